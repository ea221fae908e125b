//! Which way-points were reached, when, and whether the aircraft really was there.

use crate::believed::Believed;
use crate::planned::Planned;
use bateleur_flight::guidance::{REACHED_SHARE, Step, Waypoint};
use bateleur_messages::ActuatorCommand;
use bateleur_simulator::truth::TruthRecord;
use std::f64::consts::PI;
use std::ops::Range;

/// Around the instant at which the aircraft says that it reached a way-point, the truth is searched for the
/// closest approach this long before and after, ns: the fillet's nearest point lies within.
const SEARCH_NS: u64 = 2_000_000_000;
/// A passage is fair if it comes as near as the planned fillet does, plus this, m: wider than any tracking error that
/// still counts as flying the path; or plus [`REACHED_SHARE`] of the widest radius of the flight, within which the guidance counts a way-point as reached.
const FAIR_MARGIN_M: f64 = 25.0;
/// The same for a circle: its radius grows with the wind.
const CIRCLE_MARGIN_M: f64 = 80.0;
/// A passage that is further from the way-point's altitude, m, is told: several times what a level leg leaves.
const FAIR_HEIGHT_M: f64 = 25.0;

/// A way-point reached.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Passage {
    /// The way-point's index.
    pub index: usize,
    /// Module time at which the aircraft said so, ns.
    pub time_ns: u64,
    /// How near it came, m, by the truth shifted by the slow error; `None` without truth there.
    pub distance_m: Option<f64>,
    /// How far above the way-point's altitude it was there, m, by the truth; below: negative.
    pub above_m: Option<f64>,
    /// The truth agrees.
    pub verified: bool,
}

impl Passage {
    /// "WP0".
    pub fn name(&self) -> String {
        format!("WP{}", self.index)
    }
}

/// The way-points that the Controller counted, not yet checked.
pub fn passages(commands: &[(u64, ActuatorCommand)], waypoints: usize) -> Vec<Passage> {
    let counted = counted(commands, waypoints).into_iter();
    counted
        .map(|(time_ns, index)| Passage { index, time_ns, distance_m: None, above_m: None, verified: false })
        .collect()
}

/// Checks each passage against the truth.
pub fn verify(
    passages: &mut [Passage],
    waypoints: &[Waypoint],
    planned: &Planned,
    truth: &[TruthRecord],
    believed: &Believed,
) {
    let widest_m = planned.radii_m().into_iter().fold(0.0, f64::max);
    let margin_m = FAIR_MARGIN_M.max(REACHED_SHARE * widest_m);
    for passage in passages {
        let Some(waypoint) = waypoints.get(passage.index) else { continue };
        let fair_m = fair_distance_m(waypoints, passage.index, planned.radius_m(passage.time_ns), margin_m);
        (passage.distance_m, passage.above_m) = closest(truth, believed, waypoint, passage.time_ns).unzip();
        passage.verified = passage.distance_m.is_some_and(|distance| distance <= fair_m);
    }
}

/// Time and index of every way-point counted. The count may jump by several where messages are missing, and fall
/// where a cold restart began the mission anew; then it goes on from the new value.
fn counted(commands: &[(u64, ActuatorCommand)], count: usize) -> Vec<(u64, usize)> {
    let mut found = Vec::new();
    for pair in commands.windows(2) {
        let ((_, before), (time_ns, now)) = (&pair[0], &pair[1]);
        let steps = now.waypoints_reached.saturating_sub(before.waypoints_reached).min(count as u32);
        let index = |step: u32| (before.next_waypoint as usize + step as usize) % count.max(1);
        found.extend((0..steps).map(|step| (*time_ns, index(step))));
    }
    found
}

/// The least distance, and the height above the way-point there, m.
fn closest(
    truth: &[TruthRecord],
    believed: &Believed,
    waypoint: &Waypoint,
    time_ns: u64,
) -> Option<(f64, f64)> {
    let from = truth.partition_point(|record| record.time_ns < time_ns.saturating_sub(SEARCH_NS));
    let near = truth[from..].iter().take_while(|record| record.time_ns <= time_ns.saturating_add(SEARCH_NS));
    let distance = |record: &TruthRecord| (believed.horizontal(record) - waypoint.horizontal()).norm();
    let above = |record: &TruthRecord| -record.position_ned_m[2] - waypoint.altitude_m;
    near.map(|record| (distance(record), above(record))).min_by(|one, other| one.0.total_cmp(&other.0))
}

/// What a way-point's passage at another height than its own is told as: a fair passage is one over the ground. The first
/// one is flown in the climb.
pub fn height_notes(passages: &[Passage]) -> Vec<String> {
    let off = passages.iter().skip(1).filter_map(|passage| {
        let above_m = passage.above_m.filter(|above_m| above_m.abs() > FAIR_HEIGHT_M)?;
        let side = if above_m < 0.0 { "below" } else { "above" };
        let time_s = passage.time_ns as f64 / 1e9;
        Some(format!(
            "{} was passed {:.0} m {side} its altitude, at {time_s:.1} s",
            passage.name(),
            above_m.abs()
        ))
    });
    off.collect()
}

/// How near the path comes to a way-point at most: a fillet cuts the corner by R (1/cos(turn/2) − 1), and by half of the shorter
/// leg at most. The radius is what the laws choose for the airspeed: an aircraft of 50 m/s needs 330 m.
fn fair_distance_m(waypoints: &[Waypoint], index: usize, radius_m: f64, margin_m: f64) -> f64 {
    let count = waypoints.len();
    match waypoints[index].step {
        Step::Pass => {}
        // A circle is as near as its radius, which the aircraft may have chosen itself.
        Step::Turns(_, circle_m)
        | Step::Time(_, circle_m)
        | Step::Altitude(circle_m)
        | Step::Unlimited(circle_m) => {
            return circle_m.abs().max(radius_m) + CIRCLE_MARGIN_M;
        }
        _ => return f64::INFINITY,
    }
    let at = |i: usize| waypoints[i % count].horizontal();
    let (inbound, outbound) = (at(index) - at(index + count - 1), at(index + 1) - at(index));
    let turn = inbound.angle(&outbound);
    let cut = if turn < 0.9 * PI { 1.0 / (0.5 * turn).cos() - 1.0 } else { 0.0 };
    let room = 0.5 * inbound.norm().min(outbound.norm());
    (radius_m * cut).min(room) + margin_m
}

/// The longest stretch of way-points in the right order (`expected`, by their place in the flight) from the first one on, without one
/// missing; among equals the earliest. `fair` says which passages count at all. A Controller that lost its memory in flight begins its laps anew:
/// what it flew before then does not count towards them, and does not spoil them.
pub fn in_order(
    passages: &[Passage],
    expected: impl Fn(usize) -> Option<usize>,
    fair: impl Fn(&Passage) -> bool,
) -> Range<usize> {
    let run = |start: usize| {
        let right =
            |(place, passage): &(usize, &Passage)| fair(passage) && Some(passage.index) == expected(*place);
        start..start + passages[start..].iter().enumerate().take_while(right).count()
    };
    let starts = (0..passages.len()).rev().filter(|start| Some(passages[*start].index) == expected(0));
    starts.map(run).max_by_key(ExactSizeIterator::len).unwrap_or(0..0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_flight::guidance::seed_waypoints;

    /// Four way-points, round and round.
    fn round(place: usize) -> Option<usize> {
        Some(place % 4)
    }

    fn command(time_ns: u64, next: u32, reached: u32) -> (u64, ActuatorCommand) {
        (time_ns, ActuatorCommand { next_waypoint: next, waypoints_reached: reached, ..Default::default() })
    }

    #[test]
    fn count_that_jumps_or_falls_names_the_right_waypoints() {
        let commands = [
            command(0, 0, 0),
            command(1, 0, 0),
            command(2, 1, 1),
            command(3, 3, 3),
            command(4, 0, 0),
            command(5, 1, 1),
        ];
        assert_eq!(counted(&commands, 4), [(2, 0), (3, 1), (3, 2), (5, 0)]);
        assert_eq!(counted(&[], 4), []);
    }

    #[test]
    fn word_of_the_aircraft_alone_is_not_enough() {
        let commands = [command(0, 0, 0), command(1_000_000_000, 1, 1)];
        let truth = |north: f64| {
            let record = |i: u64| TruthRecord {
                time_ns: i * 20_000_000,
                position_ned_m: [north, 0.0, -160.0],
                ..TruthRecord::default()
            };
            (0..100).map(record).collect::<Vec<_>>()
        };
        let waypoints = seed_waypoints();
        let planned = Planned::fixed(&waypoints, 70.0, 70.0);
        let checked = |truth: &[TruthRecord]| {
            let mut found = passages(&commands, 4);
            verify(&mut found, &waypoints, &planned, truth, &Believed::default());
            found
        };
        let (near, far, blind) = (checked(&truth(480.0)), checked(&truth(300.0)), checked(&[]));
        assert_eq!((far.len(), far[0].verified, far[0].distance_m), (1, false, Some(200.0)));
        assert!(near[0].verified);
        let verified = |passages: &[Passage]| in_order(passages, round, |passage| passage.verified).len();
        assert_eq!((verified(&near), verified(&far)), (1, 0));
        assert_eq!((blind[0].verified, blind[0].distance_m), (false, None));
    }

    #[test]
    fn passage_far_below_its_altitude_is_told_but_for_the_first_in_the_climb() {
        let passage = |above_m| Passage {
            index: 1,
            time_ns: 39_100_000_000,
            distance_m: Some(3.0),
            above_m,
            verified: true,
        };
        let notes = height_notes(&[Some(-70.0), Some(-1975.4), Some(-24.0), Some(30.0), None].map(passage));
        let expected = [
            "WP1 was passed 1975 m below its altitude, at 39.1 s",
            "WP1 was passed 30 m above its altitude, at 39.1 s",
        ];
        assert_eq!(notes, expected);
    }

    #[test]
    fn laps_begun_anew_count_from_their_own_first_way_point() {
        let passage = |index| Passage { index, time_ns: 0, distance_m: None, above_m: None, verified: true };
        let passages: Vec<_> = [0, 1, 2, 0, 1, 2, 3, 0, 1].map(passage).into();
        assert_eq!(in_order(&passages, round, |_| true), 3..9);
        let listed = |place: usize| [1, 2, 0, 1].get(place).copied();
        assert_eq!(in_order(&passages, listed, |_| true), 1..5);
    }
}
