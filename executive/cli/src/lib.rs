//! The verbs that check, run and watch modules, and what every verb of the command line is made with.
//!
//! Responsible for: one module a verb, in `verb`, whose head is its manual page; the processes that the executive starts from this
//! program (recorder, observers); printing, exit codes and reading a schedule file, for the verbs of other crates too.
//! The one thing it must never do: know an aircraft, a simulator or a flight.

#[macro_use]
mod printing;

mod aside;
mod code;
mod crash_reporter;
mod doctor;
pub mod faults;
mod hexadecimal;
pub mod hosts;
pub mod http;
pub mod installed;
mod observer;
pub mod output;
pub mod plan_file;
mod player;
pub mod printed;
mod publisher;
mod recorder;
pub mod said;
pub mod setting;
mod templates;
mod verb;
pub mod words;

pub use aside::stand_aside;
pub use code::{CANNOT_RUN, Code, FINE, Format, WRONG};
pub use hexadecimal::bytes_of;
pub use verb::{Target, Verb, Watch, channels, links_text, status};
