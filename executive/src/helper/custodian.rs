//! Creates every channel of a module and holds them until its standard input closes.
//!
//! It runs as the partitions' user (shared memory is shared within one user), and the executive itself maps none of
//! the partitions' data: a damaged segment can bring down whoever maps it.

use std::collections::BTreeMap;
use std::io::{self, Read, Write};

use bateleur_ports::{Channel, ChannelError, ChannelType, Domain, Membership};
use serde::{Deserialize, Serialize};

/// What the custodian is told, as its one argument.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Order {
    /// Root of the module's shared memory.
    pub root: String,
    /// The channels.
    pub channels: Vec<OrderedChannel>,
}

/// One channel of the order.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct OrderedChannel {
    /// The service's name.
    pub name: String,
    /// The source port, `partition.port`.
    pub source: String,
    /// The message type's name.
    pub message: String,
    /// Bytes of a message.
    pub size: usize,
    /// Queue length; none: sampling.
    pub depth: Option<usize>,
    /// Destination ports.
    pub destinations: usize,
    /// Sources beside it, see [`ChannelType`].
    #[serde(default)]
    pub spare_writers: usize,
    /// Destination ports beside them, see [`ChannelType`].
    #[serde(default)]
    pub spare_readers: usize,
}

impl OrderedChannel {
    /// What lies in shared memory for it.
    #[must_use]
    pub fn channel_type(&self) -> ChannelType {
        ChannelType {
            name: self.name.clone(),
            message: self.message.clone(),
            size: self.size,
            depth: self.depth,
            destinations: self.destinations,
            spare_writers: self.spare_writers,
            spare_readers: self.spare_readers,
        }
    }
}

impl Order {
    /// Where the module's shared memory lies.
    #[must_use]
    pub fn domain(&self) -> Domain {
        Domain { root: self.root.clone() }
    }
}

/// Why the custodian could not do its work.
#[derive(Debug, thiserror::Error)]
pub enum CustodianError {
    /// The order is damaged.
    #[error("the custodian's order is damaged: {0}")]
    Order(#[from] serde_json::Error),
    /// A channel.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// The executive is gone.
    #[error("the executive does not listen: {0}")]
    Pipe(#[from] io::Error),
}

/// What the custodian says when it holds every channel.
pub const READY: &str = "ready";

/// The custodian's life: says on standard output which channel comes next, each on a line, and "ready" when it holds all of
/// them; then holds them until standard input closes. Where it ends before, the channel that it named last is why.
pub fn run(order: &str) -> Result<(), CustodianError> {
    name_process(c"custodian");
    let order: Order = serde_json::from_str(order)?;
    let (domain, mut nodes, mut held) = (order.domain(), BTreeMap::new(), Vec::new());
    for channel in &order.channels {
        let channel = channel.channel_type();
        say(&channel.name)?;
        let node = domain.join(channel.home(), "custodian")?;
        held.push(open_or_create(&channel, &node)?);
        if channel.depth.is_some() {
            held.push(open_or_create(&channel.observed(), &node)?);
        }
        nodes.insert(channel.name, node);
    }
    say(READY)?;
    io::stdin().read_to_end(&mut Vec::new())?;
    Ok(())
}

fn say(word: &str) -> io::Result<()> {
    let mut output = io::stdout().lock();
    writeln!(output, "{word}")?;
    output.flush()
}

/// A custodian that follows a dead one finds the channels that partitions still hold.
fn open_or_create(channel: &ChannelType, node: &Membership) -> Result<Channel, ChannelError> {
    channel.open(node).or_else(|_| channel.create(node))
}

pub(super) fn name_process(name: &std::ffi::CStr) {
    let _ = rustix::thread::set_name(name); // a name is a comfort
}
