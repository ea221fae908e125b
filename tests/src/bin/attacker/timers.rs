//! Timers, signals and sleepers: work that the kernel does in interrupt context.

use super::*;

pub(super) fn block(signal: i32) {
    let mask: u64 = 1 << (signal - 1);
    call!(SYS_rt_sigprocmask, libc::SIG_BLOCK, &raw const mask, null::<u64>(), 8);
}

pub(super) fn signal_event(signal: i32) -> libc::sigevent {
    // SAFETY: plain data, for which zero is a value.
    let mut event: libc::sigevent = unsafe { std::mem::zeroed() };
    event.sigev_notify = libc::SIGEV_SIGNAL;
    event.sigev_signo = signal;
    event
}

pub(super) fn make_timer(held: &mut Held, clock: i32) -> bool {
    let (event, mut timer) = (signal_event(40), 0_i32);
    let made = call!(SYS_timer_create, clock, &raw const event, &raw mut timer) == 0;
    if made {
        held.timers.push(timer);
    }
    made
}

pub(super) fn at(ns: u64) -> libc::timespec {
    libc::timespec { tv_sec: (ns / 1_000_000_000) as libc::time_t, tv_nsec: (ns % 1_000_000_000) as c_long }
}

pub(super) const NEVER: libc::timespec = libc::timespec { tv_sec: 0, tv_nsec: 0 };

/// `count` timers that all expire at the start of the window after this one, some frames later, once all are set.
pub(super) fn timers(held: &mut Held, turn: &Turn, count: usize) {
    block(40);
    turn.repeat(|| held.timers.len() < count && make_timer(held, libc::CLOCK_MONOTONIC));
    if held.strike_ns < now_ns() {
        (held.strike_ns, held.count) = (turn.next_ns + turn.frame_ns * (held.timers.len() as u64 / 2_000), 0);
    }
    let expiry = libc::itimerspec { it_interval: NEVER, it_value: at(held.strike_ns) };
    turn.repeat(|| {
        let Some(timer) = held.timers.get(held.count as usize) else { return false };
        call!(SYS_timer_settime, *timer, libc::TIMER_ABSTIME, &raw const expiry, null::<u8>());
        held.count += 1;
        true
    });
}

pub(super) fn timers_that_repeat(held: &mut Held, turn: &Turn) {
    block(40);
    let often = libc::timespec { tv_sec: 0, tv_nsec: 1 };
    let expiry = libc::itimerspec { it_interval: often, it_value: often };
    turn.repeat(|| {
        make_timer(held, libc::CLOCK_MONOTONIC) && {
            let timer = held.timers[held.timers.len() - 1];
            call!(SYS_timer_settime, timer, 0, &raw const expiry, null::<u8>()) == 0
        }
    });
    // Those that a signal has been queued for go on once it is taken.
    let (mask, no_time) = (1_u64 << 39, NEVER);
    turn.repeat(|| call!(SYS_rt_sigtimedwait, &raw const mask, null::<u8>(), &raw const no_time, 8) > 0);
}

pub(super) fn timers_of_processor_time(held: &mut Held, turn: &Turn) {
    block(40);
    let often = libc::timespec { tv_sec: 0, tv_nsec: 1_000 };
    let expiry = libc::itimerspec { it_interval: often, it_value: often };
    turn.repeat(|| {
        make_timer(held, libc::CLOCK_PROCESS_CPUTIME_ID) && {
            let timer = held.timers[held.timers.len() - 1];
            call!(SYS_timer_settime, timer, 0, &raw const expiry, null::<u8>()) == 0
        }
    });
}

pub(super) fn timer_descriptors(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        let made = call!(SYS_timerfd_create, libc::CLOCK_MONOTONIC, libc::TFD_NONBLOCK | libc::TFD_CLOEXEC);
        made >= 0 && {
            held.descriptors.push(made as i32);
            true
        }
    });
    if held.strike_ns < now_ns() {
        (held.strike_ns, held.count) = (turn.next_ns, 0);
    }
    let expiry = libc::itimerspec { it_interval: NEVER, it_value: at(held.strike_ns) };
    turn.repeat(|| {
        let Some(timer) = held.descriptors.get(held.count as usize) else { return false };
        call!(SYS_timerfd_settime, *timer, libc::TFD_TIMER_ABSTIME, &raw const expiry, null::<u8>());
        held.count += 1;
        true
    });
}

pub(super) fn interval_timers() {
    [libc::SIGALRM, libc::SIGVTALRM, libc::SIGPROF].into_iter().for_each(block);
    let often = libc::timeval { tv_sec: 0, tv_usec: 1 };
    let interval = libc::itimerval { it_interval: often, it_value: often };
    for kind in 0..3 {
        call!(SYS_setitimer, kind, &raw const interval, null::<u8>());
    }
    let mask = 1_u64 << (libc::SIGALRM - 1);
    let no_time = NEVER;
    call!(SYS_rt_sigtimedwait, &raw const mask, null::<u8>(), &raw const no_time, 8);
    // SAFETY: a plain call; on aarch64 the C library makes it of another one.
    unsafe { libc::alarm(1) };
}

/// Threads that sleep until the window after this one begins.
pub(super) fn sleepers(held: &mut Held, turn: &Turn) {
    let next_ns = turn.next_ns;
    turn.repeat(|| {
        let sleep = move || {
            let until = at(next_ns);
            call!(SYS_clock_nanosleep, libc::CLOCK_MONOTONIC, libc::TIMER_ABSTIME, &raw const until, 0);
        };
        held.count += 1;
        std::thread::Builder::new().stack_size(64 << 10).spawn(sleep).is_ok()
    });
}

pub(super) fn queued_signals(held: &mut Held, turn: &Turn) {
    block(41);
    let own = call!(SYS_getpid);
    let mut information = [0_u8; 128];
    information[0] = 41;
    information[8..12].copy_from_slice(&libc::SI_QUEUE.to_le_bytes());
    turn.repeat(|| {
        held.count += 1;
        call!(SYS_rt_sigqueueinfo, own, 41, information.as_ptr()) == 0
    });
}
