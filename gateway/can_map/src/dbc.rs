//! Signals of a DBC file.

use std::collections::BTreeMap;

use bateleur_can::Id;
use can_dbc::{ByteOrder, Dbc, Message, MessageId, MultiplexIndicator, SignalExtendedValueType, ValueType};

use crate::signal::{Order, Signal, Sort};

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
        match Dbc::try_from(text) {
            Ok(dbc) => dbc.messages.iter().for_each(|message| signals.add(name, &dbc, message, errors)),
            // The reader's words are of many lines; its first ones say where.
            Err(error) => errors.push(format!("{name}: it is no DBC file: {}", error.to_string().trim_end())),
        }
        signals
    }

    fn add(&mut self, name: &str, dbc: &Dbc, message: &Message, errors: &mut Vec<String>) {
        let id = match message.id {
            MessageId::Standard(id) => Id::standard(id.into()),
            MessageId::Extended(id) => Id::extended(id),
        };
        let Some(id) = id else { return };
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
            let sort = match (extended.map(|extended| extended.signal_extended_value_type), one.value_type) {
                (
                    Some(SignalExtendedValueType::IEEEfloat32Bit | SignalExtendedValueType::IEEEdouble64bit),
                    _,
                ) => Sort::Float,
                (_, ValueType::Signed) => Sort::Signed,
                (_, ValueType::Unsigned) => Sort::Unsigned,
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
