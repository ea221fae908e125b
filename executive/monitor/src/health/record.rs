//! What the persistent health log looks like in its file: records of one size, each with a checksum, in a ring.
//!
//! Responsible for: bytes that say whether they are whole, and a reader that finds every whole record in a file of any
//! content and no other. Touches no file itself, see [`super::ring`].
//!
//! ```text
//! header  64 bytes: "BTLRHEAL", version (4), bytes of a record (4), number of records (8), policy (4), checksum (4), zeros
//! record 256 bytes: checksum (4), level (4), sequence (8), time ns (8), frame (8), generation (4), zeros (4),
//!                   partition (32), error (24), action (16), detail (144)
//! ```
//!
//! Numbers are little-endian, checksums are CRC-32, texts end with their first zero byte. Record number `n` (from 1) stands
//! at place `(n - 1)` modulo the number of records. A place that holds zeros only was never written.

use std::ops::Range;

use serde::Serialize;

use bateleur_plan::{Closed, LogPolicy};

/// Bytes of the header.
pub const HEADER: usize = 64;
/// Bytes of a record.
pub const RECORD: usize = 256;

const MAGIC: &[u8; 8] = b"BTLRHEAL";
const VERSION: u32 = 1;
/// Places of the texts in a record.
const PARTITION: Range<usize> = 40..72;
const ERROR: Range<usize> = 72..96;
const ACTION: Range<usize> = 96..112;
const DETAIL: Range<usize> = 112..RECORD;

/// At which level something was dealt with.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// In the partition.
    Partition = 1,
    /// In the module.
    Module = 2,
    /// In the partition's own error handler.
    Process = 3,
}

/// One record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Entry {
    /// From 1, over all runs that wrote into the file.
    pub sequence: u64,
    /// Module time, ns.
    pub time_ns: u64,
    /// The minor frame, counted from module time 0, of the last window that the monitor knew of.
    pub frame: u64,
    /// The incarnation that it is about.
    pub generation: u32,
    /// Where it was dealt with.
    pub level: Level,
    /// The partition; empty: the module itself.
    pub partition: String,
    /// The error, as the health tables name it; `module_start`, `module_stop`, `recovered` and `message` are none.
    pub error: String,
    /// What was done; empty: nothing had to be.
    pub action: String,
    /// What is known beside it.
    pub detail: String,
}

/// What a file holds.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Contents {
    /// Every whole record, oldest first.
    pub entries: Vec<Entry>,
    /// Records that are not whole: cut off while they were written, or damaged later.
    pub damaged: usize,
    /// Records that the file has room for.
    pub room: u64,
    /// What becomes of it when it is full.
    pub policy: LogPolicy,
    /// Older records that were written over.
    pub overwritten: u64,
}

impl Contents {
    /// Whether every place has been used.
    #[must_use]
    pub fn is_full(&self) -> bool {
        self.entries.last().is_some_and(|last| last.sequence >= self.room)
    }
}

/// Why bytes can not be read as a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RecordError {
    /// Too short, or something else.
    #[error("this is no health log: it does not begin like one")]
    NoLog,
    /// Written by another version.
    #[error("this is a health log of version {0}, and this program reads version {VERSION}")]
    Version(u32),
    /// The header is damaged.
    #[error("the header of this health log is damaged: its checksum does not fit")]
    Header,
}

/// Where the next record goes.
#[derive(Debug, Clone, Copy)]
pub struct Ring {
    /// Records that there is room for; not zero.
    pub room: u64,
    /// What becomes of a full ring.
    pub policy: LogPolicy,
    /// The number of the next record, from 1.
    pub next: u64,
}

impl Ring {
    /// An empty ring in a file of at most `bytes`.
    #[must_use]
    pub fn new(bytes: u64, policy: LogPolicy) -> Self {
        Self { room: (bytes.saturating_sub(HEADER as u64) / RECORD as u64).max(1), policy, next: 1 }
    }

    /// Bytes of its file.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        HEADER as u64 + self.room * RECORD as u64
    }

    /// The header of its file.
    #[must_use]
    pub fn header(&self) -> [u8; HEADER] {
        let mut bytes = [0; HEADER];
        bytes[..8].copy_from_slice(MAGIC);
        bytes[8..12].copy_from_slice(&VERSION.to_le_bytes());
        bytes[12..16].copy_from_slice(&(RECORD as u32).to_le_bytes());
        bytes[16..24].copy_from_slice(&self.room.to_le_bytes());
        bytes[24..28].copy_from_slice(&(self.policy as u32).to_le_bytes());
        let checksum = crc32fast::hash(&bytes[..28]);
        bytes[28..32].copy_from_slice(&checksum.to_le_bytes());
        bytes
    }

    /// Numbers an entry: its bytes, and their place in the file. `None` if the ring is full and keeps what it has.
    pub fn add(&mut self, mut entry: Entry) -> Option<(u64, [u8; RECORD])> {
        if self.policy == LogPolicy::Keep && self.next > self.room {
            return None;
        }
        entry.sequence = self.next;
        self.next += 1;
        let place = (entry.sequence - 1) % self.room;
        Some((HEADER as u64 + place * RECORD as u64, encode(&entry)))
    }
}

fn encode(entry: &Entry) -> [u8; RECORD] {
    let mut bytes = [0; RECORD];
    bytes[4..8].copy_from_slice(&(entry.level as u32).to_le_bytes());
    bytes[8..16].copy_from_slice(&entry.sequence.to_le_bytes());
    bytes[16..24].copy_from_slice(&entry.time_ns.to_le_bytes());
    bytes[24..32].copy_from_slice(&entry.frame.to_le_bytes());
    bytes[32..36].copy_from_slice(&entry.generation.to_le_bytes());
    let texts = [
        (PARTITION, &entry.partition),
        (ERROR, &entry.error),
        (ACTION, &entry.action),
        (DETAIL, &entry.detail),
    ];
    for (place, text) in texts {
        let end =
            (0..=text.len().min(place.len())).rev().find(|end| text.is_char_boundary(*end)).unwrap_or(0);
        bytes[place.start..place.start + end].copy_from_slice(&text.as_bytes()[..end]);
    }
    let checksum = crc32fast::hash(&bytes[4..]);
    bytes[..4].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

/// Reads a log, also one that was cut off, damaged, or is being written.
///
/// # Errors
/// The bytes are no health log.
pub fn read(bytes: &[u8]) -> Result<Contents, RecordError> {
    let header = bytes.get(..HEADER).ok_or(RecordError::NoLog)?;
    if header[..8] != *MAGIC {
        return Err(RecordError::NoLog);
    }
    if number(header, 28) != crc32fast::hash(&header[..28]) {
        return Err(RecordError::Header);
    }
    if number(header, 8) != VERSION {
        return Err(RecordError::Version(number(header, 8)));
    }
    let room = long_number(header, 16);
    let policy = LogPolicy::ALL.iter().copied().find(|policy| *policy as u32 == number(header, 24));
    let policy = policy.filter(|_| room > 0).ok_or(RecordError::Header)?;
    let mut contents = Contents { entries: Vec::new(), damaged: 0, room, policy, overwritten: 0 };
    for (place, record) in (0..room).zip(bytes[HEADER..].chunks(RECORD)) {
        if record.iter().all(|byte| *byte == 0) {
            continue;
        }
        // A whole record in a place that is not its own was copied there.
        match decode(record).filter(|entry| entry.sequence > 0 && (entry.sequence - 1) % room == place) {
            Some(entry) => contents.entries.push(entry),
            None => contents.damaged += 1,
        }
    }
    contents.entries.sort_by_key(|entry| entry.sequence);
    contents.overwritten = contents.entries.last().map_or(0, |last| last.sequence.saturating_sub(room));
    Ok(contents)
}

fn decode(record: &[u8]) -> Option<Entry> {
    if record.len() < RECORD || number(record, 0) != crc32fast::hash(&record[4..]) {
        return None;
    }
    let text = |place: Range<usize>| {
        let bytes = record[place].split(|byte| *byte == 0).next().unwrap_or_default();
        String::from_utf8_lossy(bytes).into_owned()
    };
    Some(Entry {
        level: match number(record, 4) {
            1 => Level::Partition,
            2 => Level::Module,
            3 => Level::Process,
            _ => return None,
        },
        sequence: long_number(record, 8),
        time_ns: long_number(record, 16),
        frame: long_number(record, 24),
        generation: number(record, 32),
        partition: text(PARTITION),
        error: text(ERROR),
        action: text(ACTION),
        detail: text(DETAIL),
    })
}

fn number(bytes: &[u8], at: usize) -> u32 {
    bytes[at..at + 4].iter().rev().fold(0, |number, byte| (number << 8) | u32::from(*byte))
}

fn long_number(bytes: &[u8], at: usize) -> u64 {
    (u64::from(number(bytes, at + 4)) << 32) | u64::from(number(bytes, at))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn entry(time_ns: u64, detail: &str) -> Entry {
        Entry {
            sequence: 0,
            time_ns,
            frame: time_ns / 20,
            generation: 3,
            level: Level::Partition,
            partition: "estimator".into(),
            error: "memory_violation".into(),
            action: "warm_restart".into(),
            detail: detail.into(),
        }
    }

    fn begun(ring: &Ring) -> Vec<u8> {
        let mut file = ring.header().to_vec();
        file.resize(ring.bytes() as usize, 0);
        file
    }

    proptest! {
        /// The log is killed in the middle of a write, of which any bytes arrived, and cut off at any length.
        #[test]
        fn kill_at_any_byte_leaves_every_other_record_and_no_false_one(
            room in 1_u64..9,
            keep in any::<bool>(),
            whole in 0_usize..30,
            arrived in prop::collection::vec(any::<bool>(), RECORD),
            length in prop::option::of(0_usize..HEADER + 9 * RECORD),
        ) {
            let policy = if keep { LogPolicy::Keep } else { LogPolicy::Overwrite };
            let mut ring = Ring::new(HEADER as u64 + room * RECORD as u64, policy);
            prop_assert_eq!(ring.room, room);
            let mut file = begun(&ring);
            let mut expected = std::collections::BTreeMap::new();
            for number in 0..whole {
                if let Some((place, bytes)) = ring.add(entry(number as u64, "ended by SIGSEGV")) {
                    file[place as usize..][..RECORD].copy_from_slice(&bytes);
                    expected.insert(place as usize, number as u64);
                }
            }
            let torn = ring.add(entry(999, "the last"));
            if let Some((place, bytes)) = torn {
                let place = place as usize;
                for (at, _) in arrived.iter().enumerate().filter(|(_, arrived)| **arrived) {
                    file[place + at] = bytes[at];
                }
                // It counts only as what it is when nothing tells it from a whole one.
                if file[place..][..RECORD] == bytes {
                    expected.insert(place, 999);
                } else if decode(&file[place..][..RECORD]).is_none() {
                    expected.remove(&place);
                }
            }
            file.truncate(length.unwrap_or(usize::MAX).max(HEADER));
            expected.retain(|place, _| place + RECORD <= file.len());
            let log = read(&file).unwrap();
            let mut found: Vec<u64> = log.entries.iter().map(|entry| entry.time_ns).collect();
            prop_assert!(log.entries.is_sorted_by(|one, other| one.sequence < other.sequence));
            found.sort_unstable();
            let mut expected: Vec<u64> = expected.into_values().collect();
            expected.sort_unstable();
            prop_assert_eq!(found, expected);
            prop_assert!(log.damaged <= 2, "the torn one and the one that was cut off");
        }

        #[test]
        fn any_bytes_can_be_read_and_give_no_record(noise in prop::collection::vec(any::<u8>(), 0..3000)) {
            let mut file = Ring::new(4096, LogPolicy::Overwrite).header().to_vec();
            file.extend(&noise);
            prop_assert_eq!(read(&file).unwrap().entries, []);
            let _ = read(&noise);
        }
    }

    #[test]
    fn any_changed_byte_is_found() {
        let mut ring = Ring::new(2000, LogPolicy::Overwrite);
        let mut file = begun(&ring);
        for time_ns in [1, 2] {
            let (place, bytes) = ring.add(entry(time_ns, "why")).unwrap();
            file[place as usize..][..RECORD].copy_from_slice(&bytes);
        }
        for at in (0..32).chain(HEADER..HEADER + RECORD) {
            let mut changed = file.clone();
            changed[at] ^= 0x10;
            let found = read(&changed).map(|log| (log.entries.len(), log.damaged));
            assert!(found.is_err() || found == Ok((1, 1)), "byte {at}: {found:?}");
        }
    }

    #[test]
    fn record_that_was_copied_to_another_place_is_no_record() {
        let mut ring = Ring::new(2000, LogPolicy::Overwrite);
        let mut file = begun(&ring);
        let (_, bytes) = ring.add(entry(1, "")).unwrap();
        for place in [0, 3] {
            file[HEADER + place * RECORD..][..RECORD].copy_from_slice(&bytes);
        }
        let log = read(&file).unwrap();
        assert_eq!((log.entries.len(), log.damaged), (1, 1));
    }

    #[test]
    fn words_that_are_too_long_are_cut_between_letters() {
        let back = decode(&encode(&entry(1, &"ä".repeat(200)))).unwrap();
        assert_eq!(back.detail, "ä".repeat(DETAIL.len() / 2));
    }
}
