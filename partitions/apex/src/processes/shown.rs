//! What a partition shows of its processes: who ran when, and how each was at the end of the last window.
//!
//! A change of the running process costs a word and three sums; the table is written once a window. Where the executive handed no
//! table, as in tests, nothing is shown.

use std::sync::Arc;

use bateleur_contract::process_table::{
    HANDLER_NAME, HANDLER_PLACE, PLACES, ProcessRow, ProcessState, Switch,
};
use bateleur_contract::{Mapped, ProcessTable, ReportKind, ToldError};
use bateleur_processes::standard::{MAIN_PROCESS_ID, MAX_PROCESSES, ProcessId, SystemTime};
use bateleur_processes::{Dispatch, Partition, Runner};

use super::baton::Baton;
use super::kernel::{FIRST_PROCESS, HANDLER, MAIN};
use super::stack::Looker;

// Places of batons are those of the table.
const _: () = assert!(PLACES == MAX_PROCESSES + 1 && MAIN == 0 && HANDLER == HANDLER_PLACE as usize);

/// See the module's head. Places are those of batons.
#[derive(Default)]
pub(crate) struct Shown {
    table: Option<Mapped<ProcessTable>>,
    /// Who runs, and since when.
    runs: usize,
    since: SystemTime,
    /// Behind the main thread's place: what was counted of each.
    rows: Vec<ProcessRow>,
    looker: Looker,
}

impl Shown {
    pub(crate) fn new(table: Option<Mapped<ProcessTable>>) -> Self {
        Self { table, ..Self::default() }
    }

    /// The rows of the error handler and of so many processes.
    pub(crate) fn prepare(&mut self, partition: &Partition) {
        let rows = partition.processes().filter_map(|id| {
            let status = partition.get_process_status(id).ok()?;
            let attributes = &status.attributes;
            let span = |time: SystemTime| u64::try_from(time).unwrap_or(0); // infinite
            Some(ProcessRow {
                name: String::from_utf8_lossy(attributes.name.as_bytes()).into_owned(),
                base_priority: attributes.base_priority.cast_unsigned(),
                period_ns: span(attributes.period),
                capacity_ns: span(attributes.time_capacity),
                stack: attributes.stack_size,
                ..ProcessRow::default()
            })
        });
        let handler = ProcessRow { name: HANDLER_NAME.into(), base_priority: 240, ..ProcessRow::default() };
        self.rows = std::iter::once(handler).chain(rows).collect();
    }

    /// From `now` on another one runs; the main thread: nobody.
    pub(crate) fn switch(&mut self, place: usize, now: SystemTime) {
        let Some(table) = &self.table else { return };
        table.switch(Switch { time_ns: now.max(0).cast_unsigned(), place: place as u8 });
        let ran = (now - self.since).max(0).cast_unsigned();
        if let Some(row) = self.row(self.runs) {
            row.run_ns = row.run_ns.wrapping_add(ran);
        }
        if let Some(row) = self.row(place) {
            row.switches = row.switches.wrapping_add(1);
        }
        (self.runs, self.since) = (place, now);
    }

    fn row(&mut self, place: usize) -> Option<&mut ProcessRow> {
        self.rows.get_mut(place.checked_sub(HANDLER)?)
    }

    /// The error handler was told of an error of this process.
    pub(crate) fn tell_error(&self, kind: ReportKind, process: ProcessId) {
        let place = match process {
            MAIN_PROCESS_ID => MAIN,
            ProcessId(1..) => FIRST_PROCESS - 1 + process.0 as usize,
            _ => HANDLER,
        };
        if let Some(table) = &self.table {
            table.tell_error(ToldError { kind, place: place as u8 });
        }
    }

    /// An error concerns this process.
    pub(crate) fn count_error(&mut self, process: ProcessId) {
        let place = usize::try_from(process.0).unwrap_or(0);
        if place > 0
            && let Some(row) = self.rows.get_mut(place)
        {
            row.errors = row.errors.wrapping_add(1);
        }
    }

    /// Goes on with looking how much of their stacks was used.
    fn look_at_stacks(&mut self, batons: &[Arc<Baton>]) {
        let stacks = self.rows.len().min(batons.len().saturating_sub(HANDLER));
        let rows = &self.rows;
        let found =
            self.looker.look(stacks, |place| (&batons[place + HANDLER].stack, rows[place].stack_used));
        if let Some((place, used)) = found {
            self.rows[place].stack_used = used;
        }
    }

    /// Shows how everybody is (the main thread, at the end of a window).
    pub(crate) fn show(&mut self, partition: &Partition, batons: &[Arc<Baton>], has_handler: bool) {
        self.look_at_stacks(batons);
        let Some(table) = &self.table else { return };
        let Some((handler, rows)) = self.rows.split_first_mut() else { return };
        for (row, id) in rows.iter_mut().zip(partition.processes()) {
            let Ok(status) = partition.get_process_status(id) else { continue };
            row.state = status.state as u32;
            row.priority = status.current_priority.cast_unsigned();
            row.deadline_ns = u64::try_from(status.deadline_time).unwrap_or(0);
            row.starts = partition.starts_of(Runner::Process(id));
        }
        handler.starts = partition.starts_of(Runner::Handler);
        let runs = matches!(partition.dispatch(), Dispatch::Run { who: Runner::Handler, .. });
        handler.state = if runs { ProcessState::Running } else { ProcessState::Dormant } as u32;
        handler.priority = handler.base_priority;
        table.write(has_handler.then_some(&*handler), rows.iter());
    }
}
