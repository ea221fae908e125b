//! Whether the barometer climbs as the receiver does: while there is one, a static port that is blocked shows nowhere else.
//!
//! Responsible for the verdict alone. Heights are compared over a third of a minute and over a minute, so that neither the noise of
//! the one nor the weather in it counts, and the receiver's slow error does not enter: it is the velocity that is summed. Over longer times, as
//! after an outage, the receiver's height tells what is more than its slow error.

/// Seconds that are looked back on.
const SHORT: usize = 20;
const LONG: usize = 60;
/// Difference of the two climbs that is none of noise and weather, m: over the short time and over the long one.
const SHORT_M: f64 = 4.0;
const LONG_M: f64 = 6.0;
/// Difference of the two heights that has become another one by this much is not the receiver's, m; how slowly the usual one follows, s.
const LEVEL_M: f64 = 20.0;
const LEVEL_S: f64 = 30.0;
/// An outage is longer than this, s.
const LEAST_OUTAGE_S: f64 = 10.0;
/// Four deviations of the receiver's heights in one second, m.
const LEVEL_NOISE_M: f64 = 45.0;
/// So many seconds in a row.
const AGAINST: u32 = 2;
/// It is taken back after so many seconds with a climb or descent of that much, m, that both have seen.
const FOR: u32 = 20;
const SEEN_M: f64 = 8.0;
/// A height is well within the gate below this share of it; and a leap takes so many heights at most.
const NEAR_SHARE: f64 = 0.5;
const LEAP: u32 = 4;
/// Fixes further apart do not tell the climb between them, s; and one that is older does not tell that up to now, s.
const LONGEST_GAP_S: f64 = 1.0;
const OLDEST_S: f64 = 1.5;

/// The judge of the static port.
#[derive(Debug, Clone, Copy)]
pub(super) struct StaticWatch {
    /// Height by barometer and climb by receiver, once a second, m, the newest last.
    past: [(f64, f64); LONG + 1],
    count: usize,
    climb_m: f64,
    fix: Option<Fix>,
    /// How much higher the barometer is than the receiver, m; and was before the last outage.
    higher_m: f64,
    level_m: Option<f64>,
    /// Of heights, climbs and how much higher, m, and how many of them.
    sums_m: [f64; 3],
    summed: u32,
    next_s: f64,
    against: u32,
    agreed: u32,
    believed: bool,
    /// Heights since one was well within the gate; and that beyond it was reached in one leap.
    near: u32,
    leapt: bool,
    /// While heights are refused: how much more the barometer had climbed than the receiver when that began, m.
    followed_m: Option<f64>,
}

/// When it was measured, s, its height, m, and velocity down, m/s.
#[derive(Debug, Clone, Copy)]
pub(super) struct Fix {
    pub(super) time_s: f64,
    pub(super) height_m: f64,
    pub(super) down_mps: f64,
}

impl Default for StaticWatch {
    fn default() -> Self {
        Self {
            past: [(0.0, 0.0); LONG + 1],
            count: 0,
            climb_m: 0.0,
            fix: None,
            higher_m: 0.0,
            level_m: None,
            sums_m: [0.0; 3],
            summed: 0,
            next_s: 0.0,
            against: 0,
            agreed: 0,
            believed: true,
            near: 0,
            leapt: false,
            followed_m: None,
        }
    }
}

impl StaticWatch {
    pub(super) fn is_believed(&self) -> bool {
        self.believed
    }

    /// The last height beyond the gate came there in one leap, or the receiver said otherwise while it was there.
    pub(super) fn is_doubtful(&self) -> bool {
        let off_m = self.count.checked_sub(1).and_then(|seconds| self.off_m(seconds));
        self.leapt || off_m.is_some_and(|off_m| off_m.abs() > 0.5 * SHORT_M)
    }

    /// Forgets what was compared, not the verdict.
    pub(super) fn restart(&mut self) {
        let Self { believed, near, leapt, followed_m, level_m, .. } = *self;
        *self = Self { believed, near, leapt, followed_m, level_m, ..Self::default() };
    }

    /// How far a height is from the one expected, as a share of the gate. True if it is beyond, and came there in one leap: the
    /// barometer may be sound and only stand elsewhere. One that drifts there does not climb as the aircraft does.
    pub(super) fn leaps(&mut self, share: f64) -> bool {
        if share <= 1.0 {
            self.followed_m = None;
        } else if self.followed_m.is_none() {
            self.leapt = self.near <= LEAP;
            let longest = self.count.checked_sub(1).and_then(|seconds| self.off_m(seconds));
            self.followed_m = Some(longest.unwrap_or(0.0));
        }
        self.near = if share < NEAR_SHARE { 0 } else { self.near.saturating_add(1) };
        self.followed_m.is_some() && self.leapt
    }

    /// Heights have been refused for too long. Gives how much more the barometer has climbed than the receiver, m, where it drifted
    /// away from it and is therefore no longer believed; `None` where it leapt, or where no receiver is there to compare it with.
    pub(super) fn give_up(&mut self, time_s: f64) -> Option<f64> {
        let off_m = self.off_m(self.count.checked_sub(1)?)?;
        let drifted = !self.leapt && off_m.abs() > 0.5 * SHORT_M && self.is_fresh(time_s);
        if drifted {
            self.disbelieve();
        }
        // What was refused since the height has not followed.
        drifted.then(|| self.followed_m.unwrap_or(0.0))
    }

    /// The barometer's zero is found anew.
    pub(super) fn begin_level(&mut self) {
        self.level_m = None;
    }

    /// The barometer is found to be wrong, here or otherwise than by the receiver.
    pub(super) fn disbelieve(&mut self) {
        (self.believed, self.agreed) = (false, 0);
    }

    fn is_fresh(&self, time_s: f64) -> bool {
        self.fix.is_some_and(|fix| (time_s - fix.time_s).abs() <= OLDEST_S)
    }

    /// Takes what the receiver tells.
    pub(super) fn fix(&mut self, fix: Fix) {
        if self.fix.is_some_and(|last| (last.time_s - LONGEST_GAP_S..last.time_s).contains(&fix.time_s)) {
            return; // it was overtaken
        }
        match self.fix.replace(fix) {
            Some(before) if (0.0..=LONGEST_GAP_S).contains(&(fix.time_s - before.time_s)) => {
                self.climb_m -= 0.5 * (before.down_mps + fix.down_mps) * (fix.time_s - before.time_s);
            }
            before => {
                self.restart();
                self.fix = Some(fix);
                // No port goes far astray in less, and a receiver that was gone may leap.
                if before.is_some_and(|before| fix.time_s - before.time_s < LEAST_OUTAGE_S) {
                    self.level_m = None;
                }
            }
        }
    }

    /// Takes a height by barometer, m; gives how much more it has climbed than the receiver when that is found to be wrong.
    pub(super) fn height(&mut self, time_s: f64, height_m: f64) -> Option<f64> {
        let fix = self.fix.filter(|_| self.is_fresh(time_s))?;
        // In a dive a few tenths of a second are metres.
        let since_m = fix.down_mps * (time_s - fix.time_s);
        let climb_m = self.climb_m - since_m;
        let higher_m = height_m - (fix.height_m - since_m);
        for (sum_m, value_m) in self.sums_m.iter_mut().zip([height_m, climb_m, higher_m]) {
            *sum_m += value_m;
        }
        self.summed += 1;
        if time_s < self.next_s && self.next_s - time_s < 2.0 {
            return None;
        }
        let [height_m, climb_m, higher_m] = self.sums_m.map(|sum_m| sum_m / f64::from(self.summed));
        (self.sums_m, self.summed, self.next_s) = ([0.0; 3], 0, time_s + 1.0);
        if self.count > LONG {
            self.past.rotate_left(1);
        }
        self.count = (self.count + 1).min(LONG + 1);
        self.past[self.count - 1] = (height_m, climb_m);
        self.judge(higher_m)
    }

    /// How much more the barometer has climbed since so many seconds, m.
    fn off_m(&self, seconds: usize) -> Option<f64> {
        let newest = self.count.checked_sub(1)?;
        let (then, now) = (self.past[newest.checked_sub(seconds)?], self.past[newest]);
        Some((now.0 - then.0) - (now.1 - then.1))
    }

    /// The verdict of a second in which the barometer was higher than the receiver by `higher_m`.
    fn judge(&mut self, higher_m: f64) -> Option<f64> {
        let seconds = self.count as f64;
        self.higher_m += (higher_m - self.higher_m) / seconds.min(LEVEL_S);
        // Soon after an outage alone: later a receiver that leaps would be believed.
        let most_m = LEVEL_M.max(LEVEL_NOISE_M / seconds.sqrt());
        let moved = self.level_m.filter(|_| self.count <= SHORT).map(|level_m| self.higher_m - level_m);
        let level = moved.filter(|off| off.abs() > most_m);
        let short = self.off_m(SHORT).filter(|off| off.abs() > SHORT_M);
        let long = self.off_m(LONG).filter(|off| off.abs() > LONG_M);
        let wrong = level.or(long).or(short);
        if self.count > SHORT {
            self.level_m = Some(self.higher_m);
        }
        self.against = if wrong.is_some() { self.against + 1 } else { 0 };
        if self.believed && self.against >= AGAINST {
            self.disbelieve();
            return self.followed_m.or(wrong);
        }
        if !self.believed {
            let near = self.off_m(SHORT).is_some_and(|off| off.abs() < 0.5 * SHORT_M);
            self.agreed = if near && self.moved_m() > SEEN_M { self.agreed + 1 } else { 0 };
            if self.agreed >= FOR {
                (self.believed, self.against) = (true, 0);
            }
        }
        None
    }

    /// Between the least and the greatest height by receiver in the short time, m.
    fn moved_m(&self) -> f64 {
        let recent = self.past[self.count.saturating_sub(SHORT)..self.count].iter().map(|(_, climb)| *climb);
        let (low, high) = recent.fold((f64::MAX, f64::MIN), |(low, high), m| (low.min(m), high.max(m)));
        high - low
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// Flies up and down for some seconds; when the verdict fell, s, and by how much, m.
    fn fly(seed: u64, seconds: f64, wrong: impl Fn(f64, f64) -> f64) -> Option<(f64, f64)> {
        fly_with(seed, seconds, |time_s| 1.5 * (time_s / 8.0).sin(), wrong)
    }

    /// The same with a climb rate, m/s.
    fn fly_with(
        seed: u64,
        seconds: f64,
        climb_mps: impl Fn(f64) -> f64,
        wrong: impl Fn(f64, f64) -> f64,
    ) -> Option<(f64, f64)> {
        fly_without(seed, seconds, |_| false, climb_mps, wrong)
    }

    /// The same with times without fixes. They come late, by another time in each flight, and some in the wrong order; their heights have a slow error.
    fn fly_without(
        seed: u64,
        seconds: f64,
        out: impl Fn(f64) -> bool,
        climb_mps: impl Fn(f64) -> f64,
        wrong: impl Fn(f64, f64) -> f64,
    ) -> Option<(f64, f64)> {
        let late_s = 0.04 * (seed % 8) as f64;
        let mut chance = ChaCha8Rng::seed_from_u64(seed);
        let mut noise = || -> f64 { StandardNormal.sample(&mut chance) };
        let (mut watch, mut height_m, mut weather_m) = (StaticWatch::default(), 160.0_f64, 0.0);
        let (mut heights_m, mut slow_m) = (Vec::new(), 9.0 * noise());
        (0..(seconds * 25.0) as u32).find_map(|step| {
            let time_s = f64::from(step) * 0.04;
            height_m += climb_mps(time_s) * 0.04;
            let walk = (2.0 * 0.04 / 1100.0_f64).sqrt();
            weather_m += 1.5 * walk * noise();
            slow_m += 9.0 * walk * noise() - slow_m * 0.04 / 1100.0;
            heights_m.push(height_m + slow_m);
            if step % 5 == 0 && !out(time_s) {
                let mut fix = |late_s: f64, noise_mps: f64| {
                    let height_m = heights_m[(heights_m.len() - 1).saturating_sub((late_s / 0.04) as usize)];
                    let (time_s, down_mps) = (time_s - late_s, noise_mps - climb_mps(time_s - late_s));
                    watch.fix(Fix { time_s, height_m, down_mps });
                };
                if step % 15 == 0 {
                    fix(late_s + 0.4, 0.0);
                }
                fix(late_s, 0.05 * noise());
            }
            let told_m = wrong(time_s, height_m) + weather_m + 0.8 * noise();
            watch.height(time_s, told_m).map(|off_m| (time_s, off_m))
        })
    }

    #[test]
    fn sound_barometer_is_believed_for_hours() {
        for seed in 0..10 {
            assert_eq!(fly(seed, 3_600.0, |_, height_m| height_m), None, "seed {seed}");
        }
    }

    /// A loss of control that was recovered from: up to 84 m within four seconds, in each minute.
    #[test]
    fn sound_barometer_is_believed_through_dives() {
        for seed in 0..24 {
            let most_mps = 10.0 + seed as f64;
            let climb_mps = |time_s: f64| match (time_s + seed as f64) % 60.0 {
                phase if phase < 4.0 => -most_mps * (phase * std::f64::consts::PI / 4.0).sin(),
                _ => 1.0,
            };
            assert_eq!(fly_with(seed, 600.0, climb_mps, |_, height_m| height_m), None, "seed {seed}");
        }
    }

    #[test]
    fn port_that_is_blocked_is_found_when_the_aircraft_climbs() {
        for seed in 0..20 {
            let found = fly(seed, 200.0, |time_s, height_m| if time_s < 90.0 { height_m } else { 160.0 });
            let (time_s, off_m) = found.unwrap();
            assert!((90.0..130.0).contains(&time_s) && off_m.abs() > SHORT_M, "{time_s} s, {off_m} m");
        }
    }

    /// A sink rate of 3 m/s that a slow port follows by 15 s: the two climb alike after the outage, 45 m apart.
    #[test]
    fn port_that_became_slow_is_found_right_after_an_outage_and_a_sound_one_is_believed() {
        let out = |time_s: f64| (100.0..160.0).contains(&time_s);
        let climb_mps = |time_s: f64| if time_s > 120.0 { -3.0 } else { 0.0 };
        for seed in 0..40 {
            let slow = |time_s: f64, height_m: f64| height_m + (3.0 * (time_s - 120.0)).clamp(0.0, 45.0);
            let (time_s, off_m) = fly_without(seed, 200.0, out, climb_mps, slow).unwrap();
            assert!(
                (160.0..168.0).contains(&time_s) && (35.0..55.0).contains(&off_m),
                "{time_s} s, {off_m} m"
            );
            let sound = |_: f64, height_m: f64| height_m;
            assert_eq!(fly_without(seed, 300.0, out, climb_mps, sound), None, "seed {seed}");
        }
    }
}
