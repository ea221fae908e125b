//! Creates channels of a module and holds them until its standard input closes.
//!
//! It runs as the partitions' user (shared memory is shared within one user), and the executive itself maps none of
//! the partitions' data: a damaged segment can bring down whoever maps it.

use std::io::{self, Read, Write};

use bateleur_ports::{Channel, ChannelError, ChannelType, Domain, Membership};
use serde::{Deserialize, Serialize};

/// What the channel holder is told, as its one argument.
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
    /// Queue length; `None`: sampling.
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

/// Why the channel holder could not do its work.
#[derive(Debug, thiserror::Error)]
pub enum ChannelHolderError {
    /// The order is damaged.
    #[error("the channel holder's order is damaged: {0}")]
    Order(#[from] serde_json::Error),
    /// The executive is gone.
    #[error("the executive does not listen: {0}")]
    Pipe(#[from] io::Error),
}

/// What the channel holder says when it holds every channel that can be held.
pub const READY: &str = "ready";
/// What it says before the name of each channel, when it comes to it.
pub const AT: &str = "at";

/// The channel holder's life: says on standard output which channel comes next and which can not be held, each on a line, and
/// "ready" when it holds all others; then holds them until standard input closes. Where it ends before, the channel that it came to last
/// is why.
///
/// # Errors
/// Its order is damaged, or nobody listens. A bad channel is none.
pub fn run(order: &str) -> Result<(), ChannelHolderError> {
    super::begin(c"channel-holder");
    let order: Order = serde_json::from_str(order)?;
    let domain = order.domain();
    let mut held = Vec::new();
    for channel in &order.channels {
        say(AT, &channel.name)?;
        match hold(&domain, &channel.channel_type()) {
            Ok(holding) => held.push(holding),
            Err(error) => {
                eprintln!("channel-holder: {error}");
                say(super::BAD, &channel.name)?;
            }
        }
    }
    say(READY, "")?;
    io::stdin().read_to_end(&mut Vec::new())?;
    // What it holds goes with it: letting go would look into memory that may be damaged.
    std::process::exit(0);
}

/// What keeps a channel alive.
type Held = (Vec<Channel>, Membership);

fn hold(domain: &Domain, channel: &ChannelType) -> Result<Held, ChannelError> {
    let node = super::join(domain, channel.home(), "channel-holder")?;
    let mut held = vec![open_or_create(channel, &node)?];
    if channel.depth.is_some() {
        held.push(open_or_create(&channel.observed(), &node)?);
    }
    Ok((held, node))
}

fn say(word: &str, channel: &str) -> io::Result<()> {
    let mut output = io::stdout().lock();
    writeln!(output, "{word} {channel}")?;
    output.flush()
}

/// A channel holder that follows a dead one finds the channels that partitions still hold.
fn open_or_create(channel: &ChannelType, node: &Membership) -> Result<Channel, ChannelError> {
    channel.open(node).or_else(|_| channel.create(node))
}
