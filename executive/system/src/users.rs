//! The user numbers that an executive of root gives to what it starts.
//!
//! What the kernel counts for each user (queued signals, timers, watches, pages in pipes) it then counts for each partition, and
//! a file's owner says which partition made it. No such user has to exist.

/// A user that a process becomes.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct User {
    /// User number.
    pub id: u32,
    /// Group number.
    pub group: u32,
    /// Groups beside it: those of the devices that it may open.
    pub groups: Vec<u32>,
}

/// User and group of the helpers, and group of the devices that partitions are granted.
pub const HELPERS: u32 = 61_653;

/// First number of partitions: outside the ranges that distributions give to people, system services and containers (systemd's
/// table of user numbers calls 0x70000000 to 0x7ffdffff unused).
const FIRST: u32 = 0x7000_0000;
/// Numbers of one run.
const FOR_EACH_RUN: u32 = 1024;
/// Partitions of a plan that have numbers, their standbys too.
pub const MOST_PARTITIONS: usize = FOR_EACH_RUN as usize / 2;
/// Runs that have numbers of their own at a time.
const RUNS: u32 = 1 << 14;

/// Whom an executive of root starts processes as.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Users {
    /// First number of the partitions of this run; `None` if they run as the helpers' user.
    pub partitions: Option<u32>,
}

impl Users {
    /// The helpers' user, with further groups.
    #[must_use]
    pub fn helper() -> User {
        User { id: HELPERS, group: HELPERS, groups: Vec::new() }
    }

    /// The user of the partition at place `index` of the plan, below [`MOST_PARTITIONS`] where they have numbers of their own,
    /// or of its standby.
    #[must_use]
    pub fn partition(self, index: usize, standby: bool, groups: Vec<u32>) -> User {
        let place = 2 * index + usize::from(standby);
        let id = self.partitions.map_or(HELPERS, |first| first + place as u32);
        User { id, group: id, groups }
    }
}

/// First number of a run by process `pid`. `taken`: those of the runs that live.
#[must_use]
pub fn first_of_run(pid: u32, taken: &[u32]) -> u32 {
    let nth = |run: u32| FIRST + (run % RUNS) * FOR_EACH_RUN;
    let free = (0..RUNS).map(|step| nth((pid % RUNS) + step)).find(|first| !taken.contains(first));
    free.unwrap_or_else(|| nth(pid))
}

/// Whether only a run of ours has processes and files of that user.
#[must_use]
pub fn is_of_a_run(user: u32) -> bool {
    user == HELPERS || (FIRST..FIRST + RUNS * FOR_EACH_RUN).contains(&user)
}

/// The range of the partitions' users, for people.
#[must_use]
pub fn range() -> String {
    format!("{FIRST} to {}", FIRST + RUNS * FOR_EACH_RUN - 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn partitions_their_standbys_and_two_runs_have_numbers_of_their_own() {
        let [one, other] = [7, 8].map(|pid| Users { partitions: Some(first_of_run(pid, &[])) });
        let all = [one, other].map(|users| {
            (0..MOST_PARTITIONS)
                .flat_map(|index| [false, true].map(|standby| users.partition(index, standby, vec![]).id))
                .collect()
        });
        let [one, other]: [std::collections::BTreeSet<u32>; 2] = all;
        assert_eq!((one.len(), other.len(), one.intersection(&other).count()), (1024, 1024, 0));
        assert!(one.union(&other).all(|user| is_of_a_run(*user)) && !is_of_a_run(0) && !is_of_a_run(1000));
    }

    #[test]
    fn a_run_takes_no_numbers_of_one_that_lives() {
        let taken = first_of_run(7, &[]);
        assert_eq!(first_of_run(7 + RUNS, &[]), taken);
        let second = first_of_run(7 + RUNS, &[taken]);
        assert_eq!(second, taken + FOR_EACH_RUN);
        assert_eq!(
            first_of_run(RUNS - 1, &[first_of_run(RUNS - 1, &[])]),
            FIRST,
            "they begin again at the first"
        );
    }
}
