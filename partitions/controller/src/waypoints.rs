//! The list of way-points: one is put together from the ground's messages, one is flown.
//!
//! Messages may be lost, come twice and in any order. A list is flown when all of it is there; after that, a point
//! that comes again with other values is moved at once. Whoever means a new list of as many points, and not points that
//! move, begins one of another count first: then it is put together and flown whole.

use bateleur_flight::guidance::{Guidance, GuidanceConfig, GuidanceError, MAX_WAYPOINTS, Step, Waypoint};
use bateleur_messages::ground;
use bateleur_messages::telemetry::Refusal;

use crate::orders::Answer;

/// What a way-point has done to the list that is flown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Change {
    /// Nothing.
    None,
    /// One of its points is elsewhere.
    Moved,
    /// It is another list.
    New,
}

/// Way-points, of which some may be missing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct List {
    pub(crate) count: usize,
    /// One bit for each point that is there.
    pub(crate) there: u32,
    pub(crate) points: [Waypoint; MAX_WAYPOINTS],
}

impl Default for List {
    fn default() -> Self {
        Self { count: 0, there: 0, points: [Waypoint::default(); MAX_WAYPOINTS] }
    }
}

impl List {
    /// An empty list that waits for so many points.
    fn of(count: usize) -> Self {
        Self { count, ..Self::default() }
    }

    /// The points, if all are there; empty otherwise.
    pub fn whole(&self) -> &[Waypoint] {
        if self.there.count_ones() as usize == self.count { &self.points[..self.count] } else { &[] }
    }
}

/// The list that is put together, and the one that is flown.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Waypoints {
    pub(crate) staged: List,
    pub(crate) flown: List,
}

impl Waypoints {
    /// The way-points to fly; empty before there are any.
    pub fn flown(&self) -> &[Waypoint] {
        self.flown.whole()
    }

    /// Flies these way-points.
    pub fn set(&mut self, points: &[Waypoint]) -> Result<(), GuidanceError> {
        Guidance::new(GuidanceConfig::default(), points)?; // checks number and values
        let mut list = List::of(points.len());
        list.points[..points.len()].copy_from_slice(points);
        list.there = u32::MAX >> (MAX_WAYPOINTS - points.len());
        (self.staged, self.flown) = (list, list);
        Ok(())
    }

    /// Takes one way-point; gives what has become of the list to fly.
    pub fn take(&mut self, message: &ground::Waypoint) -> Result<Change, Answer> {
        let (index, count) = (usize::from(message.index), usize::from(message.count));
        if count > MAX_WAYPOINTS || index >= count {
            return Err(Answer::Refused(Refusal::TooManyWaypoints));
        }
        let point = Waypoint {
            north_m: message.north_m,
            east_m: message.east_m,
            altitude_m: message.altitude_m,
            airspeed_mps: message.airspeed_mps,
            heading_rad: message.heading_rad,
            step: Step::from_numbers(message.step.to_numbers()),
        };
        if !point.is_sane() {
            return Err(Answer::NotUnderstood);
        }
        if self.staged.count != count {
            self.staged = List::of(count);
        }
        let was_whole = !self.staged.whole().is_empty();
        self.staged.points[index] = point;
        self.staged.there |= 1 << index;
        if self.staged.whole().is_empty() || self.staged == self.flown {
            return Ok(Change::None);
        }
        if Guidance::new(GuidanceConfig::default(), self.staged.whole()).is_err() {
            return Err(Answer::Refused(Refusal::NoSuchEntry));
        }
        self.flown = self.staged;
        Ok(if was_whole { Change::Moved } else { Change::New })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(index: u8, count: u8, north_m: f64) -> ground::Waypoint {
        ground::Waypoint {
            index,
            count,
            north_m,
            east_m: 0.0,
            altitude_m: 160.0,
            heading_rad: 0.0,
            airspeed_mps: 22.0,
            step: ground::Step::Pass,
        }
    }

    fn load(waypoints: &mut Waypoints, indices: std::ops::Range<u8>, count: u8, north_m: f64) {
        for index in indices {
            waypoints.take(&point(index, count, north_m)).unwrap();
        }
    }

    #[test]
    fn a_list_is_flown_when_all_of_it_is_there_in_any_order() {
        let mut waypoints = Waypoints::default();
        assert_eq!(waypoints.take(&point(2, 3, 300.0)), Ok(Change::None));
        assert_eq!(waypoints.take(&point(0, 3, 100.0)), Ok(Change::None));
        assert_eq!(waypoints.take(&point(0, 3, 100.0)), Ok(Change::None));
        assert!(waypoints.flown().is_empty());
        assert_eq!(waypoints.take(&point(1, 3, 200.0)), Ok(Change::New));
        let norths: Vec<_> = waypoints.flown().iter().map(|point| point.north_m).collect();
        assert_eq!(norths, [100.0, 200.0, 300.0]);
    }

    #[test]
    fn a_point_that_comes_again_changes_nothing_and_another_one_moves() {
        let mut waypoints = Waypoints::default();
        load(&mut waypoints, 0..2, 2, 100.0);
        assert_eq!(waypoints.take(&point(1, 2, 100.0)), Ok(Change::None));
        assert_eq!(waypoints.take(&point(1, 2, 150.0)), Ok(Change::Moved));
        assert_eq!(waypoints.flown()[1].north_m, 150.0);
    }

    #[test]
    fn a_longer_list_replaces_the_old_one_only_when_it_is_whole() {
        let mut waypoints = Waypoints::default();
        load(&mut waypoints, 0..2, 2, 100.0);
        load(&mut waypoints, 0..2, 3, 200.0);
        assert_eq!(waypoints.flown().len(), 2);
        assert_eq!(waypoints.take(&point(2, 3, 200.0)), Ok(Change::New));
        assert_eq!(waypoints.flown().len(), 3);
    }

    #[test]
    fn a_list_of_as_many_points_is_a_new_one_when_another_count_was_begun_before() {
        let mut waypoints = Waypoints::default();
        load(&mut waypoints, 0..2, 2, 100.0);
        assert_eq!(waypoints.take(&point(0, 3, 500.0)), Ok(Change::None));
        assert_eq!(waypoints.take(&point(0, 2, 500.0)), Ok(Change::None));
        assert_eq!(waypoints.flown()[0].north_m, 100.0, "flown whole or not at all");
        assert_eq!(waypoints.take(&point(1, 2, 500.0)), Ok(Change::New));
        // The same list once more is none: what is flown goes on.
        waypoints.take(&point(0, 3, 500.0)).unwrap();
        waypoints.take(&point(0, 2, 500.0)).unwrap();
        assert_eq!(waypoints.take(&point(1, 2, 500.0)), Ok(Change::None));
    }

    #[test]
    fn too_many_points_and_impossible_airspeeds_are_told_apart() {
        let mut waypoints = Waypoints::default();
        assert_eq!(waypoints.take(&point(0, 33, 0.0)), Err(Answer::Refused(Refusal::TooManyWaypoints)));
        let slow = ground::Waypoint { airspeed_mps: 1.0, ..point(0, 1, 0.0) };
        assert_eq!(waypoints.take(&slow), Err(Answer::NotUnderstood));
        let count = MAX_WAYPOINTS as u8;
        load(&mut waypoints, 0..count, count, 7.0);
        assert_eq!(waypoints.flown().len(), MAX_WAYPOINTS);
    }

    #[test]
    fn list_whose_jump_leads_nowhere_is_refused_and_what_was_flown_is_flown() {
        let mut waypoints = Waypoints::default();
        load(&mut waypoints, 0..2, 2, 100.0);
        let jump = |to| ground::Waypoint { step: ground::Step::Jump { to, times: 1 }, ..point(2, 3, 0.0) };
        load(&mut waypoints, 0..2, 3, 200.0);
        for to in [2, 3, 200] {
            assert_eq!(waypoints.take(&jump(to)), Err(Answer::Refused(Refusal::NoSuchEntry)), "{to}");
            assert_eq!(waypoints.flown().len(), 2);
        }
        assert_eq!(waypoints.take(&jump(1)).map(|_| waypoints.flown().len()), Ok(3));
    }

    #[test]
    fn the_plans_way_points_are_checked() {
        let mut waypoints = Waypoints::default();
        let good = Waypoint { airspeed_mps: 22.0, ..Waypoint::default() };
        assert_eq!(waypoints.set(&[good; MAX_WAYPOINTS]), Ok(()));
        assert_eq!(waypoints.flown().len(), MAX_WAYPOINTS);
        assert!(waypoints.set(&[Waypoint { north_m: f64::NAN, ..good }]).is_err());
        assert!(waypoints.set(&[good; 40]).is_err());
    }
}
