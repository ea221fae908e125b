//! `can_board`: the distribution board between a simulator and a CAN gateway or a flight computer.
//!
//! Exit codes: 0 it ran and was told to end, 2 it could not start.

use std::io::{Read, Write};
use std::net::SocketAddr;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::Context;
use bateleur_can::node::now_ns;
use bateleur_can_board::{Board, RATE};
use bateleur_can_core::bus::bits::Rates;
use bateleur_can_map::DISTRIBUTION_BOARD;
use clap::Parser;
use rustix::event::{PollFd, PollFlags, Timespec, poll};

/// How soon a stop is noticed, ns.
const STOP_NS: u64 = 100_000_000;

/// The sensors and servos of a simulated aircraft as nodes on a CAN bus, with a gateway to it.
#[derive(Debug, Parser)]
#[command(name = "can_board", version)]
struct Arguments {
    /// The simulator, which speaks its native frames.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:15200")]
    simulator: SocketAddr,
    /// Where the gateway at the board's bus listens; port 0 takes a free one.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:15210")]
    listen: SocketAddr,
    /// The table of frames: a built-in one, or a file.
    #[arg(long, value_name = "NAME|FILE", default_value = DISTRIBUTION_BOARD)]
    table: String,
    /// Bit rate of the bus, bit/s.
    #[arg(long, value_name = "BIT/S", default_value_t = RATE, value_parser = clap::value_parser!(u32).range(10_000..=8_000_000))]
    rate: u32,
    /// Print one line of JSON with the address, and end when the standard input closes: for programs that start it.
    #[arg(long)]
    ready: bool,
}

fn main() -> ExitCode {
    match run(&Arguments::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("can_board: {error:#}");
            ExitCode::from(2)
        }
    }
}

fn run(arguments: &Arguments) -> anyhow::Result<()> {
    let table = bateleur_can_map::from_attributes(&arguments.table, None, bateleur_messages::catalogue())?;
    let mut board = Board::new(table, arguments.listen, arguments.simulator, Rates::classic(arguments.rate))?;
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [signal_hook::consts::SIGTERM, signal_hook::consts::SIGINT] {
        signal_hook::flag::register(signal, stop.clone()).context("cannot watch for signals")?;
    }
    let address = board.address()?;
    if arguments.ready {
        println!("{}", serde_json::json!({ "listening": address.to_string() }));
        std::io::stdout().flush().context("cannot say that it is ready")?;
        end_with_standard_input(stop.clone());
    } else {
        eprintln!("can_board: its gateway listens on {address}, Ctrl-C ends it");
    }
    while !stop.load(Ordering::Relaxed) {
        wait(&board);
        board.turn(now_ns());
    }
    let (traffic, counters) = (board.traffic(), board.counters());
    eprintln!(
        "can_board: {} questions answered, {} frames on the bus in {:.3} s of its time, {} lost in the network",
        board.cycles(),
        traffic.frames,
        traffic.busy_ns as f64 * 1e-9,
        counters.lost()
    );
    Ok(())
}

fn wait(board: &Board) {
    let left_ns = board.due_ns().saturating_sub(now_ns()).min(STOP_NS);
    let time = Timespec { tv_sec: 0, tv_nsec: left_ns as i64 };
    let _ = poll(&mut [PollFd::new(board.socket(), PollFlags::IN)], Some(&time)); // interrupted: look anyway
}

fn end_with_standard_input(stop: Arc<AtomicBool>) {
    std::thread::spawn(move || {
        let mut bytes = [0; 64];
        while std::io::stdin().read(&mut bytes).is_ok_and(|length| length > 0) {}
        stop.store(true, Ordering::Relaxed);
    });
}
