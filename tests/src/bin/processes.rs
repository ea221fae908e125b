//! A partition of several processes: `fast` is released every 20 ms and gives its number to `slow`, which computes or waits between; an
//! error handler starts `fails` again. What they do is reported.

use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use bateleur_apex::StartError;
use bateleur_apex::processes::standard::{INFINITE_TIME_VALUE, OperatingMode};
use bateleur_apex::processes::{Every, Initialisation, Process, run_processes};

/// Little, so that it is soon known how much of it was used.
const STACK: u32 = 64 << 10;

fn report(process: &Process, text: &str) {
    let _ = process.call(|services| services.report_application_message(text.as_bytes())); // at most 128 bytes
}

fn initialise(partition: &mut Initialisation<'_>) -> Result<(), StartError> {
    let computes: bool = partition.context().attribute("computes", false)?;
    let fails: bool = partition.context().attribute("fails", false)?;
    if partition.context().attribute("tells", false)? {
        let status = partition.services().get_partition_status();
        let (period, duration) = (status.period / 1000, status.duration / 1000);
        let text = format!("number {}, {duration} us in each {period} us", status.identifier);
        partition.services().report_application_message(text.as_bytes())?;
    }
    let again: String = partition.context().attribute("again", String::new())?;
    let buffer = partition.services().create_buffer("numbers", 4, 4, 0_u32)?;
    partition.process("fast", Every::ms(20).priority(20).stack(STACK), move |process| {
        for number in 0_u32.. {
            process.wait(|services| services.send_buffer(buffer, &number.to_le_bytes(), 0))?;
            if number % 10 == 0 {
                let now_ns = process.now_ns()?;
                report(process, &format!("fast {number} at {now_ns}"));
            }
            process.periodic_wait()?;
        }
        Ok(())
    })?;
    partition.process("slow", Every::once().priority(10).stack(STACK), move |process| {
        let mut message = Vec::new();
        loop {
            process.receive(&mut message, |services, into| {
                services.receive_buffer(buffer, INFINITE_TIME_VALUE, into)
            })?;
            let number = message.as_slice().try_into().map_or(0, u32::from_le_bytes);
            if number % 25 == 0 {
                report(process, &format!("slow has {number}"));
            }
        }
    })?;
    let many: u32 = partition.context().attribute("many", u32::from(computes))?;
    for number in 0..many {
        partition.process(&format!("computes {number}"), Every::once().priority(1).stack(STACK), |_| {
            loop {
                std::hint::spin_loop();
            }
        })?;
    }
    if fails {
        failing(partition)?;
    }
    if !again.is_empty() {
        let mode = match again.as_str() {
            "warm" => OperatingMode::WarmStart,
            "idle" => OperatingMode::Idle,
            _ => OperatingMode::ColdStart,
        };
        let times = if again == "without end" { u32::MAX } else { 8 };
        starting_again(partition, mode, times)?;
    }
    Ok(())
}

/// A process that says how its partition was started, and starts it again so many times.
fn starting_again(
    partition: &mut Initialisation<'_>,
    mode: OperatingMode,
    times: u32,
) -> Result<(), StartError> {
    let generation = partition.context().generation();
    partition.process("again", Every::once().priority(40), move |process| {
        let status = process.call(|services| Ok(services.get_partition_status()))?;
        report(process, &format!("generation {generation}: {:?}", status.start_condition));
        if generation < times {
            process.call(|services| services.set_partition_mode(mode))?;
        }
        Ok(())
    })?;
    Ok(())
}

/// A process that panics in its first life, and the handler that starts it again.
fn failing(partition: &mut Initialisation<'_>) -> Result<(), StartError> {
    let lives = Arc::new(AtomicU32::new(0));
    let id = partition.process("fails", Every::once().priority(30).stack(STACK), move |process| {
        let life = lives.fetch_add(1, Relaxed);
        report(process, &format!("life {life}"));
        assert!(life > 0, "as it was told");
        Ok(())
    })?;
    partition.error_handler(move |process| {
        while let Ok(error) = process.call(|services| services.get_error_status()) {
            report(process, &format!("{:?} of process {}", error.error_code, error.failed_process_id.0));
            process.call(|services| services.stop(id))?;
            process.call(|services| services.start(id))?;
        }
        Ok(())
    })
}

fn main() -> ExitCode {
    run_processes(initialise)
}
