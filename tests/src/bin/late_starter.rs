//! A partition that takes `takes_ms` to initialise; from its second incarnation on, `again_ms`. It attaches to its source
//! ports and writes nothing.

use std::process::ExitCode;
use std::time::Duration;

use bateleur_apex::{Context, Direction, Partition, PortKind, SamplingSource, StartError, Window};
use bateleur_messages::FunctionStatus;

struct LateStarter {
    _ports: Vec<SamplingSource<FunctionStatus>>,
}

impl Partition for LateStarter {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let first = context.attribute("takes_ms", 0_u64)?;
        let again = context.attribute("again_ms", first)?;
        let takes = if context.generation() == 0 { first } else { again };
        std::thread::sleep(Duration::from_millis(takes));
        let names = context.port_names(PortKind::Sampling, Direction::Source);
        let ports = names.iter().map(|name| context.sampling_source(name)).collect::<Result<_, _>>()?;
        Ok(Self { _ports: ports })
    }

    fn window(&mut self, _window: &Window) {}
}

fn main() -> ExitCode {
    bateleur_apex::run::<LateStarter>()
}
