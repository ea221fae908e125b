//! The function that turns a receiver's raw fixes into position and velocity.

use std::process::ExitCode;

use bateleur_apex::{Context, Partition, SamplingDestination, SamplingSource, StartError, Window};
use bateleur_function_shell::FunctionShell;
use bateleur_gps::{Gps, Origin, origin, parameters};
use bateleur_messages::telemetry::{FROM_GPS, Telemetry};
use bateleur_messages::{GpsPosition, GpsVelocity, Rate, RawGps, Watch};

pub(crate) struct Receiver {
    gps: Gps,
    shell: FunctionShell<Origin>,
    raw: SamplingDestination<RawGps>,
    position: SamplingSource<GpsPosition>,
    velocity: SamplingSource<GpsVelocity>,
    rate: SamplingDestination<Rate>,
    timeout: Watch,
}

impl Partition for Receiver {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let origin = origin(context.attributes())?;
        Ok(Self {
            gps: Gps::new(&origin),
            shell: FunctionShell::open(context, FROM_GPS, origin, parameters)?,
            raw: context.sampling_destination("raw")?,
            position: context.sampling_source("position")?,
            velocity: context.sampling_source("velocity")?,
            rate: context.sampling_destination("rate")?,
            timeout: Watch::default(),
        })
    }

    fn window(&mut self, window: &Window) {
        if let Some((position, velocity)) = self.raw.read_valid().and_then(|raw| self.gps.take(raw)) {
            self.position.write(&position);
            self.velocity.write(&velocity);
        }
        self.shell.take_parameters(window.start_ns());
        let due = self.rate.read_valid().is_some_and(|rate| self.timeout.changed(rate.timeout_1));
        if let Some(telemetry) = self.gps.telemetry().filter(|_| due) {
            self.shell.send(&Telemetry::Gps(telemetry));
        }
    }
}

pub(crate) fn main() -> ExitCode {
    bateleur_apex::run::<Receiver>()
}
