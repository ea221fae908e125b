//! Module time (GET_TIME).

use std::cell::Cell;
use std::rc::Rc;
use std::sync::atomic::Ordering::Relaxed;

use bateleur_contract::{Clock, ControlPage, Mapped};
use rustix::time::{ClockId, clock_gettime};

/// How long a device may keep a partition waiting under the virtual clock, real time, ns. Module time stands still
/// meanwhile; a peer that takes longer is gone, and the caller sees the time-out that it would have seen in flight.
const PATIENCE_NS: u64 = 2_000_000_000;
/// The same once a peer was found to be gone: the flight must not stand still at every window.
const LATER_PATIENCE_NS: u64 = 500_000;

/// The module's clock, as the executive gives it. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Time {
    page: Rc<Mapped<ControlPage>>,
    clock: Clock,
    patience_ns: Rc<Cell<u64>>,
}

impl Time {
    /// The clock of a control page: for measuring. A partition asks its [`crate::Context`].
    pub fn new(page: Rc<Mapped<ControlPage>>, clock: Clock) -> Self {
        Self { page, clock, patience_ns: Rc::new(Cell::new(PATIENCE_NS)) }
    }

    /// Time since the start of frame 0, ns. Never decreases.
    pub fn now_ns(&self) -> u64 {
        match self.clock {
            Clock::Virtual => self.page.now_ns.load(Relaxed),
            // Before frame 0 there is no origin: time stands at 0, instead of being the machine's and then jumping back.
            Clock::Wall => match self.page.origin_ns.load(Relaxed) {
                0 => 0,
                origin_ns => monotonic_ns().saturating_sub(origin_ns),
            },
        }
    }

    /// One that stands still until it is set.
    #[cfg(test)]
    #[allow(clippy::unwrap_used)]
    pub(crate) fn standing() -> Self {
        let page = rustix::fs::memfd_create("page", rustix::fs::MemfdFlags::CLOEXEC).unwrap();
        rustix::fs::ftruncate(&page, 4096).unwrap();
        Self::new(Rc::new(Mapped::<ControlPage>::new(page).unwrap()), Clock::Virtual)
    }

    pub(crate) fn page(&self) -> &ControlPage {
        &self.page
    }

    /// Runs `wait` with the time that it may take under the virtual clock; true: something came.
    pub(crate) fn be_patient(&self, wait: impl FnOnce(u64) -> bool) -> bool {
        let came = wait(self.patience_ns.get());
        self.patience_ns.set(if came { PATIENCE_NS } else { LATER_PATIENCE_NS });
        came
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
