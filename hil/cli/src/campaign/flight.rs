//! One flight of a campaign: a `bateleur fly` of its own, or a `bateleur run` of a plan that does not fly, watched until it ends, and
//! what is left of it.
//!
//! It must never wait for ever: a flight that does not end is ended, and counts as failed.

use std::collections::BTreeMap;
use std::fs::File;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use bateleur_report::campaign::{Figure, Flown};
use serde_json::Value;

/// Between two looks whether a flight has ended.
const LOOK: Duration = Duration::from_millis(20);
/// How long a flight may take to end when it is asked to: it waits ten seconds for its executive itself.
const END_PATIENCE: Duration = Duration::from_secs(20);
/// Files beside the flight's own, in its folder.
const SAID: &str = "said.txt";
const SUMMARY: &str = "summary-as-printed.json";
/// What the judge said.
const JUDGED: &str = "judged.txt";
/// The verb for plans that do not fly.
pub(super) const RUN: &str = "run";
/// The one for those that do.
pub(super) const FLY: &str = "fly";
/// Letters of a flight's last words that are kept.
const MOST_WORDS: usize = 400;

/// A flight that is to be flown.
#[derive(Debug, Clone)]
pub(super) struct Order {
    pub(super) number: u64,
    pub(super) seed: u64,
    /// `fly` or `run`.
    pub(super) verb: &'static str,
    /// Options of that verb, without those that say where things go.
    pub(super) options: Vec<String>,
    /// The user's own program that says whether it went well.
    pub(super) judge: Option<PathBuf>,
    /// As a person would type it.
    pub(super) command: String,
    pub(super) conditions: BTreeMap<String, f64>,
    /// Where it flies.
    pub(super) folder: PathBuf,
    /// Real time after which it hangs.
    pub(super) patience: Duration,
}

/// How it went.
enum Ending {
    Ended(ExitStatus),
    Hung,
    Interrupted,
}

/// Flies; nothing: the campaign was stopped meanwhile. A flight that can not even be started has failed.
pub(super) fn fly(order: &Order, stop: &AtomicBool) -> Option<Flown> {
    let begun = Instant::now();
    let ending = match start(order) {
        Ok(child) => watch(child, order.patience, stop),
        Err(error) => {
            return Some(failed(order, begun, format!("the flight could not be started: {error}")));
        }
    };
    match ending {
        Ending::Interrupted => None,
        Ending::Hung => {
            let seconds = order.patience.as_secs();
            Some(failed(order, begun, format!("it hangs: no end after {seconds} s (--patience)")))
        }
        Ending::Ended(status) if !matches!(status.code(), Some(0 | 1)) => {
            Some(failed(order, begun, reason(status, &order.folder)))
        }
        Ending::Ended(status) => {
            let flown = match (summary(&order.folder), order.verb) {
                (Some(summary), _) => flown(order, begun, &summary),
                (None, RUN) => Flown { completed: true, ..empty(order, begun) },
                (None, _) => failed(order, begun, reason(status, &order.folder)),
            };
            let Some(judge) = order.judge.as_ref().filter(|_| flown.completed) else { return Some(flown) };
            let why = judged(judge, order, status, stop)?;
            Some(Flown { completed: why.is_none(), failure: why.or(flown.failure.clone()), ..flown })
        }
    }
}

/// Asks the judge; why it did not pass, in words. Nothing at all: the campaign was stopped meanwhile.
fn judged(judge: &Path, order: &Order, status: ExitStatus, stop: &AtomicBool) -> Option<Option<String>> {
    let said = order.folder.join(JUDGED);
    let started = (|| {
        let errors = File::create(&said)?;
        Command::new(judge)
            .arg(&order.folder)
            .env("BATELEUR_SEED", order.seed.to_string())
            .env("BATELEUR_EXIT", status.code().unwrap_or_default().to_string())
            .stdin(Stdio::null())
            .stdout(errors.try_clone()?)
            .stderr(errors)
            .process_group(0)
            .spawn()
    })();
    let name = judge.display();
    let ending = match started {
        Ok(child) => watch(child, order.patience, stop),
        Err(error) => return Some(Some(format!("{name} could not be started: {error}"))),
    };
    let words = || last_words(&std::fs::read_to_string(&said).unwrap_or_default());
    Some(match ending {
        Ending::Interrupted => return None,
        Ending::Hung => {
            Some(format!("{name} hangs: no end after {} s (--patience)", order.patience.as_secs()))
        }
        Ending::Ended(status) => match status.code() {
            Some(0) => None,
            Some(1) if words().is_empty() => Some(format!("{name} says no")),
            Some(1) => Some(words()),
            _ => Some(format!("{name} could not judge ({status}): {}", words())),
        },
    })
}

fn start(order: &Order) -> std::io::Result<Child> {
    if order.folder.exists() {
        std::fs::remove_dir_all(&order.folder)?; // of a campaign that was stopped
    }
    std::fs::create_dir_all(&order.folder)?;
    let program = std::env::current_exe()?;
    Command::new(program)
        .arg(order.verb)
        .args(&order.options)
        .args(if order.verb == FLY { ["--format=json"] } else { ["--record"] })
        .args(["--until-stdin-closes", "--output"])
        .arg(&order.folder)
        .stdin(Stdio::piped())
        .stdout(File::create(order.folder.join(SUMMARY))?)
        .stderr(File::create(order.folder.join(SAID))?)
        .process_group(0) // Ctrl-C is for the campaign, which ends its flights in their order
        .spawn()
}

fn watch(mut child: Child, patience: Duration, stop: &AtomicBool) -> Ending {
    let begun = Instant::now();
    loop {
        match child.try_wait() {
            Ok(Some(status)) => return Ending::Ended(status),
            Ok(None) if stop.load(Ordering::Acquire) => {
                end(child);
                return Ending::Interrupted;
            }
            Ok(None) if begun.elapsed() < patience => std::thread::sleep(LOOK),
            _ => {
                end(child);
                return Ending::Hung;
            }
        }
    }
}

/// Asks a flight to end, and ends it where it does not. Its executive and simulator end when it does.
fn end(mut child: Child) {
    match child.stdin.take() {
        Some(input) => drop(input),
        // The judge has none.
        None => drop(rustix::process::kill_process_group(
            rustix::process::Pid::from_child(&child),
            rustix::process::Signal::TERM,
        )),
    }
    let begun = Instant::now();
    while begun.elapsed() < END_PATIENCE {
        if !matches!(child.try_wait(), Ok(None)) {
            return;
        }
        std::thread::sleep(LOOK);
    }
    let _ = child.kill(); // it has ended meanwhile
    let _ = child.wait(); // as above
}

fn summary(folder: &Path) -> Option<Value> {
    serde_json::from_slice(&std::fs::read(folder.join(SUMMARY)).ok()?).ok()
}

/// Why there is no summary.
fn reason(status: ExitStatus, folder: &Path) -> String {
    let how = match (status.code(), status.signal()) {
        (Some(code), _) => format!("the flight ended with code {code} and no summary"),
        (None, Some(signal)) => format!("the flight was ended by signal {signal}"),
        (None, None) => "the flight ended without a word".into(),
    };
    let said = std::fs::read_to_string(folder.join(SAID)).unwrap_or_default();
    match last_words(&said) {
        words if words.is_empty() => how,
        words => format!("{how}; last words: {words}"),
    }
}

/// What a program said last: its error, which may have several lines, or its last line. The error of another program, which it
/// points at, stands before its own.
fn last_words(said: &str) -> String {
    let lines: Vec<&str> = said.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    let own = lines.iter().rposition(|line| line.starts_with("bateleur: "));
    let points_above = |at: usize| lines[at].contains("stands above this line");
    let error = own.map(|at| if points_above(at) { at.saturating_sub(1) } else { at });
    let words = lines.get(error.unwrap_or(lines.len().saturating_sub(1))..).unwrap_or_default().join(" ");
    words.chars().take(MOST_WORDS).collect()
}

fn flown(order: &Order, begun: Instant, summary: &Value) -> Flown {
    let number =
        |name: &str| name.split('.').try_fold(summary, |value, key| value.get(key)).and_then(Value::as_f64);
    let mut figures: BTreeMap<String, f64> = Figure::ALL
        .iter()
        .filter_map(|figure| Some((figure.name.to_owned(), number(figure.name)?)))
        .collect();
    let faults = summary["faults"].as_array().into_iter().flatten();
    let recoveries = faults.filter_map(|fault| fault["recovery_ms"].as_f64());
    if let Some(latest) = recoveries.max_by(f64::total_cmp) {
        figures.insert("recovery_max_ms".into(), latest);
    }
    Flown {
        completed: summary["completed"] == true,
        failure: summary["failure"].as_str().map(str::to_owned),
        figures,
        digest: summary["digest"].as_str().map(str::to_owned),
        module_time_s: number("module_time_s"),
        ..empty(order, begun)
    }
}

fn failed(order: &Order, begun: Instant, reason: String) -> Flown {
    Flown { failure: Some(reason), ..empty(order, begun) }
}

fn empty(order: &Order, begun: Instant) -> Flown {
    Flown {
        number: order.number,
        seed: order.seed,
        command: order.command.clone(),
        conditions: order.conditions.clone(),
        completed: false,
        failure: None,
        figures: BTreeMap::new(),
        digest: None,
        module_time_s: None,
        wall_time_s: begun.elapsed().as_secs_f64(),
        folder: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn last_words_are_the_whole_error_or_the_last_line() {
        assert_eq!(
            last_words("    1.0 s  engaging\nbateleur: no mission:\n  |\nmissing\n"),
            "bateleur: no mission: | missing"
        );
        assert_eq!(last_words("one\ntwo\n\n"), "two");
        assert_eq!(last_words(""), "");
    }
}
