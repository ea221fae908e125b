//! Hidden verbs: the processes that serve an executive. They are started by it, never by a person.

use anyhow::Result;
use clap::Subcommand;

use super::{Code, FINE};

#[derive(Debug, Subcommand)]
pub enum Helper {
    /// Does nothing: shows that a process can be started so.
    #[command(hide = true)]
    Probe,
    /// Sends what some channels carry to a client.
    #[command(hide = true)]
    Observer {
        /// The channels, as JSON.
        order: String,
    },
    /// Writes every message of a module into the log behind descriptor 3.
    #[command(hide = true)]
    Recorder {
        /// The channels, as JSON.
        order: String,
    },
}

pub(crate) fn run(helper: &Helper) -> Result<Code> {
    match helper {
        Helper::Probe => {}
        Helper::Observer { order } => crate::observer::run(order)?,
        Helper::Recorder { order } => crate::recorder::run(order)?,
    }
    Ok(FINE)
}
