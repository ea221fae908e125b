//! Control groups, version 2: the one mechanism that reaches every process of a partition, whatever it forked.
//!
//! The executive makes its groups below the one that it was started in, which a user's system delegates to it. Only
//! `cgroup.freeze`, `cgroup.kill` and `cgroup.procs` are needed; `memory.max` and `pids.max` are used where they exist.

use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// A group of the executive's own; removed, with everything in it ended, when dropped.
#[derive(Debug)]
pub struct Group {
    path: PathBuf,
    directory: File,
    threads: File,
}

/// The files of a group that the time-critical path needs, kept open.
#[derive(Debug)]
pub struct Freezer {
    freeze: File,
    events: File,
    processes: File,
    threads: File,
}

impl Group {
    /// Makes the group `name` below the one that was delegated to this process.
    pub fn beside_self(name: &str) -> io::Result<Self> {
        Self::make(super::delegation::base()?.join(name))
    }

    /// Makes a group inside this one.
    pub fn child(&self, name: &str) -> io::Result<Self> {
        Self::make(self.path.join(name))
    }

    fn make(path: PathBuf) -> io::Result<Self> {
        fs::create_dir(&path)?;
        let (directory, threads) = (File::open(&path)?, File::open(path.join("cgroup.threads"))?);
        Ok(Self { path, directory, threads })
    }

    /// Where it is.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// For `clone3` into it.
    #[must_use]
    pub fn as_fd(&self) -> BorrowedFd<'_> {
        self.directory.as_fd()
    }

    /// Opens the files for freezing it.
    pub fn freezer(&self) -> io::Result<Freezer> {
        let read = |name: &str| File::open(self.path.join(name));
        Ok(Freezer {
            freeze: OpenOptions::new().write(true).open(self.path.join("cgroup.freeze"))?,
            events: read("cgroup.events")?,
            processes: read("cgroup.procs")?,
            threads: self.threads.try_clone()?,
        })
    }

    /// Sets a limit such as `memory.max`; an error where the controller is not there.
    pub fn limit(&self, file: &str, value: u64) -> io::Result<()> {
        fs::write(self.path.join(file), value.to_string())
    }

    /// Limits the memory of all processes in it, bytes. What exceeds it ends the partition as a whole, where the kernel knows how.
    pub fn limit_memory(&self, bytes: u64) -> io::Result<()> {
        self.limit("memory.max", bytes)?;
        let _ = self.limit("memory.swap.max", 0); // absent where swap is not counted
        let _ = self.limit("memory.oom.group", 1); // since Linux 4.19
        Ok(())
    }

    /// Processes that the kernel ended because the group had no memory left.
    #[must_use]
    pub fn out_of_memory_kills(&self) -> u64 {
        count(&self.path.join("memory.events"), "oom_kill")
    }

    /// Whether more memory was asked for than there is, so that the kernel had to look for some.
    #[must_use]
    pub fn has_been_full(&self) -> bool {
        count(&self.path.join("memory.events"), "max") > 0
    }

    /// Enables controllers for the groups inside, as far as they exist.
    pub fn enable_controllers(&self, controllers: &[&str]) {
        for controller in controllers {
            let _ = fs::write(self.path.join("cgroup.subtree_control"), format!("+{controller}")); // the limit will tell
        }
    }

    /// Ends every process in the group with SIGKILL, frozen or not; the group can be used again.
    ///
    /// Not by `cgroup.kill`: kernels since 6.11 then also kill whatever is later started into the group from outside
    /// it (the kill count of the starter's group is compared with that of the new process' group).
    pub fn end_processes(&self) {
        end_processes(&self.path);
    }

    /// Threads of all processes in the group, as they are now.
    #[must_use]
    pub fn threads(&self) -> Vec<i32> {
        let mut all = Vec::new();
        each_number(&self.threads, &mut |thread| all.push(thread));
        all
    }
}

/// How often the list of a group's processes is read before it is given up: a fork bomb may be faster than a few.
const ROUNDS: usize = 1000;

impl Drop for Group {
    fn drop(&mut self) {
        remove(&self.path);
    }
}

impl Freezer {
    /// Stops every thread of the group.
    pub fn freeze(&self) -> io::Result<()> {
        (&self.freeze).write_all(b"1")
    }

    /// Lets them go on.
    pub fn thaw(&self) -> io::Result<()> {
        (&self.freeze).write_all(b"0")
    }

    /// Whether every thread of the group has stopped.
    #[must_use]
    pub fn is_frozen(&self) -> bool {
        let mut text = [0; 128];
        let length = self.events.read_at(&mut text, 0).unwrap_or(0);
        text[..length].windows(b"frozen 1".len()).any(|part| part == b"frozen 1")
    }

    /// Gives `each` every process of the group, without allocating.
    pub fn each_process(&self, each: &mut dyn FnMut(i32)) {
        each_number(&self.processes, each);
    }

    /// Gives `each` every thread of the group, without allocating.
    pub fn each_thread(&self, each: &mut dyn FnMut(i32)) {
        each_number(&self.threads, each);
    }
}

/// Gives `each` the numbers in a file, one a line.
fn each_number(file: &File, each: &mut dyn FnMut(i32)) {
    let (mut text, mut at, mut number) = ([0_u8; 2048], 0, None);
    loop {
        let length = file.read_at(&mut text, at).unwrap_or(0);
        for byte in &text[..length] {
            match byte {
                b'0'..=b'9' => {
                    number = Some(number.unwrap_or(0_i32).wrapping_mul(10) + i32::from(byte - b'0'));
                }
                _ => number.take().into_iter().for_each(&mut *each),
            }
        }
        if length < text.len() {
            break;
        }
        at += length as u64;
    }
    number.into_iter().for_each(each);
}

fn kill(path: &Path) -> io::Result<()> {
    fs::write(path.join("cgroup.kill"), "1")
}

fn end_processes(group: &Path) {
    for _ in 0..ROUNDS {
        let processes = processes(group);
        if processes.is_empty() {
            return;
        }
        for pid in processes.into_iter().filter_map(rustix::process::Pid::from_raw) {
            let _ = rustix::process::kill_process(pid, rustix::process::Signal::KILL); // ended already
        }
        std::thread::sleep(Duration::from_micros(200));
    }
}

fn processes(group: &Path) -> Vec<i32> {
    let list = fs::read_to_string(group.join("cgroup.procs")).unwrap_or_default();
    list.lines().filter_map(|line| line.parse().ok()).collect()
}

/// The number behind `key` in a file of lines `key number`; 0 where either is absent.
pub(super) fn count(file: &Path, key: &str) -> u64 {
    let text = fs::read_to_string(file).unwrap_or_default();
    let mut lines = text.lines().filter_map(|line| line.split_once(' '));
    lines.find(|(name, _)| *name == key).and_then(|(_, number)| number.trim().parse().ok()).unwrap_or(0)
}

/// How long the processes of a killed group may take to be gone; a process inside the kernel takes a little.
const GONE_WITHIN: Duration = Duration::from_secs(2);

/// Ends everything in a group and removes it with the groups inside.
pub fn remove(path: &Path) {
    if !path.exists() {
        return;
    }
    if kill(path).is_err() {
        end_processes(path); // version 1, and kernels before 5.14
    }
    for inner in fs::read_dir(path).into_iter().flatten().flatten() {
        if inner.file_type().is_ok_and(|kind| kind.is_dir()) {
            remove(&inner.path());
        }
    }
    let begun = Instant::now();
    while fs::remove_dir(path).is_err() && path.exists() && begun.elapsed() < GONE_WITHIN {
        std::thread::sleep(Duration::from_millis(1));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kills_are_counted_by_their_key() {
        let file = tempfile::NamedTempFile::new().unwrap();
        fs::write(&file, "oom 7\noom_kill 3\noom_group_kill 1\n").unwrap();
        assert_eq!(count(file.path(), "oom_kill"), 3);
        assert_eq!(count(file.path(), "absent"), 0);
        assert_eq!(count(Path::new("/nowhere"), "oom_kill"), 0);
    }

    #[test]
    fn numbers_of_a_long_list_are_read_whole_across_the_ends_of_the_buffer() {
        let mut file = tempfile::tempfile().unwrap();
        let numbers: Vec<i32> = (0..3000).map(|number| number * 7).collect();
        let text: Vec<String> = numbers.iter().map(i32::to_string).collect();
        file.write_all(text.join("\n").as_bytes()).unwrap();
        let mut read = Vec::new();
        each_number(&file, &mut |number| read.push(number));
        assert_eq!(read, numbers);
    }
}
