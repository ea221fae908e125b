//! Output folders: what was written there before is not written over unasked.

use std::path::Path;

use anyhow::{Result, bail};

/// Files by which a folder is known to hold a run or a flight.
const MARKS: [&str; 4] = ["summary.json", "run.json", "windows.csv", "health.jsonl"];

/// An error where `folder` holds what an earlier run or flight wrote.
pub(crate) fn refuse_used(folder: &Path) -> Result<()> {
    if let Some(mark) = MARKS.iter().find(|mark| folder.join(mark).exists()) {
        bail!(
            "{} holds a run already (there is a {mark}): name another folder with --output, or remove this one",
            folder.display()
        );
    }
    Ok(())
}

/// Removes from a folder what made it one that holds a run: there was none after all.
pub(crate) fn clear(folder: &Path) -> std::io::Result<()> {
    let made = ["truth.bin", "ports.mcap"].iter().chain(&MARKS).map(|name| folder.join(name));
    made.filter(|file| file.exists()).try_for_each(std::fs::remove_file)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folder_with_a_run_in_it_is_refused_and_others_are_not() {
        let folder = std::env::temp_dir().join(format!("bateleur-output-{}", std::process::id()));
        assert!(refuse_used(&folder).is_ok(), "one that is not there yet");
        std::fs::create_dir_all(&folder).unwrap();
        std::fs::write(folder.join("notes.txt"), "").unwrap();
        assert!(refuse_used(&folder).is_ok(), "one with other things in it");
        std::fs::write(folder.join("windows.csv"), "").unwrap();
        let reason = refuse_used(&folder).unwrap_err().to_string();
        std::fs::remove_dir_all(&folder).unwrap();
        assert!(reason.contains("windows.csv") && reason.contains("--output"), "{reason}");
    }
}
