//! What a partition process does about signals that say more than an end by a signal could.
//!
//! Responsible for: turning them into exit codes of the contract. The first process of a PID namespace does not hear a
//! SIGABRT that it has no handler for, and its abort would look like a memory violation; and only the process itself is
//! told that a page of the machine's memory is damaged, or where its stack pointer stood. It must never hide a fault: each handler ends
//! the process, or hands the fault to an error handler of the partition's own.
#![allow(unsafe_code)] // installs handlers that make one system call

use bateleur_contract::exit;
use bateleur_processes::standard::ErrorCode;

/// `si_code` of a SIGBUS: damaged memory was touched, or was found elsewhere in the process.
const DAMAGED_MEMORY: [libc::c_int; 2] = [4, 5]; // BUS_MCEERR_AR, BUS_MCEERR_AO

/// Installs the handlers, before anything of the partition runs.
pub(crate) fn install() {
    set(libc::SIGABRT, on_abort as *const () as usize, libc::SA_ONSTACK);
    // Instead of the handler of Rust's runtime, whose idea of where the main thread's stack ends does not hold everywhere.
    set(libc::SIGSEGV, on_fault as *const () as usize, libc::SA_ONSTACK | libc::SA_SIGINFO);
    set(libc::SIGBUS, on_bus_error as *const () as usize, libc::SA_ONSTACK | libc::SA_SIGINFO);
}

/// An access so near to the stack pointer that faults can only be one to a stack that has come to its end, bytes. Compilers
/// touch every page of a frame, so that no access skips the guard page.
const NEAR: u64 = 64 << 10;

pub(crate) fn set(signal: libc::c_int, handler: usize, flags: libc::c_int) {
    // SAFETY: plain data, all zero is an empty mask; the handlers below make async-signal-safe calls only.
    unsafe {
        let mut action: libc::sigaction = std::mem::zeroed();
        action.sa_sigaction = handler;
        action.sa_flags = flags;
        libc::sigaction(signal, &raw const action, std::ptr::null_mut()); // fails for numbers that are no signals only
    }
}

extern "C" fn on_abort(_: libc::c_int) {
    // SAFETY: ends the process without running anything.
    unsafe { libc::_exit(exit::ABORTED) }
}

extern "C" fn on_fault(signal: libc::c_int, about: *mut libc::siginfo_t, context: *mut libc::c_void) {
    // SAFETY: the kernel hands a handler with SA_SIGINFO valid structures of these types.
    let (address, stack) = unsafe { ((*about).si_addr() as u64, stack_pointer(context.cast())) };
    let overflow = address.abs_diff(stack) < NEAR;
    let code = if overflow { ErrorCode::StackOverflow } else { ErrorCode::MemoryViolation };
    // SAFETY: as above.
    if unsafe { crate::processes::fault(code, address, context.cast()) } {
        return;
    }
    if overflow {
        // SAFETY: ends the process without running anything.
        unsafe { libc::_exit(exit::STACK_OVERFLOW) }
    }
    set(signal, libc::SIG_DFL, 0); // as below
}

/// Where the interrupted code had its stack.
#[cfg(target_arch = "x86_64")]
unsafe fn stack_pointer(context: *const libc::ucontext_t) -> u64 {
    // SAFETY: the caller's: a context of the kernel.
    unsafe { (*context).uc_mcontext.gregs[libc::REG_RSP as usize] as u64 }
}

/// Where the interrupted code had its stack.
#[cfg(target_arch = "aarch64")]
unsafe fn stack_pointer(context: *const libc::ucontext_t) -> u64 {
    // SAFETY: the caller's: a context of the kernel.
    unsafe { (*context).uc_mcontext.sp }
}

extern "C" fn on_bus_error(signal: libc::c_int, about: *mut libc::siginfo_t, context: *mut libc::c_void) {
    // SAFETY: the kernel hands a handler with SA_SIGINFO valid structures.
    let (code, address) = unsafe { ((*about).si_code, (*about).si_addr() as u64) };
    let damaged = DAMAGED_MEMORY.contains(&code);
    let error = if damaged { ErrorCode::HardwareFault } else { ErrorCode::MemoryViolation };
    // SAFETY: as above.
    if unsafe { crate::processes::fault(error, address, context.cast()) } {
        return;
    }
    if damaged {
        // SAFETY: as above.
        unsafe { libc::_exit(exit::HARDWARE_FAULT) }
    }
    // Any other is a memory violation: on return the instruction is tried again and ends the process as always.
    set(signal, libc::SIG_DFL, 0);
}
