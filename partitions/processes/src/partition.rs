//! The state of a partition, and what a driver asks it.

use crate::health::{ErrorList, Handler, Notice, Notices};
use crate::objects::Objects;
use crate::ports::{QueuingPort, SamplingPort};
use crate::process::{Phase, Process};
use crate::queues::{ListId, Queues};
use crate::return_code::ReturnCode;
use crate::services::blackboards::Blackboard;
use crate::services::buffers::Buffer;
use crate::services::events::Event;
use crate::services::logbooks::Logbook;
use crate::services::mutexes::Mutex;
use crate::services::name_services::NameService;
use crate::services::port_lists::PortList;
use crate::services::semaphores::Semaphore;
use crate::settings::Settings;
use crate::standard::{
    CORE_AFFINITY_ANY, MAX_PRIORITY, OperatingMode, ProcessId, StartCondition, SystemTime,
};
use crate::timers::Timers;

/// Who runs in a partition.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Runner {
    /// The main process, until the partition enters NORMAL.
    Main,
    /// The error handler.
    Handler,
    /// A process.
    Process(ProcessId),
}

/// Why a partition runs no longer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    /// It is idle until somebody outside of it starts it.
    Idle,
    /// It starts again, in this mode and for this reason.
    Restart {
        /// COLD_START or WARM_START.
        mode: OperatingMode,
        /// What its status says afterwards.
        condition: StartCondition,
    },
}

/// What a driver has to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Dispatch {
    /// Let this one run.
    Run {
        /// Whom.
        who: Runner,
        /// How often it was started. If the driver has not seen the number, it runs from its entry point.
        life: u32,
    },
    /// Nobody is ready: close the window, or wait for the next timer.
    Nobody,
    /// Nobody runs any more.
    Ended(End),
}

/// What decides who runs in NORMAL, and when time changes that: after a service that has left it as it was, its caller runs on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Standing {
    changes: u64,
    lock: Option<usize>,
    handler: Option<(u32, bool, bool)>,
    ended: bool,
    timer: Option<SystemTime>,
}

/// What became of a service that may have to wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[must_use]
pub enum Progress<T = ()> {
    /// It is done.
    Done(T),
    /// Its caller waits. When it runs again, [`Partition::result`] says with what.
    Waits,
}

/// The preemption lock.
#[derive(Debug)]
pub(crate) struct Lock {
    /// Its owner, by its place.
    pub(crate) owner: Option<usize>,
    pub(crate) level: i32,
    /// Who waits behind an owner that has faulted.
    pub(crate) waiting: ListId,
}

/// One partition: its mode, its processes and its objects.
#[derive(Debug)]
pub struct Partition {
    pub(crate) settings: Settings,
    pub(crate) now: SystemTime,
    pub(crate) mode: OperatingMode,
    pub(crate) end: Option<End>,
    /// The main process has ended.
    pub(crate) main_ended: bool,
    /// The mutex that the main process owns, by its place.
    pub(crate) main_mutex: Option<usize>,
    pub(crate) processes: Vec<Process>,
    /// The lists with the numbers of the priorities hold the ready processes, who runs first among them.
    pub(crate) queues: Queues,
    /// A bit for each priority that has a ready process.
    pub(crate) ready: [u64; 4],
    /// Started processes that wait for NORMAL, in order of their start.
    pub(crate) started: ListId,
    pub(crate) timers: Timers,
    /// Processes that are passed over, the one that sleeps the longest first.
    pub(crate) lent: Vec<usize>,
    pub(crate) lock: Lock,
    /// The core of processes that have none of their own.
    pub(crate) default_affinity: i32,
    pub(crate) stack_memory: u64,
    pub(crate) object_memory: u64,
    pub(crate) handler: Option<Handler>,
    pub(crate) errors: ErrorList,
    pub(crate) notices: Notices,
    pub(crate) buffers: Objects<Buffer>,
    pub(crate) blackboards: Objects<Blackboard>,
    pub(crate) semaphores: Objects<Semaphore>,
    pub(crate) events: Objects<Event>,
    pub(crate) mutexes: Objects<Mutex>,
    pub(crate) sampling_ports: Objects<SamplingPort>,
    pub(crate) queuing_ports: Objects<QueuingPort>,
    pub(crate) port_lists: Objects<PortList>,
    pub(crate) logbooks: Objects<Logbook>,
    pub(crate) name_services: Objects<NameService>,
}

impl Partition {
    /// A partition in the mode that its settings name, whose main process is about to run.
    #[must_use]
    pub fn new(settings: Settings) -> Self {
        let limits = settings.limits.clone();
        let lists = MAX_PRIORITY as usize + 3 + 7 * limits.objects + limits.ports;
        let mut queues = Queues::new(lists, limits.processes);
        (0..=MAX_PRIORITY).for_each(|_| {
            queues.add_list();
        });
        let (started, waiting) = (queues.add_list(), queues.add_list());
        Self {
            now: 0,
            mode: settings.mode,
            end: (settings.mode == OperatingMode::Idle).then_some(End::Idle),
            main_ended: false,
            main_mutex: None,
            processes: Vec::with_capacity(limits.processes),
            queues,
            ready: [0; 4],
            started,
            timers: Timers::new(2 * limits.processes),
            lent: Vec::with_capacity(limits.processes),
            lock: Lock { owner: None, level: 0, waiting },
            default_affinity: CORE_AFFINITY_ANY,
            stack_memory: 0,
            object_memory: 0,
            handler: None,
            errors: ErrorList::new(limits.errors),
            notices: Notices::new(limits.notices),
            buffers: Objects::new(limits.objects),
            blackboards: Objects::new(limits.objects),
            semaphores: Objects::new(limits.objects),
            events: Objects::new(limits.objects),
            mutexes: Objects::new(limits.objects),
            sampling_ports: Objects::new(limits.ports),
            queuing_ports: Objects::new(limits.ports),
            port_lists: Objects::new(limits.objects),
            logbooks: Objects::new(limits.objects),
            name_services: Objects::new(limits.objects),
            settings,
        }
    }

    /// The partition as it begins after [`End::Restart`]: without processes, objects and ports. Time goes on.
    #[must_use]
    pub fn restarted(self) -> Self {
        let mut settings = self.settings;
        if let Some(End::Restart { mode, condition }) = self.end {
            (settings.mode, settings.condition) = (mode, condition);
        }
        Self { now: self.now, ..Self::new(settings) }
    }

    /// Says that it is `now`, module time, ns: release points, time-outs and deadlines up to then take effect, in their order.
    /// Time never goes back.
    pub fn advance(&mut self, now: SystemTime) {
        self.now = self.now.max(now);
        self.settle();
    }

    /// When time alone changes something next, module time, ns.
    #[inline]
    #[must_use]
    pub fn next_timer(&self) -> Option<SystemTime> {
        self.timers.first().map(|(at, _)| at)
    }

    /// Who runs. The services that follow are called by that one.
    #[inline]
    #[must_use]
    pub fn dispatch(&self) -> Dispatch {
        if let Some(end) = self.end {
            return Dispatch::Ended(end);
        }
        match self.running() {
            None => Dispatch::Nobody,
            Some(who) => Dispatch::Run { who, life: self.life(who) },
        }
    }

    /// What decides who runs, and when time changes that.
    #[inline]
    #[must_use]
    pub fn standing(&self) -> Standing {
        Standing {
            changes: self.queues.changes(),
            lock: self.lock.owner,
            handler: self.handler.as_ref().map(|handler| (handler.life, handler.active, handler.lent)),
            ended: self.end.is_some(),
            timer: self.next_timer(),
        }
    }

    /// How often somebody was started so far; 0 for who does not exist.
    #[must_use]
    pub fn starts_of(&self, who: Runner) -> u32 {
        self.life(who)
    }

    #[inline]
    fn life(&self, who: Runner) -> u32 {
        match who {
            Runner::Main => 1,
            Runner::Handler => self.handler.as_ref().map_or(0, |handler| handler.life),
            Runner::Process(id) => {
                id.index().and_then(|place| self.processes.get(place)).map_or(0, |process| process.life)
            }
        }
    }

    /// With what the last call in which the running process waited has ended.
    ///
    /// # Errors
    /// As the service says that the process called.
    pub fn result(&self) -> Result<(), ReturnCode> {
        self.caller().map_or(Ok(()), |place| self.processes[place].result)
    }

    /// As above, of any process.
    ///
    /// # Errors
    /// As above; INVALID_PARAM: there is no such process.
    pub fn result_of(&self, id: ProcessId) -> Result<(), ReturnCode> {
        self.processes[self.place(id)?].result
    }

    /// The message that the running process was given while it waited.
    #[must_use]
    pub fn message(&self) -> &[u8] {
        self.caller().map_or(&[], |place| &self.processes[place].message)
    }

    /// As above, of any process.
    #[must_use]
    pub fn message_of(&self, id: ProcessId) -> &[u8] {
        self.place(id).map_or(&[], |place| &self.processes[place].message)
    }

    /// The oldest notice for the driver.
    pub fn take_notice(&mut self) -> Option<Notice> {
        self.notices.take()
    }

    /// Notices that found no place, so far.
    #[must_use]
    pub fn lost_notices(&self) -> u32 {
        self.notices.lost
    }

    /// The module has changed to a schedule in which the periods of this partition begin otherwise. Release points that are
    /// set stay.
    pub fn change_grid(&mut self, grid: crate::PeriodGrid, duration: SystemTime) {
        self.settings.grid = grid;
        self.settings.duration = duration;
    }

    /// The identifiers of all processes, in order of their creation.
    pub fn processes(&self) -> impl Iterator<Item = ProcessId> + use<> {
        (0..self.processes.len()).map(ProcessId::of)
    }

    /// Whom the processor belongs to.
    #[inline]
    pub(crate) fn running(&self) -> Option<Runner> {
        if self.end.is_some() {
            return None;
        }
        if self.handler.as_ref().is_some_and(|handler| handler.active && !handler.lent) {
            return Some(Runner::Handler);
        }
        if self.mode != OperatingMode::Normal {
            return (!self.main_ended).then_some(Runner::Main);
        }
        let locked = self.lock.owner.filter(|owner| self.processes[*owner].is_able());
        locked.or_else(|| self.most_urgent()).map(|place| Runner::Process(ProcessId::of(place)))
    }

    /// The running process by its place; `None` for the main process, the handler, and when nobody runs.
    pub(crate) fn caller(&self) -> Option<usize> {
        match self.running()? {
            Runner::Process(id) => id.index(),
            Runner::Main | Runner::Handler => None,
        }
    }

    /// The place of a process.
    pub(crate) fn place(&self, id: ProcessId) -> Result<usize, ReturnCode> {
        let place = id.index().filter(|place| *place < self.processes.len());
        place.ok_or(ReturnCode::InvalidParam)
    }

    /// As above, of one that is not the caller.
    pub(crate) fn other(&self, id: ProcessId) -> Result<usize, ReturnCode> {
        let place = self.place(id)?;
        if self.caller() == Some(place) { Err(ReturnCode::InvalidParam) } else { Ok(place) }
    }

    pub(crate) fn is_dormant(&self, place: usize) -> bool {
        self.processes[place].phase == Phase::Dormant
    }
}

impl Settings {
    /// A partition with a core of its own and a period, ns, in which it starts cold.
    #[must_use]
    pub fn every(period: SystemTime) -> Self {
        Self {
            identifier: 0,
            grid: crate::PeriodGrid { origin: 0, period },
            duration: period,
            cores: 1,
            affinity: crate::AffinityPermission::AllModes,
            memory_blocks: Vec::new(),
            logbooks: Vec::new(),
            name_services: Vec::new(),
            mode: OperatingMode::ColdStart,
            condition: StartCondition::NormalStart,
            health: crate::HealthTable::default(),
            limits: crate::Limits::default(),
        }
    }
}
