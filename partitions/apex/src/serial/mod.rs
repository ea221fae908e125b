//! Serial lines, for partitions that are granted one: opened raw and without blocking, and tried again when they are gone.

mod device;
mod presence;

pub use device::{Device, DeviceError};
pub use presence::{Change, Presence};
