//! How far the own major frames are from those that they follow, and by how much each is to be corrected: an estimate of the
//! phase and of its drift from measurements that come when they come, each as good as it says.
//!
//! Pure: frames and measurements are arguments, no clock is asked. A phase is how much later than the own frame the other
//! one begins, in own time; adding it to the length of a frame takes it away. It is meant as the nearest one: whole frames
//! are nothing.

/// What is known of the drift before it was seen, ns a second: crystals of computers stay within 50 parts in a million.
const DRIFT_NS_PER_S: f64 = 50_000.0;
/// No two clocks drift apart faster that both work, ns a second.
const MOST_DRIFT_NS_PER_S: f64 = 200_000.0;
/// How a drift wanders, ns a second in a square root of a second: what a crystal does that becomes warmer.
const WANDER_NS_PER_S: f64 = 100.0;
/// How a phase wanders beside its drift, ns in a square root of a second.
const NOISE_NS: f64 = 100.0;
/// No measurement is better than that, ns: reading two clocks takes as long.
const FINEST_NS: f64 = 300.0;
/// A measurement further than so many deviations from what was expected is not believed.
const GATE: f64 = 6.0;
/// So many of them in a row are: then the other side has begun anew.
const BELIEVED_AT_LAST: u32 = 5;

/// What is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Law {
    phase_ns: f64,
    drift_ns_per_s: f64,
    /// Variances of phase and drift, and what they have in common.
    var_phase: f64,
    var_drift: f64,
    covariance: f64,
    measured: u64,
    refused: u32,
}

/// What became of a measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Taken {
    /// It counts.
    Yes,
    /// It is too far from what was expected.
    Refused,
    /// The other side has begun anew: from here on.
    Anew,
}

impl Default for Law {
    fn default() -> Self {
        Self {
            phase_ns: 0.0,
            drift_ns_per_s: 0.0,
            var_phase: 0.0,
            var_drift: DRIFT_NS_PER_S * DRIFT_NS_PER_S / 4.0,
            covariance: 0.0,
            measured: 0,
            refused: 0,
        }
    }
}

impl Law {
    /// The phase at the next frame that can be corrected, ns; `None` if nothing was measured yet.
    #[must_use]
    pub fn phase_ns(&self) -> Option<f64> {
        (self.measured > 0).then_some(self.phase_ns)
    }

    /// The standard deviation of the phase, ns: it grows while nothing is measured.
    #[must_use]
    pub fn deviation_ns(&self) -> f64 {
        self.var_phase.max(0.0).sqrt()
    }

    /// The drift, parts in 10⁹; positive: the own frames are too short.
    #[must_use]
    pub fn drift_ppb(&self) -> f64 {
        self.drift_ns_per_s
    }

    /// Measurements that counted since the other side began.
    #[must_use]
    pub fn measured(&self) -> u64 {
        self.measured
    }

    /// A frame of `length_ns` passes, whose end was moved by `shift_ns`.
    pub fn pass(&mut self, length_ns: u64, shift_ns: i64) {
        if self.measured == 0 {
            return;
        }
        let seconds = length_ns as f64 / 1e9;
        self.phase_ns += self.drift_ns_per_s * seconds - shift_ns as f64;
        self.phase_ns = nearest(self.phase_ns, length_ns);
        self.var_phase +=
            seconds * (2.0 * self.covariance + seconds * self.var_drift) + NOISE_NS * NOISE_NS * seconds;
        self.covariance += seconds * self.var_drift;
        self.var_drift += WANDER_NS_PER_S * WANDER_NS_PER_S * seconds;
        let most = DRIFT_NS_PER_S * DRIFT_NS_PER_S;
        if self.var_drift > most {
            // After hours without any measurement it is not known worse than at first.
            self.covariance *= (most / self.var_drift).sqrt();
            self.var_drift = most;
        }
    }

    /// The phase at the next frame was measured, as exact as `uncertainty_ns`: the truth lies no further away. A phase is one
    /// within a frame of `length_ns`.
    pub fn measure(&mut self, phase_ns: f64, uncertainty_ns: f64, length_ns: u64) -> Taken {
        let deviation = (uncertainty_ns / 2.0).max(FINEST_NS);
        let noise = deviation * deviation;
        if self.measured == 0 {
            self.begin(phase_ns, noise, length_ns);
            return Taken::Yes;
        }
        let off = nearest(phase_ns - self.phase_ns, length_ns);
        let expected = self.var_phase + noise;
        if off * off > GATE * GATE * expected {
            self.refused += 1;
            if self.refused < BELIEVED_AT_LAST {
                return Taken::Refused;
            }
            self.begin(phase_ns, noise, length_ns);
            return Taken::Anew;
        }
        self.refused = 0;
        self.measured += 1;
        let (gain, drift_gain) = (self.var_phase / expected, self.covariance / expected);
        self.phase_ns = nearest(self.phase_ns + gain * off, length_ns);
        self.drift_ns_per_s =
            (self.drift_ns_per_s + drift_gain * off).clamp(-MOST_DRIFT_NS_PER_S, MOST_DRIFT_NS_PER_S);
        self.var_drift -= drift_gain * self.covariance;
        self.covariance *= 1.0 - gain;
        self.var_phase *= 1.0 - gain;
        Taken::Yes
    }

    /// The first measurement, or the first of another life. The drift is that of the crystals: it stays.
    fn begin(&mut self, phase_ns: f64, noise: f64, length_ns: u64) {
        self.phase_ns = nearest(phase_ns, length_ns);
        self.var_phase = noise;
        self.covariance = 0.0;
        self.measured = 1;
        self.refused = 0;
    }

    /// By how much the end of the next frame, of `length_ns`, is to be moved so that the one after it begins with the other
    /// side's, ns; at most by `early_ns` ahead and by `late_ns` back.
    #[must_use]
    pub fn shift_ns(&self, length_ns: u64, early_ns: u64, late_ns: u64) -> i64 {
        let Some(phase_ns) = self.phase_ns() else { return 0 };
        let wanted = phase_ns + self.drift_ns_per_s * (length_ns as f64 / 1e9);
        wanted.clamp(-(early_ns as f64), late_ns as f64).round() as i64
    }
}

/// The nearest of all phases that are whole frames apart: half a frame away at most, ns.
#[must_use]
pub fn nearest(phase_ns: f64, length_ns: u64) -> f64 {
    let length = length_ns.max(1) as f64;
    phase_ns - length * (phase_ns / length).round()
}
