//! Finds out which of a partition's channels nobody can attach to any more.
//!
//! Memory that partitions share can be written over by any of them. What is damaged shows when a process attaches to it:
//! that fails, hangs, or ends the process. So the channel probe attaches to each channel as the partition would, in a process
//! of its own for each, and tells which of these did not come back well. It must run while the partition has no
//! process: it takes its places in the channels. It never sends anything.

use std::io::{self, Write};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use bateleur_host::helper::orders::{Examination, ExaminedPort};
use bateleur_host::helper::{PARENT, begin};
use bateleur_ports::{ChannelError, ChannelType, Domain, Membership};
use iceoryx2::port::update_connections::ConnectionFailure;

use crate::{channel_type, join};

/// How long processes may take to attach, as a multiple of what one takes that attaches to nothing: a machine with ten times
/// the work that it can do must not make a sound channel look damaged.
const TIMES: u32 = 30;
/// The least and the most of it. A sound channel takes some milliseconds on a quiet machine.
const LEAST: Duration = Duration::from_millis(400);
const MOST: Duration = Duration::from_secs(20);
/// A channel is damaged when so many processes in a row could not attach to it.
const TRIES: usize = 2;
/// Between two looks at the processes.
const LOOK: Duration = Duration::from_millis(1);

/// Why an examination could not be carried out.
#[derive(Debug, thiserror::Error)]
pub enum ChannelProbeError {
    /// The order is damaged.
    #[error("the channel probe's order is damaged: {0}")]
    Order(#[from] serde_json::Error),
    /// A channel can not be attached to.
    #[error(transparent)]
    Channel(#[from] ChannelError),
    /// A process can not be started, or nobody listens.
    #[error("the channel probe can not work: {0}")]
    Process(#[from] io::Error),
}

/// Examines the channels of the order's ports; writes a line with the name of each damaged one to standard output.
///
/// # Errors
/// It could not begin, or nobody listens. A damaged channel is none.
pub fn run(order: &str) -> Result<(), ChannelProbeError> {
    begin(c"channel-probe");
    let order: Examination = serde_json::from_str(order)?;
    let patience = (time_of_nothing(&order.root)? * TIMES).clamp(LEAST, MOST);
    let mut damaged = order.ports;
    for _ in 0..TRIES {
        damaged = refused(&order.root, damaged, patience)?;
    }
    for port in damaged {
        writeln!(io::stdout(), "{}", port.channel.name)?;
    }
    Ok(())
}

/// How long a process takes that attaches to nothing.
fn time_of_nothing(root: &str) -> Result<Duration, ChannelProbeError> {
    let begun = Instant::now();
    comes_back_well(&mut attach_elsewhere(root, Vec::new())?, begun + MOST);
    Ok(begun.elapsed())
}

/// Those of `ports` that a process of its own could not attach to.
fn refused(
    root: &str,
    ports: Vec<ExaminedPort>,
    patience: Duration,
) -> Result<Vec<ExaminedPort>, ChannelProbeError> {
    let mut tried = Vec::new();
    for port in ports {
        let child = attach_elsewhere(root, vec![port.clone()])?;
        tried.push((port, child));
    }
    let limit = Instant::now() + patience;
    let back = |child: &mut Child| comes_back_well(child, limit);
    Ok(tried.into_iter().filter_map(|(port, mut child)| (!back(&mut child)).then_some(port)).collect())
}

fn attach_elsewhere(root: &str, ports: Vec<ExaminedPort>) -> Result<Child, ChannelProbeError> {
    let own = std::env::current_exe()?;
    let order = serde_json::to_string(&Examination { root: root.into(), ports })?;
    let mut command = Command::new(own);
    command.args(["attach", &order]).env(PARENT, std::process::id().to_string());
    Ok(command.stdin(Stdio::null()).stdout(Stdio::null()).spawn()?)
}

/// Whether it ends by itself, as it should, before `limit`.
fn comes_back_well(child: &mut Child, limit: Instant) -> bool {
    loop {
        match child.try_wait() {
            Ok(Some(status)) => return status.success(),
            Ok(None) if Instant::now() < limit => std::thread::sleep(LOOK),
            _ => {
                let _ = child.kill(); // ended meanwhile
                let _ = child.wait();
                return false;
            }
        }
    }
}

/// Attaches to the channels of the order's ports and leaves them again: the whole life of a process.
///
/// # Errors
/// A channel that can not be attached to.
pub fn attach(order: &str) -> Result<(), ChannelProbeError> {
    // It must not sit in a channel when nobody waits for its answer. A parent that was gone before is found next.
    let _ = rustix::process::set_parent_process_death_signal(Some(rustix::process::Signal::KILL)); // never refused
    begin(c"attach");
    let order: Examination = serde_json::from_str(order)?;
    let domain = Domain { root: order.root };
    for port in order.ports {
        let channel = channel_type(&port.channel);
        let node = join(&domain, channel.home(), "channel-probe")?;
        attach_to(&channel, port.writes, &node)?;
        if port.writes && channel.depth.is_some() {
            attach_to(&channel.observed(), true, &node)?;
        }
    }
    Ok(())
}

fn attach_to(channel: &ChannelType, writes: bool, node: &Membership) -> Result<(), ChannelError> {
    let opened = channel.open(node)?;
    let failed = |reason: ConnectionFailure| ChannelError::Attach {
        channel: channel.name.clone(),
        reason: format!("{reason:?}"),
    };
    if writes {
        channel.writer(&opened)?.connect().map_err(failed)
    } else {
        channel.reader(&opened)?.connect().map_err(failed)
    }
}

#[cfg(test)]
mod tests {
    use bateleur_host::helper::orders::OrderedChannel;

    use super::*;

    fn ordered(depth: Option<usize>) -> OrderedChannel {
        OrderedChannel {
            name: "imu.rates".into(),
            source: "imu.rates".into(),
            message: "Rates".into(),
            size: 24,
            depth,
            destinations: 1,
            spare_writers: 0,
            spare_readers: 0,
            sealed: None,
        }
    }

    fn attached(
        folder: &tempfile::TempDir,
        depth: Option<usize>,
        writes: bool,
    ) -> Result<(), ChannelProbeError> {
        let root = folder.path().to_string_lossy().into_owned();
        let order = Examination { root, ports: vec![ExaminedPort { channel: ordered(depth), writes }] };
        attach(&serde_json::to_string(&order).unwrap())
    }

    #[test]
    fn a_sound_channel_lets_either_end_in_again_and_again() {
        let folder = tempfile::tempdir().unwrap();
        let domain = Domain { root: folder.path().to_string_lossy().into_owned() };
        let node = domain.join("imu.rates", "test").unwrap();
        let channel = channel_type(&ordered(Some(4)));
        let held = (channel.create(&node).unwrap(), channel.observed().create(&node).unwrap());
        for writes in [true, false, true] {
            attached(&folder, Some(4), writes).unwrap();
        }
        drop(held);
    }

    #[test]
    fn a_channel_that_is_not_there_is_an_error_and_nothing_is_made_in_its_place() {
        let folder = tempfile::tempdir().unwrap();
        let error = attached(&folder, None, true).unwrap_err();
        assert!(error.to_string().contains("imu.rates"), "{error}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
