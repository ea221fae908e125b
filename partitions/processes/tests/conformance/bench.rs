//! A partition under test: who runs calls services, and time is said.

use std::collections::VecDeque;
use std::ops::{Deref, DerefMut};

use bateleur_processes::ports::{Ports, QueuingConfiguration, Received, SamplingConfiguration, Written};
use bateleur_processes::standard::*;
use bateleur_processes::{Dispatch, End, Partition, Progress, ReturnCode, Runner, Settings};

/// A return code: `Ok` is NO_ERROR.
pub(crate) type Code = Result<(), ReturnCode>;

pub(crate) const NE: Code = Ok(());
pub(crate) const NA: Code = Err(ReturnCode::NoAction);
pub(crate) const NV: Code = Err(ReturnCode::NotAvailable);
pub(crate) const IP: Code = Err(ReturnCode::InvalidParam);
pub(crate) const IC: Code = Err(ReturnCode::InvalidConfig);
pub(crate) const IM: Code = Err(ReturnCode::InvalidMode);
pub(crate) const TM: Code = Err(ReturnCode::TimedOut);

pub(crate) const FOREVER: SystemTime = INFINITE_TIME_VALUE;
pub(crate) const FIFO: u32 = QueuingDiscipline::Fifo as u32;
pub(crate) const BY_PRIORITY: u32 = QueuingDiscipline::Priority as u32;
pub(crate) const STACK: u32 = 64 << 10;
/// No discipline, mode, direction or code has this number.
pub(crate) const NONSENSE: u32 = 77;

pub(crate) fn ms(span: i64) -> SystemTime {
    span * 1_000_000
}

pub(crate) fn code<T>(result: Result<T, ReturnCode>) -> Code {
    result.map(drop)
}

/// The service has waited for nothing.
#[track_caller]
pub(crate) fn done<T>(result: Result<Progress<T>, ReturnCode>) -> T {
    match result {
        Ok(Progress::Done(value)) => value,
        Ok(Progress::Waits) => panic!("the service waits"),
        Err(code) => panic!("the service returned {code:?}"),
    }
}

#[track_caller]
pub(crate) fn waits<T>(result: Result<Progress<T>, ReturnCode>) {
    match result {
        Ok(Progress::Waits) => {}
        Ok(Progress::Done(_)) => panic!("the service does not wait"),
        Err(code) => panic!("the service returned {code:?}"),
    }
}

#[track_caller]
pub(crate) fn one_of(found: Code, accepted: &[Code]) {
    assert!(accepted.contains(&found), "{found:?} is none of {accepted:?}");
}

pub(crate) struct Bench {
    pub(crate) partition: Partition,
    pub(crate) channels: Channels,
}

impl Deref for Bench {
    type Target = Partition;

    fn deref(&self) -> &Partition {
        &self.partition
    }
}

impl DerefMut for Bench {
    fn deref_mut(&mut self) -> &mut Partition {
        &mut self.partition
    }
}

impl Bench {
    /// A period of 100 ms, cold start at 0.
    pub(crate) fn new() -> Self {
        Self::with(|_| {})
    }

    pub(crate) fn with(change: impl FnOnce(&mut Settings)) -> Self {
        let mut settings = Settings::every(ms(100));
        change(&mut settings);
        Self { partition: Partition::new(settings), channels: Channels::default() }
    }

    /// In NORMAL, with one process of priority 10 that runs.
    pub(crate) fn running() -> (Self, ProcessId) {
        let mut bench = Self::new();
        let a = bench.started("a", 10);
        bench.normal();
        (bench, a)
    }

    /// In NORMAL, with a process of priority 10 that runs, and a dormant one of priority 20.
    pub(crate) fn pair() -> (Self, ProcessId, ProcessId) {
        let mut bench = Self::new();
        let a = bench.started("a", 10);
        let b = bench.created("b", 20);
        bench.normal();
        (bench, a, b)
    }

    /// In NORMAL: the error handler runs, about an error that process `a` (priority 10) has raised.
    pub(crate) fn in_handler() -> (Self, ProcessId) {
        let mut bench = Self::new();
        let a = bench.started("a", 10);
        bench.create_error_handler(STACK).unwrap();
        bench.normal();
        bench.raise("x");
        assert_eq!(bench.who(), Some(Runner::Handler));
        (bench, a)
    }

    /// In NORMAL: the caller owns a mutex of priority 200.
    pub(crate) fn owner() -> (Self, ProcessId, MutexId) {
        let mut bench = Self::new();
        let a = bench.started("a", 10);
        let mutex = bench.create_mutex("m", 200, FIFO).unwrap();
        bench.normal();
        done(bench.acquire_mutex(mutex, 0));
        (bench, a, mutex)
    }

    /// A process of 100 ms with this capacity, started, and `a` (10) beside it, in NORMAL, with an error handler.
    pub(crate) fn periodic(capacity: i64) -> (Self, ProcessId, ProcessId) {
        let mut bench = Self::new();
        bench.create_error_handler(STACK).unwrap();
        let p = bench.timed("p", 20, 100, capacity);
        bench.start(p).unwrap();
        let a = bench.started("a", 10);
        bench.normal();
        (bench, p, a)
    }

    /// Process `b` (20) waits for a semaphore of value 0, and `a` (10) runs.
    pub(crate) fn waiting(time_out: SystemTime) -> (Self, SemaphoreId, ProcessId, ProcessId) {
        let mut bench = Self::new();
        let semaphore = bench.create_semaphore("s", 0, 5, FIFO).unwrap();
        let (b, a) = (bench.started("b", 20), bench.started("a", 10));
        bench.normal();
        waits(bench.wait_semaphore(semaphore, time_out));
        bench.runs(a);
        (bench, semaphore, b, a)
    }

    pub(crate) fn attributes(name: &str, priority: i32) -> ProcessAttributes {
        ProcessAttributes {
            name: Name::new(name).unwrap(),
            entry_point: 0x1000,
            stack_size: STACK,
            base_priority: priority,
            period: FOREVER,
            time_capacity: FOREVER,
            deadline: Deadline::Soft,
        }
    }

    /// An aperiodic process without a deadline.
    pub(crate) fn created(&mut self, name: &str, priority: i32) -> ProcessId {
        self.create_process(&Self::attributes(name, priority)).unwrap()
    }

    pub(crate) fn started(&mut self, name: &str, priority: i32) -> ProcessId {
        let id = self.created(name, priority);
        self.start(id).unwrap();
        id
    }

    /// Spans in ms; negative: none.
    pub(crate) fn timed(&mut self, name: &str, priority: i32, period: i64, capacity: i64) -> ProcessId {
        let span = |span: i64| if span < 0 { FOREVER } else { ms(span) };
        let mut attributes = Self::attributes(name, priority);
        (attributes.period, attributes.time_capacity) = (span(period), span(capacity));
        self.create_process(&attributes).unwrap()
    }

    pub(crate) fn normal(&mut self) {
        self.set_partition_mode(OperatingMode::Normal).unwrap();
    }

    pub(crate) fn at(&mut self, instant: i64) {
        self.advance(ms(instant));
    }

    pub(crate) fn who(&self) -> Option<Runner> {
        match self.dispatch() {
            Dispatch::Run { who, .. } => Some(who),
            Dispatch::Nobody | Dispatch::Ended(_) => None,
        }
    }

    pub(crate) fn end(&self) -> Option<End> {
        match self.dispatch() {
            Dispatch::Ended(end) => Some(end),
            Dispatch::Run { .. } | Dispatch::Nobody => None,
        }
    }

    #[track_caller]
    pub(crate) fn runs(&self, id: ProcessId) {
        assert_eq!(self.who(), Some(Runner::Process(id)));
    }

    #[track_caller]
    pub(crate) fn handler_runs(&self) {
        assert_eq!(self.who(), Some(Runner::Handler));
    }

    #[track_caller]
    pub(crate) fn nobody_runs(&self) {
        assert_eq!(self.who(), None);
    }

    pub(crate) fn state(&self, id: ProcessId) -> ProcessState {
        self.get_process_status(id).unwrap().state
    }

    pub(crate) fn priority(&self, id: ProcessId) -> i32 {
        self.get_process_status(id).unwrap().current_priority
    }

    /// In ms.
    pub(crate) fn deadline(&self, id: ProcessId) -> Option<i64> {
        let deadline = self.get_process_status(id).unwrap().deadline_time;
        (deadline != FOREVER).then_some(deadline / ms(1))
    }

    pub(crate) fn raise(&mut self, text: &str) {
        self.raise_application_error(ErrorCode::ApplicationError, text.as_bytes()).unwrap();
    }

    /// The caller waits for ever for an event that nobody sets.
    pub(crate) fn wait_for(&mut self, event: EventId) {
        waits(self.wait_event(event, FOREVER));
    }

    /// The processes that run one after the other, each until it stops itself.
    pub(crate) fn order(&mut self) -> Vec<ProcessId> {
        let mut order = Vec::new();
        while let Some(Runner::Process(id)) = self.who() {
            order.push(id);
            self.stop_self();
        }
        order
    }
}

/// A message and its time, once there is one.
pub(crate) type Message = Option<(Vec<u8>, SystemTime)>;

#[derive(Default)]
pub(crate) struct Channels {
    pub(crate) sampling: Vec<(Name, SamplingConfiguration, Message)>,
    pub(crate) queuing: Vec<Queue>,
}

pub(crate) struct Queue {
    name: Name,
    configured: QueuingConfiguration,
    pub(crate) messages: VecDeque<Vec<u8>>,
    pub(crate) overflow: bool,
}

impl Channels {
    pub(crate) fn add_sampling(&mut self, name: &str, direction: PortDirection) {
        let key = self.sampling.len();
        let configured = SamplingConfiguration { key, max_size: 8, direction, refresh: ms(145) };
        self.sampling.push((Name::new(name).unwrap(), configured, None));
    }

    /// Two messages of eight bytes.
    pub(crate) fn add_queuing(&mut self, name: &str, direction: PortDirection) {
        let key = self.queuing.len();
        let configured = QueuingConfiguration { key, max_size: 8, max_messages: 2, direction };
        let name = Name::new(name).unwrap();
        self.queuing.push(Queue { name, configured, messages: VecDeque::new(), overflow: false });
    }
}

impl Ports for Channels {
    fn sampling(&self, name: &Name) -> Option<SamplingConfiguration> {
        self.sampling.iter().find(|(known, ..)| known == name).map(|(_, configured, _)| *configured)
    }

    fn queuing(&self, name: &Name) -> Option<QueuingConfiguration> {
        self.queuing.iter().find(|queue| queue.name == *name).map(|queue| queue.configured)
    }

    fn write(&mut self, port: usize, message: &[u8], now: SystemTime) {
        self.sampling[port].2 = Some((message.to_vec(), now));
    }

    fn read(&mut self, port: usize, into: &mut Vec<u8>) -> Option<Written> {
        let (message, at) = self.sampling[port].2.as_ref()?;
        into.extend_from_slice(message);
        // Its text is its number.
        Some(Written { at: *at, sequence: message.iter().map(|byte| u64::from(*byte)).sum() })
    }

    fn send(&mut self, port: usize, message: &[u8]) -> bool {
        let queue = &mut self.queuing[port];
        let room = queue.messages.len() < 2;
        if room {
            queue.messages.push_back(message.to_vec());
        }
        room
    }

    fn receive(&mut self, port: usize, into: &mut Vec<u8>) -> Option<Received> {
        let queue = &mut self.queuing[port];
        into.extend_from_slice(&queue.messages.pop_front()?);
        Some(Received { overflow: std::mem::take(&mut queue.overflow) })
    }

    fn next_length(&self, port: usize) -> Option<usize> {
        self.queuing[port].messages.front().map(Vec::len)
    }

    fn clear(&mut self, port: usize) {
        self.queuing[port].messages.clear();
        self.queuing[port].overflow = false;
    }

    fn count(&self, port: usize) -> i32 {
        self.queuing[port].messages.len() as i32
    }
}
