//! The program `bateleurd`: runs one module of a compiled plan. `bateleur run` compiles the schedule file and becomes this program.
//!
//! Usage: `bateleurd PLAN [ORDER]`. PLAN is a file that `bateleur check --compile` wrote, ORDER a run's order as JSON; `fd:N` is a
//! descriptor that was handed over. Exit codes: 0 it ran and was stopped, 1 an error of the module ended it, or a log could not
//! be written, 2 it could not run.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Write};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use bateleur_contract::Mapped;
use bateleur_daemon::module::{Options, Supervision, run};
use bateleur_daemon::world::Companion;
use bateleur_daemon::{CANNOT_RUN, FINE, SIGPWR, lost_supervisor, supervisor};
use bateleur_host::helper::{guard, remover};
use bateleur_monitor::event::{Event, Events};
use bateleur_monitor::lines::{LineLog, Patience, Sink};
use bateleur_monitor::planned::not_reached;
use bateleur_monitor::run_order::{RunOrder, Supervised};
use bateleur_plan::Plan;
use bateleur_plan::compiled::{Compiled, MOST_BYTES};
use bateleur_system::handed_over::inherited;
use bateleur_system::{folders, privileges, thread};
use rustix::fs::{FlockOperation, flock};
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

/// A file would grow beyond what this process may write (Linux, signal(7)). Such a write fails then, and costs records and not the module.
const SIGXFSZ: i32 = 25;
/// Where a run writes that was not told otherwise.
const LATEST: &str = "target/runs/latest";
/// The longest order, bytes: a flight of many acts has some thousand.
const LONGEST_ORDER: usize = 4 << 20;
/// Before the number of a descriptor that was handed over.
const DESCRIPTOR: &str = "fd:";

const USAGE: &str = "usage: bateleurd PLAN [ORDER]\n\n\
    Runs one module of a compiled plan. PLAN is a file that `bateleur check --compile FILE` wrote.\n\
    `bateleur run` does both; see docs/src/trusted.md.";

fn main() -> ExitCode {
    if let Err(error) = privileges::keep_used() {
        say(
            &mut std::io::stderr(),
            &format!(
                "bateleur: cannot drop the capabilities that it does not use: {error}; let the unit or the container allow the system calls capset and prctl"
            ),
        );
        return ExitCode::from(CANNOT_RUN);
    }
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = arguments.iter().map(String::as_str).collect();
    let result = match words[..] {
        ["--help" | "-h"] => {
            say(&mut std::io::stdout(), USAGE);
            Ok(FINE)
        }
        ["--version" | "-V"] => {
            say(&mut std::io::stdout(), concat!("bateleurd ", env!("CARGO_PKG_VERSION")));
            Ok(FINE)
        }
        ["guard", instance] => guard::run(instance).map(|()| FINE).map_err(|error| error.to_string()),
        ["remover", ref paths @ ..] if !paths.is_empty() => {
            let paths: Vec<PathBuf> = paths.iter().map(PathBuf::from).collect();
            remover::run(&paths).map(|()| FINE).map_err(|error| error.to_string())
        }
        ["probe"] => Ok(FINE), // shows that a process can be started so
        [plan] => run_plan(plan, None),
        [plan, order] => run_plan(plan, Some(order)),
        _ => Err(USAGE.to_owned()),
    };
    ExitCode::from(result.unwrap_or_else(|error| {
        say(&mut std::io::stderr(), &format!("bateleur: {error}"));
        CANNOT_RUN
    }))
}

/// A terminal or a pipe that is gone must not end a flight.
fn say(to: &mut dyn Write, text: &str) {
    let _ = to.write_all(format!("{text}\n").as_bytes()); // in one write, as others write there too; nobody may read
}

fn run_plan(plan: &str, order: Option<&str>) -> Result<u8, String> {
    let _ = signal_hook::flag::register(SIGXFSZ, Arc::default()); // as before, too
    let bytes = read(plan, MOST_BYTES)?;
    let Compiled { plan, .. } = Compiled::read(&bytes).map_err(|error| format!("{plan}: {error}"))?;
    let mut order = match order {
        None => RunOrder::default(),
        Some(order) => serde_json::from_slice(&read(order, LONGEST_ORDER)?)
            .map_err(|error| format!("{order}: it is no order of a run: {error}"))?,
    };
    if order.module.is_empty() {
        order.module = only_module(&plan)?;
    }
    if order.output.as_os_str().is_empty() {
        order.output = LATEST.into();
    }
    if supervisor::is_wanted(&plan, &order) {
        return supervisor::run(&plan, &bytes, &order);
    }
    if order.supervised.is_some() {
        lost_supervisor::watch(&bytes, &order)?;
    }
    drop(bytes);
    let alone = folder(&order.output)?;
    let (acts, changes) = (order.acts.clone(), order.schedule_changes.clone());
    let for_person = order.events_fd.is_none();
    let options = options(order)?;
    let page = options.supervision.as_ref().map(|supervision| supervision.page.clone());
    let ran = run(plan, options).map_err(|error| error.to_string());
    drop(alone);
    let code = ran.as_ref().map_or(CANNOT_RUN, |outcome| outcome.code());
    if let Some(page) = page {
        page.end(code);
    }
    let outcome = ran?;
    if for_person {
        let missed = not_reached(&acts, &changes, outcome.module_ns);
        missed.iter().for_each(|line| say(&mut std::io::stderr(), line));
    }
    Ok(code)
}

/// What a file holds, or a descriptor that was handed over; no more than `most` bytes.
fn read(name: &str, most: usize) -> Result<Vec<u8>, String> {
    let cannot = |error: std::io::Error| format!("cannot read {name}: {error}");
    let mut file = match name.strip_prefix(DESCRIPTOR) {
        None => File::open(name).map_err(cannot)?,
        Some(number) => {
            let number = number.parse().map_err(|_| format!("{name}: that is no number of a descriptor"))?;
            File::from(inherited(number)?)
        }
    };
    let mut bytes = Vec::new();
    // One more shows that there is more.
    Read::by_ref(&mut file).take(most as u64 + 1).read_to_end(&mut bytes).map_err(cannot)?;
    if bytes.len() > most {
        return Err(format!("cannot read {name}: it is longer than {} MiB", most >> 20));
    }
    Ok(bytes)
}

fn only_module(plan: &Plan) -> Result<String, String> {
    match plan.modules.as_slice() {
        [only] => Ok(only.name.clone()),
        several => {
            let names: Vec<_> = several.iter().map(|module| module.name.as_str()).collect();
            let names = names.join(", ");
            Err(format!(
                "the plan has several modules: choose one with --module ({names}); `bateleur run --hosts` starts all of them on this machine"
            ))
        }
    }
}

/// Makes the folder for logs where it is missing, and keeps other runs out of it as long as what it gives is kept.
fn folder(folder: &Path) -> Result<File, String> {
    let shown = folder.display();
    folders::make(folder).map_err(|error| format!("cannot make the folder {shown}: {error}"))?;
    let alone = File::open(folder).map_err(|error| format!("cannot open the folder {shown}: {error}"))?;
    flock(&alone, FlockOperation::NonBlockingLockExclusive).map_err(|_| {
        format!("another run writes into {shown}: wait for its end, or name another folder with --output")
    })?;
    Ok(alone)
}

fn options(mut order: RunOrder) -> Result<Options, String> {
    let flag = |signals: &[i32]| {
        let flag = Arc::new(AtomicBool::new(false));
        for signal in signals {
            signal_hook::flag::register(*signal, flag.clone())
                .map_err(|error| format!("cannot watch for signals: {error}"))?;
        }
        Ok::<_, String>(flag)
    };
    let stop = flag(&[SIGINT, SIGTERM, SIGHUP])?;
    if order.until_stdin_closes {
        stop_with_standard_input(stop.clone()).map_err(|error| {
            format!("cannot start the thread that waits for the end of standard input: {error}")
        })?;
    }
    let companion = |number| {
        Companion::new(UnixStream::from(inherited(number)?))
            .map_err(|error| format!("the companion's socket can not be used: {error}"))
    };
    let lines = match order.events_fd {
        Some(number) => LineLog::to(File::from(inherited(number)?), 0, Patience::Lose),
        None => LineLog::to(Person, 0, Patience::Lose),
    };
    let lines = lines.map_err(|error| format!("cannot start a thread: {error}"))?;
    let supervision = order.supervised.take().map(supervision).transpose()?;
    Ok(Options {
        supervision,
        companion: order.companion_fd.map(companion).transpose()?,
        link_keys: Vec::new(),
        events: Events::new(Some(lines)),
        stop,
        power_fail: flag(&[SIGPWR])?,
        order,
    })
}

fn supervision(handed: Supervised) -> Result<Supervision, String> {
    let page = Mapped::new(inherited(handed.page_fd)?);
    let page = page.map_err(|error| format!("the supervisor's page can not be used: {error}"))?;
    let memories = |handed: BTreeMap<String, i32>| {
        let memory = |(name, number)| {
            let memory = inherited(number)?;
            let _ = rustix::io::fcntl_setfd(&memory, rustix::io::FdFlags::CLOEXEC); // partitions get what is theirs
            Ok((name, Arc::new(memory)))
        };
        handed.into_iter().map(memory).collect::<Result<BTreeMap<_, _>, String>>()
    };
    Ok(Supervision {
        page: Arc::new(page),
        retained: memories(handed.retained_fds)?,
        memory_blocks: memories(handed.memory_block_fds)?,
        after: handed.after,
    })
}

fn stop_with_standard_input(stop: Arc<AtomicBool>) -> std::io::Result<()> {
    thread::named("standard input").spawn(move || {
        let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink()); // closed either way
        stop.store(true, Ordering::Release);
    })?;
    Ok(())
}

/// Turns events into lines for a terminal.
struct Person;

impl Sink for Person {}

impl Write for Person {
    fn write(&mut self, lines: &[u8]) -> std::io::Result<usize> {
        for line in lines.split(|byte| *byte == b'\n') {
            let text = serde_json::from_slice::<Event>(line).map(|event| event.to_string());
            if let Some(text) = text.ok().filter(|text| !text.is_empty()) {
                say(&mut std::io::stderr(), &text);
            }
        }
        Ok(lines.len())
    }

    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}
