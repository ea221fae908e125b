//! Threads of the executive.

use std::thread::Builder;

/// Bytes of a stack: the executive's memory is locked, and a locked stack is resident whole. None calls more than some levels deep, and
/// tables lie elsewhere.
const STACK: usize = 256 << 10;

/// A thread that is not yet started, with a name as the kernel shows it (15 bytes of it).
pub fn named(name: &str) -> Builder {
    Builder::new().name(name.to_owned()).stack_size(STACK)
}
