//! Figures of the links between hosts: the relay's protocol, its transport and ports, beside raw sockets with the same bytes
//! on the same processors. Windows of the relay are left out: the schedule decides how long a message waits for one.

use std::net::{SocketAddr, UdpSocket};
use std::os::fd::{AsFd, AsRawFd};
use std::rc::Rc;

use anyhow::{Context, Result, anyhow};
use bateleur_apex::{SamplingDestination, SamplingSource, Time};
use bateleur_contract::relay::{ClockRole, LinkTable, PathTable, RelayChannel, RelayTable};
use bateleur_contract::{Clock, ControlPage, Mapped, PortKind};
use bateleur_ports::{ChannelType, Domain};
use bateleur_relay::transport::{Endpoint, RelayTransport, Udp};
use bateleur_relay::{Arrival, Frame, HEADER_BYTES, Link, MESSAGE_BYTES, Stamp, TAG_BYTES};
use bateleur_system::sched;
use bateleur_system::time::now_ns;
use rustix::event::{PollFd, PollFlags, poll};

use super::Settings;
use super::ports::Block;
use super::probe;
use super::row::{Reach, Row};
use super::statistics::{median, quantile};

/// Channels of the figure of processor time.
const CHANNELS: usize = 100;
/// Bytes of each message there.
const SMALL: usize = 64;
/// A datagram with all of them, bytes.
const FULL: usize = HEADER_BYTES + CHANNELS * (MESSAGE_BYTES + SMALL) + TAG_BYTES;
/// The longest that the other end may take, ms, before the measurement is given up.
const PATIENCE_MS: i64 = 5_000;
/// No value is too old here.
const ANY_AGE: u64 = u64::MAX;

/// All figures of links.
pub(super) fn rows(settings: &Settings) -> Result<Vec<Row>> {
    let mut rows = crossing::<64>(settings)?;
    rows.extend(crossing::<1024>(settings)?);
    rows.extend(processor_time(settings)?);
    rows.push(lost(settings)?);
    Ok(rows)
}

fn table(
    initiator: bool,
    at: [SocketAddr; 2],
    channels: usize,
    bytes: usize,
    max_datagram: usize,
) -> RelayTable {
    let (local, remote) = if initiator { (at[0], at[1]) } else { (at[1], at[0]) };
    let channel = |id: usize, outgoing: bool| RelayChannel {
        id: id as u16, // a few hundred
        name: format!("bench.{id}"),
        port: format!("bench-{id}"),
        outgoing,
        kind: PortKind::Sampling,
        plain: false,
        max_bytes: bytes as u32, // a few thousand
        depth: 1,
        period_ns: 0,
    };
    let there = (0..channels).map(|id| channel(id, initiator));
    let back = (channels..2 * channels).map(|id| channel(id, !initiator));
    RelayTable {
        module: if initiator { "a" } else { "b" }.into(),
        digest: "00".repeat(32),
        sections: std::collections::BTreeMap::new(),
        transport: "udp".into(),
        links: vec![LinkTable {
            name: "bench".into(),
            id: 1,
            peer: if initiator { "b" } else { "a" }.into(),
            initiator,
            authenticated: true,
            gap_ns: 0, // windows and gaps are the schedule's: here everything goes at once
            max_datagram: max_datagram as u32,
            skew_ns: 1_000_000,
            lost_after_ns: 1_000_000_000,
            clock: ClockRole::None,
            paths: vec![PathTable { network: "a".into(), local, remote, latency_ns: 0 }],
            channels: there.chain(back).collect(),
        }],
    }
}

/// Two addresses of this computer that nobody has at the moment.
fn free() -> Result<[SocketAddr; 2]> {
    let sockets = [UdpSocket::bind("127.0.0.1:0")?, UdpSocket::bind("127.0.0.1:0")?];
    Ok([sockets[0].local_addr()?, sockets[1].local_addr()?])
}

/// A link's end with its socket.
struct End {
    link: Link,
    udp: Udp,
}

impl End {
    fn open(table: &RelayTable, life: u8) -> Result<Self> {
        let udp = Udp::open(&Endpoint::all(table))?;
        Ok(Self { link: Link::new(table, &table.links[0], &[0x42; 32], [life; 32])?, udp })
    }

    /// Sends what `fill` puts in.
    fn send(&mut self, mut fill: impl FnMut(&mut bateleur_relay::Composer<'_>)) {
        let now_ns = now_ns();
        if let Some(mut composer) = self.link.open(now_ns, Frame::default()) {
            fill(&mut composer);
            let sealed = composer.finish(now_ns);
            self.udp.send(0, [sealed.bytes, sealed.tag(0)]);
        }
        self.udp.flush(now_ns, &mut |_| ());
    }

    /// Takes what has come; gives the number of messages.
    fn receive(&mut self, mut take: impl FnMut(&[u8])) -> usize {
        let now_ns = now_ns();
        let Self { link, udp } = self;
        let mut count = 0;
        udp.receive(&self::now_ns, 64, &mut |came| {
            if let Ok(datagram) = came.datagram {
                let arrival = Arrival { network: 0, came_ns: came.at_ns, now_ns };
                // What is refused here while both ends meet is sent again by nobody.
                let _ = link.receive(arrival, datagram, &mut |delivery| {
                    take(delivery.bytes);
                    count += 1;
                    true
                });
            }
        });
        count
    }

    fn wait(&self) -> bool {
        let socket = self.udp.socket(0);
        let limit = rustix::event::Timespec { tv_sec: PATIENCE_MS / 1000, tv_nsec: 0 };
        socket.is_some_and(|socket| {
            let mut waiting = [PollFd::from_borrowed_fd(socket.as_fd(), PollFlags::IN)];
            poll(&mut waiting, Some(&limit)).is_ok_and(|ready| ready > 0)
        })
    }
}

/// Lets both ends meet.
fn meet(a: &mut End, b: &mut End) -> Result<()> {
    for _ in 0..1_000 {
        a.send(|_| ());
        b.receive(|_| ());
        b.send(|_| ());
        a.receive(|_| ());
        if [&a.link, &b.link].iter().all(|link| link.state() == bateleur_messages::link::UP) {
            return Ok(());
        }
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    Err(anyhow!(
        "two relays on this computer do not meet: does a firewall stand between 127.0.0.1 and itself?"
    ))
}

/// A port of a partition and the relay's end of its channel.
struct Port<const N: usize> {
    source: SamplingSource<Block<N>>,
    destination: SamplingDestination<Block<N>>,
}

impl<const N: usize> Port<N> {
    fn open(folder: &std::path::Path, name: &str) -> Result<Self> {
        let page = rustix::fs::memfd_create("bench", rustix::fs::MemfdFlags::CLOEXEC)?;
        rustix::fs::ftruncate(&page, size_of::<ControlPage>() as u64)?;
        let page = Rc::new(Mapped::<ControlPage>::new(page).map_err(|error| anyhow!("{error}"))?);
        page.initialise();
        page.origin_ns.store(now_ns(), std::sync::atomic::Ordering::Relaxed);
        let time = Time::new(page, Clock::Wall);
        let domain = Domain { root: folder.display().to_string() };
        let node = domain.join(name, "bench")?;
        let kind = ChannelType {
            name: name.into(),
            message: "Block".into(),
            size: N,
            depth: None,
            destinations: 1,
            spare_writers: 0,
            spare_readers: 0,
        };
        let channel = kind.create(&node)?;
        let source = SamplingSource::new(Some(Rc::new(kind.writer(&channel)?)), time.clone());
        let destination = SamplingDestination::new(Some(Rc::new(kind.reader(&channel)?)), ANY_AGE, time);
        Ok(Self { source, destination })
    }
}

/// One of two that play ball: writes to a port, relays it; takes in what comes, and reads it from a port.
struct Player<const N: usize> {
    end: End,
    out: Port<N>,
    back: Port<N>,
    channel: usize,
    value: Block<N>,
    /// One has come that was not asked for yet.
    caught: bool,
    _folder: tempfile::TempDir,
}

impl<const N: usize> Player<N> {
    fn open(initiator: bool, at: [SocketAddr; 2]) -> Result<Self> {
        let table = table(initiator, at, 1, N, 1472);
        let folder = tempfile::Builder::new().prefix("bateleur-bench.").tempdir_in("/dev/shm")?;
        Ok(Self {
            end: End::open(&table, if initiator { 1 } else { 2 })?,
            out: Port::open(folder.path(), "out")?,
            back: Port::open(folder.path(), "back")?,
            channel: usize::from(!initiator),
            value: Block([0; N]),
            caught: false,
            _folder: folder,
        })
    }

    fn throw(&mut self) {
        self.out.source.write(&self.value);
        let Self { end, out, channel, .. } = self;
        end.send(|composer| {
            if let Some(reading) = out.destination.read().filter(|reading| reading.updated) {
                composer.put(*channel, Stamp { source_ns: 0, sequence: reading.sequence }, &reading.value.0);
            }
        });
    }

    /// False: nothing came.
    fn catch(&mut self) -> bool {
        while !self.caught {
            if !self.end.wait() {
                return false;
            }
            self.look();
        }
        self.caught = false;
        true
    }

    fn look(&mut self) {
        let Self { end, back, value, .. } = self;
        let came = end.receive(|bytes| {
            if let Ok(bytes) = bytes.try_into() {
                *value = Block(bytes);
                back.source.write(value);
            }
        });
        self.caught |= came > 0 && self.back.destination.read().is_some_and(|reading| reading.updated);
    }

    /// The other one may be ready first, and throw.
    fn meet(&mut self) -> Result<()> {
        for _ in 0..2_000 {
            self.end.send(|_| ());
            std::thread::sleep(std::time::Duration::from_millis(1));
            self.look();
            if self.end.link.state() == bateleur_messages::link::UP {
                self.end.send(|_| ());
                return Ok(());
            }
        }
        Err(anyhow!("two relays on this computer do not meet"))
    }
}

/// Half of a round, from the write to a port to the moment at which it can be read at the other end, and the same of bare
/// sockets.
fn crossing<const N: usize>(settings: &Settings) -> Result<Vec<Row>> {
    let rounds = if settings.quick { 200 } else { 10_000 };
    let (mut ours, mut raw) = (Vec::new(), Vec::new());
    for _ in 0..settings.runs {
        raw.extend(raw_rounds(settings.core, N, rounds)?);
        ours.extend(relayed_rounds::<N>(settings.core, rounds)?);
    }
    let about = "half a round of UDP ping-pong of the same size on the same processors at the same priority";
    let row = |what: &str, share: f64| {
        let (value, reference) = (quantile(&ours, share), quantile(&raw, share));
        let name = format!("port to port over a link, {N} B, {what}");
        Row::measured(name, "us", value.unwrap_or(0.0), reference, Reach::Times(1.5), about)
    };
    Ok(vec![row("p50", 0.5), row("p99.9", 0.999)])
}

/// The processor that the other end runs on: another one where there is one.
fn other_core(core: u32) -> u32 {
    sched::allowed_cores().into_iter().find(|other| *other != core).unwrap_or(core)
}

fn relayed_rounds<const N: usize>(core: u32, rounds: usize) -> Result<Vec<f64>> {
    let at = free()?;
    let other = std::thread::spawn(move || {
        probe::on_core(other_core(core), probe::PARTITION, move || {
            let mut player = Player::<N>::open(false, at)?;
            player.meet()?;
            while player.catch() {
                player.throw();
                if player.value.0[0] == u8::MAX {
                    return Ok(());
                }
            }
            Err(anyhow!("a datagram got lost on the way there"))
        })
    });
    let samples = probe::on_core(core, probe::PARTITION, move || {
        let mut player = Player::<N>::open(true, at)?;
        player.meet()?;
        let mut samples = Vec::with_capacity(rounds);
        for round in 0..rounds {
            player.value.0[0] = if round + 1 == rounds { u8::MAX } else { 0 };
            let begun_ns = now_ns();
            player.throw();
            if !player.catch() {
                return Err(anyhow!("a datagram got lost on the way back"));
            }
            samples.push((now_ns() - begun_ns) as f64 / 2e3);
        }
        Ok(samples)
    })?;
    other.join().map_err(|_| anyhow!("a measuring thread failed"))???;
    samples
}

fn raw_rounds(core: u32, bytes: usize, rounds: usize) -> Result<Vec<f64>> {
    let (here, there) = (UdpSocket::bind("127.0.0.1:0")?, UdpSocket::bind("127.0.0.1:0")?);
    here.connect(there.local_addr()?)?;
    there.connect(here.local_addr()?)?;
    let patience = Some(std::time::Duration::from_millis(PATIENCE_MS as u64));
    here.set_read_timeout(patience)?;
    there.set_read_timeout(patience)?;
    let other = std::thread::spawn(move || {
        probe::on_core(other_core(core), probe::PARTITION, move || -> Result<()> {
            let mut buffer = vec![0; bytes];
            for _ in 0..rounds {
                there.recv(&mut buffer)?;
                there.send(&buffer)?;
            }
            Ok(())
        })
    });
    let samples = probe::on_core(core, probe::PARTITION, move || -> Result<Vec<f64>> {
        let mut buffer = vec![0; bytes];
        let mut samples = Vec::with_capacity(rounds);
        for _ in 0..rounds {
            let begun_ns = now_ns();
            here.send(&buffer)?;
            here.recv(&mut buffer)?;
            samples.push((now_ns() - begun_ns) as f64 / 2e3);
        }
        Ok(samples)
    })?;
    other.join().map_err(|_| anyhow!("a measuring thread failed"))???;
    samples
}

/// What one message costs in batches that take turns, ns.
fn processor_time(settings: &Settings) -> Result<Vec<Row>> {
    let rounds = if settings.quick { 50 } else { 2_000 * settings.runs };
    let [protocol, whole, receive, one, hundred] =
        probe::on_core(settings.core, probe::PARTITION, move || costs(rounds))??;
    let one_name = "sendmmsg of one datagram of the same bytes";
    let row = |name: &str, value, reference, reach, about: &str| {
        Row::measured(
            format!("relay, a message of {SMALL} B of {CHANNELS}, {name}"),
            "ns",
            value,
            reference,
            reach,
            about,
        )
    };
    Ok(vec![
        row("into a datagram, tag, send", protocol, Some(one), Reach::Times(2.0), one_name),
        row("from its port to the wire", whole, Some(one), Reach::Stated, one_name),
        row(
            "from its port to the wire, each sent alone",
            whole,
            Some(hundred),
            Reach::Times(2.0),
            "sendmmsg of the same messages, a datagram each",
        ),
        row("from the wire, tag, taken apart", receive, Some(one), Reach::Stated, one_name),
    ])
}

fn costs(rounds: usize) -> Result<[f64; 5]> {
    let at = free()?;
    let mut a = End::open(&table(true, at, CHANNELS, SMALL, FULL), 1)?;
    let mut b = End::open(&table(false, at, CHANNELS, SMALL, FULL), 2)?;
    meet(&mut a, &mut b)?;
    let folder = tempfile::Builder::new().prefix("bateleur-bench.").tempdir_in("/dev/shm")?;
    let open = |number: usize| Port::<SMALL>::open(folder.path(), &format!("bench{number}"));
    let mut ports: Vec<_> = (0..CHANNELS).map(open).collect::<Result<_>>().context("100 channels")?;
    let (here, there) = (UdpSocket::bind("127.0.0.1:0")?, UdpSocket::bind("127.0.0.1:0")?);
    here.connect(there.local_addr()?)?;
    there.set_nonblocking(true)?;
    let value = Block([7; SMALL]);
    let mut all: [Vec<f64>; 5] = Default::default();
    for round in 0..=rounds {
        let protocol = timed(|| {
            a.send(|composer| {
                for channel in 0..CHANNELS {
                    composer.put(channel, Stamp::default(), &value.0);
                }
            });
        });
        let mut came = 0;
        let receive = timed(|| came = b.receive(|bytes| _ = std::hint::black_box(bytes)));
        anyhow::ensure!(came == CHANNELS, "{came} of {CHANNELS} messages came");
        ports.iter_mut().for_each(|port| port.source.write(&value));
        let whole = timed(|| {
            a.send(|composer| {
                for (channel, port) in ports.iter_mut().enumerate() {
                    if let Some(reading) = port.destination.read().filter(|reading| reading.updated) {
                        let stamp = Stamp { source_ns: 0, sequence: reading.sequence };
                        composer.put(channel, stamp, &reading.value.0);
                    }
                }
            });
        });
        b.receive(|_| ());
        let one = timed(|| send_raw(&here, 1, FULL));
        drain(&there);
        let hundred = timed(|| send_raw(&here, CHANNELS, SMALL));
        drain(&there);
        if round > 0 {
            // The first is cold.
            let costs = [protocol, whole, receive, one, hundred];
            all.iter_mut().zip(costs).for_each(|(list, ns)| list.push(ns / CHANNELS as f64));
        }
    }
    Ok(all.map(|list| median(&list).unwrap_or(0.0)))
}

fn timed(work: impl FnOnce()) -> f64 {
    let begun_ns = now_ns();
    work();
    (now_ns() - begun_ns) as f64
}

fn drain(socket: &UdpSocket) {
    let mut buffer = [0; 1 << 14];
    while socket.recv(&mut buffer).is_ok() {}
}

/// `count` datagrams of `bytes` with one call.
#[allow(unsafe_code)] // the call that is the reference
fn send_raw(socket: &UdpSocket, count: usize, bytes: usize) {
    static BYTES: [u8; 1 << 14] = [7; 1 << 14];
    let mut vector =
        libc::iovec { iov_base: BYTES.as_ptr().cast_mut().cast(), iov_len: bytes.min(BYTES.len()) };
    // SAFETY: a structure of integers and pointers, for which zeros are a value.
    let mut messages: [libc::mmsghdr; CHANNELS] = unsafe { std::mem::zeroed() };
    for message in &mut messages {
        message.msg_hdr.msg_iov = &raw mut vector;
        message.msg_hdr.msg_iovlen = 1;
    }
    // SAFETY: headers, vector and bytes outlive the call; the kernel only reads the bytes.
    unsafe { libc::sendmmsg(socket.as_raw_fd(), messages.as_mut_ptr(), count as libc::c_uint, 0) };
}

/// Ten million messages from relay to relay, at full length in every datagram.
fn lost(settings: &Settings) -> Result<Row> {
    let datagrams = if settings.quick { 100 } else { 100_000 };
    let (a, b) = probe::on_core(settings.core, probe::PARTITION, move || -> Result<_> {
        let at = free()?;
        let mut a = End::open(&table(true, at, CHANNELS, SMALL, FULL), 1)?;
        let mut b = End::open(&table(false, at, CHANNELS, SMALL, FULL), 2)?;
        meet(&mut a, &mut b)?;
        let value = [7; SMALL];
        for number in 0..datagrams {
            let stamp = Stamp { source_ns: now_ns(), sequence: number };
            a.send(|composer| {
                for channel in 0..CHANNELS {
                    composer.put(channel, stamp, &value);
                }
            });
            b.receive(|_| ());
            b.send(|_| ());
            a.receive(|_| ());
        }
        Ok((a.link.counters(), b.link.counters()))
    })??;
    let lost = a.messages_sent - b.messages_received + b.messages_late;
    let name = format!("messages lost of {} over a link", a.messages_sent);
    Ok(Row::measured(name, "", lost as f64, None, Reach::AtMost(0.0), "a clean network"))
}
