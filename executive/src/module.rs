//! One run of a module: from the checked plan to the last process ended.

use std::cell::RefCell;
use std::collections::{BTreeMap, VecDeque};
use std::fs::{self, File};
use std::io::{Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use bateleur_contract::Clock;
use rtrb::{Consumer, RingBuffer};

use crate::dispatcher::Dispatcher;
use crate::event::{Event, Events};
use crate::fast::{Records, VirtualGate, VirtualPace};
use crate::guarantee::Guarantee;
use crate::health::log::{HealthLog, WindowLog, WindowRecord};
use crate::helper::custodian::{Order, OrderedChannel};
use crate::helper::guard::FAREWELL;
use crate::instance::{Instance, clean_leftovers};
use crate::machine::Machine;
use crate::monitor::{Equipment, Monitor, StartJanitor};
use crate::partition::{Cage, Housing, message_name, queue_depth};
use crate::plan::{ModuleView, Plan, Timeline};
use crate::slot::Slot;
use crate::system::sched;
use crate::system::spawn::{Namespaces, Request, Spawned, User, spawn};
use crate::system::time::now_ns;
use crate::wall::{WallGate, WallPace};
use crate::world::{Companion, Killing, Recorder, Surroundings};

/// Real time from "ready" to module time 0: long enough for every dispatcher thread to be in its sleep.
const LEAD_NS: u64 = 20_000_000;
/// Window records that wait for the monitor: two seconds of a busy core.
const RECORDS: usize = 4096;
/// How often the monitor looks on the wall clock, ns. A death wakes it at once.
const MONITOR_PERIOD_NS: u64 = 5_000_000;
/// How long the custodian may take to create every channel.
const CUSTODIAN_PATIENCE_NS: u64 = 10_000_000_000;

/// What a run is asked to do.
pub struct Options {
    /// The module's name.
    pub module: String,
    /// The clock.
    pub clock: Clock,
    /// Folder for logs; made where it is missing.
    pub output: PathBuf,
    /// Folder of the schedule file: programs with a path start there.
    pub plan_folder: PathBuf,
    /// Attributes that replace the plan's, by partition.
    pub overrides: BTreeMap<String, BTreeMap<String, serde_json::Value>>,
    /// Partitions to kill, with the module time, ns.
    pub kills: Vec<(String, u64)>,
    /// End at this module time, ns.
    pub until_ns: Option<u64>,
    /// Refuse to start where a promise does not hold.
    pub strict: bool,
    /// A file for every message of every port.
    pub record: Option<PathBuf>,
    /// Who lives at the other end of a line under the virtual clock.
    pub companion: Option<Companion>,
    /// Who watches.
    pub events: Events,
    /// Set by a signal: end at the end of the major frame.
    pub stop: Arc<AtomicBool>,
}

/// Why a module did not run.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The plan has no such module.
    #[error("the plan has no module \"{name}\"; it has {known}")]
    NoModule {
        /// What was asked for.
        name: String,
        /// What there is.
        known: String,
    },
    /// A partition that is not in the plan.
    #[error("the plan has no partition \"{name}\" in module {module}; it has {known}")]
    NoPartition {
        /// What was asked for.
        name: String,
        /// The module.
        module: String,
        /// What there is.
        known: String,
    },
    /// Programs that are not there.
    #[error("{0}")]
    Programs(String),
    /// `--require strict` and a promise that does not hold.
    #[error("refused to start, because strict was required and this machine lacks:\n{0}")]
    Strict(String),
    /// Something of the machine.
    #[error("{what}: {why}")]
    Machine {
        /// What was tried.
        what: String,
        /// What the machine said.
        why: String,
    },
    /// A partition did not start.
    #[error("{0}")]
    Start(String),
}

fn machine(what: impl Into<String>) -> impl FnOnce(std::io::Error) -> RunError {
    let what = what.into();
    move |error| RunError::Machine { what, why: error.to_string() }
}

/// How a run ended.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// Why.
    pub reason: String,
    /// Module time, ns.
    pub module_ns: u64,
    /// What the machine gave.
    pub guarantees: Vec<Guarantee>,
}

/// Runs a module until it is told to stop.
///
/// # Errors
/// What kept it from starting. Nothing is left behind then.
pub fn run(plan: Plan, mut options: Options) -> Result<Outcome, RunError> {
    let plan = Arc::new(plan);
    let view = module_of(&plan, &options.module)?;
    check_names(&view, &options)?;
    let programs = find_programs(&view, &options.plan_folder)?;
    clean_leftovers();
    let machine_facts = Machine::examine(&view, options.clock);
    let lacking: Vec<String> = machine_facts
        .guarantees
        .lacking()
        .map(|lack| format!("  {}: {}", lack.promise, lack.detail))
        .collect();
    if options.strict && !lacking.is_empty() {
        return Err(RunError::Strict(lacking.join("\n")));
    }
    options.events.tell(&Event::Guarantees { list: machine_facts.guarantees.list().to_vec() });
    let logs = options.output.join("partitions");
    fs::create_dir_all(&logs).map_err(machine(format!("cannot make {}", logs.display())))?;
    let base = Base::make(&options.module, &machine_facts, &logs)?;
    let result = base.run(&plan, &view, options, &machine_facts, programs);
    base.leave();
    result
}

fn module_of<'a>(plan: &'a Plan, name: &str) -> Result<ModuleView<'a>, RunError> {
    plan.module(name).ok_or_else(|| RunError::NoModule {
        name: name.into(),
        known: plan.modules.iter().map(|module| module.name.as_str()).collect::<Vec<_>>().join(", "),
    })
}

fn check_names(view: &ModuleView<'_>, options: &Options) -> Result<(), RunError> {
    let names: Vec<&str> = view.partitions().map(|id| view.plan()[id].name.as_str()).collect();
    let asked = options.kills.iter().map(|(name, _)| name).chain(options.overrides.keys());
    match asked.into_iter().find(|name| !names.contains(&name.as_str())) {
        None => Ok(()),
        Some(name) => Err(RunError::NoPartition {
            name: name.clone(),
            module: options.module.clone(),
            known: names.join(", "),
        }),
    }
}

/// Every partition's program, or all those that are missing.
fn find_programs(view: &ModuleView<'_>, folder: &Path) -> Result<Vec<PathBuf>, RunError> {
    let beside =
        std::env::current_exe().ok().and_then(|path| path.parent().map(Path::to_owned)).unwrap_or_default();
    let mut missing = Vec::new();
    let programs = view.partitions().map(|id| {
        let partition = &view.plan()[id];
        let path = if partition.program.contains('/') { folder.join(&partition.program) } else { beside.join(&partition.program) };
        if !path.is_file() {
            missing.push(format!(
                "partition {}: there is no program {} (program = \"{}\"): build it, or correct its line in the plan",
                partition.name,
                path.display(),
                partition.program
            ));
        }
        path
    });
    let programs = programs.collect();
    if missing.is_empty() { Ok(programs) } else { Err(RunError::Programs(missing.join("\n"))) }
}

/// What a helper process finds at its first descriptors.
#[derive(Default)]
struct Lines<'a> {
    input: Option<&'a OwnedFd>,
    output: Option<&'a OwnedFd>,
    file: Option<&'a File>,
}

/// The custodian, and the line whose end tells it to leave.
struct Custodian {
    process: Spawned,
    line: Option<File>,
}

impl Custodian {
    fn leave(&mut self) {
        drop(self.line.take());
        await_end(&self.process);
    }
}

/// Waits for a helper that was asked to end, and reaps it.
fn await_end(helper: &Spawned) {
    crate::partition::await_any_end(&[helper.pidfd.as_fd()], 1_000_000_000);
    let _ = crate::partition::ended(helper); // one that still runs dies with the executive
}

/// What a run has outside its output folder, and the processes that serve it.
struct Base {
    instance: Instance,
    group: Option<crate::system::cgroup::Group>,
    own_program: PathBuf,
    log: File,
    /// The guard, and the pipe whose end tells it that the executive is gone.
    guard: RefCell<Option<(Spawned, File)>>,
    user: Option<u32>,
}

impl Base {
    fn make(module: &str, facts: &Machine, logs: &Path) -> Result<Self, RunError> {
        let instance =
            Instance::create(module).map_err(machine("cannot make the module's directory in /dev/shm"))?;
        let made = Self::furnish(instance.clone(), facts, logs);
        if made.is_err() {
            instance.clean_up();
        }
        made
    }

    fn furnish(mut instance: Instance, facts: &Machine, logs: &Path) -> Result<Self, RunError> {
        let group = facts.make_group(&instance.name);
        if let Some(group) = &group {
            instance.set_group(group.path()).map_err(machine("cannot note the control group"))?;
        }
        instance.make_ports_directory(facts.user).map_err(machine("cannot make the ports' directory"))?;
        let log = File::create(logs.join("helpers.log")).map_err(machine("cannot write the helpers' log"))?;
        let own_program =
            std::env::current_exe().map_err(machine("cannot find the executive's own program"))?;
        let base = Self { instance, group, own_program, log, guard: RefCell::new(None), user: facts.user };
        base.start_guard()?;
        Ok(base)
    }

    fn start_guard(&self) -> Result<(), RunError> {
        let (reader, writer) = std::io::pipe().map_err(machine("cannot make a pipe"))?;
        let (reader, writer) = (OwnedFd::from(reader), File::from(OwnedFd::from(writer)));
        let text = serde_json::to_string(&self.instance).unwrap_or_default();
        let lines = Lines { input: Some(&reader), ..Lines::default() };
        let guard =
            self.helper(&["guard".into(), text], lines, false).map_err(machine("cannot start the guard"))?;
        *self.guard.borrow_mut() = Some((guard, writer));
        Ok(())
    }

    /// Starts this very program with a hidden verb.
    fn helper(
        &self,
        arguments: &[String],
        lines: Lines<'_>,
        as_partitions: bool,
    ) -> std::io::Result<Spawned> {
        let file: Vec<_> = lines.file.iter().map(|file| file.as_fd()).collect();
        spawn(&Request {
            program: &self.own_program,
            arguments,
            environment: &[],
            descriptors: &file,
            input: lines.input.map(AsFd::as_fd),
            output: lines.output.map(AsFd::as_fd),
            errors: self.log.as_fd(),
            group: None,
            namespaces: Namespaces::default(),
            user: self.user.filter(|_| as_partitions).map(|id| User { id, groups: Vec::new() }),
            data_limit: 0,
            dies_with_starter: as_partitions,
        })
    }

    fn order(&self, view: &ModuleView<'_>) -> Order {
        let plan = view.plan();
        let channels = view.channels().map(|id| {
            let channel = &plan[id];
            OrderedChannel {
                name: plan.port_path(channel.source),
                source: plan.port_path(channel.source),
                message: message_name(&plan[channel.source]),
                size: plan[channel.source].payload.max_size_bytes(),
                depth: queue_depth(plan, channel).map(|depth| depth as usize),
                destinations: channel.destinations.len(),
            }
        });
        let domain = self.instance.domain();
        Order { root: domain.root, prefix: domain.prefix, channels: channels.collect() }
    }

    /// Starts the custodian and waits until every channel is there.
    fn start_custodian(&self, order: &str) -> Result<Custodian, RunError> {
        let failed = || machine("cannot start the custodian");
        let (reader, writer) = std::io::pipe().map_err(failed())?;
        let (answer, answers) = std::io::pipe().map_err(failed())?;
        let (reader, answers) = (OwnedFd::from(reader), OwnedFd::from(answers));
        let lines = Lines { input: Some(&reader), output: Some(&answers), file: None };
        let custodian = self.helper(&["custodian".into(), order.into()], lines, true).map_err(failed())?;
        drop(answers);
        let answer = File::from(OwnedFd::from(answer));
        crate::partition::await_any_end(&[answer.as_fd()], CUSTODIAN_PATIENCE_NS);
        let mut said = [0; 6];
        match (&answer).read(&mut said) {
            Ok(count) if said[..count] == *b"ready\n" => {
                Ok(Custodian { process: custodian, line: Some(File::from(OwnedFd::from(writer))) })
            }
            _ => Err(RunError::Machine {
                what: "the custodian could not create the module's channels".into(),
                why: "its reason stands in partitions/helpers.log".into(),
            }),
        }
    }

    /// Starts the recorder. It runs as the partitions' user and is handed the file, whose folder it may not enter.
    fn start_recorder(&self, path: &Path, order: String) -> Result<Recorder, RunError> {
        let log = File::create(path).map_err(machine(format!("cannot write {}", path.display())))?;
        std::os::unix::fs::fchown(&log, self.user, self.user)
            .map_err(machine("cannot hand over the port log"))?;
        let arguments = ["recorder".into(), order];
        let start = |input: &OwnedFd, output: &OwnedFd| {
            let lines = Lines { input: Some(input), output: Some(output), file: Some(&log) };
            self.helper(&arguments, lines, true)
        };
        Recorder::start(start).map_err(machine("cannot start the recorder (see partitions/helpers.log)"))
    }

    /// How a janitor is started. Without its custodian a restarted partition would not find its channels: so whoever
    /// needs a janitor first sees that the custodian is there.
    fn janitor_starter(
        &self,
        order: String,
        custodian: Rc<RefCell<Custodian>>,
    ) -> Result<StartJanitor, RunError> {
        let copy = Self {
            instance: self.instance.clone(),
            group: None,
            own_program: self.own_program.clone(),
            log: self.log.try_clone().map_err(machine("cannot copy a descriptor"))?,
            guard: RefCell::new(None),
            user: self.user,
        };
        Ok(Box::new(move |pid| {
            if crate::partition::ended(&custodian.borrow().process).is_some() {
                // Before any clean-up, which would take away the channels that only the dead one held.
                *custodian.borrow_mut() = copy.start_custodian(&order).map_err(std::io::Error::other)?;
            }
            copy.start_janitor(pid)
        }))
    }

    fn start_janitor(&self, pid: i32) -> std::io::Result<Spawned> {
        let domain = self.instance.domain();
        self.helper(&["janitor".into(), domain.root, domain.prefix, pid.to_string()], Lines::default(), true)
    }

    fn run(
        &self,
        plan: &Arc<Plan>,
        view: &ModuleView<'_>,
        mut options: Options,
        facts: &Machine,
        programs: Vec<PathBuf>,
    ) -> Result<Outcome, RunError> {
        let order = serde_json::to_string(&self.order(view)).unwrap_or_default();
        let custodian = Rc::new(RefCell::new(self.start_custodian(&order)?));
        let recorder =
            options.record.take().map(|path| self.start_recorder(&path, order.clone())).transpose()?;
        let cages = self.cages(plan, view, &options, facts, programs)?;
        let ended = conduct(
            plan,
            view,
            options,
            facts,
            cages,
            recorder,
            self.janitor_starter(order, custodian.clone())?,
        );
        custodian.borrow_mut().leave();
        ended
    }

    fn cages(
        &self,
        plan: &Plan,
        view: &ModuleView<'_>,
        options: &Options,
        facts: &Machine,
        programs: Vec<PathBuf>,
    ) -> Result<Vec<Cage>, RunError> {
        let domain = self.instance.domain();
        let housing = Housing {
            module: options.module.clone(),
            clock: options.clock,
            ports_root: domain.root,
            ports_prefix: domain.prefix,
            namespaces: facts.namespaces,
            user: facts.user,
            real_time: facts.real_time,
            logs: options.output.join("partitions"),
        };
        let none = BTreeMap::new();
        let built = view.partitions().zip(programs).map(|(id, program)| {
            let name = &plan[id].name;
            let group = match &self.group {
                Some(group) => {
                    Some(group.child(name).map_err(machine(format!("no control group for {name}")))?)
                }
                None => None,
            };
            let overrides = options.overrides.get(name).unwrap_or(&none);
            let mut cage = Cage::build(plan, id, program, group, &housing, overrides)
                .map_err(machine(format!("cannot prepare partition {name}")))?;
            cage.translate_cores(|core| facts.real_core(core));
            Ok(cage)
        });
        built.collect()
    }

    /// Removes everything and lets the guard go.
    fn leave(mut self) {
        drop(self.group.take());
        self.instance.clean_up();
        if let Some((guard, mut line)) = self.guard.borrow_mut().take() {
            let _ = line.write_all(&[FAREWELL]); // without it the guard cleans up once more: harmless
            drop(line);
            await_end(&guard);
        }
    }
}

/// Starts the partitions, runs their windows, ends them.
fn conduct(
    plan: &Arc<Plan>,
    view: &ModuleView<'_>,
    options: Options,
    facts: &Machine,
    cages: Vec<Cage>,
    mut recorder: Option<Recorder>,
    start_janitor: StartJanitor,
) -> Result<Outcome, RunError> {
    let timeline = Timeline::of(plan, view.id(), plan.initial_schedule());
    let (records, lost) = (Records::default(), Arc::new(AtomicU64::new(0)));
    let rings: Rc<RefCell<Vec<Consumer<WindowRecord>>>> = Rc::default();
    let mut monitor = Monitor::start(Equipment {
        plan: plan.clone(),
        clock: options.clock,
        cages,
        start_janitor,
        take_record: take_record(records.clone(), rings.clone()),
        window_log: WindowLog::create(&options.output.join("windows.csv"))
            .map_err(machine("cannot write windows.csv"))?,
        health_log: HealthLog::create(&options.output.join("health.jsonl"))
            .map_err(machine("cannot write health.jsonl"))?,
        events: options.events,
    })
    .map_err(RunError::Start)?;
    if let Err(reason) = monitor.await_all_ready() {
        monitor.finish(0);
        return Err(RunError::Start(reason));
    }
    let slots = monitor.slots();
    connect(&slots, timeline.minor_frame_ns, options.clock);
    monitor.events().tell(&Event::Ready { partitions: slots.iter().flatten().count() });
    let kills = Killing::of(plan, &options.kills);
    let line_slot = line_partition(view).and_then(|place| slots[place].clone());
    let mut surroundings = Surroundings::new(
        kills,
        options.until_ns,
        options.stop.clone(),
        recorder.take(),
        options.companion,
        line_slot,
    );
    let module_ns = match options.clock {
        Clock::Virtual => run_virtual(&timeline, &mut monitor, &mut surroundings, records, facts),
        Clock::Wall => run_wall(&timeline, &mut monitor, &mut surroundings, &rings, &lost, facts)?,
    };
    let reason = surroundings.reason(monitor.stop_asked());
    monitor.finish(module_ns);
    surroundings.finish();
    let totals = monitor.totals();
    monitor.events().tell(&Event::Stopped {
        reason: reason.clone(),
        module_time_s: module_ns as f64 / 1e9,
        windows: totals.windows,
        late_windows: totals.late,
        window_overruns: totals.overruns,
        lost_records: lost.load(Ordering::Relaxed),
    });
    monitor.events().finish();
    Ok(Outcome { reason, module_ns, guarantees: facts.guarantees.list().to_vec() })
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
fn line_partition(view: &ModuleView<'_>) -> Option<usize> {
    view.partitions().find(|id| !view.plan()[*id].devices.is_empty()).map(crate::plan::PartitionId::index)
}

/// A first grant without a window: every port connects to its peers now, not in its first window.
fn connect(slots: &[Option<Arc<Slot>>], minor_frame_ns: u64, clock: Clock) {
    for slot in slots.iter().flatten() {
        slot.page.clock.store(u32::from(clock == Clock::Virtual), Ordering::Relaxed);
        slot.page.minor_frame_ns.store(minor_frame_ns, Ordering::Relaxed);
        slot.grant(0, 0, 0, now_ns());
        let begun_ns = now_ns();
        while !slot.is_done() && now_ns() - begun_ns < 100_000_000 {
            slot.await_change(1_000_000);
        }
    }
}

fn run_virtual(
    timeline: &Timeline,
    monitor: &mut Monitor,
    surroundings: &mut Surroundings,
    records: Records,
    facts: &Machine,
) -> u64 {
    // On the partitions' own core a grant is a switch, not an interrupt to another processor.
    let _ = sched::bind(0, &facts.partitioned_cores()); // slower otherwise, nothing else
    let mut gate = VirtualGate::new(monitor, surroundings, records);
    Dispatcher::new(timeline, |_| true).run(&mut VirtualPace, &mut gate, &|| false);
    surroundings.module_ns()
}

fn run_wall(
    timeline: &Timeline,
    monitor: &mut Monitor,
    surroundings: &mut Surroundings,
    rings: &Rc<RefCell<Vec<Consumer<WindowRecord>>>>,
    lost: &Arc<AtomicU64>,
    facts: &Machine,
) -> Result<u64, RunError> {
    let origin_ns = now_ns() + LEAD_NS;
    let slots = monitor.slots();
    slots.iter().flatten().for_each(|slot| slot.page.origin_ns.store(origin_ns, Ordering::Release));
    let stop = Arc::new(AtomicBool::new(false));
    let mut threads = Vec::new();
    for line in &timeline.cores {
        let (producer, consumer) = RingBuffer::new(RECORDS);
        rings.borrow_mut().push(consumer);
        let gate = WallGate::new(slots.clone(), origin_ns, producer, lost.clone());
        let dispatcher = Dispatcher::new(timeline, |core| core == line.core);
        let (core, real_time, stop) = (facts.real_core(line.core), facts.real_time, stop.clone());
        let thread = std::thread::Builder::new()
            .name(format!("dispatch {}", line.core))
            .spawn(move || dispatch(dispatcher, gate, origin_ns, core, real_time, &stop))
            .map_err(machine("cannot start a dispatcher thread"))?;
        threads.push(thread);
    }
    let minor_frame_ns = timeline.minor_frame_ns;
    let mut next_minor_ns = 0;
    loop {
        monitor.pause(MONITOR_PERIOD_NS);
        let module_ns = now_ns().saturating_sub(origin_ns);
        monitor.step(module_ns);
        if module_ns >= next_minor_ns {
            next_minor_ns = (module_ns / minor_frame_ns + 1) * minor_frame_ns;
            if !crate::fast::World::minor_frame(surroundings, module_ns, monitor)
                || monitor.stop_asked().is_some()
            {
                break;
            }
        }
    }
    stop.store(true, Ordering::Release);
    for thread in threads {
        let _ = thread.join(); // a panic there was printed; the module ends either way
    }
    Ok(now_ns().saturating_sub(origin_ns))
}

/// A dispatcher thread's life.
fn dispatch(
    mut dispatcher: Dispatcher,
    mut gate: WallGate,
    origin_ns: u64,
    core: u32,
    real_time: bool,
    stop: &AtomicBool,
) {
    use thread_priority::{
        RealtimeThreadSchedulePolicy, ThreadPriority, ThreadSchedulePolicy, set_thread_priority_and_policy,
        thread_native_id,
    };
    let _ = sched::bind(0, &[core]); // said at the start where it can not be
    if real_time && let Ok(priority) = DISPATCHER_PRIORITY.try_into() {
        let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
        let _ = set_thread_priority_and_policy(
            thread_native_id(),
            ThreadPriority::Crossplatform(priority),
            policy,
        ); // as above
    }
    dispatcher.run(&mut WallPace::new(origin_ns), &mut gate, &|| stop.load(Ordering::Acquire));
}

/// Above every partition (50 at most) and every interrupt thread (50); below the kernel's own watchdogs (99).
const DISPATCHER_PRIORITY: u8 = 98;
