//! What comes in: joins pieces, keeps the order of queues and the newest of sampling channels, and hands messages on.
//!
//! Responsible for: everything about one channel that comes in here. Memory is bounded by the plan: [`JOINED`] messages that are
//! being joined, and [`HELD`] messages of a queue that wait for one before them. It must never hand on a message twice, nor an
//! older one after a newer one.

use std::collections::VecDeque;

use bateleur_contract::PortKind;
use bateleur_contract::relay::RelayChannel;

use crate::outgoing::LEAST_PIECE;
use crate::wire::{Part, Rejection};

/// Messages of a queue that wait for one that is missing before them, most; fewer where the queue is shorter.
const HELD: usize = 64;

/// Messages of a channel that are joined at a time, the newest: pieces of one message may be overtaken by those of the next.
const JOINED: usize = 2;

/// A message for a port here.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Delivery<'a> {
    /// The channel's place in the link's table.
    pub channel: usize,
    /// When its source wrote it, own module time, ns.
    pub source_ns: u64,
    /// The source's own count of its messages, its low half.
    pub sequence: u32,
    /// The message.
    pub bytes: &'a [u8],
}

/// Takes messages; false: the queue is full.
pub(crate) type Sink<'a> = &'a mut dyn FnMut(Delivery<'_>) -> bool;

/// How long things wait.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Patience {
    /// For a message that is missing in a queue, ns.
    pub(crate) missing_ns: u64,
    /// For the next piece of a message, ns.
    pub(crate) piece_ns: u64,
}

/// What became of messages.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Tally {
    pub(crate) received: u64,
    pub(crate) late: u64,
    pub(crate) overflowed: u64,
}

struct Held {
    sequence: u64,
    source: (u64, u32),
    bytes: Vec<u8>,
    came_ns: u64,
}

/// A message of which pieces have come.
#[derive(Default)]
struct Joining {
    /// `None` if there is no such message.
    sequence: Option<u64>,
    bytes: Vec<u8>,
    /// From, to; in order.
    came: Vec<(u32, u32)>,
    last_ns: u64,
}

/// One channel.
pub(crate) struct Incoming {
    place: usize,
    kind: PortKind,
    plain: bool,
    max_bytes: usize,
    most_held: usize,
    /// The least number that may still be handed on.
    next: u64,
    /// Numbers that have been seen begin at 0 and end before this.
    end: u64,
    /// Messages that came in whole, of the peer's present life.
    whole: u64,
    held: VecDeque<Held>,
    joining: [Joining; JOINED],
    tally: Tally,
    lost_before: u64,
    /// Of a queue: the source's count of its newest message, and whether it came from a life of the peer that is over.
    last_source: Option<(u32, bool)>,
}

impl Incoming {
    pub(crate) fn new(place: usize, channel: &RelayChannel) -> Self {
        Self {
            place,
            kind: channel.kind,
            plain: channel.plain,
            max_bytes: channel.max_bytes as usize,
            most_held: HELD.min(channel.depth as usize),
            next: 0,
            end: 0,
            whole: 0,
            held: VecDeque::new(),
            joining: Default::default(),
            tally: Tally::default(),
            lost_before: 0,
            last_source: None,
        }
    }

    /// Whether a part can be one of this channel.
    pub(crate) fn accepts(&self, part: &Part<'_>) -> Result<(), Rejection> {
        let length = part.piece.map_or(part.bytes.len(), |(total, _)| total as usize);
        self.kind.carries(self.plain, self.max_bytes, length).then_some(()).ok_or(Rejection::Channel)
    }

    /// The peer begins a new life: its numbers begin at 0.
    pub(crate) fn restart(&mut self, sink: Sink<'_>) {
        self.let_go(sink); // they came, and nothing before them will
        self.joining.iter_mut().for_each(|joining| joining.sequence = None);
        self.lost_before += self.lost_now();
        (self.next, self.end, self.whole) = (0, 0, 0);
        self.last_source = self.last_source.map(|(last, _)| (last, true));
    }

    /// Takes a part whose source wrote it at `source_ns`, own time.
    pub(crate) fn take(&mut self, part: &Part<'_>, source_ns: u64, now_ns: u64, sink: Sink<'_>) {
        let sequence = extended(self.end, part.sequence);
        self.end = self.end.max(sequence + 1);
        let source = (source_ns, part.source_sequence);
        match part.piece {
            None => self.take_whole(sequence, source, part.bytes, now_ns, sink),
            Some((total, offset)) => {
                let Some(place) = self.place_to_join(sequence, total) else { return };
                if self.joining[place].add(offset, part.bytes, now_ns) {
                    let bytes = std::mem::take(&mut self.joining[place].bytes);
                    self.take_whole(sequence, source, &bytes, now_ns, sink);
                    self.joining[place].bytes = bytes;
                }
            }
        }
    }

    /// Time passes.
    pub(crate) fn look(&mut self, now_ns: u64, patience: &Patience, sink: Sink<'_>) {
        for joining in &mut self.joining {
            if now_ns.saturating_sub(joining.last_ns) > patience.piece_ns {
                joining.sequence = None;
            }
        }
        // What is missing has been missing since the first of those behind it came.
        while let Some(since_ns) = self.held.iter().map(|held| held.came_ns).min()
            && now_ns.saturating_sub(since_ns) >= patience.missing_ns
        {
            self.skip(sink);
        }
    }

    /// What became of the messages so far.
    pub(crate) fn tally(&self) -> Tally {
        self.tally
    }

    /// Messages that did not come, as far as later ones show.
    pub(crate) fn lost(&self) -> u64 {
        self.lost_before + self.lost_now()
    }

    fn lost_now(&self) -> u64 {
        // One whose pieces still come is not lost.
        let joining = self.joining.iter().filter(|joining| joining.sequence.is_some()).count() as u64;
        self.end.saturating_sub(self.whole).saturating_sub(joining)
    }

    fn take_whole(&mut self, sequence: u64, source: (u64, u32), bytes: &[u8], now_ns: u64, sink: Sink<'_>) {
        self.whole += 1;
        self.tally.received += 1;
        self.follow_source(sequence, source.1);
        if sequence < self.next {
            self.tally.late += 1;
            return;
        }
        if self.kind == PortKind::Sampling || sequence == self.next {
            self.next = sequence + 1;
            self.hand_on(source, bytes, sink);
            self.hand_on_held(sink);
        } else {
            self.hold(Held { sequence, source, bytes: bytes.to_vec(), came_ns: now_ns }, sink);
        }
    }

    /// Messages that a queue's source sent between two lives of the peer have no number of either life. They are counted by the source's
    /// own numbers.
    fn follow_source(&mut self, sequence: u64, source: u32) {
        if self.kind == PortKind::Sampling {
            return;
        }
        let ahead = |last: u32| source.wrapping_sub(last).cast_signed(); // negative: the source has begun anew
        match self.last_source {
            Some((last, true)) => {
                // Those of this life have numbers.
                let between = u64::try_from(ahead(last).saturating_sub(1)).unwrap_or(0);
                self.lost_before += between.saturating_sub(sequence);
                self.last_source = Some((source, false));
            }
            Some((last, false)) if (-(HELD as i32)..=0).contains(&ahead(last)) => {} // it was overtaken
            _ => self.last_source = Some((source, false)),
        }
    }

    fn hold(&mut self, held: Held, sink: Sink<'_>) {
        let place = self.held.partition_point(|other| other.sequence < held.sequence);
        self.held.insert(place, held);
        while self.held.len() > self.most_held {
            self.skip(sink);
        }
    }

    /// Gives up what is missing before the first that is held.
    fn skip(&mut self, sink: Sink<'_>) {
        if let Some(first) = self.held.front() {
            self.next = first.sequence;
            self.hand_on_held(sink);
        }
    }

    fn let_go(&mut self, sink: Sink<'_>) {
        while !self.held.is_empty() {
            self.skip(sink);
        }
    }

    fn hand_on_held(&mut self, sink: Sink<'_>) {
        while self.held.front().is_some_and(|held| held.sequence == self.next) {
            if let Some(held) = self.held.pop_front() {
                self.next += 1;
                self.hand_on(held.source, &held.bytes, sink);
            }
        }
    }

    fn hand_on(&mut self, (source_ns, sequence): (u64, u32), bytes: &[u8], sink: Sink<'_>) {
        if !sink(Delivery { channel: self.place, source_ns, sequence, bytes }) {
            self.tally.overflowed += 1;
        }
    }

    /// Where the message of a piece is joined: where it has been begun, or in the place of the oldest one.
    fn place_to_join(&mut self, sequence: u64, total: u32) -> Option<usize> {
        if let Some(place) = self.joining.iter().position(|joining| joining.sequence == Some(sequence)) {
            return (self.joining[place].bytes.len() == total as usize).then_some(place);
        }
        if sequence < self.next {
            return None;
        }
        let (place, oldest) = self.joining.iter_mut().enumerate().min_by_key(|(_, one)| one.sequence)?;
        if oldest.sequence.is_some_and(|oldest| oldest > sequence) {
            return None;
        }
        oldest.begin(sequence, total);
        Some(place)
    }
}

impl Joining {
    fn begin(&mut self, sequence: u64, total: u32) {
        self.sequence = Some(sequence);
        self.bytes.clear();
        self.bytes.resize(total as usize, 0); // at most what the plan says: `accepts` has seen to it
        self.came.clear();
    }

    /// Takes a piece; true: the message is whole.
    fn add(&mut self, offset: u32, bytes: &[u8], now_ns: u64) -> bool {
        self.last_ns = now_ns;
        let total = self.bytes.len();
        let end = offset + bytes.len() as u32; // at most `total`
        let place = self.came.partition_point(|(from, _)| *from < offset);
        let overlaps_before = place > 0 && self.came[place - 1].1 > offset;
        let overlaps_after = self.came.get(place).is_some_and(|(from, _)| *from < end);
        if overlaps_before || overlaps_after || self.came.len() > total / LEAST_PIECE + 1 {
            return false;
        }
        self.came.insert(place, (offset, end));
        self.bytes[offset as usize..end as usize].copy_from_slice(bytes);
        let covered: u32 = self.came.iter().map(|(from, to)| to - from).sum();
        let whole = covered as usize == total;
        if whole {
            self.sequence = None;
        }
        whole
    }
}

/// The number next to `end` whose low half is `low`.
fn extended(end: u64, low: u32) -> u64 {
    const HALF: u64 = 1 << 32;
    let near = (end & !(HALF - 1)) | u64::from(low);
    if near + HALF / 2 < end {
        near + HALF
    } else if near > end + HALF / 2 && near >= HALF {
        near - HALF
    } else {
        near
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const PATIENCE: Patience = Patience { missing_ns: 100, piece_ns: 1_000 };

    fn channel(kind: PortKind, max_bytes: u32, depth: u32) -> Incoming {
        Incoming::new(
            4,
            &RelayChannel {
                id: 1,
                name: "a.b".into(),
                port: "p".into(),
                outgoing: false,
                kind,
                plain: false,
                max_bytes,
                depth,
                period_ns: 0,
            },
        )
    }

    fn part(sequence: u32, bytes: &[u8]) -> Part<'_> {
        Part { channel: 1, sequence, source_sequence: sequence + 100, source_ns: 0, piece: None, bytes }
    }

    /// Feeds numbers at their instants, and gives what was handed on by their first byte.
    fn fed(channel: &mut Incoming, arrivals: &[(u32, u64)]) -> Vec<u8> {
        let mut found = Vec::new();
        for (sequence, now_ns) in arrivals {
            let mut sink = |delivery: Delivery<'_>| {
                found.push(delivery.bytes[0]);
                true
            };
            channel.look(*now_ns, &PATIENCE, &mut sink);
            channel.take(&part(*sequence, &[*sequence as u8]), 0, *now_ns, &mut sink);
        }
        found
    }

    #[test]
    fn a_sampling_channel_never_goes_back_to_an_older_message() {
        let mut channel = channel(PortKind::Sampling, 1, 1);
        assert_eq!(fed(&mut channel, &[(0, 0), (3, 1), (1, 2), (4, 3)]), [0, 3, 4]);
        assert_eq!((channel.tally().received, channel.tally().late, channel.lost()), (4, 1, 1));
    }

    #[test]
    fn a_queue_waits_for_what_is_missing_and_then_goes_on_without() {
        let mut channel = channel(PortKind::Queuing, 8, 8);
        assert_eq!(fed(&mut channel, &[(0, 0), (2, 10), (3, 20), (1, 90)]), [0, 1, 2, 3]);
        assert_eq!(channel.lost(), 0);
        assert_eq!(fed(&mut channel, &[(5, 100), (6, 150)]), [0; 0]);
        assert_eq!(fed(&mut channel, &[(7, 200)]), [5, 6, 7]);
        assert_eq!(fed(&mut channel, &[(4, 201)]), [0; 0]);
        assert_eq!((channel.tally().late, channel.lost()), (1, 0));
    }

    #[test]
    fn second_gap_in_a_queue_is_waited_for_as_long_as_the_first() {
        let mut channel = channel(PortKind::Queuing, 8, 8);
        let handed_on = fed(&mut channel, &[(1, 0), (3, 98), (0, 99)]);
        assert_eq!(handed_on, [0, 1]);
        channel.look(100, &PATIENCE, &mut |_| panic!("2 is missing for 2 ns only"));
        assert_eq!(fed(&mut channel, &[(2, 101)]), [2, 3]);
        assert_eq!((channel.tally().late, channel.lost()), (0, 0));
        assert_eq!(fed(&mut channel, &[(5, 200), (7, 250)]), [0; 0]);
        let mut found = Vec::new();
        for now_ns in [299, 300, 349, 350] {
            channel.look(now_ns, &PATIENCE, &mut |delivery| {
                found.push((now_ns, delivery.bytes[0]));
                true
            });
        }
        assert_eq!(found, [(300, 5), (350, 7)], "each waits for the skew limit and no longer");
    }

    #[test]
    fn a_queue_holds_no_more_than_it_may_and_keeps_the_order() {
        let mut channel = channel(PortKind::Queuing, 8, 2);
        assert_eq!(fed(&mut channel, &[(2, 0), (4, 0), (1, 0)]), [1, 2]);
        assert_eq!(channel.lost(), 2);
    }

    #[test]
    fn full_queues_are_counted() {
        let mut channel = channel(PortKind::Queuing, 8, 8);
        channel.take(&part(0, &[1]), 0, 0, &mut |_| false);
        assert_eq!(channel.tally().overflowed, 1);
    }

    #[test]
    fn what_a_queue_holds_is_handed_on_when_the_peer_begins_anew() {
        let mut channel = channel(PortKind::Queuing, 8, 8);
        assert_eq!(fed(&mut channel, &[(1, 0), (3, 0)]), [0; 0]);
        let mut found = Vec::new();
        channel.restart(&mut |delivery| {
            found.push(delivery.bytes[0]);
            true
        });
        assert_eq!((found, channel.lost()), (vec![1, 3], 2));
        assert_eq!(fed(&mut channel, &[(0, 5)]), [0]);
        assert_eq!(channel.lost(), 2);
    }

    #[test]
    fn what_a_queue_lost_between_two_lives_of_the_peer_is_counted_by_its_sources_numbers() {
        let mut channel = channel(PortKind::Queuing, 8, 8);
        fed(&mut channel, &[(0, 0), (1, 1)]); // the source's 100 and 101
        let of_source = |number: u32, source: u32| Part { source_sequence: source, ..part(number, &[1]) };
        channel.restart(&mut |_| true);
        channel.take(&of_source(0, 105), 0, 10, &mut |_| true);
        assert_eq!(channel.lost(), 3);
        channel.take(&of_source(1, 106), 0, 11, &mut |_| true);
        channel.restart(&mut |_| true);
        channel.take(&of_source(2, 110), 0, 20, &mut |_| true);
        assert_eq!(channel.lost(), 6, "two of the new life's own numbers, 107");
        channel.restart(&mut |_| true);
        channel.take(&of_source(0, 3), 0, 30, &mut |_| true);
        assert_eq!(channel.lost(), 6, "the source has begun anew as well");
    }

    fn pieces(message: &[u8], length: usize) -> Vec<(u32, Vec<u8>)> {
        message.chunks(length).enumerate().map(|(n, piece)| ((n * length) as u32, piece.to_vec())).collect()
    }

    fn give(
        channel: &mut Incoming,
        sequence: u32,
        total: usize,
        piece: &(u32, Vec<u8>),
        now_ns: u64,
    ) -> Vec<Vec<u8>> {
        let mut found = Vec::new();
        let piece = Part { piece: Some((total as u32, piece.0)), ..part(sequence, &piece.1) };
        channel.accepts(&piece).unwrap();
        channel.take(&piece, 0, now_ns, &mut |delivery| {
            found.push(delivery.bytes.to_vec());
            true
        });
        found
    }

    #[test]
    fn a_message_whose_pieces_stay_away_is_lost_and_the_next_one_comes() {
        let message: Vec<u8> = (0..1000_u32).map(|n| n as u8).collect();
        let mut channel = channel(PortKind::Queuing, 1000, 8);
        let all = pieces(&message, 400);
        assert!(give(&mut channel, 0, 1000, &all[0], 0).is_empty());
        assert_eq!(channel.lost(), 0);
        channel.look(1_001, &PATIENCE, &mut |_| true);
        assert_eq!(channel.lost(), 1);
        for piece in &all {
            give(&mut channel, 1, 1000, piece, 1_002);
        }
        let mut found = 0;
        channel.look(1_200, &PATIENCE, &mut |_| {
            found += 1;
            true
        });
        assert_eq!((found, channel.lost()), (1, 1));
    }

    #[test]
    fn last_piece_of_a_message_that_the_first_of_the_next_overtook_completes_it() {
        for kind in [PortKind::Queuing, PortKind::Sampling] {
            let mut channel = channel(kind, 1000, 8);
            let [one, next] = [[1_u8; 1000], [2; 1000]].map(|message| pieces(&message, 600));
            assert!(give(&mut channel, 0, 1000, &one[0], 0).is_empty());
            assert!(give(&mut channel, 1, 1000, &next[0], 1).is_empty());
            assert_eq!(channel.lost(), 0, "both may still come");
            assert_eq!(give(&mut channel, 0, 1000, &one[1], 2), [[1; 1000]], "{kind:?}");
            assert_eq!(give(&mut channel, 1, 1000, &next[1], 3), [[2; 1000]], "{kind:?}");
            assert_eq!((channel.tally().received, channel.lost()), (2, 0));
        }
    }

    #[test]
    fn of_three_messages_in_pieces_the_oldest_is_given_up_and_counted() {
        let mut channel = channel(PortKind::Sampling, 1000, 1);
        let all = pieces(&[7; 1000], 600);
        for sequence in 0..3 {
            assert!(give(&mut channel, sequence, 1000, &all[0], 0).is_empty());
        }
        assert_eq!(channel.lost(), 1);
        assert!(give(&mut channel, 0, 1000, &all[1], 1).is_empty());
        assert_eq!(give(&mut channel, 1, 1000, &all[1], 1).len(), 1);
        assert_eq!(give(&mut channel, 2, 1000, &all[1], 1).len(), 1);
        assert_eq!((channel.tally().received, channel.lost()), (2, 1));
    }

    #[test]
    fn pieces_that_overlap_are_not_joined() {
        let mut channel = channel(PortKind::Queuing, 1000, 8);
        for (offset, length) in [(0, 600), (500, 500), (600, 300), (899, 101)] {
            assert!(give(&mut channel, 0, 1000, &(offset, vec![1; length]), 0).is_empty());
        }
        assert_eq!(give(&mut channel, 0, 1000, &(900, vec![1; 100]), 0).len(), 1);
    }

    #[test]
    fn numbers_go_on_beyond_32_bits() {
        assert_eq!(extended(0, 0), 0);
        assert_eq!(extended(0, u32::MAX), u64::from(u32::MAX));
        assert_eq!(extended(u64::from(u32::MAX), 2), (1 << 32) + 2);
        assert_eq!(extended((1 << 32) + 3, u32::MAX), u64::from(u32::MAX));
    }

    proptest! {
        #[test]
        fn pieces_in_any_order_make_the_message(length in 1_usize..5000, piece in LEAST_PIECE..2000, seed: u64) {
            let message: Vec<u8> = (0..length).map(|n| (n * 31) as u8).collect();
            let mut channel = channel(PortKind::Queuing, 5000, 8);
            let mut all = pieces(&message, piece);
            let mut order = seed;
            for n in (1..all.len()).rev() {
                order = order.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                all.swap(n, (order >> 33) as usize % (n + 1));
            }
            let found: Vec<_> = all.iter().flat_map(|piece| give(&mut channel, 0, length, piece, 0)).collect();
            prop_assert_eq!(found, [message]);
        }

        #[test]
        fn a_queue_never_repeats_nor_turns_back_whatever_is_lost_or_late(
            arrivals in proptest::collection::vec((0_u32..60, 0_u64..50), 1..80)
        ) {
            let mut channel = channel(PortKind::Queuing, 8, 8);
            let (mut now_ns, mut seen) = (0, std::collections::BTreeSet::new());
            let arrivals: Vec<_> = arrivals.into_iter().filter(|(sequence, _)| seen.insert(*sequence)).map(|(sequence, later_ns)| {
                now_ns += later_ns;
                (sequence, now_ns)
            }).collect();
            let mut found = fed(&mut channel, &arrivals);
            channel.restart(&mut |delivery| { found.push(delivery.bytes[0]); true });
            prop_assert!(found.is_sorted_by(|one, next| one < next), "{:?}", found);
            let tally = channel.tally();
            prop_assert_eq!(tally.received, arrivals.len() as u64);
            prop_assert_eq!(found.len() as u64 + tally.late, tally.received);
            let highest = arrivals.iter().map(|(sequence, _)| u64::from(*sequence)).max().unwrap();
            prop_assert_eq!(channel.lost(), highest + 1 - tally.received);
        }
    }
}
