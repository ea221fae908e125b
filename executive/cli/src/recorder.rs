//! The recorder: attaches to every channel of a module as an observer and writes what it carries into `ports.mcap`.
//!
//! It is told when to read (a byte on standard input) and says when it has (a byte on standard output), so that under
//! the virtual clock nothing is lost, however fast time goes. It can not slow a writer down.

use std::io::{BufRead, Read, Write};

use anyhow::{Context, Result};
use bateleur_executive::helper::custodian::{Order, OrderedChannel};
use bateleur_executive::world::{ATTACH_ANEW, READ};
use bateleur_ports::{Channel, Domain, Membership, Reader};
use bateleur_report::log::{ChannelId, PortLog, topic};

struct Observed {
    log: ChannelId,
    ordered: OrderedChannel,
    end: End,
}

/// Its end of a channel.
struct End {
    reader: Reader,
    _channel: Channel,
    _node: Membership,
}

/// The log was opened by the executive, whose output folder the recorder's user may not enter.
const LOG: &str = "/proc/self/fd/3";

pub(crate) fn run(order: &str) -> Result<()> {
    let _ = rustix::thread::set_name(c"recorder"); // a name is a comfort
    let order: Order = serde_json::from_str(order).context("the recorder's order is damaged")?;
    let mut log = PortLog::create(LOG)?;
    let domain = order.domain();
    let mut observed = attach(&domain, order.channels, &mut log)?;
    answer()?;
    let mut orders = std::io::stdin().lock();
    let mut word = [0; 1];
    while orders.read(&mut word)? == 1 {
        match char::from(word[0]) {
            READ => read_all(&observed, &mut log)?,
            ATTACH_ANEW => {
                let mut names = String::new();
                orders.read_line(&mut names)?;
                attach_anew(&domain, &mut observed, &names)?;
            }
            other => anyhow::bail!("the executive has ordered {other:?}"),
        }
        answer()?;
    }
    log.finish()?;
    Ok(())
}

fn answer() -> std::io::Result<()> {
    let mut output = std::io::stdout().lock();
    output.write_all(b".")?;
    output.flush()
}

fn attach(domain: &Domain, channels: Vec<OrderedChannel>, log: &mut PortLog) -> Result<Vec<Observed>> {
    let mut observed = Vec::new();
    for ordered in channels {
        let end = End::of(domain, &ordered)?;
        // Bytes without a message type have no fields to name: they are left out.
        let Some(message) = bateleur_messages::find(&ordered.message) else { continue };
        let (partition, port) = ordered.source.split_once('.').unwrap_or((&ordered.source, "port"));
        let log = log.add_channel(&topic(partition, port), message)?;
        observed.push(Observed { log, ordered, end });
    }
    Ok(observed)
}

/// Channels that were damaged have been made anew: what it still maps of the old ones is not looked at any more.
fn attach_anew(domain: &Domain, observed: &mut [Observed], names: &str) -> Result<()> {
    let renewed: Vec<&str> = names.split_whitespace().collect();
    for one in observed.iter_mut().filter(|one| renewed.contains(&one.ordered.name.as_str())) {
        let old = std::mem::replace(&mut one.end, End::of(domain, &one.ordered)?);
        std::mem::forget(old); // letting go of it would look into damaged memory
    }
    Ok(())
}

impl End {
    fn of(domain: &Domain, ordered: &OrderedChannel) -> Result<Self> {
        let kind = ordered.channel_type();
        let kind = if kind.depth.is_some() { kind.observed() } else { kind };
        let node = domain.join(kind.home(), "recorder")?;
        let channel = kind.open(&node)?;
        let reader = kind.observer(&channel)?;
        Ok(Self { reader, _channel: channel, _node: node })
    }
}

fn read_all(observed: &[Observed], log: &mut PortLog) -> Result<()> {
    for one in observed {
        // A reader that fails once has met a dying writer; what the writer sent before is still there next time.
        while let Ok(Some(sample)) = one.end.reader.receive() {
            let stamp = sample.user_header();
            log.write(one.log, stamp.sequence, stamp.source_ns, sample.payload())?;
        }
    }
    Ok(())
}
