//! What a mission is: way-points, laps, limits.

use bateleur_messages::ground::{Step, Waypoint};
use serde::Deserialize;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Most way-points of a mission: as many as the Controller holds.
pub const MOST_WAYPOINTS: usize = 32;

/// A mission, checked.
#[derive(Debug, Clone, PartialEq)]
pub struct MissionPlan {
    /// The way-points in order; index and count fit the list.
    pub waypoints: Vec<Waypoint>,
    /// Laps to fly; the last ends with the return to the first way-point.
    pub laps: u32,
    /// Height above the runway at which the autopilot is engaged, m.
    pub engage_altitude_m: f64,
    /// The autopilot takes off by itself, instead of the safety pilot.
    pub own_take_off: bool,
    /// The aircraft lands after the laps; otherwise the mission ends in flight.
    pub landing: bool,
    /// Flight after the last way-point before the mission ends, s.
    pub loiter_s: f64,
    /// Longest time from the first step to the end, s.
    pub time_limit_s: f64,
}

/// Why a mission was refused.
#[derive(Debug, Error)]
pub enum PlanError {
    /// The file cannot be read.
    #[error("cannot read the mission {}: {error}", path.display())]
    Unreadable {
        /// The file.
        path: PathBuf,
        /// What the system said.
        error: std::io::Error,
    },
    /// What is wrong with the text of a file.
    #[error("{}: {wrong}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        wrong: Box<PlanError>,
    },
    /// The text is a mission of QGroundControl's.
    #[error(
        "this is a mission of QGroundControl's, and not TOML: load it from there by MAVLink (docs/src/mavlink.md), or \
         write its way-points as `[[waypoint]]` (docs/src/ground.md)"
    )]
    QGroundControl,
    /// Two way-points in a row are at the same place, or nearly.
    #[error(
        "way-point {first} (north {} m, east {} m) and way-point {second} (north {} m, east {} m) follow each other, and \
         are {:.1} m apart on the map; it must be {nearest} m or more (the track is closed: the first follows the \
         last): move one, or leave it out",
        points[0].north_m, points[0].east_m, points[1].north_m, points[1].east_m, points[0].distance_m(&points[1]),
        nearest = Waypoint::NEAREST_M
    )]
    Near {
        /// The one.
        first: usize,
        /// The other.
        second: usize,
        /// Both.
        points: Box<[Waypoint; 2]>,
    },
    /// The text is no mission.
    #[error("line {line}, column {column}: {message}")]
    Syntax {
        /// From 1.
        line: usize,
        /// From 1.
        column: usize,
        /// What is wrong, and how to mend it.
        message: String,
    },
    /// The list of way-points is empty or too long.
    #[error("the mission has {0} way-points; it must have 1 to {MOST_WAYPOINTS}")]
    Waypoints(usize),
    /// A jump to a way-point that is not there, or back to itself.
    #[error("way-point {of} jumps to way-point {to}, and there is none: give 0 to {last}")]
    Jump {
        /// Which one.
        of: usize,
        /// Where to.
        to: usize,
        /// The last there is.
        last: usize,
    },
    /// More is flown than a mission of this program holds.
    #[error("the mission's jumps make more than {MOST_PASSED} way-points to fly to")]
    Long,
    /// A circle says nothing, or too much, of when it is left.
    #[error(
        "way-point {0} circles for `turns`, or for `seconds`, or until (`until = \"altitude\"`, `\"order\"`): give one of them"
    )]
    Circle(usize),
    /// A value is outside its range.
    #[error("the mission's {what} is {}, but it must be {demand}", short(*value))]
    Value {
        /// Which one.
        what: String,
        /// The value.
        value: f64,
        /// What it must be.
        demand: &'static str,
    },
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawPlan {
    #[serde(default = "laps")]
    laps: i64,
    #[serde(default = "engage_altitude_m")]
    engage_altitude_m: f64,
    #[serde(default)]
    take_off: TakeOff,
    #[serde(default)]
    landing: bool,
    #[serde(default = "loiter_s")]
    loiter_s: f64,
    #[serde(default = "time_limit_s")]
    time_limit_s: f64,
    waypoint: Vec<RawWaypoint>,
}

/// Who takes off.
#[derive(Debug, Default, PartialEq, Deserialize)]
#[serde(rename_all = "lowercase")]
enum TakeOff {
    #[default]
    Pilot,
    Autopilot,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawWaypoint {
    north_m: f64,
    east_m: f64,
    altitude_m: f64,
    #[serde(default)]
    heading_deg: f64,
    #[serde(default = "airspeed_mps")]
    airspeed_mps: f64,
    circle: Option<RawCircle>,
    jump: Option<RawJump>,
}

/// Circles about a way-point.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawCircle {
    turns: Option<f64>,
    seconds: Option<f64>,
    until: Option<Until>,
    #[serde(default)]
    radius_m: f64,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Until {
    Altitude,
    Order,
}

/// What comes after a way-point.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawJump {
    to: usize,
    #[serde(default = "once")]
    times: u16,
}

fn once() -> u16 {
    1
}

fn laps() -> i64 {
    2
}

fn engage_altitude_m() -> f64 {
    60.0
}

fn loiter_s() -> f64 {
    3.0
}

fn time_limit_s() -> f64 {
    600.0
}

fn airspeed_mps() -> f64 {
    22.0
}

impl MissionPlan {
    /// Two laps of the thesis' square: 500 m, 160 m above the runway, 22 m/s.
    pub fn thesis() -> Self {
        let corners = [(500.0, 0.0, 0.0), (500.0, 500.0, 0.0), (0.0, 500.0, 180.0), (0.0, 0.0, 270.0_f64)];
        let waypoint = |(index, (north_m, east_m, heading)): (usize, (f64, f64, f64))| Waypoint {
            index: index as u8,
            count: corners.len() as u8,
            north_m,
            east_m,
            altitude_m: 160.0,
            heading_rad: heading.to_radians(),
            airspeed_mps: airspeed_mps(),
            step: Step::Pass,
        };
        Self {
            waypoints: corners.into_iter().enumerate().map(waypoint).collect(),
            laps: laps() as u32,
            engage_altitude_m: engage_altitude_m(),
            own_take_off: false,
            landing: false,
            loiter_s: loiter_s(),
            time_limit_s: time_limit_s(),
        }
    }

    /// Reads and checks a mission from a TOML file.
    ///
    /// # Errors
    /// When it cannot be read or is no mission.
    pub fn from_file(path: &Path) -> Result<Self, PlanError> {
        let unreadable = |error| PlanError::Unreadable { path: path.to_owned(), error };
        let text = std::fs::read_to_string(path).map_err(unreadable)?;
        Self::from_toml(&text)
            .map_err(|wrong| PlanError::File { path: path.to_owned(), wrong: Box::new(wrong) })
    }

    /// Reads and checks a mission from a TOML text.
    ///
    /// # Errors
    /// When it is no mission.
    pub fn from_toml(text: &str) -> Result<Self, PlanError> {
        if is_of_qgroundcontrol(text) {
            return Err(PlanError::QGroundControl);
        }
        let raw: RawPlan = toml::from_str(text).map_err(|error| syntax(text, &error))?;
        let count = raw.waypoint.iter().map(RawWaypoint::entries).sum();
        if !(1..=MOST_WAYPOINTS).contains(&count) {
            return Err(PlanError::Waypoints(count));
        }
        within("laps", raw.laps as f64, 1.0..=1000.0, "1 to 1000")?;
        within("engage_altitude_m", raw.engage_altitude_m, 5.0..=2000.0, "5 to 2000 m")?;
        within("loiter_s", raw.loiter_s, 0.0..=3600.0, "0 to 3600 s")?;
        within("time_limit_s", raw.time_limit_s, 1.0..=1e6, "1 to 1000000 s")?;
        let waypoints = entries(&raw.waypoint)?;
        apart(&waypoints)?;
        if passed(&waypoints).len() > MOST_PASSED {
            return Err(PlanError::Long);
        }
        Ok(Self {
            waypoints,
            laps: raw.laps as u32, // 1 to 1000
            engage_altitude_m: raw.engage_altitude_m,
            own_take_off: raw.take_off == TakeOff::Autopilot,
            landing: raw.landing,
            loiter_s: raw.loiter_s,
            time_limit_s: raw.time_limit_s,
        })
    }

    /// Way-points to reach until the laps are flown: all of them in each lap, and the return to the first; or all that a mission with
    /// circles and jumps comes to.
    pub fn waypoints_to_reach(&self) -> u32 {
        if self.is_circuit() {
            return self.laps * self.waypoints.len() as u32 + 1;
        }
        passed(&self.waypoints).len() as u32 // MOST_PASSED at most
    }

    /// Whether all way-points are passed, and flown round for the laps.
    pub fn is_circuit(&self) -> bool {
        self.waypoints.iter().all(|waypoint| waypoint.step == Step::Pass)
    }

    /// The entries of a mission that is no circuit in the order in which they are flown to; empty for a circuit.
    pub fn sequence(&self) -> Vec<usize> {
        if self.is_circuit() { Vec::new() } else { passed(&self.waypoints) }
    }
}

/// Way-points that a mission with jumps can come to, most.
const MOST_PASSED: usize = 1_000;

/// The entries that are flown to, in their order; one more than [`MOST_PASSED`] where there are more.
fn passed(waypoints: &[Waypoint]) -> Vec<usize> {
    let (mut order, mut jumps, mut index) = (Vec::new(), vec![0; waypoints.len()], 0);
    while let Some(waypoint) = waypoints.get(index).filter(|_| order.len() <= MOST_PASSED) {
        match waypoint.step {
            Step::Jump { to, times } if jumps[index] < times => {
                jumps[index] += 1;
                index = usize::from(to);
                continue;
            }
            Step::Jump { .. } => jumps[index] = 0,
            Step::Unlimited { .. } => {
                order.push(index);
                break;
            }
            _ => order.push(index),
        }
        index += 1;
    }
    order
}

/// The Controller's list: each way-point, and the jumps behind those that have one.
fn entries(raw: &[RawWaypoint]) -> Result<Vec<Waypoint>, PlanError> {
    let count = raw.iter().map(RawWaypoint::entries).sum();
    let entry_of = |place: usize| raw[..place].iter().map(RawWaypoint::entries).sum::<usize>();
    let mut waypoints = Vec::with_capacity(count);
    for (place, raw_waypoint) in raw.iter().enumerate() {
        let waypoint = raw_waypoint.check(place, count)?;
        waypoints.push(Waypoint { index: waypoints.len() as u8, ..waypoint }); // below MOST_WAYPOINTS
        if let Some(RawJump { to, times }) = raw_waypoint.jump {
            within(&format!("way-point {place} jump.times"), f64::from(times), 1.0..=1000.0, "1 to 1000")?;
            if to >= raw.len() {
                return Err(PlanError::Jump { of: place, to, last: raw.len() - 1 });
            }
            let step = Step::Jump { to: entry_of(to) as u8, times }; // as above
            waypoints.push(Waypoint { index: waypoints.len() as u8, step, ..waypoint });
        }
    }
    Ok(waypoints)
}

impl RawWaypoint {
    /// Places that it takes in the Controller's list.
    fn entries(&self) -> usize {
        1 + usize::from(self.jump.is_some())
    }

    fn step(&self, index: usize) -> Result<Step, PlanError> {
        let Some(RawCircle { turns, seconds, until, radius_m }) = self.circle else { return Ok(Step::Pass) };
        let name = |key: &str| format!("way-point {index} circle.{key}");
        if radius_m != 0.0 {
            within(
                &name("radius_m"),
                radius_m.abs(),
                Step::NARROWEST_M..=Step::WIDEST_M,
                "10 to 10000 m, negative to turn left",
            )?;
        }
        match (turns, seconds, until) {
            (Some(turns), None, None) => {
                within(&name("turns"), turns, 0.0..=Step::MOST_TURNS, "0 to 1000")?;
                Ok(Step::Turns { turns, radius_m })
            }
            (None, Some(seconds), None) => {
                within(&name("seconds"), seconds, 0.0..=Step::LONGEST_S, "0 to 86400 s")?;
                Ok(Step::Time { seconds, radius_m })
            }
            (None, None, Some(Until::Altitude)) => Ok(Step::Altitude { radius_m }),
            (None, None, Some(Until::Order)) => Ok(Step::Unlimited { radius_m }),
            _ => Err(PlanError::Circle(index)),
        }
    }

    fn check(&self, index: usize, count: usize) -> Result<Waypoint, PlanError> {
        let name = |key: &str| format!("way-point {index} {key}");
        let near = -Waypoint::FARTHEST_M..=Waypoint::FARTHEST_M;
        within(&name("north_m"), self.north_m, near.clone(), "within 50 km")?;
        within(&name("east_m"), self.east_m, near, "within 50 km")?;
        within(&name("altitude_m"), self.altitude_m, 0.0..=5000.0, "0 to 5000 m")?;
        within(&name("heading_deg"), self.heading_deg, -360.0..=360.0, "-360 to 360 degrees")?;
        within(&name("airspeed_mps"), self.airspeed_mps, Waypoint::AIRSPEEDS_MPS, "5 to 100 m/s")?;
        Ok(Waypoint {
            index: index as u8, // below MOST_WAYPOINTS
            count: count as u8,
            north_m: self.north_m,
            east_m: self.east_m,
            altitude_m: self.altitude_m,
            heading_rad: self.heading_deg.to_radians(),
            airspeed_mps: self.airspeed_mps,
            step: self.step(index)?,
        })
    }
}

/// Whether no two way-points that are passed in a row are at the same place; in a circuit the last and the first are, too. One alone has
/// no neighbour.
fn apart(waypoints: &[Waypoint]) -> Result<(), PlanError> {
    let count = waypoints.len();
    let closed = waypoints.iter().all(|waypoint| waypoint.step == Step::Pass);
    let pairs = (0..if closed { count } else { count.saturating_sub(1) })
        .map(|first| (first, (first + 1) % count))
        .filter(|(first, second)| first != second);
    for (first, second) in pairs {
        let points = [waypoints[first], waypoints[second]];
        let passed = points.iter().all(|point| point.step == Step::Pass);
        if passed && points[0].distance_m(&points[1]) < Waypoint::NEAREST_M {
            return Err(PlanError::Near { first, second, points: Box::new(points) });
        }
    }
    Ok(())
}

/// Its plan is JSON and says so in its field `fileType`; the older kind begins with its name.
fn is_of_qgroundcontrol(text: &str) -> bool {
    let text = text.trim_start_matches('\u{feff}').trim_start();
    text.starts_with("QGC WPL") || (text.starts_with('{') && text.contains("\"fileType\""))
}

/// Where a text is no mission, and why, in words of the file and not of the program.
fn syntax(text: &str, error: &toml::de::Error) -> PlanError {
    let single = single_brackets(text);
    let place = single.or_else(|| error.span().map(|span| span.start));
    let before = place.and_then(|start| text.get(..start)).unwrap_or_default();
    let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
    PlanError::Syntax {
        line: before.matches('\n').count() + 1,
        column: before[line_start..].chars().count() + 1,
        message: match single {
            Some(_) => "a way-point has two brackets on each side: write `[[waypoint]]`".to_owned(),
            None => in_words(error.message()),
        },
    }
}

/// Where `[waypoint]` stands in place of `[[waypoint]]`, in bytes.
fn single_brackets(text: &str) -> Option<usize> {
    let lines = text.split_inclusive('\n').scan(0, |start, line| {
        let here = *start;
        *start += line.len();
        Some((here, line))
    });
    let bare = |line: &str| line.split('#').next().unwrap_or_default().replace(' ', "");
    lines.into_iter().find(|(_, line)| bare(line).trim() == "[waypoint]").map(|(start, _)| start)
}

/// Share of letters that agree, from where on a guess helps more than it misleads.
const LIKENESS: f64 = 0.6;

fn in_words(message: &str) -> String {
    let Some((unknown, known)) =
        message.strip_prefix("unknown ").and_then(|rest| rest.split_once(", expected "))
    else {
        let plain = message
            .replace("expected f64", "expected a number")
            .replace("expected i64", "expected a whole number");
        return match plain.strip_prefix("missing field ") {
            Some("`waypoint`") => "the mission has no way-points: add a `[[waypoint]]`".to_owned(),
            Some(key) => format!("this way-point has no {key}: add it"),
            None => plain.replace("floating point", "number"),
        };
    };
    let quoted = |text: &str| text.split('`').skip(1).step_by(2).map(str::to_owned).collect::<Vec<_>>();
    let (word, known) = (quoted(unknown).concat(), quoted(known));
    let like = |candidate: &String| strsim::normalized_damerau_levenshtein(&word, candidate);
    let best = known.iter().max_by(|a, b| like(a).total_cmp(&like(b))).filter(|best| like(best) >= LIKENESS);
    let guess = best.map_or_else(String::new, |best| format!(": did you mean `{best}`?"));
    let what = if unknown.starts_with("variant") { "value" } else { "key" };
    format!("there is no {what} `{word}`{guess} (there are {})", known.join(", "))
}

/// A number without hundreds of digits.
fn short(value: f64) -> String {
    if value.abs() < 1e9 || !value.is_finite() { value.to_string() } else { format!("{value:e}") }
}

fn within(what: &str, value: f64, range: RangeInclusive<f64>, demand: &'static str) -> Result<(), PlanError> {
    if range.contains(&value) {
        Ok(())
    } else {
        Err(PlanError::Value { what: what.to_owned(), value, demand })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thesis_square_has_nine_way_points_to_reach() {
        assert_eq!(MissionPlan::thesis().waypoints_to_reach(), 9);
    }

    #[test]
    fn thesis_square_can_be_written_down() {
        let text = "
            [[waypoint]]
            north_m = 500
            east_m = 0
            altitude_m = 160
            [[waypoint]]
            north_m = 500
            east_m = 500
            altitude_m = 160
            [[waypoint]]
            north_m = 0
            east_m = 500
            altitude_m = 160
            heading_deg = 180
            [[waypoint]]
            north_m = 0
            east_m = 0
            altitude_m = 160
            heading_deg = 270
            airspeed_mps = 22";
        assert_eq!(MissionPlan::from_toml(text).unwrap(), MissionPlan::thesis());
    }

    fn through(places: &[(f64, f64)]) -> Result<MissionPlan, PlanError> {
        let point =
            |(north, east)| format!("[[waypoint]]\nnorth_m = {north}\neast_m = {east}\naltitude_m = 160\n");
        MissionPlan::from_toml(&places.iter().copied().map(point).collect::<String>())
    }

    #[test]
    fn way_points_in_a_row_at_one_place_are_refused_and_both_are_named() {
        let refused = |places: &[(f64, f64)]| through(places).unwrap_err().to_string();
        let same = refused(&[(0.0, 0.0), (500.0, 0.0), (500.0, 0.0)]);
        assert!(
            same.starts_with(
                "way-point 1 (north 500 m, east 0 m) and way-point 2 (north 500 m, east 0 m) follow each other, and are \
                 0.0 m apart on the map; it must be 5 m or more"
            ),
            "{same}"
        );
        assert!(same.ends_with("move one, or leave it out"), "{same}");
        let closed = refused(&[(0.0, 0.0), (500.0, 0.0), (3.0, 3.0)]);
        assert!(closed.starts_with("way-point 2 (north 3 m, east 3 m) and way-point 0 (north 0"), "{closed}");
    }

    #[test]
    fn way_points_apart_and_one_alone_are_a_mission() {
        assert!(through(&[(500.0, 0.0)]).is_ok());
        assert!(through(&[(0.0, 0.0), (500.0, 0.0), (0.0, 5.0)]).is_ok());
        // The same place once more, but not in a row: a figure of eight.
        assert!(through(&[(0.0, 0.0), (500.0, 0.0), (0.0, 0.0), (0.0, 500.0)]).is_ok());
    }

    #[test]
    fn circles_and_jumps_become_entries_and_the_order_in_which_they_are_flown() {
        let text = "
            [[waypoint]]
            north_m = 500
            east_m = 0
            altitude_m = 160
            jump = { to = 0, times = 1 }
            [[waypoint]]
            north_m = 500
            east_m = 500
            altitude_m = 160
            circle = { turns = 1.5, radius_m = -120 }
            [[waypoint]]
            north_m = 0
            east_m = 500
            altitude_m = 100
            circle = { until = \"altitude\" }
            jump = { to = 1, times = 2 }";
        let plan = MissionPlan::from_toml(text).unwrap();
        let steps: Vec<_> = plan.waypoints.iter().map(|waypoint| waypoint.step).collect();
        let expected = [
            Step::Pass,
            Step::Jump { to: 0, times: 1 },
            Step::Turns { turns: 1.5, radius_m: -120.0 },
            Step::Altitude { radius_m: 0.0 },
            Step::Jump { to: 2, times: 2 },
        ];
        assert_eq!(steps, expected);
        assert!(
            plan.waypoints.iter().zip(0..).all(|(point, index)| (point.index, point.count) == (index, 5))
        );
        assert_eq!(plan.sequence(), [0, 0, 2, 3, 2, 3, 2, 3]);
        assert_eq!(plan.waypoints_to_reach(), 8);
    }

    #[test]
    fn circles_and_jumps_that_make_no_sense_are_refused() {
        let with = |more: &str| {
            let text = format!("[[waypoint]]\nnorth_m = 1\neast_m = 2\naltitude_m = 3\n{more}");
            MissionPlan::from_toml(&text).unwrap_err().to_string()
        };
        let cases = [
            ("circle = {}", "give one of them"),
            ("circle = { turns = 1, seconds = 3 }", "give one of them"),
            ("circle = { turns = 1, radius_m = 3 }", "10 to 10000 m"),
            ("circle = { seconds = -1 }", "0 to 86400 s"),
            ("circle = { turn = 1 }", "did you mean `turns`?"),
            ("jump = { to = 1 }", "jumps to way-point 1, and there is none: give 0 to 0"),
            ("jump = { to = 0, times = 0 }", "1 to 1000"),
            ("jump = { to = 0, times = 1000 }", "more than 1000 way-points"),
        ];
        for (more, expected) in cases {
            let message = with(more);
            assert!(message.contains(expected), "{more}: {message}");
        }
    }

    #[test]
    fn mission_of_qgroundcontrol_is_called_so_and_no_mistake_in_toml() {
        for text in ["{\n  \"fileType\": \"Plan\",\n  \"mission\": {} }", "QGC WPL 110\n0\t1\t0\t16"] {
            let message = MissionPlan::from_toml(text).unwrap_err().to_string();
            assert!(message.starts_with("this is a mission of QGroundControl's"), "{message}");
            assert!(message.contains("mavlink.md") && message.contains("ground.md"), "{message}");
        }
    }

    #[test]
    fn airspeed_that_the_controller_does_not_understand_is_refused_before_the_flight() {
        let at = |airspeed: &str| {
            let text = "[[waypoint]]\nnorth_m = 500\neast_m = 0\naltitude_m = 160\nairspeed_mps = ";
            MissionPlan::from_toml(&(text.to_owned() + airspeed))
        };
        assert!(at("5").is_ok() && at("100").is_ok());
        let message = at("4.9").unwrap_err().to_string();
        assert_eq!(message, "the mission's way-point 0 airspeed_mps is 4.9, but it must be 5 to 100 m/s");
    }

    #[test]
    fn mistakes_are_named() {
        let cases = [
            ("waypoint = []", "has 0 way-points"),
            ("[[waypoint]]\nnorth_m = 1\neast_m = nan\naltitude_m = 3", "way-point 0 east_m is NaN"),
            (
                "[[waypoint]]\nnort_m = 1",
                "line 2, column 1: there is no key `nort_m`: did you mean `north_m`?",
            ),
            ("take_off = \"autopilt\"", "there is no value `autopilt`: did you mean `autopilot`?"),
            (
                "[[waypoint]]\nnorth_m = \"1\"",
                "line 2, column 11: invalid type: string \"1\", expected a number",
            ),
            ("[[waypoint]]\nnorth_m = 1\neast_m = 2", "this way-point has no `altitude_m`: add it"),
            ("laps = 1", "the mission has no way-points: add a `[[waypoint]]`"),
            ("laps = 1\n[waypoint] # a\nnorth_m = 1", "line 2, column 1: a way-point has two brackets"),
            ("[[waypoint]]\nnorth_m = 1\n[waypoint]\nnorth_m = 1", "line 3, column 1: a way-point has two"),
            ("laps = 0\n[[waypoint]]\nnorth_m = 1\neast_m = 2\naltitude_m = 3", "laps is 0"),
            (
                "laps = -1\n[[waypoint]]\nnorth_m = 1\neast_m = 2\naltitude_m = 3",
                "laps is -1, but it must be 1 to 1000",
            ),
            (
                "laps = 99999999999\nwaypoint = [{ north_m = 1, east_m = 2, altitude_m = 3 }]",
                "laps is 9.9999999999e10",
            ),
            (
                "[[waypoint]]\nnorth_m = 1e300\neast_m = 2\naltitude_m = 3",
                "north_m is 1e300, but it must be within 50 km",
            ),
            (
                "[[waypoint]]\nnorth_m = 1\neast_m = -60_000\naltitude_m = 3",
                "east_m is -60000, but it must be within 50 km",
            ),
        ];
        for (text, expected) in cases {
            let message = MissionPlan::from_toml(text).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}
