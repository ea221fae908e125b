//! Starts the partitions, runs their windows, ends them.

use std::cell::RefCell;
use std::collections::VecDeque;
use std::path::Path;
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use bateleur_contract::Clock;
use rtrb::Consumer;

use super::course::{Course, Ended};
use super::wall_threads::{Lanes, Tables, run_wall};
use super::{Options, RunError};
use crate::fast::{Records, VirtualGate, VirtualPace, World};
use crate::playing::Player;
use crate::recording::Recording;
use crate::world::Surroundings;
use bateleur_contract::page::WindowGrant;
use bateleur_control::{Inbox, Status};
use bateleur_host::error_log::ErrorReader;
use bateleur_host::machine::Machine;
use bateleur_host::partition::Sandbox;
use bateleur_monitor::cleanup::EndedHelpers;
use bateleur_monitor::event::Event;
use bateleur_monitor::observers::StartObserver;
use bateleur_monitor::operator::Operator;
use bateleur_monitor::rebuild::RebuildHooks;
use bateleur_monitor::run_order::RunOrder;
use bateleur_monitor::why::Why;
use bateleur_monitor::{Alignment, CrashReporter, Monitor, MonitorConfig, StartChannelCleaner};
use bateleur_plan::{ModuleView, PartitionId, Plan, Timeline};
use bateleur_system::sched;
use bateleur_system::time::now_ns;
use bateleur_time::alignment::Following;
use bateleur_time::change::Changes;
use bateleur_time::dispatcher::{Dispatcher, Occurrence};
use bateleur_time::redundant_pair::RedundantPair;
use bateleur_time::schedule_switch::ScheduleSwitch;
use bateleur_time::shared_clock::{JointPace, Member};
use bateleur_time::stall::Stall;
use bateleur_time::window_record::WindowRecord;

/// What serves a run beside its partitions.
pub(super) struct Services {
    /// Writes every message down, where that was asked for.
    pub(super) recording: Option<Recording>,
    /// Drives the module's inputs, where that was asked for.
    pub(super) player: Option<Player>,
    /// Cleans up after the dead.
    pub(super) start_channel_cleaner: StartChannelCleaner,
    /// Reads what the dead have written down.
    pub(super) crash_reporter: CrashReporter,
    /// Channel holders that have ended, and the channels that they held; `None` if they are not cleaned up after.
    pub(super) ended_helpers: Option<(EndedHelpers, Vec<String>)>,
    /// Finds damaged channels and makes them anew.
    pub(super) rebuilds: RebuildHooks,
    /// Reads channels for operators.
    pub(super) start_observer: StartObserver,
    /// Where orders come from; `None` if there is no control socket.
    pub(super) inbox: Option<Inbox>,
    /// Reads the partitions' standard error.
    pub(super) error_reader: ErrorReader,
    /// The run's name.
    pub(super) run: String,
}

/// Starts the partitions, runs their windows, ends them.
pub(super) fn run_module(
    plan: &Arc<Plan>,
    view: &ModuleView<'_>,
    options: &Options,
    facts: &Machine,
    sandboxes: Vec<Sandbox>,
    services: Services,
    course: &mut Course,
) -> Result<Ended, RunError> {
    let Some(mut kept) = course.kept.take() else { return Err(RunError::Start("it runs already".into())) };
    if kept.why.is_none() {
        kept.why = begin_why(options, facts, view, &services.run);
    }
    let resets = kept.resets();
    let condition = course.take_condition(resets);
    let records = Records::default();
    let rings: Rc<RefCell<Vec<Consumer<WindowRecord>>>> = Rc::default();
    let stall = Arc::new(Stall::default());
    let schedule_switch = Arc::new(ScheduleSwitch::new(plan.initial_schedule().index()));
    let mut monitor = Monitor::new(MonitorConfig {
        plan: plan.clone(),
        schedule_switch: schedule_switch.clone(),
        clock: options.order.clock(),
        start_channel_cleaner: services.start_channel_cleaner,
        crash_reporter: services.crash_reporter,
        ended_helpers: services.ended_helpers,
        rebuilds: services.rebuilds,
        take_record: take_record(records.clone(), rings.clone()),
        kept,
        operator: Operator::new(
            services.inbox,
            about(&options.order),
            stall.clone(),
            Some(services.start_observer),
        ),
        error_reader: services.error_reader,
    });
    let lanes = Lanes { rings, lost: Arc::default(), spun_ns: Arc::default(), stall };
    let begun_ns = course.reached_ns();
    let start = module_start(&options.order.module, options.order.clock(), resets);
    monitor.health_log().note_module("module_start", start, begun_ns);
    if let Some(counts) = course.surroundings.line_counts() {
        line_sandboxes(view, &sandboxes).for_each(|sandbox| sandbox.control.carry_on_line(counts));
    }
    if options.order.clock() == Clock::Virtual {
        // No window runs yet: partitions initialise on every processor, not on those alone that are left for other work.
        let all: Vec<u32> = sched::allowed_cores().into_iter().chain(facts.partitioned_cores()).collect();
        let _ = sched::bind(0, &all); // it takes longer
    }
    let started = monitor.launch(sandboxes, condition).and_then(|()| monitor.await_all_ready(&options.stop));
    let ran = match started {
        Ok(false) => {
            course.surroundings.heed_stop();
            Ok(begun_ns)
        }
        Ok(true) => {
            let (clock, output) = (options.order.clock(), options.order.output.as_path());
            let ready = Ready { plan, view, clock, facts, schedule_switch, records, lanes: &lanes, output };
            ready.run(&mut monitor, (services.recording, services.player), resets, course)
        }
        Err(reason) => Err(RunError::Start(reason)),
    };
    let module_ns = ran.as_ref().map_or(begun_ns, |module_ns| *module_ns);
    monitor.finish(module_ns);
    if let Some(reason) = course.surroundings.finish() {
        let time_s = module_ns as f64 / 1e9;
        monitor.events().tell(&Event::LogLost { time_s, log: "ports.mcap".into(), reason });
    }
    let stop = monitor.stop_asked().cloned();
    course.kept = Some(monitor.hand_on());
    ran.map(|module_ns| {
        let over = course.surroundings.is_over();
        Ended {
            reason: course.surroundings.reason(stop.as_ref().map(|stop| stop.reason.as_str())),
            module_ns,
            reset: !over && stop.as_ref().is_some_and(|stop| stop.reset),
            faulty: !over && stop.is_some(),
            left_behind: false,
            lost_records: lanes.lost.load(Ordering::Relaxed),
            spun_ns: lanes.spun_ns.load(Ordering::Relaxed),
        }
    })
}

/// A module whose partitions have initialised.
struct Ready<'a> {
    plan: &'a Plan,
    view: &'a ModuleView<'a>,
    clock: Clock,
    facts: &'a Machine,
    schedule_switch: Arc<ScheduleSwitch>,
    records: Records,
    lanes: &'a Lanes,
    output: &'a Path,
}

impl Ready<'_> {
    /// Runs its windows, from frame 0 until it stops; gives the module time of that, ns.
    fn run(
        self,
        monitor: &mut Monitor,
        (recording, player): (Option<Recording>, Option<Player>),
        resets: u32,
        course: &mut Course,
    ) -> Result<u64, RunError> {
        let Self { plan, view, clock, facts, schedule_switch, records, lanes, output } = self;
        let pair = monitor.pair();
        connect(&pair, plan, clock);
        let module = (plan.modules.len() > 1).then(|| plan[view.id()].name.clone());
        monitor.events().tell(&Event::Ready { partitions: pair.iter().flatten().count(), module });
        let line = line_partition(view).and_then(|line| pair[line.index()].clone());
        course.surroundings.begin(recording, player, line);
        let (begin_ns, origin_ns) = course.begin(resets)?;
        schedule_switch.begin(begin_ns);
        let tables = Tables {
            timelines: Timeline::all(plan, view.id()),
            changes: Arc::new(Changes::of(plan, schedule_switch.clone())),
            schedule_switch,
            begin_ns,
        };
        monitor.begin(begin_ns, origin_ns);
        let surroundings = &mut course.surroundings;
        match clock {
            Clock::Virtual => {
                Ok(run_virtual(&tables, monitor, surroundings, records, facts, course.member.as_ref()))
            }
            Clock::Wall => {
                if let Some(following) = Following::of(plan, view.id()) {
                    let relay = plan.relay_of(view.id()).map(PartitionId::index);
                    monitor.follow(Alignment::new(
                        following,
                        &tables.timelines,
                        relay,
                        origin_ns,
                        output,
                        resets,
                    ));
                }
                run_wall(&tables, monitor, (surroundings, course.page.as_ref()), lanes, facts, origin_ns)
            }
        }
    }
}

/// Who answers why windows went as they did: nobody on the virtual clock, where nobody takes a processor from anybody. Without him the
/// module runs all the same.
fn begin_why(options: &Options, facts: &Machine, view: &ModuleView<'_>, run: &str) -> Option<Why> {
    if options.order.clock() == Clock::Virtual {
        return None;
    }
    let timelines = Timeline::all(view.plan(), view.id());
    let cores = timelines.first()?.cores.iter().map(|line| (line.core, facts.real_core(line.core)));
    Why::begin(run, &options.order.output, cores.collect()).ok()
}

/// What the persistent log and the partitions' logs say of a run's begin. Module time begins anew with every run: the date tells them apart.
pub(super) fn module_start(module: &str, clock: Clock, resets: u32) -> String {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    let clock = match clock {
        Clock::Wall => "wall",
        Clock::Virtual => "virtual",
    };
    let reset = if resets == 0 { String::new() } else { format!(", after reset {resets}") };
    format!("module {module}, {clock} clock, Unix time {} s{reset}", since.as_secs())
}

/// What does not change while it runs.
fn about(order: &RunOrder) -> Status {
    let clock = match order.clock() {
        Clock::Wall => "wall",
        Clock::Virtual => "virtual",
    };
    Status {
        module: order.module.clone(),
        pid: std::process::id() as i32,
        clock: clock.into(),
        // Whoever asks may be in another folder.
        folder: std::path::absolute(&order.output).unwrap_or_else(|_| order.output.clone()),
        ..Status::default()
    }
}

/// Where the monitor finds window records: in the virtual gate's queue, or in the rings of the dispatcher threads.
fn take_record(
    records: Records,
    rings: Rc<RefCell<Vec<Consumer<WindowRecord>>>>,
) -> Box<dyn FnMut() -> Option<WindowRecord>> {
    Box::new(move || {
        let queued: Option<WindowRecord> = VecDeque::pop_front(&mut records.borrow_mut());
        queued.or_else(|| rings.borrow_mut().iter_mut().find_map(|ring| ring.pop().ok()))
    })
}

/// The partition whose device the companion holds the other end of: the first that may open one.
fn line_partition(view: &ModuleView<'_>) -> Option<PartitionId> {
    view.partitions().find(|id| !view.plan()[*id].devices.is_empty())
}

/// Its sandboxes: one more where a process stands by.
fn line_sandboxes<'a>(view: &ModuleView<'_>, sandboxes: &'a [Sandbox]) -> impl Iterator<Item = &'a Sandbox> {
    let line = line_partition(view);
    let of_it = sandboxes.iter().filter(move |sandbox| Some(sandbox.id) == line);
    of_it.flat_map(|sandbox| std::iter::once(sandbox).chain(sandbox.standby.as_deref()))
}

/// A first grant without a window: every port connects to its peers now, not in its first window.
fn connect(pair: &[Option<Arc<RedundantPair>>], plan: &Plan, clock: Clock) {
    let initial = plan.initial_schedule();
    let (minor_frame_ns, schedule) = (plan[initial].minor_frame_ns, initial.index() as u32);
    for pair in pair.iter().flatten() {
        pair.all().for_each(|control| control.set_clock(u32::from(clock == Clock::Virtual)));
        let control = pair.active();
        control.grant_without_window(
            &WindowGrant { minor_frame_ns, schedule, next_schedule: schedule, ..WindowGrant::default() },
            now_ns(),
        );
        let begun_ns = now_ns();
        while !control.is_done() && now_ns() - begun_ns < 100_000_000 {
            control.await_change(1_000_000);
        }
        // It had no window yet, and must not take anybody's.
        control.end_window(!control.is_done());
    }
}

fn run_virtual(
    tables: &Tables,
    monitor: &mut Monitor,
    surroundings: &mut Surroundings,
    records: Records,
    facts: &Machine,
    member: Option<&Member>,
) -> u64 {
    // On the partitions' own core a grant is a switch, not an interrupt to another processor.
    let _ = sched::bind(0, &facts.partitioned_cores()); // slower otherwise, nothing else
    let dispatcher = Dispatcher::new(&tables.timelines, tables.schedule_switch.clone(), true, |_| true);
    let mut dispatcher = dispatcher.beginning_at(tables.begin_ns);
    let Some(member) = member else {
        let mut gate = VirtualGate::new(monitor, surroundings, records, tables.changes.clone());
        dispatcher.run(&mut VirtualPace, &mut gate, &|_| false);
        return surroundings.module_ns();
    };
    let mut world = Joint { surroundings, member };
    let mut gate = VirtualGate::new(monitor, &mut world, records, tables.changes.clone());
    dispatcher.run(&mut JointPace(member), &mut gate, &|_| false);
    world.tell_deaths(world.surroundings.module_ns(), monitor);
    let starts_again = monitor.stop_asked().is_some_and(|stop| stop.reset) && !surroundings.is_over();
    if !starts_again {
        member.leave();
    }
    surroundings.module_ns()
}

/// What surrounds a module that shares its clock: the others too.
struct Joint<'a> {
    surroundings: &'a mut Surroundings,
    member: &'a Member,
}

impl Joint<'_> {
    fn tell_deaths(&self, module_ns: u64, monitor: &mut Monitor) {
        for partition in self.member.newly_dead() {
            let text = "this module on the same virtual clock has died: it is not waited for any more".into();
            let time_s = module_ns as f64 / 1e9;
            monitor.events().tell(&Event::Message { time_s, partition, text });
        }
    }
}

impl World for Joint<'_> {
    fn minor_frame(&mut self, module_ns: u64, monitor: &mut Monitor) -> bool {
        self.tell_deaths(module_ns, monitor);
        self.surroundings.minor_frame(module_ns, monitor)
    }

    fn window(&mut self, occurrence: &Occurrence) {
        self.surroundings.window(occurrence);
    }

    fn window_closed(&mut self) {
        self.surroundings.window_closed();
    }
}
