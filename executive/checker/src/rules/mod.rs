//! The rules, by subject. Each looks at the raw file and notes what it finds; none depends on another having passed,
//! and what another rule has reported already is skipped.

mod chains;
mod channels;
mod health;
mod laid;
mod links;
mod modules;
mod names;
mod partitions;
mod periods;
mod ports;
mod processes;
mod schedules;
mod windows;

use super::catalogue::{self, Rule};
use super::findings::{Finding, Findings, Span};
use super::names::Names;
use super::raw::RawFile;
use super::reader::{At, Field};
use super::{Keys, MessageCatalogue, Programs};
use laid::Laid;

/// Opens the folder of message types, before any rule asks for one.
pub(super) fn open(file: &RawFile, messages: &dyn MessageCatalogue, findings: &Findings<'_>) {
    let folder = file.messages.said();
    let start = 0..0;
    let span = folder.map_or(&start, |folder| &folder.span);
    for (wrong, mend) in messages.open(folder.map(|folder| folder.value.as_str())).err().unwrap_or_default() {
        findings.add(Finding::new(&catalogue::MESSAGES_UNUSABLE, span, wrong, mend));
    }
}

/// What every rule sees.
pub(super) struct Context<'a> {
    pub(super) file: &'a RawFile,
    pub(super) names: &'a Names,
    pub(super) catalogue: &'a dyn MessageCatalogue,
    pub(super) programs: Option<&'a dyn Programs>,
    pub(super) keys: Option<&'a dyn Keys>,
    pub(super) findings: &'a Findings<'a>,
}

impl Context<'_> {
    fn add(&self, finding: Finding) {
        self.findings.add(finding);
    }

    fn note(&self, rule: &'static Rule, span: &Span, message: impl Into<String>, mend: impl Into<String>) {
        self.add(Finding::new(rule, span, message, mend));
    }

    /// A port as the file writes it.
    fn port_path(&self, port: usize) -> String {
        super::names::port_path(self.file, &self.file.ports[port])
    }

    fn partition_name(&self, partition: usize) -> &str {
        &self.file.partitions[partition].name.value
    }

    /// Notes a number that is not in `low..=high`.
    fn in_range(&self, what: &str, field: &Field<u32>, low: u32, high: u32) {
        if let Some(number) = field.said() {
            self.at_in_range(what, number, low, high);
        }
    }

    fn at_in_range(&self, what: &str, number: &At<u32>, low: u32, high: u32) {
        if !(low..=high).contains(&number.value) {
            let message = format!("`{what}` is {}", number.value);
            let mend = if high == u32::MAX {
                format!("write a number of at least {low}")
            } else {
                format!("write a number from {low} to {high}")
            };
            self.note(&catalogue::OUT_OF_RANGE, &number.span, message, mend);
        }
    }
}

/// Runs every rule.
pub(super) fn check(cx: &Context<'_>) {
    let laid: Vec<Laid> = cx.file.schedules.iter().map(|schedule| Laid::of(cx, schedule)).collect();
    names::check(cx);
    modules::check(cx, &laid);
    partitions::check(cx);
    schedules::check(cx);
    windows::check(cx, &laid);
    periods::check(cx, &laid);
    processes::check(cx, &laid);
    ports::check(cx);
    channels::check(cx, &laid);
    links::check(cx, &laid);
    chains::check(cx, &laid);
    health::check(cx);
}
