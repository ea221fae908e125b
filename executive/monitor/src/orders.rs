//! What an operator, or a plan of faults, may do to a partition or to the module.
//!
//! Each tells the watchers what was done, and nothing where there was nothing to do. None of them is a health error,
//! but a kill, which is found as the death that it is.

use std::os::fd::AsFd;
use std::time::Duration;

use bateleur_contract::Clock;
use rustix::process::{Signal, getpid, kill_process, pidfd_send_signal};

use signal_hook::consts::{SIGBUS, SIGSEGV};

use crate::act::Act;
use crate::event::Event as Told;
use crate::inject::{Aim, Fault, OwnFault};
use crate::lifecycle::{Event, Phase};
use crate::module_level::seconds;
use crate::monitor::Monitor;
use crate::provoke::{InPlaceOf, Ordered, Way, way};
use crate::unclosed::Unclosed;
use bateleur_host::partition::Sandbox;
use bateleur_system::cpu_starvation::{STARVED_PATIENCE_NS, Spell};
use bateleur_system::disposition::{self, Disposition};
use bateleur_system::spawn::Spawned;
use bateleur_system::time::now_ns;
use bateleur_system::wait::{await_any_end, is_readable};
use bateleur_time::schedule_switch::Requested;

/// How long a killed process may take to end, real time, ns.
const KILL_PATIENCE_NS: u64 = 1_000_000_000;

/// Waits until `process` ends, which may take `patience_ns` of real time. On the virtual clock its waits for a processor are not counted: what others
/// compute on this machine must not change a flight.
fn await_end(process: &Spawned, clock: Clock, patience_ns: u64) {
    let most_ns = if clock == Clock::Virtual { STARVED_PATIENCE_NS } else { patience_ns };
    let (begun_ns, spell) = (now_ns(), Spell::begin(process.pid));
    while !await_any_end(&[process.pidfd.as_fd()], patience_ns) {
        if spell.has_had(now_ns() - begun_ns, patience_ns, most_ns) {
            return;
        }
    }
}

/// A schedule that the plan does not have.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the plan has no schedule \"{name}\"; it has {known}")]
pub struct UnknownSchedule {
    /// What was asked for.
    pub name: String,
    /// What there is.
    pub known: String,
}

impl Monitor {
    /// The process of the partition at `partition` of the plan dies now (fault injection); false: it has none.
    pub fn kill(&mut self, partition: usize, module_ns: u64) -> bool {
        let Some(place) = self.places[partition] else { return false };
        let Some(process) = &self.partitions[place].active.process else { return false };
        let _ = pidfd_send_signal(&process.pidfd, Signal::KILL); // ended already
        await_end(process, self.clock, KILL_PATIENCE_NS);
        self.look_at_process(place, module_ns);
        true
    }

    /// As [`Monitor::kill`], of the process that stands by for the partition.
    fn kill_standby(&mut self, place: usize, module_ns: u64) -> bool {
        let standby = self.partitions[place].standby.as_ref();
        let Some(process) = standby.and_then(|standby| standby.process.as_ref()) else { return false };
        let _ = pidfd_send_signal(&process.pidfd, Signal::KILL); // ended already
        await_end(process, self.clock, KILL_PATIENCE_NS);
        self.look_at_standby(place, module_ns);
        true
    }

    /// Ends the partition, until it is started; its windows pass. False: it is ended already.
    fn stop_partition(&mut self, place: usize, module_ns: u64) -> bool {
        let can = self.partitions[place].life.can_stop();
        if can {
            self.close_series(place, module_ns);
            self.feed(place, Event::Stop, module_ns);
            self.say(place, "stopped by the operator", module_ns);
        }
        can
    }

    /// Starts a partition that is idle or was stopped, from nothing and with a new budget. False: it runs, or is about to.
    fn start_partition(&mut self, place: usize, module_ns: u64) -> bool {
        let can = self.partitions[place].life.can_start();
        if can {
            self.say(place, "started by the operator", module_ns);
            self.feed(place, Event::Start, module_ns);
        }
        can
    }

    /// Holds the partition until it is thawed: its windows pass, nothing of it runs. A successor that becomes ready
    /// meanwhile is held too. False: it is held already.
    fn freeze(&mut self, place: usize, module_ns: u64) -> bool {
        let can = !self.partitions[place].life.is_held();
        if can {
            self.feed(place, Event::Freeze, module_ns);
            self.say(place, "frozen by the operator", module_ns);
        }
        can
    }

    /// Ends [`Monitor::freeze`]: it goes on where it was. False: it is not held.
    fn thaw(&mut self, place: usize, module_ns: u64) -> bool {
        let can = self.partitions[place].life.is_held();
        if can {
            self.partitions[place].unclosed = Unclosed::default();
            self.feed(place, Event::Thaw, module_ns);
            self.take_pending_action(place, module_ns); // of a change of schedule meanwhile
            self.say(place, "thawed by the operator", module_ns);
        }
        can
    }

    /// Does to the partition at `place` what is ordered; in words what it was, or why nothing was done.
    pub(crate) fn carry_out_order(
        &mut self,
        place: usize,
        act: Act,
        module_ns: u64,
    ) -> Result<&'static str, &'static str> {
        let partition = self.partitions[place].active.sandbox.id.index();
        let (done, text, otherwise) = match act {
            Act::Kill => {
                (self.kill(partition, module_ns), "is killed", "has no process that could be killed")
            }
            Act::KillStandby => {
                (self.kill_standby(place, module_ns), "has lost its standby", "has no standby now")
            }
            Act::Stop => (self.stop_partition(place, module_ns), "is stopped", "is not running"),
            Act::Start => {
                (self.start_partition(place, module_ns), "is being started", "runs, or is about to")
            }
            Act::Freeze => (self.freeze(place, module_ns), "is frozen", "is frozen already"),
            Act::Thaw => (self.thaw(place, module_ns), "goes on", "is not frozen"),
            Act::Inject(_) => return Err("has faults by `inject`"),
        };
        if done { Ok(text) } else { Err(otherwise) }
    }

    /// Does what was planned for this instant. What leaves no entry of its own, as a death does, is one: also that nothing was
    /// done, or a test of faults would test nothing and not say so.
    pub fn carry_out_planned(&mut self, aim: &Aim, act: Act, module_ns: u64) {
        let place = aim.place().map(|partition| self.places[partition]);
        if place == Some(None) {
            return; // that partition runs on another module
        }
        let place = place.flatten();
        let (what, done) = match (act, place) {
            (Act::Inject(fault), _) => (format!("fault {fault}"), self.provoke(fault, aim, module_ns)),
            (act, Some(place)) => {
                let done = self.carry_out_order(place, act, module_ns);
                (act.name().to_owned(), done.map(drop).map_err(str::to_owned))
            }
            (_, None) => return, // only faults hit a part of the executive
        };
        self.suffer_own_fault(module_ns);
        // What follows from these is an entry.
        let shows = match act {
            Act::Kill | Act::KillStandby => true,
            Act::Inject(fault) => !matches!(fault, Fault::Messages { .. }),
            _ => false,
        };
        let text = match done {
            Ok(()) if shows => return,
            Ok(()) => format!("{what}, as planned"),
            Err(why) => {
                let text = format!("{what} was planned, and nothing was done: {why}");
                let partition = place.map_or(aim.part(), |place| self.partitions[place].name()).to_owned();
                self.tell(&Told::Undone { time_s: seconds(module_ns), partition, text: text.clone() });
                text
            }
        };
        self.note_order(place, &text, module_ns);
    }

    /// Asks for the schedule of that name, from the next major frame on. The last request wins.
    ///
    /// # Errors
    /// The plan has no such schedule.
    pub fn request_schedule(&mut self, name: &str, module_ns: u64) -> Result<Requested, UnknownSchedule> {
        let Some(schedule) = self.plan.schedule(name) else {
            let known = self.plan.schedules.iter().map(|schedule| schedule.name.as_str());
            return Err(UnknownSchedule { name: name.into(), known: known.collect::<Vec<_>>().join(", ") });
        };
        let requested = self.schedule_switch.request(schedule.index());
        if requested == Requested::Pending {
            self.tell(&Told::ScheduleRequested {
                time_s: seconds(module_ns),
                schedule: name.into(),
                by: "operator".into(),
            });
        }
        Ok(requested)
    }

    /// Provokes `fault` where it is aimed. What follows is found like any other fault; that nothing follows is said.
    ///
    /// # Errors
    /// It can not be provoked now, and why.
    pub fn provoke(&mut self, fault: Fault, aim: &Aim, module_ns: u64) -> Result<(), String> {
        let Some(partition) = aim.place() else { return self.provoke_in_executive(fault, aim, module_ns) };
        let place = self.places[partition].ok_or("that partition runs on another module")?;
        let name = self.partitions[place].name().to_owned();
        let process = self.partitions[place].active.process.as_ref();
        let process = process.filter(|_| self.partitions[place].life.phase() == Phase::Running);
        let Some(process) = process else { return Err(format!("{name} does not run now")) };
        if let Fault::Signal(number) = fault {
            let way = way(process.pid, number).map_err(|why| format!("{name}: {why}"))?;
            return self.send(place, fault, &way, module_ns);
        }
        // Before what follows from it.
        self.say(place, provoked(fault), module_ns);
        // The same instant of the same run is the same fault.
        let seed = module_ns ^ ((partition as u64) << 56);
        if let Some(order) = fault.order(aim, seed) {
            let partition = &mut self.partitions[place];
            partition.active.sandbox.control.page.order_fault(&order);
            partition.ordered = Ordered::new(fault, order.kind.ends_or_stops());
        }
        Ok(())
    }

    /// Sends the running process of the partition at `place` a signal, or ends it in the place of one.
    fn send(&mut self, place: usize, fault: Fault, way: &Way, module_ns: u64) -> Result<(), String> {
        let partition = &mut self.partitions[place];
        let Some(process) = &partition.active.process else { return Ok(()) };
        let (signal, patience_ns) = way.signal();
        if let Way::InPlaceOf(number) = way {
            let_write_down(&partition.active.sandbox, process, *number);
        }
        pidfd_send_signal(&process.pidfd, signal)
            .map_err(|_| format!("{} has ended already", partition.active.sandbox.name))?;
        if let Way::InPlaceOf(signal) = way {
            partition.in_place_of = Some(InPlaceOf::new(process.pid, *signal));
        }
        // Before what follows from it.
        let mut text = provoked(fault);
        if matches!(way, Way::Handled(_)) {
            text.push_str(", and it has a handler of its own for that");
        }
        self.say(place, text, module_ns);
        if self.clock == Clock::Virtual && patience_ns > 0 {
            if let Some(process) = &self.partitions[place].active.process {
                await_end(process, self.clock, patience_ns);
            }
            self.look_at_process(place, module_ns);
        }
        Ok(())
    }

    fn provoke_in_executive(&mut self, fault: Fault, aim: &Aim, module_ns: u64) -> Result<(), String> {
        if self.clock == Clock::Virtual && matches!(fault, Fault::Stall(_)) {
            return Err(format!("on the virtual clock the {} can not be late", aim.part()));
        }
        self.kept.say(aim.part(), provoked(fault), module_ns);
        match (fault, aim) {
            (Fault::Stall(stall_ns), Aim::Dispatcher) => self.operator.stall.order(stall_ns),
            (Fault::Stall(stall_ns), _) => self.own_fault = Some(OwnFault::Stall(stall_ns)),
            (Fault::Signal(signal), _) => self.own_fault = Some(OwnFault::Signal(signal)),
            (other, _) => return Err(format!("{other} does not hit the {}", aim.part())),
        }
        Ok(())
    }

    /// Does to the executive itself what was provoked. Not at once: whoever has ordered it waits for an answer.
    pub(crate) fn suffer_own_fault(&mut self, module_ns: u64) {
        let Some(fault) = self.own_fault.take() else { return };
        match self.clock {
            // What is written is the same in each run.
            Clock::Virtual => self.kept.close_logs(module_ns),
            Clock::Wall => std::thread::sleep(ANSWERED),
        }
        match fault {
            OwnFault::Stall(stall_ns) => std::thread::sleep(Duration::from_nanos(stall_ns)),
            // The standard library has a handler for these two, which takes one that somebody sends for none of its own.
            OwnFault::Signal(signal @ (SIGSEGV | SIGBUS)) => {
                let _ = signal_hook::low_level::emulate_default_handler(signal); // it ends here
            }
            OwnFault::Signal(signal) => {
                let _ = Signal::from_named_raw(signal).map(|signal| kill_process(getpid(), signal));
            }
        }
    }
}

/// A process that is about to be ended in the place of a signal is sent that first, where it handles it: it writes down where it is, and
/// waits.
fn let_write_down(sandbox: &Sandbox, process: &Spawned, number: i32) {
    let handled = disposition::of(process.pid, number) == Disposition::Handled;
    let Some(signal) = Signal::from_named_raw(number).filter(|_| handled) else { return };
    let begun_ns = now_ns();
    if pidfd_send_signal(&process.pidfd, signal).is_ok() {
        // One that is held does not hear it.
        while !sandbox.has_written_crash()
            && now_ns() - begun_ns < WRITTEN_NS
            && !is_readable(process.pidfd.as_fd())
        {
            std::thread::sleep(Duration::from_micros(100));
        }
    }
}

/// How long a process may take to write down where it is, ns.
const WRITTEN_NS: u64 = 5_000_000;
/// How long an answer may take to whoever has ordered it.
const ANSWERED: Duration = Duration::from_millis(20);

fn provoked(fault: Fault) -> String {
    format!("fault {fault} is provoked")
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use super::*;
    use crate::cleanup::tests::shell;

    #[test]
    fn a_process_that_ends_is_awaited_no_longer_than_it_takes_and_one_that_sleeps_on_as_long_as_was_said() {
        let (process, _output) = shell("exec sleep 60");
        for clock in [Clock::Virtual, Clock::Wall] {
            let begun = Instant::now();
            await_end(&process, clock, 50_000_000);
            let elapsed = begun.elapsed();
            assert!(elapsed >= Duration::from_millis(50), "{clock:?}: {elapsed:?}");
            assert!(
                elapsed.as_nanos() < u128::from(STARVED_PATIENCE_NS),
                "it sleeps: {clock:?}: {elapsed:?}"
            );
        }
        pidfd_send_signal(&process.pidfd, Signal::KILL).unwrap();
        let begun = Instant::now();
        await_end(&process, Clock::Virtual, STARVED_PATIENCE_NS);
        assert!(begun.elapsed().as_nanos() < u128::from(STARVED_PATIENCE_NS));
    }
}
