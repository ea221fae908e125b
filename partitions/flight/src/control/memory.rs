//! What a controller remembers from frame to frame, to be kept in memory that outlives its process.

use super::airspeed::AirspeedWatch;
use super::fallback::Fallback;
use super::gusts::GustWatch;
use super::inner::InnerLoops;
use super::landing::Landing;
use super::pitch_hold::PitchHold;
use super::play::PlayInverse;
use super::power::PowerWatch;
use super::range_finder::GroundWatch;
use super::roll::RollModel;
use super::stall::StallGuard;
use super::takeoff::TakeOff;
use super::wind::WindWatch;
use super::{AUTHORITY_LIMIT_MPS, Channels, References, trimmed};
use crate::GRAVITY_MPS2;
use crate::airframe::Trim;
use crate::attitude::low_pass;
use crate::guidance::{GuidanceSnapshot, Path};
use crate::kept::{Kept, kept};
use crate::servo::ActuatorCommand;
use crate::stuck::Stuck;

/// Length of a [`ControllerSnapshot`] as plain bytes.
pub const BYTES: usize = ControllerSnapshot::BYTES;

/// How slowly the mean of the actuators follows, s.
const STEADY_S: f64 = 10.0;

/// All but what the settings say, and the guidance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Memory {
    pub loops: InnerLoops,
    pub references: References,
    pub channels: Channels,
    pub fallback: Fallback,
    /// Smoothed, m/s; zero: nothing has flown yet.
    pub airspeed_mps: f64,
    pub airspeed_watch: AirspeedWatch,
    pub power: PowerWatch,
    pub ground: GroundWatch,
    pub stall: StallGuard,
    pub gusts: GustWatch,
    pub wind: WindWatch,
    pub stuck: Stuck,
    /// The elevator's, near the ground.
    pub pitch_hold: PitchHold,
    /// As of the last frame.
    pub pitches_blind: bool,
    pub roll: RollModel,
    /// Airspeed asked for on top of the reference, because the elevator is near its stop, m/s.
    pub authority_mps: f64,
    /// Last command.
    pub last: ActuatorCommand,
    pub steady: Steady,
    pub play: PlayInverse,
    pub take_off: Option<TakeOff>,
    pub landing: Option<Landing>,
}

kept!(Memory {
    loops: InnerLoops,
    references: References,
    channels: Channels,
    fallback: Fallback,
    airspeed_mps: f64,
    airspeed_watch: AirspeedWatch,
    power: PowerWatch,
    ground: GroundWatch,
    stall: StallGuard,
    gusts: GustWatch,
    wind: WindWatch,
    stuck: Stuck,
    pitch_hold: PitchHold,
    pitches_blind: bool,
    roll: RollModel,
    authority_mps: f64,
    last: ActuatorCommand,
    steady: Steady,
    play: PlayInverse,
    take_off: Option<TakeOff>,
    landing: Option<Landing>,
} if |memory| (0.0..=AUTHORITY_LIMIT_MPS).contains(&memory.authority_mps));

impl Memory {
    /// Of a controller with everything off.
    pub(super) fn new(trim: &Trim, cruise_mps: f64) -> Self {
        Self {
            loops: InnerLoops::default(),
            references: References { normal_mps2: -GRAVITY_MPS2, ..References::default() },
            channels: Channels::default(),
            fallback: Fallback::new(trim.alpha_rad, cruise_mps),
            airspeed_mps: 0.0,
            airspeed_watch: AirspeedWatch::default(),
            power: PowerWatch::default(),
            ground: GroundWatch::default(),
            stall: StallGuard::default(),
            gusts: GustWatch::default(),
            wind: WindWatch::default(),
            stuck: Stuck::default(),
            pitch_hold: PitchHold::default(),
            pitches_blind: false,
            roll: RollModel::default(),
            authority_mps: 0.0,
            last: trimmed(trim),
            steady: Steady::default(),
            play: PlayInverse::default(),
            take_off: None,
            landing: None,
        }
    }
}

/// Where the actuators stood on average, while there was a state.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Steady {
    pub mean: Option<ActuatorCommand>,
}

kept!(Steady { mean: Option<ActuatorCommand> });

impl Steady {
    pub(super) fn follow(&mut self, command: &ActuatorCommand, dt_s: f64) {
        let mean = self.mean.get_or_insert(*command);
        let towards = |mean: &mut f64, now: f64| *mean = low_pass(*mean, now, STEADY_S, dt_s);
        towards(&mut mean.throttle, command.throttle);
        towards(&mut mean.aileron_rad, command.aileron_rad);
        towards(&mut mean.elevator_rad, command.elevator_rad);
        towards(&mut mean.rudder_rad, command.rudder_rad);
    }
}

/// A controller's memory and its place in the mission: one that goes on from it gives the words that the one it was taken from gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControllerSnapshot {
    pub(super) memory: Memory,
    pub(super) path: Path,
    /// Mission progress.
    pub guidance: GuidanceSnapshot,
}

kept!(ControllerSnapshot { memory: Memory, path: Path, guidance: GuidanceSnapshot });

impl ControllerSnapshot {
    /// The last command.
    pub fn command(&self) -> &ActuatorCommand {
        &self.memory.last
    }

    /// As plain bytes.
    pub fn to_bytes(&self) -> [u8; BYTES] {
        let mut bytes = [0; BYTES];
        self.put(&mut bytes);
        bytes
    }

    /// The snapshot again; `None`: no controller has written these bytes.
    pub fn from_bytes(bytes: &[u8; BYTES]) -> Option<Self> {
        Self::take(bytes)
    }
}
