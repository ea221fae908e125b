//! Random numbers: one ChaCha stream per source, so that a source more or less never shifts another.

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, StandardNormal, Uniform};

/// Every source of chance in the plant. The number is the stream: add at the end, never renumber.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Source {
    GustAlong = 1,
    GustAcross = 2,
    GustVertical = 3,
    GustRoll = 4,
    Biases = 5,
    Accelerometer = 6,
    Gyroscope = 7,
    Magnetometer = 8,
    StaticPressure = 9,
    DifferentialPressure = 10,
    BarometerDrift = 11,
    GpsPosition = 12,
    GpsVelocity = 13,
    GpsMissed = 14,
    GpsOutage = 15,
    LostFrames = 16,
    Range = 17,
}

/// One stream.
#[derive(Clone, Debug)]
pub(crate) struct Noise(ChaCha8Rng);

impl Noise {
    pub(crate) fn new(seed: u64, source: Source) -> Self {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(source as u64);
        Self(rng)
    }

    /// A stream that belongs to a name, so that a name more or less never shifts another.
    pub(crate) fn named(seed: u64, name: &str) -> Self {
        // FNV-1a; the highest bit keeps clear of the numbers above.
        let mix = |hash: u64, byte: u8| (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
        let hash = name.bytes().fold(0xcbf2_9ce4_8422_2325, mix);
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        rng.set_stream(hash | 1 << 63);
        Self(rng)
    }

    /// Even between 0 and 1.
    pub(crate) fn unit(&mut self) -> f64 {
        0.5 * (self.within(1.0) + 1.0)
    }

    /// Normal, mean 0, deviation 1.
    pub(crate) fn gaussian(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// Three of them.
    pub(crate) fn gaussian3(&mut self) -> Vector3<f64> {
        let x = self.gaussian();
        let y = self.gaussian();
        Vector3::new(x, y, self.gaussian())
    }

    /// Even between −limit and limit; 0 for a limit that is not positive.
    pub(crate) fn within(&mut self, limit: f64) -> f64 {
        // The draw is made even without a limit, so that what follows stays the same.
        let unit: f64 = Uniform::new_inclusive(-1.0, 1.0).map_or(0.0, |d| d.sample(&mut self.0));
        unit * limit.max(0.0)
    }

    /// Three of them, each with a limit of its own.
    pub(crate) fn within3(&mut self, limits: [f64; 3]) -> Vector3<f64> {
        Vector3::from(limits.map(|limit| self.within(limit)))
    }
}
