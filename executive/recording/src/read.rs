//! Reading a log, whole or cut short.

use super::{CDR_HEADER, Layout, LogError, MESSAGE_ENCODING};
use bateleur_messages::format::type_name_of_schema;
use mcap::McapError;
use mcap::records::{Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use std::collections::{BTreeMap, HashMap, HashSet};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use zerocopy::FromBytes;

/// Bytes asked of the file at a time.
const READ_BYTES: usize = 256 * 1024;
/// No record of ours is longer than a chunk; a length beyond this is damage and must not be allocated.
const LONGEST_RECORD: usize = 64 << 20;
/// From this opcode on, records are anybody's own.
const FIRST_PRIVATE: u8 = 0x80;

/// One message of a log.
#[derive(Debug, Clone, Copy)]
pub struct Entry<'a> {
    /// The channel's topic, "/partition/port".
    pub topic: &'a str,
    /// The message type's name as `schedule.toml` has it.
    pub message: &'a str,
    /// The source's sequence, modulo 2³².
    pub sequence: u32,
    /// The source's module time, ns.
    pub time_ns: u64,
    /// The message as it lay in the port.
    pub bytes: &'a [u8],
    /// How it lies there, by the log's own word; `None` if the log says nothing that is understood.
    pub layout: Option<&'a Layout>,
}

/// How a log ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Ending {
    /// With its index and summary.
    Complete,
    /// Early; with the reader's reason, and what shows that what is left was changed too.
    Cut(String),
    /// Some of it was changed after it was written, or can not be read; with what shows it.
    Damaged(String),
}

impl Ending {
    /// What is wrong with the log, to be said behind its name.
    #[must_use]
    pub fn flaw(&self) -> Option<String> {
        match self {
            Self::Complete => None,
            Self::Cut(why) => Some(format!("was cut short ({why})")),
            Self::Damaged(why) => Some(format!("is damaged ({why})")),
        }
    }
}

/// The messages of one source port.
#[derive(Debug, Clone, Default)]
pub struct Track {
    /// The message type's name.
    pub message: String,
    /// Module time, ns, and bytes, in the order logged.
    pub samples: Vec<(u64, Vec<u8>)>,
}

impl Track {
    /// The messages as `T`, with their module time, ns; those of another size than `T` are left out.
    pub fn typed<T: FromBytes>(&self) -> Vec<(u64, T)> {
        let typed =
            |(time, bytes): &(u64, Vec<u8>)| T::read_from_bytes(bytes).ok().map(|value| (*time, value));
        self.samples.iter().filter_map(typed).collect()
    }
}

/// A log in memory.
#[derive(Debug, Clone)]
pub struct Recording {
    /// By topic.
    pub tracks: BTreeMap<String, Track>,
    /// Messages on every topic, those not kept included.
    pub counts: BTreeMap<String, u64>,
    /// How it ended.
    pub ending: Ending,
}

impl Recording {
    /// The messages of type `message`: those on `topic` if it carries them, else those of the first topic that does.
    pub fn track(&self, topic: &str, message: &str) -> Option<&Track> {
        let preferred = self.tracks.get(topic).filter(|track| track.message == message);
        preferred.or_else(|| self.tracks.values().find(|track| track.message == message))
    }
}

/// Reads the messages whose type's name `keep` accepts into memory, and counts the others.
pub fn read(path: impl AsRef<Path>, keep: impl Fn(&str) -> bool) -> Result<Recording, LogError> {
    let mut tracks: BTreeMap<String, Track> = BTreeMap::new();
    let mut counts: BTreeMap<String, u64> = BTreeMap::new();
    let ending = for_each(path, |entry| {
        count(&mut counts, entry.topic);
        if !keep(entry.message) {
            return;
        }
        if !tracks.contains_key(entry.topic) {
            let empty = Track { message: entry.message.to_owned(), samples: Vec::new() };
            tracks.insert(entry.topic.to_owned(), empty);
        }
        if let Some(track) = tracks.get_mut(entry.topic) {
            track.samples.push((entry.time_ns, entry.bytes.to_vec()));
        }
    })?;
    Ok(Recording { tracks, counts, ending })
}

fn count(counts: &mut BTreeMap<String, u64>, topic: &str) {
    match counts.get_mut(topic) {
        Some(count) => *count += 1,
        None => drop(counts.insert(topic.to_owned(), 1)),
    }
}

/// Gives every message of a log to `each`, in the order of the file. A log cut short gives what it holds, to its
/// last whole message; only a file that cannot be opened, read, or is no such log at all is an error.
pub fn for_each(path: impl AsRef<Path>, mut each: impl FnMut(Entry<'_>)) -> Result<Ending, LogError> {
    let mut reader = LogReader::open(path)?;
    loop {
        if let Some(ending) = reader.step(&mut each)? {
            return Ok(ending);
        }
    }
}

/// A log that is read step by step, for those who read two at a time. Where its recorder ended and another one followed,
/// the log has parts, and after a reset of the module further files; they are read as one.
pub struct LogReader {
    /// The first part's of the first start.
    path: PathBuf,
    file: File,
    reader: LinearReader,
    names: Names,
    /// Resets of the module before the start that is read.
    resets: u32,
    /// Parts of that start before the one that is read.
    part: u32,
    /// Why the first part that was cut short was.
    cut: Option<String>,
    /// Chunks whose checksum is wrong.
    damaged: u64,
    /// Records that can not be read.
    unreadable: u64,
}

impl LogReader {
    /// Opens a log. Whether it is one shows with the first step.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, LogError> {
        let path = path.as_ref().to_path_buf();
        let file = File::open(&path).map_err(|why| LogError::File { path: path.clone(), why })?;
        Ok(Self {
            path,
            file,
            reader: linear_reader(),
            names: Names::default(),
            resets: 0,
            part: 0,
            cut: None,
            damaged: 0,
            unreadable: 0,
        })
    }

    /// What shows, so far, that some of it was changed after it was written; `None` if nothing does.
    pub fn damage(&self) -> Option<String> {
        let one = |count: u64, what: &str| (count > 0).then(|| format!("{count} {what}"));
        let checksums = (self.damaged > 0).then(|| {
            format!(
                "the checksum of {} of its pieces, half a second each, is wrong: values of that time may be as well",
                self.damaged
            )
        });
        let found = [
            checksums,
            one(self.unreadable, "of its records can not be read and are left out"),
            one(self.names.nameless, "of its messages are of no port that it names, and are left out"),
            one(self.names.foreign, "of its messages are not encoded as it says, and are left out"),
        ];
        let found: Vec<String> = found.into_iter().flatten().collect();
        (!found.is_empty()).then(|| found.join("; "))
    }

    /// The part that is read has ended: goes on with the next one, of this start or of the one after, or gives the ending of all.
    fn end_of_part(&mut self, cut: Option<String>) -> Result<Option<Ending>, LogError> {
        self.cut = self.cut.take().or(cut);
        for (resets, part) in [(self.resets, self.part + 1), (self.resets + 1, 0)] {
            let path = file_of(&self.path, resets, part);
            match File::open(&path) {
                Ok(file) => {
                    (self.file, self.reader) = (file, linear_reader());
                    (self.resets, self.part) = (resets, part);
                    return Ok(None);
                }
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
                Err(why) => return Err(LogError::File { path, why }),
            }
        }
        Ok(Some(match (self.cut.take(), self.damage()) {
            (Some(why), None) => Ending::Cut(why),
            (Some(why), Some(damage)) => Ending::Cut(format!("{why}; {damage}")),
            (None, Some(damage)) => Ending::Damaged(damage),
            (None, None) => Ending::Complete,
        }))
    }

    /// Reads on by one record, or by a piece of the file; gives `each` the message, if it was one. An ending: that was all.
    pub fn step(&mut self, each: &mut impl FnMut(Entry<'_>)) -> Result<Option<Ending>, LogError> {
        match self.reader.next_event() {
            None => return self.end_of_part(None),
            Some(Ok(LinearReadEvent::ReadRequest(wanted))) => {
                let room = self.reader.insert(wanted.max(READ_BYTES));
                let count =
                    self.file.read(room).map_err(|why| LogError::File { path: self.path.clone(), why })?;
                self.reader.notify_read(count);
            }
            // No log of ours has an attachment, and the crate's parser can panic on a damaged one.
            Some(Ok(LinearReadEvent::Record { opcode: op::ATTACHMENT, .. })) => {}
            // A record has its length before it: one that can not be read is left out, and the reader goes on behind it.
            Some(Ok(LinearReadEvent::Record { data, opcode })) => match mcap::parse_record(opcode, data) {
                Ok(record) if is_misplaced(&record) => self.unreadable += 1,
                Ok(record) => self.names.take(&record, each),
                Err(_) => self.unreadable += 1,
            },
            // What is in the chunk was given already; the reader goes on with the next one.
            Some(Err(McapError::BadChunkCrc { .. })) => self.damaged += 1,
            Some(Err(why @ McapError::BadMagic)) if !self.names.seen_any => {
                return Err(LogError::Container { path: self.path.clone(), why });
            }
            Some(Err(error)) => return self.end_of_part(Some(error.to_string())),
        }
        Ok(None)
    }

    /// The ports that the log has named so far, with or without messages: topic, message type, and how it lies.
    pub fn ports(&self) -> impl Iterator<Item = (&str, &str, Option<&Layout>)> {
        self.names.channels.values().map(|(topic, schema)| match self.names.schemas.get(schema) {
            Some((message, layout)) => (topic.as_str(), message.as_str(), layout.as_ref()),
            None => (topic.as_str(), "", None),
        })
    }
}

/// The file of a part of a log: of the start after so many resets of the module, after so many parts.
fn file_of(first: &Path, resets: u32, part: u32) -> PathBuf {
    let reset = if resets == 0 { String::new() } else { format!("reset-{resets}.") };
    let part = if part == 0 { String::new() } else { format!("part-{part}.") };
    if reset.is_empty() && part.is_empty() {
        return first.to_path_buf();
    }
    first.with_extension(format!("{reset}{part}mcap"))
}

fn linear_reader() -> LinearReader {
    let options = LinearReaderOptions::default().with_validate_chunk_crcs(true);
    LinearReader::new_with_options(options.with_record_length_limit(LONGEST_RECORD))
}

/// Records that the reader gives only where an opcode or a length was changed: it opens chunks itself, and opcodes that the
/// format keeps for later are not in use.
fn is_misplaced(record: &Record<'_>) -> bool {
    match record {
        Record::Chunk { .. } => true,
        Record::Unknown { opcode, .. } => *opcode < FIRST_PRIVATE,
        _ => false,
    }
}

/// What the numbers in a log stand for.
#[derive(Default)]
struct Names {
    seen_any: bool,
    schemas: HashMap<u16, (String, Option<Layout>)>,
    /// Topic and schema.
    channels: HashMap<u16, (String, u16)>,
    /// Channels that say of themselves that they are encoded in another way, such as an export's `/health`.
    others: HashSet<u16>,
    /// Messages on a channel that was never named.
    nameless: u64,
    /// Messages with another header than the encoding that their channel names.
    foreign: u64,
}

impl Names {
    fn take(&mut self, record: &Record<'_>, each: &mut impl FnMut(Entry<'_>)) {
        self.seen_any = true;
        match record {
            Record::Schema { header, data } => {
                let name = type_name_of_schema(&header.name).unwrap_or_else(|| header.name.clone());
                let layout = std::str::from_utf8(data).ok().and_then(|schema| Layout::parse(&name, schema));
                self.schemas.insert(header.id, (name, layout));
            }
            Record::Channel(channel) => {
                self.channels.insert(channel.id, (channel.topic.clone(), channel.schema_id));
                if channel.message_encoding == MESSAGE_ENCODING {
                    self.others.remove(&channel.id);
                } else {
                    self.others.insert(channel.id);
                }
            }
            Record::Message { header, data } => {
                let Some((topic, schema)) = self.channels.get(&header.channel_id) else {
                    self.nameless += 1;
                    return;
                };
                let schema = self.schemas.get(schema);
                let message = schema.map_or("", |(name, _)| name);
                let layout = schema.and_then(|(_, layout)| layout.as_ref());
                let Some(bytes) = data.strip_prefix(&CDR_HEADER[..]) else {
                    self.foreign += u64::from(!self.others.contains(&header.channel_id));
                    return;
                };
                let (sequence, time_ns) = (header.sequence, header.log_time);
                each(Entry { topic, message, sequence, time_ns, bytes, layout });
            }
            _ => {}
        }
    }
}
