//! A message put together from frames as they come.

use bateleur_can_core::{Frame, Id, Kind};
use bateleur_messages::format::Scalar;

use crate::table::{Layout, Source};

/// Frames of one set come at most so far apart, module time, ns: two windows, and something for those that wait.
const SPREAD_NS: u64 = 50_000_000;

/// What a frame did.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// It belongs to something else.
    Foreign,
    /// It is a part; more is to come.
    Part,
    /// The message is there: its bytes, and how many of its frames had not come. Numbers of those are not numbers.
    Whole(Vec<u8>, usize),
    /// Its last frame came, but a frame with a whole number in it had not: nothing is believed.
    Withheld,
}

/// See the module's text.
#[derive(Debug)]
pub struct Assembly {
    layout: Layout,
    /// What has come, and when, module time, ns.
    parts: Vec<Option<(Frame, u64)>>,
}

impl Assembly {
    /// Nothing has come yet.
    pub fn new(layout: Layout) -> Self {
        Self { parts: vec![None; layout.carriers.len()], layout }
    }

    /// What it puts together.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// Whether frames of this identifier belong here.
    pub fn wants(&self, id: Id) -> bool {
        self.layout.ids().any(|own| own == id)
    }

    /// What has come so far is of a set whose end will not come.
    pub fn forget(&mut self) {
        self.parts.fill(None);
    }

    /// Takes a frame that is of module time `now_ns`: when it came, less how old it was then.
    pub fn take(&mut self, frame: &Frame, now_ns: u64) -> Outcome {
        let place = self.layout.carriers.iter().position(|carrier| carrier.id == frame.id());
        let (Some(place), Kind::Data | Kind::Fd { .. }) = (place, frame.kind()) else {
            return Outcome::Foreign;
        };
        self.parts[place] = Some((*frame, now_ns));
        if place != self.layout.complete {
            return Outcome::Part;
        }
        for part in &mut self.parts {
            part.take_if(|(_, came_ns)| now_ns.abs_diff(*came_ns) > SPREAD_NS);
        }
        let message = self.message(now_ns);
        let missing = self.parts.iter().filter(|part| part.is_none()).count();
        self.parts.fill(None);
        message.map_or(Outcome::Withheld, |bytes| Outcome::Whole(bytes, missing))
    }

    fn message(&self, now_ns: u64) -> Option<Vec<u8>> {
        let mut bytes = vec![0; self.layout.size];
        let value_of =
            |place: usize, signal: &crate::Signal| signal.read(self.parts[place].as_ref()?.0.data());
        for slot in &self.layout.slots {
            let value = match &slot.source {
                Source::Constant(value) => Some(*value),
                Source::Frame(place, signal) => value_of(*place, signal),
            };
            let number = match slot.kind.range() {
                None => Scalar::Real(value.unwrap_or(f64::NAN)),
                // A whole number is held at the ends of its range; what is no number is none.
                Some((lowest, highest)) => {
                    let value = value.filter(|value| !value.is_nan())?.round();
                    Scalar::Whole((value as i128).clamp(lowest, highest))
                }
            };
            number.write(slot.kind, bytes.get_mut(slot.offset..)?)?;
        }
        if let Some(stamp) = self.layout.stamp {
            let age_ns = match &self.layout.age {
                Some((place, signal)) => value_of(*place, signal).filter(|age| !age.is_nan())? as u64,
                None => 0,
            };
            bytes[stamp..stamp + 8].copy_from_slice(&now_ns.saturating_sub(age_ns).to_le_bytes());
        }
        Some(bytes)
    }
}
