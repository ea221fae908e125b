//! Numbers, modes, records and identifiers of ARINC 653 Part 1 (supplement 5).
//!
//! Services take the numbers of the standard as they come from outside of the language, so that a wrong one has its return code.
//! The enumerations convert into these numbers.

use crate::return_code::ReturnCode;

/// SYSTEM_TIME: ns of module time, or a span in ns.
pub type SystemTime = i64;

/// No end: an unlimited time-out, no period, no deadline.
pub const INFINITE_TIME_VALUE: SystemTime = -1;
/// The lowest priority of a process.
pub const MIN_PRIORITY: i32 = 1;
/// The highest priority of a process. The error handler is above it.
pub const MAX_PRIORITY: i32 = 239;
/// How often the preemption lock or a mutex can be taken by its owner.
pub const MAX_LOCK_LEVEL: i32 = 16;
/// The most that a semaphore counts.
pub const MAX_SEMAPHORE_VALUE: i32 = 32_767;
/// Bytes of an error's or a report's text.
pub const MAX_ERROR_MESSAGE_SIZE: usize = 128;
/// Bytes of a name.
pub const MAX_NAME_LENGTH: usize = 32;
/// Processes of a partition.
pub const MAX_PROCESSES: usize = 128;
/// Objects of each class (buffers, blackboards, semaphores, events, mutexes).
pub const MAX_OBJECTS: usize = 256;
/// Ports of each class.
pub const MAX_PORTS: usize = 512;
/// Messages of a buffer or of a queuing port.
pub const MAX_MESSAGES: i32 = 512;
/// Bytes of a message.
pub const MAX_MESSAGE_SIZE: i32 = 8192;

/// No process.
pub const NULL_PROCESS_ID: ProcessId = ProcessId(0);
/// The main process, which initialises the partition.
pub const MAIN_PROCESS_ID: ProcessId = ProcessId(-1);
/// The process owns no mutex.
pub const NO_MUTEX_OWNED: MutexId = MutexId(-2);
/// Stands for the preemption lock where a mutex is named.
pub const PREEMPTION_LOCK_MUTEX: MutexId = MutexId(-3);
/// A process runs on any core of the partition.
pub const CORE_AFFINITY_NO_PREFERENCE: i32 = -1;
/// Every core of the partition, as the default of its processes (Part 2).
pub const CORE_AFFINITY_ANY: i32 = -2;

macro_rules! numbers {
    ($(#[$about:meta])* $name:ident { $($(#[$of:meta])* $variant:ident = $number:literal),+ $(,)? }) => {
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[repr(u32)]
        pub enum $name {
            $($(#[$of])* $variant = $number),+
        }

        impl From<$name> for u32 {
            fn from(value: $name) -> Self {
                value as Self
            }
        }

        impl TryFrom<u32> for $name {
            type Error = ReturnCode;

            fn try_from(number: u32) -> Result<Self, ReturnCode> {
                match number {
                    $($number => Ok(Self::$variant),)+
                    _ => Err(ReturnCode::InvalidParam),
                }
            }
        }
    };
}

numbers! {
    /// OPERATING_MODE of a partition.
    OperatingMode {
        /// No process runs.
        Idle = 0,
        /// Initialises.
        ColdStart = 1,
        /// Initialises, and finds what it retained.
        WarmStart = 2,
        /// Its processes run.
        Normal = 3,
    }
}

numbers! {
    /// START_CONDITION of a partition.
    StartCondition {
        /// The module was started.
        NormalStart = 0,
        /// The partition asked for it.
        PartitionRestart = 1,
        /// Health monitoring restarted the module.
        HmModuleRestart = 2,
        /// Health monitoring restarted the partition.
        HmPartitionRestart = 3,
    }
}

numbers! {
    /// PROCESS_STATE.
    ProcessState {
        /// Not started, or stopped.
        Dormant = 0,
        /// Could run.
        Ready = 1,
        /// Runs.
        Running = 2,
        /// Waits for something, or is suspended.
        Waiting = 3,
        /// Ended by a fault of its own, until somebody resumes or stops it.
        Faulted = 4,
    }
}

numbers! {
    /// DEADLINE: what a missed one means to the application. The executive treats both alike.
    Deadline {
        /// Late is bad.
        Soft = 0,
        /// Late is wrong.
        Hard = 1,
    }
}

numbers! {
    /// QUEUING_DISCIPLINE: the order in which waiting processes are served.
    QueuingDiscipline {
        /// By arrival.
        Fifo = 0,
        /// By priority, then by arrival.
        Priority = 1,
    }
}

numbers! {
    /// PORT_DIRECTION.
    PortDirection {
        /// Writes.
        Source = 0,
        /// Reads.
        Destination = 1,
    }
}

numbers! {
    /// VALIDITY of a sampling message.
    Validity {
        /// Older than the refresh period.
        Invalid = 0,
        /// Not older.
        Valid = 1,
    }
}

numbers! {
    /// UPDATED: what a sampling destination has for its partition (Part 2).
    Updated {
        /// Nothing was written yet.
        EmptyPort = 0,
        /// Nothing that was not read.
        ConsumedMessage = 1,
        /// A message that was not read.
        NewMessage = 2,
    }
}

numbers! {
    /// MESSAGE_AGE of a sampling message (Part 2).
    MessageAge {
        /// Older than the refresh period, or there is none.
        Stale = 0,
        /// Not older.
        Fresh = 1,
    }
}

numbers! {
    /// EMPTY_INDICATOR of a blackboard.
    EmptyIndicator {
        /// Displays nothing.
        Empty = 0,
        /// Displays a message.
        Occupied = 1,
    }
}

numbers! {
    /// EVENT_STATE.
    EventState {
        /// Who waits for it waits.
        Down = 0,
        /// Who waits for it goes on.
        Up = 1,
    }
}

numbers! {
    /// MUTEX_STATE.
    MutexState {
        /// Nobody owns it.
        Available = 0,
        /// Somebody does.
        Owned = 1,
    }
}

numbers! {
    /// What the partition's other cores do while the error handler runs.
    ErrorHandlerConcurrency {
        /// They halt.
        ProcessesPause = 0,
        /// They go on.
        ProcessesScheduled = 1,
    }
}

numbers! {
    /// ERROR_CODE.
    ErrorCode {
        /// A process was not done at its deadline.
        DeadlineMissed = 0,
        /// Raised by the application.
        ApplicationError = 1,
        /// Division by zero, overflow, and so on.
        NumericError = 2,
        /// A call that the process must not make.
        IllegalRequest = 3,
        /// The process used more stack than it has.
        StackOverflow = 4,
        /// An access to memory that is not there, or not the partition's.
        MemoryViolation = 5,
        /// Memory or a device is damaged.
        HardwareFault = 6,
        /// The supply fails.
        PowerFail = 7,
    }
}

impl ErrorCode {
    /// How many there are.
    pub const COUNT: usize = 8;

    /// The process that caused it can not go on as if nothing were.
    #[must_use]
    pub fn stops_its_process(self) -> bool {
        !matches!(self, Self::DeadlineMissed | Self::ApplicationError | Self::PowerFail)
    }
}

numbers! {
    /// MEMORY_BLOCK_MODE (Part 2).
    MemoryBlockMode {
        /// The partition reads it.
        Read = 0,
        /// The partition reads and writes it.
        ReadWrite = 1,
    }
}

numbers! {
    /// PORT_ACTION (Part 2): what a list does with a port of it.
    PortAction {
        /// It is passed over.
        Inactive = 0,
        /// It is served.
        Active = 1,
    }
}

numbers! {
    /// WRITE_STATUS (Part 2): what has become of a message of a logbook.
    WriteStatus {
        /// It was not written to its end, and has no content.
        Aborted = 0,
        /// It is on its way to the store.
        InProgress = 1,
        /// It is stored.
        Complete = 2,
    }
}

numbers! {
    /// RESET_LIST (Part 2): where the search of a list begins.
    ResetList {
        /// With its first port.
        Reset = 0,
        /// Behind the port that was served last.
        Continue = 1,
    }
}

/// Identifiers of one class: their numbers have the class in their upper bits, so that one of another class is unknown.
macro_rules! identifiers {
    ($($(#[$about:meta])* $name:ident = $class:literal),+ $(,)?) => {$(
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
        pub struct $name(pub i32);

        impl $name {
            const CLASS: i32 = $class << 12;

            pub(crate) fn of(index: usize) -> Self {
                Self(Self::CLASS + 1 + index as i32) // far fewer than 4096 of each class
            }

            pub(crate) fn index(self) -> Option<usize> {
                usize::try_from(self.0.checked_sub(Self::CLASS + 1)?).ok()
            }
        }
    )+};
}

identifiers! {
    /// Identifier of a process.
    ProcessId = 0,
    /// Identifier of a buffer.
    BufferId = 1,
    /// Identifier of a blackboard.
    BlackboardId = 2,
    /// Identifier of a semaphore.
    SemaphoreId = 3,
    /// Identifier of an event.
    EventId = 4,
    /// Identifier of a mutex.
    MutexId = 5,
    /// Identifier of a sampling port.
    SamplingPortId = 6,
    /// Identifier of a queuing port.
    QueuingPortId = 7,
    /// Identifier of a list of queuing ports (Part 2).
    QueuingPortListId = 8,
    /// Identifier of a logbook (Part 2).
    LogbookId = 9,
    /// Identifier of a name service (Part 2).
    NameServiceId = 10,
}

/// SAP_ADDRESS (Part 2): where a service access point is reached by UDP.
pub type SapAddress = std::net::SocketAddrV4;

/// NAME_TYPE: at most 32 bytes. Upper and lower case of ASCII letters are the same.
#[derive(Clone, Copy)]
pub struct Name {
    bytes: [u8; MAX_NAME_LENGTH],
    length: usize,
}

impl Name {
    /// `None` if `text` has more than 32 bytes.
    #[must_use]
    pub fn new(text: &str) -> Option<Self> {
        let mut bytes = [0; MAX_NAME_LENGTH];
        bytes.get_mut(..text.len())?.copy_from_slice(text.as_bytes());
        Some(Self { bytes, length: text.len() })
    }

    /// That of a C string in its array: it ends before the first zero byte, or with the array.
    #[must_use]
    pub fn of_array(bytes: [u8; MAX_NAME_LENGTH]) -> Self {
        let length = bytes.iter().position(|byte| *byte == 0).unwrap_or(MAX_NAME_LENGTH);
        Self { bytes, length }
    }

    /// Its bytes.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        &self.bytes[..self.length]
    }

    /// Equal also in case.
    #[must_use]
    pub fn is_exactly(&self, other: &Self) -> bool {
        self.as_bytes() == other.as_bytes()
    }
}

impl PartialEq for Name {
    fn eq(&self, other: &Self) -> bool {
        self.as_bytes().eq_ignore_ascii_case(other.as_bytes())
    }
}

impl Eq for Name {}

impl std::fmt::Debug for Name {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{:?}", String::from_utf8_lossy(self.as_bytes()))
    }
}

/// PROCESS_ATTRIBUTE.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProcessAttributes {
    /// Unique in the partition.
    pub name: Name,
    /// Where it begins: the driver's business.
    pub entry_point: usize,
    /// Bytes.
    pub stack_size: u32,
    /// 1 to 239, the highest is the most urgent.
    pub base_priority: i32,
    /// Time between two release points, ns; infinite: aperiodic.
    pub period: SystemTime,
    /// Time from the release to the deadline, ns; infinite: no deadline.
    pub time_capacity: SystemTime,
    /// What a missed deadline means.
    pub deadline: Deadline,
}

/// PROCESS_STATUS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ProcessStatus {
    /// Module time, ns; infinite: none.
    pub deadline_time: SystemTime,
    /// While the process owns a mutex, that of the mutex.
    pub current_priority: i32,
    /// What it does.
    pub state: ProcessState,
    /// As it was created.
    pub attributes: ProcessAttributes,
}

/// PARTITION_STATUS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PartitionStatus {
    /// Time between two period starts, ns.
    pub period: SystemTime,
    /// Time that the partition has in each period, ns.
    pub duration: SystemTime,
    /// Its number in the plan.
    pub identifier: i32,
    /// How often the preemption lock was taken.
    pub lock_level: i32,
    /// What it does.
    pub operating_mode: OperatingMode,
    /// Why it was started.
    pub start_condition: StartCondition,
    /// Cores that it may use.
    pub num_assigned_cores: i32,
}

/// BUFFER_STATUS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BufferStatus {
    /// Messages in it.
    pub nb_message: i32,
    /// Messages that it can hold.
    pub max_nb_message: i32,
    /// Bytes of a message.
    pub max_message_size: i32,
    /// Processes that wait at it.
    pub waiting_processes: i32,
}

/// BLACKBOARD_STATUS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct BlackboardStatus {
    /// Whether it displays a message.
    pub empty_indicator: EmptyIndicator,
    /// Bytes of a message.
    pub max_message_size: i32,
    /// Processes that wait at it.
    pub waiting_processes: i32,
}

/// SEMAPHORE_STATUS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SemaphoreStatus {
    /// Its count.
    pub current_value: i32,
    /// The highest count.
    pub maximum_value: i32,
    /// Processes that wait at it.
    pub waiting_processes: i32,
}

/// EVENT_STATUS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct EventStatus {
    /// Up or down.
    pub event_state: EventState,
    /// Processes that wait for it.
    pub waiting_processes: i32,
}

/// MUTEX_STATUS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MutexStatus {
    /// Its owner, or [`NULL_PROCESS_ID`].
    pub mutex_owner: ProcessId,
    /// Owned or available.
    pub mutex_state: MutexState,
    /// The priority of whoever owns it.
    pub mutex_priority: i32,
    /// How often its owner has taken it.
    pub lock_count: i32,
    /// Processes that wait for it.
    pub waiting_processes: i32,
}

/// SAMPLING_PORT_STATUS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SamplingPortStatus {
    /// The age up to which a message is valid, ns.
    pub refresh_period: SystemTime,
    /// Bytes of a message.
    pub max_message_size: i32,
    /// Source or destination.
    pub port_direction: PortDirection,
    /// Of the last read; invalid before the first.
    pub last_msg_validity: Validity,
}

/// SAMPLING_PORT_CURRENT_STATUS (Part 2).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SamplingPortCurrentStatus {
    /// The age up to which a message is valid.
    pub refresh_period: SystemTime,
    /// When the latest message was written; 0: there is none.
    pub time_stamp: SystemTime,
    /// Bytes of a message.
    pub max_message_size: i32,
    /// Source or destination.
    pub port_direction: PortDirection,
    /// Of this moment.
    pub message_age: MessageAge,
    /// Whether it was read.
    pub updated: Updated,
}

/// QUEUING_PORT_STATUS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct QueuingPortStatus {
    /// Messages on this side of the channel.
    pub nb_message: i32,
    /// Messages that it can hold.
    pub max_nb_message: i32,
    /// Bytes of a message.
    pub max_message_size: i32,
    /// Source or destination.
    pub port_direction: PortDirection,
    /// Processes that wait at it.
    pub waiting_processes: i32,
}

/// MEMORY_BLOCK_STATUS (Part 2).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MemoryBlockStatus {
    /// Where it begins.
    pub address: usize,
    /// What the partition may do with it.
    pub mode: MemoryBlockMode,
    /// Bytes.
    pub size: i32,
}

/// LOGBOOK_STATUS (Part 2).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LogbookStatus {
    /// Bytes of a message.
    pub max_message_size: i32,
    /// Messages that it keeps.
    pub max_logged: i32,
    /// Messages that may be on their way to the store.
    pub max_in_progress: i32,
    /// Messages that are stored.
    pub logged: i32,
    /// Messages that are on their way.
    pub in_progress: i32,
    /// Messages of both kinds that were aborted.
    pub aborted: i32,
}

/// A text of 128 bytes at most, kept in place.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct Text {
    bytes: [u8; MAX_ERROR_MESSAGE_SIZE],
    length: usize,
}

impl Text {
    /// `None` if there are more than 128 bytes.
    #[must_use]
    pub fn new(text: &[u8]) -> Option<Self> {
        let mut bytes = [0; MAX_ERROR_MESSAGE_SIZE];
        bytes.get_mut(..text.len())?.copy_from_slice(text);
        Some(Self { bytes, length: text.len() })
    }

    /// No byte.
    #[must_use]
    pub const fn empty() -> Self {
        Self { bytes: [0; MAX_ERROR_MESSAGE_SIZE], length: 0 }
    }

    /// Its bytes.
    #[must_use]
    pub fn as_bytes(&self) -> &[u8] {
        &self.bytes[..self.length]
    }
}

impl std::fmt::Debug for Text {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{:?}", String::from_utf8_lossy(self.as_bytes()))
    }
}

/// ERROR_STATUS.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ErrorStatus {
    /// What happened.
    pub error_code: ErrorCode,
    /// The process that it concerns; [`NULL_PROCESS_ID`] for none.
    pub failed_process_id: ProcessId,
    /// Of a fault: where; otherwise 0.
    pub failed_address: usize,
    /// The text of the one who raised it.
    pub message: Text,
}
