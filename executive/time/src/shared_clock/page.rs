//! The file that modules on one virtual clock share: for each of them the instant that it has reached, and whether it
//! still runs.
//!
//! Responsible for: who is first. It must never wait, and it knows no processes: whether one has died is found out by
//! whoever waits for it. Every word is an atomic; instants only grow, so that who is found to be first stays first until it
//! says something else itself. Whoever comes back after its end comes at an instant that is later than the first one's.
#![allow(unsafe_code)] // one `unsafe impl`, a promise about this type

use std::sync::atomic::Ordering::SeqCst;
use std::sync::atomic::{AtomicU32, AtomicU64};

use bateleur_contract::SharedMemory;
use bateleur_system::time::timespec;
use rustix::thread::futex;

/// First word of the file: what it is, and the version of its layout.
const MAGIC: u64 = 0x4254_4c52_544f_4701; // "BTLRTOG", 1
/// Modules that fit.
pub(super) const MOST: usize = 63;
/// Bytes of a name that are kept.
const NAME: usize = 40;
/// It has no instant any more: it has ended.
const OVER: u64 = u64::MAX;

/// Whether a module takes part.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum State {
    /// It has not joined.
    Absent,
    /// It runs.
    Running,
    /// It has ended.
    Ended,
    /// Its process died.
    Dead,
}

/// One module, on a cache line of its own.
#[derive(Debug)]
#[repr(C, align(64))]
struct Line {
    /// What it does next happens at this instant of module time, ns. What is at an earlier one is done.
    next_ns: AtomicU64,
    /// Sleeps on this word while it is not its turn; whoever makes it so counts it up.
    turn: AtomicU32,
    /// A [`State`].
    state: AtomicU32,
    /// Its process; 0: nobody has this place.
    pid: AtomicU32,
    name_bytes: AtomicU32,
    name: [AtomicU64; NAME / 8],
}

/// See the module's head.
#[derive(Debug)]
#[repr(C, align(4096))]
pub(super) struct Page {
    magic: AtomicU64,
    /// Modules that share the clock.
    count: AtomicU32,
    reserved: [AtomicU32; 13],
    lines: [Line; MOST],
}

const _: () = assert!(size_of::<Line>() == 64 && size_of::<Page>() == 4096);

// SAFETY: every field is an atomic or an array of atomics, for which every bit pattern is a value.
unsafe impl SharedMemory for Page {}

/// Why a place can not be taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Refusal {
    /// The file is something else.
    NotOurs,
    /// The others count so many modules.
    Count(u32),
    /// Somebody has, or had, this place.
    Taken,
    /// Nobody has had this place: there is nobody to come back.
    NeverThere,
    /// Somebody is at a later instant already.
    Over,
}

impl Page {
    /// Takes `place` among `count` modules.
    pub(super) fn claim(&self, place: usize, count: usize, pid: u32, name: &str) -> Result<(), Refusal> {
        let set = |word: &AtomicU32, value: u32| match word.compare_exchange(0, value, SeqCst, SeqCst) {
            Ok(_) => Ok(()),
            Err(there) => Err(there),
        };
        match self.magic.compare_exchange(0, MAGIC, SeqCst, SeqCst) {
            Ok(_) | Err(MAGIC) => {}
            Err(_) => return Err(Refusal::NotOurs),
        }
        set(&self.count, count as u32)
            .or_else(|there| if there == count as u32 { Ok(()) } else { Err(Refusal::Count(there)) })?;
        let line = &self.lines[place];
        set(&line.pid, pid).map_err(|_| Refusal::Taken)?;
        line.name(name);
        line.state.store(State::Running as u32, SeqCst);
        Ok(())
    }

    /// Takes `place` for a module that had it and is gone, as the caller has made sure: it acts again from `instant_ns` on. What
    /// keeps the order total is that somebody else acts meanwhile, and waits until this has been done.
    pub(super) fn claim_again(
        &self,
        place: usize,
        count: usize,
        pid: u32,
        instant_ns: u64,
    ) -> Result<(), Refusal> {
        if self.magic.load(SeqCst) != MAGIC {
            return Err(Refusal::NotOurs);
        }
        let known = self.count.load(SeqCst);
        if known != count as u32 {
            return Err(Refusal::Count(known));
        }
        if self.pid(place) == 0 {
            return Err(Refusal::NeverThere);
        }
        let others = self.places().filter(|other| *other != place);
        let mut instants = others.map(|other| self.lines[other].next_ns.load(SeqCst));
        if !instants.any(|next_ns| next_ns < instant_ns) {
            return Err(Refusal::Over);
        }
        let line = &self.lines[place];
        line.pid.store(pid, SeqCst);
        line.next_ns.store(instant_ns.min(OVER - 1), SeqCst);
        line.state.store(State::Running as u32, SeqCst);
        Ok(())
    }
}

impl Line {
    fn name(&self, name: &str) {
        let length = (0..=name.len().min(NAME)).rev().find(|&end| name.is_char_boundary(end)).unwrap_or(0);
        let mut bytes = [0; NAME];
        bytes[..length].copy_from_slice(&name.as_bytes()[..length]);
        for (word, chunk) in self.name.iter().zip(bytes.as_chunks().0) {
            word.store(u64::from_le_bytes(*chunk), SeqCst);
        }
        self.name_bytes.store(length as u32, SeqCst);
    }
}

impl Page {
    /// The name of the module at `place`.
    pub(super) fn name(&self, place: usize) -> String {
        let line = &self.lines[place];
        let mut bytes = [0; NAME];
        for (word, chunk) in line.name.iter().zip(bytes.as_chunks_mut::<8>().0) {
            *chunk = word.load(SeqCst).to_le_bytes();
        }
        String::from_utf8_lossy(&bytes[..(line.name_bytes.load(SeqCst) as usize).min(NAME)]).into_owned()
    }

    /// The process of the module at `place`.
    pub(super) fn pid(&self, place: usize) -> u32 {
        self.lines[place].pid.load(SeqCst)
    }

    /// Whether the module at `place` takes part.
    pub(super) fn state(&self, place: usize) -> State {
        match self.lines[place].state.load(SeqCst) {
            1 => State::Running,
            2 => State::Ended,
            3 => State::Dead,
            _ => State::Absent,
        }
    }

    /// The places of all modules.
    pub(super) fn places(&self) -> std::ops::Range<usize> {
        0..(self.count.load(SeqCst) as usize).min(MOST)
    }

    /// Whose turn it is: the earliest instant, and of equal ones the first place. A module that has not joined stands at 0.
    /// `None` if all have ended.
    pub(super) fn first(&self) -> Option<usize> {
        let instants = self.places().map(|place| (self.lines[place].next_ns.load(SeqCst), place));
        instants.min().filter(|(next_ns, _)| *next_ns != OVER).map(|(_, place)| place)
    }

    /// The module at `place` is done with everything before `instant_ns`. Wakes whose turn it is by that.
    pub(super) fn reach(&self, place: usize, instant_ns: u64) {
        self.lines[place].next_ns.fetch_max(instant_ns.min(OVER - 1), SeqCst);
        self.hand_on(place);
    }

    /// The module at `place` takes no part any more.
    pub(super) fn end(&self, place: usize, state: State) {
        let line = &self.lines[place];
        let running = State::Running as u32;
        let _ = line.state.compare_exchange(running, state as u32, SeqCst, SeqCst); // what ended it first counts
        line.next_ns.store(OVER, SeqCst);
        self.hand_on(place);
    }

    /// Wakes whose turn it is, unless that is the caller's, at `own`.
    fn hand_on(&self, own: usize) {
        let Some(first) = self.first().filter(|first| *first != own) else { return };
        let turn = &self.lines[first].turn;
        turn.fetch_add(1, SeqCst);
        let _ = futex::wake(turn, futex::Flags::empty(), 1); // it does not sleep: it looks before it does
    }

    /// Sleeps until somebody says that it may be the turn of `place`, at most `nanoseconds`; at once if that was said since
    /// [`Page::turns`] gave `seen`.
    pub(super) fn sleep(&self, place: usize, seen: u32, nanoseconds: u64) {
        let limit = timespec(nanoseconds);
        // Any end: the caller looks.
        let _ = futex::wait(&self.lines[place].turn, futex::Flags::empty(), seen, Some(&limit));
    }

    /// How often it was said that it may be the turn of `place`.
    pub(super) fn turns(&self, place: usize) -> u32 {
        self.lines[place].turn.load(SeqCst)
    }
}
