//! What windows tell: their records are written down, counted and judged.
//!
//! An overrun, a missed deadline, silence, and a successor's first window are found here. It must never hold a window
//! against a partition that the dispatcher itself has cut short.

use bateleur_contract::Clock;

use super::{Monitor, seconds};
use crate::event::Event;
use crate::watched::{Life, is_own};
use bateleur_plan::PartitionError;
use bateleur_time::partition_control::PartitionControl;
use bateleur_time::time_guard::Escapes;
use bateleur_time::window_record::{Missed, WindowRecord};

impl Monitor {
    pub(super) fn take_records(&mut self, module_ns: u64) {
        while let Some(record) = (self.take_record)() {
            let Some(place) = self.places[record.occurrence.window.partition.index()] else { continue };
            let name = &self.watched[place].sandbox.name;
            let schedule = &self.plan.schedules[record.occurrence.epoch.schedule].name;
            self.window_log.write(&record, name, schedule);
            self.health_log.set_frame(record.occurrence.minor_frames);
            self.watched[place].figures.add(&record);
            self.totals.windows += u64::from(record.granted_ns.is_some());
            self.totals.late += u64::from(record.is_late());
            self.totals.late_switches += record.late_switches();
            self.totals.lost += u64::from(record.is_lost());
            self.totals.overruns += u64::from(record.is_overrun());
            let at = record.occurrence;
            if let Some(schedule) = record.requested {
                self.note_request(place, schedule, at.end_ns);
            }
            if let Some(Missed::Changed(_)) = record.missed {
                self.take_pending_action(place, at.start_ns);
            }
            self.judge_lateness(&record, module_ns);
            self.judge_window(place, &record, module_ns);
        }
    }

    /// Does what a change of schedule has left to be done with the partition, if anything.
    pub(super) fn take_pending_action(&mut self, place: usize, module_ns: u64) {
        let owed = self.watched[place].pair.all().find_map(PartitionControl::take_owed);
        if let Some((action, schedule)) = owed {
            self.change(place, action, schedule, module_ns);
        }
    }

    fn judge_window(&mut self, place: usize, record: &WindowRecord, module_ns: u64) {
        // A window of the process that was active before says nothing about the one that has taken over meanwhile.
        if record.member != self.watched[place].pair.active_member()
            || !is_own(record.granted_ns, self.watched[place].admitted_ns)
        {
            return;
        }
        self.watched[place].had_window = true;
        self.note_recovery(place, record.occurrence.start_ns);
        self.judge_fault(place, record, module_ns);
        self.judge_deadline(place, record, module_ns);
        let watched = &mut self.watched[place];
        if !record.is_overrun() {
            watched.unclosed = 0;
            watched.spell = None;
            return;
        }
        // A window that the dispatcher itself cut to less than half says nothing about the partition; and one that died
        // in its window did not overrun it: its end is found next.
        if record.occurrence.late_ns * 2 > record.occurrence.window.duration_ns()
            || watched.held
            || !watched.runs()
        {
            return;
        }
        if self.had_no_processor(place, record, module_ns) {
            return;
        }
        let watched = &mut self.watched[place];
        watched.unclosed += 1;
        if watched.unclosed >= self.plan.health.silence_windows {
            watched.unclosed = 0;
            let detail = format!("no window closed in {}", self.plan.health.silence_windows);
            return self.fault(place, PartitionError::Silence, detail, module_ns);
        }
        let minor = record.occurrence.minor_frames;
        let detail = format!("not done at the end of its window in frame {minor}");
        self.fault(place, PartitionError::WindowOverrun, detail, module_ns);
    }

    /// A partition has closed its window within its time capacity, or it has missed its deadline. On the virtual clock
    /// computing takes no module time: there a deadline is missed only by a window that is not closed at all.
    fn judge_deadline(&mut self, place: usize, record: &WindowRecord, module_ns: u64) {
        let watched = &self.watched[place];
        let Some(capacity_ns) = self.plan[watched.sandbox.id].deadline_ns else { return };
        let occurrence = &record.occurrence;
        let deadline_ns = occurrence.start_ns + capacity_ns;
        let in_time = match (record.closed_ns, self.clock) {
            (Some(closed_ns), Clock::Wall) => closed_ns <= deadline_ns,
            (closed_ns, _) => closed_ns.is_some(),
        };
        // The dispatcher's own delay is not the partition's.
        if in_time || occurrence.late_ns >= capacity_ns || watched.held || !watched.runs() {
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
        let watched = &mut self.watched[place];
        if !matches!(watched.life, Life::Running(_)) {
            return;
        }
        let Some(mut fault) = watched.fault.take_if(|fault| start_ns >= fault.time_ns) else { return };
        fault.recovered_ns = Some(start_ns);
        let after_ms = (start_ns - fault.time_ns) as f64 / 1e6;
        self.health_log.write(&fault);
        self.health_log.note_recovery(&fault, watched.generation, start_ns);
        let partition = watched.sandbox.name.clone();
        self.events.tell(&Event::Recovered { time_s: seconds(start_ns), partition, after_ms });
    }

    /// What a window's end did not hold is an overrun, whether the partition had closed its window or not.
    pub(super) fn judge_escapes(&mut self, place: usize, module_ns: u64) {
        let control = &self.watched[place].sandbox.control;
        let Escapes { ran_on, stuck, strayed } = control.take_escapes();
        if strayed > 0 {
            control.always_freeze();
        }
        if ran_on + stuck + strayed == 0 || !self.watched[place].runs() {
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
}
