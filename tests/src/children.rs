//! The processes of a run, and what it has on the machine beside its output folder.

use std::fs;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};

use crate::await_some;

/// The name of an executive's process.
pub(crate) const EXECUTIVE: &str = "bateleurd";

/// A process, told apart from a later one with the same number.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Process {
    /// Its number.
    pub pid: i32,
    /// Its name.
    pub name: String,
    parent: i32,
    started_ticks: u64,
    /// Processor time so far, ticks of 10 ms.
    pub used_ticks: u64,
    is_dead: bool,
}

impl Process {
    /// The process with this number, if there is one.
    pub fn read(pid: i32) -> Option<Self> {
        let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
        let (before, after) = stat.rsplit_once(')')?;
        let fields: Vec<&str> = after.split_ascii_whitespace().collect();
        let number = |place: usize| fields.get(place)?.parse::<u64>().ok();
        Some(Self {
            pid,
            name: before.split_once('(')?.1.to_owned(),
            parent: fields.get(1)?.parse().ok()?,
            started_ticks: number(19)?,
            used_ticks: number(11)? + number(12)?,
            is_dead: matches!(fields[0], "Z" | "X"),
        })
    }

    /// Whether it still runs.
    pub fn is_alive(&self) -> bool {
        Self::read(self.pid).is_some_and(|now| now.started_ticks == self.started_ticks && !now.is_dead)
    }

    /// The same process as it is now.
    pub fn again(&self) -> Option<Self> {
        Self::read(self.pid).filter(|now| now.started_ticks == self.started_ticks)
    }

    /// Sends it a signal.
    pub fn signal(&self, signal: Signal) {
        assert!(self.is_alive(), "{self:?} has ended");
        kill_process(Pid::from_raw(self.pid).unwrap(), signal).unwrap();
    }

    /// Kills it, if it has not ended.
    pub fn kill(&self) {
        if self.is_alive() {
            let _ = kill_process(Pid::from_raw(self.pid).unwrap(), Signal::KILL); // it has ended
        }
    }

    fn sockets(&self) -> Vec<String> {
        let entries = fs::read_dir(format!("/proc/{}/fd", self.pid)).into_iter().flatten().flatten();
        let targets = entries.filter_map(|entry| fs::read_link(entry.path()).ok());
        targets
            .filter_map(|target| {
                Some(target.to_str()?.strip_prefix("socket:[")?.strip_suffix(']')?.to_owned())
            })
            .collect()
    }
}

/// Every process below `pid`.
pub fn children_of(pid: i32) -> Vec<Process> {
    let entries = fs::read_dir("/proc").unwrap().flatten();
    let numbers = entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    let all: Vec<Process> = numbers.filter_map(Process::read).collect();
    let mut found: Vec<Process> = Vec::new();
    let mut parents = vec![pid];
    while let Some(parent) = parents.pop() {
        for process in all.iter().filter(|process| process.parent == parent && !process.is_dead) {
            parents.push(process.pid);
            found.push(process.clone());
        }
    }
    found
}

/// The process called `name` below `pid`.
#[track_caller]
pub fn process_named(pid: i32, name: &str) -> Process {
    let found = await_some(Duration::from_secs(10), || {
        children_of(pid).into_iter().find(|process| process.name == name)
    });
    found.unwrap_or_else(|| panic!("no process {name} below {pid}: {:?}", children_of(pid)))
}

/// The executive of a run whose partitions are ready and whose first process is `root`: that process, or one below a supervisor or a
/// `bateleur fly`.
#[track_caller]
pub fn executive_of(root: i32) -> Process {
    let is_executive = |process: &Process| process.name == EXECUTIVE;
    Process::read(root).filter(is_executive).unwrap_or_else(|| process_named(root, EXECUTIVE))
}

/// All that a run has on the machine at one moment.
#[derive(Debug, Clone)]
pub struct Traces {
    executive: i32,
    processes: Vec<Process>,
    /// Inodes of UDP sockets.
    sockets: Vec<String>,
}

impl Traces {
    /// Of a run whose partitions are ready and whose first process is `root`.
    #[track_caller]
    pub fn of(root: i32) -> Self {
        let executive = executive_of(root).pid;
        let mut processes = children_of(root);
        processes.extend(Process::read(root));
        let udp = udp_sockets();
        let sockets =
            processes.iter().flat_map(Process::sockets).filter(|inode| udp.contains(inode)).collect();
        let traces = Self { executive, processes, sockets };
        assert!(!traces.shared_memory().is_empty(), "a run has shared memory");
        assert!(traces.processes.len() > 2, "a run has processes: {:?}", traces.processes);
        traces
    }

    /// The processes.
    pub fn processes(&self) -> &[Process] {
        &self.processes
    }

    /// Whether the run had a UDP socket.
    pub fn has_sockets(&self) -> bool {
        !self.sockets.is_empty()
    }

    /// Files of the run in shared memory, now.
    pub fn shared_memory(&self) -> Vec<PathBuf> {
        entries_of_run(Path::new("/dev/shm"), self.executive)
    }

    fn control_groups(&self) -> Vec<PathBuf> {
        let groups = fs::read_to_string("/proc/self/cgroup").unwrap_or_default();
        let mounts = fs::read_to_string("/proc/self/mounts").unwrap_or_default();
        let second = |fields: &[&str]| fields[2] == "cgroup2";
        let first = |fields: &[&str], controllers: &str| {
            fields[2] == "cgroup" && fields[3].split(',').any(|option| option == controllers)
        };
        let place = |line: &str| {
            let (controllers, own) = line.split_once(':')?.1.split_once(':')?;
            let mounts = mounts.lines().map(|line| line.split(' ').collect::<Vec<_>>());
            let mut fitting = mounts.filter(|fields| match controllers {
                "" => second(fields),
                name => first(fields, name),
            });
            Some(Path::new(fitting.next()?[1]).join(own.trim_start_matches('/')))
        };
        groups.lines().filter_map(place).flat_map(|place| entries_of_run(&place, self.executive)).collect()
    }

    /// What is there now of all this, in words.
    pub fn left(&self) -> Vec<String> {
        let files = self.shared_memory().into_iter().map(|path| path.display().to_string());
        let groups = self.control_groups().into_iter().map(|path| path.display().to_string());
        let alive = self.processes.iter().filter(|process| process.is_alive());
        let udp = udp_sockets();
        let sockets = self.sockets.iter().filter(|inode| udp.contains(inode));
        files
            .chain(groups)
            .chain(alive.map(|process| format!("process {} {}", process.pid, process.name)))
            .chain(sockets.map(|inode| format!("UDP socket {inode}")))
            .collect()
    }

    /// Fails unless all of it is gone soon.
    #[track_caller]
    pub fn expect_gone(&self) {
        let gone = await_some(Duration::from_secs(10), || self.left().is_empty().then_some(()));
        assert!(gone.is_some(), "left behind: {:#?}", self.left());
    }
}

fn entries_of_run(folder: &Path, executive: i32) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let of_run = |name: &str| {
        let mut parts = name.split(['.', '_']);
        name.starts_with("bateleur.") && parts.any(|part| part == executive.to_string())
    };
    entries
        .map(|entry| entry.path())
        .filter(|path| path.file_name().unwrap().to_str().is_some_and(of_run))
        .collect()
}

fn udp_sockets() -> Vec<String> {
    let text = fs::read_to_string("/proc/net/udp").unwrap_or_default();
    text.lines().skip(1).filter_map(|line| line.split_ascii_whitespace().nth(9).map(str::to_owned)).collect()
}
