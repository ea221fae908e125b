//! What the checker has to say: violations with their places, as text for people and as JSON for programs.

use std::ops::Range;

use annotate_snippets::{AnnotationKind, Level, Renderer, Snippet};
use serde::Serialize;
use serde_json::{Value, json};

/// How bad a violation is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Severity {
    /// There is no plan.
    Error,
    /// There is a plan, and it is probably not the one that was meant.
    Warning,
    /// There is a plan, and this is worth knowing about it.
    Note,
}

/// A stretch of the source.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Place {
    /// The bytes.
    #[serde(serialize_with = "serialize_span")]
    pub span: Range<usize>,
    /// The line of the first byte, counted from one.
    pub line: usize,
    /// The column of the first byte in characters, counted from one.
    pub column: usize,
}

/// Another place that a violation involves.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Related {
    /// Where it is.
    #[serde(flatten)]
    pub place: Place,
    /// What is there.
    pub label: String,
}

/// One rule that the source breaks at one place.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Violation {
    /// The rule's id, such as `T03-window-overlap`.
    pub rule: &'static str,
    /// How bad it is.
    pub severity: Severity,
    /// What is wrong, with the names and values in it.
    pub message: String,
    /// Where it is.
    #[serde(flatten)]
    pub place: Place,
    /// The other places involved.
    pub related: Vec<Related>,
    /// How to mend it.
    pub mend: String,
}

/// Every violation found in one source, in the order of the source.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Report {
    source_name: String,
    text: String,
    violations: Vec<Violation>,
}

impl Report {
    pub(crate) fn new(source_name: &str, text: &str, mut violations: Vec<Violation>) -> Self {
        violations.sort_by(|a, b| (a.place.span.start, a.rule).cmp(&(b.place.span.start, b.rule)));
        Self { source_name: source_name.to_owned(), text: text.to_owned(), violations }
    }

    /// The violations, in the order of the source.
    #[must_use]
    pub fn violations(&self) -> &[Violation] {
        &self.violations
    }

    /// The report of some of the violations; `None`: there is none of these.
    #[must_use]
    pub fn only(self, wanted: impl Fn(&Violation) -> bool) -> Option<Self> {
        let violations: Vec<Violation> = self.violations.into_iter().filter(wanted).collect();
        (!violations.is_empty()).then_some(Self { violations, ..self })
    }

    /// How many violations forbid a plan.
    #[must_use]
    pub fn errors(&self) -> usize {
        self.count(Severity::Error)
    }

    /// How many violations leave the plan as it is.
    #[must_use]
    pub fn warnings(&self) -> usize {
        self.count(Severity::Warning)
    }

    /// How many violations are only worth knowing.
    #[must_use]
    pub fn notes(&self) -> usize {
        self.count(Severity::Note)
    }

    /// The report for people: each error, then each warning, with its lines of the source, then the totals. Empty where there
    /// is neither.
    #[must_use]
    pub fn render(&self, color: bool) -> String {
        self.render_down_to(Severity::Warning, color)
    }

    /// As [`Report::render`], notes included.
    #[must_use]
    pub fn render_all(&self, color: bool) -> String {
        self.render_down_to(Severity::Note, color)
    }

    fn render_down_to(&self, least: Severity, color: bool) -> String {
        let renderer = if color { Renderer::styled() } else { Renderer::plain() };
        let mut out = String::new();
        let mut shown: Vec<&Violation> =
            self.violations.iter().filter(|violation| violation.severity <= least).collect();
        // What forbids a plan is not to be looked for among what does not.
        shown.sort_by_key(|violation| violation.severity);
        for violation in shown {
            out.push_str(&self.render_one(violation, &renderer));
            out.push_str("\n\n");
        }
        if !out.is_empty() {
            let notes = if least == Severity::Note && self.notes() > 0 {
                format!(", {}", counted(self.notes(), "note"))
            } else {
                String::new()
            };
            out.push_str(&format!("{}: {}{notes}\n", self.source_name, self.totals()));
        }
        out
    }

    /// Errors and warnings, counted.
    #[must_use]
    pub fn totals(&self) -> String {
        format!("{}, {}", counted(self.errors(), "error"), counted(self.warnings(), "warning"))
    }

    /// What the source is called.
    #[must_use]
    pub fn source_name(&self) -> &str {
        &self.source_name
    }

    /// The first violation of one rule, alone.
    pub(crate) fn first_of(mut self, rule: &str) -> Option<Self> {
        self.violations.retain(|violation| violation.rule == rule);
        self.violations.truncate(1);
        (!self.violations.is_empty()).then_some(self)
    }

    /// One violation alone, with its lines of the source and without totals.
    #[must_use]
    pub fn render_first(&self, color: bool) -> String {
        let renderer = if color { Renderer::styled() } else { Renderer::plain() };
        self.violations.first().map_or_else(String::new, |violation| self.render_one(violation, &renderer))
    }

    /// The report for programs.
    #[must_use]
    pub fn to_json(&self) -> Value {
        json!({
            "source": self.source_name,
            "errors": self.errors(),
            "warnings": self.warnings(),
            "notes": self.notes(),
            "violations": self.violations,
        })
    }

    /// The line and column, both from one, behind the last character of a place.
    pub(crate) fn end_of(&self, place: &Place) -> (usize, usize) {
        let end = Place::in_text(&self.text, &(place.span.end..place.span.end));
        (end.line, end.column)
    }

    fn count(&self, severity: Severity) -> usize {
        self.violations.iter().filter(|violation| violation.severity == severity).count()
    }

    fn render_one(&self, violation: &Violation, renderer: &Renderer) -> String {
        let level = match violation.severity {
            Severity::Error => Level::ERROR,
            Severity::Warning => Level::WARNING,
            Severity::Note => Level::NOTE,
        };
        let primary = AnnotationKind::Primary.span(violation.place.span.clone());
        let others = violation.related.iter().map(|related| {
            AnnotationKind::Context.span(related.place.span.clone()).label(related.label.as_str())
        });
        let snippet = Snippet::source(self.text.as_str())
            .path(self.source_name.as_str())
            .annotation(primary)
            .annotations(others);
        let title = level.primary_title(violation.message.as_str()).id(violation.rule);
        renderer.render(&[title.element(snippet).element(Level::HELP.message(violation.mend.as_str()))])
    }
}

impl std::fmt::Display for Report {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(&self.render(false))
    }
}

impl std::error::Error for Report {}

impl Place {
    /// The place of a span of `text`; a span past the end becomes the end.
    pub(crate) fn in_text(text: &str, span: &Range<usize>) -> Self {
        let start = floor(text, span.start);
        let end = floor(text, span.end).max(start);
        let line_start = text[..start].rfind('\n').map_or(0, |newline| newline + 1);
        Self {
            span: start..end,
            line: text[..start].matches('\n').count() + 1,
            column: text[line_start..start].chars().count() + 1,
        }
    }
}

/// The last character boundary at or before `byte`.
fn floor(text: &str, byte: usize) -> usize {
    let byte = byte.min(text.len());
    (0..=byte).rev().find(|&at| text.is_char_boundary(at)).unwrap_or(0)
}

fn counted(count: usize, noun: &str) -> String {
    if count == 1 { format!("1 {noun}") } else { format!("{count} {noun}s") }
}

fn serialize_span<S: serde::Serializer>(span: &Range<usize>, serializer: S) -> Result<S::Ok, S::Error> {
    [span.start, span.end].serialize(serializer)
}
