//! How the messages of ports lie in CAN frames.
//!
//! Responsible for: reading a table that says so, refusing one that can not be meant, and coding messages into frames and
//! back. A value whose frame did not come is never made up: it is not a number, or the whole message is withheld.

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
        path => (path.to_owned(), read(path)?),
    };
    let dbc = match dbc {
        Some(text) if text.contains('\n') => Some(("dbc".to_owned(), text.to_owned())),
        Some(path) => Some((path.to_owned(), read(path)?)),
        None => None,
    };
    Table::parse(&name, &text, dbc.as_ref().map(|(name, text)| (name.as_str(), text.as_str())))
}

fn read(path: &str) -> Result<String, TableError> {
    std::fs::read_to_string(path).map_err(|error| TableError::one(format!("cannot read {path}: {error}")))
}
