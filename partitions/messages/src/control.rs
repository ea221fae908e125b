//! From the Controller to the actuators.

use crate::{ActuatorCommand, ServoTimers};

/// [`ActuatorCommand::task`]: single loops, or what they stand for.
pub const TASK_LOOPS: u32 = ActuatorCommand::TASK_LOOPS;
/// [`ActuatorCommand::task`]: the way-points.
pub const TASK_MISSION: u32 = ActuatorCommand::TASK_MISSION;
/// [`ActuatorCommand::task`]: a circle.
pub const TASK_LOITER: u32 = ActuatorCommand::TASK_LOITER;
/// [`ActuatorCommand::task`]: the way back to the runway, and a circle above it.
pub const TASK_RETURN: u32 = ActuatorCommand::TASK_RETURN;
/// [`ActuatorCommand::task`]: a take-off that waits to be launched.
pub const TASK_WAITING: u32 = ActuatorCommand::TASK_WAITING;
/// [`ActuatorCommand::task`]: a take-off on its wheels.
pub const TASK_ROLLING: u32 = ActuatorCommand::TASK_ROLLING;
/// [`ActuatorCommand::task`]: a take-off in the air.
pub const TASK_CLIMBING: u32 = ActuatorCommand::TASK_CLIMBING;
/// [`ActuatorCommand::task`]: a take-off that was given up.
pub const TASK_ABORTED: u32 = ActuatorCommand::TASK_ABORTED;
/// [`ActuatorCommand::task`]: a landing, in the air.
pub const TASK_LANDING: u32 = ActuatorCommand::TASK_LANDING;
/// [`ActuatorCommand::task`]: the same on its wheels, and standing.
pub const TASK_LANDED: u32 = ActuatorCommand::TASK_LANDED;

/// [`ActuatorCommand::protection`]: the pitot is not believed, the airspeed is the one that lift tells.
pub const PITOT_NOT_BELIEVED: u32 = 32;
/// [`ActuatorCommand::protection`]: the propeller drives nothing, the aircraft glides.
pub const NO_POWER: u32 = 64;
/// [`ActuatorCommand::protection`]: the wing has stalled, the nose goes down.
pub const STALLED: u32 = 128;

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
