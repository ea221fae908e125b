//! The verbs.

pub(crate) mod air;
pub(crate) mod airframe;
pub(crate) mod bench;
pub(crate) mod campaign;
pub(crate) mod check;
pub(crate) mod compare;
pub(crate) mod completions;
pub(crate) mod doctor;
pub(crate) mod export;
pub(crate) mod faults;
pub(crate) mod fly;
pub(crate) mod gateway;
pub(crate) mod ground;
pub(crate) mod health;
pub(crate) mod helper;
pub(crate) mod inject;
pub(crate) mod key;
pub(crate) mod links;
pub(crate) mod man;
pub(crate) mod new;
pub(crate) mod order;
pub(crate) mod plan;
pub(crate) mod ports;
pub(crate) mod ps;
pub(crate) mod record;
pub(crate) mod replay;
pub(crate) mod run;
pub(crate) mod schema;
pub(crate) mod show;
pub(crate) mod target;
pub(crate) mod top;

use std::process::ExitCode;

/// How a verb ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Code(u8);

/// Fine.
pub(crate) const FINE: Code = Code(0);
/// It ran, and something was wrong.
pub(crate) const WRONG: Code = Code(1);
/// It could not run.
pub(crate) const CANNOT_RUN: Code = Code(2);

impl From<Code> for ExitCode {
    fn from(code: Code) -> Self {
        Self::from(code.0)
    }
}

/// What a listing prints.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum Format {
    /// For a person.
    Text,
    /// For a program.
    Json,
}
