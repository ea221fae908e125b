//! Each limit of the envelope, provoked on three aircraft in light turbulence: somebody asks for more, and the aircraft stays within.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a panic here is a failed test")]

mod common;

use bateleur_flight::GRAVITY_MPS2;
use bateleur_flight::airframe::Airframe;
use bateleur_flight::control::LoopCommands;
use bateleur_flight::control::envelope::{Envelope, Limits, Protection};
use bateleur_plant::{Truth, Turbulence};
use common::{Flight, FlightStart, Options};

const AIRCRAFT: [(&str, &str); 3] = [
    ("Aerosonde", common::AEROSONDE),
    ("Rascal 110", common::RASCAL),
    ("Ultra Stick 25e", common::ULTRA_STICK),
];

/// Wings level at 160 m and 22 m/s, then what `set` asks for during `seconds`; the frames of that.
fn fly(text: &'static str, turbulence: Turbulence, seconds: f64, set: impl Fn(&mut LoopCommands)) -> Flight {
    let mut options = Options::new(730_001, 3.0, 40.0, turbulence);
    (options.airframe, options.start) =
        (text, Some(FlightStart { height_m: 300.0, ..FlightStart::default() }));
    let mut flight = Flight::new(options);
    flight.commands = LoopCommands {
        bank_rad: Some(0.0),
        altitude_m: Some(300.0),
        airspeed_mps: Some(22.0),
        navigation: false,
        ..LoopCommands::MISSION
    };
    flight.run(15.0);
    flight.frames.clear();
    set(&mut flight.commands);
    flight.run(seconds);
    assert!(!flight.plant.truth().crashed, "{}", flight.describe());
    flight
}

fn limits(text: &str, airspeed_mps: f64) -> Limits {
    let airframe = Airframe::from_toml(text).unwrap();
    Envelope::new(&airframe).limits(&airframe, airspeed_mps, 1.19, 60f64.to_radians())
}

fn greatest(flight: &Flight, of: impl Fn(&Truth) -> f64) -> f64 {
    flight.frames.iter().map(|frame| of(&frame.truth)).fold(f64::NEG_INFINITY, f64::max)
}

fn noted(flight: &Flight, bit: u32) -> bool {
    flight.frames.iter().any(|frame| frame.output.protection.has(bit))
}

#[test]
fn bank_beyond_what_can_be_held_is_not_flown() {
    for (name, text) in AIRCRAFT {
        for asked in [1.4, -1.4] {
            let flight = fly(text, Turbulence::Light, 10.0, |c| c.bank_rad = Some(asked));
            let bank = greatest(&flight, |t| t.roll_rad.abs()).to_degrees();
            let most = limits(text, 24.0).bank_rad.to_degrees();
            println!("{name}: {bank:.0}° of {most:.0}°");
            assert!(bank < most + 6.0 && bank > most - 20.0, "{name}: {bank}° of {most}°");
            assert!(noted(&flight, Protection::BANK), "{name}");
            let height = -flight.plant.truth().position_ned_m.z;
            assert!(
                (height - 300.0).abs() < 25.0,
                "{name}: a bank that can be held costs no height, {height} m"
            );
        }
    }
}

#[test]
fn roll_rate_that_goes_on_ends_at_the_bank_limit() {
    for (name, text) in AIRCRAFT {
        let ask = |c: &mut LoopCommands| (c.bank_rad, c.roll_rate_radps) = (None, Some(1.0));
        let flight = fly(text, Turbulence::Calm, 10.0, ask);
        let bank = greatest(&flight, |t| t.roll_rad.abs()).to_degrees();
        assert!(bank < limits(text, 24.0).bank_rad.to_degrees() + 6.0, "{name}: {bank}°");
        assert!(noted(&flight, Protection::BANK), "{name}");
    }
}

#[test]
fn load_factor_stays_within_structure_wing_and_elevator() {
    for (name, text) in AIRCRAFT {
        let flight = fly(text, Turbulence::Calm, 1.5, |c| c.normal_mps2 = Some(-60.0));
        let load = greatest(&flight, |t| -t.specific_force_mps2.z / GRAVITY_MPS2);
        let most = limits(text, 22.0).load_factor;
        println!("{name}: {load:.2} of {most:.2}");
        assert!(load < 1.25 * most && load > 1.0 + 0.6 * (most - 1.0), "{name}: {load} of {most}");
        assert!(noted(&flight, Protection::LOAD_FACTOR) || noted(&flight, Protection::LIFT), "{name}");
    }
}

#[test]
fn stall_is_not_reached_however_slow_and_hard_somebody_pulls() {
    for (name, text) in AIRCRAFT {
        let plant = bateleur_plant::Airframe::from_toml(text).unwrap();
        let (_, stall) = bateleur_plant::aerodynamics::greatest_lift(&plant.aerodynamics);
        for turbulence in [Turbulence::Calm, Turbulence::Light] {
            // Throttle closed and the stick in the belly.
            let flight = fly(text, turbulence, 25.0, |c| {
                (c.axial_mps2, c.normal_mps2) = (Some(-5.0), Some(-35.0));
            });
            let alpha = greatest(&flight, |t| t.alpha_rad);
            let slowest = -greatest(&flight, |t| -t.airspeed_mps);
            let floor = limits(text, 22.0).floor_mps;
            println!(
                "{name} {turbulence:?}: {:.1}° of {:.1}°, {slowest:.1} m/s of {floor:.1} m/s",
                alpha.to_degrees(),
                stall.to_degrees()
            );
            assert!(
                alpha < stall,
                "{name} {turbulence:?}: {}° of {}°",
                alpha.to_degrees(),
                stall.to_degrees()
            );
            assert!(noted(&flight, Protection::LIFT) || noted(&flight, Protection::LOAD_FACTOR), "{name}");
        }
    }
}

#[test]
fn airspeed_stays_above_its_floor_whoever_asks() {
    type Ask = fn(&mut LoopCommands);
    let asks: [(&str, Ask); 3] = [
        ("airspeed 10 m/s", |c| c.airspeed_mps = Some(10.0)),
        ("throttle closed at a held altitude", |c| c.axial_mps2 = Some(-5.0)),
        ("a climb of 10 m/s", |c| (c.altitude_m, c.axial_mps2) = (Some(1000.0), Some(-1.0))),
    ];
    for (name, text) in AIRCRAFT {
        for (what, ask) in asks {
            let flight = fly(text, Turbulence::Calm, 40.0, ask);
            let slowest = -greatest(&flight, |t| -t.airspeed_mps);
            let floor = limits(text, 22.0).floor_mps;
            println!("{name}, {what}: {slowest:.1} m/s of {floor:.1} m/s");
            assert!(slowest > floor - 0.8, "{name}, {what}: {slowest} m/s of {floor} m/s");
            if slowest < floor - 0.1 {
                assert!(noted(&flight, Protection::AIRSPEED), "{name}, {what}");
            }
        }
    }
}

#[test]
fn airspeed_that_is_never_reached_does_not_keep_the_aircraft_from_climbing() {
    for (name, text) in AIRCRAFT {
        let ask = |c: &mut LoopCommands| (c.airspeed_mps, c.altitude_m) = (Some(60.0), Some(380.0));
        let flight = fly(text, Turbulence::Calm, 90.0, ask);
        let truth = flight.plant.truth();
        let (height, fastest) = (-truth.position_ned_m.z, Airframe::from_toml(text).unwrap().fastest_mps());
        println!("{name}: {height:.0} m, {:.1} m/s of {fastest:.1} m/s", truth.airspeed_mps);
        assert!((height - 380.0).abs() < 20.0, "{name}: {height} m");
        assert!(truth.airspeed_mps > fastest - 2.5, "{name}: {} m/s", truth.airspeed_mps);
    }
}

#[test]
fn pulling_on_and_on_flies_no_loop_and_pushing_no_dive() {
    for (name, text) in AIRCRAFT {
        for asked in [-35.0, -2.0] {
            let flight = fly(text, Turbulence::Light, 8.0, |c| c.normal_mps2 = Some(asked));
            let steepest = greatest(&flight, |t| {
                let air = t.velocity_ned_mps - t.wind_ned_mps;
                (air.z / air.norm()).abs().asin()
            });
            println!("{name} {asked}: {:.0}°", steepest.to_degrees());
            assert!(steepest.to_degrees() < 40.0, "{name} {asked}: {}°", steepest.to_degrees());
            assert!(noted(&flight, Protection::CLIMB), "{name} {asked}");
        }
    }
}

#[test]
fn nothing_is_protected_in_the_flight_of_the_mission() {
    for (name, text) in AIRCRAFT {
        let mut options = Options::new(730_002, 5.0, 100.0, Turbulence::Light);
        options.airframe = text;
        let mut flight = Flight::new(options);
        flight.run_mission(400.0);
        let first =
            flight.frames.iter().position(|f| f.output.guidance.is_some_and(|g| g.reached >= 1)).unwrap();
        let count = flight.frames[first..].iter().filter(|f| f.output.protection.0 != 0).count();
        let share = count as f64 / (flight.frames.len() - first) as f64;
        println!("{name}: {share:.4}");
        assert!(share < 0.01, "{name}: limits were reached in {share} of all frames");
    }
}
