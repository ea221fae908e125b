//! What a partition uses while it starts: its ports, attributes, retained memory and devices.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io::{Read, Write};
use std::net::SocketAddrV4;
use std::os::fd::{AsFd, BorrowedFd};
use std::rc::Rc;

use bateleur_contract::sealed::SealedDescriptors;
use bateleur_contract::{
    ControlPage, Description, Direction, OUTVOTED_PORT, PartitionTimes, PlannedProcess, PortDescription,
    PortKind, ProcessPlan, StartCondition,
};
use bateleur_message_format::{Message, Type, describe, layout_of};
use bateleur_ports::{Channel, ChannelError, ChannelType, Domain, Handed, Membership, Reader, Writer};
use serde::de::DeserializeOwned;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::alignment::Alignment;
use crate::attributes::{AttributeError, Attributes};
use crate::faults::Faults;
use crate::line::Line;
use crate::logbook::Logbook;
use crate::memory_block::MemoryBlock;
use crate::notices::HealthNotices;
use crate::ports::{
    Connect, Inlet, Outlet, QueuingDestination, QueuingSource, SamplingDestination, SamplingSource,
};
use crate::raw::{RawQueuingDestination, RawQueuingSource, RawSamplingDestination, RawSamplingSource};
use crate::retained::Retained;
use crate::schedule::{ModuleSchedules, Schedules};
use crate::time::Time;
use crate::verdict::Verdicts;

/// Why a partition can not start.
#[derive(Debug, thiserror::Error)]
pub enum StartError {
    /// The plan does not declare the port.
    #[error("the plan gives this partition no port \"{name}\"; it has {known}")]
    NoSuchPort {
        /// The port that was asked for.
        name: String,
        /// Those that the plan declares.
        known: String,
    },
    /// The plan declares the port otherwise.
    #[error("port \"{name}\" is {found} in the plan, but the partition uses it as {wanted}")]
    WrongPort {
        /// The port.
        name: String,
        /// What the plan says.
        found: String,
        /// What the partition needs.
        wanted: String,
    },
    /// Its message type has other fields in the plan.
    #[error(
        "{message} in the plan (byte, kind, name and unit of each field):\n{found}{message} in this program:\n{wanted}port \"{name}\" \
         carries {message}, which has other fields in the plan than in this program: {}; build it from the messages of the plan",
        first_difference(.found, .wanted)
    )]
    OtherFields {
        /// The port.
        name: String,
        /// The message type.
        message: &'static str,
        /// The field table of the plan, a line for each field.
        found: String,
        /// The program's.
        wanted: String,
    },
    /// The plan does not give the partition the memory block.
    #[error("the plan gives this partition no memory block \"{name}\"; it has {known}")]
    NoSuchMemoryBlock {
        /// The block that was asked for.
        name: String,
        /// Those that it is given.
        known: String,
    },
    /// The plan does not give the partition the logbook.
    #[error("the plan gives this partition no logbook \"{name}\"; it has {known}")]
    NoSuchLogbook {
        /// The name that was asked for.
        name: String,
        /// Those that there are.
        known: String,
    },
    /// `retained` was asked for twice: there is one memory for one value.
    #[error("retained memory is asked for twice: put both values into one type")]
    RetainedTwice,
    /// The plan declares a port that the partition does not use.
    #[error("the plan gives this partition a port \"{0}\" that it does not use")]
    UnusedPort(String),
    /// The channel below a port.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// An attribute.
    #[error(transparent)]
    Attribute(#[from] AttributeError),
    /// Anything else that the partition needs: say what it is and how to mend it.
    #[error("{0}")]
    Other(String),
}

/// Handed to [`crate::Partition::start`].
pub struct Context {
    description: Description,
    attributes: Attributes,
    domain: Domain,
    /// By the channel's directory.
    nodes: BTreeMap<String, Membership>,
    time: Time,
    used: BTreeSet<String>,
    // Channels stay open as long as the partition runs.
    channels: Vec<Channel>,
    connections: Vec<Rc<dyn Connect>>,
    outlets: Vec<(String, Rc<Outlet>)>,
    inlets: Vec<Rc<Inlet>>,
    memory_blocks: Vec<MemoryBlock>,
    logbooks: Vec<Logbook>,
    retained: Option<File>,
    /// It has been asked for.
    retains: bool,
    /// The port of a replica whose voter is on another module.
    outvoted: Option<PortDescription>,
}

/// The first line in which two field tables differ. The executive tells an operator the last line of a refusal alone.
fn first_difference(found: &str, wanted: &str) -> String {
    let (mut found, mut wanted) = (found.lines(), wanted.lines());
    let words = |line: Option<&str>| {
        let words = line.map(|line| line.split_whitespace().collect::<Vec<_>>().join(" "));
        words.map_or("nothing more".to_owned(), |words| format!("`{words}`"))
    };
    loop {
        match (found.next(), wanted.next()) {
            (one, other) if one == other && one.is_some() => {}
            (one, other) => return format!("the plan has {} where it has {}", words(one), words(other)),
        }
    }
}

fn names<'n>(names: impl Iterator<Item = &'n str>) -> String {
    let names: Vec<&str> = names.collect();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

impl Context {
    pub(crate) fn new(
        mut description: Description,
        time: Time,
        retained: Option<File>,
    ) -> Result<Self, StartError> {
        let memory_blocks =
            description.memory_blocks.iter().map(MemoryBlock::map).collect::<Result<_, _>>()?;
        let logbooks = description.logbooks.iter().map(Logbook::map).collect::<Result<_, _>>()?;
        let domain = Domain { root: description.ports_root.clone() };
        let attributes = Attributes::new(std::mem::take(&mut description.attributes));
        // The last one, so that the others keep their places.
        let is_voted_elsewhere = description.voted_elsewhere;
        let outvoted = description.ports.pop_if(|port| is_voted_elsewhere && port.name == OUTVOTED_PORT);
        Ok(Self {
            description,
            attributes,
            domain,
            nodes: BTreeMap::new(),
            time,
            used: BTreeSet::new(),
            channels: Vec::new(),
            connections: Vec::new(),
            outlets: Vec::new(),
            inlets: Vec::new(),
            memory_blocks,
            logbooks,
            retained,
            retains: false,
            outvoted,
        })
    }

    /// The partition's name in the plan.
    pub fn name(&self) -> &str {
        &self.description.partition
    }

    /// Why the partition was started.
    pub fn start_condition(&self) -> StartCondition {
        self.description.start_condition
    }

    /// The partition stands by: another process of it has the windows, until [`crate::Partition::take_over`].
    pub fn stands_by(&self) -> bool {
        self.description.standby
    }

    /// Incarnations before this one.
    pub fn generation(&self) -> u32 {
        self.description.generation
    }

    /// The module's clock.
    pub fn time(&self) -> &Time {
        &self.time
    }

    /// Where to tell how the module's major frames lie to those that they follow. `None` if it is not for this partition to say.
    pub fn alignment(&self) -> Option<Alignment> {
        self.description.may_align.then(|| Alignment::new(self.time.clone()))
    }

    /// An attribute's value in the plan, or `default`.
    pub fn attribute<T: DeserializeOwned>(&mut self, name: &str, default: T) -> Result<T, StartError> {
        Ok(self.attributes.get(name, default)?)
    }

    /// An attribute such as "20ms", as nanoseconds.
    pub fn duration_ns(&mut self, name: &str, default_ns: u64) -> Result<u64, StartError> {
        Ok(self.attributes.duration_ns(name, default_ns)?)
    }

    /// All attributes, for a function that reads its own.
    pub fn attributes(&mut self) -> &mut Attributes {
        &mut self.attributes
    }

    /// CREATE_SAMPLING_PORT, source.
    pub fn sampling_source<T: Message>(&mut self, name: &str) -> Result<SamplingSource<T>, StartError> {
        let port = self.port::<T>(name, PortKind::Sampling, Direction::Source)?;
        let outlet = self.writer(&port)?.map(|writer| self.outlet(name, writer, None));
        Ok(SamplingSource::through(outlet, self.time.clone()))
    }

    /// CREATE_SAMPLING_PORT, destination.
    pub fn sampling_destination<T: Message>(
        &mut self,
        name: &str,
    ) -> Result<SamplingDestination<T>, StartError> {
        let port = self.port::<T>(name, PortKind::Sampling, Direction::Destination)?;
        Ok(SamplingDestination::new(self.reader(&port)?, port.refresh_ns, self.time.clone()))
    }

    /// CREATE_QUEUING_PORT, source.
    pub fn queuing_source<T: Message>(&mut self, name: &str) -> Result<QueuingSource<T>, StartError> {
        let port = self.port::<T>(name, PortKind::Queuing, Direction::Source)?;
        let (writer, observed) = (self.writer(&port)?, self.observed(&port)?);
        let outlet = writer.map(|writer| self.outlet(name, writer, observed));
        Ok(QueuingSource::new(outlet, self.time.clone()))
    }

    /// CREATE_QUEUING_PORT, destination.
    pub fn queuing_destination<T: Message>(
        &mut self,
        name: &str,
    ) -> Result<QueuingDestination<T>, StartError> {
        let port = self.port::<T>(name, PortKind::Queuing, Direction::Destination)?;
        Ok(QueuingDestination::new(self.inlet(&port)?, self.time.clone()))
    }

    /// As [`Context::sampling_source`], for messages of whatever type the plan says; with their length, bytes.
    ///
    /// # Errors
    /// As there.
    pub fn raw_sampling_source(&mut self, name: &str) -> Result<(RawSamplingSource, usize), StartError> {
        let port = self.raw_port(name, PortKind::Sampling, Direction::Source)?;
        let outlet = self.writer(&port)?.map(|writer| self.outlet(name, writer, None));
        Ok((RawSamplingSource::new(outlet, self.time.clone()), port.size as usize))
    }

    /// As [`Context::sampling_destination`], for messages of whatever type the plan says; with their length, bytes.
    ///
    /// # Errors
    /// As there.
    pub fn raw_sampling_destination(
        &mut self,
        name: &str,
    ) -> Result<(RawSamplingDestination, usize), StartError> {
        let port = self.raw_port(name, PortKind::Sampling, Direction::Destination)?;
        let bytes = port.size as usize;
        Ok((RawSamplingDestination::new(self.reader(&port)?, port, self.time.clone()), bytes))
    }

    /// As [`Context::queuing_source`], for messages of whatever type the plan says; with the longest one's length, bytes.
    ///
    /// # Errors
    /// As there.
    pub fn raw_queuing_source(&mut self, name: &str) -> Result<(RawQueuingSource, usize), StartError> {
        let port = self.raw_port(name, PortKind::Queuing, Direction::Source)?;
        let (writer, observed) = (self.writer(&port)?, self.observed(&port)?);
        let outlet = writer.map(|writer| self.outlet(name, writer, observed));
        Ok((RawQueuingSource::new(outlet, self.time.clone()), port.size as usize))
    }

    /// As [`Context::queuing_destination`], for messages of whatever type the plan says; with the longest one's length,
    /// bytes.
    ///
    /// # Errors
    /// As there.
    pub fn raw_queuing_destination(
        &mut self,
        name: &str,
    ) -> Result<(RawQueuingDestination, usize), StartError> {
        let port = self.raw_port(name, PortKind::Queuing, Direction::Destination)?;
        let bytes = port.size as usize;
        Ok((RawQueuingDestination::new(self.inlet(&port)?, bytes, self.time.clone()), bytes))
    }

    /// What the plan says of the partition's ports.
    pub(crate) fn described_ports(&self) -> &[PortDescription] {
        &self.description.ports
    }

    /// Ports of the plan that were not created are none of the partition's from here on.
    pub(crate) fn leave_ports_out(&mut self) {
        self.used = self.description.ports.iter().map(|port| port.name.clone()).collect();
    }

    /// The message type of a port, by its name and its text with those of the types within it; `None`: the plan has no such port, or one
    /// of plain bytes.
    pub fn message_type(&self, port: &str) -> Option<(&str, &str)> {
        let port = self.description.ports.iter().find(|described| described.name == port)?;
        (!port.is_plain()).then_some((&port.message, &port.definition))
    }

    /// Whether the plan gives the partition a port of this name.
    pub fn has_port(&self, name: &str) -> bool {
        self.description.ports.iter().any(|port| port.name == name)
    }

    /// Names of the ports that the plan declares with this direction and kind, in order; for a partition whose
    /// ports the plan decides, such as Command.
    pub fn port_names(&self, kind: PortKind, direction: Direction) -> Vec<String> {
        let matching =
            self.description.ports.iter().filter(|port| port.kind == kind && port.direction == direction);
        matching.map(|port| port.name.clone()).collect()
    }

    /// Whether the plan declares a port of this kind and direction with this name.
    pub fn declares(&self, kind: PortKind, direction: Direction, name: &str) -> bool {
        let is_it = |port: &&PortDescription| (port.kind, port.direction) == (kind, direction);
        self.description.ports.iter().filter(is_it).any(|port| port.name == name)
    }

    /// CREATE_SAMPLING_PORT, source; `None` if the plan leaves it out.
    pub fn optional_source<T: Message>(
        &mut self,
        name: &str,
    ) -> Result<Option<SamplingSource<T>>, StartError> {
        let declared = self.declares(PortKind::Sampling, Direction::Source, name);
        declared.then(|| self.sampling_source(name)).transpose()
    }

    /// CREATE_SAMPLING_PORT, destination; `None` if the plan leaves it out.
    pub fn optional_destination<T: Message>(
        &mut self,
        name: &str,
    ) -> Result<Option<SamplingDestination<T>>, StartError> {
        let declared = self.declares(PortKind::Sampling, Direction::Destination, name);
        declared.then(|| self.sampling_destination(name)).transpose()
    }

    /// Memory for one value that outlives the partition; may be asked for once.
    pub fn retained<T: FromBytes + IntoBytes + Immutable + KnownLayout>(
        &mut self,
    ) -> Result<Retained<T>, StartError> {
        if std::mem::replace(&mut self.retains, true) {
            return Err(StartError::RetainedTwice);
        }
        Retained::new(self.retained.take(), self.description.retained_bytes, self.time.clone())
    }

    /// GET_MEMORY_BLOCK_STATUS: a memory block that the plan gives this partition.
    ///
    /// # Errors
    /// It gives none with this name.
    pub fn memory_block(&self, name: &str) -> Result<MemoryBlock, StartError> {
        let block = self.memory_blocks.iter().find(|block| block.name() == name);
        block.cloned().ok_or_else(|| {
            let known = names(self.memory_blocks.iter().map(MemoryBlock::name));
            StartError::NoSuchMemoryBlock { name: name.into(), known }
        })
    }

    /// CREATE_LOGBOOK: a logbook that the plan gives this partition.
    ///
    /// # Errors
    /// It gives none with this name.
    pub fn logbook(&self, name: &str) -> Result<Logbook, StartError> {
        let logbook = self.logbooks.iter().find(|logbook| logbook.name() == name).ok_or_else(|| {
            let known = names(self.logbooks.iter().map(Logbook::name));
            StartError::NoSuchLogbook { name: name.into(), known }
        })?;
        logbook.abort_unfinished();
        Ok(logbook.clone())
    }

    /// The module's name services: addresses of service access points by their names.
    pub(crate) fn name_services(&self) -> &BTreeMap<String, BTreeMap<String, SocketAddrV4>> {
        &self.description.name_services
    }

    pub(crate) fn logbooks(&self) -> &[Logbook] {
        &self.logbooks
    }

    pub(crate) fn memory_blocks(&self) -> &[MemoryBlock] {
        &self.memory_blocks
    }

    /// Its number and times in the plan, and what its processes may take.
    pub(crate) fn process_plan(&self) -> ProcessPlan {
        self.description.processes
    }

    /// Its times in schedules in which they are others.
    pub(crate) fn schedule_times(&self) -> &BTreeMap<u32, PartitionTimes> {
        &self.description.schedule_times
    }

    /// What the plan knows of its processes.
    pub(crate) fn planned_processes(&self) -> &[PlannedProcess] {
        &self.description.planned_processes
    }

    /// The module's schedules: which one runs, and asking for another.
    pub fn module_schedules(&self) -> ModuleSchedules {
        let Description { schedules, may_set_schedule, .. } = &self.description;
        ModuleSchedules::new(self.time.clone(), Schedules::new(schedules, may_set_schedule))
    }

    /// As above, for processes.
    pub(crate) fn schedules(&self) -> Schedules {
        Schedules::new(&self.description.schedules, &self.description.may_set_schedule)
    }

    /// What the module's health log says, where the plan lets this partition know; from the oldest entry that still stands.
    pub fn health_notices(&self) -> HealthNotices {
        HealthNotices::new(self.time.clone())
    }

    /// A counted byte stream over an opened device.
    pub fn line<D: Read + Write + AsFd>(&self, device: D) -> Line<D> {
        Line::new(device, self.time.clone())
    }

    /// Nothing of the plan may be left over.
    pub(crate) fn finish(mut self) -> Result<Started, StartError> {
        self.attributes.all_known()?;
        let verdicts = match self.outvoted.take() {
            Some(port) => {
                Some(Verdicts::new(RawSamplingDestination::new(self.reader(&port)?, port, self.time.clone())))
            }
            None => None,
        };
        let is_missed = |port: &&PortDescription| !port.optional && !self.used.contains(&port.name);
        match self.description.ports.iter().find(is_missed) {
            Some(port) => Err(StartError::UnusedPort(port.name.clone())),
            None => Ok(Started {
                faults: self.faults(),
                verdicts,
                outlets: self.outlets.into_iter().map(|(_, outlet)| outlet).collect(),
                connections: self.connections,
                inlets: self.inlets,
                _channels: self.channels,
                _nodes: self.nodes,
            }),
        }
    }

    fn outlet(&mut self, name: &str, writer: Rc<Writer>, observed: Option<Rc<Writer>>) -> Rc<Outlet> {
        let outlet = Rc::new(Outlet::new(writer, observed));
        self.outlets.push((name.to_owned(), outlet.clone()));
        outlet
    }

    /// Faults of ports are ordered by a port's place in the description.
    fn faults(&self) -> Faults {
        let outlet_of = |name: &str| self.outlets.iter().find(|(port, _)| port == name);
        let ports = self.description.ports.iter().map(|port| Some(outlet_of(&port.name)?.1.fault.clone()));
        Faults::new(self.time.page(), ports.collect())
    }

    fn port<T: Message>(
        &mut self,
        name: &str,
        kind: PortKind,
        direction: Direction,
    ) -> Result<PortDescription, StartError> {
        let port = self.declared(name)?;
        let is_it = port.kind == kind && port.direction == direction && port.message == T::NAME;
        // A plan that knows the fields says more than a size.
        let size_fits = port.size as usize == size_of::<T>() || port.layout != 0;
        if !is_it || !size_fits {
            let say = |kind, direction, message: &str, size| {
                format!("{kind:?} {direction:?} of {message} ({size} bytes)")
            };
            return Err(StartError::WrongPort {
                name: name.into(),
                found: say(port.kind, port.direction, &port.message, port.size as usize),
                wanted: say(kind, direction, T::NAME, size_of::<T>()),
            });
        }
        if port.layout != 0 && port.layout != layout_of(T::FIELDS) {
            let found = Type::from_schema(&port.message, &port.definition).map(|of| of.describe());
            let found = found.unwrap_or_else(|_| format!("  {} bytes\n", port.size));
            let (name, wanted) = (name.into(), describe(T::FIELDS));
            return Err(StartError::OtherFields { name, message: T::NAME, found, wanted });
        }
        let port = port.clone();
        self.used.insert(name.into());
        Ok(port)
    }

    /// A port whose message type does not matter.
    fn raw_port(
        &mut self,
        name: &str,
        kind: PortKind,
        direction: Direction,
    ) -> Result<PortDescription, StartError> {
        let port = self.declared(name)?;
        if port.kind != kind || port.direction != direction {
            return Err(StartError::WrongPort {
                name: name.into(),
                found: format!("{:?} {:?}", port.kind, port.direction),
                wanted: format!("{kind:?} {direction:?}"),
            });
        }
        let port = port.clone();
        self.used.insert(name.into());
        Ok(port)
    }

    fn declared(&self, name: &str) -> Result<&PortDescription, StartError> {
        self.description.ports.iter().find(|port| port.name == name).ok_or_else(|| {
            let known: Vec<_> = self.description.ports.iter().map(|port| port.name.as_str()).collect();
            StartError::NoSuchPort { name: name.into(), known: known.join(", ") }
        })
    }

    fn writer(&mut self, port: &PortDescription) -> Result<Option<Rc<Writer>>, StartError> {
        if port.channel.is_empty() {
            return Ok(None);
        }
        let kind = channel_type(port);
        let channel = self.channel_of(port, &kind)?;
        self.writer_of(&kind, channel).map(Some)
    }

    /// The channel on which observers see what a queue carries; a sealed one can be looked at itself.
    fn observed(&mut self, port: &PortDescription) -> Result<Option<Rc<Writer>>, StartError> {
        if port.channel.is_empty() || port.sealed.is_some() {
            return Ok(None);
        }
        let kind = channel_type(port).observed();
        let channel = self.open(&kind)?;
        self.writer_of(&kind, channel).map(Some)
    }

    fn channel_of(&mut self, port: &PortDescription, kind: &ChannelType) -> Result<Channel, StartError> {
        match port.sealed {
            None => self.open(kind),
            Some(at) => Ok(Channel::Sealed(self.handed(port, at)?)),
        }
    }

    /// The memory of a sealed channel. The descriptors stay: a partition may ask for a port again.
    #[allow(unsafe_code)] // numbers that become descriptors
    fn handed(&self, port: &PortDescription, at: SealedDescriptors) -> Result<Handed, StartError> {
        let copy = |number: i32| {
            // SAFETY: the executive left it open where it says so, and nobody in this process closes it.
            let descriptor = unsafe { BorrowedFd::borrow_raw(number) };
            let failed = |error| {
                StartError::Other(format!(
                    "the memory of port \"{}\" was not handed over: {error}",
                    port.name
                ))
            };
            rustix::io::fcntl_dupfd_cloexec(descriptor, 0).map_err(failed)
        };
        Ok(Handed {
            ring: copy(at.ring)?,
            index: at.index.map(copy).transpose()?,
            checked: at.checked,
            incarnation: self.description.generation,
        })
    }

    /// Opens a channel, joining its shared memory first where this is the partition's first port in it.
    fn open(&mut self, kind: &ChannelType) -> Result<Channel, StartError> {
        let home = kind.home();
        if !self.nodes.contains_key(home) {
            let node = self.domain.join(home, &self.description.partition)?;
            self.nodes.insert(home.into(), node);
        }
        Ok(kind.open(&self.nodes[home])?)
    }

    fn writer_of(&mut self, kind: &ChannelType, channel: Channel) -> Result<Rc<Writer>, StartError> {
        let writer = Rc::new(kind.writer(&channel)?);
        self.hold(channel);
        self.connections.push(writer.clone());
        Ok(writer)
    }

    /// What was mapped stays without its descriptor.
    fn hold(&mut self, channel: Channel) {
        self.channels.extend(Some(channel).filter(|channel| matches!(channel, Channel::Shared(_))));
    }

    fn inlet(&mut self, port: &PortDescription) -> Result<Option<Rc<Inlet>>, StartError> {
        if port.channel.is_empty() {
            return Ok(None);
        }
        let kind = channel_type(port);
        let channel = self.channel_of(port, &kind)?;
        let inlet = Rc::new(Inlet::new(kind, channel));
        if !self.description.standby {
            inlet.attach()?;
        }
        self.inlets.push(inlet.clone());
        self.connections.push(inlet.clone());
        Ok(Some(inlet))
    }

    fn reader(&mut self, port: &PortDescription) -> Result<Option<Rc<Reader>>, StartError> {
        if port.channel.is_empty() {
            return Ok(None);
        }
        let kind = channel_type(port);
        let channel = self.channel_of(port, &kind)?;
        let reader = Rc::new(kind.reader(&channel)?);
        self.hold(channel);
        self.connections.push(reader.clone());
        Ok(Some(reader))
    }
}

/// What must live as long as the partition runs.
pub(crate) struct Started {
    pub(crate) connections: Vec<Rc<dyn Connect>>,
    pub(crate) outlets: Vec<Rc<Outlet>>,
    pub(crate) inlets: Vec<Rc<Inlet>>,
    pub(crate) faults: Faults,
    verdicts: Option<Verdicts>,
    _channels: Vec<Channel>,
    _nodes: BTreeMap<String, Membership>,
}

impl Started {
    /// Meets every peer that is there.
    pub(crate) fn connect(&self) {
        self.connections.iter().for_each(|port| port.connect());
    }

    /// A window begins: faults that were ordered are carried out, and verdicts handed on.
    pub(crate) fn begin_window(&mut self, page: &ControlPage, start_ns: u64) {
        self.faults.carry_out(page);
        self.outlets.iter().for_each(|outlet| outlet.catch_up(start_ns));
        if let Some(verdicts) = &mut self.verdicts {
            verdicts.hand_on(page, start_ns);
        }
    }

    /// Receives what queues carry from now on, where it stood by until now.
    pub(crate) fn attach(&self) -> Result<(), StartError> {
        self.inlets.iter().try_for_each(|inlet| Ok(inlet.attach()?))
    }
}

fn channel_type(port: &PortDescription) -> ChannelType {
    ChannelType {
        name: port.channel.clone(),
        message: port.message.clone(),
        size: port.size as usize,
        depth: (port.kind == PortKind::Queuing).then_some(port.depth.max(1) as usize),
        destinations: 1,
        spare_writers: 0,
        spare_readers: 0,
    }
}
