//! A partition that dies in window number `after`, as `how` says: segv, fpe, panic, exit, abort, stack, memory,
//! divide, damage (of the machine's memory), call (a system call that no partition may make), lie (rubbish in the memory that reports are made
//! of, then segv), or the number of an exit code.
#![allow(unsafe_code)] // to die of it

use std::process::ExitCode;

use bateleur_apex::{Context, Partition, StartError, Window};

struct Crasher {
    how: String,
    windows_left: u64,
}

impl Partition for Crasher {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let how = context.attribute("how", "segv".to_owned())?;
        Ok(Self { how, windows_left: context.attribute("after", 10_u64)? })
    }

    #[allow(clippy::panic)] // asked for
    fn window(&mut self, _window: &Window) {
        if self.windows_left > 0 {
            self.windows_left -= 1;
            return;
        }
        match self.how.as_str() {
            "segv" => write_to_nowhere(),
            "fpe" => divide_by_zero(),
            "abort" => std::process::abort(),
            "stack" => println!("{}", dig(1)),
            "memory" => println!("{:?}", std::hint::black_box(vec![1_u8; 1 << 40]).last()),
            "divide" => println!("{}", 1 / std::hint::black_box(0_i32)),
            "damage" => report_damage(),
            "lie" => lie(),
            "call" => make_forbidden_call(),
            "panic" => panic!("the crasher was asked to panic"),
            how => std::process::exit(how.parse().unwrap_or(3)),
        }
    }
}

fn write_to_nowhere() {
    let nowhere = std::hint::black_box(8_usize) as *mut u8;
    // SAFETY: there is none: nothing is mapped at address 8, and the process ends here.
    unsafe { nowhere.write_volatile(1) };
}

/// A trap of the processor, not a signal sent: process 1 of a namespace does not hear signals that it sends itself.
#[cfg(target_arch = "x86_64")]
fn divide_by_zero() {
    // SAFETY: the instruction traps, and the process ends here.
    unsafe {
        std::arch::asm!("xor edx, edx", "xor ecx, ecx", "mov eax, 1", "div ecx", out("eax") _, out("ecx") _, out("edx") _)
    };
}

#[cfg(not(target_arch = "x86_64"))]
fn divide_by_zero() {
    // SAFETY: sends a signal to the process itself.
    unsafe { libc::raise(libc::SIGFPE) };
}

/// Deeper with every call, until there is no stack left.
fn dig(depth: u64) -> u64 {
    let hole = std::hint::black_box([depth; 512]);
    if depth == 0 { hole[0] } else { dig(std::hint::black_box(depth + 1)) + hole[511] }
}

/// What the kernel sends when a page of the process can not be read any more.
fn report_damage() {
    const BUS_MCEERR_AR: i32 = 4;
    // SAFETY: plain data; a process may say about itself what it likes.
    unsafe {
        let mut about: libc::siginfo_t = std::mem::zeroed();
        about.si_signo = libc::SIGBUS;
        about.si_code = BUS_MCEERR_AR;
        libc::syscall(libc::SYS_rt_sigqueueinfo, libc::getpid(), libc::SIGBUS, &raw const about);
    }
}

/// Writes into whatever file in memory is its own to write, behind and instead of the library, and ends by a signal that has no handler.
fn lie() {
    let mut random = u64::from(std::process::id())
        ^ std::time::UNIX_EPOCH.elapsed().map_or(1, |since| since.as_nanos() as u64);
    let mut bytes = vec![0_u8; 128 << 10];
    for byte in &mut bytes {
        random = random.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        *byte = (random >> 56) as u8;
    }
    // A whole report of a known architecture, of a fault at some address.
    for (place, word) in [2_u64, 1, 11, 1].iter().enumerate() {
        bytes[8 * place..8 * place + 8].copy_from_slice(&word.to_ne_bytes());
    }
    // SAFETY: calls with memory of this function's; descriptors that are none are refused.
    unsafe {
        libc::signal(libc::SIGSEGV, libc::SIG_DFL);
        for descriptor in 5..40 {
            libc::pwrite(descriptor, bytes.as_ptr().cast(), bytes.len(), 0);
        }
    }
    write_to_nowhere();
}

/// Asks for its personality, which changes nothing, by a call that no partition may make.
fn make_forbidden_call() {
    // SAFETY: the argument asks and sets nothing; where the executive's filter is in place, the process ends here.
    unsafe { libc::syscall(libc::SYS_personality, 0xffff_ffff_u64) };
}

fn main() -> ExitCode {
    bateleur_apex::run::<Crasher>()
}
