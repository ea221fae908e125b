//! What is flown without an order of the ground: because the ground is silent, the battery low, the receiver without fixes, the pitot not
//! believed.
//!
//! Responsible for giving each order of the plan's ladders once, at its time, and for saying when its cause is over. Nothing is given on
//! the ground, where the Controller would refuse it, and a ground or a receiver that was never heard is not lost.

use bateleur_messages::control::PITOT_NOT_BELIEVED;
use bateleur_messages::ground::{Manoeuvre, Order, Reason};
use bateleur_messages::telemetry::{
    NAVIGATION_AUTOPILOT, NAVIGATION_LANDED, NAVIGATION_PROTECTION_SHIFT, NAVIGATION_TAKE_OFF, Telemetry,
};

/// Orders of a ladder, at most.
pub const MOST_RUNGS: usize = 4;
/// Plain numbers that outlive a restart.
pub(crate) const NUMBERS: usize = 9;

/// Why something else is flown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// No ground station was heard.
    Link,
    /// The main battery's voltage is below that of the plan.
    Battery,
    /// The receiver has no fix.
    Satellites,
    /// The pitot is not believed.
    Pitot,
}

impl Cause {
    /// All of them, in the order in which they are kept.
    pub const ALL: [Self; 4] = [Self::Link, Self::Battery, Self::Satellites, Self::Pitot];

    fn text(self) -> &'static str {
        match self {
            Self::Link => "the ground was not heard",
            Self::Battery => "the battery is low",
            Self::Satellites => "the receiver has no fix",
            Self::Pitot => "the pitot is not believed",
        }
    }

    fn is_over(self) -> &'static str {
        match self {
            Self::Link => "the ground is heard again",
            Self::Battery => "the battery is not low any more",
            Self::Satellites => "the receiver has a fix again",
            Self::Pitot => "the pitot is believed again",
        }
    }
}

/// One order of a ladder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rung {
    /// How long the cause has lasted, ns.
    pub after_ns: u64,
    /// What is flown then.
    pub fly: Manoeuvre,
}

/// What the plan says of one cause.
pub type Ladder = [Option<Rung>; MOST_RUNGS];

/// What the plan says of all.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Plan {
    /// In the order of [`Cause::ALL`].
    pub ladders: [Ladder; Cause::ALL.len()],
    /// Below this the battery is low, V.
    pub low_battery_v: f64,
}

/// What has changed.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// For the health log and the ground.
    pub text: String,
    /// For the Controller.
    pub order: Option<Order>,
}

/// Watches over the causes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Contingencies {
    plan: Plan,
    /// Module time at which each began, ns; of ground and receiver when they were heard last; zero: never.
    since_ns: [u64; Cause::ALL.len()],
    /// How many orders of each ladder were given.
    given: [u64; Cause::ALL.len()],
    /// In the air, with the autopilot on.
    flying: bool,
}

impl Contingencies {
    /// Nothing was heard yet.
    pub fn new(plan: Plan) -> Self {
        Self { plan, ..Self::default() }
    }

    /// Goes on where the incarnation before stood, see [`Contingencies::kept`].
    pub fn resume(&mut self, kept: [u64; NUMBERS]) {
        let [flying, rest @ ..] = kept;
        self.since_ns.copy_from_slice(&rest[..4]);
        self.given.copy_from_slice(&rest[4..]);
        self.flying = flying == 1;
    }

    /// What its successor goes on from.
    pub fn kept(&self) -> [u64; NUMBERS] {
        let mut kept = [u64::from(self.flying); NUMBERS];
        kept[1..5].copy_from_slice(&self.since_ns);
        kept[5..].copy_from_slice(&self.given);
        kept
    }

    /// Something of the ground's was understood.
    pub fn heard(&mut self, now_ns: u64) {
        self.since_ns[Cause::Link as usize] = now_ns.max(1);
    }

    /// Takes what a function tells.
    pub fn telemetry(&mut self, telemetry: &Telemetry, now_ns: u64) {
        match telemetry {
            // Nobody measures a battery of 0 V.
            Telemetry::Voltages(volts) if volts.main_v > 0.0 => {
                self.lasts(Cause::Battery, volts.main_v < self.plan.low_battery_v, now_ns);
            }
            Telemetry::Gps(gps) => {
                let since_ns = &mut self.since_ns[Cause::Satellites as usize];
                *since_ns = (*since_ns).max(gps.measured_ns);
            }
            Telemetry::Navigation(navigation) => {
                let is = |bit: u32| navigation.flags & bit != 0;
                self.flying = is(NAVIGATION_AUTOPILOT) && !is(NAVIGATION_TAKE_OFF) && !is(NAVIGATION_LANDED);
                self.lasts(Cause::Pitot, is(PITOT_NOT_BELIEVED << NAVIGATION_PROTECTION_SHIFT), now_ns);
            }
            _ => {}
        }
    }

    fn lasts(&mut self, cause: Cause, lasts: bool, now_ns: u64) {
        let since_ns = &mut self.since_ns[cause as usize];
        *since_ns = match (lasts, *since_ns) {
            (false, _) => 0,
            (true, 0) => now_ns.max(1),
            (true, since_ns) => since_ns,
        };
    }

    /// Called in each window; at most one change in each.
    pub fn window(&mut self, now_ns: u64) -> Option<Change> {
        Cause::ALL.into_iter().find_map(|cause| self.look(cause, now_ns))
    }

    fn look(&mut self, cause: Cause, now_ns: u64) -> Option<Change> {
        let (ladder, since_ns) = (self.plan.ladders[cause as usize], self.since_ns[cause as usize]);
        let lasted_ns = if since_ns == 0 { 0 } else { now_ns.saturating_sub(since_ns) };
        let given = &mut self.given[cause as usize];
        let first = ladder[0]?;
        if *given > 0 && lasted_ns <= first.after_ns {
            *given = 0;
            return Some(Change { text: cause.is_over().to_owned(), order: None });
        }
        let rung = ladder.get(usize::try_from(*given).ok()?).copied().flatten()?;
        if lasted_ns <= rung.after_ns || !self.flying {
            return None;
        }
        *given += 1;
        let reason = if cause == Cause::Link { Reason::LostLink } else { Reason::Contingency };
        let text = format!("{} for {} s: {}", cause.text(), rung.after_ns as f64 * 1e-9, rung.fly.name());
        Some(Change { text, order: Some(Order::Manoeuvre { what: rung.fly, reason }) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_messages::telemetry::{GpsTelemetry, Navigation, Voltages};

    const SECOND: u64 = 1_000_000_000;

    fn rung(after_s: u64, fly: Manoeuvre) -> Option<Rung> {
        Some(Rung { after_ns: after_s * SECOND, fly })
    }

    /// The ladder for one cause, in the air.
    fn with(cause: Cause, ladder: Ladder) -> Contingencies {
        let mut plan = Plan { low_battery_v: 20.0, ..Plan::default() };
        plan.ladders[cause as usize] = ladder;
        let mut contingencies = Contingencies::new(plan);
        contingencies.telemetry(&navigation(NAVIGATION_AUTOPILOT), 1);
        contingencies
    }

    fn navigation(flags: u32) -> Telemetry {
        Telemetry::Navigation(Navigation { flags, ..Navigation::default() })
    }

    fn battery(main_v: f64) -> Telemetry {
        Telemetry::Voltages(Voltages { main_v, ..Voltages::default() })
    }

    /// What is ordered in each second from one to another.
    fn ordered(contingencies: &mut Contingencies, seconds: std::ops::Range<u64>) -> Vec<(u64, Manoeuvre)> {
        let mut orders = Vec::new();
        for second in seconds {
            if let Some(Order::Manoeuvre { what, .. }) =
                contingencies.window(second * SECOND + 1).and_then(|change| change.order)
            {
                orders.push((second, what));
            }
        }
        orders
    }

    #[test]
    fn silent_ground_is_told_once_with_the_plans_order_and_once_when_it_is_back() {
        let mut silence = with(Cause::Link, [rung(10, Manoeuvre::Return), None, None, None]);
        silence.heard(5 * SECOND);
        assert_eq!(silence.window(15 * SECOND), None);
        let lost = silence.window(16 * SECOND).unwrap();
        let order = Order::Manoeuvre { what: Manoeuvre::Return, reason: Reason::LostLink };
        assert_eq!(
            (lost.order, lost.text.as_str()),
            (Some(order), "the ground was not heard for 10 s: return")
        );
        assert_eq!(silence.window(17 * SECOND), None);
        silence.heard(20 * SECOND);
        let back = silence.window(20 * SECOND).unwrap();
        assert_eq!((back.order, back.text.as_str()), (None, "the ground is heard again"));
        assert!(silence.window(31 * SECOND).unwrap().order.is_some());
    }

    #[test]
    fn ground_or_receiver_that_was_never_heard_is_not_lost_and_a_plan_without_a_ladder_does_nothing() {
        for cause in Cause::ALL {
            let mut never = with(cause, [rung(10, Manoeuvre::Return), None, None, None]);
            assert_eq!(never.window(3600 * SECOND), None, "{cause:?}");
        }
        let mut nothing = with(Cause::Link, [None; MOST_RUNGS]);
        nothing.heard(SECOND);
        assert_eq!(nothing.window(100 * SECOND), None);
    }

    #[test]
    fn ladder_is_climbed_rung_by_rung_and_begins_anew_after_its_cause_was_over() {
        let ladder =
            [rung(10, Manoeuvre::Loiter), rung(60, Manoeuvre::Return), rung(300, Manoeuvre::Land), None];
        let mut gps = with(Cause::Satellites, ladder);
        let fix =
            |second: u64| Telemetry::Gps(GpsTelemetry { measured_ns: second * SECOND, ..Default::default() });
        gps.telemetry(&fix(100), 100 * SECOND);
        let climbed = [(110, Manoeuvre::Loiter), (160, Manoeuvre::Return), (400, Manoeuvre::Land)];
        assert_eq!(ordered(&mut gps, 100..900), climbed);
        gps.telemetry(&fix(900), 900 * SECOND);
        assert_eq!(gps.window(900 * SECOND).unwrap().text, "the receiver has a fix again");
        assert_eq!(ordered(&mut gps, 900..920), [(910, Manoeuvre::Loiter)]);
    }

    #[test]
    fn battery_is_low_when_it_stays_low_and_one_that_nobody_measures_is_not() {
        let mut low = with(Cause::Battery, [rung(5, Manoeuvre::Land), None, None, None]);
        low.telemetry(&battery(0.0), SECOND);
        assert_eq!(ordered(&mut low, 1..20), []);
        low.telemetry(&battery(19.0), 20 * SECOND);
        assert_eq!(ordered(&mut low, 20..24), []);
        low.telemetry(&battery(22.0), 24 * SECOND); // the climb was over
        assert_eq!(ordered(&mut low, 24..40), []);
        low.telemetry(&battery(19.5), 40 * SECOND);
        low.telemetry(&battery(19.4), 42 * SECOND);
        assert_eq!(ordered(&mut low, 40..60), [(45, Manoeuvre::Land)]);
    }

    #[test]
    fn nothing_is_ordered_on_the_ground_and_what_lasts_is_ordered_in_the_air() {
        let mut pitot = with(Cause::Pitot, [rung(5, Manoeuvre::Return), None, None, None]);
        let doubted = PITOT_NOT_BELIEVED << NAVIGATION_PROTECTION_SHIFT | NAVIGATION_AUTOPILOT;
        for on_ground in [NAVIGATION_TAKE_OFF, NAVIGATION_LANDED] {
            pitot.telemetry(&navigation(doubted | on_ground), SECOND);
            assert_eq!(ordered(&mut pitot, 1..60), []);
        }
        pitot.telemetry(&navigation(doubted), 60 * SECOND);
        assert_eq!(ordered(&mut pitot, 60..70), [(60, Manoeuvre::Return)]);
    }

    #[test]
    fn restart_forgets_neither_the_cause_nor_what_was_ordered() {
        let ladder = [rung(10, Manoeuvre::Loiter), rung(20, Manoeuvre::Land), None, None];
        let plan = with(Cause::Link, ladder);
        let mut first = plan;
        first.heard(5 * SECOND);
        let mut second = plan;
        second.resume(first.kept());
        assert_eq!(ordered(&mut second, 5..20), [(15, Manoeuvre::Loiter)]);
        let mut third = plan;
        third.resume(second.kept());
        assert_eq!(ordered(&mut third, 20..60), [(25, Manoeuvre::Land)], "each once");
    }
}
