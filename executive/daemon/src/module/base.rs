//! What a run has outside its output folder, and the helper processes that serve it.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::sync::Arc;

use bateleur_contract::Clock;
use rustix::fs::{MemfdFlags, memfd_create};
use rustix::process::{Pid, setpriority_process};

use super::course::Course;
use super::{Options, RunError, machine};
use crate::playing::Player;
use crate::recording::{Recorder, Recording, StartRecorder};
use bateleur_control::{Inbox, Server};
use bateleur_host::error_log::ErrorLogs;
use bateleur_host::helper::crash::{self, CrashFiles, CrashOrder};
use bateleur_host::helper::orders::{Cleaning, Dead, Order, OrderedChannel};
use bateleur_host::helper::playing::{OPERATORS, PlayerOrder};
use bateleur_host::helper::recording::RecorderOrder;
use bateleur_host::helper::{PARENT, end_helper};
use bateleur_host::instance::{Alive, Instance};
use bateleur_host::logbooks::LogbookMemories;
use bateleur_host::machine::Machine;
use bateleur_host::memory_blocks::MemoryBlocks;
use bateleur_host::partition::{Sandbox, SandboxConfig, message_name};
use bateleur_host::programs::beside_own;
use bateleur_host::sealed::{End, Handover, SealedChannels};
use bateleur_monitor::cleanup::CleanupOrder;
use bateleur_monitor::event::Event;
use bateleur_monitor::observers::{MOST_PUBLISHERS, StartObserver, Work};
use bateleur_monitor::planned::STANDBY;
use bateleur_monitor::run_order::Play;
use bateleur_monitor::{CrashReporter, StartChannelCleaner};
use bateleur_plan::{ModuleView, PartitionId, Plan, PortId};
use bateleur_system::account::Accounts;
use bateleur_system::cgroup::Group;
use bateleur_system::filter::{Filters, Grants};
use bateleur_system::handed_over::copy_of_inherited;
use bateleur_system::lock_calls::LockCounter;
use bateleur_system::rules::{self, Granted};
use bateleur_system::spawn::{Request, Spawned, User, Walls, spawn};
use bateleur_system::tree::NotRemoved;
use bateleur_system::users::{self, Users};
use bateleur_system::wait::{ended, is_readable};

/// The programs of helpers.
#[derive(Debug, Clone)]
struct HelperPrograms {
    /// The executive's own: what must be root.
    own: PathBuf,
    /// What touches channels.
    channels: PathBuf,
    /// What knows the messages too: recorder and observers.
    observers: PathBuf,
}

/// What a helper process finds at its first descriptors.
#[derive(Default)]
pub(super) struct Lines<'a> {
    pub(super) input: Option<&'a OwnedFd>,
    pub(super) output: Option<&'a OwnedFd>,
    pub(super) files: &'a [BorrowedFd<'a>],
}

/// Ends of a channel beside the one of the plan: a partition with a standby has that, and for a while a dead process that
/// is not yet cleaned up after.
fn spare(plan: &Plan, port: PortId) -> usize {
    let owner: PartitionId = plan[port].partition;
    if plan[owner].standby.is_some() { 2 } else { 0 }
}

/// The file of port messages: one that is closed can not be gone on with, so each start has its own.
pub(super) fn port_log(path: &Path, resets: u32) -> PathBuf {
    match resets {
        0 => path.to_owned(),
        resets => path.with_extension(format!("reset-{resets}.mcap")),
    }
}

/// The file of a part of the port log: the recorder before may have left the one before in the middle of a record.
fn part_of(path: &Path, part: u32) -> PathBuf {
    match part {
        0 => path.to_owned(),
        part => path.with_extension(format!("part-{part}.mcap")),
    }
}

/// Parts and resets of an earlier run in the same folder do not belong to this log.
pub(super) fn remove_earlier(path: &Path) {
    let is_removed = |path: &PathBuf| std::fs::remove_file(path).is_ok();
    let resets = (1..).map(|resets| port_log(path, resets)).take_while(is_removed);
    for start in std::iter::once(path.to_owned()).chain(resets) {
        (1..).map(|part| part_of(&start, part)).take_while(is_removed).for_each(drop);
    }
}

/// The number of a helper's first descriptor behind the standard ones.
const FIRST_FILE: i32 = 3;
/// The same behind the recorder's log, its place, and the message types.
const RECORDERS_FILES: i32 = FIRST_FILE + 3;
/// The same behind a player's messages.
const PLAYERS_FILES: i32 = FIRST_FILE + 1;

/// Bytes of data that the reader of a crash memory may have: line tables of large programs take some hundred MiB.
const CRASH_REPORTER_MEMORY: u64 = 2 << 30;

/// Opens the sealed channels of an order for whoever is at that end, and says in the order where each is.
fn hand_over(
    mut order: Order,
    end: End,
    sealed: &SealedChannels,
    handover: &mut Handover,
) -> std::io::Result<Order> {
    for channel in &mut order.channels {
        channel.sealed = sealed.hand(&channel.name, end, handover)?;
    }
    Ok(order)
}

/// What partitions are handed beside their ports' channels.
pub(super) type Memories = (ErrorLogs, Arc<SealedChannels>, Arc<MemoryBlocks>, Arc<LogbookMemories>);

/// As what a helper is started.
struct Footing<'a> {
    user: Option<User>,
    walls: Walls<'a>,
    /// It outlives the run, outside of its groups.
    is_guard: bool,
}

/// What a run has outside its output folder, and the processes that serve it.
pub(super) struct Base {
    pub(super) instance: Instance,
    /// Dropped only when the run has cleaned up after itself.
    _alive: Option<Alive>,
    group: Option<Group>,
    accounts: Accounts,
    /// All helpers but the guard are in it; `None` if there are no groups.
    helpers_group: Option<Rc<Group>>,
    /// Those that were started, as long as they live.
    helpers: Rc<RefCell<Vec<Spawned>>>,
    /// Those among them that nobody waits for.
    removers: Rc<RefCell<Vec<Spawned>>>,
    programs: HelperPrograms,
    log: File,
    /// The guard, and the pipe whose end tells it that the executive is gone.
    guard: RefCell<Option<(Spawned, File)>>,
    pub(super) users: Option<Users>,
}

/// The helpers' group inside the module's. No name of a partition has a dot.
const HELPERS_GROUP: &str = "bateleur.helpers";

impl Base {
    /// `goes_on`: the helpers' log of a start before is gone on with.
    pub(super) fn make(
        (module, clock, supervised): (&str, Clock, bool),
        facts: &Machine,
        logs: &Path,
        goes_on: bool,
    ) -> Result<Self, RunError> {
        let cores = match clock {
            Clock::Wall => facts.partitioned_cores(),
            Clock::Virtual => Vec::new(),
        };
        let users = facts.users.and_then(|users| users.partitions);
        let (mut instance, alive) = Instance::create(module, cores, users)
            .map_err(machine("cannot make the module's directory in /dev/shm"))?;
        instance.supervised = supervised;
        let made = Self::furnish((instance.clone(), alive), facts, logs, goes_on);
        if made.is_err() {
            let _ = instance.clean_up(); // the next start tries again
        }
        made
    }

    fn furnish(
        (mut instance, alive): (Instance, Alive),
        facts: &Machine,
        logs: &Path,
        goes_on: bool,
    ) -> Result<Self, RunError> {
        let group = facts.make_group(&instance.name);
        let helpers_group = group.as_ref().map(|group| group.child(HELPERS_GROUP)).transpose();
        let helpers_group = helpers_group.map_err(machine("no control group for the helpers"))?.map(Rc::new);
        let accounts = Accounts::beside_self(&instance.name);
        instance
            .set_groups(group.as_ref().map(bateleur_system::cgroup::Group::path), accounts.paths())
            .map_err(machine("cannot note the control groups"))?;
        let path = logs.join("helpers.log");
        if !goes_on {
            File::create(&path).map_err(machine("cannot write the helpers' log"))?;
        }
        let log = OpenOptions::new()
            .create(true)
            .append(true)
            .open(path)
            .map_err(machine("cannot write the helpers' log"))?;
        let programs = HelperPrograms {
            own: std::env::current_exe().map_err(machine("cannot find the executive's own program"))?,
            channels: beside_own("bateleur_channels"),
            observers: beside_own("bateleur"),
        };
        let base = Self {
            instance,
            _alive: Some(alive),
            group,
            accounts,
            helpers_group,
            helpers: Rc::default(),
            removers: Rc::default(),
            programs,
            log,
            guard: RefCell::new(None),
            users: facts.users,
        };
        base.start_guard()?;
        Ok(base)
    }

    fn start_guard(&self) -> Result<(), RunError> {
        let (reader, writer) = std::io::pipe().map_err(machine("cannot make a pipe"))?;
        let (reader, writer) = (OwnedFd::from(reader), File::from(OwnedFd::from(writer)));
        let text = serde_json::to_string(&self.instance).unwrap_or_default();
        let lines = Lines { input: Some(&reader), ..Lines::default() };
        let footing = Footing { user: None, walls: Walls::default(), is_guard: true };
        let guard = self
            .start(&self.programs.own, &["guard".into(), text], lines, footing)
            .map_err(machine("cannot start the guard"))?;
        *self.guard.borrow_mut() = Some((guard, writer));
        Ok(())
    }

    /// Starts a helper that touches channels, as the helpers' user.
    pub(super) fn helper(&self, arguments: &[String], lines: Lines<'_>) -> std::io::Result<Spawned> {
        let user = self.users.map(|_| Users::helper());
        self.helper_of_run(&self.programs.channels, arguments, lines, user, Walls::default())
    }

    /// Starts a helper that knows the messages, as the helpers' user.
    fn observing_helper(&self, arguments: &[String], lines: Lines<'_>) -> std::io::Result<Spawned> {
        let user = self.users.map(|_| Users::helper());
        self.helper_of_run(&self.programs.observers, arguments, lines, user, Walls::default())
    }

    /// Root of the module's shared memory.
    fn ports_root(&self) -> String {
        self.instance.ports_root().to_string_lossy().into_owned()
    }

    /// Starts a helper that does not outlive the run.
    fn helper_of_run(
        &self,
        program: &Path,
        arguments: &[String],
        lines: Lines<'_>,
        user: Option<User>,
        walls: Walls<'_>,
    ) -> std::io::Result<Spawned> {
        let process = self.start(program, arguments, lines, Footing { user, walls, is_guard: false })?;
        let mut helpers = self.helpers.borrow_mut();
        helpers.retain(|helper| !is_readable(helper.pidfd.as_fd()));
        helpers.push(Spawned { pid: process.pid, pidfd: process.pidfd.try_clone()? });
        Ok(process)
    }

    /// Starts a program as a helper.
    fn start(
        &self,
        program: &Path,
        arguments: &[String],
        lines: Lines<'_>,
        footing: Footing<'_>,
    ) -> std::io::Result<Spawned> {
        let Footing { user, walls, is_guard } = footing;
        spawn(&Request {
            program,
            arguments,
            environment: &[format!("{PARENT}={}", std::process::id())],
            descriptors: lines.files,
            input: lines.input.map(AsFd::as_fd),
            output: lines.output.map(AsFd::as_fd),
            errors: self.log.as_fd(),
            group: self.helpers_group.as_ref().filter(|_| !is_guard).map(|group| group.as_fd()),
            walls,
            user,
            dies_with_starter: !is_guard,
        })
    }

    pub(super) fn order(&self, view: &ModuleView<'_>) -> Order {
        let plan = view.plan();
        let channels = view.channels().map(|id| {
            let channel = &plan[id];
            OrderedChannel {
                name: plan.port_path(channel.source),
                source: plan.port_path(channel.source),
                message: message_name(&plan[channel.source]),
                size: plan[channel.source].payload.max_size_bytes(),
                depth: plan.queue_depth(channel).map(|depth| depth as usize),
                destinations: channel.destinations.len(),
                spare_writers: match plan[channel.source].operator {
                    false => spare(plan, channel.source),
                    true => MOST_PUBLISHERS,
                },
                spare_readers: channel.destinations.iter().map(|port| spare(plan, *port)).sum(),
                sealed: None,
            }
        });
        Order { root: self.ports_root(), channels: channels.collect() }
    }

    /// Makes the directories of channels anew, and has what they held removed.
    pub(super) fn remake(&self, channels: &[String]) -> std::io::Result<()> {
        let aside = self.instance.remake_channel_directories(channels, self.users)?;
        let mut arguments = vec!["remover".into()];
        arguments.extend(aside.iter().map(|path| path.display().to_string()));
        // As the executive, who owns what holds it. Without a remover it stays until the run ends.
        if let Ok(remover) =
            self.helper_of_run(&self.programs.own, &arguments, Lines::default(), None, Walls::default())
        {
            let mut removers = self.removers.borrow_mut();
            removers.retain(|remover| ended(remover).is_none());
            removers.push(remover);
        }
        Ok(())
    }

    /// Starts the log of all ports.
    pub(super) fn record(
        &self,
        path: PathBuf,
        order: &Order,
        types: &BTreeMap<String, String>,
        sealed: Arc<SealedChannels>,
    ) -> Result<Recording, RunError> {
        remove_earlier(&path);
        let channels = order.channels.iter().map(|channel| channel.name.clone()).collect();
        let (copy, order, types) = (self.copy()?, order.clone(), types.clone());
        let folder = path.parent().filter(|folder| *folder != Path::new("")).unwrap_or(Path::new("."));
        let folder = folder.to_owned();
        let start: StartRecorder = Box::new(move |part, without| {
            copy.start_recorder(&path, (&order, &types, &sealed), part, without)
        });
        Recording::begin(start, channels, folder)
            .map_err(machine("cannot start the recorder (see partitions/helpers.log)"))
    }

    /// Starts the recorder of a part of the log. It runs as the partitions' user and is handed the file, whose folder it may
    /// not enter, memory in which it says what it is at, and the texts of the message types.
    fn start_recorder(
        &self,
        path: &Path,
        (order, types, sealed): (&Order, &BTreeMap<String, String>, &SealedChannels),
        part: u32,
        without: &[String],
    ) -> std::io::Result<Recorder> {
        let mut handover = Handover::from(RECORDERS_FILES);
        let order = hand_over(order.clone(), End::Observer, sealed, &mut handover)?;
        let order = RecorderOrder { order, without: without.to_vec(), part };
        let arguments = ["recorder".into(), serde_json::to_string(&order)?];
        let path = part_of(path, part);
        let log = File::create(&path).map_err(|error| {
            std::io::Error::new(error.kind(), format!("cannot write {}: {error}", path.display()))
        })?;
        let place = File::from(memfd_create("recorder's place", MemfdFlags::CLOEXEC)?);
        place.set_len(size_of::<u32>() as u64)?;
        // As a file: an argument may be too short for the texts of many types.
        let mut texts = File::from(memfd_create("message types", MemfdFlags::CLOEXEC)?);
        texts.write_all(&serde_json::to_vec(types)?)?;
        for file in [&log, &place, &texts] {
            let owner = self.users.map(|_| users::HELPERS);
            std::os::unix::fs::fchown(file, owner, owner)?;
        }
        let place = OwnedFd::from(place);
        Recorder::start(&place, |input, output| {
            let own = [log.as_fd(), place.as_fd(), texts.as_fd()];
            let files: Vec<BorrowedFd<'_>> = own.into_iter().chain(handover.files()).collect();
            let lines = Lines { input: Some(input), output: Some(output), files: &files };
            self.observing_helper(&arguments, lines)
        })
    }

    /// Starts the player of a recording, which is the source of some channels. Messages before `from_ns` were played before a reset.
    pub(super) fn play(
        &self,
        plan: &Plan,
        order: &Order,
        play: &Play,
        sealed: &SealedChannels,
        from_ns: u64,
    ) -> Result<Player, RunError> {
        let mut groups = BTreeMap::new();
        let played = plan.partitions.iter().enumerate().filter(|(_, partition)| partition.played);
        for ((place, _), group) in played.zip(OPERATORS + 1..) {
            groups.insert(place, group);
        }
        let group = |channel: &OrderedChannel| {
            let owner = channel.source.split_once('.').and_then(|(owner, _)| plan.partition(owner));
            owner.and_then(|owner| groups.get(&owner.index())).copied().unwrap_or(OPERATORS)
        };
        let channel = |port: &String| {
            let known = order.channels.iter().find(|channel| channel.source == *port);
            known.cloned().ok_or_else(|| RunError::Start(format!("the module has no source port {port}")))
        };
        let channels = play.ports.iter().map(channel).collect::<Result<Vec<_>, _>>()?;
        let order = PlayerOrder {
            groups: channels.iter().map(group).collect(),
            order: Order { root: order.root.clone(), channels },
            from_ns,
        };
        let what = "cannot start the player of the recording (see partitions/helpers.log)";
        let messages = copy_of_inherited(play.messages_fd)
            .map_err(|error| machine(what)(std::io::Error::other(error)))?;
        Player::start(groups, |input, output| {
            let mut handover = Handover::from(PLAYERS_FILES);
            let order = PlayerOrder {
                order: hand_over(order.order.clone(), End::Source, sealed, &mut handover)?,
                ..order
            };
            let arguments = ["player".into(), serde_json::to_string(&order)?];
            let files: Vec<BorrowedFd<'_>> = [messages.as_fd()].into_iter().chain(handover.files()).collect();
            let lines = Lines { input: Some(input), output: Some(output), files: &files };
            self.observing_helper(&arguments, lines)
        })
        .map_err(machine(what))
    }

    /// How a channel cleaner is started.
    pub(super) fn channel_cleaner_starter(&self, ruled: bool) -> Result<StartChannelCleaner, RunError> {
        let copy = self.copy()?;
        Ok(Box::new(move |order| copy.start_channel_cleaner(order, ruled)))
    }

    /// Enough of it to start helpers.
    pub(super) fn copy(&self) -> Result<Self, RunError> {
        Ok(Self {
            instance: self.instance.clone(),
            _alive: None,
            group: None,
            accounts: Accounts::default(),
            helpers_group: self.helpers_group.clone(),
            helpers: self.helpers.clone(),
            removers: self.removers.clone(),
            programs: self.programs.clone(),
            log: self.log.try_clone().map_err(machine("cannot copy a descriptor"))?,
            guard: RefCell::new(None),
            users: self.users,
        })
    }

    /// How observers and publishers are started: each is told of its own channels only.
    pub(super) fn observer_starter(
        &self,
        order: Order,
        sealed: Arc<SealedChannels>,
    ) -> Result<StartObserver, RunError> {
        let copy = self.copy()?;
        Ok(Box::new(move |work, connection| {
            let (verb, channels, end) = match work {
                Work::Watch(channels) => ("observer", channels, End::Observer),
                Work::Publish { channels, .. } => ("publisher", channels, End::Source),
            };
            let wanted = |channel: &&OrderedChannel| channels.contains(&channel.source);
            let channels = order.channels.iter().filter(wanted).cloned().collect();
            let mut handover = Handover::from(FIRST_FILE);
            let order = hand_over(Order { channels, ..order.clone() }, end, &sealed, &mut handover)?;
            let order = serde_json::to_string(&order)?;
            let files: Vec<BorrowedFd<'_>> = handover.files().collect();
            let lines = Lines { output: Some(connection), files: &files, ..Lines::default() };
            let mut words = vec![verb.into(), order];
            if let Work::Publish { origin_ns, lingers_ns, .. } = work {
                words.extend([origin_ns.to_string(), lingers_ns.to_string()]);
            }
            copy.observing_helper(&words, lines)
        }))
    }

    /// Starts a channel cleaner. What the dead one has written tells the library where to clean up: so it reaches the dead one's channels and
    /// nothing else, where the kernel has rules about files.
    fn start_channel_cleaner(&self, order: &CleanupOrder, ruled: bool) -> std::io::Result<(Spawned, File)> {
        // A channel that another module serves has nothing here.
        let here = |channel: &&String| self.instance.channel_directory(channel).symlink_metadata().is_ok();
        let channels: Vec<String> = order.channels.iter().filter(here).cloned().collect();
        let directories: Vec<PathBuf> =
            channels.iter().map(|channel| self.instance.channel_directory(channel)).collect();
        let cleaning = Cleaning {
            root: self.ports_root(),
            dead: Dead { pid: order.pid.unsigned_abs(), user: order.user },
            channels,
            damaged: order.damaged.clone(),
        };
        let (progress, end) = std::io::pipe()?;
        rustix::fs::fcntl_setfl(&progress, rustix::fs::OFlags::NONBLOCK)?; // nobody waits for one that does not end
        let end = OwnedFd::from(end);
        let (program, channels) = (&*self.programs.channels, &*directories);
        let granted = Granted { program, channels, devices: &[], files: &[], network: false };
        let rules = if ruled { rules::make(granted)? } else { None };
        let walls = Walls { rules: rules.as_ref().map(AsFd::as_fd), ..Walls::default() };
        let lines = Lines { output: Some(&end), ..Lines::default() };
        // As the dead one, of which nothing lives: what is its own it may remove, whatever its modes.
        let of_helpers = self.users.map(|_| Users::helper());
        let user = of_helpers.map(|helper| User { id: order.user.unwrap_or(helper.id), ..helper });
        let words = ["channel-cleaner".into(), serde_json::to_string(&cleaning)?];
        let process = self.helper_of_run(&self.programs.channels, &words, lines, user, walls)?;
        Ok((process, File::from(OwnedFd::from(progress))))
    }

    /// How a helper is started for what a dead process has written down.
    pub(super) fn crash_reporter(&self, run: &Path, facts: &Machine) -> Result<CrashReporter, RunError> {
        let (copy, run) = (self.copy()?, run.to_owned());
        let (ruled, filtered) = (facts.ruled, facts.filtered);
        Ok(CrashReporter {
            make_files: Arc::new(move |order| crash::make_files(&run, order)),
            start: Box::new(move |order, memory, files| {
                copy.start_crash_reporter(order, memory, files, (ruled, filtered))
            }),
        })
    }

    /// It is handed its files, and the program, whose folder it may not be able to enter; of others it reads libraries alone, and it has no
    /// privileges.
    fn start_crash_reporter(
        &self,
        order: &CrashOrder,
        memory: &File,
        CrashFiles { report, dump, program: (program, name) }: &CrashFiles,
        (ruled, filtered): (bool, bool),
    ) -> std::io::Result<Spawned> {
        let order = &CrashOrder { program: name.clone(), ..order.clone() };
        let mut files = vec![memory.as_fd(), report.as_fd(), dump.as_fd()];
        files.extend(program.as_ref().map(AsFd::as_fd));
        let readable = [PathBuf::from(&order.program)];
        let granted = Granted {
            program: &self.programs.observers,
            channels: &[],
            devices: &[],
            files: &readable,
            network: false,
        };
        let rules = if ruled { rules::make(granted)? } else { None };
        let filters = filtered.then(|| Filters::new(&Grants::default())).transpose()?;
        let walls = Walls {
            rules: rules.as_ref().map(AsFd::as_fd),
            filters: filters.as_ref(),
            data_limit: CRASH_REPORTER_MEMORY,
            file_limit: crash::MOST_BYTES,
            ..Walls::default()
        };
        let words = ["crash-reporter".into(), serde_json::to_string(order)?];
        let lines = Lines { files: &files, ..Lines::default() };
        let user = self.users.map(|_| Users::helper());
        let process = self.helper_of_run(&self.programs.observers, &words, lines, user, walls)?;
        let lowest = Pid::from_raw(process.pid).map(|pid| setpriority_process(Some(pid), 19));
        let _ = lowest.transpose(); // whoever starts meanwhile waits for it
        Ok(process)
    }

    /// A module flies without its control socket too, and says so.
    pub(super) fn open_control(&self, module: &str, course: &mut Course) -> (Option<Server>, Option<Inbox>) {
        match Server::open(&self.instance.directory()) {
            Ok((server, inbox)) => (Some(server), Some(inbox)),
            Err(error) => {
                let text = format!("no control socket, so `bateleur ps` and orders do not reach it: {error}");
                course.tell(&Event::Message { time_s: 0.0, partition: module.to_owned(), text });
                (None, None)
            }
        }
    }

    pub(super) fn sandboxes(
        &self,
        plan: &Plan,
        view: &ModuleView<'_>,
        options: &Options,
        facts: &Machine,
        programs: Vec<PathBuf>,
        (errors, sealed, memory_blocks, logbooks): Memories,
    ) -> Result<Vec<Sandbox>, RunError> {
        let locks = facts
            .counts_locks
            .then(LockCounter::start)
            .transpose()
            .map_err(machine("cannot count the partitions' locks"))?;
        let sandbox_config = SandboxConfig {
            module: options.order.module.clone(),
            clock: options.order.clock(),
            ports_root: self.ports_root(),
            namespaces: facts.namespaces,
            users: facts.users,
            filtered: facts.filtered,
            locks,
            ruled: facts.ruled,
            real_time: facts.real_time,
            errors,
            link_keys: options.link_keys.clone(),
            retained: options.supervision.as_ref().map_or_else(BTreeMap::new, |kept| kept.retained.clone()),
            memory_blocks,
            logbooks,
            sealed,
        };
        let built = view.partitions().zip(programs).map(|(id, program)| {
            let name = &plan[id].name;
            let all = options.order.overrides.iter();
            let overrides =
                all.filter(|(of, _)| plan.takes_settings_of(id, of)).flat_map(|(_, set)| set.clone());
            let overrides: BTreeMap<_, _> = overrides.collect();
            let build = |groups: &str, beside: Option<&Sandbox>| {
                let mut sandbox = Sandbox::build(
                    plan,
                    id,
                    program.clone(),
                    self.groups(groups)?,
                    &sandbox_config,
                    &overrides,
                    beside,
                )
                .map_err(machine(format!("cannot prepare partition {name}")))?;
                sandbox.translate_cores(|core| facts.real_core(core));
                Ok::<_, RunError>(sandbox)
            };
            let mut sandbox = build(name, None)?;
            if plan[id].standby.is_some() {
                // No name of a partition has a dot.
                sandbox.standby = Some(Box::new(build(&format!("{name}{STANDBY}"), Some(&sandbox))?));
            }
            Ok(sandbox)
        });
        built.collect()
    }

    /// Control groups inside the module's.
    fn groups(&self, name: &str) -> Result<(Option<Group>, Accounts), RunError> {
        let group = self.group.as_ref().map(|group| group.child(name)).transpose();
        let group = group.map_err(machine(format!("no control group for {name}")))?;
        let accounts = self.accounts.child(name).map_err(machine(format!("no control groups for {name}")))?;
        Ok((group, accounts))
    }

    /// Ends all helpers, then removes everything, then ends the guard.
    ///
    /// # Errors
    /// What could not be removed.
    pub(super) fn leave(mut self) -> Result<(), NotRemoved> {
        // Before anything is removed: a helper may make anew what it misses.
        self.helpers.take().iter().for_each(end_helper);
        drop(self.helpers_group.take());
        drop(self.group.take());
        drop(std::mem::take(&mut self.accounts));
        let removed = self.instance.clean_up();
        if let Some((guard, line)) = self.guard.borrow_mut().take() {
            end_helper(&guard); // also one that somebody has stopped; it has nothing left to do
            drop(line);
        }
        removed
    }
}
