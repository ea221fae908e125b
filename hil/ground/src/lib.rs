//! The ground station: way-points, autopilot, telemetry.
//!
//! Responsible for: bringing orders to the aircraft and seeing that they arrive ([`Mission`]), keeping the newest
//! telemetry ([`Board`]), and serving a person at a keyboard ([`console`]). The one thing it must never do: look at a
//! clock. Every step takes the time from its caller, so that a mission runs the same in real and in virtual time.

#![forbid(unsafe_code)]

pub mod board;
pub mod console;
pub mod link;
mod mission;
mod parameters;
mod pilot;
mod plan;
mod progress;
mod retry_queue;
mod watch;
mod waypoints;

pub use board::{Board, Latest};
pub use console::Console;
pub use link::{Link, LinkCounters, LinkError, Stream};
pub use mission::Mission;
pub use parameters::{ParameterDesk, describe_parameter};
pub use pilot::{Pilot, UdpPilot};
pub use plan::{MOST_WAYPOINTS, MissionPlan, PlanError};
pub use progress::{Event, Outcome, Phase, Progress, Severity};
pub use waypoints::WaypointDesk;
