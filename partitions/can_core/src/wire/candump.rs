//! Log files of candump (`candump -l`): `(1436509052.249713) vcan0 044#2A366C2BBA`, one frame a line.

use crate::frame::{ERROR_FLAG, EXTENDED_FLAG, Frame, FrameError, Id, Kind};

/// One line.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Entry {
    /// When, since 1970 or since the log began, ns.
    pub time_ns: u64,
    /// The interface that heard it.
    pub interface: String,
    /// What it heard.
    pub frame: Frame,
}

/// Why a line is no entry.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// Not the three parts.
    #[error("expected \"(seconds.fraction) interface id#data\"")]
    Parts,
    /// The time.
    #[error("\"{0}\" is no time such as (1436509052.249713)")]
    Time(String),
    /// The frame.
    #[error("\"{0}\" is no frame such as 123#0102, 123#R4 or 123##1AABB")]
    Text(String),
    /// A frame that can not be.
    #[error("\"{text}\": {error}")]
    Frame {
        /// The frame's text.
        text: String,
        /// What is wrong with it.
        error: FrameError,
    },
}

/// Reads a line.
///
/// # Errors
/// What is wrong with it.
pub fn parse(line: &str) -> Result<Entry, Refusal> {
    let mut parts = line.split_ascii_whitespace();
    let (Some(time), Some(interface), Some(text)) = (parts.next(), parts.next(), parts.next()) else {
        return Err(Refusal::Parts);
    };
    let time_ns = time_ns(time).ok_or_else(|| Refusal::Time(time.into()))?;
    Ok(Entry { time_ns, interface: interface.into(), frame: frame(text)? })
}

/// Writes a line, without its end.
pub fn line(entry: &Entry) -> String {
    let Entry { time_ns, interface, frame } = entry;
    format!("({}.{:06}) {interface} {frame}", time_ns / 1_000_000_000, time_ns / 1_000 % 1_000_000)
}

fn time_ns(text: &str) -> Option<u64> {
    let inner = text.strip_prefix('(')?.strip_suffix(')')?;
    let (seconds, fraction) = inner.split_once('.')?;
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    if !is_number(seconds) || !is_number(fraction) || fraction.len() > 9 {
        return None;
    }
    let fraction_ns = fraction.parse::<u64>().ok()? * 10_u64.pow(9 - fraction.len() as u32);
    seconds.parse::<u64>().ok()?.checked_mul(1_000_000_000)?.checked_add(fraction_ns)
}

/// Reads a frame as candump and cansend write it.
///
/// # Errors
/// What is wrong with it.
pub fn frame(text: &str) -> Result<Frame, Refusal> {
    let no = || Refusal::Text(text.into());
    let wrong = |error| Refusal::Frame { text: text.into(), error };
    let (id, rest) = text.split_once('#').ok_or_else(no)?;
    let number = u32::from_str_radix(id, 16).map_err(|_| no())?;
    let word = match id.len() {
        3 => number,
        // Eight digits are an extended identifier, unless its flag says that it is an error.
        8 if number & ERROR_FLAG != 0 => number & !EXTENDED_FLAG,
        8 => number | EXTENDED_FLAG,
        _ => return Err(no()),
    };
    if let Some(fd) = rest.strip_prefix('#') {
        let (flags, data) = fd.split_at_checked(1).ok_or_else(no)?;
        let flags = u8::from_str_radix(flags, 16).map_err(|_| no())?;
        let data = bytes(data).ok_or_else(no)?;
        return Frame::of_word(word, Some((flags & 1 != 0, flags & 2 != 0)), 0, &data).map_err(wrong);
    }
    if let Some(length) = rest.strip_prefix(['R', 'r']) {
        let length = if length.is_empty() { 0 } else { length.parse().map_err(|_| no())? };
        let id = if id.len() == 3 { Id::standard(number) } else { Id::extended(number) };
        return Frame::remote(id.ok_or(wrong(FrameError::Id(number)))?, length).map_err(wrong);
    }
    let data = bytes(rest).ok_or_else(no)?;
    Frame::of_word(word, None, 0, &data).map_err(wrong)
}

/// Pairs of digits, which cansend lets be parted by dots.
fn bytes(text: &str) -> Option<Vec<u8>> {
    let digits: Vec<u8> = text
        .chars()
        .filter(|one| *one != '.')
        .map(|one| one.to_digit(16).map(|digit| digit as u8))
        .collect::<Option<_>>()?;
    let (pairs, rest) = digits.as_chunks::<2>();
    rest.is_empty().then(|| pairs.iter().map(|[high, low]| high << 4 | low).collect())
}

/// Whether this is an error frame of a controller, which a replay leaves out.
pub fn is_report(frame: &Frame) -> bool {
    frame.kind() == Kind::Error
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::any;
    use proptest::prelude::*;

    #[test]
    fn lines_of_the_real_program_are_read_and_written() {
        for (text, time_ns) in [
            ("(1436509052.249713) vcan0 044#2A366C2BBA", 1_436_509_052_249_713_000),
            ("(0.000001) can1 1ABCDEF0#", 1_000),
            ("(7.500000) can1 123#R4", 7_500_000_000),
            ("(7.500000) can1 123##1AABBCCDD", 7_500_000_000),
            ("(7.500000) can1 20000004#0004000000000000", 7_500_000_000),
        ] {
            let entry = parse(text).unwrap();
            assert_eq!(entry.time_ns, time_ns);
            assert_eq!(line(&entry), text);
        }
        assert_eq!(parse("(1.0) can0 123#11.22.33").unwrap().frame.data(), [0x11, 0x22, 0x33]);
        assert!(is_report(&parse("(7.500000) can1 20000004#0004000000000000").unwrap().frame));
    }

    #[test]
    fn a_bad_line_says_which_part_is_wrong() {
        let said = |line: &str| parse(line).unwrap_err().to_string();
        assert!(said("hello").contains("expected"));
        assert!(said("(x.1) can0 123#").contains("no time"));
        assert!(said("(1.0) can0 12#").contains("no frame"));
        assert!(said("(1.0) can0 123#1").contains("no frame"));
        assert!(said("(1.0) can0 123#112233445566778899").contains("9 bytes"));
        assert!(said("(1.0) can0 FFF#").contains("no identifier"));
    }

    proptest! {
        #[test]
        fn what_is_written_is_read(frame in any::frame(), micros in 0_u64..u64::MAX / 1_000) {
            let entry = Entry { time_ns: micros * 1_000, interface: "can0".into(), frame };
            prop_assert_eq!(parse(&line(&entry)), Ok(entry));
        }

        #[test]
        fn any_text_is_read_or_refused(text in ".{0,40}") {
            let _ = parse(&text);
            let _ = frame(&text);
        }
    }
}
