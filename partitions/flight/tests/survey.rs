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

/// `FLIGHTS` flights (default 200) from the runway: wind 0–8 m/s, turbulence up to moderate, derivatives ±20 %, mass ±10 %,
/// latency 50–250 ms, sensor biases from their full ranges; prints those that do not complete and the percentiles.
#[test]
#[ignore = "prints percentiles over many flights"]
fn monte_carlo() {
    let flights: u64 = std::env::var("FLIGHTS").ok().and_then(|x| x.parse().ok()).unwrap_or(200);
    let frame_s: f64 = std::env::var("FRAME_S").ok().and_then(|x| x.parse().ok()).unwrap_or(0.02);
    let mut columns: [Vec<f64>; 5] = Default::default();
    let mut failed = 0;
    for seed in 1000..1000 + flights {
        let options = Options { frame_s, ..common::varied(seed) };
        let outcome = std::panic::catch_unwind(|| {
            let mut flight = Flight::new(options);
            flight.run_mission(400.0);
            let score = flight.score();
            if score.straight > 2.0 || score.altitude > 0.8 || score.cross_track_max > 30.0 {
                let c = &flight.options.conditions;
                println!(
                    "outlier {seed}: wind {:.1} {:?} {score:.2?} {:?}",
                    c.wind_speed_mps,
                    c.turbulence,
                    flight.estimator.counters()
                );
            }
            (flight.order(), score)
        });
        match outcome {
            Ok((order, s)) if order[..8] == [0, 1, 2, 3, 0, 1, 2, 3] => {
                let values = [s.cross_track, s.straight, s.altitude, s.airspeed, s.cross_track_max];
                columns.iter_mut().zip(values).for_each(|(column, value)| column.push(value));
            }
            _ => {
                failed += 1;
                println!("seed {seed} did not complete");
            }
        }
    }
    println!("{failed} of {flights} did not complete");
    for (name, mut column) in
        ["cross-track", "straight", "altitude", "airspeed", "xt max"].into_iter().zip(columns)
    {
        column.sort_by(f64::total_cmp);
        let at = |share: f64| column[((column.len() - 1) as f64 * share) as usize];
        println!(
            "{name:12} median {:5.2}  90 % {:5.2}  99 % {:5.2}  max {:5.2}",
            at(0.5),
            at(0.9),
            at(0.99),
            at(1.0)
        );
    }
}

/// Kills the estimator (without memory) at a drawn moment of `FLIGHTS` flights, for 0.1 s, and in every third flight the
/// controller with it; prints how long it took, how far off the first state was, and what did not come back.
#[test]
#[ignore = "prints percentiles over many flights"]
fn restarts() {
    let flights: u64 = std::env::var("FLIGHTS").ok().and_then(|x| x.parse().ok()).unwrap_or(100);
    let gps_hz: f64 = std::env::var("GPS_HZ").ok().and_then(|x| x.parse().ok()).unwrap_or(5.0);
    let (mut delays, mut errors, mut sinks, mut later) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut failed = 0;
    for seed in 5000..5000 + flights {
        let outcome = std::panic::catch_unwind(|| {
            let mut options = common::varied(seed);
            options.conditions.sensors.gps.rate_hz = gps_hz;
            let mut flight = Flight::new(options);
            flight.run(60.0 + (seed * 37 % 100) as f64 * 0.73);
            flight.estimator_dead = true;
            flight.run(0.1);
            flight.estimator = bateleur_flight::estimator::Estimator::new(flight.options.estimator);
            flight.estimator_dead = false;
            if seed % 3 == 0 {
                flight.controller = common::new_controller(&flight.options);
            }
            let (began, height) = (flight.plant.time_s(), -flight.plant.truth().position_ned_m.z);
            let from = flight.frames.len();
            while flight.estimator.state().is_none() {
                flight.step();
                assert!(flight.plant.time_s() < began + 10.0, "no state");
            }
            let delay = flight.plant.time_s() - began;
            let off = |flight: &Flight| {
                let f = flight.last();
                f.navigation.map_or(180.0, |n| n.quaternion.angle_to(&f.truth.attitude).to_degrees())
            };
            let first = off(&flight);
            flight.run(10.0);
            let after = off(&flight);
            let lowest =
                flight.frames[from..].iter().map(|f| -f.truth.position_ned_m.z).fold(f64::INFINITY, f64::min);
            flight.frames.clear();
            flight.run_mission(500.0);
            (delay, first, after, height - lowest)
        });
        match outcome {
            Ok((delay, first, after, sink)) => {
                delays.push(delay);
                errors.push(first);
                later.push(after);
                sinks.push(sink);
                if sink > 10.0 || after > 3.0 {
                    println!(
                        "outlier {seed}: delay {delay:.2} first {first:.1} after {after:.1} sink {sink:.1}"
                    );
                }
            }
            Err(_) => {
                failed += 1;
                println!("seed {seed} did not come back");
            }
        }
    }
    println!("{failed} of {flights} did not come back");
    for (name, mut column) in
        ["delay s", "first °", "10 s later °", "sunk m"].into_iter().zip([delays, errors, later, sinks])
    {
        column.sort_by(f64::total_cmp);
        let at = |share: f64| column[((column.len() - 1) as f64 * share) as usize];
        println!(
            "{name:12} median {:5.2}  90 % {:5.2}  99 % {:5.2}  max {:5.2}",
            at(0.5),
            at(0.9),
            at(0.99),
            at(1.0)
        );
    }
}
