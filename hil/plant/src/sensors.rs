//! Sensors and their errors: inertial, magnetic, pressure, satellite, distance to the ground.
//!
//! Every error has a number in [`SensorErrors`]; the defaults are those of a small autopilot board after its factory
//! calibration. Turn-on biases are drawn once from the seed. Two slow errors no filter can see, the receiver's and the
//! barometer's, are readable, since a score is fair only against a truth shifted by them.

use crate::STEP_S;
use crate::atmosphere::{self, GRAVITY_MPS2};
use crate::fault::Wrongs;
use crate::geodesy::{Geodetic, LocalFrame};
use crate::noise::{Noise, Source};
use crate::rigid_body::{RigidState, StepMean};
use nalgebra::{Matrix3, Vector2, Vector3};
use serde::Deserialize;

/// Magnetic field at the runway at the beginning of 2026, NED, gauss: declination −26.90°, inclination −64.59°.
pub const MAGNETIC_FIELD_NED_GAUSS: [f64; 3] = [0.095_84, -0.048_61, -0.226_24];
/// Interval to which the noise of accelerometer and gyroscope refers, s. A mean over longer is quieter by the root.
pub const NOISE_INTERVAL_S: f64 = 0.02;

/// Size of every error. Zero switches one off. As a TOML text, what is not named stays at its default.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct SensorErrors {
    /// Noise of a 20 ms mean, per axis, m/s². Default 0.0025 g.
    pub accelerometer_noise_mps2: f64,
    /// Turn-on bias forward and right, even within ± this, m/s². Default 50 mg (MPU-6000, x and y).
    pub accelerometer_bias_max_mps2: f64,
    /// The same down, m/s². Default 80 mg (MPU-6000, z).
    pub accelerometer_bias_down_max_mps2: f64,
    /// Scale error, even within ± this per axis. Default 0.2 % after calibration; the bare part has 3 %.
    pub accelerometer_scale_max: f64,
    /// Noise of a 20 ms mean, per axis, rad/s. Default 0.13°/s.
    pub gyroscope_noise_radps: f64,
    /// Turn-on bias, even within ± this per axis, rad/s. Default 1°/s after calibration; the bare part has 20°/s.
    pub gyroscope_bias_max_radps: f64,
    /// Scale error, even within ± this per axis. Default 0.2 %.
    pub gyroscope_scale_max: f64,
    /// Share of each other axis felt by accelerometer and gyroscope, even within ±. Default 0.2 %; bare 2 %.
    pub cross_axis_max: f64,
    /// Noise per sample and axis, gauss. Default 0.03° of the local field.
    pub magnetometer_noise_gauss: f64,
    /// Bias, even within ± this per axis, gauss. Default 0.01: some 5° of heading here, so it has to be estimated.
    pub magnetometer_bias_max_gauss: f64,
    /// Noise of the static pressure per sample, Pa. Default 10.
    pub static_pressure_noise_pa: f64,
    /// Standard deviation of the barometer's slow error, m of height. Default 1.5.
    pub barometer_bias_sigma_m: f64,
    /// Its correlation time, s. Default 1100.
    pub barometer_bias_time_s: f64,
    /// Noise of the differential pressure per sample, Pa. Default 2.
    pub differential_pressure_noise_pa: f64,
    /// Zero error of the differential pressure, even within ± this, Pa. Default 2.
    pub differential_pressure_bias_max_pa: f64,
    /// Satellite receiver.
    pub gps: GpsErrors,
    /// Range finder.
    pub range: RangeErrors,
}

/// Errors of the range finder, which looks down along the body's own axis. The defaults are what small laser altimeters are like, of no one
/// data sheet.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct RangeErrors {
    /// Whether there is one. Default true.
    pub fitted: bool,
    /// Noise of a sample, m. Default 0.05.
    pub noise_m: f64,
    /// Offset, even within ± this, m. Default 0.05.
    pub bias_max_m: f64,
    /// Shortest distance that it measures, m. Default 0.1.
    pub least_m: f64,
    /// Longest one, m. Default 50.
    pub most_m: f64,
    /// Share of the samples without an echo. Default 2 %.
    pub missed: f64,
}

/// Errors of the satellite receiver.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(default, deny_unknown_fields)]
pub struct GpsErrors {
    /// Fixes per second, 1 to 10; rounded to a whole number of plant steps. Default 5.
    pub rate_hz: f64,
    /// From measurement to delivery, s, at most 1.5. Default 0.12.
    pub latency_s: f64,
    /// Rate at which the slow error is forgotten, 1/s. Default 1/1100.
    pub slow_rate_per_s: f64,
    /// Growth of the slow error north and east, m per root second. Default 0.21: 4.9 m in the long run.
    pub slow_step_horizontal_m: f64,
    /// The same for height, m per root second. Default 0.40: 9.4 m in the long run.
    pub slow_step_vertical_m: f64,
    /// Whether the slow error starts anywhere in its long-run spread (default) or at zero.
    pub slow_starts_spread: bool,
    /// Noise of each component of the velocity, m/s. Default 0.05.
    pub velocity_noise_mps: f64,
    /// Share of the fixes that are never delivered, each by itself. Default 0.5 %.
    pub missed: f64,
    /// Mean time between outages, s; zero: there are none. Default 1200.
    pub outage_every_s: f64,
    /// Mean length of an outage, s; each has between half and one and a half of it. Default 2.
    pub outage_s: f64,
}

impl Default for SensorErrors {
    fn default() -> Self {
        let degree = std::f64::consts::PI / 180.0;
        let field = Vector3::from(MAGNETIC_FIELD_NED_GAUSS).norm();
        Self {
            accelerometer_noise_mps2: 0.0025 * GRAVITY_MPS2,
            accelerometer_bias_max_mps2: 0.05 * GRAVITY_MPS2,
            accelerometer_bias_down_max_mps2: 0.08 * GRAVITY_MPS2,
            accelerometer_scale_max: 0.002,
            gyroscope_noise_radps: 0.13 * degree,
            gyroscope_bias_max_radps: degree,
            gyroscope_scale_max: 0.002,
            cross_axis_max: 0.002,
            magnetometer_noise_gauss: 0.03 * degree * field,
            magnetometer_bias_max_gauss: 0.01,
            static_pressure_noise_pa: 10.0,
            barometer_bias_sigma_m: 1.5,
            barometer_bias_time_s: 1100.0,
            differential_pressure_noise_pa: 2.0,
            differential_pressure_bias_max_pa: 2.0,
            gps: GpsErrors::default(),
            range: RangeErrors::default(),
        }
    }
}

impl Default for RangeErrors {
    fn default() -> Self {
        Self { fitted: true, noise_m: 0.05, bias_max_m: 0.05, least_m: 0.1, most_m: 50.0, missed: 0.02 }
    }
}

impl Default for GpsErrors {
    fn default() -> Self {
        Self {
            rate_hz: 5.0,
            latency_s: 0.12,
            slow_rate_per_s: 1.0 / 1100.0,
            slow_step_horizontal_m: 0.21,
            slow_step_vertical_m: 0.40,
            slow_starts_spread: true,
            velocity_noise_mps: 0.05,
            missed: 0.005,
            outage_every_s: 1200.0,
            outage_s: 2.0,
        }
    }
}

impl SensorErrors {
    /// Perfect sensors; the receiver still gives five fixes per second, but at once.
    pub fn none() -> Self {
        Self {
            accelerometer_noise_mps2: 0.0,
            accelerometer_bias_max_mps2: 0.0,
            accelerometer_bias_down_max_mps2: 0.0,
            accelerometer_scale_max: 0.0,
            gyroscope_noise_radps: 0.0,
            gyroscope_bias_max_radps: 0.0,
            gyroscope_scale_max: 0.0,
            cross_axis_max: 0.0,
            magnetometer_noise_gauss: 0.0,
            magnetometer_bias_max_gauss: 0.0,
            static_pressure_noise_pa: 0.0,
            barometer_bias_sigma_m: 0.0,
            differential_pressure_noise_pa: 0.0,
            differential_pressure_bias_max_pa: 0.0,
            gps: GpsErrors {
                latency_s: 0.0,
                slow_step_horizontal_m: 0.0,
                slow_step_vertical_m: 0.0,
                velocity_noise_mps: 0.0,
                missed: 0.0,
                outage_every_s: 0.0,
                ..GpsErrors::default()
            },
            range: RangeErrors { noise_m: 0.0, bias_max_m: 0.0, missed: 0.0, ..RangeErrors::default() },
            ..Self::default()
        }
    }

    /// Reads errors from TOML text.
    ///
    /// # Errors
    /// When it is no TOML, or a key is unknown or no number; the message names line and column.
    pub fn from_toml(text: &str) -> Result<Self, toml::de::Error> {
        toml::from_str(text)
    }

    /// The bare parts as their data sheet (MPU-6000) allows them: 3 % scale, 2 % cross-axis, 20°/s.
    pub fn uncalibrated() -> Self {
        Self {
            accelerometer_scale_max: 0.03,
            gyroscope_bias_max_radps: 20.0_f64.to_radians(),
            gyroscope_scale_max: 0.03,
            cross_axis_max: 0.02,
            ..Self::default()
        }
    }
}

/// One sample of everything. Vectors in body axes (forward, right, down).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorSet {
    /// Time of the sample, end of the averaging interval, s.
    pub time_s: f64,
    /// Length of the averaging interval, s; zero if no time has passed since the last sample.
    pub interval_s: f64,
    /// Mean specific force, m/s²; (0, 0, −g) standing level.
    pub accelerometer_mps2: Vector3<f64>,
    /// Mean rates, rad/s.
    pub gyroscope_radps: Vector3<f64>,
    /// Magnetic field, gauss.
    pub magnetometer_gauss: Vector3<f64>,
    /// Static pressure, Pa.
    pub static_pressure_pa: f64,
    /// Pitot minus static pressure, Pa.
    pub differential_pressure_pa: f64,
    /// A fix, if one has come in since the last sample.
    pub gps: Option<GpsFix>,
    /// Distance to the ground along the body's axis down, where there is an echo, m.
    pub range_m: Option<f64>,
}

/// What the receiver reports. It is old by the latency when it comes in.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct GpsFix {
    /// Time at which the fix was true, s.
    pub measured_at_s: f64,
    /// Latitude, longitude, height above mean sea level.
    pub geodetic: Geodetic,
    /// The same place in the runway's NED axes, m.
    pub position_ned_m: Vector3<f64>,
    /// Velocity over ground, NED, m/s.
    pub velocity_ned_mps: Vector3<f64>,
}

/// First-order Gauss-Markov process, updated at a fixed interval.
#[derive(Clone, Copy, Debug)]
struct GaussMarkov {
    keep: f64,
    drive: f64,
    value: f64,
}

impl GaussMarkov {
    fn new(rate_per_s: f64, sigma: f64, interval_s: f64) -> Self {
        let keep = (-rate_per_s * interval_s).exp();
        Self { keep, drive: sigma * (1.0 - keep * keep).max(0.0).sqrt(), value: 0.0 }
    }

    fn step(&mut self, gaussian: f64) {
        self.value = self.keep * self.value + self.drive * gaussian;
    }
}

/// Constant errors of a three-axis sensor.
#[derive(Clone, Copy, Debug)]
struct Triad {
    matrix: Matrix3<f64>,
    bias: Vector3<f64>,
    noise: f64,
}

impl Triad {
    /// `bias` is the greatest one on each axis.
    fn draw(draws: &mut Noise, scale: f64, cross: f64, bias: [f64; 3], noise: f64) -> Self {
        let mut matrix = Matrix3::identity();
        for row in 0..3 {
            for column in 0..3 {
                matrix[(row, column)] += draws.within(if row == column { scale } else { cross });
            }
        }
        Self { matrix, bias: draws.within3(bias), noise }
    }

    /// `shift` is added to the bias of each axis.
    fn measure(&self, truth: &Vector3<f64>, gaussian: Vector3<f64>, shift: f64) -> Vector3<f64> {
        self.matrix * truth + self.bias + gaussian * self.noise + Vector3::repeat(shift)
    }
}

/// Fixes on their way; a rate of 10 Hz and the longest latency need 15 places.
const FIXES: usize = 32;
const LONGEST_LATENCY_S: f64 = 1.5;

/// The receiver: measures on its own clock, delivers late.
#[derive(Clone, Debug)]
struct Gps {
    every: u64,
    latency: u64,
    velocity_noise: f64,
    slow: [GaussMarkov; 3],
    position_source: Noise,
    velocity_source: Noise,
    gaps: Gaps,
    waiting: [(u64, GpsFix); FIXES],
    measured: u64,
    delivered: u64,
}

impl Gps {
    fn new(seed: u64, e: &GpsErrors) -> Self {
        let every = ((1.0 / e.rate_hz.clamp(0.1, 10.0)) / STEP_S).round() as u64;
        let interval = every as f64 * STEP_S;
        let process = |step: f64| {
            let sigma = step / (1.0 - (-2.0 * e.slow_rate_per_s).exp()).max(1e-12).sqrt();
            (GaussMarkov::new(e.slow_rate_per_s, sigma, interval), sigma)
        };
        let mut position_source = Noise::new(seed, Source::GpsPosition);
        let start = position_source.gaussian3();
        let mut slow =
            [e.slow_step_horizontal_m, e.slow_step_horizontal_m, e.slow_step_vertical_m].map(process);
        for (axis, (process, sigma)) in slow.iter_mut().enumerate() {
            process.value = if e.slow_starts_spread { *sigma * start[axis] } else { 0.0 };
        }
        Self {
            every,
            latency: (e.latency_s.clamp(0.0, LONGEST_LATENCY_S) / STEP_S).round() as u64,
            velocity_noise: e.velocity_noise_mps,
            slow: slow.map(|(process, _)| process),
            position_source,
            velocity_source: Noise::new(seed, Source::GpsVelocity),
            gaps: Gaps::new(seed, e, interval),
            waiting: [(0, GpsFix::default()); FIXES],
            measured: 0,
            delivered: 0,
        }
    }

    fn slow_error(&self) -> Vector3<f64> {
        Vector3::new(self.slow[0].value, self.slow[1].value, self.slow[2].value)
    }

    fn step(&mut self, step: u64, state: &RigidState, frame: &LocalFrame, wrongs: &Wrongs) {
        if !step.is_multiple_of(self.every) {
            return;
        }
        let drive = self.position_source.gaussian3();
        for (axis, process) in self.slow.iter_mut().enumerate() {
            process.step(drive[axis]);
        }
        let position = state.position + self.slow_error() + Vector3::new(wrongs.gps_shift_m, 0.0, 0.0);
        let fix = GpsFix {
            measured_at_s: step as f64 * STEP_S,
            geodetic: frame.to_geodetic(&position),
            position_ned_m: position,
            velocity_ned_mps: state.velocity + self.velocity_source.gaussian3() * self.velocity_noise,
        };
        // Drawn always, so that a fault does not shift what follows.
        if self.gaps.swallow(fix.measured_at_s) || wrongs.gps_lost {
            return;
        }
        let late = (wrongs.gps_late_s / STEP_S).round() as u64;
        self.waiting[(self.measured % FIXES as u64) as usize] = (step + self.latency + late, fix);
        self.measured += 1;
    }

    /// The newest fix that has arrived and was not given yet; older ones it overtakes are dropped.
    fn take(&mut self, step: u64) -> Option<GpsFix> {
        let first = self.delivered.max(self.measured.saturating_sub(FIXES as u64));
        let place = |fix: u64| (fix % FIXES as u64) as usize;
        let newest = (first..self.measured).rev().find(|fix| self.waiting[place(*fix)].0 <= step)?;
        self.delivered = newest + 1;
        Some(self.waiting[place(newest)].1)
    }
}

/// Fixes that never come: single ones, and all of an outage.
#[derive(Clone, Debug)]
struct Gaps {
    missed: f64,
    /// Chance that an outage begins between two fixes.
    begins: f64,
    outage_s: f64,
    until_s: f64,
    single: Noise,
    outages: Noise,
}

impl Gaps {
    fn new(seed: u64, e: &GpsErrors, interval_s: f64) -> Self {
        Self {
            missed: e.missed,
            begins: if e.outage_every_s > 0.0 { interval_s / e.outage_every_s } else { 0.0 },
            outage_s: e.outage_s.max(0.0),
            until_s: 0.0,
            single: Noise::new(seed, Source::GpsMissed),
            outages: Noise::new(seed, Source::GpsOutage),
        }
    }

    /// Whether the fix of a time, s, is lost.
    fn swallow(&mut self, time_s: f64) -> bool {
        let (begins, length) = (self.outages.unit() < self.begins, 0.5 + self.outages.unit());
        if begins && time_s >= self.until_s {
            self.until_s = time_s + self.outage_s * length;
        }
        self.single.unit() < self.missed || time_s < self.until_s
    }
}

/// The range finder. It looks from the place of the inertial sensors.
#[derive(Clone, Debug)]
struct RangeFinder {
    errors: RangeErrors,
    bias_m: f64,
    source: Noise,
    /// What it saw last, m.
    last_m: Option<f64>,
}

impl RangeFinder {
    fn new(seed: u64, errors: &RangeErrors) -> Self {
        let mut source = Noise::new(seed, Source::Range);
        let bias_m = source.within(errors.bias_max_m);
        Self { errors: errors.clone(), bias_m, source, last_m: None }
    }

    fn sample(&mut self, state: &RigidState, wrongs: &Wrongs) -> Option<f64> {
        let e = &self.errors;
        // Drawn always, so that a fault does not shift what follows.
        let (noise, missed) = (self.source.gaussian(), self.source.unit() < e.missed);
        let down = (state.attitude * Vector3::z()).z;
        let distance_m = (-state.position.z / down) + self.bias_m + noise * e.noise_m + wrongs.range_shift_m;
        let echo = e.fitted && !missed && down > 0.0 && (e.least_m..=e.most_m).contains(&distance_m);
        let seen_m = echo.then_some(distance_m);
        self.last_m = if wrongs.range_stuck { self.last_m } else { seen_m.or(self.last_m) };
        let told_m = if wrongs.range_stuck { self.last_m } else { seen_m };
        told_m.filter(|_| !wrongs.range_lost)
    }
}

/// What the sensors need to know at the instant of a sample.
pub(crate) struct Instant<'a> {
    pub(crate) step: u64,
    pub(crate) state: &'a RigidState,
    pub(crate) specific_force: Vector3<f64>,
    pub(crate) airspeed_mps: f64,
    pub(crate) density: f64,
    pub(crate) wrongs: Wrongs,
}

/// All sensors of one aircraft.
#[derive(Clone, Debug)]
pub(crate) struct SensorSuite {
    accelerometer: Triad,
    gyroscope: Triad,
    magnetometer: Triad,
    pitot_bias_pa: f64,
    static_noise_pa: f64,
    pitot_noise_pa: f64,
    barometer: GaussMarkov,
    gps: Gps,
    range: RangeFinder,
    frame: LocalFrame,
    elevation_m: f64,
    blocked: Blocked,
    sources: Sources,
    sum: StepMean,
    steps: u32,
}

/// What broken sensors still have of former values: pressures that are shut in behind the static ports and in the pitot, Pa,
/// and what a stuck one repeats.
#[derive(Clone, Copy, Debug, Default)]
struct Blocked {
    static_pa: Option<f64>,
    total_pa: Option<f64>,
    differential_pa: Option<f64>,
    force: [Option<f64>; 3],
    rates: [Option<f64>; 3],
}

impl Blocked {
    /// What the sensors feel of the true pressures, `dt_s` after the last time.
    fn felt(&mut self, static_pa: f64, total_pa: f64, wrongs: &Wrongs, dt_s: f64) -> (f64, f64) {
        let felt = |shut: bool, slow_s: f64, held: Option<f64>, now: f64| match (shut, slow_s > 0.0) {
            (true, _) => Some(held.unwrap_or(now)),
            (false, true) => Some(held.map_or(now, |held| now + (held - now) * (-dt_s / slow_s).exp())),
            (false, false) => None,
        };
        self.static_pa = felt(wrongs.static_blocked, wrongs.static_slow_s, self.static_pa, static_pa);
        self.total_pa = felt(wrongs.pitot.blocked, wrongs.pitot.slow_s, self.total_pa, total_pa);
        (self.static_pa.unwrap_or(static_pa), self.total_pa.unwrap_or(total_pa))
    }

    /// The values of three axes, of which some are stuck.
    fn stuck(held: &mut [Option<f64>; 3], stuck: &[bool; 3], mut values: Vector3<f64>) -> Vector3<f64> {
        for axis in 0..3 {
            held[axis] = stuck[axis].then(|| held[axis].unwrap_or(values[axis]));
            values[axis] = held[axis].unwrap_or(values[axis]);
        }
        values
    }
}

#[derive(Clone, Debug)]
struct Sources {
    accelerometer: Noise,
    gyroscope: Noise,
    magnetometer: Noise,
    static_pressure: Noise,
    differential_pressure: Noise,
    barometer: Noise,
    lost_frames: Noise,
}

impl Sources {
    fn new(seed: u64) -> Self {
        Self {
            accelerometer: Noise::new(seed, Source::Accelerometer),
            gyroscope: Noise::new(seed, Source::Gyroscope),
            magnetometer: Noise::new(seed, Source::Magnetometer),
            static_pressure: Noise::new(seed, Source::StaticPressure),
            differential_pressure: Noise::new(seed, Source::DifferentialPressure),
            barometer: Noise::new(seed, Source::BarometerDrift),
            lost_frames: Noise::new(seed, Source::LostFrames),
        }
    }
}

/// The barometer's slow error is renewed every 100 ms.
const BAROMETER_STEPS: u64 = 40;

impl SensorSuite {
    pub(crate) fn new(seed: u64, e: &SensorErrors, elevation_m: f64) -> Self {
        let mut draws = Noise::new(seed, Source::Biases);
        let mut sources = Sources::new(seed);
        let cross = e.cross_axis_max;
        let along = e.accelerometer_bias_max_mps2;
        let force_bias = [along, along, e.accelerometer_bias_down_max_mps2];
        let rate_bias = [e.gyroscope_bias_max_radps; 3];
        let (force_noise, rate_noise) = (e.accelerometer_noise_mps2, e.gyroscope_noise_radps);
        let mut barometer = GaussMarkov::new(
            1.0 / e.barometer_bias_time_s.max(1e-3),
            e.barometer_bias_sigma_m,
            BAROMETER_STEPS as f64 * STEP_S,
        );
        barometer.value = e.barometer_bias_sigma_m * sources.barometer.gaussian();
        Self {
            accelerometer: Triad::draw(&mut draws, e.accelerometer_scale_max, cross, force_bias, force_noise),
            gyroscope: Triad::draw(&mut draws, e.gyroscope_scale_max, cross, rate_bias, rate_noise),
            magnetometer: Triad::draw(
                &mut draws,
                0.0,
                0.0,
                [e.magnetometer_bias_max_gauss; 3],
                e.magnetometer_noise_gauss,
            ),
            pitot_bias_pa: draws.within(e.differential_pressure_bias_max_pa),
            static_noise_pa: e.static_pressure_noise_pa,
            pitot_noise_pa: e.differential_pressure_noise_pa,
            barometer,
            gps: Gps::new(seed, &e.gps),
            range: RangeFinder::new(seed, &e.range),
            frame: LocalFrame::new(elevation_m),
            elevation_m,
            blocked: Blocked::default(),
            sources,
            sum: StepMean::default(),
            steps: 0,
        }
    }

    /// Follows the aircraft through one plant step.
    pub(crate) fn follow(&mut self, step: u64, mean: &StepMean, state: &RigidState, wrongs: &Wrongs) {
        self.sum.specific_force += mean.specific_force;
        self.sum.rates += mean.rates;
        self.steps += 1;
        self.gps.step(step, state, &self.frame, wrongs);
        if step.is_multiple_of(BAROMETER_STEPS) {
            self.barometer.step(self.sources.barometer.gaussian());
        }
    }

    /// The receiver's slow error, NED, m: what it reports minus what is true.
    pub(crate) fn gps_slow_error(&self) -> Vector3<f64> {
        self.gps.slow_error()
    }

    /// The barometer's slow error, m of height: what it reports minus what is true.
    pub(crate) fn barometer_bias(&self) -> f64 {
        self.barometer.value
    }

    /// Biases of accelerometer (m/s²), gyroscope (rad/s), magnetometer (gauss).
    pub(crate) fn biases(&self) -> [Vector3<f64>; 3] {
        [self.accelerometer.bias, self.gyroscope.bias, self.magnetometer.bias]
    }

    /// Samples everything and starts the next averaging interval.
    pub(crate) fn sample(&mut self, now: &Instant<'_>) -> SensorSet {
        let interval_s = f64::from(self.steps) * STEP_S;
        let (force, rates) = self.means(now);
        // Before time has passed the noise is that of one plant step, not infinite.
        let louder = (NOISE_INTERVAL_S / interval_s.max(STEP_S)).sqrt();
        let wrongs = &now.wrongs;
        let field = now.state.attitude.inverse() * Vector3::from(MAGNETIC_FIELD_NED_GAUSS);
        let (static_pressure_pa, differential_pressure_pa) = self.pressures(now, interval_s);
        let s = &mut self.sources;
        let force_noise = s.accelerometer.gaussian3() * louder;
        let rate_noise = s.gyroscope.gaussian3() * louder;
        let field_noise = s.magnetometer.gaussian3();
        let lost = s.lost_frames.unit() < wrongs.frames_lost;
        let nothing = missing(wrongs.inertial_lost);
        let force =
            self.accelerometer.measure(&force, force_noise, wrongs.accelerometer_shift_mps2 + nothing);
        let rates = self.gyroscope.measure(&rates, rate_noise, wrongs.gyroscope_shift_radps + nothing);
        let held = &mut self.blocked;
        let set = SensorSet {
            time_s: now.step as f64 * STEP_S,
            interval_s,
            accelerometer_mps2: Blocked::stuck(&mut held.force, &wrongs.accelerometer_stuck, force),
            gyroscope_radps: Blocked::stuck(&mut held.rates, &wrongs.gyroscope_stuck, rates),
            magnetometer_gauss: self.magnetometer.measure(
                &field,
                field_noise,
                wrongs.magnetometer_shift_gauss + missing(wrongs.magnetometer_lost),
            ),
            static_pressure_pa,
            differential_pressure_pa: differential_pressure_pa + missing(wrongs.pitot_lost),
            gps: self.gps.take(now.step),
            range_m: self.range.sample(now.state, wrongs),
        };
        self.sum = StepMean::default();
        self.steps = 0;
        if lost { set.lost() } else { set }
    }

    fn means(&self, now: &Instant<'_>) -> (Vector3<f64>, Vector3<f64>) {
        if self.steps == 0 {
            return (now.specific_force, now.state.rates);
        }
        let count = f64::from(self.steps);
        (self.sum.specific_force / count, self.sum.rates / count)
    }

    /// Static pressure and pitot minus static, as measured, Pa.
    fn pressures(&mut self, now: &Instant<'_>, interval_s: f64) -> (f64, f64) {
        let apparent = self.elevation_m - now.state.position.z + self.barometer.value;
        let outside_pa = atmosphere::air(apparent).pressure_pa;
        let pitot = now.wrongs.pitot;
        // Without a fault the difference is taken as it is: the sum of two large numbers would cost digits.
        let told_mps = now.airspeed_mps * pitot.scale + pitot.ice_mps;
        let ram_pa = 0.5 * now.density * told_mps * told_mps.max(0.0);
        let static_noise = self.static_noise_pa * self.sources.static_pressure.gaussian();
        let noise = self.sources.differential_pressure.gaussian();
        let pitot_noise = Vector2::new(self.pitot_noise_pa, pitot.noise_pa).norm() * noise;
        let (static_pa, total_pa) =
            self.blocked.felt(outside_pa, outside_pa + ram_pa, &now.wrongs, interval_s);
        let exact = self.blocked.static_pa.is_none() && self.blocked.total_pa.is_none();
        let difference_pa = if exact { ram_pa } else { total_pa - static_pa };
        let told_pa = difference_pa + self.pitot_bias_pa + pitot_noise;
        let held = &mut self.blocked.differential_pa;
        *held = pitot.frozen.then(|| held.unwrap_or(told_pa));
        (static_pa + static_noise, held.unwrap_or(told_pa))
    }
}

/// What makes a value none at all.
fn missing(is_missing: bool) -> f64 {
    if is_missing { f64::NAN } else { 0.0 }
}

impl SensorSet {
    /// What is left of a set that was lost on its way: its time.
    fn lost(self) -> Self {
        let nothing = Vector3::repeat(f64::NAN);
        Self {
            time_s: self.time_s,
            interval_s: 0.0,
            accelerometer_mps2: nothing,
            gyroscope_radps: nothing,
            magnetometer_gauss: nothing,
            static_pressure_pa: f64::NAN,
            differential_pressure_pa: f64::NAN,
            gps: None,
            range_m: None,
        }
    }
}
