use super::*;
use bateleur_flight::GRAVITY_MPS2;
use bateleur_flight::airframe::Airframe;
use bateleur_flight::control::ControllerConfig;
use bateleur_flight::control::takeoff::Method;
use bateleur_flight::guidance::GuidanceSnapshot;
use bateleur_messages::State;
use bateleur_messages::control::{TASK_LOOPS, TASK_MISSION, TASK_ROLLING};
use bateleur_messages::ground;
use bateleur_messages::ground::{Manoeuvre, Reason};
use bateleur_messages::state::STATUS_RUNNING;
use nalgebra::Vector3;

const CYCLE: u64 = 20_000_000;

fn settings() -> Settings {
    let airframe = include_str!("../../../airframes/aerosonde.toml");
    Settings {
        airframe: Airframe::from_toml(airframe).unwrap(),
        guidance: GuidanceConfig { laps: 2, ..GuidanceConfig::default() },
        control: ControllerConfig::default(),
        take_off: Method::Roll,
        fence: Fence::default(),
        return_m: 100.0,
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
        range_m: None,
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
            step: ground::Step::Pass,
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
        step: ground::Step::Pass,
    };
    assert_eq!(function.order(&Order::Waypoint(moved), true), Answer::Accepted);
    assert_eq!(function.controller.guidance().snapshot(), progress);
    assert_eq!(function.controller.guidance().waypoints()[1].north_m, 450.0);
}

/// The seed's way-points, this far further north, as a list of their own.
fn load_another_mission(function: &mut Function, north_m: f64) {
    let message = |index, count, point: &Waypoint| ground::Waypoint {
        index,
        count,
        north_m: point.north_m + north_m,
        east_m: point.east_m,
        altitude_m: point.altitude_m,
        heading_rad: point.heading_rad,
        airspeed_mps: point.airspeed_mps,
        step: ground::Step::Pass,
    };
    let points = seed_waypoints();
    function.order(&Order::Waypoint(message(0, 5, &points[0])), true);
    for (point, index) in points.iter().zip(0..) {
        let order = Order::Waypoint(message(index, 4, point));
        assert_eq!(function.order(&order, true), Answer::Accepted);
    }
}

#[test]
fn a_new_mission_of_as_many_way_points_is_not_gone_on_with_but_begun() {
    for progress in [GuidanceSnapshot { next: 2, reached: 6 }, GuidanceSnapshot { next: 1, reached: 9 }] {
        let mut function = on_mission();
        function.controller.guidance_mut().resume(&progress);
        load_another_mission(&mut function, 0.0);
        assert_eq!(function.controller.guidance().snapshot(), progress, "the same mission goes on");
        load_another_mission(&mut function, 40.0);
        assert_eq!(function.controller.guidance().snapshot(), GuidanceSnapshot::default());
        assert_eq!(fly(&mut function, 1..3, Some(&flying(0.0, 160.0))).finished, 0);
    }
}

#[test]
fn a_restart_while_a_new_mission_comes_in_goes_on_with_the_old_one_and_begins_the_new_one() {
    let mut first = on_mission();
    let progress = GuidanceSnapshot { next: 2, reached: 6 };
    first.controller.guidance_mut().resume(&progress);
    let begun = Order::Waypoint(ground::Waypoint {
        index: 0,
        count: 5,
        north_m: 0.0,
        east_m: 0.0,
        altitude_m: 160.0,
        heading_rad: 0.0,
        airspeed_mps: 22.0,
        step: ground::Step::Pass,
    });
    first.order(&begun, true);
    let mut second = Function::new(settings(), &[], Some(&first.kept())).unwrap();
    assert_eq!(second.controller.guidance().snapshot(), progress);
    load_another_mission(&mut second, 40.0);
    assert_eq!(second.controller.guidance().snapshot(), GuidanceSnapshot::default());
}

#[test]
fn navigation_ordered_again_begins_a_mission_that_is_over_anew_and_leaves_another_alone() {
    let mut function = on_mission();
    let on = Order::Navigation { on: true };
    let under_way = GuidanceSnapshot { next: 2, reached: 6 };
    function.controller.guidance_mut().resume(&under_way);
    function.order(&on, true);
    assert_eq!(function.controller.guidance().snapshot(), under_way);
    function.controller.guidance_mut().resume(&GuidanceSnapshot { next: 1, reached: 9 });
    function.order(&on, true);
    assert_eq!(function.controller.guidance().snapshot(), GuidanceSnapshot::default());
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

const LOITER: Order = Order::Manoeuvre { what: Manoeuvre::Loiter, reason: Reason::Ordered };
const GO_ON: Order = Order::Manoeuvre { what: Manoeuvre::GoOn, reason: Reason::Ordered };

fn flags(function: &mut Function) -> u32 {
    function.navigation(0).flags
}

#[test]
fn a_circle_takes_the_place_of_mission_and_loops_until_the_ground_says_go_on() {
    for loops in [false, true] {
        let mut function = on_mission();
        let state = flying(0.0, 155.0);
        if loops {
            function.order(&Order::Navigation { on: false }, true);
            function.order(&Order::Loop { id: LoopId::RollAngle, on: true, target: 0.1 }, true);
        }
        fly(&mut function, 1..50, Some(&state));
        assert_eq!(function.order(&LOITER, true), Answer::Accepted);
        fly(&mut function, 50..51, Some(&state));
        // The circle begins a lead ahead.
        let lead_s = GuidanceConfig::default().lead_s;
        let begun = NavigationState { position: state.position + state.velocity * lead_s, ..state };
        let circle = fly(&mut function, 51..150, Some(&begun));
        assert_eq!((circle.task, circle.altitude_reference_m), (TASK_LOITER, 155.0));
        assert!(circle.bank_reference_rad > 0.5, "{circle:?}");
        assert_eq!(flags(&mut function) & NAVIGATION_LOITER, NAVIGATION_LOITER);
        assert_eq!(function.order(&GO_ON, true), Answer::Accepted);
        let after = fly(&mut function, 150..200, Some(&state));
        assert_eq!(after.task, if loops { TASK_LOOPS } else { TASK_MISSION });
        assert!(!loops || (after.bank_reference_rad - 0.1).abs() < 1e-9);
    }
}

#[test]
fn a_circle_is_refused_without_the_autopilot() {
    let mut function = function();
    assert_eq!(function.order(&LOITER, true), Answer::Refused(Refusal::NotFlying));
}

#[test]
fn the_way_back_leads_to_the_runway_at_no_less_than_its_height() {
    let mut function = on_mission();
    let state = flying(600.0, 60.0);
    fly(&mut function, 1..20, Some(&state));
    let back = Order::Manoeuvre { what: Manoeuvre::Return, reason: Reason::LostLink };
    assert_eq!(function.order(&back, true), Answer::Accepted);
    let command = fly(&mut function, 20..60, Some(&state));
    assert_eq!((command.task, command.altitude_reference_m), (TASK_RETURN, 100.0));
    let told = flags(&mut function);
    assert_eq!(told & (NAVIGATION_RETURN | NAVIGATION_LINK_LOST), NAVIGATION_RETURN | NAVIGATION_LINK_LOST);
    assert!(command.bank_reference_rad < -0.3, "the runway lies to the left: {command:?}");
    // A silent ground that would circle does not stop the way back.
    let circle = Order::Manoeuvre { what: Manoeuvre::Loiter, reason: Reason::LostLink };
    function.order(&circle, true);
    assert_eq!(fly(&mut function, 60..70, Some(&state)).task, TASK_RETURN);
    function.order(&Order::Navigation { on: true }, true);
    assert_eq!(fly(&mut function, 70..80, Some(&state)).task, TASK_MISSION);
}

#[test]
fn a_warm_restart_keeps_the_circle() {
    let mut first = on_mission();
    let state = flying(0.0, 155.0);
    fly(&mut first, 1..50, Some(&state));
    first.order(&LOITER, true);
    let before = fly(&mut first, 50..150, Some(&state));
    let mut second = Function::new(settings(), &[], Some(&first.kept())).unwrap();
    let after = second.step(151 * CYCLE, CYCLE, Some(&state), &sensors());
    assert_eq!((after.task, after.altitude_reference_m), (TASK_LOITER, 155.0));
    assert!((after.cross_track_m - before.cross_track_m).abs() < 1e-6, "the same circle");
}

fn fenced(action: FenceAction) -> Function {
    let fence = Fence { radius_m: Some(700.0), floor_m: Some(40.0), ceiling_m: Some(200.0), action };
    let mut function = Function::new(Settings { fence, ..settings() }, &[], None).unwrap();
    load_waypoints(&mut function);
    function.order(&Order::Navigation { on: true }, true);
    function.order(&Order::Autopilot { on: true }, true);
    function
}

#[test]
fn leaving_the_fence_does_what_the_plan_says() {
    for (action, task) in [
        (FenceAction::None, TASK_MISSION),
        (FenceAction::Loiter, TASK_LOITER),
        (FenceAction::Return, TASK_RETURN),
    ] {
        let mut function = fenced(action);
        let inside = fly(&mut function, 1..20, Some(&flying(600.0, 160.0)));
        assert_eq!((inside.task, flags(&mut function) & NAVIGATION_OUTSIDE), (TASK_MISSION, 0));
        let outside = fly(&mut function, 20..40, Some(&flying(705.0, 160.0)));
        assert_eq!((outside.task, flags(&mut function) & NAVIGATION_OUTSIDE), (task, NAVIGATION_OUTSIDE));
        if action == FenceAction::None {
            continue;
        }
        // Nobody talks it out of coming back; once it is inside, the ground may.
        let refused = Answer::Refused(Refusal::OutsideFence);
        assert_eq!(function.order(&GO_ON, true), refused);
        assert_eq!(function.order(&Order::Navigation { on: true }, true), refused);
        assert_eq!(fly(&mut function, 40..60, Some(&flying(500.0, 160.0))).task, task);
        assert_eq!(function.order(&GO_ON, true), Answer::Accepted);
        assert_eq!(fly(&mut function, 60..70, Some(&flying(500.0, 160.0))).task, TASK_MISSION);
    }
}

#[test]
fn floor_and_ceiling_are_part_of_the_fence_and_the_floor_counts_after_the_climb() {
    let mut function = fenced(FenceAction::Loiter);
    assert_eq!(fly(&mut function, 1..20, Some(&flying(0.0, 10.0))).task, TASK_MISSION, "still below");
    assert_eq!(fly(&mut function, 20..40, Some(&flying(0.0, 60.0))).task, TASK_MISSION);
    let low = fly(&mut function, 40..60, Some(&flying(0.0, 35.0)));
    assert_eq!((low.task, low.altitude_reference_m), (TASK_LOITER, 50.0));
    let mut function = fenced(FenceAction::Loiter);
    let high = fly(&mut function, 1..20, Some(&flying(0.0, 205.0)));
    assert_eq!((high.task, high.altitude_reference_m), (TASK_LOITER, 190.0));
}

#[test]
fn a_take_off_is_ordered_standing_and_aborted_rolling() {
    let order = |what| Order::Manoeuvre { what, reason: Reason::Ordered };
    let standing = navigation_state(&State {
        position_ned_m: [0.0, 0.0, -0.3],
        quaternion: [1.0, 0.0, 0.0, 0.0],
        specific_force_mps2: [0.0, 0.0, -GRAVITY_MPS2],
        status: STATUS_RUNNING,
        ..State::default()
    })
    .unwrap();
    let mut function = function();
    let calm = Sensors { airspeed_mps: Some(1.0), ..sensors() };
    let step =
        |function: &mut Function, cycle: u64| function.step(cycle * CYCLE, CYCLE, Some(&standing), &calm);
    assert_eq!(function.order(&order(Manoeuvre::TakeOff), true), Answer::Refused(Refusal::NotStanding));
    step(&mut function, 1);
    assert_eq!(function.order(&order(Manoeuvre::Abort), true), Answer::Refused(Refusal::NoTakeOff));
    assert_eq!(function.order(&order(Manoeuvre::TakeOff), true), Answer::Accepted);
    assert_eq!(step(&mut function, 2).engaged, 0, "not before the autopilot is on");
    function.order(&Order::Autopilot { on: true }, true);
    let rolling = (3..100).map(|cycle| step(&mut function, cycle)).last().unwrap();
    assert_eq!((rolling.task, rolling.throttle, rolling.engaged), (TASK_ROLLING, 1.0, 1));
    assert_eq!(flags(&mut function) & NAVIGATION_TAKE_OFF, NAVIGATION_TAKE_OFF);
    let kept = function.kept();
    let mut second = Function::new(settings(), &[], Some(&kept)).unwrap();
    assert_eq!(step(&mut second, 100).task, TASK_ROLLING, "a restart does not stop it");
    assert_eq!(second.order(&LOITER, true), Answer::Refused(Refusal::NotFlying));
    assert_eq!(second.order(&order(Manoeuvre::Abort), true), Answer::Accepted);
    let stopped = step(&mut second, 101);
    assert_eq!((stopped.task, stopped.throttle), (TASK_ABORTED, 0.0));
    assert_eq!(flags(&mut second) & NAVIGATION_ABORTED, NAVIGATION_ABORTED);
    let nobody = flying(0.0, 100.0);
    assert_eq!(fly(&mut on_mission(), 1..3, Some(&nobody)).task, TASK_MISSION);
}

#[test]
fn airspeed_reference_is_what_the_aircraft_reaches() {
    let mut function = function();
    function.order(&Order::Autopilot { on: true }, true);
    function.order(&Order::Loop { id: LoopId::Airspeed, on: true, target: 40.0 }, true);
    let command = fly(&mut function, 1..10, Some(&flying(0.0, 160.0)));
    assert!((command.airspeed_reference_mps - 32.4).abs() < 0.1, "{command:?}");
    function.order(&Order::Loop { id: LoopId::Airspeed, on: true, target: 25.0 }, true);
    assert_eq!(fly(&mut function, 10..20, Some(&flying(0.0, 160.0))).airspeed_reference_mps, 25.0);
}

#[test]
fn limits_that_were_reached_are_told_once() {
    let mut function = function();
    function.order(&Order::Autopilot { on: true }, true);
    function.order(&Order::Loop { id: LoopId::Normal, on: true, target: -34.0 }, true);
    let command = fly(&mut function, 1..10, Some(&flying(0.0, 160.0)));
    assert_ne!(command.protection, 0);
    function.order(&Order::Loop { id: LoopId::Normal, on: false, target: 0.0 }, true);
    fly(&mut function, 10..40, Some(&flying(0.0, 160.0)));
    assert_ne!(flags(&mut function) >> NAVIGATION_PROTECTION_SHIFT, 0);
    assert_eq!(flags(&mut function) >> NAVIGATION_PROTECTION_SHIFT, 0);
}

/// An aircraft at rest on the runway.
fn at_rest() -> NavigationState {
    navigation_state(&State {
        position_ned_m: [0.0, 0.0, -0.3],
        quaternion: [1.0, 0.0, 0.0, 0.0],
        specific_force_mps2: [0.0, 0.0, -GRAVITY_MPS2],
        status: STATUS_RUNNING,
        ..State::default()
    })
    .unwrap()
}

/// A list of these steps, 600 m apart.
fn load_steps(function: &mut Function, steps: &[ground::Step]) {
    for (index, step) in (0..).zip(steps.iter().copied()) {
        let point = ground::Waypoint {
            index,
            count: steps.len() as u8,
            north_m: 600.0 * f64::from(index),
            east_m: 0.0,
            altitude_m: 80.0,
            heading_rad: 0.0,
            airspeed_mps: 22.0,
            step,
        };
        assert_eq!(function.order(&Order::Waypoint(point), true), Answer::Accepted);
    }
}

#[test]
fn mission_that_begins_with_a_take_off_takes_off_standing_and_not_in_flight() {
    use ground::Step;
    let begin = |state: &NavigationState| {
        let mut function = function();
        load_steps(&mut function, &[Step::TakeOff, Step::Pass, Step::Return]);
        fly(&mut function, 1..5, Some(state));
        function.order(&Order::Navigation { on: true }, true);
        assert_eq!(fly(&mut function, 5..10, Some(state)).task, 0, "nobody has armed it");
        function.order(&Order::Autopilot { on: true }, true);
        fly(&mut function, 10..15, Some(state)).task
    };
    // The airspeed of these sensors lifts it off at once.
    assert!([TASK_ROLLING, TASK_CLIMBING].contains(&begin(&at_rest())));
    assert_eq!(begin(&flying(0.0, 80.0)), TASK_MISSION);
}

#[test]
fn mission_ends_as_its_last_entry_says_and_may_be_begun_again() {
    use ground::Step;
    for (last, task) in [(Step::Return, TASK_RETURN), (Step::Land, TASK_LANDING)] {
        let mut function = function();
        load_steps(&mut function, &[Step::Pass, last]);
        function.order(&Order::Navigation { on: true }, true);
        function.order(&Order::Autopilot { on: true }, true);
        assert_eq!(fly(&mut function, 1..5, Some(&flying(0.0, 80.0))).task, TASK_MISSION);
        assert_eq!(function.order(&Order::GoOnWith { index: 1 }, true), Answer::Accepted);
        let ended = fly(&mut function, 5..10, Some(&flying(0.0, 80.0)));
        assert_eq!((ended.task, ended.finished), (task, 1), "{last:?}");
        // Another entry ends that.
        assert_eq!(function.order(&Order::GoOnWith { index: 0 }, true), Answer::Accepted);
        assert_eq!(fly(&mut function, 10..12, Some(&flying(0.0, 80.0))).task, TASK_MISSION, "{last:?}");
        function.order(&Order::GoOnWith { index: 1 }, true);
        fly(&mut function, 12..15, Some(&flying(0.0, 80.0)));
        // Over a restart of the function, too.
        let kept = function.kept();
        let mut function = Function::new(settings(), &[], Some(&kept)).unwrap();
        assert_eq!(fly(&mut function, 15..20, Some(&flying(0.0, 80.0))).task, task, "{last:?}");
        function.order(&Order::Navigation { on: true }, true);
        let again = fly(&mut function, 20..25, Some(&flying(0.0, 80.0)));
        assert_eq!((again.task, again.finished, again.next_waypoint), (TASK_MISSION, 0, 0), "{last:?}");
        assert_eq!(
            function.order(&Order::GoOnWith { index: 2 }, true),
            Answer::Refused(Refusal::NoSuchEntry)
        );
    }
}

#[test]
fn areas_of_the_ground_are_a_fence_and_its_rally_point_is_returned_to_also_after_a_restart() {
    use bateleur_messages::mark::{Mark, MarkKind};
    let mut function = on_mission();
    let corners = [(-600.0, -600.0), (1500.0, -600.0), (1500.0, 700.0), (-600.0, 700.0)];
    for (index, (north_m, east_m)) in (0..).zip(corners) {
        let kind = MarkKind::InclusionCorner;
        let mark = Mark { index, count: 4, list: 1, kind, north_m, east_m, size: 4.0 };
        assert_eq!(function.order(&Order::Fence(mark), true), Answer::Accepted);
    }
    let rally = Mark {
        index: 0,
        count: 1,
        list: 1,
        kind: MarkKind::Rally,
        north_m: 300.0,
        east_m: 500.0,
        size: 90.0,
    };
    assert_eq!(function.order(&Order::Rally(rally), true), Answer::Accepted);
    let inside = fly(&mut function, 1..20, Some(&flying(600.0, 160.0)));
    assert_eq!((inside.task, flags(&mut function) & NAVIGATION_OUTSIDE), (TASK_MISSION, 0));
    let kept = function.kept();
    let mut function = Function::new(settings(), &[], Some(&kept)).unwrap();
    let outside = fly(&mut function, 20..40, Some(&flying(705.0, 160.0)));
    assert_eq!((outside.task, flags(&mut function) & NAVIGATION_OUTSIDE), (TASK_RETURN, NAVIGATION_OUTSIDE));
    assert_eq!(outside.altitude_reference_m, 90.0, "that of the rally point");
    assert_eq!(function.order(&GO_ON, true), Answer::Refused(Refusal::OutsideFence));
    // A fence that does not hold the runway is none.
    let away = Mark { count: 1, list: 2, kind: MarkKind::InclusionCircle, north_m: 3e3, ..rally };
    assert_eq!(function.order(&Order::Fence(away), true), Answer::Refused(Refusal::NoFence));
}
