//! The result of a campaign: counts, failures, and how each figure spreads.

use std::collections::BTreeMap;

use serde::Serialize;

use super::record::{Flown, Lines, Plan};

/// A figure of a flight: its name in the summary, what to call it, its unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Figure {
    /// Name in `summary.json`; with a dot where it stands in a table.
    pub name: &'static str,
    /// For a person.
    pub label: &'static str,
    /// Its unit.
    pub unit: &'static str,
}

impl Figure {
    /// Those of every campaign: larger is worse, on either side of zero.
    pub const ALL: [Self; 18] = [
        Self { name: "cross_track_rms_m", label: "cross-track, RMS", unit: "m" },
        Self { name: "straight_cross_track_rms_m", label: "cross-track, straight legs", unit: "m" },
        Self { name: "cross_track_max_m", label: "cross-track, greatest", unit: "m" },
        Self { name: "cross_track_true_rms_m", label: "cross-track, plain truth", unit: "m" },
        Self { name: "altitude_rms_m", label: "altitude, RMS", unit: "m" },
        Self { name: "altitude_true_rms_m", label: "altitude, plain truth", unit: "m" },
        Self { name: "airspeed_rms_mps", label: "airspeed, RMS", unit: "m/s" },
        Self { name: "conditions.bank_max_deg", label: "bank, greatest", unit: "°" },
        Self { name: "estimator.roll_rms_deg", label: "estimate: roll", unit: "°" },
        Self { name: "estimator.pitch_rms_deg", label: "estimate: pitch", unit: "°" },
        Self { name: "estimator.yaw_rms_deg", label: "estimate: yaw", unit: "°" },
        Self { name: "estimator.velocity_rms_mps", label: "estimate: velocity", unit: "m/s" },
        Self { name: "estimator.position_rms_m", label: "estimate: position", unit: "m" },
        Self { name: "conditions.touchdown.sink_mps", label: "touch-down, sink rate", unit: "m/s" },
        Self { name: "conditions.touchdown.along_m", label: "touch-down, off along", unit: "m" },
        Self { name: "conditions.touchdown.across_m", label: "touch-down, off across", unit: "m" },
        Self { name: "recovery_max_ms", label: "back after a fault, latest", unit: "ms" },
        Self { name: "module_time_s", label: "flight, module time", unit: "s" },
    ];
}

/// How a figure spreads over the completed flights.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Spread {
    /// Its name.
    pub figure: String,
    /// Flights that have it.
    pub flights: u64,
    /// Half of them are not above.
    pub p50: f64,
    /// 95 of 100 are not above.
    pub p95: f64,
    /// 99 of 100 are not above.
    pub p99: f64,
    /// The greatest.
    pub worst: f64,
    /// Number of the flight with the greatest.
    pub worst_flight: u64,
    /// Its seed.
    pub worst_seed: u64,
    /// What to type to fly that one again.
    pub worst_command: String,
    /// All values in rising order, for the page.
    #[serde(skip)]
    pub values: Vec<f64>,
}

/// A flight that failed.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Failure {
    /// Its number.
    pub number: u64,
    /// Its seed.
    pub seed: u64,
    /// Why.
    pub reason: String,
    /// What to type to fly it again.
    pub command: String,
}

/// The whole result.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CampaignResult {
    /// What was to be flown.
    pub plan: Plan,
    /// Flights that were to be flown, in this shard.
    pub asked: u64,
    /// Flights that were flown.
    pub flown: u64,
    /// Those that completed their mission.
    pub completed: u64,
    /// The others.
    pub failed: Vec<Failure>,
    /// Failures by reason, numbers in the reasons left out.
    pub reasons: BTreeMap<String, u64>,
    /// How the figures spread over the completed flights.
    pub figures: Vec<Spread>,
    /// Real time of all flights together, h.
    pub flight_hours: f64,
    /// Flights by what flew them, in a campaign that does not fly partitions alone.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub engines: BTreeMap<String, u64>,
    /// Flights that were flown a second time, as partitions, and compared word by word.
    pub compared: u64,
    /// What is missing or damaged.
    pub notes: Vec<String>,
}

impl CampaignResult {
    /// Puts the flights together.
    pub fn of(plan: &Plan, lines: &Lines) -> Self {
        let (flights, others): (Vec<&Flown>, Vec<&Flown>) =
            lines.flights.values().partition(|flight| plan.has(flight.number));
        let completed: Vec<&Flown> = flights.iter().copied().filter(|flight| flight.completed).collect();
        let failed: Vec<Failure> =
            flights.iter().filter(|flight| !flight.completed).map(|flight| failure(flight)).collect();
        let mut reasons = BTreeMap::new();
        for failure in &failed {
            *reasons.entry(without_numbers(&failure.reason)).or_insert(0) += 1;
        }
        let mut engines = BTreeMap::new();
        for engine in flights.iter().filter_map(|flight| flight.engine.clone()) {
            *engines.entry(engine).or_insert(0) += 1;
        }
        Self {
            engines,
            compared: flights.iter().filter(|flight| flight.compared).count() as u64,
            asked: asked(plan),
            flown: flights.len() as u64,
            completed: completed.len() as u64,
            failed,
            reasons,
            figures: Figure::ALL.iter().filter_map(|figure| spread(figure, &completed)).collect(),
            flight_hours: flights.iter().map(|flight| flight.wall_time_s).sum::<f64>() / 3600.0,
            notes: notes(plan, flights.len() as u64, others.len(), lines),
            plan: plan.clone(),
        }
    }
}

impl CampaignResult {
    /// What flew the flights, as a sentence; nothing where all were flown as partitions from the beginning.
    pub fn engine_words(&self) -> Option<String> {
        let named = |(engine, count): (&String, &u64)| format!("{count} flown by {engine}");
        let list: Vec<String> = self.engines.iter().map(named).collect();
        (!list.is_empty()).then(|| {
            format!("{}; {} of them again as partitions, word by word", list.join(", "), self.compared)
        })
    }
}

fn failure(flight: &Flown) -> Failure {
    let reason = flight.failure.clone().unwrap_or_else(|| "the mission was not completed".into());
    Failure { number: flight.number, seed: flight.seed, reason, command: flight.command.clone() }
}

/// A reason with `…` for its numbers, so that the same reason counts as one.
fn without_numbers(reason: &str) -> String {
    let mut text = String::new();
    for letter in reason.chars() {
        match (letter.is_ascii_digit(), text.ends_with('…')) {
            (true, true) => {}
            (true, false) => text.push('…'),
            (false, true) if letter == '.' => {}
            (false, _) => text.push(letter),
        }
    }
    text
}

/// Flights of this part. Reckoned and not counted: the plan is a file, and may say any number.
fn asked(plan: &Plan) -> u64 {
    let (part, parts) = plan.shard;
    plan.flights.saturating_sub(part).div_ceil(parts.max(1))
}

fn notes(plan: &Plan, flown: u64, others: usize, lines: &Lines) -> Vec<String> {
    let mut notes = lines.notes.clone();
    if others > 0 {
        notes.push(format!("{others} more are there that were not asked for now (--flights, --shard)"));
    }
    let missing = asked(plan).saturating_sub(flown);
    if missing > 0 {
        let absent = plan.numbers().filter(|number| !lines.flights.contains_key(number));
        let first: Vec<String> = absent.take(8).map(|number| number.to_string()).collect();
        let more = if missing > first.len() as u64 { ", …" } else { "" };
        notes.push(format!("not flown: {missing} of {} flights ({}{more})", asked(plan), first.join(", ")));
    }
    if lines.damaged > 0 {
        notes.push(format!("{} lines of the results are damaged and left out", lines.damaged));
    }
    for number in lines.contradictions.iter().take(8) {
        notes.push(format!("flight {number} was flown twice and did not end the same way"));
    }
    notes
}

fn spread(figure: &Figure, completed: &[&Flown]) -> Option<Spread> {
    let value = |flight: &&Flown| {
        flight.figures.get(figure.name).map(|value| value.abs()).filter(|value| value.is_finite())
    };
    let worst = completed.iter().filter_map(|flight| Some((value(flight)?, *flight)));
    let (worst, flight) = worst.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let mut values: Vec<f64> = completed.iter().filter_map(value).collect();
    values.sort_by(f64::total_cmp);
    // The smallest value that so many are not above.
    let quantile = |share: f64| {
        let rank = (share * values.len() as f64).ceil() as usize;
        values[rank.clamp(1, values.len()) - 1]
    };
    Some(Spread {
        figure: figure.name.into(),
        flights: values.len() as u64,
        p50: quantile(0.50),
        p95: quantile(0.95),
        p99: quantile(0.99),
        worst,
        worst_flight: flight.number,
        worst_seed: flight.seed,
        worst_command: flight.command.clone(),
        values,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reasons_with_other_numbers_are_one_reason() {
        assert_eq!(
            without_numbers("no way-point for 60.5 s (imu is idle)"),
            without_numbers("no way-point for 7 s (imu is idle)")
        );
        assert_eq!(without_numbers("at 12.5 m"), "at … m");
    }
}
