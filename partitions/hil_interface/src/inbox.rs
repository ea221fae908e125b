//! Which answers of the simulator to believe.

use bateleur_messages::frame::Decoder;
use bateleur_messages::hil::Packet;
use bateleur_messages::{Custom, RawAnalog, RawGps};

/// After this many windows without anything new, an older time is believed again: the simulator was started anew, or
/// one damaged time stamp lay far in the future. One second at 50 Hz.
const STUBBORN_WINDOWS: u32 = 50;

/// One window's sensors, as far as they came.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Sensors {
    /// Inertial, magnetic and pressure sensors.
    pub analog: Option<RawAnalog>,
    /// A satellite fix.
    pub gps: Option<RawGps>,
    /// Sticks and voltages.
    pub custom: Option<Custom>,
}

/// What became of what came.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counters {
    /// Windows with new sensors.
    pub accepted: u64,
    /// Windows without.
    pub missing: u64,
    /// Frames and datagrams that could not be read, or that belong elsewhere.
    pub refused: u64,
    /// Answers for another time than the one asked for.
    pub stale: u64,
    /// Datagrams from another address than the simulator's.
    pub strangers: u64,
    /// Errors of the socket.
    pub errors: u64,
    /// Questions that were sent a second time.
    pub repeated: u64,
    /// Sound messages that say nothing to a flight computer.
    pub unused: u64,
    /// Values that are no numbers, and time stamps that can not be.
    pub invalid: u64,
    /// Messages that are missing by their numbers.
    pub lost: u64,
    /// Connections made.
    pub connections: u64,
    /// Times that the simulator's clock was tied to module time.
    pub clock_ties: u64,
}

impl Counters {
    /// All that was missing, late or refused.
    pub fn refused_in_all(&self) -> u64 {
        self.missing + self.refused + self.invalid + self.strangers + self.errors
    }

    /// What hints at a fault of the link: everything but windows and answers, which a lossy link costs anyway.
    pub fn faults(&self) -> u64 {
        self.refused + self.invalid + self.strangers + self.errors
    }

    /// What the socket met.
    pub(crate) fn add_socket(&mut self, socket: &Self) {
        self.strangers += socket.strangers;
        self.errors += socket.errors;
    }
}

/// Collects the newest sensors from datagrams.
#[derive(Debug)]
pub struct Inbox {
    /// The answers are those to the questions, and others count as stale.
    lockstep: bool,
    asked_ns: u64,
    answered: bool,
    sensors: Sensors,
    last_analog_ns: Option<u64>,
    last_gps_ns: Option<u64>,
    windows_without: u32,
    counters: Counters,
}

impl Inbox {
    /// An empty one, in lockstep or for a simulator with a clock of its own.
    pub fn new(lockstep: bool) -> Self {
        Self {
            lockstep,
            asked_ns: 0,
            answered: false,
            sensors: Sensors::default(),
            last_analog_ns: None,
            last_gps_ns: None,
            windows_without: 0,
            counters: Counters::default(),
        }
    }

    /// What became of what came.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }

    /// For what the link counts.
    pub fn counters_mut(&mut self) -> &mut Counters {
        &mut self.counters
    }

    /// A window begins, whose question is for module time `asked_ns`.
    pub fn begin(&mut self, asked_ns: u64) {
        (self.asked_ns, self.answered, self.sensors) = (asked_ns, false, Sensors::default());
    }

    /// Whether the very answer to the question is there.
    pub fn is_answered(&self) -> bool {
        self.answered
    }

    /// Whether sensors that were not there before are there now.
    pub fn has_news(&self) -> bool {
        self.answered || self.sensors.analog.is_some()
    }

    /// Whether the last window had new sensors.
    pub(crate) fn was_answered(&self) -> bool {
        self.windows_without == 0 && self.last_analog_ns.is_some()
    }

    /// Nothing new has come for a second: what was not believed before is believed now.
    pub(crate) fn is_alone(&self) -> bool {
        self.windows_without >= STUBBORN_WINDOWS
    }

    /// The module time of the newest sensors that were taken, ns.
    pub fn measured_ns(&self) -> u64 {
        self.last_analog_ns.unwrap_or_default()
    }

    /// The answer to the question has come.
    pub(crate) fn note_answer(&mut self) {
        self.answered = true;
    }

    /// Sensors of this window that need no further judgement.
    pub(crate) fn put_analog(&mut self, analog: RawAnalog) {
        self.sensors.analog = Some(analog);
    }

    /// Sticks and voltages of this window.
    pub(crate) fn put_custom(&mut self, custom: Custom) {
        self.sensors.custom = Some(custom);
    }

    /// A fix, which is taken if it is news.
    pub(crate) fn put_gps(&mut self, gps: RawGps) {
        self.gps(&gps);
    }

    /// Takes a datagram of the simulator, in the native protocol.
    pub fn take(&mut self, datagram: &[u8]) {
        let mut decoder = Decoder::new();
        let mut packets = 0;
        for frame in decoder.extend(datagram) {
            packets += 1;
            match Packet::of(&frame) {
                Ok(packet) => self.packet(&packet),
                Err(_) => self.counters.refused += 1,
            }
        }
        let damaged = decoder.refused().frames();
        let nothing = u64::from(packets == 0 && damaged == 0);
        self.counters.refused += damaged + nothing;
    }

    /// The window is over: what there is to publish.
    pub fn finish(&mut self) -> Sensors {
        let sensors = std::mem::take(&mut self.sensors);
        if let Some(analog) = &sensors.analog {
            self.last_analog_ns = Some(analog.measured_ns);
            self.counters.accepted += 1;
            self.windows_without = 0;
        } else {
            self.counters.missing += 1;
            self.windows_without = self.windows_without.saturating_add(1);
        }
        if let Some(gps) = &sensors.gps {
            self.last_gps_ns = Some(gps.measured_ns);
        }
        sensors
    }

    fn packet(&mut self, packet: &Packet) {
        match packet {
            Packet::Analog(analog) => self.analog(analog),
            Packet::Gps(gps) => self.gps(gps),
            Packet::Custom(custom) => self.custom(custom),
            // What only the simulator takes.
            Packet::Actuators(_) | Packet::Pilot(_) => self.counters.refused += 1,
        }
    }

    /// The answer to the question outdoes any other; of others, the newest counts if it is new.
    fn analog(&mut self, analog: &RawAnalog) {
        if analog.measured_ns == self.asked_ns {
            self.answered = true;
            self.sensors.analog = Some(*analog);
            return;
        }
        let newest = self.sensors.analog.map(|held| held.measured_ns);
        let is_news = self.is_news(analog.measured_ns, newest.or(self.last_analog_ns));
        self.counters.stale += u64::from(self.lockstep || !is_news);
        if !self.answered && is_news {
            self.sensors.analog = Some(*analog);
        }
    }

    /// A fix may be older than the question by the receiver's latency; a repeated answer repeats it.
    fn gps(&mut self, gps: &RawGps) {
        let newest = self.sensors.gps.map(|held| held.measured_ns);
        if self.is_news(gps.measured_ns, newest.or(self.last_gps_ns)) {
            self.sensors.gps = Some(*gps);
        }
    }

    fn custom(&mut self, custom: &Custom) {
        let held = self.sensors.custom.filter(|held| held.measured_ns == self.asked_ns);
        if held.is_none() {
            self.sensors.custom = Some(*custom);
        }
    }

    fn is_news(&self, measured_ns: u64, newest_ns: Option<u64>) -> bool {
        newest_ns
            .is_none_or(|newest_ns| measured_ns > newest_ns || (self.is_alone() && measured_ns != newest_ns))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CYCLE: u64 = 20_000_000;

    fn analog(measured_ns: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        Packet::Analog(RawAnalog { measured_ns, ..RawAnalog::default() }).write(&mut bytes);
        bytes
    }

    fn published(inbox: &mut Inbox) -> Option<u64> {
        inbox.finish().analog.map(|analog| analog.measured_ns)
    }

    #[test]
    fn the_answer_to_the_question_is_taken() {
        let mut inbox = Inbox::new(true);
        inbox.begin(CYCLE);
        inbox.take(&analog(CYCLE));
        assert!(inbox.is_answered());
        assert_eq!(published(&mut inbox), Some(CYCLE));
        assert_eq!(inbox.counters(), &Counters { accepted: 1, ..Counters::default() });
    }

    #[test]
    fn a_late_answer_is_counted_and_used_where_nothing_newer_is_there() {
        let mut inbox = Inbox::new(true);
        inbox.begin(2 * CYCLE);
        inbox.take(&analog(CYCLE));
        assert!(!inbox.is_answered());
        assert_eq!(published(&mut inbox), Some(CYCLE));
        inbox.begin(3 * CYCLE);
        inbox.take(&analog(CYCLE));
        assert_eq!(published(&mut inbox), None);
        assert_eq!(inbox.counters().stale, 2);
        assert_eq!((inbox.counters().accepted, inbox.counters().missing), (1, 1));
    }

    #[test]
    fn the_newest_answer_wins_whatever_the_order() {
        let mut inbox = Inbox::new(true);
        inbox.begin(3 * CYCLE);
        inbox.take(&[analog(3 * CYCLE), analog(2 * CYCLE)].concat());
        assert_eq!(published(&mut inbox), Some(3 * CYCLE));
    }

    #[test]
    fn one_time_stamp_from_the_future_does_not_shut_out_the_right_answers() {
        let mut inbox = Inbox::new(true);
        inbox.begin(CYCLE);
        inbox.take(&analog(u64::MAX));
        assert_eq!(published(&mut inbox), Some(u64::MAX));
        inbox.begin(2 * CYCLE);
        inbox.take(&analog(2 * CYCLE));
        assert_eq!(published(&mut inbox), Some(2 * CYCLE));
    }

    #[test]
    fn a_simulator_with_its_own_clock_is_heard_and_heard_again_after_its_restart() {
        let mut inbox = Inbox::new(true);
        let mut window = |number: u64, measured_ns| {
            inbox.begin(number * CYCLE);
            inbox.take(&analog(measured_ns));
            published(&mut inbox).is_some()
        };
        assert!(window(1, 900 * CYCLE + 7));
        assert!(window(2, 901 * CYCLE + 7));
        let heard = (0..60).filter(|number| window(3 + number, number * CYCLE + 7)).count();
        assert!(heard >= 9, "{heard}");
    }

    #[test]
    fn garbage_is_counted_and_harms_nobody() {
        let mut inbox = Inbox::new(true);
        inbox.begin(CYCLE);
        inbox.take(b"hello");
        inbox.take(&[]);
        let mut damaged = analog(CYCLE);
        damaged[9] ^= 0x40;
        inbox.take(&damaged);
        inbox.take(&analog(CYCLE)[..40]);
        let mut foreign = Vec::new();
        Packet::Pilot(Default::default()).write(&mut foreign);
        inbox.take(&foreign);
        assert_eq!(inbox.counters().refused, 5);
        inbox.take(&analog(CYCLE));
        assert_eq!(published(&mut inbox), Some(CYCLE));
    }

    #[test]
    fn a_repeated_fix_is_published_once() {
        let mut inbox = Inbox::new(true);
        let mut bytes = Vec::new();
        Packet::Gps(RawGps { measured_ns: 7, ..RawGps::default() }).write(&mut bytes);
        Packet::Custom(Custom { measured_ns: CYCLE, main_v: 12.0, ..Custom::default() }).write(&mut bytes);
        inbox.begin(CYCLE);
        inbox.take(&bytes);
        let sensors = inbox.finish();
        assert_eq!(sensors.gps.map(|gps| gps.measured_ns), Some(7));
        assert_eq!(sensors.custom.map(|custom| custom.main_v), Some(12.0));
        inbox.begin(2 * CYCLE);
        inbox.take(&bytes);
        assert_eq!(inbox.finish().gps, None);
    }
}
