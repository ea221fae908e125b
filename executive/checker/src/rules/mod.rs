//! The rules, by subject. Each judges what the file means, looks at the raw file for the places of what it finds, and depends on no
//! other having passed; what has been reported already is skipped.

mod chains;
mod channels;
mod health;
mod links;
mod memory_blocks;
mod modules;
mod names;
mod partitions;
mod periods;
mod ports;
mod processes;
mod replicas;
mod schedules;
mod windows;

use super::catalogue::{self, Rule};
use super::findings::{Finding, Findings, Span};
use super::model::{LinkId, ModuleId, PartitionId, Plan, Schedule};
use super::raw::{RawFile, RawLink, RawModule, RawPartition, RawSchedule, RawWindow};
use super::reader::{At, Field};
use super::resolve::Nobody;
use super::{Contents, Keys, MessageCatalogue, Programs};

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
    /// What it means. Its lists have the tables of the file at the same places.
    pub(super) plan: &'a Plan,
    /// What names mean that lead nowhere.
    pub(super) nobody: Nobody,
    pub(super) catalogue: &'a dyn MessageCatalogue,
    pub(super) programs: Option<&'a dyn Programs>,
    pub(super) keys: Option<&'a dyn Keys>,
    pub(super) contents: Option<&'a dyn Contents>,
    pub(super) findings: &'a Findings<'a>,
}

impl<'a> Context<'a> {
    fn add(&self, finding: Finding) {
        self.findings.add(finding);
    }

    fn note(&self, rule: &'static Rule, span: &Span, message: impl Into<String>, mend: impl Into<String>) {
        self.add(Finding::new(rule, span, message, mend));
    }

    fn modules(&self) -> impl Iterator<Item = (ModuleId, &'a RawModule)> + use<'a> {
        self.file.modules.iter().enumerate().map(|(place, raw)| (ModuleId(place), raw))
    }

    fn links(&self) -> impl Iterator<Item = (LinkId, &'a RawLink)> + use<'a> {
        self.file.links.iter().enumerate().map(|(place, raw)| (LinkId(place), raw))
    }

    fn partitions(&self) -> impl Iterator<Item = (PartitionId, &'a RawPartition)> + use<'a> {
        self.file.partitions.iter().enumerate().map(|(place, raw)| (PartitionId(place), raw))
    }

    fn schedules(&self) -> impl Iterator<Item = (&'a RawSchedule, &'a Schedule)> + use<'a> {
        self.file.schedules.iter().zip(&self.plan.schedules)
    }

    /// The windows of a partition in a schedule, as the file writes them.
    fn windows_of(
        &self,
        (raw, schedule): (&'a RawSchedule, &'a Schedule),
        partition: PartitionId,
    ) -> impl Iterator<Item = &'a RawWindow> + use<'a> {
        let windows = raw.windows.iter().zip(&schedule.windows);
        windows.filter(move |(_, window)| window.partition == partition).map(|(raw, _)| raw)
    }

    /// The module of a partition, if it is known.
    fn module_of(&self, partition: PartitionId) -> Option<ModuleId> {
        Some(self.plan[partition].module).filter(|module| *module != self.nobody.module)
    }

    fn module_name(&self, module: ModuleId) -> &'a str {
        &self.plan[module].name
    }

    fn partition_name(&self, partition: PartitionId) -> &'a str {
        &self.plan[partition].name
    }

    /// Whether a schedule has a window of nobody known: one that seems to be missing may be meant by it.
    fn has_window_of_nobody(&self, schedule: &Schedule) -> bool {
        schedule.runs(self.nobody.partition)
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
    names::check(cx);
    modules::check(cx);
    partitions::check(cx);
    schedules::check(cx);
    windows::check(cx);
    periods::check(cx);
    processes::check(cx);
    replicas::check(cx);
    ports::check(cx);
    channels::check(cx);
    memory_blocks::check(cx);
    links::check(cx);
    chains::check(cx);
    health::check(cx);
}
