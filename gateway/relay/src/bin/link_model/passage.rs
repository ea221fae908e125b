//! The sockets, what is on its way between them, and when it is due.
//!
//! It must never hand on a datagram before its instant, nor in another order than that of the instants.

use std::collections::BTreeMap;
use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use bateleur_contract::relay::LinkModelTable;
use bateleur_relay::model::{LinkModel, ModelCounters};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::net::{AddressFamily, SocketFlags, SocketType, bind, socket_with, sockopt};
use serde::{Deserialize, Serialize};

/// Longer than any datagram.
const ROOM: usize = 1 << 16;
/// What the kernel keeps for a socket, bytes; it may give less.
const KEPT: usize = 4 << 20;

/// FILE.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Settings {
    model: LinkModelTable,
    ways: Vec<WaySettings>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct WaySettings {
    network: String,
    link: u16,
    first: SideSettings,
    second: SideSettings,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct SideSettings {
    listen: SocketAddr,
    #[serde(default)]
    device: Option<String>,
    peer: SocketAddr,
}

/// What became of the datagrams of one direction of one way.
#[derive(Debug, Serialize)]
pub(crate) struct Count {
    network: String,
    link: u16,
    /// From the first to the second; else the other way.
    from_first: bool,
    #[serde(flatten)]
    model: ModelCounters,
    /// Datagrams that were handed on.
    handed_on: u64,
    /// Datagrams that the system did not take.
    unsent: u64,
    /// Still on the way at the end.
    on_the_way: u64,
    /// Of others than the peer: not handed on, not in the model.
    strangers: u64,
}

/// One direction: in at one side, out at the other.
struct Direction {
    network: String,
    link: u16,
    from_first: bool,
    from: usize,
    to: usize,
    model: LinkModel,
    handed_on: u64,
    unsent: u64,
    strangers: u64,
}

struct Side {
    socket: UdpSocket,
    peer: SocketAddr,
}

/// See the module's head.
pub(crate) struct Passage {
    /// Two for each way.
    sides: Vec<Side>,
    directions: Vec<Direction>,
    /// By instant and number: direction, datagram.
    on_the_way: BTreeMap<(u64, u64), (usize, Vec<u8>)>,
    number: u64,
    begun: Instant,
    asked: Arc<AtomicBool>,
}

impl Passage {
    /// Opens all sockets.
    pub(crate) fn open(settings: &Settings) -> Result<Self, String> {
        let (mut sides, mut directions) = (Vec::new(), Vec::new());
        for way in &settings.ways {
            let first = sides.len();
            for side in [&way.first, &way.second] {
                let socket = listen(side).map_err(|error| {
                    format!("network {}: cannot listen at {}: {error}", way.network, side.listen)
                })?;
                sides.push(Side { socket, peer: side.peer });
            }
            directions.extend([true, false].map(|from_first| Direction {
                network: way.network.clone(),
                link: way.link,
                from_first,
                from: if from_first { first } else { first + 1 },
                to: if from_first { first + 1 } else { first },
                model: LinkModel::new(&settings.model, &way.network, way.link, from_first),
                handed_on: 0,
                unsent: 0,
                strangers: 0,
            }));
        }
        let asked = Arc::new(AtomicBool::new(false));
        for signal in [signal_hook::consts::SIGINT, signal_hook::consts::SIGTERM] {
            signal_hook::flag::register(signal, asked.clone()).map_err(|error| error.to_string())?;
        }
        let on_the_way = BTreeMap::new();
        Ok(Self { sides, directions, on_the_way, number: 0, begun: Instant::now(), asked })
    }

    /// Hands on until it is asked to end.
    pub(crate) fn run(&mut self) -> io::Result<()> {
        self.begun = Instant::now();
        let input = io::stdin();
        let mut buffer = vec![0; ROOM];
        while !self.asked.load(Ordering::Relaxed) {
            self.hand_on();
            if self.wait(input.as_fd())? && ended(input.as_fd()) {
                return Ok(());
            }
            (0..self.directions.len()).for_each(|direction| self.take_in(direction, &mut buffer));
        }
        Ok(())
    }

    /// What was done.
    pub(crate) fn counts(&self) -> Vec<Count> {
        let count = |(place, direction): (usize, &Direction)| Count {
            network: direction.network.clone(),
            link: direction.link,
            from_first: direction.from_first,
            model: direction.model.counters(),
            handed_on: direction.handed_on,
            unsent: direction.unsent,
            on_the_way: self.on_the_way.values().filter(|way| way.0 == place).count() as u64,
            strangers: direction.strangers,
        };
        self.directions.iter().enumerate().map(count).collect()
    }

    fn now_ns(&self) -> u64 {
        u64::try_from(self.begun.elapsed().as_nanos()).unwrap_or(u64::MAX)
    }

    fn hand_on(&mut self) {
        let now_ns = self.now_ns();
        while let Some(first) = self.on_the_way.first_entry().filter(|first| first.key().0 <= now_ns) {
            let (number, datagram) = first.remove();
            let direction = &mut self.directions[number];
            let side = &self.sides[direction.to];
            // An error of an earlier one shows at the next call: that one is made once more.
            let send = || side.socket.send_to(&datagram, side.peer);
            match send().or_else(|_| send()) {
                Ok(_) => direction.handed_on += 1,
                Err(_) => direction.unsent += 1,
            }
        }
    }

    /// Until something comes or is due; true: something is to be read from the standard input, or it has ended.
    fn wait(&self, input: BorrowedFd<'_>) -> io::Result<bool> {
        let mut waiting: Vec<PollFd<'_>> =
            self.sides.iter().map(|side| PollFd::new(&side.socket, PollFlags::IN)).collect();
        waiting.push(PollFd::from_borrowed_fd(input, PollFlags::IN));
        let due = self.on_the_way.first_key_value().map(|((due_ns, _), _)| {
            let left_ns = due_ns.saturating_sub(self.now_ns());
            Timespec { tv_sec: (left_ns / 1_000_000_000) as i64, tv_nsec: (left_ns % 1_000_000_000) as i64 }
        });
        match poll(&mut waiting, due.as_ref()) {
            Ok(_) => Ok(waiting.last().is_some_and(|input| !input.revents().is_empty())),
            Err(rustix::io::Errno::INTR) => Ok(false), // a signal: the loop looks at what it asks
            Err(error) => Err(error.into()),
        }
    }

    fn take_in(&mut self, number: usize, buffer: &mut [u8]) {
        let now_ns = self.now_ns();
        let direction = &mut self.directions[number];
        let side = &self.sides[direction.from];
        loop {
            let (length, from) = match side.socket.recv_from(buffer) {
                Ok(received) => received,
                Err(error) if error.kind() == io::ErrorKind::ConnectionRefused => continue, // of one that was sent
                Err(_) => return,
            };
            if from != side.peer {
                direction.strangers += 1;
                continue;
            }
            for due_ns in direction.model.pass(now_ns, length).into_iter().flatten() {
                self.number += 1;
                self.on_the_way.insert((due_ns, self.number), (number, buffer[..length].to_vec()));
            }
        }
    }
}

fn ended(input: BorrowedFd<'_>) -> bool {
    !matches!(rustix::io::read(input, &mut [0_u8; 256]), Ok(length) if length > 0)
}

fn listen(side: &SideSettings) -> io::Result<UdpSocket> {
    let family = if side.listen.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    let socket: OwnedFd = socket_with(family, SocketType::DGRAM, flags, None)?;
    if let Some(device) = &side.device {
        bind_to(&socket, device)?;
    }
    bind(&socket, &side.listen)?;
    let _ = sockopt::set_socket_recv_buffer_size(&socket, KEPT); // what there is has to do
    Ok(socket.into())
}

/// Only what comes over this interface is received, and what is sent leaves through it.
#[allow(unsafe_code)] // no library that is used here wraps this option
fn bind_to(socket: &OwnedFd, device: &str) -> io::Result<()> {
    use std::os::fd::AsRawFd;
    // SAFETY: the kernel reads as many bytes as it is told, which live here.
    let done = unsafe {
        libc::setsockopt(
            socket.as_raw_fd(),
            libc::SOL_SOCKET,
            libc::SO_BINDTODEVICE,
            device.as_ptr().cast(),
            device.len() as libc::socklen_t, // an interface's name is short
        )
    };
    if done == 0 { Ok(()) } else { Err(io::Error::last_os_error()) }
}
