//! What a service manager is told (sd_notify(3), `Type=notify` and `WatchdogSec` of systemd): that the service is up, and that it lives.
//!
//! Each word is a datagram to the socket that the environment names. Nobody waits for an answer, and a manager that is gone costs nothing.

use std::ffi::OsStr;
use std::io;
use std::os::linux::net::SocketAddrExt;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::net::{SocketAddr, UnixDatagram};

/// Where the manager listens.
const SOCKET: &str = "NOTIFY_SOCKET";
/// After how long without a sign of life it ends the service, us; and of which process that is expected.
const WATCHDOG: (&str, &str) = ("WATCHDOG_USEC", "WATCHDOG_PID");

/// The manager of the service that this process is; nobody where nobody started it as one.
#[derive(Debug, Default)]
pub struct ServiceManager {
    socket: Option<UnixDatagram>,
    /// Between two signs of life, ns; `None` where none is expected.
    period_ns: Option<u64>,
    next_ns: u64,
    is_ready: bool,
}

impl ServiceManager {
    /// The one that the environment names.
    #[must_use]
    pub fn from_environment() -> Self {
        let Some(name) = std::env::var_os(SOCKET) else { return Self::default() };
        let number = |name| std::env::var(name).ok()?.parse::<u64>().ok();
        let is_own = number(WATCHDOG.1).is_none_or(|pid| pid == u64::from(std::process::id()));
        let watchdog_us = number(WATCHDOG.0).filter(|us| is_own && *us > 0);
        // A manager that can not be reached is none.
        Self::at(&name, watchdog_us).unwrap_or_default()
    }

    fn at(name: &OsStr, watchdog_us: Option<u64>) -> io::Result<Self> {
        let address = match name.as_bytes() {
            [b'@', name @ ..] => SocketAddr::from_abstract_name(name)?,
            [b'/', ..] => SocketAddr::from_pathname(name)?,
            _ => return Err(io::ErrorKind::Unsupported.into()),
        };
        let socket = UnixDatagram::unbound()?;
        socket.set_nonblocking(true)?;
        socket.connect_addr(&address)?;
        // Twice in the time that it waits, as the manager's own manual has it.
        let period_ns = watchdog_us.map(|us| us.saturating_mul(1000) / 2);
        Ok(Self { socket: Some(socket), period_ns, next_ns: 0, is_ready: false })
    }

    /// The service is up, which is told once, and lives, which is told as often as it is expected. `now_ns`: of CLOCK_MONOTONIC.
    pub fn lives(&mut self, now_ns: u64) {
        if !std::mem::replace(&mut self.is_ready, true) {
            self.tell("READY=1");
        }
        self.waits(now_ns);
    }

    /// The service lives, and is not up yet, or not at the moment.
    pub fn waits(&mut self, now_ns: u64) {
        let Some(period_ns) = self.period_ns.filter(|_| now_ns >= self.next_ns) else { return };
        self.next_ns = now_ns + period_ns;
        self.tell("WATCHDOG=1");
    }

    /// What the service is at, for a person.
    pub fn is_at(&self, status: &str) {
        self.tell(&format!("STATUS={}", status.replace('\n', " ")));
    }

    /// The service ends.
    pub fn ends(&self) {
        self.tell("STOPPING=1");
    }

    fn tell(&self, words: &str) {
        if let Some(socket) = &self.socket {
            let _ = socket.send(words.as_bytes()); // a manager that is gone or does not read needs no word
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A manager's socket, and what has come there.
    fn heard(socket: &UnixDatagram) -> Vec<String> {
        socket.set_nonblocking(true).unwrap();
        let mut bytes = [0; 256];
        let next =
            || socket.recv(&mut bytes).ok().map(|count| String::from_utf8(bytes[..count].into()).unwrap());
        std::iter::from_fn(next).collect()
    }

    #[test]
    fn manager_hears_once_that_the_service_is_up_and_twice_in_its_time_that_it_lives() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notify");
        let socket = UnixDatagram::bind(&path).unwrap();
        let mut manager = ServiceManager::at(path.as_os_str(), Some(1_000_000)).unwrap();
        manager.waits(1);
        assert_eq!(heard(&socket), ["WATCHDOG=1"], "it lives while it starts");
        manager.lives(2);
        manager.lives(3);
        assert_eq!(heard(&socket), ["READY=1"]);
        manager.lives(500_000_001);
        manager.is_at("one\ntwo");
        manager.ends();
        assert_eq!(heard(&socket), ["WATCHDOG=1", "STATUS=one two", "STOPPING=1"]);
    }

    #[test]
    fn manager_without_a_watchdog_hears_no_sign_of_life_and_one_that_is_gone_costs_nothing() {
        let name = format!("bateleur-test-{}", std::process::id());
        let address = SocketAddr::from_abstract_name(&name).unwrap();
        let socket = UnixDatagram::bind_addr(&address).unwrap();
        let mut manager = ServiceManager::at(OsStr::new(&format!("@{name}")), None).unwrap();
        manager.lives(1);
        manager.lives(u64::MAX);
        assert_eq!(heard(&socket), ["READY=1"]);
        drop(socket);
        manager.ends();
        assert!(ServiceManager::at(OsStr::new("vsock:2"), None).is_err());
        let mut nobody = ServiceManager::default();
        nobody.lives(1);
    }
}
