//! Runs of generated modules: `bateleur run` as a process of its own, and what it leaves in its folder.

use std::fs;
use std::io;
use std::os::fd::AsRawFd;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::OnceLock;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use bateleur_monitor::event::Event;
use bateleur_system::sched;

/// Longer than any run takes to start and to end beside its own time.
const PATIENCE: Duration = Duration::from_secs(60);

/// Where it tells what happens.
const EVENTS: &str = "events.jsonl";

/// The processors of this program when it began: those of the modules that it runs.
static GIVEN: OnceLock<Vec<u32>> = OnceLock::new();

/// Leaves `core` to the modules: this program would disturb its own measurements there.
pub(super) fn leave(core: u32, given: Vec<u32>) {
    let others: Vec<u32> = given.iter().copied().filter(|other| *other != core).collect();
    let _ = GIVEN.set(given); // once
    if !others.is_empty() {
        let _ = sched::bind(0, &others); // noisier figures, nothing else
    }
}

/// Starts a program on all processors that this one was given, also on that which it has left.
pub(super) fn spawn(command: &mut Command) -> io::Result<Child> {
    let own = sched::allowed_cores();
    let _ = GIVEN.get().map(|given| sched::bind(0, given)); // as above
    let child = command.spawn();
    let _ = sched::bind(0, &own); // as above
    child
}

/// A module that runs; killed when dropped before its end.
pub(super) struct Running {
    process: Child,
    folder: tempfile::TempDir,
    until_s: f64,
}

/// A module that has ended.
pub(super) struct Ended {
    folder: tempfile::TempDir,
    /// Lines of its window log.
    pub(super) windows: Vec<Line>,
    /// For how long its dispatchers held their cores in slack, s.
    pub(super) spun_s: f64,
}

/// A line of the window log; times are module time, ns.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Line {
    pub(super) partition: String,
    pub(super) minor_frame: u64,
    pub(super) planned_start_ns: u64,
    pub(super) planned_end_ns: u64,
    pub(super) opened_ns: Option<u64>,
    pub(super) closed_ns: Option<u64>,
}

impl Line {
    fn parse(text: &str, frame: &mut Frames) -> Option<Self> {
        let fields: Vec<&str> = text.split(',').collect();
        let number = |place: usize| fields.get(place)?.parse::<u64>().ok();
        Some(Self {
            partition: (*fields.get(3)?).to_owned(),
            minor_frame: frame.number(number(0)?, number(1)?),
            planned_start_ns: number(4)?,
            planned_end_ns: number(5)?,
            opened_ns: number(7),
            closed_ns: number(8),
        })
    }

    /// From the planned start to the partition's first instruction, us.
    pub(super) fn start_us(&self) -> Option<f64> {
        Some((self.opened_ns? as f64 - self.planned_start_ns as f64) / 1e3)
    }

    /// What the partition made of it, us.
    pub(super) fn use_us(&self) -> Option<f64> {
        Some(self.closed_ns?.saturating_sub(self.opened_ns?) as f64 / 1e3)
    }
}

/// Counts minor frames through major frames.
#[derive(Default)]
struct Frames {
    last: Option<(u64, u64)>,
    count: u64,
}

impl Frames {
    fn number(&mut self, major: u64, minor: u64) -> u64 {
        if self.last.is_some_and(|last| last != (major, minor)) {
            self.count += 1;
        }
        self.last = Some((major, minor));
        self.count
    }
}

/// Starts the module of `schedule` for `until_s` of module time.
pub(super) fn start(schedule: &str, until_s: f64) -> Result<Running> {
    start_one(schedule, None, until_s)
}

/// As above, where it has several: the one of that name.
pub(super) fn start_one(schedule: &str, module: Option<&str>, until_s: f64) -> Result<Running> {
    let folder =
        tempfile::Builder::new().prefix("bateleur-bench.").tempdir().context("cannot make a folder")?;
    let file = folder.path().join("schedule.toml");
    fs::write(&file, schedule).context("cannot write the generated schedule")?;
    let own = std::env::current_exe().context("cannot find this program")?;
    let create = |name: &str| fs::File::create(folder.path().join(name)).context("cannot write");
    let (errors, events) = (create("errors.txt")?, create(EVENTS)?);
    // The executive takes none of the standard three for its own.
    rustix::io::fcntl_setfd(&events, rustix::io::FdFlags::empty()).context("cannot hand a file over")?;
    let mut command = Command::new(own);
    command
        // Ends with this program, however that ends.
        .args(["run", "--until-stdin-closes", "--until", &until_s.to_string()])
        .arg("--schedule")
        .arg(&file)
        .arg("--output")
        .arg(folder.path())
        .stdin(Stdio::piped())
        .stdout(Stdio::null())
        .args(["--events-fd", &events.as_raw_fd().to_string()])
        .args(module.into_iter().flat_map(|name| ["--module", name]))
        .stderr(errors);
    let process = spawn(&mut command).context("cannot start `bateleur run`")?;
    Ok(Running { process, folder, until_s })
}

impl Running {
    /// Its process.
    pub(super) fn pid(&self) -> i32 {
        self.process.id() as i32
    }

    /// What partition `name` has written so far.
    pub(super) fn words_of(&self, name: &str) -> String {
        words_of(self.folder.path(), name)
    }

    /// What the module has told so far.
    pub(super) fn events(&self) -> impl Iterator<Item = Event> {
        events(self.folder.path())
    }

    /// Waits until windows are granted; false: it ended before.
    pub(super) fn await_windows(&mut self) -> bool {
        let begun = Instant::now();
        while begun.elapsed() < PATIENCE && self.process.try_wait().is_ok_and(|ended| ended.is_none()) {
            if self.events().any(|event| matches!(event, Event::Ready { .. })) {
                return true;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        false
    }

    /// Waits for its end and reads its window log.
    pub(super) fn end(mut self) -> Result<Ended> {
        let limit = PATIENCE + Duration::from_secs_f64(self.until_s);
        let begun = Instant::now();
        let status = loop {
            if let Some(status) = self.process.try_wait()? {
                break status;
            }
            if begun.elapsed() > limit {
                bail!("a module of the bench did not end");
            }
            std::thread::sleep(Duration::from_millis(5));
        };
        if !status.success() {
            let said = fs::read_to_string(self.folder.path().join("errors.txt")).unwrap_or_default();
            bail!("a module of the bench ended with {status}: {}", said.trim());
        }
        let windows = read_windows(&self.folder.path().join("windows.csv"))?;
        let spun_s = events(self.folder.path()).find_map(|event| match event {
            Event::Stopped { spun_s, .. } => Some(spun_s),
            _ => None,
        });
        let folder = std::mem::replace(&mut self.folder, tempfile::tempdir()?);
        Ok(Ended { folder, windows, spun_s: spun_s.unwrap_or_default() })
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if self.process.try_wait().is_ok_and(|ended| ended.is_none()) {
            let _ = self.process.kill(); // its guard cleans up
            let _ = self.process.wait();
        }
    }
}

impl Ended {
    /// What partition `name` has written.
    pub(super) fn words_of(&self, name: &str) -> String {
        words_of(self.folder.path(), name)
    }

    /// The windows of partition `name`.
    pub(super) fn of<'a>(&'a self, name: &'a str) -> impl Iterator<Item = &'a Line> {
        self.windows.iter().filter(move |line| line.partition == name)
    }
}

/// What the module has told so far.
fn events(folder: &Path) -> impl Iterator<Item = Event> {
    let text = fs::read_to_string(folder.join(EVENTS)).unwrap_or_default();
    let events: Vec<Event> = text.lines().filter_map(|line| serde_json::from_str(line).ok()).collect();
    events.into_iter()
}

fn words_of(folder: &Path, name: &str) -> String {
    fs::read_to_string(folder.join("partitions").join(format!("{name}.log"))).unwrap_or_default()
}

/// The lines of a window log.
pub(super) fn read_windows(path: &Path) -> Result<Vec<Line>> {
    let text = fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let mut frames = Frames::default();
    Ok(text.lines().skip(1).filter_map(|line| Line::parse(line, &mut frames)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_of_the_window_log_gives_start_and_use_and_counts_minor_frames() {
        let mut frames = Frames::default();
        let line = |text: &str, frames: &mut Frames| Line::parse(text, frames).unwrap();
        let first = line("0,0,1,a,1000,51000,2000,3500,23500,", &mut frames);
        assert_eq!((first.start_us(), first.use_us(), first.minor_frame), (Some(2.5), Some(20.0), 0));
        let skipped = line("0,1,1,a,101000,151000,,,,S", &mut frames);
        assert_eq!((skipped.start_us(), skipped.use_us(), skipped.minor_frame), (None, None, 1));
        assert_eq!(line("1,0,1,a,201000,251000,,,,S", &mut frames).minor_frame, 2);
        assert_eq!(Line::parse("nonsense", &mut frames), None);
    }
}
