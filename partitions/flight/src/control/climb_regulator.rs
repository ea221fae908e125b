//! The elevator's gains for a climb rate in gusts: a linear-quadratic regulator.
//!
//! Responsible for the gains alone; [`super::pitch_hold`] flies with them. Near the ground the air moves up and down by 1.5 m/s and along by 3 m/s
//! within half a second (MIL-F-8785C, moderate). A wheel bears a sink rate of a few metres a second, so that is what has to stray least, for what the
//! elevator moves and with its delay. Gains come from the published derivatives and are computed anew from airspeed and density in
//! every frame, as those of the inner loops are.

use super::inner::{Pitching, Signals};
use crate::GRAVITY_MPS2;
use crate::airframe::Airframe;
use nalgebra::{SMatrix, SVector};

/// Sink rate that is too much, pitch, pitch rate, elevator, sum of the sink rate, gust along the way.
const STATES: usize = 6;
type Matrix = SMatrix<f64, STATES, STATES>;
type Vector = SVector<f64, STATES>;

/// What an elevator of one radian costs beside a sink rate of 1 m/s, squared, for each 1/s² of pitch acceleration that it gives: one that turns the
/// aircraft fast also turns it wrongly fast, if its file is wrong. And what a height of 1 m costs.
const ELEVATOR_COST: f64 = 0.3;
const HEIGHT_COST: f64 = 1.0;
/// The sum forgets with this, 1/s: it is for the elevator's trim, and one that never forgets has no solution where the elevator moves nothing.
const FORGETS_PER_S: f64 = 0.05;
/// Time constant of the gusts along the way near the ground, s: their scale of some 23 m (MIL-F-8785C at 10 ft) at 15 m/s.
const GUST_S: f64 = 1.5;
/// Terms of the exponential's series, and doublings of the horizon: 2¹⁰ frames.
const TERMS: u32 = 9;
const DOUBLINGS: u32 = 10;

/// Elevator, rad, for each unit of what is off.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Gains {
    /// Per sink rate that is too much, m/s.
    pub sink: f64,
    /// Per pitch, rad.
    pub pitch: f64,
    /// Per pitch rate, rad/s.
    pub rate: f64,
    /// Per elevator that stands beyond its trim, rad.
    pub elevator: f64,
    /// Of the trim: per sum of the sink rate, m.
    pub sum: f64,
    /// Per airspeed that gusts bring, m/s.
    pub gust: f64,
}

/// Gains at an airspeed and a density. `delay_s`: from a command to the surface, on the average.
pub(super) fn gains(airframe: &Airframe, s: &Signals, delay_s: f64, dt_s: f64) -> Gains {
    let problem = Problem::new(airframe, s, delay_s, dt_s);
    let [sink, pitch, rate, elevator, sum, gust] = problem.feedback(&problem.value()).data.0[0];
    Gains { sink, pitch, rate, elevator, sum, gust }
}

/// One frame: what the states become, what a command adds, and what both cost.
struct Problem {
    step: Matrix,
    input: Vector,
    costs: Matrix,
    elevator_cost: f64,
}

impl Problem {
    fn new(airframe: &Airframe, s: &Signals, delay_s: f64, dt_s: f64) -> Self {
        let (Pitching { a, m_q, m_alpha, m_delta }, v) = (Pitching::new(airframe, s), s.airspeed_mps);
        let aero = &airframe.aerodynamics;
        let mut rates = Matrix::zeros();
        // Sink: lift by incidence θ + sink/V and by the elevator; a gust from ahead lifts, too.
        rates[(0, 0)] = -a;
        rates[(0, 1)] = -a * v;
        rates[(0, 3)] = -a * v * aero.lift_elevator / aero.lift_alpha;
        rates[(0, 5)] = -2.0 * GRAVITY_MPS2 / v;
        rates[(1, 2)] = 1.0;
        rates[(2, 0)] = m_alpha / v;
        rates[(2, 1)] = m_alpha;
        rates[(2, 2)] = m_q;
        rates[(2, 3)] = m_delta;
        // Servo, delay and frames as one lag.
        rates[(3, 3)] = -1.0 / delay_s;
        (rates[(4, 0)], rates[(4, 4)]) = (1.0, -FORGETS_PER_S);
        rates[(5, 5)] = -1.0 / GUST_S;
        let (mut step, mut sum, mut term) =
            (Matrix::identity(), dt_s * Matrix::identity(), Matrix::identity());
        for n in 1..=TERMS {
            term *= rates * (dt_s / f64::from(n));
            step += term;
            sum += term * (dt_s / f64::from(n + 1));
        }
        let mut costs = Matrix::zeros();
        (costs[(0, 0)], costs[(4, 4)]) = (1.0, HEIGHT_COST);
        Self { step, input: sum.column(3) / delay_s, costs, elevator_cost: ELEVATOR_COST * -m_delta }
    }

    /// The solution of the discrete Riccati equation, by structure-preserving doubling (Chu, Fan, Lin and Wang, 2004).
    fn value(&self) -> Matrix {
        let reach = self.input * self.input.transpose() / self.elevator_cost;
        let (mut step, mut reach, mut value) = (self.step, reach, self.costs);
        for _ in 0..DOUBLINGS {
            // Both are positive semi-definite: there is an inverse.
            let Some(inverse) = (Matrix::identity() + reach * value).try_inverse() else { break };
            let next = step * inverse;
            reach += next * reach * step.transpose();
            value += step.transpose() * value * inverse * step;
            step = next * step;
        }
        value
    }

    /// The command that the solution gives, with its sign turned, per state.
    fn feedback(&self, value: &Matrix) -> Vector {
        let weight = self.elevator_cost + (self.input.transpose() * value * self.input).x;
        (self.input.transpose() * value * self.step / weight).transpose()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::airframe::BUILT_IN;

    fn each(mut check: impl FnMut(&str, &Airframe, &Signals, f64)) {
        for (name, text) in BUILT_IN {
            let airframe = Airframe::from_toml(text).unwrap();
            for delay_s in [0.02, 0.06, 0.14] {
                for speed in [1.2, 1.6, 2.2] {
                    let airspeed_mps = speed * airframe.stall_mps(airframe.greatest_lift(), 1.2);
                    let s = Signals { airspeed_mps, density_kgpm3: 1.2, ..Signals::default() };
                    check(name, &airframe, &s, delay_s);
                }
            }
        }
    }

    #[test]
    fn doubling_solves_the_riccati_equation() {
        each(|name, airframe, s, delay_s| {
            let problem = Problem::new(airframe, s, delay_s, 0.02);
            let value = problem.value();
            let regulated = problem.step - problem.input * problem.feedback(&value).transpose();
            let again = problem.costs + problem.step.transpose() * value * regulated;
            assert!((again - value).norm() < 1e-6 * value.norm(), "{name}, {delay_s} s: {}", again - value);
        });
    }

    #[test]
    fn regulated_model_comes_to_rest_within_seconds() {
        each(|name, airframe, s, delay_s| {
            let Problem { step, input, .. } = Problem::new(airframe, s, delay_s, 0.02);
            let g = gains(airframe, s, delay_s, 0.02);
            let gain = Vector::new(g.sink, g.pitch, g.rate, g.elevator, g.sum, g.gust).transpose();
            let mut state = Vector::new(2.0, 0.05, 0.2, 0.0, 0.0, 3.0);
            for _ in 0..400 {
                state = step * state - input * (gain * state).x;
            }
            assert!(state[0].abs() < 0.1, "{name}, {delay_s} s: {state}");
        });
    }
}
