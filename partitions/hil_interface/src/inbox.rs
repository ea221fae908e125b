//! Which answers of the simulator to believe.

use bateleur_messages::frame::Decoder;
use bateleur_messages::hil::Packet;
use bateleur_messages::{Custom, Range, RawAnalog, RawGps};

use crate::remarks::Remarks;

/// After this many windows without anything new, an older time is believed again: the simulator was started anew, or
/// one damaged time stamp lay far in the future. One second at 50 Hz.
const STUBBORN_WINDOWS: u32 = 50;
/// The same for fixes, which come once a second at the slowest.
const STUBBORN_FIX_WINDOWS: u32 = 100;
/// Further from module time and from the newest sensors than this, a fix is not believed, ns: no receiver is slower.
const FIX_NEAR_NS: u64 = 2_000_000_000;
/// Further from the time asked for than this, sticks are not believed, ns: as long as the Servo believes those that it has. What
/// waited in a network for longer would pass as fresh there.
const STICKS_NEAR_NS: u64 = 100_000_000;
/// A stamp that lies no further from the question than this answers it, whatever the cycle, ns: what a clock in
/// floating-point seconds or in whole microseconds makes of it.
const ROUNDING_NS: u64 = 1_000;
/// The furthest that an answer's stamp may lie from the question, ns: half a cycle at 50 Hz.
const FURTHEST_NS: u64 = 10_000_000;

/// One window's sensors, as far as they came.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Sensors {
    /// Inertial, magnetic and pressure sensors.
    pub analog: Option<RawAnalog>,
    /// A satellite fix.
    pub gps: Option<RawGps>,
    /// Sticks and voltages.
    pub custom: Option<Custom>,
    /// Distance to the ground.
    pub range: Option<Range>,
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
    /// How far beside the question a stamp may lie that answers it, ns.
    tolerance_ns: u64,
    answered: bool,
    sensors: Sensors,
    last_analog_ns: Option<u64>,
    last_gps_ns: Option<u64>,
    last_custom_ns: Option<u64>,
    last_range_ns: Option<u64>,
    windows_without: u32,
    /// Windows since a fix was taken.
    windows_without_fix: u32,
    /// Windows since sticks were taken.
    windows_without_custom: u32,
    /// Windows since a distance was taken.
    windows_without_range: u32,
    /// Windows since a question was answered for its own time; `None`: none was.
    windows_without_answer: Option<u32>,
    counters: Counters,
    remarks: Remarks,
}

impl Inbox {
    /// An empty one, in lockstep or for a simulator with a clock of its own.
    pub fn new(lockstep: bool) -> Self {
        Self {
            lockstep,
            asked_ns: 0,
            tolerance_ns: ROUNDING_NS,
            answered: false,
            sensors: Sensors::default(),
            last_analog_ns: None,
            last_gps_ns: None,
            last_custom_ns: None,
            last_range_ns: None,
            windows_without: 0,
            windows_without_fix: 0,
            windows_without_custom: 0,
            windows_without_range: 0,
            windows_without_answer: None,
            counters: Counters::default(),
            remarks: Remarks::default(),
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
        // A late answer lies a whole step beside this question.
        let half_step_ns = asked_ns.saturating_sub(self.asked_ns) / 2;
        self.tolerance_ns = half_step_ns.clamp(ROUNDING_NS, FURTHEST_NS);
        (self.asked_ns, self.answered, self.sensors) = (asked_ns, false, Sensors::default());
    }

    /// What the simulator sends that can hardly be meant so, to be told once.
    pub(crate) fn remarks(&mut self) -> Vec<String> {
        self.remarks.take()
    }

    /// Whether the answer to the question is there.
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
    pub(crate) fn accepts_older_stamps(&self) -> bool {
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

    /// A fix whose time can be, which is taken if it is news.
    pub(crate) fn put_gps(&mut self, gps: RawGps) {
        let newest = self.sensors.gps.map(|held| held.measured_ns).or(self.last_gps_ns);
        let patient = self.windows_without_fix >= STUBBORN_FIX_WINDOWS;
        if is_news(gps.measured_ns, newest, patient) {
            self.sensors.gps = Some(gps);
        }
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
        self.windows_without_fix = self.windows_without_fix.saturating_add(1);
        if let Some(gps) = &sensors.gps {
            self.last_gps_ns = Some(gps.measured_ns);
            self.windows_without_fix = 0;
        }
        self.windows_without_custom = self.windows_without_custom.saturating_add(1);
        if let Some(custom) = &sensors.custom {
            self.last_custom_ns = Some(custom.measured_ns);
            self.windows_without_custom = 0;
        }
        self.windows_without_range = self.windows_without_range.saturating_add(1);
        if let Some(range) = &sensors.range {
            self.last_range_ns = Some(range.measured_ns);
            self.windows_without_range = 0;
        }
        self.windows_without_answer = self.windows_without_answer.map(|windows| windows.saturating_add(1));
        self.remarks.note_values(&sensors);
        sensors
    }

    fn packet(&mut self, packet: &Packet) {
        match packet {
            Packet::Analog(analog) => self.analog(analog),
            Packet::Gps(gps) => self.gps(gps),
            Packet::Custom(custom) => self.custom(custom),
            Packet::Range(range) => self.range(range),
            // What only the simulator takes.
            Packet::Actuators(_) | Packet::Pilot(_) => self.counters.refused += 1,
        }
    }

    /// The answer to the question outdoes any other, and of several the one nearest to it; of others, the newest counts
    /// if it is new.
    fn analog(&mut self, analog: &RawAnalog) {
        let beside_ns = i128::from(analog.measured_ns) - i128::from(self.asked_ns);
        let is_answer = self.answers(analog.measured_ns);
        if self.lockstep {
            self.remarks.note_time(beside_ns, is_answer);
        }
        if is_answer {
            let held = self.sensors.analog.filter(|_| self.answered);
            let nearest_ns = held.map(|held| held.measured_ns.abs_diff(self.asked_ns));
            if nearest_ns.is_none_or(|nearest_ns| beside_ns.unsigned_abs() <= nearest_ns.into()) {
                self.sensors.analog = Some(*analog);
            }
            self.answered = true;
            self.windows_without_answer = Some(0);
            return;
        }
        let newest = self.sensors.analog.map(|held| held.measured_ns).or(self.last_analog_ns);
        let is_news = is_news(analog.measured_ns, newest, self.accepts_older_stamps());
        self.counters.stale += u64::from(self.lockstep || !is_news);
        if !self.answered && is_news {
            self.sensors.analog = Some(*analog);
        }
    }

    /// Whether sensors of this time answer the question. A free-running simulator answers none.
    fn answers(&self, measured_ns: u64) -> bool {
        let beside_ns = measured_ns.abs_diff(self.asked_ns);
        let is_repeated = self.last_analog_ns == Some(measured_ns);
        self.lockstep && (beside_ns == 0 || (beside_ns <= self.tolerance_ns && !is_repeated))
    }

    /// A fix may be older than the question by the receiver's latency; a repeated answer repeats it. One whose time can
    /// not be would otherwise shut out all that follow.
    fn gps(&mut self, gps: &RawGps) {
        if self.is_near_question(gps.measured_ns, FIX_NEAR_NS)
            || self.is_near_sensors(gps.measured_ns, FIX_NEAR_NS)
        {
            return self.put_gps(*gps);
        }
        self.counters.invalid += 1;
        self.remarks.note_fix_time(i128::from(gps.measured_ns) - i128::from(self.asked_ns));
    }

    /// Sticks get a new stamp with their port, which the Servo trusts: those that were published, and those that are old, are not
    /// taken. A simulator whose answers lie beside the questions has a clock of its own: its sensors show how late it is there.
    fn custom(&mut self, custom: &Custom) {
        let measured_ns = custom.measured_ns;
        let is_near = self.is_recent(measured_ns);
        self.remarks.note_sticks_time(i128::from(measured_ns) - i128::from(self.asked_ns), !is_near);
        if !is_near {
            self.counters.stale += 1;
            return;
        }
        let held_ns = self.sensors.custom.map(|held| held.measured_ns);
        let is_answer = measured_ns == self.asked_ns && self.last_custom_ns != Some(measured_ns);
        let patient = self.windows_without_custom >= STUBBORN_WINDOWS;
        let is_news = is_news(measured_ns, held_ns.or(self.last_custom_ns), patient);
        if is_answer || (is_news && held_ns != Some(self.asked_ns)) {
            self.sensors.custom = Some(*custom);
        }
    }

    /// A distance that waited in a network is of no use near the ground.
    fn range(&mut self, range: &Range) {
        if self.is_recent(range.measured_ns) {
            self.put_range(*range);
        } else {
            self.counters.stale += 1;
        }
    }

    /// A distance whose time can be, which is taken if it is news, and what its range finder can measure.
    pub(crate) fn put_range(&mut self, range: Range) {
        // At its longest distance a range finder says that it sees nothing.
        let measured = (range.least_m..range.most_m).contains(&range.distance_m);
        if !measured || range.distance_m <= 0.0 || !range.distance_m.is_finite() {
            return; // no echo
        }
        let newest = self.sensors.range.map(|held| held.measured_ns).or(self.last_range_ns);
        let patient = self.windows_without_range >= STUBBORN_WINDOWS;
        if is_news(range.measured_ns, newest, patient) {
            self.sensors.range = Some(range);
        }
    }

    /// Whether what must not be old is not. The sensors of a simulator with a clock of its own show how late it is there.
    fn is_recent(&self, measured_ns: u64) -> bool {
        let own_clock = self.windows_without_answer.is_none_or(|windows| windows >= STUBBORN_WINDOWS);
        self.is_near_question(measured_ns, STICKS_NEAR_NS)
            || (own_clock && self.is_near_sensors(measured_ns, STICKS_NEAR_NS))
    }

    fn is_near_question(&self, measured_ns: u64, within_ns: u64) -> bool {
        measured_ns.abs_diff(self.asked_ns) <= within_ns
    }

    fn is_near_sensors(&self, measured_ns: u64, within_ns: u64) -> bool {
        let newest_ns = self.sensors.analog.map(|held| held.measured_ns).or(self.last_analog_ns);
        newest_ns.is_some_and(|newest_ns| measured_ns.abs_diff(newest_ns) <= within_ns)
    }
}

/// Whether a time is later than the newest one, or another at least where one has waited long enough for a later one.
fn is_news(measured_ns: u64, newest_ns: Option<u64>, patient: bool) -> bool {
    newest_ns.is_none_or(|newest_ns| measured_ns > newest_ns || (patient && measured_ns != newest_ns))
}

#[cfg(test)]
mod tests {
    use super::*;

    const CYCLE: u64 = 20_000_000;

    fn analog(measured_ns: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        let sound = RawAnalog { interval_ns: CYCLE, static_pressure_pa: 101_325.0, ..RawAnalog::default() };
        Packet::Analog(RawAnalog { measured_ns, ..sound }).write(&mut bytes);
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
    fn an_answer_whose_stamp_was_rounded_is_the_answer_and_is_told_once() {
        for beside_ns in [-500_000, -1, 1, 1_000, 9_000_000] {
            let mut inbox = Inbox::new(true);
            let mut told = Vec::new();
            for cycle in 1..100 {
                inbox.begin(cycle * CYCLE);
                inbox.take(&analog((cycle * CYCLE).saturating_add_signed(beside_ns)));
                assert!(inbox.is_answered(), "cycle {cycle}, {beside_ns} ns");
                assert!(published(&mut inbox).is_some());
                told.extend(inbox.remarks());
            }
            assert_eq!((inbox.counters().accepted, inbox.counters().stale), (99, 0));
            assert!(told.len() == 1 && told[0].contains("another time than asked"), "{told:?}");
        }
    }

    #[test]
    fn a_rounded_stamp_does_not_make_a_late_answer_the_answer() {
        let mut inbox = Inbox::new(true);
        for cycle in 1..10 {
            inbox.begin(cycle * CYCLE);
            inbox.take(&analog((cycle - 1) * CYCLE + 1));
            assert!(!inbox.is_answered());
            inbox.take(
                &[analog(cycle * CYCLE + 1), analog(cycle * CYCLE), analog(cycle * CYCLE - 7)].concat(),
            );
            assert_eq!(published(&mut inbox), Some(cycle * CYCLE), "the nearest");
        }
    }

    #[test]
    fn answers_that_are_always_late_are_told_after_a_second_and_a_single_late_one_is_not() {
        let mut inbox = Inbox::new(true);
        for cycle in 1..=100 {
            inbox.begin(cycle * CYCLE);
            inbox.take(&[analog((cycle - 1) * CYCLE), analog(cycle * CYCLE)].concat());
            inbox.finish();
        }
        assert_eq!(inbox.remarks(), Vec::<String>::new());
        let told = |inbox: &mut Inbox, cycle| {
            inbox.begin(cycle * CYCLE);
            inbox.take(&analog((cycle - 1) * CYCLE));
            inbox.finish();
            inbox.remarks().len()
        };
        assert_eq!((101..300).map(|cycle| told(&mut inbox, cycle)).sum::<usize>(), 1);
    }

    #[test]
    fn of_a_free_running_simulator_the_newest_counts_also_where_one_meets_the_question() {
        let mut inbox = Inbox::new(false);
        inbox.begin(CYCLE);
        inbox.take(&[analog(CYCLE), analog(CYCLE + 1_000_000)].concat());
        assert_eq!(published(&mut inbox), Some(CYCLE + 1_000_000));
    }

    fn fixes(inbox: &mut Inbox, cycle: u64, measured_ns: u64) -> Option<u64> {
        let mut bytes = analog(cycle * CYCLE);
        Packet::Gps(RawGps { measured_ns, ..RawGps::default() }).write(&mut bytes);
        inbox.begin(cycle * CYCLE);
        inbox.take(&bytes);
        inbox.finish().gps.map(|gps| gps.measured_ns)
    }

    #[test]
    fn one_fix_from_the_future_is_counted_and_told_and_does_not_shut_out_the_right_ones() {
        let mut inbox = Inbox::new(true);
        assert_eq!(fixes(&mut inbox, 10, 9 * CYCLE), Some(9 * CYCLE));
        for future_ns in [u64::MAX, 1_000_000_000_000_000_000, 20 * CYCLE + 2_000_000_001] {
            assert_eq!(fixes(&mut inbox, 20, future_ns), None);
        }
        assert_eq!((inbox.counters().invalid, inbox.remarks().len()), (3, 1));
        assert_eq!(fixes(&mut inbox, 21, 20 * CYCLE), Some(20 * CYCLE));
        assert_eq!(fixes(&mut inbox, 22, 22 * CYCLE + 1_900_000_000), Some(22 * CYCLE + 1_900_000_000));
        let heard = (23..223).filter(|cycle| fixes(&mut inbox, *cycle, cycle * CYCLE).is_some()).count();
        assert!(heard >= 99, "{heard}: what can still be believed costs two seconds of fixes");
    }

    #[test]
    fn fixes_of_a_simulator_with_its_own_clock_are_taken_beside_its_sensors() {
        let mut inbox = Inbox::new(true);
        let own_ns = 1_700_000_000_000_000_000;
        for cycle in 1..10 {
            let mut bytes = analog(own_ns + cycle * CYCLE);
            Packet::Gps(RawGps { measured_ns: own_ns + cycle * CYCLE, ..RawGps::default() })
                .write(&mut bytes);
            inbox.begin(cycle * CYCLE);
            inbox.take(&bytes);
            assert!(inbox.finish().gps.is_some());
        }
        assert_eq!(inbox.counters().invalid, 0);
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

    /// A datagram with sensors and sticks of a time, in the window of a cycle; gives the time of the sticks that were published.
    fn sticks(inbox: &mut Inbox, cycle: u64, measured_ns: u64) -> Option<u64> {
        let mut bytes = analog(measured_ns);
        Packet::Custom(Custom { measured_ns, ..Custom::default() }).write(&mut bytes);
        inbox.begin(cycle * CYCLE);
        inbox.take(&bytes);
        inbox.finish().custom.map(|custom| custom.measured_ns)
    }

    #[test]
    fn sticks_that_come_again_or_late_are_not_published_as_fresh() {
        let mut inbox = Inbox::new(true);
        for cycle in 10..20 {
            assert_eq!(sticks(&mut inbox, cycle, cycle * CYCLE), Some(cycle * CYCLE));
        }
        assert_eq!(sticks(&mut inbox, 20, 19 * CYCLE), None, "they were published");
        assert_eq!(sticks(&mut inbox, 21, 20 * CYCLE), Some(20 * CYCLE), "late, and news");
        assert_eq!(sticks(&mut inbox, 22, 19 * CYCLE), None, "older than what was published");
        assert_eq!(sticks(&mut inbox, 60, 50 * CYCLE), None, "they waited in the network for 200 ms");
        assert_eq!(sticks(&mut inbox, 61, 61 * CYCLE), Some(61 * CYCLE));
    }

    #[test]
    fn sticks_that_never_have_a_time_are_refused_and_told_once() {
        let mut inbox = Inbox::new(true);
        let mut told = Vec::new();
        for cycle in 10..200 {
            let mut bytes = analog(cycle * CYCLE);
            Packet::Custom(Custom::default()).write(&mut bytes);
            inbox.begin(cycle * CYCLE);
            inbox.take(&bytes);
            assert_eq!(inbox.finish().custom, None);
            told.extend(inbox.remarks());
        }
        assert!(told.len() == 1 && told[0].contains("stamp CC"), "{told:?}");
    }

    #[test]
    fn sticks_of_a_simulator_with_its_own_clock_are_heard_and_heard_again_after_its_restart() {
        for lockstep in [true, false] {
            let mut inbox = Inbox::new(lockstep);
            let own_ns = 1_700_000_000_000_000_000;
            for cycle in 1..100 {
                let measured_ns = own_ns + cycle * CYCLE;
                assert_eq!(sticks(&mut inbox, cycle, measured_ns), Some(measured_ns), "cycle {cycle}");
            }
            let heard = (0..60).filter(|cycle| sticks(&mut inbox, 100 + cycle, cycle * CYCLE + 7).is_some());
            assert_eq!(heard.count(), 10, "after a second");
        }
    }

    #[test]
    fn sticks_for_the_time_asked_for_outdo_others_whatever_the_order() {
        for order in [[0, 1, 2], [2, 1, 0], [1, 2, 0]] {
            let mut inbox = Inbox::new(true);
            inbox.begin(50 * CYCLE);
            for place in order {
                let mut bytes = Vec::new();
                let measured_ns = 49 * CYCLE + place * CYCLE;
                Packet::Custom(Custom { measured_ns, ..Custom::default() }).write(&mut bytes);
                inbox.take(&bytes);
            }
            assert_eq!(inbox.finish().custom.map(|custom| custom.measured_ns), Some(50 * CYCLE));
        }
    }

    /// A datagram with sensors and a distance of a time, in the window of a cycle; the time of the distance that was published.
    fn distance(inbox: &mut Inbox, cycle: u64, set_ns: u64, measured_ns: u64) -> Option<u64> {
        let mut bytes = analog(set_ns);
        let sound = Range { measured_ns, distance_m: 7.0, least_m: 0.1, most_m: 50.0 };
        Packet::Range(sound).write(&mut bytes);
        inbox.begin(cycle * CYCLE);
        inbox.take(&bytes);
        inbox.finish().range.map(|range| range.measured_ns)
    }

    #[test]
    fn distances_are_published_once_and_old_ones_never() {
        let mut inbox = Inbox::new(true);
        assert_eq!(distance(&mut inbox, 10, 10 * CYCLE, 10 * CYCLE), Some(10 * CYCLE));
        assert_eq!(distance(&mut inbox, 11, 11 * CYCLE, 10 * CYCLE), None, "it was published");
        assert_eq!(
            distance(&mut inbox, 40, 40 * CYCLE, 30 * CYCLE),
            None,
            "it waited in the network for 200 ms"
        );
        assert_eq!((inbox.counters().stale, inbox.counters().accepted), (1, 3));
        let sound = Range { measured_ns: 41 * CYCLE, distance_m: 7.0, least_m: 0.1, most_m: 50.0 };
        let mut older_after_newer = analog(41 * CYCLE);
        for measured_ns in [41 * CYCLE, 40 * CYCLE, 41 * CYCLE - 1] {
            Packet::Range(Range { measured_ns, ..sound }).write(&mut older_after_newer);
        }
        inbox.begin(41 * CYCLE);
        inbox.take(&older_after_newer);
        assert_eq!(inbox.finish().range.map(|range| range.measured_ns), Some(41 * CYCLE));
        let mut own = Inbox::new(true);
        let own_ns = 1_700_000_000_000_000_000;
        assert_eq!(
            distance(&mut own, 41, own_ns, own_ns),
            Some(own_ns),
            "a clock of its own, as its sensors'"
        );
    }

    #[test]
    fn what_is_no_distance_is_none() {
        let mut inbox = Inbox::new(true);
        let sound = Range { measured_ns: 0, distance_m: 7.0, least_m: 0.1, most_m: 50.0 };
        let no_limits = Range { least_m: f64::NEG_INFINITY, most_m: f64::INFINITY, ..sound };
        let values = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -7.0, 0.0];
        let all = values
            .iter()
            .flat_map(|&distance_m| [Range { distance_m, ..sound }, Range { distance_m, ..no_limits }]);
        let beyond = [50.1, 1e300].map(|distance_m| Range { distance_m, ..sound });
        for (cycle, range) in (1..).zip(all.chain(beyond)) {
            inbox.begin(cycle * CYCLE);
            inbox.put_range(Range { measured_ns: cycle * CYCLE, ..range });
            assert_eq!(inbox.finish().range, None, "{range:?}");
        }
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
