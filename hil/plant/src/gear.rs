//! Ground contact: seven points with spring, damper and friction on a level runway that has no end.

use crate::airframe::Gear;
use crate::rigid_body::{Loads, RigidState};
use nalgebra::{Vector2, Vector3};

/// Friction is full from about this sliding speed on, m/s. Smaller makes the equations too stiff for a step of 2.5 ms,
/// larger lets a parked aircraft creep faster in a side wind.
const SLIP_MPS: f64 = 0.05;
/// A part of the structure this deep in the ground is broken, m.
const CRUSH_M: f64 = 0.3;
/// Wheels spring, the structure merely scrapes: its spring and damper in parts of a wheel's.
const SCRAPE: f64 = 0.4;
/// Banked more than this while touching the ground, the aircraft is lost, as the cosine of the tilt (75°).
const LARGEST_TILT_COS: f64 = 0.26;
const WHEELS: usize = 3;
const NOSE: usize = 3;
const STEERED: usize = 2;

/// Points of contact in body axes: left and right wheel, steered wheel, nose, tail, left and right wing tip.
#[derive(Clone, Debug)]
pub(crate) struct GroundContact {
    points: [Vector3<f64>; 7],
    gear: Gear,
    reach_m: f64,
    steering: f64,
}

/// How one point meets the ground.
struct Touch {
    depth: f64,
    velocity: Vector3<f64>,
}

impl GroundContact {
    pub(crate) fn new(gear: &Gear) -> Self {
        let mirror = |p: [f64; 3]| Vector3::new(p[0], -p[1], p[2]);
        let points = [
            mirror(gear.main_wheel_m),
            Vector3::from(gear.main_wheel_m),
            Vector3::from(gear.third_wheel_m),
            Vector3::from(gear.nose_m),
            Vector3::from(gear.tail_m),
            mirror(gear.wing_tip_m),
            Vector3::from(gear.wing_tip_m),
        ];
        let reach_m = points.iter().map(|p| p.norm()).fold(0.0, f64::max);
        // A positive rudder asks for the nose to the left: a wheel ahead of the centre of gravity turns left, one
        // behind it turns right.
        let steering = -gear.steering_ratio * gear.third_wheel_m[0].signum();
        Self { points, gear: gear.clone(), reach_m, steering }
    }

    /// Whether anything could touch.
    pub(crate) fn near(&self, state: &RigidState) -> bool {
        -state.position.z <= self.reach_m
    }

    fn touch(&self, state: &RigidState, point: usize) -> Option<Touch> {
        let arm = self.points[point];
        let depth = state.position.z + (state.attitude * arm).z;
        (depth > 0.0)
            .then(|| Touch { depth, velocity: state.velocity + state.attitude * state.rates.cross(&arm) })
    }

    /// Whether any point is on the ground.
    pub(crate) fn touches(&self, state: &RigidState) -> bool {
        self.near(state) && (0..self.points.len()).any(|point| self.touch(state, point).is_some())
    }

    /// Whether the aircraft has just been lost.
    pub(crate) fn crash(&self, state: &RigidState) -> bool {
        if !self.near(state) {
            return false;
        }
        let upright = (state.attitude * Vector3::z()).z;
        (0..self.points.len()).any(|point| {
            let Some(touch) = self.touch(state, point) else { return false };
            let limit = self.gear.crash_sink_mps * if point < WHEELS { 1.0 } else { 0.5 };
            let crushed = point >= WHEELS && touch.depth > CRUSH_M;
            // A propeller that strikes the ground is damage at any speed.
            point == NOSE || touch.velocity.z > limit || crushed || upright < LARGEST_TILT_COS
        })
    }

    /// Forces of the ground, body axes.
    pub(crate) fn loads(&self, state: &RigidState, rudder_rad: f64) -> Loads {
        let mut total = Loads::default();
        if !self.near(state) {
            return total;
        }
        for point in 0..self.points.len() {
            let Some(touch) = self.touch(state, point) else { continue };
            let angle = if point == STEERED { self.steering * rudder_rad } else { 0.0 };
            let force = self.point_force(state, point, &touch, angle);
            total.force += force;
            total.moment += self.points[point].cross(&force);
        }
        total
    }

    /// Force on one point, body axes, N; a wheel is turned by `angle`, rad.
    fn point_force(&self, state: &RigidState, point: usize, touch: &Touch, angle: f64) -> Vector3<f64> {
        let (part, along) = if point < WHEELS {
            (1.0, self.gear.rolling_friction)
        } else {
            (SCRAPE, self.gear.lateral_friction)
        };
        let press =
            part * (self.gear.spring_n_per_m * touch.depth + self.gear.damping_ns_per_m * touch.velocity.z);
        let normal = press.max(0.0);
        let forward = state.attitude * Vector3::new(angle.cos(), angle.sin(), 0.0);
        let length = forward.xy().norm().max(1e-6);
        let (north, east) = (forward.x / length, forward.y / length);
        let rolling = touch.velocity.x * north + touch.velocity.y * east;
        let sliding = touch.velocity.y * north - touch.velocity.x * east;
        let (drag, side) =
            (-normal * along * saturate(rolling), -normal * self.gear.lateral_friction * saturate(sliding));
        let ned = Vector3::new(drag * north - side * east, drag * east + side * north, -normal);
        state.attitude.inverse() * ned
    }
}

/// Sign of the speed, smoothed about zero.
fn saturate(speed: f64) -> f64 {
    speed / Vector2::new(speed, SLIP_MPS).norm()
}
