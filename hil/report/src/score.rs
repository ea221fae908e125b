//! How well the path, the height and the airspeed were held.
//!
//! Definitions. The *scored stretch* begins with the first passage of WP0 and ends with the return to WP0 after the
//! last lap, or with the log. The *capture* is the first record of the stretch whose height is within
//! [`CAPTURE_M`] of the way-point's; from there on height and airspeed are scored. Every record of the truth counts
//! once; nothing is left out around corners. A record counts as straight when a leg is the nearest piece of the path.

use crate::believed::Believed;
use crate::flight::{Flight, Inputs, seconds};
use crate::mission::{self, Passage};
use crate::planned::Planned;
use bateleur_flight::attitude::wrap_angle;
use bateleur_flight::guidance::Waypoint;
use bateleur_messages::State;
use bateleur_messages::state::STATUS_COARSE;
use bateleur_simulator::truth::TruthRecord;
use nalgebra::Vector2;
use serde::{Deserialize, Serialize};

/// Height counts as captured within this, m: the tightest that moderate turbulence still passes at once.
pub const CAPTURE_M: f64 = 3.0;
/// Further off its height than this, m, an aircraft does not fly its mission any more.
pub const LEFT_M: f64 = 100.0;
/// Estimate and truth are compared where they are nearer in time than this, ns: one record's period.
const NEAR_NS: u64 = 20_000_000;

/// Root of the mean square.
#[derive(Debug, Clone, Copy, Default)]
pub struct Rms {
    sum: f64,
    count: u64,
    greatest: f64,
}

impl Rms {
    /// Counts one error.
    pub fn add(&mut self, error: f64) {
        if error.is_finite() {
            self.sum += error * error;
            self.count += 1;
            self.greatest = self.greatest.max(error.abs());
        }
    }

    /// The result; `None` before the first error.
    pub fn value(&self) -> Option<f64> {
        (self.count > 0).then(|| (self.sum / self.count as f64).sqrt())
    }

    /// The greatest error without its sign.
    pub fn greatest(&self) -> Option<f64> {
        (self.count > 0).then_some(self.greatest)
    }
}

/// The tracking scores. Those without "true" in their name are against the truth shifted by the slow errors of
/// receiver and barometer, which no filter can see.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Scores {
    /// Distance to the path, m.
    pub cross_track_rms_m: Option<f64>,
    /// The same by the unshifted truth, m.
    pub cross_track_true_rms_m: Option<f64>,
    /// Distance to the path where a leg is nearest, m.
    pub straight_cross_track_rms_m: Option<f64>,
    /// The same by the unshifted truth, m.
    pub straight_cross_track_true_rms_m: Option<f64>,
    /// Greatest distance to the path, m.
    pub cross_track_max_m: Option<f64>,
    /// Height against the way-points', m.
    pub altitude_rms_m: Option<f64>,
    /// The same by the unshifted truth, m.
    pub altitude_true_rms_m: Option<f64>,
    /// Airspeed against the way-points', m/s.
    pub airspeed_rms_mps: Option<f64>,
    /// The same once more: no slow error enters the airspeed, so that the truth is not shifted for it.
    pub airspeed_true_rms_mps: Option<f64>,
    /// Module time at which the scored stretch began, s.
    pub scored_from_s: Option<f64>,
    /// Module time at which it ended, s.
    pub scored_to_s: Option<f64>,
    /// Module time of the capture, s.
    pub captured_s: Option<f64>,
}

/// How well the Estimator saw the aircraft over the scored stretch.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct EstimatorScores {
    /// Roll, °.
    pub roll_rms_deg: Option<f64>,
    /// Pitch, °.
    pub pitch_rms_deg: Option<f64>,
    /// Yaw, °.
    pub yaw_rms_deg: Option<f64>,
    /// Velocity over ground, length of the error's three parts, m/s.
    pub velocity_rms_mps: Option<f64>,
    /// Position against the shifted truth, length of the error's three parts, m.
    pub position_rms_m: Option<f64>,
    /// Position against the truth, m.
    pub position_true_rms_m: Option<f64>,
    /// Share of the scored stretch in which there was an estimate at all, 0 to 1. The figures above know no other time.
    #[serde(default)]
    pub covered: Option<f64>,
}

/// The part of a flight that is scored, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stretch {
    /// First instant.
    pub from_ns: u64,
    /// Last instant.
    pub to_ns: u64,
}

impl Stretch {
    /// The stretch of a flight: its laps. `None` if WP0 was never passed, or it was no circuit.
    pub fn of(passages: &[Passage], inputs: &Inputs) -> Option<Self> {
        if !inputs.sequence.is_empty() {
            return None;
        }
        let run = mission::in_order(passages, |place| inputs.expected(place), |_| true);
        let first = passages.get(run.start).map(|_| run.start)?;
        let last = passages.get(first + inputs.waypoints.len() * inputs.laps as usize);
        Some(Self {
            from_ns: passages[first].time_ns,
            to_ns: last.map_or(u64::MAX, |passage| passage.time_ns),
        })
    }

    /// The truth within.
    pub(crate) fn of_truth<'a>(&self, truth: &'a [TruthRecord]) -> &'a [TruthRecord] {
        let from = truth.partition_point(|record| record.time_ns < self.from_ns);
        let to = truth.partition_point(|record| record.time_ns <= self.to_ns);
        truth.get(from..to).unwrap_or_default()
    }
}

/// Scores a flight's tracking.
pub fn scores(flight: &Flight, passages: &[Passage], planned: &Planned, believed: &Believed) -> Scores {
    let Inputs { waypoints, guidance, .. } = &flight.inputs;
    let Some(stretch) = Stretch::of(passages, &flight.inputs) else { return Scores::default() };
    let truth = stretch.of_truth(&flight.truth);
    let Some(last) = truth.last() else { return Scores::default() };
    let mut scores = path_scores(truth, planned, believed);
    scores.scored_from_s = Some(seconds(stretch.from_ns));
    scores.scored_to_s = Some(seconds(last.time_ns));
    let flown_mps = (guidance.slowest_mps, guidance.fastest_mps);
    hold_scores(&mut scores, truth, &Targets { passages, waypoints }, flown_mps, believed);
    scores
}

fn path_scores(truth: &[TruthRecord], planned: &Planned, believed: &Believed) -> Scores {
    let [mut all, mut straight, mut all_true, mut straight_true] = [Rms::default(); 4];
    for record in truth {
        let [north, east, _] = record.position_ned_m;
        let pairs = [
            (believed.horizontal(record), &mut all, &mut straight),
            (Vector2::new(north, east), &mut all_true, &mut straight_true),
        ];
        for (point, all, straight) in pairs {
            let Some((right_m, on_leg)) = planned.cross_track(record.time_ns, &point) else { continue };
            all.add(right_m);
            if on_leg {
                straight.add(right_m);
            }
        }
    }
    Scores {
        cross_track_rms_m: all.value(),
        cross_track_true_rms_m: all_true.value(),
        straight_cross_track_rms_m: straight.value(),
        straight_cross_track_true_rms_m: straight_true.value(),
        cross_track_max_m: all.greatest(),
        ..Scores::default()
    }
}

/// What is to be held at each time.
pub(crate) struct Targets<'a> {
    pub(crate) passages: &'a [Passage],
    pub(crate) waypoints: &'a [Waypoint],
}

impl Targets<'_> {
    /// The way-point flown to.
    pub(crate) fn at(&self, time_ns: u64) -> Option<&Waypoint> {
        let passed = self.passages.partition_point(|passage| passage.time_ns <= time_ns);
        let last = passed.checked_sub(1).and_then(|last| self.passages.get(last));
        let next = last.map_or(0, |passage| passage.index + 1);
        self.waypoints.get(next % self.waypoints.len().max(1))
    }
}

/// An airspeed that is asked for and can not be flown is flown at the nearest that can, and is held against that.
fn hold_scores(
    scores: &mut Scores,
    truth: &[TruthRecord],
    targets: &Targets<'_>,
    (slowest_mps, fastest_mps): (f64, f64),
    believed: &Believed,
) {
    let [mut height, mut height_true, mut airspeed] = [Rms::default(); 3];
    for record in truth {
        let Some(target) = targets.at(record.time_ns) else { continue };
        let error = believed.height_m(record) - target.altitude_m;
        if scores.captured_s.is_none() && error.abs() <= CAPTURE_M {
            scores.captured_s = Some(seconds(record.time_ns));
        }
        if scores.captured_s.is_some() {
            height.add(error);
            height_true.add(-record.position_ned_m[2] - target.altitude_m);
            airspeed.add(record.airspeed_mps - target.airspeed_mps.min(fastest_mps).max(slowest_mps));
        }
    }
    scores.altitude_rms_m = height.value();
    scores.altitude_true_rms_m = height_true.value();
    scores.airspeed_rms_mps = airspeed.value();
    scores.airspeed_true_rms_mps = airspeed.value();
}

/// The first time after the capture at which the aircraft is further than [`LEFT_M`] off the heights of the way-points that it
/// flies between, s, and how far it gets, m; by the truth as it is.
pub(crate) fn left_height(flight: &Flight, passages: &[Passage]) -> Option<(f64, f64)> {
    let waypoints = &flight.inputs.waypoints;
    let stretch = Stretch::of(passages, &flight.inputs)?;
    let targets = Targets { passages, waypoints };
    let (mut captured, mut first_s, mut most_m) = (false, None, 0.0_f64);
    let mut before: Option<(f64, f64)> = None;
    for record in stretch.of_truth(&flight.truth) {
        let Some(target_m) = targets.at(record.time_ns).map(|target| target.altitude_m) else { continue };
        // From one way-point's height to the next one's.
        let (from_m, to_m) = before
            .filter(|(_, to_m)| *to_m == target_m)
            .unwrap_or_else(|| (before.map_or(target_m, |(_, to_m)| to_m), target_m));
        before = Some((from_m, to_m));
        let height_m = -record.position_ned_m[2];
        let off_m = (from_m.min(to_m) - height_m).max(height_m - from_m.max(to_m));
        captured |= off_m <= CAPTURE_M;
        if captured && off_m > LEFT_M {
            first_s.get_or_insert(seconds(record.time_ns));
            most_m = most_m.max(off_m);
        }
    }
    first_s.map(|first_s| (first_s, most_m))
}

/// Scores a flight's estimates.
pub fn estimator_scores(flight: &Flight, passages: &[Passage], believed: &Believed) -> EstimatorScores {
    let Some(stretch) = Stretch::of(passages, &flight.inputs) else {
        return EstimatorScores::default();
    };
    let truth = stretch.of_truth(&flight.truth);
    let mut errors = EstimateErrors::default();
    let mut states =
        flight.states.iter().map(|(_, state)| state).filter(|state| state.status >= STATUS_COARSE).peekable();
    for record in truth {
        while states.next_if(|state| state.valid_ns + NEAR_NS / 2 < record.time_ns).is_some() {}
        if let Some(state) = states.peek().filter(|state| state.valid_ns.abs_diff(record.time_ns) < NEAR_NS) {
            errors.add(state, record, believed);
        }
    }
    let share = errors.position.count as f64 / truth.len() as f64;
    EstimatorScores { covered: (!truth.is_empty()).then_some(share), ..errors.scores() }
}

#[derive(Default)]
struct EstimateErrors {
    euler: [Rms; 3],
    velocity: Rms,
    position: Rms,
    position_true: Rms,
}

impl EstimateErrors {
    fn add(&mut self, state: &State, record: &TruthRecord, believed: &Believed) {
        for axis in 0..3 {
            let error = wrap_angle(state.euler_rad[axis] - record.euler_rad[axis]);
            self.euler[axis].add(error.to_degrees());
        }
        // The state may hold for another instant than the record: the truth is moved to it.
        let dt_s = seconds(state.valid_ns) - seconds(record.time_ns);
        let moved = |axis: usize, place: f64| place + record.velocity_ned_mps[axis] * dt_s;
        let shifted = believed.horizontal(record);
        let seen = [shifted.x, shifted.y, -believed.height_m(record)];
        let length = |error: [f64; 3]| error.iter().map(|part| part * part).sum::<f64>().sqrt();
        let position =
            |place: [f64; 3]| length([0, 1, 2].map(|i| state.position_ned_m[i] - moved(i, place[i])));
        self.position.add(position(seen));
        self.position_true.add(position(record.position_ned_m));
        self.velocity.add(length([0, 1, 2].map(|i| state.velocity_ned_mps[i] - record.velocity_ned_mps[i])));
    }

    fn scores(&self) -> EstimatorScores {
        let [roll, pitch, yaw] = self.euler.map(|error| error.value());
        EstimatorScores {
            roll_rms_deg: roll,
            pitch_rms_deg: pitch,
            yaw_rms_deg: yaw,
            velocity_rms_mps: self.velocity.value(),
            position_rms_m: self.position.value(),
            position_true_rms_m: self.position_true.value(),
            covered: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_flight::guidance::seed_waypoints;

    fn passage(index: usize, time_s: u64) -> Passage {
        Passage {
            index,
            time_ns: time_s * 1_000_000_000,
            distance_m: Some(0.0),
            above_m: Some(0.0),
            verified: true,
        }
    }

    fn record(time_s: f64, north: f64, east: f64, height: f64) -> TruthRecord {
        TruthRecord {
            time_ns: (time_s * 1e9) as u64,
            position_ned_m: [north, east, -height],
            velocity_ned_mps: [0.0, 22.0, 0.0],
            airspeed_mps: 22.5,
            ..Default::default()
        }
    }

    fn flight(truth: Vec<TruthRecord>) -> Flight {
        Flight { truth, ..Default::default() }
    }

    fn of(flight: &Flight, passages: &[Passage]) -> Scores {
        let believed = Believed::of(&flight.truth, true);
        scores(flight, passages, &Planned::fixed(&seed_waypoints(), 70.0, 70.0), &believed)
    }

    #[test]
    fn leg_flown_three_metres_off_scores_three_metres() {
        // From WP0 towards WP1, 3 m left of the leg.
        let truth =
            (0..100).map(|i| record(10.0 + f64::from(i) * 0.1, 503.0, 100.0 + f64::from(i), 160.0)).collect();
        let found = of(&flight(truth), &[passage(0, 10)]);
        assert!((found.cross_track_rms_m.unwrap() - 3.0).abs() < 1e-9);
        assert!((found.straight_cross_track_true_rms_m.unwrap() - 3.0).abs() < 1e-9);
        assert!((found.airspeed_rms_mps.unwrap() - 0.5).abs() < 1e-9);
        assert_eq!((found.altitude_rms_m, found.captured_s), (Some(0.0), Some(10.0)));
    }

    #[test]
    fn airspeed_that_the_aircraft_can_not_fly_is_scored_as_the_one_that_it_flies() {
        let truth: Vec<_> = (0..9).map(|i| record(10.0 + f64::from(i), 500.0, 100.0, 160.0)).collect();
        let mut slow = flight(truth); // at 22.5 m/s
        slow.inputs.guidance.fastest_mps = 21.5; // of 22.0 that the mission asks for
        let found = of(&slow, &[passage(0, 10)]);
        assert!((found.airspeed_rms_mps.unwrap() - 1.0).abs() < 1e-9, "{found:?}");
        let mut fast = slow;
        (fast.inputs.guidance.slowest_mps, fast.inputs.guidance.fastest_mps) = (24.5, 30.0);
        let found = of(&fast, &[passage(0, 10)]);
        assert!((found.airspeed_rms_mps.unwrap() - 2.0).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn circle_flown_around_the_fillets_centre_scores_its_distance_and_no_straight_leg() {
        // The fillet at WP0 has its centre at (430, 70); this arc has 72 m.
        let arc = |i: u32| {
            let bearing = -1.5 + f64::from(i) * 0.014;
            record(
                10.0 + f64::from(i) * 0.02,
                430.0 + 72.0 * bearing.cos(),
                70.0 + 72.0 * bearing.sin(),
                162.0,
            )
        };
        let found = of(&flight((0..100).map(arc).collect()), &[passage(0, 10)]);
        assert!((found.cross_track_rms_m.unwrap() - 2.0).abs() < 1e-6, "{found:?}");
        assert_eq!(found.straight_cross_track_rms_m, None);
        assert!((found.altitude_rms_m.unwrap() - 2.0).abs() < 1e-9);
    }

    #[test]
    fn slow_errors_move_the_main_score_and_not_the_true_one() {
        let shifted = |i: u32| TruthRecord {
            gps_slow_error_ned_m: [-4.0, 0.0, 0.0],
            barometer_bias_m: if i == 0 { 0.0 } else { -1.0 },
            ..record(10.0 + f64::from(i) * 0.1, 504.0, 100.0 + f64::from(i), 161.0)
        };
        let found = of(&flight((0..100).map(shifted).collect()), &[passage(0, 10)]);
        assert!(found.cross_track_rms_m.unwrap() < 1e-9);
        assert!((found.cross_track_true_rms_m.unwrap() - 4.0).abs() < 1e-9);
        assert!((found.altitude_rms_m.unwrap() - 0.1).abs() < 1e-6);
        assert!((found.altitude_true_rms_m.unwrap() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn only_the_stretch_from_first_wp0_to_the_return_counts() {
        let passages: Vec<_> = (0..9).map(|i| passage(i % 4, 10 + i as u64)).collect();
        assert_eq!(Stretch::of(&passages, &Inputs::default()).unwrap().to_ns, 18_000_000_000);
        let off = vec![
            record(9.0, 900.0, 900.0, 0.0),
            record(12.0, 500.0, 250.0, 160.0),
            record(19.0, 0.0, 900.0, 0.0),
        ];
        let found = of(&flight(off), &passages);
        assert!(found.cross_track_max_m.unwrap() < 1e-9);
        assert_eq!(of(&flight(vec![record(9.0, 0.0, 0.0, 0.0)]), &[]), Scores::default());
    }

    #[test]
    fn height_is_scored_from_its_capture_on() {
        let heights = [150.0, 156.0, 158.0, 160.0, 165.0];
        let truth =
            heights.iter().enumerate().map(|(i, h)| record(10.0 + i as f64, 500.0, 250.0, *h)).collect();
        let found = of(&flight(truth), &[passage(0, 10)]);
        assert_eq!(found.captured_s, Some(12.0));
        assert!((found.altitude_rms_m.unwrap() - (29.0_f64 / 3.0).sqrt()).abs() < 1e-9);
    }

    #[test]
    fn estimate_is_compared_with_the_truth_of_its_own_instant() {
        let truth: Vec<_> =
            (0..50).map(|i| record(10.0 + f64::from(i) * 0.02, 500.0, f64::from(i) * 0.44, 160.0)).collect();
        let state = |record: &TruthRecord| {
            let late = record.time_ns + 5_000_000;
            let [north, east, down] = record.position_ned_m;
            let state = State {
                valid_ns: late,
                position_ned_m: [north + 1.0, east + 22.0 * 0.005, down],
                velocity_ned_mps: record.velocity_ned_mps,
                euler_rad: [0.01, 0.0, std::f64::consts::TAU],
                status: 3,
                ..Default::default()
            };
            (late, state)
        };
        let flight = Flight { states: truth.iter().map(state).collect(), ..flight(truth) };
        let found = estimator_scores(&flight, &[passage(0, 10)], &Believed::default());
        assert!((found.position_rms_m.unwrap() - 1.0).abs() < 1e-6, "{found:?}");
        assert!((found.roll_rms_deg.unwrap() - 0.01_f64.to_degrees()).abs() < 1e-9);
        assert!(found.yaw_rms_deg.unwrap() < 1e-9 && found.velocity_rms_mps.unwrap() < 1e-9);
    }
}
