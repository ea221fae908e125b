//! Plant, safety pilot and supply on one clock.

use crate::options::Options;
use crate::pilot::SafetyPilot;
use crate::supply::Supply;
use crate::timers::{Sticks, Timers};
use crate::truth::TruthRecord;
use bateleur_messages::hil::Actuators;
use bateleur_messages::{Custom, Range, RawAnalog, RawGps};
use bateleur_plant::{
    AirframeError, Controls, Fault, GpsFix, PlannedFault, STEP_S, SensorSet, Simulation, Truth,
};

/// One plant step, ns; module time is rounded to whole steps.
pub const STEP_NS: u64 = 2_500_000;
/// Plant steps in one cycle of 20 ms, the pace at which the safety pilot looks at the aircraft.
pub const STEPS_PER_CYCLE: u64 = 8;

const _: () = assert!(STEP_NS as f64 == STEP_S * 1e9);

/// Air temperature at mean sea level, K, and its fall with height, K/m: the standard atmosphere.
const SEA_LEVEL_K: f64 = 288.15;
const LAPSE_K_PER_M: f64 = 0.0065;
/// Satellites that the simulated receiver claims to see.
const SATELLITES: u32 = 11;
/// Error of a single fix that the receiver claims, m. As real ones do, it keeps quiet about its slow error.
const HORIZONTAL_ACCURACY_M: f64 = 2.5;
/// The same for height, m.
const VERTICAL_ACCURACY_M: f64 = 4.0;
/// The smallest error of velocity that it claims, m/s.
const SPEED_ACCURACY_MPS: f64 = 0.05;

/// One sensor set, in the messages of the link.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sample {
    /// Inertial, magnetic and pressure sensors.
    pub analog: RawAnalog,
    /// Sticks and voltages.
    pub custom: Custom,
    /// A fix, where one came in since the last sample.
    pub gps: Option<RawGps>,
    /// Distance to the ground, where the range finder sees it.
    pub range: Option<Range>,
}

/// One aircraft with its pilot.
#[derive(Debug, Clone)]
pub struct Flight {
    plant: Simulation,
    pilot: SafetyPilot,
    supply: Supply,
    faults: Vec<PlannedFault>,
    timers: Timers,
    speed_accuracy_mps: f64,
    /// Shortest and longest distance of the range finder, m.
    range_limits_m: [f64; 2],
    sticks: Sticks,
    actuators: Actuators,
    steps: u64,
    until_pilot: u64,
}

impl Flight {
    /// An aircraft at rest on the runway, with nobody commanding.
    ///
    /// # Errors
    /// When the airframe makes no sense.
    pub fn new(options: &Options) -> Result<Self, AirframeError> {
        Ok(Self {
            plant: Simulation::new(&options.airframe, &options.conditions)?,
            pilot: SafetyPilot::new(&options.airframe, options.conditions.runway_heading_rad),
            supply: Supply::new(&options.airframe),
            faults: options.conditions.faults.clone(),
            timers: Timers::new(&options.airframe.servo),
            speed_accuracy_mps: options.conditions.sensors.gps.velocity_noise_mps.max(SPEED_ACCURACY_MPS),
            range_limits_m: [
                options.conditions.sensors.range.least_m,
                options.conditions.sensors.range.most_m,
            ],
            sticks: Sticks::default(),
            actuators: Actuators::default(),
            steps: 0,
            until_pilot: STEPS_PER_CYCLE,
        })
    }

    /// Plant steps since the start.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Gives the safety pilot an order.
    pub fn order(&mut self, order: u32) {
        self.pilot.order(order);
    }

    /// Holds these actuators from now on.
    pub fn actuate(&mut self, actuators: &Actuators) {
        self.actuators = *actuators;
    }

    /// Flies on for whole plant steps, the pilot looking every 20 ms.
    pub fn advance(&mut self, mut steps: u64) {
        let controls = self.timers.controls(&self.actuators);
        while steps > 0 {
            let run = steps.min(self.until_pilot);
            self.fly(controls, run);
            steps -= run;
            self.until_pilot -= run;
            if self.until_pilot == 0 {
                self.look();
                self.until_pilot = STEPS_PER_CYCLE;
            }
        }
    }

    fn fly(&mut self, controls: Controls, steps: u64) {
        let dt_s = steps as f64 * STEP_S;
        self.plant.advance(controls, dt_s);
        let time_s = self.plant.time_s();
        for planned in self.faults.iter().filter(|planned| (planned.from_s..planned.to_s).contains(&time_s)) {
            if let Fault::Battery(left) = planned.fault {
                self.supply.drain(left);
            }
        }
        self.supply.draw(if controls.throttle.is_finite() { controls.throttle } else { 0.0 }, dt_s);
        self.steps += steps;
    }

    fn look(&mut self) {
        let dt_s = STEPS_PER_CYCLE as f64 * STEP_S;
        let autopilot = self.actuators.autopilot != 0;
        let wanted = self.pilot.fly(&self.plant.truth(), autopilot, dt_s);
        self.sticks = self.timers.sticks(&wanted);
    }

    /// Reads the sensors. `origin_ns` is the module time at which the plant's clock stood at zero; no time in the
    /// sample is later than `latest_ns`.
    pub fn sample(&mut self, origin_ns: u64, latest_ns: u64) -> Sample {
        let set = self.plant.sensors();
        let measured_ns = (origin_ns + self.steps * STEP_NS).min(latest_ns);
        Sample {
            analog: self.analog(&set, measured_ns),
            custom: self.custom(measured_ns),
            gps: set.gps.map(|fix| self.raw_gps(&fix, origin_ns)),
            range: set.range_m.map(|distance_m| {
                let [least_m, most_m] = self.range_limits_m;
                Range { measured_ns, distance_m, least_m, most_m }
            }),
        }
    }

    fn analog(&self, set: &SensorSet, measured_ns: u64) -> RawAnalog {
        let height_m = self.plant.truth().geodetic.altitude_m;
        RawAnalog {
            measured_ns,
            interval_ns: nanoseconds(set.interval_s),
            specific_force_mps2: set.accelerometer_mps2.into(),
            rates_radps: set.gyroscope_radps.into(),
            field_gauss: set.magnetometer_gauss.into(),
            static_pressure_pa: set.static_pressure_pa,
            differential_pressure_pa: set.differential_pressure_pa,
            temperature_k: SEA_LEVEL_K - LAPSE_K_PER_M * height_m,
        }
    }

    fn custom(&self, measured_ns: u64) -> Custom {
        let volts = self.supply.volts();
        Custom {
            measured_ns,
            pilot_aileron_us: self.sticks.aileron_us,
            pilot_elevator_us: self.sticks.elevator_us,
            pilot_rudder_us: self.sticks.rudder_us,
            pilot_throttle_us: self.sticks.throttle_us,
            main_v: volts.main,
            backup_v: volts.backup,
            actuator_board_v: volts.actuator_board,
        }
    }

    fn raw_gps(&self, fix: &GpsFix, origin_ns: u64) -> RawGps {
        RawGps {
            measured_ns: origin_ns + nanoseconds(fix.measured_at_s),
            latitude_rad: fix.geodetic.latitude_rad,
            longitude_rad: fix.geodetic.longitude_rad,
            altitude_m: fix.geodetic.altitude_m,
            velocity_ned_mps: fix.velocity_ned_mps.into(),
            horizontal_accuracy_m: HORIZONTAL_ACCURACY_M,
            vertical_accuracy_m: VERTICAL_ACCURACY_M,
            speed_accuracy_mps: self.speed_accuracy_mps,
            satellites: SATELLITES,
            fix: 3,
        }
    }

    /// What is really the case.
    pub fn now(&self) -> Truth {
        self.plant.truth()
    }

    /// The same as a record for the log.
    pub fn truth(&self, time_ns: u64) -> TruthRecord {
        TruthRecord::new(time_ns, &self.plant.truth(), &self.actuators)
    }
}

fn nanoseconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}
