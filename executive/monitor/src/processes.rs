//! The partitions' processes: started, found ready, found dead, followed by successors, ended.
//!
//! What a death means is decided in `faults`; here is what the kernel tells of it. It must never wait for a process for longer than a
//! step, but where no time passes: before frame 0, at the end, and on the virtual clock.

use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::os::unix::process::ExitStatusExt;
use std::sync::atomic::AtomicBool;
use std::sync::atomic::Ordering::Relaxed;

use bateleur_contract::{Mode, StartCondition, exit};

use super::Monitor;
use super::cleanup::PairMember;
use super::watched::{Life, Then, Watched};
use crate::health::decision::{Decision, decide_restart, error_of};
use bateleur_host::partition::{Sandbox, attached_channels};
use bateleur_plan::{ModuleError, PartitionError};
use bateleur_system::time::now_ns;
use bateleur_system::wait::{await_any_end, ended, is_readable};

/// A filter has ended the process.
const SIGSYS: i32 = 31;
/// What the log calls a successor that the machine could not start; no error of a table.
const NOT_STARTED: &str = "not_started";
/// How long partitions may take to end when they are asked to.
const STOP_PATIENCE_NS: u64 = 500_000_000;

impl Monitor {
    /// Starts every partition of the module.
    ///
    /// # Errors
    /// A program that could not be started, with its partition.
    pub fn launch(&mut self, sandboxes: Vec<Sandbox>, condition: StartCondition) -> Result<(), String> {
        for sandbox in sandboxes {
            let process = sandbox
                .launch(0, condition)
                .map_err(|error| format!("partition {}: {error}", sandbox.name))?;
            self.places[sandbox.id.index()] = Some(self.watched.len());
            self.watched.push(Watched::new(sandbox, process));
        }
        self.launch_standbys()
    }

    /// Waits until every partition has initialised, before frame 0; false: `stop` came first.
    ///
    /// # Errors
    /// The first partition that did not make it, with its last words.
    pub fn await_all_ready(&mut self, stop: &AtomicBool) -> Result<bool, String> {
        while !self.are_standbys_ready()?
            || self.watched.iter().any(|watched| matches!(watched.life, Life::Starting(..)))
        {
            for watched in &mut self.watched {
                watched.look_at_start(&self.plan, self.module_ns)?;
            }
            if stop.load(Relaxed) {
                return Ok(false);
            }
            self.pause(1_000_000);
        }
        Ok(true)
    }

    /// Waits until the partition runs again or is given up (the virtual clock, at its first window after a restart).
    pub fn await_successor(&mut self, partition: usize, module_ns: u64) {
        let Some(place) = self.places[partition] else { return };
        self.module_ns = module_ns;
        // One that fails now is started again later, as on the wall clock, and not at the same instant.
        while self.watched[place].is_coming()
            && module_ns >= self.watched[place].sandbox.control.not_before_ns()
        {
            self.look_at_process(place, module_ns);
            self.look_at_channel_cleaner();
            self.look_at_channel_probe(module_ns);
            if self.watched[place].is_coming() {
                self.pause(200_000);
            }
        }
    }

    /// Whether the partition's process has ended.
    pub fn has_ended(&self, partition: usize) -> bool {
        let place = self.places[partition].map(|place| &self.watched[place].life);
        match place {
            Some(Life::Running(process)) => is_readable(process.pidfd.as_fd()),
            _ => true,
        }
    }

    /// Ends every partition: politely, then not.
    pub fn finish(&mut self, module_ns: u64) {
        self.take_records(module_ns);
        (0..self.watched.len()).for_each(|place| self.tell_repeats(place, module_ns, true));
        self.watched.iter_mut().filter_map(|watched| watched.standby.as_mut()).for_each(|standby| {
            let _ = standby.put_an_end(); // it has nothing to finish
        });
        self.watched.iter().for_each(|watched| watched.sandbox.control.ask_to_stop());
        await_ends(&mut self.watched, Watched::not_gone, STOP_PATIENCE_NS);
        for watched in &mut self.watched {
            watched.put_an_end();
            if let Some(fault) = watched.fault.take() {
                self.health_log.write(&fault);
            }
        }
        self.error_reader.finish();
        self.count_starved(module_ns);
        self.cleanups.give_up();
        self.rebuilds.give_up();
        self.window_log.flush();
        if let Some(stop) = self.stop.as_ref().filter(|stop| !stop.reset) {
            self.health_log.note_module("module_stop", stop.reason.clone(), module_ns);
        }
        self.tell_lost(module_ns);
    }

    pub(super) fn look_at_process(&mut self, place: usize, module_ns: u64) {
        if matches!(self.watched[place].life, Life::Unstarted(retry_ns) if now_ns() >= retry_ns) {
            self.start_successor(place);
        }
        let watched = &mut self.watched[place];
        if let Err(detail) = watched.look_at_start(&self.plan, module_ns) {
            // Whether it died or hangs: what it finds of its predecessor may be the cause.
            watched.start_failed = true;
            return self.fault(place, PartitionError::StartupTimeout, detail, module_ns);
        }
        let watched = &mut self.watched[place];
        let Life::Running(process) = &watched.life else { return };
        if !is_readable(process.pidfd.as_fd()) {
            return;
        }
        // Before its number may be given to another process.
        watched.sandbox.control.lose_process();
        let (pid, status) = (process.pid, ended(process));
        let in_place_of = watched.in_place_of.take();
        let status = status.map(|status| in_place_of.map_or(status, |end| end.status(pid, status)));
        watched.died(pid);
        let words = watched.sandbox.last_words();
        let found = status.and_then(|status| error_of(status, words.as_deref()));
        // Only one that has a handler can be asked for something by it: the codes of others are their own.
        let has_handler = self.plan[watched.sandbox.id].error_handler;
        match status.and_then(|status| status.code()).filter(|_| has_handler) {
            Some(exit::IDLE) => return self.do_as_asked(place, Mode::Idle, module_ns),
            Some(exit::WARM_START) => return self.do_as_asked(place, Mode::WarmStart, module_ns),
            Some(exit::COLD_START) => return self.do_as_asked(place, Mode::ColdStart, module_ns),
            _ => {}
        }
        let (error, mut detail) = found.unwrap_or((PartitionError::Exit, "ended by itself".into()));
        if error == PartitionError::Killed && watched.has_starved() {
            detail = "ended by the kernel: the partition had no memory left".into();
            return self.fault(place, PartitionError::MemoryLimit, detail, module_ns);
        }
        if status.and_then(|status| status.signal()) == Some(SIGSYS)
            && let Some(call) = self.kernel_log.call_that_ended(pid)
        {
            detail = format!("{detail}: {call}");
        } else if error != PartitionError::Killed
            && let Some(words) = words
        {
            detail = format!("{detail}: {words}");
        }
        self.fault(place, error, detail, module_ns);
    }

    pub(super) fn look_at_channel_cleaner(&mut self) {
        self.tend_channels();
        while let Some(((place, member), bad)) =
            self.cleanups.next_cleaned(&self.watched, |id| attached_channels(&self.plan, id))
        {
            if member == PairMember::Standby {
                if let Some(standby) = &mut self.watched[place].standby {
                    standby.buried();
                }
                continue;
            }
            let failed = self.watched[place].start_failed;
            match self.watched[place].life {
                Life::Dead(_, Then::Successor) if failed || !bad.is_empty() => self.examine(place, bad),
                Life::Dead(_, Then::Successor) => self.start_successor(place),
                Life::Dead(_, Then::Rest) => self.watched[place].life = Life::Gone,
                _ => {}
            }
        }
    }

    pub(super) fn start_successor(&mut self, place: usize) {
        let watched = &mut self.watched[place];
        watched.had_window = false;
        match watched.sandbox.launch(watched.generation + 1, watched.next_start) {
            Ok(process) => {
                watched.generation += 1;
                watched.figures.restarts += 1;
                watched.reports_seen = watched.sandbox.control.page.reports_so_far();
                watched.life = Life::Starting(process, now_ns());
            }
            Err(error) => self.not_started(place, &error),
        }
    }

    /// The machine could not start the partition's successor. That may pass, so it is tried again: as a restart like any
    /// other, within the budget, and a little later each time. Nothing of the partition has run: warm stays warm.
    fn not_started(&mut self, place: usize, error: &io::Error) {
        let module_ns = self.module_ns;
        let recent = self.recent_restarts(place, module_ns);
        let watched = &mut self.watched[place];
        watched.life = Life::Unstarted(now_ns() + retry_after_ns(recent));
        let restart = &self.plan[watched.sandbox.id].restart;
        let decision = decide_restart(restart, watched.next_start.is_warm(), recent);
        let detail = format!("its successor can not be started: {error}");
        let text = format!("partition {} can not be started again: {error}", watched.sandbox.name);
        self.decided(place, NOT_STARTED, decision, detail, false, module_ns);
        if !matches!(decision, Decision::Restart { .. }) {
            self.module_fault(ModuleError::ConfigError, &text, true, module_ns);
        }
    }
}

/// How long after a failed try the machine is asked again to start a process, ns, where there were `recent` restarts.
fn retry_after_ns(recent: u32) -> u64 {
    50_000_000 << recent.min(6)
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

    #[test]
    fn machine_that_can_not_start_a_process_is_asked_again_later_each_time() {
        let delays: Vec<u64> = (0..8).map(|recent| retry_after_ns(recent) / 1_000_000).collect();
        assert_eq!(delays, [50, 100, 200, 400, 800, 1600, 3200, 3200]);
    }
}
