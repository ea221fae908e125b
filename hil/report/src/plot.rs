//! Charts as SVG text: axes with round numbers, several series, marks. Colours come from the page's style, so that one
//! chart reads well on light and dark. A chart carries its axes as data, from which the page's script zooms it.

use crate::reasons::linked;
use std::borrow::Cow;
use std::fmt::Write as _;

/// Most points drawn of one series: a few for each column of a screen, so that a magnified chart shows something new, and a flight's page
/// stays below 2 MB.
pub const MOST_POINTS: usize = 3000;
/// Space left of the plot for the numbers, px.
const LEFT: f64 = 54.0;
/// Space right of it, px.
const RIGHT: f64 = 12.0;
/// Space above it for title and legend, px.
const TOP: f64 = 44.0;
/// Space below it for the numbers and the axis' name, px.
const BOTTOM: f64 = 36.0;
/// Width of a letter of the legend, px: an estimate that suits common sans-serif faces at 11 px.
const LETTER: f64 = 6.6;
/// Part of the range left empty above and below the data; as in page.js.
const MARGIN: f64 = 0.06;
/// Steps of a curve in a pixel: the page's script reads values from them, and a magnified curve shows them. As in page.js, and
/// in the transformation of `curves`.
const STEPS: f64 = 100.0;
/// Labels of marks nearer than this to the last one are left out, px.
const MARK_SPACE: f64 = 46.0;

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Style {
    /// A line.
    Line,
    /// A dashed line behind the others.
    Dashed,
    /// A line that keeps its value until the next point.
    Steps,
    /// Dots.
    Dots,
}

/// A series of points. A point that is not finite interrupts the line.
#[derive(Debug, Clone)]
pub struct Series {
    /// For the legend.
    pub name: &'static str,
    /// Which of the page's colours, from 0.
    pub colour: u8,
    /// How it is drawn.
    pub style: Style,
    /// The points.
    pub points: Vec<(f64, f64)>,
}

/// Something that happened, drawn as an upright line.
#[derive(Debug, Clone)]
pub struct Mark {
    /// Where.
    pub x: f64,
    /// What.
    pub label: String,
    /// The place in the page that tells more of it.
    pub anchor: Option<String>,
}

/// A named place, drawn as a ring.
#[derive(Debug, Clone)]
pub struct Place {
    /// Where.
    pub at: (f64, f64),
    /// What.
    pub label: String,
}

/// A chart.
#[derive(Debug, Clone, Default)]
pub struct Chart {
    /// Above it.
    pub title: String,
    /// Name and unit of the horizontal axis.
    pub x_label: &'static str,
    /// Unit of the vertical axis, and after a comma what else there is to say of it; stands after the title.
    pub y_label: Cow<'static, str>,
    /// The data.
    pub series: Vec<Series>,
    /// Upright lines.
    pub marks: Vec<Mark>,
    /// Rings.
    pub places: Vec<Place>,
    /// One metre is as long in both directions.
    pub equal: bool,
    /// Least height of the vertical range, so that noise on a constant does not fill the chart.
    pub least_range: f64,
}

/// The mapping from values to pixels.
#[derive(Debug, Clone, Copy)]
struct Axes {
    x: Axis,
    y: Axis,
}

#[derive(Debug, Clone, Copy)]
struct Axis {
    from: f64,
    to: f64,
    start_px: f64,
    end_px: f64,
}

impl Axis {
    fn px(&self, value: f64) -> f64 {
        self.start_px + (value - self.from) / (self.to - self.from) * (self.end_px - self.start_px)
    }

    /// Widens the range so that a unit takes as few pixels as `px_per_unit`.
    fn widened(self, px_per_unit: f64) -> Self {
        let range = (self.end_px - self.start_px).abs() / px_per_unit;
        let middle = 0.5 * (self.from + self.to);
        Self { from: middle - 0.5 * range, to: middle + 0.5 * range, ..self }
    }

    fn px_per_unit(&self) -> f64 {
        (self.end_px - self.start_px).abs() / (self.to - self.from)
    }
}

impl Chart {
    /// The chart as an SVG element of `width` × `height` px; it scales with the page.
    pub fn svg(&self, width: f64, height: f64) -> String {
        let mut out = String::new();
        let title = escape(&self.title);
        let axes = self.axes(width, height);
        let data = axes.map_or_else(String::new, |axes| self.data(&axes));
        let _ = write!(out, r#"<svg viewBox="0 0 {width} {height}" role="img" aria-label="{title}"{data}>"#);
        let unit = escape(&self.y_label);
        let _ = write!(
            out,
            r#"<text class="title" x="{LEFT}" y="14">{title} <tspan class="unit">{unit}</tspan></text>"#
        );
        match axes {
            Some(axes) => self.draw(&mut out, &axes),
            None => {
                let _ = write!(
                    out,
                    r#"<text class="empty" x="{}" y="{}">no data</text>"#,
                    width / 2.0,
                    height / 2.0
                );
            }
        }
        out.push_str("</svg>");
        out
    }

    /// What the page's script has to know.
    fn data(&self, axes: &Axes) -> String {
        let (x, y) = (axes.x, axes.y);
        let across = Across { label: self.x_label, from: x.from, to: x.to };
        // Of a map both axes have names, and one scale.
        let label = match self.equal {
            true => format!(r#"data-map="{}""#, escape(&self.y_label)),
            false => format!(r#"data-unit="{}""#, escape(self.y_label.split(',').next().unwrap_or_default())),
        };
        let plot = across.data([x.start_px, y.end_px, x.end_px, y.start_px]);
        format!(r#"{plot} data-y="{} {}" data-least="{}" {label}"#, y.from, y.to, self.least_range)
    }

    fn draw(&self, out: &mut String, axes: &Axes) {
        self.draw_grid(out, axes);
        self.draw_legend(out);
        out.push_str(r#"<g class="data"><g class="curves" transform="scale(.01)">"#);
        for series in &self.series {
            draw_series(out, axes, series, self.equal);
        }
        out.push_str("</g>");
        self.draw_marks(out, axes);
        for place in &self.places {
            let (x, y) = (axes.x.px(place.at.0), axes.y.px(place.at.1));
            let label = escape(&place.label);
            let _ = write!(out, r#"<g data-at="{}" data-up="{}">"#, place.at.0, place.at.1);
            let _ = write!(out, r#"<circle class="place" cx="{x:.1}" cy="{y:.1}" r="4" />"#);
            let _ =
                write!(out, r#"<text class="label" x="{:.1}" y="{:.1}">{label}</text>"#, x + 7.0, y - 6.0);
            out.push_str("</g>");
        }
        out.push_str("</g>");
    }

    /// The axes that hold all data; `None` without any.
    fn axes(&self, width: f64, height: f64) -> Option<Axes> {
        let places = self.places.iter().map(|place| place.at);
        let points = self.series.iter().flat_map(|series| series.points.iter().copied()).chain(places);
        let finite: Vec<_> = points.filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
        let x = range(finite.iter().map(|(x, _)| *x), 0.0, if self.equal { MARGIN } else { 0.0 })?;
        let y = range(finite.iter().map(|(_, y)| *y), self.least_range, MARGIN)?;
        let x = Axis { from: x.0, to: x.1, start_px: LEFT, end_px: width - RIGHT };
        let y = Axis { from: y.0, to: y.1, start_px: height - BOTTOM, end_px: TOP };
        if !self.equal {
            return Some(Axes { x, y });
        }
        let scale = x.px_per_unit().min(y.px_per_unit());
        Some(Axes { x: x.widened(scale), y: y.widened(scale) })
    }

    fn draw_grid(&self, out: &mut String, axes: &Axes) {
        let (left, right) = (axes.x.start_px, axes.x.end_px);
        let (bottom, top) = (axes.y.start_px, axes.y.end_px);
        let across = Across { label: self.x_label, from: axes.x.from, to: axes.x.to };
        across.draw(out, [left, top, right, bottom], 62.0);
        out.push_str(r#"<g class="up">"#);
        for (value, text) in ticks(axes.y.from, axes.y.to, (bottom - top) / 30.0) {
            let y = axes.y.px(value);
            let _ = write!(out, r#"<line class="grid" x1="{left}" y1="{y:.1}" x2="{right}" y2="{y:.1}" />"#);
            let _ =
                write!(out, r#"<text class="tick end" x="{}" y="{:.1}">{text}</text>"#, left - 5.0, y + 3.5);
        }
        let (wide, high) = (right - left, bottom - top);
        let _ =
            write!(out, r#"</g><rect class="frame" x="{left}" y="{top}" width="{wide}" height="{high}" />"#);
    }

    fn draw_legend(&self, out: &mut String) {
        let mut x = LEFT;
        for series in self.series.iter().filter(|series| !series.points.is_empty()) {
            let class = class(series);
            if series.style == Style::Dots {
                let _ = write!(out, r#"<circle class="{class}" cx="{:.1}" cy="30" r="2.5" />"#, x + 8.0);
            } else {
                let _ = write!(out, r#"<path class="{class}" d="M{x:.1} 30h16" />"#);
            }
            let name = escape(series.name);
            let _ = write!(out, r#"<text class="legend" x="{:.1}" y="33.5">{name}</text>"#, x + 20.0);
            x += 34.0 + LETTER * series.name.chars().count() as f64;
        }
    }

    fn draw_marks(&self, out: &mut String, axes: &Axes) {
        let mut last = f64::NEG_INFINITY;
        let inside = |mark: &&Mark| (axes.x.from..=axes.x.to).contains(&mark.x);
        for mark in self.marks.iter().filter(inside) {
            let x = axes.x.px(mark.x);
            let (top, bottom) = (axes.y.end_px, axes.y.start_px);
            let _ = write!(out, r#"<g data-at="{}">"#, mark.x);
            let _ = write!(out, r#"<line class="mark" x1="{x:.1}" y1="{top}" x2="{x:.1}" y2="{bottom}" />"#);
            if x - last > MARK_SPACE {
                let text = format!(
                    r#"<text class="mark-label" x="{:.1}" y="{}">{}</text>"#,
                    x + 3.0,
                    top + 10.0,
                    escape(&mark.label)
                );
                out.push_str(&linked(mark.anchor.as_deref(), &text));
                last = x;
            }
            out.push_str("</g>");
        }
    }
}

fn class(series: &Series) -> String {
    let kind = match series.style {
        Style::Line | Style::Steps => "line",
        Style::Dashed => "line dashed",
        Style::Dots => "dots",
    };
    format!("{kind} c{}", series.colour)
}

fn draw_series(out: &mut String, axes: &Axes, series: &Series, by_stride: bool) {
    let points = if by_stride { strided(&series.points) } else { decimated(&series.points) };
    let mut pen = Pen::default();
    for (x, y) in points {
        if !x.is_finite() || !y.is_finite() {
            pen.is_down = false;
            continue;
        }
        let to = [axes.x.px(x), axes.y.px(y)].map(|px| (px * STEPS).round() as i64);
        match series.style {
            Style::Dots => {
                pen.is_down = false;
                pen.go(to);
            }
            Style::Steps if pen.is_down => pen.go([to[0], pen.at[1]]),
            _ => {}
        }
        pen.go(to);
    }
    if !pen.path.is_empty() {
        let (class, name) = (class(series), escape(series.name));
        let _ = write!(out, r#"<path class="{class}" data-name="{name}" d="{}" />"#, pen.path);
    }
}

/// Writes a path in whole steps, each from the place before: that is short, and a page has a hundred thousand of them. A
/// stretch begins with `m` and its place, and goes on in pairs of numbers.
#[derive(Default)]
struct Pen {
    path: String,
    at: [i64; 2],
    is_down: bool,
}

impl Pen {
    fn go(&mut self, to: [i64; 2]) {
        let mut before = if self.is_down { " " } else { "m" };
        for (to, at) in to.into_iter().zip(self.at) {
            let step = to - at;
            // A sign separates numbers as well as a space does.
            let _ = write!(self.path, "{}{step}", if step < 0 && before == " " { "" } else { before });
            before = " ";
        }
        (self.at, self.is_down) = (to, true);
    }
}

/// The horizontal axis of a picture, between the edges of its plot: left, top, right, bottom, px.
pub(crate) struct Across<'a> {
    /// Name and unit. Pictures with the same one zoom together.
    pub(crate) label: &'a str,
    pub(crate) from: f64,
    pub(crate) to: f64,
}

impl Across<'_> {
    /// What the page's script has to know.
    pub(crate) fn data(&self, [left, top, right, bottom]: [f64; 4]) -> String {
        let Self { label, from, to } = self;
        let label = escape(label);
        format!(r#" data-axis="{label}" data-x="{from} {to}" data-plot="{left} {top} {right} {bottom}""#)
    }

    /// Grid, numbers and name; a number about every `apart` px.
    pub(crate) fn draw(&self, out: &mut String, [left, top, right, bottom]: [f64; 4], apart: f64) {
        let axis = Axis { from: self.from, to: self.to, start_px: left, end_px: right };
        out.push_str(r#"<g class="across">"#);
        for (value, text) in ticks(self.from, self.to, (right - left) / apart) {
            let x = axis.px(value);
            let _ = write!(out, r#"<line class="grid" x1="{x:.1}" y1="{top}" x2="{x:.1}" y2="{bottom}" />"#);
            let _ = write!(out, r#"<text class="tick mid" x="{x:.1}" y="{}">{text}</text>"#, bottom + 14.0);
        }
        let (label, y) = (escape(self.label), bottom + 29.0);
        let _ = write!(out, r#"</g><text class="axis end" x="{right}" y="{y}">{label}</text>"#);
    }
}

/// At most [`MOST_POINTS`] points of a series over time, least and greatest of each stretch, so that no peak is lost.
pub fn decimated(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    if points.len() <= MOST_POINTS {
        return points.to_vec();
    }
    let stretch = points.len().div_ceil(MOST_POINTS / 2);
    let mut kept = Vec::with_capacity(MOST_POINTS);
    for chunk in points.chunks(stretch) {
        let by_height = |a: &usize, b: &usize| chunk[*a].1.total_cmp(&chunk[*b].1);
        let least = (0..chunk.len()).min_by(by_height).unwrap_or(0);
        let greatest = (0..chunk.len()).max_by(by_height).unwrap_or(0);
        kept.push(chunk[least.min(greatest)]);
        if least != greatest {
            kept.push(chunk[least.max(greatest)]);
        }
    }
    kept
}

/// At most [`MOST_POINTS`] points of a track, evenly.
fn strided(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let stride = points.len().div_ceil(MOST_POINTS - 1).max(1);
    let mut kept: Vec<_> = points.iter().step_by(stride).copied().collect();
    if points.len() % stride != 1 && stride > 1 {
        kept.extend(points.last());
    }
    kept
}

/// The range of values with a margin; `None` without any.
fn range(values: impl Iterator<Item = f64>, least: f64, margin: f64) -> Option<(f64, f64)> {
    let (low, high) = values.fold(None, |range, value| match range {
        None => Some((value, value)),
        Some((low, high)) => Some((f64::min(low, value), f64::max(high, value))),
    })?;
    let middle = 0.5 * (low + high);
    // A range too small for its numbers to differ would divide by nothing.
    let least = least.max(1e-6 * middle.abs()).max(1e-9);
    let half = (0.5 * (high - low)).max(0.5 * least) * (1.0 + 2.0 * margin);
    Some((middle - half, middle + half))
}

/// Round numbers (1, 2 or 5 times a power of ten apart) from `from` to `to`, about `wanted` of them, with their texts.
pub fn ticks(from: f64, to: f64, wanted: f64) -> Vec<(f64, String)> {
    let rough = (to - from) / wanted.max(1.0);
    if !rough.is_finite() || rough <= 0.0 {
        return Vec::new();
    }
    let power = 10f64.powf(rough.log10().floor());
    let factor =
        [1.0, 2.0, 5.0, 10.0].into_iter().find(|factor| factor * power >= rough * 0.999).unwrap_or(10.0);
    let step = factor * power;
    let decimals = (-step.log10().floor()).clamp(0.0, 9.0) as usize;
    let first = (from / step - 1e-9).ceil() as i64;
    let last = (to / step + 1e-9).floor() as i64;
    let text = |value: f64| format!("{value:.decimals$}").replace('-', "−");
    // Adding zero turns a negative zero into zero.
    (first..=last).map(|i| i as f64 * step + 0.0).map(|value| (value, text(value))).collect()
}

/// Text as it may stand in HTML and SVG, in attributes too.
pub fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\'' => out.push_str("&#39;"),
            // Control characters are not allowed in a page at all.
            letter if letter.is_control() => out.push(' '),
            letter => out.push(letter),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn texts(from: f64, to: f64, wanted: f64) -> Vec<String> {
        ticks(from, to, wanted).into_iter().map(|(_, text)| text).collect()
    }

    #[test]
    fn ticks_are_round() {
        assert_eq!(texts(0.0, 200.0, 5.0), ["0", "50", "100", "150", "200"]);
        assert_eq!(texts(-0.3, 0.31, 4.0), ["−0.2", "0.0", "0.2"]);
        assert_eq!(texts(21.93, 22.08, 3.0), ["21.95", "22.00", "22.05"]);
        assert!(ticks(1.0, 1.0, 5.0).is_empty() && ticks(0.0, f64::NAN, 5.0).is_empty());
    }

    #[test]
    fn decimation_keeps_the_peak_and_the_order() {
        let points: Vec<_> =
            (0..100_000).map(|i| (f64::from(i), if i == 54_321 { 9.0 } else { 0.0 })).collect();
        let kept = decimated(&points);
        assert!(kept.len() <= MOST_POINTS && kept.contains(&(54_321.0, 9.0)));
        assert!(kept.windows(2).all(|pair| pair[0].0 < pair[1].0));
        let track = strided(&points);
        assert!(track.len() <= MOST_POINTS && track.last() == points.last());
        assert_eq!(strided(&points[..7]), &points[..7]);
        assert!(decimated(&[]).is_empty() && strided(&[]).is_empty());
    }

    fn chart(points: Vec<(f64, f64)>, style: Style) -> Chart {
        Chart { series: vec![Series { name: "a<b", colour: 0, style, points }], ..Default::default() }
    }

    #[test]
    fn nothing_that_is_not_a_number_reaches_the_picture() {
        let odd = vec![(0.0, 1.0), (1.0, f64::NAN), (2.0, f64::INFINITY), (3.0, 1.0), (f64::NAN, 0.0)];
        for style in [Style::Line, Style::Dots, Style::Steps, Style::Dashed] {
            let svg = chart(odd.clone(), style).svg(400.0, 200.0);
            assert!(!svg.contains("NaN") && !svg.contains("inf"), "{svg}");
            assert!(svg.contains("a&lt;b") && svg.matches(r#" d="m"#).count() == 1, "{svg}");
        }
        let single = Chart { equal: true, ..chart(vec![(5.0, 5.0)], Style::Line) };
        assert!(!single.svg(400.0, 200.0).contains("NaN"));
        assert!(chart(vec![], Style::Line).svg(400.0, 200.0).contains("no data"));
        assert!(chart(vec![(f64::NAN, 0.0)], Style::Line).svg(400.0, 200.0).contains("no data"));
    }

    #[test]
    fn curve_is_written_in_steps_from_the_place_before() {
        let drawn = |style, places: &[[i64; 2]]| {
            let axis = Axis { from: 0.0, to: 1.0, start_px: 0.0, end_px: 1.0 };
            let points =
                places.iter().map(|place| place.map(|step| step as f64 / STEPS)).map(<(f64, f64)>::from);
            let gap = |(x, y): (f64, f64)| if x < 0.0 { (x, f64::NAN) } else { (x, y) };
            let series = Series { name: "a", colour: 0, style, points: points.map(gap).collect() };
            let mut out = String::new();
            draw_series(&mut out, &Axes { x: axis, y: axis }, &series, false);
            out.split('"').nth(5).unwrap_or_default().to_owned()
        };
        let places = [[5, 9], [7, 4], [-1, 0], [8, 4], [9, 6]];
        assert_eq!(drawn(Style::Line, &places), "m5 9 2-5m1 0 1 2");
        assert_eq!(drawn(Style::Steps, &places), "m5 9 2 0 0-5m1 0 1 0 0 2");
        assert_eq!(drawn(Style::Dots, &places[..2]), "m5 9 0 0m2-5 0 0");
    }

    #[test]
    fn script_of_the_page_reads_curves_as_they_are_written() {
        for constant in [format!("const STEPS = {STEPS};"), format!("const MARGIN = {MARGIN};")] {
            assert!(crate::html::SCRIPT.contains(&constant), "{constant}");
        }
        let svg = chart(vec![(0.0, 0.0), (9.0, 2.0)], Style::Line).svg(400.0, 200.0);
        assert!(
            svg.contains(&format!(r#"transform="scale({})""#, STEPS.recip()).replace("0.", ".")),
            "{svg}"
        );
    }

    #[test]
    fn charts_and_maps_say_how_they_are_zoomed() {
        let chart = Chart {
            x_label: "time, s",
            y_label: "°, right positive".into(),
            ..chart(vec![(0.0, 0.0), (9.0, 2.0)], Style::Line)
        };
        let svg = chart.svg(400.0, 200.0);
        let data = r#"data-axis="time, s" data-x="0 9" data-plot="54 44 388 164" data-y="-0.12"#;
        assert!(svg.contains(data) && svg.contains(r#"data-unit="°""#), "{svg}");
        let map = Chart { equal: true, y_label: "north, m".into(), ..chart }.svg(400.0, 400.0);
        assert!(map.contains(r#"data-map="north, m""#), "{map}");
    }

    #[test]
    fn equal_axes_have_one_scale() {
        let chart = Chart { equal: true, ..chart(vec![(0.0, 0.0), (100.0, 10.0)], Style::Line) };
        let axes = chart.axes(500.0, 500.0).unwrap();
        assert!((axes.x.px_per_unit() - axes.y.px_per_unit()).abs() < 1e-9);
        assert!(axes.y.px(10.0) > TOP && axes.x.px(100.0) <= 500.0);
    }
}
