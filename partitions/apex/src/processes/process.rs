//! What a process calls.
#![allow(unsafe_code)] // ports are shared between threads of which one runs at a time

use std::cell::UnsafeCell;
use std::sync::atomic::Ordering;
use std::sync::{Arc, MutexGuard};

use bateleur_processes::standard::{
    BlackboardId, EventId, NameServiceId, ProcessId, QueuingPortId, QueuingPortListId,
    SamplingPortCurrentStatus, SamplingPortId, SapAddress, SemaphoreId, SystemTime, Updated, Validity,
};
use bateleur_processes::{Partition, Progress, ReturnCode};

use super::PlanPorts;
use super::kernel::{Asks, FIRST_PROCESS, Kernel, MAIN, Passed, State};
use super::{foreign, thread};
use crate::schedule::{ScheduleId, ScheduleStatus, Schedules};

/// What a process is made from.
#[derive(Clone)]
pub(crate) struct Body {
    /// Its thread's name.
    pub(crate) name: String,
    /// Its thread's stack, bytes.
    pub(crate) stack: usize,
    pub(crate) run: Arc<EntryPoint>,
}

impl Body {
    /// One of another language, with `stack` bytes for itself.
    pub(crate) fn foreign(name: &str, stack: u32, entry: extern "C" fn()) -> Self {
        let run = move |_: &Process| {
            if !foreign::call(entry) {
                thread::begin_again();
            }
            Ok(())
        };
        Self { name: name.into(), stack: stack as usize + OF_SERVICES, run: Arc::new(run) }
    }
}

/// Bytes of a foreign process's stack beside what it asks for: for services, which it knows nothing of.
const OF_SERVICES: usize = 64 << 10;

/// Where a process begins.
pub(crate) type EntryPoint = dyn Fn(&Process) -> Result<(), ReturnCode> + Send + Sync;

/// The process that runs, for its own code.
pub struct Process {
    kernel: Arc<Kernel>,
}

/// A port that processes share: they reach it through [`Process::with`], one at a time. Cheap to clone.
pub struct Port<T>(Arc<Shared<T>>);

struct Shared<T>(UnsafeCell<T>);

// SAFETY: it is reached under the partition's one lock only, by one thread at a time, with everything that it shares with other ports.
unsafe impl<T> Send for Shared<T> {}
// SAFETY: as above.
unsafe impl<T> Sync for Shared<T> {}

impl<T> Port<T> {
    pub(crate) fn new(port: T) -> Self {
        Self(Arc::new(Shared(UnsafeCell::new(port))))
    }
}

impl<T> Clone for Port<T> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl Process {
    pub(crate) fn new(kernel: Arc<Kernel>) -> Self {
        Self { kernel }
    }

    /// Calls a service that does not wait. It may let another process run before it returns.
    ///
    /// # Errors
    /// As the service. INVALID_MODE: called from within another service, or while a stopped process unwinds.
    pub fn call<R>(
        &self,
        service: impl FnOnce(&mut Partition) -> Result<R, ReturnCode>,
    ) -> Result<R, ReturnCode> {
        self.at_ports(|partition, _| service(partition))
    }

    /// As above, for a service that takes the plan's ports.
    ///
    /// # Errors
    /// As above.
    pub fn at_ports<R>(
        &self,
        service: impl FnOnce(&mut Partition, &mut PlanPorts) -> Result<R, ReturnCode>,
    ) -> Result<R, ReturnCode> {
        self.serve(service)?
    }

    /// Calls a service that may wait, and returns when it is done.
    ///
    /// # Errors
    /// As the service; and as [`Process::call`].
    pub fn wait(
        &self,
        service: impl FnOnce(&mut Partition) -> Result<Progress, ReturnCode>,
    ) -> Result<(), ReturnCode> {
        match self.serve(|partition, _| service(partition))?? {
            Progress::Done(()) => Ok(()),
            Progress::Waits => self.result(),
        }
    }

    /// As [`Process::wait`], for a service that gives a message: that is put into `into`.
    ///
    /// # Errors
    /// As there. A message that comes with an error (INVALID_CONFIG of a queuing port) is in `into` as well.
    pub fn receive(
        &self,
        into: &mut Vec<u8>,
        service: impl FnOnce(&mut Partition, &mut Vec<u8>) -> Result<Progress, ReturnCode>,
    ) -> Result<(), ReturnCode> {
        let progress = self.serve(|partition, _| service(partition, into))??;
        self.message(progress, into)
    }

    /// SEND_QUEUING_MESSAGE.
    ///
    /// # Errors
    /// As [`Partition::send_queuing_message`].
    pub fn send_queuing_message(
        &self,
        port: QueuingPortId,
        message: &[u8],
        time_out: SystemTime,
    ) -> Result<(), ReturnCode> {
        let send = |partition: &mut Partition, ports: &mut PlanPorts| {
            partition.send_queuing_message(ports, port, message, time_out)
        };
        match self.at_ports(send)? {
            Progress::Done(()) => Ok(()),
            Progress::Waits => self.result(),
        }
    }

    /// RECEIVE_QUEUING_MESSAGE: the message is put into `into`.
    ///
    /// # Errors
    /// As [`Partition::receive_queuing_message`]. With INVALID_CONFIG `into` has a message too: one before it was lost.
    pub fn receive_queuing_message(
        &self,
        port: QueuingPortId,
        time_out: SystemTime,
        into: &mut Vec<u8>,
    ) -> Result<(), ReturnCode> {
        let progress =
            self.at_ports(|partition, ports| partition.receive_queuing_message(ports, port, time_out, into))?;
        self.message(progress, into)
    }

    /// RECEIVE_MESSAGE_FROM_QUEUING_PORT_LIST (Part 2): the message is put into `into`, and `port` says whose it is.
    ///
    /// # Errors
    /// As [`Partition::receive_message_from_queuing_port_list`]. With INVALID_CONFIG `into` has a message too: one before it was lost.
    pub fn receive_message_from_queuing_port_list(
        &self,
        list: QueuingPortListId,
        time_out: SystemTime,
        buffer_size: i32,
        reset_list: u32,
        (into, port): (&mut Vec<u8>, &mut Option<QueuingPortId>),
    ) -> Result<(), ReturnCode> {
        let progress = self.at_ports(|partition, ports| {
            let into = (&mut *into, &mut *port);
            partition.receive_message_from_queuing_port_list(
                ports,
                list,
                time_out,
                buffer_size,
                reset_list,
                into,
            )
        })?;
        self.with_port_of_list(progress, port)?;
        self.message(progress, into)
    }

    /// WAIT_FOR_MESSAGE_FROM_QUEUING_PORT_LIST (Part 2): the port that has a message, which stays there.
    ///
    /// # Errors
    /// As [`Partition::wait_for_message_from_queuing_port_list`].
    pub fn wait_for_message_from_queuing_port_list(
        &self,
        list: QueuingPortListId,
        time_out: SystemTime,
        reset_list: u32,
        port: &mut Option<QueuingPortId>,
    ) -> Result<(), ReturnCode> {
        let progress = self.at_ports(|partition, ports| {
            partition.wait_for_message_from_queuing_port_list(ports, list, time_out, reset_list, &mut *port)
        })?;
        self.with_port_of_list(progress, port)?;
        if progress == Progress::Done(()) { Ok(()) } else { self.result() }
    }

    /// The port of which the caller was told while it waited.
    fn with_port_of_list(
        &self,
        progress: Progress,
        port: &mut Option<QueuingPortId>,
    ) -> Result<(), ReturnCode> {
        if progress == Progress::Waits {
            let id = self.id().ok_or(ReturnCode::InvalidMode)?;
            *port = self.look(|partition| partition.served_port_of(id))?;
        }
        Ok(())
    }

    /// WRITE_SAMPLING_MESSAGE.
    ///
    /// # Errors
    /// As [`Partition::write_sampling_message`].
    pub fn write_sampling_message(&self, port: SamplingPortId, message: &[u8]) -> Result<(), ReturnCode> {
        self.at_ports(|partition, ports| partition.write_sampling_message(ports, port, message))
    }

    /// READ_SAMPLING_MESSAGE: the message is put into `into`.
    ///
    /// # Errors
    /// As [`Partition::read_sampling_message`].
    pub fn read_sampling_message(
        &self,
        port: SamplingPortId,
        into: &mut Vec<u8>,
    ) -> Result<Validity, ReturnCode> {
        self.at_ports(|partition, ports| partition.read_sampling_message(ports, port, into))
    }

    /// READ_UPDATED_SAMPLING_MESSAGE: a message that was not read yet is put into `into`; `updated` says what there was.
    ///
    /// # Errors
    /// As [`Partition::read_updated_sampling_message`].
    pub fn read_updated_sampling_message(
        &self,
        port: SamplingPortId,
        into: &mut Vec<u8>,
        updated: &mut Updated,
    ) -> Result<(), ReturnCode> {
        self.at_ports(|partition, ports| partition.read_updated_sampling_message(ports, port, into, updated))
    }

    /// READ_SAMPLING_MESSAGE_CONDITIONAL: a message that was written after `reference` is put into `into`; `time_stamp` says when it
    /// was written.
    ///
    /// # Errors
    /// As [`Partition::read_sampling_message_conditional`].
    pub fn read_sampling_message_conditional(
        &self,
        port: SamplingPortId,
        reference: SystemTime,
        into: &mut Vec<u8>,
        time_stamp: &mut SystemTime,
    ) -> Result<(), ReturnCode> {
        self.at_ports(|partition, ports| {
            partition.read_sampling_message_conditional(ports, port, reference, into, time_stamp)
        })
    }

    /// GET_SAMPLING_PORT_CURRENT_STATUS.
    ///
    /// # Errors
    /// As [`Partition::get_sampling_port_current_status`].
    pub fn get_sampling_port_current_status(
        &self,
        port: SamplingPortId,
    ) -> Result<SamplingPortCurrentStatus, ReturnCode> {
        self.at_ports(|partition, ports| partition.get_sampling_port_current_status(ports, port))
    }

    /// GET_MODULE_SCHEDULE_ID (Part 2).
    ///
    /// # Errors
    /// INVALID_CONFIG: the plan has no such schedule. And as [`Process::call`].
    pub fn get_module_schedule_id(&self, name: &str) -> Result<ScheduleId, ReturnCode> {
        self.at_schedules(|schedules| schedules.id(name))
    }

    /// GET_MODULE_SCHEDULE_STATUS (Part 2), as it was when the window was granted, and with what this partition has asked for since.
    ///
    /// # Errors
    /// As [`Process::call`].
    pub fn get_module_schedule_status(&self) -> Result<ScheduleStatus, ReturnCode> {
        self.at_schedules(|schedules| Ok(schedules.status(&self.kernel.page)))
    }

    /// SET_MODULE_SCHEDULE (Part 2).
    ///
    /// # Errors
    /// As [`crate::ModuleSchedules::set_module_schedule`], and as [`Process::call`].
    pub fn set_module_schedule(&self, schedule: ScheduleId) -> Result<(), ReturnCode> {
        self.at_schedules(|schedules| schedules.set(&self.kernel.page, schedule))
    }

    fn at_schedules<R>(
        &self,
        service: impl FnOnce(&Schedules) -> Result<R, ReturnCode>,
    ) -> Result<R, ReturnCode> {
        self.serve(|_, _| service(self.kernel.schedules.get_or_init(Schedules::default)))?
    }

    /// PERIODIC_WAIT.
    ///
    /// # Errors
    /// As [`Partition::periodic_wait`].
    pub fn periodic_wait(&self) -> Result<(), ReturnCode> {
        self.wait(Partition::periodic_wait)
    }

    /// TIMED_WAIT, ns.
    ///
    /// # Errors
    /// As [`Partition::timed_wait`].
    pub fn timed_wait(&self, delay_ns: SystemTime) -> Result<(), ReturnCode> {
        self.wait(|partition| partition.timed_wait(delay_ns))
    }

    /// GET_TIME: module time, ns.
    ///
    /// # Errors
    /// As [`Process::call`].
    pub fn now_ns(&self) -> Result<SystemTime, ReturnCode> {
        // On the wall clock nothing of the partition is asked.
        let now = if thread::own_place() == MAIN { None } else { self.kernel.wall_time() };
        let Some(now) = now else { return self.serve(|partition, _| partition.get_time()) };
        if !thread::enter_service() {
            return Err(ReturnCode::InvalidMode);
        }
        thread::leave_service();
        Ok(now)
    }

    /// GET_ADDRESS: where the service access point with that name is reached.
    ///
    /// # Errors
    /// As [`Partition::get_address`]; and as [`Process::call`].
    pub fn get_address(
        &self,
        service: NameServiceId,
        name: &[u8],
        time_out: SystemTime,
    ) -> Result<SapAddress, ReturnCode> {
        let mut found = None;
        self.wait(|services| services.get_address(service, name, time_out, &mut found))?;
        found.ok_or(ReturnCode::NotAvailable)
    }

    /// GET_NAME: the name of the service access point that is reached there, into `into`.
    ///
    /// # Errors
    /// As [`Partition::get_name`]; and as [`Process::call`].
    pub fn get_name(
        &self,
        service: NameServiceId,
        address: SapAddress,
        time_out: SystemTime,
        max_length: i32,
        into: &mut Vec<u8>,
    ) -> Result<(), ReturnCode> {
        self.wait(|services| services.get_name(service, address, time_out, max_length, into))
    }

    /// SET_EVENT. This service and the four that follow know no time: on the wall clock they cost less than by [`Process::call`].
    ///
    /// # Errors
    /// As [`Partition::set_event`].
    pub fn set_event(&self, event: EventId) -> Result<(), ReturnCode> {
        self.serve_timeless(|partition| partition.set_event(event))?
    }

    /// RESET_EVENT.
    ///
    /// # Errors
    /// As [`Partition::reset_event`].
    pub fn reset_event(&self, event: EventId) -> Result<(), ReturnCode> {
        self.serve_timeless(|partition| partition.reset_event(event))?
    }

    /// SIGNAL_SEMAPHORE.
    ///
    /// # Errors
    /// As [`Partition::signal_semaphore`].
    pub fn signal_semaphore(&self, semaphore: SemaphoreId) -> Result<(), ReturnCode> {
        self.serve_timeless(|partition| partition.signal_semaphore(semaphore))?
    }

    /// DISPLAY_BLACKBOARD.
    ///
    /// # Errors
    /// As [`Partition::display_blackboard`].
    pub fn display_blackboard(&self, blackboard: BlackboardId, message: &[u8]) -> Result<(), ReturnCode> {
        self.serve_timeless(|partition| partition.display_blackboard(blackboard, message))?
    }

    /// CLEAR_BLACKBOARD.
    ///
    /// # Errors
    /// As [`Partition::clear_blackboard`].
    pub fn clear_blackboard(&self, blackboard: BlackboardId) -> Result<(), ReturnCode> {
        self.serve_timeless(|partition| partition.clear_blackboard(blackboard))?
    }

    /// Uses a port. No other process runs meanwhile.
    ///
    /// # Errors
    /// As [`Process::call`].
    pub fn with<T, R>(&self, port: &Port<T>, using: impl FnOnce(&mut T) -> R) -> Result<R, ReturnCode> {
        // SAFETY: under the lock, and not from within another service.
        self.serve(|_, _| using(unsafe { &mut *port.0.0.get() }))
    }

    /// With what the wait of this process has ended.
    fn result(&self) -> Result<(), ReturnCode> {
        self.id().map_or(Ok(()), |id| self.look(|partition| partition.result_of(id))?)
    }

    /// As above, and the message that it was given meanwhile.
    fn message(&self, progress: Progress, into: &mut Vec<u8>) -> Result<(), ReturnCode> {
        if progress == Progress::Done(()) {
            return Ok(());
        }
        self.look(|partition| {
            let id = self.id().ok_or(ReturnCode::InvalidMode)?;
            into.clear();
            into.extend_from_slice(partition.message_of(id));
            partition.result_of(id)
        })?
    }

    /// The identifier of the thread's process; `None` for the error handler.
    fn id(&self) -> Option<ProcessId> {
        let place = thread::own_place().checked_sub(FIRST_PROCESS)?;
        Some(ProcessId(place as i32 + 1))
    }

    /// Does something as a service, when it is this process's turn.
    fn serve<R>(&self, service: impl FnOnce(&mut Partition, &mut PlanPorts) -> R) -> Result<R, ReturnCode> {
        self.serve_at(Asks::Time, service)
    }

    /// As above, for a service to which it is all one what time it is. On the wall clock that is not asked: what becomes due is the main
    /// thread's to see.
    fn serve_timeless<R>(&self, service: impl FnOnce(&mut Partition) -> R) -> Result<R, ReturnCode> {
        self.serve_at(Asks::Nothing, |partition, _| service(partition))
    }

    fn serve_at<R>(
        &self,
        asks: Asks,
        service: impl FnOnce(&mut Partition, &mut PlanPorts) -> R,
    ) -> Result<R, ReturnCode> {
        if !thread::enter_service() {
            return Err(ReturnCode::InvalidMode);
        }
        let mut state = self.kernel.lock();
        let standing = self.kernel.keep_turn(&mut state, thread::own_place(), asks);
        if standing.is_none() {
            drop(state);
            // Who has become more urgent meanwhile goes first.
            state = self.turn();
        }
        let State { partition, ports, .. } = &mut *state;
        let result = service(partition, ports);
        if standing.is_none() || asks == Asks::Time {
            self.kernel.spend(&mut state, thread::service_ns());
            state.serve_ports();
        }
        if state.is_as_it_was(standing) {
            drop(state);
        } else {
            self.hand_on(state);
        }
        thread::leave_service();
        Ok(result)
    }

    /// Looks at the state, which takes no time.
    fn look<R>(&self, at: impl FnOnce(&Partition) -> R) -> Result<R, ReturnCode> {
        if !thread::enter_service() {
            return Err(ReturnCode::InvalidMode);
        }
        let result = at(&self.kernel.lock().partition);
        thread::leave_service();
        Ok(result)
    }

    /// Waits until it is this process's turn.
    fn turn(&self) -> MutexGuard<'_, State> {
        loop {
            let mut state = self.kernel.lock();
            self.kernel.tick(&mut state, 0);
            match self.hand_on(state) {
                Some(state) => return state,
                None => continue,
            }
        }
    }

    /// Lets others run whose turn it is. The lock, if it is this process's; `None` when it is again.
    fn hand_on<'k>(&'k self, mut state: MutexGuard<'k, State>) -> Option<MutexGuard<'k, State>> {
        let place = thread::own_place();
        let life = state.batons[place].life.load(Ordering::Relaxed);
        if self.kernel.pass(&mut state, place) == Passed::Kept {
            return Some(state);
        }
        let baton = state.batons[place].clone();
        drop(state);
        if place == MAIN {
            baton.take(); // the main process does not begin again
        } else {
            thread::sleep(&baton, life);
        }
        None
    }
}
