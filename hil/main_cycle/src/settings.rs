//! What a plan says of the five functions: their attributes, when each runs in a cycle, how long values are valid.

use std::collections::BTreeMap;

use bateleur_apex::{AttributeError, Attributes, StartError};
use bateleur_controller::planned_waypoints;
use bateleur_flight::guidance::Waypoint;
use serde_json::Value;

/// The attributes of one function, as its plan and the flight's options give them.
pub type Given = BTreeMap<String, Value>;

/// When each function runs, from the start of a cycle, ns. They rise.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Instants {
    /// GPS.
    pub gps_ns: u64,
    /// IMU.
    pub imu_ns: u64,
    /// Estimator.
    pub estimator_ns: u64,
    /// Controller.
    pub controller_ns: u64,
    /// Servo.
    pub servo_ns: u64,
    /// The cycle.
    pub period_ns: u64,
}

/// Ages up to which a value is used, ns, by the function that uses it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Validity {
    /// GPS: what the receiver said.
    pub gps_raw_ns: u64,
    /// IMU: what the sensors said.
    pub imu_raw_ns: u64,
    /// Estimator: position and velocity of the receiver.
    pub estimator_gps_ns: [u64; 2],
    /// Estimator: acceleration, rates, field, pressure.
    pub estimator_imu_ns: [u64; 4],
    /// Estimator: command of the cycle before, where the plan lets it have that.
    pub estimator_command_ns: Option<u64>,
    /// Controller: state, acceleration, rates, pressure.
    pub controller_ns: [u64; 4],
    /// Controller: the distance to the ground, if it reads it.
    pub controller_range_ns: Option<u64>,
    /// Servo: command and sticks.
    pub servo_ns: [u64; 2],
}

/// The settings of all five.
#[derive(Debug, Clone)]
pub struct Settings {
    pub(crate) origin: bateleur_gps::Origin,
    pub(crate) imu: bateleur_imu::Settings,
    pub(crate) estimator: bateleur_estimator::Settings,
    pub(crate) controller: bateleur_controller::Settings,
    pub(crate) waypoints: Vec<Waypoint>,
    pub(crate) servo: bateleur_servo::Settings,
    pub(crate) instants: Instants,
    pub(crate) validity: Validity,
}

impl Settings {
    /// Reads what is given to GPS, IMU, Estimator, Controller and Servo, exactly as the partitions read it.
    ///
    /// # Errors
    /// When one of them would refuse to start with it.
    pub fn read(given: [Given; 5], instants: Instants, validity: Validity) -> Result<Self, StartError> {
        let [mut gps, mut imu, mut estimator, mut controller, mut servo] = given.map(Attributes::new);
        let settings = Self {
            origin: bateleur_gps::origin(&mut gps)?,
            imu: bateleur_imu::Settings::read(&mut imu)?,
            estimator: bateleur_estimator::Settings::read(&mut estimator)?,
            controller: bateleur_controller::Settings::read(&mut controller)?,
            waypoints: planned_waypoints(&mut controller)?,
            servo: bateleur_servo::Settings::read(&mut servo)?,
            instants,
            validity,
        };
        let all = [gps, imu, estimator, controller, servo];
        all.iter()
            .try_for_each(Attributes::all_known)
            .map_err(|error: AttributeError| error.into())
            .map(|()| settings)
    }
}
