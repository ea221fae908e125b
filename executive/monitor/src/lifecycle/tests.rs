//! Random sequences of events against a small world that carries the commands out: processes that exist, shared memory that is being
//! cleaned up, the machine's refusals. Whatever the sequence, the world's rules hold.

use bateleur_contract::{Clock, StartCondition};
use bateleur_plan::{
    ChangeAction, Closed, ErrorLevel, Exhausted, Levels, PartitionError, PartitionHealth, PartitionState,
    Restart, StartMode,
};
use bateleur_time::partition_control::Readiness;
use proptest::prelude::*;

use super::*;
use crate::health::decision::{Situation, decide};

const MS: u64 = 1_000_000;
/// Events in a sequence; with [`SEQUENCES`] more than 1e5 in a run of each property.
const EVENTS: usize = 1000;
const SEQUENCES: u32 = 250;

/// A process of the world.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Process {
    ready: bool,
    generation: u32,
}

/// What a partition shall come to when nothing else happens to it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Wanted {
    Run,
    Rest(Until),
}

/// Carries commands out, and holds the life cycle to what no world may see.
#[derive(Debug)]
struct World {
    life: Lifecycle,
    now: Instant,
    restart: Restart,
    table: PartitionHealth,
    levels: Levels,
    /// The machine refuses every launch and every takeover.
    refuses: bool,
    active: Option<Process>,
    standby: Option<Process>,
    /// Dead processes that are not cleaned up after, and whether that is under way.
    remains: Option<bool>,
    standby_remains: Option<bool>,
    examining: bool,
    readiness: Readiness,
    wanted: Wanted,
    /// Restarts that the tables decided on since an operator started it, module time.
    restarts: Vec<u64>,
    launched: u32,
    /// The condition that the next launch must have.
    expected: Option<StartCondition>,
}

impl World {
    fn new(restart: Restart, table: PartitionHealth, clock: Clock, standby: Option<Kind>) -> Self {
        let life = Lifecycle::new(restart.clone(), clock, standby);
        let mut world = Self {
            life,
            now: Instant::default(),
            restart,
            table,
            levels: Levels::fill(|_, _| ErrorLevel::Partition),
            refuses: false,
            active: Some(Process { ready: false, generation: 0 }),
            standby: None,
            remains: None,
            standby_remains: None,
            examining: false,
            readiness: Readiness::Absent,
            wanted: Wanted::Run,
            restarts: Vec::new(),
            launched: 1,
            expected: None,
        };
        world.feed(Event::Begin);
        world
    }

    fn feed(&mut self, event: Event) {
        for command in self.life.handle(event, self.now) {
            self.carry_out(command);
        }
    }

    fn carry_out(&mut self, command: Command) {
        match command {
            Command::Launch { generation, condition } => {
                assert_eq!(self.active, None, "a second process is started");
                assert_eq!(self.remains, None, "a successor is started before the clean-up");
                assert!(!self.examining, "a successor is started into channels that are being examined");
                assert_eq!(generation, self.life.generation() + 1);
                if let Some(expected) = self.expected {
                    assert_eq!(condition, expected, "why it is started");
                }
                if self.refuses {
                    self.feed(Event::NotLaunched);
                    return self.decided(self.life.decide_relaunch(self.now.module_ns), false, Cause::Health);
                }
                self.expected = None;
                self.launched += 1;
                self.active = Some(Process { ready: false, generation });
                self.feed(Event::Launched);
            }
            Command::TakeOver { .. } => self.take_over(),
            Command::BeginSpare { condition } => self.begin_spare(condition),
            Command::LaunchStandby { generation } => {
                assert_eq!((self.standby, self.standby_remains), (None, None), "a standby is active twice");
                if self.refuses {
                    return self.feed(Event::Standby(StandbyEvent::NotLaunched));
                }
                self.standby = Some(Process { ready: false, generation });
                self.feed(Event::Standby(StandbyEvent::Launched));
            }
            Command::EndProcess => {
                assert!(self.active.take().is_some(), "there is no process to end");
                assert_eq!(self.remains.replace(false), None, "the dead one before is not cleaned up after");
                self.readiness = Readiness::Absent;
            }
            Command::EndStandby => {
                assert!(self.standby.take().is_some(), "there is no standby to end");
                assert_eq!(self.standby_remains.replace(false), None);
            }
            Command::EndRemains => self.readiness = Readiness::Absent,
            Command::CleanUp(PairMember::Active) => self.remains = self.remains.map(|_| true),
            Command::CleanUp(PairMember::Standby) => {
                self.standby_remains = self.standby_remains.map(|_| true);
            }
            Command::AwaitCleanUp(member) => self.clean_up(member, false),
            Command::Examine => self.examining = true,
            Command::ForgetExamination => self.examining = false,
            Command::Windows(readiness) => self.readiness = readiness,
            Command::Admit { held } => {
                assert!(
                    self.active.is_some_and(|process| process.ready),
                    "one that is not ready has windows"
                );
                self.readiness = if held { Readiness::Held } else { Readiness::Ready };
            }
            Command::Hold => self.readiness = Readiness::Held,
            Command::Release => self.readiness = Readiness::Ready,
            Command::NotBefore(_)
            | Command::AdmitStandby
            | Command::EndStandbyRemains
            | Command::CloseFault
            | Command::AskToStop => {}
        }
    }

    fn take_over(&mut self) {
        assert_eq!(self.active, None, "two processes have the windows");
        assert!(!self.life.has_spare(), "a spare that has not begun has windows");
        let standby = self.standby.filter(|process| process.ready && !self.refuses);
        let Some(process) = standby else { return self.feed(Event::NotTakenOver) };
        assert_eq!(process.generation, self.life.generation() + 1);
        self.expected = None;
        self.active = self.standby.take();
        assert_eq!(self.standby_remains.take(), None);
        self.standby_remains = self.remains.take();
        self.readiness = if self.life.is_held() { Readiness::Held } else { Readiness::Ready };
        self.feed(Event::TookOver);
    }

    fn begin_spare(&mut self, condition: StartCondition) {
        assert!(self.life.has_spare(), "a standby is started twice");
        assert_eq!(self.active, None, "a second process is started");
        assert!(!self.examining, "a spare begins in channels that are being examined");
        let Phase::Beginning(buried) = self.life.phase() else { panic!("{:?}", self.life.phase()) };
        assert_eq!(self.remains.is_none(), buried);
        assert!(buried || self.life.clock == Clock::Wall, "peers notice at no instant of module time");
        if let Some(expected) = self.expected {
            assert_eq!(condition, expected, "why it begins");
        }
        let spare = self.standby.filter(|process| process.ready && !self.refuses);
        let Some(spare) = spare else { return self.feed(Event::NotBegun) };
        assert_eq!(spare.generation, self.life.generation() + 1);
        self.expected = None;
        self.launched += 1;
        self.active = self.standby.take().map(|process| Process { ready: false, ..process });
        assert_eq!(self.standby_remains.take(), None);
        self.standby_remains = self.remains.take();
        self.readiness = Readiness::Absent;
        self.feed(Event::Begun);
    }

    /// The channel cleaner ends.
    fn clean_up(&mut self, member: PairMember, damaged: bool) {
        let (remains, event) = match member {
            PairMember::Active => (&mut self.remains, Event::CleanedUp { damaged }),
            PairMember::Standby => (&mut self.standby_remains, Event::Standby(StandbyEvent::CleanedUp)),
        };
        if remains.take_if(|under_way| *under_way).is_some() {
            self.feed(event);
        }
    }

    /// What the health tables decide about `error`, in other words than the code under test.
    fn fails(&mut self, error: PartitionError) {
        let overdue = error == PartitionError::StartupTimeout && self.active.is_some();
        let alive = self.active.is_some() && !overdue;
        self.feed(if overdue { Event::Overdue } else { Event::Look });
        let within = |at: &&u64| self.now.module_ns - **at < self.restart.within_ns;
        let recent = self.restarts.iter().filter(within).count() as u32;
        assert_eq!(self.life.recent_restarts(self.now.module_ns), recent, "the budget is not kept");
        let state = self.life.state(false);
        let situation = Situation { state, alive, handler: false, recent };
        self.decided(
            decide(error, &self.levels, &self.table, &self.restart, &situation),
            alive,
            Cause::Health,
        );
    }

    fn decided(&mut self, decision: Decision, survives: bool, cause: Cause) {
        match decision {
            Decision::Restart { warm } => {
                let within = |at: &&u64| self.now.module_ns - **at < self.restart.within_ns;
                let recent = self.restarts.iter().filter(within).count() as u32;
                if cause != Cause::Partition {
                    assert!(recent < self.restart.budget, "restarted beyond its budget");
                    self.restarts.push(self.now.module_ns);
                }
                self.wanted = Wanted::Run;
                self.expected = Some(match (warm, cause) {
                    (true, Cause::Health) => StartCondition::HmPartitionWarmRestart,
                    (false, Cause::Health) => StartCondition::HmPartitionColdRestart,
                    (true, _) => StartCondition::PartitionWarmRestart,
                    (false, _) => StartCondition::PartitionRestart,
                });
            }
            Decision::Idle | Decision::Stop => self.wanted = Wanted::Rest(Until::Started),
            _ if !survives => self.wanted = Wanted::Rest(Until::Started),
            _ => {}
        }
        self.feed(Event::Decided { decision, survives, cause });
    }

    fn dies(&mut self, error: PartitionError) {
        if self.active.take().is_none() {
            return;
        }
        assert_eq!(self.remains.replace(false), None);
        let was_starting = self.life.phase() == Phase::Starting;
        self.feed(Event::Died);
        assert_eq!(self.life.phase(), Phase::Dead);
        self.fails(if was_starting { PartitionError::StartupTimeout } else { error });
        assert_ne!(self.life.phase(), Phase::Dead, "nothing follows its death");
    }

    fn order(&mut self, event: Event) {
        match event {
            Event::Stop if self.life.can_stop() => {
                self.wanted = Wanted::Rest(Until::Started);
            }
            Event::Start if self.life.can_start() => {
                self.restarts.clear();
                self.wanted = Wanted::Run;
                self.expected = Some(StartCondition::PartitionRestart);
            }
            Event::Schedule(action) if self.life.can_change(action) => {
                let condition = match action {
                    ChangeAction::WarmRestart => StartCondition::HmPartitionWarmRestart,
                    _ => StartCondition::HmPartitionColdRestart,
                };
                self.expected = (action != ChangeAction::Idle).then_some(condition);
                self.wanted = match action {
                    ChangeAction::Idle => Wanted::Rest(Until::Change),
                    _ => Wanted::Run,
                };
            }
            Event::ChannelsRenewed => {
                let before = self.life.phase();
                self.feed(event);
                let rests = |phase| matches!(phase, Phase::Resting(_) | Phase::CleaningUp(Next::Rest(_)));
                if rests(before) && !rests(self.life.phase()) {
                    self.wanted = Wanted::Run; // the next launch is as the failed one was to be
                }
                return;
            }
            _ => {}
        }
        self.feed(event);
    }

    /// One of the partition's channels is made anew.
    fn renew_channels(&mut self) {
        let had_process = self.active.is_some();
        self.feed(Event::Detach);
        assert_eq!((self.active, self.standby), (None, None), "somebody maps the old channel");
        if had_process {
            self.expected = Some(match self.restart.start {
                StartMode::Warm => StartCondition::HmPartitionWarmRestart,
                StartMode::Cold => StartCondition::HmPartitionColdRestart,
            });
            self.feed(Event::Reattach);
        } else {
            self.order(Event::ChannelsRenewed);
        }
    }

    fn happen(&mut self, what: u16) {
        let errors = PartitionError::ALL;
        let error = errors[usize::from(what >> 8) % errors.len()];
        let flag = what & 0x8000 != 0;
        self.now.module_ns += u64::from(what >> 8) * MS;
        self.now.real_ns += u64::from(what >> 8) * MS;
        match what & 0x1f {
            0 | 1 => self.dies(error),
            2 if self.active.is_some() => self.fails(error),
            3 => self.order(Event::Stop),
            4 | 5 => self.order(Event::Start),
            6 => self.order(Event::Freeze),
            7 => self.order(Event::Thaw),
            8 => self
                .order(Event::Schedule(ChangeAction::ALL[usize::from(what >> 8) % ChangeAction::ALL.len()])),
            9 => self.renew_channels(),
            10 => self.refuses = flag,
            11 if self.active.is_some_and(|process| process.ready) => {
                let cause = if what & 0x1000 == 0 { Cause::Handler } else { Cause::Partition };
                let decision = match cause {
                    Cause::Partition => Decision::Restart { warm: flag },
                    _ => decide_restart(&self.restart, flag, self.life.recent_restarts(self.now.module_ns)),
                };
                self.active = None;
                self.remains = Some(false);
                self.feed(Event::Died);
                self.decided(decision, false, cause);
            }
            12 if self.standby.take().is_some() => {
                self.standby_remains = Some(false);
                self.feed(Event::Standby(StandbyEvent::Died));
            }
            13 if self.standby.is_some_and(|process| !process.ready) => {
                self.feed(Event::Standby(StandbyEvent::Overdue));
            }
            14 => self.clean_up(PairMember::Active, flag),
            15 => self.clean_up(PairMember::Standby, false),
            what => self.go_on(what),
        }
    }

    /// What happens by itself, sooner or later.
    fn go_on(&mut self, what: u16) {
        match what {
            16..=18 if self.active.is_some_and(|process| !process.ready) => {
                self.active = self.active.map(|process| Process { ready: true, ..process });
                self.feed(Event::Ready);
            }
            19..=20 if self.standby.is_some_and(|process| !process.ready) => {
                self.standby = self.standby.map(|process| Process { ready: true, ..process });
                self.feed(Event::Standby(StandbyEvent::Ready));
            }
            21..=23 => self.clean_up(PairMember::Active, false),
            24 => self.clean_up(PairMember::Standby, false),
            25 | 26 if std::mem::take(&mut self.examining) => self.feed(Event::Examined),
            27 | 28 if self.active.is_some_and(|process| process.ready) => self.feed(Event::WindowUsed),
            _ => self.feed(Event::Look),
        }
    }

    /// What holds between any two events.
    fn check(&self) {
        let phase = self.life.phase();
        assert_eq!(self.life.has_process(), self.active.is_some(), "{phase:?}");
        match phase {
            Phase::Starting | Phase::Running => assert_eq!(self.remains, None, "{phase:?}"),
            Phase::CleaningUp(_) => assert_eq!(self.remains, Some(true), "nobody cleans up: {phase:?}"),
            Phase::Examining => assert!(self.examining, "nobody examines"),
            Phase::Retrying(_) | Phase::Resting(_) => {}
            Phase::Dead | Phase::TakingOver | Phase::Beginning(_) | Phase::Launching | Phase::Ending(_) => {
                panic!("{phase:?} between two events");
            }
        }
        let ready = self.active.is_some_and(|process| process.ready);
        let windows = matches!(self.readiness, Readiness::Ready | Readiness::Held);
        assert_eq!(windows, ready, "{:?} with {:?}", self.readiness, self.active);
        if ready {
            assert_eq!(self.life.is_held(), self.readiness == Readiness::Held);
            assert_eq!(self.active.map(|process| process.generation), Some(self.life.generation()));
        }
        match self.life.standby() {
            Some(StandbyState::Starting | StandbyState::Ready) => assert!(self.standby.is_some()),
            Some(StandbyState::CleaningUp) => {
                assert_eq!((self.standby, self.standby_remains), (None, Some(true)), "nobody cleans up");
            }
            Some(StandbyState::Absent) | None => {
                assert_eq!((self.standby, self.standby_remains), (None, None))
            }
            Some(StandbyState::Launching) => panic!("a standby is launched and nobody says whether"),
        }
    }

    /// Nothing else happens to it: whatever was decided comes true.
    fn settle(&mut self) {
        self.refuses = false;
        for step in 0..400_u16 {
            self.now.module_ns += 50 * MS;
            self.now.real_ns += 50 * MS;
            self.go_on(16 + step % 16);
            self.check();
        }
        match self.wanted {
            Wanted::Run => assert_eq!(self.life.phase(), Phase::Running, "it is lost"),
            Wanted::Rest(until) => {
                assert_eq!(self.life.phase(), Phase::Resting(until), "nobody wanted it to run")
            }
        }
    }
}

fn any_restart() -> impl Strategy<Value = Restart> {
    (0_u32..4, 1_u64..20_000, any::<bool>(), any::<bool>()).prop_map(|(budget, within_ms, warm, idle)| {
        Restart {
            start: if warm { StartMode::Warm } else { StartMode::Cold },
            budget,
            within_ns: within_ms * MS,
            then: if idle { Exhausted::Idle } else { Exhausted::Stop },
            startup_ns: 20 * MS,
        }
    })
}

fn any_table() -> impl Strategy<Value = PartitionHealth> {
    prop::collection::vec(0..bateleur_plan::PartitionAction::ALL.len(), PartitionError::ALL.len()).prop_map(
        |actions| {
            PartitionHealth::fill(|error| {
                let place = PartitionError::ALL.iter().position(|known| *known == error).unwrap();
                bateleur_plan::PartitionAction::ALL[actions[place]]
            })
        },
    )
}

fn any_world() -> impl Strategy<Value = World> {
    (any_restart(), any_table(), any::<bool>(), 0..3).prop_map(|(restart, table, wall, standby)| {
        let standby = [None, Some(Kind::Hot), Some(Kind::Spare)][standby as usize];
        World::new(restart, table, if wall { Clock::Wall } else { Clock::Virtual }, standby)
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: SEQUENCES, failure_persistence: None, ..ProptestConfig::default() })]

    /// Nobody is lost, nobody is started twice, every death is followed by what the tables say, budgets are kept, and no standby is
    /// active twice: the world's own assertions.
    #[test]
    fn random_events_lead_to_what_was_decided_last(
        mut world in any_world(),
        events in prop::collection::vec(any::<u16>(), EVENTS),
    ) {
        for what in events {
            world.happen(what);
            world.check();
        }
        world.settle();
    }

    #[test]
    fn orderly_end_after_random_events_ends_every_process_and_starts_none(
        mut world in any_world(),
        events in prop::collection::vec(any::<u16>(), EVENTS / 2),
        after in prop::collection::vec(any::<u16>(), EVENTS / 2),
        itself in any::<bool>(),
    ) {
        events.iter().for_each(|what| world.happen(*what));
        let launched = world.launched;
        world.feed(Event::End);
        assert_eq!(world.standby, None);
        if itself && world.active.take().is_some() {
            world.feed(Event::Died);
        }
        world.feed(Event::EndNow);
        for what in after {
            world.feed(match what & 7 {
                0 => Event::Start,
                1 => Event::CleanedUp { damaged: false },
                2 => Event::Examined,
                3 => Event::Schedule(ChangeAction::ColdRestart),
                4 => Event::ChannelsRenewed,
                5 => Event::Decided { decision: Decision::Restart { warm: true }, survives: false, cause: Cause::Health },
                _ => Event::Look,
            });
        }
        assert_eq!((world.active, world.standby, world.launched), (None, None, launched));
    }

    /// The driver makes no such mistakes; if it did, no second process would come of it.
    #[test]
    fn events_that_do_not_fit_launch_nothing(
        events in prop::collection::vec(any::<u8>(), EVENTS),
        spare in any::<bool>(),
    ) {
        let kind = if spare { Kind::Spare } else { Kind::Hot };
        let mut life = Lifecycle::new(restart(3), Clock::Wall, Some(kind));
        for what in events {
            let misfit = match what & 15 {
                0 => Event::Launched,
                1 => Event::NotLaunched,
                2 => Event::TookOver,
                3 => Event::NotTakenOver,
                4 => Event::Examined,
                5 => Event::CleanedUp { damaged: what & 16 != 0 },
                6 => Event::Reattach,
                7 => Event::Begun,
                9 => Event::NotBegun,
                _ => Event::Standby(StandbyEvent::Ready),
            };
            prop_assert_eq!(life.handle(misfit, Instant::default()), []);
            prop_assert_eq!(life.phase(), Phase::Starting);
        }
    }
}

fn restart(budget: u32) -> Restart {
    Restart {
        start: StartMode::Warm,
        budget,
        within_ns: 10_000 * MS,
        then: Exhausted::Idle,
        startup_ns: 20 * MS,
    }
}

fn at(module_ms: u64) -> Instant {
    Instant { module_ns: module_ms * MS, real_ns: module_ms * MS }
}

const WARM: Event =
    Event::Decided { decision: Decision::Restart { warm: true }, survives: false, cause: Cause::Health };

/// Runs since 1 ms.
fn running(clock: Clock, standby: Option<Kind>) -> Lifecycle {
    let mut life = Lifecycle::new(restart(3), clock, standby);
    assert_eq!(life.handle(Event::Ready, at(1)), [Command::Admit { held: false }]);
    life
}

#[test]
fn death_is_followed_by_clean_up_and_launch() {
    let mut life = running(Clock::Wall, None);
    assert_eq!(life.handle(Event::Died, at(2)), [Command::EndRemains]);
    assert_eq!(
        life.handle(WARM, at(2)),
        [Command::Windows(Readiness::Absent), Command::CleanUp(PairMember::Active)]
    );
    assert_eq!(
        life.handle(Event::CleanedUp { damaged: false }, at(3)),
        [Command::Launch { generation: 1, condition: StartCondition::HmPartitionWarmRestart }]
    );
}

#[test]
fn machine_that_can_not_start_a_process_is_asked_again_later_each_time() {
    let mut life = Lifecycle::new(restart(9), Clock::Wall, None);
    let _ = life.handle(Event::Died, at(0));
    let _ = life.handle(WARM, at(0));
    let mut now = at(0);
    let mut waits = Vec::new();
    let mut commands = life.handle(Event::CleanedUp { damaged: true }, now);
    assert_eq!(commands, [Command::Examine], "it failed before it was ready");
    commands = life.handle(Event::Examined, now);
    while let [Command::Launch { condition, .. }] = commands[..] {
        assert_eq!(condition, StartCondition::HmPartitionWarmRestart, "nothing of it has run");
        assert_eq!(life.handle(Event::NotLaunched, now), []);
        let Phase::Retrying(at_ns) = life.phase() else { panic!("{:?}", life.phase()) };
        waits.push((at_ns - now.real_ns) / MS);
        let decision = life.decide_relaunch(now.module_ns);
        let _ = life.handle(Event::Decided { decision, survives: false, cause: Cause::Health }, now);
        assert_eq!(life.handle(Event::Look, Instant { real_ns: at_ns - 1, ..now }), []);
        now.real_ns = at_ns;
        commands = life.handle(Event::Look, now);
    }
    assert_eq!(
        waits,
        [100, 200, 400, 800, 1600, 3200, 3200, 3200, 3200],
        "of which the last uses up the budget"
    );
    assert_eq!(life.phase(), Phase::Resting(Until::Started));
}

#[test]
fn restart_for_a_channel_uses_up_no_budget_and_gives_none_back() {
    let mut life = running(Clock::Wall, None);
    let back = [Event::CleanedUp { damaged: false }, Event::Launched, Event::Ready];
    for round in 0..20 {
        let died = if round < 3 { &[Event::Died, WARM][..] } else { &[] };
        for events in [&[Event::Detach, Event::Reattach], died] {
            events.iter().chain(&back).for_each(|event| drop(life.handle(*event, at(round))));
        }
    }
    assert_eq!((life.phase(), life.recent_restarts(20 * MS)), (Phase::Running, 3));
}

#[test]
fn standby_of_the_virtual_clock_is_not_called_before_its_start_is_over() {
    let mut life = running(Clock::Virtual, Some(Kind::Hot));
    let _ = life.handle(Event::WindowUsed, at(5));
    assert_eq!(life.handle(Event::Look, at(5)), [Command::LaunchStandby { generation: 1 }]);
    let _ = life.handle(Event::Standby(StandbyEvent::Launched), at(5));
    let _ = life.handle(Event::Standby(StandbyEvent::Ready), at(5));
    assert!(!life.can_take_over(24 * MS) && life.can_take_over(25 * MS));
}

/// Runs, with a spare that waits.
fn with_spare(clock: Clock) -> Lifecycle {
    let mut life = running(clock, Some(Kind::Spare));
    assert_eq!(life.handle(Event::Begin, at(1)), [Command::LaunchStandby { generation: 1 }]);
    let _ = life.handle(Event::Standby(StandbyEvent::Launched), at(1));
    assert_eq!(life.handle(Event::Standby(StandbyEvent::Ready), at(1)), [Command::AdmitStandby]);
    life
}

const BEGIN: Command = Command::BeginSpare { condition: StartCondition::HmPartitionWarmRestart };

#[test]
fn spare_begins_at_once_while_the_dead_one_is_cleaned_up_after_in_its_place() {
    let mut life = with_spare(Clock::Wall);
    assert_eq!(life.handle(Event::Died, at(2)), [Command::EndRemains]);
    assert_eq!(life.handle(WARM, at(2)), [BEGIN]);
    assert_eq!(life.handle(Event::Begun, at(2)), [Command::CleanUp(PairMember::Standby)]);
    assert_eq!((life.phase(), life.generation()), (Phase::Starting, 1));
    assert_eq!(life.handle(Event::Ready, at(3)), [Command::Admit { held: false }]);
    let _ = life.handle(Event::Standby(StandbyEvent::CleanedUp), at(4));
    let _ = life.handle(Event::WindowUsed, at(5));
    assert_eq!(
        life.handle(Event::Look, at(5)),
        [Command::LaunchStandby { generation: 2 }],
        "and is followed"
    );
}

#[test]
fn spare_of_the_virtual_clock_begins_in_the_place_of_a_launch() {
    let mut life = with_spare(Clock::Virtual);
    let _ = life.handle(Event::Died, at(2));
    let plain = [
        Command::Windows(Readiness::Absent),
        Command::NotBefore(22 * MS),
        Command::CleanUp(PairMember::Active),
    ];
    assert_eq!(life.handle(WARM, at(2)), plain, "as without one");
    assert_eq!(life.handle(Event::CleanedUp { damaged: false }, at(2)), [BEGIN]);
    assert_eq!(life.handle(Event::Begun, at(2)), []);
    assert_eq!((life.phase(), life.generation()), (Phase::Starting, 1));
}

#[test]
fn partition_whose_spare_does_not_begin_is_started_anew() {
    let mut life = with_spare(Clock::Wall);
    let _ = life.handle(Event::Died, at(2));
    let _ = life.handle(WARM, at(2));
    let anew = [
        Command::EndStandby,
        Command::CleanUp(PairMember::Standby),
        Command::Windows(Readiness::Absent),
        Command::CleanUp(PairMember::Active),
    ];
    assert_eq!(life.handle(Event::NotBegun, at(2)), anew);
    assert_eq!(
        life.handle(Event::CleanedUp { damaged: false }, at(3)),
        [Command::Launch { generation: 1, condition: StartCondition::HmPartitionWarmRestart }]
    );
}

#[test]
fn spare_that_dies_in_its_start_is_followed_by_an_examination_and_a_process_of_its_own() {
    let mut life = with_spare(Clock::Wall);
    for event in [Event::Died, WARM, Event::Begun, Event::Died] {
        let _ = life.handle(event, at(2));
    }
    assert_eq!(
        life.handle(WARM, at(3)),
        [Command::Windows(Readiness::Absent), Command::CleanUp(PairMember::Active)]
    );
    assert_eq!(life.handle(Event::CleanedUp { damaged: false }, at(4)), [Command::Examine]);
    assert_eq!(
        life.handle(Event::Examined, at(5)),
        [Command::Launch { generation: 2, condition: StartCondition::HmPartitionWarmRestart }]
    );
}

#[test]
fn process_that_hangs_in_its_start_is_in_the_state_start_and_is_ended() {
    let mut life = Lifecycle::new(restart(3), Clock::Wall, None);
    let _ = life.handle(Event::Overdue, at(9));
    assert_eq!((life.state(false), life.has_process()), (PartitionState::Start, true));
    let idle = Event::Decided { decision: Decision::Idle, survives: false, cause: Cause::Health };
    assert_eq!(
        life.handle(idle, at(9)),
        [
            Command::EndProcess,
            Command::CloseFault,
            Command::Windows(Readiness::Stopped),
            Command::CleanUp(PairMember::Active)
        ]
    );
}
