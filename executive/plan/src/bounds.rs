//! What must hold of a plan that was read from a compiled file, because a wrong value would harm whoever runs it: places in
//! lists, names that become paths, numbers that are divided by, reserved or counted up to, and windows that overlap.
//!
//! The rules of the schedule file say more, with places and mends. Here one sentence is enough: a plan that came from the
//! checker never gets it.

use std::collections::{BTreeMap, BTreeSet};

use bateleur_contract::REPLICAS;

use crate::model::{
    Attribute, Channel, Logbook, MemoryBlock, ModuleId, Partition, Payload, Plan, Port, PortId, Role,
    Schedule,
};
use crate::processes::{Process, Processes, Times};
use crate::timeline::TimelineWindow;

/// The longest name, bytes: with a closing zero it still fits the 32 bytes of an APEX name, with one to spare for
/// implementations that count it. Longer ones are cut off by other people's tools.
pub const LONGEST_NAME: usize = 30;
/// The highest priority of a partition: above it lie the executive's own threads, which a partition must not hold up.
pub const HIGHEST_PRIORITY: u8 = 50;
/// The most processes of a partition, as APEX has it; each takes a stack of its memory.
pub const MOST_PROCESSES: u32 = 128;
/// The most threads of a partition: one for each process, the error handler and the main thread.
pub const MOST_THREADS: u32 = MOST_PROCESSES + 2;
/// The most urgent priority of a process.
pub const MOST_URGENT: u8 = 239;
/// The highest number of a partition: APEX counts with a sign.
pub const HIGHEST_IDENTIFIER: u32 = i32::MAX as u32;
/// The deepest queue: as deep as an APEX queuing port may be; its slots are locked memory.
pub const DEEPEST_QUEUE: u32 = 512;
/// The longest message of plain bytes: as long as an APEX message may be.
pub const LONGEST_BYTES: u32 = 8192;
/// The longest message of any type, bytes.
const LONGEST_MESSAGE: usize = 1 << 20;
/// The longest name of a message type: two names with a slash between them.
const LONGEST_TYPE: usize = 2 * LONGEST_NAME + 1;
/// The longest text of a message type with all types within it, bytes: helpers keep one for each channel, the control socket sends
/// them.
pub const LONGEST_DEFINITION: usize = 256 << 10;
/// The longest of all of them together, bytes: a partition's description carries those of its ports, each run's status all.
pub const LONGEST_DEFINITIONS: usize = 8 << 20;
/// The most bytes of a memory block: they are locked memory, all of them there before frame 0.
pub const LARGEST_BLOCK: u64 = 1 << 30;
/// The most logbooks of a partition.
pub const MOST_LOGBOOKS: usize = 16;
/// The most messages that a logbook keeps: with the longest messages, 80 MB.
pub const MOST_LOGGED: u32 = 10_000;
/// The most messages of a logbook on their way to its file.
pub const MOST_IN_PROGRESS: u32 = 256;
/// The most minor frames of a major frame. At 50 a second, three minutes: far beyond any cycle that a person can read. The timeline
/// has an entry for every window in each of them, in memory that the dispatcher keeps locked.
pub const MOST_MINOR_FRAMES: u64 = 10_000;
/// The most windows on one core in a major frame: a window every 100 us of ten seconds, in 4 MB of the dispatcher's locked
/// memory. Whoever lays out more has written a unit for another.
pub const MOST_WINDOWS: u64 = 100_000;
/// The most of any list of a plan.
const MOST_LISTED: usize = 4096;
/// The longest period or time, ns: a day.
pub const LONGEST_NS: u64 = 86_400_000_000_000;
/// The deepest list within lists of an attribute.
const DEEPEST: usize = 8;

/// What is out of bounds.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct OutOfBounds(String);

type Checked = Result<(), OutOfBounds>;

fn require(holds: bool, what: impl FnOnce() -> String) -> Checked {
    if holds { Ok(()) } else { Err(OutOfBounds(what())) }
}

/// Holds a plan against all bounds.
///
/// # Errors
/// The first that does not hold.
pub fn check(plan: &Plan) -> Checked {
    let lists = [
        ("modules", plan.modules.len()),
        ("networks", plan.networks.len()),
        ("links", plan.links.len()),
        ("partitions", plan.partitions.len()),
        ("ports", plan.ports.len()),
        ("message types", plan.messages.len()),
        ("channels", plan.channels.len()),
        ("memory blocks", plan.memory_blocks.len()),
        ("name services", plan.name_services.len()),
        ("addresses of name services", plan.name_services.values().map(BTreeMap::len).sum()),
        ("chains", plan.chains.len()),
        ("schedules", plan.schedules.len()),
    ];
    for (what, count) in lists {
        require(count <= MOST_LISTED, || format!("{count} {what}"))?;
    }
    names("module", plan.modules.iter().map(|module| &*module.name))?;
    names("network", plan.networks.iter().map(|network| &*network.name))?;
    names("link", plan.links.iter().map(|link| &*link.name))?;
    names("schedule", plan.schedules.iter().map(|schedule| &*schedule.name))?;
    modules(plan)?;
    links(plan)?;
    let own = plan.partitions.iter().filter(|partition| !partition.relay);
    names("partition", own.map(|partition| &*partition.name))?;
    for (place, one) in plan.partitions.iter().enumerate() {
        partition(plan, place, one).map_err(|wrong| within("partition", &one.name, &wrong))?;
    }
    for (place, one) in plan.ports.iter().enumerate() {
        port(plan, PortId(place), one).map_err(|wrong| within("port", &one.name, &wrong))?;
    }
    messages(plan)?;
    for one in &plan.channels {
        channel(plan, one)?;
    }
    names("memory block", plan.memory_blocks.iter().map(|block| &*block.name))?;
    for one in &plan.memory_blocks {
        memory_block(plan, one).map_err(|wrong| within("memory block", &one.name, &wrong))?;
    }
    names("name service", plan.name_services.keys().map(String::as_str))?;
    for (name, addresses) in &plan.name_services {
        names("service access point", addresses.keys().map(String::as_str))
            .map_err(|wrong| within("name service", name, &wrong))?;
        require(addresses.values().all(|address| address.port() != 0), || "a port of 0".into())?;
    }
    let initial = plan.schedules.iter().filter(|schedule| schedule.initial).count();
    require(initial == 1, || format!("{initial} initial schedules"))?;
    for one in &plan.schedules {
        schedule(plan, one).map_err(|wrong| within("schedule", &one.name, &wrong))?;
    }
    for chain in &plan.chains {
        require(chain.path.iter().all(|port| port.0 < plan.ports.len()), || "a chain of no port".into())?;
    }
    health(plan)
}

fn within(what: &str, name: &str, wrong: &OutOfBounds) -> OutOfBounds {
    let name: String = name.chars().take(LONGEST_NAME).collect();
    OutOfBounds(format!("{what} {name:?}: {wrong}"))
}

fn is_plain(name: &str, longest: usize) -> bool {
    let plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    !name.is_empty() && name.len() <= longest && name.chars().all(plain)
}

/// `Name`, or `package/Name`.
fn is_type(name: &str) -> bool {
    let (package, own) = name.split_once('/').unwrap_or(("package", name));
    is_plain(package, LONGEST_TYPE) && is_plain(own, LONGEST_TYPE) && name.len() <= LONGEST_TYPE
}

fn messages(plan: &Plan) -> Checked {
    let carried = |name: &str| {
        let names = plan.ports.iter().map(|port| &port.payload);
        names
            .into_iter()
            .any(|payload| matches!(payload, Payload::Message { name: known, .. } if known == name))
    };
    for (name, definition) in &plan.messages {
        require(is_type(name) && carried(name), || "a message type that no port carries".into())?;
        require(definition.len() <= LONGEST_DEFINITION, || format!("message type {name}: its text"))?;
    }
    let all: usize = plan.messages.values().map(String::len).sum();
    require(all <= LONGEST_DEFINITIONS, || "the texts of message types".into())
}

/// Names become names of files and processes; two that differ in their letters' case alone would be one somewhere.
fn names<'p>(what: &str, names: impl Iterator<Item = &'p str>) -> Checked {
    let mut seen = BTreeSet::new();
    for name in names {
        require(is_plain(name, LONGEST_NAME), || format!("a {what} with the name {name:?}"))?;
        require(seen.insert(name.to_lowercase()), || format!("two {what}s with the name {name:?}"))?;
    }
    Ok(())
}

fn modules(plan: &Plan) -> Checked {
    for module in &plan.modules {
        let cores: BTreeSet<u32> = module.cores.iter().copied().collect();
        require(!cores.is_empty() && cores.len() == module.cores.len(), || "cores of a module".into())?;
        require(module.follows.is_none_or(|id| id.0 < plan.modules.len()), || {
            "no module is followed".into()
        })?;
        let known = module.addresses.iter().all(|address| address.network.0 < plan.networks.len());
        require(known, || "an address on no network".into())?;
        require(module.follows_within_ns > 0, || "an alignment of nothing".into())?;
    }
    Ok(())
}

fn links(plan: &Plan) -> Checked {
    for link in &plan.links {
        let ends = link.ends.iter().all(|end| end.0 < plan.modules.len()) && link.ends[0] != link.ends[1];
        require(ends, || format!("link {}: its ends", link.name))?;
        let networks = link.networks.iter().all(|network| network.0 < plan.networks.len());
        require(networks && (1..=2).contains(&link.networks.len()), || {
            format!("link {}: its networks", link.name)
        })?;
        let numbers = (1..=LONGEST_NS).contains(&link.gap_ns)
            && link.max_bytes <= 65_507
            && link.skew_ns <= LONGEST_NS
            && link.lost_after_ns <= LONGEST_NS;
        require(numbers, || format!("link {}: its numbers", link.name))?;
    }
    let networks = plan.networks.iter().all(|network| network.rate_bits_per_s > 0);
    require(networks, || "a network that carries nothing".into())
}

fn partition(plan: &Plan, place: usize, partition: &Partition) -> Checked {
    // A relay is called as its module, with a word before it.
    require(is_plain(&partition.name, LONGEST_NAME + 6), || "its name".into())?;
    require(partition.module.0 < plan.modules.len(), || "its module".into())?;
    require(!partition.program.is_empty() && !partition.program.contains('\0'), || "its program".into())?;
    require(partition.memory_bytes > 0, || "its memory".into())?;
    require(partition.retained_bytes <= partition.memory_bytes, || "its retained memory".into())?;
    require((1..=MOST_THREADS).contains(&partition.threads), || "its threads".into())?;
    require((1..=HIGHEST_PRIORITY).contains(&partition.priority), || "its priority".into())?;
    require(processes(&partition.processes), || "its processes".into())?;
    let times = [partition.startup_timeout_ns, partition.restart.within_ns, partition.restart.startup_ns];
    let limited = times.iter().chain(&partition.deadline_ns).all(|&time| time <= LONGEST_NS);
    require(limited, || "its times".into())?;
    let replicas = &partition.replicas;
    let known = replicas.iter().all(|id| id.0 < plan.partitions.len() && id.0 != place);
    require(known && matches!(replicas.len(), 0 | REPLICAS), || "its replicas".into())?;
    let schedules = partition.may_set_schedule.iter().all(|id| id.0 < plan.schedules.len());
    require(schedules, || "schedules that it may ask for".into())?;
    let mut ports = BTreeSet::new();
    for &id in &partition.ports {
        let owner = plan.ports.get(id.0).map(|port| port.partition.0);
        require(owner == Some(place) && ports.insert(id), || "its ports".into())?;
    }
    names("port", partition.ports.iter().map(|&id| &*plan[id].name))?;
    for (name, value) in &partition.attributes {
        require(depth(value) <= DEEPEST, || format!("its attribute {name:?}"))?;
    }
    names("logbook", partition.logbooks.iter().map(|logbook| &*logbook.name))?;
    let logbooks = partition.logbooks.len() <= MOST_LOGBOOKS && partition.logbooks.iter().all(logbook);
    require(logbooks, || "its logbooks".into())?;
    let devices = partition.devices.iter().all(|device| !device.is_empty() && !device.contains('\0'));
    require(devices, || "its devices".into())
}

fn logbook(logbook: &Logbook) -> bool {
    (1..=LONGEST_BYTES).contains(&logbook.max_size_bytes)
        && (1..=MOST_LOGGED).contains(&logbook.max_logged)
        && (1..=MOST_IN_PROGRESS).contains(&logbook.max_in_progress)
}

fn processes(processes: &Processes) -> bool {
    let &Processes { identifier, period_ns, release_ns, duration_ns, most, ref declared, .. } = processes;
    let times = |times: &Times| {
        (1..=LONGEST_NS).contains(&times.period_ns)
            && times.release_ns < times.period_ns
            && times.duration_ns <= times.period_ns
    };
    let sound = |process: &Process| {
        let times = [Some(process.wcet_ns), process.period_ns, process.deadline_ns];
        (1..=MOST_URGENT).contains(&process.priority)
            && times.iter().flatten().all(|time| (1..=LONGEST_NS).contains(time))
            && is_plain(&process.name, LONGEST_NAME)
    };
    identifier <= HIGHEST_IDENTIFIER
        && times(&Times { period_ns, release_ns, duration_ns })
        && processes.in_schedules.values().all(times)
        && most <= MOST_PROCESSES
        && declared.len() <= most as usize
        && declared.iter().all(sound)
}

fn depth(attribute: &Attribute) -> usize {
    match attribute {
        Attribute::Array(values) => 1 + values.iter().map(depth).max().unwrap_or(0),
        _ => 0,
    }
}

fn port(plan: &Plan, id: PortId, port: &Port) -> Checked {
    let owner = plan.partitions.get(port.partition.0);
    require(owner.is_some_and(|owner| owner.ports.contains(&id)), || "its partition".into())?;
    require((1..=LONGEST_MESSAGE).contains(&port.payload.max_size_bytes()), || "its message".into())?;
    if let Payload::Message { name, .. } = &port.payload {
        require(is_type(name), || "its message".into())?;
    }
    let role = match port.role {
        Role::SamplingDestination { refresh_ns } => refresh_ns > 0,
        Role::QueuingDestination { depth } => (1..=DEEPEST_QUEUE).contains(&depth),
        Role::SamplingSource | Role::QueuingSource => true,
    };
    require(role, || "its role".into())?;
    let attached = port.channel.is_none_or(|channel| {
        let channel = plan.channels.get(channel.0);
        channel.is_some_and(|channel| channel.source == id || channel.destinations.contains(&id))
    });
    require(attached, || "its channel".into())
}

fn channel(plan: &Plan, channel: &Channel) -> Checked {
    use crate::closed::Direction::{Destination, Source};
    let known = |id: &PortId| id.0 < plan.ports.len();
    require(known(&channel.source) && channel.destinations.iter().all(known), || {
        "a channel of no port".into()
    })?;
    let name = || format!("the channel of {}", plan.port_path(channel.source));
    let source = &plan[channel.source];
    require(source.direction() == Source && source.kind() == channel.kind, name)?;
    let carries = |payload: &Payload| match (payload, &source.payload) {
        (Payload::Bytes { .. }, Payload::Bytes { .. }) => true,
        (one, other) => one == other,
    };
    let fits = |id: &PortId| {
        let end = &plan[*id];
        end.direction() == Destination && end.kind() == channel.kind && carries(&end.payload)
    };
    require(channel.destinations.iter().all(fits), name)
}

fn memory_block(plan: &Plan, block: &MemoryBlock) -> Checked {
    require((1..=LARGEST_BLOCK).contains(&block.size_bytes), || "its size".into())?;
    let content = block.content.as_ref().is_none_or(|file| !file.is_empty() && !file.contains('\0'));
    require(content, || "its content".into())?;
    let (mut seen, mut modules) = (BTreeSet::new(), BTreeSet::new());
    for id in block.partitions() {
        let owner = plan.partitions.get(id.0);
        require(owner.is_some_and(|owner| !owner.relay) && seen.insert(id), || "its partitions".into())?;
        modules.extend(owner.map(|owner| owner.module));
    }
    require(modules.len() == 1, || "its modules".into())
}

fn schedule(plan: &Plan, schedule: &Schedule) -> Checked {
    let (major, minor) = (schedule.major_frame_ns, schedule.minor_frame_ns);
    let frames = minor > 0 && major <= LONGEST_NS && major.is_multiple_of(minor);
    require(frames && (1..=MOST_MINOR_FRAMES).contains(&(major / minor.max(1))), || "its frames".into())?;
    for window in &schedule.windows {
        let owner = plan.partitions.get(window.partition.0);
        let Some(about) = owner.and_then(|owner| plan.modules.get(owner.module.0)) else {
            return Err(OutOfBounds("a window of nobody".into()));
        };
        require(about.cores.contains(&window.core), || "a window on a core of others".into())?;
        let inside = window.offset_ns.checked_add(window.duration_ns).is_some_and(|end| end <= minor);
        require(inside && window.duration_ns > 0, || "a window beyond its frame".into())?;
        let rising = window.minor.windows(2).all(|pair| pair[0] < pair[1]);
        let last = window.minor.last().map(|&last| u64::from(last) < major / minor);
        require(rising && last == Some(true), || "a window in no minor frame".into())?;
    }
    let mut lines: BTreeMap<(ModuleId, u32), Vec<TimelineWindow>> = BTreeMap::new();
    for window in schedule.laid(|_| true) {
        let core = (plan[window.partition].module, schedule.windows[window.declared].core);
        lines.entry(core).or_default().push(window);
    }
    for line in lines.values() {
        require(line.len() as u64 <= MOST_WINDOWS, || format!("{} windows on a core", line.len()))?;
        let apart = line.windows(2).all(|pair| pair[0].end_ns <= pair[1].start_ns);
        require(apart, || "windows that overlap".into())?;
    }
    let changed = schedule.change_actions.keys().all(|id| id.0 < plan.partitions.len());
    require(changed, || "an action for nobody".into())
}

fn health(plan: &Plan) -> Checked {
    let health = &plan.health;
    require(health.silence_windows > 0 && health.late_after_ns > 0, || "limits of health".into())?;
    let times = [health.reset.within_ns, health.reset.startup_ns];
    require(times.iter().all(|&time| time <= LONGEST_NS), || "times of a reset".into())?;
    require(health.log.bytes <= 1 << 40, || "the length of the health log".into())
}
