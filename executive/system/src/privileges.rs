//! Work that needs no privileges, done without any; and the privileges that the executive keeps.

#![allow(unsafe_code)]

use std::io;

use rustix::process::{Pid, WaitOptions, waitpid};
use rustix::thread::{
    CapabilitySet, CapabilitySets, capabilities, capability_is_in_bounding_set,
    remove_capability_from_bounding_set, set_capabilities,
};

/// The user and group of nobody, on every Linux.
const NOBODY: libc::uid_t = 65_534;

/// Does `work` as nobody, in a child of this process, where this process is root; else here, where there are no privileges to drop. Gives
/// what it gives. It shares open files with this process and nothing that it does to memory; its code is above 0 where it could not begin.
///
/// To be called before this process has a second thread.
///
/// # Errors
/// There can be no child, or it was ended by a signal.
pub fn without_privileges(work: impl FnOnce() -> u8) -> io::Result<u8> {
    if !rustix::process::geteuid().is_root() {
        return Ok(work());
    }
    // SAFETY: this process has one thread, so that the child's copy of its memory is whole.
    match unsafe { libc::fork() } {
        ..0 => Err(io::Error::last_os_error()),
        0 => {
            let code = if drop_privileges().is_ok() { work() } else { u8::MAX };
            // SAFETY: it ends the child without the parent's clean-up.
            unsafe { libc::_exit(code.into()) }
        }
        child => {
            let child = Pid::from_raw(child).ok_or_else(|| io::Error::other("no child"))?;
            let ended = waitpid(Some(child), WaitOptions::empty())?;
            let code = ended.and_then(|(_, status)| status.exit_status());
            code.and_then(|code| u8::try_from(code).ok())
                .ok_or_else(|| io::Error::other("it was ended by a signal"))
        }
    }
}

fn drop_privileges() -> io::Result<()> {
    let done = |result: libc::c_int| if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) };
    // SAFETY: they take numbers, and no pointer but an empty list.
    unsafe {
        done(libc::setgroups(0, std::ptr::null()))?;
        done(libc::setresgid(NOBODY, NOBODY, NOBODY))?;
        done(libc::setresuid(NOBODY, NOBODY, NOBODY))?;
        done(libc::prctl(libc::PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0))
    }
}

/// The capabilities that the executive uses, each with what for. Where it is root it drops all others at its start, for itself
/// and for whatever it starts.
pub const USED: &[(CapabilitySet, &str, &str)] = &[
    (
        CapabilitySet::SYS_ADMIN,
        "CAP_SYS_ADMIN",
        "namespaces and mounts of partitions; filters of system calls",
    ),
    (
        CapabilitySet::SYS_NICE,
        "CAP_SYS_NICE",
        "real-time priorities and processors of dispatchers and partitions",
    ),
    (CapabilitySet::SYS_RESOURCE, "CAP_SYS_RESOURCE", "limits of partitions above those of the executive"),
    (CapabilitySet::IPC_LOCK, "CAP_IPC_LOCK", "memory that is never paged out"),
    (CapabilitySet::SETUID, "CAP_SETUID", "a user for each partition"),
    (CapabilitySet::SETGID, "CAP_SETGID", "its group"),
    (CapabilitySet::SETPCAP, "CAP_SETPCAP", "to take every capability from a partition"),
    (CapabilitySet::KILL, "CAP_KILL", "signals to processes of other users"),
    (CapabilitySet::CHOWN, "CAP_CHOWN", "channels and logs that belong to partitions and helpers"),
    (CapabilitySet::FOWNER, "CAP_FOWNER", "modes of what partitions own, before it is removed"),
    (CapabilitySet::DAC_OVERRIDE, "CAP_DAC_OVERRIDE", "control groups, and what partitions have closed"),
    (CapabilitySet::SYS_PTRACE, "CAP_SYS_PTRACE", "which program a process of the control group runs"),
    (
        CapabilitySet::NET_ADMIN,
        "CAP_NET_ADMIN",
        "programs in the kernel that bound the network of a partition (before Linux 6.9)",
    ),
    (CapabilitySet::SYSLOG, "CAP_SYSLOG", "what the kernel says of a process that it has ended"),
];

/// The highest number of a capability that this program knows of (Linux 5.9: CAP_CHECKPOINT_RESTORE).
const LAST_CAPABILITY: u32 = 40;

/// Drops every capability but those of [`USED`], for this thread and all that follow it. To be called before there is another one.
///
/// # Errors
/// The kernel refuses it.
pub fn keep_used() -> io::Result<()> {
    let kept = USED.iter().fold(CapabilitySet::empty(), |all, (one, ..)| all | *one);
    let sets = capabilities(None)?;
    if sets.effective.contains(CapabilitySet::SETPCAP) {
        for number in 0..=LAST_CAPABILITY {
            let one = CapabilitySet::from_bits_retain(1 << number);
            if !kept.contains(one) && capability_is_in_bounding_set(one).unwrap_or(false) {
                remove_capability_from_bounding_set(one)?;
            }
        }
    }
    let less = |set: CapabilitySet| set & kept;
    set_capabilities(
        None,
        CapabilitySets {
            effective: less(sets.effective),
            permitted: less(sets.permitted),
            inheritable: CapabilitySet::empty(),
        },
    )?;
    Ok(())
}
