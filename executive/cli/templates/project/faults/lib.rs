//! Runs the module with planned faults. The tests are in `tests`.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The project's folder.
#[must_use]
pub fn project() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().map(Path::to_owned).unwrap_or_default()
}

/// Runs the module for four seconds on the virtual clock; gives what it printed, and its health log, a line for each entry.
/// `bateleur` is looked for in `PATH`, or is what the variable `BATELEUR` names.
///
/// # Errors
/// It did not start, or it ended otherwise than it should.
pub fn run(name: &str, faults: &[&str]) -> Result<(String, String), String> {
    let program = std::env::var("BATELEUR").unwrap_or_else(|_| "bateleur".to_owned());
    let output = project().join("target/runs").join(name);
    // The run of the last time: a folder that holds one is not written over.
    let _ = fs::remove_dir_all(&output);
    let mut command = Command::new(&program);
    command.args(["run", "--fast", "--until", "4", "--output"]).arg(&output).args(faults);
    let ended = command.current_dir(project()).output().map_err(|error| format!("{program}: {error}"))?;
    let said = String::from_utf8_lossy(&ended.stderr).into_owned();
    if !ended.status.success() {
        return Err(format!("{program} ended with {}:\n{said}", ended.status));
    }
    let log = output.join("health.jsonl");
    let health = fs::read_to_string(&log).map_err(|error| format!("{}: {error}", log.display()))?;
    Ok((said, health))
}
