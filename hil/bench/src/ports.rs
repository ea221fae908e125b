//! Figures of sampling ports beside the library below them: the same settings, the same core, batches taken in turn.
#![allow(unsafe_code)] // memory that the compiler takes for unwritten

use std::rc::Rc;

use anyhow::{Context, Result, anyhow};
use bateleur_apex::{SamplingDestination, SamplingSource, Time};
use bateleur_contract::{Clock, ControlPage, Mapped};
use bateleur_messages::{Field, Message};
use bateleur_ports::{Channel, ChannelType, Domain, Handed};
use bateleur_system::time::now_ns;
use iceoryx2::port::publisher::Publisher;
use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use super::Settings;
use super::probe;
use super::row::{Reach, Row};
use super::statistics::median;

/// Messages in a batch; the batches of the ports and of the library take turns.
const BATCH: u32 = 500;

/// A message of `N` bytes.
#[derive(Debug, Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(transparent)]
pub(super) struct Block<const N: usize>(pub(super) [u8; N]);

impl<const N: usize> Message for Block<N> {
    const NAME: &'static str = "Block";
    const FIELDS: &'static [Field] = &[];
}

/// What one message costs, ns.
#[derive(Debug, Clone, Copy, Default)]
struct Cost {
    write: f64,
    copy: f64,
    read: f64,
    again: f64,
    sealed_write: f64,
    sealed_read: f64,
    raw_write: f64,
    raw_read: f64,
}

/// Writing and reading, 64 B to 64 KiB.
pub(super) fn rows(settings: &Settings) -> Result<Vec<Row>> {
    let batches = if settings.quick { 20 } else { 100 * settings.runs };
    let core = settings.core;
    let costs = probe::on_core(core, probe::PARTITION, move || {
        let costs = [
            (64, measure::<64>(batches)?),
            (1024, measure::<1024>(batches)?),
            (8192, measure::<8192>(batches)?),
            (65536, measure::<65536>(batches)?),
        ];
        anyhow::Ok(costs)
    })??;
    let raw = RAW;
    let mut rows = Vec::new();
    for (bytes, cost) in costs {
        let name = |what: &str| format!("sampling port, {what}, {bytes} B");
        let within = Reach::Times(1.2);
        rows.push(Row::measured(name("write in place"), "ns", cost.write, Some(cost.raw_write), within, raw));
        rows.push(Row::measured(name("read a new value"), "ns", cost.read, Some(cost.raw_read), within, raw));
        let sealed = |what: &str| name(&format!("{what}, sealed channel"));
        rows.push(Row::measured(
            sealed("write in place"),
            "ns",
            cost.sealed_write,
            Some(cost.raw_write),
            Reach::Times(1.0),
            raw,
        ));
        // A reader of a sealed channel copies, so what it costs grows with the size.
        let within = if bytes <= 1024 { Reach::Times(1.2) } else { Reach::Stated };
        rows.push(Row::measured(
            sealed("read a new value"),
            "ns",
            cost.sealed_read,
            Some(cost.raw_read),
            within,
            raw,
        ));
        rows.push(Row::measured(
            name("write a copy"),
            "ns",
            cost.copy,
            Some(cost.raw_write),
            Reach::Stated,
            raw,
        ));
        rows.push(Row::measured(
            name("read again"),
            "ns",
            cost.again,
            Some(cost.raw_read),
            Reach::Stated,
            raw,
        ));
    }
    let flat = |pick: fn(&Cost) -> f64| (pick(&costs[3].1), pick(&costs[0].1));
    for (what, pick) in
        [("write in place", (|cost| cost.write) as fn(&Cost) -> f64), ("read a new value", |cost| cost.read)]
    {
        let (large, small) = flat(pick);
        let name = format!("sampling port, {what}, 64 KiB over 64 B");
        rows.push(Row::measured(name, "ns", large, Some(small), Reach::Times(1.2), "the same with 64 B"));
    }
    Ok(rows)
}

/// What writing and reading a message of 64 B costs by the library alone, ns.
pub(super) fn raw(core: u32, batches: usize) -> Result<[f64; 2]> {
    let cost = probe::on_core(core, probe::PARTITION, move || measure::<64>(batches))??;
    Ok([cost.raw_write, cost.raw_read])
}

/// What the library's figures are of.
pub(super) const RAW: &str =
    "iceoryx2 by hand with the same settings: loan, header with the time, one byte, send; receive, age";

/// The two ports of a channel.
struct Ends<const N: usize> {
    source: SamplingSource<Block<N>>,
    destination: SamplingDestination<Block<N>>,
}

impl<const N: usize> Ends<N> {
    fn of(kind: &ChannelType, channel: &Channel, time: &Time) -> Result<Self> {
        let source = SamplingSource::new(Some(Rc::new(kind.writer(channel)?)), time.clone());
        let reader = Rc::new(kind.reader(channel)?);
        let destination = SamplingDestination::new(Some(reader), u64::MAX, time.clone());
        Ok(Self { source, destination })
    }

    /// Write, read, read again.
    fn in_place(&mut self) -> [u64; 3] {
        let mut sums = [0; 3];
        for number in 0..BATCH {
            let begun = now_ns();
            self.source.write_in_place(|block| block.0[0] = number as u8);
            let written = now_ns();
            let first = self.destination.read().map(|reading| reading.value.0[0]);
            let read = now_ns();
            let second = self.destination.read().map(|reading| reading.value.0[0]);
            let again = now_ns();
            std::hint::black_box((first, second));
            add(&mut sums, [written - begun, read - written, again - read]);
        }
        sums
    }
}

/// Both kinds of port on one channel each, in a domain of its own.
struct Bed<const N: usize> {
    shared: Ends<N>,
    sealed: Ends<N>,
    publisher: Publisher<ipc::Service, [u8], bateleur_ports::Stamp>,
    subscriber: Subscriber<ipc::Service, [u8], bateleur_ports::Stamp>,
    time: Time,
    value: Box<Block<N>>,
}

fn measure<const N: usize>(batches: usize) -> Result<Cost> {
    let folder =
        tempfile::Builder::new().prefix("bateleur-bench.").tempdir_in("/dev/shm").context("no /dev/shm")?;
    let prefix = format!("bateleur-bench.{}.{N}_", std::process::id());
    let cost = Bed::<N>::make(folder.path(), &prefix).map(|mut bed| bed.measure(batches));
    forget(&prefix);
    cost
}

/// One small file of each prefix stays for ever otherwise.
fn forget(prefix: &str) {
    for entry in std::fs::read_dir("/dev/shm").into_iter().flatten().flatten() {
        if entry.file_name().to_string_lossy().starts_with(prefix) {
            let _ = std::fs::remove_file(entry.path()); // somebody else did
        }
    }
}

impl<const N: usize> Bed<N> {
    fn make(folder: &std::path::Path, prefix: &str) -> Result<Self> {
        let page = rustix::fs::memfd_create("bench", rustix::fs::MemfdFlags::CLOEXEC)?;
        rustix::fs::ftruncate(&page, size_of::<ControlPage>() as u64)?;
        let page = Rc::new(Mapped::<ControlPage>::new(page).map_err(|error| anyhow!("{error}"))?);
        page.initialise();
        page.origin_ns.store(now_ns(), std::sync::atomic::Ordering::Relaxed);
        let time = Time::new(page, Clock::Wall);
        let domain = Domain { root: folder.display().to_string() };
        let node = domain.join("bench", "bench")?;
        let kind = ChannelType {
            name: "bench".into(),
            message: "Block".into(),
            size: N,
            depth: None,
            destinations: 1,
            spare_writers: 0,
            spare_readers: 0,
        };
        let channel = kind.create(&node)?;
        let shared = Ends::of(&kind, &channel, &time)?;
        let sealed = Ends::of(&kind, &Channel::Sealed(Handed::alone(&kind, false)?), &time)?;
        let raw = |error: &dyn std::fmt::Debug| anyhow!("the library alone: {error:?}");
        let mut config = Config::default();
        let root = folder.join("raw").display().to_string();
        let root = iceoryx2::prelude::Path::new(root.as_bytes()).map_err(|error| raw(&error))?;
        config.global.set_root_path(&root);
        config.global.prefix = FileName::new(prefix.as_bytes()).map_err(|error| raw(&error))?;
        let node =
            NodeBuilder::new().config(&config).create::<ipc::Service>().map_err(|error| raw(&error))?;
        let name = "bench".try_into().map_err(|error| raw(&error))?;
        let service = node
            .service_builder(&name)
            .publish_subscribe::<[u8]>()
            .user_header::<bateleur_ports::Stamp>()
            .enable_safe_overflow(true)
            .history_size(1)
            .subscriber_max_buffer_size(1)
            .subscriber_max_borrowed_samples(2)
            .create()
            .map_err(|error| raw(&error))?;
        let publisher = service.publisher_builder().initial_max_slice_len(N).max_loaned_samples(1);
        let publisher = publisher.create().map_err(|error| raw(&error))?;
        let subscriber = service.subscriber_builder().create().map_err(|error| raw(&error))?;
        Ok(Self { shared, sealed, publisher, subscriber, time, value: Box::new(Block([0; N])) })
    }

    fn measure(&mut self, batches: usize) -> Cost {
        let mut all: [Vec<f64>; 8] = Default::default();
        let look = clock_cost();
        for batch in 0..batches + 1 {
            let [shared, copied, sealed, raw] =
                [self.shared.in_place(), self.ours_copied(), self.sealed.in_place(), self.raw()];
            if batch == 0 {
                continue; // everything is cold
            }
            let each = |ns: u64| (ns as f64 / f64::from(BATCH) - look).max(0.0);
            let costs = [shared[0], copied[0], shared[1], shared[2], sealed[0], sealed[1], raw[0], raw[1]];
            all.iter_mut().zip(costs).for_each(|(list, ns)| list.push(each(ns)));
        }
        let [write, copy, read, again, sealed_write, sealed_read, raw_write, raw_read] =
            all.map(|list| median(&list).unwrap_or(0.0));
        Cost { write, copy, read, again, sealed_write, sealed_read, raw_write, raw_read }
    }

    fn ours_copied(&mut self) -> [u64; 3] {
        let mut sums = [0; 3];
        for number in 0..BATCH {
            self.value.0[0] = number as u8;
            let begun = now_ns();
            self.shared.source.write(&self.value);
            let written = now_ns();
            std::hint::black_box(self.shared.destination.read().map(|reading| reading.value.0[0]));
            add(&mut sums, [written - begun, 0, 0]);
        }
        sums
    }

    fn raw(&mut self) -> [u64; 3] {
        let mut sums = [0; 3];
        let mut latest = None;
        for number in 0..BATCH {
            let begun = now_ns();
            let sent = self.raw_write(number);
            let written = now_ns();
            if let Ok(Some(sample)) = self.subscriber.receive() {
                latest = Some(sample); // the one before is given back, as a port does
            }
            let value = latest.as_ref().map(|sample| sample.payload()[0]);
            let age_ns = latest.as_ref().map(|sample| self.time.now_ns() - sample.user_header().source_ns);
            let read = now_ns();
            std::hint::black_box((sent, value, age_ns));
            add(&mut sums, [written - begun, read - written, 0]);
        }
        sums
    }

    fn raw_write(&self, number: u32) -> Option<usize> {
        let mut sample = self.publisher.loan_slice_uninit(N).ok()?;
        let source_ns = self.time.now_ns();
        *sample.user_header_mut() = bateleur_ports::Stamp { source_ns, sequence: u64::from(number) };
        // SAFETY: as in the ports: shared memory has a value in every byte, and every value is one of a byte.
        let mut sample = unsafe { sample.assume_init() };
        sample.payload_mut()[0] = number as u8;
        sample.send().ok()
    }
}

fn add(sums: &mut [u64; 3], more: [u64; 3]) {
    sums.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
}

/// What two looks at the clock cost beside what lies between them, ns.
fn clock_cost() -> f64 {
    let rounds: Vec<f64> = (0..1001)
        .map(|_| now_ns())
        .collect::<Vec<_>>()
        .windows(2)
        .map(|pair| (pair[1] - pair[0]) as f64)
        .collect();
    median(&rounds).unwrap_or(0.0)
}
