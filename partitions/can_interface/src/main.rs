//! The function that has sensors and actuators on a CAN bus.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::os::fd::AsFd;
use std::process::ExitCode;

use bateleur_apex::{
    Context, Direction, Partition, PortKind, RawSamplingDestination, RawSamplingSource, Retained,
    SamplingDestination, SamplingSource, Stamp, StartError, Supervision, SupervisionEvent, Takeover, Window,
};
use bateleur_can_core::bus::BusName;
use bateleur_can_core::wire::native;
use bateleur_can_core::{Counters, Ids, Settings as GatewaySettings, identity};
use bateleur_can_interface::{
    Actuators, Conversation, Kept, Moment, OWN_PORTS, Sensors, Settings, Waiting, Wires, nothing_for,
};
use bateleur_function_shell::FunctionShell;
use bateleur_messages::parameter::Parameters;
use bateleur_messages::telemetry::FROM_HIL_INTERFACE;
use bateleur_messages::{
    Catalogue, Custom, FunctionStatus, Message, Range, Rate, RawAnalog, RawGps, ServoTimers, SimulatorLink,
    Type,
};

/// What is left of the window when the wait for sensors ends, ns: to decode and publish what came.
const PUBLISH_NS: u64 = 200_000;

struct CanInterface {
    conversation: Conversation,
    wires: Wires,
    supervision: Supervision,
    kept: Kept,
    retained: Retained<Kept>,
    starts: u64,
    measured_ns: u64,
    rate: SamplingDestination<Rate>,
    timers: Option<SamplingDestination<ServoTimers>>,
    raw_analog: Option<SamplingSource<RawAnalog>>,
    raw_gps: Option<SamplingSource<RawGps>>,
    custom: Option<SamplingSource<Custom>>,
    range: Option<SamplingSource<Range>>,
    /// Further ports of the plan, whose messages come from frames, and are sent as frames.
    received: Vec<(RawSamplingSource, u64)>,
    sent: Vec<RawSamplingDestination>,
    status: SamplingSource<FunctionStatus>,
    link: Option<SamplingSource<SimulatorLink>>,
    shell: FunctionShell<()>,
}

impl Partition for CanInterface {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let mut retained: Retained<Kept> = context.retained()?;
        let enabled: bool = context.attribute("enabled", true)?;
        let others = Others::of(context);
        let conversation = conversation(context, &others)?;
        same_messages(context, &conversation, &others)?;
        let mut settings = settings(context)?;
        settings.gateway.ring.newest_wins = newest_of(&conversation)?;
        let wires = Wires::open(settings).map_err(StartError::Other)?;
        Ok(Self {
            raw_analog: source(context, &conversation, "raw_analog")?,
            raw_gps: source(context, &conversation, "raw_gps")?,
            custom: source(context, &conversation, "custom")?,
            range: source(context, &conversation, "range")?,
            received: others.sources(context)?,
            sent: others.destinations(context)?,
            conversation,
            wires,
            supervision: Supervision::default(),
            kept: retained.load().unwrap_or(Kept { enabled: u64::from(enabled), cycles: 0 }),
            retained,
            starts: u64::from(context.generation()) + 1,
            measured_ns: 0,
            rate: context.sampling_destination("rate")?,
            timers: context.optional_destination("timers")?,
            status: context.sampling_source("status")?,
            link: context.optional_source("link")?,
            // The ground knows it as the function that it stands for.
            shell: FunctionShell::open(context, FROM_HIL_INTERFACE, (), no_parameters)?,
        })
    }

    fn take_over(&mut self, _takeover: &Takeover) {
        self.kept = self.retained.load().unwrap_or(self.kept);
    }

    fn window(&mut self, window: &Window) {
        if let Some(on) = self.shell.take_switch(window.start_ns()) {
            self.switch(on);
        }
        if self.kept.enabled == 1 {
            let sensors = self.ask(window);
            self.publish(&sensors, window.start_ns());
            self.supervise(window, self.conversation.came(&sensors));
            self.kept.cycles += 1;
            self.retained.store(&self.kept);
        } else {
            self.conversation.pass_over(window.start_ns(), &mut self.wires);
        }
        self.wires.events.drain(..).for_each(|event| window.report(&event));
        self.status.write(&self.function_status());
        let report = self.report(window.start_ns());
        if let Some(link) = &mut self.link {
            link.write(&report);
        }
    }
}

impl CanInterface {
    fn switch(&mut self, on: bool) {
        if self.kept.enabled != u64::from(on) {
            self.kept.enabled = u64::from(on);
            self.supervision = Supervision::default();
            self.retained.store(&self.kept);
        }
    }

    fn ask(&mut self, window: &Window) -> Sensors {
        let cutoff_ns = self.rate.read_valid().map(|rate| rate.sensor_cutoff_ns);
        let latest_ns = window.end_ns().saturating_sub(PUBLISH_NS);
        // A cut-off that is over belongs to another window of this cycle.
        let cutoff_ns = cutoff_ns.filter(|cutoff_ns| *cutoff_ns > window.start_ns());
        let deadline_ns = cutoff_ns.map_or(latest_ns, |cutoff_ns| cutoff_ns.min(latest_ns));
        let moment = Moment { module_ns: window.start_ns(), deadline_ns };
        // The last values stand, however old they are, as the pulse of a real actuator board would.
        let timers = self.timers.as_mut().and_then(|timers| timers.read().map(|reading| *reading.value));
        let others = self.sent.iter_mut().map(|port| port.read().map(|reading| reading.bytes.to_vec()));
        let actuators =
            Actuators { timers: timers.unwrap_or(ServoTimers::AT_REST), others: others.collect() };
        self.conversation.exchange(&actuators, &moment, &mut self.wires, &Clock(window))
    }

    fn publish(&mut self, sensors: &Sensors, now_ns: u64) {
        fn put<T: Message>(port: &mut Option<SamplingSource<T>>, value: Option<&T>) {
            if let (Some(port), Some(value)) = (port, value) {
                port.write(value);
            }
        }
        if let Some(analog) = &sensors.analog {
            self.measured_ns = analog.measured_ns;
        }
        put(&mut self.raw_analog, sensors.analog.as_ref());
        put(&mut self.raw_gps, sensors.gps.as_ref());
        put(&mut self.custom, sensors.custom.as_ref());
        put(&mut self.range, sensors.range.as_ref());
        for (place, message) in &sensors.others {
            if let Some((port, sequence)) = self.received.get_mut(*place) {
                *sequence += 1;
                port.write(message, Stamp { source_ns: now_ns, sequence: *sequence });
            }
        }
    }

    fn supervise(&mut self, window: &Window, came: Option<bool>) {
        let Some(came) = came else { return };
        match self.supervision.note(came) {
            Some(SupervisionEvent::Gone) => window.raise("no sensors come from the CAN bus"),
            Some(SupervisionEvent::Back) => window.report("sensors come from the CAN bus again"),
            None => {}
        }
    }

    fn network(&self) -> Counters {
        self.wires.gateway().map(|gateway| gateway.counters()).unwrap_or_default()
    }

    fn function_status(&self) -> FunctionStatus {
        let (counts, network) = (self.conversation.counts(), self.network());
        FunctionStatus {
            enabled: self.kept.enabled as u32, // 0 or 1
            ready: u32::from(
                self.kept.enabled == 1 && (self.supervision.is_ready() || !self.conversation.hears()),
            ),
            accepted: counts.accepted,
            refused: counts.missing + counts.withheld + network.lost() + self.wires.refused,
            starts: self.starts,
        }
    }

    fn report(&self, time_ns: u64) -> SimulatorLink {
        let (counts, network) = (self.conversation.counts(), self.network());
        SimulatorLink {
            time_ns,
            measured_ns: self.measured_ns,
            accepted: counts.accepted,
            missing: counts.missing,
            repeated: counts.repeated,
            stale: counts.stale,
            invalid: counts.incomplete + counts.withheld,
            refused: network.malformed + network.foreign + network.other_version,
            unused: counts.foreign,
            lost: network.lost() + self.wires.refused + self.wires.losses().unkept,
            strangers: network.strangers + network.same_identity,
            errors: network.unsent_datagrams,
            lockstep: 1,
            ..SimulatorLink::default()
        }
    }
}

fn no_parameters() -> Parameters<()> {
    Parameters::new(FROM_HIL_INTERFACE, &[])
}

struct Clock<'a>(&'a Window);

impl Waiting for Clock<'_> {
    fn now_ns(&self) -> u64 {
        self.0.now_ns()
    }

    fn wait_readable(&self, device: &impl AsFd, until_ns: u64) -> bool {
        self.0.wait_readable(device, until_ns)
    }
}

/// A source that the plan declares and the table fills; one without the other is a slip of the pen.
fn source<T: Message>(
    context: &mut Context,
    conversation: &Conversation,
    name: &str,
) -> Result<Option<SamplingSource<T>>, StartError> {
    match (context.declares(PortKind::Sampling, Direction::Source, name), conversation.has(name)) {
        (true, true) => context.sampling_source(name).map(Some),
        (true, false) => Err(StartError::Other(nothing_for(name))),
        _ => Ok(None),
    }
}

/// Sampling ports that the plan gives this partition beyond the function's own.
struct Others {
    /// Their messages come from frames.
    sources: Vec<String>,
    /// Their messages are sent as frames.
    destinations: Vec<String>,
}

impl Others {
    fn of(context: &Context) -> Self {
        let others = |direction, own: &[&str]| {
            let mut names = context.port_names(PortKind::Sampling, direction);
            names.retain(|name| !OWN_PORTS.contains(&name.as_str()) && !own.contains(&name.as_str()));
            names
        };
        Self {
            sources: others(Direction::Source, &["status", "link"]),
            destinations: others(Direction::Destination, &["rate"]),
        }
    }

    /// The flight's message types and those of these ports.
    fn types(&self, context: &Context) -> Result<Catalogue, StartError> {
        let described = self.sources.iter().chain(&self.destinations);
        let described = described.filter_map(|port| context.message_type(port));
        let read = described.map(|(name, text)| Type::from_schema(name, text));
        let types: Vec<Type> =
            read.collect::<Result<_, _>>().map_err(|error| StartError::Other(error.to_string()))?;
        Ok(bateleur_messages::catalogue().and(types))
    }

    fn sources(&self, context: &mut Context) -> Result<Vec<(RawSamplingSource, u64)>, StartError> {
        self.sources.iter().map(|name| Ok((context.raw_sampling_source(name)?.0, 0))).collect()
    }

    fn destinations(&self, context: &mut Context) -> Result<Vec<RawSamplingDestination>, StartError> {
        self.destinations.iter().map(|name| Ok(context.raw_sampling_destination(name)?.0)).collect()
    }
}

/// Plan and table say the same of each port that both have.
fn same_messages(context: &Context, conversation: &Conversation, others: &Others) -> Result<(), StartError> {
    let own = OWN_PORTS.into_iter().filter(|port| conversation.has(port) && context.has_port(port));
    let others = others.sources.iter().chain(&others.destinations).map(String::as_str);
    for port in own.chain(others) {
        let of_plan = context.message_type(port).map_or("plain bytes", |(name, _)| name);
        let of_table = conversation.message(port).unwrap_or("nothing");
        if of_plan != of_table {
            return Err(StartError::Other(format!(
                "port {port} carries {of_plan} in the plan, and {of_table} in the table of CAN frames (attribute table): let them say the same"
            )));
        }
    }
    Ok(())
}

fn conversation(context: &mut Context, others: &Others) -> Result<Conversation, StartError> {
    let table: String = context.attribute("table", bateleur_can_map::DISTRIBUTION_BOARD.into())?;
    let dbc: Option<String> = context.attribute("dbc", None)?;
    let table = bateleur_can_map::from_attributes(&table, dbc.as_deref(), &others.types(context)?)
        // One line: of a refusal the executive tells the last one.
        .map_err(|error| error.to_string().replace('\n', "; "))
        .map_err(|error| StartError::Other(format!("attributes table and dbc: {error}")))?;
    Conversation::new(table, &others.sources, &others.destinations).map_err(StartError::Other)
}

/// What it sends again and again: a board that is found must not be given a second of old commands.
fn newest_of(conversation: &Conversation) -> Result<Ids, StartError> {
    let said: Vec<String> = conversation.said().map(|id| id.to_string()).collect();
    if said.is_empty() {
        return Ok(Ids::None);
    }
    said.join(",").parse().map_err(|error| StartError::Other(format!("attribute table: {error}")))
}

fn settings(context: &mut Context) -> Result<Settings, StartError> {
    let other = |text: String| StartError::Other(text);
    let bus: String = context.attribute("bus", "none".into())?;
    // A device is granted by an attribute of this name.
    let device: Option<String> = context.attribute("device", None)?;
    let bus = match (bus.as_str(), &device) {
        ("slcan", Some(device)) => {
            let rate: Option<u32> = context.attribute("bit_rate", None)?;
            let baud: Option<u32> = context.attribute("baud", None)?;
            let rate = rate.map_or(String::new(), |rate| format!("@{rate}"));
            format!("slcan:{device}{rate}{}", baud.map_or(String::new(), |baud| format!(",{baud}")))
        }
        ("slcan", None) => {
            return Err(other("attribute bus = \"slcan\": at which device? attribute device says it".into()));
        }
        _ => bus,
    };
    let bus: BusName = bus.parse().map_err(|error| other(format!("attribute bus: {error}")))?;
    let usual =
        (bus == BusName::None).then(|| SocketAddr::from((Ipv4Addr::UNSPECIFIED, native::PORT)).to_string());
    let listen: Option<String> = context.attribute("listen", usual)?;
    let address = |name: &str, text: &str| {
        let wrong = |_| {
            other(format!(
                "attribute {name} = \"{text}\" is no address; give one such as \"10.0.0.2:{}\"",
                native::PORT
            ))
        };
        text.parse::<SocketAddr>().map_err(wrong)
    };
    let listen = listen.map(|text| address("listen", &text)).transpose()?;
    let everybody = vec![SocketAddr::from((Ipv4Addr::BROADCAST, native::PORT)).to_string()];
    let peers: Vec<String> = match context.attribute::<Option<String>>("peer", None)? {
        Some(peer) => vec![peer],
        None => context.attribute("peers", everybody)?,
    };
    let peers = peers.iter().map(|text| address("peers", text)).collect::<Result<_, _>>()?;
    let identity: Option<String> = context.attribute("identity", None)?;
    let identity = match identity {
        None => identity::usual_identity(context.name(), native::PORT),
        Some(text) => u64::from_str_radix(&text, 16)
            .map_err(|_| other(format!("attribute identity = \"{text}\": up to 16 hexadecimal digits")))?,
    };
    let only_from: Vec<String> = context.attribute("only_from", Vec::new())?;
    let only_from = only_from.iter().map(|text| {
        text.parse::<IpAddr>().map_err(|_| {
            other(format!(
                "attribute only_from: \"{text}\" is no address of a computer, such as \"10.0.0.2\""
            ))
        })
    });
    let only_from = only_from.collect::<Result<_, _>>()?;
    let gateway = GatewaySettings { only_from, ..GatewaySettings::new(identity, identity::session(), peers) };
    Ok(Settings { bus, listen, gateway })
}

pub(crate) fn main() -> ExitCode {
    bateleur_apex::run::<CanInterface>()
}
