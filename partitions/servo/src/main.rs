//! The function that turns actuator commands into timer values, or passes the safety pilot through.

use std::process::ExitCode;

use bateleur_apex::{
    Context, Partition, QueuingDestination, QueuingSource, Retained, SamplingDestination, SamplingSource,
    StartError, Takeover, Window,
};
use bateleur_messages::ground::Order;
use bateleur_messages::parameter::Parameters;
use bateleur_messages::telemetry::{ACCEPTED, Acknowledge, FROM_SERVO, NOT_UNDERSTOOD, Telemetry};
use bateleur_messages::{
    ActuatorCommand, Custom, FunctionStatus, GroundMessage, Rate, ServoTimers, TelemetryMessage, Watch,
};
use bateleur_servo::{Memory, Servo, Settings, parameters};

/// Ground messages taken in one window at most; as many as the queue usually holds.
const ORDERS_PER_WINDOW: usize = 8;
struct Actuators {
    servo: Servo,
    /// What the plan says.
    plan: Settings,
    /// The same, and what the ground has set since.
    settings: Settings,
    parameters: Parameters<Settings>,
    retained: Retained<Memory>,
    starts: u64,
    command: SamplingDestination<ActuatorCommand>,
    custom: SamplingDestination<Custom>,
    timers: SamplingSource<ServoTimers>,
    status: SamplingSource<FunctionStatus>,
    rate: SamplingDestination<Rate>,
    ground: QueuingDestination<GroundMessage>,
    telemetry: QueuingSource<TelemetryMessage>,
    timeout: Watch,
}

impl Partition for Actuators {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let plan = Settings::read(context.attributes())?;
        let mut retained = context.retained()?;
        let (servo, settings, parameters) = resume(plan, &mut retained);
        Ok(Self {
            servo,
            plan,
            settings,
            parameters,
            retained,
            starts: u64::from(context.generation()) + 1,
            command: context.sampling_destination("command")?,
            custom: context.sampling_destination("custom")?,
            timers: context.sampling_source("timers")?,
            status: context.sampling_source("status")?,
            rate: context.sampling_destination("rate")?,
            ground: context.queuing_destination("ground")?,
            telemetry: context.queuing_source("telemetry")?,
            timeout: Watch::default(),
        })
    }

    fn take_over(&mut self, _takeover: &Takeover) {
        (self.servo, self.settings, self.parameters) = resume(self.plan, &mut self.retained);
    }

    fn window(&mut self, window: &Window) {
        let now_ns = window.start_ns();
        self.take_orders(now_ns);
        let timers = self.servo.step(now_ns, self.command.read_valid(), self.custom.read_valid());
        self.timers.write(&timers);
        self.retained.store(&Memory { function: *self.servo.kept(), parameters: *self.parameters.changed() });
        self.status.write(&self.servo.status(self.starts));
        if self.rate.read_valid().is_some_and(|rate| self.timeout.changed(rate.timeout_2)) {
            let telemetry = Telemetry::Servo(self.servo.telemetry(now_ns));
            self.telemetry.send(&TelemetryMessage::of(&telemetry));
        }
    }
}

/// The function as retained memory has it now.
fn resume(plan: Settings, retained: &mut Retained<Memory>) -> (Servo, Settings, Parameters<Settings>) {
    let (memory, mut settings, mut parameters) = (retained.load(), plan, parameters());
    if let Some(memory) = &memory {
        parameters.resume(&memory.parameters, &mut settings);
    }
    let kept = memory.map(|memory| memory.function);
    (Servo::new(settings.map, settings.hold_ns, kept), settings, parameters)
}

impl Actuators {
    fn take_orders(&mut self, now_ns: u64) {
        for _ in 0..ORDERS_PER_WINDOW {
            let Some(message) = self.ground.receive() else { return };
            if let Some(answer) = self.parameters.take(&message, &mut self.settings, now_ns) {
                if answer.changed {
                    self.servo.configure(self.settings.hold_ns);
                }
                answer.messages().for_each(|message| {
                    self.telemetry.send(&message);
                });
                continue;
            }
            let taken = self.servo.order(Order::parse(message.letter, message.bytes()));
            let result = if taken { ACCEPTED } else { NOT_UNDERSTOOD };
            let answer = Acknowledge::of(&message, FROM_SERVO, result, now_ns);
            self.telemetry.send(&TelemetryMessage::of(&Telemetry::Acknowledge(answer)));
        }
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Actuators>()
}
