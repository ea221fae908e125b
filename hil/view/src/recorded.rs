//! The folder of a run, looked at instant by instant. Its logs stay on the disk: an index of `windows.csv` and one field of one port are
//! kept, however long the run was.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result, bail};
use bateleur_messages::{Message, State};
use bateleur_recording::{PORTS_FILE, for_each};
use bateleur_report::health::{self, HealthEntry};
use bateleur_report::run::{self, Clock, Run};
use bateleur_report::windows::{self, Window};
use zerocopy::FromBytes;

use crate::air::{self, Air, Place};
use crate::scene::{Choice, MOST_ENTRIES, MOST_LINES, MOST_WINDOWS, PLOT_NS, Plot, Port, Scene};

/// Bytes of `windows.csv` from one entry of its index to the next.
const STEP: u64 = 64 << 10;
/// States of the aircraft that are kept: a flight of two laps at 50 Hz, and longer ones with fewer a second.
const MOST_STATES: usize = 20_000;
/// Values of the plotted field that are kept.
const MOST_VALUES: usize = 500_000;

/// Module time, ns, and what the Estimator said.
type States = Vec<(u64, State)>;

/// See the module's head.
#[derive(Debug)]
pub(crate) struct Recorded {
    folder: PathBuf,
    clock: Clock,
    /// Planned start of a window, ns, and the place of its line.
    index: Vec<(u64, u64)>,
    health: Vec<HealthEntry>,
    states: States,
    ports: Vec<Port>,
    waypoints: Vec<Place>,
    span_ns: (u64, u64),
    plotted: Mutex<(Choice, Plot)>,
}

impl Recorded {
    /// Reads what it needs of a folder.
    ///
    /// # Errors
    /// It is no folder of a run.
    pub(crate) fn open(folder: &Path) -> Result<Self> {
        let path = folder.join(windows::FILE);
        let index = index(&path).with_context(|| {
            format!("cannot read {}: it is no folder of a run or a flight", path.display())
        })?;
        let read = |name: &str| std::fs::read(folder.join(name)).unwrap_or_default(); // a run may lack it
        let run: Run = serde_json::from_slice(&read(run::FILE)).unwrap_or_default();
        let (health, _) = health::parse(&String::from_utf8_lossy(&read(health::FILE)));
        let (states, ports) = ports(&folder.join(PORTS_FILE))?;
        let times =
            index.iter().map(|(time_ns, _)| *time_ns).chain(states.iter().map(|(time_ns, _)| *time_ns));
        let span_ns = times.fold(None, |span: Option<(u64, u64)>, time_ns| match span {
            None => Some((time_ns, time_ns)),
            Some((from, to)) => Some((from.min(time_ns), to.max(time_ns))),
        });
        let Some(span_ns) = span_ns else { bail!("{} has no window in it", path.display()) };
        Ok(Self {
            folder: folder.to_owned(),
            clock: run.clock,
            index,
            health,
            states,
            ports,
            waypoints: air::waypoints(folder),
            span_ns,
            plotted: Mutex::default(),
        })
    }

    /// The first and the last instant, ns.
    pub(crate) fn span_ns(&self) -> (u64, u64) {
        self.span_ns
    }

    pub(crate) fn name(&self) -> String {
        self.folder.display().to_string()
    }

    pub(crate) fn ports(&self) -> Vec<Port> {
        self.ports.clone()
    }

    /// What was the case at a module time.
    pub(crate) fn scene(&self, choice: &Choice, time_ns: u64) -> Scene {
        let mut air = Air::default();
        let flown = self.states.partition_point(|(at_ns, _)| *at_ns <= time_ns);
        self.states[..flown].iter().for_each(|(at_ns, state)| air.add(*at_ns, *state));
        let noted = self.health.partition_point(|entry| entry.time_ns <= time_ns);
        // What came of an entry is not known before it came.
        let known = |entry: &HealthEntry| HealthEntry {
            recovered_ns: entry.recovered_ns.filter(|back_ns| *back_ns <= time_ns),
            ..entry.clone()
        };
        Scene {
            time_ns,
            clock: self.clock,
            windows: self.windows(time_ns).unwrap_or_default(), // somebody is at the file
            health: self.health[noted.saturating_sub(MOST_ENTRIES)..noted].iter().map(known).collect(),
            air,
            waypoints: self.waypoints.clone(),
            plot: self.plot(choice, time_ns),
            ..Scene::default()
        }
    }

    /// The last windows that began before a module time.
    fn windows(&self, time_ns: u64) -> std::io::Result<Vec<Window>> {
        let after = self.index.partition_point(|(start_ns, _)| *start_ns <= time_ns);
        // Lines of several processors are not in the order of their times: some are read from before and behind.
        let Some((_, from)) = self.index.get(after.saturating_sub(3)) else { return Ok(Vec::new()) };
        let mut file = File::open(self.folder.join(windows::FILE))?;
        file.seek(SeekFrom::Start(*from))?;
        let mut bytes = Vec::new();
        file.take(5 * STEP).read_to_end(&mut bytes)?;
        let text = String::from_utf8_lossy(&bytes);
        let mut list: Vec<Window> = text.lines().filter_map(Window::parse).collect();
        list.retain(|window| window.planned_start_ns <= time_ns);
        list.drain(..list.len().saturating_sub(MOST_WINDOWS));
        Ok(list)
    }

    fn plot(&self, choice: &Choice, time_ns: u64) -> Plot {
        let mut plotted = self.plotted.lock().unwrap_or_else(PoisonError::into_inner);
        if plotted.0 != *choice {
            *plotted = (choice.clone(), self.read_field(choice));
        }
        let (from_s, to_s) = (time_ns.saturating_sub(PLOT_NS) as f64 / 1e9, time_ns as f64 / 1e9);
        let cut = |line: &Vec<(f64, f64)>| {
            let from = line.partition_point(|(at_s, _)| *at_s < from_s);
            line[from..line.partition_point(|(at_s, _)| *at_s <= to_s).max(from)].to_vec()
        };
        Plot { lines: plotted.1.lines.iter().map(cut).collect(), ..plotted.1.clone() }
    }

    fn read_field(&self, choice: &Choice) -> Plot {
        let topic = topic(&choice.port);
        let mut plot = Plot { title: format!("{} {}", choice.port, choice.field), ..Plot::default() };
        let read = for_each(self.folder.join(PORTS_FILE), |entry| {
            let leaves =
                entry.layout.filter(|_| entry.topic == topic).map(|layout| layout.message().leaves());
            let Some(leaf) = leaves.and_then(|all| all.iter().find(|leaf| leaf.path == choice.field)) else {
                return;
            };
            plot.unit.clone_from(&leaf.unit);
            plot.lines.resize(leaf.elements().min(MOST_LINES), Vec::new());
            let values = leaf.numbers(entry.bytes).zip(&mut plot.lines);
            values.for_each(|(value, line)| line.push((entry.time_ns as f64 / 1e9, value.real())));
            plot.lines.iter_mut().for_each(|line| thin(line, MOST_VALUES / MOST_LINES));
        });
        if read.is_err() {
            plot.title.push_str(" (the log can not be read)");
        }
        plot
    }
}

fn topic(port: &str) -> String {
    format!("/{}", port.replacen('.', "/", 1))
}

/// Leaves out every second one where there are too many.
fn thin<T>(list: &mut Vec<T>, most: usize) {
    if list.len() > most {
        let mut at = 0;
        list.retain(|_| {
            at += 1;
            at % 2 == 1
        });
    }
}

/// The aircraft's states and the ports of a log; nothing of a run that has none.
fn ports(path: &Path) -> Result<(States, Vec<Port>)> {
    let (mut states, mut ports) = (States::new(), Vec::<Port>::new());
    if !path.exists() {
        return Ok((states, ports));
    }
    for_each(path, |entry| {
        let name = entry.topic.trim_start_matches('/').replacen('/', ".", 1);
        if let Some(layout) = entry.layout
            && !ports.iter().any(|port| port.name == name)
        {
            let fields = layout.message().leaves().iter().map(|leaf| leaf.path.clone()).collect();
            ports.push(Port { name, fields });
        }
        if entry.message == State::NAME
            && let Ok(state) = State::read_from_bytes(entry.bytes)
        {
            states.push((entry.time_ns, state));
            thin(&mut states, MOST_STATES);
        }
    })?;
    states.sort_by_key(|(time_ns, _)| *time_ns);
    Ok((states, ports))
}

/// A line every [`STEP`] bytes, and the last one.
fn index(path: &Path) -> std::io::Result<Vec<(u64, u64)>> {
    let mut reader = BufReader::with_capacity(1 << 18, File::open(path)?);
    let (mut index, mut last, mut at, mut next) = (Vec::new(), None, 0, 0);
    let mut line = Vec::new();
    while reader.read_until(b'\n', &mut line)? > 0 {
        let start_ns = line
            .split(|byte| *byte == b',')
            .nth(4)
            .and_then(|cell| std::str::from_utf8(cell).ok()?.parse().ok());
        if let Some(start_ns) = start_ns {
            last = Some((start_ns, at));
            if at >= next {
                index.push((start_ns, at));
                next = at + STEP;
            }
        }
        at += line.len() as u64;
        line.clear();
    }
    index.extend(last.filter(|last| index.last() != Some(last)));
    Ok(index)
}

#[cfg(test)]
mod tests {
    use std::fmt::Write;

    use super::*;

    #[test]
    fn windows_of_any_instant_are_the_last_ones_before_it() {
        let folder = tempfile::tempdir().unwrap();
        let mut text = format!("{}\n", windows::HEADER);
        for frame in 0..20_000_u64 {
            let start = frame * 20_000_000;
            writeln!(
                text,
                "{frame},0,1,imu,{start},{},{start},{start},{},",
                start + 500_000,
                start + 200_000
            )
            .unwrap();
        }
        std::fs::write(folder.path().join(windows::FILE), text).unwrap();
        let recorded = Recorded::open(folder.path()).unwrap();
        assert_eq!(recorded.span_ns(), (0, 19_999 * 20_000_000));
        for frame in [0, 1, 700, 9_999, 19_998, 19_999] {
            let scene = recorded.scene(&Choice::default(), frame * 20_000_000 + 5);
            assert_eq!(scene.windows.last().unwrap().frame, frame);
            assert!(scene.windows.len() as u64 > frame.min(600), "{frame}: {}", scene.windows.len());
        }
    }

    #[test]
    fn folder_of_something_else_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let error = Recorded::open(folder.path()).unwrap_err();
        assert!(format!("{error:#}").contains("no folder of a run"), "{error:#}");
    }
}
