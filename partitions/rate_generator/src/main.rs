//! The function that gives the module its beat: synchronize, execute and the telemetry time-outs.

use std::process::ExitCode;

use bateleur_apex::{
    Context, Direction, Partition, PortKind, QueuingDestination, QueuingSource, SamplingSource, StartError,
    Window,
};
use bateleur_messages::parameter::{Answer, Parameters};
use bateleur_messages::{GroundMessage, Rate, TelemetryMessage};
use bateleur_rate_generator::{Beat, Periods, parameters};

/// Ground messages taken in one window at most; as many as the queue usually holds.
const ORDERS_PER_WINDOW: usize = 8;

struct RateGenerator {
    beat: Beat,
    rate: SamplingSource<Rate>,
    periods: Periods,
    parameters: Parameters<Periods>,
    /// To and from the ground, where the plan has them.
    ground: Option<Ground>,
}

impl Partition for RateGenerator {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let usual = Periods::default();
        let [timeout_1, timeout_2, timeout_3] = usual.timeouts_ns;
        let periods = Periods {
            sync_ns: context.duration_ns("sync_period", usual.sync_ns)?,
            cutoff_ns: context.duration_ns("sensor_cutoff_delay", usual.cutoff_ns)?,
            timeouts_ns: [
                context.duration_ns("timeout_1", timeout_1)?,
                context.duration_ns("timeout_2", timeout_2)?,
                context.duration_ns("timeout_3", timeout_3)?,
            ],
        };
        let beat = Beat::new(periods).map_err(|error| StartError::Other(error.to_string()))?;
        Ok(Self {
            beat,
            rate: context.sampling_source("rate")?,
            periods,
            parameters: parameters(),
            ground: ground(context)?,
        })
    }

    fn window(&mut self, window: &Window) {
        // The instant in the schedule, not the one at which the processor was given: no jitter gets in.
        self.rate.write(&self.beat.at(window.start_ns()));
        let Some((ground, telemetry)) = &mut self.ground else { return };
        for message in std::iter::from_fn(|| ground.receive()).take(ORDERS_PER_WINDOW) {
            let answer = self.parameters.take(&message, &mut self.periods, window.start_ns());
            answer.iter().flat_map(Answer::messages).for_each(|message| {
                telemetry.send(&message);
            });
        }
    }
}

type Ground = (QueuingDestination<GroundMessage>, QueuingSource<TelemetryMessage>);

/// The way to the ground and back, which a plan may leave out.
fn ground(context: &mut Context) -> Result<Option<Ground>, StartError> {
    let ports = context.port_names(PortKind::Queuing, Direction::Destination);
    if !ports.iter().any(|port| port == "ground") {
        return Ok(None);
    }
    Ok(Some((context.queuing_destination("ground")?, context.queuing_source("telemetry")?)))
}

fn main() -> ExitCode {
    bateleur_apex::run::<RateGenerator>()
}
