//! How much of its life a process could use: a machine with more work than it can do keeps it waiting for a processor.
//!
//! It tells a process that hangs from one that was never let run. It must never wait.

use std::fs;

/// Times of a process since it began, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Spent {
    /// It had a processor.
    ran_ns: u64,
    /// It could have run and had none, as far as these waits are over.
    waited_ns: u64,
    /// It has a processor or waits for one at this moment.
    is_runnable: bool,
}

/// How long process `pid`, which began `elapsed_ns` ago, has run or waited for something else than a processor, ns; all of it where
/// the kernel does not tell.
pub fn used_ns(pid: i32, elapsed_ns: u64) -> u64 {
    spent_of(pid).map_or(elapsed_ns, |spent| used_of(&spent, elapsed_ns))
}

/// How long waits for a processor are not counted, at most, ns.
pub const STARVED_PATIENCE_NS: u64 = 30_000_000_000;

/// Whether process `pid`, which began `elapsed_ns` ago, has had `limit_ns` for itself. Waits for a processor are not counted, until
/// `most_ns` are over.
pub fn has_had(pid: i32, elapsed_ns: u64, limit_ns: u64, most_ns: u64) -> bool {
    is_had(elapsed_ns, limit_ns, most_ns, || used_ns(pid, elapsed_ns))
}

/// The kernel is asked only where its answer decides.
fn is_had(elapsed_ns: u64, limit_ns: u64, most_ns: u64, used_ns: impl FnOnce() -> u64) -> bool {
    elapsed_ns >= limit_ns && (elapsed_ns >= most_ns || used_ns() >= limit_ns)
}

/// Whether it waits for a disk at this moment.
pub fn waits_for_disk(pid: i32) -> bool {
    fs::read_to_string(format!("/proc/{pid}/stat")).is_ok_and(|stat| state_in(&stat) == Some('D'))
}

/// A name may hold blanks and parentheses; the state follows the last one.
fn state_in(stat: &str) -> Option<char> {
    stat.rsplit_once(')')?.1.trim_start().chars().next()
}

/// A time of a process's life that begins somewhere in it.
#[derive(Debug)]
pub struct Spell {
    pid: i32,
    before: Option<Spent>,
}

impl Spell {
    /// One that begins now.
    pub fn begin(pid: i32) -> Self {
        Self { pid, before: spent_of(pid) }
    }

    /// As [`used_ns`], of this time, which began `elapsed_ns` ago.
    pub fn used_ns(&self, elapsed_ns: u64) -> u64 {
        self.spent().map_or(elapsed_ns, |since| used_of(&since, elapsed_ns))
    }

    /// As [`has_had`], of this time.
    pub fn has_had(&self, elapsed_ns: u64, limit_ns: u64, most_ns: u64) -> bool {
        is_had(elapsed_ns, limit_ns, most_ns, || self.used_ns(elapsed_ns))
    }

    /// Whether the process, which was to have a processor for `due_ns` of this time, waited for one and had none for most of it.
    pub fn has_starved(&self, due_ns: u64) -> bool {
        self.spent().is_some_and(|since| is_starved(&since, due_ns))
    }

    /// Whether it is of process `pid`.
    pub fn is_of(&self, pid: i32) -> bool {
        self.pid == pid
    }

    fn spent(&self) -> Option<Spent> {
        self.before.zip(spent_of(self.pid)).map(|(before, now)| Spent {
            ran_ns: now.ran_ns.saturating_sub(before.ran_ns),
            waited_ns: now.waited_ns.saturating_sub(before.waited_ns),
            ..now
        })
    }
}

fn spent_of(pid: i32) -> Option<Spent> {
    let read = |file| fs::read_to_string(format!("/proc/{pid}/{file}")).ok();
    read("schedstat").zip(read("stat")).and_then(|(schedstat, stat)| spent(&schedstat, &stat))
}

fn used_of(spent: &Spent, elapsed_ns: u64) -> u64 {
    match spent.is_runnable {
        // How long it has been waiting this time is not known.
        true => spent.ran_ns,
        false => elapsed_ns.saturating_sub(spent.waited_ns),
    }
}

/// See [`Spell::has_starved`].
fn is_starved(spent: &Spent, due_ns: u64) -> bool {
    let most_ns = due_ns / 2;
    spent.ran_ns < most_ns && (spent.is_runnable || spent.waited_ns > most_ns)
}

/// Reads the two files of `/proc` (Linux, Documentation/scheduler/sched-stats.rst, and proc_pid_stat(5)).
fn spent(schedstat: &str, stat: &str) -> Option<Spent> {
    let mut words = schedstat.split_ascii_whitespace().map(str::parse);
    let (Some(Ok(ran_ns)), Some(Ok(waited_ns))) = (words.next(), words.next()) else { return None };
    let state = state_in(stat)?;
    Some(Spent { ran_ns, waited_ns, is_runnable: state == 'R' })
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::{Command, Stdio};

    const SECOND_NS: u64 = 1_000_000_000;

    #[test]
    fn a_process_that_waits_for_a_processor_has_used_what_it_ran_and_one_that_sleeps_all_but_such_waits() {
        let starved = spent("7000000 0 3\n", "42 (a) b) R 1 42 0").unwrap();
        assert_eq!(used_of(&starved, 20 * SECOND_NS), 7_000_000);
        let asleep = spent("7000000 2000000000 9\n", "42 (channel-cleaner) S 1 42 0").unwrap();
        assert_eq!(used_of(&asleep, 20 * SECOND_NS), 18 * SECOND_NS);
        assert_eq!(spent("", "42 (channel-cleaner) S 1"), None);
    }

    #[test]
    fn a_window_in_which_a_process_waited_for_a_processor_is_told_from_one_that_it_used_or_slept_through() {
        let spent = |ran_ns, waited_ns, is_runnable| Spent { ran_ns, waited_ns, is_runnable };
        assert!(is_starved(&spent(10, 0, true), 1_000), "it waits still");
        assert!(is_starved(&spent(10, 900, false), 1_000), "it waited, and is held now");
        assert!(!is_starved(&spent(900, 50, true), 1_000), "it computed");
        assert!(!is_starved(&spent(10, 20, false), 1_000), "it sleeps");
    }

    #[test]
    fn a_wait_for_a_processor_is_no_delay_until_it_lasts_too_long() {
        let mut busy = Command::new("sh").args(["-c", "while :; do :; done"]).spawn().unwrap();
        let pid = busy.id() as i32;
        let hour_ns = 3_600 * SECOND_NS;
        let verdicts = [
            has_had(pid, 5, 6, 7),
            has_had(pid, hour_ns, hour_ns - 1, hour_ns + 1), // it had no processor for most of it
            has_had(pid, hour_ns, hour_ns - 1, hour_ns),     // for so long that it does not matter
        ];
        busy.kill().unwrap();
        busy.wait().unwrap();
        assert_eq!(verdicts, [false, false, true]);
        let gone = i32::MAX;
        assert!(has_had(gone, 7, 6, 8), "nothing is known of it: all of its time counts");
    }

    #[test]
    fn a_process_that_sleeps_uses_its_life_and_of_one_that_is_gone_all_is_said() {
        let mut child = Command::new("cat").stdin(Stdio::piped()).spawn().unwrap();
        let pid = child.id() as i32;
        // However long it takes until it sleeps on its input: before that it sleeps now and then while it starts.
        let spell = loop {
            let spell = Spell::begin(pid);
            if used_ns(pid, 3_600 * SECOND_NS) >= 1_800 * SECOND_NS && spell.used_ns(SECOND_NS) == SECOND_NS {
                break spell;
            }
            std::thread::yield_now();
        };
        child.kill().unwrap();
        child.wait().unwrap();
        assert_eq!((used_ns(pid, 5), spell.used_ns(5)), (5, 5));
    }
}
