//! A recording that drives the inputs of a module on the virtual clock. A player, a process of the helpers' user, writes the messages: it
//! is told before each window how far module time has come.
//!
//! What a partition would have written in its window is there when that window begins; what an operator would have written, before
//! the first window that begins at the message's time or later.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, OwnedFd};

use bateleur_host::helper::playing::{OPERATORS, ORDER_BYTES};
use bateleur_system::spawn::Spawned;
use bateleur_system::wait::{await_any_end, is_readable};
use bateleur_time::dispatcher::Occurrence;

/// How long it may take to attach itself, real time.
const ATTACH_PATIENCE_NS: u64 = 20_000_000_000;
/// How long it may take for the messages of a window, real time.
const PATIENCE_NS: u64 = 5_000_000_000;

/// See the module's head.
pub struct Player {
    _process: Spawned,
    orders: File,
    answers: File,
    /// The groups of the partitions that are not started, by the partitions' places in the plan.
    groups: BTreeMap<usize, u32>,
    /// The instant of the next message of each group.
    next_ns: BTreeMap<u32, u64>,
}

impl Player {
    /// Starts it with a line for orders and a line for answers, and waits until it is attached.
    ///
    /// # Errors
    /// It could not be started, or ended at once.
    pub fn start(
        groups: BTreeMap<usize, u32>,
        start: impl FnOnce(&OwnedFd, &OwnedFd) -> io::Result<Spawned>,
    ) -> io::Result<Self> {
        let (order_end, orders) = io::pipe()?;
        let (answers, answer_end) = io::pipe()?;
        let (order_end, answer_end) = (OwnedFd::from(order_end), OwnedFd::from(answer_end));
        let process = start(&order_end, &answer_end)?;
        drop(answer_end);
        let next_ns = groups.values().copied().chain([OPERATORS]).map(|group| (group, 0)).collect();
        let (orders, answers) = (File::from(OwnedFd::from(orders)), File::from(OwnedFd::from(answers)));
        let mut player = Self { _process: process, orders, answers, groups, next_ns };
        player.answer(ATTACH_PATIENCE_NS)?;
        Ok(player)
    }

    /// A window begins.
    ///
    /// # Errors
    /// The player has ended, or does not answer.
    pub(crate) fn before_window(&mut self, occurrence: &Occurrence) -> io::Result<()> {
        self.play(OPERATORS, occurrence.start_ns.saturating_add(1))?;
        match self.groups.get(&occurrence.window.partition.index()) {
            None => Ok(()),
            Some(&group) => self.play(group, occurrence.end_ns),
        }
    }

    fn play(&mut self, group: u32, before_ns: u64) -> io::Result<()> {
        if self.next_ns.get(&group).is_none_or(|&next_ns| next_ns >= before_ns) {
            return Ok(());
        }
        let mut order = [0; ORDER_BYTES];
        order[..4].copy_from_slice(&group.to_le_bytes());
        order[4..].copy_from_slice(&before_ns.to_le_bytes());
        self.orders.write_all(&order)?;
        let next_ns = self.answer(PATIENCE_NS)?;
        self.next_ns.insert(group, next_ns);
        Ok(())
    }

    fn answer(&mut self, patience_ns: u64) -> io::Result<u64> {
        await_any_end(&[self.answers.as_fd()], patience_ns);
        if !is_readable(self.answers.as_fd()) {
            return Err(io::Error::new(io::ErrorKind::TimedOut, "it does not answer"));
        }
        let mut answer = [0; size_of::<u64>()];
        self.answers.read_exact(&mut answer)?;
        Ok(u64::from_le_bytes(answer))
    }
}
