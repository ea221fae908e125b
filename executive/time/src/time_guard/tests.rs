use super::*;
use std::sync::{Arc, Mutex};

/// Processes that are written down.
#[derive(Debug, Default)]
struct World {
    said: Vec<String>,
    now_ns: u64,
    freeze_fails: bool,
    in_kernel: bool,
    frozen: bool,
    stopped: bool,
    real_time: Vec<i32>,
    threads: Vec<i32>,
    used_ns: u64,
}

#[derive(Debug, Default, Clone)]
struct Fake {
    world: Arc<Mutex<World>>,
    /// What freezing and thawing take: the kernel's lock of control groups.
    kernel: Arc<Mutex<()>>,
}

impl Fake {
    fn world(&self) -> std::sync::MutexGuard<'_, World> {
        self.world.lock().unwrap()
    }
    fn said(&self) -> String {
        std::mem::take(&mut self.world().said).join(", ")
    }
}

impl ProcessControl for Fake {
    fn freeze(&self) -> io::Result<()> {
        let _lock = self.kernel.lock().unwrap();
        let mut world = self.world();
        world.said.push("freeze".into());
        if world.freeze_fails {
            return Err(io::ErrorKind::Other.into());
        }
        world.frozen = true;
        Ok(())
    }
    fn thaw(&self) {
        let _lock = self.kernel.lock().unwrap();
        let mut world = self.world();
        world.said.push("thaw".into());
        world.frozen = false;
    }
    fn is_frozen(&self) -> bool {
        self.world().frozen && !self.world().in_kernel
    }
    fn is_stopped(&self, _: i32) -> bool {
        self.world().stopped
    }
    fn stop(&self, main: i32) {
        self.world().said.push(format!("stop {main}"));
        self.world().stopped = true;
    }
    fn go_on(&self, main: i32) {
        self.world().said.push(format!("go on {main}"));
        self.world().stopped = false;
    }
    fn each_thread(&self, each: &mut dyn FnMut(i32)) {
        let threads = self.world().threads.clone();
        threads.into_iter().for_each(each);
    }
    fn promote(&self, tid: i32, priority: u8) {
        let level = if priority == 40 { String::new() } else { format!(" to {priority}") };
        self.world().said.push(format!("promote {tid}{level}"));
        self.world().real_time.push(tid);
    }
    fn demote(&self, tid: i32) -> bool {
        let mut world = self.world();
        let was = world.real_time.contains(&tid);
        world.real_time.retain(|other| *other != tid);
        if was {
            world.said.push(format!("demote {tid}"));
        }
        was
    }
    fn place(&self, tid: i32, core: u32) {
        self.world().said.push(format!("{tid} to {core}"));
    }
    fn used_ns(&self, _: i32) -> Option<u64> {
        Some(self.world().used_ns)
    }
    fn now_ns(&self) -> u64 {
        self.world().now_ns
    }
}

/// A partition of `count` threads from 10 on, and a child 5, in its window.
fn in_window(count: i32) -> (Fake, TimeGuard) {
    let fake = Fake::default();
    let guard = TimeGuard::new(Box::new(fake.clone()), Some(40));
    let main: Vec<i32> = (10..10 + count).collect();
    fake.world().threads = main.iter().copied().chain([5]).collect();
    guard.admit();
    guard.set_process(10, &main, &[5]);
    guard.let_go();
    fake.said();
    (fake, guard)
}

#[test]
fn threads_are_demoted_before_the_freeze_and_promoted_after_the_thaw() {
    let (fake, guard) = in_window(2);
    guard.hold();
    assert_eq!(fake.said(), "demote 10, demote 11, freeze");
    assert!(guard.look_at_ns().is_some());
    guard.look();
    guard.let_go();
    assert_eq!(fake.said(), "thaw, promote 10 to 41, promote 11");
    assert_eq!(guard.take_escapes(), Escapes::default());
}

#[test]
fn on_the_virtual_clock_a_partition_keeps_its_priority_after_its_word_and_no_freeze_is_looked_at() {
    let (fake, guard) = in_window(1);
    let guard = guard.timeless();
    guard.give_way();
    guard.let_go();
    assert_eq!(fake.said(), "", "as it was");
    fake.world().in_kernel = true;
    guard.hold();
    assert_eq!(guard.look_at_ns(), None);
    guard.let_go();
    assert_eq!(fake.said(), "demote 10, freeze, thaw, promote 10");
    assert_eq!(guard.take_escapes(), Escapes::default());
}

#[test]
fn a_calmed_partition_is_ordinary_work_in_its_windows_too_until_a_successor_comes() {
    let (fake, guard) = in_window(1);
    let guard = guard.timeless();
    guard.calm();
    assert_eq!(fake.said(), "demote 10");
    guard.hold();
    guard.let_go();
    guard.calm();
    assert_eq!(fake.said(), "freeze, thaw");
    guard.reset();
    guard.admit();
    guard.set_process(20, &[20], &[]);
    guard.let_go();
    assert_eq!(fake.said(), "promote 20");
}

#[test]
fn thread_that_kept_its_priority_and_runs_on_is_demoted_at_the_look_and_counted() {
    let (fake, guard) = in_window(2);
    fake.world().in_kernel = true;
    guard.hold();
    // The list of threads changed under the dispatcher's eyes: it missed one.
    fake.world().real_time = vec![11];
    fake.said();
    guard.look();
    assert_eq!((fake.said().as_str(), guard.look_at_ns()), ("demote 11", None));
    assert_eq!(guard.take_escapes(), Escapes { ran_on: 1, ..Escapes::default() });
}

#[test]
fn look_that_comes_after_the_next_window_has_begun_takes_nothing_from_it() {
    let (fake, guard) = in_window(1);
    guard.hold();
    guard.let_go();
    fake.world().frozen = false;
    fake.said();
    guard.look();
    assert_eq!((fake.said().as_str(), guard.take_escapes()), ("", Escapes::default()));
}

#[test]
fn a_demoted_thread_that_waits_for_the_processor_is_no_escape_unless_it_lasts_until_its_next_window() {
    let (fake, guard) = in_window(1);
    fake.world().in_kernel = true;
    guard.hold();
    guard.look();
    assert_eq!(guard.take_escapes(), Escapes::default());
    guard.let_go();
    assert_eq!(guard.take_escapes(), Escapes { stuck: 1, ..Escapes::default() });
}

#[test]
fn a_partition_that_says_it_is_done_loses_its_priority_until_its_next_window() {
    let (fake, guard) = in_window(1);
    guard.give_way();
    assert_eq!(fake.said(), "demote 10");
    fake.world().used_ns += STRAY_NS;
    guard.let_go();
    assert_eq!(fake.said(), "promote 10");
    assert_eq!(guard.take_escapes(), Escapes::default(), "its way to sleep is its own");
}

#[test]
fn a_partition_that_computes_on_after_it_said_it_was_done_is_found_before_its_next_window() {
    let (fake, guard) = in_window(1);
    guard.give_way();
    fake.world().used_ns += STRAY_NS + 1;
    guard.let_go();
    assert_eq!(guard.take_escapes(), Escapes { strayed: 1, ..Escapes::default() });
    fake.world().used_ns += 1_000_000; // in its window
    guard.give_way();
    guard.let_go();
    assert_eq!(guard.take_escapes(), Escapes::default());
}

#[test]
fn what_a_predecessor_did_outside_its_windows_is_not_held_against_its_successor() {
    let (fake, guard) = in_window(1);
    guard.give_way();
    fake.world().used_ns += STRAY_NS + 1;
    guard.let_go();
    guard.reset();
    assert_eq!(guard.take_escapes(), Escapes::default());
}

#[test]
fn a_freeze_that_fails_is_followed_by_signals() {
    let (fake, guard) = in_window(1);
    fake.world().freeze_fails = true;
    guard.hold();
    assert_eq!(fake.said(), "demote 10, freeze, stop 10");
    assert_eq!(guard.look_at_ns(), None, "there is nothing to look at");
    guard.let_go();
    assert_eq!(fake.said(), "go on 10, promote 10");
}

#[test]
fn partition_of_one_thread_is_stopped_by_a_signal_which_takes_no_lock_of_the_machine() {
    let (fake, guard) = in_window(1);
    let guard = guard.of_one_thread();
    guard.set_threads(&[10], &[]);
    guard.hold();
    assert_eq!(fake.said(), "demote 10, stop 10");
    guard.let_go();
    assert_eq!(fake.said(), "go on 10, promote 10");
    guard.set_threads(&[10], &[5]);
    guard.hold();
    assert_eq!(fake.said(), "demote 10, freeze", "it has company, whatever the filter says");
}

#[test]
fn partition_that_somebody_else_has_stopped_is_not_let_go_on_by_its_window() {
    let (fake, guard) = in_window(1);
    let guard = guard.of_one_thread();
    guard.set_threads(&[10], &[]);
    fake.world().stopped = true;
    guard.hold();
    guard.let_go();
    assert_eq!(fake.said(), "demote 10, promote 10");
    assert!(fake.world().stopped);
    assert_eq!(guard.take_escapes(), Escapes::default());
}

#[test]
fn a_thread_that_came_during_the_window_is_promoted_with_the_next_one() {
    let (fake, guard) = in_window(1);
    guard.set_threads(&[10, 11], &[5]);
    guard.hold();
    assert_eq!(fake.said(), "demote 10, freeze");
    guard.let_go();
    assert_eq!(fake.said(), "thaw, promote 10 to 41, promote 11");
}

#[test]
fn a_successor_is_born_free_and_ordinary() {
    let (fake, guard) = in_window(1);
    guard.hold();
    fake.said();
    guard.reset();
    assert_eq!((fake.said().as_str(), fake.world().frozen), ("thaw", false));
    guard.let_go();
    assert_eq!(fake.said(), "", "nobody is promoted, not even the caller");
    guard.hold();
    assert_eq!((fake.said().as_str(), guard.holds()), ("", false), "nobody is held either");
}

#[test]
fn nobody_who_asks_waits_for_whoever_holds_the_kernels_lock() {
    let fake = Fake::default();
    let guard = TimeGuard::new(Box::new(fake.clone()), Some(40));
    let worker = FreezeWorker::new();
    guard.leave_to(&worker);
    guard.set_process(10, &[10], &[]);
    let somebody_else = fake.kernel.lock().unwrap();
    std::thread::scope(|scope| {
        // What the worker does when it is called.
        let at_work = scope.spawn(|| {
            while !guard.holds() {
                std::thread::yield_now();
            }
            guard.settle();
        });
        guard.hold(); // would wait for ever
        guard.let_go();
        assert!(!guard.holds());
        guard.hold();
        drop(somebody_else);
        at_work.join().unwrap();
    });
    guard.settle();
    assert!(fake.world().frozen, "the last word counts");
    assert!(guard.holds() && !guard.awaits_thaw());
    guard.let_go();
    assert!(guard.awaits_thaw(), "its window has begun, and nothing of it runs yet");
    worker.end();
    guard.hold();
    guard.let_go();
    assert!(!guard.awaits_thaw(), "who asks when the worker has ended does it himself");
}

#[test]
fn partition_of_one_thread_is_stopped_and_goes_on_at_once_while_the_worker_is_kept_by_another() {
    let fake = Fake::default();
    let guard = TimeGuard::new(Box::new(fake.clone()), Some(40)).of_one_thread();
    guard.leave_to(&FreezeWorker::new()); // takes calls, and never comes to them
    guard.admit();
    guard.set_process(10, &[10], &[]);
    guard.let_go();
    fake.said();
    let _somebody_else = fake.kernel.lock().unwrap();
    for _ in 0..2 {
        guard.hold();
        assert_eq!((fake.said().as_str(), guard.settles_at_once()), ("demote 10, stop 10", true));
        guard.let_go();
        assert_eq!((fake.said().as_str(), guard.awaits_thaw()), ("go on 10, promote 10", false));
    }
}
