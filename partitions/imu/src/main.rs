//! The function that turns raw analogue values into inertial, magnetic and pressure measurements.

use std::process::ExitCode;

use bateleur_apex::{
    Context, Partition, QueuingDestination, QueuingSource, Retained, SamplingDestination, SamplingSource,
    StartError, Takeover, Window,
};
use bateleur_imu::{Imu, Initialise, Measurements, Memory, Outcome, Settings, parameters};
use bateleur_messages::ground::{Order, SENSOR_GYROSCOPE};
use bateleur_messages::parameter::Parameters;
use bateleur_messages::telemetry::{ACCEPTED, Acknowledge, FROM_IMU, NOT_UNDERSTOOD, Refusal, Telemetry};
use bateleur_messages::{
    Acceleration, GroundMessage, Magnetization, Pressure, Rate, Rates, RawAnalog, TelemetryMessage, Watch,
};

/// Ground messages taken in one window at most; as many as the queue usually holds.
const ORDERS_PER_WINDOW: usize = 8;

struct InertialUnit {
    imu: Imu,
    retained: Retained<Memory>,
    /// The order that is being carried out, with the message to answer.
    initialising: Option<(Initialise, GroundMessage)>,
    /// What the plan says.
    plan: Settings,
    /// The same, and what the ground has set since.
    settings: Settings,
    parameters: Parameters<Settings>,
    raw: SamplingDestination<RawAnalog>,
    outputs: Outputs,
    rate: SamplingDestination<Rate>,
    ground: QueuingDestination<GroundMessage>,
    telemetry: QueuingSource<TelemetryMessage>,
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
        let (imu, settings, parameters) = resume(plan, &mut retained);
        Ok(Self {
            imu,
            retained,
            initialising: None,
            plan,
            settings,
            parameters,
            raw: context.sampling_destination("raw")?,
            outputs: Outputs {
                acceleration: context.sampling_source("acceleration")?,
                orientation: context.sampling_source("orientation")?,
                magnetization: context.sampling_source("magnetization")?,
                pressure: context.sampling_source("pressure")?,
            },
            rate: context.sampling_destination("rate")?,
            ground: context.queuing_destination("ground")?,
            telemetry: context.queuing_source("telemetry")?,
            timeout: Watch::default(),
        })
    }

    fn take_over(&mut self, _takeover: &Takeover) {
        (self.imu, self.settings, self.parameters) = resume(self.plan, &mut self.retained);
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
            self.telemetry.send(&TelemetryMessage::of(&Telemetry::Imu(self.imu.telemetry())));
        }
    }
}

/// The unit as retained memory has it now.
fn resume(plan: Settings, retained: &mut Retained<Memory>) -> (Imu, Settings, Parameters<Settings>) {
    let memory = retained.load().unwrap_or_default();
    let (mut settings, mut parameters) = (plan, parameters());
    parameters.resume(&memory.parameters, &mut settings);
    (Imu::new(memory.biases.sane()), settings, parameters)
}

impl InertialUnit {
    fn take_orders(&mut self, now_ns: u64) {
        for _ in 0..ORDERS_PER_WINDOW {
            let Some(message) = self.ground.receive() else { return };
            if let Some(answer) = self.parameters.take(&message, &mut self.settings, now_ns) {
                if answer.changed {
                    self.keep();
                }
                answer.messages().for_each(|message| {
                    self.telemetry.send(&message);
                });
                continue;
            }
            match Order::parse(message.letter, message.bytes()) {
                Ok(Order::InitialiseSensors { sensors }) => self.begin(&message, sensors, now_ns),
                _ => self.answer(&message, NOT_UNDERSTOOD, now_ns),
            }
        }
    }

    /// The answer to an order comes when it is carried out; a repetition meanwhile changes nothing.
    fn begin(&mut self, message: &GroundMessage, sensors: u8, now_ns: u64) {
        if sensors & SENSOR_GYROSCOPE != 0 && !self.settings.gyro_bias {
            return self.refuse(message, Refusal::SwitchedOff, now_ns);
        }
        if !self.initialising.is_some_and(|(under_way, _)| under_way.covers(sensors)) {
            let Settings { initialise_ns, pitot_covered, .. } = self.settings;
            let under_way = Initialise::new(sensors, pitot_covered, now_ns, initialise_ns);
            self.initialising = Some((under_way, *message));
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
                self.answer(&message, ACCEPTED, now_ns);
            }
            Outcome::Refused => self.refuse(&message, Refusal::NotStanding, now_ns),
        }
    }

    fn keep(&mut self) {
        self.retained.store(&Memory { biases: *self.imu.biases(), parameters: *self.parameters.changed() });
    }

    fn refuse(&mut self, message: &GroundMessage, why: Refusal, now_ns: u64) {
        let answer = Telemetry::Acknowledge(Acknowledge::refused(message, FROM_IMU, why, now_ns));
        self.telemetry.send(&TelemetryMessage::of(&answer));
    }

    fn answer(&mut self, message: &GroundMessage, result: u8, now_ns: u64) {
        let answer = Telemetry::Acknowledge(Acknowledge::of(message, FROM_IMU, result, now_ns));
        self.telemetry.send(&TelemetryMessage::of(&answer));
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

fn main() -> ExitCode {
    bateleur_apex::run::<InertialUnit>()
}
