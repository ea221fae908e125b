//! Semaphores, events and mutexes.

use a653rs::bindings as a653;
use a653rs::bindings::{
    ApexEventP1, ApexMutexP1, ApexSemaphoreP1, ApexSystemTime, EventName, MutexName, Priority,
    QueuingDiscipline, SemaphoreName, SemaphoreValue,
};
use bateleur_apex::processes::standard::{EventId, EventState, MutexId, MutexState, ProcessId, SemaphoreId};

use crate::convert::{Answer, call, id, text, time, wait};
use crate::partition::ApexLinuxPartition;

impl ApexSemaphoreP1 for ApexLinuxPartition {
    fn create_semaphore(
        semaphore_name: SemaphoreName,
        current_value: SemaphoreValue,
        maximum_value: SemaphoreValue,
        queuing_discipline: QueuingDiscipline,
    ) -> Answer<a653::SemaphoreId> {
        let (name, discipline) = (text(&semaphore_name)?, queuing_discipline as u32);
        let semaphore =
            call(|services| services.create_semaphore(name, current_value, maximum_value, discipline))?;
        Ok(semaphore.0.into())
    }

    fn wait_semaphore(semaphore_id: a653::SemaphoreId, time_out: ApexSystemTime) -> Answer<()> {
        wait(|services| services.wait_semaphore(SemaphoreId(id(semaphore_id)), time(time_out)))
    }

    fn signal_semaphore(semaphore_id: a653::SemaphoreId) -> Answer<()> {
        call(|services| services.signal_semaphore(SemaphoreId(id(semaphore_id))))
    }

    fn get_semaphore_id(semaphore_name: SemaphoreName) -> Answer<a653::SemaphoreId> {
        let name = text(&semaphore_name)?;
        Ok(call(|services| services.get_semaphore_id(name))?.0.into())
    }

    fn get_semaphore_status(semaphore_id: a653::SemaphoreId) -> Answer<a653::SemaphoreStatus> {
        let status = call(|services| services.get_semaphore_status(SemaphoreId(id(semaphore_id))))?;
        Ok(a653::SemaphoreStatus {
            current_value: status.current_value,
            maximum_value: status.maximum_value,
            waiting_processes: status.waiting_processes,
        })
    }
}

impl ApexEventP1 for ApexLinuxPartition {
    fn create_event(event_name: EventName) -> Answer<a653::EventId> {
        let name = text(&event_name)?;
        Ok(call(|services| services.create_event(name))?.0.into())
    }

    fn set_event(event_id: a653::EventId) -> Answer<()> {
        call(|services| services.set_event(EventId(id(event_id))))
    }

    fn reset_event(event_id: a653::EventId) -> Answer<()> {
        call(|services| services.reset_event(EventId(id(event_id))))
    }

    fn wait_event(event_id: a653::EventId, time_out: ApexSystemTime) -> Answer<()> {
        wait(|services| services.wait_event(EventId(id(event_id)), time(time_out)))
    }

    fn get_event_id(event_name: EventName) -> Answer<a653::EventId> {
        let name = text(&event_name)?;
        Ok(call(|services| services.get_event_id(name))?.0.into())
    }

    fn get_event_status(event_id: a653::EventId) -> Answer<a653::EventStatus> {
        let status = call(|services| services.get_event_status(EventId(id(event_id))))?;
        Ok(a653::EventStatus {
            event_state: match status.event_state {
                EventState::Down => a653::EventState::Down,
                EventState::Up => a653::EventState::Up,
            },
            waiting_processes: status.waiting_processes,
        })
    }
}

impl ApexMutexP1 for ApexLinuxPartition {
    fn create_mutex(
        mutex_name: MutexName,
        mutex_priority: Priority,
        queuing_discipline: QueuingDiscipline,
    ) -> Answer<a653::MutexId> {
        let (name, discipline) = (text(&mutex_name)?, queuing_discipline as u32);
        Ok(call(|services| services.create_mutex(name, mutex_priority, discipline))?.0.into())
    }

    fn acquire_mutex(mutex_id: a653::MutexId, time_out: ApexSystemTime) -> Answer<()> {
        wait(|services| services.acquire_mutex(MutexId(id(mutex_id)), time(time_out)))
    }

    fn release_mutex(mutex_id: a653::MutexId) -> Answer<()> {
        call(|services| services.release_mutex(MutexId(id(mutex_id))))
    }

    fn reset_mutex(mutex_id: a653::MutexId, process_id: a653::ProcessId) -> Answer<()> {
        call(|services| services.reset_mutex(MutexId(id(mutex_id)), ProcessId(id(process_id))))
    }

    fn get_mutex_id(mutex_name: MutexName) -> Answer<a653::MutexId> {
        let name = text(&mutex_name)?;
        Ok(call(|services| services.get_mutex_id(name))?.0.into())
    }

    fn get_mutex_status(mutex_id: a653::MutexId) -> Answer<a653::MutexStatus> {
        let status = call(|services| services.get_mutex_status(MutexId(id(mutex_id))))?;
        Ok(a653::MutexStatus {
            mutex_owner: status.mutex_owner.0.into(),
            mutex_state: match status.mutex_state {
                MutexState::Available => a653::MutexState::Available,
                MutexState::Owned => a653::MutexState::Owned,
            },
            mutex_priority: status.mutex_priority,
            lock_count: status.lock_count,
            waiting_processes: status.waiting_processes,
        })
    }

    fn get_process_mutex_state(process_id: a653::ProcessId) -> Answer<a653::MutexId> {
        Ok(call(|services| services.get_process_mutex_state(ProcessId(id(process_id))))?.0.into())
    }
}
