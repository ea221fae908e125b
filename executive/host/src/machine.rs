//! What this machine gives: examined by trying, before anything is started.

use std::fs::{File, Metadata};
use std::os::fd::AsFd;
use std::os::unix::fs::{FileTypeExt, MetadataExt};
use std::os::unix::process::ExitStatusExt;
use std::path::Path;

use bateleur_contract::Clock;

use crate::guarantee::Guarantees;
use crate::instance::{self, Instance};
use crate::network_limits::{MOST_ADDRESSES, NetworkLimits};
use crate::partition::MOST_SOCKETS;
use crate::processor::Claim;
use bateleur_plan::ModuleView;
use bateleur_system::account::Accounts;
use bateleur_system::cgroup::Group;
use bateleur_system::delegation::{self, Settled};
use bateleur_system::filter::{Filters, Grants};
use bateleur_system::lock_calls::{LockCounter, LockLimit};
use bateleur_system::rules::{self, Granted};
use bateleur_system::sched;
use bateleur_system::spawn::{Namespaces, Request, User, Walls, spawn};
use bateleur_system::users::{self, Users};
use bateleur_system::wait::ended;

/// The result of the examination.
#[derive(Debug)]
pub struct Machine {
    /// SCHED_FIFO is to be had.
    pub real_time: bool,
    /// What can be shut off from a partition.
    pub namespaces: Namespaces,
    /// Whom helpers and partitions run as; `None`: as the executive.
    pub users: Option<Users>,
    /// System calls can be filtered.
    pub filtered: bool,
    /// Those that make locks of byte ranges can be counted.
    pub counts_locks: bool,
    /// The kernel has rules about files.
    pub ruled: bool,
    /// Every promise, kept or not.
    pub guarantees: Guarantees,
    groups: bool,
    cores: Vec<(u32, u32)>,
    settled: Option<Settled>,
    _claim: Option<Claim>,
}

impl Machine {
    /// Tries everything that the module of `view` will need. `processor` is that for all windows on the virtual clock; `None`: it is
    /// claimed here.
    #[must_use]
    pub fn examine(view: &ModuleView<'_>, clock: Clock, processor: Option<u32>) -> Self {
        let mut guarantees = Guarantees::default();
        let is_root = rustix::process::geteuid().is_root();
        let user = is_root.then(Users::helper);
        let user = user.as_ref();
        let mut claim = None;
        let cores = match clock {
            Clock::Wall => map_cores(view.cores(), &sched::allowed_cores(), &mut guarantees),
            Clock::Virtual => {
                claim = processor.is_none().then(|| Claim::take(view.cores()));
                let real = processor.or(claim.as_ref().map(Claim::processor)).unwrap_or(0);
                const HOW: &str = "virtual clock: one window follows the other, on processor";
                guarantees.held(OWN_CORES, format!("{HOW} {real}"));
                view.cores().iter().map(|&core| (core, real)).collect()
            }
        };
        neighbours(clock, &cores, &mut guarantees);
        let real_time = real_time(clock, &mut guarantees);
        let groups = groups(&mut guarantees);
        const HARMLESS: &str = "a partition can not harm the executive";
        match is_root {
            true => guarantees.held(HARMLESS, "partitions run as users of their own"),
            false => guarantees.missing(
                HARMLESS,
                "partitions run as the same user as the executive; start it as root, or from its systemd unit",
            ),
        }
        let (filtered, counts_locks) = filters(user, &mut guarantees);
        let ruled = rules(user, &mut guarantees);
        let namespaces = namespaces(user, filtered, &mut guarantees);
        let partitions = partition_users(is_root, namespaces, view.plan().partitions.len(), &mut guarantees);
        let users = is_root.then_some(Users { partitions });
        channels(namespaces.mount, ruled, &mut guarantees);
        let settled = memory(filtered, &mut guarantees);
        if view.partitions().any(|id| view.plan()[id].network) {
            network_limits(&mut guarantees);
        }
        devices(view, &mut guarantees);
        // On the virtual clock the other processors may be those of other modules, whose partitions would starve the helpers there.
        if clock == Clock::Wall {
            keep_housekeeping_free(&cores);
        }
        Self {
            real_time,
            namespaces,
            users,
            filtered,
            counts_locks,
            ruled,
            guarantees,
            groups,
            cores,
            settled,
            _claim: claim,
        }
    }

    /// Leaves this process's control group as it was found: who only examines changes nothing.
    pub fn leave(self) {
        if let Some(settled) = self.settled {
            settled.undo();
        }
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

const OWN_CORES: &str = "each partitioned core is a processor of its own";

/// A machine may have fewer cores than the plan names: the last one that it has stands in.
fn map_cores(planned: &[u32], allowed: &[u32], guarantees: &mut Guarantees) -> Vec<(u32, u32)> {
    let last = allowed.last().copied().unwrap_or(0);
    let map: Vec<_> =
        planned.iter().map(|&core| (core, if allowed.contains(&core) { core } else { last })).collect();
    match map.iter().find(|(planned, real)| planned != real) {
        None => guarantees.held(OWN_CORES, format!("{planned:?}")),
        Some((core, real)) => guarantees.missing(
            OWN_CORES,
            format!("this process may not use processor {core} of the plan; processor {real} stands in"),
        ),
    }
    map
}

/// Other modules that live now. One that starts in the same instant is not among them: `bateleur ps` shows it.
fn neighbours(clock: Clock, cores: &[(u32, u32)], guarantees: &mut Guarantees) {
    const PROMISE: &str = "exclusive cores";
    if clock == Clock::Virtual {
        return guarantees.held(PROMISE, "virtual clock: no dispatcher takes a processor");
    }
    let cores: Vec<u32> = cores.iter().map(|(_, real)| *real).collect();
    match taken_by(&cores, &instance::living()) {
        None => guarantees.held(PROMISE, "none that lives, as far as this user may see"),
        Some(why) => guarantees.missing(PROMISE, why),
    }
}

/// Whose dispatchers have one of `cores`, in words.
pub fn taken_by(cores: &[u32], living: &[Instance]) -> Option<String> {
    let others = living.iter().filter_map(|other| {
        let core = other.cores.iter().find(|core| cores.contains(core))?;
        // As root, the folder of any user.
        let module = other.module().replace(char::is_control, "\u{fffd}");
        Some(format!("module {module} (PID {}) also uses processor {core}", other.pid))
    });
    let others: Vec<String> = others.collect();
    let mend = "each takes the other's windows; end one, or give it other cores in its plan";
    (!others.is_empty()).then(|| format!("{}: {mend}", others.join(", ")))
}

/// Said only where the plan grants a device by its path.
fn devices(view: &ModuleView<'_>, guarantees: &mut Guarantees) {
    let plan = view.plan();
    let granted = view.partitions().flat_map(|id| {
        let partition = &plan[id];
        partition.devices.iter().map(|device| (partition.name.as_str(), device.as_str()))
    });
    let granted: Vec<_> = granted.filter(|(_, device)| device.contains('/')).collect();
    if let Some(found) = devices_found(&granted) {
        match found {
            Ok(()) => guarantees.held(DEVICES, format!("{} of them", granted.len())),
            Err(why) => guarantees.missing(DEVICES, why),
        }
    }
}

const DEVICES: &str = "the devices that partitions are granted are there";

/// Which of the devices are none here, in words; nothing where there is none to look for.
fn devices_found(granted: &[(&str, &str)]) -> Option<Result<(), String>> {
    let is_root = rustix::process::geteuid().is_root();
    let fault = |&(partition, device): &(&str, &str)| {
        let why = match std::fs::metadata(device) {
            Err(error) => error.to_string(),
            Ok(about) if !about.file_type().is_char_device() && !about.file_type().is_block_device() => {
                "no device".to_owned()
            }
            Ok(about) if is_root && !is_open_to_its_group(&about) => {
                "root alone may open it: give it to a group other than 0 (udev: GROUP=, MODE=\"0660\")"
                    .to_owned()
            }
            Ok(_) => return None,
        };
        Some(format!("`{device}` of `{partition}`: {why}"))
    };
    let faults: Vec<String> = granted.iter().filter_map(fault).collect();
    match faults.as_slice() {
        _ if granted.is_empty() => None,
        [] => Some(Ok(())),
        faults => Some(Err(format!("{}; plug it in, or correct `devices` in the plan", faults.join(", ")))),
    }
}

/// Whether a process that joins the device's group may read or write it. No partition joins group 0.
fn is_open_to_its_group(about: &Metadata) -> bool {
    let may = |bits: u32| about.mode() & bits != 0;
    may(0o006) || (may(0o060) && about.gid() != 0)
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

/// Said only where the plan grants a network.
fn network_limits(guarantees: &mut Guarantees) {
    const PROMISE: &str = "a partition has few sockets and sends to few addresses";
    let probe = || {
        let group = Group::beside_self(&format!("bateleur.probe.{}", std::process::id()))?;
        NetworkLimits::of(&group, MOST_SOCKETS)
    };
    let how = format!(
        "programs for its control group (BPF): {MOST_SOCKETS} datagram sockets, {MOST_ADDRESSES} addresses"
    );
    let mend = "it has as many sockets as descriptors; needs root (CAP_BPF, CAP_NET_ADMIN), control groups of version 2, Linux 5.12 or newer \
                with CONFIG_CGROUP_BPF";
    guarantees.examine(PROMISE, probe(), &how, mend);
}

/// The first user number of this run's partitions, where there are numbers for them. Without mount namespaces they share one user:
/// nothing but its permissions would let each of them to its channels.
fn partition_users(
    is_root: bool,
    namespaces: Namespaces,
    partitions: usize,
    guarantees: &mut Guarantees,
) -> Option<u32> {
    const PROMISE: &str = "what the kernel counts for each user it counts for each partition";
    if namespaces.user {
        // Since Linux 5.14 it counts in each user namespace, and in those above.
        guarantees.held(PROMISE, "a user namespace of its own for each");
        return None;
    }
    if !is_root || !namespaces.mount {
        guarantees
            .missing(PROMISE, "all partitions are one user; needs root and mount namespaces (CAP_SYS_ADMIN)");
        return None;
    }
    if partitions > users::MOST_PARTITIONS {
        let most = users::MOST_PARTITIONS;
        let why =
            format!("all partitions are one user; a plan of at most {most} partitions has numbers for them");
        guarantees.missing(PROMISE, why);
        return None;
    }
    let taken: Vec<u32> = instance::living().iter().filter_map(|run| run.users).collect();
    let first = users::first_of_run(std::process::id(), &taken);
    let user = Users { partitions: Some(first) }.partition(0, false, Vec::new());
    let how = format!("a user number of its own for each, from {first} on, of {}", users::range());
    let mend = format!("a user namespace that maps {}", users::range());
    guarantees.examine(PROMISE, try_walls(Walls::default(), Some(&user)), &how, &mend).map(|()| first)
}

/// A promise that a namespace keeps, and what else may keep it.
struct Shut {
    promise: &'static str,
    by: Namespaces,
    else_by: Option<&'static str>,
}

fn namespaces(user: Option<&User>, filtered: bool, guarantees: &mut Guarantees) -> Namespaces {
    let none = Namespaces::default();
    let by_filters = |how| filtered.then_some(how);
    let all = [
        Shut {
            promise: "a partition sees the file system read-only",
            by: Namespaces { mount: true, ..none },
            else_by: None,
        },
        Shut {
            promise: "a partition has no network unless the plan grants it",
            by: Namespaces { network: true, ..none },
            else_by: by_filters("filters of system calls (seccomp)"),
        },
        Shut {
            promise: "a partition has System V objects and queues of its own",
            by: Namespaces { ipc: true, ..none },
            else_by: by_filters("filters of system calls (seccomp): it has none at all"),
        },
        Shut {
            promise: "a partition has a host name of its own",
            by: Namespaces { uts: true, ..none },
            else_by: by_filters("filters of system calls (seccomp): it can not change the machine's"),
        },
        Shut {
            promise: "a partition can signal nobody else",
            by: Namespaces { pid: true, ..none },
            else_by: rules::hold_signals().then_some("rules about signals (Landlock)"),
        },
    ];
    let mut found = Namespaces::default();
    let try_out = |by| try_walls(Walls { namespaces: by, ..Walls::default() }, user);
    // Most often all are to be had, and one probe says so.
    let all_of_them = Namespaces { mount: true, network: true, ipc: true, uts: true, pid: true, user: false };
    let mut everything = try_out(all_of_them);
    if everything.is_err() && user.is_none() && try_out(Namespaces { user: true, ..all_of_them }).is_ok() {
        found.user = true;
        everything = Ok(());
    }
    let how =
        if found.user { "a namespace of its own, in a user namespace" } else { "a namespace of its own" };
    for Shut { promise, by, else_by } in all {
        let tried = if everything.is_ok() { Ok(()) } else { try_out(by) };
        if tried.is_ok() {
            found.mount |= by.mount;
            found.network |= by.network;
            found.ipc |= by.ipc;
            found.uts |= by.uts;
            found.pid |= by.pid;
        }
        match (tried, else_by) {
            (Err(_), Some(how)) => guarantees.held(promise, how),
            (tried, _) => {
                let mend = "needs root (CAP_SYS_ADMIN), or user namespaces for everybody (`bateleur doctor` says what forbids them)";
                guarantees.examine(promise, tried, how, mend);
            }
        }
    }
    found
}

fn try_walls(walls: Walls<'_>, user: Option<&User>) -> std::io::Result<()> {
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
        walls,
        user: user.cloned(),
        dies_with_starter: true,
    };
    let process = spawn(&request)?;
    bateleur_system::wait::await_any_end(&[process.pidfd.as_fd()], 1_000_000_000);
    match ended(&process).map(|status| status.signal()) {
        Some(Some(signal)) => Err(std::io::Error::other(format!("a probe ended by signal {signal}"))),
        // One that hangs dies with the executive.
        Some(None) | None => Ok(()),
    }
}

/// Whether system calls can be filtered, and whether those that make locks can be counted.
fn filters(user: Option<&User>, guarantees: &mut Guarantees) -> (bool, bool) {
    const PROMISE: &str = "a partition that asks the kernel for what no partition needs is ended";
    const FEW_LOCKS: &str = "a partition has few locks of byte ranges, which no control group counts";
    let filters = Filters::new(&Grants::default());
    let try_out = |locks| {
        let filters = filters.as_ref().map_err(|error| std::io::Error::other(error.to_string()))?;
        try_walls(Walls { filters: Some(filters), locks, ..Walls::default() }, user)
    };
    let counter = LockCounter::start();
    let counted = match &counter {
        Ok(counter) => try_out(Some(LockLimit { counter, calls: 0 })),
        Err(error) => Err(std::io::Error::other(error.to_string())),
    };
    // Most often both are to be had, and one probe says so.
    let filtered = if counted.is_ok() { Ok(()) } else { try_out(None) };
    let mend = "needs a kernel with seccomp filters (CONFIG_SECCOMP_FILTER), on x86-64 or aarch64";
    let filtered = guarantees.examine(PROMISE, filtered, "filters of system calls (seccomp)", mend).is_some();
    let mend = "it has any number; needs Linux 5.5 or newer with seccomp filters";
    let how = "the calls that make them are counted (seccomp notifications)";
    (filtered, guarantees.examine(FEW_LOCKS, counted, how, mend).is_some())
}

fn rules(user: Option<&User>, guarantees: &mut Guarantees) -> bool {
    const PROMISE: &str = "a partition opens no file but those that it was granted";
    let program = std::env::current_exe().unwrap_or_default();
    let granted = Granted { program: &program, channels: &[], devices: &[], files: &[], network: false };
    let tried = rules::make(granted).and_then(|rules| {
        let absent = || std::io::Error::other("this kernel has no Landlock, or it is switched off");
        let rules = rules.ok_or_else(absent)?;
        try_walls(Walls { rules: Some(rules.as_fd()), ..Walls::default() }, user)
    });
    let mend = "Linux 5.13 or newer, with landlock among the security modules (kernel parameter lsm=)";
    guarantees.examine(PROMISE, tried, "rules about files (Landlock)", mend).is_some()
}

fn channels(hidden: bool, ruled: bool, guarantees: &mut Guarantees) {
    const PROMISE: &str = "a partition opens no channel but its own";
    match (hidden, ruled) {
        (true, _) => guarantees.held(PROMISE, "its /dev/shm holds its own channels and nothing else"),
        (false, true) => guarantees.held(PROMISE, "rules about files (Landlock)"),
        (false, false) => guarantees.missing(
            PROMISE,
            "every partition sees all channels; needs root (CAP_SYS_ADMIN), or a kernel with Landlock",
        ),
    }
}

/// A limit that can be set, bytes.
const PROBE_BYTES: u64 = 1 << 20;
const TASKS: &str = "a partition has no more threads and processes than it declared";
/// What is left where no controller counts threads.
const ONE_ONLY: &str = "; one that declared a single thread has no more (seccomp)";
/// What is left where no controller counts a partition's memory.
const PROCESS_ONLY: &str = "each process is limited (RLIMIT_DATA), their sum is not";

fn memory(filtered: bool, guarantees: &mut Guarantees) -> Option<Settled> {
    const PROMISE: &str = "a partition uses no more memory than it was granted";
    let settled = delegation::settle();
    let second = delegation::handed_on();
    let first = Accounts::beside_self(&format!("bateleur.probe.{}", std::process::id()));
    let without = |controller: &str| match &settled {
        Err(error) => error.to_string(),
        Ok(_) => format!("no {controller} controller in cgroup v2, none that may be used in v1"),
    };
    match (second.contains(&"memory"), first.limit_memory(PROBE_BYTES)) {
        (true, _) => guarantees.held(PROMISE, "memory.max of its control group"),
        (false, Ok(())) => guarantees.held(PROMISE, "memory.limit_in_bytes of a control group of version 1"),
        (false, Err(_)) => guarantees.missing(PROMISE, format!("{}; {PROCESS_ONLY}", without("memory"))),
    }
    match (second.contains(&"pids"), first.limit_tasks(1)) {
        (true, _) => guarantees.held(TASKS, "pids.max of its control group"),
        (false, Ok(())) => guarantees.held(TASKS, "pids.max of a control group of version 1"),
        (false, Err(_)) => {
            guarantees.missing(TASKS, format!("{}{}", without("pids"), if filtered { ONE_ONLY } else { "" }))
        }
    }
    let locked = rustix::mm::mlockall(rustix::mm::MlockAllFlags::CURRENT);
    let mend = "a page fault may delay a window; raise the limit of locked memory (ulimit -l)";
    guarantees.examine("the executive's memory stays in place", locked, "locked", mend);
    settled.ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::instance::tests::instance;

    #[test]
    fn a_module_that_lives_on_the_same_processor_is_named_and_others_are_not() {
        let living = [instance(7, &[]), instance(8, &[2]), instance(9, &[1, 3])];
        assert_eq!(taken_by(&[0], &living), None);
        let why = taken_by(&[0, 3, 1], &living).unwrap();
        assert!(why.starts_with("module fcu (PID 9) also uses processor 1: "), "{why}");
    }

    #[test]
    fn a_granted_device_that_is_not_there_or_is_none_is_named_and_words_are_not_looked_for() {
        let why = devices_found(&[("gps", "/dev/null"), ("gps", "/dev/no_such_line"), ("imu", "/etc")]);
        let why = why.unwrap().unwrap_err();
        assert!(
            why.contains("`/dev/no_such_line` of `gps`: No such file")
                && why.contains("`/etc` of `imu`: no device")
        );
        assert!(!why.contains("/dev/null"), "{why}");
        assert_eq!(devices_found(&[("gps", "/dev/null")]), Some(Ok(())));
        assert_eq!(devices_found(&[]), None);
    }
}
