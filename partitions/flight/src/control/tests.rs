//! The controller's switching: who flies what, and that nothing jumps.

use super::*;
use crate::airframe::tests::aerosonde;
use crate::attitude;
use crate::estimator::{EstimatorStatus, StateSigmas};
use crate::guidance::{GuidanceConfig, seed_waypoints};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

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
    assert_eq!(ControllerSnapshot::from_bytes(&[0; memory::BYTES]), None, "zeroed memory is no snapshot");
    assert!(!second.resume(&controller().snapshot()), "nothing has flown");
}

/// Flies what it is told by chance: anywhere in the air and on the ground, with sensors that come, go, repeat and say nonsense.
fn wander(random: &mut ChaCha8Rng, frames: u32, mut look: impl FnMut(&mut Controller)) {
    let mut controller = controller();
    let mut state = level_state();
    let mut commands = LoopCommands::MISSION;
    for frame in 0..frames {
        if random.random_range(0..400) == 0 {
            state.position = Vector3::new(0.0, 0.0, -100.0 * random.random::<f64>());
        }
        let mut near = |value: f64, off: f64| value + off * (2.0 * random.random::<f64>() - 1.0);
        let course_rad = near(f64::from(frame) * 0.02 * 0.2, 0.05);
        state.velocity = Vector3::new(22.0 * course_rad.cos(), 22.0 * course_rad.sin(), near(0.0, 2.0));
        state.position += state.velocity * 0.02;
        state.position.z = state.position.z.clamp(-120.0, 0.0);
        state.euler = Vector3::new(near(0.0, 0.6), near(0.05, 0.2), course_rad);
        state.quaternion = attitude::from_euler(state.euler.x, state.euler.y, state.euler.z);
        state.rates = Vector3::from_fn(|_, _| near(0.0, 0.5));
        state.wind = Vector2::new(near(2.0, 1.0), near(-1.0, 1.0));
        let mut seen = inputs(Some(&state));
        seen.rates = state.rates;
        seen.specific_force += Vector3::from_fn(|_, _| near(0.0, 3.0));
        seen.airspeed_mps = Some(near(22.0, 3.0));
        seen.range_m = Some(near(-state.position.z, 0.5).max(0.0));
        match random.random_range(0..400) {
            0 => controller.land(&state, 60.0, Vector2::new(10.0, -5.0)),
            1 => controller.take_off(Method::Roll),
            2 => {
                controller.end_landing();
                controller.abort_take_off();
            }
            3 => commands = LoopCommands { autopilot: random.random(), ..LoopCommands::MISSION },
            4 => {
                commands =
                    LoopCommands { altitude_m: Some(50.0), track_rad: Some(1.0), ..LoopCommands::MISSION }
            }
            5 => controller.guidance_mut().restart(),
            _ => {}
        }
        let unseen = random.random_range(0..4) == 0;
        if frame / 100 % 5 == 4 && unseen {
            match random.random_range(0..5) {
                0 => seen.navigation = None,
                1 => seen.rates = Vector3::repeat(f64::NAN),
                2 => seen.specific_force = Vector3::repeat(f64::INFINITY),
                3 => (seen.airspeed_mps, seen.density_kgpm3) = (Some(f64::NAN), None),
                _ => (seen.airspeed_mps, seen.range_m) = (None, Some(f64::NAN)),
            }
        }
        if frame / 200 % 3 == 2 {
            (seen.rates.y, seen.specific_force.y) = (0.1, 0.2); // stuck
        }
        controller.step(&seen, &commands);
        look(&mut controller);
    }
}

#[test]
fn controller_that_goes_on_from_memory_is_the_one_that_wrote_them() {
    let mut landings = 0;
    for seed in 0..20 {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let (mut frame, mut chosen) = (0, random.random_range(1..30));
        wander(&mut random, 2_000, |first| {
            frame += 1;
            if frame % chosen != 0 {
                return;
            }
            chosen = 1 + (chosen * 7 + 3) % 41;
            landings += u32::from(first.memory.landing.is_some());
            let snapshot = first.snapshot();
            let back = ControllerSnapshot::from_bytes(&snapshot.to_bytes());
            assert_eq!(back, Some(snapshot), "seed {seed}, frame {frame}");
            let mut second = controller();
            if second.resume(&snapshot) {
                first.memory.pitch_hold.aim = None;
                assert_eq!(second, *first, "seed {seed}, frame {frame}");
            }
        });
    }
    assert!(landings > 100, "{landings}");
}

#[test]
fn without_a_pitot_the_airspeed_stays_near_that_over_ground() {
    for over_ground_mps in [14.0, 36.0] {
        let flown_mps = |status| {
            let mut controller = controller();
            let mut state = level_state();
            // In the end it repeats its value, and is not believed before long.
            for frame in 0..6_000 {
                let mut measured = inputs(Some(&state));
                let moving_mps = if frame < 5_000 { 1e-3 * f64::from(frame % 17) } else { 0.0 };
                measured.airspeed_mps = measured.airspeed_mps.map(|mps| mps + moving_mps);
                controller.step(&measured, &LoopCommands::MISSION);
            }
            assert!(controller.memory.wind.deviation_mps() < 0.6, "{:?}", controller.memory.wind);
            assert!(!controller.memory.airspeed_watch.is_believed());
            (state.velocity.x, state.status) = (over_ground_mps, status);
            let steps = (0..100).map(|_| controller.step(&inputs(Some(&state)), &LoopCommands::MISSION));
            steps.last().unwrap().signals.airspeed_mps
        };
        // In calm air the wind has not changed by much since.
        let off_mps = flown_mps(EstimatorStatus::Ready) - over_ground_mps;
        assert!((-1.0..0.7).contains(&off_mps), "{over_ground_mps}: {off_mps}");
        let off_mps = flown_mps(EstimatorStatus::Converging) - over_ground_mps;
        assert!(off_mps.abs() > 6.0, "{over_ground_mps}: {off_mps}, the velocity is not known either");
    }
}

#[test]
fn airspeed_is_kept_less_closely_on_the_straight_way_to_the_ground_and_as_closely_before_it() {
    let mut controller = controller();
    let s =
        Signals { airspeed_mps: 20.5, density_kgpm3: 1.2, normal_mps2: -GRAVITY_MPS2, ..Signals::default() };
    let commands = LoopCommands { airspeed_mps: Some(22.0), ..LoopCommands::MISSION };
    let asked_mps2 =
        |controller: &Controller| controller.axial(&s, &commands, None, Basis::Estimator).unwrap();
    let in_flight = asked_mps2(&controller);
    controller.land(&level_state(), 50.0, Vector2::zeros());
    assert_eq!(asked_mps2(&controller), in_flight);
    controller.memory.landing.as_mut().unwrap().phase = landing::Phase::Final;
    assert!((asked_mps2(&controller) / in_flight - FINAL_SPEED_SHARE).abs() < 1e-9);
}

/// Satellites find a pitot that drifts before lift alone does; not in an outage, and not with what was learnt on the ground.
#[test]
fn pitot_that_drifts_is_found_sooner_by_satellites_and_nothing_is_known_on_the_ground() {
    let rascal = Airframe::from_toml(crate::airframe::built_in("rascal110").unwrap()).unwrap();
    let guidance = Guidance::new(GuidanceConfig::default(), &seed_waypoints()).unwrap();
    let found_s = |status: EstimatorStatus| {
        let mut controller = Controller::new(rascal, ControllerConfig::default(), guidance);
        let state = NavigationState { status, ..level_state() };
        let found = (0..8_000).find(|frame| {
            let drift_mps = 0.3 * 0.02 * f64::from((frame - 4_000).max(0));
            let mut measured = inputs(Some(&state));
            measured.airspeed_mps = Some(22.0 + 1e-3 * f64::from(frame % 17) - drift_mps);
            controller.step(&measured, &LoopCommands::MISSION);
            !controller.memory.airspeed_watch.is_believed()
        });
        f64::from(found.unwrap() - 4_000) * 0.02
    };
    let (with_s, without_s) = (found_s(EstimatorStatus::Ready), found_s(EstimatorStatus::Converging));
    assert!(with_s > 0.0 && with_s + 1.0 < without_s, "{with_s} {without_s}");

    let mut controller = controller();
    let standing = NavigationState { velocity: Vector3::zeros(), ..level_state() };
    for _ in 0..4_000 {
        controller.step(&inputs(Some(&standing)), &LoopCommands::default());
    }
    assert!(!controller.memory.wind.is_known());
}

/// A controller whose pitot was blocked in the air, and which then touched the ground with 22 m/s; its airspeed at each speed over ground, m/s.
fn rolling_out(speeds_mps: &[f64]) -> Vec<f64> {
    let mut controller = controller();
    let mut state = level_state();
    for frame in 0..2_500 {
        let mut measured = inputs(Some(&state));
        let moving_mps = if frame < 1_500 { 1e-3 * f64::from(frame % 17) } else { 0.0 };
        measured.airspeed_mps = Some(22.0 + moving_mps);
        controller.step(&measured, &LoopCommands::MISSION);
    }
    assert!(!controller.memory.airspeed_watch.is_believed());
    state.position = Vector3::new(0.0, 0.0, -1.0);
    controller.land(&state, 50.0, Vector2::zeros());
    let told_mps = |speed_mps: &f64| {
        state.velocity.x = *speed_mps;
        let steps = (0..60).map(|_| {
            controller.memory.landing.as_mut().unwrap().phase = landing::Phase::Touched;
            controller.step(&inputs(Some(&state)), &LoopCommands::MISSION).signals.airspeed_mps
        });
        steps.last().unwrap()
    };
    speeds_mps.iter().map(told_mps).collect()
}

#[test]
fn pitch_that_no_magnetic_field_tells_is_late() {
    for (sigma_rad, is_late) in [(0.009, false), (0.09, true)] {
        let mut state = level_state();
        state.sigmas.attitude = Vector3::new(0.0, sigma_rad, 0.0);
        let output = controller().step(&inputs(Some(&state)), &LoopCommands::MISSION);
        assert_eq!(output.signals.pitches_late, is_late, "{sigma_rad} rad");
    }
}

#[test]
fn on_the_wheels_no_airspeed_of_lift_is_faster_than_velocity_and_wind() {
    let speeds_mps = [18.0, 14.0, 10.0];
    for (told_mps, over_ground_mps) in rolling_out(&speeds_mps).into_iter().zip(speeds_mps) {
        assert!(told_mps < over_ground_mps + 0.5, "{told_mps} at {over_ground_mps} m/s");
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
