//! `fly --flightgear`: what FlightGear is told is where the aircraft really was, read by somebody else's reader of that format.

use std::collections::BTreeSet;
use std::path::Path;

use bateleur_tests::{Peer, alone, bateleur, flight_schedule};
use serde_json::Value;

/// One lap of a small triangle.
const MISSION: &str = "laps = 1
waypoint = [
    { north_m = 500, east_m = 0, altitude_m = 140 },
    { north_m = 500, east_m = 500, altitude_m = 140 },
    { north_m = 0, east_m = 250, altitude_m = 140 },
]
";

/// Height, roll, pitch and yaw of every record of the truth, as bits of the numbers that FlightGear takes; and the highest height, m.
fn truth(path: &Path) -> (BTreeSet<[u32; 4]>, f64) {
    let bytes = std::fs::read(path).unwrap();
    let end = bytes.iter().position(|byte| *byte == b'\n').unwrap();
    let header: Value = serde_json::from_slice(&bytes[..end]).unwrap();
    let offset = |name: &str| {
        let fields = header["fields"].as_array().unwrap();
        fields.iter().find(|field| field["name"] == name).unwrap()["offset"].as_u64().unwrap() as usize
    };
    let (position, euler) = (offset("position_ned_m"), offset("euler_rad"));
    let length = header["record_bytes"].as_u64().unwrap() as usize;
    let mut highest = 0.0_f64;
    let records = bytes[end + 1..].chunks_exact(length).map(|record| {
        let real = |at: usize| f64::from_le_bytes(record[at..at + 8].try_into().unwrap());
        let height = -real(position + 16);
        highest = highest.max(height);
        [height, real(euler), real(euler + 8), real(euler + 16)].map(|value| (value as f32).to_bits())
    });
    (records.collect(), highest)
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn what_flightgear_is_told_is_where_the_aircraft_was_and_the_flight_is_the_same_without_it() {
        let _turn = alone();
        let Some(peer) = Peer::start("window.py", &[]) else { return };
        let folder = tempfile::tempdir().unwrap();
        let mission = folder.path().join("mission.toml");
        std::fs::write(&mission, MISSION).unwrap();
        let schedule = flight_schedule();
        let flight =
            ["fly", "--fast", "--wind", "6", "--wind-from", "200", "--mission", mission.to_str().unwrap()];
        let flight = [&flight[..], &["--schedule", schedule.to_str().unwrap()]].concat();
        let shown = bateleur(&[&flight[..], &["--flightgear", peer.address()]].concat()).end().expect_code(0);
        let heard = peer.finish();
        let fields = heard["fields"].as_array().unwrap();
        let at = |name: &str| fields.iter().position(|field| field == name).unwrap();
        let poses = heard["poses"].as_array().unwrap();
        let number = |pose: &Value, name: &str| pose[at(name)].as_f64().unwrap();
        // What a full buffer of the reader loses is lost: a minute of flight is enough.
        assert!(poses.len() > 3000, "{} poses", poses.len());
        let (known, highest) = truth(&shown.folder().join("truth.bin"));
        let mut seen_highest = 0.0_f64;
        let first = &poses[0];
        for pose in poses {
            assert_eq!((number(pose, "bytes"), number(pose, "version")), (408.0, 24.0));
            let key = ["agl", "phi", "theta", "psi"].map(|name| (number(pose, name) as f32).to_bits());
            assert!(known.contains(&key), "the aircraft was never so: {pose}");
            seen_highest = seen_highest.max(number(pose, "agl"));
            // Above sea level by as much as the field is.
            let field = number(first, "altitude") - number(first, "agl");
            assert!((number(pose, "altitude") - number(pose, "agl") - field).abs() < 1.0, "{pose}");
        }
        assert!((seen_highest - highest).abs() < 5.0, "{seen_highest} m, really {highest} m");
        let [wheels, airborne] =
            [1.0, 0.0].map(|down| poses.iter().filter(|pose| number(pose, "wow") == down).count());
        assert!(wheels > 10 && airborne > 2000, "{wheels} on the ground, {airborne} in the air");
        let fast = poses.iter().map(|pose| number(pose, "vcas")).fold(0.0, f64::max);
        assert!((30.0..120.0).contains(&fast), "{fast} kt");
        // North in radians is what it is in metres over the ground.
        let (south, north) = poses.iter().fold((f64::MAX, f64::MIN), |(south, north), pose| {
            (south.min(number(pose, "latitude")), north.max(number(pose, "latitude")))
        });
        let span_m = (north - south) * 6_371_000.0;
        assert!((400.0..1500.0).contains(&span_m), "{span_m} m from south to north");

        let digest = |text: &str| text.lines().find(|line| line.starts_with("digest ")).map(str::to_owned);
        let alone = bateleur(&flight).end().expect_code(0);
        assert_eq!(digest(&shown.stdout), digest(&alone.stdout));
    }
}
