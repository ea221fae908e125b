//! Actuator commands and the timer values of the servo board.
//!
//! 1500 µs is neutral, 1000 and 2000 µs are the stops. A surface deflection is a linear share of its full travel;
//! the throttle goes from 1000 µs (idle) to 2000 µs (full).

use crate::kept::kept;

/// Timer value at rest, µs; the safety pilot's transmitter and the plant both use it as neutral.
pub const NEUTRAL_US: f64 = 1500.0;
/// Half the timer range, µs.
pub const HALF_RANGE_US: f64 = 500.0;

/// What the controller asks of the aircraft.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(C)]
pub struct ActuatorCommand {
    /// Throttle, 0 (idle) to 1 (full).
    pub throttle: f64,
    /// Aileron deflection, rad, positive rolls right (positive C_lδa of the airframe).
    pub aileron_rad: f64,
    /// Elevator deflection, rad, positive trailing edge down.
    pub elevator_rad: f64,
    /// Rudder deflection, rad, sign of the airframe's derivatives.
    pub rudder_rad: f64,
}

kept!(ActuatorCommand { throttle: f64, aileron_rad: f64, elevator_rad: f64, rudder_rad: f64 });

/// Timer values, µs, in the order of the servo message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(C)]
pub struct TimerValues {
    /// Throttle channel, µs.
    pub throttle_us: u16,
    /// Aileron channel, µs.
    pub aileron_us: u16,
    /// Elevator channel, µs.
    pub elevator_us: u16,
    /// Rudder channel, µs.
    pub rudder_us: u16,
}

impl Default for TimerValues {
    /// Surfaces neutral, engine idle: the value to send when nothing is known.
    fn default() -> Self {
        Self { throttle_us: 1000, aileron_us: 1500, elevator_us: 1500, rudder_us: 1500 }
    }
}

/// Full travel of each surface, rad: the deflection at 2000 µs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ServoMap {
    /// Aileron travel, rad.
    pub aileron_limit_rad: f64,
    /// Elevator travel, rad.
    pub elevator_limit_rad: f64,
    /// Rudder travel, rad.
    pub rudder_limit_rad: f64,
}

impl ServoMap {
    /// The timer values of a command; out-of-range and non-finite values are clamped (non-finite: neutral, idle).
    pub fn to_timer(&self, command: &ActuatorCommand) -> TimerValues {
        TimerValues {
            throttle_us: timer(2.0 * finite_or(command.throttle, 0.0) - 1.0),
            aileron_us: timer(finite_or(command.aileron_rad, 0.0) / self.aileron_limit_rad),
            elevator_us: timer(finite_or(command.elevator_rad, 0.0) / self.elevator_limit_rad),
            rudder_us: timer(finite_or(command.rudder_rad, 0.0) / self.rudder_limit_rad),
        }
    }

    /// The command that timer values stand for; values outside 1000–2000 µs count as the stop.
    pub fn to_command(&self, timer: &TimerValues) -> ActuatorCommand {
        ActuatorCommand {
            throttle: 0.5 * (share(timer.throttle_us) + 1.0),
            aileron_rad: share(timer.aileron_us) * self.aileron_limit_rad,
            elevator_rad: share(timer.elevator_us) * self.elevator_limit_rad,
            rudder_rad: share(timer.rudder_us) * self.rudder_limit_rad,
        }
    }

    /// What goes to the servos: the autopilot's command when it is engaged, otherwise the safety pilot's values
    /// untouched (not even rounded through radians).
    pub fn select(&self, autopilot: bool, command: &ActuatorCommand, pilot: &TimerValues) -> TimerValues {
        if autopilot { self.to_timer(command) } else { *pilot }
    }
}

fn finite_or(value: f64, otherwise: f64) -> f64 {
    if value.is_finite() { value } else { otherwise }
}

/// Timer value of a share of travel, −1 to 1, to the nearest µs.
fn timer(share: f64) -> u16 {
    (NEUTRAL_US + HALF_RANGE_US * share.clamp(-1.0, 1.0)).round() as u16
}

/// Share of travel of a timer value.
fn share(timer_us: u16) -> f64 {
    ((f64::from(timer_us) - NEUTRAL_US) / HALF_RANGE_US).clamp(-1.0, 1.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    const MAP: ServoMap = ServoMap { aileron_limit_rad: 0.4, elevator_limit_rad: 0.5, rudder_limit_rad: 0.3 };

    #[test]
    fn command_goes_there_and_back_within_half_a_microsecond() {
        let command =
            ActuatorCommand { throttle: 0.69, aileron_rad: 0.05, elevator_rad: -0.2, rudder_rad: 0.01 };
        let back = MAP.to_command(&MAP.to_timer(&command));
        assert!((back.throttle - command.throttle).abs() <= 0.0005);
        assert!((back.elevator_rad - command.elevator_rad).abs() <= 0.0005);
        assert!((back.aileron_rad - command.aileron_rad).abs() <= 0.0004);
    }

    #[test]
    fn neutral_and_stops_are_where_they_belong() {
        assert_eq!(MAP.to_timer(&ActuatorCommand::default()), TimerValues::default());
        let wild = ActuatorCommand {
            throttle: 7.0,
            aileron_rad: -9.0,
            elevator_rad: f64::NAN,
            rudder_rad: f64::INFINITY,
        };
        let timer = MAP.to_timer(&wild);
        assert_eq!(
            timer,
            TimerValues { throttle_us: 2000, aileron_us: 1000, elevator_us: 1500, rudder_us: 1500 }
        );
    }

    #[test]
    fn safety_pilot_goes_straight_through_when_the_autopilot_is_off() {
        let pilot = TimerValues { throttle_us: 1999, aileron_us: 1001, elevator_us: 1234, rudder_us: 1777 };
        assert_eq!(MAP.select(false, &ActuatorCommand::default(), &pilot), pilot);
        assert_eq!(MAP.select(true, &ActuatorCommand::default(), &pilot), TimerValues::default());
    }
}
