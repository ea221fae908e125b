//! What the kernel says of other processes.

/// What proc_pid_stat(5) says of a process.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Process {
    /// Its number.
    pub pid: i32,
    /// Its name, at most 15 bytes.
    pub name: String,
    /// `T`: stopped by a signal; the others stand there.
    pub state: char,
    /// Who started it, or adopted it.
    pub parent: i32,
    /// When it was started, clock ticks since boot: a number that is used again is not the same process.
    pub started_ticks: u64,
    /// It, or its first thread, is exiting or has ended, or SIGKILL waits for it. For microseconds in between none of this can be seen.
    pub dying: bool,
}

/// The flag `PF_EXITING` of include/linux/sched.h.
const EXITING: u64 = 4;

impl Process {
    /// Whether it has ended and is not waited for, or its first thread has.
    #[must_use]
    pub fn has_ended(&self) -> bool {
        matches!(self.state, 'Z' | 'X')
    }
}

/// A process that has not been waited for.
#[must_use]
pub fn process(pid: i32) -> Option<Process> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The name may hold anything, so fields are counted from its closing bracket, the end of field 2.
    let (before, after) = stat.rsplit_once(')')?;
    let fields: Vec<&str> = after.split_ascii_whitespace().collect();
    let field = |number: usize| fields.get(number - 3)?.parse::<u64>().ok();
    let is_killed = field(31)? & (1 << (libc::SIGKILL - 1)) != 0;
    let mut process = Process {
        pid,
        name: before.split_once('(')?.1.to_owned(),
        state: fields.first()?.chars().next()?,
        parent: fields.get(1)?.parse().ok()?,
        started_ticks: field(22)?,
        dying: is_killed || field(9)? & EXITING != 0,
    };
    process.dying |= process.has_ended();
    Some(process)
}

/// All processes below `root`, nearest first.
#[must_use]
pub fn below(root: i32) -> Vec<Process> {
    let entries = std::fs::read_dir("/proc").into_iter().flatten().flatten();
    let numbers = entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    let mut others: Vec<Process> = numbers.filter_map(process).collect();
    let mut found: Vec<Process> = Vec::new();
    let mut parents = vec![root];
    while !parents.is_empty() {
        let is_child = |process: &Process| parents.contains(&process.parent);
        let (children, rest): (Vec<Process>, Vec<Process>) = others.into_iter().partition(is_child);
        parents = children.iter().map(|child| child.pid).collect();
        found.extend(children);
        others = rest;
    }
    found
}

#[cfg(test)]
mod tests {
    use std::io::{BufRead, BufReader};
    use std::process::{Command, Stdio};

    use super::*;

    #[test]
    fn processes_below_are_found_with_their_names() {
        let words = "sleep 60 & echo $!; sh -c 'sleep 61; :' & echo $!; wait";
        let mut root = Command::new("sh").args(["-c", words]).stdout(Stdio::piped()).spawn().unwrap();
        let lines = BufReader::new(root.stdout.take().unwrap()).lines();
        let children: Vec<i32> = lines.take(2).map(|line| line.unwrap().parse().unwrap()).collect();
        let pid = root.id() as i32;
        let begun = std::time::Instant::now();
        // A process has its name before it runs for the first time: on a busy machine it is seen as `R` for a while.
        let found = loop {
            let found = below(pid);
            let asleep = |name: &str| {
                found.iter().filter(|process| process.state == 'S' && process.name == name).count()
            };
            if (asleep("sleep"), asleep("sh")) == (2, 1) || begun.elapsed().as_secs() > 20 {
                break found;
            }
        };
        assert_eq!(found.len(), 3, "{found:?}");
        assert!(found.iter().all(|process| process.state == 'S'), "{found:?}");
        assert!(children.iter().all(|child| found.iter().any(|it| (it.pid, it.parent) == (*child, pid))));
        for process in found {
            let _ = Command::new("kill").args(["-9", &process.pid.to_string()]).status();
        }
        root.wait().unwrap();
        assert_eq!(process(children[0]), None);
    }

    #[test]
    fn processes_that_are_dying_are_told_from_those_that_live() {
        let mut child = Command::new("sleep").arg("60").spawn().unwrap();
        let pid = child.id() as i32;
        let lives = process(pid).unwrap();
        child.kill().unwrap();
        let begun = std::time::Instant::now();
        let mut looks = Vec::new();
        // Until it is waited for it is there, in whatever stage of its death.
        while begun.elapsed().as_millis() < 50 {
            looks.push(process(pid).unwrap().dying);
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        let ended = process(pid).unwrap();
        child.wait().unwrap();
        assert!(!lives.dying && !lives.has_ended() && ended.has_ended());
        assert_eq!(lives.started_ticks, ended.started_ticks);
        assert!(looks.iter().filter(|dying| !**dying).count() < 2, "{looks:?}");
        assert_eq!(process(pid), None);
    }
}
