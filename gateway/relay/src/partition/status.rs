//! What the relay says of its links, on a port of its own.

use bateleur_apex::{Context, Direction, PortKind, SamplingSource, StartError};
use bateleur_contract::relay::{MOST_LINKS, RelayTable, STATUS_PORT};
use bateleur_messages::LinkStatus;
use bateleur_messages::link::{LINKS, NETWORKS};
use bateleur_relay::Link;

const _: () = assert!(MOST_LINKS == LINKS, "a plan may have as many links as a relay reports on");

/// Writes a [`LinkStatus`] in each window.
pub(super) struct Status {
    /// `None` if the plan leaves it out.
    port: Option<SamplingSource<LinkStatus>>,
    starts: u64,
}

impl Status {
    pub(super) fn new(context: &mut Context, table: &RelayTable) -> Result<Self, StartError> {
        if table.links.len() > LINKS {
            let found = table.links.len();
            return Err(StartError::Other(format!("{found} links; a module can have {LINKS}")));
        }
        let declared = context.port_names(PortKind::Sampling, Direction::Source);
        let declared = declared.iter().any(|port| port == STATUS_PORT);
        let port = declared.then(|| context.sampling_source(STATUS_PORT)).transpose()?;
        Ok(Self { port, starts: u64::from(context.generation()) + 1 })
    }

    pub(super) fn write<'a>(&mut self, now_ns: u64, links: impl Iterator<Item = &'a Link>) {
        let Some(port) = &mut self.port else { return };
        let mut status = LinkStatus { time_ns: now_ns, starts: self.starts, ..LinkStatus::default() };
        for (place, link) in links.enumerate().take(LINKS) {
            status.links += 1;
            fill(&mut status, place, link, now_ns);
        }
        port.write(&status);
    }
}

fn fill(status: &mut LinkStatus, place: usize, link: &Link, now_ns: u64) {
    let counters = link.counters();
    status.id[place] = link.id().into();
    status.state[place] = link.state();
    status.peer_lives[place] = counters.peer_lives;
    status.messages_sent[place] = counters.messages_sent;
    status.messages_received[place] = counters.messages_received;
    status.messages_lost[place] = counters.messages_lost;
    status.messages_late[place] = counters.messages_late;
    status.messages_overflowed[place] = counters.messages_overflowed;
    status.datagrams_lost[place] = counters.datagrams_lost;
    if let Some(estimate) = link.estimate(now_ns) {
        status.offset_ns[place] = estimate.offset_ns as f64;
        status.uncertainty_ns[place] = estimate.uncertainty_ns as f64;
        status.round_trip_ns[place] = estimate.round_trip_ns as f64;
        status.exchanges[place] = estimate.exchanges;
    }
    for network in 0..NETWORKS {
        let (path, counted) = (LinkStatus::path(place, network), &counters.networks[network]);
        status.up[path] = link.is_up(network).into();
        status.heard_ns[path] = link.heard_ns(network).unwrap_or(0);
        status.sent[path] = counted.sent;
        status.unsent[path] = counted.unsent;
        status.received[path] = counted.received;
        let (latency_ns, allowed_ns) = link.transit_ns(network);
        (status.latency_ns[path], status.allowed_ns[path]) = (latency_ns as f64, allowed_ns as f64);
        status.lost[path] = counted.lost;
        status.late[path] = counted.late;
        status.duplicated[path] = counted.duplicated;
        status.redundant[path] = counted.redundant;
        status.reordered[path] = counted.reordered;
    }
    for (reason, count) in counters.rejected.into_iter().enumerate() {
        status.rejected[LinkStatus::refusal(place, reason)] = count;
    }
}
