//! The flight's partitions in one file, for packages: each is started by its own name, as a link to this file, and is a process of its own
//! with walls of its own, as it is with a program of its own.
//!
//! Twelve programs of two megabytes hold the same library twelve times (decision 62). A partition's code is its own crate's alone; here is
//! only which name means which.

#[path = "../../can_interface/src/main.rs"]
mod can_interface;
#[path = "../../command/src/main.rs"]
mod command;
#[path = "../../controller/src/main.rs"]
mod controller;
#[path = "../../estimator/src/main.rs"]
mod estimator;
#[path = "../../gps/src/main.rs"]
mod gps;
#[path = "../../hil_interface/src/main.rs"]
mod hil_interface;
#[path = "../../imu/src/main.rs"]
mod imu;
#[path = "../../onboard_computer/src/main.rs"]
mod onboard_computer;
#[path = "../../rate_generator/src/main.rs"]
mod rate_generator;
#[path = "../../receiver/src/main.rs"]
mod receiver;
#[path = "../../servo/src/main.rs"]
mod servo;
#[path = "../../voter/src/main.rs"]
mod voter;

use std::process::ExitCode;

/// A partition's program: its name, and what it runs.
type Program = (&'static str, fn() -> ExitCode);

const PROGRAMS: [Program; 12] = [
    ("rate_generator", rate_generator::main),
    ("hil_interface", hil_interface::main),
    ("gps", gps::main),
    ("imu", imu::main),
    ("estimator", estimator::main),
    ("controller", controller::main),
    ("servo", servo::main),
    ("onboard_computer", onboard_computer::main),
    ("command", command::main),
    ("receiver", receiver::main),
    ("can_interface", can_interface::main),
    ("voter", voter::main),
];

/// It was started by a name that is no partition's.
const CANNOT_RUN: u8 = 2;

fn main() -> ExitCode {
    let given = std::env::args_os().next().unwrap_or_default();
    let name = std::path::Path::new(&given).file_name().unwrap_or_default();
    match PROGRAMS.iter().find(|(program, _)| name == *program) {
        Some((_, run)) => run(),
        None => {
            let names: Vec<&str> = PROGRAMS.iter().map(|(program, _)| *program).collect();
            eprintln!(
                "bateleur_partitions: start it by the name of a partition's program, as a link to this file: {}",
                names.join(", ")
            );
            ExitCode::from(CANNOT_RUN)
        }
    }
}
