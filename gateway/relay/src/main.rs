//! The relay of a module: a partition that carries what crosses to other modules.
//!
//! Everything that two relays agree on is in the library; here are the ports, the transport and the clock.

mod partition;

use std::process::ExitCode;

fn main() -> ExitCode {
    bateleur_apex::run::<partition::Relay>()
}
