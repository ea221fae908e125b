//! Where the aircraft is, how it lies and how it moves: an error-state extended Kalman filter.
//!
//! Responsible for one navigation state per frame from inertial samples, GPS, barometer, pitot and magnetometer,
//! and for finding that state again by itself after it was lost. It must never report a state it does not trust:
//! while it aligns, [`Estimator::state`] is `None`.
//!
//! Order within a frame: [`Estimator::predict`] first, then whatever measurements there are.

mod aiding;
mod alignment;
mod config;
#[cfg(test)]
mod consistency;
mod doubtful;
mod filter;
#[cfg(test)]
mod gates;
mod gusts;
mod health;
mod history;
mod path_watch;
mod snapshot;
mod static_watch;
#[cfg(test)]
mod world;

pub use config::{Aiding, EstimatorConfig, InitialSigmas, MeasurementNoise};
pub use filter::{ERROR_STATES, ProcessNoise};
pub use health::{Aid, Health, Innovations};
pub use snapshot::{Snapshot, TRIANGLE};

use crate::attitude;
use crate::kept::kept;
use aiding::{BarometerReference, Gate, Winds};
use alignment::{Aligned, Alignment};
use doubtful::Doubtful;
use filter::{ACCEL, ATT, ErrorVector, Filter, GYRO, MAG, Nominal, POS, VEL, WIND};
use gusts::Gusts;
use health::Record;
use history::{History, Past};
use nalgebra::{UnitQuaternion, Vector2, Vector3};
use path_watch::PathWatch;
use static_watch::StaticWatch;

/// An aid that was not taken for longer than this is not healthy, s.
const HEALTHY_WITHIN_S: f64 = 2.0;
/// A standard deviation of the velocity beyond this is not healthy on any axis, m/s.
const HEALTHY_VELOCITY_MPS: f64 = 0.5;
/// The same of the position, m.
const HEALTHY_POSITION_M: f64 = 5.0;

/// Inertial values as means over an interval.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuSample {
    /// End of the interval, s.
    pub time_s: f64,
    /// Length of the interval, s.
    pub interval_s: f64,
    /// Body, m/s².
    pub specific_force: Vector3<f64>,
    /// Body, rad/s.
    pub rates: Vector3<f64>,
}

/// One GPS fix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GpsMeasurement {
    /// When it was measured (not when it arrived), s.
    pub time_s: f64,
    /// NED from the runway, m.
    pub position_ned: Vector3<f64>,
    /// NED, m/s.
    pub velocity_ned: Vector3<f64>,
}

/// How to find the first state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Start {
    /// Standing or flying, as the measurements say.
    #[default]
    Auto,
    /// The aircraft stands on the runway.
    Ground,
    /// The aircraft flies, in any attitude.
    Flight,
}

/// Slow error of a satellite receiver's height, m, standard deviation: from the positions of satellites and the air between.
const SLOW_HEIGHT_ERROR_M: f64 = 5.0;

/// How far the state can be trusted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EstimatorStatus {
    /// Told to stop.
    Stopped,
    /// No state yet.
    Aligning,
    /// A state good enough to fly on, still improving.
    Converging,
    /// All aids at work and standard deviations small.
    Ready,
    /// No GPS for more than 2 s: position and velocity drift.
    Inertial,
}

/// What the estimator hands out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NavigationState {
    /// Time of the state, s.
    pub time_s: f64,
    /// NED from the runway, m; height from the barometer zeroed on the runway while pressure aiding is on.
    pub position: Vector3<f64>,
    /// NED, m/s.
    pub velocity: Vector3<f64>,
    /// Body to NED.
    pub quaternion: UnitQuaternion<f64>,
    /// Roll, pitch, yaw, rad.
    pub euler: Vector3<f64>,
    /// Body, bias taken off, rad/s.
    pub rates: Vector3<f64>,
    /// Body, bias taken off, m/s².
    pub specific_force: Vector3<f64>,
    /// Air over ground: north, east, m/s.
    pub wind: Vector2<f64>,
    /// Body, rad/s.
    pub gyro_bias: Vector3<f64>,
    /// Body, m/s².
    pub accel_bias: Vector3<f64>,
    /// Body, gauss.
    pub mag_bias: Vector3<f64>,
    /// Standard deviations of attitude error (NED axes, rad; the Controller gets roll, pitch and yaw), velocity (m/s), position (m).
    pub sigmas: StateSigmas,
    /// How far it can be trusted.
    pub status: EstimatorStatus,
}

/// Standard deviations, NED axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StateSigmas {
    /// Rotation error, rad.
    pub attitude: Vector3<f64>,
    /// m/s.
    pub velocity: Vector3<f64>,
    /// m.
    pub position: Vector3<f64>,
}

impl StateSigmas {
    /// Nothing is known.
    pub const UNKNOWN: Self = {
        let one = Vector3::new(1.0, 1.0, 1.0);
        Self { attitude: one, velocity: one, position: one }
    };
}

kept!(EstimatorStatus = Stopped | Aligning | Converging | Ready | Inertial);
kept!(NavigationState {
    time_s: f64,
    position: Vector3<f64>,
    velocity: Vector3<f64>,
    quaternion: UnitQuaternion<f64>,
    euler: Vector3<f64>,
    rates: Vector3<f64>,
    specific_force: Vector3<f64>,
    wind: Vector2<f64>,
    gyro_bias: Vector3<f64>,
    accel_bias: Vector3<f64>,
    status: EstimatorStatus;
    mag_bias = Vector3::zeros(), sigmas = StateSigmas::UNKNOWN
});

impl NavigationState {
    /// Velocity relative to the air, NED, m/s.
    pub fn air_velocity(&self) -> Vector3<f64> {
        self.velocity - Vector3::new(self.wind.x, self.wind.y, 0.0)
    }

    /// Height above the runway, m.
    pub fn altitude_m(&self) -> f64 {
        -self.position.z
    }
}

/// Counters for telemetry; they never go back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct EstimatorCounters {
    /// Measurements refused by a gate.
    pub refused: u32,
    /// States set anew because a measurement had been refused for too long.
    pub resets: u32,
    /// Alignments finished.
    pub alignments: u32,
    /// Inertial samples that were not finite, not newer, or beyond any sensor's range.
    pub bad_samples: u32,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Phase {
    Stopped,
    Aligning,
    Running,
}

/// The estimator. Plain data: it can be copied, and two that were fed the same are equal bit for bit.
#[derive(Debug, Clone, Copy)]
pub struct Estimator {
    config: EstimatorConfig,
    phase: Phase,
    start: Start,
    filter: Filter,
    history: History,
    alignment: Alignment,
    /// Biases, wind and barometer reference survive a new alignment, with their standard deviations.
    slow_known: bool,
    barometer: BarometerReference,
    gps_gate: Gate,
    barometer_gate: Gate,
    /// What it told when that began while there were no satellites, m.
    refused_from_m: f64,
    airspeed_gate: Gate,
    magnetometer_gate: Gate,
    last_sample: Option<ImuSample>,
    last_gps_s: f64,
    last_gps_reset_s: f64,
    last_magnetometer_s: f64,
    last_pitot_s: f64,
    last_airspeed_mps: Option<f64>,
    pitot_believed: bool,
    winds: Winds,
    gusts: Gusts,
    /// Time and innovation of the magnetic field before, body, gauss, where it was taken.
    field_off: Option<(f64, Vector3<f64>)>,
    /// When it last told that a gyroscope shifted, s, and whether that was followed since the satellites were lost.
    turned_s: f64,
    turn_followed: bool,
    static_watch: StaticWatch,
    path_watch: PathWatch,
    doubtful: Doubtful,
    standing: bool,
    aligned_s: f64,
    counters: EstimatorCounters,
    record: Record,
}

impl Estimator {
    /// A new estimator; it begins with [`Start::Auto`].
    pub fn new(config: EstimatorConfig) -> Self {
        let sigmas = initial_sigmas(&config.initial);
        Self {
            config,
            phase: Phase::Aligning,
            start: Start::Auto,
            filter: Filter::new(Nominal::default(), &sigmas),
            history: History::new(),
            alignment: Alignment::new(),
            slow_known: false,
            barometer: BarometerReference::default(),
            gps_gate: Gate::default(),
            barometer_gate: Gate::default(),
            refused_from_m: 0.0,
            airspeed_gate: Gate::default(),
            magnetometer_gate: Gate::default(),
            last_sample: None,
            last_gps_s: f64::NEG_INFINITY,
            last_gps_reset_s: f64::NEG_INFINITY,
            last_magnetometer_s: f64::NEG_INFINITY,
            last_pitot_s: f64::NEG_INFINITY,
            last_airspeed_mps: None,
            pitot_believed: true,
            winds: Winds::default(),
            gusts: Gusts::default(),
            field_off: None,
            turned_s: f64::NEG_INFINITY,
            turn_followed: false,
            static_watch: StaticWatch::default(),
            path_watch: PathWatch::default(),
            doubtful: Doubtful::default(),
            standing: false,
            aligned_s: f64::NEG_INFINITY,
            counters: EstimatorCounters::default(),
            record: Record::default(),
        }
    }

    /// Forgets everything and finds the state anew; [`Start::Ground`] is the "initialise" of the ground station.
    pub fn initialise(&mut self, start: Start) {
        *self = Self { start, counters: self.counters, record: self.record, ..Self::new(self.config) };
    }

    /// Stops giving out a state until [`Estimator::initialise`].
    pub fn stop(&mut self) {
        self.phase = Phase::Stopped;
    }

    /// What is fused.
    pub fn aiding(&self) -> Aiding {
        self.config.aiding
    }

    /// Chooses what is fused from now on.
    pub fn set_aiding(&mut self, aiding: Aiding) {
        self.config.aiding = aiding;
    }

    /// Continues from a snapshot: wholly if it is at most `longest_gap_s` old at `now_s`, otherwise with its
    /// biases, wind and barometer reference only, the rest being found in flight. False if it is not usable.
    pub fn warm_start(&mut self, snapshot: &Snapshot, now_s: f64) -> bool {
        let Some(filter) = snapshot.usable().then(|| snapshot.filter()).flatten() else { return false };
        self.initialise(Start::Auto);
        self.filter = filter;
        self.slow_known = true;
        self.barometer = BarometerReference::known(snapshot.barometer_offset());
        let age = now_s - snapshot.time_s;
        if !(0.0..=self.config.longest_gap_s).contains(&age) {
            return true;
        }
        // The gap is bridged by the first sample as if it had stood for all of it; the doubt grows with the gap.
        self.phase = Phase::Running;
        self.aligned_s = snapshot.time_s;
        self.filter.widen(ATT, 3, 0.3 * age);
        self.filter.widen(VEL, 3, 5.0 * age);
        self.filter.widen(POS, 3, 5.0 * age);
        self.last_sample = Some(ImuSample {
            time_s: snapshot.time_s,
            interval_s: 0.0,
            specific_force: Vector3::zeros(),
            rates: Vector3::zeros(),
        });
        self.last_gps_s = snapshot.time_s;
        true
    }

    /// What to keep in retained memory; `None` while there is no state.
    pub fn snapshot(&self) -> Option<Snapshot> {
        let time_s = self.last_sample?.time_s;
        (self.phase == Phase::Running)
            .then(|| Snapshot::of(&self.filter, time_s, self.barometer.settled_offset()))
    }

    /// Counters for telemetry.
    pub fn counters(&self) -> EstimatorCounters {
        self.counters
    }

    /// The innovations of one aid so far.
    pub fn innovations(&self, aid: Aid) -> &Innovations {
        self.record.of(aid)
    }

    /// What is healthy now; nothing without a state.
    pub fn health(&self) -> Health {
        if self.phase != Phase::Running {
            return Health::default();
        }
        let (now_s, within_s) = (self.now().time_s, HEALTHY_WITHIN_S);
        let fresh = |aid: Aid| self.record.fresh(aid, now_s, within_s);
        let worst = |at: usize| (at..at + 3).map(|i| self.filter.sigma(i)).fold(0.0, f64::max);
        let bits = [
            (Health::GPS, fresh(Aid::GpsVelocity) && fresh(Aid::GpsPosition)),
            (Health::BAROMETER, fresh(Aid::Barometer)),
            (Health::PITOT, fresh(Aid::Airspeed)),
            (Health::MAGNETOMETER, fresh(Aid::Magnetometer)),
            (Health::ATTITUDE, self.attitude_settled()),
            (Health::VELOCITY, worst(VEL) < HEALTHY_VELOCITY_MPS),
            (Health::POSITION, worst(POS) < HEALTHY_POSITION_M),
        ];
        Health(bits.iter().filter(|(_, good)| *good).fold(0, |all, (bit, _)| all | bit))
    }

    /// Pressure altitude of the runway as the estimator took it, m, once known.
    pub fn barometer_offset_m(&self) -> Option<f64> {
        self.barometer.settled_offset()
    }

    /// Carries the state to the end of a sample's interval. Call once per frame, before the measurements.
    pub fn predict(&mut self, sample: &ImuSample) {
        if self.phase == Phase::Stopped {
            return;
        }
        let Some(dt_s) = self.step_length(sample) else {
            self.counters.bad_samples += 1;
            return;
        };
        if dt_s > self.config.longest_gap_s {
            self.lose_state();
        }
        if self.phase == Phase::Running {
            let sample = &self.replaced(sample, dt_s);
            self.last_sample = Some(*sample);
            self.filter.propagate(&sample.rates, &sample.specific_force, dt_s, &self.process());
            if !self.filter.healthy() {
                self.initialise(Start::Auto);
                return;
            }
            self.history.push(self.now());
            self.winds.note(sample.time_s, &self.filter.nominal.wind, self.gusts.learnt());
        } else {
            self.last_sample = Some(*sample);
            self.align(&self.unturned(sample), dt_s.min(sample.interval_s.max(1e-3)).max(dt_s.min(0.1)));
        }
    }

    /// Time covered by a sample, s: from the last sample to this one, so that a lost frame is bridged.
    fn step_length(&self, sample: &ImuSample) -> Option<f64> {
        let sane = attitude::finite(&sample.rates)
            && attitude::finite(&sample.specific_force)
            && sample.time_s.is_finite()
            && sample.rates.norm() < 50.0
            && sample.specific_force.norm() < 500.0;
        let dt_s = self.last_sample.map_or(sample.interval_s, |last| sample.time_s - last.time_s);
        (sane && dt_s > 1e-6).then_some(dt_s)
    }

    /// Gives up attitude, velocity and position, keeps biases, wind and barometer reference.
    fn lose_state(&mut self) {
        if self.phase == Phase::Running {
            self.slow_known = true;
            self.phase = Phase::Aligning;
            self.counters.resets += 1;
        }
        self.start = Start::Auto;
        self.standing = false;
        self.alignment = Alignment::new();
        self.history.clear();
    }

    fn align(&mut self, sample: &ImuSample, dt_s: f64) {
        let known = self.filter.nominal;
        let corrected = ImuSample {
            rates: sample.rates - known.gyro_bias,
            specific_force: sample.specific_force - known.accel_bias,
            ..*sample
        };
        self.alignment.add_imu(&corrected, dt_s);
        if let Some((aligned, standing)) = self.try_alignment() {
            self.begin(&aligned, standing);
        } else if self.alignment.age_s() > 10.0 {
            // Old integrals only collect gyroscope bias.
            self.alignment = Alignment::new();
        }
    }

    fn try_alignment(&self) -> Option<(Aligned, bool)> {
        let field = &self.config.field_ned_gauss;
        let fix_speed = self.alignment.last_fix().map(|fix| fix.velocity_ned.norm());
        // Wind blows into the pitot of a parked aircraft too, so a fix has the first word.
        let by_air = self.last_airspeed_mps.is_some_and(|v| v > 10.0);
        let flying = fix_speed.map_or(by_air, |v| v > 5.0);
        let age = self.alignment.age_s();
        let ground = || {
            let calm = self.alignment.still() && age >= 1.0;
            calm.then(|| self.alignment.on_ground(field)).flatten().map(|aligned| (aligned, true))
        };
        let flight = || {
            let wind = Vector3::new(self.filter.nominal.wind.x, self.filter.nominal.wind.y, 0.0);
            let sigma = if self.slow_known { 2.0 } else { self.config.initial.wind };
            self.alignment.in_flight(field, &wind, sigma, self.config.incidence_rad).map(|a| (a, false))
        };
        match self.start {
            Start::Ground => ground(),
            Start::Flight => flight(),
            Start::Auto if flying => flight(),
            Start::Auto if fix_speed.is_some() || age > 5.0 => ground(),
            Start::Auto => None,
        }
    }

    /// Takes up the filter with what the alignment found.
    fn begin(&mut self, aligned: &Aligned, standing: bool) {
        let slow = self.filter;
        let mut sigmas = initial_sigmas(&self.config.initial);
        if standing {
            sigmas.fixed_rows_mut::<3>(GYRO).fill(self.config.initial.gyro_bias_ground);
        }
        let mut nominal = slow.nominal;
        nominal.attitude = aligned.attitude;
        nominal.velocity = aligned.velocity;
        nominal.position = aligned.position;
        if standing {
            nominal.gyro_bias += aligned.mean_rates;
            nominal.position.z = -self.config.standing_height_m;
        }
        if !standing && !self.slow_known {
            self.barometer.restart();
        }
        if !standing && self.barometer_carries() {
            // The height found is the receiver's, many metres off; the barometer shall pull it back at once.
            sigmas[POS + 2] = self.config.measurement.gps_vertical_with_barometer_m;
        }
        self.filter = Filter::new(nominal, &sigmas);
        if self.slow_known {
            for (at, count) in [(GYRO, 3), (ACCEL, 3), (MAG, 3), (WIND, 2)] {
                for i in at..at + count {
                    self.filter.covariance[(i, i)] = (4.0 * slow.covariance[(i, i)]).max(1e-10);
                }
            }
        }
        self.filter.covariance.fixed_view_mut::<3, 3>(ATT, ATT).copy_from(&(aligned.covariance * 2.0));
        self.phase = Phase::Running;
        self.standing = standing;
        self.counters.alignments += 1;
        self.history.clear();
        self.history.push(self.now());
        self.clear_gates();
        let time_s = self.now().time_s;
        self.aligned_s = time_s;
        self.last_gps_s = time_s;
    }

    fn clear_gates(&mut self) {
        self.gps_gate = Gate::default();
        self.barometer_gate = Gate::default();
        self.airspeed_gate = Gate::default();
        self.magnetometer_gate = Gate::default();
        self.gusts.go_back(self.gusts.learnt());
        (self.field_off, self.turned_s) = (None, f64::NEG_INFINITY);
    }

    fn now(&self) -> Past {
        Past {
            time_s: self.last_sample.map_or(f64::NEG_INFINITY, |sample| sample.time_s),
            velocity: self.filter.nominal.velocity,
            position: self.filter.nominal.position,
            velocity_noise: self.filter.velocity_noise,
        }
    }

    /// Moves a collected correction into the state and its history.
    fn finish_update(&mut self) {
        let before = self.now();
        let rotation = self.filter.nominal.attitude.to_rotation_matrix().into_inner();
        let error = self.filter.inject();
        self.history.correct(&before, &error, &rotation);
    }

    /// The present state; `None` while stopped or aligning.
    pub fn state(&self) -> Option<NavigationState> {
        let sample = self.last_sample.filter(|_| self.phase == Phase::Running)?;
        let n = &self.filter.nominal;
        let sigma = |at: usize| Vector3::from_fn(|i, _| self.filter.sigma(at + i));
        let mut position = sigma(POS);
        if !self.config.aiding.pressure || !self.barometer_carries() {
            // The filter knows the noise of the receiver's heights alone.
            position.z = Vector2::new(position.z, SLOW_HEIGHT_ERROR_M).norm();
        }
        Some(NavigationState {
            time_s: sample.time_s,
            position: n.position,
            velocity: n.velocity,
            quaternion: n.attitude,
            euler: attitude::euler(&n.attitude),
            rates: sample.rates - n.gyro_bias,
            specific_force: sample.specific_force - n.accel_bias,
            wind: n.wind,
            gyro_bias: n.gyro_bias,
            accel_bias: n.accel_bias,
            mag_bias: n.mag_bias,
            sigmas: StateSigmas { attitude: sigma(ATT), velocity: sigma(VEL), position },
            status: self.status(),
        })
    }

    /// How far the state can be trusted now.
    pub fn status(&self) -> EstimatorStatus {
        match self.phase {
            Phase::Stopped => EstimatorStatus::Stopped,
            Phase::Aligning => EstimatorStatus::Aligning,
            Phase::Running if self.now().time_s - self.last_gps_s > 2.0 => EstimatorStatus::Inertial,
            Phase::Running if self.attitude_settled() => EstimatorStatus::Ready,
            Phase::Running => EstimatorStatus::Converging,
        }
    }

    fn attitude_settled(&self) -> bool {
        let tilt = self.filter.sigma(ATT).max(self.filter.sigma(ATT + 1));
        // On the ground the accelerometer bias hides 3° of tilt; that is as good as it gets there.
        let limit = if self.standing { 0.08 } else { 0.035 };
        tilt < limit && self.filter.sigma(ATT + 2) < 0.15
    }
}

fn initial_sigmas(initial: &InitialSigmas) -> ErrorVector {
    let mut sigmas = ErrorVector::repeat(0.1);
    let mut set = |at: usize, count: usize, value: f64| sigmas.rows_mut(at, count).fill(value);
    set(VEL, 3, initial.velocity_mps);
    set(POS, 3, initial.position_m);
    set(GYRO, 3, initial.gyro_bias_flight);
    set(ACCEL, 3, initial.accel_bias);
    set(MAG, 3, initial.mag_bias);
    set(WIND, 2, initial.wind);
    sigmas
}
