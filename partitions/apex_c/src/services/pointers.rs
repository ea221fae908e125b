//! What C's pointers point to. A null pointer is INVALID_PARAM; any other is believed, as every C function does.

use std::slice;
use std::sync::Once;

use bateleur_apex::ReturnCode;
use bateleur_apex::processes::standard::MAX_NAME_LENGTH;
use bateleur_apex::processes::{Process, current};

unsafe extern "C" {
    static stdout: *mut libc::FILE;
}

/// What C prints reaches the partition's log line by line, and is not lost when the partition is ended.
fn print_by_lines() {
    static ONCE: Once = Once::new();
    // SAFETY: the C library's own stream; nobody else runs when the main process calls its first service.
    ONCE.call_once(|| unsafe {
        libc::setvbuf(stdout, std::ptr::null_mut(), libc::_IOLBF, 0);
    });
}

/// Stores the return code.
///
/// # Safety
/// Null, or a place for a number.
pub(super) unsafe fn tell(return_code: *mut u32, result: Result<(), ReturnCode>) {
    print_by_lines();
    if !return_code.is_null() {
        // SAFETY: the caller's.
        unsafe { *return_code = result.map_or_else(|code| code as u32, |()| 0) };
    }
}

/// INVALID_PARAM unless it points to something.
pub(super) fn given<T>(pointer: *const T) -> Result<(), ReturnCode> {
    if pointer.is_null() { Err(ReturnCode::InvalidParam) } else { Ok(()) }
}

/// Stores a value.
///
/// # Safety
/// Null, or a place for one.
pub(super) unsafe fn put<T>(place: *mut T, value: T) -> Result<(), ReturnCode> {
    given(place)?;
    // SAFETY: the caller's.
    unsafe { place.write(value) };
    Ok(())
}

/// Stores what a service gives; a place that is not there is found before the service is called.
///
/// # Safety
/// As [`put`].
pub(super) unsafe fn put_first<T>(
    place: *mut T,
    service: impl FnOnce() -> Result<T, ReturnCode>,
) -> Result<(), ReturnCode> {
    given(place)?;
    // SAFETY: the caller's.
    unsafe { put(place, service()?) }
}

/// A name that C gave.
pub(super) struct GivenName {
    bytes: [u8; MAX_NAME_LENGTH],
    length: usize,
}

impl GivenName {
    /// # Errors
    /// INVALID_CONFIG: it is no text, so that nothing has that name.
    pub(super) fn text(&self) -> Result<&str, ReturnCode> {
        std::str::from_utf8(&self.bytes[..self.length]).map_err(|_| ReturnCode::InvalidConfig)
    }
}

/// A name of 32 characters, or of fewer before a NUL: a string may be shorter than the array that the type is.
///
/// # Safety
/// Null, or such a name.
pub(super) unsafe fn name_of(name: *const u8) -> Result<GivenName, ReturnCode> {
    given(name)?;
    let mut copied = GivenName { bytes: [0; MAX_NAME_LENGTH], length: 0 };
    for byte in &mut copied.bytes {
        // SAFETY: the caller's; nothing behind a NUL is read.
        match unsafe { *name.add(copied.length) } {
            0 => break,
            of_name => *byte = of_name,
        }
        copied.length += 1;
    }
    Ok(copied)
}

/// A message. One without bytes, whose length may be negative, is refused by its service, in the order of the service's checks.
///
/// # Safety
/// Null, or so many bytes.
pub(super) unsafe fn bytes<'c>(message: *const u8, length: i32) -> Result<&'c [u8], ReturnCode> {
    given(message)?;
    let length = usize::try_from(length).unwrap_or(0);
    // SAFETY: the caller's, for the time of its call.
    Ok(unsafe { slice::from_raw_parts(message, length) })
}

/// A text of an error or a report, which may be empty.
///
/// # Safety
/// As [`bytes`].
pub(super) unsafe fn text<'c>(message: *const u8, length: i32) -> Result<&'c [u8], ReturnCode> {
    match length {
        0 => Ok(&[]),
        // SAFETY: the caller's.
        1.. => unsafe { bytes(message, length) },
        _ => Err(ReturnCode::InvalidParam),
    }
}

/// Copies the message that a service gives. Where it gives none, the length is 0.
///
/// # Safety
/// `message`: null, or room for the longest message of what is read; `length`: null, or a place.
pub(super) unsafe fn receive<R>(
    message: *mut u8,
    length: *mut i32,
    service: impl FnOnce(&Process, &mut Vec<u8>) -> Result<R, ReturnCode>,
) -> Result<R, ReturnCode> {
    // SAFETY: the caller's.
    unsafe { put(length, 0)? };
    given(message)?;
    current::receive(service, |result, given| {
        // SAFETY: the caller's; no message is longer than what it is read from has room for.
        unsafe {
            message.copy_from_nonoverlapping(given.as_ptr(), given.len());
            *length = given.len() as i32; // at most a port's size
        }
        result
    })
}
