//! What is looked at now and then, and not in each step: what could not be logged, threads that nobody knew of.

use bateleur_contract::Clock;

use super::{Monitor, seconds};
use crate::event::Event;

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
        self.tell_lost(module_ns);
        if self.clock == Clock::Wall {
            self.count_threads(module_ns);
            self.look_for_neighbours(module_ns);
            for place in 0..self.watched.len() {
                self.judge_escapes(place, module_ns);
            }
        }
    }

    /// Tells of logs that can not be written, each once. A full disk must not stop the aircraft.
    pub(super) fn tell_lost(&mut self, module_ns: u64) {
        for lost in self.health_log.take_trouble().chain(self.window_log.take_trouble()) {
            let time_s = seconds(module_ns);
            self.events.tell(&Event::LogLost { time_s, log: lost.log.into(), reason: lost.why });
        }
        for watched in &self.watched {
            if let Some(reason) = watched.sandbox.take_log_trouble() {
                let log = format!("partitions/{}.log", watched.sandbox.name);
                self.events.tell(&Event::LogLost { time_s: seconds(module_ns), log, reason });
            }
        }
    }

    /// A partition that declared one thread is not frozen when it closes its window: the thread sleeps. One that has
    /// more after all is found here.
    fn count_threads(&mut self, module_ns: u64) {
        let found = self.watched.iter().filter(|watched| watched.finds_company());
        for name in found.map(|watched| watched.sandbox.name.clone()).collect::<Vec<_>>() {
            let text =
                "it has more threads or processes than it declared: held between its windows from now on"
                    .into();
            self.events.tell(&Event::Message { time_s: seconds(module_ns), partition: name, text });
        }
    }
}
