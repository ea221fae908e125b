//! Provokes a fault: ends or stops the process as a signal would, orders the fault through the control page, or stalls the
//! dispatcher. What follows is found like any other fault; that nothing follows is said.

use std::os::fd::AsFd;
use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;

use bateleur_contract::Clock;
use rustix::process::{Signal, pidfd_send_signal};

use super::watched::Life;
use super::{Monitor, seconds};
use crate::event::Event;
use crate::inject::{Aim, Fault};
use bateleur_system::disposition::{self, Disposition};
use bateleur_system::wait::await_any_end;
use bateleur_time::window_record::WindowRecord;

/// Virtual clock: how long a signal with a handler may take to end a process, real time, ns. One that goes on costs that much.
const HANDLER_NS: u64 = 50_000_000;
/// As above, for the kernel to end one.
const DEATH_NS: u64 = 1_000_000_000;
/// Windows that a partition may close before a fault that ends or stops it has come to nothing: the one in which it was
/// ordered, and the one in which it is carried out, and one more.
const WINDOWS: u32 = 3;

/// Signals that the kernel sends a process for what it does itself. Who handles them has nothing to go on with.
const OF_FAULTS: [i32; 7] = [4, 5, 6, 7, 8, 11, 31];

/// A process that the executive ends in the place of a signal. The first process of a PID namespace has no default actions
/// (pid_namespaces(7)), and only SIGKILL ends it.
#[derive(Debug, Clone, Copy)]
pub(super) struct InPlaceOf {
    pid: i32,
    signal: i32,
}

impl InPlaceOf {
    /// How process `pid`, which has ended with `status`, would have ended.
    pub(super) fn status(self, pid: i32, status: ExitStatus) -> ExitStatus {
        match self.pid == pid && status.signal() == Some(Signal::KILL.as_raw()) {
            true => ExitStatus::from_raw(self.signal),
            false => status,
        }
    }
}

/// A fault that was ordered and is to end or stop its partition.
#[derive(Debug, Clone, Copy)]
pub(super) struct Ordered {
    fault: Fault,
    closed: u32,
}

/// How a signal gets to a process.
enum Way {
    /// It is sent.
    Sent(Signal),
    /// It is sent, and the process has a handler for it.
    Handled(Signal),
    /// SIGKILL is sent in its place.
    InPlaceOf(i32),
}

/// What is done so that signal `number` does to process `pid` what it does to a process in no namespace.
fn way(pid: i32, number: i32) -> Result<Way, String> {
    let signal = Signal::from_named_raw(number).ok_or("there is no such signal")?;
    match signal {
        Signal::KILL | Signal::STOP => Ok(Way::Sent(signal)),
        Signal::CONT if disposition::is_stopped(pid) => Ok(Way::Sent(signal)),
        Signal::CONT => Err("it is not stopped".into()),
        _ if OF_FAULTS.contains(&number) => Ok(Way::InPlaceOf(number)),
        _ => match disposition::of(pid, number) {
            Disposition::Ignored => Err(format!("it ignores {}", Fault::Signal(number))),
            Disposition::Handled => Ok(Way::Handled(signal)),
            Disposition::Default => Ok(Way::InPlaceOf(number)),
        },
    }
}

impl Monitor {
    /// Provokes `fault` where it is aimed.
    ///
    /// # Errors
    /// It can not be provoked now, and why.
    pub fn provoke(&mut self, fault: Fault, aim: &Aim, module_ns: u64) -> Result<(), String> {
        let Some(partition) = aim.partition else { return self.stall(fault, module_ns) };
        let place = self.places[partition].ok_or("that partition runs on another module")?;
        let name = self.watched[place].sandbox.name.clone();
        let Life::Running(process) = &self.watched[place].life else {
            return Err(format!("{name} does not run now"));
        };
        if let Fault::Signal(number) = fault {
            let way = way(process.pid, number).map_err(|why| format!("{name}: {why}"))?;
            return self.send(place, fault, way, module_ns);
        }
        // Before what follows from it.
        self.events.tell(&provoked(&name, fault, module_ns));
        // The same instant of the same run is the same fault.
        let seed = module_ns ^ ((partition as u64) << 56);
        if let Some(order) = fault.order(aim, seed) {
            let watched = &mut self.watched[place];
            watched.sandbox.control.page.order_fault(&order);
            watched.ordered = order.kind.ends_or_stops().then_some(Ordered { fault, closed: 0 });
        }
        Ok(())
    }

    fn send(&mut self, place: usize, fault: Fault, way: Way, module_ns: u64) -> Result<(), String> {
        let watched = &mut self.watched[place];
        let name = watched.sandbox.name.clone();
        let Life::Running(process) = &watched.life else { return Err(format!("{name} does not run now")) };
        let (signal, patience_ns) = match way {
            Way::Sent(Signal::KILL) | Way::InPlaceOf(_) => (Signal::KILL, DEATH_NS),
            Way::Sent(signal) => (signal, 0),
            Way::Handled(signal) => (signal, HANDLER_NS),
        };
        pidfd_send_signal(&process.pidfd, signal).map_err(|_| format!("{name} has ended already"))?;
        if let Way::InPlaceOf(signal) = way {
            watched.in_place_of = Some(InPlaceOf { pid: process.pid, signal });
        }
        // Before what follows from it.
        let mut provoked = provoked(&name, fault, module_ns);
        if let (Way::Handled(_), Event::Message { text, .. }) = (way, &mut provoked) {
            text.push_str(", and it has a handler of its own for that");
        }
        self.events.tell(&provoked);
        if self.clock == Clock::Virtual && patience_ns > 0 {
            await_any_end(&[process.pidfd.as_fd()], patience_ns);
            self.look_at_process(place, module_ns);
        }
        Ok(())
    }

    /// Says so where a fault that was to end or stop the partition has come to nothing: its program does not link the library that
    /// carries faults out, or the partition does not let it.
    pub(super) fn judge_fault(&mut self, place: usize, record: &WindowRecord, module_ns: u64) {
        let watched = &mut self.watched[place];
        let Some(ordered) = &mut watched.ordered else { return };
        ordered.closed += u32::from(record.closed_ns.is_some());
        if ordered.closed < WINDOWS {
            return;
        }
        let text = format!("fault {} has come to nothing: the partition goes on", ordered.fault);
        watched.ordered = None;
        let partition = watched.sandbox.name.clone();
        self.events.tell(&Event::Undone { time_s: seconds(module_ns), partition, text: text.clone() });
        self.note_order(Some(place), &text, module_ns);
    }

    fn stall(&mut self, fault: Fault, module_ns: u64) -> Result<(), String> {
        let Fault::Stall(stall_ns) = fault else { return Err("only a stall hits the dispatcher".into()) };
        if self.clock == Clock::Virtual {
            return Err("on the virtual clock the dispatcher can not be late".into());
        }
        self.events.tell(&provoked(crate::inject::DISPATCHER, fault, module_ns));
        self.operator.stall.order(stall_ns);
        Ok(())
    }
}

fn provoked(whom: &str, fault: Fault, module_ns: u64) -> Event {
    Event::Message {
        time_s: seconds(module_ns),
        partition: whom.into(),
        text: format!("fault {fault} is provoked"),
    }
}
