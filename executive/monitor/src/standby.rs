//! The process that stands by for a partition: started with the module, initialised, held, and active at the partition's
//! next window when the one before it is gone.
//!
//! It is started behind a successor that has had a window, once what sat there before is cleaned up after: never while the
//! partition itself is being brought back. An ordinary restart ends it, because it would count its incarnations wrong.
//!
//! ```text
//! Absent ──first window──▶ Starting ──ready──▶ Ready ──the other one dies──▶ active
//!    ▲                        └──────death, time-out──┴──▶ Dead ──channel cleaner──┐
//!    └─────────────────────────────────────────────────────────────────────┘
//! ```

use bateleur_contract::page::WindowGrant;
use std::os::fd::AsFd;
use std::sync::atomic::Ordering::Acquire;

use bateleur_contract::{Clock, Mode, Takeover};

use super::cleanup::PairMember;
use super::watched::{Life, is_overdue};
use super::{Monitor, seconds};
use crate::event::Event;
use crate::health::decision::error_of;
use crate::health::log::Fault;
use crate::health::record::Level;
use bateleur_host::partition::Sandbox;
use bateleur_plan::{Closed, PartitionError, Plan};
use bateleur_system::spawn::Spawned;
use bateleur_system::time::now_ns;
use bateleur_system::wait::{await_any_end, ended, is_readable};
use bateleur_time::partition_control::Readiness;

/// What the health log says was done.
pub(super) const TAKEOVER: &str = "takeover";
/// What it says about a process that stood by and is gone.
const NEW_STANDBY: &str = "new_standby";
/// How long a process may take from the call until it has taken over, real time, ns: it attaches its queues and loads what was
/// retained, well below a millisecond each. The monitor waits so long, so that the next window is the successor's.
const CALL_PATIENCE_NS: u64 = 20_000_000;
/// As above on the virtual clock, where nobody's time passes meanwhile.
const VIRTUAL_CALL_PATIENCE_NS: u64 = 2_000_000_000;

/// See the module's head.
#[derive(Debug)]
pub(super) struct Standby {
    pub(super) sandbox: Sandbox,
    pub(super) life: Waiting,
    reports_seen: u32,
    /// Module time of its losses so far, within the time of the partition's budget.
    losses: Vec<u64>,
    /// It was lost too often: the partition goes on without.
    given_up: bool,
    /// Virtual clock: when it is ready, module time, ns.
    ready_from_ns: u64,
}

#[derive(Debug)]
pub(super) enum Waiting {
    /// There is none.
    Absent,
    /// Initialises, since this instant of CLOCK_MONOTONIC.
    Starting(Spawned, u64),
    /// Sleeps, held.
    Ready(Spawned),
    /// Its remains, or those of the one that it has followed, wait for the channel cleaner.
    Dead(i32),
}

impl Standby {
    pub(super) fn new(sandbox: Sandbox) -> Self {
        let (life, losses) = (Waiting::Absent, Vec::new());
        Self { sandbox, life, reports_seen: 0, losses, given_up: false, ready_from_ns: 0 }
    }

    /// Starts the process that is to become incarnation number `generation`.
    pub(super) fn start(&mut self, generation: u32) -> std::io::Result<()> {
        let process = self.sandbox.launch_standby(generation)?;
        self.reports_seen = self.sandbox.control.page.reports_so_far();
        self.life = Waiting::Starting(process, now_ns());
        Ok(())
    }

    /// Takes notice of what became of the process; what ended it, if it did.
    pub(super) fn look(&mut self, plan: &Plan) -> Result<(), (PartitionError, String)> {
        let (Waiting::Starting(process, _) | Waiting::Ready(process)) = &self.life else { return Ok(()) };
        if is_readable(process.pidfd.as_fd()) {
            self.sandbox.control.lose_process();
            let (pid, status) = (process.pid, ended(process));
            self.sandbox.kill(None);
            self.life = Waiting::Dead(pid);
            let words = self.sandbox.last_words();
            return Err(status
                .and_then(|status| error_of(status, words.as_deref()))
                .unwrap_or_else(|| (PartitionError::Exit, "ended by itself".into())));
        }
        let Waiting::Starting(process, since_ns) = &self.life else { return Ok(()) };
        if Mode::from_number(self.sandbox.control.page.mode.load(Acquire)) == Some(Mode::Normal) {
            self.sandbox.stand_by(process);
            if let Waiting::Starting(process, _) = std::mem::replace(&mut self.life, Waiting::Absent) {
                self.life = Waiting::Ready(process);
            }
            return Ok(());
        }
        let limit_ns = plan[self.sandbox.id].startup_timeout_ns;
        if is_overdue(process.pid, *since_ns, limit_ns) {
            self.put_an_end();
            let detail = format!("was not ready after {} ms (startup_timeout)", limit_ns / 1_000_000);
            return Err((PartitionError::StartupTimeout, detail));
        }
        Ok(())
    }

    pub(super) fn is_starting(&self) -> bool {
        matches!(self.life, Waiting::Starting(..))
    }

    /// It sleeps, and has not ended as far as the kernel knows.
    pub(super) fn is_ready(&self) -> bool {
        matches!(&self.life, Waiting::Ready(process) if !is_readable(process.pidfd.as_fd()))
    }

    /// Its process.
    pub(super) fn process(&self) -> Option<&Spawned> {
        match &self.life {
            Waiting::Starting(process, _) | Waiting::Ready(process) => Some(process),
            Waiting::Absent | Waiting::Dead(_) => None,
        }
    }

    /// Makes sure that no process is left. True: there was one.
    pub(super) fn put_an_end(&mut self) -> bool {
        let Some(process) = self.process() else { return false };
        self.sandbox.kill(Some(process));
        await_any_end(&[process.pidfd.as_fd()], 1_000_000_000);
        let pid = process.pid;
        self.sandbox.control.lose_process(); // before its number may be given to another process
        let _ = ended(process); // reaps it
        self.life = Waiting::Dead(pid);
        true
    }

    /// The partition begins anew, with a new budget: so does what stands by for it.
    pub(super) fn forget_losses(&mut self) {
        self.losses.clear();
        self.given_up = false;
    }

    /// What lay here is cleaned up after.
    pub(super) fn buried(&mut self) {
        if matches!(self.life, Waiting::Dead(_)) {
            self.life = Waiting::Absent;
        }
    }

    /// Calls the process; true: it has taken over from the one behind `before`.
    fn call(&self, order: Takeover, before: &Sandbox, grant: &WindowGrant, patience_ns: u64) -> bool {
        let control = &self.sandbox.control;
        let begun_ns = now_ns();
        control.call(order, &before.control, grant, begun_ns);
        while !control.is_done() && self.is_ready() && now_ns() - begun_ns < patience_ns {
            control.await_change(1_000_000);
        }
        control.is_done() && self.is_ready()
    }

    /// How it is, for a status.
    pub(super) fn state(&self) -> &'static str {
        match self.life {
            Waiting::Ready(_) => "ready",
            Waiting::Starting(..) => "starting",
            Waiting::Absent | Waiting::Dead(_) => "absent",
        }
    }
}

impl Monitor {
    /// Starts, before frame 0, a process behind every partition that wants one.
    ///
    /// # Errors
    /// A program that could not be started, with its partition.
    pub(super) fn launch_standbys(&mut self) -> Result<(), String> {
        for watched in &mut self.watched {
            let generation = watched.generation + 1;
            if let Some(standby) = &mut watched.standby {
                standby
                    .start(generation)
                    .map_err(|error| format!("partition {}, the standby: {error}", watched.sandbox.name))?;
            }
        }
        Ok(())
    }

    /// Takes notice of standbys that have become ready before frame 0. True: all have.
    ///
    /// # Errors
    /// The first that never will, with its last words.
    pub(super) fn are_standbys_ready(&mut self) -> Result<bool, String> {
        let mut all = true;
        for watched in &mut self.watched {
            let Some(standby) = &mut watched.standby else { continue };
            standby.look(&self.plan).map_err(|(_, detail)| {
                let words = standby.sandbox.last_words().unwrap_or_else(|| "it said nothing".into());
                format!("partition {}, the standby {detail}: {words}", watched.sandbox.name)
            })?;
            all &= !standby.is_starting();
        }
        Ok(all)
    }

    /// Looks at the process that stands by, and starts one where it is time to.
    pub(super) fn tend_standby(&mut self, place: usize, module_ns: u64) {
        self.look_at_standby(place, module_ns);
        let watched = &mut self.watched[place];
        let due = watched.had_window && matches!(watched.life, Life::Running(_));
        let generation = watched.generation + 1;
        let Some(standby) = &mut watched.standby else { return };
        if !due || standby.given_up || !matches!(standby.life, Waiting::Absent) {
            return;
        }
        if let Err(error) = standby.start(generation) {
            standby.given_up = true;
            return self.tell_of_standby(
                place,
                format!("its standby can not be started: {error}"),
                module_ns,
            );
        }
        standby.ready_from_ns = module_ns + self.plan[standby.sandbox.id].restart.startup_ns;
        // On the virtual clock everything that peers can notice happens at an instant of module time.
        while self.clock == Clock::Virtual
            && self.watched[place].standby.as_ref().is_some_and(Standby::is_starting)
        {
            self.look_at_standby(place, module_ns);
            self.pause(200_000);
        }
    }

    fn look_at_standby(&mut self, place: usize, module_ns: u64) {
        let Some(standby) = &mut self.watched[place].standby else { return };
        if let Err((error, detail)) = standby.look(&self.plan) {
            self.lose_standby(place, error, &detail, module_ns);
        }
    }

    /// The process that stood by is gone, and is no health error of the partition, which goes on. One that is lost again and
    /// again is given up by the partition's budget.
    fn lose_standby(&mut self, place: usize, error: PartitionError, detail: &str, module_ns: u64) {
        let watched = &mut self.watched[place];
        let restart = &self.plan[watched.sandbox.id].restart;
        let Some(standby) = &mut watched.standby else { return };
        standby.losses.retain(|at| module_ns.saturating_sub(*at) < restart.within_ns);
        standby.losses.push(module_ns);
        standby.given_up = standby.losses.len() as u32 > restart.budget;
        let next = if standby.given_up { "and is given up" } else { "and is replaced" };
        let words = (error != PartitionError::Killed).then(|| standby.sandbox.last_words()).flatten();
        let detail = words.map_or_else(|| detail.to_owned(), |words| format!("{detail}: {words}"));
        let action = if standby.given_up { "ignore" } else { NEW_STANDBY };
        let entry = Fault {
            time_ns: module_ns,
            level: Level::Partition,
            partition: Some(watched.sandbox.name.clone()),
            generation: watched.generation + 1,
            error: error.name().into(),
            action: action.into(),
            detail: format!("the standby {detail}"),
            recovered_ns: None,
        };
        self.health_log.note(&entry);
        self.health_log.write(&entry);
        self.tell_of_standby(place, format!("its standby {detail}, {next}"), module_ns);
        self.clean_up_standby(place);
    }

    fn tell_of_standby(&mut self, place: usize, text: String, module_ns: u64) {
        let partition = self.watched[place].sandbox.name.clone();
        self.events.tell(&Event::Message { time_s: seconds(module_ns), partition, text });
    }

    /// Has what lies behind the partition cleaned up after.
    fn clean_up_standby(&mut self, place: usize) {
        self.cleanups.add(place, PairMember::Standby);
        let waits = |monitor: &Self| {
            let standby = monitor.watched[place].standby.as_ref();
            standby.is_some_and(|standby| matches!(standby.life, Waiting::Dead(_)))
        };
        // As above: a queue that the dead one had is full until then.
        while self.clock == Clock::Virtual && waits(self) {
            self.look_at_channel_cleaner();
            self.pause(200_000);
        }
    }

    /// An ordinary restart, or none at all, follows: nobody stands by meanwhile.
    pub(super) fn end_standby(&mut self, place: usize) {
        let watched = &mut self.watched[place];
        watched.had_window = false;
        if watched.standby.as_mut().is_some_and(Standby::put_an_end) {
            self.clean_up_standby(place);
        }
    }

    /// Whether the partition's next window can be that of the process which stands by.
    pub(super) fn can_take_over(&self, place: usize, module_ns: u64) -> bool {
        let wall = self.clock == Clock::Wall;
        let standby = self.watched[place].standby.as_ref();
        standby.is_some_and(|standby| standby.is_ready() && (wall || module_ns >= standby.ready_from_ns))
    }

    /// Puts the process that stands by in the place of the dead one. False: it can not, and nothing has changed but that
    /// it may be gone too.
    pub(super) fn take_over(&mut self, place: usize, warm: bool, module_ns: u64) -> bool {
        if !self.can_take_over(place, module_ns) {
            return false;
        }
        let schedule = self.schedule_switch.current();
        let grant = WindowGrant {
            start_ns: module_ns,
            minor_frame_ns: self.plan.schedules[schedule].minor_frame_ns,
            schedule: schedule as u32,
            schedule_since_ns: self.schedule_switch.changed_ns(),
            next_schedule: self.schedule_switch.next() as u32,
            ..WindowGrant::default()
        };
        let patience_ns = match self.clock {
            Clock::Wall => CALL_PATIENCE_NS,
            Clock::Virtual => VIRTUAL_CALL_PATIENCE_NS,
        };
        let watched = &mut self.watched[place];
        let Some(standby) = &mut watched.standby else { return false };
        let Life::Dead(dead, _) = watched.life else { return false };
        let order = if warm { Takeover::Warm } else { Takeover::Cold };
        let prepared = warm || standby.sandbox.forget().is_ok();
        if !prepared || !standby.call(order, &watched.sandbox, &grant, patience_ns) {
            let text = "its standby did not take over: it is started anew";
            self.tell_of_standby(place, text.into(), module_ns);
            return false;
        }
        let Waiting::Ready(process) = std::mem::replace(&mut standby.life, Waiting::Dead(dead)) else {
            return false; // it was asked above
        };
        watched.sandbox.control.lose_process();
        std::mem::swap(&mut watched.sandbox, &mut standby.sandbox);
        std::mem::swap(&mut watched.reports_seen, &mut standby.reports_seen);
        watched.starved = watched.sandbox.out_of_memory_kills();
        watched.sandbox.admit(&process);
        watched.life = Life::Running(process);
        watched.generation += 1;
        watched.figures.restarts += 1;
        watched.unclosed = 0;
        watched.had_window = false;
        watched.admitted_ns = module_ns;
        watched.sandbox.control.set_not_before_ns(0);
        // Only now: until here a dispatcher finds that nobody is there.
        watched.pair.hand_over();
        match watched.held {
            true => watched.sandbox.control.hold(),
            false => watched.sandbox.control.set_readiness(Readiness::Ready),
        }
        self.clean_up_standby(place);
        true
    }

    /// The process that stands by for the partition at `partition` of the plan dies now (fault injection); false: there is
    /// none.
    pub fn kill_standby(&mut self, partition: usize, module_ns: u64) -> bool {
        let Some(place) = self.places[partition] else { return false };
        let Some(process) = self.watched[place].standby.as_ref().and_then(Standby::process) else {
            return false;
        };
        let _ = rustix::process::pidfd_send_signal(&process.pidfd, rustix::process::Signal::KILL); // ended already
        await_any_end(&[process.pidfd.as_fd()], 1_000_000_000);
        self.look_at_standby(place, module_ns);
        true
    }
}
