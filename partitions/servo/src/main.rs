//! The function that turns actuator commands into timer values, or passes the safety pilot through.

use std::process::ExitCode;

use bateleur_apex::{
    Context, Partition, Retained, SamplingDestination, SamplingSource, StartError, Takeover, Window,
};
use bateleur_function_shell::{FunctionShell, Verdict};
use bateleur_messages::telemetry::{FROM_SERVO, Telemetry};
use bateleur_messages::{ActuatorCommand, Custom, FunctionStatus, Rate, ServoTimers, Watch};
use bateleur_servo::{Memory, Servo, Settings, parameters};

pub(crate) struct Actuators {
    servo: Servo,
    shell: FunctionShell<Settings>,
    retained: Retained<Memory>,
    starts: u64,
    command: SamplingDestination<ActuatorCommand>,
    custom: SamplingDestination<Custom>,
    timers: SamplingSource<ServoTimers>,
    status: SamplingSource<FunctionStatus>,
    rate: SamplingDestination<Rate>,
    timeout: Watch,
}

impl Partition for Actuators {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let plan = Settings::read(context.attributes())?;
        let mut shell = FunctionShell::open(context, FROM_SERVO, plan, parameters)?;
        let mut retained = context.retained()?;
        Ok(Self {
            servo: resume(&mut shell, &mut retained),
            shell,
            retained,
            starts: u64::from(context.generation()) + 1,
            command: context.sampling_destination("command")?,
            custom: context.sampling_destination("custom")?,
            timers: context.sampling_source("timers")?,
            status: context.sampling_source("status")?,
            rate: context.sampling_destination("rate")?,
            timeout: Watch::default(),
        })
    }

    fn take_over(&mut self, _takeover: &Takeover) {
        self.servo = resume(&mut self.shell, &mut self.retained);
    }

    fn window(&mut self, window: &Window) {
        let now_ns = window.start_ns();
        self.shell.take_orders(
            now_ns,
            &mut self.servo,
            |servo, settings| servo.configure(settings.hold_ns),
            |servo, _, order, _| {
                if servo.order(Ok(order)) { Verdict::Accepted } else { Verdict::NotUnderstood }
            },
        );
        let timers = self.servo.step(now_ns, self.command.read_valid(), self.custom.read_valid());
        self.timers.write(&timers);
        self.retained.store(&Memory { function: *self.servo.kept(), parameters: *self.shell.changed() });
        self.status.write(&self.servo.status(self.starts));
        if self.rate.read_valid().is_some_and(|rate| self.timeout.changed(rate.timeout_2)) {
            self.shell.send(&Telemetry::Servo(self.servo.telemetry(now_ns)));
        }
    }
}

/// The function as retained memory has it now.
fn resume(shell: &mut FunctionShell<Settings>, retained: &mut Retained<Memory>) -> Servo {
    let memory = retained.load();
    let settings = shell.resume(memory.as_ref().map(|memory| &memory.parameters));
    Servo::new(settings.map, settings.hold_ns, memory.map(|memory| memory.function))
}

pub(crate) fn main() -> ExitCode {
    bateleur_apex::run::<Actuators>()
}
