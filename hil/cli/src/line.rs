//! The serial line between the ground station and the aircraft: a pseudo-terminal.

use std::fs::File;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use bateleur_ground::Link;
use bateleur_system::users::HELPERS;
use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};

/// How long bytes that were written may take to arrive, real time: the kernel hands them on from a work queue.
const PATIENCE: Duration = Duration::from_secs(2);

/// Lets partitions that were granted the terminal at `path` open it: by its group, which a granted partition joins.
pub(crate) fn grant_terminal(path: &Path) -> Result<()> {
    let grant = || {
        std::os::unix::fs::chown(path, None, Some(HELPERS))?;
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o660))
    };
    match rustix::process::geteuid().is_root() {
        true => grant().with_context(|| format!("cannot grant the terminal {}", path.display())),
        false => Ok(()),
    }
}

/// Both ends of the line.
pub(crate) struct Line {
    /// What the aircraft's end is called.
    pub(crate) device: String,
    /// The ground's end.
    pub(crate) link: Link,
    ground: OwnedFd,
    /// Kept open, so that the line stays when the aircraft's process restarts.
    aircraft: OwnedFd,
}

impl Line {
    pub(crate) fn open() -> Result<Self> {
        Self::make().context("cannot make a pseudo-terminal for the ground station's line")
    }

    fn make() -> Result<Self> {
        let ground = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
        grantpt(&ground)?;
        unlockpt(&ground)?;
        let device = ptsname(&ground, Vec::new())?.into_string()?;
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
        let aircraft = rustix::fs::open(device.as_str(), flags, Mode::empty())?;
        let mut settings = tcgetattr(&aircraft)?;
        settings.make_raw();
        tcsetattr(&aircraft, OptionalActions::Now, &settings)?;
        grant_terminal(Path::new(&device))?;
        let link = Link::new(File::from(ground.try_clone()?))?;
        Ok(Self { device, link, ground, aircraft })
    }

    /// The ground's end, and the aircraft's to be kept open.
    pub(crate) fn into_link(self) -> (Link, OwnedFd) {
        (self.link, self.aircraft)
    }

    /// Waits until all of the `sent` bytes that the aircraft has written so far can be read: in virtual time it must
    /// not matter how fast the kernel carries them.
    pub(crate) fn await_bytes(&self, sent: u64) {
        let begun = Instant::now();
        while self.arrived() < sent && begun.elapsed() < PATIENCE {
            std::thread::yield_now();
        }
    }

    fn arrived(&self) -> u64 {
        let waiting = rustix::io::ioctl_fionread(self.ground.as_fd()).unwrap_or(0);
        self.link.bytes_received() + waiting
    }
}
