//! Removing what a partition may have made: trees of any depth, with any modes and names, while somebody may still change them.
//!
//! Everything is opened relative to its folder and no symbolic link is followed, so nothing outside of the tree is ever touched. A few
//! levels are descended; what lies deeper is moved up into the top of the tree and removed from there. So a removal needs
//! a few descriptors more than the levels that it descends, however deep the tree is. It says what it could not remove.

use std::ffi::{CStr, CString, OsStr};
use std::io;
use std::os::fd::{AsFd, AsRawFd, BorrowedFd, OwnedFd};
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use rustix::fs::{AtFlags, CWD, Dir, FileType, Mode, OFlags, RawDir, RenameFlags, Stat};
use rustix::io::Errno;

/// Levels that are descended before what lies deeper is moved up.
const LEVELS: u32 = 8;
/// Names that are read from a folder before they are removed.
const BATCH: usize = 1024;
/// A removal that takes longer is given up: somebody makes files faster than they can be removed.
const PATIENCE: Duration = Duration::from_secs(60);
/// What is moved up is called so, with a number behind it.
const MOVED: &str = "moved-up-";
/// Mode of a folder that its owner can empty.
const USABLE: u32 = 0o700;

/// Something that could not be removed.
#[derive(Debug, thiserror::Error)]
#[error("{} can not be removed: {why}", .path.display())]
pub struct NotRemoved {
    /// Where it is.
    pub path: PathBuf,
    /// Why.
    pub why: io::Error,
}

/// Removes what is called `path`, with everything in it. Nothing is there: that is no error.
///
/// # Errors
/// The first thing that could not be removed. The rest is.
pub fn remove(path: &Path) -> Result<(), NotRemoved> {
    let failed = |why: io::Error| NotRemoved { path: path.to_owned(), why };
    let (Some(above), Some(name)) = (path.parent(), path.file_name()) else {
        return Err(failed(io::ErrorKind::InvalidInput.into()));
    };
    let above = match Folder::open(above) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
        folder => folder.map_err(failed)?,
    };
    above.remove(&CString::new(name.as_bytes()).map_err(|error| failed(error.into()))?)
}

/// Moves what is called `path`, a folder of any mode or something else, to the unused place `aside` on the same file system.
///
/// # Errors
/// The kernel refused it.
pub fn put_aside(path: &Path, aside: &Path) -> io::Result<()> {
    let rename = || rustix::fs::renameat_with(CWD, path, CWD, aside, RenameFlags::NOREPLACE);
    match rename() {
        Err(Errno::ACCESS) => {}
        renamed => return Ok(renamed?),
    }
    // It holds the entry `..`, which is changed: that must be allowed.
    let (above, name) = (path.parent().unwrap_or(path), path.file_name().unwrap_or_default());
    Folder::open(above)?.set_mode(&CString::new(name.as_bytes())?, USABLE)?;
    Ok(rename()?)
}

/// An open folder.
#[derive(Debug)]
pub struct Folder {
    descriptor: OwnedFd,
    path: PathBuf,
}

/// A name in a folder, and what it names.
#[derive(Debug)]
pub struct Entry {
    /// The name.
    pub name: CString,
    /// What it names; a symbolic link itself.
    pub about: Stat,
}

impl Entry {
    /// The name as text; what is no text is replaced.
    #[must_use]
    pub fn text(&self) -> String {
        self.name.to_string_lossy().into_owned()
    }

    /// Whether it is a folder.
    #[must_use]
    pub fn is_folder(&self) -> bool {
        FileType::from_raw_mode(self.about.st_mode) == FileType::Directory
    }
}

impl Folder {
    /// Opens it as it is.
    ///
    /// # Errors
    /// It is none, or a symbolic link, or can not be read.
    pub fn open(path: &Path) -> io::Result<Self> {
        Ok(Self { descriptor: rustix::fs::open(path, FOLDER, Mode::empty())?, path: path.to_owned() })
    }

    /// As above, of one in it.
    ///
    /// # Errors
    /// As above.
    pub fn inner(&self, name: &CStr) -> io::Result<Self> {
        let descriptor = rustix::fs::openat(&self.descriptor, name, FOLDER, Mode::empty())?;
        Ok(Self { descriptor, path: self.path_of(name) })
    }

    /// Everything in it; what is removed meanwhile is left out.
    ///
    /// # Errors
    /// It can not be read.
    pub fn entries(&self) -> io::Result<Vec<Entry>> {
        let mut entries = Vec::new();
        for entry in Dir::read_from(&self.descriptor)? {
            let name = entry?.file_name().to_owned();
            if is_dots(&name) {
                continue;
            }
            if let Ok(about) = rustix::fs::statat(&self.descriptor, &name, AtFlags::SYMLINK_NOFOLLOW) {
                entries.push(Entry { name, about });
            }
        }
        Ok(entries)
    }

    /// Sets the mode of a file or folder in it, and of nothing that a symbolic link points to.
    ///
    /// # Errors
    /// It is not this user's.
    pub fn set_mode(&self, name: &CStr, mode: u32) -> io::Result<()> {
        set_mode(self.descriptor.as_fd(), name, mode).map_err(Into::into)
    }

    /// Removes what is called `name` in it, with everything below. Nothing is there: that is no error.
    ///
    /// # Errors
    /// The first thing that could not be removed. The rest is.
    pub fn remove(&self, name: &CStr) -> Result<(), NotRemoved> {
        let failed = |why: Errno| NotRemoved { path: self.path_of(name), why: why.into() };
        if remove_simple(self.descriptor.as_fd(), name).map_err(failed)? {
            return Ok(());
        }
        let descriptor = open_usable(self.descriptor.as_fd(), name).map_err(failed)?;
        let top = Self { descriptor, path: self.path_of(name) };
        let mut removal =
            Removal { top: &top, moved: 0, waiting: Vec::new(), until: Instant::now() + PATIENCE };
        let emptied = removal.run();
        match rustix::fs::unlinkat(&self.descriptor, name, AtFlags::REMOVEDIR) {
            Ok(()) | Err(Errno::NOENT) => Ok(()),
            Err(error) => emptied.and_then(|()| Err(failed(error))),
        }
    }

    /// It could not be emptied.
    #[must_use]
    pub fn not_removed(&self, why: io::Error) -> NotRemoved {
        NotRemoved { path: self.path.clone(), why }
    }

    fn path_of(&self, name: &CStr) -> PathBuf {
        self.path.join(OsStr::from_bytes(name.to_bytes()))
    }
}

/// How folders are opened.
const FOLDER: OFlags = OFlags::RDONLY.union(OFlags::DIRECTORY).union(OFlags::NOFOLLOW).union(OFlags::CLOEXEC);

/// A removal under way.
struct Removal<'a> {
    top: &'a Folder,
    /// Folders that were moved up so far.
    moved: u64,
    /// Those of them that still have to be removed.
    waiting: Vec<CString>,
    until: Instant,
}

impl Removal<'_> {
    /// Empties the top.
    fn run(&mut self) -> Result<(), NotRemoved> {
        let top = self.top.descriptor.as_fd();
        let mut first = self.empty(top, LEVELS);
        while let Some(name) = self.waiting.pop() {
            let removed = self.remove(top, &name, LEVELS);
            first = first.and(removed.map(drop));
        }
        first
    }

    /// Removes everything in `folder`.
    fn empty(&mut self, folder: BorrowedFd<'_>, levels: u32) -> Result<(), NotRemoved> {
        loop {
            let names = first_names(folder).map_err(|why| self.failed(c".", why))?;
            let (mut first, mut progress) = (Ok(()), false);
            for name in &names {
                match self.remove(folder, name, levels) {
                    Ok(()) => progress = true,
                    Err(error) => first = first.and(Err(error)),
                }
            }
            if !progress {
                return first; // nothing is left, or nothing that can be removed
            }
            if Instant::now() > self.until {
                return first.and(Err(self.failed(c".", Errno::TIMEDOUT)));
            }
        }
    }

    /// Removes `name` from `folder`, or moves it up.
    fn remove(&mut self, folder: BorrowedFd<'_>, name: &CStr, levels: u32) -> Result<(), NotRemoved> {
        if remove_simple(folder, name).map_err(|why| self.failed(name, why))? {
            return Ok(());
        }
        if levels == 0 {
            return self.move_up(folder, name).map_err(|why| self.failed(name, why));
        }
        let inner = open_usable(folder, name).map_err(|why| self.failed(name, why))?;
        let emptied = self.empty(inner.as_fd(), levels - 1);
        drop(inner);
        match rustix::fs::unlinkat(folder, name, AtFlags::REMOVEDIR) {
            Ok(()) | Err(Errno::NOENT) => Ok(()),
            Err(why) => emptied.and_then(|()| Err(self.failed(name, why))),
        }
    }

    /// Moves a folder into the top, where it waits.
    fn move_up(&mut self, folder: BorrowedFd<'_>, name: &CStr) -> Result<(), Errno> {
        loop {
            self.moved += 1;
            let number = format!("{MOVED}{}", self.moved);
            let Ok(place) = CString::new(number) else { return Err(Errno::INVAL) };
            let rename = || {
                rustix::fs::renameat_with(folder, name, &self.top.descriptor, &place, RenameFlags::NOREPLACE)
            };
            let renamed = match rename() {
                // It holds the entry `..`, which is changed: that must be allowed.
                Err(Errno::ACCESS) => set_mode(folder, name, USABLE).and_then(|()| rename()),
                renamed => renamed,
            };
            match renamed {
                Err(Errno::EXIST) if Instant::now() < self.until => {}
                Err(Errno::NOENT) => return Ok(()),
                Ok(()) => {
                    self.waiting.push(place);
                    return Ok(());
                }
                Err(error) => return Err(error),
            }
        }
    }

    fn failed(&self, name: &CStr, why: Errno) -> NotRemoved {
        NotRemoved { path: self.top.path_of(name), why: why.into() }
    }
}

/// Removes what is no folder, or an empty one; false: it is a folder with something in it.
fn remove_simple(folder: BorrowedFd<'_>, name: &CStr) -> Result<bool, Errno> {
    match rustix::fs::unlinkat(folder, name, AtFlags::empty()) {
        Ok(()) | Err(Errno::NOENT) => return Ok(true),
        Err(Errno::ISDIR | Errno::PERM) => {}
        Err(error) => return Err(error),
    }
    match rustix::fs::unlinkat(folder, name, AtFlags::REMOVEDIR) {
        Ok(()) | Err(Errno::NOENT) => Ok(true),
        Err(Errno::NOTEMPTY | Errno::EXIST) => Ok(false),
        Err(error) => Err(error),
    }
}

/// Opens a folder so that it can be emptied, whatever mode its owner has given it.
fn open_usable(folder: BorrowedFd<'_>, name: &CStr) -> Result<OwnedFd, Errno> {
    let open = || rustix::fs::openat(folder, name, FOLDER, Mode::empty());
    let opened = match open() {
        Err(Errno::ACCESS) => {
            set_mode(folder, name, USABLE)?;
            open()?
        }
        opened => opened?,
    };
    if rustix::fs::fstat(&opened)?.st_mode & USABLE != USABLE {
        let _ = rustix::fs::fchmod(&opened, Mode::from_raw_mode(USABLE)); // another user's: whoever may remove it needs none
    }
    Ok(opened)
}

/// `fchmodat` follows symbolic links: so what the name means is held first.
fn set_mode(folder: BorrowedFd<'_>, name: &CStr, mode: u32) -> Result<(), Errno> {
    let held =
        rustix::fs::openat(folder, name, OFlags::PATH | OFlags::NOFOLLOW | OFlags::CLOEXEC, Mode::empty())?;
    if FileType::from_raw_mode(rustix::fs::fstat(&held)?.st_mode) == FileType::Symlink {
        return Err(Errno::LOOP);
    }
    let path = format!("/proc/self/fd/{}", held.as_raw_fd());
    rustix::fs::chmodat(CWD, path, Mode::from_raw_mode(mode), AtFlags::empty())
}

/// The first names in a folder. Read by its own descriptor, which therefore stands at its end afterwards.
fn first_names(folder: BorrowedFd<'_>) -> Result<Vec<CString>, Errno> {
    rustix::fs::seek(folder, rustix::fs::SeekFrom::Start(0))?;
    let mut buffer = [std::mem::MaybeUninit::uninit(); 4096];
    let mut entries = RawDir::new(folder, &mut buffer);
    let mut names = Vec::new();
    while let Some(entry) = entries.next() {
        let name = entry?.file_name().to_owned();
        if !is_dots(&name) {
            names.push(name);
        }
        if names.len() == BATCH {
            break;
        }
    }
    Ok(names)
}

fn is_dots(name: &CStr) -> bool {
    [c".", c".."].contains(&name)
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::os::unix::fs::PermissionsExt;
    use std::process::Command;

    use super::*;

    /// A test that runs in a process of its own: with few descriptors, and as an ordinary user where `user` says so.
    fn apart(test: &str, user: bool, works_in: &Path) {
        let name = format!("tree::tests::{test}");
        let own = std::env::current_exe().unwrap();
        let mut command = Command::new("prlimit");
        command.args(["--nofile=64:64", "--stack=1048576:1048576", "--"]);
        if user && rustix::process::geteuid().is_root() {
            command.args(["setpriv", "--reuid=61654", "--regid=61654", "--clear-groups", "--"]);
        }
        // A folder on the way to the program may be closed to that user.
        let place = tempfile::tempdir_in("/dev/shm").unwrap();
        let program = place.path().join("test");
        fs::copy(own, &program).unwrap();
        fs::set_permissions(place.path(), fs::Permissions::from_mode(0o777)).unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
        command.arg(program).args(["--ignored", "--exact", "--nocapture", &name]).env(PLACE, works_in);
        let output = command.current_dir("/").output().unwrap();
        let said =
            String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && said.contains("1 passed"), "{said}");
    }

    /// Where everybody may make folders.
    fn open_to_all() -> PathBuf {
        "/dev/shm".into()
    }

    /// Names the folder in which a test of [`apart`] works.
    const PLACE: &str = "BATELEUR_TREE_TEST";

    fn place() -> tempfile::TempDir {
        let place = std::env::var_os(PLACE).map_or_else(|| "/dev/shm".into(), PathBuf::from);
        tempfile::tempdir_in(place).unwrap()
    }

    /// Folders in each other below `top`, made as a partition would that has few descriptors; the innermost one.
    fn nest(top: &Path, depth: usize, name: &str, mode: u32) -> OwnedFd {
        let mut inner = rustix::fs::open(top, FOLDER, Mode::empty()).unwrap();
        let mut all = Vec::new();
        for _ in 0..depth {
            rustix::fs::mkdirat(&inner, name, Mode::from_raw_mode(0o700)).unwrap();
            let next = rustix::fs::openat(&inner, name, FOLDER, Mode::empty()).unwrap();
            // Its own mode only when nothing is to be made in it any more.
            all.push(std::mem::replace(&mut inner, next));
            if all.len() > 2 {
                rustix::fs::fchmod(all.remove(1), Mode::from_raw_mode(mode)).unwrap();
            }
        }
        inner
    }

    #[test]
    fn deep_trees_are_removed_with_few_descriptors() {
        apart("deep_trees", false, &open_to_all());
        apart("deep_trees", true, &open_to_all());
    }

    #[test]
    #[ignore = "run by the test above, in a process of its own"]
    fn deep_trees() {
        for (depth, mode) in [(1500, 0), (20_000, 0), (1500, 0o500), (40, 0o700)] {
            let folder = place();
            let top = folder.path().join("top");
            fs::create_dir(&top).unwrap();
            let innermost = nest(&top, depth, &"n".repeat(255), mode);
            rustix::fs::openat(&innermost, "file", OFlags::CREATE | OFlags::WRONLY, Mode::empty()).unwrap();
            drop(innermost);
            remove(&top).unwrap();
            assert!(!top.exists(), "{depth} folders of mode {mode:o}");
        }
    }

    #[test]
    fn what_links_point_to_stays_as_it_is() {
        apart("links", false, &open_to_all());
        apart("links", true, &open_to_all());
    }

    #[test]
    #[ignore = "run by the test above, in a process of its own"]
    fn links() {
        let folder = place();
        let (outside, top) = (folder.path().join("outside"), folder.path().join("top"));
        fs::create_dir(&outside).unwrap();
        fs::write(outside.join("file"), "kept").unwrap();
        fs::set_permissions(outside.join("file"), fs::Permissions::from_mode(0o400)).unwrap();
        fs::create_dir_all(top.join("inner")).unwrap();
        for place in [&top, &top.join("inner")] {
            std::os::unix::fs::symlink(&outside, place.join("folder")).unwrap();
            std::os::unix::fs::symlink(outside.join("file"), place.join("link")).unwrap();
            fs::hard_link(outside.join("file"), place.join("hard")).unwrap();
        }
        let opened = Folder::open(&top).unwrap();
        assert!(opened.set_mode(c"link", 0).is_err() && opened.inner(c"folder").is_err());
        fs::set_permissions(top.join("inner"), fs::Permissions::from_mode(0o0)).unwrap();
        remove(&top).unwrap();
        assert!(!top.exists());
        assert_eq!(fs::read_to_string(outside.join("file")).unwrap(), "kept");
        assert_eq!(outside.join("file").metadata().unwrap().permissions().mode() & 0o777, 0o400);
        // A link in place of the tree itself.
        std::os::unix::fs::symlink(&outside, &top).unwrap();
        remove(&top).unwrap();
        assert!(!top.is_symlink() && outside.join("file").exists());
        remove(&top).unwrap(); // nothing is there
    }

    #[test]
    fn random_trees_are_removed() {
        apart("random_trees", false, &open_to_all());
        apart("random_trees", true, &open_to_all());
    }

    #[test]
    #[ignore = "run by the test above, in a process of its own"]
    fn random_trees() {
        for seed in 1..=30_u64 {
            let folder = place();
            let top = folder.path().join("top");
            fs::create_dir(&top).unwrap();
            grow(&top, seed);
            remove(&top).unwrap_or_else(|error| panic!("seed {seed}: {error}"));
            assert!(!top.exists(), "seed {seed}");
        }
    }

    /// Makes a random tree.
    fn grow(top: &Path, seed: u64) {
        let mut state = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let mut random = |below: usize| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as usize % below
        };
        let mut folders = vec![top.to_owned()];
        let mut modes = Vec::new();
        for number in 0..random(3000) {
            let above = folders[folders.len() - 1 - random(folders.len().min(4))].clone();
            let name = match random(5) {
                0 => format!("{MOVED}{}", random(40)),
                1 => format!("{number}{}", "x".repeat(200)),
                2 => format!("{number}\n\u{1f4a5} "),
                _ => number.to_string(),
            };
            let path = above.join(name);
            if path.as_os_str().len() > 3800 || path.symlink_metadata().is_ok() {
                folders = vec![top.to_owned()]; // deeper than a path can say: the test above
                continue;
            }
            match random(6) {
                0 | 1 => {
                    fs::create_dir(&path).unwrap();
                    folders.push(path.clone());
                    modes.push((path, random(0o1000) as u32));
                }
                2 => std::os::unix::fs::symlink("/", &path).unwrap(),
                3 => rustix::fs::mkfifoat(CWD, &path, Mode::empty()).unwrap(),
                4 => drop(std::os::unix::net::UnixListener::bind(&path)), // refused where the path is long
                _ => fs::write(&path, "").unwrap(),
            }
        }
        for (path, mode) in modes.into_iter().rev() {
            fs::set_permissions(path, fs::Permissions::from_mode(mode)).unwrap();
        }
    }

    #[test]
    fn what_can_not_be_removed_is_named_and_everything_else_is_removed() {
        if !rustix::process::geteuid().is_root() {
            return eprintln!("skipped: only root can make what an ordinary user can not remove");
        }
        let place = tempfile::tempdir_in("/dev/shm").unwrap();
        for folder in ["a", "theirs/inner", "z"] {
            fs::create_dir_all(place.path().join("top").join(folder)).unwrap();
            fs::write(place.path().join("top").join(folder).join("file"), "").unwrap();
        }
        for own in ["top", "top/a", "top/z", "top/a/file", "top/z/file"] {
            std::os::unix::fs::chown(place.path().join(own), Some(61_654), Some(61_654)).unwrap();
        }
        fs::set_permissions(place.path(), fs::Permissions::from_mode(0o777)).unwrap();
        apart("strangers", true, place.path());
        assert!(place.path().join("top/theirs/inner/file").exists());
        assert_eq!(fs::read_dir(place.path().join("top")).unwrap().count(), 1);
    }

    #[test]
    #[ignore = "run by the test above, in a process of its own"]
    fn strangers() {
        let place = PathBuf::from(std::env::var_os(PLACE).unwrap());
        let error = remove(&place.join("top")).unwrap_err().to_string();
        assert!(error.contains("can not be removed") && error.contains("Permission denied"), "{error}");
    }

    #[test]
    fn many_files_are_removed_while_somebody_makes_more() {
        let folder = place();
        let top = folder.path().join("top");
        fs::create_dir(&top).unwrap();
        for number in 0..10_000 {
            fs::write(top.join(number.to_string()), "").unwrap();
        }
        let adds = top.clone();
        let other = std::thread::spawn(move || {
            (0..20_000).filter(|number| fs::write(adds.join(format!("more-{number}")), "").is_ok()).count()
        });
        while remove(&top).is_err() {}
        other.join().unwrap();
        assert!(!top.exists());
    }
}
