//! A flight on several hosts: each left a folder, as if it had flown alone. Here they become one.
//!
//! Responsible for: the order of everything that the hosts wrote, in the module time of one of them. It must never need more
//! memory for a long flight than for a short one, and never fail because a host's log is damaged or cut off.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, Write};
use std::path::Path;

use bateleur_messages::{LinkStatus, Message};
pub use bateleur_recording::hosts::{FILE, FOLDER, Host, folder_of, of};
use bateleur_recording::{Ending, Layout, LogError, LogReader, PORTS_FILE, PortLog, read};

use crate::health;
use crate::windows;

/// What a relay's partition is called: this and the module's name. What it passes on stands in the log of its source.
const RELAY: &str = "/relay_";
/// The port on which it says how its links are.
const STATUS: &str = "status";

/// A link between two modules, as the plan numbers it.
#[derive(Debug, Clone)]
pub struct Joined {
    /// The link's number.
    pub id: u64,
    /// Its two modules.
    pub modules: [String; 2],
}

/// How the hosts' times go together, by what their relays measured: `hosts` in the order that is wanted, the first being
/// the one whose time counts. One that nobody has measured against it keeps the shift that it comes with.
pub fn shifts(folder: &Path, hosts: &[Host], links: &[Joined]) -> Vec<Host> {
    let mut known: Vec<Option<i64>> = vec![None; hosts.len()];
    if let Some(first) = known.first_mut() {
        *first = Some(0);
    }
    // What was measured against a module that began anew meanwhile is of two times.
    let began_once = |near: usize| hosts.iter().filter(|host| host.module == hosts[near].module).count() == 1;
    let linked = |near: usize, far: usize, link: &Joined| {
        let [one, other] = &link.modules;
        let (near, far) = (&hosts[near].module, &hosts[far].module);
        (one == near && other == far) || (one == far && other == near)
    };
    // As often as a way can be long.
    for _ in hosts {
        for link in links {
            for near in (0..hosts.len()).filter(|near| began_once(*near)) {
                let Some(shift_ns) = known[near] else { continue };
                for far in (0..hosts.len()).filter(|far| linked(near, *far, link)) {
                    if known[far].is_none()
                        && let Some(offset_ns) = offset_ns(folder, &hosts[far], link.id)
                    {
                        known[far] = Some(shift_ns.saturating_add(offset_ns));
                    }
                }
            }
        }
    }
    let all = hosts.iter().zip(known);
    all.map(|(host, known)| Host { shift_ns: known.unwrap_or(host.shift_ns), ..host.clone() }).collect()
}

/// The peer's module time less that of `host`, as its relay saw it over the flight: the median, ns.
fn offset_ns(folder: &Path, host: &Host, link: u64) -> Option<i64> {
    let (module, path) = (&host.module, folder_of(folder, host).join(PORTS_FILE));
    let recording = read(path, |message| message == LinkStatus::NAME).ok()?;
    let track = recording.tracks.get(&format!("{RELAY}{module}/{STATUS}"))?;
    let offset = |(_, status): (u64, LinkStatus)| {
        let count = usize::try_from(status.links).ok()?;
        let place = status.id.iter().take(count).position(|id| *id == link)?;
        (status.exchanges[place] > 0).then_some(status.offset_ns[place])
    };
    let mut offsets: Vec<f64> = track.typed::<LinkStatus>().into_iter().filter_map(offset).collect();
    offsets.retain(|offset| offset.is_finite());
    offsets.sort_by(f64::total_cmp);
    offsets.get(offsets.len() / 2).map(|median| median.round() as i64)
}

/// Makes one log of windows, one of health and one of ports of those of the hosts, in the flight's folder. What was missing or
/// damaged is given back.
///
/// # Errors
/// The folder can not be written.
pub fn merge(folder: &Path, hosts: &[Host]) -> Result<Vec<String>, LogError> {
    let mut notes = Vec::new();
    let wrong = |path: &Path| {
        let path = path.to_path_buf();
        move |why| LogError::File { path, why }
    };
    let text = serde_json::to_vec_pretty(hosts).unwrap_or_default();
    let path = folder.join(FILE);
    std::fs::write(&path, text).map_err(wrong(&path))?;
    for (file, shifted) in [
        (windows::FILE, shifted_window as fn(&str, &Host) -> Option<(u64, String)>),
        (health::FILE, shifted_health),
    ] {
        let path = folder.join(file);
        merge_lines(folder, hosts, file, shifted, &mut notes).map_err(wrong(&path))?;
    }
    merge_ports(folder, hosts, &mut notes)?;
    Ok(notes)
}

/// The lines of a file of every host that is read from front to back.
struct Lines<'a> {
    host: &'a Host,
    reader: BufReader<File>,
    shifted: fn(&str, &Host) -> Option<(u64, String)>,
    next: Option<(u64, String)>,
    head: Option<String>,
}

impl Lines<'_> {
    /// Reads on to the next whole line.
    fn step(&mut self) -> std::io::Result<()> {
        self.next = None;
        let mut line = Vec::new();
        while self.next.is_none() && self.reader.read_until(b'\n', &mut line)? > 0 {
            let text = String::from_utf8_lossy(&line);
            self.next = (self.shifted)(text.trim_end(), self.host);
            if self.next.is_none() && self.head.is_none() && text.starts_with("frame,") {
                self.head = Some(text.trim_end().to_owned());
            }
            line.clear();
        }
        Ok(())
    }
}

fn merge_lines(
    folder: &Path,
    hosts: &[Host],
    file: &str,
    shifted: fn(&str, &Host) -> Option<(u64, String)>,
    notes: &mut Vec<String>,
) -> std::io::Result<()> {
    let mut all = Vec::new();
    for host in hosts {
        match File::open(folder_of(folder, host).join(file)) {
            Err(error) => notes.push(format!("{file} of {}: {error}", host.name())),
            Ok(found) => {
                let reader = BufReader::with_capacity(1 << 16, found);
                let mut lines = Lines { host, reader, shifted, next: None, head: None };
                lines.step()?;
                all.push(lines);
            }
        }
    }
    let mut out = BufWriter::new(File::create(folder.join(file))?);
    if let Some(head) = all.iter().find_map(|lines| lines.head.as_ref()) {
        writeln!(out, "{head}")?;
    }
    let due = |all: &[Lines<'_>]| {
        let waiting =
            all.iter().enumerate().filter_map(|(place, lines)| Some((lines.next.as_ref()?.0, place)));
        waiting.min().map(|(_, place)| place)
    };
    while let Some(place) = due(&all) {
        if let Some((_, line)) = &all[place].next {
            writeln!(out, "{line}")?;
        }
        all[place].step()?;
    }
    out.flush()
}

/// Cells of a line of windows.csv that are times: planned start and end, granted, opened, closed.
const TIME_CELLS: std::ops::Range<usize> = 4..9;

fn shifted_window(line: &str, host: &Host) -> Option<(u64, String)> {
    let window = windows::Window::parse(line)?;
    let shifted = |(place, cell): (usize, &str)| match cell.trim().parse::<u64>() {
        Ok(time_ns) if TIME_CELLS.contains(&place) => host.time_ns(time_ns).to_string(),
        _ => cell.to_owned(),
    };
    let cells: Vec<String> = line.split(',').enumerate().map(shifted).collect();
    Some((host.time_ns(window.planned_start_ns), cells.join(",")))
}

fn shifted_health(line: &str, host: &Host) -> Option<(u64, String)> {
    let mut entry: serde_json::Value = serde_json::from_str(line).ok()?;
    let own_ns = entry.get("time_ns")?.as_u64()?;
    for key in ["time_ns", "recovered_ns"] {
        if let Some(own_ns) = entry.get(key).and_then(serde_json::Value::as_u64) {
            entry[key] = host.time_ns(own_ns).into();
        }
    }
    entry["module"] = host.module.clone().into();
    Some((host.time_ns(own_ns), entry.to_string()))
}

/// A message on its way from a host's log into the flight's.
struct Waiting {
    time_ns: u64,
    topic: String,
    sequence: u32,
    bytes: Vec<u8>,
    layout: Option<Layout>,
}

struct Log<'a> {
    host: &'a Host,
    reader: LogReader,
    waiting: VecDeque<Waiting>,
    ending: Option<Ending>,
}

impl Log<'_> {
    fn step(&mut self) -> Result<(), LogError> {
        while self.waiting.is_empty() && self.ending.is_none() {
            let (host, waiting) = (self.host, &mut self.waiting);
            self.ending = self.reader.step(&mut |entry| {
                let passed_on = entry.topic.starts_with(RELAY) && entry.message != LinkStatus::NAME;
                if !passed_on {
                    waiting.push_back(Waiting {
                        time_ns: host.time_ns(entry.time_ns),
                        topic: entry.topic.to_owned(),
                        sequence: entry.sequence,
                        bytes: entry.bytes.to_vec(),
                        layout: entry.layout.cloned(),
                    });
                }
            })?;
        }
        Ok(())
    }
}

fn merge_ports(folder: &Path, hosts: &[Host], notes: &mut Vec<String>) -> Result<(), LogError> {
    let mut logs = Vec::new();
    for host in hosts {
        match LogReader::open(folder_of(folder, host).join(PORTS_FILE)) {
            Err(error) => notes.push(format!("{PORTS_FILE} of {}: {error}", host.name())),
            Ok(reader) => logs.push(Log { host, reader, waiting: VecDeque::new(), ending: None }),
        }
    }
    let mut merged = PortLog::create(folder.join(PORTS_FILE))?;
    let (mut channels, mut told) = (BTreeMap::new(), BTreeSet::new());
    loop {
        for log in &mut logs {
            if let Err(error) = log.step() {
                log.ending = Some(Ending::Cut(error.to_string()));
            }
        }
        let heads =
            logs.iter().enumerate().filter_map(|(place, log)| Some((log.waiting.front()?.time_ns, place)));
        let Some((_, place)) = heads.min() else { break };
        let Some(next) = logs[place].waiting.pop_front() else { break };
        let channel = match channels.get(&next.topic) {
            Some(channel) => *channel,
            None => {
                let Some(layout) = next.layout else { continue };
                let channel = merged.add_channel(&next.topic, layout.message())?;
                channels.insert(next.topic.clone(), channel);
                channel
            }
        };
        match merged.write(channel, next.sequence.into(), next.time_ns, &next.bytes) {
            Err(wrong @ LogError::Size { .. }) if told.insert(next.topic) => {
                notes.push(format!("{PORTS_FILE} of {}: {wrong}: left out", logs[place].host.name()));
            }
            Err(LogError::Size { .. }) => {}
            written => written?,
        }
    }
    for log in logs {
        if let Some(flaw) = log.ending.and_then(|ending| ending.flaw()) {
            notes.push(format!("{PORTS_FILE} of {} {flaw}", log.host.name()));
        }
    }
    merged.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn host(shift_ns: i64) -> Host {
        Host { shift_ns, ..Host::of_module("nav") }
    }

    #[test]
    fn a_window_is_shifted_in_its_times_and_nothing_else() {
        let line = "7,2,1,imu,1000,2000,1010,,1020,L,980,flight";
        let (at, shifted) = shifted_window(line, &host(-500)).unwrap();
        assert_eq!((at, shifted.as_str()), (500, "7,2,1,imu,500,1500,510,,520,L,980,flight"));
        assert_eq!(shifted_window("frame,minor,core", &host(0)), None);
    }

    #[test]
    fn lines_of_two_hosts_come_in_the_order_of_one_time() {
        let folder = tempfile::tempdir().unwrap();
        let hosts = [Host::of_module("fcu"), host(150)];
        for (host, starts) in hosts.iter().zip([[100, 200], [0, 100]]) {
            let path = folder_of(folder.path(), host);
            std::fs::create_dir_all(&path).unwrap();
            let lines =
                starts.map(|start| format!("0,0,1,{},{start},{},,,,S,,flight\n", host.module, start + 10));
            std::fs::write(path.join(windows::FILE), format!("frame,minor\n{}0,0,1,cut", lines.concat()))
                .unwrap();
            let fault = format!("{{\"time_ns\":{},\"partition\":\"x\"}}\n", starts[0]);
            std::fs::write(path.join(health::FILE), fault).unwrap();
        }
        let notes = merge(folder.path(), &hosts).unwrap();
        assert_eq!(notes.len(), 2, "the logs of ports are missing: {notes:?}");
        let text = std::fs::read_to_string(folder.path().join(windows::FILE)).unwrap();
        let order: Vec<&str> = text.lines().skip(1).map(|line| line.split(',').nth(3).unwrap()).collect();
        assert_eq!(order, ["fcu", "nav", "fcu", "nav"]);
        assert!(text.starts_with("frame,minor\n"));
        let health = std::fs::read_to_string(folder.path().join(health::FILE)).unwrap();
        assert!(health.lines().nth(1).unwrap().contains("\"time_ns\":150"), "{health}");
        assert_eq!(of(folder.path()), hosts);
    }

    #[test]
    fn a_host_that_came_back_has_a_folder_of_its_own_and_keeps_its_shift_where_nothing_was_measured() {
        let again = Host { start: 2, ..host(7_000) };
        assert_eq!(folder_of(Path::new("flight"), &again), Path::new("flight/hosts/nav.2"));
        let hosts = [Host::of_module("fcu"), host(0), again];
        let text = serde_json::to_string(&hosts).unwrap();
        assert_eq!(serde_json::from_str::<Vec<Host>>(&text).unwrap(), hosts);
        assert_eq!(text.matches("start").count(), 1, "files of older flights are read: {text}");
        let links = [Joined { id: 0, modules: ["fcu".into(), "nav".into()] }];
        assert_eq!(shifts(Path::new("/nowhere"), &hosts, &links), hosts);
    }
}
