//! The function that talks to the ground station over a serial line.

fn main() {}
