//! A partition of several processes that sends numbered messages of many lengths through a queue and writes a sampling port, or receives and
//! reads them at the other ends, as the attribute `sends` says. What it finds is reported.

use std::process::ExitCode;

use bateleur_apex::StartError;
use bateleur_apex::processes::standard::{PortDirection, Validity};
use bateleur_apex::processes::{Every, Initialisation, Process, run_processes};
use bateleur_messages::FunctionStatus;

const MS: i64 = 1_000_000;
/// Bytes of the longest message in the queue, and messages in it.
const LONGEST: i32 = 64;
const DEPTH: i32 = 2;
const STATUS: i32 = size_of::<FunctionStatus>() as i32;

fn report(process: &Process, text: &str) {
    let _ = process.call(|services| services.report_application_message(text.as_bytes())); // at most 128 bytes
}

/// Message number `number`: between 1 and 64 bytes, all the same.
fn message(number: u32) -> Vec<u8> {
    vec![number as u8; 1 + number as usize % LONGEST as usize]
}

fn sends(partition: &mut Initialisation<'_>) -> Result<(), StartError> {
    let source = PortDirection::Source;
    let queue = partition.create_queuing_port("out", LONGEST, DEPTH, source, 0_u32)?;
    let status = partition.create_sampling_port("told", STATUS, source, MS)?;
    partition.process("sends", Every::once().priority(10), move |process| {
        for number in 0.. {
            // The receiver takes what there is once in 20 ms: the third message waits.
            process.send_queuing_message(queue, &message(number), 100 * MS)?;
            if number == 11 {
                let full = process.send_queuing_message(queue, &message(number), 0);
                report(process, &format!("full: {full:?}"));
            }
        }
        Ok(())
    })?;
    partition.process("writes", Every::ms(20).priority(20), move |process| {
        loop {
            process.write_sampling_message(status, &[7; STATUS as usize])?;
            process.periodic_wait()?;
        }
    })?;
    Ok(())
}

fn receives(partition: &mut Initialisation<'_>) -> Result<(), StartError> {
    let destination = PortDirection::Destination;
    let queue = partition.create_queuing_port("in", LONGEST, DEPTH, destination, 1_u32)?;
    let silent = partition.create_queuing_port("silent", LONGEST, DEPTH, destination, 0_u32)?;
    let status = partition.create_sampling_port("heard", STATUS, destination, 100 * MS)?;
    partition.process("receives", Every::once().priority(10), move |process| {
        let mut received = Vec::new();
        for number in 0.. {
            process.receive_queuing_message(queue, -1, &mut received)?;
            if received != message(number) {
                report(process, &format!("message {number} is {received:?}"));
            }
            if number % 50 == 49 {
                let now_ns = process.now_ns()?;
                report(process, &format!("{} messages at {now_ns}", number + 1));
            }
        }
        Ok(())
    })?;
    partition.process("awaits", Every::once().priority(20), move |process| {
        let mut received = Vec::new();
        for times in 1.. {
            let begun_ns = process.now_ns()?;
            let result = process.receive_queuing_message(silent, 30 * MS, &mut received);
            let waited_ns = process.now_ns()? - begun_ns;
            let validity = process.read_sampling_message(status, &mut received);
            if times % 20 == 0 {
                let early = if waited_ns < 30 * MS { ", too early" } else { "" };
                let heard = validity == Ok(Validity::Valid) && received == [7; STATUS as usize];
                report(process, &format!("{times}. {result:?}{early}, heard {heard}"));
            }
        }
        Ok(())
    })?;
    Ok(())
}

fn initialise(partition: &mut Initialisation<'_>) -> Result<(), StartError> {
    if partition.context().attribute("sends", false)? { sends(partition) } else { receives(partition) }
}

fn main() -> ExitCode {
    run_processes(initialise)
}
