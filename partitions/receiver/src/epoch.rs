//! When a solution was measured, in module time: from the receiver's own clock, not from when its last byte came.

/// How far the receiver's clock may run away from the module's between two solutions, as a share: crystals of both within
/// 50 parts in a million each.
const DRIFT: f64 = 100e-6;
/// A step of the receiver's clock beyond this is one, ns: a week's end, a leap, another receiver.
const STEP_NS: i64 = 1_000_000_000;
/// So much later than usual, ns, is still a line that stood and gives what it held back, and no step.
const LONGEST_DELAY_NS: i64 = 60_000_000_000;
/// A delay that stays the same for so long, ns, is none: the receiver's clock was set.
const SETTLED_NS: u64 = 5_000_000_000;
/// The same within this, ns.
const STEADY_NS: i64 = 100_000_000;

/// The relation between the receiver's time of week and module time.
///
/// A solution can only arrive late, never early, so that the least distance seen is the best. It is let grow as slowly as
/// crystals drift. What a line held back for seconds and then gives at once keeps its true age.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Epoch {
    /// From measurement to the last byte at the quickest, ns: computing and sending.
    latency_ns: u64,
    /// Module time of arrival less time of week, ns, and the arrival that it was last looked at.
    least: Option<(i64, u64)>,
    /// A distance that is far larger, ns, and since when it has been the same.
    late: Option<(i64, u64)>,
}

impl Epoch {
    /// For a receiver that needs `latency_ns` from measuring to the last byte of the solution.
    #[must_use]
    pub fn new(latency_ns: u64) -> Self {
        Self { latency_ns, least: None, late: None }
    }

    /// Module time at which a solution was measured, ns, that has time of week `itow_ms` and arrived at `arrival_ns`.
    pub fn measured_ns(&mut self, itow_ms: u32, arrival_ns: u64) -> u64 {
        let itow_ns = i64::from(itow_ms) * 1_000_000;
        let arrived = arrival_ns as i64;
        let distance = arrived - itow_ns;
        let seen = self.least;
        let least = match seen {
            Some((least, seen_ns)) if distance - least < STEP_NS && least - distance < STEP_NS => {
                self.late = None;
                let grown = (DRIFT * arrival_ns.saturating_sub(seen_ns) as f64) as i64;
                distance.min(least + grown)
            }
            Some((least, _)) if self.is_delay(distance, distance - least, arrival_ns) => least,
            _ => {
                self.late = None;
                distance
            }
        };
        self.least = Some((least, arrival_ns));
        u64::try_from(itow_ns + least - self.latency_ns as i64).unwrap_or(0)
    }
}

impl Epoch {
    /// Whether a far larger distance is the line's delay, and not a clock that was set.
    fn is_delay(&mut self, distance: i64, more_ns: i64, arrival_ns: u64) -> bool {
        if !(STEP_NS..LONGEST_DELAY_NS).contains(&more_ns) {
            return false;
        }
        match self.late {
            Some((late, since_ns)) if (distance - late).abs() < STEADY_NS => {
                arrival_ns.saturating_sub(since_ns) < SETTLED_NS
            }
            _ => {
                self.late = Some((distance, arrival_ns));
                true
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    #[test]
    fn late_arrivals_do_not_move_the_time_of_measurement() {
        let mut epoch = Epoch::new(80 * MS);
        let delays_ms = [90, 85, 120, 99, 85, 140, 88];
        let measured: Vec<u64> = delays_ms
            .iter()
            .enumerate()
            .map(|(i, delay)| {
                epoch.measured_ns(200_000 + 200 * i as u32, (5_000 + 200 * i as u64 + delay) * MS)
            })
            .collect();
        // From the second on, the quickest way so far (85 ms) stands for all.
        for (i, measured) in measured.iter().enumerate().skip(1) {
            let wanted = (5_000 + 200 * i as u64 + 5) * MS;
            assert!(measured.abs_diff(wanted) < MS / 5, "{i}: {measured} instead of {wanted}");
        }
    }

    #[test]
    fn slower_crystal_of_the_receiver_is_followed() {
        let mut epoch = Epoch::new(0);
        let mut last = 0;
        for i in 0..10_000_u64 {
            // The module's clock is 40 parts in a million faster.
            let arrival_ns = (i as f64 * 200e6 * (1.0 + 40e-6)) as u64 + 10 * MS;
            last = epoch.measured_ns(200 * i as u32, arrival_ns);
            assert!(arrival_ns.abs_diff(last) < 2 * MS, "{i}");
        }
        assert!(last > 0);
    }

    #[test]
    fn what_a_line_held_back_for_seconds_keeps_its_age() {
        let mut epoch = Epoch::new(0);
        for i in 0..10_u64 {
            epoch.measured_ns(200 * i as u32, 200 * i * MS);
        }
        // Five seconds of silence, then 25 solutions at once, then as usual.
        for i in 10..35_u64 {
            let measured = epoch.measured_ns(200 * i as u32, 7_000 * MS + i);
            assert!(measured.abs_diff(200 * i * MS) < MS, "{i}: {measured}");
        }
        assert!(epoch.measured_ns(7_000, 7_010 * MS).abs_diff(7_000 * MS) < 2 * MS);
    }

    #[test]
    fn clock_that_was_set_back_is_followed_after_five_seconds() {
        let mut epoch = Epoch::new(0);
        epoch.measured_ns(100_000, 10_000 * MS);
        let measured =
            |epoch: &mut Epoch, i: u64| epoch.measured_ns((90_000 + 200 * i) as u32, (10_200 + 200 * i) * MS);
        assert_eq!(measured(&mut epoch, 0), 0, "a delay of ten seconds, so far");
        let settled = (1..40).map(|i| measured(&mut epoch, i)).last().unwrap();
        assert_eq!(settled, (10_200 + 200 * 39) * MS);
    }

    #[test]
    fn end_of_the_week_begins_anew() {
        let mut epoch = Epoch::new(0);
        assert_eq!(epoch.measured_ns(604_799_800, 9_000 * MS), 9_000 * MS);
        assert_eq!(epoch.measured_ns(0, 9_200 * MS), 9_200 * MS);
    }
}
