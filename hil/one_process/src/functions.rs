//! Which program of a plan is which partition.
//!
//! A partition is written once, in the `main.rs` of its crate; here it is compiled a second time.

#![allow(dead_code)] // the programs' `main`

use bateleur_apex::{Hosted, Hosting, StartError};

#[path = "../../../partitions/command/src/main.rs"]
mod command;
#[path = "../../../partitions/controller/src/main.rs"]
mod controller;
#[path = "../../../partitions/estimator/src/main.rs"]
mod estimator;
#[path = "../../../partitions/gps/src/main.rs"]
mod gps;
#[path = "../../../partitions/hil_interface/src/main.rs"]
mod hil_interface;
#[path = "../../../partitions/imu/src/main.rs"]
mod imu;
#[path = "../../../partitions/onboard_computer/src/main.rs"]
mod onboard_computer;
#[path = "../../../partitions/rate_generator/src/main.rs"]
mod rate_generator;
#[path = "../../../partitions/servo/src/main.rs"]
mod servo;

/// Starts the partition of a program.
pub(crate) type Start = fn(Hosting<'_>) -> Result<Hosted, StartError>;

const PROGRAMS: [(&str, Start); 9] = [
    ("rate_generator", Hosted::start::<rate_generator::RateGenerator>),
    ("hil_interface", Hosted::start::<hil_interface::HilInterface>),
    ("gps", Hosted::start::<gps::Receiver>),
    ("imu", Hosted::start::<imu::InertialUnit>),
    ("estimator", Hosted::start::<estimator::EstimatorPartition>),
    ("controller", Hosted::start::<controller::ControllerPartition>),
    ("servo", Hosted::start::<servo::Actuators>),
    ("onboard_computer", Hosted::start::<onboard_computer::OnBoardComputer>),
    ("command", Hosted::start::<command::Command>),
];

/// By the program's name in the plan; a path names a program of somebody's own.
pub(crate) fn of(program: &str) -> Option<Start> {
    PROGRAMS.iter().find(|(name, _)| *name == program).map(|(_, start)| *start)
}
