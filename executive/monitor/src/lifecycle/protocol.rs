//! The words of the life cycle: what can happen to a partition, and what its driver can be told to do.

use bateleur_contract::{Clock, StartCondition};
use bateleur_plan::ChangeAction;
use bateleur_time::partition_control::Readiness;

use crate::health::decision::Decision;

/// When an event happened.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Instant {
    /// Module time, ns.
    pub module_ns: u64,
    /// CLOCK_MONOTONIC, ns.
    pub real_ns: u64,
}

/// Who wanted what was decided.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// The health tables.
    Health,
    /// The partition's error handler, as its answer to an error: the budget counts the restart.
    Handler,
    /// The partition, by SET_PARTITION_MODE, which is no answer to an error: the budget does not count it.
    Partition,
}

/// Which of a partition's two processes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PairMember {
    /// The one that has the windows.
    Active,
    /// The one that stands by, or what is left of the one that it followed.
    Standby,
}

/// What happened to a partition.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// Its process has initialised.
    Ready,
    /// Its process was not ready in time; [`Event::Decided`] follows.
    Overdue,
    /// Its process has ended by itself; [`Event::Decided`] follows.
    Died,
    /// The health tables, or its own error handler, say what is done.
    Decided {
        /// What is done.
        decision: Decision,
        /// Its process can go on, where the decision leaves it alone.
        survives: bool,
        /// Who wanted it.
        cause: Cause,
    },
    /// Its process had a window.
    WindowUsed,
    /// Nothing is left of its dead process in shared memory. `damaged`: but for channels that could not be cleared.
    CleanedUp {
        /// Some could not be cleared.
        damaged: bool,
    },
    /// Its channels were examined, and are sound or new.
    Examined,
    /// The answer to [`Command::Launch`].
    Launched,
    /// The answer to [`Command::Launch`]; [`Event::Decided`] follows.
    NotLaunched,
    /// The answer to [`Command::TakeOver`].
    TookOver,
    /// The answer to [`Command::TakeOver`].
    NotTakenOver,
    /// The answer to [`Command::BeginSpare`].
    Begun,
    /// The answer to [`Command::BeginSpare`].
    NotBegun,
    /// A little time has passed.
    Look,
    /// An operator ends it.
    Stop,
    /// An operator starts it.
    Start,
    /// An operator holds it.
    Freeze,
    /// An operator lets it go on.
    Thaw,
    /// A change of schedule has an action for it.
    Schedule(ChangeAction),
    /// One of its channels is made anew: nobody may be attached to it meanwhile. [`Event::Reattach`] follows where it had a process.
    Detach,
    /// Its channels are there again.
    Reattach,
    /// A channel of a partition that could not start is new.
    ChannelsRenewed,
    /// Its first process has been launched, and now its standby may be.
    Begin,
    /// The module ends: it is asked to end.
    End,
    /// The module ends, and has waited long enough.
    EndNow,
    /// Something about its standby.
    Standby(StandbyEvent),
}

/// What happened to the process that stands by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StandbyEvent {
    /// The answer to [`Command::LaunchStandby`].
    Launched,
    /// The answer to [`Command::LaunchStandby`].
    NotLaunched,
    /// It has initialised.
    Ready,
    /// It was not ready in time.
    Overdue,
    /// It has ended.
    Died,
    /// Nothing is left in shared memory of the one that was there.
    CleanedUp,
}

/// What the driver has to do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// Bind the process to its cores and let it have windows; if `held`, hold it instead.
    Admit {
        /// An operator holds the partition.
        held: bool,
    },
    /// End the process, and whatever it has started, and reap it. Its windows pass from before its end on.
    EndProcess,
    /// End whatever the dead process has started. Its windows pass.
    EndRemains,
    /// Say what becomes of its windows.
    Windows(Readiness),
    /// On the virtual clock, let windows pass that start before this instant of module time, ns.
    NotBefore(u64),
    /// Remove what the dead process left in shared memory, and report [`Event::CleanedUp`] or [`StandbyEvent::CleanedUp`].
    CleanUp(PairMember),
    /// On the virtual clock, wait for that: it happens at this instant of module time.
    AwaitCleanUp(PairMember),
    /// Start a process and report whether that was possible.
    Launch {
        /// Which incarnation it is.
        generation: u32,
        /// Why it is started.
        condition: StartCondition,
    },
    /// Examine its channels, and report [`Event::Examined`].
    Examine,
    /// Its channels need not be examined any more.
    ForgetExamination,
    /// Have the standby take the dead one's place, with retained memory or without, and report whether it did.
    TakeOver {
        /// With retained memory.
        warm: bool,
    },
    /// Put the spare in the place of the one before and let it begin, and report whether it does.
    BeginSpare {
        /// Why it begins.
        condition: StartCondition,
    },
    /// Start a process that stands by and report whether that was possible.
    LaunchStandby {
        /// Which incarnation it will be.
        generation: u32,
    },
    /// The standby sleeps until it is called.
    AdmitStandby,
    /// End the process that stands by and reap it.
    EndStandby,
    /// End whatever the dead standby has started.
    EndStandbyRemains,
    /// No successor follows the last fault: its record is complete.
    CloseFault,
    /// Hold the process: nothing of it runs, and its windows pass.
    Hold,
    /// Let it go on.
    Release,
    /// Ask the process to end by itself.
    AskToStop,
}

/// Has what `member` left removed; on the virtual clock at this instant of module time.
pub(super) fn clean_up(member: PairMember, clock: Clock, commands: &mut Vec<Command>) {
    commands.push(Command::CleanUp(member));
    if clock == Clock::Virtual {
        commands.push(Command::AwaitCleanUp(member));
    }
}
