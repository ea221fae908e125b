//! The processes that hold the module's channels.
//!
//! One holds all of them from the start. Channels that are rebuilt get another one: what the first still maps of the old ones is
//! looked at by nobody, and the other channels are not let go. One that ends is followed when a channel of its own is needed.
//! A channel that can not be held is told, and all others are.

use std::cell::RefCell;
use std::fs::File;
use std::io::Read;
use std::os::fd::{AsFd, OwnedFd};
use std::rc::Rc;

use super::base::{Base, Lines};
use bateleur_host::helper::end_helper;
use bateleur_host::helper::orders::{AT, BAD, Order, READY};
use bateleur_monitor::cleanup::EndedHelpers;
use bateleur_monitor::rebuild::NotHeld;
use bateleur_system::spawn::Spawned;
use bateleur_system::time::now_ns;
use bateleur_system::wait::{await_any_end, ended, is_readable};

/// How long a channel holder may take to create every channel before frame 0.
const PATIENCE_NS: u64 = 10_000_000_000;
/// As above while the module runs: the monitor waits for it.
const NEXT_PATIENCE_NS: u64 = 3_000_000_000;
/// After a channel holder could not be followed, its channels are tried again so much later; each time twice as much, up to the most.
const RETRY_NS: (u64, u64) = (50_000_000, 3_200_000_000);

/// One channel holder.
struct ChannelHolder {
    process: Spawned,
    /// Its end tells it to leave.
    _line: File,
    /// The channels that it holds for the module.
    channels: Vec<String>,
}

/// See the module's head.
pub(super) struct ChannelHolders {
    base: Base,
    order: Order,
    list: Vec<ChannelHolder>,
    /// Channels that a channel holder held which has ended.
    unheld: Vec<String>,
    next_try_ns: u64,
    wait_ns: u64,
    ended_helpers: EndedHelpers,
}

impl ChannelHolders {
    /// Creates every channel of the module.
    pub(super) fn begin(
        base: Base,
        order: Order,
        ended_helpers: EndedHelpers,
    ) -> Result<Rc<RefCell<Self>>, NotHeld> {
        let channels: Vec<String> = order.channels.iter().map(|channel| channel.name.clone()).collect();
        let (list, unheld) = (Vec::new(), Vec::new());
        let mut channel_holders =
            Self { base, order, list, unheld, next_try_ns: 0, wait_ns: RETRY_NS.0, ended_helpers };
        let bad = channel_holders.hold(&channels, PATIENCE_NS)?;
        refuse(bad)?;
        Ok(Rc::new(RefCell::new(channel_holders)))
    }

    /// Makes channels anew that nobody is attached to.
    pub(super) fn rebuild(&mut self, channels: &[String]) -> Result<(), NotHeld> {
        self.unheld.retain(|channel| !channels.contains(channel));
        for channel_holder in &mut self.list {
            channel_holder.channels.retain(|channel| !channels.contains(channel));
        }
        // One that holds others too is kept: they must not be without a holder for an instant.
        for channel_holder in self.list.extract_if(.., |channel_holder| channel_holder.channels.is_empty()) {
            end_helper(&channel_holder.process);
        }
        self.base
            .remake(channels)
            .map_err(|error| NotHeld(format!("cannot make their directories: {error}")))?;
        let bad = self.hold(channels, NEXT_PATIENCE_NS);
        if bad.is_err() {
            self.unheld.extend_from_slice(channels);
        }
        refuse(bad?)
    }

    /// Sees that every channel is held; gives those that can not be. Before a clean-up, which would take away a channel that only the
    /// dead one held.
    pub(super) fn tend(&mut self) -> Vec<String> {
        for channel_holder in
            self.list.extract_if(.., |channel_holder| is_readable(channel_holder.process.pidfd.as_fd()))
        {
            let status = ended(&channel_holder.process);
            // It has left something in each of them; cleaned up after when another one holds them.
            if status.is_none_or(|status| !status.success()) {
                self.ended_helpers.borrow_mut().push(channel_holder.process.pid);
            }
            self.unheld.extend(channel_holder.channels);
        }
        if self.unheld.is_empty() || now_ns() < self.next_try_ns {
            return Vec::new();
        }
        let channels = std::mem::take(&mut self.unheld);
        match self.hold(&channels, NEXT_PATIENCE_NS) {
            Ok(bad) => {
                self.wait_ns = RETRY_NS.0;
                bad
            }
            Err(_) => {
                self.unheld = channels;
                self.next_try_ns = now_ns() + self.wait_ns;
                self.wait_ns = (2 * self.wait_ns).min(RETRY_NS.1);
                Vec::new()
            }
        }
    }

    /// Has channel holders hold `channels`; gives those that can not be held, because a channel holder has said so, or ended or hung at them.
    fn hold(&mut self, channels: &[String], patience_ns: u64) -> Result<Vec<String>, NotHeld> {
        let limit_ns = now_ns().saturating_add(patience_ns);
        let (mut left, mut bad) = (channels.to_vec(), Vec::new());
        while !left.is_empty() {
            let (channel_holder, said) = self.start(&left, limit_ns.saturating_sub(now_ns()))?;
            let last_of = |word: &'static str| {
                let words = said.iter().filter_map(move |line| line.strip_prefix(word)?.strip_prefix(' '));
                words.map(str::to_owned)
            };
            let refused: Vec<String> = last_of(BAD).collect();
            left.retain(|channel| !refused.contains(channel));
            bad.extend(refused);
            if said.last().is_some_and(|line| line.trim_end() == READY) {
                self.list.push(ChannelHolder { channels: left, ..channel_holder });
                break;
            }
            end_helper(&channel_holder.process);
            let Some(at) = last_of(AT).next_back().filter(|at| left.contains(at)) else {
                return Err(NotHeld(
                    "the channel holder could not create the module's channels: its reason stands in partitions/helpers.log"
                        .into(),
                ));
            };
            left.retain(|channel| *channel != at);
            bad.push(at);
        }
        Ok(bad)
    }

    /// Starts one for `channels`, and gives what it has said when it was ready, had ended or had taken too long.
    fn start(&self, channels: &[String], patience_ns: u64) -> Result<(ChannelHolder, Vec<String>), NotHeld> {
        let failed = |error: std::io::Error| NotHeld(format!("cannot start the channel holder: {error}"));
        let ordered = self.order.channels.iter().filter(|channel| channels.contains(&channel.name));
        let order = Order { root: self.order.root.clone(), channels: ordered.cloned().collect() };
        let order = serde_json::to_string(&order).map_err(|error| failed(error.into()))?;
        let (reader, writer) = std::io::pipe().map_err(failed)?;
        let (answer, answers) = std::io::pipe().map_err(failed)?;
        let (reader, answers) = (OwnedFd::from(reader), OwnedFd::from(answers));
        let lines = Lines { input: Some(&reader), output: Some(&answers), ..Lines::default() };
        let process = self.base.helper(&["channel-holder".into(), order], lines).map_err(failed)?;
        drop(answers);
        let channel_holder =
            ChannelHolder { process, _line: File::from(OwnedFd::from(writer)), channels: Vec::new() };
        Ok((channel_holder, words_until_ready(&File::from(OwnedFd::from(answer)), patience_ns)))
    }
}

/// An error where a channel could not be held.
fn refuse(bad: Vec<String>) -> Result<(), NotHeld> {
    match bad.as_slice() {
        [] => Ok(()),
        bad => Err(NotHeld(format!(
            "the channel holder could not create {}: its reason stands in partitions/helpers.log",
            bad.join(", ")
        ))),
    }
}

/// The lines that a channel holder says, until it is ready, ends, or has taken too long.
fn words_until_ready(mut answer: &File, patience_ns: u64) -> Vec<String> {
    let limit_ns = now_ns().saturating_add(patience_ns);
    let (mut said, mut piece) = (Vec::new(), [0; 512]);
    loop {
        await_any_end(&[answer.as_fd()], limit_ns.saturating_sub(now_ns()));
        if !is_readable(answer.as_fd()) {
            break;
        }
        match answer.read(&mut piece) {
            Ok(count) if count > 0 => said.extend_from_slice(&piece[..count]),
            _ => break,
        }
        if said.ends_with(format!("{READY} \n").as_bytes()) {
            break;
        }
    }
    String::from_utf8_lossy(&said).lines().map(str::to_owned).collect()
}
