//! The figures of a flight: which values each chart shows.

use crate::flight::{Flight, seconds};
use crate::planned::Planned;
use crate::plot::{Chart, Mark, Place, Series, Style};
use crate::score::{Stretch, Targets};
use crate::summary::Analysis;
use bateleur_messages::{ActuatorCommand, State};
use bateleur_simulator::truth::TruthRecord;
use nalgebra::Vector2;

/// Colours of the page, by what they stand for.
const TRUTH: u8 = 0;
const ESTIMATE: u8 = 1;
const GPS: u8 = 2;
const WANTED: u8 = 3;
const SHIFTED: u8 = 4;
/// Where messages of one port are farther apart than this, s, its line is interrupted: its partition was not there.
const GAP_S: f64 = 0.5;
const TIME: &str = "module time, s";

/// The seed's track over ground: planned, true, estimated, measured.
pub fn track(flight: &Flight, analysis: &Analysis) -> Chart {
    let east_north = |[north, east, _]: [f64; 3]| (east, north);
    let last_passage = analysis.passages.last().map_or(0, |passage| passage.time_ns);
    let outline = analysis.planned.outline(last_passage);
    let planned = outline.iter().map(|point| (point.y, point.x)).collect();
    let truth = flight.truth.iter().map(|record| east_north(record.position_ned_m)).collect();
    let estimate = flight.states.iter().filter(|(_, state)| state.status > 1);
    let estimate = estimate.map(|(_, state)| east_north(state.position_ned_m)).collect();
    let fixes = flight.fixes.iter().map(|(_, fix)| east_north(fix.position_ned_m)).collect();
    let places = flight.inputs.waypoints.iter().enumerate();
    Chart {
        title: "Track over ground".into(),
        x_label: "east of the runway, m",
        y_label: "north, m",
        series: vec![
            series("satellite fixes", GPS, Style::Dots, fixes),
            series("planned", WANTED, Style::Dashed, planned),
            series("estimate", ESTIMATE, Style::Line, estimate),
            series("truth", TRUTH, Style::Line, truth),
        ],
        places: places
            .map(|(index, at)| Place { at: (at.east_m, at.north_m), label: format!("WP{index}") })
            .collect(),
        equal: true,
        ..Chart::default()
    }
}

/// The figures over time, in the order of the page.
pub fn over_time(flight: &Flight, analysis: &Analysis) -> Vec<Chart> {
    let mut charts = vec![
        altitude(flight, analysis),
        altitude_error(flight, analysis),
        airspeed(flight),
        cross_track(flight, analysis),
        next_waypoint(flight),
        bank(flight),
        wind(flight),
        throttle(flight),
        surface(flight, "Elevator", |at| at.surfaces_rad[1], |command| command.elevator_rad),
        surface(flight, "Rudder", |at| at.surfaces_rad[2], |command| command.rudder_rad),
        surface(flight, "Aileron", |at| at.surfaces_rad[0], |command| command.aileron_rad),
    ];
    let marks = marks(flight);
    charts.iter_mut().for_each(|chart| chart.marks.clone_from(&marks));
    charts
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

fn altitude_error(flight: &Flight, analysis: &Analysis) -> Chart {
    let scored = scored(flight, analysis);
    let waypoints = &flight.inputs.waypoints;
    let targets = Targets { passages: &analysis.passages, waypoints };
    let error = |height_m: &dyn Fn(&TruthRecord) -> f64| {
        let error =
            |at: &TruthRecord| Some((seconds(at.time_ns), height_m(at) - targets.at(at.time_ns)?.altitude_m));
        scored.iter().filter_map(error).collect()
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
    let stretch = Stretch::of(&analysis.passages, flight.inputs.waypoints.len(), flight.inputs.laps);
    stretch.map_or(&[], |stretch| stretch.of_truth(&flight.truth))
}

fn airspeed(flight: &Flight) -> Chart {
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

fn wind(flight: &Flight) -> Chart {
    let speed = |north: f64, east: f64| north.hypot(east);
    let met = truth(flight, |at| speed(at.wind_ned_mps[0], at.wind_ned_mps[1]));
    let seen = estimated(flight, |state| speed(state.wind_ne_mps[0], state.wind_ne_mps[1]));
    let both =
        vec![series("truth", TRUTH, Style::Line, met), series("estimate", ESTIMATE, Style::Line, seen)];
    Chart { least_range: 2.0, ..chart("Horizontal wind, gusts included", "m/s", both) }
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

fn chart(title: &str, y_label: &'static str, series: Vec<Series>) -> Chart {
    Chart { title: title.to_owned(), x_label: TIME, y_label, series, ..Chart::default() }
}

fn series(name: &'static str, colour: u8, style: Style, points: Vec<(f64, f64)>) -> Series {
    Series { name, colour, style, points }
}

fn truth(flight: &Flight, value: impl Fn(&TruthRecord) -> f64) -> Vec<(f64, f64)> {
    flight.truth.iter().map(|at| (seconds(at.time_ns), value(at))).collect()
}

fn estimated(flight: &Flight, value: impl Fn(&State) -> f64) -> Vec<(f64, f64)> {
    let usable = flight.states.iter().filter(|(_, state)| state.status > 1);
    interrupted(usable.map(|(time, state)| (seconds(*time), value(state))))
}

fn engaged(flight: &Flight, value: impl Fn(&ActuatorCommand) -> f64) -> Vec<(f64, f64)> {
    let engaged = flight.commands.iter().filter(|(_, command)| command.engaged != 0);
    interrupted(engaged.map(|(time, command)| (seconds(*time), value(command))))
}

/// Points with an interruption wherever time leaps.
fn interrupted(points: impl Iterator<Item = (f64, f64)>) -> Vec<(f64, f64)> {
    let mut with_gaps: Vec<(f64, f64)> = Vec::new();
    for point in points {
        if with_gaps.last().is_some_and(|last| point.0 - last.0 > GAP_S) {
            with_gaps.push((point.0, f64::NAN));
        }
        with_gaps.push(point);
    }
    with_gaps
}

fn marks(flight: &Flight) -> Vec<Mark> {
    let acted = flight.health.iter().filter(|entry| entry.acted_on());
    let label = |partition: &Option<String>| partition.clone().unwrap_or_else(|| "module".to_owned());
    acted.map(|entry| Mark { x: seconds(entry.time_ns), label: label(&entry.partition) }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_interrupts_a_line() {
        let points = interrupted([(0.0, 1.0), (0.02, 1.0), (3.0, 2.0)].into_iter());
        assert_eq!(points.len(), 4);
        assert!(points[2].0 == 3.0 && points[2].1.is_nan());
    }

    #[test]
    fn charts_of_an_empty_flight_say_so() {
        let flight = Flight::default();
        let analysis = Analysis::of(&flight);
        let charts = over_time(&flight, &analysis);
        assert!(charts.iter().all(|chart| chart.svg(400.0, 200.0).contains("no data")));
        // The planned path is there even without a flight.
        assert!(track(&flight, &analysis).svg(400.0, 400.0).contains("WP3"));
    }
}
