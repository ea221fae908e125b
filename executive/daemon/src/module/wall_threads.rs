//! The threads of a module on the wall clock: one dispatcher for each core, and the freeze worker beside them. The caller's thread
//! monitors until they have ended.

use std::cell::RefCell;
use std::io;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::thread::JoinHandle;

use rtrb::{Consumer, RingBuffer};

use super::{RunError, machine};
use crate::fast::World;
use crate::world::Surroundings;
use bateleur_contract::Mapped;
use bateleur_host::machine::Machine;
use bateleur_monitor::Monitor;
use bateleur_plan::{ModuleError, Timeline};
use bateleur_system::sched;
use bateleur_system::thread;
use bateleur_system::time::now_ns;
use bateleur_time::change::Changes;
use bateleur_time::dispatcher::Dispatcher;
use bateleur_time::freeze_worker::FreezeWorker;
use bateleur_time::redundant_pair::RedundantPair;
use bateleur_time::run_page::{Heartbeat, RunPage};
use bateleur_time::schedule_switch::ScheduleSwitch;
use bateleur_time::stall::Stall;
use bateleur_time::wall::{WallGate, WallPace};
use bateleur_time::window_record::WindowRecord;

/// Why a module ends whose dispatcher has ended by itself.
const LOST_CORE: &str =
    "a dispatcher was held up for longer than the schedules of the major frames are remembered";
/// Window records that wait for the monitor: two seconds of a busy core.
const RECORDS: usize = 4096;
/// How often the monitor looks, ns. A death wakes it at once; what a window's record tells, and an order, wait for the next look.
const MONITOR_PERIOD_NS: u64 = 10_000_000;
/// As above while a partition starts, ns: it says on its control page that it is ready, which wakes nobody.
const START_PERIOD_NS: u64 = 500_000;
/// Above every partition (50 at most) and every interrupt thread (50); below the kernel's own watchdogs (99).
const DISPATCHER_PRIORITY: u8 = 98;
/// The freeze worker's, on processors that no partition has.
const FREEZE_PRIORITY: u8 = 97;
/// The freeze worker's, where every processor has partitions: below each of them.
const FREEZE_PRIORITY_IN_SLACK: u8 = 1;

/// All that is known about time before frame 0.
pub(super) struct Tables {
    pub(super) timelines: Vec<Timeline>,
    pub(super) schedule_switch: Arc<ScheduleSwitch>,
    pub(super) changes: Arc<Changes>,
    /// Module time of frame 0.
    pub(super) begin_ns: u64,
}

impl Tables {
    /// The next minor frame of the schedule that runs: when the world is asked again.
    pub(super) fn following_minor_frame(&self, module_ns: u64) -> u64 {
        let minor_frame_ns = self.timelines[self.schedule_switch.current()].minor_frame_ns;
        let since_ns = self.schedule_switch.newest_frame_ns();
        since_ns + (module_ns.saturating_sub(since_ns) / minor_frame_ns + 1) * minor_frame_ns
    }
}

/// What dispatcher threads share with the monitor.
pub(super) struct Lanes {
    pub(super) rings: Rc<RefCell<Vec<Consumer<WindowRecord>>>>,
    pub(super) lost: Arc<AtomicU64>,
    pub(super) spun_ns: Arc<AtomicU64>,
    pub(super) stall: Arc<Stall>,
}

/// Runs windows from frame 0 until the module stops; gives the module time of that, ns.
pub(super) fn run_wall(
    tables: &Tables,
    monitor: &mut Monitor,
    (surroundings, page): (&mut Surroundings, Option<&Arc<Mapped<RunPage>>>),
    lanes: &Lanes,
    facts: &Machine,
    origin_ns: u64,
) -> Result<u64, RunError> {
    let pair = monitor.pair();
    pair.iter().flatten().flat_map(|pair| pair.all()).for_each(|control| control.set_origin_ns(origin_ns));
    let stop = Arc::new(AtomicBool::new(false));
    // Dispatchers that ended because they were to: each is counted before its thread is seen to be finished.
    let orderly = Arc::new(AtomicUsize::new(0));
    let mut threads = Vec::new();
    let freezing = Freezing::begin(&pair, facts, Heartbeat::of_freeze_worker(page))
        .map_err(machine("cannot start the freeze worker's thread"))?;
    let monitor_beat = Heartbeat::of_monitor(page);
    for (place, line) in tables.timelines.first().into_iter().flat_map(|timeline| &timeline.cores).enumerate()
    {
        let (producer, consumer) = RingBuffer::new(RECORDS);
        let (core, real_time, all_stop) = (facts.real_core(line.core), facts.real_time, &stop);
        let (stop, orderly) = (stop.clone(), orderly.clone());
        let until_ns = surroundings.until_ns().unwrap_or(u64::MAX);
        lanes.rings.borrow_mut().push(consumer);
        let gate = WallGate::new(
            pair.clone(),
            origin_ns,
            producer,
            lanes.lost.clone(),
            tables.changes.clone(),
            (line.core, core),
            lanes.stall.clone(),
        )
        .beside(freezing.apart.clone());
        let dispatcher = Dispatcher::new(&tables.timelines, tables.schedule_switch.clone(), false, |core| {
            core == line.core
        })
        .beginning_at(tables.begin_ns);
        let beat = Heartbeat::of_dispatcher(page, place);
        let pace = WallPace::new(origin_ns, lanes.spun_ns.clone(), beat);
        let thread = thread::named(&format!("dispatch {}", line.core)).spawn(move || {
            let stop = |frame_ns| stop.load(Ordering::Acquire) || frame_ns >= until_ns;
            if dispatch(dispatcher, gate, pace, core, real_time, &stop) {
                orderly.fetch_add(1, Ordering::Release);
            }
        });
        match thread {
            Ok(thread) => threads.push(thread),
            Err(error) => {
                all_stop.store(true, Ordering::Release);
                await_ends(threads);
                return Err(machine("cannot start a dispatcher thread")(error));
            }
        }
    }
    // What was made since the machine was examined: tables, rings, pages, stacks. Refused: the list of guarantees says so.
    let _ = rustix::mm::mlockall(rustix::mm::MlockAllFlags::CURRENT);
    let mut next_minor_ns = tables.begin_ns;
    loop {
        monitor.pause(if monitor.awaits_start() { START_PERIOD_NS } else { MONITOR_PERIOD_NS });
        monitor_beat.beat();
        if let Some(page) = page {
            page.keep_counts(monitor.totals().counts());
        }
        let module_ns = now_ns().saturating_sub(origin_ns);
        monitor.step(module_ns);
        let finished = threads.iter().filter(|thread| thread.is_finished()).count();
        if finished > orderly.load(Ordering::Acquire) {
            monitor.module_fault(ModuleError::LateDispatcher, LOST_CORE, false, module_ns);
            break;
        }
        if module_ns >= next_minor_ns {
            next_minor_ns = tables.following_minor_frame(module_ns);
            if !surroundings.minor_frame(module_ns, monitor) || monitor.stop_asked().is_some() {
                break;
            }
        }
    }
    stop.store(true, Ordering::Release);
    // They end with their major frame, which may be long: what happens until then is seen.
    while !threads.iter().all(JoinHandle::is_finished) {
        monitor.pause(MONITOR_PERIOD_NS);
        monitor_beat.beat();
        monitor.step(now_ns().saturating_sub(origin_ns));
    }
    await_ends(threads);
    Ok(now_ns().saturating_sub(origin_ns))
}

/// Waits for dispatchers that have been told to stop.
fn await_ends(threads: Vec<JoinHandle<()>>) {
    for thread in threads {
        let _ = thread.join(); // a panic there was printed; the module ends either way
    }
}

/// A dispatcher thread's life; whether it ended because it was to.
fn dispatch(
    mut dispatcher: Dispatcher,
    mut gate: WallGate,
    mut pace: WallPace,
    core: u32,
    real_time: bool,
    stop: &dyn Fn(u64) -> bool,
) -> bool {
    let _ = sched::bind(0, &[core]); // said at the start where it can not be
    if real_time {
        let _ = sched::fifo(0, DISPATCHER_PRIORITY); // as above
    }
    dispatcher.run(&mut pace, &mut gate, stop)
}

/// The freeze worker at work, until this is dropped. Without real-time priorities a dispatcher freezes by itself: nothing else would stop
/// a partition at its window's end.
struct Freezing {
    worker: Option<(Arc<FreezeWorker>, JoinHandle<()>)>,
    /// The worker, if no dispatcher uses its processors.
    apart: Option<Arc<FreezeWorker>>,
}

impl Freezing {
    fn begin(pairs: &[Option<Arc<RedundantPair>>], facts: &Machine, beat: Heartbeat) -> io::Result<Self> {
        if !facts.real_time {
            return Ok(Self { worker: None, apart: None });
        }
        let pairs: Vec<_> = pairs.iter().flatten().cloned().collect();
        let partitioned = facts.partitioned_cores();
        let shares = sched::allowed_cores().iter().any(|core| partitioned.contains(core));
        let priority = if shares { FREEZE_PRIORITY_IN_SLACK } else { FREEZE_PRIORITY };
        let worker = FreezeWorker::new();
        let own = worker.clone();
        let thread = thread::named("freeze").spawn(move || {
            let _ = sched::fifo(0, priority); // said at the start where it can not be
            own.run(&pairs, &beat);
        })?;
        let apart = (!shares).then(|| worker.clone());
        Ok(Self { worker: Some((worker, thread)), apart })
    }
}

impl Drop for Freezing {
    fn drop(&mut self) {
        if let Some((worker, thread)) = self.worker.take() {
            worker.end();
            let _ = thread.join(); // a panic there was printed; whoever asks freezes by himself
        }
    }
}
