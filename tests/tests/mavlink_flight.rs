//! Flights that are not `bateleur fly`'s own: by orders in MAVLink alone, and with a simulator that somebody else has started.

use std::io::{BufRead, BufReader};
use std::net::UdpSocket;
use std::process::{Child, Command, Stdio};

use bateleur_mavlink::Encoder;
use bateleur_mavlink::common::{COMMAND_LONG_DATA, MavCmd, MavMessage};
use bateleur_tests::{
    PATIENCE, Peer, Started, TWO_LAPS, among_others, await_some, bateleur, edited, flight_schedule, program,
};
use serde_json::{Value, json};

/// This project's simulator, with nobody to look after it; it ends with its standard input.
struct Simulator {
    child: Child,
    address: String,
}

impl Simulator {
    fn start(arguments: &[&str]) -> Self {
        let mut child = Command::new(program("simulator"))
            .args(["--listen", "127.0.0.1:0", "--ready", "--until-stdin-closes"])
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
        let ready: Value = serde_json::from_str(&line).unwrap();
        let address = ready.as_object().unwrap().values().find_map(Value::as_str).unwrap().to_owned();
        Self { child, address }
    }

    /// Lets its safety pilot take off, as somebody else's program would.
    fn call_pilot(&self) {
        let line = UdpSocket::bind("127.0.0.1:0").unwrap();
        line.set_read_timeout(Some(std::time::Duration::from_millis(200))).unwrap();
        let mut order = Vec::new();
        let take_off =
            COMMAND_LONG_DATA { command: MavCmd::MAV_CMD_NAV_TAKEOFF, ..COMMAND_LONG_DATA::DEFAULT };
        Encoder::new(255, 190).write(&MavMessage::COMMAND_LONG(take_off), &mut order);
        let heard = await_some(PATIENCE, || {
            line.send_to(&order, &self.address).unwrap();
            line.recv(&mut [0; 512]).ok()
        });
        assert!(heard.is_some(), "the pilot does not hear");
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        drop(self.child.stdin.take());
        let _ = self.child.kill(); // it may have ended already
        let _ = self.child.wait(); // as above
    }
}

/// The module on the virtual clock, between a simulator and a ground station that both speak MAVLink, and the folder of its
/// schedule, in which Command has these attributes more.
fn by_mavlink(simulator: &Simulator, ground: &Peer, attributes: &str) -> (Started, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let schedule = folder.path().join("schedule.toml");
    let to_ground = format!(
        "network    = true\nattributes = {{ {attributes}device = \"/dev/nowhere\", mavlink = \"{}\" }}",
        ground.address()
    );
    std::fs::write(&schedule, edited(&[(r#"attributes = { device = "/dev/ttyS0" }"#, &to_ground)])).unwrap();
    let simulator_set = format!("hil_interface.simulator={}", simulator.address);
    let module = bateleur(&[
        "run",
        "--fast",
        "--schedule",
        schedule.to_str().unwrap(),
        "--set",
        "hil_interface.protocol=mavlink",
        "--set",
        &simulator_set,
        "--until",
        "3000",
    ]);
    (module, folder)
}

#[test]
fn aircraft_whose_ground_falls_silent_comes_back_and_circles_over_the_runway() {
    let _turn = among_others();
    let simulator = Simulator::start(&["--protocol", "mavlink", "--seed", "13"]);
    let Some(mut ground) = Peer::start("silence.py", &[&simulator.address]) else { return };
    let (module, _folder) =
        by_mavlink(&simulator, &ground, "lost_link = \"return\", lost_link_after = \"10s\", ");
    let said = ground.line();
    eprintln!("{said:#}");
    module.signal(rustix::process::Signal::TERM);
    module.end().expect_code(0);
    assert_eq!((&said["armed"], &said["reached"]), (&json!(true), &json!(2)));
    assert_eq!((&said["told"], &said["heard_again"]), (&json!(true), &json!(true)));
    assert_eq!(said["passed_while_lost"], json!([]), "the mission is left");
    // Two and a half radii at most lie between the circle and the place that it is flown about.
    let far = said["distances_m"][1].as_f64().unwrap();
    assert!(far < 250.0, "{far} m from the runway");
}

#[test]
fn simulator_that_somebody_else_started_is_flown_when_its_pilot_has_taken_off() {
    let _turn = among_others();
    let simulator = Simulator::start(&["--protocol", "mavlink", "--seed", "12"]);
    let schedule = flight_schedule();
    let mut flight = bateleur(&[
        "fly",
        "--fast",
        "--no-simulator",
        "--protocol",
        "mavlink",
        "--simulator",
        &simulator.address,
        "--format",
        "json",
        "--schedule",
        schedule.to_str().unwrap(),
    ]);
    flight.await_words("now the simulator's own pilot has to take off");
    simulator.call_pilot();
    let ended = flight.end().expect_code(0);
    // There is no truth of somebody else's simulator: what the aircraft says of itself.
    let run: Value =
        serde_json::from_slice(&std::fs::read(ended.folder().join("run.json")).unwrap()).unwrap();
    assert_eq!(run["mission"]["waypoints_reached"], TWO_LAPS.len(), "{run:#}");
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn two_laps_are_flown_by_mavlink_orders_alone() {
        let _turn = among_others();
        let simulator = Simulator::start(&["--protocol", "mavlink", "--seed", "11", "--wind", "3"]);
        let Some(mut ground) = Peer::start("flight.py", &[&simulator.address]) else { return };
        let (module, _folder) = by_mavlink(&simulator, &ground, "");
        let said = ground.line();
        eprintln!("{said:#}");
        module.signal(rustix::process::Signal::TERM);
        module.end().expect_code(0);
        for step in ["heard", "hil", "calibrated", "ready", "auto", "pilot", "armed"] {
            assert_eq!(said[step], true, "{step}");
        }
        assert_eq!((&said["laps"], &said["uploaded"]), (&json!([2, null]), &json!(0)));
        // Two laps of four way-points, and back to the first.
        assert_eq!(said["reached"], json!([0, 1, 2, 3, 0, 1, 2, 3, 0]));
        let height = |place: usize| said["heights"][place].as_f64().unwrap();
        assert!((height(0) - 160.0).abs() < 15.0 && (height(1) - 160.0).abs() < 15.0, "{}", said["heights"]);
        assert!(said["texts"].to_string().contains("the laps are flown"), "{}", said["texts"]);
        assert_eq!(said["mode"].as_u64().unwrap() & (128 + 32), 128 + 32, "armed, in HIL: {}", said["mode"]);
    }
}
