//! How long the flight laws took and how evenly they were started, frame by frame.

use super::{ESTIMATE, TRUTH, chart, series};
use crate::flight::Flight;
use crate::plot::{Chart, Style};
use crate::run::Clock;

/// Axis of a figure that is not over time.
const LATENESS: &str = "window opened after its planned start, µs";

/// What these times mean under the clock of the flight.
pub(super) fn note(flight: &Flight) -> &'static str {
    match clock(flight) {
        Clock::Wall => "The flight chain is gps, imu, estimator, controller, servo, once a minor frame.",
        Clock::Virtual => {
            "The flight chain is gps, imu, estimator, controller, servo, once a minor frame: the schedule's distance and what \
             the last of them computed. How late windows start means nothing on the virtual clock."
        }
    }
}

/// Execution time and interval of the flight chain over the flight, and how late windows started.
pub(super) fn charts(flight: &Flight) -> Vec<Chart> {
    let timing = &flight.timing;
    let took =
        vec![series("first opened → servo closed", TRUTH, Style::Line, timing.chain_over_time.points())];
    let mut charts =
        vec![Chart { least_range: 1.0, ..chart("Execution time of the flight chain", "ms", took) }];
    if clock(flight) == Clock::Wall {
        let apart = vec![series(
            "from one start to the next",
            ESTIMATE,
            Style::Line,
            timing.interval_over_time.points(),
        )];
        charts.push(Chart { least_range: 1.0, ..chart("Interval of the flight chain", "ms", apart) });
        let share = vec![series("all windows", TRUTH, Style::Steps, timing.lateness.shares())];
        charts.push(Chart {
            x_label: LATENESS,
            least_range: 5.0,
            ..chart("Latency of windows", "% of them", share)
        });
    }
    charts
}

fn clock(flight: &Flight) -> Clock {
    flight.run.as_ref().map(|run| run.clock).unwrap_or_default()
}
