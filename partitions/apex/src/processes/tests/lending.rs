//! Processes that sleep outside of services, on the wall clock.

use std::sync::Condvar;

use super::*;

fn compute_ms(span: u64) {
    let begun = Instant::now();
    while begun.elapsed() < Duration::from_millis(span) {
        std::hint::spin_loop();
    }
}

/// A lock of the program's own that `low` is preempted with, and that `high` wants: how often both had it when `high` had it 20 times.
fn shared_lock(middle: bool) -> (u32, u32) {
    let lock = Arc::new(Mutex::new(()));
    let [high, low] = [(); 2].map(|()| Arc::new(AtomicU32::new(0)));
    let (its_high, its_low) = (high.clone(), low.clone());
    let (kernel, _) = partition(Clock::Wall, move |partition, _| {
        let (one, other) = (lock.clone(), lock);
        partition.process("high", Every::once().priority(20), move |process| {
            loop {
                process.timed_wait(2 * MS)?;
                drop(one.lock().unwrap());
                its_high.fetch_add(1, Relaxed);
            }
        })?;
        if middle {
            partition.process("middle", Every::once().priority(15), |process| {
                loop {
                    process.timed_wait(MS)?;
                }
            })?;
        }
        partition.process("low", Every::once().priority(10), move |_| {
            loop {
                let held = other.lock().unwrap();
                compute_ms(3);
                drop(held);
                its_low.fetch_add(1, Relaxed);
                compute_ms(1);
            }
        })?;
        Ok(())
    });
    windows_until(&kernel, || high.load(Relaxed) >= 20);
    (high.load(Relaxed), low.load(Relaxed))
}

#[test]
fn lock_of_a_preempted_process_does_not_stop_the_partition() {
    let (high, low) = shared_lock(false);
    assert!(high >= 20 && low >= 10, "{high} {low}");
}

#[test]
fn lock_of_a_preempted_process_is_given_up_although_a_third_one_runs_between() {
    shared_lock(true);
}

#[test]
fn process_that_sleeps_by_other_means_than_services_lets_others_run() {
    let rounds = Arc::new(AtomicU32::new(0));
    let own = rounds.clone();
    let (kernel, _) = partition(Clock::Wall, |partition, _| {
        partition.process("sleeps", Every::once().priority(20), |_| {
            loop {
                std::thread::sleep(Duration::from_secs(1000));
            }
        })?;
        let never = (Mutex::new(false), Condvar::new());
        partition.process("awaits", Every::once().priority(15), move |_| {
            let mut guard = never.0.lock().unwrap();
            while !*guard {
                guard = never.1.wait(guard).unwrap();
            }
            Ok(())
        })?;
        partition.process("low", Every::once().priority(10), move |process| {
            loop {
                process.timed_wait(MS)?;
                own.fetch_add(1, Relaxed);
            }
        })?;
        Ok(())
    });
    windows_until(&kernel, || rounds.load(Relaxed) >= 20);
}

#[test]
fn lock_that_an_error_handler_wants_is_given_up() {
    let lock = Arc::new(Mutex::new(()));
    let handled = Arc::new(AtomicU32::new(0));
    let own = handled.clone();
    let (kernel, _) = partition(Clock::Wall, move |partition, _| {
        let (one, other) = (lock.clone(), lock);
        let holds = partition.process("holds", Every::once().priority(10), move |_| {
            let held = other.lock().unwrap();
            compute_ms(20);
            drop(held);
            Ok(())
        })?;
        partition.process("late", Every::once().priority(20).deadline_ms(2), |process| {
            process.timed_wait(3 * MS)?;
            process.call(|services| services.suspend_self(FOREVER)).map(drop)
        })?;
        partition.error_handler(move |process| {
            while process.call(|services| services.get_error_status()).is_ok() {
                drop(one.lock().unwrap());
                own.fetch_add(1, Relaxed);
            }
            let _ = holds;
            Ok(())
        })
    });
    windows_until(&kernel, || handled.load(Relaxed) >= 1);
}
