//! The summary for a terminal: plain text, at most [`WIDTH`] columns.

use crate::chains::ChainAge;
use crate::run::Clock;
use crate::summary::{Fault, Judge, Summary};
use crate::timing::Percentiles;

/// Columns that no line exceeds.
pub const WIDTH: usize = 100;
/// Column at which values begin.
const LABEL: usize = 26;
/// Columns of one value in a table.
const CELL: usize = 14;
/// A share of the time from which on it counts as all of it.
const WHOLE: f64 = 0.995;
/// Faults listed; the rest is counted.
const MOST_FAULTS: usize = 12;

/// A table of a summary: a heading, the columns' names, and rows of a label with its values.
pub(crate) struct Table {
    pub(crate) heading: &'static str,
    pub(crate) columns: Vec<&'static str>,
    pub(crate) rows: Vec<(String, Vec<String>)>,
    /// What a reader may stumble over.
    pub(crate) note: Option<&'static str>,
}

/// The whole summary.
pub fn table(summary: &Summary) -> String {
    let mut lines = Vec::new();
    wrap(&mut lines, "", &headline(summary));
    wrap(&mut lines, "way-points", &waypoints(summary));
    for table in tables(summary) {
        lines.push(String::new());
        let heading = format!("{:<LABEL$}{}", table.heading, cells(table.columns.iter().copied()));
        lines.push(heading.trim_end().to_owned());
        lines.extend(table.rows.iter().map(|(label, row)| line(label, row)));
        table.note.iter().for_each(|note| wrap(&mut lines, "", note));
    }
    list(&mut lines, "not known", unknown(summary).into_iter().map(str::to_owned));
    list(&mut lines, "faults", summary.faults.iter().take(MOST_FAULTS).map(fault));
    if summary.faults.len() > MOST_FAULTS {
        wrap(&mut lines, "", &format!("and {} more", summary.faults.len() - MOST_FAULTS));
    }
    list(&mut lines, "means of this machine", means(summary).into_iter());
    list(&mut lines, "measured in this run", measured(summary).into_iter());
    list(&mut lines, "notes", summary.notes.iter().cloned());
    lines.push(String::new());
    let of = match summary.judged_by {
        Judge::Truth => String::new(),
        Judge::Aircraft => format!(" (of the {})", summary.digest_of()),
    };
    wrap(&mut lines, "digest", &(summary.digest.as_deref().unwrap_or(NONE).to_owned() + &of));
    lines.join("\n") + "\n"
}

pub(crate) const NONE: &str = "–";

fn line(label: &str, row: &[String]) -> String {
    let text = format!("{label:<LABEL$}{}", cells(row.iter().map(String::as_str)));
    text.chars().take(WIDTH).collect()
}

fn cells<'a>(row: impl Iterator<Item = &'a str>) -> String {
    let text: String = row.map(|cell| format!("{cell:>CELL$}")).collect();
    text.trim_end().to_owned()
}

fn list(lines: &mut Vec<String>, heading: &str, items: impl Iterator<Item = String>) {
    for (place, item) in items.enumerate() {
        if place == 0 {
            lines.push(String::new());
        }
        wrap(lines, if place == 0 { heading } else { "" }, &item);
    }
}

/// Appends text beside its label, broken between words (or inside one that is too long for a line).
fn wrap(lines: &mut Vec<String>, label: &str, text: &str) {
    let indent = if label.is_empty() && lines.is_empty() { 0 } else { LABEL };
    let room = WIDTH - indent;
    let mut current = String::new();
    let mut label = label;
    let mut put = |text: &mut String| {
        lines.push(format!("{label:<indent$}{text}").trim_end().to_owned());
        label = "";
        text.clear();
    };
    for word in text.split_whitespace() {
        let letters: Vec<char> = word.chars().collect();
        for piece in letters.chunks(room) {
            let space = usize::from(!current.is_empty());
            if current.chars().count() + space + piece.len() > room {
                put(&mut current);
            } else if space > 0 {
                current.push(' ');
            }
            current.extend(piece);
        }
    }
    if !current.is_empty() {
        put(&mut current);
    }
}

fn laps(count: u32) -> String {
    format!("{count} lap{}", if count == 1 { "" } else { "s" })
}

/// One sentence: whether it was flown, and how fast.
pub(crate) fn headline(summary: &Summary) -> String {
    let verdict = match &summary.failure {
        None => match summary.judged_by {
            Judge::Truth => format!("completed, {}", laps(summary.laps)),
            Judge::Aircraft => {
                let laps = laps(summary.laps);
                format!("completed by the aircraft's own count, {laps}")
            }
        },
        Some(why) => format!("NOT completed: {why}"),
    };
    let clock = match summary.clock {
        Some(Clock::Wall) => ", wall clock",
        Some(Clock::Virtual) => ", virtual clock",
        None => "",
    };
    let speed =
        summary.real_time_factor.map_or_else(String::new, |factor| format!(", {factor:.1} × real time"));
    format!(
        "flight {}: {verdict}; {:.1} s of module time{clock}{speed}",
        summary.flight, summary.module_time_s
    )
}

/// The way-points in order, those without the truth's confirmation with a question mark.
pub(crate) fn waypoints(summary: &Summary) -> String {
    let named = |(place, name): (usize, &String)| {
        let doubted = summary.judged_by == Judge::Truth && summary.unverified_waypoints.contains(&place);
        let doubt = if doubted { "?" } else { "" };
        format!("{name}{doubt}")
    };
    let names: Vec<_> = summary.waypoints.iter().enumerate().map(named).collect();
    if names.is_empty() { "none reached".to_owned() } else { names.join(" ") }
}

/// Whether this machine has the means for each promise: a line for each, or one where all are there. What came of them is
/// [`measured`].
fn means(summary: &Summary) -> Vec<String> {
    let count = summary.guarantees.len();
    if count > 1 && summary.guarantees.iter().all(|promise| promise.held) {
        return vec![format!("all {count} are there (report.html lists them)")];
    }
    let sentence = |promise: &crate::run::Guarantee| {
        let mark = if promise.held { "there:" } else { "MISSING:" };
        let detail = if promise.detail.is_empty() { String::new() } else { format!(" ({})", promise.detail) };
        format!("{mark} {}{detail}", promise.promise)
    };
    summary.guarantees.iter().map(sentence).collect()
}

/// What became of the windows: beside the means, because they alone promise nothing.
pub(crate) fn measured(summary: &Summary) -> Vec<String> {
    let windows = summary.windows + summary.skipped_windows;
    if windows == 0 {
        return Vec::new();
    }
    let of = |count: u64, what: &str| match count {
        0 => format!("{what}: none of {windows} windows"),
        count => format!("{what}: {count} of {windows} windows"),
    };
    let mut lines = Vec::new();
    if summary.clock != Some(Clock::Virtual) {
        lines.push(of(summary.late_windows, "begun more than 200 µs late (L)"));
    }
    lines.push(of(summary.window_overruns, "not closed at the end (O)"));
    lines.push(of(summary.skipped_windows, "not granted (S, M)"));
    if summary.lost_records > 0 {
        lines.push(format!(
            "{} further windows are not in the log, which could not keep up",
            summary.lost_records
        ));
    }
    lines
}

fn fault(fault: &Fault) -> String {
    let recovery = fault.recovery_ms.map_or_else(String::new, |ms| format!(", back after {ms:.1} ms"));
    format!("{:.2} s {}: {} → {}{recovery}", fault.time_s, fault.partition, fault.error, fault.action)
}

/// The tables of numbers, for terminal and page alike.
pub(crate) fn tables(summary: &Summary) -> Vec<Table> {
    let mut tables = vec![
        tracking(summary),
        estimate(summary),
        air(summary),
        windows(summary),
        chains(summary),
        times(summary),
    ];
    if summary.judged_by == Judge::Aircraft {
        // What only the truth knows; the chart of the windows has no row of dashes.
        let known = |(_, values): &(String, Vec<String>)| values.iter().any(|value| !value.starts_with(NONE));
        tables.iter_mut().for_each(|table| table.rows.retain(known));
    }
    tables.retain(|table| !table.rows.is_empty());
    tables
}

/// What a flight on somebody else's simulator can not have, in a sentence.
pub(crate) fn unknown(summary: &Summary) -> Option<&'static str> {
    (summary.judged_by == Judge::Aircraft).then_some(
        "what only the truth tells, which this simulator does not give: errors of track and estimate, wind and gusts, \
         whether the aircraft was damaged",
    )
}

/// A number with its unit, or a dash.
pub(crate) fn number(value: Option<f64>, unit: &str) -> String {
    let finite = value.filter(|value| value.is_finite());
    finite.map_or_else(|| NONE.to_owned(), |value| format!("{value:.2} {unit}").trim_end().to_owned())
}

fn tracking(summary: &Summary) -> Table {
    let scores = &summary.scores;
    let row = |label: &str, shifted, truth, unit: &str| {
        (label.to_owned(), vec![number(shifted, unit), number(truth, unit)])
    };
    let rows = vec![
        row("cross-track", scores.cross_track_rms_m, scores.cross_track_true_rms_m, "m"),
        row(
            "  on straight legs",
            scores.straight_cross_track_rms_m,
            scores.straight_cross_track_true_rms_m,
            "m",
        ),
        row("altitude", scores.altitude_rms_m, scores.altitude_true_rms_m, "m"),
        row("airspeed", scores.airspeed_rms_mps, scores.airspeed_true_rms_mps, "m/s"),
    ];
    let note = "shifted truth: the truth moved by the slow errors of receiver and barometer, which no filter can see";
    Table { heading: "tracking, RMS", columns: vec!["shifted truth", "truth"], rows, note: Some(note) }
}

fn estimate(summary: &Summary) -> Table {
    let scores = &summary.estimator;
    let row = |label: &str, value, unit: &str| (label.to_owned(), vec![number(value, unit)]);
    let rows = vec![
        row("roll", scores.roll_rms_deg, "°"),
        row("pitch", scores.pitch_rms_deg, "°"),
        row("yaw", scores.yaw_rms_deg, "°"),
        row("velocity", scores.velocity_rms_mps, "m/s"),
        row("position, shifted truth", scores.position_rms_m, "m"),
        row("position, truth", scores.position_true_rms_m, "m"),
        row("share of the time covered", scores.covered.map(|share| 100.0 * share), "%"),
    ];
    let gaps = scores.covered.is_some_and(|share| share < WHOLE);
    let note =
        gaps.then_some("scored only where there was an estimate: see the share of the time that this covers");
    Table { heading: "estimate, RMS", columns: Vec::new(), rows, note }
}

fn air(summary: &Summary) -> Table {
    let air = &summary.conditions;
    let row = |label: &str, value: String| (label.to_owned(), vec![value]);
    let listed = |what: &[String]| if what.is_empty() { NONE.to_owned() } else { what.join("; ") };
    let rows = vec![
        row("wind and gusts as asked", said(air.air_as_asked).into()),
        row("wind met (asked)", format!("{} ({:.1})", number(air.wind_mean_mps, "m/s"), air.wind_asked_mps)),
        row("gusts met, RMS", number(air.gust_rms_mps, "m/s")),
        row("turbulence asked", if air.turbulence.is_empty() { NONE.into() } else { air.turbulence.clone() }),
        row("faults asked", listed(&air.faults)),
        row("sensors and aircraft varied", listed(&air.variation)),
        row("steepest bank", number(air.bank_max_deg, "°")),
        row("slowest airspeed", number(air.airspeed_min_mps, "m/s")),
        row("greatest cross-track", number(summary.scores.cross_track_max_m, "m")),
    ];
    let landing = air.touchdown.iter().flat_map(|touchdown| {
        let aside = if touchdown.across_m < 0.0 { "left" } else { "right" };
        let place = format!("{:.0} m along, {:.1} m {aside}", touchdown.along_m, touchdown.across_m.abs());
        [
            row("touch-down, sink", number(Some(touchdown.sink_mps), "m/s")),
            row("touch-down, place", place),
            row("touch-down, speed", number(Some(touchdown.speed_mps), "m/s")),
        ]
    });
    let rows = rows.into_iter().chain(landing).collect();
    Table { heading: "aircraft and air", columns: Vec::new(), rows, note: None }
}

fn said(answer: Option<bool>) -> &'static str {
    match answer {
        Some(true) => "yes",
        Some(false) => "NO",
        None => NONE,
    }
}

fn windows(summary: &Summary) -> Table {
    let row = |label: &str, value: u64| (label.to_owned(), vec![value.to_string()]);
    let rows = vec![
        row("granted", summary.windows),
        row("late", summary.late_windows),
        row("overruns", summary.window_overruns),
        row("skipped", summary.skipped_windows),
        row("restarts", summary.restarts),
    ];
    Table { heading: "windows", columns: Vec::new(), rows, note: None }
}

fn chains(summary: &Summary) -> Table {
    let ms = |us: f64| format!("{:.2}", us / 1000.0);
    let row = |chain: &ChainAge| {
        let measured = |of: fn(&Percentiles) -> f64| {
            chain.measured_us.as_ref().map_or_else(|| NONE.to_owned(), |times| ms(of(times)))
        };
        let (p50, p99, max) =
            (measured(|times| times.p50), measured(|times| times.p99), measured(|times| times.max));
        let name: String = chain.chain.chars().take(LABEL - 2).collect();
        (name, vec![ms(chain.computed_us), p50, p99, max, ms(chain.allowed_us)])
    };
    let rows = summary.chain_ages.iter().map(row).collect();
    let older = summary.chain_ages.iter().any(|chain| chain.too_old > 0);
    let note = older.then_some(
        "values older than allowed came about where windows were not granted or not closed: the computed age takes every \
         window for granted",
    );
    let columns = vec!["computed", "median", "99 %", "greatest", "allowed"];
    Table { heading: "chain ages, ms", columns, rows, note }
}

fn times(summary: &Summary) -> Table {
    let row = |label: &str, times: &Percentiles| {
        let values = [times.p50, times.p99, times.p999, times.max];
        (label.to_owned(), values.iter().map(|value| format!("{value:.1}")).collect())
    };
    let mut rows = Vec::new();
    rows.extend(summary.window_start_lateness_us.iter().map(|times| row("window start, late by", times)));
    rows.extend(summary.chain_execution_us.iter().map(|times| row("whole chain", times)));
    rows.extend(summary.partition_execution_us.iter().map(|(name, times)| row(&format!("  {name}"), times)));
    let note = (summary.clock == Some(Clock::Virtual)).then_some(
        "virtual clock: the processor's time, of which module time knows nothing. A partition that waits for its device \
         (hil_interface: for the simulator) may take longer than its window; the whole chain is the schedule's distance \
         plus what its last partition took",
    );
    Table { heading: "times, µs", columns: vec!["median", "99 %", "99.9 %", "greatest"], rows, note }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::{Guarantee, Run};
    use crate::{Analysis, Flight};

    #[test]
    fn empty_flight_still_says_what_happened() {
        let flight = Flight { notes: vec!["windows.csv cannot be read".into()], ..Default::default() };
        let text = table(&Analysis::of(&flight).summary(&flight));
        assert!(text.contains("NOT completed: the truth confirms 0 of 9 way-points"), "{text}");
        assert!(text.contains("none reached") && text.contains("windows.csv cannot be read"));
    }

    #[test]
    fn means_stand_beside_what_was_measured_and_neither_says_that_a_promise_was_kept() {
        let means =
            Guarantee { promise: "a window starts at its instant".into(), held: true, detail: String::new() };
        let run = Run { guarantees: vec![means.clone()], lost_records: 3, ..Default::default() };
        let flight = Flight { run: Some(run), ..Default::default() };
        let mut summary = Analysis::of(&flight).summary(&flight);
        (summary.windows, summary.late_windows, summary.skipped_windows) = (95, 2, 5);
        let text = table(&summary);
        assert!(text.contains("means of this machine     there: a window starts at its instant"), "{text}");
        for line in [
            "begun more than 200 µs late (L): 2 of 100 windows",
            "not closed at the end (O): none of 100 windows",
            "not granted (S, M): 5 of 100 windows",
            "3 further windows are not in the log",
        ] {
            assert!(text.contains(line), "{line}\n{text}");
        }
        assert!(!text.contains("held"), "{text}");
        let missing = Guarantee { promise: "memory is locked".into(), held: false, ..means.clone() };
        summary.guarantees = vec![means.clone(), missing];
        let text = table(&summary);
        assert!(text.contains(" there: a window") && text.contains("MISSING: memory is locked"), "{text}");
        summary.guarantees = vec![means.clone(), means];
        assert!(table(&summary).contains("means of this machine     all 2 are there (report.html"), "{text}");
        summary.clock = Some(Clock::Virtual);
        assert!(!table(&summary).contains("µs late"), "on the virtual clock no window has a real instant");
    }

    #[test]
    fn estimate_says_which_share_of_the_time_it_covers() {
        let flight = Flight::default();
        let mut summary = Analysis::of(&flight).summary(&flight);
        summary.estimator.roll_rms_deg = Some(0.25);
        summary.estimator.covered = Some(0.314);
        let text = table(&summary);
        assert!(text.contains("share of the time covered") && text.contains("31.40 %"), "{text}");
        assert!(text.contains("scored only where there was an estimate"), "{text}");
        summary.estimator = Default::default();
        assert!(!table(&summary).contains("scored only"), "dashes need no explanation");
    }

    #[test]
    fn no_line_is_wider_than_the_terminal() {
        let long = Guarantee { promise: "p".repeat(250), held: false, detail: "word ".repeat(60) };
        let run = Run { guarantees: vec![long], ..Default::default() };
        let flight = Flight { name: "n".repeat(120), run: Some(run), ..Default::default() };
        let mut summary = Analysis::of(&flight).summary(&flight);
        summary.waypoints = vec!["WP0".to_owned(); 200];
        summary.unverified_waypoints = vec![1];
        let text = table(&summary);
        assert!(text.lines().all(|line| line.chars().count() <= WIDTH), "{text}");
        assert!(text.contains("WP0 WP0? WP0") && text.contains("MISSING"));
    }
}
