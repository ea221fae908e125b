//! One granted window.

use std::os::fd::AsFd;
use std::sync::atomic::Ordering::Relaxed;

use bateleur_contract::{Clock, ReportKind};
use rustix::event::{PollFd, PollFlags, Timespec, poll};

use crate::time::{Time, monotonic_ns};

/// A stretch of time that belongs to this partition.
#[derive(Debug)]
pub struct Window {
    time: Time,
    start_ns: u64,
    end_ns: u64,
    minor_frames: u64,
}

impl Window {
    pub(crate) fn granted(time: &Time) -> Self {
        let page = time.page();
        Self {
            time: time.clone(),
            start_ns: page.window_start_ns.load(Relaxed),
            end_ns: page.window_end_ns.load(Relaxed),
            minor_frames: page.minor_frames.load(Relaxed),
        }
    }

    /// Module time, ns.
    pub fn now_ns(&self) -> u64 {
        self.time.now_ns()
    }

    /// The instant at which the schedule starts this window, module time, ns.
    pub fn start_ns(&self) -> u64 {
        self.start_ns
    }

    /// The instant at which the schedule takes the processor away, module time, ns.
    pub fn end_ns(&self) -> u64 {
        self.end_ns
    }

    /// Minor frames since module time 0.
    pub fn minor_frames(&self) -> u64 {
        self.minor_frames
    }

    /// Length of the minor frame, ns.
    pub fn minor_frame_ns(&self) -> u64 {
        self.time.page().minor_frame_ns.load(Relaxed)
    }

    /// Waits until `device` has something to read, at the longest until module time `until_ns`. False: nothing came.
    pub fn wait_readable(&self, device: &impl AsFd, until_ns: u64) -> bool {
        let until_ns = until_ns.min(self.end_ns);
        match self.time.clock() {
            Clock::Virtual => self.time.be_patient(|patience_ns| wait(device, monotonic_ns() + patience_ns)),
            Clock::Wall => wait(device, self.time.page().origin_ns.load(Relaxed) + until_ns),
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
}

/// Polls until `deadline_ns` on CLOCK_MONOTONIC. A freeze between two windows can interrupt the call: it goes on.
fn wait(device: &impl AsFd, deadline_ns: u64) -> bool {
    loop {
        let left_ns = deadline_ns.saturating_sub(monotonic_ns());
        let left =
            Timespec { tv_sec: (left_ns / 1_000_000_000) as i64, tv_nsec: (left_ns % 1_000_000_000) as i64 };
        match poll(&mut [PollFd::new(device, PollFlags::IN)], Some(&left)) {
            Ok(0) => return false,
            Ok(_) => return true,
            Err(rustix::io::Errno::INTR) if left_ns > 0 => {}
            Err(_) => return false,
        }
    }
}
