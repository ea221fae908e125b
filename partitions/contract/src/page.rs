//! The control page: one for each partition, mapped by the executive and by that partition alone.
//!
//! The executive writes the upper half and trusts nothing that it reads from the lower half; a partition that
//! writes nonsense harms itself only. Every field is an atomic; the words that are slept on are `grant`, `done` and
//! `begin`.
//!
//! A window: the executive stores the window's data, increments `grant` and wakes it ([`ControlPage::publish_grant`]). The partition,
//! which sleeps on `grant`, takes a copy of the data ([`ControlPage::granted_window`]), computes, stores the grant's value in `done` and wakes who sleeps on it: the window is closed, the rest of
//! it is slack. A `done` that differs from `grant` at the window's end is an overrun.
#![allow(unsafe_code)] // one `unsafe impl`, a promise about this type

use crate::fault::{FaultKind, FaultOrder};
use crate::mapping::SharedMemory;
use crate::ring::{Ring, RingPlace};
use crate::sync::{AtomicU32, AtomicU64, Ordering, fence};

/// The page is one for the model checker, which wants few words.
const MODEL: bool = cfg!(feature = "model");

/// First word of every control page.
pub const MAGIC: u32 = 0x4254_4c52; // "BTLR"
/// Raised whenever the page or the description changes its meaning.
pub const VERSION: u32 = 15;

/// Bytes of a report's text, as in REPORT_APPLICATION_MESSAGE.
pub const REPORT_TEXT: usize = if MODEL { 8 } else { 128 };
/// Places for errors that wait for a partition's handler; older ones are overwritten.
pub const ERRORS: usize = if MODEL { 1 } else { 8 };
/// Entries of the health log that stand for a partition that is told of them; older ones are overwritten and counted as lost.
pub const NOTICES: usize = if MODEL { 1 } else { 8 };
/// Places for orders of faults between two windows of a partition; older ones are overwritten.
pub const FAULTS: usize = if MODEL { 1 } else { 8 };
/// Places for reports between two looks of the executive; older ones are overwritten.
pub const REPORTS: usize = if MODEL { 1 } else { 8 };

/// [`ControlPage::handling`]: the code that the process ends with is a mode that it has set itself (SET_PARTITION_MODE).
pub const OWN_REQUEST: u32 = 2;

/// [`ControlPage::device_expected`]: nobody counts what the world sends.
pub const NOT_COUNTED: u64 = u64::MAX;

/// The operating mode of a partition (ARINC 653 numbers).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Mode {
    /// Does not run.
    Idle = 0,
    /// Initialises, nothing kept.
    ColdStart = 1,
    /// Initialises, retained memory kept.
    WarmStart = 2,
    /// Runs.
    Normal = 3,
}

impl Mode {
    /// The mode with this number.
    pub fn from_number(number: u32) -> Option<Self> {
        [Self::Idle, Self::ColdStart, Self::WarmStart, Self::Normal]
            .into_iter()
            .find(|mode| *mode as u32 == number)
    }
}

/// What a process that stood by finds when it takes over.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum Takeover {
    /// The retained memory, as its predecessor left it.
    Warm = 1,
    /// Zeros.
    Cold = 2,
}

impl Takeover {
    /// The order with this number.
    pub fn from_number(number: u32) -> Option<Self> {
        [Self::Warm, Self::Cold].into_iter().find(|order| *order as u32 == number)
    }
}

/// What a report is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum ReportKind {
    /// REPORT_APPLICATION_MESSAGE: recorded, no error.
    Message = 0,
    /// RAISE_APPLICATION_ERROR: a health error.
    ApplicationError = 1,
    /// A port could not be read or written: a health error.
    PortError = 2,
    /// A process has missed its deadline: a health error, as all that follow.
    DeadlineMissed = 3,
    /// A process has computed what there is no number for.
    NumericError = 4,
    /// A process has asked for what it may not have.
    IllegalRequest = 5,
    /// A process has used more stack than it has.
    StackOverflow = 6,
    /// A process has touched memory that is not its partition's.
    MemoryViolation = 7,
    /// The machine has reported damage while a process ran.
    HardwareFault = 8,
    /// The first of three replicas is outvoted: a health error of that partition, reported by its voter.
    FirstOutvoted = 9,
    /// The second is.
    SecondOutvoted = 10,
    /// The third is.
    ThirdOutvoted = 11,
}

/// How a voter says that a replica is outvoted, by the replica's place.
const OUTVOTED: [ReportKind; REPLICAS] =
    [ReportKind::FirstOutvoted, ReportKind::SecondOutvoted, ReportKind::ThirdOutvoted];

/// Replicas of a partition that has any: the fewest with a majority against one.
pub const REPLICAS: usize = 3;

/// An error that a partition's own handler is told of. The first eight have the numbers of ARINC 653.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u32)]
pub enum ErrorCode {
    /// A window was closed after its deadline.
    DeadlineMissed = 0,
    /// The partition raised one itself.
    ApplicationError = 1,
    /// A port could not be read or written.
    PortError = 16,
    /// A window ended before the partition was done.
    WindowOverrun = 17,
}

impl ErrorCode {
    /// The code with this number.
    pub fn from_number(number: u32) -> Option<Self> {
        [Self::DeadlineMissed, Self::ApplicationError, Self::PortError, Self::WindowOverrun]
            .into_iter()
            .find(|code| *code as u32 == number)
    }
}

/// A report as the executive reads it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Reported {
    /// What it is.
    pub kind: ReportKind,
    /// Made while the partition's error handler ran.
    pub in_handler: bool,
    /// Its text.
    pub text: String,
}

/// In a report's kind: made while the error handler ran.
const IN_HANDLER: u32 = 1 << 16;

/// One report of a partition, or one error for it.
#[derive(Debug, Default)]
#[repr(C)]
struct Report {
    sequence: AtomicU32,
    /// Its kind, and the length of its text in the highest eight bits.
    kind: AtomicU32,
    text: [AtomicU64; REPORT_TEXT / 8],
}

/// See [`Report::kind`].
const LENGTH_SHIFT: u32 = 24;

/// An order of a fault.
#[derive(Debug, Default)]
#[repr(C)]
struct OrderedFault {
    sequence: AtomicU32,
    /// A [`FaultKind`].
    kind: AtomicU32,
    /// [`FaultOrder::port`].
    port: AtomicU32,
    /// [`FaultOrder::messages`].
    messages: AtomicU32,
    /// [`FaultOrder::argument`].
    argument: AtomicU64,
}

/// What a partition is told with a window.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct WindowGrant {
    /// Its start, module time, ns.
    pub start_ns: u64,
    /// Its end, module time, ns; 0: no window, but the last call before frame 0.
    pub end_ns: u64,
    /// Minor frames since module time 0, at its start.
    pub minor_frames: u64,
    /// Length of the minor frame, ns.
    pub minor_frame_ns: u64,
    /// Major frames since frame 0, at its start.
    pub major_frame: u64,
    /// When its major frame began, module time, ns.
    pub major_frame_ns: u64,
    /// Place in the plan of the schedule that it belongs to.
    pub schedule: u32,
    /// That of the next major frame, as it is known when the window is granted.
    pub next_schedule: u32,
    /// When the schedule took effect, module time, ns; 0: the module has not changed yet.
    pub schedule_since_ns: u64,
}

/// How a module's major frames lie to those that they follow, as a partition has found it.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct AlignmentReport {
    /// How much later than an own major frame one of the peer's begins, in own time, ns; negative: earlier. Whole major frames
    /// more or less say the same.
    pub peer_minus_own_ns: i64,
    /// The true value lies no further away, ns.
    pub uncertainty_ns: u32,
    /// Exchanges with the peer so far: a report that rests on no new one is not counted as news.
    pub exchanges: u32,
}

/// A report as the executive reads it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AlignmentTold {
    /// What was said.
    pub report: AlignmentReport,
    /// The own major frame that it speaks of: that of the window in which it was said.
    pub major_frame: u64,
}

/// The page. Offsets are part of the contract; reserved words are zero.
#[derive(Debug)]
#[cfg_attr(feature = "model", derive(Default))]
#[repr(C, align(4096))]
pub struct ControlPage {
    // Written by the executive.
    magic: AtomicU32,
    version: AtomicU32,
    /// Windows granted so far; the partition sleeps on it.
    pub grant: AtomicU32,
    /// 1 when the partition shall end instead of taking another window.
    pub stop: AtomicU32,
    /// 0 wall clock, 1 virtual clock.
    pub clock: AtomicU32,
    /// Orders a process that stands by to take over: 0 not yet, else a [`Takeover`]. It does so with the next grant.
    pub take_over: AtomicU32,
    /// Wall clock: the CLOCK_MONOTONIC instant of module time 0, ns.
    pub origin_ns: AtomicU64,
    /// Virtual clock: module time, ns.
    pub now_ns: AtomicU64,
    // The window of the newest grant, see [`WindowGrant`].
    window_start_ns: AtomicU64,
    window_end_ns: AtomicU64,
    minor_frames: AtomicU64,
    minor_frame_ns: AtomicU64,
    /// Bytes that the world has sent to the partition's device so far, or [`NOT_COUNTED`]. Under the virtual clock the
    /// partition's library waits for them, so that a slow line discipline can not change a flight.
    pub device_expected: AtomicU64,
    schedule: AtomicU32,
    next_schedule: AtomicU32,
    schedule_since_ns: AtomicU64,
    /// Faults ordered so far, see [`Ring`]. The partition's library carries them out at its next window's start.
    fault_orders: AtomicU32,
    /// The grant whose window is being written or was written last: differs from `grant` while it is written.
    granting: AtomicU32,
    /// Lets a spare begin: 0 not yet, else the number of its [`crate::StartCondition`]. It sleeps on this word.
    pub begin: AtomicU32,
    reserved_1: [AtomicU32; 3],
    /// 1 while the executive sleeps on `done`: a partition that closes its window wakes it then, and spares itself the
    /// call otherwise. See [`ControlPage::close`].
    pub awaited: AtomicU32,
    reserved_2: AtomicU32,
    // Written by the partition, on cache lines of its own.
    /// The last grant that the partition has used up; the executive sleeps on it.
    pub done: AtomicU32,
    /// A [`Mode`], set by the partition.
    pub mode: AtomicU32,
    /// CLOCK_MONOTONIC when the partition took the last window, ns.
    pub opened_ns: AtomicU64,
    /// CLOCK_MONOTONIC when the partition closed it, ns.
    pub closed_ns: AtomicU64,
    /// Bytes written to the partition's device so far.
    pub device_sent: AtomicU64,
    /// Bytes read from the partition's device so far, by all its incarnations.
    pub device_received: AtomicU64,
    /// Messages that the partition's ports refused so far.
    pub port_refusals: AtomicU64,
    /// The schedule that the partition asks for, and how often it has asked: see [`ControlPage::request_schedule`].
    schedule_request: AtomicU64,
    /// 1 when a spare has come as far as it may before it begins.
    pub waits: AtomicU32,
    reserved_3: AtomicU32,
    /// Reports so far, see [`Ring`].
    report_count: AtomicU32,
    /// Not zero while the partition's error handler runs, and while what it has asked for is carried out; [`OWN_REQUEST`] while what the
    /// partition itself has asked for is.
    pub handling: AtomicU32,
    reports: [Report; REPORTS],
    // Written by the executive.
    /// Errors for the partition's handler so far, see [`Ring`].
    error_count: AtomicU32,
    reserved_5: AtomicU32,
    errors: [Report; ERRORS],
    major_frame: AtomicU64,
    major_frame_ns: AtomicU64,
    // Written by the partition, where the plan lets it: see [`ControlPage::tell_alignment`].
    /// Odd while the words below are written.
    alignment_count: AtomicU32,
    alignment_exchanges: AtomicU32,
    alignment_uncertainty_ns: AtomicU32,
    reserved_6: AtomicU32,
    /// The bits of a signed number.
    alignment_ns: AtomicU64,
    alignment_frame: AtomicU64,
    // Written by the executive, where the plan lets the partition know.
    /// Entries of the health log so far, see [`Ring`]; their kind is their severity.
    notice_count: AtomicU32,
    reserved_7: AtomicU32,
    notices: [Report; NOTICES],
    // Written by the executive.
    faults: [OrderedFault; FAULTS],
}

// SAFETY: every field is an atomic or an array of atomics, for which every bit pattern is a value.
unsafe impl SharedMemory for ControlPage {}

#[cfg(not(feature = "model"))]
const _: () = assert!(size_of::<ControlPage>() == 4096);

impl ControlPage {
    /// Makes the page a valid one (the executive, once).
    pub fn initialise(&self) {
        self.version.store(VERSION, Ordering::Relaxed);
        self.device_expected.store(NOT_COUNTED, Ordering::Relaxed);
        self.magic.store(MAGIC, Ordering::Release);
    }

    /// Whether the page is one of this contract.
    pub fn is_valid(&self) -> bool {
        self.magic.load(Ordering::Acquire) == MAGIC && self.version.load(Ordering::Relaxed) == VERSION
    }

    /// Makes grant number `number` known, with its window (the executive). Who sleeps on `grant` is to be woken.
    pub fn publish_grant(&self, number: u32, window: &WindowGrant) {
        self.begin_grant(number);
        self.window_start_ns.store(window.start_ns, Ordering::Relaxed);
        self.window_end_ns.store(window.end_ns, Ordering::Relaxed);
        self.minor_frames.store(window.minor_frames, Ordering::Relaxed);
        self.minor_frame_ns.store(window.minor_frame_ns, Ordering::Relaxed);
        self.major_frame.store(window.major_frame, Ordering::Relaxed);
        self.major_frame_ns.store(window.major_frame_ns, Ordering::Relaxed);
        self.schedule.store(window.schedule, Ordering::Relaxed);
        self.next_schedule.store(window.next_schedule, Ordering::Relaxed);
        self.schedule_since_ns.store(window.schedule_since_ns, Ordering::Relaxed);
        self.grant.store(number, Ordering::Release);
    }

    fn begin_grant(&self, number: u32) {
        self.granting.store(number, Ordering::Relaxed);
        // Whoever reads one of the words that follow finds the number above when it looks again.
        fence(Ordering::Release);
    }

    /// The newest grant with its window (the partition): never one with a part of another's.
    pub fn granted_window(&self) -> (u32, WindowGrant) {
        loop {
            if let Some(granted) = self.try_granted_window() {
                return granted;
            }
            std::hint::spin_loop(); // the executive writes a few words
        }
    }

    /// As above; `None` if a newer one is being written.
    fn try_granted_window(&self) -> Option<(u32, WindowGrant)> {
        let number = self.grant.load(Ordering::Acquire);
        let window = WindowGrant {
            start_ns: self.window_start_ns.load(Ordering::Relaxed),
            end_ns: self.window_end_ns.load(Ordering::Relaxed),
            minor_frames: self.minor_frames.load(Ordering::Relaxed),
            minor_frame_ns: self.minor_frame_ns.load(Ordering::Relaxed),
            major_frame: self.major_frame.load(Ordering::Relaxed),
            major_frame_ns: self.major_frame_ns.load(Ordering::Relaxed),
            schedule: self.schedule.load(Ordering::Relaxed),
            next_schedule: self.next_schedule.load(Ordering::Relaxed),
            schedule_since_ns: self.schedule_since_ns.load(Ordering::Relaxed),
        };
        fence(Ordering::Acquire);
        (self.granting.load(Ordering::Relaxed) == number).then_some((number, window))
    }

    /// No grant yet after that of `number`, for a process that is about to start (the executive). Numbers go on from one process
    /// to the next: a late word of the one before closes no window of its successor. Of the last window the schedule stands.
    pub fn forget_grants(&self, number: u32) {
        self.begin_grant(number);
        self.grant.store(number, Ordering::Relaxed);
        self.done.store(number, Ordering::Relaxed);
        self.report_ring().forget_unfinished();
        self.error_ring().forget_unfinished();
        self.notice_ring().forget_unfinished();
        self.fault_ring().forget_unfinished();
    }

    /// Closes the window of grant number `grant` (the partition); true: somebody sleeps until then, and is to be woken.
    #[must_use]
    pub fn close(&self, grant: u32) -> bool {
        self.done.store(grant, Ordering::Release);
        // Before the question, as the executive says that it sleeps before it looks once more: one of the two sees the other.
        fence(Ordering::SeqCst);
        self.awaited.load(Ordering::Relaxed) != 0
    }

    /// Says that the executive is about to sleep on `done`; gives its value after that. [`ControlPage::awake`] afterwards.
    pub fn await_close(&self) -> u32 {
        self.awaited.store(1, Ordering::Relaxed);
        fence(Ordering::SeqCst);
        self.done.load(Ordering::Acquire)
    }

    /// Says that the executive does not sleep any more.
    pub fn awake(&self) {
        self.awaited.store(0, Ordering::Relaxed);
    }

    /// Asks for the schedule at place `schedule` of the plan (the partition). The executive looks at the window's end.
    pub fn request_schedule(&self, schedule: u32) {
        let count = self.schedule_request.load(Ordering::Relaxed) >> 32;
        let count = (count + 1) & u64::from(u32::MAX);
        self.schedule_request.store(count << 32 | u64::from(schedule), Ordering::Release);
    }

    /// The last request for a schedule (the executive): its number, 0 where there was none, and the place in the plan.
    pub fn schedule_requested(&self) -> (u32, u32) {
        let request = self.schedule_request.load(Ordering::Acquire);
        ((request >> 32) as u32, request as u32)
    }

    /// Forgets requests of an incarnation before (the executive).
    pub fn forget_schedule_request(&self) {
        self.schedule_request.store(0, Ordering::Relaxed);
    }

    /// Tells how the module's major frames lie to the peer's (the partition), as of the present window's major frame.
    pub fn tell_alignment(&self, report: &AlignmentReport) {
        let writing = self.alignment_count.load(Ordering::Relaxed) | 1; // odd also after a death in here
        self.alignment_count.store(writing, Ordering::Relaxed);
        fence(Ordering::Release);
        self.alignment_ns.store(report.peer_minus_own_ns.cast_unsigned(), Ordering::Relaxed);
        self.alignment_uncertainty_ns.store(report.uncertainty_ns, Ordering::Relaxed);
        self.alignment_exchanges.store(report.exchanges, Ordering::Relaxed);
        self.alignment_frame.store(self.major_frame.load(Ordering::Relaxed), Ordering::Relaxed);
        self.alignment_count.store(writing.wrapping_add(1), Ordering::Release);
    }

    /// What was told since number `seen` (the executive), which is moved on. `None`: nothing, or it is being written now.
    pub fn alignment_since(&self, seen: &mut u32) -> Option<AlignmentTold> {
        let count = self.alignment_count.load(Ordering::Acquire);
        if count == *seen || count % 2 == 1 {
            return None;
        }
        let told = AlignmentTold {
            report: AlignmentReport {
                peer_minus_own_ns: self.alignment_ns.load(Ordering::Relaxed).cast_signed(),
                uncertainty_ns: self.alignment_uncertainty_ns.load(Ordering::Relaxed),
                exchanges: self.alignment_exchanges.load(Ordering::Relaxed),
            },
            major_frame: self.alignment_frame.load(Ordering::Relaxed),
        };
        fence(Ordering::Acquire);
        if self.alignment_count.load(Ordering::Relaxed) != count {
            return None; // the next look finds the newer one
        }
        *seen = count;
        Some(told)
    }

    /// Orders a fault (the executive). Of those that were not carried out yet only the newest [`FAULTS`] still stand.
    pub fn order_fault(&self, order: &FaultOrder) {
        self.fault_ring().add(|fault| fault.write(order));
    }

    /// The next fault that was ordered since number `seen` (the partition), which is moved on. Of a flood the newest still stand.
    pub fn fault_since(&self, seen: &mut u32) -> Option<FaultOrder> {
        loop {
            // What is no kind was written over: the page is the partition's too.
            if let Some(order) = self.fault_ring().next(seen, &mut 0, OrderedFault::read)? {
                return Some(order);
            }
        }
    }

    /// Adds a report (the partition, any of its threads). Text beyond [`REPORT_TEXT`] bytes is cut.
    pub fn report(&self, kind: ReportKind, text: &str) {
        let in_handler = if self.handling.load(Ordering::Relaxed) == 0 { 0 } else { IN_HANDLER };
        self.report_ring().add(|report| report.write(kind as u32 | in_handler, text));
    }

    /// The reports since number `seen` (the executive), which is moved on. Of a flood the newest still stand.
    pub fn reports_since(&self, seen: &mut u32) -> Vec<Reported> {
        let next = || self.report_ring().next(seen, &mut 0, Report::read);
        // As many as there are places at most: a partition may go on reporting on another core.
        let found = std::iter::from_fn(next).take(REPORTS);
        let report = |(kind, text): (u32, String)| Reported {
            kind: ReportKind::from_word(kind),
            in_handler: kind & IN_HANDLER != 0,
            text,
        };
        found.map(report).collect()
    }

    /// Tells the partition's handler of an error (the executive). Text beyond [`REPORT_TEXT`] bytes is cut.
    pub fn raise(&self, code: ErrorCode, text: &str) {
        self.error_ring().add(|error| error.write(code as u32, text));
    }

    /// The next error since number `seen` (the partition), which is moved on. Of a flood the newest still stand.
    pub fn next_error(&self, seen: &mut u32) -> Option<(ErrorCode, String)> {
        loop {
            let (code, text) = self.error_ring().next(seen, &mut 0, Report::read)?;
            if let Some(code) = ErrorCode::from_number(code) {
                return Some((code, text));
            }
        }
    }

    /// Tells the partition of an entry of the health log (the executive). Text beyond [`REPORT_TEXT`] bytes is cut.
    pub fn notify(&self, severity: u32, text: &str) {
        self.notice_ring().add(|notice| notice.write(severity, text));
    }

    /// The next entry of the health log since number `seen` (the partition), with its severity. `seen` is moved on, and `lost`
    /// by as many as were overwritten before they were read.
    pub fn next_notice(&self, seen: &mut u32, lost: &mut u64) -> Option<(u32, String)> {
        self.notice_ring().next(seen, lost, Report::read)
    }

    /// Reports so far (the executive).
    pub fn reports_so_far(&self) -> u32 {
        self.report_count.load(Ordering::Acquire)
    }

    /// Errors for the handler so far (the partition, before its first window: those were its predecessor's).
    pub fn errors_so_far(&self) -> u32 {
        self.error_count.load(Ordering::Acquire)
    }

    fn report_ring(&self) -> Ring<'_, Report> {
        Ring { count: &self.report_count, places: &self.reports }
    }

    fn error_ring(&self) -> Ring<'_, Report> {
        Ring { count: &self.error_count, places: &self.errors }
    }

    fn notice_ring(&self) -> Ring<'_, Report> {
        Ring { count: &self.notice_count, places: &self.notices }
    }

    fn fault_ring(&self) -> Ring<'_, OrderedFault> {
        Ring { count: &self.fault_orders, places: &self.faults }
    }
}

impl RingPlace for OrderedFault {
    fn sequence(&self) -> &AtomicU32 {
        &self.sequence
    }
}

impl OrderedFault {
    fn write(&self, order: &FaultOrder) {
        self.kind.store(order.kind as u32, Ordering::Relaxed);
        self.port.store(order.port, Ordering::Relaxed);
        self.messages.store(order.messages, Ordering::Relaxed);
        self.argument.store(order.argument, Ordering::Relaxed);
    }

    /// `None` if it is of no known kind.
    fn read(&self) -> Option<FaultOrder> {
        Some(FaultOrder {
            kind: FaultKind::from_number(self.kind.load(Ordering::Relaxed))?,
            port: self.port.load(Ordering::Relaxed),
            messages: self.messages.load(Ordering::Relaxed),
            argument: self.argument.load(Ordering::Relaxed),
        })
    }
}

impl ReportKind {
    /// The replica at `place` is outvoted; `None`: there is no such place.
    pub fn outvoted(place: usize) -> Option<Self> {
        OUTVOTED.get(place).copied()
    }

    /// The place of the replica that is outvoted; `None`: it is about the partition that reports.
    pub fn outvoted_place(self) -> Option<usize> {
        OUTVOTED.iter().position(|kind| *kind == self)
    }

    /// What is no kind is an error all the same.
    pub(crate) fn from_word(word: u32) -> Self {
        match word & !IN_HANDLER {
            0 => Self::Message,
            2 => Self::PortError,
            3 => Self::DeadlineMissed,
            4 => Self::NumericError,
            5 => Self::IllegalRequest,
            6 => Self::StackOverflow,
            7 => Self::MemoryViolation,
            8 => Self::HardwareFault,
            9 => Self::FirstOutvoted,
            10 => Self::SecondOutvoted,
            11 => Self::ThirdOutvoted,
            _ => Self::ApplicationError,
        }
    }
}

impl RingPlace for Report {
    fn sequence(&self) -> &AtomicU32 {
        &self.sequence
    }
}

impl Report {
    fn write(&self, kind: u32, text: &str) {
        let length =
            (0..=text.len().min(REPORT_TEXT)).rev().find(|&end| text.is_char_boundary(end)).unwrap_or(0);
        let mut bytes = [0; REPORT_TEXT];
        bytes[..length].copy_from_slice(&text.as_bytes()[..length]);
        for (word, chunk) in self.text.iter().zip(bytes.as_chunks().0) {
            word.store(u64::from_le_bytes(*chunk), Ordering::Relaxed);
        }
        self.kind.store((length as u32) << LENGTH_SHIFT | kind, Ordering::Relaxed);
    }

    /// Its kind and its text.
    fn read(&self) -> (u32, String) {
        let mut bytes = [0; REPORT_TEXT];
        for (word, chunk) in self.text.iter().zip(bytes.as_chunks_mut::<8>().0) {
            *chunk = word.load(Ordering::Relaxed).to_le_bytes();
        }
        let kind = self.kind.load(Ordering::Relaxed);
        let length = ((kind >> LENGTH_SHIFT) as usize).min(REPORT_TEXT);
        let text = String::from_utf8_lossy(&bytes[..length]).into_owned();
        (kind & ((1 << LENGTH_SHIFT) - 1), text)
    }
}

#[cfg(not(feature = "model"))]
#[cfg(test)]
mod tests;

#[cfg(feature = "model")]
#[cfg(test)]
mod model;
