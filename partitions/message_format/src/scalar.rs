//! One value of a message.

use crate::FieldKind;

/// One value of a message.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Scalar {
    /// Of a `bool`.
    Bool(bool),
    /// Of a field that counts.
    Whole(i128),
    /// Of a `float32`.
    Single(f32),
    /// Of a `float64`.
    Real(f64),
}

impl Scalar {
    /// The value at the start of `bytes`; `None` if they are too few.
    #[must_use]
    pub fn read(kind: FieldKind, bytes: &[u8]) -> Option<Self> {
        let mut eight = [0; 8];
        let size = kind.size();
        eight[..size].copy_from_slice(bytes.get(..size)?);
        let word = u64::from_le_bytes(eight);
        let signed = |bits: u32| i128::from((word << (64 - bits)) as i64 >> (64 - bits));
        Some(match kind {
            FieldKind::U8 | FieldKind::U16 | FieldKind::U32 | FieldKind::U64 => Self::Whole(word.into()),
            FieldKind::I8 => Self::Whole(signed(8)),
            FieldKind::I16 => Self::Whole(signed(16)),
            FieldKind::I32 => Self::Whole(signed(32)),
            FieldKind::I64 => Self::Whole(signed(64)),
            FieldKind::F32 => Self::Single(f32::from_bits(word as u32)),
            FieldKind::F64 => Self::Real(f64::from_bits(word)),
            FieldKind::Bool => Self::Bool(word != 0),
        })
    }

    /// Writes it at the start of `bytes` as a value of `kind`. `None`, and nothing is written: the kind does not hold the
    /// value, or the bytes are too few.
    pub fn write(self, kind: FieldKind, bytes: &mut [u8]) -> Option<()> {
        let word = match (kind, self) {
            (FieldKind::F64, _) => self.real().to_bits(),
            (FieldKind::F32, Self::Single(value)) => u64::from(value.to_bits()),
            (FieldKind::F32, _) => u64::from((self.real() as f32).to_bits()),
            _ => self.whole_of(kind)? as u64,
        };
        let size = kind.size();
        bytes.get_mut(..size)?.copy_from_slice(&word.to_le_bytes()[..size]);
        Some(())
    }

    /// The value as a whole number, where `kind` holds it.
    fn whole_of(self, kind: FieldKind) -> Option<i128> {
        let (lowest, highest) = kind.range()?;
        let whole = match self {
            Self::Bool(value) => i128::from(value),
            Self::Whole(value) => value,
            // Within 2^64 a conversion is exact where there is no fraction.
            _ if self.real().fract() == 0.0 => self.real() as i128,
            _ => return None,
        };
        (lowest..=highest).contains(&whole).then_some(whole)
    }

    /// The value as a real number, the nearest where it is whole and large.
    #[must_use]
    pub fn real(self) -> f64 {
        match self {
            Self::Bool(value) => f64::from(u8::from(value)),
            Self::Whole(value) => value as f64,
            Self::Single(value) => value.into(),
            Self::Real(value) => value,
        }
    }

    /// The same bits.
    #[must_use]
    pub fn is_same(self, other: Self) -> bool {
        match (self, other) {
            (Self::Single(a), Self::Single(b)) => a.to_bits() == b.to_bits(),
            (Self::Real(a), Self::Real(b)) => a.to_bits() == b.to_bits(),
            (a, b) => a == b,
        }
    }

    /// `other` minus this one.
    #[must_use]
    pub fn difference(self, other: Self) -> f64 {
        match (self, other) {
            (Self::Whole(a), Self::Whole(b)) => (b - a) as f64,
            (a, b) => b.real() - a.real(),
        }
    }
}

/// The shortest text that reads back as the same number.
impl std::fmt::Display for Scalar {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Bool(value) => write!(f, "{value}"),
            Self::Whole(value) => write!(f, "{value}"),
            Self::Single(value) => write!(f, "{value}"),
            Self::Real(value) => write!(f, "{value}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_of_every_range_are_read_as_written_and_one_beyond_is_refused() {
        for &kind in FieldKind::ALL {
            let Some((lowest, highest)) = kind.range() else { continue };
            for value in [lowest, highest] {
                let mut bytes = [0xaa; 8];
                Scalar::Whole(value).write(kind, &mut bytes).unwrap();
                let read = Scalar::read(kind, &bytes).unwrap();
                let expected =
                    if kind == FieldKind::Bool { Scalar::Bool(value != 0) } else { Scalar::Whole(value) };
                assert_eq!(read, expected, "{kind:?}");
                assert!(
                    bytes[kind.size()..].iter().all(|&byte| byte == 0xaa),
                    "{kind:?} writes beyond its end"
                );
            }
            for value in [lowest - 1, highest + 1] {
                assert_eq!(Scalar::Whole(value).write(kind, &mut [0; 8]), None, "{kind:?} {value}");
            }
        }
    }

    #[test]
    fn too_few_bytes_are_no_value() {
        assert_eq!(Scalar::read(FieldKind::F32, &[0; 3]), None);
        assert_eq!(Scalar::Real(1.0).write(FieldKind::F64, &mut [0; 7]), None);
    }

    #[test]
    fn fraction_is_no_whole_number() {
        assert_eq!(Scalar::Real(1.5).write(FieldKind::U8, &mut [0; 8]), None);
        assert_eq!(Scalar::Real(f64::NAN).write(FieldKind::U8, &mut [0; 8]), None);
        let mut bytes = [0; 8];
        Scalar::Real(200.0).write(FieldKind::U8, &mut bytes).unwrap();
        assert_eq!(bytes[0], 200);
    }
}
