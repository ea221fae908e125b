//! Observers and publishers that operators have asked for: processes that read channels and send what they carry to a client, or write
//! into one what a client sends. The executive maps none of it; one that ends, for whatever reason, is cleaned up after like a
//! partition.

use std::io;
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use bateleur_control::{Answer, ChannelStatus, LinkName, Ordered};
use bateleur_host::partition::message_name;
use bateleur_plan::{ChannelId, Plan, nearest};
use bateleur_system::spawn::Spawned;
use bateleur_system::wait::{ended, is_readable};

/// At a time. A channel admits four observers: one is the recorder, one is left for tools of other kinds.
const MOST: usize = 2;
/// Publishers at a time. Each stays for two major frames after its last message.
pub const MOST_PUBLISHERS: usize = 8;
/// How long a publisher stays at least, ns: those who look on look now and then.
const LINGERS_NS: u64 = 200_000_000;

/// What a process is started for that has a client's connection.
#[derive(Debug, Clone, Copy)]
pub enum Work<'a> {
    /// To read these channels.
    Watch(&'a [String]),
    /// To write into one.
    Publish {
        /// That one.
        channels: &'a [String],
        /// CLOCK_MONOTONIC instant of module time 0, ns.
        origin_ns: u64,
        /// How long it stays when its client has gone, ns: what nobody has taken yet goes with it.
        lingers_ns: u64,
    },
}

/// Starts an observer or a publisher; the descriptor is its client's connection.
pub type StartObserver = Box<dyn Fn(Work<'_>, &OwnedFd) -> io::Result<Spawned>>;

/// Those at work.
#[derive(Default)]
pub(crate) struct Observers {
    start: Option<StartObserver>,
    working: Vec<Working>,
}

struct Working {
    process: Spawned,
    channels: Vec<String>,
    publishes: bool,
}

impl Observers {
    pub(crate) fn new(start: Option<StartObserver>) -> Self {
        Self { start, working: Vec::new() }
    }

    pub(crate) fn processes(&self) -> impl Iterator<Item = BorrowedFd<'_>> {
        self.working.iter().map(|one| one.process.pidfd.as_fd())
    }

    /// The next one that has ended: its process, and the channels that it was attached to.
    pub(crate) fn next_ended(&mut self) -> Option<(i32, Vec<String>)> {
        let place = self.working.iter().position(|one| is_readable(one.process.pidfd.as_fd()))?;
        let Working { process, channels, .. } = self.working.swap_remove(place);
        let _ = ended(&process); // reaps it
        Some((process.pid, channels))
    }

    /// Hands the client over to an observer of `ports` of `module`; of all its channels where there are none.
    pub(crate) fn watch(
        &mut self,
        plan: &Plan,
        module: &str,
        ordered: &Ordered,
        ports: &[String],
    ) -> Result<Answer, String> {
        let start = self.start.as_ref().ok_or("this module has no observers")?;
        if self.working.iter().filter(|one| !one.publishes).count() >= MOST {
            return Err(format!("{MOST} observers are at work already: end one of them first"));
        }
        let connection = ordered.connection.as_ref().ok_or("the connection could not be handed over")?;
        let mut channels: Vec<String> = match ports {
            [] => channels_of(plan, module).iter().map(|id| plan.port_path(plan[*id].source)).collect(),
            some => some.iter().map(|port| channel_of(plan, module, port)).collect::<Result<_, _>>()?,
        };
        channels.sort_unstable();
        channels.dedup();
        let process = start(Work::Watch(&channels), connection)
            .map_err(|error| format!("cannot start an observer: {error}"))?;
        self.working.push(Working { process, channels, publishes: false });
        Ok(Answer::Watching)
    }

    /// Hands the client over to a publisher into the channel of `port`, where the plan leaves its source to the operator.
    pub(crate) fn publish(
        &mut self,
        plan: &Plan,
        module: &str,
        ordered: &Ordered,
        port: &str,
        origin_ns: u64,
    ) -> Result<Answer, String> {
        let start = self.start.as_ref().ok_or("this module has no publishers")?;
        let connection = ordered.connection.as_ref().ok_or("the connection could not be handed over")?;
        let source = channel_of(plan, module, port)?;
        let channels = channels_of(plan, module).into_iter().map(|id| &plan[id]);
        let mut operators = channels.filter(|channel| plan[channel.source].operator);
        let Some(channel) = operators.find(|channel| plan.port_path(channel.source) == source) else {
            return Err(format!(
                "{source} is its partition's to write: where the plan says `operator = true` of that port, the operator may"
            ));
        };
        let mut publishers = self.working.iter().filter(|one| one.publishes);
        let busy = match channel.isolation.is_sealed() {
            // Its memory has one writer.
            true => publishers.any(|one| one.channels.contains(&source)),
            false => publishers.count() >= MOST_PUBLISHERS,
        };
        if busy {
            return Ok(Answer::Busy); // one of them goes soon, as a rule
        }
        let channels = vec![source];
        let longest_ns = plan.schedules.iter().map(|schedule| schedule.major_frame_ns).max().unwrap_or(0);
        let lingers_ns = (2 * longest_ns).max(LINGERS_NS);
        let process = start(Work::Publish { channels: &channels, origin_ns, lingers_ns }, connection)
            .map_err(|error| format!("cannot start a publisher: {error}"))?;
        self.working.push(Working { process, channels, publishes: true });
        Ok(Answer::Publishing)
    }
}

/// The names of the module's links.
pub(crate) fn link_names(plan: &Plan, module: &str) -> Vec<LinkName> {
    plan.module(module).map(|view| LinkName::of(&view)).unwrap_or_default()
}

/// The module's channels, for a client.
pub(crate) fn channel_list(plan: &Plan, module: &str) -> Vec<ChannelStatus> {
    let status = |id: &ChannelId| {
        let channel = &plan[*id];
        let source = &plan[channel.source];
        ChannelStatus {
            source: plan.port_path(channel.source),
            destinations: channel.destinations.iter().map(|port| plan.port_path(*port)).collect(),
            queue_depth: plan.queue_depth(channel),
            message: message_name(source),
            size: source.payload.max_size_bytes(),
            operator: source.operator,
            definition: plan.messages.get(&message_name(source)).cloned().unwrap_or_default(),
        }
    };
    channels_of(plan, module).iter().map(status).collect()
}

fn channels_of(plan: &Plan, module: &str) -> Vec<ChannelId> {
    plan.module(module).map(|view| view.channels().collect()).unwrap_or_default()
}

/// The source of the channel that `port` is attached to.
fn channel_of(plan: &Plan, module: &str, port: &str) -> Result<String, String> {
    let mut all = Vec::new();
    for id in channels_of(plan, module) {
        let channel = &plan[id];
        for known in channel.destinations.iter().chain([&channel.source]) {
            let name = plan.port_path(*known);
            if name == port {
                return Ok(plan.port_path(channel.source));
            }
            all.push(name);
        }
    }
    let hint = match nearest(port, all.iter().map(String::as_str)) {
        Some(near) => format!("did you mean `{near}`?"),
        None => "see `bateleur ports list`".to_owned(),
    };
    Err(format!("no channel of the module has a port \"{port}\": {hint}"))
}
