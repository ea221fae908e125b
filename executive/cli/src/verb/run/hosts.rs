//! `bateleur run --hosts`: all modules of a plan, each as a process of its own that runs one, on this machine. Their relays talk over
//! addresses of the loopback interface; on the virtual clock they share it, and the same run comes out every time.
//!
//! Each ends when this process does, however it does. Exit codes: the worst of those of the modules.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, Result, bail};
use bateleur_plan::Plan;
use bateleur_system::folders;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};

use super::Arguments;
use crate::code::{CANNOT_RUN, Code, FINE, WRONG};
use crate::{hosts, plan_file};

/// Where a run writes that was not told otherwise.
/// Below it: a folder for each host.
const FOLDER: &str = "hosts";
/// How often the processes are looked at.
const LOOK: Duration = Duration::from_millis(20);

pub(super) fn run(arguments: &Arguments) -> Result<Code> {
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
    let machine = Machine::prepare(arguments, &plan)?;
    let mut modules = Vec::new();
    for place in 0..plan.modules.len() {
        modules.push(machine.start(arguments, &plan, place)?);
    }
    await_all(&mut modules, &stop)
}

/// What is the same for all hosts.
struct Machine {
    folder: PathBuf,
    /// On the virtual clock: the file that they share.
    together: Option<PathBuf>,
    addresses: BTreeMap<SocketAddr, SocketAddr>,
    keys: BTreeMap<String, PathBuf>,
}

impl Machine {
    fn prepare(arguments: &Arguments, plan: &Plan) -> Result<Self> {
        let folder = arguments.output.clone().unwrap_or_else(super::latest).join(FOLDER);
        folders::make(&folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
        let mut addresses = hosts::on_loopback(plan, std::process::id())?;
        addresses.extend(arguments.address.iter().copied());
        let mut keys = hosts::missing_keys(&arguments.schedule, plan, &folder)?;
        keys.extend(arguments.key.iter().cloned());
        Ok(Self { folder, together: arguments.fast.then(hosts::shared_clock), addresses, keys })
    }

    /// The process of the module at `place`.
    fn start(&self, arguments: &Arguments, plan: &Plan, place: usize) -> Result<Child> {
        let name = &plan.modules[place].name;
        let program = std::env::current_exe().context("cannot find this program")?;
        let mut command = Command::new(&program);
        command.arg("run").arg("--schedule").arg(&arguments.schedule).args(["--module", name]);
        command.arg("--output").arg(self.folder.join(name)).args(["--over", "--until-stdin-closes"]);
        if let Some(file) = &self.together {
            command.arg("--fast").arg("--together").arg(file);
            command.args(["--place", &format!("{place}/{}", plan.modules.len())]);
        }
        command.args(self.choices(arguments, plan, place));
        // Ctrl-C is for this process, which ends them all.
        command.stdin(Stdio::piped()).process_group(0);
        command.spawn().with_context(|| format!("cannot start {}", program.display()))
    }

    fn choices(&self, arguments: &Arguments, plan: &Plan, place: usize) -> Vec<String> {
        // What is aimed at no partition is refused by the first module.
        let is_here = |target: &str| hosts::place_of_target(plan, target).unwrap_or(0) == place;
        let mut list = arguments.faults.arguments_for(true, is_here);
        let mut add = |option: &str, value: String| list.extend([option.to_owned(), value]);
        for (planned, other) in &self.addresses {
            add("--address", format!("{planned}={other}"));
        }
        for (link, file) in &self.keys {
            add("--key", format!("{link}={}", file.display()));
        }
        for setting in arguments.set.iter().filter(|setting| is_here(&setting.partition)) {
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
        let _ = self.together.as_ref().map(std::fs::remove_file); // as a rule it is gone
        // Keys that were made for these hosts are of no use to anybody.
        for file in self
            .keys
            .values()
            .filter(|file| file.parent() == std::path::absolute(&self.folder).ok().as_deref())
        {
            let _ = std::fs::remove_file(file); // gone already
        }
    }
}

/// Waits for the end of all; a module that can not run ends the others.
fn await_all(modules: &mut [Child], stop: &AtomicBool) -> Result<Code> {
    let mut codes: Vec<Option<i32>> = vec![None; modules.len()];
    while codes.iter().any(Option::is_none) {
        for (module, code) in modules.iter_mut().zip(&mut codes).filter(|(_, code)| code.is_none()) {
            if let Some(status) = module.try_wait().context("cannot wait for a module")? {
                // By a signal: it ran, and something was wrong.
                *code = Some(status.code().unwrap_or(1));
            }
        }
        if stop.load(Ordering::Acquire) || codes.contains(&Some(2)) {
            modules.iter_mut().for_each(|module| drop(module.stdin.take()));
        }
        std::thread::sleep(LOOK);
    }
    Ok(match codes.iter().flatten().max() {
        Some(0) => FINE,
        Some(2) => CANNOT_RUN,
        _ => WRONG,
    })
}
