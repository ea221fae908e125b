//! Removes what was put aside: directories of channels that were rebuilt. A partition may have filled them with whatever it could make,
//! and the executive must not wait for that.

use std::path::PathBuf;

use bateleur_system::tree::{self, NotRemoved};

/// Removes each of `paths`.
///
/// # Errors
/// The first thing that could not be removed: it is removed at the end of the run.
pub fn run(paths: &[PathBuf]) -> Result<(), NotRemoved> {
    super::begin(c"remover");
    paths.iter().map(|path| tree::remove(path)).fold(Ok(()), Result::and)
}
