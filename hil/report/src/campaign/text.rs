//! The result for a terminal.

use std::fmt::Write;

use super::result::{CampaignResult, Figure};

/// Failures that are listed; the rest is counted.
const MOST_FAILURES: usize = 20;

/// The table of figures, the failures and how to fly them again.
pub fn text(result: &CampaignResult) -> String {
    let CampaignResult { asked, flown, completed, failed, .. } = result;
    let mut text = String::new();
    // Into a string: nothing of this can fail.
    let _ =
        writeln!(text, "{flown} of {asked} flights flown: {completed} completed, {} failed", failed.len());
    if let Some(words) = result.engine_words() {
        let _ = writeln!(text, "{words}");
    }
    if !result.figures.is_empty() {
        let _ = writeln!(
            text,
            "\n{:<28} {:>8} {:>9} {:>9} {:>9} {:>9}  {:<5} {:>12}",
            "figure", "flights", "p50", "p95", "p99", "worst", "", "worst, seed"
        );
    }
    for spread in &result.figures {
        let Some(figure) = Figure::ALL.iter().find(|figure| figure.name == spread.figure) else { continue };
        let _ = writeln!(
            text,
            "{:<28} {:>8} {:>9.2} {:>9.2} {:>9.2} {:>9.2}  {:<5} {:>12}",
            figure.label,
            spread.flights,
            spread.p50,
            spread.p95,
            spread.p99,
            spread.worst,
            figure.unit,
            spread.worst_seed
        );
    }
    if !failed.is_empty() {
        text.push_str("\nfailed\n");
        for (reason, count) in &result.reasons {
            let _ = writeln!(text, "{count:>6}  {reason}");
        }
        text.push_str("\nto fly them again\n");
        for failure in failed.iter().take(MOST_FAILURES) {
            let _ = writeln!(text, "flight {}: {}\n  {}", failure.number, failure.reason, failure.command);
        }
        if failed.len() > MOST_FAILURES {
            let _ = writeln!(text, "and {} more, see --format json", failed.len() - MOST_FAILURES);
        }
    }
    for note in &result.notes {
        let _ = writeln!(text, "note: {note}");
    }
    text
}
