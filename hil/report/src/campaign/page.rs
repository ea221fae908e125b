//! The result as one HTML page that loads nothing from anywhere.

use std::fmt::Write;

use super::result::{CampaignResult, Failure, Figure, Spread};
use crate::plot::escape;

const STYLE: &str = include_str!("../page.css");
/// Bars of a histogram.
const BARS: usize = 30;
/// Size of a histogram, px.
const SIZE: (f64, f64) = (320.0, 60.0);
/// Failures that are listed; the rest is counted.
const MOST_FAILURES: usize = 200;

/// The page.
pub fn page(result: &CampaignResult) -> String {
    let mut out = String::with_capacity(1 << 16);
    let CampaignResult { asked, flown, completed, failed, .. } = result;
    let all_well = failed.is_empty() && flown == asked;
    let (class, word) = if all_well { ("good", "all completed") } else { ("bad", "not all completed") };
    // Into a string: nothing of this can fail.
    let _ = write!(
        out,
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\" />\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\" />\
         <title>Campaign of {flown} flights</title><style>{STYLE}</style></head><body>\
         <header><h1>Campaign of {flown} flights</h1><span class=\"badge {class}\">{word}</span></header>"
    );
    let plan = &result.plan;
    let (part, parts) = plan.shard;
    let shard = if parts > 1 { format!(" · shard {part} of {parts}") } else { String::new() };
    let _ = write!(
        out,
        r#"<p class="sub">seeds from {} on{shard} · version {} · {:.2} h of real time in flights</p>"#,
        plan.seed,
        escape(&plan.version),
        result.flight_hours
    );
    let cards = [
        ("asked for", *asked),
        ("flown", *flown),
        ("completed", *completed),
        ("failed", failed.len() as u64),
    ];
    out.push_str(r#"<section class="cards">"#);
    for (label, value) in cards {
        let _ = write!(out, "<div><small>{label}</small><b>{value}</b></div>");
    }
    out.push_str("</section>");
    if let Some(words) = result.engine_words() {
        let _ = write!(out, r#"<p class="sub">{}</p>"#, escape(&words));
    }
    figures(&mut out, result);
    failures(&mut out, result);
    space(&mut out, result);
    if !result.notes.is_empty() {
        out.push_str("<h2>Notes</h2><ul>");
        for note in &result.notes {
            let _ = write!(out, "<li>{}</li>", escape(note));
        }
        out.push_str("</ul>");
    }
    out.push_str("</body></html>\n");
    out
}

fn figures(out: &mut String, result: &CampaignResult) {
    if result.figures.is_empty() {
        return;
    }
    out.push_str(
        r#"<h2>Figures of the completed flights</h2><table class="wide"><thead><tr><th>figure</th><th>flights</th><th>p50</th>
<th>p95</th><th>p99</th><th>worst</th><th>unit</th><th>seed of the worst</th><th>how they spread</th></tr></thead><tbody>"#,
    );
    for spread in &result.figures {
        let Some(figure) = Figure::ALL.iter().find(|figure| figure.name == spread.figure) else { continue };
        let Spread { flights, p50, p95, p99, worst, worst_seed, worst_command, .. } = spread;
        let _ = write!(
            out,
            r#"<tr><td>{}</td><td>{flights}</td><td>{p50:.2}</td><td>{p95:.2}</td><td>{p99:.2}</td><td>{worst:.2}</td><td>{}</td><td title="{}">{worst_seed}</td><td>{}</td></tr>"#,
            escape(figure.label),
            escape(figure.unit),
            escape(worst_command),
            histogram(spread)
        );
    }
    out.push_str(
        r#"</tbody></table><p class="sub">Lines: p50 green, p95 amber, p99 red. The command of the worst stands behind its seed.</p>"#,
    );
}

/// Flights by value, from the least to the worst, with marks at p50, p95 and p99.
fn histogram(spread: &Spread) -> String {
    let (least, worst) = (spread.values.first().copied().unwrap_or(0.0), spread.worst);
    let width = (worst - least).max(f64::MIN_POSITIVE);
    let mut counts = [0_u64; BARS];
    for value in &spread.values {
        let bar = ((value - least) / width * BARS as f64) as usize;
        counts[bar.min(BARS - 1)] += 1;
    }
    let most = counts.iter().copied().max().unwrap_or(1).max(1) as f64;
    let (wide, high) = SIZE;
    let mut svg = format!(
        r#"<svg viewBox="0 0 {wide} {high}" width="{wide}" height="{high}" role="img" aria-label="{least:.3} to {worst:.3}">"#
    );
    let (step, foot) = (wide / BARS as f64, high - 3.0);
    for (place, count) in counts.iter().enumerate() {
        let tall = (high - 14.0) * *count as f64 / most;
        let _ = write!(
            svg,
            r#"<rect x="{:.1}" y="{:.1}" width="{:.1}" height="{tall:.1}" fill="var(--c0)"/>"#,
            place as f64 * step,
            high - 14.0 - tall,
            step - 1.0
        );
    }
    for (value, colour) in [(spread.p50, "var(--c3)"), (spread.p95, "var(--c1)"), (spread.p99, "var(--bad)")]
    {
        let x = (value - least) / width * wide;
        let _ = write!(
            svg,
            r#"<line x1="{x:.1}" x2="{x:.1}" y1="0" y2="{:.1}" stroke="{colour}"/>"#,
            high - 14.0
        );
    }
    let _ = write!(
        svg,
        r#"<text x="0" y="{foot}" font-size="10" fill="var(--soft)">{least:.2}</text><text x="{wide}" y="{foot}" font-size="10" text-anchor="end" fill="var(--soft)">{worst:.2}</text></svg>"#
    );
    svg
}

fn failures(out: &mut String, result: &CampaignResult) {
    if result.failed.is_empty() {
        return;
    }
    out.push_str(r#"<h2>Failed</h2><table class="wide"><thead><tr><th>flights</th><th>reason</th></tr></thead><tbody>"#);
    for (reason, count) in &result.reasons {
        let _ = write!(out, "<tr><td>{count}</td><td>{}</td></tr>", escape(reason));
    }
    out.push_str(
        r#"</tbody></table><h2>To fly them again</h2><table class="wide"><thead><tr><th>flight</th><th>reason</th><th>command</th></tr></thead><tbody>"#,
    );
    for Failure { number, reason, command, .. } in result.failed.iter().take(MOST_FAILURES) {
        let (reason, command) = (escape(reason), escape(command));
        let _ = write!(out, "<tr><td>{number}</td><td>{reason}</td><td><code>{command}</code></td></tr>");
    }
    out.push_str("</tbody></table>");
    if result.failed.len() > MOST_FAILURES {
        let _ = write!(out, r#"<p class="sub">and {} more</p>"#, result.failed.len() - MOST_FAILURES);
    }
}

fn space(out: &mut String, result: &CampaignResult) {
    out.push_str(r#"<h2>Drawn from</h2><table class="wide"><tbody>"#);
    for (name, range) in &result.plan.space {
        let _ = write!(out, "<tr><td>{}</td><td>{}</td></tr>", escape(name), escape(range));
    }
    let common = result.plan.common.join(" ");
    if !common.is_empty() {
        let _ = write!(out, "<tr><td>every flight</td><td><code>{}</code></td></tr>", escape(&common));
    }
    out.push_str("</tbody></table>");
}
