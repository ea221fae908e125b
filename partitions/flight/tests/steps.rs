//! Each loop by itself: a step of its target on the plant, in calm air with the usual sensors and the estimator in the loop, held
//! against the closed loop that its gains were designed for. Everything else is held as the Controller holds it.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a panic here is a failed test")]

mod common;

use bateleur_flight::GRAVITY_MPS2;
use bateleur_flight::airframe::Airframe;
use bateleur_flight::control::LoopCommands;
use bateleur_flight::control::inner::{InnerLoops, InnerTuning, Signals};
use bateleur_plant::{Truth, Turbulence};
use common::{Flight, FlightStart, Options};
use nalgebra::Vector3;
use std::collections::VecDeque;

const AIRCRAFT: [(&str, &str); 3] = [
    ("Aerosonde", common::AEROSONDE),
    ("Rascal 110", common::RASCAL),
    ("Ultra Stick 25e", common::ULTRA_STICK),
];
const FRAME_S: f64 = 0.02;

/// An actuator as the laws' design knows it: dead time, then a first-order lag.
struct Actuator {
    waiting: VecDeque<f64>,
    lag_s: f64,
    position: f64,
}

impl Actuator {
    fn new(dead_s: f64, lag_s: f64, position: f64) -> Self {
        let steps = (dead_s / H_S).round() as usize;
        Self { waiting: vec![position; steps].into(), lag_s, position }
    }

    fn step(&mut self, command: f64) -> f64 {
        self.waiting.push_back(command);
        let arrived = self.waiting.pop_front().unwrap();
        self.position += (arrived - self.position) * (1.0 - (-H_S / self.lag_s).exp());
        self.position
    }
}

/// Steps of the design models in a frame, and their length, s.
const FINE: usize = 20;
const H_S: f64 = FRAME_S / FINE as f64;

/// What the design of a loop knows: the airframe, its gains, and the delays it has to live with.
struct Design {
    airframe: Airframe,
    tuning: InnerTuning,
    loops: InnerLoops,
    s: Signals,
}

impl Design {
    fn new(text: &str) -> Self {
        let airframe = Airframe::from_toml(text).unwrap();
        let mut loops = InnerLoops::default();
        let (tuning, s) = (InnerTuning::default(), signals());
        loops.engage_normal(&airframe, &tuning, &s, s.normal_mps2, 0.0);
        Self { airframe, tuning, loops, s }
    }

    /// A command takes a frame to the servo, and its sensors' means are half a frame old.
    fn surface(&self) -> Actuator {
        let servo = &self.airframe.servo;
        Actuator::new(servo.delay_s + 1.5 * FRAME_S, 1.0 / servo.bandwidth_radps, 0.0)
    }

    fn pressure_n(&self) -> f64 {
        0.5 * self.s.density_kgpm3
            * self.s.airspeed_mps
            * self.s.airspeed_mps
            * self.airframe.geometry.wing_area_m2
    }

    /// The short period: Ċ = −aC − aVQ, Q̇ = −m_α/(Va) C + m_q Q + m_α̇ α̇ + m_δ δ.
    fn normal(mut self, by: f64, frames: usize) -> Vec<f64> {
        let (aero, mass, chord) =
            (self.airframe.aerodynamics, self.airframe.mass, self.airframe.geometry.mean_chord_m);
        let (force, v) = (self.pressure_n(), self.s.airspeed_mps);
        let a = force * aero.lift_alpha / (mass.mass_kg * v);
        let per_rate = force * chord * chord / (2.0 * v * mass.inertia_yy_kgm2);
        let (m_q, m_alpha_rate) = (per_rate * aero.pitch_pitch_rate, per_rate * aero.pitch_alpha_rate);
        let m_alpha = force * chord * aero.pitch_alpha / mass.inertia_yy_kgm2;
        let m_delta = force * chord * aero.pitch_elevator / mass.inertia_yy_kgm2;
        let mut elevator = self.surface();
        let mut wanted = -GRAVITY_MPS2;
        (0..frames)
            .map(|_| {
                wanted = (wanted - 60.0 * FRAME_S).max(-GRAVITY_MPS2 - by);
                let command =
                    self.loops.normal(&self.airframe, &self.tuning, &self.s, (wanted, -1.0), FRAME_S);
                for _ in 0..FINE {
                    let (delta, c) = (elevator.step(command), self.s.normal_mps2 + GRAVITY_MPS2);
                    let q = self.s.pitch_rate_radps;
                    self.s.normal_mps2 += H_S * (-a * c - a * v * q);
                    let alpha_rate = q + c / v;
                    let stiffness = -m_alpha / (v * a) * c;
                    self.s.pitch_rate_radps +=
                        H_S * (stiffness + m_q * q + m_alpha_rate * alpha_rate + m_delta * delta);
                }
                -(self.s.normal_mps2 + GRAVITY_MPS2) / by
            })
            .collect()
    }

    /// Ṗ = l_p P + l_δ δ.
    fn roll(mut self, by: f64, frames: usize) -> Vec<f64> {
        let (aero, span) = (self.airframe.aerodynamics, self.airframe.geometry.wing_span_m);
        let scale = self.pressure_n() * span / self.airframe.mass.inertia_xx_kgm2;
        let (l_p, l_delta) =
            (scale * span * aero.roll_roll_rate / (2.0 * self.s.airspeed_mps), scale * aero.roll_aileron);
        let mut aileron = self.surface();
        let mut wanted = 0.0;
        (0..frames)
            .map(|_| {
                wanted = (wanted + 16.0 * FRAME_S).min(by);
                let command = self.loops.roll(&self.airframe, &self.tuning, &self.s, wanted, FRAME_S);
                for _ in 0..FINE {
                    let delta = aileron.step(command);
                    self.s.roll_rate_radps += H_S * (l_p * self.s.roll_rate_radps + l_delta * delta);
                }
                self.s.roll_rate_radps / by
            })
            .collect()
    }

    /// The thrust's lag, and that thrust falls and drag rises while the aircraft gets faster.
    fn axial(mut self, by: f64, frames: usize) -> Vec<f64> {
        let (v, density) = (self.s.airspeed_mps, self.s.density_kgpm3);
        let trim = self.airframe.trim(v, density).throttle;
        let frame = self.airframe;
        let drag = |v: f64| {
            let area = 0.5 * density * v * v * frame.geometry.wing_area_m2;
            let lift = frame.mass.mass_kg * GRAVITY_MPS2 / area;
            area * (frame.aerodynamics.drag_0 + frame.aerodynamics.drag_induced * lift * lift)
        };
        let dead = frame.servo.delay_s + 1.5 * FRAME_S;
        let mut throttle = Actuator::new(dead, frame.thrust_lag_s(), trim);
        self.loops.engage_axial(&frame, &self.tuning, &self.s, 0.0, trim);
        let mut wanted = 0.0;
        (0..frames)
            .map(|_| {
                wanted = (wanted + 8.0 * FRAME_S).min(by);
                let command = self.loops.axial(&frame, &self.tuning, &self.s, wanted, FRAME_S);
                for _ in 0..FINE {
                    let v = self.s.airspeed_mps;
                    let thrust = frame.thrust_n(throttle.step(command), v, density);
                    self.s.axial_mps2 = (thrust - drag(v)) / frame.mass.mass_kg;
                    self.s.airspeed_mps += H_S * self.s.axial_mps2;
                }
                self.s.axial_mps2 / by
            })
            .collect()
    }

    /// The rudder's steady sideslip and its side force: B = q̄S/m (C_Yδ − C_Yβ C_nδ/C_nβ) δ.
    fn lateral(mut self, plant: &bateleur_plant::Airframe, by: f64, frames: usize) -> Vec<f64> {
        let a = &plant.aerodynamics;
        let side = a.side_rudder - a.side_beta * a.yaw_rudder / a.yaw_beta;
        let scale = self.pressure_n() / self.airframe.mass.mass_kg;
        // With the wings level a side force bends the track, and the yaw rate of that works against the rudder.
        let v = self.s.airspeed_mps;
        let turning = a.side_beta * a.yaw_yaw_rate * plant.geometry.wing_span_m / (2.0 * v * a.yaw_beta * v);
        let gain = scale * side / (1.0 + scale * turning);
        let mut rudder = self.surface();
        (0..frames)
            .map(|_| {
                let command = self.loops.lateral(&self.airframe, &self.tuning, &self.s, by, FRAME_S);
                for _ in 0..FINE {
                    self.s.lateral_mps2 = gain * rudder.step(command);
                    self.s.yaw_rate_radps = self.s.lateral_mps2 / v;
                }
                self.s.lateral_mps2 / by
            })
            .collect()
    }
}

/// What an answer to a step of 1 looks like.
#[derive(Clone, Copy, Debug)]
struct Shape {
    /// From a tenth to nine tenths, s.
    rise_s: f64,
    /// Beyond 1.
    overshoot: f64,
    /// Mean error of the last fifth.
    steady: f64,
}

fn shape(answer: &[f64]) -> Shape {
    let first = |level: f64| answer.iter().position(|x| *x >= level).map_or(f64::NAN, |i| i as f64 * FRAME_S);
    let tail = &answer[answer.len() * 4 / 5..];
    Shape {
        rise_s: first(0.9) - first(0.1),
        overshoot: answer.iter().fold(0.0, |most: f64, x| most.max(x - 1.0)),
        steady: tail.iter().sum::<f64>() / tail.len() as f64 - 1.0,
    }
}

/// Specific acceleration in wind axes: axial, lateral, normal.
fn specific(t: &Truth) -> Vector3<f64> {
    let (sin, cos) = t.alpha_rad.sin_cos();
    let f = t.specific_force_mps2;
    Vector3::new(f.x * cos + f.z * sin, f.y, f.z * cos - f.x * sin)
}

fn roll_rate(t: &Truth) -> f64 {
    let (sin, cos) = t.alpha_rad.sin_cos();
    t.rates_radps.x * cos + t.rates_radps.z * sin
}

/// Wings level at 160 m and 22 m/s, as the Controller flies with the autopilot alone.
const LEVEL: LoopCommands = LoopCommands {
    autopilot: true,
    bank_rad: Some(0.0),
    altitude_m: Some(160.0),
    airspeed_mps: Some(22.0),
    ..LoopCommands::MISSION
};

/// Settles, sets the step, and gives the measured answer as a share of it.
fn step(
    text: &'static str,
    seconds: f64,
    from: f64,
    to: f64,
    set: impl Fn(&mut LoopCommands, f64),
    measure: impl Fn(&Truth) -> f64,
) -> Vec<f64> {
    let mut mean = vec![0.0; (seconds / FRAME_S) as usize];
    let seeds = 3;
    for seed in 0..seeds {
        let mut options = Options::new(720_000 + seed, 0.0, 0.0, Turbulence::Calm);
        (options.airframe, options.start) = (text, Some(FlightStart::default()));
        options.conditions.sensors = bateleur_plant::SensorErrors::none();
        let mut flight = Flight::new(options);
        flight.commands = LoopCommands { navigation: false, ..LEVEL };
        flight.run(25.0);
        set(&mut flight.commands, from);
        flight.run(3.0);
        set(&mut flight.commands, to);
        // What the accelerometer's bias hides of the truth was there before.
        let before = measure(&flight.plant.truth());
        for value in &mut mean {
            flight.step();
            *value += (measure(&flight.plant.truth()) - before) / (to - from) / seeds as f64;
        }
        assert!(!flight.plant.truth().crashed);
    }
    mean
}

fn signals() -> Signals {
    Signals { airspeed_mps: 22.0, density_kgpm3: 1.2, normal_mps2: -GRAVITY_MPS2, ..Signals::default() }
}

/// Mean square difference of two answers, as a share of the step.
fn apart(a: &[f64], b: &[f64]) -> f64 {
    (a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
}

fn show(name: &str, what: &str, flown: &[f64], wanted: &[f64]) -> (Shape, Shape, f64) {
    let (a, b) = (shape(flown), shape(wanted));
    let off = apart(flown, wanted);
    println!(
        "{name:16} {what:9} rise {:5.2} s ({:5.2}) overshoot {:5.1} % ({:4.1}) steady {:5.1} % ({:5.1}) apart {:5.1} %",
        a.rise_s,
        b.rise_s,
        100.0 * a.overshoot,
        100.0 * b.overshoot,
        100.0 * a.steady,
        100.0 * b.steady,
        100.0 * off
    );
    (a, b, off)
}

/// Each inner loop answers as its design says, delays and all.
fn assert_as_designed(name: &str, what: &str, flown: &[f64], design: &[f64]) {
    let (is, should, off) = show(name, what, flown, design);
    let rise = (is.rise_s - should.rise_s).abs() - 0.04;
    assert!(off < 0.1, "{name}, {what}: {off} off its design");
    assert!(rise.is_nan() || rise < 0.5 * should.rise_s, "{name}, {what}: {is:?}, {should:?}");
    assert!(
        is.overshoot < should.overshoot + 0.05 && is.overshoot < 0.26,
        "{name}, {what}: {is:?}, {should:?}"
    );
    assert!((is.steady - should.steady).abs() < 0.06, "{name}, {what}: {is:?}, {should:?}");
}

#[test]
fn normal_loop_answers_a_step_as_designed_on_three_aircraft() {
    let by = 3.0;
    for (name, text) in AIRCRAFT {
        let set = |c: &mut LoopCommands, x: f64| c.normal_mps2 = Some(x);
        let flown = step(text, 1.2, -GRAVITY_MPS2, -GRAVITY_MPS2 - by, set, |t| specific(t).z);
        assert_as_designed(name, "normal", &flown, &Design::new(text).normal(by, flown.len()));
    }
}

#[test]
fn roll_rate_loop_answers_a_step_as_designed_on_three_aircraft() {
    let by = 0.5;
    for (name, text) in AIRCRAFT {
        let set = |c: &mut LoopCommands, x: f64| (c.bank_rad, c.roll_rate_radps) = (None, Some(x));
        let flown = step(text, 1.0, 0.0, by, set, roll_rate);
        assert_as_designed(name, "roll rate", &flown, &Design::new(text).roll(by, flown.len()));
    }
}

#[test]
fn axial_loop_answers_a_step_as_designed_on_three_aircraft() {
    let by = 0.6;
    for (name, text) in AIRCRAFT {
        let flown = step(text, 4.0, 0.0, by, |c, x| c.axial_mps2 = Some(x), |t| specific(t).x);
        assert_as_designed(name, "axial", &flown, &Design::new(text).axial(by, flown.len()));
    }
}

#[test]
fn lateral_loop_answers_a_step_as_designed_on_three_aircraft() {
    let by = 0.3;
    for (name, text) in AIRCRAFT {
        let flown = step(text, 20.0, 0.0, by, |c, x| c.lateral_mps2 = Some(x), |t| specific(t).y);
        let plant = bateleur_plant::Airframe::from_toml(text).unwrap();
        assert_as_designed(name, "lateral", &flown, &Design::new(text).lateral(&plant, by, flown.len()));
    }
}

/// The answer of a first-order loop, 1/s.
fn first_order(rate: f64, frames: usize) -> Vec<f64> {
    (0..frames).map(|k| 1.0 - (-rate * (k + 1) as f64 * FRAME_S).exp()).collect()
}

/// An outer loop is a gain about an inner one: first order at its rate, as long as the inner one is quicker.
struct Outer {
    what: &'static str,
    rate: f64,
    seconds: f64,
    from: f64,
    to: f64,
    set: fn(&mut LoopCommands, f64),
    measure: fn(&Truth) -> f64,
}

const OUTER: [Outer; 6] = [
    Outer {
        what: "bank",
        rate: 2.2,
        seconds: 3.0,
        from: 0.0,
        to: 0.4,
        set: |c, x| c.bank_rad = Some(x),
        measure: |t| t.roll_rad,
    },
    Outer {
        what: "pitch rate",
        rate: 8.0,
        seconds: 1.0,
        from: 0.0,
        to: 0.1,
        set: |c, x| c.pitch_rate_radps = Some(x),
        // Of the path: what the nose does follows when the angle of attack is there.
        measure: |t| -(specific(t).z + GRAVITY_MPS2 * t.pitch_rad.cos()) / t.airspeed_mps,
    },
    Outer {
        what: "airspeed",
        rate: 0.7,
        seconds: 15.0,
        from: 22.0,
        to: 24.0,
        set: |c, x| c.airspeed_mps = Some(x),
        measure: |t| t.airspeed_mps,
    },
    Outer {
        what: "altitude",
        rate: 0.4,
        seconds: 20.0,
        from: 160.0,
        to: 165.0,
        set: |c, x| c.altitude_m = Some(x),
        measure: |t| -t.position_ned_m.z,
    },
    Outer {
        what: "heading",
        rate: 0.75,
        seconds: 10.0,
        from: 0.0,
        to: 0.4,
        set: |c, x| (c.bank_rad, c.track_rad) = (None, Some(x)),
        measure: |t| t.velocity_ned_mps.y.atan2(t.velocity_ned_mps.x),
    },
    Outer {
        what: "heading, left",
        rate: 0.75,
        seconds: 10.0,
        from: 0.0,
        to: -0.4,
        set: |c, x| (c.bank_rad, c.track_rad) = (None, Some(x)),
        measure: |t| t.velocity_ned_mps.y.atan2(t.velocity_ned_mps.x),
    },
];

#[test]
fn outer_loops_answer_steps_as_the_gains_about_the_inner_ones_say() {
    for (name, text) in AIRCRAFT {
        for outer in &OUTER {
            let flown = step(text, outer.seconds, outer.from, outer.to, outer.set, outer.measure);
            let (is, should, _) = show(name, outer.what, &flown, &first_order(outer.rate, flown.len()));
            let (rise, quick) = (is.rise_s / should.rise_s, outer.rate > 5.0);
            let (over, off) = if quick { (0.26, 0.08) } else { (0.15, 0.03) };
            assert!((0.25..1.6).contains(&rise), "{name}, {}: {is:?}, {should:?}", outer.what);
            assert!(is.overshoot < over && is.steady.abs() < off, "{name}, {}: {is:?}", outer.what);
        }
    }
}
