//! Datagrams that are not the peer's: forged, changed, recorded, cut short. None is taken, none does harm.
//!
//! `no_attack_is_taken` runs a seeded stream of them; how many says `BATELEUR_FUZZ` (see the book's page on the relay).

use bateleur_contract::relay::LinkModelTable;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use zerocopy::FromBytes;

use super::*;
use crate::Rejection;
use crate::tag::{Seal, TAG_BYTES};
use crate::wire::{HEADER_BYTES, Header, Part, put};

/// A pair that has exchanged messages, and all datagrams that the first end has sent.
fn acquainted() -> Pair {
    let mut pair = Pair::new(&LinkModelTable::default());
    pair.meet();
    for number in 0..20_u8 {
        pair.ends[0].write(STATE, number.into(), pair.now_ns, &[number; 64]);
        pair.ends[0].write(ORDERS, number.into(), pair.now_ns, &[number; 30]);
        pair.frame();
    }
    pair
}

/// A datagram of the first end that has not come yet, on the first network.
fn fresh(pair: &mut Pair) -> Vec<u8> {
    pair.ends[0].write(STATE, 99, pair.now_ns, &[99; 64]);
    pair.ends[0].send(pair.now_ns).swap_remove(0).1
}

fn refused(pair: &mut Pair, datagram: &[u8]) -> Rejection {
    let now_ns = pair.now_ns;
    let before = pair.ends[1].received.len();
    let reason = pair.ends[1].take(0, now_ns, datagram).unwrap_err();
    assert_eq!(pair.ends[1].received.len(), before);
    reason
}

/// The datagram with other content, and with a tag that fits it.
fn resealed(datagram: &[u8], change: impl FnOnce(&mut Vec<u8>)) -> Vec<u8> {
    let mut bytes = datagram[..datagram.len() - TAG_BYTES].to_vec();
    change(&mut bytes);
    let length = (bytes.len() + TAG_BYTES) as u32;
    if let Ok((header, _)) = Header::mut_from_prefix(&mut bytes) {
        header.length = length.into();
    }
    let tags = Seal::new(&KEY, 7, true).tags(&bytes);
    bytes.extend_from_slice(&tags[0]);
    bytes
}

fn header(bytes: &mut [u8]) -> &mut Header {
    Header::mut_from_prefix(bytes).unwrap().0
}

#[test]
fn a_datagram_that_is_sealed_again_unchanged_is_taken() {
    let mut pair = acquainted();
    let datagram = fresh(&mut pair);
    let datagram = resealed(&datagram, |_| ());
    let now_ns = pair.now_ns;
    assert_eq!(pair.ends[1].take(0, now_ns, &datagram), Ok(())); // so that the refusals below mean something
}

#[test]
fn every_changed_bit_is_noticed() {
    let mut pair = acquainted();
    let datagram = fresh(&mut pair);
    for bit in 0..datagram.len() * 8 {
        let mut changed = datagram.clone();
        changed[bit / 8] ^= 1 << (bit % 8);
        refused(&mut pair, &changed);
    }
    let now_ns = pair.now_ns;
    assert_eq!(pair.ends[1].take(0, now_ns, &datagram), Ok(()));
}

#[test]
fn another_key_is_refused_as_one() {
    let table = table(true);
    let mut stranger = Link::new(&table, &table.links[0], &[9; 32], [1; 32]).unwrap();
    let sealed = stranger.open(0, Frame::default()).unwrap().finish(0);
    let datagram = [sealed.bytes, sealed.tag(0)].concat();
    assert_eq!(refused(&mut acquainted(), &datagram), Rejection::Key);
}

#[test]
fn a_datagram_of_the_other_network_or_direction_does_not_pass() {
    let mut pair = acquainted();
    pair.ends[0].write(STATE, 99, pair.now_ns, &[99; 64]);
    let now_ns = pair.now_ns;
    let of_b = pair.ends[0].send(now_ns).swap_remove(1).1;
    assert_eq!(refused(&mut pair, &of_b), Rejection::Key);
    let own = pair.ends[1].send(now_ns + 5_000_000).swap_remove(0).1;
    assert_eq!(refused(&mut pair, &own), Rejection::Key);
}

#[test]
fn a_datagram_without_a_tag_is_refused_where_one_belongs() {
    let mut pair = acquainted();
    let datagram = fresh(&mut pair);
    let mut plain = datagram[..datagram.len() - TAG_BYTES].to_vec();
    let length = plain.len() as u32;
    header(&mut plain).tagged = 0.into();
    header(&mut plain).length = length.into();
    assert_eq!(refused(&mut pair, &plain), Rejection::Key);
}

#[test]
fn cut_short_lengthened_giant_and_foreign_datagrams_are_told_apart() {
    let mut pair = acquainted();
    let datagram = fresh(&mut pair);
    for length in [0, 1, HEADER_BYTES - 1, HEADER_BYTES, datagram.len() - 1] {
        assert_eq!(refused(&mut pair, &datagram[..length]), Rejection::Truncated);
    }
    assert_eq!(refused(&mut pair, &[datagram.as_slice(), b"x"].concat()), Rejection::Giant);
    assert_eq!(refused(&mut pair, &[7; 1473]), Rejection::Giant);
    assert_eq!(refused(&mut pair, &[7; 400]), Rejection::Foreign);
    let version = resealed(&datagram, |bytes| header(bytes).version = 2);
    assert_eq!(refused(&mut pair, &version), Rejection::Version);
    let link = resealed(&datagram, |bytes| header(bytes).link = 8.into());
    assert_eq!(refused(&mut pair, &link), Rejection::Link);
    let plan = resealed(&datagram, |bytes| header(bytes).plan[15] ^= 1);
    assert_eq!(refused(&mut pair, &plan), Rejection::Plan);
}

#[test]
fn recorded_datagrams_are_not_taken_a_second_time() {
    let mut pair = acquainted();
    pair.frames(2);
    let (recorded, now_ns) = (pair.ends[0].sent.clone(), pair.now_ns);
    let before = pair.ends[1].received.len();
    for (network, datagram) in &recorded {
        let _ = pair.ends[1].take(*network, now_ns, datagram);
    }
    assert_eq!(pair.ends[1].received.len(), before);
    // Those from before both met are refused; the rest shows as repeated.
    let counters = pair.ends[1].link.counters();
    assert!(counters.networks[0].duplicated >= 20 && counters.networks[1].duplicated >= 20);
}

#[test]
fn recorded_datagrams_are_not_taken_after_any_restart() {
    for (first, second) in [(true, false), (false, true), (true, true)] {
        let mut pair = acquainted();
        let recorded = pair.ends[0].sent.clone();
        pair.lose_what_is_on_the_way();
        if first {
            pair.ends[0].link = link(&table(true), 11);
        }
        if second {
            pair.ends[1].link = link(&table(false), 12);
        }
        pair.ends[1].received.clear();
        // Before, while and after the living ones meet again.
        for _ in 0..6 {
            let now_ns = pair.now_ns;
            for (network, datagram) in &recorded {
                let _ = pair.ends[1].take(*network, now_ns, datagram);
            }
            assert!(pair.ends[1].received.is_empty());
            pair.frame();
        }
        assert_eq!(pair.ends[1].link.state(), bateleur_messages::link::UP, "{first} {second}");
    }
}

#[test]
fn one_bad_message_takes_the_whole_datagram_with_it() {
    let mut pair = acquainted();
    let datagram = fresh(&mut pair);
    let good =
        Part { channel: 4, sequence: 500, source_sequence: 0, source_ns: 0, piece: None, bytes: &[1; 10] };
    let mut number = 0;
    let mut with = |more: &[Part<'_>], counted: u16| {
        number += 1;
        let bad = resealed(&datagram, |bytes| {
            more.iter().for_each(|part| put(bytes, part));
            let count = header(bytes).count.get() + counted;
            header(bytes).count = count.into();
            header(bytes).sequence = (header(bytes).sequence.get() + number).into();
        });
        refused(&mut pair, &bad)
    };
    assert_eq!(with(&[good, Part { channel: 6, ..good }], 2), Rejection::Channel); // there is none
    assert_eq!(with(&[good, Part { channel: 9, ..good }], 2), Rejection::Channel); // it goes the other way
    assert_eq!(with(&[good, Part { bytes: &[1; 201], ..good }], 2), Rejection::Channel); // too long
    assert_eq!(with(&[good, Part { bytes: &[], ..good }], 2), Rejection::Channel); // nothing
    assert_eq!(with(&[good, Part { channel: 3, ..good }], 2), Rejection::Channel); // too short for its type
    assert_eq!(with(&[good], 2), Rejection::Malformed); // another count
    assert_eq!(with(&[good, Part { piece: Some((12, 3)), ..good }], 2), Rejection::Malformed); // beyond its end
}

/// One datagram that is not the peer's, made of a recorded one.
fn attack(random: &mut ChaCha8Rng, recorded: &[(usize, Vec<u8>)]) -> (usize, Vec<u8>) {
    let below = |random: &mut ChaCha8Rng, limit: usize| (random.next_u64() % limit as u64) as usize;
    let (network, datagram) = &recorded[below(random, recorded.len())];
    let mut bytes = datagram.clone();
    match below(random, 8) {
        0 => bytes.truncate(below(random, datagram.len())),
        1 => bytes.resize(datagram.len() + 1 + below(random, 3_000), 0xa5),
        2 => {
            for _ in 0..=below(random, 16) {
                let place = below(random, bytes.len());
                bytes[place] ^= 1 << below(random, 8);
            }
            if bytes == *datagram {
                bytes[0] ^= 1;
            }
        }
        3 => {
            bytes = vec![0; below(random, 2_000)];
            random.fill_bytes(&mut bytes);
        }
        4 => {
            // Its own header, the content of another.
            let other = &recorded[below(random, recorded.len())].1;
            bytes.truncate(HEADER_BYTES);
            bytes.extend_from_slice(&other[HEADER_BYTES..]);
            let length = bytes.len() as u32;
            header(&mut bytes).length = length.into();
            header(&mut bytes).sequence = random.next_u64().into();
        }
        5 => {
            // A header of numbers that mean something, and a tag of chance.
            header(&mut bytes).sequence = (1 + random.next_u64() % 100_000).into();
            header(&mut bytes).session = random.next_u64().into();
        }
        6 => {
            // Sealed with another key.
            let end = bytes.len() - TAG_BYTES;
            let tags = Seal::new(&[1; 32], 7, true).tags(&bytes[..end]);
            bytes[end..].copy_from_slice(&tags[*network]);
        }
        _ => {} // as it was recorded
    }
    (*network, bytes)
}

fn datagrams() -> u64 {
    std::env::var("BATELEUR_FUZZ").ok().and_then(|count| count.parse().ok()).unwrap_or(40_000)
}

#[test]
fn no_attack_is_taken() {
    let mut pair = acquainted();
    pair.frames(2);
    let mut recorded = pair.ends[0].sent.clone();
    // Another plan under the same key, and an earlier life.
    let mut other = table(true);
    other.digest = "77".repeat(32);
    for table in [other, table(true)] {
        let mut link = link(&table, 42);
        let sealed = link.open(0, Frame::default()).unwrap().finish(0);
        recorded.extend((0..2).map(|network| (network, [sealed.bytes, sealed.tag(network)].concat())));
    }
    let mut random = ChaCha8Rng::seed_from_u64(0xb47e1e);
    let (count, before, now_ns) = (datagrams(), pair.ends[1].received.len(), pair.now_ns);
    let counted = pair.ends[1].link.counters();
    for _ in 0..count {
        let (network, datagram) = attack(&mut random, &recorded);
        let _ = pair.ends[1].take(network, now_ns, &datagram); // counted
    }
    assert_eq!(pair.ends[1].received.len(), before, "a datagram was taken that is not the peer's");
    let after = pair.ends[1].link.counters();
    let duplicated = |counters: &crate::counters::LinkCounters| {
        counters.networks.iter().map(|network| network.duplicated).sum::<u64>()
    };
    let refused = after.all_rejections() - counted.all_rejections();
    assert_eq!(refused + duplicated(&after) - duplicated(&counted), count);
    println!("{count} datagrams: {refused} refused, the others repeated; {:?}", after.rejected);
    // The peer itself goes on undisturbed.
    pair.ends[0].write(ORDERS, 1_000, now_ns, b"after all that");
    pair.frames(2);
    assert_eq!(
        pair.ends[1].received.last().map(|message| message.3.as_slice()),
        Some(&b"after all that"[..])
    );
}

#[test]
fn no_content_of_one_who_has_the_key_does_harm() {
    let mut pair = acquainted();
    let datagram = fresh(&mut pair);
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let now_ns = pair.now_ns;
    for number in 0..datagrams() / 4 {
        let bad = resealed(&datagram, |bytes| {
            header(bytes).sequence = (header(bytes).sequence.get() + 1 + number).into();
            header(bytes).kind = (random.next_u64() % 3) as u8;
            header(bytes).count = ((random.next_u64() % 4) as u16).into();
            header(bytes).echo_sent_ns = random.next_u64().into();
            header(bytes).echo_came_ns = random.next_u64().into();
            header(bytes).plan[0] ^= (random.next_u64() % 5 == 0) as u8;
            bytes.truncate(HEADER_BYTES);
            let mut junk = vec![0; (random.next_u64() % 200) as usize];
            random.fill_bytes(&mut junk);
            for part in 0..random.next_u64() % 3 {
                let channel = [3, 4, 5, 9, 200][(random.next_u64() % 5) as usize];
                let piece = (random.next_u64() % 2 == 0)
                    .then(|| (random.next_u32() % 10_000, random.next_u32() % 9_000));
                let sequence = random.next_u32() >> (random.next_u32() % 32);
                let source_ns = random.next_u64();
                put(
                    bytes,
                    &Part { channel, sequence, source_sequence: part as u32, source_ns, piece, bytes: &junk },
                );
            }
        });
        let _ = pair.ends[1].take(0, now_ns, &bad);
        if number % 64 == 0 {
            pair.ends[1].look(now_ns);
        }
    }
    let counters = pair.ends[1].link.counters();
    for reason in [Rejection::Malformed, Rejection::Channel, Rejection::Plan] {
        assert!(counters.rejections(reason) > 0, "{reason:?}: {counters:?}");
    }
}

#[test]
fn a_message_number_that_comes_in_two_datagrams_makes_no_counter_wrap() {
    let mut pair = acquainted();
    let datagram = fresh(&mut pair);
    for number in 1..4 {
        let again = resealed(&datagram, |bytes| {
            header(bytes).sequence = (header(bytes).sequence.get() + number).into();
        });
        let _ = pair.ends[1].take(0, pair.now_ns, &again); // what counts is what is counted
    }
    let counters = pair.ends[1].link.counters();
    assert!(counters.messages_lost < 10, "{counters:?}");
}
