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
}

macro_rules! rules {
    ($($rule:ident: $severity:ident $id:literal $reason:literal)+) => {
        $(pub(in crate::plan) const $rule: Rule =
            Rule { id: $id, severity: Severity::$severity, reason: $reason };)+

        /// Every rule, by subject.
        pub const RULES: &[Rule] = &[$($rule,)+];
    };
}

rules! {
    SYNTAX: Error "S01-syntax"
        "A file that is not TOML says nothing at all."
    UNKNOWN_KEY: Error "S02-unknown-key"
        "A mistyped key would be a setting that silently has no effect."
    WRONG_TYPE: Error "S03-wrong-type"
        "A value of another type was meant to say something else."
    MISSING_KEY: Error "S04-missing-key"
        "Without it there is no sensible default to fall back on."
    BAD_DURATION: Error "S05-bad-duration"
        "A time without a unit, or with a wrong one, is off by a factor of a thousand."
    BAD_SIZE: Error "S06-bad-size"
        "A size without a unit, or with a wrong one, is off by a factor of a thousand."
    OUT_OF_RANGE: Error "S07-out-of-range"
        "The executive or the kernel could not do it."
    UNKNOWN_WORD: Error "S08-unknown-word"
        "Only the members of a closed set have a meaning."

    BAD_NAME: Error "N01-bad-name"
        "Names become file, cgroup and service names and must fit an APEX name."
    DUPLICATE_NAME: Error "N02-duplicate-name"
        "Two things of one name cannot be told apart, in no spelling of it."
    UNKNOWN_PARTITION: Error "N03-unknown-partition"
        "What belongs to nobody cannot be run or connected."
    UNKNOWN_PORT: Error "N04-unknown-port"
        "A channel or chain needs ports at its ends."
    UNKNOWN_MESSAGE: Error "N05-unknown-message"
        "The size of a port's memory follows from its message type."
    UNKNOWN_MODULE: Error "N06-unknown-module"
        "A partition without a computer never runs."
    UNKNOWN_SCHEDULE: Error "N07-unknown-schedule"
        "A permission for a schedule that does not exist permits nothing."

    NO_CORE: Error "M01-no-core"
        "Without a core there is no time to give away."
    CORE_TWICE: Error "M02-core-twice"
        "A core has one dispatcher, and its time is either partitioned or not."
    EMPTY_MODULE: Warning "M03-empty-module"
        "A module without partitions has nothing to run."

    MEMORY_ZERO: Error "R01-memory-zero"
        "A partition without memory dies before its first instruction."
    DEVICE_TWICE: Error "R02-device-twice"
        "The second mention was probably meant to be another device."
    DEVICE_SHARED: Warning "R03-device-shared"
        "Partitions that share a device are not separated in space."
    RETAINED_TOO_LARGE: Error "R04-retained-too-large"
        "Retained memory counts towards the memory of the partition."
    ZERO_TIME: Error "R05-zero-time"
        "A limit of no time is over before anything can happen."

    ZERO_DURATION: Error "T01-zero-duration"
        "A window without length runs nothing."
    ZERO_FRAME: Error "T02-zero-frame"
        "A frame without length never ends, or always."
    WINDOW_OVERLAP: Error "T03-window-overlap"
        "A core runs one partition at a time."
    WINDOW_OUTSIDE_FRAME: Error "T04-window-outside-frame"
        "A window that outlasts its minor frame would run into the next."
    MINOR_OUT_OF_RANGE: Error "T05-minor-out-of-range"
        "The major frame has only so many minor frames."
    MAJOR_NOT_MULTIPLE: Error "T06-major-not-multiple"
        "A minor frame that is cut off breaks the period of every partition."
    CORE_NOT_IN_MODULE: Error "T07-core-not-in-module"
        "The executive switches only the cores that the module gives it."
    TWO_CORES_AT_ONCE: Error "T08-two-cores-at-once"
        "A partition has one window loop and cannot be in two windows."
    NEVER_SCHEDULED: Error "T09-never-scheduled"
        "A partition without a window never runs."
    NOT_IN_SCHEDULE: Warning "T10-not-in-schedule"
        "The partition stands still for as long as that schedule runs."
    WINDOW_TOO_SHORT: Warning "T11-window-too-short"
        "A switch takes tens of microseconds and would eat most of the window."
    CORE_TOO_FULL: Warning "T12-core-too-full"
        "Linux by default stops real-time threads that use 95 % of a second, and the executive needs some time itself."
    NO_INITIAL_SCHEDULE: Error "T13-no-initial-schedule"
        "The module must know what to start with."
    TWO_INITIAL_SCHEDULES: Error "T14-two-initial-schedules"
        "The module can start with one schedule only."
    MINOR_TWICE: Error "T15-minor-twice"
        "A window is in a minor frame once or not at all, and in one of them at least."
    TOO_MANY_MINOR_FRAMES: Error "T16-too-many-minor-frames"
        "The timeline of a whole major frame is laid out in locked memory."
    UNEVEN_MINOR: Warning "T17-uneven-minor"
        "A partition that is released at uneven intervals has no period for its laws to rely on."
    MAJOR_FRAMES_DIFFER: Warning "T18-major-frames-differ"
        "A change of schedule takes up to the major frame that is left, so the longest decides how long it takes."
    MINOR_FRAMES_DIFFER: Warning "T19-minor-frames-differ"
        "The period of every partition changes with the schedule, and with it what laws, refresh periods and queues were laid out for."
    CHANGE_ACTION_UNUSED: Warning "T20-change-action-unused"
        "The action is taken at the partition's first window in that schedule, which never comes."
    NEWLY_SCHEDULED_IGNORED: Warning "T21-newly-scheduled-ignored"
        "The partition stood still in another schedule and goes on with what it knew then."
    PERMISSION_UNUSED: Warning "T22-permission-unused"
        "The partition can never ask for another schedule: there is none, or it does not run where it may ask."

    PORT_UNCONNECTED: Warning "P01-port-unconnected"
        "What is written to it is read by nobody, or nothing ever arrives at it."
    REFRESH_MISSING: Error "P02-refresh-missing"
        "Without a refresh period no value can be told from a stale one."
    REFRESH_ZERO: Error "P03-refresh-zero"
        "No value would ever be valid."
    DEPTH_MISSING: Error "P04-depth-missing"
        "The queue is laid out before frame 0 and must have a size."
    DEPTH_ZERO: Error "P05-depth-zero"
        "No message would ever get through."
    MISPLACED_KEY: Error "P06-misplaced-key"
        "A setting that this kind of port does not have would have no effect."
    PAYLOAD_MISSING: Error "P07-payload-missing"
        "The memory of a port is laid out before frame 0 and must have a size."
    PAYLOAD_TWICE: Error "P08-payload-twice"
        "The message type already has a size."
    PAYLOAD_ZERO: Error "P09-payload-zero"
        "A message without a byte carries nothing."
    REFRESH_TOO_SHORT: Warning "P10-refresh-too-short"
        "The value is stale for a while in every frame, though nothing failed."

    SOURCE_DIRECTION: Error "C01-source-direction"
        "A channel starts at a port that its partition writes."
    DESTINATION_DIRECTION: Error "C02-destination-direction"
        "A channel ends at ports that their partitions read."
    KIND_MIXED: Error "C03-kind-mixed"
        "The latest value and every value are two different memories."
    MESSAGE_MISMATCH: Error "C04-message-mismatch"
        "The reader would take the bytes for something else."
    QUEUING_SEVERAL_DESTINATIONS: Error "C05-queuing-several-destinations"
        "One full queue would have to hold up the others."
    DESTINATION_TWICE: Error "C06-destination-twice"
        "A port that is written from two sides has no order and no owner."
    SOURCE_TWICE: Error "C07-source-twice"
        "A port belongs to one channel, which may have several destinations."
    NO_DESTINATION: Error "C08-no-destination"
        "A channel leads somewhere."
    SELF_CHANNEL: Warning "C09-self-channel"
        "A partition can talk to itself without a channel."
    QUEUE_TOO_SHALLOW: Warning "C10-queue-too-shallow"
        "One message in every window of the sender already overflows the queue."
    DESTINATION_TOO_SMALL: Error "C11-destination-too-small"
        "The longest message of the sender does not fit."

    CHAIN_DISCONNECTED: Error "L01-chain-disconnected"
        "No value travels where neither a channel nor a partition leads."
    CHAIN_TOO_SHORT: Error "L02-chain-too-short"
        "A path has two ends."
    CHAIN_ZERO_AGE: Error "L03-chain-zero-age"
        "Every step of a path takes time."

    UNKNOWN_ERROR: Error "H01-unknown-error"
        "An action for an error that never occurs protects from nothing."
    ILLEGAL_ACTION: Error "H02-illegal-action"
        "A partition's error is answered in the partition, a module's in the module."
    WARM_WITHOUT_RETAINED: Warning "H03-warm-without-retained"
        "Without retained memory a warm restart is a cold one under another name."
    FAULT_IGNORED: Warning "H04-fault-ignored"
        "After such an error nothing that the partition holds can be trusted."
    WARM_WHERE_COLD: Warning "H05-warm-where-cold"
        "The partition says that it cannot use what it left behind."
    RESTART_WITHOUT_BUDGET: Warning "H06-restart-without-budget"
        "A restart is asked for and never allowed."
}
