//! What this machine gives: examined by trying, before anything is started.

use std::fs::File;
use std::os::fd::AsFd;
use std::path::Path;

use bateleur_contract::Clock;

use crate::guarantee::Guarantees;
use crate::partition::ended;
use crate::plan::ModuleView;
use crate::system::cgroup::Group;
use crate::system::delegation;
use crate::system::sched;
use crate::system::spawn::{Namespaces, Request, User, spawn};

/// The user that partitions run as when the executive is root: outside the ranges that Linux distributions give to
/// people, services and containers.
pub const PARTITION_USER: u32 = 61_653;

/// The result of the examination.
#[derive(Debug)]
pub struct Machine {
    /// SCHED_FIFO is to be had.
    pub real_time: bool,
    /// What can be shut off from a partition.
    pub namespaces: Namespaces,
    /// Whom partitions run as; none: as the executive.
    pub user: Option<u32>,
    /// Every promise, kept or not.
    pub guarantees: Guarantees,
    groups: bool,
    cores: Vec<(u32, u32)>,
}

impl Machine {
    /// Tries everything that the module of `view` will need.
    #[must_use]
    pub fn examine(view: &ModuleView<'_>, clock: Clock) -> Self {
        let mut guarantees = Guarantees::default();
        let user = (rustix::process::geteuid().is_root()).then_some(PARTITION_USER);
        let cores = map_cores(view.cores(), &sched::allowed_cores(), &mut guarantees);
        let real_time = real_time(clock, &mut guarantees);
        let groups = groups(&mut guarantees);
        match user {
            Some(id) => guarantees.held("a partition can not harm the executive", format!("partitions run as user {id}")),
            None => guarantees.missing(
                "a partition can not harm the executive",
                "partitions run as the same user as the executive; start it as root, or from its systemd unit",
            ),
        }
        let namespaces = namespaces(user, &mut guarantees);
        memory(&mut guarantees);
        keep_housekeeping_free(&cores);
        Self { real_time, namespaces, user, guarantees, groups, cores }
    }

    /// The module's control group, where there can be one.
    #[must_use]
    pub fn make_group(&self, name: &str) -> Option<Group> {
        let group = self.groups.then(|| Group::beside_self(name).ok()).flatten()?;
        group.enable_controllers(&delegation::CONTROLLERS);
        Some(group)
    }

    /// The processor that stands for the plan's `core`.
    #[must_use]
    pub fn real_core(&self, core: u32) -> u32 {
        self.cores.iter().find(|(planned, _)| *planned == core).map_or(core, |(_, real)| *real)
    }

    /// The processors whose time is partitioned.
    #[must_use]
    pub fn partitioned_cores(&self) -> Vec<u32> {
        self.cores.iter().map(|(_, real)| *real).collect()
    }
}

/// A machine may have fewer cores than the plan names: the last one that it has stands in.
fn map_cores(planned: &[u32], allowed: &[u32], guarantees: &mut Guarantees) -> Vec<(u32, u32)> {
    const PROMISE: &str = "each partitioned core is a processor of its own";
    let last = allowed.last().copied().unwrap_or(0);
    let map: Vec<_> =
        planned.iter().map(|&core| (core, if allowed.contains(&core) { core } else { last })).collect();
    match map.iter().find(|(planned, real)| planned != real) {
        None => guarantees.held(PROMISE, format!("{planned:?}")),
        Some((core, real)) => guarantees.missing(
            PROMISE,
            format!("this process may not use processor {core} of the plan; processor {real} stands in"),
        ),
    }
    map
}

/// Everything but dispatchers and partitions stays off the partitioned cores, if there are others.
fn keep_housekeeping_free(cores: &[(u32, u32)]) {
    let free: Vec<u32> = sched::allowed_cores()
        .into_iter()
        .filter(|core| cores.iter().all(|(_, real)| real != core))
        .collect();
    if !free.is_empty() {
        let _ = sched::bind(0, &free); // a machine that forbids it has said so above
    }
}

fn real_time(clock: Clock, guarantees: &mut Guarantees) -> bool {
    const PROMISE: &str = "a window starts and ends at its instant";
    if clock == Clock::Virtual {
        guarantees.held(PROMISE, "virtual clock: windows have no real instants");
        return true;
    }
    let tried = sched::fifo(0, 1);
    let _ = sched::ordinary(0); // was not changed then
    let mend = "no SCHED_FIFO, windows may be milliseconds late; run as root, or give CAP_SYS_NICE or an rtprio limit";
    guarantees
        .examine(PROMISE, tried, "SCHED_FIFO 98 on the partitioned core, absolute instants", mend)
        .is_some()
}

fn groups(guarantees: &mut Guarantees) -> bool {
    const PROMISE: &str = "a window's end holds every process of a partition";
    let probe = || {
        let group = Group::beside_self(&format!("bateleur.probe.{}", std::process::id()))?;
        group.freezer()?.freeze()
    };
    let place = delegation::base().map(|path| path.display().to_string()).unwrap_or_default();
    let how = format!("control groups below {place}");
    let mend = "a child that leaves its session escapes SIGSTOP; delegate a cgroup v2 subtree (systemd: Delegate=yes)";
    guarantees.examine(PROMISE, probe(), &how, mend).is_some()
}

fn namespaces(user: Option<u32>, guarantees: &mut Guarantees) -> Namespaces {
    let all = [
        (
            "a partition sees the file system read-only, and of all channels its own",
            Namespaces { mount: true, ..Namespaces::default() },
        ),
        (
            "a partition has no network unless the plan grants it",
            Namespaces { network: true, ..Namespaces::default() },
        ),
        (
            "a partition has System V objects and queues of its own",
            Namespaces { ipc: true, ..Namespaces::default() },
        ),
        ("a partition has a host name of its own", Namespaces { uts: true, ..Namespaces::default() }),
        ("a partition can signal nobody else", Namespaces { pid: true, ..Namespaces::default() }),
    ];
    let mut found = Namespaces::default();
    for (promise, one) in all {
        let mend = "needs root (CAP_SYS_ADMIN)";
        if guarantees.examine(promise, try_namespaces(one, user), "a namespace of its own", mend).is_some() {
            found.mount |= one.mount;
            found.network |= one.network;
            found.ipc |= one.ipc;
            found.uts |= one.uts;
            found.pid |= one.pid;
        }
    }
    found
}

fn try_namespaces(namespaces: Namespaces, user: Option<u32>) -> std::io::Result<()> {
    let nothing = File::open("/dev/null")?;
    let request = Request {
        program: Path::new("/proc/self/exe"),
        arguments: &["probe".into()],
        environment: &[],
        descriptors: &[],
        input: None,
        output: None,
        errors: nothing.as_fd(),
        group: None,
        namespaces,
        channels: &[],
        user: user.map(|id| User { id, groups: Vec::new() }),
        data_limit: 0,
        dies_with_starter: true,
    };
    let process = spawn(&request)?;
    crate::partition::await_any_end(&[process.pidfd.as_fd()], 1_000_000_000);
    let _ = ended(&process); // a probe that hangs dies with the executive
    Ok(())
}

/// What is left where no controller counts a partition's memory.
const PROCESS_ONLY: &str = "each process is limited (RLIMIT_DATA), their sum is not";

fn memory(guarantees: &mut Guarantees) {
    const PROMISE: &str = "a partition uses no more memory than it was granted";
    let settled = delegation::settle();
    match (delegation::handed_on().contains(&"memory"), settled) {
        (true, _) => guarantees.held(PROMISE, "memory.max of its control group"),
        (false, Err(error)) => guarantees.missing(PROMISE, format!("{error}; {PROCESS_ONLY}")),
        (false, Ok(())) => {
            guarantees.missing(PROMISE, format!("no memory controller in cgroup v2: {PROCESS_ONLY}"));
        }
    }
    let locked = rustix::mm::mlockall(rustix::mm::MlockAllFlags::CURRENT);
    let mend = "a page fault may delay a window; raise the limit of locked memory (ulimit -l)";
    guarantees.examine("the executive's memory stays in place", locked, "locked", mend);
}
