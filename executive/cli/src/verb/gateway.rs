//! `bateleur gateway`: the gateway between CAN and Ethernet, run or asked; the same as the program `can_gateway`.
//!
//! Exit codes: 0 fine, 1 it runs and something is wrong (a bus that is off, another gateway with the same identity), 2 it could
//! not run, or none runs.

use anyhow::Result;

use super::{CANNOT_RUN, Code, FINE, WRONG};

/// Run a gateway between CAN and Ethernet, or ask a running one.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(subcommand)]
    verb: bateleur_can::cli::Verb,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    Ok(match bateleur_can::cli::perform(&arguments.verb)? {
        0 => FINE,
        1 => WRONG,
        _ => CANNOT_RUN,
    })
}
