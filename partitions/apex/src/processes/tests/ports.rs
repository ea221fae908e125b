//! Ports of the plan through the standard's services: the test is the partition at their other end.

use bateleur_messages::{GroundMessage, Rate};
use bateleur_ports::Stamp;
use bateleur_processes::standard::{PortDirection, QueuingPortId, Validity};
use zerocopy::IntoBytes;

use super::*;
use crate::ports::{QueuingDestination, QueuingSource};

const SOURCE: PortDirection = PortDirection::Source;
const DESTINATION: PortDirection = PortDirection::Destination;
const LONGEST: i32 = size_of::<GroundMessage>() as i32;

/// Appends bytes of any length, as the message with this number.
fn send(source: &QueuingSource<GroundMessage>, bytes: &[u8], sequence: u64) -> bool {
    let stamp = Stamp { source_ns: 0, sequence };
    source.outlet.as_ref().unwrap().put(bytes, stamp, 0).is_ok_and(|receivers| receivers > 0)
}

/// A partition with queue `in` of two messages, and the source that fills it.
fn receiving(
    clock: Clock,
    discipline: u32,
    initialise: impl FnOnce(&mut Initialisation<'_>, &Notes, QueuingPortId) -> Result<(), StartError>,
) -> (Arc<Kernel>, Notes, QueuingSource<GroundMessage>, Harness) {
    let mut harness = Harness::new("receiving").unwrap();
    let source = harness.queuing_destination::<GroundMessage>("in", 2).unwrap();
    let context = harness.context().unwrap();
    let (kernel, notes) = partition_in(context, clock, |partition, notes| {
        let port = partition.create_queuing_port("in", LONGEST, 2, DESTINATION, discipline)?;
        initialise(partition, notes, port)
    });
    (kernel, notes, source, harness)
}

/// A process that notes what it receives, and when.
fn receiver(
    partition: &mut Initialisation<'_>,
    (name, priority): (&'static str, i32),
    (port, time_out): (QueuingPortId, i64),
    notes: &Notes,
) -> Result<(), StartError> {
    let notes = notes.clone();
    partition.process(name, Every::once().priority(priority), move |process| {
        let mut message = Vec::new();
        loop {
            let result = process.receive_queuing_message(port, time_out, &mut message);
            let text = String::from_utf8_lossy(&message).into_owned();
            note(&notes, format!("{name} {result:?} {text} at {}", time(process)?));
        }
    })?;
    Ok(())
}

#[test]
fn message_of_any_length_wakes_its_receiver_with_the_next_window_and_a_time_out_comes_at_its_instant() {
    let (kernel, notes, source, _harness) = receiving(Clock::Virtual, 0, |partition, notes, port| {
        receiver(partition, ("r", 10), (port, 30 * MS), notes)
    });
    windows(&kernel, 0..1);
    assert!(send(&source, b"four", 1) && send(&source, b"sixsix", 2) && !send(&source, b"full", 3));
    windows(&kernel, 1..4);
    assert_eq!(
        *notes.lock().unwrap(),
        ["r Ok(()) four at 20", "r Ok(()) sixsix at 20", "r Err(TimedOut)  at 60"],
        "the time-out at 50 ms lies between two windows"
    );
}

#[test]
fn prt_12_lost_message_is_told_once_with_the_one_after_it() {
    let (kernel, notes, source, _harness) = receiving(Clock::Virtual, 0, |partition, notes, port| {
        receiver(partition, ("r", 10), (port, FOREVER), notes)
    });
    windows(&kernel, 0..1);
    assert!(send(&source, b"one", 1) && send(&source, b"three", 3));
    windows(&kernel, 1..2);
    assert!(send(&source, b"four", 4));
    windows(&kernel, 2..3);
    assert_eq!(
        *notes.lock().unwrap(),
        ["r Ok(()) one at 20", "r Err(InvalidConfig) three at 20", "r Ok(()) four at 40"]
    );
}

#[test]
fn receivers_are_served_in_the_order_of_the_discipline() {
    for (discipline, expected) in [(0, ["low", "high"]), (1, ["high", "low"])] {
        let (kernel, notes, source, _harness) =
            receiving(Clock::Virtual, discipline, |partition, notes, port| {
                receiver(partition, ("low", 10), (port, FOREVER), notes)?;
                // It comes later.
                let notes = notes.clone();
                partition.process("high", Every::once().priority(20).delayed_ms(1), move |process| {
                    let mut message = Vec::new();
                    process.receive_queuing_message(port, FOREVER, &mut message)?;
                    note(&notes, format!("high {}", String::from_utf8_lossy(&message)));
                    Ok(())
                })?;
                Ok(())
            });
        windows(&kernel, 0..1);
        assert!(send(&source, b"1", 1));
        windows(&kernel, 1..2);
        assert!(send(&source, b"2", 2));
        windows(&kernel, 2..3);
        let notes = notes.lock().unwrap();
        let order: Vec<&str> = notes.iter().filter_map(|note| note.split(' ').next()).collect();
        assert_eq!(order, expected);
    }
}

#[test]
fn status_counts_what_has_arrived_and_clearing_drops_it() {
    let (kernel, notes, source, _harness) = receiving(Clock::Virtual, 0, |partition, notes, port| {
        let notes = notes.clone();
        partition.process("counts", Every::ms(20).priority(10), move |process| {
            let status = |process: &Process| {
                process.at_ports(|services, ports| services.get_queuing_port_status(ports, port))
            };
            let before = status(process)?;
            let mut first = Vec::new();
            let received = process.receive_queuing_message(port, 0, &mut first);
            let left = status(process)?.nb_message;
            process.at_ports(|services, ports| services.clear_queuing_port(ports, port))?;
            let cleared = status(process)?.nb_message;
            note(
                &notes,
                format!("{} of {} {received:?} {left} {cleared}", before.nb_message, before.max_nb_message),
            );
            process.periodic_wait()
        })?;
        Ok(())
    });
    windows(&kernel, 0..1);
    assert!(send(&source, b"one", 1) && send(&source, b"two", 2));
    windows(&kernel, 1..2);
    assert_eq!(*notes.lock().unwrap(), ["2 of 2 Ok(()) 1 0"]);
}

#[test]
fn prt_11_message_waits_at_its_source_until_the_other_partition_has_received() {
    let mut harness = Harness::new("sending").unwrap();
    let mut far: QueuingDestination<GroundMessage> = harness.queuing_source("out", 2).unwrap();
    let (kernel, notes) = partition_in(harness.context().unwrap(), Clock::Virtual, |partition, notes| {
        let port = partition.create_queuing_port("out", LONGEST, 2, SOURCE, 0_u32)?;
        let notes = notes.clone();
        partition.process("sends", Every::once(), move |process| {
            for letter in 1_u8..=4 {
                let message = GroundMessage { letter, ..GroundMessage::default() };
                let result = process.send_queuing_message(port, message.as_bytes(), 30 * MS);
                note(&notes, format!("{letter} {result:?} at {}", time(process)?));
            }
            let polled = process.send_queuing_message(port, &[1], 0);
            note(&notes, format!("{polled:?}"));
            Ok(())
        })?;
        Ok(())
    });
    windows(&kernel, 0..1);
    assert_eq!(far.receive().map(|message| message.letter), Some(1));
    windows(&kernel, 1..4);
    let expected =
        ["1 Ok(()) at 0", "2 Ok(()) at 0", "3 Ok(()) at 20", "4 Err(TimedOut) at 60", "Err(NotAvailable)"];
    assert_eq!(*notes.lock().unwrap(), expected);
    let left: Vec<u8> = std::iter::from_fn(|| far.receive()).map(|message| message.letter).collect();
    assert_eq!(left, [2, 3], "what timed out was not sent");
}

#[test]
fn prt_13_refused_send_counts_as_no_lost_message() {
    let mut harness = Harness::new("sending").unwrap();
    let far: QueuingDestination<GroundMessage> = harness.queuing_source("out", 1).unwrap();
    let (kernel, notes) = partition_in(harness.context().unwrap(), Clock::Virtual, |partition, notes| {
        let port = partition.create_queuing_port("out", LONGEST, 1, SOURCE, 0_u32)?;
        let notes = notes.clone();
        partition.process("sends", Every::ms(20), move |process| {
            loop {
                let sent = [(); 2].map(|()| process.send_queuing_message(port, b"x", 0));
                note(&notes, format!("{sent:?}"));
                process.periodic_wait()?;
            }
        })?;
        Ok(())
    });
    let reader = far.inlet.as_ref().unwrap().reader.get().unwrap();
    windows(&kernel, 0..1);
    for number in 1..4 {
        windows(&kernel, number..number + 1);
        let received = reader.receive().unwrap().unwrap();
        assert_eq!(received.stamp().sequence, number, "a gap would tell of a lost message");
    }
    assert_eq!(*notes.lock().unwrap(), ["[Ok(()), Err(NotAvailable)]"; 3]);
}

#[test]
fn que_clear_05_note_of_a_lost_message_is_dropped_with_the_messages() {
    let (kernel, notes, source, _harness) = receiving(Clock::Virtual, 0, |partition, notes, port| {
        let notes = notes.clone();
        partition.process("clears", Every::ms(20).priority(10), move |process| {
            let mut message = Vec::new();
            for clears in [false, true, false] {
                if clears {
                    process.at_ports(|services, ports| services.clear_queuing_port(ports, port))?;
                }
                let received = process.receive_queuing_message(port, 0, &mut message);
                note(&notes, format!("{received:?} {}", String::from_utf8_lossy(&message)));
                process.periodic_wait()?;
            }
            Ok(())
        })?;
        Ok(())
    });
    windows(&kernel, 0..1);
    assert!(send(&source, b"one", 1));
    windows(&kernel, 1..2);
    assert!(send(&source, b"three", 3));
    windows(&kernel, 2..3);
    assert!(send(&source, b"four", 4));
    windows(&kernel, 3..4);
    assert_eq!(*notes.lock().unwrap(), ["Ok(()) one", "Err(NotAvailable) ", "Ok(()) four"]);
}

#[test]
fn sampling_message_is_valid_up_to_its_refresh_period_and_the_sources_is_read_by_the_other_partition() {
    let mut harness = Harness::new("sampling").unwrap();
    let mut rate = harness.sampling_destination::<Rate>("rate", 25_000_000).unwrap();
    let mut again = harness.sampling_source::<Rate>("again").unwrap();
    let (kernel, notes) = partition_in(harness.context().unwrap(), Clock::Virtual, |partition, notes| {
        let bytes = size_of::<Rate>() as i32;
        let into = partition.create_sampling_port("rate", bytes, DESTINATION, 25 * MS)?;
        let out = partition.create_sampling_port("AGAIN", bytes, SOURCE, MS)?;
        let notes = notes.clone();
        partition.process("copies", Every::once().priority(10), move |process| {
            let mut message = Vec::new();
            loop {
                let validity = process.read_sampling_message(into, &mut message);
                let shown = process.call(|services| services.get_sampling_port_status(into))?;
                note(&notes, format!("{validity:?} at {}", time(process)?));
                if validity.is_ok() {
                    assert_eq!(Ok(shown.last_msg_validity), validity);
                    process.write_sampling_message(out, &message)?;
                }
                process.timed_wait(20 * MS)?;
            }
        })?;
        Ok(())
    });
    windows(&kernel, 0..1);
    rate.write(&Rate { synchronize: 7, ..Rate::default() }); // stamped with 0: the harness's time stands
    windows(&kernel, 1..3);
    let expected = ["Err(NoAction) at 0", &format!("Ok({:?}) at 20", Validity::Valid), "Ok(Invalid) at 40"];
    assert_eq!(*notes.lock().unwrap(), expected);
    assert_eq!(again.read().map(|reading| (reading.value.synchronize, reading.sequence)), Some((7, 2)));
}

#[test]
fn on_the_wall_clock_a_message_wakes_its_receiver_while_another_process_computes() {
    let (kernel, notes, source, _harness) = receiving(Clock::Wall, 0, |partition, notes, port| {
        receiver(partition, ("r", 20), (port, FOREVER), notes)?;
        partition.process("computes", Every::once().priority(10), |_| {
            loop {
                std::hint::spin_loop();
            }
        })?;
        Ok(())
    });
    let granting = kernel.clone();
    let sender = Arc::new(AtomicU32::new(0));
    let sent = sender.clone();
    // One window of a second: the message comes in its midst, from another thread.
    let notes_of_sender = notes.clone();
    std::thread::scope(|scope| {
        let begun = monotonic_ns();
        let channel = Far(source);
        scope.spawn(move || {
            std::thread::sleep(Duration::from_millis(200));
            let whole = channel;
            assert!(send(&whole.0, b"midst", 1));
            while notes_of_sender.lock().unwrap().is_empty() && monotonic_ns() - begun < 20_000_000_000 {
                std::thread::sleep(Duration::from_millis(1));
            }
            sent.store(1, Relaxed);
        });
        let now = granting.page.origin_ns.load(Relaxed);
        let start = monotonic_ns() - now;
        granting.window(start, start + 1_000_000_000);
    });
    let received = notes.lock().unwrap().first().cloned().unwrap_or_default();
    assert!(received.starts_with("r Ok(()) midst at"), "{received}");
    assert_eq!(sender.load(Relaxed), 1);
}

/// A source that one other thread uses alone.
struct Far(QueuingSource<GroundMessage>);

// SAFETY: the thread that makes it hands it over and keeps nothing of it.
#[allow(unsafe_code)]
unsafe impl Send for Far {}
