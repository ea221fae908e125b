//! The function that turns actuator commands into timer values, or passes the safety pilot through.

fn main() {}
