//! Circles in place of the mission: where it ended, where somebody said so, about a place to return to.
//!
//! A circle that is far off is joined along its tangent. It never ends by itself: whoever began it ends it.

use super::path::{Arc, Leg};
use super::{Guidance, Motion, STRONGEST_WIND_MPS, Stage};
use crate::attitude::wrap_angle;
use crate::kept::kept;
use nalgebra::Vector2;
use std::f64::consts::TAU;

/// Nearer to the centre than so many radii there is no room for a tangent: the circle is joined from where one is.
const NEAR: f64 = 1.5;
/// Centres so near to each other are those of one circle, m: the wind of the moment moves one that is laid out anew in each frame.
const SAME_M: f64 = 30.0;

/// A circle to fly.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Hold {
    /// North of the runway, m.
    pub north_m: f64,
    /// East of the runway, m.
    pub east_m: f64,
    /// m.
    pub radius_m: f64,
    /// +1 turns right, −1 left.
    pub side: f64,
    /// Above the runway, m.
    pub altitude_m: f64,
    /// m/s.
    pub airspeed_mps: f64,
}

impl Hold {
    fn centre(&self) -> Vector2<f64> {
        Vector2::new(self.north_m, self.east_m)
    }

    /// The whole circle.
    fn circle(&self) -> Arc {
        let (centre, radius_m, side) = (self.centre(), self.radius_m, self.side);
        Arc { centre, radius_m, side, start_rad: 0.0, sweep_rad: TAU, tangent_m: radius_m }
    }
}

kept!(Hold { north_m: f64, east_m: f64, radius_m: f64, side: f64, altitude_m: f64, airspeed_mps: f64 }
    if |hold| hold.side.abs() == 1.0 && hold.radius_m > 1.0 && hold.airspeed_mps > 1.0);

impl Guidance {
    /// The circle that is held.
    pub fn held(&self) -> Option<&Hold> {
        self.hold.as_ref()
    }

    /// Radius (m) of corners and circles in the wind of the moment.
    pub fn corner_radius_m(&self, motion: &Motion) -> f64 {
        self.radius_m(&motion.wind)
    }

    /// The same at an airspeed, m/s.
    pub fn radius_at_m(&self, airspeed_mps: f64, wind: &Vector2<f64>) -> f64 {
        self.config.corner_radius_m(airspeed_mps, wind.norm().min(STRONGEST_WIND_MPS))
    }

    /// Goes on with the mission, to the way-point that was next.
    pub fn release(&mut self) {
        self.disengage();
    }

    /// Holds a circle, and goes on with it where that is the one that is held.
    pub fn hold(&mut self, circle: Hold) {
        let same =
            |held: &Hold| (held.centre() - circle.centre()).norm() < SAME_M && held.side == circle.side;
        if self.hold.as_ref().is_some_and(same) {
            return;
        }
        (self.hold, self.stage, self.progress.circling) = (Some(circle), Stage::Idle, false);
    }

    /// Holds a circle that begins here and turns right.
    pub fn hold_here(&mut self, motion: &Motion, altitude_m: f64, airspeed_mps: f64) {
        self.begin_hold(motion, 1.0, altitude_m, airspeed_mps);
    }

    /// Holds a circle about a place, m north and east, turning as it is reached with the lesser turn.
    pub fn hold_at(&mut self, place: &Vector2<f64>, motion: &Motion, altitude_m: f64, airspeed_mps: f64) {
        let on = |side: f64| Hold {
            north_m: place.x,
            east_m: place.y,
            radius_m: self.radius_m(&motion.wind),
            side,
            altitude_m,
            airspeed_mps,
        };
        let (right, left) = (on(1.0), on(-1.0));
        let shorter = tangent_turn_rad(&left, motion) < tangent_turn_rad(&right, motion);
        self.hold = Some(if shorter { left } else { right });
        (self.stage, self.progress.circling) = (Stage::Idle, false);
    }

    /// The mission is over: on round the arc of the last corner, or on the side of the next turn.
    pub(super) fn hold_where_it_ended(&mut self, motion: &Motion) {
        // A list that is flown once stays at its last entry.
        let last = *self.waypoint(if self.program { self.next } else { self.next + self.count - 1 });
        if let Stage::Arc(arc, _) = self.stage {
            self.hold = Some(Hold {
                north_m: arc.centre.x,
                east_m: arc.centre.y,
                radius_m: arc.radius_m,
                side: arc.side,
                altitude_m: last.altitude_m,
                airspeed_mps: last.airspeed_mps,
            });
            self.stage = self.hold.map_or(Stage::Idle, |held| Stage::Hold(held.circle()));
            return;
        }
        let course = motion.velocity.y.atan2(motion.velocity.x);
        let turn = wrap_angle(self.leg().track_rad() - course);
        let side = if turn < 0.0 { -1.0 } else { 1.0 };
        self.begin_hold(motion, side, last.altitude_m, last.airspeed_mps);
    }

    fn begin_hold(&mut self, motion: &Motion, side: f64, altitude_m: f64, airspeed_mps: f64) {
        let course = motion.velocity.y.atan2(motion.velocity.x);
        let radius_m = self.radius_m(&motion.wind);
        let right = Vector2::new(-course.sin(), course.cos());
        // The bank needs its time, in which the aircraft goes straight on.
        let begin = motion.position + motion.velocity * self.lead_s();
        let centre = begin + right * (side * radius_m);
        let held = Hold { north_m: centre.x, east_m: centre.y, radius_m, side, altitude_m, airspeed_mps };
        (self.hold, self.progress.circling) = (Some(held), false);
        self.stage = Stage::Hold(held.circle());
    }

    pub(super) fn advance_hold(&mut self, held: Hold, motion: &Motion) {
        match self.stage {
            Stage::Hold(_) => {}
            Stage::ToHold(leg, circle) => {
                if leg.offset(&motion.position).left_m <= 0.0 {
                    self.stage = Stage::Hold(circle);
                }
            }
            _ => {
                let circle = held.circle();
                self.stage = tangent(&circle, &motion.position)
                    .map_or(Stage::Hold(circle), |leg| Stage::ToHold(leg, circle));
            }
        }
    }
}

/// Turn (rad) onto the tangent of a circle; zero from near it.
pub(super) fn tangent_turn_rad(held: &Hold, motion: &Motion) -> f64 {
    let course = motion.velocity.y.atan2(motion.velocity.x);
    let leg = tangent(&held.circle(), &motion.position);
    leg.map_or(0.0, |leg| wrap_angle(leg.track_rad() - course).abs())
}

/// The leg from a point to where it touches a circle; `None` if the point is too near to it.
fn tangent(circle: &Arc, from: &Vector2<f64>) -> Option<Leg> {
    let out = from - circle.centre;
    let distance = out.norm();
    if distance < NEAR * circle.radius_m {
        return None;
    }
    // Of the two points that touch, the one from which the track goes round the right way.
    let bearing = out.y.atan2(out.x) + circle.side * (circle.radius_m / distance).acos();
    let touch = circle.centre + Vector2::new(bearing.cos(), bearing.sin()) * circle.radius_m;
    Some(Leg { from: *from, to: touch })
}
