//! A partition that dies in window number `after`, as `how` says: segv, fpe, panic, exit.
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
            "panic" => panic!("the crasher was asked to panic"),
            _ => std::process::exit(3),
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

fn main() -> ExitCode {
    bateleur_apex::run::<Crasher>()
}
