//! Memory of channels between pages that nobody may touch.
//!
//! A place that a partition has written into a channel may lie beyond the channel's memory. Whoever attaches writes there, into what the
//! kernel has mapped next: in a partition that may be memory that ends it, and in a [`channel_probe`](bateleur_channels::channel_probe) another
//! channel, where nothing is noticed. So the process of a probe that attaches has guards on both sides of each mapping of a file.
//!
//! The library maps by the C library's `mmap`, which the definition here takes the place of in this program.

#![allow(unsafe_code)]

use std::ffi::{c_int, c_void};
use std::os::fd::BorrowedFd;
use std::ptr;
use std::sync::atomic::{AtomicBool, Ordering};

use rustix::io::Errno;
use rustix::mm::{self, MapFlags, ProtFlags};

/// On each side, bytes: a multiple of every size of pages.
const GUARD: usize = 1 << 20;
/// The same for what is mapped, which need not fill its last page.
const STEP: usize = 1 << 16;

/// Whether mappings have guards from now on.
static GUARDS: AtomicBool = AtomicBool::new(false);

/// Mappings of files have guards from now on. They take addresses, no memory, and stay until the process ends.
pub(crate) fn begin() {
    GUARDS.store(true, Ordering::Relaxed);
}

unsafe extern "C" {
    fn __errno_location() -> *mut c_int;
}

/// As the C library's.
///
/// # Safety
/// As the C library's.
#[unsafe(no_mangle)]
unsafe extern "C" fn mmap(
    address: *mut c_void,
    length: usize,
    protection: c_int,
    flags: c_int,
    file: c_int,
    offset: i64,
) -> *mut c_void {
    let protection = ProtFlags::from_bits_retain(protection as u32);
    let flags = MapFlags::from_bits_retain(flags as u32);
    let guarded = file >= 0 && address.is_null() && GUARDS.load(Ordering::Relaxed);
    // SAFETY: the caller's, but for a mapping with guards: that lies at a place which was free and is this one's alone.
    let mapped = unsafe {
        match (guarded.then(|| place(length)).flatten(), file) {
            (Some(place), _) => {
                mm::mmap(place, length, protection, flags | MapFlags::FIXED, borrowed(file), offset as u64)
            }
            (None, 0..) => mm::mmap(address, length, protection, flags, borrowed(file), offset as u64),
            (None, _) => mm::mmap_anonymous(address, length, protection, flags.difference(ANONYMOUS)),
        }
    };
    mapped.unwrap_or_else(|error| {
        // SAFETY: the C library gives each thread such a place.
        unsafe { *__errno_location() = error.raw_os_error() };
        ptr::without_provenance_mut(usize::MAX) // MAP_FAILED
    })
}

/// `mmap_anonymous` says it by itself.
const ANONYMOUS: MapFlags = MapFlags::from_bits_retain(0x20);

/// # Safety
/// The caller of `mmap` vouches for the descriptor.
unsafe fn borrowed<'a>(file: c_int) -> BorrowedFd<'a> {
    // SAFETY: see above.
    unsafe { BorrowedFd::borrow_raw(file) }
}

/// Where so many bytes have a guard on both sides; `None`: there are no such addresses.
fn place(length: usize) -> Option<*mut c_void> {
    let all = length.checked_next_multiple_of(STEP)?.checked_add(2 * GUARD)?;
    let flags = MapFlags::PRIVATE | MapFlags::NORESERVE;
    // SAFETY: addresses that are free, of which nothing can be read or written.
    let reserved: Result<_, Errno> =
        unsafe { mm::mmap_anonymous(ptr::null_mut(), all, ProtFlags::empty(), flags) };
    Some(reserved.ok()?.wrapping_byte_add(GUARD))
}

#[cfg(test)]
mod tests {
    use std::io::Write;
    use std::os::fd::AsRawFd;

    use super::*;

    unsafe extern "C" {
        #[link_name = "mmap"]
        fn mmap_of_the_c_library(
            _: *mut c_void,
            _: usize,
            _: c_int,
            _: c_int,
            _: c_int,
            _: i64,
        ) -> *mut c_void;
    }

    /// The protection of what is mapped at an address.
    fn protection_at(address: usize) -> Option<String> {
        let maps = std::fs::read_to_string("/proc/self/maps").unwrap();
        maps.lines().find_map(|line| {
            let (range, rest) = line.split_once(' ')?;
            let (from, to) = range.split_once('-')?;
            let bounds = [from, to].map(|text| usize::from_str_radix(text, 16).unwrap());
            (bounds[0]..bounds[1]).contains(&address).then(|| rest[..4].to_owned())
        })
    }

    #[test]
    fn a_write_past_the_memory_of_a_channel_meets_a_guard_whatever_is_mapped_next() {
        begin();
        let mut file = tempfile::tempfile().unwrap();
        file.write_all(&[7; 10_000]).unwrap();
        let (both, shared) =
            ((ProtFlags::READ | ProtFlags::WRITE).bits() as c_int, MapFlags::SHARED.bits() as c_int);
        for _ in 0..3 {
            // SAFETY: a mapping of a file that nobody else has.
            let mapped =
                unsafe { mmap_of_the_c_library(ptr::null_mut(), 10_000, both, shared, file.as_raw_fd(), 0) };
            // SAFETY: the first byte of it.
            assert_eq!(unsafe { *mapped.cast::<u8>() }, 7);
            let from = mapped.addr();
            assert_eq!(protection_at(from).as_deref(), Some("rw-s"));
            for guard in [from - 1, from - GUARD, from + STEP, from + STEP + GUARD - 1] {
                assert_eq!(
                    protection_at(guard).as_deref(),
                    Some("---p"),
                    "{:+}",
                    guard.wrapping_sub(from) as isize
                );
            }
        }
    }

    #[test]
    fn a_refused_mapping_says_why_and_one_without_a_file_is_made() {
        let (read, private) = (ProtFlags::READ.bits() as c_int, MapFlags::PRIVATE.bits() as c_int);
        // SAFETY: nothing is mapped, or pages that nobody else has.
        unsafe {
            let refused = mmap_of_the_c_library(ptr::null_mut(), 4096, read, private, 9_999, 0);
            assert_eq!(refused.addr(), usize::MAX);
            assert_eq!(std::io::Error::last_os_error().raw_os_error(), Some(Errno::BADF.raw_os_error()));
            let flags = private | ANONYMOUS.bits() as c_int;
            let made = mmap_of_the_c_library(ptr::null_mut(), 4096, read, flags, -1, 0);
            assert_eq!(*made.cast::<u8>(), 0);
        }
    }
}
