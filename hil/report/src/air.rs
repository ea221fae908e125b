//! Whether the air was the one that was asked for: a score in an air that was not there is worth nothing.

use bateleur_plant::Turbulence;
use bateleur_plant::wind::Spectrum;
use bateleur_simulator::truth::TruthRecord;

use crate::flight::Conditions;

/// Difference of the mean wind from the one asked for, m/s: it is constant, and known without its gusts.
const WIND_ROOM_MPS: f64 = 0.01;
/// Gusts of a few minutes, as shares of their standard deviation in the long run: a flight holds some ten of the longest.
/// One level of turbulence more or less is a factor of two.
const GUST_ROOM: std::ops::Range<f64> = 0.55..1.75;
/// Below so many seconds in the air nothing is said about gusts.
const LEAST_S: f64 = 60.0;

/// Whether mean wind and gusts of these records are those of the conditions.
pub fn is_as_asked(asked: &Conditions, airborne: &[&TruthRecord]) -> bool {
    wind_is_as_asked(asked, airborne) && gusts_are_as_asked(asked, airborne)
}

fn wind_is_as_asked(asked: &Conditions, airborne: &[&TruthRecord]) -> bool {
    let wanted =
        [-asked.wind_mps * asked.wind_from_rad.cos(), -asked.wind_mps * asked.wind_from_rad.sin(), 0.0];
    (0..3).all(|axis| {
        let off = |record: &&TruthRecord| {
            (record.wind_ned_mps[axis] - record.gust_ned_mps[axis] - wanted[axis]).abs()
        };
        airborne.iter().map(off).fold(0.0, f64::max) < WIND_ROOM_MPS
    })
}

fn gusts_are_as_asked(asked: &Conditions, airborne: &[&TruthRecord]) -> bool {
    let planned = asked.faults.iter().any(|fault| fault.starts_with("gust") || fault.starts_with("updraft"));
    let (Some(first), Some(last)) = (airborne.first(), airborne.last()) else { return true };
    if planned {
        return true;
    }
    let Some(level) = level(&asked.turbulence) else { return false };
    if level == Turbulence::Calm {
        return airborne.iter().all(|record| record.gust_ned_mps == [0.0; 3]);
    }
    if ((last.time_ns - first.time_ns) as f64) < LEAST_S * 1e9 {
        return true;
    }
    let share = |met: fn(&[f64; 3]) -> f64, due: fn(&Spectrum) -> f64| {
        let met: f64 = airborne.iter().map(|record| met(&record.gust_ned_mps)).sum();
        let due = |record: &&TruthRecord| due(&Spectrum::low_altitude(level, -record.position_ned_m[2]));
        (met / airborne.iter().map(due).sum::<f64>()).sqrt()
    };
    let along =
        share(|gust| gust[0] * gust[0] + gust[1] * gust[1], |due| 2.0 * due.horizontal_sigma_mps.powi(2));
    let vertical = share(|gust| gust[2] * gust[2], |due| due.vertical_sigma_mps.powi(2));
    GUST_ROOM.contains(&along) && GUST_ROOM.contains(&vertical)
}

fn level(name: &str) -> Option<Turbulence> {
    let levels = [Turbulence::Calm, Turbulence::Light, Turbulence::Moderate, Turbulence::Severe];
    levels.into_iter().find(|level| format!("{level:?}").to_lowercase() == name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_plant::{Airframe, Simulation};
    use bateleur_plant::{Conditions as Set, Controls, FlightStart, trim};

    /// What a plant in a set air logs in 200 s, with its wings held level.
    fn logged(wind_mps: f64, from_deg: f64, turbulence: Turbulence) -> Vec<TruthRecord> {
        let set = Set {
            wind_speed_mps: wind_mps,
            wind_from_rad: f64::to_radians(from_deg),
            turbulence,
            ..Set::default()
        };
        let airframe = Airframe::aerosonde();
        let at = trim(&airframe, 22.0, 0.0, 160.0).unwrap().controls;
        let mut plant = Simulation::in_flight(&airframe, &set, &FlightStart::default()).unwrap();
        let mut log = Vec::new();
        for step in 1..=2_000 {
            let truth = plant.truth();
            let level = Controls {
                aileron_rad: at.aileron_rad - 0.5 * truth.roll_rad - 0.1 * truth.rates_radps.x,
                elevator_rad: at.elevator_rad + 0.6 * (truth.pitch_rad - 0.08) + 0.1 * truth.rates_radps.y,
                ..at
            };
            plant.advance(level, 0.1);
            log.push(TruthRecord::new(step * 100_000_000, &plant.truth(), &Default::default()));
        }
        log
    }

    fn asked(wind_mps: f64, from_deg: f64, turbulence: &str) -> Conditions {
        Conditions {
            airframe: String::new(),
            wind_mps,
            wind_from_rad: from_deg.to_radians(),
            turbulence: turbulence.into(),
            faults: Vec::new(),
            variation: Vec::new(),
        }
    }

    #[test]
    fn air_that_was_asked_for_is_told_from_any_other() {
        let log = logged(6.0, 250.0, Turbulence::Light);
        let records: Vec<&TruthRecord> = log.iter().collect();
        assert!(is_as_asked(&asked(6.0, 250.0, "light"), &records));
        assert!(!is_as_asked(&asked(6.0, 70.0, "light"), &records), "the wind from the other side");
        assert!(!is_as_asked(&asked(5.0, 250.0, "light"), &records), "a weaker wind");
        assert!(!is_as_asked(&asked(6.0, 250.0, "moderate"), &records), "more turbulence");
        assert!(!is_as_asked(&asked(6.0, 250.0, "calm"), &records), "none");
        assert!(!is_as_asked(&asked(6.0, 250.0, "storm"), &records), "an unknown level");
    }

    #[test]
    fn gust_that_was_planned_speaks_for_itself() {
        let log = logged(0.0, 0.0, Turbulence::Light);
        let records: Vec<&TruthRecord> = log.iter().collect();
        let planned = Conditions { faults: vec!["gust=8,270@1..2".into()], ..asked(0.0, 0.0, "calm") };
        assert!(is_as_asked(&planned, &records));
    }
}
