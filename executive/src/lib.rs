//! The time- and space-partitioned executive.

pub mod plan;
