//! One pass of the main cycle: GPS, IMU, Estimator, Controller, Servo, one after the other.
//!
//! It is what the partitions do in their windows, without windows, ports, processes and restarts: values are handed on in a
//! struct. A function that stopped would stop them all.

use std::collections::VecDeque;

use bateleur_controller::{Sensors, navigation_state};
use bateleur_estimator::Inputs;
use bateleur_flight::guidance::GuidanceError;
use bateleur_gps::Gps;
use bateleur_imu::{Biases, Imu, Initialise, Outcome};
use bateleur_messages::ground::{Order, SENSOR_GYROSCOPE};
use bateleur_messages::parameter::Parameters;
use bateleur_messages::{
    Acceleration, ActuatorCommand, Custom, GpsPosition, GpsVelocity, GroundMessage, Magnetization, Pressure,
    Range, Rates, RawAnalog, RawGps, ServoTimers, State,
};

use crate::settings::Settings;

/// Orders that a function takes in one pass at most, as in a window.
const ORDERS_PER_PASS: usize = 8;

/// A latest value and when it was written.
#[derive(Debug, Clone, Copy)]
struct Latest<T> {
    value: Option<(u64, T)>,
}

impl<T> Default for Latest<T> {
    fn default() -> Self {
        Self { value: None }
    }
}

impl<T: Copy> Latest<T> {
    fn put(&mut self, time_ns: u64, value: &T) {
        self.value = Some((time_ns, *value));
    }

    fn valid(&self, now_ns: u64, at_most_ns: u64) -> Option<&T> {
        let (time_ns, value) = self.value.as_ref()?;
        (now_ns.saturating_sub(*time_ns) <= at_most_ns).then_some(value)
    }
}

/// What comes from outside, each with the module time at which it was written, ns, the oldest first.
#[derive(Debug, Default)]
pub(crate) struct Outside {
    pub(crate) raw_gps: VecDeque<(u64, RawGps)>,
    pub(crate) raw_analog: VecDeque<(u64, RawAnalog)>,
    pub(crate) custom: VecDeque<(u64, Custom)>,
    pub(crate) range: VecDeque<(u64, Range)>,
    pub(crate) imu_orders: VecDeque<(u64, GroundMessage)>,
    pub(crate) estimator_orders: VecDeque<(u64, GroundMessage)>,
    pub(crate) controller_orders: VecDeque<(u64, GroundMessage)>,
    pub(crate) servo_orders: VecDeque<(u64, GroundMessage)>,
}

/// The oldest of `queue`, if it was written before `now_ns`.
pub(crate) fn pop_before<T>(queue: &mut VecDeque<(u64, T)>, now_ns: u64) -> Option<(u64, T)> {
    if queue.front().is_some_and(|(time_ns, _)| *time_ns < now_ns) { queue.pop_front() } else { None }
}

/// Moves what was written before `now_ns` into place; false: nothing was.
fn arrive<T: Copy>(queue: &mut VecDeque<(u64, T)>, now_ns: u64, latest: &mut Latest<T>) -> bool {
    let mut updated = false;
    while let Some((time_ns, value)) = pop_before(queue, now_ns) {
        latest.put(time_ns, &value);
        updated = true;
    }
    updated
}

/// The orders that a function takes now.
fn orders(queue: &mut VecDeque<(u64, GroundMessage)>, now_ns: u64) -> Vec<GroundMessage> {
    let next = || pop_before(queue, now_ns).map(|(_, message)| message);
    std::iter::from_fn(next).take(ORDERS_PER_PASS).collect()
}

/// What one pass gave; nothing where a function had nothing new to say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Outputs {
    /// From GPS.
    pub fix: Option<(GpsPosition, GpsVelocity)>,
    /// From IMU.
    pub measurements: bateleur_imu::Measurements,
    /// From the Estimator.
    pub state: State,
    /// From the Controller.
    pub command: ActuatorCommand,
    /// From the Servo.
    pub timers: ServoTimers,
}

/// What the ground may set in flight.
#[derive(Debug)]
struct Tables {
    imu: Parameters<bateleur_imu::Settings>,
    estimator: Parameters<bateleur_estimator::Settings>,
    controller: Parameters<bateleur_controller::Settings>,
    servo: Parameters<bateleur_servo::Settings>,
}

/// The functions and what is between them.
#[derive(Debug)]
pub struct MainCycle {
    settings: Settings,
    tables: Tables,
    gps: Gps,
    imu: Imu,
    initialising: Option<Initialise>,
    estimator: bateleur_estimator::Function,
    controller: bateleur_controller::Function,
    servo: bateleur_servo::Servo,
    raw_gps: Latest<RawGps>,
    raw_analog: Latest<RawAnalog>,
    custom: Latest<Custom>,
    range: Latest<Range>,
    position: Latest<GpsPosition>,
    velocity: Latest<GpsVelocity>,
    acceleration: Latest<Acceleration>,
    orientation: Latest<Rates>,
    magnetization: Latest<Magnetization>,
    pressure: Latest<Pressure>,
    state: Latest<State>,
    command: Latest<ActuatorCommand>,
}

impl MainCycle {
    /// All functions at rest, as at the start of a module.
    ///
    /// # Errors
    /// When the plan's way-points make no path.
    pub fn new(settings: Settings) -> Result<Self, GuidanceError> {
        let estimator = &settings.estimator;
        Ok(Self {
            gps: Gps::new(&settings.origin),
            imu: Imu::new(Biases::default()),
            initialising: None,
            estimator: bateleur_estimator::Function::new(
                estimator.config,
                estimator.pressure_aiding,
                None,
                0.0,
            ),
            controller: bateleur_controller::Function::new(settings.controller, &settings.waypoints, None)?,
            servo: bateleur_servo::Servo::new(settings.servo.map, settings.servo.hold_ns, None),
            settings,
            tables: Tables {
                imu: bateleur_imu::parameters(),
                estimator: bateleur_estimator::parameters(),
                controller: bateleur_controller::parameters(),
                servo: bateleur_servo::parameters(),
            },
            raw_gps: Latest::default(),
            raw_analog: Latest::default(),
            custom: Latest::default(),
            range: Latest::default(),
            position: Latest::default(),
            velocity: Latest::default(),
            acceleration: Latest::default(),
            orientation: Latest::default(),
            magnetization: Latest::default(),
            pressure: Latest::default(),
            state: Latest::default(),
            command: Latest::default(),
        })
    }

    /// One pass; the cycle begins at module time `start_ns`.
    pub(crate) fn pass(&mut self, start_ns: u64, outside: &mut Outside) -> Outputs {
        let instants = self.settings.instants;
        let fix = self.run_gps(start_ns + instants.gps_ns, outside);
        let measurements = self.run_imu(start_ns + instants.imu_ns, outside);
        let state = self.run_estimator(start_ns + instants.estimator_ns, outside);
        let command = self.run_controller(start_ns + instants.controller_ns, outside);
        let timers = self.run_servo(start_ns + instants.servo_ns, outside);
        Outputs { fix, measurements, state, command, timers }
    }

    fn run_gps(&mut self, now_ns: u64, outside: &mut Outside) -> Option<(GpsPosition, GpsVelocity)> {
        arrive(&mut outside.raw_gps, now_ns, &mut self.raw_gps);
        let raw = self.raw_gps.valid(now_ns, self.settings.validity.gps_raw_ns)?;
        let (position, velocity) = self.gps.take(raw)?;
        self.position.put(now_ns, &position);
        self.velocity.put(now_ns, &velocity);
        Some((position, velocity))
    }

    fn run_imu(&mut self, now_ns: u64, outside: &mut Outside) -> bateleur_imu::Measurements {
        for message in orders(&mut outside.imu_orders, now_ns) {
            if self.tables.imu.take(&message, &mut self.settings.imu, now_ns).is_some() {
                continue;
            }
            if let Ok(Order::InitialiseSensors { sensors }) = Order::parse(message.letter, message.bytes()) {
                self.begin(sensors, now_ns);
            }
        }
        arrive(&mut outside.raw_analog, now_ns, &mut self.raw_analog);
        let raw = self.raw_analog.valid(now_ns, self.settings.validity.imu_raw_ns).copied();
        let taken = raw.as_ref().and_then(|raw| self.imu.take(raw));
        let measurements = taken.unwrap_or_default();
        measurements.acceleration.iter().for_each(|value| self.acceleration.put(now_ns, value));
        measurements.orientation.iter().for_each(|value| self.orientation.put(now_ns, value));
        measurements.magnetization.iter().for_each(|value| self.magnetization.put(now_ns, value));
        measurements.pressure.iter().for_each(|value| self.pressure.put(now_ns, value));
        self.initialise(now_ns, raw.as_ref().filter(|_| taken.is_some()));
        measurements
    }

    fn begin(&mut self, sensors: u8, now_ns: u64) {
        let bateleur_imu::Settings { initialise_ns, gyro_bias, pitot_covered } = self.settings.imu;
        let refused = sensors & SENSOR_GYROSCOPE != 0 && !gyro_bias;
        if !refused && !self.initialising.is_some_and(|under_way| under_way.covers(sensors)) {
            self.initialising = Some(Initialise::new(sensors, pitot_covered, now_ns, initialise_ns));
        }
    }

    fn initialise(&mut self, now_ns: u64, raw: Option<&RawAnalog>) {
        let Some(under_way) = &mut self.initialising else { return };
        let Some(outcome) = under_way.step(now_ns, raw, self.imu.biases()) else { return };
        self.initialising = None;
        if let Outcome::Found(biases) = outcome {
            self.imu.set_biases(biases);
        }
    }

    fn run_estimator(&mut self, now_ns: u64, outside: &mut Outside) -> State {
        for message in orders(&mut outside.estimator_orders, now_ns) {
            let settings = &mut self.settings.estimator;
            if let Some(answer) = self.tables.estimator.take(&message, settings, now_ns) {
                if answer.changed {
                    self.estimator.configure(settings.pressure_aiding);
                }
                continue;
            }
            if let Ok(Order::Estimator(order)) = Order::parse(message.letter, message.bytes()) {
                let _ = self.estimator.order(order, bateleur_estimator::seconds(now_ns)); // nobody waits for an answer
            }
        }
        let [position_ns, velocity_ns] = self.settings.validity.estimator_gps_ns;
        let [acceleration_ns, orientation_ns, magnetization_ns, pressure_ns] =
            self.settings.validity.estimator_imu_ns;
        self.estimator.step(&Inputs {
            acceleration: self.acceleration.valid(now_ns, acceleration_ns),
            orientation: self.orientation.valid(now_ns, orientation_ns),
            magnetization: self.magnetization.valid(now_ns, magnetization_ns),
            pressure: self.pressure.valid(now_ns, pressure_ns),
            gps_position: self.position.valid(now_ns, position_ns),
            gps_velocity: self.velocity.valid(now_ns, velocity_ns),
            command: self
                .settings
                .validity
                .estimator_command_ns
                .and_then(|ns| self.command.valid(now_ns, ns)),
        });
        let state = self.estimator.state();
        self.state.put(now_ns, &state);
        state
    }

    fn run_controller(&mut self, now_ns: u64, outside: &mut Outside) -> ActuatorCommand {
        let updated = arrive(&mut outside.range, now_ns, &mut self.range);
        let valid_ns = self.settings.validity.controller_range_ns.filter(|_| updated);
        let range = valid_ns.and_then(|valid_ns| self.range.valid(now_ns, valid_ns));
        let [state_ns, acceleration_ns, orientation_ns, pressure_ns] = self.settings.validity.controller_ns;
        let state = self.state.valid(now_ns, state_ns).and_then(navigation_state);
        let sensors = Sensors::of(
            self.acceleration.valid(now_ns, acceleration_ns),
            self.orientation.valid(now_ns, orientation_ns),
            self.pressure.valid(now_ns, pressure_ns),
            range.map(|range| range.distance_m),
        );
        for message in orders(&mut outside.controller_orders, now_ns) {
            let settings = &mut self.settings.controller;
            if let Some(answer) = self.tables.controller.take(&message, settings, now_ns) {
                if answer.changed {
                    self.controller.configure(settings);
                }
                continue;
            }
            if let Ok(order) = Order::parse(message.letter, message.bytes()) {
                let _ = self.controller.order(&order, state.is_some()); // as above
            }
        }
        let period_ns = self.settings.instants.period_ns;
        let command = self.controller.step(now_ns, period_ns, state.as_ref(), &sensors);
        self.command.put(now_ns, &command);
        command
    }

    fn run_servo(&mut self, now_ns: u64, outside: &mut Outside) -> ServoTimers {
        for message in orders(&mut outside.servo_orders, now_ns) {
            let settings = &mut self.settings.servo;
            if let Some(answer) = self.tables.servo.take(&message, settings, now_ns) {
                if answer.changed {
                    self.servo.configure(settings.hold_ns);
                }
                continue;
            }
            let _ = self.servo.order(Order::parse(message.letter, message.bytes())); // as above
        }
        arrive(&mut outside.custom, now_ns, &mut self.custom);
        let [command_ns, custom_ns] = self.settings.validity.servo_ns;
        let command = self.command.valid(now_ns, command_ns);
        self.servo.step(now_ns, command, self.custom.valid(now_ns, custom_ns))
    }
}
