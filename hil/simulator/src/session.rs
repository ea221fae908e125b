//! The conversation: bytes in, bytes out, no socket and no clock. What MAVLink says stands in [`crate::dialect`].

use crate::counters::Counters;
use crate::dialect::{Asked, Dialect};
use crate::flight::{Flight, STEP_NS, STEPS_PER_CYCLE, Sample};
use crate::flightgear::FlightGear;
use crate::options::Options;
use crate::truth::{Header, TruthError, TruthWriter};
use bateleur_messages::frame::Decoder;
use bateleur_messages::hil::{Actuators, Packet, PilotOrder, Protocol};
use bateleur_plant::{AirframeError, Fault, PlannedFault};
use thiserror::Error;

/// Longest gap that one packet makes the plant catch up with, steps: 1 s. A longer one is a pause of the module (a
/// debugger, a suspended machine), during which the aircraft shall not fly off with its controls held.
const LONGEST_CATCH_UP: u64 = 1_000_000_000 / STEP_NS;
/// So many older packets in a row, each newer than the one before, mean that the module's clock began anew: 1 s.
const CLOCK_RESTART_PACKETS: u32 = 50;
/// Free-running: a module clock further than this from its expected reading is taken anew, ns.
const FREE_CLOCK_SLACK_NS: u64 = 100_000_000;

/// Why a session could not begin.
#[derive(Debug, Error)]
pub enum SessionError {
    /// The airframe makes no sense.
    #[error(transparent)]
    Airframe(#[from] AirframeError),
    /// The truth cannot be logged.
    #[error(transparent)]
    Truth(#[from] TruthError),
    /// There is no socket to show the aircraft by.
    #[error("cannot show the aircraft to FlightGear: {0}")]
    FlightGear(std::io::Error),
}

/// A flight with the state of its conversation.
#[derive(Debug)]
pub struct Session {
    flight: Flight,
    free_running: bool,
    /// Module time at which the plant's clock stood at zero, once known.
    origin_ns: Option<u64>,
    /// Module time of the newest answer.
    newest_ns: u64,
    /// Module time of the newest actuators of a free-running plant.
    newest_actuators_ns: u64,
    answer: Vec<u8>,
    /// Where MAVLink is spoken.
    mavlink: Option<Dialect>,
    older: OlderRun,
    /// When the simulator stands still, by the time since the first packet.
    pauses: Vec<PlannedFault>,
    /// Module time of the first packet.
    began_ns: Option<u64>,
    /// Cycles that a free-running plant has had, the paused ones included.
    ticks: u64,
    log: Option<TruthWriter>,
    flightgear: Option<FlightGear>,
    counters: Counters,
}

#[derive(Debug, Default)]
struct OlderRun {
    packets: u32,
    last_ns: u64,
}

impl Session {
    /// A parked aircraft and an empty log.
    ///
    /// # Errors
    /// When the airframe makes no sense or the log cannot be created.
    pub fn new(options: &Options) -> Result<Self, SessionError> {
        let log = match &options.truth {
            Some(path) => Some(TruthWriter::create(path, &Header::new(options))?),
            None => None,
        };
        Ok(Self {
            flight: Flight::new(options)?,
            free_running: options.free_running,
            origin_ns: None,
            newest_ns: 0,
            newest_actuators_ns: 0,
            answer: Vec::with_capacity(1024),
            mavlink: (options.protocol != Protocol::Native).then(Dialect::default),
            older: OlderRun::default(),
            pauses: pauses(options),
            began_ns: None,
            ticks: 0,
            log,
            flightgear: options
                .flightgear
                .map(FlightGear::at)
                .transpose()
                .map_err(SessionError::FlightGear)?,
            counters: Counters::default(),
        })
    }

    /// What happened so far.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// Counts a datagram that the socket refused.
    pub fn count_unsent(&mut self) {
        self.counters.unsent += 1;
    }

    /// Takes one datagram and appends the reply to `reply`, nothing where none is due. True when the sender has
    /// proved to be a flight computer.
    pub fn take(&mut self, datagram: &[u8], reply: &mut Vec<u8>) -> bool {
        // The ground crew calls the pilot in the native frames, whatever the flight computer speaks.
        if self.mavlink.is_some() && !datagram.starts_with(b"$") {
            return self.take_mavlink(reply, |dialect, asked| dialect.datagram(datagram, asked));
        }
        // A decoder of its own for each datagram: half a frame from a stranger must not swallow the next one.
        let mut decoder = Decoder::new();
        let (mut sound, mut flies) = (true, false);
        for &byte in datagram {
            let Some(frame) = decoder.push(byte) else { continue };
            match Packet::of(&frame) {
                Ok(Packet::Actuators(actuators)) if self.mavlink.is_none() => {
                    flies = true;
                    self.actuators(&actuators, reply);
                }
                Ok(Packet::Pilot(order)) => self.pilot(order, reply),
                _ => sound = false,
            }
        }
        let refused = decoder.refused();
        let useful = flies || !reply.is_empty();
        if !(sound && useful && refused.frames() == 0 && refused.noise_bytes == 0) {
            self.counters.garbage += 1;
        }
        flies
    }

    /// Takes the next bytes of a stream, as [`Session::take`] takes a datagram.
    pub fn take_stream(&mut self, bytes: &[u8], reply: &mut Vec<u8>) {
        self.take_mavlink(reply, |dialect, asked| dialect.stream(bytes, asked));
    }

    /// The stream has ended; what comes next belongs to another one.
    pub fn end_of_stream(&mut self) {
        self.mavlink.iter_mut().for_each(Dialect::cut);
    }

    /// Does what the bytes ask for. True when the sender has proved to be a flight computer.
    fn take_mavlink(
        &mut self,
        reply: &mut Vec<u8>,
        read: impl FnOnce(&mut Dialect, &mut Vec<Asked>) -> bool,
    ) -> bool {
        let Some(dialect) = &mut self.mavlink else { return false };
        let mut asked = Vec::new();
        let sound = read(dialect, &mut asked);
        self.counters.garbage += u64::from(!sound);
        let mut flies = false;
        for one in asked {
            match one {
                Asked::Advance(actuators) => {
                    flies = true;
                    self.actuators(&actuators, reply);
                }
                Asked::Pilot(order, answer) => {
                    self.counters.pilot_orders += 1;
                    self.flight.order(order);
                    reply.extend(answer);
                }
                Asked::Nothing(answer) => reply.extend(answer),
            }
        }
        flies
    }

    fn pilot(&mut self, order: PilotOrder, reply: &mut Vec<u8>) {
        self.counters.pilot_orders += 1;
        self.flight.order(order.order);
        Packet::Pilot(order).write(reply);
    }

    fn actuators(&mut self, actuators: &Actuators, reply: &mut Vec<u8>) {
        let began_ns = *self.began_ns.get_or_insert(actuators.module_ns);
        if !self.free_running && self.is_paused(actuators.module_ns.saturating_sub(began_ns)) {
            self.counters.withheld += 1;
            return;
        }
        if self.free_running {
            self.follow_clock(actuators.module_ns);
            self.actuate_newest(actuators);
        } else if self.exchange(actuators) {
            reply.extend_from_slice(&self.answer);
        }
    }

    /// Brings the answer up to the packet's time; false where the packet is to be ignored.
    fn exchange(&mut self, actuators: &Actuators) -> bool {
        let module_ns = actuators.module_ns;
        let Some(origin_ns) = self.origin_ns else {
            self.begin(actuators, module_ns);
            return true;
        };
        if module_ns < self.newest_ns {
            return self.older(actuators);
        }
        self.older.packets = 0;
        let due = round_to_steps(module_ns.saturating_sub(origin_ns));
        let steps = due.saturating_sub(self.flight.steps());
        if module_ns == self.newest_ns || steps == 0 {
            self.counters.repeated += 1;
            return true;
        }
        let steps = self.skip_pause(origin_ns, steps);
        self.flight.actuate(actuators);
        self.flight.advance(steps);
        self.compose(module_ns);
        true
    }

    fn begin(&mut self, actuators: &Actuators, module_ns: u64) {
        self.origin_ns = Some(module_ns.saturating_sub(self.flight.steps() * STEP_NS));
        self.flight.actuate(actuators);
        self.compose(module_ns);
    }

    /// An older packet is ignored, unless many in a row show that the module was started anew: then the aircraft
    /// flies on under the new clock.
    fn older(&mut self, actuators: &Actuators) -> bool {
        self.counters.older += 1;
        let rises = actuators.module_ns > self.older.last_ns;
        self.older.packets = if rises { self.older.packets + 1 } else { 1 };
        self.older.last_ns = actuators.module_ns;
        if self.older.packets < CLOCK_RESTART_PACKETS {
            return false;
        }
        self.older.packets = 0;
        self.counters.clock_restarts += 1;
        self.begin(actuators, actuators.module_ns);
        true
    }

    /// Steps to advance by; a gap that is too long shrinks to one cycle, and the plant's clock zero moves along.
    fn skip_pause(&mut self, origin_ns: u64, steps: u64) -> u64 {
        if steps <= LONGEST_CATCH_UP {
            return steps;
        }
        let skipped_ns = (steps - STEPS_PER_CYCLE) * STEP_NS;
        self.counters.pauses += 1;
        self.counters.skipped_ns += skipped_ns;
        self.origin_ns = Some(origin_ns + skipped_ns);
        STEPS_PER_CYCLE
    }

    /// Samples the sensors into the answer and logs the truth of that instant.
    fn compose(&mut self, module_ns: u64) {
        self.newest_ns = module_ns;
        let sample = self.flight.sample(self.origin_ns.unwrap_or(0), module_ns);
        self.write(&sample);
        self.counters.answers += 1;
        if let Some(flightgear) = &self.flightgear {
            flightgear.show(&self.flight.now());
        }
        let Some(log) = &mut self.log else { return };
        if log.append(&self.flight.truth(sample.analog.measured_ns)).is_err() {
            self.counters.unlogged += 1;
        }
    }

    fn write(&mut self, sample: &Sample) {
        self.answer.clear();
        if let Some(dialect) = &mut self.mavlink {
            return dialect.answer(sample, &mut self.answer);
        }
        Packet::Analog(sample.analog).write(&mut self.answer);
        Packet::Custom(sample.custom).write(&mut self.answer);
        if let Some(fix) = sample.gps {
            Packet::Gps(fix).write(&mut self.answer);
        }
        if let Some(range) = sample.range {
            Packet::Range(range).write(&mut self.answer);
        }
    }

    fn is_paused(&self, since_ns: u64) -> bool {
        let since_s = since_ns as f64 / 1e9;
        self.pauses.iter().any(|pause| pause.is_active(since_s))
    }

    /// Free-running: flies on for one cycle of 20 ms and gives the sensor set to send; nothing in a planned pause.
    pub fn tick(&mut self) -> &[u8] {
        self.ticks += 1;
        if self.is_paused(self.ticks * STEPS_PER_CYCLE * STEP_NS) {
            self.counters.withheld += 1;
            return &[];
        }
        self.flight.advance(STEPS_PER_CYCLE);
        let now_ns = self.origin_ns.unwrap_or(0) + self.flight.steps() * STEP_NS;
        self.compose(now_ns);
        &self.answer
    }

    /// Free-running: datagrams may overtake each other; one that was overtaken is ignored.
    fn actuate_newest(&mut self, actuators: &Actuators) {
        if actuators.module_ns < self.newest_actuators_ns {
            self.counters.older += 1;
            return;
        }
        self.newest_actuators_ns = actuators.module_ns;
        self.flight.actuate(actuators);
    }

    /// Free-running: ties the plant's clock to the module's at the first packet, and again after a jump.
    fn follow_clock(&mut self, module_ns: u64) {
        let flown_ns = self.flight.steps() * STEP_NS;
        let expected_ns = self.origin_ns.map(|origin_ns| origin_ns + flown_ns);
        match expected_ns {
            Some(expected_ns) if expected_ns.abs_diff(module_ns) <= FREE_CLOCK_SLACK_NS => return,
            Some(_) => self.counters.clock_restarts += 1,
            None => {}
        }
        self.origin_ns = Some(module_ns.saturating_sub(flown_ns));
        self.newest_actuators_ns = 0;
    }

    /// Hands the log to the system.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn flush(&mut self) -> Result<(), TruthError> {
        self.log.as_mut().map_or(Ok(()), TruthWriter::flush)
    }
}

fn pauses(options: &Options) -> Vec<PlannedFault> {
    let faults = options.conditions.faults.iter();
    faults.filter(|planned| planned.fault == Fault::Pause).copied().collect()
}

/// To the nearest step, so that a module whose instants jitter by less than half of one sees equal intervals.
fn round_to_steps(time_ns: u64) -> u64 {
    (time_ns + STEP_NS / 2) / STEP_NS
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_messages::{Custom, Range, RawAnalog, RawGps};

    fn packet(module_ns: u64, pulse_us: u16) -> Vec<u8> {
        let mut bytes = Vec::new();
        Packet::Actuators(Actuators { module_ns, throttle_us: pulse_us, ..Actuators::default() })
            .write(&mut bytes);
        bytes
    }

    #[test]
    fn free_running_plant_ignores_overtaken_actuators_and_follows_a_new_clock() {
        let mut session = Session::new(&Options { free_running: true, ..Options::default() }).unwrap();
        let mut reply = Vec::new();
        for (module_ns, pulse_us) in [(1_000_000_000, 1000), (1_040_000_000, 2000), (1_020_000_000, 1000)] {
            session.take(&packet(module_ns, pulse_us), &mut reply);
        }
        assert_eq!((session.counters().older, session.counters().clock_restarts), (1, 0));
        assert_eq!(session.flight.truth(0).timers_us[4], 2000);
        session.take(&packet(20_000_000, 1500), &mut reply);
        assert_eq!((session.counters().older, session.counters().clock_restarts), (1, 1));
        assert_eq!(session.flight.truth(0).timers_us[4], 1500);
        assert!(reply.is_empty());
    }

    fn answers(faults: &[&str], cycles: u64) -> (Vec<RawAnalog>, Vec<bool>, Session) {
        let mut options = Options::default();
        options.conditions.faults = faults.iter().map(|text| text.parse().unwrap()).collect();
        let mut session = Session::new(&options).unwrap();
        let (mut analog, mut answered) = (Vec::new(), Vec::new());
        for cycle in 0..cycles {
            let mut reply = Vec::new();
            session.take(&packet(1_000_000_000 + cycle * 20_000_000, 1000), &mut reply);
            answered.push(!reply.is_empty());
            let mut decoder = Decoder::new();
            let packets = decoder.extend(&reply).filter_map(|frame| Packet::of(&frame).ok());
            analog.extend(packets.filter_map(|packet| match packet {
                Packet::Analog(analog) => Some(analog),
                _ => None,
            }));
        }
        (analog, answered, session)
    }

    #[test]
    fn planned_pause_withholds_answers_and_the_aircraft_catches_up() {
        let (analog, answered, session) = answers(&["pause@0.2..0.4"], 30);
        let silent: Vec<usize> = (0..30).filter(|cycle| !answered[*cycle]).collect();
        assert_eq!(silent, (10..20).collect::<Vec<_>>());
        assert_eq!(analog[10].interval_ns, 220_000_000);
        assert_eq!((session.counters().withheld, session.counters().pauses), (10, 0));
    }

    #[test]
    fn planned_pause_of_a_free_running_plant_sends_nothing() {
        let mut options = Options { free_running: true, ..Options::default() };
        options.conditions.faults = vec!["pause@0.2..0.4".parse().unwrap()];
        let mut session = Session::new(&options).unwrap();
        let silent = (0..30).filter(|_| session.tick().is_empty()).count();
        assert_eq!(silent, 10);
    }

    #[test]
    fn lost_sensor_sets_arrive_empty_and_keep_their_time() {
        let (analog, answered, _) = answers(&["frames_lost=10%"], 1000);
        assert!(answered.iter().all(|answered| *answered));
        let lost = analog.iter().filter(|set| set.interval_ns == 0).skip(1); // the first has no interval anyway
        let mut count = 0;
        for set in lost {
            assert!(set.rates_radps[0].is_nan() && set.static_pressure_pa.is_nan(), "{set:?}");
            count += 1;
        }
        assert!((60..140).contains(&count), "{count} of 1000");
        assert!(analog.windows(2).all(|pair| pair[0].measured_ns < pair[1].measured_ns));
    }

    #[test]
    fn lost_magnetometer_and_pitot_give_no_numbers_for_their_time() {
        let (analog, _, _) = answers(&["magnetometer_lost@0.2..0.4", "pitot_lost@0.3..0.4"], 30);
        let without = |value: fn(&RawAnalog) -> f64| analog.iter().filter(|set| value(set).is_nan()).count();
        assert_eq!(without(|set| set.field_gauss[1]), 10);
        assert_eq!(without(|set| set.differential_pressure_pa), 5);
        assert_eq!(without(|set| set.static_pressure_pa), 0);
    }

    /// The README tells these lengths to people who bring their own simulator.
    #[test]
    fn packets_have_the_lengths_that_are_documented() {
        let lengths = [
            ("`T` actuators", size_of::<Actuators>()),
            ("`I` analogue", size_of::<RawAnalog>()),
            ("`C` custom", size_of::<Custom>()),
            ("`G` fix", size_of::<RawGps>()),
            ("`R` range", size_of::<Range>()),
            ("`P` pilot", size_of::<PilotOrder>()),
        ];
        let readme = include_str!("../README.md");
        for (name, length) in lengths {
            assert!(readme.contains(&format!("{name}, {length} bytes")), "{name} has {length} bytes");
        }
    }
}
