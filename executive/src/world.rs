//! What surrounds a module while it runs: planned faults, the recorder, the companion at the end of a line, and the
//! wish to stop. Looked at once in each minor frame, on either clock.

use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, OwnedFd};
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use bateleur_contract::Clock;

use crate::event::Event;
use crate::fast::World;
use crate::monitor::Monitor;
use crate::partition::{await_any_end, ended, is_readable};
use crate::plan::ModuleError;
use crate::planned::PlannedActs;
use crate::seats::Seats;
use crate::system::spawn::Spawned;
use crate::system::time::now_ns;

/// Module time between two exchanges with the companion and the recorder, ns: the step of a ground station.
pub const EXCHANGE_NS: u64 = 100_000_000;
/// How long a companion may take for a step, real time: it may have to wait until another module has started.
const COMPANION_PATIENCE: Duration = Duration::from_secs(120);

/// How long the recorder may take to attach itself, real time.
const ATTACH_PATIENCE_NS: u64 = 20_000_000_000;
/// How long it may take to answer in flight, real time. A disk that stalls for longer costs the log. On the wall clock nobody
/// waits for it meanwhile: what partitions write in that time is read later, as far as it still stands.
const RECORDER_PATIENCE_NS: u64 = 5_000_000_000;

/// Schedules to ask for, in the order of time.
#[derive(Debug, Default)]
pub struct Changing(Vec<(String, u64)>);

impl Changing {
    /// By name and module time, ns. Names that are not in the plan were refused before.
    #[must_use]
    pub fn of(changes: &[(String, u64)]) -> Self {
        let mut list = changes.to_vec();
        list.sort_by_key(|(_, at)| std::cmp::Reverse(*at));
        Self(list)
    }

    fn due(&mut self, module_ns: u64) -> Option<String> {
        self.0.pop_if(|(_, at)| *at <= module_ns).map(|(name, _)| name)
    }
}

/// The other end of the virtual clock's handshake: told the time and the bytes that were sent to it, answers with the
/// bytes that it has sent and whether the run shall end.
#[derive(Debug)]
pub struct Companion(UnixStream);

impl Companion {
    /// Over a connected socket.
    pub fn new(socket: UnixStream) -> io::Result<Self> {
        socket.set_read_timeout(Some(COMPANION_PATIENCE))?;
        Ok(Self(socket))
    }

    fn exchange(&mut self, module_ns: u64, sent: u64) -> io::Result<(u64, bool)> {
        let mut question = [0; 16];
        question[..8].copy_from_slice(&module_ns.to_le_bytes());
        question[8..].copy_from_slice(&sent.to_le_bytes());
        self.0.write_all(&question)?;
        let mut answer = [0; 9];
        self.0.read_exact(&mut answer)?;
        let [bytes @ .., stop] = answer;
        Ok((u64::from_le_bytes(bytes), stop != 0))
    }
}

/// The recorder: a process that reads every channel when it is told to.
#[derive(Debug)]
pub struct Recorder {
    process: Spawned,
    orders: Option<File>,
    answers: File,
    /// Since when it owes an answer, CLOCK_MONOTONIC, ns.
    asked_ns: Option<u64>,
    /// Channels that were made anew, of which it has not been told.
    renewed: Vec<String>,
    /// Why it has ended, to be told once.
    lost: Option<&'static str>,
}

/// Orders to a recorder, each a letter; it answers each with a byte. Read what has been written:
pub const READ: char = 'r';
/// Attach anew to the channels whose names follow, separated by spaces, until the end of the line:
pub const ATTACH_ANEW: char = 'a';

/// Where a recorder that has ended leaves its reason.
const RECORDER_ENDED: &str =
    "the recorder has ended or does not answer; its reason stands in partitions/helpers.log";

impl Recorder {
    /// Starts it with a line for orders and a line for answers, and waits until it has attached itself.
    pub fn start(start: impl FnOnce(&OwnedFd, &OwnedFd) -> io::Result<Spawned>) -> io::Result<Self> {
        let (order_end, orders) = io::pipe()?;
        let (answers, answer_end) = io::pipe()?;
        let (order_end, answer_end) = (OwnedFd::from(order_end), OwnedFd::from(answer_end));
        let process = start(&order_end, &answer_end)?;
        drop(answer_end);
        let (orders, answers) = (File::from(OwnedFd::from(orders)), File::from(OwnedFd::from(answers)));
        let mut recorder = Self {
            process,
            orders: Some(orders),
            answers,
            asked_ns: Some(now_ns()),
            renewed: Vec::new(),
            lost: None,
        };
        recorder.has_answered(ATTACH_PATIENCE_NS, ATTACH_PATIENCE_NS);
        match recorder.orders {
            Some(_) => Ok(recorder),
            None => Err(io::Error::other("it ended at once")),
        }
    }

    /// Has it attach itself anew to channels that were made anew, and read what has been written since the last time; each
    /// when it has finished what it is at, for which it is waited so long.
    fn read_channels(&mut self, patience_ns: u64) {
        if !self.has_answered(patience_ns, RECORDER_PATIENCE_NS) {
            return;
        }
        if !self.renewed.is_empty() {
            let order = format!("{ATTACH_ANEW}{}\n", self.renewed.join(" ")); // no name of a port has a space
            self.renewed.clear();
            self.order(order.as_bytes());
        }
        if self.has_answered(patience_ns, RECORDER_PATIENCE_NS) {
            self.order(&[READ as u8]);
        }
    }

    fn order(&mut self, order: &[u8]) {
        if let Some(orders) = &mut self.orders {
            self.asked_ns = orders.write_all(order).is_ok().then(now_ns);
        }
    }

    /// Takes the answer that it owes, and waits for it for so long; false: not yet. One that owes it for longer than
    /// `most_ns` is ended: it maps what partitions may have damaged, and a hanging log must not keep the module from living on.
    fn has_answered(&mut self, patience_ns: u64, most_ns: u64) -> bool {
        let Some(asked_ns) = self.asked_ns else { return true };
        await_any_end(&[self.answers.as_fd()], patience_ns);
        let speaks = is_readable(self.answers.as_fd());
        if !speaks && now_ns().saturating_sub(asked_ns) < most_ns {
            return false;
        }
        self.asked_ns = None;
        let mut answer = [0; 1];
        let heard = speaks && self.answers.read(&mut answer).is_ok_and(|count| count == 1);
        if !heard && self.orders.is_some() {
            self.lost = Some(RECORDER_ENDED);
        }
        if !heard {
            self.orders = None; // it has ended, or does now: the flight goes on without a log
            let _ = rustix::process::pidfd_send_signal(&self.process.pidfd, rustix::process::Signal::KILL);
        }
        true
    }

    /// Why the log is not whole, where that was not told before.
    fn finish(&mut self) -> Option<&'static str> {
        self.read_channels(RECORDER_PATIENCE_NS);
        self.has_answered(RECORDER_PATIENCE_NS, 0);
        let recorded = self.orders.take().is_some();
        await_any_end(&[self.process.pidfd.as_fd()], 5_000_000_000);
        // One that still runs dies with the executive.
        let whole = ended(&self.process).is_some_and(|status| status.success());
        self.lost.take().or_else(|| (recorded && !whole).then_some(RECORDER_ENDED))
    }
}

/// See the module's head.
pub struct Surroundings {
    clock: Clock,
    acts: PlannedActs,
    changes: Changing,
    until_ns: Option<u64>,
    stop: Arc<AtomicBool>,
    power_fail: Arc<AtomicBool>,
    recorder: Option<Recorder>,
    companion: Option<Companion>,
    line: Option<Arc<Seats>>,
    next_exchange_ns: u64,
    module_ns: u64,
    reason: Option<String>,
}

impl Surroundings {
    /// Everything that may be there. `stop` and `power_fail` are set by signals.
    #[must_use]
    pub fn new(
        clock: Clock,
        acts: PlannedActs,
        changes: Changing,
        until_ns: Option<u64>,
        stop: Arc<AtomicBool>,
        power_fail: Arc<AtomicBool>,
        companion: Option<Companion>,
    ) -> Self {
        Self {
            clock,
            acts,
            changes,
            until_ns,
            stop,
            power_fail,
            recorder: None,
            companion,
            line: None,
            next_exchange_ns: 0,
            module_ns: 0,
            reason: None,
        }
    }

    /// The module starts, perhaps not for the first time. `line`: the partition whose device the companion holds the other
    /// end of.
    pub fn begin(&mut self, recorder: Option<Recorder>, line: Option<Arc<Seats>>) {
        self.recorder = recorder;
        self.line = line;
    }

    /// What the partition at the line has sent and received so far, and what it is to receive: its successors in a module
    /// that was reset go on counting there. None: nobody counts yet.
    #[must_use]
    pub fn line_counts(&self) -> Option<[u64; 3]> {
        let page = &self.line.as_ref()?.in_office().page;
        let counts = [&page.device_sent, &page.device_received, &page.device_expected];
        Some(counts.map(|count| count.load(Ordering::Relaxed)))
    }

    /// When the run is to end, module time, ns.
    #[must_use]
    pub fn until_ns(&self) -> Option<u64> {
        self.until_ns
    }

    /// Module time of the last minor frame, ns.
    #[must_use]
    pub fn module_ns(&self) -> u64 {
        self.module_ns
    }

    /// The run is over, whatever the module says.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.reason.is_some()
    }

    /// Why the run ended.
    #[must_use]
    pub fn reason(&self, of_monitor: Option<&str>) -> String {
        let own = self.reason.as_deref();
        own.or(of_monitor).unwrap_or("the end of its time").to_owned()
    }

    /// Ends what was started; gives the reason why the recorder's log is not whole, where it was not told before.
    pub fn finish(&mut self) -> Option<String> {
        self.recorder.take()?.finish().map(str::to_owned)
    }

    fn exchange(&mut self, module_ns: u64, monitor: &mut Monitor) {
        if let Some(recorder) = &mut self.recorder {
            recorder.renewed.extend(monitor.take_renewed());
            // On the virtual clock nobody's time passes meanwhile, and the log is the same at every run.
            let patience_ns = if self.clock == Clock::Virtual { RECORDER_PATIENCE_NS } else { 0 };
            recorder.read_channels(patience_ns);
            if let Some(reason) = recorder.lost.take() {
                let (time_s, log) = (module_ns as f64 / 1e9, "ports.mcap".into());
                monitor.events().tell(&Event::LogLost { time_s, log, reason: reason.into() });
            }
        }
        let Some(companion) = &mut self.companion else { return };
        let sent =
            self.line.as_ref().map_or(0, |seats| seats.in_office().page.device_sent.load(Ordering::Relaxed));
        match companion.exchange(module_ns, sent) {
            Ok((bytes, stop)) => {
                if let Some(seats) = &self.line {
                    seats.all().for_each(|slot| slot.expect_of_device(bytes));
                }
                if stop {
                    self.reason = Some("the mission is over".into());
                }
            }
            Err(error) => self.reason = Some(format!("the companion of the virtual clock is gone: {error}")),
        }
    }
}

impl World for Surroundings {
    fn minor_frame(&mut self, module_ns: u64, monitor: &mut Monitor) -> bool {
        self.module_ns = module_ns;
        self.acts.perform(module_ns, monitor);
        while let Some(schedule) = self.changes.due(module_ns) {
            let _ = monitor.request_schedule(&schedule, module_ns); // the names were looked up before frame 0
        }
        if module_ns >= self.next_exchange_ns {
            self.next_exchange_ns = module_ns + EXCHANGE_NS;
            self.exchange(module_ns, monitor);
        }
        if self.power_fail.swap(false, Ordering::AcqRel) {
            let detail = "the supply announced that it is going (SIGPWR)";
            monitor.module_fault(ModuleError::PowerFail, detail, true, module_ns);
        }
        if self.stop.load(Ordering::Acquire) {
            self.reason.get_or_insert_with(|| "it was asked to stop".into());
        }
        if self.until_ns.is_some_and(|until| module_ns >= until) {
            self.reason.get_or_insert_with(|| "the asked-for time is over".into());
        }
        self.reason.is_none()
    }
}
