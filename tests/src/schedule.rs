//! Schedule files: the flight's, copies of it with something changed, and small ones for the test partitions.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use crate::programs::{program, repository};

/// The flight's schedule file.
pub fn flight_schedule() -> PathBuf {
    repository().join("schedule.toml")
}

/// A mission that is over after 75 s of module time.
pub fn small_mission() -> PathBuf {
    repository().join("tests/missions/small.toml")
}

/// A mission of so many laps of that triangle, some 50 s each, in a file of `folder`.
#[track_caller]
pub fn laps_of_small_mission(folder: &Path, laps: u32) -> PathBuf {
    let mut text = std::fs::read_to_string(small_mission()).unwrap();
    for (old, new) in
        [("laps = 1", format!("laps = {laps}")), ("time_limit_s = 180", "time_limit_s = 1800".into())]
    {
        assert!(text.contains(old), "small.toml no longer has {old:?}: correct this helper");
        text = text.replace(old, &new);
    }
    let path = folder.join("laps.toml");
    std::fs::write(&path, text).unwrap();
    path
}

/// The text of the flight's schedule with each first text replaced by its second, everywhere.
#[track_caller]
pub fn edited(changes: &[(&str, &str)]) -> String {
    let mut text = std::fs::read_to_string(flight_schedule()).unwrap();
    for (old, new) in changes {
        assert!(text.contains(old), "schedule.toml no longer has {old:?}: correct this test");
        text = text.replace(old, new);
    }
    text
}

/// The number of the first line of `text` that has `part`.
#[track_caller]
pub fn line_of(text: &str, part: &str) -> usize {
    1 + text.lines().position(|line| line.contains(part)).expect("the part stands in the text")
}

/// A small schedule: partitions on one core, their windows one after the other in a minor frame of 20 ms.
#[derive(Debug, Clone)]
pub struct Sketch {
    head: String,
    partitions: String,
    windows: String,
    next_us: u32,
}

impl Default for Sketch {
    fn default() -> Self {
        Self { head: String::new(), partitions: String::new(), windows: String::new(), next_us: 200 }
    }
}

impl Sketch {
    /// Without partitions.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds tables or keys before the partitions, such as a `[[channel]]`.
    #[must_use]
    pub fn table(mut self, text: &str) -> Self {
        self.head.push_str(text);
        self.head.push('\n');
        self
    }

    /// Adds a partition that runs one of the test programs in a window of `window_us`. `keys`: further lines.
    #[must_use]
    pub fn partition(self, name: &str, runs: &str, window_us: u32, keys: &str) -> Self {
        self.partition_at(name, &program(runs), window_us, keys)
    }

    /// As above, with a program that lies somewhere.
    #[must_use]
    pub fn partition_at(mut self, name: &str, path: &Path, window_us: u32, keys: &str) -> Self {
        writeln!(
            self.partitions,
            "[partition.{name}]\nprogram = \"{}\"\nmodule = \"test\"\nmemory = \"96MiB\"\n{keys}\n",
            path.display()
        )
        .unwrap();
        writeln!(
            self.windows,
            "    {{ partition = \"{name}\", offset = \"{}us\", duration = \"{window_us}us\" }},",
            self.next_us
        )
        .unwrap();
        self.next_us += window_us + 500;
        self
    }

    /// The file's text.
    pub fn text(&self) -> String {
        format!(
            "[module.test]\ncores = [1]\n\n[schedule.only]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\ninitial = true\n\
             window = [\n{}]\n\n{}\n{}",
            self.windows, self.head, self.partitions
        )
    }

    /// Writes it into a folder.
    pub fn write(&self, folder: &Path) -> String {
        let path = folder.join("test.toml");
        std::fs::write(&path, self.text()).unwrap();
        path.to_str().unwrap().to_owned()
    }
}

fn port(name: &str, direction: &str, kind: &str) -> String {
    let message = if kind == "queuing" { "GroundMessage" } else { "FunctionStatus" };
    let more = match (direction, kind) {
        ("destination", "sampling") => ", refresh = \"100ms\"",
        ("destination", _) => ", depth = 8",
        _ => "",
    };
    format!("{name} = {{ direction = \"{direction}\", kind = \"{kind}\", message = \"{message}\"{more} }}\n")
}

/// The table of ports of a partition: name, direction, kind of each. Messages are those of the partition `neighbour`.
pub fn ports_of(partition: &str, all: &[(&str, &str, &str)]) -> String {
    let lines: String = all.iter().map(|(name, direction, kind)| port(name, direction, kind)).collect();
    format!("[partition.{partition}.port]\n{lines}")
}

/// A channel between two ports, such as `"before.numbers"`.
pub fn channel_between(source: &str, destination: &str) -> String {
    format!("[[channel]]\nsource = \"{source}\"\ndestinations = [\"{destination}\"]\n")
}
