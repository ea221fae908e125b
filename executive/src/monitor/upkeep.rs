//! What is looked at now and then, and not in each step: the partitions' logs, what could not be logged, threads that nobody knew of.

use bateleur_contract::Clock;

use super::{Monitor, seconds};
use crate::event::Event;
use crate::partition::Cage;
use crate::system::time::now_ns;

/// Between two looks, ns. A child that is not found out until then runs as ordinary work: it can take idle time, and nobody's
/// window.
const UPKEEP_NS: u64 = 100_000_000;

impl Monitor {
    /// Looks, where it is time to.
    pub(super) fn keep_up(&mut self, module_ns: u64) {
        if module_ns < self.next_upkeep_ns {
            return;
        }
        self.next_upkeep_ns = module_ns + UPKEEP_NS;
        self.bound_logs();
        self.tell_lost(module_ns);
        if self.clock == Clock::Wall {
            self.count_threads(module_ns);
            for place in 0..self.watched.len() {
                self.judge_fence(place, module_ns);
            }
        }
    }

    /// Keeps the partitions' logs short. They grow in real time, whatever the module's clock does.
    fn bound_logs(&mut self) {
        let now_ns = now_ns();
        if now_ns >= self.next_bound_ns {
            self.next_bound_ns = now_ns + UPKEEP_NS;
            self.watched.iter().for_each(|watched| watched.cage.bound_log());
        }
    }

    /// Tells of logs that can not be written, each once. A full disk must not stop the aircraft.
    pub(super) fn tell_lost(&mut self, module_ns: u64) {
        for lost in self.health_log.take_trouble().chain(self.window_log.take_trouble()) {
            let time_s = seconds(module_ns);
            self.events.tell(&Event::LogLost { time_s, log: lost.log.into(), reason: lost.why });
        }
        for watched in &self.watched {
            let cages =
                std::iter::once(&watched.cage).chain(watched.standby.iter().map(|standby| &standby.cage));
            for reason in cages.filter_map(Cage::take_log_trouble) {
                let log = format!("partitions/{}.log", watched.cage.name);
                self.events.tell(&Event::LogLost { time_s: seconds(module_ns), log, reason });
            }
        }
    }

    /// A partition that declared one thread is not frozen when it closes its window: the thread sleeps. One that has
    /// more after all is found here.
    fn count_threads(&mut self, module_ns: u64) {
        let found = self.watched.iter().filter(|watched| watched.finds_company());
        for name in found.map(|watched| watched.cage.name.clone()).collect::<Vec<_>>() {
            let text =
                "it has more threads or processes than it declared: held between its windows from now on"
                    .into();
            self.events.tell(&Event::Message { time_s: seconds(module_ns), partition: name, text });
        }
    }
}
