//! Networks that are cut, relays that are restarted, plans that differ.

use bateleur_contract::relay::{CutTable, LinkModelTable};
use bateleur_messages::link::{DOWN, PLAN_DIFFERS, UP};

use super::*;
use crate::Rejection;

fn cut(network: &str, from_ns: u64, until_ns: u64) -> CutTable {
    CutTable { network: network.into(), from_ns, until_ns }
}

/// Writes an order in each of `count` frames.
fn write_orders(pair: &mut Pair, count: u64) {
    for number in 0..count {
        pair.ends[0].write(ORDERS, number, pair.now_ns, &[number as u8; 10]);
        pair.frame();
    }
}

#[test]
fn one_network_cut_loses_nothing_and_is_said_twice_gone_and_back() {
    let cuts = vec![cut("a", 1_000_000_000, 2_000_000_000)];
    let mut pair = Pair::new(&LinkModelTable { cuts, ..Default::default() });
    pair.meet();
    write_orders(&mut pair, 150);
    let counters = pair.ends[1].link.counters();
    assert_eq!((counters.messages_received, counters.messages_lost, counters.datagrams_lost), (150, 0, 0));
    assert_eq!(counters.networks[0].lost, 50);
    assert_eq!(pair.ends[1].events, [Event::Up, Event::NetworkDown(0), Event::NetworkUp(0)]);
    assert_eq!(pair.ends[1].link.state(), UP);
}

#[test]
fn both_networks_cut_is_said_and_the_link_recovers_by_itself() {
    let cuts = vec![cut("a", 1_000_000_000, 2_000_000_000), cut("b", 1_000_000_000, 2_000_000_000)];
    let mut pair = Pair::new(&LinkModelTable { cuts, ..Default::default() });
    pair.meet();
    write_orders(&mut pair, 70);
    assert_eq!(pair.ends.each_ref().map(|end| end.link.state()), [DOWN; 2]);
    write_orders(&mut pair, 60);
    assert_eq!(pair.ends.each_ref().map(|end| end.link.state()), [UP; 2]);
    let events = &pair.ends[1].events;
    let expected = [Event::Up, Event::NetworkDown(0), Event::NetworkDown(1), Event::Down];
    assert_eq!(events[..4], expected);
    assert!(events[4..].contains(&Event::Up) && !events.contains(&Event::PeerRestarted));
    // What went out before the silence was noticed is lost; what was written after that has waited.
    let counters = pair.ends[1].link.counters();
    assert!((1..=7).contains(&counters.messages_lost), "{counters:?}");
    assert_eq!(counters.messages_received + counters.messages_lost, 130);
}

#[test]
fn networks_that_take_longer_than_the_plan_says_are_told_once_and_quick_ones_are_not() {
    for (delay_ns, slow) in [(600_000, false), (2_000_000, true)] {
        let mut pair = Pair::new(&LinkModelTable { delay_ns, ..Default::default() });
        pair.meet();
        write_orders(&mut pair, 150);
        for end in &pair.ends {
            let is_slow = |event: &&Event| matches!(event, Event::NetworkSlow { .. });
            let mut told: Vec<Event> = end.events.iter().filter(is_slow).cloned().collect();
            // Whichever was the first to come after the clocks were known.
            told.sort_by_key(|event| matches!(event, Event::NetworkSlow { network: 1, .. }));
            let of = |network| Event::NetworkSlow { network, took_ns: delay_ns, allowed_ns: 623_000 };
            assert_eq!(told, if slow { vec![of(0), of(1)] } else { vec![] }, "{delay_ns} ns");
            assert_eq!([0, 1].map(|network| end.link.transit_ns(network)), [(delay_ns, 623_000); 2]);
            assert_eq!(end.link.counters().messages_lost, 0, "what comes is used");
        }
    }
}

#[test]
fn a_way_that_works_in_one_direction_only_is_down_at_both_ends_and_recovers() {
    let mut pair = Pair::new(&LinkModelTable::default());
    pair.meet();
    pair.mute = Some(0);
    write_orders(&mut pair, 30);
    assert_eq!(pair.ends.each_ref().map(|end| end.link.state()), [DOWN; 2]);
    for end in &pair.ends {
        assert_eq!(end.events.iter().filter(|event| **event == Event::Down).count(), 1, "{:?}", end.events);
    }
    assert!(pair.ends[0].link.is_up(0), "it hears that it is not heard");
    let before = pair.ends[1].link.counters();
    pair.mute = None;
    write_orders(&mut pair, 30);
    assert_eq!(pair.ends.each_ref().map(|end| end.link.state()), [UP; 2]);
    let counters = pair.ends[1].link.counters();
    let expected = before.messages_received + 30;
    assert!(counters.messages_received >= expected, "what was written after the silence was noticed waited");
    assert_eq!(counters.messages_received + counters.messages_lost, 60);
    assert!(counters.messages_lost <= 12, "{counters:?}");
    for end in &pair.ends {
        assert_eq!(end.events.iter().filter(|event| **event == Event::Up).count(), 2, "{:?}", end.events);
    }
}

#[test]
fn a_restarted_peer_is_met_anew_and_messages_flow_on() {
    let mut pair = Pair::new(&LinkModelTable::default());
    pair.meet();
    write_orders(&mut pair, 5);
    pair.ends[0].link = link(&table(true), 3);
    write_orders(&mut pair, 10);
    let counters = pair.ends[1].link.counters();
    assert_eq!((counters.peer_lives, counters.messages_lost), (2, 0));
    assert_eq!(pair.ends[1].of(ORDERS).len(), 15);
    assert!(pair.ends[1].events.contains(&Event::PeerRestarted));
    assert!(pair.ends[1].link.estimate(pair.now_ns).is_some());
}

#[test]
fn a_restarted_receiver_takes_only_what_is_meant_for_its_life() {
    let mut pair = Pair::new(&LinkModelTable::default());
    pair.meet();
    write_orders(&mut pair, 5);
    pair.ends[1].link = link(&table(false), 3);
    write_orders(&mut pair, 10);
    let counters = pair.ends[1].link.counters();
    assert_eq!(
        (counters.messages_lost, counters.messages_late),
        (0, 0),
        "{counters:?} {:?}",
        pair.ends[1].of(ORDERS)
    );
    // Sent in the windows before the sender knew of the new life: lost with the old one, and refused by the new one.
    assert!((13..=15).contains(&pair.ends[1].of(ORDERS).len()), "{:?}", pair.ends[1].of(ORDERS).len());
    assert!(counters.rejections(Rejection::Restart) > 0);
}

#[test]
fn new_life_is_answered_also_while_messages_of_the_old_one_come() {
    let mut pair = Pair::new(&LinkModelTable::default());
    pair.meet();
    let mut newcomer = link(&table(true), 9);
    let sealed = newcomer.open(0, Frame::default()).unwrap().finish(0);
    let hello = [sealed.bytes, sealed.tag(0)].concat();
    let sent_before = pair.ends[1].sent.len();
    for number in 0..10 {
        assert_eq!(pair.ends[1].take(0, pair.now_ns, &hello), Err(Rejection::Restart));
        pair.ends[0].write(ORDERS, number, pair.now_ns, &[1; 10]);
        pair.frame();
    }
    let taken = pair.ends[1].sent[sent_before..].iter().filter(|(network, datagram)| {
        let arrival = Arrival { network: *network, came_ns: 0, now_ns: 0 };
        *network == 0 && newcomer.receive(arrival, datagram, &mut |_| true).is_ok()
    });
    assert!(taken.count() > 0, "it was answered nothing that it could take");
}

#[test]
fn values_are_sent_again_to_a_restarted_peer_however_much_else_happened() {
    let mut pair = Pair::new(&LinkModelTable::default());
    pair.meet();
    assert!(pair.ends.iter_mut().all(|end| end.link.sends_all_again()), "the peer was not there before");
    assert!(pair.ends.iter_mut().all(|end| !end.link.sends_all_again()), "said once");
    for number in 0..200 {
        pair.ends[1].link.note(Event::Overflow(number));
    }
    pair.ends[0].link = link(&table(true), 3);
    for _ in 0..4 {
        // Nobody takes the events of the second one.
        let sent = pair.ends[0].send(pair.now_ns);
        let _ = pair.ends[1].take(0, pair.now_ns, &sent[0].1);
        let sent = pair.ends[1].send(pair.now_ns);
        let _ = pair.ends[0].take(0, pair.now_ns, &sent[0].1);
        pair.now_ns += MINOR_NS;
    }
    assert_eq!(pair.ends[1].link.counters().peer_lives, 2);
    assert!(pair.ends[1].link.sends_all_again());
}

#[test]
fn both_restarted_at_once_meet_again() {
    let mut pair = Pair::new(&LinkModelTable::default());
    pair.meet();
    pair.lose_what_is_on_the_way();
    pair.ends[0].link = link(&table(true), 4);
    pair.ends[1].link = link(&table(false), 5);
    pair.meet();
}

#[test]
fn a_peer_that_never_comes_is_said_once_for_each_network() {
    let cuts = ["a", "b"].map(|network| cut(network, 0, u64::MAX)).into();
    let mut pair = Pair::new(&LinkModelTable { cuts, ..Default::default() });
    pair.frames(30);
    assert_eq!(pair.ends[0].events, [Event::NetworkSilent(0), Event::NetworkSilent(1)]);
    assert_eq!(pair.ends[0].link.state(), DOWN);
}

#[test]
fn peer_with_another_key_that_comes_later_is_said_to_be_refused_once() {
    let other = table(false);
    let wrong = Link::new(&other, &other.links[0], &[7; 32], [2; 32]).unwrap();
    let mut pair = Pair::of([link(&table(true), 1), wrong], &LinkModelTable::default());
    pair.mute = Some(1);
    pair.frames(30);
    let silent = [Event::NetworkSilent(0), Event::NetworkSilent(1)];
    assert_eq!(pair.ends[0].events, silent);
    pair.mute = None;
    pair.frames(100);
    assert_eq!(pair.ends[0].events, [silent.clone(), silent].concat(), "silent, then refused");
    assert!(pair.ends[0].link.counters().rejections(Rejection::Key) >= 100);
}

#[test]
fn another_plan_is_refused_and_what_differs_is_said_at_both_ends() {
    let mut other = table(false);
    other.digest = "5e".repeat(32);
    other.links[0].gap_ns = 8_000_000;
    other.links[0].channels[STATE].max_bytes = 72;
    other.sections.insert("schedule.flight".into(), "f00d".into());
    let mut pair = Pair::of([link(&table(true), 1), link(&other, 2)], &LinkModelTable::default());
    pair.ends[0].write(STATE, 1, pair.now_ns, &[1; 64]);
    pair.frames(20);
    assert!(pair.ends[1].received.is_empty());
    for end in &pair.ends {
        assert_eq!(end.link.state(), PLAN_DIFFERS);
        assert!(end.link.counters().rejections(Rejection::Plan) > 10);
    }
    let said = |end: usize| pair.ends[end].events.clone();
    let differs = "differs in: channel estimator.state, link.gap";
    assert!(
        said(0).contains(&Event::PlanDiffers(format!("{differs}; only there: schedule.flight"))),
        "{:?}",
        said(0)
    );
    assert!(
        said(1).contains(&Event::PlanDiffers(format!("{differs}; only here: schedule.flight"))),
        "{:?}",
        said(1)
    );
    for end in 0..2 {
        assert_eq!(said(end)[0], Event::PlanDiffers(String::new()), "that it differs, {:?}", said(end));
        assert_eq!(said(end).len(), 2, "then in what: {:?}", said(end));
    }
}

#[test]
fn plans_that_agree_again_after_a_restart_are_taken() {
    let mut other = table(false);
    other.digest = "5e".repeat(32);
    let mut pair = Pair::of([link(&table(true), 1), link(&other, 2)], &LinkModelTable::default());
    pair.frames(5);
    let said = Event::PlanDiffers("differs beyond this link".into());
    assert!(pair.ends[0].events.contains(&said), "{:?}", pair.ends[0].events);
    pair.ends[1].link = link(&table(false), 3);
    pair.meet();
}

#[test]
fn tables_that_no_checker_lets_pass_are_refused_in_words() {
    let refused = |change: &dyn Fn(&mut RelayTable)| {
        let mut table = table(true);
        change(&mut table);
        Link::new(&table, &table.links[0], &KEY, [1; 32]).err().unwrap().to_string()
    };
    assert!(refused(&|table| table.digest = "5d".into()).contains("64 hexadecimal digits"));
    assert!(refused(&|table| table.links[0].paths.clear()).contains("1 to 2"));
    assert!(refused(&|table| table.links[0].max_datagram = 100).contains("100 bytes"));
    assert!(refused(&|table| table.links[0].channels[1].id = 3).contains("number 3"));
    let table = table(true);
    let error = Link::new(&table, &table.links[0], &[0; 32], [1; 32]).err().unwrap();
    assert!(error.to_string().contains("all zeros"));
}
