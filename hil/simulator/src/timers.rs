//! Pulse widths of the actuators and what they mean.
//!
//! Surfaces: 1500 µs is neutral, 1000 µs and 2000 µs are minus and plus the limit in the airframe's `[servo]` section,
//! linear between. Throttle: 1000 µs closed, 2000 µs full. The flight computer writes by the same rule, so both have
//! to use the same airframe file. Both ailerons carry the same sign (a positive one rolls right) and the plant flies
//! their mean. A pulse outside [`SHORTEST_US`] to [`LONGEST_US`] is no pulse: the servo stays where it is.

use bateleur_messages::hil::Actuators;
use bateleur_plant::Controls;
use bateleur_plant::airframe::Servo;

/// Pulse of a neutral surface, µs.
pub const NEUTRAL_US: f64 = 1500.0;
/// From neutral to the stop, µs.
pub const HALF_RANGE_US: f64 = 500.0;
/// A shorter pulse, µs, is noise or a dead line; a servo that acted on it would slam into its stop.
pub const SHORTEST_US: u16 = 800;
/// A longer pulse, µs, likewise.
pub const LONGEST_US: u16 = 2200;

/// Translates between pulses and deflections for one airframe.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timers {
    aileron_limit_rad: f64,
    elevator_limit_rad: f64,
    rudder_limit_rad: f64,
}

/// Pulses of the safety pilot's sticks, µs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sticks {
    /// Ailerons, positive rolls right.
    pub aileron_us: u16,
    /// Elevator, positive pitches down.
    pub elevator_us: u16,
    /// Rudder, positive yaws left.
    pub rudder_us: u16,
    /// Throttle.
    pub throttle_us: u16,
}

impl Default for Sticks {
    fn default() -> Self {
        Self { aileron_us: 1500, elevator_us: 1500, rudder_us: 1500, throttle_us: 1000 }
    }
}

impl Timers {
    /// The translation for an airframe's actuators.
    pub fn new(servo: &Servo) -> Self {
        Self {
            aileron_limit_rad: servo.aileron_limit_rad,
            elevator_limit_rad: servo.elevator_limit_rad,
            rudder_limit_rad: servo.rudder_limit_rad,
        }
    }

    /// What the plant shall do. A missing pulse becomes NaN, on which the plant holds the last command.
    pub fn controls(&self, actuators: &Actuators) -> Controls {
        let aileron = 0.5 * (share(actuators.aileron_left_us) + share(actuators.aileron_right_us));
        Controls {
            aileron_rad: aileron * self.aileron_limit_rad,
            elevator_rad: share(actuators.elevator_us) * self.elevator_limit_rad,
            rudder_rad: share(actuators.rudder_us) * self.rudder_limit_rad,
            throttle: 0.5 * (share(actuators.throttle_us) + 1.0),
        }
    }

    /// The stick pulses that stand for `controls`, to the nearest microsecond.
    pub fn sticks(&self, controls: &Controls) -> Sticks {
        Sticks {
            aileron_us: pulse(controls.aileron_rad / self.aileron_limit_rad),
            elevator_us: pulse(controls.elevator_rad / self.elevator_limit_rad),
            rudder_us: pulse(controls.rudder_rad / self.rudder_limit_rad),
            throttle_us: pulse(2.0 * controls.throttle - 1.0),
        }
    }
}

fn share(pulse_us: u16) -> f64 {
    if !(SHORTEST_US..=LONGEST_US).contains(&pulse_us) {
        return f64::NAN;
    }
    ((f64::from(pulse_us) - NEUTRAL_US) / HALF_RANGE_US).clamp(-1.0, 1.0)
}

fn pulse(share: f64) -> u16 {
    (NEUTRAL_US + HALF_RANGE_US * share.clamp(-1.0, 1.0)).round() as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_plant::Airframe;

    fn timers() -> Timers {
        Timers::new(&Airframe::aerosonde().servo)
    }

    fn all(pulse_us: u16) -> Actuators {
        Actuators {
            aileron_left_us: pulse_us,
            aileron_right_us: pulse_us,
            elevator_us: pulse_us,
            rudder_us: pulse_us,
            throttle_us: pulse_us,
            ..Actuators::default()
        }
    }

    #[test]
    fn stops_and_neutral_are_where_the_airframe_says() {
        assert_eq!(
            timers().controls(&all(1500)),
            Controls { aileron_rad: 0.0, elevator_rad: 0.0, rudder_rad: 0.0, throttle: 0.5 }
        );
        let stop = timers().controls(&all(2000));
        assert_eq!((stop.aileron_rad, stop.elevator_rad, stop.throttle), (0.52, 0.52, 1.0));
        assert_eq!(timers().controls(&all(2200)), stop);
    }

    #[test]
    fn missing_pulse_holds_the_servo() {
        assert!(timers().controls(&all(0)).elevator_rad.is_nan());
        assert!(timers().controls(&all(u16::MAX)).throttle.is_nan());
    }

    #[test]
    fn sticks_come_back_within_half_a_microsecond() {
        let controls = Controls { aileron_rad: 0.1, elevator_rad: -0.2, rudder_rad: 0.03, throttle: 0.69 };
        let sticks = timers().sticks(&controls);
        let back = timers().controls(&Actuators {
            aileron_left_us: sticks.aileron_us,
            aileron_right_us: sticks.aileron_us,
            elevator_us: sticks.elevator_us,
            rudder_us: sticks.rudder_us,
            throttle_us: sticks.throttle_us,
            ..Actuators::default()
        });
        assert!((back.elevator_rad - controls.elevator_rad).abs() <= 0.52 / 1000.0);
        assert!((back.throttle - controls.throttle).abs() <= 0.0005);
    }
}
