//! Starting programs, with their output in files and an end to every wait.

use std::fs::{File, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process, kill_process_group};
use serde_json::Value;
use tempfile::TempDir;

use crate::await_some;
use crate::children::{EXECUTIVE as EXECUTIVE_NAME, Process, children_of};
use crate::output::{Fault, Window, faults, windows};

/// The project's root.
pub fn repository() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..").canonicalize().unwrap()
}

/// A program of this workspace, built for release.
pub fn program(name: &str) -> PathBuf {
    let own = std::env::current_exe().unwrap();
    let beside = own.ancestors().nth(2).map(Path::to_owned); // target/release/deps/<test>
    let named = std::env::var_os("CARGO_TARGET_DIR").map(|target| Path::new(&target).join("release"));
    let usual = repository().join("target/release");
    let folders: Vec<PathBuf> = beside.into_iter().chain(named).chain([usual]).collect();
    match folders
        .iter()
        .filter(|folder| folder.ends_with("release"))
        .map(|folder| folder.join(name))
        .find(|path| path.is_file())
    {
        Some(path) => path,
        None => panic!(
            "there is no program {name} in {folders:?}: build it with `cargo build --release --workspace --bins`"
        ),
    }
}

/// Names a control group that is given to each `bateleur` of a test alone, as a unit of systemd would be.
const UNIT: &str = "BATELEUR_TESTS_UNIT";

/// A program that this workspace does not build.
pub fn other(program: &Path, arguments: &[&str]) -> Started {
    start(Command::new(program), arguments, None)
}

/// A command for a program, in the group that the environment names.
fn in_its_unit(program: &Path) -> Command {
    let Some(unit) = std::env::var_os(UNIT) else { return Command::new(program) };
    let mut command = Command::new("sh");
    let mut members = unit;
    members.push("/cgroup.procs");
    command.args(["-c", "echo $$ > \"$0\"; exec \"$@\""]).arg(members).arg(program);
    command
}

/// A verb of `bateleur`, such as `["fly", "--fast"]`; nothing is added but `--output`, where the verb has
/// one and is not told.
pub fn bateleur<S: AsRef<str>>(arguments: &[S]) -> Started {
    start(in_its_unit(&program("bateleur")), arguments, None)
}

/// The executive without the command line before it.
pub fn daemon(arguments: &[&str]) -> Started {
    start(in_its_unit(&program("bateleurd")), arguments, None)
}

/// As [`bateleur`] with the schedule of a [`crate::Sketch`], as an ordinary user: the one who runs the tests, or user `ORDINARY` where that is
/// root. The programs lie where that user may run them, whoever may enter the clone.
pub fn bateleur_as_ordinary(arguments: &[&str]) -> Started {
    if !rustix::process::geteuid().is_root() {
        return bateleur(arguments);
    }
    let place = tempfile::Builder::new().prefix("bateleur-programs-").tempdir().unwrap();
    std::fs::set_permissions(place.path(), Permissions::from_mode(0o755)).unwrap();
    let offer = |name: &str| {
        let (built, offered) = (program(name), place.path().join(name));
        // Another file system has no link to it.
        std::fs::hard_link(&built, &offered).or_else(|_| std::fs::copy(&built, &offered).map(drop)).unwrap();
        offered
    };
    let mut command = Command::new(EXECUTIVE.map(offer)[0].clone());
    command.uid(ORDINARY).gid(ORDINARY);
    let at = arguments.iter().position(|argument| *argument == "--schedule").unwrap() + 1;
    let built = format!("{}/", program("bateleur").parent().unwrap().display());
    let mut schedule = read(Path::new(arguments[at]));
    while let Some((before, after)) = schedule.split_once(&built) {
        let (name, after) = after.split_once('"').unwrap();
        let offered = place.path().join(name);
        let offered = if offered.exists() { offered } else { offer(name) };
        schedule = format!("{before}{}\"{after}", offered.display());
    }
    let path = place.path().join("test.toml");
    std::fs::write(&path, schedule).unwrap();
    let mut arguments = arguments.to_vec();
    arguments[at] = path.to_str().unwrap();
    let mut started = start(command, &arguments, Some(ORDINARY));
    started.programs = Some(place);
    started
}

/// The programs that run a module, the command line first.
pub const EXECUTIVE: [&str; 3] = ["bateleur", "bateleurd", "bateleur_channels"];

/// A user that no process but those of these tests has.
pub const ORDINARY: u32 = 61_657;

fn start<S: AsRef<str>>(mut command: Command, arguments: &[S], owner: Option<u32>) -> Started {
    let scratch = tempfile::Builder::new().prefix("bateleur-test-").tempdir().unwrap();
    std::os::unix::fs::chown(scratch.path(), owner, owner).unwrap();
    let text = |name: &str| File::create(scratch.path().join(name)).unwrap();
    command.args(arguments.iter().map(AsRef::as_ref)).current_dir(scratch.path());
    let told = arguments.iter().any(|argument| argument.as_ref() == "--output");
    if matches!(arguments.first().map(AsRef::as_ref), Some("fly" | "run")) && !told {
        command.arg("--output").arg(scratch.path().join("out"));
    }
    command.process_group(0); // a terminal's Ctrl-C can be played
    command.stdin(Stdio::null()).stdout(text("stdout")).stderr(text("stderr"));
    let child = command.spawn().unwrap();
    Started { child, scratch: Some(scratch), programs: None }
}

/// A program that runs; killed when dropped.
#[derive(Debug)]
pub struct Started {
    child: Child,
    scratch: Option<TempDir>,
    /// Where its programs lie, if that is no folder of the build.
    programs: Option<TempDir>,
}

impl Started {
    /// Its number.
    pub fn pid(&self) -> i32 {
        self.child.id() as i32
    }

    /// The module that it runs, as `--module` takes it: once that answers.
    #[track_caller]
    pub fn module(&self) -> String {
        let module = crate::executive_of(self.pid()).pid.to_string();
        let answers = await_some(crate::PATIENCE, || {
            bateleur(&["ps", "--module", &module]).end().code.filter(|code| *code == 0)
        });
        assert!(answers.is_some(), "the module never came: {}", self.said());
        module
    }

    /// Its output folder.
    pub fn folder(&self) -> PathBuf {
        self.scratch.as_ref().unwrap().path().join("out")
    }

    /// What it said on standard error so far.
    pub fn said(&self) -> String {
        read(&self.scratch.as_ref().unwrap().path().join("stderr"))
    }

    /// Waits until it has said `text`.
    #[track_caller]
    pub fn await_words(&mut self, text: &str) {
        let heard = await_some(crate::PATIENCE, || {
            let ended = self.child.try_wait().unwrap().is_some();
            (ended || self.said().contains(text)).then_some(())
        });
        assert!(heard.is_some() && self.said().contains(text), "it never said {text:?}:\n{}", self.said());
    }

    /// Sends it a signal.
    pub fn signal(&self, signal: Signal) {
        kill_process(Pid::from_raw(self.pid()).unwrap(), signal).unwrap();
    }

    /// Sends a signal to it and to all that it started and left in its group, as a terminal does.
    pub fn signal_group(&self, signal: Signal) {
        kill_process_group(Pid::from_raw(self.pid()).unwrap(), signal).unwrap();
    }

    /// Whether it has ended.
    pub fn has_ended(&mut self) -> bool {
        self.child.try_wait().unwrap().is_some()
    }

    /// Waits until it ends by itself.
    #[track_caller]
    pub fn end(self) -> Ended {
        self.end_within(crate::PATIENCE)
    }

    /// As [`Started::end`], for one that may take long.
    #[track_caller]
    pub fn end_within(mut self, limit: Duration) -> Ended {
        let status = await_some(limit, || self.child.try_wait().unwrap());
        let Some(status) = status else {
            panic!("it hangs: still running after {limit:?}; it said:\n{}", self.said())
        };
        let scratch = self.scratch.take().unwrap();
        let text = |name: &str| read(&scratch.path().join(name));
        Ended { code: status.code(), stdout: text("stdout"), stderr: text("stderr"), scratch }
    }
}

impl Drop for Started {
    fn drop(&mut self) {
        // A supervisor would start another executive, and an executive goes on without its supervisor.
        let is_supervisor = Process::read(self.pid()).is_some_and(|process| process.name == "supervisor");
        if is_supervisor {
            self.signal(Signal::STOP);
            children_of(self.pid())
                .iter()
                .filter(|child| child.name == EXECUTIVE_NAME)
                .for_each(Process::kill);
        }
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// What a program left.
#[derive(Debug)]
pub struct Ended {
    /// Its exit code; `None` if a signal ended it.
    pub code: Option<i32>,
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
    scratch: TempDir,
}

impl Ended {
    /// Its output folder.
    pub fn folder(&self) -> PathBuf {
        self.scratch.path().join("out")
    }

    /// Fails with all that it said unless it ended with `code`.
    #[track_caller]
    pub fn expect_code(self, code: i32) -> Self {
        assert_eq!(self.code, Some(code), "exit code; it said:\n{}\n{}", self.stderr, self.stdout);
        self
    }

    /// Fails unless every one of `words` is in what it said on standard error.
    #[track_caller]
    pub fn expect_words(self, words: &[&str]) -> Self {
        for word in words {
            assert!(self.stderr.contains(word), "{word:?} is missing in:\n{}", self.stderr);
        }
        self
    }

    /// The one JSON document on standard output.
    #[track_caller]
    pub fn summary(&self) -> Value {
        match serde_json::from_str(&self.stdout) {
            Ok(document) => document,
            Err(error) => panic!("{error}:\n{}\n{}", self.stdout, self.stderr),
        }
    }

    /// The health log, without orders.
    #[track_caller]
    pub fn faults(&self) -> Vec<Fault> {
        faults(&self.folder()).into_iter().filter(|entry| entry.error != "order").collect()
    }

    /// The same of another module of the run.
    #[track_caller]
    pub fn faults_on(&self, module: &str) -> Vec<Fault> {
        let all = faults(&self.folder().join("hosts").join(module)).into_iter();
        all.filter(|entry| entry.error != "order").collect()
    }

    /// The orders in the health log: what was done, or not.
    #[track_caller]
    pub fn orders(&self) -> Vec<String> {
        let orders = faults(&self.folder()).into_iter().filter(|entry| entry.error == "order");
        orders.map(|entry| entry.detail).collect()
    }

    /// The window log.
    #[track_caller]
    pub fn windows(&self) -> Vec<Window> {
        windows(&self.folder())
    }

    /// Whether it wrote nothing into its output folder.
    pub fn left_no_output(&self) -> bool {
        std::fs::read_dir(self.folder()).map_or(true, |mut entries| entries.next().is_none())
    }
}

fn read(path: &Path) -> String {
    String::from_utf8_lossy(&std::fs::read(path).unwrap_or_default()).into_owned()
}
