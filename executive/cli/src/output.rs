//! Outputs: what a folder or a file holds already is not written over unasked.

use std::fs::File;
use std::io::Read;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

use anyhow::{Context, Result, bail};

/// Files by which a folder is known to hold a run or a flight.
const MARKS: [&str; 5] = ["summary.json", "run.json", "windows.csv", "health.jsonl", "ports.mcap"];

/// An error where `folder` holds what an earlier run or flight wrote.
pub fn refuse_used(folder: &Path) -> Result<()> {
    if let Some(mark) = MARKS.iter().find(|mark| folder.join(mark).exists()) {
        bail!(
            "{} holds a run already (there is a {mark}): name another folder with --output, or remove this one",
            folder.display()
        );
    }
    Ok(())
}

/// What a log of messages begins with (MCAP, "Magic").
pub const LOG_BEGINNING: &str = "\u{89}MCAP0\r\n";

/// An error where the file `output` is one of those that are read, or holds something else than what is written, which begins with
/// `beginning`: whoever names another file by mistake would lose it.
pub fn refuse_file(output: &Path, beginning: &str, inputs: &[&Path]) -> Result<()> {
    let Ok(about) = output.metadata() else { return Ok(()) }; // not there, or found out when it is written
    let is_same = |input: &&&Path| {
        input.metadata().is_ok_and(|input| (input.dev(), input.ino()) == (about.dev(), about.ino()))
    };
    if inputs.iter().any(|input| is_same(&input)) {
        bail!("{} is read by this command: name another file to be written", output.display());
    }
    if about.is_file() && about.len() > 0 && !begins_with(output, &bytes_of(beginning))? {
        bail!(
            "{} is there already and holds something else: name another file, or remove this one",
            output.display()
        );
    }
    Ok(())
}

fn begins_with(file: &Path, beginning: &[u8]) -> Result<bool> {
    let mut head = Vec::new();
    let opened = File::open(file).with_context(|| format!("cannot look into {}", file.display()))?;
    opened.take(beginning.len() as u64).read_to_end(&mut head)?;
    Ok(head == beginning)
}

/// The letters as bytes: a log's first one is no text.
fn bytes_of(beginning: &str) -> Vec<u8> {
    beginning.chars().map(|letter| letter as u8).collect()
}

/// Removes from a folder what made it one that holds a run: there was none after all.
pub fn clear(folder: &Path) -> std::io::Result<()> {
    let made = ["truth.bin", "mission.json"].iter().chain(&MARKS).map(|name| folder.join(name));
    made.filter(|file| file.exists()).try_for_each(std::fs::remove_file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_that_is_read_or_holds_something_else_is_not_written_over() {
        let folder = tempfile::tempdir().unwrap();
        let [plan, hard, soft, old, other, new] =
            ["plan.toml", "hard", "soft", "old.svg", "notes.txt", "new.svg"]
                .map(|name| folder.path().join(name));
        std::fs::write(&plan, "<svg").unwrap();
        std::fs::hard_link(&plan, &hard).unwrap();
        std::os::unix::fs::symlink(&plan, &soft).unwrap();
        std::fs::write(&old, "<svg of last week").unwrap();
        std::fs::write(&other, "by hand").unwrap();
        for same in [&plan, &hard, &soft, &folder.path().join("./plan.toml")] {
            let reason = refuse_file(same, "<svg", &[&plan]).unwrap_err().to_string();
            assert!(reason.contains("is read by this command"), "{reason}");
        }
        let reason = refuse_file(&other, "<svg", &[&plan]).unwrap_err().to_string();
        assert!(reason.contains("holds something else"), "{reason}");
        for fine in [&old, &new, Path::new("/dev/null")] {
            assert!(refuse_file(fine, "<svg", &[&plan]).is_ok(), "{}", fine.display());
        }
        std::fs::write(&other, b"\x89MCAP0\r\n...").unwrap();
        assert!(refuse_file(&other, LOG_BEGINNING, &[]).is_ok());
    }

    #[test]
    fn folder_with_a_run_in_it_is_refused_and_others_are_not() {
        let folder = std::env::temp_dir().join(format!("bateleur-output-{}", std::process::id()));
        assert!(refuse_used(&folder).is_ok(), "one that is not there yet");
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("notes.txt"), "").unwrap();
        assert!(refuse_used(&folder).is_ok(), "one with other things in it");
        for mark in ["ports.mcap", "windows.csv"] {
            std::fs::write(folder.join(mark), "").unwrap();
            let reason = refuse_used(&folder).unwrap_err().to_string();
            assert!(reason.contains(mark) && reason.contains("--output"), "{reason}");
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
