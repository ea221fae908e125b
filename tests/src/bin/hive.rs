//! A partition of processes, twenty or as many as its attribute `processes` says, that do at random what processes do: wait, send, signal, suspend, stop and start each other, panic. Its
//! error handler starts again what has faulted; now and then the partition starts itself again. Each says a digest of what it has seen.

use std::process::ExitCode;

use bateleur_apex::StartError;
use bateleur_apex::processes::standard::{BufferId, EventId, OperatingMode, ProcessId, SemaphoreId};
use bateleur_apex::processes::{Every, Initialisation, Process, ReturnCode, run_processes};

const MS: i64 = 1_000_000;

#[derive(Clone, Copy)]
struct Objects {
    /// How many processes share them.
    processes: u64,
    buffer: BufferId,
    semaphore: SemaphoreId,
    event: EventId,
}

/// Numbers that look random (splitmix64).
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (mixed ^ (mixed >> 31)) % limit
    }
}

/// One of the things that processes do; what came of it.
fn act(process: &Process, own: u64, random: &mut Random, objects: Objects, message: &mut Vec<u8>) -> String {
    let processes = objects.processes;
    let span = random.below(8) as i64 * MS / 2;
    let other = ProcessId(1 + random.below(processes) as i32);
    match random.below(12) {
        0 => format!("{:?}", process.timed_wait(span)),
        1 | 2 => {
            let bytes = vec![own as u8; 1 + random.below(16) as usize];
            format!("{:?}", process.wait(|services| services.send_buffer(objects.buffer, &bytes, span)))
        }
        3 | 4 => {
            let received = process
                .receive(message, |services, into| services.receive_buffer(objects.buffer, span, into));
            format!("{received:?} {message:?}")
        }
        5 => format!("{:?}", process.call(|services| services.signal_semaphore(objects.semaphore))),
        6 => format!("{:?}", process.wait(|services| services.wait_semaphore(objects.semaphore, span))),
        7 => format!("{:?}", process.call(|services| services.set_event(objects.event))),
        8 => format!("{:?}", process.call(|services| services.reset_event(objects.event))),
        9 => format!("{:?}", process.wait(|services| services.wait_event(objects.event, span))),
        10 => format!("{:?}", process.call(|services| services.stop(other))),
        _ => format!("{:?}", process.call(|services| services.start(other))),
    }
}

fn lives(process: &Process, own: u64, generation: u64, objects: Objects) -> Result<(), ReturnCode> {
    let mut random = Random(own << 32 | generation);
    let mut digest = 0_u64;
    let mut message = Vec::new();
    for step in 1_u64.. {
        let came = act(process, own, &mut random, objects, &mut message);
        let now_ns = process.now_ns()?;
        let seen = came.bytes().map(u64::from).chain([now_ns as u64]);
        digest = seen.fold(digest, |digest, value| (digest ^ value).wrapping_mul(0x0100_0000_01b3));
        if step % 25 == 0 {
            let text = format!("{own} step {step} at {now_ns}: {digest:016x}");
            process.call(|services| services.report_application_message(text.as_bytes())).ok();
        }
        assert!(random.below(60) > 0, "as it was told");
        if random.below(400) == 0 {
            process.call(|services| services.set_partition_mode(OperatingMode::WarmStart))?;
        }
    }
    Ok(())
}

fn initialise(partition: &mut Initialisation<'_>) -> Result<(), StartError> {
    let generation = u64::from(partition.context().generation());
    let processes = partition.context().attribute("processes", 20)?;
    let mut services = partition.services();
    let objects = Objects {
        processes,
        buffer: services.create_buffer("buffer", 16, 4, 0_u32)?,
        semaphore: services.create_semaphore("semaphore", 1, 3, 1_u32)?,
        event: services.create_event("event")?,
    };
    drop(services);
    for own in 1..=processes {
        let every = Every::once().priority(10 + (own as i32 * 7) % 12).stack(64 << 10);
        partition
            .process(&format!("bee {own}"), every, move |process| lives(process, own, generation, objects))?;
    }
    partition.error_handler(|process| {
        while let Ok(error) = process.call(|services| services.get_error_status()) {
            let id = error.failed_process_id;
            process.call(|services| services.stop(id)).ok();
            process.call(|services| services.start(id)).ok();
        }
        Ok(())
    })
}

fn main() -> ExitCode {
    run_processes(initialise)
}
