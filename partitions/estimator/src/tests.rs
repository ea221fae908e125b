use super::*;
use bateleur_flight::GRAVITY_MPS2;
use bateleur_messages::state::{STATUS_INITIALISING, STATUS_RUNNING};
use zerocopy::FromBytes;

const CYCLE: u64 = 20_000_000;
const FIELD_GAUSS: [f64; 3] = [0.09584, -0.04861, -0.22624];

fn function(kept: Option<&Kept>, now_s: f64) -> Function {
    Function::new(EstimatorConfig::with_field(Vector3::from(FIELD_GAUSS)), true, kept, now_s)
}

/// What one window brings of an aircraft that stands level on the runway, its nose to the north.
#[derive(Clone, Copy)]
struct Set {
    acceleration: Acceleration,
    orientation: Rates,
    magnetization: Magnetization,
    pressure: Pressure,
    position: GpsPosition,
    velocity: GpsVelocity,
}

impl Set {
    fn standing(cycle: u64) -> Self {
        let measured_ns = cycle * CYCLE;
        let fix_ns = measured_ns / (10 * CYCLE) * (10 * CYCLE); // five fixes a second
        Self {
            acceleration: Acceleration {
                measured_ns,
                interval_ns: CYCLE,
                specific_force_mps2: [0.0, 0.0, -GRAVITY_MPS2],
            },
            orientation: Rates { measured_ns, interval_ns: CYCLE, rates_radps: [0.0; 3] },
            magnetization: Magnetization { measured_ns, field_gauss: FIELD_GAUSS },
            pressure: Pressure { measured_ns, static_pressure_pa: 101_325.0, ..Default::default() },
            position: GpsPosition { measured_ns: fix_ns, ..Default::default() },
            velocity: GpsVelocity { measured_ns: fix_ns, ..Default::default() },
        }
    }

    fn inputs(&self) -> Inputs<'_> {
        Inputs {
            acceleration: Some(&self.acceleration),
            orientation: Some(&self.orientation),
            magnetization: Some(&self.magnetization),
            pressure: Some(&self.pressure),
            gps_position: Some(&self.position),
            gps_velocity: Some(&self.velocity),
            command: None,
        }
    }
}

fn run(function: &mut Function, cycles: std::ops::Range<u64>) {
    cycles.for_each(|cycle| function.step(&Set::standing(cycle).inputs()));
}

#[test]
fn a_standing_aircraft_is_found_level_by_itself() {
    let mut function = function(None, 0.0);
    assert_eq!(function.state().status, STATUS_INITIALISING);
    run(&mut function, 1..600);
    let state = function.state();
    assert_eq!(state.status, STATUS_RUNNING);
    assert_eq!(state.valid_ns, 599 * CYCLE);
    assert!(state.euler_rad.iter().all(|angle| angle.abs() < 0.02), "{:?}", state.euler_rad);
    assert_eq!(function.status(&state, 1).ready, 1);
}

#[test]
fn the_same_sample_again_is_not_used_twice() {
    let mut function = function(None, 0.0);
    let set = Set::standing(5);
    function.step(&set.inputs());
    function.step(&set.inputs());
    assert_eq!((function.accepted, function.missing), (1, 1));
}

#[test]
fn rates_and_forces_of_different_intervals_are_not_mixed() {
    let mut function = function(None, 0.0);
    let mut set = Set::standing(5);
    set.orientation.measured_ns -= CYCLE;
    function.step(&set.inputs());
    assert_eq!((function.accepted, function.missing), (0, 1));
}

#[test]
fn a_disabled_estimator_gives_nothing_until_it_is_enabled() {
    let mut function = function(None, 0.0);
    run(&mut function, 1..300);
    assert!(function.order(EstimatorOrder::Disable, 6.0));
    run(&mut function, 300..400);
    assert_eq!(function.state().status, STATUS_DISABLED);
    assert_eq!(function.status(&function.state(), 1).enabled, 0);
    assert!(function.order(EstimatorOrder::Enable, 8.0));
    run(&mut function, 400..800);
    assert!(function.state().status >= STATUS_COARSE);
}

#[test]
fn a_warm_restart_goes_on_with_the_next_sample() {
    let mut first = function(None, 0.0);
    run(&mut first, 1..300);
    let kept = first.kept();
    let mut second = function(Some(&kept), 6.0);
    run(&mut second, 303..304);
    assert!(second.state().status >= STATUS_COARSE);
    let before = first.navigation().unwrap();
    let after = second.navigation().unwrap();
    assert!((before.euler - after.euler).norm() < 1e-3);
}

#[test]
fn a_warm_restart_does_not_enable_what_the_ground_disabled() {
    let mut first = function(None, 0.0);
    run(&mut first, 1..300);
    first.order(EstimatorOrder::Disable, 6.0);
    let mut second = function(Some(&first.kept()), 6.0);
    run(&mut second, 303..310);
    assert_eq!(second.state().status, STATUS_DISABLED);
    assert!(second.kept().is_disabled());
}

#[test]
fn retained_memory_full_of_noise_is_a_cold_start() {
    let noise = Kept::read_from_bytes(&vec![0xa5; size_of::<Kept>()]).unwrap();
    let mut function = function(Some(&noise), 0.0);
    run(&mut function, 1..600);
    assert_eq!(function.state().status, STATUS_RUNNING);
}

#[test]
fn initialising_from_a_standstill_is_refused_in_flight() {
    let mut function = function(None, 0.0);
    let mut set = Set::standing(10);
    set.pressure.airspeed_mps = 22.0;
    function.step(&set.inputs());
    assert!(!function.order(EstimatorOrder::Initialise { full_inertial: false }, 0.2));
    assert!(function.order(EstimatorOrder::Initialise { full_inertial: true }, 0.2));
}

#[test]
fn a_simulator_that_was_started_anew_is_followed_after_half_a_second() {
    let mut function = function(None, 0.0);
    run(&mut function, 5_000..5_600);
    run(&mut function, 1..20);
    assert_eq!(function.state().status, STATUS_INITIALISING, "values of the past are none");
    run(&mut function, 20..800);
    assert_eq!(function.state().valid_ns, 799 * CYCLE);
    assert_eq!(function.state().status, STATUS_RUNNING);
}

#[test]
fn inertial_values_that_stop_leave_no_state_after_a_tenth_of_a_second_and_a_coarse_one_before() {
    let mut function = function(None, 0.0);
    run(&mut function, 1..600);
    let mut told = Vec::new();
    for cycle in 600..606 {
        let set = Set::standing(cycle);
        function.step(&Inputs { acceleration: None, orientation: None, ..set.inputs() });
        let state = function.state();
        told.push((state.status, state.health != 0, function.navigation().is_some()));
    }
    assert_eq!(told[1], (STATUS_RUNNING, true, true));
    assert_eq!(told[2], (STATUS_COARSE, false, true));
    assert_eq!(told[4], (STATUS_INITIALISING, false, false));
    assert_eq!(told[5], told[4]);
    run(&mut function, 606..607);
    assert_eq!(function.state().status, STATUS_RUNNING, "six windows are bridged");
}

#[test]
fn stuck_axis_is_told_in_the_state_within_a_tenth_of_a_second() {
    let mut function = function(None, 0.0);
    run(&mut function, 1..600);
    for cycle in 600..606 {
        let mut set = Set::standing(cycle);
        set.acceleration.specific_force_mps2[0] = 1e-3 * cycle as f64;
        function.step(&set.inputs());
    }
    let state = function.state();
    assert_ne!(function.stuck_axes(), 0);
    assert_eq!((state.status, state.health & 112), (STATUS_COARSE, 0));
}
