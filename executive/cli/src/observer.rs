//! The observer: attaches to some channels of a running module and sends what they carry to a client, one
//! [`Observation`] a line on standard output, which is the client's connection. It can not slow a writer down.
//!
//! It ends when the client goes, or takes its lines too slowly for too long; the executive then clears what it leaves.

use std::io::Write;
use std::os::fd::AsFd;
use std::time::Duration;

use anyhow::{Context, Result};
use bateleur_channels::observe;
use bateleur_control::{Answer, Observation};
use bateleur_host::helper::orders::{Order, OrderedChannel};
use bateleur_ports::{Channel, Domain, Membership, OBSERVER_DEPTH, Reader};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::net::sockopt::{Timeout, set_socket_timeout};

use crate::hexadecimal::digits_of;

/// Between two looks at the channels: a channel of 50 Hz fills its 128 places in 2.5 s.
const LOOK: Timespec = Timespec { tv_sec: 0, tv_nsec: 5_000_000 };
/// How long a client may leave its lines unread. It costs nobody a message but itself; longer, and it keeps one of the few
/// places for observers.
const PATIENCE: Duration = Duration::from_secs(10);

struct Observed {
    source: String,
    reader: Reader,
    _channel: Channel,
    _node: Option<Membership>,
}

pub(crate) fn run(order: &str) -> Result<()> {
    bateleur_host::helper::begin(c"observer");
    let order: Order = serde_json::from_str(order).context("the observer's order is damaged")?;
    let observed = attach(&order)?;
    let mut output = std::io::stdout();
    // The server's end of the connection never waited; this one does, for so long.
    rustix::io::ioctl_fionbio(output.as_fd(), false)?;
    set_socket_timeout(output.as_fd(), Timeout::Send, Some(PATIENCE))?;
    output.write_all(&Answer::Watching.line())?;
    let mut lines = Vec::new();
    while !has_gone(&output) {
        for one in &observed {
            read(one, &mut lines)?;
        }
        output.write_all(&lines)?;
        output.flush()?;
        lines.clear();
    }
    Ok(())
}

/// Attaches to all of the channels that it can attach to.
fn attach(order: &Order) -> Result<Vec<Observed>> {
    let domain = Domain { root: order.root.clone() };
    let (mut attached, mut refused) = (Vec::new(), None);
    for ordered in &order.channels {
        match attach_to(&domain, ordered) {
            Ok(one) => attached.push(one),
            Err(error) => {
                eprintln!("observer: nothing of {}: {error:#}", ordered.source);
                refused = Some(error);
            }
        }
    }
    match refused {
        Some(error) if attached.is_empty() => Err(error),
        _ => Ok(attached),
    }
}

fn attach_to(domain: &Domain, ordered: &OrderedChannel) -> Result<Observed> {
    let (reader, channel, node) = observe(domain, ordered, "observer")?;
    Ok(Observed { source: ordered.source.clone(), reader, _channel: channel, _node: node })
}

fn read(one: &Observed, lines: &mut Vec<u8>) -> Result<()> {
    // A reader that fails once has met a dying writer; what the writer sent before is still there next time.
    // And one that writes without end must not keep it from the others.
    for _ in 0..=OBSERVER_DEPTH {
        let Ok(Some(sample)) = one.reader.receive() else { break };
        let stamp = sample.stamp();
        let observation = Observation {
            source: one.source.clone(),
            sequence: stamp.sequence,
            source_ns: stamp.source_ns,
            bytes: digits_of(sample.payload()),
        };
        serde_json::to_writer(&mut *lines, &observation)?;
        lines.push(b'\n');
    }
    Ok(())
}

/// Waits for the next look; true: the client has closed its connection.
fn has_gone(output: &std::io::Stdout) -> bool {
    let mut fds = [PollFd::new(output, PollFlags::RDHUP)];
    let ready = poll(&mut fds, Some(&LOOK)).is_ok_and(|ready| ready > 0);
    ready && fds[0].revents().intersects(PollFlags::HUP | PollFlags::RDHUP | PollFlags::ERR)
}
