//! Properties that only trying shows.
#![allow(unsafe_code)] // one system call without a wrapper

use bateleur_host::guarantee::Guarantee;

/// The result of trying.
#[derive(Debug, Clone, Default)]
pub(crate) struct Tried {
    /// Version of Landlock's interface; `None` if the kernel has none, or it is switched off.
    pub(crate) landlock: Option<u32>,
    /// Bytes that fit into `/dev/shm`.
    pub(crate) shared_memory_bytes: Option<u64>,
    /// What a run here could promise.
    pub(crate) promises: Vec<Guarantee>,
}

impl Tried {
    /// On this machine; `promises` from [`crate::machine::Machine::examine`].
    #[must_use]
    pub(crate) fn here(promises: &[Guarantee]) -> Self {
        let room = rustix::fs::statvfs("/dev/shm").ok();
        Self {
            landlock: landlock(),
            shared_memory_bytes: room.map(|room| room.f_bavail.saturating_mul(room.f_frsize)),
            promises: promises.to_vec(),
        }
    }
}

/// `landlock_create_ruleset` with this flag gives the version instead of a rule set.
const CREATE_RULESET_VERSION: libc::c_long = 1;

fn landlock() -> Option<u32> {
    let nothing: libc::c_long = 0;
    // SAFETY: with this flag the call takes no structure (null, length 0) and makes nothing.
    let version =
        unsafe { libc::syscall(libc::SYS_landlock_create_ruleset, nothing, nothing, CREATE_RULESET_VERSION) };
    u32::try_from(version).ok().filter(|version| *version > 0)
}
