//! The crash memory: where a partition's process that is about to end by a fault leaves what a report of it is made from.
//!
//! A file in memory of a size that stays, one for each process. The process writes it by calls of the kernel in its signal handlers and
//! never maps it: an address that leads nowhere is an error of the call. Whoever reads it believes nothing of it.
//!
//! A head of words comes first, then the name of the process of ARINC 653, the bytes above the stack pointer, and the map of the
//! process's memory as the kernel tells it (`/proc/self/maps`).

/// The place of the name, and its longest, bytes.
pub const NAME_AT: u64 = 512;
/// See [`NAME_AT`].
pub const NAME_BYTES: usize = 64;
/// The place of the copied stack, and its longest, bytes.
pub const STACK_AT: u64 = 4096;
/// See [`STACK_AT`].
pub const STACK_BYTES: usize = 64 << 10;
/// The place of the map of memory, and its longest, bytes.
pub const MAPS_AT: u64 = STACK_AT + STACK_BYTES as u64;
/// See [`MAPS_AT`].
pub const MAPS_BYTES: usize = 56 << 10;
/// Bytes of the whole memory.
pub const BYTES: u64 = MAPS_AT + MAPS_BYTES as u64;

/// Registers of the larger of the two architectures.
pub const REGISTERS: usize = 34;
/// Words before the registers.
const FIRST: usize = 10;
/// Bytes of the head.
pub const HEAD_BYTES: usize = (FIRST + REGISTERS) * 8;

/// [`CrashHead::state`]: nothing was written.
pub const NOTHING: u64 = 0;
/// [`CrashHead::state`]: the process has ended in the midst of it.
pub const BEGUN: u64 = 1;
/// [`CrashHead::state`]: everything was written.
pub const WHOLE: u64 = 2;

/// [`CrashHead::architecture`]: x86-64. Registers are in the order of DWARF: rax, rdx, rcx, rbx, rsi, rdi, rbp, rsp, r8 to r15; then rip and
/// rflags.
pub const X86_64: u64 = 1;
/// [`CrashHead::architecture`]: aarch64. Registers are x0 to x30, sp, pc, pstate.
pub const AARCH64: u64 = 2;

/// [`CrashHead::signal`]: none, a Rust panic.
pub const PANIC: u64 = 0;

/// What stands first in the memory. Every bit pattern is one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CrashHead {
    /// How far the process has come.
    pub state: u64,
    /// Whose registers they are.
    pub architecture: u64,
    /// The signal's number, or [`PANIC`].
    pub signal: u64,
    /// The signal's `si_code`, as a number with a sign.
    pub code: u64,
    /// The address that the signal is about.
    pub address: u64,
    /// The number of the process within its namespace.
    pub process: u64,
    /// That of the thread; the main thread has the process's.
    pub thread: u64,
    /// Address of the first byte of the copied stack.
    pub stack_from: u64,
    /// Bytes of the stack that were copied.
    pub stack_bytes: u64,
    /// Bytes of the map that were copied.
    pub maps_bytes: u64,
    /// The registers.
    pub registers: [u64; REGISTERS],
}

impl Default for CrashHead {
    fn default() -> Self {
        Self::from_bytes(&[0; HEAD_BYTES])
    }
}

impl CrashHead {
    /// As it lies in the memory. Takes no memory itself.
    #[must_use]
    pub fn to_bytes(&self) -> [u8; HEAD_BYTES] {
        let mut bytes = [0; HEAD_BYTES];
        let first = [
            self.state,
            self.architecture,
            self.signal,
            self.code,
            self.address,
            self.process,
            self.thread,
            self.stack_from,
            self.stack_bytes,
            self.maps_bytes,
        ];
        let words = first.iter().chain(&self.registers);
        for (place, word) in bytes.chunks_exact_mut(8).zip(words) {
            place.copy_from_slice(&word.to_ne_bytes());
        }
        bytes
    }

    /// What lies in the memory.
    #[must_use]
    pub fn from_bytes(bytes: &[u8; HEAD_BYTES]) -> Self {
        let mut words = [0; FIRST + REGISTERS];
        for (word, place) in words.iter_mut().zip(bytes.chunks_exact(8)) {
            *word = u64::from_ne_bytes(place.try_into().unwrap_or_default());
        }
        let mut registers = [0; REGISTERS];
        registers.copy_from_slice(&words[FIRST..]);
        let [
            state,
            architecture,
            signal,
            code,
            address,
            process,
            thread,
            stack_from,
            stack_bytes,
            maps_bytes,
            ..,
        ] = words;
        Self {
            state,
            architecture,
            signal,
            code,
            address,
            process,
            thread,
            stack_from,
            stack_bytes,
            maps_bytes,
            registers,
        }
    }
}

// No part lies in another one.
const _: () = assert!(HEAD_BYTES as u64 <= NAME_AT && NAME_AT + NAME_BYTES as u64 <= STACK_AT);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn head_is_read_as_it_was_written_whatever_it_holds() {
        let mut random = 1_u64;
        for _ in 0..1_000 {
            let bytes: [u8; HEAD_BYTES] = std::array::from_fn(|_| {
                random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (random >> 56) as u8
            });
            assert_eq!(CrashHead::from_bytes(&bytes).to_bytes(), bytes);
        }
        let head = CrashHead { state: WHOLE, maps_bytes: 7, ..CrashHead::default() };
        assert_eq!(CrashHead::from_bytes(&head.to_bytes()), head);
    }
}
