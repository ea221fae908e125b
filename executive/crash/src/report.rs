//! The report as it is written (JSON), and as it is read again.

use std::collections::BTreeMap;

use bateleur_contract::crash::PANIC;
use serde::{Deserialize, Serialize};

use crate::backtrace::Process;
use crate::captured::Captured;
use crate::frame::{Frame, Word};
use crate::sections::Binaries;

/// What the executive knows of a death.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Death {
    /// The partition.
    pub partition: String,
    /// Incarnations before this one.
    pub generation: u32,
    /// Module time, ns.
    pub time_ns: u64,
    /// The error of the health table.
    pub error: String,
    /// What the health log says beside it.
    pub detail: String,
    /// The partition's program.
    pub program: String,
    /// Its ports.
    pub ports: Vec<PortOf>,
}

/// A port of the partition.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PortOf {
    /// Its name.
    pub name: String,
    /// The port that its messages come from, `partition.port`.
    pub source: String,
}

/// What is known of the end of one process.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CrashReport {
    /// What the executive knows of it.
    #[serde(flatten)]
    pub death: Death,
    /// The signal, or `panic`.
    pub signal: String,
    /// What the kernel says of the signal beside its number, in words.
    pub reason: Option<String>,
    /// The address that a signal is about.
    pub address: Option<Word>,
    /// The process of ARINC 653 whose thread it was.
    pub process: Option<String>,
    /// The thread's number within the partition.
    pub thread: u64,
    /// It was the main thread.
    pub main_thread: bool,
    /// Whose registers they are.
    pub architecture: String,
    /// Their values, by their names.
    pub registers: BTreeMap<String, Word>,
    /// Bytes of the stack that were kept.
    pub stack_bytes: u64,
    /// The innermost first; `None`: it is not known yet, because its reader is at work, or has ended early.
    pub backtrace: Option<Vec<Frame>>,
}

impl CrashReport {
    /// Without a backtrace.
    #[must_use]
    pub fn new(death: Death, captured: &Captured) -> Self {
        let head = &captured.head;
        let code = head.code.cast_signed() as i32;
        let (signal, reason, has_address) = signal(head.signal, code);
        let names = captured.architecture.registers().iter();
        let registers = names.zip(head.registers).map(|(name, value)| ((*name).to_owned(), Word(value)));
        Self {
            death,
            signal,
            reason: reason.map(str::to_owned),
            address: has_address.then_some(Word(head.address)),
            process: Some(captured.name.clone()).filter(|name| !name.is_empty()),
            thread: head.thread,
            main_thread: head.thread == head.process,
            architecture: captured.architecture.name().into(),
            registers: registers.collect(),
            stack_bytes: captured.stack.len() as u64,
            backtrace: None,
        }
    }

    /// Finds the backtrace.
    pub fn trace(&mut self, captured: &Captured, binaries: &mut Binaries) {
        let process = Process::new(captured, binaries);
        self.backtrace = Some(process.frames(&process.addresses()));
    }

    /// Where the program was ended: the innermost function of its own.
    #[must_use]
    pub fn place(&self) -> Option<&Frame> {
        self.backtrace.as_ref()?.iter().find(|frame| !frame.runtime)
    }
}

/// A signal's name, what its code means, and whether it is about an address.
fn signal(number: u64, code: i32) -> (String, Option<&'static str>, bool) {
    let sent = (code <= 0).then_some("sent by a process");
    let (name, words): (_, &[&str]) = match number {
        PANIC => return ("panic".into(), None, false),
        4 => (
            "SIGILL",
            &[
                "illegal opcode",
                "illegal operand",
                "illegal addressing mode",
                "illegal trap",
                "privileged opcode",
                "privileged register",
            ],
        ),
        6 => ("SIGABRT", &[]),
        7 => (
            "SIGBUS",
            &[
                "misaligned address",
                "no such memory",
                "a device's error",
                "damaged memory was touched",
                "damaged memory was found",
            ],
        ),
        8 => (
            "SIGFPE",
            &[
                "integer division by zero",
                "integer overflow",
                "division of floats by zero",
                "overflow of a float",
                "underflow of a float",
                "inexact result of floats",
                "invalid operation on floats",
            ],
        ),
        11 => ("SIGSEGV", &["nothing is mapped there", "the mapping does not allow it"]),
        other => return (format!("signal {other}"), sent, false),
    };
    let known = usize::try_from(code).ok().and_then(|code| words.get(code.checked_sub(1)?)).copied();
    // An address that no processor has is told without one (SI_KERNEL).
    let kernels = (number == 11 && code == 0x80).then_some("no address of the processor's");
    (name.into(), sent.or(known).or(kernels), known.is_some() && number != 6)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signals_are_told_with_what_the_kernel_says_of_them() {
        assert_eq!(signal(11, 1), ("SIGSEGV".into(), Some("nothing is mapped there"), true));
        assert_eq!(signal(8, 1), ("SIGFPE".into(), Some("integer division by zero"), true));
        assert_eq!(signal(6, -6), ("SIGABRT".into(), Some("sent by a process"), false));
        assert_eq!(signal(11, i32::MAX), ("SIGSEGV".into(), None, false));
        assert_eq!(signal(PANIC, 0), ("panic".into(), None, false));
        assert_eq!(signal(u64::MAX, 0).0, format!("signal {}", u64::MAX));
    }

    #[test]
    fn report_is_read_as_it_was_written() {
        let frame = Frame { address: u64::MAX, offset: Some(1), line: Some(7), ..Frame::default() };
        let report = CrashReport {
            registers: [("rip".into(), Word(u64::MAX))].into(),
            address: Some(Word(8)),
            backtrace: Some(vec![frame, Frame::default()]),
            ..CrashReport::default()
        };
        let text = serde_json::to_string(&report).unwrap();
        assert!(text.contains("\"rip\":\"0xffffffffffffffff\""), "{text}");
        assert_eq!(serde_json::from_str::<CrashReport>(&text).unwrap(), report);
    }
}
