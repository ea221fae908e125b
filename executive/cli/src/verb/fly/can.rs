//! The distribution board's process, where the plan has the sensors on a CAN bus; and a gateway's, where the partition has a bus of
//! its own, which the board's is then joined to.
//!
//! With the partition on the network: simulator – board (a bus, a gateway) – UDP – partition. With `bus = "slcan"`: simulator – board
//! (a bus, a gateway) – UDP – gateway – adapter – partition; with `bus = "socketcan:vcan0"` an interface of this computer, which has to
//! be there, stands in the place of the adapter.

use std::io::{BufRead, BufReader};
use std::net::SocketAddr;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use bateleur_executive::machine::PARTITION_USER;
use bateleur_executive::plan::{Attribute, Plan};

use super::simulator::place;
use super::{Arguments, attribute, beside_self, partition_running};

/// How long a process may take to end when it is asked to.
const END_PATIENCE: Duration = Duration::from_secs(5);
/// The program of the partition that has its sensors on a bus.
const PROGRAM: &str = "can_interface";
/// What its attribute `bus` says of a serial adapter.
const SERIAL: &str = "slcan";

/// Whether the plan has its sensors on a bus.
pub(super) fn is_between(plan: &Plan) -> bool {
    partition_running(plan, PROGRAM).is_ok()
}

/// What stands between the simulator and the partition.
pub(super) struct Can {
    /// What the partition is told: its name, and ATTRIBUTE=VALUE.
    pub(super) attributes: Vec<(String, String)>,
    /// In the order in which they end.
    processes: Vec<(Child, Option<ChildStdin>)>,
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
        let mut can = Self { attributes: Vec::new(), processes: Vec::new() };
        let mut board = Command::new(beside_self("can_board")?);
        board.args(["--listen", "127.0.0.1:0", "--simulator", &simulator.to_string(), "--ready"]);
        let address = can.add(board, arguments, plan)?;
        if let Some(own) = own_bus(arguments, plan, &partition) {
            // Sockets and links in the file system have short names, the folder of a flight need not.
            let link = std::env::temp_dir().join(format!("bateleur-can.{}", std::process::id()));
            let is_serial = own == SERIAL;
            let bus = if is_serial { format!("slcan-pty:{}", link.display()) } else { own };
            let mut gateway = Command::new(beside_self("can_gateway")?);
            gateway.arg("run").arg("--bus").arg(bus);
            gateway.args([
                "--listen",
                "127.0.0.1:0",
                "--peer",
                &address.to_string(),
                "--name",
                "flight",
                "--ready",
            ]);
            gateway.arg("--status").arg(link.with_extension(format!("{}.sock", std::process::id())));
            gateway.arg("--log").arg(folder.join("can.log"));
            can.add(gateway, arguments, plan)?;
            if is_serial {
                can.attributes.push((partition, format!("device={}", terminal(&link)?)));
            }
        } else {
            can.attributes.push((partition.clone(), "listen=127.0.0.1:0".into()));
            can.attributes.push((partition, format!("peer={address}")));
        }
        Ok(Some(can))
    }

    /// Starts a process; gives where it listens.
    fn add(&mut self, mut command: Command, arguments: &Arguments, plan: &Plan) -> Result<SocketAddr> {
        let name = Path::new(command.get_program()).display().to_string();
        let mut process = command
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .process_group(0) // Ctrl-C is for the flight, which ends its processes in their order
            .spawn()
            .with_context(|| format!("cannot start {name}"))?;
        let (line, output) = (process.stdin.take(), process.stdout.take());
        place(process.id() as i32, arguments, plan);
        self.processes.insert(0, (process, line));
        let mut text = String::new();
        if let Some(output) = output {
            BufReader::new(output).read_line(&mut text).with_context(|| format!("{name} says nothing"))?;
        }
        let ready: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
        match ready["listening"].as_str().map(str::parse) {
            Some(Ok(address)) => Ok(address),
            _ => bail!("{name} did not start; its message stands above"),
        }
    }
}

impl Drop for Can {
    fn drop(&mut self) {
        for (process, line) in &mut self.processes {
            drop(line.take());
            let begun = Instant::now();
            while matches!(process.try_wait(), Ok(None)) && begun.elapsed() < END_PATIENCE {
                std::thread::sleep(Duration::from_millis(2));
            }
            let _ = process.kill(); // it has ended already
            let _ = process.wait(); // as above
        }
    }
}

/// The bus that the partition has for itself, by what replaces the plan's or by the plan; none: it is on the network.
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

/// The terminal behind a link, which the partitions' user may open.
fn terminal(link: &Path) -> Result<String> {
    let device: PathBuf =
        std::fs::read_link(link).with_context(|| format!("there is no {}", link.display()))?;
    if rustix::process::geteuid().is_root() {
        std::os::unix::fs::chown(&device, Some(PARTITION_USER), None)?;
    }
    Ok(device.to_string_lossy().into_owned())
}
