//! A partition that counts its windows in a memory block where it may write one, and otherwise watches another one count.

use std::process::ExitCode;

use bateleur_apex::{Context, MemoryBlock, Partition, StartError, Takeover, Window};

struct Blocks {
    block: MemoryBlock,
    found: Option<String>,
    seen: u64,
}

impl Blocks {
    fn count(&self) -> u64 {
        self.block.load(8).unwrap_or(u64::MAX)
    }
}

impl Partition for Blocks {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let block = context.memory_block("count")?;
        let found = format!("{:?} found {:?}", context.start_condition(), block.load::<u64>(8));
        Ok(Self { block, found: Some(found), seen: 0 })
    }

    fn take_over(&mut self, _: &Takeover) {
        self.found = Some(format!("took over {}", self.count()));
    }

    fn window(&mut self, window: &Window) {
        if let Some(found) = self.found.take() {
            window.report(&found);
        }
        if self.block.is_writable() {
            if let Err(wrong) = self.block.store(8, &(self.count() + 1)) {
                window.report(&wrong.to_string());
            }
        } else if self.count() < self.seen || self.block.store(8, &0_u64).is_ok() {
            window.report("FAILED: it went back, or was written");
        }
        self.seen = self.count();
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Blocks>()
}
