//! Records of the standard's C interface, with the layout that `apex.h` gives them.
//!
//! Enumerations are plain numbers here: what comes from C may be any. `I` is an identifier, of 32 or 64 bits.

use bateleur_apex::processes::current::ModuleScheduleStatus;
use bateleur_apex::processes::standard;

/// A name: 32 characters, or fewer and a NUL.
pub type Name = [u8; standard::MAX_NAME_LENGTH];

/// A number that stands for an object.
pub trait Identifier: Copy {
    /// As the services have it; one that nobody has if it is beyond their range.
    fn number(self) -> i32;
    /// As C has it.
    fn of(number: i32) -> Self;
}

impl Identifier for i32 {
    fn number(self) -> i32 {
        self
    }

    fn of(number: i32) -> Self {
        number
    }
}

impl Identifier for i64 {
    fn number(self) -> i32 {
        i32::try_from(self).unwrap_or(i32::MIN)
    }

    fn of(number: i32) -> Self {
        number.into()
    }
}

/// PROCESS_ATTRIBUTE_TYPE.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct ProcessAttribute {
    /// ns; -1: aperiodic.
    pub period: i64,
    /// ns; -1: no deadline.
    pub time_capacity: i64,
    /// Address of a function without arguments.
    pub entry_point: usize,
    /// Bytes.
    pub stack_size: u32,
    /// 1 to 239.
    pub base_priority: i32,
    /// SOFT or HARD.
    pub deadline: u32,
    /// Unique in the partition.
    pub name: Name,
}

/// PROCESS_STATUS_TYPE.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct ProcessStatus {
    /// Module time, ns; -1: none.
    pub deadline_time: i64,
    /// 1 to 239.
    pub current_priority: i32,
    /// PROCESS_STATE_TYPE.
    pub process_state: u32,
    /// As it was created.
    pub attributes: ProcessAttribute,
}

/// PARTITION_STATUS_TYPE.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct PartitionStatus<I> {
    /// ns.
    pub period: i64,
    /// ns.
    pub duration: i64,
    /// The partition's number.
    pub identifier: I,
    /// Of the preemption lock.
    pub lock_level: i32,
    /// OPERATING_MODE_TYPE.
    pub operating_mode: u32,
    /// START_CONDITION_TYPE.
    pub start_condition: u32,
    /// Cores that it may use.
    pub num_assigned_cores: u32,
}

/// SAMPLING_PORT_STATUS_TYPE.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct SamplingPortStatus {
    /// ns.
    pub refresh_period: i64,
    /// Bytes.
    pub max_message_size: i32,
    /// PORT_DIRECTION_TYPE.
    pub port_direction: u32,
    /// VALIDITY_TYPE.
    pub last_msg_validity: u32,
}

/// SAMPLING_PORT_CURRENT_STATUS_TYPE.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct SamplingPortCurrentStatus {
    /// ns.
    pub refresh_period: i64,
    /// When the latest message was written, ns.
    pub time_stamp: i64,
    /// Bytes.
    pub max_message_size: i32,
    /// PORT_DIRECTION_TYPE.
    pub port_direction: u32,
    /// MESSAGE_AGE_TYPE.
    pub message_age: u32,
    /// UPDATED_TYPE.
    pub updated: u32,
}

/// QUEUING_PORT_STATUS_TYPE.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct QueuingPortStatus {
    /// Messages in it.
    pub nb_message: i32,
    /// Messages that it can hold.
    pub max_nb_message: i32,
    /// Bytes.
    pub max_message_size: i32,
    /// PORT_DIRECTION_TYPE.
    pub port_direction: u32,
    /// Processes that wait at it.
    pub waiting_processes: i32,
}

/// BUFFER_STATUS_TYPE.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct BufferStatus {
    /// Messages in it.
    pub nb_message: i32,
    /// Messages that it can hold.
    pub max_nb_message: i32,
    /// Bytes.
    pub max_message_size: i32,
    /// Processes that wait at it.
    pub waiting_processes: i32,
}

/// BLACKBOARD_STATUS_TYPE.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct BlackboardStatus {
    /// EMPTY_INDICATOR_TYPE.
    pub empty_indicator: u32,
    /// Bytes.
    pub max_message_size: i32,
    /// Processes that wait at it.
    pub waiting_processes: i32,
}

/// SEMAPHORE_STATUS_TYPE.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct SemaphoreStatus {
    /// Its count.
    pub current_value: i32,
    /// The highest count.
    pub maximum_value: i32,
    /// Processes that wait at it.
    pub waiting_processes: i32,
}

/// EVENT_STATUS_TYPE.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct EventStatus {
    /// EVENT_STATE_TYPE.
    pub event_state: u32,
    /// Processes that wait for it.
    pub waiting_processes: i32,
}

/// MUTEX_STATUS_TYPE.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct MutexStatus<I> {
    /// A process, or NULL_PROCESS_ID.
    pub mutex_owner: I,
    /// MUTEX_STATE_TYPE.
    pub mutex_state: u32,
    /// 1 to 239.
    pub mutex_priority: i32,
    /// How often its owner has taken it.
    pub lock_count: i32,
    /// Processes that wait for it.
    pub waiting_processes: i32,
}

/// SCHEDULE_STATUS_TYPE (Part 2).
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct ScheduleStatus<I> {
    /// Module time, ns; 0: the module has not changed yet.
    pub time_of_last_schedule_switch: i64,
    /// The schedule that runs.
    pub current_schedule: I,
    /// That of the next major frame.
    pub next_schedule: I,
}

/// MEMORY_BLOCK_STATUS_TYPE (Part 2).
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct MemoryBlockStatus {
    /// Where it begins.
    pub memory_block_addr: usize,
    /// MEMORY_BLOCK_MODE_TYPE.
    pub memory_block_mode: u32,
    /// Bytes.
    pub memory_block_size: i32,
}

/// SAP_ADDRESS_TYPE (Part 2).
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct SapAddress {
    /// The address in IP, version 4: its first number in the upper eight bits.
    pub ip_address: u32,
    /// The port.
    pub udp_port: u32,
}

impl From<standard::SapAddress> for SapAddress {
    fn from(of: standard::SapAddress) -> Self {
        Self { ip_address: of.ip().to_bits(), udp_port: of.port().into() }
    }
}

impl From<SapAddress> for standard::SapAddress {
    /// A port that none can have is 0, which the plan gives nobody.
    fn from(of: SapAddress) -> Self {
        Self::new(of.ip_address.into(), of.udp_port.try_into().unwrap_or(0))
    }
}

/// LOGBOOK_STATUS_TYPE (Part 2).
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct LogbookStatus {
    /// Bytes of a message.
    pub max_message_size: i32,
    /// Messages that it keeps.
    pub max_nb_logged_messages: i32,
    /// Messages that may be on their way to the store.
    pub max_nb_in_progress_messages: i32,
    /// Messages that are stored.
    pub nb_logged_messages: i32,
    /// Messages that are on their way.
    pub nb_in_progress_messages: i32,
    /// Messages of both kinds that were aborted.
    pub nb_aborted_messages: i32,
}

/// ERROR_STATUS_TYPE.
#[derive(Debug, Clone, Copy)]
#[repr(C)]
pub struct ErrorStatus<I> {
    /// Of a fault: where; otherwise 0.
    pub failed_address: usize,
    /// The process that it concerns.
    pub failed_process_id: I,
    /// ERROR_CODE_TYPE.
    pub error_code: u32,
    /// Bytes of the message.
    pub length: i32,
    /// The text of the one who raised it.
    pub message: [u8; standard::MAX_ERROR_MESSAGE_SIZE],
}

impl<I: Identifier> From<ModuleScheduleStatus> for ScheduleStatus<I> {
    fn from(of: ModuleScheduleStatus) -> Self {
        Self {
            time_of_last_schedule_switch: of.time_of_last_switch,
            current_schedule: I::of(of.current),
            next_schedule: I::of(of.next),
        }
    }
}

impl From<standard::MemoryBlockStatus> for MemoryBlockStatus {
    fn from(of: standard::MemoryBlockStatus) -> Self {
        Self { memory_block_addr: of.address, memory_block_mode: of.mode.into(), memory_block_size: of.size }
    }
}

impl From<standard::LogbookStatus> for LogbookStatus {
    fn from(of: standard::LogbookStatus) -> Self {
        Self {
            max_message_size: of.max_message_size,
            max_nb_logged_messages: of.max_logged,
            max_nb_in_progress_messages: of.max_in_progress,
            nb_logged_messages: of.logged,
            nb_in_progress_messages: of.in_progress,
            nb_aborted_messages: of.aborted,
        }
    }
}

impl From<standard::ProcessAttributes> for ProcessAttribute {
    fn from(of: standard::ProcessAttributes) -> Self {
        Self {
            period: of.period,
            time_capacity: of.time_capacity,
            entry_point: of.entry_point,
            stack_size: of.stack_size,
            base_priority: of.base_priority,
            deadline: of.deadline.into(),
            name: filled(of.name.as_bytes()),
        }
    }
}

impl From<standard::ProcessStatus> for ProcessStatus {
    fn from(of: standard::ProcessStatus) -> Self {
        Self {
            deadline_time: of.deadline_time,
            current_priority: of.current_priority,
            process_state: of.state.into(),
            attributes: of.attributes.into(),
        }
    }
}

impl<I: Identifier> From<standard::PartitionStatus> for PartitionStatus<I> {
    fn from(of: standard::PartitionStatus) -> Self {
        Self {
            period: of.period,
            duration: of.duration,
            identifier: I::of(of.identifier),
            lock_level: of.lock_level,
            operating_mode: of.operating_mode.into(),
            start_condition: of.start_condition.into(),
            num_assigned_cores: of.num_assigned_cores.unsigned_abs(),
        }
    }
}

impl From<standard::SamplingPortStatus> for SamplingPortStatus {
    fn from(of: standard::SamplingPortStatus) -> Self {
        Self {
            refresh_period: of.refresh_period,
            max_message_size: of.max_message_size,
            port_direction: of.port_direction.into(),
            last_msg_validity: of.last_msg_validity.into(),
        }
    }
}

impl From<standard::SamplingPortCurrentStatus> for SamplingPortCurrentStatus {
    fn from(of: standard::SamplingPortCurrentStatus) -> Self {
        Self {
            refresh_period: of.refresh_period,
            time_stamp: of.time_stamp,
            max_message_size: of.max_message_size,
            port_direction: of.port_direction.into(),
            message_age: of.message_age.into(),
            updated: of.updated.into(),
        }
    }
}

impl From<standard::QueuingPortStatus> for QueuingPortStatus {
    fn from(of: standard::QueuingPortStatus) -> Self {
        Self {
            nb_message: of.nb_message,
            max_nb_message: of.max_nb_message,
            max_message_size: of.max_message_size,
            port_direction: of.port_direction.into(),
            waiting_processes: of.waiting_processes,
        }
    }
}

impl From<standard::BufferStatus> for BufferStatus {
    fn from(of: standard::BufferStatus) -> Self {
        Self {
            nb_message: of.nb_message,
            max_nb_message: of.max_nb_message,
            max_message_size: of.max_message_size,
            waiting_processes: of.waiting_processes,
        }
    }
}

impl From<standard::BlackboardStatus> for BlackboardStatus {
    fn from(of: standard::BlackboardStatus) -> Self {
        Self {
            empty_indicator: of.empty_indicator.into(),
            max_message_size: of.max_message_size,
            waiting_processes: of.waiting_processes,
        }
    }
}

impl From<standard::SemaphoreStatus> for SemaphoreStatus {
    fn from(of: standard::SemaphoreStatus) -> Self {
        Self {
            current_value: of.current_value,
            maximum_value: of.maximum_value,
            waiting_processes: of.waiting_processes,
        }
    }
}

impl From<standard::EventStatus> for EventStatus {
    fn from(of: standard::EventStatus) -> Self {
        Self { event_state: of.event_state.into(), waiting_processes: of.waiting_processes }
    }
}

impl<I: Identifier> From<standard::MutexStatus> for MutexStatus<I> {
    fn from(of: standard::MutexStatus) -> Self {
        Self {
            mutex_owner: I::of(of.mutex_owner.0),
            mutex_state: of.mutex_state.into(),
            mutex_priority: of.mutex_priority,
            lock_count: of.lock_count,
            waiting_processes: of.waiting_processes,
        }
    }
}

impl<I: Identifier> From<standard::ErrorStatus> for ErrorStatus<I> {
    fn from(of: standard::ErrorStatus) -> Self {
        let text = of.message.as_bytes();
        Self {
            failed_address: of.failed_address,
            failed_process_id: I::of(of.failed_process_id.0),
            error_code: of.error_code.into(),
            length: text.len() as i32, // 128 at the most
            message: filled(text),
        }
    }
}

/// The text, and zeros behind it.
fn filled<const N: usize>(text: &[u8]) -> [u8; N] {
    let mut bytes = [0; N];
    let length = text.len().min(N);
    bytes[..length].copy_from_slice(&text[..length]);
    bytes
}
