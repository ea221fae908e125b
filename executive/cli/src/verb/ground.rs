//! `bateleur ground`: the ground station for a person. Typed lines become orders; answers and telemetry are printed.
//!
//! The line is a serial device (`--device`), or a pseudo-terminal that this verb makes (`--pty`): it then says what the
//! aircraft's end is called, and the module is started with `--set command.device=…`. `--script` flies the mission of
//! `bateleur fly` over the same line. Exit codes: 0 quit or the mission is flown, 1 the mission failed, 2 the line can not
//! be used.

use std::io::BufRead;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::{Duration, Instant};

use anyhow::{Context, Result};
use bateleur_ground::console::{HELP, Request, describe, status};
use bateleur_ground::{Board, Console, Link, Mission, MissionPlan, Outcome, Pilot, UdpPilot};
use bateleur_messages::hil::PilotOrder;
use bateleur_messages::telemetry::Telemetry;

use super::{Code, FINE, WRONG};
use crate::line::Line;

/// Between two looks at the line.
const STEP: Duration = Duration::from_millis(50);

/// Talk to an aircraft as its ground station.
#[derive(Debug, clap::Args)]
pub(crate) struct Arguments {
    /// The serial device of the radio.
    #[arg(long, short, required_unless_present = "pty", conflicts_with = "pty")]
    device: Option<PathBuf>,
    /// Speed of the serial device, bits a second.
    #[arg(long, default_value_t = 57_600)]
    baud: u32,
    /// Make a pseudo-terminal and say what the aircraft's end is called.
    #[arg(long)]
    pty: bool,
    /// Address of a simulator, whose safety pilot can then be called.
    #[arg(long, value_name = "ADDRESS:PORT")]
    simulator: Option<SocketAddr>,
    /// Print all telemetry as it comes, not only answers.
    #[arg(long, short)]
    watch: bool,
    /// Fly the scripted mission instead of listening to the keyboard.
    #[arg(long)]
    script: bool,
    /// Way-points, laps and limits of the script, instead of the usual two laps of four way-points.
    #[arg(long, value_name = "FILE", requires = "script")]
    mission: Option<PathBuf>,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Code> {
    let (mut link, _line) = open(arguments)?;
    let mut pilot =
        Sticks(arguments.simulator.map(UdpPilot::new).transpose().context("cannot reach the simulator")?);
    if arguments.script {
        let plan = match &arguments.mission {
            Some(path) => MissionPlan::from_file(path)?,
            None => MissionPlan::thesis(),
        };
        return script(Mission::new(plan), &mut link, &mut pilot);
    }
    keyboard(&mut link, &mut pilot, arguments.watch)
}

/// The link, and what must live as long as it.
fn open(arguments: &Arguments) -> Result<(Link, Option<std::os::fd::OwnedFd>)> {
    if let Some(device) = &arguments.device {
        return Ok((Link::serial(device, arguments.baud)?, None));
    }
    let line = Line::open()?;
    println!("the aircraft's end is {0}: start the module with --set command.device={0}", line.device);
    let (link, aircraft) = line.into_link();
    Ok((link, Some(aircraft)))
}

/// The safety pilot, where there is one to call.
struct Sticks(Option<UdpPilot>);

impl Pilot for Sticks {
    fn order(&mut self, order: PilotOrder) {
        match &mut self.0 {
            Some(pilot) => pilot.order(order),
            None => println!(
                "nobody to call: give the simulator's address with --simulator, or tell the pilot yourself"
            ),
        }
    }

    fn confirmed(&mut self) -> bool {
        self.0.as_mut().is_none_or(Pilot::confirmed)
    }
}

fn keyboard(link: &mut Link, pilot: &mut Sticks, watch: bool) -> Result<Code> {
    println!("\"help\" lists what can be typed");
    let (begun, lines) = (Instant::now(), read_lines());
    let (mut board, mut console) = (Board::default(), Console::new());
    loop {
        let now_ns = begun.elapsed().as_nanos() as u64;
        link.flush()?;
        link.receive(|telemetry| {
            board.take(&telemetry, now_ns);
            if watch || matches!(telemetry, Telemetry::Acknowledge(_)) {
                println!("{}", describe(&telemetry));
            }
        })?;
        match lines.try_recv() {
            Ok(line) => match console.line(&line) {
                Ok(Request::Orders(orders)) => orders.iter().try_for_each(|order| link.send(order))?,
                Ok(Request::Pilot(order)) => pilot.order(PilotOrder { order, reserved: 0 }),
                Ok(Request::Status) => print!("{}", status(&board, now_ns)),
                Ok(Request::Help) => println!("{HELP}"),
                Ok(Request::Quit) => return Ok(FINE),
                Ok(Request::Nothing) => {}
                Err(error) => println!("{error}"),
            },
            Err(TryRecvError::Empty) => std::thread::sleep(STEP),
            Err(TryRecvError::Disconnected) => return Ok(FINE),
        }
    }
}

fn read_lines() -> Receiver<String> {
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        let lines = std::io::stdin().lock().lines().map_while(Result::ok);
        lines.take_while(|line| sender.send(line.clone()).is_ok()).for_each(drop);
    });
    receiver
}

fn script(mut mission: Mission, link: &mut Link, pilot: &mut Sticks) -> Result<Code> {
    let begun = Instant::now();
    loop {
        let progress = mission.step(begun.elapsed().as_nanos() as u64, link, pilot);
        progress
            .events
            .iter()
            .for_each(|event| println!("{:9.3} s  {}", event.time_ns as f64 / 1e9, event.text));
        match progress.outcome {
            Outcome::Running => std::thread::sleep(STEP),
            Outcome::Finished => return Ok(FINE),
            Outcome::Failed(why) => {
                println!("the mission failed: {why}");
                return Ok(WRONG);
            }
        }
    }
}
