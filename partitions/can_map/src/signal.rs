//! A value in some bits of a frame.

/// The order of the bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Order {
    /// Intel: the start is the lowest bit's place.
    #[default]
    Little,
    /// Motorola: the start is the highest bit's place, counted as in a DBC file (bit 7 is the first byte's highest).
    Big,
}

/// What the bits hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Sort {
    /// A number from 0 on.
    #[default]
    Unsigned,
    /// Two's complement.
    Signed,
    /// IEEE 754, of 32 or 64 bits.
    Float,
}

/// A value in some bits of a frame: what they hold times the scale, plus the offset.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Signal {
    /// Its first bit; see [`Order`].
    pub start: u32,
    /// How many bits, 1 to 64.
    pub bits: u32,
    /// The order of its bytes.
    pub order: Order,
    /// What the bits hold.
    pub sort: Sort,
    /// Value of one step.
    pub scale: f64,
    /// Value of step 0.
    pub offset: f64,
    /// The number that says that there is no value.
    pub none: Option<i64>,
}

impl Signal {
    /// The places of its bits in a frame, the lowest first: byte times eight plus bit.
    pub fn places(&self) -> Vec<u32> {
        match self.order {
            Order::Little => (self.start..self.start + self.bits).collect(),
            Order::Big => {
                let next = |place: &u32| Some(if place.is_multiple_of(8) { place + 15 } else { place - 1 });
                let mut places: Vec<u32> =
                    std::iter::successors(Some(self.start), next).take(self.bits as usize).collect();
                places.reverse();
                places
            }
        }
    }

    /// Bytes that a frame needs to hold it.
    pub fn bytes(&self) -> usize {
        self.places().iter().map(|place| *place as usize / 8 + 1).max().unwrap_or(0)
    }

    /// What can not be meant, whatever frame it lies in.
    pub(crate) fn fault(&self) -> Option<String> {
        let Self { start, bits, .. } = *self;
        let (fits, lengths) = match self.sort {
            Sort::Float => (bits == 32 || bits == 64, "a float has 32 or 64 bits"),
            Sort::Unsigned | Sort::Signed => ((1..=64).contains(&bits), "1 to 64 bits"),
        };
        if !fits || start >= 512 || self.bytes() > 64 {
            return Some(format!(
                "{bits} bits from {start}: {lengths}, within the 64 bytes that a frame has at most"
            ));
        }
        if self.scale == 0.0 || !self.scale.is_finite() || !self.offset.is_finite() {
            return Some(
                "the scale (a DBC's factor) must be a number other than 0, the offset a number".into(),
            );
        }
        let none = self.none?;
        if self.sort == Sort::Float {
            return Some(format!(
                "none = {none}: a float says by itself that it is not a number; leave none out"
            ));
        }
        let (least, most) = self.range();
        (!(least..=most).contains(&none.into())).then(|| {
            format!(
                "none = {none} is never what these {bits} bits hold: give a number from {least} to {most}"
            )
        })
    }

    /// Its value in `data`; not a number where there is none. `None` if the frame is too short for it.
    pub fn read(&self, data: &[u8]) -> Option<f64> {
        let mut number = 0_u64;
        for (bit, place) in self.places().iter().enumerate() {
            let byte = data.get(*place as usize / 8)?;
            number |= u64::from(byte >> (place % 8) & 1) << bit;
        }
        let above = 64 - self.bits;
        let signed = (number << above).cast_signed() >> above;
        let stands_for_none =
            |none: i64| none == if self.sort == Sort::Signed { signed } else { number.cast_signed() };
        if self.sort != Sort::Float && self.none.is_some_and(stands_for_none) {
            return Some(f64::NAN);
        }
        let steps = match (self.sort, self.bits) {
            (Sort::Unsigned, _) => number as f64,
            (Sort::Signed, _) => signed as f64,
            (Sort::Float, 32) => f64::from(f32::from_bits(number as u32)),
            (Sort::Float, _) => f64::from_bits(number),
        };
        Some(steps * self.scale + self.offset)
    }

    /// Puts a value into `data`, which is long enough: rounded, at most what the bits can hold. What is not a number
    /// becomes what stands for none, or 0 where nothing does.
    pub fn write(&self, value: f64, data: &mut [u8]) {
        let number = self.number(value);
        for (bit, place) in self.places().iter().enumerate() {
            if let Some(byte) = data.get_mut(*place as usize / 8) {
                let mask = 1 << (place % 8);
                *byte = if number >> bit & 1 != 0 { *byte | mask } else { *byte & !mask };
            }
        }
    }

    fn number(&self, value: f64) -> u64 {
        let steps = (value - self.offset) / self.scale;
        match (self.sort, self.bits) {
            (Sort::Float, 32) => return (steps as f32).to_bits().into(),
            (Sort::Float, _) => return steps.to_bits(),
            _ if value.is_nan() => return self.none.unwrap_or(0).cast_unsigned(),
            _ => {}
        }
        let (least, most) = self.range();
        let mut number = (steps.round() as i128).clamp(least, most);
        if self.none.is_some_and(|none| i128::from(none) == number) {
            // The number next to it, towards 0.
            number -= number.signum();
        }
        number as u64 // two's complement
    }

    fn range(&self) -> (i128, i128) {
        match self.sort {
            Sort::Signed => (-(1 << (self.bits - 1)), (1 << (self.bits - 1)) - 1),
            _ => (0, (1 << self.bits) - 1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn signal(start: u32, bits: u32, order: Order, sort: Sort) -> Signal {
        Signal { start, bits, order, sort, scale: 1.0, offset: 0.0, none: None }
    }

    #[test]
    fn bits_lie_where_a_dbc_says_in_both_orders() {
        let mut data = [0; 8];
        signal(12, 12, Order::Little, Sort::Unsigned).write(f64::from(0xabc), &mut data);
        assert_eq!(data[..3], [0, 0xc0, 0xab]);
        let mut data = [0; 8];
        signal(7, 16, Order::Big, Sort::Unsigned).write(f64::from(0x1234), &mut data);
        assert_eq!(data[..2], [0x12, 0x34]);
        let mut data = [0; 8];
        let across = signal(3, 12, Order::Big, Sort::Unsigned);
        across.write(f64::from(0xabc), &mut data);
        assert_eq!(data[..2], [0x0a, 0xbc]);
        assert_eq!(across.read(&data), Some(f64::from(0xabc)));
        assert_eq!(across.read(&data[..1]), None, "a short frame has no value");
    }

    #[test]
    fn what_is_out_of_range_is_held_at_its_end_and_nothing_stays_nothing() {
        let with_none = Signal { none: Some(-128), scale: 0.5, ..signal(0, 8, Order::Little, Sort::Signed) };
        let through = |value: f64| {
            let mut data = [0xff; 8];
            with_none.write(value, &mut data);
            with_none.read(&data).unwrap()
        };
        assert_eq!((through(1e9), through(-1e9), through(3.2)), (63.5, -63.5, 3.0));
        assert!(through(f64::NAN).is_nan());
        let float = signal(0, 32, Order::Little, Sort::Float);
        let mut data = [0; 8];
        float.write(-1.5, &mut data);
        assert_eq!(float.read(&data), Some(-1.5));
    }

    proptest! {
        #[test]
        fn what_is_written_is_read_and_nothing_beside_it_changes(
            bits in 1_u32..=32, start in 0_u32..24, big: bool, negative: bool, value: u32, fill: u8,
        ) {
            let order = if big { Order::Big } else { Order::Little };
            let sort = if negative { Sort::Signed } else { Sort::Unsigned };
            let signal = signal(start, bits, order, sort);
            prop_assume!(signal.bytes() <= 8);
            let (least, most) = signal.range();
            let number = least + i128::from(value) % (most - least + 1);
            let mut data = [fill; 8];
            signal.write(number as f64, &mut data);
            prop_assert_eq!(signal.read(&data), Some(number as f64));
            let own = signal.places();
            for place in (0..64).filter(|place| !own.contains(place)) {
                prop_assert_eq!(data[place as usize / 8] >> (place % 8) & 1, fill >> (place % 8) & 1);
            }
        }
    }
}
