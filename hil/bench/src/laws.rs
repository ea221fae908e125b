//! What one frame of the flight laws computes: the Estimator's filter and the Controller's laws on the sensors of a flight
//! that is flown for it, beside the cheapest way of moving a covariance of 20 states by a dense transition.

use std::hint::black_box;
use std::time::Instant;

use anyhow::{Context, Result};
use bateleur_flight::airframe::{Airframe, built_in};
use bateleur_flight::atmosphere::{airspeed_mps, density_kgpm3, pressure_altitude_m};
use bateleur_flight::control::{
    Controller, ControllerConfig, ControllerInputs, ControllerOutput, LoopCommands,
};
use bateleur_flight::estimator::{Estimator, EstimatorConfig, GpsMeasurement, ImuSample};
use bateleur_flight::guidance::{Guidance, GuidanceConfig, seed_waypoints};
use bateleur_flight::magnetic::Site;
use bateleur_flight::servo::ActuatorCommand;
use bateleur_plant::{Conditions, Controls, FlightStart, SensorSet, Simulation, Turbulence};

use super::Settings;
use super::row::{Reach, Row};
use super::statistics::{median, quantile};

/// The length of a frame, s.
const FRAME_S: f64 = 0.02;
/// States of the filter.
const STATES: usize = 20;
/// A frame of the estimator and one of the controller may take this, µs.
const ESTIMATOR_US: f64 = 50.0;
const CONTROLLER_US: f64 = 10.0;

type Dense = [[f64; STATES]; STATES];

/// The rows of the laws.
pub(super) fn rows(settings: &Settings) -> Result<Vec<Row>> {
    let frames = if settings.quick { 250 } else { 6_000 };
    let [mut estimator, mut late, mut controller, mut dense] = <[Vec<f64>; 4]>::default();
    for run in 0..settings.runs {
        let timed = fly(1 + run as u64, frames)?;
        dense.push(multiply(frames));
        estimator.extend(median(&timed.estimator_us));
        late.extend(quantile(&timed.estimator_us, 0.99));
        controller.extend(median(&timed.controller_us));
    }
    let reference = median(&dense);
    let of = |values: &[f64]| median(values).context("no frame was timed");
    let about = "F P Fᵀ, two products of dense 20 × 20 matrices";
    let row = |name, value, reach| Row::measured(name, "us", value, reference, reach, about);
    Ok(vec![
        row("estimator's frame, p50", of(&estimator)?, Reach::AtMost(ESTIMATOR_US)),
        row("estimator's frame, p99", of(&late)?, Reach::AtMost(ESTIMATOR_US)),
        row("controller's frame, p50", of(&controller)?, Reach::AtMost(CONTROLLER_US)),
    ])
}

/// Each frame's time.
struct Timed {
    estimator_us: Vec<f64>,
    controller_us: Vec<f64>,
}

/// Flies through light turbulence on the laws that are timed.
fn fly(seed: u64, frames: usize) -> Result<Timed> {
    let name = "aerosonde";
    let text = built_in(name).context("no aerosonde is built in")?;
    let plant = bateleur_plant::Airframe::from_toml(text)?;
    let conditions = Conditions { seed, turbulence: Turbulence::Light, ..Conditions::default() };
    let mut plant = Simulation::in_flight(&plant, &conditions, &FlightStart::default())?;
    let mut estimator = Estimator::new(EstimatorConfig::at_site(&Site::default())?);
    let guidance = Guidance::new(GuidanceConfig::default(), &seed_waypoints())?;
    let mut controller = Controller::new(Airframe::from_toml(text)?, ControllerConfig::default(), guidance);
    let trim = *controller.trim();
    let pilot = ActuatorCommand {
        throttle: trim.throttle,
        elevator_rad: trim.elevator_rad,
        ..ActuatorCommand::default()
    };
    let mut timed = Timed { estimator_us: Vec::new(), controller_us: Vec::new() };
    for _ in 0..frames {
        let sensors = plant.sensors();
        let begun = Instant::now();
        estimate(&mut estimator, &sensors);
        let navigation = black_box(estimator.state());
        let after = Instant::now();
        let density = density_kgpm3(pressure_altitude_m(sensors.static_pressure_pa).unwrap_or(0.0));
        let inputs = ControllerInputs {
            navigation: navigation.as_ref(),
            rates: sensors.gyroscope_radps,
            specific_force: sensors.accelerometer_mps2,
            airspeed_mps: Some(airspeed_mps(sensors.differential_pressure_pa, density)),
            density_kgpm3: Some(density),
            range_m: sensors.range_m,
            pilot,
            dt_s: FRAME_S,
        };
        let output: ControllerOutput = black_box(controller.step(&inputs, &LoopCommands::MISSION));
        let ended = Instant::now();
        timed.estimator_us.push((after - begun).as_secs_f64() * 1e6);
        timed.controller_us.push((ended - after).as_secs_f64() * 1e6);
        let c = output.command;
        let (aileron_rad, elevator_rad, rudder_rad) = (c.aileron_rad, c.elevator_rad, c.rudder_rad);
        plant.advance(Controls { aileron_rad, elevator_rad, rudder_rad, throttle: c.throttle }, FRAME_S);
    }
    Ok(timed)
}

fn estimate(estimator: &mut Estimator, s: &SensorSet) {
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
        estimator.update_gps(&GpsMeasurement {
            time_s: fix.measured_at_s,
            position_ned: fix.position_ned_m,
            velocity_ned: fix.velocity_ned_mps,
        });
    }
}

/// Median time of F P Fᵀ, µs.
fn multiply(times: usize) -> f64 {
    let mut transition: Dense = [[0.0; STATES]; STATES];
    let mut covariance: Dense = [[0.0; STATES]; STATES];
    for i in 0..STATES {
        for j in 0..STATES {
            let near = 0.02 / (1.0 + i.abs_diff(j) as f64);
            (transition[i][j], covariance[i][j]) = if i == j { (1.0, 1.0) } else { (near, near) };
        }
    }
    let taken = (0..times).map(|_| {
        let begun = Instant::now();
        let half = product(black_box(&transition), black_box(&covariance));
        black_box(product(&half, &transposed(&transition)));
        begun.elapsed().as_secs_f64() * 1e6
    });
    median(&taken.collect::<Vec<_>>()).unwrap_or(0.0)
}

fn product(left: &Dense, right: &Dense) -> Dense {
    let mut result = [[0.0; STATES]; STATES];
    for (row, to) in left.iter().zip(&mut result) {
        for (factor, line) in row.iter().zip(right) {
            to.iter_mut().zip(line).for_each(|(sum, value)| *sum += factor * value);
        }
    }
    result
}

fn transposed(matrix: &Dense) -> Dense {
    std::array::from_fn(|i| std::array::from_fn(|j| matrix[j][i]))
}
