use std::process::{Child, Command};
use std::sync::Mutex;

use super::*;

fn order(folder: &tempfile::TempDir, place: usize, count: usize) -> SharedClock {
    SharedClock { file: folder.path().join("clock"), place, count, back_ns: None }
}

fn join(folder: &tempfile::TempDir, place: usize, count: usize) -> Member {
    Member::join(order(folder, place, count), &format!("m{place}"), Arc::default()).unwrap()
}

/// Instants of one module: steps between them as a little generator gives them, some of them zero.
fn instants(seed: u64, count: usize) -> Vec<u64> {
    let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1;
    let step = || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        Some(state % 7)
    };
    let steps = std::iter::from_fn(step).take(count);
    steps
        .scan(0, |at, step| {
            *at += step;
            Some(*at)
        })
        .collect()
}

/// Runs modules in threads, each through its instants; gives who did what in which order.
fn run(lists: &[Vec<u64>]) -> Vec<(u64, usize)> {
    let folder = tempfile::tempdir().unwrap();
    let done = Mutex::new(Vec::new());
    let acting = AtomicBool::new(false);
    std::thread::scope(|scope| {
        for (place, list) in lists.iter().enumerate() {
            let (folder, done, acting) = (&folder, &done, &acting);
            scope.spawn(move || {
                let member = join(folder, place, lists.len());
                member.await_all(PATIENCE_NS).unwrap();
                for instant in list {
                    member.reach(*instant);
                    assert!(!acting.swap(true, Ordering::SeqCst), "two act at once");
                    done.lock().unwrap().push((*instant, place));
                    acting.store(false, Ordering::SeqCst);
                }
            });
        }
    });
    assert!(!folder.path().join("clock").exists(), "the last one removes the file");
    done.into_inner().unwrap()
}

#[test]
fn modules_act_in_the_order_of_time_and_at_one_instant_in_that_of_their_places() {
    for seed in 0..6 {
        let lists: Vec<_> = (0..4).map(|place| instants(seed * 4 + place, 400)).collect();
        let done = run(&lists);
        assert_eq!(done.len(), 1600);
        assert!(done.is_sorted(), "seed {seed}");
    }
}

#[test]
fn modules_that_end_early_are_not_waited_for() {
    let lists = [vec![0, 5, 9], instants(3, 300), vec![], vec![2]];
    let done = run(&lists);
    assert_eq!(done.len(), 304);
    assert!(done.is_sorted());
}

#[test]
fn one_alone_never_waits() {
    assert_eq!(run(&[vec![3, 3, 4]]), [(3, 0), (3, 0), (4, 0)]);
}

fn sleeper() -> Child {
    Command::new("sleep").arg("1000").spawn().unwrap()
}

#[test]
fn module_that_dies_is_waited_for_no_more_and_the_file_goes_with_the_last() {
    let folder = tempfile::tempdir().unwrap();
    let mut child = sleeper();
    let dying = Member::join_as(order(&folder, 0, 2), "dying", Arc::default(), child.id()).unwrap();
    std::mem::forget(dying); // a process that is killed leaves nothing in order
    let member = join(&folder, 1, 2);
    member.await_all(PATIENCE_NS).unwrap();
    let reached = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let thread = scope.spawn(|| {
            member.reach(7);
            reached.store(true, Ordering::SeqCst);
        });
        std::thread::sleep(std::time::Duration::from_millis(150));
        assert!(!reached.load(Ordering::SeqCst), "it waits for one that lives, however long");
        child.kill().unwrap();
        thread.join().unwrap();
    });
    child.wait().unwrap();
    assert_eq!(member.newly_dead(), ["dying"]);
    assert!(member.newly_dead().is_empty(), "told once");
    drop(member);
    assert!(!folder.path().join("clock").exists());
}

/// One whose process is killed, and another one in its place that lives.
#[test]
fn module_that_was_killed_comes_back_at_its_instant_and_is_waited_for_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut child = sleeper();
    std::mem::forget(Member::join_as(order(&folder, 1, 2), "m1", Arc::default(), child.id()).unwrap());
    let member = join(&folder, 0, 2);
    member.await_all(PATIENCE_NS).unwrap();
    let back = |back_ns| SharedClock { back_ns: Some(back_ns), ..order(&folder, 1, 2) };
    let error = Member::join(back(9), "m1", Arc::default()).unwrap_err().to_string();
    assert!(error.contains("is taken"), "it lives: {error}");
    child.kill().unwrap();
    child.wait().unwrap();
    member.reach(5);
    assert_eq!(member.newly_dead(), ["m1"]);
    let again = Member::join(back(9), "m1", Arc::default()).unwrap();
    member.reach(8); // before it, nobody waits
    let done = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        scope.spawn(|| {
            member.reach(12);
            done.lock().unwrap().push(12);
            member.leave();
        });
        std::thread::sleep(std::time::Duration::from_millis(120));
        done.lock().unwrap().push(9);
        again.reach(13);
        done.lock().unwrap().push(13);
    });
    assert_eq!(done.into_inner().unwrap(), [9, 12, 13]);
    assert!(member.newly_dead().is_empty());
}

#[test]
fn nobody_comes_back_where_nobody_was_or_to_a_time_that_is_over() {
    let folder = tempfile::tempdir().unwrap();
    let member = join(&folder, 0, 2);
    let back = |place, back_ns| SharedClock { back_ns: Some(back_ns), ..order(&folder, place, 2) };
    let refused = |order| Member::join(order, "m", Arc::default()).unwrap_err().to_string();
    assert!(refused(back(1, 50)).contains("nobody had place 1"));
    let mut child = sleeper();
    std::mem::forget(Member::join_as(order(&folder, 1, 2), "m1", Arc::default(), child.id()).unwrap());
    member.await_all(PATIENCE_NS).unwrap();
    child.kill().unwrap();
    child.wait().unwrap();
    member.reach(50);
    assert!(refused(back(1, 50)).contains("beyond the instant"));
}

#[test]
fn module_that_is_asked_to_stop_does_not_wait_for_one_that_hangs() {
    let folder = tempfile::tempdir().unwrap();
    let mut child = sleeper();
    std::mem::forget(Member::join_as(order(&folder, 0, 2), "hangs", Arc::default(), child.id()).unwrap());
    let stop: Arc<AtomicBool> = Arc::default();
    let member = Member::join(order(&folder, 1, 2), "m1", stop.clone()).unwrap();
    member.await_all(PATIENCE_NS).unwrap();
    stop.store(true, Ordering::SeqCst);
    member.reach(1);
    assert!(member.newly_dead().is_empty());
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn module_that_never_joins_is_named_with_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let text = join(&folder, 1, 3).await_all(1).unwrap_err().to_string();
    assert!(text.contains("2 of the 3 modules") && text.contains("place 0 is empty"), "{text}");
    assert!(text.contains("--place, from 0/3 to 2/3"), "{text}");
}

#[test]
fn place_that_is_taken_or_of_a_run_before_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    drop(join(&folder, 0, 2)); // place 1 may still come: the file stays
    let error = Member::join(order(&folder, 0, 2), "again", Arc::default()).unwrap_err().to_string();
    assert!(error.contains("place 0 is taken") && error.contains("new file"), "{error}");
}

#[test]
fn modules_that_count_differently_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let _first = join(&folder, 0, 2);
    let error = Member::join(order(&folder, 1, 3), "m1", Arc::default()).unwrap_err().to_string();
    assert!(error.contains("count 2"), "{error}");
    let error = Member::join(order(&folder, 2, 2), "m2", Arc::default()).unwrap_err().to_string();
    assert!(error.contains("place 2 of 2"), "{error}");
}

#[test]
fn file_that_is_something_else_is_refused_and_left_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    for content in [b"[module.a]\n".to_vec(), vec![b'x'; 4096]] {
        let path = folder.path().join("clock");
        std::fs::write(&path, &content).unwrap();
        let error = Member::join(order(&folder, 0, 1), "m", Arc::default()).unwrap_err().to_string();
        assert!(error.contains("something else"), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), content);
    }
}
