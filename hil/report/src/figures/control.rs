//! What was asked for and what came of it: guidance, the loops' references, the actuators.

use super::{ESTIMATE, GPS, SHIFTED, TRUTH, WANTED, chart, engaged, estimated, series, truth};
use crate::flight::{Flight, seconds};
use crate::planned::Planned;
use crate::plot::{Chart, Style};
use crate::score::{CAPTURE_M, Stretch, Targets};
use crate::summary::Analysis;
use bateleur_messages::ActuatorCommand;
use bateleur_simulator::truth::TruthRecord;
use nalgebra::Vector2;

/// For the acceleration that a bank gives in level flight, m/s².
const GRAVITY_MPS2: f64 = 9.80665;

/// How well the path was kept: what most readers look for first.
pub(super) fn overview(flight: &Flight, analysis: &Analysis) -> Vec<Chart> {
    [vec![altitude(flight, analysis)], errors(flight, analysis)].concat()
}

/// How far it was off the height and off the path.
pub(super) fn errors(flight: &Flight, analysis: &Analysis) -> Vec<Chart> {
    vec![altitude_error(flight, analysis), cross_track(flight, analysis)]
}

/// References of guidance and the loops beside what the aircraft did.
pub(super) fn references(flight: &Flight) -> Vec<Chart> {
    vec![airspeed(flight), bank(flight), horizontal_acceleration(flight), next_waypoint(flight)]
}

/// Commanded and acting positions.
pub(super) fn actuators(flight: &Flight) -> Vec<Chart> {
    vec![
        throttle(flight),
        surface(flight, "Elevator", |at| at.surfaces_rad[1], |command| command.elevator_rad),
        surface(flight, "Aileron", |at| at.surfaces_rad[0], |command| command.aileron_rad),
        surface(flight, "Rudder", |at| at.surfaces_rad[2], |command| command.rudder_rad),
    ]
}

fn altitude(flight: &Flight, analysis: &Analysis) -> Chart {
    let believed = &analysis.believed;
    let fixes = flight.fixes.iter().map(|(time, fix)| (seconds(*time), -fix.position_ned_m[2])).collect();
    Chart {
        least_range: 10.0,
        ..chart(
            "Altitude above the runway",
            "m",
            vec![
                series("fixes", GPS, Style::Dots, fixes),
                series(
                    "asked for",
                    WANTED,
                    Style::Dashed,
                    engaged(flight, |command| command.altitude_reference_m),
                ),
                series("shifted truth", SHIFTED, Style::Line, truth(flight, |at| believed.height_m(at))),
                series(
                    "estimate",
                    ESTIMATE,
                    Style::Line,
                    estimated(flight, |state| -state.position_ned_m[2]),
                ),
                series("truth", TRUTH, Style::Line, truth(flight, |at| -at.position_ned_m[2])),
            ],
        )
    }
}

/// From the first capture of the height on, as it is scored: the climb before it would hide the rest.
fn altitude_error(flight: &Flight, analysis: &Analysis) -> Chart {
    let waypoints = &flight.inputs.waypoints;
    let targets = Targets { passages: &analysis.passages, waypoints };
    let off_m = |at: &TruthRecord| Some(analysis.believed.height_m(at) - targets.at(at.time_ns)?.altitude_m);
    let climbs = |at: &&TruthRecord| off_m(at).is_none_or(|off_m| off_m.abs() > CAPTURE_M);
    let scored: Vec<_> = scored(flight, analysis).iter().skip_while(climbs).collect();
    let error = |height_m: &dyn Fn(&TruthRecord) -> f64| {
        let error =
            |at: &TruthRecord| Some((seconds(at.time_ns), height_m(at) - targets.at(at.time_ns)?.altitude_m));
        scored.iter().copied().filter_map(error).collect()
    };
    Chart {
        least_range: 2.0,
        ..chart(
            "Altitude error",
            "m",
            vec![
                series("truth", TRUTH, Style::Line, error(&|at| -at.position_ned_m[2])),
                series("shifted truth", SHIFTED, Style::Line, error(&|at| analysis.believed.height_m(at))),
            ],
        )
    }
}

/// The truth of the scored stretch.
fn scored<'a>(flight: &'a Flight, analysis: &Analysis) -> &'a [TruthRecord] {
    let stretch = Stretch::of(&analysis.passages, &flight.inputs);
    stretch.map_or(&[], |stretch| stretch.of_truth(&flight.truth))
}

pub(super) fn airspeed(flight: &Flight) -> Chart {
    Chart {
        least_range: 2.0,
        ..chart(
            "Airspeed",
            "m/s",
            vec![
                series(
                    "asked for",
                    WANTED,
                    Style::Dashed,
                    engaged(flight, |command| command.airspeed_reference_mps),
                ),
                series("truth", TRUTH, Style::Line, truth(flight, |at| at.airspeed_mps)),
            ],
        )
    }
}

fn cross_track(flight: &Flight, analysis: &Analysis) -> Chart {
    let Analysis { planned, believed, .. } = analysis;
    let scored = scored(flight, analysis);
    let along = |point: &dyn Fn(&TruthRecord) -> Vector2<f64>| {
        let offset =
            |at: &TruthRecord| Some((seconds(at.time_ns), right_m(planned, at.time_ns, &point(at))?));
        scored.iter().filter_map(offset).collect()
    };
    let unshifted = |at: &TruthRecord| Vector2::new(at.position_ned_m[0], at.position_ned_m[1]);
    Chart {
        least_range: 4.0,
        ..chart(
            "Cross-track error, right positive",
            "m",
            vec![
                series("truth", TRUTH, Style::Line, along(&unshifted)),
                series("shifted truth", SHIFTED, Style::Line, along(&|at| believed.horizontal(at))),
            ],
        )
    }
}

fn right_m(planned: &Planned, time_ns: u64, point: &Vector2<f64>) -> Option<f64> {
    planned.cross_track(time_ns, point).map(|(right_m, _)| right_m)
}

fn next_waypoint(flight: &Flight) -> Chart {
    let next = engaged(flight, |command| f64::from(command.next_waypoint));
    let step = vec![series("flown to", TRUTH, Style::Steps, next)];
    Chart { least_range: 1.0, ..chart("Next way-point", "index", step) }
}

fn bank(flight: &Flight) -> Chart {
    let asked = engaged(flight, |command| command.bank_reference_rad.to_degrees());
    chart(
        "Bank",
        "°, right positive",
        vec![
            series("asked for", WANTED, Style::Line, asked),
            series(
                "estimate",
                ESTIMATE,
                Style::Line,
                estimated(flight, |state| state.euler_rad[0].to_degrees()),
            ),
            series("truth", TRUTH, Style::Line, truth(flight, |at| at.euler_rad[0].to_degrees())),
        ],
    )
}

fn horizontal_acceleration(flight: &Flight) -> Chart {
    let asked = engaged(flight, |command| command.horizontal_acceleration_mps2);
    let asked = series("asked for", WANTED, Style::Line, asked);
    let turning = truth(flight, |at| GRAVITY_MPS2 * at.euler_rad[0].tan());
    let met = series("g tan of the true bank", TRUTH, Style::Line, turning);
    Chart { least_range: 2.0, ..chart("Horizontal acceleration", "m/s², right positive", vec![asked, met]) }
}

fn throttle(flight: &Flight) -> Chart {
    let acting = series("acting", TRUTH, Style::Line, truth(flight, |at| 100.0 * at.throttle));
    let asked = series("commanded", WANTED, Style::Line, engaged(flight, |command| 100.0 * command.throttle));
    Chart { least_range: 20.0, ..chart("Throttle", "%", vec![asked, acting]) }
}

fn surface(
    flight: &Flight,
    title: &str,
    acting: impl Fn(&TruthRecord) -> f64,
    asked: impl Fn(&ActuatorCommand) -> f64,
) -> Chart {
    let acting = truth(flight, |at| acting(at).to_degrees());
    let asked = engaged(flight, |command| asked(command).to_degrees());
    let both =
        vec![series("commanded", WANTED, Style::Line, asked), series("acting", TRUTH, Style::Line, acting)];
    Chart { least_range: 4.0, ..chart(title, "°", both) }
}
