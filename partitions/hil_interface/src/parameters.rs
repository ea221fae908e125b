//! What the ground can read of this function. Nothing can be set: who the simulator is, and what is spoken, belongs to the plan.

use bateleur_messages::hil::Protocol;
use bateleur_messages::parameter::{Kind, Parameters, Row};
use bateleur_messages::telemetry::FROM_HIL_INTERFACE;

/// The attributes that are numbers or words of a list.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Numbers {
    /// What is spoken.
    pub protocol: Protocol,
    /// The simulator follows the module's time.
    pub lockstep: bool,
    /// HIL mode is on from the start.
    pub hil_mode: bool,
    /// Own system number in MAVLink.
    pub system: u8,
    /// The simulator's; 0: any.
    pub simulator_system: u8,
}

/// The table.
pub fn parameters() -> Parameters<Numbers> {
    Parameters::new(FROM_HIL_INTERFACE, ROWS)
}

static ROWS: &[Row<Numbers>] = &[
    Row::fixed("HIL_PROTOCOL", Kind::Choice, |n| Some(f64::from(n.protocol as u32))),
    Row::fixed("HIL_LOCKSTEP", Kind::Choice, |n| Some(f64::from(n.lockstep))),
    Row::fixed("HIL_MODE", Kind::Choice, |n| Some(f64::from(n.hil_mode))),
    Row::fixed("HIL_SYSTEM", Kind::Whole, |n| Some(f64::from(n.system))),
    Row::fixed("HIL_SIM_SYSTEM", Kind::Whole, |n| Some(f64::from(n.simulator_system))),
];
