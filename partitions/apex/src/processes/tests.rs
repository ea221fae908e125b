//! Processes on both clocks, without an executive: the test grants windows.

use std::sync::atomic::{AtomicU32, Ordering::Relaxed};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use bateleur_contract::{Clock, ControlPage, Mapped, StartCondition};
use bateleur_processes::ReturnCode;
use bateleur_processes::standard::{ErrorCode, INFINITE_TIME_VALUE as FOREVER, ProcessId};

use super::initialisation::{Every, Initialisation, complete};
use super::kernel::Kernel;
use super::process::Process;
use super::run::{kernel, settings};
use crate::context::{Context, StartError};
use crate::harness::Harness;
use crate::time::monotonic_ns;

mod lending;
mod ports;

const MS: i64 = 1_000_000;

/// What processes note, in order.
type Notes = Arc<Mutex<Vec<String>>>;

fn note(notes: &Notes, text: impl Into<String>) {
    notes.lock().unwrap().push(text.into());
}

/// A partition of 20 ms whose processes note what they do.
fn partition(
    clock: Clock,
    initialise: impl FnOnce(&mut Initialisation<'_>, &Notes) -> Result<(), StartError>,
) -> (Arc<Kernel>, Notes) {
    let context = Harness::new("processes").unwrap().context().unwrap();
    partition_in(context, clock, initialise)
}

/// As above, with what the plan gives it.
fn partition_in(
    mut context: Context,
    clock: Clock,
    initialise: impl FnOnce(&mut Initialisation<'_>, &Notes) -> Result<(), StartError>,
) -> (Arc<Kernel>, Notes) {
    let page = rustix::fs::memfd_create("page", rustix::fs::MemfdFlags::CLOEXEC).unwrap();
    rustix::fs::ftruncate(&page, 4096).unwrap();
    let page = Mapped::<ControlPage>::new(page).unwrap();
    page.initialise();
    if clock == Clock::Wall {
        page.origin_ns.store(monotonic_ns(), Relaxed);
    }
    let settings = settings(StartCondition::NormalStart, &crate::harness::PROCESSES, &[]);
    let kernel = kernel(page, clock, settings, None);
    let notes = Notes::default();
    initialise(&mut Initialisation { context: &mut context, kernel: &kernel }, &notes).unwrap();
    complete(&mut kernel.lock()).unwrap();
    (kernel, notes)
}

/// Windows of 5 ms at the start of so many periods.
fn windows(kernel: &Arc<Kernel>, periods: std::ops::Range<u64>) {
    for period in periods {
        kernel.window(period * 20_000_000, period * 20_000_000 + 5_000_000);
    }
}

fn time(process: &Process) -> Result<i64, ReturnCode> {
    Ok(process.now_ns()? / MS)
}

#[test]
fn urgent_process_preempts_at_its_release_and_the_other_goes_on_in_the_next_window() {
    let (kernel, notes) = partition(Clock::Virtual, |partition, notes| {
        let (fast, slow) = (notes.clone(), notes.clone());
        partition.process("fast", Every::ms(20).priority(20), move |process| {
            loop {
                note(&fast, format!("fast {}", time(process)?));
                process.periodic_wait()?;
            }
        })?;
        partition.process("slow", Every::once().priority(10), move |process| {
            for step in 0.. {
                note(&slow, format!("slow {step} at {}", time(process)?));
                process.timed_wait(2 * MS)?;
            }
            Ok(())
        })?;
        Ok(())
    });
    windows(&kernel, 0..3);
    let expected = [
        "slow 0 at 0",
        "slow 1 at 2",
        "slow 2 at 4",
        "fast 20",
        "slow 3 at 20",
        "slow 4 at 22",
        "slow 5 at 24",
        "fast 40",
        "slow 6 at 40",
        "slow 7 at 42",
        "slow 8 at 44",
    ];
    assert_eq!(*notes.lock().unwrap(), expected);
}

#[test]
fn process_that_only_polls_comes_to_its_windows_end() {
    let (kernel, notes) = partition(Clock::Virtual, |partition, notes| {
        let event = partition.services().create_event("never")?;
        let notes = notes.clone();
        partition.process("poll", Every::once(), move |process| {
            let mut polls = 0;
            while process.wait(|services| services.wait_event(event, 0)) == Err(ReturnCode::NotAvailable) {
                polls += 1;
                if polls == 7_500 {
                    note(&notes, format!("at {}", time(process)?));
                }
            }
            Ok(())
        })?;
        Ok(())
    });
    windows(&kernel, 0..2);
    assert_eq!(
        *notes.lock().unwrap(),
        ["at 22"],
        "5000 calls of 1 us in the first window, the rest in the second"
    );
}

#[test]
fn message_of_a_buffer_reaches_the_process_that_waits_for_it() {
    let (kernel, notes) = partition(Clock::Virtual, |partition, notes| {
        let buffer = partition.services().create_buffer("b", 8, 2, 0_u32)?;
        let notes = notes.clone();
        partition.process("reader", Every::once().priority(20), move |process| {
            let mut message = Vec::new();
            for _ in 0..2 {
                process
                    .receive(&mut message, |services, into| services.receive_buffer(buffer, FOREVER, into))?;
                note(&notes, String::from_utf8_lossy(&message));
            }
            let late =
                process.receive(&mut message, |services, into| services.receive_buffer(buffer, MS, into));
            note(&notes, format!("{late:?} {message:?}"));
            Ok(())
        })?;
        partition.process("writer", Every::once().priority(10), move |process| {
            for message in [b"one", b"two"] {
                process.wait(|services| services.send_buffer(buffer, message, FOREVER))?;
            }
            Ok(())
        })?;
        Ok(())
    });
    windows(&kernel, 0..1);
    assert_eq!(*notes.lock().unwrap(), ["one", "two", "Err(TimedOut) []"]);
}

/// Notes when it is dropped.
struct Held(Notes);

impl Drop for Held {
    fn drop(&mut self) {
        note(&self.0, "dropped");
    }
}

#[test]
fn stopped_process_begins_again_at_its_entry_point_and_what_it_held_is_dropped() {
    let (kernel, notes) = partition(Clock::Virtual, |partition, notes| {
        let (one, two) = (notes.clone(), notes.clone());
        let victim = partition.process("victim", Every::once().priority(20), move |process| {
            note(&one, "begins");
            let _held = Held(one.clone());
            process.timed_wait(100 * MS)
        })?;
        partition.process("other", Every::once().priority(10), move |process| {
            process.call(|services| services.stop(victim))?;
            note(&two, "stopped");
            process.call(|services| services.start(victim))?;
            note(&two, "started");
            Ok(())
        })?;
        Ok(())
    });
    windows(&kernel, 0..1);
    assert_eq!(*notes.lock().unwrap(), ["begins", "stopped", "dropped", "begins", "started"]);
}

/// A process that fails as `fails` does, and an error handler that notes the error and starts it again once.
fn failing(fails: impl Fn(&Process) -> Result<(), ReturnCode> + Send + Sync + 'static) -> Vec<String> {
    let (kernel, notes) = partition(Clock::Virtual, |partition, notes| {
        let (own, handler) = (notes.clone(), notes.clone());
        let id = partition.process("fails", Every::once().priority(20), move |process| {
            note(&own, "begins");
            fails(process)?;
            note(&own, "ends");
            Ok(())
        })?;
        partition.error_handler(move |process| {
            while let Ok(error) = process.call(|services| services.get_error_status()) {
                note(&handler, format!("{:?} of {}", error.error_code, error.failed_process_id.0));
                if handler.lock().unwrap().len() < 4 {
                    process.call(|services| services.stop(id)).ok();
                    process.call(|services| services.start(id))?;
                }
            }
            Ok(())
        })
    });
    windows(&kernel, 0..1);
    notes.lock().unwrap().to_vec()
}

#[test]
#[allow(unconditional_panic, arithmetic_overflow)] // it is the fault
fn panic_is_a_fault_of_its_process_alone() {
    let zero = std::hint::black_box(0_u32);
    let divides = failing(move |_| {
        std::hint::black_box(1 / zero);
        Ok(())
    });
    assert_eq!(divides, ["begins", "NumericError of 1", "begins", "NumericError of 1"]);
    let panics = failing(|_| panic!("as the test wants it"));
    assert_eq!(panics[1], "IllegalRequest of 1");
}

#[test]
fn memory_violation_and_trap_are_faults_of_their_process_alone() {
    crate::signals::install();
    let writes = failing(|_| {
        crate::faults::write_byte(std::hint::black_box(8), 1);
        Ok(())
    });
    assert_eq!(writes, ["begins", "MemoryViolation of 1", "begins", "MemoryViolation of 1"]);
    let overflows = failing(|_| {
        std::hint::black_box(crate::faults::recurse(std::hint::black_box(1)));
        Ok(())
    });
    assert_eq!(overflows[1], "StackOverflow of 1");
    let traps = failing(|_| {
        crate::faults::illegal_instruction();
        Ok(())
    });
    assert_eq!(traps[1], "IllegalRequest of 1");
}

#[test]
fn lk_02_preemption_lock_does_not_delay_the_end_of_a_window() {
    let (kernel, notes) = partition(Clock::Virtual, |partition, notes| {
        let (own, other) = (notes.clone(), notes.clone());
        partition.process("locks", Every::once().priority(10), move |process| {
            let _ = process.call(|services| services.lock_preemption())?; // nobody else has it
            for _ in 0..6_000 {
                process.now_ns()?;
            }
            note(&own, format!("unlocks at {}", time(process)?));
            process.call(|services| services.unlock_preemption())?;
            note(&own, "goes on");
            Ok(())
        })?;
        partition.process("urgent", Every::ms(20).priority(20), move |process| {
            note(&other, format!("urgent at {}", time(process)?));
            process.periodic_wait()
        })?;
        Ok(())
    });
    windows(&kernel, 0..1);
    assert!(notes.lock().unwrap().is_empty(), "the window is over");
    windows(&kernel, 1..2);
    assert_eq!(*notes.lock().unwrap(), ["unlocks at 21", "urgent at 21", "goes on"]);
}

#[test]
fn bug_31_window_changes_while_a_process_holds_the_lock() {
    let (kernel, notes) = partition(Clock::Virtual, |partition, notes| {
        let notes = notes.clone();
        partition.process("locks", Every::once(), move |process| {
            let _ = process.call(|services| services.lock_preemption())?; // nobody else has it
            while time(process)? < 42 {}
            note(&notes, "third window");
            Ok(())
        })?;
        Ok(())
    });
    windows(&kernel, 0..2);
    assert!(notes.lock().unwrap().is_empty());
    windows(&kernel, 2..3);
    assert_eq!(*notes.lock().unwrap(), ["third window"]);
}

#[test]
fn error_that_a_process_returns_or_raises_is_the_handlers() {
    let returned = failing(|process| process.periodic_wait());
    assert_eq!(returned, ["begins", "ApplicationError of 1", "begins", "ApplicationError of 1"]);
    let raised = failing(|process| {
        process.call(|services| services.raise_application_error(ErrorCode::ApplicationError, b"x"))
    });
    assert_eq!(raised[..3], ["begins", "ApplicationError of 1", "begins"]);
}

#[test]
fn service_within_a_service_is_refused() {
    let (kernel, notes) = partition(Clock::Virtual, |partition, notes| {
        let port = partition.port(7_u32);
        let notes = notes.clone();
        partition.process("nested", Every::once(), move |process| {
            let inner = process.with(&port, |value| (*value, process.now_ns()))?;
            note(&notes, format!("{inner:?}"));
            Ok(())
        })?;
        Ok(())
    });
    windows(&kernel, 0..1);
    assert_eq!(*notes.lock().unwrap(), ["(7, Err(InvalidMode))"]);
}

#[test]
fn process_without_a_thread_is_refused_before_normal() {
    let attempt = std::panic::catch_unwind(|| {
        partition(Clock::Virtual, |partition, _| {
            let attributes = bateleur_processes::standard::ProcessAttributes {
                name: bateleur_processes::standard::Name::new("bare").unwrap(),
                entry_point: 0,
                stack_size: 1 << 16,
                base_priority: 1,
                period: FOREVER,
                time_capacity: FOREVER,
                deadline: bateleur_processes::standard::Deadline::Soft,
            };
            let bare: ProcessId = partition.services().create_process(&attributes)?;
            partition.services().start(bare)?;
            Ok(())
        })
    });
    assert!(attempt.is_err());
}

#[test]
fn on_the_wall_clock_a_process_is_released_several_times_in_a_window_while_another_one_computes() {
    let turns = Arc::new(AtomicU32::new(0));
    let own = turns.clone();
    let (kernel, _) = partition(Clock::Wall, |partition, _| {
        partition.process("urgent", Every::once().priority(20), move |process| {
            loop {
                process.timed_wait(2 * MS)?;
                own.fetch_add(1, Relaxed);
            }
        })?;
        partition.process("computes", Every::once().priority(10), |_| {
            loop {
                std::hint::spin_loop();
            }
        })?;
        Ok(())
    });
    kernel.window(0, 1_000_000_000);
    assert!(turns.load(Relaxed) > 20, "{} turns in a second", turns.load(Relaxed));
}

/// Grants windows of 50 ms, one after the other, until `enough`.
fn windows_until(kernel: &Arc<Kernel>, enough: impl Fn() -> bool) {
    let begun = Instant::now();
    let mut end_ns = 50_000_000;
    while !enough() {
        assert!(begun.elapsed() < Duration::from_secs(60), "nothing happens");
        kernel.window(end_ns - 50_000_000, end_ns);
        end_ns += 50_000_000;
    }
}

#[test]
fn on_the_wall_clock_a_process_that_computes_is_preempted_and_gives_the_window_back() {
    let turns = Arc::new(AtomicU32::new(0));
    let own = turns.clone();
    let (kernel, _) = partition(Clock::Wall, |partition, _| {
        partition.process("urgent", Every::once().priority(20), move |process| {
            loop {
                process.timed_wait(2 * MS)?;
                own.fetch_add(1, Relaxed);
            }
        })?;
        // It takes and gives memory, whose lock it must not be stopped with.
        partition.process("computes", Every::once().priority(10), |_| {
            loop {
                std::hint::black_box(vec![0_u8; 100_000]);
            }
        })?;
        Ok(())
    });
    windows_until(&kernel, || turns.load(Relaxed) >= 50);
}

#[test]
fn on_the_wall_clock_a_process_that_computes_for_ever_is_stopped_and_begins_again() {
    let [begins, misses] = [(); 2].map(|()| Arc::new(AtomicU32::new(0)));
    let (begun, missed) = (begins.clone(), misses.clone());
    let (kernel, _) = partition(Clock::Wall, |partition, _| {
        let id = partition.process("computes", Every::once().priority(20).deadline_ms(5), move |_| {
            begun.fetch_add(1, Relaxed);
            loop {
                std::hint::black_box(vec![0_u8; 100_000]);
            }
        })?;
        partition.error_handler(move |process| {
            while let Ok(error) = process.call(|services| services.get_error_status()) {
                assert_eq!(error.error_code, ErrorCode::DeadlineMissed);
                missed.fetch_add(1, Relaxed);
                process.call(|services| services.stop(id))?;
                process.call(|services| services.start(id))?;
            }
            Ok(())
        })
    });
    windows_until(&kernel, || misses.load(Relaxed) >= 5 && begins.load(Relaxed) >= 5);
}

#[test]
fn handler_that_is_enabled_serves_errors_while_the_partition_starts() {
    for clock in [Clock::Virtual, Clock::Wall] {
        let (kernel, notes) = partition(clock, |partition, notes| {
            let handler = notes.clone();
            partition.error_handler(move |process| {
                while let Ok(error) = process.call(|services| services.get_error_status()) {
                    note(&handler, String::from_utf8_lossy(error.message.as_bytes()));
                    let normal = process.call(|services| services.set_partition_mode(3_u32));
                    note(&handler, format!("{normal:?}"));
                }
                Ok(())
            })?;
            partition.services().enable_error_handler()?;
            for text in ["first", "second"] {
                partition.services().raise_application_error(ErrorCode::ApplicationError, text.as_bytes())?;
                note(notes, format!("after the {text}"));
            }
            let process = notes.clone();
            partition.process("a", Every::once(), move |_| {
                note(&process, "a");
                Ok(())
            })?;
            Ok(())
        });
        let expected = [
            "first",
            "Err(InvalidMode)",
            "after the first",
            "second",
            "Err(InvalidMode)",
            "after the second",
            "a",
        ];
        // On the wall clock a window may have passed before it is granted here.
        for _ in 0..100 {
            let start_ns = match clock {
                Clock::Virtual => 0,
                Clock::Wall => monotonic_ns() - kernel.page.origin_ns.load(Relaxed),
            };
            kernel.window(start_ns, start_ns + 5_000_000);
            if notes.lock().unwrap().len() >= expected.len() {
                break;
            }
        }
        assert_eq!(*notes.lock().unwrap(), expected, "{clock:?}");
    }
}
