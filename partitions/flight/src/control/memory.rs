//! The controller's memory as plain numbers, for memory that outlives a process.
//!
//! Any number may come back: what goes on from it checks it first (see [`Controller::resume`](super::Controller::resume)).

use super::inner::InnerLoops;
use super::{Channels, ControllerSnapshot, References, airspeed, landing, power, range_finder, takeoff};
use crate::guidance::{GuidanceSnapshot, PATH_NUMBERS};
use crate::servo::ActuatorCommand;

/// Four integrators, four references, four actuators, airspeed and its reserve, four channels.
const LOOPS: usize = 18;
/// The loops, the take-off, the landing, the pitot, the motor, the ground, the path.
pub const NUMBERS: usize = GROUND + range_finder::NUMBERS + PATH_NUMBERS;
const LANDING: usize = LOOPS + takeoff::NUMBERS;
const PITOT: usize = LANDING + landing::NUMBERS;
const POWER: usize = PITOT + airspeed::NUMBERS;
const GROUND: usize = POWER + power::NUMBERS;

impl ControllerSnapshot {
    /// All but the place in the mission.
    pub fn to_numbers(&self) -> [f64; NUMBERS] {
        let (r, c, on) = (&self.references, &self.command, |on: bool| if on { 1.0 } else { 0.0 });
        let [normal, lateral, axial, roll] = self.loops.to_numbers();
        let mut numbers = [0.0; NUMBERS];
        let (loops, path) = numbers.split_at_mut(NUMBERS - PATH_NUMBERS);
        let (loops, take_off) = loops.split_at_mut(LOOPS);
        let (take_off, landing) = take_off.split_at_mut(takeoff::NUMBERS);
        let (landing, pitot) = landing.split_at_mut(landing::NUMBERS);
        let (pitot, power) = pitot.split_at_mut(airspeed::NUMBERS);
        let (power, ground) = power.split_at_mut(power::NUMBERS);
        take_off.copy_from_slice(&self.take_off);
        landing.copy_from_slice(&self.landing);
        pitot.copy_from_slice(&self.airspeed_watch);
        power.copy_from_slice(&self.power);
        ground.copy_from_slice(&self.ground);
        loops.copy_from_slice(&[
            normal,
            lateral,
            axial,
            roll,
            r.roll_rate_radps,
            r.normal_mps2,
            r.axial_mps2,
            r.bank_rad,
            c.throttle,
            c.aileron_rad,
            c.elevator_rad,
            c.rudder_rad,
            self.airspeed_mps,
            self.authority_mps,
            on(self.channels.roll),
            on(self.channels.pitch),
            on(self.channels.yaw),
            on(self.channels.thrust),
        ]);
        path.copy_from_slice(&self.path);
        numbers
    }

    /// The snapshot again, with the place in the mission.
    pub fn from_numbers(numbers: &[f64; NUMBERS], guidance: GuidanceSnapshot) -> Self {
        let n = numbers;
        let mut path = [0.0; PATH_NUMBERS];
        path.copy_from_slice(&n[NUMBERS - PATH_NUMBERS..]);
        let mut take_off = [0.0; takeoff::NUMBERS];
        take_off.copy_from_slice(&n[LOOPS..LANDING]);
        let mut landing = [0.0; landing::NUMBERS];
        landing.copy_from_slice(&n[LANDING..PITOT]);
        let mut airspeed_watch = [0.0; airspeed::NUMBERS];
        airspeed_watch.copy_from_slice(&n[PITOT..POWER]);
        let mut power = [0.0; power::NUMBERS];
        power.copy_from_slice(&n[POWER..GROUND]);
        let mut ground = [0.0; range_finder::NUMBERS];
        ground.copy_from_slice(&n[GROUND..NUMBERS - PATH_NUMBERS]);
        Self {
            loops: InnerLoops::from_numbers([n[0], n[1], n[2], n[3]]),
            references: References {
                roll_rate_radps: n[4],
                normal_mps2: n[5],
                axial_mps2: n[6],
                bank_rad: n[7],
            },
            command: ActuatorCommand {
                throttle: n[8],
                aileron_rad: n[9],
                elevator_rad: n[10],
                rudder_rad: n[11],
            },
            airspeed_mps: n[12],
            authority_mps: n[13],
            channels: Channels {
                roll: n[14] > 0.5,
                pitch: n[15] > 0.5,
                yaw: n[16] > 0.5,
                thrust: n[17] > 0.5,
            },
            take_off,
            landing,
            airspeed_watch,
            power,
            ground,
            path,
            guidance,
        }
    }
}
