//! Gateways on a network of their own, in virtual time.

use super::*;
use crate::frame::{Id, any};
use crate::ring::GivenUp;
use proptest::prelude::*;

const MS: u64 = 1_000_000;

fn address(number: usize) -> SocketAddr {
    format!("10.0.0.{}:15210", number + 1).parse().unwrap()
}

fn broadcast() -> SocketAddr {
    "10.0.0.255:15210".parse().unwrap()
}

fn settings(number: usize) -> Settings {
    Settings::new(number as u64 + 1, 77, vec![broadcast()])
}

fn frame(id: u16, value: u8) -> Frame {
    Frame::classic(Id::Standard(id), &[value])
}

/// Somebody at `from` meets a gateway, and shows what is sent to him.
fn meet(gateway: &mut Gateway, identity: u64, from: SocketAddr, now_ns: u64) {
    let cookie = gateway.cookie(from);
    tell(gateway, Header { echo: cookie, ..claim(Purpose::Alive, identity) }, from, now_ns);
}

/// What somebody may say who has not heard anything.
fn claim(purpose: Purpose, identity: u64) -> Header {
    Header { purpose, identity, session: 1, sequence: 0, first_frame: 0, cookie: 7, echo: 0 }
}

fn tell(gateway: &mut Gateway, header: Header, from: SocketAddr, now_ns: u64) {
    let mut bytes = Vec::new();
    native::encode(&header, &mut bytes);
    gateway.take_datagram(&bytes, from, now_ns, |_, _| ());
}

/// Gateways with a bus each, and a network that loses what it is told to.
struct Net {
    gateways: Vec<Option<Gateway>>,
    /// What each wrote on its bus.
    buses: Vec<Vec<Frame>>,
    now_ns: u64,
    /// Decides by the number of a datagram with frames whether it arrives.
    loses: fn(u64) -> bool,
    sent: u64,
    events: Vec<(usize, Event)>,
}

impl Net {
    fn of(all: Vec<Settings>) -> Self {
        let mut net = Self {
            buses: vec![Vec::new(); all.len()],
            gateways: Vec::new(),
            now_ns: 0,
            loses: |_| false,
            sent: 0,
            events: Vec::new(),
        };
        net.gateways = all.into_iter().map(|settings| Some(net.started(settings))).collect();
        net
    }

    fn two() -> Self {
        let mut net = Self::of(vec![settings(0), settings(1)]);
        net.pass(1_000 * MS);
        net
    }

    fn started(&self, settings: Settings) -> Gateway {
        let mut gateway = Gateway::new(settings);
        assert_eq!(gateway.state(), State::Start);
        gateway.bus_is_ready();
        assert_eq!(gateway.state(), State::Address);
        gateway.address_is_ready(self.now_ns);
        gateway
    }

    /// Lets time pass in steps of a millisecond.
    fn pass(&mut self, ns: u64) {
        let end_ns = self.now_ns + ns;
        while self.now_ns < end_ns {
            self.now_ns += MS;
            for number in 0..self.gateways.len() {
                self.run(number);
            }
        }
    }

    fn run(&mut self, number: usize) {
        let mut datagrams = Vec::new();
        let Some(gateway) = &mut self.gateways[number] else { return };
        gateway.run(self.now_ns, &mut |to, bytes| {
            datagrams.push((to, bytes.to_vec()));
            true
        });
        while let Some(event) = gateway.event() {
            self.events.push((number, event));
        }
        for (to, bytes) in datagrams {
            let carries_frames = bytes[9] == 1;
            self.sent += u64::from(carries_frames);
            if carries_frames && (self.loses)(self.sent) {
                continue;
            }
            self.deliver(number, to, &bytes);
        }
    }

    fn deliver(&mut self, from: usize, to: SocketAddr, bytes: &[u8]) {
        for (number, bus) in self.buses.iter_mut().enumerate() {
            if (to == broadcast() || to == address(number))
                && let Some(gateway) = &mut self.gateways[number]
            {
                gateway.take_datagram(bytes, address(from), self.now_ns, |frame, _| bus.push(*frame));
            }
        }
    }

    fn gateway(&mut self, number: usize) -> &mut Gateway {
        self.gateways[number].as_mut().unwrap()
    }

    fn bus_says(&mut self, number: usize, frame: Frame) {
        let now_ns = self.now_ns;
        self.gateway(number).take_frame(&frame, now_ns);
    }

    fn states(&self) -> Vec<State> {
        self.gateways.iter().flatten().map(Gateway::state).collect()
    }

    fn counters(&self, number: usize) -> Counters {
        self.gateways[number].as_ref().unwrap().counters()
    }
}

#[test]
fn alone_it_asks_again_and_again_and_holds_frames_no_longer_than_their_age() {
    let mut net = Net::of(vec![settings(0)]);
    net.bus_says(0, frame(1, 1));
    net.pass(5_000 * MS);
    assert_eq!(net.states(), [State::Discover]);
    let counters = net.counters(0);
    assert_eq!(counters.datagrams_out, 10, "twice a second");
    assert_eq!(counters.own_echoes, 10, "its own broadcasts are not another gateway");
    assert_eq!((counters.to_network.expired, counters.network_out), (1, 0));
}

#[test]
fn two_find_each_other_and_carry_frames_both_ways() {
    let mut net = Net::two();
    assert_eq!(net.states(), [State::Forward, State::Forward]);
    let remote = Frame::remote(Id::Extended(0x1234), 3).unwrap();
    net.bus_says(0, frame(0x100, 1));
    net.bus_says(1, remote);
    net.pass(MS);
    assert_eq!(net.buses, [vec![remote], vec![frame(0x100, 1)]]);
    net.pass(10_000 * MS);
    assert_eq!(net.buses[1].len(), 1, "nothing comes back, nothing comes twice");
    assert_eq!((net.counters(0).lost(), net.counters(1).lost()), (0, 0));
}

#[test]
fn what_waited_for_a_target_goes_to_it_in_the_order_of_arbitration() {
    let mut net = Net::of(vec![settings(0), settings(1)]);
    for id in [0x300, 0x100, 0x200] {
        net.bus_says(0, frame(id, 1));
    }
    net.pass(1_000 * MS);
    assert_eq!(net.buses[1], [frame(0x100, 1), frame(0x200, 1), frame(0x300, 1)]);
}

#[test]
fn a_target_that_falls_silent_is_lost_and_found_again_when_it_is_back() {
    let mut net = Net::two();
    net.gateways[1] = None;
    net.pass(4_600 * MS);
    assert_eq!(net.states(), [State::Discover]);
    assert!(net.events.contains(&(0, Event::Lost { identity: 2, address: address(1) })));
    assert_eq!(net.counters(0).targets_lost, 1);
    net.gateways[1] = Some(net.started(Settings { session: 78, ..settings(1) }));
    net.pass(600 * MS);
    assert_eq!(net.states(), [State::Forward, State::Forward]);
    assert!(net.events.contains(&(0, Event::Found { identity: 2, address: address(1), again: true })));
    assert!(net.events.contains(&(0, Event::Restarted { identity: 2 })));
    net.bus_says(0, frame(1, 1));
    net.pass(MS);
    assert_eq!((net.buses[1].len(), net.counters(1).lost()), (1, 0), "a new start is no loss");
}

#[test]
fn one_that_was_started_anew_gets_frames_within_half_a_second() {
    let mut net = Net::two();
    net.bus_says(1, frame(9, 9));
    net.pass(MS);
    net.gateways[1] = Some(net.started(Settings { session: 78, ..settings(1) }));
    net.bus_says(0, frame(1, 1));
    net.bus_says(1, frame(2, 2));
    net.pass(500 * MS);
    net.bus_says(0, frame(3, 3));
    net.pass(MS);
    assert_eq!(net.buses[1], [frame(3, 3)]);
    assert_eq!(net.counters(1).unproven_frames, 1, "the first went to the earlier start");
    assert_eq!(net.buses[0], [frame(9, 9), frame(2, 2)]);
    assert_eq!(net.counters(0).target_restarts, 1);
}

#[test]
fn one_that_ends_in_order_is_not_waited_for() {
    let mut net = Net::two();
    let mut said = Vec::new();
    let now_ns = net.now_ns;
    net.gateway(1).leave(now_ns, &mut |to, bytes| {
        said.push((to, bytes.to_vec()));
        true
    });
    net.gateways[1] = None;
    said.iter().for_each(|(to, bytes)| net.deliver(1, *to, bytes));
    assert_eq!(net.states(), [State::Discover]);
}

#[test]
fn leaving_datagram_of_an_earlier_start_that_comes_late_does_not_disconnect_the_new_one() {
    let mut net = Net::two();
    let mut said = Vec::new();
    let now_ns = net.now_ns;
    net.gateway(1).leave(now_ns, &mut |to, bytes| {
        said.push((to, bytes.to_vec()));
        true
    });
    net.gateways[1] = Some(net.started(Settings { session: 78, ..settings(1) }));
    net.pass(600 * MS);
    said.iter().for_each(|(to, bytes)| net.deliver(1, *to, bytes));
    assert_eq!(net.states(), [State::Forward, State::Forward]);
}

#[test]
fn a_gateway_with_the_same_identity_is_said_and_its_frames_are_not_taken() {
    let twin = Settings { session: 99, ..settings(0) };
    let mut net = Net::of(vec![settings(0), twin, settings(2)]);
    net.pass(2_000 * MS);
    assert_eq!(net.gateway(0).conflict(2_000 * MS), Some(address(1)));
    assert_eq!(net.gateway(1).conflict(2_000 * MS), Some(address(0)));
    let told = |event: &&(usize, Event)| matches!(event.1, Event::SameIdentity { .. });
    assert_eq!(net.events.iter().filter(told).count(), 2, "once, not with each datagram");
    assert!(net.counters(0).same_identity > 0);
    net.bus_says(1, frame(1, 1));
    net.pass(MS);
    assert!(net.buses[0].is_empty());
}

#[test]
fn two_of_one_identity_that_do_not_hear_each_other_are_told_by_the_third_and_one_that_restarts_is_not() {
    // They ask the third alone: neither hears the other.
    let far = |session| Settings { session, ..Settings::new(1, 77, vec![address(2)]) };
    let mut net = Net::of(vec![far(77), far(99), Settings { discover: vec![], ..settings(2) }]);
    net.pass(8_000 * MS);
    let told =
        |net: &Net| net.events.iter().filter(|(_, event)| matches!(event, Event::Shared { .. })).count();
    assert_eq!((told(&net), net.gateway(0).conflict(8_000 * MS)), (1, None), "{:?}", net.events);
    assert!(net.gateway(2).targets(8_000 * MS)[0].shared);
    assert_eq!(net.counters(2).target_restarts, 1, "the others were no restarts");
    net.pass(12_000 * MS);
    let said: Vec<String> = net.events.iter().map(|(_, event)| event.to_string()).collect();
    assert!(
        said.iter().any(|text| text.contains("of one identity: ") && text.contains(" more ")),
        "{said:?}"
    );
    // One of them goes: after a while all is well.
    net.gateways[1] = None;
    net.pass(11_000 * MS);
    let told_before = told(&net);
    for session in 100..110 {
        net.gateways[0] = Some(net.started(far(session)));
        net.pass(500 * MS);
    }
    assert!(!net.gateway(2).targets(36_000 * MS)[0].shared);
    assert_eq!((told(&net), net.counters(2).target_restarts), (told_before, 11), "{:?}", net.events);
}

#[test]
fn three_share_a_network_and_each_gets_a_frame_once() {
    let mut net = Net::of((0..3).map(settings).collect());
    net.pass(1_000 * MS);
    net.bus_says(1, frame(7, 7));
    net.pass(3_000 * MS);
    assert_eq!(net.buses, [vec![frame(7, 7)], vec![], vec![frame(7, 7)]]);
}

#[test]
fn lost_datagrams_are_counted_with_their_frames_also_the_last_one() {
    let mut net = Net::two();
    net.loses = |number| matches!(number, 2 | 3 | 6);
    for value in 1..=6 {
        net.bus_says(0, frame(1, value));
        net.bus_says(0, frame(2, value));
        net.pass(MS);
    }
    net.pass(1_100 * MS);
    let counters = net.counters(1);
    assert_eq!((counters.lost_datagrams, counters.lost_frames, counters.network_in), (3, 6, 6));
    assert!(net.events.contains(&(1, Event::Missing { identity: 1, datagrams: 2 })));
}

#[test]
fn what_is_foreign_or_flawed_is_counted_and_told_once() {
    let mut net = Net::two();
    let stranger: SocketAddr = "10.9.9.9:1".parse().unwrap();
    let mut future = vec![0; 64];
    future[..8].copy_from_slice(&native::PREFIX);
    future[8] = 3;
    for _ in 0..3 {
        let now_ns = net.now_ns;
        for bytes in [&b"hello"[..], &[], &future, &native::PREFIX] {
            net.gateway(0).take_datagram(bytes, stranger, now_ns, |_, _| panic!());
        }
    }
    let counters = net.counters(0);
    assert_eq!((counters.foreign, counters.other_version, counters.malformed), (6, 3, 3));
    net.pass(MS);
    let said: Vec<String> = net.events.iter().map(|(_, event)| event.to_string()).collect();
    assert!(said.iter().any(|text| text.contains("version 3") && text.contains("10.9.9.9")), "{said:?}");
}

#[test]
fn others_than_those_that_are_allowed_are_not_heard() {
    let closed = Settings { only_from: vec![address(1).ip()], ..settings(0) };
    let mut net = Net::of(vec![closed, settings(1), settings(2)]);
    net.pass(1_000 * MS);
    net.bus_says(2, frame(1, 1));
    net.bus_says(1, frame(2, 2));
    net.pass(MS);
    assert_eq!(net.buses[0], [frame(2, 2)]);
    assert!(net.counters(0).strangers > 0);
}

#[test]
fn frames_share_a_datagram_for_as_long_as_they_may_wait_and_no_longer() {
    let patient = Settings { flush_after_ns: 5 * MS, ..settings(0) };
    let mut net = Net::of(vec![patient, settings(1)]);
    net.pass(1_000 * MS);
    net.sent = 0;
    (0..4).for_each(|value| {
        net.bus_says(0, frame(1, value));
        net.pass(MS);
    });
    assert_eq!(net.sent, 0);
    net.pass(2 * MS);
    assert_eq!((net.sent, net.buses[1].len()), (1, 4));
    (0..160).for_each(|value| net.bus_says(0, frame(1, value)));
    net.run(0);
    assert_eq!((net.sent, net.buses[1].len()), (3, 164), "a full datagram does not wait");
    net.bus_says(0, frame(1, 1));
    let now_ns = net.now_ns;
    let mut flushed = 0;
    net.gateway(0).flush(now_ns, &mut |_, _| {
        flushed += 1;
        true
    });
    assert_eq!(flushed, 1, "the end of a window waits for nothing");
}

#[test]
fn only_the_chosen_identifiers_are_forwarded_and_the_others_are_counted() {
    let choosy = Settings { forward: "100-1ff".parse().unwrap(), ..settings(0) };
    let mut net = Net::of(vec![choosy, settings(1)]);
    net.pass(1_000 * MS);
    net.bus_says(0, frame(0x100, 1));
    net.bus_says(0, frame(0x200, 1));
    net.pass(MS);
    assert_eq!(net.buses[1], [frame(0x100, 1)]);
    assert_eq!(net.counters(0).not_forwarded, 1);
}

#[test]
fn reports_of_errors_are_told_to_the_other_side_and_never_put_on_its_bus() {
    let mut net = Net::two();
    net.bus_says(0, Frame::new(Id::Extended(0x40), crate::frame::Kind::Error, &[0; 8]).unwrap());
    net.pass(MS);
    assert!(net.buses[1].is_empty());
    assert_eq!((net.counters(0).bus_errors, net.counters(1).remote_errors), (1, 1));
}

#[test]
fn a_network_that_takes_nothing_is_counted_and_harms_nobody() {
    let mut net = Net::two();
    net.bus_says(0, frame(1, 1));
    let now_ns = net.now_ns;
    net.gateway(0).run(now_ns, &mut |_, _| false);
    assert_eq!(net.counters(0).unsent_datagrams, 1);
}

#[test]
fn cannelloni_goes_to_its_peers_and_listens_to_nobody_else() {
    let peers = |to: usize| Settings {
        protocol: Protocol::Cannelloni,
        discover: vec![address(to)],
        ..settings(1 - to)
    };
    let mut net = Net::of(vec![peers(1), peers(0), Settings { discover: vec![address(0)], ..peers(1) }]);
    assert_eq!(net.states(), [State::Forward; 3]);
    for value in 0..=255_u8 {
        net.loses = |_| false;
        net.bus_says(0, frame(1, value));
        net.bus_says(2, frame(2, value));
        net.pass(MS);
    }
    assert_eq!((net.buses[1].len(), net.buses[0].len()), (256, 0));
    assert_eq!((net.counters(1).lost_datagrams, net.counters(0).strangers), (0, 256));
}

#[test]
fn a_gap_in_cannellonis_numbers_is_counted_and_nothing_is_dropped() {
    let mut gateway =
        Gateway::new(Settings { protocol: Protocol::Cannelloni, discover: vec![address(1)], ..settings(0) });
    gateway.address_is_ready(0);
    let mut heard = 0;
    for sequence in [254, 255, 2, 3] {
        let mut bytes = Vec::new();
        cannelloni::encode(sequence, &mut bytes);
        cannelloni::append(&frame(1, sequence), &mut bytes);
        gateway.take_datagram(&bytes, address(1), 0, |_, _| heard += 1);
    }
    assert_eq!((heard, gateway.counters().lost_datagrams), (4, 2));
}

#[test]
fn datagram_of_cannelloni_that_was_overtaken_is_late_and_not_255_losses() {
    let mut gateway =
        Gateway::new(Settings { protocol: Protocol::Cannelloni, discover: vec![address(1)], ..settings(0) });
    gateway.address_is_ready(0);
    let mut heard = Vec::new();
    for sequence in [5, 7, 6, 8, 8] {
        let mut bytes = Vec::new();
        cannelloni::encode(sequence, &mut bytes);
        cannelloni::append(&frame(1, sequence), &mut bytes);
        gateway.take_datagram(&bytes, address(1), 0, |frame, _| heard.push(frame.data()[0]));
    }
    let counters = gateway.counters();
    assert_eq!(heard, [5, 7, 6, 8, 8], "its numbers decide nothing");
    assert_eq!((counters.lost_datagrams, counters.late_datagrams, counters.repeated_datagrams), (0, 1, 1));
}

#[test]
fn counters_of_a_target_that_makes_room_for_another_one_stay() {
    let mut net = Net::two();
    net.loses = |number| number == 2;
    for value in 1..=3 {
        net.bus_says(1, frame(1, value));
        net.pass(MS);
    }
    assert_eq!(net.counters(0).lost_datagrams, 1);
    net.gateways[1] = None;
    net.pass(4_600 * MS);
    let now_ns = net.now_ns;
    for identity in 100..100 + MAX_TARGETS as u64 {
        meet(net.gateway(0), identity, address(9), now_ns);
    }
    let counters = net.counters(0);
    assert!(net.gateway(0).targets(now_ns).iter().all(|target| target.identity != format!("{:016x}", 2)));
    assert_eq!((counters.lost_datagrams, counters.lost_frames), (1, 1));
}

#[test]
fn forged_senders_get_no_frames_drive_out_nobody_and_are_answered_with_no_more_bytes_than_they_sent() {
    let mut net = Net::two();
    let victim: SocketAddr = "10.9.9.9:15210".parse().unwrap();
    let now_ns = net.now_ns;
    for identity in 100..100 + 2 * MAX_TARGETS as u64 {
        for purpose in [Purpose::Discover, Purpose::Alive, Purpose::Frames] {
            tell(net.gateway(0), claim(purpose, identity), victim, now_ns);
        }
    }
    // Somebody else tries to have the frames of a target that is there.
    tell(net.gateway(0), Header { session: 77, ..claim(Purpose::Alive, 2) }, victim, now_ns);
    tell(net.gateway(0), Header { session: 77, ..claim(Purpose::Leaving, 2) }, victim, now_ns);
    net.bus_says(0, frame(1, 1));
    let mut to_victim = 0;
    net.gateway(0).run(now_ns, &mut |to, bytes| {
        to_victim += if to == victim { bytes.len() } else { 0 };
        true
    });
    assert_eq!(to_victim, native::HEADER_BYTES, "one answer, with which he could show that he is there");
    assert_eq!(net.gateway(0).targets(now_ns).len(), 1);
    assert_eq!(net.gateway(0).targets(now_ns)[0].address, address(1));
    assert_eq!(net.counters(0).unproven_datagrams, 4 * MAX_TARGETS as u64 + 2);
    assert_eq!(net.states(), [State::Forward; 2]);
}

#[test]
fn whoever_shows_what_was_sent_to_his_address_becomes_a_target() {
    let mut gateway = Gateway::new(settings(0));
    gateway.address_is_ready(0);
    tell(&mut gateway, claim(Purpose::Discover, 2), address(1), 0);
    assert_eq!((gateway.state(), gateway.due_ns()), (State::Discover, 0));
    let mut answer = None;
    gateway.run(0, &mut |to, bytes| {
        if to == address(1) {
            answer = native::decode(bytes, &mut Vec::new()).ok();
        }
        true
    });
    let answer = answer.unwrap();
    assert_eq!((answer.purpose, answer.echo), (Purpose::Discover, 7));
    let shown = Header { echo: answer.cookie, ..claim(Purpose::Discover, 2) };
    tell(&mut gateway, shown, address(2), 0);
    assert_eq!(gateway.state(), State::Discover, "it was sent to another address");
    tell(&mut gateway, shown, address(1), 0);
    assert_eq!(gateway.state(), State::Forward);
}

#[test]
fn gateway_of_version_1_is_refused_and_said() {
    let mut gateway = Gateway::new(settings(0));
    gateway.address_is_ready(0);
    let mut bytes = Vec::new();
    native::encode(&claim(Purpose::Discover, 2), &mut bytes);
    bytes[8] = 1;
    gateway.take_datagram(&bytes[..32], address(1), 0, |_, _| ());
    assert_eq!((gateway.counters().other_version, gateway.unproven.len()), (1, 0));
    let said: Vec<String> = std::iter::from_fn(|| gateway.event()).map(|event| event.to_string()).collect();
    assert!(said.iter().any(|text| text.contains("of version 1, this gateway speaks version 2")), "{said:?}");
}

#[test]
fn a_full_table_of_targets_takes_no_more_and_counts_them() {
    let mut gateway = Gateway::new(settings(0));
    gateway.address_is_ready(0);
    for identity in 2..2 + MAX_TARGETS as u64 + 3 {
        meet(&mut gateway, identity, address(1), 0);
    }
    assert_eq!((gateway.targets(0).len(), gateway.counters().strangers), (MAX_TARGETS, 3));
}

proptest! {
    #[test]
    fn every_frame_arrives_or_is_counted(
        frames in proptest::collection::vec((any::frame(), 0_u64..4, any::<bool>()), 1..300),
        seed in 0_u64..5,
    ) {
        let mut net = Net::two();
        const LOSSES: [fn(u64) -> bool; 5] = [|_| false, |_| true, |number| number % 2 == 0, |number| number % 7 == 3, |number| number > 10];
        net.loses = LOSSES[seed as usize];
        let mut said = [0_u64; 2];
        for (frame, wait, first) in &frames {
            let number = usize::from(*first);
            net.bus_says(number, *frame);
            said[number] += 1;
            net.pass(wait * MS);
        }
        net.pass(3_000 * MS);
        for (number, said) in said.into_iter().enumerate() {
            let counters = net.counters(1 - number);
            prop_assert_eq!(net.counters(number).to_network, GivenUp::default());
            prop_assert_eq!(said, net.buses[1 - number].len() as u64 + counters.lost_frames);
        }
    }

    #[test]
    fn any_datagram_is_survived(bytes in proptest::collection::vec(any::<u8>(), 0..200), with_prefix: bool) {
        let mut gateway = Gateway::new(settings(0));
        gateway.address_is_ready(0);
        let mut bytes = bytes;
        if with_prefix && bytes.len() > 10 {
            bytes[..8].copy_from_slice(&native::PREFIX);
            bytes[8] = 1;
            bytes[9] %= 6;
        }
        gateway.take_datagram(&bytes, address(1), 0, |_, _| ());
        gateway.run(1, &mut |_, _| true);
        prop_assert_eq!(gateway.counters().datagrams_in, 1);
    }
}
