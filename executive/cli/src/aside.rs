//! Programs that look on do not stand in the way.

use bateleur_system::sched;

/// Leaves the processors `dispatched`, those of a module's dispatchers, to them, and the others to whoever wants them first. Threads that are
/// begun later do as this one.
pub fn stand_aside(dispatched: &[u32]) {
    let others: Vec<u32> =
        sched::allowed_cores().into_iter().filter(|core| !dispatched.contains(core)).collect();
    if !others.is_empty() {
        let _ = sched::bind(0, &others); // it is a courtesy: dispatchers have a higher priority anyway
    }
    let _ = rustix::process::nice(10); // as above
}
