//! The function that turns a receiver's raw fixes into position and velocity.

use std::process::ExitCode;

use bateleur_apex::{
    Context, Partition, QueuingDestination, QueuingSource, SamplingDestination, SamplingSource, StartError,
    Window,
};
use bateleur_gps::{Gps, origin};
use bateleur_messages::telemetry::Telemetry;
use bateleur_messages::{GpsPosition, GpsVelocity, GroundMessage, Rate, RawGps, TelemetryMessage, Watch};

/// Ground messages taken in one window at most; as many as the queue usually holds.
const ORDERS_PER_WINDOW: usize = 8;

struct Receiver {
    gps: Gps,
    raw: SamplingDestination<RawGps>,
    position: SamplingSource<GpsPosition>,
    velocity: SamplingSource<GpsVelocity>,
    rate: SamplingDestination<Rate>,
    ground: QueuingDestination<GroundMessage>,
    telemetry: QueuingSource<TelemetryMessage>,
    timeout: Watch,
}

impl Partition for Receiver {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        Ok(Self {
            gps: Gps::new(&origin(context.attributes())?),
            raw: context.sampling_destination("raw")?,
            position: context.sampling_source("position")?,
            velocity: context.sampling_source("velocity")?,
            rate: context.sampling_destination("rate")?,
            ground: context.queuing_destination("ground")?,
            telemetry: context.queuing_source("telemetry")?,
            timeout: Watch::default(),
        })
    }

    fn window(&mut self, _window: &Window) {
        if let Some((position, velocity)) = self.raw.read_valid().and_then(|raw| self.gps.take(raw)) {
            self.position.write(&position);
            self.velocity.write(&velocity);
        }
        // No ground message concerns this function; none may fill its queue either.
        let _ = std::iter::from_fn(|| self.ground.receive()).take(ORDERS_PER_WINDOW).count();
        let due = self.rate.read_valid().is_some_and(|rate| self.timeout.changed(rate.timeout_1));
        if let Some(telemetry) = self.gps.telemetry().filter(|_| due) {
            self.telemetry.send(&TelemetryMessage::of(&Telemetry::Gps(telemetry)));
        }
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Receiver>()
}
