//! `message_header FOLDER…`: writes a C header (C99, C++17) with the message types of folders to standard output, for partitions in
//! these languages. Exit codes: 0 fine, 2 the types can not be used.

use std::io::Write as _;
use std::path::Path;
use std::process::ExitCode;

use bateleur_message_format::{Catalogue, header, sources};

const USAGE: &str = "usage: message_header FOLDER… > messages.h\n\
    Writes a C header (C99, C++17) with the message types of the folders' files NAME.msg, for partitions in these languages.";
/// What keeps the header from being read twice.
const GUARD: &str = "BATELEUR_MESSAGES_H";

fn main() -> ExitCode {
    let folders: Vec<String> = std::env::args().skip(1).collect();
    if folders.iter().any(|word| word == "--help" || word == "-h") {
        println!("{USAGE}");
        return ExitCode::SUCCESS;
    }
    let written = made(&folders).and_then(|header| {
        std::io::stdout().write_all(header.as_bytes()).map_err(|error| format!("cannot write: {error}"))
    });
    match written {
        Ok(()) => ExitCode::SUCCESS,
        Err(wrong) => {
            eprintln!("{wrong}");
            ExitCode::from(2)
        }
    }
}

fn made(folders: &[String]) -> Result<String, String> {
    if folders.is_empty() {
        return Err(format!("name the folders with the message types\n{USAGE}"));
    }
    let read = |folder: &String| sources(Path::new(folder)).map_err(|error| error.to_string());
    let read: Vec<_> = folders.iter().map(read).collect::<Result<_, _>>()?;
    let catalogue = Catalogue::read(read.into_iter().flatten()).map_err(|faults| faults.to_string())?;
    Ok(header(GUARD, catalogue.types().map(|of| &**of)))
}
