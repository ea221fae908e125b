//! Which partitions were there over the whole flight: a lane each, with gaps where windows found nobody to run, ticks at
//! overruns and rings at faults.

use crate::figures::TIME;
use crate::flight::seconds;
use crate::health::HealthEntry;
use crate::plot::{Across, escape};
use crate::reasons::{self, Reason, fault_anchor, linked};
use crate::windows::Window;
use std::fmt::Write as _;

/// Space for the partitions' names, px.
const LEFT: f64 = 128.0;
/// Space right of the lanes, px.
const RIGHT: f64 = 12.0;
/// Space above the lanes for the title, px.
const TOP: f64 = 26.0;
/// Height of a lane, px.
const LANE: f64 = 19.0;
/// Height of what is drawn in it, px.
const BAR: f64 = 9.0;
/// Space below the lanes for the numbers, px.
const BOTTOM: f64 = 36.0;
/// An absence is drawn at least this wide, px, or it could not be seen.
const LEAST_WIDTH: f64 = 1.5;
/// Absences and overruns kept of one partition, most: a picture shows no more, and a long flight may have millions.
const MOST: usize = 2000;
/// Lane of errors of the module itself.
const MODULE: &str = "module";

/// The window log as seen from far away.
#[derive(Debug, Default)]
pub struct Presence {
    lanes: Vec<Lane>,
    end_ns: u64,
}

#[derive(Debug)]
struct Lane {
    partition: String,
    /// Stretches without anybody to run, ns.
    absent: Vec<(u64, u64)>,
    /// Whether the last window found nobody.
    away: bool,
    /// Windows that were not closed in time, ns.
    overruns: Vec<u64>,
}

impl Lane {
    /// An absence ends where the partition is there again.
    fn note(&mut self, window: &Window) {
        let until = if window.skipped { window.planned_end_ns } else { window.planned_start_ns };
        if let Some(last) = self.absent.last_mut().filter(|_| self.away) {
            last.1 = until;
        } else if self.absent.len() == MOST {
            return;
        } else if window.skipped {
            self.absent.push((window.planned_start_ns, until));
        }
        self.away = window.skipped;
    }
}

impl Presence {
    /// Takes a window; they come in the order of their planned starts.
    pub fn add(&mut self, window: &Window) {
        self.end_ns = self.end_ns.max(window.planned_end_ns);
        let lane = self.lane(&window.partition);
        // A window that the executive lost says nothing about the partition.
        if !window.flags.contains(['M', 'H', 'F']) {
            lane.note(window);
        }
        if window.overrun && lane.overruns.len() < MOST {
            lane.overruns.push(window.planned_end_ns);
        }
    }

    fn lane(&mut self, partition: &str) -> &mut Lane {
        let place = self.lanes.iter().position(|lane| lane.partition == partition).unwrap_or_else(|| {
            let partition = partition.to_owned();
            self.lanes.push(Lane { partition, absent: Vec::new(), away: false, overruns: Vec::new() });
            self.lanes.len() - 1
        });
        &mut self.lanes[place]
    }

    /// The picture as an SVG element; it scales with the page. `None` without windows.
    pub fn svg(&self, health: &[HealthEntry], reasons: &[Reason], width: f64) -> Option<String> {
        if self.lanes.is_empty() {
            return None;
        }
        let of_module = health.iter().any(|entry| entry.acted_on() && entry.partition.is_none());
        let names: Vec<&str> = self
            .lanes
            .iter()
            .map(|lane| lane.partition.as_str())
            .chain(of_module.then_some(MODULE))
            .collect();
        let bottom = TOP + LANE * names.len() as f64;
        let mut out = String::new();
        let (across, plot) = (
            Across { label: TIME, from: 0.0, to: seconds(self.end_ns.max(1)) },
            [LEFT, TOP, width - RIGHT, bottom],
        );
        let _ = write!(
            out,
            r#"<svg viewBox="0 0 {width} {}" role="img" aria-label="Partitions over the flight"{}>"#,
            bottom + BOTTOM,
            across.data(plot)
        );
        let _ = write!(out, r#"<text class="title" x="{LEFT}" y="14">Partitions over the flight</text>"#);
        across.draw(&mut out, plot, (width - LEFT - RIGHT) / 12.0);
        let middle = |row: usize| TOP + LANE * (row as f64 + 0.5);
        for (row, name) in names.iter().enumerate() {
            let (label, y) = (escape(name), middle(row) - 0.5 * BAR + 8.5);
            let _ = write!(out, r#"<text class="tick end" x="{}" y="{y}">{label}</text>"#, LEFT - 6.0);
        }
        out.push_str(r#"<g class="data">"#);
        for (row, lane) in self.lanes.iter().enumerate() {
            self.draw_lane(&mut out, lane, reasons, width, middle(row) - 0.5 * BAR);
        }
        for (place, entry) in health.iter().filter(|entry| entry.acted_on()).enumerate() {
            let name = entry.of_whom();
            let Some(row) = names.iter().position(|other| *other == name) else { continue };
            let ring = self.fault(entry, width, middle(row));
            out.push_str(&linked(fault_anchor(place).as_deref(), &ring));
        }
        out.push_str("</g></svg>");
        Some(out)
    }

    fn px(&self, ns: u64, width: f64) -> f64 {
        LEFT + (ns as f64 / self.end_ns.max(1) as f64).min(1.0) * (width - LEFT - RIGHT)
    }

    fn draw_lane(&self, out: &mut String, lane: &Lane, reasons: &[Reason], width: f64, y: f64) {
        let wide = width - LEFT - RIGHT;
        let _ = write!(out, r#"<rect class="there" x="{LEFT}" y="{y}" width="{wide}" height="{BAR}" />"#);
        for (from, to) in &lane.absent {
            let x = self.px(*from, width);
            let wide = (self.px(*to, width) - x).max(LEAST_WIDTH);
            let at = format!(r#"data-at="{}" data-to="{}""#, seconds(*from), seconds(*to));
            let text = format!(
                "{}: nobody to run from {:.2} s to {:.2} s",
                lane.partition,
                seconds(*from),
                seconds(*to)
            );
            let _ = write!(
                out,
                r#"<rect class="absent" x="{x:.2}" y="{y}" width="{wide:.2}" height="{BAR}" {at}>"#
            );
            let _ = write!(out, "<title>{}</title></rect>", escape(&text));
        }
        for end in &lane.overruns {
            let x = self.px(*end, width);
            let (at, y) = (seconds(*end), y + BAR);
            let tick = format!(r#"<path class="overran" d="M{x:.2} {y}v3.5" data-at="{at}" />"#);
            out.push_str(&linked(reasons::before(reasons, &lane.partition, *end).as_deref(), &tick));
        }
    }

    fn fault(&self, entry: &HealthEntry, width: f64, y: f64) -> String {
        let (x, at) = (self.px(entry.time_ns, width), seconds(entry.time_ns));
        let back = entry.recovery_ms().map_or_else(String::new, |ms| format!(", back after {ms:.1} ms"));
        let HealthEntry { error, action, detail, .. } = entry;
        let text = format!("{at:.2} s {}: {error} → {action}{back}. {detail}", entry.of_whom());
        let text = escape(text.trim());
        format!(
            r#"<circle class="fault" cx="{x:.2}" cy="{y:.1}" r="3.5" data-at="{at}"><title>{text}</title></circle>"#
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn seen(lines: &[&str]) -> Presence {
        let mut presence = Presence::default();
        lines.iter().for_each(|line| presence.add(&Window::parse(line).unwrap()));
        presence
    }

    #[test]
    fn absence_lasts_from_the_first_empty_window_to_the_next_full_one() {
        let presence = seen(&[
            "0,0,1,imu,0,500,0,1,9,",
            "0,1,1,imu,1000,1500,,,,S",
            "0,2,1,imu,2000,2500,,,,M",
            "0,3,1,imu,3000,3500,,,,S",
            "0,4,1,imu,4000,4500,4000,4001,,O",
            "0,4,1,gps,4600,4700,4600,4601,4602,",
        ]);
        assert_eq!(presence.lanes[0].absent, [(1000, 4000)]);
        assert_eq!(presence.lanes[0].overruns, [4500]);
        assert!(presence.lanes[1].absent.is_empty());
    }

    #[test]
    fn window_missed_by_the_dispatcher_is_no_absence() {
        let presence = seen(&["0,0,1,imu,0,500,,,,M", "0,1,1,imu,1000,1500,1000,1001,1002,"]);
        assert!(presence.lanes[0].absent.is_empty());
    }

    #[test]
    fn faults_lie_in_their_partitions_lane_and_say_what_was_done() {
        let presence = seen(&["0,0,1,imu,0,2000000000,0,1,9,"]);
        let entry = |partition: Option<&str>| HealthEntry {
            time_ns: 1_000_000_000,
            partition: partition.map(Into::into),
            generation: 1,
            error: "killed".into(),
            action: "warm_restart".into(),
            detail: "by <somebody>".into(),
            recovered_ns: Some(1_064_000_000),
        };
        let svg = presence.svg(&[entry(Some("imu")), entry(None)], &[], 900.0).unwrap();
        assert!(svg.contains("imu: killed → warm_restart, back after 64.0 ms. by &lt;somebody&gt;"), "{svg}");
        assert!(
            svg.contains(r##"<a href="#fault-1"><circle"##)
                && svg.contains(">module</text>")
                && svg.matches("<circle").count() == 2
        );
        assert!(Presence::default().svg(&[], &[], 900.0).is_none());
    }
}
