//! The function that estimates position, velocity and attitude.
//!
//! Responsible for: bringing measurements to the filter of `bateleur-flight` in the right order and once each, and its
//! state to those who fly on it. Time comes from the measurements alone. It must never say that a state can be used
//! while the filter has none.

mod kept;
mod parameters;
mod remarks;
mod settings;
mod state;

pub use kept::Kept;
pub use parameters::{Memory, parameters};
pub use remarks::{Remark, Remarks};
pub use settings::Settings;
pub use state::{message, telemetry};

use bateleur_flight::estimator::{
    Aiding, Estimator, EstimatorConfig, GpsMeasurement, Health, ImuSample, NavigationState, Start,
};
use bateleur_flight::stuck::Stuck;
use bateleur_messages::control::PITOT_NOT_BELIEVED;
use bateleur_messages::ground::EstimatorOrder;
use bateleur_messages::state::{STATUS_COARSE, STATUS_DISABLED};
use bateleur_messages::{
    Acceleration, ActuatorCommand, FunctionStatus, GpsPosition, GpsVelocity, Magnetization, Pressure, Rates,
    State,
};
use nalgebra::Vector3;

/// Airspeed above which an aircraft is not called standing, m/s.
const FLYING_MPS: f64 = 10.0;
/// Samples in a row that lie before the last good one, after which the sensors' clock counts as set back: the
/// simulator was started anew. Half a second at 50 Hz.
const SET_BACK_SAMPLES: u32 = 25;
/// Windows in a row without inertial values after which the state is no longer one to rely on, and after which there is none: a
/// tenth of a second at 50 Hz.
const DOUBTED_WINDOWS: u32 = 3;
const SILENT_WINDOWS: u32 = 5;

/// What is there in one window; each only if it is valid.
#[derive(Debug, Clone, Copy, Default)]
pub struct Inputs<'a> {
    /// From IMU.
    pub acceleration: Option<&'a Acceleration>,
    /// From IMU.
    pub orientation: Option<&'a Rates>,
    /// From IMU.
    pub magnetization: Option<&'a Magnetization>,
    /// From IMU.
    pub pressure: Option<&'a Pressure>,
    /// From GPS.
    pub gps_position: Option<&'a GpsPosition>,
    /// From GPS.
    pub gps_velocity: Option<&'a GpsVelocity>,
    /// From the Controller, of the cycle before: it says whether the pitot is believed.
    pub command: Option<&'a ActuatorCommand>,
}

/// Time stamps of what was used last, ns.
#[derive(Debug, Clone, Copy, Default)]
struct Used {
    inertial: Option<u64>,
    field: Option<u64>,
    pressure: Option<u64>,
    gps: Option<u64>,
}

/// The function.
#[derive(Debug)]
pub struct Function {
    estimator: Box<Estimator>,
    enabled: bool,
    used: Used,
    set_back: u32,
    /// Windows in a row without inertial values.
    silent: u32,
    stuck: Stuck,
    airspeed_mps: f64,
    speed_mps: f64,
    /// What the filter knew when it was disabled.
    parked: Option<Box<Kept>>,
    accepted: u64,
    missing: u64,
}

impl Function {
    /// A function that finds its state by itself, on the ground or in flight. `pressure_aiding` lets barometer and pitot
    /// in. It goes on where `kept` stood; `now_s` is the module's time, s.
    pub fn new(mut config: EstimatorConfig, pressure_aiding: bool, kept: Option<&Kept>, now_s: f64) -> Self {
        config.aiding = Aiding { pressure: pressure_aiding, ..config.aiding };
        let mut function = Self {
            estimator: Box::new(Estimator::new(config)),
            enabled: true,
            used: Used::default(),
            set_back: 0,
            silent: 0,
            stuck: Stuck::default(),
            airspeed_mps: 0.0,
            speed_mps: 0.0,
            parked: None,
            accepted: 0,
            missing: 0,
        };
        if let Some(kept) = kept {
            function.estimator.warm_start(&kept.snapshot(), now_s);
            if kept.is_disabled() {
                function.disable(kept);
            }
        }
        function
    }

    /// Takes an order; false: not in this state.
    pub fn order(&mut self, order: EstimatorOrder, now_s: f64) -> bool {
        match order {
            EstimatorOrder::Disable if self.enabled => {
                let kept = self.kept();
                self.disable(&kept);
                true
            }
            EstimatorOrder::Disable => true,
            EstimatorOrder::Enable => {
                self.enable(now_s);
                true
            }
            EstimatorOrder::Initialise { full_inertial } => self.initialise(full_inertial),
        }
    }

    /// Lets barometer and pitot in from now on, or leaves them out.
    pub fn configure(&mut self, pressure_aiding: bool) {
        self.estimator.set_aiding(Aiding { pressure: pressure_aiding, ..self.estimator.aiding() });
    }

    /// Takes what is new in this window.
    pub fn step(&mut self, inputs: &Inputs<'_>) {
        if let Some(command) = inputs.command {
            self.estimator.believe_pitot(command.protection & PITOT_NOT_BELIEVED == 0);
        }
        match self.sample(inputs) {
            Some(sample) => {
                (self.accepted, self.silent) = (self.accepted + 1, 0);
                self.stuck.look(&sample.specific_force, &sample.rates);
                self.estimator.doubt(self.stuck.axes());
                self.estimator.predict(&sample);
            }
            None => (self.missing, self.silent) = (self.missing + 1, self.silent.saturating_add(1)),
        }
        self.aid_by_gps(inputs);
        self.aid_by_pressure(inputs);
        self.aid_by_field(inputs);
    }

    /// The state, if there is one.
    pub fn navigation(&self) -> Option<NavigationState> {
        self.estimator.state().filter(|_| self.enabled && !self.is_silent())
    }

    /// There have been no inertial values for so long that the last state says nothing of the present one.
    pub fn is_silent(&self) -> bool {
        self.silent >= SILENT_WINDOWS
    }

    /// Axes of the inertial sensors that repeat their value, one bit each: accelerometer 1, 2, 4, gyroscope 8, 16, 32.
    pub fn stuck_axes(&self) -> u32 {
        self.stuck.axes()
    }

    /// The state as the other functions get it: with its status alone while there is none.
    pub fn state(&self) -> State {
        let (refused, health) = (self.estimator.counters().refused, self.estimator.health());
        let mut state = state::message(self.navigation().as_ref(), refused, health);
        if self.silent >= DOUBTED_WINDOWS {
            (state.status, state.health) = (state.status.min(STATUS_COARSE), 0);
        }
        if self.stuck_axes() != 0 {
            state.status = state.status.min(STATUS_COARSE);
            state.health &= !u64::from(Health::ATTITUDE | Health::VELOCITY | Health::POSITION);
        }
        if !self.enabled {
            state.status = STATUS_DISABLED;
        }
        state
    }

    /// What the OnBoardComputer is told; `starts` is how often the function was started.
    pub fn status(&self, state: &State, starts: u64) -> FunctionStatus {
        FunctionStatus {
            enabled: u32::from(self.enabled),
            ready: u32::from(state.status >= STATUS_COARSE),
            accepted: self.accepted,
            refused: self.missing + u64::from(state.rejected),
            starts,
        }
    }

    /// What to keep over a warm restart.
    pub fn kept(&self) -> Kept {
        match (&self.parked, self.estimator.snapshot()) {
            (Some(parked), _) => **parked,
            (None, snapshot) => Kept::new(snapshot.as_ref(), !self.enabled),
        }
    }

    fn disable(&mut self, kept: &Kept) {
        self.parked = Some(Box::new(kept.disabled()));
        self.enabled = false;
        self.estimator.stop();
    }

    /// Goes on with the biases and the wind that were known; the rest is found anew, in flight as well.
    fn enable(&mut self, now_s: f64) {
        let Some(parked) = self.parked.take() else { return };
        self.enabled = true;
        if !self.estimator.warm_start(&parked.snapshot(), now_s) {
            self.estimator.initialise(Start::Auto);
        }
    }

    /// Full inertial estimation finds the attitude from the inertial sensors in any motion. Without, the aircraft has to
    /// stand, and that is refused in flight, where it would never end.
    fn initialise(&mut self, full_inertial: bool) -> bool {
        let flying = self.airspeed_mps > FLYING_MPS || self.speed_mps > FLYING_MPS;
        if flying && !full_inertial {
            return false;
        }
        (self.parked, self.enabled) = (None, true);
        self.estimator.initialise(if full_inertial { Start::Auto } else { Start::Ground });
        true
    }

    /// Rates and forces of the same interval, if they are new.
    fn sample(&mut self, inputs: &Inputs<'_>) -> Option<ImuSample> {
        let (force, rates) = (inputs.acceleration?, inputs.orientation?);
        if force.measured_ns != rates.measured_ns || !self.is_inertial_new(rates.measured_ns) {
            return None;
        }
        Some(ImuSample {
            time_s: seconds(rates.measured_ns),
            interval_s: seconds(rates.interval_ns),
            specific_force: Vector3::from(force.specific_force_mps2),
            rates: Vector3::from(rates.rates_radps),
        })
    }

    fn is_inertial_new(&mut self, measured_ns: u64) -> bool {
        let Some(last_ns) = self.used.inertial.filter(|last_ns| measured_ns <= *last_ns) else {
            (self.used.inertial, self.set_back) = (Some(measured_ns), 0);
            return true;
        };
        self.set_back = if measured_ns < last_ns { self.set_back + 1 } else { self.set_back };
        if self.set_back < SET_BACK_SAMPLES {
            return false;
        }
        // All stamps lie in the past now: nothing of the filter's time makes sense any more.
        (self.used, self.set_back) = (Used { inertial: Some(measured_ns), ..Used::default() }, 0);
        if self.enabled {
            self.estimator.initialise(Start::Auto);
        }
        true
    }

    fn aid_by_gps(&mut self, inputs: &Inputs<'_>) {
        let (Some(position), Some(velocity)) = (inputs.gps_position, inputs.gps_velocity) else { return };
        let whole = position.measured_ns == velocity.measured_ns;
        if !whole || self.used.gps.replace(position.measured_ns) == Some(position.measured_ns) {
            return;
        }
        let velocity_ned = Vector3::from(velocity.velocity_ned_mps);
        self.speed_mps = velocity_ned.norm();
        self.estimator.update_gps(&GpsMeasurement {
            time_s: seconds(position.measured_ns),
            position_ned: Vector3::from(position.position_ned_m),
            velocity_ned,
        });
    }

    fn aid_by_pressure(&mut self, inputs: &Inputs<'_>) {
        let Some(pressure) = inputs.pressure else { return };
        if self.used.pressure.replace(pressure.measured_ns) == Some(pressure.measured_ns) {
            return;
        }
        self.airspeed_mps = pressure.airspeed_mps;
        let time_s = seconds(pressure.measured_ns);
        let (static_pa, differential_pa) = (pressure.static_pressure_pa, pressure.differential_pressure_pa);
        self.estimator.update_baro(time_s, static_pa);
        self.estimator.update_airspeed(time_s, differential_pa, static_pa);
    }

    fn aid_by_field(&mut self, inputs: &Inputs<'_>) {
        let Some(field) = inputs.magnetization else { return };
        if self.used.field.replace(field.measured_ns) != Some(field.measured_ns) {
            let time_s = seconds(field.measured_ns);
            self.estimator.update_magnetometer(time_s, &Vector3::from(field.field_gauss));
        }
    }
}

/// Nanoseconds as seconds; exact to a nanosecond for a hundred days.
pub fn seconds(ns: u64) -> f64 {
    ns as f64 * 1e-9
}

#[cfg(test)]
mod tests;
