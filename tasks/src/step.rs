//! One step of the verification: a command whose words pass through, are counted, and whose time is told.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, Read};
use std::process::{Command, Stdio};
use std::sync::mpsc::{Sender, channel};
use std::thread;
use std::time::{Duration, Instant};

use crate::tally::Tally;

/// A command to run.
#[derive(Debug)]
pub(crate) struct Step {
    name: &'static str,
    program: OsString,
    arguments: Vec<String>,
    environment: Vec<(String, String)>,
    idle: bool,
}

impl Step {
    /// A step of cargo's. In CI what compiles does so at the levels of `.ci/levels.toml`.
    pub(crate) fn cargo(name: &'static str, arguments: &[&str]) -> Self {
        let levels: &[&str] = match arguments.first() {
            Some(&("build" | "clippy" | "doc" | "nextest" | "test")) if in_ci() => {
                &["--config", ".ci/levels.toml"]
            }
            _ => &[],
        };
        let at = arguments.iter().position(|&word| word == "--release").unwrap_or(arguments.len());
        Self::new(name, crate::cargo(), &[&arguments[..at], levels, &arguments[at..]].concat())
    }

    /// A step of any program's.
    pub(crate) fn new(name: &'static str, program: impl Into<OsString>, arguments: &[&str]) -> Self {
        let arguments = arguments.iter().map(|&argument| argument.to_owned()).collect();
        Self { name, program: program.into(), arguments, environment: Vec::new(), idle: false }
    }

    /// With an environment variable.
    pub(crate) fn with(mut self, variable: &str, value: &str) -> Self {
        self.environment.push((variable.to_owned(), value.to_owned()));
        self
    }

    /// On processors that nobody else wants (SCHED_IDLE), where there is `chrt` to say so.
    pub(crate) fn idle(mut self) -> Self {
        self.idle = succeeds("chrt", &["--version"], Duration::from_secs(5));
        self
    }

    /// Runs it; its tests are added to `tally`. An error is what a person shall read.
    pub(crate) fn run(&self, tally: &mut Tally) -> Result<(), String> {
        println!("== {}: {}", self.name, self.shown());
        let begun = Instant::now();
        let status =
            self.pass_through(tally).map_err(|error| format!("{} cannot be run: {error}", self.shown()))?;
        let seconds = begun.elapsed().as_secs_f64();
        if status {
            println!("== {}: fine, {seconds:.1} s", self.name);
            return Ok(());
        }
        Err(format!("{} failed after {seconds:.1} s; to repeat it: {}", self.name, self.shown()))
    }

    fn pass_through(&self, tally: &mut Tally) -> std::io::Result<bool> {
        let mut command = Command::new(if self.idle { "chrt".as_ref() } else { self.program.as_os_str() });
        if self.idle {
            command.args(["--idle", "0"]).arg(&self.program);
        }
        command.args(&self.arguments).envs(self.environment.iter().cloned());
        let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
        let (sender, lines) = channel();
        let readers = [
            child.stdout.take().map(|pipe| read_lines(pipe, sender.clone())),
            child.stderr.take().map(|pipe| read_lines(pipe, sender.clone())),
        ];
        drop(sender);
        for line in lines {
            println!("{line}");
            tally.add_line(&line);
        }
        for reader in readers.into_iter().flatten() {
            let _ = reader.join(); // it has nothing more to say
        }
        Ok(child.wait()?.success())
    }

    /// What a person types to repeat it.
    fn shown(&self) -> String {
        let program = match self.program == crate::cargo() {
            true => "cargo".into(),
            false => self.program.to_string_lossy().into_owned(),
        };
        let variables = self.environment.iter().map(|(name, value)| format!("{name}=\"{value}\""));
        variables.chain([program]).chain(self.arguments.iter().cloned()).collect::<Vec<_>>().join(" ")
    }
}

fn read_lines(pipe: impl Read + Send + 'static, lines: Sender<String>) -> thread::JoinHandle<()> {
    thread::spawn(move || {
        // A test may write bytes that are no text: they must not end the reading.
        for line in BufReader::new(pipe).split(b'\n').map_while(Result::ok) {
            if lines.send(String::from_utf8_lossy(&line).trim_end_matches('\r').to_owned()).is_err() {
                return;
            }
        }
    })
}

/// Whether this is a machine that decides what lands: nothing may be left out there.
pub(crate) fn in_ci() -> bool {
    std::env::var_os("CI").is_some_and(|value| value == "true")
}

/// Whether a program can be started and ends well, silently and in time.
pub(crate) fn succeeds(program: impl Into<OsString>, arguments: &[&str], within: Duration) -> bool {
    let mut command = Command::new(program.into());
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let Ok(mut child) = command.spawn() else { return false };
    let begun = Instant::now();
    while begun.elapsed() < within {
        match child.try_wait() {
            Ok(None) => thread::sleep(Duration::from_millis(20)),
            Ok(Some(status)) => return status.success(),
            Err(_) => return false,
        }
    }
    let _ = child.kill(); // it has ended meanwhile
    let _ = child.wait();
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_counts_tests_on_both_outputs_and_says_how_it_ended() {
        let mut tally = Tally::default();
        let script = "echo 'test result: ok. 2 passed; 0 failed; 1 ignored'; \
                      echo '  Summary [ 0.1s] 3 tests run: 3 passed, 0 skipped' >&2";
        assert_eq!(Step::new("shell", "sh", &["-c", script]).run(&mut tally), Ok(()));
        assert_eq!(tally, Tally { passed: 5, failed: 0, skipped: 1 });
        let failed = Step::new("shell", "false", &[]).with("A", "b").run(&mut tally).unwrap_err();
        assert!(failed.ends_with("to repeat it: A=\"b\" false"), "{failed}");
        let idle = Step::new("policy", "sh", &["-c", "chrt --pid $$ | grep -q SCHED_IDLE"]).idle();
        assert_eq!(idle.run(&mut tally), Ok(()));
        let absent = Step::new("nothing", "no-such-program", &[]).run(&mut tally).unwrap_err();
        assert!(absent.starts_with("no-such-program cannot be run"), "{absent}");
    }

    #[test]
    fn a_program_that_hangs_does_not_succeed() {
        assert!(succeeds("true", &[], Duration::from_secs(5)));
        assert!(!succeeds("false", &[], Duration::from_secs(5)));
        assert!(!succeeds("sleep", &["30"], Duration::from_millis(50)));
    }
}
