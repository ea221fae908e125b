//! Where the code of the C library lies.
#![allow(unsafe_code)] // asks the loader

use std::sync::atomic::{AtomicUsize, Ordering::Relaxed};

/// Its first byte and the one behind its last; both 0 if it is part of the program.
static BEGIN: AtomicUsize = AtomicUsize::new(0);
static END: AtomicUsize = AtomicUsize::new(0);

/// Asks the loader, once, before signals come.
pub(crate) fn find() {
    // SAFETY: the loader calls back with valid descriptions of what it has loaded.
    unsafe { libc::dl_iterate_phdr(Some(look_at), std::ptr::null_mut()) };
}

/// An address in it. False for every address if the program has a C library of its own.
pub(crate) fn contains(address: usize) -> bool {
    (BEGIN.load(Relaxed)..END.load(Relaxed)).contains(&address)
}

/// Remembers the code that has `malloc` and not this function.
unsafe extern "C" fn look_at(
    object: *mut libc::dl_phdr_info,
    _: libc::size_t,
    _: *mut libc::c_void,
) -> libc::c_int {
    // SAFETY: the loader's: an object, and its list of program headers.
    let (base, headers) = unsafe {
        let object = &*object;
        (object.dlpi_addr as usize, std::slice::from_raw_parts(object.dlpi_phdr, object.dlpi_phnum.into()))
    };
    for header in headers.iter().filter(|header| header.p_type == libc::PT_LOAD) {
        let begin = base + header.p_vaddr as usize;
        let code = begin..begin + header.p_memsz as usize;
        if code.contains(&(libc::malloc as *const () as usize))
            && !code.contains(&(find as *const () as usize))
        {
            BEGIN.store(code.start, Relaxed);
            END.store(code.end, Relaxed);
        }
    }
    0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_the_librarys_and_this_test_is_not() {
        find();
        assert!(!contains(memory_is_the_librarys_and_this_test_is_not as *const () as usize));
        assert!(cfg!(target_feature = "crt-static") || contains(libc::free as *const () as usize));
    }
}
