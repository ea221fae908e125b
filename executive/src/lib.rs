//! The time- and space-partitioned executive.
//!
//! Responsible for: reading the plan, granting windows, keeping partitions in their time and space, watching their
//! health and starting them again. It must never block on a partition: whatever a partition does or fails to do, the
//! next window starts at its instant.

pub mod agenda;
pub mod alignment;
pub mod change;
pub mod control;
pub mod dispatcher;
pub mod doctor;
pub mod event;
pub mod fast;
pub mod fence;
pub mod guarantee;
pub mod health;
pub mod helper;
pub mod inject;
pub mod instance;
pub mod keys;
pub mod line_counts;
pub mod machine;
pub mod module;
pub mod monitor;
pub mod partition;
pub mod plan;
pub mod planned;
pub mod recording;
pub mod seats;
pub mod slot;
pub mod system;
#[cfg(test)]
mod test_support;
pub mod together;
pub mod wall;
pub mod world;
