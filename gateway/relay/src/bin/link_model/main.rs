//! `link_model FILE`: a modelled network between the real sockets of two hosts.
//!
//! It stands where each of them expects the other: what one sends it hands on to the other, late, twice, in another order or
//! not at all, as the model says and the seed decides. FILE is JSON: the model, and the ways that it stands in:
//!
//! ```json
//! { "model": { "seed": 7, "delay_ns": 1000000, "jitter_ns": 5000000, "loss": 0.05 },
//!   "ways": [ { "network": "a", "link": 0,
//!               "first":  { "listen": "10.77.0.2:15300", "device": "to_fcu", "peer": "10.77.0.1:15300" },
//!               "second": { "listen": "10.77.0.1:15300", "device": "to_nav", "peer": "10.77.0.2:15300" } } ] }
//! ```
//!
//! `listen` is where the peer sends to; `device` (may be left out, else needs root) lets both sides have addresses that would
//! otherwise be one host's. Instants of `cuts` count from the line `ready`, which it prints when it listens. It ends with
//! its standard input, or by SIGINT or SIGTERM, and prints as JSON what it did, exactly. Exit codes: 0, or 2 where it could
//! not start.

mod passage;

use std::process::ExitCode;

use passage::Passage;

fn main() -> ExitCode {
    let Some(path) = std::env::args().nth(1) else {
        eprintln!("link_model: which FILE? A model of a network and the ways that it stands in, as JSON");
        return ExitCode::from(2);
    };
    match run(&path) {
        Ok(()) => ExitCode::SUCCESS,
        Err(reason) => {
            eprintln!("link_model: {reason}");
            ExitCode::from(2)
        }
    }
}

fn run(path: &str) -> Result<(), String> {
    let text = std::fs::read_to_string(path).map_err(|error| format!("cannot read {path}: {error}"))?;
    let settings = serde_json::from_str(&text).map_err(|error| format!("{path}: {error}"))?;
    let mut passage = Passage::open(&settings)?;
    println!("ready");
    passage.run().map_err(|error| format!("cannot wait for datagrams: {error}"))?;
    let counts = serde_json::to_string_pretty(&passage.counts()).map_err(|error| error.to_string())?;
    println!("{counts}");
    Ok(())
}
