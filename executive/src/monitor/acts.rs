//! What an operator, or a plan of faults, may do to one partition.
//!
//! Each tells the watchers what was done, and nothing where there was nothing to do. None of them is a health error,
//! but a kill, which is found as the death that it is.

use std::os::fd::AsFd;

use bateleur_contract::{Clock, StartCondition};

use super::burial::Seat;
use super::watched::{Life, Then, Until};
use super::{Monitor, seconds};
use crate::event::Event;
use crate::partition::await_any_end;
use crate::slot::Readiness;

impl Monitor {
    /// The process of the partition at `partition` of the plan dies now (fault injection); false: it has none.
    pub fn kill(&mut self, partition: usize, module_ns: u64) -> bool {
        let Some(place) = self.places[partition] else { return false };
        let (Life::Running(process) | Life::Starting(process, _)) = &self.watched[place].life else {
            return false;
        };
        let _ = rustix::process::pidfd_send_signal(&process.pidfd, rustix::process::Signal::KILL); // ended already
        await_any_end(&[process.pidfd.as_fd()], 1_000_000_000);
        self.look_at_process(place, module_ns);
        true
    }

    /// Ends the partition, until [`Monitor::start`]; its windows pass. False: it is ended already.
    pub fn stop(&mut self, partition: usize, module_ns: u64) -> bool {
        let Some(place) = self.places[partition] else { return false };
        let watched = &mut self.watched[place];
        let idle = watched.cage.slot.readiness() == Readiness::Idle; // a change of schedule might bring it back
        if !watched.is_alive() && !watched.is_coming() && !idle {
            return false;
        }
        watched.held = false;
        watched.start_failed = false; // it is the operator who keeps it from running
        self.lay_to_rest(place, Until::Started, module_ns);
        self.say(place, "stopped by the operator", module_ns);
        true
    }

    /// Starts a partition that is idle or was stopped, from nothing and with a new budget. False: it runs, or is about to.
    pub fn start(&mut self, partition: usize, module_ns: u64) -> bool {
        let Some(place) = self.places[partition] else { return false };
        let watched = &mut self.watched[place];
        if watched.is_alive() || watched.is_coming() {
            return false;
        }
        watched.restarts.clear();
        if let Some(standby) = &mut watched.standby {
            standby.forget_losses();
        }
        watched.next_start = StartCondition::PartitionRestart;
        self.say(place, "started by the operator", module_ns);
        self.bury(place, Then::Successor, module_ns);
        true
    }

    /// Holds the partition until [`Monitor::thaw`]: its windows pass, nothing of it runs. A successor that becomes ready
    /// meanwhile is held too. False: it is held already.
    pub fn freeze(&mut self, partition: usize, module_ns: u64) -> bool {
        let Some(place) = self.places[partition] else { return false };
        let watched = &mut self.watched[place];
        if std::mem::replace(&mut watched.held, true) {
            return false;
        }
        if matches!(watched.life, Life::Running(_)) {
            watched.cage.slot.hold();
        }
        self.say(place, "frozen by the operator", module_ns);
        true
    }

    /// Ends [`Monitor::freeze`]: it goes on where it was. False: it is not held.
    pub fn thaw(&mut self, partition: usize, module_ns: u64) -> bool {
        let Some(place) = self.places[partition] else { return false };
        let watched = &mut self.watched[place];
        if !std::mem::replace(&mut watched.held, false) {
            return false;
        }
        watched.unclosed = 0;
        if matches!(watched.life, Life::Running(_)) {
            watched.cage.slot.release();
        }
        self.say(place, "thawed by the operator", module_ns);
        true
    }

    /// A partition without a process, or whose process has just ended, gets no other one by itself.
    pub(super) fn lay_to_rest(&mut self, place: usize, until: Until, module_ns: u64) {
        self.watched[place].put_an_end();
        self.renewals.forget(place);
        // The fault before waits for a successor that will not come.
        if let Some(fault) = self.watched[place].fault.take() {
            self.health_log.write(&fault);
        }
        self.watched[place].rest(until);
        self.bury(place, Then::Rest, module_ns);
    }

    /// Has the dead process of `place` buried, and `then` what comes after it.
    pub(super) fn bury(&mut self, place: usize, then: Then, module_ns: u64) {
        self.end_standby(place);
        let startup_ns = self.plan[self.watched[place].cage.id].restart.startup_ns;
        let watched = &mut self.watched[place];
        let dead = match &mut watched.life {
            Life::Dead(_, planned) => {
                *planned = then;
                true
            }
            _ => false,
        };
        if then == Then::Successor {
            watched.cage.slot.set_readiness(Readiness::Absent);
            if self.clock == Clock::Virtual {
                watched.cage.slot.set_not_before_ns(module_ns + startup_ns);
            }
            if matches!(watched.life, Life::Unstarted(_)) {
                return; // at its time
            }
            if !dead {
                return self.start_successor(place);
            }
        }
        if dead {
            self.burials.add(place, Seat::Office);
            // On the virtual clock everything that peers can notice happens at an instant of module time.
            while self.clock == Clock::Virtual
                && matches!(self.watched[place].life, Life::Dead(_, Then::Rest))
            {
                self.look_at_janitor();
                self.pause(200_000);
            }
        }
    }

    fn say(&mut self, place: usize, text: &str, module_ns: u64) {
        let partition = self.watched[place].cage.name.clone();
        self.events.tell(&Event::Message { time_s: seconds(module_ns), partition, text: text.into() });
    }
}
