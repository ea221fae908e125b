//! Hidden verbs: the processes that serve an executive. They are started by it, never by a person.

use std::path::PathBuf;

use anyhow::Result;
use bateleur_host::helper::{channel_cleaner, channel_holder, channel_probe, guard, remover};
use bateleur_ports::Domain;
use clap::Subcommand;

use super::{Code, FINE};

#[derive(Debug, Subcommand)]
pub(crate) enum Helper {
    /// Creates and holds the module's channels.
    #[command(hide = true)]
    ChannelHolder {
        /// What to create, as JSON.
        order: String,
    },
    /// Cleans up after a dead partition.
    #[command(hide = true)]
    ChannelCleaner {
        /// Root of the module's shared memory.
        root: String,
        /// The dead process.
        pid: u32,
        /// Its user, of which nobody lives: everything of it goes.
        #[arg(long)]
        user: Option<u32>,
        /// One of its channels whose memory must not be looked at.
        #[arg(long)]
        damaged: Vec<String>,
        /// The channels that it was attached to.
        channels: Vec<String>,
    },
    /// Removes directories of channels that were made anew.
    #[command(hide = true)]
    Remover {
        /// Where they were put.
        paths: Vec<PathBuf>,
    },
    /// Finds out which of a partition's channels are damaged.
    #[command(hide = true)]
    ChannelProbe {
        /// The partition's ports, as JSON.
        order: String,
    },
    /// Attaches to channels and leaves them again.
    #[command(hide = true)]
    Attach {
        /// The ports, as JSON.
        order: String,
    },
    /// Cleans up after a dead executive.
    #[command(hide = true)]
    Guard {
        /// The run, as JSON.
        instance: String,
    },
    /// Becomes `bateleur` with other arguments, in a network namespace of its own.
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
    /// Writes every message of a module into the log behind descriptor 3.
    #[command(hide = true)]
    Recorder {
        /// The channels, as JSON.
        order: String,
    },
}

pub(crate) fn run(helper: &Helper) -> Result<Code> {
    match helper {
        Helper::ChannelHolder { order } => channel_holder::run(order)?,
        Helper::ChannelCleaner { root, pid, user, damaged, channels } => {
            let dead = channel_cleaner::Dead { pid: *pid, user: *user };
            channel_cleaner::run(&Domain { root: root.clone() }, dead, channels, damaged);
        }
        Helper::Remover { paths } => remover::run(paths)?,
        Helper::ChannelProbe { order } => channel_probe::run(order)?,
        Helper::Attach { order } => channel_probe::attach(order)?,
        Helper::Guard { instance } => guard::run(instance)?,
        Helper::Within { interface, arguments } => {
            super::fly::hosts::namespace::within(interface, arguments)?;
        }
        Helper::Probe => {}
        Helper::Observer { order } => crate::observer::run(order)?,
        Helper::Recorder { order } => crate::recorder::run(order)?,
    }
    Ok(FINE)
}
