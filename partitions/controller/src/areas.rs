//! The fence's areas and the rally points that the ground has sent.
//!
//! Responsible for what is in force, and for where there is room. A list comes in force when all of it is there and it makes sense; until then
//! the one before holds.

use bateleur_messages::mark::{MOST_MARKS, Mark, MarkKind};
use bateleur_messages::telemetry::Refusal;
use nalgebra::Vector2;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::orders::Answer;

/// Points about a circle that are looked at where it has to fit into the fence, and between a place outside and the one to return to.
const AROUND: u32 = 12;
const STEPS: u32 = 40;

/// Kind, north m, east m, size: to a few millimetres.
type Numbers = [f32; 4];

/// One list.
#[derive(Debug, Clone, Copy, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct List {
    number: u32,
    count: u32,
    /// One bit for each mark that is there.
    there: u32,
    reserved: u32,
    marks: [Numbers; MOST_MARKS],
}

impl List {
    const EMPTY: Self = Self { number: 0, count: 0, there: 0, reserved: 0, marks: [[0.0; 4]; MOST_MARKS] };

    fn is_whole(&self) -> bool {
        self.there.count_ones() == self.count
    }

    fn marks(&self) -> &[Numbers] {
        self.marks.get(..self.count as usize).unwrap_or_default()
    }

    fn is_sane(&self) -> bool {
        self.count as usize <= MOST_MARKS && self.marks.iter().flatten().all(|number| number.is_finite())
    }
}

fn place_of(mark: &Numbers) -> Vector2<f64> {
    Vector2::new(f64::from(mark[1]), f64::from(mark[2]))
}

/// One area of the fence.
enum Area<'a> {
    Polygon(&'a [Numbers]),
    Circle(Vector2<f64>, f64),
}

impl Area<'_> {
    fn contains(&self, point: &Vector2<f64>) -> bool {
        match self {
            Self::Circle(centre, radius_m) => (point - centre).norm() <= *radius_m,
            Self::Polygon(corners) => {
                let pairs = corners.iter().map(place_of).zip(corners.iter().map(place_of).cycle().skip(1));
                // A line to the east crosses an odd number of edges from inside.
                let crossed = pairs.filter(|(from, to)| {
                    let spans = (from.x > point.x) != (to.x > point.x);
                    spans && point.y < from.y + (point.x - from.x) / (to.x - from.x) * (to.y - from.y)
                });
                crossed.count() % 2 == 1
            }
        }
    }
}

/// What the ground has sent: put together, and in force.
#[derive(Debug, Clone, Copy, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Areas {
    staged_fence: List,
    fence: List,
    staged_rally: List,
    rally: List,
}

impl Default for Areas {
    fn default() -> Self {
        Self { staged_fence: List::EMPTY, fence: List::EMPTY, staged_rally: List::EMPTY, rally: List::EMPTY }
    }
}

impl Areas {
    /// Whether the numbers are some of these.
    pub(crate) fn is_sane(&self) -> bool {
        let lists = [&self.staged_fence, &self.fence, &self.staged_rally, &self.rally];
        lists.into_iter().all(List::is_sane) && is_fence(&self.fence)
    }

    /// Takes a mark of either list.
    pub(crate) fn take(&mut self, mark: &Mark) -> Answer {
        let (index, count) = (usize::from(mark.index), usize::from(mark.count));
        if count > MOST_MARKS || index >= count.max(1) {
            return Answer::Refused(Refusal::TooManyWaypoints);
        }
        let (staged, force) = match mark.kind {
            MarkKind::Rally => (&mut self.staged_rally, &mut self.rally),
            _ => (&mut self.staged_fence, &mut self.fence),
        };
        if (staged.number, staged.count) != (u32::from(mark.list), u32::from(mark.count)) {
            *staged = List { number: u32::from(mark.list), count: u32::from(mark.count), ..List::EMPTY };
        }
        if count > 0 {
            staged.marks[index] =
                [f32::from(mark.kind as u8), mark.north_m as f32, mark.east_m as f32, mark.size as f32];
            staged.there |= 1 << index;
        }
        if !staged.is_whole() {
            return Answer::Accepted;
        }
        if mark.kind != MarkKind::Rally && !(is_fence(staged) && is_inside(staged, &Vector2::zeros())) {
            return Answer::Refused(Refusal::NoFence);
        }
        *force = *staged;
        Answer::Accepted
    }

    /// Whether a place (m north and east) is where the aircraft may be.
    pub(crate) fn allow(&self, place: &Vector2<f64>) -> bool {
        is_inside(&self.fence, place)
    }

    /// Whether a circle of this radius, m, is.
    fn has_room(&self, centre: &Vector2<f64>, radius_m: f64) -> bool {
        let around = (0..AROUND).map(|step| {
            let bearing = f64::from(step) * std::f64::consts::TAU / f64::from(AROUND);
            centre + Vector2::new(bearing.cos(), bearing.sin()) * radius_m
        });
        self.allow(centre) && around.into_iter().all(|point| self.allow(&point))
    }

    /// The place to return to from here, and the altitude there, m: the nearest of the rally points that lie inside the fence; `None`: the
    /// runway, which is as good as they are.
    pub(crate) fn refuge(&self, from: &Vector2<f64>) -> Option<(Vector2<f64>, f64)> {
        let points = self.rally.marks().iter().map(|mark| (place_of(mark), f64::from(mark[3])));
        let inside = points.filter(|(place, _)| self.allow(place));
        let nearest = inside.min_by(|a, b| (a.0 - from).norm().total_cmp(&(b.0 - from).norm()));
        nearest.filter(|(place, _)| (place - from).norm() < from.norm())
    }

    /// A circle's centre with room for `radius_m`: as wanted, or from there towards the place to return to.
    pub(crate) fn centre(&self, wanted: &Vector2<f64>, radius_m: f64) -> Vector2<f64> {
        let refuge = self.refuge(wanted).map_or_else(Vector2::zeros, |(place, _)| place);
        let way = |step: u32| wanted + (refuge - wanted) * (f64::from(step) / f64::from(STEPS));
        (0..STEPS).map(way).find(|centre| self.has_room(centre, radius_m)).unwrap_or(refuge)
    }
}

/// Each area of a fence, and whether it is one to stay in; `None` in place of one that makes no sense.
fn areas(list: &List) -> impl Iterator<Item = Option<(bool, Area<'_>)>> {
    let mut rest = list.marks();
    std::iter::from_fn(move || {
        let first = rest.first()?;
        let (centre, size) = (place_of(first), f64::from(first[3]));
        let kind = MarkKind::of_number(f64::from(first[0]));
        let corners = kind.filter(|kind| kind.is_corner()).map_or(1, |_| size as usize);
        let Some((area, behind)) = rest.split_at_checked(corners.max(1)) else {
            rest = &[];
            return Some(None);
        };
        rest = behind;
        let alike = area.iter().all(|mark| mark[0] == area[0][0] && mark[3] == area[0][3]);
        Some(match kind {
            Some(MarkKind::InclusionCorner | MarkKind::ExclusionCorner) if alike && corners >= 3 => {
                Some((kind == Some(MarkKind::InclusionCorner), Area::Polygon(area)))
            }
            Some(MarkKind::InclusionCircle | MarkKind::ExclusionCircle) => {
                Some((kind == Some(MarkKind::InclusionCircle), Area::Circle(centre, size)))
            }
            _ => None,
        })
    })
}

fn is_fence(list: &List) -> bool {
    areas(list).all(|area| area.is_some())
}

/// In one of those to stay in, where there are some, and in none of those to stay out of.
fn is_inside(list: &List, place: &Vector2<f64>) -> bool {
    let (mut asked, mut inside) = (false, false);
    for (stay_in, area) in areas(list).flatten() {
        let contains = area.contains(place);
        if !stay_in && contains {
            return false;
        }
        asked |= stay_in;
        inside |= stay_in && contains;
    }
    !asked || inside
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A list of marks in one go; the answer to the last.
    pub(crate) fn load(areas: &mut Areas, list: u8, marks: &[(MarkKind, f64, f64, f64)]) -> Answer {
        let count = marks.len() as u8;
        let mut answer = Answer::Accepted;
        for (index, (kind, north_m, east_m, size)) in (0..).zip(marks.iter().copied()) {
            answer = areas.take(&Mark { index, count, list, kind, north_m, east_m, size });
        }
        answer
    }

    const FIELD: [(MarkKind, f64, f64, f64); 5] = [
        (MarkKind::InclusionCorner, -500.0, -500.0, 4.0),
        (MarkKind::InclusionCorner, 1500.0, -500.0, 4.0),
        (MarkKind::InclusionCorner, 1500.0, 1500.0, 4.0),
        (MarkKind::InclusionCorner, -500.0, 1500.0, 4.0),
        (MarkKind::ExclusionCircle, 800.0, 800.0, 200.0),
    ];

    fn field() -> Areas {
        let mut areas = Areas::default();
        assert_eq!(load(&mut areas, 1, &FIELD), Answer::Accepted);
        areas
    }

    #[test]
    fn polygon_is_to_be_stayed_in_and_circle_out_of() {
        let areas = field();
        let allowed = |north, east| areas.allow(&Vector2::new(north, east));
        assert!(allowed(0.0, 0.0) && allowed(1400.0, -400.0) && allowed(800.0, 1100.0));
        assert!(!allowed(-600.0, 0.0) && !allowed(0.0, 1600.0) && !allowed(700.0, 800.0));
        assert!(Areas::default().allow(&Vector2::new(1e5, 0.0)), "no fence");
    }

    #[test]
    fn polygon_with_a_bay_is_left_in_the_bay_from_any_side() {
        let corner = |north, east| (MarkKind::InclusionCorner, north, east, 5.0);
        let arrow = [
            corner(-300.0, -300.0),
            corner(1000.0, 0.0),
            corner(400.0, 400.0),
            corner(1000.0, 900.0),
            corner(-300.0, 900.0),
        ];
        let mut areas = Areas::default();
        assert_eq!(load(&mut areas, 1, &arrow), Answer::Accepted);
        assert!(!areas.allow(&Vector2::new(700.0, 450.0)), "the bay");
        assert!(areas.allow(&Vector2::new(350.0, 400.0)) && areas.allow(&Vector2::new(700.0, 100.0)));
    }

    #[test]
    fn fence_comes_in_force_whole_and_in_any_order_and_parts_of_two_are_not_mixed() {
        let mut areas = Areas::default();
        let mark = |list, place: usize| {
            let (kind, north_m, east_m, size) = FIELD[place];
            Mark { index: place as u8, count: 5, list, kind, north_m, east_m, size }
        };
        for place in [3, 1, 4, 1, 0] {
            assert_eq!(areas.take(&mark(7, place)), Answer::Accepted);
            assert!(areas.allow(&Vector2::new(9_000.0, 0.0)));
        }
        // Another list begins: what was put together of the first is gone.
        areas.take(&mark(8, 2));
        assert!(areas.allow(&Vector2::new(9_000.0, 0.0)));
        for place in [0, 1, 3, 4] {
            areas.take(&mark(8, place));
        }
        assert!(!areas.allow(&Vector2::new(9_000.0, 0.0)));
        areas.take(&Mark::none(9, MarkKind::InclusionCorner));
        assert!(areas.allow(&Vector2::new(9_000.0, 0.0)), "cleared");
    }

    #[test]
    fn fence_without_the_runway_or_with_a_polygon_in_pieces_is_refused_and_the_one_before_holds() {
        let away = (MarkKind::InclusionCircle, 5_000.0, 0.0, 300.0);
        let over = (MarkKind::ExclusionCircle, 50.0, 0.0, 100.0);
        let pieces = [FIELD[0], FIELD[1], FIELD[4], FIELD[2], FIELD[3]];
        for (list, wrong) in [(2, &[away][..]), (3, &[over]), (4, &FIELD[..3]), (5, &pieces)] {
            let mut areas = field();
            assert_eq!(load(&mut areas, list, wrong), Answer::Refused(Refusal::NoFence), "{wrong:?}");
            assert!(!areas.allow(&Vector2::new(-600.0, 0.0)) && areas.is_sane());
        }
    }

    #[test]
    fn refuge_is_the_nearest_rally_point_inside_or_the_runway() {
        let mut areas = field();
        let rally = |north, east| (MarkKind::Rally, north, east, 120.0);
        let points = [rally(1200.0, 0.0), rally(800.0, 800.0), rally(2500.0, 2500.0)];
        assert_eq!(load(&mut areas, 1, &points), Answer::Accepted);
        let refuge =
            |north, east| areas.refuge(&Vector2::new(north, east)).map(|(place, _)| (place.x, place.y));
        assert_eq!(refuge(1300.0, 1400.0), Some((1200.0, 0.0)), "the nearer ones are outside of the fence");
        assert_eq!(refuge(200.0, 100.0), None, "the runway is nearer");
    }

    #[test]
    fn circle_is_moved_until_it_fits() {
        let areas = field();
        for (north, east) in
            [(1600.0, 0.0), (-700.0, 1400.0), (800.0, 800.0), (1500.0, 1500.0), (0.0, -800.0)]
        {
            let centre = areas.centre(&Vector2::new(north, east), 150.0);
            assert!(areas.has_room(&centre, 150.0), "{north} {east}: {centre}");
        }
    }
}
