//! What surrounds a module while it runs: planned faults, the recorder, the player, the companion at the end of a line, and the
//! wish to stop. Looked at once in each minor frame, on either clock.

use std::io::{self, Read, Write};
use std::os::fd::AsFd;
use std::os::unix::net::UnixStream;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use bateleur_contract::{Clock, Mapped};

use crate::fast::World;
use crate::playing::Player;
use crate::recording::Recording;
use bateleur_monitor::Monitor;
use bateleur_monitor::event::{Event, Events};
use bateleur_monitor::logbook_store::{LogbookStores, Lost};
use bateleur_monitor::planned::PlannedActs;
use bateleur_monitor::run_order::RunOrder;
use bateleur_plan::ModuleError;
use bateleur_system::service_manager::ServiceManager;
use bateleur_system::time::now_ns;
use bateleur_system::wait::is_hung_up;
use bateleur_time::dispatcher::Occurrence;
use bateleur_time::redundant_pair::RedundantPair;
use bateleur_time::run_page::RunPage;

/// Module time between two exchanges with the companion and the recorder, ns: the step of a ground station.
pub const EXCHANGE_NS: u64 = 100_000_000;
/// How long a companion may take for a step, real time: it may have to wait until another module has started.
const COMPANION_PATIENCE: Duration = Duration::from_secs(120);

/// Schedules to ask for, in the order of time.
#[derive(Debug, Default)]
struct Changing(Vec<(String, u64)>);

impl Changing {
    /// By name and module time, ns. Names that are not in the plan were refused before.
    #[must_use]
    fn of(changes: &[(String, u64)]) -> Self {
        let mut list = changes.to_vec();
        list.sort_by_key(|(_, at)| std::cmp::Reverse(*at));
        Self(list)
    }

    fn skip_until(&mut self, module_ns: u64) {
        while self.due(module_ns).is_some() {}
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

/// A logbook that can not be stored.
pub fn tell_lost(events: &mut Events, lost: Lost, module_ns: u64) {
    events.tell(&Event::LogLost { time_s: module_ns as f64 / 1e9, log: lost.log, reason: lost.why });
}

/// See the module's head.
pub struct Surroundings {
    clock: Clock,
    acts: PlannedActs,
    changes: Changing,
    until_ns: Option<u64>,
    stops_with_input: bool,
    stop: Arc<AtomicBool>,
    power_fail: Arc<AtomicBool>,
    recording: Option<Recording>,
    player: Option<Player>,
    companion: Option<Companion>,
    line: Option<Arc<RedundantPair>>,
    /// Virtual clock: what the next executive finds, if this one dies.
    pub page: Option<Arc<Mapped<RunPage>>>,
    /// The files of the partitions' logbooks.
    pub logbooks: Option<LogbookStores>,
    /// Where the executive itself is a service.
    pub service_manager: ServiceManager,
    next_exchange_ns: u64,
    module_ns: u64,
    reason: Option<String>,
}

impl Surroundings {
    /// Everything that may be there. `stop` and `power_fail` are set by signals.
    #[must_use]
    pub fn new(
        order: &RunOrder,
        acts: PlannedActs,
        stop: Arc<AtomicBool>,
        power_fail: Arc<AtomicBool>,
        companion: Option<Companion>,
    ) -> Self {
        Self {
            clock: order.clock(),
            acts,
            changes: Changing::of(&order.schedule_changes),
            until_ns: order.until_ns,
            stops_with_input: order.until_stdin_closes,
            stop,
            power_fail,
            recording: None,
            player: None,
            companion,
            line: None,
            page: None,
            logbooks: None,
            service_manager: ServiceManager::default(),
            next_exchange_ns: 0,
            module_ns: 0,
            reason: None,
        }
    }

    /// The module starts, perhaps not for the first time. `line`: the partition whose device the companion holds the other
    /// end of.
    pub fn begin(
        &mut self,
        recording: Option<Recording>,
        player: Option<Player>,
        line: Option<Arc<RedundantPair>>,
    ) {
        self.recording = recording;
        self.player = player;
        self.line = line;
    }

    /// An executive before this one has come to `module_ns`: what was planned until then is not done again.
    pub fn go_on_from(&mut self, module_ns: u64) {
        self.acts.skip_until(module_ns);
        self.changes.skip_until(module_ns);
        self.module_ns = module_ns;
    }

    /// What the partition at the line has sent and received so far, and what it is to receive: its successors in a module
    /// that was reset go on counting there. `None` if nobody counts yet.
    #[must_use]
    pub fn line_counts(&self) -> Option<[u64; 3]> {
        let Some(line) = &self.line else {
            // The executive before this one.
            return self.page.as_ref().map(|page| page.reached().1);
        };
        line.active().look_at_line();
        Some(line.active().line_counts())
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

    /// Ends the run where that was asked for.
    pub fn heed_stop(&mut self) {
        // Looked at here too: whoever closes it while the virtual clock waits for him shall see no later frame.
        if self.stops_with_input && is_hung_up(io::stdin().as_fd()) {
            self.stop.store(true, Ordering::Release);
        }
        if self.stop.load(Ordering::Acquire) {
            if self.reason.is_none() {
                self.service_manager.ends();
            }
            self.reason.get_or_insert_with(|| "it was asked to stop".into());
        }
    }

    /// Why the run ended.
    #[must_use]
    pub fn reason(&self, of_monitor: Option<&str>) -> String {
        let own = self.reason.as_deref();
        own.or(of_monitor).unwrap_or("the end of its time").to_owned()
    }

    /// Ends what was started; gives the reason why the recorder's log is not whole, where it was not told before.
    pub fn finish(&mut self) -> Option<String> {
        self.player = None;
        self.recording.take()?.finish()
    }

    fn exchange(&mut self, module_ns: u64, monitor: &mut Monitor) {
        if let Some(recording) = &mut self.recording {
            recording.turn(self.clock, module_ns, monitor);
        }
        let Some(companion) = &mut self.companion else { return };
        let sent = self.line.as_ref().map_or(0, |pair| pair.active().line_counts()[0]);
        match companion.exchange(module_ns, sent) {
            Ok((bytes, stop)) => {
                if let Some(pair) = &self.line {
                    pair.all().for_each(|control| control.expect_of_device(bytes));
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
        self.service_manager.lives(now_ns());
        if let Some(page) = &self.page {
            page.reach(module_ns, self.line_counts());
            page.keep_counts(monitor.totals().counts());
        } else if let Some(pair) = &self.line {
            pair.active().look_at_line();
        }
        if let Some(logbooks) = &self.logbooks {
            if self.clock == Clock::Wall {
                logbooks.store();
            }
            logbooks.take_trouble().into_iter().for_each(|lost| tell_lost(monitor.events(), lost, module_ns));
        }
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
        self.heed_stop();
        if self.until_ns.is_some_and(|until| module_ns >= until) {
            self.reason.get_or_insert_with(|| "the asked-for time is over".into());
        }
        self.reason.is_none()
    }

    fn window_closed(&mut self) {
        if let Some(logbooks) = &self.logbooks {
            logbooks.store();
        }
    }

    fn window(&mut self, occurrence: &Occurrence) {
        let Some(player) = &mut self.player else { return };
        if let Err(error) = player.before_window(occurrence) {
            self.player = None;
            self.reason =
                Some(format!("the player of the recording is gone: {error} (see partitions/helpers.log)"));
        }
    }
}
