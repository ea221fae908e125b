//! Stands for chrony or phc2sys in a guest, whose clock is nobody else's: tells the kernel how CLOCK_REALTIME is kept, and sets it.
//!
//! `clock_keeper kept MICROSECONDS` (it is, with that error), `clock_keeper left` (nobody keeps it), `clock_keeper step
//! MICROSECONDS` (later by as much), `clock_keeper offset` (prints CLOCK_REALTIME less CLOCK_MONOTONIC, ns).
#![allow(unsafe_code)] // adjtimex

use std::process::ExitCode;

use rustix::time::{ClockId, Timespec, clock_gettime};

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let done = match words[..] {
        ["kept", error_us] => error_us.parse().is_ok_and(|error_us| tell(0, error_us)),
        ["left"] => tell(libc::STA_UNSYNC, 16_000_000),
        ["step", by_us] => by_us.parse().is_ok_and(step),
        ["offset"] => {
            println!("{}", offset_ns());
            true
        }
        _ => false,
    };
    if done { ExitCode::SUCCESS } else { ExitCode::FAILURE }
}

fn adjust(state: &mut libc::timex) -> bool {
    // SAFETY: the structure is the caller's own.
    unsafe { libc::adjtimex(state) >= 0 }
}

fn nothing() -> libc::timex {
    // SAFETY: plain numbers, for which zero is a value; no mode is set, so nothing is changed.
    unsafe { std::mem::zeroed() }
}

fn tell(status: i32, error_us: libc::c_long) -> bool {
    let modes = libc::ADJ_STATUS | libc::ADJ_ESTERROR | libc::ADJ_MAXERROR;
    adjust(&mut libc::timex { modes, status, esterror: error_us, maxerror: error_us, ..nothing() })
}

fn step(by_us: i64) -> bool {
    let time = libc::timeval { tv_sec: by_us.div_euclid(1_000_000), tv_usec: by_us.rem_euclid(1_000_000) };
    adjust(&mut libc::timex { modes: libc::ADJ_SETOFFSET, time, ..nothing() })
}

/// The quickest of many readings.
fn offset_ns() -> i128 {
    let reading = || {
        let before = nanoseconds(clock_gettime(ClockId::Monotonic));
        let real = nanoseconds(clock_gettime(ClockId::Realtime));
        let after = nanoseconds(clock_gettime(ClockId::Monotonic));
        (after - before, real - (before + after) / 2)
    };
    (0..1_000).map(|_| reading()).min().map_or(0, |(_, offset_ns)| offset_ns)
}

fn nanoseconds(time: Timespec) -> i128 {
    i128::from(time.tv_sec) * 1_000_000_000 + i128::from(time.tv_nsec)
}
