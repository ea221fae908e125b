//! What the cargo aliases run: `cargo fly` and `cargo verify`; and for whoever writes pages one step of the latter alone, `commands` and
//! `pages`, and `trusted` and `apex`, which write the tables of two pages: the lines of the daemon, and the requirements that have a test; and
//! `package`, which makes the Debian packages.
//!
//! Responsible for: building before flying, and everything that must pass before a change lands. It must never depend on
//! another crate, so that the first thing a fresh clone builds is built in a second.

mod apex;
mod arrows;
mod blocks;
mod book;
mod circles;
mod commands;
mod features;
mod fly;
mod links;
mod package;
mod step;
mod tally;
mod trusted;
mod verify;

use std::ffi::OsString;
use std::process::ExitCode;

/// The command line could not be followed, or what it asks for could not begin.
const CANNOT_RUN: u8 = 2;

fn main() -> ExitCode {
    let mut arguments = std::env::args_os().skip(1);
    match arguments.next().as_deref().and_then(|verb| verb.to_str()) {
        Some("fly") => fly::run(arguments.collect()),
        Some("commands") => verify::only_commands(),
        Some("package") => package::run(&verify::root(), &arguments.collect::<Vec<OsString>>()),
        Some("pages") => verify::only_pages(),
        Some("apex") => verify::write_page(apex::check),
        Some("trusted") => verify::write_page(trusted::check),
        Some("verify") => verify::run(&arguments.collect::<Vec<OsString>>()),
        _ => {
            eprintln!(
                "usage: cargo fly [what `bateleur fly` takes] | cargo verify | cargo run -p tasks -- commands | … pages | … apex | … trusted | … package"
            );
            ExitCode::from(CANNOT_RUN)
        }
    }
}

/// The cargo that started this program, or the one that the shell would find.
fn cargo() -> OsString {
    std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into())
}
