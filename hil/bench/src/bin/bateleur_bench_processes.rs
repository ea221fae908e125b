//! The partition of several processes that `bateleur bench` measures with. What it measures says its attribute `measures`:
//!
//! - `services`: what services cost that let nobody else run, beside an uncontended mutex of the C library;
//! - `switch`: a ring of `processes` processes in which each wakes the next one and waits;
//! - `handover`: what futexes of a ring of threads cost here that know nothing of processes;
//! - `release`: how late a process runs that waits for an instant while another one computes.
//!
//! What it has found goes to standard error, a line for each figure: its name and its value, ns. It must never be part of a flight.
#![allow(unsafe_code)] // a mutex of the C library

use std::hint::black_box;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use bateleur_apex::StartError;
use bateleur_apex::processes::{Every, Initialisation, Process, ReturnCode, run_processes};
use rustix::time::{ClockId, clock_gettime};

#[path = "../turns.rs"]
mod turns;
use turns::Ring;

/// Calls, or rounds of the ring, that are timed together.
const BATCH: u32 = 200;
/// How long a process waits for its release, ns.
const WAIT_NS: i64 = 1_000_000;
/// Bytes of a thread's stack, of which there may be many.
const STACK: usize = 64 << 10;
/// Bytes on the blackboard.
const MESSAGE: usize = 64;

fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64 // never negative
}

/// The value below which this share of the samples lies.
fn quantile(samples: &mut [f64], share: f64) -> f64 {
    samples.sort_by(f64::total_cmp);
    let place = (samples.len() as f64 * share) as usize;
    samples.get(place.min(samples.len().saturating_sub(1))).copied().unwrap_or_default()
}

/// Median cost of a call, ns: batches that a window's end lies in are outliers.
fn cost(batches: u32, mut call: impl FnMut() -> Result<(), ReturnCode>) -> Result<f64, ReturnCode> {
    let mut samples = Vec::new();
    for _ in 0..batches {
        let begun = monotonic_ns();
        for _ in 0..BATCH {
            call()?;
        }
        samples.push((monotonic_ns() - begun) as f64 / f64::from(BATCH));
    }
    Ok(quantile(&mut samples, 0.5))
}

/// A mutex of the C library that nobody else wants.
fn mutex_ns(batches: u32) -> Result<f64, ReturnCode> {
    let mut mutex = libc::PTHREAD_MUTEX_INITIALIZER;
    cost(batches, || {
        // SAFETY: an initialised mutex of this thread alone.
        unsafe {
            libc::pthread_mutex_lock(black_box(&raw mut mutex));
            libc::pthread_mutex_unlock(black_box(&raw mut mutex));
        }
        Ok(())
    })
}

fn services(partition: &mut Initialisation<'_>, batches: u32) -> Result<(), StartError> {
    let mut services = partition.services();
    let event = services.create_event("event")?;
    let semaphore = services.create_semaphore("semaphore", 0, 32_767, 0_u32)?;
    let blackboard = services.create_blackboard("blackboard", MESSAGE as i32)?;
    drop(services);
    partition.process("measures", Every::once(), move |process| {
        let reference = mutex_ns(batches)?;
        let time = cost(batches, || process.now_ns().map(|now| assert!(black_box(now) >= 0)))?;
        let event = cost(batches, || process.set_event(event))?;
        let signal = cost(batches.min(100), || process.signal_semaphore(semaphore))?;
        let display =
            cost(batches, || process.display_blackboard(blackboard, &[7; MESSAGE]))?;
        eprintln!("mutex {reference}\nGET_TIME {time}\nSET_EVENT {event}\nSIGNAL_SEMAPHORE {signal}\nDISPLAY_BLACKBOARD {display}");
        Ok(())
    })?;
    Ok(())
}

fn ring(partition: &mut Initialisation<'_>, processes: u32, batches: u32) -> Result<(), StartError> {
    let turns = (0..processes).map(|number| {
        let first = i32::from(number == 0);
        Ok(partition.services().create_semaphore(&format!("turn {number}"), first, 1, 0_u32)?)
    });
    let turns: Vec<_> = turns.collect::<Result<_, StartError>>()?;
    let ends = Arc::new(AtomicBool::new(false));
    for number in 0..processes as usize {
        let (own, next) = (turns[number], turns[(number + 1) % turns.len()]);
        let ends = ends.clone();
        let hand_on = move |process: &Process| {
            process.wait(|services| services.wait_semaphore(own, -1))?;
            process.signal_semaphore(next)
        };
        let body = move |process: &Process| {
            if number == 0 {
                let round = cost(batches, || hand_on(process))?;
                eprintln!("switch {}", round / f64::from(processes));
                ends.store(true, Relaxed);
            }
            while !ends.load(Relaxed) {
                hand_on(process)?;
            }
            Ok(())
        };
        partition.process(&format!("member {number}"), Every::once().stack(STACK as u32), body)?;
    }
    Ok(())
}

/// A futex wake and the switch to the woken thread, in this partition's groups and behind its filter of system calls.
fn handover(partition: &mut Initialisation<'_>, threads: u32, batches: u32) -> Result<(), StartError> {
    partition.process("measures", Every::once(), move |_| {
        let ring = Ring::new(threads);
        let round = std::thread::scope(|scope| {
            for own in 1..threads as usize {
                let ring = &ring;
                let thread = std::thread::Builder::new().stack_size(STACK);
                let made = thread.spawn_scoped(scope, move || ring.take_turns(own, batches * BATCH));
                made.map_err(|_| ReturnCode::InvalidConfig)?;
            }
            // Each call is a round: from this thread to all others and back.
            cost(batches, || {
                ring.take_turn(0);
                Ok(())
            })
        })?;
        eprintln!("handover {}", round / f64::from(threads));
        Ok(())
    })?;
    Ok(())
}

/// `window_ns`: where in each frame of `frame_ns` a wait may begin that ends in the same window.
fn release(
    partition: &mut Initialisation<'_>,
    samples: u32,
    frame_ns: i64,
    window_ns: std::ops::Range<i64>,
) -> Result<(), StartError> {
    partition.process("urgent", Every::once().priority(20), move |process| {
        let mut late = Vec::new();
        while late.len() < samples as usize {
            let due_ns = process.now_ns()? + WAIT_NS;
            let result = process.timed_wait(WAIT_NS);
            let late_ns = process.now_ns()? - due_ns;
            result?;
            if window_ns.contains(&((due_ns - WAIT_NS) % frame_ns)) {
                late.push(late_ns as f64);
            }
        }
        eprintln!("p50 {}\np999 {}", quantile(&mut late, 0.5), quantile(&mut late, 0.999));
        Ok(())
    })?;
    partition.process("computes", Every::once().priority(10), |_| {
        loop {
            std::hint::spin_loop();
        }
    })?;
    Ok(())
}

fn initialise(partition: &mut Initialisation<'_>) -> Result<(), StartError> {
    let context = partition.context();
    let measures: String = context.attribute("measures", "services".into())?;
    let processes: u32 = context.attribute("processes", 4)?;
    let samples: u32 = context.attribute("samples", 100)?;
    let frame_ns = context.duration_ns("frame", 20_000_000)? as i64;
    let from_ns = context.duration_ns("from", 0)? as i64;
    let to_ns = context.duration_ns("to", 0)? as i64;
    match measures.as_str() {
        "services" => services(partition, samples),
        "switch" => ring(partition, processes, samples),
        "handover" => handover(partition, processes, samples),
        "release" => release(partition, samples, frame_ns, from_ns..to_ns),
        other => {
            Err(StartError::Other(format!("measures = \"{other}\": services, switch, handover or release")))
        }
    }
}

fn main() -> ExitCode {
    run_processes(initialise)
}
