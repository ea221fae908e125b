//! The parameter protocol: what the functions have, by name, under one count.
//!
//! A list is gathered from the functions when a ground station asks for it, and told when all have answered or are given up; a
//! single one is read and set at its function. Nothing is asked of the functions before that. A place in the list belongs to its
//! parameter for as long as this lives: one that is found later stands behind the others.

use std::collections::VecDeque;
use std::ops::Range;

use bateleur_mavlink::common::{
    MavMessage, MavParamError, MavParamType, MavSeverity, PARAM_ERROR_DATA, PARAM_REQUEST_READ_DATA,
    PARAM_SET_DATA, PARAM_VALUE_DATA,
};
use bateleur_messages::ground::{Name, Order, ParameterSetting};
use bateleur_messages::parameter::{ASKED_BY_COMMAND, Gatherer, Kind, ParameterValue, name_text};
use bateleur_messages::telemetry::{Acknowledge, Refusal, function_name};

use super::{Out, Peer};

/// Parameters told in one window, most.
const A_WINDOW: usize = 4;
/// Messages that may wait for the line while a list is told: a slow line keeps room for telemetry.
const ROOM: usize = 16;
/// Questions that wait at most; the ground station asks again.
const QUESTIONS: usize = 32;
/// Questions that are at the functions at once: half of what a queue holds.
const AT_ONCE: usize = 4;
/// How long a function may take to answer one, module time, ns, and how often it is asked.
const PATIENCE_NS: u64 = 400_000_000;
const TRIES: u32 = 4;
/// Numbers of single questions begin behind those of [`bateleur_messages::parameter`].
const FIRST_NUMBER: u8 = 16;

/// How whole numbers stand in the `float` of PARAM_VALUE and PARAM_SET.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[repr(u8)]
pub enum Encoding {
    /// Their bits: what the protocol recommends, and what QGroundControl reads of an autopilot that it does not know.
    #[default]
    Bytes = 0,
    /// Their value: what MAVProxy reads of such an autopilot.
    Cast = 1,
}

impl Encoding {
    /// The encoding of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "bytes" => Some(Self::Bytes),
            "cast" => Some(Self::Cast),
            _ => None,
        }
    }

    fn encode(self, kind: Kind, value: f64) -> f32 {
        match (kind, self) {
            (Kind::Real, _) | (_, Self::Cast) => value as f32,
            (Kind::Whole, Self::Bytes) => f32::from_bits(value as i32 as u32),
            (Kind::Choice, Self::Bytes) => f32::from_bits(u32::from(value as u8)),
        }
    }

    /// The number that a ground station meant. A type may have no room in four bytes; and bytes beyond those of a short one show
    /// that it was sent by its value, of which the first bytes are another number.
    pub(super) fn decode(self, value: f32, kind: MavParamType) -> Result<f64, MavParamError> {
        use MavParamType as T;
        let bits = value.to_bits();
        let whole = match kind {
            T::MAV_PARAM_TYPE_REAL32 => return Ok(shortest(value)),
            T::MAV_PARAM_TYPE_UINT8 => f64::from(bits as u8),
            T::MAV_PARAM_TYPE_INT8 => f64::from(bits as u8 as i8),
            T::MAV_PARAM_TYPE_UINT16 => f64::from(bits as u16),
            T::MAV_PARAM_TYPE_INT16 => f64::from(bits as u16 as i16),
            T::MAV_PARAM_TYPE_UINT32 => f64::from(bits),
            T::MAV_PARAM_TYPE_INT32 => f64::from(bits as i32),
            _ => return Err(MavParamError::MAV_PARAM_ERROR_TYPE_UNSUPPORTED),
        };
        let room = match kind {
            T::MAV_PARAM_TYPE_UINT8 | T::MAV_PARAM_TYPE_INT8 => Some(8),
            T::MAV_PARAM_TYPE_UINT16 | T::MAV_PARAM_TYPE_INT16 => Some(16),
            _ => None,
        };
        // A negative one may come with its sign carried on.
        let carried_on = whole == f64::from(bits as i32);
        let is_short = room.is_none_or(|room| bits >> room == 0 || carried_on);
        match self {
            Self::Cast => Ok(shortest(value)),
            Self::Bytes if is_short => Ok(whole),
            Self::Bytes => Err(MavParamError::MAV_PARAM_ERROR_TYPE_MISMATCH),
        }
    }
}

/// The number that a person would write for it: 0.4, not 0.4000000059604645.
fn shortest(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::from(value))
}

/// Which one.
#[derive(Debug, Clone, Copy)]
enum Which {
    Place(usize),
    Name(Name),
}

/// What a ground station wants of one parameter.
#[derive(Debug, Clone, Copy)]
struct Question {
    peer: Peer,
    which: Which,
    /// To set it; `None`: to read it.
    value: Option<f64>,
    /// All functions have been asked for it.
    searched: bool,
}

/// A question that is at its function.
#[derive(Debug)]
struct Asked {
    number: u8,
    order: Order,
    place: usize,
    peer: Peer,
    until_ns: u64,
    tries: u32,
}

/// See the module.
#[derive(Debug)]
pub(super) struct Parameters {
    gatherer: Gatherer,
    encoding: Encoding,
    /// Function and name by place.
    places: Vec<(u8, Name)>,
    listing: bool,
    /// Those that are still to be told of a list.
    telling: Range<usize>,
    questions: VecDeque<Question>,
    asked: Vec<Asked>,
    number: u8,
}

impl Parameters {
    pub(super) fn new(functions: u16, encoding: Encoding) -> Self {
        let functions = (0..16).filter(|function| functions & (1 << function) != 0);
        Self {
            gatherer: Gatherer::new(functions, ASKED_BY_COMMAND),
            encoding,
            places: Vec::new(),
            listing: false,
            telling: 0..0,
            questions: VecDeque::new(),
            asked: Vec::new(),
            number: FIRST_NUMBER,
        }
    }

    pub(super) fn list(&mut self) {
        if !self.listing {
            (self.listing, self.telling) = (true, 0..0);
            self.gather();
        }
    }

    pub(super) fn read(&mut self, message: &PARAM_REQUEST_READ_DATA, peer: Peer) {
        let which = match usize::try_from(message.param_index) {
            Ok(place) => Which::Place(place),
            Err(_) => Which::Name(*message.param_id),
        };
        self.question(Question { peer, which, value: None, searched: false });
    }

    pub(super) fn set(&mut self, message: &PARAM_SET_DATA, peer: Peer, out: &mut Out) {
        match self.encoding.decode(message.param_value, message.param_type) {
            Ok(value) => {
                let which = Which::Name(*message.param_id);
                self.question(Question { peer, which, value: Some(value), searched: false });
            }
            Err(error) => {
                if error == MavParamError::MAV_PARAM_ERROR_TYPE_MISMATCH {
                    let name = name_text(&message.param_id);
                    let text = format!("{name}: sent by value? see parameter_encoding");
                    out.text(MavSeverity::MAV_SEVERITY_WARNING, &text);
                }
                refuse(&message.param_id, error, peer, out);
            }
        }
    }

    fn question(&mut self, question: Question) {
        if self.questions.len() < QUESTIONS {
            self.questions.push_back(question);
        }
    }

    /// A function's answer to an order.
    pub(super) fn answered(&mut self, answer: &Acknowledge) {
        self.gatherer.answered(answer);
    }

    /// What a function says of one of its parameters, whoever asked.
    pub(super) fn told(&mut self, value: &ParameterValue, out: &mut Out) {
        self.gatherer.take(value);
        let Some(place) = self.asked.iter().position(|asked| asked.number == value.asker) else { return };
        let asked = self.asked.swap_remove(place);
        if let Some(refusal) = value.refusal() {
            let name = name_text(&value.name);
            let why = match refusal {
                Refusal::OutOfRange => format!("{} to {}", value.lowest, value.highest),
                other => other.text().to_owned(),
            };
            out.text(MavSeverity::MAV_SEVERITY_WARNING, &format!("{name}: {why}"));
            refuse(&value.name, error_of(refusal), asked.peer, out);
        }
        if !value.name().is_empty() && value.refusal() != Some(Refusal::NoSuchParameter) {
            self.say(asked.place, value, out);
        }
    }

    pub(super) fn window(&mut self, now_ns: u64, out: &mut Out) {
        out.orders.extend(self.gatherer.due(now_ns));
        if self.gatherer.is_done() {
            self.enlist();
            if std::mem::take(&mut self.listing) {
                self.name_the_silent(out);
                self.telling = 0..self.places.len();
            }
        }
        self.send_questions(now_ns, out);
        self.ask_again(now_ns, out);
        for _ in 0..A_WINDOW {
            if out.messages.len() >= ROOM {
                return;
            }
            let Some(place) = self.telling.next() else { return };
            if let Some(value) = self.known(place).copied() {
                self.say(place, &value, out);
            }
        }
    }

    fn gather(&mut self) {
        if self.gatherer.is_done() {
            self.gatherer.begin();
        }
    }

    /// Gives what was found a place.
    fn enlist(&mut self) {
        for value in self.gatherer.known() {
            let one = (value.from, value.name);
            if !self.places.contains(&one) {
                self.places.push(one);
            }
        }
    }

    fn name_the_silent(&self, out: &mut Out) {
        for name in self.gatherer.silent().filter_map(function_name) {
            let text = format!("{name} does not answer: its parameters are missing, or as it told them last");
            out.text(MavSeverity::MAV_SEVERITY_WARNING, &text);
        }
    }

    fn known(&self, place: usize) -> Option<&ParameterValue> {
        let (from, name) = self.places.get(place)?;
        self.gatherer.known().find(|value| value.from == *from && value.name == *name)
    }

    fn place(&self, which: &Which) -> Option<usize> {
        match which {
            Which::Place(place) => Some(*place).filter(|place| *place < self.places.len()),
            Which::Name(name) => {
                self.places.iter().position(|(_, known)| name_text(known) == name_text(name))
            }
        }
    }

    /// Sends on what ground stations want of single ones, in their order.
    fn send_questions(&mut self, now_ns: u64, out: &mut Out) {
        while self.asked.len() < AT_ONCE {
            let Some(question) = self.questions.pop_front() else { return };
            let known = self.place(&question.which).and_then(|place| Some((place, *self.known(place)?)));
            match known {
                Some((place, value)) => {
                    self.number = self.number.checked_add(1).unwrap_or(FIRST_NUMBER);
                    let (of, asker) = (value.from, self.number);
                    let order = match question.value {
                        None => Order::ReadParameter { of, index: value.index, asker },
                        Some(wanted) => Order::SetParameter(ParameterSetting {
                            of,
                            asker,
                            name: value.name,
                            value: wanted,
                        }),
                    };
                    out.orders.push(order);
                    let until_ns = now_ns.saturating_add(PATIENCE_NS);
                    let peer = question.peer;
                    self.asked.push(Asked { number: asker, order, place, peer, until_ns, tries: 1 });
                }
                None if !question.searched || !self.gatherer.is_done() => {
                    self.questions.push_front(Question { searched: true, ..question });
                    return self.gather();
                }
                None => {
                    let id = match question.which {
                        Which::Place(_) => Name::default(),
                        Which::Name(name) => name,
                    };
                    refuse(&id, MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST, question.peer, out);
                }
            }
        }
    }

    fn ask_again(&mut self, now_ns: u64, out: &mut Out) {
        let places = &self.places;
        self.asked.retain_mut(|asked| {
            if now_ns < asked.until_ns {
                return true;
            }
            if asked.tries < TRIES {
                (asked.tries, asked.until_ns) = (asked.tries + 1, now_ns.saturating_add(PATIENCE_NS));
                out.orders.push(asked.order);
                return true;
            }
            if let Some((from, name)) = places.get(asked.place) {
                let function = function_name(*from).unwrap_or("a function");
                let text = format!("{}: {function} does not answer", name_text(name));
                out.text(MavSeverity::MAV_SEVERITY_WARNING, &text);
                refuse(name, MavParamError::MAV_PARAM_ERROR_READ_FAIL, asked.peer, out);
            }
            false
        });
    }

    fn say(&self, place: usize, value: &ParameterValue, out: &mut Out) {
        let kind = Kind::from_number(value.kind);
        let mut message = PARAM_VALUE_DATA {
            param_value: self.encoding.encode(kind, value.value),
            param_count: self.places.len() as u16, // functions have few
            param_index: place as u16,             // as above
            param_type: match kind {
                Kind::Real => MavParamType::MAV_PARAM_TYPE_REAL32,
                Kind::Whole => MavParamType::MAV_PARAM_TYPE_INT32,
                Kind::Choice => MavParamType::MAV_PARAM_TYPE_UINT8,
            },
            ..PARAM_VALUE_DATA::DEFAULT
        };
        message.param_id = value.name.into();
        out.say(&MavMessage::PARAM_VALUE(message));
    }
}

fn error_of(refusal: Refusal) -> MavParamError {
    match refusal {
        Refusal::BelongsToPlan => MavParamError::MAV_PARAM_ERROR_READ_ONLY,
        Refusal::OutOfRange => MavParamError::MAV_PARAM_ERROR_VALUE_OUT_OF_RANGE,
        Refusal::NotWhole => MavParamError::MAV_PARAM_ERROR_TYPE_MISMATCH,
        Refusal::NoSuchParameter => MavParamError::MAV_PARAM_ERROR_DOES_NOT_EXIST,
        _ => MavParamError::MAV_PARAM_ERROR_PERMISSION_DENIED,
    }
}

fn refuse(id: &Name, error: MavParamError, peer: Peer, out: &mut Out) {
    out.say(&MavMessage::PARAM_ERROR(PARAM_ERROR_DATA {
        param_index: -1,
        target_system: peer.0,
        target_component: peer.1,
        param_id: (*id).into(),
        error,
    }));
}
