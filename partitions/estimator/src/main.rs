//! The function that estimates position, velocity and attitude.

use std::process::ExitCode;

use bateleur_apex::{
    Context, Partition, QueuingDestination, QueuingSource, Retained, SamplingDestination, SamplingSource,
    StartError, Takeover, Window,
};
use bateleur_estimator::{Function, Inputs, Memory, Settings, parameters, seconds, telemetry};
use bateleur_messages::ground::Order;
use bateleur_messages::parameter::Parameters;
use bateleur_messages::telemetry::{
    ACCEPTED, Acknowledge, FROM_ESTIMATOR, NOT_UNDERSTOOD, Refusal, Telemetry,
};
use bateleur_messages::{
    Acceleration, FunctionStatus, GpsPosition, GpsVelocity, GroundMessage, Magnetization, Pressure, Rate,
    Rates, State, TelemetryMessage, Watch,
};

/// Ground messages taken in one window at most; as many as the queue usually holds.
const ORDERS_PER_WINDOW: usize = 8;

struct EstimatorPartition {
    function: Function,
    /// What the plan says.
    plan: Settings,
    /// The same, and what the ground has set since.
    settings: Settings,
    parameters: Parameters<Settings>,
    retained: Retained<Memory>,
    starts: u64,
    inputs: InputPorts,
    state: SamplingSource<State>,
    status: SamplingSource<FunctionStatus>,
    rate: SamplingDestination<Rate>,
    ground: QueuingDestination<GroundMessage>,
    telemetry: QueuingSource<TelemetryMessage>,
    timeout: Watch,
}

struct InputPorts {
    acceleration: SamplingDestination<Acceleration>,
    orientation: SamplingDestination<Rates>,
    magnetization: SamplingDestination<Magnetization>,
    pressure: SamplingDestination<Pressure>,
    gps_position: SamplingDestination<GpsPosition>,
    gps_velocity: SamplingDestination<GpsVelocity>,
}

impl Partition for EstimatorPartition {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let plan = Settings::read(context.attributes())?;
        let mut retained: Retained<Memory> = context.retained()?;
        let now_ns = context.time().now_ns();
        let (function, settings, parameters) = resume(plan, &mut retained, now_ns);
        Ok(Self {
            function,
            plan,
            settings,
            parameters,
            retained,
            starts: u64::from(context.generation()) + 1,
            inputs: InputPorts {
                acceleration: context.sampling_destination("acceleration")?,
                orientation: context.sampling_destination("orientation")?,
                magnetization: context.sampling_destination("magnetization")?,
                pressure: context.sampling_destination("pressure")?,
                gps_position: context.sampling_destination("gps_position")?,
                gps_velocity: context.sampling_destination("gps_velocity")?,
            },
            state: context.sampling_source("state")?,
            status: context.sampling_source("status")?,
            rate: context.sampling_destination("rate")?,
            ground: context.queuing_destination("ground")?,
            telemetry: context.queuing_source("telemetry")?,
            timeout: Watch::default(),
        })
    }

    fn take_over(&mut self, takeover: &Takeover) {
        (self.function, self.settings, self.parameters) =
            resume(self.plan, &mut self.retained, takeover.now_ns());
    }

    fn window(&mut self, window: &Window) {
        self.take_orders(window.start_ns());
        self.function.step(&self.inputs.read());
        let state = self.function.state();
        self.state.write(&state);
        self.status.write(&self.function.status(&state, self.starts));
        if self.rate.read_valid().is_some_and(|rate| self.timeout.changed(rate.timeout_3)) {
            self.telemetry.send(&TelemetryMessage::of(&Telemetry::State(telemetry(&state))));
        }
        self.retained
            .store(&Memory { function: self.function.kept(), parameters: *self.parameters.changed() });
    }
}

/// The function as retained memory has it now.
fn resume(
    plan: Settings,
    retained: &mut Retained<Memory>,
    now_ns: u64,
) -> (Function, Settings, Parameters<Settings>) {
    let (memory, mut settings, mut parameters) = (retained.load(), plan, parameters());
    if let Some(memory) = &memory {
        parameters.resume(&memory.parameters, &mut settings);
    }
    let kept = memory.as_ref().map(|memory| &memory.function);
    let function = Function::new(settings.config, settings.pressure_aiding, kept, seconds(now_ns));
    (function, settings, parameters)
}

impl EstimatorPartition {
    fn take_orders(&mut self, now_ns: u64) {
        for _ in 0..ORDERS_PER_WINDOW {
            let Some(message) = self.ground.receive() else { return };
            if let Some(answer) = self.parameters.take(&message, &mut self.settings, now_ns) {
                if answer.changed {
                    self.function.configure(self.settings.pressure_aiding);
                }
                answer.messages().for_each(|message| {
                    self.telemetry.send(&message);
                });
                continue;
            }
            let of = |result| Acknowledge::of(&message, FROM_ESTIMATOR, result, now_ns);
            let answer = match Order::parse(message.letter, message.bytes()) {
                Ok(Order::Estimator(order)) if self.function.order(order, seconds(now_ns)) => of(ACCEPTED),
                Ok(Order::Estimator(_)) => {
                    Acknowledge::refused(&message, FROM_ESTIMATOR, Refusal::InFlight, now_ns)
                }
                _ => of(NOT_UNDERSTOOD),
            };
            self.telemetry.send(&TelemetryMessage::of(&Telemetry::Acknowledge(answer)));
        }
    }
}

impl InputPorts {
    fn read(&mut self) -> Inputs<'_> {
        Inputs {
            acceleration: self.acceleration.read_valid(),
            orientation: self.orientation.read_valid(),
            magnetization: self.magnetization.read_valid(),
            pressure: self.pressure.read_valid(),
            gps_position: self.gps_position.read_valid(),
            gps_velocity: self.gps_velocity.read_valid(),
        }
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<EstimatorPartition>()
}
