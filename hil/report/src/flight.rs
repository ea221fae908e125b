//! A flight's folder, read: everything that is there, and a note for everything that is not.

use crate::chains::{ChainAge, ChainBound, Follower};
use crate::error::ReportError;
use crate::health::{self, HealthEntry};
use crate::presence::Presence;
use crate::reasons::{Crash, Reason};
use crate::run::{self, Run};
use crate::timing::Timing;
use crate::windows::{self, Window};
use bateleur_flight::guidance::{GuidanceConfig, Waypoint, seed_waypoints};
use bateleur_messages::{
    Acceleration, ActuatorCommand, GpsPosition, GpsVelocity, Magnetization, Message, Pressure, Rates, State,
};
use bateleur_recording::processes::{self, Span};
use bateleur_recording::{self as log, PORTS_FILE};
use bateleur_simulator::truth::{self, TruthRecord};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Name of the truth log in a flight's folder.
pub const TRUTH_FILE: &str = "truth.bin";
/// Notes about one kind of file; more would only repeat themselves.
const MOST_NOTES: usize = 20;
/// Spans of processes that are drawn, most.
const MOST_SPANS: usize = 20_000;

/// What the flight was to do: a score needs it beside the logs.
#[derive(Debug, Clone)]
pub struct Inputs {
    /// The way-points, in order.
    pub waypoints: Vec<Waypoint>,
    /// Laps asked for.
    pub laps: u32,
    /// The entries of a mission with circles and jumps in the order in which they are flown to; empty: a circuit, flown round for the laps.
    pub sequence: Vec<usize>,
    /// How corners were flown: fillets or not, and their radius.
    pub guidance: GuidanceConfig,
    /// Whether the barometer carried the estimated height (it does unless the Estimator's attribute says otherwise).
    pub pressure_aiding: bool,
    /// The chains whose ages are to be measured.
    pub chains: Vec<ChainBound>,
    /// Why windows were late.
    pub reasons: Vec<Reason>,
}

impl Default for Inputs {
    /// The seed's mission: four way-points, two laps, guidance as it is set by default.
    fn default() -> Self {
        Self {
            waypoints: seed_waypoints().to_vec(),
            laps: 2,
            sequence: Vec::new(),
            guidance: GuidanceConfig::default(),
            pressure_aiding: true,
            chains: Vec::new(),
            reasons: Vec::new(),
        }
    }
}

impl Inputs {
    /// The way-point that comes at this place of the flight; `None` behind the last.
    pub(crate) fn expected(&self, place: usize) -> Option<usize> {
        match &self.sequence[..] {
            [] => Some(place % self.waypoints.len().max(1)),
            sequence => sequence.get(place).copied(),
        }
    }
}

/// The conditions that the simulator was set to.
#[derive(Debug, Clone, PartialEq)]
pub struct Conditions {
    /// Name of the airframe.
    pub airframe: String,
    /// Mean wind asked for, m/s.
    pub wind_mps: f64,
    /// Where it was to come from, rad clockwise from north.
    pub wind_from_rad: f64,
    /// Level of turbulence asked for.
    pub turbulence: String,
    /// Faults of sensors, actuators and air that were asked for.
    pub faults: Vec<String>,
    /// How sensors and aircraft differed from the usual ones.
    pub variation: Vec<String>,
}

/// A flight in memory.
#[derive(Default)]
pub struct Flight {
    /// Name of the folder.
    pub name: String,
    /// What was to be flown.
    pub inputs: Inputs,
    /// The run as a whole.
    pub run: Option<Run>,
    /// The health log.
    pub health: Vec<HealthEntry>,
    /// Crash reports.
    pub crashes: Vec<Crash>,
    /// What the simulator was set to.
    pub conditions: Option<Conditions>,
    /// What was really the case.
    pub truth: Vec<TruthRecord>,
    /// What the Estimator said, with the source's module time, ns.
    pub states: Vec<(u64, State)>,
    /// What the Controller said.
    pub commands: Vec<(u64, ActuatorCommand)>,
    /// The receiver's fixes, each once.
    pub fixes: Vec<(u64, GpsPosition)>,
    /// The receiver's velocities, each once.
    pub velocities: Vec<(u64, GpsVelocity)>,
    /// What the gyroscope said.
    pub rates: Vec<(u64, Rates)>,
    /// What the accelerometer said.
    pub accelerations: Vec<(u64, Acceleration)>,
    /// What the magnetometer said.
    pub fields: Vec<(u64, Magnetization)>,
    /// What the pressure sensors said.
    pub pressures: Vec<(u64, Pressure)>,
    /// Messages on each topic.
    pub messages: BTreeMap<String, u64>,
    /// How well the windows kept their times.
    pub timing: Timing,
    /// How old values were at the end of each chain.
    pub chains: Vec<ChainAge>,
    /// The windows of one major frame from the middle of the flight.
    pub frame: Vec<Window>,
    /// Who ran in its windows, of partitions of several processes.
    pub processes: Vec<Span>,
    /// Which partitions were there, from the first window to the last.
    pub presence: Presence,
    /// What was missing or damaged.
    pub notes: Vec<String>,
}

impl Flight {
    /// Reads a flight's folder. Only a folder that is not there is an error.
    pub fn load(dir: &Path, inputs: &Inputs) -> Result<Self, ReportError> {
        if !dir.is_dir() {
            return Err(ReportError::NoFlight(dir.to_path_buf()));
        }
        let resolved = dir.canonicalize().unwrap_or_else(|_| dir.to_path_buf());
        let name = resolved.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned());
        let mut flight = Self { name, inputs: inputs.clone(), ..Self::default() };
        let ports = dir.join(PORTS_FILE);
        std::thread::scope(|scope| {
            // The two long files side by side: whoever flies a campaign waits for this after each flight.
            let recording = scope.spawn(|| read_ports(&ports));
            flight.load_run(&dir.join(run::FILE));
            flight.load_health(&dir.join(health::FILE));
            flight.crashes = Crash::read(dir);
            flight.load_truth(&dir.join(TRUTH_FILE));
            flight.load_windows(&dir.join(windows::FILE));
            flight.load_processes(&dir.join(processes::FILE));
            match recording.join() {
                Ok(recording) => flight.take_ports(&ports, recording),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        });
        flight.notes.truncate(MOST_NOTES);
        Ok(flight)
    }

    fn text(&mut self, path: &Path) -> Option<String> {
        match std::fs::read(path) {
            Ok(bytes) => Some(String::from_utf8_lossy(&bytes).into_owned()),
            Err(error) => {
                self.notes.push(format!("{} cannot be read: {error}", short(path)));
                None
            }
        }
    }

    fn load_run(&mut self, path: &Path) {
        let Some(text) = self.text(path) else { return };
        match serde_json::from_str(&text) {
            Ok(run) => self.run = Some(run),
            Err(error) => self.notes.push(format!("{} is not understood: {error}", short(path))),
        }
    }

    fn load_health(&mut self, path: &Path) {
        let Some(text) = self.text(path) else { return };
        let (entries, broken) = health::parse(&text);
        self.health = entries;
        self.note_broken_lines(path, broken);
    }

    fn load_truth(&mut self, path: &Path) {
        match truth::read_with_header(path) {
            Ok((header, records)) => {
                let (wind_mps, turbulence) = (header.wind_speed_mps, header.turbulence);
                let sensors = header.sensors.map(|choice| format!("sensors {choice}"));
                let variation = sensors.into_iter().chain(header.plant).collect();
                let (airframe, faults) = (header.airframe, header.faults);
                let wind_from_rad = header.wind_from_rad;
                self.conditions =
                    Some(Conditions { airframe, wind_mps, wind_from_rad, turbulence, faults, variation });
                self.truth = records;
            }
            // Somebody else's simulator leaves none.
            Err(_) if !path.exists() && self.run.as_ref().is_some_and(|run| run.foreign_simulator) => {}
            Err(error) => self.notes.push(format!("no score against the truth: {error}")),
        }
        if self.conditions.is_some() && self.truth.is_empty() {
            self.notes.push(format!("{} holds no record", short(path)));
        }
    }

    fn take_ports(&mut self, path: &Path, recording: Result<log::Recording, log::LogError>) {
        let recording = match recording {
            Ok(recording) => recording,
            Err(error) => {
                self.notes.push(format!("no messages: {error}"));
                return;
            }
        };
        if let Some(flaw) = recording.ending.flaw() {
            self.notes.push(format!("{} {flaw}; what it holds is used", short(path)));
        }
        self.states = typed(&recording, "/estimator/state");
        self.commands = typed(&recording, "/controller/command");
        self.fixes = typed(&recording, "/gps/position");
        self.fixes.dedup_by_key(|(_, fix)| fix.count);
        self.fixes.retain(|(_, fix)| fix.count > 0);
        self.velocities = typed(&recording, "/gps/velocity");
        self.velocities.dedup_by_key(|(_, fix)| fix.count);
        self.velocities.retain(|(_, fix)| fix.count > 0);
        self.rates = typed(&recording, "/imu/orientation");
        self.accelerations = typed(&recording, "/imu/acceleration");
        self.fields = typed(&recording, "/imu/magnetization");
        self.pressures = typed(&recording, "/imu/pressure");
        if self.commands.is_empty() {
            self.notes.push(format!("{} holds no command of the controller", short(path)));
        }
        self.messages = recording.counts;
    }

    fn load_windows(&mut self, path: &Path) {
        let mut timing = Timing::default();
        let mut chains: Vec<Follower> = self.inputs.chains.iter().map(Follower::new).collect();
        let clock = self.run.as_ref().map(|run| run.clock).unwrap_or_default();
        let add = |window: Window| {
            timing.add(&window);
            self.presence.add(&window);
            chains.iter_mut().for_each(|chain| chain.add(&window, clock));
        };
        match windows::for_each(path, add) {
            Ok(broken) => self.note_broken_lines(path, broken),
            Err(error) => self.notes.push(format!("{} cannot be read: {error}", short(path))),
        }
        self.chains = chains.iter().map(Follower::age).collect();
        let middle = timing.last_frame / 2;
        let mut frame = Vec::new();
        // Read a second time rather than kept the first: a long flight has millions. What cannot be read was noted above.
        let _ = windows::for_each_of_frame(path, middle, |window| frame.push(window));
        (self.timing, self.frame) = (timing, frame);
    }

    /// Those of the major frame that is drawn.
    fn load_processes(&mut self, path: &Path) {
        let starts = self.frame.iter().map(|window| window.planned_start_ns);
        let ends = self.frame.iter().map(|window| window.planned_end_ns);
        let Some((from_ns, to_ns)) = starts.min().zip(ends.max()) else { return };
        let mut spans = Vec::new();
        let read = processes::for_each(path, |span| {
            if span.to_ns > from_ns && span.from_ns < to_ns && spans.len() < MOST_SPANS {
                spans.push(span);
            }
        });
        match read {
            Ok(broken) => self.note_broken_lines(path, broken),
            Err(error) => self.notes.push(format!("{} cannot be read: {error}", short(path))),
        }
        self.processes = spans;
    }

    fn note_broken_lines(&mut self, path: &Path, broken: usize) {
        if broken > 0 {
            self.notes.push(format!("{}: {broken} lines are damaged and left out", short(path)));
        }
    }

    /// Module time of the last record of any kind, s.
    pub fn last_time_s(&self) -> f64 {
        let truth = self.truth.last().map(|record| record.time_ns);
        let command = self.commands.last().map(|(time, _)| *time);
        truth.max(command).map_or(0.0, seconds)
    }
}

/// Those messages of a log that figures and charts need.
fn read_ports(path: &Path) -> Result<log::Recording, log::LogError> {
    let wanted = [
        State::NAME,
        ActuatorCommand::NAME,
        GpsPosition::NAME,
        GpsVelocity::NAME,
        Rates::NAME,
        Acceleration::NAME,
        Magnetization::NAME,
        Pressure::NAME,
    ];
    log::read(path, |message| wanted.contains(&message))
}

fn typed<T: Message>(recording: &log::Recording, topic: &str) -> Vec<(u64, T)> {
    recording.track(topic, T::NAME).map(|track| track.typed()).unwrap_or_default()
}

fn short(path: &Path) -> String {
    path.file_name()
        .map_or_else(|| PathBuf::from(path).display().to_string(), |name| name.to_string_lossy().into())
}

/// Nanoseconds of module time in seconds.
pub(crate) fn seconds(ns: u64) -> f64 {
    ns as f64 / 1e9
}
