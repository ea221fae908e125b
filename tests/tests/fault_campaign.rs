//! Faults of all kinds at random instants in a flight module on the wall clock, from a seed: the module runs on, nobody
//! but those who were provoked loses a window or a message, and nothing is left over.
//!
//! `BATELEUR_CAMPAIGN_FAULTS` says how many (30), `BATELEUR_CAMPAIGN_SEED` which (1). How late windows began is printed
//! and not judged.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::os::unix::net::UnixStream;
use std::time::Duration;

use bateleur_tests::{
    Ended, Fault, NINE, Started, Traces, Window, alone, await_some, bateleur, children_of, edited,
    executive_of, quantile,
};
use rustix::process::Signal;
use serde_json::Value;

/// What one partition can suffer without writing over memory that it shares with its peers.
const CONTAINED: [&str; 26] = [
    "sigkill",
    "sigsegv",
    "sigbus",
    "sigfpe",
    "sigill",
    "sigabrt",
    "sigterm",
    "sigtrap",
    "sigsys",
    "sigstop",
    "panic",
    "abort",
    "exit",
    "hang",
    "spin",
    "allocate",
    "fork-bomb",
    "threads",
    "illegal-call",
    "null-write",
    "wild-page",
    "stack-overflow",
    "divide-by-zero",
    "illegal-instruction",
    "bus-error",
    "run-on",
];
/// What can hit memory that is shared with peers, and bring down whoever records: the last part of a campaign. On sealed channels it harms
/// nobody else, and comes at any time.
const SHARED: [&str; 2] = ["wild-write", "wild-ports"];
const SHARED_CHANNELS: &str = "shared";
/// The share of faults, of a hundred, that are of that kind; on sealed channels three times that.
const SHARED_SHARE: u64 = 10;
/// What ends the executive, or makes it hang until its supervisor ends it: each in turn, once for ten faults, when all else has been judged.
const OF_EXECUTIVE: [(&str, &str); 7] = [
    ("monitor", "stall=9s"),
    ("executive", "sigkill"),
    ("dispatcher", "stall=9s"),
    ("executive", "sigsegv"),
    ("executive", "sigstop"),
    ("executive", "sigabrt"),
    ("executive", "sigbus"),
];
/// After a fault, how long an error of its partition is put down to it: `silence_windows` and a restart take a second.
const AFTERMATH_NS: u64 = 20_000_000_000;

/// So long after a fault, and before it where the answer came late, its partition's windows are its own affair: it is silent
/// for half a second, then it is restarted.
const OWN_NS: u64 = 1_500_000_000;

/// SplitMix64.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: u64) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (mixed ^ (mixed >> 31)) % limit
    }

    fn of<'a, T: ?Sized>(&mut self, list: &[&'a T]) -> &'a T {
        list[self.below(list.len() as u64) as usize]
    }
}

/// A conversation with the module.
struct Control(BufReader<UnixStream>);

impl Control {
    fn of(pid: i32) -> Self {
        let stream = UnixStream::connect(format!("/dev/shm/bateleur.fcu.{pid}/control")).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(30))).unwrap();
        Self(BufReader::new(stream))
    }

    fn ask(&mut self, request: &Value) -> Value {
        self.0.get_mut().write_all(format!("{request}\n").as_bytes()).unwrap();
        let mut line = String::new();
        self.0.read_line(&mut line).expect("the module answers");
        serde_json::from_str(&line).unwrap_or_else(|_| panic!("the module has ended: {line:?}"))
    }

    fn status(&mut self) -> Value {
        self.ask(&serde_json::json!({ "ask": "status" }))
    }

    fn module_ns(&mut self) -> u64 {
        self.status()["module_ns"].as_u64().unwrap()
    }

    /// Waits until every partition takes windows.
    fn await_calm(&mut self) {
        let mut last = Value::Null;
        let calm = await_some(Duration::from_secs(60), || {
            last = self.status();
            let partitions = last["partitions"].as_array().unwrap();
            partitions.iter().all(|partition| partition["mode"] == "normal").then_some(())
        });
        assert!(calm.is_some(), "not all partitions came back: {last:#}");
    }
}

/// One provoked fault.
#[derive(Debug, Clone)]
struct Provoked {
    target: String,
    fault: String,
    at_ns: u64,
}

impl Provoked {
    fn partition(&self) -> &str {
        self.target.split('.').next().unwrap()
    }

    fn ends_the_executive(&self) -> bool {
        OF_EXECUTIVE.contains(&(self.target.as_str(), self.fault.as_str()))
    }
}

/// What the module has on the machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Holdings {
    resident_kb: u64,
    descriptors: usize,
    processes: usize,
    shared_files: usize,
    groups: usize,
}

fn files_below(folder: &std::path::Path) -> usize {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries
        .map(|entry| match entry.file_type() {
            Ok(kind) if kind.is_dir() => 1 + files_below(&entry.path()),
            _ => 1,
        })
        .sum()
}

fn holdings(pid: i32) -> Holdings {
    let status = std::fs::read_to_string(format!("/proc/{pid}/status")).unwrap();
    let resident = status.lines().find(|line| line.starts_with("VmRSS:")).unwrap();
    let group = std::fs::read_to_string(format!("/dev/shm/bateleur.fcu.{pid}/instance.json")).unwrap();
    let group: Value = serde_json::from_str(&group).unwrap();
    let groups = std::fs::read_dir(group["group"].as_str().unwrap_or("/nowhere"));
    Holdings {
        resident_kb: resident.split_ascii_whitespace().nth(1).unwrap().parse().unwrap(),
        descriptors: std::fs::read_dir(format!("/proc/{pid}/fd")).unwrap().count(),
        processes: children_of(pid).len(),
        shared_files: files_below(format!("/dev/shm/bateleur.fcu.{pid}").as_ref()),
        groups: groups.map_or(0, |entries| {
            entries.flatten().filter(|entry| entry.file_type().is_ok_and(|kind| kind.is_dir())).count()
        }),
    }
}

/// The channels of the schedule: each with its source first, as `partition.port`.
fn channels() -> Vec<Vec<String>> {
    let text = edited(&[]);
    let tables = text.split("[[channel]]").skip(1);
    tables
        .map(|table| {
            let table = table.split("\n[").next().unwrap();
            table.split('"').skip(1).step_by(2).map(str::to_owned).collect()
        })
        .collect()
}

fn variable(name: &str, default: u64) -> u64 {
    std::env::var(name)
        .ok()
        .map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name} is a number")))
}

/// The flight's module, that restarts for ever; no simulator and no ground station.
fn start(folder: &std::path::Path, isolation: &str) -> (Started, Traces) {
    let resets = ("[health]\n", "[health]\nreset = { budget = 1000000, within = \"60s\" }\n");
    let text = edited(&[("budget = 5,", "budget = 1000000,"), resets]);
    let text = format!("isolation = \"{isolation}\"\n{text}");
    let schedule = folder.join("schedule.toml");
    std::fs::write(&schedule, text).unwrap();
    let device = "command.device=/dev/nowhere";
    let mut module =
        bateleur(&["run", "--record", "--schedule", schedule.to_str().unwrap(), "--set", device]);
    module.await_words("partitions are ready");
    let traces = Traces::of(module.pid());
    (module, traces)
}

fn choose(random: &mut Random, sources: &[&str], shared: bool) -> (String, String) {
    if shared {
        return (random.of(&NINE).to_owned(), random.of(&SHARED).to_owned());
    }
    match random.below(CONTAINED.len() as u64 + 7) {
        0 => (random.of(sources).to_owned(), "drop=5".into()),
        1 => (random.of(sources).to_owned(), "delay=5/60ms".into()),
        2 => (random.of(sources).to_owned(), "corrupt=5".into()),
        3 => (random.of(sources).to_owned(), "stuck=5".into()),
        4 => (random.of(sources).to_owned(), "bias=5".into()),
        5 => (random.of(sources).to_owned(), "swap=5".into()),
        6 => ("dispatcher".into(), "stall=5ms".into()),
        _ => (random.of(&NINE).to_owned(), random.of(&CONTAINED).to_owned()),
    }
}

/// Provokes a fault, unless its partition is just being restarted. What it has done may be told before it is answered.
fn provoke(control: &mut Control, (target, fault): (String, String)) -> Option<Provoked> {
    let at_ns = control.module_ns();
    let answer = control.ask(&serde_json::json!({ "ask": "inject", "target": target, "fault": fault }));
    (answer["answer"] == "done").then_some(Provoked { target, fault, at_ns })
}

fn sources(channels: &[Vec<String>]) -> Vec<&str> {
    channels.iter().map(|channel| channel[0].as_str()).collect()
}

fn campaign(module: &Started, faults: u64, seed: u64, isolation: &str) -> Vec<Provoked> {
    let (mut random, mut control) = (Random(seed), Control::of(executive_of(module.pid()).pid));
    let channels = channels();
    let mut provoked = Vec::new();
    let mut tries = 0;
    while (provoked.len() as u64) < faults {
        tries += 1;
        assert!(tries < 100 * faults + 1000, "only {} of {faults} faults could be provoked", provoked.len());
        std::thread::sleep(Duration::from_micros(random.below(200_000)));
        let shared = match isolation {
            SHARED_CHANNELS => provoked.len() as u64 * 100 >= faults * (100 - SHARED_SHARE),
            _ => random.below(100) < 3 * SHARED_SHARE,
        };
        let chosen = choose(&mut random, &sources(&channels), shared);
        provoked.extend(provoke(&mut control, chosen));
    }
    control.await_calm();
    provoked
}

/// Ends the executive so often, each time soon after a fault of a partition; what each of the executives had on the machine.
fn end_executives(module: &Started, count: u64, seed: u64, provoked: &mut Vec<Provoked>) -> Vec<Traces> {
    let (mut random, channels) = (Random(seed), channels());
    let after = |number| {
        let begun = || (module.said().matches("frame 0 again").count() as u64 >= number).then_some(());
        let begun = await_some(Duration::from_secs(60), begun);
        assert!(begun.is_some(), "no executive follows number {number}: {}", module.said());
        let mut control = Control::of(executive_of(module.pid()).pid);
        control.await_calm();
        control
    };
    let ways = (0..count).map(|number| {
        let mut control = after(number);
        let traces = Traces::of(module.pid());
        let chosen = choose(&mut random, &sources(&channels), false);
        provoked.extend(provoke(&mut control, chosen));
        std::thread::sleep(Duration::from_micros(random.below(200_000)));
        let (target, fault) = OF_EXECUTIVE[((seed + number) % OF_EXECUTIVE.len() as u64) as usize];
        let ended = provoke(&mut control, (target.to_owned(), fault.to_owned()));
        provoked.push(ended.expect("what is aimed at the executive is done"));
        traces
    });
    let mut traces: Vec<Traces> = ways.collect();
    after(count);
    traces.push(Traces::of(module.pid()));
    traces
}

/// Those of the module itself stand in the health log without a partition.
fn is_of_executive(fault: &Fault) -> bool {
    fault.error.starts_with("executive_")
}

fn faults_leave_nothing(isolation: &str) {
    let (faults, seed) = (variable("BATELEUR_CAMPAIGN_FAULTS", 30), variable("BATELEUR_CAMPAIGN_SEED", 1));
    let folder = tempfile::tempdir().unwrap();
    let (module, traces) = start(folder.path(), isolation);
    std::thread::sleep(Duration::from_secs(5));
    let quiet_until_ns = Control::of(executive_of(module.pid()).pid).module_ns();
    let before = holdings(executive_of(module.pid()).pid);
    let mut provoked = campaign(&module, faults, seed, isolation);
    std::thread::sleep(Duration::from_secs(2));
    let after = holdings(executive_of(module.pid()).pid);
    let of_executives = end_executives(&module, faults.div_ceil(10), seed, &mut provoked);
    module.signal(Signal::TERM);
    let ended = module.end().expect_code(0);
    traces.expect_gone();
    of_executives.iter().for_each(Traces::expect_gone);
    assert_executives_told(&ended, &provoked);
    eprintln!("{} faults, seed {seed}; before {before:?}, after {after:?}", provoked.len());
    print_lateness(&ended, quiet_until_ns);
    assert_nothing_grew(before, after, channels().len());
    // Whose faults may bring down peers.
    let harmful: &[&str] = if isolation == SHARED_CHANNELS { &SHARED } else { &[] };
    assert_faults_explained(&ended.faults(), &provoked, &channels(), harmful);
    assert_windows_explained(&ended, &provoked, harmful);
    assert_nobody_took_time(&ended.windows(), &provoked, quiet_until_ns);
    assert_messages_explained(&ended, &provoked, harmful);
    if harmful.is_empty() {
        assert!(
            !ended.stderr.contains("made anew") && !ended.stderr.contains("the recorder has ended"),
            "{}",
            ended.stderr
        );
    }
}

/// Each death of an executive is told once, and no other.
fn assert_executives_told(ended: &Ended, provoked: &[Provoked]) {
    let told: Vec<Fault> = ended.faults().into_iter().filter(is_of_executive).collect();
    let ordered: Vec<&Provoked> = provoked.iter().filter(|one| one.ends_the_executive()).collect();
    eprintln!("{} of them ended the executive", ordered.len());
    assert_eq!(told.len(), ordered.len(), "{told:#?} of {ordered:#?}");
    for (fault, one) in told.iter().zip(ordered) {
        let is_its = fault.time_ns.abs_diff(one.at_ns) < AFTERMATH_NS && fault.recovered_ns.is_some();
        assert!(fault.action == "reset" && is_its, "{fault:?} of {one:?}");
    }
}

fn print_lateness(ended: &Ended, quiet_until_ns: u64) {
    let windows = ended.windows();
    let (quiet, harmed): (Vec<_>, Vec<_>) =
        windows.iter().partition(|window| window.planned_start_ns < quiet_until_ns);
    for (name, list) in [("undisturbed", &quiet), ("with faults", &harmed)] {
        let late = |q| quantile(list.iter().filter_map(|window| window.lateness_ns()), q);
        eprintln!(
            "{name}: {} windows, {} late, lateness p50 {} ns, p99 {} ns, p99.9 {} ns",
            list.len(),
            list.iter().filter(|window| window.late).count(),
            late(0.5),
            late(0.99),
            late(0.999)
        );
    }
}

/// The recorder may have ended of what it read. Each of the `channels` may have a channel holder of its own, since it was made anew: the
/// executive holds its process, its line, and one descriptor more to end it by.
fn assert_nothing_grew(before: Holdings, after: Holdings, channels: usize) {
    let holders = after.processes.saturating_sub(before.processes);
    assert!(after.resident_kb < before.resident_kb + 8192, "memory: {before:?} {after:?}");
    assert!(after.descriptors <= before.descriptors + 2 + 3 * holders, "descriptors: {before:?} {after:?}");
    assert!(holders <= channels, "processes: {before:?} {after:?}");
    assert_eq!(after.groups, before.groups, "control groups");
    // A partition that died just now may still have a file more than one that has connected to all its peers.
    assert!(after.shared_files <= before.shared_files + 20, "shared memory: {before:?} {after:?}");
}

fn peers<'a>(partition: &'a str, channels: &'a [Vec<String>]) -> impl Iterator<Item = &'a str> {
    let attached = channels.iter().filter(move |channel| channel.iter().any(|port| owner(port) == partition));
    attached.flat_map(|channel| channel.iter().map(|port| owner(port)))
}

fn owner(port: &str) -> &str {
    port.split('.').next().unwrap()
}

/// Something was done about it.
fn acts(fault: &Fault) -> bool {
    fault.action != "ignore"
}

fn assert_faults_explained(
    found: &[Fault],
    provoked: &[Provoked],
    channels: &[Vec<String>],
    harmful: &[&str],
) {
    let mut counts: BTreeMap<String, u64> = BTreeMap::new();
    let acted = found.iter().filter(|fault| acts(fault) && !is_of_executive(fault));
    let mut unexplained = Vec::new();
    for fault in acted {
        *counts.entry(format!("{} -> {}", fault.error, fault.action)).or_default() += 1;
        let explains = |one: &Provoked| {
            // The order is answered a little after it was given.
            let before = one.at_ns <= fault.time_ns + 1_000_000_000;
            let recent = fault.time_ns <= one.at_ns + AFTERMATH_NS;
            let own = one.partition() == fault.partition;
            let of_peer = harmful.contains(&one.fault.as_str())
                && peers(one.partition(), channels).any(|peer| peer == fault.partition);
            before && recent && (own || of_peer)
        };
        if !provoked.iter().any(explains) {
            unexplained.push(fault);
        }
    }
    eprintln!("{counts:#?}");
    assert!(unexplained.is_empty(), "nobody provoked these: {unexplained:#?}");
}

/// Every window that passed without its partition lies between a fault of that partition and its recovery. A fault whose partition had not
/// come back when the executive ended is no entry of `health.jsonl`: there it is one that was provoked.
fn assert_windows_explained(ended: &Ended, provoked: &[Provoked], harmful: &[&str]) {
    let cut_off = |window: &Window| {
        let lately = |at_ns: u64| {
            at_ns <= window.planned_end_ns + OWN_NS && window.planned_start_ns <= at_ns + 2 * OWN_NS
        };
        let is_its =
            |one: &&Provoked| one.partition() == window.partition || harmful.contains(&one.fault.as_str());
        provoked.iter().any(|one| one.ends_the_executive() && lately(one.at_ns))
            && provoked.iter().filter(is_its).any(|one| lately(one.at_ns))
    };
    let faults = ended.faults();
    let slack_ns = 1_000_000_000; // a death is found a little after it happens; its entry has the time of the finding
    let windows = ended.windows();
    let missed = windows.iter().filter(|window| window.granted_ns.is_none() && !window.late);
    let unexplained: Vec<_> = missed
        .filter(|window| {
            !faults.iter().any(|fault| {
                (fault.partition == window.partition || is_of_executive(fault))
                    && acts(fault)
                    && fault.time_ns <= window.planned_end_ns + slack_ns
                    && fault.recovered_ns.is_none_or(|recovered| window.planned_start_ns <= recovered)
            }) && !cut_off(window)
        })
        .collect();
    assert!(
        unexplained.is_empty(),
        "{} windows lost by those who had no fault: {unexplained:#?}",
        unexplained.len()
    );
}

/// Of the windows that were granted on time to partitions that had no fault lately, hardly more were not closed than before
/// the faults: whoever computes outside its own window would show in others'.
fn assert_nobody_took_time(windows: &[Window], provoked: &[Provoked], quiet_until_ns: u64) {
    let is_own_fault = |window: &Window| {
        provoked.iter().any(|one| {
            let lately = one.at_ns.saturating_sub(OWN_NS)..=one.at_ns + OWN_NS;
            let concerns = one.partition() == window.partition
                || SHARED.contains(&one.fault.as_str())
                || one.target == "dispatcher"
                || one.ends_the_executive();
            concerns && lately.contains(&window.planned_start_ns)
        })
    };
    let judged = windows.iter().filter(|window| window.granted_ns.is_some() && !window.late);
    let (quiet, harmed): (Vec<_>, Vec<_>) = judged
        .filter(|window| !is_own_fault(window))
        .partition(|window| window.planned_start_ns < quiet_until_ns);
    let open = |list: &[&Window]| list.iter().filter(|window| window.closed_ns.is_none()).count();
    let (before, with) = (open(&quiet), open(&harmed));
    eprintln!(
        "not closed: {before} of {} windows before, {with} of {} with faults",
        quiet.len(),
        harmed.len()
    );
    // A hundredth is the machine's.
    let most = harmed.len() * before / quiet.len().max(1) + harmed.len() / 100 + 3;
    assert!(with <= most, "{with} of {} windows of those who had no fault were not closed", harmed.len());
}

/// A gap in the sequence of a source's messages is one that was ordered there, or the source was harmed itself.
fn assert_messages_explained(ended: &Ended, provoked: &[Provoked], harmful: &[&str]) {
    let mut last: BTreeMap<String, (u32, u64)> = BTreeMap::new();
    let (mut messages, mut unexplained, mut latest_ns) = (0_u64, Vec::new(), 0);
    let harmful_ns = provoked.iter().find(|one| harmful.contains(&one.fault.as_str())).map(|one| one.at_ns);
    let ending = bateleur_recording::for_each(ended.folder().join("ports.mcap"), |entry| {
        // Who writes wildly may damage its own stamp: then it was when the message came.
        let is_sound = latest_ns == 0 || entry.time_ns.abs_diff(latest_ns) < 10_000_000_000;
        let entry_ns = if is_sound { entry.time_ns } else { latest_ns };
        latest_ns = latest_ns.max(entry_ns);
        // From there on the recorder itself may read damaged memory.
        if harmful_ns.is_some_and(|harmful| entry_ns + 1_000_000_000 > harmful) {
            return;
        }
        messages += 1;
        let before = last.insert(entry.topic.to_owned(), (entry.sequence, entry_ns));
        let Some((sequence, time_ns)) = before else { return };
        // A lower number: a successor, which counts anew.
        if entry.sequence <= sequence + 1 {
            return;
        }
        let source = entry.topic.trim_start_matches('/').replace('/', ".");
        let ordered = provoked.iter().any(|one| {
            let is_its = one.target == source || one.target == owner(&source);
            // A recorder that begins anew has missed what came meanwhile, and no more.
            let (concerns, after_ns) = match one.ends_the_executive() {
                true => (true, 2 * OWN_NS),
                false => (is_its, AFTERMATH_NS),
            };
            concerns && one.at_ns <= entry_ns + 1_000_000_000 && time_ns <= one.at_ns + after_ns
        });
        if !ordered {
            unexplained.push(format!("{source}: {} after {sequence} at {entry_ns} ns", entry.sequence));
        }
    });
    eprintln!("{messages} messages in {} channels, log {:?}", last.len(), ending.unwrap());
    assert!(messages > 1000, "the log holds {messages} messages");
    assert!(unexplained.is_empty(), "lost messages of channels that nobody provoked: {unexplained:#?}");
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn faults_of_all_kinds_at_random_instants_harm_nobody_else_and_leave_nothing() {
        let _turn = alone();
        faults_leave_nothing(SHARED_CHANNELS);
    }

    #[test]
    fn faults_of_all_kinds_on_sealed_channels_harm_nobody_else_wild_writes_over_them_included() {
        let _turn = alone();
        faults_leave_nothing("checked");
    }
}
