//! What a run has outside its output folder, and the helper processes that serve it.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{Read, Write};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};
use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::rc::Rc;
use std::sync::Arc;

use bateleur_contract::Clock;
use rustix::fs::{MemfdFlags, memfd_create};

use super::conduct::Staff;
use super::course::{Course, Ended};
use super::{Options, RunError, machine};
use crate::control::{Inbox, Server};
use crate::event::Event;
use crate::helper::custodian::{self, Order, OrderedChannel};
use crate::helper::examiner;
use crate::helper::guard::FAREWELL;
use crate::instance::{Alive, Instance};
use crate::machine::Machine;
use crate::monitor::StartJanitor;
use crate::monitor::burial::{Burial, Fallen};
use crate::monitor::observers::StartObserver;
use crate::monitor::renewal::{Means, NotHeld};
use crate::partition::{Cage, Housing, is_readable, message_name, queue_depth};
use crate::plan::{ModuleView, PartitionId, Plan, PortId};
use crate::planned::STANDBY;
use crate::recording::{Recorder, RecorderOrder, Recording, StartRecorder, part_name};
use crate::system::account::Accounts;
use crate::system::cgroup::Group;
use crate::system::spawn::{Request, Spawned, User, Walls, spawn};
use crate::system::time::now_ns;

/// How long the custodian may take to create every channel.
const CUSTODIAN_PATIENCE_NS: u64 = 10_000_000_000;

/// As above while the module runs: the monitor waits for it.
const NEXT_CUSTODIAN_PATIENCE_NS: u64 = 3_000_000_000;

/// What a helper process finds at its first descriptors.
#[derive(Default)]
struct Lines<'a> {
    input: Option<&'a OwnedFd>,
    output: Option<&'a OwnedFd>,
    files: &'a [BorrowedFd<'a>],
}

/// The custodian, and the line whose end tells it to leave.
pub(super) struct Custodian {
    process: Spawned,
    line: Option<File>,
    /// It has held every channel.
    was_ready: bool,
    end: Option<ExitStatus>,
    fallen: Fallen,
}

impl Drop for Custodian {
    /// One that memory has ended left something in every channel. It is replaced by one that holds them, so that it can be buried.
    fn drop(&mut self) {
        if self.was_ready && self.end.is_some_and(|status| !status.success()) {
            self.fallen.borrow_mut().push(self.process.pid);
        }
    }
}

impl Custodian {
    pub(super) fn leave(&mut self) {
        drop(self.line.take());
        self.await_end();
    }

    /// Whether it holds the channels no more.
    fn has_left(&mut self) -> bool {
        self.look();
        self.line.is_none() || self.end.is_some()
    }

    /// As above; one that does not, because what it holds is damaged, is ended.
    fn leave_or_die(&mut self) {
        self.leave();
        if self.end.is_none() {
            let _ = rustix::process::pidfd_send_signal(&self.process.pidfd, rustix::process::Signal::KILL); // it has left
            self.await_end();
        }
    }

    /// Waits for it, once it was asked to end. One that still runs dies with the executive.
    fn await_end(&mut self) {
        crate::partition::await_any_end(&[self.process.pidfd.as_fd()], 1_000_000_000);
        self.look();
    }

    /// How a process has ended is told only once.
    fn look(&mut self) {
        self.end = self.end.or_else(|| crate::partition::ended(&self.process));
    }
}

/// Ends of a channel beside the one of the plan: a partition with a standby has that, and for a while a dead process that
/// is not yet buried.
fn spare(plan: &Plan, port: PortId) -> usize {
    let owner: PartitionId = plan[port].partition;
    if plan[owner].standby.is_some() { 2 } else { 0 }
}

/// What an examiner is told about a partition's ports.
fn examination(order: &Order, plan: &Plan, partition: PartitionId) -> examiner::Order {
    let ports = plan[partition].ports.iter().filter_map(|id| {
        let source = plan[plan[*id].channel?].source;
        let name = plan.port_path(source);
        let channel = order.channels.iter().find(|channel| channel.name == name)?.clone();
        Some(examiner::OrderedPort { channel, writes: source == *id })
    });
    examiner::Order { root: order.root.clone(), ports: ports.collect() }
}

/// The lines that a custodian says, until it is ready, ends, or has taken too long.
fn words_until_ready(mut answer: &File, patience_ns: u64) -> Vec<String> {
    let limit_ns = now_ns().saturating_add(patience_ns);
    let (mut said, mut piece) = (Vec::new(), [0; 512]);
    loop {
        crate::partition::await_any_end(&[answer.as_fd()], limit_ns.saturating_sub(now_ns()));
        if !is_readable(answer.as_fd()) {
            break;
        }
        match answer.read(&mut piece) {
            Ok(count) if count > 0 => said.extend_from_slice(&piece[..count]),
            _ => break,
        }
        if said.ends_with(b"ready\n") {
            break;
        }
    }
    String::from_utf8_lossy(&said).lines().map(str::to_owned).collect()
}

/// Waits for a helper that was asked to end, and reaps it.
fn await_end(helper: &Spawned) {
    crate::partition::await_any_end(&[helper.pidfd.as_fd()], 1_000_000_000);
    let _ = crate::partition::ended(helper); // one that still runs dies with the executive
}

/// The file of port messages: one that is closed can not be gone on with, so each start has its own.
fn port_log(path: &Path, resets: u32) -> PathBuf {
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
fn remove_earlier(path: &Path) {
    let is_removed = |path: &PathBuf| std::fs::remove_file(path).is_ok();
    let resets = (1..).map(|resets| port_log(path, resets)).take_while(is_removed);
    for start in std::iter::once(path.to_owned()).chain(resets) {
        (1..).map(|part| part_of(&start, part)).take_while(is_removed).for_each(drop);
    }
}

/// What a run has outside its output folder, and the processes that serve it.
pub(super) struct Base {
    instance: Instance,
    /// Dropped only when the run has cleaned up after itself.
    _alive: Option<Alive>,
    group: Option<Group>,
    accounts: Accounts,
    own_program: PathBuf,
    log: File,
    /// The guard, and the pipe whose end tells it that the executive is gone.
    guard: RefCell<Option<(Spawned, File)>>,
    user: Option<u32>,
    fallen: Fallen,
}

impl Base {
    /// `goes_on`: the helpers' log of a start before is gone on with.
    pub(super) fn make(
        (module, clock): (&str, Clock),
        facts: &Machine,
        logs: &Path,
        goes_on: bool,
    ) -> Result<Self, RunError> {
        let cores = match clock {
            Clock::Wall => facts.partitioned_cores(),
            Clock::Virtual => Vec::new(),
        };
        let (instance, alive) = Instance::create(module, cores)
            .map_err(machine("cannot make the module's directory in /dev/shm"))?;
        let made = Self::furnish((instance.clone(), alive), facts, logs, goes_on);
        if made.is_err() {
            instance.clean_up();
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
        let accounts = Accounts::beside_self(&instance.name);
        instance
            .set_groups(group.as_ref().map(crate::system::cgroup::Group::path), accounts.paths())
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
        let own_program =
            std::env::current_exe().map_err(machine("cannot find the executive's own program"))?;
        let base = Self {
            instance,
            _alive: Some(alive),
            group,
            accounts,
            own_program,
            log,
            guard: RefCell::new(None),
            user: facts.user,
            fallen: Fallen::default(),
        };
        base.start_guard()?;
        Ok(base)
    }

    fn start_guard(&self) -> Result<(), RunError> {
        let (reader, writer) = std::io::pipe().map_err(machine("cannot make a pipe"))?;
        let (reader, writer) = (OwnedFd::from(reader), File::from(OwnedFd::from(writer)));
        let text = serde_json::to_string(&self.instance).unwrap_or_default();
        let lines = Lines { input: Some(&reader), ..Lines::default() };
        let guard =
            self.helper(&["guard".into(), text], lines, false).map_err(machine("cannot start the guard"))?;
        *self.guard.borrow_mut() = Some((guard, writer));
        Ok(())
    }

    /// Starts this very program with a hidden verb.
    fn helper(
        &self,
        arguments: &[String],
        lines: Lines<'_>,
        as_partitions: bool,
    ) -> std::io::Result<Spawned> {
        spawn(&Request {
            program: &self.own_program,
            arguments,
            environment: &[],
            descriptors: lines.files,
            input: lines.input.map(AsFd::as_fd),
            output: lines.output.map(AsFd::as_fd),
            errors: self.log.as_fd(),
            group: None,
            walls: Walls::default(),
            user: self.user.filter(|_| as_partitions).map(|id| User { id, groups: Vec::new() }),
            dies_with_starter: as_partitions,
        })
    }

    fn order(&self, view: &ModuleView<'_>) -> Order {
        let plan = view.plan();
        let channels = view.channels().map(|id| {
            let channel = &plan[id];
            OrderedChannel {
                name: plan.port_path(channel.source),
                source: plan.port_path(channel.source),
                message: message_name(&plan[channel.source]),
                size: plan[channel.source].payload.max_size_bytes(),
                depth: queue_depth(plan, channel).map(|depth| depth as usize),
                destinations: channel.destinations.len(),
                spare_writers: spare(plan, channel.source),
                spare_readers: channel.destinations.iter().map(|port| spare(plan, *port)).sum(),
            }
        });
        let domain = self.instance.domain();
        Order { root: domain.root, channels: channels.collect() }
    }

    /// Starts the custodian and waits until every channel is there, at most `patience_ns`.
    fn start_custodian(&self, order: &str, patience_ns: u64) -> Result<Custodian, NotHeld> {
        let failed = |error: std::io::Error| NotHeld {
            channel: None,
            why: format!("cannot start the custodian: {error}"),
        };
        let (reader, writer) = std::io::pipe().map_err(failed)?;
        let (answer, answers) = std::io::pipe().map_err(failed)?;
        let (reader, answers) = (OwnedFd::from(reader), OwnedFd::from(answers));
        let lines = Lines { input: Some(&reader), output: Some(&answers), ..Lines::default() };
        let process = self.helper(&["custodian".into(), order.into()], lines, true).map_err(failed)?;
        drop(answers);
        let line = Some(File::from(OwnedFd::from(writer)));
        let fallen = self.fallen.clone();
        let mut custodian = Custodian { process, line, was_ready: false, end: None, fallen };
        let said = words_until_ready(&File::from(OwnedFd::from(answer)), patience_ns);
        match said.last() {
            Some(word) if word == custodian::READY => {
                custodian.was_ready = true;
                Ok(custodian)
            }
            last => {
                custodian.leave_or_die();
                let about = last.map_or_else(String::new, |channel| format!(" (at {channel})"));
                let why = format!(
                    "the custodian could not create the module's channels{about}: its reason stands in partitions/helpers.log"
                );
                Err(NotHeld { channel: last.cloned(), why })
            }
        }
    }

    /// Starts the log of all ports.
    fn record(&self, path: PathBuf, order: &Order) -> Result<Recording, RunError> {
        remove_earlier(&path);
        let channels = order.channels.iter().map(|channel| channel.name.clone()).collect();
        let (copy, order) = (self.copy()?, order.clone());
        let start: StartRecorder =
            Box::new(move |part, without| copy.start_recorder(&path, &order, part, without));
        Recording::begin(start, channels)
            .map_err(machine("cannot start the recorder (see partitions/helpers.log)"))
    }

    /// Starts the recorder of a part of the log. It runs as the partitions' user and is handed the file, whose folder it may
    /// not enter, and memory in which it says what it is at.
    fn start_recorder(
        &self,
        path: &Path,
        order: &Order,
        part: u32,
        without: &[String],
    ) -> std::io::Result<Recorder> {
        let order = RecorderOrder { order: order.clone(), without: without.to_vec(), part };
        let arguments = ["recorder".into(), serde_json::to_string(&order)?];
        let path = part_of(path, part);
        let log = File::create(&path).map_err(|error| {
            std::io::Error::new(error.kind(), format!("cannot write {}: {error}", path.display()))
        })?;
        let place = File::from(memfd_create("recorder's place", MemfdFlags::CLOEXEC)?);
        place.set_len(size_of::<u32>() as u64)?;
        for file in [&log, &place] {
            std::os::unix::fs::fchown(file, self.user, self.user)?;
        }
        let place = OwnedFd::from(place);
        Recorder::start(&place, |input, output| {
            let lines =
                Lines { input: Some(input), output: Some(output), files: &[log.as_fd(), place.as_fd()] };
            self.helper(&arguments, lines, true)
        })
    }

    /// How a janitor is started. Without its custodian a restarted partition would not find its channels: so whoever
    /// needs a janitor first sees that the custodian is there.
    fn janitor_starter(
        &self,
        order: String,
        custodian: Rc<RefCell<Custodian>>,
    ) -> Result<StartJanitor, RunError> {
        let copy = self.copy()?;
        Ok(Box::new(move |burial| {
            if custodian.borrow_mut().has_left() {
                // Before any clean-up, which would take away the channels that only the dead one held.
                *custodian.borrow_mut() = copy
                    .start_custodian(&order, NEXT_CUSTODIAN_PATIENCE_NS)
                    .map_err(std::io::Error::other)?;
            }
            copy.start_janitor(burial)
        }))
    }

    /// How a partition's channels are examined, and damaged ones made anew.
    fn renewals(
        &self,
        order: Order,
        plan: Arc<Plan>,
        custodian: Rc<RefCell<Custodian>>,
    ) -> Result<Means, RunError> {
        let (examiner, renewer) = (self.copy()?, self.copy()?);
        let text = serde_json::to_string(&order).unwrap_or_default();
        let examine = move |partition| {
            let (answers, answer_end) = std::io::pipe()?;
            let answer_end = OwnedFd::from(answer_end);
            let order = examination(&order, &plan, partition);
            let lines = Lines { output: Some(&answer_end), ..Lines::default() };
            let process =
                examiner.helper(&["examiner".into(), serde_json::to_string(&order)?], lines, true)?;
            Ok((process, File::from(OwnedFd::from(answers))))
        };
        let renew = move |channels: &[String]| {
            // It holds the others too: whoever is attached to them keeps them while it is being followed.
            custodian.borrow_mut().leave_or_die();
            renewer.instance.empty_channel_directories(channels).map_err(|error| NotHeld {
                channel: None,
                why: format!("cannot empty a channel's directory: {error}"),
            })?;
            *custodian.borrow_mut() = renewer.start_custodian(&text, NEXT_CUSTODIAN_PATIENCE_NS)?;
            Ok(())
        };
        Ok(Means { examine: Box::new(examine), renew: Box::new(renew) })
    }

    /// Enough of it to start helpers.
    fn copy(&self) -> Result<Self, RunError> {
        Ok(Self {
            instance: self.instance.clone(),
            _alive: None,
            group: None,
            accounts: Accounts::default(),
            own_program: self.own_program.clone(),
            log: self.log.try_clone().map_err(machine("cannot copy a descriptor"))?,
            guard: RefCell::new(None),
            user: self.user,
            fallen: self.fallen.clone(),
        })
    }

    /// How observers are started: each is told of its own channels only.
    fn observer_starter(&self, order: Order) -> Result<StartObserver, RunError> {
        let copy = self.copy()?;
        Ok(Box::new(move |channels, connection| {
            let wanted = |channel: &&OrderedChannel| channels.contains(&channel.source);
            let channels = order.channels.iter().filter(wanted).cloned().collect();
            let order = serde_json::to_string(&Order { channels, ..order.clone() })?;
            let lines = Lines { output: Some(connection), ..Lines::default() };
            copy.helper(&["observer".into(), order], lines, true)
        }))
    }

    fn start_janitor(&self, burial: &Burial) -> std::io::Result<(Spawned, File)> {
        let domain = self.instance.domain();
        let mut arguments = vec!["janitor".into(), domain.root.clone(), burial.pid.to_string()];
        arguments.extend(burial.damaged.iter().map(|channel| format!("--damaged={channel}")));
        // A channel that another module serves has nothing here.
        let here = |channel: &&String| domain.directory(channel).exists();
        arguments.extend(burial.channels.iter().filter(here).cloned());
        let (progress, end) = std::io::pipe()?;
        rustix::fs::fcntl_setfl(&progress, rustix::fs::OFlags::NONBLOCK)?; // nobody waits for one that does not end
        let end = OwnedFd::from(end);
        let process = self.helper(&arguments, Lines { output: Some(&end), ..Lines::default() }, true)?;
        Ok((process, File::from(OwnedFd::from(progress))))
    }

    pub(super) fn run(
        &self,
        plan: &Arc<Plan>,
        view: &ModuleView<'_>,
        options: &Options,
        facts: &Machine,
        programs: Vec<PathBuf>,
        course: &mut Course,
    ) -> Result<Ended, RunError> {
        let order = self.order(view);
        let homes: Vec<String> = order.channels.iter().map(|channel| channel.name.clone()).collect();
        self.instance
            .make_channel_directories(&homes, self.user)
            .map_err(machine("cannot make the channels' directories in /dev/shm"))?;
        let start_observer = self.observer_starter(order.clone())?;
        let (ordered, order) = (order.clone(), serde_json::to_string(&order).unwrap_or_default());
        let custodian = self.start_custodian(&order, CUSTODIAN_PATIENCE_NS);
        let custodian = custodian.map_err(|error| RunError::Machine {
            what: "cannot make the module's channels".into(),
            why: error.why,
        })?;
        let custodian = Rc::new(RefCell::new(custodian));
        if options.record.is_none() && course.resets() == 0 {
            // What an earlier run recorded in this folder would be taken for this one's.
            let earlier = options.output.join(part_name(0));
            remove_earlier(&earlier);
            let _ = std::fs::remove_file(&earlier); // there is none, as a rule
        }
        let port_log = options.record.as_deref().map(|path| port_log(path, course.resets()));
        let recording = port_log.map(|path| self.record(path, &ordered)).transpose()?;
        let cages = self.cages(plan, view, options, facts, programs)?;
        let (control, inbox) = self.open_control(&options.module, course);
        let start_janitor = self.janitor_starter(order, custodian.clone())?;
        let renewals = self.renewals(ordered, plan.clone(), custodian.clone())?;
        // On the virtual clock nobody is buried at an instant of the wall clock.
        let fallen = (options.clock == Clock::Wall).then(|| (self.fallen.clone(), homes));
        let staff = Staff { recording, start_janitor, fallen, renewals, start_observer, inbox };
        let ended = super::conduct::conduct(plan, view, options, facts, cages, staff, course);
        drop(control);
        custodian.borrow_mut().leave();
        ended
    }

    /// A module flies without its control socket too, and says so.
    fn open_control(&self, module: &str, course: &mut Course) -> (Option<Server>, Option<Inbox>) {
        match Server::open(&self.instance.directory()) {
            Ok((server, inbox)) => (Some(server), Some(inbox)),
            Err(error) => {
                let text = format!("no control socket, so `bateleur ps` and orders do not reach it: {error}");
                course.tell(&Event::Message { time_s: 0.0, partition: module.to_owned(), text });
                (None, None)
            }
        }
    }

    fn cages(
        &self,
        plan: &Plan,
        view: &ModuleView<'_>,
        options: &Options,
        facts: &Machine,
        programs: Vec<PathBuf>,
    ) -> Result<Vec<Cage>, RunError> {
        let domain = self.instance.domain();
        let housing = Housing {
            module: options.module.clone(),
            clock: options.clock,
            ports_root: domain.root,
            namespaces: facts.namespaces,
            user: facts.user,
            filtered: facts.filtered,
            ruled: facts.ruled,
            real_time: facts.real_time,
            logs: options.output.join("partitions"),
            link_keys: options.link_keys.clone(),
        };
        let none = BTreeMap::new();
        let built = view.partitions().zip(programs).map(|(id, program)| {
            let name = &plan[id].name;
            let overrides = options.overrides.get(name).unwrap_or(&none);
            let build = |groups: &str, beside: Option<&Cage>| {
                let mut cage =
                    Cage::build(plan, id, program.clone(), self.groups(groups)?, &housing, overrides, beside)
                        .map_err(machine(format!("cannot prepare partition {name}")))?;
                cage.translate_cores(|core| facts.real_core(core));
                Ok(cage)
            };
            let mut cage = build(name, None)?;
            if plan[id].standby.is_some() {
                // No name of a partition has a dot.
                cage.standby = Some(Box::new(build(&format!("{name}{STANDBY}"), Some(&cage))?));
            }
            Ok(cage)
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

    /// Removes everything and lets the guard go.
    pub(super) fn leave(mut self) {
        drop(self.group.take());
        drop(std::mem::take(&mut self.accounts));
        self.instance.clean_up();
        if let Some((guard, mut line)) = self.guard.borrow_mut().take() {
            let _ = line.write_all(&[FAREWELL]); // without it the guard cleans up once more: harmless
            drop(line);
            await_end(&guard);
        }
    }
}
