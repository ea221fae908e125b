use super::*;

const MS: u64 = 1_000_000;
const HOLD_NS: u64 = 200 * MS;
const MAP: ServoMap = ServoMap { aileron_limit_rad: 0.5, elevator_limit_rad: 0.5, rudder_limit_rad: 0.5 };

fn servo() -> Servo {
    let mut servo = Servo::new(MAP, HOLD_NS, None);
    assert!(servo.order(Ok(Order::Autopilot { on: true })));
    servo
}

fn command() -> ActuatorCommand {
    ActuatorCommand {
        throttle: 0.69,
        aileron_rad: 0.1,
        elevator_rad: -0.2,
        rudder_rad: 0.05,
        engaged: 1,
        ..Default::default()
    }
}

fn sticks() -> Custom {
    Custom {
        pilot_aileron_us: 1501,
        pilot_elevator_us: 1402,
        pilot_rudder_us: 1603,
        pilot_throttle_us: 1904,
        ..Default::default()
    }
}

fn values(timers: &ServoTimers) -> [u16; 5] {
    [
        timers.aileron_left_us,
        timers.aileron_right_us,
        timers.elevator_us,
        timers.rudder_us,
        timers.throttle_us,
    ]
}

#[test]
fn the_autopilot_moves_the_actuators() {
    let timers = servo().step(20 * MS, Some(&command()), Some(&sticks()));
    assert_eq!(values(&timers), [1600, 1600, 1300, 1550, 1690]);
    assert_eq!((timers.autopilot, timers.cycle), (1, 1));
}

#[test]
fn with_the_autopilot_off_the_sticks_go_through_to_the_microsecond() {
    let mut servo = Servo::new(MAP, HOLD_NS, None);
    let timers = servo.step(20 * MS, Some(&command()), Some(&sticks()));
    assert_eq!(values(&timers), [1501, 1501, 1402, 1603, 1904]);
    assert_eq!(timers.autopilot, 0);
}

#[test]
fn a_controller_that_idles_gives_the_aircraft_to_the_pilot_at_once() {
    let mut servo = servo();
    servo.step(20 * MS, Some(&command()), Some(&sticks()));
    let idle = ActuatorCommand { engaged: 0, ..command() };
    let timers = servo.step(40 * MS, Some(&idle), Some(&sticks()));
    assert_eq!(values(&timers), [1501, 1501, 1402, 1603, 1904]);
}

#[test]
fn a_silent_controller_leaves_the_actuators_where_they_are_and_then_to_the_pilot() {
    let mut servo = servo();
    let before = servo.step(20 * MS, Some(&command()), Some(&sticks()));
    let held = servo.step(220 * MS, None, Some(&sticks()));
    assert_eq!(values(&held), values(&before));
    assert_eq!((held.autopilot, servo.source()), (1, Source::Held));
    let after = servo.step(240 * MS, None, Some(&sticks()));
    assert_eq!((values(&after)[4], servo.source()), (1904, Source::Pilot));
    assert_eq!((servo.status(1).enabled, servo.status(1).ready), (1, 0));
    servo.step(260 * MS, Some(&command()), Some(&sticks()));
    assert_eq!(servo.source(), Source::Autopilot);
}

#[test]
fn with_neither_controller_nor_pilot_the_surfaces_go_neutral_after_the_hold_time() {
    let mut servo = servo();
    servo.step(20 * MS, Some(&command()), None);
    assert_eq!(values(&servo.step(200 * MS, None, None))[4], 1690);
    let lost = servo.step(240 * MS, None, None);
    assert_eq!(values(&lost), [1500; 5]);
    assert_eq!((lost.autopilot, servo.source()), (0, Source::Nobody));
    assert_eq!(servo.status(1).ready, 0);
}

#[test]
fn a_command_that_is_no_number_counts_as_none() {
    let mut servo = servo();
    servo.step(20 * MS, Some(&command()), Some(&sticks()));
    let broken = ActuatorCommand { elevator_rad: f64::NAN, ..command() };
    let timers = servo.step(40 * MS, Some(&broken), Some(&sticks()));
    assert_eq!(values(&timers), [1600, 1600, 1300, 1550, 1690]);
    assert_eq!((servo.status(1).accepted, servo.status(1).refused), (1, 1));
}

#[test]
fn a_receiver_without_a_transmitter_is_no_pilot() {
    let mut servo = Servo::new(MAP, HOLD_NS, None);
    let timers = servo.step(20 * MS, None, Some(&Custom::default()));
    // Nobody ever had the actuators: the aircraft stands, with its throttle closed.
    assert_eq!(values(&timers), [1500, 1500, 1500, 1500, 1000]);
}

#[test]
fn a_warm_restart_in_flight_moves_nothing() {
    let mut first = servo();
    let before = first.step(20 * MS, Some(&command()), Some(&sticks()));
    let mut second = Servo::new(MAP, HOLD_NS, Some(*first.kept()));
    let after = second.step(60 * MS, None, Some(&sticks()));
    assert_eq!(values(&after), values(&before));
    assert_eq!((after.autopilot, after.cycle), (1, 2));
    second.step(80 * MS, Some(&command()), Some(&sticks()));
    assert_eq!(second.source(), Source::Autopilot);
}

#[test]
fn retained_memory_that_makes_no_sense_is_passed_over() {
    let kept = Kept { timers_us: [7; 5], autopilot: 1, ..*servo().kept() };
    assert_eq!(Servo::new(MAP, HOLD_NS, Some(kept)).kept().autopilot, 0);
}

#[test]
fn an_order_for_another_function_is_not_taken() {
    assert!(!servo().order(Ok(Order::Navigation { on: true })));
    assert!(!servo().order(Err(OrderError::WrongLength('A'))));
}
