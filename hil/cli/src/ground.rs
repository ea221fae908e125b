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
use bateleur_ground::{
    Board, Console, Link, Mission, MissionPlan, Outcome, ParameterDesk, Pilot, UdpPilot, WaypointDesk,
    describe_parameter,
};
use bateleur_messages::ground::Order;
use bateleur_messages::hil::PilotOrder;
use bateleur_messages::parameter::ParameterValue;
use bateleur_messages::telemetry::Telemetry;

use super::{Code, FINE, WRONG};
use crate::line::Line;

/// Between two looks at the line.
const STEP: Duration = Duration::from_millis(50);
/// How long an answer about a parameter may take, and how often it is asked for.
const ANSWER: Duration = Duration::from_millis(1_500);
const TRIES: u32 = 4;

/// Talk to an aircraft as its ground station.
#[derive(Debug, clap::Args)]
pub struct Arguments {
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
    /// List the functions' parameters whose names begin so (all without a name), and leave.
    #[arg(long, value_name = "BEGINNING", num_args = 0..=1, default_missing_value = "", conflicts_with = "script")]
    parameters: Option<String>,
    /// Set a parameter, say what stands, and leave (may be repeated).
    #[arg(long, value_name = "NAME=VALUE", conflicts_with_all = ["script", "parameters"])]
    set: Vec<String>,
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
        return script(Mission::new(plan).setting_laps(), &mut link, &mut pilot);
    }
    if let Some(beginning) = &arguments.parameters {
        return list(&mut link, beginning);
    }
    if !arguments.set.is_empty() {
        return set(&mut link, &arguments.set);
    }
    println!("\"help\" lists what can be typed");
    keyboard(&mut link, &mut pilot, arguments.watch, &read_lines())
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

fn keyboard(link: &mut Link, pilot: &mut Sticks, watch: bool, lines: &Receiver<String>) -> Result<Code> {
    let begun = Instant::now();
    let (mut board, mut console, mut desk) = (Board::default(), Console::new(), ParameterDesk::default());
    let (mut waypoints, mut held) = (WaypointDesk::default(), None);
    loop {
        let now_ns = begun.elapsed().as_nanos() as u64;
        link.beat(now_ns)?;
        link.flush()?;
        link.receive(|telemetry| {
            board.take(&telemetry, now_ns);
            let answer = matches!(
                telemetry,
                Telemetry::Acknowledge(_) | Telemetry::Parameter(_) | Telemetry::Health(_)
            );
            if (watch || answer) && !desk.hides(&telemetry) {
                println!("{}", describe(&telemetry));
            }
            desk.take(&telemetry);
            waypoints.take(&telemetry, &board, now_ns);
        })?;
        let (questions, list) = desk.step(now_ns);
        questions.iter().try_for_each(|question| link.send(question))?;
        list.iter().for_each(|list| print!("{list}"));
        waypoints.step(now_ns, link)?.iter().for_each(|given_up| println!("{given_up}"));
        match held.take().map_or_else(|| lines.try_recv(), Ok) {
            Ok(line) if !waypoints.is_idle() && waits_for_waypoints(&line) => {
                held = Some(line);
                std::thread::sleep(STEP);
            }
            Ok(line) => match console.line(&line) {
                Ok(Request::Orders(orders)) if matches!(orders.first(), Some(Order::Waypoint(_))) => {
                    waypoints.request(orders, &board, now_ns);
                }
                Ok(Request::Orders(orders)) => orders.iter().try_for_each(|order| link.send(order))?,
                Ok(Request::Pilot(order)) => pilot.order(PilotOrder { order, reserved: 0 }),
                Ok(Request::Parameters(beginning)) => desk.list(&beginning),
                Ok(Request::Status) => print!("{}", status(&board, now_ns)),
                Ok(Request::Help) => println!("{HELP}"),
                Ok(Request::Quit) => return Ok(FINE),
                Ok(Request::Nothing) => {}
                Err(error) => println!("{error}"),
            },
            Err(TryRecvError::Empty) => std::thread::sleep(STEP),
            Err(TryRecvError::Disconnected) if !waypoints.is_idle() => std::thread::sleep(STEP),
            Err(TryRecvError::Disconnected) => return Ok(FINE),
        }
    }
}

/// Whether a line makes sense only after the way-points that were typed before it. All others, a call for help among them, go
/// out at once.
fn waits_for_waypoints(line: &str) -> bool {
    let word = line.split_whitespace().next().unwrap_or_default();
    ["waypoint", "navigation", "quit", "exit"].contains(&word)
}

/// Asks for all parameters and lists some.
fn list(link: &mut Link, beginning: &str) -> Result<Code> {
    let (begun, mut desk) = (Instant::now(), ParameterDesk::default());
    desk.list(beginning);
    loop {
        link.flush()?;
        link.receive(|telemetry| desk.take(&telemetry))?;
        let (questions, list) = desk.step(begun.elapsed().as_nanos() as u64);
        questions.iter().try_for_each(|question| link.send(question))?;
        if let Some(list) = list {
            print!("{list}");
            return Ok(FINE);
        }
        std::thread::sleep(STEP);
    }
}

/// Sets parameters one after the other; the answers say what stands.
fn set(link: &mut Link, settings: &[String]) -> Result<Code> {
    let mut code = FINE;
    for setting in settings {
        let (name, value) = setting
            .split_once('=')
            .with_context(|| format!("\"{setting}\" sets nothing: write NAME=VALUE, such as CTL_LAPS=3"))?;
        let Request::Orders(orders) = Console::new().line(&format!("set {name} {value}"))? else { continue };
        let mut stands = None;
        for _ in 0..TRIES {
            orders.iter().try_for_each(|order| link.send(order))?;
            stands = answer(link, name)?;
            if stands.is_some() {
                break;
            }
        }
        let Some(stands) = stands else {
            println!("{name}: no answer; does the line reach the module, and its function run?");
            return Ok(WRONG);
        };
        match stands.refusal() {
            None => println!("{}", describe_parameter(&stands)),
            Some(why) => {
                println!("{name} is not set: {}\n{}", why.text(), describe_parameter(&stands));
                code = WRONG;
            }
        }
    }
    Ok(code)
}

/// What stands after an order to set a parameter, if it comes in time: the order is acknowledged first. A value from before that belongs
/// to a list that somebody asked for earlier.
fn answer(link: &mut Link, name: &str) -> Result<Option<ParameterValue>> {
    let begun = Instant::now();
    let (mut acknowledged_ns, mut found) = (None, None);
    while found.is_none() && begun.elapsed() < ANSWER {
        link.flush()?;
        link.receive(|telemetry| match telemetry {
            Telemetry::Acknowledge(answer) if answer.letter == b'Y' => acknowledged_ns = Some(answer.time_ns),
            Telemetry::Parameter(value)
                if value.name().eq_ignore_ascii_case(name)
                    && acknowledged_ns.is_some_and(|since_ns| value.time_ns >= since_ns) =>
            {
                found = Some(value);
            }
            _ => {}
        })?;
        std::thread::sleep(STEP);
    }
    Ok(found)
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

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_messages::frame::{self, Decoder};
    use bateleur_messages::ground::BEAT;
    use bateleur_messages::telemetry::{Acknowledge, FROM_CONTROLLER};
    use std::collections::BTreeSet;
    use std::io::{Read, Write};
    use std::os::unix::net::UnixStream;
    use std::sync::mpsc::Sender;
    use std::thread::JoinHandle;

    /// Somebody at the keyboard, and the aircraft's end of the line.
    fn somebody() -> (Sender<String>, UnixStream, JoinHandle<Result<Code>>) {
        let (ours, theirs) = UnixStream::pair().unwrap();
        theirs.set_read_timeout(Some(STEP)).unwrap();
        let (sender, lines) = channel();
        let ground =
            std::thread::spawn(move || keyboard(&mut Link::new(ours)?, &mut Sticks(None), false, &lines));
        (sender, theirs, ground)
    }

    #[test]
    fn keyboard_at_which_nothing_is_typed_beats_once_a_second() {
        let (sender, mut aircraft, ground) = somebody();
        let (begun, mut decoder, mut beats) = (Instant::now(), Decoder::new(), 0);
        while beats < 2 && begun.elapsed() < Duration::from_secs(20) {
            let mut bytes = [0; 256];
            let length = aircraft.read(&mut bytes).unwrap_or(0);
            beats += decoder.extend(&bytes[..length]).filter(|frame| frame.letter == BEAT).count();
        }
        drop(sender);
        assert_eq!((beats, ground.join().unwrap().unwrap()), (2, FINE));
    }

    #[test]
    fn value_of_an_older_listing_is_not_taken_for_the_answer_to_a_setting() {
        let (ours, mut aircraft) = UnixStream::pair().unwrap();
        let say = |aircraft: &mut UnixStream, telemetry: Telemetry| {
            let mut bytes = Vec::new();
            let (letter, data) = telemetry.parts();
            frame::encode(letter, data, &mut bytes);
            aircraft.write_all(&bytes).unwrap();
        };
        let value = |time_ns, reason| {
            let name = bateleur_messages::parameter::name_bytes("CTL_LAPS");
            Telemetry::Parameter(ParameterValue { time_ns, reason, name, ..ParameterValue::default() })
        };
        say(&mut aircraft, value(1, 0));
        let ground = std::thread::spawn(move || set(&mut Link::new(ours)?, &["CTL_LAPS=3".to_owned()]));
        let (mut decoder, mut asked) = (Decoder::new(), false);
        while !asked {
            let mut bytes = [0; 256];
            let length = aircraft.read(&mut bytes).unwrap();
            asked = decoder.extend(&bytes[..length]).any(|frame| frame.letter == b'Y');
        }
        say(&mut aircraft, value(2, 0)); // of the listing, still
        let acknowledge =
            Acknowledge { time_ns: 3, letter: b'Y', from: FROM_CONTROLLER, ..Acknowledge::default() };
        say(&mut aircraft, Telemetry::Acknowledge(acknowledge));
        say(&mut aircraft, value(3, bateleur_messages::telemetry::Refusal::NoState as u32));
        assert_eq!(ground.join().unwrap().unwrap(), WRONG, "it was refused");
    }

    #[test]
    fn navigation_typed_after_way_points_goes_out_when_all_of_them_have_arrived() {
        let (sender, mut aircraft, ground) = somebody();
        (0..12).for_each(|index| sender.send(format!("waypoint {index} {index}00 0 160 22")).unwrap());
        sender.send("navigation on".to_owned()).unwrap();
        drop(sender);
        let (begun, mut decoder, mut taken) = (Instant::now(), Decoder::new(), BTreeSet::new());
        let mut navigation_after = None;
        while navigation_after.is_none() && begun.elapsed() < Duration::from_secs(30) {
            let mut bytes = [0; 4096];
            let length = aircraft.read(&mut bytes).unwrap_or(0);
            for frame in decoder.extend(&bytes[..length]) {
                match frame.letter {
                    b'W' => {
                        taken.insert((frame.data[1], frame.data[0]));
                        let answer = Telemetry::Acknowledge(Acknowledge {
                            letter: b'W',
                            first: frame.data[0],
                            from: FROM_CONTROLLER,
                            ..Acknowledge::default()
                        });
                        let mut bytes = Vec::new();
                        let (letter, data) = answer.parts();
                        frame::encode(letter, data, &mut bytes);
                        aircraft.write_all(&bytes).unwrap();
                    }
                    b'N' => navigation_after = Some(taken.len()),
                    _ => {}
                }
            }
        }
        // Every list of 1 to 12, each whole.
        assert_eq!(navigation_after, Some(12 * 13 / 2));
        assert_eq!(ground.join().unwrap().unwrap(), FINE);
    }
}
