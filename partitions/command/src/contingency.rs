//! What is flown without an order of the ground: because the ground is silent, the battery low, the receiver without fixes, the pitot not
//! believed.
//!
//! Responsible for giving each order of the plan's ladders once, at its time, and for saying when its cause is over. Nothing is given on
//! the ground, where the Controller would refuse it, and a ground or a receiver that was never heard is not lost.

use bateleur_apex::{Attributes, StartError, parse_duration};
use bateleur_messages::control::PITOT_NOT_BELIEVED;
use bateleur_messages::ground::{Manoeuvre, Order, Reason};
use bateleur_messages::telemetry::{
    NAVIGATION_ABORTED, NAVIGATION_AUTOPILOT, NAVIGATION_LANDED, NAVIGATION_LANDING, NAVIGATION_LOITER,
    NAVIGATION_OUTSIDE, NAVIGATION_PROTECTION_SHIFT, NAVIGATION_RETURN, NAVIGATION_TAKE_OFF, Telemetry,
};
use serde::Deserialize;

/// A second, ns.
const SECOND_NS: u64 = 1_000_000_000;
/// Least time for what telemetry tells, which comes every two seconds.
const LEAST_NS: u64 = 5 * SECOND_NS;
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

/// In the air, with the autopilot on.
fn is_flying(flags: u32) -> bool {
    let on_ground = NAVIGATION_TAKE_OFF | NAVIGATION_ABORTED | NAVIGATION_LANDED;
    flags & NAVIGATION_AUTOPILOT != 0 && flags & on_ground == 0
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
pub struct Contingency {
    /// In the order of [`Cause::ALL`].
    pub ladders: [Ladder; Cause::ALL.len()],
    /// Below this the battery is low, V.
    pub low_battery_v: f64,
}

impl Contingency {
    /// Reads it.
    ///
    /// # Errors
    /// When an attribute has another type or a value that makes no sense.
    pub fn read(attributes: &mut Attributes) -> Result<Self, StartError> {
        let low_battery = ladder(attributes, "low_battery", 5 * SECOND_NS)?;
        let low_battery_v: Option<f64> = attributes.get("low_battery_v", None)?;
        if low_battery[0].is_some() && !low_battery_v.is_some_and(|volts| (1.0..=1000.0).contains(&volts)) {
            return Err(StartError::Other(
                "attribute low_battery: give low_battery_v too, the voltage below which the battery is low, from 1 to 1000 V".into(),
            ));
        }
        Ok(Self {
            ladders: [
                ladder(attributes, "lost_link", 10 * SECOND_NS)?,
                low_battery,
                ladder(attributes, "lost_satellites", 30 * SECOND_NS)?,
                ladder(attributes, "lost_pitot", 10 * SECOND_NS)?,
            ],
            low_battery_v: low_battery_v.unwrap_or_default(),
        })
    }
}

/// What an attribute says: one manoeuvre, or several, each after so long.
#[derive(Deserialize)]
#[serde(untagged)]
enum Words {
    One(String),
    Several(Vec<Written>),
}

/// One of several.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    fly: String,
    after: String,
}

/// The ladder of an attribute; `usual_ns` and the attribute `…_after` are for one manoeuvre.
fn ladder(attributes: &mut Attributes, name: &str, usual_ns: u64) -> Result<Ladder, StartError> {
    let wrong = |what: String| StartError::Other(format!("attribute {name}: {what}"));
    let after_ns = attributes.duration_ns(&format!("{name}_after"), usual_ns)?;
    let words = attributes.get(name, Words::One("none".into())).map_err(|_| {
        wrong("give one manoeuvre, or several such as [{ fly = \"loiter\", after = \"10s\" }]".into())
    })?;
    let steps = match words {
        Words::One(none) if none == "none" => Vec::new(),
        Words::One(fly) => vec![(fly, after_ns)],
        Words::Several(steps) => steps
            .into_iter()
            .map(|Written { fly, after }| {
                let after_ns = parse_duration(&after)
                    .ok_or_else(|| wrong(format!("after = \"{after}\": give a duration such as \"10s\"")))?;
                Ok((fly, after_ns))
            })
            .collect::<Result<_, StartError>>()?,
    };
    if steps.len() > MOST_RUNGS {
        return Err(wrong(format!("{} manoeuvres: give {MOST_RUNGS} at most", steps.len())));
    }
    let mut ladder = Ladder::default();
    let mut before_ns = 0;
    let least_ns = if name == "lost_link" { SECOND_NS } else { LEAST_NS };
    for (place, (fly, after_ns)) in ladder.iter_mut().zip(steps) {
        let flown = [Manoeuvre::Loiter, Manoeuvre::Return, Manoeuvre::Land];
        let Some(fly) = flown.into_iter().find(|one| one.name() == fly) else {
            return Err(wrong(format!("\"{fly}\": give \"none\", \"loiter\", \"return\" or \"land\"")));
        };
        if after_ns < least_ns || after_ns <= before_ns {
            let least_s = least_ns / SECOND_NS;
            return Err(wrong(format!("give {least_s}s or more, and each manoeuvre after the one before")));
        }
        (*place, before_ns) = (Some(Rung { after_ns, fly }), after_ns);
    }
    Ok(ladder)
}

/// What has changed.
#[derive(Debug, Clone, PartialEq)]
pub struct Change {
    /// What it is about.
    pub cause: Cause,
    /// For the health log and the ground.
    pub text: String,
    /// For the Controller.
    pub order: Option<Order>,
}

/// Watches over the causes.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Contingencies {
    plan: Contingency,
    /// Module time at which each began, ns; of ground and receiver when they were heard last; zero: never.
    since_ns: [u64; Cause::ALL.len()],
    /// How many orders of each ladder were given.
    given: [u64; Cause::ALL.len()],
    /// What the Controller says of navigation, [`Navigation::flags`].
    flags: u32,
}

impl Contingencies {
    /// Nothing was heard yet.
    pub fn new(plan: Contingency) -> Self {
        Self { plan, ..Self::default() }
    }

    /// Goes on where the incarnation before stood, see [`Contingencies::kept`].
    pub fn resume(&mut self, kept: [u64; NUMBERS]) {
        let [flags, rest @ ..] = kept;
        self.since_ns.copy_from_slice(&rest[..4]);
        self.given.copy_from_slice(&rest[4..]);
        self.flags = u32::try_from(flags).unwrap_or_default();
    }

    /// What its successor goes on from.
    pub fn kept(&self) -> [u64; NUMBERS] {
        let mut kept = [u64::from(self.flags); NUMBERS];
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
                let flew = self.is_flying();
                self.flags = navigation.flags;
                let since_ns = &mut self.since_ns[Cause::Battery as usize];
                if *since_ns != 0 && !flew && is_flying(navigation.flags) {
                    *since_ns = now_ns; // a climb at full throttle says nothing
                }
                let doubted = self.is(PITOT_NOT_BELIEVED << NAVIGATION_PROTECTION_SHIFT);
                self.lasts(Cause::Pitot, doubted, now_ns);
            }
            _ => {}
        }
    }

    fn is(&self, bit: u32) -> bool {
        self.flags & bit != 0
    }

    fn is_flying(&self) -> bool {
        is_flying(self.flags)
    }

    /// Whether this would take more of the mission than what is flown already, and would not be refused.
    fn is_more(&self, fly: Manoeuvre) -> bool {
        let flown = [NAVIGATION_LANDING, NAVIGATION_RETURN, NAVIGATION_LOITER]
            .into_iter()
            .position(|bit| self.is(bit));
        let asked =
            [Manoeuvre::Land, Manoeuvre::Return, Manoeuvre::Loiter].into_iter().position(|one| one == fly);
        asked < flown.or(Some(usize::MAX))
    }

    /// The Controller took the order of a change.
    pub fn given(&mut self, cause: Cause) {
        self.given[cause as usize] += 1;
    }

    fn lasts(&mut self, cause: Cause, lasts: bool, now_ns: u64) {
        let since_ns = &mut self.since_ns[cause as usize];
        *since_ns = match (lasts, *since_ns) {
            (false, _) => 0,
            (true, 0) => now_ns.max(1),
            (true, since_ns) => since_ns,
        };
    }

    /// Called in each window; at most one change in each. One with an order comes again until it was [`Contingencies::given`].
    pub fn window(&mut self, now_ns: u64) -> Option<Change> {
        Cause::ALL.into_iter().find_map(|cause| self.look(cause, now_ns))
    }

    fn look(&mut self, cause: Cause, now_ns: u64) -> Option<Change> {
        let (ladder, since_ns) = (self.plan.ladders[cause as usize], self.since_ns[cause as usize]);
        let lasted_ns = if since_ns == 0 { 0 } else { now_ns.saturating_sub(since_ns) };
        let given = self.given[cause as usize];
        let first = ladder[0]?;
        if given > 0 && lasted_ns <= first.after_ns {
            self.given[cause as usize] = 0;
            return Some(Change { cause, text: cause.is_over().to_owned(), order: None });
        }
        let rung = ladder.get(usize::try_from(given).ok()?).copied().flatten()?;
        // Outside of the fence the Controller takes a landing alone.
        let waits = self.is(NAVIGATION_OUTSIDE) && rung.fly != Manoeuvre::Land;
        if lasted_ns <= rung.after_ns || !self.is_flying() || waits {
            return None;
        }
        if !self.is_more(rung.fly) {
            self.given(cause);
            return None;
        }
        let reason = if cause == Cause::Link { Reason::LostLink } else { Reason::Contingency };
        let text = format!("{} for {} s: {}", cause.text(), rung.after_ns as f64 / 1e9, rung.fly.name());
        Some(Change { cause, text, order: Some(Order::Manoeuvre { what: rung.fly, reason }) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_messages::telemetry::{GpsTelemetry, Navigation, Voltages};

    const SECOND: u64 = SECOND_NS;

    fn rung(after_s: u64, fly: Manoeuvre) -> Option<Rung> {
        Some(Rung { after_ns: after_s * SECOND, fly })
    }

    /// The ladder for one cause, in the air.
    fn with(cause: Cause, ladder: Ladder) -> Contingencies {
        let mut plan = Contingency { low_battery_v: 20.0, ..Contingency::default() };
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
            let Some(change) = contingencies.window(second * SECOND + 1) else { continue };
            if let Some(Order::Manoeuvre { what, .. }) = change.order {
                contingencies.given(change.cause);
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
        assert_eq!(silence.window(16 * SECOND), Some(lost), "until the Controller took it");
        silence.given(Cause::Link);
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
        for on_ground in [NAVIGATION_TAKE_OFF, NAVIGATION_LANDED, NAVIGATION_ABORTED] {
            pitot.telemetry(&navigation(doubted | on_ground), SECOND);
            assert_eq!(ordered(&mut pitot, 1..60), []);
        }
        pitot.telemetry(&navigation(doubted), 60 * SECOND);
        assert_eq!(ordered(&mut pitot, 60..70), [(60, Manoeuvre::Return)]);
    }

    #[test]
    fn nothing_calls_an_aircraft_back_and_outside_of_the_fence_only_a_landing_is_ordered() {
        for (flags, ordered_then) in [
            (NAVIGATION_LANDING, vec![]),
            (NAVIGATION_RETURN, vec![(20, Manoeuvre::Land)]),
            (NAVIGATION_LOITER, vec![(10, Manoeuvre::Return), (20, Manoeuvre::Land)]),
        ] {
            let mut link =
                with(Cause::Link, [rung(9, Manoeuvre::Return), rung(19, Manoeuvre::Land), None, None]);
            link.heard(SECOND);
            link.telemetry(&navigation(NAVIGATION_AUTOPILOT | flags), 2 * SECOND);
            assert_eq!(ordered(&mut link, 2..60), ordered_then);
        }
        let mut link = with(Cause::Link, [rung(9, Manoeuvre::Return), rung(19, Manoeuvre::Land), None, None]);
        link.heard(SECOND);
        link.telemetry(&navigation(NAVIGATION_AUTOPILOT | NAVIGATION_OUTSIDE), 2 * SECOND);
        assert_eq!(ordered(&mut link, 2..30), []);
        link.telemetry(&navigation(NAVIGATION_AUTOPILOT), 30 * SECOND);
        assert_eq!(ordered(&mut link, 30..60), [(30, Manoeuvre::Return), (31, Manoeuvre::Land)]);
    }

    #[test]
    fn battery_that_is_low_in_the_climb_alone_is_not_low() {
        let mut low = with(Cause::Battery, [rung(5, Manoeuvre::Land), None, None, None]);
        low.telemetry(&navigation(NAVIGATION_AUTOPILOT | NAVIGATION_TAKE_OFF), SECOND);
        low.telemetry(&battery(19.0), 2 * SECOND);
        low.telemetry(&navigation(NAVIGATION_AUTOPILOT), 40 * SECOND);
        assert_eq!(ordered(&mut low, 40..44), []);
        low.telemetry(&battery(21.0), 44 * SECOND);
        assert_eq!(ordered(&mut low, 44..80), []);
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

    fn read(json: &str) -> Result<Contingency, String> {
        let mut attributes = Attributes::new(serde_json::from_str(json).unwrap());
        Contingency::read(&mut attributes).map_err(|error| error.to_string())
    }

    #[test]
    fn plan_names_one_manoeuvre_or_several_and_what_makes_no_sense_is_refused_by_name() {
        let one = read(r#"{"lost_link": "return", "lost_link_after": "20s"}"#).unwrap();
        assert_eq!(one.ladders[Cause::Link as usize], [rung(20, Manoeuvre::Return), None, None, None]);
        let several =
            r#"{"lost_satellites": [{"fly": "loiter", "after": "10s"}, {"fly": "land", "after": "5min"}]}"#;
        let ladder = read(several).unwrap().ladders[Cause::Satellites as usize];
        assert_eq!(ladder, [rung(10, Manoeuvre::Loiter), rung(300, Manoeuvre::Land), None, None]);
        assert_eq!(read("{}").unwrap(), Contingency::default());
        for (wrong, named) in [
            (r#"{"lost_pitot": "dive"}"#, "lost_pitot"),
            (r#"{"lost_pitot": "take_off"}"#, "lost_pitot"),
            (r#"{"lost_link": "land", "lost_link_after": "10ms"}"#, "1s or more"),
            (
                r#"{"lost_link": [{"fly": "loiter", "after": "9s"}, {"fly": "land", "after": "9s"}]}"#,
                "after the one before",
            ),
            (r#"{"lost_link": [{"fly": "loiter", "after": "soon"}]}"#, "soon"),
            (r#"{"lost_link": 3}"#, "one manoeuvre"),
            (r#"{"low_battery": "land"}"#, "low_battery_v"),
        ] {
            let said = read(wrong).unwrap_err();
            assert!(said.contains(named), "{wrong}: {said}");
        }
    }
}
