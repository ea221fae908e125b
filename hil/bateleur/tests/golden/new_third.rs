//! The partition `third`: say here in a sentence what it is for, and what it must never do.
//!
//! `bateleur new` made it from the schedule file. It runs as it is, and what it sends are zeros. Once `window` has
//! more than a few lines, put what it computes into `src/lib.rs`, which knows no ports and no clock.

use std::process::ExitCode;

use bateleur_apex::{Context, Partition, StartError, Window};

struct Third {
    /// Windows of this incarnation.
    windows: u64,
}

impl Partition for Third {
    fn start(_context: &mut Context) -> Result<Self, StartError> {
        // Before the first window, with all the time of `startup_timeout`: here it may allocate, read files and fail. The
        // text of an error is what the operator reads.
        Ok(Self { windows: 0 })
    }

    fn window(&mut self, window: &Window) {
        if self.windows == 0 {
            window.report("runs");
        }
        // Compute here. Nothing may block, and every loop needs a bound; the time is `window.start_ns()` or
        // `window.now_ns()`, never the system's. `window.report` tells the operator, `window.raise` is a health error.
        self.windows += 1;
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Third>()
}

#[cfg(test)]
mod tests {
    use bateleur_apex::Harness;

    use super::*;

    #[test]
    fn windows_read_every_destination_and_write_every_source() -> Result<(), StartError> {
        let mut harness = Harness::new("third")?;
        let mut partition = harness.start::<Third>()?;
        partition.window();
        Ok(())
    }
}
