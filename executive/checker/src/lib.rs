//! The schedule file: read, checked, and turned into a [`Plan`].
//!
//! Reading takes two steps. The first says what stands in the file, value by value, each with its place; the second
//! looks names up and holds every rule of [`RULES`] against it. Only a file that breaks no rule of severity error
//! becomes a plan; what is wrong with it is reported all at once.
//!
//! Nothing here touches the machine: whether a core exists or a program can be started is found out elsewhere.

mod build;
mod catalogue;
mod cycle;
mod defaults;
pub mod facts;
mod findings;
mod latency;
pub mod links;
mod names;
pub mod planner;
mod processes;
mod raw;
mod reader;
mod relays;
pub mod report;
mod response;
mod responses;
mod rules;
mod sarif;
mod schema;

pub use catalogue::{RULES, Rule};
pub use facts::Facts;
pub use latency::Visit;
pub use report::{Place, Related, Report, Severity, Violation};
pub use responses::ProcessResponse;
pub use schema::schema;

use bateleur_plan::{Plan, closed, model, timeline, units};
use findings::{Finding, Findings};
use names::Names;
use raw::RawFile;

/// The message types that ports may name.
pub trait MessageCatalogue {
    /// Takes the types of `folder`, as the file names it, beside those that it has anyway; `None`: the file names none. Asked once for
    /// each file, before everything else.
    ///
    /// # Errors
    /// Why they can not be used, each with how to mend it.
    fn open(&self, _folder: Option<&str>) -> Result<(), Vec<(String, String)>> {
        Ok(())
    }
    /// The size of a message type in bytes, or nothing if there is no such type.
    fn size_of(&self, name: &str) -> Option<usize>;
    /// A number that differs where the fields of a message type differ, so that a partition that was built with others is
    /// found; 0: its fields are not known.
    fn layout_of(&self, _name: &str) -> u32 {
        0
    }
    /// The text of a message type and of those within it; nothing if its fields are not known.
    fn definition_of(&self, _name: &str) -> Option<String> {
        None
    }
    /// The name of every message type.
    fn names(&self) -> Vec<&str>;
}

/// The programs that partitions may name.
pub trait Programs {
    /// Why a program, as the file writes it, can not be started; nothing if it can.
    fn fault(&self, program: &str) -> Option<String>;
}

/// The files with the keys of links.
pub trait Keys {
    /// Why a key's file, as the schedule file names it, can not be used here; nothing if it can.
    fn fault(&self, file: &str) -> Option<String>;
}

/// What a file refers to and does not hold itself.
#[derive(Clone, Copy)]
pub struct Surroundings<'a> {
    /// The message types.
    pub messages: &'a dyn MessageCatalogue,
    /// The programs; `None` if they are not looked for.
    pub programs: Option<&'a dyn Programs>,
    /// The files with keys; `None` if they are not looked for.
    pub keys: Option<&'a dyn Keys>,
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
    check_among(source_name, text, &Surroundings { messages, programs: None, keys: None })
}

/// As [`check_with_warnings`], with everything that the file may refer to.
///
/// # Errors
/// Everything that is wrong with the file, if anything forbids a plan.
pub fn check_among(
    source_name: &str,
    text: &str,
    surroundings: &Surroundings<'_>,
) -> Result<(Plan, Report), Report> {
    let findings = Findings::new(text, schema::tables_with);
    let plan = read(text, surroundings, &findings);
    let report = Report::new(source_name, text, findings.into_violations());
    match plan {
        Some(plan) => Ok((plan, report)),
        None => Err(report),
    }
}

/// A violation of `rule` as the checker reports it, from a file that was written to break it.
///
/// None only for an id that is none of [`RULES`].
#[must_use]
pub fn example_of(rule: &Rule, messages: &dyn MessageCatalogue) -> Option<Report> {
    let surroundings = Surroundings { messages, programs: Some(&NoPrograms), keys: Some(&NoKeys) };
    let report = match check_among(rule.example_name, rule.example, &surroundings) {
        Ok((_, report)) | Err(report) => report,
    };
    report.first_of(rule.id)
}

/// Where nothing was built yet.
struct NoPrograms;

impl Programs for NoPrograms {
    fn fault(&self, _: &str) -> Option<String> {
        Some("there is no such file".to_owned())
    }
}

/// Where nobody has made a key yet.
struct NoKeys;

impl Keys for NoKeys {
    fn fault(&self, _: &str) -> Option<String> {
        Some("there is no such file".to_owned())
    }
}

fn read(text: &str, surroundings: &Surroundings<'_>, findings: &Findings<'_>) -> Option<Plan> {
    let document = raw::parse(text, findings)?;
    let mut file = RawFile::read(document.get_ref(), findings);
    relays::add(&mut file);
    let names = Names::of(&file);
    let catalogue = surroundings.messages;
    rules::open(&file, catalogue, findings);
    let &Surroundings { programs, keys, .. } = surroundings;
    rules::check(&rules::Context { file: &file, names: &names, catalogue, programs, keys, findings });
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
