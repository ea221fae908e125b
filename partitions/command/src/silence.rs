//! A ground station that is not heard any more.
//!
//! Responsible for saying once that it is silent, with the order that the plan has for that, and once that it is back. It must never give
//! an order before a ground station was heard for the first time: an aircraft that flies without one has not lost it.

use bateleur_messages::ground::{Manoeuvre, Order};

/// What the plan says about a silent ground.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct OnSilence {
    /// What is flown; nothing: it is not even told.
    pub order: Option<Manoeuvre>,
    /// After so long, ns.
    pub after_ns: u64,
}

/// What has changed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Heard {
    /// It is silent: this order goes to the Controller.
    Lost(Order),
    /// It is there again. What the order began goes on until the ground says otherwise.
    Back,
}

/// Watches over the link.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Silence {
    on: OnSilence,
    /// Module time at which the ground was heard last, ns; zero: never.
    heard_ns: u64,
    lost: bool,
}

impl Silence {
    /// Nobody was heard yet.
    pub fn new(on: OnSilence) -> Self {
        Self { on, ..Self::default() }
    }

    /// Goes on where the incarnation before stood, see [`Silence::kept`].
    pub fn resume(&mut self, kept: [u64; 2]) {
        (self.heard_ns, self.lost) = (kept[0], kept[1] == 1);
    }

    /// What its successor goes on from.
    pub fn kept(&self) -> [u64; 2] {
        [self.heard_ns, u64::from(self.lost)]
    }

    /// Something of the ground's was understood.
    pub fn heard(&mut self, now_ns: u64) {
        self.heard_ns = now_ns.max(1);
    }

    /// Called in each window.
    pub fn window(&mut self, now_ns: u64) -> Option<Heard> {
        let what = self.on.order?;
        let silent = self.heard_ns != 0 && now_ns.saturating_sub(self.heard_ns) > self.on.after_ns;
        match (silent, std::mem::replace(&mut self.lost, silent)) {
            (true, false) => Some(Heard::Lost(Order::Manoeuvre { what, link_lost: true })),
            (false, true) => Some(Heard::Back),
            _ => None,
        }
    }

    /// How long it may be silent, s.
    pub fn patience_s(&self) -> f64 {
        self.on.after_ns as f64 * 1e-9
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;

    fn silence() -> Silence {
        Silence::new(OnSilence { order: Some(Manoeuvre::Return), after_ns: 10 * SECOND })
    }

    #[test]
    fn silent_ground_is_told_once_with_the_plans_order_and_once_when_it_is_back() {
        let mut silence = silence();
        silence.heard(5 * SECOND);
        assert_eq!(silence.window(15 * SECOND), None);
        let order = Order::Manoeuvre { what: Manoeuvre::Return, link_lost: true };
        assert_eq!(silence.window(16 * SECOND), Some(Heard::Lost(order)));
        assert_eq!(silence.window(17 * SECOND), None);
        silence.heard(20 * SECOND);
        assert_eq!(silence.window(20 * SECOND), Some(Heard::Back));
        assert_eq!(silence.window(31 * SECOND), Some(Heard::Lost(order)));
    }

    #[test]
    fn ground_that_was_never_heard_is_not_lost() {
        assert_eq!(silence().window(3600 * SECOND), None);
    }

    #[test]
    fn plan_that_says_nothing_about_it_does_nothing() {
        let mut silence = Silence::new(OnSilence { order: None, after_ns: SECOND });
        silence.heard(SECOND);
        assert_eq!(silence.window(100 * SECOND), None);
    }

    #[test]
    fn restart_forgets_neither_the_ground_nor_that_it_is_silent() {
        let mut first = silence();
        first.heard(5 * SECOND);
        let mut second = silence();
        second.resume(first.kept());
        assert!(second.window(16 * SECOND).is_some());
        let mut third = silence();
        third.resume(second.kept());
        assert_eq!(third.window(17 * SECOND), None, "told already");
    }
}
