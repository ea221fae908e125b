//! What happens in a script.

use bateleur_processes::standard::*;
use bateleur_processes::{Dispatch, Partition, Progress, ReturnCode, Runner};
use rand::{Rng, RngExt};

use crate::ms;
use crate::plan::Plan;

/// Processes and mutexes by their place, spans in ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Call {
    Mode(OperatingMode),
    SetPriority(usize, i32),
    SuspendSelf(SystemTime),
    Suspend(usize),
    Resume(usize),
    StopSelf,
    Stop(usize),
    DelayedStart(usize, SystemTime),
    Lock,
    Unlock,
    TimedWait(SystemTime),
    PeriodicWait,
    Replenish(SystemTime),
    Send(u8, SystemTime),
    Receive(SystemTime),
    Display(u8),
    Read(SystemTime),
    Clear,
    WaitSemaphore(SystemTime),
    Signal,
    SetEvent,
    ResetEvent,
    WaitEvent(SystemTime),
    Acquire(usize, SystemTime),
    Release(usize),
    Reset(usize, usize),
    ResetLock(usize),
    GetError,
    EnableHandler,
    Raise,
    Fault(ErrorCode),
}

impl Call {
    /// It comes from outside, also when nobody runs.
    pub(crate) fn is_fault(self) -> bool {
        matches!(self, Self::Fault(_))
    }
}

/// What a call gave: a number that means something to it, or that its caller waits.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) enum Given {
    Number(i64),
    Bytes(Vec<u8>),
    Waits,
}

pub(crate) type Answer = Result<Given, ReturnCode>;

/// The draws that a call is made from.
pub(crate) const DRAWS: u32 = 114;

pub(crate) const NOTHING: Answer = Ok(Given::Number(0));

pub(crate) fn random_call(random: &mut impl Rng, plan: &Plan, partition: &Partition) -> Call {
    let mode = partition.get_partition_status().operating_mode;
    let process = random.random_range(0..plan.processes.len());
    let mutex = random.random_range(0..plan.mutexes.len());
    let byte = random.random_range(1..200);
    let time_out = [0, INFINITE_TIME_VALUE, -2, ms(3), ms(7), ms(12)][random.random_range(0..6)];
    if mode != OperatingMode::Normal && random.random_range(0..4) == 0 {
        return Call::Mode(OperatingMode::Normal);
    }
    // Otherwise few scripts would leave the error handler.
    let handler = matches!(partition.dispatch(), Dispatch::Run { who: Runner::Handler, .. });
    let nobody = partition.get_my_id().is_err() && mode == OperatingMode::Normal;
    if (handler || nobody) && random.random_range(0..2) == 0 {
        return [Call::GetError, Call::GetError, Call::StopSelf][random.random_range(0..3)];
    }
    let liked = plan.liked[random.random_range(0..plan.liked.len())];
    match if random.random_range(0..2) == 0 { liked } else { random.random_range(0..DRAWS) } {
        0 if random.random_range(0..8) == 0 => Call::Mode(OperatingMode::Idle),
        0..4 => Call::SetPriority(process, [0, 5, 10, 20, 30][random.random_range(0..5)]),
        4..8 => Call::SuspendSelf(time_out),
        8..14 => Call::Suspend(process),
        14..22 => Call::Resume(process),
        22..25 if mode == OperatingMode::Normal || handler => Call::StopSelf,
        25..29 => Call::Stop(process),
        29..43 => {
            let delay = [0, 0, 0, ms(3), ms(9), ms(11), -1, -2][random.random_range(0..8)];
            Call::DelayedStart(process, delay)
        }
        43..46 => Call::Lock,
        46..49 => Call::Unlock,
        49..53 => Call::TimedWait(time_out),
        53..58 => Call::PeriodicWait,
        58..61 => Call::Replenish(time_out),
        61..66 => Call::Send(byte, time_out),
        66..71 => Call::Receive(time_out),
        71..73 => Call::Display(byte),
        73..77 => Call::Read(time_out),
        77 => Call::Clear,
        78..83 => Call::WaitSemaphore(time_out),
        83..87 => Call::Signal,
        87..89 => Call::SetEvent,
        89..91 => Call::ResetEvent,
        91..94 => Call::WaitEvent(time_out),
        94..99 => Call::Acquire(mutex, time_out),
        99..103 => Call::Release(mutex),
        103 => Call::Reset(mutex, process),
        104 => Call::ResetLock(process),
        105..108 => Call::GetError,
        108 => Call::Raise,
        113 => Call::EnableHandler,
        109.. if plan.handler => {
            let codes = [ErrorCode::NumericError, ErrorCode::MemoryViolation, ErrorCode::PowerFail];
            Call::Fault(codes[random.random_range(0..3)])
        }
        _ => Call::GetError,
    }
}

fn process_id(place: usize) -> ProcessId {
    ProcessId(place as i32 + 1)
}

/// Makes the call in the crate.
pub(crate) fn real(partition: &mut Partition, call: Call) -> Answer {
    let semaphore = partition.get_semaphore_id("s").unwrap();
    let event = partition.get_event_id("e").unwrap();
    let buffer = partition.get_buffer_id("b").unwrap();
    let board = partition.get_blackboard_id("b").unwrap();
    let mutex = |partition: &Partition, place: usize| partition.get_mutex_id(&format!("m{place}")).unwrap();
    let mut into = Vec::new();
    match call {
        Call::Mode(mode) => plain(partition.set_partition_mode(mode)),
        Call::SetPriority(place, priority) => plain(partition.set_priority(process_id(place), priority)),
        Call::SuspendSelf(time_out) => progress(partition.suspend_self(time_out)),
        Call::Suspend(place) => plain(partition.suspend(process_id(place))),
        Call::Resume(place) => plain(partition.resume(process_id(place))),
        Call::StopSelf => {
            partition.stop_self();
            NOTHING
        }
        Call::Stop(place) => plain(partition.stop(process_id(place))),
        Call::DelayedStart(place, delay) => plain(partition.delayed_start(process_id(place), delay)),
        Call::Lock => match partition.lock_preemption()? {
            Progress::Done(level) => Ok(Given::Number(level.into())),
            Progress::Waits => Ok(Given::Waits),
        },
        Call::Unlock => partition.unlock_preemption().map(|level| Given::Number(level.into())),
        Call::TimedWait(delay) => progress(partition.timed_wait(delay)),
        Call::PeriodicWait => progress(partition.periodic_wait()),
        Call::Replenish(budget) => plain(partition.replenish(budget)),
        Call::Send(byte, time_out) => progress(partition.send_buffer(buffer, &[byte], time_out)),
        Call::Receive(time_out) => {
            let result = partition.receive_buffer(buffer, time_out, &mut into);
            bytes(result, into)
        }
        Call::Display(byte) => plain(partition.display_blackboard(board, &[byte])),
        Call::Read(time_out) => {
            let result = partition.read_blackboard(board, time_out, &mut into);
            bytes(result, into)
        }
        Call::Clear => plain(partition.clear_blackboard(board)),
        Call::WaitSemaphore(time_out) => progress(partition.wait_semaphore(semaphore, time_out)),
        Call::Signal => plain(partition.signal_semaphore(semaphore)),
        Call::SetEvent => plain(partition.set_event(event)),
        Call::ResetEvent => plain(partition.reset_event(event)),
        Call::WaitEvent(time_out) => progress(partition.wait_event(event, time_out)),
        Call::Acquire(place, time_out) => {
            progress(partition.acquire_mutex(mutex(partition, place), time_out))
        }
        Call::Release(place) => plain(partition.release_mutex(mutex(partition, place))),
        Call::Reset(place, process) => {
            plain(partition.reset_mutex(mutex(partition, place), process_id(process)))
        }
        Call::ResetLock(process) => plain(partition.reset_mutex(PREEMPTION_LOCK_MUTEX, process_id(process))),
        Call::GetError => partition.get_error_status().map(|error| {
            Given::Number(
                i64::from(u32::from(error.error_code)) * 1000 + i64::from(error.failed_process_id.0),
            )
        }),
        Call::EnableHandler => plain(partition.enable_error_handler()),
        Call::Raise => plain(partition.raise_application_error(ErrorCode::ApplicationError, b"x")),
        Call::Fault(code) => {
            partition.fault(code, 7);
            NOTHING
        }
    }
}

fn plain(result: Result<(), ReturnCode>) -> Answer {
    result.map(|()| Given::Number(0))
}

fn progress(result: Result<Progress, ReturnCode>) -> Answer {
    result.map(|progress| if progress == Progress::Waits { Given::Waits } else { Given::Number(0) })
}

fn bytes(result: Result<Progress, ReturnCode>, into: Vec<u8>) -> Answer {
    result.map(|progress| if progress == Progress::Waits { Given::Waits } else { Given::Bytes(into) })
}
