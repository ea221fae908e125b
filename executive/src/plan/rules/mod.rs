//! The rules, by subject. Each looks at the raw file and notes what it finds; none depends on another having run.

pub(super) mod chains;

use super::MessageCatalogue;
use super::findings::{Finding, Findings};
use super::names::Names;
use super::raw::RawFile;

/// What every rule sees.
pub(super) struct Context<'a> {
    pub(super) file: &'a RawFile,
    pub(super) names: &'a Names,
    pub(super) catalogue: &'a dyn MessageCatalogue,
    pub(super) findings: &'a Findings<'a>,
}

impl Context<'_> {
    fn add(&self, finding: Finding) {
        self.findings.add(finding);
    }
}

/// Runs every rule.
pub(super) fn check(cx: &Context<'_>) {
    chains::check(cx);
}
