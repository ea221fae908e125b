//! What the cargo aliases run: fly and verify.

fn main() {}
