//! The closed sets of the schedule file: each member has one spelling, used in the file, in messages and in logs.

use serde::{Deserialize, Serialize};

/// A closed set of names that a file may say.
pub trait Closed: Copy + Sized + 'static {
    /// What the set is called in a message, such as `direction`.
    const WHAT: &'static str;
    /// Every member, in the order of the documentation.
    const ALL: &'static [Self];

    /// The one spelling of this member.
    fn name(self) -> &'static str;

    /// The member that is spelled so.
    fn from_name(name: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|member| member.name() == name)
    }
}

macro_rules! closed {
    ($(#[$doc:meta])* $set:ident, $what:literal { $($(#[$member_doc:meta])* $member:ident = $name:literal,)+ }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        pub enum $set { $($(#[$member_doc])* #[serde(rename = $name)] $member,)+ }

        impl Closed for $set {
            const WHAT: &'static str = $what;
            const ALL: &'static [Self] = &[$(Self::$member,)+];

            fn name(self) -> &'static str {
                match self { $(Self::$member => $name,)+ }
            }
        }

        impl std::fmt::Display for $set {
            fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                formatter.write_str(self.name())
            }
        }
    };
}

closed! {
    /// Which way a port carries messages, seen from its partition.
    Direction, "direction" {
        /// The partition writes.
        Source = "source",
        /// The partition reads.
        Destination = "destination",
    }
}

closed! {
    /// How a channel keeps messages.
    Kind, "kind" {
        /// The latest value only, with an age.
        Sampling = "sampling",
        /// Every message, in order, up to a depth.
        Queuing = "queuing",
    }
}

closed! {
    /// What a channel's ends can do to each other.
    #[derive(Default)]
    Isolation, "isolation" {
        /// They share its memory: who writes nonsense there may end the others.
        #[default]
        Shared = "shared",
        /// Each reads what the other alone can write.
        Sealed = "sealed",
        /// The same, and each message carries a checksum.
        Checked = "checked",
    }
}

impl Isolation {
    /// Whether the channel's memory can be written by one of its ends only.
    #[must_use]
    pub fn is_sealed(self) -> bool {
        self != Self::Shared
    }

    /// What a plan says that says nothing.
    pub(crate) fn is_default(&self) -> bool {
        !self.is_sealed()
    }
}

closed! {
    /// What a partition may find when it starts again.
    StartMode, "start" {
        /// Nothing of the incarnation before.
        Cold = "cold",
        /// Its retained memory, as it was left.
        Warm = "warm",
    }
}

closed! {
    /// Where the major frames of a module lie.
    ModuleClock, "clock" {
        /// Where its start has put them, on the machine's own clock.
        Monotonic = "monotonic",
        /// At multiples of their length on the machine's disciplined clock.
        Realtime = "realtime",
    }
}

closed! {
    /// By what datagrams travel between two modules.
    Transport, "transport" {
        /// UDP, from address to address.
        Udp = "udp",
        /// The distributed engine of that name.
        Zenoh = "zenoh",
    }
}

closed! {
    /// What waits behind a partition.
    Standby, "standby" {
        /// The next process, which waits before its start.
        Spare = "spare",
        /// A second process that has initialised and sleeps.
        Hot = "hot",
    }
}

closed! {
    /// A family of system calls that partitions have only where their plan names it.
    SystemCalls, "system_calls" {
        /// POSIX timers, `timerfd`, interval timers.
        Timers = "timers",
        /// Notification of changes to files.
        Inotify = "inotify",
        /// Pairs of connected sockets.
        LocalSockets = "local_sockets",
        /// Connections of TCP, where the partition has the network.
        Tcp = "tcp",
        /// The machine's CAN buses, where the partition has the network.
        Can = "can",
        /// System V objects and POSIX message queues.
        IpcObjects = "ipc_objects",
        /// Signals that carry a value.
        QueuedSignals = "queued_signals",
        /// Barriers, advice about memory, synchronisation of mappings.
        MemoryControl = "memory_control",
        /// Reserving, copying, linking files; their owner and mode.
        FileOperations = "file_operations",
    }
}

impl SystemCalls {
    /// What it costs others that a partition has them.
    #[must_use]
    pub fn cost(self) -> &'static str {
        match self {
            Self::Timers => "each timer that expires interrupts whoever has the processor then",
            Self::Inotify => {
                "watches are kept by the kernel beside the partition's memory, 128 instances at most"
            }
            Self::LocalSockets => "descriptors in flight are closed by the kernel at an instant of its own",
            Self::Tcp => {
                "the kernel keeps up to 64 KiB for each connection beside what sockets may hold, and what waits to be accepted"
            }
            Self::Can => "the kernel keeps the frames that wait in each socket beside the partition's memory",
            Self::IpcObjects => "the kernel removes what is left of them at an instant of its own",
            Self::QueuedSignals => "64 of them are kept by the kernel",
            Self::MemoryControl => {
                "barriers and some advice interrupt other processors and queue work in the kernel"
            }
            Self::FileOperations => "read-ahead makes the disk work, which others wait for",
        }
    }
}

closed! {
    /// What becomes of a partition that has used up its restarts.
    Exhausted, "then" {
        /// It keeps its windows and does nothing in them.
        Idle = "idle",
        /// It is ended, and the module is told.
        Stop = "stop",
    }
}

closed! {
    /// What can go wrong in a partition.
    PartitionError, "partition error" {
        /// It touched memory that is not its own (SIGSEGV, SIGBUS).
        MemoryViolation = "memory_violation",
        /// It divided by zero or overflowed (SIGFPE).
        NumericError = "numeric_error",
        /// It asked the kernel, or the processor, for what it may not have (SIGSYS, SIGILL).
        IllegalRequest = "illegal_request",
        /// It used more stack than it has.
        StackOverflow = "stack_overflow",
        /// The machine reported damage while it ran.
        HardwareFault = "hardware_fault",
        /// Another signal ended it.
        Killed = "killed",
        /// It ended by itself, whatever its exit code.
        Exit = "exit",
        /// It did not become ready in time.
        StartupTimeout = "startup_timeout",
        /// Its window ended before it was done.
        WindowOverrun = "window_overrun",
        /// It closed none of a number of windows in a row.
        Silence = "silence",
        /// It closed its window after its deadline.
        DeadlineMissed = "deadline_missed",
        /// It raised an error itself.
        ApplicationError = "application_error",
        /// It needed more memory than it was granted.
        MemoryLimit = "memory_limit",
        /// A port could not be read or written.
        PortError = "port_error",
        /// It is a replica, and what it wrote was not what the others wrote.
        Outvoted = "outvoted",
    }
}

closed! {
    /// What is done about an error in a partition.
    PartitionAction, "partition action" {
        /// It is logged, and nothing else.
        Ignore = "ignore",
        /// The partition keeps its windows and does nothing in them.
        Idle = "idle",
        /// The partition starts again and finds its retained memory.
        WarmRestart = "warm_restart",
        /// The partition starts again from nothing.
        ColdRestart = "cold_restart",
        /// The partition is ended, and the module is told.
        Stop = "stop",
    }
}

closed! {
    /// Where an error is dealt with.
    ErrorLevel, "level" {
        /// In the partition's own error handler.
        Process = "process",
        /// By the partition's health table.
        Partition = "partition",
        /// By the module's.
        Module = "module",
    }
}

closed! {
    /// What a partition was at when an error occurred.
    PartitionState, "state" {
        /// It initialised.
        Start = "start",
        /// It took windows.
        Normal = "normal",
        /// Its error handler ran.
        Handler = "handler",
    }
}

closed! {
    /// What becomes of a partition when the module changes to another schedule.
    ChangeAction, "change action" {
        /// It goes on where it was.
        Ignore = "ignore",
        /// It keeps its windows and does nothing in them.
        Idle = "idle",
        /// It starts again from nothing.
        ColdRestart = "cold_restart",
        /// It starts again and finds its retained memory.
        WarmRestart = "warm_restart",
    }
}

closed! {
    /// What becomes of the persistent health log when it is full.
    LogPolicy, "policy" {
        /// The oldest record makes room.
        Overwrite = "overwrite",
        /// The first records stay, new ones are dropped.
        Keep = "keep",
    }
}

closed! {
    /// What can go wrong in a module.
    ModuleError, "module error" {
        /// A window was switched too late.
        LateDispatcher = "late_dispatcher",
        /// A partition had no processor in its window, because somebody else had it.
        ProcessorTaken = "processor_taken",
        /// What the file says could not be set up on this machine.
        ConfigError = "config_error",
        /// The supply announced that it is going.
        PowerFail = "power_fail",
        /// A partition was ended.
        PartitionStopped = "partition_stopped",
        /// An error of a partition that is dealt with at this level.
        PartitionError = "partition_error",
        /// The major frames do not begin with those that they follow.
        SyncLost = "sync_lost",
        /// The executive's process has ended and was not to.
        ExecutiveDied = "executive_died",
        /// The executive's process, or one of its threads, gives no sign of life.
        ExecutiveHung = "executive_hung",
    }
}

closed! {
    /// What is done about an error in a module.
    ModuleAction, "module action" {
        /// It is logged, and nothing else.
        Ignore = "ignore",
        /// The module starts again, with every partition.
        Reset = "reset",
        /// The module ends, with every partition.
        Shutdown = "shutdown",
    }
}
