//! `bateleur view` of a flight that goes on: a process of its own, which ends with the flight, however that ends.

use std::process::{Child, Command, Stdio};

use anyhow::{Context, Result};

use super::beside_self;

/// See the module's head.
pub(super) struct Viewer(Child);

impl Viewer {
    /// Of the module with that executive; prints its address as soon as the module runs.
    pub(super) fn start(executive: u32) -> Result<Self> {
        let mut command = Command::new(beside_self("bateleur")?);
        command.args(["view", "--of-flight", "--module", &executive.to_string()]);
        // It ends when its standard input does: also when this process is killed.
        command.stdin(Stdio::piped()).stdout(Stdio::null());
        command.spawn().map(Self).context("cannot start the view")
    }
}

impl Drop for Viewer {
    fn drop(&mut self) {
        drop(self.0.stdin.take());
        let _ = self.0.wait(); // it has gone by itself
    }
}
