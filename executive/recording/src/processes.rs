//! `processes.csv`: who ran when in the windows of partitions of several processes.
//!
//! One line a span: `partition,process,from_ns,to_ns`, ns of module time, in each partition in the order of time. A span without a
//! process's name stands for those that were left out. A run without such partitions has no such file.

use std::fs::File;
use std::io::{BufRead, BufReader, ErrorKind};
use std::path::Path;

/// Name of the file in a run's folder.
pub const FILE: &str = "processes.csv";

/// A stretch of time in which one process had its partition's processor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Span {
    /// The partition.
    pub partition: String,
    /// The process, or `error handler`; `None`: what ran is not recorded.
    pub process: Option<String>,
    /// ns.
    pub from_ns: u64,
    /// ns.
    pub to_ns: u64,
}

impl Span {
    /// Reads one line; `None` if it is not a whole one.
    pub fn parse(line: &str) -> Option<Self> {
        let cells: Vec<&str> = line.split(',').collect();
        let [partition, process, from_ns, to_ns] = cells.as_slice() else { return None };
        let (from_ns, to_ns) = (from_ns.parse().ok()?, to_ns.parse().ok()?);
        let process = (!process.is_empty()).then(|| (*process).to_owned());
        (from_ns <= to_ns).then(|| Self { partition: (*partition).to_owned(), process, from_ns, to_ns })
    }
}

/// Gives every span of the file to `each`; returns how many lines were none. Without the file there is none.
///
/// # Errors
/// The file is there and can not be read.
pub fn for_each(path: &Path, mut each: impl FnMut(Span)) -> std::io::Result<usize> {
    let file = match File::open(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(0),
        file => file?,
    };
    let mut reader = BufReader::with_capacity(1 << 18, file);
    let (mut line, mut broken) = (Vec::new(), 0);
    while reader.read_until(b'\n', &mut line)? > 0 {
        let text = std::str::from_utf8(&line).unwrap_or_default().trim_ascii();
        match Span::parse(text) {
            Some(span) => each(span),
            None if text.starts_with("partition,process,") => {}
            None => broken += 1,
        }
        line.clear();
    }
    Ok(broken)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spans_are_read_and_lines_that_are_none_counted() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(FILE);
        assert_eq!(for_each(&path, |_| panic!("there is no file")).unwrap(), 0);
        let text = "partition,process,from_ns,to_ns\nown,fast,10,20\nown,,20,30\nown,fast,30,29\nown,fa";
        std::fs::write(&path, text).unwrap();
        let mut found = Vec::new();
        let broken = for_each(&path, |span| found.push((span.process, span.from_ns, span.to_ns))).unwrap();
        assert_eq!((found, broken), (vec![(Some("fast".into()), 10, 20), (None, 20, 30)], 2));
    }
}
