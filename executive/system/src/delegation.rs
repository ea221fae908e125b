//! The place in the tree of control groups where a module's groups are made.
//!
//! A unit of systemd with `Delegate=yes` starts the executive in the very group that it delegates. Controllers can be
//! handed on to groups inside only by a group without processes of its own (Linux, Documentation/admin-guide/cgroup-v2.rst,
//! "No Internal Process Constraint"), so the executive first steps aside, into a leaf. It moves itself and the programs that it
//! was started with or has started, and nothing else: a group that is shared with strangers stays as it is.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

/// The leaf into which the executive steps aside.
pub const LEAF: &str = "bateleur.executive";
/// What is handed on to the module's groups, where the machine has it.
pub const CONTROLLERS: [&str; 2] = ["memory", "pids"];

/// The group below which a module's groups are made.
///
/// # Errors
/// There is no hierarchy of version 2.
pub fn base() -> io::Result<PathBuf> {
    Ok(above_leaf(own_group()?))
}

/// The version 2 group that this process is in.
fn own_group() -> io::Result<PathBuf> {
    let groups = fs::read_to_string("/proc/self/cgroup")?;
    let own = groups.lines().find_map(|line| line.strip_prefix("0::/"));
    let absent = || io::Error::new(io::ErrorKind::NotFound, absence(own));
    let mount = mount_point(&fs::read_to_string("/proc/self/mounts")?).ok_or_else(absent)?;
    Ok(mount.join(own.ok_or_else(absent)?))
}

/// Why there is no hierarchy for a process whose group is `own` below its root, and what to do.
fn absence(own: Option<&str>) -> &'static str {
    match own {
        None | Some("") => "no cgroup version 2 hierarchy is mounted",
        // The kernel has it, and this process is in it: somebody has mounted something else above it.
        Some(_) => HIDDEN,
    }
}

/// What is said where control groups are there and can not be seen.
const HIDDEN: &str = "the cgroup version 2 hierarchy is hidden from this process, as `ip netns exec` does, which mounts /sys anew: \
    enter the network namespace by `nsenter --net=/run/netns/NAME`, or mount it again: mount -t cgroup2 none /sys/fs/cgroup";

fn mount_point(mounts: &str) -> Option<PathBuf> {
    let mut fields = mounts.lines().map(|line| line.split(' '));
    fields.find_map(|mut field| {
        let (_, at, kind) = (field.next()?, field.next()?, field.next()?);
        (kind == "cgroup2").then(|| PathBuf::from(at))
    })
}

fn above_leaf(own: PathBuf) -> PathBuf {
    match (own.file_name(), own.parent()) {
        (Some(name), Some(above)) if name == LEAF => above.to_owned(),
        _ => own,
    }
}

/// Which of [`CONTROLLERS`] the groups below [`base`] have.
#[must_use]
pub fn handed_on() -> Vec<&'static str> {
    let words = base().and_then(|base| words(&base.join("cgroup.subtree_control"))).unwrap_or_default();
    CONTROLLERS.into_iter().filter(|controller| words.iter().any(|word| word == controller)).collect()
}

/// What [`settle`] did.
#[derive(Debug)]
pub struct Settled {
    base: PathBuf,
    handed_on: Vec<&'static str>,
    aside: bool,
}

impl Settled {
    /// Leaves the group as it was found, unless groups have been made in it. As long as it hands controllers on, systemd can
    /// start no other process in it: a unit's main process after an `ExecStartPre=`.
    pub fn undo(self) {
        let leaf = self.base.join(LEAF);
        let inside = fs::read_dir(&self.base).into_iter().flatten().flatten();
        if inside.map(|entry| entry.path()).any(|path| path.is_dir() && path != leaf) {
            return;
        }
        for controller in self.handed_on {
            let _ = fs::write(self.base.join("cgroup.subtree_control"), format!("-{controller}")); // then it stays
        }
        if self.aside {
            for pid in processes(&leaf).unwrap_or_default() {
                let _ = fs::write(self.base.join("cgroup.procs"), pid.to_string()); // as above
            }
            let _ = fs::remove_dir(&leaf); // as above
        }
    }
}

/// Hands the controllers on to the groups below [`base`], stepping aside where that needs it.
///
/// # Errors
/// What forbids it, with the way to mend it. What is not handed on then is seen by [`handed_on`].
pub fn settle() -> io::Result<Settled> {
    let base = base()?;
    if let Ok(handed_on) = hand_on(&base) {
        return Ok(Settled { base, handed_on, aside: false });
    }
    let inside = processes(&base)?;
    if let Some(stranger) = inside.iter().find(|pid| !is_ours(**pid)) {
        return Err(io::Error::other(format!(
            "the control group {} is shared with process {stranger}; start in a unit of its own, such as \
             `systemd-run --scope -p Delegate=yes bateleur …`",
            base.display()
        )));
    }
    let leaf = base.join(LEAF);
    match fs::create_dir(&leaf) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
        _ => {}
    }
    for pid in inside {
        // One that has ended meanwhile can not be moved, and need not be.
        let _ = fs::write(leaf.join("cgroup.procs"), pid.to_string());
    }
    let handed_on = hand_on(&base)?;
    Ok(Settled { base, handed_on, aside: true })
}

/// Gives what was not handed on before.
fn hand_on(group: &Path) -> io::Result<Vec<&'static str>> {
    let mut handed_on = Vec::new();
    let there = words(&group.join("cgroup.controllers"))?;
    let already = words(&group.join("cgroup.subtree_control"))?;
    for controller in CONTROLLERS {
        let has = |list: &[String]| list.iter().any(|word| word == controller);
        if has(&there) && !has(&already) {
            fs::write(group.join("cgroup.subtree_control"), format!("+{controller}"))?;
            handed_on.push(controller);
        }
    }
    Ok(handed_on)
}

fn words(file: &Path) -> io::Result<Vec<String>> {
    Ok(fs::read_to_string(file)?.split_whitespace().map(str::to_owned).collect())
}

fn processes(group: &Path) -> io::Result<Vec<i32>> {
    Ok(fs::read_to_string(group.join("cgroup.procs"))?.lines().filter_map(|line| line.parse().ok()).collect())
}

/// Whether a process is this one, one of the project's that started it, or a child of these.
fn is_ours(pid: i32) -> bool {
    let own = std::process::id().cast_signed();
    // The project's programs lie in one folder.
    let folder = |pid: i32| Some(fs::read_link(format!("/proc/{pid}/exe")).ok()?.parent()?.to_owned());
    let mut eldest = own;
    while let Some(parent) = parent_of(eldest).filter(|parent| folder(*parent) == folder(own)) {
        eldest = parent;
    }
    std::iter::successors(Some(pid), |pid| parent_of(*pid)).any(|ancestor| ancestor == eldest)
}

fn parent_of(pid: i32) -> Option<i32> {
    let stat = fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The name in brackets may hold anything, so fields are counted from its closing bracket.
    stat.rsplit_once(')')?.1.split_whitespace().nth(1)?.parse().ok().filter(|parent| *parent > 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hidden_groups_are_answered_with_what_to_do_and_absent_ones_are_not() {
        assert!(absence(Some("user.slice/session-1.scope")).contains("nsenter --net="));
        assert!(!absence(Some("")).contains("nsenter") && !absence(None).contains("nsenter"));
    }

    #[test]
    fn the_second_version_is_found_beside_the_first() {
        let mounts =
            "cgroup /sys/fs/cgroup/cpu cgroup rw,cpu 0 0\ncgroup2 /sys/fs/cgroup/unified cgroup2 rw 0 0\n";
        assert_eq!(mount_point(mounts), Some("/sys/fs/cgroup/unified".into()));
        assert_eq!(mount_point("proc /proc proc rw 0 0\n"), None);
    }

    #[test]
    fn groups_are_made_beside_the_leaf_and_not_inside_it() {
        assert_eq!(
            above_leaf("/sys/fs/cgroup/fcu.service/bateleur.executive".into()),
            Path::new("/sys/fs/cgroup/fcu.service")
        );
        assert_eq!(above_leaf("/sys/fs/cgroup/fcu.service".into()), Path::new("/sys/fs/cgroup/fcu.service"));
    }

    #[test]
    fn children_are_ours_and_the_first_process_of_the_machine_is_not() {
        let mut child = std::process::Command::new("sleep").arg("30").spawn().unwrap();
        assert!(is_ours(child.id().cast_signed()) && is_ours(std::process::id().cast_signed()));
        assert!(!is_ours(1));
        child.kill().unwrap();
        child.wait().unwrap();
    }
}
