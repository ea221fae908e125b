//! A flight made up to be known exactly: the seed's mission at constant speed, a fixed distance beside the path.

use bateleur_flight::guidance::seed_waypoints;
use bateleur_messages::{ActuatorCommand, GpsPosition, Message, State};
use bateleur_recording::{ChannelId, PortLog, topic};
use bateleur_report::{run, windows};
use bateleur_simulator::Options;
use bateleur_simulator::truth::{Header, TruthRecord, TruthWriter};
use nalgebra::Vector2;
use std::f64::consts::FRAC_PI_2;
use std::fmt::Write as _;
use std::path::Path;
use zerocopy::IntoBytes;

/// Radius of the fillets, m.
const RADIUS_M: f64 = 70.0;
const SPEED_MPS: f64 = 22.0;
const STEP_NS: u64 = 20_000_000;
/// Standing on the runway at first, s.
const STANDING_S: f64 = 5.0;
/// How far right of the path the aircraft believes to fly, m.
pub(crate) const BESIDE_M: f64 = 1.5;
/// How far above the way-points it believes to fly, m.
pub(crate) const ABOVE_M: f64 = 0.5;
/// The receiver's slow error, m.
pub(crate) const SLOW_NED_M: [f64; 3] = [3.0, -4.0, 2.0];
/// What the barometer's bias grew by since take-off, m.
pub(crate) const GROWN_BIAS_M: f64 = 1.2;

/// Length of one corner and the leg after it, m.
fn piece_m() -> f64 {
    500.0 - 2.0 * RADIUS_M + RADIUS_M * FRAC_PI_2
}

/// Way flown from the runway to the middle of corner number `passage`, m.
fn middle_m(passage: usize) -> f64 {
    500.0 - RADIUS_M + 0.5 * RADIUS_M * FRAC_PI_2 + passage as f64 * piece_m()
}

/// The path's place and direction after `way` metres.
fn path(way: f64) -> (Vector2<f64>, f64) {
    let first = 500.0 - RADIUS_M;
    if way < first {
        return (Vector2::new(way, 0.0), 0.0);
    }
    let corner = ((way - first) / piece_m()) as usize;
    let inside = way - first - corner as f64 * piece_m();
    let waypoint = seed_waypoints()[corner % 4].horizontal();
    let track = corner as f64 * FRAC_PI_2;
    let forward = |track: f64| Vector2::new(track.cos(), track.sin());
    if inside > RADIUS_M * FRAC_PI_2 {
        let after = track + FRAC_PI_2;
        return (waypoint + forward(after) * (RADIUS_M + inside - RADIUS_M * FRAC_PI_2), after);
    }
    let turned = inside / RADIUS_M;
    let centre = waypoint + (forward(track + FRAC_PI_2) - forward(track)) * RADIUS_M;
    (centre + forward(track + turned - FRAC_PI_2) * RADIUS_M, track + turned)
}

fn way_at(time_s: f64) -> f64 {
    SPEED_MPS * (time_s - STANDING_S).max(0.0)
}

fn reached_at(time_s: f64) -> usize {
    (0..9).take_while(|passage| way_at(time_s) >= middle_m(*passage)).count()
}

/// The truth at a module time.
pub(crate) fn record(time_ns: u64) -> TruthRecord {
    let time_s = time_ns as f64 * 1e-9;
    let way = way_at(time_s);
    let standing = way == 0.0;
    let (place, track) = path(way);
    let believed = place + Vector2::new(-track.sin(), track.cos()) * BESIDE_M;
    let bias = 7.0 + if standing { 0.0 } else { GROWN_BIAS_M };
    let height = if standing { 0.0 } else { (way * 0.45).min(160.0 + ABOVE_M - GROWN_BIAS_M) };
    let on_arc = reached_at(time_s + 2.5) != reached_at(time_s - 2.5);
    TruthRecord {
        time_ns,
        position_ned_m: [believed.x - SLOW_NED_M[0], believed.y - SLOW_NED_M[1], -height],
        velocity_ned_mps: if standing {
            [0.0; 3]
        } else {
            [SPEED_MPS * track.cos(), SPEED_MPS * track.sin(), 0.0]
        },
        euler_rad: [if on_arc { 0.6 } else { 0.0 }, 0.08, track],
        airspeed_mps: if standing { 0.0 } else { SPEED_MPS + 0.2 * (time_s * 1.7).sin() },
        wind_ned_mps: [0.5, 0.5, 0.0],
        surfaces_rad: [0.02 * (time_s * 3.0).sin(), -0.2, 0.01 * (time_s * 2.0).cos()],
        throttle: if standing { 0.0 } else { 0.69 },
        gps_slow_error_ned_m: SLOW_NED_M,
        barometer_bias_m: bias,
        timers_us: [1500, 1500, 1450, 1500, 1690],
        on_ground: u16::from(standing),
        ..TruthRecord::default()
    }
}

/// Module times of a flight of `seconds`.
fn times(seconds: f64) -> impl Iterator<Item = u64> {
    (0..=(seconds * 50.0) as u64).map(|step| step * STEP_NS)
}

/// A flight's length, s, that holds the return to WP0 and a little more.
pub(crate) fn whole_s() -> f64 {
    STANDING_S + middle_m(8) / SPEED_MPS + 3.0
}

/// Writes every file of a flight of `seconds`.
pub(crate) fn write(dir: &Path, seconds: f64) {
    write_truth(dir, seconds, |_| {});
    write_ports(dir, seconds);
    write_windows(dir, seconds);
    write_run(dir, seconds);
    let health = concat!(
        r#"{"time_ns":100000000000,"partition":"estimator","generation":1,"error":"killed","action":"warm_restart","#,
        r#""detail":"SIGKILL","recovered_ns":100064400000}"#,
        "\n",
        r#"{"time_ns":101000000000,"partition":"imu","generation":1,"error":"window_overrun","action":"ignore","#,
        r#""detail":"","recovered_ns":null}"#,
        "\n",
    );
    std::fs::write(dir.join("health.jsonl"), health).unwrap();
}

/// Writes the truth log, each record after `change`.
pub(crate) fn write_truth(dir: &Path, seconds: f64, change: impl Fn(&mut TruthRecord)) {
    let header = Header::new(&Options::default());
    let mut writer = TruthWriter::create(&dir.join("truth.bin"), &header).unwrap();
    for time_ns in times(seconds) {
        let mut record = record(time_ns);
        change(&mut record);
        writer.append(&record).unwrap();
    }
    writer.flush().unwrap();
}

fn add<T: Message>(log: &mut PortLog, partition: &str, port: &str) -> ChannelId {
    let message = bateleur_messages::find(T::NAME).unwrap();
    log.add_channel(&topic(partition, port), message).unwrap()
}

/// Writes the log of the ports.
pub(crate) fn write_ports(dir: &Path, seconds: f64) {
    let mut log = PortLog::create(dir.join("ports.mcap")).unwrap();
    let states = add::<State>(&mut log, "estimator", "state");
    let commands = add::<ActuatorCommand>(&mut log, "controller", "command");
    let fixes = add::<GpsPosition>(&mut log, "gps", "position");
    for (sequence, time_ns) in times(seconds).enumerate() {
        let sequence = sequence as u64;
        // The estimator is dead for a moment.
        if !(100_000_000_000..100_064_400_000).contains(&time_ns) {
            log.write(states, sequence, time_ns, state(time_ns).as_bytes()).unwrap();
        }
        log.write(commands, sequence, time_ns, command(time_ns).as_bytes()).unwrap();
        if sequence.is_multiple_of(10) {
            log.write(fixes, sequence / 10, time_ns, fix(time_ns, sequence / 10 + 1).as_bytes()).unwrap();
        }
    }
    log.finish().unwrap();
}

fn believed_ned(record: &TruthRecord) -> [f64; 3] {
    let [north, east, down] = record.position_ned_m;
    let shift = if record.on_ground == 1 { 0.0 } else { GROWN_BIAS_M };
    [north + SLOW_NED_M[0], east + SLOW_NED_M[1], down - shift]
}

fn state(time_ns: u64) -> State {
    let record = record(time_ns);
    State {
        valid_ns: time_ns,
        position_ned_m: believed_ned(&record),
        velocity_ned_mps: record.velocity_ned_mps,
        euler_rad: record.euler_rad,
        status: 3,
        ..State::default()
    }
}

fn command(time_ns: u64) -> ActuatorCommand {
    let record = record(time_ns);
    let reached = reached_at(time_ns as f64 * 1e-9);
    ActuatorCommand {
        throttle: record.throttle,
        aileron_rad: 1.2 * record.surfaces_rad[0],
        elevator_rad: record.surfaces_rad[1],
        rudder_rad: record.surfaces_rad[2],
        bank_reference_rad: record.euler_rad[0],
        altitude_reference_m: 160.0,
        airspeed_reference_mps: 22.0,
        engaged: u32::from(record.on_ground == 0),
        next_waypoint: reached as u32 % 4,
        waypoints_reached: reached as u32,
        ..ActuatorCommand::default()
    }
}

fn fix(time_ns: u64, count: u64) -> GpsPosition {
    let [north, east, down] = believed_ned(&record(time_ns));
    let noise = ((count * 7919) % 13) as f64 * 0.1 - 0.6;
    GpsPosition {
        measured_ns: time_ns,
        position_ned_m: [north + noise, east - noise, down + 2.0 * noise],
        count,
        ..GpsPosition::default()
    }
}

/// Each partition with its window's start and length and what it uses of it, µs.
const SCHEDULE: [(&str, u64, u64, u64); 9] = [
    ("rate_generator", 0, 300, 30),
    ("hil_interface", 300, 2700, 900),
    ("gps", 3200, 500, 60),
    ("imu", 3800, 500, 80),
    ("estimator", 4400, 2000, 700),
    ("controller", 6500, 1000, 200),
    ("servo", 7600, 400, 50),
    ("onboard_computer", 12000, 500, 90),
    ("command", 13000, 2000, 300),
];

/// Writes the windows: five minor frames a major frame.
pub(crate) fn write_windows(dir: &Path, seconds: f64) {
    let mut text = format!("{}\n", windows::HEADER);
    for (cycle, time_ns) in times(seconds).enumerate() {
        for (partition, offset, length, used) in SCHEDULE {
            let start = time_ns + offset * 1000;
            let opened = start + 8_000 + (cycle as u64 * 7919) % 12_000;
            let (end, closed) = (start + length * 1000, opened + used * 1000);
            let (frame, minor) = (cycle / 5, cycle % 5);
            let dead = partition == "estimator" && (5000..5003).contains(&cycle);
            let tail = if dead { ",,,S".to_owned() } else { format!("{start},{opened},{closed},") };
            let _ = writeln!(text, "{frame},{minor},1,{partition},{start},{end},{tail}");
        }
    }
    std::fs::write(dir.join("windows.csv"), text).unwrap();
}

fn write_run(dir: &Path, seconds: f64) {
    let guarantee = |promise: &str, held: bool, detail: &str| run::Guarantee {
        promise: promise.to_owned(),
        held,
        detail: detail.to_owned(),
    };
    let run = run::Run {
        clock: run::Clock::Wall,
        seed: 7,
        wall_time_s: seconds,
        module_time_s: seconds,
        schedule: "schedule.toml".to_owned(),
        foreign_simulator: false,
        mission: run::Mission { completed: true, failure: None, waypoints_reached: Some(9) },
        guarantees: vec![
            guarantee("windows end on time", true, "SCHED_FIFO 98 on core 1, cgroup freezer"),
            guarantee("memory is locked", false, "RLIMIT_MEMLOCK is 64 KiB"),
        ],
        lost_records: 0,
        notes: Vec::new(),
        arguments: serde_json::json!(["fly", "--seed", "7"]),
    };
    std::fs::write(dir.join("run.json"), serde_json::to_string(&run).unwrap()).unwrap();
}
