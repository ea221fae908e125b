//! `bateleur top`: the table of `bateleur ps` for one module, again every second. On a terminal it is drawn in place, sorted by any column,
//! with a partition's details, and takes orders by keys; `?` shows them. Elsewhere each table follows the one before. `--once` ends after the
//! first. `--processes` adds the ARINC 653 processes of partitions; on a terminal it begins with the details, which have them. Ends with the
//! module, with `q`, or with Ctrl-C.

use std::io::{IsTerminal, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use bateleur_control::{Answer, AskError, Client, Request, Running};
use bateleur_monitor::event_text::printable;
use crossterm::event::{self, Event, KeyEventKind};

use self::board::{Act, Board};
use self::screen::Screen;
use super::ps::tables;
use super::target::{Target, status};
use super::{Code, FINE};
use crate::printed::Printed;

mod board;
mod draw;
mod screen;

/// Watch the partitions of a running module.
#[derive(Debug, clap::Args)]
pub struct Arguments {
    #[command(flatten)]
    target: Target,
    /// Show the processes of partitions too.
    #[arg(long)]
    processes: bool,
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

/// Between two looks whether a signal came or a key was pressed.
const LOOK: Duration = Duration::from_millis(50);

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM, signal_hook::consts::SIGHUP] {
        signal_hook::flag::register(signal, stop.clone()).context("cannot watch for signals")?;
    }
    let running = arguments.target.choose()?;
    let client = Client::connect(&running)?;
    let interval = Duration::from_secs_f64(arguments.interval);
    let on_terminal = std::io::stdout().is_terminal() && std::io::stdin().is_terminal() && !arguments.once;
    let ended = match on_terminal {
        true => drawn(client, &running, (interval, arguments.processes), &stop)?,
        false => printed(client, interval, arguments, &stop)?,
    };
    if ended {
        eprintln!("the module has ended");
    }
    Ok(FINE)
}

/// Tables one after the other; true: the module has ended.
fn printed(mut client: Client, interval: Duration, arguments: &Arguments, stop: &AtomicBool) -> Result<bool> {
    let (mut output, mut first) = (Printed, true);
    loop {
        let shown = match status(&mut client) {
            Ok(status) => tables(&status, arguments.processes),
            Err(error) if !first && has_ended(&error) => return Ok(true),
            Err(error) => return Err(error),
        };
        let told = output.write_all(format!("{shown}\n").as_bytes()).and_then(|()| output.flush());
        if told.is_err() || arguments.once {
            return Ok(false); // nobody reads any more
        }
        first = false;
        let begun = Instant::now();
        while begun.elapsed() < interval {
            if stop.load(Ordering::Acquire) {
                return Ok(false);
            }
            std::thread::sleep(LOOK);
        }
    }
}

/// On the terminal, until it is left; true: the module has ended.
fn drawn(
    mut client: Client,
    running: &Running,
    (interval, details): (Duration, bool),
    stop: &AtomicBool,
) -> Result<bool> {
    let mut board = Board::of(status(&mut client)?);
    board.details = details;
    let mut screen = Screen::open().context("cannot take the terminal")?;
    let mut asked = Instant::now();
    loop {
        screen.show(|size| draw::lines(&board, size)).context("cannot draw on the terminal")?;
        // A key shows at once, new figures when they are due.
        while asked.elapsed() < interval && !event::poll(LOOK)? {
            if stop.load(Ordering::Acquire) {
                return Ok(false);
            }
        }
        while event::poll(Duration::ZERO)? {
            let pressed = match event::read()? {
                Event::Key(key) if key.kind != KeyEventKind::Release => board.press(key),
                _ => None, // the terminal's size has changed: it is drawn again
            };
            match pressed {
                None => {}
                Some(Act::Leave) => return Ok(false),
                Some(Act::Order(request)) => {
                    board.answered(give(running, &request));
                    asked = Instant::now().checked_sub(interval).unwrap_or(asked); // what it led to is shown
                }
            }
        }
        if asked.elapsed() >= interval {
            asked = Instant::now();
            match status(&mut client) {
                Ok(status) => board.take(status),
                Err(error) if has_ended(&error) => return Ok(true),
                Err(error) => return Err(error),
            }
        }
        if stop.load(Ordering::Acquire) {
            return Ok(false);
        }
    }
}

/// Gives an order on a conversation of its own, and says what was answered.
fn give(running: &Running, request: &Request) -> Result<String, String> {
    match Client::connect(running).and_then(|mut client| client.ask(request)) {
        Ok(Answer::Done { text }) => Ok(printable(&text)),
        Ok(other) => Err(format!("the module's answer is not understood: {other:?}")),
        Err(error) => Err(printable(&error.to_string())),
    }
}

fn has_ended(error: &anyhow::Error) -> bool {
    matches!(
        error.downcast_ref(),
        Some(AskError::Closed(_) | AskError::Unreachable { .. } | AskError::Silent { .. })
    )
}
