//! Actuators: dead time, first-order lag, play in the linkage, stops; and the lag of the throttle.
//!
//! Each aileron has a servo of its own, so that one can be stuck; what the air feels is the mean of both.

use crate::aerodynamics::Surfaces;
use crate::airframe::Airframe;
use crate::fault::{Actuation, Actuator};
use crate::{Controls, STEP_S};

/// Longest dead time an airframe may ask for, s.
pub(crate) const LONGEST_DELAY_S: f64 = 0.25;
/// Steps that a command may wait: the longest dead time, and the longest delay that a fault adds.
const RING: usize = ((LONGEST_DELAY_S + crate::fault::LONGEST_DELAY_S) / STEP_S) as usize + 1;
/// Left aileron, right aileron, elevator, rudder: the order of [`Actuator`].
const SERVOS: usize = 4;

/// Commands on their way, and where the surfaces are.
#[derive(Clone, Debug)]
pub(crate) struct Actuators {
    waiting: [Controls; RING],
    next: usize,
    delay: usize,
    surface_gain: f64,
    throttle_gain: f64,
    backlash: f64,
    limits: [f64; SERVOS],
    servo: [f64; SERVOS],
    surface: [f64; SERVOS],
    throttle: f64,
}

/// Share of the way a first-order lag covers in one step.
fn gain(rate: f64) -> f64 {
    1.0 - (-rate * STEP_S).exp()
}

impl Actuators {
    /// Actuators at rest in the given position.
    pub(crate) fn new(airframe: &Airframe, start: Controls) -> Self {
        let s = &airframe.servo;
        let lag = airframe.propulsion.lag_s();
        let place = [start.aileron_rad, start.aileron_rad, start.elevator_rad, start.rudder_rad];
        Self {
            waiting: [start; RING],
            next: 0,
            delay: ((s.delay_s / STEP_S).round() as usize).min(RING - 1),
            surface_gain: gain(s.bandwidth_radps),
            throttle_gain: if lag > 0.0 { gain(1.0 / lag) } else { 1.0 },
            backlash: s.backlash_rad,
            limits: [s.aileron_limit_rad, s.aileron_limit_rad, s.elevator_limit_rad, s.rudder_limit_rad],
            servo: place,
            surface: place,
            throttle: start.throttle,
        }
    }

    /// Takes a command and moves for one step. A command that is not a number leaves the last one standing.
    pub(crate) fn step(&mut self, command: &Controls, wrong: &Actuation) {
        let due = self.delayed(command, wrong.delay_s);
        let targets = [due.aileron_rad, due.aileron_rad, due.elevator_rad, due.rudder_rad];
        for (axis, target) in targets.into_iter().enumerate() {
            let target = match wrong.stuck[axis] {
                None => target.clamp(-self.limits[axis], self.limits[axis]),
                Some(Some(share)) => share * self.limits[axis],
                Some(None) => continue,
            };
            self.servo[axis] += self.surface_gain * (target - self.servo[axis]);
            let half = 0.5 * self.backlash;
            self.surface[axis] = self.surface[axis].clamp(self.servo[axis] - half, self.servo[axis] + half);
        }
        let throttle = match wrong.stuck[Actuator::Throttle as usize] {
            None => due.throttle.clamp(0.0, 1.0),
            Some(Some(share)) => share,
            Some(None) => self.throttle,
        };
        self.throttle += self.throttle_gain * (throttle - self.throttle);
    }

    /// Stores the command and gives the one whose time has come.
    fn delayed(&mut self, command: &Controls, longer_s: f64) -> Controls {
        let last = self.waiting[(self.next + RING - 1) % RING];
        self.waiting[self.next] = command.or(&last);
        let delay = (self.delay + (longer_s / STEP_S).round() as usize).min(RING - 1);
        let due = self.waiting[(self.next + RING - delay) % RING];
        self.next = (self.next + 1) % RING;
        due
    }

    /// Where the surfaces are.
    pub(crate) fn surfaces(&self) -> Surfaces {
        let [left, right, elevator_rad, rudder_rad] = self.surface;
        Surfaces { aileron_rad: 0.5 * (left + right), elevator_rad, rudder_rad }
    }

    /// Throttle that acts, 0 to 1.
    pub(crate) fn throttle(&self) -> f64 {
        self.throttle
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step_response(actuators: &mut Actuators, steps: usize) -> Vec<f64> {
        let command = Controls { elevator_rad: 0.1, ..Controls::default() };
        let mut run = Vec::new();
        for _ in 0..steps {
            actuators.step(&command, &Actuation::default());
            run.push(actuators.surfaces().elevator_rad);
        }
        run
    }

    #[test]
    fn command_waits_for_the_dead_time_and_then_lags() {
        let run = step_response(&mut Actuators::new(&Airframe::aerosonde(), Controls::default()), 80);
        assert!(run[..8].iter().all(|d| *d == 0.0), "moved within 20 ms");
        assert!(run[8] > 0.0);
        let seven = run[8 + 6]; // 17.5 ms = one time constant of 57 rad/s
        assert!((seven / 0.1 - 0.632).abs() < 0.02, "{seven}");
    }

    #[test]
    fn play_is_lost_and_stops_hold() {
        let mut frame = Airframe::aerosonde();
        frame.servo.backlash_rad = 0.02;
        frame.servo.elevator_limit_rad = 0.05;
        let run = step_response(&mut Actuators::new(&frame, Controls::default()), 400);
        assert!((run[399] - 0.04).abs() < 1e-9, "{}", run[399]);
    }

    #[test]
    fn command_that_is_no_number_keeps_the_last_one() {
        let mut actuators = Actuators::new(&Airframe::aerosonde(), Controls::default());
        step_response(&mut actuators, 200);
        for _ in 0..100 {
            let command = Controls { elevator_rad: f64::NAN, ..Controls::default() };
            actuators.step(&command, &Actuation::default());
        }
        assert!((actuators.surfaces().elevator_rad - 0.1).abs() < 1e-9);
    }

    fn after(wrong: &Actuation, command: &Controls) -> Actuators {
        let start = Controls { rudder_rad: 0.1, throttle: 0.7, ..Controls::default() };
        let mut actuators = Actuators::new(&Airframe::aerosonde(), start);
        (0..800).for_each(|_| actuators.step(command, wrong));
        actuators
    }

    #[test]
    fn one_stuck_aileron_leaves_half_of_the_other() {
        let mut wrong = Actuation::default();
        wrong.stuck[Actuator::LeftAileron as usize] = Some(Some(0.3));
        let limit = Airframe::aerosonde().servo.aileron_limit_rad;
        let against = after(&wrong, &Controls { aileron_rad: -0.3 * limit, ..Controls::default() });
        assert!(against.surfaces().aileron_rad.abs() < 1e-9, "the other one holds against it");
        let full = after(&wrong, &Controls { aileron_rad: -limit, ..Controls::default() });
        assert!((full.surfaces().aileron_rad + 0.35 * limit).abs() < 1e-9);
    }

    #[test]
    fn rudder_and_throttle_that_are_stuck_stay_where_they_are() {
        let mut wrong = Actuation::default();
        wrong.stuck[Actuator::Rudder as usize] = Some(None);
        wrong.stuck[Actuator::Throttle as usize] = Some(None);
        let actuators = after(&wrong, &Controls { rudder_rad: -0.4, throttle: 0.1, ..Controls::default() });
        assert_eq!((actuators.surfaces().rudder_rad, actuators.throttle()), (0.1, 0.7));
    }

    #[test]
    fn added_delay_comes_on_top_of_the_dead_time() {
        let wrong = Actuation { delay_s: 0.06, ..Actuation::default() };
        let mut actuators = Actuators::new(&Airframe::aerosonde(), Controls::default());
        let command = Controls { elevator_rad: 0.1, ..Controls::default() };
        let still = |actuators: &mut Actuators| {
            actuators.step(&command, &wrong);
            actuators.surfaces().elevator_rad == 0.0
        };
        let steps = (0..100).take_while(|_| still(&mut actuators)).count();
        assert_eq!(steps, 32, "20 ms and 60 ms are 32 steps");
    }
}
