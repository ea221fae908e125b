//! Who has the baton: the partition's state behind one lock, time, and the windows.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use bateleur_contract::page::WindowGrant;
use bateleur_contract::{Clock, ControlPage, Mapped, PartitionTimes, ProcessPlan};
use bateleur_processes::standard::{OperatingMode, SystemTime};
use bateleur_processes::{Dispatch, End, Partition, PeriodGrid, Runner, Standing};

use super::baton::Baton;
use super::ports::PlanPorts;
use super::process::Body;
use super::shown::Shown;
use super::thread;
use crate::context::Context;
use crate::schedule::Schedules;
use crate::time::monotonic_ns;

/// What a service costs under the virtual clock, ns: a loop that only polls comes to its window's end.
pub const SERVICE_NS: i64 = 1_000;
/// So long before the end of a window on the wall clock the running thread is asked to stop, ns.
const MARGIN_NS: i64 = bateleur_contract::WINDOW_MARGIN_NS as i64;

/// A thread that was asked to stop is asked again so much later, ns: it does not stop within the C library. Longer than a hand-over takes,
/// which a timer that ends meanwhile would delay; at a window's end, where little time is left, sooner.
const ASK_AGAIN_NS: i64 = 50_000;
const ASK_SOON_NS: i64 = 20_000;

/// So often the main thread looks, while processes wait at ports, what another partition has sent or received; and while several are ready,
/// whether the running one sleeps, ns.
const LOOK_NS: i64 = 1_000_000;

/// A process that sleeps outside of services lets others run for so long, ns. Then it is seen whether it still sleeps.
const LENT_NS: i64 = 500_000;

/// The places of batons: the main thread's, the error handler's, then those of the processes.
pub(crate) const MAIN: usize = 0;
pub(crate) const HANDLER: usize = 1;
pub(crate) const FIRST_PROCESS: usize = 2;

/// The partition, for all of its threads.
pub(crate) struct Kernel {
    pub(crate) page: Mapped<ControlPage>,
    clock: Clock,
    /// Nobody sees time before this, ns.
    begun: AtomicI64,
    /// The module's, once the plan is known.
    pub(crate) schedules: OnceLock<Schedules>,
    state: Mutex<State>,
}

/// What only the thread that holds the lock sees.
pub(crate) struct State {
    pub(crate) partition: Partition,
    pub(crate) ports: PlanPorts,
    pub(crate) batons: Vec<Arc<Baton>>,
    /// What the threads run, by the place of their baton.
    pub(crate) bodies: Vec<Option<Body>>,
    /// Whose turn it is.
    pub(crate) holder: usize,
    pub(crate) shown: Shown,
    /// Under the virtual clock: the partition's own time, which services and waiting move on.
    now: SystemTime,
    window_end: SystemTime,
    /// The window is over: the baton goes to the main thread.
    closing: bool,
    /// The holder is whom the scheduler names, and nothing but services of its own has happened since.
    settled: bool,
    /// When the main thread wakes by itself on the wall clock.
    main_until: SystemTime,
    /// Somebody who sleeps outside of services is passed over.
    pub(crate) has_lent: bool,
    pub(crate) periods: Periods,
    /// A process begins again whose thread was stopped in its own code: it needs a new one.
    pub(crate) orphan: Option<usize>,
}

/// The partition's periods, which a change of the module's schedule may change.
#[derive(Default)]
pub(crate) struct Periods {
    usual: Option<PartitionTimes>,
    others: BTreeMap<u32, PartitionTimes>,
    /// The schedule whose periods hold, and since when, ns.
    followed: Option<(u32, u64)>,
}

impl Periods {
    pub(crate) fn of(context: &Context) -> Self {
        let ProcessPlan { period_ns, release_ns, duration_ns, .. } = context.process_plan();
        let usual = Some(PartitionTimes { period_ns, release_ns, duration_ns });
        Self { usual, others: context.schedule_times().clone(), followed: None }
    }
}

/// What a service asks before it begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Asks {
    /// What time it is.
    Time,
    Nothing,
}

/// What became of the baton.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Passed {
    /// Its holder keeps it.
    Kept,
    /// Somebody else has it.
    Away,
}

impl Kernel {
    pub(crate) fn new(page: Mapped<ControlPage>, clock: Clock, partition: Partition, shown: Shown) -> Self {
        let state = State {
            partition,
            ports: PlanPorts::default(),
            batons: vec![Arc::default(), Arc::default()],
            bodies: vec![None, None],
            holder: MAIN,
            shown,
            now: 0,
            window_end: SystemTime::MAX,
            closing: false,
            settled: false,
            main_until: SystemTime::MIN,
            has_lent: false,
            periods: Periods::default(),
            orphan: None,
        };
        let schedules = OnceLock::new();
        Self { page, clock, begun: AtomicI64::new(0), schedules, state: Mutex::new(state) }
    }

    /// The main process begins at this module time: nobody sees time go back when a partition starts again.
    pub(crate) fn begin_at(&self, now: SystemTime) {
        let mut state = self.lock();
        state.now = now;
        self.begun.fetch_max(now, Ordering::Relaxed);
        state.partition.advance(now);
    }

    /// Nobody who panics holds it for longer than a service, and each service leaves the state whole.
    pub(crate) fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Module time on the wall clock, ns.
    fn wall_ns(&self) -> SystemTime {
        match self.page.origin_ns.load(Ordering::Relaxed) {
            0 => 0,
            origin_ns => monotonic_ns().saturating_sub(origin_ns) as SystemTime,
        }
    }

    /// What GET_TIME says in a window on the wall clock, without the partition's lock; `None` on the virtual one.
    pub(crate) fn wall_time(&self) -> Option<SystemTime> {
        (self.clock == Clock::Wall).then(|| self.wall_ns().max(self.begun.load(Ordering::Relaxed)))
    }

    /// On the wall clock: how the partition stands at the beginning of a service of the holder `me`, if it is still that one's turn.
    pub(crate) fn keep_turn(&self, state: &mut State, me: usize, asks: Asks) -> Option<Standing> {
        if self.clock != Clock::Wall || !state.settled || state.closing || state.holder != me {
            return None;
        }
        let standing = state.partition.standing();
        if asks == Asks::Time {
            self.tick(state, 0);
        }
        state.is_as_it_was(Some(standing)).then_some(standing)
    }

    /// Time goes on by a service, or to what the clock says.
    pub(crate) fn tick(&self, state: &mut State, service_ns: i64) {
        state.settled = false;
        state.now = match self.clock {
            // Before NORMAL no window counts.
            Clock::Virtual if !state.is_normal() => state.now,
            Clock::Virtual => state.now + service_ns,
            Clock::Wall => self.wall_ns(),
        };
        state.ports.now = state.now;
        state.partition.advance(state.now);
    }

    /// What a service costs under the virtual clock. On the wall clock it was read at the service's beginning, and what becomes due is the
    /// main thread's to see.
    pub(crate) fn spend(&self, state: &mut State, service_ns: i64) {
        if self.clock == Clock::Virtual {
            self.tick(state, service_ns);
        }
    }

    /// The holder `me` lets go if another one is to run, the window is over, or nobody is ready.
    pub(crate) fn pass(&self, state: &mut State, me: usize) -> Passed {
        loop {
            if state.closing || (self.clock == Clock::Virtual && state.now >= state.window_end) {
                return state.give(me, MAIN, 0);
            }
            match state.partition.dispatch() {
                Dispatch::Run { who, life } => return state.give(me, place(who), life),
                Dispatch::Ended(_) => return state.give(me, MAIN, 0),
                Dispatch::Nobody => match state.partition.next_timer() {
                    // Nothing else happens until then.
                    Some(at) if self.clock == Clock::Virtual && at < state.window_end => {
                        state.now = state.now.max(at);
                        self.tick(state, 0);
                        state.serve_ports();
                    }
                    _ => return state.give(me, MAIN, 0),
                },
            }
        }
    }

    /// The main process waits until the error handler has nothing to do.
    pub(crate) fn let_handler_run(&self) {
        loop {
            let mut state = self.lock();
            self.tick(&mut state, 0);
            // Who created it by its service alone is told later that it has no thread.
            if state.bodies[HANDLER].is_none() || self.pass(&mut state, MAIN) == Passed::Kept {
                return;
            }
            let baton = state.batons[MAIN].clone();
            drop(state);
            baton.take();
        }
    }

    /// Lets processes run in a window (the main thread). It is over when nobody has anything to do before its end.
    pub(crate) fn window(self: &Arc<Self>, start_ns: u64, end_ns: u64) {
        {
            let mut state = self.lock();
            let state = &mut *state;
            state.window_end = end_ns as SystemTime;
            state.closing = false;
            state.take_back();
            state.now = state.now.max(start_ns as SystemTime);
            self.begun.fetch_max(state.now, Ordering::Relaxed);
            state.partition.advance(state.now);
            if !state.is_normal() {
                // Release points count from the first window on. In NORMAL already: it was asked for before.
                let _ = state.partition.set_partition_mode(OperatingMode::Normal);
            }
            self.tick(state, 0);
            state.serve_ports();
        }
        match self.clock {
            Clock::Virtual => self.window_without_interruption(),
            Clock::Wall => self.window_with_interruptions(),
        }
    }

    fn window_without_interruption(self: &Arc<Self>) {
        loop {
            let mut state = self.lock();
            thread::adopt(self, &mut state);
            if self.pass(&mut state, MAIN) == Passed::Away {
                let baton = state.batons[MAIN].clone();
                drop(state);
                baton.take();
                state = self.lock();
            }
            if state.orphan.is_none() {
                return;
            }
        }
    }

    fn window_with_interruptions(self: &Arc<Self>) {
        let baton = self.lock().batons[MAIN].clone();
        let mut watch = Watch { look_at: 0, lent_until: None };
        loop {
            let mut state = self.lock();
            self.tick(&mut state, 0);
            state.serve_ports();
            let last = state.window_end - MARGIN_NS;
            state.closing |= state.now >= last;
            watch.take_back(&mut state);
            if state.holder == MAIN {
                thread::adopt(self, &mut state);
                let kept = self.pass(&mut state, MAIN) == Passed::Kept;
                let timer = state.partition.next_timer().unwrap_or(SystemTime::MAX);
                if state.orphan.is_some() {
                    continue;
                }
                if kept && (state.closing || state.ended().is_some() || (timer >= last && !state.has_lent)) {
                    return;
                }
            }
            let until = watch.look(&state, last);
            state.main_until = until;
            let span_ns = until.saturating_sub(self.wall_ns()).clamp(0, 1_000_000_000) as u64;
            drop(state);
            baton.take_within(span_ns);
        }
    }
}

/// What the main thread remembers of a window, module time, ns.
struct Watch {
    /// When the running process is asked whether it sleeps.
    look_at: SystemTime,
    /// When those that were passed over are asked again.
    lent_until: Option<SystemTime>,
}

impl Watch {
    /// Those that slept long enough may run again.
    fn take_back(&mut self, state: &mut State) {
        if !state.has_lent {
            self.lent_until = None;
            return;
        }
        if state.now >= *self.lent_until.get_or_insert(state.now + LENT_NS) {
            state.take_back();
            (self.lent_until, self.look_at) = (None, state.now + ASK_SOON_NS);
        }
    }

    /// Asks the running process to stop, or whether it sleeps. When to look again: at the `last` instant of the window at the latest, but
    /// later if it has to run to stop.
    fn look(&mut self, state: &State, last: SystemTime) -> SystemTime {
        let timer = state.partition.next_timer().unwrap_or(SystemTime::MAX);
        let timer = timer.min(self.lent_until.unwrap_or(SystemTime::MAX));
        let (runs, now) = (state.holder != MAIN, state.now);
        if runs && (state.closing || !state.is_holders_turn()) {
            thread::interrupt(&state.batons[state.holder]);
            // It does not begin to close later than it would without this.
            let soon = now + ASK_SOON_NS;
            return if state.closing { soon } else { (now + ASK_AGAIN_NS).min(last.max(soon)) };
        }
        let shared = runs && state.partition.others_are_ready();
        if shared && now >= self.look_at {
            thread::interrupt(&state.batons[state.holder]);
            self.look_at = now + LOOK_NS;
        }
        let ports = if state.partition.waits_at_ports() { now + LOOK_NS } else { SystemTime::MAX };
        let sleep = if shared { self.look_at } else { SystemTime::MAX };
        timer.min(ports).min(sleep).min(last)
    }
}

fn place(who: Runner) -> usize {
    match who {
        Runner::Main => MAIN,
        Runner::Handler => HANDLER,
        Runner::Process(id) => FIRST_PROCESS - 1 + id.0 as usize, // processes are numbered from 1
    }
}

impl State {
    /// The window is one of a schedule that may be another one: its periods hold, counted from a major frame of it. Release points that are
    /// set stay.
    pub(crate) fn follow_schedule(&mut self, window: &WindowGrant) {
        let running = Some((window.schedule, window.schedule_since_ns));
        if self.periods.followed == running {
            return;
        }
        self.periods.followed = running;
        let schedule = window.schedule;
        let Some(times) = self.periods.others.get(&schedule).copied().or(self.periods.usual) else { return };
        let time = |ns: u64| SystemTime::try_from(ns).unwrap_or(SystemTime::MAX);
        let origin = time(window.major_frame_ns.saturating_add(times.release_ns));
        let period = time(times.period_ns).max(1);
        self.partition.change_grid(PeriodGrid { origin, period }, time(times.duration_ns));
    }

    /// The partition runs no more.
    pub(crate) fn ended(&self) -> Option<End> {
        match self.partition.dispatch() {
            Dispatch::Ended(end) => Some(end),
            Dispatch::Run { .. } | Dispatch::Nobody => None,
        }
    }

    /// Who runs sleeps outside of services: others run instead.
    pub(crate) fn lend(&mut self) {
        (self.has_lent, self.settled) = (true, false);
        self.partition.lend();
    }

    fn take_back(&mut self) {
        (self.has_lent, self.settled) = (false, false);
        self.partition.take_back();
    }

    /// Processes that wait at ports get what has come, and what is no longer in their way.
    pub(crate) fn serve_ports(&mut self) {
        if self.partition.waits_at_ports() {
            self.settled = false;
            self.partition.serve_ports(&mut self.ports);
        }
    }

    /// The partition stands as it did: whoever had the turn keeps it.
    pub(crate) fn is_as_it_was(&mut self, standing: Option<Standing>) -> bool {
        let same = standing == Some(self.partition.standing());
        self.settled |= same;
        same
    }

    fn is_normal(&self) -> bool {
        self.partition.get_partition_status().operating_mode == OperatingMode::Normal
    }

    /// The scheduler names who has the baton.
    pub(crate) fn is_holders_turn(&self) -> bool {
        let Dispatch::Run { who, life } = self.partition.dispatch() else { return false };
        place(who) == self.holder && self.batons[self.holder].life.load(Ordering::Relaxed) == life
    }

    /// Wakes the main thread if it would sleep for longer than it may (a process, on the wall clock).
    fn wake_main_in_time(&mut self) {
        let shared = self.partition.waits_at_ports() || self.partition.others_are_ready();
        let look = if shared { self.now + LOOK_NS } else { SystemTime::MAX };
        let wanted = self.partition.next_timer().map_or(look, |timer| timer.min(look));
        if wanted < self.main_until {
            self.main_until = wanted;
            self.batons[MAIN].nudge();
        }
    }

    fn give(&mut self, me: usize, next: usize, life: u32) -> Passed {
        if me != MAIN && next != MAIN {
            self.wake_main_in_time();
        }
        self.settled = next != MAIN;
        let baton = &self.batons[next];
        let begins_again = baton.life.load(Ordering::Relaxed) != life;
        if baton.preempted.load(Ordering::Relaxed) && begins_again {
            // Threads are made by the main thread: who gives may be in a signal's handler.
            self.orphan = Some(next);
            return self.give(me, MAIN, 0);
        }
        if next == me {
            baton.life.store(life, Ordering::Relaxed);
            return Passed::Kept;
        }
        self.holder = next;
        self.shown.switch(next, self.now);
        self.batons[next].give(life);
        Passed::Away
    }
}
