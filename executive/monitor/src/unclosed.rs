//! Windows that a partition leaves open: counted until they are a silence, without those in which it had no processor.
//!
//! It must never hold against a partition what somebody else has taken from it.

use bateleur_system::cpu_starvation::Spell;
use bateleur_time::window_record::WindowRecord;

/// The granted windows in a row that a partition has not closed, as far as it is to blame.
#[derive(Debug, Default)]
pub(crate) struct Unclosed {
    count: u32,
    /// Of the last of them it is not known whether the partition had a processor.
    is_last_unknown: bool,
    /// What its process had since the last look, at this module time, ns.
    spell: Option<(u64, Spell)>,
    /// What the last look has found.
    seen: Option<Seen>,
}

/// What a process had between two looks, at module times, ns.
#[derive(Debug, Clone, Copy)]
struct Seen {
    pid: i32,
    from_ns: u64,
    to_ns: u64,
    why: Why,
}

impl Seen {
    /// Whether a window of process `pid` that began then lies between them.
    fn is_of(&self, pid: i32, began_ns: u64) -> bool {
        self.pid == pid && (self.from_ns..self.to_ns).contains(&began_ns)
    }
}

/// What is known of a window that a partition has not closed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Why {
    Unknown,
    NoProcessor,
    Itself,
}

impl Unclosed {
    /// A window was closed, or a process begins. `watched`: the process whose next window is watched, if any. Nobody asks the kernel for
    /// more of what goes well, unless a single window decides.
    pub(crate) fn end(&mut self, watched: Option<i32>, module_ns: u64) {
        *self = Self { spell: watched.map(|pid| (module_ns, Spell::begin(pid))), ..Self::default() };
    }

    /// A window of process `pid` was not closed. False: it had no processor for most of it.
    pub(crate) fn count_watched(&mut self, pid: i32, record: &WindowRecord, module_ns: u64) -> bool {
        let began_ns = record.granted_ns.unwrap_or(0);
        // A monitor that comes late looks at several windows at once: one look is for all of them.
        let why = match &self.seen {
            Some(seen) if seen.is_of(pid, began_ns) => seen.why,
            _ => self.look(pid, record, module_ns).why,
        };
        self.count(why)
    }

    /// Asks the kernel what the process had since the last look.
    fn look(&mut self, pid: i32, record: &WindowRecord, module_ns: u64) -> Seen {
        let before = self.spell.replace((module_ns, Spell::begin(pid)));
        let known = before.filter(|(begun_ns, spell)| {
            spell.is_of(pid) && record.granted_ns.is_some_and(|granted_ns| granted_ns >= *begun_ns)
        });
        let (from_ns, why) = match known {
            None => (module_ns, Why::Unknown),
            Some((begun_ns, spell)) if spell.has_starved(record.occurrence.window.duration_ns()) => {
                (begun_ns, Why::NoProcessor)
            }
            Some((begun_ns, _)) => (begun_ns, Why::Itself),
        };
        *self.seen.insert(Seen { pid, from_ns, to_ns: module_ns, why })
    }

    /// A window was not closed, and the partition had a processor.
    pub(crate) fn count_own(&mut self) {
        self.count(Why::Itself);
    }

    /// Whether it was blamed for it. Where a window without a processor follows one of which nothing is known, that one had none either.
    fn count(&mut self, why: Why) -> bool {
        let before = std::mem::replace(&mut self.is_last_unknown, why == Why::Unknown);
        match why {
            Why::NoProcessor => self.count -= u32::from(before),
            Why::Unknown | Why::Itself => self.count += 1,
        }
        why != Why::NoProcessor
    }

    /// Whether there were so many, which are counted anew then.
    pub(crate) fn take(&mut self, most: u32) -> bool {
        let full = self.count >= most;
        if full {
            (self.count, self.is_last_unknown) = (0, false);
        }
        full
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_first_window_without_a_processor_is_not_held_against_a_partition_and_each_that_it_used_is() {
        use Why::{Itself, NoProcessor, Unknown};
        let count = |windows: &[Why]| {
            let mut unclosed = Unclosed::default();
            windows.iter().for_each(|why| {
                unclosed.count(*why);
            });
            unclosed.count
        };
        assert_eq!(count(&[Unknown]), 1);
        assert_eq!(count(&[Unknown, NoProcessor, NoProcessor]), 0);
        assert_eq!(count(&[Unknown, Itself, NoProcessor, Itself]), 3);
        assert_eq!(count(&[Unknown, NoProcessor, Itself, NoProcessor]), 1);
        assert_eq!(count(&[Itself, NoProcessor]), 1, "the only one was watched");
        // In any order it is never blamed for more than it used, but for one window that nobody has followed.
        for bits in 0..1_u32 << 10 {
            let rest = (0..10).map(|place| if bits >> place & 1 == 1 { Itself } else { NoProcessor });
            let windows: Vec<Why> = std::iter::once(Unknown).chain(rest).collect();
            let used = bits.count_ones();
            assert_eq!(count(&windows), used + (bits & 1), "{windows:?}");
        }
    }

    #[test]
    fn windows_are_counted_anew_when_there_were_enough() {
        let mut unclosed = Unclosed::default();
        let mut taken = || {
            unclosed.count_own();
            unclosed.take(3)
        };
        assert_eq!([(); 6].map(|()| taken()), [false, false, true, false, false, true]);
    }
}
