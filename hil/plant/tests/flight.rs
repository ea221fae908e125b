//! Trim, modes, runway and wind of the whole aircraft.

use bateleur_plant::atmosphere::GRAVITY_MPS2;
use bateleur_plant::{
    Airframe, Conditions, Controls, FlightStart, SensorErrors, Simulation, StartError, Truth, Turbulence,
    trim,
};
use nalgebra::Vector3;

const FRAME_S: f64 = 0.02;

fn quiet() -> Conditions {
    Conditions { sensors: SensorErrors::none(), ..Conditions::default() }
}

fn run(plant: &mut Simulation, seconds: f64, mut law: impl FnMut(&Truth) -> Controls) -> Vec<Truth> {
    let mut log = Vec::new();
    for _ in 0..(seconds / FRAME_S).round() as usize {
        let truth = plant.truth();
        plant.advance(law(&truth), FRAME_S);
        log.push(plant.truth());
    }
    log
}

#[test]
fn aerosonde_trims_where_its_published_model_does() {
    // The published model takes 1.2682 kg/m³ for the density of air, which the standard atmosphere has at −358 m.
    let trim = trim(&Airframe::aerosonde(), 22.0, 0.0, -358.0).unwrap();
    println!("{trim:?}");
    assert!((trim.alpha_rad.to_degrees() - 4.5).abs() < 0.1, "{trim:?}");
    assert!((trim.controls.elevator_rad + 0.20).abs() < 0.005, "{trim:?}");
    assert!((trim.controls.throttle - 0.69).abs() < 0.01, "{trim:?}");
}

#[test]
fn trim_out_of_reach_says_which_control() {
    let message = trim(&Airframe::aerosonde(), 60.0, 0.0, 160.0).unwrap_err().to_string();
    assert!(message.contains("the throttle"), "{message}");
}

fn without_rudder() -> Airframe {
    let mut wing = Airframe::aerosonde();
    let a = &mut wing.aerodynamics;
    (a.yaw_rudder, a.side_rudder, a.roll_rudder) = (0.0, 0.0, 0.0);
    wing
}

#[test]
fn aircraft_without_a_rudder_trims_with_a_little_bank() {
    for climb_angle_rad in [0.0, 0.1] {
        let found = trim(&without_rudder(), 22.0, climb_angle_rad, 160.0).unwrap();
        assert_eq!(found.controls.rudder_rad, 0.0);
        assert!(found.bank_rad != 0.0 && found.bank_rad.abs() < 0.1, "{found:?}");
    }
}

#[test]
fn trimmed_aircraft_flies_straight_hands_off() {
    for airframe in [Airframe::aerosonde(), Airframe::rascal110(), without_rudder()] {
        for wind in [0.0, 8.0] {
            let conditions = Conditions { wind_speed_mps: wind, wind_from_rad: 1.0, ..quiet() };
            let start = FlightStart { heading_rad: 0.5, ..FlightStart::default() };
            let mut plant = Simulation::in_flight(&airframe, &conditions, &start).unwrap();
            let controls = trim(&airframe, 22.0, 0.0, 160.0).unwrap().controls;
            let end = *run(&mut plant, 4.0, |_| controls).last().unwrap();
            assert!((end.airspeed_mps - 22.0).abs() < 0.01, "{} {}", airframe.name, end.airspeed_mps);
            assert!(
                (end.position_ned_m.z + 160.0).abs() < 0.05,
                "{} {}",
                airframe.name,
                end.position_ned_m.z
            );
            let air = end.velocity_ned_mps - end.wind_ned_mps;
            assert!((air.y.atan2(air.x) - 0.5).abs() < 1e-3, "{} {air}", airframe.name);
        }
    }
}

#[test]
fn start_with_a_senseless_airframe_is_refused() {
    let mut airframe = Airframe::aerosonde();
    airframe.mass.mass_kg = -1.0;
    let refused = Simulation::in_flight(&airframe, &quiet(), &FlightStart::default());
    assert!(matches!(refused, Err(StartError::Airframe(_))));
    assert!(Simulation::new(&airframe, &quiet()).is_err());
}

#[test]
fn surfaces_act_in_the_direction_the_signs_say() {
    let airframe = Airframe::aerosonde();
    let controls = trim(&airframe, 22.0, 0.0, 160.0).unwrap().controls;
    let after = |change: Controls| {
        let mut plant = Simulation::in_flight(&airframe, &quiet(), &FlightStart::default()).unwrap();
        let sum = Controls {
            aileron_rad: controls.aileron_rad + change.aileron_rad,
            elevator_rad: controls.elevator_rad + change.elevator_rad,
            rudder_rad: controls.rudder_rad + change.rudder_rad,
            throttle: controls.throttle + change.throttle,
        };
        run(&mut plant, 0.14, |_| sum).last().unwrap().rates_radps
    };
    assert!(after(Controls { aileron_rad: 0.05, ..Controls::default() }).x > 0.1);
    assert!(after(Controls { elevator_rad: 0.05, ..Controls::default() }).y < -0.05);
    assert!(after(Controls { rudder_rad: 0.05, ..Controls::default() }).z < -0.01);
}

#[test]
fn parked_aircraft_stands_still() {
    for airframe in [Airframe::aerosonde(), Airframe::rascal110()] {
        let mut plant = Simulation::new(&airframe, &quiet()).unwrap();
        let before = plant.truth();
        let after = *run(&mut plant, 20.0, |_| Controls::default()).last().unwrap();
        println!("{} parked at pitch {:.2} deg", airframe.name, after.pitch_rad.to_degrees());
        assert!(after.on_ground && !after.crashed);
        let moved = (after.position_ned_m - before.position_ned_m).norm();
        assert!(moved < 2e-3, "{} moved {moved} m", airframe.name);
        assert!(after.velocity_ned_mps.norm() < 1e-4 && after.rates_radps.norm() < 1e-4, "{}", airframe.name);
        let up = after.attitude * after.specific_force_mps2;
        assert!((up - Vector3::new(0.0, 0.0, -GRAVITY_MPS2)).norm() < 1e-3, "{}: {up}", airframe.name);
    }
}

#[test]
fn parked_aircraft_is_held_in_a_side_wind() {
    for airframe in [Airframe::aerosonde(), Airframe::rascal110()] {
        let conditions = Conditions { wind_speed_mps: 8.0, wind_from_rad: 1.57, ..quiet() };
        let mut plant = Simulation::new(&airframe, &conditions).unwrap();
        let after = *run(&mut plant, 20.0, |_| Controls::default()).last().unwrap();
        println!("{}: {} m, yaw {:.1} deg", airframe.name, after.position_ned_m, after.yaw_rad.to_degrees());
        assert!(after.on_ground && !after.crashed);
        assert!(
            after.position_ned_m.xy().norm() < 0.5,
            "{} blown away: {}",
            airframe.name,
            after.position_ned_m
        );
        assert!(after.roll_rad.abs() < 0.2, "{} banked {}", airframe.name, after.roll_rad);
    }
}

fn pilot(t: &Truth, pitch_rad: f64) -> Controls {
    Controls {
        aileron_rad: -0.8 * t.roll_rad - 0.1 * t.rates_radps.x,
        elevator_rad: -0.15 + 1.0 * (t.pitch_rad - pitch_rad) + 0.15 * t.rates_radps.y,
        rudder_rad: 1.5 * t.yaw_rad + 0.3 * t.rates_radps.z,
        throttle: 1.0,
    }
}

#[test]
fn aircraft_takes_off_at_full_throttle_with_a_simple_pitch_hold() {
    for airframe in [Airframe::aerosonde(), Airframe::rascal110()] {
        for (speed, from) in [(0.0, 0.0), (8.0, 0.0), (5.0, 1.57)] {
            let conditions = Conditions { wind_speed_mps: speed, wind_from_rad: from, ..quiet() };
            let mut plant = Simulation::new(&airframe, &conditions).unwrap();
            let log = run(&mut plant, 30.0, |t| pilot(t, 0.15));
            let end = log.last().unwrap();
            let off = log.iter().find(|t| !t.on_ground && t.position_ned_m.z < -2.0).unwrap();
            println!(
                "{} wind {speed} from {from}: off at {:.1} s, {:.0} m, {:.1} m/s; after 30 s {:.0} m high",
                airframe.name, off.time_s, off.position_ned_m.x, off.airspeed_mps, -end.position_ned_m.z
            );
            assert!(!end.crashed && !end.on_ground);
            assert!(-end.position_ned_m.z > 60.0, "{} only {} m high", airframe.name, -end.position_ned_m.z);
            assert!(
                off.position_ned_m.y.abs() < 15.0,
                "{} left the runway: {}",
                airframe.name,
                off.position_ned_m
            );
        }
    }
}

#[test]
fn full_down_elevator_ends_in_a_crash_and_a_wreck_that_lies_still() {
    let start = FlightStart { height_m: 40.0, ..FlightStart::default() };
    let mut plant = Simulation::in_flight(&Airframe::aerosonde(), &quiet(), &start).unwrap();
    let dive = Controls { elevator_rad: 0.3, throttle: 1.0, ..Controls::default() };
    let log = run(&mut plant, 10.0, |_| dive);
    let end = log.last().unwrap();
    assert!(end.crashed && end.velocity_ned_mps == Vector3::zeros());
    assert!(end.position_ned_m.iter().all(|x| x.is_finite()));
    plant.sensors();
    plant.advance(dive, FRAME_S);
    assert!((plant.sensors().accelerometer_mps2.norm() - GRAVITY_MPS2).abs() < 1e-9);
}

#[test]
fn wind_asked_for_is_the_wind_in_the_truth() {
    let conditions = Conditions {
        wind_speed_mps: 8.0,
        wind_from_rad: 1.5 * std::f64::consts::PI,
        turbulence: Turbulence::Moderate,
        ..quiet()
    };
    let airframe = Airframe::aerosonde();
    let (mut sum, mut square, mut n) = (Vector3::zeros(), Vector3::zeros(), 0.0);
    for seed in 0..60 {
        let conditions = Conditions { seed, ..conditions.clone() };
        let mut plant = Simulation::in_flight(&airframe, &conditions, &FlightStart::default()).unwrap();
        for truth in run(&mut plant, 20.0, |t| Controls { throttle: 0.69, ..pilot(t, 0.08) }) {
            sum += truth.wind_ned_mps;
            square += truth.gust_ned_mps.component_mul(&truth.gust_ned_mps);
            n += 1.0;
        }
    }
    let (mean, sigma) = (sum / n, (square / n).map(f64::sqrt));
    println!("mean wind {mean} sigma {sigma}");
    assert!((mean - Vector3::new(0.0, 8.0, 0.0)).norm() < 1.0, "{mean}");
    assert!((sigma.z / 1.54 - 1.0).abs() < 0.12, "{sigma}");
    assert!(sigma.x > 1.6 && sigma.x < 3.2, "{sigma}");
}

#[test]
fn same_seed_gives_the_same_bits_and_cuts_do_not_matter() {
    let conditions = Conditions {
        seed: 7,
        wind_speed_mps: 5.0,
        turbulence: Turbulence::Moderate,
        ..Conditions::default()
    };
    let airframe = Airframe::aerosonde();
    let fly = |steps: usize, dt: f64| {
        let mut plant = Simulation::in_flight(&airframe, &conditions, &FlightStart::default()).unwrap();
        let controls = Controls { elevator_rad: -0.2, throttle: 0.69, ..Controls::default() };
        (0..steps).for_each(|_| plant.advance(controls, dt));
        (plant.truth(), plant.sensors())
    };
    let (truth, sensed) = fly(500, 0.02);
    assert_eq!(fly(500, 0.02), (truth, sensed));
    assert_eq!(fly(2000, 0.005).0, truth);
    assert_eq!(fly(2000, 0.005).1, sensed);
}

#[test]
fn another_seed_and_sensors_switched_off_do_not_shift_the_gusts() {
    let airframe = Airframe::aerosonde();
    let gusts = |conditions: Conditions| {
        let mut plant = Simulation::in_flight(&airframe, &conditions, &FlightStart::default()).unwrap();
        run(&mut plant, 2.0, |_| Controls { elevator_rad: -0.2, throttle: 0.69, ..Controls::default() })
            .iter()
            .map(|t| t.gust_ned_mps)
            .collect::<Vec<_>>()
    };
    let base = Conditions { seed: 3, turbulence: Turbulence::Light, ..Conditions::default() };
    let deaf = Conditions { sensors: SensorErrors::none(), ..base.clone() };
    let other = Conditions { seed: 4, ..base.clone() };
    assert_eq!(gusts(base.clone()), gusts(deaf));
    assert_ne!(gusts(base), gusts(other));
}

#[test]
fn airframes_varied_by_a_fifth_still_trim() {
    for seed in 0..64_u32 {
        let mut airframe = Airframe::aerosonde();
        let part = |bit: u32, by: f64| if seed >> bit & 1 == 1 { 1.0 + by } else { 1.0 - by };
        airframe.mass.mass_kg *= part(0, 0.1);
        airframe.aerodynamics.lift_alpha *= part(1, 0.2);
        airframe.aerodynamics.pitch_alpha *= part(2, 0.2);
        airframe.aerodynamics.pitch_elevator *= part(3, 0.2);
        airframe.aerodynamics.drag_0 *= part(4, 0.2);
        airframe.aerodynamics.yaw_beta *= part(5, 0.2);
        let trim = trim(&airframe, 22.0, 0.0, 160.0).unwrap();
        assert!((0.4..0.95).contains(&trim.controls.throttle), "{trim:?}");
    }
}
