//! The measurements: how each looks at the state, when it is refused, and what happens if that lasts.

use super::filter::{ACCEL, ATT, ErrorVector, GYRO, MAG, POS, ProcessNoise, Scalar, VEL, WIND};
use super::gusts::Part;
use super::health::Aid;
use super::history::{Past, position_row, scalar, velocity_row};
use super::path_watch::Heights;
use super::static_watch::Fix;
use super::{Estimator, EstimatorStatus, GpsMeasurement, Phase};
use crate::atmosphere::{airspeed_mps, density_kgpm3, pressure_altitude_m};
use crate::attitude::{finite, skew};
use nalgebra::{Vector2, Vector3};

/// Barometer samples averaged before their mean becomes the reference: 2 s at 25 Hz leave 0.12 m of noise.
const REFERENCE_SAMPLES: u32 = 50;
/// As few will do when the aircraft leaves the ground with no more: 0.2 m of noise, where the receiver's height is many
/// metres off.
const FEWEST_REFERENCE_SAMPLES: u32 = 10;
/// Samples over which the reference is refined while standing; more would make it deaf to the weather.
const LONGEST_REFERENCE_SAMPLES: u32 = 1500;
/// Two GPS resets within this time, s: the attitude is to blame, so everything is found anew.
const GPS_RESET_MEMORY_S: f64 = 6.0;
/// What the gyroscope's bias may be off then, rad/s, and the attitude where the magnetometer tells it first, rad.
const UNTOLD_RATE_RADPS: f64 = 0.03;
const UNTOLD_TURN_RAD: f64 = 0.05;
/// A field that comes away by less than this share of what it is off, within this time, s, does not leap; one of which less than this share is a
/// change of its size has turned.
const TURNING_SHARE: f64 = 0.6;
const STEP_S: f64 = 0.3;
const GROWN_SHARE: f64 = 0.35;
/// Satellites mend that. When they are lost this shortly after it, s, the field does.
const TURN_KNOWN_S: f64 = 6.0;
/// A magnetometer that was not taken for so long, s, does not carry the heading.
const HEADING_WITHIN_S: f64 = 2.0;
/// Faster than this over ground, m/s, the aircraft no longer stands.
const STANDING_SPEED_MPS: f64 = 3.0;

/// Remembers since when a measurement has been refused.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Gate {
    refused_since: Option<f64>,
}

impl Gate {
    /// Notes the verdict; true when refusal has lasted longer than the patience (and the count starts anew).
    fn out_of_patience(&mut self, accepted: bool, now_s: f64, patience_s: f64) -> bool {
        if accepted {
            self.refused_since = None;
            return false;
        }
        let since = *self.refused_since.get_or_insert(now_s);
        let lost = now_s - since >= patience_s;
        if lost {
            self.refused_since = None;
        }
        lost
    }
}

/// Pressure altitude of the runway: measured there, remembered, or set against GPS in flight.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct BarometerReference {
    offset_m: f64,
    samples: u32,
    sum_m: f64,
    summed: u32,
    last_s: Option<f64>,
}

impl BarometerReference {
    pub(super) fn known(offset_m: Option<f64>) -> Self {
        let samples = if offset_m.is_some() { REFERENCE_SAMPLES } else { 0 };
        Self { offset_m: offset_m.unwrap_or(0.0), samples, ..Self::default() }
    }

    pub(super) fn settled_offset(&self) -> Option<f64> {
        (self.samples >= REFERENCE_SAMPLES).then_some(self.offset_m)
    }

    /// Forgets a reference that was taken while the attitude was sought.
    pub(super) fn restart(&mut self) {
        *self = Self { last_s: self.last_s, ..Self::default() };
    }

    /// The aircraft moves: what was learnt standing holds, if it was enough.
    fn leave_ground(&mut self) {
        if self.samples >= FEWEST_REFERENCE_SAMPLES {
            self.samples = self.samples.max(REFERENCE_SAMPLES);
        }
    }

    fn learn(&mut self, offset_m: f64) {
        self.samples += 1;
        self.offset_m += (offset_m - self.offset_m) / f64::from(self.samples.min(LONGEST_REFERENCE_SAMPLES));
    }

    /// Averages what comes in; gives the mean once per interval.
    fn decimate(&mut self, time_s: f64, altitude_m: f64, interval_s: f64) -> Option<f64> {
        self.sum_m += altitude_m;
        self.summed += 1;
        let due = self.last_s.is_none_or(|last| time_s - last > interval_s - 1e-3);
        due.then(|| {
            let mean = self.sum_m / f64::from(self.summed);
            (self.sum_m, self.summed, self.last_s) = (0.0, 0, Some(time_s));
            mean
        })
    }
}

/// Seconds for which winds are remembered: a pitot that is found to be wrong has been so for some.
const WINDS: usize = 16;
/// What the height may be off when a barometer is found to be wrong, m.
const UNTOLD_HEIGHT_M: f64 = 2.0;
/// A barometer that has moved by this while it was refused is not blocked, m.
const ALIVE_M: f64 = 1.5;
/// A fix taken no longer ago than this tells how the air comes, s.
const LEARN_WITHIN_S: f64 = 0.5;
/// Gusts where a pitot that was wrong may not have told them, m/s.
const UNLEARNT_GUSTS_MPS: f64 = 1.0;
/// How far the airspeed without a pitot is from the one before the outage, m/s.
const UNTOLD_AIRSPEED_MPS: f64 = 3.0;
/// What the sink rate and the accelerometers may be off, m/s and m/s², when the height has come away from the barometer.
const UNTOLD_SINK_MPS: f64 = 3.0;
const UNTOLD_ACCELERATION_MPS2: f64 = 0.5;
/// What the wind may have become since, m/s, and the share of its process noise while nothing tells it.
const WIND_SINCE_MPS: f64 = 1.0;
const UNTOLD_WIND_SHARE: f64 = 0.1;

/// The wind of the last seconds, m/s, and what was learnt of its gusts, the oldest first.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Winds {
    past: [(Vector2<f64>, f64); WINDS],
    count: usize,
    last_s: f64,
}

impl Winds {
    pub(super) fn note(&mut self, time_s: f64, wind: &Vector2<f64>, gusts: f64) {
        if self.count > 0 && (time_s - self.last_s).abs() < 1.0 {
            return;
        }
        if self.count == WINDS {
            self.past.rotate_left(1);
        }
        self.count = (self.count + 1).min(WINDS);
        (self.past[self.count - 1], self.last_s) = ((*wind, gusts), time_s);
    }

    fn oldest(&self) -> Option<(Vector2<f64>, f64)> {
        (self.count > 0).then_some(self.past[0])
    }
}

impl Estimator {
    /// Takes the pitot's airspeed or leaves it; from the moment on in which it is not believed any more, the wind is that of a
    /// quarter of a minute before and stays about so.
    pub fn believe_pitot(&mut self, believed: bool) {
        let before = std::mem::replace(&mut self.pitot_believed, believed);
        if believed && !before {
            self.last_airspeed_mps = None;
        }
        if let Some((wind, gusts)) = self.winds.oldest().filter(|_| before && !believed) {
            self.gusts.go_back(gusts);
            self.filter.nominal.wind = wind;
            self.filter.forget(WIND, 2, WIND_SINCE_MPS);
        }
    }

    /// What drives the errors just now.
    pub(super) fn process(&self) -> ProcessNoise {
        let process = self.config.process;
        // Without a pitot nothing tells the wind, without satellites it is what tells the velocity.
        let told = self.pitot_believed && self.status() != EstimatorStatus::Inertial;
        let share = if told { 1.0 } else { UNTOLD_WIND_SHARE };
        self.doubting(ProcessNoise { wind: share * process.wind, ..process })
    }

    /// Fuses a fix at its measurement time.
    pub fn update_gps(&mut self, measurement: &GpsMeasurement) {
        let whole = finite(&measurement.position_ned) && finite(&measurement.velocity_ned);
        if !whole || !measurement.time_s.is_finite() || !self.config.aiding.gps {
            return;
        }
        let time_s = measurement.time_s - self.config.gps_extra_latency_s;
        let fix = GpsMeasurement { time_s, ..*measurement };
        match self.phase {
            Phase::Stopped => {}
            Phase::Aligning => self.alignment.add_gps(&fix),
            Phase::Running => self.fuse_gps(&fix),
        }
    }

    fn fuse_gps(&mut self, fix: &GpsMeasurement) {
        let Some(past) = self.history.at(fix.time_s) else { return };
        let now = self.now();
        self.last_gps_s = now.time_s;
        if self.standing && fix.velocity_ned.norm() > STANDING_SPEED_MPS {
            self.standing = false;
            self.barometer.leave_ground();
        }
        if !self.standing {
            self.static_watch.fix(Fix {
                time_s: fix.time_s,
                height_m: -fix.position_ned.z,
                down_mps: fix.velocity_ned.z,
            });
        }
        let velocity = self.velocity_scalars(fix, &past);
        let position = self.position_scalars(fix, &past);
        let accepted = self.fuse(Aid::GpsVelocity, &velocity) & self.fuse(Aid::GpsPosition, &position);
        let patience = self.config.measurement.gps_patience_s;
        if self.gps_gate.out_of_patience(accepted, now.time_s, patience) {
            self.reset_to_fix(fix, &past);
        }
    }

    fn velocity_scalars(&self, fix: &GpsMeasurement, past: &Past) -> [Scalar; 3] {
        let rotation = self.filter.nominal.attitude.to_rotation_matrix().into_inner();
        let (now, sigma) = (self.now(), self.config.measurement.gps_velocity_mps);
        let gathered = now.velocity_noise - past.velocity_noise;
        [0, 1, 2].map(|axis| {
            let innovation = fix.velocity_ned[axis] - past.velocity[axis];
            let row = velocity_row(axis, &now, past, &rotation);
            Scalar { since: Some((VEL + axis, gathered)), ..scalar(row, innovation, sigma) }
        })
    }

    fn position_scalars(&self, fix: &GpsMeasurement, past: &Past) -> [Scalar; 3] {
        let noise = &self.config.measurement;
        let by_barometer = self.config.aiding.pressure && (self.standing || self.barometer_carries());
        let vertical = if by_barometer { noise.gps_vertical_with_barometer_m } else { noise.gps_vertical_m };
        let sigmas = [noise.gps_horizontal_m, noise.gps_horizontal_m, vertical];
        let now = self.now();
        [0, 1, 2].map(|axis| {
            let innovation = fix.position_ned[axis] - past.position[axis];
            scalar(position_row(axis, &now, past), innovation, sigmas[axis])
        })
    }

    /// Takes a group of scalars together or not at all; true if taken.
    fn fuse(&mut self, aid: Aid, group: &[Scalar]) -> bool {
        self.fuse_from(aid, group, 0)
    }

    /// The same, correcting error states from `first` on only.
    fn fuse_from(&mut self, aid: Aid, group: &[Scalar], first: usize) -> bool {
        let gate = self.config.measurement.gate_sigma;
        let accepted = group.iter().all(|scalar| self.filter.normalised(scalar).abs() <= gate);
        if accepted {
            let time_s = self.now().time_s;
            for scalar in group {
                let normalised = self.filter.correct_from(scalar, first);
                self.record.take(aid, normalised, time_s);
            }
            self.finish_update();
        } else {
            self.counters.refused += 1;
        }
        accepted
    }

    /// The fix has been refused for too long: believe it. Twice in short order: the attitude is wrong.
    fn reset_to_fix(&mut self, fix: &GpsMeasurement, past: &Past) {
        let now = self.now();
        if now.time_s - self.last_gps_reset_s < GPS_RESET_MEMORY_S {
            self.last_gps_reset_s = f64::NEG_INFINITY;
            self.filter.widen(GYRO, 3, UNTOLD_RATE_RADPS);
            self.lose_state();
            return;
        }
        self.counters.resets += 1;
        self.last_gps_reset_s = now.time_s;
        let lag = now.time_s - fix.time_s;
        let by_barometer = self.barometer_carries();
        let nominal = &mut self.filter.nominal;
        let moved = now.position - past.position;
        nominal.velocity = fix.velocity_ned + now.velocity - past.velocity;
        nominal.position = fix.position_ned + moved + (fix.velocity_ned - past.velocity) * lag;
        if by_barometer {
            nominal.position.z = now.position.z;
        }
        self.filter.forget(VEL, 3, 1.0);
        self.filter.forget(POS, 3, 5.0);
        self.filter.widen(ATT, 3, 0.1);
        self.begin_history();
    }

    /// Fuses static pressure (Pa) as height above the runway; call as often as there are values, it fuses at 25 Hz.
    pub fn update_baro(&mut self, time_s: f64, static_pa: f64) {
        let Some(altitude) = pressure_altitude_m(static_pa) else { return };
        let interval = self.config.measurement.barometer_interval_s;
        let Some(altitude) = self.barometer.decimate(time_s, altitude, interval) else { return };
        if !self.config.aiding.pressure || self.phase == Phase::Stopped {
            return;
        }
        // The runway is height zero by definition of the frame. While the attitude is sought the aircraft may stand: if
        // it turns out to fly, what was learnt is forgotten.
        let seeking = self.phase == Phase::Aligning && !self.slow_known;
        if self.standing || seeking {
            self.barometer.learn(altitude - self.config.standing_height_m);
        }
        if self.phase != Phase::Running {
            return;
        }
        let Some(offset) = self.barometer.settled_offset() else {
            if !self.standing {
                self.barometer.learn(altitude + self.filter.nominal.position.z);
            }
            return;
        };
        let mut h = ErrorVector::zeros();
        h[POS + 2] = -1.0;
        let innovation = altitude - offset + self.filter.nominal.position.z;
        let scalar = scalar(h, innovation, self.config.measurement.barometer_m);
        let believed = self.static_watch.is_believed();
        let gate_share = self.filter.normalised(&scalar).abs() / self.config.measurement.gate_sigma;
        let leaps = self.static_watch.leaps(gate_share) && believed;
        if leaps {
            // A leap is the gate's matter: the height has not followed it.
            self.static_watch.restart();
            self.path_watch.restart();
        } else if let Some(off_m) = self.static_watch.height(time_s, altitude) {
            self.leave_barometer(off_m);
        }
        match (believed, self.static_watch.is_believed()) {
            (_, false) => return,
            (false, true) => return self.zero_barometer(time_s), // it stands elsewhere than before
            (true, true) => {}
        }
        let inertial = self.status() == EstimatorStatus::Inertial;
        if !leaps && self.goes_another_path(time_s, altitude, inertial) {
            return;
        }
        let accepted = self.fuse(Aid::Barometer, &[scalar]);
        if accepted || !inertial {
            self.refused_from_m = altitude;
        }
        // Without satellites it is what they are: one that moves, against which nothing has spoken.
        let moves = (altitude - self.refused_from_m).abs() > ALIVE_M;
        let alone = inertial && moves && !self.static_watch.is_doubtful();
        let noise = &self.config.measurement;
        let patience = if alone { noise.gps_patience_s } else { noise.other_patience_s };
        if self.barometer_gate.out_of_patience(accepted, time_s, patience) {
            match self.static_watch.give_up(time_s) {
                Some(off_m) => self.leave_barometer(off_m),
                None if alone => self.return_to_barometer(innovation),
                None => self.zero_barometer(time_s),
            }
        }
    }

    /// Without satellites attitude and pitot tell of a barometer that does not climb as the aircraft does; true if it was left. Height and sink rate
    /// have followed it, and what it cost has gone into the accelerometers' bias.
    fn goes_another_path(&mut self, time_s: f64, altitude_m: f64, inertial: bool) -> bool {
        if !inertial || self.is_near_ground() {
            self.path_watch.restart();
            return false;
        }
        let air = self.air();
        let by_attitude = self.path_watch.air_mps(&self.filter.nominal.attitude, &air);
        let (Some(by_attitude), Some(sample)) = (by_attitude, self.last_sample) else {
            return false;
        };
        let now = Heights {
            time_s,
            barometer_m: altitude_m,
            climb_mps: -by_attitude.z,
            airspeed_mps: self.last_airspeed_mps.filter(|_| self.pitot_believed),
            specific_force: sample.specific_force,
        };
        let least_mps = if self.pitot_believed { 0.0 } else { UNLEARNT_GUSTS_MPS };
        let Some(off_m) = self.path_watch.compare(now, self.gusts.learnt().sqrt().max(least_mps)) else {
            return false;
        };
        self.static_watch.disbelieve();
        self.filter.nominal.velocity += by_attitude - air;
        self.filter.forget(VEL, 3, UNTOLD_SINK_MPS);
        self.filter.widen(ACCEL, 3, UNTOLD_ACCELERATION_MPS2);
        self.leave_barometer(off_m);
        true
    }

    /// Velocity through the air, NED, m/s.
    pub(super) fn air(&self) -> Vector3<f64> {
        let nominal = &self.filter.nominal;
        nominal.velocity - Vector3::new(nominal.wind.x, nominal.wind.y, 0.0)
    }

    /// A height that has slowly come away from the barometer by `off_m`, m, is wrong itself, by an error of the accelerometers.
    fn return_to_barometer(&mut self, off_m: f64) {
        self.counters.resets += 1;
        self.filter.nominal.position.z -= off_m;
        self.filter.forget(POS + 2, 1, UNTOLD_HEIGHT_M);
        self.filter.forget(VEL + 2, 1, UNTOLD_SINK_MPS);
        self.filter.widen(ACCEL, 3, UNTOLD_ACCELERATION_MPS2);
        self.begin_history();
    }

    /// The height has followed a barometer that climbed so much too far, m; now it follows the receiver.
    fn leave_barometer(&mut self, off_m: f64) {
        self.barometer_gate = Gate::default();
        self.filter.nominal.position.z += off_m;
        self.filter.forget(POS + 2, 1, UNTOLD_HEIGHT_M);
        self.begin_history();
    }

    /// The state was set: the past that led to another one says nothing of it.
    fn begin_history(&mut self) {
        self.history.clear();
        self.history.push(self.now());
    }

    /// Its zero is known, and it is believed.
    pub(super) fn barometer_carries(&self) -> bool {
        self.barometer.settled_offset().is_some() && self.static_watch.is_believed()
    }

    fn zero_barometer(&mut self, time_s: f64) {
        self.barometer_gate = Gate::default();
        self.static_watch.begin_level();
        self.counters.resets += 1;
        self.barometer = BarometerReference { last_s: Some(time_s), ..BarometerReference::default() };
    }

    /// Fuses differential pressure (Pa) as airspeed: ground velocity less wind; it is what tells the wind.
    pub fn update_airspeed(&mut self, time_s: f64, differential_pa: f64, static_pa: f64) {
        if !differential_pa.is_finite() {
            return;
        }
        let density = density_kgpm3(pressure_altitude_m(static_pa).unwrap_or(0.0));
        let airspeed = airspeed_mps(differential_pa, density);
        if self.pitot_believed {
            self.last_airspeed_mps = Some(airspeed);
        }
        // Near standstill the direction of the air is unknown and the linearisation means nothing.
        let least = self.config.measurement.least_airspeed_mps;
        let slow =
            (airspeed < least && self.pitot_believed) || self.filter.nominal.velocity.norm() < 0.7 * least;
        let due = time_s - self.last_pitot_s > self.config.measurement.airspeed_interval_s - 1e-3;
        if self.phase != Phase::Running || !self.config.aiding.pressure || slow || !due {
            return;
        }
        self.last_pitot_s = time_s;
        let inertial = self.status() == EstimatorStatus::Inertial;
        if self.pitot_believed {
            self.fuse_airspeed(time_s, airspeed, inertial);
        }
        if !self.is_near_ground() {
            let scalar = self.across_scalar(&Vector3::y(), inertial);
            self.compare(Part::Across, &scalar, inertial);
            // It tells the heading where no magnetometer does.
            let alone = inertial || !self.record.fresh(Aid::Magnetometer, time_s, HEADING_WITHIN_S);
            self.fuse_from(Aid::Sideslip, &[scalar], if alone { 0 } else { WIND });
            self.follow_incidence(time_s, inertial);
        }
    }

    /// The air may come from the side there.
    fn is_near_ground(&self) -> bool {
        -self.filter.nominal.position.z <= self.config.measurement.sideslip_height_m
    }

    fn fuse_airspeed(&mut self, time_s: f64, airspeed: f64, inertial: bool) {
        let noise = &self.config.measurement;
        let sigma =
            if inertial { self.beside_inertial(noise.airspeed_without_gps_mps) } else { noise.airspeed_mps };
        let scalar = self.airspeed_scalar(airspeed, sigma);
        self.compare(Part::Along, &scalar, inertial);
        let accepted = self.fuse_from(Aid::Airspeed, &[scalar], if inertial { 0 } else { WIND });
        if accepted && !inertial {
            self.gusts.learn(scalar.innovation, self.config.measurement.airspeed_interval_s);
        }
        let patience = self.config.measurement.other_patience_s;
        if self.airspeed_gate.out_of_patience(accepted, time_s, patience) {
            self.counters.resets += 1;
            self.filter.forget(WIND, 2, self.config.initial.wind);
        }
    }

    /// Airspeed is the length of ground velocity less wind.
    fn airspeed_scalar(&self, airspeed: f64, sigma: f64) -> Scalar {
        let air = self.air();
        let expected = air.norm().max(1.0);
        let mut h = ErrorVector::zeros();
        for i in 0..3 {
            h[VEL + i] = air[i] / expected;
        }
        h[WIND] = -air.x / expected;
        h[WIND + 1] = -air.y / expected;
        scalar(h, airspeed - expected, sigma)
    }

    /// Learns how the air comes; without a receiver, that tells the sink rate where no barometer does, and the airspeed where no pitot does.
    fn follow_incidence(&mut self, time_s: f64, inertial: bool) {
        if !inertial {
            if self.record.fresh(Aid::GpsVelocity, time_s, LEARN_WITHIN_S) {
                let air = self.filter.nominal.attitude.inverse() * self.air();
                let interval_s = self.config.measurement.airspeed_interval_s;
                self.path_watch.learn(interval_s, &air, &self.filter.nominal.accel_bias);
            }
            return;
        }
        let Some((_, across)) = self.path_watch.axes() else { return };
        if !self.static_watch.is_believed() {
            let scalar = self.across_scalar(&across, inertial);
            self.fuse_from(Aid::Sideslip, &[scalar], 0);
        }
        if !self.pitot_believed {
            let scalar = self.airspeed_scalar(self.path_watch.usual_mps(), UNTOLD_AIRSPEED_MPS);
            self.fuse_from(Aid::Sideslip, &[scalar], 0);
        }
    }

    /// The air does not come along an axis `b` of the body: `R b · (v − w) = 0`. With y it comes along the plane of symmetry.
    fn across_scalar(&self, axis: &Vector3<f64>, inertial: bool) -> Scalar {
        let (air, across) = (self.air(), self.filter.nominal.attitude * axis);
        let swing = across.cross(&air);
        let mut h = ErrorVector::zeros();
        for i in 0..3 {
            h[ATT + i] = swing[i];
            h[VEL + i] = across[i];
        }
        h[WIND] = -across.x;
        h[WIND + 1] = -across.y;
        let sigma = self.config.measurement.sideslip_mps;
        scalar(h, -across.dot(&air), if inertial { self.beside_inertial(sigma) } else { sigma })
    }

    fn compare(&mut self, part: Part, scalar: &Scalar, inertial: bool) {
        let interval_s = self.config.measurement.airspeed_interval_s;
        self.gusts.compare(part, scalar.innovation, interval_s, inertial);
    }

    fn beside_inertial(&self, least_mps: f64) -> f64 {
        self.gusts.noise_mps(least_mps, self.config.measurement.airspeed_interval_s)
    }

    /// Fuses the magnetic field (body, gauss) against the model's at the site; fuses at 10 Hz.
    pub fn update_magnetometer(&mut self, time_s: f64, field_gauss: &Vector3<f64>) {
        let plausible = finite(field_gauss) && field_gauss.norm() > 0.05 && field_gauss.norm() < 2.0;
        if !plausible || !self.config.aiding.magnetometer {
            return;
        }
        if self.phase == Phase::Aligning {
            let corrected = field_gauss - self.filter.nominal.mag_bias;
            self.alignment.add_magnetometer(&corrected);
            return;
        }
        let due = time_s - self.last_magnetometer_s > self.config.measurement.magnetometer_interval_s - 1e-3;
        if self.phase != Phase::Running || !due {
            return;
        }
        self.last_magnetometer_s = time_s;
        let scalars = self.magnetometer_scalars(field_gauss);
        let mut accepted = self.fuse(Aid::Magnetometer, &scalars);
        let off = Vector3::from_fn(|axis, _| scalars[axis].innovation);
        if !accepted && self.turns_away(time_s, field_gauss, &off) {
            self.turned_s = time_s;
        }
        // Once in an outage: a magnetometer that drifts would be followed further and further.
        let alone = self.status() == EstimatorStatus::Inertial && !self.standing;
        self.turn_followed &= alone;
        let since_s = time_s - self.turned_s;
        if !accepted && alone && since_s < TURN_KNOWN_S && !self.turn_followed {
            self.turn_followed = true;
            self.counters.resets += 1;
            self.filter.widen(ATT, 3, UNTOLD_TURN_RAD + 2.0 * UNTOLD_RATE_RADPS * since_s);
            self.filter.widen(GYRO, 3, UNTOLD_RATE_RADPS);
            accepted = self.fuse(Aid::Magnetometer, &scalars);
        }
        self.field_off = accepted.then_some((time_s, off));
        let patience = self.config.measurement.other_patience_s;
        if self.magnetometer_gate.out_of_patience(accepted, time_s, patience) {
            self.counters.resets += 1;
            self.filter.forget(MAG, 3, 5.0 * self.config.initial.mag_bias);
            self.filter.widen(ATT + 2, 1, 0.3);
        }
    }

    /// The field comes away step by step, and is as large as before: the attitude turns wrongly. A magnetometer that shifts leaps, and one
    /// that drifts changes the field's size.
    fn turns_away(&self, time_s: f64, field_gauss: &Vector3<f64>, off_gauss: &Vector3<f64>) -> bool {
        let off = off_gauss.norm();
        let near = |(before_s, before): (f64, Vector3<f64>)| {
            time_s - before_s < STEP_S && (off_gauss - before).norm() < TURNING_SHARE * off
        };
        let expected = (field_gauss - self.filter.nominal.mag_bias - off_gauss).norm();
        let grown = ((field_gauss - self.filter.nominal.mag_bias).norm() - expected).abs();
        self.field_off.is_some_and(near)
            && grown < GROWN_SHARE * off + 2.0 * self.config.measurement.magnetometer_gauss
    }

    /// `m_body = Rᵀ m + b`, with `R = (1 + [θ]×) R̂`: the rows are `R̂ᵀ [m]×` and the identity for the bias.
    fn magnetometer_scalars(&self, field_gauss: &Vector3<f64>) -> [Scalar; 3] {
        let nominal = &self.filter.nominal;
        let down = nominal.attitude.to_rotation_matrix().into_inner().transpose();
        let field = &self.config.field_ned_gauss;
        let expected = down * field + nominal.mag_bias;
        let rows = down * skew(field);
        [0, 1, 2].map(|axis| {
            let mut h = ErrorVector::zeros();
            for i in 0..3 {
                h[ATT + i] = rows[(axis, i)];
            }
            h[MAG + axis] = 1.0;
            scalar(h, field_gauss[axis] - expected[axis], self.config.measurement.magnetometer_gauss)
        })
    }
}
