//! Every rule of the checker: its id, how bad it is to break it, and why it exists.

use serde::Serialize;

use super::report::Severity;

/// A rule of the checker.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Rule {
    /// The id that a violation carries.
    pub id: &'static str,
    /// How bad it is to break it.
    pub severity: Severity,
    /// Why it exists, in a sentence.
    pub reason: &'static str,
    /// The name of a file that breaks it, among those of the tests.
    pub example_name: &'static str,
    /// That file's text.
    #[serde(skip)]
    pub example: &'static str,
}

macro_rules! rules {
    ($($rule:ident: $severity:ident $id:literal $file:literal $reason:literal)+) => {
        $(pub(in crate::plan) const $rule: Rule =
            Rule {
                id: $id,
                severity: Severity::$severity,
                reason: $reason,
                example_name: concat!($file, ".toml"),
                example: include_str!(concat!("../../../tests/schedule/", $file, ".toml")),
            };)+

        /// Every rule, by subject.
        pub const RULES: &[Rule] = &[$($rule,)+];
    };
}

rules! {
    SYNTAX: Error "S01-syntax" "file_syntax"
        "A file that is not TOML says nothing at all."
    UNKNOWN_KEY: Error "S02-unknown-key" "file_unknown_table"
        "A mistyped key would be a setting that silently has no effect."
    WRONG_TYPE: Error "S03-wrong-type" "partition_wrong_type"
        "A value of another type was meant to say something else."
    MISSING_KEY: Error "S04-missing-key" "partition_missing_keys"
        "Without it there is no sensible default to fall back on."
    BAD_DURATION: Error "S05-bad-duration" "duration_bad"
        "A time without a unit, or with a wrong one, is off by a factor of a thousand."
    BAD_SIZE: Error "S06-bad-size" "size_bad"
        "A size without a unit, or with a wrong one, is off by a factor of a thousand."
    OUT_OF_RANGE: Error "S07-out-of-range" "queue_too_large"
        "The executive or the kernel could not do it."
    UNKNOWN_WORD: Error "S08-unknown-word" "port_unknown_word"
        "Only the members of a closed set have a meaning."

    BAD_NAME: Error "N01-bad-name" "name_bad"
        "Names become file, cgroup and service names and must fit an APEX name."
    DUPLICATE_NAME: Error "N02-duplicate-name" "name_duplicate_case"
        "Two things of one name cannot be told apart, in no spelling of it."
    UNKNOWN_PARTITION: Error "N03-unknown-partition" "window_unknown_partition"
        "What belongs to nobody cannot be run or connected."
    UNKNOWN_PORT: Error "N04-unknown-port" "channel_unknown_port"
        "A channel or chain needs ports at its ends."
    UNKNOWN_MESSAGE: Error "N05-unknown-message" "port_unknown_message"
        "The size of a port's memory follows from its message type."
    UNKNOWN_MODULE: Error "N06-unknown-module" "partition_unknown_module"
        "A partition without a computer never runs."
    UNKNOWN_SCHEDULE: Error "N07-unknown-schedule" "schedule_permission_unknown"
        "A permission for a schedule that does not exist permits nothing."

    NO_CORE: Error "M01-no-core" "module_without_core"
        "Without a core there is no time to give away."
    CORE_TWICE: Error "M02-core-twice" "module_core_twice"
        "A core has one dispatcher, and its time is either partitioned or not."
    EMPTY_MODULE: Warning "M03-empty-module" "module_empty"
        "A module without partitions has nothing to run."
    UNUSED_CORE: Warning "M04-unused-core" "module_core_unused"
        "A core that is taken from the rest of the machine and given to nobody is lost to both."

    MEMORY_ZERO: Error "R01-memory-zero" "partition_memory_zero"
        "A partition without memory dies before its first instruction."
    DEVICE_TWICE: Error "R02-device-twice" "partition_device_twice"
        "The second mention was probably meant to be another device."
    DEVICE_SHARED: Warning "R03-device-shared" "partition_device_shared"
        "Partitions that share a device are not separated in space."
    RETAINED_TOO_LARGE: Error "R04-retained-too-large" "partition_retained_too_large"
        "Retained memory counts towards the memory of the partition."
    ZERO_TIME: Error "R05-zero-time" "partition_zero_time"
        "A limit of no time is over before anything can happen."
    PROGRAM_MISSING: Warning "R06-program-missing" "partition_program_missing"
        "A partition whose program cannot be started stops the whole module at its start."
    STANDBY_MEMORY: Note "R07-standby-memory" "partition_standby_memory"
        "Each of the two processes has the partition's memory for itself, and the machine has to have it twice."

    ZERO_DURATION: Error "T01-zero-duration" "window_zero_duration"
        "A window without length runs nothing."
    ZERO_FRAME: Error "T02-zero-frame" "frame_zero"
        "A frame without length never ends, or always."
    WINDOW_OVERLAP: Error "T03-window-overlap" "window_overlap"
        "A core runs one partition at a time."
    WINDOW_OUTSIDE_FRAME: Error "T04-window-outside-frame" "window_outside_frame"
        "A window that outlasts its minor frame would run into the next."
    MINOR_OUT_OF_RANGE: Error "T05-minor-out-of-range" "window_minor_out_of_range"
        "The major frame has only so many minor frames."
    MAJOR_NOT_MULTIPLE: Error "T06-major-not-multiple" "frame_not_multiple"
        "A minor frame that is cut off breaks the period of every partition."
    CORE_NOT_IN_MODULE: Error "T07-core-not-in-module" "window_core_not_in_module"
        "The executive switches only the cores that the module gives it."
    TWO_CORES_AT_ONCE: Error "T08-two-cores-at-once" "partition_on_two_cores"
        "A partition has one window loop and cannot be in two windows."
    NEVER_SCHEDULED: Error "T09-never-scheduled" "partition_never_scheduled"
        "A partition without a window never runs."
    NOT_IN_SCHEDULE: Warning "T10-not-in-schedule" "partition_not_in_schedule"
        "The partition stands still for as long as that schedule runs."
    WINDOW_TOO_SHORT: Warning "T11-window-too-short" "window_too_short"
        "A switch takes tens of microseconds and would eat most of the window."
    CORE_TOO_FULL: Warning "T12-core-too-full" "core_too_full"
        "Linux by default stops real-time threads that use 95 % of a second, and the executive needs some time itself."
    NO_INITIAL_SCHEDULE: Error "T13-no-initial-schedule" "schedule_no_initial"
        "The module must know what to start with."
    TWO_INITIAL_SCHEDULES: Error "T14-two-initial-schedules" "schedule_two_initial"
        "The module can start with one schedule only."
    MINOR_TWICE: Error "T15-minor-twice" "window_minor_twice"
        "A window is in a minor frame once or not at all, and in one of them at least."
    TOO_MANY_MINOR_FRAMES: Error "T16-too-many-minor-frames" "frame_too_many_minor"
        "The timeline of a whole major frame is laid out in locked memory."
    UNEVEN_MINOR: Warning "T17-uneven-minor" "window_uneven_minor"
        "A partition that is released at uneven intervals has no period for its laws to rely on."
    MAJOR_FRAMES_DIFFER: Warning "T18-major-frames-differ" "schedule_major_frames_differ"
        "A change of schedule takes up to the major frame that is left, so the longest decides how long it takes."
    MINOR_FRAMES_DIFFER: Warning "T19-minor-frames-differ" "schedule_minor_frames_differ"
        "The period of every partition changes with the schedule, and with it what laws, refresh periods and queues were laid out for."
    CHANGE_ACTION_UNUSED: Warning "T20-change-action-unused" "schedule_change_action_unused"
        "The action is taken at the partition's first window in that schedule, which never comes."
    NEWLY_SCHEDULED_IGNORED: Warning "T21-newly-scheduled-ignored" "schedule_newly_scheduled_ignored"
        "The partition stood still in another schedule and goes on with what it knew then."
    PERMISSION_UNUSED: Warning "T22-permission-unused" "schedule_permission_alone"
        "The partition can never ask for another schedule: there is none, or it does not run where it may ask."

    PORT_UNCONNECTED: Warning "P01-port-unconnected" "port_unconnected"
        "What is written to it is read by nobody, or nothing ever arrives at it."
    REFRESH_MISSING: Error "P02-refresh-missing" "port_refresh_missing"
        "Without a refresh period no value can be told from a stale one."
    REFRESH_ZERO: Error "P03-refresh-zero" "port_refresh_zero"
        "No value would ever be valid."
    DEPTH_MISSING: Error "P04-depth-missing" "port_depth_missing"
        "The queue is laid out before frame 0 and must have a size."
    DEPTH_ZERO: Error "P05-depth-zero" "port_depth_zero"
        "No message would ever get through."
    MISPLACED_KEY: Error "P06-misplaced-key" "port_misplaced_key"
        "A setting that this kind of port does not have would have no effect."
    PAYLOAD_MISSING: Error "P07-payload-missing" "port_payload_missing"
        "The memory of a port is laid out before frame 0 and must have a size."
    PAYLOAD_TWICE: Error "P08-payload-twice" "port_payload_twice"
        "The message type already has a size."
    PAYLOAD_ZERO: Error "P09-payload-zero" "port_payload_zero"
        "A message without a byte carries nothing."
    REFRESH_TOO_SHORT: Warning "P10-refresh-too-short" "port_refresh_too_short"
        "The value is stale for a while in every frame, though nothing failed."

    SOURCE_DIRECTION: Error "C01-source-direction" "channel_source_direction"
        "A channel starts at a port that its partition writes."
    DESTINATION_DIRECTION: Error "C02-destination-direction" "channel_destination_direction"
        "A channel ends at ports that their partitions read."
    KIND_MIXED: Error "C03-kind-mixed" "channel_kind_mixed"
        "The latest value and every value are two different memories."
    MESSAGE_MISMATCH: Error "C04-message-mismatch" "channel_message_mismatch"
        "The reader would take the bytes for something else."
    QUEUING_SEVERAL_DESTINATIONS: Error "C05-queuing-several-destinations" "channel_queuing_several_destinations"
        "One full queue would have to hold up the others."
    DESTINATION_TWICE: Error "C06-destination-twice" "channel_destination_twice"
        "A port that is written from two sides has no order and no owner."
    SOURCE_TWICE: Error "C07-source-twice" "channel_source_twice"
        "A port belongs to one channel, which may have several destinations."
    NO_DESTINATION: Error "C08-no-destination" "channel_no_destination"
        "A channel leads somewhere."
    SELF_CHANNEL: Warning "C09-self-channel" "channel_to_itself"
        "A partition can talk to itself without a channel."
    QUEUE_TOO_SHALLOW: Warning "C10-queue-too-shallow" "channel_queue_too_shallow"
        "One message in every window of the sender already overflows the queue."
    DESTINATION_TOO_SMALL: Error "C11-destination-too-small" "channel_destination_too_small"
        "The longest message of the sender does not fit."
    UNREAD_WRITES: Note "C12-unread-writes" "channel_unread_writes"
        "What is overwritten before anybody looks was computed for nothing, unless that is meant."
    LOOP: Note "C13-loop" "channel_loop"
        "Around a loop, somebody always reads what was written a period before; the laws have to know that."

    CHAIN_DISCONNECTED: Error "L01-chain-disconnected" "chain_disconnected"
        "No value travels where neither a channel nor a partition leads."
    CHAIN_TOO_SHORT: Error "L02-chain-too-short" "chain_too_short"
        "A path has two ends."
    CHAIN_ZERO_AGE: Error "L03-chain-zero-age" "chain_zero_age"
        "Every step of a path takes time."
    CHAIN_TOO_OLD: Error "L04-chain-too-old" "chain_too_old"
        "Laws that act on values older than they were designed for lose the phase that keeps them stable."
    CHAIN_PORT_TWICE: Error "L05-chain-port-twice" "chain_port_twice"
        "A path that comes back to a port has no end from which an age could be counted."
    CHAIN_CROSSES_MODULES: Note "L06-chain-crosses-modules" "chain_crosses_modules"
        "The frames of two computers have no common phase, so the windows alone say nothing about the age."

    UNKNOWN_ERROR: Error "H01-unknown-error" "health_unknown_error"
        "An action for an error that never occurs protects from nothing."
    ILLEGAL_ACTION: Error "H02-illegal-action" "health_illegal_action"
        "A partition's error is answered in the partition, a module's in the module."
    WARM_WITHOUT_RETAINED: Warning "H03-warm-without-retained" "health_warm_without_retained"
        "Without retained memory a warm restart is a cold one under another name."
    FAULT_IGNORED: Warning "H04-fault-ignored" "health_fault_ignored"
        "After such an error nothing that the partition holds can be trusted."
    WARM_WHERE_COLD: Warning "H05-warm-where-cold" "health_warm_where_cold"
        "The partition says that it cannot use what it left behind."
    RESTART_WITHOUT_BUDGET: Warning "H06-restart-without-budget" "health_restart_without_budget"
        "A restart is asked for and never allowed."
    INCOMPLETE_TABLE: Note "H07-incomplete-table" "health_incomplete_table"
        "Whoever reads the table should see what happens, not what would be assumed."
    OVERRUN_NOT_MAPPED: Warning "H08-overrun-not-mapped" "health_overrun_not_mapped"
        "An overrun is the error that a schedule makes by itself: what it means has to be decided, even if it is ignored."
    DEADLINE_TOO_LONG: Error "H09-deadline-too-long" "health_deadline_too_long"
        "A window ends by itself: a deadline after its end could never be the first to be missed."
    STANDBY_WITHOUT_RESTART: Warning "H10-standby-without-restart" "health_standby_without_restart"
        "Only a restart becomes a takeover: the second process waits for what never happens."
    ILLEGAL_LEVEL: Error "H11-illegal-level" "health_illegal_level"
        "An error handler runs in the partition's process: it deals with errors that the process survives, while it takes windows."
    PROCESS_WITHOUT_HANDLER: Error "H12-process-without-handler" "health_process_without_handler"
        "An error that is left to a handler that nobody has is left to nobody."
    HANDLER_UNUSED: Warning "H13-handler-unused" "health_handler_unused"
        "The handler is never called: every error that it could deal with is dealt with at another level."
    ANSWER_UNUSED: Warning "H14-answer-unused" "health_answer_unused"
        "What a partition's table says about an error counts only where the error is dealt with at its level."
    MODULE_FOR_PARTITION: Note "H15-module-for-partition" "health_module_for_partition"
        "Every partition loses what it was at because of an error of one."
}
