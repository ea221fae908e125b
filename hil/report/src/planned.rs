//! The path that was to be flown.
//!
//! The geometry is guidance's own. The radius of each fillet is fixed where it was set; otherwise guidance chose it from
//! the wind that the Estimator saw, and the same code chooses it here again from the logged estimates. So the score takes
//! from the aircraft which path it meant to fly, and nothing about where it was.

use crate::flight::{Flight, Inputs};
use crate::mission::Passage;
use bateleur_flight::guidance::path::{Arc, Circuit, Piece};
use bateleur_flight::guidance::{Corner, Guidance, GuidanceSnapshot, Motion, Waypoint};
use bateleur_messages::state::STATUS_COARSE;
use bateleur_messages::{ActuatorCommand, State};
use nalgebra::Vector2;

/// Frames that guidance may count another way-point here than it did in flight before it is set to what it did in
/// flight: a passage falls into neighbouring frames at most, a restart or a new mission lasts.
const PATIENCE_FRAMES: u32 = 10;
/// Steps of an arc that is drawn, rad.
const DRAWN_STEP_RAD: f64 = 0.05;

/// The circuit as planned, which changes its radius from corner to corner.
#[derive(Debug, Clone)]
pub struct Planned {
    waypoints: Vec<Waypoint>,
    stages: Vec<Stage>,
}

/// The circuit from halfway down the leg before a corner to halfway down the leg after it.
#[derive(Debug, Clone)]
struct Stage {
    from_ns: u64,
    radius_m: f64,
    circuit: Circuit,
}

impl Planned {
    /// The path of a flight.
    pub fn of(flight: &Flight, passages: &[Passage]) -> Self {
        let Inputs { waypoints, guidance, .. } = &flight.inputs;
        let fixed = if guidance.corner == Corner::FlyThrough { Some(0.0) } else { guidance.radius_m };
        match fixed {
            Some(radius_m) => {
                let airspeed_mps = waypoints.first().map_or(0.0, |waypoint| waypoint.airspeed_mps);
                Self::fixed(waypoints, radius_m, guidance.turn_radius_m(airspeed_mps, 0.0))
            }
            None => Self::chosen(waypoints, passages, &radii(flight), guidance.least_radius_m),
        }
    }

    /// The path with one radius throughout, m; zero flies through the way-points. The aircraft turns with `turn_m`.
    pub fn fixed(waypoints: &[Waypoint], radius_m: f64, turn_m: f64) -> Self {
        let mut planned = Self { waypoints: waypoints.to_vec(), stages: Vec::new() };
        planned.push(0, radius_m, turn_m);
        planned
    }

    /// The path with a radius for each passage, from what guidance had in mind over time.
    fn chosen(waypoints: &[Waypoint], passages: &[Passage], radii: &[(u64, f64)], least_m: f64) -> Self {
        let mut planned = Self { waypoints: waypoints.to_vec(), stages: Vec::new() };
        let mut last_ns = 0;
        for passage in passages {
            let from_ns = if last_ns == 0 { 0 } else { u64::midpoint(last_ns, passage.time_ns.max(last_ns)) };
            planned.push_chosen(from_ns, radius_at(radii, passage.time_ns).unwrap_or(least_m));
            last_ns = passage.time_ns;
        }
        if passages.is_empty() {
            planned.push_chosen(0, radius_at(radii, u64::MAX).unwrap_or(least_m));
        }
        planned
    }

    /// A radius that guidance chose is what the aircraft turns with.
    fn push_chosen(&mut self, from_ns: u64, radius_m: f64) {
        self.push(from_ns, radius_m, radius_m);
    }

    fn push(&mut self, from_ns: u64, radius_m: f64, turn_m: f64) {
        let circuit = Circuit::new(&self.waypoints, radius_m, turn_m);
        self.stages.push(Stage { from_ns, radius_m, circuit });
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

    /// The radius in force at a module time, ns.
    pub fn radius_m(&self, time_ns: u64) -> f64 {
        self.stage(time_ns).map_or(0.0, |stage| stage.radius_m)
    }

    /// The radius of each corner in the order flown, m.
    pub fn radii_m(&self) -> Vec<f64> {
        self.stages.iter().map(|stage| stage.radius_m).collect()
    }

    /// The circuit in force at a module time, ns, as points north and east, m, to be drawn.
    pub fn outline(&self, time_ns: u64) -> Vec<Vector2<f64>> {
        let Some(stage) = self.stage(time_ns) else { return Vec::new() };
        let mut points = Vec::new();
        for (index, waypoint) in self.waypoints.iter().enumerate() {
            match stage.circuit.arc(index) {
                Some(arc) => points.extend(drawn(arc)),
                None => points.push(waypoint.horizontal()),
            }
        }
        points.extend(points.first().copied());
        points
    }
}

/// The radius that guidance had in mind at each estimate, m: the same laws fed with the same estimates again.
fn radii(flight: &Flight) -> Vec<(u64, f64)> {
    let Inputs { waypoints, guidance, .. } = &flight.inputs;
    let Ok(mut guidance) = Guidance::new(*guidance, waypoints) else { return Vec::new() };
    let mut radii = Vec::new();
    let mut commands = flight.commands.iter().peekable();
    let mut logged = ActuatorCommand::default();
    let mut apart = 0;
    for (time_ns, state) in flight.states.iter().filter(|(_, state)| state.status >= STATUS_COARSE) {
        while let Some((_, command)) = commands.next_if(|(time, _)| time <= time_ns) {
            logged = *command;
        }
        if logged.engaged == 0 {
            guidance.disengage();
            continue;
        }
        let count = guidance.snapshot().reached;
        apart = if count == logged.waypoints_reached { 0 } else { apart + 1 };
        if apart > PATIENCE_FRAMES {
            guidance
                .resume(&GuidanceSnapshot { next: logged.next_waypoint, reached: logged.waypoints_reached });
        }
        // It may have flown faster than it was asked to: corners are wider then.
        if logged.airspeed_reference_mps > 0.0 {
            guidance.fly_within(logged.airspeed_reference_mps, None);
        }
        let radius_m = guidance.step(&motion(state)).radius_m;
        if radius_m > 0.0 {
            radii.push((*time_ns, radius_m));
        }
    }
    radii
}

fn motion(state: &State) -> Motion {
    let horizontal = |ned: &[f64; 3]| Vector2::new(ned[0], ned[1]);
    Motion {
        position: horizontal(&state.position_ned_m),
        velocity: horizontal(&state.velocity_ned_mps),
        wind: Vector2::from(state.wind_ne_mps),
    }
}

fn radius_at(radii: &[(u64, f64)], time_ns: u64) -> Option<f64> {
    let after = radii.partition_point(|(time, _)| *time <= time_ns);
    radii.get(after.saturating_sub(1)).map(|(_, radius_m)| *radius_m)
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

    /// An estimate on the leg to WP0, and the command of the same frame.
    fn frame(time_ns: u64, wind: f64) -> ((u64, State), (u64, ActuatorCommand)) {
        let state = State {
            position_ned_m: [20.0, 0.0, -160.0],
            velocity_ned_mps: [22.0, 0.0, 0.0],
            wind_ne_mps: [wind, 0.0],
            status: 3,
            ..Default::default()
        };
        ((time_ns, state), (time_ns, ActuatorCommand { engaged: 1, ..Default::default() }))
    }

    #[test]
    fn wind_widens_the_corner_as_it_did_in_flight() {
        let flown = |wind: f64| {
            let (states, commands) = (0..5).map(|i| frame(i * 20_000_000, wind)).unzip();
            let flight = Flight { states, commands, ..Default::default() };
            Planned::of(&flight, &[]).radii_m()
        };
        let least = Inputs::default().guidance.least_radius_m;
        assert_eq!(flown(0.0), [least]);
        assert!(flown(8.0)[0] > least + 20.0);
    }

    /// An aircraft that has learnt that its wing stalls early flies faster than it is asked to.
    #[test]
    fn corners_are_as_wide_as_the_airspeed_that_was_flown_makes_them() {
        let flown = |airspeed_reference_mps: f64| {
            let frames = (0..5).map(|i| frame(i * 20_000_000, 0.0)).map(|(state, (time_ns, command))| {
                (state, (time_ns, ActuatorCommand { airspeed_reference_mps, ..command }))
            });
            let (states, commands) = frames.unzip();
            let flight = Flight { states, commands, ..Default::default() };
            Planned::of(&flight, &[]).radii_m()[0]
        };
        assert!(flown(30.0) > flown(22.0) + 20.0);
        assert_eq!(flown(22.0), flown(0.0));
    }

    #[test]
    fn each_corner_is_scored_with_its_own_radius() {
        let passage = |index: usize, time_ns: u64| Passage {
            index,
            time_ns,
            distance_m: None,
            above_m: None,
            verified: true,
        };
        let radii = [(90, 70.0), (190, 100.0)];
        let planned = Planned::chosen(&seed_waypoints(), &[passage(0, 100), passage(1, 200)], &radii, 50.0);
        assert_eq!(planned.radii_m(), [70.0, 100.0]);
        let cut = 2f64.sqrt() - 1.0;
        let corner = Vector2::new(500.0, 0.0);
        for (time_ns, radius_m) in [(0, 70.0), (149, 70.0), (150, 100.0), (900, 100.0)] {
            let (right_m, straight) = planned.cross_track(time_ns, &corner).unwrap();
            assert!((right_m + radius_m * cut).abs() < 1e-9 && !straight);
        }
    }

    #[test]
    fn outline_closes() {
        let planned = Planned::fixed(&seed_waypoints(), 70.0, 70.0);
        let outline = planned.outline(0);
        assert_eq!(outline.first(), outline.last());
        assert!(outline.iter().all(|point| planned.cross_track(0, point).unwrap().0.abs() < 1e-6));
        assert_eq!(Planned::fixed(&seed_waypoints(), 0.0, 70.0).outline(0).len(), 5);
        assert!(Planned::fixed(&[], 70.0, 70.0).outline(0).is_empty());
    }
}
