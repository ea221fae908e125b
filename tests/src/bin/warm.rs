//! A partition that counts its windows in retained memory and says at each start what it found there.

use std::process::ExitCode;

use bateleur_apex::{Context, Partition, Retained, StartError, Takeover, Window};

struct Warm {
    found: Option<String>,
    retained: Retained<u64>,
    count: u64,
}

impl Partition for Warm {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let mut retained = context.retained::<u64>()?;
        let count = retained.load();
        let found = format!("{:?} found {count:?}", context.start_condition());
        Ok(Self { found: Some(found), retained, count: count.unwrap_or(0) })
    }

    fn take_over(&mut self, takeover: &Takeover) {
        let count = self.retained.load();
        self.found = Some(format!("{:?} took over {count:?}", takeover.start_condition()));
        self.count = count.unwrap_or(0);
    }

    fn window(&mut self, window: &Window) {
        if let Some(found) = self.found.take() {
            window.report(&found);
        }
        self.count += 1;
        self.retained.store(&self.count);
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Warm>()
}
