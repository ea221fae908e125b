//! The mechanisms of one partition's life: its sandbox, which outlives its processes, and the start and end of a process
//! in it. Whether to start or end one is decided elsewhere.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, Write};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use bateleur_contract::page::WindowGrant;
use bateleur_contract::{
    CONTROL_FD, Clock, ControlPage, Description, Direction, ENVIRONMENT, Mapped, PLAIN_BYTES, PartitionTimes,
    PlannedProcess, PortDescription, PortKind, ProcessPlan, ProcessTable, RELAY_KEYS_FD, StartCondition,
    page,
};
use rustix::fs::{
    FallocateFlags, MemfdFlags, SealFlags, fallocate, fcntl_add_seals, ftruncate, memfd_create,
};

use crate::crash_memory::CrashMemory;
use crate::error_log::{ErrorLine, ErrorLogs};
use crate::keys::Key;
use crate::logbooks::{GivenLogbooks, LogbookMemories};
use crate::memory_blocks::{GivenBlocks, MemoryBlocks};
use crate::network_limits::NetworkLimits;
use crate::sealed::{End, Handover, SealedChannels};
use bateleur_plan::units::ShowSize;
use bateleur_plan::{
    Attribute, Closed, ErrorLevel, Partition, PartitionError, PartitionId, PartitionState, Plan, Port, Role,
    Standby, SystemCalls, leaves_the_process,
};
use bateleur_system::account::Accounts;
use bateleur_system::cgroup::Group;
use bateleur_system::filter::{Filters, Grants};
use bateleur_system::lock_calls::{LockCounter, LockLimit};
use bateleur_system::rules::{self, Granted};
use bateleur_system::sched;
use bateleur_system::spawn::{Counts, Namespaces, Request, Spawned, User, Walls, spawn};
use bateleur_system::users::{HELPERS, Users};
use bateleur_time::partition_control::PartitionControl;
use bateleur_time::time_guard::{Processes, TimeGuard};

/// What the module gives each of its partitions.
#[derive(Debug, Clone)]
pub struct SandboxConfig {
    /// The module's name.
    pub module: String,
    /// The clock.
    pub clock: Clock,
    /// Root of the ports' shared memory.
    pub ports_root: String,
    /// Namespaces that this machine allows.
    pub namespaces: Namespaces,
    /// Whom partitions run as; `None`: as the executive.
    pub users: Option<Users>,
    /// Whether system calls can be filtered.
    pub filtered: bool,
    /// Who counts locks of byte ranges, where they can be counted.
    pub locks: Option<LockCounter>,
    /// Whether the kernel has rules about files.
    pub ruled: bool,
    /// Whether real-time priority is to be had.
    pub real_time: bool,
    /// Where partitions' standard error goes.
    pub errors: ErrorLogs,
    /// The keys of the module's links, for its relay.
    pub link_keys: Vec<Key>,
    /// Retained memories that outlive the executive, by partition.
    pub retained: BTreeMap<String, Arc<OwnedFd>>,
    /// The module's memory blocks.
    pub memory_blocks: Arc<MemoryBlocks>,
    /// The memories of its logbooks.
    pub logbooks: Arc<LogbookMemories>,
    /// The memories of sealed channels.
    pub sealed: Arc<SealedChannels>,
}

/// Times that memory which is being written is read again until it stands still.
const TAKING_UP: usize = 8;

/// A partition without its process.
#[derive(Debug)]
pub struct Sandbox {
    /// Its place in the plan.
    pub id: PartitionId,
    /// Its name.
    pub name: String,
    /// Shared with the dispatcher.
    pub control: Arc<PartitionControl>,
    /// What its processes show of themselves, where it may have several; nothing read from it is trusted.
    pub table: Option<Mapped<ProcessTable>>,
    program: PathBuf,
    cores: Vec<u32>,
    page: OwnedFd,
    table_file: Option<OwnedFd>,
    retained: Option<OwnedFd>,
    retained_bytes: u64,
    memory_blocks: GivenBlocks,
    logbooks: GivenLogbooks,
    /// A relay's: the keys of its links.
    keys: Option<OwnedFd>,
    group: Option<Group>,
    accounts: Accounts,
    /// Those of its sockets and addresses, where it has the network and the kernel counts them.
    network_limits: Option<NetworkLimits>,
    filters: Option<Filters>,
    locks: Option<LockCounter>,
    /// Whether the kernel restricts what it opens.
    ruled: bool,
    network: bool,
    devices: Vec<PathBuf>,
    /// Files that its attributes name: it may read them.
    files: Vec<PathBuf>,
    namespaces: Namespaces,
    user: Option<User>,
    counts: Counts,
    data_limit: u64,
    memory_bytes: u64,
    /// The directories of its channels.
    channels: Vec<PathBuf>,
    /// Those of the sealed ones.
    sealed: Arc<SealedChannels>,
    /// The number of the process that was started last.
    incarnation: AtomicU32,
    /// Where it writes what happened when it ends by a fault; `None`: nowhere.
    crash_memory: Option<CrashMemory>,
    errors: ErrorLine,
    description: Description,
    /// That of a process that stands by.
    pub standby: Option<Box<Sandbox>>,
}

impl Sandbox {
    /// Builds the sandbox of partition `id`. `overrides` replace attributes of the plan. `beside`: the partition has this one
    /// already, whose retained memory both share.
    pub fn build(
        plan: &Plan,
        id: PartitionId,
        program: PathBuf,
        (group, accounts): (Option<Group>, Accounts),
        sandbox_config: &SandboxConfig,
        overrides: &BTreeMap<String, serde_json::Value>,
        beside: Option<&Self>,
    ) -> io::Result<Self> {
        let partition = &plan[id];
        let page = shared_memory(&partition.name, size_of::<ControlPage>() as u64)?;
        let mapped = Mapped::<ControlPage>::new(&page).map_err(io::Error::other)?;
        let shows_processes = partition.threads > 1;
        let table_file = shows_processes.then(|| process_table(&partition.name)).transpose()?;
        let table = table_file.as_ref().map(Mapped::new).transpose().map_err(io::Error::other)?;
        let freezer = group.as_ref().map(Group::freezer).transpose()?;
        let (socket_count, socket_bytes) = if partition.relay { RELAY_SOCKETS } else { SOCKETS };
        let _ = accounts.limit_sockets(socket_bytes); // without version 1 of the controller they count as its memory
        let networked = group.as_ref().filter(|_| partition.network);
        let network_limits = networked.and_then(|group| NetworkLimits::of(group, socket_count).ok()); // as the list of guarantees says
        let memory_limited = accounts.limit_memory(partition.memory_bytes).is_ok()
            || group.as_ref().is_some_and(|group| group.limit_memory(partition.memory_bytes).is_ok());
        if let Err(_absent) = accounts.limit_tasks(partition.threads)
            && let Some(group) = &group
        {
            let _ = group.limit("pids.max", partition.threads.into()); // as the list of guarantees says
        }
        let priority = match sandbox_config.clock {
            Clock::Wall => sandbox_config.real_time.then_some(partition.priority),
            Clock::Virtual => virtual_priority(),
        };
        let retained = match (partition.retained_bytes, beside.and_then(|first| first.retained.as_ref())) {
            (0, _) => None,
            (_, Some(shared)) => Some(shared.try_clone()?),
            (bytes, None) => Some(match sandbox_config.retained.get(&partition.name) {
                Some(kept) => kept.try_clone()?,
                None => shared_memory(&partition.name, bytes)?,
            }),
        };
        let guard = TimeGuard::new(Box::new(Processes(freezer)), priority);
        let guard = if sandbox_config.clock == Clock::Virtual { guard.timeless() } else { guard };
        let guard =
            if partition.threads == 1 && sandbox_config.filtered { guard.of_one_thread() } else { guard };
        let initial = plan.initial_schedule().index() as u32;
        mapped.publish_grant(
            0,
            &WindowGrant { schedule: initial, next_schedule: initial, ..WindowGrant::default() },
        );
        let always_freeze =
            partition.threads > 1 || (priority.is_none() && sandbox_config.clock == Clock::Wall);
        Ok(Self {
            id,
            name: partition.name.clone(),
            control: Arc::new(match beside {
                Some(first) => PartitionControl::new(mapped, guard, always_freeze).beside(&first.control),
                None => PartitionControl::new(mapped, guard, always_freeze),
            }),
            table,
            program,
            cores: window_cores(plan, id),
            page,
            table_file,
            retained,
            retained_bytes: partition.retained_bytes,
            memory_blocks: sandbox_config.memory_blocks.of(plan, id)?,
            logbooks: sandbox_config.logbooks.of(&plan[id]),
            keys: partition.relay.then(|| sealed_keys(&sandbox_config.link_keys)).transpose()?,
            group,
            accounts,
            network_limits,
            filters: sandbox_config
                .filtered
                .then(|| Filters::new(&grants(partition, sandbox_config, overrides)))
                .transpose()?,
            locks: sandbox_config.locks.clone(),
            ruled: sandbox_config.ruled,
            network: partition.network,
            devices: devices(partition, overrides).map(PathBuf::from).collect(),
            files: named_files(partition, overrides),
            namespaces: Namespaces {
                network: sandbox_config.namespaces.network && !partition.network,
                ..sandbox_config.namespaces
            },
            user: sandbox_config.users.map(|users| {
                users.partition(id.index(), beside.is_some(), device_groups(partition, overrides))
            }),
            counts: counts(plan, id),
            data_limit: if memory_limited { 0 } else { partition.memory_bytes },
            memory_bytes: partition.memory_bytes,
            channels: shared_channels(plan, id)
                .iter()
                .map(|channel| Path::new(&sandbox_config.ports_root).join(channel))
                .collect(),
            sealed: sandbox_config.sealed.clone(),
            incarnation: AtomicU32::new(0),
            crash_memory: None,
            errors: beside
                .map_or_else(|| sandbox_config.errors.line(&partition.name), |first| first.errors.beside()),
            description: describe(
                plan,
                partition,
                (&sandbox_config.module, sandbox_config.clock, &sandbox_config.ports_root),
                overrides,
            ),
            standby: None,
        })
    }

    /// Replaces the plan's core numbers by the machine's.
    pub fn translate_cores(&mut self, real: impl Fn(u32) -> u32) {
        self.cores.iter_mut().for_each(|core| *core = real(*core));
    }

    /// The machine's cores on which the partition has windows.
    #[must_use]
    pub fn cores(&self) -> &[u32] {
        &self.cores
    }

    /// Starts incarnation number `generation`.
    pub fn launch(&mut self, generation: u32, condition: StartCondition) -> io::Result<Spawned> {
        if !condition.is_warm() {
            self.forget()?;
        }
        self.start(generation, condition, None)
    }

    /// Starts a process that shall become incarnation number `generation`, and waits as `standby` says until then.
    pub fn launch_standby(&mut self, generation: u32, standby: Standby) -> io::Result<Spawned> {
        self.start(generation, StartCondition::HmPartitionWarmRestart, Some(standby))
    }

    /// Retained memory is zero.
    pub fn forget(&self) -> io::Result<()> {
        let Some(retained) = &self.retained else { return Ok(()) };
        // A hole reads as zeros; the seals allow no other way.
        let hole = FallocateFlags::PUNCH_HOLE | FallocateFlags::KEEP_SIZE;
        Ok(fallocate(retained, hole, 0, self.retained_bytes)?)
    }

    /// Retained memory is what `other`, of the same size, retains; false: there is none, or it was written all the time.
    pub fn take_up(&self, other: &Self) -> io::Result<bool> {
        let (Some(own), Some(others)) = (&self.retained, &other.retained) else { return Ok(false) };
        if self.retained_bytes != other.retained_bytes {
            return Ok(false);
        }
        let (own, others) = (File::from(own.try_clone()?), File::from(others.try_clone()?));
        let read = || -> io::Result<Vec<u8>> {
            let mut bytes = vec![0; self.retained_bytes as usize];
            others.read_exact_at(&mut bytes, 0)?;
            Ok(bytes)
        };
        let mut bytes = read()?;
        for _ in 0..TAKING_UP {
            // The other one runs, and may be at writing.
            let again = read()?;
            if bytes == again {
                own.write_all_at(&bytes, 0)?;
                return Ok(true);
            }
            bytes = again;
        }
        Ok(false)
    }

    fn start(
        &mut self,
        generation: u32,
        condition: StartCondition,
        standby: Option<Standby>,
    ) -> io::Result<Spawned> {
        let mut description = Description {
            generation,
            start_condition: condition,
            standby: standby == Some(Standby::Hot),
            spare: standby == Some(Standby::Spare),
            ..self.description.clone()
        };
        let (sealed, free) = self.hand_over(&mut description)?;
        description.process_table = self.table_file.as_ref().map(|_| free);
        // One that died before has its own: that is read while this process runs. Without one there is no report.
        self.crash_memory = CrashMemory::make(&self.name).ok();
        description.crash_memory =
            self.crash_memory.as_ref().map(|_| free + i32::from(self.table_file.is_some()));
        if let Some(table) = &self.table {
            table.forget();
        }
        self.incarnation.store(generation, Ordering::Relaxed);
        let description = sealed_text(&self.name, &serde_json::to_vec(&description)?)?;
        let errors = self.errors.begin()?;
        // A process that was ended has no socket, and its successor needs them at once.
        self.network_limits.as_ref().map_or(Ok(()), NetworkLimits::clear)?;
        let mut descriptors: Vec<BorrowedFd<'_>> = vec![self.page.as_fd(), description.as_fd()];
        descriptors.extend(self.retained.as_ref().map(AsFd::as_fd));
        if let Some(keys) = &self.keys {
            // Descriptors are numbered without gaps: the keys themselves stand in for retained memory that there is none of.
            while descriptors.len() <= (RELAY_KEYS_FD - CONTROL_FD) as usize {
                descriptors.push(keys.as_fd());
            }
        }
        descriptors.extend(sealed.files());
        descriptors.extend(self.table_file.as_ref().map(AsFd::as_fd));
        descriptors.extend(self.crash_memory.as_ref().map(AsFd::as_fd));
        let granted = Granted {
            program: &self.program,
            channels: &self.channels,
            devices: &self.devices,
            files: &self.files,
            network: self.network,
        };
        let rules = if self.ruled { rules::make(granted)? } else { None };
        self.control.take_in(!condition.is_warm());
        spawn(&Request {
            program: &self.program,
            arguments: &[],
            environment: &[format!("{ENVIRONMENT}={}", page::VERSION), "RUST_BACKTRACE=0".into()],
            descriptors: &descriptors,
            input: None,
            output: None,
            errors: errors.as_fd(),
            group: self.group.as_ref().map(Group::as_fd),
            walls: Walls {
                namespaces: self.namespaces,
                channels: &self.channels,
                filters: self.filters.as_ref(),
                locks: self.locks.as_ref().map(|counter| LockLimit { counter, calls: self.lock_calls() }),
                rules: rules.as_ref().map(AsFd::as_fd),
                entrances: &self.accounts.entrances()?,
                data_limit: self.data_limit,
                file_limit: FILE_LIMIT.max(self.memory_bytes),
                counts: Some(self.counts),
            },
            user: self.user.clone(),
            dies_with_starter: true,
        })
    }

    /// Calls that may set a lock of a byte range.
    fn lock_calls(&self) -> u32 {
        LOCK_CALLS + LOCK_CALLS_OF_A_PORT * self.description.ports.len() as u32
    }

    /// Opens the memories of its sealed channels, its memory blocks and its logbooks, which come behind the other descriptors, and says in the
    /// description where each is. With the number of the descriptor behind them.
    fn hand_over(&self, description: &mut Description) -> io::Result<(Handover, i32)> {
        let others = match self.keys {
            Some(_) => RELAY_KEYS_FD - CONTROL_FD + 1,
            None => 2 + i32::from(self.retained.is_some()),
        };
        let mut handover = Handover::from(CONTROL_FD + others);
        for port in &mut description.ports {
            let end = match port.direction {
                Direction::Source => End::Source,
                Direction::Destination => End::Destination,
            };
            port.sealed = self.sealed.hand(&port.channel, end, &mut handover)?;
        }
        description.memory_blocks = self.memory_blocks.hand(&mut handover)?;
        description.logbooks = self.logbooks.hand(&mut handover)?;
        let free = CONTROL_FD + others + handover.files().count() as i32;
        Ok((handover, free))
    }

    /// Its process is dead: nobody receives what its sealed queues carry.
    pub fn detach(&self) {
        let incarnation = self.incarnation.load(Ordering::Relaxed);
        for port in self.description.ports.iter().filter(|port| port.direction == Direction::Destination) {
            let _ = self.sealed.detach(&port.channel, incarnation); // its source then fills the queue
        }
    }

    /// What the process that was started last has written down of its end, if it has written all of it; and which signal that was.
    pub fn take_crash(&mut self) -> Option<(File, u64)> {
        let signal = self.crash_memory.as_ref()?.signal()?;
        Some((self.crash_memory.take()?.into_file(), signal))
    }

    /// Its process has come to the point of writing down that it ends by a signal.
    #[must_use]
    pub fn has_written_crash(&self) -> bool {
        self.crash_memory.as_ref().and_then(CrashMemory::signal).is_some()
    }

    /// Its program.
    #[must_use]
    pub fn program(&self) -> &Path {
        &self.program
    }

    /// Why the partition's log could not be written, the first time that this was so.
    pub fn take_log_trouble(&self) -> Option<String> {
        self.errors.take_trouble()
    }

    /// Moves a process that has initialised onto its cores. Its priority comes with its first window.
    pub fn admit(&self, process: &Spawned) {
        let (main, others) = self.threads(process);
        for tid in main.iter().chain(&others) {
            let _ = sched::bind(*tid, &self.cores); // it ended meanwhile: found by its descriptor
        }
        self.control.admit(process.pid, &main, &others);
    }

    /// A process that has initialised stands by, on whatever core it is.
    pub fn stand_by(&self, process: &Spawned) {
        let (main, others) = self.threads(process);
        self.control.stand_by(process.pid, &main, &others);
    }

    /// The user that its processes have and nobody else; `None` if others have it too.
    #[must_use]
    pub fn own_user(&self) -> Option<u32> {
        self.user.as_ref().map(|user| user.id).filter(|id| *id != HELPERS)
    }

    /// Takes notice of threads and children that came or went. True: there are some beyond the one thread that closes
    /// windows, for the first time. Whatever they do, from now on they are held between windows.
    #[must_use]
    pub fn finds_company(&self, process: &Spawned) -> bool {
        let (main, others) = self.threads(process);
        self.control.set_threads(&main, &others);
        main.len() + others.len() > 1 && self.control.always_freeze()
    }

    /// The threads of the first process, and all others.
    fn threads(&self, process: &Spawned) -> (Vec<i32>, Vec<i32>) {
        let all = self.group.as_ref().map_or_else(Vec::new, Group::threads);
        if all == [process.pid] {
            return (all, Vec::new());
        }
        let main = sched::threads(process.pid);
        let others = all.into_iter().filter(|tid| !main.contains(tid)).collect();
        (main, others)
    }

    /// Ends whatever runs in the sandbox.
    pub fn kill(&self, process: Option<&Spawned>) {
        if let Some(process) = process {
            let _ = rustix::process::pidfd_send_signal(&process.pidfd, rustix::process::Signal::KILL); // ended already
        }
        if let Some(group) = &self.group {
            group.end_processes();
        }
    }

    /// Processes in the sandbox that the kernel ended so far because the partition had no memory left.
    #[must_use]
    pub fn out_of_memory_kills(&self) -> u64 {
        self.accounts.out_of_memory_kills() + self.group.as_ref().map_or(0, Group::out_of_memory_kills)
    }

    /// Whether its memory is what a start failed for, in words: `kills_before` are the processes that were ended for it before.
    #[must_use]
    pub fn lack_of_memory(&self, kills_before: u64) -> Option<String> {
        let full = self.accounts.has_been_full() || self.group.as_ref().is_some_and(Group::has_been_full);
        lack_of_memory(self.memory_bytes, self.out_of_memory_kills() > kills_before, full)
    }

    /// The last line that the partition's present or last process wrote to its standard error; of a panic, what it was.
    #[must_use]
    pub fn last_words(&self) -> Option<String> {
        last_words(&String::from_utf8_lossy(&self.errors.tail()))
    }
}

/// See [`Sandbox::last_words`].
fn last_words(log: &str) -> Option<String> {
    let lines: Vec<&str> = log.lines().map(str::trim).collect();
    // A panic's words stand below the line with its place, and above a trace of calls that says nothing to most.
    let panic =
        lines.iter().rposition(|line| line.contains("' panicked at ") || line.contains(") panicked at "));
    let is_trace = |lines: &[&str]| lines.contains(&"stack backtrace:");
    let words =
        panic.filter(|place| is_trace(&lines[*place..])).and_then(|place| lines.get(place + 1)).copied();
    let mut last = lines.iter().rev().copied();
    let line = words.or_else(|| last.find(|line| !line.is_empty() && !line.starts_with("note: ")))?;
    Some(line.chars().take(300).collect())
}

/// See [`Sandbox::lack_of_memory`].
fn lack_of_memory(bytes: u64, ended_for_it: bool, full: bool) -> Option<String> {
    let memory = ShowSize(bytes);
    if ended_for_it {
        Some(format!(
            "the kernel ended it because it needs more memory than its {memory} (`memory` in the plan)"
        ))
    } else {
        full.then(|| format!("its {memory} of memory were full, which may be why (`memory` in the plan)"))
    }
}

/// SCHED_FIFO priority of partitions on the virtual clock, see [`virtual_priority`].
const VIRTUAL_PRIORITY: u8 = 1;

/// What partitions run with in their windows on the virtual clock, which last microseconds: whoever is woken runs at once, and the thread that opens
/// windows, which has no priority, finds them done when it looks. `None` where such work could keep that thread from a processor
/// for ever.
#[must_use]
pub fn virtual_priority() -> Option<u8> {
    sched::spares_ordinary_work().then_some(VIRTUAL_PRIORITY)
}

/// What no file that a partition writes exceeds, bytes, unless it was granted more memory than that: channels are files. Standard
/// error is none (see [`crate::error_log`]).
const FILE_LIMIT: u64 = 64 << 20;

/// Memory that a partition may write and not resize: the executive's next look at a page that its partition has cut
/// off would be a bus error.
///
/// # Errors
/// The machine has no memory or no descriptor left.
pub fn shared_memory(name: &str, bytes: u64) -> io::Result<OwnedFd> {
    let file = memfd_create(name, MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING)?;
    ftruncate(&file, bytes)?;
    fcntl_add_seals(&file, SealFlags::SHRINK | SealFlags::GROW | SealFlags::SEAL)?;
    Ok(file)
}

/// Memory for a partition's [`ProcessTable`].
fn process_table(name: &str) -> io::Result<OwnedFd> {
    shared_memory(&format!("{name} processes"), size_of::<ProcessTable>() as u64)
}

fn sealed_text(name: &str, text: &[u8]) -> io::Result<OwnedFd> {
    let file = memfd_create(name, MemfdFlags::CLOEXEC | MemfdFlags::ALLOW_SEALING)?;
    let mut file = File::from(file);
    file.write_all(text)?;
    fcntl_add_seals(&file, SealFlags::WRITE | SealFlags::SHRINK)?;
    Ok(file.into())
}

/// The keys of links one after another, in memory without a name that nobody can change.
fn sealed_keys(keys: &[Key]) -> io::Result<OwnedFd> {
    let bytes: Vec<u8> = keys.iter().flat_map(|key| *key.bytes()).collect();
    sealed_text("keys", &bytes)
}

/// The cores on which a partition has windows, in any schedule.
fn window_cores(plan: &Plan, id: PartitionId) -> Vec<u32> {
    let windows = plan.schedules.iter().flat_map(|schedule| &schedule.windows);
    let mut cores: Vec<u32> =
        windows.filter(|window| window.partition == id).map(|window| window.core).collect();
    cores.sort_unstable();
    cores.dedup();
    cores
}

/// What the filters of a partition let through beside the ordinary.
fn grants(
    partition: &Partition,
    sandbox_config: &SandboxConfig,
    overrides: &BTreeMap<String, serde_json::Value>,
) -> Grants {
    // Without a namespace of their own such objects are everybody's.
    let is_kept_inside =
        |calls: &&SystemCalls| **calls != SystemCalls::IpcObjects || sandbox_config.namespaces.ipc;
    Grants {
        network: partition.network,
        threads: partition.threads > 1,
        devices: devices(partition, overrides).next().is_some(),
        named: partition.system_calls.iter().filter(is_kept_inside).map(|calls| calls.name()).collect(),
    }
}

/// Descriptors of a program, and of each port below iceoryx2, with room to spare.
const DESCRIPTORS: u64 = 256;
const DESCRIPTORS_OF_A_PORT: u64 = 16;
/// Calls that set a lock, of a program and of each port below iceoryx2, which makes one or two, with room to spare.
const LOCK_CALLS: u32 = 256;
const LOCK_CALLS_OF_A_PORT: u32 = 16;
/// Queued signals and POSIX timers of a partition.
const SIGNALS: u64 = 64;
/// Bytes of message queues where the plan grants them.
const QUEUES: u64 = 256 << 10;

/// How many datagram sockets a partition may have, and what they may have received beside its memory, where the controller of
/// version 1 counts them apart, bytes. With what each socket has sent (`net.core.wmem_default`: 208 KiB, and one packet) they are a part
/// of 2 MiB, because the kernel counts in whole pages and lets a socket go over it by one message.
const SOCKETS: (usize, u64) = (MOST_SOCKETS, 640 << 10);
/// The same of a relay: 8 links of two networks each, with two sockets where a network is a group.
const RELAY_SOCKETS: (usize, u64) = (64, 1280 << 10);

/// Datagram sockets of a partition that is no relay.
pub const MOST_SOCKETS: usize = 6;

/// What the kernel may keep for a partition.
fn counts(plan: &Plan, id: PartitionId) -> Counts {
    let partition = &plan[id];
    let memories = plan.memory_blocks_of(id).count() as u64 + partition.logbooks.len() as u64;
    Counts {
        descriptors: DESCRIPTORS + DESCRIPTORS_OF_A_PORT * partition.ports.len() as u64 + memories,
        signals: SIGNALS,
        queues: if partition.system_calls.contains(&SystemCalls::IpcObjects) { QUEUES } else { 0 },
    }
}

/// The devices that a partition may open.
fn devices<'a>(
    partition: &'a Partition,
    overrides: &'a BTreeMap<String, serde_json::Value>,
) -> impl Iterator<Item = &'a str> {
    let attribute = overrides.get("device").and_then(serde_json::Value::as_str);
    // Whatever is granted, a link that leads out of /dev opens nothing there.
    let leads_out = |path: &&str| Path::new(path).canonicalize().is_ok_and(|path| !path.starts_with("/dev"));
    partition.devices.iter().map(String::as_str).chain(attribute).filter(move |path| !leads_out(path))
}

/// The files that a partition's attributes name: whoever says where a file is means it to be read.
fn named_files(partition: &Partition, overrides: &BTreeMap<String, serde_json::Value>) -> Vec<PathBuf> {
    let planned = partition.attributes.values().filter_map(|value| match value {
        Attribute::String(text) => Some(text.as_str()),
        _ => None,
    });
    let texts = planned.chain(overrides.values().filter_map(serde_json::Value::as_str));
    texts.map(PathBuf::from).filter(|path| path.is_file()).collect()
}

/// The groups that own the devices which a partition may open.
fn device_groups(partition: &Partition, overrides: &BTreeMap<String, serde_json::Value>) -> Vec<u32> {
    devices(partition, overrides)
        .filter_map(|path| Path::new(path).metadata().ok().map(|about| about.gid()))
        .filter(|gid| *gid != 0)
        .collect()
}

/// What a partition is told at its start: of which module, on which clock, and below which folder its channels lie.
#[must_use]
pub fn describe(
    plan: &Plan,
    partition: &Partition,
    (module, clock, ports_root): (&str, Clock, &str),
    overrides: &BTreeMap<String, serde_json::Value>,
) -> Description {
    let mut attributes: BTreeMap<String, serde_json::Value> =
        partition.attributes.iter().map(|(name, value)| (name.clone(), json(value))).collect();
    attributes.extend(overrides.iter().map(|(name, value)| (name.clone(), value.clone())));
    Description {
        module: module.to_owned(),
        partition: partition.name.clone(),
        generation: 0,
        standby: false,
        spare: false,
        start_condition: StartCondition::NormalStart,
        clock,
        ports: plan.own_ports(partition).map(|id| describe_port(plan, &plan[id])).collect(),
        attributes,
        schedules: plan.schedules.iter().map(|schedule| schedule.name.clone()).collect(),
        may_set_schedule: partition.may_set_schedule.iter().map(|id| id.index() as u32).collect(),
        error_handler: partition.error_handler,
        processes: process_plan(partition),
        schedule_times: schedule_times(partition),
        process_table: None,
        crash_memory: None,
        planned_processes: planned_processes(partition),
        taken_errors: taken_errors(plan),
        may_align: partition.relay && plan[partition.module].follows.is_some(),
        voted_elsewhere: plan.is_voted_elsewhere(partition),
        retained_bytes: partition.retained_bytes,
        memory_blocks: Vec::new(),
        logbooks: Vec::new(),
        name_services: plan.name_services.clone(),
        ports_root: ports_root.to_owned(),
    }
}

fn process_plan(partition: &Partition) -> ProcessPlan {
    let &bateleur_plan::Processes {
        identifier, period_ns, release_ns, duration_ns, most, stacks_bytes, ..
    } = &partition.processes;
    ProcessPlan { identifier, period_ns, release_ns, duration_ns, most, stacks_bytes }
}

fn schedule_times(partition: &Partition) -> BTreeMap<u32, PartitionTimes> {
    let of = |(schedule, times): (&usize, &bateleur_plan::Times)| {
        let &bateleur_plan::Times { period_ns, release_ns, duration_ns } = times;
        (*schedule as u32, PartitionTimes { period_ns, release_ns, duration_ns })
    };
    partition.processes.in_schedules.iter().map(of).collect()
}

fn planned_processes(partition: &Partition) -> Vec<PlannedProcess> {
    let planned = |process: &bateleur_plan::Process| PlannedProcess {
        name: process.name.clone(),
        priority: process.priority,
        period_ns: process.period_ns,
        deadline_ns: process.deadline_ns,
    };
    partition.processes.declared.iter().map(planned).collect()
}

/// The errors of processes that the table of levels does not leave to an error handler of theirs. That of one which ends the
/// partition's process where nobody handles it is the partition's by default: it is the handler's unless the file makes it the module's.
fn taken_errors(plan: &Plan) -> Vec<String> {
    let is_taken = |error: &&PartitionError| match plan.health.levels.level(**error, PartitionState::Normal) {
        ErrorLevel::Process => false,
        ErrorLevel::Partition => leaves_the_process(**error),
        ErrorLevel::Module => true,
    };
    PartitionError::ALL.iter().filter(is_taken).map(|error| error.name().to_owned()).collect()
}

fn json(attribute: &Attribute) -> serde_json::Value {
    match attribute {
        Attribute::String(text) => text.clone().into(),
        Attribute::Integer(number) => (*number).into(),
        Attribute::Float(number) => (*number).into(),
        Attribute::Boolean(value) => (*value).into(),
        Attribute::Array(list) => list.iter().map(json).collect(),
    }
}

fn describe_port(plan: &Plan, port: &Port) -> PortDescription {
    let channel = port.channel.map(|id| &plan[id]);
    let own_depth = match port.role {
        Role::QueuingDestination { depth } => depth,
        _ => 0,
    };
    let (direction, kind, refresh_ns) = match port.role {
        Role::SamplingSource => (Direction::Source, PortKind::Sampling, 0),
        Role::SamplingDestination { refresh_ns } => (Direction::Destination, PortKind::Sampling, refresh_ns),
        Role::QueuingSource => (Direction::Source, PortKind::Queuing, 0),
        Role::QueuingDestination { .. } => (Direction::Destination, PortKind::Queuing, 0),
    };
    PortDescription {
        name: port.name.clone(),
        direction,
        kind,
        message: message_name(port),
        size: channel
            .map_or(port.payload.max_size_bytes(), |channel| plan[channel.source].payload.max_size_bytes())
            as u32,
        layout: match &port.payload {
            bateleur_plan::Payload::Message { layout, .. } => *layout,
            bateleur_plan::Payload::Bytes { .. } => 0,
        },
        definition: plan.messages.get(&message_name(port)).cloned().unwrap_or_default(),
        channel: channel.map_or_else(String::new, |channel| plan.port_path(channel.source)),
        sealed: None,
        refresh_ns,
        depth: channel.map_or(own_depth, |channel| plan.queue_depth(channel).unwrap_or(0)),
        optional: port.optional,
    }
}

/// The directories of the channels that a partition is attached to, each once.
#[must_use]
pub fn shared_channels(plan: &Plan, id: PartitionId) -> Vec<String> {
    let channels = plan.own_ports(&plan[id]).filter_map(|port| plan[port].channel);
    let shared = channels.map(|id| &plan[id]).filter(|channel| !channel.isolation.is_sealed());
    let mut homes: Vec<String> = shared.map(|channel| plan.port_path(channel.source)).collect();
    homes.sort_unstable();
    homes.dedup();
    homes
}

/// The message type's name; [`PLAIN_BYTES`] where the plan gives a size alone.
#[must_use]
pub fn message_name(port: &Port) -> String {
    match &port.payload {
        bateleur_plan::Payload::Message { name, .. } => name.clone(),
        bateleur_plan::Payload::Bytes { .. } => PLAIN_BYTES.into(),
    }
}

#[cfg(test)]
mod tests {
    use std::io::{Read, Seek};

    use super::*;

    #[test]
    fn every_family_of_calls_that_a_plan_may_name_has_a_filter_and_no_other() {
        let words: Vec<_> = SystemCalls::ALL.iter().map(|calls| calls.name()).collect();
        assert_eq!(bateleur_system::filter::grantable().collect::<Vec<_>>(), words);
    }

    #[test]
    fn last_words_of_a_panic_are_its_own_and_not_the_last_frame_of_its_trace() {
        let trace: String = (0..200).map(|frame| format!("  {frame}:   0x0 - <unknown>\n")).collect();
        let log = format!(
            "ready\nthread 'main' (7) panicked at src/lib.rs:3:5:\nrange end 9 out of 4\nstack backtrace:\n{trace}"
        );
        assert!(log.len() < crate::error_log::TAIL);
        assert_eq!(last_words(&log).as_deref(), Some("range end 9 out of 4"));
        assert_eq!(
            last_words("thread 'main' panicked at a.rs:1:1:\nno\nnote: run with\n").as_deref(),
            Some("no")
        );
        assert_eq!(last_words("one\n\ntwo\n").as_deref(), Some("two"));
    }

    #[test]
    fn a_partition_can_not_cut_off_the_page_that_the_executive_reads() {
        let page = shared_memory("page", 4096).unwrap();
        assert_eq!(ftruncate(&page, 0), Err(rustix::io::Errno::PERM));
        assert_eq!(fcntl_add_seals(&page, SealFlags::WRITE), Err(rustix::io::Errno::PERM));
    }

    #[test]
    fn a_start_that_failed_for_want_of_memory_is_said_to_have() {
        let said = |ended, full| lack_of_memory(1 << 20, ended, full);
        assert!(said(true, true).unwrap().contains("more memory than its 1MiB"));
        assert!(said(false, true).unwrap().contains("1MiB of memory were full"));
        assert_eq!(said(false, false), None, "it failed for something else");
    }

    #[test]
    fn a_cold_start_finds_retained_memory_of_zeros_in_its_old_size() {
        let retained = File::from(shared_memory("retained", 8192).unwrap());
        (&retained).write_all(&[7; 8192]).unwrap();
        let hole = FallocateFlags::PUNCH_HOLE | FallocateFlags::KEEP_SIZE;
        fallocate(&retained, hole, 0, 8192).unwrap();
        let mut found = Vec::new();
        (&retained).rewind().unwrap();
        (&retained).read_to_end(&mut found).unwrap();
        assert_eq!(found, [0; 8192]);
    }
}
