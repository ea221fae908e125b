//! The function that gives the module its beat: synchronize, execute and the telemetry time-outs.

fn main() {}
