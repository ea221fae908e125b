//! `bateleur_foxglove`: the ports, the health log and the figures of a running module, for Foxglove, while it runs.
//!
//! Responsible for: a WebSocket server of Foxglove's own protocol, by its own SDK. Every port is a topic `/partition/port`, as in a run's
//! `ports.mcap`; `/health` and `/module` are the health log and the figures. Times are module time.
//! The one thing it must never do: disturb the module, or take an order for it. It is an observer like `bateleur ports echo`.
//!
//! Exit codes: 0 the module has ended, or Ctrl-C; 2 there is no such module, or it could not listen.

use std::net::SocketAddr;
use std::process::ExitCode;

use bateleur_executive_cli::Target;
use clap::Parser;

mod json;
mod stream;

/// Show a running module live in Foxglove: all ports, the health log, and the figures of its partitions.
#[derive(Debug, Parser)]
#[command(version)]
struct Arguments {
    #[command(flatten)]
    target: Target,
    /// Where Foxglove connects; port 0 takes a free one. Whoever reaches it may read all ports, without encryption.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8765")]
    listen: SocketAddr,
}

fn main() -> ExitCode {
    let arguments = match Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(error) => {
            let _ = error.print(); // nobody reads
            return ExitCode::from(if error.use_stderr() { 2 } else { 0 });
        }
    };
    match stream::run(&arguments.target, arguments.listen) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("bateleur_foxglove: {error:#}");
            ExitCode::from(2)
        }
    }
}
