//! Crash reports: what dead processes have written down is handed to helpers, one at a time, when nobody waits for their successors any
//! more.
//!
//! A helper reads it, because the dead process could write there what it liked, and because finding functions and lines takes as long as it
//! takes. It must never hold up a restart: a helper begins when the partition runs again, or has no successor, or a second has passed. Nor may it
//! wait for the disk: a thread makes the files of a report.

use std::collections::VecDeque;
use std::fs::File;
use std::io;
use std::os::fd::{AsFd, BorrowedFd};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, TryRecvError, sync_channel};
use std::time::Duration;

use bateleur_host::helper::crash::{CrashFiles, CrashOrder};
use bateleur_host::helper::end_helper;
use bateleur_plan::PartitionError;
use bateleur_system::spawn::Spawned;
use bateleur_system::thread;
use bateleur_system::time::now_ns;
use bateleur_system::wait::{await_any_end, ended, is_readable};

/// Makes the files of a report, as long as the disk takes. `None`: there are enough reports.
pub type MakeCrashFiles = Arc<dyn Fn(&CrashOrder) -> io::Result<Option<CrashFiles>> + Send + Sync>;
/// Starts a helper, with the memory that a process has written into.
pub type StartCrashReporter = Box<dyn Fn(&CrashOrder, &File, &CrashFiles) -> io::Result<Spawned>>;

/// How a helper is started for what a dead process has written down.
pub struct CrashReporter {
    /// On a thread of its own.
    pub make_files: MakeCrashFiles,
    /// On the monitor's.
    pub start: StartCrashReporter,
}

/// Dead processes that wait for a helper, most; later ones have no report.
const WAITING: usize = 16;
/// How long a helper may take, real time, ns.
const PATIENCE_NS: u64 = 20_000_000_000;
/// How long the end of a run waits for all of them, real time, ns.
const END_PATIENCE_NS: u64 = 20_000_000_000;
/// Between two looks whether its files are there, at the end of a run.
const LOOK: Duration = Duration::from_millis(1);
/// How long a dead process waits for a partition that does not come back, real time, ns.
const RESPECT_NS: u64 = 1_000_000_000;

/// See the module's head.
#[derive(Default)]
pub(crate) struct Crashes {
    reporter: Option<CrashReporter>,
    waiting: VecDeque<Dead>,
    /// The first of those whose files are being made.
    opening: Option<(Dead, Receiver<io::Result<Option<CrashFiles>>>)>,
    at_work: Option<(Spawned, Dead, u64)>,
}

struct Dead {
    order: CrashOrder,
    memory: File,
    since_ns: u64,
}

impl Crashes {
    /// From now on helpers are started so.
    pub(crate) fn start_by(&mut self, reporter: CrashReporter) {
        self.reporter = Some(reporter);
    }

    pub(crate) fn add(&mut self, order: CrashOrder, memory: File) {
        if self.waiting.len() < WAITING {
            self.waiting.push_back(Dead { order, memory, since_ns: now_ns() });
        }
    }

    /// Tells the end of the helper that is at work.
    fn helper(&self) -> Option<BorrowedFd<'_>> {
        self.at_work.as_ref().map(|(process, ..)| process.pidfd.as_fd())
    }

    /// Nobody is dead of whom it knows.
    pub(crate) fn is_idle(&self) -> bool {
        self.at_work.is_none() && self.opening.is_none() && self.waiting.is_empty()
    }

    /// Looks at the helper, and has the next one begin where that is possible. `comes_back`: whether the partition with this name has a
    /// successor that does not run yet. What can not be done, once.
    pub(crate) fn look(&mut self, comes_back: impl Fn(&str) -> bool) -> Option<String> {
        if let Some((process, _, since_ns)) = &self.at_work {
            let over = is_readable(process.pidfd.as_fd());
            if !over && now_ns().saturating_sub(*since_ns) < PATIENCE_NS {
                return None;
            }
            if !over {
                end_helper(process);
            }
            let _ = ended(process); // what it could do lies in its files
            self.at_work = None;
        }
        if self.opening.is_none() {
            let next = self.waiting.front()?;
            if comes_back(&next.order.partition) && now_ns().saturating_sub(next.since_ns) < RESPECT_NS {
                return None;
            }
            let dead = Dead { since_ns: now_ns(), ..self.waiting.pop_front()? };
            let files = self.make_files(dead.order.clone());
            self.opening = Some((dead, files));
        }
        self.begin_reading()
    }

    /// Has a thread make the files of a report.
    fn make_files(&self, order: CrashOrder) -> Receiver<io::Result<Option<CrashFiles>>> {
        let (made, files) = sync_channel(1);
        if let Some(make) = self.reporter.as_ref().map(|reporter| reporter.make_files.clone()) {
            // Without a thread nobody answers, which is told.
            let _ = thread::named("crash files").spawn(move || made.send(make(&order)));
        }
        files
    }

    /// Starts the helper whose files are there.
    fn begin_reading(&mut self) -> Option<String> {
        let (dead, files) = self.opening.as_ref()?;
        let files = match files.try_recv() {
            Ok(files) => files,
            Err(TryRecvError::Empty) if now_ns().saturating_sub(dead.since_ns) < PATIENCE_NS => return None,
            Err(_) => Err(io::Error::other("the disk does not take it")),
        };
        let (dead, _) = self.opening.take()?;
        let start = &self.reporter.as_ref()?.start;
        let started =
            files.and_then(|files| files.map(|files| start(&dead.order, &dead.memory, &files)).transpose());
        match started {
            Ok(process) => self.at_work = process.map(|process| (process, dead, now_ns())),
            Err(error) => {
                return Some(format!("there is no report of how {} ended: {error}", dead.order.partition));
            }
        }
        None
    }

    /// The run is over: waits for those that are left.
    pub(crate) fn finish(&mut self) {
        let begun_ns = now_ns();
        while !self.is_idle() && now_ns().saturating_sub(begun_ns) < END_PATIENCE_NS {
            if self.look(|_| false).is_some() {
                return;
            }
            let helper: Vec<_> = self.helper().into_iter().collect();
            match helper.is_empty() {
                true => std::thread::sleep(LOOK),
                false => drop(await_any_end(&helper, 100_000_000)),
            }
        }
    }

    /// The module starts again, and everything that serves it ends. What was not read is read then.
    pub(crate) fn set_back(&mut self) {
        if let Some((process, dead, _)) = self.at_work.take() {
            if is_readable(process.pidfd.as_fd()) {
                let _ = ended(&process);
            } else {
                end_helper(&process);
                self.waiting.push_front(dead);
            }
        }
        if let Some((dead, _)) = self.opening.take() {
            self.waiting.push_front(dead);
        }
        self.reporter = None;
    }
}

/// Whether what a process wrote down when it was hit by `signal` (0: a panic) tells of this end. It may be of a fault that it has
/// survived, or that it has made up.
pub(crate) fn tells_of(error: PartitionError, exit_code: Option<i32>, signal: u64) -> bool {
    const PANIC: u64 = 0;
    const SIGILL: u64 = 4;
    const SIGABRT: u64 = 6;
    const SIGBUS: u64 = 7;
    const SIGFPE: u64 = 8;
    const SIGSEGV: u64 = 11;
    let expected: &[u64] = match error {
        PartitionError::MemoryViolation => &[SIGSEGV, SIGBUS, SIGABRT, PANIC],
        PartitionError::NumericError => &[SIGFPE, PANIC],
        PartitionError::IllegalRequest => &[SIGILL, PANIC],
        PartitionError::StackOverflow => &[SIGSEGV, SIGABRT, PANIC],
        PartitionError::MemoryLimit => &[SIGABRT],
        PartitionError::HardwareFault => &[SIGBUS],
        PartitionError::StartupTimeout => &[SIGILL, SIGABRT, SIGBUS, SIGFPE, SIGSEGV, PANIC],
        PartitionError::Exit => match exit_code {
            Some(bateleur_contract::exit::ABORTED) => &[SIGABRT],
            Some(PANICKED) => &[PANIC],
            _ => &[],
        },
        _ => &[],
    };
    expected.contains(&signal)
}

/// What a Rust program that panicked ends with.
const PANICKED: i32 = 101;

#[cfg(test)]
mod tests {
    use std::cell::RefCell;
    use std::rc::Rc;

    use super::*;
    use crate::cleanup::tests::shell;

    #[test]
    fn what_was_written_down_tells_of_an_end_of_its_kind_alone() {
        let fits = |error, code, signal| tells_of(error, code, signal);
        assert!(
            fits(PartitionError::MemoryViolation, None, 11)
                && !fits(PartitionError::MemoryViolation, None, 8)
        );
        assert!(fits(PartitionError::Exit, Some(67), 6) && fits(PartitionError::Exit, Some(101), 0));
        assert!(!fits(PartitionError::Exit, Some(3), 0), "it has survived a panic, and ended by itself");
        for error in [PartitionError::Killed, PartitionError::Silence, PartitionError::ApplicationError] {
            assert!((0..64).all(|signal| !fits(error, None, signal)), "{error:?}");
        }
    }

    fn files() -> io::Result<Option<CrashFiles>> {
        let program = (None, String::new());
        Ok(Some(CrashFiles { report: tempfile::tempfile()?, dump: tempfile::tempfile()?, program }))
    }

    fn reporter(start: impl Fn(&CrashOrder) -> Spawned + 'static) -> CrashReporter {
        CrashReporter {
            make_files: Arc::new(|_| files()),
            start: Box::new(move |order, _, _| Ok(start(order))),
        }
    }

    /// Looks until something was begun.
    fn await_begun(crashes: &mut Crashes) {
        while crashes.at_work.is_none() {
            assert_eq!(crashes.look(|_| false), None);
            std::thread::sleep(LOOK);
        }
    }

    #[test]
    fn disk_that_hangs_keeps_nobody_waiting_and_a_report_that_can_not_be_written_is_told() {
        let mut crashes = Crashes::default();
        let (held, hold) = sync_channel::<()>(1);
        let hold = std::sync::Mutex::new(hold);
        crashes.start_by(CrashReporter {
            make_files: Arc::new(move |_| {
                let _ = hold.lock().unwrap().recv(); // until the test ends
                files()
            }),
            start: Box::new(|_, _, _| panic!("it has no files")),
        });
        let (order, memory) = dead("a");
        crashes.add(order, memory);
        let begun = std::time::Instant::now();
        (0..1000).for_each(|_| assert_eq!(crashes.look(|_| false), None));
        assert!(begun.elapsed() < Duration::from_secs(5) && !crashes.is_idle());
        crashes.opening.as_mut().unwrap().0.since_ns = 0;
        assert!(crashes.look(|_| false).unwrap().contains("the disk does not take it"));
        drop(held);
        crashes.start_by(CrashReporter {
            make_files: Arc::new(|_| Err(io::ErrorKind::StorageFull.into())),
            start: Box::new(|_, _, _| panic!("it has no files")),
        });
        let (order, memory) = dead("b");
        crashes.add(order, memory);
        let said = std::iter::repeat_with(|| crashes.look(|_| false)).flatten().next().unwrap();
        assert!(said.starts_with("there is no report of how b ended"), "{said}");
    }

    fn dead(partition: &str) -> (CrashOrder, File) {
        let order = CrashOrder { partition: partition.into(), ..CrashOrder::default() };
        (order, tempfile::tempfile().unwrap())
    }

    #[test]
    fn helpers_begin_one_at_a_time_when_nobody_comes_back_and_all_of_them_before_the_end() {
        let begun: Rc<RefCell<Vec<String>>> = Rc::default();
        let log = begun.clone();
        let mut crashes = Crashes::default();
        crashes.start_by(reporter(move |order| {
            log.borrow_mut().push(order.partition.clone());
            shell("sleep 0.2").0
        }));
        for partition in ["a", "b", "c"] {
            let (order, memory) = dead(partition);
            crashes.add(order, memory);
        }
        assert_eq!(crashes.look(|_| true), None);
        assert!(begun.borrow().is_empty(), "its successor is about to run");
        await_begun(&mut crashes);
        assert_eq!(crashes.look(|_| false), None);
        assert_eq!(*begun.borrow(), ["a"], "the helper is at work");
        crashes.finish();
        assert!(crashes.is_idle());
        assert_eq!(*begun.borrow(), ["a", "b", "c"]);
    }

    #[test]
    fn reader_that_was_at_work_at_a_reset_begins_again_and_those_beyond_a_number_are_left_out() {
        let begun: Rc<RefCell<u32>> = Rc::default();
        let start = |script: &'static str| {
            let begun = begun.clone();
            reporter(move |_| {
                *begun.borrow_mut() += 1;
                shell(script).0
            })
        };
        let mut crashes = Crashes::default();
        crashes.start_by(start("sleep 60"));
        for _ in 0..2 * WAITING {
            let (order, memory) = dead("a");
            crashes.add(order, memory);
        }
        await_begun(&mut crashes);
        crashes.set_back();
        crashes.start_by(start("true"));
        crashes.finish();
        assert_eq!(*begun.borrow() as usize, 1 + WAITING);
    }
}
