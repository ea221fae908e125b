use super::*;
use bateleur_flight::GRAVITY_MPS2;
use bateleur_flight::airframe::Airframe;
use bateleur_flight::control::ControllerConfig;
use bateleur_messages::State;
use bateleur_messages::ground;
use bateleur_messages::state::STATUS_RUNNING;
use nalgebra::Vector3;

const CYCLE: u64 = 20_000_000;

fn settings() -> Settings {
    let airframe = include_str!("../../../airframes/aerosonde.toml");
    Settings {
        airframe: Airframe::from_toml(airframe).unwrap(),
        guidance: GuidanceConfig { laps: 2, ..GuidanceConfig::default() },
        control: ControllerConfig::default(),
    }
}

fn function() -> Function {
    Function::new(settings(), &[], None).unwrap()
}

/// A state of level flight at 22 m/s to the north, this far east of the runway and high above it.
fn flying(east_m: f64, altitude_m: f64) -> NavigationState {
    navigation_state(&State {
        position_ned_m: [100.0, east_m, -altitude_m],
        velocity_ned_mps: [22.0, 0.0, 0.0],
        quaternion: [1.0, 0.0, 0.0, 0.0],
        specific_force_mps2: [0.0, 0.0, -GRAVITY_MPS2],
        status: STATUS_RUNNING,
        ..State::default()
    })
    .unwrap()
}

fn sensors() -> Sensors {
    Sensors {
        rates_radps: Vector3::zeros(),
        specific_force_mps2: Vector3::new(0.0, 0.0, -GRAVITY_MPS2),
        airspeed_mps: Some(22.0),
        density_kgpm3: Some(1.2),
    }
}

fn fly(
    function: &mut Function,
    cycles: std::ops::Range<u64>,
    state: Option<&NavigationState>,
) -> ActuatorCommand {
    cycles.map(|cycle| function.step(cycle * CYCLE, CYCLE, state, &sensors())).last().unwrap()
}

fn load_waypoints(function: &mut Function) {
    for (point, index) in seed_waypoints().iter().zip(0..) {
        let message = ground::Waypoint {
            index,
            count: 4,
            north_m: point.north_m,
            east_m: point.east_m,
            altitude_m: point.altitude_m,
            heading_rad: point.heading_rad,
            airspeed_mps: point.airspeed_mps,
        };
        assert_eq!(function.order(&Order::Waypoint(message), true), Answer::Accepted);
    }
}

fn on_mission() -> Function {
    let mut function = function();
    load_waypoints(&mut function);
    assert_eq!(function.order(&Order::Navigation { on: true }, true), Answer::Accepted);
    assert_eq!(function.order(&Order::Autopilot { on: true }, true), Answer::Accepted);
    function
}

#[test]
fn nothing_is_claimed_before_the_autopilot_is_on() {
    let mut function = function();
    let command = fly(&mut function, 1..50, Some(&flying(0.0, 160.0)));
    assert_eq!((command.engaged, function.loops(0).engaged), (0, 0));
    assert_eq!(function.status(1).enabled, 0);
}

#[test]
fn navigation_without_way_points_is_refused() {
    let mut function = function();
    assert_eq!(function.order(&Order::Navigation { on: true }, true), Answer::Refused(Refusal::NoWaypoints));
    load_waypoints(&mut function);
    assert_eq!(function.order(&Order::Navigation { on: true }, true), Answer::Accepted);
}

#[test]
fn the_autopilot_is_refused_without_a_state() {
    let mut function = function();
    assert_eq!(function.order(&Order::Autopilot { on: true }, false), Answer::Refused(Refusal::NoState));
    assert_eq!(function.order(&Order::Autopilot { on: true }, true), Answer::Accepted);
    // Said again while the Estimator is away for a moment: it is on already.
    assert_eq!(function.order(&Order::Autopilot { on: true }, false), Answer::Accepted);
}

#[test]
fn an_aircraft_right_of_its_track_is_banked_to_the_left() {
    let mut function = on_mission();
    let command = fly(&mut function, 1..50, Some(&flying(20.0, 160.0)));
    assert_eq!((command.engaged, command.next_waypoint), (1, 0));
    assert!((command.cross_track_m - 20.0).abs() < 1.0, "{command:?}");
    assert!(command.bank_reference_rad < -0.1 && command.aileron_rad < 0.0, "{command:?}");
    assert_eq!((command.altitude_reference_m, command.airspeed_reference_mps), (160.0, 22.0));
}

#[test]
fn the_autopilot_alone_holds_level_flight_where_it_was_switched_on() {
    let mut function = function();
    function.order(&Order::Autopilot { on: true }, true);
    let command = fly(&mut function, 1..50, Some(&flying(0.0, 87.0)));
    assert_eq!((command.engaged, command.altitude_reference_m, command.bank_reference_rad), (1, 87.0, 0.0));
    assert_eq!(fly(&mut function, 50..60, Some(&flying(0.0, 90.0))).altitude_reference_m, 87.0);
    let closed = function.loops(0).engaged;
    let bit = |id: LoopId| closed & (1 << (id as u64)) != 0;
    assert!(bit(LoopId::Altitude) && bit(LoopId::Airspeed) && bit(LoopId::RollAngle) && bit(LoopId::Normal));
    assert!(!bit(LoopId::Heading) && !bit(LoopId::PitchRate));
}

#[test]
fn a_single_loop_takes_the_place_of_its_default() {
    let mut function = function();
    function.order(&Order::Autopilot { on: true }, true);
    function.order(&Order::Loop { id: LoopId::RollAngle, on: true, target: 0.4 }, true);
    let command = fly(&mut function, 1..50, Some(&flying(0.0, 87.0)));
    assert!((command.bank_reference_rad - 0.4).abs() < 1e-9 && command.aileron_rad > 0.0);
    function.order(&Order::Loop { id: LoopId::ClimbRate, on: true, target: 2.0 }, true);
    let climbing = fly(&mut function, 50..60, Some(&flying(0.0, 87.0)));
    assert!(climbing.elevator_rad < command.elevator_rad, "up is a negative elevator");
}

#[test]
fn a_silent_estimator_does_not_let_go_of_the_actuators() {
    let mut function = on_mission();
    fly(&mut function, 1..50, Some(&flying(0.0, 160.0)));
    let command = fly(&mut function, 50..300, None);
    assert_eq!((command.engaged, function.status(1).ready), (1, 0));
    assert!([command.throttle, command.aileron_rad, command.elevator_rad].iter().all(|x| x.is_finite()));
}

#[test]
fn a_warm_restart_keeps_the_mission_and_the_actuators() {
    let mut first = on_mission();
    let state = flying(8.0, 158.0);
    let before = fly(&mut first, 1..200, Some(&state));
    let kept = first.kept();
    let mut second = Function::new(settings(), &[], Some(&kept)).unwrap();
    let after = second.step(203 * CYCLE, CYCLE, Some(&state), &sensors());
    assert_eq!((after.engaged, after.next_waypoint), (1, before.next_waypoint));
    assert!((after.elevator_rad - before.elevator_rad).abs() < 0.01, "{before:?} {after:?}");
    assert!((after.throttle - before.throttle).abs() < 0.05, "{before:?} {after:?}");
    assert_eq!(second.waypoints, first.waypoints);
    assert_eq!(second.orders, first.orders);
}

#[test]
fn kept_memory_comes_back_as_it_was() {
    let mut function = on_mission();
    function.order(&Order::Loop { id: LoopId::Lateral, on: true, target: 0.5 }, true);
    fly(&mut function, 1..10, Some(&flying(0.0, 160.0)));
    let kept = function.kept();
    assert!(kept.is_sane());
    assert_eq!((kept.orders(), kept.waypoints()), (function.orders, function.waypoints));
}

#[test]
fn retained_memory_full_of_noise_is_a_cold_start() {
    use zerocopy::FromBytes;
    for byte in [0x3f, 0xa5, 0xff] {
        let noise = Kept::read_from_bytes(&vec![byte; size_of::<Kept>()]).unwrap();
        let mut function = Function::new(settings(), &[], Some(&noise)).unwrap();
        assert_eq!(fly(&mut function, 1..5, Some(&flying(0.0, 160.0))).engaged, 0);
    }
}

#[test]
fn the_plans_way_points_can_be_flown_without_a_word_from_the_ground() {
    let mut function = Function::new(settings(), &seed_waypoints(), None).unwrap();
    assert_eq!(function.order(&Order::Navigation { on: true }, true), Answer::Accepted);
    assert_eq!(function.navigation(7).waypoint_count, 4);
    assert_eq!(function.navigation(7).flags, NAVIGATION_ON);
}

#[test]
fn moving_one_way_point_does_not_begin_the_mission_anew() {
    let mut function = on_mission();
    let progress = GuidanceSnapshot { next: 2, reached: 6 };
    function.controller.guidance_mut().resume(&progress);
    let moved = ground::Waypoint {
        index: 1,
        count: 4,
        north_m: 450.0,
        east_m: 500.0,
        altitude_m: 160.0,
        heading_rad: 0.0,
        airspeed_mps: 22.0,
    };
    assert_eq!(function.order(&Order::Waypoint(moved), true), Answer::Accepted);
    assert_eq!(function.controller.guidance().snapshot(), progress);
    assert_eq!(function.controller.guidance().waypoints()[1].north_m, 450.0);
}

#[test]
fn two_laps_of_four_way_points_are_finished_with_the_return_to_the_first() {
    let mut function = on_mission();
    function.controller.guidance_mut().resume(&GuidanceSnapshot { next: 0, reached: 8 });
    assert_eq!(fly(&mut function, 1..3, Some(&flying(0.0, 160.0))).finished, 0);
    function.controller.guidance_mut().resume(&GuidanceSnapshot { next: 1, reached: 9 });
    assert_eq!(fly(&mut function, 3..5, Some(&flying(0.0, 160.0))).finished, 1);
    assert_eq!(function.navigation(0).flags & NAVIGATION_FINISHED, NAVIGATION_FINISHED);
    // Switched on again, the mission begins at its first way-point.
    function.order(&Order::Navigation { on: false }, true);
    function.order(&Order::Navigation { on: true }, true);
    assert_eq!(function.controller.guidance().snapshot(), GuidanceSnapshot::default());
}
