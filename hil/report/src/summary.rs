//! The flight in numbers: what `summary.json` holds.

use crate::air;
use crate::believed::Believed;
use crate::chains::ChainAge;
use crate::error::{self, ReportError};
use crate::flight::{Flight, Inputs, seconds};
use crate::health::HealthEntry;
use crate::mission::{self, Passage};
use crate::planned::Planned;
use crate::run::{Clock, Guarantee, Run};
use crate::score::{self, EstimatorScores, Scores};
use crate::timing::Percentiles;
use crate::touchdown::Touchdown;
use bateleur_flight::guidance::waypoints_to_reach;
use bateleur_messages::ActuatorCommand;
use bateleur_simulator::truth::TruthRecord;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use zerocopy::IntoBytes;

/// Name of the file in a flight's folder.
pub const FILE: &str = "summary.json";

/// An error that something was done about.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Fault {
    /// Module time, s.
    pub time_s: f64,
    /// The partition, or "module".
    pub partition: String,
    /// What happened.
    pub error: String,
    /// What was done.
    pub action: String,
    /// Until the successor's first window, ms.
    pub recovery_ms: Option<f64>,
}

impl Fault {
    fn of(entry: &HealthEntry) -> Self {
        Self {
            time_s: seconds(entry.time_ns),
            partition: entry.of_whom().to_owned(),
            error: entry.error.clone(),
            action: entry.action.clone(),
            recovery_ms: entry.recovery_ms(),
        }
    }
}

/// What the air and the aircraft did, by the truth, from lift-off to the end.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Conditions {
    /// Name of the airframe.
    pub airframe: String,
    /// Level of turbulence asked for.
    pub turbulence: String,
    /// Faults of sensors, actuators and air that were asked for.
    #[serde(default)]
    pub faults: Vec<String>,
    /// How sensors and aircraft differed from the usual ones.
    #[serde(default)]
    pub variation: Vec<String>,
    /// Mean wind asked for, m/s.
    pub wind_asked_mps: f64,
    /// Mean of the wind met, m/s: length of the mean horizontal vector.
    pub wind_mean_mps: Option<f64>,
    /// Whether mean wind and gusts were those asked for; `None` without a record in the air.
    #[serde(default)]
    pub air_as_asked: Option<bool>,
    /// Root mean square of the gusts met, all axes, m/s.
    pub gust_rms_mps: Option<f64>,
    /// Steepest bank, °.
    pub bank_max_deg: Option<f64>,
    /// Slowest airspeed, m/s.
    pub airspeed_min_mps: Option<f64>,
    /// Fastest airspeed, m/s.
    pub airspeed_max_mps: Option<f64>,
    /// Greatest height, m.
    pub height_max_m: Option<f64>,
    /// The aircraft was lost.
    pub crashed: bool,
    /// Its landing, if it ends with one.
    #[serde(default)]
    pub touchdown: Option<Touchdown>,
}

/// Who says that way-points were reached.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Judge {
    /// The simulator's truth, passage by passage.
    #[default]
    Truth,
    /// The aircraft's own count: somebody else's simulator leaves no truth.
    Aircraft,
}

impl Judge {
    fn of(flight: &Flight) -> Self {
        let foreign = flight.run.as_ref().is_some_and(|run| run.foreign_simulator);
        if foreign && flight.truth.is_empty() { Self::Aircraft } else { Self::Truth }
    }
}

/// The flight in numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Name of the flight's folder.
    pub flight: String,
    /// All laps were flown, by the executive's word and by [`Summary::judged_by`].
    pub completed: bool,
    /// Why not, if not.
    pub failure: Option<String>,
    /// Who says that way-points were reached.
    #[serde(default)]
    pub judged_by: Judge,
    /// Way-points in the order reached, "WP0".
    pub waypoints: Vec<String>,
    /// Module time of each, s.
    pub waypoint_times_s: Vec<f64>,
    /// How near the aircraft came to each, m; the fillets cut the corners.
    pub waypoint_distances_m: Vec<Option<f64>>,
    /// Those that the aircraft counted and the truth does not confirm, with their place in the order from 0.
    pub unverified_waypoints: Vec<usize>,
    /// Whole laps, all way-points in order and confirmed.
    pub laps: u32,
    /// How much module time passed, s.
    pub module_time_s: f64,
    /// How long it took, s.
    pub wall_time_s: Option<f64>,
    /// Module time over wall time.
    pub real_time_factor: Option<f64>,
    /// The clock that the windows followed.
    pub clock: Option<Clock>,
    /// Seed of everything random.
    pub seed: Option<u64>,
    /// The schedule file.
    pub schedule: Option<String>,
    /// Tracking.
    #[serde(flatten)]
    pub scores: Scores,
    /// Radius of each corner of the planned path in the order flown, m.
    pub corner_radii_m: Vec<f64>,
    /// The estimate against the truth.
    pub estimator: EstimatorScores,
    /// What the air and the aircraft did.
    pub conditions: Conditions,
    /// Windows granted.
    pub windows: u64,
    /// Windows whose partition was not there to run.
    pub skipped_windows: u64,
    /// Windows that the dispatcher switched to late.
    pub late_windows: u64,
    /// Windows that their partition had not closed at their end.
    pub window_overruns: u64,
    /// Opened minus planned start, µs; `None` under the virtual clock.
    pub window_start_lateness_us: Option<Percentiles>,
    /// First of the flight chain opened → servo closed, µs, once a minor frame.
    pub chain_execution_us: Option<Percentiles>,
    /// How old values were at the end of each chain of the schedule file.
    #[serde(default)]
    pub chain_ages: Vec<ChainAge>,
    /// Opened → closed by partition, µs.
    pub partition_execution_us: BTreeMap<String, Percentiles>,
    /// Messages on each topic.
    pub messages: BTreeMap<String, u64>,
    /// Errors that something was done about.
    pub faults: Vec<Fault>,
    /// Errors that were written down only: how many of each.
    pub ignored_errors: BTreeMap<String, u64>,
    /// Partitions started anew.
    pub restarts: u64,
    /// Windows that the log lost, because it could not keep up.
    #[serde(default)]
    pub lost_records: u64,
    /// The means that the machine gave, or did not, for each promise.
    pub guarantees: Vec<Guarantee>,
    /// BLAKE3 over every actuator word that the simulator received, in order: equal for equal flights. Where it left no truth, over
    /// every message on the Controller's port.
    pub digest: Option<String>,
    /// What was missing or damaged.
    pub notes: Vec<String>,
}

/// Reads a flight's folder, computes its summary and writes it to [`FILE`] there.
pub fn make(dir: &Path, inputs: &Inputs) -> Result<Summary, ReportError> {
    let flight = Flight::load(dir, inputs)?;
    let summary = Analysis::of(&flight).summary(&flight);
    write(dir, &summary)?;
    Ok(summary)
}

/// Writes a summary to [`FILE`] in a flight's folder.
pub fn write(dir: &Path, summary: &Summary) -> Result<(), ReportError> {
    let path = dir.join(FILE);
    let text =
        serde_json::to_string_pretty(summary).map_err(|why| ReportError::Json { path: path.clone(), why })?;
    error::write(&path, &(text + "\n"))
}

/// What scores and figures both need.
pub struct Analysis {
    /// The way-points reached.
    pub passages: Vec<Passage>,
    /// The path that was to be flown.
    pub planned: Planned,
    /// How the truth is shifted.
    pub believed: Believed,
}

impl Analysis {
    /// Looks at a flight.
    pub fn of(flight: &Flight) -> Self {
        let believed = Believed::of(&flight.truth, flight.inputs.pressure_aiding);
        let waypoints = &flight.inputs.waypoints;
        let mut passages = mission::passages(&flight.commands, waypoints.len());
        let planned = Planned::of(flight, &passages);
        mission::verify(&mut passages, waypoints, &planned, &flight.truth, &believed);
        Self { passages, planned, believed }
    }

    /// The flight in numbers.
    pub fn summary(&self, flight: &Flight) -> Summary {
        let verdict = self.verdict(flight);
        let run = flight.run.as_ref();
        let timing = &flight.timing;
        let used = timing.used.iter().filter_map(|(name, times)| Some((name.clone(), times.percentiles()?)));
        Summary {
            flight: flight.name.clone(),
            completed: verdict.failure.is_none(),
            failure: verdict.failure,
            judged_by: Judge::of(flight),
            waypoints: self.passages.iter().map(Passage::name).collect(),
            waypoint_times_s: self.passages.iter().map(|passage| seconds(passage.time_ns)).collect(),
            waypoint_distances_m: self.passages.iter().map(|passage| passage.distance_m).collect(),
            unverified_waypoints: self.unverified(),
            laps: verdict.laps,
            module_time_s: run.map_or(0.0, |run| run.module_time_s).max(flight.last_time_s()),
            wall_time_s: run.map(|run| run.wall_time_s),
            real_time_factor: run
                .filter(|run| run.wall_time_s > 0.0)
                .map(|run| run.module_time_s / run.wall_time_s),
            clock: run.map(|run| run.clock),
            seed: run.map(|run| run.seed),
            schedule: run.map(|run| run.schedule.clone()),
            scores: score::scores(flight, &self.passages, &self.planned, &self.believed),
            corner_radii_m: self.planned.radii_m(),
            estimator: score::estimator_scores(flight, &self.passages, &self.believed),
            conditions: conditions(flight, &self.believed),
            windows: timing.granted,
            skipped_windows: timing.skipped,
            late_windows: timing.late,
            window_overruns: timing.overruns,
            window_start_lateness_us: run.and_then(|run| timing.lateness_us(run.clock)),
            chain_execution_us: timing.chain.percentiles(),
            chain_ages: flight.chains.clone(),
            partition_execution_us: used.collect(),
            messages: flight.messages.clone(),
            faults: flight.health.iter().filter(|entry| entry.acted_on()).map(Fault::of).collect(),
            ignored_errors: ignored(&flight.health),
            restarts: flight.health.iter().filter(|entry| entry.restarted()).count() as u64,
            lost_records: run.map_or(0, |run| run.lost_records),
            guarantees: run.map(|run| run.guarantees.clone()).unwrap_or_default(),
            digest: match Judge::of(flight) {
                Judge::Truth => digest(&flight.truth),
                Judge::Aircraft => commands_digest(&flight.commands),
            },
            notes: {
                let notes = run.map(|run| &run.notes).into_iter().flatten().chain(&flight.notes).cloned();
                notes.chain(mission::height_notes(&self.passages)).collect()
            },
        }
    }

    fn unverified(&self) -> Vec<usize> {
        let places = self.passages.iter().enumerate().filter(|(_, passage)| !passage.verified);
        places.map(|(place, _)| place).collect()
    }

    fn verdict(&self, flight: &Flight) -> Verdict {
        let inputs = &flight.inputs;
        let judge = Judge::of(flight);
        let reached = |passage: &Passage| judge == Judge::Aircraft || passage.verified;
        let confirmed = mission::in_order(&self.passages, |place| inputs.expected(place), reached).len();
        let laps = match inputs.sequence.len() {
            // A lap ends with the return to the first way-point.
            0 => confirmed.saturating_sub(1).checked_div(inputs.waypoints.len()).unwrap_or(0) as u32,
            all if confirmed >= all => inputs.laps,
            _ => 0,
        };
        let failure = reported_failure(flight.run.as_ref())
            .or_else(|| crash(&flight.truth))
            .or_else(|| self.left_height(flight))
            .or_else(|| self.lap_failure(flight, confirmed, laps));
        Verdict { laps, failure }
    }

    /// An aircraft that is lost says so by itself; one that was in nobody's place for a while does not.
    fn left_height(&self, flight: &Flight) -> Option<String> {
        let (first_s, most_m) = score::left_height(flight, &self.passages)?;
        Some(format!("the aircraft left its height by {most_m:.0} m from {first_s:.1} s on"))
    }

    fn lap_failure(&self, flight: &Flight, confirmed: usize, laps: u32) -> Option<String> {
        let asked = flight.inputs.laps;
        if laps >= asked {
            return None;
        }
        let counted = self.passages.len();
        let wanted = match flight.inputs.sequence.len() {
            0 => waypoints_to_reach(asked, flight.inputs.waypoints.len()).unwrap_or(0),
            all => all as u32,
        };
        let until = unlogged(flight).map_or_else(String::new, |(logged_s, flown_s)| {
            format!(
                "it can not be judged, the messages end at {logged_s:.1} s of {flown_s:.1} s; until then "
            )
        });
        let words = match Judge::of(flight) {
            Judge::Truth => format!(
                "the truth confirms {confirmed} of {wanted} way-points in order (the aircraft counted {counted})"
            ),
            Judge::Aircraft => format!("the aircraft counted {confirmed} of {wanted} way-points in order"),
        };
        Some(format!("{until}{words}; {laps} of {asked} laps were flown"))
    }
}

/// Longer than a restart of the Controller and the recorder's pauses, ns.
const UNLOGGED_NS: u64 = 2_000_000_000;

/// Where the log of messages ends before the flight does: both ends, s. A recorder may end of memory that somebody has damaged.
fn unlogged(flight: &Flight) -> Option<(f64, f64)> {
    let flown_ns = flight.truth.last()?.time_ns;
    let last = [
        flight.commands.last().map(|(time_ns, _)| *time_ns),
        flight.states.last().map(|(time_ns, _)| *time_ns),
        flight.fixes.last().map(|(time_ns, _)| *time_ns),
    ];
    let logged_ns = last.into_iter().flatten().max().unwrap_or(0);
    (flown_ns > logged_ns + UNLOGGED_NS).then(|| (seconds(logged_ns), seconds(flown_ns)))
}

struct Verdict {
    laps: u32,
    failure: Option<String>,
}

fn reported_failure(run: Option<&Run>) -> Option<String> {
    let mission = &run?.mission;
    let unnamed =
        || (!mission.completed).then(|| "the run ended before its mission was completed".to_owned());
    mission.failure.clone().or_else(unnamed)
}

fn crash(truth: &[TruthRecord]) -> Option<String> {
    let lost = truth.iter().find(|record| record.crashed != 0)?;
    Some(format!("the aircraft was lost at {:.1} s", seconds(lost.time_ns)))
}

fn ignored(health: &[HealthEntry]) -> BTreeMap<String, u64> {
    let mut counts = BTreeMap::new();
    for entry in health.iter().filter(|entry| !entry.acted_on()) {
        *counts.entry(entry.error.clone()).or_default() += 1;
    }
    counts
}

impl Summary {
    /// What [`Summary::digest`] is made of.
    pub(crate) fn digest_of(&self) -> &'static str {
        match self.judged_by {
            Judge::Truth => "actuator words",
            Judge::Aircraft => "commands of the Controller",
        }
    }
}

/// BLAKE3 over the bytes of the messages, without their times.
fn commands_digest(commands: &[(u64, ActuatorCommand)]) -> Option<String> {
    let mut hasher = blake3::Hasher::new();
    commands.iter().for_each(|(_, command)| {
        hasher.update(command.as_bytes());
    });
    (!commands.is_empty()).then(|| hasher.finalize().to_hex().to_string())
}

/// BLAKE3 over the five pulses and the autopilot word of each record, 16 bits each, little endian.
fn digest(truth: &[TruthRecord]) -> Option<String> {
    let mut hasher = blake3::Hasher::new();
    for record in truth {
        for word in record.timers_us.iter().chain([&record.autopilot]) {
            hasher.update(&word.to_le_bytes());
        }
    }
    (!truth.is_empty()).then(|| hasher.finalize().to_hex().to_string())
}

fn conditions(flight: &Flight, believed: &Believed) -> Conditions {
    let asked = flight.conditions.as_ref();
    let mut found = Conditions {
        airframe: asked.map(|asked| asked.airframe.clone()).unwrap_or_default(),
        turbulence: asked.map(|asked| asked.turbulence.clone()).unwrap_or_default(),
        faults: asked.map(|asked| asked.faults.clone()).unwrap_or_default(),
        variation: asked.map(|asked| asked.variation.clone()).unwrap_or_default(),
        wind_asked_mps: asked.map_or(0.0, |asked| asked.wind_mps),
        crashed: flight.truth.iter().any(|record| record.crashed != 0),
        touchdown: Touchdown::of(&flight.truth, believed),
        ..Conditions::default()
    };
    let airborne: Vec<_> = flight.truth.iter().filter(|record| record.on_ground == 0).collect();
    if airborne.is_empty() {
        return found;
    }
    let mean =
        |axis: usize| airborne.iter().map(|at| at.wind_ned_mps[axis]).sum::<f64>() / airborne.len() as f64;
    let mut gusts = score::Rms::default();
    airborne
        .iter()
        .for_each(|at| gusts.add(at.gust_ned_mps.iter().map(|part| part * part).sum::<f64>().sqrt()));
    let least = |value: fn(&TruthRecord) -> f64| airborne.iter().map(|at| value(at)).min_by(f64::total_cmp);
    found.wind_mean_mps = Some(mean(0).hypot(mean(1)));
    found.gust_rms_mps = gusts.value();
    found.air_as_asked = asked.map(|asked| air::is_as_asked(asked, &airborne));
    found.bank_max_deg = least(|at| -at.euler_rad[0].abs()).map(|bank| -bank.to_degrees());
    found.airspeed_min_mps = least(|at| at.airspeed_mps);
    found.airspeed_max_mps = least(|at| -at.airspeed_mps).map(|speed| -speed);
    found.height_max_m = least(|at| at.position_ned_m[2]).map(|down| -down);
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_that_ends_before_the_flight_is_told_from_one_that_lasts() {
        let truth = vec![TruthRecord { time_ns: 100_000_000_000, ..Default::default() }];
        let mut flight = Flight { truth, ..Default::default() };
        assert_eq!(unlogged(&flight), Some((0.0, 100.0)));
        flight.commands = vec![(31_300_000_000, Default::default())];
        assert_eq!(unlogged(&flight), Some((31.3, 100.0)));
        flight.commands = vec![(99_900_000_000, Default::default())];
        assert_eq!(unlogged(&flight), None);
    }

    #[test]
    fn digest_changes_with_one_word_and_with_nothing_else() {
        let record = TruthRecord { timers_us: [1500; 5], ..Default::default() };
        let flown = [record; 3];
        let mut other = flown;
        other[1].position_ned_m[0] = 1.0;
        assert_eq!(digest(&flown), digest(&other));
        other[1].timers_us[4] += 1;
        assert_ne!(digest(&flown), digest(&other));
        assert_eq!(digest(&[]), None);
        assert_eq!(digest(&flown).map(|hex| hex.len()), Some(64));
    }

    #[test]
    fn summary_survives_json() {
        let flight = Flight::default();
        let summary = Analysis::of(&flight).summary(&flight);
        let text = serde_json::to_string(&summary).unwrap();
        assert!(text.contains("\"straight_cross_track_true_rms_m\":null"));
        assert_eq!(serde_json::from_str::<Summary>(&text).unwrap(), summary);
    }
}
