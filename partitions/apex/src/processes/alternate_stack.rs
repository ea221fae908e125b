//! A stack for signals, so that a process whose own has come to its end can be told so.
#![allow(unsafe_code)] // hands memory to the kernel

/// Bytes of it, at least what the kernel stores of a processor with large registers.
const BYTES: usize = 64 << 10;

/// Gives this thread such a stack, unless it has one (the runtime of a Rust program gives it one). Kept as long as the process lives:
/// a thread that is abandoned could not give it back.
pub(crate) fn install() {
    // SAFETY: plain data, all zero is a valid value; the kernel fills it, and later takes a piece of memory that is never freed.
    unsafe {
        let mut stack: libc::stack_t = std::mem::zeroed();
        libc::sigaltstack(std::ptr::null(), &raw mut stack);
        if stack.ss_flags & libc::SS_DISABLE == 0 {
            return;
        }
        let memory = Vec::<u8>::with_capacity(BYTES).leak();
        let given = libc::stack_t { ss_sp: memory.as_mut_ptr().cast(), ss_flags: 0, ss_size: BYTES };
        libc::sigaltstack(&raw const given, std::ptr::null_mut());
    }
}
