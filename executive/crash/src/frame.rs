//! Functions on the stack, and numbers of 64 bits, as a report has them.

use serde::{Deserialize, Serialize};

/// A number that is read and written as text of sixteen: JSON's numbers are not exact beyond 53 bits.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Word(pub u64);

impl Serialize for Word {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(&format_args!("{:#x}", self.0))
    }
}

impl<'de> Deserialize<'de> for Word {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let text = String::deserialize(deserializer)?;
        let digits = text.strip_prefix("0x").unwrap_or(&text);
        u64::from_str_radix(digits, 16).map(Self).map_err(serde::de::Error::custom)
    }
}

/// One function on the stack.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Frame {
    /// The instruction, or one within the call.
    #[serde(with = "word")]
    pub address: u64,
    /// The file that the code was mapped from.
    pub module: Option<String>,
    /// The address as that file has it.
    #[serde(with = "optional_word")]
    pub offset: Option<u64>,
    /// The function.
    pub function: Option<String>,
    /// Its source.
    pub file: Option<String>,
    /// The line, from 1.
    pub line: Option<u32>,
    /// The column, from 1.
    pub column: Option<u32>,
    /// The compiler has made it a part of the function that follows.
    #[serde(default)]
    pub inlined: bool,
    /// It says how the program was ended, and not where.
    #[serde(default)]
    pub runtime: bool,
}

mod word {
    use super::{Deserialize, Serialize, Word};

    pub(super) fn serialize<S: serde::Serializer>(word: &u64, serializer: S) -> Result<S::Ok, S::Error> {
        Word(*word).serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: serde::Deserializer<'de>>(deserializer: D) -> Result<u64, D::Error> {
        Word::deserialize(deserializer).map(|word| word.0)
    }
}

mod optional_word {
    use super::{Deserialize, Serialize, Word};

    pub(super) fn serialize<S: serde::Serializer>(
        word: &Option<u64>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        word.map(Word).serialize(serializer)
    }

    pub(super) fn deserialize<'de, D: serde::Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Option<u64>, D::Error> {
        Ok(Option::<Word>::deserialize(deserializer)?.map(|word| word.0))
    }
}
