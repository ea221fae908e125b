//! One flight of a campaign: a `bateleur fly` of its own, or a `bateleur run` of a plan that does not fly, watched until it ends, and
//! what is left of it.
//!
//! It must never wait for ever: a flight that does not end is ended, and counts as failed.

use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::os::unix::process::{CommandExt, ExitStatusExt};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use bateleur_report::campaign::{Figure, Flown};
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use serde_json::Value;

use super::again;
use crate::fly::here::{Engine, ONE_PROCESS_ENDS};

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
    /// What flies it: one process only where that shows all of it.
    pub(super) engine: Engine,
    /// The campaign flies in one process what it can.
    pub(super) mixed: bool,
    /// Options of that verb, without those that say where things go and what flies it.
    pub(super) options: Vec<String>,
    /// The user's own program that says whether it went well.
    pub(super) judge: Option<PathBuf>,
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

impl Order {
    /// The same flight as partitions, into `folder`.
    fn as_partitions(&self, folder: PathBuf) -> Self {
        Self { engine: Engine::Partitions, folder, ..self.clone() }
    }

    /// What to type.
    pub(super) fn command(&self) -> String {
        let words: Vec<String> = self.words().map(|word| quoted(&word)).collect();
        format!("bateleur {} {}", self.verb, words.join(" "))
    }

    fn words(&self) -> impl Iterator<Item = String> {
        let engine = (self.engine != Engine::Partitions).then(|| format!("--engine={}", self.engine.name()));
        self.options.iter().cloned().chain(engine)
    }
}

/// Flies it, in one process where that was ordered, and there one in so many a second time as partitions; nothing: the campaign was
/// stopped meanwhile.
pub(super) fn fly(order: &Order, stop: &AtomicBool) -> Option<Flown> {
    let mut flown = fly_once(order, stop)?;
    if order.mixed {
        flown.engine = Some(order.engine.name().into());
    }
    if order.engine == Engine::Partitions {
        return Some(flown);
    }
    if flown.digest.is_none() || flown.failure.as_ref().is_some_and(|why| why.contains(ONE_PROCESS_ENDS)) {
        // It came to what one process has not: partitions show it.
        let order = order.as_partitions(order.folder.clone());
        let engine = Some(order.engine.name().into());
        return Some(Flown { engine, ..fly_once(&order, stop)? });
    }
    if again::is_drawn(order.seed) {
        let judge = None; // of the flight, not of the comparison
        let again = Order { judge, ..order.as_partitions(order.folder.with_extension("again")) };
        let other = fly_once(&again, stop);
        let found = other.map(|other| again::difference((&flown, &order.folder), (&other, &again.folder)));
        let _ = std::fs::remove_dir_all(&again.folder); // what stays is removed when the campaign goes on
        flown.compared = true;
        if let Some(why) = found? {
            (flown.completed, flown.failure) = (false, Some(why));
        }
    }
    Some(flown)
}

/// Flies; nothing: the campaign was stopped meanwhile. A flight that can not even be started has failed.
fn fly_once(order: &Order, stop: &AtomicBool) -> Option<Flown> {
    let begun = Instant::now();
    let ending = match start(order, stop) {
        Ok(Some(child)) => watch(child, order.patience, stop),
        Ok(None) => return None,
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

/// A word as a shell reads it.
fn quoted(word: &str) -> String {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "-_=./,:@%+".contains(letter);
    if word.chars().all(plain) && !word.is_empty() {
        word.to_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

/// Starts it in an empty folder; nothing: the campaign was stopped meanwhile.
fn start(order: &Order, stop: &AtomicBool) -> io::Result<Option<Child>> {
    if order.folder.exists() {
        // Of a campaign that was stopped.
        if !await_writers(order, stop)? {
            return Ok(None);
        }
        std::fs::remove_dir_all(&order.folder)?;
    }
    std::fs::create_dir_all(&order.folder)?;
    let said = File::create(order.folder.join(SAID))?;
    let _ = flock(&said, FlockOperation::NonBlockingLockExclusive); // no file system has to have locks
    let program = std::env::current_exe()?;
    let child = Command::new(program)
        .arg(order.verb)
        .args(order.words())
        .args(if order.verb == FLY { ["--format=json"] } else { ["--record"] })
        .args(["--until-stdin-closes", "--output"])
        .arg(&order.folder)
        .stdin(Stdio::piped())
        .stdout(File::create(order.folder.join(SUMMARY))?)
        .stderr(said) // with the lock, which the flight's own processes inherit
        .process_group(0) // Ctrl-C is for the campaign, which ends its flights in their order
        .spawn();
    child.map(Some)
}

/// Waits until nobody writes into the flight's folder: flights of a campaign that was killed end a little later than it does. False:
/// this campaign was stopped meanwhile.
fn await_writers(order: &Order, stop: &AtomicBool) -> io::Result<bool> {
    let Ok(said) = File::options().append(true).open(order.folder.join(SAID)) else { return Ok(true) };
    let begun = Instant::now();
    while flock(&said, FlockOperation::NonBlockingLockExclusive) == Err(Errno::WOULDBLOCK) {
        if stop.load(Ordering::Acquire) {
            return Ok(false);
        }
        if begun.elapsed() > order.patience {
            let folder = order.folder.display();
            return Err(io::Error::other(format!("an earlier flight still writes into {folder}")));
        }
        std::thread::sleep(LOOK);
    }
    Ok(true)
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
        command: order.command(),
        conditions: order.conditions.clone(),
        completed: false,
        failure: None,
        figures: BTreeMap::new(),
        digest: None,
        module_time_s: None,
        wall_time_s: begun.elapsed().as_secs_f64(),
        folder: None,
        engine: None,
        compared: false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_quoted_where_a_shell_would_take_them_apart() {
        assert_eq!(quoted("--fault=gps_lost@100..130"), "--fault=gps_lost@100..130");
        assert_eq!(quoted("--schedule=my file.toml"), "'--schedule=my file.toml'");
        assert_eq!(quoted("it's"), "'it'\\''s'");
    }

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
