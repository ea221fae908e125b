//! Who ran when in partitions of several processes: read from their process tables, written as `processes.csv`.
//!
//! A partition writes what it likes into its table. So spans lie one behind the other and none in the future, a name is a name, and
//! both the lines of a partition in a second and the bytes of the file are bounded: beyond that, one line stands for what is left out.

use std::io;
use std::path::{Path, PathBuf};

use bateleur_contract::{ProcessTable, Switch};

use crate::lines::{LineLog, Patience};
use bateleur_host::trouble::Trouble;

/// Name of the file in a run's folder.
pub(crate) const FILE: &str = "processes.csv";
/// The first line.
const HEADING: &[u8] = b"partition,process,from_ns,to_ns\n";
/// Bytes that are written at once.
const PIECE_BYTES: usize = 1 << 16;
/// Bytes of the file, most: some two million spans.
const MOST_BYTES: u64 = 64 << 20;
/// Spans of one partition that are written in a second of module time, most: 64 processes that all run in each of 50 windows.
const SPANS_A_SECOND: u32 = 4_000;

/// The file. There is none until somebody has run.
#[derive(Debug)]
pub(crate) struct ProcessLog {
    path: PathBuf,
    patience: Patience,
    lines: Option<LineLog>,
    bytes: u64,
    /// Of a file that could not be made.
    trouble: Trouble,
    line: Vec<u8>,
}

impl ProcessLog {
    /// In a run's folder, where no older one is left.
    pub(crate) fn create(folder: &Path, patience: Patience) -> Self {
        let _ = std::fs::remove_file(folder.join(FILE)); // there is none, as a rule
        Self::go_on(folder, patience)
    }

    /// That of an executive which has died is gone on with.
    pub(crate) fn go_on(folder: &Path, patience: Patience) -> Self {
        let path = folder.join(FILE);
        Self { path, patience, lines: None, bytes: 0, trouble: Trouble::default(), line: Vec::new() }
    }

    /// Appends a span of a process; of nobody known where its name is empty.
    fn write(&mut self, partition: &str, process: &str, from_ns: u64, to_ns: u64) {
        if self.bytes >= MOST_BYTES {
            return self.trouble.lose(1, "it has grown to 64 MiB");
        }
        self.line.clear();
        let mut number = itoa::Buffer::new();
        for cell in [partition.as_bytes(), process.as_bytes(), number.format(from_ns).as_bytes()] {
            self.line.extend_from_slice(cell);
            self.line.push(b',');
        }
        self.line.extend_from_slice(number.format(to_ns).as_bytes());
        self.line.push(b'\n');
        match self.open() {
            Ok(()) => {}
            Err(error) => return self.trouble.lose(1, &error.to_string()),
        }
        self.bytes += self.line.len() as u64;
        if let Some(lines) = &mut self.lines {
            lines.push(&self.line);
        }
    }

    fn open(&mut self) -> io::Result<()> {
        if self.lines.is_some() {
            return Ok(());
        }
        let mut lines = LineLog::go_on(&self.path, PIECE_BYTES, self.patience)?;
        self.bytes = self.path.metadata().map_or(0, |file| file.len());
        if self.bytes == 0 {
            lines.push(HEADING);
        }
        self.lines = Some(lines);
        Ok(())
    }

    /// Hands all lines to the thread that writes them.
    pub(crate) fn flush(&mut self) {
        self.lines.iter_mut().for_each(LineLog::flush);
    }

    /// Waits a little until everything was written.
    pub(crate) fn finish(&mut self) {
        self.lines.iter_mut().for_each(LineLog::finish);
    }

    /// Why spans were lost, the first time.
    pub(crate) fn take_trouble(&mut self) -> Option<String> {
        let lines = self.lines.as_ref().and_then(|lines| lines.trouble().take());
        lines.or_else(|| self.trouble.take())
    }

    /// Spans lost so far.
    pub(crate) fn lost(&self) -> u64 {
        self.trouble.lost() + self.lines.as_ref().map_or(0, |lines| lines.trouble().lost())
    }
}

/// What is known of one partition's switches.
#[derive(Debug, Default)]
pub(crate) struct Spans {
    seen: u32,
    /// Who runs, and since when.
    place: u8,
    since_ns: u64,
    /// A second of module time, and the spans that were written in it.
    second: (u64, u32),
    /// Since when spans are left out.
    left_out_ns: Option<u64>,
}

impl Spans {
    /// A new process of the partition begins: what the one before did is over.
    pub(crate) fn begin(&mut self, table: &ProcessTable) {
        (self.seen, self.place) = (table.switched(), 0);
    }

    /// Writes who has run since the last look; `now_ns`: nobody has run beyond it.
    pub(crate) fn take(&mut self, table: &ProcessTable, partition: &str, now_ns: u64, log: &mut ProcessLog) {
        let mut seen = self.seen;
        let before_ns = self.since_ns;
        let mut switches = Vec::new();
        let lost = table.switches_since(&mut seen, |switch| switches.push(switch));
        self.seen = seen;
        if lost > 0 {
            self.left_out_ns.get_or_insert(before_ns);
            self.place = 0;
        }
        for Switch { time_ns, place } in switches {
            let at_ns = time_ns.clamp(self.since_ns, now_ns.max(self.since_ns));
            if self.place != 0 && at_ns > self.since_ns {
                self.span(table, partition, at_ns, log);
            } else if self.left_out_ns.is_some() && place != 0 {
                self.tell_left_out(partition, at_ns, log);
            }
            (self.place, self.since_ns) = (place, at_ns);
        }
    }

    fn span(&mut self, table: &ProcessTable, partition: &str, until_ns: u64, log: &mut ProcessLog) {
        let second = until_ns / 1_000_000_000;
        if self.second.0 != second {
            self.second = (second, 0);
        }
        self.second.1 = self.second.1.saturating_add(1);
        if self.second.1 > SPANS_A_SECOND {
            self.left_out_ns.get_or_insert(self.since_ns);
            return;
        }
        self.tell_left_out(partition, self.since_ns, log);
        let name = table.name_at(self.place).unwrap_or_else(|| format!("process {}", self.place));
        log.write(partition, &name, self.since_ns, until_ns);
    }

    fn tell_left_out(&mut self, partition: &str, until_ns: u64, log: &mut ProcessLog) {
        if let Some(from_ns) = self.left_out_ns.take() {
            log.write(partition, "", from_ns, until_ns);
        }
    }
}

#[cfg(test)]
mod tests {
    use bateleur_contract::process_table::{ProcessRow, SWITCHES};
    use bateleur_contract::{Mapped, ProcessTable};
    use rustix::fs::{MemfdFlags, ftruncate, memfd_create};

    use super::*;

    /// Switches of two processes, and the lines that they make; looked at after each part.
    fn lines(parts: &[&[(u64, u8)]], now_ns: u64) -> Vec<String> {
        let file = memfd_create("processes", MemfdFlags::CLOEXEC).unwrap();
        ftruncate(&file, size_of::<ProcessTable>() as u64).unwrap();
        let table: Mapped<ProcessTable> = Mapped::new(&file).unwrap();
        let rows = ["fast", "sl,ow\n"].map(|name| ProcessRow { name: name.into(), ..ProcessRow::default() });
        table.write(None, rows.iter());
        let folder = tempfile::tempdir().unwrap();
        let mut log = ProcessLog::create(folder.path(), Patience::Wait);
        let mut spans = Spans::default();
        for part in parts {
            part.iter().for_each(|&(time_ns, place)| table.switch(Switch { time_ns, place }));
            spans.take(&table, "own", now_ns, &mut log);
        }
        log.finish();
        assert_eq!(log.take_trouble(), None);
        let text = std::fs::read_to_string(folder.path().join(FILE)).unwrap_or_default();
        text.lines().skip(1).map(str::to_owned).collect()
    }

    #[test]
    fn span_lasts_until_the_next_switch_also_over_two_looks() {
        let found = lines(&[&[(100, 2), (150, 3)], &[(180, 2), (200, 0), (300, 1), (310, 0)]], 1_000);
        let expected =
            ["own,fast,100,150", "own,sl_ow_,150,180", "own,fast,180,200", "own,error handler,300,310"];
        assert_eq!(found, expected);
        assert!(lines(&[&[], &[]], 1_000).is_empty(), "no file where nobody has run");
    }

    #[test]
    fn spans_of_a_partition_that_lies_are_in_order_and_in_the_past() {
        let found = lines(&[&[(900, 2), (100, 3), (u64::MAX >> 8, 200), (5, 2), (950, 0)]], 1_000);
        assert_eq!(found, ["own,process 3,900,1000"].map(|line| line.replace("process 3", "sl_ow_")));
    }

    #[test]
    fn flood_is_bounded_and_one_line_stands_for_what_is_left_out() {
        let flood = |from: u64, count: u64| -> Vec<(u64, u8)> {
            (0..count).map(|n| (from + 10 * n, 2 + (n % 2) as u8)).collect()
        };
        let places = SWITCHES as u64;
        let found = lines(&[&flood(0, 50), &flood(1_000, places + 100), &[(900_000_000, 0)]], u64::MAX);
        assert_eq!(found.iter().filter(|line| line.starts_with("own,,")).count(), 1, "overwritten");
        assert_eq!(found[49], "own,,490,2010", "{:?}", &found[48..52]);
        let parts: Vec<_> = (0..5).map(|part| flood(part * 100_000, places - 1)).collect();
        let parts: Vec<&[(u64, u8)]> = parts.iter().map(Vec::as_slice).collect();
        let last: &[(u64, u8)] = &[(1_500_000_000, 2), (1_500_000_100, 0)];
        let found = lines(&[&parts[..], &[last]].concat(), u64::MAX);
        assert_eq!(found.len() as u64, u64::from(SPANS_A_SECOND) + 3, "{:?}", &found[found.len() - 3..]);
        assert!(found[found.len() - 3].starts_with("own,,"), "{:?}", &found[found.len() - 3..]);
    }
}
