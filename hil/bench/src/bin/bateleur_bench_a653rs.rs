//! Two partitions written with the traits of `a653rs` that `bateleur bench` measures with. The name in the plan says which one this is:
//! `writes` measures WRITE_SAMPLING_MESSAGE, `reads` READ_SAMPLING_MESSAGE of what was written last.
//!
//! What they have found goes to standard error: a name and a value, ns. They must never be part of a flight.
#![allow(unsafe_code)] // the trait's functions that need a buffer which is large enough

use std::hint::black_box;
use std::str::FromStr;
use std::sync::atomic::{AtomicI64, Ordering::Relaxed};
use std::time::Instant;

use a653rs::bindings::{ApexSamplingPortP4, PortDirection};
use a653rs::prelude::*;
use a653rs_linux::partition::ApexLinuxPartition as Apex;

/// Bytes of a message.
const SIZE: usize = 64;
/// Calls that are timed together, and how often.
const BATCH: u32 = 200;
const BATCHES: usize = 500;
/// The port's identifier.
static PORT: AtomicI64 = AtomicI64::new(0);

fn main() {
    match Apex::get_partition_name().as_str() {
        "writes" => Measures { direction: PortDirection::Source, process: writes }.run(),
        "reads" => Measures { direction: PortDirection::Destination, process: reads }.run(),
        other => eprintln!("no partition {other}: writes or reads"),
    }
}

struct Measures {
    direction: PortDirection,
    process: extern "C" fn(),
}

impl Partition<Apex> for Measures {
    fn cold_start(&self, context: &mut StartContext<Apex>) {
        let begun = self.begin(context);
        begun.unwrap_or_else(|error| eprintln!("{error:?} while the partition starts"));
    }

    fn warm_start(&self, context: &mut StartContext<Apex>) {
        self.cold_start(context);
    }
}

impl Measures {
    fn begin(&self, context: &mut StartContext<Apex>) -> Result<(), Error> {
        let name = |name: &str| Name::from_str(name).map_err(|_| Error::InvalidParam);
        let refresh = 1_000_000_000; // ns
        let port = Apex::create_sampling_port(name("data")?.into(), SIZE as u32, self.direction, refresh);
        PORT.store(port.map_err(Error::from)?, Relaxed);
        let process = context.create_process(ProcessAttribute {
            period: SystemTime::Normal(std::time::Duration::ZERO), // the partition's
            time_capacity: SystemTime::Infinite,
            entry_point: self.process,
            stack_size: 256 << 10,
            base_priority: 1,
            deadline: Deadline::Soft,
            name: name("measures")?,
        })?;
        process.start()
    }
}

fn median(mut samples: Vec<f64>) -> f64 {
    samples.sort_by(f64::total_cmp);
    samples.get(samples.len() / 2).copied().unwrap_or_default()
}

/// Median cost of a call, ns: batches that a window's end lies in are outliers.
fn cost(mut call: impl FnMut(u32)) -> f64 {
    let batches = (0..BATCHES).map(|_| {
        let begun = Instant::now();
        (0..BATCH).for_each(&mut call);
        begun.elapsed().as_nanos() as f64 / f64::from(BATCH)
    });
    median(batches.collect())
}

extern "C" fn writes() {
    let write = |number| {
        let written = Apex::write_sampling_message(PORT.load(Relaxed), &[number as u8; SIZE]);
        assert!(written.is_ok(), "{written:?}");
    };
    eprintln!("write {}", cost(write));
}

extern "C" fn reads() {
    let mut message = [0; SIZE];
    // SAFETY: the port's messages are as long as the buffer.
    let mut read = || unsafe { Apex::read_sampling_message(PORT.load(Relaxed), &mut message) };
    while read().is_err() {
        let _ = Apex::periodic_wait();
    }
    let again = |_| assert!(black_box(read()).is_ok());
    eprintln!("read {}", cost(again));
}
