//! The new lines of a log that a running module writes.

use std::fs::File;
use std::io::{Read, Result, Seek, SeekFrom};
use std::path::PathBuf;

/// Bytes that are read at a look, and of a line at most.
const MOST: u64 = 1 << 20;

/// A file of which each line is given once. It need not be there yet.
#[derive(Debug)]
pub struct Tail {
    path: PathBuf,
    file: Option<File>,
    /// Of a file that is long already the last lines are enough.
    only_last: bool,
    /// A line that has begun.
    rest: Vec<u8>,
}

impl Tail {
    /// The lines of a file from its first.
    #[must_use]
    pub fn from_first(path: PathBuf) -> Self {
        Self { path, file: None, only_last: false, rest: Vec::new() }
    }

    /// The lines of a file, of a long one those of the last MiB.
    #[must_use]
    pub fn of_last(path: PathBuf) -> Self {
        Self { only_last: true, ..Self::from_first(path) }
    }

    /// The whole lines that have come since the last look, of one MiB at most. What is no UTF-8 is replaced.
    pub fn lines(&mut self) -> Vec<String> {
        self.read().unwrap_or_default() // no file yet, or none any more
    }

    fn read(&mut self) -> Result<Vec<String>> {
        let file = match &mut self.file {
            Some(file) => file,
            None => self.file.insert(open(&self.path, self.only_last)?),
        };
        // A module that begins anew empties its logs.
        if file.metadata()?.len() < file.stream_position()? {
            file.seek(SeekFrom::Start(0))?;
            self.rest.clear();
        }
        file.take(MOST).read_to_end(&mut self.rest)?;
        let whole = self.rest.iter().rposition(|byte| *byte == b'\n').map_or(0, |last| last + 1);
        let lines: Vec<u8> = self.rest.drain(..whole).collect();
        if self.rest.len() as u64 > MOST {
            self.rest.clear(); // no line of ours
        }
        let lines = String::from_utf8_lossy(&lines);
        Ok(lines.lines().filter(|line| !line.is_empty()).map(str::to_owned).collect())
    }
}

fn open(path: &PathBuf, only_last: bool) -> Result<File> {
    let mut file = File::open(path)?;
    let length = file.metadata()?.len();
    if only_last && length > MOST {
        file.seek(SeekFrom::Start(length - MOST))?;
        let mut byte = [0];
        // The line that the place lies in is left out.
        while file.read(&mut byte)? == 1 && byte[0] != b'\n' {}
    }
    Ok(file)
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    #[test]
    fn lines_come_once_and_whole_and_those_of_a_file_that_begins_anew_too() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let mut tail = Tail::from_first(path.clone());
        assert!(tail.lines().is_empty());
        let mut file = File::create(&path).unwrap();
        file.write_all(b"one\ntw").unwrap();
        assert_eq!(tail.lines(), ["one"]);
        file.write_all(b"o\nthree\n").unwrap();
        assert_eq!(tail.lines(), ["two", "three"]);
        assert!(tail.lines().is_empty());
        file.set_len(0).unwrap();
        file.rewind().unwrap();
        file.write_all(b"new\n").unwrap();
        assert_eq!(tail.lines(), ["new"]);
    }

    #[test]
    fn of_a_long_file_the_last_whole_lines_come_or_all() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log");
        let text: String = (0..200_000).map(|number| format!("line {number}\n")).collect();
        std::fs::write(&path, &text).unwrap();
        let last = Tail::of_last(path.clone()).lines();
        assert_eq!(last.last().unwrap(), "line 199999");
        assert!(last.len() < 200_000 && last.iter().all(|line| line.starts_with("line ")));
        let mut all = Tail::from_first(path);
        let looks: Vec<usize> =
            std::iter::repeat_with(|| all.lines().len()).take_while(|count| *count > 0).collect();
        assert_eq!(looks.iter().sum::<usize>(), 200_000);
        assert!(looks.len() > 1, "a look is bounded");
    }
}
