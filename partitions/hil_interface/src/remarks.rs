//! What a simulator sends that can hardly be meant so: told once, with the mend.
//!
//! None of it is refused here. It would otherwise show much later and elsewhere: as an airspeed of nought, an Estimator
//! that never becomes ready, or a virtual clock that seems to stand.

use crate::inbox::Sensors;

/// Sensor sets on end in which something has to be found before it is told: one second at 50 Hz.
const ENOUGH: u32 = 50;
/// Static pressures of a real atmosphere between 16 km and well below the sea, Pa.
const STATIC_PA: std::ops::Range<f64> = 10_000.0..120_000.0;

/// Something that may be found in a sensor set.
#[derive(Debug, Clone, Copy, Default)]
struct Finding {
    sets: u32,
    told: bool,
}

impl Finding {
    /// Whether to tell it now: it was found in so many sets on end, and has not been told yet.
    fn note(&mut self, found: bool, enough: u32) -> bool {
        self.sets = if found { self.sets.saturating_add(1) } else { 0 };
        let tell = self.sets >= enough && !self.told;
        self.told |= tell;
        tell
    }
}

/// What was found so far, and what of it waits to be told. The health log takes 128 bytes of each.
#[derive(Debug, Default)]
pub(crate) struct Remarks {
    other_time: Finding,
    fix_time: Finding,
    sticks_time: Finding,
    pressure: Finding,
    interval: Finding,
    waiting: Vec<String>,
}

impl Remarks {
    /// Sensors came that lie so far beside the time that was asked for; `is_answer`: they were taken for the answer all
    /// the same.
    pub(crate) fn note_time(&mut self, beside_ns: i128, is_answer: bool) {
        // A late answer lies a cycle beside it now and then; nothing else for a second is another matter.
        let enough = if is_answer { 1 } else { ENOUGH };
        if self.other_time.note(beside_ns != 0, enough) {
            self.waiting.push(format!(
                "answers carry another time than asked, by {beside_ns:+} ns: late, or stamp II with the question's time"
            ));
        }
    }

    /// A fix was refused for its time.
    pub(crate) fn note_fix_time(&mut self, beside_ns: i128) {
        if self.fix_time.note(true, 1) {
            let beside_s = beside_ns as f64 / 1e9;
            self.waiting.push(format!(
                "fix refused, {beside_s:+.3e} s beside module time: stamp GG on the clock of II, in ns"
            ));
        }
    }

    /// Sticks came that lie so far beside the time that was asked for; `refused`: too far.
    pub(crate) fn note_sticks_time(&mut self, beside_ns: i128, refused: bool) {
        if self.sticks_time.note(refused, ENOUGH) {
            let beside_s = beside_ns as f64 / 1e9;
            self.waiting.push(format!(
                "sticks refused, {beside_s:+.3e} s beside module time: stamp CC on the clock of II, in ns"
            ));
        }
    }

    /// A window is over, and these are its sensors.
    pub(crate) fn note_values(&mut self, sensors: &Sensors) {
        let Some(analog) = &sensors.analog else { return };
        let pa = analog.static_pressure_pa;
        if self.pressure.note(pa.is_finite() && !STATIC_PA.contains(&pa), ENOUGH) {
            self.waiting.push(format!(
                "static pressure of {pa:.4e} Pa: native II takes Pa, MAVLink hPa, both pressures alike"
            ));
        }
        let is_measured =
            analog.specific_force_mps2.iter().chain(&analog.rates_radps).all(|value| value.is_finite());
        if self.interval.note(is_measured && analog.interval_ns == 0, ENOUGH) {
            self.waiting.push(
                "the interval of forces and rates is always 0, so they are not used (II interval; MAVLink bit 31)".into(),
            );
        }
    }

    /// What is to be told now.
    pub(crate) fn take(&mut self) -> Vec<String> {
        std::mem::take(&mut self.waiting)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_messages::RawAnalog;

    fn sound() -> RawAnalog {
        RawAnalog { interval_ns: 20_000_000, static_pressure_pa: 101_325.0, ..RawAnalog::default() }
    }

    /// What is told about `windows` of these.
    fn told(analog: RawAnalog, windows: u32) -> Vec<String> {
        let mut remarks = Remarks::default();
        for _ in 0..windows {
            remarks.note_values(&Sensors { analog: Some(analog), ..Sensors::default() });
        }
        let told = remarks.take();
        assert!(told.iter().all(|text| text.len() <= 128), "{told:?}");
        told
    }

    #[test]
    fn pressures_in_the_wrong_unit_are_told_once_with_the_value() {
        assert_eq!(told(sound(), 500), Vec::<String>::new());
        for pa in [1_013.25, 10_132_500.0, f64::MAX] {
            let told = told(RawAnalog { static_pressure_pa: pa, ..sound() }, 500);
            assert!(told.len() == 1 && told[0].contains(&format!("{pa:.4e} Pa")), "{told:?}");
        }
        let nothing = RawAnalog { static_pressure_pa: f64::NAN, ..sound() };
        assert!(told(nothing, 500).is_empty());
    }

    #[test]
    fn interval_that_is_always_nought_is_told_once_and_that_of_a_lost_set_is_not() {
        let none = RawAnalog { interval_ns: 0, ..sound() };
        assert!(told(none, 49).is_empty(), "the first answer has none");
        let said = told(none, 500);
        assert!(said.len() == 1 && said[0].contains("interval"), "{said:?}");
        assert!(told(RawAnalog { rates_radps: [f64::NAN; 3], ..none }, 500).is_empty());
    }

    #[test]
    fn texts_about_times_fit_into_the_health_log_whatever_the_time() {
        let mut remarks = Remarks::default();
        remarks.note_time(i128::from(u64::MAX), true);
        remarks.note_fix_time(-i128::from(u64::MAX));
        let told = remarks.take();
        assert!(told.len() == 2 && told.iter().all(|text| text.len() <= 128), "{told:?}");
    }
}
