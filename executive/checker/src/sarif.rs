//! The report in the Static Analysis Results Interchange Format, version 2.1.0 (OASIS), which editors and code hosts show
//! beside the source.

use serde_json::{Value, json};

use super::catalogue::RULES;
use super::report::{Place, Report, Severity, Violation};

/// Where the format's own description lies.
const SCHEMA: &str =
    "https://docs.oasis-open.org/sarif/sarif/v2.1.0/errata01/os/schemas/sarif-schema-2.1.0.json";

impl Report {
    /// The report as SARIF 2.1.0, for tools that show findings beside the source.
    #[must_use]
    pub fn to_sarif(&self) -> Value {
        document(self)
    }
}

/// The whole document: one run with every rule and every finding.
fn document(report: &Report) -> Value {
    json!({
        "$schema": SCHEMA,
        "version": "2.1.0",
        "runs": [{
            "tool": { "driver": {
                "name": "bateleur check",
                "version": env!("CARGO_PKG_VERSION"),
                "rules": RULES.iter().map(|rule| json!({
                    "id": rule.id,
                    "shortDescription": { "text": rule.reason },
                    "defaultConfiguration": { "level": level(rule.severity) },
                })).collect::<Vec<_>>(),
            } },
            "columnKind": "unicodeCodePoints",
            "artifacts": [{ "location": { "uri": uri(report.source_name()) } }],
            "results": report.violations().iter().map(|violation| result(report, violation)).collect::<Vec<_>>(),
        }],
    })
}

fn level(severity: Severity) -> &'static str {
    match severity {
        Severity::Error => "error",
        Severity::Warning => "warning",
        Severity::Note => "note",
    }
}

fn result(report: &Report, violation: &Violation) -> Value {
    let related = violation.related.iter().enumerate().map(|(place, related)| {
        let mut location = location(report, &related.place);
        location["id"] = json!(place + 1);
        location["message"] = json!({ "text": related.label });
        location
    });
    json!({
        "ruleId": violation.rule,
        "ruleIndex": RULES.iter().position(|rule| rule.id == violation.rule),
        "level": level(violation.severity),
        "message": { "text": format!("{}\nHelp: {}", violation.message, violation.mend) },
        "locations": [location(report, &violation.place)],
        "relatedLocations": related.collect::<Vec<_>>(),
    })
}

fn location(report: &Report, place: &Place) -> Value {
    let (end_line, end_column) = report.end_of(place);
    json!({ "physicalLocation": {
        "artifactLocation": { "uri": uri(report.source_name()), "index": 0 },
        "region": {
            "startLine": place.line,
            "startColumn": place.column,
            "endLine": end_line,
            "endColumn": end_column,
        },
    } })
}

/// A path as a reference: what the format does not allow in one is written by its bytes.
fn uri(path: &str) -> String {
    let mut uri = String::new();
    for byte in path.bytes() {
        if byte.is_ascii_alphanumeric() || b"/._-~".contains(&byte) {
            uri.push(char::from(byte));
        } else {
            uri.push_str(&format!("%{byte:02X}"));
        }
    }
    uri
}

#[cfg(test)]
mod tests {
    use super::uri;

    #[test]
    fn spaces_and_letters_beyond_ascii_are_written_by_their_bytes() {
        assert_eq!(uri("a b/ä.toml"), "a%20b/%C3%A4.toml");
        assert_eq!(uri("../tests/schedule.toml"), "../tests/schedule.toml");
    }
}
