//! What follows from a plan, shown.

pub(crate) mod facts;
