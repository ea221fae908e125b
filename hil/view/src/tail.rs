//! The new lines of a file that somebody else writes.

use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::PathBuf;

/// Bytes of a file that are read at the first look, from its end, and at each further look.
const MOST: u64 = 1 << 20;

/// See the module's head.
#[derive(Debug)]
pub(crate) struct Tail {
    path: PathBuf,
    file: Option<File>,
    /// A line that has begun.
    rest: Vec<u8>,
}

impl Tail {
    pub(crate) fn of(path: PathBuf) -> Self {
        Self { path, file: None, rest: Vec::new() }
    }

    /// The whole lines that have come since the last look; of a long file its last ones.
    pub(crate) fn lines(&mut self) -> Vec<String> {
        self.read().unwrap_or_default() // no file yet, or none any more
    }

    fn read(&mut self) -> std::io::Result<Vec<String>> {
        if self.file.is_none() {
            let mut file = File::open(&self.path)?;
            let length = file.metadata()?.len();
            if length > MOST {
                file.seek(SeekFrom::Start(length - MOST))?;
                let mut byte = [0];
                // The line that the place lies in is left out.
                while file.read(&mut byte)? == 1 && byte[0] != b'\n' {}
            }
            self.file = Some(file);
        }
        let Some(file) = &mut self.file else { return Ok(Vec::new()) };
        file.take(MOST).read_to_end(&mut self.rest)?;
        let whole = self.rest.iter().rposition(|byte| *byte == b'\n').map_or(0, |last| last + 1);
        let lines: Vec<u8> = self.rest.drain(..whole).collect();
        if self.rest.len() as u64 > MOST {
            self.rest.clear(); // no line of ours
        }
        Ok(String::from_utf8_lossy(&lines).lines().map(str::to_owned).collect())
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn lines_come_once_and_whole_and_of_a_long_file_the_last_ones() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let mut tail = Tail::of(path.clone());
        assert!(tail.lines().is_empty());
        let mut file = File::create(&path).unwrap();
        file.write_all(b"one\ntw").unwrap();
        assert_eq!(tail.lines(), ["one"]);
        file.write_all(b"o\nthree\n").unwrap();
        assert_eq!(tail.lines(), ["two", "three"]);
        assert!(tail.lines().is_empty());
        for number in 0..200_000 {
            writeln!(file, "line {number}").unwrap();
        }
        let lines = Tail::of(path).lines();
        assert_eq!(lines.last().unwrap(), "line 199999");
        assert!(lines.len() < 200_000 && lines.iter().all(|line| line.starts_with("line ")));
    }
}
