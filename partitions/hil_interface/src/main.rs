//! The function that exchanges sensors and actuators with a simulator.

use std::os::fd::AsFd;
use std::process::ExitCode;

use bateleur_apex::{
    Context, Partition, Retained, SamplingDestination, SamplingSource, StartError, Supervision,
    SupervisionEvent, Takeover, Window,
};
use bateleur_function_shell::FunctionShell;
use bateleur_hil_interface::{Conversation, Kept, Moment, Numbers, Sensors, Settings, Waiting, parameters};
use bateleur_messages::hil::{Protocol, UnknownProtocol};
use bateleur_messages::telemetry::FROM_HIL_INTERFACE;
use bateleur_messages::{
    Custom, FunctionStatus, Range, Rate, RawAnalog, RawGps, ServoTimers, SimulatorLink, Watch,
};

/// What is left of the window when the wait for the simulator ends, ns: to decode and publish what came. Too little, and
/// the window is overrun; too much, and a late answer is missed.
const PUBLISH_NS: u64 = 200_000;

pub(crate) struct HilInterface {
    conversation: Conversation,
    supervision: Supervision,
    timeout: Watch,
    /// Faults of the link when they were last told.
    faults_told: u64,
    kept: Kept,
    retained: Retained<Kept>,
    starts: u64,
    rate: SamplingDestination<Rate>,
    timers: SamplingDestination<ServoTimers>,
    raw_analog: SamplingSource<RawAnalog>,
    raw_gps: SamplingSource<RawGps>,
    custom: SamplingSource<Custom>,
    /// Where the plan has it.
    range: Option<SamplingSource<Range>>,
    status: SamplingSource<FunctionStatus>,
    /// Where the plan has it.
    link: Option<SamplingSource<SimulatorLink>>,
    shell: FunctionShell<Numbers>,
}

impl Partition for HilInterface {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let mut retained: Retained<Kept> = context.retained()?;
        let from_the_start: bool = context.attribute("hil_mode", false)?;
        let at_start = Kept { sequence: 0, enabled: u64::from(from_the_start) };
        let (conversation, numbers) = open(context, from_the_start)?;
        Ok(Self {
            conversation,
            supervision: Supervision::default(),
            timeout: Watch::default(),
            faults_told: 0,
            kept: retained.load().unwrap_or(at_start),
            retained,
            starts: u64::from(context.generation()) + 1,
            rate: context.sampling_destination("rate")?,
            timers: context.sampling_destination("timers")?,
            raw_analog: context.sampling_source("raw_analog")?,
            raw_gps: context.sampling_source("raw_gps")?,
            custom: context.sampling_source("custom")?,
            range: context.optional_source("range")?,
            status: context.sampling_source("status")?,
            link: context.optional_source("link")?,
            shell: FunctionShell::open(context, FROM_HIL_INTERFACE, numbers, parameters)?,
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
            self.publish(&sensors);
            self.supervise(window, sensors.analog.is_some());
            self.conversation.remarks().iter().for_each(|remark| window.report(remark));
            self.retained.store(&self.kept);
        }
        self.status.write(&self.function_status());
        if let Some(link) = &mut self.link {
            link.write(&self.conversation.report(window.start_ns()));
        }
        if self.rate.read_valid().is_some_and(|rate| self.timeout.changed(rate.timeout_1)) {
            self.complain(window);
        }
    }
}

impl HilInterface {
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
        self.kept.sequence += 1;
        let moment = Moment {
            module_ns: window.start_ns(),
            sequence: self.kept.sequence,
            deadline_ns: cutoff_ns.map_or(latest_ns, |cutoff_ns| cutoff_ns.min(latest_ns)),
        };
        // The last values stand, however old they are, as the pulse of a real actuator board would.
        let timers = self.timers.read().map_or(ServoTimers::AT_REST, |reading| *reading.value);
        self.conversation.exchange(&timers, &moment, &Clock(window))
    }

    fn publish(&mut self, sensors: &Sensors) {
        sensors.analog.iter().for_each(|analog| self.raw_analog.write(analog));
        sensors.gps.iter().for_each(|gps| self.raw_gps.write(gps));
        sensors.custom.iter().for_each(|custom| self.custom.write(custom));
        if let (Some(port), Some(range)) = (&mut self.range, &sensors.range) {
            port.write(range);
        }
    }

    fn supervise(&mut self, window: &Window, answered: bool) {
        let simulator = self.conversation.simulator();
        match self.supervision.note(answered) {
            Some(SupervisionEvent::Gone) => {
                window.raise(&format!("simulator at {simulator} does not answer"))
            }
            Some(SupervisionEvent::Back) => window.report(&format!("simulator at {simulator} answers again")),
            None => {}
        }
    }

    /// Says what could not be taken, where that has become twice as much: a lossy link must not fill the health log.
    fn complain(&mut self, window: &Window) {
        let counters = self.conversation.counters();
        if counters.faults() < 2 * self.faults_told.max(1) {
            return;
        }
        self.faults_told = counters.faults();
        window.report(&format!(
            "simulator link: {} refused, {} invalid, {} of strangers, {} socket errors so far",
            counters.refused, counters.invalid, counters.strangers, counters.errors
        ));
    }

    fn function_status(&self) -> FunctionStatus {
        let counters = self.conversation.counters();
        FunctionStatus {
            enabled: self.kept.enabled as u32, // 0 or 1
            ready: u32::from(self.kept.enabled == 1 && self.supervision.is_ready()),
            accepted: counters.accepted,
            refused: counters.refused_in_all(),
            starts: self.starts,
        }
    }
}

struct Clock<'a>(&'a Window);

impl Waiting for Clock<'_> {
    fn now_ns(&self) -> u64 {
        self.0.now_ns()
    }

    fn wait_readable(&self, device: &impl AsFd, until_ns: u64) -> bool {
        self.0.wait_readable(device, until_ns)
    }

    fn wait_shortly(&self, device: &impl AsFd, until_ns: u64) -> bool {
        self.0.wait_readable_shortly(device, until_ns)
    }

    fn wait_writable(&self, device: &impl AsFd, until_ns: u64) -> bool {
        self.0.wait_writable(device, until_ns)
    }
}

/// A port that a plan may leave out.
fn open(context: &mut Context, hil_mode: bool) -> Result<(Conversation, Numbers), StartError> {
    let protocol: String = context.attribute("protocol", Protocol::default().name().into())?;
    let protocol = protocol
        .parse()
        .map_err(|error: UnknownProtocol| StartError::Other(format!("attribute protocol: {error}")))?;
    let simulator: Option<String> = context.attribute("simulator", None)?;
    let listen: Option<String> = context.attribute("listen", None)?;
    let settings = Settings {
        protocol,
        simulator: simulator.as_deref(),
        listen: listen.as_deref(),
        lockstep: context.attribute("lockstep", true)?,
        system: context.attribute("system", 1)?,
        simulator_system: context.attribute("simulator_system", 0)?,
    };
    let Settings { lockstep, system, simulator_system, .. } = settings;
    let numbers = Numbers { protocol, lockstep, hil_mode, system, simulator_system };
    let conversation = Conversation::open(&settings).map_err(|error| StartError::Other(error.to_string()))?;
    Ok((conversation, numbers))
}

pub(crate) fn main() -> ExitCode {
    bateleur_apex::run::<HilInterface>()
}
