//! What nobody else may know: the keys of the links, and numbers that nobody can foresee.
//!
//! It must never write either anywhere.
#![allow(unsafe_code)] // takes over the descriptor that the executive left open, and asks the kernel for random bytes

use std::fs::File;
use std::os::fd::FromRawFd;
use std::os::unix::fs::FileExt;

use bateleur_apex::StartError;
use bateleur_contract::relay::{KEY_BYTES, RELAY_KEYS_FD, RelayTable};
use bateleur_relay::Key;

/// The keys of a table's links, in its order; zeros for those that are not authenticated.
pub(super) fn read(table: &RelayTable) -> Result<Vec<Key>, StartError> {
    let mut keys = vec![[0; KEY_BYTES]; table.links.len()];
    if table.links.iter().any(|link| link.authenticated) {
        // SAFETY: where a link is authenticated the executive left this descriptor open, and nobody else in the process knows it.
        let file = unsafe { File::from_raw_fd(RELAY_KEYS_FD) };
        file.read_exact_at(keys.as_flattened_mut(), 0).map_err(|error| {
            StartError::Other(format!("the executive handed over no keys of links: {error}"))
        })?;
    }
    Ok(keys)
}

/// 32 bytes of the kernel's.
pub(super) fn unforeseen() -> Result<[u8; 32], StartError> {
    let mut bytes = [0; 32];
    // SAFETY: the kernel writes as many bytes as it is handed, which live here.
    let length = unsafe { libc::getrandom(bytes.as_mut_ptr().cast(), bytes.len(), 0) };
    match usize::try_from(length) {
        Ok(length) if length == bytes.len() => Ok(bytes),
        _ => {
            let error = std::io::Error::last_os_error();
            Err(StartError::Other(format!("the kernel gives no random bytes: {error}")))
        }
    }
}
