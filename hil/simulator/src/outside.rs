//! Options about what is outside of the flight computer: sensors, faults, the aircraft that is really flown.
//!
//! `simulator` and `bateleur fly` take the same ones: the second hands them on to the first.

use crate::options::Options;
use bateleur_plant::variation::{Change, VariationError, change};
use bateleur_plant::{PlannedFault, Ranges, SensorErrors, vary};
use thiserror::Error;

/// Sensors, faults and the aircraft.
#[derive(Debug, Clone, Default, PartialEq, clap::Args)]
#[command(next_help_heading = "Sensors, faults and the aircraft that is really flown")]
pub struct Outside {
    /// Errors of the sensors: calibrated, data-sheet, perfect, or a TOML file [default: calibrated].
    #[arg(long, value_name = "WHAT|FILE")]
    pub sensors: Option<String>,
    /// A fault of a sensor, an actuator or the air, in seconds of flight: gps_lost@100..130, frames_lost=1/50,
    /// left_aileron_stuck=30%@90, delay=0.06, pause@60..60.5, gust=8,270@70..74 (may be repeated).
    #[arg(long, value_name = "FAULT[=VALUE][@FROM[..TO]]")]
    pub fault: Vec<PlannedFault>,
    /// Draw the aircraft about its file, the laws keep the file: mass=10%,inertia=10%,derivatives=20%,power=5%,servo=20%.
    #[arg(long, value_name = "RANGES")]
    pub vary: Option<Ranges>,
    /// Seed of that draw [default: the flight's].
    #[arg(long, value_name = "NUMBER", requires = "vary")]
    pub vary_seed: Option<u64>,
    /// Change a number of the aircraft, the laws keep the file: mass.mass_kg=12 or aerodynamics.lift_alpha=x0.8
    /// (may be repeated).
    #[arg(long, value_name = "KEY=VALUE")]
    pub plant: Vec<Change>,
}

/// Why these options cannot be followed.
#[derive(Debug, Error)]
pub enum OutsideError {
    /// The sensors' file cannot be read.
    #[error("--sensors {choice}: {error}; choose calibrated, data-sheet, perfect, or a readable TOML file")]
    Unknown {
        /// What was asked for.
        choice: String,
        /// What the file system said.
        error: std::io::Error,
    },
    /// The sensors' file makes no sense.
    #[error("--sensors {choice}: {error}")]
    Sensors {
        /// The file.
        choice: String,
        /// What is wrong, with line and column.
        error: toml::de::Error,
    },
    /// The aircraft cannot be varied so.
    #[error(transparent)]
    Variation(#[from] VariationError),
}

impl Outside {
    /// Puts all of it into the options of a simulation, whose seed and airframe are set.
    ///
    /// # Errors
    /// When a file cannot be read, or what comes out makes no sense.
    pub fn apply(&self, options: &mut Options) -> Result<(), OutsideError> {
        options.airframe = change(&options.airframe, &self.plant)?;
        if let Some(ranges) = &self.vary {
            let seed = self.vary_seed.unwrap_or(options.conditions.seed);
            options.airframe = vary(&options.airframe, seed, ranges)?;
        }
        if let Some(choice) = &self.sensors {
            options.conditions.sensors = sensors(choice)?;
        }
        options.conditions.faults.clone_from(&self.fault);
        options.outside = self.clone();
        Ok(())
    }

    /// The options again, for another program.
    pub fn arguments(&self) -> Vec<String> {
        let mut all = Vec::new();
        let mut add = |name: &str, value: String| all.extend([format!("--{name}={value}")]);
        self.sensors.iter().for_each(|choice| add("sensors", choice.clone()));
        self.fault.iter().for_each(|fault| add("fault", fault.to_string()));
        self.vary.iter().for_each(|ranges| add("vary", ranges.to_string()));
        self.vary_seed.iter().for_each(|seed| add("vary-seed", seed.to_string()));
        self.plant.iter().for_each(|change| add("plant", change.to_string()));
        all
    }

    /// A line for each fault whose time did not come.
    pub fn not_reached(&self, module_time_s: f64) -> Vec<String> {
        let missed = self.fault.iter().filter(|fault| fault.from_s > module_time_s);
        missed
            .map(|fault| format!("--fault {fault} was not reached: it ended at {module_time_s:.2} s"))
            .collect()
    }
}

fn sensors(choice: &str) -> Result<SensorErrors, OutsideError> {
    match choice {
        "calibrated" => Ok(SensorErrors::default()),
        "data-sheet" => Ok(SensorErrors::uncalibrated()),
        "perfect" => Ok(SensorErrors::none()),
        _ => {
            let unknown = |error| OutsideError::Unknown { choice: choice.to_owned(), error };
            let text = std::fs::read_to_string(choice).map_err(unknown)?;
            SensorErrors::from_toml(&text)
                .map_err(|error| OutsideError::Sensors { choice: choice.to_owned(), error })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Program {
        #[command(flatten)]
        outside: Outside,
    }

    fn parsed(arguments: &[String]) -> Outside {
        let all = std::iter::once("program".to_owned()).chain(arguments.iter().cloned());
        Program::try_parse_from(all).unwrap().outside
    }

    fn all() -> Outside {
        let texts =
            ["--fault=gps_lost@100..130", "--fault=updraft=-5@1..2", "--vary=mass=10%", "--vary-seed=4"];
        let more = ["--plant=servo.backlash_rad=0.01", "--plant=mass.mass_kg=x1.1", "--sensors=data-sheet"];
        parsed(&[&texts[..], &more[..]].concat().iter().map(|text| (*text).to_owned()).collect::<Vec<_>>())
    }

    #[test]
    fn options_come_back_from_what_is_handed_on() {
        assert_eq!(parsed(&all().arguments()), all());
        assert_eq!(Outside::default().arguments(), Vec::<String>::new());
    }

    #[test]
    fn options_reach_the_aircraft_and_its_sensors() {
        let mut options = Options::default();
        let before = options.airframe.clone();
        all().apply(&mut options).unwrap();
        assert_eq!(options.airframe.servo.backlash_rad, 0.01);
        let factor = options.airframe.mass.mass_kg / before.mass.mass_kg;
        assert!((0.99..=1.21).contains(&factor) && factor != 1.1, "{factor}");
        assert_eq!(options.conditions.sensors, SensorErrors::uncalibrated());
        assert_eq!(options.conditions.faults.len(), 2);
    }

    #[test]
    fn sensors_of_a_file_take_what_it_names_and_mistakes_have_their_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mine.toml");
        let apply = |text: &str| {
            std::fs::write(&path, text).unwrap();
            let outside = Outside { sensors: Some(path.display().to_string()), ..Outside::default() };
            let mut options = Options::default();
            outside
                .apply(&mut options)
                .map(|()| options.conditions.sensors)
                .map_err(|error| error.to_string())
        };
        let sensors = apply("static_pressure_noise_pa = 3.0\n[gps]\nlatency_s = 0.25\n").unwrap();
        assert_eq!((sensors.static_pressure_noise_pa, sensors.gps.latency_s), (3.0, 0.25));
        assert_eq!(sensors.gyroscope_noise_radps, SensorErrors::default().gyroscope_noise_radps);
        let wrong = apply("\nstatic_noise = 3.0\n").unwrap_err();
        assert!(wrong.contains("line 2") && wrong.contains("static_noise"), "{wrong}");
    }

    #[test]
    fn fault_after_the_end_is_told_of() {
        assert_eq!(all().not_reached(50.0).len(), 1);
        assert_eq!(all().not_reached(100.0).len(), 0);
    }
}
