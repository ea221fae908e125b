//! The windows of a schedule as a picture: a bar for each kind of minor frame on each core, a legend with the share of
//! each partition.

use std::fmt::Write;

use bateleur_checker::Facts;
use bateleur_checker::facts::share;
use bateleur_plan::units::ShowTime;
use bateleur_plan::{PartitionId, Plan, ScheduleId};

use super::facts::percent;
use super::frames::{Alike, alike, lines};

/// Colours that can be told apart, also by most colour-blind people (after Paul Tol's sets), and lighter ones after them.
const COLOURS: [&str; 12] = [
    "#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#ee8866", "#44bb99", "#aaaa00",
    "#99ddff", "#ffaabb", "#bbcc33",
];

const WIDTH: u64 = 960;
const LEFT: u64 = 20;
const BAR: u64 = 920;
const BAR_HEIGHT: u64 = 46;
/// About what a letter of the labels takes, so that only names that fit are written into a window.
const LETTER_WIDTH: u64 = 7;

pub(super) fn colour(partition: PartitionId) -> &'static str {
    COLOURS[partition.index() % COLOURS.len()]
}

/// Text as XML holds it.
pub(super) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// The whole picture.
pub(super) fn svg(plan: &Plan, schedule: ScheduleId) -> String {
    let table = &plan[schedule];
    let mut body = String::new();
    let mut y = 30;
    let _ = writeln!(
        body,
        "<text x=\"{LEFT}\" y=\"{y}\" font-size=\"16\">schedule {}: major frame {}, minor frame {}</text>",
        escaped(&table.name),
        ShowTime(table.major_frame_ns),
        ShowTime(table.minor_frame_ns)
    );
    let facts = Facts::of(plan);
    for (module, line) in lines(plan, schedule) {
        for core in &line.cores {
            y += 34;
            let used = percent(share(core.used_ns(), table.major_frame_ns));
            let _ = writeln!(
                body,
                "<text x=\"{LEFT}\" y=\"{y}\">core {} of {}: {used} used</text>",
                core.core,
                escaped(module)
            );
            for kind in alike(core, table.minor_frame_ns, table.minor_frames()) {
                y += 22;
                let _ =
                    writeln!(body, "<text x=\"{LEFT}\" y=\"{y}\" font-size=\"12\">{}</text>", kind.label());
                y += 8;
                bar(&mut body, plan, &kind, table.minor_frame_ns, y);
                y += BAR_HEIGHT + 18;
            }
        }
    }
    y = legend(&mut body, plan, &facts, schedule, y + 14);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {WIDTH} {y}\" width=\"{WIDTH}\" height=\"{y}\" \
         font-family=\"sans-serif\" font-size=\"13\" fill=\"#222222\">\n<title>schedule {}</title>\n\
         <rect width=\"{WIDTH}\" height=\"{y}\" fill=\"#ffffff\"/>\n{body}</svg>\n",
        escaped(&table.name)
    )
}

/// A place on the bar in tenths of a pixel, so that equal files give equal texts everywhere.
fn at(ns: u64, minor_ns: u64) -> String {
    let tenths = u128::from(ns) * u128::from(BAR) * 10 / u128::from(minor_ns.max(1));
    format!("{}.{}", u128::from(LEFT) + tenths / 10, tenths % 10)
}

fn length(from: u64, to: u64, minor_ns: u64) -> String {
    let tenths = |ns: u64| u128::from(ns) * u128::from(BAR) * 10 / u128::from(minor_ns.max(1));
    let length = tenths(to).saturating_sub(tenths(from));
    format!("{}.{}", length / 10, length % 10)
}

fn bar(body: &mut String, plan: &Plan, kind: &Alike, minor_ns: u64, y: u64) {
    let _ = writeln!(
        body,
        "<rect x=\"{LEFT}\" y=\"{y}\" width=\"{BAR}\" height=\"{BAR_HEIGHT}\" fill=\"#eeeeee\" stroke=\"#999999\"/>"
    );
    for &(start, end, partition) in &kind.windows {
        let name = escaped(&plan[partition].name);
        let (x, width) = (at(start, minor_ns), length(start, end, minor_ns));
        let _ = writeln!(
            body,
            "<rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{BAR_HEIGHT}\" fill=\"{}\" stroke=\"#ffffff\">\
             <title>{name}: {} to {}</title></rect>",
            colour(partition),
            ShowTime(start),
            ShowTime(end)
        );
        let room = u128::from(end - start) * u128::from(BAR) / u128::from(minor_ns.max(1));
        if room > u128::from(LETTER_WIDTH) * (name.len() as u128 + 1) {
            let _ = writeln!(
                body,
                "<text x=\"{}\" y=\"{}\" text-anchor=\"middle\" fill=\"#ffffff\" font-size=\"12\">{name}</text>",
                at(u64::midpoint(start, end), minor_ns),
                y + BAR_HEIGHT / 2 + 4
            );
        }
    }
    scale(body, minor_ns, y + BAR_HEIGHT);
}

/// Marks at the tenths of the minor frame.
fn scale(body: &mut String, minor_ns: u64, y: u64) {
    for tenth in 0..=10 {
        let (ns, anchor) = (
            minor_ns / 10 * tenth,
            ["start", "middle", "end"][usize::from(tenth > 0) + usize::from(tenth == 10)],
        );
        let x = at(ns, minor_ns);
        let _ = writeln!(
            body,
            "<path d=\"M{x} {y}v4\" stroke=\"#999999\"/><text x=\"{x}\" y=\"{}\" text-anchor=\"{anchor}\" font-size=\"10\">{}</text>",
            y + 14,
            ShowTime(ns)
        );
    }
}

/// What each partition has of each core; returns where it ends.
fn legend(body: &mut String, plan: &Plan, facts: &Facts, schedule: ScheduleId, mut y: u64) -> u64 {
    let Some(facts) = facts.schedules.get(schedule.index()) else { return y };
    for core in &facts.cores {
        for one in &core.partitions {
            y += 20;
            let colour = plan.partition(&one.partition).map_or("#000000", colour);
            let _ = writeln!(
                body,
                "<rect x=\"{LEFT}\" y=\"{}\" width=\"14\" height=\"14\" fill=\"{colour}\"/><text x=\"{}\" y=\"{y}\">{}</text>\
                 <text x=\"330\" y=\"{y}\" text-anchor=\"end\">{}</text><text x=\"350\" y=\"{y}\">{} in a major frame, core {}</text>",
                y - 12,
                LEFT + 22,
                escaped(&one.partition),
                percent(share(one.used_ns, core.major_frame_ns)),
                ShowTime(one.used_ns),
                core.core
            );
        }
    }
    y + 20
}
