//! The monotonic clock, in nanoseconds. Windows never run on a clock that somebody may set.

use rustix::thread::clock_nanosleep_absolute;
use rustix::time::{ClockId, Timespec, clock_gettime};

const NS: u64 = 1_000_000_000;

/// CLOCK_MONOTONIC now.
#[must_use]
pub fn now_ns() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * NS + now.tv_nsec as u64 // never negative
}

/// An instant or a span as the kernel takes it.
#[must_use]
pub fn timespec(nanoseconds: u64) -> Timespec {
    Timespec { tv_sec: (nanoseconds / NS) as i64, tv_nsec: (nanoseconds % NS) as i64 }
}

/// Sleeps until an instant of CLOCK_MONOTONIC; at once if it has passed.
pub fn sleep_until_ns(instant_ns: u64) {
    let until = timespec(instant_ns);
    // A signal may end the sleep early: go on until the instant. Any other error would mean a clock that is not there.
    while clock_nanosleep_absolute(ClockId::Monotonic, &until) == Err(rustix::io::Errno::INTR) {}
}

/// Holds the processor until an instant of CLOCK_MONOTONIC.
pub fn spin_until_ns(instant_ns: u64) {
    while now_ns() < instant_ns {
        std::hint::spin_loop();
    }
}
