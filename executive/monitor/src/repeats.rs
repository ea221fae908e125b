//! What a partition says again and again: told in the log so often and no more, and counted beyond that.
//!
//! An error in a loop, or a babbling partition, must not fill the disk, nor write over what the persistent log knows of
//! others. It must never lose that something was left out: how many, stands in the next entry.

use crate::health::decision::Decision;
use bateleur_plan::PartitionError;

/// Between two entries about one error of one partition, module time, ns.
const SILENCE_NS: u64 = 1_000_000_000;
/// Messages of one partition that are recorded at once, most; then one in each second.
const MESSAGES: u32 = 20;
const SECOND_NS: u64 = 1_000_000_000;

/// The errors of one partition that leave it running, each with what is done about it.
#[derive(Debug, Default)]
pub struct Repeats(Vec<Series>);

/// One error, again and again.
#[derive(Debug)]
struct Series {
    error: PartitionError,
    decision: Decision,
    told_ns: u64,
    /// Those since then.
    more: u32,
    last: String,
}

/// What has to be told of errors that were not told one by one.
#[derive(Debug, PartialEq, Eq)]
pub struct Untold {
    /// The error.
    pub error: PartitionError,
    /// What was decided about it.
    pub decision: Decision,
    /// How many there were, and what the last one was.
    pub detail: String,
}

impl Repeats {
    /// Takes notice of an error; whether it gets an entry of its own.
    #[must_use]
    pub fn is_told(
        &mut self,
        error: PartitionError,
        decision: Decision,
        detail: &str,
        module_ns: u64,
    ) -> bool {
        let known = |series: &&mut Series| series.error == error && series.decision == decision;
        let Some(series) = self.0.iter_mut().find(known) else {
            self.0.push(Series { error, decision, told_ns: module_ns, more: 0, last: String::new() });
            return true;
        };
        let told = module_ns >= series.told_ns + SILENCE_NS && series.more == 0;
        if told {
            series.told_ns = module_ns;
        } else {
            series.more = series.more.saturating_add(1);
            series.last = detail.to_owned();
        }
        told
    }

    /// What is due to be told at `module_ns`; `all`: also what is not due yet.
    pub fn take_untold(&mut self, module_ns: u64, all: bool) -> Option<Untold> {
        let due = |series: &&mut Series| series.more > 0 && (all || module_ns >= series.told_ns + SILENCE_NS);
        let series = self.0.iter_mut().find(due)?;
        let seconds = module_ns.saturating_sub(series.told_ns) as f64 / 1e9;
        let (more, last) = (std::mem::take(&mut series.more), std::mem::take(&mut series.last));
        series.told_ns = module_ns;
        let detail = format!("{more} more in {seconds:.1} s, the last: {last}");
        Some(Untold { error: series.error, decision: series.decision, detail })
    }
}

/// Whether `error` may come again and again, because nothing is done that ends it.
pub(crate) fn goes_on_after(error: PartitionError, decision: Decision, module_ignores: bool) -> bool {
    use PartitionError::{ApplicationError, DeadlineMissed, PortError, WindowOverrun};
    matches!(error, ApplicationError | PortError | WindowOverrun | DeadlineMissed)
        && match decision {
            Decision::Ignore | Decision::Handler => true,
            Decision::Module => module_ignores,
            Decision::Idle | Decision::Stop | Decision::Restart { .. } => false,
        }
}

/// How many messages of a partition may still be recorded.
#[derive(Debug)]
pub struct Allowance {
    left: u32,
    /// Since when the next one is earned, module time, ns.
    since_ns: u64,
    unrecorded: u32,
}

impl Default for Allowance {
    fn default() -> Self {
        Self { left: MESSAGES, since_ns: 0, unrecorded: 0 }
    }
}

impl Allowance {
    /// The text under which a message is recorded; `None` if it is one too many, and counted.
    pub fn record(&mut self, text: &str, module_ns: u64) -> Option<String> {
        let earned = module_ns.saturating_sub(self.since_ns) / SECOND_NS;
        self.since_ns += earned * SECOND_NS;
        self.left = MESSAGES.min(self.left.saturating_add(earned.try_into().unwrap_or(MESSAGES)));
        if self.left == 0 {
            self.unrecorded = self.unrecorded.saturating_add(1);
            return None;
        }
        self.left -= 1;
        Some(match self.take_unrecorded() {
            0 => text.to_owned(),
            more => format!("{text} ({more} before it are not recorded)"),
        })
    }

    /// Messages that were not recorded, where that has not been said yet.
    pub fn take_unrecorded(&mut self) -> u32 {
        std::mem::take(&mut self.unrecorded)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;

    #[test]
    fn error_that_is_raised_in_a_loop_has_one_entry_a_second_and_none_is_uncounted() {
        let mut repeats = Repeats::default();
        let (mut entries, mut counted) = (0, 0);
        // 10 s, 200 times a second.
        for step in 0..2000 {
            let module_ns = step * 5_000_000;
            while let Some(untold) = repeats.take_untold(module_ns, false) {
                entries += 1;
                counted += untold.detail.split(' ').next().unwrap().parse::<u32>().unwrap();
            }
            if repeats.is_told(PartitionError::ApplicationError, Decision::Ignore, "again", module_ns) {
                entries += 1;
                counted += 1;
            }
        }
        let last = repeats.take_untold(10 * SECOND, true).unwrap();
        assert_eq!(last.detail, "200 more in 1.0 s, the last: again");
        assert_eq!((entries, counted), (10, 2000 - 200));
        assert_eq!(repeats.take_untold(10 * SECOND, true), None);
    }

    #[test]
    fn errors_that_come_seldom_have_an_entry_each_and_different_ones_do_not_hide_each_other() {
        let mut repeats = Repeats::default();
        let (own, port) = (PartitionError::ApplicationError, PartitionError::PortError);
        assert!(repeats.is_told(own, Decision::Ignore, "", 0));
        assert!(repeats.is_told(port, Decision::Ignore, "", 1));
        assert!(repeats.is_told(own, Decision::Handler, "", 2));
        assert!(!repeats.is_told(own, Decision::Ignore, "", 3));
        assert_eq!(repeats.take_untold(SECOND - 1, false), None);
        assert!(repeats.take_untold(SECOND, false).is_some());
        assert!(repeats.is_told(own, Decision::Ignore, "", 2 * SECOND));
        assert!(repeats.is_told(own, Decision::Ignore, "", 3 * SECOND));
    }

    #[test]
    fn messages_of_a_babbling_partition_are_recorded_once_a_second_and_the_others_counted() {
        let mut allowance = Allowance::default();
        // 100 s, 10 times a second.
        let recorded: Vec<String> =
            (0..1000).filter_map(|step| allowance.record("so", step * SECOND / 10)).collect();
        assert_eq!(recorded.len(), 20 + 99);
        assert_eq!(recorded[0], "so");
        assert_eq!(recorded[118], "so (9 before it are not recorded)");
        assert_eq!(allowance.take_unrecorded(), 9);
        assert_eq!(allowance.record("after a while", 200 * SECOND).unwrap(), "after a while");
    }
}
