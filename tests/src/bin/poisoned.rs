//! A partition that spoils its retained memory in window number `after` and dies; a successor that finds it spoilt dies in
//! its start.

use std::process::ExitCode;

use bateleur_apex::{Context, Partition, Retained, StartError, Window};

struct Poisoned {
    retained: Retained<u64>,
    windows_left: u64,
}

const SPOILT: u64 = u64::MAX;

impl Partition for Poisoned {
    #[allow(clippy::panic)] // that is what it is for
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let mut retained = context.retained::<u64>()?;
        if retained.load() == Some(SPOILT) {
            panic!("what it has retained is spoilt");
        }
        // It is spoilt once: a successor that starts from nothing goes on.
        let after = context.attribute("after", 10)?;
        let windows_left = if context.generation() == 0 { after } else { u64::MAX };
        Ok(Self { retained, windows_left })
    }

    fn window(&mut self, _window: &Window) {
        self.windows_left -= 1;
        if self.windows_left == 0 {
            self.retained.store(&SPOILT);
            std::process::abort();
        }
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Poisoned>()
}
