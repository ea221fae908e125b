//! The atomics of sealed memory: those of the model checker where the feature `model` is on, so that tests go through every order in
//! which two sides can meet.

pub(crate) use std::sync::atomic::Ordering;

#[cfg(feature = "model")]
pub(crate) use loom::sync::atomic::{AtomicU64, fence};
#[cfg(not(feature = "model"))]
pub(crate) use std::sync::atomic::{AtomicU64, fence};
