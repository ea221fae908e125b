//! Missions of more than places to pass: circles for some turns, for some time or up to a height, jumps, and what they end with.
//!
//! Responsible for which entry comes after which, and for when a circle is over. A list of places that are all passed is no such mission: it is
//! a circuit, flown round for the laps. Every other list is flown once.

use super::hold::tangent_turn_rad;
use super::path::Leg;
use super::{Guidance, GuidanceError, Hold, MAX_WAYPOINTS, Motion, Stage, Waypoint};
use crate::attitude::wrap_angle;
use crate::kept::kept;
use nalgebra::Vector2;
use std::f64::consts::TAU;

/// A leg that begins where the aircraft is is this many radii long at least: there is room to come back onto it.
const LEG_RADII: f64 = 5.0;
/// A circle is begun to be counted within this share of its radius.
const ON_CIRCLE_SHARE: f64 = 0.3;
/// It is left when the course is within this of the way to the next place, rad, or after so much more of it, rad.
const LEAVES_RAD: f64 = 0.35;
const LONGEST_OVER_RAD: f64 = 1.25 * TAU;
/// A height is reached within this, m.
const ON_HEIGHT_M: f64 = 5.0;

/// What is done at an entry of the list.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum Step {
    /// Passed.
    #[default]
    Pass,
    /// Circles: so many; radius m, negative to the left, 0 of one's own choice.
    Turns(f64, f64),
    /// Circles for so long, s; radius as above.
    Time(f64, f64),
    /// Circles until its altitude is reached; radius as above.
    Altitude(f64),
    /// Circles for good; radius as above.
    Unlimited(f64),
    /// A take-off, by who flies; passed over in flight.
    TakeOff,
    /// The way back to the runway, by who flies.
    Return,
    /// A landing, by who flies.
    Land,
    /// Goes on with this entry, so many times; 0: always.
    Jump(usize, u16),
}

impl Step {
    /// As numbers: which kind, and two more.
    pub fn to_numbers(self) -> [f64; 3] {
        match self {
            Self::Pass => [0.0; 3],
            Self::Turns(turns, radius_m) => [1.0, turns, radius_m],
            Self::Time(seconds, radius_m) => [2.0, seconds, radius_m],
            Self::Altitude(radius_m) => [3.0, 0.0, radius_m],
            Self::Unlimited(radius_m) => [4.0, 0.0, radius_m],
            Self::TakeOff => [5.0, 0.0, 0.0],
            Self::Return => [6.0, 0.0, 0.0],
            Self::Land => [7.0, 0.0, 0.0],
            Self::Jump(to, times) => [8.0, to as f64, f64::from(times)],
        }
    }

    /// The step again; numbers that are none give one that is passed.
    pub fn from_numbers([kind, amount, second]: [f64; 3]) -> Self {
        match kind {
            1.0 => Self::Turns(amount, second),
            2.0 => Self::Time(amount, second),
            3.0 => Self::Altitude(second),
            4.0 => Self::Unlimited(second),
            5.0 => Self::TakeOff,
            6.0 => Self::Return,
            7.0 => Self::Land,
            // Casts saturate: what is too much is a place that is not there.
            8.0 => Self::Jump(amount as usize, second as u16),
            _ => Self::Pass,
        }
    }

    /// Radius of its circle, where it is one.
    fn radius_m(self) -> Option<f64> {
        match self {
            Self::Turns(_, radius_m)
            | Self::Time(_, radius_m)
            | Self::Altitude(radius_m)
            | Self::Unlimited(radius_m) => Some(radius_m),
            _ => None,
        }
    }

    /// Whether there is a place to fly to.
    pub fn has_place(self) -> bool {
        self == Self::Pass || self == Self::Land || self.radius_m().is_some()
    }

    fn is_last(self) -> bool {
        matches!(self, Self::Land | Self::Return)
    }
}

/// How far such a mission has come, beside its entry.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Progress {
    /// Where the leg to the next place begins; not known before it is joined.
    from: Option<Vector2<f64>>,
    /// The circle that is held is one of the mission's.
    pub(super) circling: bool,
    /// There is nothing left to fly to.
    pub(super) ended: bool,
    /// The aircraft is on the circle, and was last at this bearing from its centre, rad.
    arrived: bool,
    bearing_rad: f64,
    /// Flown of the circle.
    turned_rad: f64,
    since_s: f64,
    /// Turned since the circle was over.
    over_rad: Option<f64>,
    /// How often each jump was taken.
    jumps: [u16; MAX_WAYPOINTS],
    /// What the frame brings.
    dt_s: f64,
    altitude_m: f64,
}

impl Progress {
    pub(super) const BEGINNING: Self = Self {
        from: None,
        circling: false,
        ended: false,
        arrived: false,
        bearing_rad: 0.0,
        turned_rad: 0.0,
        since_s: 0.0,
        over_rad: None,
        jumps: [0; MAX_WAYPOINTS],
        dt_s: 0.0,
        altitude_m: 0.0,
    };

    /// On the way to another entry.
    fn towards_next(&self, from: Option<Vector2<f64>>) -> Self {
        Self { from, jumps: self.jumps, dt_s: self.dt_s, altitude_m: self.altitude_m, ..Self::BEGINNING }
    }
}

kept!(Progress {
    from: Option<Vector2<f64>>,
    circling: bool,
    ended: bool,
    arrived: bool,
    bearing_rad: f64,
    turned_rad: f64,
    since_s: f64,
    over_rad: Option<f64>,
    jumps: [u16; MAX_WAYPOINTS],
    dt_s: f64,
    altitude_m: f64,
});

/// Whether a list is such a mission, and what is wrong with it as one.
pub(super) fn check(waypoints: &[Waypoint]) -> Result<bool, GuidanceError> {
    if waypoints.iter().all(|waypoint| waypoint.step == Step::Pass) {
        return Ok(false);
    }
    for (index, waypoint) in waypoints.iter().enumerate() {
        let Step::Jump(mut to, _) = waypoint.step else { continue };
        // Jumps may lead to jumps, but not for ever.
        let leads = (0..waypoints.len()).any(|_| match waypoints.get(to).map(|target| target.step) {
            Some(Step::Jump(on, _)) => {
                to = on;
                false
            }
            Some(Step::TakeOff) | None => false,
            Some(_) => true,
        });
        if !leads {
            return Err(GuidanceError::Jump { index });
        }
    }
    let flown = waypoints.iter().any(|waypoint| !matches!(waypoint.step, Step::TakeOff | Step::Jump(..)));
    if flown { Ok(true) } else { Err(GuidanceError::Empty) }
}

impl Guidance {
    /// What the frame brings beside the motion: its length, and the altitude, m above the runway.
    pub fn observe(&mut self, dt_s: f64, altitude_m: f64) {
        (self.progress.dt_s, self.progress.altitude_m) = (dt_s, altitude_m);
    }

    /// What the mission has come to that guidance does not fly: a landing, the way back.
    pub fn ending(&self) -> Option<&Waypoint> {
        let entry = self.waypoint(self.next);
        (self.program && self.progress.ended && entry.step.is_last()).then_some(entry)
    }

    /// The circle that the mission ends with, where it has one.
    pub fn ends_in_circle(&self) -> bool {
        self.program && self.waypoint(self.next).step.radius_m().is_some()
    }

    /// Height (m) of the take-off that the mission begins with, as long as nothing of it was flown.
    pub fn take_off_m(&self) -> Option<f64> {
        let first = self.waypoint(0);
        let begins = self.program && self.reached == 0 && first.step == Step::TakeOff;
        begins.then_some(first.altitude_m)
    }

    /// Goes on with this entry, or with what it leads to; false: there is no such entry.
    pub fn go_on_with(&mut self, index: usize) -> bool {
        let mut jumps = self.progress.jumps;
        let Some(entry) = (index < self.count).then(|| self.entry_from(index, &mut jumps)).flatten() else {
            return false;
        };
        self.disengage();
        (self.next, self.progress) = (entry, Progress { jumps, ..Progress::BEGINNING });
        self.progress.ended = self.waypoint(entry).step.is_last();
        true
    }

    /// Goes on where another one stands, with way-points that were moved.
    pub fn carry_on(&mut self, other: &Self) {
        self.resume(&other.snapshot());
        if self.program == other.program {
            self.progress = Progress { circling: false, arrived: false, ..other.progress };
        }
    }

    /// The first entry that is flown to.
    pub(super) fn begin_program(&mut self) {
        self.progress = Progress::BEGINNING;
        if self.program {
            let mut jumps = self.progress.jumps;
            let first = self.entry_from(0, &mut jumps);
            (self.next, self.progress.jumps) = (first.unwrap_or(0), jumps);
            self.progress.ended = first.is_none_or(|first| self.waypoint(first).step.is_last());
        }
    }

    /// The entry at `index`, or the one that it leads to; `None` behind the last one.
    fn entry_from(&self, mut index: usize, jumps: &mut [u16; MAX_WAYPOINTS]) -> Option<usize> {
        // More than any list without a circle of jumps needs.
        for _ in 0..4 * MAX_WAYPOINTS {
            match self.waypoints().get(index)?.step {
                Step::TakeOff => index += 1,
                Step::Jump(to, 0) => index = to,
                Step::Jump(to, times) if jumps[index] < times => {
                    jumps[index] += 1;
                    index = to;
                }
                Step::Jump(..) => {
                    jumps[index] = 0; // the next time round it is taken again
                    index += 1;
                }
                _ => return Some(index),
            }
        }
        None
    }

    /// The leg to the next place.
    pub(super) fn leg(&self) -> Leg {
        if !self.program {
            return self.circuit_leg(self.next);
        }
        let to = self.waypoint(self.next).horizontal();
        Leg { from: self.progress.from.unwrap_or(to), to }
    }

    /// The leg after that; `None` where there is no corner.
    pub(super) fn leg_after(&self) -> Option<Leg> {
        if !self.program {
            return Some(self.circuit_leg(self.next + 1));
        }
        let mut jumps = self.progress.jumps;
        let after = self.waypoint(self.entry_from(self.next + 1, &mut jumps)?);
        let from = self.waypoint(self.next).horizontal();
        let leg = Leg { from, to: after.horizontal() };
        (after.step.has_place() && leg.length_m() > 1.0).then_some(leg)
    }

    /// The leg to be joined: from where the aircraft is, where it does not begin at a place.
    pub(super) fn leg_to_join(&mut self, motion: &Motion, radius_m: f64) -> Leg {
        if self.program && self.progress.from.is_none() {
            let to = self.waypoint(self.next).horizontal();
            let way = to - motion.position;
            let forward = way.try_normalize(1.0).unwrap_or(Vector2::new(1.0, 0.0));
            self.progress.from = Some(to - forward * way.norm().max(LEG_RADII * radius_m));
        }
        self.leg()
    }

    /// An entry was reached: on to the next one, from a place.
    pub(super) fn pass_entry(&mut self, from: Option<Vector2<f64>>) {
        (self.reached, self.missed) = (self.reached.saturating_add(1), 0);
        let mut jumps = self.progress.jumps;
        let after = self.entry_from(self.next + 1, &mut jumps);
        self.progress = Progress { jumps, ..self.progress.towards_next(from) };
        match after {
            Some(after) => {
                self.next = after;
                self.progress.ended = self.waypoint(after).step.is_last();
            }
            None => self.progress.ended = true,
        }
    }

    /// Begins the circle of the next entry; false: it is none.
    pub(super) fn begin_circle(&mut self, motion: &Motion) -> bool {
        let entry = *self.waypoint(self.next);
        let Some(asked_m) = entry.step.radius_m().filter(|_| self.program) else { return false };
        // None that is narrower than the aircraft holds.
        let radius_m = self.radius_m(&motion.wind).max(asked_m.abs());
        let on = |side: f64| Hold {
            north_m: entry.north_m,
            east_m: entry.east_m,
            radius_m,
            side,
            altitude_m: entry.altitude_m,
            airspeed_mps: entry.airspeed_mps,
        };
        let (right, left) = (on(1.0), on(-1.0));
        let circle = if asked_m == 0.0 {
            if tangent_turn_rad(&left, motion) < tangent_turn_rad(&right, motion) { left } else { right }
        } else {
            on(1f64.copysign(asked_m))
        };
        (self.hold, self.stage) = (Some(circle), Stage::Idle);
        (self.progress.circling, self.progress.arrived) = (true, false);
        self.advance_hold(circle, motion);
        true
    }

    /// One frame on the mission's own circle, or on the way to it.
    pub(super) fn circle_on(&mut self, held: Hold, motion: &Motion) {
        let Stage::Hold(_) = self.stage else { return };
        let out = motion.position - Vector2::new(held.north_m, held.east_m);
        let bearing_rad = out.y.atan2(out.x);
        let step = self.waypoint(self.next).step;
        if !self.progress.arrived {
            if (out.norm() - held.radius_m).abs() < ON_CIRCLE_SHARE * held.radius_m {
                (self.progress.arrived, self.progress.bearing_rad) = (true, bearing_rad);
                if matches!(step, Step::Unlimited(_)) && !self.progress.ended {
                    self.reached = self.reached.saturating_add(1);
                    self.progress.ended = true;
                }
            }
            return;
        }
        let turned_rad = held.side * wrap_angle(bearing_rad - self.progress.bearing_rad);
        let progress = &mut self.progress;
        progress.bearing_rad = bearing_rad;
        progress.turned_rad += turned_rad;
        progress.since_s += progress.dt_s;
        let over = match step {
            Step::Turns(turns, _) => progress.turned_rad >= turns * TAU,
            Step::Time(seconds, _) => progress.since_s >= seconds,
            Step::Altitude(_) => (progress.altitude_m - held.altitude_m).abs() < ON_HEIGHT_M,
            _ => false,
        };
        progress.over_rad = progress.over_rad.map(|over| over + turned_rad.max(0.0)).or(over.then_some(0.0));
        if progress.over_rad.is_some() && !progress.ended {
            self.leave_circle(motion);
        }
    }

    /// The circle is over: it is left towards the next place.
    fn leave_circle(&mut self, motion: &Motion) {
        let mut jumps = self.progress.jumps;
        let after = self.entry_from(self.next + 1, &mut jumps);
        let Some(after) = after.map(|after| *self.waypoint(after)) else {
            // Nothing comes after it: the circle goes on.
            self.reached = self.reached.saturating_add(1);
            self.progress.ended = true;
            return;
        };
        let way = after.horizontal() - motion.position;
        let course = motion.velocity.y.atan2(motion.velocity.x);
        let ahead = wrap_angle(way.y.atan2(way.x) - course).abs() < LEAVES_RAD;
        let late = self.progress.over_rad.is_some_and(|over| over > LONGEST_OVER_RAD);
        if ahead || late || !after.step.has_place() {
            (self.hold, self.stage) = (None, Stage::Idle);
            self.pass_entry(None);
            self.set_out(motion);
        }
    }
}
