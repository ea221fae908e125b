//! What a partition process does about signals of faults.
//!
//! Responsible for: having a fault written down before it ends the process, and turning into exit codes of the contract what an end by a
//! signal could not say. The first process of a PID namespace does not hear a
//! SIGABRT that it has no handler for, and its abort would look like a memory violation; and only the process itself is
//! told that a page of the machine's memory is damaged, or where its stack pointer stood. It must never hide a fault: each handler ends
//! the process, or hands the fault to an error handler of the partition's own.
#![allow(unsafe_code)] // installs handlers that make calls of the kernel

use bateleur_contract::exit;
use bateleur_processes::standard::ErrorCode;
use libc::{c_int, c_void, siginfo_t, ucontext_t};

use crate::crash;

/// `si_code` of a SIGBUS: damaged memory was touched, or was found elsewhere in the process.
const DAMAGED_MEMORY: [c_int; 2] = [4, 5]; // BUS_MCEERR_AR, BUS_MCEERR_AO

/// A handler with the kernel's word about the signal, and what it has interrupted.
type Handler = extern "C" fn(c_int, *mut siginfo_t, *mut c_void);

/// Installs the handlers, before anything of the partition runs.
pub(crate) fn install() {
    set_handler(libc::SIGABRT, on_abort);
    // Instead of the handler of Rust's runtime, whose idea of where the main thread's stack ends does not hold everywhere.
    set_handler(libc::SIGSEGV, on_fault);
    set_handler(libc::SIGBUS, on_bus_error);
    install_traps();
}

/// Those for traps of the processor.
pub(crate) fn install_traps() {
    set_handler(libc::SIGFPE, on_trap);
    set_handler(libc::SIGILL, on_trap);
}

fn set_handler(signal: c_int, handler: Handler) {
    set(signal, handler as *const () as usize, libc::SA_ONSTACK | libc::SA_SIGINFO);
}

/// An access so near to the stack pointer that faults can only be one to a stack that has come to its end, where nobody knows where that is,
/// bytes. Compilers touch every page of a frame, so that no access skips the guard page.
const NEAR: u64 = 64 << 10;

/// Whether an access to `address` that faults is one to a stack that has come to its end. `low`: where that is, if it is known. Other memory may
/// lie next to the stack of a thread.
fn is_overflow(address: u64, stack: u64, low: Option<u64>, page: u64) -> bool {
    match low {
        Some(low) => stack < low || (low.saturating_sub(page)..low).contains(&address),
        None => address.abs_diff(stack) < NEAR,
    }
}

pub(crate) fn set(signal: c_int, handler: usize, flags: c_int) {
    // SAFETY: plain data, all zero is an empty mask; the handlers below make async-signal-safe calls only.
    unsafe {
        let mut action: libc::sigaction = std::mem::zeroed();
        action.sa_sigaction = handler;
        action.sa_flags = flags;
        libc::sigaction(signal, &raw const action, std::ptr::null_mut()); // fails for numbers that are no signals only
    }
}

/// What a handler is told.
#[derive(Clone, Copy)]
struct Caught {
    signal: c_int,
    about: *const siginfo_t,
    context: *const ucontext_t,
}

impl Caught {
    /// Somebody has sent the signal, and nothing of the process has faulted.
    fn was_sent(self) -> bool {
        // SAFETY: the kernel hands a handler with SA_SIGINFO valid structures; as below.
        unsafe { (*self.about).si_code <= 0 }
    }

    /// Somebody has sent it: what it does by default. If it was the executive, it is to be as if the process had faulted where it is: that
    /// is written down, and the executive ends the process.
    fn suffer(self) {
        // SAFETY: numbers, a sleep, and a signal to this thread.
        unsafe {
            if (*self.about).si_pid() == libc::getppid() {
                crash::caught(self.signal, self.about, self.context);
                let pause = libc::timespec { tv_sec: 1, tv_nsec: 0 };
                libc::nanosleep(&raw const pause, std::ptr::null_mut());
            }
            set(self.signal, libc::SIG_DFL, 0);
            libc::syscall(libc::SYS_tgkill, libc::getpid(), libc::syscall(libc::SYS_gettid), self.signal); // after the handler
        }
    }

    fn address(self) -> u64 {
        // SAFETY: as above.
        unsafe { (*self.about).si_addr() as u64 }
    }

    /// An error handler of the partition's own was told, and the process lives on.
    fn is_handled(self, code: ErrorCode) -> bool {
        // SAFETY: as above.
        unsafe { crate::processes::fault(code, self.address(), self.context) }
    }

    fn write_down(self) {
        // SAFETY: as above.
        unsafe { crash::caught(self.signal, self.about, self.context) }
    }

    /// It is written down. On return the instruction is tried again and ends the process as always.
    fn end(self) {
        self.write_down();
        set(self.signal, libc::SIG_DFL, 0);
    }

    /// It is written down, and the process ends with `code`.
    fn end_with(self, code: i32) -> ! {
        self.write_down();
        // SAFETY: ends the process without running anything.
        unsafe { libc::_exit(code) }
    }
}

extern "C" fn on_abort(signal: c_int, about: *mut siginfo_t, context: *mut c_void) {
    Caught { signal, about, context: context.cast() }.end_with(exit::ABORTED)
}

extern "C" fn on_fault(signal: c_int, about: *mut siginfo_t, context: *mut c_void) {
    let caught = Caught { signal, about, context: context.cast() };
    if caught.was_sent() {
        return caught.suffer();
    }
    // SAFETY: the kernel's context, and a number that it has told the process.
    let (stack, page) = unsafe { (stack_pointer(caught.context), libc::getauxval(libc::AT_PAGESZ)) };
    let overflow = is_overflow(caught.address(), stack, crate::processes::stack_low(), page);
    let code = if overflow { ErrorCode::StackOverflow } else { ErrorCode::MemoryViolation };
    match (caught.is_handled(code), overflow) {
        (true, _) => {}
        (false, true) => caught.end_with(exit::STACK_OVERFLOW),
        (false, false) => caught.end(),
    }
}

/// Where the interrupted code had its stack.
#[cfg(target_arch = "x86_64")]
unsafe fn stack_pointer(context: *const ucontext_t) -> u64 {
    // SAFETY: the caller's: a context of the kernel.
    unsafe { (*context).uc_mcontext.gregs[libc::REG_RSP as usize] as u64 }
}

/// Where the interrupted code had its stack.
#[cfg(target_arch = "aarch64")]
unsafe fn stack_pointer(context: *const ucontext_t) -> u64 {
    // SAFETY: the caller's: a context of the kernel.
    unsafe { (*context).uc_mcontext.sp }
}

extern "C" fn on_bus_error(signal: c_int, about: *mut siginfo_t, context: *mut c_void) {
    let caught = Caught { signal, about, context: context.cast() };
    if caught.was_sent() {
        return caught.suffer();
    }
    // SAFETY: the kernel hands a handler with SA_SIGINFO valid structures.
    let damaged = DAMAGED_MEMORY.contains(unsafe { &(*about).si_code });
    let error = if damaged { ErrorCode::HardwareFault } else { ErrorCode::MemoryViolation };
    match (caught.is_handled(error), damaged) {
        (true, _) => {}
        (false, true) => caught.end_with(exit::HARDWARE_FAULT),
        // Any other is a memory violation.
        (false, false) => caught.end(),
    }
}

/// Division by zero, and what is no instruction.
extern "C" fn on_trap(signal: c_int, about: *mut siginfo_t, context: *mut c_void) {
    let caught = Caught { signal, about, context: context.cast() };
    if caught.was_sent() {
        return caught.suffer();
    }
    let code = if signal == libc::SIGFPE { ErrorCode::NumericError } else { ErrorCode::IllegalRequest };
    if !caught.is_handled(code) {
        caught.end();
    }
}

#[cfg(test)]
mod tests {
    use super::is_overflow;

    #[test]
    fn memory_beside_the_stack_of_a_thread_is_not_its_end() {
        let (page, low) = (4096, Some(0x7000_0000));
        let inside = 0x7000_1000;
        assert!(is_overflow(0x6fff_fff8, inside, low, page), "the guard page");
        assert!(is_overflow(0x6ffe_0000, 0x6ffe_0000, low, page), "a frame of many pages");
        assert!(!is_overflow(0x6fff_e000, inside, low, page), "a mapping below the guard page");
        assert!(!is_overflow(0x7000_9000, inside, low, page), "a mapping above the stack");
        assert!(is_overflow(inside - 8, inside, None, page) && !is_overflow(0, inside, None, page));
    }
}
