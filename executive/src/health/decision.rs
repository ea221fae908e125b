//! What to do about an error: a pure function of the tables and of what happened before.

use std::os::unix::process::ExitStatusExt;
use std::process::ExitStatus;

use bateleur_contract::exit;

use crate::plan::{
    Exhausted, ModuleAction, ModuleError, ModuleHealth, PartitionAction, PartitionError, PartitionHealth,
    Reset, Restart, StartMode,
};

/// What is done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Decision {
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
            Self::Ignore => "ignore",
            Self::Idle => "idle",
            Self::Restart { warm: true } => "warm_restart",
            Self::Restart { warm: false } => "cold_restart",
            Self::Stop => "stop",
        }
    }
}

/// Decides about `error`. `alive`: the partition's process still runs. `recent`: restarts within the budget's time.
#[must_use]
pub fn decide(
    error: PartitionError,
    tables: &PartitionHealth,
    restart: &Restart,
    alive: bool,
    recent: u32,
) -> Decision {
    match tables.action(error) {
        // A process that is gone can not be ignored: without a restart its windows are idle.
        PartitionAction::Ignore if !alive => Decision::Idle,
        PartitionAction::Ignore => Decision::Ignore,
        PartitionAction::Idle => Decision::Idle,
        PartitionAction::Stop => Decision::Stop,
        PartitionAction::WarmRestart | PartitionAction::ColdRestart if recent >= restart.budget => {
            match restart.then {
                Exhausted::Idle => Decision::Idle,
                Exhausted::Stop => Decision::Stop,
            }
        }
        PartitionAction::WarmRestart => Decision::Restart { warm: restart.start == StartMode::Warm },
        PartitionAction::ColdRestart => Decision::Restart { warm: false },
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

/// The error that the end of a process means, and its description. None: it ended as it was asked to. `words`: the last
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

/// What an abort means, by the words that Rust's runtime ends with.
fn error_of_abort(words: Option<&str>) -> (PartitionError, String) {
    let words = words.unwrap_or_default();
    let error = if words.starts_with("memory allocation of ") {
        PartitionError::MemoryLimit
    } else if words.contains("stack overflow") || words.contains("overflowed its stack") {
        PartitionError::StackOverflow
    } else {
        PartitionError::Exit
    };
    (error, "aborted".into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::Closed;
    use crate::test_support::plan_of;

    const PARTITION: &str = "[partition.a]\nprogram = \"a\"\nmodule = \"m\"\nmemory = \"1MiB\"\n\
         [schedule.s]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\ninitial = true\n\
         [[schedule.s.window]]\npartition = \"a\"\noffset = \"0ms\"\nduration = \"2ms\"\n";

    fn partition(keys: &str) -> crate::plan::Partition {
        let text = format!(
            "[module.m]\ncores = [0]\n[partition.a]\nprogram = \"a\"\nmodule = \"m\"\nmemory = \"1MiB\"\n{keys}\n\
             [schedule.s]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\ninitial = true\n\
             [[schedule.s.window]]\npartition = \"a\"\noffset = \"0ms\"\nduration = \"2ms\"\n"
        );
        plan_of(&text).partitions[0].clone()
    }

    fn decided(keys: &str, error: PartitionError, alive: bool, recent: u32) -> Decision {
        let partition = partition(keys);
        decide(error, &partition.health, &partition.restart, alive, recent)
    }

    #[test]
    fn a_killed_partition_comes_back_cold_or_warm_as_its_line_says() {
        let warm = "retained = \"4KiB\"\nrestart = { start = \"warm\" }";
        assert_eq!(decided("", PartitionError::Killed, false, 0), Decision::Restart { warm: false });
        assert_eq!(decided(warm, PartitionError::Killed, false, 0), Decision::Restart { warm: true });
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
    fn every_error_has_a_decision() {
        for error in PartitionError::ALL {
            for alive in [true, false] {
                let _ = decided("", *error, alive, 0);
            }
        }
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
        assert_eq!(of(PANICKED, "attempt to divide by zero"), PartitionError::NumericError);
        assert_eq!(of(PANICKED, "attempt to add with overflow"), PartitionError::NumericError);
        assert_eq!(of(PANICKED, "called `Option::unwrap()` on a `None` value"), PartitionError::Exit);
        assert_eq!(of(exit::HARDWARE_FAULT, ""), PartitionError::HardwareFault);
        assert_eq!(of(exit::STACK_OVERFLOW, ""), PartitionError::StackOverflow);
        let by_signal = error_of(ExitStatus::from_raw(SIGABRT), Some("memory allocation of 8 bytes failed"));
        assert_eq!(by_signal.unwrap().0, PartitionError::MemoryLimit);
    }
}
