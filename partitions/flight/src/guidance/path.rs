//! The path over ground: legs between way-points, joined by fillet arcs.
//!
//! Pure geometry in the horizontal plane, north and east in metres. Guidance flies it and a report scores it, so
//! both ask the same functions.

use super::{MAX_WAYPOINTS, Waypoint};
use crate::attitude::wrap_angle;
use crate::kept::kept;
use nalgebra::Vector2;
use std::f64::consts::FRAC_PI_2;

/// Turns sharper than this, rad, get no fillet: its tangents would reach back beyond the leg.
const SHARPEST_FILLET_RAD: f64 = 2.6;
/// A fillet may take up this share of either leg, so that two of them leave a straight piece.
const LARGEST_LEG_SHARE: f64 = 0.45;
/// One that is tighter than this share of what the aircraft turns with is none: the way-point itself is passed.
const TIGHTEST_SHARE: f64 = 0.6;

/// A straight piece.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Leg {
    /// Start, m.
    pub from: Vector2<f64>,
    /// End, m.
    pub to: Vector2<f64>,
}

/// The arc at a way-point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Arc {
    /// Centre, m.
    pub centre: Vector2<f64>,
    /// m.
    pub radius_m: f64,
    /// +1 turns right, −1 left.
    pub side: f64,
    /// Bearing from the centre to where the arc begins, rad.
    pub start_rad: f64,
    /// Angle turned through, rad, positive.
    pub sweep_rad: f64,
    /// Distance from its ends to the way-point, m.
    pub tangent_m: f64,
}

kept!(Leg { from: Vector2<f64>, to: Vector2<f64> });
kept!(Arc {
    centre: Vector2<f64>,
    radius_m: f64,
    side: f64,
    start_rad: f64,
    sweep_rad: f64,
    tangent_m: f64,
} if |arc| arc.side.abs() == 1.0 && arc.radius_m > 1.0);

/// Position relative to a piece of path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Offset {
    /// Distance to the right of the track, m.
    pub right_m: f64,
    /// Way flown on the piece, m (negative before its start).
    pub along_m: f64,
    /// Way left, m (negative after its end).
    pub left_m: f64,
    /// Direction of the track here, rad from north.
    pub track_rad: f64,
}

impl Leg {
    /// Length, m.
    pub fn length_m(&self) -> f64 {
        (self.to - self.from).norm()
    }

    /// Direction, rad from north.
    pub fn track_rad(&self) -> f64 {
        let way = self.to - self.from;
        way.y.atan2(way.x)
    }

    /// Where a point lies relative to the leg.
    pub fn offset(&self, point: &Vector2<f64>) -> Offset {
        let track_rad = self.track_rad();
        let forward = Vector2::new(track_rad.cos(), track_rad.sin());
        let right = Vector2::new(-forward.y, forward.x);
        let relative = point - self.from;
        let along_m = relative.dot(&forward);
        Offset { right_m: relative.dot(&right), along_m, left_m: self.length_m() - along_m, track_rad }
    }
}

impl Arc {
    /// The fillet between two legs that meet, as wide as `radius_m` and the legs allow; `None` where the track goes
    /// straight on or turns back, or the legs leave no room for an aircraft that turns with `turn_m`.
    pub fn between(inbound: &Leg, outbound: &Leg, radius_m: f64, turn_m: f64) -> Option<Self> {
        let turn = wrap_angle(outbound.track_rad() - inbound.track_rad());
        if turn.abs() < 1e-3 || turn.abs() > SHARPEST_FILLET_RAD {
            return None;
        }
        let half = (0.5 * turn.abs()).tan();
        let room = LARGEST_LEG_SHARE * inbound.length_m().min(outbound.length_m());
        let tangent_m = (radius_m * half).min(room);
        let least_m = TIGHTEST_SHARE * radius_m.min(turn_m);
        let radius_m = tangent_m / half;
        if radius_m < least_m {
            return None;
        }
        let side = turn.signum();
        let track = inbound.track_rad();
        let forward = Vector2::new(track.cos(), track.sin());
        let right = Vector2::new(-forward.y, forward.x);
        let begin = inbound.to - forward * tangent_m;
        let centre = begin + right * (side * radius_m);
        let start_rad = track - side * FRAC_PI_2;
        Some(Self { centre, radius_m, side, start_rad, sweep_rad: turn.abs(), tangent_m })
    }

    /// Where a point lies relative to the arc.
    pub fn offset(&self, point: &Vector2<f64>) -> Offset {
        let relative = point - self.centre;
        let bearing = relative.y.atan2(relative.x);
        // Half the way round past the middle of the arc counts as before it, the other half as after it.
        let middle = self.start_rad + self.side * 0.5 * self.sweep_rad;
        let turned = self.side * wrap_angle(bearing - middle) + 0.5 * self.sweep_rad;
        Offset {
            right_m: self.side * (self.radius_m - relative.norm()),
            along_m: turned * self.radius_m,
            left_m: (self.sweep_rad - turned) * self.radius_m,
            track_rad: wrap_angle(bearing + self.side * FRAC_PI_2),
        }
    }
}

/// A kind of piece, for a score that looks at straight legs alone.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Piece {
    /// The straight part of the leg that leads to the way-point of this index.
    Leg(usize),
    /// The arc at the way-point of this index.
    Arc(usize),
}

/// A closed circuit of way-points with its fillets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Circuit {
    legs: [Leg; MAX_WAYPOINTS],
    arcs: [Option<Arc>; MAX_WAYPOINTS],
    count: usize,
}

impl Circuit {
    /// The circuit through all way-points (at most [`MAX_WAYPOINTS`]) and back to the first, with one radius.
    /// A radius of zero gives the polygon itself (the fly-through path). The aircraft turns with `turn_m`.
    pub fn new(waypoints: &[Waypoint], radius_m: f64, turn_m: f64) -> Self {
        let count = waypoints.len().min(MAX_WAYPOINTS);
        let nowhere = Leg { from: Vector2::zeros(), to: Vector2::zeros() };
        let mut circuit = Self { legs: [nowhere; MAX_WAYPOINTS], arcs: [None; MAX_WAYPOINTS], count };
        for i in 0..count {
            let from = waypoints[(i + count - 1) % count].horizontal();
            circuit.legs[i] = Leg { from, to: waypoints[i].horizontal() };
        }
        if radius_m > 0.0 {
            for i in 0..count {
                let (leg, after) = (&circuit.legs[i], &circuit.legs[(i + 1) % count]);
                circuit.arcs[i] = Arc::between(leg, after, radius_m, turn_m);
            }
        }
        circuit
    }

    /// The whole leg that leads to way-point `i`.
    pub fn leg(&self, i: usize) -> &Leg {
        &self.legs[i % self.count.max(1)]
    }

    /// The fillet at way-point `i`.
    pub fn arc(&self, i: usize) -> Option<&Arc> {
        self.arcs[i % self.count.max(1)].as_ref()
    }

    /// Distance to the right of the nearest piece of the circuit, m, and that piece; `None` without way-points.
    pub fn nearest(&self, point: &Vector2<f64>) -> Option<(f64, Piece)> {
        let pieces = (0..self.count).flat_map(|i| [Piece::Leg(i), Piece::Arc(i)]);
        let near = pieces.filter_map(|piece| self.distance(piece, point).map(|(d, right)| (d, right, piece)));
        near.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, right, piece)| (right, piece))
    }

    /// Distance to a piece as an end-limited line, and how far right of it.
    fn distance(&self, piece: Piece, point: &Vector2<f64>) -> Option<(f64, f64)> {
        let offset = match piece {
            Piece::Arc(i) => self.arcs[i].as_ref()?.offset(point),
            Piece::Leg(i) => {
                let before = self.arcs[(i + self.count - 1) % self.count].map_or(0.0, |arc| arc.tangent_m);
                let after = self.arcs[i].map_or(0.0, |arc| arc.tangent_m);
                let offset = self.legs[i].offset(point);
                let along_m = offset.along_m - before;
                Offset { along_m, left_m: offset.left_m - after, ..offset }
            }
        };
        let beyond = (-offset.along_m).max(-offset.left_m).max(0.0);
        let distance = Vector2::new(offset.right_m, beyond).norm();
        Some((distance, distance.copysign(offset.right_m)))
    }
}

#[cfg(test)]
mod tests {
    use super::super::seed_waypoints;
    use super::*;

    #[test]
    fn leg_offset_is_positive_on_the_right() {
        let leg = Leg { from: Vector2::new(0.0, 0.0), to: Vector2::new(500.0, 0.0) };
        let offset = leg.offset(&Vector2::new(100.0, 7.0));
        assert!((offset.right_m - 7.0).abs() < 1e-9 && (offset.left_m - 400.0).abs() < 1e-9);
    }

    #[test]
    fn fillet_touches_both_legs() {
        let circuit = Circuit::new(&seed_waypoints(), 70.0, 70.0);
        let arc = circuit.arc(0).unwrap();
        assert!((arc.centre - Vector2::new(430.0, 70.0)).norm() < 1e-9);
        assert!((arc.tangent_m - 70.0).abs() < 1e-9 && arc.side > 0.0);
        let begin = arc.offset(&Vector2::new(430.0, 0.0));
        assert!(begin.along_m.abs() < 1e-9 && begin.right_m.abs() < 1e-9 && begin.track_rad.abs() < 1e-9);
        let end = arc.offset(&Vector2::new(500.0, 70.0));
        assert!(end.left_m.abs() < 1e-9);
        assert!((end.track_rad - FRAC_PI_2).abs() < 1e-9);
    }

    #[test]
    fn left_turn_has_its_centre_on_the_left() {
        let inbound = Leg { from: Vector2::new(0.0, 0.0), to: Vector2::new(300.0, 0.0) };
        let outbound = Leg { from: inbound.to, to: Vector2::new(300.0, -300.0) };
        let arc = Arc::between(&inbound, &outbound, 50.0, 50.0).unwrap();
        assert!((arc.centre - Vector2::new(250.0, -50.0)).norm() < 1e-9);
        // Outside of a left turn is right of the track.
        assert!(arc.offset(&Vector2::new(251.0, 3.0)).right_m > 2.9);
    }

    #[test]
    fn wide_fillets_shrink_to_the_legs_and_reversals_get_none() {
        let inbound = Leg { from: Vector2::new(0.0, 0.0), to: Vector2::new(100.0, 0.0) };
        let square = Leg { from: inbound.to, to: Vector2::new(100.0, 100.0) };
        assert!((Arc::between(&inbound, &square, 500.0, 70.0).unwrap().radius_m - 45.0).abs() < 1e-9);
        assert_eq!(Arc::between(&inbound, &square, 500.0, 80.0), None, "tighter than it turns");
        let back = Leg { from: inbound.to, to: inbound.from };
        assert!(Arc::between(&inbound, &back, 50.0, 50.0).is_none());
    }

    #[test]
    fn score_sees_the_nearest_piece_and_its_side() {
        let circuit = Circuit::new(&seed_waypoints(), 70.0, 70.0);
        let (right, piece) = circuit.nearest(&Vector2::new(250.0, -3.0)).unwrap();
        assert!((right + 3.0).abs() < 1e-9);
        assert_eq!(piece, Piece::Leg(0));
        // The way-point itself lies outside of the fillet, which turns right: left of track.
        let (right, piece) = circuit.nearest(&Vector2::new(500.0, 0.0)).unwrap();
        assert!((right + 70.0 * (2f64.sqrt() - 1.0)).abs() < 1e-9);
        assert_eq!(piece, Piece::Arc(0));
    }
}
