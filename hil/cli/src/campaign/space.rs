//! What the flights of a campaign are drawn from, and the options of one flight.
//!
//! Every draw belongs to the flight's seed and to its own name: a condition more or less does not change the others, and flight
//! number N of a seed is the same flight in every campaign.

use std::collections::BTreeMap;

use bateleur_plant::{Ranges, drawn};
use clap::Parser;

/// Module times between which faults begin, s: after the first way-point, before the end of two laps.
const FAULTS_S: Span = Span { from: 40.0, to: 180.0 };
/// Shorter outages of the receiver than this are none, s: it gives a fix every 200 ms.
const SHORTEST_OUTAGE_S: f64 = 0.2;
/// Added latency below this is none, s.
const LEAST_LATENCY_S: f64 = 0.005;
/// Largest change of a bias in flight: accelerometer m/s², gyroscope °/s, magnetometer gauss. About what calibrated sensors
/// start with.
const SHIFTS: [(&str, f64); 3] =
    [("accelerometer_shift", 0.2), ("gyroscope_shift", 0.5), ("magnetometer_shift", 0.01)];
/// What a sensor can do in flight, by the sensor: a fault of `bateleur fly`, the span of its value where it has one, and how long it lasts, s;
/// without: to the end. What nobody can fly without ends.
const SENSOR_FAULTS: [(&str, &[SensorFault]); 6] = [
    (
        "airspeed",
        &[
            ("pitot_blocked", None, None),
            ("pitot_frozen", None, None),
            ("pitot_lost", None, None),
            ("pitot_slow", Some(Span { from: 2.0, to: 20.0 }), None),
            ("pitot_scale", Some(Span { from: 0.5, to: 0.9 }), None),
            ("pitot_scale", Some(Span { from: 1.1, to: 1.5 }), None),
            ("pitot_icing", Some(Span { from: -0.5, to: 0.5 }), Some(Span { from: 20.0, to: 60.0 })),
            ("pitot_noise", Some(Span { from: 20.0, to: 100.0 }), None),
        ],
    ),
    (
        "static-pressure",
        &[("static_blocked", None, None), ("static_slow", Some(Span { from: 2.0, to: 20.0 }), None)],
    ),
    ("satellites", &[("gps_lost", None, Some(Span { from: 60.0, to: 60.0 }))]),
    (
        "magnetometer",
        &[
            ("magnetometer_lost", None, None),
            ("magnetometer_shift", Some(Span { from: -0.2, to: 0.2 }), None),
        ],
    ),
    (
        "inertial",
        &[
            ("accelerometer_stuck", None, None),
            ("gyroscope_stuck", None, None),
            ("accelerometer_shift", Some(Span { from: -2.0, to: 2.0 }), None),
            ("gyroscope_shift", Some(Span { from: -5.0, to: 5.0 }), None),
            ("inertial_lost", None, Some(Span { from: 0.1, to: 1.0 })),
        ],
    ),
    (
        "range",
        &[
            ("range_lost", None, None),
            ("range_stuck", None, None),
            ("range_shift", Some(Span { from: -5.0, to: 5.0 }), None),
        ],
    ),
];
const AXES: [&str; 3] = ["x", "y", "z"];

type SensorFault = (&'static str, Option<Span>, Option<Span>);

/// The dimension that every plan has.
const KILLED: &str = "killed";

/// From one number to another, evenly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Span {
    pub(super) from: f64,
    pub(super) to: f64,
}

impl Span {
    fn draw(self, seed: u64, name: &str) -> f64 {
        self.from + (self.to - self.from) * drawn(seed, name)
    }
}

impl std::fmt::Display for Span {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}..{}", self.from, self.to)
    }
}

/// What conditions are drawn from.
#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "What each flight draws")]
pub(crate) struct Space {
    /// Mean wind, m/s, from any direction.
    #[arg(long, value_name = "FROM..TO", default_value = "0..8", value_parser = wind)]
    wind: Span,
    /// Gusts.
    #[arg(long, value_name = "LEVELS", default_value = "calm,light,moderate", value_delimiter = ',',
          value_parser = ["calm", "light", "moderate", "severe"])]
    turbulence: Vec<String>,
    /// How far the aircraft is from its file; with `none` it is as in its file.
    #[arg(long, value_name = "RANGES|none", default_value = "mass=10%,inertia=10%,derivatives=20%", value_parser = ranges)]
    vary: Vary,
    /// Share of flights in which the bias of a sensor changes in flight.
    #[arg(long, value_name = "SHARE", default_value = "0.25", value_parser = share)]
    bias_shifts: f64,
    /// Share of flights in which a sensor fails, of each of these alone: airspeed, static pressure, satellites (60 s), magnetometer,
    /// inertial sensors, range finder.
    #[arg(long, value_name = "SHARE", default_value = "0", value_parser = share)]
    sensor_faults: f64,
    /// Aircraft, one of which each flight has: names or files [default: what every flight has].
    #[arg(long, value_name = "AIRCRAFT", value_delimiter = ',', value_parser = airframe)]
    airframes: Vec<String>,
    /// How much later than usual the receiver's fixes come, s.
    #[arg(long, value_name = "FROM..TO", default_value = "0..0.2", value_parser = latency)]
    gps_late: Span,
    /// How long the receiver is lost, once, s.
    #[arg(long, value_name = "FROM..TO", default_value = "0..10", value_parser = outage)]
    gps_outage: Span,
    /// How often somebody is killed.
    #[arg(long, value_name = "FROM..TO", default_value = "0..2", value_parser = kills)]
    kills: Span,
    /// Those that may be killed, and `executive` [default: all partitions but relays].
    #[arg(long, value_name = "PARTITIONS", value_delimiter = ',')]
    kill_only: Vec<String>,
}

/// To know what nobody has asked for.
#[derive(Debug, Parser)]
struct Usual {
    #[command(flatten)]
    space: Space,
}

/// Ranges of the aircraft's numbers, or none.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Vary(Option<Ranges>);

/// What one flight drew.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Drawn {
    /// Options of `bateleur fly`.
    pub(super) options: Vec<String>,
    /// The same as numbers.
    pub(super) conditions: BTreeMap<String, f64>,
}

impl Space {
    /// Who may be killed, checked against those who can be; empty: nobody is named.
    pub(super) fn victims(&self, known: &[String]) -> Result<&[String], String> {
        let Some(unknown) = self.kill_only.iter().find(|name| !known.contains(name)) else {
            return Ok(&self.kill_only);
        };
        let near = bateleur_executive_cli::words::nearest(unknown, known.iter().map(String::as_str));
        let hint = near.map_or_else(String::new, |near| format!(": did you mean `{near}`?"));
        Err(format!("--kill-only: there is no partition `{unknown}` here{hint}"))
    }

    /// A sentence for each dimension: two campaigns with the same ones draw the same.
    pub(super) fn sentences(&self, victims: &[String]) -> BTreeMap<String, String> {
        let vary = self.vary.0.map_or_else(|| "none".into(), |ranges| ranges.to_string());
        let sentences = [
            ("wind, m/s", self.wind.to_string()),
            ("turbulence", self.turbulence.join(", ")),
            ("aircraft about its file", vary),
            ("flights with a bias that changes", self.bias_shifts.to_string()),
            ("flights in which a sensor fails, of each", self.sensor_faults.to_string()),
            (
                "aircraft",
                if self.airframes.is_empty() { "as asked".into() } else { self.airframes.join(", ") },
            ),
            ("added latency of fixes, s", self.gps_late.to_string()),
            ("receiver lost for, s", self.gps_outage.to_string()),
            (KILLED, format!("{} of {}", self.kills, victims.join(", "))),
        ];
        sentences.into_iter().map(|(name, text)| (name.to_owned(), text)).collect()
    }

    /// The conditions of the flight with this seed.
    pub(super) fn draw(&self, seed: u64, victims: &[String]) -> Drawn {
        let mut drawn = Drawn { options: vec![format!("--seed={seed}")], conditions: BTreeMap::new() };
        self.draw_air(seed, &mut drawn);
        if let Some(ranges) = self.vary.0 {
            drawn.option("vary", ranges);
        }
        self.draw_receiver(seed, &mut drawn);
        self.draw_shift(seed, &mut drawn);
        self.draw_sensor_faults(seed, &mut drawn);
        if let Some(airframe) = pick(&self.airframes, seed, "airframe") {
            drawn.option("airframe", airframe);
        }
        self.draw_kills(seed, victims, FAULTS_S, &mut drawn);
        drawn
    }

    /// The conditions of a run of a plan that does not fly, of so many seconds of module time.
    pub(super) fn draw_run(&self, seed: u64, victims: &[String], until_s: f64) -> Drawn {
        let mut drawn = Drawn { options: Vec::new(), conditions: BTreeMap::new() };
        self.draw_kills(seed, victims, Span { from: 0.1 * until_s, to: 0.9 * until_s }, &mut drawn);
        drawn
    }

    /// What is asked for that only a flight has, in words; nothing where all is as usual.
    pub(super) fn of_flights_alone(&self) -> Option<String> {
        let usual = Usual::try_parse_from(["usual"]).ok()?.space.sentences(&[]);
        let asked = self
            .sentences(&[])
            .into_iter()
            .find(|(name, text)| name != KILLED && usual.get(name) != Some(text));
        asked.map(|(name, text)| format!("{name}: {text}"))
    }

    /// A sentence for each dimension of a run that does not fly.
    pub(super) fn run_sentences(&self, victims: &[String]) -> BTreeMap<String, String> {
        let mut sentences = self.sentences(victims);
        sentences.retain(|name, _| name == KILLED);
        sentences
    }

    fn draw_air(&self, seed: u64, into: &mut Drawn) {
        let wind = rounded(self.wind.draw(seed, "wind"), 2);
        let from = rounded(Span { from: 0.0, to: 360.0 }.draw(seed, "wind-from"), 0);
        let level = pick(&self.turbulence, seed, "turbulence");
        into.option("wind", wind);
        into.option("wind-from", from);
        into.option("turbulence", level.map_or("calm", String::as_str));
        into.note("wind_mps", wind);
        into.note("wind_from_deg", from);
    }

    fn draw_receiver(&self, seed: u64, into: &mut Drawn) {
        let late_s = rounded(self.gps_late.draw(seed, "gps-late"), 3);
        if late_s >= LEAST_LATENCY_S {
            into.option("fault", format!("gps_late={late_s}"));
        }
        let lost_s = rounded(self.gps_outage.draw(seed, "gps-outage"), 1);
        if lost_s >= SHORTEST_OUTAGE_S {
            let from_s = moment(seed, "gps-outage-from");
            into.option("fault", format!("gps_lost@{from_s}..{}", rounded(from_s + lost_s, 1)));
        }
        into.note("gps_late_s", late_s);
        into.note("gps_lost_s", lost_s);
    }

    fn draw_shift(&self, seed: u64, into: &mut Drawn) {
        if bateleur_plant::drawn(seed, "shift") >= self.bias_shifts {
            return;
        }
        let Some((fault, most)) = pick(&SHIFTS, seed, "shift-sensor") else { return };
        let size = rounded(Span { from: -*most, to: *most }.draw(seed, "shift-size"), 4);
        into.option("fault", format!("{fault}={size}@{}", moment(seed, "shift-from")));
        into.note(fault, size);
    }

    fn draw_sensor_faults(&self, seed: u64, into: &mut Drawn) {
        for (sensor, faults) in SENSOR_FAULTS {
            let named = |what: &str| format!("{sensor}-{what}");
            let fails = bateleur_plant::drawn(seed, &named("fails")) < self.sensor_faults;
            let Some((fault, value, lasts)) = pick(faults, seed, &named("fault")).filter(|_| fails) else {
                continue;
            };
            let value = match (value, pick(&AXES, seed, &named("axis"))) {
                (Some(span), _) => format!("={}", rounded(span.draw(seed, &named("value")), 2)),
                (None, Some(axis)) if fault.ends_with("_stuck") && sensor == "inertial" => format!("={axis}"),
                _ => String::new(),
            };
            let from_s = moment(seed, &named("from"));
            let until = lasts
                .map(|span| format!("..{}", rounded(from_s + span.draw(seed, &named("lasts")), 1)))
                .unwrap_or_default();
            into.option("fault", format!("{fault}{value}@{from_s}{until}"));
            into.note(&format!("{}_fails", sensor.replace('-', "_")), 1.0);
        }
    }

    fn draw_kills(&self, seed: u64, victims: &[String], when: Span, into: &mut Drawn) {
        let Span { from, to } = self.kills;
        // Whole numbers from the first to the last, each as likely as the others.
        let count =
            (from + ((to - from + 1.0) * bateleur_plant::drawn(seed, "kills")).floor()).min(to) as u64;
        for number in 0..count {
            if let Some(victim) = pick(victims, seed, &format!("kill-{number}")) {
                let at_s = rounded(when.draw(seed, &format!("kill-{number}-at")), 1);
                into.option("kill", format!("{victim}@{at_s}"));
            }
        }
        into.note("kills", count as f64);
    }
}

impl Drawn {
    fn option(&mut self, name: &str, value: impl std::fmt::Display) {
        self.options.push(format!("--{name}={value}"));
    }

    fn note(&mut self, name: &str, value: f64) {
        self.conditions.insert(name.to_owned(), value);
    }
}

fn moment(seed: u64, name: &str) -> f64 {
    rounded(FAULTS_S.draw(seed, name), 1)
}

fn pick<'l, T>(list: &'l [T], seed: u64, name: &str) -> Option<&'l T> {
    let place = (drawn(seed, name) * list.len() as f64) as usize;
    list.get(place.min(list.len().saturating_sub(1)))
}

/// So many digits: commands are read by people.
fn rounded(value: f64, digits: i32) -> f64 {
    let scale = 10_f64.powi(digits);
    (value * scale).round() / scale
}

fn span(text: &str, least: f64, most: f64, unit: &str) -> Result<Span, String> {
    let wrong = || {
        format!(
            "\"{text}\" is not FROM..TO with numbers from {least} to {most}{unit}, such as {least}..{most}"
        )
    };
    let (from, to) = text.split_once("..").unwrap_or((text, text));
    let number = |text: &str| text.trim().parse::<f64>().ok().filter(|value| (least..=most).contains(value));
    let (from, to) = number(from).zip(number(to)).ok_or_else(wrong)?;
    if from <= to { Ok(Span { from, to }) } else { Err(wrong()) }
}

fn wind(text: &str) -> Result<Span, String> {
    span(text, 0.0, 50.0, " m/s")
}

fn latency(text: &str) -> Result<Span, String> {
    span(text, 0.0, 1.3, " s")
}

fn outage(text: &str) -> Result<Span, String> {
    span(text, 0.0, 1000.0, " s")
}

fn kills(text: &str) -> Result<Span, String> {
    let span = span(text, 0.0, 100.0, "")?;
    let whole = span.from.fract() == 0.0 && span.to.fract() == 0.0;
    if whole { Ok(span) } else { Err(format!("\"{text}\": give whole numbers, such as 0..2")) }
}

fn ranges(text: &str) -> Result<Vary, String> {
    match text {
        "none" => Ok(Vary(None)),
        text => text
            .parse()
            .map(|ranges| Vary(Some(ranges)))
            .map_err(|error: bateleur_plant::variation::VariationError| error.to_string()),
    }
}

/// A name or a file; what is wrong in a file is told before the first flight.
fn airframe(text: &str) -> Result<String, String> {
    let names = bateleur_flight::airframe::BUILT_IN.map(|(name, _)| name);
    if names.contains(&text) {
        return Ok(text.to_owned());
    }
    let file = std::fs::read_to_string(text)
        .map_err(|error| format!("\"{text}\": {error}; name a file, or one of {}", names.join(", ")))?;
    bateleur_plant::Airframe::from_toml(&file).map_err(|error| format!("{text}: {error}"))?;
    Ok(text.to_owned())
}

fn share(text: &str) -> Result<f64, String> {
    let number = match text.strip_suffix('%') {
        Some(percent) => percent.parse::<f64>().ok().map(|percent| percent / 100.0),
        None => text.parse().ok(),
    };
    number
        .filter(|share| (0.0..=1.0).contains(share))
        .ok_or_else(|| format!("\"{text}\" is no share: give 25% or 0.25"))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Program {
        #[command(flatten)]
        space: Space,
    }

    fn space(options: &[&str]) -> Space {
        let words = ["program"].iter().chain(options);
        Program::try_parse_from(words).unwrap().space
    }

    fn nine() -> Vec<String> {
        ["imu", "estimator", "servo"].map(str::to_owned).to_vec()
    }

    #[test]
    fn same_seed_draws_the_same_and_another_dimension_changes_no_other() {
        let (usual, wider) = (space(&[]), space(&["--kills=0..5", "--bias-shifts=1"]));
        for seed in 0..50 {
            let (a, b) = (usual.draw(seed, &nine()), wider.draw(seed, &nine()));
            assert_eq!(a, usual.draw(seed, &nine()));
            for name in ["wind_mps", "wind_from_deg", "gps_late_s", "gps_lost_s"] {
                assert_eq!(a.conditions[name], b.conditions[name]);
            }
        }
        assert_ne!(usual.draw(1, &nine()), usual.draw(2, &nine()));
    }

    #[test]
    fn draws_stay_within_their_spans_and_reach_all_of_them() {
        let space = space(&["--wind=2..3", "--kills=1..3", "--turbulence=calm,severe", "--vary=none"]);
        let all: Vec<Drawn> = (0..400).map(|seed| space.draw(seed, &nine())).collect();
        let wind = |drawn: &Drawn| drawn.conditions["wind_mps"];
        assert!(all.iter().all(|drawn| (2.0..=3.0).contains(&wind(drawn))));
        assert!(all.iter().any(|drawn| wind(drawn) < 2.1) && all.iter().any(|drawn| wind(drawn) > 2.9));
        for count in 1..=3 {
            let kills =
                |drawn: &&Drawn| drawn.options.iter().filter(|option| option.starts_with("--kill=")).count();
            assert!(all.iter().any(|drawn| kills(&drawn) == count), "{count}");
        }
        let severe = all.iter().filter(|drawn| drawn.options.contains(&"--turbulence=severe".into())).count();
        assert!((150..250).contains(&severe), "{severe}");
        assert!(all.iter().all(|drawn| !drawn.options.iter().any(|option| option.contains("vary"))));
    }

    #[test]
    fn each_sensor_fails_in_its_share_of_flights_with_faults_that_the_plant_knows() {
        let space =
            space(&["--sensor-faults=10%", "--airframes=zagi,vtail60", "--gps-late=0", "--gps-outage=0"]);
        let all: Vec<Drawn> = (0..4_000).map(|seed| space.draw(seed, &nine())).collect();
        for (sensor, faults) in SENSOR_FAULTS {
            let noted = format!("{}_fails", sensor.replace('-', "_"));
            let failed = all.iter().filter(|drawn| drawn.conditions.contains_key(&noted));
            let share = failed.count() as f64 / all.len() as f64;
            assert!((0.08..0.12).contains(&share), "{sensor}: {share}");
            for (fault, ..) in faults {
                let drawn = |option: &String| option.starts_with(&format!("--fault={fault}"));
                assert!(all.iter().any(|one| one.options.iter().any(drawn)), "{fault}");
            }
        }
        for option in all.iter().flat_map(|drawn| &drawn.options) {
            if let Some(fault) = option.strip_prefix("--fault=") {
                let known: Result<bateleur_plant::fault::PlannedFault, _> = fault.parse();
                assert!(known.is_ok(), "{known:?}");
            }
        }
        let zagi = all.iter().filter(|drawn| drawn.options.contains(&"--airframe=zagi".into())).count();
        assert!((1_800..2_200).contains(&zagi), "{zagi}");
    }

    #[test]
    fn spans_that_make_no_sense_are_refused() {
        for wrong in [
            "--wind=8..2",
            "--wind=-1..2",
            "--wind=a..b",
            "--kills=0.5..1",
            "--gps-late=0..9",
            "--vary=wings=3%",
            "--airframes=aerosonde,zaggi",
            "--sensor-faults=11",
        ] {
            assert!(Program::try_parse_from(["program", wrong]).is_err(), "{wrong}");
        }
        assert_eq!(space(&["--wind=5"]).wind, Span { from: 5.0, to: 5.0 });
        assert!(space(&["--kill-only=imuu"]).victims(&nine()).unwrap_err().contains("did you mean `imu`?"));
    }
}
