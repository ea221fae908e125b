//! The function that flies: specific-acceleration loops, roll-rate loop and guidance.

use std::process::ExitCode;

use bateleur_apex::{
    Context, Partition, QueuingDestination, QueuingSource, Retained, SamplingDestination, SamplingSource,
    StartError, Takeover, Window,
};
use bateleur_controller::{
    Answer, Function, Memory, Sensors, Settings, navigation_state, parameters, planned_waypoints,
};
use bateleur_flight::estimator::NavigationState;
use bateleur_flight::guidance::Waypoint;
use bateleur_messages::ground::Order;
use bateleur_messages::parameter::Parameters;
use bateleur_messages::telemetry::{ACCEPTED, Acknowledge, FROM_CONTROLLER, NOT_UNDERSTOOD, Telemetry};
use bateleur_messages::{
    Acceleration, ActuatorCommand, FunctionStatus, GroundMessage, Pressure, Rate, Rates, State,
    TelemetryMessage, Watch,
};

/// Ground messages taken in one window at most; a list of way-points takes a few windows.
const ORDERS_PER_WINDOW: usize = 8;
struct ControllerPartition {
    function: Function,
    /// What the plan says.
    plan: Settings,
    planned: Vec<Waypoint>,
    /// The same, and what the ground has set since.
    settings: Settings,
    parameters: Parameters<Settings>,
    retained: Retained<Memory>,
    starts: u64,
    inputs: InputPorts,
    command: SamplingSource<ActuatorCommand>,
    status: SamplingSource<FunctionStatus>,
    rate: SamplingDestination<Rate>,
    ground: QueuingDestination<GroundMessage>,
    telemetry: QueuingSource<TelemetryMessage>,
    timeout_1: Watch,
    timeout_3: Watch,
}

struct InputPorts {
    state: SamplingDestination<State>,
    acceleration: SamplingDestination<Acceleration>,
    orientation: SamplingDestination<Rates>,
    pressure: SamplingDestination<Pressure>,
}

impl Partition for ControllerPartition {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let plan = Settings::read(context.attributes())?;
        let planned = planned_waypoints(context.attributes())?;
        let mut retained: Retained<Memory> = context.retained()?;
        let Resumed { function, settings, parameters } = resume(plan, &planned, &mut retained)?;
        Ok(Self {
            function,
            plan,
            planned,
            settings,
            parameters,
            retained,
            starts: u64::from(context.generation()) + 1,
            inputs: InputPorts {
                state: context.sampling_destination("state")?,
                acceleration: context.sampling_destination("acceleration")?,
                orientation: context.sampling_destination("orientation")?,
                pressure: context.sampling_destination("pressure")?,
            },
            command: context.sampling_source("command")?,
            status: context.sampling_source("status")?,
            rate: context.sampling_destination("rate")?,
            ground: context.queuing_destination("ground")?,
            telemetry: context.queuing_source("telemetry")?,
            timeout_1: Watch::default(),
            timeout_3: Watch::default(),
        })
    }

    fn take_over(&mut self, _takeover: &Takeover) {
        // What the plan says was accepted at the start, and what was kept is judged before it is used.
        if let Ok(resumed) = resume(self.plan, &self.planned, &mut self.retained) {
            let Resumed { function, settings, parameters } = resumed;
            (self.function, self.settings, self.parameters) = (function, settings, parameters);
        }
    }

    fn window(&mut self, window: &Window) {
        let now_ns = window.start_ns();
        let (state, sensors) = self.inputs.read();
        self.take_orders(now_ns, state.is_some());
        let command = self.function.step(now_ns, window.minor_frame_ns(), state.as_ref(), &sensors);
        self.command.write(&command);
        self.status.write(&self.function.status(self.starts));
        self.retained
            .store(&Memory { function: self.function.kept(), parameters: *self.parameters.changed() });
        self.send_telemetry(now_ns);
    }
}

/// A function as retained memory has it.
struct Resumed {
    function: Function,
    settings: Settings,
    parameters: Parameters<Settings>,
}

fn resume(
    plan: Settings,
    planned: &[Waypoint],
    retained: &mut Retained<Memory>,
) -> Result<Resumed, StartError> {
    let (memory, mut settings, mut parameters) = (retained.load(), plan, parameters());
    if let Some(memory) = &memory {
        parameters.resume(&memory.parameters, &mut settings);
    }
    let function = Function::new(settings, planned, memory.as_ref().map(|memory| &memory.function))
        .map_err(|error| StartError::Other(format!("attribute waypoints: {error}")))?;
    Ok(Resumed { function, settings, parameters })
}

impl ControllerPartition {
    fn take_orders(&mut self, now_ns: u64, ready: bool) {
        for _ in 0..ORDERS_PER_WINDOW {
            let Some(message) = self.ground.receive() else { return };
            if let Some(answer) = self.parameters.take(&message, &mut self.settings, now_ns) {
                if answer.changed {
                    self.function.configure(&self.settings);
                }
                answer.messages().for_each(|message| {
                    self.telemetry.send(&message);
                });
                continue;
            }
            let order = Order::parse(message.letter, message.bytes());
            let answer = order.map_or(Answer::NotUnderstood, |order| self.function.order(&order, ready));
            let answer = match answer {
                Answer::Accepted => Acknowledge::of(&message, FROM_CONTROLLER, ACCEPTED, now_ns),
                Answer::Refused(why) => Acknowledge::refused(&message, FROM_CONTROLLER, why, now_ns),
                Answer::NotUnderstood => Acknowledge::of(&message, FROM_CONTROLLER, NOT_UNDERSTOOD, now_ns),
            };
            self.telemetry.send(&TelemetryMessage::of(&Telemetry::Acknowledge(answer)));
        }
    }

    fn send_telemetry(&mut self, now_ns: u64) {
        let Some(rate) = self.rate.read_valid() else { return };
        let navigation_due = self.timeout_1.changed(rate.timeout_1);
        let loops_due = self.timeout_3.changed(rate.timeout_3);
        if navigation_due {
            let navigation = Telemetry::Navigation(self.function.navigation(now_ns));
            self.telemetry.send(&TelemetryMessage::of(&navigation));
        }
        if loops_due {
            let loops = Telemetry::Loops(self.function.loops(now_ns));
            self.telemetry.send(&TelemetryMessage::of(&loops));
        }
    }
}

impl InputPorts {
    fn read(&mut self) -> (Option<NavigationState>, Sensors) {
        let state = self.state.read_valid().and_then(navigation_state);
        let acceleration = self.acceleration.read_valid();
        (state, Sensors::of(acceleration, self.orientation.read_valid(), self.pressure.read_valid()))
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<ControllerPartition>()
}
