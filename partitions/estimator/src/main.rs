//! The function that estimates position, velocity and attitude.

use std::process::ExitCode;

use bateleur_apex::{
    Context, Partition, Retained, SamplingDestination, SamplingSource, StartError, Takeover, Window,
};
use bateleur_estimator::{
    Function, Inputs, Memory, Remark, Remarks, Settings, parameters, seconds, telemetry,
};
use bateleur_function_shell::{FunctionShell, Verdict};
use bateleur_messages::ground::Order;
use bateleur_messages::telemetry::{FROM_ESTIMATOR, Refusal, Telemetry};
use bateleur_messages::{
    Acceleration, ActuatorCommand, FunctionStatus, GpsPosition, GpsVelocity, Magnetization, Pressure, Rate,
    Rates, State, Watch,
};

pub(crate) struct EstimatorPartition {
    function: Function,
    shell: FunctionShell<Settings>,
    retained: Retained<Memory>,
    starts: u64,
    remarks: Remarks,
    inputs: InputPorts,
    state: SamplingSource<State>,
    status: SamplingSource<FunctionStatus>,
    rate: SamplingDestination<Rate>,
    timeout: Watch,
}

struct InputPorts {
    acceleration: SamplingDestination<Acceleration>,
    orientation: SamplingDestination<Rates>,
    magnetization: SamplingDestination<Magnetization>,
    pressure: SamplingDestination<Pressure>,
    gps_position: SamplingDestination<GpsPosition>,
    gps_velocity: SamplingDestination<GpsVelocity>,
    command: Option<SamplingDestination<ActuatorCommand>>,
}

impl Partition for EstimatorPartition {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let plan = Settings::read(context.attributes())?;
        let mut retained: Retained<Memory> = context.retained()?;
        let now_ns = context.time().now_ns();
        let mut shell = FunctionShell::open(context, FROM_ESTIMATOR, plan, parameters)?;
        Ok(Self {
            function: resume(&mut shell, &mut retained, now_ns),
            shell,
            retained,
            starts: u64::from(context.generation()) + 1,
            remarks: Remarks::default(),
            inputs: InputPorts {
                acceleration: context.sampling_destination("acceleration")?,
                orientation: context.sampling_destination("orientation")?,
                magnetization: context.sampling_destination("magnetization")?,
                pressure: context.sampling_destination("pressure")?,
                gps_position: context.sampling_destination("gps_position")?,
                gps_velocity: context.sampling_destination("gps_velocity")?,
                command: context.optional_destination("command")?,
            },
            state: context.sampling_source("state")?,
            status: context.sampling_source("status")?,
            rate: context.sampling_destination("rate")?,
            timeout: Watch::default(),
        })
    }

    fn take_over(&mut self, takeover: &Takeover) {
        self.function = resume(&mut self.shell, &mut self.retained, takeover.now_ns());
    }

    fn window(&mut self, window: &Window) {
        let now_ns = window.start_ns();
        self.shell.take_orders(
            now_ns,
            &mut self.function,
            |function, settings| function.configure(settings.pressure_aiding),
            |function, _, one, _| order(function, one, now_ns),
        );
        self.function.step(&self.inputs.read());
        let state = self.function.state();
        let (silent, stuck) = (self.function.is_silent(), self.function.stuck_axes());
        self.remarks.look(&state, silent, stuck, |remark| match remark {
            Remark::Gone(text) => window.raise(text),
            Remark::Back(text) => window.report(text),
        });
        self.state.write(&state);
        self.status.write(&self.function.status(&state, self.starts));
        if self.rate.read_valid().is_some_and(|rate| self.timeout.changed(rate.timeout_3)) {
            self.shell.send(&Telemetry::State(telemetry(&state)));
        }
        self.retained.store(&Memory { function: self.function.kept(), parameters: *self.shell.changed() });
    }
}

/// The function as retained memory has it now.
fn resume(shell: &mut FunctionShell<Settings>, retained: &mut Retained<Memory>, now_ns: u64) -> Function {
    let memory = retained.load();
    let settings = shell.resume(memory.as_ref().map(|memory| &memory.parameters));
    let kept = memory.as_ref().map(|memory| &memory.function);
    Function::new(settings.config, settings.pressure_aiding, kept, seconds(now_ns))
}

fn order(function: &mut Function, order: Order, now_ns: u64) -> Verdict {
    match order {
        Order::Estimator(order) if function.order(order, seconds(now_ns)) => Verdict::Accepted,
        Order::Estimator(_) => Verdict::Refused(Refusal::InFlight),
        _ => Verdict::NotUnderstood,
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
            command: self.command.as_mut().and_then(SamplingDestination::read_valid),
        }
    }
}

pub(crate) fn main() -> ExitCode {
    bateleur_apex::run::<EstimatorPartition>()
}
