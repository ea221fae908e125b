//! What a person should hear of, and how often.
//!
//! Responsible for: that a flood of one kind neither fills a log nor hides what else happens. Of each kind the first few are
//! told at once; what comes within ten seconds beyond those is told as a number when they are over.

use std::collections::VecDeque;
use std::fmt;
use std::net::SocketAddr;

use crate::gateway::State;
use crate::wire::native::Refusal;

/// Events that wait for whoever tells them; more are counted alone.
const MOST: usize = 64;
/// Kinds are counted over so long, ns.
const PERIOD_NS: u64 = 10_000_000_000;

/// What a person should hear of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Event {
    /// It is in another state.
    State(State),
    /// A target answered.
    Found {
        /// Who.
        identity: u64,
        /// Where.
        address: SocketAddr,
        /// It was a target before and had been lost.
        again: bool,
    },
    /// A target was started anew.
    Restarted {
        /// Who.
        identity: u64,
    },
    /// A target said nothing for too long.
    Lost {
        /// Who.
        identity: u64,
        /// Where it was.
        address: SocketAddr,
    },
    /// A target said that it goes.
    Left {
        /// Who.
        identity: u64,
    },
    /// Another gateway has the same identity: its frames are not taken.
    SameIdentity {
        /// Where it is.
        address: SocketAddr,
    },
    /// Something came that is none of ours.
    Refused {
        /// From where.
        address: SocketAddr,
        /// What was wrong with it.
        refusal: Refusal,
    },
    /// Datagrams did not come.
    Missing {
        /// Of whom.
        identity: u64,
        /// So many, so far.
        datagrams: u64,
    },
    /// Two others have one identity, and take turns in being one target of ours.
    Shared {
        /// Which.
        identity: u64,
        /// Where they are.
        addresses: [SocketAddr; 2],
    },
    /// More of one kind happened than a person wants to hear.
    More {
        /// What.
        what: &'static str,
        /// So often.
        times: u64,
    },
}

impl fmt::Display for Event {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::State(state) => write!(f, "state: {state}"),
            Self::Found { identity, address, again: false } => {
                write!(f, "found {identity:016x} at {address}")
            }
            Self::Found { identity, address, again: true } => {
                write!(f, "found {identity:016x} again at {address}")
            }
            Self::Restarted { identity } => write!(f, "{identity:016x} was started anew"),
            Self::Lost { identity, address } => {
                write!(f, "lost {identity:016x} at {address}: it says nothing any more")
            }
            Self::Left { identity } => write!(f, "{identity:016x} has ended"),
            Self::SameIdentity { address } => write!(
                f,
                "the gateway at {address} has the identity of this one: its frames are not taken; give each its own \
                 (--identity)"
            ),
            Self::Refused { address, refusal } => {
                write!(f, "a datagram from {address} is refused: {refusal}")
            }
            Self::Missing { identity, datagrams } => {
                write!(f, "{datagrams} datagrams of {identity:016x} are missing")
            }
            Self::Shared { identity, addresses: [one, other] } => write!(
                f,
                "the gateways at {one} and {other} have one identity, {identity:016x}: give each its own (--identity)"
            ),
            Self::More { what, times } => {
                write!(f, "{what}: {times} more in the last {} s", PERIOD_NS / 1_000_000_000)
            }
        }
    }
}

/// Each kind: its name for [`Event::More`], and how many of it are told in one period.
const KINDS: [(&str, u32); 11] = [
    ("changes of state", 8),
    ("targets found", 8),
    ("targets started anew", 4),
    ("targets lost", 8),
    ("targets ended", 8),
    ("datagrams of a gateway with the identity of this one", 1),
    ("foreign datagrams refused", 1),
    ("datagrams of another version refused", 1),
    ("flawed datagrams refused", 1),
    ("losses of datagrams", 4),
    ("changes between gateways of one identity", 1),
];

impl Event {
    /// Its place in [`KINDS`]; `None` if it is told in any case.
    fn kind(&self) -> Option<usize> {
        Some(match self {
            Self::State(_) => 0,
            Self::Found { .. } => 1,
            Self::Restarted { .. } => 2,
            Self::Lost { .. } => 3,
            Self::Left { .. } => 4,
            Self::SameIdentity { .. } => 5,
            Self::Refused { refusal: Refusal::Foreign, .. } => 6,
            Self::Refused { refusal: Refusal::Version(_), .. } => 7,
            Self::Refused { .. } => 8,
            Self::Missing { .. } => 9,
            Self::Shared { .. } => 10,
            Self::More { .. } => return None,
        })
    }
}

/// One kind in the current period.
#[derive(Debug, Clone, Copy, Default)]
struct Pace {
    since_ns: u64,
    told: u32,
    held_back: u64,
}

/// Events that wait to be told.
#[derive(Debug, Default)]
pub(crate) struct Events {
    queue: VecDeque<Event>,
    paces: [Pace; KINDS.len()],
    untold: u64,
}

impl Events {
    /// Something happened.
    pub(crate) fn push(&mut self, event: Event, now_ns: u64) {
        self.tend(now_ns);
        let may = match event.kind() {
            Some(kind) => {
                let (pace, (_, most)) = (&mut self.paces[kind], KINDS[kind]);
                if pace.told == 0 {
                    pace.since_ns = now_ns;
                }
                let may = pace.told < most && self.queue.len() < MOST;
                pace.told += u32::from(may);
                pace.held_back += u64::from(!may);
                may
            }
            None => self.queue.len() < MOST,
        };
        match may {
            true => self.queue.push_back(event),
            false => self.untold += 1,
        }
    }

    /// Time passes: what was held back in a period that is over is told as a number.
    pub(crate) fn tend(&mut self, now_ns: u64) {
        for (kind, (what, _)) in KINDS.iter().enumerate() {
            let pace = &mut self.paces[kind];
            if pace.told + u32::from(pace.held_back > 0) == 0 || now_ns < pace.since_ns + PERIOD_NS {
                continue;
            }
            let times = std::mem::take(pace).held_back;
            if times > 0 && self.queue.len() < MOST {
                self.queue.push_back(Event::More { what, times });
            }
        }
    }

    /// The next one.
    pub(crate) fn pop(&mut self) -> Option<Event> {
        self.queue.pop_front()
    }

    /// Those that were not told one by one.
    pub(crate) fn untold(&self) -> u64 {
        self.untold
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: u64 = 1_000_000_000;

    fn refused(port: u16) -> Event {
        Event::Refused { address: ([10, 9, 9, 9], port).into(), refusal: Refusal::Foreign }
    }

    fn told(events: &mut Events) -> Vec<Event> {
        std::iter::from_fn(|| events.pop()).collect()
    }

    #[test]
    fn flood_of_one_kind_is_told_once_and_then_as_a_number_and_hides_nothing_else() {
        let mut events = Events::default();
        let mut said = Vec::new();
        for millisecond in 0..100_000_u64 {
            // Another stranger each time.
            events.push(refused(millisecond as u16), millisecond * S / 1_000);
            if millisecond == 55_000 {
                events.push(Event::Left { identity: 7 }, millisecond * S / 1_000);
            }
            said.extend(told(&mut events));
        }
        assert!(said.contains(&Event::Left { identity: 7 }));
        assert!(said.len() <= 21, "{}: {said:?}", said.len());
        assert_eq!(said[0], refused(0));
        assert_eq!(said[1], Event::More { what: "foreign datagrams refused", times: 9_999 });
    }

    #[test]
    fn what_was_held_back_is_told_also_when_nothing_more_happens() {
        let mut events = Events::default();
        (0..3).for_each(|port| events.push(refused(port), S));
        assert_eq!(told(&mut events), [refused(0)]);
        events.tend(10 * S);
        assert_eq!(told(&mut events), []);
        events.tend(11 * S);
        let more = told(&mut events);
        assert_eq!(more[0].to_string(), "foreign datagrams refused: 2 more in the last 10 s");
        events.tend(60 * S);
        assert_eq!((told(&mut events).len(), more.len()), (0, 1));
        events.push(refused(9), 61 * S);
        assert_eq!(told(&mut events), [refused(9)], "after a while the first is told again");
    }

    #[test]
    fn nobody_who_listens_costs_bounded_memory_and_what_was_not_told_is_counted() {
        let mut events = Events::default();
        for second in 0..1_000 {
            events.push(refused(1), 20 * second * S);
        }
        assert_eq!((told(&mut events).len() as u64, events.untold()), (64, 1_000 - 64));
    }
}
