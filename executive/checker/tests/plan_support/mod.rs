//! What the tests of the plan share.

// Each test file uses a part of it.
#![allow(dead_code)]

pub(crate) mod schema_check;

use std::path::{Path, PathBuf};

use bateleur_checker::{Contents, Keys, MessageCatalogue, Programs, Report, Surroundings, check_among};
use bateleur_plan::Plan;

/// The message types that the schedules of the tests name, each with a size.
pub(crate) struct Table;

const NAMES: &[&str] = &[
    "Rate",
    "RawGps",
    "RawAnalog",
    "Custom",
    "Range",
    "GpsPosition",
    "GpsVelocity",
    "Acceleration",
    "Rates",
    "Magnetization",
    "Pressure",
    "State",
    "ActuatorCommand",
    "ServoTimers",
    "FunctionStatus",
    "GroundMessage",
    "TelemetryMessage",
    "SimulatorLink",
];

impl MessageCatalogue for Table {
    fn open(&self, folder: Option<&str>) -> Result<(), Vec<(String, String)>> {
        let absent = |folder| vec![(format!("{folder}: there is no such folder"), "make it".to_owned())];
        folder.map_or(Ok(()), |folder| Err(absent(folder)))
    }

    fn size_of(&self, name: &str) -> Option<usize> {
        NAMES.contains(&name).then_some(if name == "GroundMessage" { 256 } else { 64 })
    }

    fn names(&self) -> Vec<&str> {
        NAMES.to_vec()
    }
}

/// Every program is there but those in the folder `nowhere`.
pub(crate) struct Built;

impl Programs for Built {
    fn fault(&self, program: &str) -> Option<String> {
        program.starts_with("nowhere/").then(|| "there is no such file".to_owned())
    }
}

/// Every key is there but those in the folder `nowhere`.
pub(crate) struct Made;

impl Keys for Made {
    fn fault(&self, file: &str) -> Option<String> {
        file.starts_with("nowhere/").then(|| "there is no such file".to_owned())
    }
}

/// Every content is there but those in the folder `nowhere`, and has 4096 bytes.
pub(crate) struct Filled;

impl Contents for Filled {
    fn fault(&self, file: &str, size: u64) -> Option<String> {
        if file.starts_with("nowhere/") {
            return Some("there is no such file".to_owned());
        }
        (size < 4096).then(|| "it has 4096 bytes".to_owned())
    }
}

/// The answer of the checker to a text, with programs, keys and contents looked for.
pub(crate) fn answer_to(name: &str, text: &str) -> Result<(Plan, Report), Report> {
    let surroundings =
        Surroundings { messages: &Table, programs: Some(&Built), keys: Some(&Made), contents: Some(&Filled) };
    check_among(name, text, &surroundings)
}

/// The top of the repository.
pub(crate) fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).map(PathBuf::from).unwrap_or_default()
}
