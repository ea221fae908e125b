//! The gateway without its sockets: frames and datagrams in, frames and datagrams out, time as an argument.
//!
//! Responsible for: the states (start, address, discover, forward), who the targets are and whether they are still there, the
//! frames between bus and network, and counting whatever becomes of them. It must never send a frame back to where it came
//! from, and never drop one without counting it.

use std::fmt;
use std::hash::{BuildHasher, RandomState};
use std::net::{IpAddr, SocketAddr};

use serde::Serialize;

use crate::Ids;
use crate::counters::Counters;
use crate::events::{Event, Events};
use crate::frame::Frame;
use crate::ring::{Ring, Rules};
use crate::track::{Tally, Track};
use crate::wire::cannelloni;
use crate::wire::native::{self, Aged, Header, Purpose, Refusal};

/// Targets that one gateway has at most: each gets every datagram.
pub const MAX_TARGETS: usize = 32;
/// Senders that wait for an answer with which they can show that they get what is sent to their address, most: as many as the program
/// takes datagrams in a turn, so that none drives out another.
const UNPROVEN: usize = 256;
/// What was heard of a gateway of an identity that another has is true for so long, ns.
const CONFLICT_NS: u64 = 10_000_000_000;
/// Old sessions of a target that are remembered. One that is used again shows that two gateways have one identity.
const LIVES: usize = 4;
/// So often a target has to change between its lives before two are behind it: datagrams of one that was started anew may be late.
const FLIPS: u32 = 3;

/// What a gateway speaks over UDP.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Protocol {
    /// [`native`]: discovery, keep-alive, numbers.
    #[default]
    Native,
    /// [`cannelloni`]: to fixed peers.
    Cannelloni,
}

/// How a gateway behaves.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Settings {
    /// What is spoken.
    pub protocol: Protocol,
    /// Who it is; no two in one network may have the same.
    pub identity: u64,
    /// Another one with each start.
    pub session: u32,
    /// Where discovery goes (broadcast addresses, or single ones); with cannelloni: the peers.
    pub discover: Vec<SocketAddr>,
    /// How often, as long as there is no target, ns.
    pub discover_every_ns: u64,
    /// How often, while there are some, ns.
    pub rediscover_every_ns: u64,
    /// How often it tells its targets that it is there, ns.
    pub alive_every_ns: u64,
    /// After so long without a word a target is lost, ns.
    pub lost_after_ns: u64,
    /// A frame waits so long for others to share its datagram, at most, ns.
    pub flush_after_ns: u64,
    /// Frames from the bus that go to the network.
    pub forward: Ids,
    /// What the ring between bus and network does.
    pub ring: Rules,
    /// Where others may come from; empty: anywhere.
    pub only_from: Vec<IpAddr>,
}

impl Settings {
    /// The usual times, for a gateway that looks for others at `discover`.
    pub fn new(identity: u64, session: u32, discover: Vec<SocketAddr>) -> Self {
        Self {
            protocol: Protocol::Native,
            identity,
            session,
            discover,
            discover_every_ns: 500_000_000,
            rediscover_every_ns: 5_000_000_000,
            alive_every_ns: 1_000_000_000,
            lost_after_ns: 3_500_000_000,
            flush_after_ns: 0,
            forward: Ids::All,
            ring: Rules { capacity: 4_096, max_age_ns: 1_000_000_000, newest_wins: Ids::None },
            only_from: Vec::new(),
        }
    }
}

/// Where a gateway is in its life.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum State {
    /// It waits for its bus.
    Start,
    /// It waits for an address of its own.
    Address,
    /// It asks who is there.
    Discover,
    /// It has at least one target.
    Forward,
}

impl fmt::Display for State {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Start => "start",
            Self::Address => "address",
            Self::Discover => "discover",
            Self::Forward => "forward",
        })
    }
}

/// A gateway, or a flight computer, that gets our frames.
#[derive(Debug)]
struct Target {
    identity: u64,
    session: u32,
    address: SocketAddr,
    /// What it wants back.
    cookie: u64,
    heard_ns: u64,
    /// Nothing was heard of it for too long, or it left: it gets nothing.
    lost: bool,
    track: Track,
    tally: Tally,
    missing_told: u64,
    /// Sessions that it had before, the newest last.
    former: Vec<u32>,
    /// How often it was again one of those, within [`CONFLICT_NS`] each; and when it was last.
    flips: u32,
    flipped_ns: u64,
}

/// A target as others see it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct TargetStatus {
    /// Who; 16 hexadecimal digits. Of a peer without identity, zeros.
    pub identity: String,
    /// Where.
    pub address: SocketAddr,
    /// It is there.
    pub present: bool,
    /// When it was heard last, ns before now.
    pub silent_ns: u64,
    /// Two gateways have this identity.
    pub shared: bool,
    /// What came from it.
    #[serde(flatten)]
    pub tally: Tally,
}

/// See the module's text.
#[derive(Debug)]
pub struct Gateway {
    settings: Settings,
    state: State,
    targets: Vec<Target>,
    /// Of targets that made room for others.
    former: Tally,
    ring: Ring,
    /// Bytes that the frames in the ring need in datagrams.
    ring_bytes: usize,
    sequence: u32,
    frame_number: u32,
    discover_at_ns: u64,
    alive_at_ns: u64,
    counters: Counters,
    events: Events,
    /// The time of the last call that had one, ns.
    now_ns: u64,
    conflict: Option<(SocketAddr, u64)>,
    /// What it makes of an address nobody can foresee who does not get what is sent there.
    cookies: RandomState,
    /// Who did not show a cookie, and what he wants back himself.
    unproven: Vec<(SocketAddr, u64)>,
    outgoing: Vec<Aged>,
    incoming: Vec<Aged>,
    plain: Vec<Frame>,
    datagram: Vec<u8>,
}

impl Gateway {
    /// One that has neither bus nor address yet.
    pub fn new(settings: Settings) -> Self {
        Self {
            ring: Ring::new(settings.ring.clone()),
            settings,
            state: State::Start,
            targets: Vec::new(),
            former: Tally::default(),
            ring_bytes: 0,
            sequence: 0,
            frame_number: 0,
            discover_at_ns: 0,
            alive_at_ns: 0,
            counters: Counters::default(),
            events: Events::default(),
            now_ns: 0,
            conflict: None,
            cookies: RandomState::new(),
            unproven: Vec::new(),
            outgoing: Vec::new(),
            incoming: Vec::new(),
            plain: Vec::new(),
            datagram: Vec::with_capacity(native::DATAGRAM_BYTES),
        }
    }

    /// The state.
    pub fn state(&self) -> State {
        self.state
    }

    /// What became of everything so far.
    pub fn counters(&self) -> Counters {
        let mut counters = self.counters;
        counters.to_network = self.ring.given_up();
        counters.events_untold = self.events.untold();
        let mut tally = self.former;
        self.targets.iter().for_each(|target| tally += target.tally);
        counters.lost_datagrams = tally.lost_datagrams;
        counters.lost_frames = tally.lost_frames;
        counters.late_datagrams = tally.late;
        counters.repeated_datagrams = tally.repeated;
        counters
    }

    /// Frames that wait for the network.
    pub fn waiting(&self) -> usize {
        self.ring.len()
    }

    /// Whom it knows, also those that are lost.
    pub fn targets(&self, now_ns: u64) -> Vec<TargetStatus> {
        let status = |target: &Target| TargetStatus {
            identity: format!("{:016x}", target.identity),
            address: target.address,
            present: !target.lost,
            silent_ns: now_ns.saturating_sub(target.heard_ns),
            shared: target.is_shared(now_ns),
            tally: target.tally,
        };
        self.targets.iter().map(status).collect()
    }

    /// Where another gateway with the same identity was heard in the last ten seconds.
    pub fn conflict(&self, now_ns: u64) -> Option<SocketAddr> {
        self.conflict.filter(|(_, heard_ns)| now_ns < heard_ns + CONFLICT_NS).map(|(address, _)| address)
    }

    /// The next thing that happened.
    pub fn event(&mut self) -> Option<Event> {
        self.events.pop()
    }

    /// The bus is there.
    pub fn bus_is_ready(&mut self) {
        if self.state == State::Start {
            self.enter(State::Address);
        }
    }

    /// It has an address.
    pub fn address_is_ready(&mut self, now_ns: u64) {
        if !matches!(self.state, State::Start | State::Address) {
            return;
        }
        self.now_ns = now_ns;
        (self.discover_at_ns, self.alive_at_ns) = (now_ns, now_ns);
        if self.settings.protocol == Protocol::Cannelloni {
            // Its peers have no names, and say nothing of themselves.
            for address in self.settings.discover.clone() {
                self.targets.push(Target::new(0, 0, address, 0, now_ns));
            }
            self.enter(State::Forward);
        } else {
            self.enter(State::Discover);
        }
    }

    /// A frame came from the bus, written by somebody else.
    pub fn take_frame(&mut self, frame: &Frame, now_ns: u64) {
        if frame.is_of_the_bus() {
            self.counters.bus_in += 1;
        } else {
            self.counters.bus_errors += 1;
            if self.settings.protocol == Protocol::Cannelloni {
                return;
            }
        }
        if !self.settings.forward.contain(frame.id()) && frame.is_of_the_bus() {
            self.counters.not_forwarded += 1;
            return;
        }
        if self.ring.push(*frame, 0, now_ns) {
            self.ring_bytes += native::size(frame);
        }
    }

    /// A datagram came. Frames for the bus go to `to_bus`, with their age.
    pub fn take_datagram(
        &mut self,
        bytes: &[u8],
        from: SocketAddr,
        now_ns: u64,
        mut to_bus: impl FnMut(&Frame, u64),
    ) {
        self.now_ns = now_ns;
        self.counters.datagrams_in += 1;
        if !self.settings.only_from.is_empty() && !self.settings.only_from.contains(&from.ip()) {
            self.counters.strangers += 1;
            return;
        }
        match self.settings.protocol {
            Protocol::Native => self.take_native(bytes, from, now_ns, &mut to_bus),
            Protocol::Cannelloni => self.take_cannelloni(bytes, from, now_ns, &mut to_bus),
        }
    }

    fn take_native(
        &mut self,
        bytes: &[u8],
        from: SocketAddr,
        now_ns: u64,
        to_bus: &mut impl FnMut(&Frame, u64),
    ) {
        let mut frames = std::mem::take(&mut self.incoming);
        frames.clear();
        match native::decode(bytes, &mut frames) {
            Ok(header) => {
                if self.believes(&header, from, now_ns, frames.len()) {
                    self.counters.network_in += frames.len() as u64;
                    frames.iter().for_each(|aged| self.hand_over(aged, to_bus));
                }
            }
            Err(refusal) => self.refuse(refusal, from),
        }
        self.incoming = frames;
    }

    fn hand_over(&mut self, aged: &Aged, to_bus: &mut impl FnMut(&Frame, u64)) {
        match aged.frame.is_of_the_bus() {
            true => to_bus(&aged.frame, aged.age_ns),
            // Of another bus: to be known, not to be sent.
            false => self.counters.remote_errors += 1,
        }
    }

    /// Who sent it, and what it means for us. True: its frames are to be taken.
    fn believes(&mut self, header: &Header, from: SocketAddr, now_ns: u64, frames: usize) -> bool {
        if header.identity == self.settings.identity {
            if header.session == self.settings.session {
                self.counters.own_echoes += 1;
            } else {
                self.note_conflict(from, now_ns);
            }
            return false;
        }
        if header.echo != self.cookie(from) {
            self.ask_for_proof(header, from, frames);
            return false;
        }
        if header.purpose == Purpose::Leaving {
            self.leave_by(header);
            return false;
        }
        let Some(place) = self.target(header, from, now_ns) else {
            self.counters.strangers += 1;
            return false;
        };
        let target = &mut self.targets[place];
        match header.purpose {
            Purpose::Frames => {
                let taken =
                    target.track.note(header.sequence, header.first_frame, frames as u32, &mut target.tally);
                self.tell_missing(place);
                taken
            }
            _ => {
                target.track.hear_of(header.sequence, header.first_frame, &mut target.tally);
                if header.purpose == Purpose::Discover {
                    // Answered with the next call of `run`.
                    self.alive_at_ns = now_ns;
                }
                self.tell_missing(place);
                false
            }
        }
    }

    /// What whoever gets datagrams at an address can send back; never 0.
    fn cookie(&self, address: SocketAddr) -> u64 {
        self.cookies.hash_one(address).max(1)
    }

    /// Anybody can write any address on a datagram. Who does not show that he gets what is sent there is told how with the next call
    /// of `run`, in no more bytes than his had, and nothing else of his is believed.
    fn ask_for_proof(&mut self, header: &Header, from: SocketAddr, frames: usize) {
        if header.purpose != Purpose::Discover || header.echo != 0 {
            self.counters.unproven_datagrams += 1;
            self.counters.unproven_frames += frames as u64;
        }
        if header.purpose == Purpose::Leaving {
            return;
        }
        // A target that asks everybody has sent its cookie before.
        let known =
            self.targets.iter().find(|target| target.address == from).map_or(0, |target| target.cookie);
        let answer = (from, if header.cookie == 0 { known } else { header.cookie });
        if self.unproven.len() < UNPROVEN && !self.unproven.contains(&answer) {
            self.unproven.push(answer);
        }
    }

    fn answer_unproven(&mut self, send: &mut impl FnMut(SocketAddr, &[u8]) -> bool) {
        for (address, echo) in std::mem::take(&mut self.unproven) {
            let header = Header { cookie: self.cookie(address), echo, ..self.header(Purpose::Discover) };
            native::encode(&header, &mut self.datagram);
            self.count_sent(send(address, &self.datagram));
        }
    }

    fn count_sent(&mut self, is_sent: bool) {
        match is_sent {
            true => self.counters.datagrams_out += 1,
            false => self.counters.unsent_datagrams += 1,
        }
    }

    /// The place of the target that sent `header`; it is made where it is new.
    fn target(&mut self, header: &Header, from: SocketAddr, now_ns: u64) -> Option<usize> {
        let known = self.targets.iter().position(|target| target.identity == header.identity);
        let Some(place) = known else {
            if self.targets.len() == MAX_TARGETS {
                let lost = self.targets.iter().position(|target| target.lost)?;
                self.former += self.targets.swap_remove(lost).tally;
            }
            self.targets.push(Target::new(header.identity, header.session, from, header.cookie, now_ns));
            self.tell(Event::Found { identity: header.identity, address: from, again: false });
            self.alive_at_ns = now_ns;
            self.enter(State::Forward);
            return Some(self.targets.len() - 1);
        };
        let target = &mut self.targets[place];
        let (was_lost, restarted) = (target.lost, target.session != header.session);
        let before = std::mem::replace(&mut target.address, from);
        (target.cookie, target.heard_ns, target.lost) = (header.cookie, now_ns, false);
        if restarted && target.is_former_life(header.session, now_ns) {
            self.counters.target_flips += 1;
            if target.is_shared(now_ns) {
                self.tell(Event::Shared { identity: header.identity, addresses: [before, from] });
            }
        } else if restarted {
            self.counters.target_restarts += 1;
            self.tell(Event::Restarted { identity: header.identity });
        }
        if was_lost {
            self.tell(Event::Found { identity: header.identity, address: from, again: true });
            self.enter(State::Forward);
        }
        if was_lost || restarted {
            self.alive_at_ns = now_ns;
        }
        Some(place)
    }

    /// What an earlier start of it says late is over.
    fn leave_by(&mut self, header: &Header) {
        let is_it = |target: &&mut Target| {
            (target.identity, target.session, target.lost) == (header.identity, header.session, false)
        };
        let Some(target) = self.targets.iter_mut().find(is_it) else { return };
        target.lost = true;
        self.tell(Event::Left { identity: header.identity });
        self.look_again();
    }

    fn note_conflict(&mut self, from: SocketAddr, now_ns: u64) {
        self.counters.same_identity += 1;
        self.conflict = Some((from, now_ns));
        self.tell(Event::SameIdentity { address: from });
    }

    fn refuse(&mut self, refusal: Refusal, from: SocketAddr) {
        match refusal {
            Refusal::Foreign => self.counters.foreign += 1,
            Refusal::Version(_) => self.counters.other_version += 1,
            _ => self.counters.malformed += 1,
        }
        self.tell(Event::Refused { address: from, refusal });
    }

    /// Says how many are missing, where that has become twice as many: a lossy network must not fill a log.
    fn tell_missing(&mut self, place: usize) {
        let target = &mut self.targets[place];
        let (identity, datagrams) = (target.identity, target.tally.lost_datagrams);
        if datagrams >= 2 * target.missing_told.max(1) || (datagrams == 1 && target.missing_told == 0) {
            target.missing_told = datagrams;
            self.tell(Event::Missing { identity, datagrams });
        }
    }

    fn take_cannelloni(
        &mut self,
        bytes: &[u8],
        from: SocketAddr,
        now_ns: u64,
        to_bus: &mut impl FnMut(&Frame, u64),
    ) {
        let Some(place) = self.targets.iter().position(|target| target.address == from) else {
            self.counters.strangers += 1;
            return;
        };
        let mut frames = std::mem::take(&mut self.plain);
        frames.clear();
        match cannelloni::decode(bytes, &mut frames) {
            Some(arrival) => {
                let target = &mut self.targets[place];
                target.heard_ns = now_ns;
                // Its numbers are counted and decide nothing.
                target.track.note_byte(arrival.sequence, frames.len() as u32, &mut target.tally);
                self.counters.malformed += u64::from(arrival.damaged);
                self.counters.network_in += frames.len() as u64;
                for frame in &frames {
                    self.hand_over(&Aged { frame: *frame, age_ns: 0 }, to_bus);
                }
            }
            None => self.counters.foreign += 1,
        }
        self.plain = frames;
    }

    /// When [`Gateway::run`] has something to do next, ns.
    pub fn due_ns(&self) -> u64 {
        if matches!(self.state, State::Start | State::Address) {
            return u64::MAX;
        }
        if !self.unproven.is_empty() {
            return 0;
        }
        let mut due_ns = u64::MAX;
        if self.settings.protocol == Protocol::Native {
            due_ns = self.discover_at_ns;
            for target in self.targets.iter().filter(|target| !target.lost) {
                due_ns = due_ns
                    .min(self.alive_at_ns)
                    .min(target.heard_ns.saturating_add(self.settings.lost_after_ns));
            }
        }
        due_ns.min(self.flush_at_ns())
    }

    /// When the frames that wait have to go.
    fn flush_at_ns(&self) -> u64 {
        match (self.state, self.ring.oldest_ns()) {
            (State::Forward, Some(_)) if self.is_full() => 0,
            (State::Forward, Some(oldest_ns)) => oldest_ns.saturating_add(self.settings.flush_after_ns),
            _ => u64::MAX,
        }
    }

    fn is_full(&self) -> bool {
        self.ring_bytes + native::HEADER_BYTES + native::FRAME_BYTES + crate::frame::FD_BYTES
            > native::DATAGRAM_BYTES
    }

    /// Does what is due. `send` puts a datagram on the network, and says whether it could.
    pub fn run(&mut self, now_ns: u64, send: &mut impl FnMut(SocketAddr, &[u8]) -> bool) {
        self.now_ns = now_ns;
        self.events.tend(now_ns);
        if matches!(self.state, State::Start | State::Address) {
            return;
        }
        if self.settings.protocol == Protocol::Native {
            self.answer_unproven(send);
            self.lose_silent(now_ns);
            self.discover(now_ns, send);
            self.keep_alive(now_ns, send);
        }
        if self.flush_at_ns() <= now_ns {
            self.flush(now_ns, send);
        } else if self.state != State::Forward {
            self.ring.expire(now_ns);
        }
    }

    /// Sends the frames that wait, at once: at the end of a window.
    pub fn flush(&mut self, now_ns: u64, send: &mut impl FnMut(SocketAddr, &[u8]) -> bool) {
        if self.state != State::Forward || self.ring.is_empty() {
            return;
        }
        let mut outgoing = std::mem::take(&mut self.outgoing);
        outgoing.clear();
        self.ring.hand_out(now_ns, |aged| {
            outgoing.push(*aged);
            true
        });
        self.ring_bytes = 0;
        let mut rest = &outgoing[..];
        while !rest.is_empty() {
            let fitted = self.pack(rest);
            self.counters.network_out += fitted as u64;
            self.send_to_all(send);
            rest = &rest[fitted..];
        }
        self.outgoing = outgoing;
    }

    /// Fills a datagram; gives how many frames are in it, at least one.
    fn pack(&mut self, frames: &[Aged]) -> usize {
        let fitted = match self.settings.protocol {
            Protocol::Native => {
                native::encode(&self.header(Purpose::Frames), &mut self.datagram);
                frames.iter().take_while(|aged| native::append(aged, &mut self.datagram)).count()
            }
            Protocol::Cannelloni => {
                cannelloni::encode(self.sequence as u8, &mut self.datagram);
                frames.iter().take_while(|aged| cannelloni::append(&aged.frame, &mut self.datagram)).count()
            }
        };
        self.sequence = self.sequence.wrapping_add(1);
        self.frame_number = self.frame_number.wrapping_add(fitted as u32);
        fitted.max(1)
    }

    fn send_to_all(&mut self, send: &mut impl FnMut(SocketAddr, &[u8]) -> bool) {
        for place in 0..self.targets.len() {
            let Target { address, cookie, lost, .. } = self.targets[place];
            if lost {
                continue;
            }
            if self.settings.protocol == Protocol::Native {
                let own = self.cookie(address);
                native::address_to(&mut self.datagram, own, cookie);
            }
            self.count_sent(send(address, &self.datagram));
        }
    }

    /// Tells its targets that it ends.
    pub fn leave(&mut self, now_ns: u64, send: &mut impl FnMut(SocketAddr, &[u8]) -> bool) {
        self.flush(now_ns, send);
        if self.settings.protocol == Protocol::Native {
            native::encode(&self.header(Purpose::Leaving), &mut self.datagram);
            self.send_to_all(send);
        }
    }

    fn header(&self, purpose: Purpose) -> Header {
        Header {
            purpose,
            identity: self.settings.identity,
            session: self.settings.session,
            sequence: self.sequence,
            first_frame: self.frame_number,
            cookie: 0,
            echo: 0,
        }
    }

    fn lose_silent(&mut self, now_ns: u64) {
        let lost_after_ns = self.settings.lost_after_ns;
        let is_silent =
            |target: &Target| !target.lost && now_ns.saturating_sub(target.heard_ns) >= lost_after_ns;
        while let Some(place) = self.targets.iter().position(is_silent) {
            let target = &mut self.targets[place];
            target.lost = true;
            let (identity, address) = (target.identity, target.address);
            self.counters.targets_lost += 1;
            self.tell(Event::Lost { identity, address });
            self.discover_at_ns = now_ns;
            self.look_again();
        }
    }

    /// Without a target it asks again who is there.
    fn look_again(&mut self) {
        if self.targets.iter().all(|target| target.lost) {
            self.enter(State::Discover);
        }
    }

    fn discover(&mut self, now_ns: u64, send: &mut impl FnMut(SocketAddr, &[u8]) -> bool) {
        if now_ns < self.discover_at_ns {
            return;
        }
        let every_ns = match self.state {
            State::Forward => self.settings.rediscover_every_ns,
            _ => self.settings.discover_every_ns,
        };
        self.discover_at_ns = now_ns + every_ns;
        native::encode(&self.header(Purpose::Discover), &mut self.datagram);
        // Also where targets were last: a broadcast need not reach them.
        let lost = self.targets.iter().filter(|target| target.lost).map(|target| target.address);
        let addresses: Vec<SocketAddr> = self.settings.discover.iter().copied().chain(lost).collect();
        for address in addresses {
            self.count_sent(send(address, &self.datagram));
        }
    }

    fn keep_alive(&mut self, now_ns: u64, send: &mut impl FnMut(SocketAddr, &[u8]) -> bool) {
        if now_ns < self.alive_at_ns || self.targets.iter().all(|target| target.lost) {
            return;
        }
        self.alive_at_ns = now_ns + self.settings.alive_every_ns;
        native::encode(&self.header(Purpose::Alive), &mut self.datagram);
        self.send_to_all(send);
    }

    fn enter(&mut self, state: State) {
        if self.state != state {
            self.state = state;
            self.tell(Event::State(state));
        }
    }

    fn tell(&mut self, event: Event) {
        self.events.push(event, self.now_ns);
    }
}

impl Target {
    fn new(identity: u64, session: u32, address: SocketAddr, cookie: u64, now_ns: u64) -> Self {
        Self {
            identity,
            session,
            address,
            cookie,
            heard_ns: now_ns,
            lost: false,
            track: Track::default(),
            tally: Tally::default(),
            missing_told: 0,
            former: Vec::new(),
            flips: 0,
            flipped_ns: 0,
        }
    }

    /// It has another session now: whether it is one that it had before. One that is started anew never gets an old one back, so
    /// two take turns.
    fn is_former_life(&mut self, session: u32, now_ns: u64) -> bool {
        let before = std::mem::replace(&mut self.session, session);
        self.track = Track::default();
        let place = self.former.iter().position(|former| *former == session);
        if let Some(place) = place {
            self.former.remove(place);
            let is_recent = now_ns < self.flipped_ns + CONFLICT_NS;
            self.flips = if is_recent { self.flips.saturating_add(1) } else { 1 };
            self.flipped_ns = now_ns;
        } else if self.former.len() == LIVES {
            self.former.remove(0);
        }
        self.former.push(before);
        place.is_some()
    }

    /// Whether two gateways are behind it.
    fn is_shared(&self, now_ns: u64) -> bool {
        self.flips >= FLIPS && now_ns < self.flipped_ns + CONFLICT_NS
    }
}

#[cfg(test)]
#[path = "gateway_tests.rs"]
mod tests;
