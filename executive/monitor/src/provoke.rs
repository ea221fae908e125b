//! Provokes a fault: ends or stops the process as a signal would, orders the fault through the control page, or stalls the
//! dispatcher. What follows is found like any other fault; that nothing follows is said.

use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;

use rustix::process::Signal;

use crate::inject::Fault;
use bateleur_system::disposition::{self, Disposition};
use bateleur_system::wait;
use bateleur_time::window_record::WindowRecord;

/// Virtual clock: how long a signal with a handler may take to end a process, real time, ns. One that goes on costs that much.
const HANDLER_NS: u64 = 50_000_000;
/// As above, for the kernel to end one.
const DEATH_NS: u64 = 1_000_000_000;
/// Windows that a partition may close before a fault that ends or stops it has come to nothing: the one in which it was
/// ordered, and the one in which it is carried out, and one more.
const WINDOWS: u32 = 3;

/// Signals that the kernel sends a process for what it does itself. Who handles them has nothing to go on with.
const OF_FAULTS: [i32; 7] = [4, 5, 6, 7, 8, 11, 31];

/// A process that the executive ends in the place of a signal. The first process of a PID namespace has no default actions
/// (pid_namespaces(7)), and only SIGKILL ends it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct InPlaceOf {
    pid: i32,
    signal: i32,
}

impl InPlaceOf {
    /// Process `pid` is ended in the place of `signal`.
    pub(crate) fn new(pid: i32, signal: i32) -> Self {
        Self { pid, signal }
    }

    /// How process `pid`, which has ended with `status`, would have ended.
    pub(crate) fn status(self, pid: i32, status: ExitStatus) -> ExitStatus {
        match self.pid == pid && status.signal() == Some(Signal::KILL.as_raw()) {
            true => ExitStatus::from_raw(self.signal),
            false => status,
        }
    }
}

/// A fault that was ordered and is to end or stop its partition.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Ordered {
    fault: Fault,
    closed: u32,
}

impl Ordered {
    /// `None` if the fault leaves its partition running.
    pub(crate) fn new(fault: Fault, ends_or_stops: bool) -> Option<Self> {
        ends_or_stops.then_some(Self { fault, closed: 0 })
    }

    /// Takes notice of a window; the fault where it has come to nothing.
    pub(crate) fn judge(&mut self, record: &WindowRecord) -> Option<Fault> {
        self.closed += u32::from(record.closed_ns.is_some());
        (self.closed >= WINDOWS).then_some(self.fault)
    }
}

/// How a signal gets to a process.
pub(crate) enum Way {
    /// It is sent.
    Sent(Signal),
    /// It is sent, and the process has a handler for it.
    Handled(Signal),
    /// SIGKILL is sent in its place.
    InPlaceOf(i32),
}

/// What is done so that signal `number` does to process `pid` what it does to a process in no namespace.
pub(crate) fn way(pid: i32, number: i32) -> Result<Way, String> {
    let signal = Signal::from_named_raw(number).ok_or("there is no such signal")?;
    match signal {
        Signal::KILL | Signal::STOP => Ok(Way::Sent(signal)),
        Signal::CONT if wait::is_stopped(pid) => Ok(Way::Sent(signal)),
        Signal::CONT => Err("it is not stopped".into()),
        _ if OF_FAULTS.contains(&number) => Ok(Way::InPlaceOf(number)),
        _ => match disposition::of(pid, number) {
            Disposition::Ignored => Err(format!("it ignores {}", Fault::Signal(number))),
            Disposition::Handled => Ok(Way::Handled(signal)),
            Disposition::Default => Ok(Way::InPlaceOf(number)),
        },
    }
}

impl Way {
    /// What is sent, and how long the process may take to end of it on the virtual clock, real time, ns.
    pub(crate) fn signal(&self) -> (Signal, u64) {
        match self {
            Self::Sent(Signal::KILL) | Self::InPlaceOf(_) => (Signal::KILL, DEATH_NS),
            Self::Sent(signal) => (*signal, 0),
            Self::Handled(signal) => (*signal, HANDLER_NS),
        }
    }
}
