//! What to do about an error: a pure function of the tables and of what happened before.

use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;

use bateleur_contract::ReportKind;
use bateleur_contract::{ErrorCode, exit};

use bateleur_plan::{
    ErrorLevel, Exhausted, Levels, ModuleAction, ModuleError, ModuleHealth, PartitionAction, PartitionError,
    PartitionHealth, PartitionState, Reset, Restart, StartMode, leaves_the_process,
};

/// What a partition was at when its error occurred.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Situation {
    /// Its state.
    pub state: PartitionState,
    /// Its process still runs.
    pub alive: bool,
    /// It has an error handler.
    pub handler: bool,
    /// Restarts within the budget's time.
    pub recent: u32,
}

/// What is done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Decision {
    /// Level of a process: the partition's own error handler is told.
    Handler,
    /// Level of the module: the module's table is asked.
    Module,
    /// Log it and go on.
    Ignore,
    /// The partition keeps its windows and does nothing in them.
    Idle,
    /// Start it again; warm: with its retained memory.
    Restart {
        /// Retained memory is kept.
        warm: bool,
    },
    /// End the partition and tell the module.
    Stop,
}

impl Decision {
    /// The word that stands in logs.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Handler => "error_handler",
            Self::Module => "module",
            Self::Ignore => "ignore",
            Self::Idle => "idle",
            Self::Restart { warm: true } => "warm_restart",
            Self::Restart { warm: false } => "cold_restart",
            Self::Stop => "stop",
        }
    }
}

impl Situation {
    /// Whether the partition's own handler can be told of `error`: where there is none, or it can not run, or the error is
    /// its own, the partition's table answers.
    fn has_handler_for(&self, error: PartitionError) -> bool {
        self.handler && self.alive && self.state == PartitionState::Normal && leaves_the_process(error)
    }
}

/// Decides about `error`.
#[must_use]
pub fn decide(
    error: PartitionError,
    levels: &Levels,
    table: &PartitionHealth,
    restart: &Restart,
    situation: &Situation,
) -> Decision {
    match levels.level(error, situation.state) {
        ErrorLevel::Module => return Decision::Module,
        ErrorLevel::Process if situation.has_handler_for(error) => return Decision::Handler,
        ErrorLevel::Process | ErrorLevel::Partition => {}
    }
    match table.action(error) {
        // A process that is gone can not be ignored: without a restart its windows are idle.
        PartitionAction::Ignore if !situation.alive => Decision::Idle,
        PartitionAction::Ignore => Decision::Ignore,
        PartitionAction::Idle => Decision::Idle,
        PartitionAction::Stop => Decision::Stop,
        // What keeps a partition from starting may be what it finds of its predecessor.
        PartitionAction::WarmRestart => {
            decide_restart(restart, situation.state != PartitionState::Start, situation.recent)
        }
        PartitionAction::ColdRestart => decide_restart(restart, false, situation.recent),
    }
}

/// Decides about a restart, also one that the partition itself asks for: as warm as it can be, within its budget.
#[must_use]
pub fn decide_restart(restart: &Restart, warm: bool, recent: u32) -> Decision {
    match restart.then {
        _ if recent < restart.budget => Decision::Restart { warm: warm && restart.start == StartMode::Warm },
        Exhausted::Idle => Decision::Idle,
        Exhausted::Stop => Decision::Stop,
    }
}

/// What is done about an error of the module. `can_go_on`: it can do its work in spite of it. `recent`: resets within the
/// budget's time.
#[must_use]
pub fn decide_module(
    error: ModuleError,
    table: &ModuleHealth,
    reset: &Reset,
    can_go_on: bool,
    recent: u32,
) -> ModuleAction {
    match table.action(error) {
        // What does not run can not go on.
        ModuleAction::Ignore if !can_go_on => ModuleAction::Shutdown,
        ModuleAction::Reset if recent >= reset.budget => ModuleAction::Shutdown,
        action => action,
    }
}

/// What a report says is wrong; `None`: nothing, it is a message.
#[must_use]
pub fn reported_error(kind: ReportKind) -> Option<PartitionError> {
    Some(match kind {
        ReportKind::Message => return None,
        // Of a partition that has no replicas: see `take_verdict`.
        ReportKind::FirstOutvoted | ReportKind::SecondOutvoted | ReportKind::ThirdOutvoted => {
            PartitionError::ApplicationError
        }
        ReportKind::ApplicationError => PartitionError::ApplicationError,
        ReportKind::PortError => PartitionError::PortError,
        ReportKind::DeadlineMissed => PartitionError::DeadlineMissed,
        ReportKind::NumericError => PartitionError::NumericError,
        ReportKind::IllegalRequest => PartitionError::IllegalRequest,
        ReportKind::StackOverflow => PartitionError::StackOverflow,
        ReportKind::MemoryViolation => PartitionError::MemoryViolation,
        ReportKind::HardwareFault => PartitionError::HardwareFault,
    })
}

/// The error that the end of a process means, and its description. `None` if it ended as it was asked to. `words`: the last
/// line that it wrote, by which ends of one kind are told apart.
#[must_use]
pub fn error_of(status: ExitStatus, words: Option<&str>) -> Option<(PartitionError, String)> {
    let Some(signal) = status.signal() else { return error_of_code(status.code().unwrap_or(-1), words) };
    let (error, name) = match signal {
        SIGSEGV => (PartitionError::MemoryViolation, "SIGSEGV"),
        SIGBUS => (PartitionError::MemoryViolation, "SIGBUS"),
        SIGFPE => (PartitionError::NumericError, "SIGFPE"),
        SIGILL => (PartitionError::IllegalRequest, "SIGILL"),
        SIGSYS => (PartitionError::IllegalRequest, "SIGSYS"),
        SIGABRT => return Some(error_of_abort(words)),
        SIGKILL => (PartitionError::Killed, "SIGKILL"),
        _ => return Some((PartitionError::Killed, format!("ended by signal {signal}"))),
    };
    Some((error, format!("ended by {name}")))
}

const SIGILL: i32 = 4;
const SIGABRT: i32 = 6;
const SIGBUS: i32 = 7;
const SIGFPE: i32 = 8;
const SIGKILL: i32 = 9;
const SIGSEGV: i32 = 11;
const SIGSYS: i32 = 31;
/// What a Rust program that panicked ends with.
const PANICKED: i32 = 101;

fn error_of_code(code: i32, words: Option<&str>) -> Option<(PartitionError, String)> {
    let text = match code {
        exit::STOPPED => return None,
        exit::ABORTED => return Some(error_of_abort(words)),
        exit::HARDWARE_FAULT => {
            let text = "the machine reported damaged memory (SIGBUS)";
            return Some((PartitionError::HardwareFault, text.into()));
        }
        exit::STACK_OVERFLOW => {
            return Some((PartitionError::StackOverflow, "used more stack than it has".into()));
        }
        exit::START_REFUSED => "refused to start".into(),
        exit::NO_CONTRACT => "was built for another contract".into(),
        PANICKED if words.is_some_and(is_arithmetic) => {
            return Some((PartitionError::NumericError, "panicked".into()));
        }
        PANICKED => "panicked".into(),
        code => format!("ended by itself with code {code}"),
    };
    Some((PartitionError::Exit, text))
}

/// Rust's own words for what a processor would trap, or should have.
fn is_arithmetic(words: &str) -> bool {
    words.starts_with("attempt to ")
        && ["overflow", "by zero", "divisor of zero"].iter().any(|end| words.contains(end))
}

/// How the C library begins what it says of memory that it found damaged, before it aborts.
const DAMAGED: [&str; 10] = [
    "free(): ",
    "malloc(): ",
    "realloc(): ",
    "malloc_consolidate(): ",
    "munmap_chunk(): ",
    "double free or corruption",
    "corrupted ",
    "*** stack smashing detected ***",
    "*** buffer overflow detected ***",
    "Fatal glibc error: malloc",
];

/// What an abort means, by the words that the runtime of Rust or the C library ends with.
fn error_of_abort(words: Option<&str>) -> (PartitionError, String) {
    let words = words.unwrap_or_default();
    if DAMAGED.iter().any(|damaged| words.starts_with(damaged)) {
        return (PartitionError::MemoryViolation, "aborted".into());
    }
    let error = if words.starts_with("memory allocation of ") {
        PartitionError::MemoryLimit
    } else if words.contains("stack overflow") || words.contains("overflowed its stack") {
        PartitionError::StackOverflow
    } else {
        PartitionError::Exit
    };
    (error, "aborted".into())
}

/// What a partition's handler is told that an error is; `None` if it is told of no such error.
#[must_use]
pub fn handler_code(error: PartitionError) -> Option<ErrorCode> {
    match error {
        PartitionError::DeadlineMissed => Some(ErrorCode::DeadlineMissed),
        PartitionError::ApplicationError => Some(ErrorCode::ApplicationError),
        PartitionError::PortError => Some(ErrorCode::PortError),
        PartitionError::WindowOverrun => Some(ErrorCode::WindowOverrun),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::plan_of;
    use bateleur_plan::Closed;

    const PARTITION: &str = "[partition.a]\nprogram = \"a\"\nmodule = \"m\"\nmemory = \"1MiB\"\n\
         [schedule.s]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\ninitial = true\n\
         [[schedule.s.window]]\npartition = \"a\"\noffset = \"0ms\"\nduration = \"2ms\"\n";

    fn partition(keys: &str) -> bateleur_plan::Partition {
        let text = format!(
            "[module.m]\ncores = [0]\n[partition.a]\nprogram = \"a\"\nmodule = \"m\"\nmemory = \"1MiB\"\n{keys}\n\
             [schedule.s]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\ninitial = true\n\
             [[schedule.s.window]]\npartition = \"a\"\noffset = \"0ms\"\nduration = \"2ms\"\n"
        );
        plan_of(&text).partitions[0].clone()
    }

    fn decided(keys: &str, error: PartitionError, alive: bool, recent: u32) -> Decision {
        let partition = partition(keys);
        let levels = plan_of(&format!("[module.m]\ncores = [0]\n{PARTITION}")).health.levels;
        let situation = Situation { state: PartitionState::Normal, alive, handler: false, recent };
        decide(error, &levels, &partition.health, &partition.restart, &situation)
    }

    /// What the manual says, in other words than the code.
    fn expected(
        error: PartitionError,
        level: ErrorLevel,
        action: PartitionAction,
        starts_warm: bool,
        situation: &Situation,
    ) -> Decision {
        let own = [
            PartitionError::ApplicationError,
            PartitionError::PortError,
            PartitionError::DeadlineMissed,
            PartitionError::WindowOverrun,
        ];
        let normal = situation.state == PartitionState::Normal;
        if level == ErrorLevel::Module {
            return Decision::Module;
        }
        if level == ErrorLevel::Process
            && normal
            && situation.alive
            && situation.handler
            && own.contains(&error)
        {
            return Decision::Handler;
        }
        let budget_left = situation.recent < 2;
        match action {
            PartitionAction::Ignore if situation.alive => Decision::Ignore,
            PartitionAction::Ignore | PartitionAction::Idle => Decision::Idle,
            PartitionAction::Stop => Decision::Stop,
            _ if !budget_left => Decision::Stop,
            PartitionAction::WarmRestart => {
                Decision::Restart { warm: starts_warm && situation.state != PartitionState::Start }
            }
            PartitionAction::ColdRestart => Decision::Restart { warm: false },
        }
    }

    #[test]
    fn every_error_in_every_state_has_the_decision_of_its_level_and_table() {
        let mut cases = 0;
        for (error, action) in pairs(PartitionError::ALL, PartitionAction::ALL) {
            for start in StartMode::ALL {
                let keys = format!(
                    "retained = \"4KiB\"\nhealth = {{ {error} = \"{action}\" }}\n\
                     restart = {{ start = \"{start}\", budget = 2, within = \"9s\", then = \"stop\" }}"
                );
                let partition = partition(&keys);
                for (level, state) in pairs(ErrorLevel::ALL, PartitionState::ALL) {
                    let levels = Levels::fill(|_, _| level);
                    for (alive, handler) in pairs(&[true, false], &[true, false]) {
                        for recent in 0..4 {
                            let situation = Situation { state, alive, handler, recent };
                            let found =
                                decide(error, &levels, &partition.health, &partition.restart, &situation);
                            let warm = *start == StartMode::Warm;
                            let wanted = expected(error, level, action, warm, &situation);
                            assert_eq!(found, wanted, "{error} -> {action} at {level}, {situation:?}");
                            cases += 1;
                        }
                    }
                }
            }
        }
        assert_eq!(cases, PartitionError::ALL.len() * 5 * 2 * 3 * 3 * 4 * 4);
    }

    fn pairs<A: Copy, B: Copy>(left: &[A], right: &[B]) -> Vec<(A, B)> {
        left.iter().flat_map(|one| right.iter().map(|other| (*one, *other))).collect()
    }

    #[test]
    fn what_a_process_survives_is_its_handlers_by_default_and_all_else_its_tables() {
        let levels = plan_of(&format!("[module.m]\ncores = [0]\n{PARTITION}")).health.levels;
        for (error, state) in pairs(PartitionError::ALL, PartitionState::ALL) {
            let own = state == PartitionState::Normal && leaves_the_process(error);
            let wanted = if own { ErrorLevel::Process } else { ErrorLevel::Partition };
            assert_eq!(levels.level(error, state), wanted, "{error} in {state}");
        }
    }

    #[test]
    fn levels_are_those_of_the_file_for_the_state_or_for_the_error() {
        let text = "[health.level]\nkilled = \"module\"\nport_error = { normal = \"module\" }\n\
                    application_error = \"process\"\n[partition.b]\nprogram = \"b\"\nmodule = \"m\"\n\
                    memory = \"1MiB\"\nerror_handler = true\n\
                    [schedule.t]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\n\
                    [[schedule.t.window]]\npartition = \"b\"\noffset = \"3ms\"\nduration = \"2ms\"\n";
        let levels = plan_of(&format!("[module.m]\ncores = [0]\n{PARTITION}{text}")).health.levels;
        let of = |error, state| levels.level(error, state);
        for state in PartitionState::ALL {
            assert_eq!(of(PartitionError::Killed, *state), ErrorLevel::Module);
        }
        assert_eq!(of(PartitionError::PortError, PartitionState::Normal), ErrorLevel::Module);
        assert_eq!(of(PartitionError::PortError, PartitionState::Handler), ErrorLevel::Partition);
        assert_eq!(of(PartitionError::ApplicationError, PartitionState::Normal), ErrorLevel::Process);
        assert_eq!(of(PartitionError::ApplicationError, PartitionState::Handler), ErrorLevel::Partition);
    }

    #[test]
    fn a_killed_partition_comes_back_cold_or_warm_as_its_line_says() {
        let warm = "retained = \"4KiB\"\nrestart = { start = \"warm\" }";
        assert_eq!(decided("", PartitionError::Killed, false, 0), Decision::Restart { warm: false });
        assert_eq!(decided(warm, PartitionError::Killed, false, 0), Decision::Restart { warm: true });
    }

    #[test]
    fn one_that_fails_before_it_is_ready_is_never_started_warm_again_whatever_its_table_says() {
        let keys = "retained = \"4KiB\"\nrestart = { start = \"warm\" }\n\
                    health = { startup_timeout = \"warm_restart\", application_error = \"warm_restart\" }";
        let partition = partition(keys);
        let levels = plan_of(&format!("[module.m]\ncores = [0]\n{PARTITION}")).health.levels;
        let decided = |error, state| {
            let situation = Situation { state, alive: false, handler: false, recent: 0 };
            decide(error, &levels, &partition.health, &partition.restart, &situation)
        };
        let cold = Decision::Restart { warm: false };
        assert_eq!(decided(PartitionError::StartupTimeout, PartitionState::Start), cold);
        assert_eq!(decided(PartitionError::ApplicationError, PartitionState::Start), cold);
        let warm = Decision::Restart { warm: true };
        assert_eq!(decided(PartitionError::ApplicationError, PartitionState::Normal), warm);
    }

    #[test]
    fn a_restart_beyond_the_budget_ends_as_the_plan_says() {
        let idle = "restart = { budget = 2, within = \"10s\", then = \"idle\" }";
        let stop = "restart = { budget = 2, within = \"10s\", then = \"stop\" }";
        assert_eq!(
            decided(idle, PartitionError::MemoryViolation, false, 1),
            Decision::Restart { warm: false }
        );
        assert_eq!(decided(idle, PartitionError::MemoryViolation, false, 2), Decision::Idle);
        assert_eq!(decided(stop, PartitionError::MemoryViolation, false, 2), Decision::Stop);
    }

    #[test]
    fn a_death_can_not_be_ignored() {
        let ignore = "health = { killed = \"ignore\" }";
        assert_eq!(decided(ignore, PartitionError::Killed, false, 0), Decision::Idle);
        assert_eq!(decided("", PartitionError::WindowOverrun, true, 0), Decision::Ignore);
    }

    #[test]
    fn every_error_of_a_module_has_the_action_of_its_table_unless_that_can_not_be() {
        for error in ModuleError::ALL {
            for action in ModuleAction::ALL {
                let text = format!(
                    "[module.m]\ncores = [0]\n[health]\nreset = {{ budget = 2 }}\n[health.module]\n{error} = \"{action}\"\n"
                );
                let health = plan_of(&(text + PARTITION)).health;
                for can_go_on in [true, false] {
                    for recent in 0..4 {
                        let decided = decide_module(*error, &health.module, &health.reset, can_go_on, recent);
                        let case = format!("{error} -> {action}, can_go_on {can_go_on}, {recent} resets");
                        match decided {
                            ModuleAction::Ignore => assert!(can_go_on && *action == decided, "{case}"),
                            ModuleAction::Reset => assert!(recent < 2 && *action == decided, "{case}"),
                            ModuleAction::Shutdown => assert!(
                                *action == decided
                                    || (*action == ModuleAction::Ignore && !can_go_on)
                                    || (*action == ModuleAction::Reset && recent >= 2),
                                "{case}"
                            ),
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn signals_and_exit_codes_are_named_after_what_went_wrong() {
        let of = |raw| error_of(ExitStatus::from_raw(raw), None);
        assert_eq!(of(SIGSEGV).unwrap().0, PartitionError::MemoryViolation);
        assert_eq!(of(SIGFPE).unwrap().0, PartitionError::NumericError);
        assert_eq!(of(SIGKILL).unwrap(), (PartitionError::Killed, "ended by SIGKILL".into()));
        assert_eq!(of(PANICKED << 8).unwrap(), (PartitionError::Exit, "panicked".into()));
        assert_eq!(of(0), None);
    }

    #[test]
    fn ends_of_one_kind_are_told_apart_by_the_last_words() {
        let of = |code: i32, words| error_of(ExitStatus::from_raw(code << 8), Some(words)).unwrap().0;
        let aborted = |words| of(exit::ABORTED, words);
        assert_eq!(aborted("memory allocation of 99 bytes failed"), PartitionError::MemoryLimit);
        assert_eq!(aborted("fatal runtime error: stack overflow, aborting"), PartitionError::StackOverflow);
        assert_eq!(aborted("thread caused non-unwinding panic. aborting."), PartitionError::Exit);
        for damaged in
            ["free(): double free detected in tcache 2", "*** stack smashing detected ***: terminated"]
        {
            assert_eq!(aborted(damaged), PartitionError::MemoryViolation, "{damaged}");
        }
        assert_eq!(of(PANICKED, "attempt to divide by zero"), PartitionError::NumericError);
        assert_eq!(of(PANICKED, "attempt to add with overflow"), PartitionError::NumericError);
        assert_eq!(of(PANICKED, "called `Option::unwrap()` on a `None` value"), PartitionError::Exit);
        assert_eq!(of(exit::HARDWARE_FAULT, ""), PartitionError::HardwareFault);
        assert_eq!(of(exit::STACK_OVERFLOW, ""), PartitionError::StackOverflow);
        let by_signal = error_of(ExitStatus::from_raw(SIGABRT), Some("memory allocation of 8 bytes failed"));
        assert_eq!(by_signal.unwrap().0, PartitionError::MemoryLimit);
    }
}
