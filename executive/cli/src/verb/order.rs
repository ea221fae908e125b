//! `bateleur kill|stop|start|freeze|thaw PARTITION`, `bateleur schedule NAME`: orders to a running module. Each is an entry in its health log
//! and a line on its standard error, "by the operator".
//!
//! Exit codes: 0 it was done; 2 it was refused, and why is said.

use anyhow::Result;
use bateleur_control::Request;

use super::target::Target;
use super::{Code, FINE};

/// An order to a partition.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// The partition.
    partition: String,
    #[command(flatten)]
    target: Target,
}

/// Another schedule.
#[derive(Debug, clap::Args)]
pub struct Schedule {
    /// The schedule.
    name: String,
    #[command(flatten)]
    target: Target,
}

pub(crate) fn schedule(arguments: &Schedule) -> Result<Code> {
    arguments.target.order(&Request::Schedule { name: arguments.name.clone() })?;
    Ok(FINE)
}

pub(crate) fn run(arguments: &Arguments, request: impl FnOnce(String) -> Request) -> Result<Code> {
    arguments.target.order(&request(arguments.partition.clone()))?;
    Ok(FINE)
}
