//! How frames travel beside a bus: one codec a file, bytes in and frames out, without a socket or a clock.

pub mod candump;
pub mod cannelloni;
pub mod native;
pub mod slcan;
pub mod socketcand;
