//! The services for code that is handed no [`Process`]: C functions, and traits whose functions know no receiver.
//!
//! Responsible for: which process calls. It must never let a thread that is none of the partition's processes call a service, and never
//! unwind through frames of another language: they are left (see `foreign.rs`).

use std::cell::{OnceCell, RefCell};
use std::sync::{Mutex, OnceLock, PoisonError};

use bateleur_contract::{Direction, PortDescription, PortKind, ReportKind, exit};
use bateleur_message_format::Type;
use bateleur_processes::standard::{
    OperatingMode, ProcessAttributes, ProcessId, QueuingPortId, SamplingPortId, SystemTime,
};
use bateleur_processes::{Progress, ReturnCode};

use super::initialisation::Initialisation;
use super::process::{Body, Process};
use super::run::{Beginning, begin, end_of};
use super::thread;
use crate::run::{End, report};
use crate::schedule::ScheduleId;

/// Where a process of another language begins.
pub type ForeignEntry = extern "C" fn();

/// The partition's name.
static NAME: OnceLock<String> = OnceLock::new();

thread_local! {
    /// The process that this thread runs.
    static PROCESS: OnceCell<Process> = const { OnceCell::new() };
    /// What the main process needs that nobody handed it.
    static MAIN: RefCell<Option<Beginning>> = const { RefCell::new(None) };
    /// A message on its way from a service to its reader.
    static MESSAGE: RefCell<Vec<u8>> = const { RefCell::new(Vec::new()) };
}

/// From here on this thread runs this process.
pub(crate) fn enter(process: Process) {
    PROCESS.with(|own| own.set(process).ok()); // it is set once, when the thread begins
}

/// Does something as the process that this thread runs. On the first thread of a program, which is its main process, the first call
/// takes over what the executive handed the program; where there is none, it says so and ends the program.
///
/// # Errors
/// As `using`. INVALID_MODE: this thread runs none of the partition's processes.
pub fn as_process<R>(using: impl FnOnce(&Process) -> Result<R, ReturnCode>) -> Result<R, ReturnCode> {
    connect();
    PROCESS.with(|own| using(own.get().ok_or(ReturnCode::InvalidMode)?))
}

/// Calls a service that gives a message, and hands what it gave to `take`: no byte where it gave none. INVALID_CONFIG comes with a
/// message.
pub fn receive<R, T>(
    service: impl FnOnce(&Process, &mut Vec<u8>) -> Result<R, ReturnCode>,
    take: impl FnOnce(Result<R, ReturnCode>, &[u8]) -> T,
) -> T {
    // Not borrowed: whoever is left in the midst of a service gives nothing back.
    let mut message = MESSAGE.take();
    message.clear();
    let result = as_process(|process| service(process, &mut message));
    if !matches!(result, Ok(_) | Err(ReturnCode::InvalidConfig)) {
        message.clear();
    }
    let taken = take(result, &message);
    MESSAGE.set(message);
    taken
}

/// Begins the partition if this is the first thread of a program that has not begun.
fn connect() {
    let known = PROCESS.with(|own| own.get().is_some());
    if known || !thread::is_first() {
        return;
    }
    match begin() {
        Ok(Some(main)) => {
            let _ = NAME.set(main.context.name().to_owned()); // it begins once
            MAIN.set(Some(main));
        }
        Ok(None) => {}
        Err(end) => std::process::exit(report(Err(end))),
    }
}

/// Does something as the main process of a partition that began here. `None`: this is another process, or the main one has ended.
fn as_main<R>(using: impl FnOnce(&mut Beginning) -> R) -> Option<R> {
    connect();
    MAIN.with_borrow_mut(|main| main.as_mut().map(using))
}

/// The partition's name in the plan; empty before the first service, and where nobody began it here.
pub fn partition_name() -> String {
    connect();
    NAME.get().cloned().unwrap_or_default()
}

/// SET_PARTITION_MODE. Out of the main process, and into any mode but NORMAL, it does not return: the thread of the main process takes
/// the partition's windows until the program ends.
///
/// # Errors
/// As [`bateleur_processes::Partition::set_partition_mode`].
pub fn set_partition_mode(mode: u32) -> Result<(), ReturnCode> {
    connect();
    if mode == u32::from(OperatingMode::Normal)
        && let Some(mut main) = MAIN.take()
    {
        main.context.leave_ports_out();
        std::process::exit(report(main.run()));
    }
    as_process(|process| process.call(|services| services.set_partition_mode(mode)))?;
    if let Some(end) = as_main(|main| end_of(&main.kernel)) {
        std::process::exit(report(end));
    }
    Ok(())
}

/// STOP_SELF. It does not return: in the main process neither, whose partition stays in its start mode.
pub fn stop_self() {
    let stopped = as_process(|process| {
        process.call(|services| {
            services.stop_self();
            Ok(())
        })
    });
    while stopped.is_ok() {
        std::thread::park();
    }
}

/// LOCK_PREEMPTION: the lock's level, once the caller has it.
///
/// # Errors
/// As [`bateleur_processes::Partition::lock_preemption`].
pub fn lock_preemption() -> Result<i32, ReturnCode> {
    as_process(|process| match process.call(|services| services.lock_preemption())? {
        Progress::Done(level) => Ok(level),
        Progress::Waits => process.call(|services| {
            services.result()?;
            Ok(services.get_partition_status().lock_level)
        }),
    })
}

/// What GET_MODULE_SCHEDULE_STATUS gives, with identifiers as C and `a653rs` have them: from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ModuleScheduleStatus {
    /// TIME_OF_LAST_SCHEDULE_SWITCH, module time, ns; 0: the module has not changed yet.
    pub time_of_last_switch: SystemTime,
    /// CURRENT_SCHEDULE.
    pub current: i32,
    /// NEXT_SCHEDULE.
    pub next: i32,
}

/// Identifiers are not 0.
fn identifier_of(schedule: ScheduleId) -> i32 {
    i32::try_from(schedule.0).unwrap_or(i32::MAX - 1) + 1
}

/// SET_MODULE_SCHEDULE (Part 2).
///
/// # Errors
/// As [`Process::set_module_schedule`].
pub fn set_module_schedule(schedule: i32) -> Result<(), ReturnCode> {
    // What is no identifier is the place of no schedule.
    let place = schedule.checked_sub(1).and_then(|place| u32::try_from(place).ok()).unwrap_or(u32::MAX);
    as_process(|process| process.set_module_schedule(ScheduleId(place)))
}

/// GET_MODULE_SCHEDULE_STATUS (Part 2).
///
/// # Errors
/// As [`Process::get_module_schedule_status`].
pub fn get_module_schedule_status() -> Result<ModuleScheduleStatus, ReturnCode> {
    let status = as_process(Process::get_module_schedule_status)?;
    Ok(ModuleScheduleStatus {
        time_of_last_switch: SystemTime::try_from(status.time_of_last_switch_ns).unwrap_or(SystemTime::MAX),
        current: identifier_of(status.current),
        next: identifier_of(status.next),
    })
}

/// GET_MODULE_SCHEDULE_ID (Part 2).
///
/// # Errors
/// As [`Process::get_module_schedule_id`].
pub fn get_module_schedule_id(name: &str) -> Result<i32, ReturnCode> {
    as_process(|process| process.get_module_schedule_id(name)).map(identifier_of)
}

/// CREATE_PROCESS, with its thread, which the plan's `threads` has to count. Why it is refused is on standard error.
///
/// # Errors
/// As [`bateleur_processes::Partition::create_process`]. INVALID_CONFIG too: the machine gives no thread.
pub fn create_process(attributes: &ProcessAttributes, entry: ForeignEntry) -> Result<ProcessId, ReturnCode> {
    let name = String::from_utf8_lossy(attributes.name.as_bytes()).into_owned();
    let body = Body::foreign(&name, attributes.stack_size, entry);
    let created = as_main(|main| main.kernel.add_process(attributes, body));
    let Some(created) = created else {
        return as_process(|process| process.call(|services| services.create_process(attributes)));
    };
    created.map_err(|refusal| refusal.tell(&format!("process \"{name}\"")))
}

/// CREATE_ERROR_HANDLER, as above.
///
/// # Errors
/// As [`bateleur_processes::Partition::create_error_handler`]. INVALID_CONFIG too: the machine gives no thread.
pub fn create_error_handler(entry: ForeignEntry, stack_size: u32) -> Result<(), ReturnCode> {
    let body = Body::foreign("error handler", stack_size, entry);
    let created = as_main(|main| main.kernel.add_error_handler(stack_size, body));
    let Some(created) = created else {
        return as_process(|process| process.call(|services| services.create_error_handler(stack_size)));
    };
    created.map_err(|refusal| refusal.tell("error handler"))
}

/// CREATE_SAMPLING_PORT. What the plan says instead, where it differs, is on standard error.
///
/// # Errors
/// As [`bateleur_processes::Partition::create_sampling_port`].
pub fn create_sampling_port(
    name: &str,
    max_message_size: i32,
    direction: u32,
    refresh_period: SystemTime,
) -> Result<SamplingPortId, ReturnCode> {
    let asked = || {
        // A source's means nothing.
        let refresh = match refresh_period {
            ..=0 => "a refresh period that is not above 0 ns".to_owned(),
            period => format!("refresh {period} ns"),
        };
        format!("sampling {}, {max_message_size} bytes, {refresh}", direction_word(direction))
    };
    create_port(name, asked, |main| {
        main.create_sampling_port(name, max_message_size, direction, refresh_period)
    })
    .unwrap_or_else(|| {
        as_process(|process| {
            process.at_ports(|services, ports| {
                services.create_sampling_port(ports, name, max_message_size, direction, refresh_period)
            })
        })
    })
}

/// CREATE_QUEUING_PORT, as above.
///
/// # Errors
/// As [`bateleur_processes::Partition::create_queuing_port`].
pub fn create_queuing_port(
    name: &str,
    max_message_size: i32,
    max_nb_message: i32,
    direction: u32,
    discipline: u32,
) -> Result<QueuingPortId, ReturnCode> {
    let asked = || {
        let direction = direction_word(direction);
        format!("queuing {direction}, {max_nb_message} messages of {max_message_size} bytes")
    };
    create_port(name, asked, |main| {
        main.create_queuing_port(name, max_message_size, max_nb_message, direction, discipline)
    })
    .unwrap_or_else(|| {
        as_process(|process| {
            process.at_ports(|services, ports| {
                services.create_queuing_port(
                    ports,
                    name,
                    max_message_size,
                    max_nb_message,
                    direction,
                    discipline,
                )
            })
        })
    })
}

/// Creates a port in the main process; `None` in another one.
fn create_port<I>(
    name: &str,
    asked: impl FnOnce() -> String,
    create: impl FnOnce(&mut Initialisation<'_>) -> Result<I, ReturnCode>,
) -> Option<Result<I, ReturnCode>> {
    as_main(|main| {
        if let Some(reason) = built_with_other_fields(main.context.described_ports(), name) {
            // As a partition in Rust does: whatever it read and wrote would be taken for something else.
            std::process::exit(report(Err(End { code: exit::START_REFUSED, reason })));
        }
        let created = create(&mut main.initialisation());
        if matches!(created, Err(ReturnCode::InvalidConfig)) {
            let planned = planned(main.context.described_ports(), name);
            let text = format!("port \"{name}\" is refused: the program asks for {}; {planned}", asked());
            eprintln!("{text}");
            // A program that does not look at the code runs without it.
            main.kernel.page.report(ReportKind::Message, &text);
        }
        created
    })
}

/// Message types that the program was built with, and their layouts.
static BUILT_WITH: Mutex<Vec<(String, u32)>> = Mutex::new(Vec::new());

/// The program was built with `message` of that layout, as a header that `message_header` wrote says of each type within it.
pub fn built_with(message: &str, layout: u32) {
    let mut all = BUILT_WITH.lock().unwrap_or_else(PoisonError::into_inner);
    if !all.iter().any(|(name, known)| name == message && *known == layout) {
        all.push((message.to_owned(), layout));
    }
}

/// Why a port is not this program's: it was built with other fields of its message type.
fn built_with_other_fields(ports: &[PortDescription], name: &str) -> Option<String> {
    let port = ports.iter().find(|port| port.name.eq_ignore_ascii_case(name))?;
    let built = BUILT_WITH.lock().unwrap_or_else(PoisonError::into_inner);
    let differs = |(message, layout): &(String, u32)| *message == port.message && *layout != port.layout;
    if port.layout == 0 || !built.iter().any(differs) {
        return None;
    }
    let message = &port.message;
    let fields = Type::from_schema(message, &port.definition).map(|of| of.describe()).unwrap_or_default();
    Some(format!(
        "{message} in the plan (byte, kind, name and unit of each field):\n{fields}port \"{}\" carries {message}, which has other \
         fields in the plan than in this program; write its header anew (message_header) and build the program again",
        port.name
    ))
}

fn planned(ports: &[PortDescription], name: &str) -> String {
    let Some(port) = ports.iter().find(|port| port.name.eq_ignore_ascii_case(name)) else {
        let known: Vec<_> = ports.iter().map(|port| port.name.as_str()).collect();
        return format!("the plan gives this partition no such port; it has {}", known.join(", "));
    };
    let (kind, direction) = (format!("{:?}", port.kind), format!("{:?}", port.direction));
    let head = format!("the plan has {} {}", kind.to_lowercase(), direction.to_lowercase());
    match port.depth {
        0 if port.kind == PortKind::Sampling && port.direction == Direction::Source => {
            format!("{head}, {} bytes, any refresh period above 0 ns", port.size)
        }
        0 => format!("{head}, {} bytes, refresh {} ns", port.size, port.refresh_ns),
        depth => format!("{head}, {depth} messages of {} bytes", port.size),
    }
}

fn direction_word(direction: u32) -> &'static str {
    match direction {
        0 => "source",
        1 => "destination",
        _ => "port of no direction",
    }
}
