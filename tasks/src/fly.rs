//! `cargo fly`: builds every program in the release profile, then becomes `bateleur fly`.
//!
//! Nothing of it goes to standard output, which belongs to the flight's summary.

use std::ffi::OsString;
use std::io::{BufRead, BufReader, IsTerminal};
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Command, ExitCode, Stdio};

use crate::{CANNOT_RUN, cargo};

/// All programs, because the executive starts the partitions, the simulator and itself from one folder.
const BUILD: [&str; 4] = ["build", "--release", "--workspace", "--bins"];

/// What shows help.
const BUILD_HELP: [&str; 6] = ["build", "--release", "--package", "bateleur", "--bin", "bateleur"];

pub(crate) fn run(arguments: Vec<OsString>) -> ExitCode {
    let asks_for_help = arguments.iter().any(|word| word == "--help" || word == "-h");
    let words: &[&str] = if asks_for_help { &BUILD_HELP } else { &BUILD };
    if let Err(reason) = build(words) {
        eprintln!("fly: {reason}; to see it again: cargo {}", words.join(" "));
        return ExitCode::from(CANNOT_RUN);
    }
    let program = match beside_self("bateleur") {
        Ok(program) => program,
        Err(error) => return refuse(&format!("cannot find where this program lies: {error}")),
    };
    let error = Command::new(&program).arg("fly").args(arguments).exec();
    refuse(&format!("cannot start {}: {error}", program.display()))
}

fn refuse(reason: &str) -> ExitCode {
    eprintln!("fly: {reason}");
    ExitCode::from(CANNOT_RUN)
}

/// Cargo's words pass through as they come, but for the line that only says that nothing was to be done.
fn build(words: &[&str]) -> Result<(), String> {
    let mut command = Command::new(cargo());
    command.args(words).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::piped());
    if std::io::stderr().is_terminal() {
        command.env("CARGO_TERM_COLOR", "always");
    }
    let mut child = command.spawn().map_err(|error| format!("cannot start cargo: {error}"))?;
    let words =
        child.stderr.take().into_iter().flat_map(|pipe| BufReader::new(pipe).lines().map_while(Result::ok));
    words.filter(|line| !says_finished(line)).for_each(|line| eprintln!("{line}"));
    match child.wait() {
        Ok(status) if status.success() => Ok(()),
        Ok(_) => Err("the programs could not be built, for the reason above".into()),
        Err(error) => Err(format!("cannot wait for cargo: {error}")),
    }
}

fn says_finished(line: &str) -> bool {
    crate::tally::without_colors(line).trim_start().starts_with("Finished ")
}

/// A program in this one's folder: the same target folder and profile, whatever they are called.
pub(crate) fn beside_self(name: &str) -> std::io::Result<PathBuf> {
    Ok(std::env::current_exe()?.with_file_name(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_line_without_news_is_dropped() {
        assert!(says_finished("    Finished `release` profile [optimized] target(s) in 0.05s"));
        assert!(says_finished("\u{1b}[1m\u{1b}[32m    Finished\u{1b}[0m `release` profile"));
        assert!(!says_finished("   Compiling bateleur v0.1.0"));
        assert!(!says_finished("error: could not compile `bateleur`"));
    }
}
