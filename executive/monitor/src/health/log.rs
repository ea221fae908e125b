//! The health log (`health.jsonl`, one object a line, and the persistent `health.ring`) and the window log (`windows.csv`).
//!
//! Responsible for: lines that are whole. A disk that is full or gone costs lines, which are counted, and never the module.

use std::io;
use std::path::Path;

use serde::Serialize;

use super::journal::Journal;
use super::record::{Entry, Level};
use super::ring::{self, RingLog};
use crate::lines::{LineLog, Patience};
use crate::process_log::{self, ProcessLog};
use bateleur_host::trouble::Trouble;
use bateleur_time::run_page::Heartbeat;
use bateleur_time::window_record::WindowRecord;

/// One fault, from its detection to the successor's first window.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Fault {
    /// Module time of the detection, ns.
    pub time_ns: u64,
    /// Where it was dealt with.
    pub level: Level,
    /// The partition; `None`: the module itself.
    pub partition: Option<String>,
    /// The incarnation that failed; of a module, the number of its resets before.
    pub generation: u32,
    /// The error, as the health tables name it.
    pub error: String,
    /// What was done.
    pub action: String,
    /// What is known beside it.
    pub detail: String,
    /// Module time of the successor's first window, ns; null where there was none (yet).
    pub recovered_ns: Option<u64>,
}

/// A log that lost records, and why.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lost {
    /// The file.
    pub log: &'static str,
    /// Why.
    pub why: String,
}

/// An entry as a partition is told of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Notice {
    /// As in syslog: 1 alert, 2 critical, 3 error, 4 warning, 5 notice.
    pub severity: u32,
    /// Who, what, and what was done about it.
    pub text: String,
}

impl Notice {
    fn of(fault: &Fault) -> Self {
        let Fault { error, action, detail, .. } = fault;
        let who = fault.partition.as_deref().unwrap_or("the module");
        Self { severity: severity(action), text: format!("{who}: {error} -> {action} ({detail})") }
    }
}

/// As in syslog.
const NOTICE: u32 = 5;
/// As in syslog.
const INFORMATION: u32 = 6;

/// How bad it is that this had to be done.
fn severity(action: &str) -> u32 {
    match action {
        "ignore" | "error_handler" => 4,
        "idle" => 2,
        "stop" | "shutdown" | "reset" => 1,
        _ => 3,
    }
}

/// Entries that wait to be told, most: what nobody fetches must not grow.
const NOTICES: usize = 64;

/// Notes faults: at once in the ring, and as a line when it is known what became of them.
#[derive(Debug)]
pub struct HealthLog {
    lines: LineLog,
    ring: Option<RingLog>,
    ring_trouble: Trouble,
    /// Where it is told as well.
    journal: Option<Journal>,
    /// The minor frame of the last window that is known.
    frame: u64,
    /// What partitions are to be told.
    notices: Vec<Notice>,
}

impl HealthLog {
    /// A new log in a run's folder; the ring there is gone on with.
    ///
    /// # Errors
    /// `health.jsonl` can not be made. A ring that can not be opened is told as trouble.
    pub fn create(
        folder: &Path,
        ring: bateleur_plan::HealthLog,
        patience: Patience,
        beat: Heartbeat,
    ) -> io::Result<Self> {
        Self::of(LineLog::create(&folder.join(HEALTH_FILE), 0, patience)?, folder, ring, beat)
    }

    /// That of an executive which has died is gone on with.
    ///
    /// # Errors
    /// As [`HealthLog::create`].
    pub fn go_on(
        folder: &Path,
        ring: bateleur_plan::HealthLog,
        patience: Patience,
        beat: Heartbeat,
    ) -> io::Result<Self> {
        Self::of(LineLog::go_on(&folder.join(HEALTH_FILE), 0, patience)?, folder, ring, beat)
    }

    fn of(
        lines: LineLog,
        folder: &Path,
        ring: bateleur_plan::HealthLog,
        beat: Heartbeat,
    ) -> io::Result<Self> {
        let ring = RingLog::open(&folder.join(ring::FILE), ring.bytes, ring.policy, beat);
        let (ring, ring_trouble) = match ring {
            Ok(ring) => (Some(ring), Trouble::default()),
            Err(error) => {
                let mut trouble = Trouble::default();
                trouble.lose(1, &error.to_string());
                (None, trouble)
            }
        };
        Ok(Self { lines, ring, ring_trouble, journal: None, frame: 0, notices: Vec::new() })
    }

    /// From now on a journal is told, too.
    pub fn tell_journal(&mut self, journal: Option<Journal>) {
        self.journal = journal;
    }

    /// Frames are counted from 0 again.
    pub fn begin_frames(&mut self) {
        self.frame = 0;
    }

    /// The minor frame that the next entries belong to.
    pub fn set_frame(&mut self, frame: u64) {
        self.frame = self.frame.max(frame);
    }

    /// Notes in the ring what has been decided about a fault.
    pub fn note(&mut self, fault: &Fault) {
        let notice = Notice::of(fault);
        let said = (notice.severity, notice.text.clone());
        self.tell(notice);
        self.add(
            said,
            Entry {
                sequence: 0,
                time_ns: fault.time_ns,
                frame: self.frame,
                generation: fault.generation,
                level: fault.level,
                partition: fault.partition.clone().unwrap_or_default(),
                error: fault.error.clone(),
                action: fault.action.clone(),
                detail: fault.detail.clone(),
            },
        );
    }

    /// Notes in the ring that a fault's successor had its first window.
    pub fn note_recovery(&mut self, fault: &Fault, generation: u32, time_ns: u64) {
        let after_ms = time_ns.saturating_sub(fault.time_ns) as f64 / 1e6;
        let who = fault.partition.as_deref().unwrap_or("the module");
        let text = format!("{who}: back after {after_ms:.1} ms");
        self.tell(Notice { severity: NOTICE, text: text.clone() });
        self.add(
            (NOTICE, text),
            Entry {
                sequence: 0,
                time_ns,
                frame: self.frame,
                generation,
                level: fault.level,
                partition: fault.partition.clone().unwrap_or_default(),
                error: "recovered".into(),
                action: String::new(),
                detail: format!("after {after_ms:.1} ms"),
            },
        );
    }

    /// Notes in the ring what a partition has said; it is no error, and nobody is told.
    pub fn note_message(&mut self, partition: &str, generation: u32, text: String, time_ns: u64) {
        self.add(
            (INFORMATION, format!("{partition}: {text}")),
            Entry {
                sequence: 0,
                time_ns,
                frame: self.frame,
                generation,
                level: Level::Partition,
                partition: partition.into(),
                error: "message".into(),
                action: String::new(),
                detail: text,
            },
        );
    }

    /// Notes in the ring what became of the module.
    pub fn note_module(&mut self, what: &str, detail: String, time_ns: u64) {
        self.add(
            (NOTICE, format!("the module: {what} ({detail})")),
            Entry {
                sequence: 0,
                time_ns,
                frame: self.frame,
                generation: 0,
                level: Level::Module,
                partition: String::new(),
                error: what.into(),
                action: String::new(),
                detail,
            },
        );
    }

    fn tell(&mut self, notice: Notice) {
        if self.notices.len() < NOTICES {
            self.notices.push(notice);
        }
    }

    /// What partitions are to be told, since it was last asked.
    pub fn take_notices(&mut self) -> Vec<Notice> {
        std::mem::take(&mut self.notices)
    }

    /// `severity` and `text` are what the journal is told beside the entry.
    fn add(&mut self, (severity, text): (u32, String), entry: Entry) {
        let journal_trouble = self.journal.as_mut().and_then(|journal| {
            journal.note(&entry, severity, &text);
            journal.trouble().take()
        });
        let time_ns = entry.time_ns;
        self.add_to_ring(entry);
        // The journal has a copy: that it misses some is worth knowing, and no fault of the run.
        if let Some(detail) = journal_trouble {
            self.add_to_ring(Entry {
                sequence: 0,
                time_ns,
                frame: self.frame,
                generation: 0,
                level: Level::Module,
                partition: String::new(),
                error: "journal_loses_entries".into(),
                action: String::new(),
                detail,
            });
        }
    }

    fn add_to_ring(&mut self, entry: Entry) {
        match &mut self.ring {
            Some(ring) => ring.note(entry),
            None => self.ring_trouble.lose(1, "it could not be opened"),
        }
    }

    /// Appends a fault as a line.
    pub fn write(&mut self, fault: &Fault) {
        match serde_json::to_vec(fault) {
            Ok(mut line) => {
                line.push(b'\n');
                self.lines.push(&line);
            }
            Err(error) => self.lines.trouble().lose(1, &error.to_string()),
        }
    }

    /// Logs that have lost records for the first time.
    pub fn take_trouble(&mut self) -> impl Iterator<Item = Lost> + use<> {
        let lines = self.lines.trouble().take();
        let ring = self.ring.as_ref().and_then(|ring| ring.trouble().take());
        let ring = ring.or_else(|| self.ring_trouble.take());
        let lines = lines.map(|why| Lost { log: HEALTH_FILE, why });
        lines.into_iter().chain(ring.map(|why| Lost { log: ring::FILE, why }))
    }

    /// Records lost so far.
    #[must_use]
    pub fn lost(&self) -> u64 {
        let ring = self.ring.as_ref().map_or(0, |ring| ring.trouble().lost());
        self.lines.trouble().lost() + ring + self.ring_trouble.lost()
    }

    /// Waits a little until everything is on the disk.
    pub fn finish(&mut self) {
        self.lines.finish();
        if let Some(ring) = &mut self.ring {
            ring.finish();
        }
    }
}

/// Name of the health log's lines in a run's folder.
const HEALTH_FILE: &str = "health.jsonl";
/// Name of the window log in a run's folder.
const WINDOW_FILE: &str = "windows.csv";

/// The first line of the window log.
const HEADING: &[u8] = b"frame,minor,core,partition,planned_start_ns,planned_end_ns,granted_ns,opened_ns,closed_ns,flags,slack_ns,schedule\n";
/// Bytes of it that are written at once.
const PIECE_BYTES: usize = 1 << 16;
/// As above where another executive may go on with the log.
const SMALL_PIECE_BYTES: usize = 1 << 10;

/// Writes window records as lines of comma-separated values, and beside them who ran in the windows of partitions of several
/// processes.
#[derive(Debug)]
pub struct WindowLog {
    lines: LineLog,
    pub(crate) processes: ProcessLog,
    /// The line that is being made.
    line: Vec<u8>,
}

impl WindowLog {
    /// A new log with its heading in a run's folder.
    ///
    /// # Errors
    /// It can not be made.
    pub fn create(folder: &Path, patience: Patience) -> io::Result<Self> {
        let mut lines = LineLog::create(&folder.join(WINDOW_FILE), PIECE_BYTES, patience)?;
        lines.push(HEADING);
        Ok(Self { lines, processes: ProcessLog::create(folder, patience), line: Vec::new() })
    }

    /// Hands a window to the disk soon after it: whoever dies loses few.
    #[must_use]
    pub fn in_small_pieces(mut self) -> Self {
        self.lines.hand_over_at(SMALL_PIECE_BYTES);
        self
    }

    /// That of an executive which has died is gone on with.
    ///
    /// # Errors
    /// It can not be written.
    pub fn go_on(folder: &Path, patience: Patience) -> io::Result<Self> {
        let path = folder.join(WINDOW_FILE);
        let is_new = path.metadata().map_or(true, |file| file.len() < HEADING.len() as u64);
        if is_new {
            return Self::create(folder, patience);
        }
        let lines = LineLog::go_on(&path, PIECE_BYTES, patience)?;
        Ok(Self { lines, processes: ProcessLog::go_on(folder, patience), line: Vec::new() })
    }

    /// Appends a record of the partition called `name`, in the schedule of that name.
    pub fn write(&mut self, record: &WindowRecord, name: &str, schedule: &str) {
        let at = &record.occurrence;
        self.line.clear();
        self.number(Some(at.major_frame));
        self.number(Some(at.window.minor.into()));
        self.number(Some(at.core.into()));
        self.text(name);
        self.number(Some(at.start_ns));
        self.number(Some(at.end_ns));
        self.number(record.granted_ns);
        self.number(record.opened_ns);
        self.number(record.closed_ns);
        record.flags(&mut self.line);
        self.line.push(b',');
        self.number(record.slack_ns());
        self.line.extend_from_slice(schedule.as_bytes());
        self.line.push(b'\n');
        self.lines.push(&self.line);
    }

    /// A number or nothing, and a comma. A line has ten of them: the formatting of the standard library took 4 % of the
    /// executive's time on the virtual clock.
    fn number(&mut self, number: Option<u64>) {
        if let Some(number) = number {
            self.line.extend_from_slice(itoa::Buffer::new().format(number).as_bytes());
        }
        self.line.push(b',');
    }

    fn text(&mut self, text: &str) {
        self.line.extend_from_slice(text.as_bytes());
        self.line.push(b',');
    }

    /// Hands all lines to the thread that writes them.
    pub fn flush(&mut self) {
        self.lines.flush();
        self.processes.flush();
    }

    /// Waits a little until everything was written.
    pub fn finish(&mut self) {
        self.lines.finish();
        self.processes.finish();
    }

    /// That it has lost records for the first time.
    pub fn take_trouble(&mut self) -> Option<Lost> {
        let lost = self.lines.trouble().take().map(|why| Lost { log: WINDOW_FILE, why });
        lost.or_else(|| self.processes.take_trouble().map(|why| Lost { log: process_log::FILE, why }))
    }

    /// Records lost so far.
    #[must_use]
    pub fn lost(&self) -> u64 {
        self.lines.trouble().lost() + self.processes.lost()
    }
}

#[cfg(test)]
mod tests {
    use bateleur_time::dispatcher::{Ending, LATE_NS, Occurrence};
    use bateleur_time::window_record::Missed;

    use std::os::unix::fs::symlink;

    use super::*;
    use bateleur_plan::LogPolicy;

    const RING: bateleur_plan::HealthLog =
        bateleur_plan::HealthLog { bytes: 4096, policy: LogPolicy::Overwrite };

    fn fault(time_ns: u64) -> Fault {
        Fault {
            time_ns,
            level: Level::Partition,
            partition: Some("imu".into()),
            generation: 0,
            error: "killed".into(),
            action: "warm_restart".into(),
            detail: String::new(),
            recovered_ns: None,
        }
    }

    #[test]
    fn health_log_on_a_full_disk_is_said_once_and_counted() {
        let folder = tempfile::tempdir().unwrap();
        symlink("/dev/full", folder.path().join(HEALTH_FILE)).unwrap();
        symlink("/dev/full", folder.path().join(ring::FILE)).unwrap();
        let mut log =
            HealthLog::create(folder.path(), RING, Patience::Wait, Heartbeat::of_health_log(None)).unwrap();
        (0..3).for_each(|time_ns| {
            log.note(&fault(time_ns));
            log.write(&fault(time_ns));
        });
        log.finish();
        let said: Vec<_> = log.take_trouble().collect();
        assert_eq!(said.iter().map(|lost| lost.log).collect::<Vec<_>>(), [HEALTH_FILE, ring::FILE]);
        assert!(said[0].why.contains("No space left"), "{said:?}");
        assert_eq!(log.take_trouble().count(), 0);
        assert_eq!(log.lost(), 3 + 4, "three lines; the opening and three records");
    }

    #[test]
    fn a_line_of_the_window_log_has_every_column_and_nothing_where_there_is_nothing() {
        let plan = crate::test_support::plan_of(
            r#"
            [module.m]
            cores = [2]
            [partition.imu]
            program = "imu"
            module = "m"
            memory = "1MiB"
            [schedule.s]
            major_frame = "40ms"
            minor_frame = "20ms"
            initial = true
            [[schedule.s.window]]
            partition = "imu"
            offset = "2ms"
            duration = "1ms"
            "#,
        );
        let timelines = bateleur_plan::Timeline::all(&plan, plan.module("m").unwrap().id());
        let epoch =
            bateleur_time::dispatcher::ScheduleEpoch { number: 0, schedule: 0, after: None, since_ns: 0 };
        let occurrence = Occurrence {
            window: timelines[0].cores[0].windows[1],
            core: 2,
            epoch,
            major_frame: 7,
            minor_frames: 15,
            minor_frame_ns: 20_000_000,
            start_ns: 302_000_000,
            end_ns: 303_000_000,
            late_ns: LATE_NS + 1,
        };
        let mut record = WindowRecord {
            occurrence,
            member: 0,
            ending: Ending::default(),
            missed: None,
            requested: None,
            granted_ns: Some(302_300_000),
            opened_ns: Some(302_310_000),
            closed_ns: Some(302_900_000),
        };
        let folder = tempfile::tempdir().unwrap();
        let mut log = WindowLog::create(folder.path(), Patience::Wait).unwrap();
        log.write(&record, "imu", "s");
        record.closed_ns = None;
        log.write(&record, "imu", "s");
        (record.granted_ns, record.opened_ns, record.missed) = (None, None, Some(Missed::TooLate));
        log.write(&record, "imu", "s");
        log.finish();
        let text = std::fs::read_to_string(folder.path().join(WINDOW_FILE)).unwrap();
        let lines: Vec<&str> = text.lines().skip(1).collect();
        assert_eq!(
            lines,
            [
                "7,1,2,imu,302000000,303000000,302300000,302310000,302900000,L,100000,s",
                "7,1,2,imu,302000000,303000000,302300000,302310000,,LO,,s",
                "7,1,2,imu,302000000,303000000,,,,LM,,s",
            ]
        );
    }

    #[test]
    fn window_log_on_a_full_disk_is_said_once_and_counted() {
        let folder = tempfile::tempdir().unwrap();
        symlink("/dev/full", folder.path().join(WINDOW_FILE)).unwrap();
        let mut log = WindowLog::create(folder.path(), Patience::Wait).unwrap();
        let line = b"0,0,1,imu,3800000,4300000,3800000,3800000,3900000,,1,flight\n";
        (0..5000).for_each(|_| log.lines.push(line));
        log.finish();
        assert!(log.take_trouble().is_some_and(|lost| lost.why.contains("No space left")));
        assert_eq!(log.take_trouble(), None);
        assert_eq!(log.lost(), 5000 + 1, "every window and the heading");
    }
}
