//! Provokes a fault: sends the signal, orders it through the control page, or stalls the dispatcher. What follows is found
//! like any other fault.

use std::os::fd::AsFd;

use bateleur_contract::Clock;
use rustix::process::{Signal, pidfd_send_signal};

use super::watched::Life;
use super::{Monitor, seconds};
use crate::event::Event;
use crate::inject::{Aim, Fault};
use crate::partition::await_any_end;

/// Virtual clock: how long a signal may take to end a process, real time, ns. The kernel ends a sleeping process at once;
/// one that ignores the signal costs that much.
const DEATH_NS: u64 = 50_000_000;

impl Monitor {
    /// Provokes `fault` where it is aimed.
    ///
    /// # Errors
    /// It can not be provoked now, and why.
    pub fn provoke(&mut self, fault: Fault, aim: &Aim, module_ns: u64) -> Result<(), String> {
        let Some(partition) = aim.partition else { return self.stall(fault, module_ns) };
        let place = self.places[partition].ok_or("that partition runs on another module")?;
        let name = self.watched[place].cage.name.clone();
        let Life::Running(process) = &self.watched[place].life else {
            return Err(format!("{name} does not run now"));
        };
        // Before what follows from it.
        self.events.tell(&provoked(&name, fault, module_ns));
        match fault {
            Fault::Signal(number) => {
                let signal = Signal::from_named_raw(number).ok_or("there is no such signal")?;
                let _ = pidfd_send_signal(&process.pidfd, signal); // it has ended already
                if self.clock == Clock::Virtual {
                    await_any_end(&[process.pidfd.as_fd()], DEATH_NS);
                    self.look_at_process(place, module_ns);
                }
            }
            fault => {
                // The same instant of the same run is the same fault.
                let seed = module_ns ^ ((partition as u64) << 56);
                if let Some(order) = fault.order(aim, seed) {
                    self.watched[place].cage.slot.page.order_fault(&order);
                }
            }
        }
        Ok(())
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
