//! Way-points into a horizontal acceleration, an altitude and an airspeed.
//!
//! Responsible for the order of the way-points and for the track between them. It must never lose the mission: from
//! any place and heading it turns towards the next way-point, and a way-point passed too far off is flown to again.

mod hold;
pub mod path;
mod program;

pub use hold::Hold;
pub use program::Step;

use crate::GRAVITY_MPS2;
use crate::airframe::Airframe;
use crate::attitude::wrap_angle;
use crate::control::envelope::{Banks, Envelope};
use crate::kept::{Kept, kept, put_first, take_first};
use nalgebra::Vector2;
use path::{Arc, Leg, Offset};
use program::Progress;
use thiserror::Error;

/// Way-points a mission can hold.
pub const MAX_WAYPOINTS: usize = 32;

/// A place to fly to.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
#[repr(C)]
pub struct Waypoint {
    /// North of the runway, m.
    pub north_m: f64,
    /// East of the runway, m.
    pub east_m: f64,
    /// Above the runway, m.
    pub altitude_m: f64,
    /// Airspeed on the way there, m/s.
    pub airspeed_mps: f64,
    /// Kept as data; the track follows from the places (the seed's table does not fit its own square).
    pub heading_rad: f64,
    /// What is done there.
    pub step: Step,
}

impl Waypoint {
    /// North and east.
    pub fn horizontal(&self) -> Vector2<f64> {
        Vector2::new(self.north_m, self.east_m)
    }

    /// Whether its values can be flown.
    pub fn is_sane(&self) -> bool {
        [self.north_m, self.east_m, self.altitude_m, self.airspeed_mps, self.heading_rad]
            .iter()
            .chain(&self.step.to_numbers())
            .all(|x| x.is_finite())
            && (5.0..=100.0).contains(&self.airspeed_mps)
    }
}

/// The seed's four way-points: a square of 500 m, 160 m above the runway, 22 m/s.
pub fn seed_waypoints() -> [Waypoint; 4] {
    let at = |north_m, east_m, heading_deg: f64| Waypoint {
        north_m,
        east_m,
        altitude_m: 160.0,
        airspeed_mps: 22.0,
        heading_rad: heading_deg.to_radians(),
        step: Step::Pass,
    };
    [at(500.0, 0.0, 0.0), at(500.0, 500.0, 0.0), at(0.0, 500.0, 180.0), at(0.0, 0.0, 270.0)]
}

/// Why way-points were refused.
#[derive(Debug, Error, Clone, Copy, PartialEq, Eq)]
pub enum GuidanceError {
    /// None given.
    #[error("a mission needs at least one way-point")]
    Empty,
    /// More than fit.
    #[error("{count} way-points were given, a mission holds {MAX_WAYPOINTS}")]
    TooMany {
        /// How many.
        count: usize,
    },
    /// A value that is not a number, or an airspeed outside 5 to 100 m/s.
    #[error("way-point {index} has a value that is not finite, or an airspeed outside 5 to 100 m/s")]
    Value {
        /// Which, from 0.
        index: usize,
    },
    /// A jump to an entry that is not there, or from jump to jump for ever.
    #[error("entry {index} jumps to where nothing is flown to")]
    Jump {
        /// Which, from 0.
        index: usize,
    },
}

/// How corners are flown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Corner {
    /// Legs joined by arcs inside the corner.
    #[default]
    Fillet,
    /// Through the way-point, then turn: the seed's manner.
    FlyThrough,
}

/// What comes after the laps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Finish {
    /// A circle, begun where the last way-point was reached.
    #[default]
    Loiter,
    /// Round again, for ever: the seed's manner.
    Circuit,
    /// A landing, by who flies; until then a circle.
    Land,
}

/// What one may set on guidance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GuidanceConfig {
    /// How corners are flown.
    pub corner: Corner,
    /// Radius of the fillets, m; `None` takes it from airspeed and wind.
    pub radius_m: Option<f64>,
    /// Least automatic radius, m: 70 m keeps a 22 m/s aircraft within about 2 m in calm air.
    pub least_radius_m: f64,
    /// Bank for which the automatic radius is made, with the whole wind behind, rad; what is left up to the bank
    /// limit is for corrections.
    pub turn_bank_rad: f64,
    /// Laps after which `finished` is set, see [`waypoints_to_reach`]. Zero: never.
    pub laps: u32,
    /// What comes then.
    pub finish: Finish,
    /// How long before an arc begins or ends its acceleration is commanded, s: the lag of bank behind its reference.
    pub lead_s: f64,
    /// The aircraft's fastest airspeed, m/s: no corner is made for more.
    pub fastest_mps: f64,
    /// The least that is flown, m/s: no corner is made for less.
    pub slowest_mps: f64,
    /// Roll rate that a bank is turned to with, for each m/s of airspeed, rad/m; infinite: as quickly as the laws ask.
    pub roll_per_airspeed: f64,
    /// Banks that the aircraft holds level.
    pub banks: Banks,
}

impl GuidanceConfig {
    /// As set, for an aircraft.
    #[must_use]
    pub fn of_airframe(self, airframe: &Airframe) -> Self {
        let envelope = Envelope::new(airframe);
        Self {
            fastest_mps: envelope.fastest_mps,
            slowest_mps: envelope.slowest_mps,
            roll_per_airspeed: envelope.roll_rate_radps(1.0),
            banks: envelope.banks(airframe),
            ..self
        }
    }

    /// Radius (m) of a corner at which the design bank suffices with the whole wind from behind, (V + W)²/(g tan φ), and not more
    /// than a share of the bank that the aircraft holds.
    #[must_use]
    pub fn corner_radius_m(&self, airspeed_mps: f64, wind_mps: f64) -> f64 {
        self.radius_m.unwrap_or(self.turn_radius_m(airspeed_mps, wind_mps))
    }

    /// The same whatever radius of corners is set: what the aircraft turns with.
    #[must_use]
    pub fn turn_radius_m(&self, airspeed_mps: f64, wind_mps: f64) -> f64 {
        let fastest = airspeed_mps + wind_mps;
        let tangent = self.turn_bank_rad.tan().min(BANK_SHARE * self.banks.tangent(airspeed_mps));
        (fastest * fastest / (GRAVITY_MPS2 * tangent)).max(self.least_radius_m)
    }
}

impl Default for GuidanceConfig {
    fn default() -> Self {
        Self {
            corner: Corner::Fillet,
            radius_m: None,
            least_radius_m: 70.0,
            turn_bank_rad: 38f64.to_radians(),
            laps: 0,
            finish: Finish::Loiter,
            lead_s: 0.55,
            fastest_mps: f64::INFINITY,
            slowest_mps: 0.0,
            roll_per_airspeed: f64::INFINITY,
            banks: Banks::ANY,
        }
    }
}

/// Motion over ground, as guidance needs it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// North, east, m.
    pub position: Vector2<f64>,
    /// North, east, m/s.
    pub velocity: Vector2<f64>,
    /// North, east, m/s.
    pub wind: Vector2<f64>,
}

/// What guidance asks for, and where it stands.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GuidanceOutput {
    /// Horizontal acceleration to the right of the ground track, m/s².
    pub horizontal_mps2: f64,
    /// Altitude wanted, m above the runway.
    pub altitude_m: f64,
    /// Airspeed wanted, m/s.
    pub airspeed_mps: f64,
    /// Index of the way-point flown to.
    pub next: usize,
    /// Way-points reached since engagement.
    pub reached: u32,
    /// Distance right of the track, m.
    pub cross_track_m: f64,
    /// Way left on this leg or arc, m.
    pub distance_m: f64,
    /// Direction of the track, rad from north.
    pub track_rad: f64,
    /// On an arc.
    pub on_arc: bool,
    /// Radius of the corner at hand, m; zero without fillet.
    pub radius_m: f64,
    /// The laps asked for are done.
    pub finished: bool,
    /// It flies a circle, or on the way to one, and not the mission.
    pub holding: bool,
}

/// Share of the greatest turn (the tangent of its bank) that a corner is made for: what is left is for corrections.
const BANK_SHARE: f64 = 0.65;
/// Roll rate that the outer loop asks for at most, rad/s: whoever rolls as quickly has the full gains and leads.
const QUICK_ROLL_RADPS: f64 = 1.6;
/// Roll rate below which the gains sink with it, rad/s: a bank that comes late makes a quick path swing.
const SLOW_ROLL_RADPS: f64 = 0.6;
/// Bank that is rolled to where an arc begins, rad: half of it is how much longer a slow roll's lag is.
const LEAD_BANK_RAD: f64 = 0.33;
/// Gain from cross-track error to closing speed, 1/s.
const TRACK_GAIN: f64 = 0.5;
/// Closing speed as a share of ground speed: an intercept of 37°.
const TRACK_SHARE: f64 = 0.6;
/// Gain from closing-speed error to acceleration, 1/s.
const CLOSING_GAIN: f64 = 1.6;
/// Gain from course error to turn rate, 1/s: a third of the bank loop's, so that a slow roller does not swing.
const COURSE_GAIN: f64 = 0.75;
/// It flies so many radii away from a place that it can not turn to.
const AWAY_RADII: f64 = 2.5;
/// And one more each time that it was missed, up to so many.
const MOST_MISSED: u8 = 5;
/// Greatest horizontal acceleration, m/s²: 47° of bank, which leaves a third of the lift a wing has at 22 m/s.
const HORIZONTAL_LIMIT_MPS2: f64 = 10.5;
/// Time an engagement takes to bend the track, s.
const REACTION_S: f64 = 1.0;
/// A fillet no longer changes when its beginning is nearer than this, s.
const SETTLED_S: f64 = 3.0;
/// A wind beyond this is taken for a wrong estimate where the radius is chosen, m/s.
const STRONGEST_WIND_MPS: f64 = 15.0;
/// Share of a bank that is flown at most which a corner is laid out for: the rest steers.
const LAID_OUT_SHARE: f64 = 0.9;
/// A way-point passed abeam within this share of the radius counts as reached.
pub const REACHED_SHARE: f64 = 0.35;
/// Ground speeds below this count as this, m/s: the laws divide by it.
const LEAST_GROUND_SPEED_MPS: f64 = 5.0;

/// Where on the path.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Stage {
    /// Not engaged yet.
    Idle,
    /// On the way to the beginning of the leg, because there is no room left to join it before its end.
    Entry(Leg),
    /// On a leg to the next way-point, with the fillet at its end.
    Leg(Leg, Option<Arc>),
    /// On the fillet; true once its way-point was passed abeam.
    Arc(Arc, bool),
    /// On the way to the circle that is held.
    ToHold(Leg, Arc),
    /// On it.
    Hold(Arc),
}

/// Which one, with a leg and an arc where it has them.
impl Kept for Stage {
    const BYTES: usize = u8::BYTES + Option::<Leg>::BYTES + Option::<Arc>::BYTES;

    fn put(&self, mut bytes: &mut [u8]) {
        let (which, leg, arc): (u8, _, _) = match *self {
            Self::Idle => (0, None, None),
            Self::Entry(leg) => (1, Some(leg), None),
            Self::Leg(leg, arc) => (2, Some(leg), arc),
            Self::Arc(arc, passed) => (if passed { 4 } else { 3 }, None, Some(arc)),
            Self::ToHold(leg, arc) => (5, Some(leg), Some(arc)),
            Self::Hold(arc) => (6, None, Some(arc)),
        };
        put_first(&which, &mut bytes);
        put_first(&leg, &mut bytes);
        put_first(&arc, &mut bytes);
    }

    fn take(mut bytes: &[u8]) -> Option<Self> {
        let which: u8 = take_first(&mut bytes)?;
        let (leg, arc) = (take_first(&mut bytes)?, take_first(&mut bytes)?);
        Some(match (which, leg, arc) {
            (0, None, None) => Self::Idle,
            (1, Some(leg), None) => Self::Entry(leg),
            (2, Some(leg), arc) => Self::Leg(leg, arc),
            (3, None, Some(arc)) => Self::Arc(arc, false),
            (4, None, Some(arc)) => Self::Arc(arc, true),
            (5, Some(leg), Some(arc)) => Self::ToHold(leg, arc),
            (6, None, Some(arc)) => Self::Hold(arc),
            _ => return None,
        })
    }
}

/// Guidance over a circuit of way-points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Guidance {
    config: GuidanceConfig,
    waypoints: [Waypoint; MAX_WAYPOINTS],
    count: usize,
    next: usize,
    reached: u32,
    stage: Stage,
    /// A circle in place of the mission, or one of the mission's.
    hold: Option<Hold>,
    /// The list is more than places to pass.
    program: bool,
    progress: Progress,
    /// How often the next way-point was passed too far off.
    missed: u8,
}

/// What to keep over a restart: enough to go on to the same way-point.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[repr(C)]
pub struct GuidanceSnapshot {
    /// Index of the way-point flown to.
    pub next: u32,
    /// Way-points reached.
    pub reached: u32,
}

kept!(GuidanceSnapshot { next: u32, reached: u32 });

/// Where on the path, and what corners are laid out for, to keep over a restart.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Path {
    stage: Stage,
    hold: Option<Hold>,
    progress: Progress,
    missed: u8,
    slowest_mps: f64,
    turn_bank_rad: f64,
}

kept!(Path { stage: Stage, hold: Option<Hold>, progress: Progress, missed: u8, slowest_mps: f64, turn_bank_rad: f64 }
    if |path| path.turn_bank_rad > 0.0);

/// Way-points to reach until `laps` laps of `count` way-points are flown: every lap ends with the return to the first
/// one. `None`: for ever.
pub fn waypoints_to_reach(laps: u32, count: usize) -> Option<u32> {
    (laps > 0).then(|| laps.saturating_mul(count as u32).saturating_add(1))
}

impl Guidance {
    /// Guidance over way-points, in order and round again.
    pub fn new(config: GuidanceConfig, waypoints: &[Waypoint]) -> Result<Self, GuidanceError> {
        if waypoints.is_empty() {
            return Err(GuidanceError::Empty);
        }
        if waypoints.len() > MAX_WAYPOINTS {
            return Err(GuidanceError::TooMany { count: waypoints.len() });
        }
        if let Some(index) = waypoints.iter().position(|waypoint| !waypoint.is_sane()) {
            return Err(GuidanceError::Value { index });
        }
        let program = program::check(waypoints)?;
        let mut held = [Waypoint::default(); MAX_WAYPOINTS];
        held[..waypoints.len()].copy_from_slice(waypoints);
        let mut guidance = Self {
            config,
            waypoints: held,
            count: waypoints.len(),
            next: 0,
            reached: 0,
            missed: 0,
            stage: Stage::Idle,
            hold: None,
            program,
            progress: Progress::BEGINNING,
        };
        guidance.begin_program();
        Ok(guidance)
    }

    /// The way-points flown.
    pub fn waypoints(&self) -> &[Waypoint] {
        &self.waypoints[..self.count]
    }

    /// Flies with another configuration from now on; a corner that is being flown is flown as it was begun.
    pub fn configure(&mut self, config: GuidanceConfig) {
        self.config = config;
    }

    /// Starts the mission at its first way-point, from wherever the aircraft is at the next step.
    pub fn restart(&mut self) {
        (self.next, self.reached, self.missed) = (0, 0, 0);
        (self.stage, self.hold) = (Stage::Idle, None);
        self.begin_program();
    }

    /// Leaves the path but keeps the way-point: the next step joins anew.
    pub fn disengage(&mut self) {
        (self.stage, self.hold, self.progress.circling) = (Stage::Idle, None, false);
        self.missed = 0;
    }

    /// What to keep over a restart.
    pub fn snapshot(&self) -> GuidanceSnapshot {
        GuidanceSnapshot { next: self.next as u32, reached: self.reached }
    }

    /// Goes on where a snapshot stood.
    pub fn resume(&mut self, snapshot: &GuidanceSnapshot) {
        self.next = snapshot.next as usize % self.count;
        self.reached = snapshot.reached;
        self.stage = Stage::Idle;
    }

    /// Where on the path it is, beside [`Guidance::snapshot`].
    pub(crate) fn path(&self) -> Path {
        let Self { stage, hold, progress, missed, config, .. } = *self;
        let GuidanceConfig { slowest_mps, turn_bank_rad, .. } = config;
        Path { stage, hold, progress, missed, slowest_mps, turn_bank_rad }
    }

    /// Goes on there, after [`Guidance::resume`].
    pub(crate) fn resume_path(&mut self, path: &Path) {
        (self.stage, self.hold) = (path.stage, path.hold);
        (self.progress, self.missed) = (path.progress, path.missed);
        self.config.slowest_mps = path.slowest_mps;
        self.config.turn_bank_rad = self.config.turn_bank_rad.min(path.turn_bank_rad);
    }

    /// The aircraft flies no slower than this from now on, m/s, and holds these banks.
    pub fn fly_within(&mut self, slowest_mps: f64, banks: Option<Banks>) {
        self.config.slowest_mps = slowest_mps;
        self.config.banks = banks.unwrap_or(self.config.banks);
    }

    /// Corners and circles are laid out for less bank than this from now on, rad.
    pub fn turn_no_steeper(&mut self, bank_rad: f64) {
        self.config.turn_bank_rad = self.config.turn_bank_rad.min(LAID_OUT_SHARE * bank_rad);
    }

    fn waypoint(&self, index: usize) -> &Waypoint {
        &self.waypoints[index % self.count]
    }

    fn circuit_leg(&self, index: usize) -> Leg {
        let from = self.waypoint(index + self.count - 1).horizontal();
        Leg { from, to: self.waypoint(index).horizontal() }
    }

    /// Airspeed that is flown to the next way-point, m/s.
    fn airspeed_mps(&self) -> f64 {
        self.flown_mps(self.waypoint(self.next).airspeed_mps)
    }

    /// What is flown where this is asked for, m/s.
    fn flown_mps(&self, asked_mps: f64) -> f64 {
        asked_mps.min(self.config.fastest_mps).max(self.config.slowest_mps)
    }

    /// Roll rate that a bank is turned to with, rad/s.
    fn roll_rate_radps(&self) -> f64 {
        (self.config.roll_per_airspeed * self.airspeed_mps()).min(QUICK_ROLL_RADPS)
    }

    /// Share of the gains: all of them for who rolls quickly enough.
    fn agility(&self) -> f64 {
        (self.roll_rate_radps() / SLOW_ROLL_RADPS).min(1.0)
    }

    /// Lag of bank behind its reference, s.
    fn lead_s(&self) -> f64 {
        self.config.lead_s + LEAD_BANK_RAD * (1.0 / self.roll_rate_radps() - 1.0 / QUICK_ROLL_RADPS)
    }

    fn radius_m(&self, wind: &Vector2<f64>) -> f64 {
        self.radius_at_m(self.airspeed_mps(), wind)
    }

    /// Radius (m) that it turns with, whatever corners are asked for.
    fn turn_radius_m(&self, wind: &Vector2<f64>) -> f64 {
        self.config.turn_radius_m(self.airspeed_mps(), wind.norm().min(STRONGEST_WIND_MPS))
    }

    /// The leg, with the fillet at its end.
    fn begin_leg(&self, leg: Leg, wind: &Vector2<f64>) -> Stage {
        let arc = match self.config.corner {
            Corner::Fillet => {
                let (radius_m, turn_m) = (self.radius_m(wind), self.turn_radius_m(wind));
                self.leg_after().and_then(|after| Arc::between(&leg, &after, radius_m, turn_m))
            }
            Corner::FlyThrough => None,
        };
        Stage::Leg(leg, arc)
    }

    /// Joins the circuit: on the leg to the next way-point if there is room to get on it, otherwise by way of a point
    /// beside its beginning, from where the turn back leads onto it.
    fn join(&mut self, motion: &Motion) -> Stage {
        let radius_m = self.radius_m(&motion.wind);
        let own = self.leg_to_join(motion, radius_m);
        if self.goes_straight(&own, radius_m) {
            let (to, from) = (own.to, motion.position);
            let speed = motion.velocity.norm();
            let turn_m = self.turn_radius_m(&motion.wind);
            if speed > LEAST_GROUND_SPEED_MPS && is_within_turn(&(to - from), &motion.velocity, turn_m) {
                // Away from it first, further each time that it was missed.
                let away_m = (AWAY_RADII + f64::from(self.missed.min(MOST_MISSED))) * turn_m;
                return Stage::Entry(Leg { from, to: from + motion.velocity * (away_m / speed) });
            }
            return self.begin_leg(Leg { from, to }, &motion.wind);
        }
        let offset = own.offset(&motion.position);
        if has_room(&offset, &motion.velocity, radius_m) {
            return self.begin_leg(own, &motion.wind);
        }
        let track = offset.track_rad;
        let right = Vector2::new(-track.sin(), track.cos());
        let side = 1f64.copysign(offset.right_m);
        Stage::Entry(Leg { from: motion.position, to: own.from + right * (2.0 * side * radius_m) })
    }

    /// Whether it flies straight to the end of the leg: that is too short to be joined, or its end was missed.
    fn goes_straight(&self, leg: &Leg, radius_m: f64) -> bool {
        leg.length_m() < 3.0 * radius_m || self.missed > 0
    }

    /// On the way to the next way-point, or to its circle.
    fn set_out(&mut self, motion: &Motion) {
        if !self.begin_circle(motion) {
            self.stage = self.join(motion);
        }
    }

    /// The same from the place that was passed.
    fn go_straight_on(&mut self, motion: &Motion) {
        if !self.begin_circle(motion) {
            self.stage = self.begin_leg(self.leg(), &motion.wind);
        }
    }

    fn pass(&mut self) {
        self.missed = 0;
        if self.program {
            return self.pass_entry(Some(self.waypoint(self.next).horizontal()));
        }
        self.next = (self.next + 1) % self.count;
        self.reached = self.reached.saturating_add(1);
    }

    /// Moves on to the next piece where this one ends.
    fn advance(&mut self, motion: &Motion) {
        if let Some(held) = self.hold {
            self.advance_hold(held, motion);
            if self.progress.circling {
                self.circle_on(held, motion);
            }
            return;
        }
        match self.stage {
            Stage::ToHold(..) | Stage::Hold(_) | Stage::Idle => self.set_out(motion),
            Stage::Entry(leg) => {
                let radius_m = self.radius_m(&motion.wind);
                let is_past = leg.offset(&motion.position).left_m <= 0.0;
                if is_past || (leg.to - motion.position).norm() < radius_m {
                    let own = self.leg_to_join(motion, radius_m);
                    self.stage = match self.goes_straight(&own, radius_m) {
                        true => self.join(motion),
                        false => self.begin_leg(own, &motion.wind),
                    };
                }
            }
            Stage::Leg(leg, arc) => self.advance_leg(&leg, arc, motion),
            Stage::Arc(arc, passed) => self.advance_arc(arc, passed, motion),
        }
    }

    fn advance_leg(&mut self, leg: &Leg, arc: Option<Arc>, motion: &Motion) {
        let offset = leg.offset(&motion.position);
        let settled = arc.map_or(0.0, |arc| arc.tangent_m) + SETTLED_S * motion.velocity.norm();
        if offset.left_m > settled {
            // The wind of the corner is not that of the last corner: the fillet follows it until shortly before.
            self.stage = self.begin_leg(*leg, &motion.wind);
            return;
        }
        if offset.left_m > arc.map_or(0.0, |arc| arc.tangent_m) {
            return;
        }
        let radius_m = self.radius_m(&motion.wind);
        if offset.right_m.abs() > REACHED_SHARE * arc.map_or(radius_m, |arc| arc.radius_m.min(radius_m)) {
            // Too far off to count: fly to it again.
            self.missed = self.missed.saturating_add(1);
            self.stage = self.join(motion);
        } else if let Some(arc) = arc {
            self.stage = Stage::Arc(arc, false);
        } else {
            self.pass();
            self.go_straight_on(motion);
        }
    }

    fn advance_arc(&mut self, arc: Arc, passed: bool, motion: &Motion) {
        let offset = arc.offset(&motion.position);
        if !passed && offset.along_m >= offset.left_m {
            self.pass();
            self.stage = Stage::Arc(arc, true);
        } else if passed && offset.left_m <= 0.0 {
            self.go_straight_on(motion);
        }
    }

    /// One frame: moves along the path and asks for an acceleration.
    pub fn step(&mut self, motion: &Motion) -> GuidanceOutput {
        self.advance(motion);
        let stays = self.config.finish != Finish::Circuit || self.program;
        if self.is_finished() && stays && self.hold.is_none() {
            self.hold_where_it_ended(motion);
        }
        let (offset, on_arc, radius_m) = match &self.stage {
            Stage::Leg(leg, arc) => {
                (leg.offset(&motion.position), false, arc.map_or(0.0, |arc| arc.radius_m))
            }
            Stage::Entry(leg) => (leg.offset(&motion.position), false, 0.0),
            Stage::Arc(arc, _) | Stage::Hold(arc) => (arc.offset(&motion.position), true, arc.radius_m),
            Stage::ToHold(leg, arc) => (leg.offset(&motion.position), false, arc.radius_m),
            Stage::Idle => (self.leg().offset(&motion.position), false, 0.0),
        };
        let target = self.waypoint(self.next);
        let (altitude_m, airspeed_mps) = self
            .hold
            .map_or((target.altitude_m, target.airspeed_mps), |held| (held.altitude_m, held.airspeed_mps));
        GuidanceOutput {
            horizontal_mps2: track_acceleration(
                &offset,
                &motion.velocity,
                self.curvature(motion),
                self.agility(),
            ),
            altitude_m,
            airspeed_mps: self.flown_mps(airspeed_mps),
            next: self.next,
            reached: self.reached,
            cross_track_m: offset.right_m,
            distance_m: offset.left_m,
            track_rad: offset.track_rad,
            on_arc,
            radius_m,
            finished: self.is_finished(),
            holding: self.hold.is_some(),
        }
    }

    /// The laps asked for are done, or all that the list asks for.
    pub fn is_finished(&self) -> bool {
        if self.program {
            return self.progress.ended;
        }
        waypoints_to_reach(self.config.laps, self.count).is_some_and(|wanted| self.reached >= wanted)
    }

    /// Curvature of the path (1/m, positive right) a lead time ahead.
    fn curvature(&self, motion: &Motion) -> f64 {
        let ahead = motion.velocity.norm() * self.lead_s();
        match &self.stage {
            Stage::Leg(leg, Some(arc)) => {
                let offset = leg.offset(&motion.position);
                let near = offset.left_m - ahead <= arc.tangent_m && offset.right_m.abs() < 20.0;
                if near { arc.side / arc.radius_m } else { 0.0 }
            }
            Stage::Arc(arc, _) if arc.offset(&motion.position).left_m > ahead => arc.side / arc.radius_m,
            Stage::ToHold(leg, arc) if leg.offset(&motion.position).left_m <= ahead => {
                arc.side / arc.radius_m
            }
            Stage::Hold(arc) if arc.offset(&motion.position).right_m.abs() < 0.5 * arc.radius_m => {
                arc.side / arc.radius_m
            }
            _ => 0.0,
        }
    }
}

/// Whether a place (m from here) lies within the circle of a turn to its side, so that no turn leads to it.
fn is_within_turn(way: &Vector2<f64>, velocity: &Vector2<f64>, radius_m: f64) -> bool {
    let speed = velocity.norm().max(LEAST_GROUND_SPEED_MPS);
    let (along_m, aside_m) = (way.dot(velocity) / speed, velocity.perp(way).abs() / speed);
    Vector2::new(along_m, aside_m - radius_m).norm() < radius_m
}

/// Whether a leg can still be joined so that its end is passed near enough: at an intercept of 37° most of the
/// sideways distance must be gone where the corner begins, and a turn back needs its own room.
fn has_room(offset: &Offset, velocity: &Vector2<f64>, radius_m: f64) -> bool {
    let course = velocity.y.atan2(velocity.x);
    let turned = wrap_angle(course - offset.track_rad).abs();
    let turning = if turned > 1.0 { 2.0 * radius_m } else { 0.0 };
    let reaction = velocity.norm() * REACTION_S;
    let straight = offset.left_m - radius_m - turning - reaction;
    let remaining = offset.right_m.abs() - TRACK_SHARE * straight;
    straight > -0.25 * radius_m && remaining < 0.6 * REACHED_SHARE * radius_m
}

/// Acceleration to the right (m/s²) that closes a cross-track error and follows the curvature (1/m):
/// `ẏ_ref = clamp(−0.5 y, ±0.6 V_g)`, `a = clamp(1.6 (ẏ_ref − ẏ) + V_g²/R, ±10.5)`; from a course more than 70° off
/// the wanted one it turns as hard as it may, the shorter way round. `agility`: share of both gains.
pub fn track_acceleration(offset: &Offset, velocity: &Vector2<f64>, curvature: f64, agility: f64) -> f64 {
    let speed = velocity.norm().max(LEAST_GROUND_SPEED_MPS);
    let closing = (-agility * TRACK_GAIN * offset.right_m).clamp(-TRACK_SHARE * speed, TRACK_SHARE * speed);
    let course = velocity.y.atan2(velocity.x);
    let error = wrap_angle(offset.track_rad + (closing / speed).asin() - course);
    if error.abs() > 1.2 {
        return HORIZONTAL_LIMIT_MPS2.copysign(error);
    }
    let sideways = speed * wrap_angle(course - offset.track_rad).sin();
    let wanted = agility * CLOSING_GAIN * (closing - sideways) + curvature * speed * speed;
    wanted.clamp(-HORIZONTAL_LIMIT_MPS2, HORIZONTAL_LIMIT_MPS2)
}

/// Acceleration to the right (m/s²) that turns the ground track to a wanted one (rad from north).
pub fn course_acceleration(track_rad: f64, velocity: &Vector2<f64>) -> f64 {
    let speed = velocity.norm().max(LEAST_GROUND_SPEED_MPS);
    let error = wrap_angle(track_rad - velocity.y.atan2(velocity.x));
    (COURSE_GAIN * speed * error).clamp(-HORIZONTAL_LIMIT_MPS2, HORIZONTAL_LIMIT_MPS2)
}

#[cfg(test)]
mod tests;
