//! `bateleur top`: the table of `bateleur ps` for one module, again every second. On a terminal it is drawn in place;
//! otherwise each table follows the one before. `--once` ends after the first. Ends with the module, or with Ctrl-C.

use std::io::{IsTerminal, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use bateleur_control::AskError;

use super::ps::table;
use super::target::{Target, status};
use super::{Code, FINE};
use crate::printed::Printed;

/// Watch the partitions of a running module.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    target: Target,
    /// Show the figures once and end.
    #[arg(long)]
    once: bool,
    /// Seconds between two looks.
    #[arg(long, value_name = "SECONDS", default_value_t = 1.0, value_parser = parse_interval)]
    interval: f64,
}

fn parse_interval(text: &str) -> Result<f64, String> {
    let seconds = text.parse::<f64>().ok().filter(|seconds| (0.1..=20.0).contains(seconds));
    seconds.ok_or_else(|| format!("\"{text}\" is not a number of seconds from 0.1 to 20"))
}

/// Between two looks whether Ctrl-C was pressed.
const LOOK: Duration = Duration::from_millis(50);
/// To the upper left corner; each line ends by clearing the rest of the line, and the last clears what is below.
const HOME: &str = "\x1b[H";
const CLEAR_LINE: &str = "\x1b[K\r\n";
const CLEAR_BELOW: &str = "\x1b[J";
const CLEAR_ALL: &str = "\x1b[2J";

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
        signal_hook::flag::register(signal, stop.clone()).context("cannot watch for signals")?;
    }
    let mut client = arguments.target.connect()?;
    let in_place = std::io::stdout().is_terminal() && !arguments.once;
    let mut output = Printed;
    if in_place {
        write!(output, "{CLEAR_ALL}")?;
    }
    let mut first = true;
    loop {
        let shown = match status(&mut client) {
            Ok(status) => table(&status),
            Err(error) if !first && has_ended(&error) => {
                eprintln!("the module has ended");
                return Ok(FINE);
            }
            Err(error) => return Err(error),
        };
        let text = match in_place {
            true => format!("{HOME}{}{CLEAR_BELOW}", shown.replace('\n', CLEAR_LINE)),
            false => format!("{shown}\n"),
        };
        let told = output.write_all(text.as_bytes()).and_then(|()| output.flush());
        if told.is_err() || arguments.once {
            return Ok(FINE); // nobody reads any more
        }
        first = false;
        let begun = Instant::now();
        while begun.elapsed().as_secs_f64() < arguments.interval {
            if stop.load(Ordering::Acquire) {
                return Ok(FINE);
            }
            std::thread::sleep(LOOK);
        }
    }
}

fn has_ended(error: &anyhow::Error) -> bool {
    matches!(
        error.downcast_ref(),
        Some(AskError::Closed(_) | AskError::Unreachable { .. } | AskError::Silent { .. })
    )
}
