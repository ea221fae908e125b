//! The parts of the page, as the page takes them: by the names of their places. Figures are those of the report.

use std::fmt::Write as _;

use bateleur_control::PartitionStatus;
use bateleur_messages::State;
use bateleur_report::plot::{Chart, Place, Series, Style, escape};
use bateleur_report::timeline::Timeline;
use bateleur_report::windows::Window;

use crate::air::{speeds, wind};
use crate::scene::{MOST_LINES, Plot, Scene};

/// Windows of a partition that a row shows, most.
const ROW_WINDOWS: usize = 50;
/// Size of a row's picture, px.
const ROW: (f64, f64) = (150.0, 20.0);
/// Length of the line that shows where the aircraft flies to, s of its way.
const AHEAD_S: f64 = 5.0;
/// How far a degree of pitch moves the horizon, px.
const PITCH_PX: f64 = 2.0;
/// Names of the elements of an array.
const ELEMENTS: [&str; MOST_LINES] = ["[0]", "[1]", "[2]", "[3]", "[4]"];

/// All parts of a scene: place in the page, content.
pub(crate) fn parts(scene: &Scene) -> Vec<(&'static str, String)> {
    let state = scene.air.state.as_ref().map(|(_, state)| state);
    let frame = scene.frame();
    let frame_picture = Timeline::major(&frame, &[], scene.clock).map(|picture| picture.svg(&[], 980.0));
    let mut parts = vec![
        ("head", head(scene)),
        ("note", escape(&scene.note)),
        ("frame", frame_picture.unwrap_or_else(|| "No major frame is over yet.".into())),
        ("partitions", partitions(scene)),
        ("health", health(scene)),
        ("links", escape(&scene.links)),
        ("plot", plot(&scene.plot)),
    ];
    if let Some(state) = state {
        parts.extend([("map", map(scene)), ("horizon", horizon(state)), ("numbers", numbers(state))]);
    }
    parts
}

fn head(scene: &Scene) -> String {
    let mut out = format!("<b>{:.2} s</b>", scene.time_ns as f64 / 1e9);
    if let Some(status) = &scene.status {
        let next = status.next_schedule.as_ref().map(|next| format!(", then {next}")).unwrap_or_default();
        let _ = write!(
            out,
            " · schedule {}{} · {} windows, {} late, {} overruns, {} lost",
            escape(&status.schedule),
            escape(&next),
            status.windows,
            status.late_windows,
            status.window_overruns,
            status.lost_windows
        );
    }
    out
}

fn map(scene: &Scene) -> String {
    let at = |north: f64, east: f64| (east, north);
    let flown = scene.air.track.iter().map(|(_, north, east)| at(*north, *east)).collect();
    let planned =
        scene.waypoints.iter().chain(scene.waypoints.first()).map(|[north, east, _]| at(*north, *east));
    let places = scene.waypoints.iter().enumerate();
    let mut places: Vec<Place> = places
        .map(|(number, [north, east, _])| Place { at: at(*north, *east), label: format!("WP{number}") })
        .collect();
    let mut ahead = Vec::new();
    if let Some((_, state)) = &scene.air.state {
        let [north, east, _] = state.position_ned_m;
        let [to_north, to_east, _] = state.velocity_ned_mps.map(|speed| speed * AHEAD_S);
        ahead = vec![at(north, east), at(north + to_north, east + to_east)];
        places.push(Place { at: at(north, east), label: String::new() });
    }
    let line = |name, colour, style, points| Series { name, colour, style, points };
    let chart = Chart {
        title: "Map".into(),
        x_label: "east of the runway, m",
        y_label: "north, m".into(),
        series: vec![
            line("way-points", 3, Style::Dashed, planned.collect()),
            line("flown, as estimated", 1, Style::Line, flown),
            line("course", 0, Style::Line, ahead),
        ],
        places,
        equal: true,
        ..Chart::default()
    };
    chart.svg(560.0, 420.0)
}

/// An artificial horizon, and the wind beside it.
fn horizon(state: &State) -> String {
    let [roll, pitch, yaw] = state.euler_rad.map(f64::to_degrees);
    if !roll.is_finite() || !pitch.is_finite() {
        return String::new();
    }
    let down = (pitch * PITCH_PX).clamp(-80.0, 80.0);
    let (speed, from) = wind(state);
    let mut out = format!(
        "<svg viewBox=\"0 0 300 180\" role=\"img\" aria-label=\"Attitude: roll {roll:.0}°, pitch {pitch:.0}°, yaw {:.0}°\">\
         <clipPath id=\"round\"><circle cx=\"100\" cy=\"90\" r=\"80\"/></clipPath><g clip-path=\"url(#round)\">\
         <g transform=\"rotate({:.1} 100 90) translate(0 {down:.1})\">\
         <rect class=\"sky\" x=\"-60\" y=\"-160\" width=\"320\" height=\"250\"/>\
         <rect class=\"earth\" x=\"-60\" y=\"90\" width=\"320\" height=\"250\"/>",
        yaw.rem_euclid(360.0),
        -roll
    );
    for step in [-20.0, -10.0, 10.0, 20.0] {
        let y = 90.0 - step * PITCH_PX;
        let _ = write!(out, "<path class=\"rung\" d=\"M80 {y}h40\"/>");
    }
    out.push_str("</g></g><circle class=\"rim\" cx=\"100\" cy=\"90\" r=\"80\"/><path class=\"wings\" d=\"M50 90h30l8 8M150 90h-30l-8 8M100 90h.1\"/>");
    let _ = write!(
        out,
        "<text class=\"title\" x=\"200\" y=\"20\">Wind</text><g transform=\"translate(245 80) rotate({:.0})\">\
         <path class=\"wind\" d=\"M0 -34V34M-9 22L0 34L9 22\"/></g>\
         <text class=\"mid\" x=\"245\" y=\"146\">{speed:.1} m/s</text><text class=\"mid\" x=\"245\" y=\"162\">from {from:.0}°</text></svg>",
        from
    );
    out
}

fn numbers(state: &State) -> String {
    let [air, ground, climb] = speeds(state);
    let [roll, pitch, yaw] = state.euler_rad.map(f64::to_degrees);
    let rows = [
        ("airspeed", air, "m/s"),
        ("ground speed", ground, "m/s"),
        ("height", -state.position_ned_m[2], "m"),
        ("climb", climb, "m/s"),
        ("roll", roll, "°"),
        ("pitch", pitch, "°"),
        ("heading", yaw.rem_euclid(360.0), "°"),
    ];
    let mut out = String::new();
    for (name, value, unit) in rows {
        let text = format!("{value:.1}");
        let text = if text == "-0.0" { "0.0" } else { &text };
        let _ = write!(out, "<div><small>{name}</small><b>{text}</b><small>{unit}</small></div>");
    }
    out
}

fn partitions(scene: &Scene) -> String {
    let by_name = scene.by_partition();
    let status = scene.status.as_ref().map(|status| status.partitions.as_slice()).unwrap_or_default();
    let names: Vec<&str> = match status {
        [] => by_name.keys().copied().collect(),
        all => all.iter().map(|one| one.name.as_str()).collect(),
    };
    let mut out = String::from(
        "<table class=\"wide\"><thead><tr><th>partition</th><th>state</th><th>restarts</th><th>use of the last windows</th>\
         <th>mean</th><th>most</th><th>latest, µs</th><th>last fault</th></tr></thead><tbody>",
    );
    for name in names {
        let said = status.iter().find(|one| one.name == name);
        row(&mut out, name, said, by_name.get(name).map(Vec::as_slice).unwrap_or_default());
    }
    out.push_str("</tbody></table>");
    out
}

fn row(out: &mut String, name: &str, said: Option<&PartitionStatus>, windows: &[&Window]) {
    let windows = &windows[windows.len().saturating_sub(ROW_WINDOWS)..];
    let absent = windows.last().is_some_and(|window| window.skipped);
    let mode = said.map_or(if absent { "absent" } else { "normal" }, |said| said.mode.as_str());
    let class = if mode == "normal" { "good" } else { "bad" };
    let uses: Vec<f64> = windows.iter().filter_map(|window| share(window)).collect();
    let mean = uses.iter().sum::<f64>() / uses.len().max(1) as f64;
    let most = uses.iter().copied().fold(0.0, f64::max);
    let lateness =
        windows.iter().filter_map(|one| Some(one.granted_ns?.saturating_sub(one.planned_start_ns)));
    let latest = lateness.max().map_or_else(String::new, |ns| format!("{:.0}", ns as f64 / 1e3));
    let restarts = said.map_or_else(String::new, |said| said.restarts.to_string());
    let fault = said.and_then(|said| said.last_fault.as_ref());
    let fault = fault.map_or_else(String::new, |fault| {
        format!("{} at {:.1} s → {}", fault.error, fault.time_ns as f64 / 1e9, fault.action)
    });
    let (name, mode, fault) = (escape(name), escape(mode), escape(&fault));
    let _ = write!(
        out,
        "<tr data-partition=\"{name}\"><td>{name}</td><td class=\"{class}\">{mode}</td><td>{restarts}</td><td>{}</td>\
         <td>{:.0} %</td><td>{:.0} %</td><td>{latest}</td><td>{fault}</td></tr>",
        bars(windows),
        100.0 * mean,
        100.0 * most
    );
}

/// The part of a window that was used.
fn share(window: &Window) -> Option<f64> {
    let planned =
        window.planned_end_ns.checked_sub(window.planned_start_ns).filter(|planned| *planned > 0)?;
    Some((window.used_ns()? as f64 / planned as f64).min(1.0))
}

/// A bar for each window, the newest on the right.
fn bars(windows: &[&Window]) -> String {
    let (width, height) = ROW;
    let step = width / ROW_WINDOWS as f64;
    let mut out = format!("<svg class=\"bars\" viewBox=\"0 0 {width} {height}\" aria-hidden=\"true\">");
    for (place, window) in windows.iter().enumerate() {
        let x = width - step * (windows.len() - place) as f64;
        let part = if window.skipped { 1.0 } else { share(window).unwrap_or(1.0).max(0.05) };
        let class = match (window.skipped, window.overrun, window.late) {
            (true, ..) => "absent",
            (_, true, _) => "over",
            (.., true) => "was-late",
            _ => "used",
        };
        let high = part * height;
        let _ = write!(
            out,
            "<rect class=\"{class}\" x=\"{x:.1}\" y=\"{:.1}\" width=\"{:.1}\" height=\"{high:.1}\"/>",
            height - high,
            step - 0.6
        );
    }
    out.push_str("</svg>");
    out
}

/// The newest first.
fn health(scene: &Scene) -> String {
    let mut out = String::new();
    for entry in scene.health.iter().rev() {
        let whom = entry.partition.as_deref().unwrap_or("the module");
        let back = entry.recovered_ns.map(|back| back.saturating_sub(entry.time_ns) as f64 / 1e6);
        let back = back.map_or_else(String::new, |ms| format!(", back after {ms:.1} ms"));
        let class = if entry.acted_on() { "" } else { " class=\"sub\"" };
        let words = format!(
            "{:.3} s  {whom}: {} ({}) → {}{back}",
            entry.time_ns as f64 / 1e9,
            entry.error,
            entry.detail,
            entry.action
        );
        let _ = write!(out, "<li{class}>{}</li>", escape(&words));
    }
    if out.is_empty() { "<li class=\"sub\">Nothing was noted.</li>".into() } else { out }
}

fn plot(plot: &Plot) -> String {
    let style = Style::Line;
    let line = |(place, points): (usize, &Vec<(f64, f64)>)| {
        let name = if plot.lines.len() > 1 { ELEMENTS[place % MOST_LINES] } else { "value" };
        Series { name, colour: place as u8, style, points: points.clone() }
    };
    let chart = Chart {
        title: plot.title.clone(),
        y_label: plot.unit.clone().into(),
        x_label: "module time, s",
        series: plot.lines.iter().take(MOST_LINES).enumerate().map(line).collect(),
        ..Chart::default()
    };
    chart.svg(560.0, 220.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_report::health::HealthEntry;

    fn scene() -> Scene {
        let lines = [
            "0,0,1,imu,0,500000,0,10000,260000,,240000,flight",
            "1,0,1,imu,100000000,100500000,,,,S,,flight",
            "2,0,1,imu,200000000,200500000,200007000,200010000,200260000,,240000,flight",
        ];
        let windows = lines.iter().map(|line| Window::parse(line).unwrap()).collect();
        Scene { windows, ..Scene::default() }
    }

    fn part(scene: &Scene, name: &str) -> String {
        parts(scene).into_iter().find(|(known, _)| *known == name).unwrap().1
    }

    #[test]
    fn last_frame_that_is_over_is_drawn_and_each_partition_with_its_use_and_lateness() {
        let scene = scene();
        assert_eq!(scene.frame()[0].frame, 1);
        let rows = part(&scene, "partitions");
        for text in ["data-partition=\"imu\"", "50 %", "<td>7</td>", "class=\"absent\""] {
            assert!(rows.contains(text), "{text} is not in {rows}");
        }
        assert!(
            !parts(&scene).iter().any(|(name, _)| *name == "map"),
            "a module that does not fly has no map"
        );
    }

    #[test]
    fn names_of_a_plan_are_text_and_never_markup() {
        let mut scene = scene();
        let evil = "<img src=x onerror=alert(1)>";
        scene.windows.iter_mut().for_each(|window| window.partition = evil.into());
        scene.health.push(HealthEntry {
            time_ns: 1,
            partition: Some(evil.into()),
            generation: 1,
            error: evil.into(),
            action: evil.into(),
            detail: evil.into(),
            recovered_ns: None,
        });
        (scene.links, scene.note, scene.plot.title) = (evil.into(), evil.into(), evil.into());
        for (name, text) in parts(&scene) {
            assert!(!text.contains("<img"), "{name}: {text}");
        }
    }

    #[test]
    fn states_that_are_no_numbers_draw_no_strange_figures() {
        let mut scene = scene();
        let none = [f64::NAN; 3];
        let state = State {
            euler_rad: none,
            position_ned_m: none,
            velocity_ned_mps: none,
            status: 3,
            ..State::default()
        };
        scene.air.add(1, state);
        assert!(!part(&scene, "map").contains("NaN") && part(&scene, "horizon").is_empty());
    }
}
