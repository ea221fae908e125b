//! What the plan counts of datagrams is what a relay needs at most.

use bateleur_contract::packing::{Waiting, datagrams_needed};
use bateleur_contract::relay::LinkModelTable;
use proptest::prelude::*;

use super::*;

/// The table of one end with queues for messages of so many bytes, in datagrams of at most `max_datagram`.
fn table_for(initiator: bool, bytes: &[u32], max_datagram: u32) -> RelayTable {
    let mut table = table(initiator);
    let link = &mut table.links[0];
    link.max_datagram = max_datagram;
    let queue = |(place, &bytes): (usize, &u32)| {
        channel(place as u16, &format!("a.q{place}"), initiator, PortKind::Queuing, bytes, 64)
    };
    link.channels = bytes.iter().enumerate().map(queue).collect();
    table
}

/// Sends all messages, by channel, as a relay does, beginning with the channel at `first`; gives the datagrams that it took.
fn sent_in(link: &mut Link, mut now_ns: u64, waiting: &mut [Vec<Vec<u8>>], first: usize) -> u64 {
    let (mut first, mut datagrams) = (first, 0);
    loop {
        now_ns += MINOR_NS;
        let mut composer = link.open(now_ns, Frame::default()).expect("the gap has passed");
        let mut full = false;
        for step in 0..waiting.len() {
            let place = (first + step) % waiting.len();
            while !waiting[place].is_empty() && composer.has_room(place) {
                assert!(composer.put(place, Stamp::default(), &waiting[place].remove(0)));
            }
            if !waiting[place].is_empty() && !std::mem::replace(&mut full, true) {
                first = place;
            }
        }
        let _ = composer.finish(now_ns);
        datagrams += 1;
        if !full && !link.has_more() {
            return datagrams;
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2_000, ..ProptestConfig::default() })]

    #[test]
    fn a_relay_needs_no_more_datagrams_than_the_plan_counts(
        queues in proptest::collection::vec((prop_oneof![1_u32..200, 1_u32..4_000], 1_usize..4), 1..9),
        max_datagram in 256_u32..3_000,
        shorter: bool,
        first in 0_usize..9,
    ) {
        let most: Vec<u32> = queues.iter().map(|(bytes, _)| *bytes).collect();
        let ends = [true, false].map(|initiator| link(&table_for(initiator, &most, max_datagram), u8::from(initiator)));
        let mut pair = Pair::of(ends, &LinkModelTable::default());
        pair.meet();
        let mut messages: Vec<Vec<Vec<u8>>> = queues
            .iter()
            .enumerate()
            .map(|(place, &(bytes, count))| {
                let length = if shorter { 1 + bytes * (place as u32 + 1) / 10 } else { bytes };
                vec![vec![place as u8; length.min(bytes) as usize]; count]
            })
            .collect();
        let waiting: Vec<Waiting> = queues
            .iter()
            .map(|&(bytes, count)| Waiting { bytes: bytes.into(), count: count as u64 })
            .collect();
        let needed = datagrams_needed(&waiting, max_datagram);
        let now_ns = pair.now_ns;
        let took = sent_in(&mut pair.ends[0].link, now_ns, &mut messages, first);
        prop_assert!(took <= needed, "{took} of {needed}");
    }
}
