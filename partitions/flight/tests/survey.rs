//! Prints what flights measure; run with `--ignored --nocapture` when tuning.
mod common;
use bateleur_plant::Turbulence;
use common::{Flight, Options};

#[test]
#[ignore = "prints a table, asserts nothing"]
fn table() {
    let cases = [
        ("calm", 0.0, 0.0, Turbulence::Calm),
        ("calm 5N", 5.0, 0.0, Turbulence::Calm),
        ("light 5N", 5.0, 0.0, Turbulence::Light),
        ("light 5W", 5.0, 270.0, Turbulence::Light),
        ("moderate 5S", 5.0, 180.0, Turbulence::Moderate),
        ("moderate 8E", 8.0, 90.0, Turbulence::Moderate),
    ];
    let seeds: u64 = std::env::var("SEEDS").ok().and_then(|x| x.parse().ok()).unwrap_or(3);
    for (name, wind, from, turbulence) in cases {
        for seed in 1..=seeds {
            let mut flight = Flight::new(Options::new(seed, wind, from, turbulence));
            flight.run_mission(400.0);
            let (s, e) = (flight.score(), flight.estimate_errors(40.0));
            println!(
                "{name:12} {seed:3} xt {:5.2} straight {:5.2} (true {:5.2}) max {:5.1} alt {:5.2} ({:5.2}) V {:5.2} | roll {:4.2} pitch {:4.2} yaw {:4.2} v {:5.3} p {:4.2} h {:4.2} {:?} worst {:.0?} engaged {:.0?}",
                s.cross_track,
                s.straight,
                s.straight_true,
                s.cross_track_max,
                s.altitude,
                s.altitude_true,
                s.airspeed,
                e.roll_deg,
                e.pitch_deg,
                e.yaw_deg,
                e.velocity_mps,
                e.horizontal_m,
                e.height_m,
                flight.estimator.counters(),
                s.worst,
                flight
                    .frames
                    .iter()
                    .find(|f| f.engaged)
                    .map(|f| (f.truth.time_s, f.truth.position_ned_m.x, f.truth.position_ned_m.y))
                    .unwrap()
            );
            assert_eq!(flight.order()[..8], [0, 1, 2, 3, 0, 1, 2, 3]);
        }
    }
}

#[test]
#[ignore = "prints one flight"]
fn one() {
    let mut flight = Flight::new(Options::new(1, 8.0, 90.0, Turbulence::Moderate));
    let mut last = (0, 0);
    for _ in 0..50 * 120 {
        flight.step();
        let c = flight.estimator.counters();
        if c.refused / 20 != last.0 / 20 || c.resets != last.1 {
            last = (c.refused, c.resets);
            let f = flight.last();
            let n = f.navigation.unwrap();
            println!(
                "{:.2} {c:?} V {:.1} est {:.1} wind {:?} truth {:?} off {:?} h {:.1} truth {:.1} bias {:.1} sig {:?}",
                f.truth.time_s,
                f.truth.airspeed_mps,
                n.air_velocity().norm(),
                n.wind,
                f.truth.wind_ned_mps,
                flight.estimator.barometer_offset_m(),
                n.altitude_m(),
                -f.truth.position_ned_m.z,
                f.truth.barometer_bias_m,
                n.sigmas.position
            );
        }
    }
}
