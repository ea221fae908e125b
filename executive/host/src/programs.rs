//! Where programs lie.

use std::io::Read;
use std::path::{Path, PathBuf};

/// Where a partition's program lies: a path counts from the schedule file's `folder`, a name from where this program lies.
#[must_use]
pub fn program_path(program: &str, folder: &Path) -> PathBuf {
    if program.contains('/') { folder.join(program) } else { beside_own(program) }
}

/// What is wrong with a program that is a script: its interpreter is another program, with files of its own, which no partition may
/// open.
#[must_use]
pub fn script(path: &Path) -> Option<String> {
    let mut head = [0; 2];
    std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut head)).ok()?;
    (&head == b"#!").then(|| {
        format!(
            "{} is a script: a partition runs one program that was built for this machine, without an interpreter",
            path.display()
        )
    })
}

/// Where a program of the project lies: beside this one.
#[must_use]
pub fn beside_own(program: &str) -> PathBuf {
    let own = std::env::current_exe().ok();
    own.as_deref().and_then(Path::parent).unwrap_or(Path::new("")).join(program)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn script_is_told_from_a_program() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("program");
        std::fs::write(&path, "#!/bin/sh\n").unwrap();
        assert!(script(&path).unwrap().contains("program is a script"));
        std::fs::write(&path, b"\x7fELF").unwrap();
        assert_eq!(script(&path), None);
        assert_eq!(script(&folder.path().join("nowhere")), None);
    }
}
