//! The path that was to be flown.
//!
//! The geometry is guidance's own. The radius of each fillet is what guidance chose when it began the leg before it: fixed
//! where it is set, else from the wind that the Estimator saw at that instant. So the score takes from the aircraft which path
//! it meant to fly, and nothing about where it was.

use crate::flight::{Flight, Inputs};
use crate::mission::Passage;
use bateleur_flight::GRAVITY_MPS2;
use bateleur_flight::guidance::path::{Arc, Circuit, Piece};
use bateleur_flight::guidance::{Corner, GuidanceConfig, Waypoint};
use bateleur_messages::State;
use nalgebra::Vector2;

/// Where a corner has no passage yet, its radius takes over this long after its leg began, ns.
const TAKE_OVER_NS: u64 = 3_000_000_000;
/// Pieces that an arc is drawn with, one for each of these angles, rad.
const DRAWN_STEP_RAD: f64 = 0.05;

/// The circuit as planned, which changes its radius from corner to corner.
#[derive(Debug, Clone)]
pub struct Planned {
    waypoints: Vec<Waypoint>,
    stages: Vec<Stage>,
}

#[derive(Debug, Clone)]
struct Stage {
    from_ns: u64,
    radius_m: f64,
    circuit: Circuit,
}

impl Planned {
    /// The path of a flight.
    pub fn of(flight: &Flight, passages: &[Passage]) -> Self {
        let config = &flight.inputs.guidance;
        let fixed = if config.corner == Corner::FlyThrough { Some(0.0) } else { config.radius_m };
        match fixed {
            Some(radius_m) => Self::fixed(&flight.inputs.waypoints, radius_m),
            None => Self::from_wind(flight, passages),
        }
    }

    /// The path with one radius throughout, m; zero flies through the way-points.
    pub fn fixed(waypoints: &[Waypoint], radius_m: f64) -> Self {
        let mut planned = Self { waypoints: waypoints.to_vec(), stages: Vec::new() };
        planned.push(0, radius_m);
        planned
    }

    fn from_wind(flight: &Flight, passages: &[Passage]) -> Self {
        let Inputs { waypoints, guidance, .. } = &flight.inputs;
        let mut planned = Self { waypoints: waypoints.clone(), stages: Vec::new() };
        let engaged = flight.commands.iter().find(|(_, command)| command.engaged != 0);
        let mut begun_ns = engaged.map_or(0, |(time, _)| *time);
        for corner in 0..=passages.len() {
            let index =
                passages.get(corner).map_or_else(|| after_last(passages, waypoints.len()), |at| at.index);
            let radius_m = radius_m(guidance, waypoints.get(index), state_at(&flight.states, begun_ns));
            planned.push(take_over(begun_ns, passages.get(corner)), radius_m);
            if let Some(passage) = passages.get(corner) {
                begun_ns = planned.corner_left(&flight.states, passage);
            }
        }
        planned
    }

    fn push(&mut self, from_ns: u64, radius_m: f64) {
        // What lies before the first stage belongs to it.
        let from_ns = if self.stages.is_empty() { 0 } else { from_ns };
        self.stages.push(Stage { from_ns, radius_m, circuit: Circuit::new(&self.waypoints, radius_m) });
    }

    /// When the fillet at a way-point came to its end, ns, by the Estimator's position.
    fn corner_left(&self, states: &[(u64, State)], passage: &Passage) -> u64 {
        let Some(arc) = self.stages.last().and_then(|stage| stage.circuit.arc(passage.index)) else {
            return passage.time_ns;
        };
        let from = states.partition_point(|(time, _)| *time < passage.time_ns);
        let over = |state: &State| {
            let [north, east, _] = state.position_ned_m;
            arc.offset(&Vector2::new(north, east)).left_m <= 0.0
        };
        states[from..].iter().find(|(_, state)| over(state)).map_or(passage.time_ns, |(time, _)| *time)
    }

    fn stage(&self, time_ns: u64) -> Option<&Stage> {
        let after = self.stages.partition_point(|stage| stage.from_ns <= time_ns);
        self.stages.get(after.saturating_sub(1))
    }

    /// Distance to the right of the path, m, of a point at a module time, ns, and whether a straight leg is the nearest
    /// piece of it.
    pub fn cross_track(&self, time_ns: u64, point: &Vector2<f64>) -> Option<(f64, bool)> {
        let (right_m, piece) = self.stage(time_ns)?.circuit.nearest(point)?;
        Some((right_m, matches!(piece, Piece::Leg(_))))
    }

    /// The radius of each corner in the order flown, m.
    pub fn radii_m(&self) -> Vec<f64> {
        self.stages.iter().map(|stage| stage.radius_m).collect()
    }

    /// The circuit in force at a module time, ns, as points north and east, m, to be drawn.
    pub fn outline(&self, time_ns: u64) -> Vec<Vector2<f64>> {
        let Some(stage) = self.stage(time_ns) else { return Vec::new() };
        let mut points = Vec::new();
        for index in 0..self.waypoints.len() {
            match stage.circuit.arc(index) {
                Some(arc) => points.extend(drawn(arc)),
                None => points.push(self.waypoints[index].horizontal()),
            }
        }
        points.extend(points.first().copied());
        points
    }
}

fn take_over(begun_ns: u64, passage: Option<&Passage>) -> u64 {
    passage.map_or(begun_ns + TAKE_OVER_NS, |passage| begun_ns.midpoint(passage.time_ns.max(begun_ns)))
}

fn after_last(passages: &[Passage], count: usize) -> usize {
    passages.last().map_or(0, |passage| (passage.index + 1) % count.max(1))
}

fn state_at(states: &[(u64, State)], time_ns: u64) -> Option<&State> {
    let at = states.partition_point(|(time, _)| *time < time_ns).min(states.len().saturating_sub(1));
    states.get(at).map(|(_, state)| state)
}

/// Guidance's rule: the design bank suffices with the whole wind from behind, (V + W)²/(g tan φ), but not below its
/// least radius.
fn radius_m(config: &GuidanceConfig, target: Option<&Waypoint>, state: Option<&State>) -> f64 {
    let wind = state.map_or(0.0, |state| state.wind_ne_mps[0].hypot(state.wind_ne_mps[1]));
    let fastest =
        target.map_or(0.0, |target| target.airspeed_mps) + if wind.is_finite() { wind } else { 0.0 };
    let needed = fastest * fastest / (GRAVITY_MPS2 * config.turn_bank_rad.tan());
    needed.max(config.least_radius_m)
}

fn drawn(arc: &Arc) -> Vec<Vector2<f64>> {
    let steps = (arc.sweep_rad / DRAWN_STEP_RAD).ceil().max(1.0) as usize;
    let at = |step: usize| {
        let bearing = arc.start_rad + arc.side * arc.sweep_rad * step as f64 / steps as f64;
        arc.centre + Vector2::new(bearing.cos(), bearing.sin()) * arc.radius_m
    };
    (0..=steps).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_flight::guidance::seed_waypoints;
    use bateleur_messages::ActuatorCommand;

    #[test]
    fn wind_widens_the_corners_as_guidance_does() {
        let config = GuidanceConfig::default();
        let target = seed_waypoints()[0];
        let windy = State { wind_ne_mps: [0.0, 8.0], ..Default::default() };
        assert_eq!(radius_m(&config, Some(&target), None), 70.0);
        assert!((radius_m(&config, Some(&target), Some(&windy)) - 109.4).abs() < 0.1);
    }

    #[test]
    fn each_corner_has_the_radius_of_its_own_wind() {
        let wind = |time: u64, wind: f64| {
            let position_ned_m = [500.0, 200.0, -160.0];
            (time, State { wind_ne_mps: [wind, 0.0], position_ned_m, ..Default::default() })
        };
        let engaged = ActuatorCommand { engaged: 1, ..Default::default() };
        let flight = Flight {
            states: vec![wind(0, 0.0), wind(1_000, 8.0), wind(9_000, 8.0)],
            commands: vec![(0, engaged)],
            ..Default::default()
        };
        let first = Passage { index: 0, time_ns: 1_000, distance_m: None, verified: true };
        let planned = Planned::of(&flight, &[first]);
        let radii = planned.radii_m();
        assert!(radii.len() == 2 && radii[0] == 70.0 && (radii[1] - 109.4).abs() < 0.1);
        // The corner's middle, before and after the radius changes.
        let corner = Vector2::new(500.0, 0.0);
        let (before, _) = planned.cross_track(500, &corner).unwrap();
        let (after, _) = planned.cross_track(1_000 + TAKE_OVER_NS, &corner).unwrap();
        assert!((before + 29.0).abs() < 0.1 && (after + 45.3).abs() < 0.1, "{before} {after}");
    }

    #[test]
    fn outline_closes() {
        let planned = Planned::fixed(&seed_waypoints(), 70.0);
        let outline = planned.outline(0);
        assert_eq!(outline.first(), outline.last());
        assert!(outline.iter().all(|point| planned.cross_track(0, point).unwrap().0.abs() < 1e-6));
        assert_eq!(Planned::fixed(&seed_waypoints(), 0.0).outline(0).len(), 5);
        assert!(Planned::fixed(&[], 70.0).outline(0).is_empty());
    }
}
