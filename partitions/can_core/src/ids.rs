//! Sets of identifiers, as people write them: `100-1ff,2a0,18ff0000-18ffffff`.

use std::fmt;
use std::str::FromStr;

use crate::frame::Id;

/// A set of identifiers.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub enum Ids {
    /// None.
    #[default]
    None,
    /// All.
    All,
    /// Those from the first to the second, inclusive.
    Ranges(Vec<(Id, Id)>),
}

impl Ids {
    /// Whether `id` is in it.
    pub fn contain(&self, id: Id) -> bool {
        match self {
            Self::None => false,
            Self::All => true,
            Self::Ranges(ranges) => ranges.iter().any(|(first, last)| (*first..=*last).contains(&id)),
        }
    }

    /// As pairs of identifier and mask, in the words of Linux, for a filter in the kernel; `None` if it has to let all through.
    /// A range that is no power of two is let through a little wider, and looked at again afterwards.
    pub fn masks(&self) -> Option<Vec<(u32, u32)>> {
        let Self::Ranges(ranges) = self else { return None };
        Some(ranges.iter().map(|(first, last)| mask(*first, *last)).collect())
    }
}

fn mask(first: Id, last: Id) -> (u32, u32) {
    use crate::frame::EXTENDED_FLAG;
    let (flag, bits) = match first {
        Id::Standard(_) => (0, 0x7ff),
        Id::Extended(_) => (EXTENDED_FLAG, 0x1fff_ffff),
    };
    let differ = first.number() ^ last.number();
    let below = u32::MAX.checked_shr(differ.leading_zeros()).unwrap_or(0);
    let mask = bits & !below;
    ((first.number() & mask) | flag, mask | EXTENDED_FLAG)
}

/// A text that is no set of identifiers.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "\"{0}\" is no set of identifiers: write all, none, or hexadecimal numbers and ranges such as 100-1ff,2a0; up to three digits \
     are standard, more are extended"
)]
pub struct NotIds(pub String);

impl FromStr for Ids {
    type Err = NotIds;

    fn from_str(text: &str) -> Result<Self, NotIds> {
        match text.trim() {
            "all" => return Ok(Self::All),
            "none" | "" => return Ok(Self::None),
            _ => {}
        }
        let range = |part: &str| {
            let (first, last) = part.split_once('-').unwrap_or((part, part));
            let (first, last) = (one(first.trim())?, one(last.trim())?);
            let same = std::mem::discriminant(&first) == std::mem::discriminant(&last);
            (same && first <= last).then_some((first, last))
        };
        let ranges = text.split(',').map(|part| range(part.trim())).collect::<Option<_>>();
        ranges.map(Self::Ranges).ok_or_else(|| NotIds(text.into()))
    }
}

/// One identifier: up to three hexadecimal digits are standard, more are extended; `0x` before it says nothing.
pub fn one(text: &str) -> Option<Id> {
    let digits = text.strip_prefix("0x").unwrap_or(text);
    if digits.is_empty() || digits.len() > 8 || digits.starts_with('+') {
        return None;
    }
    let number = u32::from_str_radix(digits, 16).ok()?;
    if digits.len() <= 3 { Id::standard(number) } else { Id::extended(number) }
}

impl fmt::Display for Ids {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::None => f.write_str("none"),
            Self::All => f.write_str("all"),
            Self::Ranges(ranges) => {
                for (place, (first, last)) in ranges.iter().enumerate() {
                    let comma = if place == 0 { "" } else { "," };
                    if first == last {
                        write!(f, "{comma}{first}")?;
                    } else {
                        write!(f, "{comma}{first}-{last}")?;
                    }
                }
                Ok(())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_read_and_hold_what_they_say() {
        let ids: Ids = "100-1ff, 2a0,18FF0000-18ffffff".parse().unwrap();
        for (id, inside) in [
            (Id::Standard(0x100), true),
            (Id::Standard(0x1ff), true),
            (Id::Standard(0x200), false),
            (Id::Standard(0x2a0), true),
            (Id::Extended(0x100), false),
            (Id::Extended(0x18ff_1234), true),
        ] {
            assert_eq!(ids.contain(id), inside, "{id}");
        }
        assert_eq!(ids.to_string(), "100-1FF,2A0,18FF0000-18FFFFFF");
        assert_eq!(ids.to_string().parse(), Ok(ids));
    }

    #[test]
    fn what_is_none_is_refused_with_an_example() {
        for text in ["800", "1-00000002", "2-1", "x", "1,,2", "200000000", "+1"] {
            assert!(text.parse::<Ids>().unwrap_err().to_string().contains("100-1ff"), "{text}");
        }
    }

    #[test]
    fn a_kernels_filter_lets_through_all_of_a_range() {
        let ids: Ids = "100-1ff,18ff0000-18ff0002".parse().unwrap();
        assert_eq!(ids.masks().unwrap(), [(0x100, 0x8000_0700), (0x98ff_0000, 0x9fff_fffc)]);
        assert_eq!(Ids::All.masks(), None);
    }
}
