//! What partitions report by their control pages, and what they are told there of the health log.

use bateleur_contract::{ReportKind, Reported};

use super::repeats::{Repeats, Untold};
use super::watched::Watched;
use super::{Monitor, seconds};
use crate::event::Event;
use bateleur_plan::{Closed, PartitionError, PartitionState};

impl Monitor {
    /// Takes what the partition has reported since the last look.
    pub(super) fn take_reports(&mut self, place: usize, module_ns: u64) {
        let watched = &mut self.watched[place];
        if watched.sandbox.control.page.reports_so_far() == watched.reports_seen {
            return;
        }
        let reports = watched.sandbox.control.page.reports_since(&mut watched.reports_seen);
        for Reported { kind, in_handler, text } in reports {
            // The word about the state is of the report's time: by now the handler may have come back.
            let state = in_handler.then_some(PartitionState::Handler);
            // One burst of errors is one fault where it ends the process: the rest must not use up its budget.
            if !self.watched[place].is_alive() && kind != ReportKind::Message {
                continue;
            }
            match kind {
                ReportKind::Message => self.take_message(place, text, module_ns),
                ReportKind::ApplicationError => {
                    self.fault_in(place, PartitionError::ApplicationError, state, text, module_ns);
                }
                ReportKind::PortError => {
                    self.fault_in(place, PartitionError::PortError, state, text, module_ns);
                }
            }
        }
    }

    /// REPORT_APPLICATION_MESSAGE: recorded and passed on, within bounds.
    fn take_message(&mut self, place: usize, text: String, module_ns: u64) {
        let watched = &mut self.watched[place];
        if let Some(text) = watched.messages.record(&text, module_ns) {
            self.health_log.note_message(&watched.sandbox.name, watched.generation, text, module_ns);
        }
        if watched.may_speak(module_ns) {
            let partition = watched.sandbox.name.clone();
            self.events.tell(&Event::Message { time_s: seconds(module_ns), partition, text });
        }
    }

    /// Makes an entry of the errors that had none of their own, where it is time to, or where `all` says so.
    pub(super) fn tell_repeats(&mut self, place: usize, module_ns: u64, all: bool) {
        while let Some(untold) = self.watched[place].repeats.take_untold(module_ns, all) {
            let Untold { error, decision, detail } = untold;
            let fault = self.entry(place, error.name(), decision, detail, module_ns);
            self.tell_fault(place, &fault);
            self.health_log.write(&fault);
        }
        let watched = &mut self.watched[place];
        if all && let more @ 1.. = watched.messages.take_unrecorded() {
            let text = format!("{more} more are not recorded");
            self.health_log.note_message(&watched.sandbox.name, watched.generation, text, module_ns);
        }
    }

    /// What an incarnation said again and again is told as its own, before its successor begins.
    pub(super) fn close_series(&mut self, place: usize, module_ns: u64) {
        self.tell_repeats(place, module_ns, true);
        self.watched[place].repeats = Repeats::default();
    }

    /// Tells those partitions of the health log's new entries that the plan lets know: also a process that stands by, so that it
    /// goes on with the same count.
    pub(super) fn tell_partitions(&mut self) {
        let notices = self.health_log.take_notices();
        if notices.is_empty() {
            return;
        }
        let told = self.watched.iter().filter(|watched| self.plan[watched.sandbox.id].health_texts);
        for page in told.flat_map(Watched::pages) {
            notices.iter().for_each(|notice| page.notify(notice.severity, &notice.text));
        }
    }
}
