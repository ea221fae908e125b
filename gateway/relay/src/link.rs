//! One end of a link between two modules.
//!
//! Responsible for: the order in which a datagram is judged (form, link, tag, life, number, plan, content), the states of
//! networks and peer, and the header of what goes out. It must never hand on anything of a datagram before all of it
//! was judged, and never look at a clock.

use std::collections::VecDeque;

use bateleur_contract::relay::{LinkTable, RelayTable};
use bateleur_messages::link::{DOWN, NETWORKS, PLAN_DIFFERS, UP};
use zerocopy::IntoBytes;
use zerocopy::little_endian::{U16, U32, U64};

use crate::clock::{self, Estimate, Exchange, PeerClock};
use crate::counters::LinkCounters;
use crate::incoming::{Incoming, Patience, Sink};
use crate::outgoing::{Composer, LEAST_PIECE, Outgoing};
use crate::pace::Pace;
use crate::presence::{Change, Presence};
use crate::sections::Sections;
use crate::sequence::{Seen, Sequences};
use crate::session::{Claim, Draw, Session, Verdict};
use crate::tag::{Key, Seal, TAG_BYTES, Tags};
use crate::transit::{self, Transit};
use crate::wire::{
    self, CHANNELS, HEADER_BYTES, Header, KIND_MESSAGES, KIND_SECTIONS, MAGIC, MESSAGE_BYTES, PIECE_BYTES,
    Part, Parts, Rejection, VERSION,
};

/// The longest payload of a UDP datagram, bytes.
pub(crate) const LONGEST: u32 = 65_507;
/// The shortest limit with which anything can be said, bytes: a piece beside another that is being sent.
const SHORTEST: usize = HEADER_BYTES + TAG_BYTES + 2 * (MESSAGE_BYTES + PIECE_BYTES + LEAST_PIECE);
/// So many datagrams that are refused on a network on which nothing was ever heard are told: a few are usual at a meeting.
const REFUSED: u64 = 20;
/// Events that wait to be taken, most; further ones are dropped, and states tell what they would have told.
const EVENTS: usize = 64;

/// Why there is no link of a table.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
pub enum LinkError {
    /// The digest can not be read.
    #[error("the plan's digest \"{0}\" is not of 64 hexadecimal digits")]
    Digest(String),
    /// Networks.
    #[error("link {link} has {found} networks; it can have 1 to {NETWORKS}")]
    Networks {
        /// The link.
        link: String,
        /// How many.
        found: usize,
    },
    /// The limit of a datagram.
    #[error("link {link}: datagrams of {found} bytes at most; the limit can be {SHORTEST} to {LONGEST}")]
    Datagram {
        /// The link.
        link: String,
        /// The limit.
        found: u32,
    },
    /// A channel's number.
    #[error("link {link}: channel number {id} is there twice or not below {CHANNELS}")]
    Channel {
        /// The link.
        link: String,
        /// The number.
        id: u16,
    },
    /// There is no key.
    #[error("link {0} is authenticated, but its key is all zeros: give it a key file")]
    NoKey(String),
}

/// Something that an operator or the health monitor wants to know.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Event {
    /// Nothing of the peer comes on a network any more (its place in the table).
    NetworkDown(usize),
    /// The peer is heard on a network again.
    NetworkUp(usize),
    /// Nothing has ever come on a network.
    NetworkSilent(usize),
    /// Both ends hear each other, and messages flow.
    Up,
    /// Messages do not flow any more.
    Down,
    /// A new life of the peer's relay has begun, and it is not the first that was met.
    PeerRestarted,
    /// The peer has another plan; what differs, as far as it has said.
    PlanDiffers(String),
    /// A queue was full (the channel's place in the table).
    Overflow(usize),
    /// Datagrams of a network (its place in the table) take longer than the plan says, both in ns.
    NetworkSlow {
        /// The network.
        network: usize,
        /// The longest that one was on its way of late.
        took_ns: u64,
        /// What the plan says.
        allowed_ns: u64,
    },
    /// None of a network does any more.
    NetworkInTime(usize),
}

/// The module's major frame.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Frame {
    /// Frames before this one.
    pub number: u64,
    /// When it began, module time, ns.
    pub start_ns: u64,
}

/// Where and when a datagram came.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Arrival {
    /// The place of the network in the link's table.
    pub network: usize,
    /// When it came, own module time, ns: as near to the wire as can be told.
    pub came_ns: u64,
    /// The present instant, own module time, ns.
    pub now_ns: u64,
}

/// A datagram that is ready to go: the same bytes for every network, then that network's tag.
#[derive(Debug)]
pub struct Sealed<'a> {
    /// All but the tag.
    pub bytes: &'a [u8],
    tags: Option<Tags>,
}

impl Sealed<'_> {
    /// What follows the bytes on a network: nothing where the link is not authenticated.
    #[must_use]
    pub fn tag(&self, network: usize) -> &[u8] {
        self.tags.as_ref().and_then(|tags| tags.get(network)).map_or(&[], |tag| tag.as_slice())
    }
}

/// See the module's head.
pub struct Link {
    id: u16,
    plan: [u8; 16],
    sections: Sections,
    max_datagram: usize,
    skew_ns: u64,
    /// Of what this end sends, and of what the other one does; `None`: not authenticated.
    seals: Option<(Seal, Seal)>,
    session: Session,
    sequences: Option<Sequences>,
    /// Of lives that are over: datagrams lost in all, and on each network.
    lost_before: (u64, [u64; NETWORKS]),
    networks: Vec<Presence>,
    transits: Vec<Transit>,
    clock: PeerClock,
    /// `sent_ns` of the peer's latest datagram, and when it came.
    echo: (u64, u64),
    peer_frame: Option<Frame>,
    differs: bool,
    /// That what comes on a silent network is refused has been said.
    refusals_told: [bool; NETWORKS],
    /// What was said last of a plan that differs.
    said: Option<Event>,
    was_up: bool,
    /// Values that were written once have to go again.
    again: bool,
    pace: Pace,
    patience: Patience,
    next_sequence: u64,
    /// Numbers of the channels, by their place in the table.
    channel_ids: Vec<u16>,
    /// By number; `None` if it does not come in here.
    incoming: Vec<Option<Incoming>>,
    pub(crate) outgoing: Outgoing,
    pub(crate) datagram: Vec<u8>,
    pub(crate) counters: LinkCounters,
    events: VecDeque<Event>,
}

impl Link {
    /// This end of a link of `table`, with its key and 32 bytes that nobody can foresee.
    ///
    /// # Errors
    /// A table that the checker would not have let pass, or an authenticated link without a key.
    pub fn new(
        table: &RelayTable,
        link: &LinkTable,
        key: &Key,
        entropy: [u8; 32],
    ) -> Result<Self, LinkError> {
        check(link, key)?;
        let digest = digest(&table.digest).ok_or_else(|| LinkError::Digest(table.digest.clone()))?;
        let seals = link
            .authenticated
            .then(|| (Seal::new(key, link.id, link.initiator), Seal::new(key, link.id, !link.initiator)));
        let ids = link.channels.iter().map(|channel| channel.id);
        let mut incoming: Vec<Option<Incoming>> = Vec::new();
        incoming.resize_with(ids.clone().max().map_or(0, |id| usize::from(id) + 1), || None);
        for (place, channel) in link.channels.iter().enumerate().filter(|(_, channel)| !channel.outgoing) {
            incoming[usize::from(channel.id)] = Some(Incoming::new(place, channel));
        }
        let max_datagram = link.max_datagram as usize;
        Ok(Self {
            id: link.id,
            plan: digest,
            sections: Sections::new(table, link),
            max_datagram,
            skew_ns: link.skew_ns,
            seals,
            session: Session::new(Draw::new(entropy)),
            sequences: None,
            lost_before: Default::default(),
            networks: link.paths.iter().map(|_| Presence::new(link.lost_after_ns)).collect(),
            transits: link.paths.iter().map(|path| Transit::new(path.latency_ns)).collect(),
            clock: PeerClock::new(),
            echo: (0, 0),
            peer_frame: None,
            differs: false,
            refusals_told: Default::default(),
            said: None,
            was_up: false,
            again: false,
            pace: Pace::new(link.gap_ns),
            patience: Patience { missing_ns: link.skew_ns, piece_ns: link.lost_after_ns },
            next_sequence: 0,
            channel_ids: ids.collect(),
            incoming,
            outgoing: Outgoing::new(&link.channels, link.max_datagram),
            datagram: Vec::with_capacity(max_datagram),
            counters: LinkCounters::default(),
            events: VecDeque::with_capacity(EVENTS),
        })
    }

    /// The link's number in the plan.
    #[must_use]
    pub fn id(&self) -> u16 {
        self.id
    }

    /// Judges a datagram, and hands the messages in it to `sink`, which says whether there was room for each.
    ///
    /// # Errors
    /// Why nothing of it was taken; counted already.
    pub fn receive(
        &mut self,
        arrival: Arrival,
        datagram: &[u8],
        sink: &mut dyn FnMut(crate::Delivery<'_>) -> bool,
    ) -> Result<(), Rejection> {
        self.counters.networks[arrival.network].received += 1;
        let taken = self.judge(arrival, datagram, sink);
        if let Err(reason) = taken {
            self.counters.rejected[reason as usize] += 1;
        }
        taken
    }

    /// Counts a datagram that the transport itself refused.
    pub fn refuse(&mut self, network: usize, reason: Rejection) {
        self.counters.networks[network].received += 1;
        self.counters.rejected[reason as usize] += 1;
    }

    /// Counts a datagram that could not be sent on a network.
    pub fn could_not_send(&mut self, network: usize) {
        self.counters.networks[network].unsent += 1;
    }

    /// Time passes: silent networks, and messages that nobody needs to wait for any longer. Once in every window.
    pub fn look(&mut self, now_ns: u64, sink: &mut dyn FnMut(crate::Delivery<'_>) -> bool) {
        for network in 0..self.networks.len() {
            let change = self.networks[network].look(now_ns);
            self.note_network(network, change);
            self.look_at_refusals(network, change == Some(Change::Never));
        }
        if !self.networks.iter().any(Presence::is_up) {
            self.session.silent();
        }
        let Self { incoming, patience, events, .. } = self;
        for channel in incoming.iter_mut().flatten() {
            channel.look(now_ns, patience, &mut noting(events, sink));
        }
        self.note_state();
    }

    /// Whoever was said to be silent may come later and be refused: that is another fault, with another mend.
    fn look_at_refusals(&mut self, network: usize, just_told: bool) {
        let came = self.counters.networks[network].received;
        if just_told {
            self.refusals_told[network] = came > 0; // with the silence
        } else if came >= REFUSED
            && self.networks[network].is_told_silent()
            && !std::mem::replace(&mut self.refusals_told[network], true)
        {
            self.note(Event::NetworkSilent(network));
        }
    }

    /// When the next datagram may begin, own module time, ns.
    #[must_use]
    pub fn next_ns(&self) -> u64 {
        self.pace.next_ns()
    }

    /// Whether more of a message that was begun has to go out.
    #[must_use]
    pub fn has_more(&self) -> bool {
        self.outgoing.has_more()
    }

    /// Begins a datagram; nothing while the gap after the one before has not passed.
    pub fn open(&mut self, now_ns: u64, frame: Frame) -> Option<Composer<'_>> {
        if !self.pace.allows(now_ns) {
            return None;
        }
        self.pace.started(now_ns);
        let claim = self.session.claim();
        let header = Header {
            magic: MAGIC,
            version: VERSION,
            kind: if self.differs { KIND_SECTIONS } else { KIND_MESSAGES },
            link: U16::new(self.id),
            length: U32::new(0),
            count: U16::new(0),
            tagged: U16::new(u16::from(self.seals.is_some())),
            plan: self.plan,
            session: U64::new(claim.session),
            to_session: U64::new(claim.to_session),
            challenge: U64::new(claim.challenge),
            answer: U64::new(claim.answer),
            sequence: U64::new(self.next_sequence),
            sent_ns: U64::new(0), // when it goes
            echo_sent_ns: U64::new(self.echo.0),
            echo_came_ns: U64::new(self.echo.1),
            frame: U64::new(frame.number),
            frame_ns: U64::new(frame.start_ns),
        };
        self.next_sequence += 1;
        self.datagram.clear();
        self.datagram.extend_from_slice(header.as_bytes());
        let end = self.max_datagram - self.tag_bytes();
        let open = self.session.is_adopted() && !self.differs;
        Some(Composer { link: self, end, count: 0, open })
    }

    /// Finishes the datagram of `count` messages, which goes at `now_ns`.
    pub(crate) fn seal(&mut self, count: u16, now_ns: u64) -> Sealed<'_> {
        let mut count = count;
        if self.differs {
            let room = self.max_datagram - self.tag_bytes() - self.datagram.len();
            count = self.sections.put(&mut self.datagram, room);
        }
        let length = self.datagram.len() + self.tag_bytes();
        self.datagram[LENGTH_AT..LENGTH_AT + 4].copy_from_slice(&(length as u32).to_le_bytes()); // at most LONGEST
        self.datagram[COUNT_AT..COUNT_AT + 2].copy_from_slice(&count.to_le_bytes());
        self.datagram[SENT_AT..SENT_AT + 8].copy_from_slice(&now_ns.to_le_bytes());
        for network in 0..self.networks.len() {
            self.counters.networks[network].sent += 1;
        }
        let tags = self.seals.as_ref().map(|(own, _)| own.tags(&self.datagram));
        Sealed { bytes: &self.datagram, tags }
    }

    /// Whether values that were written once have to go again, because the peer was not there, or another life of it was; asked once
    /// for each time. No event: those may be dropped.
    pub fn sends_all_again(&mut self) -> bool {
        std::mem::take(&mut self.again)
    }

    /// The next thing that happened.
    pub fn next_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Counters, as of now.
    #[must_use]
    pub fn counters(&self) -> LinkCounters {
        let mut counters = self.counters;
        let sequences = self.sequences.as_ref();
        counters.datagrams_lost = self.lost_before.0 + sequences.map_or(0, Sequences::lost);
        for (network, counted) in counters.networks.iter_mut().enumerate() {
            counted.lost = self.lost_before.1[network] + sequences.map_or(0, |all| all.lost_on(network));
        }
        for channel in self.incoming.iter().flatten() {
            let tally = channel.tally();
            counters.messages_received += tally.received;
            counters.messages_late += tally.late;
            counters.messages_overflowed += tally.overflowed;
            counters.messages_lost += channel.lost();
        }
        counters
    }

    /// How the link is, as in a [`bateleur_messages::LinkStatus`].
    #[must_use]
    pub fn state(&self) -> u64 {
        let heard = self.networks.iter().any(Presence::is_up);
        match heard {
            true if self.differs => PLAN_DIFFERS,
            true if self.session.is_adopted() => UP,
            _ => DOWN,
        }
    }

    /// Whether the peer is heard on a network.
    #[must_use]
    pub fn is_up(&self, network: usize) -> bool {
        self.networks.get(network).is_some_and(Presence::is_up)
    }

    /// When the peer was heard on a network last, the own module time, ns; `None`: never.
    #[must_use]
    pub fn heard_ns(&self, network: usize) -> Option<u64> {
        self.networks.get(network).and_then(Presence::heard_ns)
    }

    /// What is known of the peer's clock.
    #[must_use]
    pub fn estimate(&self, now_ns: u64) -> Option<Estimate> {
        self.clock.estimate(now_ns)
    }

    /// The longest that a datagram was on its way on a network of late, and what the plan allows, ns; 0: nothing was measured, or
    /// nothing is said.
    #[must_use]
    pub fn transit_ns(&self, network: usize) -> (u64, u64) {
        self.transits.get(network).map_or((0, 0), |transit| (transit.longest_ns(), transit.allowed_ns()))
    }

    /// The peer's major frame as of its latest datagram, in the peer's module time.
    #[must_use]
    pub fn peer_frame(&self) -> Option<Frame> {
        self.peer_frame
    }

    /// The number of the channel at a place of the table.
    pub(crate) fn channel_id(&self, place: usize) -> Option<u16> {
        self.channel_ids.get(place).copied()
    }

    fn tag_bytes(&self) -> usize {
        if self.seals.is_some() { TAG_BYTES } else { 0 }
    }

    fn judge(&mut self, arrival: Arrival, datagram: &[u8], sink: Sink<'_>) -> Result<(), Rejection> {
        let header = wire::parse(datagram, self.max_datagram)?;
        if header.link.get() != self.id {
            return Err(Rejection::Link);
        }
        let body = self.authentic(header, arrival.network, datagram)?;
        let header = *header;
        let newest = self.meet(&header, arrival, sink)?;
        if header.plan != self.plan {
            self.met_other_plan(&header, body);
            return Err(Rejection::Plan);
        }
        let Some(newest) = newest else { return Ok(()) }; // a copy: all is known
        (self.differs, self.said) = (false, None);
        self.take_time(&header, arrival, newest);
        self.note_state();
        match header.kind {
            KIND_MESSAGES => self.take_messages(&header, body, arrival.now_ns, sink),
            KIND_SECTIONS => Ok(()), // the plans agree again
            _ => Err(Rejection::Malformed),
        }
    }

    /// What stands between header and tag of a datagram with the right tag.
    fn authentic<'a>(
        &self,
        header: &Header,
        network: usize,
        datagram: &'a [u8],
    ) -> Result<&'a [u8], Rejection> {
        let Some((_, seal)) = &self.seals else {
            let plain = header.tagged.get() == 0;
            return if plain { Ok(&datagram[HEADER_BYTES..]) } else { Err(Rejection::Key) };
        };
        let end = datagram.len() - TAG_BYTES.min(datagram.len());
        if header.tagged.get() != 1 || end < HEADER_BYTES {
            return Err(Rejection::Key);
        }
        let (bytes, tag) = datagram.split_at(end);
        if seal.fits(bytes, network, tag) { Ok(&bytes[HEADER_BYTES..]) } else { Err(Rejection::Key) }
    }

    /// Life and number. Gives whether it is the newest datagram; nothing for one that has come before.
    fn meet(&mut self, header: &Header, arrival: Arrival, sink: Sink<'_>) -> Result<Option<bool>, Rejection> {
        let claim = Claim {
            session: header.session.get(),
            to_session: header.to_session.get(),
            challenge: header.challenge.get(),
            answer: header.answer.get(),
        };
        let sequence = header.sequence.get();
        let newest = self.sequences.as_ref().is_none_or(|sequences| sequences.is_newest(sequence));
        match self.session.meet(&claim, newest) {
            Verdict::Unproven => return Err(Rejection::Restart),
            Verdict::Born => self.begin_life(sequence, sink),
            Verdict::Present => {}
        }
        let Some(sequences) = &mut self.sequences else { return Err(Rejection::Restart) };
        let newest = sequences.is_newest(sequence);
        let seen = sequences.note(sequence, arrival.network, arrival.came_ns);
        let counters = &mut self.counters.networks[arrival.network];
        let first = match seen {
            Seen::Before => return Err(Rejection::Restart),
            Seen::TooOld => return Err(Rejection::Replay),
            Seen::Again => {
                counters.duplicated += 1;
                return Ok(None);
            }
            Seen::Copy { reordered, after_ns } => {
                counters.redundant += 1;
                counters.reordered += u64::from(reordered);
                counters.late += u64::from(after_ns > self.skew_ns);
                false
            }
            Seen::First { reordered } => {
                counters.reordered += u64::from(reordered);
                true
            }
        };
        let change = self.networks[arrival.network].heard_at(arrival.came_ns, arrival.now_ns);
        self.note_network(arrival.network, change);
        self.take_transit(header, arrival);
        Ok(first.then_some(newest))
    }

    /// How long a datagram of the peer's life was on its way, as far as the peer's clock is known.
    fn take_transit(&mut self, header: &Header, arrival: Arrival) {
        let Some(estimate) = self.clock.estimate(arrival.now_ns) else { return };
        let left_ns = clock::own_ns(header.sent_ns.get(), estimate.offset_ns);
        let took_ns = arrival.came_ns.saturating_sub(left_ns);
        let network = arrival.network;
        let transit = &mut self.transits[network];
        let allowed_ns = transit.allowed_ns();
        match transit.took(took_ns, estimate.exchanges, arrival.now_ns) {
            None => {}
            Some(transit::Change::Slow(took_ns)) => {
                self.note(Event::NetworkSlow { network, took_ns, allowed_ns })
            }
            Some(transit::Change::InTime) => self.note(Event::NetworkInTime(network)),
        }
    }

    fn begin_life(&mut self, sequence: u64, sink: Sink<'_>) {
        if let Some(before) = self.sequences.replace(Sequences::new(sequence)) {
            self.lost_before.0 += before.lost();
            for network in 0..self.networks.len() {
                self.lost_before.1[network] += before.lost_at_end(network);
            }
            self.again = true;
            self.note(Event::PeerRestarted);
        }
        self.counters.peer_lives += 1;
        self.clock.forget();
        self.echo = (0, 0);
        self.peer_frame = None;
        self.outgoing.restart();
        let Self { incoming, events, .. } = self;
        for channel in incoming.iter_mut().flatten() {
            channel.restart(&mut noting(events, sink));
        }
    }

    fn take_time(&mut self, header: &Header, arrival: Arrival, newest: bool) {
        let exchange = Exchange {
            sent_ns: header.echo_sent_ns.get(),
            peer_came_ns: header.echo_came_ns.get(),
            peer_sent_ns: header.sent_ns.get(),
            came_ns: arrival.came_ns,
        };
        if exchange.sent_ns > 0 {
            self.clock.take(&exchange);
        }
        if newest {
            self.echo = (header.sent_ns.get(), arrival.came_ns);
            self.peer_frame = Some(Frame { number: header.frame.get(), start_ns: header.frame_ns.get() });
        }
    }

    fn met_other_plan(&mut self, header: &Header, body: &[u8]) {
        let told = std::mem::replace(&mut self.differs, true);
        let said = match header.kind {
            KIND_SECTIONS => self.sections.compare(body, header.count.get()),
            _ => None,
        };
        if !told {
            self.note_difference(String::new());
        }
        if let Some(what) = said {
            self.note_difference(what);
        }
        self.note_state();
    }

    fn note_difference(&mut self, what: String) {
        let event = Event::PlanDiffers(what);
        if self.said.as_ref() != Some(&event) {
            self.said = Some(event.clone());
            self.note(event);
        }
    }

    fn take_messages(
        &mut self,
        header: &Header,
        body: &[u8],
        now_ns: u64,
        sink: Sink<'_>,
    ) -> Result<(), Rejection> {
        let mut count = 0;
        for part in Parts(body) {
            let part = part?;
            self.channel(&part).ok_or(Rejection::Channel)?.accepts(&part)?;
            count += 1;
        }
        if count != header.count.get() {
            return Err(Rejection::Malformed);
        }
        if count > 0 && header.to_session.get() != self.session.own() {
            return Err(Rejection::Restart); // meant for a life of this end that is over
        }
        let offset_ns = self.offset_ns(header, now_ns);
        let Self { incoming, events, .. } = self;
        let sink = &mut noting(events, sink);
        for part in Parts(body).flatten() {
            if let Some(Some(channel)) = incoming.get_mut(usize::from(part.channel)) {
                channel.take(&part, clock::own_ns(part.source_ns, offset_ns), now_ns, sink);
            }
        }
        Ok(())
    }

    /// The peer's clock less the own one; before the first exchange as if the way took no time.
    fn offset_ns(&self, header: &Header, now_ns: u64) -> i64 {
        let unknown = || clock::difference(header.sent_ns.get(), self.echo.1).unwrap_or(0);
        self.clock.estimate(now_ns).map_or_else(unknown, |estimate| estimate.offset_ns)
    }

    fn channel(&self, part: &Part<'_>) -> Option<&Incoming> {
        self.incoming.get(usize::from(part.channel))?.as_ref()
    }

    fn note_network(&mut self, network: usize, change: Option<Change>) {
        match change {
            None | Some(Change::First) => {}
            Some(Change::Back) => self.note(Event::NetworkUp(network)),
            Some(Change::Gone) => self.note(Event::NetworkDown(network)),
            Some(Change::Never) => self.note(Event::NetworkSilent(network)),
        }
    }

    fn note_state(&mut self) {
        let up = self.state() == UP;
        if std::mem::replace(&mut self.was_up, up) != up {
            self.again |= up;
            self.note(if up { Event::Up } else { Event::Down });
        }
    }

    pub(crate) fn note(&mut self, event: Event) {
        push(&mut self.events, event);
    }
}

const LENGTH_AT: usize = std::mem::offset_of!(Header, length);
const COUNT_AT: usize = std::mem::offset_of!(Header, count);
const SENT_AT: usize = std::mem::offset_of!(Header, sent_ns);

fn push(events: &mut VecDeque<Event>, event: Event) {
    if events.len() < EVENTS {
        events.push_back(event);
    }
}

/// Hands on to `sink`, and notes the queues that are full.
fn noting<'a>(
    events: &'a mut VecDeque<Event>,
    sink: Sink<'a>,
) -> impl FnMut(crate::Delivery<'_>) -> bool + 'a {
    move |delivery| {
        let taken = sink(delivery);
        let event = Event::Overflow(delivery.channel);
        if !taken && events.back() != Some(&event) {
            push(events, event);
        }
        taken
    }
}

fn check(link: &LinkTable, key: &Key) -> Result<(), LinkError> {
    let name = || link.name.clone();
    if !(1..=NETWORKS).contains(&link.paths.len()) {
        return Err(LinkError::Networks { link: name(), found: link.paths.len() });
    }
    if (link.max_datagram as usize) < SHORTEST || link.max_datagram > LONGEST {
        return Err(LinkError::Datagram { link: name(), found: link.max_datagram });
    }
    let twice = |id: u16| link.channels.iter().filter(|channel| channel.id == id).count() > 1;
    if let Some(bad) = link.channels.iter().find(|channel| channel.id >= CHANNELS || twice(channel.id)) {
        return Err(LinkError::Channel { link: name(), id: bad.id });
    }
    if link.authenticated && key.iter().all(|byte| *byte == 0) {
        return Err(LinkError::NoKey(name()));
    }
    Ok(())
}

/// The first half of a digest.
fn digest(digits: &str) -> Option<[u8; 16]> {
    if digits.len() != bateleur_contract::relay::DIGEST_DIGITS
        || !digits.bytes().all(|digit| digit.is_ascii_hexdigit())
    {
        return None;
    }
    let mut digest = [0; 16];
    for (place, byte) in digest.iter_mut().enumerate() {
        *byte = u8::from_str_radix(digits.get(2 * place..2 * place + 2)?, 16).ok()?;
    }
    Some(digest)
}
