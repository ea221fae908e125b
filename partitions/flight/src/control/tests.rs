//! The controller's switching: who flies what, and that nothing jumps.

use super::*;
use crate::airframe::tests::aerosonde;
use crate::attitude;
use crate::estimator::{EstimatorStatus, StateSigmas};
use crate::guidance::{GuidanceConfig, PATH_NUMBERS, seed_waypoints};

fn controller() -> Controller {
    let guidance = Guidance::new(GuidanceConfig::default(), &seed_waypoints()).unwrap();
    Controller::new(aerosonde(), ControllerConfig::default(), guidance)
}

pub(super) fn level_state() -> NavigationState {
    let quaternion = attitude::from_euler(0.0, 0.08, 0.0);
    let one = Vector3::repeat(0.1);
    NavigationState {
        time_s: 0.0,
        position: Vector3::new(50.0, 0.0, -160.0),
        velocity: Vector3::new(22.0, 0.0, 0.0),
        quaternion,
        euler: attitude::euler(&quaternion),
        rates: Vector3::zeros(),
        specific_force: quaternion.inverse() * Vector3::new(0.0, 0.0, -GRAVITY_MPS2),
        wind: Vector2::zeros(),
        gyro_bias: Vector3::zeros(),
        accel_bias: Vector3::zeros(),
        mag_bias: Vector3::zeros(),
        sigmas: StateSigmas { attitude: one, velocity: one, position: one },
        status: EstimatorStatus::Ready,
    }
}

fn inputs(state: Option<&NavigationState>) -> ControllerInputs<'_> {
    ControllerInputs {
        navigation: state,
        rates: Vector3::zeros(),
        specific_force: level_state().specific_force,
        airspeed_mps: Some(22.0),
        density_kgpm3: Some(1.2),
        range_m: None,
        pilot: ActuatorCommand { throttle: 0.7, aileron_rad: 0.01, elevator_rad: -0.2, rudder_rad: 0.02 },
        dt_s: 0.02,
    }
}

#[test]
fn autopilot_off_is_the_pilot_untouched() {
    let state = level_state();
    let out = controller().step(&inputs(Some(&state)), &LoopCommands::default());
    assert_eq!(out.command, inputs(None).pilot);
    assert_eq!(out.channels, Channels::default());
}

#[test]
fn engagement_starts_from_the_pilots_actuators() {
    let state = level_state();
    let mut controller = controller();
    controller.step(&inputs(Some(&state)), &LoopCommands::default());
    let out = controller.step(&inputs(Some(&state)), &LoopCommands::MISSION);
    let pilot = inputs(None).pilot;
    assert!((out.command.elevator_rad - pilot.elevator_rad).abs() < 0.02, "{:?}", out.command);
    assert!((out.command.aileron_rad - pilot.aileron_rad).abs() < 0.05);
    assert!((out.command.throttle - pilot.throttle).abs() < 0.05);
    assert!((out.command.rudder_rad - pilot.rudder_rad).abs() < 0.02);
}

#[test]
fn each_loop_can_be_engaged_alone() {
    let state = level_state();
    let only = |commands: LoopCommands| {
        let commands = LoopCommands { autopilot: true, ..commands };
        controller().step(&inputs(Some(&state)), &commands).channels
    };
    let off = LoopCommands::default;
    assert!(only(LoopCommands { roll_rate_radps: Some(0.1), ..off() }).roll);
    assert!(only(LoopCommands { bank_rad: Some(0.1), ..off() }).roll);
    assert!(only(LoopCommands { track_rad: Some(0.1), ..off() }).roll);
    assert!(only(LoopCommands { pitch_rate_radps: Some(0.1), ..off() }).pitch);
    assert!(only(LoopCommands { normal_mps2: Some(-12.0), ..off() }).pitch);
    assert!(only(LoopCommands { altitude_m: Some(170.0), ..off() }).pitch);
    assert!(only(LoopCommands { airspeed_mps: Some(20.0), ..off() }).thrust);
    assert!(only(LoopCommands { axial_mps2: Some(0.2), ..off() }).thrust);
    let bank = only(LoopCommands { bank_rad: Some(0.1), ..off() });
    assert!(!bank.pitch && !bank.thrust && bank.yaw);
    assert!(
        !only(LoopCommands { bank_rad: Some(f64::NAN), ..off() }).roll,
        "a target that is no number is off"
    );
}

#[test]
fn innermost_target_wins() {
    let state = level_state();
    let commands = LoopCommands { bank_rad: Some(0.5), roll_rate_radps: Some(0.0), ..LoopCommands::MISSION };
    let mut controller = controller();
    let mut out = controller.step(&inputs(Some(&state)), &commands);
    for _ in 0..20 {
        out = controller.step(&inputs(Some(&state)), &commands);
    }
    assert_eq!(out.references.roll_rate_radps, 0.0);
}

#[test]
fn silent_estimator_is_bridged_without_a_jump() {
    let mut state = level_state();
    let mut controller = controller();
    let mut last = controller.step(&inputs(Some(&state)), &LoopCommands::MISSION).command;
    for frame in 0..300 {
        let silent = (100..250).contains(&frame);
        // It comes back with a bank 6° off what had been propagated.
        if frame == 250 {
            state.quaternion = attitude::from_euler(0.1, 0.08, 0.0);
            state.euler = attitude::euler(&state.quaternion);
        }
        let out = controller.step(&inputs((!silent).then_some(&state)), &LoopCommands::MISSION);
        let expected = match frame {
            100..=174 => Basis::Propagated,
            175..=249 => Basis::WingsLevel,
            _ => Basis::Estimator,
        };
        assert_eq!(out.basis, expected, "frame {frame}");
        assert!((out.command.aileron_rad - last.aileron_rad).abs() < 0.08, "frame {frame}");
        assert!((out.command.elevator_rad - last.elevator_rad).abs() < 0.05, "frame {frame}");
        assert!((out.command.throttle - last.throttle).abs() < 0.1, "frame {frame}");
        last = out.command;
    }
}

#[test]
fn snapshot_resumes_with_the_same_command() {
    let state = level_state();
    let mut first = controller();
    for _ in 0..50 {
        first.step(&inputs(Some(&state)), &LoopCommands::MISSION);
    }
    let mut second = controller();
    assert!(second.resume(&first.snapshot()));
    let a = first.step(&inputs(Some(&state)), &LoopCommands::MISSION).command;
    let b = second.step(&inputs(Some(&state)), &LoopCommands::MISSION).command;
    assert!((a.elevator_rad - b.elevator_rad).abs() < 1e-9 && (a.throttle - b.throttle).abs() < 1e-9);
    let zeroed = ControllerSnapshot::from_numbers(&[0.0; memory::NUMBERS], GuidanceSnapshot::default());
    assert!(!second.resume(&zeroed), "zeroed memory is no snapshot");
}

#[test]
fn numbers_bring_back_the_same_controller_on_every_piece_of_path() {
    let mut first = controller();
    let mut state = level_state();
    let mut kinds = std::collections::BTreeSet::new();
    for frame in 0..3_000 {
        // Round the square, 22 m/s, without a thought for the laws: every piece of path comes by.
        let along = f64::from(frame) * 0.44;
        let corner = |from: f64| (along - from).clamp(0.0, 500.0);
        state.position.x = corner(0.0) - corner(1000.0);
        state.position.y = corner(500.0) - corner(1500.0);
        let flown = |from: f64| (from..from + 500.0).contains(&along);
        let speed = |there: bool, back: bool| {
            if there {
                22.0
            } else if back {
                -22.0
            } else {
                0.0
            }
        };
        state.velocity.x = speed(flown(0.0), flown(1000.0));
        state.velocity.y = speed(flown(500.0), flown(1500.0));
        first.step(&inputs(Some(&state)), &LoopCommands::MISSION);
        let snapshot = first.snapshot();
        kinds.insert(snapshot.path[0] as u32);
        let back = ControllerSnapshot::from_numbers(&snapshot.to_numbers(), snapshot.guidance);
        assert_eq!(back, snapshot);
        let mut second = controller();
        assert!(second.resume(&back));
        assert_eq!(second.snapshot(), snapshot, "frame {frame}");
    }
    assert!(kinds.len() >= 3, "{kinds:?}");
}

#[test]
fn numbers_that_are_no_path_are_passed_over() {
    let mut guidance = *controller().guidance();
    for path in [[f64::NAN; PATH_NUMBERS], [9.0; PATH_NUMBERS], [4.0; PATH_NUMBERS], [-1.0; PATH_NUMBERS]] {
        guidance.resume_path(&path);
        assert_eq!(guidance.path(), [0.0; PATH_NUMBERS]);
    }
}

#[test]
fn lateral_force_that_is_stuck_does_not_drive_the_rudder_to_its_end() {
    for stuck_mps2 in [-2.0, -0.3, 0.1, 1.0] {
        let mut controller = controller();
        let mut trim = [0.0; 2];
        for frame in 0..3_000 {
            let mut state = level_state();
            state.specific_force.y = stuck_mps2;
            let mut measured = inputs(Some(&state));
            let moving = 1e-3 * f64::from(frame % 17);
            measured.specific_force = Vector3::new(moving, stuck_mps2, -GRAVITY_MPS2 + moving);
            measured.rates = Vector3::repeat(1e-3 * moving);
            let rudder_rad = controller.step(&measured, &LoopCommands::MISSION).command.rudder_rad;
            trim[usize::from(frame > 100)] = rudder_rad;
        }
        assert!((trim[1] - trim[0]).abs() < 0.01, "{stuck_mps2} m/s²: {trim:?}");
    }
}

#[test]
fn nonsense_inputs_give_finite_commands() {
    let mut controller = controller();
    let mut bad = inputs(None);
    bad.rates = Vector3::repeat(f64::NAN);
    bad.specific_force = Vector3::repeat(f64::INFINITY);
    bad.airspeed_mps = Some(f64::NAN);
    bad.dt_s = f64::NAN;
    for _ in 0..200 {
        let c = controller.step(&bad, &LoopCommands::MISSION).command;
        assert!([c.throttle, c.aileron_rad, c.elevator_rad, c.rudder_rad].iter().all(|x| x.is_finite()));
    }
}
