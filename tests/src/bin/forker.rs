//! A partition whose first window leaves `children` behind that spin, each in a session of its own (where that is not
//! refused) and with a child that does the same. With `closes` it closes its windows all the same, else it spins too.
#![allow(unsafe_code)] // forks

use std::process::ExitCode;

use bateleur_apex::{Context, Partition, StartError, Window};

struct Forker {
    children: u32,
    closes: bool,
}

impl Partition for Forker {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        Ok(Self { children: context.attribute("children", 2)?, closes: context.attribute("closes", true)? })
    }

    fn window(&mut self, _window: &Window) {
        for _ in 0..std::mem::take(&mut self.children) {
            leave_child();
        }
        if !self.closes {
            spin();
        }
    }
}

fn leave_child() {
    // SAFETY: the process has one thread; the child makes system calls and spins.
    unsafe {
        if libc::fork() == 0 {
            libc::setsid();
            if libc::fork() == 0 {
                libc::setsid();
            }
            spin();
        }
    }
}

fn spin() -> ! {
    loop {
        std::hint::spin_loop();
    }
}

fn main() -> ExitCode {
    bateleur_apex::run::<Forker>()
}
