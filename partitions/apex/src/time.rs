//! Module time (GET_TIME).

use std::cell::Cell;
use std::rc::Rc;
use std::sync::atomic::Ordering::Relaxed;

use bateleur_contract::{Clock, ControlPage, Mapped};
use rustix::thread::futex;
use rustix::time::{ClockId, clock_gettime};

/// How long a device may keep a partition waiting under the virtual clock, real time, ns. Module time stands still
/// meanwhile; a peer that takes longer is gone, and the caller sees the time-out that it would have seen in flight.
const PATIENCE_NS: u64 = 2_000_000_000;
/// The same once a peer was found to be gone: the flight must not stand still at every window.
const LATER_PATIENCE_NS: u64 = 500_000;
/// Looks at a clock that stands still after which the caller is waiting for it: from then on each look takes [`POLL_NS`]. Far more
/// than a computation makes in a window.
const POLLS: u64 = 10_000;
/// About what a look and the loop around it take on the wall clock, ns.
const POLL_NS: u64 = 1_000;

/// The module's clock, as the executive gives it. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Time {
    page: Rc<Mapped<ControlPage>>,
    clock: Clock,
    patience_ns: Rc<Cell<u64>>,
    looks: Rc<Cell<Looks>>,
    neighbour: Option<Neighbour>,
    granted_by_caller: Option<Rc<str>>,
}

/// Looks at the virtual clock while it stood still.
#[derive(Debug, Clone, Copy, Default)]
struct Looks {
    at_ns: u64,
    count: u64,
}

/// Whoever answers at the other end of a device, where he lives in this process too: called before it is waited for.
#[derive(Clone)]
pub(crate) struct Neighbour(pub(crate) Rc<dyn Fn()>);

impl std::fmt::Debug for Neighbour {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Neighbour")
    }
}

impl Time {
    /// The clock of a control page: for measuring. A partition asks its [`crate::Context`].
    pub fn new(page: Rc<Mapped<ControlPage>>, clock: Clock) -> Self {
        Self {
            page,
            clock,
            patience_ns: Rc::new(Cell::new(PATIENCE_NS)),
            looks: Rc::default(),
            neighbour: None,
            granted_by_caller: None,
        }
    }

    /// The thread that looks is the one that grants windows, one call each: nobody else could grant the next one.
    pub(crate) fn granted_by_caller(self, partition: &str) -> Self {
        Self { granted_by_caller: Some(partition.into()), ..self }
    }

    pub(crate) fn beside(self, neighbour: Neighbour) -> Self {
        Self { neighbour: Some(neighbour), ..self }
    }

    /// A device is about to be waited for.
    pub(crate) fn before_wait(&self) {
        if let Some(Neighbour(answer)) = &self.neighbour {
            answer();
        }
    }

    /// Time since the start of frame 0, ns. Never decreases. The virtual clock stands still in a window, but for who waits in a loop
    /// until it moves: after ten thousand looks in one window each further look takes a microsecond. At the window's end the caller
    /// is held until the next window, as on the wall clock.
    ///
    /// # Panics
    /// At the window's end in a [`crate::Harness`], or where the partition is one of several in a process: nobody could grant the next
    /// window.
    #[inline]
    pub fn now_ns(&self) -> u64 {
        match self.clock {
            Clock::Virtual => self.virtual_ns(),
            // Before frame 0 there is no origin: time stands at 0, instead of being the machine's and then jumping back.
            Clock::Wall => match self.page.origin_ns.load(Relaxed) {
                0 => 0,
                origin_ns => monotonic_ns().saturating_sub(origin_ns),
            },
        }
    }

    fn virtual_ns(&self) -> u64 {
        let at_ns = self.page.now_ns.load(Relaxed);
        let looks = self.looks.get();
        let count = if looks.at_ns == at_ns { looks.count + 1 } else { 1 };
        self.looks.set(Looks { at_ns, count });
        if count <= POLLS {
            return at_ns;
        }
        let (number, window) = self.page.granted_window();
        if window.end_ns == 0 {
            return at_ns; // no window yet, or the last call before frame 0
        }
        let now_ns = at_ns + (count - POLLS) * POLL_NS;
        if now_ns < window.end_ns {
            return now_ns;
        }
        if let Some(partition) = &self.granted_by_caller {
            beyond_the_window(partition, window.end_ns);
        }
        self.hold(number);
        self.page.now_ns.load(Relaxed).max(window.end_ns)
    }

    /// The window of grant `number` is used up: sleeps until there is another one.
    fn hold(&self, number: u32) {
        // A stamp outside of the window: it was not closed.
        self.page.closed_ns.store(0, Relaxed);
        if self.page.close(number) {
            let _ = futex::wake(&self.page.done, futex::Flags::empty(), 1); // woken by the clock meanwhile: fine
        }
        crate::run::await_grant(&self.page, number);
        self.page.opened_ns.store(monotonic_ns(), Relaxed);
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

/// Fails a test, or a flight in one process, which then is flown as partitions.
#[cold]
#[allow(clippy::panic)] // a partition that goes on here would never end
fn beyond_the_window(partition: &str, end_ns: u64) -> ! {
    panic!(
        "{partition} looks at module time until its window is over, at {end_ns} ns; in flight that is an overrun, which is not shown here: \
         return from the window, and go on in the next one"
    );
}

/// CLOCK_MONOTONIC, ns.
#[inline]
pub(crate) fn monotonic_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64 // never negative
}
