//! Module time (GET_TIME).

use std::rc::Rc;
use std::sync::atomic::Ordering::Relaxed;

use bateleur_contract::{Clock, ControlPage, Mapped};
use rustix::time::{ClockId, clock_gettime};

/// The module's clock, as the executive gives it. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Time {
    page: Rc<Mapped<ControlPage>>,
    clock: Clock,
}

impl Time {
    pub(crate) fn new(page: Rc<Mapped<ControlPage>>, clock: Clock) -> Self {
        Self { page, clock }
    }

    /// Time since the start of frame 0, ns. Never decreases.
    pub fn now_ns(&self) -> u64 {
        match self.clock {
            Clock::Virtual => self.page.now_ns.load(Relaxed),
            Clock::Wall => monotonic_ns().saturating_sub(self.page.origin_ns.load(Relaxed)),
        }
    }

    pub(crate) fn page(&self) -> &ControlPage {
        &self.page
    }

    pub(crate) fn clock(&self) -> Clock {
        self.clock
    }
}

/// CLOCK_MONOTONIC, ns.
pub(crate) fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64 // never negative
}
