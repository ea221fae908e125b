//! Folders for logs that root makes among a user's own.

use std::fs;
use std::io;
use std::os::unix::fs::{MetadataExt, lchown};
use std::path::Path;

/// Makes a folder with those above it that are missing. What root makes belongs to whoever owns the folder above, so that a run as root
/// locks no user out of his own folders.
///
/// # Errors
/// One can not be made.
pub fn make(folder: &Path) -> io::Result<()> {
    if folder.as_os_str().is_empty() || folder.is_dir() {
        return Ok(());
    }
    let above = folder.parent().filter(|above| !above.as_os_str().is_empty()).unwrap_or(Path::new("."));
    make(above)?;
    match fs::create_dir(folder) {
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists && folder.is_dir() => return Ok(()),
        made => made?,
    }
    if rustix::process::geteuid().is_root() {
        let owner = fs::metadata(above)?;
        let _ = lchown(folder, Some(owner.uid()), Some(owner.gid())); // a file system without owners
    }
    Ok(())
}

/// Takes files out of a folder of this user that another one wrote there and that this one may not write: what is to be kept, by its
/// name, stays beside as `NAME.old`.
///
/// # Errors
/// One can not be taken out.
pub fn free(folder: &Path, kept: &[&str]) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let denied = || fs::OpenOptions::new().write(true).open(&path).err();
        if !path.is_file() || denied().is_none_or(|error| error.kind() != io::ErrorKind::PermissionDenied) {
            continue;
        }
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        match kept.contains(&name.as_str()) {
            true => fs::rename(&path, folder.join(name + ".old"))?,
            false => fs::remove_file(&path)?,
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    #[test]
    fn folders_belong_to_the_owner_of_the_one_above() {
        let place = tempfile::tempdir().unwrap();
        if !rustix::process::geteuid().is_root() {
            eprintln!("skipped: needs root");
            return;
        }
        lchown(place.path(), Some(61_657), Some(61_657)).unwrap();
        let deep = place.path().join("target/runs/latest");
        make(&deep).unwrap();
        make(&deep).unwrap();
        for folder in deep.ancestors().take(3) {
            let about = fs::metadata(folder).unwrap();
            assert_eq!((about.uid(), about.gid()), (61_657, 61_657), "{}", folder.display());
        }
    }

    #[test]
    fn a_file_in_place_of_a_folder_is_an_error() {
        let place = tempfile::tempdir().unwrap();
        let file = place.path().join("target");
        fs::write(&file, "").unwrap();
        assert!(make(&file.join("runs")).is_err());
    }

    #[test]
    fn files_that_can_be_written_stay() {
        let place = tempfile::tempdir().unwrap();
        let log = place.path().join("windows.csv");
        fs::write(&log, "last run").unwrap();
        fs::set_permissions(&log, fs::Permissions::from_mode(0o600)).unwrap();
        free(place.path(), &[]).unwrap();
        assert_eq!(fs::read_to_string(&log).unwrap(), "last run");
    }
}
