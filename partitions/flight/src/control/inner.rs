//! The inner loops: specific acceleration and roll rate follow their references, whatever the aircraft.
//!
//! Everything uncertain (aerodynamics, engine, inertia) is enclosed here; the architecture is the seed's, three
//! specific-acceleration loops and a roll-rate loop. Gains come from the published derivatives by pole placement and
//! are computed anew from airspeed and density in every frame: that is the gain schedule. Integrators are kept in
//! actuator units, so that a changing gain does not move the actuator.

use super::Channels;
use crate::GRAVITY_MPS2;
use crate::airframe::Airframe;
use crate::kept::kept;
use crate::servo::ActuatorCommand;

/// What the inner loops measure.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Signals {
    /// Airspeed, m/s.
    pub airspeed_mps: f64,
    /// kg/m³.
    pub density_kgpm3: f64,
    /// Specific acceleration along wind x, m/s².
    pub axial_mps2: f64,
    /// Along wind y.
    pub lateral_mps2: f64,
    /// Along wind z; −g in level flight.
    pub normal_mps2: f64,
    /// Roll rate about the direction of flight, rad/s.
    pub roll_rate_radps: f64,
    /// Body, rad/s.
    pub pitch_rate_radps: f64,
    /// It is not known: the short period stays as it is, and a slow integrator alone moves the elevator.
    pub pitches_blind: bool,
    /// Nor does a magnetic field tell the attitude, which is found from forces and comes late.
    pub pitches_late: bool,
    /// Body, rad/s.
    pub yaw_rate_radps: f64,
    /// The gyroscope does not tell that.
    pub yaws_blind: bool,
    /// rad.
    pub bank_rad: f64,
    /// rad.
    pub pitch_rad: f64,
    /// Climb angle relative to the air, rad.
    pub climb_rad: f64,
}

impl Signals {
    /// q̄ S, N.
    fn pressure_force(&self, airframe: &Airframe) -> f64 {
        0.5 * self.density_kgpm3 * self.airspeed_mps * self.airspeed_mps * airframe.geometry.wing_area_m2
    }
}

/// An actuator integrator with stops.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(C)]
pub struct Integrator {
    value: f64,
}

impl Integrator {
    pub(super) fn new(value: f64) -> Self {
        Self { value }
    }

    pub(super) fn value(self) -> f64 {
        self.value
    }

    /// Adds a step unless the actuator stands at a stop and the step pushes further into it.
    pub(super) fn advance(&mut self, step: f64, output: f64, low: f64, high: f64) {
        let pushes = (output >= high && step > 0.0) || (output <= low && step < 0.0);
        if !pushes {
            self.value = (self.value + step).clamp(low, high);
        }
    }
}

kept!(Integrator { value: f64 });

/// One loop: an actuator output from proportional terms and an integrator.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Law {
    /// All terms without memory.
    proportional: f64,
    /// Rate of the integrator.
    integral_rate: f64,
}

/// The four loops' memory.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(C)]
pub struct InnerLoops {
    normal: Integrator,
    lateral: Integrator,
    axial: Integrator,
    roll: Integrator,
}

kept!(InnerLoops { normal: Integrator, lateral: Integrator, axial: Integrator, roll: Integrator });

/// Poles wanted; the same for every aircraft.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InnerTuning {
    /// Pole of the normal loop's integrator, rad/s.
    pub normal_pole: f64,
    /// Least damping of the short period.
    pub normal_damping: f64,
    /// Damping added to the Dutch roll.
    pub yaw_damping: f64,
    /// Rudder per lateral velocity change not felt, rad/(m/s).
    pub lateral_gain: f64,
    /// Bandwidth of the axial loop, rad/s.
    pub axial_bandwidth: f64,
    /// Damping of the axial loop.
    pub axial_damping: f64,
    /// Least fast pole of the roll loop, rad/s.
    pub roll_fast_pole: f64,
    /// Slow pole of the roll loop, rad/s.
    pub roll_pole: f64,
}

impl Default for InnerTuning {
    fn default() -> Self {
        Self {
            normal_pole: 3.0,
            normal_damping: 0.75,
            yaw_damping: 0.5,
            lateral_gain: 0.02,
            axial_bandwidth: 1.5,
            axial_damping: 0.9,
            roll_fast_pole: 8.0,
            roll_pole: 4.0,
        }
    }
}

/// The rudder trim stays within this, rad: a biased accelerometer must not fly a sideslip of more than 4°.
const RUDDER_TRIM_LIMIT_RAD: f64 = 0.08;

impl InnerLoops {
    /// Normal loop: elevator (rad) so that C follows its reference (m/s²), not below `least_rad`.
    pub fn normal(
        &mut self,
        airframe: &Airframe,
        tuning: &InnerTuning,
        s: &Signals,
        (wanted_mps2, least_rad): (f64, f64),
        dt_s: f64,
    ) -> f64 {
        let law = normal_law(airframe, tuning, s, wanted_mps2);
        let limit = airframe.servo.elevator_limit_rad;
        run(&mut self.normal, &law, least_rad.clamp(-limit, limit), limit, dt_s)
    }

    /// Lateral loop: rudder (rad), a Dutch-roll damper about the coordinated turn with a slow trim on B.
    pub fn lateral(
        &mut self,
        airframe: &Airframe,
        tuning: &InnerTuning,
        s: &Signals,
        wanted_mps2: f64,
        dt_s: f64,
    ) -> f64 {
        if !airframe.has_rudder() {
            return 0.0;
        }
        let law = lateral_law(airframe, tuning, s, wanted_mps2);
        let limit = airframe.servo.rudder_limit_rad;
        let output = run(&mut self.lateral, &law, -limit, limit, dt_s);
        self.lateral.value = self.lateral.value.clamp(-RUDDER_TRIM_LIMIT_RAD, RUDDER_TRIM_LIMIT_RAD);
        output
    }

    /// Axial loop: throttle (0 to 1) so that A follows its reference (m/s²).
    pub fn axial(
        &mut self,
        airframe: &Airframe,
        tuning: &InnerTuning,
        s: &Signals,
        wanted_mps2: f64,
        dt_s: f64,
    ) -> f64 {
        let law = axial_law(airframe, tuning, s, wanted_mps2, self.axial.value, dt_s);
        run(&mut self.axial, &law, 0.0, 1.0, dt_s)
    }

    /// Roll loop: aileron (rad) so that the roll rate about the direction of flight follows its reference (rad/s).
    pub fn roll(
        &mut self,
        airframe: &Airframe,
        tuning: &InnerTuning,
        s: &Signals,
        wanted_radps: f64,
        dt_s: f64,
    ) -> f64 {
        let law = roll_law(airframe, tuning, s, wanted_radps);
        let limit = airframe.servo.aileron_limit_rad;
        run(&mut self.roll, &law, -limit, limit, dt_s)
    }

    /// Sets the normal loop's memory so that its output is `elevator_rad` now.
    pub fn engage_normal(
        &mut self,
        airframe: &Airframe,
        tuning: &InnerTuning,
        s: &Signals,
        wanted_mps2: f64,
        elevator_rad: f64,
    ) {
        let limit = airframe.servo.elevator_limit_rad;
        let value = elevator_rad - normal_law(airframe, tuning, s, wanted_mps2).proportional;
        self.normal.value = value.clamp(-limit, limit);
    }

    /// Sets the lateral loop's memory so that its output is `rudder_rad` now, as far as its trim range goes.
    pub fn engage_lateral(
        &mut self,
        airframe: &Airframe,
        tuning: &InnerTuning,
        s: &Signals,
        wanted_mps2: f64,
        rudder_rad: f64,
    ) {
        let value = rudder_rad - lateral_law(airframe, tuning, s, wanted_mps2).proportional;
        self.lateral.value = value.clamp(-RUDDER_TRIM_LIMIT_RAD, RUDDER_TRIM_LIMIT_RAD);
    }

    /// Sets the axial loop's memory so that its output is `throttle` now.
    pub fn engage_axial(
        &mut self,
        airframe: &Airframe,
        tuning: &InnerTuning,
        s: &Signals,
        wanted_mps2: f64,
        throttle: f64,
    ) {
        let law = axial_law(airframe, tuning, s, wanted_mps2, throttle, 0.02);
        self.axial.value = (throttle - law.proportional).clamp(0.0, 1.0);
    }

    /// Moves the memories of the loops that are on by a share of what the actuators are off (rad, throttle 0 to 1).
    pub(super) fn shift(&mut self, airframe: &Airframe, on: &Channels, off: &ActuatorCommand, share: f64) {
        let servo = &airframe.servo;
        let loops = [
            (on.roll, &mut self.roll, off.aileron_rad, servo.aileron_limit_rad),
            (on.pitch, &mut self.normal, off.elevator_rad, servo.elevator_limit_rad),
            (on.yaw, &mut self.lateral, off.rudder_rad, servo.rudder_limit_rad),
            (on.thrust, &mut self.axial, off.throttle, 1.0),
        ];
        for (_, memory, off, limit) in loops.into_iter().filter(|(on, _, off, _)| *on && *off != 0.0) {
            memory.value = (memory.value + share * off).clamp(-limit, limit);
        }
    }

    /// Sets the roll loop's memory so that its output is `aileron_rad` now.
    pub fn engage_roll(
        &mut self,
        airframe: &Airframe,
        tuning: &InnerTuning,
        s: &Signals,
        wanted_radps: f64,
        aileron_rad: f64,
    ) {
        let limit = airframe.servo.aileron_limit_rad;
        let value = aileron_rad - roll_law(airframe, tuning, s, wanted_radps).proportional;
        self.roll.value = value.clamp(-limit, limit);
    }
}

fn run(integrator: &mut Integrator, law: &Law, low: f64, high: f64, dt_s: f64) -> f64 {
    let output = law.proportional + integrator.value;
    integrator.advance(law.integral_rate * dt_s, output, low, high);
    (law.proportional + integrator.value).clamp(low, high)
}

/// Gains of the normal loop, and what they were placed for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NormalGains {
    /// K_Q, rad per rad/s.
    pub pitch_rate: f64,
    /// K_C, rad per m/s².
    pub normal: f64,
    /// K_E, rad per m/s.
    pub integral: f64,
    /// N_C, rad per m/s².
    pub forward: f64,
    /// Short period that is kept, rad/s.
    pub frequency_radps: f64,
    /// Its damping.
    pub damping: f64,
    /// Pole of the integrator, rad/s.
    pub pole_radps: f64,
}

/// Gains of the lateral loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LateralGains {
    /// K_R, rad per rad/s, with the rudder's sign.
    pub yaw_rate: f64,
    /// K_B, rad per m/s, with the rudder's sign.
    pub integral: f64,
}

/// Gains of the axial loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AxialGains {
    /// K_A, per m/s².
    pub axial: f64,
    /// K_EA, per m/s.
    pub integral: f64,
    /// k_T: what full throttle is worth at this throttle and airspeed, m/s².
    pub slope_mps2: f64,
}

/// Gains of the roll loop, and what they were placed for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RollGains {
    /// K_P, rad per rad/s.
    pub roll_rate: f64,
    /// K_EP, rad per rad.
    pub integral: f64,
    /// N_P, rad per rad/s.
    pub forward: f64,
    /// Its two poles, rad/s.
    pub poles_radps: [f64; 2],
}

/// `δ = −K_Q (Q − Q_turn) − K_C (C + g) − K_E ∫(C − C_ref) + N_C (C_ref + g)` with the gains that give
/// `(s + p)(s² + 2ζω s + ω²)` to Ċ = −aC − aVQ, Q̇ = −m_α/(Va) C + m_q Q + m_δ δ.
fn normal_law(airframe: &Airframe, tuning: &InnerTuning, s: &Signals, wanted_mps2: f64) -> Law {
    let gains = normal_gains(airframe, tuning, s);
    let turn_rate = turn_pitch_rate(s);
    let proportional = -gains.pitch_rate * (s.pitch_rate_radps - turn_rate)
        - gains.normal * (s.normal_mps2 + GRAVITY_MPS2)
        + gains.forward * (wanted_mps2 + GRAVITY_MPS2);
    Law { proportional, integral_rate: -gains.integral * (s.normal_mps2 - wanted_mps2) }
}

/// The normal loop keeps the open loop's short period, but not beyond this part of its zeros: a third leaves room for servos and
/// delays.
const ZERO_SHARE: f64 = 3.0;

/// Pole of the normal loop's integrator without a pitch rate, rad/s.
const BLIND_POLE: f64 = 1.0;

/// How lift and pitching moment answer, at an airspeed and a density.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Pitching {
    /// Of the path to the incidence, 1/s.
    pub a: f64,
    /// Pitch acceleration per pitch rate, 1/s.
    pub m_q: f64,
    /// Per incidence, 1/s².
    pub m_alpha: f64,
    /// Per elevator, 1/s².
    pub m_delta: f64,
}

impl Pitching {
    pub(super) fn new(airframe: &Airframe, s: &Signals) -> Self {
        let (aero, mass, chord) = (&airframe.aerodynamics, &airframe.mass, airframe.geometry.mean_chord_m);
        let (force, v) = (s.pressure_force(airframe), s.airspeed_mps);
        let a = force * aero.lift_alpha / (mass.mass_kg * v);
        let per_rate = force * chord * chord / (2.0 * v * mass.inertia_yy_kgm2);
        let m_alpha_rate = per_rate * aero.pitch_alpha_rate;
        // C_mα̇ acts on α̇ = Q + (C + g)/V: damping as C_mq is, and some stiffness taken away.
        let m_q = per_rate * aero.pitch_pitch_rate + m_alpha_rate;
        let m_alpha = force * chord * aero.pitch_alpha / mass.inertia_yy_kgm2 - a * m_alpha_rate;
        let m_delta = force * chord * aero.pitch_elevator / mass.inertia_yy_kgm2;
        Self { a, m_q, m_alpha, m_delta }
    }
}

/// The normal loop's gains at an airspeed and a density.
pub fn normal_gains(airframe: &Airframe, tuning: &InnerTuning, s: &Signals) -> NormalGains {
    let (Pitching { a, m_q, m_alpha, m_delta }, v) = (Pitching::new(airframe, s), s.airspeed_mps);
    let natural = (-m_alpha - a * m_q).max(1.0).sqrt();
    if s.pitches_blind {
        let pole = BLIND_POLE.min(0.5 * natural);
        let integral = -pole * natural * natural / (v * a * m_delta);
        let damping = (a - m_q) / (2.0 * natural);
        let (pitch_rate, normal, forward) = (0.0, 0.0, 0.0);
        return NormalGains {
            pitch_rate,
            normal,
            integral,
            forward,
            frequency_radps: natural,
            damping,
            pole_radps: pole,
        };
    }
    let room = normal_zero_radps(airframe, s).map_or(f64::INFINITY, |zero| zero / ZERO_SHARE);
    let frequency = natural.min(room);
    let zeta = tuning.normal_damping.max((a - m_q) / (2.0 * frequency));
    let p = tuning.normal_pole.min(0.5 * frequency);
    let (alpha_2, alpha_1, alpha_0) = (
        p + 2.0 * zeta * frequency,
        frequency * frequency + 2.0 * zeta * frequency * p,
        p * frequency * frequency,
    );
    let k_q = (alpha_2 - a + m_q) / m_delta;
    let k_c = (a * (alpha_2 - a) - m_alpha - alpha_1) / (v * a * m_delta);
    let k_e = -alpha_0 / (v * a * m_delta);
    NormalGains {
        pitch_rate: k_q,
        normal: k_c,
        integral: k_e,
        forward: k_e / p,
        frequency_radps: frequency,
        damping: zeta,
        pole_radps: p,
    }
}

/// The zeros of the normal acceleration lie at plus and minus this, rad/s: the elevator first pushes the aircraft the wrong way,
/// which bounds how fast the loop can be made. None where the elevator's lift has no such effect.
pub fn normal_zero_radps(airframe: &Airframe, s: &Signals) -> Option<f64> {
    let (aero, chord) = (&airframe.aerodynamics, airframe.geometry.mean_chord_m);
    let neutral_m = -aero.pitch_alpha / aero.lift_alpha * chord;
    let tail_m = -aero.pitch_elevator / aero.lift_elevator * chord;
    let square = s.pressure_force(airframe) * aero.lift_alpha * (tail_m - neutral_m);
    let zero = (square / airframe.mass.inertia_yy_kgm2).sqrt();
    zero.is_finite().then_some(zero)
}

/// Pitch rate of a steady turn: (g/V) sin²φ / cos φ.
pub(super) fn turn_pitch_rate(s: &Signals) -> f64 {
    let (sin, cos) = s.bank_rad.sin_cos();
    GRAVITY_MPS2 / s.airspeed_mps * sin * sin / cos.max(0.3)
}

/// Yaw damper on the deviation from the coordinated turn, and trim. Signs follow C_nδr: the rudder that yaws left
/// when positive (negative derivative) is moved the other way. Steady sideslip from rudder is −C_nδr/C_nβ δ and
/// gives side force of the sign of C_Yβ, so the trim must take the sign of −C_nδr to drive B to zero.
fn lateral_law(airframe: &Airframe, tuning: &InnerTuning, s: &Signals, wanted_mps2: f64) -> Law {
    let gains = lateral_gains(airframe, tuning, s);
    let turn = GRAVITY_MPS2 / s.airspeed_mps * s.bank_rad.sin() * s.pitch_rad.cos();
    let rate = -gains.integral * (s.lateral_mps2 - wanted_mps2);
    Law { proportional: -gains.yaw_rate * (s.yaw_rate_radps - turn), integral_rate: rate }
}

/// The lateral loop's gains at an airspeed and a density.
pub fn lateral_gains(airframe: &Airframe, tuning: &InnerTuning, s: &Signals) -> LateralGains {
    let (aero, span) = (&airframe.aerodynamics, airframe.geometry.wing_span_m);
    let (force, inertia) = (s.pressure_force(airframe), airframe.mass.inertia_zz_kgm2);
    let n_beta = (force * span * aero.yaw_beta / inertia).max(0.0);
    let n_r = force * span * span * aero.yaw_yaw_rate / (2.0 * s.airspeed_mps * inertia);
    let n_delta = force * span * aero.yaw_rudder / inertia;
    if !airframe.has_rudder() {
        return LateralGains { yaw_rate: 0.0, integral: 0.0 };
    }
    let damping = (2.0 * tuning.yaw_damping * n_beta.sqrt() + n_r).max(0.0);
    let k_r = (damping / n_delta.abs()).min(0.6) * n_delta.signum();
    LateralGains { yaw_rate: k_r, integral: tuning.lateral_gain * n_delta.signum() }
}

/// Throttle: `δ = −K_A A − K_EA ∫(A − A_ref) + 0.6 A_ref/k_T`. A lag too short to need K_A leaves a first-order loop,
/// whose bandwidth is then ω/2ζ.
fn axial_law(
    airframe: &Airframe,
    tuning: &InnerTuning,
    s: &Signals,
    wanted_mps2: f64,
    throttle: f64,
    dt_s: f64,
) -> Law {
    let gains = axial_gains(airframe, tuning, s, throttle, dt_s);
    let proportional = -gains.axial * s.axial_mps2 + 0.6 * wanted_mps2 / gains.slope_mps2;
    Law { proportional, integral_rate: -gains.integral * (s.axial_mps2 - wanted_mps2) }
}

/// The axial loop's gains about a throttle, for steps of `dt_s` seconds.
pub fn axial_gains(
    airframe: &Airframe,
    tuning: &InnerTuning,
    s: &Signals,
    throttle: f64,
    dt_s: f64,
) -> AxialGains {
    let slope_mps2 = airframe.thrust_slope_mps2(throttle, s.airspeed_mps, s.density_kgpm3);
    let lag = airframe.thrust_lag_s() + airframe.servo.delay_s + 1.5 * dt_s;
    let (omega, zeta) = (tuning.axial_bandwidth, tuning.axial_damping);
    let axial = ((2.0 * zeta * omega * lag - 1.0) / slope_mps2).max(0.0);
    let integral = (lag * omega * omega).max(0.5 * omega / zeta) / slope_mps2;
    AxialGains { axial, integral, slope_mps2 }
}

/// `δ = −K_P P − K_EP ∫(P − P_ref) + N_P P_ref` with poles ω₁ and p.
fn roll_law(airframe: &Airframe, tuning: &InnerTuning, s: &Signals, wanted_radps: f64) -> Law {
    let gains = roll_gains(airframe, tuning, s);
    let proportional = -gains.roll_rate * s.roll_rate_radps + gains.forward * wanted_radps;
    Law { proportional, integral_rate: -gains.integral * (s.roll_rate_radps - wanted_radps) }
}

/// The roll loop's gains at an airspeed and a density.
pub fn roll_gains(airframe: &Airframe, tuning: &InnerTuning, s: &Signals) -> RollGains {
    let (aero, span) = (&airframe.aerodynamics, airframe.geometry.wing_span_m);
    let (force, inertia) = (s.pressure_force(airframe), airframe.mass.inertia_xx_kgm2);
    let l_p = -roll_damping_per_s(airframe, s);
    let l_delta = force * span * aero.roll_aileron / inertia;
    let fast = tuning.roll_fast_pole.max(-l_p);
    let p = tuning.roll_pole;
    let integral = fast * p / l_delta;
    RollGains {
        roll_rate: (fast + p + l_p) / l_delta,
        integral,
        forward: integral / p,
        poles_radps: [fast, p],
    }
}

/// How fast a roll dies by itself, 1/s.
pub(super) fn roll_damping_per_s(airframe: &Airframe, s: &Signals) -> f64 {
    let (span, inertia) = (airframe.geometry.wing_span_m, airframe.mass.inertia_xx_kgm2);
    let force = s.pressure_force(airframe);
    -force * span * span * airframe.aerodynamics.roll_roll_rate / (2.0 * s.airspeed_mps * inertia)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::airframe::tests::aerosonde;

    fn level() -> Signals {
        Signals { airspeed_mps: 22.0, density_kgpm3: 1.2, normal_mps2: -GRAVITY_MPS2, ..Signals::default() }
    }

    /// Flies the normal loop on its own design model; returns C after `seconds` of asking for `wanted`.
    fn normal_response(wanted: f64, seconds: f64, dt: f64) -> (f64, f64) {
        let airframe = aerosonde();
        let mut s = level();
        let force = s.pressure_force(&airframe);
        let (aero, m, chord) = (airframe.aerodynamics, airframe.mass, airframe.geometry.mean_chord_m);
        let a = force * aero.lift_alpha / (m.mass_kg * s.airspeed_mps);
        let m_alpha = force * chord * aero.pitch_alpha / m.inertia_yy_kgm2;
        let m_q = force * chord * chord * aero.pitch_pitch_rate / (2.0 * s.airspeed_mps * m.inertia_yy_kgm2);
        let m_delta = force * chord * aero.pitch_elevator / m.inertia_yy_kgm2;
        let mut loops = InnerLoops::default();
        let mut peak: f64 = 0.0;
        for _ in 0..(seconds / dt) as usize {
            let elevator = loops.normal(&airframe, &InnerTuning::default(), &s, (wanted, -1.0), dt);
            for _ in 0..20 {
                let (h, c) = (dt / 20.0, s.normal_mps2 + GRAVITY_MPS2);
                let q_dot =
                    -m_alpha / (s.airspeed_mps * a) * c + m_q * s.pitch_rate_radps + m_delta * elevator;
                s.normal_mps2 += h * (-a * c - a * s.airspeed_mps * s.pitch_rate_radps);
                s.pitch_rate_radps += h * q_dot;
            }
            peak = peak.min(s.normal_mps2);
        }
        (s.normal_mps2, peak)
    }

    #[test]
    fn normal_acceleration_follows_without_much_overshoot() {
        for dt in [0.02, 0.04] {
            let (end, peak) = normal_response(-1.5 * GRAVITY_MPS2, 3.0, dt);
            assert!((end + 1.5 * GRAVITY_MPS2).abs() < 0.1, "dt {dt}: {end}");
            assert!(peak > -1.5 * GRAVITY_MPS2 - 0.2 * 0.5 * GRAVITY_MPS2, "dt {dt}: peak {peak}");
        }
    }

    #[test]
    fn roll_rate_follows_on_the_first_order_model() {
        let airframe = aerosonde();
        let mut s = level();
        let force = s.pressure_force(&airframe);
        let span = airframe.geometry.wing_span_m;
        let l_p = force * span * span * airframe.aerodynamics.roll_roll_rate
            / (44.0 * airframe.mass.inertia_xx_kgm2);
        let l_delta = force * span * airframe.aerodynamics.roll_aileron / airframe.mass.inertia_xx_kgm2;
        let mut loops = InnerLoops::default();
        for _ in 0..100 {
            let aileron = loops.roll(&airframe, &InnerTuning::default(), &s, 0.5, 0.02);
            for _ in 0..20 {
                s.roll_rate_radps += 0.001 * (l_p * s.roll_rate_radps + l_delta * aileron + 1.0);
            }
        }
        assert!((s.roll_rate_radps - 0.5).abs() < 0.01, "{}", s.roll_rate_radps);
    }

    #[test]
    fn throttle_removes_a_steady_axial_error_and_does_not_wind_up() {
        let airframe = aerosonde();
        let (mut loops, mut s, mut throttle) = (InnerLoops::default(), level(), 0.0);
        for _ in 0..3000 {
            s.axial_mps2 = -2.0;
            throttle = loops.axial(&airframe, &InnerTuning::default(), &s, 1.0, 0.02);
        }
        assert_eq!(throttle, 1.0);
        let mut frames = 0;
        while throttle > 0.9 {
            s.axial_mps2 = 2.0;
            throttle = loops.axial(&airframe, &InnerTuning::default(), &s, 0.0, 0.02);
            frames += 1;
        }
        assert!(frames < 50, "{frames}");
    }

    #[test]
    fn rudder_opposes_yaw_and_lateral_force_with_the_signs_of_the_airframe() {
        let airframe = aerosonde();
        let mut s = level();
        s.yaw_rate_radps = 0.2;
        let rudder = InnerLoops::default().lateral(&airframe, &InnerTuning::default(), &s, 0.0, 0.02);
        // Nose swings right; C_nδr < 0, so a positive rudder brings it back.
        assert!(rudder * airframe.aerodynamics.yaw_rudder < 0.0);
        s.yaw_rate_radps = 0.0;
        s.lateral_mps2 = -1.0;
        let mut loops = InnerLoops::default();
        let mut trim = 0.0;
        for _ in 0..1000 {
            trim = loops.lateral(&airframe, &InnerTuning::default(), &s, 0.0, 0.02);
        }
        // Force to the left is air from the right: the nose must go right.
        assert!(trim * airframe.aerodynamics.yaw_rudder > 0.0);
        assert!((trim.abs() - RUDDER_TRIM_LIMIT_RAD).abs() < 1e-3);
    }

    #[test]
    fn engagement_takes_over_where_the_actuators_are() {
        let airframe = aerosonde();
        let (tuning, mut s) = (InnerTuning::default(), level());
        s.pitch_rate_radps = 0.05;
        s.roll_rate_radps = 0.1;
        let mut loops = InnerLoops::default();
        loops.engage_normal(&airframe, &tuning, &s, -10.0, -0.21);
        loops.engage_roll(&airframe, &tuning, &s, 0.1, 0.03);
        loops.engage_axial(&airframe, &tuning, &s, 0.0, 0.8);
        assert!((loops.normal(&airframe, &tuning, &s, (-10.0, -1.0), 1e-9) + 0.21).abs() < 1e-6);
        assert!((loops.roll(&airframe, &tuning, &s, 0.1, 1e-9) - 0.03).abs() < 1e-6);
        assert!((loops.axial(&airframe, &tuning, &s, 0.0, 1e-9) - 0.8).abs() < 1e-6);
    }
}
