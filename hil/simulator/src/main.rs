//! `simulator`: an aircraft that a flight computer can fly over UDP or TCP.
//!
//! Exit codes: 0 it ran and was told to end, 1 it broke while running, 2 it could not start.

use anyhow::Context;
use bateleur_messages::hil::Protocol;
use bateleur_simulator::{Counters, Options, Outside, Server, airframe};
use clap::{Parser, ValueEnum};
use rustix::process::{Signal, getpid, kill_process};
use std::io::{Read, Write};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Flies an aircraft over the network: actuators in, sensors out, in lockstep with the flight computer's time.
#[derive(Debug, Parser)]
#[command(name = "simulator", version)]
struct Arguments {
    /// What is spoken: native, mavlink (over UDP), mavlink-tcp.
    #[arg(long, value_name = "NAME", default_value = "native")]
    protocol: Protocol,
    /// Address to listen on; port 0 takes a free one. Without it, this machine alone and the protocol's usual port: native
    /// 15200, mavlink 14560, mavlink-tcp 4560.
    #[arg(long, value_name = "ADDRESS:PORT")]
    listen: Option<SocketAddr>,
    /// aerosonde, rascal110, ultrastick25e, vtail60, zagi, or a TOML file.
    #[arg(long, value_name = "NAME|FILE", default_value = "aerosonde")]
    airframe: String,
    /// Seed of all chance: the same seed and the same packets give the same flight.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Mean wind.
    #[arg(long, value_name = "M/S", default_value_t = 0.0, value_parser = wind, allow_negative_numbers = true)]
    wind: f64,
    /// Direction that the wind comes from, clockwise from north.
    #[arg(long, value_name = "DEG", default_value_t = 0.0, value_parser = direction, allow_negative_numbers = true)]
    wind_from: f64,
    /// Gusts (Dryden, MIL-F-8785C).
    #[arg(long, value_enum, default_value_t = Turbulence::Calm)]
    turbulence: Turbulence,
    #[command(flatten)]
    outside: Outside,
    /// Advance by the own clock, 20 ms at a time, instead of by the flight computer's.
    #[arg(long)]
    free_running: bool,
    /// Log what was really the case into this file.
    #[arg(long, value_name = "FILE")]
    truth: Option<PathBuf>,
    /// Show the aircraft to a FlightGear that listens at that address.
    #[arg(long, value_name = "ADDRESS:PORT")]
    flightgear: Option<SocketAddr>,
    /// Print one line of JSON with the address once packets are answered, for a program, instead of a line for a person.
    #[arg(long)]
    ready: bool,
    /// End when the standard input closes, so that no simulator outlives who started it.
    #[arg(long)]
    until_stdin_closes: bool,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Turbulence {
    Calm,
    Light,
    Moderate,
    Severe,
}

impl From<Turbulence> for bateleur_plant::Turbulence {
    fn from(level: Turbulence) -> Self {
        match level {
            Turbulence::Calm => Self::Calm,
            Turbulence::Light => Self::Light,
            Turbulence::Moderate => Self::Moderate,
            Turbulence::Severe => Self::Severe,
        }
    }
}

fn number(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err("it must be a number".to_owned()),
    }
}

fn wind(text: &str) -> Result<f64, String> {
    match number(text)? {
        speed if (0.0..=50.0).contains(&speed) => Ok(speed),
        _ => Err("it must lie between 0 and 50 m/s; --wind-from says where it comes from".to_owned()),
    }
}

fn direction(text: &str) -> Result<f64, String> {
    match number(text)? {
        degrees if (-360.0..=360.0).contains(&degrees) => Ok(degrees),
        _ => Err("it must lie between -360 and 360 degrees, clockwise from north".to_owned()),
    }
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    match start(&arguments) {
        Ok((server, stop)) => serve(server, &stop),
        Err(error) => fail(&error, 2),
    }
}

fn fail(error: &anyhow::Error, code: u8) -> ExitCode {
    eprintln!("simulator: {error:#}");
    ExitCode::from(code)
}

fn start(arguments: &Arguments) -> anyhow::Result<(Server, Arc<AtomicBool>)> {
    let server = Server::bind(&options(arguments)?)?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        signal_hook::flag::register(signal, Arc::clone(&stop)).context("cannot listen to signals")?;
    }
    if arguments.until_stdin_closes {
        stop_with_stdin(Arc::clone(&stop));
    }
    if arguments.ready {
        announce(server.address()).context("cannot write to the standard output")?;
    } else {
        eprintln!("simulator: listens on {}, Ctrl-C ends it", server.address());
    }
    Ok((server, stop))
}

fn options(arguments: &Arguments) -> anyhow::Result<Options> {
    let mut options = Options {
        listen: arguments.listen.unwrap_or_else(|| (Ipv4Addr::LOCALHOST, arguments.protocol.port()).into()),
        protocol: arguments.protocol,
        airframe: airframe(&arguments.airframe)?,
        free_running: arguments.free_running,
        truth: arguments.truth.clone(),
        flightgear: arguments.flightgear,
        ..Options::default()
    };
    options.conditions.seed = arguments.seed;
    options.conditions.wind_speed_mps = arguments.wind;
    options.conditions.wind_from_rad = arguments.wind_from.to_radians();
    options.conditions.turbulence = arguments.turbulence.into();
    arguments.outside.apply(&mut options)?;
    Ok(options)
}

/// The socket is bound, so packets that come from now on wait for the first read.
fn announce(address: SocketAddr) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "{}", serde_json::json!({ "listening": address.to_string() }))?;
    out.flush()
}

fn stop_with_stdin(stop: Arc<AtomicBool>) {
    std::thread::spawn(move || {
        let mut rest = [0; 256];
        while matches!(std::io::stdin().read(&mut rest), Ok(1..)) {}
        stop.store(true, Ordering::Relaxed);
        // Out of its wait for the next packet, instead of at the wait's end: whoever flies waits for the log.
        let _ = kill_process(getpid(), Signal::TERM); // else it is noticed within 100 ms
    });
}

fn serve(mut server: Server, stop: &AtomicBool) -> ExitCode {
    match server.run(stop) {
        Ok(counters) => {
            // A module that refused to start has told why; zeros would only push that off the screen.
            if counters != Counters::default() {
                eprintln!("simulator: {counters}");
            }
            ExitCode::SUCCESS
        }
        Err(error) => fail(&error.into(), 1),
    }
}
