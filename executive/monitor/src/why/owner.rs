//! Whose thread it was: a partition's, the executive's, another module's, the kernel's.

use std::collections::HashMap;
use std::fs;

use bateleur_host::instance::{self, Instance};
use bateleur_system::time::now_ns;

/// Threads whose owner is remembered, most.
const MOST: usize = 4_096;
/// Between two looks for other modules, ns.
const LOOK_NS: u64 = 1_000_000_000;
/// The same, where a process is nobody's that is known: its module may have just begun.
const STRANGER_LOOK_NS: u64 = 50_000_000;
/// Parents that are followed, most: a child of a partition's child is the partition's.
const GENERATIONS: usize = 16;
/// Whose children the kernel's own threads are.
const KERNEL: i32 = 2;

/// See the module's head.
#[derive(Debug, Default)]
pub(super) struct Owners {
    /// Processes of this module's partitions, those that have ended too.
    processes: HashMap<i32, String>,
    /// What was found: a thread that has ended can not be asked any more.
    found: HashMap<i32, String>,
    others: Vec<Instance>,
    looked_ns: u64,
}

impl Owners {
    /// These are processes of partitions, with their names.
    pub(super) fn note(&mut self, processes: &[(i32, String)]) {
        for (process, name) in processes {
            if self.processes.get(process) == Some(name) {
                continue;
            }
            if self.processes.len() >= MOST {
                self.processes.clear();
            }
            self.processes.insert(*process, name.clone());
            self.found.remove(process);
        }
    }

    /// Whether a thread is of this module's partition `name`.
    pub(super) fn is_of_partition(&mut self, thread: i32, name: &str) -> bool {
        self.of(thread).is_some_and(|of| of.strip_prefix("partition ") == Some(name))
    }

    /// Whose it is, in words.
    pub(super) fn of(&mut self, thread: i32) -> Option<String> {
        if let Some(name) = self.processes.get(&thread) {
            return Some(partition(name));
        }
        if let Some(found) = self.found.get(&thread) {
            return Some(found.clone());
        }
        let (found, is_sure) = self.look_up(thread)?;
        if !is_sure {
            return Some(found);
        }
        if self.found.len() >= MOST {
            self.found.clear();
        }
        self.found.insert(thread, found.clone());
        Some(found)
    }

    /// And whether a look for other modules would change nothing.
    fn look_up(&mut self, thread: i32) -> Option<(String, bool)> {
        let (first, owner) = self.known(thread)?;
        let most_ns = if owner.is_some() { LOOK_NS } else { STRANGER_LOOK_NS };
        let looks = now_ns().saturating_sub(self.looked_ns) > most_ns;
        if looks {
            self.looked_ns = now_ns();
            self.others = instance::others();
        }
        let owner = self.known(thread).map_or(owner, |(_, again)| again); // it may have ended meanwhile
        let is_sure = looks || owner.is_some();
        Some((owner.unwrap_or_else(|| format!("process {first}")), is_sure))
    }

    /// A thread's process, and whose that is, if that is known.
    fn known(&self, thread: i32) -> Option<(i32, Option<String>)> {
        let own = std::process::id() as i32;
        let (first, mut parent) = process_of(thread)?;
        let mut process = first;
        for _ in 0..GENERATIONS {
            if let Some(name) = self.processes.get(&process) {
                return Some((first, Some(partition(name))));
            }
            if process == own {
                let helper = if first == own { "the executive" } else { "a helper of the executive" };
                return Some((first, Some(helper.into())));
            }
            if let Some(other) = self.others.iter().find(|other| other.pid == process) {
                let module = other.module().replace(char::is_control, "\u{fffd}");
                return Some((first, Some(format!("module {module} (PID {process})"))));
            }
            if process == KERNEL || parent == KERNEL {
                return Some((first, Some("the kernel".into())));
            }
            if process <= 1 {
                break;
            }
            (process, parent) = process_of(parent)?;
        }
        Some((first, None))
    }
}

fn partition(name: &str) -> String {
    format!("partition {name}")
}

/// A thread's process, and that one's parent.
fn process_of(thread: i32) -> Option<(i32, i32)> {
    let status = fs::read_to_string(format!("/proc/{thread}/status")).ok()?;
    let value = |key| status.lines().find_map(|line| line.strip_prefix(key)?.trim().parse().ok());
    Some((value("Tgid:")?, value("PPid:")?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::Command;

    #[test]
    fn a_thread_is_its_process_partition_or_that_of_a_parent() {
        let mut child = Command::new("sh").args(["-c", "sleep 60 & echo; wait"]).spawn().unwrap();
        let (own, pid) = (std::process::id() as i32, child.id() as i32);
        let mut owners = Owners::default();
        assert_eq!(owners.of(own).as_deref(), Some("the executive"));
        assert_eq!(owners.of(pid).as_deref(), Some("a helper of the executive"));
        owners.note(&[(pid, "imu".into())]);
        assert!(owners.is_of_partition(pid, "imu") && !owners.is_of_partition(pid, "gps"));
        let grandchild = loop {
            if let Some(below) = bateleur_system::processes::below(pid).first() {
                break below.pid;
            }
        };
        assert_eq!(owners.of(grandchild).as_deref(), Some("partition imu"));
        rustix::process::kill_process(
            rustix::process::Pid::from_raw(grandchild).unwrap(),
            rustix::process::Signal::KILL,
        )
        .unwrap();
        child.kill().unwrap();
        child.wait().unwrap();
        assert_eq!(owners.of(grandchild).as_deref(), Some("partition imu"), "it was found while it lived");
        assert_eq!(owners.of(i32::MAX), None);
    }
}
