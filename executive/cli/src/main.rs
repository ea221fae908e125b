//! The command line of the executive.

fn main() {}
