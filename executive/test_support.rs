//! What the tests of the executive share.

#![allow(dead_code, clippy::panic)] // each takes a part of it

use bateleur_checker::{MessageCatalogue, check};
use bateleur_plan::Plan;

/// A catalogue of no messages: the schedules of these tests have no ports.
pub(crate) struct NoMessages;

impl MessageCatalogue for NoMessages {
    fn size_of(&self, _: &str) -> Option<usize> {
        None
    }

    fn names(&self) -> Vec<&str> {
        Vec::new()
    }
}

/// The plan of a schedule file's text, which must be without a fault.
pub(crate) fn plan_of(text: &str) -> Plan {
    check("test.toml", text, &NoMessages).unwrap_or_else(|report| panic!("{}", report.render(false)))
}
