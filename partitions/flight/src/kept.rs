//! States as plain bytes, for memory that outlives a process.
//!
//! Whoever goes on from them is the one that wrote them, to the bit: a replica that starts again with another's memory gives the same
//! words from then on. Any byte may come back from such memory; what no state could have written is refused, and so is a number that is not
//! finite. Little endian.

use nalgebra::{Quaternion, SVector, UnitQuaternion, Vector4};

/// A state that can be kept. See [`kept!`] for one with named fields.
pub(crate) trait Kept: Sized {
    /// How many bytes it has.
    const BYTES: usize;

    /// Writes the bytes.
    fn put(&self, bytes: &mut [u8]);

    /// The state again; `None`: it has written others.
    fn take(bytes: &[u8]) -> Option<Self>;
}

/// Writes `state` at the beginning of `bytes`, which then begin behind it.
pub(crate) fn put_first<T: Kept>(state: &T, bytes: &mut &mut [u8]) {
    if let Some((first, rest)) = std::mem::take(bytes).split_at_mut_checked(T::BYTES) {
        state.put(first);
        *bytes = rest;
    }
}

/// The first state of `bytes`, which then begin behind it.
pub(crate) fn take_first<T: Kept>(bytes: &mut &[u8]) -> Option<T> {
    let (first, rest) = bytes.split_at_checked(T::BYTES)?;
    *bytes = rest;
    T::take(first)
}

/// Makes [`Kept`] of a struct, which has to name all its fields, or of an enum without values. Fields behind a semicolon are not kept, and
/// have the value that stands there. A condition behind it says which states there can be.
macro_rules! kept {
    ($state:ident { $($field:ident: $kind:ty),+ $(,)? $(; $($left:ident = $value:expr),+)? }) => {
        $crate::kept::kept!($state { $($field: $kind),+ $(; $($left = $value),+)? } if |_| true);
    };
    ($state:ident { $($field:ident: $kind:ty),+ $(,)? $(; $($left:ident = $value:expr),+)? } if $can_be:expr) => {
        impl $crate::kept::Kept for $state {
            const BYTES: usize = 0 $(+ <$kind as $crate::kept::Kept>::BYTES)+;

            fn put(&self, mut bytes: &mut [u8]) {
                let Self { $($field),+ $(, $($left: _),+)? } = self;
                $($crate::kept::put_first($field, &mut bytes);)+
            }

            fn take(mut bytes: &[u8]) -> Option<Self> {
                let state = Self {
                    $($field: $crate::kept::take_first::<$kind>(&mut bytes)?),+
                    $(, $($left: $value),+)?
                };
                let can_be: fn(&Self) -> bool = $can_be;
                can_be(&state).then_some(state)
            }
        }
    };
    ($state:ident = $($value:ident)|+) => {
        impl $crate::kept::Kept for $state {
            const BYTES: usize = 1;

            fn put(&self, bytes: &mut [u8]) {
                (*self as u8).put(bytes);
            }

            fn take(bytes: &[u8]) -> Option<Self> {
                [$(Self::$value),+].into_iter().find(|value| bytes == [*value as u8])
            }
        }
    };
}
pub(crate) use kept;

/// Whole numbers, as they are.
macro_rules! whole {
    ($($whole:ty),+) => {
        $(impl Kept for $whole {
            const BYTES: usize = size_of::<Self>();

            fn put(&self, bytes: &mut [u8]) {
                bytes.copy_from_slice(&self.to_le_bytes());
            }

            fn take(bytes: &[u8]) -> Option<Self> {
                bytes.try_into().map(Self::from_le_bytes).ok()
            }
        })+
    };
}
whole!(u8, u16, u32, u64);

/// Numbers that are finite, by their bits.
macro_rules! finite {
    ($($number:ty: $bits:ty),+) => {
        $(impl Kept for $number {
            const BYTES: usize = <$bits as Kept>::BYTES;

            fn put(&self, bytes: &mut [u8]) {
                self.to_bits().put(bytes);
            }

            fn take(bytes: &[u8]) -> Option<Self> {
                <$bits>::take(bytes).map(Self::from_bits).filter(|number| number.is_finite())
            }
        })+
    };
}
finite!(f32: u32, f64: u64);

impl Kept for bool {
    const BYTES: usize = 1;

    fn put(&self, bytes: &mut [u8]) {
        u8::from(*self).put(bytes);
    }

    fn take(bytes: &[u8]) -> Option<Self> {
        [false, true].into_iter().find(|value| bytes == [u8::from(*value)])
    }
}

impl<T: Kept> Kept for Option<T> {
    const BYTES: usize = 1 + T::BYTES;

    fn put(&self, mut bytes: &mut [u8]) {
        put_first(&self.is_some(), &mut bytes);
        match self {
            Some(state) => state.put(bytes),
            None => bytes.fill(0),
        }
    }

    fn take(mut bytes: &[u8]) -> Option<Self> {
        match take_first(&mut bytes)? {
            true => T::take(bytes).map(Some),
            false => Some(None),
        }
    }
}

impl<T: Kept + Copy + Default, const N: usize> Kept for [T; N] {
    const BYTES: usize = N * T::BYTES;

    fn put(&self, mut bytes: &mut [u8]) {
        self.iter().for_each(|state| put_first(state, &mut bytes));
    }

    fn take(mut bytes: &[u8]) -> Option<Self> {
        let mut states = [T::default(); N];
        for state in &mut states {
            *state = take_first(&mut bytes)?;
        }
        Some(states)
    }
}

impl<const N: usize> Kept for SVector<f64, N> {
    const BYTES: usize = <[f64; N]>::BYTES;

    fn put(&self, mut bytes: &mut [u8]) {
        self.iter().for_each(|number| put_first(number, &mut bytes));
    }

    fn take(bytes: &[u8]) -> Option<Self> {
        <[f64; N]>::take(bytes).map(Self::from)
    }
}

impl Kept for UnitQuaternion<f64> {
    const BYTES: usize = Vector4::<f64>::BYTES;

    fn put(&self, bytes: &mut [u8]) {
        self.coords.put(bytes);
    }

    fn take(bytes: &[u8]) -> Option<Self> {
        let quaternion = Quaternion::from(Vector4::take(bytes)?);
        // As it was, to the bit: not normalised anew.
        ((quaternion.norm() - 1.0).abs() < 1e-6).then(|| Self::new_unchecked(quaternion))
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use nalgebra::Vector2;

    /// A state that went through its bytes.
    pub(crate) fn again<T: Kept>(state: &T) -> Option<T> {
        let mut bytes = vec![0xa5; T::BYTES];
        state.put(&mut bytes);
        T::take(&bytes)
    }

    #[derive(Debug, Clone, Copy, PartialEq)]
    enum Colour {
        Red,
        Green,
    }
    kept!(Colour = Red | Green);

    #[derive(Debug, Clone, Copy, PartialEq)]
    struct Lamp {
        colour: Colour,
        is_on: bool,
        times: [u16; 2],
        place: Option<Vector2<f64>>,
        bright: f64,
        warm: f32,
        seen: u32,
    }
    kept!(Lamp { colour: Colour, is_on: bool, times: [u16; 2], place: Option<Vector2<f64>>, bright: f64, warm: f32; seen = 0 }
        if |lamp| lamp.bright >= 0.0);

    const LAMP: Lamp = Lamp {
        colour: Colour::Green,
        is_on: true,
        times: [7, u16::MAX],
        place: Some(Vector2::new(0.1, -1e-300)),
        bright: 1.0 / 3.0,
        warm: 1.0 / 3.0,
        seen: 0,
    };

    #[test]
    fn state_comes_back_to_the_bit() {
        for lamp in [LAMP, Lamp { colour: Colour::Red, is_on: false, place: None, ..LAMP }] {
            assert_eq!(again(&lamp), Some(lamp));
            assert_eq!(again(&Lamp { seen: 9, ..lamp }), Some(lamp));
        }
        let turned = UnitQuaternion::from_euler_angles(0.1, 0.2, 0.3);
        assert_eq!(again(&turned), Some(turned));
    }

    #[test]
    fn bytes_that_no_state_has_written_are_refused() {
        for bright in [-1.0, f64::NAN, f64::INFINITY] {
            assert_eq!(again(&Lamp { bright, ..LAMP }), None, "{bright}");
        }
        for warm in [f32::NAN, f32::NEG_INFINITY] {
            assert_eq!(again(&Lamp { warm, ..LAMP }), None, "{warm}");
        }
        assert_eq!(again(&Lamp { place: Some(Vector2::new(0.0, f64::NAN)), ..LAMP }), None);
        let mut fine = [0; Lamp::BYTES];
        LAMP.put(&mut fine);
        // Colour, switch, and whether there is a place.
        for place in [0, 1, 6] {
            for byte in 2..=u8::MAX {
                let mut bytes = fine;
                bytes[place] = byte;
                assert_eq!(Lamp::take(&bytes), None, "{byte} at {place}");
            }
        }
        assert_eq!(Lamp::take(&fine[1..]), None);
        assert_eq!(UnitQuaternion::take(&[0; 32]), None);
    }
}
