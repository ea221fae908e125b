//! The controller's memory as plain numbers, for memory that outlives a process.
//!
//! Any number may come back: what goes on from it checks it first (see [`Controller::resume`](super::Controller::resume)).

use super::inner::InnerLoops;
use super::{
    Channels, ControllerSnapshot, References, airspeed, gusts, landing, pitch_hold, play, power,
    range_finder, stall, takeoff,
};
use crate::guidance::{GuidanceSnapshot, PATH_NUMBERS};
use crate::servo::ActuatorCommand;

/// Four integrators, four references, four actuators, airspeed and its reserve, four channels.
const LOOPS: usize = 18;
/// The loops, the take-off, the landing, the pitot, the motor, the ground, the wing, the gusts, the pitch, the play, the path.
pub const NUMBERS: usize = LOOPS
    + takeoff::NUMBERS
    + landing::NUMBERS
    + airspeed::NUMBERS
    + power::NUMBERS
    + range_finder::NUMBERS
    + stall::NUMBERS
    + gusts::NUMBERS
    + pitch_hold::NUMBERS
    + play::NUMBERS
    + PATH_NUMBERS;

/// The first `N` of `numbers`, which then begin behind them; zeros where there are not so many.
fn take<const N: usize>(numbers: &mut &[f64]) -> [f64; N] {
    numbers.split_first_chunk().map_or([0.0; N], |(first, rest)| {
        *numbers = rest;
        *first
    })
}

impl ControllerSnapshot {
    /// All but the place in the mission.
    pub fn to_numbers(&self) -> [f64; NUMBERS] {
        let (r, c, on) = (&self.references, &self.command, |on: bool| if on { 1.0 } else { 0.0 });
        let [normal, lateral, axial, roll] = self.loops.to_numbers();
        let loops: [f64; LOOPS] = [
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
        ];
        let parts: [&[f64]; 11] = [
            &loops,
            &self.take_off,
            &self.landing,
            &self.airspeed_watch,
            &self.power,
            &self.ground,
            &self.stall,
            &self.gusts,
            &self.pitch_hold,
            &self.play,
            &self.path,
        ];
        let mut numbers = [0.0; NUMBERS];
        numbers.iter_mut().zip(parts.into_iter().flatten()).for_each(|(number, part)| *number = *part);
        numbers
    }

    /// The snapshot again, with the place in the mission.
    pub fn from_numbers(numbers: &[f64; NUMBERS], guidance: GuidanceSnapshot) -> Self {
        let mut rest = numbers.as_slice();
        let n: [f64; LOOPS] = take(&mut rest);
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
            // In the order of `parts`.
            take_off: take(&mut rest),
            landing: take(&mut rest),
            airspeed_watch: take(&mut rest),
            power: take(&mut rest),
            ground: take(&mut rest),
            stall: take(&mut rest),
            gusts: take(&mut rest),
            pitch_hold: take(&mut rest),
            play: take(&mut rest),
            path: take(&mut rest),
            guidance,
        }
    }
}
