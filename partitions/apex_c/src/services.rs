//! The functions that C calls.
#![allow(unsafe_code)] // every pointer is the caller's

mod pointers;

use std::ffi::{CStr, c_char};

use bateleur_apex::ReturnCode;
use bateleur_apex::processes::standard::{
    BlackboardId, BufferId, Deadline, EventId, LogbookId, MAX_LOCK_LEVEL, MutexId, NameServiceId,
    ProcessAttributes, ProcessId, QueuingPortId, QueuingPortListId, SamplingPortId, SemaphoreId, Updated,
    Validity, WriteStatus,
};
use bateleur_apex::processes::{Progress, Services, current, standard};

use crate::types::{
    BlackboardStatus, BufferStatus, ErrorStatus, EventStatus, Identifier, LogbookStatus, MemoryBlockStatus,
    MutexStatus, PartitionStatus, ProcessAttribute, ProcessStatus, QueuingPortStatus,
    SamplingPortCurrentStatus, SamplingPortStatus, SapAddress, ScheduleStatus, SemaphoreStatus,
};
use pointers::{bytes, given, name_of, put, put_first, receive, tell, text};

/// Declares functions for identifiers of 32 bits, and of 64 bits under the name behind. Each has a last argument for the return code.
macro_rules! services {
    ($($narrow:ident, $wide:ident ($($argument:ident: $of:ty),*) $body:block)+) => {
        mod narrow {
            use super::*;
            type Id = i32;
            $(services!(@function $narrow ($($argument: $of),*) $body);)+
        }
        mod wide {
            use super::*;
            type Id = i64;
            $(services!(@function $wide ($($argument: $of),*) $body);)+
        }
    };
    (@function $name:ident ($($argument:ident: $of:ty),*) $body:block) => {
        #[unsafe(no_mangle)]
        #[allow(non_snake_case)] // the standard's name
        unsafe extern "C" fn $name($($argument: $of,)* return_code: *mut u32) {
            // SAFETY: the header asks for pointers to what their types say; null is looked for.
            unsafe {
                let serve = || -> Result<(), ReturnCode> { $body };
                tell(return_code, serve());
            }
        }
    };
}

/// As above, for functions in which no identifier is.
macro_rules! plain_services {
    ($($name:ident ($($argument:ident: $of:ty),*) $body:block)+) => {
        $(services!(@function $name ($($argument: $of),*) $body);)+
    };
}

/// How a program in Rust ends that has panicked.
const PANICKED: i32 = 101;

/// Calls a service that does not wait.
fn call<R>(service: impl FnOnce(&mut Services) -> Result<R, ReturnCode>) -> Result<R, ReturnCode> {
    current::as_process(|process| process.call(service))
}

/// Calls one that may wait.
fn wait(service: impl FnOnce(&mut Services) -> Result<Progress, ReturnCode>) -> Result<(), ReturnCode> {
    current::as_process(|process| process.wait(service))
}

fn process(id: impl Identifier) -> ProcessId {
    ProcessId(id.number())
}

plain_services! {
    SET_PARTITION_MODE(mode: u32) {
        // It ends the program as a panic in Rust does: into C nothing unwinds, and an abort there prints a backtrace, for which the
        // partition may lack memory and time.
        let set = std::panic::catch_unwind(|| current::set_partition_mode(mode));
        set.unwrap_or_else(|_| std::process::exit(PANICKED))
    }
    GET_MEMORY_BLOCK_STATUS(name: *const u8, status: *mut MemoryBlockStatus) {
        let name = name_of(name)?;
        put_first(status, || call(|services| services.get_memory_block_status(name.text()?)).map(Into::into))
    }
    SET_DEFAULT_PROCESS_CORE_AFFINITY(core: i32) {
        call(|services| services.set_default_process_core_affinity(core))
    }
    SUSPEND_SELF(time_out: i64) { wait(|services| services.suspend_self(time_out)) }
    LOCK_PREEMPTION(level: *mut i32) {
        given(level)?;
        match current::lock_preemption() {
            Err(ReturnCode::InvalidConfig) => {
                put(level, MAX_LOCK_LEVEL)?;
                Err(ReturnCode::InvalidConfig)
            }
            locked => put(level, locked?),
        }
    }
    UNLOCK_PREEMPTION(level: *mut i32) { put_first(level, || call(|services| services.unlock_preemption())) }
    GET_MY_PROCESSOR_CORE_ID(core: *mut i32) {
        put_first(core, || call(|services| Ok(services.get_my_processor_core_id())))
    }
    GET_MY_INDEX(index: *mut i32) { put_first(index, || call(|services| services.get_my_index())) }
    TIMED_WAIT(delay: i64) { wait(|services| services.timed_wait(delay)) }
    PERIODIC_WAIT() { wait(|services| services.periodic_wait()) }
    GET_TIME(time: *mut i64) { put_first(time, || current::as_process(|process| process.now_ns())) }
    REPLENISH(budget: i64) { call(|services| services.replenish(budget)) }
    REPORT_APPLICATION_MESSAGE(message: *const u8, length: i32) {
        let message = text(message, length)?;
        call(|services| services.report_application_message(message))
    }
    CREATE_ERROR_HANDLER(entry: usize, stack: u32) {
        current::create_error_handler(entry_of(entry)?, stack)
    }
    ENABLE_ERROR_HANDLER() { call(|services| services.enable_error_handler()) }
    RAISE_APPLICATION_ERROR(code: u32, message: *const u8, length: i32) {
        let message = text(message, length)?;
        call(|services| services.raise_application_error(code, message))
    }
    CONFIGURE_ERROR_HANDLER(concurrency: u32, core: i32) {
        call(|services| services.configure_error_handler(concurrency, core))
    }
}

services! {
    GET_PARTITION_STATUS, GET_PARTITION_STATUS_64 (status: *mut PartitionStatus<Id>) {
        put_first(status, || call(|services| Ok(services.get_partition_status().into())))
    }

    CREATE_PROCESS, CREATE_PROCESS_64 (attributes: *const ProcessAttribute, id: *mut Id) {
        put_first(id, || {
            given(attributes)?;
            let (attributes, entry) = attributes_of(&*attributes)?;
            current::create_process(&attributes, entry).map(|id| Id::of(id.0))
        })
    }
    SET_PRIORITY, SET_PRIORITY_64 (id: Id, priority: i32) {
        call(|services| services.set_priority(process(id), priority))
    }
    SUSPEND, SUSPEND_64 (id: Id) { call(|services| services.suspend(process(id))) }
    RESUME, RESUME_64 (id: Id) { call(|services| services.resume(process(id))) }
    STOP, STOP_64 (id: Id) { call(|services| services.stop(process(id))) }
    START, START_64 (id: Id) { call(|services| services.start(process(id))) }
    DELAYED_START, DELAYED_START_64 (id: Id, delay: i64) {
        call(|services| services.delayed_start(process(id), delay))
    }
    GET_MY_ID, GET_MY_ID_64 (id: *mut Id) {
        put_first(id, || call(|services| services.get_my_id()).map(|id| Id::of(id.0)))
    }
    GET_PROCESS_ID, GET_PROCESS_ID_64 (name: *const u8, id: *mut Id) {
        let name = name_of(name)?;
        put_first(id, || call(|services| services.get_process_id(name.text()?)).map(|id| Id::of(id.0)))
    }
    GET_PROCESS_STATUS, GET_PROCESS_STATUS_64 (id: Id, status: *mut ProcessStatus) {
        put_first(status, || call(|services| services.get_process_status(process(id))).map(Into::into))
    }
    INITIALIZE_PROCESS_CORE_AFFINITY, INITIALIZE_PROCESS_CORE_AFFINITY_64 (id: Id, core: i32) {
        call(|services| services.initialize_process_core_affinity(process(id), core))
    }
    SET_PROCESS_CORE_AFFINITY, SET_PROCESS_CORE_AFFINITY_64 (id: Id, core: i32) {
        call(|services| services.set_process_core_affinity(process(id), core))
    }
    GET_PROCESS_CORE_AFFINITY, GET_PROCESS_CORE_AFFINITY_64 (id: Id, core: *mut i32) {
        put_first(core, || call(|services| services.get_process_core_affinity(process(id))))
    }

    SET_MODULE_SCHEDULE, SET_MODULE_SCHEDULE_64 (id: Id) { current::set_module_schedule(id.number()) }
    GET_MODULE_SCHEDULE_STATUS, GET_MODULE_SCHEDULE_STATUS_64 (status: *mut ScheduleStatus<Id>) {
        put_first(status, || current::get_module_schedule_status().map(Into::into))
    }
    GET_MODULE_SCHEDULE_ID, GET_MODULE_SCHEDULE_ID_64 (name: *const u8, id: *mut Id) {
        let name = name_of(name)?;
        put_first(id, || current::get_module_schedule_id(name.text()?).map(Id::of))
    }

    CREATE_SAMPLING_PORT, CREATE_SAMPLING_PORT_64
    (name: *const u8, size: i32, direction: u32, refresh: i64, id: *mut Id) {
        std::hint::black_box(bateleur_built_with as *const ()); // it is linked
        let name = name_of(name)?;
        put_first(id, || {
            current::create_sampling_port(name.text()?, size, direction, refresh).map(|id| Id::of(id.0))
        })
    }
    WRITE_SAMPLING_MESSAGE, WRITE_SAMPLING_MESSAGE_64 (id: Id, message: *const u8, length: i32) {
        let (id, message) = (SamplingPortId(id.number()), bytes(message, length)?);
        current::as_process(|process| process.write_sampling_message(id, message))
    }
    READ_SAMPLING_MESSAGE, READ_SAMPLING_MESSAGE_64
    (id: Id, message: *mut u8, length: *mut i32, validity: *mut u32) {
        put(validity, Validity::Invalid.into())?;
        let id = SamplingPortId(id.number());
        let read = receive(message, length, |process, into| process.read_sampling_message(id, into))?;
        put(validity, read.into())
    }
    GET_SAMPLING_PORT_ID, GET_SAMPLING_PORT_ID_64 (name: *const u8, id: *mut Id) {
        let name = name_of(name)?;
        put_first(id, || call(|services| services.get_sampling_port_id(name.text()?)).map(|id| Id::of(id.0)))
    }
    GET_SAMPLING_PORT_STATUS, GET_SAMPLING_PORT_STATUS_64 (id: Id, status: *mut SamplingPortStatus) {
        let id = SamplingPortId(id.number());
        put_first(status, || call(|services| services.get_sampling_port_status(id)).map(Into::into))
    }
    READ_UPDATED_SAMPLING_MESSAGE, READ_UPDATED_SAMPLING_MESSAGE_64
    (id: Id, message: *mut u8, length: *mut i32, updated: *mut u32) {
        put(updated, Updated::EmptyPort.into())?;
        let (id, mut found) = (SamplingPortId(id.number()), Updated::EmptyPort);
        let read = receive(message, length, |process, into| {
            process.read_updated_sampling_message(id, into, &mut found)
        });
        put(updated, found.into())?;
        read
    }
    READ_SAMPLING_MESSAGE_CONDITIONAL, READ_SAMPLING_MESSAGE_CONDITIONAL_64
    (id: Id, reference: i64, message: *mut u8, length: *mut i32, time_stamp: *mut i64) {
        put(time_stamp, 0)?;
        let (id, mut stamp) = (SamplingPortId(id.number()), 0);
        let read = receive(message, length, |process, into| {
            process.read_sampling_message_conditional(id, reference, into, &mut stamp)
        });
        put(time_stamp, stamp)?;
        read
    }
    GET_SAMPLING_PORT_CURRENT_STATUS, GET_SAMPLING_PORT_CURRENT_STATUS_64
    (id: Id, status: *mut SamplingPortCurrentStatus) {
        let id = SamplingPortId(id.number());
        put_first(status, || {
            current::as_process(|process| process.get_sampling_port_current_status(id)).map(Into::into)
        })
    }

    CREATE_QUEUING_PORT, CREATE_QUEUING_PORT_64
    (name: *const u8, size: i32, messages: i32, direction: u32, discipline: u32, id: *mut Id) {
        std::hint::black_box(bateleur_built_with as *const ()); // it is linked
        let name = name_of(name)?;
        put_first(id, || {
            let port = current::create_queuing_port(name.text()?, size, messages, direction, discipline);
            port.map(|id| Id::of(id.0))
        })
    }
    SEND_QUEUING_MESSAGE, SEND_QUEUING_MESSAGE_64 (id: Id, message: *const u8, length: i32, time_out: i64) {
        let (id, message) = (QueuingPortId(id.number()), bytes(message, length)?);
        current::as_process(|process| process.send_queuing_message(id, message, time_out))
    }
    RECEIVE_QUEUING_MESSAGE, RECEIVE_QUEUING_MESSAGE_64
    (id: Id, time_out: i64, message: *mut u8, length: *mut i32) {
        let id = QueuingPortId(id.number());
        receive(message, length, |process, into| process.receive_queuing_message(id, time_out, into))
    }
    GET_QUEUING_PORT_ID, GET_QUEUING_PORT_ID_64 (name: *const u8, id: *mut Id) {
        let name = name_of(name)?;
        put_first(id, || call(|services| services.get_queuing_port_id(name.text()?)).map(|id| Id::of(id.0)))
    }
    GET_QUEUING_PORT_STATUS, GET_QUEUING_PORT_STATUS_64 (id: Id, status: *mut QueuingPortStatus) {
        let id = QueuingPortId(id.number());
        put_first(status, || {
            let status = current::as_process(|process| {
                process.at_ports(|services, ports| services.get_queuing_port_status(ports, id))
            });
            status.map(Into::into)
        })
    }
    CLEAR_QUEUING_PORT, CLEAR_QUEUING_PORT_64 (id: Id) {
        let id = QueuingPortId(id.number());
        current::as_process(|process| process.at_ports(|services, ports| services.clear_queuing_port(ports, id)))
    }

    CREATE_QUEUING_PORT_LIST, CREATE_QUEUING_PORT_LIST_64 (name: *const u8, most: i32, id: *mut Id) {
        let name = name_of(name)?;
        put_first(id, || {
            call(|services| services.create_queuing_port_list(name.text()?, most)).map(|id| Id::of(id.0))
        })
    }
    ADD_PORT_TO_QUEUING_PORT_LIST, ADD_PORT_TO_QUEUING_PORT_LIST_64 (list: Id, port: Id, action: u32) {
        let (list, port) = (QueuingPortListId(list.number()), QueuingPortId(port.number()));
        call(|services| services.add_port_to_queuing_port_list(list, port, action))
    }
    SET_PORT_ACTION_IN_QUEUING_PORT_LIST, SET_PORT_ACTION_IN_QUEUING_PORT_LIST_64
    (list: Id, port: Id, action: u32) {
        let (list, port) = (QueuingPortListId(list.number()), QueuingPortId(port.number()));
        call(|services| services.set_port_action_in_queuing_port_list(list, port, action))
    }
    GET_QUEUING_PORT_ACTION_STATUS, GET_QUEUING_PORT_ACTION_STATUS_64
    (list: Id, port: Id, action: *mut u32) {
        let (list, port) = (QueuingPortListId(list.number()), QueuingPortId(port.number()));
        put_first(action, || {
            call(|services| services.get_queuing_port_action_status(list, port)).map(Into::into)
        })
    }
    RECEIVE_MESSAGE_FROM_QUEUING_PORT_LIST, RECEIVE_MESSAGE_FROM_QUEUING_PORT_LIST_64
    (list: Id, time_out: i64, message: *mut u8, size: i32, reset: u32, port: *mut Id, length: *mut i32) {
        put(port, Id::of(0))?;
        let (list, mut served) = (QueuingPortListId(list.number()), None);
        let received = receive(message, length, |process, into| {
            let into = (into, &mut served);
            process.receive_message_from_queuing_port_list(list, time_out, size, reset, into)
        });
        put(port, Id::of(served.map_or(0, |port| port.0)))?;
        received
    }
    WAIT_FOR_MESSAGE_FROM_QUEUING_PORT_LIST, WAIT_FOR_MESSAGE_FROM_QUEUING_PORT_LIST_64
    (list: Id, time_out: i64, reset: u32, port: *mut Id) {
        put(port, Id::of(0))?;
        let (list, mut served) = (QueuingPortListId(list.number()), None);
        let waited = current::as_process(|process| {
            process.wait_for_message_from_queuing_port_list(list, time_out, reset, &mut served)
        });
        put(port, Id::of(served.map_or(0, |port| port.0)))?;
        waited
    }

    CREATE_LOGBOOK, CREATE_LOGBOOK_64
    (name: *const u8, size: i32, logged: i32, in_progress: i32, id: *mut Id) {
        let name = name_of(name)?;
        put_first(id, || {
            let logbook = call(|services| services.create_logbook(name.text()?, size, logged, in_progress));
            logbook.map(|id| Id::of(id.0))
        })
    }
    WRITE_LOGBOOK, WRITE_LOGBOOK_64 (id: Id, message: *const u8, length: i32) {
        let (id, message) = (LogbookId(id.number()), bytes(message, length)?);
        call(|services| services.write_logbook(id, message))
    }
    OVERWRITE_LOGBOOK, OVERWRITE_LOGBOOK_64 (id: Id, message: *const u8, length: i32) {
        let (id, message) = (LogbookId(id.number()), bytes(message, length)?);
        call(|services| services.overwrite_logbook(id, message))
    }
    READ_LOGBOOK, READ_LOGBOOK_64
    (id: Id, entry: i32, message: *mut u8, length: *mut i32, status: *mut u32) {
        put(status, WriteStatus::Aborted.into())?;
        let id = LogbookId(id.number());
        let read = receive(message, length, |process, into| {
            process.call(|services| services.read_logbook(id, entry, into))
        })?;
        put(status, read.into())
    }
    CLEAR_LOGBOOK, CLEAR_LOGBOOK_64 (id: Id) { call(|services| services.clear_logbook(LogbookId(id.number()))) }
    GET_LOGBOOK_ID, GET_LOGBOOK_ID_64 (name: *const u8, id: *mut Id) {
        let name = name_of(name)?;
        put_first(id, || call(|services| services.get_logbook_id(name.text()?)).map(|id| Id::of(id.0)))
    }
    GET_LOGBOOK_STATUS, GET_LOGBOOK_STATUS_64 (id: Id, status: *mut LogbookStatus) {
        let id = LogbookId(id.number());
        put_first(status, || call(|services| services.get_logbook_status(id)).map(Into::into))
    }

    CREATE_NAME_SERVICE, CREATE_NAME_SERVICE_64 (name: *const u8, discipline: u32, id: *mut Id) {
        let name = name_of(name)?;
        put_first(id, || {
            call(|services| services.create_name_service(name.text()?, discipline)).map(|id| Id::of(id.0))
        })
    }
    GET_NAME, GET_NAME_64
    (id: Id, address: SapAddress, time_out: i64, name: *mut u8, most: i32, length: *mut i32) {
        let id = NameServiceId(id.number());
        receive(name, length, |process, into| process.get_name(id, address.into(), time_out, most, into))
    }
    GET_ADDRESS, GET_ADDRESS_64
    (id: Id, name: *const u8, length: i32, time_out: i64, address: *mut SapAddress) {
        let (id, name) = (NameServiceId(id.number()), bytes(name, length)?);
        put_first(address, || {
            current::as_process(|process| process.get_address(id, name, time_out)).map(Into::into)
        })
    }

    CREATE_BUFFER, CREATE_BUFFER_64
    (name: *const u8, size: i32, messages: i32, discipline: u32, id: *mut Id) {
        let name = name_of(name)?;
        put_first(id, || {
            let buffer = call(|services| services.create_buffer(name.text()?, size, messages, discipline));
            buffer.map(|id| Id::of(id.0))
        })
    }
    SEND_BUFFER, SEND_BUFFER_64 (id: Id, message: *const u8, length: i32, time_out: i64) {
        let (id, message) = (BufferId(id.number()), bytes(message, length)?);
        wait(|services| services.send_buffer(id, message, time_out))
    }
    RECEIVE_BUFFER, RECEIVE_BUFFER_64 (id: Id, time_out: i64, message: *mut u8, length: *mut i32) {
        let id = BufferId(id.number());
        receive(message, length, |process, into| {
            process.receive(into, |services, into| services.receive_buffer(id, time_out, into))
        })
    }
    GET_BUFFER_ID, GET_BUFFER_ID_64 (name: *const u8, id: *mut Id) {
        let name = name_of(name)?;
        put_first(id, || call(|services| services.get_buffer_id(name.text()?)).map(|id| Id::of(id.0)))
    }
    GET_BUFFER_STATUS, GET_BUFFER_STATUS_64 (id: Id, status: *mut BufferStatus) {
        let id = BufferId(id.number());
        put_first(status, || call(|services| services.get_buffer_status(id)).map(Into::into))
    }

    CREATE_BLACKBOARD, CREATE_BLACKBOARD_64 (name: *const u8, size: i32, id: *mut Id) {
        let name = name_of(name)?;
        put_first(id, || call(|services| services.create_blackboard(name.text()?, size)).map(|id| Id::of(id.0)))
    }
    DISPLAY_BLACKBOARD, DISPLAY_BLACKBOARD_64 (id: Id, message: *const u8, length: i32) {
        let (id, message) = (BlackboardId(id.number()), bytes(message, length)?);
        current::as_process(|process| process.display_blackboard(id, message))
    }
    READ_BLACKBOARD, READ_BLACKBOARD_64 (id: Id, time_out: i64, message: *mut u8, length: *mut i32) {
        let id = BlackboardId(id.number());
        receive(message, length, |process, into| {
            process.receive(into, |services, into| services.read_blackboard(id, time_out, into))
        })
    }
    CLEAR_BLACKBOARD, CLEAR_BLACKBOARD_64 (id: Id) {
        current::as_process(|process| process.clear_blackboard(BlackboardId(id.number())))
    }
    GET_BLACKBOARD_ID, GET_BLACKBOARD_ID_64 (name: *const u8, id: *mut Id) {
        let name = name_of(name)?;
        put_first(id, || call(|services| services.get_blackboard_id(name.text()?)).map(|id| Id::of(id.0)))
    }
    GET_BLACKBOARD_STATUS, GET_BLACKBOARD_STATUS_64 (id: Id, status: *mut BlackboardStatus) {
        let id = BlackboardId(id.number());
        put_first(status, || call(|services| services.get_blackboard_status(id)).map(Into::into))
    }

    CREATE_SEMAPHORE, CREATE_SEMAPHORE_64
    (name: *const u8, value: i32, most: i32, discipline: u32, id: *mut Id) {
        let name = name_of(name)?;
        put_first(id, || {
            let semaphore = call(|services| services.create_semaphore(name.text()?, value, most, discipline));
            semaphore.map(|id| Id::of(id.0))
        })
    }
    WAIT_SEMAPHORE, WAIT_SEMAPHORE_64 (id: Id, time_out: i64) {
        wait(|services| services.wait_semaphore(SemaphoreId(id.number()), time_out))
    }
    SIGNAL_SEMAPHORE, SIGNAL_SEMAPHORE_64 (id: Id) {
        current::as_process(|process| process.signal_semaphore(SemaphoreId(id.number())))
    }
    GET_SEMAPHORE_ID, GET_SEMAPHORE_ID_64 (name: *const u8, id: *mut Id) {
        let name = name_of(name)?;
        put_first(id, || call(|services| services.get_semaphore_id(name.text()?)).map(|id| Id::of(id.0)))
    }
    GET_SEMAPHORE_STATUS, GET_SEMAPHORE_STATUS_64 (id: Id, status: *mut SemaphoreStatus) {
        let id = SemaphoreId(id.number());
        put_first(status, || call(|services| services.get_semaphore_status(id)).map(Into::into))
    }

    CREATE_EVENT, CREATE_EVENT_64 (name: *const u8, id: *mut Id) {
        let name = name_of(name)?;
        put_first(id, || call(|services| services.create_event(name.text()?)).map(|id| Id::of(id.0)))
    }
    SET_EVENT, SET_EVENT_64 (id: Id) { current::as_process(|process| process.set_event(EventId(id.number()))) }
    RESET_EVENT, RESET_EVENT_64 (id: Id) { current::as_process(|process| process.reset_event(EventId(id.number()))) }
    WAIT_EVENT, WAIT_EVENT_64 (id: Id, time_out: i64) {
        wait(|services| services.wait_event(EventId(id.number()), time_out))
    }
    GET_EVENT_ID, GET_EVENT_ID_64 (name: *const u8, id: *mut Id) {
        let name = name_of(name)?;
        put_first(id, || call(|services| services.get_event_id(name.text()?)).map(|id| Id::of(id.0)))
    }
    GET_EVENT_STATUS, GET_EVENT_STATUS_64 (id: Id, status: *mut EventStatus) {
        let id = EventId(id.number());
        put_first(status, || call(|services| services.get_event_status(id)).map(Into::into))
    }

    CREATE_MUTEX, CREATE_MUTEX_64 (name: *const u8, priority: i32, discipline: u32, id: *mut Id) {
        let name = name_of(name)?;
        put_first(id, || {
            let mutex = call(|services| services.create_mutex(name.text()?, priority, discipline));
            mutex.map(|id| Id::of(id.0))
        })
    }
    ACQUIRE_MUTEX, ACQUIRE_MUTEX_64 (id: Id, time_out: i64) {
        wait(|services| services.acquire_mutex(MutexId(id.number()), time_out))
    }
    RELEASE_MUTEX, RELEASE_MUTEX_64 (id: Id) { call(|services| services.release_mutex(MutexId(id.number()))) }
    RESET_MUTEX, RESET_MUTEX_64 (id: Id, owner: Id) {
        call(|services| services.reset_mutex(MutexId(id.number()), process(owner)))
    }
    GET_MUTEX_ID, GET_MUTEX_ID_64 (name: *const u8, id: *mut Id) {
        let name = name_of(name)?;
        put_first(id, || call(|services| services.get_mutex_id(name.text()?)).map(|id| Id::of(id.0)))
    }
    GET_MUTEX_STATUS, GET_MUTEX_STATUS_64 (id: Id, status: *mut MutexStatus<Id>) {
        let id = MutexId(id.number());
        put_first(status, || call(|services| services.get_mutex_status(id)).map(Into::into))
    }
    GET_PROCESS_MUTEX_STATE, GET_PROCESS_MUTEX_STATE_64 (id: Id, mutex: *mut Id) {
        put_first(mutex, || {
            call(|services| services.get_process_mutex_state(process(id))).map(|id| Id::of(id.0))
        })
    }

    GET_ERROR_STATUS, GET_ERROR_STATUS_64 (status: *mut ErrorStatus<Id>) {
        put_first(status, || call(|services| services.get_error_status()).map(Into::into))
    }
}

/// What a header of message types tells of one of them before `main`. It is weak there: whoever creates ports has it linked.
#[unsafe(no_mangle)]
unsafe extern "C" fn bateleur_built_with(name: *const c_char, layout: u32) {
    // SAFETY: the header gives a literal.
    if let Ok(name) = unsafe { CStr::from_ptr(name) }.to_str() {
        current::built_with(name, layout);
    }
}

/// STOP_SELF.
#[unsafe(no_mangle)]
#[allow(non_snake_case)]
extern "C" fn STOP_SELF() {
    current::stop_self();
}

fn attributes_of(given: &ProcessAttribute) -> Result<(ProcessAttributes, current::ForeignEntry), ReturnCode> {
    let attributes = ProcessAttributes {
        name: standard::Name::of_array(given.name),
        entry_point: given.entry_point,
        stack_size: given.stack_size,
        base_priority: given.base_priority,
        period: given.period,
        time_capacity: given.time_capacity,
        deadline: Deadline::try_from(given.deadline)?,
    };
    Ok((attributes, entry_of(given.entry_point)?))
}

/// The function at an address.
fn entry_of(address: usize) -> Result<current::ForeignEntry, ReturnCode> {
    if address == 0 {
        return Err(ReturnCode::InvalidParam);
    }
    // SAFETY: the header asks for a function without arguments; where it is none, its process faults.
    Ok(unsafe { std::mem::transmute::<usize, current::ForeignEntry>(address) })
}
