//! One virtual clock for several modules: their processes, on one machine, take their windows in one order.
//!
//! A module may do what is due at an instant when every other one is done with all that is due earlier; at one instant the
//! place in the list decides. So exactly one of them acts at a time, the order of all windows is total, and it is the same in
//! every run. Who starts partitions again or waits for its companion takes no module time: the others wait for it in real
//! time, for as long as its process lives. A module that ends or dies is waited for no more.
//! One that was there and is gone may come back, as another process, while somebody who acts waits until it has.

use std::fs::{File, OpenOptions};
use std::io;
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use bateleur_contract::{Mapped, MappingError};
use rustix::process::{Pid, PidfdFlags, pidfd_open};
use serde::{Deserialize, Serialize};

use crate::dispatcher::{Meanwhile, Pace};
use bateleur_system::time::now_ns;
use bateleur_system::wait::is_readable;
use page::{MOST, Page, Refusal, State};

mod page;

/// How long the others may take to start, real time, ns: their partitions' `startup_timeout` and a busy machine.
pub const PATIENCE_NS: u64 = 60_000_000_000;
/// How often whoever waits looks whether it waits for a process that has died, ns.
const LOOK_NS: u64 = 50_000_000;
/// How long one that was asked to stop still waits for its turn, ns: long enough for modules that live.
const STOP_PATIENCE_NS: u64 = 1_000_000_000;

/// What a module is told about those it shares the virtual clock with.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct SharedClock {
    /// The file that they share; the first makes it, the last removes it.
    pub file: PathBuf,
    /// This module's place among them, from 0. At one instant the lower place comes first.
    pub place: usize,
    /// How many they are.
    pub count: usize,
    /// It was there before and its process is gone: the instant of module time at which its windows begin again, ns.
    pub back_ns: Option<u64>,
}

/// Why a module can not share a clock.
#[derive(Debug, thiserror::Error)]
pub enum SharedClockError {
    /// A place that there can not be.
    #[error(
        "place {place} of {count} modules on one virtual clock: places count from 0, and there are {MOST} at most"
    )]
    Place {
        /// What was asked for.
        place: usize,
        /// Of how many.
        count: usize,
    },
    /// The file can not be used.
    #[error("the file {file} for several modules on one virtual clock: {why}")]
    File {
        /// The file.
        file: PathBuf,
        /// Why.
        why: String,
    },
    /// Somebody did not come.
    #[error(
        "{missing} of the {count} modules on this virtual clock did not join {file} within {patience_s} s: start every one \
         with --together {file} and its --place, from 0/{count} to {last}/{count}; place {first} is empty"
    )]
    Missing {
        /// How many.
        missing: usize,
        /// The first of their places.
        first: usize,
        /// Of how many.
        count: usize,
        /// The highest place.
        last: usize,
        /// The file.
        file: PathBuf,
        /// How long it was waited, s.
        patience_s: u64,
    },
}

/// One module among those on one virtual clock.
#[derive(Debug)]
pub struct Member {
    page: Mapped<Page>,
    order: SharedClock,
    stop: Arc<AtomicBool>,
    /// By place: the process, once all have joined.
    processes: Mutex<Vec<Process>>,
    /// By place: that it has died was told.
    told: Mutex<Vec<bool>>,
}

/// The process of a module.
#[derive(Debug)]
struct Process {
    pid: u32,
    /// `None` if it is gone already.
    descriptor: Option<OwnedFd>,
}

impl Process {
    fn of(pid: u32) -> Self {
        let raw = Pid::from_raw(pid as i32);
        Self { pid, descriptor: raw.and_then(|raw| pidfd_open(raw, PidfdFlags::empty()).ok()) }
    }

    fn has_died(&self) -> bool {
        self.descriptor.as_ref().is_none_or(|descriptor| is_readable(descriptor.as_fd()))
    }
}

/// Nobody panics while holding one of these locks.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Member {
    /// Takes the place of module `name`. `stop`: set when it is asked to end.
    ///
    /// # Errors
    /// The file is not one of these, belongs to a run before, or the place is taken.
    pub fn join(order: SharedClock, name: &str, stop: Arc<AtomicBool>) -> Result<Self, SharedClockError> {
        Self::join_as(order, name, stop, std::process::id())
    }

    fn join_as(
        order: SharedClock,
        name: &str,
        stop: Arc<AtomicBool>,
        pid: u32,
    ) -> Result<Self, SharedClockError> {
        let (place, count) = (order.place, order.count);
        if place >= count || count > MOST {
            return Err(SharedClockError::Place { place, count });
        }
        let failed = |why: String| SharedClockError::File { file: order.file.clone(), why };
        let file = open(&order.file).map_err(|error| failed(error.to_string()))?;
        let page = Mapped::<Page>::new(&file).map_err(|error: MappingError| failed(error.to_string()))?;
        let claimed = match order.back_ns {
            None => page.claim(place, count, pid, name),
            // The one before is gone, or it is not for another to take its place.
            Some(_) if page.pid(place) != 0 && !Process::of(page.pid(place)).has_died() => {
                Err(Refusal::Taken)
            }
            Some(back_ns) => page.claim_again(place, count, pid, back_ns),
        };
        claimed.map_err(|refusal| failed(refusal_text(refusal, place)))?;
        let told = Mutex::new(vec![false; count]);
        Ok(Self { page, order, stop, processes: Mutex::default(), told })
    }

    /// Waits until every module has joined, at most `patience_ns` of real time, or until it is asked to stop.
    ///
    /// # Errors
    /// Somebody did not come.
    pub fn await_all(&self, patience_ns: u64) -> Result<(), SharedClockError> {
        let begun_ns = now_ns();
        while !self.stop.load(Ordering::Acquire) {
            let absent: Vec<usize> =
                self.page.places().filter(|place| self.page.state(*place) == State::Absent).collect();
            let Some(first) = absent.first() else { break };
            if now_ns() - begun_ns > patience_ns {
                return Err(SharedClockError::Missing {
                    missing: absent.len(),
                    first: *first,
                    count: self.order.count,
                    last: self.order.count - 1,
                    file: self.order.file.clone(),
                    patience_s: patience_ns / 1_000_000_000,
                });
            }
            self.page.sleep(self.order.place, self.page.turns(self.order.place), 5_000_000);
        }
        let mut processes = lock(&self.processes);
        if processes.is_empty() {
            *processes = self.page.places().map(|place| Process::of(self.page.pid(place))).collect();
        }
        Ok(())
    }

    /// Returns when everything is done that is due before `instant_ns` of module time, in every module.
    pub fn reach(&self, instant_ns: u64) {
        let own = self.order.place;
        self.page.reach(own, instant_ns);
        let mut stopping_ns = None;
        loop {
            let turns = self.page.turns(own);
            let Some(first) = self.page.first().filter(|first| *first != own) else { return };
            self.page.sleep(own, turns, LOOK_NS);
            if self.page.turns(own) != turns {
                continue;
            }
            if self.has_died(first) {
                self.page.end(first, State::Dead);
            }
            if self.stop.load(Ordering::Acquire) {
                let since_ns = *stopping_ns.get_or_insert_with(now_ns);
                if now_ns() - since_ns > STOP_PATIENCE_NS {
                    return; // who hangs there must not keep this one from ending
                }
            }
        }
    }

    /// This module takes no part any more: nobody waits for it.
    pub fn leave(&self) {
        self.page.end(self.order.place, State::Ended);
    }

    /// The other modules that have died since the last call, by name.
    #[must_use]
    pub fn newly_dead(&self) -> Vec<String> {
        let mut told = lock(&self.told);
        let mut news = Vec::new();
        for (place, told) in told.iter_mut().enumerate() {
            let is_dead = self.page.state(place) == State::Dead;
            if is_dead && !*told {
                news.push(self.page.name(place));
            }
            *told = is_dead; // one that has come back may die again
        }
        news
    }

    fn has_died(&self, place: usize) -> bool {
        let mut processes = lock(&self.processes);
        // `None`: it was asked to stop before all had joined.
        let Some(process) = processes.get_mut(place) else { return false };
        let pid = self.page.pid(place);
        if process.pid != pid {
            *process = Process::of(pid); // it has come back as another one
        }
        process.has_died()
    }
}

impl Drop for Member {
    fn drop(&mut self) {
        self.leave();
        let runs = |place| self.page.state(place) == State::Running && !self.has_died(place);
        let awaited = |place| self.page.state(place) == State::Absent;
        if !self.page.places().any(|place| runs(place) || awaited(place)) {
            let _ = std::fs::remove_file(&self.order.file); // another one was quicker
        }
    }
}

/// Opens the file, made where it is missing. One that is something else is left as it is.
fn open(path: &Path) -> io::Result<File> {
    let nofollow = rustix::fs::OFlags::NOFOLLOW.bits() as i32;
    let file = OpenOptions::new()
        .read(true)
        .write(true)
        .create(true)
        .truncate(false)
        .mode(0o600)
        .custom_flags(nofollow)
        .open(path)?;
    match file.metadata()?.len() {
        0 => file.set_len(size_of::<Page>() as u64)?,
        length if length == size_of::<Page>() as u64 => {}
        length => {
            let text =
                format!("it has {length} bytes and is something else: give a name that nothing has yet");
            return Err(io::Error::other(text));
        }
    }
    Ok(file)
}

fn refusal_text(refusal: Refusal, place: usize) -> String {
    match refusal {
        Refusal::NeverThere => format!("nobody had place {place}: nobody can come back to it"),
        Refusal::Over => "all others have gone beyond the instant at which it should come back".into(),
        Refusal::NotOurs => {
            "it is something else, or of another version: give a name that nothing has yet".into()
        }
        Refusal::Count(count) => {
            format!("the modules that have joined count {count}: say the same for every one")
        }
        Refusal::Taken => format!(
            "place {place} is taken, by a module that runs or by one of a run before: give each module a place of its own, and \
             every run a new file"
        ),
    }
}

/// Time passes in the order of all modules.
#[derive(Debug)]
pub struct JointPace<'a>(pub &'a Member);

impl Pace for JointPace<'_> {
    fn reach(&mut self, instant_ns: u64, _: &mut dyn Meanwhile) -> u64 {
        self.0.reach(instant_ns);
        0
    }

    fn pass(&mut self, _: u64, _: &mut dyn Meanwhile) -> u64 {
        0 // nothing of the others depends on it
    }
}

#[cfg(test)]
mod tests;
