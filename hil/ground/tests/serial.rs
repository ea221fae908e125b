//! The line over a pseudo-terminal, as a serial device.

#![allow(clippy::unwrap_used, reason = "a panic here is a failed test")]

use bateleur_ground::Link;
use bateleur_messages::ground::Order;
use bateleur_messages::telemetry::{Telemetry, Voltages};
use bateleur_messages::{TelemetryMessage, frame};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use std::fs::File;
use std::io::{Read, Write};
use std::path::PathBuf;
use std::time::{Duration, Instant};

fn pseudo_terminal() -> (File, PathBuf) {
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let name = ptsname(&master, Vec::new()).unwrap();
    (File::from(master), PathBuf::from(name.to_str().unwrap()))
}

/// A message whose bytes hold all that a terminal in line mode would swallow: ends, erasures, interrupts.
fn awkward() -> Telemetry {
    Telemetry::Voltages(Voltages {
        time_ns: u64::from_le_bytes([3, 4, 8, 10, 13, 17, 19, 26]),
        main_v: f64::from_le_bytes([0x7f, 0x1c, 0x15, 0x16, 0x0d, 0x0a, 0x24, 0x40]),
        ..Voltages::default()
    })
}

#[test]
fn every_byte_passes_in_both_directions() {
    let (mut aircraft, device) = pseudo_terminal();
    let mut link = Link::serial(&device, 115_200).unwrap();
    let message = TelemetryMessage::of(&awkward());
    let mut bytes = Vec::new();
    frame::encode(message.letter, message.bytes(), &mut bytes);
    aircraft.write_all(&bytes).unwrap();

    let (mut heard, limit) = (Vec::new(), Instant::now() + Duration::from_secs(5));
    while heard.is_empty() && Instant::now() < limit {
        link.receive(|telemetry| heard.push(telemetry)).unwrap();
    }
    assert_eq!(heard, [awkward()]);

    link.send(&Order::InitialiseSensors { sensors: 3 }).unwrap();
    let mut order = [0; 6];
    aircraft.read_exact(&mut order).unwrap();
    assert_eq!(order, [b'$', b'I', b'I', 3, b'*', 3]);
    assert_eq!((link.bytes_received(), link.bytes_sent()), (bytes.len() as u64, 6));
}

#[test]
fn terminal_whose_other_end_is_vacant_is_waited_for() {
    let (master, device) = pseudo_terminal();
    let mut link = Link::new(master).unwrap();
    drop(File::open(&device).unwrap());
    link.receive(|_| ()).unwrap();
}
