//! The trace event format that Perfetto (ui.perfetto.dev) and chrome://tracing open.
//!
//! Two or three processes: *cores*, with one track a core that shows whose window is when, and *partitions*, with one track a partition
//! that shows what it used of its windows and the slack, its faults and the messages that it wrote. A change of schedule is
//! an instant across all of them. Where partitions have several processes, the third process, *processes*, has one track for each of
//! them, with when it ran in its partition's windows. Times are module time, from microsecond 0. Of a flight on several hosts each module has such
//! processes of its own, and all times are the first module's.

use std::collections::{BTreeMap, BTreeSet};
use std::io::{BufRead, BufReader};
use std::path::Path;

use serde::Serialize;
use serde_json::json;

use super::{ExportError, Exported, Sink, check_folder};
use crate::health::{self, HealthEntry};
use crate::hosts::{self, Host};
use crate::windows::{self, Window};
use bateleur_recording as log;
use bateleur_recording::PORTS_FILE;
use bateleur_recording::processes::{self, Span};

/// The process of the cores' tracks.
const CORES: u32 = 1;
/// The process of the partitions' tracks.
const PARTITIONS: u32 = 2;
/// The process of the tracks of partitions' processes.
const PROCESSES: u32 = 3;
/// Tracks of the processes of one partition lie together: so many numbers are each partition's.
const TRACKS: u32 = 1_000;

/// One event; see "Trace Event Format".
#[derive(Serialize)]
struct Event<'a> {
    name: &'a str,
    /// X a span, i an instant, M a name of a track.
    ph: char,
    pid: u32,
    tid: u32,
    /// µs, with decimals.
    #[serde(skip_serializing_if = "Option::is_none")]
    ts: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    dur: Option<f64>,
    /// How far an instant reaches: t its track, g all.
    #[serde(skip_serializing_if = "Option::is_none")]
    s: Option<char>,
    #[serde(skip_serializing_if = "Option::is_none")]
    args: Option<serde_json::Value>,
}

/// Writes the trace of a run's `folder` to `path`.
pub fn chrome(folder: &Path, path: &Path) -> Result<Exported, ExportError> {
    check_folder(folder)?;
    let mut trace = Trace::begin(path)?;
    let mut exported = Exported::default();
    let hosts = hosts::of(folder);
    if hosts.is_empty() {
        trace.enter(None);
        add(folder, &mut trace, &mut exported);
    }
    for host in hosts {
        let own = hosts::folder_of(folder, &host);
        trace.enter(Some(host));
        add(&own, &mut trace, &mut exported);
    }
    trace.end()?;
    exported.or_nothing()
}

/// Everything that one module left.
fn add(folder: &Path, trace: &mut Trace, exported: &mut Exported) {
    add_windows(folder, trace, exported);
    add_processes(folder, trace, exported);
    add_health(folder, trace, exported);
    add_messages(folder, trace, exported);
}

struct Trace {
    sink: Sink,
    first: bool,
    cores: BTreeSet<u32>,
    partitions: BTreeMap<String, u32>,
    /// By partition and process.
    processes: BTreeMap<(String, String), u32>,
    schedule: String,
    /// Modules before the present one.
    before: u32,
    /// The present one, of several.
    host: Option<Host>,
}

impl Trace {
    fn begin(path: &Path) -> Result<Self, ExportError> {
        let mut sink = Sink::create(path)?;
        sink.write(b"{\"displayTimeUnit\":\"ns\",\"traceEvents\":[\n");
        Ok(Self {
            sink,
            first: true,
            cores: BTreeSet::new(),
            partitions: BTreeMap::new(),
            processes: BTreeMap::new(),
            schedule: String::new(),
            before: 0,
            host: None,
        })
    }

    /// What follows is of this module; `None` if there is one only.
    fn enter(&mut self, host: Option<Host>) {
        if self.host.is_some() {
            self.before += 1;
        }
        let named =
            |what: &str| host.as_ref().map_or(what.to_owned(), |host| format!("{} {what}", host.name()));
        let (cores, partitions) = (named("cores"), named("partitions"));
        self.host = host;
        self.cores.clear();
        self.partitions.clear();
        self.processes.clear();
        self.schedule.clear();
        self.name("process_name", CORES, 0, &cores);
        self.name("process_name", PARTITIONS, 0, &partitions);
    }

    /// The number of one of the present module's processes.
    fn process(&self, kind: u32) -> u32 {
        self.before * PROCESSES + kind
    }

    /// µs of the first module's time; exact for a hundred days.
    fn us(&self, own_ns: u64) -> f64 {
        let shift_ns = self.host.as_ref().map_or(0, |host| host.shift_ns);
        own_ns.saturating_add_signed(shift_ns) as f64 / 1e3
    }

    fn end(mut self) -> Result<(), ExportError> {
        self.sink.write(b"\n]}\n");
        self.sink.finish()
    }

    fn event(&mut self, event: &Event<'_>) {
        self.sink.write(if std::mem::take(&mut self.first) { b"" } else { b",\n" });
        match serde_json::to_vec(event) {
            Ok(bytes) => self.sink.write(&bytes),
            Err(error) => self.sink.error = Some(error.into()),
        }
    }

    fn name(&mut self, what: &str, pid: u32, tid: u32, name: &str) {
        let args = Some(json!({ "name": name }));
        let pid = self.process(pid);
        self.event(&Event { name: what, ph: 'M', pid, tid, ts: None, dur: None, s: None, args });
    }

    fn span(&mut self, name: &str, pid: u32, tid: u32, from_ns: u64, to_ns: u64, args: serde_json::Value) {
        let (ts, dur) = (Some(self.us(from_ns)), Some(to_ns.saturating_sub(from_ns) as f64 / 1e3));
        let pid = self.process(pid);
        self.event(&Event { name, ph: 'X', pid, tid, ts, dur, s: None, args: Some(args) });
    }

    fn instant(&mut self, name: &str, tid: u32, at_ns: u64, reach: char, args: Option<serde_json::Value>) {
        let (ts, pid) = (Some(self.us(at_ns)), self.process(PARTITIONS));
        self.event(&Event { name, ph: 'i', pid, tid, ts, dur: None, s: Some(reach), args });
    }

    /// The track of a partition, named where it is new.
    fn partition(&mut self, name: &str) -> u32 {
        if let Some(tid) = self.partitions.get(name) {
            return *tid;
        }
        let tid = self.partitions.len() as u32 + 1;
        self.partitions.insert(name.to_owned(), tid);
        self.name("thread_name", PARTITIONS, tid, name);
        tid
    }

    fn window(&mut self, window: &Window) {
        if window.schedule != self.schedule {
            self.instant(&format!("schedule {}", window.schedule), 0, window.planned_start_ns, 'g', None);
            self.schedule.clone_from(&window.schedule);
        }
        if self.cores.insert(window.core) {
            self.name("thread_name", CORES, window.core, &format!("core {}", window.core));
        }
        let args = json!({ "frame": window.frame, "minor": window.minor, "flags": window.flags });
        let planned = (window.planned_start_ns, window.planned_end_ns);
        let tid = self.partition(&window.partition);
        if window.skipped {
            let name = format!("{} (not granted)", window.partition);
            return self.span(&name, CORES, window.core, planned.0, planned.1, args);
        }
        let granted_ns = window.granted_ns.unwrap_or(planned.0).max(planned.0);
        self.span(&window.partition, CORES, window.core, granted_ns, planned.1, args.clone());
        let opened_ns = window.opened_ns.unwrap_or(granted_ns);
        match window.closed_ns {
            None => self.span("overrun", PARTITIONS, tid, opened_ns, planned.1, args),
            Some(closed_ns) => {
                // On the virtual clock a window may take longer than it lasts: module time stands still meanwhile.
                self.span("use", PARTITIONS, tid, opened_ns, closed_ns.min(planned.1), args);
                if closed_ns < planned.1 {
                    self.span("slack", PARTITIONS, tid, closed_ns, planned.1, json!({}));
                }
            }
        }
    }

    /// The track of a partition's process, named where it is new.
    fn process_track(&mut self, partition: &str, process: &str) -> u32 {
        let known = (partition.to_owned(), process.to_owned());
        if let Some(tid) = self.processes.get(&known) {
            return *tid;
        }
        if self.processes.is_empty() {
            let name =
                self.host.as_ref().map_or("processes".into(), |host| format!("{} processes", host.name()));
            self.name("process_name", PROCESSES, 0, &name);
        }
        let before = self.processes.keys().filter(|(other, _)| other == partition).count() as u32;
        let tid = self.partition(partition) * TRACKS + before;
        self.processes.insert(known, tid);
        self.name("thread_name", PROCESSES, tid, &format!("{partition}: {process}"));
        tid
    }

    fn process_span(&mut self, span: &Span) {
        let process = span.process.as_deref().unwrap_or("(not recorded)");
        let tid = self.process_track(&span.partition, process);
        self.span(process, PROCESSES, tid, span.from_ns, span.to_ns, json!({}));
    }

    fn fault(&mut self, entry: &HealthEntry) {
        let tid = self.partition(entry.partition.as_deref().unwrap_or("module"));
        let args = json!({ "action": entry.action, "detail": entry.detail, "generation": entry.generation });
        self.instant(&format!("{} → {}", entry.error, entry.action), tid, entry.time_ns, 't', Some(args));
        if let Some(recovered_ns) = entry.recovered_ns {
            self.instant("back", tid, recovered_ns, 't', None);
        }
    }

    fn message(&mut self, entry: &log::Entry<'_>) {
        let (partition, port) = super::tables::port_of(entry.topic);
        let tid = self.partition(partition);
        let args = json!({ "message": entry.message, "sequence": entry.sequence });
        self.instant(port, tid, entry.time_ns, 't', Some(args));
    }
}

fn add_windows(folder: &Path, trace: &mut Trace, exported: &mut Exported) {
    let read = windows::for_each(&folder.join(windows::FILE), |window| {
        exported.records += 1;
        trace.window(&window);
    });
    match read {
        Ok(broken) => exported.note_broken(windows::FILE, broken),
        Err(error) => exported.note(windows::FILE, error),
    }
}

fn add_processes(folder: &Path, trace: &mut Trace, exported: &mut Exported) {
    let read = processes::for_each(&folder.join(processes::FILE), |span| {
        exported.records += 1;
        trace.process_span(&span);
    });
    match read {
        Ok(broken) => exported.note_broken(processes::FILE, broken),
        Err(error) => exported.note(processes::FILE, error),
    }
}

fn add_health(folder: &Path, trace: &mut Trace, exported: &mut Exported) {
    match each_fault(folder, |entry| trace.fault(&entry)) {
        Ok((faults, broken)) => {
            exported.records += faults;
            exported.note_broken(health::FILE, broken);
        }
        Err(error) => exported.note(health::FILE, error),
    }
}

fn add_messages(folder: &Path, trace: &mut Trace, exported: &mut Exported) {
    let path = folder.join(PORTS_FILE);
    if !path.exists() {
        return exported.note(PORTS_FILE, "is not there: the run was not recorded (`bateleur run --record`)");
    }
    let read = log::for_each(&path, |entry| {
        exported.records += 1;
        trace.message(&entry);
    });
    match read {
        Ok(ending) => exported.note_ending(&ending),
        Err(error) => exported.note(PORTS_FILE, error),
    }
}

/// Gives each fault of the health log to `each`; returns how many there were and how many lines are damaged.
pub(super) fn each_fault(folder: &Path, mut each: impl FnMut(HealthEntry)) -> std::io::Result<(u64, usize)> {
    let mut reader = BufReader::new(std::fs::File::open(folder.join(health::FILE))?);
    let (mut line, mut faults, mut broken) = (Vec::new(), 0, 0);
    while reader.read_until(b'\n', &mut line)? > 0 {
        let (entries, wrong) = health::parse(&String::from_utf8_lossy(&line));
        faults += entries.len() as u64;
        broken += wrong;
        entries.into_iter().for_each(&mut each);
        line.clear();
    }
    Ok((faults, broken))
}
