//! The schedule file: read, checked, and turned into a [`Plan`].
//!
//! Reading takes three steps. The first says what stands in the file, value by value, each with its place. The second resolves it:
//! names become places in lists, and what the file leaves out is filled in. The third holds every rule of [`RULES`] against
//! both. Only a file that breaks no rule of severity error becomes a plan; what is wrong with it is reported all at once.
//!
//! Nothing here touches the machine: whether a core exists or a program can be started is found out elsewhere.

mod catalogue;
mod cycle;
mod defaults;
pub mod facts;
mod findings;
mod latency;
pub mod links;
pub mod planner;
mod raw;
mod reader;
pub mod report;
mod resolve;
mod response;
mod responses;
mod rules;
mod sarif;
mod schema;
mod ways;

pub use catalogue::{RULES, Rule};
pub use facts::Facts;
pub use latency::Visit;
pub use report::{Place, Related, Report, Severity, Violation};
pub use resolve::{RELAY_PREFIX, numbered};
pub use responses::ProcessResponse;
pub use schema::schema;

use bateleur_plan::{Plan, closed, model, timeline, units};
use findings::{Finding, Findings};
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

/// The files with the contents of memory blocks.
pub trait Contents {
    /// Why a file, as the schedule file names it, can not fill a block of `size` bytes; nothing if it can.
    fn fault(&self, file: &str, size: u64) -> Option<String>;
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
    /// The contents of memory blocks; `None` if they are not looked for.
    pub contents: Option<&'a dyn Contents>,
}

impl<'a> Surroundings<'a> {
    /// Message types, and nothing else is looked for.
    #[must_use]
    pub fn of(messages: &'a dyn MessageCatalogue) -> Self {
        Self { messages, programs: None, keys: None, contents: None }
    }
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
    check_among(source_name, text, &Surroundings::of(messages))
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
    let nothing = &Nothing;
    let surroundings =
        Surroundings { messages, programs: Some(nothing), keys: Some(nothing), contents: Some(nothing) };
    let report = match check_among(rule.example_name, rule.example, &surroundings) {
        Ok((_, report)) | Err(report) => report,
    };
    report.first_of(rule.id)
}

/// Where nothing was built yet, and nobody has made a key.
struct Nothing;

/// What is said of every file there.
const NO_FILE: &str = "there is no such file";

impl Programs for Nothing {
    fn fault(&self, _: &str) -> Option<String> {
        Some(NO_FILE.to_owned())
    }
}

impl Keys for Nothing {
    fn fault(&self, _: &str) -> Option<String> {
        Some(NO_FILE.to_owned())
    }
}

impl Contents for Nothing {
    fn fault(&self, _: &str, _: u64) -> Option<String> {
        Some(NO_FILE.to_owned())
    }
}

fn read(text: &str, surroundings: &Surroundings<'_>, findings: &Findings<'_>) -> Option<Plan> {
    let document = raw::parse(text, findings)?;
    let mut file = RawFile::read(document.get_ref(), findings);
    resolve::expand_replicas(&mut file, findings);
    resolve::add_relays(&mut file, findings);
    let &Surroundings { messages, programs, keys, contents } = surroundings;
    rules::open(&file, messages, findings);
    let resolved = resolve::resolve(&file, messages, findings);
    let (plan, nobody) = (&resolved.plan, resolved.nobody);
    rules::check(&rules::Context {
        file: &file,
        plan,
        nobody,
        catalogue: messages,
        programs,
        keys,
        contents,
        findings,
    });
    if findings.has_errors() {
        return None;
    }
    let fault = |why| {
        let message =
            format!("the rules let through what can not be planned ({why}): this is a fault of the checker");
        findings.add(Finding::new(&catalogue::SYNTAX, &(0..0), message, "report it with the file"));
    };
    resolved.into_plan().map_err(fault).ok()
}
