//! A partition that keeps to no library: it says that it is done with each window as soon as it has it, and then uses processor
//! time, in everybody else's windows.
//!
//! Attributes: `computes_ms`, how much it uses, 5 ms unless told; `pause_us`: it sleeps for so long between its word and that.
#![allow(unsafe_code)] // takes over what the executive left open, as the contract says

use std::fs::File;
use std::os::fd::FromRawFd;
use std::os::unix::fs::FileExt;
use std::process::ExitCode;
use std::sync::atomic::Ordering::{Acquire, Release};
use std::time::Duration;

use bateleur_contract::{CONTROL_FD, ControlPage, DESCRIPTION_FD, Mapped, Mode};
use rustix::thread::futex;
use rustix::time::{ClockId, clock_gettime};

fn main() -> ExitCode {
    // SAFETY: the executive left both open, and nobody else in this process uses them.
    let (control, description) =
        unsafe { (File::from_raw_fd(CONTROL_FD), File::from_raw_fd(DESCRIPTION_FD)) };
    let Ok(page) = Mapped::<ControlPage>::new(&control) else { return ExitCode::FAILURE };
    let mut json = vec![0; description.metadata().map_or(0, |about| about.len()) as usize];
    if description.read_exact_at(&mut json, 0).is_err() {
        return ExitCode::FAILURE;
    }
    let about: serde_json::Value = serde_json::from_slice(&json).unwrap_or_default();
    let pause = Duration::from_micros(about["attributes"]["pause_us"].as_u64().unwrap_or(0));
    let computes_ns = about["attributes"]["computes_ms"].as_u64().unwrap_or(5) * 1_000_000;
    page.mode.store(Mode::Normal as u32, Release);
    let mut last = 0;
    loop {
        while page.grant.load(Acquire) == last {
            let _ = futex::wait(&page.grant, futex::Flags::empty(), last, None); // looked at again
        }
        last = page.grant.load(Acquire);
        if page.stop.load(Acquire) != 0 {
            return ExitCode::SUCCESS;
        }
        page.opened_ns.store(now_ns(ClockId::Monotonic), Release);
        page.closed_ns.store(now_ns(ClockId::Monotonic), Release);
        let _ = page.close(last); // woken in any case
        let _ = futex::wake(&page.done, futex::Flags::empty(), 1);
        if !pause.is_zero() {
            std::thread::sleep(pause);
        }
        let begun_ns = now_ns(ClockId::ThreadCPUTime);
        while now_ns(ClockId::ThreadCPUTime) < begun_ns + computes_ns {
            std::hint::spin_loop();
        }
    }
}

fn now_ns(clock: ClockId) -> u64 {
    let now = clock_gettime(clock);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}
