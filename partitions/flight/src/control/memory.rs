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
use super::{Channels, References, Steady};
use crate::guidance::{GuidanceSnapshot, Path};
use crate::kept::{Kept, kept};
use crate::servo::ActuatorCommand;
use crate::stuck::Stuck;

/// Length of a [`ControllerSnapshot`] as plain bytes.
pub const BYTES: usize = ControllerSnapshot::BYTES;

/// All of it: a controller that goes on from it gives the words that the one it was taken from gives.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ControllerSnapshot {
    pub(super) loops: InnerLoops,
    pub(super) references: References,
    pub(super) channels: Channels,
    pub(super) fallback: Fallback,
    /// Smoothed, m/s; zero: nothing has flown yet.
    pub(super) airspeed_mps: f64,
    pub(super) airspeed_watch: AirspeedWatch,
    pub(super) power: PowerWatch,
    pub(super) ground: GroundWatch,
    pub(super) stall: StallGuard,
    pub(super) gusts: GustWatch,
    pub(super) stuck: Stuck,
    pub(super) pitch_hold: PitchHold,
    pub(super) pitches_blind: bool,
    pub(super) roll: RollModel,
    pub(super) authority_mps: f64,
    /// Last command.
    pub command: ActuatorCommand,
    pub(super) steady: Steady,
    pub(super) play: PlayInverse,
    pub(super) take_off: Option<TakeOff>,
    pub(super) landing: Option<Landing>,
    pub(super) path: Path,
    /// Mission progress.
    pub guidance: GuidanceSnapshot,
}

kept!(ControllerSnapshot {
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
    stuck: Stuck,
    pitch_hold: PitchHold,
    pitches_blind: bool,
    roll: RollModel,
    authority_mps: f64,
    command: ActuatorCommand,
    steady: Steady,
    play: PlayInverse,
    take_off: Option<TakeOff>,
    landing: Option<Landing>,
    path: Path,
    guidance: GuidanceSnapshot,
});

impl ControllerSnapshot {
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
