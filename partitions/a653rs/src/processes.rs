//! The partition, its processes, their time, and errors.
#![allow(unsafe_code)] // addresses of functions, which the services keep as numbers

use std::mem::transmute;
use std::sync::Mutex;

use a653rs::bindings as a653;
use a653rs::bindings::{
    ApexErrorP1, ApexErrorP4, ApexPartitionP4, ApexPartitionStatus, ApexProcessAttribute, ApexProcessP1,
    ApexProcessP4, ApexProcessStatus, ApexSystemTime, ApexTimeP1, ApexTimeP4, ErrorReturnCode, ProcessName,
    SystemAddress,
};
use bateleur_apex::processes::current;
use bateleur_apex::processes::standard::{
    Deadline, ErrorCode, INFINITE_TIME_VALUE, MAX_ERROR_MESSAGE_SIZE, MAX_PRIORITY, Name, OperatingMode,
    ProcessAttributes, ProcessId, ProcessState, StartCondition,
};

use crate::convert::{Answer, call, code, id, text, time, unsigned, wait};
use crate::partition::ApexLinuxPartition;

impl a653rs::prelude::limits::ApexLimits for ApexLinuxPartition {}

impl ApexPartitionP4 for ApexLinuxPartition {
    fn get_partition_status() -> ApexPartitionStatus {
        let Ok(status) = call(|services| Ok(services.get_partition_status())) else {
            // A thread that is no process knows nothing.
            return ApexPartitionStatus::default();
        };
        ApexPartitionStatus {
            period: status.period,
            duration: status.duration,
            identifier: status.identifier.into(),
            lock_level: status.lock_level,
            operating_mode: match status.operating_mode {
                OperatingMode::Idle => a653::OperatingMode::Idle,
                OperatingMode::ColdStart => a653::OperatingMode::ColdStart,
                OperatingMode::WarmStart => a653::OperatingMode::WarmStart,
                OperatingMode::Normal => a653::OperatingMode::Normal,
            },
            start_condition: match status.start_condition {
                StartCondition::NormalStart => a653::StartCondition::NormalStart,
                StartCondition::PartitionRestart => a653::StartCondition::PartitionRestart,
                StartCondition::HmModuleRestart => a653::StartCondition::HmModuleRestart,
                StartCondition::HmPartitionRestart => a653::StartCondition::HmPartitionRestart,
            },
            num_assigned_cores: unsigned(status.num_assigned_cores),
        }
    }

    fn set_partition_mode(operating_mode: a653::OperatingMode) -> Answer<()> {
        if operating_mode == a653::OperatingMode::Normal {
            periodic_first();
        }
        current::set_partition_mode(operating_mode as u32).map_err(code)
    }
}

/// The priorities of the processes that were created, and whether they have a period.
static CREATED: Mutex<Vec<(ProcessId, bool, i32)>> = Mutex::new(Vec::new());

/// Of one periodic and one aperiodic process the periodic one goes first, whatever their priorities say, as in the profile of Part 4 and
/// on that hypervisor: partitions rely on it, and their aperiodic process may never wait.
fn periodic_first() {
    let Ok(created) = CREATED.lock() else { return };
    let mut processes = created.clone();
    processes.sort_by_key(|(_, periodic, _)| *periodic);
    if let [(aperiodic, false, its), (periodic, true, others)] = processes[..]
        && others <= its
    {
        let below = its.min(MAX_PRIORITY - 1);
        for (process, priority) in [(aperiodic, below), (periodic, below + 1)] {
            let _ = call(|services| services.set_priority(process, priority)); // one that is not started runs not at all
        }
    }
}

impl ApexProcessP4 for ApexLinuxPartition {
    fn create_process(attributes: &ApexProcessAttribute) -> Answer<a653::ProcessId> {
        let attributes = attributes_of(attributes);
        let entry = entry(attributes.entry_point);
        let id = current::create_process(&attributes, entry).map_err(code)?;
        if let Ok(mut created) = CREATED.lock() {
            created.push((id, attributes.period != INFINITE_TIME_VALUE, attributes.base_priority));
        }
        Ok(id.0.into())
    }

    fn start(process_id: a653::ProcessId) -> Answer<()> {
        call(|services| services.start(process(process_id)))
    }
}

/// A period of 0 is the partition's.
fn period(period: ApexSystemTime) -> ApexSystemTime {
    if period == 0 { ApexLinuxPartition::get_partition_status().period } else { time(period) }
}

/// A capacity of 0 is none.
fn capacity(capacity: ApexSystemTime) -> ApexSystemTime {
    if capacity > 0 { capacity } else { INFINITE_TIME_VALUE }
}

fn attributes_of(given: &ApexProcessAttribute) -> ProcessAttributes {
    ProcessAttributes {
        name: Name::of_array(given.name),
        entry_point: given.entry_point as usize,
        stack_size: given.stack_size,
        base_priority: given.base_priority,
        period: period(given.period),
        time_capacity: capacity(given.time_capacity),
        deadline: match given.deadline {
            a653::Deadline::Soft => Deadline::Soft,
            a653::Deadline::Hard => Deadline::Hard,
        },
    }
}

extern "C" fn nowhere() {}

/// The function at an address; at 0 there is none, which the type of `a653rs` can not say.
fn entry(address: usize) -> SystemAddress {
    if address == 0 {
        return nowhere;
    }
    // SAFETY: what is called was such a function when the program gave its address; the address of a fault is only looked at.
    unsafe { transmute::<usize, SystemAddress>(address) }
}

fn process(number: a653::ProcessId) -> ProcessId {
    ProcessId(id(number))
}

impl ApexProcessP1 for ApexLinuxPartition {
    fn set_priority(process_id: a653::ProcessId, priority: a653::Priority) -> Answer<()> {
        call(|services| services.set_priority(process(process_id), priority))
    }

    fn suspend_self(time_out: ApexSystemTime) -> Answer<()> {
        wait(|services| services.suspend_self(time(time_out)))
    }

    fn suspend(process_id: a653::ProcessId) -> Answer<()> {
        call(|services| services.suspend(process(process_id)))
    }

    fn resume(process_id: a653::ProcessId) -> Answer<()> {
        call(|services| services.resume(process(process_id)))
    }

    fn stop_self() {
        current::stop_self();
    }

    fn stop(process_id: a653::ProcessId) -> Answer<()> {
        call(|services| services.stop(process(process_id)))
    }

    fn delayed_start(process_id: a653::ProcessId, delay_time: ApexSystemTime) -> Answer<()> {
        call(|services| services.delayed_start(process(process_id), delay_time))
    }

    fn lock_preemption() -> Answer<a653::LockLevel> {
        current::lock_preemption().map_err(code)
    }

    fn unlock_preemption() -> Answer<a653::LockLevel> {
        call(|services| services.unlock_preemption())
    }

    fn get_my_id() -> Answer<a653::ProcessId> {
        Ok(call(|services| services.get_my_id())?.0.into())
    }

    fn get_process_id(process_name: ProcessName) -> Answer<a653::ProcessId> {
        let name = text(&process_name)?;
        Ok(call(|services| services.get_process_id(name))?.0.into())
    }

    fn get_process_status(process_id: a653::ProcessId) -> Answer<ApexProcessStatus> {
        let status = call(|services| services.get_process_status(process(process_id)))?;
        let of = status.attributes;
        let mut name = ProcessName::default();
        name[..of.name.as_bytes().len()].copy_from_slice(of.name.as_bytes());
        Ok(ApexProcessStatus {
            deadline_time: status.deadline_time,
            current_priority: status.current_priority,
            process_state: match status.state {
                ProcessState::Dormant => a653::ProcessState::Dormant,
                ProcessState::Ready => a653::ProcessState::Ready,
                ProcessState::Running => a653::ProcessState::Running,
                ProcessState::Waiting => a653::ProcessState::Waiting,
                ProcessState::Faulted => a653::ProcessState::Faulted,
            },
            attributes: ApexProcessAttribute {
                period: of.period,
                time_capacity: of.time_capacity,
                entry_point: entry(of.entry_point),
                stack_size: of.stack_size,
                base_priority: of.base_priority,
                deadline: match of.deadline {
                    Deadline::Soft => a653::Deadline::Soft,
                    Deadline::Hard => a653::Deadline::Hard,
                },
                name,
            },
        })
    }

    fn initialize_process_core_affinity(
        process_id: a653::ProcessId,
        processor_core_id: a653::ProcessorCoreId,
    ) -> Answer<()> {
        call(|services| services.initialize_process_core_affinity(process(process_id), processor_core_id))
    }

    fn get_my_processor_core_id() -> a653::ProcessorCoreId {
        call(|services| Ok(services.get_my_processor_core_id())).unwrap_or(0)
    }

    fn get_my_index() -> Answer<a653::ProcessIndex> {
        call(|services| services.get_my_index())
    }
}

impl ApexTimeP4 for ApexLinuxPartition {
    fn periodic_wait() -> Answer<()> {
        wait(|services| services.periodic_wait())
    }

    fn get_time() -> ApexSystemTime {
        call(|services| Ok(services.get_time())).unwrap_or(0)
    }
}

impl ApexTimeP1 for ApexLinuxPartition {
    fn timed_wait(delay_time: ApexSystemTime) -> Answer<()> {
        wait(|services| services.timed_wait(time(delay_time)))
    }

    fn replenish(budget_time: ApexSystemTime) -> Answer<()> {
        call(|services| services.replenish(time(budget_time)))
    }
}

impl ApexErrorP4 for ApexLinuxPartition {
    fn report_application_message(message: &[a653::ApexByte]) -> Answer<()> {
        call(|services| services.report_application_message(message))
    }

    fn raise_application_error(error_code: a653::ErrorCode, message: &[a653::ApexByte]) -> Answer<()> {
        call(|services| services.raise_application_error(error_code as u32, message))
    }
}

impl ApexErrorP1 for ApexLinuxPartition {
    fn create_error_handler(entry_point: SystemAddress, stack_size: a653::StackSize) -> Answer<()> {
        current::create_error_handler(entry_point, stack_size).map_err(code)
    }

    fn get_error_status() -> Answer<a653::ErrorStatus> {
        let status = call(|services| services.get_error_status())?;
        let (given, mut message) = (status.message.as_bytes(), [0; MAX_ERROR_MESSAGE_SIZE]);
        message[..given.len()].copy_from_slice(given);
        Ok(a653::ErrorStatus {
            failed_address: entry(status.failed_address),
            failed_process_id: status.failed_process_id.0.into(),
            error_code: error_code(status.error_code),
            length: given.len() as a653::ErrorMessageSize, // 128 at the most
            message,
        })
    }

    fn configure_error_handler(
        concurrency_control: a653::ErrorHandlerConcurrencyControl,
        processor_core_id: a653::ProcessorCoreId,
    ) -> Result<(), ErrorReturnCode> {
        call(|services| services.configure_error_handler(concurrency_control as u32, processor_core_id))
    }
}

fn error_code(of: ErrorCode) -> a653::ErrorCode {
    match of {
        ErrorCode::DeadlineMissed => a653::ErrorCode::DeadlineMissed,
        ErrorCode::ApplicationError => a653::ErrorCode::ApplicationError,
        ErrorCode::NumericError => a653::ErrorCode::NumericError,
        ErrorCode::IllegalRequest => a653::ErrorCode::IllegalRequest,
        ErrorCode::StackOverflow => a653::ErrorCode::StackOverflow,
        ErrorCode::MemoryViolation => a653::ErrorCode::MemoryViolation,
        ErrorCode::HardwareFault => a653::ErrorCode::HardwareFault,
        ErrorCode::PowerFail => a653::ErrorCode::PowerFail,
    }
}
