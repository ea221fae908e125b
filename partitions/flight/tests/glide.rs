//! Landing without power, with the estimator in the loop: from wherever in the mission it is lost, softly, against the wind, and on the
//! runway where the height lasts for it.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a panic here is a failed test")]

mod common;

use bateleur_flight::airframe::Airframe;
use bateleur_flight::control::landing::Phase;
use bateleur_flight::control::takeoff;
use bateleur_plant::Turbulence;
use common::{Flight, Options};
use nalgebra::Vector2;

const AIRCRAFT: [(&str, &str); 3] = [
    ("Aerosonde", common::AEROSONDE),
    ("Rascal 110", common::RASCAL),
    ("Ultra Stick 25e", common::ULTRA_STICK),
];

/// How it came down.
struct TouchDown {
    told_s: f64,
    sink_mps: f64,
    roll_deg: f64,
    /// From the runway's origin.
    away_m: f64,
}

fn options(text: &'static str, seed: u64, wind: f64, from: f64, turbulence: Turbulence) -> Options {
    let mut options = Options::new(seed, wind, from, turbulence);
    options.airframe = text;
    options.guidance = options.guidance.of_airframe(&Airframe::from_toml(text).unwrap());
    options
}

/// Flies the mission, loses its power at `at_s`, and lands by what the laws say; why it is damaged or does not stand in the end.
fn landed(mut options: Options, at_s: f64) -> Result<TouchDown, String> {
    options.conditions.faults = vec![format!("throttle_stuck=0@{at_s}").parse().unwrap()];
    landed_in(Flight::new(options), at_s)
}

fn landed_in(mut flight: Flight, at_s: f64) -> Result<TouchDown, String> {
    let (mut told_s, mut touched) = (None, None);
    for _ in 0..20_000 {
        let before = flight.plant.truth();
        flight.step();
        if flight.controller.has_lost_power() && told_s.is_none() {
            if before.time_s < at_s {
                return Err(format!("told without a reason: {}", flight.describe()));
            }
            told_s = Some(before.time_s - at_s);
            let state = flight.last().navigation.unwrap();
            flight.controller.land(&state, 50.0, Vector2::zeros());
        }
        let t = flight.plant.truth();
        let phase = flight.controller.landing_phase();
        if t.crashed {
            return Err(format!(
                "{phase:?}, sink {:.1} m/s, {}",
                before.velocity_ned_mps.z,
                flight.describe()
            ));
        }
        if let Some(told_s) = told_s.filter(|_| t.on_ground && touched.is_none()) {
            touched = Some(TouchDown {
                told_s,
                sink_mps: before.velocity_ned_mps.z,
                roll_deg: t.roll_rad.to_degrees(),
                away_m: t.position_ned_m.xy().norm(),
            });
        }
        if phase == Some(Phase::Standing) {
            return Ok(touched.unwrap());
        }
    }
    Err(format!("{:?} {}", flight.controller.landing_phase(), flight.describe()))
}

#[test]
fn aircraft_without_power_land_softly_and_most_of_them_on_the_runway() {
    let (mut flights, mut near) = (0, 0);
    for (name, text) in AIRCRAFT {
        // A light one is thrown about by what a heavier one does not notice.
        let strong = if name == "Ultra Stick 25e" { 5.0 } else { 7.0 };
        let winds = [(0.0, 0.0), (4.0, 60.0), (strong, 200.0)];
        for (seed, (wind, from)) in (760_001..).zip(winds) {
            let turbulence = if wind > 0.0 { Turbulence::Light } else { Turbulence::Calm };
            for at_s in [70.0, 95.0, 120.0, 150.0] {
                let about = format!("{name}, {wind} m/s from {from}°, at {at_s} s");
                let down = landed(options(text, seed, wind, from, turbulence), at_s)
                    .unwrap_or_else(|why| panic!("{about}: {why}"));
                let (sink_mps, roll_deg, away_m) = (down.sink_mps, down.roll_deg, down.away_m);
                println!(
                    "{about}: told after {:.1} s, {sink_mps:.1} m/s, {roll_deg:.0}°, {away_m:.0} m away",
                    down.told_s
                );
                assert!(down.told_s < 6.0, "{about}: {}", down.told_s);
                assert!(sink_mps < 3.5 && roll_deg.abs() < 15.0, "{about}: {sink_mps} m/s, {roll_deg}°");
                assert!(away_m < 600.0, "{about}: {away_m} m away");
                flights += 1;
                near += u32::from(away_m < 250.0);
            }
        }
    }
    // 27 or 28 of 36: two come down at the limit, on which side decides the last bit of a number.
    assert!(3 * near > 2 * flights, "{near} of {flights} within 250 m");
}

#[test]
fn power_that_is_lost_in_the_climb_ends_straight_ahead_or_against_the_wind() {
    for (name, text) in AIRCRAFT {
        for (wind, from) in [(0.0, 0.0), (4.0, 0.0)] {
            for climbed_s in [6.0, 8.0, 11.0, 15.0] {
                let mut options = options(text, 760_201, wind, from, Turbulence::Calm);
                // When it leaves the ground is known after the first flight.
                let mut ahead = Flight::new(self::options(text, 760_201, wind, from, Turbulence::Calm));
                let climbing =
                    |flight: &Flight| flight.controller.take_off_phase() == Some(takeoff::Phase::Climbing);
                let begin = |flight: &mut Flight| {
                    flight.run(6.0);
                    flight.controller.take_off(takeoff::Method::Roll);
                    flight.engaged = true;
                };
                begin(&mut ahead);
                while !climbing(&ahead) {
                    ahead.step();
                }
                let at_s = ahead.plant.truth().time_s + climbed_s;
                options.conditions.faults = vec![format!("throttle_stuck=0@{at_s}").parse().unwrap()];
                let mut flight = Flight::new(options);
                begin(&mut flight);
                let down = landed_in(flight, at_s);
                let down =
                    down.unwrap_or_else(|why| panic!("{name}, {wind} m/s, after {climbed_s} s: {why}"));
                println!(
                    "{name}, {wind} m/s, after {climbed_s} s: {:.1} m/s, {:.0} m away",
                    down.sink_mps, down.away_m
                );
                assert!(down.sink_mps < 3.5 && down.roll_deg.abs() < 15.0, "{name}: {}", down.sink_mps);
            }
        }
    }
}

#[test]
fn power_that_is_there_is_never_missed_and_what_comes_back_is_told() {
    for seed in 1..=24 {
        let mut flight = Flight::new(common::varied(760_100 + seed));
        for _ in 0..15_000 {
            flight.step();
            assert!(!flight.controller.has_lost_power(), "{}", flight.describe());
        }
        let mut flight =
            Flight::new(options(AIRCRAFT[seed as usize % 3].1, seed, 0.0, 0.0, Turbulence::Severe));
        for _ in 0..15_000 {
            flight.step();
            assert!(!flight.controller.has_lost_power(), "{}", flight.describe());
        }
    }
    let mut options = options(common::AEROSONDE, 760_011, 3.0, 90.0, Turbulence::Light);
    options.conditions.faults = vec!["throttle_stuck=0@60..75".parse().unwrap()];
    let mut flight = Flight::new(options);
    flight.run(70.0);
    assert!(flight.controller.has_lost_power(), "{}", flight.describe());
    flight.run(15.0);
    assert!(!flight.controller.has_lost_power(), "{}", flight.describe());
    flight.run_mission(400.0);
}

/// Not a test: how many of 50 flights for each aircraft and kind of air are damaged, and how the others come down.
#[test]
#[ignore = "prints how drawn landings without power end, asserts nothing"]
fn survey_of_landings_without_power() {
    let mut state: u64 = 1;
    let mut draw = |most: f64| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / f64::from(1_u32 << 31) * most
    };
    for (name, text) in AIRCRAFT {
        for turbulence in [Turbulence::Calm, Turbulence::Light, Turbulence::Moderate] {
            let (mut sinks, mut away, mut damaged) = (Vec::new(), Vec::new(), Vec::new());
            for seed in 0..50 {
                let (wind, from, at_s) = (draw(8.0), draw(360.0), 60.0 + draw(140.0));
                match landed(options(text, 770_000 + seed, wind, from, turbulence), at_s) {
                    Ok(down) => {
                        sinks.push(down.sink_mps);
                        away.push(down.away_m);
                    }
                    Err(why) => damaged.push(format!("{wind:.1} m/s from {from:.0}, at {at_s:.0}: {why}")),
                }
            }
            sinks.sort_by(f64::total_cmp);
            away.sort_by(f64::total_cmp);
            let part = |values: &[f64], part: f64| values[(part * (values.len() - 1) as f64) as usize];
            println!(
                "{name}, {turbulence:?}: {} damaged; sink p50 {:.1}, p95 {:.1} m/s; away p50 {:.0}, p95 {:.0} m",
                damaged.len(),
                part(&sinks, 0.5),
                part(&sinks, 0.95),
                part(&away, 0.5),
                part(&away, 0.95)
            );
            damaged.iter().for_each(|why| println!("   {why}"));
        }
    }
}
