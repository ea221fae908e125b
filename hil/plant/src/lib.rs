//! An aircraft as physics: six degrees of freedom, wind, sensors.
//!
//! Responsible for what the air, the ground, the motor and the sensors do; given the same airframe, conditions and
//! commands it does the same again, bit for bit. The one thing it must never do: look at a clock, a file or a socket.
//!
//! ```
//! use bateleur_plant::{Airframe, Conditions, Controls, Simulation};
//!
//! let mut plant = Simulation::new(&Airframe::aerosonde(), &Conditions::default())?;
//! plant.advance(Controls { throttle: 1.0, ..Controls::default() }, 0.020);
//! let measured = plant.sensors(); // for the flight computer
//! let truth = plant.truth(); // for the score
//! assert!(truth.on_ground && measured.gyroscope_radps.norm() < 0.1);
//! # Ok::<(), bateleur_plant::AirframeError>(())
//! ```
//!
//! Axes: north, east, down from the runway; body forward, right, down. SI units, angles in rad.
//!
//! Signs of the commands: a positive aileron rolls right (C_lδa > 0), a positive elevator pitches down (C_mδe < 0), a
//! positive rudder turns the nose left (C_nδr < 0). Throttle is 0 to 1.

#![forbid(unsafe_code)]

pub mod aerodynamics;
pub mod airframe;
pub mod airframe_file;
pub mod atmosphere;
mod dynamics;
pub mod fault;
mod gear;
pub mod geodesy;
pub mod modes;
mod noise;
pub mod propulsion;
pub mod rigid_body;
pub mod sensors;
mod servo;
mod simulation;
pub mod trim;
pub mod variation;
pub mod wind;
mod words;

pub use aerodynamics::Surfaces;
pub use airframe::{Airframe, AirframeError, EMBEDDED};
pub use airframe_file::{Flaw, Flaws};
pub use fault::{Fault, FaultError, PlannedFault};
pub use geodesy::{Geodetic, LocalFrame};
pub use modes::{Mode, Modes};
pub use sensors::{GpsErrors, GpsFix, RangeErrors, SensorErrors, SensorSet};
pub use simulation::{Conditions, Controls, FlightStart, STEP_S, Simulation, StartError, Truth};
pub use trim::{Trim, TrimError, trim};
pub use variation::{Ranges, vary};
pub use wind::Turbulence;

/// A number from 0 to 1, evenly drawn, that belongs to a seed and a name: for campaigns. One name more or less changes no other's.
pub fn drawn(seed: u64, name: &str) -> f64 {
    noise::Noise::named(seed, name).unit()
}
