//! What holds where the schedule file says nothing.

use super::closed::{Exhausted, LogPolicy, ModuleClock, StartMode, Transport};

/// One thread: a partition has one window loop.
pub(crate) const THREADS: u32 = 1;
/// Threads of a partition of several processes beside theirs: the main thread, and the error handler's.
pub(crate) const THREADS_BESIDE: u32 = 2;
/// Long enough for a debug build on a slow disk; a partition that hangs holds up the start for no longer.
pub(crate) const STARTUP_TIMEOUT_NS: u64 = 5_000_000_000;
/// Above every ordinary real-time thread of the system's own, below the dispatcher's 98.
pub(crate) const PRIORITY: u32 = 40;
/// A partition promises nothing about retained memory unless it says so.
pub(crate) const START: StartMode = StartMode::Cold;
/// With [`WITHIN_NS`]: enough for a passing fault, too few for a restart loop to go unseen.
pub(crate) const BUDGET: u32 = 5;
/// See [`BUDGET`].
pub(crate) const WITHIN_NS: u64 = 10_000_000_000;
/// The windows stay, so that nobody else's time changes.
pub(crate) const THEN: Exhausted = Exhausted::Idle;
/// About what starting a process takes; in virtual time it must be the same on every machine.
pub(crate) const STARTUP_NS: u64 = 20_000_000;
/// Half a second at 50 windows a second: long enough not to be a hiccup, short enough to fly through.
pub(crate) const SILENCE_WINDOWS: u32 = 25;
/// Several windows of 0.5 to 2 ms are lost or cut short by then: no noise of a machine that carries its schedule.
pub(crate) const LATE_AFTER_NS: u64 = 5_000_000;
/// With [`RESET_WITHIN_NS`]: a fault that a reset mends does not come back so soon.
pub(crate) const RESET_BUDGET: u32 = 2;
/// See [`RESET_BUDGET`].
pub(crate) const RESET_WITHIN_NS: u64 = 60_000_000_000;
/// About what a module of ten partitions takes; in virtual time it must be the same on every machine.
pub(crate) const RESET_STARTUP_NS: u64 = 200_000_000;
/// A thousand records: what a bad day leaves.
pub(crate) const HEALTH_LOG_BYTES: u64 = 256 << 10;
/// Several times what a switch and two network stacks take when nothing else is on the way.
pub(crate) const NETWORK_LATENCY_NS: u64 = 1_000_000;
/// A tenth of the shortest windows' distance in the plans here: beyond it a value may miss the window it was meant for.
pub(crate) const FOLLOWS_WITHIN_NS: u64 = 1_000_000;
/// What an Ethernet frame of 1500 bytes holds behind the headers of IPv6 and UDP: nobody on the way has to split it.
pub(crate) const MAX_BYTES: u32 = 1452;
/// Copies are sent at once: what is further apart than two such networks can be is no copy.
pub(crate) const SKEW_NS: u64 = 2_000_000;
/// Five windows of a relay that runs 50 times in a second.
pub(crate) const LOST_AFTER_NS: u64 = 100_000_000;
/// What every machine has.
pub(crate) const TRANSPORT: Transport = Transport::Udp;
pub(crate) const CLOCK: ModuleClock = ModuleClock::Monotonic;
/// What happened last explains an end.
pub(crate) const HEALTH_LOG_POLICY: LogPolicy = LogPolicy::Overwrite;
