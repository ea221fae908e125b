//! The Estimator's output beside the truth, and what lies between them.

use super::{ESTIMATE, SHIFTED, TRUTH, WANTED, chart, estimated, series, truth, wrapped};
use crate::flight::{Flight, seconds};
use crate::plot::{Chart, Series, Style};
use crate::summary::Analysis;
use bateleur_messages::State;
use bateleur_simulator::truth::TruthRecord;
use std::f64::consts::{PI, TAU};

const AXES: [&str; 3] = ["north", "east", "down"];
const ANGLES: [&str; 3] = ["roll", "pitch", "yaw"];
/// Colours of three components.
const THREE: [u8; 3] = [TRUTH, ESTIMATE, WANTED];
/// An estimate is compared with the truth's record of the same instant, or of one at most this much earlier, ns: the
/// truth is written every 20 ms.
const SAME_INSTANT_NS: u64 = 25_000_000;

/// Positions, velocities, angles; their errors; wind.
pub(super) fn charts(flight: &Flight, analysis: &Analysis) -> Vec<Chart> {
    let believed = &analysis.believed;
    let shifted = |axis: usize| truth(flight, |at| believed.horizontal(at)[axis]);
    let places = vec![
        beside(
            flight,
            "North position",
            "m",
            |at| at.position_ned_m[0],
            |state| state.position_ned_m[0],
            shifted(0),
        ),
        beside(
            flight,
            "East position",
            "m",
            |at| at.position_ned_m[1],
            |state| state.position_ned_m[1],
            shifted(1),
        ),
        beside(
            flight,
            "North velocity",
            "m/s",
            |at| at.velocity_ned_mps[0],
            |state| state.velocity_ned_mps[0],
            Vec::new(),
        ),
        beside(
            flight,
            "East velocity",
            "m/s",
            |at| at.velocity_ned_mps[1],
            |state| state.velocity_ned_mps[1],
            Vec::new(),
        ),
    ];
    let errors = vec![
        wind(flight),
        errors(flight, "Attitude error, estimate minus truth", "°", 0.5, ANGLES, |state, at, axis| {
            turned(state.euler_rad[axis] - at.euler_rad[axis]).to_degrees()
        }),
        errors(flight, "Velocity error", "m/s", 0.2, AXES, |state, at, axis| {
            state.velocity_ned_mps[axis] - at.velocity_ned_mps[axis]
        }),
        errors(flight, "Position error, from the shifted truth", "m", 1.0, AXES, |state, at, axis| {
            let there = match axis {
                2 => -believed.height_m(at),
                _ => believed.horizontal(at)[axis],
            };
            state.position_ned_m[axis] - there
        }),
        standard_deviations(flight),
    ];
    [places, angles(flight), errors].concat()
}

/// Roll, pitch and yaw.
pub(super) fn angles(flight: &Flight) -> Vec<Chart> {
    ["Roll angle", "Pitch angle", "Yaw angle"]
        .iter()
        .enumerate()
        .map(|(axis, title)| angle(flight, title, axis))
        .collect()
}

fn beside(
    flight: &Flight,
    title: &str,
    unit: &'static str,
    real: impl Fn(&TruthRecord) -> f64,
    seen: impl Fn(&State) -> f64,
    shifted: Vec<(f64, f64)>,
) -> Chart {
    let lines = vec![
        series("shifted truth", SHIFTED, Style::Line, shifted),
        series("truth", TRUTH, Style::Line, truth(flight, real)),
        series("estimate", ESTIMATE, Style::Line, estimated(flight, seen)),
    ];
    Chart { least_range: 2.0, ..chart(title, unit, lines) }
}

fn angle(flight: &Flight, title: &str, axis: usize) -> Chart {
    let real = wrapped(truth(flight, |at| turned(at.euler_rad[axis]).to_degrees()));
    let seen = wrapped(estimated(flight, |state| turned(state.euler_rad[axis]).to_degrees()));
    let lines =
        vec![series("truth", TRUTH, Style::Line, real), series("estimate", ESTIMATE, Style::Line, seen)];
    Chart { least_range: 4.0, ..chart(title, "°", lines) }
}

/// An angle between −π and π, rad.
fn turned(angle_rad: f64) -> f64 {
    (angle_rad + PI).rem_euclid(TAU) - PI
}

fn wind(flight: &Flight) -> Chart {
    let speed = |north: f64, east: f64| north.hypot(east);
    let met = truth(flight, |at| speed(at.wind_ned_mps[0], at.wind_ned_mps[1]));
    let seen = estimated(flight, |state| speed(state.wind_ne_mps[0], state.wind_ne_mps[1]));
    let both =
        vec![series("truth", TRUTH, Style::Line, met), series("estimate", ESTIMATE, Style::Line, seen)];
    Chart { least_range: 2.0, ..chart("Horizontal wind, gusts included", "m/s", both) }
}

fn errors(
    flight: &Flight,
    title: &str,
    unit: &'static str,
    least_range: f64,
    names: [&'static str; 3],
    error: impl Fn(&State, &TruthRecord, usize) -> f64,
) -> Chart {
    let pairs = pairs(flight);
    let lines = (0..3).map(|axis| {
        let points = pairs.iter().map(|(time, state, at)| (seconds(*time), error(state, at, axis)));
        series(names[axis], THREE[axis], Style::Line, super::interrupted(points))
    });
    Chart { least_range, ..chart(title, unit, lines.collect()) }
}

/// Usable estimates, each with the truth of the instant that it is valid for.
fn pairs(flight: &Flight) -> Vec<(u64, &State, &TruthRecord)> {
    let mut pairs = Vec::with_capacity(flight.states.len());
    let mut next = 0;
    for (time, state) in flight.states.iter().filter(|(_, state)| state.status > 1) {
        while flight.truth.get(next + 1).is_some_and(|at| at.time_ns <= state.valid_ns) {
            next += 1;
        }
        // After the simulator's own restart its time begins anew.
        let near = |at: &&TruthRecord| {
            at.time_ns <= state.valid_ns && state.valid_ns - at.time_ns <= SAME_INSTANT_NS
        };
        pairs.extend(flight.truth.get(next).filter(near).map(|at| (*time, state, at)));
    }
    pairs
}

/// How sure the filter is of itself.
fn standard_deviations(flight: &Flight) -> Chart {
    let largest = |values: &[f64; 3]| values.iter().copied().fold(0.0, f64::max);
    let line = |name, colour, value: fn(&State) -> [f64; 3], scale: f64| -> Series {
        series(name, colour, Style::Line, estimated(flight, |state| scale * largest(&value(state))))
    };
    let lines = vec![
        line("position, m", TRUTH, |state| state.position_sigma_m, 1.0),
        line("velocity, m/s", ESTIMATE, |state| state.velocity_sigma_mps, 1.0),
        line("attitude, °", WANTED, |state| state.attitude_sigma_rad, 1f64.to_degrees()),
    ];
    chart("The filter's own standard deviations, greatest axis", "", lines)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn yaw_across_north_has_a_small_error() {
        assert!((turned(3.1 - -3.1) - (6.2 - TAU)).abs() < 1e-12);
        assert!(turned(TAU).abs() < 1e-12);
    }

    #[test]
    fn estimate_is_compared_with_the_truth_of_its_instant_or_not_at_all() {
        let truth = |ms: u64| TruthRecord { time_ns: ms * 1_000_000, ..TruthRecord::default() };
        let state =
            |ms: u64| (ms * 1_000_000 + 1, State { status: 3, valid_ns: ms * 1_000_000, ..State::default() });
        let flight = Flight {
            truth: vec![truth(20), truth(40), truth(100)],
            states: vec![state(10), state(40), state(50), state(80), state(100)],
            ..Flight::default()
        };
        let found: Vec<_> = pairs(&flight)
            .iter()
            .map(|(_, state, at)| (state.valid_ns / 1_000_000, at.time_ns / 1_000_000))
            .collect();
        assert_eq!(found, [(40, 40), (50, 40), (100, 100)]);
    }
}
