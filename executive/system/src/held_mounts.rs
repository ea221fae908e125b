//! Keeps a process's mount namespace longer than the process.
//!
//! Who leaves a mount namespace as the last one unmounts all of it, and waits for the kernel's RCU meanwhile: a process that dies is found
//! dead several milliseconds later. While somebody else holds the namespace, it dies at once.

use std::fs::File;

use super::thread;

/// The mount namespace of a process, if it could be had.
#[derive(Debug, Default)]
pub struct HeldMounts(Option<File>);

impl HeldMounts {
    /// That of the process with this number.
    #[must_use]
    pub fn of(pid: i32) -> Self {
        Self(File::open(format!("/proc/{pid}/ns/mnt")).ok()) // without the right to it, the process waits itself
    }
}

impl Drop for HeldMounts {
    /// A thread waits for the kernel: whoever drops this has a successor to start.
    fn drop(&mut self) {
        if let Some(mounts) = self.0.take() {
            let _ = thread::named("unmount").spawn(move || drop(mounts)); // no thread: the closure is dropped here
        }
    }
}
