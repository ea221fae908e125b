//! The ground station for a person: typed lines become orders, telemetry becomes text.

use crate::board::Board;
use crate::retry_queue::function_name;
use bateleur_messages::SimulatorLink;
use bateleur_messages::ground::{
    EstimatorOrder, LoopId, Manoeuvre, Order, Reason, SENSOR_ACCELEROMETER, SENSOR_GYROSCOPE,
    SENSOR_PRESSURE, Step, Waypoint,
};
use bateleur_messages::hil::Protocol;
use bateleur_messages::hil::{PILOT_STAND_BY, PILOT_TAKE_OFF};
use bateleur_messages::telemetry::{
    ACCEPTED, Acknowledge, HealthText, NAVIGATION_ABORTED, NAVIGATION_AUTOPILOT, NAVIGATION_FINISHED,
    NAVIGATION_LANDED, NAVIGATION_LANDING, NAVIGATION_LINK_LOST, NAVIGATION_LOITER, NAVIGATION_ON,
    NAVIGATION_OUTSIDE, NAVIGATION_PROTECTION_SHIFT, NAVIGATION_RETURN, NAVIGATION_TAKE_OFF, NOT_UNDERSTOOD,
    Navigation, Primary, Refusal, StateTelemetry, Telemetry,
};
use std::fmt::Write;
use thiserror::Error;

/// What can be typed.
pub const HELP: &str = "\
hil on|off                        hardware-in-the-loop mode
sensors [accelerometer] [gyroscope] [pressure]
                                  take their biases anew, at standstill; all without a name
estimator init|enable|disable     `init aiding` without attitude from the inertial sensors
waypoint N NORTH EAST ALTITUDE AIRSPEED [HEADING]
                                  way-point N (from 0), m, m/s, degrees; type them in order
waypoint clear                    begin the list anew
navigation on|off                 fly the way-points
autopilot on|off                  the autopilot flies, or the safety pilot
loop NAME TARGET                  one loop with its target, in m, m/s, rad, rad/s, m/s2:
                                  roll_angle roll_rate pitch_rate airspeed altitude climb_rate heading
                                  axial lateral normal
loop NAME off
fly go_on|take_off|loiter|return|land|abort
                                  in place of mission and loops; take_off standing, then `autopilot on`
pilot take-off|stand-by           call the simulated safety pilot
parameters [BEGINNING]            what can be read and set of the functions, such as CTL or CTL_BANK
set NAME VALUE                    set a parameter; what stands is answered
status                            the newest telemetry
help                              this page
quit                              leave; the aircraft flies on";

/// What a typed line asks for.
#[derive(Debug, Clone, PartialEq)]
pub enum Request {
    /// Orders to send, in this sequence.
    Orders(Vec<Order>),
    /// An order to the safety pilot; see the constants of the simulator link.
    Pilot(u32),
    /// List the parameters whose names begin so.
    Parameters(String),
    /// Show the board.
    Status,
    /// Show [`HELP`].
    Help,
    /// Leave.
    Quit,
    /// An empty line.
    Nothing,
}

/// Why a line was not understood. The text says what would be.
#[derive(Debug, Clone, PartialEq, Eq, Error)]
pub enum ConsoleError {
    /// The first word is no command.
    #[error("\"{word}\" is no command{hint}; \"help\" lists them")]
    UnknownCommand {
        /// The word.
        word: String,
        /// ", did you mean …?", or nothing.
        hint: String,
    },
    /// A name of a loop that there is not.
    #[error("\"{word}\" is no loop{hint}; there are {}", loop_names())]
    UnknownLoop {
        /// The word.
        word: String,
        /// As above.
        hint: String,
    },
    /// The words after it do not fit.
    #[error("\"{command}\" wants {wanted}, as in: {example}")]
    Usage {
        /// The command.
        command: &'static str,
        /// What belongs after it.
        wanted: &'static str,
        /// A line that works.
        example: &'static str,
    },
    /// A word that should be a number.
    #[error("{what} \"{word}\" is not a number{hint}")]
    Number {
        /// What it stands for.
        what: &'static str,
        /// The word.
        word: String,
        /// How to write it.
        hint: &'static str,
    },
    /// A way-point out of order.
    #[error(
        "way-point {index} cannot follow {known} known ones; the next is {known} (type them in order, from 0)"
    )]
    WaypointOrder {
        /// The index typed.
        index: usize,
        /// Way-points so far.
        known: usize,
    },
    /// A way-point's speed.
    #[error("the airspeed must be {} to {} m/s", Waypoint::AIRSPEEDS_MPS.start(), Waypoint::AIRSPEEDS_MPS.end())]
    Airspeed,
    /// A name like no parameter's.
    #[error("\"{name}\" is no parameter's name; \"parameters\" lists them")]
    UnknownParameter {
        /// The word.
        name: String,
    },
    /// The list is full.
    #[error("a list holds {0} way-points at most")]
    WaypointCount(usize),
}

/// Understands typed lines; remembers the way-points, since each goes out with the length of the whole list.
#[derive(Debug, Clone, Default)]
pub struct Console {
    waypoints: Vec<Waypoint>,
}

impl Console {
    /// A console with no way-points.
    pub fn new() -> Self {
        Self::default()
    }

    /// Understands one line.
    ///
    /// # Errors
    /// When it makes no sense; the error says what would.
    pub fn line(&mut self, line: &str) -> Result<Request, ConsoleError> {
        let words: Vec<&str> = line.split_whitespace().collect();
        let Some((command, rest)) = words.split_first() else { return Ok(Request::Nothing) };
        match *command {
            "hil" => switch("hil", "hil on", rest).map(|on| one(Order::Hil { on })),
            "autopilot" => switch("autopilot", "autopilot on", rest).map(|on| one(Order::Autopilot { on })),
            "navigation" => {
                switch("navigation", "navigation on", rest).map(|on| one(Order::Navigation { on }))
            }
            "waypoint" => self.waypoint(rest).map(Request::Orders),
            "loop" => single_loop(rest).map(one),
            "fly" => manoeuvre(rest).map(one),
            "sensors" => sensors(rest).map(one),
            "estimator" => estimator(rest).map(one),
            "pilot" => pilot(rest).map(Request::Pilot),
            "parameters" => parameters(rest).map(Request::Parameters),
            "set" => set(rest).map(one),
            "status" => Ok(Request::Status),
            "help" | "?" => Ok(Request::Help),
            "quit" | "exit" => Ok(Request::Quit),
            other => Err(ConsoleError::UnknownCommand {
                word: other.to_owned(),
                hint: did_you_mean(other, &COMMANDS),
            }),
        }
    }

    /// A typed way-point changes the length of the list, so all of them go out again.
    fn waypoint(&mut self, words: &[&str]) -> Result<Vec<Order>, ConsoleError> {
        let usage = ConsoleError::Usage {
            command: "waypoint",
            wanted: "index, north, east, altitude (m), airspeed (m/s) and perhaps heading (degrees)",
            example: "waypoint 0 500 0 160 22",
        };
        if words == ["clear"] {
            self.waypoints.clear();
            return Ok(Vec::new());
        }
        let [index, north, east, altitude, airspeed, heading @ ..] = words else { return Err(usage) };
        let heading = match heading {
            [] => 0.0,
            [heading] => number("heading", heading)?,
            _ => return Err(usage),
        };
        let point = Waypoint {
            index: 0,
            count: 0,
            north_m: number("north", north)?,
            east_m: number("east", east)?,
            altitude_m: number("altitude", altitude)?,
            heading_rad: heading.to_radians(),
            airspeed_mps: number("airspeed", airspeed)?,
            step: Step::Pass,
        };
        self.insert(whole_number("index", index)?, point)?;
        Ok(self.waypoints.iter().copied().map(Order::Waypoint).collect())
    }

    fn insert(&mut self, index: usize, point: Waypoint) -> Result<(), ConsoleError> {
        let known = self.waypoints.len();
        if index > known {
            return Err(ConsoleError::WaypointOrder { index, known });
        }
        if index >= crate::plan::MOST_WAYPOINTS {
            return Err(ConsoleError::WaypointCount(crate::plan::MOST_WAYPOINTS));
        }
        if !Waypoint::AIRSPEEDS_MPS.contains(&point.airspeed_mps) {
            return Err(ConsoleError::Airspeed);
        }
        if index == known {
            self.waypoints.push(point);
        } else {
            self.waypoints[index] = point;
        }
        let count = self.waypoints.len() as u8; // at most MOST_WAYPOINTS
        for (index, point) in self.waypoints.iter_mut().enumerate() {
            (point.index, point.count) = (index as u8, count);
        }
        Ok(())
    }
}

/// The first words that a line may have, for [`did_you_mean`].
const COMMANDS: [&str; 14] = [
    "hil",
    "sensors",
    "estimator",
    "waypoint",
    "navigation",
    "autopilot",
    "loop",
    "fly",
    "pilot",
    "parameters",
    "set",
    "status",
    "help",
    "quit",
];
/// Words less alike than this (Jaro and Winkler, 0 to 1) have nothing to do with each other.
const ALIKE: f64 = 0.75;

fn did_you_mean(word: &str, known: &[&str]) -> String {
    let near = known.iter().map(|name| (strsim::jaro_winkler(name, word), name));
    match near.max_by(|a, b| a.0.total_cmp(&b.0)) {
        Some((likeness, name)) if likeness > ALIKE => format!(", did you mean \"{name}\"?"),
        _ => String::new(),
    }
}

fn loop_names() -> String {
    LoopId::ALL.map(LoopId::name).join(", ")
}

fn one(order: Order) -> Request {
    Request::Orders(vec![order])
}

fn switch(command: &'static str, example: &'static str, words: &[&str]) -> Result<bool, ConsoleError> {
    match words {
        ["on"] => Ok(true),
        ["off"] => Ok(false),
        _ => Err(ConsoleError::Usage { command, wanted: "on or off", example }),
    }
}

fn single_loop(words: &[&str]) -> Result<Order, ConsoleError> {
    let usage = ConsoleError::Usage {
        command: "loop",
        wanted: "one of roll_angle, roll_rate, pitch_rate, airspeed, altitude, climb_rate, heading, axial, lateral, \
                 normal, and a target or off",
        example: "loop roll_angle 0.3",
    };
    let [name, target] = words else { return Err(usage) };
    let Some(id) = LoopId::ALL.into_iter().find(|id| id.name() == *name) else {
        let hint = did_you_mean(name, &LoopId::ALL.map(LoopId::name));
        return Err(ConsoleError::UnknownLoop { word: (*name).to_owned(), hint });
    };
    match *target {
        "off" => Ok(Order::Loop { id, on: false, target: 0.0 }),
        target => Ok(Order::Loop { id, on: true, target: number("target", target)? }),
    }
}

fn manoeuvre(words: &[&str]) -> Result<Order, ConsoleError> {
    let usage = ConsoleError::Usage {
        command: "fly",
        wanted: "go_on, take_off, loiter, return, land or abort",
        example: "fly loiter",
    };
    let [name] = words else { return Err(usage) };
    let what = Manoeuvre::ALL.into_iter().find(|what| what.name() == *name).ok_or(usage)?;
    Ok(Order::Manoeuvre { what, reason: Reason::Ordered })
}

fn sensors(words: &[&str]) -> Result<Order, ConsoleError> {
    let bit = |word: &&str| match *word {
        "accelerometer" => Some(SENSOR_ACCELEROMETER),
        "gyroscope" => Some(SENSOR_GYROSCOPE),
        "pressure" => Some(SENSOR_PRESSURE),
        _ => None,
    };
    let all = SENSOR_ACCELEROMETER | SENSOR_GYROSCOPE | SENSOR_PRESSURE;
    let chosen = words.iter().map(bit).try_fold(0, |sum, bit| bit.map(|bit| sum | bit));
    match chosen {
        Some(0) => Ok(Order::InitialiseSensors { sensors: all }),
        Some(sensors) => Ok(Order::InitialiseSensors { sensors }),
        None => Err(ConsoleError::Usage {
            command: "sensors",
            wanted: "any of accelerometer, gyroscope, pressure",
            example: "sensors gyroscope pressure",
        }),
    }
}

fn estimator(words: &[&str]) -> Result<Order, ConsoleError> {
    let order = match words {
        ["init"] => EstimatorOrder::Initialise { full_inertial: true },
        ["init", "aiding"] => EstimatorOrder::Initialise { full_inertial: false },
        ["enable"] => EstimatorOrder::Enable,
        ["disable"] => EstimatorOrder::Disable,
        _ => {
            return Err(ConsoleError::Usage {
                command: "estimator",
                wanted: "init, enable or disable",
                example: "estimator init",
            });
        }
    };
    Ok(Order::Estimator(order))
}

fn parameters(words: &[&str]) -> Result<String, ConsoleError> {
    match words {
        [] => Ok(String::new()),
        [beginning] => Ok((*beginning).to_owned()),
        _ => Err(ConsoleError::Usage {
            command: "parameters",
            wanted: "nothing, or the beginning of the names",
            example: "parameters CTL_BANK",
        }),
    }
}

fn set(words: &[&str]) -> Result<Order, ConsoleError> {
    let [name, value] = words else {
        return Err(ConsoleError::Usage {
            command: "set",
            wanted: "a parameter's name and a value",
            example: "set CTL_LAPS 3",
        });
    };
    let unknown = || ConsoleError::UnknownParameter { name: (*name).to_owned() };
    crate::parameters::setting(name, number("value", value)?).ok_or_else(unknown)
}

fn pilot(words: &[&str]) -> Result<u32, ConsoleError> {
    match words {
        ["take-off"] => Ok(PILOT_TAKE_OFF),
        ["stand-by"] => Ok(PILOT_STAND_BY),
        _ => Err(ConsoleError::Usage {
            command: "pilot",
            wanted: "take-off or stand-by",
            example: "pilot take-off",
        }),
    }
}

fn number(what: &'static str, word: &str) -> Result<f64, ConsoleError> {
    let hint = if word.contains(',') { "; write a point for the decimals" } else { "" };
    match word.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(ConsoleError::Number { what, word: word.to_owned(), hint }),
    }
}

fn whole_number(what: &'static str, word: &str) -> Result<usize, ConsoleError> {
    word.parse().map_err(|_| ConsoleError::Number { what, word: word.to_owned(), hint: "; it counts from 0" })
}

/// One message as a line of text.
pub fn describe(telemetry: &Telemetry) -> String {
    match telemetry {
        Telemetry::Primary(message) => describe_primary(message),
        Telemetry::Voltages(v) => format!(
            "supply      main {:.2} V, backup {:.2} V, actuators {:.2} V",
            v.main_v, v.backup_v, v.actuator_board_v
        ),
        Telemetry::Gps(gps) => format!(
            "gps         {:.6}°, {:.6}°, {:.1} m, {} fixes",
            gps.latitude_rad.to_degrees(),
            gps.longitude_rad.to_degrees(),
            gps.altitude_m,
            gps.count
        ),
        Telemetry::Imu(imu) => format!(
            "imu         airspeed {:.1} m/s, pressure altitude {:.1} m, force {} m/s², rates {} °/s",
            imu.airspeed_mps,
            imu.pressure_altitude_m,
            triple(imu.specific_force_mps2),
            triple(imu.rates_radps.map(f64::to_degrees))
        ),
        Telemetry::State(state) => describe_state(state),
        Telemetry::Navigation(message) => describe_navigation(message),
        Telemetry::Loops(loops) => {
            let [throttle, surfaces @ ..] = loops.command;
            let surfaces = triple(surfaces.map(f64::to_degrees));
            format!(
                "controller  throttle {throttle:.2}, surfaces {surfaces}°, loops {}",
                engaged(loops.engaged)
            )
        }
        Telemetry::Servo(servo) => format!(
            "servo       {:?} µs, {} flies",
            servo.timers_us,
            if servo.autopilot != 0 { "autopilot" } else { "pilot" }
        ),
        Telemetry::Simulator(link) => describe_simulator(link),
        Telemetry::Acknowledge(message) => describe_answer(message),
        Telemetry::Health(message) => describe_health(message),
        Telemetry::Parameter(message) => {
            format!("parameter   {}", crate::parameters::describe_parameter(message))
        }
    }
}

/// The whole board, a line a message, with its age.
pub fn status(board: &Board, now_ns: u64) -> String {
    let mut text = String::new();
    let mut row = |item: Option<(Telemetry, u64)>| {
        if let Some((telemetry, received_ns)) = item {
            let age_s = now_ns.saturating_sub(received_ns) as f64 * 1e-9;
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{age_s:>6.1} s  {}", describe(&telemetry));
        }
    };
    row(board.primary.map(|latest| (Telemetry::Primary(latest.message), latest.received_ns)));
    row(board.state.map(|latest| (Telemetry::State(latest.message), latest.received_ns)));
    row(board.navigation.map(|latest| (Telemetry::Navigation(latest.message), latest.received_ns)));
    row(board.loops.map(|latest| (Telemetry::Loops(latest.message), latest.received_ns)));
    row(board.servo.map(|latest| (Telemetry::Servo(latest.message), latest.received_ns)));
    row(board.imu.map(|latest| (Telemetry::Imu(latest.message), latest.received_ns)));
    row(board.gps.map(|latest| (Telemetry::Gps(latest.message), latest.received_ns)));
    row(board.voltages.map(|latest| (Telemetry::Voltages(latest.message), latest.received_ns)));
    row(board.simulator.map(|latest| (Telemetry::Simulator(latest.message), latest.received_ns)));
    row(board.acknowledge.map(|latest| (Telemetry::Acknowledge(latest.message), latest.received_ns)));
    if text.is_empty() { "nothing heard yet\n".to_owned() } else { text }
}

fn describe_primary(p: &Primary) -> String {
    let switch = |value: u8| if value != 0 { "on" } else { "off" };
    format!(
        "functions   autopilot {} (controller {}), estimator {}{}, hil {}{}",
        switch(p.autopilot),
        switch(p.controller),
        switch(p.estimator_enabled),
        if p.estimator_ready != 0 { ", ready" } else { "" },
        switch(p.hil),
        if p.hil_ready != 0 { ", simulator answers" } else { "" },
    )
}

fn describe_state(s: &StateTelemetry) -> String {
    let word = match s.status {
        0 => "disabled",
        1 => "initialising",
        2 => "coarse",
        3 => "running",
        _ => "unknown",
    };
    let [north, east, down] = s.position_ned_m;
    format!(
        "estimator   {word}: north {north:.1} m, east {east:.1} m, height {:.1} m, velocity {} m/s, attitude {}°",
        -down,
        triple(s.velocity_ned_mps),
        triple(s.euler_rad.map(f64::to_degrees))
    )
}

fn describe_navigation(n: &Navigation) -> String {
    let flag = |bit: u32, word: &'static str| if n.flags & bit != 0 { word } else { "" };
    format!(
        "navigation  to way-point {} of {}, {} reached, {:.1} m right of track, wants {:.0} m and {:.1} m/s{}",
        n.next_waypoint,
        n.waypoint_count,
        n.waypoints_reached,
        n.cross_track_m,
        n.altitude_reference_m,
        n.airspeed_reference_mps,
        [
            flag(NAVIGATION_AUTOPILOT, ", autopilot"),
            flag(NAVIGATION_ON, ", navigating"),
            flag(NAVIGATION_FINISHED, ", finished"),
            flag(NAVIGATION_TAKE_OFF, ", taking off"),
            flag(NAVIGATION_ABORTED, ", take-off given up"),
            flag(NAVIGATION_LOITER, ", circling"),
            flag(NAVIGATION_RETURN, ", flying back"),
            flag(NAVIGATION_LANDING, ", landing"),
            flag(NAVIGATION_LANDED, ", landed"),
            flag(NAVIGATION_LINK_LOST, ", because the ground is silent"),
            flag(NAVIGATION_OUTSIDE, ", OUTSIDE of the fence"),
            flag(u32::MAX << NAVIGATION_PROTECTION_SHIFT, ", limits reached"),
        ]
        .concat(),
    )
}

fn describe_simulator(l: &SimulatorLink) -> String {
    let protocol = Protocol::ALL.into_iter().find(|protocol| *protocol as u32 == l.protocol);
    format!(
        "simulator   {}, {}: {} windows with sensors, {} without, {} asked again, {} stale, {} lost, {} refused, {} \
         invalid, {} of strangers, {} socket errors",
        protocol.map_or("unknown protocol", Protocol::name),
        if l.lockstep == 1 { "lockstep" } else { "free-running" },
        l.accepted,
        l.missing,
        l.repeated,
        l.stale,
        l.lost,
        l.refused,
        l.invalid,
        l.strangers,
        l.errors,
    )
}

fn describe_health(message: &HealthText) -> String {
    let word = ["alert", "alert", "critical", "error", "warning"];
    let word = word.get(usize::from(message.severity)).unwrap_or(&"notice");
    match message.times {
        0 | 1 => format!("health      {word}: {}", message.text()),
        times => format!("health      {word}: {} ({times} times)", message.text()),
    }
}

fn describe_answer(a: &Acknowledge) -> String {
    let result = match a.result {
        ACCEPTED => "takes",
        NOT_UNDERSTOOD => "does not understand",
        _ => "refuses",
    };
    let why = Refusal::of(a).map_or_else(String::new, |refusal| format!(": {}", refusal.text()));
    format!("answer      {} {result} {}{why}", function_name(a.from), order_name(a))
}

/// What was ordered, in the words of [`HELP`] as far as an answer tells them.
fn order_name(a: &Acknowledge) -> String {
    let on = if a.first != 0 { "on" } else { "off" };
    match a.letter {
        b'H' => format!("hil {on}"),
        b'A' => format!("autopilot {on}"),
        b'N' => format!("navigation {on}"),
        b'W' => format!("waypoint {}", a.first),
        b'L' => {
            let id = LoopId::ALL.into_iter().find(|id| *id as u8 == a.first);
            format!("loop {}", id.map_or("?", LoopId::name))
        }
        b'I' => "sensors".into(),
        b'E' => {
            format!("estimator {}", ["disable", "enable", "init"].get(usize::from(a.first)).unwrap_or(&"?"))
        }
        b'R' => "reading a parameter".into(),
        b'Y' => "setting a parameter".into(),
        letter => format!("{} {}", letter as char, a.first),
    }
}

fn engaged(bits: u64) -> String {
    let names: Vec<_> =
        LoopId::ALL.iter().filter(|id| bits & (1 << **id as u8) != 0).map(|id| id.name()).collect();
    if names.is_empty() { "none".to_owned() } else { names.join(" ") }
}

fn triple(v: [f64; 3]) -> String {
    format!("({:.1}, {:.1}, {:.1})", v[0], v[1], v[2])
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn order(line: &str) -> Order {
        match Console::new().line(line) {
            Ok(Request::Orders(orders)) if orders.len() == 1 => orders[0],
            other => panic!("{line}: {other:?}"),
        }
    }

    #[test]
    fn lines_become_orders() {
        assert_eq!(order("hil on"), Order::Hil { on: true });
        assert_eq!(order("  autopilot   off "), Order::Autopilot { on: false });
        assert_eq!(
            order("loop roll_angle 0.3"),
            Order::Loop { id: LoopId::RollAngle, on: true, target: 0.3 }
        );
        assert_eq!(
            order("loop roll_angle off"),
            Order::Loop { id: LoopId::RollAngle, on: false, target: 0.0 }
        );
        assert_eq!(order("sensors gyroscope pressure"), Order::InitialiseSensors { sensors: 6 });
        assert_eq!(order("sensors"), Order::InitialiseSensors { sensors: 7 });
        assert_eq!(order("estimator enable"), Order::Estimator(EstimatorOrder::Enable));
        assert_eq!(Console::new().line("pilot take-off"), Ok(Request::Pilot(PILOT_TAKE_OFF)));
        assert_eq!(Console::new().line(""), Ok(Request::Nothing));
    }

    #[test]
    fn every_order_names_the_length_of_the_list() {
        let mut console = Console::new();
        console.line("waypoint 0 500 0 160 22").unwrap();
        let Ok(Request::Orders(orders)) = console.line("waypoint 1 500 500 160 22 90") else { panic!() };
        let places: Vec<_> = orders
            .iter()
            .map(|order| match order {
                Order::Waypoint(point) => (point.index, point.count, point.east_m),
                other => panic!("{other:?}"),
            })
            .collect();
        assert_eq!(places, [(0, 2, 0.0), (1, 2, 500.0)]);
        for sent in orders {
            assert_eq!(Order::parse(sent.letter(), &sent.data()), Ok(sent));
        }
    }

    #[test]
    fn mistakes_say_what_would_work() {
        let cases = [
            ("hill on", "\"hill\" is no command, did you mean \"hil\"?; \"help\" lists them"),
            ("xyz", "\"xyz\" is no command; \"help\" lists them"),
            ("autopilto on", "did you mean \"autopilot\"?"),
            ("loop roll_angel 1", "\"roll_angel\" is no loop, did you mean \"roll_angle\"?"),
            ("hil", "as in: hil on"),
            ("waypoint 1 2 3 4 5", "the next is 0"),
            ("waypoint 0 1,5 0 160 22", "write a point"),
            ("waypoint 0 1 0 160 0", "the airspeed must be 5 to 100 m/s"),
            ("waypoint 0 1 0 nan 22", "altitude \"nan\" is not a number"),
            ("loop roll 1", "roll_angle"),
            ("loop roll_angle", "as in: loop roll_angle 0.3"),
            ("set CTL_LAPS", "as in: set CTL_LAPS 3"),
            ("set LAPS 3", "\"LAPS\" is no parameter's name"),
        ];
        for (line, expected) in cases {
            let message = Console::new().line(line).unwrap_err().to_string();
            assert!(message.contains(expected), "{line}: {message}");
        }
    }

    #[test]
    fn refusal_is_shown_with_its_reason() {
        let refused = |letter, first, refusal| {
            let message = bateleur_messages::GroundMessage { letter, length: 1, ..Default::default() };
            let answer =
                Acknowledge::refused(&message, bateleur_messages::telemetry::FROM_CONTROLLER, refusal, 0);
            describe(&Telemetry::Acknowledge(Acknowledge { first, ..answer }))
        };
        assert_eq!(
            refused(b'A', 1, Refusal::NoState),
            "answer      Controller refuses autopilot on: there is no usable state from the Estimator: initialise it, \
             and wait until it runs"
        );
        assert_eq!(
            refused(b'N', 1, Refusal::NoWaypoints),
            "answer      Controller refuses navigation on: it has no way-points: load them first"
        );
    }

    #[test]
    fn help_names_every_command_and_loop() {
        for word in COMMANDS {
            assert!(HELP.contains(word), "{word}");
        }
        assert!(LoopId::ALL.iter().all(|id| HELP.contains(id.name())));
    }

    #[test]
    fn board_is_shown_with_ages() {
        let mut board = Board::default();
        assert_eq!(status(&board, 0), "nothing heard yet\n");
        let state = StateTelemetry { status: 3, position_ned_m: [1.0, 2.0, -160.0], ..Default::default() };
        board.take(&Telemetry::State(state), 500_000_000);
        let text = status(&board, 2_000_000_000);
        assert!(
            text.starts_with("   1.5 s  estimator   running: north 1.0 m, east 2.0 m, height 160.0 m"),
            "{text}"
        );
    }

    proptest! {
        #[test]
        fn no_line_is_too_strange(line in ".*", number in "waypoint [0-9]{1,3} .*") {
            let mut console = Console::new();
            let _ = console.line(&line);
            let _ = console.line(&number);
        }
    }
}
