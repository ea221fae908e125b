//! A partition that knows no message type: writes counted bytes into every sampling source that the plan gives it, and reads every
//! sampling destination.

use std::process::ExitCode;

use bateleur_apex::{
    Context, Direction, Partition, PortKind, RawSamplingDestination, RawSamplingSource, Stamp, StartError,
    Window,
};

struct Untyped {
    windows: u64,
    sources: Vec<(RawSamplingSource, usize)>,
    destinations: Vec<RawSamplingDestination>,
}

impl Partition for Untyped {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let sources = context.port_names(PortKind::Sampling, Direction::Source);
        let destinations = context.port_names(PortKind::Sampling, Direction::Destination);
        let source = |name: &String| context.raw_sampling_source(name);
        let sources = sources.iter().map(source).collect::<Result<_, _>>()?;
        let destination = |name: &String| context.raw_sampling_destination(name).map(|(port, _)| port);
        let destinations = destinations.iter().map(destination).collect::<Result<_, _>>()?;
        Ok(Self { windows: 0, sources, destinations })
    }

    fn window(&mut self, window: &Window) {
        self.windows += 1;
        let stamp = Stamp { source_ns: window.start_ns(), sequence: self.windows };
        for (source, bytes) in &mut self.sources {
            source.write(&vec![self.windows as u8; *bytes], stamp);
        }
        for destination in &mut self.destinations {
            let _ = destination.read(); // the plan's types are not known here
        }
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Untyped>()
}
