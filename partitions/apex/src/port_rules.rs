//! PRT, QUE-CLEAR and their scenarios: what channels in shared memory do, as the requirements of ARINC 653 Part 1 have it.

use std::rc::Rc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use bateleur_messages::{GroundMessage, Rate};
use bateleur_ports::{Channel, ChannelType, Domain, Membership};

use crate::ports::{
    Inlet, Outlet, QueuingDestination, QueuingSource, SamplingDestination, SamplingSource, Sent,
};
use crate::time::Time;

/// A channel under a clock that stands still until it is set.
struct Bed {
    time: Time,
    kind: ChannelType,
    channel: Channel,
    node: Membership,
    folder: tempfile::TempDir,
}

impl Bed {
    fn new<T>(message: &str, depth: Option<usize>) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let node = domain(&folder).join("channel", "test").unwrap();
        let kind = ChannelType {
            name: "channel".into(),
            message: message.into(),
            size: size_of::<T>(),
            depth,
            destinations: 2,
            spare_writers: 1,
            spare_readers: 1,
        };
        let channel = kind.create(&node).unwrap();
        Self { time: Time::standing(), kind, channel, node, folder }
    }

    fn source(&self) -> SamplingSource<Rate> {
        SamplingSource::new(Some(Rc::new(self.kind.writer(&self.channel).unwrap())), self.time.clone())
    }

    fn destination(&self, refresh_ns: u64) -> SamplingDestination<Rate> {
        let reader = self.kind.reader(&self.channel).unwrap();
        SamplingDestination::new(Some(Rc::new(reader)), refresh_ns, self.time.clone())
    }

    fn sender(&self) -> QueuingSource<GroundMessage> {
        let outlet = Outlet::new(Rc::new(self.kind.writer(&self.channel).unwrap()), None);
        QueuingSource::new(Some(Rc::new(outlet)), self.time.clone())
    }

    fn receiver(&self) -> QueuingDestination<GroundMessage> {
        let inlet = Inlet::new(self.kind.clone(), self.kind.open(&self.node).unwrap());
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
    let bed = Bed::new::<Rate>("Rate", None);
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

/// Another thread writes messages whose bytes are all the same, as fast as it can, while this one reads.
fn read_while_written(each: impl Fn(Option<&GroundMessage>)) {
    let bed = Bed::new::<GroundMessage>("GroundMessage", None);
    let reader = bed.kind.reader(&bed.channel).unwrap();
    let mut destination: SamplingDestination<GroundMessage> =
        SamplingDestination::new(Some(Rc::new(reader)), u64::MAX, bed.time.clone());
    let (kind, root, ends, begun) =
        (bed.kind.clone(), domain(&bed.folder), AtomicBool::new(false), AtomicBool::new(false));
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let node = root.join("channel", "writer").unwrap();
            let writer = kind.writer(&kind.open(&node).unwrap()).unwrap();
            for number in 0_u32.. {
                let bytes = vec![number as u8; kind.size];
                assert!(writer.put(&bytes, Stamp::default()).is_ok());
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
    read_while_written(|value| {
        let bytes = value.map(zerocopy::IntoBytes::as_bytes).unwrap_or_default();
        assert!(bytes.iter().all(|byte| *byte == bytes[0]), "parts of two messages");
    });
}

#[test]
fn bug_17_read_during_a_write_finds_a_message() {
    read_while_written(|value| assert!(value.is_some()));
}

#[test]
fn prt_06_last_message_of_a_stopped_source_can_be_read_and_ages() {
    let bed = Bed::new::<Rate>("Rate", None);
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

#[test]
fn prt_07_restarted_destination_begins_with_what_its_source_writes_next() {
    let bed = Bed::new::<Rate>("Rate", None);
    let (mut source, before) = (bed.source(), bed.destination(10));
    source.write(&rate(7));
    drop(before);
    let mut after = bed.destination(10);
    assert!(after.read().is_none());
    source.write(&rate(8));
    assert_eq!(after.read().map(|reading| reading.value.synchronize), Some(8));
    let bed = Bed::new::<GroundMessage>("GroundMessage", Some(4));
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

#[test]
fn prt_09_message_can_be_seen_as_soon_as_it_is_written() {
    let bed = Bed::new::<Rate>("Rate", None);
    let (mut source, mut destination) = (bed.source(), bed.destination(10));
    for number in 1..4 {
        source.write(&rate(number));
        assert_eq!(destination.read().map(|reading| reading.value.synchronize), Some(number));
    }
}

#[test]
fn prt_10_order_is_kept_over_both_sides_of_a_queue() {
    let bed = Bed::new::<GroundMessage>("GroundMessage", Some(3));
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

#[test]
fn scn_30_two_destinations_see_a_message_as_new_each_once() {
    let bed = Bed::new::<Rate>("Rate", None);
    let (mut one, mut other, mut source) = (bed.destination(10), bed.destination(10), bed.source());
    for _ in 0..2 {
        source.write(&rate(1));
        assert!(one.read_updated().is_some() && other.read_updated().is_some());
        assert!(one.read_updated().is_none() && other.read_updated().is_none());
    }
}

#[test]
fn bug_16_one_reader_does_not_consume_for_the_other() {
    let bed = Bed::new::<Rate>("Rate", None);
    let (mut one, mut other, mut source) = (bed.destination(10), bed.destination(10), bed.source());
    source.write(&rate(1));
    (0..3).for_each(|_| assert!(one.read().is_some()));
    assert!(other.read_updated().is_some());
}

#[test]
fn que_clear_06_source_of_a_cleared_queue_has_room_again() {
    let bed = Bed::new::<GroundMessage>("GroundMessage", Some(2));
    let (mut sender, mut receiver) = (bed.sender(), bed.receiver());
    assert_eq!(
        [1, 2, 3].map(|number| sender.send(&letter(number))),
        [Sent::Queued, Sent::Queued, Sent::Full]
    );
    assert_eq!(letters(&mut receiver), [1, 2], "CLEAR_QUEUING_PORT takes all that there is");
    assert_eq!(sender.send(&letter(4)), Sent::Queued);
    assert_eq!(letters(&mut receiver), [4]);
}
