//! Gateways with real sockets on this machine. No durations are judged: what has to come is waited for.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

use std::net::{SocketAddr, UdpSocket};
use std::os::fd::BorrowedFd;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use bateleur_can::node::{Node, Options};
use bateleur_can::status;
use bateleur_can_core::bus::{Bus, BusError, BusName, BusState, Sent};
use bateleur_can_core::{Frame, Id, Protocol, Settings, State};

const PATIENCE: Duration = Duration::from_secs(60);

/// What a test says on a bus, what it heard there, and how many frames its controller takes before it is full.
#[derive(Default)]
struct Ends {
    says: Vec<Frame>,
    heard: Vec<Frame>,
    room: Option<usize>,
    tried: u64,
    off: bool,
    broken: bool,
}

/// A bus whose other end the test holds.
#[derive(Clone, Default)]
struct Held(Arc<Mutex<Ends>>);

impl Bus for Held {
    fn receive(&mut self) -> Result<Option<Frame>, BusError> {
        let mut ends = self.0.lock().unwrap();
        if ends.broken {
            return Err(BusError::Ended { bus: "held".into() });
        }
        Ok((!ends.says.is_empty()).then(|| ends.says.remove(0)))
    }

    fn send(&mut self, frame: &Frame) -> Result<Sent, BusError> {
        let mut ends = self.0.lock().unwrap();
        ends.tried += 1;
        if ends.off {
            return Ok(Sent::Full);
        }
        if let Some(room) = &mut ends.room {
            let Some(left) = room.checked_sub(1) else { return Ok(Sent::Full) };
            *room = left;
        }
        ends.heard.push(*frame);
        Ok(Sent::Taken)
    }

    fn readable(&self) -> Option<BorrowedFd<'_>> {
        None
    }

    fn state(&self) -> BusState {
        if self.0.lock().unwrap().off { BusState::Off } else { BusState::Active }
    }
}

fn options(name: &str, identity: u64, peers: Vec<SocketAddr>) -> Options {
    let settings = Settings::new(identity, identity as u32, peers);
    Options {
        name: name.into(),
        bus: BusName::None,
        listen: "127.0.0.1:0".parse().unwrap(),
        to_bus: settings.ring.clone(),
        settings,
        server: None,
        status: None,
        log: None,
    }
}

/// Turns of all of them until `done`.
fn until(nodes: &mut [&mut Node], said: &mut Vec<String>, mut done: impl FnMut(&[&mut Node]) -> bool) {
    let begun = Instant::now();
    while !done(nodes) {
        assert!(begun.elapsed() < PATIENCE, "it never came; {said:?}");
        for node in nodes.iter_mut() {
            node.turn(1_000_000, &mut |text| said.push(text.to_owned()));
        }
    }
}

fn frame(id: u16) -> Frame {
    Frame::classic(Id::Standard(id), &[1, 2, 3])
}

/// Two that know of each other's address.
fn two() -> (Node, Held, Node, Held) {
    let (first_bus, second_bus) = (Held::default(), Held::default());
    let first = Node::with_bus(options("first", 1, vec![]), Box::new(first_bus.clone())).unwrap();
    let second_options = options("second", 2, vec![first.address().unwrap()]);
    let second = Node::with_bus(second_options, Box::new(second_bus.clone())).unwrap();
    (first, first_bus, second, second_bus)
}

#[test]
fn two_gateways_carry_frames_from_bus_to_bus_and_lose_none() {
    let (mut first, first_bus, mut second, second_bus) = two();
    let mut said = Vec::new();
    first_bus.0.lock().unwrap().says = (0..1_000).map(|id| frame(id % 0x700)).collect();
    second_bus.0.lock().unwrap().says = vec![frame(0x7ff)];
    until(&mut [&mut first, &mut second], &mut said, |_| {
        second_bus.0.lock().unwrap().heard.len() == 1_000 && !first_bus.0.lock().unwrap().heard.is_empty()
    });
    let status = serde_json::to_value(first.status()).unwrap();
    assert_eq!((status["state"].as_str(), &status["lost_frames"]), (Some("forward"), &0.into()));
    assert!(status::text(&status).contains("target   0000000000000002"), "{}", status::text(&status));
    assert!(said.iter().any(|text| text.contains("found 0000000000000001")), "{said:?}");
}

#[test]
fn a_bus_whose_queue_is_full_gets_the_rest_later_the_lowest_identifier_first() {
    let (mut first, first_bus, mut second, second_bus) = two();
    let mut said = Vec::new();
    second_bus.0.lock().unwrap().room = Some(1);
    first_bus.0.lock().unwrap().says = vec![frame(3), frame(1), frame(2)];
    until(&mut [&mut first, &mut second], &mut said, |nodes| {
        let waiting = nodes[1].status().waiting_for_bus;
        let heard = second_bus.0.lock().unwrap().heard.len();
        waiting == 2 && heard == 1
    });
    second_bus.0.lock().unwrap().room = None;
    until(&mut [&mut first, &mut second], &mut said, |_| second_bus.0.lock().unwrap().heard.len() == 3);
    let heard = second_bus.0.lock().unwrap().heard.clone();
    let rest: Vec<Frame> = heard[1..].to_vec();
    assert!(rest.is_sorted_by_key(Frame::priority), "{heard:?}");
}

#[test]
fn bus_that_is_off_is_not_tried_all_the_time_and_gets_what_waited_as_soon_as_it_is_back() {
    let (mut first, first_bus, mut second, second_bus) = two();
    let mut said = Vec::new();
    second_bus.0.lock().unwrap().off = true;
    first_bus.0.lock().unwrap().says = vec![frame(3), frame(1), frame(2)];
    until(&mut [&mut first, &mut second], &mut said, |nodes| nodes[1].status().waiting_for_bus == 3);
    let begun = Instant::now();
    second_bus.0.lock().unwrap().tried = 0;
    while begun.elapsed() < Duration::from_millis(30) {
        second.turn(0, &mut |text| said.push(text.to_owned()));
    }
    let tried = second_bus.0.lock().unwrap().tried;
    assert!(u128::from(tried) <= 2 + begun.elapsed().as_millis() / 100, "{tried}, every tenth of a second");
    second_bus.0.lock().unwrap().off = false;
    second.turn(0, &mut |text| said.push(text.to_owned()));
    assert_eq!(second_bus.0.lock().unwrap().heard, [frame(1), frame(2), frame(3)]);
}

#[test]
fn a_bus_that_breaks_is_opened_again_and_said() {
    let (mut first, first_bus, mut second, _) = two();
    let mut said = Vec::new();
    first_bus.0.lock().unwrap().broken = true;
    until(&mut [&mut first, &mut second], &mut said, |nodes| nodes[0].counters().bus_reopened == 1);
    assert!(said.iter().any(|text| text.contains("held: it has ended")), "{said:?}");
    assert!(said.iter().any(|text| text.contains("is there again")), "{said:?}");
}

#[test]
fn reason_for_which_a_bus_can_not_be_opened_again_is_said() {
    let bus = Held::default();
    let gone = Options { bus: "slcan:/dev/nowhere9".parse().unwrap(), ..options("gone", 1, vec![]) };
    let mut node = Node::with_bus(gone, Box::new(bus.clone())).unwrap();
    bus.0.lock().unwrap().broken = true;
    let mut said = Vec::new();
    let begun = Instant::now();
    while !said.iter().any(|text: &String| text.contains("plugged in")) {
        assert!(begun.elapsed() < PATIENCE, "{said:?}");
        node.turn(1_000_000, &mut |text| said.push(text.to_owned()));
    }
}

#[test]
fn frames_that_the_log_did_not_take_are_counted() {
    let bus = Held::default();
    let full = Options { log: Some("/dev/full".into()), ..options("full", 1, vec![]) };
    let mut node = Node::with_bus(full, Box::new(bus.clone())).unwrap();
    bus.0.lock().unwrap().says = vec![frame(1); 1_000];
    let mut said = Vec::new();
    until(&mut [&mut node], &mut said, |_| bus.0.lock().unwrap().says.is_empty());
    let status = serde_json::to_value(node.status()).unwrap();
    assert!(status["counters"]["log_unwritten"].as_u64().unwrap_or(0) > 0, "{status}");
}

#[test]
fn cannelloni_is_spoken_to_a_peer_in_its_own_bytes() {
    let peer = UdpSocket::bind("127.0.0.1:0").unwrap();
    peer.set_read_timeout(Some(PATIENCE)).unwrap();
    let mut options = options("cannelloni", 1, vec![peer.local_addr().unwrap()]);
    options.settings.protocol = Protocol::Cannelloni;
    let bus = Held::default();
    let mut node = Node::with_bus(options, Box::new(bus.clone())).unwrap();
    let mut said = Vec::new();
    bus.0.lock().unwrap().says = vec![Frame::classic(Id::Standard(0x123), &[1, 2, 3])];
    until(&mut [&mut node], &mut said, |nodes| nodes[0].counters().datagrams_out == 1);
    let mut bytes = [0; 64];
    let length = peer.recv(&mut bytes).unwrap();
    assert_eq!(bytes[..length], [2, 0, 0, 0, 1, 0, 0, 1, 0x23, 3, 1, 2, 3]);
    let remote = [2, 0, 2, 0, 1, 0x40, 0, 1, 0x23, 4];
    peer.send_to(&remote, node.address().unwrap()).unwrap();
    until(&mut [&mut node], &mut said, |_| !bus.0.lock().unwrap().heard.is_empty());
    assert_eq!(bus.0.lock().unwrap().heard, [Frame::remote(Id::Standard(0x123), 4).unwrap()]);
    assert_eq!(serde_json::to_value(State::Forward).unwrap(), "forward");
}

#[test]
fn a_foreign_packet_at_the_right_port_is_said_and_harms_nobody() {
    let mut node = Node::with_bus(options("alone", 1, vec![]), Box::new(Held::default())).unwrap();
    let stranger = UdpSocket::bind("127.0.0.1:0").unwrap();
    stranger.send_to(b"GET / HTTP/1.1\r\n", node.address().unwrap()).unwrap();
    let mut said = Vec::new();
    until(&mut [&mut node], &mut said, |nodes| nodes[0].counters().foreign == 1);
    assert!(said.iter().any(|text| text.contains("none of a gateway's")), "{said:?}");
}

#[test]
fn the_status_is_told_to_whoever_asks_and_a_second_gateway_of_the_name_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("status");
    let with_status = || Options { status: Some(path.clone()), ..options("wing", 7, vec![]) };
    let mut node = Node::with_bus(with_status(), Box::new(Held::default())).unwrap();
    let asker = std::thread::spawn({
        let path = path.clone();
        move || status::ask(&path).unwrap()
    });
    let mut said = Vec::new();
    until(&mut [&mut node], &mut said, |_| asker.is_finished());
    let told = asker.join().unwrap();
    assert_eq!((told["name"].as_str(), told["state"].as_str()), (Some("wing"), Some("discover")));
    let second = Node::with_bus(with_status(), Box::new(Held::default()));
    assert!(second.err().unwrap().to_string().contains("runs already"));
    drop(node);
    assert!(!path.exists());
}

#[test]
fn a_port_that_is_taken_is_refused_with_what_helps() {
    let other = UdpSocket::bind("127.0.0.1:0").unwrap();
    let taken = Options { listen: other.local_addr().unwrap(), ..options("late", 1, vec![]) };
    let error = Node::with_bus(taken, Box::new(Held::default())).err().unwrap().to_string();
    assert!(error.contains("--listen"), "{error}");
}

#[test]
fn a_log_is_replayed_into_the_network() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("a.log");
    std::fs::write(&log, "(5.000000) can0 001#AA\n(5.010000) can0 002#BB\n").unwrap();
    let heard = Held::default();
    let mut listener = Node::with_bus(options("listener", 1, vec![]), Box::new(heard.clone())).unwrap();
    let mut player_options = options("player", 2, vec![listener.address().unwrap()]);
    player_options.bus = BusName::Replay(log);
    player_options.log = Some(folder.path().join("b.log"));
    let mut player = Node::new(player_options).unwrap();
    let mut said = Vec::new();
    until(&mut [&mut player, &mut listener], &mut said, |_| heard.0.lock().unwrap().heard.len() == 2);
    until(&mut [&mut player, &mut listener], &mut said, |nodes| nodes[0].status().bus_state.is_none());
    drop(player);
    let written = std::fs::read_to_string(folder.path().join("b.log")).unwrap();
    assert_eq!(written.lines().count(), 2, "{written}");
    assert!(written.lines().next().unwrap().ends_with("001#AA"), "{written}");
}
