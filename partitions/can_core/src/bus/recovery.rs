//! A controller that went off the bus: when it is restarted, and what is said where that is no use. Time is an argument.

/// Delay before each restart of a controller that is bus-off, ns.
const RESTART_AFTER_NS: u64 = 1_000_000_000;
/// Refusals after which somebody has to hear of it: the first may be the kernel's, which restarts the controller by itself.
const REFUSALS: u32 = 3;

/// See the module's text.
#[derive(Debug, Default)]
pub(super) struct Recovery {
    restart_at_ns: Option<u64>,
    refusals: u32,
    complaint: Option<String>,
}

impl Recovery {
    /// It went off the bus.
    pub(super) fn off(&mut self, now_ns: u64) {
        *self = Self { restart_at_ns: Some(now_ns + RESTART_AFTER_NS), ..Self::default() };
    }

    /// It is on the bus again.
    pub(super) fn on(&mut self) {
        *self = Self::default();
    }

    /// When [`Recovery::tend`] has something to do, ns.
    pub(super) fn due_ns(&self) -> u64 {
        self.restart_at_ns.unwrap_or(u64::MAX)
    }

    /// Asks for a restart by `restart` where it is time.
    pub(super) fn tend(&mut self, now_ns: u64, bus: &str, restart: impl FnOnce() -> Result<(), String>) {
        if now_ns < self.due_ns() {
            return;
        }
        self.restart_at_ns = Some(now_ns + RESTART_AFTER_NS);
        let Err(why) = restart() else { return };
        self.refusals += 1;
        if self.refusals == REFUSALS {
            self.complaint = Some(format!(
                "{bus}: the controller stays bus-off: restarts are refused ({why}); that takes CAP_NET_ADMIN, or `ip link set {} \
                 type can restart-ms 100`, with which the kernel does it",
                bus.rsplit(':').next().unwrap_or(bus)
            ));
        }
    }

    /// What a person should hear of, once for each time that it went off the bus.
    pub(super) fn complaint(&mut self) -> Option<String> {
        self.complaint.take()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    /// Lets time pass; gives how often a restart was asked for, and what was said.
    fn pass(
        recovery: &mut Recovery,
        from_ms: u64,
        until_ms: u64,
        answer: Result<(), String>,
    ) -> (u32, Vec<String>) {
        let (mut asked, mut said) = (0, Vec::new());
        for now_ms in from_ms..until_ms {
            recovery.tend(now_ms * MS, "socketcan:can0", || {
                asked += 1;
                answer.clone()
            });
            said.extend(recovery.complaint());
        }
        (asked, said)
    }

    #[test]
    fn a_controller_off_the_bus_is_restarted_every_second_until_it_is_on_it_again() {
        let mut recovery = Recovery::default();
        assert_eq!(pass(&mut recovery, 0, 5_000, Ok(())), (0, vec![]));
        recovery.off(5_000 * MS);
        assert_eq!(pass(&mut recovery, 5_000, 7_500, Ok(())), (2, vec![]));
        recovery.on();
        assert_eq!(pass(&mut recovery, 7_500, 20_000, Ok(())), (0, vec![]));
    }

    #[test]
    fn a_restart_that_is_refused_is_said_once_with_what_helps_unless_the_kernel_does_it() {
        let mut recovery = Recovery::default();
        recovery.off(0);
        let (asked, said) = pass(&mut recovery, 0, 60_000, Err("not permitted".into()));
        assert!(asked > 50 && said.len() == 1, "{asked}, {said:?}");
        for words in ["not permitted", "CAP_NET_ADMIN", "ip link set can0 type can restart-ms"] {
            assert!(said[0].contains(words), "{said:?}");
        }
        recovery.off(60_000 * MS);
        let (_, early) = pass(&mut recovery, 60_000, 61_500, Err("not permitted".into()));
        recovery.on();
        assert_eq!((early, recovery.complaint()), (vec![], None));
    }
}
