//! `can_gateway`: the gateway between CAN and Ethernet as a program of its own; see `bateleur_can::cli`.

use std::process::ExitCode;

use bateleur_can::cli::{Verb, perform};
use clap::Parser;

/// Carries the frames of a CAN bus over UDP, and back.
#[derive(Debug, Parser)]
#[command(name = "can_gateway", version, arg_required_else_help = true)]
struct Arguments {
    #[command(subcommand)]
    verb: Verb,
}

fn main() -> ExitCode {
    match perform(&Arguments::parse().verb) {
        Ok(code) => ExitCode::from(code),
        Err(error) => {
            eprintln!("can_gateway: {error:#}");
            ExitCode::from(2)
        }
    }
}
