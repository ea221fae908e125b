//! What the Estimator says in the health log: which sensors went away, and came back.
//!
//! It speaks of a flight alone: on the ground sensors come one after the other.

use bateleur_flight::estimator::Health;
use bateleur_messages::State;
use bateleur_messages::state::STATUS_COARSE;
use nalgebra::Vector2;

/// Slower than this over ground, m/s, nothing is said.
const FLYING_MPS: f64 = 10.0;

/// A sensor's bit, what is said when it goes away and when it is back.
const SENSORS: [(u32, &str, &str); 3] = [
    (Health::GPS, "no satellites: position by inertial values, wind and airspeed", "satellites are back"),
    (Health::BAROMETER, "the barometer is not taken: height by satellites", "the barometer is taken again"),
    (
        Health::MAGNETOMETER,
        "the magnetic field is not taken: heading by satellites",
        "the magnetic field is taken again",
    ),
];

/// What was said last.
#[derive(Debug, Clone, Copy, Default)]
pub struct Remarks {
    silent: bool,
    flies: bool,
    gone: u32,
    stuck: u32,
}

/// What there is to say.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Remark {
    /// Something went away: an error.
    Gone(&'static str),
    /// It is back.
    Back(&'static str),
}

/// Said of axes that are stuck: of the accelerometer, of the gyroscope, of both.
const STUCK: [&str; 3] = [
    "an axis of the accelerometer is stuck: the state can not be relied on",
    "an axis of the gyroscope is stuck: the state can not be relied on",
    "axes of accelerometer and gyroscope are stuck: the state can not be relied on",
];

impl Remarks {
    /// Says what has changed. `silent`: there are no inertial values; `stuck`: axes that repeat their value.
    pub fn look(&mut self, state: &State, silent: bool, stuck: u32, mut say: impl FnMut(Remark)) {
        match (silent, self.silent) {
            (true, false) if self.flies => say(Remark::Gone("no inertial values: no state")),
            (false, true) if self.flies => say(Remark::Back("inertial values are back")),
            _ => {}
        }
        match (stuck != 0, self.stuck != 0) {
            (true, false) if self.flies => {
                let which = usize::from(stuck >= 8) + usize::from(stuck > 8 && stuck & 7 != 0);
                say(Remark::Gone(STUCK[which]));
            }
            (false, true) if self.flies => say(Remark::Back("all inertial axes move again")),
            _ => {}
        }
        (self.silent, self.stuck) = (silent, stuck);
        if silent || state.status < STATUS_COARSE || state.health == 0 {
            return;
        }
        let [north_mps, east_mps, _] = state.velocity_ned_mps;
        self.flies = Vector2::new(north_mps, east_mps).norm() > FLYING_MPS;
        for (bit, gone, back) in SENSORS {
            let missing = state.health & u64::from(bit) == 0;
            match (missing, self.gone & bit != 0) {
                (true, false) if self.flies => {
                    say(Remark::Gone(gone));
                    self.gone |= bit;
                }
                (false, true) => {
                    say(Remark::Back(back));
                    self.gone &= !bit;
                }
                _ => {}
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Remark::{Back, Gone};
    use super::*;

    const ALL: u64 = 127;

    fn flying(health: u64) -> State {
        State { status: STATUS_COARSE, health, velocity_ned_mps: [20.0, 0.0, 0.0], ..State::default() }
    }

    fn said(remarks: &mut Remarks, state: &State, silent: bool, stuck: u32) -> Vec<Remark> {
        let mut said = Vec::new();
        remarks.look(state, silent, stuck, |remark| said.push(remark));
        said
    }

    #[test]
    fn what_goes_away_is_said_once_and_once_when_it_is_back() {
        let mut remarks = Remarks::default();
        assert!(said(&mut remarks, &flying(ALL), false, 0).is_empty());
        for (bit, gone, back) in SENSORS {
            let without = flying(ALL & !u64::from(bit));
            assert_eq!(said(&mut remarks, &without, false, 0), [Gone(gone)]);
            assert!(said(&mut remarks, &without, false, 0).is_empty());
            assert_eq!(said(&mut remarks, &flying(ALL), false, 0), [Back(back)]);
        }
    }

    #[test]
    fn silence_in_flight_is_said_and_names_no_single_sensor() {
        let mut remarks = Remarks::default();
        said(&mut remarks, &flying(ALL), false, 0);
        let none = State::default();
        assert_eq!(said(&mut remarks, &none, true, 0), [Gone("no inertial values: no state")]);
        assert!(said(&mut remarks, &none, true, 0).is_empty());
        assert_eq!(said(&mut remarks, &none, false, 0), [Back("inertial values are back")]);
    }

    #[test]
    fn stuck_axes_are_named_by_their_sensor() {
        for (stuck, which) in [(1, 0), (4, 0), (8, 1), (32, 1), (48, 1), (9, 2), (36, 2)] {
            let mut remarks = Remarks::default();
            said(&mut remarks, &flying(ALL), false, 0);
            assert_eq!(said(&mut remarks, &flying(ALL), false, stuck), [Gone(STUCK[which])], "{stuck}");
            assert_eq!(said(&mut remarks, &flying(ALL), false, 0).len(), 1);
        }
    }

    #[test]
    fn nothing_is_said_on_the_ground() {
        let mut remarks = Remarks::default();
        let standing = State { velocity_ned_mps: [0.0; 3], ..flying(16) };
        assert!(said(&mut remarks, &standing, false, 0).is_empty());
        assert!(said(&mut remarks, &State::default(), true, 7).is_empty());
    }
}
