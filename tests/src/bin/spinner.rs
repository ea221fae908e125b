//! A partition that never closes a window after number `after`: it computes for ever.

use std::process::ExitCode;

use bateleur_apex::{Context, Partition, StartError, Window};

struct Spinner {
    windows_left: u64,
}

impl Partition for Spinner {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        Ok(Self { windows_left: context.attribute("after", 0_u64)? })
    }

    fn window(&mut self, _window: &Window) {
        if self.windows_left > 0 {
            self.windows_left -= 1;
            return;
        }
        loop {
            std::hint::spin_loop();
        }
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Spinner>()
}
