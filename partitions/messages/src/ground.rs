//! From the ground to the aircraft.

use std::ops::RangeInclusive;

use crate::frame::Frame;
use crate::mark::Mark;
use crate::{FunctionStatus, GroundMessage};

/// Bytes of data that a ground message can hold.
pub const GROUND_DATA: usize = 62;

impl GroundMessage {
    /// The message for a frame from the serial line; nothing where its data is too long for any ground message.
    pub fn from_frame(frame: &Frame) -> Option<Self> {
        let mut message =
            Self { letter: frame.letter, length: u8::try_from(frame.data.len()).ok()?, ..Self::default() };
        message.data.get_mut(..frame.data.len())?.copy_from_slice(&frame.data);
        Some(message)
    }

    /// The data in use.
    pub fn bytes(&self) -> &[u8] {
        &self.data[..usize::from(self.length).min(GROUND_DATA)]
    }
}

const _: () = assert!(size_of::<GroundMessage>() == 64 && size_of::<FunctionStatus>() == 32);

/// What the ground can ask for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Order {
    /// `HH`: hardware-in-the-loop mode on or off (HILInterface).
    Hil {
        /// On.
        on: bool,
    },
    /// `AA`: the autopilot flies, or the safety pilot (Controller, Servo).
    Autopilot {
        /// On.
        on: bool,
    },
    /// `NN`: way-point navigation on or off (Controller).
    Navigation {
        /// On.
        on: bool,
    },
    /// `WW`: one way-point of the list (Controller).
    Waypoint(Waypoint),
    /// `LL`: one loop of the Controller on or off, with its target.
    Loop {
        /// Which loop; see [`LoopId`].
        id: LoopId,
        /// On.
        on: bool,
        /// Target in the loop's unit.
        target: f64,
    },
    /// `II`: take the bias of sensors anew (IMU); one bit a sensor, see the `SENSOR_…` constants.
    InitialiseSensors {
        /// The sensors.
        sensors: u8,
    },
    /// `EE`: initialise, enable or disable (Estimator).
    Estimator(EstimatorOrder),
    /// `FF`: something to be flown in place of what was ordered before (Controller).
    Manoeuvre {
        /// What.
        what: Manoeuvre,
        /// Why.
        reason: Reason,
    },
    /// `JJ`: flies to this entry of the list next (Controller).
    GoOnWith {
        /// Its position, from 0.
        index: u8,
    },
    /// `GG`: one place of the fence's areas (Controller).
    Fence(Mark),
    /// `PP`: one rally point (Controller).
    Rally(Mark),
    /// `RR`: says what stands at a place of a function's list of parameters.
    ReadParameter {
        /// The function: a `FROM_…` constant of [`crate::telemetry`].
        of: u8,
        /// The place, from 0.
        index: u16,
        /// Who asks: an `ASKED_BY_…` constant of [`crate::parameter`].
        asker: u8,
    },
    /// `YY`: sets a parameter of a function.
    SetParameter(ParameterSetting),
}

/// Bytes of a parameter's name.
pub const NAME: usize = 16;
/// A parameter's name, zeros behind.
pub type Name = [u8; NAME];

/// A parameter that is to be set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ParameterSetting {
    /// The function: a `FROM_…` constant of [`crate::telemetry`].
    pub of: u8,
    /// Who asks: an `ASKED_BY_…` constant of [`crate::parameter`].
    pub asker: u8,
    /// Its name.
    pub name: Name,
    /// The value.
    pub value: f64,
}

/// What the ground can have flown with one order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Manoeuvre {
    /// What was ordered before: the mission, or the loops.
    GoOn = 0,
    /// Take off, as soon as the autopilot is on.
    TakeOff = 1,
    /// Circle here.
    Loiter = 2,
    /// Fly to the runway and circle above it.
    Return = 3,
    /// Stop a take-off, as long as the wheels are on the ground; fly a landing round once more, as long as they are not.
    Abort = 4,
    /// Land on the runway.
    Land = 5,
}

impl Manoeuvre {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 6] =
        [Self::GoOn, Self::TakeOff, Self::Loiter, Self::Return, Self::Abort, Self::Land];

    /// The name that a person types.
    pub fn name(self) -> &'static str {
        match self {
            Self::GoOn => "go_on",
            Self::TakeOff => "take_off",
            Self::Loiter => "loiter",
            Self::Return => "return",
            Self::Abort => "abort",
            Self::Land => "land",
        }
    }
}

/// Why something is flown in place of what was ordered before. The ground itself gives the first alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Reason {
    /// The ground asks for it.
    Ordered = 0,
    /// Command does, because the ground is silent.
    LostLink = 1,
    /// Command does, because something is lost that the plan names.
    Contingency = 2,
}

impl Reason {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 3] = [Self::Ordered, Self::LostLink, Self::Contingency];
}

/// A ground station that has nothing to say says this, once a second or so, where the plan asks for a link that is not lost:
/// letter of a frame without data, which Command takes and nobody answers.
pub const BEAT: u8 = b'B';

/// What the ground can ask of the Estimator.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum EstimatorOrder {
    /// Stop estimating.
    Disable,
    /// Go on.
    Enable,
    /// Begin anew.
    Initialise {
        /// With attitude from the inertial sensors (full inertial estimation), or from aiding alone.
        full_inertial: bool,
    },
}

/// One way-point as the ground sends it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Waypoint {
    /// Position in the list, from 0.
    pub index: u8,
    /// Way-points in the whole list.
    pub count: u8,
    /// North of the runway, m.
    pub north_m: f64,
    /// East of the runway, m.
    pub east_m: f64,
    /// Above the runway, m.
    pub altitude_m: f64,
    /// Heading of the seed's table, rad; kept as data.
    pub heading_rad: f64,
    /// Airspeed, m/s.
    pub airspeed_mps: f64,
    /// What is done there.
    pub step: Step,
}

/// What is done at a place of a list before it goes on to the next one.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Step {
    /// It is passed. A list of nothing else is a circuit, flown round for the laps; any other is flown once, in its order.
    #[default]
    Pass,
    /// Circles about it.
    Turns {
        /// So many.
        turns: f64,
        /// Radius, m, negative to turn left; 0: the aircraft's choice.
        radius_m: f64,
    },
    /// Circles about it for a time.
    Time {
        /// s.
        seconds: f64,
        /// As above.
        radius_m: f64,
    },
    /// Circles about it until the altitude is reached.
    Altitude {
        /// As above.
        radius_m: f64,
    },
    /// Circles about it until the ground orders something else.
    Unlimited {
        /// As above.
        radius_m: f64,
    },
    /// A take-off, where the aircraft stands; passed over in flight. No place.
    TakeOff,
    /// Back to the runway, and a circle there. No place.
    Return,
    /// A landing, with the touch-down at this place.
    Land,
    /// Goes on with another entry. No place.
    Jump {
        /// Its position in the list.
        to: u8,
        /// So many times, then with the next one; 0: always.
        times: u16,
    },
}

impl Step {
    /// Longest circling, turns and s; radius at most, and least of one that is named, m.
    pub const MOST_TURNS: f64 = 1_000.0;
    /// See above.
    pub const LONGEST_S: f64 = 86_400.0;
    /// See above.
    pub const WIDEST_M: f64 = 10_000.0;
    /// See above.
    pub const NARROWEST_M: f64 = 10.0;

    /// Whether it has a place on the map.
    pub fn has_place(self) -> bool {
        !matches!(self, Self::TakeOff | Self::Return | Self::Jump { .. })
    }

    /// As numbers: which kind; turns, seconds, or the entry to go on with; radius, or times.
    pub fn to_numbers(self) -> [f64; 3] {
        match self {
            Self::Pass => [0.0; 3],
            Self::Turns { turns, radius_m } => [1.0, turns, radius_m],
            Self::Time { seconds, radius_m } => [2.0, seconds, radius_m],
            Self::Altitude { radius_m } => [3.0, 0.0, radius_m],
            Self::Unlimited { radius_m } => [4.0, 0.0, radius_m],
            Self::TakeOff => [5.0, 0.0, 0.0],
            Self::Return => [6.0, 0.0, 0.0],
            Self::Land => [7.0, 0.0, 0.0],
            Self::Jump { to, times } => [8.0, f64::from(to), f64::from(times)],
        }
    }

    /// The step again; `None` where the numbers are none, or outside of what can be flown.
    pub fn from_numbers([kind, amount, second]: [f64; 3]) -> Option<Self> {
        let radius_m = second;
        let turns = radius_m == 0.0 || (Self::NARROWEST_M..=Self::WIDEST_M).contains(&radius_m.abs());
        let whole = |value: f64, most: u16| {
            ((0.0..=f64::from(most)).contains(&value) && value.fract() == 0.0).then_some(value as u16)
        };
        Some(match kind {
            0.0 => Self::Pass,
            1.0 if turns && (0.0..=Self::MOST_TURNS).contains(&amount) => {
                Self::Turns { turns: amount, radius_m }
            }
            2.0 if turns && (0.0..=Self::LONGEST_S).contains(&amount) => {
                Self::Time { seconds: amount, radius_m }
            }
            3.0 if turns => Self::Altitude { radius_m },
            4.0 if turns => Self::Unlimited { radius_m },
            5.0 => Self::TakeOff,
            6.0 => Self::Return,
            7.0 => Self::Land,
            8.0 => {
                Self::Jump { to: whole(amount, u16::from(u8::MAX))? as u8, times: whole(second, u16::MAX)? }
            }
            _ => return None,
        })
    }
}

/// A loop that the ground can engage by itself, with its target's unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum LoopId {
    /// Roll angle, rad.
    RollAngle = 0,
    /// Roll rate, rad/s.
    RollRate = 1,
    /// Pitch rate, rad/s.
    PitchRate = 2,
    /// Airspeed, m/s.
    Airspeed = 3,
    /// Altitude above the runway, m.
    Altitude = 4,
    /// Climb rate, m/s.
    ClimbRate = 5,
    /// Heading over ground, rad.
    Heading = 6,
    /// Axial specific acceleration, m/s².
    Axial = 7,
    /// Lateral specific acceleration, m/s².
    Lateral = 8,
    /// Normal specific acceleration, m/s² (level flight: −9.81).
    Normal = 9,
}

impl LoopId {
    /// Every loop, in the order of its number.
    pub const ALL: [Self; 10] = [
        Self::RollAngle,
        Self::RollRate,
        Self::PitchRate,
        Self::Airspeed,
        Self::Altitude,
        Self::ClimbRate,
        Self::Heading,
        Self::Axial,
        Self::Lateral,
        Self::Normal,
    ];

    /// The name that a person types.
    pub fn name(self) -> &'static str {
        match self {
            Self::RollAngle => "roll_angle",
            Self::RollRate => "roll_rate",
            Self::PitchRate => "pitch_rate",
            Self::Airspeed => "airspeed",
            Self::Altitude => "altitude",
            Self::ClimbRate => "climb_rate",
            Self::Heading => "heading",
            Self::Axial => "axial",
            Self::Lateral => "lateral",
            Self::Normal => "normal",
        }
    }
}

/// [`Order::InitialiseSensors`]: the accelerometer.
pub const SENSOR_ACCELEROMETER: u8 = 1;
/// [`Order::InitialiseSensors`]: the gyroscope.
pub const SENSOR_GYROSCOPE: u8 = 2;
/// [`Order::InitialiseSensors`]: the pressure sensors.
pub const SENSOR_PRESSURE: u8 = 4;

/// Why a ground message was refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum OrderError {
    /// A letter that no function knows.
    #[error("no function knows a message \"{0}\"")]
    UnknownLetter(char),
    /// Data of the wrong length.
    #[error("message \"{0}\" has the wrong length")]
    WrongLength(char),
    /// A value outside what the message allows.
    #[error("message \"{0}\" holds a value outside its range")]
    OutOfRange(char),
}

impl Order {
    /// The letter on the line.
    pub fn letter(&self) -> u8 {
        match self {
            Self::Hil { .. } => b'H',
            Self::Autopilot { .. } => b'A',
            Self::Navigation { .. } => b'N',
            Self::Waypoint(_) => b'W',
            Self::Loop { .. } => b'L',
            Self::InitialiseSensors { .. } => b'I',
            Self::Estimator(_) => b'E',
            Self::Manoeuvre { .. } => b'F',
            Self::GoOnWith { .. } => b'J',
            Self::Fence(_) => b'G',
            Self::Rally(_) => b'P',
            Self::ReadParameter { .. } => b'R',
            Self::SetParameter(_) => b'Y',
        }
    }

    /// The data on the line, little endian.
    pub fn data(&self) -> Vec<u8> {
        match *self {
            Self::Hil { on } | Self::Autopilot { on } | Self::Navigation { on } => vec![u8::from(on)],
            Self::Waypoint(point) => point.data(),
            Self::Loop { id, on, target } => [&[id as u8, u8::from(on)][..], &target.to_le_bytes()].concat(),
            Self::InitialiseSensors { sensors } => vec![sensors],
            Self::Estimator(EstimatorOrder::Disable) => vec![0, 0],
            Self::Estimator(EstimatorOrder::Enable) => vec![1, 0],
            Self::Estimator(EstimatorOrder::Initialise { full_inertial }) => vec![2, u8::from(full_inertial)],
            Self::Manoeuvre { what, reason } => vec![what as u8, reason as u8],
            Self::GoOnWith { index } => vec![index],
            Self::Fence(mark) | Self::Rally(mark) => mark.data(),
            Self::ReadParameter { of, index, asker } => [&[of, asker][..], &index.to_le_bytes()].concat(),
            Self::SetParameter(ParameterSetting { of, asker, name, value }) => {
                [&[of, asker][..], &name, &value.to_le_bytes()].concat()
            }
        }
    }

    /// Reads an order from a frame's letter and data. Every number is checked: nothing that is not finite passes, but for a
    /// parameter's value, whose range the function knows.
    pub fn parse(letter: u8, data: &[u8]) -> Result<Self, OrderError> {
        match letter {
            b'H' => switch(letter, data).map(|on| Self::Hil { on }),
            b'A' => switch(letter, data).map(|on| Self::Autopilot { on }),
            b'N' => switch(letter, data).map(|on| Self::Navigation { on }),
            b'W' => Waypoint::parse(data).map(Self::Waypoint),
            b'L' => parse_loop(data),
            b'I' => parse_sensors(data),
            b'E' => parse_estimator(data),
            b'F' => parse_manoeuvre(data),
            b'J' => match *data {
                [index] => Ok(Self::GoOnWith { index }),
                _ => Err(OrderError::WrongLength('J')),
            },
            b'G' => Mark::parse(letter, false, data).map(Self::Fence),
            b'P' => Mark::parse(letter, true, data).map(Self::Rally),
            b'R' => match *data {
                [of, asker, low, high] => {
                    Ok(Self::ReadParameter { of, index: u16::from_le_bytes([low, high]), asker })
                }
                _ => Err(OrderError::WrongLength('R')),
            },
            b'Y' => parse_setting(data),
            _ => Err(OrderError::UnknownLetter(letter as char)),
        }
    }
}

impl Waypoint {
    /// Farthest from the runway, north or east, m: the plant's and the laws' flat ground reaches no further.
    pub const FARTHEST_M: f64 = 50_000.0;
    /// Highest, m.
    pub const HIGHEST_M: f64 = 10_000.0;
    /// Airspeeds that the Controller takes, m/s: it does not understand one with another.
    pub const AIRSPEEDS_MPS: RangeInclusive<f64> = 5.0..=100.0;
    /// Two in a row are at least so far apart on the map, m: a leg with no length has no direction to fly in, and its end counts
    /// as reached at once.
    pub const NEAREST_M: f64 = 5.0;

    /// How far another one is on the map, m.
    pub fn distance_m(&self, other: &Self) -> f64 {
        (other.north_m - self.north_m).hypot(other.east_m - self.east_m)
    }

    fn data(&self) -> Vec<u8> {
        let numbers = [self.north_m, self.east_m, self.altitude_m, self.heading_rad, self.airspeed_mps];
        let mut data = vec![self.index, self.count];
        numbers.iter().for_each(|number| data.extend(number.to_le_bytes()));
        if self.step != Step::Pass {
            let [kind, amount, second] = self.step.to_numbers();
            data.push(kind as u8); // 1 to 8
            [amount, second].iter().for_each(|number| data.extend(number.to_le_bytes()));
        }
        data
    }

    fn parse(data: &[u8]) -> Result<Self, OrderError> {
        let (place, step) = data.split_at_checked(PLACE_BYTES).unwrap_or((data, &[]));
        let numbers: [f64; 5] = finite(b'W', place.get(2..))?;
        let [north_m, east_m, altitude_m, heading_rad, airspeed_mps] = numbers;
        let step = match step.split_first() {
            None => Step::Pass,
            Some((kind, rest)) => {
                let [amount, second] = finite(b'W', Some(rest))?;
                let step = Step::from_numbers([f64::from(*kind), amount, second]);
                step.ok_or(OrderError::OutOfRange('W'))?
            }
        };
        let (index, count) = (data[0], data[1]);
        let is_near = |metres: f64| metres.abs() <= Self::FARTHEST_M;
        let is_there = is_near(north_m) && is_near(east_m) && (0.0..=Self::HIGHEST_M).contains(&altitude_m);
        if index >= count || airspeed_mps <= 0.0 || !is_there {
            return Err(OrderError::OutOfRange('W'));
        }
        Ok(Self { index, count, north_m, east_m, altitude_m, heading_rad, airspeed_mps, step })
    }
}

/// Bytes of a way-point that is passed: two, and five numbers. More say what is done there.
const PLACE_BYTES: usize = 42;

fn switch(letter: u8, data: &[u8]) -> Result<bool, OrderError> {
    match data {
        [0] => Ok(false),
        [1] => Ok(true),
        [_] => Err(OrderError::OutOfRange(letter as char)),
        _ => Err(OrderError::WrongLength(letter as char)),
    }
}

fn parse_loop(data: &[u8]) -> Result<Order, OrderError> {
    let [target] = finite(b'L', data.get(2..))?;
    let id = LoopId::ALL.get(usize::from(data[0])).copied().ok_or(OrderError::OutOfRange('L'))?;
    Ok(Order::Loop { id, on: switch(b'L', &data[1..2])?, target })
}

fn parse_sensors(data: &[u8]) -> Result<Order, OrderError> {
    match data {
        [sensors @ 1..=7] => Ok(Order::InitialiseSensors { sensors: *sensors }),
        [_] => Err(OrderError::OutOfRange('I')),
        _ => Err(OrderError::WrongLength('I')),
    }
}

fn parse_estimator(data: &[u8]) -> Result<Order, OrderError> {
    let order = match data {
        [0, 0] => EstimatorOrder::Disable,
        [1, 0] => EstimatorOrder::Enable,
        [2, full @ 0..=1] => EstimatorOrder::Initialise { full_inertial: *full == 1 },
        [_, _] => return Err(OrderError::OutOfRange('E')),
        _ => return Err(OrderError::WrongLength('E')),
    };
    Ok(Order::Estimator(order))
}

fn parse_manoeuvre(data: &[u8]) -> Result<Order, OrderError> {
    let [what, reason] = data else { return Err(OrderError::WrongLength('F')) };
    let what = Manoeuvre::ALL.get(usize::from(*what)).copied().ok_or(OrderError::OutOfRange('F'))?;
    let reason = Reason::ALL.get(usize::from(*reason)).copied().ok_or(OrderError::OutOfRange('F'))?;
    Ok(Order::Manoeuvre { what, reason })
}

fn parse_setting(data: &[u8]) -> Result<Order, OrderError> {
    // What is not finite passes: the table refuses it with its range.
    match data.split_first_chunk::<2>().map(|(head, rest)| (head, rest.split_first_chunk::<NAME>())) {
        Some((&[of, asker], Some((name, value)))) => {
            let value = value.try_into().map_err(|_| OrderError::WrongLength('Y'))?;
            let value = f64::from_le_bytes(value);
            Ok(Order::SetParameter(ParameterSetting { of, asker, name: *name, value }))
        }
        _ => Err(OrderError::WrongLength('Y')),
    }
}

pub(crate) fn finite<const N: usize>(letter: u8, data: Option<&[u8]>) -> Result<[f64; N], OrderError> {
    let data = data.filter(|data| data.len() == 8 * N).ok_or(OrderError::WrongLength(letter as char))?;
    let mut numbers = [0.0; N];
    for (number, bytes) in numbers.iter_mut().zip(data.as_chunks().0) {
        *number = f64::from_le_bytes(*bytes);
    }
    if numbers.iter().all(|number| number.is_finite()) {
        Ok(numbers)
    } else {
        Err(OrderError::OutOfRange(letter as char))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mark::MarkKind;
    use proptest::prelude::*;

    #[test]
    fn every_order_survives_the_line() {
        let point = Waypoint {
            index: 1,
            count: 4,
            north_m: 500.0,
            east_m: 0.0,
            altitude_m: 160.0,
            heading_rad: 0.0,
            airspeed_mps: 22.0,
            step: Step::Pass,
        };
        let corner = Mark {
            index: 2,
            count: 5,
            list: 200,
            kind: MarkKind::ExclusionCorner,
            north_m: -900.0,
            east_m: 70.5,
            size: 3.0,
        };
        let with = |step| Order::Waypoint(Waypoint { step, ..point });
        assert_eq!(Order::Waypoint(point).data().len(), PLACE_BYTES);
        let orders = [
            with(Step::Turns { turns: 2.5, radius_m: -80.0 }),
            with(Step::Time { seconds: 60.0, radius_m: 0.0 }),
            with(Step::Altitude { radius_m: 100.0 }),
            with(Step::Unlimited { radius_m: 0.0 }),
            with(Step::TakeOff),
            with(Step::Return),
            with(Step::Land),
            with(Step::Jump { to: 3, times: 0 }),
            Order::Hil { on: true },
            Order::Autopilot { on: false },
            Order::Navigation { on: true },
            Order::Waypoint(point),
            Order::Loop { id: LoopId::Normal, on: true, target: -9.81 },
            Order::InitialiseSensors { sensors: SENSOR_GYROSCOPE | SENSOR_PRESSURE },
            Order::Estimator(EstimatorOrder::Disable),
            Order::Estimator(EstimatorOrder::Enable),
            Order::Estimator(EstimatorOrder::Initialise { full_inertial: true }),
            Order::Manoeuvre { what: Manoeuvre::Return, reason: Reason::Ordered },
            Order::Manoeuvre { what: Manoeuvre::Loiter, reason: Reason::LostLink },
            Order::GoOnWith { index: 31 },
            Order::Fence(corner),
            Order::Fence(Mark::none(9, MarkKind::InclusionCorner)),
            Order::Rally(Mark { kind: MarkKind::Rally, size: 120.0, ..corner }),
            Order::ReadParameter { of: 4, index: 300, asker: 1 },
            Order::SetParameter(ParameterSetting {
                of: 4,
                asker: 0,
                name: *b"CTL_LAPS\0\0\0\0\0\0\0\0",
                value: 3.0,
            }),
        ];
        for order in orders {
            assert_eq!(Order::parse(order.letter(), &order.data()), Ok(order));
        }
    }

    #[test]
    fn a_way_point_that_is_not_a_number_is_refused() {
        let mut data = vec![0, 1];
        (0..5).for_each(|_| data.extend(f64::NAN.to_le_bytes()));
        assert_eq!(Order::parse(b'W', &data), Err(OrderError::OutOfRange('W')));
    }

    #[test]
    fn step_that_can_not_be_flown_is_refused() {
        let refused = [
            [1.0, 2_000.0, 0.0],
            [1.0, f64::NAN, 0.0],
            [2.0, -1.0, 0.0],
            [3.0, 0.0, 5.0],
            [8.0, 0.5, 1.0],
            [8.0, 300.0, 1.0],
            [9.0, 0.0, 0.0],
        ];
        for numbers in refused {
            assert_eq!(Step::from_numbers(numbers), None, "{numbers:?}");
        }
    }

    proptest! {
        #[test]
        fn no_bytes_panic_the_parser(letter: u8, data in proptest::collection::vec(any::<u8>(), 0..80)) {
            let _ = Order::parse(letter, &data);
        }
    }
}
