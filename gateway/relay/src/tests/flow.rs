//! Messages over networks that work, more or less.

use bateleur_contract::relay::LinkModelTable;
use proptest::prelude::*;

use super::*;

fn quiet(delay_ns: u64) -> LinkModelTable {
    LinkModelTable { delay_ns, ..Default::default() }
}

#[test]
fn prt_15_two_ends_meet_and_messages_keep_their_source_and_its_time() {
    let mut pair = Pair::new(&quiet(300_000));
    pair.ends[0].write(STATE, 41, pair.now_ns, &[1; 64]);
    pair.meet();
    let written_ns = pair.now_ns - 5_000_000;
    pair.ends[0].write(STATE, 42, written_ns, &[2; 64]);
    pair.ends[1].write(RATES, 7, written_ns, &[3; 24]);
    pair.frames(2);
    // Both ways take as long: the clocks are known exactly.
    assert_eq!(pair.ends[1].of(STATE).last(), Some(&&(STATE, written_ns + AHEAD_NS, 42, vec![2; 64])));
    assert_eq!(pair.ends[0].of(RATES), [&(RATES, written_ns, 7, vec![3; 24])]);
    let estimate = pair.ends[0].link.estimate(pair.now_ns).unwrap();
    assert_eq!((estimate.offset_ns, estimate.round_trip_ns), (AHEAD_NS as i64, 600_000));
    assert_eq!(pair.ends[0].link.peer_frame().map(|frame| frame.number), Some(3));
}

#[test]
fn what_was_written_before_the_peer_was_there_goes_when_it_is() {
    let mut pair = Pair::new(&quiet(0));
    for number in 0..5_u8 {
        pair.ends[0].write(ORDERS, u64::from(number), pair.now_ns, &[number; 10]);
    }
    pair.frames(5);
    let orders: Vec<u8> = pair.ends[1].of(ORDERS).iter().map(|message| message.3[0]).collect();
    assert_eq!(orders, [0, 1, 2, 3, 4]);
}

#[test]
fn both_ends_know_that_messages_flow_and_that_is_said_once() {
    let mut pair = Pair::new(&quiet(0));
    pair.frames(20);
    for end in &pair.ends {
        assert_eq!(end.events, [Event::Up]);
        assert_eq!(end.link.counters().peer_lives, 1);
    }
}

#[test]
fn a_large_message_goes_in_pieces_and_small_ones_beside_it() {
    let mut pair = Pair::new(&quiet(0));
    pair.meet();
    let map: Vec<u8> = (0..9_000_u32).map(|n| (n % 251) as u8).collect();
    pair.ends[0].write(MAP, 1, pair.now_ns, &map);
    for number in 0..12_u8 {
        pair.ends[0].write(STATE, number.into(), pair.now_ns, &[number; 64]);
        pair.frame();
    }
    assert_eq!(pair.ends[1].of(MAP).iter().map(|message| &message.3).collect::<Vec<_>>(), [&map]);
    assert!(pair.ends[1].of(STATE).len() >= 11);
    let longest = pair.ends[0].sent.iter().map(|(_, datagram)| datagram.len()).max();
    assert_eq!(longest, Some(1472));
}

#[test]
fn messages_that_do_not_fit_wait_for_the_next_datagram() {
    let mut pair = Pair::new(&quiet(0));
    pair.meet();
    for number in 0..14_u8 {
        pair.ends[0].write(ORDERS, number.into(), pair.now_ns, &[number; 200]);
    }
    pair.frames(4);
    let orders: Vec<u8> = pair.ends[1].of(ORDERS).iter().map(|message| message.3[0]).collect();
    assert_eq!(orders, (0..14).collect::<Vec<u8>>());
    assert_eq!(pair.ends[1].link.counters().messages_lost, 0);
}

#[test]
fn no_datagram_starts_before_the_gap_has_passed() {
    let mut end = Pair::new(&quiet(0)).ends.into_iter().next().unwrap();
    assert_eq!(end.send(10_000_000).len(), 2);
    assert!(end.send(13_999_999).is_empty());
    assert_eq!(end.send(14_000_000).len(), 2);
}

#[test]
fn a_full_queue_is_counted_and_said() {
    let mut pair = Pair::new(&quiet(0));
    pair.meet();
    pair.ends[1].room = 2;
    for number in 0..3_u8 {
        pair.ends[0].write(ORDERS, number.into(), pair.now_ns, &[number; 10]);
    }
    pair.ends[1].room = 3;
    pair.frames(2);
    assert_eq!(pair.ends[1].link.counters().messages_overflowed, 1);
    assert!(pair.ends[1].events.contains(&Event::Overflow(ORDERS)));
}

#[test]
fn both_networks_bring_the_same_and_it_is_taken_once() {
    let mut pair = Pair::new(&quiet(0));
    pair.meet();
    for number in 0..50_u8 {
        pair.ends[0].write(ORDERS, number.into(), pair.now_ns, &[number; 10]);
        pair.frame();
    }
    let counters = pair.ends[1].link.counters();
    assert_eq!(counters.messages_received, 50);
    let [a, b] = counters.networks;
    assert_eq!((a.redundant, a.duplicated, b.duplicated), (0, 0, 0));
    assert!(b.redundant >= 50 && a.lost + b.lost + counters.datagrams_lost == 0);
}

#[test]
fn copies_beyond_the_skew_limit_are_late_and_not_taken() {
    let mut pair = Pair::new(&quiet(0));
    pair.meet();
    let sent = pair.ends[0].send(pair.now_ns);
    let now_ns = pair.now_ns;
    pair.ends[1].take(0, now_ns, &sent[0].1).unwrap();
    pair.ends[1].take(1, now_ns + 10_000_001, &sent[1].1).unwrap();
    assert_eq!(pair.ends[1].link.counters().networks[1].late, 1);
}

#[test]
fn message_of_a_wrong_length_is_not_sent_and_the_others_of_its_datagram_are_taken() {
    let mut pair = Pair::new(&quiet(0));
    pair.meet();
    let now_ns = pair.now_ns;
    let mut composer = pair.ends[0].link.open(now_ns, Frame::default()).unwrap();
    assert!(composer.put(ORDERS, Stamp::default(), b"order"));
    for (channel, bytes) in [(STATE, 63), (STATE, 65), (ORDERS, 0), (ORDERS, 201)] {
        assert!(!composer.put(channel, Stamp::default(), &vec![1; bytes]), "{bytes} bytes on {channel}");
    }
    let sealed = composer.finish(now_ns);
    let datagram = [sealed.bytes, sealed.tag(0)].concat();
    assert_eq!(pair.ends[1].take(0, now_ns, &datagram), Ok(()));
    assert_eq!(pair.ends[1].of(ORDERS).last().map(|message| message.3.as_slice()), Some(&b"order"[..]));
    assert_eq!(
        (pair.ends[0].link.counters().messages_sent, pair.ends[1].link.counters().messages_lost),
        (1, 0)
    );
}

#[test]
fn without_authentication_everything_works_the_same() {
    let tables = [true, false].map(|initiator| {
        let mut table = table(initiator);
        table.links[0].authenticated = false;
        table
    });
    let links = [link(&tables[0], 1), link(&tables[1], 2)];
    let mut pair = Pair::of(links, &quiet(0));
    pair.meet();
    pair.ends[0].write(STATE, 1, pair.now_ns, &[1; 64]);
    pair.frames(2);
    assert_eq!(pair.ends[1].of(STATE).len(), 1);
}

#[test]
fn counters_match_what_a_bad_network_did_exactly() {
    let bad = LinkModelTable {
        seed: 11,
        delay_ns: 1_000_000,
        jitter_ns: 45_000_000,
        loss: 0.05,
        duplicate: 0.02,
        reorder: 0.01,
        reorder_ns: 30_000_000,
        ..Default::default()
    };
    let mut pair = Pair::new(&quiet(1_000_000));
    pair.meet();
    // The same networks, from now on bad ones.
    let names = [(true, "a"), (true, "b"), (false, "a"), (false, "b")];
    let offered: Vec<ModelCounters> = pair.models.iter().map(LinkModel::counters).collect();
    pair.models = names.map(|(initiator, name)| LinkModel::new(&bad, name, 7, initiator)).into();
    for number in 0..3_000_u64 {
        pair.ends[0].write(ORDERS, number, pair.now_ns, &(number as u32).to_le_bytes());
        pair.frame();
    }
    let worst = pair.models(0, 0);
    assert!(worst.lost > 100 && worst.duplicated > 30 && worst.reordered > 300, "{worst:?}");
    // At the end everything comes, so that nothing is missing behind the last one.
    let bad_part: Vec<ModelCounters> = pair.models.iter().map(LinkModel::counters).collect();
    pair.models =
        names.map(|(initiator, name)| LinkModel::new(&quiet(60_000_000), name, 7, initiator)).into();
    pair.frames(10);
    let last_part: Vec<ModelCounters> = pair.models.iter().map(LinkModel::counters).collect();
    pair.models = Vec::new();
    let on_the_way = |receiver, network| {
        let all = pair.on_the_way.values();
        all.filter(|way| (way.0, way.1) == (receiver, network)).count() as u64
    };
    for (place, (sender, network)) in [(0, 0), (0, 1), (1, 0), (1, 1)].into_iter().enumerate() {
        let counters = pair.ends[1 - sender].link.counters();
        let counted = &counters.networks[network];
        let (bad, before, after) = (&bad_part[place], &offered[place], &last_part[place]);
        let arrivals = before.arrivals + bad.arrivals + after.arrivals - on_the_way(1 - sender, network);
        assert_eq!(counted.received, arrivals, "{counted:?}");
        assert_eq!((counted.lost, counted.duplicated), (bad.lost, bad.duplicated));
        assert_eq!(counted.reordered, bad.reordered);
        assert_eq!(counters.all_rejections(), counters.rejections(crate::Rejection::Restart)); // while both met
    }
    // A message is lost where both networks have lost its datagram, and nothing else is.
    let counters = pair.ends[1].link.counters();
    let orders = pair.ends[1].of(ORDERS);
    assert!(orders.is_sorted_by_key(|message| message.2));
    assert_eq!(orders.len() as u64, 3_000 - counters.messages_lost - counters.messages_late);
    assert!(
        counters.messages_lost <= counters.datagrams_lost && counters.datagrams_lost < 30,
        "{counters:?}"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn whatever_a_network_does_queues_keep_their_order_and_counts_add_up(
        seed: u64,
        loss in 0.0..0.6_f64,
        duplicate in 0.0..0.5_f64,
        jitter_ns in 0_u64..80_000_000,
        lengths in proptest::collection::vec(1_usize..3_000, 1..60),
    ) {
        let model = LinkModelTable { seed, loss, duplicate, jitter_ns, ..Default::default() };
        let mut pair = Pair::new(&model);
        for (number, length) in lengths.iter().enumerate() {
            let bytes: Vec<u8> = (0..*length).map(|n| (n + number) as u8).collect();
            pair.ends[0].write(MAP, number as u64, pair.now_ns, &bytes);
            pair.frame();
        }
        pair.frames(150);
        let received = pair.ends[1].of(MAP);
        prop_assert!(received.is_sorted_by(|one, next| one.2 < next.2));
        for message in &received {
            let number = message.2 as usize;
            let expected: Vec<u8> = (0..lengths[number]).map(|n| (n + number) as u8).collect();
            prop_assert_eq!(&message.3, &expected);
        }
        let (sender, receiver) = (pair.ends[0].link.counters(), pair.ends[1].link.counters());
        prop_assert_eq!(receiver.messages_received, received.len() as u64 + receiver.messages_late);
        prop_assert!(receiver.messages_received + receiver.messages_lost <= sender.messages_sent);
    }
}
