//! Ground stations that speak MAVLink and are not ours: pymavlink (`tests/peers/ground.py`), with the aircraft of
//! `tests/peers/simulator.py`, which stands on the runway and looks east; MAVProxy as it comes.

use std::io::Write;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use bateleur_mavlink::common::{COMMAND_LONG_DATA, MavCmd, MavMessage, MavResult};
use bateleur_mavlink::{Decoder, Encoder};
use bateleur_messages::telemetry::{HealthText, Telemetry};
use bateleur_tests::{
    Ground, PATIENCE, Peer, alone, among_others, await_some, bateleur, edited, flight_schedule,
};
use serde_json::{Value, json};

/// Results of a command.
const ACCEPTED: u64 = 0;
const REJECTED_NOW: u64 = 1;
const UNSUPPORTED: u64 = 3;

/// Types of parameters, and why one was not set.
const UINT8: u64 = 1;
const INT32: u64 = 6;
const OUT_OF_RANGE: u64 = 2;
const READ_ONLY: u64 = 5;
const TYPE_MISMATCH: u64 = 7;

/// Verdicts on a mission.
const MISSION_ACCEPTED: u64 = 0;
const MISSION_UNSUPPORTED: u64 = 3;
const MISSION_NO_SPACE: u64 = 4;
const MISSION_DENIED: u64 = 14;
const MISSION_TOO_FAR_NORTH: u64 = 10;

fn angle_deg(said: &Value, place: usize) -> f64 {
    said["attitude"][place].as_f64().unwrap_or(f64::NAN).to_degrees()
}

/// A port that nobody uses just now.
fn free_port() -> u16 {
    std::net::UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// All parameters of the delivered plan with its aircraft.
const PARAMETERS: usize = 135;

/// A line with a device at either end.
struct Cable {
    aircraft: String,
    ground: String,
    cut: Arc<AtomicBool>,
    carrier: Option<JoinHandle<()>>,
}

impl Cable {
    fn lay() -> Self {
        let (mut one, mut other) = (Ground::open(), Ground::open());
        let cut = Arc::new(AtomicBool::new(false));
        let (aircraft, ground, is_cut) = (one.device.clone(), other.device.clone(), cut.clone());
        let carrier = std::thread::spawn(move || {
            while !is_cut.load(Ordering::Relaxed) {
                let (down, up) = (one.bytes(), other.bytes());
                other.send(&down);
                one.send(&up);
                std::thread::sleep(Duration::from_millis(5));
            }
        });
        Self { aircraft, ground, cut, carrier: Some(carrier) }
    }
}

impl Drop for Cable {
    fn drop(&mut self) {
        self.cut.store(true, Ordering::Relaxed);
        let _ = self.carrier.take().map(JoinHandle::join); // a failed test has said why
    }
}

/// What `bateleur ground` says of parameters on this line.
fn asked(device: &str, arguments: &[&str]) -> String {
    let ended = bateleur(&[&["ground", "--device", device][..], arguments].concat()).end();
    format!("{}{}", ended.stdout, ended.stderr)
}

#[test]
fn faults_in_the_module_and_of_command_itself_are_told_to_the_ground_with_what_was_done() {
    let _turn = among_others();
    let mut ground = Ground::open();
    let schedule = flight_schedule();
    let device = format!("command.device={}", ground.device);
    let run = ["run", "--fast", "--schedule", schedule.to_str().unwrap(), "--until", "12", "--set", &device];
    let kills = ["--kill", "estimator@3", "--kill", "command@5"];
    let module = bateleur(&[&run[..], &kills[..]].concat());
    let wanted = [
        "estimator: killed -> warm_restart (ended by SIGKILL)",
        "estimator: back after",
        "command: killed -> warm_restart (ended by SIGKILL)",
        "command: back after",
    ];
    let mut told: Vec<HealthText> = Vec::new();
    let all = await_some(PATIENCE, || {
        told.extend(ground.receive().iter().filter_map(|telemetry| match telemetry {
            Telemetry::Health(text) => Some(*text),
            _ => None,
        }));
        (told.len() == wanted.len()).then_some(())
    });
    let texts: Vec<&str> = told.iter().map(HealthText::text).collect();
    assert!(all.is_some(), "{texts:?}");
    assert!(texts.iter().zip(wanted).all(|(text, wanted)| text.starts_with(wanted)), "{texts:?}");
    let severities: Vec<u8> = told.iter().map(|text| text.severity).collect();
    assert_eq!(severities, [3, 5, 3, 5]);
    module.end().expect_code(0);
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn ground_station_by_others_sees_asks_loads_and_orders_on_the_wall_clock() {
        let _turn = alone();
        let Some(simulator) = Peer::start("simulator.py", &["--transport", "udp"]) else { return };
        let Some(mut ground) = Peer::start("ground.py", &[]) else { return };
        let folder = tempfile::tempdir().unwrap();
        let schedule = folder.path().join("schedule.toml");
        let ground_link =
            format!(r#"attributes = {{ device = "/dev/nowhere", mavlink = "{}" }}"#, ground.address());
        let ground_link = format!("network    = true\n{ground_link}");
        std::fs::write(&schedule, edited(&[(r#"attributes = { device = "/dev/ttyS0" }"#, &ground_link)]))
            .unwrap();
        let simulator_set = format!("hil_interface.simulator={}", simulator.address());
        let module = bateleur(&[
            "run",
            "--schedule",
            schedule.to_str().unwrap(),
            "--set",
            "hil_interface.protocol=mavlink",
            "--set",
            &simulator_set,
            "--set",
            "hil_interface.hil_mode=true",
            "--until",
            "110",
        ]);
        let said = ground.line();
        eprintln!("{said:#}");
        module.signal(rustix::process::Signal::TERM);
        module.end().expect_code(0);
        simulator.finish();

        // Fixed wing, system 1, component 1; the safety pilot flies.
        assert_eq!(said["heartbeat"].as_array().unwrap()[..3], [json!(1), json!(1), json!(1)]);
        assert_eq!(said["armed_too_early"], REJECTED_NOW);
        let why = said["why_not_armed"].to_string();
        assert!(why.contains("refused"), "{why}");
        assert_eq!((&said["version"], &said["version_heard"]), (&json!(ACCEPTED), &json!(true)));
        assert_eq!(said["parachute"], UNSUPPORTED);
        let count = said["parameters"][0].as_u64().unwrap();
        assert!(count > 100, "{count} parameters");
        assert_eq!(said["parameters"][1], json!((0..count).collect::<Vec<_>>()));
        let named = &said["parameters"][2];
        for (_, prefix) in bateleur_messages::parameter::PREFIXES {
            assert!(
                named.as_object().unwrap().keys().any(|name| name.starts_with(prefix)),
                "{prefix}: {named}"
            );
        }
        assert_eq!((&named["CTL_LAPS"], &named["EST_PRESSURE"]), (&json!([2, INT32]), &json!([1, UINT8])));
        assert_eq!(named["HIL_PROTOCOL"], json!([1, UINT8]));
        assert_eq!(
            (&said["settable"], &said["out_of_range"]),
            (&json!([20.0, null]), &json!([20.0, OUT_OF_RANGE]))
        );
        assert_eq!((&said["laps"], &said["half_a_lap"]), (&json!([3, null]), &json!([3, TYPE_MISMATCH])));
        assert_eq!(said["read_only"], json!([11.0, READ_ONLY]));
        assert_eq!(said["uploaded"], MISSION_ACCEPTED);
        assert_eq!(said["came_back"], json!([true, true, true, true]));
        assert_eq!(said["too_far"], MISSION_TOO_FAR_NORTH);
        assert_eq!(said["too_many"], MISSION_NO_SPACE);
        assert_eq!(said["fence"], MISSION_UNSUPPORTED, "a way-point is none of a fence");
        assert_eq!(said["fenced"], MISSION_ACCEPTED);
        assert_eq!(said["runway_left_out"], MISSION_DENIED);
        assert_eq!(said["rally"], MISSION_ACCEPTED);
        assert!(angle_deg(&said, 0).abs() < 3.0 && angle_deg(&said, 1).abs() < 3.0, "{}", said["attitude"]);
        assert!((angle_deg(&said, 2) - 90.0).abs() < 8.0, "{}", said["attitude"]);
        let near = |place: usize, limit: f64| said["position"][place].as_f64().unwrap().abs() < limit;
        assert!(near(0, 2e-4) && near(1, 2e-4) && near(2, 20.0), "{}", said["position"]);
        assert_eq!(
            (&said["ready"], &said["started"], &said["disarmed"]),
            (&json!(true), &json!(ACCEPTED), &json!(ACCEPTED))
        );
        // Armed, HIL, stabilised, automatic; then the safety pilot, in HIL, with navigation still on.
        assert_eq!((&said["flies"], &said["rests"]), (&json!(128 + 32 + 16 + 4), &json!(64 + 32 + 4)));
        let attitudes = said["attitudes_in_4_s"].as_u64().unwrap();
        assert!((40..=100).contains(&attitudes), "20 Hz were asked for: {attitudes} in 4 s");
        for kind in [
            "ATTITUDE",
            "BATTERY_STATUS",
            "ESTIMATOR_STATUS",
            "EXTENDED_SYS_STATE",
            "GLOBAL_POSITION_INT",
            "GPS_RAW_INT",
            "HEARTBEAT",
            "HIGHRES_IMU",
            "HOME_POSITION",
            "LOCAL_POSITION_NED",
            "MISSION_CURRENT",
            "NAMED_VALUE_INT",
            "NAV_CONTROLLER_OUTPUT",
            "SERVO_OUTPUT_RAW",
            "STATUSTEXT",
            "SYSTEM_TIME",
            "SYS_STATUS",
            "VFR_HUD",
        ] {
            assert!(
                said["kinds"].as_array().unwrap().contains(&json!(kind)),
                "{kind} never came: {}",
                said["kinds"]
            );
        }
        assert!(said["texts"].to_string().contains("the autopilot flies"), "{}", said["texts"]);
    }

    #[test]
    fn mavproxy_as_it_is_finds_the_aircraft_and_its_parameters_and_is_told_why_on_the_wall_clock() {
        let _turn = alone();
        let Some(python) = bateleur_tests::python() else { return };
        let folder = tempfile::tempdir().unwrap();
        let address = format!("127.0.0.1:{}", free_port());
        let schedule = folder.path().join("schedule.toml");
        let link = format!(
            "network = true\nattributes = {{ device = \"/dev/nowhere\", mavlink = \"{address}\", parameter_encoding = \"cast\" }}"
        );
        std::fs::write(&schedule, edited(&[(r#"attributes = { device = "/dev/ttyS0" }"#, &link)])).unwrap();
        let module = bateleur(&["run", "--schedule", schedule.to_str().unwrap(), "--until", "100"]);
        let state = format!("--state-basedir={}", folder.path().display());
        let said = folder.path().join("said");
        let mut proxy = Command::new(&python)
            .arg(python.with_file_name("mavproxy.py"))
            .args([&format!("--master=udpin:{address}"), &state, "--default-modules=link,param,arm,mode"])
            .current_dir(folder.path())
            .stdin(Stdio::piped())
            .stdout(std::fs::File::create(&said).unwrap())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        let mut keyboard = proxy.stdin.take().unwrap();
        let mut hears = |order: &str, words: &[&str]| {
            let heard = await_some(PATIENCE, || {
                keyboard.write_all(order.as_bytes()).unwrap();
                std::thread::sleep(Duration::from_secs(2));
                let text = std::fs::read_to_string(&said).unwrap();
                words.iter().all(|word| text.contains(word)).then_some(())
            });
            assert!(heard.is_some(), "{words:?} never came:\n{}", std::fs::read_to_string(&said).unwrap());
        };
        hears("\n", &["online system 1"]);
        hears("param fetch\n", &[&format!("Received {PARAMETERS} parameters")]);
        hears("param show CTL_LAPS\n", &["CTL_LAPS         2"]);
        hears("param set CTL_LAPS 3\nparam show CTL_LAPS\n", &["CTL_LAPS         3"]);
        hears("arm throttle\n", &["TEMPORARILY_REJECTED", "initialise it, and wait until it runs"]);
        drop(keyboard);
        proxy.kill().unwrap();
        proxy.wait().unwrap();
        module.signal(rustix::process::Signal::TERM);
        module.end().expect_code(0);
    }

    #[test]
    fn mavlink_on_the_serial_line_is_heard_and_answers_on_the_wall_clock() {
        let _turn = alone();
        let mut ground = Ground::open();
        let schedule = flight_schedule();
        let device = format!("command.device={}", ground.device);
        let set = ["--set", &device, "--set", "command.mavlink=serial"];
        let run = ["run", "--schedule", schedule.to_str().unwrap(), "--until", "60"];
        let module = bateleur(&[&run[..], &set[..]].concat());
        let (mut decoder, mut encoder) = (Decoder::new(), Encoder::new(255, 190));
        let mut heartbeats = 0;
        let result = await_some(PATIENCE, || {
            let mut question = Vec::new();
            let land = COMMAND_LONG_DATA {
                command: MavCmd::MAV_CMD_DO_PARACHUTE,
                target_system: 1,
                ..COMMAND_LONG_DATA::DEFAULT
            };
            encoder.write(&MavMessage::COMMAND_LONG(land), &mut question);
            let mut result = None;
            decoder.stream(&ground.bytes(), |received| match received.message {
                Ok(MavMessage::HEARTBEAT(_)) => heartbeats += 1,
                Ok(MavMessage::COMMAND_ACK(ack)) => result = Some(ack.result),
                _ => {}
            });
            if heartbeats > 0 && result.is_none() {
                ground.send(&question);
                std::thread::sleep(std::time::Duration::from_millis(200));
            }
            result
        });
        assert_eq!(result, Some(MavResult::MAV_RESULT_UNSUPPORTED));
        assert!(decoder.refused().messages() == 0, "{:?}", decoder.refused());
        module.signal(rustix::process::Signal::TERM);
        module.end().expect_code(0);
    }

    #[test]
    fn parameter_that_was_set_outlives_a_warm_restart_and_not_a_cold_one_on_the_wall_clock() {
        let _turn = alone();
        let line = Cable::lay();
        let folder = tempfile::tempdir().unwrap();
        let schedule = folder.path().join("schedule.toml");
        // Imu starts cold here, the Controller warm.
        let cold = (
            "retained   = \"16KiB\"\nrestart    = { start = \"warm\", budget = 5, within = \"10s\", then = \"idle\" }\n\n[partition.imu.port]",
            "retained   = \"16KiB\"\nrestart    = { start = \"cold\", budget = 5, within = \"10s\", then = \"idle\" }\n\n[partition.imu.port]",
        );
        std::fs::write(&schedule, edited(&[cold])).unwrap();
        let device = format!("command.device={}", line.aircraft);
        let run = ["run", "--schedule", schedule.to_str().unwrap(), "--until", "100", "--set", &device];
        let module = bateleur(&run);
        let ask = |arguments: &[&str]| asked(&line.ground, arguments);
        let listed = ask(&["--parameters", "CTL_LAPS"]);
        assert!(listed.contains("CTL_LAPS                         2  0 to 1000, whole"), "{listed}");
        assert!(ask(&["--set", "CTL_LAPS=5", "--set", "IMU_INIT_TIME=0.5"]).contains("  0.5  "));
        let refused = ask(&["--set", "CTL_MASS=1"]);
        assert!(refused.contains("CTL_MASS is not set: it comes from the schedule file"), "{refused}");
        for partition in ["controller", "imu"] {
            let pid = module.pid().to_string();
            bateleur(&["kill", partition, "--module", &pid]).end().expect_code(0);
        }
        let after = await_some(PATIENCE, || {
            let after = ask(&["--parameters"]);
            (after.contains("CTL_LAPS") && after.contains("IMU_INIT_TIME")).then_some(after)
        });
        let after = after.unwrap();
        assert!(after.contains("CTL_LAPS                         5"), "{after}");
        assert!(after.contains("IMU_INIT_TIME                    1"), "{after}");
        module.signal(rustix::process::Signal::TERM);
        module.end().expect_code(0);
    }
}
