//! A partition with company: its first window leaves two threads that spin, one that is deep in the kernel most of the time
//! (writes of 32 MiB), and a child in a session of its own that spins too. With `closes` it closes its windows all the
//! same, else its first thread spins as well.
#![allow(unsafe_code)] // forks

use std::process::ExitCode;

use bateleur_apex::{Context, Partition, StartError, Window};

struct Crowd {
    closes: bool,
    alone: bool,
}

impl Partition for Crowd {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        Ok(Self { closes: context.attribute("closes", true)?, alone: true })
    }

    fn window(&mut self, _window: &Window) {
        if std::mem::take(&mut self.alone) {
            leave_child();
            for work in [spin as fn() -> !, spin, write] {
                std::thread::spawn(move || work());
            }
        }
        if !self.closes {
            spin();
        }
    }
}

fn leave_child() {
    // SAFETY: the process still has one thread; the child makes a system call and spins.
    unsafe {
        if libc::fork() == 0 {
            libc::setsid();
            spin();
        }
    }
}

fn spin() -> ! {
    loop {
        std::hint::spin_loop();
    }
}

/// Four times eight MiB in one call: the thread comes out of the kernel after some milliseconds.
fn write() -> ! {
    let part = vec![7; 8 << 20];
    let parts = [(); 4].map(|()| std::io::IoSlice::new(&part));
    let file = rustix::fs::memfd_create("crowd", rustix::fs::MemfdFlags::CLOEXEC).ok();
    loop {
        if let Some(file) = &file {
            let _ = rustix::io::pwritev(file, &parts, 0); // whatever becomes of it
        }
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Crowd>()
}
