//! Hidden verbs: the processes that serve an executive. They are started by it, or by whoever starts several of them, never by a person.

use std::time::Duration;

use anyhow::Result;
use clap::Subcommand;

use super::{Code, FINE};

#[derive(Debug, Subcommand)]
pub enum Helper {
    /// Becomes `bateleur` with other arguments, in a network namespace of its own; standard input is the starter's socket.
    #[command(hide = true)]
    Within {
        /// An interface: NAME=OWN,OTHER,…, the addresses on its network.
        #[arg(long)]
        interface: Vec<String>,
        /// What `bateleur` is told there.
        #[arg(last = true)]
        arguments: Vec<String>,
    },
    /// Does nothing: shows that a process can be started so.
    #[command(hide = true)]
    Probe,
    /// Sends what some channels carry to a client.
    #[command(hide = true)]
    Observer {
        /// The channels, as JSON.
        order: String,
    },
    /// Writes into a channel what a client sends.
    #[command(hide = true)]
    Publisher {
        /// The channel, as JSON.
        order: String,
        /// CLOCK_MONOTONIC instant of module time 0, ns.
        origin_ns: u64,
        /// How long it stays when its client has gone, ns.
        lingers_ns: u64,
    },
    /// Writes what a recording has into channels.
    #[command(hide = true)]
    Player {
        /// The channels, as JSON.
        order: String,
    },
    /// Reads what a dead partition has written down.
    #[command(hide = true)]
    CrashReporter {
        /// Whose it is, as JSON.
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
        Helper::Within { interface, arguments } => crate::hosts::namespace::within(interface, arguments)?,
        Helper::Observer { order } => crate::observer::run(order)?,
        Helper::Publisher { order, origin_ns, lingers_ns } => {
            crate::publisher::run(order, *origin_ns, Duration::from_nanos(*lingers_ns))?;
        }
        Helper::Player { order } => crate::player::run(order)?,
        Helper::CrashReporter { order } => crate::crash_reporter::run(order)?,
        Helper::Recorder { order } => crate::recorder::run(order)?,
    }
    Ok(FINE)
}
