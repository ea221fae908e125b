//! The atomics of sealed memory: those of the model checker where the feature `model` is on, so that tests go through every order in
//! which two sides can meet.

pub(crate) use std::sync::atomic::Ordering;

#[cfg(feature = "model")]
pub(crate) use loom::sync::atomic::{AtomicU64, fence};
#[cfg(not(feature = "model"))]
pub(crate) use std::sync::atomic::{AtomicU64, fence};

/// Runs `scene` in every order of its threads' steps in which at most three times one loses the processor unasked: faults that need more
/// are rare, and the time grows with each.
#[cfg(all(test, feature = "model"))]
pub(crate) fn explore(scene: impl Fn() + Sync + Send + 'static) {
    let mut builder = loom::model::Builder::new();
    builder.preemption_bound = Some(3);
    builder.check(scene);
}
