//! One run of a module: from the checked plan to the last process ended.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::os::fd::OwnedFd;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

use crate::recording::part_name;
use crate::world::Companion;
use base::Base;
use bateleur_contract::Mapped;
use bateleur_host::guarantee::Guarantee;
use bateleur_host::instance::clean_leftovers;
use bateleur_host::keys::{Key, KeyError};
use bateleur_host::machine::Machine;
use bateleur_host::memory_blocks::MemoryBlockError;
use bateleur_host::programs::{program_path, script};
use bateleur_monitor::event::{Event, Events};
use bateleur_monitor::health::ring;
use bateleur_monitor::inject::Aim;
use bateleur_monitor::planned::Act;
use bateleur_monitor::run_order::{DeadExecutive, RunOrder};
use bateleur_plan::{ModuleView, Plan};
use bateleur_system::folders;
use bateleur_system::tree::NotRemoved;
use bateleur_time::run_page::RunPage;
use bateleur_time::shared_clock::SharedClockError;
use course::{Course, Ended};

mod base;
mod channel_holders;
mod course;
mod joined;
mod one_start;
mod run_module;
mod wall_threads;

/// What a run is asked to do, and what it was given for it.
pub struct Options {
    /// What it is asked to do.
    pub order: RunOrder,
    /// The keys of the module's links, in the order of the plan: read by [`run`], whatever stands here before.
    pub link_keys: Vec<Key>,
    /// Who lives at the other end of a line under the virtual clock.
    pub companion: Option<Companion>,
    /// Who watches.
    pub events: Events,
    /// Set by a signal: end at the end of the major frame.
    pub stop: Arc<AtomicBool>,
    /// Set by SIGPWR: the supply is going.
    pub power_fail: Arc<AtomicBool>,
    /// What it has of a supervisor; `None` if there is none.
    pub supervision: Option<Supervision>,
}

/// What outlives an executive that is supervised.
#[derive(Debug)]
pub struct Supervision {
    /// The run's time, and signs of life.
    pub page: Arc<Mapped<RunPage>>,
    /// Retained memories, by partition.
    pub retained: BTreeMap<String, Arc<OwnedFd>>,
    /// Memory blocks that partitions write, by name, and logbooks, by path.
    pub memory_blocks: BTreeMap<String, Arc<OwnedFd>>,
    /// The executive before; `None` if this is the first one.
    pub after: Option<DeadExecutive>,
}

impl Options {
    /// The file for every message of every port.
    #[must_use]
    pub fn port_log(&self) -> Option<PathBuf> {
        self.order.record.then(|| self.order.output.join(part_name(0)))
    }
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
    /// A fault that hits nothing.
    #[error("{0}")]
    Aim(String),
    /// A schedule that is not in the plan.
    #[error("the plan has no schedule \"{name}\"; it has {known}")]
    NoSchedule {
        /// What was asked for.
        name: String,
        /// What there is.
        known: String,
    },
    /// Programs that are not there.
    #[error("{0}")]
    Programs(String),
    /// `--require strict` and a promise that does not hold.
    #[error("refused to start, because strict was required and this machine lacks:\n{0}")]
    Strict(String),
    /// Other modules on the same virtual clock.
    #[error(transparent)]
    SharedClock(SharedClockError),
    /// A key of a link that is not in the plan.
    #[error("the plan has no link \"{name}\"; it has {known}")]
    NoLink {
        /// What was asked for.
        name: String,
        /// What there is.
        known: String,
    },
    /// An address to replace that is not in the plan.
    #[error("--address {address}=…: the plan has no such address; it has {known}")]
    NoAddress {
        /// What was to be replaced.
        address: SocketAddr,
        /// What there is.
        known: String,
    },
    /// The key of a link.
    #[error(
        "the key of link {link}: {error} (`bateleur key FILE` makes one; the host at the other end needs the same file)"
    )]
    Key {
        /// The link.
        link: String,
        /// What is wrong with its file.
        error: KeyError,
    },
    /// A memory block.
    #[error(transparent)]
    MemoryBlock(#[from] MemoryBlockError),
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
    /// An error of the module ended it.
    pub faulty: bool,
    /// A log could not be written, or not to its end.
    pub logs_lost: bool,
    /// Something that the run made could not be removed.
    pub left_behind: bool,
    /// What the machine gave.
    pub guarantees: Vec<Guarantee>,
}

impl Outcome {
    /// The exit code that says so.
    #[must_use]
    pub fn code(&self) -> u8 {
        if self.faulty || self.logs_lost || self.left_behind { crate::WRONG } else { crate::FINE }
    }
}

/// Runs a module until it is told to stop.
///
/// # Errors
/// What kept it from starting. Nothing is left behind then.
pub fn run(plan: Plan, mut options: Options) -> Result<Outcome, RunError> {
    let plan = Arc::new(joined::prepare(plan, &mut options)?);
    let view = module_of(&plan, &options.order.module)?;
    check_names(&view, &options)?;
    check_schedules(&plan, &options)?;
    take_descriptors()?;
    for left in clean_leftovers().1 {
        options.events.tell(&not_removed(&options.order.module, 0.0, &left));
    }
    let facts = Machine::examine(&view, options.order.clock(), options.order.processor);
    let lacking: Vec<String> =
        facts.guarantees.lacking().map(|lack| format!("  {}: {}", lack.promise, lack.detail)).collect();
    if options.order.strict && !lacking.is_empty() {
        return Err(RunError::Strict(lacking.join("\n")));
    }
    options.events.tell(&Event::Guarantees { list: facts.guarantees.list().to_vec() });
    // Before anything of the last run is written over.
    find_programs(&view, &options.order.plan_folder)?;
    let logs = options.order.output.join("partitions");
    folders::make(&logs).map_err(machine(format!("cannot make {}", logs.display())))?;
    for folder in [&options.order.output, &logs] {
        let what = format!("cannot take the files of another user's run out of {}", folder.display());
        folders::free(folder, &[ring::FILE]).map_err(machine(what))?;
    }
    let mut course = Course::new(&plan, &view, &mut options)?;
    loop {
        match start(&plan, &view, &options, &facts, &mut course) {
            Ok(ended) => {
                course.note(&ended);
                if !ended.reset {
                    let guarantees = facts.guarantees.list().to_vec();
                    return Ok(course.finish(ended, guarantees));
                }
            }
            Err(error) => {
                if !course.tries_again(&plan, &error) {
                    course.give_up();
                    return Err(error);
                }
            }
        }
    }
}

/// One start of the module, from nothing to nothing.
fn start(
    plan: &Arc<Plan>,
    view: &ModuleView<'_>,
    options: &Options,
    facts: &Machine,
    course: &mut Course,
) -> Result<Ended, RunError> {
    let programs = find_programs(view, &options.order.plan_folder)?;
    let logs = options.order.output.join("partitions");
    let about = (options.order.module.as_str(), options.order.clock(), options.supervision.is_some());
    let base = Base::make(about, facts, &logs, course.resets() > 0)?;
    let mut result = base.run(plan, view, options, facts, programs, course);
    if let Err(left) = base.leave() {
        let time_s = course.reached_ns() as f64 / 1e9;
        course.tell(&not_removed(&options.order.module, time_s, &left));
        result = result.map(|ended| Ended { left_behind: true, ..ended });
    }
    result
}

/// What is told of something that should not be there any more.
fn not_removed(module: &str, time_s: f64, left: &NotRemoved) -> Event {
    let text = format!("left behind: {left}; the next start tries again");
    Event::Message { time_s, partition: module.to_owned(), text }
}

pub(crate) fn module_of<'a>(plan: &'a Plan, name: &str) -> Result<ModuleView<'a>, RunError> {
    plan.module(name).ok_or_else(|| RunError::NoModule {
        name: name.into(),
        known: plan.modules.iter().map(|module| module.name.as_str()).collect::<Vec<_>>().join(", "),
    })
}

fn check_names(view: &ModuleView<'_>, options: &Options) -> Result<(), RunError> {
    let names: Vec<&str> = view.partitions().map(|id| view.plan()[id].name.as_str()).collect();
    let acts = options.order.acts.iter().filter(|one| !matches!(one.act, Act::Inject(_)));
    let unknown = |name: &&String| !names.contains(&name.as_str());
    // A partition of another module may have replicas here.
    let takes = |name: &str| view.partitions().any(|id| view.plan().takes_settings_of(id, name));
    let mut asked = acts
        .map(|one| &one.partition)
        .filter(unknown)
        .chain(options.order.overrides.keys().filter(|name| !takes(name)));
    if let Some(name) = asked.next() {
        return Err(RunError::NoPartition {
            name: name.clone(),
            module: options.order.module.clone(),
            known: names.join(", "),
        });
    }
    let alone = options.order.together.is_none();
    options.order.acts.iter().try_for_each(|one| match one.aim(view.plan()).map_err(RunError::Aim)? {
        Aim::Executive if !alone => Err(RunError::Aim(
            "the executive can not be aimed at where modules share a virtual clock: use --kill-host".into(),
        )),
        _ => Ok(()),
    })
}

/// Fewer descriptors than the smallest module and the examination of the machine need.
const LEAST_DESCRIPTORS: u64 = 256;

/// Takes as many descriptors as this process may have: a lack of them looks like a lack of whatever is tried then.
fn take_descriptors() -> Result<(), RunError> {
    use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
    let Rlimit { maximum, .. } = getrlimit(Resource::Nofile);
    let _ = setrlimit(Resource::Nofile, Rlimit { current: maximum, maximum }); // it never rises above the hard limit
    match maximum {
        Some(most @ ..LEAST_DESCRIPTORS) => Err(RunError::Machine {
            what: format!("this process may open {most} files"),
            why: format!("a module needs {LEAST_DESCRIPTORS} at least: ulimit -n, LimitNOFILE= in a unit"),
        }),
        _ => Ok(()),
    }
}

fn check_schedules(plan: &Plan, options: &Options) -> Result<(), RunError> {
    match options.order.schedule_changes.iter().find(|(name, _)| plan.schedule(name).is_none()) {
        None => Ok(()),
        Some((name, _)) => Err(RunError::NoSchedule {
            name: name.clone(),
            known: plan
                .schedules
                .iter()
                .map(|schedule| schedule.name.as_str())
                .collect::<Vec<_>>()
                .join(", "),
        }),
    }
}

/// Every partition's program, or all those that are missing.
fn find_programs(view: &ModuleView<'_>, folder: &Path) -> Result<Vec<PathBuf>, RunError> {
    let mut missing = Vec::new();
    let programs = view.partitions().map(|id| {
        let partition = &view.plan()[id];
        let path = program_path(&partition.program, folder);
        let fault = match path.is_file() {
            true => script(&path),
            false => Some(format!("there is no program {}", path.display())),
        };
        missing.extend(fault.map(|fault| {
            let (name, program) = (&partition.name, &partition.program);
            format!("partition {name}: {fault} (program = \"{program}\"): build it, or correct its line in the plan")
        }));
        path
    });
    let programs = programs.collect();
    if missing.is_empty() { Ok(programs) } else { Err(RunError::Programs(missing.join("\n"))) }
}
