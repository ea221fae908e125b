//! What an operator, or a plan of faults, may do to one partition.
//!
//! Each tells the watchers what was done, and nothing where there was nothing to do. None of them is a health error,
//! but a kill, which is found as the death that it is.

use std::os::fd::AsFd;

use bateleur_contract::{Clock, StartCondition};

use super::cleanup::PairMember;
use super::watched::{Life, Then, Until};
use super::{Monitor, seconds};
use crate::event::Event;
use crate::health::log::Fault;
use crate::health::record::Level;
use crate::inject::{self, Aim};
use crate::planned::Act;
use bateleur_system::wait::await_any_end;
use bateleur_time::partition_control::Readiness;

/// What the health log calls an order in place of an error.
const ORDER: &str = "order";

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
        let idle = watched.sandbox.control.readiness() == Readiness::Idle; // a change of schedule might bring it back
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
        self.clean_up(place, Then::Successor, module_ns);
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
            watched.sandbox.control.hold();
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
            watched.sandbox.control.release();
        }
        self.say(place, "thawed by the operator", module_ns);
        true
    }

    /// A partition without a process, or whose process has just ended, gets no other one by itself.
    pub(super) fn lay_to_rest(&mut self, place: usize, until: Until, module_ns: u64) {
        self.close_series(place, module_ns);
        self.watched[place].put_an_end();
        self.rebuilds.forget(place);
        // The fault before waits for a successor that will not come.
        if let Some(fault) = self.watched[place].fault.take() {
            self.health_log.write(&fault);
        }
        self.watched[place].rest(until);
        self.clean_up(place, Then::Rest, module_ns);
    }

    /// Has the dead process of `place` cleaned up after, and `then` what comes after it.
    pub(super) fn clean_up(&mut self, place: usize, then: Then, module_ns: u64) {
        self.end_standby(place);
        let startup_ns = self.plan[self.watched[place].sandbox.id].restart.startup_ns;
        let watched = &mut self.watched[place];
        let dead = match &mut watched.life {
            Life::Dead(_, planned) => {
                *planned = then;
                true
            }
            _ => false,
        };
        if then == Then::Successor {
            watched.sandbox.control.set_readiness(Readiness::Absent);
            if self.clock == Clock::Virtual {
                watched.sandbox.control.set_not_before_ns(module_ns + startup_ns);
            }
            if matches!(watched.life, Life::Unstarted(_)) {
                return; // at its time
            }
            if !dead {
                return self.start_successor(place);
            }
        }
        if dead {
            self.cleanups.add(place, PairMember::Active);
            // On the virtual clock everything that peers can notice happens at an instant of module time.
            while self.clock == Clock::Virtual
                && matches!(self.watched[place].life, Life::Dead(_, Then::Rest))
            {
                self.look_at_channel_cleaner();
                self.pause(200_000);
            }
        }
    }

    /// Does to the partition at `partition` of the plan what is ordered; in words what it was, or why nothing was done.
    pub(super) fn carry_out(
        &mut self,
        partition: usize,
        act: Act,
        module_ns: u64,
    ) -> Result<&'static str, &'static str> {
        let (done, text, otherwise) = match act {
            Act::Kill => {
                (self.kill(partition, module_ns), "is killed", "has no process that could be killed")
            }
            Act::KillStandby => {
                (self.kill_standby(partition, module_ns), "has lost its standby", "has no standby now")
            }
            Act::Stop => (self.stop(partition, module_ns), "is stopped", "is not running"),
            Act::Start => (self.start(partition, module_ns), "is being started", "runs, or is about to"),
            Act::Freeze => (self.freeze(partition, module_ns), "is frozen", "is frozen already"),
            Act::Thaw => (self.thaw(partition, module_ns), "goes on", "is not frozen"),
            Act::Inject(_) => return Err("has faults by `inject`"),
        };
        if done { Ok(text) } else { Err(otherwise) }
    }

    /// Does what was planned for this instant. What leaves no entry of its own, as a death does, is one: also that nothing was
    /// done, or a test of faults would test nothing and not say so.
    pub fn carry_out_planned(&mut self, aim: &Aim, act: Act, module_ns: u64) {
        let place = aim.partition.map(|partition| self.places[partition]);
        if place == Some(None) {
            return; // that partition runs on another module
        }
        let place = place.flatten();
        let (what, done) = match (act, aim.partition) {
            (Act::Inject(fault), _) => (format!("fault {fault}"), self.provoke(fault, aim, module_ns)),
            (act, Some(partition)) => {
                let name = act.name().to_owned();
                (name, self.carry_out(partition, act, module_ns).map(drop).map_err(str::to_owned))
            }
            (_, None) => return, // only faults hit the dispatcher
        };
        // What follows from these is an entry.
        let shows = match act {
            Act::Kill | Act::KillStandby => true,
            Act::Inject(fault) => !matches!(fault, inject::Fault::Messages { .. }),
            _ => false,
        };
        let text = match done {
            Ok(()) if shows => return,
            Ok(()) => format!("{what}, as planned"),
            Err(why) => {
                let text = format!("{what} was planned, and nothing was done: {why}");
                let partition = place.map(|place| self.watched[place].sandbox.name.clone());
                let partition = partition.unwrap_or_else(|| inject::DISPATCHER.to_owned());
                self.events.tell(&Event::Undone {
                    time_s: seconds(module_ns),
                    partition,
                    text: text.clone(),
                });
                text
            }
        };
        self.note_order(place, &text, module_ns);
    }

    /// An order is an entry in the health log: whoever reads what followed from it must not take it for a fault.
    pub(super) fn note_order(&mut self, place: Option<usize>, text: &str, module_ns: u64) {
        let watched = place.map(|place| &self.watched[place]);
        let entry = Fault {
            time_ns: module_ns,
            level: if place.is_some() { Level::Partition } else { Level::Module },
            partition: watched.map(|watched| watched.sandbox.name.clone()),
            generation: watched.map_or(0, |watched| watched.generation),
            error: ORDER.into(),
            action: "ignore".into(),
            detail: text.into(),
            recovered_ns: None,
        };
        self.health_log.note(&entry);
        self.health_log.write(&entry);
    }

    fn say(&mut self, place: usize, text: &str, module_ns: u64) {
        let partition = self.watched[place].sandbox.name.clone();
        self.events.tell(&Event::Message { time_s: seconds(module_ns), partition, text: text.into() });
    }
}
