//! What of the file system a partition sees: everything read-only, its channels writable, nobody else's at all; of the
//! processes only itself.
//!
//! Prepared before there is a process; [`View::enter`] runs between `clone3` and the program, in a mount namespace of
//! its own, and makes system calls only.
#![allow(unsafe_code)]

use std::ffi::CString;
use std::io;
use std::mem::zeroed;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::ptr::null;

/// Where channels lie.
const SHARED_MEMORY: &str = "/dev/shm";

/// A view, with every text that its making needs.
#[derive(Debug)]
pub(super) struct View {
    /// Folders to make in the private `/dev/shm`, parents first.
    folders: Vec<CString>,
    /// Each channel's directory, and the same relative to `/dev/shm`.
    channels: Vec<(CString, CString)>,
}

impl View {
    /// With these directories below `/dev/shm`; those that are not there are left out.
    pub(super) fn new(channels: &[PathBuf]) -> io::Result<Self> {
        let mut view = Self { folders: Vec::new(), channels: Vec::new() };
        for path in channels.iter().filter(|path| path.is_dir()) {
            let Ok(relative) = path.strip_prefix(SHARED_MEMORY) else { continue };
            let parents = relative.ancestors().filter(|part| !part.as_os_str().is_empty());
            let mut parents: Vec<_> = parents.map(|part| Path::new(SHARED_MEMORY).join(part)).collect();
            parents.reverse();
            for parent in parents {
                let text = text(&parent)?;
                if !view.folders.contains(&text) {
                    view.folders.push(text);
                }
            }
            view.channels.push((text(path)?, text(relative)?));
        }
        Ok(view)
    }

    /// Makes it. False: something failed, as `errno` says.
    ///
    /// # Safety
    /// For a child between `clone3` and its program, in a mount namespace of its own.
    pub(super) unsafe fn enter(&self) -> bool {
        // SAFETY: system calls on constant strings and on those of `self`.
        unsafe { make_private() && hide_processes() && self.hide_shared_memory() && self.make_read_only() }
    }

    /// Covers `/dev/shm` by an empty one with the channels in it. The old one is still reached from the working directory.
    unsafe fn hide_shared_memory(&self) -> bool {
        // SAFETY: as in `enter`.
        unsafe {
            let here = libc::open(c".".as_ptr(), libc::O_PATH | libc::O_DIRECTORY | libc::O_CLOEXEC);
            here >= 0
                && libc::chdir(c"/dev/shm".as_ptr()) == 0
                && mount(c"tmpfs", c"/dev/shm", c"tmpfs", HARMLESS, c"size=4k,mode=0755")
                && self.folders.iter().all(|folder| libc::mkdir(folder.as_ptr(), 0o755) == 0)
                && self.channels.iter().all(|(place, old)| mount(old, place, c"", libc::MS_BIND, c""))
                && libc::fchdir(here) == 0
                && libc::close(here) == 0
        }
    }

    unsafe fn make_read_only(&self) -> bool {
        // SAFETY: as in `enter`.
        unsafe {
            let mut read_only: libc::mount_attr = zeroed();
            read_only.attr_set = libc::MOUNT_ATTR_RDONLY | libc::MOUNT_ATTR_NOSUID;
            let mut writable: libc::mount_attr = zeroed();
            writable.attr_clr = libc::MOUNT_ATTR_RDONLY;
            writable.attr_set = libc::MOUNT_ATTR_NOEXEC | libc::MOUNT_ATTR_NODEV;
            set_attributes(c"/", libc::AT_RECURSIVE, &read_only)
                && self.channels.iter().all(|(place, _)| set_attributes(place, 0, &writable))
        }
    }
}

/// What the C library reads in `/proc` beside the process' own folder.
const TELLING: [(&std::ffi::CStr, &std::ffi::CStr); 5] = [
    (c"meminfo", c"/proc/meminfo"),
    (c"cpuinfo", c"/proc/cpuinfo"),
    (c"stat", c"/proc/stat"),
    (c"uptime", c"/proc/uptime"),
    (c"version", c"/proc/version"),
];

/// Covers `/proc` by one with the process' own folder alone. It stays the machine's, not one of the inner process numbers:
/// shared memory names its owner by the number that the machine knows.
unsafe fn hide_processes() -> bool {
    // SAFETY: constant strings; the old place is still reached from the working directory.
    unsafe {
        let here = libc::open(c".".as_ptr(), libc::O_PATH | libc::O_DIRECTORY | libc::O_CLOEXEC);
        let fill = |(old, place): &(&std::ffi::CStr, &std::ffi::CStr)| {
            let file = libc::open(place.as_ptr(), libc::O_CREAT | libc::O_CLOEXEC, 0o444);
            file >= 0 && libc::close(file) == 0 && mount(old, place, c"", libc::MS_BIND, c"")
        };
        let folder = |old, place: &std::ffi::CStr| {
            // With what is mounted inside, which a user namespace must not uncover.
            libc::mkdir(place.as_ptr(), 0o755) == 0
                && mount(old, place, c"", libc::MS_BIND | libc::MS_REC, c"")
        };
        here >= 0
            && libc::chdir(c"/proc".as_ptr()) == 0
            && mount(c"tmpfs", c"/proc", c"tmpfs", HARMLESS, c"size=4k,mode=0755")
            && folder(c"self", c"/proc/self")
            && folder(c"sys", c"/proc/sys")
            && TELLING.iter().all(fill)
            && libc::fchdir(here) == 0
            && libc::close(here) == 0
    }
}

/// Nothing of what is mounted from now on may be seen outside.
unsafe fn make_private() -> bool {
    // SAFETY: constant strings.
    unsafe { mount(c"none", c"/", c"", libc::MS_REC | libc::MS_PRIVATE, c"") }
}

/// What holds no programs and no devices.
const HARMLESS: libc::c_ulong = libc::MS_NOSUID | libc::MS_NODEV | libc::MS_NOEXEC;

unsafe fn mount(
    what: &std::ffi::CStr,
    place: &std::ffi::CStr,
    kind: &std::ffi::CStr,
    flags: libc::c_ulong,
    options: &std::ffi::CStr,
) -> bool {
    let pointer = |text: &std::ffi::CStr| if text.is_empty() { null() } else { text.as_ptr() };
    // SAFETY: texts that outlive the call; absent ones are null.
    unsafe { libc::mount(what.as_ptr(), place.as_ptr(), pointer(kind), flags, pointer(options).cast()) == 0 }
}

unsafe fn set_attributes(place: &std::ffi::CStr, flags: i32, attributes: &libc::mount_attr) -> bool {
    let at: *const libc::mount_attr = attributes;
    // SAFETY: a text and a structure that outlive the call.
    unsafe {
        let size = size_of::<libc::mount_attr>();
        libc::syscall(libc::SYS_mount_setattr, libc::AT_FDCWD, place.as_ptr(), flags, at, size) == 0
    }
}

fn text(path: &Path) -> io::Result<CString> {
    Ok(CString::new(path.as_os_str().as_bytes())?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_made_before_what_lies_in_them_and_each_once() {
        let place = tempfile::tempdir_in(SHARED_MEMORY).unwrap();
        let channels = ["a", "b", "absent"].map(|name| place.path().join(name));
        channels[..2].iter().for_each(|path| std::fs::create_dir(path).unwrap());
        let view = View::new(&channels).unwrap();
        let run = text(place.path()).unwrap();
        let made: Vec<_> = channels[..2].iter().map(|path| text(path).unwrap()).collect();
        assert_eq!(view.folders, [run, made[0].clone(), made[1].clone()]);
        assert_eq!(view.channels.iter().map(|(place, _)| place.clone()).collect::<Vec<_>>(), made);
    }
}
