//! Where readers and rules leave what they find.

use std::cell::RefCell;
use std::ops::Range;

use serde_json::Value;

use super::catalogue::Rule;
use super::report::{Place, Related, Severity, Violation};

/// A stretch of the source, in bytes.
pub(super) type Span = Range<usize>;

/// One violation on its way into the report.
#[derive(Debug)]
#[must_use]
pub(super) struct Finding {
    rule: &'static Rule,
    span: Span,
    message: String,
    mend: String,
    related: Vec<(Span, String)>,
}

impl Finding {
    /// A violation of `rule` at `span`, and how to mend it.
    pub(super) fn new(
        rule: &'static Rule,
        span: &Span,
        message: impl Into<String>,
        mend: impl Into<String>,
    ) -> Self {
        let (message, mend) = (message.into(), mend.into());
        Self { rule, span: span.clone(), message, mend, related: Vec::new() }
    }

    /// Another place that is involved.
    pub(super) fn also(mut self, span: &Span, label: impl Into<String>) -> Self {
        self.related.push((span.clone(), label.into()));
        self
    }
}

/// A key that a table was asked for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Key {
    pub(super) name: &'static str,
    pub(super) required: bool,
    pub(super) under: Under,
}

/// What belongs under a key.
#[derive(Clone, Copy, Debug)]
pub(super) enum Under {
    /// A value with this JSON schema.
    Value(fn() -> Value),
    /// A table, or entries with names of their own.
    Table,
    /// A list of tables.
    Tables,
}

/// A table and the keys that it was asked for.
type TableKeys = (String, Vec<Key>);

/// Everything found so far in one source.
pub(super) struct Findings<'a> {
    text: &'a str,
    /// The tables that know a key of this name.
    tables_with: fn(&str) -> Vec<String>,
    list: RefCell<Vec<Violation>>,
    /// What each table was asked for, where somebody wants to know.
    keys: Option<RefCell<Vec<TableKeys>>>,
}

impl<'a> Findings<'a> {
    /// In `text`; `tables_with` gives the tables that know a key, for messages.
    pub(super) fn new(text: &'a str, tables_with: fn(&str) -> Vec<String>) -> Self {
        Self { text, tables_with, list: RefCell::default(), keys: None }
    }

    /// The tables that know a key of this name, as messages call them.
    pub(super) fn tables_with(&self, key: &str) -> Vec<String> {
        (self.tables_with)(key)
    }

    /// What stands at a place of the source.
    pub(super) fn source(&self, span: &Span) -> &'a str {
        self.text.get(span.clone()).unwrap_or_default()
    }

    /// For what is only tried: the same source, and nothing found in it.
    pub(super) fn aside(&self) -> Self {
        Self::new(self.text, self.tables_with)
    }

    /// The same, which also keeps what each table is asked for.
    pub(super) fn with_keys(text: &'a str) -> Self {
        Self { keys: Some(RefCell::default()), ..Self::new(text, |_| Vec::new()) }
    }

    /// A table has been read: all that it was asked for.
    pub(super) fn asked(&self, table: String, keys: Vec<Key>) {
        if let Some(kept) = &self.keys {
            kept.borrow_mut().push((table, keys));
        }
    }

    /// What each table was asked for.
    pub(super) fn into_keys(self) -> Vec<TableKeys> {
        self.keys.map(RefCell::into_inner).unwrap_or_default()
    }

    /// Notes a violation.
    pub(super) fn add(&self, finding: Finding) {
        let place = |span: &Span| Place::in_text(self.text, span);
        let related = finding.related.into_iter();
        let violation = Violation {
            rule: finding.rule.id,
            severity: finding.rule.severity,
            message: finding.message,
            place: place(&finding.span),
            related: related.map(|(span, label)| Related { place: place(&span), label }).collect(),
            mend: finding.mend,
        };
        // What holds for three replicas stands in the file once.
        let mut list = self.list.borrow_mut();
        if !list.contains(&violation) {
            list.push(violation);
        }
    }

    /// Whether this rule is violated somewhere.
    pub(super) fn has(&self, rule: &Rule) -> bool {
        self.list.borrow().iter().any(|violation| violation.rule == rule.id)
    }

    /// Whether anything found forbids a plan.
    pub(super) fn has_errors(&self) -> bool {
        self.list.borrow().iter().any(|violation| violation.severity == Severity::Error)
    }

    pub(super) fn into_violations(self) -> Vec<Violation> {
        self.list.into_inner()
    }
}
