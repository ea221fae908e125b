//! The verbs.

mod check;
mod crash;
mod doctor;
mod gateway;
mod health;
mod helper;
mod init;
mod inject;
mod key;
mod links;
mod logbook;
mod metrics;
mod new;
mod notes;
mod order;
mod plan;
mod ports;
mod ps;
mod publish;
mod record;
mod run;
mod schema;
mod show;
mod target;
mod top;
mod why;

pub use links::text as links_text;
pub use ports::Watch;
pub use target::{Target, channels, status};

use anyhow::Result;
use bateleur_control::Request;
use clap::Subcommand;

use crate::code::{CANNOT_RUN, Code, FINE, Format, WRONG};

/// The verbs about modules, with their arguments.
#[derive(Debug, Subcommand)]
#[allow(
    missing_docs,
    reason = "the text of a verb stands at its arguments, and would be replaced by one here"
)]
pub enum Verb {
    Check(check::Arguments),
    Crash(crash::Arguments),
    Doctor(doctor::Arguments),
    Gateway(gateway::Arguments),
    Health(health::Arguments),
    Key(key::Arguments),
    Links(links::Arguments),
    Logbook(logbook::Arguments),
    Metrics(metrics::Arguments),
    /// Kill a partition of a running module; its health table says what follows.
    Kill(order::Arguments),
    /// End a partition of a running module until it is started; its windows pass.
    Stop(order::Arguments),
    /// Start a partition that is idle or stopped, from nothing and with a new budget of restarts.
    Start(order::Arguments),
    /// Hold a partition: it gets no windows until it is thawed.
    Freeze(order::Arguments),
    /// Let a held partition go on where it was.
    Thaw(order::Arguments),
    Init(init::Arguments),
    Inject(inject::Arguments),
    Ports(ports::Arguments),
    Ps(ps::Arguments),
    New(new::Arguments),
    Plan(plan::Arguments),
    Record(record::Arguments),
    Run(Box<run::Arguments>),
    /// Change a running module to another schedule, with its next major frame.
    Schedule(order::Schedule),
    Top(top::Arguments),
    Schema(schema::Arguments),
    Show(show::Arguments),
    Why(why::Arguments),
    #[command(flatten)]
    Helper(helper::Helper),
}

impl Verb {
    /// Does it.
    ///
    /// # Errors
    /// It could not begin, or had to be given up.
    pub fn run(self) -> Result<Code> {
        match self {
            Self::Check(arguments) => check::run(&arguments),
            Self::Crash(arguments) => crash::run(&arguments),
            Self::Doctor(arguments) => doctor::run(&arguments),
            Self::Gateway(arguments) => gateway::run(&arguments),
            Self::Health(arguments) => health::run(&arguments),
            Self::Key(arguments) => key::run(&arguments),
            Self::Links(arguments) => links::run(&arguments),
            Self::Logbook(arguments) => logbook::run(&arguments),
            Self::Metrics(arguments) => metrics::run(&arguments),
            Self::Kill(arguments) => order::run(&arguments, |partition| Request::Kill { partition }),
            Self::Stop(arguments) => order::run(&arguments, |partition| Request::Stop { partition }),
            Self::Start(arguments) => order::run(&arguments, |partition| Request::Start { partition }),
            Self::Freeze(arguments) => order::run(&arguments, |partition| Request::Freeze { partition }),
            Self::Thaw(arguments) => order::run(&arguments, |partition| Request::Thaw { partition }),
            Self::Init(arguments) => init::run(&arguments),
            Self::Inject(arguments) => inject::run(&arguments),
            Self::Ports(arguments) => ports::run(&arguments),
            Self::Ps(arguments) => ps::run(&arguments),
            Self::New(arguments) => new::run(&arguments),
            Self::Plan(arguments) => plan::run(&arguments),
            Self::Record(arguments) => record::run(&arguments),
            Self::Run(arguments) => run::run(&arguments),
            Self::Schedule(arguments) => order::schedule(&arguments),
            Self::Top(arguments) => top::run(&arguments),
            Self::Schema(_) => schema::run(),
            Self::Show(arguments) => show::run(&arguments),
            Self::Why(arguments) => why::run(&arguments),
            Self::Helper(helper) => helper::run(&helper),
        }
    }
}
