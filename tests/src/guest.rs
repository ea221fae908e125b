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
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use crate::await_some;
use crate::programs::{EXECUTIVE, program, repository};

/// A guest boots in some 6 s and is slower than the machine below by a factor of ten; a whole file of tests takes minutes.
const PATIENCE: Duration = Duration::from_secs(1200);
/// What a guest says before its script begins.
const BEGAN: &str = "guest-began\n";
/// An emulated kernel hangs at its start at times, before it says anything: after so long it is started again, so often in all.
const START: Duration = Duration::from_secs(180);
const STARTS: u32 = 3;
/// Memory of a guest, MiB: the programs lie in it twice, packed and unpacked.
const MEMORY_MIB: u32 = 2048;

/// Where programs lie in a guest, as below `target/release`, so that this project's tests find them there too.
const RELEASE: &str = "flight/release";
/// Kernel modules for a CAN bus without hardware, each after those that it needs.
const CAN: [&str; 4] = ["can-dev", "can", "can-raw", "vcan"];

/// A kind of processor that a guest can have.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub enum Processor {
    /// That of the machine below the tests.
    #[default]
    X86_64,
    /// Programs for it are those that `cargo verify` builds, libraries those of the C compiler for it.
    Aarch64,
}

impl Processor {
    fn emulator(self) -> &'static str {
        match self {
            Self::X86_64 => "qemu-system-x86_64",
            Self::Aarch64 => "qemu-system-aarch64",
        }
    }

    /// What the emulator takes for its board, and for a second serial line, for what the script prints, to the file `output`.
    fn board(self, output: &Path) -> Vec<String> {
        let output = output.display();
        match self {
            Self::X86_64 => vec!["-serial".into(), format!("file:{output}")],
            Self::Aarch64 => {
                let board =
                    ["-machine", "virt", "-cpu", "cortex-a72", "-device", "pci-serial,chardev=output"];
                let line = ["-chardev".into(), format!("file,id=output,path={output}")];
                board.map(str::to_owned).into_iter().chain(line).collect()
            }
        }
    }

    /// The console's line and the script's, as the kernel names them.
    fn lines(self) -> [&'static str; 2] {
        match self {
            Self::X86_64 => ["ttyS0", "ttyS1"],
            Self::Aarch64 => ["ttyAMA0", "ttyS0"],
        }
    }

    /// Where `tests/guest/prepare` put what is this processor's.
    fn prepared(self) -> PathBuf {
        let all = repository().join("target/guest");
        match self {
            Self::X86_64 => all,
            Self::Aarch64 => all.join("aarch64"),
        }
    }

    fn shell(self) -> PathBuf {
        match self {
            Self::X86_64 => "/bin/busybox".into(),
            Self::Aarch64 => self.prepared().join("bin/busybox"),
        }
    }

    /// A program of this workspace, built for release.
    fn program(self, name: &str) -> PathBuf {
        let own = program(name);
        match self {
            Self::X86_64 => own,
            Self::Aarch64 => {
                let target = own.ancestors().nth(2).unwrap_or(&own);
                let path = target.join("aarch64-unknown-linux-gnu/release").join(name);
                assert!(path.is_file(), "there is no {}: `cargo verify` builds it", path.display());
                path
            }
        }
    }

    fn strip(self) -> &'static str {
        match self {
            Self::X86_64 => "strip",
            Self::Aarch64 => "aarch64-linux-gnu-strip",
        }
    }

    /// The shared libraries that a program loads, its loader among them: where they lie, and where they are looked for.
    fn libraries_of(self, program: &Path) -> io::Result<Vec<(PathBuf, PathBuf)>> {
        if self == Self::Aarch64 {
            let all = ["ld-linux-aarch64.so.1", "libc.so.6", "libm.so.6", "libgcc_s.so.1"];
            let cross = Path::new("/usr/aarch64-linux-gnu/lib");
            return Ok(all.map(|name| (cross.join(name), Path::new("/lib").join(name))).into());
        }
        let listed = Command::new("ldd").arg(program).output()?;
        let text = String::from_utf8_lossy(&listed.stdout).into_owned();
        let paths = text.split_whitespace().filter(|word| word.starts_with('/')).map(PathBuf::from);
        Ok(paths.map(|path| (path.clone(), path)).collect())
    }
}

/// The flight's schedule, with time for starts on a processor that is emulated, on a machine that is busy with other things.
pub fn patient(schedule: &str) -> String {
    schedule.replace("module     = \"fcu\"", "module = \"fcu\"\nstartup_timeout = \"60s\"")
}

/// What is put into a guest.
#[derive(Debug, Default)]
pub struct Guest {
    processor: Processor,
    programs: Vec<PathBuf>,
    files: Vec<(String, Vec<u8>)>,
    modules: Vec<&'static str>,
    systemd: bool,
    patience: Option<Duration>,
}

/// What a guest's script left.
#[derive(Debug)]
pub struct Said {
    /// Everything that it printed.
    pub text: String,
    /// Its exit code; `None` if the guest did not come to the script's end.
    pub code: Option<i32>,
}

impl Guest {
    /// A guest with `bateleur`, the nine partitions and the schedule of the flight in `/flight`.
    pub fn of_the_flight() -> Self {
        Self::of_the_flight_on(Processor::X86_64)
    }

    /// The same on a processor of that kind.
    pub fn of_the_flight_on(processor: Processor) -> Self {
        let own = crate::NINE.iter().chain(&EXECUTIVE).chain(&["simulator"]);
        let programs = own.map(|name| processor.program(name));
        let schedule = patient(&fs::read_to_string(repository().join("schedule.toml")).unwrap());
        let files = vec![("schedule.toml".into(), schedule.into_bytes())];
        Self { processor, programs: programs.collect(), files, ..Self::default() }
    }

    /// With another program of this workspace.
    pub fn program(mut self, name: &str) -> Self {
        self.programs.push(self.processor.program(name));
        self
    }

    /// With the program that runs this test, `./system`, and the partitions that its tests start there.
    pub fn tests(mut self, partitions: &[&str]) -> Self {
        self.programs.push(std::env::current_exe().unwrap());
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

    /// Given that much time instead of twenty minutes.
    pub fn within(self, patience: Duration) -> Self {
        Self { patience: Some(patience), ..self }
    }

    /// Boots, runs `script` in `/flight` by a shell, and gives what it printed.
    pub fn run(self, script: &str) -> Said {
        let folder = tempfile::Builder::new().prefix("bateleur-guest-").tempdir().unwrap();
        let (disk, output) = (folder.path().join("initrd"), folder.path().join("output"));
        self.pack(&disk, script).unwrap();
        let console = folder.path().join("console");
        let [console_line, output_line] = self.processor.lines();
        let kernels = format!(
            "console={console_line} output=/dev/{output_line} quiet panic=-1 systemd.unit=script.service"
        );
        let start = || {
            Command::new(self.processor.emulator())
                .args(["-accel", "tcg,thread=multi", "-smp", "2", "-m"])
                .arg(MEMORY_MIB.to_string())
                .args(["-display", "none", "-no-reboot", "-kernel"])
                .arg(kernel(&self.processor.prepared()))
                .arg("-initrd")
                .arg(&disk)
                .args(["-append", &kernels, "-serial"])
                .arg(format!("file:{}", console.display()))
                .args(self.processor.board(&output))
                .stdin(Stdio::null())
                .spawn()
                .expect("an emulator is needed: tests/guest/prepare installs it")
        };
        let said = || String::from_utf8_lossy(&fs::read(&output).unwrap_or_default()).into_owned();
        let end = |machine: &mut Child| {
            machine.kill().unwrap();
            machine.wait().unwrap();
        };
        let mut machine = start();
        for _ in 1..STARTS {
            let begins = || (machine.try_wait().unwrap().is_some() || said().contains(BEGAN)).then_some(());
            if await_some(START, begins).is_some() {
                break;
            }
            eprintln!("the guest's kernel did not come up within {} s: started again", START.as_secs());
            end(&mut machine);
            machine = start();
        }
        let patience = self.patience.unwrap_or(PATIENCE);
        let ended = await_some(patience, || machine.try_wait().unwrap());
        let how = ended.map_or_else(
            || format!("it was ended after {} s", patience.as_secs()),
            |status| format!("its emulator ended with {status}"),
        );
        if ended.is_none() {
            end(&mut machine);
        }
        let text = said();
        let text = text.split_once(BEGAN).map_or(text.as_str(), |(_, text)| text).to_owned();
        let (text, code) = match text.rsplit_once("guest-exit ") {
            Some((text, code)) => (text.to_owned(), code.trim().parse().ok()),
            None => {
                let console = fs::read_to_string(&console).unwrap_or_default();
                (format!("{text}{console}\nthe guest's script did not end: {how}"), None)
            }
        };
        Said { text, code }
    }

    /// Boots once and runs `scripts` one after the other, each by a shell of its own; gives what each printed.
    pub fn run_each<const COUNT: usize>(self, scripts: [&str; COUNT]) -> [Said; COUNT] {
        let numbered = scripts.iter().enumerate();
        let guest = numbered.fold(self, |guest, (number, text)| guest.file(&format!("part{number}"), text));
        let run = |number| format!("sh ./part{number}; echo \"part-exit $?\"\n");
        let mut said = guest.run(&(0..COUNT).map(run).collect::<String>()).text;
        scripts.map(|_| {
            let (text, after) = match said.split_once("part-exit ") {
                Some((text, after)) => (text.to_owned(), after.to_owned()),
                None => (std::mem::take(&mut said), String::new()),
            };
            let (code, rest) = after.split_once('\n').unwrap_or((&after, ""));
            let code = code.trim().parse().ok();
            said = rest.to_owned();
            Said { text, code }
        })
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
        let strip = self.processor.strip();
        for folder in ["proc", "sys", "dev", "tmp", "flight", "modules"] {
            archive.add(folder, 0o040_755, &[])?;
        }
        archive.add(RELEASE, 0o040_755, &[])?;
        archive.add(&format!("{RELEASE}/deps"), 0o040_755, &[])?;
        self.pack_repository(&mut archive)?;
        archive.add("bin/busybox", 0o100_755, &fs::read(self.processor.shell())?)?;
        archive.add("etc/passwd", 0o100_644, b"root:x:0:0::/:/bin/sh\nbateleur:x:990:990::/:/bin/sh\n")?;
        archive.add("etc/group", 0o100_644, b"root:x:0:\nbateleur:x:990:\n")?;
        archive.add("etc/shadow", 0o100_600, b"root:*:1:0:99999:7:::\n")?;
        archive.add("flight/script", 0o100_755, script.as_bytes())?;
        for (name, bytes) in &self.files {
            archive.add(&format!("flight/{name}"), 0o100_644, bytes)?;
        }
        let mut libraries = Vec::new();
        for path in &self.programs {
            pack_program(&mut archive, path, strip)?;
            libraries.extend(self.processor.libraries_of(path)?);
        }
        for module in &self.modules {
            archive.add(&format!("modules/{module}.ko"), 0o100_644, &fs::read(kernel_module(module))?)?;
        }
        libraries.sort();
        libraries.dedup();
        for (path, place) in libraries {
            let mode = fs::metadata(&path)?.permissions().mode();
            archive.add(place.to_string_lossy().trim_start_matches('/'), mode, &fs::read(&path)?)?;
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
fn pack_program(archive: &mut Archive, path: &Path, strip: &str) -> io::Result<()> {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let own = path.parent().is_some_and(|folder| folder.ends_with("deps"));
    let place = if own { format!("release/deps/{name}") } else { format!("release/{name}") };
    let slim = tempfile::NamedTempFile::new()?;
    let stripped = Command::new(strip).arg("--strip-debug").arg("-o").arg(slim.path()).arg(path).status();
    let whole = !stripped.is_ok_and(|status| status.success()); // a guest with more memory would hold it too
    archive.add(&format!("flight/{place}"), 0o100_755, &fs::read(if whole { path } else { slim.path() })?)?;
    // A test program's name ends with a number of the compiler's.
    let short = if own { name.rsplit_once('-').map_or(&*name, |(short, _)| short) } else { &name };
    archive.add(&format!("flight/{short}"), 0o120_777, place.as_bytes())
}

/// A module that `tests/guest/prepare` unpacked.
fn kernel_module(name: &str) -> PathBuf {
    let path = repository().join(format!("target/guest/modules/{name}.ko"));
    assert!(path.is_file(), "there is no {}: run tests/guest/prepare", path.display());
    path
}

/// The kernel that `tests/guest/prepare` unpacked.
fn kernel(prepared: &Path) -> PathBuf {
    let folder = prepared.join("boot");
    let files = fs::read_dir(&folder).into_iter().flatten().flatten().map(|entry| entry.path());
    let mut kernels = files
        .filter(|path| path.file_name().is_some_and(|name| name.to_string_lossy().starts_with("vmlinuz")));
    kernels
        .next()
        .unwrap_or_else(|| panic!("there is no kernel in {}: run tests/guest/prepare", folder.display()))
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
