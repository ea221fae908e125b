//! What a signal has interrupted, from the registers that it has saved.
#![allow(unsafe_code)] // reads a context of the kernel

use libc::ucontext_t;

/// Registers that a system call uses.
struct Call {
    /// The next instruction.
    instruction: usize,
    /// The call's number, while it is about to be made (again).
    number: i64,
    /// What the call before has returned.
    result: i64,
    /// Its second argument.
    second: i64,
}

/// The instruction that makes a system call.
#[cfg(target_arch = "x86_64")]
const CALL: &[u8] = &[0x0f, 0x05];
#[cfg(target_arch = "aarch64")]
const CALL: &[u8] = &[0x01, 0x00, 0x00, 0xd4];

#[cfg(target_arch = "x86_64")]
unsafe fn call(context: *const ucontext_t) -> Call {
    // SAFETY: the caller's: a context of the kernel.
    let registers = unsafe { &(*context).uc_mcontext.gregs };
    let at = |register: libc::c_int| registers[register as usize];
    let (rip, rax, rsi) = (at(libc::REG_RIP), at(libc::REG_RAX), at(libc::REG_RSI));
    Call { instruction: rip as usize, number: rax, result: rax, second: rsi }
}

#[cfg(target_arch = "aarch64")]
unsafe fn call(context: *const ucontext_t) -> Call {
    // SAFETY: the caller's: a context of the kernel.
    let machine = unsafe { &(*context).uc_mcontext };
    let at = |register: usize| machine.regs[register] as i64;
    Call { instruction: machine.pc as usize, number: at(8), result: at(0), second: at(1) }
}

/// The instruction that runs next.
///
/// # Safety
/// `context` is the kernel's, of a signal's handler.
pub(crate) unsafe fn instruction(context: *const ucontext_t) -> usize {
    // SAFETY: the caller's.
    unsafe { call(context) }.instruction
}

/// The thread was asleep in the kernel, at a futex or for input, or is about to be. The kernel makes such a call again after the handler, or
/// has ended it with EINTR.
///
/// # Safety
/// As above.
pub(crate) unsafe fn sleeps(context: *const ucontext_t) -> bool {
    // SAFETY: the caller's.
    let call = unsafe { call(context) };
    if is_call(call.instruction) {
        return match call.number {
            libc::SYS_futex => is_wait(call.second),
            number => [libc::SYS_read, libc::SYS_recvfrom, libc::SYS_recvmsg].contains(&number),
        };
    }
    call.result == -i64::from(libc::EINTR) && is_call(call.instruction.wrapping_sub(CALL.len()))
}

/// A futex operation that sleeps.
fn is_wait(operation: i64) -> bool {
    let flags = i64::from(libc::FUTEX_PRIVATE_FLAG | libc::FUTEX_CLOCK_REALTIME);
    [libc::FUTEX_WAIT, libc::FUTEX_WAIT_BITSET].map(i64::from).contains(&(operation & !flags))
}

/// A system call's instruction is at this address, which lies in code that runs.
fn is_call(at: usize) -> bool {
    // The page before may not be there.
    const PAGE: usize = 4096;
    let whole = at % PAGE <= PAGE - CALL.len();
    // SAFETY: bytes of the code that was interrupted.
    whole && unsafe { std::slice::from_raw_parts(at as *const u8, CALL.len()) } == CALL
}
