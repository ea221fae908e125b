//! Where the aircraft is and was, from what the Estimator says.

use std::collections::VecDeque;
use std::path::Path;

use bateleur_messages::State;
use bateleur_messages::state::STATUS_COARSE;

/// In the folder of a flight: the way-points that are flown.
pub const MISSION_FILE: &str = "mission.json";
/// Places of the track that are kept; a longer one is kept at longer steps.
const MOST_PLACES: usize = 8192;

/// A way-point, m from the runway: north, east, height.
pub type Place = [f64; 3];

/// The way-points of a flight; none of other runs.
pub(crate) fn waypoints(folder: &Path) -> Vec<Place> {
    let text = std::fs::read(folder.join(MISSION_FILE)).unwrap_or_default();
    serde_json::from_slice(&text).unwrap_or_default()
}

/// Module time, ns, and place, north and east, m.
pub(crate) type Track = VecDeque<(u64, f64, f64)>;

/// The aircraft.
#[derive(Debug, Clone, Default)]
pub(crate) struct Air {
    /// What was said last, and at which module time, ns.
    pub(crate) state: Option<(u64, State)>,
    /// Module time, ns, and place, north and east, m.
    pub(crate) track: Track,
    /// Least time from one place of the track to the next, ns.
    step_ns: u64,
}

impl Air {
    /// Adds what the Estimator said.
    pub(crate) fn add(&mut self, time_ns: u64, state: State) {
        if self.track.back().is_some_and(|(last_ns, ..)| *last_ns > time_ns) {
            *self = Self::default(); // module time has begun anew
        }
        let last_ns = self.track.back().map(|(last_ns, ..)| *last_ns);
        if state.status >= STATUS_COARSE && last_ns.is_none_or(|last_ns| time_ns >= last_ns + self.step_ns) {
            let [north_m, east_m, _] = state.position_ned_m;
            self.track.push_back((time_ns, north_m, east_m));
        }
        if self.track.len() > MOST_PLACES {
            let mut at = 0;
            self.track.retain(|_| {
                at += 1;
                at % 2 == 1
            });
            let over_ns =
                self.track.back().zip(self.track.front()).map_or(0, |(last, first)| last.0 - first.0);
            self.step_ns = over_ns / (MOST_PLACES as u64 / 2);
        }
        self.state = Some((time_ns, state));
    }
}

/// Airspeed, ground speed and climb, m/s.
pub(crate) fn speeds(state: &State) -> [f64; 3] {
    let [north, east, down] = state.velocity_ned_mps;
    let [wind_north, wind_east] = state.wind_ne_mps;
    let air = [north - wind_north, east - wind_east, down];
    [air.iter().map(|part| part * part).sum::<f64>().sqrt(), north.hypot(east), -down]
}

/// Speed of the wind, m/s, and where it comes from, degrees clockwise from north.
pub(crate) fn wind(state: &State) -> (f64, f64) {
    let [north, east] = state.wind_ne_mps;
    (north.hypot(east), (-east).atan2(-north).to_degrees().rem_euclid(360.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn track_of_any_length_keeps_its_begin_its_end_and_its_bound() {
        let mut air = Air::default();
        for step in 0..100_000_u64 {
            let position_ned_m = [step as f64, 0.0, 0.0];
            air.add(step * 20_000_000, State { status: 3, position_ned_m, ..State::default() });
        }
        assert!(air.track.len() <= MOST_PLACES && air.track.len() > MOST_PLACES / 4, "{}", air.track.len());
        assert_eq!(air.track[0].0, 0);
        assert!(air.track.back().unwrap().1 > 99_900.0);
        air.add(0, State { status: 3, ..State::default() });
        assert_eq!(air.track.len(), 1, "after a reset it begins anew");
    }

    #[test]
    fn wind_is_told_by_where_it_comes_from() {
        // 5 m/s from 250°: the air moves towards 70°.
        let to = 70_f64.to_radians();
        let state = State { wind_ne_mps: [5.0 * to.cos(), 5.0 * to.sin()], ..State::default() };
        let (speed, from) = wind(&state);
        assert!((speed - 5.0).abs() < 1e-9 && (from - 250.0).abs() < 1e-9, "{speed} {from}");
    }
}
