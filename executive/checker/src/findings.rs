//! Where readers and rules leave what they find.

use std::cell::RefCell;
use std::ops::Range;

use super::catalogue::Rule;
use super::reader::Key;
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

/// A table and the keys that it was asked for.
type TableKeys = (String, Vec<Key>);

/// Everything found so far in one source.
pub(super) struct Findings<'a> {
    text: &'a str,
    list: RefCell<Vec<Violation>>,
    /// What each table was asked for, where somebody wants to know.
    keys: Option<RefCell<Vec<TableKeys>>>,
}

impl<'a> Findings<'a> {
    pub(super) fn new(text: &'a str) -> Self {
        Self { text, list: RefCell::default(), keys: None }
    }

    /// What stands at a place of the source.
    pub(super) fn source(&self, span: &Span) -> &'a str {
        self.text.get(span.clone()).unwrap_or_default()
    }

    /// For what is only tried: the same source, and nothing found in it.
    pub(super) fn aside(&self) -> Self {
        Self::new(self.text)
    }

    /// The same, which also keeps what each table is asked for.
    pub(super) fn with_keys(text: &'a str) -> Self {
        Self { keys: Some(RefCell::default()), ..Self::new(text) }
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
        self.list.borrow_mut().push(Violation {
            rule: finding.rule.id,
            severity: finding.rule.severity,
            message: finding.message,
            place: place(&finding.span),
            related: related.map(|(span, label)| Related { place: place(&span), label }).collect(),
            mend: finding.mend,
        });
    }

    /// Whether anything found forbids a plan.
    pub(super) fn has_errors(&self) -> bool {
        self.list.borrow().iter().any(|violation| violation.severity == Severity::Error)
    }

    pub(super) fn into_violations(self) -> Vec<Violation> {
        self.list.into_inner()
    }
}
