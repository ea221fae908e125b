//! A guest: a kernel with PREEMPT_RT and every control group controller, in a virtual machine, for what the machine below
//! the tests may lack.
//!
//! Responsible for: packing programs and a script into an initial file system, running it, and handing back what it said.
//! Timings in a guest mean nothing (every instruction is emulated); behaviour does. Prepared by `tests/guest/prepare`.

use std::fs::{self, File};
use std::io::{self, Write};
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

use crate::await_some;
use crate::programs::{program, repository};

/// A guest boots in some 6 s and is slower than the machine below by a factor of ten.
const PATIENCE: Duration = Duration::from_secs(180);
/// Memory of a guest, MiB: the programs lie in it twice, packed and unpacked.
const MEMORY_MIB: u32 = 2048;

/// What is put into a guest.
#[derive(Debug, Default)]
pub struct Guest {
    programs: Vec<String>,
    files: Vec<(String, Vec<u8>)>,
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
    /// A guest with `bateleur`, the nine partitions and the schedule of the flight in `/work`.
    pub fn of_the_flight() -> Self {
        let programs = crate::NINE.iter().chain(&["bateleur", "simulator"]).map(|&name| name.to_owned());
        let schedule = fs::read(repository().join("schedule.toml")).unwrap();
        Self { programs: programs.collect(), files: vec![("schedule.toml".into(), schedule)] }
    }

    /// With another program of this workspace.
    pub fn program(mut self, name: &str) -> Self {
        self.programs.push(name.into());
        self
    }

    /// With a file in `/work`.
    pub fn file(mut self, name: &str, text: &str) -> Self {
        self.files.push((name.into(), text.into()));
        self
    }

    /// Boots, runs `script` in `/work` by a shell, and gives what it printed.
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
            .args(["-append", "console=ttyS0 quiet panic=-1", "-serial"])
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

    fn pack(&self, disk: &Path, script: &str) -> io::Result<()> {
        let mut archive = Archive(io::BufWriter::new(File::create(disk)?), 0);
        for folder in
            ["bin", "proc", "sys", "dev", "tmp", "etc", "work", "lib64", "lib", "lib/x86_64-linux-gnu"]
        {
            archive.add(folder, 0o040_755, &[])?;
        }
        archive.add("bin/busybox", 0o100_755, &fs::read("/bin/busybox")?)?;
        archive.add("init", 0o100_755, include_bytes!("../guest/init"))?;
        archive.add("etc/passwd", 0o100_644, b"root:x:0:0::/:/bin/sh\n")?;
        archive.add("work/script", 0o100_755, script.as_bytes())?;
        for (name, bytes) in &self.files {
            archive.add(&format!("work/{name}"), 0o100_644, bytes)?;
        }
        let mut libraries = Vec::new();
        for name in &self.programs {
            let path = program(name);
            archive.add(&format!("work/{name}"), 0o100_755, &fs::read(&path)?)?;
            libraries.extend(libraries_of(&path)?);
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
