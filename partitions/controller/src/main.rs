//! The function that flies: specific-acceleration loops, roll-rate loop and guidance.

use std::process::ExitCode;

use bateleur_apex::{
    Context, Partition, Retained, SamplingDestination, SamplingSource, StartError, Takeover, Window,
};
use bateleur_controller::{
    Answer, Function, Memory, Sensors, Settings, navigation_state, parameters, planned_waypoints,
};
use bateleur_flight::estimator::NavigationState;
use bateleur_flight::guidance::Waypoint;
use bateleur_function_shell::{FunctionShell, Verdict};
use bateleur_messages::control::{NO_POWER, PITOT_NOT_BELIEVED, STALLED};
use bateleur_messages::ground::Order;
use bateleur_messages::telemetry::{FROM_CONTROLLER, Telemetry};
use bateleur_messages::{
    Acceleration, ActuatorCommand, FunctionStatus, Pressure, Range, Rate, Rates, State, Watch,
};

pub(crate) struct ControllerPartition {
    function: Function,
    shell: FunctionShell<Settings>,
    /// What the plan says.
    planned: Vec<Waypoint>,
    retained: Retained<Memory>,
    starts: u64,
    /// [`ActuatorCommand::protection`] of the last window.
    told: u32,
    inputs: InputPorts,
    command: SamplingSource<ActuatorCommand>,
    status: SamplingSource<FunctionStatus>,
    rate: SamplingDestination<Rate>,
    timeout_1: Watch,
    timeout_3: Watch,
}

struct InputPorts {
    state: SamplingDestination<State>,
    acceleration: SamplingDestination<Acceleration>,
    orientation: SamplingDestination<Rates>,
    pressure: SamplingDestination<Pressure>,
    /// Where the plan has it.
    range: Option<SamplingDestination<Range>>,
    /// What the voter of its replicas hands on, where the plan gives it back to them.
    voted: Option<SamplingDestination<ActuatorCommand>>,
}

impl Partition for ControllerPartition {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let plan = Settings::read(context.attributes())?;
        let planned = planned_waypoints(context.attributes())?;
        let mut retained: Retained<Memory> = context.retained()?;
        let mut shell = FunctionShell::open(context, FROM_CONTROLLER, plan, parameters)?;
        Ok(Self {
            function: resume(&mut shell, &planned, &mut retained)?,
            shell,
            planned,
            retained,
            starts: u64::from(context.generation()) + 1,
            told: 0,
            inputs: InputPorts {
                state: context.sampling_destination("state")?,
                acceleration: context.sampling_destination("acceleration")?,
                orientation: context.sampling_destination("orientation")?,
                pressure: context.sampling_destination("pressure")?,
                range: context.optional_destination("range")?,
                voted: context.optional_destination("voted")?,
            },
            command: context.sampling_source("command")?,
            status: context.sampling_source("status")?,
            rate: context.sampling_destination("rate")?,
            timeout_1: Watch::default(),
            timeout_3: Watch::default(),
        })
    }

    fn take_over(&mut self, _takeover: &Takeover) {
        // What the plan says was accepted at the start, and what was kept is judged before it is used.
        if let Ok(function) = resume(&mut self.shell, &self.planned, &mut self.retained) {
            self.function = function;
        }
    }

    fn window(&mut self, window: &Window) {
        let now_ns = window.start_ns();
        let (state, sensors) = self.inputs.read();
        if let Some((voted, voted_ns)) = self.inputs.voted(window.now_ns()) {
            self.function.equalise(&voted, voted_ns, window.minor_frame_ns());
        }
        self.shell.take_orders(
            now_ns,
            &mut self.function,
            |function, settings| function.configure(settings),
            |function, _, one, _| order(function, &one, state.is_some()),
        );
        let command = self.function.step(now_ns, window.minor_frame_ns(), state.as_ref(), &sensors);
        self.tell(window, command.protection);
        self.command.write(&command);
        self.status.write(&self.function.status(self.starts));
        self.retained.store(&Memory { function: self.function.kept(), parameters: *self.shell.changed() });
        self.send_telemetry(now_ns);
    }
}

/// The function as retained memory has it.
fn resume(
    shell: &mut FunctionShell<Settings>,
    planned: &[Waypoint],
    retained: &mut Retained<Memory>,
) -> Result<Function, StartError> {
    let memory = retained.load();
    let settings = shell.resume(memory.as_ref().map(|memory| &memory.parameters));
    Function::new(settings, planned, memory.as_ref().map(|memory| &memory.function))
        .map_err(|error| StartError::Other(format!("attribute waypoints: {error}")))
}

fn order(function: &mut Function, order: &Order, ready: bool) -> Verdict {
    match function.order(order, ready) {
        Answer::Accepted => Verdict::Accepted,
        Answer::Refused(why) => Verdict::Refused(why),
        Answer::NotUnderstood => Verdict::NotUnderstood,
    }
}

impl ControllerPartition {
    /// The health log has it when the verdict on the pitot, the motor or the wing changes.
    fn tell(&mut self, window: &Window, protection: u32) {
        let verdicts = [
            (
                PITOT_NOT_BELIEVED,
                "the pitot is not believed: airspeed by lift",
                "the pitot is believed again",
            ),
            (NO_POWER, "no power: gliding to the runway", "the motor drives again"),
            (STALLED, "the wing has stalled: nose down, and faster from now on", "the wing carries again"),
        ];
        let before = std::mem::replace(&mut self.told, protection);
        for (bit, on, off) in verdicts {
            match (before & bit != 0, protection & bit != 0) {
                (false, true) => window.raise(on),
                (true, false) => window.report(off),
                _ => {}
            }
        }
    }

    fn send_telemetry(&mut self, now_ns: u64) {
        let Some(rate) = self.rate.read_valid() else { return };
        let navigation_due = self.timeout_1.changed(rate.timeout_1);
        let loops_due = self.timeout_3.changed(rate.timeout_3);
        if navigation_due {
            self.shell.send(&Telemetry::Navigation(self.function.navigation(now_ns)));
        }
        if loops_due {
            self.shell.send(&Telemetry::Loops(self.function.loops(now_ns)));
        }
    }
}

impl InputPorts {
    fn read(&mut self) -> (Option<NavigationState>, Sensors) {
        let state = self.state.read_valid().and_then(navigation_state);
        let acceleration = self.acceleration.read_valid();
        let range = self.range.as_mut().and_then(SamplingDestination::read_updated);
        let range_m = range.map(|range| range.distance_m);
        (state, Sensors::of(acceleration, self.orientation.read_valid(), self.pressure.read_valid(), range_m))
    }

    /// A fresh vote, and when it was taken, ns.
    fn voted(&mut self, now_ns: u64) -> Option<(ActuatorCommand, u64)> {
        let voted = self.voted.as_mut()?.read().filter(|voted| voted.valid && voted.updated)?;
        Some((*voted.value, now_ns.saturating_sub(voted.age_ns)))
    }
}

pub(crate) fn main() -> ExitCode {
    bateleur_apex::run::<ControllerPartition>()
}
