//! The verbs that fly hardware-in-the-loop, and those that look at flights and aircraft.
//!
//! Responsible for: bringing together the executive, the simulator, the ground station and the report, which know nothing of each
//! other; one module a verb, whose head is its manual page.
//! The one thing it must never do: hold a mechanism of the executive, or of the report.

#[macro_use(eprintln, print, println)]
extern crate bateleur_executive_cli;

mod air;
mod airframe;
mod campaign;
mod compare;
mod export;
mod fly;
mod ground;
mod line;
mod play;
mod replay;

use anyhow::Result;
use bateleur_executive_cli::{CANNOT_RUN, Code, FINE, Format, WRONG};
use clap::Subcommand;

/// The verbs about flights, with their arguments.
#[derive(Debug, Subcommand)]
#[allow(
    missing_docs,
    reason = "the text of a verb stands at its arguments, and would be replaced by one here"
)]
pub enum Verb {
    Airframe(airframe::Arguments),
    Campaign(Box<campaign::Arguments>),
    Compare(compare::Arguments),
    Export(export::Arguments),
    Fly(Box<fly::Arguments>),
    Ground(ground::Arguments),
    Play(play::Arguments),
    Replay(replay::Arguments),
    View(bateleur_view::Arguments),
}

impl Verb {
    /// Does it.
    ///
    /// # Errors
    /// It could not begin, or had to be given up.
    pub fn run(self) -> Result<Code> {
        match self {
            Self::Airframe(arguments) => airframe::run(&arguments),
            Self::Campaign(arguments) => campaign::run(&arguments),
            Self::Compare(arguments) => compare::run(&arguments),
            Self::Export(arguments) => export::run(&arguments),
            Self::Fly(arguments) => fly::run(&arguments),
            Self::Ground(arguments) => ground::run(&arguments),
            Self::Play(arguments) => play::run(&arguments),
            Self::Replay(arguments) => replay::run(&arguments),
            Self::View(arguments) => bateleur_view::run(&arguments),
        }
    }
}
