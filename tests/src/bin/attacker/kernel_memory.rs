//! The kernel's memory outside of sockets: pipes, queues, mappings, locks, names.

use super::*;

pub(super) fn pipes(held: &mut Held, turn: &Turn) {
    static BYTES: [u8; 1 << 20] = [0; 1 << 20];
    turn.repeat(|| {
        let mut ends = [0_i32; 2];
        if call!(SYS_pipe2, ends.as_mut_ptr(), libc::O_NONBLOCK) != 0 {
            return false;
        }
        held.descriptors.extend(ends);
        call!(SYS_fcntl, ends[1], libc::F_SETPIPE_SZ, 1 << 20);
        call!(SYS_write, ends[1], BYTES.as_ptr(), PAGE) > 0
    });
}

pub(super) fn message_queues(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        held.count += 1;
        let name = CString::new(format!("q{}", held.count)).unwrap_or_default();
        let flags = libc::O_CREAT | libc::O_RDWR | libc::O_NONBLOCK;
        let made = call!(SYS_mq_open, name.as_ptr(), flags, 0o600, null::<u8>());
        while made >= 0 && call!(SYS_mq_timedsend, made, name.as_ptr(), 2, 0, null::<u8>()) == 0 {}
        keep(held, made)
    });
}

pub(super) fn system_v(held: &mut Held, turn: &Turn) {
    static MESSAGE: [u8; 8_192] = [1; 8_192];
    turn.repeat(|| {
        held.count += 1;
        let queue = call!(SYS_msgget, libc::IPC_PRIVATE, 0o600);
        call!(SYS_msgsnd, queue, MESSAGE.as_ptr(), 8_000, libc::IPC_NOWAIT);
        let set = call!(SYS_semget, libc::IPC_PRIVATE, 32_000, 0o600);
        let memory = call!(SYS_shmget, libc::IPC_PRIVATE, 1 << 20, 0o600);
        let place = call!(SYS_shmat, memory, null::<u8>(), 0);
        if place > 0 {
            // SAFETY: in the middle of the memory that was just attached.
            unsafe { (place as *mut u8).add(PAGE).write_volatile(1) };
        }
        queue >= 0 || set >= 0 || memory >= 0
    });
}

pub(super) fn locked_memory() {
    call!(SYS_mlockall, libc::MCL_CURRENT | libc::MCL_FUTURE);
    let protection = libc::PROT_READ | libc::PROT_WRITE;
    let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS;
    let place = call!(SYS_mmap, 0, 256 << 20, protection, flags, -1, 0);
    if place > 0 {
        call!(SYS_mlock2, place, 256 << 20, 1);
        call!(SYS_mlock, place, 16 << 20);
        call!(SYS_munlockall);
        call!(SYS_munmap, place, 256 << 20);
    }
}

pub(super) fn small_mappings(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        held.count += 1;
        let protection = if held.count.is_multiple_of(2) { libc::PROT_READ } else { libc::PROT_NONE };
        // A page in each two mebibytes has a page table of its own.
        let place = (1_u64 << 40) + held.count * (2 << 20);
        let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_POPULATE | libc::MAP_FIXED_NOREPLACE;
        call!(SYS_mmap, place, PAGE, protection, flags, -1, 0) > 0
    });
}

/// Mappings with a name each, which the kernel keeps.
pub(super) fn named_mappings(held: &mut Held, turn: &Turn) {
    turn.repeat(|| {
        held.count += 1;
        let protection = if held.count.is_multiple_of(2) { libc::PROT_READ } else { libc::PROT_NONE };
        let place = call!(SYS_mmap, 0, PAGE, protection, libc::MAP_PRIVATE | libc::MAP_ANONYMOUS, -1, 0);
        let name = CString::new(format!("{:079}", held.count)).unwrap_or_default();
        place > 0 && call!(SYS_prctl, libc::PR_SET_VMA, 0, place, PAGE, name.as_ptr()) == 0
    });
}

/// Pages of the machine's own pool, which no partition's memory counts.
pub(super) fn huge_pages(held: &mut Held) {
    let bytes = 2_usize << 20;
    let protection = libc::PROT_READ | libc::PROT_WRITE;
    for _ in 0..64 {
        let file = call!(SYS_memfd_create, c"huge".as_ptr(), libc::MFD_HUGETLB);
        call!(SYS_ftruncate, file, bytes);
        call!(SYS_mmap, 0, bytes, protection, libc::MAP_SHARED | libc::MAP_POPULATE, file, 0);
        let flags = libc::MAP_PRIVATE | libc::MAP_ANONYMOUS | libc::MAP_HUGETLB | libc::MAP_POPULATE;
        call!(SYS_mmap, 0, bytes, protection, flags, -1, 0);
        if !keep(held, file) {
            return;
        }
    }
}

/// Locks of single bytes, which can not be joined.
pub(super) fn file_locks(held: &mut Held, turn: &Turn) {
    if held.descriptors.is_empty() {
        let file = call!(SYS_memfd_create, c"locks".as_ptr(), 0);
        keep(held, file);
    }
    let Some(file) = held.descriptors.first().copied() else { return };
    turn.repeat(|| {
        held.count += 1;
        // SAFETY: plain data, for which zero is a value.
        let mut byte: libc::flock = unsafe { std::mem::zeroed() };
        (byte.l_type, byte.l_start, byte.l_len) = (libc::F_WRLCK as libc::c_short, 2 * held.count as i64, 1);
        call!(SYS_fcntl, file, libc::F_OFD_SETLK, &raw const byte);
        (byte.l_start, byte.l_len) = (2 * held.count as i64 + (1 << 40), 1);
        call!(SYS_fcntl, file, libc::F_SETLK, &raw const byte);
        true
    });
}

/// Names that are asked for and not there are remembered by the kernel.
pub(super) fn absent_names(held: &mut Held, turn: &Turn) {
    let folders = own_channels();
    turn.repeat(|| {
        held.count += 1;
        for folder in folders.iter().map(|folder| folder.to_str().unwrap_or_default()).chain(["/usr/lib"]) {
            let name = CString::new(format!("{folder}/{:0200}", held.count)).unwrap_or_default();
            call!(SYS_faccessat, libc::AT_FDCWD, name.as_ptr(), 0);
        }
        true
    });
}
