//! A package as a tree of files, and the archive that `dpkg-deb` makes of it.

use std::fs::{self, Permissions};
use std::os::unix::fs::{MetadataExt, PermissionsExt, symlink};
use std::path::{Path, PathBuf};
use std::process::Command;

use super::{Order, make_folder, succeed, words_of};

/// MB: of the archive, and of what it installs.
pub(super) type Sizes = (f64, f64);

/// A package that is being laid out.
pub(super) struct Tree {
    root: PathBuf,
    /// The head of `control`: name, section, dependencies, description.
    pub(super) control: String,
}

impl Tree {
    pub(super) fn new(root: &Path) -> Result<Self, String> {
        if root.exists() {
            fs::remove_dir_all(root).map_err(|error| format!("cannot empty {}: {error}", root.display()))?;
        }
        make_folder(root)?;
        Ok(Self { root: root.to_owned(), control: String::new() })
    }

    /// Where a path of the package lies, in a folder that is there.
    pub(super) fn place(&self, path: &str) -> Result<PathBuf, String> {
        let place = self.root.join(path.trim_start_matches('/'));
        place.parent().map_or(Ok(()), make_folder)?;
        Ok(place)
    }

    pub(super) fn text(&self, path: &str, text: &str) -> Result<PathBuf, String> {
        let place = self.place(path)?;
        fs::write(&place, text).map_err(|error| format!("cannot write {}: {error}", place.display()))?;
        Ok(place)
    }

    /// A script that runs as a program.
    pub(super) fn script(&self, path: &str, text: &str) -> Result<(), String> {
        executable(&self.text(path, text)?)
    }

    pub(super) fn copy(&self, from: &Path, path: &str) -> Result<PathBuf, String> {
        let place = self.place(path)?;
        fs::copy(from, &place).map_err(|error| format!("cannot copy {}: {error}", from.display()))?;
        fs::set_permissions(&place, Permissions::from_mode(0o644)).map_err(|error| error.to_string())?;
        Ok(place)
    }

    /// A program, without what only debuggers read.
    pub(super) fn program(&self, order: &Order<'_>, name: &str, path: &str) -> Result<(), String> {
        let built = order.programs.join(name);
        if !built.is_file() {
            return Err(format!(
                "there is no {}: `cargo build --release --workspace --bins` makes all programs",
                built.display()
            ));
        }
        let place = self.copy(&built, path)?;
        strip(order, &place, "--strip-all")?;
        executable(&place)
    }

    /// A folder's files and those below it.
    pub(super) fn folder(&self, from: &Path, path: &str) -> Result<(), String> {
        let cannot = |error| format!("cannot read {}: {error}", from.display());
        for entry in fs::read_dir(from).map_err(cannot)? {
            let entry = entry.map_err(cannot)?.path();
            let name = entry.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let inner = format!("{path}/{name}");
            match entry.is_dir() {
                true if name == "target" => {}
                true => self.folder(&entry, &inner)?,
                false => drop(self.copy(&entry, &inner)?),
            }
        }
        Ok(())
    }

    /// Another name of the same file.
    pub(super) fn same(&self, path: &str, other: &str) -> Result<(), String> {
        let (from, to) = (self.place(path)?, self.place(other)?);
        fs::hard_link(&from, &to).map_err(|error| format!("cannot link {}: {error}", to.display()))
    }

    pub(super) fn link(&self, path: &str, to: &str) -> Result<(), String> {
        let place = self.place(path)?;
        symlink(to, &place).map_err(|error| format!("cannot link {}: {error}", place.display()))
    }

    /// Packed as Debian wants manuals and lists of changes: without name and time.
    pub(super) fn pressed(&self, path: &str, text: &str) -> Result<(), String> {
        let place = self.text(path, text)?;
        succeed(Command::new("gzip").args(["-9", "--no-name", "--force"]).arg(&place))
    }

    /// What the package's texts in `/usr/share/doc` are: the licences, and that it is a package.
    pub(super) fn documents(&self, order: &Order<'_>, name: &str, licences: &str) -> Result<(), String> {
        let date =
            words_of(Command::new("date").args(["--utc", "-R", "-d"]).arg(format!("@{}", order.time)))?;
        let changes = format!(
            "{name} ({}) unstable; urgency=medium\n\n  * Packed from the commit of that time.\n\n -- {MAINTAINER}  {}\n",
            order.version,
            date.trim()
        );
        self.pressed(&format!("usr/share/doc/{name}/changelog"), &changes)?;
        self.text(&format!("usr/share/doc/{name}/copyright"), licences).map(drop)
    }

    /// Writes the archive and removes the tree.
    pub(super) fn pack(self, output: &Path, order: &Order<'_>) -> Result<(PathBuf, Sizes), String> {
        let mut files = Vec::new();
        walk(&self.root, &mut files)?;
        files.sort();
        self.write_sums(&files)?;
        let settings: Vec<String> = files
            .iter()
            .filter_map(|path| path.strip_prefix(&self.root).ok())
            .filter(|path| path.starts_with("etc"))
            .map(|path| format!("/{}\n", path.display()))
            .collect();
        if !settings.is_empty() {
            self.text("DEBIAN/conffiles", &settings.concat())?;
        }
        let bytes = installed_bytes(&files)?;
        let name = self.control.lines().find_map(|line| line.strip_prefix("Package: "));
        let name = name.ok_or("a package without a name")?;
        let fixed = format!(
            "Version: {}\nArchitecture: {}\nMaintainer: {MAINTAINER}\nPriority: optional\nInstalled-Size: {}\n",
            order.version,
            order.processor.debian(),
            bytes.div_ceil(1024)
        );
        let control = self.control.replacen('\n', &format!("\n{fixed}"), 1);
        self.text("DEBIAN/control", &control)?;
        let file = output.join(format!("{name}_{}_{}.deb", order.version, order.processor.debian()));
        let mut command = Command::new("dpkg-deb");
        command.env("SOURCE_DATE_EPOCH", order.time);
        command.args(["--root-owner-group", "--threads-max=1"]);
        // dpkg's own variable decides where it is set: a test has no time for a small archive.
        if std::env::var_os("DPKG_DEB_COMPRESSOR_TYPE").is_none() {
            command.args(["-Zxz", "-z3"]);
        }
        command.arg("--build");
        // What it prints is told in one line with the sizes.
        words_of(command.arg(&self.root).arg(&file))
            .map_err(|reason| format!("{reason} (dpkg-deb and xz are on every Debian machine)"))?;
        let archive = fs::metadata(&file).map_err(|error| error.to_string())?.len();
        fs::remove_dir_all(&self.root).map_err(|error| error.to_string())?;
        Ok((file, (archive as f64 / 1e6, bytes as f64 / 1e6)))
    }

    fn write_sums(&self, files: &[PathBuf]) -> Result<(), String> {
        let inner: Vec<&Path> = files
            .iter()
            .filter(|path| !path.is_symlink())
            .filter_map(|path| path.strip_prefix(&self.root).ok())
            .filter(|path| !path.starts_with("DEBIAN"))
            .collect();
        let sums = words_of(Command::new("md5sum").current_dir(&self.root).args(inner))?;
        self.text("DEBIAN/md5sums", &sums).map(drop)
    }
}

/// Who answers for the packages; the project has no public address.
const MAINTAINER: &str = "The Bateleur project <bateleur@example.org>";

pub(super) fn strip(order: &Order<'_>, path: &Path, what: &str) -> Result<(), String> {
    let tool = if order.processor.is_own() {
        "strip".into()
    } else {
        format!("{}-strip", order.processor.triplet())
    };
    let sections = ["--remove-section=.comment", "--remove-section=.note"];
    succeed(Command::new(tool).arg(what).arg("--enable-deterministic-archives").args(sections).arg(path))
}

fn executable(path: &Path) -> Result<(), String> {
    fs::set_permissions(path, Permissions::from_mode(0o755)).map_err(|error| error.to_string())
}

/// All files below a folder, folders with the mode that a package's have, whatever this user's mask is.
fn walk(folder: &Path, files: &mut Vec<PathBuf>) -> Result<(), String> {
    executable(folder)?;
    let cannot = |error| format!("cannot read {}: {error}", folder.display());
    for entry in fs::read_dir(folder).map_err(cannot)? {
        let path = entry.map_err(cannot)?.path();
        match path.is_dir() && !path.is_symlink() {
            true => walk(&path, files)?,
            false => files.push(path),
        }
    }
    Ok(())
}

/// Files that are one count once.
fn installed_bytes(files: &[PathBuf]) -> Result<u64, String> {
    let mut seen = std::collections::BTreeMap::new();
    for path in files {
        let about = fs::symlink_metadata(path).map_err(|error| error.to_string())?;
        seen.insert(about.ino(), about.len());
    }
    Ok(seen.values().sum())
}
