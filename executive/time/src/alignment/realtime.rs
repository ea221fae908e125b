//! Where the machine's CLOCK_REALTIME stands, seen from the monotonic clock, and how far it can be trusted.
//!
//! Somebody else disciplines it (chrony, ntpd, phc2sys of a PTP clock) and tells the kernel so. It is only read here.
#![allow(unsafe_code)] // adjtimex, which no library of this workspace has

use std::mem::MaybeUninit;

use rustix::time::{ClockId, clock_gettime};

use bateleur_system::time::now_ns;

/// Readings of which the quickest counts: whoever is interrupted between two clocks is not believed.
const READINGS: usize = 5;

/// What one look found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sample {
    /// CLOCK_REALTIME less CLOCK_MONOTONIC, ns.
    pub offset_ns: i128,
    /// How long reading both took: the offset is no further away, ns.
    pub uncertainty_ns: u64,
    /// How far CLOCK_REALTIME itself is off, as the kernel believes, ns.
    pub error_ns: u64,
}

/// The disciplined clock.
#[derive(Debug, Default)]
pub struct Realtime;

impl Realtime {
    /// Reads it.
    ///
    /// # Errors
    /// It can not be trusted, and why.
    pub fn sample(&self) -> Result<Sample, String> {
        let error_ns = discipline()?;
        let readings = (0..READINGS).map(|_| {
            let before_ns = now_ns();
            let real = clock_gettime(ClockId::Realtime);
            let took_ns = now_ns().saturating_sub(before_ns);
            let real_ns = i128::from(real.tv_sec) * 1_000_000_000 + i128::from(real.tv_nsec);
            let offset_ns = real_ns - i128::from(before_ns) - i128::from(took_ns / 2);
            Sample { offset_ns, uncertainty_ns: took_ns, error_ns }
        });
        readings.min_by_key(|sample| sample.uncertainty_ns).ok_or_else(|| "it can not be read".into())
    }
}

/// How much later than a frame that begins at `start_ns` of the monotonic clock the grid of CLOCK_REALTIME has its next whole
/// multiple of `length_ns`, ns; less than half a frame either way.
#[must_use]
pub(super) fn phase_ns(start_ns: u64, offset_ns: i128, length_ns: u64) -> f64 {
    let length = i128::from(length_ns.max(1));
    let into = (i128::from(start_ns) + offset_ns).rem_euclid(length);
    super::nearest(-(into as f64), length_ns)
}

/// How far the clock is off, ns, where the kernel says that somebody keeps it right.
fn discipline() -> Result<u64, String> {
    let mut state = MaybeUninit::<libc::timex>::zeroed();
    // SAFETY: all zeros is a `timex` that asks for nothing to be changed.
    let state = unsafe { state.assume_init_mut() };
    // SAFETY: the structure is the caller's own, and the call fills it in.
    let result = unsafe { libc::adjtimex(state) };
    judge(result, state.status, (state.esterror, state.maxerror))
}

/// What `adjtimex` has said: the error, or in words why there is none. Of the two errors in µs, the estimated and the largest, some
/// daemons tell only one: what they do not tell stays at 16 s.
fn judge(
    result: i32,
    status: i32,
    (error_us, max_error_us): (libc::c_long, libc::c_long),
) -> Result<u64, String> {
    let mend = "start chrony, ntpd or phc2sys";
    match result {
        -1 => Err("the kernel does not say how CLOCK_REALTIME is kept".into()),
        libc::TIME_ERROR => Err(format!("CLOCK_REALTIME is not synchronised: {mend}")),
        _ if status & libc::STA_UNSYNC != 0 => Err(format!(
            "CLOCK_REALTIME is not synchronised (wrong by {:.1} s at most, as the kernel counts): {mend}",
            max_error_us as f64 / 1e6
        )),
        _ => Ok(u64::try_from(error_us.min(max_error_us)).unwrap_or(0).saturating_mul(1_000)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn phase_of_a_frame_is_the_way_to_the_nearest_multiple() {
        // 1000.030 s of real time: 30 ms after a multiple of 100 ms.
        let offset_ns = 999_000_000_000;
        assert!((phase_ns(1_030_000_000, offset_ns, 100_000_000) + 30e6).abs() < 1e-6);
        assert!((phase_ns(1_080_000_000, offset_ns, 100_000_000) - 20e6).abs() < 1e-6);
        assert!(phase_ns(1_100_000_000, offset_ns, 100_000_000).abs() < 1e-6);
        assert!((phase_ns(30_000_000, -90_000_000, 100_000_000) + 40e6).abs() < 1e-6, "before 1970 too");
    }

    #[test]
    fn clock_that_nobody_keeps_is_not_trusted_and_the_mend_is_said() {
        assert_eq!(judge(libc::TIME_OK, 0, (16_000_000, 500)), Ok(500_000), "as phc2sys has it");
        assert_eq!(judge(libc::TIME_OK, 0, (12, 30_000)), Ok(12_000), "as chrony has it");
        for (result, status) in [(libc::TIME_ERROR, 0), (libc::TIME_OK, libc::STA_UNSYNC)] {
            assert!(judge(result, status, (16_000_000, 16_000_000)).unwrap_err().contains("chrony"));
        }
        assert!(judge(-1, 0, (0, 0)).is_err());
    }

    #[test]
    fn both_clocks_are_read_within_a_millisecond_or_the_kernel_says_why_not() {
        match Realtime.sample() {
            Ok(sample) => assert!(sample.offset_ns > 0 && sample.uncertainty_ns < 1_000_000_000),
            Err(why) => assert!(why.contains("CLOCK_REALTIME")),
        }
    }
}
