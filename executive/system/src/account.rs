//! Control groups of version 1 that count what version 2 can not count here: memory, and threads with processes.
//!
//! A machine may have both versions mounted, with the controllers held by the first. There a partition is in three
//! groups: one of version 2, which freezes and ends it, and one of version 1 for each controller. A process joins the
//! latter by itself, between `clone3` and its program. They are removed like the others, also by the guard and by the next start.

use std::fs::{self, File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};

use super::{cgroup, delegation};

/// The groups of a module or of a partition, by controller; removed when dropped.
#[derive(Debug, Default)]
pub struct Accounts {
    memory: Option<PathBuf>,
    pids: Option<PathBuf>,
}

impl Accounts {
    /// The groups `name` below those of this process, for the controllers that version 2 does not hand on.
    #[must_use]
    pub fn beside_self(name: &str) -> Self {
        let second = delegation::handed_on();
        let make = |controller: &str| {
            let absent = !second.contains(&controller);
            let above = absent.then(|| own_group(controller)).flatten()?;
            make(above.join(name)).ok()
        };
        Self { memory: make("memory"), pids: make("pids") }
    }

    /// Groups inside these.
    pub fn child(&self, name: &str) -> io::Result<Self> {
        let make = |above: &Option<PathBuf>| above.as_ref().map(|path| make(path.join(name))).transpose();
        Ok(Self { memory: make(&self.memory)?, pids: make(&self.pids)? })
    }

    /// Where they are.
    #[must_use]
    pub fn paths(&self) -> Vec<PathBuf> {
        self.memory.iter().chain(&self.pids).cloned().collect()
    }

    /// Limits the memory of all processes in them, bytes.
    pub fn limit_memory(&self, bytes: u64) -> io::Result<()> {
        let group = self.memory.as_ref().ok_or_else(absent)?;
        fs::write(group.join("memory.limit_in_bytes"), bytes.to_string())?;
        // Memory and swap together; the file is absent where swap is not counted.
        let _ = fs::write(group.join("memory.memsw.limit_in_bytes"), bytes.to_string());
        Ok(())
    }

    /// Limits what the sockets that processes in them make hold, bytes: those of UDP too, whatever the file is called.
    pub fn limit_sockets(&self, bytes: u64) -> io::Result<()> {
        let group = self.memory.as_ref().ok_or_else(absent)?;
        fs::write(group.join("memory.kmem.tcp.limit_in_bytes"), bytes.to_string())
    }

    /// Limits the threads of all processes in them.
    pub fn limit_tasks(&self, count: u32) -> io::Result<()> {
        let group = self.pids.as_ref().ok_or_else(absent)?;
        fs::write(group.join("pids.max"), count.to_string())
    }

    /// The files through which a process joins: it writes "0".
    pub fn entrances(&self) -> io::Result<Vec<File>> {
        let open = |path: PathBuf| OpenOptions::new().write(true).open(path.join("cgroup.procs"));
        self.paths().into_iter().map(open).collect()
    }

    /// Processes that the kernel ended because the group had no memory left.
    #[must_use]
    pub fn out_of_memory_kills(&self) -> u64 {
        self.memory.as_ref().map_or(0, |group| cgroup::count(&group.join("memory.oom_control"), "oom_kill"))
    }

    /// Whether more memory was asked for than there is, so that the kernel had to look for some.
    #[must_use]
    pub fn has_been_full(&self) -> bool {
        // The counters of failures stay at 0 on some kernels (seen on 6.18); the greatest use does not.
        let number =
            |group: &PathBuf, file| fs::read_to_string(group.join(file)).ok()?.trim().parse::<u64>().ok();
        let reached = |group: &PathBuf| -> Option<bool> {
            Some(number(group, "memory.max_usage_in_bytes")? >= number(group, "memory.limit_in_bytes")?)
        };
        self.memory.as_ref().is_some_and(|group| reached(group).unwrap_or(false))
    }
}

impl Drop for Accounts {
    fn drop(&mut self) {
        self.paths().iter().for_each(|path| cgroup::remove(path));
    }
}

fn make(path: PathBuf) -> io::Result<PathBuf> {
    fs::create_dir(&path)?;
    Ok(path)
}

fn absent() -> io::Error {
    io::Error::new(io::ErrorKind::NotFound, "no such controller in cgroup version 1")
}

/// The group of this process in the hierarchy of `controller`, if there is such a hierarchy.
fn own_group(controller: &str) -> Option<PathBuf> {
    let mounts = fs::read_to_string("/proc/self/mounts").ok()?;
    let groups = fs::read_to_string("/proc/self/cgroup").ok()?;
    let (mount, own) = (mount_of(&mounts, controller)?, group_of(&groups, controller)?);
    // In a container the hierarchy may be mounted from the container's group on.
    [mount.join(own.trim_start_matches('/')), mount].into_iter().find(|path| path.join("tasks").exists())
}

fn mount_of(mounts: &str, controller: &str) -> Option<PathBuf> {
    mounts.lines().find_map(|line| {
        let mut fields = line.split(' ');
        let (_, place, kind, options) = (fields.next()?, fields.next()?, fields.next()?, fields.next()?);
        let holds = kind == "cgroup" && options.split(',').any(|option| option == controller);
        holds.then(|| Path::new(place).to_owned())
    })
}

fn group_of<'a>(groups: &'a str, controller: &str) -> Option<&'a str> {
    groups.lines().find_map(|line| {
        let mut fields = line.splitn(3, ':').skip(1);
        let (controllers, path) = (fields.next()?, fields.next()?);
        controllers.split(',').any(|one| one == controller).then_some(path)
    })
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::process::{Command, Stdio};

    use super::*;

    /// Waits for a line, then holds far more memory than the group has: one process, so that there is one to end.
    const HOG: &str = "read go; exec dd if=/dev/zero of=/dev/null bs=300M count=1";

    #[test]
    fn a_process_that_is_ended_for_its_memory_is_counted() {
        let accounts = Accounts::beside_self(&format!("bateleur.account_test.{}", std::process::id()));
        if accounts.limit_memory(16 << 20).is_err() {
            return eprintln!("skipped: no memory controller of version 1 that may be used here");
        }
        assert_eq!((accounts.out_of_memory_kills(), accounts.has_been_full()), (0, false));
        let mut hog = Command::new("sh").args(["-c", HOG]).stdin(Stdio::piped()).spawn().unwrap();
        let group = accounts.memory.as_ref().unwrap();
        fs::write(group.join("cgroup.procs"), hog.id().to_string()).unwrap();
        hog.stdin.take().unwrap().write_all(b"go\n").unwrap();
        hog.wait().unwrap();
        assert_eq!((accounts.out_of_memory_kills(), accounts.has_been_full()), (1, true));
        let paths = accounts.paths();
        drop(accounts);
        assert!(paths.iter().all(|path| !path.exists()), "removed when dropped");
    }

    #[test]
    fn the_hierarchy_of_a_controller_is_found_among_others() {
        let mounts = "cgroup /sys/fs/cgroup/cpu cgroup rw,relatime,cpu 0 0\n\
                      cgroup /sys/fs/cgroup/memory cgroup rw,relatime,memory 0 0\n\
                      cgroup2 /sys/fs/cgroup/unified cgroup2 rw 0 0\n";
        assert_eq!(mount_of(mounts, "memory"), Some("/sys/fs/cgroup/memory".into()));
        assert_eq!(mount_of(mounts, "pids"), None);
        let groups = "8:pids:/\n5:memory,hugetlb:/user/a:b\n0::/\n";
        assert_eq!(group_of(groups, "memory"), Some("/user/a:b"));
        assert_eq!(group_of(groups, "cpu"), None);
    }
}
