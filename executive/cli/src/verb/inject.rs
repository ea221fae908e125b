//! `bateleur inject TARGET FAULT`: provokes a fault in a running module, to see what its health monitor and the others make
//! of it. `run` and `fly` take the same with a time: `--inject TARGET:FAULT@SECONDS`.
//!
//! TARGET is a partition; for faults of messages a source port, PARTITION.PORT; for faults of the executive itself one of
//! `executive` (signals), `dispatcher`, `monitor` (stalls). What the faults are says `--list`. Exit codes: 0 it was provoked, 2 it was refused.

use anyhow::{Result, anyhow};
use bateleur_control::Request;
use bateleur_monitor::inject::Fault;

use super::target::Target;
use super::{Code, FINE};

/// Provoke a fault in a running module.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    /// A partition, a source port (PARTITION.PORT), or `executive`, `dispatcher`, `monitor`.
    #[arg(value_name = "TARGET", required_unless_present = "list")]
    to: Option<String>,
    /// The fault, such as `panic`, `sigkill`, `drop=10`, `delay=10/50ms`, `stall=20ms`.
    #[arg(value_name = "FAULT", required_unless_present = "list")]
    fault: Option<String>,
    /// Name every fault, and end.
    #[arg(long)]
    list: bool,
    #[command(flatten)]
    target: Target,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    if arguments.list {
        Fault::names().for_each(|name| println!("{name}"));
        return Ok(FINE);
    }
    let (Some(to), Some(fault)) = (&arguments.to, &arguments.fault) else { return Ok(FINE) };
    // A mistyped one is found before a module is looked for.
    let _: Fault = fault.parse().map_err(|why: String| anyhow!(why))?;
    arguments.target.order(&Request::Inject { target: to.clone(), fault: fault.clone() })?;
    Ok(FINE)
}
