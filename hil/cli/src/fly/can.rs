//! The distribution board's process, where the plan has the sensors on a CAN bus; and a gateway's, where the partition has a bus of
//! its own, which the board's is then joined to. One that ends in flight is started again: as what keeps services running would do.
//!
//! With the partition on the network: simulator – board (a bus, a gateway) – UDP – partition. With `bus = "slcan"`: simulator – board
//! (a bus, a gateway) – UDP – gateway – adapter – partition; with `bus = "socketcan:vcan0"` an interface of this computer, which has to
//! be there, stands in the place of the adapter.

use std::ffi::OsString;
use std::net::SocketAddr;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::time::{Duration, Instant};

use crate::line::grant_terminal;
use anyhow::{Context, Result, bail};
use bateleur_plan::{Attribute, Plan};

use super::simulator::place;
use super::{Arguments, attribute, beside_self, partition_running, ready};

/// How long a process may take to end when it is asked to.
const END_PATIENCE: Duration = Duration::from_secs(5);
/// Module time between the end of a process and its next start, ns.
const START_AGAIN_NS: u64 = 500_000_000;
/// Starts after the first one, in a flight: who ends again and again is broken.
const STARTS_AGAIN: u32 = 5;
/// The program of the partition that has its sensors on a bus.
const PROGRAM: &str = "can_interface";
/// The programs that stand between.
const BOARD: &str = "can_board";
const GATEWAY: &str = "can_gateway";
/// What its attribute `bus` says of a serial adapter.
const SERIAL: &str = "slcan";

/// What the flight does to the processes between simulator and module.
#[derive(Debug, Clone, Default, PartialEq, clap::Args)]
pub(crate) struct Options {
    /// Kill the distribution board (`board`) or the gateway that is inserted (`gateway`) at a module time, on a flight over CAN (may
    /// be repeated); it is started again after half a second.
    #[arg(long, value_name = "board|gateway@SECONDS", value_parser = parse_kill)]
    kill_can: Vec<Kill>,
}

/// Who is killed, and when.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Kill {
    program: &'static str,
    at_s: f64,
}

fn parse_kill(text: &str) -> Result<Kill, String> {
    let kill = text.split_once('@').and_then(|(who, at)| {
        let program = match who {
            "board" => BOARD,
            "gateway" => GATEWAY,
            _ => return None,
        };
        let at_s = at.parse::<f64>().ok().filter(|at_s| at_s.is_finite() && *at_s >= 0.0)?;
        Some(Kill { program, at_s })
    });
    kill.ok_or_else(|| {
        format!("\"{text}\" is neither board@SECONDS nor gateway@SECONDS, such as gateway@100")
    })
}

impl Options {
    /// What was planned for later than the flight's end.
    pub(super) fn not_reached(&self, module_time_s: f64) -> Vec<String> {
        let late = self.kill_can.iter().filter(|kill| kill.at_s > module_time_s);
        let line = |kill: &Kill| {
            format!(
                "kill of {} at {} s was not reached: it ended at {module_time_s:.2} s",
                kill.program, kill.at_s
            )
        };
        late.map(line).collect()
    }
}

/// Whether the plan has its sensors on a bus.
pub(super) fn is_between(plan: &Plan) -> bool {
    partition_running(plan, PROGRAM).is_ok()
}

/// Refuses to kill what this flight does not have.
pub(super) fn check(arguments: &Arguments, plan: &Plan) -> Result<()> {
    let kills = &arguments.can.kill_can;
    let Ok(partition) = partition_running(plan, PROGRAM) else {
        if !kills.is_empty() {
            bail!(
                "--kill-can: no partition of {} runs {PROGRAM}: this flight has no CAN bus",
                arguments.schedule.display()
            );
        }
        return Ok(());
    };
    let is_inserted = own_bus(arguments, plan, &partition).is_some();
    if !is_inserted && kills.iter().any(|kill| kill.program == GATEWAY) {
        bail!(
            "--kill-can gateway: none is inserted, {partition} talks to the board's own; --set {partition}.bus={SERIAL} inserts one"
        );
    }
    Ok(())
}

/// What stands between the simulator and the partition.
pub(super) struct Can {
    /// What the partition is told: its name, and ATTRIBUTE=VALUE.
    pub(super) attributes: Vec<(String, String)>,
    /// In the order in which they end.
    processes: Vec<Process>,
    kills: Vec<Kill>,
    arguments: Arguments,
    plan: Plan,
}

/// One of them.
struct Process {
    program: &'static str,
    /// What it is told, but for where it listens and logs.
    options: Vec<OsString>,
    /// Where it listens: at the same place after each start, so that those who know it find it again.
    listen: SocketAddr,
    /// Where it logs, where it does.
    log: Option<PathBuf>,
    /// The link to the adapter that it is.
    link: Option<PathBuf>,
    /// `None` if it has ended.
    running: Option<(Child, Option<ChildStdin>)>,
    /// When it is started again, module time, ns.
    again_ns: u64,
    starts_again: u32,
}

impl Can {
    /// Starts it where the plan has such a partition.
    pub(super) fn start(
        arguments: &Arguments,
        plan: &Plan,
        folder: &Path,
        simulator: SocketAddr,
    ) -> Result<Option<Self>> {
        let Ok(partition) = partition_running(plan, PROGRAM) else { return Ok(None) };
        let (arguments, plan) = (arguments.clone(), plan.clone());
        let own = own_bus(&arguments, &plan, &partition);
        let kills = arguments.can.kill_can.clone();
        let mut can = Self { attributes: Vec::new(), processes: Vec::new(), kills, arguments, plan };
        let board = ["--simulator".into(), simulator.to_string().into(), "--ready".into()];
        let address = can.add(Process::new(BOARD, board.to_vec()))?;
        if let Some(own) = own {
            can.add_gateway(&own, address, folder, partition)?;
        } else {
            can.attributes.push((partition.clone(), "listen=127.0.0.1:0".into()));
            can.attributes.push((partition, format!("peer={address}")));
        }
        Ok(Some(can))
    }

    fn add_gateway(&mut self, bus: &str, board: SocketAddr, folder: &Path, partition: String) -> Result<()> {
        // Sockets and links in the file system have short names, the folder of a flight need not; and the partitions' user has to
        // get to the link.
        let place = if rustix::process::geteuid().is_root() { "/tmp".into() } else { std::env::temp_dir() };
        let link = place.join(format!("bateleur-can.{}", std::process::id()));
        let is_serial = bus == SERIAL;
        let bus = if is_serial { format!("slcan-pty:{}", link.display()) } else { bus.to_owned() };
        let mut options: Vec<OsString> =
            ["run", "--bus", &bus, "--name", "flight", "--ready", "--peer"].map(OsString::from).to_vec();
        options.extend([board.to_string().into(), "--status".into()]);
        options.push(link.with_extension(format!("{}.sock", std::process::id())).into());
        let mut gateway = Process::new(GATEWAY, options);
        gateway.log = Some(folder.join("can.log"));
        gateway.link = is_serial.then(|| link.clone());
        self.add(gateway)?;
        if is_serial {
            // The link, not the terminal: an adapter that was started anew has another one.
            self.attributes.push((partition, format!("device={}", link.display())));
        }
        Ok(())
    }

    /// Starts a process for the first time; gives where it listens.
    fn add(&mut self, mut process: Process) -> Result<SocketAddr> {
        let started = process.start(&self.arguments, &self.plan);
        let listen = process.listen;
        self.processes.insert(0, process);
        started.map(|()| listen)
    }

    /// Does to the processes what is due, and starts those again that have ended; gives a line for each.
    pub(super) fn perform(&mut self, module_ns: u64) -> Vec<String> {
        let (mut lines, now_s) = (Vec::new(), module_ns as f64 / 1e9);
        for kill in self.kills.extract_if(.., |kill| now_s >= kill.at_s) {
            let found = self.processes.iter_mut().find(|process| process.program == kill.program);
            if let Some(process) = found {
                process.kill();
                process.again_ns = module_ns + START_AGAIN_NS;
                lines.push(format!("{} is killed", kill.program));
            }
        }
        for process in &mut self.processes {
            lines.extend(process.supervise(module_ns, &self.arguments, &self.plan));
        }
        lines
    }
}

impl Process {
    fn new(program: &'static str, options: Vec<OsString>) -> Self {
        let (listen, running) = (SocketAddr::from(([127, 0, 0, 1], 0)), None);
        Self { program, options, listen, log: None, link: None, running, again_ns: 0, starts_again: 0 }
    }

    /// Starts it and waits until it listens.
    fn start(&mut self, arguments: &Arguments, plan: &Plan) -> Result<()> {
        let program = beside_self(self.program)?;
        let mut command = Command::new(&program);
        command.args(&self.options).arg("--listen").arg(self.listen.to_string());
        if let Some(log) = &self.log {
            command.arg("--log").arg(match self.starts_again {
                0 => log.clone(),
                starts => log.with_extension(format!("start-{starts}.log")),
            });
        }
        let mut child = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .process_group(0) // Ctrl-C is for the flight, which ends its processes in their order
            .spawn()
            .with_context(|| format!("cannot start {}", program.display()))?;
        let (line, output) = (child.stdin.take(), child.stdout.take());
        place(child.id() as i32, arguments, plan);
        self.running = Some((child, line));
        let output = output.with_context(|| format!("{} has no standard output", self.program))?;
        let line = ready::first_line(output).with_context(|| format!("{} says nothing", self.program))?;
        match ready::address(&line) {
            Some(address) => self.listen = address,
            None => bail!("{} did not start; its message stands above", self.program),
        }
        self.link.as_deref().map_or(Ok(()), grant_terminal)
    }

    fn kill(&mut self) {
        if let Some((mut child, _)) = self.running.take() {
            let _ = child.kill(); // it has ended already
            let _ = child.wait(); // as above
        }
    }

    fn supervise(&mut self, module_ns: u64, arguments: &Arguments, plan: &Plan) -> Option<String> {
        if let Some((child, _)) = &mut self.running {
            let status = child.try_wait().ok()??;
            self.running = None;
            self.again_ns = module_ns + START_AGAIN_NS;
            return Some(format!("! {} has ended ({status})", self.program));
        }
        if module_ns < self.again_ns || self.starts_again > STARTS_AGAIN {
            return None;
        }
        self.starts_again += 1;
        if self.starts_again > STARTS_AGAIN {
            return Some(format!(
                "! {} has ended {STARTS_AGAIN} times and more: it is not started again",
                self.program
            ));
        }
        Some(match self.start(arguments, plan) {
            Ok(()) => format!("{} is started again", self.program),
            Err(error) => {
                self.kill();
                self.again_ns = module_ns + START_AGAIN_NS;
                format!("! {} can not be started again: {error:#}", self.program)
            }
        })
    }
}

impl Drop for Can {
    fn drop(&mut self) {
        for process in &mut self.processes {
            if let Some((child, line)) = &mut process.running {
                drop(line.take());
                let begun = Instant::now();
                while matches!(child.try_wait(), Ok(None)) && begun.elapsed() < END_PATIENCE {
                    std::thread::sleep(Duration::from_millis(2));
                }
            }
            process.kill();
            if let Some(link) = &process.link {
                let _ = std::fs::remove_file(link); // its adapter did, unless it was killed
            }
        }
    }
}

/// The bus that the partition has for itself, by what replaces the plan's or by the plan; `None` if it is on the network.
fn own_bus(arguments: &Arguments, plan: &Plan, partition: &str) -> Option<String> {
    let prefix = format!("{partition}.bus=");
    let set = arguments.set.iter().rev().find_map(|set| set.strip_prefix(&prefix));
    let bus = match (set, attribute(plan, PROGRAM, "bus")) {
        (Some(word), _) => word.trim_matches('"').to_owned(),
        (None, Some(Attribute::String(word))) => word.clone(),
        _ => return None,
    };
    (bus == SERIAL || bus.starts_with("socketcan:")).then_some(bus)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_is_killed_and_when_is_read_and_nonsense_refused_with_an_example() {
        assert_eq!(parse_kill("gateway@100"), Ok(Kill { program: GATEWAY, at_s: 100.0 }));
        assert_eq!(parse_kill("board@0.5"), Ok(Kill { program: BOARD, at_s: 0.5 }));
        for text in ["gateway", "wing@3", "board@-1", "board@", "gateway@nan", ""] {
            assert!(parse_kill(text).unwrap_err().contains("gateway@100"), "{text}");
        }
        let options = Options { kill_can: vec![Kill { program: BOARD, at_s: 100.0 }] };
        assert_eq!((options.not_reached(99.0).len(), options.not_reached(101.0).len()), (1, 0));
    }
}
