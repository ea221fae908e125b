//! Two flights on one page: their tracks over one another, the main charts with a curve of each, their figures side by side, the faults
//! of both.

use std::fmt::Write as _;

use crate::compare::{Comparison, Side};
use crate::figures;
use crate::flight::{Flight, seconds};
use crate::health::HealthEntry;
use crate::html::{self, begun, ended};
use crate::plot::escape;
use crate::reasons::MOST_LISTED;
use crate::summary::{Analysis, Summary};
use crate::text::{NONE, number};

/// A figure: what it is called, its unit, where it stands.
type Figure = (&'static str, &'static str, fn(&Summary) -> Option<f64>);

/// The figures that are compared.
const FIGURES: [Figure; 25] = [
    ("cross-track, RMS", "m", |of| of.scores.cross_track_rms_m),
    ("cross-track on straight legs, RMS", "m", |of| of.scores.straight_cross_track_rms_m),
    ("cross-track, greatest", "m", |of| of.scores.cross_track_max_m),
    ("cross-track by the truth, RMS", "m", |of| of.scores.cross_track_true_rms_m),
    ("altitude, RMS", "m", |of| of.scores.altitude_rms_m),
    ("altitude by the truth, RMS", "m", |of| of.scores.altitude_true_rms_m),
    ("airspeed, RMS", "m/s", |of| of.scores.airspeed_rms_mps),
    ("estimate of roll, RMS", "°", |of| of.estimator.roll_rms_deg),
    ("estimate of pitch, RMS", "°", |of| of.estimator.pitch_rms_deg),
    ("estimate of yaw, RMS", "°", |of| of.estimator.yaw_rms_deg),
    ("estimate of velocity, RMS", "m/s", |of| of.estimator.velocity_rms_mps),
    ("estimate of position, RMS", "m", |of| of.estimator.position_rms_m),
    ("wind met", "m/s", |of| of.conditions.wind_mean_mps),
    ("gusts met, RMS", "m/s", |of| of.conditions.gust_rms_mps),
    ("steepest bank", "°", |of| of.conditions.bank_max_deg),
    ("slowest airspeed", "m/s", |of| of.conditions.airspeed_min_mps),
    ("module time", "s", |of| Some(of.module_time_s)),
    ("laps", "", |of| Some(f64::from(of.laps))),
    ("windows granted", "", |of| Some(of.windows as f64)),
    ("windows late", "", |of| Some(of.late_windows as f64)),
    ("windows not closed", "", |of| Some(of.window_overruns as f64)),
    ("windows skipped", "", |of| Some(of.skipped_windows as f64)),
    ("restarts", "", |of| Some(of.restarts as f64)),
    ("flight chain, median", "ms", |of| Some(of.chain_execution_us?.p50 / 1e3)),
    ("flight chain, greatest", "ms", |of| Some(of.chain_execution_us?.max / 1e3)),
];

/// The page of two flights, of which the messages have been compared.
pub fn page(flights: [&Flight; 2], comparison: &Comparison) -> String {
    let analyses = flights.map(Analysis::of);
    let both = [(flights[0], &analyses[0]), (flights[1], &analyses[1])];
    let summaries = both.map(|(flight, analysis)| analysis.summary(flight));
    let mut out = begun(&format!("{} and {}", flights[0].name, flights[1].name));
    head(&mut out, &summaries, comparison);
    out.push_str(r#"<section class="overview"><div class="left">"#);
    let _ = write!(out, "<figure>{}</figure></div>", figures::tracks(both).svg(560.0, 520.0));
    table(&mut out, &summaries);
    out.push_str(r#"</section><h2>Over module time</h2><section class="charts">"#);
    let first_s = comparison.first.as_ref().map(|first| seconds(first.time_ns));
    for chart in figures::beside(both, first_s) {
        let _ = write!(out, "<figure>{}</figure>", chart.svg(480.0, 210.0));
    }
    out.push_str("</section>");
    faults(&mut out, flights);
    ended(out)
}

fn head(out: &mut String, summaries: &[Summary; 2], comparison: &Comparison) {
    out.push_str("<header><h1>Two flights</h1></header>");
    for (side, summary) in [Side::A, Side::B].iter().zip(summaries) {
        let (class, word) = html::verdict(summary);
        let (name, about) = (escape(&summary.flight), escape(&html::circumstances(summary)));
        let _ = write!(out, r#"<p><b>{side:?}: {name}</b> <span class="badge {class}">{word}</span></p>"#);
        let _ = write!(out, r#"<p class="sub">{about}</p>"#);
        if let Some(why) = &summary.failure {
            let _ = write!(out, r#"<p class="failure">{}</p>"#, escape(why));
        }
    }
    let _ = write!(out, "<p>{}</p>", escape(&words(comparison)));
}

/// What came out of the comparison of the messages.
fn words(comparison: &Comparison) -> String {
    let Comparison { equal, first, ports, incomparable, .. } = comparison;
    let differ = ports.iter().filter(|port| port.first.is_some()).count();
    let words = match first {
        Some(first) => format!(
            "The first of their messages that differs is on {} at {:.6} s; {differ} of {} ports differ.",
            first.port,
            seconds(first.time_ns),
            ports.len()
        ),
        None if *equal => "All their messages are equal.".to_owned(),
        None => "What could be compared of their messages is equal.".to_owned(),
    };
    let missing: String = incomparable.iter().map(|what| format!(" Not compared: {what}.")).collect();
    words + &missing
}

fn table(out: &mut String, [a, b]: &[Summary; 2]) {
    out.push_str(r#"<div class="tables"><table><thead><tr><th>figure</th><th>A</th><th>B</th><th>B − A</th></tr></thead><tbody>"#);
    for (label, unit, value) in FIGURES {
        let (a, b) = (value(a), value(b));
        let (in_a, in_b) = (cell(a, unit), cell(b, unit));
        let difference = a.zip(b).map_or_else(|| NONE.to_owned(), |(a, b)| signed(b - a, unit));
        let _ = write!(out, "<tr><td>{label}</td><td>{in_a}</td><td>{in_b}</td><td>{difference}</td></tr>");
    }
    out.push_str("</tbody></table></div>");
}

/// A count has no unit and no decimals.
fn cell(value: Option<f64>, unit: &str) -> String {
    match value {
        Some(count) if unit.is_empty() => format!("{count:.0}"),
        _ => number(value, unit),
    }
}

fn signed(difference: f64, unit: &str) -> String {
    let size = cell(Some(difference.abs()), unit);
    let is_nothing = !size.contains(|letter: char| ('1'..='9').contains(&letter));
    let sign = if is_nothing {
        ""
    } else if difference < 0.0 {
        "−"
    } else {
        "+"
    };
    format!("{sign}{size}")
}

/// What something was done about, in the order of time.
fn faults(out: &mut String, flights: [&Flight; 2]) {
    let of = |side: Side| {
        let acted = flights[side as usize].health.iter().filter(|entry| entry.acted_on());
        acted.map(move |entry| (side, entry))
    };
    let mut entries: Vec<(Side, &HealthEntry)> = of(Side::A).chain(of(Side::B)).collect();
    entries.sort_by_key(|(_, entry)| entry.time_ns);
    if entries.is_empty() {
        out.push_str(r#"<h2 id="faults">Faults</h2><p class="sub">There were none in either flight.</p>"#);
        return;
    }
    out.push_str(
        r#"<h2 id="faults">Faults</h2><table class="wide"><thead><tr><th>flight</th><th>time, s</th>"#,
    );
    out.push_str("<th>partition</th><th>error</th><th>action</th><th>back after, ms</th><th>reason</th></tr></thead><tbody>");
    for (side, entry) in entries.iter().take(MOST_LISTED) {
        let (cells, detail) = (html::cells(entry), escape(&entry.detail));
        let _ = write!(out, "<tr><td>{side:?}</td>{cells}<td>{detail}</td></tr>");
    }
    out.push_str("</tbody></table>");
    html::more(out, entries.len(), MOST_LISTED);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn difference_has_a_sign_only_where_it_is_seen() {
        assert_eq!([0.004, -0.25, 3.0].map(|by| signed(by, "m")), ["0.00 m", "−0.25 m", "+3.00 m"]);
        assert_eq!([0.0, -2.0].map(|by| signed(by, "")), ["0", "−2"]);
    }
}
