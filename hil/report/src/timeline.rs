//! The partitions' windows over time as a picture: planned as outlines, used time filled, one lane for each partition
//! of each core.

use crate::plot::{escape, ticks};
use crate::run::Clock;
use crate::windows::Window;
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
    lanes: Vec<(u32, &'a str)>,
    clock: Clock,
    from_ns: u64,
    to_ns: u64,
    minors_ns: Vec<u64>,
}

impl<'a> Timeline<'a> {
    /// The whole major frame; `None` without windows.
    pub fn major(windows: &'a [Window], clock: Clock) -> Option<Self> {
        let minors_ns = minor_starts(windows);
        let from_ns = *minors_ns.first()?;
        let period = minors_ns.get(1).map_or(0, |second| second - from_ns);
        let last_end = windows.iter().map(|window| window.planned_end_ns).max()?;
        let to_ns = last_end.max(from_ns + period * minors_ns.len() as u64);
        let title = format!("Windows of major frame {}", windows.first()?.frame);
        let windows: Vec<_> = windows.iter().collect();
        let lanes = lanes(&windows);
        Some(Self { title, windows, lanes, clock, from_ns, to_ns, minors_ns })
    }

    /// Its first minor frame alone, as a magnified view; `None` where the major frame has only one.
    pub fn minor(windows: &'a [Window], clock: Clock) -> Option<Self> {
        let minors_ns = minor_starts(windows);
        let (from_ns, to_ns) = (*minors_ns.first()?, *minors_ns.get(1)?);
        let title = "Its first minor frame".to_owned();
        let windows: Vec<_> = windows.iter().filter(|window| window.planned_start_ns < to_ns).collect();
        let lanes = lanes(&windows);
        Some(Self { title, windows, lanes, clock, from_ns, to_ns, minors_ns: vec![from_ns] })
    }

    /// The picture as an SVG element; it scales with the page.
    pub fn svg(&self, width: f64) -> String {
        let bottom = TOP + LANE * self.lanes.len() as f64;
        let height = bottom + BOTTOM;
        let mut out = String::new();
        let title = escape(&self.title);
        let _ = write!(out, r#"<svg viewBox="0 0 {width} {height}" role="img" aria-label="{title}">"#);
        let _ = write!(out, r#"<text class="title" x="{LEFT}" y="14">{title}</text>"#);
        self.draw_grid(&mut out, width, bottom);
        for (row, (core, partition)) in self.lanes.iter().enumerate() {
            let y = TOP + LANE * row as f64;
            let name = escape(&self.lane_name(*core, partition));
            let _ =
                write!(out, r#"<text class="tick end" x="{}" y="{}">{name}</text>"#, LEFT - 6.0, y + 12.5);
            let own = self
                .windows
                .iter()
                .filter(|window| (window.core, window.partition.as_str()) == (*core, partition));
            own.for_each(|window| self.draw_window(&mut out, window, width, y + 0.5 * (LANE - BAR)));
        }
        out.push_str("</svg>");
        out
    }

    fn lane_name(&self, core: u32, partition: &str) -> String {
        let alone = self.lanes.iter().all(|(other, _)| *other == core);
        if alone { partition.to_owned() } else { format!("{partition} · core {core}") }
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

    fn draw_window(&self, out: &mut String, window: &Window, width: f64, y: f64) {
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
        let _ = write!(out, r#"<rect class="{class}" x="{x:.2}" y="{y}" width="{wide:.2}" height="{BAR}">"#);
        let _ = write!(out, "<title>{}</title></rect>", escape(&described(window)));
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

fn lanes<'a>(windows: &[&'a Window]) -> Vec<(u32, &'a str)> {
    let mut lanes = Vec::new();
    for window in windows {
        let lane = (window.core, window.partition.as_str());
        if !lanes.contains(&lane) {
            lanes.push(lane);
        }
    }
    // By core; within one in the order of the schedule.
    lanes.sort_by_key(|(core, _)| *core);
    lanes
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
        let timeline = Timeline::major(&windows, Clock::Wall).unwrap();
        assert_eq!((timeline.from_ns, timeline.to_ns), (400_000_000, 440_000_000));
        let svg = timeline.svg(900.0);
        assert!(svg.contains("imu · core 1") && svg.contains("80.0 µs used"));
        assert!(svg.contains("planned skipped") && svg.contains("planned late") && svg.contains("used over"));
        let minor = Timeline::minor(&windows, Clock::Virtual).unwrap();
        assert_eq!(minor.windows.len(), 2);
        assert!(minor.svg(900.0).contains("planned skipped"));
    }

    #[test]
    fn no_windows_no_timeline() {
        assert!(Timeline::major(&[], Clock::Wall).is_none());
        let one = windows(&["0,0,1,imu,0,0,0,0,0,"]);
        assert!(Timeline::minor(&one, Clock::Wall).is_none());
        assert!(!Timeline::major(&one, Clock::Wall).unwrap().svg(900.0).contains("NaN"));
    }
}
