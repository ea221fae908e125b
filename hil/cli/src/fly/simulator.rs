//! The simulator's process.

use std::net::SocketAddr;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, ChildStdin, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use bateleur_host::partition::virtual_priority;
use bateleur_messages::hil::Protocol;
use bateleur_plan::Plan;
use bateleur_system::sched;

use super::Arguments;
use super::can::Can;
use super::here::Neighbour;
use super::ready;

/// SCHED_FIFO priority of the simulator on the wall clock: it stands for an aircraft, which is never late.
const PRIORITY: u8 = 30;

/// How long the simulator may take to end when it is asked to.
const END_PATIENCE: Duration = Duration::from_secs(5);

/// A running simulator; ended when dropped, unless it is somebody else's.
pub(super) struct Simulator {
    /// Where it listens.
    pub(super) address: SocketAddr,
    /// What it speaks.
    pub(super) protocol: Protocol,
    /// What stands between it and the module, where that has its sensors on a CAN bus.
    pub(super) can: Option<Can>,
    process: Option<Child>,
    /// It is in this process.
    here: Option<Neighbour>,
    /// The simulator ends when this closes.
    line: Option<ChildStdin>,
}

impl Simulator {
    /// One that runs already, or will.
    pub(super) fn of_somebody_else(arguments: &Arguments, protocol: Protocol) -> Self {
        let mut address = arguments.simulator;
        if address.port() == 0 {
            address.set_port(protocol.port());
        }
        Self { address, protocol, can: None, process: None, here: None, line: None }
    }

    /// One in this process, which answers where it is called.
    pub(super) fn here(address: SocketAddr, protocol: Protocol, server: Neighbour) -> Self {
        Self { address, protocol, can: None, process: None, here: Some(server), line: None }
    }

    /// The one in this process.
    pub(super) fn near(&self) -> Option<&Neighbour> {
        self.here.as_ref()
    }

    /// Whether this flight started it.
    pub(super) fn is_ours(&self) -> bool {
        self.process.is_some() || self.here.is_some()
    }

    pub(super) fn start(
        arguments: &Arguments,
        plan: &Plan,
        folder: &Path,
        protocol: Protocol,
    ) -> Result<Self> {
        let program = super::beside_self("simulator")?;
        let mut command = Command::new(&program);
        command.args(["--listen", &arguments.simulator.to_string(), "--protocol", protocol.name()]);
        if let Some(airframe) = &arguments.airframe {
            command.args(["--airframe", airframe]);
        }
        command.args(["--seed", &arguments.seed.to_string(), "--turbulence", &arguments.turbulence]);
        command.args([
            "--wind",
            &arguments.wind.to_string(),
            "--wind-from",
            &arguments.wind_from.to_string(),
        ]);
        command.args(arguments.outside.arguments());
        command.arg("--truth").arg(folder.join("truth.bin")).args(["--ready", "--until-stdin-closes"]);
        if let Some(address) = arguments.flightgear {
            command.args(["--flightgear", &address.to_string()]);
        }
        if arguments.free_running {
            command.arg("--free-running");
        }
        let mut process = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .process_group(0) // as the executive
            .spawn()
            .with_context(|| format!("cannot start {}", program.display()))?;
        let line = process.stdin.take();
        let address = match process.stdout.take() {
            Some(output) => ready::first_line(output).ok().and_then(|line| ready::address(&line)),
            None => bail!("the simulator has no standard output"),
        };
        let Some(address) = address else {
            let _ = process.kill(); // it has ended already, or says nothing
            let status = process.wait()?;
            bail!("the simulator did not start ({status}): its own message stands above this line");
        };
        place(process.id() as i32, arguments, plan);
        Ok(Self { address, protocol, can: None, process: Some(process), here: None, line })
    }

    /// How it ended, if it has.
    pub(super) fn ended(&mut self) -> Option<String> {
        let status = self.process.as_mut()?.try_wait().ok()??;
        Some(format!("the simulator ended in flight ({status})"))
    }

    /// Whether it was stopped (SIGSTOP) and not continued.
    pub(super) fn is_stopped(&self) -> bool {
        let Some(process) = &self.process else { return false };
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", process.id())).unwrap_or_default();
        // The state follows the name in brackets, which may hold anything.
        stat.rsplit(')').next().is_some_and(|rest| rest.trim_start().starts_with(['T', 't']))
    }

    /// Ends it and waits until its log is whole.
    pub(super) fn finish(&mut self) {
        if let Some(Err(error)) = self.here.take().map(|server| server.borrow_mut().finish()) {
            eprintln!("! {error}");
        }
        drop(self.line.take());
        let begun = Instant::now();
        while self.process.is_some() && self.ended().is_none() && begun.elapsed() < END_PATIENCE {
            std::thread::sleep(Duration::from_millis(2));
        }
        if let Some(process) = &mut self.process {
            let _ = process.kill(); // it has ended already, or it is stopped and never will
            let _ = process.wait(); // as above
        }
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        self.finish();
    }
}

/// Virtual clock: on the partitions' processor, where an exchange is a switch and not an interrupt, and ahead of the partition that
/// asks it, which finds the answer when it looks. Wall clock: off those processors, ahead of everything ordinary.
pub(super) fn place(pid: i32, arguments: &Arguments, plan: &Plan) {
    stand(pid, arguments, plan);
    let priority =
        if arguments.fast { virtual_priority().map(|partitions| partitions + 1) } else { Some(PRIORITY) };
    if let Some(priority) = priority {
        for tid in sched::threads(pid) {
            let _ = sched::fifo(tid, priority); // a comfort, as below
        }
    }
}

/// The processor of [`place`], without its priority.
pub(super) fn stand(pid: i32, arguments: &Arguments, plan: &Plan) {
    let partitioned = plan.cores();
    let cores = match arguments.processor {
        Some(core) => vec![core],
        None => sched::allowed_cores().into_iter().filter(|core| !partitioned.contains(core)).collect(),
    };
    if !cores.is_empty() {
        for tid in sched::threads(pid) {
            let _ = sched::bind(tid, &cores); // a comfort: slower or later otherwise, nothing else
        }
    }
}
