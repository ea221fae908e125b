//! Who has a processor, as well as the kernel's counters tell it where there is no trace: what each thread that was last on it used of it
//! between two looks. And what the host took from it.

use std::collections::HashMap;
use std::fs;
use std::time::Duration;

/// Between the two looks.
const APART: Duration = Duration::from_millis(30);

/// A thread that used a processor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Busy {
    pub(super) tid: i32,
    pub(super) name: String,
    /// As the trace has it: below 100 is real time, the lower the more urgent.
    pub(super) priority: i32,
    pub(super) used_ns: u64,
}

/// The thread that used most of `core` in the time of two looks, from now on.
pub(super) fn busiest(core: u32) -> Option<Busy> {
    let before: HashMap<i32, u64> =
        threads_on(core).map(|(tid, _)| (tid, ran_ns(tid).unwrap_or(0))).collect();
    std::thread::sleep(APART);
    let used = threads_on(core).filter_map(|(tid, stat)| {
        let used_ns = ran_ns(tid)?.saturating_sub(*before.get(&tid)?);
        Some(Busy { tid, name: stat.name, priority: stat.priority, used_ns })
    });
    used.max_by_key(|busy| busy.used_ns).filter(|busy| busy.used_ns > 0)
}

/// What the host took from `core` since the machine began, in hundredths of a second; `None`: it does not say.
pub(super) fn steal(core: u32) -> Option<u64> {
    steal_in(&fs::read_to_string("/proc/stat").ok()?, core)
}

fn steal_in(stat: &str, core: u32) -> Option<u64> {
    let name = format!("cpu{core}");
    let line = stat.lines().find_map(|line| line.strip_prefix(&name)?.strip_prefix(' '))?;
    line.split_ascii_whitespace().nth(7)?.parse().ok()
}

#[derive(Debug, PartialEq, Eq)]
struct Stat {
    name: String,
    priority: i32,
    core: u32,
}

fn threads_on(core: u32) -> impl Iterator<Item = (i32, Stat)> {
    let numbers = |path: String| {
        let entries = fs::read_dir(path).into_iter().flatten().flatten();
        entries.filter_map(|entry| entry.file_name().to_str()?.parse::<i32>().ok())
    };
    let threads = numbers("/proc".into()).flat_map(move |pid| {
        let of_it = numbers(format!("/proc/{pid}/task"));
        of_it.filter_map(move |tid| {
            Some((tid, stat_of(&fs::read_to_string(format!("/proc/{pid}/task/{tid}/stat")).ok()?)?))
        })
    });
    threads.filter(move |(_, stat)| stat.core == core)
}

/// proc_pid_stat(5).
fn stat_of(text: &str) -> Option<Stat> {
    let (before, after) = text.rsplit_once(')')?;
    let fields: Vec<&str> = after.split_ascii_whitespace().collect();
    let field = |number: usize| fields.get(number - 3); // the first one behind the name is the third
    let priority: i32 = field(18)?.parse().ok()?;
    Some(Stat {
        name: before.split_once('(')?.1.to_owned(),
        priority: priority + 100, // real-time work is told as -2 to -100
        core: field(39)?.parse().ok()?,
    })
}

fn ran_ns(tid: i32) -> Option<u64> {
    fs::read_to_string(format!("/proc/{tid}/schedstat")).ok()?.split_ascii_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::Command;

    #[test]
    fn what_the_kernel_says_of_a_thread_and_of_a_processor_is_read_by_its_places() {
        let text = "42 (a) b) R 1 42 42 0 -1 4194304 1 2 3 4 5 6 7 8 -100 0 1 0 500 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 17 1 99 1 0 0 0";
        let stat = stat_of(text).unwrap();
        assert_eq!(stat, Stat { name: "a) b".into(), priority: 0, core: 1 });
        assert_eq!(stat_of("42 (cat) S 1"), None);
        let stat = "cpu  1 2 3 4 5 6 7 8 0 0\ncpu1 1 2 3 4 5 6 7 82 0 0\ncpu10 1 2 3 4 5 6 7 9 0 0\n";
        assert_eq!((steal_in(stat, 1), steal_in(stat, 10), steal_in(stat, 0)), (Some(82), Some(9), None));
    }

    #[test]
    fn a_thread_that_computes_is_the_busiest_of_its_processor() {
        let core = bateleur_system::sched::allowed_cores()[0];
        let mut hog = Command::new("sh").args(["-c", "while :; do :; done"]).spawn().unwrap();
        let pid = hog.id() as i32;
        bateleur_system::sched::bind(pid, &[core]).unwrap();
        // Others compute on a busy machine too.
        let found = (0..100).find_map(|_| busiest(core).filter(|busy| busy.tid == pid));
        hog.kill().unwrap();
        hog.wait().unwrap();
        let found = found.unwrap();
        assert_eq!((found.name.as_str(), found.priority), ("sh", 120));
    }
}
