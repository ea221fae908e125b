//! The services of ARINC 653 Part 1, each with the standard's name and return codes.
//!
//! Checks stand in the order in which they decide. Nothing changes where a service returns an error, unless it says so.

pub(crate) mod blackboards;
pub(crate) mod buffers;
pub(crate) mod events;
mod health;
pub(crate) mod logbooks;
mod memory_blocks;
pub(crate) mod mutexes;
pub(crate) mod name_services;
mod partition;
pub(crate) mod port_lists;
mod process;
mod queuing;
mod sampling;
pub(crate) mod semaphores;
mod time;

use crate::partition::Partition;
use crate::return_code::ReturnCode;
use crate::standard::{OperatingMode, QueuingDiscipline};

impl Partition {
    /// Objects are created before NORMAL only.
    fn initialising(&self) -> Result<(), ReturnCode> {
        if self.mode == OperatingMode::Normal { Err(ReturnCode::InvalidMode) } else { Ok(()) }
    }
}

/// INVALID_PARAM unless it holds.
fn valid(holds: bool) -> Result<(), ReturnCode> {
    if holds { Ok(()) } else { Err(ReturnCode::InvalidParam) }
}

/// INVALID_CONFIG unless it holds.
fn configured(holds: bool) -> Result<(), ReturnCode> {
    if holds { Ok(()) } else { Err(ReturnCode::InvalidConfig) }
}

fn discipline(number: impl Into<u32>) -> Result<QueuingDiscipline, ReturnCode> {
    QueuingDiscipline::try_from(number.into())
}

/// Puts a message in place of what was there.
fn copy(message: &[u8], into: &mut Vec<u8>) {
    into.clear();
    into.extend_from_slice(message);
}
