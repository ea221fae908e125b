//! A flight of the plant with the real estimator and controller in the loop, and its score.
#![allow(dead_code, unreachable_pub, reason = "each test program uses its own part of this")]
#![allow(clippy::unwrap_used, clippy::panic, reason = "a panic here is a failed test")]

use bateleur_flight::airframe::Airframe;
use bateleur_flight::atmosphere::{airspeed_mps, density_kgpm3, pressure_altitude_m};
use bateleur_flight::control::{
    Controller, ControllerConfig, ControllerInputs, ControllerOutput, LoopCommands,
};
use bateleur_flight::estimator::{Estimator, EstimatorConfig, GpsMeasurement, ImuSample, NavigationState};
use bateleur_flight::guidance::path::{Circuit, Piece};
use bateleur_flight::guidance::{Guidance, GuidanceConfig, seed_waypoints};
use bateleur_flight::magnetic::Site;
use bateleur_flight::servo::ActuatorCommand;
pub use bateleur_plant::FlightStart;
use bateleur_plant::{Conditions, Controls, SensorSet, Simulation, Truth, Turbulence};
use nalgebra::Vector2;

pub const AEROSONDE: &str = include_str!("../../../../airframes/aerosonde.toml");
pub const ULTRA_STICK: &str = include_str!("../../../../airframes/ultrastick25e.toml");
pub const RASCAL: &str = include_str!("../../../../airframes/rascal110.toml");

/// Everything that distinguishes one test flight from another.
pub struct Options {
    pub airframe: &'static str,
    pub conditions: Conditions,
    pub frame_s: f64,
    pub estimator: EstimatorConfig,
    pub guidance: GuidanceConfig,
    pub controller: ControllerConfig,
    /// Every so many frames one is lost whole: sensors unread, nothing computed, actuators held.
    pub lose_every: Option<u32>,
    /// Frames between a command and its arrival at the actuators.
    pub delay_frames: usize,
    /// The plant is built from this instead, if given.
    pub plant: Option<bateleur_plant::Airframe>,
    /// Applied to every fix before the estimator sees it.
    pub spoil_fix: fn(GpsMeasurement) -> GpsMeasurement,
    pub start: Option<FlightStart>,
}

impl Options {
    pub fn new(seed: u64, wind_mps: f64, wind_from_deg: f64, turbulence: Turbulence) -> Self {
        Self {
            airframe: AEROSONDE,
            conditions: Conditions {
                seed,
                wind_speed_mps: wind_mps,
                wind_from_rad: wind_from_deg.to_radians(),
                turbulence,
                ..Conditions::default()
            },
            frame_s: 0.02,
            estimator: EstimatorConfig::at_site(&Site::default()).unwrap(),
            guidance: GuidanceConfig { laps: 2, ..GuidanceConfig::default() },
            controller: ControllerConfig::default(),
            lose_every: None,
            delay_frames: 1,
            plant: None,
            spoil_fix: |fix| fix,
            start: None,
        }
    }
}

/// One frame as recorded.
#[derive(Clone, Copy)]
pub struct Frame {
    pub truth: Truth,
    pub navigation: Option<NavigationState>,
    pub output: ControllerOutput,
    pub engaged: bool,
}

/// A flight under way.
pub struct Flight {
    pub plant: Simulation,
    pub estimator: Estimator,
    pub controller: Controller,
    pub commands: LoopCommands,
    pub options: Options,
    pub frames: Vec<Frame>,
    pub engaged: bool,
    /// While true the estimator is not run at all (its partition is dead).
    pub estimator_dead: bool,
    /// Mean of the barometer's slow error while the aircraft stood, when the estimator zeroed it.
    pub barometer_at_start_m: f64,
    stood: f64,
    waiting: Vec<ActuatorCommand>,
    held: ActuatorCommand,
    count: u32,
}

impl Flight {
    pub fn new(options: Options) -> Self {
        let plant_airframe = options
            .plant
            .clone()
            .unwrap_or_else(|| bateleur_plant::Airframe::from_toml(options.airframe).unwrap());
        let plant = match &options.start {
            Some(start) => Simulation::in_flight(&plant_airframe, &options.conditions, start).unwrap(),
            None => Simulation::new(&plant_airframe, &options.conditions).unwrap(),
        };
        let controller = new_controller(&options);
        let trim = *controller.trim();
        let flying = options.start.is_some();
        let rest = ActuatorCommand {
            throttle: if flying { trim.throttle } else { 0.0 },
            elevator_rad: if flying { trim.elevator_rad } else { 0.0 },
            ..ActuatorCommand::default()
        };
        Self {
            barometer_at_start_m: 0.0,
            stood: 0.0,
            plant,
            estimator: Estimator::new(options.estimator),
            controller,
            commands: LoopCommands::MISSION,
            frames: Vec::new(),
            engaged: flying,
            estimator_dead: false,
            waiting: vec![rest; options.delay_frames],
            held: rest,
            options,
            count: 0,
        }
    }

    /// One frame: sensors, estimator, controller, actuators one frame late.
    pub fn step(&mut self) {
        let sensors = self.plant.sensors();
        let truth = self.plant.truth();
        self.count += 1;
        if truth.time_s < 8.0 && truth.on_ground {
            self.stood += 1.0;
            self.barometer_at_start_m += (truth.barometer_bias_m - self.barometer_at_start_m) / self.stood;
        }
        let lost = self.options.lose_every.is_some_and(|every| self.count.is_multiple_of(every));
        if !lost {
            self.compute(&sensors, &truth);
        }
        self.waiting.push(self.held);
        let arriving = self.waiting.remove(0);
        let controls = Controls {
            aileron_rad: arriving.aileron_rad,
            elevator_rad: arriving.elevator_rad,
            rudder_rad: arriving.rudder_rad,
            throttle: arriving.throttle,
        };
        self.plant.advance(controls, self.options.frame_s);
    }

    fn compute(&mut self, sensors: &SensorSet, truth: &Truth) {
        if !self.estimator_dead {
            feed(&mut self.estimator, sensors, self.options.spoil_fix);
        }
        let navigation = if self.estimator_dead { None } else { self.estimator.state() };
        if !self.engaged && -truth.position_ned_m.z > 60.0 && navigation.is_some() {
            self.engaged = true;
        }
        let density = density_kgpm3(pressure_altitude_m(sensors.static_pressure_pa).unwrap_or(0.0));
        let inputs = ControllerInputs {
            navigation: navigation.as_ref(),
            rates: sensors.gyroscope_radps,
            specific_force: sensors.accelerometer_mps2,
            airspeed_mps: Some(airspeed_mps(sensors.differential_pressure_pa, density)),
            density_kgpm3: Some(density),
            range_m: sensors.range_m,
            pilot: pilot(truth),
            dt_s: self.options.frame_s,
        };
        let commands = LoopCommands { autopilot: self.engaged, ..self.commands };
        let output = self.controller.step(&inputs, &commands);
        self.held = output.command;
        self.frames.push(Frame { truth: *truth, navigation, output, engaged: self.engaged });
    }

    pub fn run(&mut self, seconds: f64) {
        for _ in 0..(seconds / self.options.frame_s).round() as u32 {
            self.step();
        }
    }

    /// Flies until the laps are done and a while longer; panics if that takes more than `limit_s`.
    pub fn run_mission(&mut self, limit_s: f64) {
        let frames = (limit_s / self.options.frame_s) as u32;
        for _ in 0..frames {
            self.step();
            let truth = self.plant.truth();
            assert!(!truth.crashed, "crashed at {:.1} s: {}", truth.time_s, self.describe());
            if self.last().output.guidance.is_some_and(|g| g.finished) {
                self.run(20.0);
                assert!(!self.plant.truth().crashed, "crashed while loitering");
                return;
            }
        }
        panic!("mission not finished after {limit_s} s: {}", self.describe());
    }

    pub fn last(&self) -> &Frame {
        self.frames.last().unwrap()
    }

    pub fn describe(&self) -> String {
        let f = self.last();
        let t = &f.truth;
        format!(
            "seed {} at {:.0} {:.0} {:.0} m, {:.1} m/s, roll {:.0} pitch {:.0} yaw {:.0}, guidance {:?}, status {:?}, counters {:?}",
            self.options.conditions.seed,
            t.position_ned_m.x,
            t.position_ned_m.y,
            -t.position_ned_m.z,
            t.airspeed_mps,
            t.roll_rad.to_degrees(),
            t.pitch_rad.to_degrees(),
            t.yaw_rad.to_degrees(),
            f.output.guidance.map(|g| (g.next, g.reached, g.cross_track_m)),
            self.estimator.status(),
            self.estimator.counters()
        )
    }

    /// Indices of the way-points in the order they were reached.
    pub fn order(&self) -> Vec<usize> {
        let mut order = Vec::new();
        let mut last: Option<(u32, usize)> = None;
        for guidance in self.frames.iter().filter_map(|frame| frame.output.guidance) {
            if let Some((reached, next)) = last.filter(|(reached, _)| guidance.reached > *reached) {
                assert_eq!(guidance.reached, reached + 1);
                order.push(next);
            }
            last = Some((guidance.reached, guidance.next));
        }
        order
    }

    pub fn score(&self) -> Score {
        let first = self.frames.iter().position(|f| f.output.guidance.is_some_and(|g| g.reached >= 1));
        let flown = &self.frames[first.unwrap()..];
        let mut score = Score::default();
        let mut leg = Mean::default();
        let mut all = Mean::default();
        let (mut altitude, mut altitude_true, mut airspeed, mut leg_true) =
            (Mean::default(), Mean::default(), Mean::default(), Mean::default());
        let mut radius = 70.0;
        let mut captured = false;
        // The circle at the end is no part of the circuit.
        let ended = |frame: &&Frame| frame.output.guidance.is_some_and(|g| g.holding);
        for frame in flown.iter().take_while(|frame| !ended(frame)) {
            let t = &frame.truth;
            if let Some(r) = frame.output.guidance.map(|g| g.radius_m).filter(|r| *r > 0.0) {
                radius = r;
            }
            let circuit = Circuit::new(&seed_waypoints(), radius, radius);
            let here = t.position_ned_m + t.gps_slow_error_ned_m;
            let (right, piece) = circuit.nearest(&Vector2::new(here.x, here.y)).unwrap();
            all.add(right);
            if matches!(piece, Piece::Leg(_)) {
                leg.add(right);
                let truly = circuit.nearest(&Vector2::new(t.position_ned_m.x, t.position_ned_m.y)).unwrap().0;
                leg_true.add(truly);
            }
            if right.abs() > score.cross_track_max {
                score.cross_track_max = right.abs();
                score.worst = (t.time_s, here.x, here.y);
            }
            let drift = t.barometer_bias_m - self.barometer_at_start_m;
            // The climb from the take-off ends some way into the first lap.
            captured |= (-t.position_ned_m.z + drift - 160.0).abs() < 1.0;
            if captured {
                altitude.add(-t.position_ned_m.z + drift - 160.0);
                altitude_true.add(-t.position_ned_m.z - 160.0);
            }
            airspeed.add(t.airspeed_mps - 22.0);
        }
        score.cross_track = all.rms();
        score.straight = leg.rms();
        score.straight_true = leg_true.rms();
        score.altitude = altitude.rms();
        score.altitude_true = altitude_true.rms();
        score.airspeed = airspeed.rms();
        score
    }

    /// Errors of the estimate from `from_s` on, position against the receiver's own truth.
    pub fn estimate_errors(&self, from_s: f64) -> EstimateErrors {
        let mut e = EstimateErrors::default();
        let mut sums = [Mean::default(); 6];
        for frame in self.frames.iter().filter(|f| f.truth.time_s >= from_s) {
            let (t, Some(n)) = (&frame.truth, &frame.navigation) else { continue };
            let wrap = bateleur_flight::attitude::wrap_angle;
            sums[0].add(wrap(n.euler.x - t.roll_rad).to_degrees());
            sums[1].add(wrap(n.euler.y - t.pitch_rad).to_degrees());
            sums[2].add(wrap(n.euler.z - t.yaw_rad).to_degrees());
            sums[3].add((n.velocity - t.velocity_ned_mps).norm() / 3f64.sqrt());
            let seen = t.position_ned_m + t.gps_slow_error_ned_m;
            let off = n.position - seen;
            sums[4].add(off.xy().norm());
            sums[5]
                .add(-n.position.z + t.position_ned_m.z - (t.barometer_bias_m - self.barometer_at_start_m));
        }
        e.roll_deg = sums[0].rms();
        e.pitch_deg = sums[1].rms();
        e.yaw_deg = sums[2].rms();
        e.velocity_mps = sums[3].rms();
        e.horizontal_m = sums[4].rms();
        e.height_m = sums[5].rms();
        e
    }

    /// Distance of the estimated position from the true one from `from_s` on, RMS, m; and that of a faultless filter's,
    /// which has the slow errors of receiver and barometer.
    pub fn true_position_errors(&self, from_s: f64) -> (f64, f64) {
        let mut sums = [Mean::default(); 2];
        for frame in self.frames.iter().filter(|f| f.truth.time_s >= from_s) {
            let (t, Some(n)) = (&frame.truth, &frame.navigation) else { continue };
            let slow = t.gps_slow_error_ned_m;
            let up = t.barometer_bias_m - self.barometer_at_start_m;
            sums[0].add((n.position - t.position_ned_m).norm());
            sums[1].add(nalgebra::Vector2::new(slow.xy().norm(), up).norm());
        }
        (sums[0].rms(), sums[1].rms())
    }
}

/// Hands one sensor set to the estimator.
pub fn feed(estimator: &mut Estimator, s: &SensorSet, spoil: fn(GpsMeasurement) -> GpsMeasurement) {
    if s.interval_s <= 0.0 {
        return;
    }
    estimator.predict(&ImuSample {
        time_s: s.time_s,
        interval_s: s.interval_s,
        specific_force: s.accelerometer_mps2,
        rates: s.gyroscope_radps,
    });
    estimator.update_magnetometer(s.time_s, &s.magnetometer_gauss);
    estimator.update_baro(s.time_s, s.static_pressure_pa);
    estimator.update_airspeed(s.time_s, s.differential_pressure_pa, s.static_pressure_pa);
    if let Some(fix) = s.gps {
        estimator.update_gps(&spoil(GpsMeasurement {
            time_s: fix.measured_at_s,
            position_ned: fix.position_ned_m,
            velocity_ned: fix.velocity_ned_mps,
        }));
    }
}

/// The safety pilot: waits three seconds, full throttle, keeps straight, pulls up gently after 15 m/s, wings level.
fn pilot(t: &Truth) -> ActuatorCommand {
    let wait = t.time_s < 8.0;
    let rotated = t.airspeed_mps > 15.0;
    let pitch_wanted: f64 = if rotated { 0.17 } else { 0.0 };
    let yaw = t.yaw_rad + 0.3 * t.position_ned_m.y.clamp(-2.0, 2.0) / 10.0;
    ActuatorCommand {
        throttle: if wait { 0.0 } else { 1.0 },
        aileron_rad: (-0.5 * t.roll_rad - 0.05 * t.rates_radps.x).clamp(-0.3, 0.3),
        elevator_rad: if rotated {
            (-0.15 - 0.6 * (pitch_wanted - t.pitch_rad) + 0.1 * t.rates_radps.y).clamp(-0.4, 0.3)
        } else {
            0.0
        },
        rudder_rad: if t.on_ground { (1.0 * yaw + 0.3 * t.rates_radps.z).clamp(-0.4, 0.4) } else { 0.0 },
    }
}

#[derive(Clone, Copy, Default)]
pub struct Mean {
    sum: f64,
    count: f64,
}

impl Mean {
    pub fn add(&mut self, x: f64) {
        self.sum += x * x;
        self.count += 1.0;
    }
    pub fn rms(&self) -> f64 {
        (self.sum / self.count.max(1.0)).sqrt()
    }
}

#[derive(Clone, Copy, Debug, Default)]
pub struct Score {
    pub cross_track: f64,
    pub straight: f64,
    pub straight_true: f64,
    pub cross_track_max: f64,
    /// Time, north, east of the largest cross-track error.
    pub worst: (f64, f64, f64),
    pub altitude: f64,
    pub altitude_true: f64,
    pub airspeed: f64,
}

#[derive(Clone, Copy, Debug, Default)]
pub struct EstimateErrors {
    pub roll_deg: f64,
    pub pitch_deg: f64,
    pub yaw_deg: f64,
    pub velocity_mps: f64,
    pub horizontal_m: f64,
    pub height_m: f64,
}

/// A controller as after a restart without memory.
pub fn new_controller(options: &Options) -> Controller {
    let airframe = Airframe::from_toml(options.airframe).unwrap();
    let guidance = Guidance::new(options.guidance, &seed_waypoints()).unwrap();
    Controller::new(airframe, options.controller, guidance)
}

/// A flight drawn from a seed: wind, turbulence, derivatives ±20 %, mass ±10 %, latency 50–250 ms.
pub fn varied(seed: u64) -> Options {
    // A linear congruence, so that the cases are the same everywhere.
    let mut state = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15);
    let mut draw = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / f64::from(1_u32 << 30) - 1.0
    };
    let levels = [Turbulence::Calm, Turbulence::Light, Turbulence::Moderate];
    let turbulence = levels[(seed % 3) as usize];
    let mut options = Options::new(seed, 4.0 + 4.0 * draw(), 180.0 * draw(), turbulence);
    let mut plant = bateleur_plant::Airframe::from_toml(AEROSONDE).unwrap();
    let a = &mut plant.aerodynamics;
    for derivative in [
        &mut a.lift_alpha,
        &mut a.pitch_alpha,
        &mut a.pitch_pitch_rate,
        &mut a.pitch_elevator,
        &mut a.side_beta,
        &mut a.roll_beta,
        &mut a.roll_roll_rate,
        &mut a.roll_yaw_rate,
        &mut a.roll_aileron,
        &mut a.yaw_beta,
        &mut a.yaw_yaw_rate,
        &mut a.yaw_rudder,
    ] {
        *derivative *= 1.0 + 0.2 * draw();
    }
    plant.mass.mass_kg *= 1.0 + 0.1 * draw();
    options.plant = Some(plant);
    options.conditions.sensors.gps.latency_s = 0.15 + 0.1 * draw();
    options
}
