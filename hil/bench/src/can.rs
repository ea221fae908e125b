//! Figures of the CAN gateway, beside raw datagrams of the same bytes, taken in turn on the same core.

use std::net::{SocketAddr, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use anyhow::{Context, Result};
use bateleur_can_core::bus::bits::{Rates, bits};
use bateleur_can_core::bus::memory::{MemoryBus, Node, Wire};
use bateleur_can_core::{Frame, Gateway, Id, Settings as GatewaySettings, State};
use bateleur_system::time::now_ns;

use super::Settings;
use super::probe;
use super::row::{Reach, Row};
use super::statistics::quantile;

/// Frames of one measurement of latency.
const FRAMES: usize = 20_000;
/// Frames of one measurement of throughput.
const MANY: usize = 500_000;
/// How long an echo is waited for.
const PATIENCE: Duration = Duration::from_secs(5);

/// Latency and throughput.
pub(super) fn rows(settings: &Settings) -> Result<Vec<Row>> {
    let frames = if settings.quick { FRAMES / 20 } else { FRAMES * settings.runs };
    let many = if settings.quick { MANY / 20 } else { MANY };
    let (out, back, most) = probe::on_core(settings.core, probe::PARTITION, move || {
        anyhow::Ok((bus_to_network(frames)?, bus_to_bus(frames)?, throughput(many)?))
    })??;
    let mut rows = Vec::new();
    for (what, at, reach) in [("p50", 0.5, Reach::Times(2.0)), ("p99.9", 0.999, Reach::Times(2.0))] {
        let (gateway, raw) = both(&out, at)?;
        let about = "send_to of the same bytes, in turn with it";
        rows.push(Row::measured(
            format!("CAN frame in to datagram out, {what}"),
            "us",
            gateway,
            Some(raw),
            reach,
            about,
        ));
    }
    for (what, at, reach) in [("p50", 0.5, Reach::Stated), ("p99.9", 0.999, Reach::Times(3.0))] {
        let (gateway, raw) = both(&back, at)?;
        let about = "the same bytes there and back over UDP alone, in turn with it";
        rows.push(Row::measured(
            format!("bus to bus and back over two gateways, {what}"),
            "us",
            gateway,
            Some(raw),
            reach,
            about,
        ));
    }
    let full = full_bus();
    let about = "frames a second of a full bus at 800 kbit/s";
    rows.push(Row::measured(
        "CAN frames through one core",
        "frames/s",
        most,
        Some(full),
        Reach::AtLeast(20.0 * full),
        about,
    ));
    Ok(rows)
}

/// A quantile of either, µs.
fn both(times: &[Vec<f64>; 2], share: f64) -> Result<(f64, f64)> {
    let of = |times: &[f64]| quantile(times, share).context("nothing was measured");
    Ok((of(&times[0])? * 1e-3, of(&times[1])? * 1e-3))
}

fn frame(number: usize) -> Frame {
    Frame::classic(Id::Standard(0x123), &(number as u64).to_le_bytes())
}

/// Frames a second on a full bus at 800 kbit/s, with data like those that are measured.
fn full_bus() -> f64 {
    let lasts_ns: u64 =
        (0..1_000).map(|number| bits(&frame(number)).duration_ns(Rates::classic(800_000))).sum();
    1e12 / lasts_ns as f64
}

fn socket() -> Result<UdpSocket> {
    let socket = UdpSocket::bind("127.0.0.1:0").context("no datagrams on this machine")?;
    socket.set_read_timeout(Some(PATIENCE))?;
    Ok(socket)
}

/// Two gateways at these addresses that have found each other; how is not measured.
fn acquainted(sockets: [&UdpSocket; 2]) -> Result<[Gateway; 2]> {
    let addresses = [sockets[0].local_addr()?, sockets[1].local_addr()?];
    let mut gateways = [0, 1].map(|place| {
        let mut gateway = Gateway::new(GatewaySettings::new(place as u64 + 1, 1, vec![addresses[1 - place]]));
        gateway.address_is_ready(0);
        gateway
    });
    for turn in 0..8 {
        let (from, mut sent) = (turn % 2, Vec::new());
        gateways[from].run(1, &mut |_, bytes| {
            sent.push(bytes.to_vec());
            true
        });
        for bytes in &sent {
            gateways[1 - from].take_datagram(bytes, addresses[from], 1, |_, _| ());
        }
    }
    let met = gateways.iter().all(|gateway| gateway.state() == State::Forward);
    anyhow::ensure!(met, "two gateways did not find each other");
    Ok(gateways)
}

/// From a frame that waits at the controller until the system has its datagram, and the datagram alone, ns each.
fn bus_to_network(frames: usize) -> Result<[Vec<f64>; 2]> {
    let (from, to) = (socket()?, socket()?);
    to.set_nonblocking(true)?;
    let [mut gateway, _] = acquainted([&from, &to])?;
    let mut bytes = Vec::new();
    let mut times = [Vec::with_capacity(frames), Vec::with_capacity(frames)];
    let address = to.local_addr()?;
    let mut wire = Bus::new();
    for number in 0..frames {
        wire.put(&frame(number));
        let begun = now_ns();
        let Some(frame) = wire.get() else { continue };
        gateway.take_frame(&frame, 2);
        gateway.run(2, &mut |to, sent| {
            let taken = from.send_to(sent, to).is_ok();
            bytes.clear();
            bytes.extend_from_slice(sent);
            taken
        });
        let between = now_ns();
        let _ = from.send_to(&bytes, address); // counted by its time
        let end = now_ns();
        times[0].push((between - begun) as f64);
        times[1].push((end - between) as f64);
        let mut heard = [0; 2_048];
        while to.recv_from(&mut heard).is_ok() {}
    }
    Ok(times)
}

/// A bus in memory whose time does not count.
struct Bus {
    bus: MemoryBus,
    gateway: Node,
    other: Node,
}

impl Bus {
    fn new() -> Self {
        let mut bus = MemoryBus::new(Wire::new(Rates::classic(800_000)));
        let (gateway, other) = (bus.attach(), bus.attach());
        Self { bus, gateway, other }
    }

    /// The other node says a frame.
    fn put(&mut self, frame: &Frame) {
        self.bus.send(self.other, frame);
        self.pass();
    }

    /// The gateway's controller has one.
    fn get(&mut self) -> Option<Frame> {
        self.bus.receive(self.gateway).map(|(_, frame)| frame)
    }

    /// The gateway writes one; gives what the other node hears.
    fn write(&mut self, frame: &Frame) -> Option<Frame> {
        self.bus.send(self.gateway, frame);
        self.pass();
        self.bus.receive(self.other).map(|(_, frame)| frame)
    }

    fn pass(&mut self) {
        while let Some(due_ns) = self.bus.due_ns() {
            self.bus.advance(due_ns);
        }
    }
}

/// From a node's frame on one bus to the echo of a node on another, over two gateways, and the same bytes over UDP alone,
/// there and back, ns each.
fn bus_to_bus(frames: usize) -> Result<[Vec<f64>; 2]> {
    let (near, far) = (socket()?, socket()?);
    let (near_address, stop) = (near.local_addr()?, Arc::new(AtomicBool::new(false)));
    let [mut ours, theirs] = acquainted([&near, &far])?;
    let far_address = far.local_addr()?;
    let echo = std::thread::spawn({
        let stop = stop.clone();
        move || echo(&far, theirs, near_address, &stop)
    });
    let mut times = [Vec::with_capacity(frames), Vec::with_capacity(frames)];
    let (mut wire, mut bytes) = (Bus::new(), [0; 2_048]);
    for number in 0..frames {
        let begun = now_ns();
        wire.put(&frame(number));
        let heard = wire.get().context("the bus in memory lost a frame")?;
        ours.take_frame(&heard, 2);
        ours.run(2, &mut |to, sent| near.send_to(sent, to).is_ok());
        let mut back = None;
        while back.is_none() {
            let (length, from) = near.recv_from(&mut bytes).context("no echo came over two gateways")?;
            ours.take_datagram(&bytes[..length], from, 2, |frame, _| back = wire.write(frame));
        }
        let between = now_ns();
        bytes[0] = RAW;
        near.send_to(&bytes[..64], far_address)?;
        near.recv_from(&mut bytes).context("no echo came over UDP")?;
        times[0].push((between - begun) as f64);
        times[1].push((now_ns() - between) as f64);
    }
    stop.store(true, Ordering::Relaxed);
    near.send_to(&[RAW], far_address)?;
    let _ = echo.join(); // its socket goes with it
    Ok(times)
}

/// The first byte of what is sent back as it is.
const RAW: u8 = 0xff;

fn echo(socket: &UdpSocket, mut gateway: Gateway, to: SocketAddr, stop: &AtomicBool) {
    let (mut wire, mut bytes) = (Bus::new(), [0; 2_048]);
    while !stop.load(Ordering::Relaxed) {
        let Ok((length, from)) = socket.recv_from(&mut bytes) else { return };
        if bytes[0] == RAW {
            let _ = socket.send_to(&bytes[..length], to); // missed, and so noticed
            continue;
        }
        let mut heard = None;
        gateway.take_datagram(&bytes[..length], from, 2, |frame, _| heard = wire.write(frame));
        // The node on the far bus says it again.
        if let Some(frame) = heard {
            wire.put(&frame);
        }
        if let Some(frame) = wire.get() {
            gateway.take_frame(&frame, 2);
        }
        gateway.run(2, &mut |to, sent| socket.send_to(sent, to).is_ok());
    }
}

/// Frames a second from a controller into datagrams that the system takes, and out of them again at another gateway.
fn throughput(frames: usize) -> Result<f64> {
    let (from, to) = (socket()?, socket()?);
    to.set_nonblocking(true)?;
    let [mut ours, mut theirs] = acquainted([&from, &to])?;
    let (mut bytes, mut arrived) = ([0; 2_048], 0_usize);
    let begun = now_ns();
    for number in 0..frames {
        ours.take_frame(&frame(number), 2);
        // As many as a datagram holds: what a gateway finds waiting when it has been kept from its work.
        if number % 80 == 79 || number + 1 == frames {
            ours.flush(2, &mut |to, sent| from.send_to(sent, to).is_ok());
            while let Ok((length, sender)) = to.recv_from(&mut bytes) {
                theirs.take_datagram(&bytes[..length], sender, 2, |_, _| arrived += 1);
            }
        }
    }
    anyhow::ensure!(arrived == frames, "{} of {frames} frames were lost on this machine", frames - arrived);
    Ok(frames as f64 * 1e9 / (now_ns() - begun) as f64)
}
