//! Rules about health tables: that what they ask for makes sense.

use super::Context;
use crate::catalogue;
use crate::closed::{
    Closed, ErrorLevel, ModuleAction, ModuleError, PartitionAction, PartitionError, PartitionState, StartMode,
};
use crate::findings::{Finding, Span};
use crate::model::{PartitionId, leaves_the_process};
use crate::raw::{Answer, RawHealth, RawLevel, RawPartition};
use crate::reader::{At, Bytes, Nanoseconds, Word};
use crate::units::ShowTime;
use bateleur_plan::words::listed;

pub(super) fn check(cx: &Context<'_>) {
    let health = &cx.file.health;
    ignored(cx, &health.partition);
    incomplete(cx, "partition", health.partition_span.as_ref(), &health.partition);
    incomplete(cx, "module", health.module_span.as_ref(), &health.module);
    overrun(cx);
    if let Some(windows) = &health.silence_windows {
        cx.at_in_range("silence_windows", windows, 1, u32::MAX);
    }
    not_zero(cx, "late_after", &health.late_after);
    not_zero(cx, "within", &health.reset_within);
    reset_budget(cx, health);
    log_size(cx);
    health.levels.iter().for_each(|level| level_of(cx, level));
    for (id, partition) in cx.partitions() {
        ignored(cx, &partition.health);
        warm(cx, partition);
        warm_answers(cx, partition);
        budget(cx, id, partition);
        standby(cx, id, partition);
        deadline(cx, id, partition);
        handler(cx, partition);
        unused_answers(cx, &partition.health);
    }
    unused_answers(cx, &health.partition);
}

fn level_of(cx: &Context<'_>, said: &RawLevel) {
    let error = said.error;
    match said.level.value {
        ErrorLevel::Process => {
            let state = said.state.filter(|state| *state != PartitionState::Normal);
            if !leaves_the_process(error) || state.is_some() {
                let message = match state {
                    Some(state) if leaves_the_process(error) => {
                        format!(
                            "`{error}` can not be dealt with by the partition's process in the state `{state}`"
                        )
                    }
                    _ => format!("after `{error}` there is no process that could deal with it"),
                };
                let mend = "choose `partition` or `module`";
                return cx.note(&catalogue::ILLEGAL_LEVEL, &said.level.span, message, mend);
            }
            let has_handler = |partition: &RawPartition| partition.error_handler.or(false) != Some(false);
            if !cx.file.partitions.iter().any(has_handler) {
                let message = format!("`{error}` is left to error handlers, but no partition has one");
                let mend =
                    "add `error_handler = true` to a partition whose program has one, or choose `partition`";
                cx.note(&catalogue::PROCESS_WITHOUT_HANDLER, &said.level.span, message, mend);
            }
        }
        ErrorLevel::Partition => {}
        ErrorLevel::Module => {
            let table = &cx.file.health.module;
            let said_action = table.iter().find(|answer| answer.error == ModuleError::PartitionError);
            let what = match cx.plan.health.module.action(ModuleError::PartitionError) {
                ModuleAction::Ignore => return,
                ModuleAction::Reset => "resets",
                ModuleAction::Shutdown => "shuts down",
            };
            let message = format!("`{error}` of any partition {what} the module");
            let mend = "nothing, if that is meant; else choose `partition`";
            let finding = Finding::new(&catalogue::MODULE_FOR_PARTITION, &said.level.span, message, mend);
            cx.add(match said_action {
                Some(answer) => finding.also(&answer.action.span, "what is done at this level"),
                None => finding,
            });
        }
    }
}

fn handler(cx: &Context<'_>, partition: &RawPartition) {
    let Some(said) = partition.error_handler.said().filter(|said| said.value) else { return };
    let own = |error: &&PartitionError| {
        leaves_the_process(**error)
            && cx.plan.health.levels.level(**error, PartitionState::Normal) == ErrorLevel::Process
    };
    if !PartitionError::ALL.iter().any(|error| own(&error)) {
        let message = format!("no error is left to the error handler of `{}`", partition.name.value);
        let mend = "leave an error at the level `process` in `[health.level]`, or take the key out";
        cx.note(&catalogue::HANDLER_UNUSED, &said.span, message, mend);
    }
}

/// Whether an error never reaches a partition's table.
fn is_dealt_with_by_module(cx: &Context<'_>, error: PartitionError) -> bool {
    PartitionState::ALL.iter().all(|state| cx.plan.health.levels.level(error, *state) == ErrorLevel::Module)
}

/// Answers for errors that never reach a partition's table.
fn unused_answers(cx: &Context<'_>, table: &[Answer<PartitionError, PartitionAction>]) {
    for answer in table {
        if !is_dealt_with_by_module(cx, answer.error) {
            continue;
        }
        let message = format!("`{}` is dealt with by the module, whatever is said here", answer.error);
        let mend = "take this line out, or `[health.level]`'s";
        let finding = Finding::new(&catalogue::ANSWER_UNUSED, &answer.action.span, message, mend);
        let raised = cx.file.health.levels.iter().find(|said| said.error == answer.error);
        cx.add(match raised {
            Some(said) => finding.also(&said.level.span, "raised to the module here"),
            None => finding,
        });
    }
}

fn not_zero(cx: &Context<'_>, what: &str, time: &Option<At<Nanoseconds>>) {
    if let Some(time) = time.as_ref().filter(|time| time.value.0 == 0) {
        let mend = "write a time above zero, or leave the key out for its default";
        cx.note(&catalogue::ZERO_TIME, &time.span, format!("`{what}` is zero"), mend);
    }
}

fn reset_budget(cx: &Context<'_>, health: &RawHealth) {
    let Some(budget) = health.reset_budget.as_ref().filter(|budget| budget.value == 0) else { return };
    let Some(answer) = health.module.iter().find(|answer| answer.action.value == ModuleAction::Reset) else {
        return;
    };
    let message = format!("`{}` resets the module, but its budget is zero", answer.error);
    let mend = "allow some resets, or choose `shutdown`";
    let finding = Finding::new(&catalogue::RESTART_WITHOUT_BUDGET, &budget.span, message, mend);
    cx.add(finding.also(&answer.action.span, "it is asked for here"));
}

/// Bytes of a persistent log: from a few records to what is read in one piece.
const LOG_SIZES: std::ops::RangeInclusive<u64> = (4 << 10)..=(64 << 20);

fn log_size(cx: &Context<'_>) {
    let Some(size) = &cx.file.health.log_size else { return };
    if !LOG_SIZES.contains(&size.value.0) {
        let message = format!("the health log has a `size` of {} bytes", size.value.0);
        let mend = "write a size from 4KiB (15 records) to 64MiB (262143 records)";
        cx.note(&catalogue::OUT_OF_RANGE, &size.span, message, mend);
    }
}

/// More names of errors than this nobody reads in a sentence.
const MOST_LISTED: usize = 5;

/// Notes the errors that a table leaves to the defaults.
fn incomplete<E: Closed + PartialEq, A>(
    cx: &Context<'_>,
    level: &str,
    span: Option<&Span>,
    table: &[Answer<E, A>],
) {
    let Some(span) = span else { return };
    let named = |error: &&E| table.iter().any(|answer| answer.error == **error);
    // Of a module without voters it never happens.
    let has_voters = cx.file.partitions.iter().any(|partition| !partition.voted.is_empty());
    let occurs = |error: &&E| has_voters || error.name() != PartitionError::Outvoted.name();
    let missing = E::ALL.iter().filter(occurs).filter(|error| !named(error));
    let missing: Vec<&str> = missing.map(|error| error.name()).collect();
    if !missing.is_empty() {
        let (some, more) = missing.split_at(missing.len().min(MOST_LISTED));
        let some = listed(some.iter().copied());
        let more = if more.is_empty() { String::new() } else { format!(" and {} more", more.len()) };
        let message = format!("`[health.{level}]` says nothing about {some}{more}");
        let mend = "name them too; until then the defaults hold";
        cx.note(&catalogue::INCOMPLETE_TABLE, span, message, mend);
    }
}

/// A file that decides about errors decides about overruns.
fn overrun(cx: &Context<'_>) {
    let Some(span) = &cx.file.health.partition_span else { return };
    let decides = |table: &[Answer<PartitionError, PartitionAction>]| {
        table.iter().any(|answer| answer.error == PartitionError::WindowOverrun)
    };
    let each_decides = cx.file.partitions.iter().all(|partition| decides(&partition.health));
    if is_dealt_with_by_module(cx, PartitionError::WindowOverrun) {
        return;
    }
    if !decides(&cx.file.health.partition) && !each_decides {
        let mend = "add `window_overrun = \"ignore\"` if counting it is enough, or a restart";
        cx.note(&catalogue::OVERRUN_NOT_MAPPED, span, "nothing says what becomes of an overrun", mend);
    }
}

fn ignored(cx: &Context<'_>, table: &[Answer<PartitionError, PartitionAction>]) {
    for answer in table {
        let grave = matches!(
            answer.error,
            PartitionError::MemoryViolation | PartitionError::StackOverflow | PartitionError::HardwareFault
        );
        if grave && answer.action.value == PartitionAction::Ignore {
            let message = format!("`{}` is ignored", answer.error);
            let mend = "restart the partition, or stop it";
            cx.note(&catalogue::FAULT_IGNORED, &answer.action.span, message, mend);
        }
    }
}

fn warm(cx: &Context<'_>, partition: &RawPartition) {
    let Some(start) = partition.restart.start.said().filter(|start| start.value.0 == StartMode::Warm) else {
        return;
    };
    if partition.retained.or(Bytes(0)) == Some(Bytes(0)) {
        let message = format!("partition `{}` starts warm and retains nothing", partition.name.value);
        let mend = "add `retained = \"16KiB\"`, or let it start cold";
        cx.note(&catalogue::WARM_WITHOUT_RETAINED, &start.span, message, mend);
    }
}

fn warm_answers(cx: &Context<'_>, partition: &RawPartition) {
    let start = &partition.restart.start;
    if start.or(Word(StartMode::Cold)).map(|word| word.0) != Some(StartMode::Cold) {
        return;
    }
    for answer in partition.health.iter().filter(|answer| answer.action.value == PartitionAction::WarmRestart)
    {
        let name = &partition.name.value;
        let message = format!("`{}` restarts `{name}` warm, but it starts cold", answer.error);
        let mend = "say `cold_restart`, or `start = \"warm\"` in `restart`";
        let finding = Finding::new(&catalogue::WARM_WHERE_COLD, &answer.action.span, message, mend);
        cx.add(match start.said() {
            Some(said) => finding.also(&said.span, "it starts cold"),
            None => finding,
        });
    }
}

fn deadline(cx: &Context<'_>, id: PartitionId, partition: &RawPartition) {
    let Some(deadline) = partition.deadline.said() else { return };
    let name = &partition.name.value;
    let windows = cx.schedules().flat_map(|pair| cx.windows_of(pair, id));
    let durations = windows.filter_map(|window| window.duration.said());
    let Some(longest) = durations.max_by_key(|duration| duration.value.0) else { return };
    if deadline.value.0 > longest.value.0 {
        let (late, length) = (ShowTime(deadline.value.0), ShowTime(longest.value.0));
        let message = format!(
            "the deadline of `{name}` is {late} after a window's start, but none is longer than {length}"
        );
        let mend = "shorten the deadline, or lengthen the window";
        let finding = Finding::new(&catalogue::DEADLINE_TOO_LONG, &deadline.span, message, mend);
        cx.add(finding.also(&longest.span, "its longest window"));
    }
}

fn budget(cx: &Context<'_>, id: PartitionId, partition: &RawPartition) {
    let Some(budget) = partition.restart.budget.said().filter(|budget| budget.value == 0) else { return };
    let Some(error) = answered_by_restart(cx, id) else { return };
    let message = format!("`{error}` restarts `{}`, but its budget is zero", partition.name.value);
    let mend = "allow some restarts, or choose `idle` or `stop` for its errors";
    cx.note(&catalogue::RESTART_WITHOUT_BUDGET, &budget.span, message, mend);
}

fn standby(cx: &Context<'_>, id: PartitionId, partition: &RawPartition) {
    let Some(standby) = partition.standby.said() else { return };
    // A handler of its own may decide for a restart, whatever the tables say.
    let decides_itself = partition.error_handler.or(false) != Some(false);
    if !decides_itself && answered_by_restart(cx, id).is_none() {
        let message = format!("`{}` has a standby, and none of its errors restarts it", partition.name.value);
        let mend = "answer an error by a restart, such as `killed = \"cold_restart\"`, or remove `standby`";
        cx.note(&catalogue::STANDBY_WITHOUT_RESTART, &standby.span, message, mend);
    }
}

/// An error after which a partition is started again, if there is one.
fn answered_by_restart(cx: &Context<'_>, partition: PartitionId) -> Option<PartitionError> {
    let restarts = |error: &PartitionError| {
        let action = cx.plan[partition].health.action(*error);
        matches!(action, PartitionAction::WarmRestart | PartitionAction::ColdRestart)
    };
    let is_replica = cx.plan.voter_of(partition).is_some();
    let occurs = |error: &PartitionError| *error != PartitionError::Outvoted || is_replica;
    PartitionError::ALL.iter().copied().filter(occurs).find(restarts)
}
