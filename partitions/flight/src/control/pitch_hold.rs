//! The elevator near the ground: it regulates a sink rate in the air, and holds a pitch attitude on the wheels.
//!
//! Gusts near the ground change within half a second, as fast as the normal loop follows. It would pitch the aircraft after each of them, and late.
//! In the air [`super::climb_regulator`] has the gains. On its wheels, where neither the normal acceleration nor the sink rate says anything, an
//! attitude keeps the aircraft off its nose; so it does in a hop, which is no flight.

use super::climb_regulator;
use super::inner::{Integrator, Pitching, Signals};
use super::outer::slew;
use crate::airframe::Airframe;
use crate::attitude::low_pass;
use crate::kept::kept;

/// Frequency of the attitude, rad/s, at most, its damping, and what servo and frames leave of the frequency: a share of one over their delay.
const FREQUENCY_RADPS: f64 = 12.0;
const DAMPING: f64 = 0.8;
const DELAY_SHARE: f64 = 0.84;
/// Share of the stiffness that the loop adds at least.
const LEAST_SHARE: f64 = 0.25;
/// The frequency where the pitch rate is not known, rad/s: the airframe's own damping has to do.
const BLIND_RADPS: f64 = 4.0;
/// And where the attitude comes late, too.
const LATE_RADPS: f64 = 1.6;
/// Delay of the frames: an actuator command is taken half a frame late on the average, and acts a frame later.
const FRAMES: f64 = 1.5;
/// Share of the frequency with which the trim follows.
const TRIM_SHARE: f64 = 0.17;
/// What the regulator answers at most: sink rate that is too much, and that part of it that moves the trim, m/s; pitch off, rad; gust, m/s. The model
/// is one of small changes.
const MOST_SINK_MPS: f64 = 4.0;
const MOST_LEARNT_MPS: f64 = 2.0;
const MOST_PITCH_RAD: f64 = 0.3;
const MOST_GUST_MPS: f64 = 6.0;
/// How fast it goes to another attitude, rad/s.
const TO_ATTITUDE_RADPS: f64 = 0.26;
/// Share of its travel down that the elevator has where the aircraft is too slow to fly: nothing can lift it there, and the tail may sink.
const SLOW_SHARE: f64 = 0.2;
/// Below this airspeed, of the one that carries the aircraft, the gains grow no more: the airframe's own damping falls with the airspeed.
const GAINS_SHARE: f64 = 1.2;

/// What the elevator is for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Aim {
    /// A climb rate.
    Climb {
        /// Attitude in which it is known to be flown, rad.
        about_rad: f64,
        /// What it lacks yet, m/s.
        lacking_mps: f64,
        /// What gusts add to the airspeed, m/s.
        gust_mps: f64,
    },
    /// An attitude: that on the wheels, or where the ground may be.
    Attitude {
        /// rad.
        pitch_rad: f64,
        /// It is too slow to fly.
        is_slow: bool,
    },
}

/// See the module's head.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct PitchHold {
    /// What is asked for in this frame; `None`: the normal loop has the elevator.
    pub aim: Option<Aim>,
    held: Option<Held>,
}

/// What it remembers from frame to frame.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Held {
    /// It holds an attitude, and regulates no climb rate.
    attitude: bool,
    /// The attitude that is asked for by now, or where the elevator is; rad.
    reached_rad: f64,
    /// Of the elevator, rad.
    trim: Integrator,
}

kept!(Held { attitude: bool, reached_rad: f64, trim: Integrator });
kept!(PitchHold { held: Option<Held>; aim = None });

impl PitchHold {
    /// It holds the elevator, or did in the frame before.
    pub(super) fn is_on(&self) -> bool {
        self.held.is_some()
    }

    /// Moves the elevator's trim, rad.
    pub(super) fn shift(&mut self, by_rad: f64) {
        if let Some(held) = &mut self.held {
            held.trim = Integrator::new(held.trim.value() + by_rad);
        }
    }

    /// Lets go of the elevator.
    pub(super) fn release(&mut self) {
        self.held = None;
    }

    /// Elevator (rad) for an aim; it begins at `last_rad`.
    pub(super) fn step(
        &mut self,
        airframe: &Airframe,
        s: &Signals,
        aim: &Aim,
        last_rad: f64,
        dt_s: f64,
    ) -> f64 {
        let limit = airframe.servo.elevator_limit_rad;
        let is_slow = matches!(aim, Aim::Attitude { is_slow: true, .. });
        let high = if is_slow { SLOW_SHARE * limit } else { limit };
        // The other law begins anew, where the elevator is.
        let attitude = matches!(aim, Aim::Attitude { .. });
        let held = self.held.filter(|held| held.attitude == attitude);
        let least_mps = GAINS_SHARE * airframe.stall_mps(airframe.greatest_lift(), s.density_kgpm3);
        let at = Signals { airspeed_mps: s.airspeed_mps.max(least_mps), ..*s };
        let delay_s = airframe.servo.delay_s + 1.0 / airframe.servo.bandwidth_radps + FRAMES * dt_s;
        match *aim {
            Aim::Climb { lacking_mps, about_rad, gust_mps } => {
                let gains = climb_regulator::gains(airframe, &at, delay_s, dt_s);
                let within = |value: f64, most: f64| value.clamp(-most, most);
                let law = -gains.sink * within(lacking_mps, MOST_SINK_MPS)
                    - gains.pitch * within(s.pitch_rad - about_rad, MOST_PITCH_RAD)
                    - gains.rate * s.pitch_rate_radps
                    - gains.gust * within(gust_mps, MOST_GUST_MPS);
                // Trim counts this much, as the elevator beyond it is fed back.
                let trim_share = 1.0 + gains.elevator;
                let trim_rad = (last_rad - law / trim_share).clamp(-limit, limit);
                let begun = Held { attitude, reached_rad: last_rad, trim: Integrator::new(trim_rad) };
                let mut held = held.unwrap_or(begun);
                let law = law - gains.elevator * (held.reached_rad - held.trim.value());
                let learnt = -gains.sum / trim_share * within(lacking_mps, MOST_LEARNT_MPS);
                held.trim.advance(learnt * dt_s, law + held.trim.value(), -limit, high);
                let elevator_rad = (law + held.trim.value()).clamp(-limit, high);
                held.reached_rad = low_pass(held.reached_rad, elevator_rad, delay_s, dt_s);
                self.held = Some(held);
                elevator_rad
            }
            Aim::Attitude { pitch_rad, .. } => {
                let reached_rad = held.map_or(s.pitch_rad, |held| held.reached_rad);
                let reached_rad = slew(reached_rad, pitch_rad, TO_ATTITUDE_RADPS, dt_s);
                let gains = gains(airframe, &at, delay_s);
                let off_rad = reached_rad - s.pitch_rad;
                let law = gains.rate * s.pitch_rate_radps - gains.attitude * off_rad;
                let mut trim = held.map_or(Integrator::new(last_rad - law), |held| held.trim);
                trim.advance(-gains.trim * off_rad * dt_s, law + trim.value(), -limit, high);
                self.held = Some(Held { attitude, reached_rad, trim });
                (law + trim.value()).clamp(-limit, high)
            }
        }
    }
}

/// Elevator per attitude that is lacking, per pitch rate (s), and of the trim (1/s).
struct Gains {
    attitude: f64,
    rate: f64,
    trim: f64,
}

/// Gains that give `s² + 2ζω s + ω²` to θ̈ = m_q θ̇ + m_α θ + m_δ δ. An airframe that is as stiff by itself keeps its stiffness and gets a share.
fn gains(airframe: &Airframe, s: &Signals, delay_s: f64) -> Gains {
    let Pitching { m_q, m_alpha, m_delta, .. } = Pitching::new(airframe, s);
    let (most, damping) = match (s.pitches_blind, s.pitches_late) {
        (true, true) => (LATE_RADPS, 0.0),
        (true, _) => (BLIND_RADPS, 0.0),
        _ => (FREQUENCY_RADPS, DAMPING),
    };
    let frequency = most.min(DELAY_SHARE / delay_s);
    let square = frequency * frequency;
    let attitude = -(square + m_alpha).max(LEAST_SHARE * square) / m_delta;
    Gains {
        attitude,
        rate: (2.0 * damping * frequency + m_q).max(0.0) / -m_delta,
        trim: -TRIM_SHARE * frequency * square / m_delta,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::GRAVITY_MPS2;
    use crate::airframe::BUILT_IN;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use std::collections::VecDeque;

    /// The design model of pitch and path in gusts: changes about a trimmed flight.
    struct Model {
        airframe: Airframe,
        s: Signals,
        /// Path and gust as angles, rad.
        path_rad: f64,
        gust_rad: f64,
        sent: VecDeque<f64>,
        surface_rad: f64,
    }

    impl Model {
        fn new(text: &str, (speed, delay_s, dt_s): (f64, f64, f64)) -> Self {
            let mut airframe = Airframe::from_toml(text).unwrap();
            airframe.servo.delay_s = delay_s;
            let airspeed_mps = speed * airframe.stall_mps(airframe.greatest_lift(), 1.2);
            let sent = VecDeque::from(vec![0.0; 1 + (delay_s / dt_s).ceil() as usize]);
            let s = Signals { airspeed_mps, density_kgpm3: 1.2, ..Signals::default() };
            Self { airframe, s, path_rad: 0.0, gust_rad: 0.0, sent, surface_rad: 0.0 }
        }

        /// A frame with the elevator that was asked for a delay and a frame ago.
        fn step(&mut self, elevator_rad: f64, dt_s: f64) {
            self.sent.push_back(elevator_rad);
            let asked_rad = self.sent.pop_front().unwrap();
            let (a, v) = (&self.airframe, self.s.airspeed_mps);
            let (aero, inertia) = (&a.aerodynamics, a.mass.inertia_yy_kgm2);
            let (force, chord) = (0.6 * v * v * a.geometry.wing_area_m2, a.geometry.mean_chord_m);
            for _ in 0..20 {
                let h = dt_s / 20.0;
                self.surface_rad += h * a.servo.bandwidth_radps * (asked_rad - self.surface_rad);
                let alpha = self.s.pitch_rad - self.path_rad + self.gust_rad;
                let rate = chord / (2.0 * v) * (aero.pitch_pitch_rate + aero.pitch_alpha_rate);
                let moment = aero.pitch_alpha * alpha
                    + aero.pitch_elevator * self.surface_rad
                    + rate * self.s.pitch_rate_radps;
                self.s.pitch_rate_radps += h * force * chord * moment / inertia;
                self.s.pitch_rad += h * self.s.pitch_rate_radps;
                self.path_rad += h * force * aero.lift_alpha * alpha / (a.mass.mass_kg * v);
            }
        }
    }

    fn each(mut check: impl FnMut(&str, &str, (f64, f64, f64))) {
        for (name, text) in BUILT_IN {
            for delay_s in [0.0, 0.02, 0.06] {
                for dt_s in [0.01, 0.02, 0.04] {
                    for speed in [0.7, 1.0, 1.4] {
                        check(name, text, (speed, delay_s, dt_s));
                    }
                }
            }
        }
    }

    #[test]
    fn attitude_is_reached_and_does_not_swing_with_any_aircraft_and_delay() {
        each(|name, text, about| {
            let (mut model, mut hold) = (Model::new(text, about), PitchHold::default());
            let (.., dt_s) = about;
            let aim = Aim::Attitude { pitch_rad: 0.07, is_slow: false };
            let (mut most, mut last) = (0f64, 0f64);
            for frame in 0..(8.0 / dt_s) as u32 {
                let elevator_rad = hold.step(&model.airframe, &model.s, &aim, 0.0, dt_s);
                model.step(elevator_rad, dt_s);
                most = most.max(model.s.pitch_rad);
                last = if f64::from(frame) * dt_s > 6.0 {
                    last.max((model.s.pitch_rad - 0.07).abs())
                } else {
                    0.0
                };
            }
            assert!(most < 0.14, "{name}, {about:?}: {most} rad");
            assert!(last < 0.045, "{name}, {about:?}: {last} rad off");
        });
    }

    #[test]
    fn attitude_that_comes_late_without_a_pitch_rate_does_not_swing_up() {
        each(|name, text, about| {
            let (.., dt_s) = about;
            let (mut model, mut hold) = (Model::new(text, about), PitchHold::default());
            let mut told = VecDeque::from(vec![0.0; (0.3 / dt_s) as usize]);
            let aim = Aim::Attitude { pitch_rad: 0.07, is_slow: false };
            let mut last = 0f64;
            for frame in 0..(20.0 / dt_s) as u32 {
                told.push_back(model.s.pitch_rad);
                let pitch_rad = told.pop_front().unwrap();
                let s = Signals {
                    pitch_rad,
                    pitch_rate_radps: 0.0,
                    pitches_blind: true,
                    pitches_late: true,
                    ..model.s
                };
                model.step(hold.step(&model.airframe, &s, &aim, 0.0, dt_s), dt_s);
                if f64::from(frame) * dt_s > 15.0 {
                    last = last.max((model.s.pitch_rad - 0.07).abs());
                }
            }
            // An elevator that stays where it is leaves 0.07.
            assert!(last < 0.065, "{name}, {about:?}: {last} rad off");
        });
    }

    #[test]
    fn gusts_turn_no_aircraft_further_than_a_few_degrees() {
        let mut chance = ChaCha8Rng::seed_from_u64(1);
        each(|name, text, about| {
            let (mut model, mut hold) = (Model::new(text, about), PitchHold::default());
            let (speed, delay_s, dt_s) = about;
            if speed < 1.0 {
                return; // on its wheels
            }
            let v = model.s.airspeed_mps;
            let aim = Aim::Attitude { pitch_rad: 0.0, is_slow: false };
            let (mut gust_mps, mut squares) = (0.0, 0.0);
            let frames = (20.0 / dt_s) as u32;
            for _ in 0..frames {
                // 1.5 m/s, and 3 m long.
                let keep = (-dt_s * v / 3.0).exp();
                let noise: f64 = StandardNormal.sample(&mut chance);
                gust_mps = keep * gust_mps + 1.5 * (1.0 - keep * keep).sqrt() * noise;
                model.gust_rad = gust_mps / v;
                let elevator_rad = hold.step(&model.airframe, &model.s, &aim, 0.0, dt_s);
                model.step(elevator_rad, dt_s);
                squares += model.s.pitch_rad * model.s.pitch_rad;
            }
            let off_rad = (squares / f64::from(frames)).sqrt();
            let bound_rad = if delay_s + dt_s < 0.045 { 0.1 } else { 0.2 };
            assert!(off_rad < bound_rad, "{name}, {about:?}: {off_rad} rad");
        });
    }

    /// Root mean square of the sink rate in gusts, m/s, with an aim for each sink rate (m/s) and gust along the way (m/s).
    fn sink_in_gusts_mps(model: &mut Model, dt_s: f64, aim: impl Fn(f64, f64) -> Aim) -> f64 {
        let (mut hold, mut chance) = (PitchHold::default(), ChaCha8Rng::seed_from_u64(1));
        let v = model.s.airspeed_mps;
        let (mut gust_mps, mut along_mps, mut squares) = (0.0, 0.0, 0.0);
        let frames = (60.0 / dt_s) as u32;
        for frame in 0..frames {
            let mut next = |value: f64, deviation: f64, scale_m: f64| {
                let keep = (-dt_s * v / scale_m).exp();
                let noise: f64 = StandardNormal.sample(&mut chance);
                keep * value + deviation * (1.0 - keep * keep).sqrt() * noise
            };
            (gust_mps, along_mps) = (next(gust_mps, 1.5, 3.0), next(along_mps, 3.0, 23.0));
            model.gust_rad = gust_mps / v;
            model.path_rad += 2.0 * GRAVITY_MPS2 * along_mps / (v * v) * dt_s;
            let sink_mps = -model.path_rad * v;
            let elevator_rad = hold.step(&model.airframe, &model.s, &aim(sink_mps, along_mps), 0.0, dt_s);
            model.step(elevator_rad, dt_s);
            // The first seconds are those of the trim.
            if f64::from(frame) * dt_s > 10.0 {
                squares += sink_mps * sink_mps;
            }
        }
        (squares / f64::from(frames)).sqrt()
    }

    #[test]
    fn regulator_begins_where_the_elevator_is_whatever_is_off() {
        each(|name, text, about| {
            if about.0 < 1.4 {
                return; // a weak elevator's trim is at its stop
            }
            let mut model = Model::new(text, about);
            (model.s.pitch_rad, model.s.pitch_rate_radps) = (-0.02, -0.05);
            for (lacking_mps, gust_mps, last_rad) in [(0.5, -1.0, -0.1), (-0.5, 1.0, -0.05)] {
                let aim = Aim::Climb { about_rad: 0.0, lacking_mps, gust_mps };
                let first_rad = PitchHold::default().step(&model.airframe, &model.s, &aim, last_rad, about.2);
                assert!((first_rad - last_rad).abs() < 0.02, "{name}, {about:?}: {last_rad} to {first_rad}");
            }
        });
    }

    #[test]
    fn regulated_sink_rate_strays_less_in_gusts_than_that_of_an_attitude_that_follows_it() {
        let (mut regulated, mut held) = (0.0, 0.0);
        each(|name, text, about| {
            let (speed, .., dt_s) = about;
            if speed < 1.4 {
                return; // the elevator is at its stop for much of the time
            }
            let model = || Model::new(text, about);
            let v = model().s.airspeed_mps;
            let regulated_mps = sink_in_gusts_mps(&mut model(), dt_s, |lacking_mps, gust_mps| Aim::Climb {
                about_rad: 0.0,
                lacking_mps,
                gust_mps,
            });
            let held_mps = sink_in_gusts_mps(&mut model(), dt_s, |sink_mps, _| Aim::Attitude {
                pitch_rad: (0.5 * sink_mps / v).clamp(-0.07, 0.14),
                is_slow: false,
            });
            // An elevator that is weak beside the wing's own damping has less to give.
            assert!(regulated_mps < 1.2 * held_mps, "{name}, {about:?}: {regulated_mps} and {held_mps} m/s");
            regulated += regulated_mps;
            held += held_mps;
        });
        assert!(regulated < 0.75 * held, "{regulated} and {held}");
    }

    #[test]
    fn tail_may_sink_once_nothing_can_lift_the_aircraft() {
        for (_, text) in BUILT_IN {
            let airframe = Airframe::from_toml(text).unwrap();
            let s = Signals { airspeed_mps: 8.0, density_kgpm3: 1.2, pitch_rad: 0.3, ..Signals::default() };
            let elevator_rad = |is_slow: bool| {
                let mut hold = PitchHold::default();
                let aim = Aim::Attitude { pitch_rad: 0.0, is_slow };
                (0..200).map(|_| hold.step(&airframe, &s, &aim, 0.0, 0.02)).fold(0.0, f64::max)
            };
            let limit = airframe.servo.elevator_limit_rad;
            assert!((elevator_rad(false) - limit).abs() < 1e-9);
            assert!(elevator_rad(true) < 0.21 * limit);
        }
    }
}
