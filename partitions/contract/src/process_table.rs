//! The process table: what a partition of several processes shows of them. Mapped by the executive and by that partition alone.
//!
//! The partition writes all of it and the executive believes none of it: what is read is bounded by the size of the table, and a
//! partition that writes nonsense is shown as nonsense. A change of the running process costs one word of a ring; the rest is written
//! once at the end of each window.
#![allow(unsafe_code)] // one `unsafe impl`, a promise about this type

use crate::mapping::SharedMemory;
use crate::page::ReportKind;
use crate::ring::{Ring, RingPlace};
use crate::sync::{AtomicU32, AtomicU64, Ordering, fence};

/// Places in the table: the error handler's, then those of 128 processes in the order of their identifiers.
pub const PLACES: usize = 129;
/// The place of the error handler.
pub const HANDLER_PLACE: u8 = 1;
/// Changes of the running process between two looks of the executive, and one; older ones are overwritten and counted as lost.
pub const SWITCHES: usize = if cfg!(feature = "model") { 2 } else { 2048 };
/// Errors that the partition's error handler was told of between two looks of the executive; older ones are overwritten and counted as
/// lost.
pub const TOLD_ERRORS: usize = if cfg!(feature = "model") { 1 } else { 64 };
/// Bytes of a process's name.
const NAME: usize = 32;

/// In a switch: the place, below its instant.
const PLACE_BITS: u32 = 8;

/// A process's state (ARINC 653 numbers).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum ProcessState {
    /// Not started, or stopped.
    Dormant = 0,
    /// Able to run.
    Ready = 1,
    /// Runs, or goes on in the partition's next window.
    Running = 2,
    /// Waits.
    Waiting = 3,
    /// Stopped by a fault.
    Faulted = 4,
}

impl ProcessState {
    /// The state with this number.
    #[must_use]
    pub fn from_number(number: u32) -> Option<Self> {
        [Self::Dormant, Self::Ready, Self::Running, Self::Waiting, Self::Faulted]
            .into_iter()
            .find(|state| *state as u32 == number)
    }

    /// As a word.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Dormant => "dormant",
            Self::Ready => "ready",
            Self::Running => "running",
            Self::Waiting => "waiting",
            Self::Faulted => "faulted",
        }
    }
}

/// One process at the end of a window.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct ProcessRow {
    /// Its name.
    pub name: String,
    /// A [`ProcessState`].
    pub state: u32,
    /// Its base priority.
    pub base_priority: u32,
    /// Its present priority.
    pub priority: u32,
    /// From one release to the next, ns; 0: it is not periodic.
    pub period_ns: u64,
    /// From a release to its deadline, ns; 0: none.
    pub capacity_ns: u64,
    /// Its present deadline, module time, ns; 0: none.
    pub deadline_ns: u64,
    /// Module time for which it has run so far, ns.
    pub run_ns: u64,
    /// How often it was let run so far.
    pub switches: u32,
    /// Its starts so far.
    pub starts: u32,
    /// Its errors so far.
    pub errors: u32,
    /// Bytes of its stack; 0: not known.
    pub stack: u32,
    /// The most of them that it has used; 0: not known.
    pub stack_used: u32,
}

/// A row as it lies in the table.
#[derive(Debug, Default)]
#[repr(C)]
struct Row {
    name: [AtomicU64; NAME / 8],
    state: AtomicU32,
    /// The base priority, and the present one in the upper half.
    priority: AtomicU32,
    period_ns: AtomicU64,
    capacity_ns: AtomicU64,
    deadline_ns: AtomicU64,
    run_ns: AtomicU64,
    switches: AtomicU32,
    starts: AtomicU32,
    errors: AtomicU32,
    stack: AtomicU32,
    stack_used: AtomicU32,
    reserved: AtomicU32,
}

/// A change of the running process.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Switch {
    /// Module time, ns.
    pub time_ns: u64,
    /// Who runs from then on: 0 nobody, 1 the error handler, from 2 on the processes.
    pub place: u8,
}

/// An error that the partition's error handler was told of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ToldError {
    /// What it is.
    pub kind: ReportKind,
    /// Whose: 0 the main process's, 1 the error handler's, from 2 on the processes'.
    pub place: u8,
}

/// As it lies in the table.
#[derive(Debug, Default)]
#[repr(C)]
struct ErrorPlace {
    sequence: AtomicU32,
    /// The place, below the kind.
    word: AtomicU32,
}

impl RingPlace for ErrorPlace {
    fn sequence(&self) -> &AtomicU32 {
        &self.sequence
    }
}

/// See the module's head.
#[derive(Debug)]
#[repr(C, align(4096))]
pub struct ProcessTable {
    /// Odd while rows are written.
    writing: AtomicU32,
    /// Processes, the error handler apart.
    processes: AtomicU32,
    /// Switches so far.
    switched: AtomicU32,
    /// Errors told so far, see [`Ring`].
    errors_told: AtomicU32,
    rows: [Row; PLACES],
    switches: [AtomicU64; SWITCHES],
    errors: [ErrorPlace; TOLD_ERRORS],
}

// SAFETY: every field is an atomic or an array of atomics, for which every bit pattern is a value.
unsafe impl SharedMemory for ProcessTable {}

impl ProcessTable {
    /// Forgets the processes of an incarnation before (the executive). The count of switches goes on.
    pub fn forget(&self) {
        self.processes.store(0, Ordering::Relaxed);
        self.writing.store(0, Ordering::Relaxed);
        self.error_ring().forget_unfinished();
    }

    /// The error handler was told of an error (the partition, any of its threads).
    pub fn tell_error(&self, error: ToldError) {
        let word = (error.kind as u32) << PLACE_BITS | u32::from(error.place);
        self.error_ring().add(|place| place.word.store(word, Ordering::Relaxed));
    }

    /// Errors told so far (the executive).
    pub fn errors_told(&self) -> u32 {
        self.errors_told.load(Ordering::Acquire)
    }

    /// The next error since number `seen` (the executive), which is moved on, and `lost` by as many as were overwritten before they were
    /// read.
    pub fn error_since(&self, seen: &mut u32, lost: &mut u64) -> Option<ToldError> {
        let word = self.error_ring().next(seen, lost, |place| place.word.load(Ordering::Relaxed))?;
        Some(ToldError { kind: ReportKind::from_word(word >> PLACE_BITS), place: word as u8 })
    }

    fn error_ring(&self) -> Ring<'_, ErrorPlace> {
        Ring { count: &self.errors_told, places: &self.errors }
    }

    /// Notes who runs from `time_ns` on (the partition, one thread at a time).
    pub fn switch(&self, switch: Switch) {
        let count = self.switched.load(Ordering::Relaxed);
        // Whoever reads the word that follows in the place of an old one finds the count of before at least.
        fence(Ordering::Release);
        let word = switch.time_ns << PLACE_BITS | u64::from(switch.place);
        self.switches[count as usize % SWITCHES].store(word, Ordering::Relaxed);
        self.switched.store(count.wrapping_add(1), Ordering::Release);
    }

    /// Switches so far.
    pub fn switched(&self) -> u32 {
        self.switched.load(Ordering::Acquire)
    }

    /// Gives the switches since number `seen` (the executive), which is moved on, to `each`; how many were overwritten before they
    /// were read. Takes no more than the ring has places, whatever the partition does meanwhile.
    pub fn switches_since(&self, seen: &mut u32, mut each: impl FnMut(Switch)) -> u32 {
        let until = self.switched();
        let waiting = until.wrapping_sub(*seen);
        let mut lost = waiting.saturating_sub(SWITCHES as u32);
        let first = seen.wrapping_add(lost);
        *seen = until;
        for number in 0..waiting - lost {
            let place = first.wrapping_add(number);
            let word = self.switches[place as usize % SWITCHES].load(Ordering::Relaxed);
            fence(Ordering::Acquire);
            // The place may be the next one's by now, and its word a later switch's.
            if self.switched.load(Ordering::Relaxed).wrapping_sub(place) >= SWITCHES as u32 {
                lost += 1;
                continue;
            }
            each(Switch { time_ns: word >> PLACE_BITS, place: word as u8 });
        }
        lost
    }

    /// Writes the rows (the partition): the error handler's, if it has one, and those of its processes.
    pub fn write<'r>(
        &self,
        handler: Option<&ProcessRow>,
        processes: impl ExactSizeIterator<Item = &'r ProcessRow>,
    ) {
        let writing = self.writing.load(Ordering::Relaxed) | 1;
        self.writing.store(writing, Ordering::Relaxed);
        fence(Ordering::Release);
        self.processes.store(processes.len() as u32, Ordering::Relaxed);
        self.rows[0].name[0].store(u64::from(handler.is_some()), Ordering::Relaxed);
        if let Some(handler) = handler {
            self.rows[0].write(handler);
        }
        self.rows[1..].iter().zip(processes).for_each(|(row, process)| row.write(process));
        self.writing.store(writing.wrapping_add(1), Ordering::Release);
    }

    /// The rows at the end of the last window, the error handler's first (the executive). Where the partition writes all the time,
    /// rows of two moments are mixed.
    pub fn read(&self) -> (Option<ProcessRow>, Vec<ProcessRow>) {
        let mut found = self.try_read();
        for _ in 0..LOOKS {
            let before = self.writing.load(Ordering::Acquire);
            found = self.try_read();
            fence(Ordering::Acquire);
            if before.is_multiple_of(2) && self.writing.load(Ordering::Relaxed) == before {
                break;
            }
        }
        found
    }

    fn try_read(&self) -> (Option<ProcessRow>, Vec<ProcessRow>) {
        let processes = (self.processes.load(Ordering::Relaxed) as usize).min(PLACES - 1);
        let has_handler = processes > 0 && self.rows[0].name[0].load(Ordering::Relaxed) != 0;
        let handler = has_handler.then(|| ProcessRow { name: HANDLER_NAME.into(), ..self.rows[0].read() });
        (handler, self.rows[1..=processes].iter().map(Row::read).collect())
    }

    /// What whoever runs at a place is called; `None`: nobody is known there.
    pub fn name_at(&self, place: u8) -> Option<String> {
        match place {
            0 => None,
            HANDLER_PLACE => Some(HANDLER_NAME.into()),
            place => self.rows.get(usize::from(place) - 1).map(Row::name).filter(|name| !name.is_empty()),
        }
    }
}

/// What the error handler is called, which has no name.
pub const HANDLER_NAME: &str = "error handler";

/// How often rows are read that change meanwhile.
const LOOKS: usize = 3;

impl Row {
    fn write(&self, row: &ProcessRow) {
        let mut bytes = [0; NAME];
        let length = row.name.len().min(NAME);
        bytes[..length].copy_from_slice(&row.name.as_bytes()[..length]);
        if row.name != HANDLER_NAME {
            for (word, chunk) in self.name.iter().zip(bytes.as_chunks().0) {
                word.store(u64::from_le_bytes(*chunk), Ordering::Relaxed);
            }
        }
        let store = |place: &AtomicU32, value: u32| place.store(value, Ordering::Relaxed);
        let store_long = |place: &AtomicU64, value: u64| place.store(value, Ordering::Relaxed);
        store(&self.state, row.state);
        store(&self.priority, row.base_priority & 0xffff | row.priority << 16);
        store_long(&self.period_ns, row.period_ns);
        store_long(&self.capacity_ns, row.capacity_ns);
        store_long(&self.deadline_ns, row.deadline_ns);
        store_long(&self.run_ns, row.run_ns);
        store(&self.switches, row.switches);
        store(&self.starts, row.starts);
        store(&self.errors, row.errors);
        store(&self.stack, row.stack);
        store(&self.stack_used, row.stack_used);
    }

    /// Without characters that a line of a log, a cell of a table or a terminal could take for its own.
    fn name(&self) -> String {
        let mut bytes = [0; NAME];
        for (word, chunk) in self.name.iter().zip(bytes.as_chunks_mut::<8>().0) {
            *chunk = word.load(Ordering::Relaxed).to_le_bytes();
        }
        let length = bytes.iter().position(|byte| *byte == 0).unwrap_or(NAME);
        let plain = |character: char| match character {
            ',' | '"' | '\u{fffd}' => '_',
            other if other.is_control() => '_',
            other => other,
        };
        String::from_utf8_lossy(&bytes[..length]).chars().map(plain).collect()
    }

    fn read(&self) -> ProcessRow {
        let (word, long) = (
            |place: &AtomicU32| place.load(Ordering::Relaxed),
            |place: &AtomicU64| place.load(Ordering::Relaxed),
        );
        let priority = word(&self.priority);
        ProcessRow {
            name: self.name(),
            state: word(&self.state),
            base_priority: priority & 0xffff,
            priority: priority >> 16,
            period_ns: long(&self.period_ns),
            capacity_ns: long(&self.capacity_ns),
            deadline_ns: long(&self.deadline_ns),
            run_ns: long(&self.run_ns),
            switches: word(&self.switches),
            starts: word(&self.starts),
            errors: word(&self.errors),
            stack: word(&self.stack),
            stack_used: word(&self.stack_used),
        }
    }
}

#[cfg(not(feature = "model"))]
#[cfg(test)]
mod tests {
    use std::os::unix::fs::FileExt;

    use rustix::fs::{MemfdFlags, ftruncate, memfd_create};

    use super::*;
    use crate::mapping::Mapped;

    fn table() -> (std::fs::File, Mapped<ProcessTable>) {
        let file = memfd_create("processes", MemfdFlags::CLOEXEC).unwrap();
        ftruncate(&file, size_of::<ProcessTable>() as u64).unwrap();
        let table = Mapped::new(&file).unwrap();
        (file.into(), table)
    }

    fn row(name: &str, number: u32) -> ProcessRow {
        ProcessRow {
            name: name.into(),
            state: ProcessState::Waiting as u32,
            base_priority: 10 + number,
            priority: 239,
            period_ns: 20_000_000,
            capacity_ns: 5_000_000,
            deadline_ns: u64::from(number) << 40,
            run_ns: 77,
            switches: 5,
            starts: 1,
            errors: number,
            stack: 65_536,
            stack_used: 4_096,
        }
    }

    #[test]
    fn rows_come_back_as_they_were_written_with_names_of_32_bytes_and_128_processes() {
        let (_file, table) = table();
        assert_eq!(table.read(), (None, Vec::new()));
        let name = |number: u32| format!("process {number:024}");
        let rows: Vec<_> = (0..128).map(|number| row(&name(number), number)).collect();
        table.write(None, rows.iter());
        assert_eq!(table.read(), (None, rows.clone()));
        let handler = row(HANDLER_NAME, 3);
        table.write(Some(&handler), rows[..4].iter());
        assert_eq!(table.read(), (Some(handler), rows[..4].to_vec()));
        assert_eq!(table.name_at(5).as_deref(), Some(name(3).as_str()));
        assert_eq!(table.name_at(HANDLER_PLACE).as_deref(), Some(HANDLER_NAME));
        assert_eq!((table.name_at(0), table.name_at(255)), (None, None));
        table.forget();
        assert_eq!(table.read(), (None, Vec::new()), "of a predecessor");
    }

    #[test]
    fn switches_are_read_once_in_order_and_those_that_found_no_place_are_counted() {
        let (_file, table) = table();
        let mut seen = 0;
        let mut read = |table: &ProcessTable| {
            let mut found = Vec::new();
            let lost = table.switches_since(&mut seen, |switch| found.push((switch.time_ns, switch.place)));
            (lost, found)
        };
        (0..3).for_each(|n| table.switch(Switch { time_ns: 1 << 50 | n, place: n as u8 }));
        assert_eq!(read(&table), (0, (0..3).map(|n| (1 << 50 | n, n as u8)).collect()));
        assert_eq!(read(&table), (0, Vec::new()));
        (0..SWITCHES as u64 + 5).for_each(|time_ns| table.switch(Switch { time_ns, place: 1 }));
        let (lost, found) = read(&table);
        assert_eq!((lost, found.len(), found[0]), (6, SWITCHES - 1, (6, 1)));
    }

    #[test]
    fn told_errors_are_read_once_in_order_beside_those_that_found_no_place() {
        let (_file, table) = table();
        let told = |place| ToldError { kind: ReportKind::MemoryViolation, place };
        let (mut seen, mut lost) = (0, 0);
        (0..TOLD_ERRORS as u8 + 3).for_each(|place| table.tell_error(told(place)));
        for place in 3..TOLD_ERRORS as u8 + 3 {
            assert_eq!(table.error_since(&mut seen, &mut lost), Some(told(place)));
        }
        assert_eq!((table.error_since(&mut seen, &mut lost), lost), (None, 3));
        assert_eq!(table.errors_told(), seen);
    }

    #[test]
    fn table_that_was_written_over_is_read_within_its_bounds() {
        let (file, table) = table();
        let mut random = 7_u64;
        for round in 0..40 {
            let bytes: Vec<u8> = (0..size_of::<ProcessTable>())
                .map(|_| {
                    random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    if round == 0 { 0xff } else { (random >> 56) as u8 }
                })
                .collect();
            file.write_all_at(&bytes, 0).unwrap();
            let (_, rows) = table.read();
            assert!(rows.len() < PLACES);
            for row in rows {
                assert!(!row.name.contains([',', '"', '\n', '\x1b', '\0']), "{:?}", row.name);
                let _ = ProcessState::from_number(row.state);
            }
            let (mut seen, mut count) = (round, 0);
            table.switches_since(&mut seen, |_| count += 1);
            assert!(count <= SWITCHES);
        }
    }
}
