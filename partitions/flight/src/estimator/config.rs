//! What one may set on the estimator; every default stands with its reason.

use super::filter::ProcessNoise;
use crate::STANDING_HEIGHT_M;
use crate::magnetic::{MagneticError, Site, field_ned_gauss};
use nalgebra::Vector3;

/// Which measurements are fused. Without GPS the filter runs on inertial values alone ("full inertial").
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Aiding {
    /// GPS position and velocity.
    pub gps: bool,
    /// Barometer and pitot tube; off gives the seed's filter, where pressure goes to the controller only.
    pub pressure: bool,
    /// Magnetometer.
    pub magnetometer: bool,
}

impl Default for Aiding {
    fn default() -> Self {
        Self { gps: true, pressure: true, magnetometer: true }
    }
}

/// Standard deviations of the measurements, and when they are refused.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasurementNoise {
    /// GPS horizontal position, m, without the slow error, which no filter can see.
    pub gps_horizontal_m: f64,
    /// GPS height while no barometer reference holds, m.
    pub gps_vertical_m: f64,
    /// GPS height while the barometer carries the height, m: large, or the receiver's slow error would come in.
    pub gps_vertical_with_barometer_m: f64,
    /// GPS velocity, each axis, m/s.
    pub gps_velocity_mps: f64,
    /// Barometric height after averaging to 25 Hz, m (10 Pa are 0.83 m).
    pub barometer_m: f64,
    /// Airspeed against ground velocity and steady wind, m/s: turbulence is noise here. With GPS it corrects the
    /// wind alone, for gusts last ten seconds and would be taken for motion.
    pub airspeed_mps: f64,
    /// Air from the side, m/s: none on average in coordinated flight, which makes both components of the wind
    /// observable on a straight leg. It corrects the wind alone, and the whole state where no magnetometer is taken.
    /// Gusts raise it without GPS.
    pub sideslip_mps: f64,
    /// Height above the runway from which the flight is taken to be coordinated, m; wheels roll sideways to the air.
    pub sideslip_height_m: f64,
    /// The same as `airspeed_mps` without GPS, when it has to carry the velocity, in still air; gusts raise it.
    pub airspeed_without_gps_mps: f64,
    /// Magnetometer, each axis, gauss.
    pub magnetometer_gauss: f64,
    /// Innovations beyond this many standard deviations are refused.
    pub gate_sigma: f64,
    /// Refused for this long, s: the GPS states are set anew.
    pub gps_patience_s: f64,
    /// Refused for this long, s: the state that barometer, pitot or magnetometer disagree with is set anew.
    pub other_patience_s: f64,
    /// Least interval between two barometer updates, s.
    pub barometer_interval_s: f64,
    /// Least interval between two pitot updates, s: nearer ones see the same gust.
    pub airspeed_interval_s: f64,
    /// Least interval between two magnetometer updates, s.
    pub magnetometer_interval_s: f64,
    /// Below this airspeed the pitot is not used, m/s: the pressure falls with the square.
    pub least_airspeed_mps: f64,
}

impl Default for MeasurementNoise {
    fn default() -> Self {
        Self {
            gps_horizontal_m: 0.5,
            gps_vertical_m: 1.0,
            gps_vertical_with_barometer_m: 20.0,
            gps_velocity_mps: 0.06,
            barometer_m: 0.7,
            airspeed_mps: 4.0,
            sideslip_mps: 5.0,
            sideslip_height_m: 8.0,
            airspeed_without_gps_mps: 6.0,
            magnetometer_gauss: 0.002,
            gate_sigma: 5.0,
            gps_patience_s: 1.5,
            other_patience_s: 5.0,
            barometer_interval_s: 0.04,
            airspeed_interval_s: 0.1,
            magnetometer_interval_s: 0.1,
            least_airspeed_mps: 10.0,
        }
    }
}

/// Standard deviations right after alignment, where nothing better is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InitialSigmas {
    /// Velocity, m/s.
    pub velocity_mps: f64,
    /// Position, m.
    pub position_m: f64,
    /// Gyroscope bias after averaging at standstill, rad/s.
    pub gyro_bias_ground: f64,
    /// Gyroscope bias after a start in flight, rad/s.
    pub gyro_bias_flight: f64,
    /// Accelerometer bias, m/s² (50 mg are 0.49).
    pub accel_bias: f64,
    /// Magnetometer bias, gauss.
    pub mag_bias: f64,
    /// Wind, m/s.
    pub wind: f64,
}

impl Default for InitialSigmas {
    fn default() -> Self {
        Self {
            velocity_mps: 0.3,
            position_m: 1.5,
            gyro_bias_ground: 1e-3,
            gyro_bias_flight: 0.02,
            accel_bias: 0.3,
            mag_bias: 0.01,
            wind: 5.0,
        }
    }
}

/// Everything the estimator needs to be told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EstimatorConfig {
    /// Earth's field at the site, NED, gauss.
    pub field_ned_gauss: Vector3<f64>,
    /// What is fused.
    pub aiding: Aiding,
    /// What drives the errors.
    pub process: ProcessNoise,
    /// What the measurements are worth.
    pub measurement: MeasurementNoise,
    /// What is known at the start.
    pub initial: InitialSigmas,
    /// Usual angle of attack, rad: only for the weak direction-of-flight vector of a start in flight.
    pub incidence_rad: f64,
    /// Height of the inertial sensors above the runway while the aircraft stands on it, m.
    pub standing_height_m: f64,
    /// Latency of GPS that its time stamps do not tell, s: taken off the stamp.
    /// Zero for receivers that stamp the measurement time.
    pub gps_extra_latency_s: f64,
    /// A gap in the inertial data longer than this, s, ends the state: it is found anew in flight.
    pub longest_gap_s: f64,
}

impl EstimatorConfig {
    /// Defaults with the World Magnetic Model's field at a site.
    pub fn at_site(site: &Site) -> Result<Self, MagneticError> {
        Ok(Self::with_field(field_ned_gauss(site)?))
    }

    /// Defaults with a given field, NED, gauss.
    pub fn with_field(field_ned_gauss: Vector3<f64>) -> Self {
        Self {
            field_ned_gauss,
            aiding: Aiding::default(),
            process: ProcessNoise::default(),
            measurement: MeasurementNoise::default(),
            initial: InitialSigmas::default(),
            incidence_rad: 0.08,
            standing_height_m: STANDING_HEIGHT_M,
            gps_extra_latency_s: 0.0,
            longest_gap_s: 0.5,
        }
    }
}
