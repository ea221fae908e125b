//! The partition: in each window it takes in what has come, hands it to its ports, and sends what its ports hold.
//!
//! Responsible for: the order of these, and for bounded time in each. It must never retry something late: what a window can
//! not send waits in its port, and what was sent is gone.

mod end;
mod inbox;
mod keys;
mod status;

use bateleur_apex::{Alignment, AlignmentReport, Context, Partition, StartError, Window};
use bateleur_contract::relay::{
    ATTRIBUTE, ClockRole, LEAST_SHARE, LinkModelTable, MODEL_ATTRIBUTE, RelayTable, SENDING_NS, STEPPED,
    TAKEN_IN_A_WINDOW, share_of_a_window,
};
use bateleur_relay::transport::{Endpoint, RelayTransport, Stepped, Udp};
use bateleur_relay::{Arrival, Frame, Link};

use end::End;
use inbox::Inbox;
use status::Status;

/// So many datagrams are looked at in each window, however short it is.
const LEAST: usize = LEAST_SHARE;
/// What has come is taken in the first part of a window, one in so many: the rest is for what goes out.
const RECEIVE_WINDOW_DIVISOR: u64 = 2;

/// See the module's head.
pub(crate) struct Relay {
    ends: Vec<End>,
    endpoints: Vec<Endpoint>,
    transport: Box<dyn RelayTransport>,
    inbox: Inbox,
    status: Status,
    /// By link, in the present window: something may be left to send.
    left: Vec<bool>,
    /// Of a module that follows: where to tell how its frames lie, and the link to the one that it follows.
    alignment: Option<(Alignment, usize)>,
}

impl Partition for Relay {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let table: Option<RelayTable> = context.attribute(ATTRIBUTE, None)?;
        let model: Option<LinkModelTable> = context.attribute(MODEL_ATTRIBUTE, None)?;
        let table = table.ok_or_else(|| {
            let what = "it is started without a table of links: relays are made by the executive from the channels that cross";
            StartError::Other(what.into())
        })?;
        let endpoints = Endpoint::all(&table);
        let transport = open(&table.transport, &endpoints, model)?;
        let keys = keys::read(&table)?;
        let links = table.links.iter().zip(&keys);
        let ends =
            links.map(|(link, key)| End::open(context, &table, link, key)).collect::<Result<Vec<_>, _>>()?;
        let leader = table.links.iter().position(|link| link.clock == ClockRole::Follower);
        let alignment = context.alignment().zip(leader);
        Ok(Self {
            left: vec![false; ends.len()],
            ends,
            endpoints,
            transport,
            inbox: Inbox::default(),
            status: Status::new(context, &table)?,
            alignment,
        })
    }

    fn window(&mut self, window: &Window) {
        self.take_in(window);
        for end in &mut self.ends {
            end.tell(window);
        }
        let frame = frame(window);
        if let Some((alignment, leader)) = &self.alignment
            && let Some(report) = report(&self.ends[*leader].link, frame, window.now_ns())
        {
            alignment.tell(&report);
        }
        self.send(window, frame);
        self.status.write(window.now_ns(), self.ends.iter().map(|end| &end.link));
    }
}

impl Relay {
    fn take_in(&mut self, window: &Window) {
        let Self { ends, endpoints, transport, inbox, .. } = self;
        if inbox.len() < TAKEN_IN_A_WINDOW {
            let share = share_of_a_window(endpoints.len());
            transport.receive(&|| window.now_ns(), share, &mut |came| inbox.add(&came));
        }
        for (number, endpoint) in endpoints.iter().enumerate() {
            ends[endpoint.place]
                .note_port_unreachable(endpoint.network, transport.port_unreachable_count(number));
        }
        let now_ns = window.now_ns();
        let until_ns = now_ns + window.end_ns().saturating_sub(now_ns) / RECEIVE_WINDOW_DIVISOR;
        inbox.empty(&mut |done| done < LEAST || window.now_ns() < until_ns, &mut |came| {
            let endpoint = &endpoints[came.endpoint];
            let End { link, ports, .. } = &mut ends[endpoint.place];
            let arrival = Arrival { network: endpoint.network, came_ns: came.at_ns, now_ns };
            match came.datagram {
                // A refusal is counted by the link.
                Ok(datagram) => {
                    let _ = link.receive(arrival, datagram, &mut |delivery| ports.deliver(&delivery));
                }
                Err(reason) => link.refuse(endpoint.network, reason),
            }
        });
        for End { link, ports, .. } in ends {
            link.look(now_ns, &mut |delivery| ports.deliver(&delivery));
        }
    }

    /// Sends what the links have to send: one datagram of each, and more in turn, as their gaps allow while something is left. No link
    /// waits for another one's gap.
    fn send(&mut self, window: &Window, frame: Frame) {
        let mut at_ns = window.now_ns();
        self.left.fill(true);
        loop {
            for place in 0..self.ends.len() {
                if self.left[place] && self.ends[place].link.next_ns() <= at_ns {
                    self.left[place] = self.send_one(place, window, frame, at_ns);
                }
            }
            let left = self.ends.iter().zip(&self.left).filter(|(_, left)| **left);
            let next_ns = left.map(|(end, _)| end.link.next_ns()).min();
            let Some(next_ns) = next_ns.filter(|next_ns| next_ns + SENDING_NS <= window.end_ns()) else {
                return;
            };
            window.wait_until(next_ns);
            at_ns = next_ns.max(window.now_ns());
        }
    }

    /// True: something is left.
    fn send_one(&mut self, place: usize, window: &Window, frame: Frame, at_ns: u64) -> bool {
        let Self { transport, ends, endpoints, .. } = self;
        let End { link, ports, .. } = &mut ends[place];
        let Some(mut composer) = link.open(at_ns, frame) else { return false };
        let left = ports.collect(&mut composer);
        let sealed = composer.finish(at_ns.max(window.now_ns()));
        for (number, endpoint) in endpoints.iter().enumerate().filter(|(_, end)| end.place == place) {
            transport.send(number, [sealed.bytes, sealed.tag(endpoint.network)]);
        }
        let left = left || link.has_more();
        transport.flush(at_ns, &mut |endpoint| {
            let Endpoint { place, network, .. } = endpoints[endpoint];
            ends[place].link.could_not_send(network);
        });
        left
    }
}

fn frame(window: &Window) -> Frame {
    let frame = window.major_frame();
    Frame { number: frame.number, start_ns: frame.start_ns }
}

/// How the peer's major frames lie to the own one; nothing before the first exchange.
fn report(link: &Link, own: Frame, now_ns: u64) -> Option<AlignmentReport> {
    let (estimate, peer) = (link.estimate(now_ns)?, link.peer_frame()?);
    let begins_ns = i128::from(peer.start_ns) - i128::from(estimate.offset_ns); // own time
    Some(AlignmentReport {
        peer_minus_own_ns: i64::try_from(begins_ns - i128::from(own.start_ns)).ok()?,
        uncertainty_ns: u32::try_from(estimate.uncertainty_ns).unwrap_or(u32::MAX),
        exchanges: estimate.exchanges as u32, // whether there is a new one matters, not how many
    })
}

fn open(
    transport: &str,
    endpoints: &[Endpoint],
    model: Option<LinkModelTable>,
) -> Result<Box<dyn RelayTransport>, StartError> {
    let refused = |error: bateleur_relay::transport::TransportError| StartError::Other(error.to_string());
    match (transport, model) {
        (STEPPED, model) => {
            let stepped = Stepped::open(endpoints, &model.unwrap_or_default()).map_err(refused)?;
            Ok(Box::new(stepped))
        }
        ("udp", None) => Ok(Box::new(Udp::open(endpoints).map_err(refused)?)),
        ("udp", Some(_)) => Err(StartError::Other(format!(
            "attribute {MODEL_ATTRIBUTE}: a network is modelled by transport \"{STEPPED}\", or by the program `link_model` \
             between two real sockets"
        ))),
        (other, _) => Err(StartError::Other(format!(
            "transport \"{other}\" is not one that this relay was built with: \"udp\", \"{STEPPED}\""
        ))),
    }
}

#[cfg(test)]
mod tests;
