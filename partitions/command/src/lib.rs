//! The function that talks to the ground station over a serial line.
//!
//! Responsible for: the frames on the line, the way of each order to the functions that it concerns, and the way of all
//! telemetry to the ground. It must never believe that the line is there: noise, a device that vanishes and a ground
//! station that does not listen are the usual case, and none of them may cost memory or time without bound.

mod contingency;
mod downlink;
mod health;
mod kept;
mod numbers;
mod paced;
mod radio;
mod station;
mod uplink;

pub use contingency::{Cause, Change, Contingencies, Contingency, Ladder, MOST_RUNGS, Rung};
pub use downlink::{BACKLOG, Downlink};
pub use health::HealthTexts;
pub use kept::Kept;
pub use numbers::{Numbers, Rates, parameters, sane_runway};
pub use paced::Paced;
pub use radio::{Radio, RadioError};
pub use station::{Encoding, Setup, Station};
pub use uplink::{Delivery, Uplink, receivers};
