//! Two relays of two modules, with real ports and real sockets, in steps.

use std::net::{SocketAddr, UdpSocket};

use bateleur_apex::{Harness, QueuingDestination, QueuingSource, SamplingDestination, SamplingSource};
use bateleur_contract::PortKind;
use bateleur_contract::relay::{ClockRole, LinkTable, PathTable, RelayChannel};
use bateleur_messages::link::UP;
use bateleur_messages::{GroundMessage, LinkStatus, Rate, State};

use super::*;

fn channel(id: u16, name: &str, outgoing: bool, kind: PortKind, max_bytes: usize) -> RelayChannel {
    let depth = if kind == PortKind::Queuing { 8 } else { 1 };
    let (port, max_bytes) = (name.replace('.', "_"), max_bytes as u32);
    let (name, plain) = (name.into(), false);
    RelayChannel { id, name, port, outgoing, kind, plain, max_bytes, depth, period_ns: 20_000_000 }
}

fn table(initiator: bool, local: SocketAddr, remote: SocketAddr, transport: &str) -> RelayTable {
    let names = if initiator { ["fcu", "nav"] } else { ["nav", "fcu"] };
    RelayTable {
        module: names[0].into(),
        digest: "ab".repeat(32),
        sections: std::collections::BTreeMap::new(),
        transport: transport.into(),
        links: vec![LinkTable {
            name: "bus".into(),
            id: 3,
            peer: names[1].into(),
            initiator,
            authenticated: false,
            gap_ns: 4_000_000,
            max_datagram: 1472,
            skew_ns: 2_000_000,
            lost_after_ns: 100_000_000,
            clock: ClockRole::None,
            paths: vec![PathTable { network: "a".into(), local, remote, latency_ns: 0 }],
            channels: vec![
                channel(0, "rate_generator.rate", initiator, PortKind::Sampling, size_of::<Rate>()),
                channel(1, "command.orders", initiator, PortKind::Queuing, size_of::<GroundMessage>()),
                channel(2, "estimator.state", !initiator, PortKind::Sampling, size_of::<State>()),
            ],
        }],
    }
}

/// The surroundings of the relay that sends rates and orders, and takes a state.
struct Fcu {
    harness: Harness,
    rate: SamplingSource<Rate>,
    orders: QueuingSource<GroundMessage>,
    state: SamplingDestination<State>,
    status: SamplingDestination<LinkStatus>,
}

/// Those of the other one.
struct Nav {
    harness: Harness,
    rate: SamplingDestination<Rate>,
    orders: QueuingDestination<GroundMessage>,
    state: SamplingSource<State>,
}

fn free() -> [SocketAddr; 2] {
    let sockets = [(); 2].map(|()| UdpSocket::bind("127.0.0.1:0").unwrap());
    sockets.map(|socket| socket.local_addr().unwrap())
}

fn surroundings(transport: &str) -> (Fcu, Nav) {
    let [here, there] = free();
    let attribute = |table: &RelayTable| serde_json::to_value(table).unwrap();
    let mut fcu = Harness::new("relay_fcu").unwrap();
    fcu.attribute(ATTRIBUTE, attribute(&table(true, here, there, transport)));
    let mut nav = Harness::new("relay_nav").unwrap();
    nav.attribute(ATTRIBUTE, attribute(&table(false, there, here, transport)));
    let fcu = Fcu {
        rate: fcu.sampling_destination("rate_generator_rate", 0).unwrap(),
        orders: fcu.queuing_destination("command_orders", 8).unwrap(),
        state: fcu.sampling_source("estimator_state").unwrap(),
        status: fcu.sampling_source(STATUS).unwrap(),
        harness: fcu,
    };
    let nav = Nav {
        rate: nav.sampling_source("rate_generator_rate").unwrap(),
        orders: nav.queuing_source("command_orders", 8).unwrap(),
        state: nav.sampling_destination("estimator_state", 0).unwrap(),
        harness: nav,
    };
    (fcu, nav)
}

const STATUS: &str = bateleur_contract::relay::STATUS_PORT;

#[test]
fn messages_cross_with_their_stamps_and_a_restarted_relay_is_met_again() {
    let (mut fcu, mut nav) = surroundings(STEPPED);
    let mut here = fcu.harness.start::<Relay>().unwrap();
    let mut there = nav.harness.start::<Relay>().unwrap();
    // Written once, before anybody is there to receive it.
    fcu.rate.write(&Rate { synchronize: 1, ..Rate::default() });
    for _ in 0..4 {
        here.window();
        there.window();
    }
    let rate = nav.rate.read().unwrap();
    assert_eq!((rate.value.synchronize, rate.sequence), (1, 1));
    assert_eq!(rate.age_ns, 80_000_000, "as old as it is where it was written");
    for letter in 1..=3 {
        fcu.orders.send(&GroundMessage { letter, ..GroundMessage::default() });
    }
    nav.state.write(&State { status: 3, ..State::default() });
    for _ in 0..2 {
        here.window();
        there.window();
    }
    let orders: Vec<u8> = std::iter::from_fn(|| nav.orders.receive()).map(|order| order.letter).collect();
    assert_eq!(orders, [1, 2, 3]);
    assert_eq!(fcu.state.read().unwrap().value.status, 3);
    let status = *fcu.status.read().unwrap().value;
    assert_eq!((status.links, status.id[0], status.state[0]), (1, 3, UP));
    assert_eq!((status.messages_sent[0], status.messages_received[0], status.messages_lost[0]), (4, 1, 0));
    assert!(fcu.harness.reports().iter().any(|text| text == "link bus: up, nav is there"));

    drop(there);
    let mut there = nav.harness.start::<Relay>().unwrap();
    for number in 2..8 {
        fcu.rate.write(&Rate { synchronize: number, ..Rate::default() });
        here.window();
        there.window();
    }
    assert_eq!(nav.rate.read().unwrap().value.synchronize, 7);
    let said = fcu.harness.reports();
    assert!(said.iter().any(|text| text.contains("the relay of nav was restarted")), "{said:?}");
}

#[test]
fn value_that_was_written_once_while_the_peers_relay_was_down_reaches_its_next_life() {
    let (mut fcu, mut nav) = surroundings(STEPPED);
    let mut here = fcu.harness.start::<Relay>().unwrap();
    let mut there = nav.harness.start::<Relay>().unwrap();
    for _ in 0..4 {
        here.window();
        there.window();
    }
    drop(there);
    fcu.rate.write(&Rate { synchronize: 5, ..Rate::default() });
    here.window(); // to nobody, before the silence is noticed
    let mut there = nav.harness.start::<Relay>().unwrap();
    for _ in 0..5 {
        here.window();
        there.window();
    }
    assert_eq!(nav.rate.read().map(|rate| rate.value.synchronize), Some(5));
}

#[test]
fn message_that_nobody_is_there_to_receive_is_told_as_that_and_not_as_a_full_queue() {
    let (mut fcu, mut nav) = surroundings(STEPPED);
    let mut here = fcu.harness.start::<Relay>().unwrap();
    let mut there = nav.harness.start::<Relay>().unwrap();
    drop(nav.orders);
    for letter in 0..40 {
        fcu.orders.send(&GroundMessage { letter, ..GroundMessage::default() });
        here.window();
        there.window();
    }
    let said = nav.harness.reports();
    let counts =
        said.iter().filter(|text| text.starts_with("link bus: nobody receives command.orders; ")).count();
    assert!((3..=7).contains(&counts), "as it becomes twice as much: {said:?}");
    assert!(!said.iter().any(|text| text.contains("no room")), "{said:?}");
    assert_eq!(there.partition.ends[0].link.counters().messages_overflowed, 0);
}

#[test]
fn frames_of_the_peer_are_told_in_own_time_once_there_was_an_exchange() {
    let (mut fcu, mut nav) = surroundings(STEPPED);
    let mut here = fcu.harness.start::<Relay>().unwrap();
    let own = Frame { number: 7, start_ns: 5_000 };
    assert_eq!(report(&here.partition.ends[0].link, own, 0), None);
    let mut there = nav.harness.start::<Relay>().unwrap();
    for _ in 0..5 {
        here.window();
        there.window();
    }
    // The clocks of both are one, and the peer's frame began at 0.
    let told = report(&here.partition.ends[0].link, own, 100_000_000).unwrap();
    assert_eq!(told.peer_minus_own_ns, -5_000);
    assert!(told.exchanges > 0 && told.uncertainty_ns < 25_000_000, "{told:?}");
}

#[test]
fn a_peer_that_goes_is_an_error_once_and_its_return_is_said() {
    let (mut fcu, mut nav) = surroundings("udp");
    let mut here = fcu.harness.start::<Relay>().unwrap();
    let mut there = nav.harness.start::<Relay>().unwrap();
    let both = |here: &mut bateleur_apex::Incarnation<Relay>,
                there: &mut bateleur_apex::Incarnation<Relay>| {
        here.window();
        there.window();
        std::thread::sleep(std::time::Duration::from_millis(2)); // for the sockets, not for the relays
    };
    for _ in 0..6 {
        both(&mut here, &mut there);
    }
    assert_eq!(fcu.status.read().unwrap().value.state[0], UP);
    let _ = fcu.harness.reports();
    drop(there);
    for _ in 0..20 {
        here.window();
    }
    assert_eq!(
        fcu.harness.reports(),
        [
            "link bus: nothing comes on network a any more; the computer there says that no relay listens",
            "link bus: down, nav is not heard"
        ]
    );
    let mut there = nav.harness.start::<Relay>().unwrap();
    for _ in 0..6 {
        both(&mut here, &mut there);
    }
    let said = fcu.harness.reports();
    assert!(said.iter().any(|text| text == "link bus: up, nav is there"), "{said:?}");
}

#[test]
fn network_on_which_nothing_could_be_taken_says_so_and_why() {
    let (mut fcu, _) = surroundings("udp");
    let [local, remote] = free();
    let table = serde_json::to_value(table(true, local, remote, "udp")).unwrap();
    fcu.harness.attribute(ATTRIBUTE, table);
    let mut here = fcu.harness.start::<Relay>().unwrap();
    let stranger = UdpSocket::bind(remote).unwrap();
    stranger.send_to(b"not of this world", local).unwrap();
    std::thread::sleep(std::time::Duration::from_millis(5)); // for the socket
    for _ in 0..20 {
        here.window();
    }
    let said = fcu.harness.reports();
    let expected = "link bus: 1 datagrams came on network a, none was taken: truncated 1";
    assert!(said.iter().any(|text| text == expected), "{said:?}");
}

#[test]
fn a_relay_without_a_table_or_with_an_unknown_transport_says_so() {
    let refused = |harness: &mut Harness| harness.start::<Relay>().err().unwrap().to_string();
    assert!(refused(&mut Harness::new("relay_fcu").unwrap()).contains("without a table of links"));
    let [here, there] = free();
    let mut harness = Harness::new("relay_fcu").unwrap();
    let table = serde_json::to_value(table(true, here, there, "carrier pigeon")).unwrap();
    harness.attribute(ATTRIBUTE, table);
    assert!(refused(&mut harness).contains("transport \"carrier pigeon\""));
}
