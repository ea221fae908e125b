//! Two gateways at full buses, for as long as one likes: `full_bus --virtual-hours 1`, `full_bus --real-minutes 10`.
//!
//! Exit codes: 0 every frame has come and in its place, 1 one has not.

use std::process::ExitCode;
use std::time::{Duration, Instant};

use bateleur_can::soak::{LOADS, Soak, in_real_time, in_virtual_time};
use clap::Parser;

/// Fills buses and looks at what comes on the other side.
#[derive(Debug, Parser)]
struct Arguments {
    /// Bus time in virtual time, h; of each load.
    #[arg(long, default_value_t = 0.0)]
    virtual_hours: f64,
    /// Real time, min; of each load.
    #[arg(long, default_value_t = 0.0)]
    real_minutes: f64,
    /// One load alone: 800 kbit/s, 1 Mbit/s or FD, by 0, 1, 2.
    #[arg(long)]
    load: Option<usize>,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let mut whole = true;
    let chosen =
        LOADS.iter().enumerate().filter(|(place, _)| arguments.load.is_none_or(|load| load == *place));
    for (_, (name, load)) in chosen {
        if arguments.virtual_hours > 0.0 {
            let begun = Instant::now();
            let soak = in_virtual_time(*load, (arguments.virtual_hours * 3.6e12) as u64);
            whole &= say(name, "virtual", &soak, begun);
        }
        if arguments.real_minutes > 0.0 {
            let begun = Instant::now();
            match in_real_time(*load, Duration::from_secs_f64(60.0 * arguments.real_minutes)) {
                Ok(soak) => whole &= say(name, "real", &soak, begun),
                Err(error) => {
                    eprintln!("full_bus: {error}");
                    whole = false;
                }
            }
        }
    }
    ExitCode::from(u8::from(!whole))
}

fn say(name: &str, time: &str, soak: &Soak, begun: Instant) -> bool {
    let Soak { sent, arrived, out_of_sequence, counted_lost, busy_ns, .. } = soak;
    println!(
        "{name}, {time} time: {:.1} s of a full bus, {sent} frames, {} lost, {out_of_sequence} out of sequence, {counted_lost} counted as lost; took {:.1} s",
        *busy_ns as f64 * 1e-9,
        sent - arrived,
        begun.elapsed().as_secs_f64()
    );
    soak.is_whole()
}
