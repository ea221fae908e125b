//! What a simulation is started with.

use crate::outside::Outside;
use bateleur_messages::hil::Protocol;
use bateleur_plant::{Airframe, Conditions, EMBEDDED, Flaws, airframe_file};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use thiserror::Error;

/// Port on which flight computers expect the simulator, in the native protocol.
pub const DEFAULT_PORT: u16 = Protocol::Native.port();

/// Everything about one run of the simulator.
#[derive(Debug, Clone)]
pub struct Options {
    /// Address to listen on; port 0 takes a free one.
    pub listen: SocketAddr,
    /// What is spoken with the flight computer.
    pub protocol: Protocol,
    /// The aircraft.
    pub airframe: Airframe,
    /// Seed, wind and sensor errors.
    pub conditions: Conditions,
    /// What was asked for about sensors, faults and aircraft, for the log: it is in effect already.
    pub outside: Outside,
    /// Advance by an own clock instead of by the flight computer's.
    pub free_running: bool,
    /// Where to log the truth.
    pub truth: Option<PathBuf>,
    /// Where a FlightGear listens that is to draw the aircraft.
    pub flightgear: Option<SocketAddr>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from((Ipv4Addr::LOCALHOST, DEFAULT_PORT)),
            protocol: Protocol::Native,
            airframe: Airframe::aerosonde(),
            conditions: Conditions::default(),
            outside: Outside::default(),
            free_running: false,
            truth: None,
            flightgear: None,
        }
    }
}

/// Why an airframe could not be had.
#[derive(Debug, Error)]
pub enum AirframeChoiceError {
    /// Neither an embedded airframe nor a file.
    #[error(
        "\"{choice}\" is neither an embedded airframe nor a readable file ({error}); embedded are {}, and a path names a \
         TOML file of your own",
        embedded()
    )]
    Unknown {
        /// What was asked for.
        choice: String,
        /// What the file system said.
        error: std::io::Error,
    },
    /// The file holds no airframe: all that is wrong with it.
    #[error("the airframe file cannot be used\n{}", flaws.in_file(&path.display().to_string()))]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        flaws: Flaws,
    },
}

/// The airframe called `choice`, or the one in the file of that name.
///
/// # Errors
/// When there is none, or it makes no sense.
pub fn airframe(choice: &str) -> Result<Airframe, AirframeChoiceError> {
    let text = match EMBEDDED.iter().find(|(name, _)| *name == choice) {
        Some((_, text)) => (*text).to_owned(),
        None => std::fs::read_to_string(choice)
            .map_err(|error| AirframeChoiceError::Unknown { choice: choice.to_owned(), error })?,
    };
    airframe_file::read(&text).map_err(|flaws| AirframeChoiceError::Invalid { path: choice.into(), flaws })
}

fn embedded() -> String {
    EMBEDDED.map(|(name, _)| format!("\"{name}\"")).join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn misspelt_airframe_names_those_that_exist() {
        let message = airframe("aerosond").unwrap_err().to_string();
        assert!(message.contains("\"aerosonde\", \"rascal110\", "), "{message}");
        for (name, _) in EMBEDDED {
            assert!(airframe(name).is_ok(), "{name}");
        }
    }

    #[test]
    fn airframe_of_ones_own_is_read_from_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mine.toml");
        std::fs::write(&path, "name = \"half\"").unwrap();
        let message = airframe(path.to_str().unwrap()).unwrap_err().to_string();
        assert!(message.contains("mine.toml:1:1: the file has no `mass`"), "{message}");
    }
}
