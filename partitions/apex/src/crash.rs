//! Leaves in the crash memory what a report of this process's end is made from: registers, the stack above the stack pointer, the map of
//! memory.
//!
//! It runs in signal handlers, of a process whose memory may be damaged: it takes no memory and no lock, and hands addresses that may
//! lead nowhere to the kernel alone, whose answer is an error then. It must never decide whether the process ends.
#![allow(unsafe_code)] // calls of the kernel with raw addresses, and this thread's registers

use std::arch::asm;
use std::cell::UnsafeCell;
use std::ffi::c_void;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};

use bateleur_contract::Description;
use bateleur_contract::crash::{
    BEGUN, CrashHead, HEAD_BYTES, MAPS_AT, MAPS_BYTES, NAME_AT, NAME_BYTES, NOTHING, PANIC, REGISTERS,
    STACK_AT, STACK_BYTES, WHOLE,
};
use libc::ucontext_t;

/// The memory's descriptor; below 0: there is none.
static MEMORY: AtomicI32 = AtomicI32::new(-1);
/// The process that it belongs to: a child of it has the descriptor too.
static PROCESS: AtomicI32 = AtomicI32::new(0);
/// A thread is writing.
static WRITES: AtomicBool = AtomicBool::new(false);

/// Where the map of memory passes through.
struct Passage(UnsafeCell<[u8; 4096]>);
// SAFETY: used by the thread alone that has set `WRITES`.
unsafe impl Sync for Passage {}
static PASSAGE: Passage = Passage(UnsafeCell::new([0; 4096]));

/// Compilers keep data below the stack pointer where the architecture lets them, bytes.
const RED_ZONE: u64 = if cfg!(target_arch = "x86_64") { 128 } else { 0 };
const PAGE: u64 = 4096;

/// From now on faults are written down, and panics: these before the words of the hook that is there.
pub(crate) fn prepare(description: &Description) {
    let Some(memory) = description.crash_memory else { return };
    // SAFETY: a flag of a descriptor, which would be refused for one that nobody has.
    unsafe { libc::fcntl(memory, libc::F_SETFD, libc::FD_CLOEXEC) };
    PROCESS.store(std::process::id().cast_signed(), Ordering::Relaxed);
    MEMORY.store(memory, Ordering::Release);
    let before = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |about| {
        panicked();
        before(about);
    }));
}

/// The fault that was written down last has not ended the process.
pub(crate) fn forget() {
    if let Some(memory) = Memory::claim() {
        memory.state(&CrashHead { state: NOTHING, ..CrashHead::default() });
    }
}

/// A signal is about to end the process.
///
/// # Safety
/// Both are the kernel's, of the handler of `signal` that this thread is in.
pub(crate) unsafe fn caught(signal: libc::c_int, about: *const libc::siginfo_t, context: *const ucontext_t) {
    let Some(memory) = Memory::claim() else { return };
    // SAFETY: the caller's.
    let (code, address, registers) = unsafe { ((*about).si_code, (*about).si_addr(), registers(context)) };
    let (signal, address) = (signal as u64, address as u64);
    memory.write(CrashHead {
        signal,
        code: i64::from(code).cast_unsigned(),
        address,
        registers,
        ..CrashHead::default()
    });
}

/// A Rust panic has begun on this thread.
fn panicked() {
    let registers = own_registers();
    if let Some(memory) = Memory::claim() {
        memory.write(CrashHead { signal: PANIC, registers, ..CrashHead::default() });
    }
}

/// The crash memory, which this thread alone writes.
struct Memory(libc::c_int);

impl Memory {
    fn claim() -> Option<Self> {
        let memory = MEMORY.load(Ordering::Acquire);
        // SAFETY: asks for a number.
        let is_own = memory >= 0 && unsafe { libc::getpid() } == PROCESS.load(Ordering::Relaxed);
        (is_own && !WRITES.swap(true, Ordering::Acquire)).then_some(Self(memory))
    }

    fn write(&self, mut head: CrashHead) {
        head.state = BEGUN;
        head.architecture = ARCHITECTURE;
        head.process = PROCESS.load(Ordering::Relaxed) as u64;
        // SAFETY: asks for a number.
        head.thread = unsafe { libc::syscall(libc::SYS_gettid) } as u64;
        self.state(&head);
        let (name, bytes) = crate::processes::own_name();
        self.put(&[0; NAME_BYTES], NAME_AT);
        self.copy(name as u64, bytes.min(NAME_BYTES), NAME_AT);
        let stack = head.registers[STACK_POINTER];
        head.stack_from = stack.wrapping_sub(RED_ZONE);
        head.stack_bytes = self.copy(head.stack_from, STACK_BYTES, STACK_AT);
        if head.stack_bytes == 0 {
            // The stack has come to its end: it begins above the guard page.
            head.stack_from = (stack & !(PAGE - 1)).wrapping_add(PAGE);
            head.stack_bytes = self.copy(head.stack_from, STACK_BYTES, STACK_AT);
        }
        head.maps_bytes = self.maps();
        head.state = WHOLE;
        self.state(&head);
    }

    fn state(&self, head: &CrashHead) {
        let bytes: [u8; HEAD_BYTES] = head.to_bytes();
        self.put(&bytes, 0);
    }

    fn put(&self, bytes: &[u8], at: u64) {
        self.copy(bytes.as_ptr() as u64, bytes.len(), at);
    }

    /// Copies what lies at an address, as far as something does; how many bytes.
    fn copy(&self, from: u64, bytes: usize, at: u64) -> u64 {
        // SAFETY: the kernel reads, and refuses what it can not read.
        let copied = unsafe { libc::pwrite(self.0, from as *const c_void, bytes, at.cast_signed()) };
        u64::try_from(copied).unwrap_or(0)
    }

    /// Copies the map of memory; how many bytes.
    fn maps(&self) -> u64 {
        // SAFETY: a path that ends, and memory that this thread alone uses, see `PASSAGE`.
        unsafe {
            let file = libc::open(c"/proc/self/maps".as_ptr(), libc::O_RDONLY | libc::O_CLOEXEC);
            let passage = PASSAGE.0.get().cast::<u8>();
            let mut copied = 0;
            while file >= 0 && copied < MAPS_BYTES {
                let read = libc::read(file, passage.cast(), (MAPS_BYTES - copied).min(4096));
                let Some(read) = usize::try_from(read).ok().filter(|read| *read > 0) else { break };
                copied += self.copy(passage as u64, read, MAPS_AT + copied as u64) as usize;
            }
            libc::close(file);
            copied as u64
        }
    }
}

impl Drop for Memory {
    fn drop(&mut self) {
        WRITES.store(false, Ordering::Release);
    }
}

#[cfg(target_arch = "x86_64")]
const ARCHITECTURE: u64 = bateleur_contract::crash::X86_64;
#[cfg(target_arch = "aarch64")]
const ARCHITECTURE: u64 = bateleur_contract::crash::AARCH64;

#[cfg(target_arch = "x86_64")]
pub(crate) const STACK_POINTER: usize = 7;
#[cfg(target_arch = "aarch64")]
pub(crate) const STACK_POINTER: usize = 31;

/// The registers of the code that a signal has interrupted.
#[cfg(target_arch = "x86_64")]
unsafe fn registers(context: *const ucontext_t) -> [u64; REGISTERS] {
    use libc::{
        REG_EFL, REG_R8, REG_R9, REG_R10, REG_R11, REG_R12, REG_R13, REG_R14, REG_R15, REG_RAX, REG_RBP,
        REG_RBX, REG_RCX, REG_RDI, REG_RDX, REG_RIP, REG_RSI, REG_RSP,
    };
    const ORDER: [libc::c_int; 18] = [
        REG_RAX, REG_RDX, REG_RCX, REG_RBX, REG_RSI, REG_RDI, REG_RBP, REG_RSP, REG_R8, REG_R9, REG_R10,
        REG_R11, REG_R12, REG_R13, REG_R14, REG_R15, REG_RIP, REG_EFL,
    ];
    // SAFETY: the caller's: a context of the kernel.
    let saved = unsafe { &(*context).uc_mcontext.gregs };
    let mut registers = [0; REGISTERS];
    for (place, register) in registers.iter_mut().zip(ORDER) {
        *place = saved[register as usize].cast_unsigned();
    }
    registers
}

/// The registers of the code that a signal has interrupted.
#[cfg(target_arch = "aarch64")]
unsafe fn registers(context: *const ucontext_t) -> [u64; REGISTERS] {
    // SAFETY: the caller's: a context of the kernel.
    let machine = unsafe { &(*context).uc_mcontext };
    let mut registers = [0; REGISTERS];
    registers[..31].copy_from_slice(&machine.regs);
    registers[31..].copy_from_slice(&[machine.sp, machine.pc, machine.pstate]);
    registers
}

/// This thread's registers, as far as its callers' frames are found by them.
#[cfg(target_arch = "x86_64")]
#[inline(always)]
fn own_registers() -> [u64; REGISTERS] {
    let mut registers = [0; REGISTERS];
    // SAFETY: stores registers, and changes none but the one that it is given.
    unsafe {
        asm!(
            "lea {at}, [rip]",
            "mov [{to} + 128], {at}",
            "mov [{to} + 24], rbx",
            "mov [{to} + 48], rbp",
            "mov [{to} + 56], rsp",
            "mov [{to} + 96], r12",
            "mov [{to} + 104], r13",
            "mov [{to} + 112], r14",
            "mov [{to} + 120], r15",
            at = out(reg) _,
            to = in(reg) registers.as_mut_ptr(),
            options(nostack, preserves_flags),
        );
    }
    registers
}

/// This thread's registers, as far as its callers' frames are found by them.
#[cfg(target_arch = "aarch64")]
#[inline(always)]
fn own_registers() -> [u64; REGISTERS] {
    let mut registers = [0; REGISTERS];
    // SAFETY: stores registers, and changes none but the one that it is given.
    unsafe {
        asm!(
            "stp x19, x20, [{to}, #152]",
            "stp x21, x22, [{to}, #168]",
            "stp x23, x24, [{to}, #184]",
            "stp x25, x26, [{to}, #200]",
            "stp x27, x28, [{to}, #216]",
            "stp x29, x30, [{to}, #232]",
            "mov {at}, sp",
            "str {at}, [{to}, #248]",
            "adr {at}, .",
            "str {at}, [{to}, #256]",
            at = out(reg) _,
            to = in(reg) registers.as_mut_ptr(),
            options(nostack, preserves_flags),
        );
    }
    registers
}
