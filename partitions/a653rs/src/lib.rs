//! Partitions that were written with the traits of `a653rs`, and for the Linux hypervisor of that project.
//!
//! Responsible for: the traits of `a653rs` 0.6, on the services of the process that calls, and the names under which partitions find them
//! there. What a service does is decided in `bateleur-processes`. It must never interpret what a program asks for, but where programs rely
//! on that hypervisor: a period of 0 is the partition's, every negative time is infinite, and one periodic process goes before one
//! aperiodic process.
//!
//! In the `Cargo.toml` of a partition:
//!
//! ```toml
//! [dependencies]
//! a653rs = { version = "0.6", features = ["macros"] }
//! a653rs-linux = { package = "bateleur-a653rs", path = "…/partitions/a653rs" }
//! ```

mod convert;
mod extended;
mod messages;
mod objects;
pub mod partition;
mod ports;
mod processes;
