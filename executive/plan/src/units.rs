//! Times and sizes as the file writes them: a number and a unit, such as `"1.5s"` and `"64KiB"`.

use std::fmt;

use crate::bounds::LONGEST_NS;

/// Why a text is not a quantity.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum QuantityError {
    /// There is nothing.
    #[error("it is empty")]
    Empty,
    /// It starts with a minus sign.
    #[error("it is negative")]
    Negative,
    /// The part before the unit is not a decimal number.
    #[error("`{0}` is not a decimal number")]
    Number(String),
    /// There is no unit.
    #[error("it has no unit")]
    NoUnit,
    /// The unit is not known.
    #[error("`{0}` is not a unit")]
    Unit(String),
    /// It is not a whole number of the smallest unit.
    #[error("it is not a whole number of {0}")]
    Fraction(&'static str),
    /// It is larger than a signed number of 64 bits holds.
    #[error("it is too large")]
    Overflow,
    /// It is a time of more than a day.
    #[error("it is more than a day")]
    Long,
}

struct Units {
    smallest: &'static str,
    units: &'static [(&'static str, u64)],
}

const TIME: Units = Units {
    smallest: "nanoseconds",
    units: &[("ns", 1), ("us", 1_000), ("ms", 1_000_000), ("s", 1_000_000_000), ("min", 60_000_000_000)],
};

const RATE: Units = Units {
    smallest: "bit/s",
    units: &[("bit/s", 1), ("kbit/s", 1_000), ("Mbit/s", 1_000_000), ("Gbit/s", 1_000_000_000)],
};

const SIZE: Units =
    Units { smallest: "bytes", units: &[("B", 1), ("KiB", 1 << 10), ("MiB", 1 << 20), ("GiB", 1 << 30)] };

/// The units of time, for a message.
pub const TIME_UNITS: &str = "ns, us, ms, s or min";
/// The units of size, for a message.
pub const SIZE_UNITS: &str = "B, KiB, MiB or GiB";

/// The units of a network's rate, for a message.
pub const RATE_UNITS: &str = "bit/s, kbit/s, Mbit/s or Gbit/s";

/// Reads a rate such as `100Mbit/s`, in bits per second.
///
/// # Errors
/// What the text lacks, or has too much of.
pub fn rate_bits_per_s(text: &str) -> Result<u64, QuantityError> {
    quantity(text, &RATE)
}

/// Reads a time such as `500us`, `20ms` or `1.5s`, a day at most, in nanoseconds.
///
/// # Errors
/// What the text lacks, or has too much of.
pub fn duration_ns(text: &str) -> Result<u64, QuantityError> {
    match quantity(text, &TIME)? {
        time if time <= LONGEST_NS => Ok(time),
        _ => Err(QuantityError::Long),
    }
}

/// Reads a size such as `64KiB`, in bytes.
///
/// # Errors
/// What the text lacks, or has too much of.
pub fn size_bytes(text: &str) -> Result<u64, QuantityError> {
    quantity(text, &SIZE)
}

/// A regular expression that every time in a file meets.
#[must_use]
pub fn duration_pattern() -> String {
    pattern(&TIME)
}

/// A regular expression that every rate in a file meets.
#[must_use]
pub fn rate_pattern() -> String {
    pattern(&RATE)
}

/// A regular expression that every size in a file meets.
#[must_use]
pub fn size_pattern() -> String {
    pattern(&SIZE)
}

fn pattern(units: &Units) -> String {
    let names: Vec<&str> = units.units.iter().map(|(name, _)| *name).collect();
    format!("^[0-9._]+\\s*({})$", names.join("|"))
}

fn quantity(text: &str, units: &Units) -> Result<u64, QuantityError> {
    if text.is_empty() {
        return Err(QuantityError::Empty);
    }
    if text.starts_with('-') {
        return Err(QuantityError::Negative);
    }
    let split = text.find(|c: char| !c.is_ascii_digit() && c != '.' && c != '_').unwrap_or(text.len());
    let (number, unit) = text.split_at(split);
    if number.is_empty() {
        return Err(QuantityError::Number(text.to_owned()));
    }
    scaled(number, factor(unit.trim_start(), units)?, units.smallest)
}

fn factor(unit: &str, units: &Units) -> Result<u64, QuantityError> {
    if unit.is_empty() {
        return Err(QuantityError::NoUnit);
    }
    let known = units.units.iter().find(|(name, _)| *name == unit);
    known.map(|(_, factor)| *factor).ok_or_else(|| QuantityError::Unit(unit.to_owned()))
}

/// `number × factor`, exactly: no binary fraction is involved.
fn scaled(number: &str, factor: u64, smallest: &'static str) -> Result<u64, QuantityError> {
    let (whole, fraction) = number.split_once('.').unwrap_or((number, "0"));
    if !is_digits(whole) || !is_digits(fraction) {
        return Err(QuantityError::Number(number.to_owned()));
    }
    let fraction = fraction.trim_end_matches('0');
    let whole: u128 = whole.parse().map_err(|_| QuantityError::Overflow)?;
    let digits = u32::try_from(fraction.len()).map_err(|_| QuantityError::Fraction(smallest))?;
    let parts = if fraction.is_empty() { Ok(0) } else { fraction.parse::<u128>() };
    let parts = parts.map_err(|_| QuantityError::Fraction(smallest))?;
    let scale = 10u128.checked_pow(digits).ok_or(QuantityError::Fraction(smallest))?;
    let factor = u128::from(factor);
    let part = parts.checked_mul(factor).ok_or(QuantityError::Fraction(smallest))?;
    if part % scale != 0 {
        return Err(QuantityError::Fraction(smallest));
    }
    let total = whole.checked_mul(factor).and_then(|whole| whole.checked_add(part / scale));
    // Signed, because times are subtracted from each other and APEX counts them so.
    total.and_then(|total| i64::try_from(total).ok()).map(i64::unsigned_abs).ok_or(QuantityError::Overflow)
}

fn is_digits(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit())
}

/// A time in the largest unit that keeps it short and exact.
#[derive(Clone, Copy, Debug)]
pub struct ShowTime(
    /// In nanoseconds.
    pub u64,
);

/// A rate in the largest unit that it reaches, to three digits behind the point.
#[derive(Clone, Copy, Debug)]
pub struct ShowRate(
    /// In bits per second.
    pub u64,
);

/// A size in the largest unit that keeps it whole.
#[derive(Clone, Copy, Debug)]
pub struct ShowSize(
    /// In bytes.
    pub u64,
);

impl fmt::Display for ShowTime {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (unit, factor) = match self.0 {
            0 => ("s", 1_000_000_000),
            1..1_000 => ("ns", 1),
            1_000..1_000_000 => ("us", 1_000),
            1_000_000..1_000_000_000 => ("ms", 1_000_000),
            _ => ("s", 1_000_000_000),
        };
        let digits = match factor {
            1 => 0,
            1_000 => 3,
            1_000_000 => 6,
            _ => 9,
        };
        let fraction = format!("{:0digits$}", self.0 % factor);
        let fraction = fraction.trim_end_matches('0');
        let point = if fraction.is_empty() { "" } else { "." };
        write!(formatter, "{}{point}{fraction}{unit}", self.0 / factor)
    }
}

impl fmt::Display for ShowRate {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let reached = |(_, factor): &&(&str, u64)| self.0 >= *factor;
        let (unit, factor) = RATE.units.iter().rev().find(reached).copied().unwrap_or(("bit/s", 1));
        // Whole thousandths of the unit: exact enough for a person, and the same on every machine.
        let thousandths = u128::from(self.0) * 1000 / u128::from(factor);
        let fraction = format!("{:03}", thousandths % 1000);
        let fraction = fraction.trim_end_matches('0');
        let point = if fraction.is_empty() { "" } else { "." };
        write!(formatter, "{}{point}{fraction}{unit}", thousandths / 1000)
    }
}

impl fmt::Display for ShowSize {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let fits = |(_, factor): &&(&str, u64)| self.0 >= *factor && self.0.is_multiple_of(*factor);
        let (unit, factor) = SIZE.units.iter().rev().find(fits).copied().unwrap_or(("B", 1));
        write!(formatter, "{}{unit}", self.0 / factor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_exactly() {
        for (text, ns) in [
            ("0s", 0),
            ("1ns", 1),
            ("500us", 500_000),
            ("20ms", 20_000_000),
            ("20 ms", 20_000_000),
            ("1.5s", 1_500_000_000),
            ("0.1s", 100_000_000),
            ("0.000000001s", 1),
            ("2min", 120_000_000_000),
            ("1440min", LONGEST_NS),
        ] {
            assert_eq!(duration_ns(text), Ok(ns), "{text}");
        }
    }

    #[test]
    fn bad_times_say_what_is_wrong() {
        for (text, error) in [
            ("", QuantityError::Empty),
            ("-1ms", QuantityError::Negative),
            ("20", QuantityError::NoUnit),
            ("ms", QuantityError::Number("ms".to_owned())),
            ("1.ms", QuantityError::Number("1.".to_owned())),
            (".5ms", QuantityError::Number(".5".to_owned())),
            ("1.2.3ms", QuantityError::Number("1.2.3".to_owned())),
            ("1_000us", QuantityError::Number("1_000".to_owned())),
            ("20m", QuantityError::Unit("m".to_owned())),
            ("20 MS", QuantityError::Unit("MS".to_owned())),
            ("20ms ", QuantityError::Unit("ms ".to_owned())),
            ("1e3ms", QuantityError::Unit("e3ms".to_owned())),
            ("0.5ns", QuantityError::Fraction("nanoseconds")),
            ("0.0000000001s", QuantityError::Fraction("nanoseconds")),
            ("86400.000000001s", QuantityError::Long),
            ("9223372036854775807ns", QuantityError::Long),
            ("9223372036854775808ns", QuantityError::Overflow),
            ("99999999999999999999999999999999999999999s", QuantityError::Overflow),
        ] {
            assert_eq!(duration_ns(text), Err(error), "{text}");
        }
    }

    #[test]
    fn sizes_are_binary() {
        assert_eq!(size_bytes("64KiB"), Ok(65_536));
        assert_eq!(size_bytes("1.5MiB"), Ok(1_572_864));
        assert_eq!(size_bytes("256B"), Ok(256));
        assert_eq!(size_bytes("64kB"), Err(QuantityError::Unit("kB".to_owned())));
        assert_eq!(size_bytes("16777216GiB"), Ok(1 << 54));
        assert_eq!(size_bytes("8589934592GiB"), Err(QuantityError::Overflow));
    }

    #[test]
    fn rates_are_read_exactly_and_shown_short() {
        for (text, bits, shown) in [
            ("100Mbit/s", 100_000_000, "100Mbit/s"),
            ("1 Gbit/s", 1_000_000_000, "1Gbit/s"),
            ("1.5Mbit/s", 1_500_000, "1.5Mbit/s"),
            ("3076543bit/s", 3_076_543, "3.076Mbit/s"),
            ("0bit/s", 0, "0bit/s"),
        ] {
            assert_eq!(rate_bits_per_s(text), Ok(bits), "{text}");
            assert_eq!(ShowRate(bits).to_string(), shown);
        }
        assert_eq!(rate_bits_per_s("100Mb"), Err(QuantityError::Unit("Mb".to_owned())));
    }

    #[test]
    fn quantities_are_shown_as_they_are_written() {
        for (ns, text) in
            [(0, "0s"), (7, "7ns"), (500_000, "500us"), (2_700_000, "2.7ms"), (1_500_000_000, "1.5s")]
        {
            assert_eq!(ShowTime(ns).to_string(), text);
        }
        assert_eq!(ShowSize(65_536).to_string(), "64KiB");
        assert_eq!(ShowSize(100).to_string(), "100B");
        assert_eq!(ShowSize(0).to_string(), "0B");
    }
}
