//! Two logs of the ports side by side: where they first differ, by port and field.
//!
//! Responsible for: pairing the messages of each port, comparing their values, and keeping what was first. Both logs are
//! read once, the one that is behind in module time first, so that an hour takes no more memory than a minute. It must
//! never call two logs equal because it could not compare them: a port that only one of them has, or has with another
//! message type, is said, and so is a log that was changed after it was written. Bytes that are not of the layout that the log
//! gives them are compared as bytes.
//!
//! Messages of a port are paired in their order. Two that carry the same module time (within the tolerance) are a pair, and so
//! are two with the same sequence; of two that share neither, the earlier one is alone. So a message that is missing in
//! one log is one difference, and so is a source that was restarted in one of them, whose sequence begins anew. A module time
//! far ahead of those around it (one wrong bit does that) holds up neither the reading nor the pairing of the others.

use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::Value;

use bateleur_recording::PORTS_FILE;
use bateleur_recording::{Ending, Entry, Layout, LogError, LogReader, Scalar, word_of};

/// Messages of a port that wait for their counterparts at most, in one log: a minute of the fastest port. Beyond it the
/// oldest counts as alone. It bounds the memory where two logs have little in common.
const MOST_WAITING: usize = 3_000;
/// A message so far ahead of the one after it on its port is out of place, ns: a source's times rise.
const FAR_NS: u64 = 10_000_000_000;
/// Messages of a log of which the earliest says how far it is read.
const LATEST: usize = 3;
/// Fields of the first difference that are kept; the rest is counted.
const MOST_FIELDS: usize = 64;
/// The name of a message's module time among its fields.
pub const TIME: &str = "header.time_ns";
/// The name of a message's sequence among its fields.
pub const SEQUENCE: &str = "header.sequence";
/// The name of a message's length among its fields, where it differs.
const BYTES: &str = "length in bytes";

/// Something in a log: a partition, a port of it, a field of that, or one element of a field; joined by dots.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Place(pub String);

impl Place {
    /// Whether `name` is this place or lies in it.
    pub fn holds(&self, name: &str) -> bool {
        name.strip_prefix(self.0.as_str()).is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
    }

    /// Whether this place lies in `name`, or is it.
    fn is_in(&self, name: &str) -> bool {
        Self(name.to_owned()).holds(&self.0)
    }
}

/// How far numbers may differ.
#[derive(Debug, Clone, PartialEq)]
pub struct Tolerance {
    /// Where; `None`: everywhere.
    pub place: Option<Place>,
    /// How far, in the unit of the field.
    pub at_most: f64,
}

/// What is compared, and how exactly.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// Module time before which nothing is compared, ns.
    pub from_ns: Option<u64>,
    /// Module time after which nothing is compared, ns.
    pub until_ns: Option<u64>,
    /// Only these places; all where it is empty.
    pub only: Vec<Place>,
    /// Not these.
    pub ignored: Vec<Place>,
    /// Of several that fit, the longest place counts, and of those the last.
    pub tolerances: Vec<Tolerance>,
    /// How far the module times of two messages may differ, ns.
    pub time_tolerance_ns: u64,
}

/// One of the two logs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Side {
    /// The first.
    A,
    /// The second.
    B,
}

/// A value that is not the same in both.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FieldDifference {
    /// The field, and the element of it; or [`TIME`] or [`SEQUENCE`]; of a message that is not as long as its type says, its
    /// length in bytes or the first byte that differs.
    pub field: String,
    /// In the first log.
    pub a: Value,
    /// In the second.
    pub b: Value,
    /// The second minus the first.
    pub difference: f64,
}

/// A message that is not the same in both.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Difference {
    /// "partition.port".
    pub port: String,
    /// Its message type.
    pub message: String,
    /// Module time, ns; the earlier one.
    pub time_ns: u64,
    /// The source's sequence; the first log's, if it is there.
    pub sequence: u32,
    /// It is in this one alone.
    pub only_in: Option<Side>,
    /// What differs.
    pub fields: Vec<FieldDifference>,
    /// Fields that differ too and are not listed.
    pub more_fields: u64,
}

/// How a port compares.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PortComparison {
    /// "partition.port".
    pub port: String,
    /// Its message type.
    pub message: String,
    /// Messages in both.
    pub compared: u64,
    /// Those of them that differ.
    pub different: u64,
    /// Messages that only the first log has.
    pub only_a: u64,
    /// Messages that only the second has.
    pub only_b: u64,
    /// The first difference.
    pub first: Option<Difference>,
}

/// A log as it was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct End {
    /// The file.
    pub file: PathBuf,
    /// Messages in it.
    pub messages: u64,
    /// The latest module time in it, ns.
    pub time_ns: u64,
    /// It was cut short, and why.
    pub cut: Option<String>,
    /// Some of it was changed after it was written, and what shows it.
    pub damaged: Option<String>,
}

/// What came out.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    /// Everything was compared and nothing differs.
    pub equal: bool,
    /// The first log.
    pub a: End,
    /// The second.
    pub b: End,
    /// The earliest difference of all ports.
    pub first: Option<Difference>,
    /// All ports that both have, by name.
    pub ports: Vec<PortComparison>,
    /// What could not be compared: a sentence for each.
    pub incomparable: Vec<String>,
}

/// A log's file: `path`, or the log in the folder `path`.
pub fn file(path: &Path) -> PathBuf {
    if path.is_dir() { path.join(PORTS_FILE) } else { path.to_path_buf() }
}

/// Compares the logs in two files.
pub fn compare(a: &Path, b: &Path, options: &Options) -> Result<Comparison, LogError> {
    let mut sides = [Reading::open(a)?, Reading::open(b)?];
    let mut lanes = Lanes { options, lanes: BTreeMap::new() };
    loop {
        let [a, b] = &sides;
        let side = match (a.is_over(), b.is_over()) {
            (true, true) => break,
            (true, false) => Side::B,
            (false, true) => Side::A,
            (false, false) if a.place() <= b.place() => Side::A,
            (false, false) => Side::B,
        };
        sides[side as usize].step(side, &mut lanes)?;
    }
    lanes.drain();
    let mut incomparable = lanes.incomparable(&sides);
    let ports: Vec<PortComparison> = lanes.lanes.into_values().filter_map(Lane::result).collect();
    let first = ports.iter().filter_map(|port| port.first.clone()).min_by_key(|first| first.time_ns);
    // What differs is known to differ; what is equal in a damaged log may have been something else.
    if first.is_none() {
        let damaged = ["A", "B"].into_iter().zip(&sides).filter(|(_, side)| side.reader.damage().is_some());
        incomparable.extend(damaged.map(|(name, _)| format!("what was in {name} before it was damaged")));
    }
    let [a, b] = sides.map(|side| side.end);
    Ok(Comparison { equal: first.is_none() && incomparable.is_empty(), a, b, first, ports, incomparable })
}

/// One of the two logs while it is read.
struct Reading {
    reader: LogReader,
    end: End,
    ending: Option<Ending>,
    /// Module times of the messages read last, ns.
    latest_ns: [u64; LATEST],
}

impl Reading {
    fn open(path: &Path) -> Result<Self, LogError> {
        let end = End { file: path.to_path_buf(), messages: 0, time_ns: 0, cut: None, damaged: None };
        Ok(Self { reader: LogReader::open(path)?, end, ending: None, latest_ns: [0; LATEST] })
    }

    /// How far it is read: module time, ns, and messages, by which logs are told apart that stand at the same time. Not the
    /// latest time of all: after a single wrong one the other log would be read to its end at once.
    fn place(&self) -> (u64, u64) {
        (self.latest_ns.into_iter().min().unwrap_or_default(), self.end.messages)
    }

    fn is_over(&self) -> bool {
        self.ending.is_some()
    }

    fn step(&mut self, side: Side, lanes: &mut Lanes<'_>) -> Result<(), LogError> {
        let (end, latest_ns) = (&mut self.end, &mut self.latest_ns);
        let mut take = |entry: Entry<'_>| {
            latest_ns.rotate_left(1);
            latest_ns[LATEST - 1] = entry.time_ns;
            end.messages += 1;
            end.time_ns = end.time_ns.max(entry.time_ns);
            lanes.take(side, &entry);
        };
        if let Some(ending) = self.reader.step(&mut take)? {
            match &ending {
                Ending::Cut(why) => self.end.cut = Some(why.clone()),
                Ending::Damaged(why) => self.end.damaged = Some(why.clone()),
                Ending::Complete => {}
            }
            self.ending = Some(ending);
        }
        Ok(())
    }
}

/// What a port is in one log.
#[derive(Debug, Clone, PartialEq)]
struct Kind {
    message: String,
    layout: Option<Layout>,
}

#[derive(Debug)]
struct Message {
    time_ns: u64,
    sequence: u32,
    bytes: Vec<u8>,
}

/// How exactly a value is compared.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Limit {
    Ignored,
    Exact,
    Within(f64),
}

impl Limit {
    fn allows(self, a: Scalar, b: Scalar) -> bool {
        match self {
            Self::Ignored => true,
            Self::Exact => a.is_same(b),
            Self::Within(at_most) => a.is_same(b) || a.difference(b).abs() <= at_most || both_nan(a, b),
        }
    }
}

fn both_nan(a: Scalar, b: Scalar) -> bool {
    a.real().is_nan() && b.real().is_nan()
}

/// One port in both logs.
struct Lane {
    port: String,
    kinds: [Option<Kind>; 2],
    waiting: [VecDeque<Message>; 2],
    limits: Vec<(String, Limit)>,
    /// Any byte that differs is a difference.
    is_exact: bool,
    sequence_counts: bool,
    time_tolerance_ns: Option<u64>,
    compared: u64,
    different: u64,
    alone: [u64; 2],
    first: Option<Difference>,
}

struct Lanes<'o> {
    options: &'o Options,
    /// By topic; `None`: left out.
    lanes: BTreeMap<String, Lane>,
}

/// "partition.port" of a topic.
fn port_of(topic: &str) -> String {
    topic.trim_start_matches('/').replace('/', ".")
}

impl Lanes<'_> {
    fn take(&mut self, side: Side, entry: &Entry<'_>) {
        let time = entry.time_ns;
        if self.options.from_ns.is_some_and(|from| time < from)
            || self.options.until_ns.is_some_and(|until| time > until)
        {
            return;
        }
        if !self.lanes.contains_key(entry.topic) {
            let lane = Lane::new(port_of(entry.topic), entry.layout, self.options);
            self.lanes.insert(entry.topic.to_owned(), lane);
        }
        let Some(lane) = self.lanes.get_mut(entry.topic) else { return };
        let kind = &mut lane.kinds[side as usize];
        if kind.is_none() {
            *kind = Some(Kind { message: entry.message.to_owned(), layout: entry.layout.cloned() });
        }
        let message = Message { time_ns: time, sequence: entry.sequence, bytes: entry.bytes.to_vec() };
        lane.push(side, message);
    }

    /// What is left has no counterpart.
    fn drain(&mut self) {
        for lane in self.lanes.values_mut() {
            lane.pair(true);
            for side in [Side::A, Side::B] {
                while lane.waiting[side as usize].front().is_some() {
                    lane.leave_alone(side);
                }
            }
        }
    }

    /// Sentences about what could not be compared.
    fn incomparable(&self, sides: &[Reading; 2]) -> Vec<String> {
        let known = |side: usize| -> BTreeMap<String, Kind> {
            let ports = sides[side].reader.ports();
            let kind = |message: &str, layout: Option<&Layout>| Kind {
                message: message.to_owned(),
                layout: layout.cloned(),
            };
            ports.map(|(topic, message, layout)| (port_of(topic), kind(message, layout))).collect()
        };
        let [a, b] = [known(0), known(1)];
        let mut said = self.unknown_places(&a, &b);
        let mut names: Vec<&String> = a.keys().chain(b.keys()).collect();
        names.sort();
        names.dedup();
        names.retain(|name| is_wanted(self.options, name));
        if names.is_empty() && said.is_empty() {
            said.push("there is no port to compare".into());
        }
        said.extend(names.into_iter().filter_map(|name| disagreement(name, a.get(name), b.get(name))));
        if self.lanes.values().all(|lane| lane.compared + lane.alone[0] + lane.alone[1] == 0)
            && said.is_empty()
        {
            said.push("neither log has a message of what was to be compared".into());
        }
        said
    }

    /// Places that somebody named and that are in neither log: most likely a slip of the pen.
    fn unknown_places(&self, a: &BTreeMap<String, Kind>, b: &BTreeMap<String, Kind>) -> Vec<String> {
        let tolerances = self.options.tolerances.iter().filter_map(|tolerance| tolerance.place.as_ref());
        let mut places = self.options.only.iter().chain(&self.options.ignored).chain(tolerances).peekable();
        if places.peek().is_none() {
            return Vec::new(); // without the name of every element of every port
        }
        let names: Vec<String> = a.iter().chain(b).flat_map(|(port, kind)| names_of(port, kind)).collect();
        let unknown = places.filter(|place| !names.iter().any(|name| place.holds(name)));
        unknown
            .map(|place| {
                let hint = near(&place.0, &names)
                    .map_or_else(String::new, |name| format!(": did you mean `{name}`?"));
                format!("there is no port or field `{}` in either log{hint}", place.0)
            })
            .collect()
    }
}

/// Likeness (Jaro and Winkler, 0 to 1) from which on a guess helps more than it misleads.
const ALIKE: f64 = 0.8;

/// The partition, port or field that was most likely meant: one of as many parts.
fn near<'n>(place: &str, names: &'n [String]) -> Option<&'n str> {
    let dots = place.matches('.').count();
    let of_as_many = |name: &'n String| {
        let end = name.match_indices('.').nth(dots).map_or(name.len(), |(end, _)| end);
        (name.matches('.').count() >= dots).then(|| &name[..end])
    };
    let scored = names.iter().filter_map(of_as_many).map(|name| (strsim::jaro_winkler(place, name), name));
    let (likeness, name) = scored.max_by(|a, b| a.0.total_cmp(&b.0))?;
    (likeness > ALIKE).then_some(name)
}

/// A port, its elements, and what stands beside each message.
fn names_of(port: &str, kind: &Kind) -> Vec<String> {
    let columns = kind.layout.as_ref().map(Layout::columns).unwrap_or_default();
    let below = columns.into_iter().chain([TIME.to_owned(), SEQUENCE.to_owned()]);
    below.map(|column| format!("{port}.{column}")).chain([port.to_owned()]).collect()
}

/// Whether anything of a port is to be compared.
fn is_wanted(options: &Options, port: &str) -> bool {
    let chosen =
        options.only.is_empty() || options.only.iter().any(|place| place.holds(port) || place.is_in(port));
    chosen && !options.ignored.iter().any(|place| place.holds(port))
}

/// Why a port can not be compared.
fn disagreement(port: &str, a: Option<&Kind>, b: Option<&Kind>) -> Option<String> {
    match (a, b) {
        (Some(_), None) => Some(format!("B has no port {port}")),
        (None, Some(_)) => Some(format!("A has no port {port}")),
        (Some(a), Some(b)) if a.message != b.message => {
            Some(format!("{port} carries {} in A and {} in B", a.message, b.message))
        }
        (Some(a), Some(b)) if a.layout != b.layout => {
            Some(format!("{port}: the fields of {} are not the same in A and in B", a.message))
        }
        (Some(a), Some(_)) if a.layout.is_none() => {
            Some(format!("{port}: the logs do not say what a {} is made of", a.message))
        }
        _ => None,
    }
}

impl Lane {
    fn new(port: String, layout: Option<&Layout>, options: &Options) -> Self {
        let limit = |field: &str| limit(options, &format!("{port}.{field}"));
        let columns = layout.map(Layout::columns).unwrap_or_default();
        let limits: Vec<(String, Limit)> =
            columns.into_iter().map(|column| (column.clone(), limit(&column))).collect();
        let is_exact = limits.iter().all(|(_, limit)| *limit == Limit::Exact);
        let sequence_counts = limit(SEQUENCE) != Limit::Ignored;
        let time_tolerance_ns = (limit(TIME) != Limit::Ignored).then_some(options.time_tolerance_ns);
        Self {
            port,
            kinds: [None, None],
            waiting: Default::default(),
            limits,
            is_exact,
            sequence_counts,
            time_tolerance_ns,
            compared: 0,
            different: 0,
            alone: [0; 2],
            first: None,
        }
    }

    fn push(&mut self, side: Side, message: Message) {
        self.waiting[side as usize].push_back(message);
        if self.waiting[side as usize].len() > MOST_WAITING {
            self.leave_alone(side);
        }
        self.pair(false);
    }

    /// Pairs what waits, as far as it can be told; with `is_over`, nothing follows.
    fn pair(&mut self, is_over: bool) {
        while let [Some(a), Some(b)] = [self.waiting[0].front(), self.waiting[1].front()] {
            let apart_ns = a.time_ns.abs_diff(b.time_ns);
            if apart_ns <= self.time_tolerance_ns.unwrap_or(0) || a.sequence == b.sequence {
                self.compare();
                continue;
            }
            let (earlier, later) =
                if a.time_ns < b.time_ns { (Side::A, Side::B) } else { (Side::B, Side::A) };
            let waiting = &self.waiting[later as usize];
            match (apart_ns > FAR_NS, waiting.get(1)) {
                // Whether the later one is out of place shows with the next one on its port.
                (true, None) if !is_over => return,
                (true, Some(next)) if next.time_ns.saturating_add(FAR_NS) < waiting[0].time_ns => {
                    self.leave_alone(later);
                }
                _ => self.leave_alone(earlier),
            }
        }
    }

    fn leave_alone(&mut self, side: Side) {
        let Some(message) = self.waiting[side as usize].pop_front() else { return };
        self.alone[side as usize] += 1;
        if self.first.is_none() && self.limits.iter().any(|(_, limit)| *limit != Limit::Ignored) {
            self.first = Some(Difference {
                port: self.port.clone(),
                message: self.message(),
                time_ns: message.time_ns,
                sequence: message.sequence,
                only_in: Some(side),
                fields: Vec::new(),
                more_fields: 0,
            });
        }
    }

    fn compare(&mut self) {
        let [Some(a), Some(b)] = [self.waiting[0].pop_front(), self.waiting[1].pop_front()] else { return };
        self.compared += 1;
        let is_late = |limit_ns: u64| a.time_ns.abs_diff(b.time_ns) > limit_ns;
        let times_differ = self.time_tolerance_ns.is_some_and(is_late);
        let sequences_differ = self.sequence_counts && a.sequence != b.sequence;
        let same_bytes = a.bytes == b.bytes;
        if same_bytes && !times_differ && !sequences_differ {
            return;
        }
        let mut fields = Vec::new();
        if times_differ {
            fields.push(whole(TIME, a.time_ns, b.time_ns));
        }
        if sequences_differ {
            fields.push(whole(SEQUENCE, a.sequence.into(), b.sequence.into()));
        }
        // Those after the first of a port are counted alone, which takes no look at each field where every bit counts.
        let counted_only = self.first.is_some() && (self.is_exact || !fields.is_empty());
        let mut more_fields = 0;
        if !same_bytes && !counted_only {
            more_fields = self.compare_fields(&a.bytes, &b.bytes, &mut fields);
        }
        if fields.is_empty() && !counted_only {
            return;
        }
        self.different += 1;
        if self.first.is_none() {
            self.first = Some(Difference {
                port: self.port.clone(),
                message: self.message(),
                time_ns: a.time_ns.min(b.time_ns),
                sequence: a.sequence,
                only_in: None,
                fields,
                more_fields,
            });
        }
    }

    /// Gives the number of differences that were not listed.
    fn compare_fields(&self, a: &[u8], b: &[u8], found: &mut Vec<FieldDifference>) -> u64 {
        let layout = self.kinds[0].as_ref().and_then(|kind| kind.layout.as_ref());
        let Some(layout) = layout else { return 0 }; // said elsewhere: what it is made of is not known
        let (Some(in_a), Some(in_b)) = (layout.numbers(a), layout.numbers(b)) else {
            found.push(unlike(a, b));
            return 0;
        };
        let mut more = 0;
        for ((name, limit), (a, b)) in self.limits.iter().zip(in_a.zip(in_b)) {
            if limit.allows(a, b) {
                continue;
            }
            if found.len() == MOST_FIELDS {
                more += 1;
                continue;
            }
            let difference = a.difference(b);
            found.push(FieldDifference { field: name.clone(), a: word_of(a), b: word_of(b), difference });
        }
        more
    }

    fn message(&self) -> String {
        let kind = self.kinds.iter().flatten().next();
        kind.map(|kind| kind.message.clone()).unwrap_or_default()
    }

    /// `None`: not both logs have it, or nothing of it is compared.
    fn result(self) -> Option<PortComparison> {
        let same_kind = self.kinds[0].is_none() || self.kinds[1].is_none() || self.kinds[0] == self.kinds[1];
        let compared = self.limits.iter().any(|(_, limit)| *limit != Limit::Ignored);
        (same_kind && compared).then(|| PortComparison {
            message: self.message(),
            port: self.port,
            compared: self.compared,
            different: self.different,
            only_a: self.alone[0],
            only_b: self.alone[1],
            first: self.first,
        })
    }
}

/// A difference in its numbers.
fn whole(field: &str, a: u64, b: u64) -> FieldDifference {
    FieldDifference {
        field: field.to_owned(),
        a: a.into(),
        b: b.into(),
        difference: Scalar::Whole(a.into()).difference(Scalar::Whole(b.into())),
    }
}

/// How bytes differ that can not be taken apart: in their number, or where they first do.
fn unlike(a: &[u8], b: &[u8]) -> FieldDifference {
    match a.iter().zip(b).position(|(a, b)| a != b) {
        Some(place) if a.len() == b.len() => {
            whole(&format!("byte[{place}]"), a[place].into(), b[place].into())
        }
        _ => whole(BYTES, a.len() as u64, b.len() as u64),
    }
}

/// How exactly the value called "partition.port.field" is compared.
fn limit(options: &Options, name: &str) -> Limit {
    let chosen = options.only.is_empty() || options.only.iter().any(|place| place.holds(name));
    if !chosen || options.ignored.iter().any(|place| place.holds(name)) {
        return Limit::Ignored;
    }
    let fits = |tolerance: &&Tolerance| tolerance.place.as_ref().is_none_or(|place| place.holds(name));
    let length = |tolerance: &&Tolerance| tolerance.place.as_ref().map_or(0, |place| place.0.len());
    match options.tolerances.iter().filter(fits).max_by_key(length) {
        Some(tolerance) if tolerance.at_most > 0.0 => Limit::Within(tolerance.at_most),
        _ => Limit::Exact,
    }
}
