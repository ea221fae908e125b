//! The crash memory as it is read.

use std::fs::File;
use std::os::unix::fs::FileExt;

use bateleur_contract::crash::{
    AARCH64, CrashHead, HEAD_BYTES, MAPS_AT, MAPS_BYTES, NAME_AT, NAME_BYTES, STACK_AT, STACK_BYTES, WHOLE,
    X86_64,
};

use crate::maps::{self, Mapping};

/// Why nothing can be made of a crash memory.
#[derive(Debug)]
pub enum Unreadable {
    /// The file can not be read.
    File(std::io::Error),
    /// The process has written nothing, or has ended in the midst of it.
    Incomplete,
    /// It names no architecture that is known.
    Architecture(u64),
}

impl std::fmt::Display for Unreadable {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::File(error) => write!(f, "the crash memory can not be read: {error}"),
            Self::Incomplete => f.write_str("the process has ended before it had written everything down"),
            Self::Architecture(number) => write!(f, "no architecture has number {number}"),
        }
    }
}

impl std::error::Error for Unreadable {}

/// Names of registers as they lie in the memory, the stack pointer and the instruction pointer among them.
const X86_64_NAMES: [&str; 18] = [
    "rax", "rdx", "rcx", "rbx", "rsi", "rdi", "rbp", "rsp", "r8", "r9", "r10", "r11", "r12", "r13", "r14",
    "r15", "rip", "rflags",
];
const AARCH64_NAMES: [&str; 34] = [
    "x0", "x1", "x2", "x3", "x4", "x5", "x6", "x7", "x8", "x9", "x10", "x11", "x12", "x13", "x14", "x15",
    "x16", "x17", "x18", "x19", "x20", "x21", "x22", "x23", "x24", "x25", "x26", "x27", "x28", "x29", "x30",
    "sp", "pc", "pstate",
];

/// Whose registers they are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Architecture {
    /// x86-64.
    X86_64,
    /// aarch64.
    Aarch64,
}

impl Architecture {
    /// As a word.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::X86_64 => "x86-64",
            Self::Aarch64 => "aarch64",
        }
    }

    /// The names of its registers, in their order.
    #[must_use]
    pub fn registers(self) -> &'static [&'static str] {
        match self {
            Self::X86_64 => &X86_64_NAMES,
            Self::Aarch64 => &AARCH64_NAMES,
        }
    }
}

/// What a process has written down.
#[derive(Debug, Clone)]
pub struct Captured {
    /// Its head.
    pub head: CrashHead,
    /// Whose registers they are.
    pub architecture: Architecture,
    /// The name of the process of ARINC 653; empty: none was known.
    pub name: String,
    /// The stack from [`CrashHead::stack_from`] on.
    pub stack: Vec<u8>,
    /// The map of memory, as the kernel told it.
    pub maps: Vec<u8>,
    /// The same, by its lines.
    pub mappings: Vec<Mapping>,
}

impl Captured {
    /// Reads the memory of a process that has ended.
    ///
    /// # Errors
    /// See [`Unreadable`].
    pub fn read(memory: &File) -> Result<Self, Unreadable> {
        let mut bytes = vec![0; (MAPS_AT as usize) + MAPS_BYTES];
        let mut filled = 0;
        while filled < bytes.len() {
            match memory.read_at(&mut bytes[filled..], filled as u64) {
                Ok(0) => break,
                Ok(count) => filled += count,
                Err(error) if error.kind() == std::io::ErrorKind::Interrupted => {}
                Err(error) => return Err(Unreadable::File(error)),
            }
        }
        Self::of(&bytes)
    }

    /// As above, of the memory's bytes; what is missing is zero.
    ///
    /// # Errors
    /// See [`Unreadable`].
    pub fn of(bytes: &[u8]) -> Result<Self, Unreadable> {
        let part = |at: usize, length: usize| {
            let from = bytes.get(at..).unwrap_or_default();
            &from[..length.min(from.len())]
        };
        let mut head = [0; HEAD_BYTES];
        let found = part(0, HEAD_BYTES);
        head[..found.len()].copy_from_slice(found);
        let head = CrashHead::from_bytes(&head);
        if head.state != WHOLE {
            return Err(Unreadable::Incomplete);
        }
        let architecture = match head.architecture {
            X86_64 => Architecture::X86_64,
            AARCH64 => Architecture::Aarch64,
            other => return Err(Unreadable::Architecture(other)),
        };
        let bounded = |length: u64, most: usize| usize::try_from(length).unwrap_or(most).min(most);
        let name = part(NAME_AT as usize, NAME_BYTES).split(|byte| *byte == 0).next().unwrap_or_default();
        let maps = part(MAPS_AT as usize, bounded(head.maps_bytes, MAPS_BYTES)).to_vec();
        // An address range that would end beyond the last address ends there.
        let room = usize::try_from(u64::MAX - head.stack_from).unwrap_or(STACK_BYTES);
        let stack = part(STACK_AT as usize, bounded(head.stack_bytes, STACK_BYTES).min(room)).to_vec();
        Ok(Self {
            name: plain(&String::from_utf8_lossy(name)),
            mappings: maps::read(&maps),
            maps,
            stack,
            head,
            architecture,
        })
    }

    /// The instruction that ran.
    #[must_use]
    pub fn instruction(&self) -> u64 {
        match self.architecture {
            Architecture::X86_64 => self.head.registers[16],
            Architecture::Aarch64 => self.head.registers[32],
        }
    }

    /// The stack pointer.
    #[must_use]
    pub fn stack_pointer(&self) -> u64 {
        match self.architecture {
            Architecture::X86_64 => self.head.registers[7],
            Architecture::Aarch64 => self.head.registers[31],
        }
    }

    /// The word of the stack at `address`, if it was copied.
    #[must_use]
    pub fn word(&self, address: u64) -> Option<u64> {
        let at = usize::try_from(address.checked_sub(self.head.stack_from)?).ok()?;
        let bytes = self.stack.get(at..at.checked_add(8)?)?;
        Some(u64::from_le_bytes(bytes.try_into().ok()?))
    }
}

/// Without what a terminal would obey.
pub(crate) fn plain(text: &str) -> String {
    text.replace(char::is_control, "\u{fffd}")
}
