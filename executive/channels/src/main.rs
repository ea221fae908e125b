//! The program `bateleur_channels`: the executive starts it with the name of a helper and its order, as JSON.

mod guarded_memory;

use std::error::Error;
use std::process::ExitCode;

use bateleur_channels::{channel_cleaner, channel_holder, channel_probe};

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let result: Result<(), Box<dyn Error>> = match arguments.iter().map(String::as_str).collect::<Vec<_>>()[..]
    {
        ["channel-holder", order] => channel_holder::run(order).map_err(Into::into),
        ["channel-cleaner", order] => channel_cleaner::run(order).map_err(Into::into),
        ["channel-probe", order] => channel_probe::run(order).map_err(Into::into),
        ["attach", order] => {
            guarded_memory::begin();
            channel_probe::attach(order).map_err(Into::into)
        }
        _ => Err("bateleurd starts this program; nobody needs to call it".into()),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("bateleur_channels: {error}");
            ExitCode::FAILURE
        }
    }
}
