//! The flights of a campaign, side by side: one worker for each, one processor for each worker.
//!
//! Responsible for: flying every order once, writing each result down as soon as it is there, and cleaning up behind flights. A flight's
//! processes inherit their worker's processor. It must never be stopped by a flight; a disk that takes no more results stops it.

use std::collections::VecDeque;
use std::fs::File;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use bateleur_report::campaign::{Flown, append};
use bateleur_system::sched;

use super::flight::{self, Order};

/// Between two lines of progress.
const REPORT: Duration = Duration::from_secs(30);

/// How the orders are flown.
pub(super) struct Fleet {
    /// Flights side by side.
    pub(super) jobs: usize,
    /// Processors to fly on.
    pub(super) cores: Vec<u32>,
    /// Logs of completed flights stay.
    pub(super) keep: bool,
    /// Of how many failed flights the logs stay.
    pub(super) keep_failed: u64,
    /// Of how many they are there already.
    pub(super) kept: u64,
    /// Somebody wants it to end.
    pub(super) stop: Arc<AtomicBool>,
}

/// What the workers share.
struct Common {
    orders: Mutex<VecDeque<Order>>,
    results: Mutex<File>,
    /// Failed flights whose logs were kept.
    kept: AtomicU64,
    progress: Mutex<Progress>,
    failure: Mutex<Option<std::io::Error>>,
}

struct Progress {
    begun: Instant,
    told: Instant,
    all: usize,
    flown: usize,
    failed: usize,
}

/// A worker that panicked has left nothing half-done behind these locks.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Fleet {
    /// Flies all of them, or as many as there is time for.
    ///
    /// # Errors
    /// When a result can not be written.
    pub(super) fn fly(&self, orders: VecDeque<Order>, results: File) -> Result<()> {
        let now = Instant::now();
        let all = orders.len();
        let common = Common {
            orders: Mutex::new(orders),
            results: Mutex::new(results),
            kept: AtomicU64::new(self.kept),
            progress: Mutex::new(Progress { begun: now, told: now, all, flown: 0, failed: 0 }),
            failure: Mutex::new(None),
        };
        std::thread::scope(|scope| {
            for worker in 0..self.jobs.min(all) {
                let common = &common;
                scope.spawn(move || self.work(worker, common));
            }
        });
        match lock(&common.failure).take() {
            Some(error) => Err(error).context("cannot write a result; the flights so far are kept"),
            None => Ok(()),
        }
    }

    fn work(&self, worker: usize, common: &Common) {
        if let Some(core) = self.cores.get(worker % self.cores.len().max(1)) {
            let _ = sched::bind(0, &[*core]); // slower otherwise, nothing else
        }
        while !self.stop.load(Ordering::Acquire) {
            let Some(order) = lock(&common.orders).pop_front() else { return };
            let Some(mut flown) = flight::fly(&order, &self.stop) else { return remove(&order.folder) };
            self.tidy(&order, &mut flown, common);
            if let Err(error) = append(&mut lock(&common.results), &flown) {
                *lock(&common.failure) = Some(error);
                self.stop.store(true, Ordering::Release);
            }
            lock(&common.progress).take(&flown);
        }
    }

    /// Removes what nobody needs: the disk does not grow with the number of flights.
    fn tidy(&self, order: &Order, flown: &mut Flown, common: &Common) {
        let wanted = if flown.completed {
            self.keep
        } else {
            self.keep || common.kept.fetch_add(1, Ordering::AcqRel) < self.keep_failed
        };
        if wanted {
            flown.folder = Some(order.folder.clone());
        } else {
            remove(&order.folder);
        }
    }
}

fn remove(folder: &Path) {
    let _ = std::fs::remove_dir_all(folder); // what stays is removed when the campaign goes on
}

impl Progress {
    fn take(&mut self, flown: &Flown) {
        self.flown += 1;
        if !flown.completed {
            self.failed += 1;
            let reason = flown.failure.as_deref().unwrap_or("the mission was not completed");
            eprintln!("flight {}: {reason}\n  {}", flown.number, flown.command);
        }
        if self.told.elapsed() >= REPORT || self.flown == self.all {
            self.told = Instant::now();
            let hours = self.begun.elapsed().as_secs_f64() / 3600.0;
            let pace = self.flown as f64 / hours.max(1e-9);
            let left_min = (self.all - self.flown) as f64 / pace * 60.0;
            eprintln!(
                "{} of {} flown, {} failed, {pace:.0} flights an hour, {left_min:.0} min left",
                self.flown, self.all, self.failed
            );
        }
    }
}
