//! Code of another language on the thread of a process, and the way out of it when its process begins again within a service.
//!
//! Nothing can unwind through such code. So the thread remembers where its stack was when the code was called, and goes back there: frames
//! in between are gone without a trace. Those of this library have nothing in them by then that anybody waits for.
#![allow(unsafe_code)] // moves the stack pointer

use std::arch::global_asm;
use std::cell::Cell;

use super::current::ForeignEntry;

thread_local! {
    /// Where the stack was when the code of another language was called; 0: this thread runs none.
    static BASE: Cell<usize> = const { Cell::new(0) };
}

unsafe extern "C" {
    /// Keeps the registers that a function has to keep on the stack, stores where in `base`, and calls `entry`. 0: it has returned.
    /// 1: it was left.
    fn bateleur_call_foreign(entry: ForeignEntry, base: *mut usize) -> u32;
    /// Ends the call that stored `base`.
    fn bateleur_leave_foreign(base: usize) -> !;
}

/// Calls it. False: it was left, and begins again.
pub(crate) fn call(entry: ForeignEntry) -> bool {
    // SAFETY: the base is this thread's own, and stays valid until the call returns, in whichever way.
    let left = unsafe { BASE.with(|base| bateleur_call_foreign(entry, base.as_ptr())) };
    BASE.set(0);
    left == 0
}

/// Leaves code of another language, if this thread runs any.
pub(crate) fn leave() {
    let base = BASE.get();
    if base != 0 {
        // SAFETY: `call` is below on this stack, and its registers lie where it stored them.
        unsafe { bateleur_leave_foreign(base) }
    }
}

#[cfg(target_arch = "x86_64")]
global_asm!(
    ".global bateleur_call_foreign",
    ".hidden bateleur_call_foreign",
    ".type bateleur_call_foreign, @function",
    "bateleur_call_foreign:",
    "push rbp",
    "push rbx",
    "push r12",
    "push r13",
    "push r14",
    "push r15",
    "sub rsp, 8",
    "mov [rsi], rsp",
    "call rdi",
    "xor eax, eax",
    "2:",
    "add rsp, 8",
    "pop r15",
    "pop r14",
    "pop r13",
    "pop r12",
    "pop rbx",
    "pop rbp",
    "ret",
    ".global bateleur_leave_foreign",
    ".hidden bateleur_leave_foreign",
    ".type bateleur_leave_foreign, @function",
    "bateleur_leave_foreign:",
    "mov rsp, rdi",
    "mov eax, 1",
    "jmp 2b",
);

#[cfg(target_arch = "aarch64")]
global_asm!(
    ".global bateleur_call_foreign",
    ".hidden bateleur_call_foreign",
    ".type bateleur_call_foreign, %function",
    "bateleur_call_foreign:",
    "stp x29, x30, [sp, #-160]!",
    "stp x19, x20, [sp, #16]",
    "stp x21, x22, [sp, #32]",
    "stp x23, x24, [sp, #48]",
    "stp x25, x26, [sp, #64]",
    "stp x27, x28, [sp, #80]",
    "stp d8, d9, [sp, #96]",
    "stp d10, d11, [sp, #112]",
    "stp d12, d13, [sp, #128]",
    "stp d14, d15, [sp, #144]",
    "mov x9, sp",
    "str x9, [x1]",
    "blr x0",
    "mov w0, #0",
    "2:",
    "ldp x19, x20, [sp, #16]",
    "ldp x21, x22, [sp, #32]",
    "ldp x23, x24, [sp, #48]",
    "ldp x25, x26, [sp, #64]",
    "ldp x27, x28, [sp, #80]",
    "ldp d8, d9, [sp, #96]",
    "ldp d10, d11, [sp, #112]",
    "ldp d12, d13, [sp, #128]",
    "ldp d14, d15, [sp, #144]",
    "ldp x29, x30, [sp], #160",
    "ret",
    ".global bateleur_leave_foreign",
    ".hidden bateleur_leave_foreign",
    ".type bateleur_leave_foreign, %function",
    "bateleur_leave_foreign:",
    "mov sp, x0",
    "mov w0, #1",
    "b 2b",
);

#[cfg(test)]
mod tests {
    use super::*;

    thread_local! {
        static DEPTH: Cell<u32> = const { Cell::new(0) };
    }

    extern "C" fn returns() {
        DEPTH.set(1);
    }

    extern "C" fn is_left() {
        fn deeper(depth: u32) -> u32 {
            DEPTH.set(depth);
            if depth == 100 {
                leave();
                return 0;
            }
            std::hint::black_box(deeper(depth + 1)) + 1
        }
        std::hint::black_box(deeper(1));
    }

    #[test]
    fn code_that_is_left_gives_its_callers_registers_back_as_often_as_one_likes() {
        let (kept, real) = (std::hint::black_box(77_u64), std::hint::black_box(0.5_f64));
        for round in 0..1000_u64 {
            assert!(call(returns));
            assert!(!call(is_left));
            assert_eq!(DEPTH.get(), 100, "round {round}");
            assert_eq!((kept + round, real * 2.0), (77 + round, 1.0));
        }
        leave(); // nothing to leave: it returns
    }
}
