//! This partition is a replica, and its voter runs on another module. What the voter says of it is handed on to the executive here.

use bateleur_contract::{ControlPage, ReportKind};

use crate::raw::RawSamplingDestination;

/// The port through which the voter speaks.
pub(crate) struct Verdicts {
    port: RawSamplingDestination,
    /// When the first window began, module time, ns.
    begun_ns: Option<u64>,
}

impl Verdicts {
    pub(crate) fn new(port: RawSamplingDestination) -> Self {
        Self { port, begun_ns: None }
    }

    /// Hands on what has come until this window. What the process before this one wrote is not held against this one.
    pub(crate) fn hand_on(&mut self, page: &ControlPage, window_start_ns: u64) {
        let begun_ns = *self.begun_ns.get_or_insert(window_start_ns);
        let Some(verdict) = self.port.read() else { return };
        if verdict.updated && verdict.stamp.source_ns >= begun_ns {
            page.report(ReportKind::FirstOutvoted, &String::from_utf8_lossy(verdict.bytes));
        }
    }
}
