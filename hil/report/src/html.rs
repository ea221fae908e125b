//! The report as one HTML page that needs nothing else: no script, no font, no picture from elsewhere. Its own script lets the
//! charts zoom and show values; without it the page is the same.

use crate::figures::{self, Group};
use crate::flight::{Flight, seconds};
use crate::health::HealthEntry;
use crate::plot::escape;
use crate::reasons::{self, Crash, MOST_ANSWERS, MOST_LISTED, fault_anchor, linked};
use crate::run::Clock;
use crate::summary::{Analysis, Judge, Summary};
use crate::text::{self, Table, number};
use crate::timeline::Timeline;
use std::fmt::Write as _;

/// Name of the file in a flight's folder.
pub const FILE: &str = "report.html";
/// Colours and figures, for other pages that show them too.
pub const STYLE: &str = include_str!("page.css");
/// What lets charts zoom and show their values, for other pages that have some too.
pub const SCRIPT: &str = include_str!("page.js");

/// The page of a flight.
pub fn page(flight: &Flight, analysis: &Analysis, summary: &Summary) -> String {
    let mut out = begun(&format!("Flight {}", summary.flight));
    head(&mut out, summary);
    cards(&mut out, flight, summary);
    let groups = figures::over_time(flight, analysis);
    links(&mut out, flight, summary, &groups);
    let (first, second) = groups.split_at(groups.len() / 2);
    std::thread::scope(|scope| {
        // Charts are most of the page: half of them beside the other.
        let second = scope.spawn(|| drawn(second));
        overview(&mut out, flight, analysis, summary);
        presence(&mut out, flight);
        out.push_str(&drawn(first));
        match second.join() {
            Ok(second) => out.push_str(&second),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    });
    windows(&mut out, flight, summary);
    late(&mut out, flight, summary);
    guarantees(&mut out, summary);
    faults(&mut out, flight, summary);
    crashes(&mut out, &flight.crashes);
    foot(&mut out, summary);
    ended(out)
}

/// The begin of a page, to its body.
pub(crate) fn begun(title: &str) -> String {
    let mut out = String::with_capacity(1 << 20);
    let title = escape(title);
    let _ = write!(
        out,
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\" />\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\" />\
         <title>{title}</title><style>{STYLE}</style></head><body>"
    );
    out
}

/// The page with its script and its end.
pub(crate) fn ended(mut out: String) -> String {
    let _ = write!(out, "<script>\n{SCRIPT}</script></body></html>\n");
    out
}

/// Class and words of the badge that says whether a flight was completed.
pub(crate) fn verdict(summary: &Summary) -> (&'static str, &'static str) {
    match (summary.completed, summary.judged_by) {
        (false, _) => ("bad", "not completed"),
        (true, Judge::Truth) => ("good", "completed"),
        (true, Judge::Aircraft) => ("good", "completed by its own count"),
    }
}

fn head(out: &mut String, summary: &Summary) {
    let (class, word) = verdict(summary);
    let name = escape(&summary.flight);
    let _ =
        write!(out, r#"<header><h1>Flight {name}</h1><span class="badge {class}">{word}</span></header>"#);
    if let Some(why) = &summary.failure {
        let _ = write!(out, r#"<p class="failure">{}</p>"#, escape(why));
    }
    let _ = write!(out, r#"<p class="sub">{}</p>"#, escape(&circumstances(summary)));
    let _ = write!(out, r#"<p class="sub">way-points: {}</p>"#, escape(&text::waypoints(summary)));
}

/// One line: aircraft, air, clock, seed, schedule.
pub(crate) fn circumstances(summary: &Summary) -> String {
    let air = &summary.conditions;
    let mut parts = Vec::new();
    if !air.airframe.is_empty() {
        parts.push(air.airframe.clone());
        parts.push(format!("wind {:.1} m/s, turbulence {}", air.wind_asked_mps, air.turbulence));
    }
    parts.push(format!("{:.1} s of module time", summary.module_time_s));
    if let (Some(clock), Some(wall)) = (summary.clock, summary.wall_time_s) {
        parts.push(format!("{} clock, {wall:.1} s taken", format!("{clock:?}").to_lowercase()));
    }
    parts.extend(summary.real_time_factor.map(|factor| format!("{factor:.1} × real time")));
    parts.extend(summary.seed.map(|seed| format!("seed {seed}")));
    parts.extend(summary.schedule.as_ref().filter(|name| !name.is_empty()).cloned());
    parts.join(" · ")
}

fn cards(out: &mut String, flight: &Flight, summary: &Summary) {
    let scores = &summary.scores;
    let chain = summary.chain_execution_us.map(|times| times.p50 / 1000.0);
    let truth = |value, unit| format!("{} by the unshifted truth", number(value, unit));
    let greatest = summary.chain_execution_us.map(|times| times.max / 1000.0);
    let why = (!flight.inputs.reasons.is_empty()).then_some("late");
    let late = format!("{} late, {} overruns", summary.late_windows, summary.window_overruns);
    let cards = [
        ("cross-track RMS", number(scores.cross_track_rms_m, "m"), truth(scores.cross_track_true_rms_m, "m")),
        (
            "on straight legs",
            number(scores.straight_cross_track_rms_m, "m"),
            truth(scores.straight_cross_track_true_rms_m, "m"),
        ),
        ("altitude RMS", number(scores.altitude_rms_m, "m"), truth(scores.altitude_true_rms_m, "m")),
        ("airspeed RMS", number(scores.airspeed_rms_mps, "m/s"), "gusts included".to_owned()),
        ("flight chain, median", number(chain, "ms"), format!("{} at most", number(greatest, "ms"))),
        ("windows granted", summary.windows.to_string(), late),
    ];
    out.push_str(r#"<section class="cards">"#);
    // Without the truth there is nothing to say of the errors.
    let known = cards.into_iter().filter(|(_, value, _)| value != text::NONE);
    for (label, value, detail) in known {
        let (value, detail) = (escape(&value), escape(&detail));
        let detail = linked(why.filter(|_| label == "windows granted"), &detail);
        let _ = write!(out, "<div><small>{label}</small><b>{value}</b><small>{detail}</small></div>");
    }
    out.push_str("</section>");
}

/// To the parts of a long page.
fn links(out: &mut String, flight: &Flight, summary: &Summary, groups: &[Group]) {
    let parts = [
        (flight.frame.is_empty(), "windows", "Windows"),
        (flight.inputs.reasons.is_empty(), "late", "Late windows"),
        (summary.guarantees.is_empty(), "means", "Means"),
        (flight.health.is_empty(), "faults", "Faults"),
    ];
    let there = parts.into_iter().filter(|(is_empty, ..)| !is_empty);
    let named = groups.iter().map(|group| (group.anchor, group.heading));
    let links = named.chain(there.map(|(_, anchor, heading)| (anchor, heading)));
    out.push_str("<nav>");
    links.for_each(|(anchor, heading)| {
        let _ = write!(out, r##"<a href="#{anchor}">{heading}</a> "##);
    });
    out.push_str("</nav>");
}

fn presence(out: &mut String, flight: &Flight) {
    let Some(picture) = flight.presence.svg(&flight.health, &flight.inputs.reasons, 980.0) else { return };
    let _ = write!(out, r#"<section class="timelines presence"><figure>{picture}</figure>"#);
    out.push_str(
        r#"<p class="sub">Red: no process was there to run. Ticks below a lane: windows that were not closed in time. Rings: errors that
something was done about; point at one to read it, follow it to its entry below.</p></section>"#,
    );
}

fn overview(out: &mut String, flight: &Flight, analysis: &Analysis, summary: &Summary) {
    out.push_str(r#"<section class="overview"><div class="left">"#);
    let _ = write!(out, "<figure>{}</figure>", figures::track(flight, analysis).svg(560.0, 520.0));
    for chart in figures::overview(flight, analysis) {
        let _ = write!(out, "<figure>{}</figure>", chart.svg(560.0, 200.0));
    }
    out.push_str(r#"</div><div class="tables">"#);
    text::tables(summary).iter().for_each(|each| table(out, each));
    if let Some(what) = text::unknown(summary) {
        let _ = write!(out, r#"<p class="sub">Not known: {}</p>"#, escape(what));
    }
    out.push_str("</div></section>");
}

fn drawn(groups: &[Group]) -> String {
    let mut out = String::with_capacity(1 << 19);
    groups.iter().for_each(|each| group(&mut out, each));
    out
}

fn group(out: &mut String, group: &Group) {
    let _ = write!(out, r#"<h2 id="{}">{}</h2>"#, group.anchor, group.heading);
    if !group.note.is_empty() {
        let _ = write!(out, r#"<p class="sub">{}</p>"#, escape(group.note));
    }
    out.push_str(r#"<section class="charts">"#);
    for chart in &group.charts {
        let _ = write!(out, "<figure>{}</figure>", chart.svg(480.0, 210.0));
    }
    out.push_str("</section>");
}

fn table(out: &mut String, table: &Table) {
    let _ = write!(out, "<table><thead><tr><th>{}</th>", escape(table.heading));
    let width = table.rows.iter().map(|(_, row)| row.len()).max().unwrap_or(0);
    for column in 0..width {
        let _ = write!(
            out,
            "<th>{}</th>",
            table.columns.get(column).map_or_else(String::new, |name| escape(name))
        );
    }
    out.push_str("</tr></thead><tbody>");
    for (label, row) in &table.rows {
        let class = if label.starts_with(' ') { r#" class="sub""# } else { "" };
        let _ = write!(out, "<tr><td{class}>{}</td>", escape(label.trim()));
        row.iter().for_each(|cell| {
            let _ = write!(out, "<td>{}</td>", escape(cell));
        });
        out.push_str("</tr>");
    }
    out.push_str("</tbody></table>");
    if let Some(note) = table.note {
        let _ = write!(out, r#"<p class="sub">{}</p>"#, escape(note));
    }
}

fn windows(out: &mut String, flight: &Flight, summary: &Summary) {
    let clock = summary.clock.unwrap_or_default();
    let pictures = [
        Timeline::major(&flight.frame, &flight.processes, clock),
        Timeline::minor(&flight.frame, &flight.processes, clock),
    ];
    if pictures.iter().all(Option::is_none) {
        return;
    }
    out.push_str(r#"<h2 id="windows">Windows</h2><section class="timelines">"#);
    for picture in pictures.iter().flatten() {
        let _ = write!(out, "<figure>{}</figure>", picture.svg(&flight.inputs.reasons, 980.0));
    }
    out.push_str(r#"<p class="sub">Outlines are planned windows, what is filled was used. "#);
    out.push_str(
        "Red was not closed in time (O in windows.csv), amber was granted late (L), \
         dashed was not granted (S: no partition was there, M: the dispatcher came too late).</p></section>",
    );
}

/// The means, and beside them what came of them.
fn guarantees(out: &mut String, summary: &Summary) {
    if summary.guarantees.is_empty() {
        return;
    }
    out.push_str(r#"<h2 id="means">Means of this machine</h2><table class="wide"><tbody>"#);
    for guarantee in &summary.guarantees {
        let (class, word) = if guarantee.held { ("good", "there") } else { ("bad", "missing") };
        let (promise, detail) = (escape(&guarantee.promise), escape(&guarantee.detail));
        let _ = write!(out, r#"<tr><td><span class="badge {class}">{word}</span></td>"#);
        let _ = write!(out, "<td>{promise}</td><td>{detail}</td></tr>");
    }
    out.push_str("</tbody></table>");
    let measured = text::measured(summary).join("; ");
    let _ = write!(out, r#"<p class="sub">measured in this run: {}</p>"#, escape(&measured));
}

/// Why windows were late, as far as that is known.
fn late(out: &mut String, flight: &Flight, summary: &Summary) {
    let answers = &flight.inputs.reasons;
    if answers.is_empty() {
        if summary.late_windows + summary.window_overruns > 0 && summary.clock == Some(Clock::Wall) {
            out.push_str(r#"<p class="sub">Why windows were late is not known: there is no why.jsonl.</p>"#);
        }
        return;
    }
    out.push_str(
        r#"<h2 id="late">Late windows</h2><p class="sub">As <code>bateleur why</code> answers.</p>
<div class="answers" tabindex="0"><table class="wide"><tbody>"#,
    );
    for (place, answer) in answers.iter().take(MOST_ANSWERS).enumerate() {
        let (anchor, sentence) = (reasons::anchor(place).unwrap_or_default(), escape(&answer.sentence));
        let _ = write!(out, r#"<tr id="{anchor}"><td>{:.3} s</td><td>{sentence}</td></tr>"#, answer.time_s);
    }
    out.push_str("</tbody></table></div>");
    more(out, answers.len(), MOST_ANSWERS);
}

/// How many are not listed.
pub(crate) fn more(out: &mut String, all: usize, listed: usize) {
    if all > listed {
        let _ = write!(out, r#"<p class="sub">and {} more</p>"#, all - listed);
    }
}

/// The health log: what something was done about, and what was written down only.
fn faults(out: &mut String, flight: &Flight, summary: &Summary) {
    if flight.health.is_empty() {
        return;
    }
    let (acted, ignored): (Vec<_>, Vec<_>) = flight.health.iter().partition(|entry| entry.acted_on());
    out.push_str(r#"<h2 id="faults">Faults</h2>"#);
    if !acted.is_empty() {
        entries(out, flight, &acted);
    }
    if !ignored.is_empty() {
        let counts: Vec<_> =
            summary.ignored_errors.iter().map(|(error, count)| format!("{error}: {count}")).collect();
        let counts = escape(&counts.join(", "));
        let _ = write!(out, r#"<details><summary class="sub">written down only: {counts}</summary>"#);
        entries(out, flight, &ignored);
        out.push_str("</details>");
    }
}

fn entries(out: &mut String, flight: &Flight, entries: &[&HealthEntry]) {
    out.push_str(
        r#"<table class="wide"><thead><tr><th>time, s</th><th>partition</th><th>error</th><th>action</th>"#,
    );
    out.push_str("<th>back after, ms</th><th>reason</th></tr></thead><tbody>");
    for (place, entry) in entries.iter().take(MOST_LISTED).enumerate() {
        let anchor = fault_anchor(place).filter(|_| entry.acted_on());
        let id = anchor.map_or_else(String::new, |anchor| format!(r#" id="{anchor}""#));
        let _ = write!(out, "<tr{id}>{}<td>{}</td></tr>", cells(entry), reason(flight, entry));
    }
    out.push_str("</tbody></table>");
    more(out, entries.len(), MOST_LISTED);
}

/// The cells of an entry of the health log that every page has.
pub(crate) fn cells(entry: &HealthEntry) -> String {
    let recovery = entry.recovery_ms().map_or_else(|| text::NONE.to_owned(), |ms| format!("{ms:.1}"));
    let time = format!("{:.2}", seconds(entry.time_ns));
    let cells = [&time, entry.of_whom(), &entry.error, &entry.action, &recovery];
    cells.map(|cell| format!("<td>{}</td>", escape(cell))).concat()
}

/// What the health log says of it, its crash report, and who had the processor.
fn reason(flight: &Flight, entry: &HealthEntry) -> String {
    let crash = flight.crashes.iter().find(|crash| crash.is_of(entry));
    let crash = crash.map(|crash| format!(r#"<a href="{}">crash report</a>"#, escape(&crash.file)));
    let why = reasons::before(&flight.inputs.reasons, entry.of_whom(), entry.time_ns);
    let why = why.map(|anchor| linked(Some(&anchor), "who had the processor"));
    let detail = Some(escape(&entry.detail)).filter(|detail| !detail.is_empty());
    [detail, crash, why].into_iter().flatten().collect::<Vec<_>>().join("; ")
}

fn crashes(out: &mut String, reports: &[Crash]) {
    if reports.is_empty() {
        return;
    }
    let links = reports.iter().map(|report| format!(r#"<a href="{0}">{0}</a>"#, escape(&report.file)));
    let links: Vec<String> = links.collect();
    let _ = write!(
        out,
        r#"<p class="sub">crash reports, which <code>bateleur crash</code> shows: {}</p>"#,
        links.join(", ")
    );
}

fn foot(out: &mut String, summary: &Summary) {
    if !summary.notes.is_empty() {
        out.push_str("<h2>Notes</h2><ul>");
        summary.notes.iter().for_each(|note| {
            let _ = write!(out, "<li>{}</li>", escape(note));
        });
        out.push_str("</ul>");
    }
    out.push_str(
        r#"<footer><p>Shifted truth: the true track moved by the satellite receiver's slow error, the true height
by the barometer's bias since it was zeroed; neither can be seen by a filter. Cross-track counts from the first
passage of WP0 to the return to it, altitude and airspeed from the first instant in that stretch within 3 m of the
way-point's altitude.</p>"#,
    );
    if let Some(digest) = &summary.digest {
        let _ = write!(out, "<p>digest of all {}: <code>{}</code></p>", summary.digest_of(), escape(digest));
    }
    out.push_str("</footer>");
}
