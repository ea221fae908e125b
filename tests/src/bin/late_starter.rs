//! A partition that takes `takes_ms` to initialise; from its second incarnation on, `again_ms`.

use std::process::ExitCode;
use std::time::Duration;

use bateleur_apex::{Context, Partition, StartError, Window};

struct LateStarter;

impl Partition for LateStarter {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let first = context.attribute("takes_ms", 0_u64)?;
        let again = context.attribute("again_ms", first)?;
        let takes = if context.generation() == 0 { first } else { again };
        std::thread::sleep(Duration::from_millis(takes));
        Ok(Self)
    }

    fn window(&mut self, _window: &Window) {}
}

fn main() -> ExitCode {
    bateleur_apex::run::<LateStarter>()
}
