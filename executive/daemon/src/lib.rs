//! The executive that runs one module: its start, its frames on either clock, its end.

pub mod fast;
pub mod module;
pub mod recording;
pub mod world;
