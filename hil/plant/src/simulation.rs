//! The plant as a whole: aircraft, wind and sensors on one clock.

use crate::aerodynamics::Surfaces;
use crate::airframe::{Airframe, AirframeError};
use crate::dynamics::{Aircraft, Model};
use crate::fault::{PlannedFault, Wrongs};
use crate::geodesy::{Geodetic, LocalFrame};
use crate::sensors::{Instant, SensorErrors, SensorSet, SensorSuite};
use crate::trim::{self, TrimError};
use crate::wind::{AirMotion, Passage, Turbulence, Wind};
use nalgebra::{UnitQuaternion, Vector3};
use thiserror::Error;

/// Length of one internal step, s. Every step the caller asks for is a whole number of these.
pub const STEP_S: f64 = 0.0025;

/// Commands to the actuators. Signs: aileron positive rolls right, elevator positive pitches down, rudder positive
/// turns the nose left; the throttle is 0 to 1. Values beyond the stops are cut; one that is not a number leaves the
/// last one standing.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Controls {
    /// Aileron, rad.
    pub aileron_rad: f64,
    /// Elevator, rad.
    pub elevator_rad: f64,
    /// Rudder, rad.
    pub rudder_rad: f64,
    /// Throttle, 0 to 1.
    pub throttle: f64,
}

impl Controls {
    /// These commands, with those that are not numbers taken from another set.
    pub(crate) fn or(&self, last: &Self) -> Self {
        let pick = |new: f64, old: f64| if new.is_finite() { new } else { old };
        Self {
            aileron_rad: pick(self.aileron_rad, last.aileron_rad),
            elevator_rad: pick(self.elevator_rad, last.elevator_rad),
            rudder_rad: pick(self.rudder_rad, last.rudder_rad),
            throttle: pick(self.throttle, last.throttle),
        }
    }
}

/// Everything about a flight that is not the airframe.
#[derive(Clone, Debug, PartialEq)]
pub struct Conditions {
    /// Seed of all chance.
    pub seed: u64,
    /// Mean wind, m/s.
    pub wind_speed_mps: f64,
    /// Direction the mean wind comes from, clockwise from north, rad.
    pub wind_from_rad: f64,
    /// Gusts; no level implies a mean wind.
    pub turbulence: Turbulence,
    /// Whether gusts also rotate the air. Default yes.
    pub angular_gusts: bool,
    /// Errors of the sensors.
    pub sensors: SensorErrors,
    /// What goes wrong, and when. Default nothing.
    pub faults: Vec<PlannedFault>,
    /// Height of the runway above mean sea level, m. Default 0: the seed project names none.
    pub runway_elevation_m: f64,
    /// Heading of an aircraft parked on the runway, rad. Default 0, north.
    pub runway_heading_rad: f64,
}

impl Default for Conditions {
    fn default() -> Self {
        Self {
            seed: 1,
            wind_speed_mps: 0.0,
            wind_from_rad: 0.0,
            turbulence: Turbulence::Calm,
            angular_gusts: true,
            sensors: SensorErrors::default(),
            faults: Vec::new(),
            runway_elevation_m: 0.0,
            runway_heading_rad: 0.0,
        }
    }
}

/// A start in trimmed flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlightStart {
    /// North of the runway, m.
    pub north_m: f64,
    /// East of the runway, m.
    pub east_m: f64,
    /// Height above the runway, m.
    pub height_m: f64,
    /// Direction of the motion through the air, clockwise from north, rad.
    pub heading_rad: f64,
    /// Airspeed, m/s.
    pub airspeed_mps: f64,
}

impl Default for FlightStart {
    fn default() -> Self {
        Self { north_m: 0.0, east_m: 0.0, height_m: 160.0, heading_rad: 0.0, airspeed_mps: 22.0 }
    }
}

/// Why a flight could not begin.
#[derive(Debug, Error)]
pub enum StartError {
    /// The airframe, perhaps varied by the caller, makes no sense.
    #[error(transparent)]
    Airframe(#[from] AirframeError),
    /// It cannot fly at the airspeed asked for.
    #[error(transparent)]
    Trim(#[from] TrimError),
}

/// What is really the case; for scores, displays and tests, never for the flight computer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Truth {
    /// Time since the start, s.
    pub time_s: f64,
    /// Position from the runway, NED, m.
    pub position_ned_m: Vector3<f64>,
    /// The same as latitude, longitude, height.
    pub geodetic: Geodetic,
    /// Velocity over ground, NED, m/s.
    pub velocity_ned_mps: Vector3<f64>,
    /// Rotation from body axes to NED.
    pub attitude: UnitQuaternion<f64>,
    /// Roll, rad, −π to π.
    pub roll_rad: f64,
    /// Pitch, rad, −π/2 to π/2.
    pub pitch_rad: f64,
    /// Yaw from true north, rad, −π to π.
    pub yaw_rad: f64,
    /// Rates over ground, body axes, rad/s.
    pub rates_radps: Vector3<f64>,
    /// Specific force at this instant, body axes, m/s².
    pub specific_force_mps2: Vector3<f64>,
    /// Airspeed, gusts included, m/s.
    pub airspeed_mps: f64,
    /// Angle of attack, rad.
    pub alpha_rad: f64,
    /// Sideslip, rad, positive with air from the right.
    pub beta_rad: f64,
    /// Wind and gust, NED, m/s.
    pub wind_ned_mps: Vector3<f64>,
    /// The gust alone, NED, m/s.
    pub gust_ned_mps: Vector3<f64>,
    /// Rotation of the air, body axes, rad/s.
    pub gust_rates_radps: Vector3<f64>,
    /// Air density, kg/m³.
    pub density_kgpm3: f64,
    /// Where the surfaces are.
    pub surfaces: Surfaces,
    /// Throttle that acts, 0 to 1.
    pub throttle: f64,
    /// Thrust, N.
    pub thrust_n: f64,
    /// Shaft speed of the propeller, rad/s.
    pub propeller_radps: f64,
    /// Whether anything touches the ground.
    pub on_ground: bool,
    /// Whether the aircraft is lost. It then lies where it fell.
    pub crashed: bool,
    /// Slow error of the satellite receiver, NED, m: reported minus true.
    pub gps_slow_error_ned_m: Vector3<f64>,
    /// Slow error of the barometer, m of height: reported minus true.
    pub barometer_bias_m: f64,
    /// Bias of the accelerometer, body axes, m/s².
    pub accelerometer_bias_mps2: Vector3<f64>,
    /// Bias of the gyroscope, body axes, rad/s.
    pub gyroscope_bias_radps: Vector3<f64>,
    /// Bias of the magnetometer, body axes, gauss.
    pub magnetometer_bias_gauss: Vector3<f64>,
}

/// One aircraft in one flight.
#[derive(Clone, Debug)]
pub struct Simulation {
    aircraft: Aircraft,
    wind: Wind,
    air: AirMotion,
    sensors: SensorSuite,
    faults: Vec<PlannedFault>,
    frame: LocalFrame,
    step: u64,
}

impl Simulation {
    /// An aircraft at rest on the runway.
    ///
    /// # Errors
    /// When the airframe makes no sense.
    pub fn new(airframe: &Airframe, conditions: &Conditions) -> Result<Self, AirframeError> {
        airframe.check()?;
        let model = Model::new(airframe, conditions.runway_elevation_m);
        Ok(Self::with(Aircraft::parked(model, conditions.runway_heading_rad), conditions))
    }

    /// An aircraft in straight, level, trimmed flight, carried along by the mean wind, its controls in trim.
    ///
    /// # Errors
    /// When the airframe makes no sense or cannot fly at that airspeed.
    pub fn in_flight(
        airframe: &Airframe,
        conditions: &Conditions,
        start: &FlightStart,
    ) -> Result<Self, StartError> {
        airframe.check()?;
        let altitude = conditions.runway_elevation_m + start.height_m;
        let trim = trim::trim(airframe, start.airspeed_mps, 0.0, altitude)?;
        let position = Vector3::new(start.north_m, start.east_m, -start.height_m);
        let mut state = trim::flight_state(&trim, start.heading_rad, position);
        let wind = Self::wind(airframe, conditions);
        state.velocity += wind.mean_ned();
        let model = Model::new(airframe, conditions.runway_elevation_m);
        Ok(Self::with(Aircraft::new(model, state, trim.controls), conditions))
    }

    fn wind(airframe: &Airframe, c: &Conditions) -> Wind {
        let span = airframe.geometry.wing_span_m;
        Wind::new(c.seed, c.wind_speed_mps, c.wind_from_rad, c.turbulence, c.angular_gusts, span)
    }

    fn with(aircraft: Aircraft, conditions: &Conditions) -> Self {
        let wind = Self::wind(&aircraft.model().airframe, conditions);
        let air = AirMotion { velocity_ned: wind.mean_ned(), ..AirMotion::default() };
        let elevation = conditions.runway_elevation_m;
        Self {
            aircraft,
            air,
            wind,
            sensors: SensorSuite::new(conditions.seed, &conditions.sensors, elevation),
            faults: conditions.faults.clone(),
            frame: LocalFrame::new(elevation),
            step: 0,
        }
    }

    /// Flies on for `dt_s` seconds with the commands held. The time is rounded to whole steps of [`STEP_S`]; how it is
    /// cut into calls does not change the flight.
    pub fn advance(&mut self, controls: Controls, dt_s: f64) {
        for _ in 0..(dt_s / STEP_S).round() as u64 {
            let wrongs = self.wrongs();
            self.air = self.wind.step(&self.passage(), STEP_S);
            self.air.velocity_ned += wrongs.gust_ned_mps;
            self.air.gust_ned += wrongs.gust_ned_mps;
            let mean = self.aircraft.step(&controls, &self.air, &wrongs.actuation);
            self.step += 1;
            let wrongs = self.wrongs();
            self.sensors.follow(self.step, &mean, self.aircraft.state(), &wrongs);
        }
    }

    fn wrongs(&self) -> Wrongs {
        Wrongs::at(&self.faults, self.time_s())
    }

    fn passage(&self) -> Passage {
        let state = self.aircraft.state();
        Passage {
            height_m: -state.position.z,
            airspeed_mps: (state.velocity - self.air.velocity_ned).norm(),
            to_body: state.attitude.inverse().to_rotation_matrix(),
        }
    }

    /// Samples the sensors. Inertial values are means since the last call; a fix is given once. What a faulty sensor does
    /// not give is not a number; a set that is lost has an interval of zero.
    pub fn sensors(&mut self) -> SensorSet {
        let state = self.aircraft.state();
        let now = Instant {
            step: self.step,
            state,
            specific_force: self.aircraft.specific_force(&self.air),
            airspeed_mps: (state.velocity - self.air.velocity_ned).norm(),
            density: self.aircraft.model().density(&state.position),
            wrongs: self.wrongs(),
        };
        self.sensors.sample(&now)
    }

    /// Time since the start, s.
    pub fn time_s(&self) -> f64 {
        self.step as f64 * STEP_S
    }

    /// What is really the case.
    pub fn truth(&self) -> Truth {
        let state = self.aircraft.state();
        let held = self.aircraft.held(&self.air);
        let air = self.aircraft.model().air_data(state, &self.air, held.density);
        let propeller = self.aircraft.model().thrust(&air, held.throttle);
        let (roll_rad, pitch_rad, yaw_rad) = state.attitude.euler_angles();
        let [accelerometer, gyroscope, magnetometer] = self.sensors.biases();
        Truth {
            time_s: self.time_s(),
            position_ned_m: state.position,
            geodetic: self.frame.to_geodetic(&state.position),
            velocity_ned_mps: state.velocity,
            attitude: state.attitude,
            roll_rad,
            pitch_rad,
            yaw_rad,
            rates_radps: state.rates,
            specific_force_mps2: self.aircraft.specific_force(&self.air),
            airspeed_mps: air.airspeed,
            alpha_rad: air.alpha,
            beta_rad: air.beta,
            wind_ned_mps: self.air.velocity_ned,
            gust_ned_mps: self.air.gust_ned,
            gust_rates_radps: self.air.rates_body,
            density_kgpm3: held.density,
            surfaces: held.surfaces,
            throttle: held.throttle,
            thrust_n: propeller.thrust_n,
            propeller_radps: propeller.speed_radps,
            on_ground: self.aircraft.on_ground(),
            crashed: self.aircraft.crashed(),
            gps_slow_error_ned_m: self.sensors.gps_slow_error(),
            barometer_bias_m: self.sensors.barometer_bias(),
            accelerometer_bias_mps2: accelerometer,
            gyroscope_bias_radps: gyroscope,
            magnetometer_bias_gauss: magnetometer,
        }
    }
}
