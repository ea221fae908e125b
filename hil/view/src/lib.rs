//! A running module, or a recorded run, on a page in a browser.
//!
//! Responsible for: one page on a port of this machine, which shows what is the case and gives orders as the user who started it could by
//! the command line. The one thing it must never do: disturb a frame. It sees what any client of the control socket and reader of the run's
//! logs sees, holds a bounded amount of it, and runs at the lowest priority outside of the processors of the dispatchers.
//!
//! ```text
//! control socket, observer, logs ──▶ live ──┐
//!                                           ├─▶ scene ──▶ draw ──▶ server ──▶ page
//! folder of a run ───────────────▶ recorded ┘
//! ```

#![forbid(unsafe_code)]

#[macro_use(eprintln)]
extern crate bateleur_executive_cli;

mod air;
mod draw;
mod live;
mod page;
mod recorded;
mod scene;
mod server;
mod verb;

pub use air::{MISSION_FILE, Place};
pub use verb::{Arguments, run};
