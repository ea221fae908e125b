//! Other people's programs as peers: Python programs on libraries from PyPI, in environments that are made when they are first needed:
//! those of `tests/peers`, for which `tests/peers/prepare` makes `target/peers`, and that of `examples/jsbsim`, likewise.

use std::fs::File;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::OnceLock;
use std::time::Duration;

use rustix::fs::{FlockOperation, flock};
use serde_json::Value;

use crate::await_some;
use crate::programs::repository;

/// Fetching the libraries takes seconds; a registry that does not answer must not hold the tests for ever.
const PREPARING: Duration = Duration::from_secs(240);

/// The Python to run peers with. `None` if there is none, and why has been said; the test is to be left out. In CI that is
/// a failure.
pub fn python() -> Option<PathBuf> {
    static PYTHON: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    prepared(&PYTHON, "peers")
}

/// The Python that has JSBSim; as [`python`].
pub fn jsbsim() -> Option<PathBuf> {
    static PYTHON: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    prepared(&PYTHON, "jsbsim")
}

fn prepared(place: &OnceLock<Result<PathBuf, String>>, name: &str) -> Option<PathBuf> {
    match place.get_or_init(|| prepare(name)) {
        Ok(python) => Some(python.clone()),
        Err(reason) if std::env::var_os("CI").is_some_and(|value| value == "true") => {
            panic!("the peers of the tests are needed in CI: {reason}")
        }
        Err(reason) => {
            eprintln!("NOT TESTED against other people's programs: {reason}");
            None
        }
    }
}

fn prepare(name: &str) -> Result<PathBuf, String> {
    let script = repository().join(format!("tests/{name}/prepare"));
    let lock = File::options()
        .create(true)
        .append(true)
        .open(std::env::temp_dir().join(format!("bateleur-tests.{name}")))
        .map_err(|error| error.to_string())?;
    flock(&lock, FlockOperation::LockExclusive).map_err(|error| error.to_string())?;
    let mut said = tempfile::tempfile().map_err(|error| error.to_string())?;
    let mut process = Command::new(&script)
        .stdin(Stdio::null())
        .stdout(said.try_clone().map_err(|error| error.to_string())?)
        .stderr(said.try_clone().map_err(|error| error.to_string())?)
        .spawn()
        .map_err(|error| format!("{}: {error}", script.display()))?;
    let ended = await_some(PREPARING, || process.try_wait().ok().flatten());
    if !ended.is_some_and(|status| status.success()) {
        let _ = process.kill(); // it has ended, or takes too long
        let _ = process.wait(); // as above
        let mut text = String::new();
        let _ = std::io::Seek::rewind(&mut said); // an empty text then
        let _ = said.read_to_string(&mut text); // as above
        return Err(format!("tests/{name}/prepare failed: {}", text.trim()));
    }
    Ok(repository().join(format!("target/{name}/bin/python")))
}

/// A running peer; ended when dropped.
#[derive(Debug)]
pub struct Peer {
    child: Child,
    /// It ends when this closes.
    input: Option<ChildStdin>,
    output: BufReader<ChildStdout>,
    /// The first line that it said.
    pub ready: Value,
}

impl Peer {
    /// Starts `tests/peers/<script>` and waits for its first line. `None`: as [`python`].
    pub fn start(script: &str, arguments: &[&str]) -> Option<Self> {
        Some(Self::run(&python()?, &format!("tests/peers/{script}"), arguments))
    }

    /// Starts a program of the repository and waits for its first line.
    pub fn run(python: &Path, script: &str, arguments: &[&str]) -> Self {
        let mut child = Command::new(python)
            .arg(repository().join(script))
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let input = child.stdin.take();
        let mut output = BufReader::new(child.stdout.take().unwrap());
        let mut line = String::new();
        output.read_line(&mut line).unwrap();
        let ready =
            serde_json::from_str(&line).unwrap_or_else(|error| panic!("{script} said {line:?}: {error}"));
        Self { child, input, output, ready }
    }

    /// Where it listens.
    pub fn address(&self) -> &str {
        self.ready["listening"].as_str().unwrap()
    }

    /// Says a line to it.
    pub fn say(&mut self, line: &Value) {
        use std::io::Write;
        writeln!(self.input.as_mut().unwrap(), "{line}").unwrap();
    }

    /// Its next line; it must come.
    pub fn line(&mut self) -> Value {
        let mut line = String::new();
        self.output.read_line(&mut line).unwrap();
        serde_json::from_str(&line).unwrap_or_else(|error| panic!("it said {line:?}: {error}"))
    }

    /// Ends it and gives its last line.
    pub fn finish(mut self) -> Value {
        drop(self.input.take());
        let mut text = String::new();
        self.output.read_to_string(&mut text).unwrap();
        let last = text.lines().last().unwrap_or_default();
        serde_json::from_str(last).unwrap_or_else(|error| panic!("it said {text:?} at its end: {error}"))
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        drop(self.input.take());
        let _ = self.child.kill(); // it may have ended already
        let _ = self.child.wait(); // as above
    }
}
