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
                println!("outlier {seed}: wind {:.1} {:?} {score:.2?} {:?}", c.wind_speed_mps, c.turbulence, flight.estimator.counters());
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

#[test]
#[ignore = "scratch"]
fn trace() {
    let seed: u64 = std::env::var("SEED").unwrap().parse().unwrap();
    let t0: f64 = std::env::var("T0").unwrap().parse().unwrap();
    let t1: f64 = std::env::var("T1").unwrap().parse().unwrap();
    let options = common::varied(seed);
    println!("{:?} lat {}", options.plant.as_ref().unwrap().aerodynamics, options.conditions.sensors.gps.latency_s);
    let mut flight = Flight::new(options);
    let mut k = 0;
    while flight.plant.time_s() < t1 {
        flight.step();
        k += 1;
        let f = flight.last();
        if f.truth.time_s > t0 && k % 10 == 0 {
            let (t, o) = (&f.truth, &f.output);
            let n = f.navigation.unwrap();
            println!("{:6.2} roll {:5.1} ref {:5.1} P {:5.2} ref {:5.2} C {:6.2} ref {:6.2} A {:5.2} ref {:5.2} V {:4.1} alt {:6.1} beta {:5.2} ail {:5.2} ele {:5.2} rud {:5.2} thr {:4.2} xt {:6.2} wind {:4.1} {:4.1} true {:4.1} {:4.1} arc {} R {:.0} next {} reached {}", t.time_s, t.roll_rad.to_degrees(), o.references.bank_rad.to_degrees(), o.signals.roll_rate_radps, o.references.roll_rate_radps, o.signals.normal_mps2, o.references.normal_mps2, o.signals.axial_mps2, o.references.axial_mps2, t.airspeed_mps, n.altitude_m(), t.beta_rad.to_degrees(), o.command.aileron_rad, o.command.elevator_rad, o.command.rudder_rad, o.command.throttle, o.guidance.map_or(0.0, |g| g.cross_track_m), n.wind.x, n.wind.y, t.wind_ned_mps.x, t.wind_ned_mps.y, o.guidance.is_some_and(|g| g.on_arc), o.guidance.map_or(0.0, |g| g.radius_m), o.guidance.map_or(9, |g| g.next), o.guidance.map_or(0, |g| g.reached));
        }
    }
}
