//! Partitions of several processes: one thread for each process, of which exactly one runs at a time.
//!
//! Responsible for: letting that thread run which `bateleur-processes` names, on both clocks, from window to window. It must never let
//! two threads of a partition run at once, and never allocate or wait for anything but its turn in a signal's handler.
//!
//! Whoever runs holds the *baton*, a word that its thread sleeps on otherwise. Under the virtual clock it changes hands inside of services
//! only: computing takes no module time, each service takes [`SERVICE_NS`], and what happens is the same in every run. On the wall clock
//! the main thread watches timers and the window's end, and asks the running thread by a signal to look who runs next.
//!
//! ```no_run
//! use std::process::ExitCode;
//!
//! use bateleur_apex::processes::{Every, Initialisation, run_processes};
//! use bateleur_apex::StartError;
//! use bateleur_messages::Pressure;
//!
//! fn initialise(partition: &mut Initialisation<'_>) -> Result<(), StartError> {
//!     let pressure = partition.context().sampling_source::<Pressure>("pressure")?;
//!     let pressure = partition.port(pressure);
//!     let ready = partition.services().create_semaphore("ready", 0, 1, 0_u32)?;
//!     partition.process("fast", Every::ms(20).priority(20), move |process| loop {
//!         process.with(&pressure, |pressure| pressure.write(&Pressure::default()))?;
//!         process.call(|services| services.signal_semaphore(ready)).ok();
//!         process.periodic_wait()?;
//!     })?;
//!     partition.process("slow", Every::once().priority(10), move |process| loop {
//!         process.wait(|services| services.wait_semaphore(ready, -1))?;
//!     })?;
//!     Ok(())
//! }
//!
//! fn main() -> ExitCode {
//!     run_processes(initialise)
//! }
//! ```

mod alternate_stack;
mod baton;
mod c_library;
pub mod current;
mod foreign;
mod initialisation;
mod interrupted;
mod kernel;
mod ports;
mod process;
mod run;
mod shown;
mod stack;
mod thread;

pub(crate) use thread::{fault, own_name, stack_low};

pub use bateleur_processes::{Partition as Services, Progress, ReturnCode, standard};
pub use initialisation::{Every, Initialisation};
pub use kernel::SERVICE_NS;
pub use ports::PlanPorts;
pub use process::{Port, Process};
pub use run::run_processes;

#[cfg(test)]
mod tests;
