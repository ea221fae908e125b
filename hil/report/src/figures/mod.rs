//! The figures of a flight: which values each chart shows, in the groups of the page.

use crate::flight::{Flight, seconds};
use crate::health::HealthEntry;
use crate::plot::{Chart, Mark, Place, Series, Style};
use crate::reasons::fault_anchor;
use crate::summary::Analysis;
use bateleur_messages::{ActuatorCommand, State};
use bateleur_simulator::truth::TruthRecord;

mod control;
mod estimates;
mod sensors;
mod times;

/// Colours of the page, by what they stand for.
const TRUTH: u8 = 0;
const ESTIMATE: u8 = 1;
const GPS: u8 = 2;
const WANTED: u8 = 3;
const SHIFTED: u8 = 4;
/// Where messages of one port are farther apart than this, s, its line is interrupted: its partition was not there.
const GAP_S: f64 = 0.5;
pub(crate) const TIME: &str = "module time, s";

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
        y_label: "north, m".into(),
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

/// Colours of two flights.
const SIDES: [(&str, u8); 2] = [("A", TRUTH), ("B", ESTIMATE)];

/// The tracks of two flights over one another, and the paths that were planned.
pub fn tracks(flights: [(&Flight, &Analysis); 2]) -> Chart {
    let [mut a, b] = flights.map(|(flight, analysis)| track(flight, analysis));
    let planned = |chart: &Chart, name| named(chart, "planned").map(|found| Series { name, ..found.clone() });
    let way_points = flights.map(|(flight, _)| &flight.inputs.waypoints);
    let mut series: Vec<Series> = planned(&a, "planned").into_iter().collect();
    if way_points[0] != way_points[1] {
        series.extend(planned(&b, "planned, B").map(|found| Series { colour: SHIFTED, ..found }));
        a.places.extend(b.places.iter().cloned());
    }
    series.extend(curves([&a, &b], &["truth", "estimate"]).1);
    Chart { title: "Tracks over ground".into(), series, ..a }
}

/// The main charts of two flights with a curve of each, the faults of both, and the time of the first message that differs, s.
pub fn beside(flights: [(&Flight, &Analysis); 2], first_s: Option<f64>) -> Vec<Chart> {
    let [a, b] = flights.map(|(flight, analysis)| main(flight, analysis));
    let of = |place: usize| {
        let mark = move |mark: Mark| Mark {
            label: format!("{} {}", SIDES[place].0, mark.label),
            anchor: Some("faults".into()),
            ..mark
        };
        marks(flights[place].0).into_iter().map(mark)
    };
    let first = first_s.map(|x| Mark { x, label: "first difference".into(), anchor: None });
    let mut marks: Vec<Mark> = first.into_iter().chain(of(0)).chain(of(1)).collect();
    marks.sort_by(|a, b| a.x.total_cmp(&b.x));
    a.into_iter().zip(b).map(|(a, b)| Chart { marks: marks.clone(), ..together(a, b) }).collect()
}

/// Errors of the path, airspeed, attitude, actuators.
fn main(flight: &Flight, analysis: &Analysis) -> Vec<Chart> {
    let paths = control::errors(flight, analysis).into_iter();
    let held = paths.chain([control::airspeed(flight)]).chain(estimates::angles(flight));
    held.chain(control::actuators(flight)).collect()
}

/// One chart of two, with the curve of each that says most.
fn together(a: Chart, b: Chart) -> Chart {
    let (name, series) = curves([&a, &b], &["shifted truth", "truth", "acting", "estimate", "commanded"]);
    let y_label = format!("{}, {name}", a.y_label).into();
    Chart { y_label, series, ..a }
}

/// The first of these series that either chart has, and both its curves.
fn curves(charts: [&Chart; 2], names: &[&'static str]) -> (&'static str, Vec<Series>) {
    let is_there = |name: &&&'static str| charts.iter().any(|chart| named(chart, name).is_some());
    let name = names.iter().find(is_there).copied().unwrap_or_default();
    let curve = |(chart, (side, colour)): (&Chart, (&'static str, u8))| {
        named(chart, name).map(|found| Series { name: side, colour, ..found.clone() })
    };
    (name, charts.into_iter().zip(SIDES).filter_map(curve).collect())
}

/// Charts that belong together.
pub struct Group {
    /// Above them.
    pub heading: &'static str,
    /// Its place in the page, for links.
    pub anchor: &'static str,
    /// What a reader has to know of them; may be empty.
    pub note: &'static str,
    /// The charts.
    pub charts: Vec<Chart>,
}

/// The figures that stand below the track.
pub fn overview(flight: &Flight, analysis: &Analysis) -> Vec<Chart> {
    let marks = marks(flight);
    let charts = control::overview(flight, analysis).into_iter();
    charts.map(|chart| Chart { marks: marks.clone(), ..chart }).collect()
}

/// The figures over time, in the order of the page.
pub fn over_time(flight: &Flight, analysis: &Analysis) -> Vec<Group> {
    let mut groups = vec![
        Group {
            heading: "Controller",
            anchor: "controller",
            note: "What guidance and the loops asked for, and what came of it.",
            charts: control::references(flight),
        },
        Group {
            heading: "Actuators",
            anchor: "actuators",
            note: "As commanded while the autopilot is engaged, and as they stood after the servos.",
            charts: control::actuators(flight),
        },
        Group {
            heading: "Estimator against the truth",
            anchor: "estimator",
            note: "The shifted truth is moved by the errors that no filter can see; see the foot of the page.",
            charts: estimates::charts(flight, analysis),
        },
        Group {
            heading: "Sensors",
            anchor: "sensors",
            note: "As the GPS and IMU partitions published them.",
            charts: sensors::charts(flight),
        },
        Group { heading: "Times", anchor: "times", note: times::note(flight), charts: times::charts(flight) },
    ];
    let marks = marks(flight);
    let over_time =
        groups.iter_mut().flat_map(|group| &mut group.charts).filter(|chart| chart.x_label == TIME);
    over_time.for_each(|chart| chart.marks.clone_from(&marks));
    groups
}

/// The series of that name, if it has points.
fn named<'c>(chart: &'c Chart, name: &str) -> Option<&'c Series> {
    chart.series.iter().find(|series| series.name == name && !series.points.is_empty())
}

fn chart(title: &str, y_label: &'static str, series: Vec<Series>) -> Chart {
    Chart { title: title.to_owned(), x_label: TIME, y_label: y_label.into(), series, ..Chart::default() }
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

/// An angle over time, °; where it goes round from 180° to −180° its line is interrupted.
fn wrapped(points: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    let mut out: Vec<(f64, f64)> = Vec::with_capacity(points.len());
    for point in points {
        if out.last().is_some_and(|last| (point.1 - last.1).abs() > 180.0) {
            out.push((point.0, f64::NAN));
        }
        out.push(point);
    }
    out
}

/// Messages of one port over time.
fn told<T>(messages: &[(u64, T)], value: impl Fn(&T) -> f64) -> Vec<(f64, f64)> {
    interrupted(messages.iter().map(|(time, message)| (seconds(*time), value(message))))
}

fn marks(flight: &Flight) -> Vec<Mark> {
    let acted = flight.health.iter().filter(|entry| entry.acted_on()).enumerate();
    let mark = |(place, entry): (usize, &HealthEntry)| Mark {
        x: seconds(entry.time_ns),
        label: entry.of_whom().to_owned(),
        anchor: fault_anchor(place),
    };
    acted.map(mark).collect()
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
    fn angle_that_goes_round_interrupts_its_line() {
        let points = wrapped(vec![(0.0, 179.0), (0.1, -179.0), (0.2, -178.0)]);
        assert_eq!(points.len(), 4);
        assert!(points[1].1.is_nan());
    }

    #[test]
    fn charts_of_an_empty_flight_say_so() {
        let flight = Flight::default();
        let analysis = Analysis::of(&flight);
        let groups = over_time(&flight, &analysis);
        let mut charts = groups.iter().flat_map(|group| &group.charts);
        assert!(charts.all(|chart| chart.svg(400.0, 200.0).contains("no data")));
        // The planned path is there even without a flight.
        assert!(track(&flight, &analysis).svg(400.0, 400.0).contains("WP3"));
    }
}
