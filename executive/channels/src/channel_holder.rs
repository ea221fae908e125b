//! Creates channels of a module and holds them until its standard input closes.
//!
//! It runs as the partitions' user (shared memory is shared within one user), and the executive itself maps none of
//! the partitions' data: a damaged segment can bring down whoever maps it.

use std::io::{self, Read, Write};

use bateleur_host::helper::begin;
use bateleur_host::helper::orders::{AT, BAD, Order, READY};
use bateleur_ports::{Channel, ChannelError, ChannelType, Domain, Membership};

use crate::{channel_type, join};

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

/// The channel holder's life: says on standard output which channel comes next and which can not be held, each on a line, and
/// "ready" when it holds all others; then holds them until standard input closes. Where it ends before, the channel that it came to last
/// is why.
///
/// # Errors
/// Its order is damaged, or nobody listens. A bad channel is none.
pub fn run(order: &str) -> Result<(), ChannelHolderError> {
    begin(c"channel-holder");
    let order: Order = serde_json::from_str(order)?;
    let domain = Domain { root: order.root.clone() };
    let mut held = Vec::new();
    for channel in &order.channels {
        say(AT, &channel.name)?;
        match hold(&domain, &channel_type(channel)) {
            Ok(holding) => held.push(holding),
            Err(error) => {
                eprintln!("channel-holder: {error}");
                say(BAD, &channel.name)?;
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
    let node = join(domain, channel.home(), "channel-holder")?;
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
