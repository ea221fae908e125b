//! The pages of a ring of tracefs (Linux, Documentation/trace/ring-buffer-design.rst and include/linux/ring_buffer.h), and what the
//! kernel's `format` files say of the events in them.
//!
//! A page begins with its time and the count of its bytes. Each record has a word of 32 bits: five for its kind or length, 27 for the time
//! since the record before. It must never read beyond a page, whatever stands in it.

use std::collections::HashMap;

use super::{Event, Interrupt, Names, What};

/// Bytes of a page before its records.
const HEAD: usize = 16;
/// In the count of bytes: records before this page were lost.
const MISSED: u64 = 1 << 31;
/// The bits that are a count.
const COUNT: u64 = (1 << 27) - 1;
/// The states of a thread that is not to run; a bit above them says that it was preempted.
const STATES: u32 = 0xff;
const PADDING: u32 = 29;
const TIME_EXTEND: u32 = 30;
const TIME_STAMP: u32 = 31;

/// What an event means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Role {
    Switch,
    Waking,
    Begin,
    End,
    SoftBegin,
    SoftEnd,
    OwnBegin(&'static str),
    OwnEnd(&'static str),
}

impl Role {
    /// The fields that are read of it.
    fn fields(self) -> &'static [&'static str] {
        match self {
            Self::Switch => {
                &["prev_pid", "prev_prio", "prev_comm", "prev_state", "next_pid", "next_prio", "next_comm"]
            }
            Self::Waking => &["pid"],
            Self::Begin => &["irq", "name"],
            Self::End => &["irq"],
            Self::SoftBegin | Self::SoftEnd => &["vec"],
            Self::OwnBegin(_) | Self::OwnEnd(_) => &[],
        }
    }
}

/// Where the fields of an event stand.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Format {
    role: Role,
    /// Where the number of the present thread stands.
    thread: usize,
    /// Offset and size of each of [`Role::fields`].
    fields: Vec<(usize, usize)>,
}

impl Format {
    /// Reads a `format` file; gives the event's number too. `None`: it is not what is expected.
    pub(super) fn parse(text: &str, role: Role) -> Option<(u16, Self)> {
        let number = text.lines().find_map(|line| line.strip_prefix("ID:"))?.trim().parse().ok()?;
        let (thread, _) = field(text, "common_pid")?;
        let fields = role.fields().iter().map(|name| field(text, name)).collect::<Option<Vec<_>>>()?;
        Some((number, Self { role, thread, fields }))
    }
}

/// Offset and size of a field.
fn field(text: &str, name: &str) -> Option<(usize, usize)> {
    text.lines().find_map(|line| {
        let (declared, rest) = line.trim().strip_prefix("field:")?.split_once(';')?;
        // The name is the last word, without the brackets of an array.
        let word = declared.rsplit([' ', '\t', '*']).next()?;
        if word.split('[').next()? != name {
            return None;
        }
        let value = |key| rest.split(';').find_map(|part| part.trim().strip_prefix(key)?.parse().ok());
        Some((value("offset:")?, value("size:")?))
    })
}

/// The events that are read, by their numbers.
#[derive(Debug, Default)]
pub(super) struct Formats(HashMap<u16, Format>);

impl Formats {
    pub(super) fn add(&mut self, number: u16, format: Format) {
        self.0.insert(number, format);
    }

    pub(super) fn has_switch(&self) -> bool {
        self.0.values().any(|format| format.role == Role::Switch)
    }

    /// Appends what stands in a page.
    pub(super) fn decode(&self, page: &[u8], events: &mut Vec<Event>, names: &mut Names) {
        let (Some(begun_ns), Some(count)) = (word_64(page, 0), word_64(page, 8)) else { return };
        if count & MISSED != 0 {
            events.push(Event { at_ns: begun_ns, thread: 0, what: What::Lost });
        }
        let end = page.len().min(HEAD + (count & COUNT) as usize);
        let (mut at, mut now_ns) = (HEAD, begun_ns);
        while let Some(head) = word_32(page, at).filter(|_| at + 4 <= end) {
            let (kind, delta) = (head & 31, u64::from(head >> 5));
            let next = |word| word_32(page, at + 4).map(|value| (value, at + word));
            let (body, length) = match kind {
                PADDING if delta == 0 => return,
                PADDING => {
                    let Some((length, _)) = next(0) else { return };
                    now_ns += delta;
                    at += 4 + length as usize;
                    continue;
                }
                TIME_EXTEND => {
                    let Some((high, _)) = next(0) else { return };
                    now_ns += (u64::from(high) << 27) + delta;
                    at += 8;
                    continue;
                }
                TIME_STAMP => {
                    let Some((high, _)) = next(0) else { return };
                    // Its five highest bits do not fit, and are those of the time before.
                    now_ns = (now_ns & (31 << 59)) | ((u64::from(high) << 27) + delta);
                    at += 8;
                    continue;
                }
                0 => {
                    let Some((length, body)) = next(8) else { return };
                    (body, (length as usize).saturating_sub(4).next_multiple_of(4))
                }
                words => (at + 4, words as usize * 4),
            };
            now_ns += delta;
            let Some(record) = page.get(body..(body + length).min(end)) else { return };
            if let Some((thread, what)) = self.what(record, names) {
                events.push(Event { at_ns: now_ns, thread, what });
            }
            at = body + length;
        }
    }

    /// Whose it is, and what.
    fn what(&self, record: &[u8], names: &mut Names) -> Option<(i32, What)> {
        let number = u16::from_le_bytes(record.get(..2)?.try_into().ok()?);
        let format = self.0.get(&number)?;
        let value = |place: usize| {
            let (offset, _) = format.fields.get(place)?;
            word_32(record, *offset)
        };
        let bytes = |place: usize| {
            let (offset, size) = *format.fields.get(place)?;
            record.get(offset..offset + size)
        };
        let thread = word_32(record, format.thread)?.cast_signed();
        let what = match format.role {
            Role::Switch => {
                let to = value(4)?.cast_signed();
                names.note_thread(value(0)?.cast_signed(), bytes(2)?, value(1)?.cast_signed());
                names.note_thread(to, bytes(6)?, value(5)?.cast_signed());
                What::Switch { sleeps: value(3)? & STATES != 0, to }
            }
            Role::Waking => What::Waking(value(0)?.cast_signed()),
            Role::Begin => {
                let number = value(0)?.cast_signed();
                // Offset in the low half, length in the high one.
                let place = value(1)?;
                let (offset, size) = ((place & 0xffff) as usize, (place >> 16) as usize);
                if let Some(name) = record.get(offset..offset + size) {
                    names.note_device(number, name);
                }
                What::Begin(Interrupt::Device(number))
            }
            Role::End => What::End(Interrupt::Device(value(0)?.cast_signed())),
            Role::SoftBegin => What::Begin(Interrupt::Soft(value(0)?)),
            Role::SoftEnd => What::End(Interrupt::Soft(value(0)?)),
            Role::OwnBegin(name) => What::Begin(Interrupt::Own(name)),
            Role::OwnEnd(name) => What::End(Interrupt::Own(name)),
        };
        Some((thread, what))
    }
}

fn word_32(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_ne_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

fn word_64(bytes: &[u8], at: usize) -> Option<u64> {
    Some(u64::from_ne_bytes(bytes.get(at..at + 8)?.try_into().ok()?))
}

#[cfg(test)]
mod tests {
    use super::super::Thread;
    use super::*;

    const SWITCH: &str = "name: sched_switch\nID: 372\nformat:\n\
        \tfield:unsigned short common_type;\toffset:0;\tsize:2;\tsigned:0;\n\
        \tfield:int common_pid;\toffset:4;\tsize:4;\tsigned:1;\n\n\
        \tfield:char prev_comm[16];\toffset:8;\tsize:16;\tsigned:0;\n\
        \tfield:pid_t prev_pid;\toffset:24;\tsize:4;\tsigned:1;\n\
        \tfield:int prev_prio;\toffset:28;\tsize:4;\tsigned:1;\n\
        \tfield:long prev_state;\toffset:32;\tsize:8;\tsigned:1;\n\
        \tfield:char next_comm[16];\toffset:40;\tsize:16;\tsigned:0;\n\
        \tfield:pid_t next_pid;\toffset:56;\tsize:4;\tsigned:1;\n\
        \tfield:int next_prio;\toffset:60;\tsize:4;\tsigned:1;\n";

    fn formats() -> Formats {
        let mut formats = Formats::default();
        let (number, format) = Format::parse(SWITCH, Role::Switch).unwrap();
        formats.add(number, format);
        formats
    }

    fn switch(from: i32, to: i32) -> Vec<u8> {
        let mut record = vec![0; 64];
        record[..2].copy_from_slice(&372_u16.to_le_bytes());
        record[8..11].copy_from_slice(b"old");
        record[4..8].copy_from_slice(&from.to_le_bytes());
        record[24..28].copy_from_slice(&from.to_le_bytes());
        record[28..32].copy_from_slice(&120_i32.to_le_bytes());
        record[40..43].copy_from_slice(b"new");
        record[56..60].copy_from_slice(&to.to_le_bytes());
        record[60..64].copy_from_slice(&0_i32.to_le_bytes());
        record
    }

    fn page(parts: &[(u32, u32, Vec<u8>)]) -> Vec<u8> {
        let mut body = Vec::new();
        for (kind, delta, bytes) in parts {
            body.extend((kind | delta << 5).to_le_bytes());
            body.extend(bytes);
        }
        [&1_000_u64.to_le_bytes()[..], &(body.len() as u64).to_le_bytes(), &body].concat()
    }

    #[test]
    fn a_format_is_read_by_the_names_of_its_fields() {
        let (number, format) = Format::parse(SWITCH, Role::Switch).unwrap();
        assert_eq!(number, 372);
        assert_eq!(format.thread, 4);
        assert_eq!(format.fields, [(24, 4), (28, 4), (8, 16), (32, 8), (56, 4), (60, 4), (40, 16)]);
        assert_eq!(Format::parse("ID: 1\n", Role::Switch), None);
        assert_eq!(field("\tfield:__data_loc char[] name;\toffset:12;\tsize:4;", "name"), Some((12, 4)));
    }

    #[test]
    fn records_of_every_kind_keep_the_time_of_those_after_them() {
        let extended = 5_u32.to_le_bytes().to_vec();
        let long = [&68_u32.to_le_bytes()[..], &switch(8, 9)].concat();
        let skipped = [&8_u32.to_le_bytes()[..], &[0; 4]].concat();
        let page = page(&[
            (16, 10, switch(7, 8)),
            (TIME_EXTEND, 1, extended),
            (PADDING, 3, skipped),
            (0, 2, long),
            (PADDING, 0, Vec::new()),
            (16, 10, switch(9, 1)),
        ]);
        let (mut events, mut names) = (Vec::new(), Names::default());
        formats().decode(&page, &mut events, &mut names);
        let times: Vec<u64> = events.iter().map(|event| event.at_ns).collect();
        assert_eq!(times, [1_010, 1_010 + (5 << 27) + 1 + 3 + 2]);
        let to = |event: &Event| match event.what {
            What::Switch { to, .. } => (event.thread, to),
            _ => (-1, -1),
        };
        assert_eq!(events.iter().map(to).collect::<Vec<_>>(), [(7, 8), (8, 9)]);
        assert_eq!(names.thread(9), Some(&Thread { name: "new".into(), priority: 0 }));
        assert_eq!(names.thread(8), Some(&Thread { name: "old".into(), priority: 120 }));
    }

    #[test]
    fn a_page_of_anything_is_read_to_its_end_at_most() {
        let whole = page(&[(16, 10, switch(7, 8)), (TIME_EXTEND, 1, vec![1; 4]), (16, 10, switch(8, 7))]);
        let mut seed = 1_u64;
        for round in 0..20_000 {
            let mut damaged = whole.clone();
            for _ in 0..round % 8 {
                seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
                let at = (seed >> 33) as usize % damaged.len();
                damaged[at] = (seed >> 24) as u8;
            }
            damaged.truncate((seed >> 40) as usize % (whole.len() + 1));
            formats().decode(&damaged, &mut Vec::new(), &mut Names::default());
        }
    }
}
