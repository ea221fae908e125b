//! Signals of a DBC file.

use std::collections::BTreeMap;

use bateleur_can_core::Id;
use can_dbc::{ByteOrder, Dbc, Message, MessageId, MultiplexIndicator, SignalExtendedValueType, ValueType};

use crate::signal::{Order, Signal, Sort};

/// What Vector's tools call the place of signals that belong to no message: no frame has its number.
const OF_NO_MESSAGE: &str = "VECTOR__INDEPENDENT_SIG_MSG";

/// The signals of a file by "Message.Signal".
#[derive(Debug, Default)]
pub(crate) struct Signals {
    found: BTreeMap<String, (Id, Signal)>,
    /// Those that lie in some frames of their identifier and not in others.
    multiplexed: Vec<String>,
    /// There is no file.
    absent: bool,
}

impl Signals {
    /// Those of no file.
    pub(crate) fn absent() -> Self {
        Self { absent: true, ..Self::default() }
    }

    /// Reads a file. What is wrong with it is added to `errors`.
    pub(crate) fn read(name: &str, text: &str, errors: &mut Vec<String>) -> Self {
        let mut signals = Self::default();
        let dbc = match Dbc::try_from(text) {
            Ok(dbc) => dbc,
            Err(error) => {
                // The reader's words are of many lines; its first ones say where.
                errors.push(format!("{name}: it is no DBC file: {}", error.to_string().trim_end()));
                return signals;
            }
        };
        let cut = cut(text);
        let mut names: BTreeMap<&str, Id> = BTreeMap::new();
        for message in dbc.messages.iter().filter(|message| message.name != OF_NO_MESSAGE) {
            let id = match message.id {
                MessageId::Standard(id) => match cut.get(&(message.name.as_str(), id)) {
                    Some(number) => Err(*number),
                    None => Id::standard(id.into()).ok_or(u32::from(id)),
                },
                MessageId::Extended(id) => Id::extended(id).ok_or(id),
            };
            match id {
                Err(number) => errors.push(unflagged(name, &message.name, number)),
                Ok(id) => match names.insert(&message.name, id) {
                    Some(other) => errors.push(format!(
                        "{name}: two messages ({other} and {id}) are called {}: rename one of them, or leave it \
                         out",
                        message.name
                    )),
                    None => signals.add(name, &dbc, message, id, errors),
                },
            }
        }
        signals
    }

    fn add(&mut self, name: &str, dbc: &Dbc, message: &Message, id: Id, errors: &mut Vec<String>) {
        let mut taken: BTreeMap<u32, &str> = BTreeMap::new();
        for one in &message.signals {
            let path = format!("{}.{}", message.name, one.name);
            if matches!(
                one.multiplexer_indicator,
                MultiplexIndicator::MultiplexedSignal(_)
                    | MultiplexIndicator::MultiplexorAndMultiplexedSignal(_)
            ) {
                self.multiplexed.push(path);
                continue;
            }
            let extended = dbc
                .signal_extended_value_type_list
                .iter()
                .find(|extended| extended.message_id == message.id && extended.signal_name == one.name);
            let float_bits = match extended.map(|extended| extended.signal_extended_value_type) {
                Some(SignalExtendedValueType::IEEEfloat32Bit) => Some(32),
                Some(SignalExtendedValueType::IEEEdouble64bit) => Some(64),
                Some(SignalExtendedValueType::SignedOrUnsignedInteger) | None => None,
            };
            let sort = match (float_bits, one.value_type) {
                (Some(_), _) => Sort::Float,
                (None, ValueType::Signed) => Sort::Signed,
                (None, ValueType::Unsigned) => Sort::Unsigned,
            };
            let order = match one.byte_order {
                ByteOrder::LittleEndian => Order::Little,
                ByteOrder::BigEndian => Order::Big,
            };
            let (Ok(start), Ok(bits)) = (u32::try_from(one.start_bit), u32::try_from(one.size)) else {
                continue;
            };
            let signal =
                Signal { start, bits, order, sort, scale: one.factor, offset: one.offset, none: None };
            if !(1..=64).contains(&bits) || start >= 512 || signal.bytes() as u64 > message.size {
                errors.push(format!(
                    "{name}: {path} does not fit into the {} bytes of its message",
                    message.size
                ));
                continue;
            }
            if let Some(wanted) = float_bits.filter(|wanted| *wanted != bits) {
                errors.push(format!(
                    "{name}: {path} is a float of {wanted} bits by its SIG_VALTYPE_ and has {bits}: correct one \
                     of the two"
                ));
                continue;
            }
            if let Some(fault) = signal.fault() {
                errors.push(format!("{name}: {path}: {fault}"));
                continue;
            }
            for place in signal.places() {
                if let Some(other) = taken.insert(place, &one.name) {
                    errors.push(format!(
                        "{name}: in message {} ({id}) the signals {other} and {} overlap at bit {place}: correct the start or \
                         the length of one of them",
                        message.name, one.name
                    ));
                    break;
                }
            }
            if self.found.contains_key(&path) {
                errors.push(format!("{name}: {path} is there twice: rename one of them, or leave it out"));
                continue;
            }
            self.found.insert(path, (id, signal));
        }
    }

    /// A signal by "Message.Signal".
    pub(crate) fn get(&self, path: &str) -> Result<(Id, Signal), String> {
        if let Some(found) = self.found.get(path) {
            return Ok(*found);
        }
        if self.multiplexed.iter().any(|name| name == path) {
            return Err(format!(
                "signal {path} is multiplexed, which is not supported: it lies in some frames of its message only, and in others another one \
                 has its bits; let its sender say it in a message of its own"
            ));
        }
        Err(match crate::table::nearest(path, self.found.keys().map(String::as_str)) {
            Some(near) => format!("the DBC file has no signal {path}; did you mean {near}?"),
            None if self.absent => {
                format!("signal {path} is of a DBC file, and there is none (attribute dbc)")
            }
            None if self.found.is_empty() => format!("the DBC file has no signal {path}, nor any other"),
            None => format!("the DBC file has no signal {path}"),
        })
    }
}

/// Bit 31 of a number in a DBC file: its message's identifier is an extended one.
const EXTENDED: u32 = 1 << 31;

/// The numbers above that of the last standard identifier which do not say that they are extended ones, by message and by
/// what the reader of the file makes of them: it cuts them to 16 bits without a word, and that is another message's frame.
fn cut(text: &str) -> BTreeMap<(&str, u16), u32> {
    const BLANKS: [char; 2] = [' ', '\t'];
    let message = |(at, keyword): (usize, &str)| {
        let rest = text[at + keyword.len()..].trim_start_matches(BLANKS);
        let (number, rest) = rest.split_at(rest.find(|sign: char| !sign.is_ascii_digit())?);
        let number: u32 = number.parse().ok().filter(|number| (0x800..EXTENDED).contains(number))?;
        let rest = rest.trim_start_matches(BLANKS);
        let (name, rest) =
            rest.split_at(rest.find(|sign: char| !sign.is_ascii_alphanumeric() && sign != '_')?);
        rest.trim_start_matches(BLANKS).starts_with(':').then_some(((name, number as u16), number))
    };
    text.match_indices("BO_").filter_map(message).collect()
}

/// What is said of a message whose number is no standard identifier and not flagged as an extended one.
fn unflagged(name: &str, message: &str, number: u32) -> String {
    let mend = match Id::extended(number) {
        Some(_) => format!(
            "an extended one has its flag in a DBC file (2147483648 is added): write BO_ {}",
            number | EXTENDED
        ),
        None => "an extended one is 536870911 at most, and has its flag there (2147483648 is added)".into(),
    };
    format!(
        "{name}: message {message} has the identifier {number}, and a standard one is 2047 at most; {mend}"
    )
}
