//! What a partition's walls are made of: groups, limits, memory, filters.

use super::{Finding, Root, Subject, Tried};
use bateleur_system::delegation;

pub(super) fn findings(root: &Root, subject: &Subject, tried: &Tried) -> Vec<Finding> {
    vec![
        groups(root),
        controllers(root),
        locked_memory(root),
        swap(root),
        descriptors(root, subject),
        shared_memory(tried),
        seccomp(root),
        landlock(tried),
        user_namespaces(root),
    ]
}

/// Where the second version is mounted, and the group of this process in it.
fn own_group(root: &Root) -> Option<(String, String)> {
    let mounts = root.text("proc/self/mounts")?;
    let fields = mounts.lines().map(|line| line.split(' ').collect::<Vec<_>>());
    let mount = fields
        .filter(|fields| fields.get(2) == Some(&"cgroup2"))
        .find_map(|fields| fields.get(1).map(|mount| (*mount).to_owned()))?;
    let groups = root.text("proc/self/cgroup")?;
    let own = groups.lines().find_map(|line| line.strip_prefix("0::/"))?;
    // The executive steps aside into a leaf; its partitions' groups stay beside it.
    let own = own.strip_suffix(delegation::LEAF).unwrap_or(own).trim_end_matches('/');
    let group = format!("{mount}/{own}").trim_end_matches('/').to_owned();
    Some((mount, group))
}

/// What it costs that there are none.
const NO_GROUPS: &str = "a window's end is SIGSTOP to one process: 21 us (median) to 71 us (99 %) past the end, and a child in a session of \
    its own runs on";

/// Whether this process is in a group below the root of a hierarchy that it can not see.
fn is_hidden(root: &Root) -> bool {
    let groups = root.text("proc/self/cgroup").unwrap_or_default();
    groups.lines().any(|line| line.strip_prefix("0::/").is_some_and(|own| !own.is_empty()))
}

fn groups(root: &Root) -> Finding {
    const TOPIC: &str = "control groups";
    match own_group(root) {
        Some((mount, group)) if root.exists(&format!("{group}/cgroup.procs")) => {
            Finding::well(TOPIC, format!("version 2 at {mount}, this process in {group}"))
        }
        None if is_hidden(root) => Finding::lacks(
            TOPIC,
            "the version 2 hierarchy is hidden from this process, as `ip netns exec` does, which mounts /sys anew",
            NO_GROUPS,
            "enter the network namespace by nsenter --net=/run/netns/NAME, or mount it again: mount -t cgroup2 none /sys/fs/cgroup",
        ),
        _ => Finding::lacks(
            TOPIC,
            "no version 2 hierarchy is mounted",
            NO_GROUPS,
            "mkdir -p /sys/fs/cgroup/unified && mount -t cgroup2 none /sys/fs/cgroup/unified; with systemd: systemd.unified_cgroup_hierarchy=1",
        ),
    }
}

fn controllers(root: &Root) -> Finding {
    const TOPIC: &str = "group controllers";
    const COSTS: &str =
        "memory.max does not exist: RLIMIT_DATA limits each process of a partition, not their sum";
    let Some((_, group)) = own_group(root) else {
        return Finding::lacks(
            TOPIC,
            "none, because there are no control groups",
            COSTS,
            "see control groups",
        );
    };
    let has = |file: &str, name: &str| {
        let list = root.text(&format!("{group}/{file}")).unwrap_or_default();
        list.split_whitespace().any(|controller| controller == name)
    };
    let missing: Vec<&str> =
        delegation::CONTROLLERS.into_iter().filter(|name| !has("cgroup.subtree_control", name)).collect();
    if missing.is_empty() {
        return Finding::well(TOPIC, format!("{} for the groups inside", delegation::CONTROLLERS.join(", ")));
    }
    let mounts = root.text("proc/self/mounts").unwrap_or_default();
    let by_first = missing.iter().filter(|name| {
        mounts.lines().map(|line| line.split(' ').collect::<Vec<_>>()).any(|fields| {
            fields.len() > 3 && fields[2] == "cgroup" && fields[3].split(',').any(|word| word == **name)
        })
    });
    if by_first.count() > 0 {
        return Finding::note(
            TOPIC,
            format!("{} held by cgroup version 1, beside version 2", missing.join(", ")),
            "nothing where the executive may make groups there, which the promises below say; else kernel parameter cgroup_no_v1=all, with systemd: systemd.unified_cgroup_hierarchy=1",
        );
    }
    let (there, absent): (Vec<&str>, Vec<&str>) =
        missing.iter().copied().partition(|name| has("cgroup.controllers", name));
    let enable: Vec<String> = there.iter().map(|name| format!("+{name}")).collect();
    let mend = match absent.is_empty() {
        true => format!(
            "echo '{}' > {group}/cgroup.subtree_control (no other process may be in that group itself)",
            enable.join(" ")
        ),
        false => {
            "the group above does not hand them down: systemd: Delegate=yes, or DefaultMemoryAccounting=yes"
                .into()
        }
    };
    Finding::lacks(TOPIC, format!("{} not enabled in {group}", missing.join(", ")), COSTS, mend)
}

const CAP_IPC_LOCK: u32 = 14;
/// What the executive keeps in memory, with room to spare, bytes.
const LOCKED_BYTES: u64 = 64 << 20;

fn locked_memory(root: &Root) -> Finding {
    const TOPIC: &str = "locked memory";
    let limit = root.limit("Max locked memory").unwrap_or(0);
    if root.has_capability(CAP_IPC_LOCK) || limit >= LOCKED_BYTES {
        return Finding::well(TOPIC, "as much as is needed");
    }
    Finding::lacks(
        TOPIC,
        format!("at most {} KiB", limit / 1024),
        "pages of the executive and of partitions may leave memory: a fault in a window takes microseconds, with swap milliseconds",
        "ulimit -l unlimited; LimitMEMLOCK=infinity in a unit; `* - memlock unlimited` in /etc/security/limits.d/bateleur.conf",
    )
}

fn swap(root: &Root) -> Finding {
    const TOPIC: &str = "swap";
    let areas = root.text("proc/swaps").unwrap_or_default().lines().skip(1).count();
    match areas {
        0 => Finding::well(TOPIC, "none"),
        _ => Finding::lacks(
            TOPIC,
            format!("{areas} area(s)"),
            "memory of a partition that was quiet for long may be on the disk: milliseconds in its next window",
            "swapoff -a, and the line in /etc/fstab",
        ),
    }
}

/// Descriptors for each port below iceoryx2, and what a process has beside them.
const FOR_EACH_PORT: u64 = 10;
const BESIDE: u64 = 64;

fn descriptors(root: &Root, subject: &Subject) -> Finding {
    const TOPIC: &str = "descriptors";
    let needed = subject.ports as u64 * FOR_EACH_PORT + BESIDE;
    let limit = root.limit("Max open files").unwrap_or(0);
    if limit >= needed {
        return Finding::well(TOPIC, format!("{limit}, about {needed} needed at most"));
    }
    Finding::lacks(
        TOPIC,
        format!("{limit} for a process, where {} ports may need {needed}", subject.ports),
        "channels can not be created or opened: the module does not start",
        format!("ulimit -n {needed}; LimitNOFILE={needed} in a unit"),
    )
}

/// Shared memory of a recorded flight with nine partitions, about twice, bytes.
const SHARED_BYTES: u64 = 16 << 20;

fn shared_memory(tried: &Tried) -> Finding {
    const TOPIC: &str = "/dev/shm";
    let mend = "mount -o remount,size=64M /dev/shm (containers: --shm-size=64m)";
    match tried.shared_memory_bytes {
        Some(bytes) if bytes >= SHARED_BYTES => Finding::well(TOPIC, format!("{} MiB free", bytes >> 20)),
        Some(bytes) => Finding::lacks(
            TOPIC,
            format!("{} KiB free", bytes >> 10),
            "a module with nine recorded partitions needs 5 to 9 MiB: channels can not be created",
            mend,
        ),
        None => Finding::lacks(TOPIC, "not there", "no channel can be created: nothing runs", mend),
    }
}

fn seccomp(root: &Root) -> Finding {
    const TOPIC: &str = "seccomp";
    let actions = root.text("proc/sys/kernel/seccomp/actions_avail").unwrap_or_default();
    match actions.split_whitespace().any(|action| action == "kill_process") {
        true => Finding::well(TOPIC, actions),
        false => Finding::lacks(
            TOPIC,
            "not in this kernel",
            "no filter can keep a partition from a system call",
            "a kernel with CONFIG_SECCOMP_FILTER",
        ),
    }
}

/// Switches that keep an ordinary user from user namespaces: file, the value that forbids, and what to do.
const USER_NAMESPACE_SWITCHES: [(&str, &str, &str); 3] = [
    ("proc/sys/user/max_user_namespaces", "0", "sysctl user.max_user_namespaces=65536"),
    ("proc/sys/kernel/unprivileged_userns_clone", "0", "sysctl kernel.unprivileged_userns_clone=1"),
    (
        "proc/sys/kernel/apparmor_restrict_unprivileged_userns",
        "1",
        "an AppArmor profile with `userns,` for the program, or sysctl kernel.apparmor_restrict_unprivileged_userns=0",
    ),
];

fn user_namespaces(root: &Root) -> Finding {
    const TOPIC: &str = "user namespaces";
    const COSTS: &str = "without root, partitions share the file system, the network and the processes of whoever starts them, as far as the rules below allow";
    if !root.exists("proc/self/ns/user") {
        return Finding::lacks(
            TOPIC,
            "not in this kernel",
            COSTS,
            "a kernel with CONFIG_USER_NS; or start as root",
        );
    }
    let is = |file: &str, value: &str| root.text(file).is_some_and(|text| text.trim() == value);
    match USER_NAMESPACE_SWITCHES.iter().find(|(file, value, _)| is(file, value)) {
        Some((file, value, mend)) => {
            let name = file.trim_start_matches("proc/sys/").replace('/', ".");
            Finding::lacks(TOPIC, format!("{name} is {value}"), COSTS, format!("{mend}; or start as root"))
        }
        None => Finding::well(TOPIC, "an ordinary user may make them"),
    }
}

fn landlock(tried: &Tried) -> Finding {
    const TOPIC: &str = "Landlock";
    match tried.landlock {
        Some(version) => Finding::well(TOPIC, format!("interface {version}")),
        None => Finding::lacks(
            TOPIC,
            "not in this kernel, or switched off",
            "a partition's file system can only be narrowed by mounts, which need root",
            "a kernel with CONFIG_SECURITY_LANDLOCK, and landlock in the parameter lsm=",
        ),
    }
}
