//! The executives' processes, as the flight sees them: events come out, orders to stop go in.

use std::io::{BufRead, BufReader, Read, Write};
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use bateleur_executive_cli::hosts::namespace::Lan;
use bateleur_monitor::event::Event;
use bateleur_plan::{ModuleId, Plan};
use rustix::io::{FdFlags, fcntl_setfd};
use rustix::process::{Pid, Signal, kill_process};

use super::hosts::{self, Hosts};
use super::remains::Remains;
use super::simulator::Simulator;
use super::{Arguments, beside_self, partition_running};
use crate::line::Line;

/// How long the executive may take to end when it is asked to.
const END_PATIENCE: Duration = Duration::from_secs(10);
/// How long a module that is started anew may take until its partitions are ready, real time.
const START_PATIENCE: Duration = Duration::from_secs(60);
/// Between two looks whether the companion asks.
const LOOK: Duration = Duration::from_millis(100);

/// A running executive; ended when dropped.
pub(super) struct Executive {
    process: Child,
    /// The executive stops when this closes.
    line: Option<UnixStream>,
    events: Receiver<Event>,
    /// Nobody can send more events.
    events_end: Arc<AtomicBool>,
    /// Virtual clock: the other end of the handshake.
    companion: Option<UnixStream>,
    /// How it was started.
    start: Start,
    /// What it left when it was killed.
    remains: Option<Remains>,
}

/// A question of the virtual clock.
pub(super) struct Question {
    /// Module time, ns.
    pub(super) module_ns: u64,
    /// Bytes that the aircraft has sent so far.
    pub(super) sent: u64,
}

impl Executive {
    /// The only one of a flight.
    pub(super) fn start(
        arguments: &Arguments,
        plan: &Plan,
        folder: &Path,
        simulator: &Simulator,
        line: &Line,
    ) -> Result<Self> {
        let mut choices: Vec<String> =
            arguments.module.iter().flat_map(|name| ["--module".into(), name.clone()]).collect();
        for (target, setting) in settings(arguments, plan, simulator, line)? {
            choices.extend(["--set".into(), format!("{target}.{setting}")]);
        }
        choices.extend(arguments.set.iter().flat_map(|setting| ["--set".into(), setting.clone()]));
        Self::spawn(Start {
            folder: folder.to_owned(),
            schedule: arguments.schedule.clone(),
            choices: [choices, common(arguments)].concat(),
            faults: arguments.faults.arguments(),
            again: Vec::new(),
            companion: arguments.fast,
            interfaces: None,
        })
    }

    /// Its process.
    pub(super) fn pid(&self) -> u32 {
        self.process.id()
    }

    /// That of the module at `place`, one of several.
    pub(super) fn of_host(
        arguments: &Arguments,
        plan: &Plan,
        hosts: &Hosts,
        place: usize,
        (simulator, line): (&Simulator, &Line),
        interfaces: Option<Vec<String>>,
    ) -> Result<Self> {
        let main = hosts::place_of(plan, "command")?;
        // What is aimed at no partition is for the module with the ground's line.
        let is_here = |target: &str| hosts::place_of_target(plan, target).unwrap_or(main) == place;
        let concerns = |setting: &str| {
            let partition = setting.split('.').next().unwrap_or(setting);
            hosts::concerns_setting(plan, partition, place, main)
        };
        let mut choices = hosts.arguments(plan, place);
        for (target, setting) in settings(arguments, plan, simulator, line)? {
            if concerns(&target) {
                choices.extend(["--set".into(), format!("{target}.{setting}")]);
            }
        }
        let asked = arguments.set.iter().filter(|setting| concerns(setting));
        choices.extend(asked.flat_map(|setting| ["--set".into(), setting.clone()]));
        Self::spawn(Start {
            folder: hosts.folder_of(&hosts.modules[place]),
            schedule: arguments.schedule.clone(),
            choices: [choices, common(arguments)].concat(),
            faults: arguments.faults.arguments_for(place == main, is_here),
            again: Vec::new(),
            companion: arguments.fast && place == main,
            interfaces,
        })
    }

    /// The same module again, after it was killed: from nothing, as a computer that is switched on, with `again` beside the
    /// choices that it had at first. What was planned to happen to its partitions does not happen once more.
    pub(super) fn again(&self, folder: PathBuf, again: Vec<String>) -> Result<Self> {
        if let Some(remains) = &self.remains {
            remains.await_end()?;
        }
        Self::spawn(Start { folder, again, faults: Vec::new(), ..self.start.clone() })
    }

    fn spawn(start: Start) -> Result<Self> {
        let program = beside_self("bateleur")?;
        let (events, event_end) = std::io::pipe()?;
        let event_end = OwnedFd::from(event_end);
        fcntl_setfd(&event_end, FdFlags::empty())?;
        let mut command = Command::new(&program);
        if let Some(interfaces) = &start.interfaces {
            command.arg("within").args(interfaces.iter().flat_map(|one| ["--interface", one])).arg("--");
        }
        command.arg("run").arg("--schedule").arg(&start.schedule).arg("--output").arg(&start.folder);
        command.args(["--record", "--until-stdin-closes", "--events-fd", &event_end.as_raw_fd().to_string()]);
        command.args(&start.choices).args(&start.faults).args(&start.again);
        let companion = if start.companion { Some(add_companion(&mut command)?) } else { None };
        let (line, input) = UnixStream::pair()?;
        let process = command
            .stdin(OwnedFd::from(input))
            .stdout(Stdio::null())
            .process_group(0) // Ctrl-C is for the flight, which ends its processes in their order
            .spawn()
            .with_context(|| format!("cannot start {}", program.display()))?;
        drop(event_end);
        let companion = companion.map(|(own, _)| own);
        let (events, events_end) = read_events(events);
        Ok(Self { process, line: Some(line), events, events_end, companion, start, remains: None })
    }

    /// Joins it to its networks, and lets it start.
    pub(super) fn join(&mut self, lan: &mut Lan, plan: &Plan, module: ModuleId) -> Result<()> {
        let line = self.line.as_ref().context("it was asked to stop")?;
        lan.join(plan, module, self.process.id(), line)
    }

    /// Ends it as a computer ends that loses its power.
    pub(super) fn kill(&mut self) {
        // A supervisor would start another executive, and an executive goes on without its supervisor.
        if let Some(pid) = Pid::from_raw(self.process.id() as i32) {
            let _ = kill_process(pid, Signal::STOP); // it has ended already
        }
        self.remains = Some(Remains::of(self.process.id()).without_executive());
        let _ = self.process.kill(); // as above
        let _ = self.process.wait(); // as above
    }

    /// Whether it shares a virtual clock.
    pub(super) fn is_joint(&self) -> bool {
        self.start.choices.iter().any(|choice| choice == "--together")
    }

    /// Waits until its partitions are ready; gives what it said until then.
    ///
    /// # Errors
    /// It ended before, or takes too long.
    pub(super) fn await_ready(&self) -> Result<Vec<Event>> {
        let begun = Instant::now();
        let mut said = Vec::new();
        loop {
            match self.events.recv_timeout(LOOK) {
                Ok(event) => said.push(event),
                Err(RecvTimeoutError::Timeout) if begun.elapsed() < START_PATIENCE => {}
                Err(RecvTimeoutError::Timeout) => {
                    bail!("its partitions were not ready after {} s", START_PATIENCE.as_secs())
                }
                Err(RecvTimeoutError::Disconnected) => bail!("it ended; its message stands above"),
            }
            if matches!(said.last(), Some(Event::Ready { .. })) {
                return Ok(said);
            }
        }
    }

    /// Asks it to stop.
    pub(super) fn ask_to_stop(&mut self) {
        drop(self.line.take());
        drop(self.companion.take());
    }

    /// Events since the last look.
    pub(super) fn take_events(&self) -> Vec<Event> {
        self.events.try_iter().collect()
    }

    /// How it ended, if it has. A supervisor that a signal has ended is followed by another one: the module goes on, and so do its events.
    pub(super) fn ended(&mut self) -> Option<ExitStatus> {
        let status = self.process.try_wait().ok().flatten()?;
        (status.code().is_some() || self.events_end.load(Ordering::Acquire)).then_some(status)
    }

    /// The virtual clock's next question; none yet, or an error where there will be no more.
    pub(super) fn question(&mut self) -> std::io::Result<Option<Question>> {
        let Some(companion) = &mut self.companion else { return Ok(None) };
        let mut bytes = [0; 16];
        match companion.read_exact(&mut bytes) {
            Ok(()) => {
                let (time, sent) = bytes.split_at(8);
                let number = |bytes: &[u8]| bytes.try_into().map_or(0, u64::from_le_bytes);
                Ok(Some(Question { module_ns: number(time), sent: number(sent) }))
            }
            Err(error)
                if matches!(error.kind(), std::io::ErrorKind::WouldBlock | std::io::ErrorKind::TimedOut) =>
            {
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// Answers it.
    pub(super) fn answer(&mut self, bytes: u64, stop: bool) -> std::io::Result<()> {
        let Some(companion) = &mut self.companion else { return Ok(()) };
        let mut answer = [0; 9];
        answer[..8].copy_from_slice(&bytes.to_le_bytes());
        answer[8] = u8::from(stop);
        companion.write_all(&answer)
    }

    /// Asks it to stop and waits until it has; gives the events of its end.
    pub(super) fn finish(&mut self) -> Vec<Event> {
        self.ask_to_stop();
        let begun = Instant::now();
        while self.ended().is_none() && begun.elapsed() < END_PATIENCE {
            std::thread::sleep(Duration::from_millis(2));
        }
        if self.ended().is_none() {
            self.kill(); // its guard cleans up
        }
        // The reader ends when the pipe does.
        self.events.iter().collect()
    }
}

impl Drop for Executive {
    fn drop(&mut self) {
        self.finish();
    }
}

/// How one is started.
#[derive(Clone)]
struct Start {
    folder: PathBuf,
    schedule: PathBuf,
    /// What differs from flight to flight and from module to module.
    choices: Vec<String>,
    /// What is planned to happen to its partitions.
    faults: Vec<String>,
    /// Where it comes back: what is said of that.
    again: Vec<String>,
    /// The ground's line ends there.
    companion: bool,
    /// In a network namespace of its own, with these interfaces.
    interfaces: Option<Vec<String>>,
}

/// What the executives of a flight have in common.
fn common(arguments: &Arguments) -> Vec<String> {
    let mut list = Vec::new();
    if arguments.fast {
        list.push("--fast".to_owned());
    }
    list.extend(arguments.processor.iter().flat_map(|core| ["--processor".to_owned(), core.to_string()]));
    if let Some(how) = &arguments.require {
        list.extend(["--require".to_owned(), how.clone()]);
    }
    list
}

/// What a flight sets: the partition, and ATTRIBUTE=VALUE.
pub(super) fn settings(
    arguments: &Arguments,
    plan: &Plan,
    simulator: &Simulator,
    line: &Line,
) -> Result<Vec<(String, String)>> {
    let mut list = vec![(partition_running(plan, "command")?, format!("device={}", line.device))];
    match &simulator.can {
        Some(can) => list.extend_from_slice(&can.attributes),
        None => {
            let interface = partition_running(plan, "hil_interface")?;
            list.push((interface.clone(), format!("simulator={}", simulator.address)));
            list.push((interface.clone(), format!("protocol={}", simulator.protocol.name())));
            if arguments.free_running {
                list.push((interface, "lockstep=false".to_owned()));
            }
        }
    }
    // The laws and the servos must know the aircraft that the simulator flies.
    if let Some(airframe) = &arguments.airframe {
        // Partitions run as a user who may not be let into the file's folder: they get its text.
        let value = std::fs::read_to_string(airframe).unwrap_or_else(|_| airframe.clone());
        for program in ["controller", "servo"] {
            list.push((partition_running(plan, program)?, format!("airframe={value}")));
        }
    }
    Ok(list)
}

/// Gives our end of the handshake, and the other one to keep until the process is started.
fn add_companion(command: &mut Command) -> Result<(UnixStream, UnixStream)> {
    let (own, other) = UnixStream::pair()?;
    own.set_read_timeout(Some(LOOK))?;
    fcntl_setfd(&other, FdFlags::empty())?;
    command.args(["--companion-fd", &other.as_raw_fd().to_string()]);
    Ok((own, other))
}

/// The events, and whether nobody can send more of them.
fn read_events(pipe: impl Read + Send + 'static) -> (Receiver<Event>, Arc<AtomicBool>) {
    let (sender, receiver) = channel();
    let end = Arc::new(AtomicBool::new(false));
    let ends = end.clone();
    std::thread::spawn(move || {
        for line in BufReader::new(pipe).lines().map_while(Result::ok) {
            if let Ok(event) = serde_json::from_str(&line)
                && sender.send(event).is_err()
            {
                break;
            }
        }
        ends.store(true, Ordering::Release);
    });
    (receiver, end)
}
