//! When a solution was measured, in module time: from the receiver's own clock, not from when its last byte came.

/// How far the receiver's clock may run away from the module's between two solutions, as a share: crystals of both within
/// 50 parts in a million each.
const DRIFT: f64 = 100e-6;
/// A step of the receiver's clock beyond this begins anew, ns: a week's end, a leap, another receiver.
const STEP_NS: i64 = 1_000_000_000;

/// The relation between the receiver's time of week and module time.
///
/// A solution can only arrive late, never early, so that the least distance seen is the best. It is let grow as slowly as
/// crystals drift.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Epoch {
    /// From measurement to the last byte at the quickest, ns: computing and sending.
    latency_ns: u64,
    /// Module time of arrival less time of week, ns, and the arrival that it was last looked at.
    least: Option<(i64, u64)>,
}

impl Epoch {
    /// For a receiver that needs `latency_ns` from measuring to the last byte of the solution.
    #[must_use]
    pub fn new(latency_ns: u64) -> Self {
        Self { latency_ns, least: None }
    }

    /// Module time at which a solution was measured, ns, that has time of week `itow_ms` and arrived at `arrival_ns`.
    pub fn measured_ns(&mut self, itow_ms: u32, arrival_ns: u64) -> u64 {
        let itow_ns = i64::from(itow_ms) * 1_000_000;
        let arrived = arrival_ns as i64;
        let distance = arrived - itow_ns;
        let least = match self.least {
            Some((least, seen_ns)) if (distance - least).abs() < STEP_NS => {
                let grown = (DRIFT * arrival_ns.saturating_sub(seen_ns) as f64) as i64;
                distance.min(least + grown)
            }
            _ => distance,
        };
        self.least = Some((least, arrival_ns));
        u64::try_from(itow_ns + least - self.latency_ns as i64).unwrap_or(0)
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
    fn end_of_the_week_begins_anew() {
        let mut epoch = Epoch::new(0);
        assert_eq!(epoch.measured_ns(604_799_800, 9_000 * MS), 9_000 * MS);
        assert_eq!(epoch.measured_ns(0, 9_200 * MS), 9_200 * MS);
    }
}
