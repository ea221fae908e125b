//! What is not Bateleur's: the simulator, the network, the serial line. They may be busy, gone, silent or mad.

use std::net::UdpSocket;
use std::time::Duration;

use bateleur_messages::ground::Order;
use bateleur_tests::{
    Ended, Ground, Process, Started, Traces, alone, among_others, bateleur, executive_of, flight_schedule,
    process_named,
};
use rustix::process::Signal;

fn fly(choices: &[&str]) -> Started {
    let schedule = flight_schedule();
    let mut arguments = vec!["fly", "--format", "json", "--schedule", schedule.to_str().unwrap()];
    arguments.extend(choices);
    bateleur(&arguments)
}

fn simulator_of(flight: &Started) -> Process {
    process_named(flight.pid(), "simulator")
}

/// A port that nobody uses just now.
fn free_port() -> u16 {
    UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

fn assert_failed_by_simulator(ended: Ended) {
    let ended = ended.expect_code(1);
    let summary = ended.summary();
    assert_eq!(summary["completed"], false);
    assert!(summary["failure"].as_str().unwrap().contains("simulator"), "{}", summary["failure"]);
    let told = ended.faults().into_iter().any(|fault| {
        fault.partition == "hil_interface"
            && fault.error == "application_error"
            && fault.detail.contains("does not answer")
    });
    assert!(told, "the health log does not have it: {:#?}", ended.faults());
}

#[test]
fn port_of_the_simulator_that_is_taken_is_named_and_nothing_is_left() {
    let taken = UdpSocket::bind("127.0.0.1:0").unwrap();
    let address = taken.local_addr().unwrap().to_string();
    let ended = fly(&["--fast", "--simulator", &address]).end().expect_code(2);
    let ended = ended.expect_words(&[&address, "is taken", "--simulator"]);
    assert!(!ended.stderr.contains("partitions are ready"));
}

#[test]
fn simulator_killed_in_virtual_time_ends_the_flight_with_its_reason() {
    let _turn = among_others();
    let mut flight = fly(&["--fast"]);
    flight.await_words("1 of 9 way-points");
    simulator_of(&flight).signal(Signal::KILL);
    assert_failed_by_simulator(flight.end());
}

#[test]
fn simulator_stopped_in_virtual_time_fails_the_flight_and_nothing_hangs() {
    let _turn = among_others();
    let mut flight = fly(&["--fast"]);
    flight.await_words("1 of 9 way-points");
    let simulator = simulator_of(&flight);
    simulator.signal(Signal::STOP);
    let ended = flight.end().expect_code(1);
    assert!(!simulator.is_alive(), "the simulator is left");
    let summary = ended.summary();
    assert_eq!(summary["completed"], false);
    let failure = summary["failure"].as_str().unwrap();
    assert!(failure.contains("has not answered for") && failure.contains("SIGSTOP"), "{failure}");
    assert!(
        ended
            .faults()
            .iter()
            .any(|fault| fault.partition == "hil_interface" && fault.error == "application_error")
    );
}

/// Ports of the UDP sockets of a process.
fn udp_ports(process: &Process) -> Vec<u16> {
    let entries = std::fs::read_dir(format!("/proc/{}/fd", process.pid)).into_iter().flatten().flatten();
    let targets: Vec<String> = entries
        .filter_map(|entry| std::fs::read_link(entry.path()).ok())
        .map(|target| target.to_string_lossy().into_owned())
        .collect();
    let table = std::fs::read_to_string(format!("/proc/{}/net/udp", process.pid)).unwrap_or_default();
    let mine = table.lines().skip(1).filter_map(|line| {
        let fields: Vec<&str> = line.split_ascii_whitespace().collect();
        let own = targets.contains(&format!("socket:[{}]", fields.get(9)?));
        let port = u16::from_str_radix(fields.get(1)?.rsplit(':').next()?, 16).ok()?;
        own.then_some(port)
    });
    mine.collect()
}

#[test]
fn garbage_thrown_at_both_udp_sockets_does_not_disturb_the_flight() {
    let _turn = among_others();
    let port = free_port();
    let mut flight = fly(&["--fast", "--simulator", &format!("127.0.0.1:{port}")]);
    flight.await_words("partitions are ready");
    let interface = process_named(executive_of(flight.pid()).pid, "hil_interface");
    let mut ports = udp_ports(&interface);
    assert!(!ports.is_empty(), "hil_interface has a socket");
    ports.push(port);
    let thrower = UdpSocket::bind("127.0.0.1:0").unwrap();
    let mut seed = 1_u64;
    let mut thrown = 0;
    while interface.is_alive() && thrown < 200_000 {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let length = (seed >> 33) as usize % 600;
        let mut garbage: Vec<u8> =
            (0..length).map(|place| (seed >> (place % 56)) as u8 ^ place as u8).collect();
        if seed.is_multiple_of(3) {
            garbage.splice(0..0, *b"$II"); // looks like the beginning of a packet
        }
        for port in &ports {
            let _ = thrower.send_to(&garbage, ("127.0.0.1", *port)); // a full buffer is fine
        }
        thrown += 1;
        std::thread::sleep(Duration::from_micros(200));
    }
    assert!(thrown > 100, "only {thrown} datagrams were thrown");
    let ended = flight.end().expect_code(0);
    assert_eq!(ended.summary()["completed"], true);
}

/// The module without a simulator, with the test at the other end of the serial line.
fn run_with_device(device: &str, seconds: &str) -> Started {
    let schedule = flight_schedule();
    let set = format!("command.device={device}");
    bateleur(&["run", "--schedule", schedule.to_str().unwrap(), "--set", &set, "--until", seconds])
}

#[test]
fn serial_line_that_is_not_there_at_the_start_is_told_once_and_the_others_go_on() {
    let _turn = among_others();
    let schedule = flight_schedule();
    let set = "command.device=/dev/nowhere";
    let run = ["run", "--fast", "--schedule", schedule.to_str().unwrap(), "--set", set, "--until", "10"];
    assert_line_is_told(&bateleur(&run).end().expect_code(0), "/dev/nowhere");
}

fn assert_line_is_told(ended: &Ended, device: &str) {
    let of_command: Vec<_> = ended
        .faults()
        .into_iter()
        .filter(|fault| fault.partition == "command" && fault.error == "application_error")
        .collect();
    assert_eq!(of_command.len(), 1, "{of_command:#?}");
    assert!(of_command[0].detail.contains(device), "{of_command:?}");
    let windows = ended.windows();
    for partition in bateleur_tests::NINE {
        let of = || windows.iter().filter(|window| window.partition == partition);
        let (all, closed) = (of().count(), of().filter(|window| window.closed_ns.is_some()).count());
        assert!(closed * 10 >= all * 9, "{partition} closed {closed} of {all} windows");
    }
}

#[test]
fn simulator_killed_leaves_nothing() {
    let _turn = among_others();
    let mut flight = fly(&["--fast"]);
    flight.await_words("partitions are ready");
    let traces = Traces::of(flight.pid());
    simulator_of(&flight).signal(Signal::KILL);
    flight.end().expect_code(1);
    traces.expect_gone();
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn simulator_killed_on_the_wall_clock_ends_the_flight_with_its_reason() {
        let _turn = alone();
        let mut flight = fly(&[]);
        flight.await_words("waiting for the estimator");
        simulator_of(&flight).signal(Signal::KILL);
        assert_failed_by_simulator(flight.end_within(Duration::from_secs(30)));
    }

    #[test]
    fn garbage_and_half_frames_on_the_serial_line_do_not_keep_an_order_from_its_answer() {
        let _turn = alone();
        let mut ground = Ground::open();
        let mut module = run_with_device(&ground.device, "120");
        module.await_words("partitions are ready");
        let all: Vec<u8> = (0..=255).collect();
        ground.send(&all);
        ground.send(b"$AA\x01"); // no end
        ground.send(b"$$$$**$NN");
        ground.send(&[b'$'; 100]);
        ground.send(b"$HH\x01*\x7f"); // another checksum
        let order = Order::Hil { on: false };
        let answer = bateleur_tests::await_some(Duration::from_secs(20), || {
            ground.order(&order); // noise may cost the first one
            ground.await_answer(Duration::from_secs(1))
        });
        let answer = answer.expect("an answer");
        let told = format!("{answer:?}");
        assert_eq!(u32::from(answer.letter), u32::from(b'H'), "{told}");
        module.signal(Signal::TERM);
        module.end().expect_code(0);
    }

    #[test]
    fn serial_line_that_vanishes_is_told_once_and_the_others_go_on() {
        let _turn = alone();
        let ground = Ground::open();
        let device = ground.device.clone();
        let mut module = run_with_device(&device, "4");
        module.await_words("partitions are ready");
        std::thread::sleep(Duration::from_millis(500));
        drop(ground);
        let ended = module.end().expect_code(0);
        assert_line_is_told(&ended, &device);
    }
}
