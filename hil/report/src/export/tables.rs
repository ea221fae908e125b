//! One file of comma-separated values a port: module time, sequence, and a column for each value.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::Path;

use super::{ExportError, Exported, Sink, check_folder};
use bateleur_recording::PORTS_FILE;
use bateleur_recording::{self as log, Entry};

/// The partition and the port of a topic, "/partition/port".
pub(super) fn port_of(topic: &str) -> (&str, &str) {
    let topic = topic.trim_start_matches('/');
    topic.split_once('/').unwrap_or((topic, "port"))
}

/// Writes `partition.port.csv` for every port of a run's `folder` into the folder `into`, which is made where it is missing. Of
/// ports whose names are the same in a file's name, the second one becomes `partition.port.2.csv`.
pub fn tables(folder: &Path, into: &Path) -> Result<Exported, ExportError> {
    check_folder(folder)?;
    std::fs::create_dir_all(into).map_err(|why| ExportError::Write { path: into.to_path_buf(), why })?;
    let (mut exported, mut tables) = (Exported::default(), Tables::default());
    let mut failed = None;
    let read = log::for_each(folder.join(PORTS_FILE), |entry| {
        if failed.is_none() {
            failed = tables.add(into, &entry).err();
        }
    });
    match read {
        Ok(ending) => exported.note_ending(&ending),
        Err(error) => exported.note(PORTS_FILE, error),
    }
    failed.map_or(Ok(()), Err)?;
    exported.records = tables.finish(&mut exported)?;
    exported.or_nothing()
}

#[derive(Default)]
struct Tables {
    files: BTreeMap<String, Sink>,
    /// Names that are given away.
    taken: BTreeSet<String>,
    /// Messages whose schema says nothing, or whose bytes are not of it, by topic.
    unreadable: BTreeMap<String, u64>,
    rows: u64,
    line: String,
}

impl Tables {
    fn add(&mut self, into: &Path, entry: &Entry<'_>) -> Result<(), ExportError> {
        self.line.clear();
        // Writing to a string cannot fail.
        let _ = write!(self.line, "{},{}", entry.time_ns, entry.sequence);
        let layout = entry.layout.filter(|layout| layout.cells(entry.bytes, &mut self.line));
        let Some(layout) = layout else {
            *self.unreadable.entry(entry.topic.to_owned()).or_default() += 1;
            return Ok(());
        };
        self.line.push('\n');
        if !self.files.contains_key(entry.topic) {
            let mut sink = Sink::create(&into.join(self.free_name(entry.topic)))?;
            sink.write(format!("time_ns,sequence,{}\n", layout.columns().join(",")).as_bytes());
            self.files.insert(entry.topic.to_owned(), sink);
        }
        if let Some(sink) = self.files.get_mut(entry.topic) {
            sink.write(self.line.as_bytes());
            self.rows += 1;
        }
        Ok(())
    }

    /// A name that no other topic has: `/a/b.c` and `/a/b_c` must not write over each other.
    fn free_name(&mut self, topic: &str) -> String {
        let mut name = file_name(topic, 1);
        for place in 2.. {
            if self.taken.insert(name.clone()) {
                break;
            }
            name = file_name(topic, place);
        }
        name
    }

    fn finish(self, exported: &mut Exported) -> Result<u64, ExportError> {
        for (topic, count) in self.unreadable {
            exported.note(&topic, format_args!("{count} messages do not fit what the log says of them"));
        }
        self.files.into_values().try_for_each(Sink::finish)?;
        Ok(self.rows)
    }
}

/// A name that stays in its folder, whatever the topic holds; `place` among those that would have the same one, from 1 on.
fn file_name(topic: &str, place: u32) -> String {
    let (partition, port) = port_of(topic);
    let plain = |name: &str| name.replace(|c: char| !(c.is_alphanumeric() || c == '_' || c == '-'), "_");
    let place = if place == 1 { String::new() } else { format!(".{place}") };
    format!("{}.{}{place}.csv", plain(partition), plain(port))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_name_stays_in_its_folder() {
        assert_eq!(file_name("/estimator/state", 1), "estimator.state.csv");
        assert_eq!(file_name("/../../etc/passwd", 1), "__.___etc_passwd.csv");
        assert_eq!(file_name("alone", 1), "alone.port.csv");
    }

    #[test]
    fn topics_that_would_share_a_file_name_get_a_file_each() {
        let mut tables = Tables::default();
        let names = ["/a/b.c", "/a/b_c", "/a/b-c", "/a/b c"].map(|topic| tables.free_name(topic));
        assert_eq!(names, ["a.b_c.csv", "a.b_c.2.csv", "a.b-c.csv", "a.b_c.3.csv"]);
    }
}
