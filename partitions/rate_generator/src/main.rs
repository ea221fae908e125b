//! The function that gives the module its beat: synchronize, execute and the telemetry time-outs.

use std::process::ExitCode;

use bateleur_apex::{Context, Direction, Partition, PortKind, SamplingSource, StartError, Window};
use bateleur_function_shell::FunctionShell;
use bateleur_messages::Rate;
use bateleur_messages::telemetry::FROM_RATE_GENERATOR;
use bateleur_rate_generator::{Beat, Periods, parameters};

pub(crate) struct RateGenerator {
    beat: Beat,
    rate: SamplingSource<Rate>,
    /// `None` if the plan has no ports to and from the ground.
    shell: Option<FunctionShell<Periods>>,
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
        Ok(Self { beat, rate: context.sampling_source("rate")?, shell: shell(context, periods)? })
    }

    fn window(&mut self, window: &Window) {
        // The instant in the schedule, not the one at which the processor was given: no jitter gets in.
        self.rate.write(&self.beat.at(window.start_ns()));
        if let Some(shell) = &mut self.shell {
            shell.take_parameters(window.start_ns());
        }
    }
}

/// The way to the ground and back, which a plan may leave out.
fn shell(context: &mut Context, periods: Periods) -> Result<Option<FunctionShell<Periods>>, StartError> {
    let has_ground = context.declares(PortKind::Queuing, Direction::Destination, "ground");
    has_ground.then(|| FunctionShell::open(context, FROM_RATE_GENERATOR, periods, parameters)).transpose()
}

pub(crate) fn main() -> ExitCode {
    bateleur_apex::run::<RateGenerator>()
}
