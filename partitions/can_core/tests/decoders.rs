//! Every decoder against damaged bytes: what is in the corpus, changed at random. Whatever comes out of one goes through its
//! encoder and back unchanged. `BATELEUR_FUZZ=100000000` makes it long.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use bateleur_can_core::wire::{candump, cannelloni, native, slcan, socketcand};
use bateleur_can_core::{Frame, Gateway, Kind, Settings};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};

fn corpus() -> Vec<Vec<u8>> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/corpus");
    let mut paths: Vec<_> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths.iter().map(|path| std::fs::read(path).unwrap()).collect()
}

/// One to eight changes: a bit, a byte, a cut, a repetition, a piece of another one.
fn damage(bytes: &mut Vec<u8>, corpus: &[Vec<u8>], chance: &mut ChaCha8Rng) {
    let mut draw = |below: usize| chance.next_u64() as usize % below.max(1);
    for _ in 0..=draw(8) {
        let at = draw(bytes.len());
        match draw(5) {
            0 if !bytes.is_empty() => bytes[at] ^= 1 << draw(8),
            1 if !bytes.is_empty() => bytes[at] = draw(256) as u8,
            2 => bytes.truncate(at),
            3 => bytes.extend_from_within(at..),
            _ => {
                let other = &corpus[draw(corpus.len())];
                let from = draw(other.len());
                bytes.splice(at..at, other[from..].iter().copied());
            }
        }
        bytes.truncate(3_000);
    }
}

fn decode(bytes: &[u8]) {
    let mut aged = Vec::new();
    if let Ok(header) = native::decode(bytes, &mut aged) {
        let mut again = Vec::new();
        native::encode(&header, &mut again);
        assert!(aged.iter().all(|one| native::append(one, &mut again)));
        let mut back = Vec::new();
        assert_eq!(native::decode(&again, &mut back), Ok(header));
        assert_eq!(back, aged);
    }
    let mut frames = Vec::new();
    if let Some(arrival) = cannelloni::decode(bytes, &mut frames) {
        let mut again = Vec::new();
        cannelloni::encode(arrival.sequence, &mut again);
        let fitted = frames.iter().take_while(|frame| cannelloni::append(frame, &mut again)).count();
        let mut back = Vec::new();
        cannelloni::decode(&again, &mut back).unwrap();
        assert_eq!(back, frames[..fitted]);
    }
    let mut lines = slcan::Decoder::new();
    for line in bytes.iter().filter_map(|byte| lines.push(*byte)) {
        if let Ok(slcan::Line::Frame(frame)) = line {
            let mut text = Vec::new();
            assert!(slcan::encode(&frame, &mut text));
            let mut decoder = slcan::Decoder::new();
            let back = text.iter().find_map(|byte| decoder.push(*byte));
            assert_eq!(back, Some(Ok(slcan::Line::Frame(frame))));
        }
    }
    let mut messages = socketcand::Decoder::new();
    for words in bytes.iter().filter_map(|byte| messages.push(*byte)) {
        if let socketcand::Request::Send(frame) = socketcand::request(&words) {
            assert!(frame.kind() == Kind::Data && socketcand::frame(&frame, 0).is_some());
        }
    }
    for line in String::from_utf8_lossy(bytes).lines() {
        if let Ok(entry) = candump::parse(line) {
            let written = candump::line(&entry);
            let back: Frame = candump::parse(&written).unwrap().frame;
            assert_eq!(back, entry.frame, "{written}");
        }
    }
    let mut gateway = Gateway::new(Settings::new(1, 1, vec![]));
    gateway.address_is_ready(0);
    gateway.take_datagram(bytes, "10.0.0.1:1".parse().unwrap(), 0, |_, _| ());
    gateway.run(1, &mut |_, _| true);
}

#[test]
fn no_bytes_whatever_bring_a_decoder_down() {
    let corpus = corpus();
    assert!(corpus.len() > 12);
    corpus.iter().for_each(|bytes| decode(bytes));
    let rounds = std::env::var("BATELEUR_FUZZ")
        .map_or(30_000, |text| text.parse().expect("BATELEUR_FUZZ is a number"));
    let seed =
        std::env::var("BATELEUR_FUZZ_SEED").map_or(1, |text| text.parse().expect("a seed is a number"));
    let mut chance = ChaCha8Rng::seed_from_u64(seed);
    for round in 0..rounds {
        let mut bytes = corpus[round % corpus.len()].clone();
        damage(&mut bytes, &corpus, &mut chance);
        decode(&bytes);
    }
}
