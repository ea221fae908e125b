//! Work that needs no privileges, done without any.

#![allow(unsafe_code)]

use std::fs::File;
use std::io;

use rustix::process::{Pid, WaitOptions, waitpid};

/// The user and group of nobody, on every Linux.
const NOBODY: libc::uid_t = 65_534;

/// Does `work` as nobody, in a child of this process, where this process is root; else here, where there is nothing to lay down. Gives
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
            let code = if lay_down().is_ok() { work() } else { u8::MAX };
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

fn lay_down() -> io::Result<()> {
    let done = |result: libc::c_int| if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) };
    // SAFETY: they take numbers, and no pointer but an empty list.
    unsafe {
        done(libc::setgroups(0, std::ptr::null()))?;
        done(libc::setresgid(NOBODY, NOBODY, NOBODY))?;
        done(libc::setresuid(NOBODY, NOBODY, NOBODY))?;
        done(libc::prctl(libc::PR_SET_NO_NEW_PRIVS, 1, 0, 0, 0))
    }
}

/// A file in memory that is handed to the next program: it outlives `exec`.
///
/// # Errors
/// There is no memory for it.
pub fn handed_on(name: &str) -> io::Result<File> {
    Ok(File::from(rustix::fs::memfd_create(name, rustix::fs::MemfdFlags::empty())?))
}
