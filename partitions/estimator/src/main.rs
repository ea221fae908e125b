//! The function that estimates position, velocity and attitude.

fn main() {}
