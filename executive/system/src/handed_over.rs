//! Descriptors that one program hands to the next by their numbers.
#![allow(unsafe_code)] // one conversion of a number

use std::fs::File;
use std::io::{self, Write};
use std::os::fd::{AsFd, FromRawFd, OwnedFd, RawFd};
use std::path::Path;

use rustix::fs::{MemfdFlags, SeekFrom, ftruncate, memfd_create, seek};

/// An empty file in memory that outlives `exec`.
///
/// # Errors
/// There is no memory for it.
pub fn file(name: &str) -> io::Result<File> {
    Ok(File::from(memfd_create(name, MemfdFlags::empty())?))
}

/// The same with `bytes` zeros.
///
/// # Errors
/// As above.
pub fn memory(name: &str, bytes: u64) -> io::Result<OwnedFd> {
    let file = file(name)?;
    ftruncate(&file, bytes)?;
    Ok(file.into())
}

/// The same with a text, to be read from its start.
///
/// # Errors
/// As above.
pub fn text(name: &str, text: &[u8]) -> io::Result<OwnedFd> {
    let mut file = file(name)?;
    file.write_all(text)?;
    seek(&file, SeekFrom::Start(0))?;
    Ok(file.into())
}

/// A second descriptor of a file, which outlives `exec`.
///
/// # Errors
/// The process has no descriptor left.
pub fn copy(of: impl AsFd) -> io::Result<OwnedFd> {
    Ok(rustix::io::dup(of)?)
}

/// A descriptor that whoever started this program handed over. To be taken once.
///
/// # Errors
/// It is not open, or one of the three standard ones.
pub fn inherited(number: RawFd) -> Result<OwnedFd, String> {
    if number < 3 || !Path::new(&format!("/proc/self/fd/{number}")).exists() {
        return Err(format!("descriptor {number} was not handed over"));
    }
    // SAFETY: it is open, and whoever started this program handed it over for this purpose; each is taken once.
    Ok(unsafe { OwnedFd::from_raw_fd(number) })
}

/// As [`inherited`], a second descriptor of what was handed over, which leaves that as it is.
///
/// # Errors
/// As there.
pub fn copy_of_inherited(number: RawFd) -> Result<OwnedFd, String> {
    let original = std::mem::ManuallyDrop::new(inherited(number)?);
    copy(original.as_fd()).map_err(|error| format!("descriptor {number} can not be copied: {error}"))
}
