//! A partition that behaves: counts its windows, writes the count where the plan gives it a port `count`, and reads
//! that of another where the plan gives it a port `heard`. With `busy_us` it computes for so long in each window.

use std::process::ExitCode;

use bateleur_apex::{
    Context, Direction, Partition, PortKind, SamplingDestination, SamplingSource, StartError, Window,
};
use bateleur_messages::FunctionStatus;

struct Counter {
    windows: u64,
    count: Option<SamplingSource<FunctionStatus>>,
    heard: Option<SamplingDestination<FunctionStatus>>,
    refused: u64,
    busy_ns: u64,
}

impl Partition for Counter {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let has = |name: &str, direction| {
            context.port_names(PortKind::Sampling, direction).iter().any(|port| port == name)
        };
        let (counts, hears) = (has("count", Direction::Source), has("heard", Direction::Destination));
        let count = if counts { Some(context.sampling_source("count")?) } else { None };
        let heard = if hears { Some(context.sampling_destination("heard")?) } else { None };
        let busy_ns = context.attribute("busy_us", 0_u64)? * 1_000;
        Ok(Self { windows: 0, count, heard, refused: 0, busy_ns })
    }

    fn window(&mut self, window: &Window) {
        while self.busy_ns > 0 && window.now_ns() < window.start_ns() + self.busy_ns {
            std::hint::spin_loop();
        }
        self.windows += 1;
        if self.heard.as_mut().is_some_and(|heard| heard.read_valid().is_none()) {
            self.refused += 1;
        }
        if let Some(count) = &mut self.count {
            count.write(&FunctionStatus {
                accepted: self.windows,
                refused: self.refused,
                ..FunctionStatus::default()
            });
        }
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Counter>()
}
