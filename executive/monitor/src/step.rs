//! The run of a monitor: partitions are started, looked at in each step, and ended.

use std::os::fd::BorrowedFd;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;

use bateleur_contract::{Clock, StartCondition};

use crate::align::Found;
use crate::event::Event as Told;
use crate::inject::DISPATCHER;
use crate::lifecycle::{Event, Instant, PairMember, Phase, StandbyEvent, StandbyState, noun};
use crate::module_level::seconds;
use crate::monitor::Monitor;
use crate::partition::{Partition, Start};
use bateleur_host::partition::Sandbox;
use bateleur_plan::{ModuleError, PartitionError};
use bateleur_system::time::now_ns;
use bateleur_system::wait::await_any_end;

/// How long partitions may take to end when they are asked to.
const STOP_PATIENCE_NS: u64 = 500_000_000;
/// Between two looks at what need not be looked at in each step, ns. A child that is not found out until then runs as ordinary work: it can
/// take idle time, and nobody's window.
const UPKEEP_NS: u64 = 100_000_000;

impl Monitor {
    /// Starts every partition of the module.
    ///
    /// # Errors
    /// A program that could not be started, with its partition.
    pub fn launch(&mut self, sandboxes: Vec<Sandbox>, condition: StartCondition) -> Result<(), String> {
        for sandbox in sandboxes {
            let (name, place) = (sandbox.name.clone(), sandbox.id.index());
            let partition = Partition::launch(sandbox, &self.plan, self.clock, condition)
                .map_err(|error| format!("partition {name}: {error}"))?;
            self.places[place] = Some(self.partitions.len());
            self.partitions.push(partition);
        }
        let now = Instant::default();
        for partition in &mut self.partitions {
            let kind = self.plan[partition.active.sandbox.id].standby;
            let Some((standby, kind)) = partition.standby.as_mut().zip(kind) else { continue };
            let _ = partition.life.handle(Event::Begin, now); // is carried out here
            let generation = partition.life.generation() + 1;
            standby.launch_standby(generation, kind).map_err(|error| {
                format!("partition {}, the {}: {error}", partition.active.sandbox.name, noun(kind))
            })?;
            let _ = partition.life.handle(Event::Standby(StandbyEvent::Launched), now);
        }
        Ok(())
    }

    /// Waits until every partition has initialised, before frame 0; false: `stop` came first.
    ///
    /// # Errors
    /// The first partition that did not make it, with its last words.
    pub fn await_all_ready(&mut self, stop: &AtomicBool) -> Result<bool, String> {
        let is_starting = |partition: &Partition| {
            partition.life.phase() == Phase::Starting
                || partition.life.standby() == Some(StandbyState::Starting)
        };
        while self.partitions.iter().any(is_starting) {
            for place in 0..self.partitions.len() {
                self.look_at_first_start(place)?;
            }
            if stop.load(Relaxed) {
                return Ok(false);
            }
            self.pause(1_000_000);
        }
        Ok(true)
    }

    /// Looks at the partition's processes before frame 0.
    ///
    /// # Errors
    /// One of them failed: why.
    fn look_at_first_start(&mut self, place: usize) -> Result<(), String> {
        let partition = &mut self.partitions[place];
        let limit_ns = self.plan[partition.active.sandbox.id].startup_timeout_ns;
        match partition.look_at_start(limit_ns) {
            Start::UnderWay => {}
            Start::Ready => self.feed(place, Event::Ready, self.module_ns),
            Start::Ended(detail) => {
                self.feed(place, Event::Died, self.module_ns);
                let found = (PartitionError::StartupTimeout, detail.as_str());
                self.collect_crash(place, PairMember::Active, found, self.module_ns);
                return Err(detail);
            }
            Start::Overdue(detail) => return Err(detail),
        }
        let partition = &mut self.partitions[place];
        let Some((event, found)) = partition.look_at_standby(limit_ns) else { return Ok(()) };
        if let (Some((_, detail)), Some(standby)) = (found, &partition.standby) {
            let words = standby.sandbox.last_words().unwrap_or_else(|| "it said nothing".into());
            let (name, noun) = (partition.name(), partition.noun());
            return Err(format!("partition {name}, the {noun} {detail}: {words}"));
        }
        self.feed(place, Event::Standby(event), self.module_ns);
        Ok(())
    }

    /// Looks at everything once. `module_ns`: the time of what is found.
    pub fn step(&mut self, module_ns: u64) {
        self.module_ns = module_ns;
        self.take_records(module_ns);
        self.tell_schedule();
        self.align(module_ns);
        let all_run = self.did_all_run();
        for place in 0..self.partitions.len() {
            self.tell_repeats(place, module_ns, false);
            self.take_reports(place, module_ns);
            self.take_handled(place, module_ns);
            self.take_switches(place, module_ns);
            self.take_pending_action(place, module_ns); // whose window's record found no room
            // On the virtual clock a successor is looked at when its first window comes, whenever it was ready.
            let awaited = self.clock == Clock::Virtual && self.partitions[place].life.is_coming();
            if !all_run && !awaited {
                self.look_at_process(place, module_ns);
            }
            self.tend_standby(place, module_ns);
        }
        self.look_at_channel_cleaner();
        self.look_at_crashes(module_ns);
        if self.clock == Clock::Wall {
            self.look_at_channel_probe(module_ns);
        }
        self.serve_requests(module_ns);
        self.suffer_own_fault(module_ns);
        self.tell_partitions();
        self.keep_up(module_ns);
    }

    /// Waits until the partition runs again or is given up (the virtual clock, at its first window after a restart).
    pub fn await_successor(&mut self, partition: usize, module_ns: u64) {
        let Some(place) = self.places[partition] else { return };
        self.module_ns = module_ns;
        // One that fails now is started again later, as on the wall clock, and not at the same instant.
        while self.partitions[place].life.is_coming()
            && module_ns >= self.partitions[place].active.sandbox.control.not_before_ns()
        {
            self.look_at_process(place, module_ns);
            self.look_at_channel_cleaner();
            self.look_at_channel_probe(module_ns);
            if self.partitions[place].life.is_coming() {
                self.pause(200_000);
            }
        }
    }

    /// Waits until the process that is no partition is cleaned up after, as nobody's time passes (the virtual clock).
    pub fn await_cleanup(&mut self, pid: i32) {
        while self.awaits_cleanup(pid) {
            self.look_at_channel_cleaner();
            if self.awaits_cleanup(pid) {
                self.pause(200_000);
            }
        }
    }

    /// Ends every partition: politely, then not.
    pub fn finish(&mut self, module_ns: u64) {
        self.take_records(module_ns);
        for place in 0..self.partitions.len() {
            self.tell_repeats(place, module_ns, true);
            self.take_switches(place, module_ns);
            self.feed(place, Event::End, module_ns);
        }
        await_ends(&mut self.partitions, not_ended, STOP_PATIENCE_NS);
        for place in 0..self.partitions.len() {
            self.feed(place, Event::EndNow, module_ns);
            if let Some(fault) = self.partitions[place].fault.take() {
                self.kept.health_log.write(&fault);
            }
        }
        self.error_reader.finish();
        if let Some(text) = self.neighbours.sum() {
            self.tell_of_neighbour(text, module_ns);
        }
        self.cleanups.give_up();
        self.rebuilds.give_up();
        match self.stop.as_ref().is_some_and(|stop| stop.reset) {
            true => self.kept.crashes.set_back(),
            false => self.kept.crashes.finish(),
        }
        self.kept.window_log.flush();
        if let Some(stop) = self.stop.as_ref().filter(|stop| !stop.reset) {
            self.kept.health_log.note_module("module_stop", stop.reason.clone(), module_ns);
        }
        self.tell_lost(module_ns);
    }

    /// Tells about a change of schedule that has taken effect.
    fn tell_schedule(&mut self) {
        let current = self.schedule_switch.current();
        if current == self.told_schedule {
            return;
        }
        let before = std::mem::replace(&mut self.told_schedule, current);
        self.tell(&Told::ScheduleChanged {
            time_s: seconds(self.schedule_switch.changed_ns()),
            schedule: self.plan.schedules[current].name.clone(),
            before: self.plan.schedules[before].name.clone(),
        });
    }

    /// Where the module follows another one's frames: looks at what was measured, and decides about the next frame's end.
    fn align(&mut self, module_ns: u64) {
        let Some(alignment) = &mut self.alignment else { return };
        let active = |partition: usize| Some(self.partitions[self.places[partition]?].pair.active().clone());
        match alignment.step(&self.schedule_switch, active, module_ns) {
            Some(Found::Lost(why)) => self.module_fault(ModuleError::SyncLost, &why, true, module_ns),
            Some(Found::Locked(text)) => {
                self.kept.health_log.note_module("sync_gained", text.clone(), module_ns);
                self.kept.say(DISPATCHER, text, module_ns);
            }
            None => {}
        }
    }

    /// Tells those partitions of the health log's new entries that the plan lets know: also a process that stands by, so that it
    /// goes on with the same count.
    fn tell_partitions(&mut self) {
        let notices = self.kept.health_log.take_notices();
        if notices.is_empty() {
            return;
        }
        let told = self.partitions.iter().filter(|one| self.plan[one.active.sandbox.id].health_texts);
        for page in told.flat_map(Partition::pages) {
            notices.iter().for_each(|notice| page.notify(notice.severity, &notice.text));
        }
    }

    /// Looks, where it is time to, at what need not be looked at in each step.
    fn keep_up(&mut self, module_ns: u64) {
        if module_ns < self.next_upkeep_ns {
            return;
        }
        self.next_upkeep_ns = module_ns + UPKEEP_NS;
        self.kept.events.flush();
        self.tell_lost(module_ns);
        if self.clock == Clock::Virtual {
            return;
        }
        // Who looks at the run meanwhile sees its windows soon.
        self.kept.window_log.flush();
        for place in 0..self.partitions.len() {
            // A partition that declared one thread is not frozen when it closes its window: the thread sleeps.
            if self.partitions[place].finds_company() {
                let text =
                    "it has more threads or processes than it declared: held between its windows from now on";
                self.say(place, text, module_ns);
            }
        }
        let mut cores: Vec<u32> =
            self.partitions.iter().flat_map(|one| one.active.sandbox.cores()).copied().collect();
        cores.dedup();
        if let Some(text) = self.neighbours.look(&cores, module_ns) {
            self.tell_of_neighbour(text, module_ns);
        }
        self.tell_taken(module_ns);
        for place in 0..self.partitions.len() {
            self.judge_escapes(place, module_ns);
        }
    }

    /// Tells of logs that can not be written, each once.
    fn tell_lost(&mut self, module_ns: u64) {
        self.kept.tell_lost(module_ns);
        for partition in &self.partitions {
            if let Some(reason) = partition.active.sandbox.take_log_trouble() {
                let log = format!("partitions/{}.log", partition.name());
                self.kept.events.tell(&Told::LogLost { time_s: seconds(module_ns), log, reason });
            }
        }
    }
}

/// Tells the end of the partition's process, which was asked to end; `None` if it has ended: then it is reaped.
fn not_ended(partition: &mut Partition) -> Option<BorrowedFd<'_>> {
    if partition.active.has_ended() {
        let _ = partition.active.reap();
        let _ = partition.life.handle(Event::Died, Instant::default()); // commands nothing at the end
    }
    partition.active.end()
}

/// Sleeps until all of `list` have ended, at most `patience_ns`. `look`: what tells the end of one; `None` if it has ended.
fn await_ends<T>(list: &mut [T], look: impl Fn(&mut T) -> Option<BorrowedFd<'_>>, patience_ns: u64) {
    let end_ns = now_ns() + patience_ns;
    loop {
        // Those alone that still live: one that has ended would end each sleep at once.
        let left: Vec<BorrowedFd<'_>> = list.iter_mut().filter_map(&look).collect();
        let left_ns = end_ns.saturating_sub(now_ns());
        if left.is_empty() || left_ns == 0 {
            return;
        }
        await_any_end(&left, left_ns);
    }
}

#[cfg(test)]
mod tests {
    use std::io::{PipeReader, PipeWriter};
    use std::os::fd::AsFd;

    use super::*;

    /// A pipe stands for a process: closed, it can be read from, as the descriptor of one that has ended.
    struct Process {
        descriptor: PipeReader,
        life: Option<PipeWriter>,
        looks: u32,
    }

    impl Process {
        fn look(&mut self) -> Option<BorrowedFd<'_>> {
            self.looks += 1;
            self.life.is_some().then(|| self.descriptor.as_fd())
        }
    }

    #[test]
    fn process_that_has_ended_before_the_first_in_the_list_does_not_keep_the_end_of_a_run_busy() {
        let mut list: Vec<Process> = (0..3)
            .map(|_| {
                let (descriptor, life) = std::io::pipe().unwrap();
                Process { descriptor, life: Some(life), looks: 0 }
            })
            .collect();
        list[1].life = None;
        await_ends(&mut list, Process::look, 20_000_000);
        let looks: Vec<u32> = list.iter().map(|process| process.looks).collect();
        assert_eq!(looks, [2, 2, 2], "before the sleep and after it");
    }
}
