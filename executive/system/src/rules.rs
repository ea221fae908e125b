//! Which files a partition may open (Landlock): made before there is a process, applied between `clone3` and its program.
//!
//! Unlike namespaces it needs no privileges. Each partition is a domain of its own, so it can neither look into another's
//! process nor signal it, and it opens nothing but what is named here. It must never be the only thing that keeps a
//! secret: what was opened before stays open, and a file's name and size can still be asked for.
#![allow(unsafe_code)]

use std::io;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};

use landlock::{
    ABI, Access, AccessFs, AccessNet, BitFlags, CompatLevel, Compatible, PathBeneath, PathFd, Ruleset,
    RulesetAttr, RulesetCreated, RulesetCreatedAttr, RulesetError, Scope,
};

/// What a partition is granted.
#[derive(Debug, Clone, Copy)]
pub struct Granted<'a> {
    /// Its program.
    pub program: &'a Path,
    /// Directories that it may write.
    pub channels: &'a [PathBuf],
    /// Devices.
    pub devices: &'a [PathBuf],
    /// Files that it may read.
    pub files: &'a [PathBuf],
    /// Whether it may open connections.
    pub network: bool,
}

/// The newest interface that was tried; what an older kernel does not know is left out.
const INTERFACE: ABI = ABI::V7;

/// Where a dynamic program's libraries lie, its loader among them.
const LIBRARIES: &[&str] =
    &["/lib", "/lib64", "/usr/lib", "/usr/lib64", "/usr/local/lib", "/nix/store", "/gnu/store"];
/// What the C library reads: of the system, nothing of a person's.
const READABLE: &[&str] = &[
    "/etc/ld.so.cache",
    "/etc/ld.so.preload",
    "/etc/localtime",
    "/usr/share/zoneinfo",
    "/usr/share/locale",
    "/etc/nsswitch.conf",
    "/proc/meminfo",
    "/proc/cpuinfo",
    "/proc/stat",
    "/proc/uptime",
    "/proc/version",
    "/proc/sys/kernel/osrelease",
    "/proc/sys/kernel/pid_max",
    "/proc/sys/kernel/cap_last_cap",
    "/proc/sys/kernel/random/boot_id",
    "/proc/sys/vm/overcommit_memory",
    "/proc/sys/vm/max_map_count",
    "/sys/devices/system/cpu/online",
    "/sys/devices/system/cpu/possible",
    "/dev/urandom",
    "/dev/random",
];
/// What it reads to find a host.
const RESOLVER: &[&str] =
    &["/etc/hosts", "/etc/host.conf", "/etc/resolv.conf", "/etc/gai.conf", "/etc/services", "/etc/protocols"];
const ORDINARY_DEVICES: &[&str] = &["/dev/null", "/dev/zero", "/dev/full"];

/// The rules for `granted`; `None` if the kernel has no Landlock.
///
/// # Errors
/// The kernel refused a rule.
pub fn make(granted: Granted<'_>) -> io::Result<Option<OwnedFd>> {
    build(granted).map(Into::into).map_err(|error| io::Error::other(format!("no Landlock rules: {error}")))
}

/// Whether the kernel keeps signals within a partition (since Linux 6.12).
#[must_use]
pub fn hold_signals() -> bool {
    let strict = Ruleset::default().set_compatibility(CompatLevel::HardRequirement);
    strict.scope(Scope::Signal).and_then(Ruleset::create).is_ok()
}

fn build(granted: Granted<'_>) -> Result<RulesetCreated, RulesetError> {
    let mut rules =
        Ruleset::default().handle_access(AccessFs::from_all(INTERFACE))?.scope(Scope::from_all(INTERFACE))?;
    if !granted.network {
        rules = rules.handle_access(AccessNet::from_all(INTERFACE))?;
    }
    let read = AccessFs::ReadFile | AccessFs::ReadDir;
    let execute = read | AccessFs::Execute;
    let device = AccessFs::ReadFile | AccessFs::WriteFile | AccessFs::IoctlDev;
    let channel = AccessFs::from_all(INTERFACE) & !(AccessFs::Execute | AccessFs::IoctlDev | NODES);
    let paths = |list: &'static [&'static str]| list.iter().map(Path::new).collect::<Vec<_>>();
    let mut all: Vec<(&Path, BitFlags<AccessFs>)> = vec![(granted.program, execute)];
    all.extend(paths(LIBRARIES).into_iter().map(|path| (path, execute)));
    all.extend(paths(READABLE).into_iter().map(|path| (path, read)));
    if granted.network {
        all.extend(paths(RESOLVER).into_iter().map(|path| (path, read)));
    }
    all.extend(paths(ORDINARY_DEVICES).into_iter().map(|path| (path, device)));
    all.extend(granted.files.iter().map(|path| (path.as_path(), read)));
    all.extend(granted.channels.iter().map(|path| (path.as_path(), channel)));
    let devices: Vec<PathBuf> = granted.devices.iter().map(|path| place_of_device(path)).collect();
    all.extend(devices.iter().map(|path| (path.as_path(), device)));
    let mut rules = rules.create()?;
    for (path, access) in all {
        // What is not on this machine needs no rule.
        let Ok(place) = PathFd::new(path) else { continue };
        let access = if path.is_dir() { access } else { access & AccessFs::from_file(INTERFACE) };
        rules = rules.add_rule(PathBeneath::new(place, access))?;
    }
    Ok(rules)
}

/// Special files, which no channel holds.
const NODES: BitFlags<AccessFs> =
    landlock::make_bitflags!(AccessFs::{MakeChar | MakeBlock | MakeFifo | MakeSym | Refer});

/// What a rule for a device is about: a rule holds for a file, and a line that is plugged in anew is another file. So it is
/// about the folder, unless that is `/dev` itself with all that the machine has.
fn place_of_device(device: &Path) -> PathBuf {
    let place = device.canonicalize().unwrap_or_else(|_| device.to_owned());
    match place.parent() {
        Some(folder) if folder != Path::new("/dev") && folder.starts_with("/dev") => folder.to_owned(),
        _ => place,
    }
}

/// Kind of rule, `LANDLOCK_RULE_PATH_BENEATH`.
const PATH_BENEATH: libc::c_ulong = 1;
/// Bits of `AccessFs::ReadFile` and `AccessFs::ReadDir`.
const READ: u64 = 1 << 2 | 1 << 3;

/// A rule as the kernel reads it.
#[repr(C, packed)]
struct Beneath {
    access: u64,
    parent: i32,
}

/// Puts the rules behind `rules` on the calling thread, with one that only it can make: it may read what the kernel tells
/// about itself. False: refused, as `errno` says.
///
/// # Safety
/// For a child between `clone3` and its program, which has given up gaining privileges.
pub(super) unsafe fn apply(rules: i32) -> bool {
    let none: libc::c_ulong = 0;
    // SAFETY: system calls on a constant string and a local structure.
    unsafe {
        let own = libc::open(c"/proc/self".as_ptr(), libc::O_PATH | libc::O_CLOEXEC);
        if own >= 0 {
            let rule = Beneath { access: READ, parent: own };
            libc::syscall(libc::SYS_landlock_add_rule, rules, PATH_BENEATH, &raw const rule, none);
            libc::close(own);
        }
        libc::syscall(libc::SYS_landlock_restrict_self, rules, none) == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_below_a_folder_of_its_own_is_granted_with_the_folder_and_one_in_dev_alone() {
        assert_eq!(place_of_device(Path::new("/dev/pts/999999")), Path::new("/dev/pts"));
        assert_eq!(place_of_device(Path::new("/dev/ttyUSB99")), Path::new("/dev/ttyUSB99"));
        assert_eq!(place_of_device(Path::new("/srv/line")), Path::new("/srv/line"));
    }

    #[test]
    fn rules_are_made_where_the_kernel_has_them() {
        let program = std::env::current_exe().unwrap();
        let granted = Granted { program: &program, channels: &[], devices: &[], files: &[], network: false };
        assert!(make(granted).is_ok());
    }
}
