//! The scripted ground station: from the first order to the last way-point.
//!
//! A state machine with one step. Each phase says what it asks for on entering, when it is done, and how long it may
//! take; from the take-off on, everything already established is watched and ordered again where it is lost.

use crate::board::Board;
use crate::link::{Link, LinkError};
use crate::parameters::setting;
use crate::pilot::Pilot;
use crate::plan::MissionPlan;
use crate::progress::{Event, Outcome, Phase, Progress, Severity};
use crate::retry_queue::{RETRY_NS, RetryQueue, Settled, function_name};
use crate::watch::{Losses, Watch};
use bateleur_messages::control::NO_POWER;
use bateleur_messages::ground::{
    EstimatorOrder, Manoeuvre, Order, Reason, SENSOR_GYROSCOPE, SENSOR_PRESSURE,
};
use bateleur_messages::hil::{PILOT_TAKE_OFF, PilotOrder};
use bateleur_messages::state::{STATUS_COARSE, STATUS_DISABLED, STATUS_RUNNING};
use bateleur_messages::telemetry::{
    Acknowledge, NAVIGATION_ABORTED, NAVIGATION_FINISHED, NAVIGATION_LANDED, NAVIGATION_LINK_LOST,
    NAVIGATION_OUTSIDE, NAVIGATION_PROTECTION_SHIFT, NAVIGATION_RETURN, NOT_UNDERSTOOD, Navigation, Refusal,
    StateTelemetry, Telemetry,
};

const SECOND_NS: u64 = 1_000_000_000;
/// Silence after which the line is called silent, ns: the aircraft speaks every half second.
const SILENCE_NS: u64 = 5 * SECOND_NS;
/// An estimate or a measurement older than this, ns, is not shown as if it were of now: both come every half second.
const STALE_NS: u64 = 3 * SECOND_NS;
/// Silence after which the mission is given up, ns. Command may be restarted several times within it.
const LOST_NS: u64 = 30 * SECOND_NS;
/// A coarse state is taken for good enough after this time, ns: some biases show only in flight.
const COARSE_PATIENCE_NS: u64 = 10 * SECOND_NS;
/// Slowest climb that counts as rising, m/s.
const RISING_MPS: f64 = 0.3;
/// Lower than this, m, and slower than [`GROUNDED_MPS`] in the air or [`STANDING_MPS`] over ground for [`GROUNDED_NS`], the aircraft
/// is down: in a wind a wreck has airspeed. All of them are far outside what flight shows.
const GROUNDED_M: f64 = 3.0;
const GROUNDED_MPS: f64 = 6.0;
const STANDING_MPS: f64 = 2.0;
const GROUNDED_NS: u64 = 5 * SECOND_NS;
/// The same for one that is to be there.
const LANDED_NS: u64 = 15 * SECOND_NS;
/// After a landing it stands below this, m/s.
const STOPPED_MPS: f64 = 0.7;

/// The Controller's parameter for the laps.
const LAPS: &str = "CTL_LAPS";
/// What to do where nobody takes off.
const NO_PILOT: &str = "; is a safety pilot at the sticks? For a simulator that has none, write take_off = \"autopilot\" in \
                        the mission file (--mission)";

/// What the aircraft does instead of flying to its way-points, by the flags of its navigation; the first says most.
const CONDITIONS: [(u32, &str); 5] = [
    (
        NO_POWER << NAVIGATION_PROTECTION_SHIFT,
        "the aircraft has no power and glides to the runway; way-points are not flown to",
    ),
    (NAVIGATION_OUTSIDE, "the aircraft has left its fence and acts on that; way-points are not flown to"),
    (
        NAVIGATION_LINK_LOST,
        "the aircraft does not hear the ground and acts on that; way-points are not flown to",
    ),
    (NAVIGATION_ABORTED, "the take-off was broken off"),
    (NAVIGATION_RETURN, "the aircraft flies back to the runway and circles there"),
];

/// A mission under way.
#[derive(Debug)]
pub struct Mission {
    plan: MissionPlan,
    /// The laps are the Controller's by an order of ours, and not by its plan.
    sets_laps: bool,
    board: Board,
    retry_queue: RetryQueue,
    watch: Watch,
    phase: Phase,
    now_ns: u64,
    started_ns: Option<u64>,
    phase_since_ns: u64,
    pilot_called_ns: u64,
    grounded_since_ns: Option<u64>,
    reached: u32,
    flags: u32,
    rearmed: u32,
    silent: bool,
    estimator_silent: bool,
    incoming: Vec<Telemetry>,
    events: Vec<Event>,
    outcome: Outcome,
}

impl Mission {
    /// A mission that begins with its first step.
    pub fn new(plan: MissionPlan) -> Self {
        Self {
            plan,
            sets_laps: false,
            board: Board::default(),
            retry_queue: RetryQueue::default(),
            watch: Watch::default(),
            phase: Phase::EnableHil,
            now_ns: 0,
            started_ns: None,
            phase_since_ns: 0,
            pilot_called_ns: 0,
            grounded_since_ns: None,
            reached: 0,
            flags: 0,
            rearmed: 0,
            silent: false,
            estimator_silent: false,
            incoming: Vec::new(),
            events: Vec::new(),
            outcome: Outcome::Running,
        }
    }

    /// The same, and the Controller is told the laps: for a module whose plan knows nothing of this mission, and counts its
    /// own.
    #[must_use]
    pub fn setting_laps(self) -> Self {
        Self { sets_laps: true, ..self }
    }

    /// The newest telemetry.
    pub fn board(&self) -> &Board {
        &self.board
    }

    /// Reads what came, goes on in the script, sends what is due. Call it every 100 ms or so; `now_ns` never falls.
    pub fn step(&mut self, now_ns: u64, link: &mut Link, pilot: &mut dyn Pilot) -> Progress {
        self.now_ns = now_ns;
        if self.started_ns.is_none() {
            self.started_ns = Some(now_ns);
            self.enter(Phase::EnableHil, pilot);
        }
        if let Err(error) = self.run(link, pilot) {
            self.fail(format!("{}: {error}", self.phase));
        }
        self.progress()
    }

    fn run(&mut self, link: &mut Link, pilot: &mut dyn Pilot) -> Result<(), LinkError> {
        self.read(link)?;
        while self.outcome == Outcome::Running && self.is_done(pilot) {
            let next = match following(self.phase) {
                Phase::Land if !self.plan.landing => Phase::End,
                next => next,
            };
            self.enter(next, pilot);
        }
        if self.outcome == Outcome::Running {
            self.repair();
            self.check_limits();
        }
        self.retry_queue.send_due(self.now_ns, link)?;
        link.beat(self.now_ns)?;
        link.flush()
    }

    fn read(&mut self, link: &mut Link) -> Result<(), LinkError> {
        let mut incoming = std::mem::take(&mut self.incoming);
        let received = link.receive(|telemetry| incoming.push(telemetry));
        for telemetry in incoming.drain(..) {
            self.take(&telemetry);
        }
        self.incoming = incoming;
        received
    }

    fn take(&mut self, telemetry: &Telemetry) {
        let restarts = self.board.module_restarts;
        self.board.take(telemetry, self.now_ns);
        if self.board.module_restarts != restarts {
            self.retry_queue.forget_times();
            self.say(Severity::Warning, "the module's clock began anew".to_owned());
        }
        self.watch.notice(telemetry, &self.board);
        match telemetry {
            Telemetry::Acknowledge(answer) => {
                let time_ns = self.board.time_of_answer_ns(answer);
                self.answered(&Acknowledge { time_ns, ..*answer });
            }
            Telemetry::Navigation(navigation) => self.navigated(navigation),
            _ => {}
        }
    }

    fn answered(&mut self, answer: &Acknowledge) {
        match self.retry_queue.answer(answer) {
            Some(Settled::Refused(Order::InitialiseSensors { .. }, _)) => {
                self.say(Severity::Info, "the IMU keeps its present biases".to_owned());
            }
            Some(Settled::Refused(order, answer)) if answer.result == NOT_UNDERSTOOD => {
                let name = function_name(answer.from);
                self.say(Severity::Warning, format!("{name} does not understand {}", order_name(&order)));
            }
            Some(Settled::Accepted(order)) if self.phase >= Phase::Engage => {
                self.say(Severity::Info, format!("{} acknowledged", order_name(&order)));
            }
            _ => {}
        }
    }

    fn navigated(&mut self, navigation: &Navigation) {
        let reached = navigation.waypoints_reached;
        if reached > self.reached && self.phase >= Phase::Watch {
            let total = self.plan.waypoints_to_reach();
            let height = self.fresh_altitude_m().map_or(String::new(), |height| format!(" at {height:.1} m"));
            self.say(Severity::Info, format!("{reached} of {total} way-points reached{height}"));
        }
        self.reached = reached;
        let began = navigation.flags & !self.flags;
        self.flags = navigation.flags;
        for (flag, text) in CONDITIONS {
            if began & flag != 0 && self.phase >= Phase::Watch {
                self.say(Severity::Warning, text.to_owned());
            }
        }
    }

    /// What keeps the aircraft from its way-points, by its own word.
    fn kept_from(&self) -> String {
        let held = CONDITIONS.iter().find(|(flag, _)| self.flags & flag != 0);
        held.map_or_else(String::new, |(_, text)| format!("; {text}"))
    }

    fn say(&mut self, severity: Severity, text: String) {
        self.events.push(Event { time_ns: self.now_ns, severity, text });
    }

    fn fail(&mut self, text: String) {
        if self.outcome == Outcome::Running {
            self.say(Severity::Failure, text.clone());
            self.outcome = Outcome::Failed(text);
        }
    }

    fn enter(&mut self, phase: Phase, pilot: &mut dyn Pilot) {
        self.phase = phase;
        self.phase_since_ns = self.now_ns;
        let own = phase == Phase::OrderTakeOff && self.plan.own_take_off;
        self.say(Severity::Info, if own { "ordering the take-off" } else { phase.name() }.to_owned());
        match phase {
            Phase::EnableHil => self.request(Order::Hil { on: true }),
            Phase::InitialiseSensors => {
                self.request(Order::InitialiseSensors { sensors: SENSOR_GYROSCOPE | SENSOR_PRESSURE });
            }
            Phase::InitialiseEstimator => self.request(initialise()),
            Phase::LoadWaypoints => self.request_waypoints(),
            Phase::SwitchNavigation => self.request(Order::Navigation { on: true }),
            Phase::OrderTakeOff if self.plan.own_take_off => {
                self.request(Order::Manoeuvre { what: Manoeuvre::TakeOff, reason: Reason::Ordered });
            }
            Phase::OrderTakeOff => self.call_pilot(pilot),
            Phase::Climb if self.plan.own_take_off => self.request(Order::Autopilot { on: true }),
            Phase::Engage => self.request(Order::Autopilot { on: true }),
            Phase::Land => self.request(Order::Manoeuvre { what: Manoeuvre::Land, reason: Reason::Ordered }),
            Phase::End => self.outcome = Outcome::Finished,
            _ => {}
        }
    }

    fn request(&mut self, order: Order) {
        self.retry_queue.request(order, self.board.module_ns);
    }

    /// What was set is lost together with the way-points, where a function begins cold.
    fn request_waypoints(&mut self) {
        if self.sets_laps
            && let Some(order) = setting(LAPS, f64::from(self.plan.laps))
        {
            self.request(order);
        }
        for &point in &self.plan.waypoints {
            self.retry_queue.request(Order::Waypoint(point), self.board.module_ns);
        }
    }

    fn call_pilot(&mut self, pilot: &mut dyn Pilot) {
        self.pilot_called_ns = self.now_ns;
        pilot.order(PilotOrder { order: PILOT_TAKE_OFF, reserved: 0 });
    }

    fn is_done(&mut self, pilot: &mut dyn Pilot) -> bool {
        match self.phase {
            Phase::EnableHil => !self.retry_queue.is_pending(b'H'),
            Phase::AwaitSensors => self.sensors_came(),
            Phase::InitialiseSensors => !self.retry_queue.is_pending(b'I'),
            Phase::InitialiseEstimator => !self.retry_queue.is_pending(b'E'),
            Phase::AwaitEstimator => self.estimator_can_be_flown_on(),
            Phase::LoadWaypoints => !self.retry_queue.is_pending(b'W') && !self.retry_queue.is_pending(b'Y'),
            Phase::SwitchNavigation => !self.retry_queue.is_pending(b'N'),
            Phase::OrderTakeOff if self.plan.own_take_off => !self.retry_queue.is_pending(b'F'),
            Phase::OrderTakeOff => self.pilot_understood(pilot),
            Phase::Climb => {
                self.check_take_off();
                self.is_high_and_rising()
            }
            Phase::Engage => !self.retry_queue.is_pending(b'A'),
            Phase::Watch => self.laps_are_flown(),
            Phase::Loiter => self.in_phase_ns() as f64 >= self.plan.loiter_s * 1e9,
            Phase::Land => self.stands(),
            Phase::End => false,
        }
    }

    fn in_phase_ns(&self) -> u64 {
        self.now_ns.saturating_sub(self.phase_since_ns)
    }

    fn sensors_came(&self) -> bool {
        let settled_ns = self.retry_queue.settled_ns(b'H');
        self.board.imu.is_some_and(|imu| imu.message.measured_ns > settled_ns)
    }

    fn estimator_can_be_flown_on(&mut self) -> bool {
        let Some(state) = self.state_since_initialised() else { return false };
        let patient = self.in_phase_ns() >= COARSE_PATIENCE_NS;
        if state.status == STATUS_DISABLED && self.in_phase_ns() > SECOND_NS {
            self.request(Order::Estimator(EstimatorOrder::Enable));
        }
        state.status == STATUS_RUNNING || (patient && state.status == STATUS_COARSE)
    }

    fn state_since_initialised(&self) -> Option<StateTelemetry> {
        let settled_ns = self.retry_queue.settled_ns(b'E');
        let state = self.board.state.filter(|state| state.received_ns >= self.phase_since_ns)?.message;
        (state.valid_ns > settled_ns || state.status == STATUS_DISABLED).then_some(state)
    }

    fn pilot_understood(&mut self, pilot: &mut dyn Pilot) -> bool {
        let understood = pilot.confirmed();
        if !understood && self.now_ns.saturating_sub(self.pilot_called_ns) >= RETRY_NS {
            self.call_pilot(pilot);
        }
        understood
    }

    fn is_high_and_rising(&self) -> bool {
        self.board.state.is_some_and(|state| {
            let high = -state.message.position_ned_m[2] > self.plan.engage_altitude_m;
            high && -state.message.velocity_ned_mps[2] > RISING_MPS && state.message.status >= STATUS_COARSE
        })
    }

    /// A take-off that the Controller has given up is not waited for.
    fn check_take_off(&mut self) {
        let settled_ns = self.retry_queue.settled_ns(b'F');
        let latest = self.board.navigation.map(|navigation| navigation.message);
        let Some(navigation) = latest.filter(|navigation| navigation.time_ns > settled_ns) else { return };
        if self.plan.own_take_off && navigation.flags & NAVIGATION_ABORTED != 0 {
            self.fail(
                "the Controller has given the take-off up: the aircraft lost its direction, its speed or its state on the runway, or it was ordered to"
                    .to_owned(),
            );
        }
    }

    /// The Controller has landed, and the aircraft moves no more.
    fn stands(&self) -> bool {
        let settled_ns = self.retry_queue.settled_ns(b'F');
        let landed = self.board.navigation.is_some_and(|navigation| {
            navigation.message.time_ns > settled_ns && navigation.message.flags & NAVIGATION_LANDED != 0
        });
        landed && self.is_stopped()
    }

    fn is_stopped(&self) -> bool {
        self.fresh_ground_speed_mps().is_some_and(|speed| speed < STOPPED_MPS)
    }

    /// The Controller may have been told other laps by its plan, and has finished then; but not those of an order of ours.
    fn laps_are_flown(&mut self) -> bool {
        let settled_ns = self.retry_queue.settled_ns(b'N');
        let latest = self.board.navigation.map(|navigation| navigation.message);
        let Some(navigation) = latest.filter(|navigation| navigation.time_ns > settled_ns) else {
            return false;
        };
        let (reached, all) = (navigation.waypoints_reached, self.plan.waypoints_to_reach());
        let finished = navigation.flags & NAVIGATION_FINISHED != 0;
        if !self.plan.is_circuit() {
            return finished; // circles end it later than their places are reached
        }
        if finished && reached < all && self.sets_laps {
            let laps = self.plan.laps;
            self.fail(format!(
                "the Controller has finished after {reached} of {all} way-points: it counts other laps than the mission's \
                 {laps}; set {LAPS}={laps}, or laps = {laps} in the plan"
            ));
            return false;
        }
        finished || reached >= all
    }

    /// Orders again what a function has lost, as far as the script had come.
    fn repair(&mut self) {
        let lost = self.watch.losses(&self.board, &self.retry_queue, self.plan.waypoints.len());
        if lost.hil && self.phase > Phase::AwaitSensors {
            self.rearm(Order::Hil { on: true }, "HIL mode is lost: ordering it again");
        } else if lost.sensors && self.phase > Phase::AwaitSensors {
            self.rearm(
                Order::Hil { on: true },
                "no sensors come: ordering HIL mode once more, if it was lost",
            );
        }
        if lost.estimator && self.phase > Phase::AwaitEstimator {
            self.rearm(initialise(), "the Estimator is disabled: initialising it again");
        }
        if self.phase > Phase::SwitchNavigation {
            self.repair_navigation(lost);
        }
        let usable = self.board.state.is_some_and(|state| state.message.status >= STATUS_COARSE);
        if lost.autopilot && usable && self.phase >= Phase::Watch {
            self.rearm(Order::Autopilot { on: true }, "the autopilot has let go: engaging it again");
        }
    }

    fn repair_navigation(&mut self, lost: Losses) {
        let loading = self.retry_queue.is_pending(b'W');
        if lost.waypoints && !loading {
            self.request_waypoints();
            self.count_rearming("the Controller has lost the way-points: loading them again");
        } else if lost.navigation && !loading {
            self.rearm(Order::Navigation { on: true }, "navigation is off: switching it on again");
        }
    }

    fn rearm(&mut self, order: Order, text: &str) {
        if !self.retry_queue.is_pending(order.letter())
            && self.retry_queue.request(order, self.board.module_ns)
        {
            self.count_rearming(text);
        }
    }

    fn count_rearming(&mut self, text: &str) {
        self.rearmed += 1;
        self.say(Severity::Warning, text.to_owned());
    }

    fn check_limits(&mut self) {
        let in_mission_ns = self.now_ns.saturating_sub(self.started_ns.unwrap_or(self.now_ns));
        let limit_s = limit_s(self.phase);
        if matches!(self.phase, Phase::Watch | Phase::Loiter)
            && self.flags & (NAVIGATION_LANDED | NAVIGATION_FINISHED) == NAVIGATION_LANDED
            && self.is_stopped()
        {
            let (phase, why) = (self.phase, self.kept_from());
            self.fail(format!("it landed while {phase}{why}"));
        }
        // A landing has a limit of its own, and is not cut off by that of the laps.
        let over = in_mission_ns as f64 > self.plan.time_limit_s * 1e9;
        if over && self.phase != Phase::Land {
            let (phase, limit) = (self.phase, self.plan.time_limit_s);
            let why = self.kept_from();
            self.fail(format!("the mission's time limit of {limit} s is over while {phase}{why}"));
        } else if limit_s.is_some_and(|limit_s| self.in_phase_ns() > limit_s * SECOND_NS) {
            self.fail(self.why_not_in_time(limit_s.unwrap_or(0)));
        }
        self.check_silence();
        self.check_estimate();
        self.check_height();
    }

    /// How long ago the Estimator spoke last, ns, where that is longer than it should be.
    fn estimator_silent_ns(&self) -> Option<u64> {
        let age_ns = self.now_ns.saturating_sub(self.board.state?.received_ns);
        (age_ns > STALE_NS).then_some(age_ns)
    }

    fn fresh_altitude_m(&self) -> Option<f64> {
        self.board.altitude_m().filter(|_| self.estimator_silent_ns().is_none())
    }

    /// None also from an Estimator that is being aligned, whose state says nothing.
    fn fresh_ground_speed_mps(&self) -> Option<f64> {
        let state =
            self.board.state.filter(|state| self.now_ns.saturating_sub(state.received_ns) <= STALE_NS);
        let message = state.filter(|state| state.message.status >= STATUS_COARSE)?.message;
        Some(message.velocity_ned_mps[0].hypot(message.velocity_ned_mps[1]))
    }

    fn fresh_airspeed_mps(&self) -> Option<f64> {
        let imu = self.board.imu.filter(|imu| self.now_ns.saturating_sub(imu.received_ns) <= STALE_NS);
        imu.map(|imu| imu.message.airspeed_mps)
    }

    /// Says once that there is no estimate any more, and once that there is. A line that is silent altogether is told
    /// elsewhere.
    fn check_estimate(&mut self) {
        let silent = self.estimator_silent_ns().is_some() && !self.silent;
        if silent && !self.estimator_silent {
            self.say(Severity::Warning, "the Estimator has been silent for 3 s".to_owned());
        } else if self.estimator_silent && !silent && !self.silent {
            self.say(Severity::Info, "the Estimator is back".to_owned());
        }
        self.estimator_silent = silent || (self.estimator_silent && self.silent);
    }

    fn why_not_in_time(&self, limit_s: u64) -> String {
        let phase = self.phase;
        let start = format!("{phase} took longer than {limit_s} s: ");
        let reason = match (self.board.last_received_ns, self.retry_queue.last_refusal()) {
            (None, _) => {
                "nothing was heard from the aircraft; is it the right line, and does Command run?".to_owned()
            }
            (_, Some(refusal)) if refusal.time_ns + 2 * SECOND_NS > self.board.module_ns => {
                let why = Refusal::of(&refusal).map_or("it does not say why", Refusal::text);
                format!("{} refuses the order: {why}", function_name(refusal.from))
            }
            _ if phase == Phase::Climb && !self.plan.own_take_off => waiting_for(phase).to_owned() + NO_PILOT,
            _ => waiting_for(phase).to_owned(),
        };
        start + &reason
    }

    fn check_silence(&mut self) {
        let Some(silence_ns) = self.board.silence_ns(self.now_ns) else { return };
        let silent = silence_ns > SILENCE_NS;
        if silent && !self.silent {
            self.say(Severity::Warning, "no telemetry for 5 s".to_owned());
        } else if self.silent && !silent {
            self.say(Severity::Info, "telemetry is back".to_owned());
        }
        self.silent = silent;
        if silence_ns > LOST_NS {
            self.fail(format!("no telemetry for {} s while {}", LOST_NS / SECOND_NS, self.phase));
        }
    }

    fn check_height(&mut self) {
        let low = self.board.altitude_m().is_some_and(|height| height < GROUNDED_M);
        let slow = self.board.airspeed_mps().is_some_and(|speed| speed < GROUNDED_MPS);
        let stands = self.fresh_ground_speed_mps().is_some_and(|speed| speed < STANDING_MPS);
        // Who lands is on the ground before he says so.
        let patience_ns = if self.phase == Phase::Land { LANDED_NS } else { GROUNDED_NS };
        let landed = self.flags & NAVIGATION_LANDED != 0;
        if !(low && (slow || stands) && self.phase >= Phase::Engage) || landed {
            self.grounded_since_ns = None;
            return;
        }
        let since_ns = *self.grounded_since_ns.get_or_insert(self.now_ns);
        if self.now_ns.saturating_sub(since_ns) >= patience_ns {
            self.fail(format!("the aircraft came down while {}", self.phase));
        }
    }

    fn progress(&mut self) -> Progress {
        Progress {
            phase: self.phase,
            time_ns: self.now_ns,
            next_waypoint: self.board.navigation.map(|navigation| navigation.message.next_waypoint),
            altitude_m: self.fresh_altitude_m(),
            airspeed_mps: self.fresh_airspeed_mps(),
            estimator_silent_ns: self.estimator_silent_ns(),
            waypoints_reached: self.reached,
            waypoints_to_reach: self.plan.waypoints_to_reach(),
            rearmed: self.rearmed,
            events: std::mem::take(&mut self.events),
            outcome: self.outcome.clone(),
        }
    }
}

fn initialise() -> Order {
    Order::Estimator(EstimatorOrder::Initialise { full_inertial: true })
}

fn following(phase: Phase) -> Phase {
    match phase {
        Phase::EnableHil => Phase::AwaitSensors,
        Phase::AwaitSensors => Phase::InitialiseSensors,
        Phase::InitialiseSensors => Phase::InitialiseEstimator,
        Phase::InitialiseEstimator => Phase::AwaitEstimator,
        Phase::AwaitEstimator => Phase::LoadWaypoints,
        Phase::LoadWaypoints => Phase::SwitchNavigation,
        Phase::SwitchNavigation => Phase::OrderTakeOff,
        Phase::OrderTakeOff => Phase::Climb,
        Phase::Climb => Phase::Engage,
        Phase::Engage => Phase::Watch,
        Phase::Watch => Phase::Loiter,
        Phase::Loiter => Phase::Land,
        Phase::Land | Phase::End => Phase::End,
    }
}

/// Longest time in a phase, s. The laps have only the limit of the whole mission.
fn limit_s(phase: Phase) -> Option<u64> {
    match phase {
        Phase::EnableHil => Some(30),
        Phase::AwaitSensors
        | Phase::InitialiseSensors
        | Phase::InitialiseEstimator
        | Phase::LoadWaypoints
        | Phase::SwitchNavigation
        | Phase::OrderTakeOff
        | Phase::Engage => Some(15),
        Phase::AwaitEstimator | Phase::Climb => Some(90),
        Phase::Land => Some(600),
        Phase::Watch | Phase::Loiter | Phase::End => None,
    }
}

/// What a phase lacks when its time is over and nobody has refused anything.
fn waiting_for(phase: Phase) -> &'static str {
    match phase {
        Phase::AwaitSensors => "HIL mode is on, but no sensor values come; does the simulator run?",
        Phase::AwaitEstimator => "the Estimator reports no usable state; do GPS and IMU give values?",
        Phase::OrderTakeOff => "the safety pilot does not echo the order; does the simulator run?",
        Phase::Climb => "the aircraft does not rise to the height at which the autopilot is engaged",
        Phase::Engage => "Controller and Servo have not both acknowledged the autopilot",
        Phase::Land => "the aircraft has not come to a standstill on the runway",
        _ => "no acknowledgement came",
    }
}

fn order_name(order: &Order) -> String {
    match order {
        Order::Hil { .. } => "HIL mode".to_owned(),
        Order::Autopilot { .. } => "autopilot".to_owned(),
        Order::Navigation { .. } => "navigation".to_owned(),
        Order::Waypoint(point) => format!("way-point {}", point.index),
        Order::Loop { id, .. } => format!("loop {}", id.name()),
        Order::InitialiseSensors { .. } => "sensor initialisation".to_owned(),
        Order::Estimator(_) => "estimator order".to_owned(),
        Order::Manoeuvre { what, .. } => what.name().to_owned(),
        Order::Fence(_) => "fence".to_owned(),
        Order::Rally(_) => "rally point".to_owned(),
        Order::GoOnWith { index } => format!("way-point {index} next"),
        Order::ReadParameter { .. } | Order::SetParameter(_) => "parameter".to_owned(),
    }
}
