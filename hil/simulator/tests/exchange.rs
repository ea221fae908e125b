//! The simulator over a real socket.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a panic here is a failed test")]

use bateleur_messages::frame::Decoder;
use bateleur_messages::hil::{Actuators, PILOT_TAKE_OFF, Packet, PilotOrder};
use bateleur_messages::{Custom, RawAnalog, RawGps};
use bateleur_simulator::truth::{self, TruthRecord};
use bateleur_simulator::{Counters, Options, Server};
use std::net::{SocketAddr, UdpSocket};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

const CYCLE_NS: u64 = 20_000_000;
const START_NS: u64 = 3_000_000_000;

struct Running {
    address: SocketAddr,
    stop: Arc<AtomicBool>,
    thread: JoinHandle<Counters>,
}

impl Running {
    fn start(options: Options) -> Self {
        let options = Options { listen: "127.0.0.1:0".parse().unwrap(), ..options };
        let mut server = Server::bind(&options).unwrap();
        let address = server.address();
        let stop = Arc::new(AtomicBool::new(false));
        let seen = Arc::clone(&stop);
        let thread = std::thread::spawn(move || server.run(&seen).unwrap());
        Self { address, stop, thread }
    }

    fn end(self) -> Counters {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.join().unwrap()
    }
}

struct Computer {
    socket: UdpSocket,
    sequence: u64,
    sticks: Custom,
}

struct Answer {
    bytes: Vec<u8>,
    analog: RawAnalog,
    custom: Custom,
    gps: Option<RawGps>,
}

impl Answer {
    fn read(bytes: &[u8]) -> Self {
        let (mut analog, mut custom, mut gps) = (None, None, None);
        for frame in Decoder::new().extend(bytes) {
            match Packet::of(&frame).unwrap() {
                Packet::Analog(packet) => analog = Some(packet),
                Packet::Custom(packet) => custom = Some(packet),
                Packet::Gps(packet) => gps = Some(packet),
                Packet::Range(_) => {}
                other => panic!("{other:?} in an answer"),
            }
        }
        Self { bytes: bytes.to_vec(), analog: analog.unwrap(), custom: custom.unwrap(), gps }
    }
}

impl Computer {
    fn of(simulator: &Running) -> Self {
        let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
        socket.connect(simulator.address).unwrap();
        socket.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        let sticks = Custom {
            pilot_aileron_us: 1500,
            pilot_elevator_us: 1500,
            pilot_rudder_us: 1500,
            pilot_throttle_us: 1000,
            ..Custom::default()
        };
        Self { socket, sequence: 0, sticks }
    }

    fn send(&mut self, module_ns: u64) {
        self.sequence += 1;
        let actuators = Actuators {
            module_ns,
            sequence: self.sequence,
            aileron_left_us: self.sticks.pilot_aileron_us,
            aileron_right_us: self.sticks.pilot_aileron_us,
            elevator_us: self.sticks.pilot_elevator_us,
            rudder_us: self.sticks.pilot_rudder_us,
            throttle_us: self.sticks.pilot_throttle_us,
            ..Actuators::default()
        };
        let mut bytes = Vec::new();
        Packet::Actuators(actuators).write(&mut bytes);
        self.socket.send(&bytes).unwrap();
    }

    fn receive(&mut self) -> Vec<u8> {
        let mut bytes = vec![0; 2048];
        let length = self.socket.recv(&mut bytes).unwrap();
        bytes.truncate(length);
        bytes
    }

    fn exchange(&mut self, module_ns: u64) -> Answer {
        self.send(module_ns);
        Answer::read(&self.receive())
    }

    fn hears_nothing(&self) -> bool {
        self.socket.set_read_timeout(Some(Duration::from_millis(50))).unwrap();
        let silent = self.socket.recv(&mut [0; 2048]).is_err();
        self.socket.set_read_timeout(Some(Duration::from_secs(5))).unwrap();
        silent
    }

    fn order_take_off(&mut self) {
        let order = PilotOrder { order: PILOT_TAKE_OFF, reserved: 0 };
        let mut bytes = Vec::new();
        Packet::Pilot(order).write(&mut bytes);
        self.socket.send(&bytes).unwrap();
        assert_eq!(self.receive(), bytes, "the order comes back as an echo");
    }

    /// Flies `cycles` with the sticks passed straight through; gives all bytes received.
    fn pass_through(&mut self, cycles: u64) -> Vec<u8> {
        let mut all = Vec::new();
        for cycle in 1..=cycles {
            let answer = self.exchange(START_NS + cycle * CYCLE_NS);
            self.sticks = answer.custom;
            all.extend(answer.bytes);
        }
        all
    }
}

fn logged(folder: &Path, name: &str) -> Options {
    Options { truth: Some(folder.join(name)), ..Options::default() }
}

#[test]
fn repeated_time_gets_identical_bytes_and_a_fix_comes_once() {
    let simulator = Running::start(Options::default());
    let mut computer = Computer::of(&simulator);
    let (mut fixes, mut last_fix_ns) = (0, 0);
    for cycle in 0..100 {
        let now = START_NS + cycle * CYCLE_NS;
        let first = computer.exchange(now);
        let again = computer.exchange(now);
        assert_eq!(first.bytes, again.bytes);
        assert_eq!(first.analog.measured_ns, now);
        assert_eq!(first.analog.interval_ns, if cycle == 0 { 0 } else { CYCLE_NS });
        if let Some(fix) = first.gps {
            assert!(fix.measured_ns > last_fix_ns && fix.measured_ns < now);
            (fixes, last_fix_ns) = (fixes + 1, fix.measured_ns);
        }
    }
    assert_eq!(fixes, 9, "five fixes a second, the first of them 120 ms late");
    assert_eq!(simulator.end(), Counters { answers: 100, repeated: 100, ..Counters::default() });
}

#[test]
fn lost_packets_are_caught_up_with() {
    let simulator = Running::start(Options::default());
    let mut computer = Computer::of(&simulator);
    computer.exchange(START_NS);
    let late = computer.exchange(START_NS + 5 * CYCLE_NS);
    assert_eq!(late.analog.measured_ns, START_NS + 5 * CYCLE_NS);
    assert_eq!(late.analog.interval_ns, 5 * CYCLE_NS);
    let odd = computer.exchange(START_NS + 5 * CYCLE_NS + 7_600_000);
    assert_eq!(odd.analog.interval_ns, 7_500_000, "whole plant steps");
    simulator.end();
}

#[test]
fn older_packet_is_ignored() {
    let simulator = Running::start(Options::default());
    let mut computer = Computer::of(&simulator);
    computer.exchange(START_NS);
    computer.send(START_NS - CYCLE_NS);
    assert!(computer.hears_nothing());
    computer.exchange(START_NS + CYCLE_NS);
    assert_eq!(simulator.end().older, 1);
}

#[test]
fn module_that_starts_anew_is_followed_after_a_second() {
    let simulator = Running::start(Options::default());
    let mut computer = Computer::of(&simulator);
    computer.exchange(START_NS);
    for cycle in 0..50 {
        computer.send(cycle * CYCLE_NS);
    }
    let answer = Answer::read(&computer.receive());
    assert_eq!(answer.analog.measured_ns, 49 * CYCLE_NS);
    let next = computer.exchange(50 * CYCLE_NS);
    assert_eq!((next.analog.measured_ns, next.analog.interval_ns), (50 * CYCLE_NS, CYCLE_NS));
    assert_eq!(simulator.end().clock_restarts, 1);
}

#[test]
fn pause_is_skipped_and_counted() {
    let folder = tempfile::tempdir().unwrap();
    let simulator = Running::start(logged(folder.path(), "pause"));
    let mut computer = Computer::of(&simulator);
    computer.exchange(START_NS);
    let minute_ns = 60_000_000_000;
    let after = computer.exchange(START_NS + minute_ns);
    assert_eq!(after.analog.measured_ns, START_NS + minute_ns);
    assert_eq!(after.analog.interval_ns, CYCLE_NS);
    let next = computer.exchange(START_NS + minute_ns + CYCLE_NS);
    assert_eq!(next.analog.interval_ns, CYCLE_NS);
    let counters = simulator.end();
    assert_eq!((counters.pauses, counters.skipped_ns), (1, minute_ns - CYCLE_NS));
}

#[test]
fn garbage_and_strangers_are_counted_and_disturb_nobody() {
    let flights = [false, true].map(|disturbed| {
        let simulator = Running::start(Options::default());
        let mut computer = Computer::of(&simulator);
        let mut stranger = Computer::of(&simulator);
        let mut bytes = Vec::new();
        for cycle in 0..50 {
            if disturbed {
                for garbage in [&b"$TT"[..], b"", b"hello", b"$II\x01*\x01", &[0xff; 1500]] {
                    stranger.socket.send(garbage).unwrap();
                }
            }
            bytes.extend(computer.exchange(START_NS + cycle * CYCLE_NS).bytes);
        }
        assert!(stranger.hears_nothing());
        stranger.exchange(START_NS + 49 * CYCLE_NS);
        (bytes, simulator.end().garbage)
    });
    assert_eq!(flights[0].0, flights[1].0);
    assert_eq!((flights[0].1, flights[1].1), (0, 250));
}

#[test]
fn safety_pilot_takes_off_and_the_same_seed_gives_the_same_flight() {
    let folder = tempfile::tempdir().unwrap();
    let flights = ["first", "second"].map(|name| {
        let simulator = Running::start(logged(folder.path(), name));
        let mut computer = Computer::of(&simulator);
        computer.exchange(START_NS);
        computer.order_take_off();
        let bytes = computer.pass_through(50 * 60);
        assert_eq!(simulator.end().answers, 50 * 60 + 1);
        (bytes, std::fs::read(folder.path().join(name)).unwrap())
    });
    assert!(flights[0] == flights[1], "two flights with one seed differ");
    let records = truth::read(&folder.path().join("first")).unwrap();
    assert_eq!(records.len(), 50 * 60 + 1);
    flown_to_height(&records);
}

fn flown_to_height(records: &[TruthRecord]) {
    assert!(records.iter().all(|record| record.crashed == 0));
    let highest = records.iter().map(|record| -record.position_ned_m[2]).fold(0.0, f64::max);
    assert!(highest > 100.0, "{highest} m");
    let last = records.last().unwrap();
    assert_eq!((last.on_ground, last.time_ns), (0, START_NS + 50 * 60 * CYCLE_NS));
    assert!(last.airspeed_mps > 15.0 && last.timers_us[4] > 1000);
}

#[test]
fn free_running_plant_keeps_its_own_time() {
    let simulator = Running::start(Options { free_running: true, ..Options::default() });
    let mut computer = Computer::of(&simulator);
    computer.send(START_NS);
    let first = Answer::read(&computer.receive());
    let start = Instant::now();
    let mut last_ns = first.analog.measured_ns;
    assert!(last_ns > START_NS && last_ns <= START_NS + 2 * CYCLE_NS);
    for _ in 0..25 {
        let answer = Answer::read(&computer.receive());
        assert_eq!(answer.analog.measured_ns, last_ns + CYCLE_NS);
        last_ns = answer.analog.measured_ns;
    }
    let took = start.elapsed();
    assert!((Duration::from_millis(400)..Duration::from_millis(900)).contains(&took), "{took:?}");
    simulator.end();
}

#[test]
fn taken_port_is_named_with_the_mend() {
    let simulator = Running::start(Options::default());
    let error = Server::bind(&Options { listen: simulator.address, ..Options::default() }).unwrap_err();
    let message = error.to_string();
    assert!(message.contains(&simulator.address.to_string()) && message.contains("--listen"), "{message}");
    simulator.end();
}
