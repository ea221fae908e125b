//! Places that limit a flight, as the ground sends them: the areas of a fence, and rally points.
//!
//! A list is in force when all of it is there. A list with another number is another list, so one that is sent again in part is not mixed with
//! the one before.

use crate::ground::{OrderError, Waypoint};

/// Marks that a list can hold.
pub const MOST_MARKS: usize = 32;

/// What a mark is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum MarkKind {
    /// A place to return to; its size is the altitude there, m above the runway.
    Rally = 0,
    /// A corner of a polygon to stay in; its size is the number of the polygon's corners, which follow each other in the list.
    InclusionCorner = 1,
    /// A corner of a polygon to stay out of.
    ExclusionCorner = 2,
    /// The centre of a circle to stay in; its size is the radius, m.
    InclusionCircle = 3,
    /// The centre of a circle to stay out of.
    ExclusionCircle = 4,
}

impl MarkKind {
    /// Every kind, in the order of its number.
    pub const ALL: [Self; 5] = [
        Self::Rally,
        Self::InclusionCorner,
        Self::ExclusionCorner,
        Self::InclusionCircle,
        Self::ExclusionCircle,
    ];

    /// The kind with this number.
    pub fn of_number(number: f64) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| f64::from(*kind as u8) == number)
    }

    /// Whether it is a corner of a polygon.
    pub fn is_corner(self) -> bool {
        matches!(self, Self::InclusionCorner | Self::ExclusionCorner)
    }

    /// Whether a size can be flown.
    fn takes(self, size: f64) -> bool {
        match self {
            Self::Rally => (0.0..=Waypoint::HIGHEST_M).contains(&size),
            Self::InclusionCircle | Self::ExclusionCircle => (1.0..=Waypoint::FARTHEST_M).contains(&size),
            _ => size.fract() == 0.0 && (3.0..=MOST_MARKS as f64).contains(&size),
        }
    }
}

/// One place of a list.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mark {
    /// Position in the list, from 0.
    pub index: u8,
    /// Marks in the whole list; 0: there are none, and this one says just that.
    pub count: u8,
    /// The list's number: another one than that of the list before.
    pub list: u8,
    /// What it is.
    pub kind: MarkKind,
    /// North of the runway, m.
    pub north_m: f64,
    /// East of the runway, m.
    pub east_m: f64,
    /// See [`MarkKind`].
    pub size: f64,
}

impl Mark {
    /// That a list is empty.
    pub fn none(list: u8, kind: MarkKind) -> Self {
        Self { index: 0, count: 0, list, kind, north_m: 0.0, east_m: 0.0, size: 0.0 }
    }

    pub(crate) fn data(&self) -> Vec<u8> {
        let mut data = vec![self.index, self.count, self.list, self.kind as u8];
        [self.north_m, self.east_m, self.size].iter().for_each(|number| data.extend(number.to_le_bytes()));
        data
    }

    /// Reads one of a list of rally points, or of a fence.
    pub(crate) fn parse(letter: u8, rally: bool, data: &[u8]) -> Result<Self, OrderError> {
        let (wrong, range) =
            (OrderError::WrongLength(letter as char), OrderError::OutOfRange(letter as char));
        let (&[index, count, list, kind], numbers) = data.split_first_chunk::<4>().ok_or(wrong)?;
        let [north_m, east_m, size] = crate::ground::finite(letter, Some(numbers))?;
        let kind = MarkKind::of_number(f64::from(kind)).filter(|kind| (*kind == MarkKind::Rally) == rally);
        let kind = kind.ok_or(range)?;
        let near = [north_m, east_m].iter().all(|metres| metres.abs() <= Waypoint::FARTHEST_M);
        let empty = count == 0 && index == 0;
        if !empty && (index >= count || !near || !kind.takes(size)) {
            return Err(range);
        }
        Ok(Self { index, count, list, kind, north_m, east_m, size })
    }
}
