//! Taking off without the safety pilot, on the plant's wheels and thrown, with the estimator in the loop.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a panic here is a failed test")]

mod common;

use bateleur_flight::control::takeoff::{Method, Phase};
use bateleur_plant::Turbulence;
use common::{Flight, FlightStart, Options};

const AIRCRAFT: [(&str, &str); 3] = [
    ("Aerosonde", common::AEROSONDE),
    ("Rascal 110", common::RASCAL),
    ("Ultra Stick 25e", common::ULTRA_STICK),
];

/// Stands for five seconds, then the autopilot is on and told to take off.
fn begun(text: &'static str, seed: u64, wind: f64, from: f64, turbulence: Turbulence) -> Flight {
    let mut options = Options::new(seed, wind, from, turbulence);
    options.airframe = text;
    let mut flight = Flight::new(options);
    flight.run(6.0);
    flight.controller.take_off(Method::Roll);
    flight.engaged = true;
    flight
}

#[test]
fn three_aircraft_take_off_by_themselves_and_fly_the_mission() {
    for (name, text) in AIRCRAFT {
        let nose_wheel = name == "Aerosonde";
        // A tail wheel holds less against wind from the side.
        let (across, turbulence) =
            if nose_wheel { (3.0, Turbulence::Light) } else { (2.0, Turbulence::Calm) };
        let winds = [(0.0, 0.0), (4.0, 0.0), (across, 90.0), (across, 270.0), (2.0, 180.0), (5.0, 340.0)];
        for (seed, (wind, from)) in (740_001..).zip(winds) {
            let mut flight = begun(text, seed, wind, from, turbulence);
            let mut off = None;
            for _ in 0..2500 {
                flight.step();
                let t = flight.plant.truth();
                assert!(
                    !t.crashed,
                    "{name} seed {seed}: {} {:?}",
                    flight.describe(),
                    flight.controller.take_off_phase()
                );
                if !t.on_ground && -t.position_ned_m.z > 2.0 && off.is_none() {
                    off = Some((t.time_s, t.position_ned_m.x, t.position_ned_m.y, t.airspeed_mps));
                }
                if flight.controller.take_off_phase().is_none() {
                    break;
                }
            }
            let (time_s, north_m, east_m, airspeed_mps) = off.unwrap_or_else(|| {
                panic!("{name} seed {seed}: {} {:?}", flight.describe(), flight.controller.take_off_phase())
            });
            println!(
                "{name} wind {wind} from {from}: off at {time_s:.1} s, {north_m:.0} m, {east_m:.1} m aside, {airspeed_mps:.1} m/s; 60 m at {:.1} s",
                flight.plant.time_s()
            );
            assert_eq!(flight.controller.take_off_phase(), None, "{name} seed {seed}");
            assert!(east_m.abs() < 15.0 && north_m < 400.0, "{name} seed {seed}: {north_m} {east_m}");
            flight.run_mission(400.0);
            assert_eq!(flight.order()[..8], [0, 1, 2, 3, 0, 1, 2, 3]);
        }
    }
}

#[test]
fn take_off_is_aborted_on_the_ground_and_not_in_the_air() {
    for (name, text) in AIRCRAFT {
        let mut flight = begun(text, 740_011, 2.0, 30.0, Turbulence::Calm);
        while flight.plant.truth().airspeed_mps < 9.0 {
            flight.step();
        }
        assert!(flight.controller.abort_take_off());
        flight.run(15.0);
        let t = flight.plant.truth();
        assert!(t.on_ground && !t.crashed && t.throttle < 0.01, "{name}: {}", flight.describe());
        assert!(t.position_ned_m.y.abs() < 10.0, "{name}: {}", flight.describe());
        assert_eq!(flight.controller.take_off_phase(), Some(Phase::Aborted));
        let mut flight = begun(text, 740_012, 2.0, 30.0, Turbulence::Calm);
        while flight.controller.take_off_phase() != Some(Phase::Climbing) {
            flight.step();
        }
        assert!(!flight.controller.abort_take_off(), "{name}: it is faster than a wheel should be");
    }
}

#[test]
fn take_off_without_a_state_or_a_straight_line_stops_by_itself() {
    let mut flight = begun(common::AEROSONDE, 740_021, 0.0, 0.0, Turbulence::Calm);
    flight.run(1.0);
    flight.estimator_dead = true;
    flight.run(14.0);
    assert_eq!(flight.controller.take_off_phase(), Some(Phase::Aborted));
    assert!(flight.plant.truth().on_ground && !flight.plant.truth().crashed);
    // Gusts of 7 m/s from the side turn an aircraft on a tail wheel into them before its rudder can hold it.
    let mut flight = begun(common::RASCAL, 740_003, 3.0, 90.0, Turbulence::Light);
    flight.run(14.0);
    let t = flight.plant.truth();
    assert_eq!(flight.controller.take_off_phase(), Some(Phase::Aborted));
    assert!(!t.crashed && t.velocity_ned_mps.norm() < 3.0, "{}", flight.describe());
}

#[test]
fn thrown_aircraft_starts_its_motor_and_climbs_away() {
    for (name, text) in AIRCRAFT {
        let mut options = Options::new(740_031, 2.0, 0.0, Turbulence::Light);
        options.airframe = text;
        // Out of the hand or off the rail at this speed; the estimator has nothing but what it finds in the air.
        options.start = Some(FlightStart { height_m: 25.0, airspeed_mps: 17.0, ..FlightStart::default() });
        let mut flight = Flight::new(options);
        flight.controller.take_off(Method::Launch);
        assert_eq!(flight.controller.take_off_phase(), Some(Phase::Waiting));
        for _ in 0..2000 {
            flight.step();
            assert!(!flight.plant.truth().crashed, "{name}: {}", flight.describe());
            if flight.controller.take_off_phase().is_none() {
                break;
            }
        }
        assert_eq!(flight.controller.take_off_phase(), None, "{name}: {}", flight.describe());
        flight.run_mission(400.0);
    }
}
