//! A table, checked: every field in its place, no two values on one bit.

use std::collections::BTreeMap;
use std::fmt;

use bateleur_can_core::{Frame, Id, Kind, frame::is_fd_length, id_of};
use bateleur_messages::format::{PathError, Scalar};
use bateleur_messages::{Catalogue, FieldKind, Type};
use toml::Spanned;

use crate::dbc::Signals;
use crate::raw::{RawPort, RawSignal, RawTable};
use crate::signal::{Order, Signal, Sort};

/// What can not be meant, all of it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TableError(Vec<String>);

impl TableError {
    pub(crate) fn one(text: String) -> Self {
        Self(vec![text])
    }
}

impl fmt::Display for TableError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0.join("\n"))
    }
}

impl std::error::Error for TableError {}

/// The frame that asks for sensors at a module time, and the one that says that they have all been sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sync {
    /// Sent in each window after everything else: 64 bits little endian, module time, ns.
    pub frame: Id,
    /// Waited for: the same 64 bits.
    pub answer: Option<Id>,
}

/// How one field gets its value.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Slot {
    pub(crate) field: String,
    pub(crate) offset: usize,
    pub(crate) kind: FieldKind,
    pub(crate) source: Source,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Source {
    /// In a frame, by its place in the layout.
    Frame(usize, Signal),
    Constant(f64),
}

/// A frame of a layout.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Carrier {
    pub(crate) id: Id,
    pub(crate) bytes: usize,
}

/// How one port's message lies in frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Layout {
    pub(crate) port: String,
    pub(crate) message: String,
    pub(crate) size: usize,
    pub(crate) slots: Vec<Slot>,
    /// In the order of arbitration.
    pub(crate) carriers: Vec<Carrier>,
    /// The one that comes last; a place in `carriers`.
    pub(crate) complete: usize,
    /// Where the time of measuring stands in the message.
    pub(crate) stamp: Option<usize>,
    /// The frame and the signal that say how long ago that was, ns.
    pub(crate) age: Option<(usize, Signal)>,
}

impl Layout {
    /// The port.
    pub fn port(&self) -> &str {
        &self.port
    }

    /// The message type's name.
    pub fn message(&self) -> &str {
        &self.message
    }

    /// The identifiers of its frames.
    pub fn ids(&self) -> impl Iterator<Item = Id> {
        self.carriers.iter().map(|carrier| carrier.id)
    }

    /// A message at module time `now_ns` as frames, in the order in which a bus would carry them.
    pub fn frames(&self, message: &[u8], now_ns: u64) -> Vec<Frame> {
        let mut data: Vec<Vec<u8>> = self.carriers.iter().map(|carrier| vec![0; carrier.bytes]).collect();
        for slot in &self.slots {
            if let Source::Frame(place, signal) = slot.source {
                signal.write(field(message, slot), &mut data[place]);
            }
        }
        if let (Some((place, signal)), Some(stamp)) = (self.age, self.stamp) {
            let measured_ns = message
                .get(stamp..stamp + 8)
                .and_then(|bytes| bytes.try_into().ok())
                .map_or(0, u64::from_le_bytes);
            signal.write(now_ns.saturating_sub(measured_ns) as f64, &mut data[place]);
        }
        let frame = |(carrier, data): (&Carrier, &Vec<u8>)| {
            let kind = if data.len() > 8 { Kind::Fd { brs: true, esi: false } } else { Kind::Data };
            Frame::new(carrier.id, kind, data).ok()
        };
        self.carriers.iter().zip(&data).filter_map(frame).collect()
    }
}

impl Layout {
    /// Moves the time of measuring of a message back by `by_ns`.
    pub fn make_older(&self, message: &mut [u8], by_ns: u64) {
        let Some(stamp) = self.stamp.and_then(|stamp| message.get_mut(stamp..stamp + 8)) else { return };
        let measured_ns = stamp.try_into().map_or(0, u64::from_le_bytes);
        stamp.copy_from_slice(&measured_ns.saturating_sub(by_ns).to_le_bytes());
    }
}

/// The value of a field.
fn field(message: &[u8], slot: &Slot) -> f64 {
    let bytes = message.get(slot.offset..).unwrap_or_default();
    Scalar::read(slot.kind, bytes).map_or(0.0, Scalar::real)
}

/// All layouts.
#[derive(Debug, Clone, PartialEq)]
pub struct Table {
    layouts: Vec<Layout>,
    sync: Option<Sync>,
}

impl Table {
    /// Reads a table of the flight's messages, called `name` in errors, with the signals of a DBC file (its name and its text).
    ///
    /// # Errors
    /// Everything that can not be meant, with the line where it stands.
    pub fn parse(name: &str, text: &str, dbc: Option<(&str, &str)>) -> Result<Self, TableError> {
        Self::parse_among(name, text, dbc, bateleur_messages::catalogue())
    }

    /// As [`Table::parse`], of messages of `types`.
    ///
    /// # Errors
    /// Everything that can not be meant, with the line where it stands.
    pub fn parse_among(
        name: &str,
        text: &str,
        dbc: Option<(&str, &str)>,
        types: &Catalogue,
    ) -> Result<Self, TableError> {
        let raw: RawTable = toml::from_str(text).map_err(|error| {
            let line = line_of(text, error.span().map_or(0, |span| span.start));
            TableError::one(format!("{name}:{line}: {}", error.message()))
        })?;
        let mut errors = Vec::new();
        let signals = dbc.map_or_else(Signals::absent, |(name, text)| Signals::read(name, text, &mut errors));
        let mut checker = Checker { name, text, types, signals, errors, taken: BTreeMap::new() };
        let sync = raw.sync.as_ref().and_then(|sync| {
            let answer = match &sync.answer {
                Some(answer) => Some(checker.id(answer)?),
                None => None,
            };
            Some(Sync { frame: checker.id(&sync.frame)?, answer })
        });
        for id in sync.iter().flat_map(|sync| [Some(sync.frame), sync.answer]).flatten() {
            (0..64).for_each(|bit| drop(checker.taken.insert((id, bit), "sync".into())));
        }
        let layouts = raw.port.iter().filter_map(|(port, raw)| checker.layout(port, raw)).collect();
        match checker.errors.is_empty() {
            true => Ok(Self { layouts, sync }),
            false => Err(TableError(checker.errors)),
        }
    }

    /// The layout of a port.
    pub fn layout(&self, port: &str) -> Option<&Layout> {
        self.layouts.iter().find(|layout| layout.port == port)
    }

    /// The ports that it has.
    pub fn ports(&self) -> impl Iterator<Item = &str> {
        self.layouts.iter().map(|layout| layout.port.as_str())
    }

    /// The frame that asks, where there is one.
    pub fn sync(&self) -> Option<Sync> {
        self.sync
    }
}

/// Fields that say at which time something was, ns. Others are how long something took, or what is set.
const MOMENTS: [&str; 4] = ["measured_ns", "valid_ns", "time_ns", "module_ns"];

struct Checker<'a> {
    name: &'a str,
    text: &'a str,
    types: &'a Catalogue,
    signals: Signals,
    errors: Vec<String>,
    /// Which value has which bit.
    taken: BTreeMap<(Id, u32), String>,
}

impl Checker<'_> {
    fn wrong(&mut self, at: usize, text: impl fmt::Display) {
        self.errors.push(format!("{}:{}: {text}", self.name, line_of(self.text, at)));
    }

    fn id(&mut self, text: &Spanned<String>) -> Option<Id> {
        let id = id_of(text.get_ref());
        if id.is_none() {
            self.wrong(
                text.span().start,
                format!(
                    "\"{}\" is no identifier: up to three hexadecimal digits standard, up to eight extended",
                    text.get_ref()
                ),
            );
        }
        id
    }

    fn layout(&mut self, port: &str, raw: &RawPort) -> Option<Layout> {
        let before = self.errors.len();
        let at = raw.message.span().start;
        let types = self.types;
        let Some(message) = types.find(raw.message.get_ref()) else {
            let known = types.types().map(|message| message.name());
            let hint = nearest(raw.message.get_ref(), known)
                .map_or(String::new(), |near| format!("; did you mean {near}?"));
            self.wrong(at, format!("there is no message {}{hint}", raw.message.get_ref()));
            return None;
        };
        let mut parts: Vec<(Option<Id>, Slot)> = Vec::new();
        let mut given: BTreeMap<usize, &str> = BTreeMap::new();
        for (name, signal) in &raw.fields {
            let at = signal.span().start;
            let Some((field, offset, kind)) = self.field(message, name, at) else { continue };
            let path = format!("{port}.{name}");
            // "rates_radps[00]" is another key, and the same field.
            if let Some(other) = given.insert(offset, name) {
                self.wrong(
                    at,
                    format!("{path} and {port}.{other} are the same field: leave one of them out"),
                );
                continue;
            }
            let Some((id, source)) = self.source(signal.get_ref(), &path, at) else { continue };
            parts.push((id, Slot { field, offset, kind, source }));
        }
        let stamp = match &raw.stamp {
            Some(stamp) => self.stamp(message, stamp),
            None => None,
        };
        if let (Some(age), None) = (&raw.age, &raw.stamp) {
            self.wrong(age.span().start, format!("port {port} has an age and no stamp to take it from"));
        }
        let age = raw
            .age
            .as_ref()
            .and_then(|age| self.source(age.get_ref(), &format!("{port}, age"), age.span().start));
        let age = age.and_then(|(id, source)| match source {
            Source::Frame(_, signal) => Some((id?, signal)),
            Source::Constant(_) => None,
        });
        let carriers = carriers(parts.iter().filter_map(|(id, slot)| part(*id, slot.source)).chain(age));
        if carriers.is_empty() {
            // Where its fields are wrong, that has been said.
            if self.errors.len() == before {
                self.wrong(at, format!("port {port} has no field in any frame"));
            }
            return None;
        }
        let place = |id: Id| carriers.iter().position(|carrier| carrier.id == id).unwrap_or(0);
        let complete = match &raw.complete {
            None => carriers.len() - 1,
            Some(text) => {
                let id = self.id(text)?;
                let found = carriers.iter().position(|carrier| carrier.id == id);
                if found != Some(carriers.len() - 1) {
                    let last = carriers[carriers.len() - 1].id;
                    self.wrong(
                        text.span().start,
                        format!("complete = \"{id}\": a bus carries low identifiers first, so the last frame of port {port} is {last}; say that, or give the frames other identifiers"),
                    );
                }
                found.unwrap_or(0)
            }
        };
        let slots = parts.into_iter().map(|(id, slot)| match (id, slot.source) {
            (Some(id), Source::Frame(_, signal)) => Slot { source: Source::Frame(place(id), signal), ..slot },
            _ => slot,
        });
        let slots = slots.collect();
        let age = age.map(|(id, signal)| (place(id), signal));
        let name = message.name().to_owned();
        Some(Layout {
            port: port.into(),
            message: name,
            size: message.size(),
            slots,
            complete,
            stamp,
            age,
            carriers,
        })
    }

    /// Where the field for the time stands.
    fn stamp(&mut self, message: &Type, stamp: &Spanned<String>) -> Option<usize> {
        let at = stamp.span().start;
        let (field, offset, kind) = self.field(message, stamp.get_ref(), at)?;
        if kind == FieldKind::U64 && MOMENTS.contains(&&*field) {
            return Some(offset);
        }
        let moment = message.members().iter().find(|field| MOMENTS.contains(&&*field.name));
        let mend = match moment {
            Some(moment) => format!("of {} it is {}", message.name(), moment.name),
            None => format!("{} has none; leave stamp out", message.name()),
        };
        self.wrong(at, format!("stamp = \"{field}\" is no time of measuring: {mend}"));
        None
    }

    /// Path, place and kind of a field such as "position[1]" or "echoes[0].range"; of an array the path is its name.
    fn field(&mut self, message: &Type, path: &str, at: usize) -> Option<(String, usize, FieldKind)> {
        match message.place(path) {
            Ok(place) => {
                let base = path.rsplit_once('[').filter(|(_, rest)| rest.ends_with(']'));
                Some((base.map_or(path, |(base, _)| base).to_owned(), place.offset, place.kind))
            }
            Err(wrong @ PathError::NoField { .. }) => {
                // The nearest by what this table calls near, wherever the field stands.
                let paths = message.leaves().iter().map(|leaf| leaf.path.as_str());
                let hint = nearest(path.split('[').next().unwrap_or(path), paths);
                let hint = hint.map_or_else(
                    || wrong.to_string(),
                    |near| {
                        let base = path.split('[').next().unwrap_or(path);
                        format!("{} has no field {base}; did you mean {near}?", message.name())
                    },
                );
                self.wrong(at, hint);
                None
            }
            Err(wrong) => {
                self.wrong(at, wrong);
                None
            }
        }
    }

    fn source(&mut self, raw: &RawSignal, path: &str, at: usize) -> Option<(Option<Id>, Source)> {
        let chosen = match (raw.constant, &raw.signal) {
            (Some(_), _) => Some(("constant", &["constant"][..])),
            (None, Some(_)) => Some(("signal", &["signal", "scale", "offset", "none"][..])),
            (None, None) => None,
        };
        if let Some((chosen, meant)) = chosen {
            let ignored: Vec<&str> = raw.keys().filter(|key| !meant.contains(key)).collect();
            if !ignored.is_empty() {
                let ignored = ignored.join(", ");
                self.wrong(
                    at,
                    format!("{path}: beside {chosen}, {ignored} would say nothing: leave that out"),
                );
                return None;
            }
        }
        if let Some(constant) = raw.constant {
            return Some((None, Source::Constant(constant)));
        }
        let (id, signal) = match (&raw.signal, &raw.frame) {
            (Some(name), None) => match self.signals.get(name) {
                Ok((id, signal)) => (id, scaled(signal, raw)),
                Err(reason) => {
                    self.wrong(at, reason);
                    return None;
                }
            },
            (None, Some(frame)) => {
                let Some(id) = id_of(frame) else {
                    self.wrong(at, format!("{path}: \"{frame}\" is no identifier: up to three hexadecimal digits standard, up to eight extended"));
                    return None;
                };
                (id, self.own(raw, path, at)?)
            }
            _ => {
                self.wrong(
                    at,
                    format!("{path}: say either frame, start and bits, or a DBC's signal, or a constant"),
                );
                return None;
            }
        };
        if let Some(fault) = signal.fault() {
            self.wrong(at, format!("{path}: {fault}"));
            return None;
        }
        for place in signal.places() {
            if let Some(other) = self.taken.insert((id, place), path.to_owned()) {
                self.wrong(at, format!("{path} and {other} overlap at bit {place} of frame {id}: correct the start or the length of one of them"));
                return None;
            }
        }
        Some((Some(id), Source::Frame(0, signal)))
    }

    fn own(&mut self, raw: &RawSignal, path: &str, at: usize) -> Option<Signal> {
        let (Some(start), Some(bits)) = (raw.start, raw.bits) else {
            self.wrong(at, format!("{path}: a value in a frame needs start and bits"));
            return None;
        };
        let order = match raw.order.as_deref() {
            None | Some("little") => Order::Little,
            Some("big") => Order::Big,
            Some(other) => {
                self.wrong(at, format!("{path}: order = \"{other}\": little or big"));
                return None;
            }
        };
        let sort = match (raw.float.unwrap_or(false), raw.signed.unwrap_or(false)) {
            (true, _) => Sort::Float,
            (false, true) => Sort::Signed,
            (false, false) => Sort::Unsigned,
        };
        let (scale, offset) = (raw.scale.unwrap_or(1.0), raw.offset.unwrap_or(0.0));
        Some(Signal { start, bits, order, sort, scale, offset, none: raw.none })
    }
}

/// A signal of a DBC, in the message's unit: `scale` and `offset` apply to the value that the DBC gives.
fn scaled(signal: Signal, raw: &RawSignal) -> Signal {
    let (scale, offset) = (raw.scale.unwrap_or(1.0), raw.offset.unwrap_or(0.0));
    Signal { scale: signal.scale * scale, offset: signal.offset * scale + offset, none: raw.none, ..signal }
}

fn part(id: Option<Id>, source: Source) -> Option<(Id, Signal)> {
    match source {
        Source::Frame(_, signal) => Some((id?, signal)),
        Source::Constant(_) => None,
    }
}

/// The frames that these need, in the order of arbitration.
fn carriers(parts: impl Iterator<Item = (Id, Signal)>) -> Vec<Carrier> {
    let mut carriers: Vec<Carrier> = Vec::new();
    for (id, signal) in parts {
        let bytes = (signal.bytes()..=64).find(|bytes| is_fd_length(*bytes)).unwrap_or(64);
        match carriers.iter_mut().find(|carrier| carrier.id == id) {
            Some(carrier) => carrier.bytes = carrier.bytes.max(bytes),
            None => carriers.push(Carrier { id, bytes }),
        }
    }
    carriers.sort_by_key(|carrier| Frame::classic(carrier.id, &[]).priority());
    carriers
}

fn line_of(text: &str, at: usize) -> usize {
    1 + text.get(..at.min(text.len())).map_or(0, |before| before.matches('\n').count())
}

/// What was probably meant.
pub(crate) fn nearest<'a>(word: &str, known: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    let likeness = known.map(|known| (strsim::jaro_winkler(known, word), known));
    likeness
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .filter(|(likeness, _)| *likeness > 0.8)
        .map(|(_, known)| known)
}

#[cfg(test)]
#[path = "table_tests.rs"]
mod tests;
