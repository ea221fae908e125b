//! Instants that recur with every major frame: how many of them lie within a span.

use super::timeline::gaps;

/// How many of `instants` lie from `start` on within `span`, the end left out, in a cycle. They rise, and lie in the cycle as `start` does.
pub(super) fn within(instants: &[u64], (start, span): (u64, u64), cycle: u64) -> u64 {
    let (rounds, rest) = (span / cycle.max(1), span % cycle.max(1));
    let before = |instant: u64| instants.partition_point(|&one| one < instant) as u64;
    let end = start + rest;
    // What reaches beyond the cycle goes on at its beginning.
    rounds * instants.len() as u64 + before(end) - before(start) + before(end.saturating_sub(cycle))
}

/// How many of `writes` lie at most between two neighbours of `reads`: from a read on, up to the next. Both rise.
pub(super) fn most_between(writes: &[u64], reads: &[u64], cycle: u64) -> u64 {
    let spans = reads.iter().copied().zip(gaps(reads, cycle));
    spans.map(|span| within(writes, span, cycle)).max().unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn writes_between_two_reads_are_counted_also_across_the_end_of_the_cycle() {
        assert_eq!(most_between(&[10, 20, 30], &[25], 100), 3, "a single read has the whole cycle before it");
        assert_eq!(most_between(&[0, 10, 90, 95], &[20, 80], 100), 4, "80 to 20 of the next");
        assert_eq!(
            most_between(&[20, 80], &[20, 80], 100),
            1,
            "one that is written as another opens comes after it"
        );
        assert_eq!((most_between(&[5], &[], 100), most_between(&[], &[5], 100)), (0, 0));
    }

    #[test]
    fn span_of_several_cycles_counts_each_of_them() {
        assert_eq!(within(&[0, 40, 80], (40, 30), 100), 1);
        assert_eq!(within(&[0, 40, 80], (40, 60), 100), 2, "the end is left out");
        assert_eq!(within(&[0, 40, 80], (80, 221), 100), 3 * 2 + 2, "80, and 0 of the next");
        assert_eq!(within(&[], (0, 1000), 100), 0);
    }
}
