//! Ends of sealed channels that are killed at any instant, each a process of its own: whoever is left has whole messages only, waits for
//! nobody, and goes on with the successor.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]
#![allow(unsafe_code)] // numbers that become descriptors

use std::os::fd::{AsRawFd, FromRawFd, OwnedFd};
use std::os::unix::process::ExitStatusExt;
use std::process::{Child, Command};
use std::time::{Duration, Instant};

use bateleur_ports::{Channel, ChannelType, Handed, Received, Stamp};
use rustix::io::{FdFlags, fcntl_setfd};

/// What the other process is to be, as `ROLE,RING,INDEX,INCARNATION,CHECKED`.
const ORDER: &str = "BATELEUR_KILLED_ORDER";
/// Processes that are killed in each test.
const KILLS: u32 = 120;
/// A killed one lives so long at most, µs.
const LIFE_US: u64 = 4_000;
/// A process has so long to send or receive its first message.
const PATIENCE: Duration = Duration::from_secs(20);
/// The exit code of a process that was handed something wrong.
const WRONG: i32 = 3;

fn kind(depth: Option<usize>) -> ChannelType {
    ChannelType {
        name: "killed".into(),
        message: "Words".into(),
        size: 2048,
        depth,
        destinations: 1,
        spare_writers: 0,
        spare_readers: 0,
    }
}

fn message(sequence: u64) -> Vec<u8> {
    let words = 1 + sequence as usize % 256;
    sequence.to_ne_bytes().repeat(words)
}

fn is_whole(received: &Received) -> bool {
    let stamp = received.stamp();
    stamp.source_ns == !stamp.sequence && received.payload() == message(stamp.sequence)
}

fn stamp(sequence: u64) -> Stamp {
    Stamp { source_ns: !sequence, sequence }
}

/// Starts this program again as one of the ends.
fn start(role: &str, handed: &Handed) -> Child {
    let index = handed.index.as_ref().map_or(-1, AsRawFd::as_raw_fd);
    for descriptor in [Some(&handed.ring), handed.index.as_ref()].into_iter().flatten() {
        fcntl_setfd(descriptor, FdFlags::empty()).unwrap();
    }
    let (ring, checked) = (handed.ring.as_raw_fd(), u8::from(handed.checked));
    let order = format!("{role},{ring},{index},{},{checked}", handed.incarnation);
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "the_other_process", "--nocapture"]).env(ORDER, order);
    command.stdout(std::process::Stdio::null()).spawn().unwrap()
}

/// The other process' whole life: it ends when it is killed, or by what is wrong.
#[test]
fn the_other_process() {
    let Ok(order) = std::env::var(ORDER) else { return };
    let words: Vec<&str> = order.split(',').collect();
    let number = |place: usize| words[place].parse::<i32>().unwrap();
    // SAFETY: the parent left them open for this purpose.
    let own = |place| (number(place) >= 0).then(|| unsafe { OwnedFd::from_raw_fd(number(place)) });
    let incarnation = number(3) as u32;
    let handed = Handed { ring: own(1).unwrap(), index: own(2), checked: number(4) == 1, incarnation };
    let kind = kind(handed.index.as_ref().map(|_| 4));
    let channel = Channel::Sealed(handed);
    match words[0] {
        "source" => {
            let writer = kind.writer(&channel).unwrap();
            let mut sequence = u64::from(incarnation) << 32 | 1;
            loop {
                let sent = match sequence % 3 {
                    0 => writer.put_in_place(message(sequence).len(), stamp(sequence), |bytes| {
                        bytes.copy_from_slice(&message(sequence));
                    }),
                    _ => writer.put(&message(sequence), stamp(sequence)),
                };
                sequence += u64::from(matches!(sent, Ok(1)));
            }
        }
        _ => {
            let reader = kind.reader(&channel).unwrap();
            let mut last: Option<u64> = None;
            loop {
                let Ok(received) = reader.receive() else { std::process::exit(WRONG) };
                let Some(received) = received else { continue };
                let sequence = received.stamp().sequence;
                if !is_whole(&received) || last.is_some_and(|last| sequence != last + 1) {
                    std::process::exit(WRONG);
                }
                last = Some(sequence);
            }
        }
    }
}

fn random(seed: &mut u64) -> u64 {
    *seed ^= *seed << 13;
    *seed ^= *seed >> 7;
    *seed ^= *seed << 17;
    *seed
}

/// Kills it, and sees that it lived until then.
fn kill(mut child: Child) {
    child.kill().unwrap();
    let status = child.wait().unwrap();
    assert_eq!(status.signal(), Some(9), "it found something wrong: {status}");
}

/// Does `turn` until it has done something, and then for a random time.
fn live(seed: &mut u64, mut turn: impl FnMut() -> bool) {
    let begun = Instant::now();
    while !turn() {
        assert!(begun.elapsed() < PATIENCE, "nothing comes from the successor");
    }
    let (until, begun) = (Duration::from_micros(random(seed) % LIFE_US), Instant::now());
    while begun.elapsed() < until {
        turn();
    }
}

#[test]
fn a_source_that_is_killed_at_any_instant_leaves_whole_values_and_a_channel_for_its_successor() {
    for checked in [false, true] {
        let kind = kind(None);
        let handed = Handed::alone(&kind, checked).unwrap();
        let channel = Channel::Sealed(handed.again(0).unwrap());
        let (reader, observer) = (kind.reader(&channel).unwrap(), kind.observer(&channel).unwrap());
        let mut seed = 0x5eed_0001;
        for incarnation in 1..=KILLS {
            let source = start("source", &handed.again(incarnation).unwrap());
            let look = |reader: &bateleur_ports::Reader| match reader.receive().unwrap() {
                Some(received) => {
                    assert!(is_whole(&received), "{received:?}");
                    received.stamp().sequence >> 32 == u64::from(incarnation)
                }
                None => false,
            };
            live(&mut seed, || {
                let seen = look(&observer);
                look(&reader) || seen
            });
            kill(source);
            while reader.receive().unwrap().is_some_and(|received| is_whole(&received)) {}
        }
    }
}

#[test]
fn a_sender_that_is_killed_at_any_instant_loses_nothing_that_it_had_sent_and_nothing_comes_twice() {
    for checked in [false, true] {
        let kind = kind(Some(4));
        let handed = Handed::alone(&kind, checked).unwrap();
        let reader = kind.reader(&Channel::Sealed(handed.again(0).unwrap())).unwrap();
        let (mut seed, mut last) = (0x5eed_0002, 0);
        for incarnation in 1..=KILLS {
            let sender = start("source", &handed.again(incarnation).unwrap());
            let mut take = || {
                let Some(received) = reader.receive().unwrap() else { return false };
                assert!(is_whole(&received), "{received:?}");
                let sequence = received.stamp().sequence;
                let is_first = sequence & u64::from(u32::MAX) == 1 && sequence > last;
                assert!(sequence == last + 1 || is_first, "{sequence:x} follows {last:x}");
                last = sequence;
                true
            };
            live(&mut seed, &mut take);
            kill(sender);
            while take() {}
        }
        assert_eq!(last >> 32, u64::from(KILLS));
    }
}

#[test]
fn a_receiver_that_is_killed_at_any_instant_leaves_a_queue_for_its_successor() {
    for checked in [false, true] {
        let kind = kind(Some(4));
        let handed = Handed::alone(&kind, checked).unwrap();
        let writer = kind.writer(&Channel::Sealed(handed.again(0).unwrap())).unwrap();
        let (mut seed, mut sequence) = (0x5eed_0003, 1);
        for incarnation in 1..=KILLS {
            while matches!(writer.put(&message(sequence), stamp(sequence)), Ok(1)) {
                sequence += 1; // what the dead one has not taken stays full, or nobody receives yet
            }
            let receiver = start("receiver", &handed.again(incarnation).unwrap());
            live(&mut seed, || {
                let sent = matches!(writer.put(&message(sequence), stamp(sequence)), Ok(1));
                sequence += u64::from(sent);
                sent
            });
            kill(receiver);
        }
    }
}
