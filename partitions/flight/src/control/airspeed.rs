//! The airspeed that is flown on: the pitot's while it fits what the aircraft must be doing, else the one that its lift tells.
//!
//! Responsible for the verdict and for the airspeed in place of one that is not believed. It must never take turbulence for a
//! fault: both sides of the comparison are averaged over the same seconds and with the same weights.
//!
//! The specific force along the normal tells the lift, `L = 2 m |f| / (ρ S) = V² C_L`. The elevator tells its coefficient: the
//! pitching moment is zero on average, `α = −(C_m0 + C_mδ δe + C_mq q̂) / C_mα`, `C_L = C_L0 + C_Lα α + C_Lδ δe + C_Lq q̂`. What the
//! file of the airframe has wrong is a factor between the two airspeeds, which is learnt while they go together.

use crate::airframe::Airframe;
use crate::attitude::low_pass;
use crate::kept::kept;

/// Averaging of lift and coefficient for the verdict, s: a few short periods; and for flying on them, where gusts count.
const AVERAGE_S: f64 = 4.0;
const FLOWN_S: f64 = 1.5;
/// Where the elevator tells the lift badly it is averaged for longer, up to so many times. Measured is how much the airspeed moves
/// with the pitching moment; with so much of it an average is long enough.
const LONGEST: f64 = 3.0;
const EASY: f64 = 5.0;
/// What gusts leave of the pitching moment's coefficient in an average over [`AVERAGE_S`], in moderate turbulence; and how many of
/// these deviations are none of a fault.
const MOMENT: f64 = 0.0021;
const DEVIATIONS: f64 = 5.5;
/// Before so much flight with the elevator in these hands nothing is said, s.
const SETTLED_S: f64 = 6.0;
/// Share of the airspeed by which the two may differ: 2 m/s at 22.
const LIMIT: f64 = 0.09;
/// What the airframe file may have wrong before anything is learnt, as a share of the airspeed, and how long learning takes that away, s.
const DOUBT: f64 = 0.25;
const DOUBT_S: f64 = 20.0;
/// Memory of what was learnt, s.
const LEARNING_S: f64 = 60.0;
/// What the file may have wrong at another lift coefficient than that at which was learnt, as a share of the airspeed: for one that is 2.4
/// times as large, or as small.
const DOUBT_APART: f64 = 0.05;
/// Learnt factors beyond are no error of an airframe file.
const FACTORS: (f64, f64) = (0.7, 1.4);
/// Beyond the limit for so long, s, weighted by how far, it is not believed; within half of it for so long it is again.
const PATIENCE_S: f64 = 2.0;
const AGAIN_S: f64 = 30.0;
/// One that has moved away from the inertial values by this, m/s, or from satellites and wind by more than gusts explain, is judged by this
/// share of the limit: gusts move it so far for moments.
const APART_MPS: f64 = 5.0;
const APART_SHARE: f64 = 0.5;
/// So far away from satellites and wind it is not believed where lift tells nothing.
const FAR_AWAY: f64 = 1.6;
/// A difference weighs this much at most.
const HEAVIEST: f64 = 8.0;
/// Frames in a row in which a sensor that has noise tells the same number; and in which one that is silent tells none.
const FROZEN_FRAMES: u32 = 25;
const SILENT_FRAMES: u32 = 50;
/// Change from frame to frame, as a share of the airspeed, RMS over a second: three times what severe turbulence does.
const NOISY: f64 = 0.04;
/// No less than this share of the airspeed that lift tells is flown on, whatever the pitot says before the verdict: loops whose gains
/// are made for half of the airspeed are unstable. And where the inertial values say so, too.
const LEAST_SHARE: f64 = 0.6;
const LEAST_SHARE_APART: f64 = 0.85;
/// Least lift coefficient that does so clearly.
const CLEAR_LIFT: f64 = 0.15;
/// Least lift coefficient that says anything.
const LEAST_LIFT: f64 = 0.05;

/// What a frame brings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// Of the pitot, m/s.
    pub pitot_mps: Option<f64>,
    /// How far that has moved away from what the inertial values tell of the last seconds, m/s.
    pub apart_mps: f64,
    /// How far it has come away from velocity by satellites and wind: 1 where gusts do not explain it, negative where it tells too little.
    pub away: f64,
    /// What lift is to be learnt from while no pitot is believed, m/s.
    pub learnt_mps: Option<f64>,
    /// kg/m³.
    pub density_kgpm3: f64,
    /// rad.
    pub elevator_rad: f64,
    /// rad/s.
    pub pitch_rate_radps: f64,
    /// Normal specific acceleration, m/s²; −9.8 in level flight.
    pub normal_mps2: f64,
    /// Change of airspeed in steady air, A − g sin γ, m/s².
    pub change_mps2: f64,
    /// The autopilot moves the elevator, and wings carry the weight.
    pub flying: bool,
    /// What the pitot tells may be judged by that.
    pub judged: bool,
    /// s.
    pub dt_s: f64,
}

/// The judge of the pitot.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AirspeedWatch {
    /// Average of lift over ρ S m / 2, m²/s²; of its coefficient; and of the coefficient times the square of the pitot's airspeed.
    lift: f64,
    coefficient: f64,
    by_pitot: f64,
    /// Lift and coefficient as they are flown on.
    flown: [f64; 2],
    /// What change of airspeed these have not seen yet, m/s.
    recent_mps: f64,
    /// Time in the averages, s.
    seen_s: f64,
    /// Pitot over lift, learnt.
    factor: f64,
    /// And by how much more lift is taken while no pitot is believed.
    correction: f32,
    learnt_s: f64,
    /// Lift over the square of the pitot's airspeed, where that was learnt.
    learnt_at: f64,
    against_s: f64,
    for_s: f64,
    last_pa: f64,
    repeated: u32,
    jump2: f32,
    believed: bool,
}

impl Default for AirspeedWatch {
    fn default() -> Self {
        Self {
            lift: 0.0,
            coefficient: 0.0,
            by_pitot: 0.0,
            flown: [0.0; 2],
            recent_mps: 0.0,
            seen_s: 0.0,
            factor: 1.0,
            correction: 1.0,
            learnt_s: 0.0,
            learnt_at: 0.0,
            against_s: 0.0,
            for_s: 0.0,
            last_pa: 0.0,
            repeated: 0,
            jump2: 0.0,
            believed: true,
        }
    }
}

impl AirspeedWatch {
    /// Whether the pitot is believed.
    pub fn is_believed(&self) -> bool {
        self.believed && self.repeated < SILENT_FRAMES
    }

    /// The pitot has told for long enough what the airframe file has wrong.
    pub fn has_learnt(&self) -> bool {
        self.learnt_s > DOUBT_S
    }

    /// How many times the lift that is there the elevator tells, as far as that was learnt.
    pub fn elevator_factor(&self) -> f64 {
        if self.has_learnt() { self.factor * self.factor } else { 1.0 }
    }

    /// Share of the airspeed per coefficient of the pitching moment: half of what the lift coefficient makes of it.
    fn sensitivity(&self, airframe: &Airframe) -> f64 {
        let a = &airframe.aerodynamics;
        0.5 * (a.lift_alpha / a.pitch_alpha).abs() / self.coefficient.max(0.1)
    }

    /// How many times as long as usual is averaged.
    fn longer(&self, airframe: &Airframe) -> f64 {
        (self.sensitivity(airframe) / EASY).clamp(1.0, LONGEST)
    }

    /// Learns from another airspeed, m/s, while no pitot is believed: lift whose file is wrong tells less the faster the aircraft flies.
    fn learn(&mut self, airspeed_mps: f64, dt_s: f64) {
        if let Some(by_lift_mps) = self.by_lift_mps().filter(|mps| *mps > 0.0) {
            let correction = f64::from(self.correction);
            let wanted = correction * airspeed_mps / by_lift_mps;
            self.correction =
                low_pass(correction, wanted, LEARNING_S, dt_s).clamp(FACTORS.0, FACTORS.1) as f32;
        }
    }

    /// The airspeed that lift tells, as the pitot would read it, m/s; `None` before there was enough flight.
    pub fn by_lift_mps(&self) -> Option<f64> {
        self.by_lift_of(self.flown[1])
    }

    /// The same with another lift coefficient.
    fn by_lift_of(&self, coefficient: f64) -> Option<f64> {
        let settled = self.seen_s >= SETTLED_S && coefficient > LEAST_LIFT;
        let factor = self.factor * f64::from(self.correction);
        settled.then(|| factor * (self.flown[0] / coefficient).max(0.0).sqrt() + self.recent_mps)
    }

    /// Takes a frame; gives the airspeed to fly on: the pitot's or the lift's, `None` if there is neither.
    pub fn step(&mut self, airframe: &Airframe, frame: &Frame) -> Option<f64> {
        if frame.flying {
            self.average(airframe, frame);
        } else if self.believed {
            let Self { factor, learnt_s, learnt_at, repeated, .. } = *self;
            *self = Self { factor, learnt_s, learnt_at, repeated, ..Self::default() };
        }
        let pitot = frame.pitot_mps.filter(|mps| mps.is_finite());
        match pitot {
            Some(pitot_mps) if frame.flying && frame.judged => self.judge(airframe, pitot_mps, frame),
            Some(_) => self.repeated = 0,
            None if frame.flying => (self.repeated, self.last_pa) = (self.repeated.saturating_add(1), 0.0),
            None => {}
        }
        match frame.learnt_mps.filter(|_| frame.flying) {
            _ if self.is_believed() => self.correction = 1.0,
            Some(learnt_mps) => self.learn(learnt_mps, frame.dt_s),
            None => {}
        }
        self.flown_mps(frame.pitot_mps, frame.apart_mps)
    }

    /// The airspeed to fly on, m/s, with nothing judged. `apart_mps`: as in [`Frame`].
    pub fn flown_mps(&self, pitot_mps: Option<f64>, apart_mps: f64) -> Option<f64> {
        let (pitot, by_lift) = (pitot_mps.filter(|mps| mps.is_finite()), self.by_lift_mps());
        let share = if apart_mps < -APART_MPS { LEAST_SHARE_APART } else { LEAST_SHARE };
        // A coefficient that is small, and uncertain, stands for an airspeed that is no less.
        let least = self.by_lift_of(self.flown[1].max(CLEAR_LIFT)).filter(|_| self.has_learnt());
        let least_mps = least.map_or(0.0, |mps| share * mps);
        if self.believed { pitot.map(|mps| mps.max(least_mps)).or(by_lift) } else { by_lift }
    }

    /// The pitot is believed, and nothing speaks against it.
    pub fn is_sure(&self) -> bool {
        self.is_believed() && self.against_s == 0.0
    }

    fn average(&mut self, airframe: &Airframe, frame: &Frame) {
        let (a, g, dt_s) = (&airframe.aerodynamics, &airframe.geometry, frame.dt_s);
        let speed_mps = self.by_lift_mps().or(frame.pitot_mps).unwrap_or(20.0).max(5.0);
        let rate = frame.pitch_rate_radps * g.mean_chord_m / (2.0 * speed_mps);
        let moment = a.pitch_0 + a.pitch_elevator * frame.elevator_rad + a.pitch_pitch_rate * rate;
        let alpha_rad = -moment / a.pitch_alpha;
        let coefficient = a.lift_0
            + a.lift_alpha * alpha_rad
            + a.lift_elevator * frame.elevator_rad
            + a.lift_pitch_rate * rate;
        let lift = -2.0 * airframe.mass.mass_kg * frame.normal_mps2 / (frame.density_kgpm3 * g.wing_area_m2);
        if !(coefficient.is_finite() && lift.is_finite() && frame.change_mps2.is_finite()) {
            return;
        }
        self.seen_s += dt_s;
        // A mean at first, then one that forgets.
        let longer = self.longer(airframe);
        let memory_s = (longer * AVERAGE_S).min(self.seen_s);
        self.lift = low_pass(self.lift, lift, memory_s, dt_s);
        self.coefficient = low_pass(self.coefficient, coefficient, memory_s, dt_s);
        let flown_s = (longer * FLOWN_S).min(self.seen_s);
        let [flown_lift, flown_coefficient] = self.flown;
        self.flown = [
            low_pass(flown_lift, lift, flown_s, dt_s),
            low_pass(flown_coefficient, coefficient, flown_s, dt_s),
        ];
        let pitot_mps = frame.pitot_mps.filter(|mps| mps.is_finite()).unwrap_or(speed_mps);
        self.by_pitot = low_pass(self.by_pitot, coefficient * pitot_mps * pitot_mps, memory_s, dt_s);
        self.recent_mps += (frame.change_mps2 - self.recent_mps / flown_s) * dt_s;
    }

    fn judge(&mut self, airframe: &Airframe, pitot_mps: f64, frame: &Frame) {
        let dt_s = frame.dt_s;
        // The pressure is what a sensor repeats; the airspeed that it stands for moves with the density.
        let ram_pa = 0.5 * frame.density_kgpm3 * pitot_mps * pitot_mps;
        self.repeated = if (ram_pa - self.last_pa).abs() <= 1e-9 * ram_pa { self.repeated + 1 } else { 0 };
        let last_mps = (2.0 * self.last_pa / frame.density_kgpm3).sqrt();
        let jump = if last_mps > 0.0 { pitot_mps - last_mps } else { 0.0 };
        self.jump2 = low_pass(f64::from(self.jump2), jump * jump, 1.0, dt_s) as f32;
        self.last_pa = ram_pa;
        let Some(by_lift_mps) = self.by_lift_mps() else {
            // An aircraft that is fast has little lift to tell it by.
            if self.seen_s >= SETTLED_S && frame.away.abs() > FAR_AWAY {
                self.count(1.0, dt_s);
            }
            return;
        };
        let ratio = (self.by_pitot.max(0.0) / self.lift.max(1.0)).sqrt();
        let off = (ratio / self.factor - 1.0).abs();
        let gusts = MOMENT * self.sensitivity(airframe) / self.longer(airframe).sqrt();
        let at = self.lift / (pitot_mps * pitot_mps).max(1.0);
        let times = if self.learnt_at > 0.0 { (at / self.learnt_at).max(0.1) } else { 1.0 };
        let apart = (0.5 * (times - 1.0 / times)).abs().min(1.0);
        let limit = LIMIT.max(DEVIATIONS * gusts)
            + DOUBT * (1.0 - self.learnt_s / DOUBT_S).max(0.0)
            + DOUBT_APART * apart;
        if self.believed && off < 0.5 * limit {
            self.learnt_s += dt_s;
            let memory_s = self.learnt_s.min(LEARNING_S);
            self.factor = low_pass(self.factor, ratio, memory_s, dt_s).clamp(FACTORS.0, FACTORS.1);
            self.learnt_at = low_pass(self.learnt_at, at, memory_s, dt_s);
        }
        // Where lift and inertial values, or lift and satellites say so, less of it will do.
        let with = |apart: f64, least: f64| apart.abs() > least && (ratio > self.factor) == (apart > 0.0);
        let limit = if with(frame.apart_mps, APART_MPS) || with(frame.away, 1.0) {
            APART_SHARE * limit
        } else {
            limit
        };
        let broken = self.repeated >= FROZEN_FRAMES || f64::from(self.jump2).sqrt() > NOISY * by_lift_mps;
        self.for_s = if off < 0.5 * limit && !broken { self.for_s + dt_s } else { 0.0 };
        self.count(if off > limit { (off / limit).min(HEAVIEST) } else { -1.0 }, dt_s);
        if self.believed && broken {
            (self.believed, self.for_s) = (false, 0.0);
        } else if !self.believed && self.for_s >= AGAIN_S {
            (self.believed, self.against_s) = (true, 0.0);
        }
    }

    /// Counts what speaks against the pitot, by its weight; what is below zero speaks for it.
    fn count(&mut self, weight: f64, dt_s: f64) {
        self.against_s = (self.against_s + weight * dt_s).max(0.0);
        if self.believed && self.against_s >= PATIENCE_S {
            (self.believed, self.for_s) = (false, 0.0);
        }
    }
}

kept!(AirspeedWatch {
    lift: f64,
    coefficient: f64,
    by_pitot: f64,
    flown: [f64; 2],
    recent_mps: f64,
    seen_s: f64,
    factor: f64,
    correction: f32,
    learnt_s: f64,
    learnt_at: f64,
    against_s: f64,
    for_s: f64,
    last_pa: f64,
    repeated: u32,
    jump2: f32,
    believed: bool,
} if |watch| [watch.factor, f64::from(watch.correction)].iter().all(|x| (FACTORS.0..=FACTORS.1).contains(x)));

#[cfg(test)]
#[path = "airspeed_tests.rs"]
mod tests;
