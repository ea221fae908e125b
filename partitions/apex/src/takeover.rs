//! What a partition is told when it takes over from a process that has ended.

use bateleur_contract::{StartCondition, Takeover as Order};

/// Handed to [`crate::Partition::take_over`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Takeover {
    order: Order,
    now_ns: u64,
}

impl Takeover {
    pub(crate) fn new(order: Order, now_ns: u64) -> Self {
        Self { order, now_ns }
    }

    /// What it would have been started for: after a warm takeover retained memory is as the predecessor left it, after a
    /// cold one it is zero.
    #[must_use]
    pub fn start_condition(&self) -> StartCondition {
        match self.order {
            Order::Warm => StartCondition::HmPartitionWarmRestart,
            Order::Cold => StartCondition::HmPartitionColdRestart,
        }
    }

    /// Module time, ns.
    #[must_use]
    pub fn now_ns(&self) -> u64 {
        self.now_ns
    }
}
