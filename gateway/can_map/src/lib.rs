//! How the messages of ports lie in CAN frames.
//!
//! Responsible for: reading a table that says so, refusing one that can not be meant, and coding messages into frames and
//! back. A value whose frame did not come is never made up: it is not a number, or the whole message is withheld.

use std::io::Read as _;

mod assembly;
mod dbc;
mod raw;
mod signal;
mod table;

pub use assembly::{Assembly, Outcome};
pub use signal::{Order, Signal, Sort};
pub use table::{Layout, Sync, Table, TableError};

/// The table of the simulated distribution board, by name.
pub const DISTRIBUTION_BOARD: &str = "distribution_board";

/// The table behind an attribute: the name of one that is built in, a file's path, or a table itself. `dbc`: a path or a
/// text likewise.
///
/// # Errors
/// The file can not be read, or what the table says can not be meant.
pub fn from_attributes(table: &str, dbc: Option<&str>) -> Result<Table, TableError> {
    let (name, text) = match table {
        DISTRIBUTION_BOARD => {
            (table.to_owned(), include_str!("../tables/distribution_board.toml").to_owned())
        }
        text if text.contains('\n') => ("table".to_owned(), text.to_owned()),
        path => (path.to_owned(), read(path, "the table")?),
    };
    let dbc = match dbc {
        Some(text) if text.contains('\n') => Some(("dbc".to_owned(), text.to_owned())),
        Some(path) => Some((path.to_owned(), read(path, "the DBC file")?)),
        None => None,
    };
    Table::parse(&name, &text, dbc.as_ref().map(|(name, text)| (name.as_str(), text.as_str())))
}

/// Longest file that is read, bytes: taken apart it needs many times that, and a partition's memory is small.
const MOST_BYTES: u64 = 1 << 20;

fn read(path: &str, what: &str) -> Result<String, TableError> {
    let wrong = |why: &dyn std::fmt::Display| TableError::one(format!("cannot read {what} {path}: {why}"));
    let mut text = String::new();
    let file = std::fs::File::open(path).map_err(|error| wrong(&error))?;
    // One more shows that there is more.
    file.take(MOST_BYTES + 1).read_to_string(&mut text).map_err(|error| wrong(&error))?;
    match text.len() as u64 > MOST_BYTES {
        true => Err(wrong(&"it is longer than 1 MiB; leave the messages that are needed in a copy")),
        false => Ok(text),
    }
}
