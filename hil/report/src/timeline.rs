//! The partitions' windows over time as a picture: planned as outlines, used time filled, one lane for each partition
//! of each core. Below a partition of several processes each of them has a lane of its own, with when it ran.

use crate::plot::{escape, ticks};
use crate::reasons::{Reason, linked, of_window};
use crate::run::Clock;
use crate::windows::Window;
use bateleur_recording::processes::Span;
use std::fmt::Write as _;

/// Space for the partitions' names, px.
const LEFT: f64 = 128.0;
/// Space right of the lanes, px.
const RIGHT: f64 = 12.0;
/// Space above the lanes for the title, px.
const TOP: f64 = 26.0;
/// Height of a lane, px.
const LANE: f64 = 17.0;
/// Height of a window in its lane, px.
const BAR: f64 = 11.0;
/// Space below the lanes for the numbers, px.
const BOTTOM: f64 = 36.0;
/// Used time is drawn at least this wide, px, or it could not be seen.
const LEAST_BAR: f64 = 1.0;

/// A stretch of the schedule to be drawn.
pub struct Timeline<'a> {
    title: String,
    windows: Vec<&'a Window>,
    spans: Vec<&'a Span>,
    lanes: Vec<Lane<'a>>,
    clock: Clock,
    from_ns: u64,
    to_ns: u64,
    minors_ns: Vec<u64>,
}

/// A partition's on a core, or that of one of its processes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Lane<'a> {
    core: u32,
    partition: &'a str,
    process: Option<&'a str>,
}

/// Processes of a partition that have a lane, most: those that come first.
const MOST_PROCESSES: usize = 32;

impl<'a> Timeline<'a> {
    /// The whole major frame; `None` without windows.
    pub fn major(windows: &'a [Window], spans: &'a [Span], clock: Clock) -> Option<Self> {
        let minors_ns = minor_starts(windows);
        let from_ns = *minors_ns.first()?;
        let period = minors_ns.get(1).map_or(0, |second| second - from_ns);
        let last_end = windows.iter().map(|window| window.planned_end_ns).max()?;
        let to_ns = last_end.max(from_ns + period * minors_ns.len() as u64);
        let title = format!("Windows of major frame {}", windows.first()?.frame);
        let windows: Vec<_> = windows.iter().collect();
        let spans: Vec<_> =
            spans.iter().filter(|span| span.to_ns > from_ns && span.from_ns < to_ns).collect();
        let lanes = lanes(&windows, &spans);
        Some(Self { title, windows, spans, lanes, clock, from_ns, to_ns, minors_ns })
    }

    /// Its first minor frame alone, as a magnified view; `None` where the major frame has only one.
    pub fn minor(windows: &'a [Window], spans: &'a [Span], clock: Clock) -> Option<Self> {
        let minors_ns = minor_starts(windows);
        let (from_ns, to_ns) = (*minors_ns.first()?, *minors_ns.get(1)?);
        let title = "Its first minor frame".to_owned();
        let windows: Vec<_> = windows.iter().filter(|window| window.planned_start_ns < to_ns).collect();
        let spans: Vec<_> =
            spans.iter().filter(|span| span.to_ns > from_ns && span.from_ns < to_ns).collect();
        let lanes = lanes(&windows, &spans);
        Some(Self { title, windows, spans, lanes, clock, from_ns, to_ns, minors_ns: vec![from_ns] })
    }

    /// The picture as an SVG element; it scales with the page.
    pub fn svg(&self, reasons: &[Reason], width: f64) -> String {
        let bottom = TOP + LANE * self.lanes.len() as f64;
        let height = bottom + BOTTOM;
        let mut out = String::new();
        let title = escape(&self.title);
        let _ = write!(out, r#"<svg viewBox="0 0 {width} {height}" role="img" aria-label="{title}">"#);
        let _ = write!(out, r#"<text class="title" x="{LEFT}" y="14">{title}</text>"#);
        self.draw_grid(&mut out, width, bottom);
        for (row, lane) in self.lanes.iter().enumerate() {
            let y = TOP + LANE * row as f64;
            let name = escape(&self.lane_name(lane));
            let _ =
                write!(out, r#"<text class="tick end" x="{}" y="{}">{name}</text>"#, LEFT - 6.0, y + 12.5);
            let y = y + 0.5 * (LANE - BAR);
            if lane.process.is_some() {
                let is_own = |span: &&&Span| {
                    (span.partition.as_str(), span.process.as_deref()) == (lane.partition, lane.process)
                };
                self.spans.iter().filter(is_own).for_each(|span| self.draw_span(&mut out, span, width, y));
                continue;
            }
            let is_own =
                |window: &&&Window| (window.core, window.partition.as_str()) == (lane.core, lane.partition);
            self.windows
                .iter()
                .filter(is_own)
                .for_each(|window| self.draw_window(&mut out, window, reasons, width, y));
        }
        out.push_str("</svg>");
        out
    }

    fn lane_name(&self, lane: &Lane<'_>) -> String {
        let (core, partition) = (lane.core, lane.partition);
        if let Some(process) = lane.process {
            return format!("· {process}");
        }
        let alone = self.lanes.iter().all(|other| other.core == core);
        if alone { partition.to_owned() } else { format!("{partition} · core {core}") }
    }

    fn draw_span(&self, out: &mut String, span: &Span, width: f64, y: f64) {
        let (x, end) = (self.px(span.from_ns, width), self.px(span.to_ns, width));
        let wide = (end - x).max(LEAST_BAR);
        let _ = write!(out, r#"<rect class="used" x="{x:.2}" y="{y}" width="{wide:.2}" height="{BAR}">"#);
        let ran_us = (span.to_ns - span.from_ns) as f64 * 1e-3;
        let process = escape(span.process.as_deref().unwrap_or_default());
        let _ = write!(out, "<title>{process}: {ran_us:.1} µs</title></rect>");
    }

    fn px(&self, ns: u64, width: f64) -> f64 {
        let range = (self.to_ns - self.from_ns).max(1) as f64;
        let part = ns.saturating_sub(self.from_ns) as f64 / range;
        LEFT + part.min(1.0) * (width - LEFT - RIGHT)
    }

    fn draw_grid(&self, out: &mut String, width: f64, bottom: f64) {
        let range_ms = (self.to_ns - self.from_ns) as f64 * 1e-6;
        for (ms, text) in ticks(0.0, range_ms, 12.0) {
            let x = self.px(self.from_ns + (ms * 1e6).round() as u64, width);
            let _ = write!(out, r#"<line class="grid" x1="{x:.1}" y1="{TOP}" x2="{x:.1}" y2="{bottom}" />"#);
            let _ = write!(out, r#"<text class="tick mid" x="{x:.1}" y="{}">{text}</text>"#, bottom + 14.0);
        }
        for start in &self.minors_ns {
            let x = self.px(*start, width);
            let _ = write!(out, r#"<line class="minor" x1="{x:.1}" y1="{TOP}" x2="{x:.1}" y2="{bottom}" />"#);
        }
        let axis = format!("ms from {:.3} s of module time", self.from_ns as f64 * 1e-9);
        let _ = write!(
            out,
            r#"<text class="axis end" x="{}" y="{}">{axis}</text>"#,
            width - RIGHT,
            bottom + 29.0
        );
    }

    fn draw_window(&self, out: &mut String, window: &Window, reasons: &[Reason], width: f64, y: f64) {
        if let Some((from, to)) = self.used(window) {
            let (x, end) = (self.px(from, width), self.px(to, width));
            let class = if window.overrun { "used over" } else { "used" };
            let wide = (end - x).max(LEAST_BAR);
            let _ = write!(
                out,
                r#"<rect class="{class}" x="{x:.2}" y="{y}" width="{wide:.2}" height="{BAR}" />"#
            );
        }
        let (x, end) = (self.px(window.planned_start_ns, width), self.px(window.planned_end_ns, width));
        let class = match (window.skipped, window.late) {
            (true, _) => "planned skipped",
            (_, true) => "planned late",
            _ => "planned",
        };
        let wide = (end - x).max(LEAST_BAR);
        let text = escape(&described(window));
        let outline = format!(
            r#"<rect class="{class}" x="{x:.2}" y="{y}" width="{wide:.2}" height="{BAR}"><title>{text}</title></rect>"#
        );
        let was_late = window.skipped || window.late || window.overrun;
        let reason = if was_late { of_window(reasons, &window.partition, window.frame) } else { None };
        out.push_str(&linked(reason.as_deref(), &outline));
    }

    /// From when to when it worked. One never closed worked to its end. Under the virtual clock the stamps are of another
    /// time, so that the used time is laid to the planned start.
    fn used(&self, window: &Window) -> Option<(u64, u64)> {
        let opened = window.opened_ns?;
        let used = window.used_ns();
        match self.clock {
            Clock::Virtual => Some((window.planned_start_ns, window.planned_start_ns.saturating_add(used?))),
            Clock::Wall => Some((opened, window.closed_ns.unwrap_or(window.planned_end_ns))),
        }
    }
}

/// When each minor frame begins: at its earliest window.
fn minor_starts(windows: &[Window]) -> Vec<u64> {
    let mut minors: Vec<(u32, u64)> =
        windows.iter().map(|window| (window.minor, window.planned_start_ns)).collect();
    minors.sort_unstable();
    minors.dedup_by_key(|(minor, _)| *minor);
    let mut starts: Vec<_> = minors.into_iter().map(|(_, start)| start).collect();
    starts.sort_unstable();
    starts
}

fn lanes<'a>(windows: &[&'a Window], spans: &[&'a Span]) -> Vec<Lane<'a>> {
    let mut lanes = Vec::new();
    for window in windows {
        let lane = Lane { core: window.core, partition: window.partition.as_str(), process: None };
        if !lanes.contains(&lane) {
            lanes.push(lane);
        }
    }
    // By core; within one in the order of the schedule.
    lanes.sort_by_key(|lane| lane.core);
    // Below the first lane of a partition those of its processes, by name.
    let mut all: Vec<Lane<'a>> = Vec::new();
    for lane in lanes {
        let is_first = all.iter().all(|other| other.partition != lane.partition);
        all.push(lane);
        let own = spans.iter().filter(|span| is_first && span.partition == lane.partition);
        let mut processes: Vec<&str> = own.filter_map(|span| span.process.as_deref()).collect();
        processes.sort_unstable();
        processes.dedup();
        processes.truncate(MOST_PROCESSES);
        all.extend(processes.into_iter().map(|process| Lane { process: Some(process), ..lane }));
    }
    all
}

fn described(window: &Window) -> String {
    let planned = (window.planned_end_ns.saturating_sub(window.planned_start_ns)) as f64 * 1e-3;
    let used = window
        .used_ns()
        .map_or_else(|| "not closed".to_owned(), |ns| format!("{:.1} µs used", ns as f64 * 1e-3));
    let used = if window.skipped { "skipped".to_owned() } else { used };
    format!("{}: {planned:.0} µs planned, {used}", window.partition)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn windows(lines: &[&str]) -> Vec<Window> {
        lines.iter().map(|line| Window::parse(line).unwrap()).collect()
    }

    #[test]
    fn frame_shows_used_skipped_and_late_windows_on_two_cores() {
        let windows = windows(&[
            "4,0,1,imu,400000000,400500000,400000000,400010000,400090000,",
            "4,0,2,command,400000000,402000000,,,,S",
            "4,1,1,imu,420000000,420500000,420100000,420110000,,LO",
        ]);
        let spans: Vec<Span> = ["command,slow,399999000,400002000", "imu,fa<st,420110000,420200000"]
            .iter()
            .map(|line| Span::parse(line).unwrap())
            .collect();
        let timeline = Timeline::major(&windows, &spans, Clock::Wall).unwrap();
        assert_eq!((timeline.from_ns, timeline.to_ns), (400_000_000, 440_000_000));
        let svg = timeline.svg(&[], 900.0);
        assert!(svg.contains("imu · core 1") && svg.contains("80.0 µs used"));
        assert!(svg.contains("· slow") && svg.contains("<title>fa&lt;st: 90.0 µs</title>"), "{svg}");
        assert!(svg.contains("planned skipped") && svg.contains("planned late") && svg.contains("used over"));
        let minor = Timeline::minor(&windows, &spans, Clock::Virtual).unwrap();
        assert_eq!((minor.windows.len(), minor.spans.len(), minor.lanes.len()), (2, 1, 3));
        assert!(minor.svg(&[], 900.0).contains("planned skipped"));
    }

    #[test]
    fn no_windows_no_timeline() {
        assert!(Timeline::major(&[], &[], Clock::Wall).is_none());
        let one = windows(&["0,0,1,imu,0,0,0,0,0,"]);
        assert!(Timeline::minor(&one, &[], Clock::Wall).is_none());
        assert!(!Timeline::major(&one, &[], Clock::Wall).unwrap().svg(&[], 900.0).contains("NaN"));
    }
}
