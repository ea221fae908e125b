//! Where the aircraft may be: within a distance of the runway, between a floor and a ceiling, and in the areas that the ground has sent.
//!
//! Responsible for the verdict, and for where to fly then. It judges the estimated position, and only while the autopilot flies.

use bateleur_flight::control::landing::LandingConfig;
use bateleur_flight::estimator::NavigationState;
use nalgebra::Vector2;

use crate::areas::Areas;

/// The floor counts from so much above it on, m: a take-off begins below.
const ABOVE_FLOOR_M: f64 = 5.0;
/// Heights are kept so far inside, m, and circles so many of their radii.
const INSIDE_M: f64 = 10.0;
const INSIDE_RADII: f64 = 2.5;
/// What an approach needs beside its glide slope, m, and the least height that it begins at, m.
const LEVEL_ROOM_M: f64 = 300.0;
const LEAST_APPROACH_M: f64 = 25.0;

/// What is done where it is left.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum FenceAction {
    /// It is told.
    None,
    /// A circle inside, near to where it was left.
    Loiter,
    /// Back to the runway.
    #[default]
    Return,
}

/// The fence.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Fence {
    /// Greatest distance from the runway, m.
    pub radius_m: Option<f64>,
    /// Least height above the runway, m.
    pub floor_m: Option<f64>,
    /// Greatest height above the runway, m.
    pub ceiling_m: Option<f64>,
    /// What is done.
    pub action: FenceAction,
}

impl Fence {
    /// Whether its numbers leave room to fly in.
    ///
    /// # Errors
    /// A sentence with the attribute.
    pub fn check(&self) -> Result<(), String> {
        if self.radius_m.is_some_and(|radius_m| !(radius_m >= 300.0 && radius_m.is_finite())) {
            return Err("attribute fence_radius_m: give 300 m or more; a circle has to fit in".into());
        }
        let (floor, ceiling) = (self.floor_m.unwrap_or(0.0), self.ceiling_m.unwrap_or(f64::MAX));
        if ceiling - floor >= 4.0 * INSIDE_M && floor.is_finite() {
            return Ok(());
        }
        Err("attributes fence_floor_m and fence_ceiling_m: leave 40 m between them".into())
    }

    /// A height (m) within the fence.
    pub fn height_m(&self, wanted_m: f64) -> f64 {
        let least = self.floor_m.map_or(f64::NEG_INFINITY, |floor_m| floor_m + INSIDE_M);
        let most = self.ceiling_m.map_or(f64::INFINITY, |ceiling_m| ceiling_m - INSIDE_M);
        wanted_m.max(least).min(most)
    }

    /// Height (m) at which a final approach begins, for circles of `radius_m` beside it: lower where the fence is near, or there would
    /// be no room for it.
    pub fn approach_m(&self, landing: &LandingConfig, radius_m: f64) -> f64 {
        let room_m =
            self.radius_m.map_or(f64::INFINITY, |fence_m| fence_m - INSIDE_RADII * radius_m - LEVEL_ROOM_M);
        landing.height_m.min((room_m * landing.slope_rad.tan()).max(LEAST_APPROACH_M))
    }

    /// A circle's centre within the fence, for circles of `radius_m`.
    pub fn centre(&self, wanted: &Vector2<f64>, radius_m: f64) -> Vector2<f64> {
        let room =
            self.radius_m.map_or(f64::INFINITY, |fence_m| (fence_m - INSIDE_RADII * radius_m).max(0.0));
        if wanted.norm() > room { wanted * (room / wanted.norm()) } else { *wanted }
    }
}

/// Remembers whether the fence was left.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct FenceWatch {
    /// The aircraft is outside.
    pub(crate) outside: bool,
    /// It has been above the floor.
    pub(crate) above_floor: bool,
}

impl FenceWatch {
    /// Looks at a state; true when it has just been left.
    pub(crate) fn look(&mut self, fence: &Fence, areas: &Areas, state: &NavigationState) -> bool {
        let (height_m, away_m) = (state.altitude_m(), state.position.xy().norm());
        self.above_floor |= fence.floor_m.is_some_and(|floor_m| height_m > floor_m + ABOVE_FLOOR_M);
        let beyond = fence.radius_m.is_some_and(|radius_m| away_m > radius_m);
        let above = fence.ceiling_m.is_some_and(|ceiling_m| height_m > ceiling_m);
        let below = self.above_floor && fence.floor_m.is_some_and(|floor_m| height_m < floor_m);
        let outside = beyond || above || below || !areas.allow(&state.position.xy());
        let before = std::mem::replace(&mut self.outside, outside);
        outside && !before
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fence_without_room_is_refused() {
        let fence = |radius_m, floor_m, ceiling_m| Fence { radius_m, floor_m, ceiling_m, ..Fence::default() };
        assert_eq!(fence(None, None, None).check(), Ok(()));
        assert_eq!(fence(Some(1000.0), Some(50.0), Some(300.0)).check(), Ok(()));
        assert!(fence(Some(100.0), None, None).check().is_err());
        assert!(fence(Some(f64::NAN), None, None).check().is_err());
        assert!(fence(None, Some(100.0), Some(120.0)).check().is_err());
    }

    #[test]
    fn circle_and_height_are_moved_inside() {
        let fence =
            Fence { radius_m: Some(1000.0), floor_m: Some(50.0), ceiling_m: Some(200.0), ..Fence::default() };
        assert_eq!(
            (fence.height_m(250.0), fence.height_m(20.0), fence.height_m(100.0)),
            (190.0, 60.0, 100.0)
        );
        let centre = fence.centre(&Vector2::new(0.0, 990.0), 80.0);
        assert!((centre - Vector2::new(0.0, 800.0)).norm() < 1e-9);
        assert_eq!(fence.centre(&Vector2::new(10.0, 20.0), 80.0), Vector2::new(10.0, 20.0));
    }
}
