//! Feeds a recorded flight to the main cycle and holds its actuator words against the recorded ones.
//!
//! The log is read once, from front to back. It is ordered by port and not by time within a read of the recorder, so the
//! cycle runs behind the newest message by [`BEHIND_NS`]; memory is that of a second of flight. One message with a time far
//! ahead of all others is damage of that message: it is left out and counted. After a gap in the log all messages are ahead.

use std::collections::{BTreeMap, VecDeque};
use std::path::Path;

use bateleur_apex::StartError;
use bateleur_flight::guidance::GuidanceError;
use bateleur_messages::{
    Acceleration, ActuatorCommand, GpsPosition, GpsVelocity, Magnetization, Message, Pressure, Rates,
    ServoTimers, State, find,
};
use bateleur_recording::{ChannelId, Entry, LogError, PortLog, for_each};
use serde::Serialize;
use zerocopy::{FromBytes, IntoBytes};

use crate::cycle::{MainCycle, Outputs, Outside, pop_before};
use crate::settings::Settings;

/// How far the cycle runs behind the newest message, ns: the recorder looks at every port much more often.
const BEHIND_NS: u64 = 1_000_000_000;
/// A message so far ahead of the newest one is held back until a second one stands as near to it, ns.
const FAR_NS: u64 = 2 * BEHIND_NS;
/// Cycles that a gap in the log may span; time stamps beyond are damage: a day at 50 Hz.
const MOST_CYCLES: u64 = 24 * 3600 * 50;
/// The names of the words of one cycle.
const WORDS: [&str; 6] =
    ["aileron_left_us", "aileron_right_us", "elevator_us", "rudder_us", "throttle_us", "autopilot"];

/// Where the log has what goes in, and what the flight's own functions gave. Topics, "/partition/port".
#[derive(Debug, Clone, Default)]
pub struct Topics {
    /// Raw fixes, sensors, sticks.
    pub sensors: [String; 3],
    /// Distances to the ground, if the Controller reads them.
    pub range: Option<String>,
    /// Orders to IMU, Estimator, Controller and Servo.
    pub orders: [String; 4],
    /// What came of it, in the order of [`OUTPUTS`].
    pub outputs: [String; OUTPUTS.len()],
}

impl Topics {
    /// Whether what is on `topic` is used.
    fn has(&self, topic: &str) -> bool {
        self.sensors
            .iter()
            .chain(&self.range)
            .chain(&self.orders)
            .chain(&self.outputs[TIMERS..])
            .any(|one| one == topic)
    }
}

/// The ports that the main cycle gives, by function and port.
pub const OUTPUTS: [(&str, &str); 9] = [
    ("gps", "position"),
    ("gps", "velocity"),
    ("imu", "acceleration"),
    ("imu", "orientation"),
    ("imu", "magnetization"),
    ("imu", "pressure"),
    ("estimator", "state"),
    ("controller", "command"),
    ("servo", "timers"),
];
/// The last of [`OUTPUTS`]: the actuator words.
const TIMERS: usize = OUTPUTS.len() - 1;

/// Why nothing could be replayed.
#[derive(Debug, thiserror::Error)]
pub enum ReplayError {
    /// A log.
    #[error(transparent)]
    Log(#[from] LogError),
    /// A function would not start so.
    #[error(transparent)]
    Start(#[from] StartError),
    /// The plan's way-points.
    #[error("attribute waypoints: {0}")]
    Waypoints(#[from] GuidanceError),
    /// The log lacks what the functions live on.
    #[error(
        "the log has no {0}: it is no recording of a flight, or of one with another schedule (--schedule)"
    )]
    Missing(String),
    /// A time stamp that can not be.
    #[error("the log says module time {0} s: it is damaged")]
    Damaged(u64),
}

/// The actuator words.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct Words {
    /// In both, and compared.
    pub compared: u64,
    /// Those that are not the same.
    pub different: u64,
    /// The greatest difference, by word.
    pub greatest: BTreeMap<&'static str, u16>,
    /// The first cycle with one that is not the same: module time of the Servo's turn, ns.
    pub first_ns: Option<u64>,
    /// The last such cycle.
    pub last_ns: Option<u64>,
    /// Cycles in which the flight's Servo gave nothing.
    pub absent_cycles: u64,
}

/// What came of it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Replayed {
    /// Passes of the main cycle.
    pub cycles: u64,
    /// The actuator words.
    pub words: Words,
    /// What is wrong with the log: it was cut short, or is damaged, or has messages with times that can not be.
    pub flaw: Option<String>,
    /// Messages that stood in the log so late that the cycle was over which they belong to.
    pub too_late: u64,
}

/// Replays the log at `path`, and writes what the main cycle gave to `output`, under the same topics.
///
/// # Errors
/// When a log can not be read or written, or the settings are such that a function would not start.
pub fn replay(
    path: &Path,
    settings: Settings,
    topics: &Topics,
    output: &Path,
) -> Result<Replayed, ReplayError> {
    let mut replay = Replay {
        period_ns: settings.instants.period_ns.max(1),
        servo_ns: settings.instants.servo_ns,
        instants: [
            settings.instants.gps_ns,
            settings.instants.imu_ns,
            settings.instants.estimator_ns,
            settings.instants.controller_ns,
            settings.instants.servo_ns,
        ],
        cycle: MainCycle::new(settings)?,
        topics,
        outside: Outside::default(),
        recorded: VecDeque::new(),
        newest_ns: 0,
        ahead: None,
        astray: 0,
        sensors: 0,
        log: OwnLog::create(output, topics)?,
        result: Replayed { cycles: 0, words: Words::default(), flaw: None, too_late: 0 },
        failure: None,
    };
    let flaw = for_each(path, |entry| replay.take(&entry))?.flaw();
    replay.astray += u64::from(replay.ahead.is_some());
    let astray = (replay.astray > 0).then(|| {
        let far_s = FAR_NS / 1_000_000_000;
        format!(
            "has messages with a time more than {far_s} s ahead of all others: {} left out",
            replay.astray
        )
    });
    let flaws: Vec<String> = flaw.into_iter().chain(astray).collect();
    replay.result.flaw = (!flaws.is_empty()).then(|| flaws.join(", and "));
    replay.finish()
}

struct Replay<'a> {
    period_ns: u64,
    servo_ns: u64,
    instants: [u64; 5],
    cycle: MainCycle,
    topics: &'a Topics,
    outside: Outside,
    /// The flight's own actuator words that no pass has reached yet.
    recorded: VecDeque<(u64, ServoTimers)>,
    newest_ns: u64,
    /// A message far ahead of the newest, until a second one bears its time out.
    ahead: Option<Ahead>,
    /// Messages that none bore out.
    astray: u64,
    sensors: u64,
    log: OwnLog,
    result: Replayed,
    failure: Option<ReplayError>,
}

/// A message that waits.
struct Ahead {
    topic: String,
    time_ns: u64,
    bytes: Vec<u8>,
}

impl Replay<'_> {
    fn take(&mut self, entry: &Entry<'_>) {
        if self.failure.is_some() || !self.topics.has(entry.topic) {
            return;
        }
        if entry.time_ns > self.newest_ns.saturating_add(FAR_NS) {
            match self.ahead.take_if(|ahead| ahead.time_ns.abs_diff(entry.time_ns) <= FAR_NS) {
                Some(ahead) => {
                    let (topic, message) = (ahead.topic.as_str(), entry.message);
                    let (sequence, time_ns, bytes) = (0, ahead.time_ns, ahead.bytes.as_slice());
                    self.accept(&Entry { topic, message, sequence, time_ns, bytes, layout: None });
                }
                None => {
                    let (topic, bytes) = (entry.topic.to_owned(), entry.bytes.to_vec());
                    let older = self.ahead.replace(Ahead { topic, time_ns: entry.time_ns, bytes });
                    self.astray += u64::from(older.is_some());
                    return;
                }
            }
        }
        self.accept(entry);
    }

    fn accept(&mut self, entry: &Entry<'_>) {
        if entry.time_ns / self.period_ns > self.result.cycles + MOST_CYCLES {
            self.failure = Some(ReplayError::Damaged(entry.time_ns / 1_000_000_000));
            return;
        }
        if self.sort(entry) {
            self.newest_ns = self.newest_ns.max(entry.time_ns);
            let now_ns = self.newest_ns.saturating_sub(BEHIND_NS);
            while self.failure.is_none() && self.start_ns() + self.period_ns <= now_ns {
                self.pass();
            }
        }
    }

    /// Puts a message where it belongs; false: it is of no use.
    fn sort(&mut self, entry: &Entry<'_>) -> bool {
        let [raw_gps, raw_analog, custom] = &self.topics.sensors;
        let [imu, estimator, controller, servo] = &self.topics.orders;
        let is = |topic: &String| topic == entry.topic;
        let outside = &mut self.outside;
        // A value that its function would have read in a pass that is over.
        let over_ns = (self.result.cycles * self.period_ns).saturating_sub(self.period_ns);
        let taken = match entry.topic {
            _ if is(raw_gps) => put(&mut outside.raw_gps, entry),
            _ if is(raw_analog) => {
                self.sensors += 1;
                put(&mut outside.raw_analog, entry)
            }
            _ if is(custom) => put(&mut outside.custom, entry),
            _ if self.topics.range.as_ref().is_some_and(is) => put(&mut outside.range, entry),
            _ if is(imu) => put(&mut outside.imu_orders, entry),
            _ if is(estimator) => put(&mut outside.estimator_orders, entry),
            _ if is(controller) => put(&mut outside.controller_orders, entry),
            _ if is(servo) => put(&mut outside.servo_orders, entry),
            _ if is(&self.topics.outputs[TIMERS]) => put(&mut self.recorded, entry),
            _ => false,
        };
        if taken && self.result.cycles > 0 && entry.time_ns < over_ns {
            self.result.too_late += 1;
        }
        taken
    }

    fn start_ns(&self) -> u64 {
        self.result.cycles * self.period_ns
    }

    fn pass(&mut self) {
        let start_ns = self.start_ns();
        let outputs = self.cycle.pass(start_ns, &mut self.outside);
        let times = self.instants.map(|instant_ns| start_ns + instant_ns);
        if let Err(error) = self.log.write(&times, &outputs) {
            self.failure = Some(error.into());
        }
        self.result.cycles += 1;
        let end_ns = start_ns + self.period_ns;
        let mut theirs = None;
        while let Some((_, timers)) = pop_before(&mut self.recorded, end_ns) {
            theirs = Some(timers);
        }
        match theirs {
            Some(theirs) => self.result.words.compare(start_ns + self.servo_ns, &theirs, &outputs.timers),
            None => self.result.words.absent_cycles += 1,
        }
    }

    fn finish(mut self) -> Result<Replayed, ReplayError> {
        // To the last word that the flight gave.
        while let Some((last_ns, _)) = self.recorded.back()
            && self.failure.is_none()
            && self.start_ns() <= *last_ns
        {
            self.pass();
        }
        self.log.finish()?;
        if let Some(failure) = self.failure {
            return Err(failure);
        }
        if self.sensors == 0 || self.result.words.compared == 0 {
            let topic =
                if self.sensors == 0 { &self.topics.sensors[1] } else { &self.topics.outputs[TIMERS] };
            return Err(ReplayError::Missing(topic.trim_start_matches('/').replace('/', ".")));
        }
        Ok(self.result)
    }
}

/// A message of another size than `T` is of no use.
fn put<T: FromBytes>(queue: &mut VecDeque<(u64, T)>, entry: &Entry<'_>) -> bool {
    let value = T::read_from_bytes(entry.bytes).ok().map(|value| (entry.time_ns, value));
    let taken = value.is_some();
    queue.extend(value);
    taken
}

impl Words {
    fn compare(&mut self, time_ns: u64, theirs: &ServoTimers, ours: &ServoTimers) {
        let list = |timers: &ServoTimers| {
            let ServoTimers { aileron_left_us, aileron_right_us, elevator_us, .. } = *timers;
            let ServoTimers { rudder_us, throttle_us, autopilot, .. } = *timers;
            [aileron_left_us, aileron_right_us, elevator_us, rudder_us, throttle_us, autopilot]
        };
        for ((name, theirs), ours) in WORDS.into_iter().zip(list(theirs)).zip(list(ours)) {
            self.compared += 1;
            if theirs == ours {
                continue;
            }
            self.different += 1;
            self.first_ns.get_or_insert(time_ns);
            self.last_ns = Some(time_ns);
            let greatest = self.greatest.entry(name).or_default();
            *greatest = (*greatest).max(theirs.abs_diff(ours));
        }
    }
}

/// The main cycle's own log.
struct OwnLog {
    log: PortLog,
    /// In the order of [`OUTPUTS`], each with the messages so far.
    channels: [(ChannelId, u64); OUTPUTS.len()],
}

impl OwnLog {
    fn create(path: &Path, topics: &Topics) -> Result<Self, LogError> {
        let mut log = PortLog::create(path)?;
        let names = [
            GpsPosition::NAME,
            GpsVelocity::NAME,
            Acceleration::NAME,
            Rates::NAME,
            Magnetization::NAME,
            Pressure::NAME,
            State::NAME,
            ActuatorCommand::NAME,
            ServoTimers::NAME,
        ];
        let mut channels = Vec::new();
        for (topic, name) in topics.outputs.iter().zip(names) {
            // Every message type of this crate is in the catalogue.
            if let Some(message) = find(name) {
                channels.push((log.add_channel(topic, message)?, 0));
            }
        }
        let channels = channels.try_into().map_err(|_| LogError::UnknownChannel(OUTPUTS.len()))?;
        Ok(Self { log, channels })
    }

    fn write(&mut self, times: &[u64; 5], outputs: &Outputs) -> Result<(), LogError> {
        let [gps_ns, imu_ns, estimator_ns, controller_ns, servo_ns] = *times;
        let Outputs { fix, measurements, state, command, timers } = outputs;
        if let Some((position, velocity)) = fix {
            self.put(0, gps_ns, position.as_bytes())?;
            self.put(1, gps_ns, velocity.as_bytes())?;
        }
        if let Some(acceleration) = &measurements.acceleration {
            self.put(2, imu_ns, acceleration.as_bytes())?;
        }
        if let Some(orientation) = &measurements.orientation {
            self.put(3, imu_ns, orientation.as_bytes())?;
        }
        if let Some(magnetization) = &measurements.magnetization {
            self.put(4, imu_ns, magnetization.as_bytes())?;
        }
        if let Some(pressure) = &measurements.pressure {
            self.put(5, imu_ns, pressure.as_bytes())?;
        }
        self.put(6, estimator_ns, state.as_bytes())?;
        self.put(7, controller_ns, command.as_bytes())?;
        self.put(TIMERS, servo_ns, timers.as_bytes())
    }

    fn put(&mut self, place: usize, time_ns: u64, bytes: &[u8]) -> Result<(), LogError> {
        let (channel, count) = &mut self.channels[place];
        *count += 1;
        self.log.write(*channel, *count, time_ns, bytes)
    }

    fn finish(self) -> Result<(), LogError> {
        self.log.finish()
    }
}
