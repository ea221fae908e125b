//! A partition that never closes a window after number `after`. `how`: `spin` computes for ever, `sleep` blocks and uses no
//! processor.

use std::process::ExitCode;
use std::time::Duration;

use bateleur_apex::{Context, Partition, StartError, Window};

struct Hanger {
    windows_left: u64,
    hang: fn(),
}

impl Partition for Hanger {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let how = context.attribute("how", "spin".to_owned())?;
        let hang: fn() = match how.as_str() {
            "spin" => std::hint::spin_loop,
            "sleep" => || std::thread::sleep(Duration::from_secs(3600)),
            other => {
                return Err(StartError::Other(format!("attribute how = \"{other}\": give spin or sleep")));
            }
        };
        Ok(Self { windows_left: context.attribute("after", 0_u64)?, hang })
    }

    fn window(&mut self, _window: &Window) {
        if self.windows_left > 0 {
            self.windows_left -= 1;
            return;
        }
        loop {
            (self.hang)();
        }
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Hanger>()
}
