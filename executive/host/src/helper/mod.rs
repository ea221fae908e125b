//! Processes that serve the executive and are not the executive, because they touch what a partition may have
//! damaged, or because they must outlive it: what they are told, and how they begin and end.
//!
//! - holder, cleaner and probe of channels: `executive/channels`;
//! - a [`remover`] removes the directories of channels that were rebuilt, and ends;
//! - the [`guard`] waits for the executive's death and removes everything that it made;
//! - recorder, observers, publishers and the player: `executive/cli`, which knows the messages;
//! - who reads what a dead process has left ([`crash`]): `executive/cli`.

use std::os::fd::AsFd;

use bateleur_system::spawn::Spawned;
use bateleur_system::time::now_ns;
use bateleur_system::wait::{await_any_end, ended};
use rustix::process::{
    Pid, Signal, WaitId, WaitIdOptions, kill_process_group, pidfd_send_signal, test_kill_process_group,
    waitid,
};

pub mod crash;
pub mod guard;
pub mod orders;
pub mod playing;
pub mod recording;
pub mod remover;

/// Names the process that a helper must not outlive, in its environment.
pub const PARENT: &str = "BATELEUR_PARENT";

/// The first thing that a helper does: gives itself a name, and ends where whoever started it is gone already. It has asked for a
/// signal at its parent's death before, which tells nothing of a death before that.
pub fn begin(name: &std::ffi::CStr) {
    let _ = rustix::thread::set_name(name); // a name is a comfort
    let parent = std::env::var(PARENT).ok().and_then(|text| text.parse::<i32>().ok());
    if parent.is_some() && parent != rustix::process::getppid().map(Pid::as_raw_pid) {
        std::process::exit(1);
    }
}

/// Ends a helper that nobody waits for any more, and what it has started: each helper has a session of its own. To be asked before its
/// end is told, which gives its number free.
pub fn end_helper(process: &Spawned) {
    let _ = pidfd_send_signal(&process.pidfd, Signal::KILL); // ended already
    let is_ours = await_any_end(&[process.pidfd.as_fd()], GROUP_PATIENCE_NS) && has_not_been_told(process);
    let Some(group) = Pid::from_raw(process.pid).filter(|_| is_ours) else { return };
    let _ = kill_process_group(group, Signal::KILL); // it has started nothing
    let _ = ended(process);
    let begun_ns = now_ns();
    while test_kill_process_group(group).is_ok() && now_ns() - begun_ns < GROUP_PATIENCE_NS {
        std::thread::sleep(std::time::Duration::from_micros(200));
    }
}

/// How long processes that a helper has started may take to be gone once they are killed.
const GROUP_PATIENCE_NS: u64 = 1_000_000_000;

/// Whether the end of a process has not been told yet, so that no other one can have its number.
fn has_not_been_told(process: &Spawned) -> bool {
    let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
    waitid(WaitId::PidFd(process.pidfd.as_fd()), options).is_ok_and(|status| status.is_some())
}
