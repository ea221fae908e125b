//! The log of the ports: the process that writes it, and what becomes of the log when that process ends.
//!
//! The recorder reads memory that partitions share, so what one of them has written over may end it. Then it is cleaned up after and
//! followed by another one, which goes on in a file of its own, the next part of the log. A channel at which two
//! recorders in a row have ended is left out until it has been rebuilt. On the wall clock nobody waits for any of this;
//! it must never hold up the module, and never start recorders for ever.

use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::sync::atomic::AtomicU32;
use std::sync::atomic::Ordering::Relaxed;

use bateleur_contract::{Clock, Mapped};

use bateleur_host::helper::recording::{ATTACH_ANEW, LEFT_OUT, NO_ROOM, READ};
use bateleur_monitor::Monitor;
use bateleur_monitor::event::Event;
use bateleur_system::cpu_starvation::{STARVED_PATIENCE_NS, Spell, waits_for_disk};
use bateleur_system::spawn::Spawned;
use bateleur_system::time::now_ns;
use bateleur_system::wait::{await_any_end, ended, is_readable, is_victim};

/// How long the first recorder may take to attach itself, real time.
const ATTACH_PATIENCE_NS: u64 = 20_000_000_000;
/// How long one may take to answer in flight, real time, and then for itself: waits for a processor or a disk are not counted, for
/// [`STARVED_PATIENCE_NS`] at most. On the wall clock nobody waits for it meanwhile: what partitions write in that time is read later, as far
/// as it still stands.
const PATIENCE_NS: u64 = 5_000_000_000;
const OWN_PATIENCE_NS: u64 = 1_000_000_000;
/// How long the end of one that is ended may take, real time.
const END_PATIENCE_NS: u64 = 1_000_000_000;
/// How long a dead one may wait until no partition is being restarted, real time: it was attached to every channel, the
/// damaged ones among them, and there is one channel cleaner for all.
const RESPECT_NS: u64 = 3_000_000_000;
/// Parts of a log, most: whoever damages channels for ever must not fill the disk with beginnings.
const MOST_PARTS: u32 = 16;

/// Room on the disk, in bytes, with which a log that the lack of it has ended goes on: half a minute of a flight.
const ROOM: u64 = 4 << 20;
/// Between two looks whether there is room, real time.
const LOOK_FOR_ROOM_NS: u64 = 1_000_000_000;

/// Where a recorder that has ended leaves its reason.
const ENDED: &str = "the recorder has ended or does not answer; its reason stands in partitions/helpers.log";

/// Starts the recorder of a part of the log, the number of which is given, without the channels of these names.
pub type StartRecorder = Box<dyn Fn(u32, &[String]) -> io::Result<Recorder>>;

/// A recorder: a process that reads every channel when it is told to.
#[derive(Debug)]
pub struct Recorder {
    process: Spawned,
    orders: Option<File>,
    answers: File,
    /// What it is at: the place of a channel in its order, plus one; 0: none.
    place: Mapped<AtomicU32>,
    /// Since when it owes an answer, CLOCK_MONOTONIC, ns.
    asked_ns: Option<u64>,
    /// The time since its patience was over.
    late: Option<(u64, Spell)>,
    /// Channels that were rebuilt, of which it has not been told.
    rebuilt: Vec<String>,
    /// It has said that something was left out.
    has_left_out: bool,
}

impl Recorder {
    /// Starts it with a line for orders and a line for answers. It owes its first answer when it has attached itself.
    /// `place`: memory in which it says what it is at.
    ///
    /// # Errors
    /// It could not be started.
    pub fn start(
        place: &OwnedFd,
        start: impl FnOnce(&OwnedFd, &OwnedFd) -> io::Result<Spawned>,
    ) -> io::Result<Self> {
        let (order_end, orders) = io::pipe()?;
        let (answers, answer_end) = io::pipe()?;
        let (order_end, answer_end) = (OwnedFd::from(order_end), OwnedFd::from(answer_end));
        let place = Mapped::new(place).map_err(io::Error::other)?;
        let process = start(&order_end, &answer_end)?;
        drop(answer_end);
        let (orders, answers) = (File::from(OwnedFd::from(orders)), File::from(OwnedFd::from(answers)));
        Ok(Self {
            process,
            orders: Some(orders),
            answers,
            place,
            asked_ns: Some(now_ns()),
            late: None,
            rebuilt: Vec::new(),
            has_left_out: false,
        })
    }

    /// Has it attach itself anew to channels that were rebuilt, and read what has been written since the last time; each
    /// when it has finished what it is at, for which it is waited or not.
    fn read_channels(&mut self, waits: bool) {
        if !self.has_answered(PATIENCE_NS, waits) {
            return;
        }
        if !self.rebuilt.is_empty() {
            let order = format!("{ATTACH_ANEW}{}\n", self.rebuilt.join(" ")); // no name of a port has a space
            self.rebuilt.clear();
            self.order(order.as_bytes());
        }
        if self.has_answered(PATIENCE_NS, waits) {
            self.order(&[READ as u8]);
        }
    }

    fn order(&mut self, order: &[u8]) {
        if let Some(orders) = &mut self.orders {
            // One that is gone is found when its answer is looked for.
            let _ = orders.write_all(order);
            self.asked_ns = Some(now_ns());
        }
    }

    /// Takes the answer that it owes, and waits for it or not; false: not yet. One that owes it for longer than
    /// `most_ns` is ended: it maps what partitions may have damaged, and a hanging log must not keep the module from living on.
    fn has_answered(&mut self, most_ns: u64, waits: bool) -> bool {
        let Some(asked_ns) = self.asked_ns else { return true };
        let speaks = loop {
            await_any_end(&[self.answers.as_fd()], if waits { OWN_PATIENCE_NS } else { 0 });
            let speaks = is_readable(self.answers.as_fd());
            if speaks || self.hangs(asked_ns, most_ns) {
                break speaks;
            }
            if !waits {
                return false;
            }
        };
        (self.asked_ns, self.late) = (None, None);
        let mut answer = [0; 1];
        let heard = speaks && self.answers.read(&mut answer).is_ok_and(|count| count == 1);
        self.has_left_out |= heard && char::from(answer[0]) == LEFT_OUT;
        if !heard {
            self.orders = None; // it has ended, or does now
            let _ = rustix::process::pidfd_send_signal(&self.process.pidfd, rustix::process::Signal::KILL);
        }
        true
    }

    /// Whether it has owed its answer for so long, and has had the time to give it.
    fn hangs(&mut self, asked_ns: u64, most_ns: u64) -> bool {
        let now = now_ns();
        if now.saturating_sub(asked_ns) < most_ns {
            return false;
        }
        let pid = self.process.pid;
        if now.saturating_sub(asked_ns) < most_ns + STARVED_PATIENCE_NS && waits_for_disk(pid) {
            self.late = None; // its own time begins anew
            return false;
        }
        let (since_ns, spell) = self.late.get_or_insert_with(|| (now, Spell::begin(pid)));
        spell.has_had(now.saturating_sub(*since_ns), OWN_PATIENCE_NS, STARVED_PATIENCE_NS)
    }

    fn works(&self) -> bool {
        self.orders.is_some()
    }

    /// How it has ended, once it has no orders any more.
    fn end(&self, patience_ns: u64) -> Option<ExitStatus> {
        await_any_end(&[self.process.pidfd.as_fd()], patience_ns);
        ended(&self.process) // one that still runs dies with the executive
    }

    /// The place of the channel that it was at.
    fn place(&self) -> Option<usize> {
        (self.place.load(Relaxed) as usize).checked_sub(1)
    }
}

/// Channels that recorders have ended at.
#[derive(Debug, Default)]
struct Blame {
    /// Where the last one has ended.
    suspect: Option<String>,
    left_out: Vec<String>,
}

impl Blame {
    /// A recorder has ended at a channel.
    fn ended_at(&mut self, channel: Option<&str>) {
        let again = channel.is_some() && self.suspect.as_deref() == channel;
        self.suspect = channel.map(str::to_owned);
        if again {
            self.left_out.extend(self.suspect.take());
        }
    }

    /// Channels were rebuilt.
    fn forgive(&mut self, rebuilt: &[String]) {
        self.left_out.retain(|name| !rebuilt.contains(name));
        self.suspect.take_if(|name| rebuilt.contains(name));
    }
}

enum State {
    Working(Recorder),
    /// The last recorder has ended, at this instant of CLOCK_MONOTONIC, ns, and is not yet with the channel cleaner.
    Dead(i32, u64),
    /// It is.
    Buried(i32),
    /// The disk is full; the next look is at this instant of CLOCK_MONOTONIC, ns.
    Full(u64),
    /// There is no log any more.
    Over,
}

/// See the module's head.
pub struct Recording {
    start: StartRecorder,
    channels: Vec<String>,
    /// Where the log is.
    folder: PathBuf,
    state: State,
    /// The last recorder has ended for want of room on the disk.
    full: bool,
    /// Parts before the present one.
    part: u32,
    blame: Blame,
}

impl Recording {
    /// Starts the first recorder, and waits until it has attached itself to `channels`. `folder`: where its log is.
    ///
    /// # Errors
    /// It could not be started, or ended at once.
    pub fn begin(start: StartRecorder, channels: Vec<String>, folder: PathBuf) -> io::Result<Self> {
        let mut recorder = start(0, &[])?;
        recorder.has_answered(ATTACH_PATIENCE_NS, true);
        if !recorder.works() {
            return Err(io::Error::other("it ended at once"));
        }
        let (state, blame) = (State::Working(recorder), Blame::default());
        Ok(Self { start, channels, folder, state, full: false, part: 0, blame })
    }

    /// Has it read what has been written since the last turn.
    pub(crate) fn turn(&mut self, clock: Clock, module_ns: u64, monitor: &mut Monitor) {
        let rebuilt = monitor.take_rebuilt();
        self.blame.forgive(&rebuilt);
        // On the virtual clock nobody's time passes meanwhile, and the log is the same at every run.
        let waits = clock == Clock::Virtual;
        if let State::Working(recorder) = &mut self.state {
            recorder.rebuilt.extend(rebuilt);
            recorder.read_channels(waits);
            if std::mem::take(&mut recorder.has_left_out) {
                let (time_s, log) = (module_ns as f64 / 1e9, part_name(self.part));
                let reason = "something is no message of its port's type, and is left out (partitions/helpers.log \
                              says of which port)";
                monitor.events().tell(&Event::LogLacks { time_s, log, reason: reason.into() });
            }
            if !recorder.works() {
                self.has_ended(module_ns, monitor);
            }
        }
        if let State::Dead(pid, since_ns) = self.state
            && (waits || monitor.do_all_run() || now_ns().saturating_sub(since_ns) > RESPECT_NS)
        {
            monitor.clean_up_after_helper(pid, self.channels.clone());
            self.state = State::Buried(pid);
        }
        if let State::Buried(pid) = self.state {
            if waits {
                monitor.await_cleanup(pid);
            }
            if !monitor.awaits_cleanup(pid) {
                self.go_on(module_ns, monitor);
            }
        }
        if let State::Full(look_ns) = self.state
            && now_ns() >= look_ns
        {
            self.go_on(module_ns, monitor);
        }
    }

    /// The recorder has ended: whether another one follows.
    fn has_ended(&mut self, module_ns: u64, monitor: &mut Monitor) {
        let State::Working(recorder) = std::mem::replace(&mut self.state, State::Over) else { return };
        let status = recorder.end(END_PATIENCE_NS);
        self.full = status.and_then(|status| status.code()) == Some(NO_ROOM);
        if !(self.full || is_victim(status)) || self.part + 1 >= MOST_PARTS {
            return tell_lost(ENDED.into(), module_ns, monitor);
        }
        let channel = recorder.place().and_then(|place| self.channels.get(place)).filter(|_| !self.full);
        self.blame.ended_at(channel.map(String::as_str));
        self.state = State::Dead(recorder.process.pid, now_ns());
        let at = channel.map_or_else(String::new, |name| format!(" at {name}"));
        let left_out = match self.blame.left_out.as_slice() {
            [] => String::new(),
            some => format!(", without {} until that is made anew", some.join(", ")),
        };
        let (log, next) = (part_name(self.part), part_name(self.part + 1));
        let reason = match self.full {
            true => format!(
                "the disk is full; messages are missing until there is room again, and the log goes on in {next}{left_out}"
            ),
            false => format!("the recorder has ended{at}; another one goes on in {next}{left_out}"),
        };
        monitor.events().tell(&Event::LogCut { time_s: module_ns as f64 / 1e9, log, reason });
    }

    fn go_on(&mut self, module_ns: u64, monitor: &mut Monitor) {
        if self.full && !has_room(&self.folder) {
            self.state = State::Full(now_ns() + LOOK_FOR_ROOM_NS);
            return;
        }
        self.state = match (self.start)(self.part + 1, &self.blame.left_out) {
            Ok(recorder) => State::Working(recorder),
            Err(error) if self.full && is_full(&error) => {
                self.state = State::Full(now_ns() + LOOK_FOR_ROOM_NS);
                return;
            }
            Err(error) => {
                tell_lost(format!("no other recorder can be started: {error}"), module_ns, monitor);
                State::Over
            }
        };
        self.part += 1;
    }

    /// Has everything read and the log closed; gives the reason why it is not whole, where that was not told before.
    pub(crate) fn finish(self) -> Option<String> {
        let State::Working(mut recorder) = self.state else { return None };
        recorder.read_channels(true);
        recorder.has_answered(PATIENCE_NS, true);
        recorder.orders = None;
        let whole = recorder.end(PATIENCE_NS).is_some_and(|status| status.success());
        (!whole).then(|| ENDED.into())
    }
}

/// Whether a log that the lack of room has ended can go on in `folder`. A folder that is gone has none.
fn has_room(folder: &Path) -> bool {
    rustix::fs::statvfs(folder).is_ok_and(|disk| disk.f_bavail.saturating_mul(disk.f_frsize) >= ROOM)
}

/// Whether a write failed for want of room, which may come again.
fn is_full(error: &io::Error) -> bool {
    matches!(error.kind(), io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded)
}

fn tell_lost(reason: String, module_ns: u64, monitor: &mut Monitor) {
    let (time_s, log) = (module_ns as f64 / 1e9, part_name(0));
    monitor.events().tell(&Event::LogLost { time_s, log, reason });
}

/// What the file of a part is called, beside the first one's `ports.mcap`.
pub(crate) fn part_name(part: u32) -> String {
    match part {
        0 => "ports.mcap".into(),
        part => format!("ports.part-{part}.mcap"),
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::process::ExitStatusExt;

    use super::*;

    #[test]
    fn a_channel_is_left_out_when_two_recorders_in_a_row_have_ended_at_it_and_until_it_is_made_anew() {
        let mut blame = Blame::default();
        blame.ended_at(Some("imu.state"));
        assert!(blame.left_out.is_empty());
        blame.ended_at(Some("gps.state"));
        blame.ended_at(Some("imu.state"));
        assert!(blame.left_out.is_empty(), "not in a row");
        blame.ended_at(Some("imu.state"));
        assert_eq!(blame.left_out, ["imu.state"]);
        blame.ended_at(None);
        blame.ended_at(None);
        assert_eq!(blame.left_out, ["imu.state"], "nobody knows where they have ended");
        blame.forgive(&["gps.state".into()]);
        assert_eq!(blame.left_out, ["imu.state"]);
        blame.forgive(&["imu.state".into()]);
        assert!(blame.left_out.is_empty());
    }

    #[test]
    fn a_channel_that_was_made_anew_in_between_is_no_suspect_any_more() {
        let mut blame = Blame::default();
        blame.ended_at(Some("imu.state"));
        blame.forgive(&["imu.state".into()]);
        blame.ended_at(Some("imu.state"));
        assert!(blame.left_out.is_empty());
    }

    #[test]
    fn a_recorder_that_says_why_it_can_not_go_on_is_not_followed() {
        assert!(!is_victim(Some(ExitStatus::from_raw(1 << 8))), "a full disk");
        assert!(!is_victim(Some(ExitStatus::from_raw(0))));
        assert!(!is_victim(None), "it still runs");
        for status in [libc::SIGSEGV, libc::SIGKILL, 101 << 8] {
            assert!(is_victim(Some(ExitStatus::from_raw(status))), "{status}");
        }
    }
}
