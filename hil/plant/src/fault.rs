//! What goes wrong outside of the flight computer: sensors, actuators, air. Planned, never by chance alone, so that the same
//! plan and seed give the same flight.
//!
//! Written `KIND`, `KIND@FROM`, `KIND@FROM..TO`, with `KIND=VALUE` where it has one; times in seconds of the plant's clock. A
//! fault acts from its FROM on, until just before its TO.

use crate::words::unknown;
use nalgebra::{Vector2, Vector3};
use std::f64::consts::TAU;
use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// Latest that a fix may come, s: the receiver's ring is made for it.
const LATEST_FIX_S: f64 = 1.3;
/// Longest delay that can be added to the actuators, s: theirs is at most 0.25 s by the airframe file.
pub(crate) const LONGEST_DELAY_S: f64 = 0.5;

/// A servo that can be stuck.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Actuator {
    /// Left aileron; the plant's aileron is the mean of both.
    LeftAileron,
    /// Right aileron.
    RightAileron,
    /// Elevator.
    Elevator,
    /// Rudder.
    Rudder,
    /// Throttle.
    Throttle,
}

/// One thing that goes wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// The receiver measures nothing.
    GpsLost,
    /// Fixes come this much later than they do anyway, s.
    GpsLate(f64),
    /// Fixes lie this far north of where they should, m, with the right velocity.
    GpsShift(f64),
    /// The magnetometer gives no values.
    MagnetometerLost,
    /// The magnetometer's bias changes by this on each axis, gauss.
    MagnetometerShift(f64),
    /// The differential pressure sensor gives no values.
    PitotLost,
    /// The pitot's opening is closed: the total pressure in it stays what it was.
    PitotBlocked,
    /// The differential pressure sensor repeats the value it had.
    PitotFrozen,
    /// The pressure in the pitot follows the one outside with this time constant, s: its opening is partly closed.
    PitotSlow(f64),
    /// The pitot tells this many times the airspeed: it leaks, or stands askew.
    PitotScale(f64),
    /// Ice grows on the pitot: the airspeed that it tells changes by this each second, m/s.
    PitotIcing(f64),
    /// Noise on the differential pressure, standard deviation, Pa.
    PitotNoise(f64),
    /// The static ports are closed: the pressure behind them stays what it was, for both sensors.
    StaticBlocked,
    /// The pressure behind the static ports follows the one outside with this time constant, s.
    StaticSlow(f64),
    /// The range finder has no echo.
    RangeLost,
    /// The range finder repeats the distance it had.
    RangeStuck,
    /// The range finder tells this much more, m: it sees something below the aircraft, or grass.
    RangeShift(f64),
    /// One axis of the accelerometer repeats the value it had: 0 forward, 1 right, 2 down.
    AccelerometerStuck(usize),
    /// One axis of the gyroscope does.
    GyroscopeStuck(usize),
    /// Neither accelerometer nor gyroscope gives values.
    InertialLost,
    /// The accelerometer's bias changes by this on each axis, m/s².
    AccelerometerShift(f64),
    /// The gyroscope's bias changes by this on each axis, °/s.
    GyroscopeShift(f64),
    /// This share of the sensor sets is lost whole, the fix in them included: chosen by the seed.
    FramesLost(f64),
    /// The simulator stands still and answers nobody. The plant alone knows nothing of it.
    Pause,
    /// The main battery has this share of its charge left, or less. The plant alone knows nothing of it.
    Battery(f64),
    /// Commands reach the servos this much later than they do anyway, s.
    Delay(f64),
    /// A servo runs to this share of its travel (−1 to 1, throttle 0 to 1) and stays; `None` if it stays where it is.
    Stuck(Actuator, Option<f64>),
    /// A gust that swells and dies, (1 − cos)/2, over the time of the fault.
    Gust {
        /// Its greatest speed, m/s.
        speed_mps: f64,
        /// Where it comes from, degrees clockwise from north.
        from_deg: f64,
    },
    /// The same upwards, m/s.
    Updraft(f64),
}

/// A fault and when it acts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlannedFault {
    /// What.
    pub fault: Fault,
    /// From here on, s.
    pub from_s: f64,
    /// Until just before, s; infinite: to the end.
    pub to_s: f64,
}

/// Why a text is no fault. The message says how to mend it.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{0}")]
pub struct FaultError(String);

/// A kind of fault as it is written.
struct Kind {
    name: &'static str,
    /// What its value is, with an example; empty: it has none.
    value: &'static str,
    /// Reads the value; `None`: the value makes no sense.
    read: fn(Option<&str>) -> Option<Fault>,
    /// Whether it has to have an end.
    ends: bool,
}

/// A value in a range, and what it makes.
fn within(text: Option<&str>, low: f64, high: f64, make: fn(f64) -> Fault) -> Option<Fault> {
    let value: f64 = text?.parse().ok()?;
    (low..=high).contains(&value).then(|| make(value))
}

/// A share as `0.02`, `2%` or `1/50`.
pub(crate) fn share(text: &str) -> Option<f64> {
    let number = |text: &str| text.trim().parse::<f64>().ok();
    let value = match (text.strip_suffix('%'), text.split_once('/')) {
        (Some(percent), _) => number(percent)? / 100.0,
        (None, Some((part, whole))) => number(part)? / number(whole)?,
        (None, None) => number(text)?,
    };
    value.is_finite().then_some(value)
}

fn stuck(text: Option<&str>, actuator: Actuator) -> Option<Fault> {
    let low = if actuator == Actuator::Throttle { 0.0 } else { -1.0 };
    match text {
        None => Some(Fault::Stuck(actuator, None)),
        Some(text) => {
            let at = share(text).filter(|at| (low..=1.0).contains(at))?;
            Some(Fault::Stuck(actuator, Some(at)))
        }
    }
}

fn gust(text: Option<&str>) -> Option<Fault> {
    let (speed, from) = text?.split_once(',')?;
    let (speed_mps, from_deg): (f64, f64) = (speed.parse().ok()?, from.parse().ok()?);
    let sane = (0.0..=30.0).contains(&speed_mps) && (-360.0..=360.0).contains(&from_deg);
    sane.then_some(Fault::Gust { speed_mps, from_deg })
}

/// What a stuck axis is.
const AXES: &str = "an axis: x (forward), y (right) or z (down)";

fn axis(text: Option<&str>) -> Option<usize> {
    ["x", "y", "z"].iter().position(|name| Some(*name) == text)
}

/// What a stuck servo's value is.
const STUCK: &str = "a share of its travel, such as 30% or -0.3 (without: where it is)";

const KINDS: [Kind; 33] = [
    plain("gps_lost", |_| Some(Fault::GpsLost)),
    valued("gps_late", "seconds up to 1.3, such as 0.25", |v| within(v, 0.0, LATEST_FIX_S, Fault::GpsLate)),
    valued("gps_shift", "metres north, such as 30", |v| within(v, -1e4, 1e4, Fault::GpsShift)),
    plain("magnetometer_lost", |_| Some(Fault::MagnetometerLost)),
    valued("magnetometer_shift", "gauss up to 1, such as 0.05", |v| {
        within(v, -1.0, 1.0, Fault::MagnetometerShift)
    }),
    plain("pitot_lost", |_| Some(Fault::PitotLost)),
    plain("pitot_blocked", |_| Some(Fault::PitotBlocked)),
    plain("pitot_frozen", |_| Some(Fault::PitotFrozen)),
    valued("pitot_slow", "seconds up to 100, such as 5", |v| within(v, 0.1, 100.0, Fault::PitotSlow)),
    valued("pitot_scale", "a factor of the airspeed up to 3, such as 0.8", |v| {
        within(v, 0.0, 3.0, Fault::PitotScale)
    }),
    valued("pitot_icing", "m/s in each second, -20 to 20, such as -0.2", |v| {
        within(v, -20.0, 20.0, Fault::PitotIcing)
    }),
    valued("pitot_noise", "Pa up to 1000, such as 50", |v| within(v, 0.0, 1e3, Fault::PitotNoise)),
    plain("static_blocked", |_| Some(Fault::StaticBlocked)),
    valued("static_slow", "seconds up to 100, such as 5", |v| within(v, 0.1, 100.0, Fault::StaticSlow)),
    plain("range_lost", |_| Some(Fault::RangeLost)),
    plain("range_stuck", |_| Some(Fault::RangeStuck)),
    valued("range_shift", "metres, -50 to 50, such as -1.5", |v| within(v, -50.0, 50.0, Fault::RangeShift)),
    valued("accelerometer_stuck", AXES, |v| axis(v).map(Fault::AccelerometerStuck)),
    valued("gyroscope_stuck", AXES, |v| axis(v).map(Fault::GyroscopeStuck)),
    plain("inertial_lost", |_| Some(Fault::InertialLost)),
    valued("accelerometer_shift", "m/s² up to 50, such as 0.5", |v| {
        within(v, -50.0, 50.0, Fault::AccelerometerShift)
    }),
    valued("gyroscope_shift", "°/s up to 100, such as 2", |v| {
        within(v, -100.0, 100.0, Fault::GyroscopeShift)
    }),
    valued("frames_lost", "a share below 1, such as 1/50 or 2%", |v| {
        share(v?).filter(|share| (0.0..1.0).contains(share)).map(Fault::FramesLost)
    }),
    Kind { ends: true, ..plain("pause", |_| Some(Fault::Pause)) },
    valued("battery", "a share from 0 to 1, such as 10%", |v| {
        share(v?).filter(|share| (0.0..=1.0).contains(share)).map(Fault::Battery)
    }),
    valued("delay", "seconds up to 0.5, such as 0.06", |v| within(v, 0.0, LONGEST_DELAY_S, Fault::Delay)),
    valued("left_aileron_stuck", STUCK, |v| stuck(v, Actuator::LeftAileron)),
    valued("right_aileron_stuck", STUCK, |v| stuck(v, Actuator::RightAileron)),
    valued("elevator_stuck", STUCK, |v| stuck(v, Actuator::Elevator)),
    valued("rudder_stuck", STUCK, |v| stuck(v, Actuator::Rudder)),
    valued("throttle_stuck", "a share from 0 to 1, such as 40% (without: where it is)", |v| {
        stuck(v, Actuator::Throttle)
    }),
    Kind {
        ends: true,
        ..valued("gust", "m/s up to 30 and degrees where from, -360 to 360, such as 8,270", gust)
    },
    Kind {
        ends: true,
        ..valued("updraft", "m/s up to 20, such as -5", |v| within(v, -20.0, 20.0, Fault::Updraft))
    },
];

const fn plain(name: &'static str, read: fn(Option<&str>) -> Option<Fault>) -> Kind {
    Kind { name, value: "", read, ends: false }
}

const fn valued(name: &'static str, value: &'static str, read: fn(Option<&str>) -> Option<Fault>) -> Kind {
    Kind { name, value, read, ends: false }
}

impl Fault {
    /// Every kind as it is written, with what its value is.
    pub fn kinds() -> impl Iterator<Item = (&'static str, &'static str)> {
        KINDS.iter().map(|kind| (kind.name, kind.value))
    }

    fn name(&self) -> &'static str {
        match self {
            Self::GpsLost => "gps_lost",
            Self::GpsLate(_) => "gps_late",
            Self::GpsShift(_) => "gps_shift",
            Self::MagnetometerLost => "magnetometer_lost",
            Self::MagnetometerShift(_) => "magnetometer_shift",
            Self::PitotLost => "pitot_lost",
            Self::PitotBlocked => "pitot_blocked",
            Self::PitotFrozen => "pitot_frozen",
            Self::PitotSlow(_) => "pitot_slow",
            Self::PitotScale(_) => "pitot_scale",
            Self::PitotIcing(_) => "pitot_icing",
            Self::PitotNoise(_) => "pitot_noise",
            Self::StaticBlocked => "static_blocked",
            Self::StaticSlow(_) => "static_slow",
            Self::RangeLost => "range_lost",
            Self::RangeStuck => "range_stuck",
            Self::RangeShift(_) => "range_shift",
            Self::AccelerometerStuck(_) => "accelerometer_stuck",
            Self::GyroscopeStuck(_) => "gyroscope_stuck",
            Self::InertialLost => "inertial_lost",
            Self::AccelerometerShift(_) => "accelerometer_shift",
            Self::GyroscopeShift(_) => "gyroscope_shift",
            Self::FramesLost(_) => "frames_lost",
            Self::Pause => "pause",
            Self::Battery(_) => "battery",
            Self::Delay(_) => "delay",
            Self::Stuck(Actuator::LeftAileron, _) => "left_aileron_stuck",
            Self::Stuck(Actuator::RightAileron, _) => "right_aileron_stuck",
            Self::Stuck(Actuator::Elevator, _) => "elevator_stuck",
            Self::Stuck(Actuator::Rudder, _) => "rudder_stuck",
            Self::Stuck(Actuator::Throttle, _) => "throttle_stuck",
            Self::Gust { .. } => "gust",
            Self::Updraft(_) => "updraft",
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())?;
        match self {
            Self::GpsLate(value)
            | Self::GpsShift(value)
            | Self::MagnetometerShift(value)
            | Self::AccelerometerShift(value)
            | Self::GyroscopeShift(value)
            | Self::FramesLost(value)
            | Self::Battery(value)
            | Self::PitotSlow(value)
            | Self::PitotScale(value)
            | Self::PitotIcing(value)
            | Self::PitotNoise(value)
            | Self::StaticSlow(value)
            | Self::RangeShift(value)
            | Self::Delay(value)
            | Self::Stuck(_, Some(value))
            | Self::Updraft(value) => write!(f, "={value}"),
            Self::Gust { speed_mps, from_deg } => write!(f, "={speed_mps},{from_deg}"),
            Self::AccelerometerStuck(axis) | Self::GyroscopeStuck(axis) => {
                write!(f, "={}", ["x", "y", "z"][*axis])
            }
            _ => Ok(()),
        }
    }
}

impl fmt::Display for PlannedFault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}@{}", self.fault, self.from_s)?;
        if self.to_s.is_finite() { write!(f, "..{}", self.to_s) } else { Ok(()) }
    }
}

impl FromStr for PlannedFault {
    type Err = FaultError;

    fn from_str(text: &str) -> Result<Self, FaultError> {
        let (what, when) = text.split_once('@').map_or((text, None), |(what, when)| (what, Some(when)));
        let (name, value) = what.split_once('=').map_or((what, None), |(name, value)| (name, Some(value)));
        let Some(kind) = KINDS.iter().find(|kind| kind.name == name) else {
            return Err(FaultError(unknown("fault", name, KINDS.iter().map(|kind| kind.name))));
        };
        if kind.value.is_empty() && value.is_some() {
            return Err(FaultError(format!("`{name}` takes no value: write {name}@100..130")));
        }
        let wrong = || {
            FaultError(match value {
                Some(value) => format!("`{name}` can not be `{value}`; it takes {}", kind.value),
                None => format!("`{name}` needs a value: {}", kind.value),
            })
        };
        let fault = (kind.read)(value).ok_or_else(wrong)?;
        let (from_s, to_s) = times(when).ok_or_else(|| {
            FaultError(format!("`{text}` has no sensible time: write {what}@100 or {what}@100..130, seconds"))
        })?;
        if kind.ends && !to_s.is_finite() {
            return Err(FaultError(format!("`{name}` has to end: write {what}@100..103, seconds")));
        }
        Ok(Self { fault, from_s, to_s })
    }
}

/// The beginning and the end of `FROM` or `FROM..TO`.
fn times(when: Option<&str>) -> Option<(f64, f64)> {
    let Some(when) = when else { return Some((0.0, f64::INFINITY)) };
    let second = |text: &str| {
        let time: f64 = text.strip_suffix('s').unwrap_or(text).parse().ok()?;
        (time.is_finite() && time >= 0.0).then_some(time)
    };
    match when.split_once("..") {
        None => Some((second(when)?, f64::INFINITY)),
        Some((from, to)) => {
            let (from, to) = (second(from)?, second(to)?);
            (from < to).then_some((from, to))
        }
    }
}

impl PlannedFault {
    /// Whether it acts at a time, s.
    pub fn is_active(&self, time_s: f64) -> bool {
        self.from_s <= time_s && time_s < self.to_s
    }

    /// Share of a gust's greatest speed at a time.
    fn swell(&self, time_s: f64) -> f64 {
        let through = (time_s - self.from_s) / (self.to_s - self.from_s);
        if through.is_finite() { 0.5 * (1.0 - (TAU * through).cos()) } else { 0.0 }
    }
}

/// What is wrong at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Wrongs {
    pub(crate) gps_lost: bool,
    pub(crate) gps_late_s: f64,
    pub(crate) gps_shift_m: f64,
    pub(crate) magnetometer_lost: bool,
    pub(crate) magnetometer_shift_gauss: f64,
    pub(crate) pitot_lost: bool,
    pub(crate) pitot: PitotWrongs,
    pub(crate) static_blocked: bool,
    pub(crate) static_slow_s: f64,
    pub(crate) range_lost: bool,
    pub(crate) range_stuck: bool,
    pub(crate) range_shift_m: f64,
    pub(crate) accelerometer_stuck: [bool; 3],
    pub(crate) gyroscope_stuck: [bool; 3],
    pub(crate) inertial_lost: bool,
    pub(crate) accelerometer_shift_mps2: f64,
    pub(crate) gyroscope_shift_radps: f64,
    pub(crate) frames_lost: f64,
    pub(crate) gust_ned_mps: Vector3<f64>,
    pub(crate) actuation: Actuation,
}

/// What is wrong with the pitot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PitotWrongs {
    pub(crate) blocked: bool,
    pub(crate) frozen: bool,
    pub(crate) slow_s: f64,
    pub(crate) scale: f64,
    pub(crate) ice_mps: f64,
    pub(crate) noise_pa: f64,
}

impl Default for PitotWrongs {
    fn default() -> Self {
        Self { blocked: false, frozen: false, slow_s: 0.0, scale: 1.0, ice_mps: 0.0, noise_pa: 0.0 }
    }
}

/// What is wrong with the actuators.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Actuation {
    pub(crate) delay_s: f64,
    /// By [`Actuator`]: the outer `None` if it works, the inner one if it stays where it is.
    pub(crate) stuck: [Option<Option<f64>>; 5],
}

impl Wrongs {
    /// All that the plan has for an instant, s.
    pub(crate) fn at(plan: &[PlannedFault], time_s: f64) -> Self {
        let mut wrongs = Self::default();
        for planned in plan.iter().filter(|planned| planned.is_active(time_s)) {
            wrongs.add(&planned.fault, planned.swell(time_s), time_s - planned.from_s);
        }
        wrongs
    }

    fn add(&mut self, fault: &Fault, swell: f64, since_s: f64) {
        match *fault {
            Fault::GpsLost => self.gps_lost = true,
            Fault::GpsLate(late_s) => self.gps_late_s += late_s,
            Fault::GpsShift(north_m) => self.gps_shift_m += north_m,
            Fault::RangeLost => self.range_lost = true,
            Fault::RangeStuck => self.range_stuck = true,
            Fault::RangeShift(shift_m) => self.range_shift_m += shift_m,
            Fault::MagnetometerLost => self.magnetometer_lost = true,
            Fault::MagnetometerShift(gauss) => self.magnetometer_shift_gauss += gauss,
            Fault::PitotLost => self.pitot_lost = true,
            Fault::PitotBlocked => self.pitot.blocked = true,
            Fault::PitotFrozen => self.pitot.frozen = true,
            Fault::PitotSlow(slow_s) => self.pitot.slow_s = self.pitot.slow_s.max(slow_s),
            Fault::PitotScale(scale) => self.pitot.scale *= scale,
            Fault::PitotIcing(mps2) => self.pitot.ice_mps += mps2 * since_s,
            Fault::PitotNoise(pa) => self.pitot.noise_pa = Vector2::new(self.pitot.noise_pa, pa).norm(),
            Fault::StaticBlocked => self.static_blocked = true,
            Fault::StaticSlow(slow_s) => self.static_slow_s = self.static_slow_s.max(slow_s),
            Fault::AccelerometerStuck(axis) => self.accelerometer_stuck[axis] = true,
            Fault::GyroscopeStuck(axis) => self.gyroscope_stuck[axis] = true,
            Fault::InertialLost => self.inertial_lost = true,
            Fault::AccelerometerShift(mps2) => self.accelerometer_shift_mps2 += mps2,
            Fault::GyroscopeShift(degps) => self.gyroscope_shift_radps += degps.to_radians(),
            Fault::FramesLost(share) => self.frames_lost = self.frames_lost.max(share),
            Fault::Pause | Fault::Battery(_) => {}
            Fault::Delay(delay_s) => self.actuation.delay_s += delay_s,
            Fault::Stuck(actuator, at) => self.actuation.stuck[actuator as usize] = Some(at),
            Fault::Gust { speed_mps, from_deg } => {
                let (sin, cos) = from_deg.to_radians().sin_cos();
                self.gust_ned_mps -= Vector3::new(cos, sin, 0.0) * (speed_mps * swell);
            }
            Fault::Updraft(mps) => self.gust_ned_mps.z -= mps * swell,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(text: &str) -> PlannedFault {
        text.parse().unwrap()
    }

    fn refused(text: &str) -> String {
        text.parse::<PlannedFault>().unwrap_err().to_string()
    }

    #[test]
    fn faults_are_read_with_value_and_times() {
        let lost = PlannedFault { fault: Fault::GpsLost, from_s: 100.0, to_s: 130.0 };
        assert_eq!(parsed("gps_lost@100..130"), lost);
        assert_eq!(parsed("gps_lost@100s..130s"), lost);
        assert_eq!(parsed("magnetometer_lost").to_s, f64::INFINITY);
        let stuck = Fault::Stuck(Actuator::LeftAileron, Some(0.3));
        assert_eq!(parsed("left_aileron_stuck=30%@60").fault, stuck);
        assert_eq!(parsed("frames_lost=1/50").fault, Fault::FramesLost(0.02));
        assert_eq!(parsed("rudder_stuck").fault, Fault::Stuck(Actuator::Rudder, None));
    }

    #[test]
    fn every_kind_comes_back_from_its_own_text() {
        let values = ["", "=0.25", "=0.5,270", "=y"];
        let mut found = 0;
        for kind in &KINDS {
            let texts = values.iter().map(|value| format!("{}{value}@1..2", kind.name));
            let read: Vec<PlannedFault> = texts.filter_map(|text| text.parse().ok()).collect();
            assert!(!read.is_empty(), "{}", kind.name);
            for fault in read {
                assert_eq!(parsed(&fault.to_string()), fault);
                assert_eq!(fault.fault.name(), kind.name);
                found += 1;
            }
        }
        assert!(found > KINDS.len(), "servos can be stuck with and without a value");
    }

    #[test]
    fn mistakes_are_answered_with_the_way_to_mend_them() {
        assert!(refused("gps_last@3").contains("did you mean `gps_lost`"), "{}", refused("gps_last@3"));
        assert!(refused("gps_lost=3").contains("takes no value"));
        assert!(refused("delay").contains("such as 0.06"));
        assert!(refused("delay=9").contains("up to 0.5"));
        assert!(refused("frames_lost=3").contains("1/50"));
        assert!(refused("throttle_stuck=-0.5").contains("from 0 to 1"));
        assert!(refused("gust=8@1..2").contains("8,270"));
        let strong = refused("gust=300,0@60..63");
        assert!(strong.contains("can not be `300,0`") && strong.contains("up to 30"), "{strong}");
        for wrong in ["gps_lost@", "gps_lost@5..3", "gps_lost@-1", "gps_lost@nan", "gps_lost@1..inf"] {
            assert!(refused(wrong).contains("@100..130"), "{wrong}: {}", refused(wrong));
        }
        assert!(refused("gust=8,270@5").contains("has to end"));
    }

    #[test]
    fn fault_acts_from_its_beginning_until_just_before_its_end() {
        let plan = [parsed("gps_lost@100..130")];
        let lost = |time_s| Wrongs::at(&plan, time_s).gps_lost;
        assert_eq!([99.999, 100.0, 129.999, 130.0].map(lost), [false, true, true, false]);
    }

    #[test]
    fn gust_swells_to_its_speed_and_dies() {
        let plan = [parsed("gust=8,270@10..20"), parsed("updraft=2@10..20")];
        let at = |time_s| Wrongs::at(&plan, time_s).gust_ned_mps;
        assert!(at(10.0).norm() < 1e-12);
        assert!((at(15.0) - Vector3::new(0.0, 8.0, -2.0)).norm() < 1e-9, "{}", at(15.0));
        assert!((at(12.5).norm() - 0.5 * at(15.0).norm()).abs() < 1e-9);
        assert_eq!(at(20.0), Vector3::zeros());
    }
}
