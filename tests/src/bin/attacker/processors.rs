//! The processors: calls that make the kernel work long, or in others' time.

use super::*;

pub(super) fn barriers(turn: &Turn) {
    // Registrations of the expedited kinds.
    for command in [2, 4, 16, 64, 128] {
        call!(SYS_membarrier, command, 0, 0);
    }
    turn.repeat(|| {
        for command in [2, 8, 32, 128] {
            call!(SYS_membarrier, command, 0, 0);
        }
        true
    });
    // Waits for every processor.
    call!(SYS_membarrier, 1, 0, 0);
}

/// Work that the kernel does on every processor, or in threads of its own.
pub(super) fn drain(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        held.count += 1;
        let file = call!(SYS_memfd_create, c"drain".as_ptr(), 2);
        call!(SYS_ftruncate, file, 64 * PAGE);
        call!(SYS_fcntl, file, 1033, 8); // F_ADD_SEALS, F_SEAL_WRITE
        call!(SYS_fadvise64, file, 0, 0, libc::POSIX_FADV_DONTNEED);
        call!(SYS_close, file);
        for descriptor in [1, 2] {
            call!(SYS_sync_file_range, descriptor, 0, 0, 7);
            call!(SYS_fadvise64, descriptor, 0, 0, libc::POSIX_FADV_DONTNEED);
            call!(SYS_fdatasync, descriptor);
            call!(SYS_fsync, descriptor);
        }
        let program = open(&c"/proc/self/exe".to_owned(), libc::O_RDONLY);
        call!(SYS_fadvise64, program, 0, 0, libc::POSIX_FADV_DONTNEED);
        call!(SYS_readahead, program, 0, 1 << 30);
        call!(SYS_close, program);
        true
    });
}

pub(super) fn open_and_close(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        held.count += 1;
        let null = open(&c"/dev/null".to_owned(), libc::O_RDONLY);
        let event = call!(SYS_eventfd2, 0, 0);
        let memory = call!(SYS_memfd_create, c"storm".as_ptr(), 0);
        let mut ends = [-1_i32; 2];
        call!(SYS_pipe2, ends.as_mut_ptr(), 0);
        let mut sockets = [-1_i32; 2];
        call!(SYS_socketpair, libc::AF_UNIX, libc::SOCK_STREAM, 0, sockets.as_mut_ptr());
        for descriptor in [null, event, memory] {
            call!(SYS_close, descriptor);
        }
        for descriptor in ends.iter().chain(&sockets).filter(|descriptor| **descriptor > 2) {
            call!(SYS_close, *descriptor);
        }
        true
    });
}

pub(super) fn make_and_remove(held: &mut Held, turn: &Turn) {
    let folders = own_channels();
    turn.repeat(|| {
        held.count += 1;
        folders.iter().any(|folder| {
            let name = path(folder, &format!("storm{}", held.count));
            let file = open(&name, libc::O_CREAT | libc::O_RDWR);
            call!(SYS_write, file, c"x".as_ptr(), 1);
            call!(SYS_close, file);
            call!(SYS_unlinkat, libc::AT_FDCWD, name.as_ptr(), 0);
            call!(SYS_mkdirat, libc::AT_FDCWD, name.as_ptr(), 0o777);
            call!(SYS_unlinkat, libc::AT_FDCWD, name.as_ptr(), libc::AT_REMOVEDIR);
            file >= 0
        })
    });
}

pub(super) fn futexes(turn: &Turn) {
    let words = [0_u32; 1_024];
    let short = libc::timespec { tv_sec: 0, tv_nsec: 1 };
    turn.repeat(|| {
        for word in &words {
            call!(SYS_futex, std::ptr::from_ref(word), libc::FUTEX_WAKE, i32::MAX);
            call!(SYS_futex, std::ptr::from_ref(word), libc::FUTEX_WAIT, 0, &raw const short);
            call!(SYS_futex, std::ptr::from_ref(word), 6, 0, &raw const short); // FUTEX_LOCK_PI
            call!(SYS_futex, std::ptr::from_ref(word), 7); // FUTEX_UNLOCK_PI
            if now_ns() >= turn.until_ns {
                break;
            }
        }
        true
    });
}

pub(super) fn page_faults(turn: &Turn) {
    let protection = libc::PROT_READ | libc::PROT_WRITE;
    let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS;
    turn.repeat(|| {
        let bytes = 4_usize << 20;
        let place = call!(SYS_mmap, 0, bytes, protection, flags, -1, 0);
        if place <= 0 {
            return false;
        }
        for page in (0..bytes).step_by(PAGE) {
            // SAFETY: inside the mapping.
            unsafe { (place as *mut u8).add(page).write_volatile(1) };
        }
        call!(SYS_mprotect, place, bytes, libc::PROT_READ);
        call!(SYS_madvise, place, bytes, libc::MADV_DONTNEED);
        call!(SYS_madvise, place, bytes, libc::MADV_HUGEPAGE);
        call!(SYS_madvise, place, bytes, 25); // MADV_COLLAPSE
        call!(SYS_munmap, place, bytes) == 0
    });
}

/// Calls that take long inside the kernel.
pub(super) fn long_reads() {
    let bytes = 16_usize << 20;
    let protection = libc::PROT_READ | libc::PROT_WRITE;
    let place = call!(SYS_mmap, 0, bytes, protection, libc::MAP_PRIVATE | libc::MAP_ANONYMOUS, -1, 0);
    call!(SYS_getrandom, place, bytes, 0);
    let zero = open(&c"/dev/zero".to_owned(), libc::O_RDONLY);
    call!(SYS_read, zero, place, bytes);
    call!(SYS_close, zero);
    call!(SYS_munmap, place, bytes);
}

/// Files whose reading asks every processor, or walks all that the kernel knows.
pub(super) fn tell_tale_files(turn: &Turn) {
    let files = [
        "/proc/cpuinfo",
        "/proc/stat",
        "/proc/meminfo",
        "/proc/self/smaps",
        "/proc/self/pagemap",
        "/proc/self/sched",
        "/proc/self/mountinfo",
        "/proc/self/net/dev",
        "/sys/devices/system/cpu/online",
    ];
    turn.repeat(|| {
        for file in files {
            let _ = std::fs::File::open(file).and_then(|mut file| {
                let mut bytes = [0; 65_536];
                std::io::Read::read(&mut file, &mut bytes)
            });
        }
        true
    });
}

pub(super) fn splices(held: &mut Held, turn: &Turn) {
    if held.descriptors.is_empty() {
        for _ in 0..2 {
            let mut ends = [0_i32; 2];
            call!(SYS_pipe2, ends.as_mut_ptr(), libc::O_NONBLOCK);
            held.descriptors.extend(ends);
        }
    }
    static BYTES: [u8; 65_536] = [0; 65_536];
    let [first_out, first_in, second_out, second_in] = held.descriptors[..] else { return };
    let part = libc::iovec { iov_base: BYTES.as_ptr().cast_mut().cast(), iov_len: BYTES.len() };
    turn.repeat(|| {
        call!(SYS_vmsplice, first_in, &raw const part, 1, 0);
        call!(SYS_tee, first_out, second_in, 65_536, 0);
        call!(SYS_splice, first_out, null::<u8>(), second_in, null::<u8>(), 65_536, libc::SPLICE_F_NONBLOCK);
        call!(SYS_splice, second_out, null::<u8>(), 2, null::<u8>(), 65_536, libc::SPLICE_F_NONBLOCK);
        true
    });
}

pub(super) fn execute_itself() {
    let program = open(&c"/proc/self/exe".to_owned(), libc::O_PATH);
    let none: [*const libc::c_char; 1] = [null()];
    call!(SYS_execveat, program, c"".as_ptr(), none.as_ptr(), none.as_ptr(), libc::AT_EMPTY_PATH);
    call!(SYS_execve, c"/proc/self/exe".as_ptr(), none.as_ptr(), null_mut::<u8>());
}

/// Ends in its last moment with much to be given back.
pub(super) fn exit_with_much(held: &mut Held, turn: &Turn) {
    descriptors(held, turn);
    if now_ns() < turn.until_ns {
        page_faults(turn);
        // SAFETY: it ends the process.
        unsafe { libc::_exit(0) }
    }
}

/// Children that end at once, as many as there may be.
pub(super) fn children(turn: &Turn) {
    turn.repeat(|| {
        // SAFETY: the child ends at once.
        match unsafe { libc::fork() } {
            -1 => {
                call!(SYS_wait4, -1, null::<u8>(), libc::WNOHANG, null::<u8>());
                true
            }
            // SAFETY: it ends the process.
            0 => unsafe { libc::_exit(0) },
            _ => true,
        }
    });
}
