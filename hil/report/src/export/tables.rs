//! One file of comma-separated values a port: module time, sequence, and a column for each value.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use super::{ExportError, Exported, Sink, check_folder};
use crate::flight::PORTS_FILE;
use crate::log::{self, Entry};

/// The partition and the port of a topic, "/partition/port".
pub(super) fn port_of(topic: &str) -> (&str, &str) {
    let topic = topic.trim_start_matches('/');
    topic.split_once('/').unwrap_or((topic, "port"))
}

/// Writes `partition.port.csv` for every port of a run's `folder` into the folder `into`, which is made where it is missing.
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
            let mut sink = Sink::create(&into.join(file_name(entry.topic)))?;
            sink.write(format!("time_ns,sequence,{}\n", layout.columns().join(",")).as_bytes());
            self.files.insert(entry.topic.to_owned(), sink);
        }
        if let Some(sink) = self.files.get_mut(entry.topic) {
            sink.write(self.line.as_bytes());
            self.rows += 1;
        }
        Ok(())
    }

    fn finish(self, exported: &mut Exported) -> Result<u64, ExportError> {
        for (topic, count) in self.unreadable {
            exported.note(&topic, format_args!("{count} messages do not fit what the log says of them"));
        }
        self.files.into_values().try_for_each(Sink::finish)?;
        Ok(self.rows)
    }
}

/// A name that stays in its folder, whatever the topic holds.
fn file_name(topic: &str) -> String {
    let (partition, port) = port_of(topic);
    let plain = |name: &str| name.replace(|c: char| !(c.is_alphanumeric() || c == '_' || c == '-'), "_");
    format!("{}.{}.csv", plain(partition), plain(port))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn file_name_stays_in_its_folder() {
        assert_eq!(file_name("/estimator/state"), "estimator.state.csv");
        assert_eq!(file_name("/../../etc/passwd"), "__.___etc_passwd.csv");
        assert_eq!(file_name("alone"), "alone.port.csv");
    }
}
