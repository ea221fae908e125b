//! How the messages of ports lie in CAN frames.
//!
//! Responsible for: reading a table that says so, refusing one that can not be meant, and coding messages into frames and
//! back. A value whose frame did not come is never made up: it is not a number, or the whole message is withheld.

use std::io::Read as _;

use bateleur_messages::Catalogue;

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
/// text likewise. `types`: those of the messages.
///
/// # Errors
/// The file can not be read, or what the table says can not be meant.
pub fn from_attributes(table: &str, dbc: Option<&str>, types: &Catalogue) -> Result<Table, TableError> {
    let (name, text) = match table {
        DISTRIBUTION_BOARD => {
            (table.to_owned(), include_str!("../tables/distribution_board.toml").to_owned())
        }
        text if text.contains('\n') => ("table".to_owned(), text.to_owned()),
        path => {
            let bytes = read(path, "the table")?;
            let text = String::from_utf8(bytes)
                .map_err(|error| TableError::one(format!("the table {path} is not UTF-8 text: {error}")))?;
            (path.to_owned(), text)
        }
    };
    let dbc = match dbc {
        Some(text) if text.contains('\n') => Some(("dbc".to_owned(), text.to_owned())),
        Some(path) => Some((path.to_owned(), dbc_text(read(path, "the DBC file")?))),
        None => None,
    };
    let dbc = dbc.as_ref().map(|(name, text)| (name.as_str(), text.as_str()));
    Table::parse_among(&name, &text, dbc, types)
}

/// Longest file that is read, bytes: taken apart it needs many times that, and a partition's memory is small.
const MOST_BYTES: u64 = 1 << 20;

fn read(path: &str, what: &str) -> Result<Vec<u8>, TableError> {
    let wrong = |why: &dyn std::fmt::Display| TableError::one(format!("cannot read {what} {path}: {why}"));
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(|error| wrong(&error))?;
    // One more shows that there is more.
    file.take(MOST_BYTES + 1).read_to_end(&mut bytes).map_err(|error| wrong(&error))?;
    match bytes.len() as u64 > MOST_BYTES {
        true => Err(wrong(&"it is longer than 1 MiB; leave the messages that are needed in a copy")),
        false => Ok(bytes),
    }
}

/// Many tools write DBC files in Windows-1252, where a byte is a sign. Units and comments have such signs (a degree's); names
/// are of ASCII, so which sign it was does not matter here.
fn dbc_text(bytes: Vec<u8>) -> String {
    String::from_utf8(bytes).unwrap_or_else(|error| error.into_bytes().into_iter().map(char::from).collect())
}
