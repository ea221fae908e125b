//! What a frame of the plant costs. A coarse bound, so that only a blunder fails it.

use bateleur_plant::{Airframe, Conditions, Controls, FlightStart, Simulation, Turbulence};
use std::time::Instant;

#[test]
fn a_frame_with_sensors_is_cheap() {
    let conditions = Conditions { turbulence: Turbulence::Light, ..Conditions::default() };
    let mut plant =
        Simulation::in_flight(&Airframe::aerosonde(), &conditions, &FlightStart::default()).unwrap();
    let controls = Controls { elevator_rad: -0.2, throttle: 0.69, ..Controls::default() };
    let begin = Instant::now();
    let frames = 20_000;
    let mut sum = 0.0;
    for _ in 0..frames {
        plant.advance(controls, 0.02);
        sum += plant.sensors().static_pressure_pa;
    }
    let micros = begin.elapsed().as_secs_f64() * 1e6 / f64::from(frames);
    println!("{micros:.2} us per 20 ms frame ({sum})");
    assert!(micros < 500.0, "{micros} us per frame");
}
