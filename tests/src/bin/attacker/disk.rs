//! The disk, the partition's log and its channel directories.

use super::*;

pub(super) fn allocate() {
    for mode in [libc::FALLOC_FL_KEEP_SIZE, 0, 0x10, 0x10 | libc::FALLOC_FL_KEEP_SIZE] {
        call!(SYS_fallocate, 2, mode, 0, HUGE);
        call!(SYS_fallocate, 1, mode, HUGE, HUGE);
    }
}

pub(super) fn truncate() {
    for length in [60 << 20, HUGE, 1 << 44, 0] {
        call!(SYS_ftruncate, 2, length);
        call!(SYS_ftruncate, 1, length);
    }
}

pub(super) fn write_anywhere() {
    let text = [b'.'; PAGE];
    for offset in [0_i64, 60 << 20, 63 << 20, HUGE, 1 << 40] {
        call!(SYS_pwrite64, 2, text.as_ptr(), PAGE, offset);
        call!(SYS_lseek, 2, offset, libc::SEEK_SET);
        call!(SYS_write, 2, text.as_ptr(), PAGE);
    }
    let into = &mut (50_i64 << 20);
    let from = call!(SYS_openat, libc::AT_FDCWD, c"/dev/zero".as_ptr(), libc::O_RDONLY);
    call!(SYS_copy_file_range, from, null::<u8>(), 2, std::ptr::from_mut(into), 1 << 20, 0);
    call!(SYS_sendfile, 2, from, null::<u8>(), 1 << 20);
    call!(SYS_close, from);
}

pub(super) fn map_log() {
    let protection = libc::PROT_READ | libc::PROT_WRITE;
    for descriptor in [1, 2] {
        call!(SYS_ftruncate, descriptor, 8 << 20);
        let place = call!(SYS_mmap, 0, 8 << 20, protection, libc::MAP_SHARED, descriptor, 0);
        if place <= 0 {
            continue;
        }
        for page in (0..(8 << 20)).step_by(PAGE) {
            // SAFETY: inside the mapping, of a file that is as long; if it is not any more, this ends the process.
            unsafe { (place as *mut u8).add(page).write_volatile(b'.') };
        }
        call!(SYS_msync, place, 8 << 20, libc::MS_ASYNC);
        call!(SYS_munmap, place, 8 << 20);
    }
}

pub(super) fn change_log() {
    let own = call!(SYS_getpid);
    for descriptor in [1, 2] {
        call!(SYS_fcntl, descriptor, libc::F_SETFL, 0);
        call!(SYS_fcntl, descriptor, libc::F_SETFL, libc::O_ASYNC | libc::O_NONBLOCK | libc::O_DIRECT);
        call!(SYS_fcntl, descriptor, libc::F_SETOWN, own);
        call!(SYS_fcntl, descriptor, libc::F_SETPIPE_SZ, 1 << 20);
        call!(SYS_fcntl, descriptor, libc::F_SETPIPE_SZ, PAGE);
        call!(SYS_fcntl, descriptor, libc::F_SETLEASE, libc::F_WRLCK);
        call!(SYS_fcntl, descriptor, libc::F_NOTIFY, 0x7fff_ffff);
        // SAFETY: plain data, for which zero is a value.
        let mut lock: libc::flock = unsafe { std::mem::zeroed() };
        lock.l_type = libc::F_WRLCK as libc::c_short;
        call!(SYS_fcntl, descriptor, libc::F_SETLK, &raw const lock);
        call!(SYS_flock, descriptor, libc::LOCK_EX | libc::LOCK_NB);
        call!(SYS_fchmod, descriptor, 0);
        call!(SYS_lseek, descriptor, 0, libc::SEEK_SET);
        call!(SYS_write, descriptor, c"overwritten\n".as_ptr(), 12);
        // A pipe that another one reads: it may be read from here too, or filled without an end of a line.
        let mut bytes = [0_u8; 64];
        call!(SYS_fcntl, descriptor, libc::F_SETFL, libc::O_NONBLOCK);
        call!(SYS_read, descriptor, bytes.as_mut_ptr(), bytes.len());
        call!(SYS_write, descriptor, bytes.as_ptr(), bytes.len());
    }
}

pub(super) fn babble(held: &mut Held, turn: &Turn) {
    static TEXT: [u8; 1 << 20] = [b'x'; 1 << 20];
    turn.repeat(|| {
        held.count += 1;
        let length = if held.count.is_multiple_of(2) { TEXT.len() } else { 1 };
        call!(SYS_write, 2, TEXT.as_ptr(), length) > 0
    });
}

/// The folders of its own channels, as its memory map names them.
pub(super) fn own_channels() -> Vec<CString> {
    let maps = std::fs::read_to_string("/proc/self/maps").unwrap_or_default();
    let mut folders: Vec<String> = maps
        .lines()
        .filter_map(|line| line.find("/dev/shm/").map(|place| line[place..].trim_end_matches(" (deleted)")))
        .filter_map(|path| {
            let (run, rest) = path.split_once("/ports/")?;
            Some(format!("{run}/ports/{}", rest.split('/').next()?))
        })
        .collect();
    folders.sort_unstable();
    folders.dedup();
    folders.into_iter().filter_map(|folder| CString::new(folder).ok()).collect()
}

pub(super) fn path(folder: &CString, name: &str) -> CString {
    let folder = folder.to_str().unwrap_or_default();
    CString::new(format!("{folder}/{name}")).unwrap_or_default()
}

pub(super) fn open(path: &CString, flags: i32) -> c_long {
    call!(SYS_openat, libc::AT_FDCWD, path.as_ptr(), flags, 0o666)
}

pub(super) fn fill_channel(held: &mut Held, turn: &Turn) {
    let text = [b'.'; 16 * PAGE];
    for folder in own_channels() {
        let file = open(&path(&folder, "fill"), libc::O_CREAT | libc::O_WRONLY | libc::O_APPEND);
        if file < 0 {
            continue;
        }
        turn.repeat(|| call!(SYS_write, file, text.as_ptr(), text.len()) > 0);
        call!(SYS_fallocate, file, 0, 0, 60 << 20);
        held.count += 1;
        call!(SYS_close, file);
    }
}

pub(super) fn sparse_in_channel() {
    for folder in own_channels() {
        for (number, length) in [64_i64 << 20, HUGE, 1 << 44, i64::MAX].into_iter().enumerate() {
            let file = open(&path(&folder, &format!("sparse{number}")), libc::O_CREAT | libc::O_RDWR);
            call!(SYS_ftruncate, file, length);
            call!(SYS_fallocate, file, libc::FALLOC_FL_KEEP_SIZE, 0, length);
            call!(SYS_pwrite64, file, c"end".as_ptr(), 3, length - 3);
            call!(SYS_close, file);
        }
        call!(SYS_truncate, path(&folder, "sparse0").as_ptr(), 0);
    }
}

pub(super) fn names_in_channel(held: &mut Held, turn: &Turn) {
    let folders = own_channels();
    turn.repeat(|| {
        held.count += 1;
        folders.iter().any(|folder| {
            let name = format!("{:0200}", held.count);
            let file = open(&path(folder, &name), libc::O_CREAT | libc::O_RDONLY);
            let link = path(folder, &format!("link{:0200}", held.count));
            call!(SYS_linkat, libc::AT_FDCWD, path(folder, &name).as_ptr(), libc::AT_FDCWD, link.as_ptr(), 0);
            call!(SYS_symlinkat, c"/etc/passwd".as_ptr(), libc::AT_FDCWD, link.as_ptr());
            call!(SYS_close, file);
            file >= 0
        })
    });
}

pub(super) fn folders_in_channel(held: &mut Held, turn: &Turn) {
    if held.count == 0 {
        held.count = own_channels().len() as u64;
        if let Some(folder) = own_channels().first() {
            call!(SYS_chdir, folder.as_ptr());
        }
    }
    turn.repeat(|| {
        call!(SYS_mkdirat, libc::AT_FDCWD, c"d".as_ptr(), 0o777) == 0 && {
            let entered = call!(SYS_chdir, c"d".as_ptr()) == 0;
            call!(SYS_fchmodat, libc::AT_FDCWD, c"..".as_ptr(), 0);
            entered
        }
    });
}

pub(super) fn chmod_all() {
    for folder in own_channels() {
        let names = std::fs::read_dir(folder.to_str().unwrap_or_default()).into_iter().flatten().flatten();
        for entry in names {
            let path = CString::new(entry.path().as_os_str().as_encoded_bytes()).unwrap_or_default();
            call!(SYS_fchmodat, libc::AT_FDCWD, path.as_ptr(), 0);
        }
        call!(SYS_fchmodat, libc::AT_FDCWD, folder.as_ptr(), 0);
        call!(SYS_fchownat, libc::AT_FDCWD, folder.as_ptr(), 0, 0, 0);
    }
    for descriptor in 0..64 {
        call!(SYS_fchmod, descriptor, 0);
        call!(SYS_fchown, descriptor, 0, 0);
    }
    for place in [c"/dev/shm", c"/proc/self", c"/dev/null", c"/tmp", c"."] {
        call!(SYS_fchmodat, libc::AT_FDCWD, place.as_ptr(), 0);
    }
    // SAFETY: it ends the process: who buries it finds what it left.
    unsafe { libc::_exit(0) }
}

/// Locks every file of its channels, and all that it has open, for as long as it lives.
pub(super) fn lock_all(held: &mut Held) {
    if held.count > 0 {
        return;
    }
    held.count = 1;
    let mut folders: Vec<_> =
        own_channels().iter().filter_map(|path| path.to_str().ok().map(std::path::PathBuf::from)).collect();
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            if entry.path().is_dir() {
                folders.push(entry.path());
            } else if let Ok(path) = CString::new(entry.path().as_os_str().as_encoded_bytes()) {
                let file = open(&path, libc::O_RDWR);
                lock(file as i32);
                keep(held, file);
            }
        }
    }
    (0..64).for_each(lock);
}

pub(super) fn lock(descriptor: i32) {
    // SAFETY: plain data, for which zero is a value.
    let mut whole: libc::flock = unsafe { std::mem::zeroed() };
    whole.l_type = libc::F_WRLCK as libc::c_short;
    call!(SYS_fcntl, descriptor, libc::F_OFD_SETLK, &raw const whole);
    call!(SYS_fcntl, descriptor, libc::F_SETLK, &raw const whole);
    call!(SYS_flock, descriptor, libc::LOCK_EX | libc::LOCK_NB);
}

pub(super) fn change_folder(held: &mut Held) {
    call!(SYS_umask, 0o777);
    let places = own_channels();
    if let Some(folder) = places.get(held.count as usize % places.len().max(1)) {
        call!(SYS_chdir, folder.as_ptr());
    }
    for name in [c"made", c"made/again", c"../made", c"../../made"] {
        call!(SYS_mkdirat, libc::AT_FDCWD, name.as_ptr(), 0o777);
        call!(SYS_openat, libc::AT_FDCWD, name.as_ptr(), libc::O_CREAT | libc::O_RDWR, 0o777);
    }
    call!(SYS_renameat2, libc::AT_FDCWD, c".".as_ptr(), libc::AT_FDCWD, c"../elsewhere".as_ptr(), 0);
    held.count += 1;
}
