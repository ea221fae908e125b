//! What the main process of a partition does before NORMAL.

use std::ops::{Deref, DerefMut};
use std::sync::{Arc, MutexGuard};

use bateleur_processes::standard::{
    Deadline, ErrorHandlerConcurrency, INFINITE_TIME_VALUE, Name, ProcessAttributes, ProcessId,
    QueuingPortId, SamplingPortId, SystemTime,
};
use bateleur_processes::{Partition, ReturnCode};

use super::kernel::{FIRST_PROCESS, HANDLER, Kernel, State};
use super::ports::PlanPorts;
use super::process::{Body, Port, Process};
use super::thread;
use crate::context::{Context, StartError};

/// When a process runs, and how urgently.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Every {
    period: SystemTime,
    capacity: SystemTime,
    delay: SystemTime,
    priority: i32,
    stack: u32,
}

/// Bytes of a process's stack where nothing else is said: what Rust's formatting needs, several times.
const STACK: u32 = 256 << 10;

impl Every {
    /// Every so many ms, a multiple of the partition's period. Priority 1, no deadline.
    #[must_use]
    pub fn ms(period: u32) -> Self {
        Self { period: SystemTime::from(period) * 1_000_000, ..Self::once() }
    }

    /// From the start of the partition on, without a period.
    #[must_use]
    pub fn once() -> Self {
        Self {
            period: INFINITE_TIME_VALUE,
            capacity: INFINITE_TIME_VALUE,
            delay: 0,
            priority: 1,
            stack: STACK,
        }
    }

    /// 1 to 239, the highest is the most urgent.
    #[must_use]
    pub fn priority(self, priority: i32) -> Self {
        Self { priority, ..self }
    }

    /// Time from a release to its deadline, ms.
    #[must_use]
    pub fn deadline_ms(self, capacity: u32) -> Self {
        Self { capacity: SystemTime::from(capacity) * 1_000_000, ..self }
    }

    /// Begins so much later, ms (DELAYED_START).
    #[must_use]
    pub fn delayed_ms(self, delay: u32) -> Self {
        Self { delay: SystemTime::from(delay) * 1_000_000, ..self }
    }

    /// Bytes of its stack.
    #[must_use]
    pub fn stack(self, bytes: u32) -> Self {
        Self { stack: bytes, ..self }
    }
}

impl From<ReturnCode> for StartError {
    fn from(code: ReturnCode) -> Self {
        Self::Other(format!("a service refuses while the partition starts: {code}"))
    }
}

/// A partition of several processes before NORMAL. The processes run when this has been left, from the first window on.
pub struct Initialisation<'p> {
    pub(crate) context: &'p mut Context,
    pub(crate) kernel: &'p Arc<Kernel>,
}

impl Initialisation<'_> {
    /// Ports, attributes, retained memory.
    pub fn context(&mut self) -> &mut Context {
        self.context
    }

    /// Lets processes share a port.
    pub fn port<T>(&self, port: T) -> Port<T> {
        Port::new(port)
    }

    /// The services, as the main process calls them: to create buffers, semaphores and so on.
    #[must_use]
    pub fn services(&mut self) -> Services<'_> {
        Services { state: self.kernel.lock(), _after: HandlerFirst(self.kernel) }
    }

    /// CREATE_SAMPLING_PORT: a port of the plan, reached by the standard's services. See [`Process::read_sampling_message`].
    ///
    /// # Errors
    /// As [`Partition::create_sampling_port`]. INVALID_CONFIG too: the channel can not be opened; standard error says why.
    pub fn create_sampling_port(
        &mut self,
        name: &str,
        max_message_size: i32,
        direction: impl Into<u32>,
        refresh_period: SystemTime,
    ) -> Result<SamplingPortId, ReturnCode> {
        self.open_port(name, |partition, ports| {
            partition.create_sampling_port(ports, name, max_message_size, direction, refresh_period)
        })
    }

    /// CREATE_QUEUING_PORT: as above. See [`Process::receive_queuing_message`].
    ///
    /// # Errors
    /// As [`Partition::create_queuing_port`], and as above.
    pub fn create_queuing_port(
        &mut self,
        name: &str,
        max_message_size: i32,
        max_nb_message: i32,
        direction: impl Into<u32>,
        discipline: impl Into<u32>,
    ) -> Result<QueuingPortId, ReturnCode> {
        self.open_port(name, |partition, ports| {
            partition.create_queuing_port(
                ports,
                name,
                max_message_size,
                max_nb_message,
                direction,
                discipline,
            )
        })
    }

    fn open_port<I>(
        &mut self,
        name: &str,
        create: impl FnOnce(&mut Partition, &PlanPorts) -> Result<I, ReturnCode>,
    ) -> Result<I, ReturnCode> {
        let mut state = self.kernel.lock();
        let State { partition, ports, .. } = &mut *state;
        ports.declare(self.context);
        let id = create(partition, ports)?;
        ports.open(self.context, name).map(|()| id).map_err(|error| {
            eprintln!("port \"{name}\": {error}");
            ReturnCode::InvalidConfig
        })
    }

    /// Calls a service that takes the plan's ports, as the main process calls it.
    ///
    /// # Errors
    /// As the service.
    pub fn at_ports<R>(
        &mut self,
        service: impl FnOnce(&mut Partition, &mut PlanPorts) -> Result<R, ReturnCode>,
    ) -> Result<R, ReturnCode> {
        let State { partition, ports, .. } = &mut *self.kernel.lock();
        service(partition, ports)
    }

    /// Creates a process, with its thread, and starts it: CREATE_PROCESS and DELAYED_START. `body` is its entry point; an aperiodic
    /// process ends with it, a periodic one loops and calls [`Process::periodic_wait`]. An error that it returns is raised as an
    /// application error.
    ///
    /// # Errors
    /// A service refuses, for instance because the plan's `processes` or `stacks` allow no more; or the machine gives no thread.
    pub fn process(
        &mut self,
        name: &str,
        every: Every,
        body: impl Fn(&Process) -> Result<(), ReturnCode> + Send + Sync + 'static,
    ) -> Result<ProcessId, StartError> {
        let refused = |what: &str| StartError::Other(format!("process \"{name}\": {what}"));
        let attributes = ProcessAttributes {
            name: Name::new(name).ok_or_else(|| refused("its name has more than 32 bytes"))?,
            entry_point: 0,
            stack_size: every.stack,
            base_priority: every.priority,
            period: every.period,
            time_capacity: every.capacity,
            deadline: Deadline::Hard,
        };
        let (name, stack) = (name.to_owned(), every.stack as usize);
        let body = Body { name, stack, run: Arc::new(body) };
        let id = self.kernel.add_process(&attributes, body);
        let id = id.map_err(|refusal| refused(&refusal.to_string()))?;
        let started = self.kernel.lock().partition.delayed_start(id, every.delay);
        started.map_err(|code| refused(&code.to_string()))?;
        Ok(id)
    }

    /// Creates the error handler, with its thread: CREATE_ERROR_HANDLER. It runs at once when an error comes, above all processes,
    /// and reads errors with GET_ERROR_STATUS.
    ///
    /// # Errors
    /// As [`Initialisation::process`].
    pub fn error_handler(
        &mut self,
        body: impl Fn(&Process) -> Result<(), ReturnCode> + Send + Sync + 'static,
    ) -> Result<(), StartError> {
        let (name, stack) = ("error handler".to_owned(), STACK as usize);
        let body = Body { name, stack, run: Arc::new(body) };
        let added = self.kernel.add_error_handler(STACK, body);
        added.map_err(|refusal| StartError::Other(format!("error handler: {refusal}")))
    }
}

/// Why a process was not created.
#[derive(Debug, thiserror::Error)]
pub(crate) enum Refusal {
    #[error(transparent)]
    Service(#[from] ReturnCode),
    #[error("{0}: {1}")]
    Limit(ReturnCode, String),
    #[error(
        "no thread for it: {0}; let `threads` of the plan count one for each process, one for the error handler and one more"
    )]
    NoThread(std::io::Error),
}

impl Refusal {
    /// Its return code, and on standard error why, for a caller who sees nothing but the code.
    pub(crate) fn tell(&self, what: &str) -> ReturnCode {
        eprintln!("{what}: {self}");
        match self {
            Self::Service(code) | Self::Limit(code, _) => *code,
            Self::NoThread(_) => ReturnCode::InvalidConfig,
        }
    }
}

impl Kernel {
    /// CREATE_PROCESS, with its thread.
    pub(crate) fn add_process(
        self: &Arc<Self>,
        attributes: &ProcessAttributes,
        body: Body,
    ) -> Result<ProcessId, Refusal> {
        let mut state = self.lock();
        let id = state.partition.create_process(attributes);
        let id = id.map_err(|code| match state.partition.exceeded_by(attributes) {
            Some(limit) => Refusal::Limit(code, limit.to_string()),
            None => code.into(),
        })?;
        let place = state.batons.len(); // `complete` sees to it that every process is made here
        let baton = thread::spawn(self, place, body.clone()).map_err(Refusal::NoThread)?;
        state.batons.push(baton);
        state.bodies.push(Some(body));
        Ok(id)
    }

    /// CREATE_ERROR_HANDLER, with its thread.
    pub(crate) fn add_error_handler(self: &Arc<Self>, stack_size: u32, body: Body) -> Result<(), Refusal> {
        let mut state = self.lock();
        state.partition.create_error_handler(stack_size)?;
        state.batons[HANDLER] = thread::spawn(self, HANDLER, body.clone()).map_err(Refusal::NoThread)?;
        state.bodies[HANDLER] = Some(body);
        Ok(())
    }
}

/// Every process and the error handler have a thread.
///
/// # Errors
/// One was created by its service alone.
pub(crate) fn complete(state: &mut State) -> Result<(), StartError> {
    let processes = state.partition.processes().count();
    let handler = state.partition.configure_error_handler(ErrorHandlerConcurrency::ProcessesPause, 0).is_ok();
    if processes + FIRST_PROCESS != state.batons.len() || handler != state.bodies[HANDLER].is_some() {
        let mend = "create processes and the error handler by `Initialisation`, which gives them threads";
        return Err(StartError::Other(mend.into()));
    }
    Ok(())
}

/// The services while the partition starts. When this is dropped, an error handler that was enabled serves the errors that were raised.
pub struct Services<'p> {
    state: MutexGuard<'p, State>,
    /// Dropped after the lock.
    _after: HandlerFirst<'p>,
}

/// When this is dropped, the main process waits until the error handler has nothing to do.
struct HandlerFirst<'p>(&'p Kernel);

impl Drop for HandlerFirst<'_> {
    fn drop(&mut self) {
        if !std::thread::panicking() {
            self.0.let_handler_run();
        }
    }
}

impl Deref for Services<'_> {
    type Target = Partition;

    fn deref(&self) -> &Partition {
        &self.state.partition
    }
}

impl DerefMut for Services<'_> {
    fn deref_mut(&mut self) -> &mut Partition {
        &mut self.state.partition
    }
}
