//! A guest: a kernel with PREEMPT_RT and every control group controller, in a virtual machine, for what the machine below
//! the tests may lack.
//!
//! Responsible for: packing programs and a script into an initial file system, running it, and handing back what it said.
//! Timings in a guest mean nothing (every instruction is emulated); behaviour does. Prepared by `tests/guest/prepare`.

use std::fs::{self, File};
use std::io::{self, Write};
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::await_some;
use crate::programs::{program, repository};

/// A guest boots in some 6 s and is slower than the machine below by a factor of ten; a whole file of tests takes minutes.
const PATIENCE: Duration = Duration::from_secs(600);
/// Memory of a guest, MiB: the programs lie in it twice, packed and unpacked.
const MEMORY_MIB: u32 = 2048;

/// Where programs lie in a guest, as below `target/release`, so that this project's tests find them there too.
const RELEASE: &str = "flight/release";
/// Kernel modules for a CAN bus without hardware, each after those that it needs.
const CAN: [&str; 4] = ["can-dev", "can", "can-raw", "vcan"];

/// What is put into a guest.
#[derive(Debug, Default)]
pub struct Guest {
    programs: Vec<PathBuf>,
    files: Vec<(String, Vec<u8>)>,
    modules: Vec<&'static str>,
    systemd: bool,
}

/// What a guest's script left.
#[derive(Debug)]
pub struct Said {
    /// Everything that it printed.
    pub text: String,
    /// Its exit code; none: the guest did not come to the script's end.
    pub code: Option<i32>,
}

impl Guest {
    /// A guest with `bateleur`, the nine partitions and the schedule of the flight in `/flight`.
    pub fn of_the_flight() -> Self {
        let programs = crate::NINE.iter().chain(&["bateleur", "simulator"]).map(|name| program(name));
        let schedule = fs::read(repository().join("schedule.toml")).unwrap();
        let files = vec![("schedule.toml".into(), schedule)];
        Self { programs: programs.collect(), files, ..Self::default() }
    }

    /// With another program of this workspace.
    pub fn program(mut self, name: &str) -> Self {
        self.programs.push(program(name));
        self
    }

    /// With the tests of a file in `tests/tests` and the partitions that they start: `./NAME` runs them.
    pub fn tests(mut self, name: &str, partitions: &[&str]) -> Self {
        self.programs.push(test_program(name));
        partitions.iter().fold(self, |guest, partition| guest.program(partition))
    }

    /// With CAN: `cansend`, `candump`, `cangen`, `canplayer` of can-utils, and modules for [`LOAD_CAN`](Self::LOAD_CAN).
    pub fn can(mut self) -> Self {
        self.modules.extend(CAN);
        let tools = repository().join("target/guest/can-utils/usr/bin");
        let tool = |name| {
            let path = tools.join(name);
            assert!(path.is_file(), "there is no {}: run tests/guest/prepare", path.display());
            path
        };
        self.programs.extend(["cansend", "candump", "cangen", "canplayer"].map(tool));
        self
    }

    /// Lines of a script that bring up the bus `vcan0`, which carries classic and FD frames.
    pub const LOAD_CAN: &str = "
        export PATH=$PATH:/flight; for module in can-dev can can-raw vcan; do insmod /modules/$module.ko || exit 8; done
        ip link add dev vcan0 type vcan && ip link set vcan0 mtu 72 && ip link set vcan0 up || exit 8
    ";

    /// With systemd as its first process, and a user `bateleur`: units lie in `/etc/systemd/system`.
    pub fn systemd(self) -> Self {
        Self { systemd: true, ..self }
    }

    /// With a file in `/flight`.
    pub fn file(mut self, name: &str, text: &str) -> Self {
        self.files.push((name.into(), text.into()));
        self
    }

    /// Boots, runs `script` in `/flight` by a shell, and gives what it printed.
    pub fn run(self, script: &str) -> Said {
        let folder = tempfile::Builder::new().prefix("bateleur-guest-").tempdir().unwrap();
        let (disk, output) = (folder.path().join("initrd"), folder.path().join("output"));
        self.pack(&disk, script).unwrap();
        let console = folder.path().join("console");
        let mut machine = Command::new("qemu-system-x86_64")
            .args(["-accel", "tcg,thread=multi", "-smp", "2", "-m"])
            .arg(MEMORY_MIB.to_string())
            .args(["-display", "none", "-no-reboot", "-kernel"])
            .arg(kernel())
            .arg("-initrd")
            .arg(&disk)
            .args(["-append", "console=ttyS0 quiet panic=-1 systemd.unit=script.service", "-serial"])
            .arg(format!("file:{}", console.display()))
            .arg("-serial")
            .arg(format!("file:{}", output.display()))
            .stdin(Stdio::null())
            .spawn()
            .expect("qemu-system-x86_64 is needed: tests/guest/prepare installs it");
        let ended = await_some(PATIENCE, || machine.try_wait().unwrap());
        if ended.is_none() {
            machine.kill().unwrap();
            machine.wait().unwrap();
        }
        let text = String::from_utf8_lossy(&fs::read(&output).unwrap_or_default()).into_owned();
        let (text, code) = match text.rsplit_once("guest-exit ") {
            Some((text, code)) => (text.to_owned(), code.trim().parse().ok()),
            None => (text + &fs::read_to_string(&console).unwrap_or_default(), None),
        };
        Said { text, code }
    }

    /// What this project's tests expect of the folder that they were built in: that it is there, and holds the schedule.
    fn pack_repository(&self, archive: &mut Archive) -> io::Result<()> {
        let root = repository();
        let tests = root.join("tests");
        let mut folders: Vec<&Path> = tests.ancestors().collect();
        folders.reverse();
        for folder in folders {
            let name = folder.to_string_lossy();
            let name = name.trim_start_matches('/');
            if !["", "tmp"].contains(&name) {
                archive.add(name, 0o040_755, &[])?;
            }
        }
        let schedule = root.join("schedule.toml");
        archive.add(schedule.to_string_lossy().trim_start_matches('/'), 0o120_777, b"/flight/schedule.toml")
    }

    fn pack(&self, disk: &Path, script: &str) -> io::Result<()> {
        let mut archive = Archive(io::BufWriter::new(File::create(disk)?), 0);
        match self.systemd {
            true => pack_systemd(&mut archive)?,
            false => pack_plain(&mut archive)?,
        }
        for folder in ["proc", "sys", "dev", "tmp", "flight", "modules"] {
            archive.add(folder, 0o040_755, &[])?;
        }
        archive.add(RELEASE, 0o040_755, &[])?;
        archive.add(&format!("{RELEASE}/deps"), 0o040_755, &[])?;
        self.pack_repository(&mut archive)?;
        archive.add("bin/busybox", 0o100_755, &fs::read("/bin/busybox")?)?;
        archive.add("etc/passwd", 0o100_644, b"root:x:0:0::/:/bin/sh\nbateleur:x:990:990::/:/bin/sh\n")?;
        archive.add("etc/group", 0o100_644, b"root:x:0:\nbateleur:x:990:\n")?;
        archive.add("etc/shadow", 0o100_600, b"root:*:1:0:99999:7:::\n")?;
        archive.add("flight/script", 0o100_755, script.as_bytes())?;
        for (name, bytes) in &self.files {
            archive.add(&format!("flight/{name}"), 0o100_644, bytes)?;
        }
        let mut libraries = Vec::new();
        for path in &self.programs {
            pack_program(&mut archive, path)?;
            libraries.extend(libraries_of(path)?);
        }
        for module in &self.modules {
            archive.add(&format!("modules/{module}.ko"), 0o100_644, &fs::read(kernel_module(module))?)?;
        }
        libraries.sort();
        libraries.dedup();
        for path in libraries {
            let mode = fs::metadata(&path)?.permissions().mode();
            archive.add(path.to_string_lossy().trim_start_matches('/'), mode, &fs::read(&path)?)?;
        }
        archive.end()
    }
}

/// A system whose first process is a shell.
fn pack_plain(archive: &mut Archive) -> io::Result<()> {
    for folder in ["bin", "etc", "lib64", "lib", "lib/x86_64-linux-gnu", "usr", "usr/lib"] {
        archive.add(folder, 0o040_755, &[])?;
    }
    archive.add("init", 0o100_755, include_bytes!("../guest/init"))
}

/// A system whose first process is systemd, as `tests/guest/prepare` unpacked it.
fn pack_systemd(archive: &mut Archive) -> io::Result<()> {
    let tree = repository().join("target/guest/systemd");
    assert!(tree.is_dir(), "there is no {}: run tests/guest/prepare", tree.display());
    pack_tree(archive, &tree, &tree)?;
    for folder in ["flight", "flight/bin", "run", "var", "var/lib", "opt"] {
        archive.add(folder, 0o040_755, &[])?;
    }
    archive.add("init", 0o120_777, b"/lib/systemd/systemd")?;
    // Without a number the first start asks questions.
    archive.add("etc/machine-id", 0o100_444, b"b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0b0\n")?;
    archive.add("etc/nsswitch.conf", 0o100_644, b"passwd: files\ngroup: files\n")?;
    archive.add("bin/sh", 0o120_777, b"busybox")?;
    archive.add("flight/begin", 0o100_644, include_bytes!("../guest/begin"))?;
    archive.add("etc/systemd/system/script.service", 0o100_644, include_bytes!("../guest/script.service"))
}

/// Everything below `folder`, by its path below `root`, each folder before what is in it.
fn pack_tree(archive: &mut Archive, root: &Path, folder: &Path) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let name = path.strip_prefix(root).unwrap_or(&path).to_string_lossy().into_owned();
        let about = fs::symlink_metadata(&path)?;
        if about.is_dir() {
            archive.add(&name, about.permissions().mode(), &[])?;
            pack_tree(archive, root, &path)?;
        } else if about.is_symlink() {
            archive.add(&name, about.permissions().mode(), fs::read_link(&path)?.as_os_str().as_bytes())?;
        } else if about.is_file() {
            archive.add(&name, about.permissions().mode(), &fs::read(&path)?)?;
        }
    }
    Ok(())
}

/// A program, without what only a debugger reads, and beside the schedule a link to it.
fn pack_program(archive: &mut Archive, path: &Path) -> io::Result<()> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let own = path.parent().is_some_and(|folder| folder.ends_with("deps"));
    let place = if own { format!("release/deps/{name}") } else { format!("release/{name}") };
    let slim = tempfile::NamedTempFile::new()?;
    let stripped = Command::new("strip").arg("--strip-debug").arg("-o").arg(slim.path()).arg(path).status();
    let whole = !stripped.is_ok_and(|status| status.success()); // a guest with more memory would hold it too
    archive.add(&format!("flight/{place}"), 0o100_755, &fs::read(if whole { path } else { slim.path() })?)?;
    // A test program's name ends with a number of the compiler's.
    let short = if own { name.rsplit_once('-').map_or(&*name, |(short, _)| short) } else { &name };
    archive.add(&format!("flight/{short}"), 0o120_777, place.as_bytes())
}

/// The newest build of the tests of a file in `tests/tests`.
fn test_program(name: &str) -> PathBuf {
    let own = std::env::current_exe().unwrap();
    let beside = fs::read_dir(own.parent().unwrap()).unwrap().flatten().map(|entry| entry.path());
    let is_it = |path: &PathBuf| {
        let file = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let number = file.strip_prefix(name).and_then(|rest| rest.strip_prefix('-'));
        number.is_some_and(|number| number.len() == 16 && number.bytes().all(|byte| byte.is_ascii_hexdigit()))
    };
    let built = |path: &PathBuf| fs::metadata(path).and_then(|data| data.modified()).ok();
    let newest = beside.filter(is_it).max_by_key(built);
    newest.unwrap_or_else(|| {
        panic!("the tests of {name} are not built: cargo test --release --no-run --workspace")
    })
}

/// A module that `tests/guest/prepare` unpacked.
fn kernel_module(name: &str) -> PathBuf {
    let path = repository().join(format!("target/guest/modules/{name}.ko"));
    assert!(path.is_file(), "there is no {}: run tests/guest/prepare", path.display());
    path
}

/// The kernel that `tests/guest/prepare` unpacked.
fn kernel() -> PathBuf {
    let folder = repository().join("target/guest/boot");
    let files = fs::read_dir(&folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut kernels = files
        .filter(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("vmlinuz")));
    kernels
        .next()
        .unwrap_or_else(|| panic!("there is no kernel in {}: run tests/guest/prepare", folder.display()))
}

/// The shared libraries that a program loads, its loader among them.
fn libraries_of(program: &Path) -> io::Result<Vec<PathBuf>> {
    let listed = Command::new("ldd").arg(program).output()?;
    let text = String::from_utf8_lossy(&listed.stdout).into_owned();
    let paths = text.split_whitespace().filter(|word| word.starts_with('/')).map(PathBuf::from);
    Ok(paths.collect())
}

/// An archive in the kernel's own format (Linux, Documentation/driver-api/early-userspace/buffer-format.rst, "newc").
struct Archive(io::BufWriter<File>, u32);

impl Archive {
    fn add(&mut self, name: &str, mode: u32, bytes: &[u8]) -> io::Result<()> {
        self.1 += 1; // every entry is a file of its own
        let name_bytes = name.len() + 1;
        let fields = [self.1, mode, 0, 0, 1, 0, bytes.len() as u32, 0, 0, 0, 0, name_bytes as u32, 0];
        let head = fields.iter().fold("070701".to_owned(), |head, field| format!("{head}{field:08x}"));
        self.0.write_all(head.as_bytes())?;
        self.0.write_all(name.as_bytes())?;
        self.0.write_all(&[0])?;
        self.pad(head.len() + name_bytes)?;
        self.0.write_all(bytes)?;
        self.pad(bytes.len())
    }

    fn pad(&mut self, written: usize) -> io::Result<()> {
        self.0.write_all(&[0; 3][..written.next_multiple_of(4) - written])
    }

    fn end(mut self) -> io::Result<()> {
        self.add("TRAILER!!!", 0, &[])?;
        self.0.flush()
    }
}
