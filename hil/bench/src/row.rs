//! A row of the table of figures, and how it is printed.

use serde::Serialize;

/// How far a figure may go.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Reach {
    /// At most so many times the reference.
    Times(f64),
    /// The value itself at most this.
    AtMost(f64),
    /// The value itself at least this.
    AtLeast(f64),
    /// Stands there to be known.
    Stated,
}

/// One figure.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Row {
    /// What was measured.
    pub(super) name: String,
    /// The median over the runs; `None`: not to be had here.
    pub(super) value: Option<f64>,
    /// Unit of value and reference.
    pub(super) unit: String,
    /// What it is held against, measured in the same run; `None` if the reach is a number of its own.
    pub(super) reference: Option<f64>,
    /// Value over reference.
    pub(super) ratio: Option<f64>,
    /// How far it may go, in words.
    pub(super) reach: String,
    /// Whether it does not go further.
    pub(super) met: Option<bool>,
    /// What the reference is, or why there is no value.
    pub(super) about: String,
}

impl Row {
    /// A figure that was measured.
    pub(super) fn measured(
        name: impl Into<String>,
        unit: &str,
        value: f64,
        reference: Option<f64>,
        reach: Reach,
        about: &str,
    ) -> Self {
        let ratio = reference.filter(|reference| *reference != 0.0).map(|reference| value / reference);
        let (words, met) = match reach {
            Reach::Times(times) => (format!("<= {times} times"), ratio.map(|ratio| ratio <= times)),
            Reach::AtMost(most) => (format!("<= {} {unit}", short(most)), Some(value <= most)),
            Reach::AtLeast(least) => (format!(">= {} {unit}", short(least)), Some(value >= least)),
            Reach::Stated => ("-".into(), None),
        };
        let (name, unit, about) = (name.into(), unit.into(), about.into());
        Self { name, value: Some(value), unit, reference, ratio, reach: words, met, about }
    }

    /// A figure that this machine can not give.
    pub(super) fn impossible(name: impl Into<String>, why: impl Into<String>) -> Self {
        let (name, about) = (name.into(), why.into());
        let nothing = String::new;
        Self {
            name,
            value: None,
            unit: nothing(),
            reference: None,
            ratio: None,
            reach: nothing(),
            met: None,
            about,
        }
    }
}

/// The table for a person, as it stands in a page.
pub(super) fn table(rows: &[Row]) -> String {
    let heading = ["figure", "value", "reference", "ratio", "reach", "met"].map(str::to_owned);
    let mut lines = vec![heading];
    lines.extend(rows.iter().filter(|row| row.value.is_some()).map(cells));
    let widths: Vec<usize> = (0..6)
        .map(|column| lines.iter().map(|line| line[column].chars().count()).max().unwrap_or(0))
        .collect();
    let mut text = String::new();
    for (number, line) in lines.iter().enumerate() {
        let padded = line.iter().zip(&widths).enumerate().map(|(column, (cell, width))| match column {
            0 | 4 | 5 => format!("{cell:width$}"),
            _ => format!("{cell:>width$}"),
        });
        text += &format!("| {} |\n", padded.collect::<Vec<_>>().join(" | "));
        if number == 0 {
            let rule: Vec<String> = widths.iter().map(|width| "-".repeat(width + 2)).collect();
            text += &format!("|{}|\n", rule.join("|"));
        }
    }
    for row in rows.iter().filter(|row| row.value.is_none()) {
        text += &format!("\nnot here: {}: {}\n", row.name, row.about);
    }
    text
}

fn cells(row: &Row) -> [String; 6] {
    let with_unit = |value: Option<f64>| {
        value.map_or_else(|| "-".into(), |value| format!("{} {}", short(value), row.unit))
    };
    let met = match row.met {
        Some(true) => "yes",
        Some(false) => "NO",
        None => "-",
    };
    [
        row.name.clone(),
        with_unit(row.value),
        with_unit(row.reference),
        row.ratio.map_or_else(|| "-".into(), |ratio| format!("{ratio:.2}")),
        row.reach.clone(),
        met.into(),
    ]
}

/// Three digits that matter, as far as there are so many.
fn short(value: f64) -> String {
    match value.abs() {
        at_least_100 if at_least_100 >= 100.0 => format!("{value:.0}"),
        at_least_10 if at_least_10 >= 10.0 => without_zeros(format!("{value:.1}")),
        _ => without_zeros(format!("{value:.2}")),
    }
}

fn without_zeros(text: String) -> String {
    match text.split_once('.') {
        Some((whole, fraction)) if fraction.bytes().all(|digit| digit == b'0') => whole.to_owned(),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ratio_above_its_reach_is_not_met_and_one_at_it_is() {
        let row = |value| Row::measured("start", "us", value, Some(10.0), Reach::Times(2.5), "cyclictest");
        assert_eq!((row(25.0).ratio, row(25.0).met), (Some(2.5), Some(true)));
        assert_eq!(row(25.1).met, Some(false));
    }

    #[test]
    fn a_reference_of_nothing_gives_no_ratio_and_no_verdict() {
        let row = Row::measured("start", "us", 3.0, Some(0.0), Reach::Times(2.0), "");
        assert_eq!((row.ratio, row.met), (None, None));
    }

    #[test]
    fn the_table_says_what_is_not_to_be_had_and_why() {
        let rows = [
            Row::measured("window start, p50", "us", 18.61, Some(9.0), Reach::Times(2.5), "cyclictest"),
            Row::measured("memory", "MiB", 123.4, None, Reach::AtMost(32.0), ""),
            Row::impossible("fence", "needs SCHED_FIFO"),
        ];
        let expected = "\
| figure            |   value | reference | ratio | reach        | met |
|-------------------|---------|-----------|-------|--------------|-----|
| window start, p50 | 18.6 us |      9 us |  2.07 | <= 2.5 times | yes |
| memory            | 123 MiB |         - |     - | <= 32 MiB    | NO  |

not here: fence: needs SCHED_FIFO
";
        assert_eq!(table(&rows), expected);
    }
}
