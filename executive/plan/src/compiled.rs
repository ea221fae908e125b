//! The compiled plan: the file that carries a checked plan to the program that runs it.
//!
//! One line of text, `bateleur plan VERSION DIGEST`, and a JSON document behind it: where the plan came from, and the plan.
//! DIGEST is the BLAKE3 digest of the document, 64 hexadecimal digits. Whoever reads it holds no rule of the schedule file against it, but
//! trusts nothing either: a file that is too long, damaged, of another version, or with a value that could hurt
//! ([`crate::bounds`]) is refused by name.

use serde::{Deserialize, Serialize};

use crate::bounds::{self, OutOfBounds};
use crate::model::Plan;

/// The version of the file. It changes with every change of the plan's fields.
pub const VERSION: u32 = 8;
/// The longest file, bytes: several times what the largest plan that the checker lets through needs.
pub const MOST_BYTES: usize = 32 << 20;
/// The first words of the file.
pub const MAGIC: &str = "bateleur plan ";
/// The longest first line, bytes.
const LONGEST_HEAD: usize = 128;

/// A plan, and what it was made from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Compiled {
    /// Where it came from.
    pub source: Source,
    /// The plan.
    pub plan: Plan,
}

/// The file that a plan was made from.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Source {
    /// Its path, as it was named.
    pub name: String,
    /// The BLAKE3 digest of its text, 64 hexadecimal digits.
    pub digest: String,
}

/// Why a compiled plan can not be used.
#[derive(Debug, thiserror::Error)]
pub enum CompiledError {
    /// Something else.
    #[error("it is no compiled plan: `bateleur check --compile FILE` makes one")]
    Foreign,
    /// A program of another version made it.
    #[error(
        "it is a compiled plan of version {0}, and this program reads version {VERSION}: compile it again"
    )]
    Version(String),
    /// Longer than any plan.
    #[error("it is longer than {} MiB, the most that a compiled plan may have", MOST_BYTES >> 20)]
    TooLong,
    /// It is not what was written.
    #[error("it is damaged: its digest is not that of its content; compile it again")]
    Damaged,
    /// It is written well, and is no plan.
    #[error("it is no plan: {0}")]
    Structure(serde_json::Error),
    /// A value that the checker lets nobody write.
    #[error("it is no plan that the checker lets through: {0}")]
    Bounds(#[from] OutOfBounds),
    /// A value that can not be written down, such as a number that is none.
    #[error("the plan can not be written down: {0}")]
    Unwritable(String),
}

impl Compiled {
    /// A plan that was made from `text`, which `name` names.
    #[must_use]
    pub fn new(name: &str, text: &str, plan: Plan) -> Self {
        let digest = blake3::hash(text.as_bytes()).to_hex().to_string();
        Self { source: Source { name: name.to_owned(), digest }, plan }
    }

    /// The file's content.
    ///
    /// # Errors
    /// [`CompiledError::Unwritable`]: it would not be read as the same plan.
    pub fn write(&self) -> Result<Vec<u8>, CompiledError> {
        let unwritable = |error: &dyn std::fmt::Display| CompiledError::Unwritable(error.to_string());
        let body = serde_json::to_vec(self).map_err(|error| unwritable(&error))?;
        let mut bytes = format!("{MAGIC}{VERSION} {}\n", blake3::hash(&body).to_hex()).into_bytes();
        bytes.extend(body);
        match Self::read(&bytes) {
            Ok(again) if again == *self => Ok(bytes),
            Ok(_) => Err(unwritable(&"a value is not read as it was written")),
            Err(error) => Err(unwritable(&error)),
        }
    }

    /// Reads a file's content.
    ///
    /// # Errors
    /// It can not be used; nothing of it was.
    pub fn read(bytes: &[u8]) -> Result<Self, CompiledError> {
        if bytes.len() > MOST_BYTES {
            return Err(CompiledError::TooLong);
        }
        let head = bytes.iter().take(LONGEST_HEAD).position(|&byte| byte == b'\n');
        let (head, body) = bytes.split_at(head.ok_or(CompiledError::Foreign)?);
        let body = body.get(1..).unwrap_or_default();
        let head = std::str::from_utf8(head).ok().and_then(|head| head.strip_prefix(MAGIC));
        let (version, digest) = head.and_then(|head| head.split_once(' ')).ok_or(CompiledError::Foreign)?;
        if version != VERSION.to_string() {
            return Err(CompiledError::Version(version.to_owned()));
        }
        if digest != blake3::hash(body).to_hex().as_str() {
            return Err(CompiledError::Damaged);
        }
        let compiled: Self = serde_json::from_slice(body).map_err(CompiledError::Structure)?;
        bounds::check(&compiled.plan)?;
        Ok(compiled)
    }
}
