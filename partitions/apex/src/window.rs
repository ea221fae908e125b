//! One granted window.

use std::os::fd::AsFd;
use std::sync::atomic::Ordering::Relaxed;

use bateleur_contract::page::WindowGrant;
use bateleur_contract::{Clock, ReportKind};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use crate::time::{Time, monotonic_ns};

/// The short wait under the virtual clock, real time, ns: no peer that lives takes as long, even on a busy machine.
const SHORTLY_NS: u64 = 100_000_000;

/// A major frame.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct MajorFrame {
    /// Major frames since frame 0 before it.
    pub number: u64,
    /// When it began, module time, ns. No whole multiple of its length where the module follows another one's frames, or was
    /// reset.
    pub start_ns: u64,
}

/// A stretch of time that belongs to this partition.
#[derive(Debug)]
pub struct Window {
    time: Time,
    granted: WindowGrant,
}

impl Window {
    /// The newest grant's number, and its window.
    pub(crate) fn granted(time: &Time) -> (u32, Self) {
        let (number, granted) = time.page().granted_window();
        (number, Self { time: time.clone(), granted })
    }

    /// Module time, ns.
    pub fn now_ns(&self) -> u64 {
        self.time.now_ns()
    }

    /// The instant at which the schedule starts this window, module time, ns.
    pub fn start_ns(&self) -> u64 {
        self.granted.start_ns
    }

    /// The instant at which the schedule takes the processor away, module time, ns.
    pub fn end_ns(&self) -> u64 {
        self.granted.end_ns
    }

    /// Minor frames since module time 0.
    pub fn minor_frames(&self) -> u64 {
        self.granted.minor_frames
    }

    /// Length of the minor frame, ns.
    pub fn minor_frame_ns(&self) -> u64 {
        self.granted.minor_frame_ns
    }

    /// The major frame that this window lies in.
    pub fn major_frame(&self) -> MajorFrame {
        MajorFrame { number: self.granted.major_frame, start_ns: self.granted.major_frame_ns }
    }

    /// Waits until `device` has something to read, at the longest until module time `until_ns`. False: nothing came.
    pub fn wait_readable(&self, device: &impl AsFd, until_ns: u64) -> bool {
        self.wait(device, PollFlags::IN, until_ns)
    }

    /// As [`Window::wait_readable`], for a caller who will ask again when nothing came: where module time stands still while a device is
    /// waited for, a lost datagram must not cost all of the patience there is.
    pub fn wait_readable_shortly(&self, device: &impl AsFd, until_ns: u64) -> bool {
        self.time.before_wait();
        match self.time.clock() {
            Clock::Virtual => wait(device, PollFlags::IN, monotonic_ns() + SHORTLY_NS),
            Clock::Wall => self.wait(device, PollFlags::IN, until_ns),
        }
    }

    /// Waits until `device` takes bytes, or until its connection is made or refused, at the longest until module time
    /// `until_ns`. False: neither.
    pub fn wait_writable(&self, device: &impl AsFd, until_ns: u64) -> bool {
        self.wait(device, PollFlags::OUT, until_ns)
    }

    fn wait(&self, device: &impl AsFd, what: PollFlags, until_ns: u64) -> bool {
        self.time.before_wait();
        let until_ns = until_ns.min(self.granted.end_ns);
        match self.time.clock() {
            Clock::Virtual => {
                self.time.be_patient(|patience_ns| wait(device, what, monotonic_ns() + patience_ns))
            }
            Clock::Wall => wait(device, what, self.time.page().origin_ns.load(Relaxed) + until_ns),
        }
    }

    /// Sleeps until module time `until_ns`, at the longest to the window's end (TIMED_WAIT). Where module time stands still
    /// during a window, it returns at once.
    pub fn wait_until(&self, until_ns: u64) {
        if self.time.clock() == Clock::Wall {
            let until_ns = self.time.page().origin_ns.load(Relaxed) + until_ns.min(self.granted.end_ns);
            let now_ns = monotonic_ns();
            // A freeze between two windows makes it longer: the window is over then in any case.
            std::thread::sleep(std::time::Duration::from_nanos(until_ns.saturating_sub(now_ns)));
        }
    }

    /// Writes into the health log without raising an error (REPORT_APPLICATION_MESSAGE); 128 bytes at most.
    pub fn report(&self, text: &str) {
        self.time.page().report(ReportKind::Message, text);
    }

    /// Raises an application error (RAISE_APPLICATION_ERROR): the executive acts as its health table says.
    pub fn raise(&self, text: &str) {
        self.time.page().report(ReportKind::ApplicationError, text);
    }

    /// Says that the replica at `place` is outvoted, of a partition whose voter this one is: the health monitor does with that partition
    /// what the plan says of the error `outvoted`. Text over 128 bytes is cut off.
    pub fn outvote(&self, place: usize, text: &str) {
        if let Some(kind) = ReportKind::outvoted(place) {
            self.time.page().report(kind, text);
        }
    }
}

/// Polls until `deadline_ns` on CLOCK_MONOTONIC. A freeze between two windows can interrupt the call: it goes on.
fn wait(device: &impl AsFd, what: PollFlags, deadline_ns: u64) -> bool {
    loop {
        let left_ns = deadline_ns.saturating_sub(monotonic_ns());
        let left =
            Timespec { tv_sec: (left_ns / 1_000_000_000) as i64, tv_nsec: (left_ns % 1_000_000_000) as i64 };
        match poll(&mut [PollFd::new(device, what)], Some(&left)) {
            Ok(0) => return false,
            Ok(_) => return true,
            Err(rustix::io::Errno::INTR) if left_ns > 0 => {}
            Err(_) => return false,
        }
    }
}
