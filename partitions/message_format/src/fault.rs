//! What is wrong with a text.

use std::fmt;

/// One thing that is wrong, with its place and how to mend it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fault {
    /// The file, as its source names it.
    pub file: String,
    /// The line, from 1.
    pub line: usize,
    /// The column, in characters from 1.
    pub column: usize,
    /// What is wrong.
    pub what: String,
    /// How to mend it.
    pub mend: String,
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}:{}: {}: {}", self.file, self.line, self.column, self.what, self.mend)
    }
}

/// All that is wrong, at least one thing; a line for each.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Faults(pub Vec<Fault>);

impl fmt::Display for Faults {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, fault) in self.0.iter().enumerate() {
            write!(f, "{}{fault}", if place == 0 { "" } else { "\n" })?;
        }
        Ok(())
    }
}

impl std::error::Error for Faults {}

/// A place in a text.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Spot {
    pub(crate) line: usize,
    pub(crate) column: usize,
}

/// Faults of one file while it is read.
pub(crate) struct Reporter<'a> {
    pub(crate) file: &'a str,
    pub(crate) faults: &'a mut Vec<Fault>,
}

/// Nobody reads more than so many.
const MOST: usize = 64;

impl Reporter<'_> {
    pub(crate) fn add(&mut self, at: Spot, what: impl Into<String>, mend: impl Into<String>) {
        if self.faults.len() < MOST {
            self.faults.push(Fault {
                file: self.file.to_owned(),
                line: at.line,
                column: at.column,
                what: what.into(),
                mend: mend.into(),
            });
        }
    }
}
