//! Descriptors of every kind, and what watches them.

use super::*;

pub(super) fn keep(held: &mut Held, descriptor: c_long) -> bool {
    if descriptor >= 0 {
        held.descriptors.push(descriptor as i32);
    }
    descriptor >= 0
}

pub(super) fn watch(held: &mut Held) -> bool {
    let made = call!(SYS_inotify_init1, libc::IN_NONBLOCK);
    if made >= 0 {
        for folder in own_channels() {
            call!(SYS_inotify_add_watch, made, folder.as_ptr(), libc::IN_ALL_EVENTS);
        }
    }
    keep(held, made)
}

pub(super) fn descriptors(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        let made = match held.descriptors.len() % 6 {
            0 => call!(SYS_openat, libc::AT_FDCWD, c"/dev/null".as_ptr(), libc::O_RDWR),
            1 => call!(SYS_eventfd2, 0, 0),
            2 => call!(SYS_memfd_create, c"held".as_ptr(), 0),
            3 => call!(SYS_epoll_create1, 0),
            4 => {
                let mask = 1_u64;
                call!(SYS_signalfd4, -1, &raw const mask, 8, 0)
            }
            _ => call!(SYS_openat, libc::AT_FDCWD, c"/dev/zero".as_ptr(), libc::O_RDWR),
        };
        if keep(held, made) {
            return true;
        }
        let mut ends = [0_i32; 2];
        call!(SYS_pipe2, ends.as_mut_ptr(), 0) == 0 && {
            held.descriptors.extend(ends);
            true
        }
    });
}

/// Sets of watched descriptors that watch one another.
pub(super) fn watched_descriptors(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        let made = call!(SYS_epoll_create1, 0);
        if !keep(held, made) {
            return false;
        }
        let mut event = libc::epoll_event { events: 1, u64: 0 };
        for watched in held.descriptors.iter().rev().skip(1).take(64) {
            call!(SYS_epoll_ctl, made, libc::EPOLL_CTL_ADD, *watched, &raw mut event);
        }
        true
    });
}
