//! A partition without an executive, for its own tests: the test holds the far ends of the ports, grants windows and reads
//! what was reported.
//!
//! Ports are real channels, in a folder of their own; time is virtual and moves by a minor frame with each window. What
//! only an executive does is not here: isolation, the end of a window, faults.
//!
//! ```
//! use bateleur_apex::{Context, Harness, Partition, SamplingDestination, SamplingSource, StartError, Window};
//! use bateleur_messages::{Pressure, RawAnalog};
//!
//! struct Altimeter {
//!     raw: SamplingDestination<RawAnalog>,
//!     pressure: SamplingSource<Pressure>,
//! }
//!
//! impl Partition for Altimeter {
//!     fn start(context: &mut Context) -> Result<Self, StartError> {
//!         Ok(Self { raw: context.sampling_destination("raw")?, pressure: context.sampling_source("pressure")? })
//!     }
//!
//!     fn window(&mut self, _window: &Window) {
//!         if let Some(raw) = self.raw.read_valid() {
//!             let pressure = Pressure { static_pressure_pa: raw.static_pressure_pa, ..Default::default() };
//!             self.pressure.write(&pressure);
//!         }
//!     }
//! }
//!
//! # fn main() -> Result<(), StartError> {
//! let mut harness = Harness::new("altimeter")?;
//! let mut raw = harness.sampling_destination::<RawAnalog>("raw", 40_000_000)?;
//! let mut pressure = harness.sampling_source::<Pressure>("pressure")?;
//! let mut altimeter = harness.start::<Altimeter>()?;
//! raw.write(&RawAnalog { static_pressure_pa: 90_000.0, ..Default::default() });
//! altimeter.window();
//! assert_eq!(pressure.read().map(|reading| reading.value.static_pressure_pa), Some(90_000.0));
//! # Ok(())
//! # }
//! ```

use std::fs::File;
use std::os::fd::{IntoRawFd, OwnedFd};
use std::path::PathBuf;
use std::rc::Rc;
use std::sync::atomic::{AtomicU32, Ordering::Relaxed};

use bateleur_contract::page::WindowGrant;
use bateleur_contract::{
    Clock, ControlPage, Description, Direction, LogbookDescription, LogbookSizes, Mapped,
    MemoryBlockDescription, PortDescription, PortKind, ProcessPlan, StartCondition, Takeover as Order,
};
use bateleur_message_format::{Field, Message, layout_of};
use bateleur_ports::{Channel, ChannelType, Domain, Membership};
use rustix::fs::{MemfdFlags, ftruncate, memfd_create};

use crate::context::{Context, StartError, Started};
use crate::errors::{HealthError, Response};
use crate::logbook::LogbookStore;
use crate::memory_block::MemoryBlock;
use crate::ports::{Inlet, Outlet, QueuingDestination, QueuingSource, SamplingDestination, SamplingSource};
use crate::run::Partition;
use crate::takeover::Takeover;
use crate::time::Time;
use crate::window::Window;

/// From the start of a window to that of the next, ns.
const MINOR_FRAME_NS: u64 = 20_000_000;
/// Length of a window, ns. Time stands still in it.
const WINDOW_NS: u64 = 1_000_000;

/// The surroundings of one partition in a test.
pub struct Harness {
    description: Description,
    time: Time,
    retained: Option<File>,
    memory_blocks: Vec<OwnedFd>,
    logbooks: Vec<OwnedFd>,
    reports_seen: u32,
    // Held so that the channels stay; before the folder in which they lie.
    channels: Vec<(Channel, Option<Channel>, Membership)>,
    _folder: Folder,
}

/// One incarnation of a partition in a test.
pub struct Incarnation<P> {
    /// The partition itself.
    pub partition: P,
    started: Started,
    time: Time,
}

/// A folder for the channels, removed when dropped.
struct Folder(PathBuf);

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0); // the system clears its temporary folder in time
    }
}

impl Harness {
    /// Surroundings without ports, attributes and retained memory.
    ///
    /// # Errors
    /// The machine has no memory or no temporary folder to give.
    pub fn new(partition: &str) -> Result<Self, StartError> {
        static NUMBER: AtomicU32 = AtomicU32::new(0);
        let number = NUMBER.fetch_add(1, Relaxed);
        let folder = format!("bateleur-harness-{}-{number}", std::process::id());
        let folder = Folder(std::env::temp_dir().join(folder));
        std::fs::create_dir_all(&folder.0).map_err(|error| refused("folder", error))?;
        let page = memory(size_of::<ControlPage>() as u64)?;
        let page = Mapped::<ControlPage>::new(page).map_err(|error| refused("a control page", error))?;
        page.initialise();
        let description = Description {
            module: "harness".into(),
            partition: partition.into(),
            generation: 0,
            start_condition: StartCondition::NormalStart,
            standby: false,
            spare: false,
            clock: Clock::Virtual,
            ports: Vec::new(),
            attributes: std::collections::BTreeMap::new(),
            schedules: vec!["harness".into()],
            may_set_schedule: Vec::new(),
            error_handler: false,
            processes: PROCESSES,
            schedule_times: std::collections::BTreeMap::new(),
            process_table: None,
            crash_memory: None,
            planned_processes: Vec::new(),
            taken_errors: Vec::new(),
            may_align: false,
            voted_elsewhere: false,
            retained_bytes: 0,
            memory_blocks: Vec::new(),
            logbooks: Vec::new(),
            name_services: std::collections::BTreeMap::new(),
            ports_root: folder.0.to_string_lossy().into_owned(),
        };
        let time = Time::new(Rc::new(page), Clock::Virtual).granted_by_caller(&description.partition);
        Ok(Self {
            description,
            time,
            retained: None,
            memory_blocks: Vec::new(),
            logbooks: Vec::new(),
            reports_seen: 0,
            channels: Vec::new(),
            _folder: folder,
        })
    }

    /// Gives the partition an attribute.
    pub fn attribute(&mut self, name: &str, value: impl Into<serde_json::Value>) {
        self.description.attributes.insert(name.into(), value.into());
    }

    /// Gives the partition retained memory, which all its incarnations share.
    ///
    /// # Errors
    /// The machine has no memory to give.
    pub fn retained(&mut self, bytes: u64) -> Result<(), StartError> {
        self.retained = Some(File::from(memory(bytes)?));
        self.description.retained_bytes = bytes;
        Ok(())
    }

    /// Gives the partition a memory block with this content, which all its incarnations share. The answer is the same memory for whoever
    /// shares it, and may be written.
    ///
    /// # Errors
    /// The machine has no memory to give.
    pub fn memory_block(
        &mut self,
        name: &str,
        content: &[u8],
        writable: bool,
    ) -> Result<MemoryBlock, StartError> {
        let file = memory(content.len() as u64)?;
        let others = file.try_clone().map_err(|error| refused("a memory block", error))?;
        let described = MemoryBlockDescription {
            name: name.into(),
            bytes: content.len() as u64,
            writable,
            descriptor: -1,
        };
        let descriptor = others.into_raw_fd();
        let others =
            MemoryBlock::map(&MemoryBlockDescription { writable: true, descriptor, ..described.clone() })?;
        others.write(0, content).map_err(|error| StartError::Other(error.to_string()))?;
        self.description.memory_blocks.push(described);
        self.memory_blocks.push(file);
        Ok(others)
    }

    /// Gives the partition a logbook, which all its incarnations share. The answer stores its messages when the test asks it to.
    ///
    /// # Errors
    /// The machine has no memory to give.
    pub fn logbook(&mut self, name: &str, sizes: LogbookSizes) -> Result<LogbookStore, StartError> {
        let file = memory(sizes.bytes())?;
        let others = file.try_clone().map_err(|error| refused("a logbook", error))?;
        let described = LogbookDescription { name: name.into(), sizes, descriptor: -1 };
        let store = LogbookStore::new(&described, others)?;
        self.description.logbooks.push(described);
        self.logbooks.push(file);
        Ok(store)
    }

    /// Gives the partition a sampling destination; the answer is the source that feeds it.
    ///
    /// # Errors
    /// The channel can not be made.
    pub fn sampling_destination<T: Message>(
        &mut self,
        name: &str,
        refresh_ns: u64,
    ) -> Result<SamplingSource<T>, StartError> {
        let port = port::<T>(name, PortKind::Sampling, Direction::Destination);
        let (kind, channel) = self.add(PortDescription { refresh_ns, ..port })?;
        let writer = kind.writer(&channel)?;
        Ok(SamplingSource::new(Some(Rc::new(writer)), self.time.clone()))
    }

    /// Gives the partition a sampling source; the answer is a destination that reads it, for which no value is too old.
    ///
    /// # Errors
    /// As above.
    pub fn sampling_source<T: Message>(&mut self, name: &str) -> Result<SamplingDestination<T>, StartError> {
        let (kind, channel) = self.add(port::<T>(name, PortKind::Sampling, Direction::Source))?;
        let reader = kind.reader(&channel)?;
        Ok(SamplingDestination::new(Some(Rc::new(reader)), u64::MAX, self.time.clone()))
    }

    /// Gives the partition a queuing destination of `depth` messages; the answer is the source that fills it.
    ///
    /// # Errors
    /// As above.
    pub fn queuing_destination<T: Message>(
        &mut self,
        name: &str,
        depth: u32,
    ) -> Result<QueuingSource<T>, StartError> {
        let port = port::<T>(name, PortKind::Queuing, Direction::Destination);
        let (kind, channel) = self.add(PortDescription { depth, ..port })?;
        let outlet = Outlet::new(Rc::new(kind.writer(&channel)?), None);
        Ok(QueuingSource::new(Some(Rc::new(outlet)), self.time.clone()))
    }

    /// Gives the partition a queuing source for `depth` messages; the answer is the destination that takes them.
    ///
    /// # Errors
    /// As above.
    pub fn queuing_source<T: Message>(
        &mut self,
        name: &str,
        depth: u32,
    ) -> Result<QueuingDestination<T>, StartError> {
        let port = port::<T>(name, PortKind::Queuing, Direction::Source);
        let (kind, channel) = self.add(PortDescription { depth, ..port })?;
        let inlet = Inlet::new(kind, channel);
        inlet.attach()?;
        Ok(QueuingDestination::new(Some(Rc::new(inlet)), self.time.clone()))
    }

    /// Starts the partition: the first time as the module starts it, then as a warm restart does. Drop the incarnation before.
    ///
    /// # Errors
    /// What its `start` says, and what an executive would: a port or an attribute that it does not ask for.
    pub fn start<P: Partition>(&mut self) -> Result<Incarnation<P>, StartError> {
        let mut context = self.context()?;
        let partition = P::start(&mut context)?;
        let started = context.finish()?;
        started.connect();
        self.description.generation += 1;
        self.description.start_condition = StartCondition::HmPartitionWarmRestart;
        Ok(Incarnation { partition, started, time: self.time.clone() })
    }

    /// What a partition is started with.
    pub(crate) fn context(&self) -> Result<Context, StartError> {
        let retained = match &self.retained {
            Some(file) => Some(file.try_clone().map_err(|error| refused("retained memory", error))?),
            None => None,
        };
        let mut description = self.description.clone();
        for (block, file) in description.memory_blocks.iter_mut().zip(&self.memory_blocks) {
            let file = file.try_clone().map_err(|error| refused("a memory block", error))?;
            block.descriptor = file.into_raw_fd();
        }
        for (logbook, file) in description.logbooks.iter_mut().zip(&self.logbooks) {
            let file = file.try_clone().map_err(|error| refused("a logbook", error))?;
            logbook.descriptor = file.into_raw_fd();
        }
        Context::new(description, self.time.clone(), retained)
    }

    /// What the partition has reported since this was asked last: messages to the operator, errors, refusals of ports.
    pub fn reports(&mut self) -> Vec<String> {
        let reports = self.time.page().reports_since(&mut self.reports_seen);
        reports.into_iter().map(|report| report.text).collect()
    }

    /// Makes the channel of a port, and the twin of a queue that an executive makes for observers; opens it for the far end.
    fn add(&mut self, port: PortDescription) -> Result<(ChannelType, Channel), StartError> {
        let queuing = port.kind == PortKind::Queuing;
        let kind = ChannelType {
            name: port.channel.clone(),
            message: port.message.clone(),
            size: port.size as usize,
            depth: queuing.then_some(port.depth.max(1) as usize),
            destinations: 1,
            spare_writers: 1,
            spare_readers: 1,
        };
        let node = Domain { root: self.description.ports_root.clone() }.join(kind.home(), "harness")?;
        let made = kind.create(&node)?;
        let twin = if queuing { Some(kind.observed().create(&node)?) } else { None };
        let far_end = kind.open(&node)?;
        self.channels.push((made, twin, node));
        self.description.ports.push(port);
        Ok((kind, far_end))
    }
}

impl<P: Partition> Incarnation<P> {
    /// One window, a minor frame after the one before.
    pub fn window(&mut self) {
        let page = self.time.page();
        let (number, before) = page.granted_window();
        let minor_frames = before.minor_frames + 1;
        let start_ns = minor_frames * MINOR_FRAME_NS;
        page.now_ns.store(start_ns, Relaxed);
        let window = WindowGrant {
            start_ns,
            end_ns: start_ns + WINDOW_NS,
            minor_frames,
            minor_frame_ns: MINOR_FRAME_NS,
            ..before
        };
        page.publish_grant(number + 1, &window);
        let (_, window) = Window::granted(&self.time);
        self.started.connect();
        self.partition.window(&window);
    }

    /// Hands an error to its error handler, in the window that it had last.
    pub fn handle(&mut self, error: &HealthError) -> Response {
        let (_, window) = Window::granted(&self.time);
        self.partition.error_handler(error, &window)
    }

    /// It takes over from one whose retained memory was kept.
    pub fn take_over(&mut self) {
        self.partition.take_over(&Takeover::new(Order::Warm, self.time.now_ns()));
    }
}

/// A partition of the harness may have as many processes as any.
pub(crate) const PROCESSES: ProcessPlan = ProcessPlan {
    identifier: 0,
    period_ns: MINOR_FRAME_NS,
    release_ns: 0,
    duration_ns: MINOR_FRAME_NS,
    most: 128,
    stacks_bytes: 1 << 30,
};

/// A port without its refresh period or depth.
fn port<T: Message>(name: &str, kind: PortKind, direction: Direction) -> PortDescription {
    PortDescription {
        name: name.into(),
        direction,
        kind,
        message: T::NAME.into(),
        size: size_of::<T>() as u32, // at most what a port can carry, far below
        layout: layout_of(T::FIELDS),
        definition: definition(T::FIELDS),
        channel: format!("harness.{name}"),
        sealed: None,
        refresh_ns: 0,
        depth: 0,
        optional: false,
    }
}

/// Fields as the text of a type, as far as a path is no name in it.
fn definition(fields: &[Field]) -> String {
    let line = |field: &Field| {
        let array = if field.count == 1 { String::new() } else { format!("[{}]", field.count) };
        let name = field.name.replace(['.', '['], "_").replace(']', "");
        let unit = if field.unit.is_empty() { String::new() } else { format!(" # [{}]", field.unit) };
        format!("{}{array} {name}{unit}\n", field.kind.ros2_name())
    };
    fields.iter().map(line).collect()
}

fn memory(bytes: u64) -> Result<OwnedFd, StartError> {
    let wrong = |error| refused("memory", error);
    let memory = memfd_create("harness", MemfdFlags::CLOEXEC).map_err(wrong)?;
    ftruncate(&memory, bytes).map_err(wrong)?;
    Ok(memory)
}

fn refused(what: &str, error: impl std::fmt::Display) -> StartError {
    StartError::Other(format!("the harness has no {what}: {error}"))
}

#[cfg(test)]
mod tests {
    use bateleur_messages::{FieldKind, GroundMessage, Rate};
    use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

    use super::*;
    use crate::{Retained, Sent};

    /// Writes the sum of what it heard and kept, sends on what was sent to it.
    struct Adder {
        step: u64,
        rate: SamplingDestination<Rate>,
        sum: SamplingSource<Rate>,
        orders: QueuingDestination<GroundMessage>,
        answers: QueuingSource<GroundMessage>,
        retained: Retained<u64>,
        total: u64,
    }

    impl Partition for Adder {
        fn start(context: &mut Context) -> Result<Self, StartError> {
            let mut retained = context.retained()?;
            Ok(Self {
                step: context.attribute("step", 1)?,
                rate: context.sampling_destination("rate")?,
                sum: context.sampling_source("sum")?,
                orders: context.queuing_destination("orders")?,
                answers: context.queuing_source("answers")?,
                total: retained.load().unwrap_or(0),
                retained,
            })
        }

        fn take_over(&mut self, takeover: &Takeover) {
            assert_eq!(takeover.start_condition(), StartCondition::HmPartitionWarmRestart);
            self.total = self.retained.load().unwrap_or(0);
        }

        fn window(&mut self, window: &Window) {
            match self.rate.read_valid() {
                Some(rate) => self.total += rate.synchronize * self.step,
                None => window.report("no rate"),
            }
            self.sum.write(&Rate { synchronize: self.total, ..Rate::default() });
            self.retained.store(&self.total);
            if let Some(order) = self.orders.receive() {
                self.answers.send(&order);
            }
        }
    }

    #[test]
    fn a_partition_meets_its_ports_attributes_and_what_was_retained() {
        let mut harness = Harness::new("adder").unwrap();
        harness.attribute("step", 10_u64);
        harness.retained(4096).unwrap();
        let mut rate = harness.sampling_destination::<Rate>("rate", 2 * MINOR_FRAME_NS).unwrap();
        let mut sum = harness.sampling_source::<Rate>("sum").unwrap();
        let mut orders = harness.queuing_destination::<GroundMessage>("orders", 1).unwrap();
        let mut answers = harness.queuing_source::<GroundMessage>("answers", 1).unwrap();
        let mut adder = harness.start::<Adder>().unwrap();
        adder.window();
        assert_eq!(harness.reports(), ["no rate"]);
        rate.write(&Rate { synchronize: 3, ..Rate::default() });
        assert_eq!(orders.send(&GroundMessage { letter: 7, ..Default::default() }), Sent::Queued);
        assert_eq!(orders.send(&GroundMessage::default()), Sent::Full);
        (0..3).for_each(|_| adder.window());
        // The value is valid for two frames after the one in which it was written.
        assert_eq!(sum.read().map(|reading| reading.value.synchronize), Some(60));
        assert_eq!(harness.reports(), ["no rate"]);
        assert_eq!(answers.receive().map(|answer| answer.letter), Some(7));
        assert_eq!(answers.receive().map(|answer| answer.letter), None);
        drop(adder);
        let mut adder = harness.start::<Adder>().unwrap();
        assert_eq!(adder.partition.total, 60);
        adder.partition.total = 0;
        adder.take_over();
        assert_eq!(adder.partition.total, 60);
    }

    #[test]
    fn what_an_executive_would_refuse_is_refused() {
        let mut harness = Harness::new("adder").unwrap();
        let error = harness.start::<Adder>().err().map(|error| error.to_string());
        assert_eq!(error.as_deref(), Some("the plan gives this partition no port \"rate\"; it has "));
        let folder = harness._folder.0.clone();
        assert!(folder.is_dir());
        drop(harness);
        assert!(!folder.exists());
    }

    /// As `Rate` by name and size, from a build in which its fields are others.
    #[derive(Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
    #[repr(C)]
    struct OtherRate([u64; size_of::<Rate>() / 8]);

    impl Message for OtherRate {
        const NAME: &'static str = Rate::NAME;
        const FIELDS: &'static [Field] = &[Field {
            name: "swapped",
            unit: "",
            kind: FieldKind::U64,
            count: size_of::<Rate>() / 8,
            offset: 0,
        }];
    }

    /// As `Rate` by name, from a build in which it was shorter.
    #[derive(Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
    #[repr(C)]
    struct ShortRate(u64);

    impl Message for ShortRate {
        const NAME: &'static str = Rate::NAME;
        const FIELDS: &'static [Field] =
            &[Field { name: "synchronize", unit: "", kind: FieldKind::U64, count: 1, offset: 0 }];
    }

    struct Listener<T>(#[allow(dead_code)] SamplingDestination<T>);

    impl<T: Message> Partition for Listener<T> {
        fn start(context: &mut Context) -> Result<Self, StartError> {
            context.sampling_destination("rate").map(Self)
        }

        fn window(&mut self, _window: &Window) {}
    }

    #[test]
    fn partition_that_was_built_from_other_messages_is_not_started() {
        let mut harness = Harness::new("listener").unwrap();
        let _source = harness.sampling_destination::<Rate>("rate", 40_000_000).unwrap();
        assert!(harness.start::<Listener<Rate>>().is_ok());
        let other = harness.start::<Listener<OtherRate>>().err().map(|error| error.to_string());
        let other = other.unwrap();
        // Both tables, and last what an operator is told.
        for table in [
            "Rate in the plan (byte",
            "     40  uint64 synchronize_ns [ns]\n",
            "Rate in this program:\n      0  uint64[7] swapped\n",
        ] {
            assert!(other.contains(table), "{other}");
        }
        let last = other.lines().last().unwrap();
        assert!(
            last.contains("the plan has `0 uint64 synchronize` where it has `0 uint64[7] swapped`"),
            "{last}"
        );
        let short = harness.start::<Listener<ShortRate>>().err().map(|error| error.to_string());
        assert!(short.as_ref().is_some_and(|words| words.contains("where it has nothing more")), "{short:?}");
    }

    #[test]
    fn port_that_the_plan_calls_optional_may_be_left_out_and_no_other() {
        let mut harness = Harness::new("listener").unwrap();
        let _rate = harness.sampling_destination::<Rate>("rate", 40_000_000).unwrap();
        let _spare = harness.sampling_destination::<Rate>("spare", 40_000_000).unwrap();
        let refused = harness.start::<Listener<Rate>>().err().map(|error| error.to_string());
        assert!(
            refused.as_ref().is_some_and(|words| words.contains("\"spare\" that it does not use")),
            "{refused:?}"
        );
        harness.description.ports[1].optional = true;
        assert!(harness.start::<Listener<Rate>>().is_ok());
    }

    /// Plain bytes, as the far end of a channel has them.
    #[derive(Clone, Copy, FromBytes, IntoBytes, Immutable, KnownLayout)]
    #[repr(C)]
    struct Plain([u8; 8]);

    impl Message for Plain {
        const NAME: &'static str = bateleur_contract::PLAIN_BYTES;
        const FIELDS: &'static [Field] = &[];
    }

    struct PlainListener(crate::RawSamplingDestination, Vec<Vec<u8>>);

    impl Partition for PlainListener {
        fn start(context: &mut Context) -> Result<Self, StartError> {
            Ok(Self(context.raw_sampling_destination("bytes")?.0, Vec::new()))
        }

        fn window(&mut self, _window: &Window) {
            self.1.extend(self.0.read().map(|reading| reading.bytes.to_vec()));
        }
    }

    #[test]
    fn sampling_port_of_plain_bytes_takes_every_length_up_to_its_own() {
        let mut harness = Harness::new("listener").unwrap();
        let bytes = harness.sampling_destination::<Plain>("bytes", 40_000_000).unwrap();
        harness.description.ports[0].layout = 0;
        let mut listener = harness.start::<PlainListener>().unwrap();
        for length in [8, 3, 1, 0] {
            let put = bytes.outlet.as_ref().unwrap().put(&vec![length; length.into()], Default::default(), 0);
            assert_eq!(put.ok(), Some(1));
            listener.window();
        }
        let seen = std::mem::take(&mut listener.partition.1);
        assert_eq!(seen, [vec![8; 8], vec![3; 3], vec![1], vec![1]], "no message is empty");
        assert_eq!(harness.reports(), ["message of 0 bytes where 1 to 8 belong"]);
    }

    struct Keeper;

    impl Partition for Keeper {
        fn start(context: &mut Context) -> Result<Self, StartError> {
            let _first: Retained<u64> = context.retained()?;
            let _second: Retained<u64> = context.retained()?;
            Ok(Self)
        }

        fn window(&mut self, _window: &Window) {}
    }

    #[test]
    fn second_retained_value_is_refused_instead_of_being_kept_nowhere() {
        let mut harness = Harness::new("keeper").unwrap();
        harness.retained(4096).unwrap();
        let error = harness.start::<Keeper>().err().map(|error| error.to_string());
        assert!(error.as_ref().is_some_and(|words| words.contains("asked for twice")), "{error:?}");
    }

    struct Poller;

    impl Partition for Poller {
        fn start(_: &mut Context) -> Result<Self, StartError> {
            Ok(Self)
        }

        fn window(&mut self, window: &Window) {
            while window.now_ns() < window.start_ns() + 10 * WINDOW_NS {}
        }
    }

    #[test]
    #[should_panic(expected = "looks at module time until its window is over")]
    fn loop_that_waits_for_an_instant_beyond_its_window_fails_the_test_and_does_not_hang_it() {
        Harness::new("poller").unwrap().start::<Poller>().unwrap().window();
    }
}
