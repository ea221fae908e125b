//! Faults that a partition's library carries out when the executive orders them, so that every partition, the user's own
//! too, can be provoked. For tests: nothing in flight orders one.

/// The closed set of such faults.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u32)]
pub enum FaultKind {
    /// A Rust panic.
    Panic = 1,
    /// `abort`.
    Abort = 2,
    /// Ends by itself, with code 3.
    Exit = 3,
    /// Sleeps and never closes its window.
    Hang = 4,
    /// Computes without end.
    Spin = 5,
    /// Takes memory without end.
    Allocate = 6,
    /// Forks children that fork, up to a bound.
    ForkBomb = 7,
    /// Starts threads that compute without end.
    Threads = 8,
    /// Asks the kernel for things that a partition has no business with.
    IllegalCall = 9,
    /// Writes where nothing is mapped.
    NullWrite = 10,
    /// Writes random bytes over its own memory.
    WildWrite = 11,
    /// Writes random bytes over its control page.
    WildPage = 12,
    /// Writes random bytes over the port memory that it may write.
    WildPorts = 13,
    /// Recurses without end.
    StackOverflow = 14,
    /// Divides an integer by zero.
    DivideByZero = 15,
    /// Executes what is no instruction.
    IllegalInstruction = 16,
    /// Reads a page of a file behind the file's end.
    BusError = 17,
    /// The next messages of a source port are not sent.
    Drop = 18,
    /// They are sent later.
    Delay = 19,
    /// They are sent with wrong bits.
    Corrupt = 20,
    /// Says that it is done with its window, and computes on in the others'.
    RunOn = 21,
    /// They are the first of them, again and again.
    Stuck = 22,
    /// Each of their numbers is wrong by a tenth of itself and a tenth.
    Bias = 23,
    /// Two of their fields stand in each other's place.
    Swap = 24,
}

impl FaultKind {
    /// All of them.
    pub const ALL: [Self; 24] = [
        Self::Panic,
        Self::Abort,
        Self::Exit,
        Self::Hang,
        Self::Spin,
        Self::Allocate,
        Self::ForkBomb,
        Self::Threads,
        Self::IllegalCall,
        Self::NullWrite,
        Self::WildWrite,
        Self::WildPage,
        Self::WildPorts,
        Self::StackOverflow,
        Self::DivideByZero,
        Self::IllegalInstruction,
        Self::BusError,
        Self::Drop,
        Self::Delay,
        Self::Corrupt,
        Self::RunOn,
        Self::Stuck,
        Self::Bias,
        Self::Swap,
    ];

    /// Its word.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Panic => "panic",
            Self::Abort => "abort",
            Self::Exit => "exit",
            Self::Hang => "hang",
            Self::Spin => "spin",
            Self::Allocate => "allocate",
            Self::ForkBomb => "fork-bomb",
            Self::Threads => "threads",
            Self::IllegalCall => "illegal-call",
            Self::NullWrite => "null-write",
            Self::WildWrite => "wild-write",
            Self::WildPage => "wild-page",
            Self::WildPorts => "wild-ports",
            Self::StackOverflow => "stack-overflow",
            Self::DivideByZero => "divide-by-zero",
            Self::IllegalInstruction => "illegal-instruction",
            Self::BusError => "bus-error",
            Self::Drop => "drop",
            Self::Delay => "delay",
            Self::Corrupt => "corrupt",
            Self::RunOn => "run-on",
            Self::Stuck => "stuck",
            Self::Bias => "bias",
            Self::Swap => "swap",
        }
    }

    /// The kind with this number.
    pub fn from_number(number: u32) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| *kind as u32 == number)
    }

    /// The kind with this word.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name() == name)
    }

    /// The process closes no window after it, whatever it is and wherever it runs.
    pub const fn ends_or_stops(self) -> bool {
        matches!(
            self,
            Self::Panic
                | Self::Abort
                | Self::Exit
                | Self::Hang
                | Self::Spin
                | Self::NullWrite
                | Self::StackOverflow
                | Self::DivideByZero
                | Self::IllegalInstruction
                | Self::BusError
        )
    }

    /// It happens to the messages of a port, and not to the partition.
    pub const fn is_of_port(self) -> bool {
        matches!(self, Self::Drop | Self::Delay | Self::Corrupt | Self::Stuck | Self::Bias | Self::Swap)
    }
}

/// One ordered fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FaultOrder {
    /// What happens.
    pub kind: FaultKind,
    /// Faults of a port: the port's place in the description.
    pub port: u32,
    /// Faults of a port: how many messages.
    pub messages: u32,
    /// A delay: its length, ns. Otherwise the seed of what is random.
    pub argument: u64,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_and_words_are_unique_and_lead_back() {
        for (place, kind) in FaultKind::ALL.into_iter().enumerate() {
            assert_eq!(kind as usize, place + 1);
            assert_eq!(FaultKind::from_number(kind as u32), Some(kind));
            assert_eq!(FaultKind::from_name(kind.name()), Some(kind));
        }
    }
}
