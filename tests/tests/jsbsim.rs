//! The example `examples/jsbsim`: an aircraft of JSBSim, which nobody here has made, flown by the partitions and by an airframe file of its own.

use std::time::Duration;

use bateleur_messages::State;
use bateleur_recording::{self as log, Track};
use bateleur_tests::{Peer, TWO_LAPS, among_others, bateleur, flight_schedule, jsbsim, repository};
use serde_json::Value;

/// Two programs take turns 17 000 times: half a minute, more where the processors are shared.
const MOST: Duration = Duration::from_secs(220);

/// What the bridge writes of JSBSim's own state: time, north, east, height, s and m.
fn truth(path: &std::path::Path) -> Vec<[f64; 4]> {
    let text = std::fs::read_to_string(path).unwrap();
    let line = |line: &str| {
        let mut values = line.split(',').map(|value| value.parse::<f64>().unwrap());
        [(); 4].map(|()| values.next().unwrap())
    };
    text.lines().skip(1).map(line).collect()
}

/// Farther from the square than this, m, after its first way-point: its corners are cut by arcs of about 100 m.
const MOST_ASIDE_M: f64 = 50.0;

fn aside_m([_, north, east, _]: [f64; 4]) -> f64 {
    let (north, east) = ((north - 500.0).abs(), (east - 500.0).abs());
    (north.max(east) - 500.0).abs()
}

#[test]
fn aircraft_of_jsbsim_takes_off_and_flies_two_laps() {
    let Some(python) = jsbsim() else { return };
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let track = folder.path().join("track.csv");
    let choices = ["--listen", "127.0.0.1:0", "--track", track.to_str().unwrap()];
    let bridge = Peer::run(&python, "examples/jsbsim/bridge.py", &choices);
    let schedule = flight_schedule();
    let example = repository().join("examples/jsbsim");
    let [airframe, mission] = ["j3cub.toml", "mission.toml"].map(|name| example.join(name));
    let flown = bateleur(&[
        "fly",
        "--fast",
        "--no-simulator",
        "--format",
        "json",
        "--protocol",
        "mavlink",
        "--simulator",
        bridge.address(),
        "--airframe",
        airframe.to_str().unwrap(),
        "--mission",
        mission.to_str().unwrap(),
        "--schedule",
        schedule.to_str().unwrap(),
    ])
    .end_within(MOST)
    .expect_code(0);
    let summary = flown.summary();
    assert_eq!(summary["completed"], true, "{}", summary["failure"]);
    assert_eq!(summary["waypoints"], Value::from(TWO_LAPS.to_vec()));
    let seen = bridge.finish();
    assert_eq!(seen["aircraft"], "J3Cub");
    // The module can not judge itself here: JSBSim's own state has to say that it was there.
    let truth = truth(&track);
    let until_s = summary["waypoint_times_s"].as_array().unwrap().last().unwrap().as_f64().unwrap();
    let first_s = summary["waypoint_times_s"][0].as_f64().unwrap();
    let laps: Vec<_> = truth.iter().filter(|at| (first_s + 20.0..until_s).contains(&at[0])).collect();
    assert!(laps.len() > 1_000, "{}", laps.len());
    let farthest_m = laps.iter().map(|at| aside_m(**at)).fold(0.0, f64::max);
    assert!(farthest_m < MOST_ASIDE_M, "{farthest_m:.1} m from the square");
    let second = laps.iter().skip(laps.len() / 2);
    let worst_m = second.map(|at| (at[3] - 120.0).abs()).fold(0.0, f64::max);
    assert!(worst_m < 3.0, "{worst_m:.1} m from its height in the second lap");
    // And the estimate is that of the place where it was.
    let messages = log::read(flown.folder().join("ports.mcap"), |message| message == "State").unwrap();
    let states: Vec<(u64, State)> = messages.tracks.get("/estimator/state").map(Track::typed).unwrap();
    for at in laps.iter().step_by(50) {
        let near = states.iter().min_by_key(|(time_ns, _)| time_ns.abs_diff((at[0] * 1e9) as u64)).unwrap().1;
        let off_m = (near.position_ned_m[0] - at[1]).hypot(near.position_ned_m[1] - at[2]);
        assert!(off_m < 5.0, "{off_m:.1} m at {:.1} s", at[0]);
    }
}
