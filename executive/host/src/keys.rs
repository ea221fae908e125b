//! The keys of links, as they lie on a disk: one file for each, 64 hexadecimal digits, for its owner alone.
//!
//! A key is read here and handed to a relay. It must never be printed, logged, or stand in a description.

use std::fmt;
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::os::unix::fs::{MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use bateleur_contract::relay::KEY_BYTES;
use rustix::fs::{MemfdFlags, Mode, fchmod, memfd_create};

/// Mode bits that let somebody else at a file.
const OTHERS: u32 = 0o077;
/// A file that is longer than this is no key, bytes: the digits, and room for line ends.
const LONGEST: u64 = 128;

/// The key of a link.
#[derive(Clone, PartialEq, Eq)]
pub struct Key([u8; KEY_BYTES]);

impl Key {
    /// What a link without authentication has in its place.
    #[must_use]
    pub fn none() -> Self {
        Self([0; KEY_BYTES])
    }

    /// Its bytes, for whoever hands it over.
    #[must_use]
    pub fn bytes(&self) -> &[u8; KEY_BYTES] {
        &self.0
    }
}

impl fmt::Debug for Key {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("Key(…)")
    }
}

/// Why a file is no key.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// It can not be read.
    #[error("{path}: {error}", path = .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's answer.
        error: io::Error,
    },
    /// Others can read or write it.
    #[error("{path} has mode {mode:04o}, so that others can get at the key: `chmod 600 {path}`", path = .path.display())]
    Mode {
        /// The file.
        path: PathBuf,
        /// Its mode.
        mode: u32,
    },
    /// Somebody else could have put it there.
    #[error("{path} belongs to user {owner}: `chown {user} {path}`, if the key is yours", path = .path.display())]
    Owner {
        /// The file.
        path: PathBuf,
        /// Whose it is.
        owner: u32,
        /// Who reads it.
        user: u32,
    },
    /// It is a folder, a device, a pipe.
    #[error("{path} is no ordinary file", path = .path.display())]
    Kind {
        /// The file.
        path: PathBuf,
    },
    /// It holds something else.
    #[error("{path} holds no key: {KEY_BYTES} bytes as {digits} hexadecimal digits belong there", path = .path.display(), digits = 2 * KEY_BYTES)]
    Content {
        /// The file.
        path: PathBuf,
    },
}

/// Reads a key.
///
/// # Errors
/// The file is not there, not the reader's own, open to others, or holds something else.
pub fn read(path: &Path) -> Result<Key, KeyError> {
    let failed = |error| KeyError::Read { path: path.to_owned(), error };
    // A pipe would wait for somebody who writes.
    let nowait = rustix::fs::OFlags::NONBLOCK.bits() as i32;
    let file = OpenOptions::new().read(true).custom_flags(nowait).open(path).map_err(failed)?;
    // Of the open file: what its name stands for may change meanwhile.
    let about = file.metadata().map_err(failed)?;
    if !about.is_file() {
        return Err(KeyError::Kind { path: path.to_owned() });
    }
    if about.mode() & OTHERS != 0 {
        return Err(KeyError::Mode { path: path.to_owned(), mode: about.mode() & 0o7777 });
    }
    let user = rustix::process::geteuid().as_raw();
    if about.uid() != user && about.uid() != 0 {
        return Err(KeyError::Owner { path: path.to_owned(), owner: about.uid(), user });
    }
    let mut text = String::new();
    let wrong = || KeyError::Content { path: path.to_owned() };
    file.take(LONGEST).read_to_string(&mut text).map_err(|error| match error.kind() {
        io::ErrorKind::InvalidData => wrong(),
        _ => failed(error),
    })?;
    parse(text.trim()).ok_or_else(wrong)
}

fn parse(text: &str) -> Option<Key> {
    let digits = text.as_bytes();
    if digits.len() != 2 * KEY_BYTES {
        return None;
    }
    let mut key = [0; KEY_BYTES];
    for (byte, pair) in key.iter_mut().zip(digits.chunks_exact(2)) {
        let digit = |place: usize| char::from(*pair.get(place)?).to_digit(16);
        *byte = u8::try_from(digit(0)? * 16 + digit(1)?).ok()?;
    }
    // What stands for no key must never be one.
    (key != [0; KEY_BYTES]).then_some(Key(key))
}

/// Makes a key of the kernel's random numbers. A file that is there already is left alone.
///
/// # Errors
/// The file can not be made.
pub fn make(path: &Path) -> io::Result<()> {
    let mut file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path)?;
    write_new(&mut file)
}

/// Makes one in memory, without a name: the kernel removes it with the last process that holds it. Others of the same user
/// read it at `/proc/PID/fd/NUMBER`.
///
/// # Errors
/// There is no memory for it.
pub fn make_in_memory() -> io::Result<File> {
    let mut file = File::from(memfd_create("key", MemfdFlags::CLOEXEC)?);
    fchmod(&file, Mode::RUSR | Mode::WUSR)?;
    write_new(&mut file)?;
    Ok(file)
}

fn write_new(file: &mut File) -> io::Result<()> {
    let mut bytes = [0_u8; KEY_BYTES];
    File::open("/dev/urandom")?.read_exact(&mut bytes)?;
    let text: String = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    writeln!(file, "{text}")
}

#[cfg(test)]
mod tests {
    use std::os::fd::AsRawFd;
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    fn written(text: &str, mode: u32) -> (tempfile::TempDir, PathBuf) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bus.key");
        std::fs::write(&path, text).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(mode)).unwrap();
        (folder, path)
    }

    #[test]
    fn a_key_that_was_made_is_read_and_two_differ() {
        let folder = tempfile::tempdir().unwrap();
        let (one, other) = (folder.path().join("one"), folder.path().join("other"));
        make(&one).unwrap();
        make(&other).unwrap();
        assert_ne!(read(&one).unwrap(), read(&other).unwrap());
        assert!(make(&one).is_err(), "a key is not written over");
    }

    #[test]
    fn a_key_in_memory_is_read_by_its_descriptor_and_gone_with_it() {
        let key = make_in_memory().unwrap();
        let path = PathBuf::from(format!("/proc/{}/fd/{}", std::process::id(), key.as_raw_fd()));
        assert!(read(&path).unwrap() != Key::none());
        drop(key);
        assert!(matches!(read(&path), Err(KeyError::Read { .. })));
    }

    #[test]
    fn a_key_that_others_can_read_is_refused_with_the_mend() {
        let (_folder, path) = written(&"5a".repeat(32), 0o640);
        let text = read(&path).unwrap_err().to_string();
        assert!(text.contains("0640") && text.contains("chmod 600"), "{text}");
    }

    #[test]
    fn what_is_no_key_is_refused() {
        for text in [
            "".into(),
            "5a".repeat(31),
            "5a".repeat(33),
            "5a".repeat(100),
            "zz".repeat(32),
            "00".repeat(32),
            "ä".repeat(32),
        ] {
            let (_folder, path) = written(&text, 0o600);
            assert!(matches!(read(&path), Err(KeyError::Content { .. })), "{text}");
        }
        let (_folder, path) = written(&format!("{}\n", "5A".repeat(32)), 0o400);
        assert!(read(&path).is_ok());
    }

    #[test]
    fn pipe_or_folder_in_the_place_of_a_key_is_refused_and_not_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        let mode = rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR;
        rustix::fs::mknodat(rustix::fs::CWD, &pipe, rustix::fs::FileType::Fifo, mode, 0).unwrap();
        for path in [pipe.as_path(), folder.path()] {
            assert!(matches!(read(path), Err(KeyError::Kind { .. })), "{}", path.display());
        }
    }

    #[test]
    fn a_key_is_never_printed() {
        let (_folder, path) = written(&"5a".repeat(32), 0o600);
        assert_eq!(format!("{:?}", read(&path).unwrap()), "Key(…)");
    }
}
