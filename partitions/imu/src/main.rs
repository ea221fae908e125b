//! The function that turns raw analogue values into inertial, magnetic and pressure measurements.

use std::process::ExitCode;

use bateleur_apex::{
    Context, Partition, Retained, SamplingDestination, SamplingSource, StartError, Takeover, Window,
};
use bateleur_function_shell::{FunctionShell, Verdict};
use bateleur_imu::{Imu, Initialise, Measurements, Memory, Outcome, Settings, parameters};
use bateleur_messages::ground::{Order, SENSOR_GYROSCOPE};
use bateleur_messages::telemetry::{FROM_IMU, Refusal, Telemetry};
use bateleur_messages::{
    Acceleration, GroundMessage, Magnetization, Pressure, Rate, Rates, RawAnalog, Watch,
};

pub(crate) struct InertialUnit {
    imu: Imu,
    retained: Retained<Memory>,
    /// The order that is being carried out, with the message to answer.
    initialising: Option<(Initialise, GroundMessage)>,
    shell: FunctionShell<Settings>,
    raw: SamplingDestination<RawAnalog>,
    outputs: Outputs,
    rate: SamplingDestination<Rate>,
    timeout: Watch,
}

struct Outputs {
    acceleration: SamplingSource<Acceleration>,
    orientation: SamplingSource<Rates>,
    magnetization: SamplingSource<Magnetization>,
    pressure: SamplingSource<Pressure>,
}

impl Partition for InertialUnit {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let mut retained: Retained<Memory> = context.retained()?;
        let plan = Settings::read(context.attributes())?;
        let mut shell = FunctionShell::open(context, FROM_IMU, plan, parameters)?;
        Ok(Self {
            imu: resume(&mut shell, &mut retained),
            retained,
            initialising: None,
            shell,
            raw: context.sampling_destination("raw")?,
            outputs: Outputs {
                acceleration: context.sampling_source("acceleration")?,
                orientation: context.sampling_source("orientation")?,
                magnetization: context.sampling_source("magnetization")?,
                pressure: context.sampling_source("pressure")?,
            },
            rate: context.sampling_destination("rate")?,
            timeout: Watch::default(),
        })
    }

    fn take_over(&mut self, _takeover: &Takeover) {
        self.imu = resume(&mut self.shell, &mut self.retained);
    }

    fn window(&mut self, window: &Window) {
        let now_ns = window.start_ns();
        self.take_orders(now_ns);
        let raw = self.raw.read_valid().copied();
        let measurements = raw.as_ref().and_then(|raw| self.imu.take(raw));
        if let Some(measurements) = &measurements {
            self.outputs.write(measurements);
        }
        self.initialise(now_ns, raw.as_ref().filter(|_| measurements.is_some()));
        if self.rate.read_valid().is_some_and(|rate| self.timeout.changed(rate.timeout_3)) {
            self.shell.send(&Telemetry::Imu(self.imu.telemetry()));
        }
    }
}

/// The unit as retained memory has it now.
fn resume(shell: &mut FunctionShell<Settings>, retained: &mut Retained<Memory>) -> Imu {
    let memory = retained.load().unwrap_or_default();
    shell.resume(Some(&memory.parameters));
    Imu::new(memory.biases.sane())
}

/// The answer to an order comes when it is carried out; a repetition meanwhile changes nothing.
fn begin(
    initialising: &mut Option<(Initialise, GroundMessage)>,
    settings: &Settings,
    (sensors, message): (u8, &GroundMessage),
    now_ns: u64,
) -> Verdict {
    if sensors & SENSOR_GYROSCOPE != 0 && !settings.gyro_bias {
        return Verdict::Refused(Refusal::SwitchedOff);
    }
    if !initialising.is_some_and(|(under_way, _)| under_way.covers(sensors)) {
        let under_way = Initialise::new(sensors, settings.pitot_covered, now_ns, settings.initialise_ns);
        *initialising = Some((under_way, *message));
    }
    Verdict::Later
}

impl InertialUnit {
    fn take_orders(&mut self, now_ns: u64) {
        let mut changed = false;
        self.shell.take_orders(
            now_ns,
            &mut self.initialising,
            |_, _| changed = true,
            |initialising, settings, order, message| match order {
                Order::InitialiseSensors { sensors } => {
                    begin(initialising, settings, (sensors, message), now_ns)
                }
                _ => Verdict::NotUnderstood,
            },
        );
        if changed {
            self.keep();
        }
    }

    fn initialise(&mut self, now_ns: u64, raw: Option<&RawAnalog>) {
        let Some((under_way, message)) = &mut self.initialising else { return };
        let message = *message;
        let Some(outcome) = under_way.step(now_ns, raw, self.imu.biases()) else { return };
        self.initialising = None;
        match outcome {
            Outcome::Found(biases) => {
                self.imu.set_biases(biases);
                self.keep();
                self.shell.answer(&message, Verdict::Accepted, now_ns);
            }
            Outcome::Refused => {
                self.shell.answer(&message, Verdict::Refused(Refusal::NotStanding), now_ns);
            }
        }
    }

    fn keep(&mut self) {
        self.retained.store(&Memory { biases: *self.imu.biases(), parameters: *self.shell.changed() });
    }
}

impl Outputs {
    fn write(&mut self, measurements: &Measurements) {
        let Measurements { acceleration, orientation, magnetization, pressure } = measurements;
        acceleration.iter().for_each(|value| self.acceleration.write(value));
        orientation.iter().for_each(|value| self.orientation.write(value));
        magnetization.iter().for_each(|value| self.magnetization.write(value));
        pressure.iter().for_each(|value| self.pressure.write(value));
    }
}

pub(crate) fn main() -> ExitCode {
    bateleur_apex::run::<InertialUnit>()
}
