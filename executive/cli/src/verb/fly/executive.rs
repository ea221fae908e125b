//! The executive's process, as the flight sees it: events come out, orders to stop go in.

use std::io::{BufRead, BufReader, Read, Write};
use std::os::fd::{AsRawFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::{Child, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use bateleur_executive::event::Event;
use bateleur_executive::plan::Plan;
use rustix::io::{FdFlags, fcntl_setfd};

use super::simulator::Simulator;
use super::{Arguments, beside_self, partition_running};
use crate::line::Line;

/// How long the executive may take to end when it is asked to.
const END_PATIENCE: Duration = Duration::from_secs(10);
/// Between two looks whether the companion asks.
const LOOK: Duration = Duration::from_millis(100);

/// A running executive; ended when dropped.
pub(super) struct Executive {
    process: Child,
    /// The executive stops when this closes.
    line: Option<ChildStdin>,
    events: Receiver<Event>,
    /// Virtual clock: the other end of the handshake.
    companion: Option<UnixStream>,
}

/// A question of the virtual clock.
pub(super) struct Question {
    /// Module time, ns.
    pub(super) module_ns: u64,
    /// Bytes that the aircraft has sent so far.
    pub(super) sent: u64,
}

impl Executive {
    pub(super) fn start(
        arguments: &Arguments,
        plan: &Plan,
        folder: &Path,
        simulator: &Simulator,
        line: &Line,
    ) -> Result<Self> {
        let program = beside_self("bateleur")?;
        let (events, event_end) = std::io::pipe()?;
        let event_end = OwnedFd::from(event_end);
        fcntl_setfd(&event_end, FdFlags::empty())?;
        let mut command = Command::new(&program);
        command.arg("run").arg("--schedule").arg(&arguments.schedule).arg("--output").arg(folder);
        command.args(["--record", "--until-stdin-closes", "--events-fd", &event_end.as_raw_fd().to_string()]);
        set(&mut command, &partition_running(plan, "command")?, "device", &line.device);
        let interface = partition_running(plan, "hil_interface")?;
        set(&mut command, &interface, "simulator", &simulator.address.to_string());
        set(&mut command, &interface, "protocol", simulator.protocol.name());
        if arguments.free_running {
            set(&mut command, &interface, "lockstep", "false");
        }
        set_airframe(&mut command, arguments, plan)?;
        add_choices(&mut command, arguments);
        let companion = if arguments.fast { Some(add_companion(&mut command)?) } else { None };
        let mut process = command
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .process_group(0) // Ctrl-C is for the flight, which ends its processes in their order
            .spawn()
            .with_context(|| format!("cannot start {}", program.display()))?;
        drop(event_end);
        let line = process.stdin.take();
        let companion = companion.map(|(own, _)| own);
        Ok(Self { process, line, events: read_events(events), companion })
    }

    /// Events since the last look.
    pub(super) fn take_events(&self) -> Vec<Event> {
        self.events.try_iter().collect()
    }

    /// How it ended, if it has.
    pub(super) fn ended(&mut self) -> Option<ExitStatus> {
        self.process.try_wait().ok().flatten()
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
        drop(self.line.take());
        drop(self.companion.take());
        let begun = Instant::now();
        while self.ended().is_none() && begun.elapsed() < END_PATIENCE {
            std::thread::sleep(Duration::from_millis(2));
        }
        if self.ended().is_none() {
            let _ = self.process.kill(); // its guard cleans up
            let _ = self.process.wait();
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

fn set(command: &mut Command, partition: &str, attribute: &str, value: &str) {
    command.arg("--set").arg(format!("{partition}.{attribute}={value}"));
}

/// The laws and the servos must know the aircraft that the simulator flies.
fn set_airframe(command: &mut Command, arguments: &Arguments, plan: &Plan) -> Result<()> {
    let Some(airframe) = &arguments.airframe else { return Ok(()) };
    // Partitions run as a user who may not be let into the file's folder: they get its text.
    let value = std::fs::read_to_string(airframe).unwrap_or_else(|_| airframe.clone());
    for program in ["controller", "servo"] {
        set(command, &partition_running(plan, program)?, "airframe", &value);
    }
    Ok(())
}

fn add_choices(command: &mut Command, arguments: &Arguments) {
    if let Some(module) = &arguments.module {
        command.arg("--module").arg(module);
    }
    if arguments.fast {
        command.arg("--fast");
    }
    if let Some(how) = &arguments.require {
        command.args(["--require", how]);
    }
    for setting in &arguments.set {
        command.args(["--set", setting]);
    }
    command.args(arguments.faults.arguments());
}

/// Gives our end of the handshake, and the other one to keep until the process is started.
fn add_companion(command: &mut Command) -> Result<(UnixStream, UnixStream)> {
    let (own, other) = UnixStream::pair()?;
    own.set_read_timeout(Some(LOOK))?;
    fcntl_setfd(&other, FdFlags::empty())?;
    command.args(["--companion-fd", &other.as_raw_fd().to_string()]);
    Ok((own, other))
}

fn read_events(pipe: impl Read + Send + 'static) -> Receiver<Event> {
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        for line in BufReader::new(pipe).lines().map_while(Result::ok) {
            if let Ok(event) = serde_json::from_str(&line)
                && sender.send(event).is_err()
            {
                return;
            }
        }
    });
    receiver
}
