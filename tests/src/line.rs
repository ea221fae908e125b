//! The ground's end of a serial line.

use std::fs::File;
use std::io::{Read, Write};
use std::os::fd::OwnedFd;
use std::os::unix::fs::PermissionsExt;
use std::time::Duration;

use bateleur_messages::frame::{Decoder, encode};
use bateleur_messages::ground::Order;
use bateleur_messages::telemetry::{Acknowledge, Telemetry};
use rustix::fs::{OFlags, fcntl_setfl};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};

/// A ground station of the barest kind. The line vanishes when it is dropped.
#[derive(Debug)]
pub struct Ground {
    /// The name of the aircraft's end.
    pub device: String,
    line: File,
    decoder: Decoder,
}

impl Ground {
    /// A new line that everybody may open.
    pub fn open() -> Self {
        let line: OwnedFd = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
        grantpt(&line).unwrap();
        unlockpt(&line).unwrap();
        fcntl_setfl(&line, OFlags::NONBLOCK).unwrap();
        let device = ptsname(&line, Vec::new()).unwrap().into_string().unwrap();
        std::fs::set_permissions(&device, std::fs::Permissions::from_mode(0o666)).unwrap();
        Self { device, line: line.into(), decoder: Decoder::new() }
    }

    /// Sends bytes as they are.
    pub fn send(&mut self, bytes: &[u8]) {
        self.line.write_all(bytes).unwrap();
    }

    /// Sends an order.
    pub fn order(&mut self, order: &Order) {
        let mut bytes = Vec::new();
        encode(order.letter(), &order.data(), &mut bytes);
        self.send(&bytes);
    }

    /// The bytes that the aircraft sent since.
    pub fn bytes(&mut self) -> Vec<u8> {
        let mut bytes = vec![0; 4096];
        let count = self.line.read(&mut bytes).unwrap_or(0); // nothing there yet
        bytes.truncate(count);
        bytes
    }

    /// What the aircraft sent since.
    pub fn receive(&mut self) -> Vec<Telemetry> {
        let mut bytes = [0; 4096];
        let count = self.line.read(&mut bytes).unwrap_or(0); // nothing there yet
        self.decoder.extend(&bytes[..count]).filter_map(|frame| Telemetry::of(&frame).ok()).collect()
    }

    /// The next answer to an order.
    pub fn await_answer(&mut self, limit: Duration) -> Option<Acknowledge> {
        crate::await_some(limit, || {
            self.receive().into_iter().find_map(|item| match item {
                Telemetry::Acknowledge(answer) => Some(answer),
                _ => None,
            })
        })
    }
}
