//! A socketcand server: clients over TCP that see the bus and send on it, python-can's among them.
//!
//! Responsible for: what clients are told, and that one that does not read, or talks nonsense, costs the others nothing.

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::os::fd::{AsFd, BorrowedFd};

use serde::Serialize;

use bateleur_can_core::frame::Frame;
use bateleur_can_core::wire::socketcand::{self, BEACON_PORT, Decoder, Request};

/// Clients at a time.
const CLIENTS: usize = 16;
/// Bytes that wait for a client; one that leaves more unread is cut off: some 20 000 frames.
const BACKLOG: usize = 1 << 20;
/// Nonsense that a client may say before it is cut off.
const PATIENCE: u64 = 100;
/// Messages of one client that are heard in one turn at most; what more it has said waits for the next, behind everybody else.
const PER_TURN: usize = 64;
/// How often the beacon goes out, ns.
const BEACON_EVERY_NS: u64 = 3_000_000_000;

/// How to serve.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServerOptions {
    /// Where to listen.
    pub listen: SocketAddr,
    /// The bus's name, which clients open; another name is refused.
    pub bus: String,
    /// Tell the network by broadcast that there is a server.
    pub beacon: bool,
    /// Where clients may come from; empty: anywhere.
    pub only_from: Vec<IpAddr>,
}

/// What became of what clients wanted.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize)]
pub struct ServerCounters {
    /// Clients that are there.
    pub clients: u64,
    /// Clients that came, so far.
    pub accepted: u64,
    /// Clients that were turned away or cut off: too many, too slow, or nonsense.
    pub cut_off: u64,
    /// Frames from clients.
    pub frames_in: u64,
    /// Frames to clients, each to each.
    pub frames_out: u64,
    /// Frames that the protocol can not carry: FD, remote, reports of errors.
    pub not_carried: u64,
    /// Requests that are none.
    pub refused: u64,
}

#[derive(Debug)]
struct Client {
    stream: TcpStream,
    decoder: Decoder,
    /// Whole messages that were read and not yet heard.
    input: VecDeque<String>,
    output: Vec<u8>,
    opened: bool,
    raw: bool,
    nonsense: u64,
    gone: bool,
}

/// See the module's text.
#[derive(Debug)]
pub struct Server {
    options: ServerOptions,
    listener: TcpListener,
    address: SocketAddr,
    beacon: Option<UdpSocket>,
    beacon_at_ns: u64,
    clients: Vec<Client>,
    counters: ServerCounters,
}

impl Server {
    /// Listens.
    ///
    /// # Errors
    /// The system's answer: the port is taken, or the address is not ours.
    pub fn bind(options: ServerOptions) -> io::Result<Self> {
        let listener = TcpListener::bind(options.listen)?;
        listener.set_nonblocking(true)?;
        let address = listener.local_addr()?;
        let beacon = match options.beacon {
            true => {
                let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
                socket.set_broadcast(true)?;
                Some(socket)
            }
            false => None,
        };
        Ok(Self {
            options,
            listener,
            address,
            beacon,
            beacon_at_ns: 0,
            clients: Vec::new(),
            counters: ServerCounters::default(),
        })
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What happened so far.
    pub fn counters(&self) -> ServerCounters {
        ServerCounters { clients: self.clients.len() as u64, ..self.counters }
    }

    /// What to wait for, each with whether it also waits to be written.
    pub fn descriptors(&self) -> impl Iterator<Item = (BorrowedFd<'_>, bool)> {
        let clients = self.clients.iter().map(|client| (client.stream.as_fd(), !client.output.is_empty()));
        std::iter::once((self.listener.as_fd(), false)).chain(clients)
    }

    /// When there is something to do by the clock: the beacon, or at once what clients have said and was not heard yet; ns.
    pub fn due_ns(&self) -> u64 {
        if self.clients.iter().any(|client| !client.input.is_empty()) {
            return 0;
        }
        if self.beacon.is_some() { self.beacon_at_ns } else { u64::MAX }
    }

    /// Tells every client of a frame on the bus.
    pub fn tell(&mut self, frame: &Frame, time_ns: u64) {
        self.tell_others(frame, time_ns, usize::MAX);
    }

    fn tell_others(&mut self, frame: &Frame, time_ns: u64, but: usize) {
        if !self.clients.iter().any(|client| client.raw) {
            return;
        }
        let Some(text) = socketcand::frame(frame, time_ns) else {
            self.counters.not_carried += 1;
            return;
        };
        let listening = |(place, client): &(usize, &mut Client)| *place != but && client.raw && !client.gone;
        for (_, client) in self.clients.iter_mut().enumerate().filter(listening) {
            client.output.extend_from_slice(text.as_bytes());
            client.flush();
            self.counters.frames_out += 1;
        }
    }

    /// Hears everybody; frames from clients go to `take`, and to the other clients.
    pub fn turn(&mut self, now_ns: u64, time_ns: u64, mut take: impl FnMut(&Frame)) {
        self.accept();
        for place in 0..self.clients.len() {
            self.clients[place].read();
            let refused = std::mem::take(&mut self.clients[place].decoder.refused);
            self.clients[place].nonsense += refused;
            self.counters.refused += refused;
            for _ in 0..PER_TURN {
                let Some(words) = self.clients[place].input.pop_front() else { break };
                if let Some(frame) = self.answer(place, &words) {
                    self.counters.frames_in += 1;
                    take(&frame);
                    self.tell_others(&frame, time_ns, place);
                }
            }
            self.clients[place].flush();
        }
        let cut_off = |client: &&Client| client.output.len() > BACKLOG || client.nonsense > PATIENCE;
        self.counters.cut_off += self.clients.iter().filter(cut_off).count() as u64;
        // What one said before it went is heard.
        let is_over = |client: &Client| client.gone && client.input.is_empty();
        self.clients.retain(|client| !is_over(client) && !cut_off(&client));
        self.send_beacon(now_ns);
    }

    fn accept(&mut self) {
        while let Ok((stream, from)) = self.listener.accept() {
            let prepared = stream.set_nonblocking(true).and_then(|()| stream.set_nodelay(true));
            let is_stranger =
                !self.options.only_from.is_empty() && !self.options.only_from.contains(&from.ip());
            if self.clients.len() == CLIENTS || is_stranger || prepared.is_err() {
                self.counters.cut_off += 1;
                continue;
            }
            self.counters.accepted += 1;
            let output = b"< hi >".to_vec();
            let (decoder, input, nonsense) = (Decoder::new(), VecDeque::new(), 0);
            let mut client =
                Client { stream, decoder, input, output, opened: false, raw: false, nonsense, gone: false };
            client.flush();
            self.clients.push(client);
        }
    }

    fn answer(&mut self, place: usize, words: &str) -> Option<Frame> {
        let client = &mut self.clients[place];
        let text = match socketcand::request(words) {
            Request::Open(name) if name == self.options.bus => {
                client.opened = true;
                "< ok >".to_owned()
            }
            Request::Open(name) => {
                format!("< error there is no bus {name}: this server has {} >", self.options.bus)
            }
            Request::RawMode if client.opened => {
                client.raw = true;
                "< ok >".to_owned()
            }
            Request::Echo => "< echo >".to_owned(),
            Request::Send(frame) if client.raw => return Some(frame),
            Request::RawMode | Request::Send(_) => "< error open the bus, then ask for rawmode >".to_owned(),
            Request::Unknown(_) => {
                client.nonsense += 1;
                self.counters.refused += 1;
                "< error unknown command >".to_owned()
            }
        };
        client.output.extend_from_slice(text.as_bytes());
        None
    }

    fn send_beacon(&mut self, now_ns: u64) {
        let Some(socket) = &self.beacon else { return };
        if now_ns < self.beacon_at_ns {
            return;
        }
        self.beacon_at_ns = now_ns + BEACON_EVERY_NS;
        let address = match self.address.ip() {
            IpAddr::V4(Ipv4Addr::UNSPECIFIED) => SocketAddr::new(own_address(), self.address.port()),
            _ => self.address,
        };
        let text = socketcand::beacon("bateleur", &address.to_string(), &self.options.bus);
        // A network without broadcast has no beacon.
        let _ = socket.send_to(text.as_bytes(), (Ipv4Addr::BROADCAST, BEACON_PORT));
    }
}

/// The address from which this computer would reach others.
fn own_address() -> IpAddr {
    let found = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0)).and_then(|socket| {
        socket.connect((Ipv4Addr::new(192, 0, 2, 1), 9))?; // nothing is sent
        socket.local_addr()
    });
    found.map_or(IpAddr::V4(Ipv4Addr::LOCALHOST), |address| address.ip())
}

impl Client {
    /// Takes what has come, unless enough waits to be heard: one that never stops waits itself then.
    fn read(&mut self) {
        let mut bytes = [0; 4_096];
        while self.input.len() < PER_TURN && !self.gone {
            match self.stream.read(&mut bytes) {
                Ok(0) => self.gone = true,
                Ok(length) => {
                    let decoder = &mut self.decoder;
                    self.input.extend(bytes[..length].iter().filter_map(|byte| decoder.push(*byte)));
                    // A flood of what is no message ends a turn, too.
                    if self.input.is_empty() {
                        break;
                    }
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => {
                    self.gone = error.kind() != ErrorKind::WouldBlock;
                    break;
                }
            }
        }
    }

    fn flush(&mut self) {
        while !self.output.is_empty() && !self.gone {
            match self.stream.write(&self.output) {
                Ok(0) => self.gone = true,
                Ok(written) => drop(self.output.drain(..written)),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => {
                    self.gone = error.kind() != ErrorKind::WouldBlock;
                    break;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_can_core::frame::Id;

    fn server() -> Server {
        let listen = "127.0.0.1:0".parse().unwrap();
        Server::bind(ServerOptions { listen, bus: "can0".into(), beacon: false, only_from: Vec::new() })
            .unwrap()
    }

    /// Turns until `text` has come to the client; gives the frames that the server took meanwhile.
    fn until(server: &mut Server, client: &mut TcpStream, text: &str) -> Vec<Frame> {
        client.set_nonblocking(true).unwrap();
        let (mut heard, mut frames) = (Vec::new(), Vec::new());
        for _ in 0..2_000 {
            server.turn(0, 1_500_000_000, |frame| frames.push(*frame));
            let mut bytes = [0; 512];
            if let Ok(length) = client.read(&mut bytes) {
                heard.extend_from_slice(&bytes[..length]);
            }
            if String::from_utf8_lossy(&heard).contains(text) {
                return frames;
            }
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        panic!("{text} never came: {:?}", String::from_utf8_lossy(&heard));
    }

    fn raw(server: &mut Server) -> TcpStream {
        let mut client = TcpStream::connect(server.address()).unwrap();
        until(server, &mut client, "< hi >");
        client.write_all(b"< open can0 >< rawmode >").unwrap();
        until(server, &mut client, "< ok >< ok >");
        client
    }

    #[test]
    fn clients_hear_the_bus_and_each_other_but_not_themselves() {
        let mut server = server();
        let (mut first, mut second) = (raw(&mut server), raw(&mut server));
        first.write_all(b"< send 123 2 1 f1 >").unwrap();
        let taken = until(&mut server, &mut second, "< frame 123 1.500000 01F1 >");
        assert_eq!(taken, [Frame::classic(Id::Standard(0x123), &[1, 0xf1])]);
        server.tell(&Frame::classic(Id::Extended(7), &[9]), 0);
        until(&mut server, &mut first, "< frame 00000007 0.000000 09 >");
        server.tell(&Frame::remote(Id::Standard(7), 1).unwrap(), 0);
        let counters = server.counters();
        assert_eq!((counters.frames_in, counters.frames_out, counters.not_carried), (1, 3, 1));
    }

    #[test]
    fn a_client_of_a_computer_that_is_not_listened_to_is_not_let_in() {
        let options = ServerOptions { only_from: vec![[10, 0, 0, 2].into()], ..server().options };
        let mut server =
            Server::bind(ServerOptions { listen: "127.0.0.1:0".parse().unwrap(), ..options }).unwrap();
        let _client = TcpStream::connect(server.address()).unwrap();
        while server.counters().cut_off == 0 {
            server.turn(0, 0, |_| ());
        }
        assert_eq!(server.counters().clients, 0);
    }

    #[test]
    fn another_bus_and_frames_before_raw_mode_are_refused_with_the_reason() {
        let mut server = server();
        let mut client = TcpStream::connect(server.address()).unwrap();
        client.write_all(b"< send 1 0 >").unwrap();
        assert!(until(&mut server, &mut client, "< error open the bus").is_empty());
        client.write_all(b"< open can9 >").unwrap();
        until(&mut server, &mut client, "no bus can9: this server has can0");
    }

    #[test]
    fn one_that_never_stops_is_heard_a_little_in_each_turn_and_all_in_the_end() {
        let mut server = server();
        let (loud, mut quiet) = (raw(&mut server), raw(&mut server));
        let said = 5_000;
        loud.set_nonblocking(false).unwrap();
        let mut speaker = loud.try_clone().unwrap();
        let speaking = std::thread::spawn(move || speaker.write_all("< send 1 0 >".repeat(said).as_bytes()));
        let (mut heard, mut turns, mut bytes) = (0, 0, [0; 65_536]);
        while heard < said {
            let mut in_turn = 0;
            server.turn(0, 0, |_| in_turn += 1);
            assert!(in_turn <= PER_TURN, "{in_turn} in one turn");
            (heard, turns) = (heard + in_turn, turns + 1);
            let _ = quiet.read(&mut bytes); // it hears them all, and has to read
            assert!(turns < 2_000_000, "only {heard} were heard");
        }
        speaking.join().unwrap().unwrap();
        assert_eq!((server.counters().frames_in, server.counters().cut_off), (said as u64, 0));
    }

    #[test]
    fn message_that_never_ends_is_counted_and_a_client_that_goes_on_so_is_cut_off() {
        let mut server = server();
        let mut client = raw(&mut server);
        client.set_nonblocking(false).unwrap();
        client.write_all(format!("< {} >< echo >", "x".repeat(300)).as_bytes()).unwrap();
        until(&mut server, &mut client, "< echo >");
        assert_eq!((server.counters().refused, server.counters().clients), (1, 1));
        client.set_nonblocking(false).unwrap();
        client.write_all("<".repeat(2 * PATIENCE as usize + 10).as_bytes()).unwrap();
        while server.counters().cut_off == 0 {
            server.turn(0, 0, |_| ());
        }
        assert_eq!(server.counters().clients, 0);
    }

    #[test]
    fn one_that_talks_nonsense_or_does_not_read_is_cut_off_and_the_others_go_on() {
        let mut server = server();
        let mut good = raw(&mut server);
        let mut bad = TcpStream::connect(server.address()).unwrap();
        until(&mut server, &mut bad, "< hi >");
        bad.write_all("< fly >".repeat(200).as_bytes()).unwrap();
        let _deaf = raw(&mut server);
        for _ in 0..400_000 {
            server.tell(&Frame::classic(Id::Standard(1), &[0; 8]), 0);
            if server.clients.iter().any(|client| client.output.len() > BACKLOG) {
                break;
            }
            let mut bytes = [0; 4_096];
            let _ = good.read(&mut bytes);
        }
        server.turn(0, 0, |_| ());
        assert!(server.counters().cut_off >= 1, "{:?}", server.counters());
        assert!(server.counters().clients <= 2);
    }
}
