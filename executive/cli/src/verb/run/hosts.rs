//! `bateleur run --hosts`: all modules of a plan, each as a process of its own that runs one, on this machine. Each has a network
//! namespace and the plan's addresses, or their relays talk over addresses of the loopback interface. On the virtual clock they share
//! it, and the same run comes out every time.
//!
//! Each ends when this process does, however it does. Exit codes: the worst of those of the modules.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::os::fd::OwnedFd;
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Command};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use bateleur_host::processor::Claim;
use bateleur_plan::Plan;
use bateleur_recording::hosts::FOLDER;
use bateleur_system::folders;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use super::Arguments;
use crate::code::{CANNOT_RUN, Code, FINE, WRONG};
use crate::hosts::namespace::{self, Lan};
use crate::hosts::{self, Keys};
use crate::plan_file;

/// How often the processes are looked at.
const LOOK: Duration = Duration::from_millis(20);

/// Where the modules' relays talk.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Where {
    /// In namespaces, where that can be.
    Any,
    Namespaces,
    Loopback,
}

pub(super) fn run(arguments: &Arguments, place: Where) -> Result<Code> {
    let Some(plan) = plan_file::read_or_say(&arguments.schedule)? else { return Ok(CANNOT_RUN) };
    if plan.modules.len() < 2 {
        bail!("{} has one module: leave --hosts out", arguments.schedule.display());
    }
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        signal_hook::flag::register(signal, stop.clone()).context("cannot watch for signals")?;
    }
    if arguments.until_stdin_closes {
        let stop = stop.clone();
        std::thread::spawn(move || {
            let _ = std::io::copy(&mut std::io::stdin(), &mut std::io::sink()); // closed either way
            stop.store(true, Ordering::Release);
        });
    }
    let mut machine = Machine::prepare(arguments, &plan, place)?;
    let mut modules = Vec::new();
    for place in 0..plan.modules.len() {
        modules.push(machine.start(arguments, &plan, place)?);
    }
    await_all(&mut modules, &stop)
}

/// What is the same for all hosts.
struct Machine {
    folder: PathBuf,
    /// On the virtual clock: the file that they share, and their processor, because they wait for each other.
    together: Option<(PathBuf, Claim)>,
    /// Their networks; none on the loopback interface.
    lan: Option<Lan>,
    addresses: BTreeMap<SocketAddr, SocketAddr>,
    keys: Keys,
}

/// A module's process; it ends with its line.
struct Module {
    process: Child,
    line: Option<UnixStream>,
}

impl Machine {
    fn prepare(arguments: &Arguments, plan: &Plan, place: Where) -> Result<Self> {
        let folder = arguments.output.clone().unwrap_or_else(crate::installed::latest_run).join(FOLDER);
        folders::make(&folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
        let lan = lan(arguments, plan, place)?;
        let mut addresses = match &lan {
            Some(_) => BTreeMap::new(),
            None => hosts::on_loopback(plan, std::process::id())?,
        };
        addresses.extend(arguments.address.iter().copied());
        let keys = Keys::missing(&arguments.schedule, plan)?;
        let together = arguments.fast.then(|| (hosts::shared_clock(), Claim::take(&plan.cores())));
        Ok(Self { folder, together, lan, addresses, keys })
    }

    /// The process of the module at `place`.
    fn start(&mut self, arguments: &Arguments, plan: &Plan, place: usize) -> Result<Module> {
        let name = &plan.modules[place].name;
        let program = std::env::current_exe().context("cannot find this program")?;
        let mut command = Command::new(&program);
        let id = plan.module(name).map(|view| view.id());
        if let (Some(_), Some(id)) = (&self.lan, id) {
            let interfaces = namespace::interfaces(plan, id);
            command.arg("within").args(interfaces.iter().flat_map(|one| ["--interface", one])).arg("--");
        }
        command.arg("run").arg("--schedule").arg(&arguments.schedule).args(["--module", name]);
        command.arg("--output").arg(self.folder.join(name)).args(["--over", "--until-stdin-closes"]);
        if let Some((file, claim)) = &self.together {
            command.arg("--fast").arg("--together").arg(file);
            command.args(["--processor", &claim.processor().to_string()]);
            command.args(["--place", &format!("{place}/{}", plan.modules.len())]);
        }
        command.args(self.choices(arguments, plan, place));
        // Ctrl-C is for this process, which ends them all.
        let (line, input) = UnixStream::pair()?;
        command.stdin(OwnedFd::from(input)).process_group(0);
        let process = command.spawn().with_context(|| format!("cannot start {}", program.display()))?;
        drop(command); // and with it this process's copy of the module's end
        if let Some((lan, id)) = self.lan.as_mut().zip(id) {
            lan.join(plan, id, process.id(), &line)?;
        }
        Ok(Module { process, line: Some(line) })
    }

    fn choices(&self, arguments: &Arguments, plan: &Plan, place: usize) -> Vec<String> {
        // What is aimed at no partition is refused by the first module.
        let is_here = |target: &str| hosts::place_of_target(plan, target).unwrap_or(0) == place;
        let mut list = arguments.faults.arguments_for(true, is_here);
        let mut add = |option: &str, value: String| list.extend([option.to_owned(), value]);
        for (planned, other) in &self.addresses {
            add("--address", format!("{planned}={other}"));
        }
        let asked = arguments.key.iter().map(|(link, file)| (link.as_str(), file.clone()));
        for (link, file) in self.keys.files().chain(asked) {
            add("--key", format!("{link}={}", file.display()));
        }
        for setting in
            arguments.set.iter().filter(|setting| hosts::concerns_setting(plan, &setting.partition, place, 0))
        {
            add("--set", format!("{}.{}={}", setting.partition, setting.attribute, setting.value));
        }
        if let Some(until_s) = arguments.until {
            add("--until", until_s.to_string());
        }
        if let Some(how) = &arguments.require {
            add("--require", how.clone());
        }
        if arguments.record {
            list.push("--record".to_owned());
        }
        list
    }
}

impl Drop for Machine {
    fn drop(&mut self) {
        // The last module removes it, unless it was killed.
        let _ = self.together.as_ref().map(|(file, _)| std::fs::remove_file(file)); // as a rule it is gone
    }
}

/// The networks of the modules, and what is said of them.
fn lan(arguments: &Arguments, plan: &Plan, place: Where) -> Result<Option<Lan>> {
    let on_loopback = |why: &str| eprintln!("             hosts: over the loopback interface{why}");
    let lack = match place {
        Where::Loopback => {
            on_loopback("");
            return Ok(None);
        }
        _ if !arguments.address.is_empty() => Some("--address names others than the plan's".to_owned()),
        _ => namespace::lack(plan),
    };
    if let Some(lack) = lack {
        if place == Where::Namespaces {
            bail!("no host can have a network namespace: {lack}; --hosts=loopback needs none");
        }
        on_loopback(&format!(" ({lack})"));
        return Ok(None);
    }
    let made = Lan::make(plan, None);
    if place == Where::Any
        && let Err(error) = &made
    {
        on_loopback(&format!(" ({error:#})"));
        return Ok(None);
    }
    eprintln!("             hosts: each in a network namespace, with the addresses of the plan");
    made.map(Some)
}

/// Waits for the end of all; a module that can not run ends the others.
fn await_all(modules: &mut [Module], stop: &AtomicBool) -> Result<Code> {
    let mut codes: Vec<Option<i32>> = vec![None; modules.len()];
    while codes.iter().any(Option::is_none) {
        for (module, code) in modules.iter_mut().zip(&mut codes).filter(|(_, code)| code.is_none()) {
            if let Some(status) = module.process.try_wait().context("cannot wait for a module")? {
                // By a signal: it ran, and something was wrong.
                *code = Some(status.code().unwrap_or(1));
            }
        }
        if stop.load(Ordering::Acquire) || codes.contains(&Some(2)) {
            modules.iter_mut().for_each(|module| drop(module.line.take()));
        }
        std::thread::sleep(LOOK);
    }
    Ok(match codes.iter().flatten().max() {
        Some(0) => FINE,
        Some(2) => CANNOT_RUN,
        _ => WRONG,
    })
}
