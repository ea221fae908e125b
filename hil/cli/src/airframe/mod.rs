//! `bateleur airframe`: reads an airframe file, says everything that is wrong with it, and what follows from it: how the aircraft
//! trims over its speeds, its natural modes, the gains that the Controller computes from it, and the limits of all that.
//!
//! Exit codes: 0 it can be flown, 1 the laws can not fly it at the airspeed asked for, 2 the file can not be used.

mod facts;
mod text;

use std::io::IsTerminal;
use std::path::Path;

use annotate_snippets::{AnnotationKind, Level, Renderer, Snippet};
use anyhow::{Context, Result};
use bateleur_flight::airframe::{BUILT_IN, built_in};
use bateleur_flight::control::envelope::Envelope;
use bateleur_plant::airframe_file::{self, Flaw};

use super::{CANNOT_RUN, Code, FINE, Format, WRONG};
use bateleur_executive_cli::plan_file;
use facts::{Facts, Point};

/// Say what follows from an airframe file: trim, modes, gains and limits.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Exit codes: 0 it can be flown; 1 the laws can not fly it at this airspeed; 2 the file can not be used."
)]
pub struct Arguments {
    /// The airframe file, or aerosonde, rascal110, ultrastick25e, vtail60 or zagi.
    #[arg(value_name = "FILE|NAME")]
    file: String,
    /// Airspeed of modes, gains and limits, m/s [default: 22, or the nearest that it flies].
    #[arg(long, value_name = "M/S", value_parser = speed, allow_negative_numbers = true)]
    airspeed: Option<f64>,
    /// Height above mean sea level, m.
    #[arg(long, value_name = "M", default_value_t = 0.0, value_parser = height, allow_negative_numbers = true)]
    height: f64,
    /// What to print.
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

/// Airspeed of the missions that come with Bateleur, m/s.
const MISSION_MPS: f64 = 22.0;

fn speed(text: &str) -> std::result::Result<f64, String> {
    number(text, 5.0, 100.0, "m/s")
}

fn height(text: &str) -> std::result::Result<f64, String> {
    number(text, -400.0, 10_000.0, "m")
}

fn number(text: &str, low: f64, high: f64, unit: &str) -> std::result::Result<f64, String> {
    let value = text.parse().ok().filter(|value| (low..=high).contains(value));
    value.ok_or_else(|| format!("it must be a number from {low} to {high} {unit}"))
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let text = text_of(&arguments.file)?;
    let plant = match airframe_file::read(&text) {
        Ok(airframe) => airframe,
        Err(flaws) => return Ok(refuse(arguments, &text, &flaws.0)),
    };
    let laws = match bateleur_flight::airframe::Airframe::from_toml(&text) {
        Ok(airframe) => airframe,
        Err(error) => return Ok(refuse(arguments, &text, &[not_for_the_laws(&text, &error)])),
    };
    let airspeed_mps = arguments.airspeed.unwrap_or_else(|| {
        let envelope = Envelope::new(&laws);
        let least_mps = (2.0 * envelope.slowest_mps).ceil() / 2.0;
        MISSION_MPS.max(least_mps).min((2.0 * envelope.fastest_mps).floor() / 2.0)
    });
    let point = Point { airspeed_mps, height_m: arguments.height };
    let facts = Facts::of(&plant, &laws, &point);
    let out = match arguments.format {
        Format::Json => format!("{:#}\n", serde_json::json!(facts)),
        Format::Text => text::report(&facts),
    };
    print!("{out}");
    Ok(if facts.trim_error.is_none() { FINE } else { WRONG })
}

fn text_of(name: &str) -> Result<String> {
    match built_in(name) {
        Some(text) => Ok(text.to_owned()),
        None => plan_file::read_bounded(Path::new(name)).with_context(|| {
            let names = BUILT_IN.map(|(name, _)| name).join(", ");
            format!("cannot read {name}: name an airframe file, or one of the built-in {names}")
        }),
    }
}

/// What the laws cannot work with, at its place.
fn not_for_the_laws(text: &str, error: &bateleur_flight::airframe::AirframeError) -> Flaw {
    use bateleur_flight::airframe::AirframeError;
    match error {
        AirframeError::Value { key, value, demand } => {
            let message = format!("{key} is {value}");
            Flaw::at(text, &airframe_file::place_of(text, key), message, format!("the laws need {demand}"))
        }
        other => Flaw::at(text, &(0..0), other.to_string(), "more power, or less mass".to_owned()),
    }
}

fn refuse(arguments: &Arguments, text: &str, flaws: &[Flaw]) -> Code {
    let out = match arguments.format {
        Format::Json => format!("{:#}\n", json(&arguments.file, flaws)),
        Format::Text => rendered(&arguments.file, text, flaws),
    };
    print!("{out}");
    CANNOT_RUN
}

fn json(file: &str, flaws: &[Flaw]) -> serde_json::Value {
    let one = |flaw: &Flaw| {
        serde_json::json!({
            "line": flaw.line, "column": flaw.column, "message": flaw.message, "mend": flaw.mend,
        })
    };
    serde_json::json!({ "file": file, "flaws": flaws.iter().map(one).collect::<Vec<_>>() })
}

/// As `bateleur check` shows what is wrong with a schedule.
fn rendered(file: &str, text: &str, flaws: &[Flaw]) -> String {
    let renderer = if std::io::stdout().is_terminal() { Renderer::styled() } else { Renderer::plain() };
    let mut out = String::new();
    for flaw in flaws {
        let snippet =
            Snippet::source(text).path(file).annotation(AnnotationKind::Primary.span(flaw.span.clone()));
        let title = Level::ERROR.primary_title(flaw.message.as_str());
        let help = Level::HELP.message(flaw.mend.as_str());
        out.push_str(&renderer.render(&[title.element(snippet).element(help)]));
        out.push_str("\n\n");
    }
    let errors = if flaws.len() == 1 { "1 error".into() } else { format!("{} errors", flaws.len()) };
    out.push_str(&format!("{file}: {errors}\n"));
    out
}
