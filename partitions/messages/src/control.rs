//! From the Controller to the actuators.

use crate::field::message;

message! {
    /// What the Controller asks of the actuators.
    pub struct ActuatorCommand {
        /// Throttle, 0 to 1.
        pub throttle: f64,
        /// Aileron, rad, positive rolls right.
        pub aileron_rad: f64,
        /// Elevator, rad, positive pitches down.
        pub elevator_rad: f64,
        /// Rudder, rad, positive yaws left.
        pub rudder_rad: f64,
        /// Bank that guidance or the ground asks for, rad.
        pub bank_reference_rad: f64,
        /// Horizontal acceleration that guidance asks for, m/s², right positive.
        pub horizontal_acceleration_mps2: f64,
        /// Signed distance right of the track, m.
        pub cross_track_m: f64,
        /// Altitude asked for above the runway, m.
        pub altitude_reference_m: f64,
        /// Airspeed asked for, m/s.
        pub airspeed_reference_mps: f64,
        /// 1 while the autopilot computes the command, 0 while it idles.
        pub engaged: u32,
        /// Index of the way-point flown to.
        pub next_waypoint: u32,
        /// Way-points reached since navigation was switched on.
        pub waypoints_reached: u32,
        /// 1 once the asked-for laps are flown.
        pub finished: u32,
        /// What is flown: 0 nothing, 1 single loops, 2 the mission, 3 a circle, 4 the way back to the runway; of a take-off
        /// 5 waiting to be launched, 6 rolling, 7 climbing, 8 given up.
        pub task: u32,
        /// Limits that a reference ran into in this frame, one bit each: 1 bank, 2 load factor, 4 angle of attack, 8 airspeed,
        /// 16 angle of climb.
        pub protection: u32,
    }
}

/// [`ActuatorCommand::task`]: single loops, or what they stand for.
pub const TASK_LOOPS: u32 = 1;
/// [`ActuatorCommand::task`]: the way-points.
pub const TASK_MISSION: u32 = 2;
/// [`ActuatorCommand::task`]: a circle.
pub const TASK_LOITER: u32 = 3;
/// [`ActuatorCommand::task`]: the way back to the runway, and a circle above it.
pub const TASK_RETURN: u32 = 4;
/// [`ActuatorCommand::task`]: a take-off that waits to be launched.
pub const TASK_WAITING: u32 = 5;
/// [`ActuatorCommand::task`]: a take-off on its wheels.
pub const TASK_ROLLING: u32 = 6;
/// [`ActuatorCommand::task`]: a take-off in the air.
pub const TASK_CLIMBING: u32 = 7;
/// [`ActuatorCommand::task`]: a take-off that was given up.
pub const TASK_ABORTED: u32 = 8;

message! {
    /// Pulse widths for the actuators, µs: 1000 to 2000, neutral 1500.
    pub struct ServoTimers {
        /// Left aileron.
        pub aileron_left_us: u16,
        /// Right aileron.
        pub aileron_right_us: u16,
        /// Elevator.
        pub elevator_us: u16,
        /// Rudder.
        pub rudder_us: u16,
        /// Throttle: 1000 closed, 2000 full.
        pub throttle_us: u16,
        /// 1 when the Controller's command, 0 when the safety pilot's sticks are behind the values.
        pub autopilot: u16,
        /// Output cycles so far.
        pub cycle: u32,
    }
}

impl ServoTimers {
    /// What holds before the Servo has spoken: surfaces neutral, throttle closed.
    pub const AT_REST: Self = Self {
        aileron_left_us: 1500,
        aileron_right_us: 1500,
        elevator_us: 1500,
        rudder_us: 1500,
        throttle_us: 1000,
        autopilot: 0,
        cycle: 0,
    };
}

message! {
    /// What a function tells the OnBoardComputer about itself.
    pub struct FunctionStatus {
        /// 1 when the function is switched on.
        pub enabled: u32,
        /// 1 when its output can be used.
        pub ready: u32,
        /// Input that came in time, so far.
        pub accepted: u64,
        /// Input that was missing, late or refused, so far.
        pub refused: u64,
        /// Times that the function was started since the module was.
        pub starts: u64,
    }
}
