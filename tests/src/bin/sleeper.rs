//! A partition that blocks in window number `after` and never closes it. It uses no processor.

use std::process::ExitCode;
use std::time::Duration;

use bateleur_apex::{Context, Partition, StartError, Window};

struct Sleeper {
    windows_left: u64,
}

impl Partition for Sleeper {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        Ok(Self { windows_left: context.attribute("after", 0_u64)? })
    }

    fn window(&mut self, _window: &Window) {
        if self.windows_left > 0 {
            self.windows_left -= 1;
            return;
        }
        loop {
            std::thread::sleep(Duration::from_secs(3600));
        }
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Sleeper>()
}
