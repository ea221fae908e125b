//! PRT, QUE-CLEAR and their scenarios: what channels in shared memory do, as the requirements of ARINC 653 Part 1 have it.

use std::cell::Cell;
use std::rc::Rc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use bateleur_messages::{GroundMessage, Rate};
use bateleur_ports::{Channel, ChannelType, Domain, Handed, Membership, Stamp};

use crate::ports::{
    Inlet, Outlet, QueuingDestination, QueuingSource, SamplingDestination, SamplingSource, Sent,
};
use crate::time::Time;

/// What a channel's memory is. Every rule here holds for each.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Memory {
    Shared,
    Sealed,
    Checked,
}

const ALL: [Memory; 3] = [Memory::Shared, Memory::Sealed, Memory::Checked];

/// A channel under a clock that stands still until it is set.
struct Bed {
    time: Time,
    kind: ChannelType,
    channel: Channel,
    node: Membership,
    folder: tempfile::TempDir,
    /// Processes that had an end of it.
    incarnations: Cell<u32>,
}

impl Bed {
    fn new<T>(memory: Memory, message: &str, depth: Option<usize>) -> Self {
        Self::of_bytes(memory, message, size_of::<T>(), depth)
    }

    fn of_bytes(memory: Memory, message: &str, size: usize, depth: Option<usize>) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let node = domain(&folder).join("channel", "test").unwrap();
        let kind = ChannelType {
            name: "channel".into(),
            message: message.into(),
            size,
            depth,
            destinations: 2,
            spare_writers: 1,
            spare_readers: 1,
        };
        let channel = match memory {
            Memory::Shared => kind.create(&node).unwrap(),
            _ => Channel::Sealed(Handed::alone(&kind, memory == Memory::Checked).unwrap()),
        };
        let incarnations = Cell::new(0);
        Self { time: Time::standing(), kind, channel, node, folder, incarnations }
    }

    /// The channel as the next process finds it.
    fn opened(&self) -> Channel {
        let incarnation = self.incarnations.replace(self.incarnations.get() + 1);
        match &self.channel {
            Channel::Shared(_) => self.kind.open(&self.node).unwrap(),
            Channel::Sealed(handed) => Channel::Sealed(handed.again(incarnation).unwrap()),
        }
    }

    fn source(&self) -> SamplingSource<Rate> {
        SamplingSource::new(Some(Rc::new(self.kind.writer(&self.opened()).unwrap())), self.time.clone())
    }

    fn destination(&self, refresh_ns: u64) -> SamplingDestination<Rate> {
        let reader = self.kind.reader(&self.opened()).unwrap();
        SamplingDestination::new(Some(Rc::new(reader)), refresh_ns, self.time.clone())
    }

    fn sender(&self) -> QueuingSource<GroundMessage> {
        let outlet = Outlet::new(Rc::new(self.kind.writer(&self.opened()).unwrap()), None);
        QueuingSource::new(Some(Rc::new(outlet)), self.time.clone())
    }

    fn receiver(&self) -> QueuingDestination<GroundMessage> {
        let inlet = Inlet::new(self.kind.clone(), self.opened());
        inlet.attach().unwrap();
        QueuingDestination::new(Some(Rc::new(inlet)), self.time.clone())
    }

    fn pass(&self, nanoseconds: u64) {
        self.time.page().now_ns.fetch_add(nanoseconds, Relaxed);
    }
}

fn domain(folder: &tempfile::TempDir) -> Domain {
    Domain { root: folder.path().display().to_string() }
}

fn rate(synchronize: u64) -> Rate {
    Rate { synchronize, ..Rate::default() }
}

fn letter(letter: u8) -> GroundMessage {
    GroundMessage { letter, ..GroundMessage::default() }
}

fn letters(receiver: &mut QueuingDestination<GroundMessage>) -> Vec<u8> {
    std::iter::from_fn(|| receiver.receive()).map(|message| message.letter).collect()
}

#[test]
fn prt_03_validity_and_novelty_are_each_destinations_own() {
    for memory in ALL {
        let bed = Bed::new::<Rate>(memory, "Rate", None);
        let (mut patient, mut strict, mut source) = (bed.destination(100), bed.destination(10), bed.source());
        source.write(&rate(1));
        bed.pass(50);
        let seen = |destination: &mut SamplingDestination<Rate>| {
            destination.read().map(|reading| (reading.valid, reading.updated))
        };
        assert_eq!(seen(&mut patient), Some((true, true)));
        assert_eq!(seen(&mut patient), Some((true, false)));
        assert_eq!(seen(&mut strict), Some((false, true)), "its own refresh period, and new to it");
    }
}

/// Another thread writes messages whose bytes are all the same, as fast as it can, while this one reads.
fn read_while_written(memory: Memory, each: impl Fn(Option<&GroundMessage>)) {
    let bed = Bed::new::<GroundMessage>(memory, "GroundMessage", None);
    let reader = bed.kind.reader(&bed.opened()).unwrap();
    let mut destination: SamplingDestination<GroundMessage> =
        SamplingDestination::new(Some(Rc::new(reader)), u64::MAX, bed.time.clone());
    let (kind, root, ends, begun) =
        (bed.kind.clone(), domain(&bed.folder), AtomicBool::new(false), AtomicBool::new(false));
    let handed = match &bed.channel {
        Channel::Shared(_) => None,
        Channel::Sealed(handed) => Some(handed.again(1).unwrap()),
    };
    let (ends, begun) = (&ends, &begun);
    std::thread::scope(|scope| {
        scope.spawn(move || {
            let node = root.join("channel", "writer").unwrap();
            let channel = handed.map_or_else(|| kind.open(&node).unwrap(), Channel::Sealed);
            let writer = kind.writer(&channel).unwrap();
            for number in 0_u32.. {
                assert!(writer.put(&vec![number as u8; kind.size], Stamp::default()).is_ok());
                begun.store(true, Relaxed);
                if ends.load(Relaxed) {
                    return;
                }
            }
        });
        while !begun.load(Relaxed) {
            std::thread::yield_now();
        }
        for _ in 0..20_000 {
            each(destination.read().map(|reading| reading.value));
        }
        ends.store(true, Relaxed);
    });
}

#[test]
fn prt_04_reader_has_a_whole_message_old_or_new() {
    for memory in ALL {
        read_while_written(memory, |value| {
            let bytes = value.map(zerocopy::IntoBytes::as_bytes).unwrap_or_default();
            assert!(bytes.iter().all(|byte| *byte == bytes[0]), "parts of two messages");
        });
    }
}

#[test]
fn bug_17_read_during_a_write_finds_a_message() {
    for memory in ALL {
        read_while_written(memory, |value| assert!(value.is_some()));
    }
}

#[test]
fn prt_06_last_message_of_a_stopped_source_can_be_read_and_ages() {
    for memory in ALL {
        let bed = Bed::new::<Rate>(memory, "Rate", None);
        let (mut source, mut destination) = (bed.source(), bed.destination(10));
        source.write(&rate(7));
        drop(source);
        let seen = |destination: &mut SamplingDestination<Rate>| {
            destination.read().map(|reading| (reading.value.synchronize, reading.age_ns, reading.valid))
        };
        assert_eq!(seen(&mut destination), Some((7, 0, true)));
        bed.pass(11);
        assert_eq!(seen(&mut destination), Some((7, 11, false)));
    }
}

#[test]
fn prt_07_restarted_destination_begins_with_what_its_source_writes_next() {
    for memory in ALL {
        let bed = Bed::new::<Rate>(memory, "Rate", None);
        let (mut source, before) = (bed.source(), bed.destination(10));
        source.write(&rate(7));
        drop(before);
        let mut after = bed.destination(10);
        assert!(after.read().is_none());
        source.write(&rate(8));
        assert_eq!(after.read().map(|reading| reading.value.synchronize), Some(8));
        let bed = Bed::new::<GroundMessage>(memory, "GroundMessage", Some(4));
        let (mut sender, mut before) = (bed.sender(), bed.receiver());
        assert_eq!(sender.send(&letter(1)), Sent::Queued);
        assert_eq!(letters(&mut before), [1]);
        assert_eq!(sender.send(&letter(2)), Sent::Queued);
        drop(before);
        let mut after = bed.receiver();
        assert_eq!(letters(&mut after), [0_u8; 0]);
        assert_eq!(sender.send(&letter(3)), Sent::Queued);
        assert_eq!(letters(&mut after), [3]);
    }
}

#[test]
fn prt_09_message_can_be_seen_as_soon_as_it_is_written() {
    for memory in ALL {
        let bed = Bed::new::<Rate>(memory, "Rate", None);
        let (mut source, mut destination) = (bed.source(), bed.destination(10));
        for number in 1..4 {
            source.write(&rate(number));
            assert_eq!(destination.read().map(|reading| reading.value.synchronize), Some(number));
        }
    }
}

#[test]
fn prt_10_order_is_kept_over_both_sides_of_a_queue() {
    for memory in ALL {
        let bed = Bed::new::<GroundMessage>(memory, "GroundMessage", Some(3));
        let (mut sender, mut receiver) = (bed.sender(), bed.receiver());
        let (mut found, mut next) = (Vec::new(), 0);
        for round in 0..40 {
            while sender.send(&letter(next)) == Sent::Queued {
                next += 1;
            }
            found.extend((0..1 + round % 3).filter_map(|_| receiver.receive()).map(|message| message.letter));
        }
        let expected: Vec<u8> = (0..found.len() as u8).collect();
        assert!(found == expected && found.len() > 60, "{found:?}");
    }
}

#[test]
fn scn_30_two_destinations_see_a_message_as_new_each_once() {
    for memory in ALL {
        let bed = Bed::new::<Rate>(memory, "Rate", None);
        let (mut one, mut other, mut source) = (bed.destination(10), bed.destination(10), bed.source());
        for _ in 0..2 {
            source.write(&rate(1));
            assert!(one.read_updated().is_some() && other.read_updated().is_some());
            assert!(one.read_updated().is_none() && other.read_updated().is_none());
        }
    }
}

#[test]
fn bug_16_one_reader_does_not_consume_for_the_other() {
    for memory in ALL {
        let bed = Bed::new::<Rate>(memory, "Rate", None);
        let (mut one, mut other, mut source) = (bed.destination(10), bed.destination(10), bed.source());
        source.write(&rate(1));
        (0..3).for_each(|_| assert!(one.read().is_some()));
        assert!(other.read_updated().is_some());
    }
}

#[test]
fn que_clear_06_source_of_a_cleared_queue_has_room_again() {
    for memory in ALL {
        let bed = Bed::new::<GroundMessage>(memory, "GroundMessage", Some(2));
        let (mut sender, mut receiver) = (bed.sender(), bed.receiver());
        assert_eq!(
            [1, 2, 3].map(|number| sender.send(&letter(number))),
            [Sent::Queued, Sent::Queued, Sent::Full]
        );
        assert_eq!(letters(&mut receiver), [1, 2], "CLEAR_QUEUING_PORT takes all that there is");
        assert_eq!(sender.send(&letter(4)), Sent::Queued);
        assert_eq!(letters(&mut receiver), [4]);
    }
}

#[test]
fn message_longer_than_its_channels_is_refused_and_changes_nothing() {
    for memory in ALL {
        for depth in [None, Some(2)] {
            let bed = Bed::of_bytes(memory, "bytes", 10, depth);
            let reader = bed.kind.reader(&bed.opened()).unwrap();
            let writer = bed.kind.writer(&bed.opened()).unwrap();
            let stamp = Stamp { source_ns: 5, sequence: 1 };
            assert!(writer.put(&[1; 10], stamp).is_ok());
            assert!(writer.put(&[2; 11], stamp).is_err(), "{memory:?}");
            assert!(writer.put_in_place(11, stamp, |_| unreachable!()).is_err(), "{memory:?}");
            let received = reader.receive().unwrap().unwrap();
            assert_eq!((received.payload(), received.stamp()), (&[1; 10][..], stamp));
            assert!(reader.receive().unwrap().is_none());
        }
    }
}

#[test]
fn messages_of_every_length_arrive_with_their_length_and_stamp() {
    for memory in ALL {
        for depth in [None, Some(1)] {
            let bed = Bed::of_bytes(memory, "bytes", 130, depth);
            let reader = bed.kind.reader(&bed.opened()).unwrap();
            let writer = bed.kind.writer(&bed.opened()).unwrap();
            for length in 1..=130_usize {
                let bytes: Vec<u8> = (0..length).map(|place| (place * 7 + length) as u8).collect();
                let stamp = Stamp { source_ns: 1 << 40 | length as u64, sequence: length as u64 };
                assert_eq!(writer.put(&bytes, stamp).ok(), Some(1), "{memory:?}");
                let received = reader.receive().unwrap().unwrap();
                assert_eq!((received.payload(), received.stamp()), (&*bytes, stamp), "{memory:?}");
                assert_eq!(received.payload().as_ptr() as usize % bateleur_ports::ALIGNMENT, 0);
            }
        }
    }
}

#[test]
fn queue_to_which_nobody_listens_takes_nothing() {
    for memory in ALL {
        let bed = Bed::new::<GroundMessage>(memory, "GroundMessage", Some(2));
        let mut sender = bed.sender();
        assert_eq!(sender.send(&letter(1)), Sent::NoReceiver, "{memory:?}");
        let mut receiver = bed.receiver();
        assert_eq!(sender.send(&letter(2)), Sent::Queued, "{memory:?}");
        assert_eq!(letters(&mut receiver), [2]);
    }
}

#[test]
fn successor_of_a_source_goes_on_where_its_channel_is() {
    for memory in ALL {
        let bed = Bed::new::<Rate>(memory, "Rate", None);
        let mut destination = bed.destination(10);
        for round in 0..5 {
            let mut source = bed.source();
            for number in 1..=3 {
                source.write(&rate(10 * round + number));
            }
            bed.pass(11); // what the one before left is no longer valid, and hides nothing
            source.write(&rate(10 * round + 4));
            let seen = destination.read().map(|reading| (reading.value.synchronize, reading.sequence));
            assert_eq!(seen, Some((10 * round + 4, 4)), "{memory:?}");
        }
        let bed = Bed::new::<GroundMessage>(memory, "GroundMessage", Some(4));
        let mut receiver = bed.receiver();
        for round in 0..5 {
            let mut sender = bed.sender();
            let sent = [1, 2, 3].map(|number| sender.send(&letter(10 * round + number)));
            assert_eq!(sent, [Sent::Queued; 3], "{memory:?}");
            // On shared memory a message lies with its writer, and goes with it.
            let living = (memory == Memory::Shared).then_some(sender);
            assert_eq!(letters(&mut receiver), [1, 2, 3].map(|number| 10 * round + number), "{memory:?}");
            drop(living);
        }
    }
}

#[test]
fn queue_of_every_depth_is_full_behind_its_last_place() {
    for memory in ALL {
        for depth in [1_usize, 2, 3, 8, 64] {
            let bed = Bed::new::<GroundMessage>(memory, "GroundMessage", Some(depth));
            let (mut sender, mut receiver) = (bed.sender(), bed.receiver());
            for _ in 0..3 {
                let sent: Vec<Sent> =
                    (0..depth + 2).map(|number| sender.send(&letter(number as u8))).collect();
                let accepted = sent.iter().filter(|sent| **sent == Sent::Queued).count();
                assert_eq!((accepted, sent[depth]), (depth, Sent::Full), "{memory:?} of {depth}");
                assert_eq!(letters(&mut receiver), (0..depth as u8).collect::<Vec<_>>());
            }
        }
    }
}
