//! What windows tell: their records are written down, counted and judged.
//!
//! An overrun, a missed deadline, silence, and a successor's first window are found here. It must never hold a window
//! against a partition that the dispatcher itself has cut short.

use bateleur_contract::process_table::TOLD_ERRORS;
use bateleur_contract::{Clock, ReportKind, Reported};

use crate::event::Event as Told;
use crate::health::decision::{Decision, reported_error};
use crate::lifecycle::{Event, Phase};
use crate::module_level::seconds;
use crate::monitor::Monitor;
use crate::partition::is_own;
use crate::why::Kind;
use bateleur_plan::{ChangeAction, Closed, ModuleError, PartitionError, PartitionState};
use bateleur_time::time_guard::Escapes;
use bateleur_time::window_record::{Missed, WindowRecord};

impl Monitor {
    pub(crate) fn take_records(&mut self, module_ns: u64) {
        while let Some(record) = (self.take_record)() {
            let at = record.occurrence;
            let Some(place) = self.places[at.window.partition.index()] else { continue };
            let partition = &mut self.partitions[place];
            self.kept.record(&self.plan, partition.name(), &record);
            partition.figures.add(&record);
            if let Some(schedule) = record.requested {
                self.tell(&Told::ScheduleRequested {
                    time_s: seconds(at.end_ns),
                    schedule: self.plan.schedules[schedule].name.clone(),
                    by: self.partitions[place].name().to_owned(),
                });
            }
            if let Some(Missed::Changed(_)) = record.missed {
                self.take_pending_action(place, at.start_ns);
            }
            let late_after_ns = self.plan.health.late_after_ns;
            if let Some(kind) = Kind::of(&record) {
                self.ask(kind, place, &record);
            }
            let name = self.partitions[place].name();
            if let Some(detail) = self.kept.judge_lateness(late_after_ns, name, &record, module_ns) {
                self.module_fault(ModuleError::LateDispatcher, &detail, true, module_ns);
            }
            self.judge_window(place, &record, module_ns);
        }
    }

    /// Does what a change of schedule has left to be done with the partition, if anything. The dispatcher finds a partition's first
    /// window in a new schedule, and keeps that window back where the plan wants something done. It is no health error and uses up no
    /// budget. What an operator holds keeps it until it is released.
    pub(crate) fn take_pending_action(&mut self, place: usize, module_ns: u64) {
        if self.partitions[place].life.is_held() {
            return;
        }
        let Some((action, schedule)) = self.partitions[place].pair.active().take_owed() else { return };
        if !self.partitions[place].life.can_change(action) {
            return;
        }
        let text = format!("{} with schedule {}", action.name(), self.plan.schedules[schedule].name);
        self.say(place, text, module_ns);
        if action == ChangeAction::Idle {
            self.close_series(place, module_ns);
        }
        self.feed(place, Event::Schedule(action), module_ns);
    }

    fn judge_window(&mut self, place: usize, record: &WindowRecord, module_ns: u64) {
        // A window of the process that was active before says nothing about the one that has taken over meanwhile.
        if record.member != self.partitions[place].pair.active_member()
            || !is_own(record.granted_ns, self.partitions[place].admitted_ns)
        {
            return;
        }
        self.feed(place, Event::WindowUsed, module_ns);
        self.note_recovery(place, record.occurrence.start_ns);
        self.judge_fault(place, record, module_ns);
        self.judge_deadline(place, record, module_ns);
        let silence_windows = self.plan.health.silence_windows;
        let partition = &mut self.partitions[place];
        if !record.is_overrun() {
            let process = partition.active.process.as_ref().map(|process| process.pid);
            let watched = process.filter(|_| silence_windows == 1 && self.clock == Clock::Wall);
            partition.unclosed.end(watched, module_ns);
            return;
        }
        // A window that the dispatcher itself cut to less than half says nothing about the partition; and one that died
        // in its window did not overrun it: its end is found next.
        if record.occurrence.late_ns * 2 > record.occurrence.window.duration_ns()
            || partition.life.is_held()
            || !partition.runs()
        {
            return;
        }
        if self.had_no_processor(place, record, module_ns) {
            return;
        }
        if self.partitions[place].unclosed.take(silence_windows) {
            self.ask(Kind::Silence, place, record);
            let detail = format!("no window closed in {silence_windows}");
            return self.fault(place, PartitionError::Silence, detail, module_ns);
        }
        self.ask(Kind::Overrun, place, record);
        let minor = record.occurrence.minor_frames;
        let detail = format!("not done at the end of its window in frame {minor}");
        self.fault(place, PartitionError::WindowOverrun, detail, module_ns);
    }

    /// A partition has closed its window within its time capacity, or it has missed its deadline. On the virtual clock
    /// computing takes no module time: there a deadline is missed only by a window that is not closed at all.
    fn judge_deadline(&mut self, place: usize, record: &WindowRecord, module_ns: u64) {
        let partition = &self.partitions[place];
        let Some(capacity_ns) = self.plan[partition.active.sandbox.id].deadline_ns else { return };
        let occurrence = &record.occurrence;
        let deadline_ns = occurrence.start_ns + capacity_ns;
        let in_time = match (record.closed_ns, self.clock) {
            (Some(closed_ns), Clock::Wall) => closed_ns <= deadline_ns,
            (closed_ns, _) => closed_ns.is_some(),
        };
        // The dispatcher's own delay is not the partition's.
        if in_time || occurrence.late_ns >= capacity_ns || partition.life.is_held() || !partition.runs() {
            return;
        }
        let what = match record.closed_ns {
            Some(closed_ns) => format!("{} us after its deadline", (closed_ns - deadline_ns) / 1_000),
            None => "not at all".into(),
        };
        let detail = format!("the window of frame {} was closed {what}", occurrence.minor_frames);
        self.fault(place, PartitionError::DeadlineMissed, detail, module_ns);
    }

    fn note_recovery(&mut self, place: usize, start_ns: u64) {
        let partition = &mut self.partitions[place];
        if partition.life.phase() != Phase::Running {
            return;
        }
        let Some(mut fault) = partition.fault.take_if(|fault| start_ns >= fault.time_ns) else { return };
        fault.recovered_ns = Some(start_ns);
        let after_ms = (start_ns - fault.time_ns) as f64 / 1e6;
        self.kept.health_log.write(&fault);
        self.kept.health_log.note_recovery(&fault, partition.life.generation(), start_ns);
        let partition = partition.name().to_owned();
        self.kept.events.tell(&Told::Recovered { time_s: seconds(start_ns), partition, after_ms });
    }

    /// Says so where a fault that was to end or stop the partition has come to nothing: its program does not link the library that
    /// carries faults out, or the partition does not let it.
    fn judge_fault(&mut self, place: usize, record: &WindowRecord, module_ns: u64) {
        let partition = &mut self.partitions[place];
        let Some(fault) = partition.ordered.as_mut().and_then(|ordered| ordered.judge(record)) else {
            return;
        };
        partition.ordered = None;
        let text = format!("fault {fault} has come to nothing: the partition goes on");
        let partition = partition.name().to_owned();
        self.tell(&Told::Undone { time_s: seconds(module_ns), partition, text: text.clone() });
        self.note_order(Some(place), &text, module_ns);
    }

    /// Counts a window that the partition did not close. True: it had no processor for most of it, which is known from the second
    /// such window in a row on, and then of the first one too.
    fn had_no_processor(&mut self, place: usize, record: &WindowRecord, module_ns: u64) -> bool {
        let partition = &mut self.partitions[place];
        let process = partition.active.process.as_ref();
        // On the virtual clock its gate has waited until it had one.
        let Some(process) = process.filter(|_| self.clock == Clock::Wall) else {
            partition.unclosed.count_own();
            return false;
        };
        let starved = !partition.unclosed.count_watched(process.pid, record, module_ns);
        if starved {
            self.neighbours.count_starved();
            self.ask(Kind::ProcessorTaken, place, record);
        }
        starved
    }

    /// What a window's end did not hold is an overrun, whether the partition had closed its window or not.
    pub(super) fn judge_escapes(&mut self, place: usize, module_ns: u64) {
        let control = &self.partitions[place].active.sandbox.control;
        let Escapes { ran_on, stuck, strayed } = control.take_escapes();
        if strayed > 0 {
            control.always_freeze();
        }
        if ran_on + stuck + strayed == 0 || !self.partitions[place].runs() {
            return;
        }
        let detail = match (ran_on, strayed) {
            (0, 0) => format!(
                "not stopped between two windows, {stuck} times: something of it is deep in the kernel"
            ),
            (0, _) => format!(
                "computed on after it had said that it was done with its window, {strayed} times, as ordinary work: held between \
                 its windows from now on"
            ),
            _ => format!("ran on after its window's end, {ran_on} times, until it lost its priority"),
        };
        self.fault(place, PartitionError::WindowOverrun, detail, module_ns);
    }

    /// Takes what the partition has reported by its control page since the last look.
    pub(crate) fn take_reports(&mut self, place: usize, module_ns: u64) {
        let member = &mut self.partitions[place].active;
        let page = &member.sandbox.control.page;
        if page.reports_so_far() == member.reports_seen {
            return;
        }
        let mut accused = Vec::new();
        for Reported { kind, in_handler, text } in page.reports_since(&mut member.reports_seen) {
            // The word about the state is of the report's time: by now the handler may have come back.
            let state = in_handler.then_some(PartitionState::Handler);
            // One burst of errors is one fault where it ends the process: the rest must not use up its budget.
            if !self.partitions[place].life.has_process() && kind != ReportKind::Message {
                continue;
            }
            if let Some(replica) = kind.outvoted_place() {
                // One burst of verdicts is one fault: the rest is of the one that was ended.
                if !accused.contains(&replica) {
                    accused.push(replica);
                    self.take_verdict(place, replica, text, module_ns);
                }
                continue;
            }
            let Some(error) = reported_error(kind) else {
                self.take_message(place, text, module_ns);
                continue;
            };
            self.fault_in(place, error, state, text, module_ns);
        }
    }

    /// The partition says that one of its replicas is outvoted.
    fn take_verdict(&mut self, place: usize, replica: usize, text: String, module_ns: u64) {
        let own = self.partitions[place].active.sandbox.id;
        let reporter = &self.plan[own];
        // A replica hands on what its voter on another module says of it.
        let is_replica = self.plan.is_voted_elsewhere(reporter);
        let accused = if is_replica { Some(&own) } else { reporter.replicas.get(replica) };
        let Some(&accused) = accused else {
            let text = format!("says that a replica is outvoted, and has none: {text}");
            self.fault(place, PartitionError::ApplicationError, text, module_ns);
            return;
        };
        match self.partitions.iter().position(|partition| partition.active.sandbox.id == accused) {
            // What was said of its predecessor is not held against one that starts, nor silence against one that an operator holds.
            Some(accused) if self.partitions[accused].runs() && !self.partitions[accused].life.is_held() => {
                self.fault(accused, PartitionError::Outvoted, text, module_ns);
            }
            Some(_) => {}
            // Its module is another one, and it tells the executive there.
            None => {
                let text = format!("{} is outvoted: {text}", self.plan[accused].name);
                self.note(place, (PartitionError::Outvoted, Decision::Ignore), text, module_ns);
            }
        }
    }

    /// Takes the errors that an error handler among the partition's processes was told of: noted, and nothing is left to be done.
    pub(crate) fn take_handled(&mut self, place: usize, module_ns: u64) {
        // No more than there are places: a partition may go on telling on another core.
        for _ in 0..TOLD_ERRORS {
            let Some((kind, whose)) = self.partitions[place].active.next_handled() else { return };
            let error = reported_error(kind).unwrap_or(PartitionError::ApplicationError);
            self.note(place, (error, Decision::Handler), whose, module_ns);
        }
    }

    /// Takes what the partition's processes have shown of who ran.
    pub(crate) fn take_switches(&mut self, place: usize, module_ns: u64) {
        // On the virtual clock windows that are over may lie behind the instant at which they are looked at.
        let latest_ns = match self.clock {
            Clock::Wall => module_ns,
            Clock::Virtual => module_ns + self.plan.schedules[self.schedule_switch.current()].major_frame_ns,
        };
        let partition = &mut self.partitions[place].active;
        let Some(table) = &partition.sandbox.table else { return };
        let (name, log) = (&partition.sandbox.name, &mut self.kept.window_log.processes);
        partition.spans.take(table, name, latest_ns, log);
    }

    /// REPORT_APPLICATION_MESSAGE: recorded and passed on, within bounds.
    fn take_message(&mut self, place: usize, text: String, module_ns: u64) {
        let partition = &mut self.partitions[place];
        if let Some(text) = partition.messages.record(&text, module_ns) {
            let generation = partition.life.generation();
            self.kept.health_log.note_message(partition.name(), generation, text, module_ns);
        }
        if partition.may_speak(module_ns) {
            self.say(place, text, module_ns);
        }
    }
}
