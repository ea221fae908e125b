//! What each aid is worth just now, and whether the filter believes itself as much as its measurements do.
//!
//! Responsible for remembering; it decides nothing. An aid is healthy while it is taken: a sensor that is silent, refused or
//! switched off is not.

/// A kind of measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Aid {
    /// Velocity of the receiver.
    GpsVelocity = 0,
    /// Position of the receiver.
    GpsPosition = 1,
    /// Static pressure.
    Barometer = 2,
    /// Differential pressure.
    Airspeed = 3,
    /// No air from the side.
    Sideslip = 4,
    /// Magnetic field.
    Magnetometer = 5,
}

impl Aid {
    /// All of them, in the order of their numbers.
    pub const ALL: [Self; 6] = [
        Self::GpsVelocity,
        Self::GpsPosition,
        Self::Barometer,
        Self::Airspeed,
        Self::Sideslip,
        Self::Magnetometer,
    ];
}

/// Innovations of one aid that were taken, each over the standard deviation that the filter expected of it and with what
/// the ones before it had told taken off: independent, of mean 0 and variance 1, if the filter is right about itself.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Innovations {
    /// How many.
    pub count: u64,
    /// Sum of their squares; over `count` it is 1 for a consistent filter, less for one that is too modest.
    pub squares: f64,
    /// Time of the last one that was taken, s.
    pub taken_s: Option<f64>,
}

/// One bit each, see the constants.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Health(pub u32);

impl Health {
    /// Fixes are taken.
    pub const GPS: u32 = 1;
    /// The barometer carries the height.
    pub const BAROMETER: u32 = 2;
    /// The pitot tells the wind; not below flying speed.
    pub const PITOT: u32 = 4;
    /// The field tells the heading.
    pub const MAGNETOMETER: u32 = 8;
    /// Roll, pitch and yaw are as good as they should be.
    pub const ATTITUDE: u32 = 16;
    /// The velocity is.
    pub const VELOCITY: u32 = 32;
    /// The position is.
    pub const POSITION: u32 = 64;

    /// Whether all of these bits are set.
    pub fn has(self, bits: u32) -> bool {
        self.0 & bits == bits
    }
}

/// The innovations of all aids.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Record {
    aids: [Innovations; Aid::ALL.len()],
}

impl Record {
    pub(super) fn of(&self, aid: Aid) -> &Innovations {
        &self.aids[aid as usize]
    }

    /// Notes one innovation that was taken.
    pub(super) fn take(&mut self, aid: Aid, normalised: f64, time_s: f64) {
        let of = &mut self.aids[aid as usize];
        of.count += 1;
        of.squares += normalised * normalised;
        of.taken_s = Some(time_s);
    }

    /// Whether an aid was taken at most `within_s` before `now_s`.
    pub(super) fn fresh(&self, aid: Aid, now_s: f64, within_s: f64) -> bool {
        self.of(aid).taken_s.is_some_and(|taken_s| (now_s - taken_s).abs() <= within_s)
    }
}
