//! Parameters: what can be read, and in part set, of a function over the ports to and from the ground.
//!
//! Responsible for: the two messages, the table from which a function answers them ([`Parameters`]), and asking functions for all they
//! have ([`Gatherer`]). A function that has no table answers as to any letter that it does not know, and counts as one without
//! parameters. Nothing is said unless it is asked for.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::ground::{NAME, Name, Order, ParameterSetting};
pub use crate::packet::ParameterValue;
use crate::telemetry::{self, ACCEPTED, Acknowledge, NOT_UNDERSTOOD, Refusal, Telemetry};
use crate::{GroundMessage, TelemetryMessage};

/// [`Order::ReadParameter`]: asked over the line of the native protocol.
pub const ASKED_BY_LINE: u8 = 0;
/// [`Order::ReadParameter`]: asked by Command itself, for MAVLink.
pub const ASKED_BY_COMMAND: u8 = 1;

/// What a parameter is made of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Kind {
    /// Any number within its range.
    Real = 0,
    /// A whole number that fits into 32 bits with a sign.
    Whole = 1,
    /// 0 or 1, or the place of a word in a list.
    Choice = 2,
}

impl Kind {
    /// The kind with this number; a real where there is none.
    pub fn from_number(number: u8) -> Self {
        [Self::Real, Self::Whole, Self::Choice]
            .into_iter()
            .find(|kind| *kind as u8 == number)
            .unwrap_or(Self::Real)
    }
}

impl ParameterValue {
    /// The name as text.
    pub fn name(&self) -> &str {
        name_text(&self.name)
    }

    /// Why it was not set.
    pub fn refusal(&self) -> Option<Refusal> {
        Refusal::of_number(self.reason)
    }
}

/// The function whose parameters begin like `name`: each has three letters of its own.
pub fn function_of(name: &str) -> Option<u8> {
    let (letters, _) = name.split_once('_')?;
    PREFIXES.iter().find(|(_, prefix)| *prefix == letters).map(|(function, _)| *function)
}

/// What the names of a function's parameters begin with.
pub const PREFIXES: [(u8, &str); 8] = [
    (telemetry::FROM_COMMAND, "CMD"),
    (telemetry::FROM_RATE_GENERATOR, "RAT"),
    (telemetry::FROM_HIL_INTERFACE, "HIL"),
    (telemetry::FROM_GPS, "GPS"),
    (telemetry::FROM_IMU, "IMU"),
    (telemetry::FROM_ESTIMATOR, "EST"),
    (telemetry::FROM_CONTROLLER, "CTL"),
    (telemetry::FROM_SERVO, "SRV"),
];

/// A name as it is sent: zeros behind it. What is longer is cut.
pub fn name_bytes(name: &str) -> Name {
    let mut bytes = [0; NAME];
    let length = name.len().min(NAME);
    bytes[..length].copy_from_slice(&name.as_bytes()[..length]);
    bytes
}

/// A sent name as text; empty where it is none.
pub fn name_text(name: &Name) -> &str {
    let end = name.iter().position(|byte| *byte == 0).unwrap_or(NAME);
    std::str::from_utf8(&name[..end]).unwrap_or_default()
}

/// One line of a function's table. `S` is what the function was set up with.
#[derive(Debug)]
pub struct Row<S> {
    name: &'static str,
    kind: Kind,
    get: fn(&S) -> Option<f64>,
    set: Option<Setting<S>>,
}

/// How a value is set, and between which limits.
#[derive(Debug)]
struct Setting<S> {
    lowest: f64,
    highest: f64,
    set: fn(&mut S, f64) -> bool,
}

impl<S> Row<S> {
    /// One that belongs to the plan or to a file: it can be read. `get` gives nothing where this function has no such
    /// value (a piston engine has no winding): the parameter then is not listed.
    pub const fn fixed(name: &'static str, kind: Kind, get: fn(&S) -> Option<f64>) -> Self {
        assert!(name.len() <= NAME);
        Self { name, kind, get, set: None }
    }

    /// One that can be set from `lowest` to `highest`. `set` may refuse a value within, by false, and then
    /// changes nothing.
    pub const fn settable(
        name: &'static str,
        kind: Kind,
        limits: (f64, f64),
        get: fn(&S) -> Option<f64>,
        set: fn(&mut S, f64) -> bool,
    ) -> Self {
        assert!(name.len() <= NAME);
        Self { name, kind, get, set: Some(Setting { lowest: limits.0, highest: limits.1, set }) }
    }

    fn try_set(&self, settings: &mut S, value: f64) -> Result<(), Refusal> {
        let setting = self.set.as_ref().ok_or(Refusal::BelongsToPlan)?;
        // What is not a number is in no range.
        if !(setting.lowest..=setting.highest).contains(&value) {
            return Err(Refusal::OutOfRange);
        }
        if self.kind != Kind::Real && value.fract() != 0.0 {
            return Err(Refusal::NotWhole);
        }
        if (setting.set)(settings, value) { Ok(()) } else { Err(Refusal::OutOfRange) }
    }
}

/// Settable rows that a table may have: they are its first.
pub const MOST_SETTABLE: usize = 64;

/// What was set since the cold start, for retained memory: plain data, every bit pattern is one.
#[derive(Debug, Clone, Copy, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Changed {
    /// One bit a row.
    rows: u64,
    values: [f64; MOST_SETTABLE],
}

impl Default for Changed {
    fn default() -> Self {
        Self { rows: 0, values: [0.0; MOST_SETTABLE] }
    }
}

/// A function's table, and what was set of it.
#[derive(Debug)]
pub struct Parameters<S: 'static> {
    from: u8,
    rows: &'static [Row<S>],
    changed: Changed,
}

/// What a function answers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Answer {
    acknowledge: Option<Acknowledge>,
    value: ParameterValue,
    /// The settings are others now.
    pub changed: bool,
}

impl Answer {
    /// For the way to the ground, in this order.
    pub fn messages(&self) -> impl Iterator<Item = TelemetryMessage> {
        let acknowledge = self.acknowledge.map(Telemetry::Acknowledge);
        let value = Telemetry::Parameter(self.value);
        acknowledge.into_iter().chain([value]).map(|telemetry| TelemetryMessage::of(&telemetry))
    }
}

impl<S> Parameters<S> {
    /// The table of function `from` (a `FROM_…` constant). Settable rows come first, at most [`MOST_SETTABLE`]; others behind
    /// are read only.
    pub fn new(from: u8, rows: &'static [Row<S>]) -> Self {
        Self { from, rows, changed: Changed::default() }
    }

    /// What outlives a warm restart.
    pub fn changed(&self) -> &Changed {
        &self.changed
    }

    /// Sets again what was set before a warm restart; what the table does not allow is forgotten.
    pub fn resume(&mut self, changed: &Changed, settings: &mut S) {
        self.changed = Changed::default();
        for (place, row) in self.rows.iter().enumerate().take(MOST_SETTABLE) {
            let value = changed.values[place];
            if changed.rows & (1 << place) != 0 && row.try_set(settings, value).is_ok() {
                self.note(place, value);
            }
        }
    }

    /// Carries out an order about parameters; nothing where the message is none.
    pub fn take(&mut self, message: &GroundMessage, settings: &mut S, time_ns: u64) -> Option<Answer> {
        match Order::parse(message.letter, message.bytes()) {
            Ok(Order::ReadParameter { index, asker, .. }) => {
                let place = self.present(settings).nth(usize::from(index)).map(|(place, _)| place);
                let value = match place {
                    Some(place) => self.value(place, settings),
                    None => ParameterValue { index, ..self.nothing(settings) },
                };
                let value = ParameterValue { time_ns, asker, ..value };
                Some(Answer { acknowledge: None, value, changed: false })
            }
            Ok(Order::SetParameter(setting)) => Some(self.set(message, &setting, settings, time_ns)),
            _ => None,
        }
    }

    fn set(
        &mut self,
        message: &GroundMessage,
        setting: &ParameterSetting,
        settings: &mut S,
        time_ns: u64,
    ) -> Answer {
        let named = |(_, row): &(usize, &Row<S>)| row.name.as_bytes() == name_text(&setting.name).as_bytes();
        let place = self.present(settings).find(named).map(|(place, _)| place);
        let result = match place {
            None => Err(Refusal::NoSuchParameter),
            Some(place) => self.rows[place].try_set(settings, setting.value).map(|()| place),
        };
        if let Ok(place) = result {
            self.note(place, setting.value);
        }
        let value = match place {
            Some(place) => self.value(place, settings),
            None => ParameterValue { index: u16::MAX, name: setting.name, ..self.nothing(settings) },
        };
        let reason = result.err().map_or(0, |refusal| refusal as u32);
        let value = ParameterValue { time_ns, asker: setting.asker, reason, ..value };
        let acknowledge = match result {
            Ok(_) => Acknowledge::of(message, self.from, ACCEPTED, time_ns),
            Err(refusal) => Acknowledge::refused(message, self.from, refusal, time_ns),
        };
        Answer { acknowledge: Some(acknowledge), value, changed: result.is_ok() }
    }

    fn note(&mut self, place: usize, value: f64) {
        if let Some(kept) = self.changed.values.get_mut(place) {
            *kept = value;
            self.changed.rows |= 1 << place;
        }
    }

    /// The rows that this function has a value for.
    fn present<'a>(&'a self, settings: &'a S) -> impl Iterator<Item = (usize, &'static Row<S>)> + 'a {
        self.rows.iter().enumerate().filter(|(_, row)| (row.get)(settings).is_some())
    }

    fn nothing(&self, settings: &S) -> ParameterValue {
        let count = self.present(settings).count() as u16; // tables are short
        ParameterValue { count, from: self.from, ..ParameterValue::default() }
    }

    fn value(&self, place: usize, settings: &S) -> ParameterValue {
        let row = &self.rows[place];
        let before = self.present(settings).take_while(|(other, _)| *other < place).count();
        let value = (row.get)(settings).unwrap_or_default();
        let (lowest, highest) = row.set.as_ref().map_or((value, value), |set| (set.lowest, set.highest));
        ParameterValue {
            value,
            lowest,
            highest,
            index: before as u16, // tables are short
            kind: row.kind as u8,
            settable: u8::from(row.set.is_some()),
            name: name_bytes(row.name),
            ..self.nothing(settings)
        }
    }
}

/// Parameters of a function that are on their way at once, most: half of what its queues hold.
const AT_ONCE: usize = 4;
/// How long a function may take to answer, ns of the asker's clock; then it is asked again.
const PATIENCE_NS: u64 = 500_000_000;
/// Times that a function is asked before it counts as silent.
const TRIES: u32 = 4;
/// More parameters than any function has: a count beyond is nonsense.
const MOST: usize = 512;

/// Asks functions for all their parameters, several functions at a time: one that is silent holds up nobody else, and one
/// that is restarted meanwhile is gone on with.
#[derive(Debug)]
pub struct Gatherer {
    asker: u8,
    tables: Vec<Table>,
}

/// What is known of one function.
#[derive(Debug)]
struct Table {
    of: u8,
    known: Vec<Option<ParameterValue>>,
    /// Heard in this round.
    fresh: Vec<bool>,
    counted: bool,
    asked_until_ns: Option<u64>,
    tries: u32,
    silent: bool,
    asking: bool,
}

impl Gatherer {
    /// For those functions (`FROM_…` constants), in this order; `asker` is one of the `ASKED_BY_…` constants.
    pub fn new(functions: impl IntoIterator<Item = u8>, asker: u8) -> Self {
        Self { asker, tables: functions.into_iter().map(Table::new).collect() }
    }

    /// Begins to ask; what is known stays until it is heard anew.
    pub fn begin(&mut self) {
        self.tables.iter_mut().for_each(Table::begin);
    }

    /// Everything has been heard, or given up.
    pub fn is_done(&self) -> bool {
        self.tables.iter().all(|table| !table.asking)
    }

    /// Questions that are due now.
    pub fn due(&mut self, now_ns: u64) -> Vec<Order> {
        let asker = self.asker;
        let questions = self.tables.iter_mut().flat_map(|table| table.due(now_ns));
        questions.map(|(of, index)| Order::ReadParameter { of, index, asker }).collect()
    }

    /// Takes what a function says of one of its parameters, whoever asked.
    pub fn take(&mut self, value: &ParameterValue) {
        if let Some(table) = self.tables.iter_mut().find(|table| table.of == value.from) {
            table.take(value);
        }
    }

    /// Takes an answer: a function that does not know the question has no parameters.
    pub fn answered(&mut self, answer: &Acknowledge) {
        let question = Order::ReadParameter { of: 0, index: 0, asker: 0 }.letter();
        if answer.letter == question && answer.result == NOT_UNDERSTOOD {
            for table in self.tables.iter_mut().filter(|table| table.of == answer.first) {
                (table.counted, table.asking) = (true, false);
            }
        }
    }

    /// All that is known, function by function.
    pub fn known(&self) -> impl Iterator<Item = &ParameterValue> {
        self.tables.iter().flat_map(|table| table.known.iter().flatten())
    }

    /// Functions that did not answer in this round.
    pub fn silent(&self) -> impl Iterator<Item = u8> {
        self.tables.iter().filter(|table| table.silent).map(|table| table.of)
    }
}

impl Table {
    fn new(of: u8) -> Self {
        Self {
            of,
            known: Vec::new(),
            fresh: Vec::new(),
            counted: false,
            asked_until_ns: None,
            tries: 0,
            silent: false,
            asking: false,
        }
    }

    fn begin(&mut self) {
        self.fresh.iter_mut().for_each(|fresh| *fresh = false);
        (self.counted, self.asked_until_ns, self.tries) = (false, None, 0);
        (self.silent, self.asking) = (false, true);
    }

    fn due(&mut self, now_ns: u64) -> Vec<(u8, u16)> {
        if !self.asking {
            return Vec::new();
        }
        if let Some(until_ns) = self.asked_until_ns {
            if now_ns < until_ns {
                return Vec::new();
            }
            self.tries += 1;
            if self.tries >= TRIES {
                (self.silent, self.asking) = (true, false);
                return Vec::new();
            }
        }
        self.asked_until_ns = Some(now_ns.saturating_add(PATIENCE_NS));
        if !self.counted {
            return vec![(self.of, 0)]; // the answer says how many there are
        }
        let missing = self.fresh.iter().zip(0_u16..).filter(|(fresh, _)| !**fresh);
        missing.take(AT_ONCE).map(|(_, index)| (self.of, index)).collect()
    }

    fn take(&mut self, value: &ParameterValue) {
        let count = usize::from(value.count).min(MOST);
        self.known.resize(count, None);
        self.fresh.resize(count, false);
        let index = usize::from(value.index);
        if let Some(place) = self.known.get_mut(index) {
            (*place, self.fresh[index]) = (Some(*value), true);
        }
        if !self.asking {
            return;
        }
        (self.counted, self.tries) = (true, 0);
        let asked = self.fresh.iter().filter(|fresh| **fresh).count();
        if asked == count {
            (self.asking, self.asked_until_ns) = (false, None);
        } else if index == 0 || asked.is_multiple_of(AT_ONCE) {
            self.asked_until_ns = None; // the next ones may go
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Frame;
    use crate::telemetry::{FROM_CONTROLLER, FROM_IMU};

    #[derive(Debug, Clone, Copy, PartialEq)]
    struct Settings {
        gain: f64,
        laps: f64,
        mass: Option<f64>,
    }

    static ROWS: [Row<Settings>; 3] = [
        Row::settable(
            "CTL_GAIN",
            Kind::Real,
            (0.0, 5.0),
            |s| Some(s.gain),
            |s, value| {
                s.gain = value;
                value != 4.0
            },
        ),
        Row::settable(
            "CTL_LAPS",
            Kind::Whole,
            (0.0, 100.0),
            |s| Some(s.laps),
            |s, value| {
                s.laps = value;
                true
            },
        ),
        Row::fixed("CTL_MASS", Kind::Real, |s| s.mass),
    ];

    fn settings() -> Settings {
        Settings { gain: 1.0, laps: 2.0, mass: Some(13.5) }
    }

    fn message(order: Order) -> GroundMessage {
        GroundMessage::from_frame(&Frame { letter: order.letter(), data: order.data() }).unwrap()
    }

    fn set(name: &str, value: f64) -> GroundMessage {
        let setting = ParameterSetting { of: FROM_CONTROLLER, asker: 1, name: name_bytes(name), value };
        message(Order::SetParameter(setting))
    }

    fn read(index: u16) -> GroundMessage {
        message(Order::ReadParameter { of: FROM_CONTROLLER, index, asker: 1 })
    }

    #[test]
    fn every_parameter_is_read_by_its_place_and_beyond_the_last_is_nothing() {
        let (mut settings, mut table) = (settings(), Parameters::new(FROM_CONTROLLER, &ROWS));
        let mut told = |index| table.take(&read(index), &mut settings, 7).unwrap().value;
        assert_eq!((told(0).name(), told(0).value, told(0).count), ("CTL_GAIN", 1.0, 3));
        assert_eq!((told(2).name(), told(2).settable, told(2).asker), ("CTL_MASS", 0, 1));
        assert_eq!((told(3).name(), told(3).count, told(3).index), ("", 3, 3));
    }

    #[test]
    fn what_this_aircraft_does_not_have_is_not_listed() {
        let mut settings = Settings { mass: None, ..settings() };
        let mut table = Parameters::new(FROM_CONTROLLER, &ROWS);
        assert_eq!(table.take(&read(0), &mut settings, 7).unwrap().value.count, 2);
    }

    #[test]
    fn bad_setting_is_refused_with_its_reason_and_the_value_that_stands() {
        let (mut settings, mut table) = (settings(), Parameters::new(FROM_CONTROLLER, &ROWS));
        for (name, value, why, stands) in [
            ("CTL_GAIN", 9.0, Refusal::OutOfRange, 1.0),
            ("CTL_GAIN", f64::INFINITY, Refusal::OutOfRange, 1.0),
            ("CTL_LAPS", 1.5, Refusal::NotWhole, 2.0),
            ("CTL_MASS", 1.0, Refusal::BelongsToPlan, 13.5),
            ("CTL_MSS", 1.0, Refusal::NoSuchParameter, 0.0),
        ] {
            let answer = table.take(&set(name, value), &mut settings, 7).unwrap();
            assert_eq!((answer.value.refusal(), answer.value.value), (Some(why), stands), "{name}");
            assert!(!answer.changed && answer.messages().count() == 2);
        }
        assert_eq!(table.changed(), &Changed::default());
    }

    #[test]
    fn what_was_set_is_set_again_after_a_warm_restart_and_noise_is_forgotten() {
        let (mut before, mut table) = (settings(), Parameters::new(FROM_CONTROLLER, &ROWS));
        assert!(table.take(&set("CTL_LAPS", 5.0), &mut before, 7).unwrap().changed);
        let (mut after, mut next) = (settings(), Parameters::new(FROM_CONTROLLER, &ROWS));
        next.resume(table.changed(), &mut after);
        assert_eq!(after, Settings { laps: 5.0, ..settings() });
        for byte in [0x7f, 0xff] {
            let noise = Changed::read_from_bytes(&[byte; size_of::<Changed>()]).unwrap();
            next.resume(&noise, &mut after);
            assert_eq!(next.changed(), &Changed::default());
        }
    }

    #[test]
    fn order_about_something_else_is_none_of_the_table() {
        let mut table = Parameters::new(FROM_CONTROLLER, &ROWS);
        assert_eq!(table.take(&message(Order::Hil { on: true }), &mut settings(), 7), None);
    }

    /// Asks two functions in steps of 20 ms, of which one answers as `heard` says; gives the steps that it took.
    fn gather(gatherer: &mut Gatherer, mut heard: impl FnMut(u64, u8) -> bool) -> u64 {
        let (mut settings, mut table) = (settings(), Parameters::new(FROM_CONTROLLER, &ROWS));
        gatherer.begin();
        for step in 0..1_000 {
            for order in gatherer.due(step * 20_000_000) {
                let Order::ReadParameter { of, .. } = order else { panic!("{order:?}") };
                let answer = table.take(&message(order), &mut settings, 0).unwrap().value;
                if heard(step, of) {
                    gatherer.take(&ParameterValue { from: of, ..answer });
                }
            }
            if gatherer.is_done() {
                return step;
            }
        }
        panic!("it never ends");
    }

    #[test]
    fn silent_function_holds_up_nobody_and_is_named() {
        let mut gatherer = Gatherer::new([FROM_IMU, FROM_CONTROLLER], ASKED_BY_COMMAND);
        let steps = gather(&mut gatherer, |_, of| of == FROM_CONTROLLER);
        assert!((50..=120).contains(&steps), "{steps}");
        assert_eq!(gatherer.known().count(), 3);
        assert_eq!(gatherer.silent().collect::<Vec<_>>(), [FROM_IMU]);
        assert!(gather(&mut gatherer, |_, _| true) < 10);
        assert_eq!((gatherer.known().count(), gatherer.silent().count()), (6, 0));
    }

    #[test]
    fn function_that_is_restarted_meanwhile_is_gone_on_with() {
        let mut gatherer = Gatherer::new([FROM_IMU, FROM_CONTROLLER], ASKED_BY_COMMAND);
        gather(&mut gatherer, |step, of| of == FROM_CONTROLLER || !(1..40).contains(&step));
        assert_eq!((gatherer.known().count(), gatherer.silent().count()), (6, 0));
    }

    #[test]
    fn function_that_does_not_know_the_question_has_no_parameters() {
        let mut gatherer = Gatherer::new([FROM_IMU], ASKED_BY_COMMAND);
        gatherer.begin();
        let question = message(gatherer.due(0)[0]);
        let question = GroundMessage {
            data: {
                let mut data = question.data;
                data[0] = FROM_IMU;
                data
            },
            ..question
        };
        gatherer.answered(&Acknowledge::of(&question, FROM_IMU, NOT_UNDERSTOOD, 1));
        assert!(gatherer.is_done() && gatherer.silent().count() == 0);
    }
}
