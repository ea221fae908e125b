//! What the module's health log says, on its way to the ground: in order, at a pace that leaves the line to telemetry.
//!
//! Entries that say the same while they wait are one, with their number. What there is no room for is counted, and the count is told;
//! so is what a predecessor took from the log and could not tell any more.

use std::collections::VecDeque;

use bateleur_apex::HealthNotice;
use bateleur_messages::telemetry::HealthText;

/// From one text to the next, module time, ns.
const PACE_NS: u64 = 250_000_000;
/// Different texts that wait, most: four seconds of them.
const WAITING: usize = 16;
/// Severity of a word about what was lost.
const WARNING: u8 = 4;

/// See the module.
#[derive(Debug, Default)]
pub struct HealthTexts {
    waiting: VecDeque<(HealthNotice, u32)>,
    untold: u64,
    next_ns: u64,
}

impl HealthTexts {
    /// Takes an entry of the log.
    pub fn take(&mut self, notice: HealthNotice) {
        let room = self.waiting.len() < WAITING;
        match self.waiting.iter_mut().find(|(waiting, _)| *waiting == notice) {
            Some((_, times)) => *times = times.saturating_add(1),
            None if room => self.waiting.push_back((notice, 1)),
            None => self.untold += 1,
        }
    }

    /// So many entries will never be told.
    pub fn lose(&mut self, count: u64) {
        self.untold = self.untold.saturating_add(count);
    }

    /// Entries that a successor could not tell: those that wait, and those that are lost and not told of yet.
    pub fn owed(&self) -> u64 {
        let waiting: u64 = self.waiting.iter().map(|(_, times)| u64::from(*times)).sum();
        self.untold.saturating_add(waiting)
    }

    /// What is due at module time `now_ns`.
    pub fn next(&mut self, now_ns: u64) -> Option<HealthText> {
        if now_ns < self.next_ns || (self.waiting.is_empty() && self.untold == 0) {
            return None;
        }
        self.next_ns = now_ns.saturating_add(PACE_NS);
        if let Some((notice, times)) = self.waiting.pop_front() {
            return Some(HealthText::of(notice.severity, &notice.text, times, now_ns));
        }
        let text = format!("{} entries of the health log were not told", std::mem::take(&mut self.untold));
        Some(HealthText::of(WARNING, &text, 1, now_ns))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CYCLE: u64 = 20_000_000;

    fn notice(text: &str) -> HealthNotice {
        HealthNotice { severity: 3, text: text.into() }
    }

    /// What is told in so many seconds from `from_s` on.
    fn told(texts: &mut HealthTexts, from_s: u64, seconds: u64) -> Vec<(String, u32)> {
        let windows = from_s * 50..(from_s + seconds) * 50;
        let told = windows.filter_map(|window| texts.next(window * CYCLE));
        told.map(|text| (text.text().to_owned(), text.times)).collect()
    }

    #[test]
    fn entries_are_told_in_order_and_not_faster_than_the_pace() {
        let mut texts = HealthTexts::default();
        (0..8).for_each(|number| texts.take(notice(&number.to_string())));
        assert_eq!(told(&mut texts, 0, 1).len(), 4);
        assert_eq!(told(&mut texts, 1, 10).last().unwrap().0, "7");
    }

    #[test]
    fn flood_of_one_fault_is_one_text_with_its_number_and_no_entry_is_lost_silently() {
        let mut texts = HealthTexts::default();
        texts.take(notice("first"));
        (0..1_000).for_each(|_| texts.take(notice("window_overrun")));
        (0..100).for_each(|number| texts.take(notice(&number.to_string())));
        texts.lose(5);
        assert_eq!(texts.owed(), 1 + 1_000 + 100 + 5);
        let told = told(&mut texts, 0, 20);
        assert_eq!(told[1], ("window_overrun".into(), 1_000));
        assert_eq!(told.last().unwrap().0, "91 entries of the health log were not told");
        assert_eq!((told.len(), texts.owed()), (17, 0));
    }
}
