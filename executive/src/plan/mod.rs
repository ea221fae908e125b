//! The schedule file: read, checked, and turned into a [`Plan`].
//!
//! Reading takes two steps. The first says what stands in the file, value by value, each with its place; the second
//! looks names up and holds every rule of [`RULES`] against it. Only a file that breaks no rule of severity error
//! becomes a plan; what is wrong with it is reported all at once.
//!
//! Nothing here touches the machine: whether a core exists or a program can be started is found out elsewhere.

mod build;
mod catalogue;
pub mod closed;
mod findings;
pub mod model;
mod names;
mod raw;
mod reader;
pub mod report;
mod rules;
pub mod timeline;
pub mod units;

pub use catalogue::{RULES, Rule};
pub use closed::{
    ChangeAction, Closed, Direction, Exhausted, Kind, ModuleAction, ModuleError, PartitionAction,
    PartitionError, StartMode,
};
pub use model::{
    Attribute, Chain, Channel, ChannelId, Health, Module, ModuleHealth, ModuleId, ModuleView, Partition,
    PartitionHealth, PartitionId, Payload, Plan, Port, PortId, Restart, Role, Schedule, ScheduleId, Window,
};
pub use report::{Place, Related, Report, Severity, Violation};
pub use timeline::{CoreTimeline, Timeline, TimelineWindow};

pub(crate) use findings::did_you_mean;
use findings::{Finding, Findings};
use names::Names;
use raw::RawFile;

/// The message types that ports may name.
pub trait MessageCatalogue {
    /// The size of a message type in bytes, or nothing if there is no such type.
    fn size_of(&self, name: &str) -> Option<usize>;
    /// The name of every message type.
    fn names(&self) -> Vec<&str>;
}

/// Reads and checks a schedule file; `source_name` is what the report calls it.
///
/// # Errors
/// Everything that is wrong with the file, if anything forbids a plan.
pub fn check(source_name: &str, text: &str, messages: &dyn MessageCatalogue) -> Result<Plan, Report> {
    check_with_warnings(source_name, text, messages).map(|(plan, _)| plan)
}

/// As [`check`], with a report of the warnings beside the plan.
///
/// # Errors
/// Everything that is wrong with the file, if anything forbids a plan.
pub fn check_with_warnings(
    source_name: &str,
    text: &str,
    messages: &dyn MessageCatalogue,
) -> Result<(Plan, Report), Report> {
    let findings = Findings::new(text);
    let plan = read(text, messages, &findings);
    let report = Report::new(source_name, text, findings.into_violations());
    match plan {
        Some(plan) => Ok((plan, report)),
        None => Err(report),
    }
}

fn read(text: &str, catalogue: &dyn MessageCatalogue, findings: &Findings<'_>) -> Option<Plan> {
    let document = raw::parse(text, findings)?;
    let file = RawFile::read(document.get_ref(), findings);
    let names = Names::of(&file);
    rules::check(&rules::Context { file: &file, names: &names, catalogue, findings });
    if findings.has_errors() {
        return None;
    }
    let plan = build::plan(&file, &names, catalogue);
    if plan.is_none() {
        let message = "the rules let through what cannot be planned: this is a fault of the checker";
        findings.add(Finding::new(&catalogue::SYNTAX, &(0..0), message, "report it with the file"));
    }
    plan
}
