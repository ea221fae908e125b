//! The recorder: attaches to every channel of a module as an observer and writes what it carries into `ports.mcap`.
//!
//! It is told when to read (a byte on standard input) and says when it has (a byte on standard output), so that under
//! the virtual clock nothing is lost, however fast time goes. It can not slow a writer down.

use std::io::{Read, Write};

use anyhow::{Context, Result};
use bateleur_executive::helper::custodian::Order;
use bateleur_ports::{Channel, Membership, Reader};
use bateleur_report::log::{ChannelId, PortLog, topic};

struct Observed {
    reader: Reader,
    log: ChannelId,
    _channel: Channel,
    _node: Membership,
}

/// The log was opened by the executive, whose output folder the recorder's user may not enter.
const LOG: &str = "/proc/self/fd/3";

pub(crate) fn run(order: &str) -> Result<()> {
    let _ = rustix::thread::set_name(c"recorder"); // a name is a comfort
    let order: Order = serde_json::from_str(order).context("the recorder's order is damaged")?;
    let mut log = PortLog::create(LOG)?;
    let observed = attach(&order, &mut log)?;
    answer()?;
    let mut word = [0; 1];
    while std::io::stdin().read(&mut word)? == 1 {
        read_all(&observed, &mut log)?;
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

fn attach(order: &Order, log: &mut PortLog) -> Result<Vec<Observed>> {
    let (domain, mut observed) = (order.domain(), Vec::new());
    for ordered in &order.channels {
        let kind = ordered.channel_type();
        let kind = if kind.depth.is_some() { kind.observed() } else { kind };
        let node = domain.join(kind.home(), "recorder")?;
        let channel = kind.open(&node)?;
        let reader = kind.observer(&channel)?;
        // Bytes without a message type have no fields to name: they are left out.
        let Some(message) = bateleur_messages::find(&ordered.message) else { continue };
        let (partition, port) = ordered.source.split_once('.').unwrap_or((&ordered.source, "port"));
        let id = log.add_channel(&topic(partition, port), message)?;
        observed.push(Observed { reader, log: id, _channel: channel, _node: node });
    }
    Ok(observed)
}

fn read_all(observed: &[Observed], log: &mut PortLog) -> Result<()> {
    for one in observed {
        // A reader that fails once has met a dying writer; what the writer sent before is still there next time.
        while let Ok(Some(sample)) = one.reader.receive() {
            let stamp = sample.user_header();
            log.write(one.log, stamp.sequence, stamp.source_ns, sample.payload())?;
        }
    }
    Ok(())
}
