//! The texts in a folder.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use crate::bounds;
use crate::catalogue::Source;

/// How a type's file ends.
const ENDING: &str = "msg";

/// The texts of `folder`, by their names: `Name.msg` is the type `Name`, `package/Name.msg` and `package/msg/Name.msg` are the type
/// `package/Name`. Other files are passed over.
///
/// # Errors
/// A file or a folder that can not be read, or more of them than a catalogue takes; with its path.
pub fn sources(folder: &Path) -> std::io::Result<Vec<Source>> {
    let mut sources = Vec::new();
    for entry in entries(folder)? {
        if entry.is_dir() {
            let package = name_of(&entry);
            for inner in entries(&entry)? {
                let files =
                    if inner.is_dir() && name_of(&inner) == ENDING { entries(&inner)? } else { vec![inner] };
                files.iter().try_for_each(|file| add(file, &package, &mut sources))?;
            }
        } else {
            add(&entry, "", &mut sources)?;
        }
    }
    sources.sort_by(|one, other| one.name.cmp(&other.name));
    Ok(sources)
}

fn add(path: &Path, package: &str, sources: &mut Vec<Source>) -> std::io::Result<()> {
    if path.extension().is_none_or(|ending| ending != ENDING) || !path.is_file() {
        return Ok(());
    }
    let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned()).unwrap_or_default();
    let name = if package.is_empty() { stem } else { format!("{package}/{stem}") };
    let mut bytes = Vec::new();
    // One more shows that there is more, which the catalogue refuses.
    let file = std::fs::File::open(path).map_err(|error| of(path, &error))?;
    file.take(bounds::FILE_BYTES as u64 + 1).read_to_end(&mut bytes).map_err(|error| of(path, &error))?;
    let text =
        String::from_utf8(bytes).map_err(|_| of(path, &std::io::Error::other("it is not UTF-8 text")))?;
    sources.push(Source { name, file: path.display().to_string(), text });
    Ok(())
}

fn entries(folder: &Path) -> std::io::Result<Vec<PathBuf>> {
    let listed = std::fs::read_dir(folder).map_err(|error| of(folder, &error))?;
    let mut paths = Vec::new();
    for entry in listed {
        paths.push(entry.map_err(|error| of(folder, &error))?.path());
        if paths.len() > bounds::TYPES {
            let many = format!("it has more than {} entries", bounds::TYPES);
            return Err(of(folder, &std::io::Error::other(many)));
        }
    }
    paths.sort();
    Ok(paths)
}

fn name_of(path: &Path) -> String {
    path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default()
}

fn of(path: &Path, error: &std::io::Error) -> std::io::Error {
    std::io::Error::new(error.kind(), format!("{}: {error}", path.display()))
}
