//! One test for each requirement that is built; its name begins with the requirement's identifier (`tests/requirements.txt`).
//!
//! Where implementations differ, the test accepts what any of them does, and the table says what is done here.
#![allow(clippy::unwrap_used, clippy::panic)] // a test may be blunt

mod bench;
mod cores;
mod deadlines;
mod events;
mod extensions;
mod functional_status;
mod general;
mod handler;
mod health;
mod lending;
mod locking;
mod locks;
mod logbooks;
mod memory_blocks;
mod messages;
mod mutexes;
mod name_services;
mod objects;
mod partition;
mod port_lists;
mod ports;
mod process;
mod regressions;
mod rules;
mod scenarios;
mod semaphores;
mod start;
mod suspension;
mod time;
