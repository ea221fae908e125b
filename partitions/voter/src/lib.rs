//! What most of three replicas say, and which of them say something else.
//!
//! Responsible for: the value of each field (the median: with one wrong replica it lies between two right ones), and how long a replica
//! may differ until it is outvoted. It must never know a port or a particular message type, and never write a value that no replica wrote.
//!
//! Replicas that are right differ a little: their windows are not at one instant, and an input may have changed between them. A number
//! with a fraction may differ by [`SHARE`] of the largest that was written so far; a time (unit `ns`) and the time at which a message was
//! written by [`LATE_FRAMES`] minor frames; every other number not at all.

#![forbid(unsafe_code)]

pub mod queues;
pub mod standing;

pub use bateleur_contract::{OUTVOTED_BYTES, OUTVOTED_PORT, REPLICAS};
use bateleur_message_format::{Scalar, Type};

use standing::Standing;

/// How far a number with a fraction may be off, as a share of the largest that its field had.
pub const SHARE: f64 = 0.05;
/// How far times may be off, minor frames.
pub const LATE_FRAMES: f64 = 1.5;

/// What one replica has written.
#[derive(Debug, Clone, Copy)]
pub struct Ballot<'a> {
    /// The message.
    pub bytes: &'a [u8],
    /// When it was written, module time, ns.
    pub source_ns: u64,
}

/// Where a replica differs from what is written.
#[derive(Debug, Clone, PartialEq)]
pub struct Difference {
    /// The field's path; `None`: the time at which the message was written, or the whole of a message of plain bytes.
    pub field: Option<String>,
    /// What it wrote, and what is written.
    pub values: Option<(Scalar, Scalar)>,
}

/// What comes of a vote.
#[derive(Debug, Default)]
pub struct Outcome {
    /// When the message was written by the replica in the middle, module time, ns; `None`: there is no message.
    pub source_ns: Option<u64>,
    /// By replica: where it differs, if it does.
    pub differences: [Option<Difference>; REPLICAS],
}

/// One field, or one element of it.
#[derive(Debug)]
struct Element {
    path: String,
    kind: bateleur_message_format::FieldKind,
    offset: usize,
    is_time: bool,
    /// The largest number that was written so far.
    largest: f64,
}

/// Votes on the values of one port.
#[derive(Debug)]
pub struct Election {
    /// Empty: plain bytes, of which only whole messages are compared.
    elements: Vec<Element>,
    /// What was decided last.
    message: Vec<u8>,
}

impl Election {
    /// For messages of a type; `None`: plain bytes.
    #[must_use]
    pub fn new(of: Option<&Type>) -> Self {
        let leaves = of.into_iter().flat_map(Type::leaves);
        let elements = leaves.flat_map(|leaf| {
            (0..leaf.elements()).map(|number| Element {
                path: leaf.count.map_or_else(|| leaf.path.clone(), |_| format!("{}[{number}]", leaf.path)),
                kind: leaf.kind,
                offset: leaf.offset + number * leaf.kind.size(),
                is_time: leaf.unit == "ns",
                largest: 0.0,
            })
        });
        Self { elements: elements.collect(), message: Vec::new() }
    }

    /// The largest number that each field had so far, by which it is judged how far two are apart.
    pub fn scale(&mut self) -> impl Iterator<Item = &mut f64> {
        self.elements.iter_mut().map(|element| &mut element.largest)
    }

    /// The message that the last vote decided on.
    #[must_use]
    pub fn message(&self) -> &[u8] {
        &self.message
    }

    /// Decides between what the replicas wrote, `None` for one that wrote nothing. Where two are left and differ, the doubted one loses;
    /// without doubt in either there is no message, but where replicas may differ (`masks`) the first in rank speaks.
    pub fn vote(
        &mut self,
        ballots: [Option<Ballot<'_>>; REPLICAS],
        minor_frame_ns: u64,
        (standing, masks): (&Standing, bool),
    ) -> Outcome {
        let mut present: Vec<(usize, Ballot<'_>)> =
            ballots.iter().enumerate().filter_map(|(replica, one)| Some((replica, (*one)?))).collect();
        present.sort_by_key(|(replica, _)| standing.rank(*replica));
        let mut agree = false;
        if let &[(one, first), (other, second)] = present.as_slice() {
            let decides = masks || standing.is_doubted(other, one);
            if !decides && self.differences(first, second, minor_frame_ns).is_some() {
                return Outcome::default();
            }
            present.truncate(1);
            agree = !decides;
        }
        let Some(&(_, first)) = present.first() else { return Outcome::default() };
        self.message.clear();
        self.message.extend_from_slice(first.bytes);
        let source_ns = median(present.iter().map(|(_, ballot)| ballot.source_ns).collect(), u64::cmp);
        if present.len() == REPLICAS && !self.take_medians(&present) {
            return Outcome::default();
        }
        let message = std::mem::take(&mut self.message);
        let decided = Ballot { bytes: &message, source_ns: source_ns.unwrap_or(first.source_ns) };
        let mut outcome = Outcome { source_ns: Some(decided.source_ns), differences: Default::default() };
        for (replica, ballot) in ballots.iter().enumerate().filter_map(|(place, one)| Some((place, (*one)?)))
        {
            outcome.differences[replica] = self.differences(ballot, decided, minor_frame_ns);
        }
        self.message = message;
        if present.len() > 1 || agree {
            self.note_largest();
        }
        outcome
    }

    /// Each field of the message is the one in the middle of three; false: they are plain bytes of which no two are the same.
    fn take_medians(&mut self, present: &[(usize, Ballot<'_>)]) -> bool {
        if self.elements.is_empty() {
            let same = |&(replica, one): &(usize, Ballot<'_>)| {
                present.iter().any(|(other, two)| *other != replica && two.bytes == one.bytes)
            };
            let Some((_, most)) = present.iter().find(|ballot| same(ballot)) else { return false };
            self.message.clear();
            self.message.extend_from_slice(most.bytes);
            return true;
        }
        for element in &self.elements {
            let values = present.iter().filter_map(|(_, ballot)| element.read(ballot.bytes)).collect();
            if let Some(value) = median(values, order) {
                // It is of that kind, and there is room: it was read so.
                let _ = value.write(element.kind, &mut self.message[element.offset..]);
            }
        }
        true
    }

    /// The first difference between what one replica wrote and what is written, or another one wrote.
    fn differences(&self, one: Ballot<'_>, other: Ballot<'_>, minor_frame_ns: u64) -> Option<Difference> {
        let late_ns = minor_frame_ns as f64 * LATE_FRAMES;
        if one.source_ns.abs_diff(other.source_ns) as f64 > late_ns
            || (self.elements.is_empty() && one.bytes != other.bytes)
        {
            return Some(Difference { field: None, values: None });
        }
        self.elements.iter().find_map(|element| {
            let (own, decided) = (element.read(one.bytes)?, element.read(other.bytes)?);
            let is_far = !own.is_same(decided) && element.is_far(own, decided, late_ns);
            is_far.then(|| Difference { field: Some(element.path.clone()), values: Some((own, decided)) })
        })
    }

    fn note_largest(&mut self) {
        for element in &mut self.elements {
            let value = element.read(&self.message).map_or(0.0, |value| value.real().abs());
            if value.is_finite() {
                element.largest = element.largest.max(value);
            }
        }
    }
}

impl Element {
    fn read(&self, message: &[u8]) -> Option<Scalar> {
        Scalar::read(self.kind, message.get(self.offset..)?)
    }

    fn is_far(&self, own: Scalar, decided: Scalar, late_ns: f64) -> bool {
        let off = own.difference(decided).abs();
        match own {
            Scalar::Single(_) | Scalar::Real(_) => {
                let most = SHARE * self.largest.max(decided.real().abs());
                // What is not finite is far from everything but itself.
                (off.is_nan() && own.real().is_nan() != decided.real().is_nan()) || off > most
            }
            Scalar::Whole(_) if self.is_time => off > late_ns,
            Scalar::Whole(_) | Scalar::Bool(_) => off > 0.0,
        }
    }
}

fn order(one: &Scalar, other: &Scalar) -> std::cmp::Ordering {
    match (one, other) {
        (Scalar::Whole(one), Scalar::Whole(other)) => one.cmp(other),
        // What is no number stands at the ends, by its sign: in the middle only where two are none.
        (one, other) => one.real().total_cmp(&other.real()),
    }
}

fn median<T: Copy>(mut values: Vec<T>, order: impl Fn(&T, &T) -> std::cmp::Ordering) -> Option<T> {
    values.sort_by(order);
    values.get(values.len().checked_sub(1)? / 2).copied()
}

#[cfg(test)]
mod tests;
