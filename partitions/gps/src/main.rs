//! The function that turns a receiver's raw fixes into position and velocity.

use std::process::ExitCode;

use bateleur_apex::{
    Context, Partition, QueuingDestination, QueuingSource, SamplingDestination, SamplingSource, StartError,
    Window,
};
use bateleur_gps::{Gps, Origin, origin, parameters};
use bateleur_messages::parameter::{Answer, Parameters};
use bateleur_messages::telemetry::Telemetry;
use bateleur_messages::{GpsPosition, GpsVelocity, GroundMessage, Rate, RawGps, TelemetryMessage, Watch};

/// Ground messages taken in one window at most; as many as the queue usually holds.
const ORDERS_PER_WINDOW: usize = 8;

struct Receiver {
    gps: Gps,
    origin: Origin,
    parameters: Parameters<Origin>,
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
        let origin = origin(context.attributes())?;
        Ok(Self {
            gps: Gps::new(&origin),
            origin,
            parameters: parameters(),
            raw: context.sampling_destination("raw")?,
            position: context.sampling_source("position")?,
            velocity: context.sampling_source("velocity")?,
            rate: context.sampling_destination("rate")?,
            ground: context.queuing_destination("ground")?,
            telemetry: context.queuing_source("telemetry")?,
            timeout: Watch::default(),
        })
    }

    fn window(&mut self, window: &Window) {
        if let Some((position, velocity)) = self.raw.read_valid().and_then(|raw| self.gps.take(raw)) {
            self.position.write(&position);
            self.velocity.write(&velocity);
        }
        // Of the ground's messages only those about parameters concern this function; none may fill its queue.
        for message in std::iter::from_fn(|| self.ground.receive()).take(ORDERS_PER_WINDOW) {
            let answer = self.parameters.take(&message, &mut self.origin, window.start_ns());
            answer.iter().flat_map(Answer::messages).for_each(|message| {
                self.telemetry.send(&message);
            });
        }
        let due = self.rate.read_valid().is_some_and(|rate| self.timeout.changed(rate.timeout_1));
        if let Some(telemetry) = self.gps.telemetry().filter(|_| due) {
            self.telemetry.send(&TelemetryMessage::of(&Telemetry::Gps(telemetry)));
        }
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Receiver>()
}
