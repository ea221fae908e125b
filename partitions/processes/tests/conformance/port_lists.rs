//! Lists of queuing ports.

use bateleur_processes::standard::*;
use bateleur_processes::{Progress, ReturnCode};

use crate::bench::*;

const SOURCE: PortDirection = PortDirection::Source;
const DESTINATION: PortDirection = PortDirection::Destination;
const ACTIVE: PortAction = PortAction::Active;
const INACTIVE: PortAction = PortAction::Inactive;
const RESET: ResetList = ResetList::Reset;
const CONTINUE: ResetList = ResetList::Continue;

/// What a service has given: its message, and the port.
type Got = (Result<Progress, ReturnCode>, Vec<u8>, Option<QueuingPortId>);

impl Bench {
    fn port(&mut self, name: &str, direction: PortDirection) -> QueuingPortId {
        self.channels.add_queuing(name, direction);
        self.partition.create_queuing_port(&self.channels, name, 8, 2, direction, FIFO).unwrap()
    }

    fn with_port_of_list(
        &mut self,
        list: QueuingPortListId,
        time_out: SystemTime,
        size: i32,
        order: ResetList,
    ) -> Got {
        let (mut message, mut port) = (vec![9], None);
        let Self { partition, channels } = self;
        let into = (&mut message, &mut port);
        let got =
            partition.receive_message_from_queuing_port_list(channels, list, time_out, size, order, into);
        (got, message, port)
    }

    fn polled(&mut self, list: QueuingPortListId, order: ResetList) -> (Vec<u8>, Option<QueuingPortId>) {
        let (got, message, port) = self.with_port_of_list(list, 0, 8, order);
        assert_eq!(got, Ok(Progress::Done(())));
        (message, port)
    }

    fn comes(&mut self, queue: usize, message: &[u8]) {
        self.channels.queuing[queue].messages.push_back(message.to_vec());
    }

    fn look(&mut self) {
        let Self { partition, channels } = self;
        partition.serve_ports(channels);
    }
}

/// Three destinations in a list, in NORMAL, with one process that runs.
fn listed() -> (Bench, QueuingPortListId, [QueuingPortId; 3], ProcessId) {
    let mut bench = Bench::new();
    let ports = ["one", "two", "three"].map(|name| bench.port(name, DESTINATION));
    let list = bench.create_queuing_port_list("list", 3).unwrap();
    ports.iter().for_each(|port| bench.add_port_to_queuing_port_list(list, *port, ACTIVE).unwrap());
    let a = bench.started("a", 10);
    bench.normal();
    (bench, list, ports, a)
}

#[test]
fn qpl_create_01_as_many_as_there_may_be() {
    let mut bench = Bench::with(|settings| settings.limits.objects = 1);
    assert_eq!(code(bench.create_queuing_port_list("one", 1)), NE);
    assert_eq!(code(bench.create_queuing_port_list("two", 1)), IC);
}

#[test]
fn qpl_create_02_name_exists() {
    let mut bench = Bench::new();
    bench.create_queuing_port_list("list", 1).unwrap();
    assert_eq!(code(bench.create_queuing_port_list("List", 1)), NA);
}

#[test]
fn qpl_create_03_number_of_ports_below_one_is_a_wrong_parameter() {
    let mut bench = Bench::new();
    for most in [0, -1, i32::MIN] {
        assert_eq!(code(bench.create_queuing_port_list("list", most)), IP);
    }
    assert_eq!(code(bench.create_queuing_port_list("list", i32::MAX)), NE);
}

#[test]
fn qpl_create_04_in_normal() {
    let (mut bench, ..) = listed();
    assert_eq!(code(bench.create_queuing_port_list("late", 1)), IM);
}

#[test]
fn qpl_add_01_unknown_list_or_port() {
    let mut bench = Bench::new();
    let port = bench.port("one", DESTINATION);
    let list = bench.create_queuing_port_list("list", 1).unwrap();
    assert_eq!(bench.add_port_to_queuing_port_list(QueuingPortListId(1), port, ACTIVE), IP);
    assert_eq!(bench.add_port_to_queuing_port_list(list, QueuingPortId(1), ACTIVE), IP);
    assert_eq!(bench.add_port_to_queuing_port_list(list, port, NONSENSE), IP, "or an unknown action");
}

#[test]
fn qpl_add_02_source() {
    let mut bench = Bench::new();
    let port = bench.port("one", SOURCE);
    let list = bench.create_queuing_port_list("list", 1).unwrap();
    assert_eq!(bench.add_port_to_queuing_port_list(list, port, ACTIVE), IM);
}

#[test]
fn qpl_add_03_port_that_is_in_the_list() {
    let mut bench = Bench::new();
    let port = bench.port("one", DESTINATION);
    let list = bench.create_queuing_port_list("list", 2).unwrap();
    assert_eq!(bench.add_port_to_queuing_port_list(list, port, ACTIVE), NE);
    assert_eq!(bench.add_port_to_queuing_port_list(list, port, INACTIVE), NA);
    assert_eq!(bench.get_queuing_port_action_status(list, port), Ok(ACTIVE), "nothing has changed");
}

#[test]
fn qpl_add_04_full_list() {
    let mut bench = Bench::new();
    let ports = ["one", "two"].map(|name| bench.port(name, DESTINATION));
    let list = bench.create_queuing_port_list("list", 1).unwrap();
    let added = ports.map(|port| bench.add_port_to_queuing_port_list(list, port, ACTIVE));
    assert_eq!(added, [NE, IC]);
}

#[test]
fn qpl_add_05_in_normal() {
    let mut bench = Bench::new();
    let port = bench.port("one", DESTINATION);
    let list = bench.create_queuing_port_list("list", 1).unwrap();
    bench.started("a", 10);
    bench.normal();
    assert_eq!(bench.add_port_to_queuing_port_list(list, port, ACTIVE), IM);
}

#[test]
fn qpl_add_06_port_of_another_list() {
    let mut bench = Bench::new();
    let port = bench.port("one", DESTINATION);
    for name in ["first", "second"] {
        let list = bench.create_queuing_port_list(name, 1).unwrap();
        one_of(bench.add_port_to_queuing_port_list(list, port, ACTIVE), &[IC, NE]);
    }
}

#[test]
fn qpl_set_01_unknown_list_or_port() {
    let (mut bench, list, ports, _) = listed();
    assert_eq!(bench.set_port_action_in_queuing_port_list(QueuingPortListId(1), ports[0], INACTIVE), IP);
    assert_eq!(bench.set_port_action_in_queuing_port_list(list, QueuingPortId(1), INACTIVE), IP);
    assert_eq!(bench.set_port_action_in_queuing_port_list(list, ports[0], NONSENSE), IP);
}

#[test]
fn qpl_set_02_port_that_is_not_in_the_list() {
    let mut bench = Bench::new();
    let port = bench.port("one", DESTINATION);
    let list = bench.create_queuing_port_list("list", 1).unwrap();
    assert_eq!(bench.set_port_action_in_queuing_port_list(list, port, INACTIVE), IC);
}

#[test]
fn qpl_set_03_the_same_action() {
    let (mut bench, list, ports, _) = listed();
    assert_eq!(bench.set_port_action_in_queuing_port_list(list, ports[1], ACTIVE), NA);
}

#[test]
fn qpl_set_04_another_action_in_normal_too() {
    let (mut bench, list, ports, _) = listed();
    for action in [INACTIVE, ACTIVE] {
        assert_eq!(bench.set_port_action_in_queuing_port_list(list, ports[1], action), NE);
        assert_eq!(bench.get_queuing_port_action_status(list, ports[1]), Ok(action));
    }
}

#[test]
fn qpl_stat_01_unknown_list_or_port_or_not_in_the_list() {
    let mut bench = Bench::new();
    let port = bench.port("one", DESTINATION);
    let list = bench.create_queuing_port_list("list", 1).unwrap();
    assert_eq!(code(bench.get_queuing_port_action_status(QueuingPortListId(1), port)), IP);
    assert_eq!(code(bench.get_queuing_port_action_status(list, QueuingPortId(1))), IP);
    assert_eq!(code(bench.get_queuing_port_action_status(list, port)), IC);
}

#[test]
fn qpl_recv_01_unknown_list() {
    let (mut bench, ..) = listed();
    assert_eq!(code(bench.with_port_of_list(QueuingPortListId(1), 0, 8, RESET).0), IP);
}

#[test]
fn qpl_recv_02_time_out_out_of_range() {
    let (mut bench, list, ..) = listed();
    bench.at(1);
    assert_eq!(code(bench.with_port_of_list(list, SystemTime::MAX, 8, RESET).0), IP);
}

#[test]
fn qpl_recv_03_message_that_does_not_fit_stays() {
    let (mut bench, list, ports, _) = listed();
    bench.comes(1, b"long");
    for size in [3, 0, -1] {
        let (got, message, _) = bench.with_port_of_list(list, 0, size, RESET);
        assert_eq!((code(got), message), (IP, vec![]), "{size} bytes");
    }
    let (got, message, port) = bench.with_port_of_list(list, 0, 4, RESET);
    assert_eq!((code(got), &*message, port), (NE, &b"long"[..], Some(ports[1])));
}

#[test]
fn qpl_recv_04_from_the_first_port_or_behind_the_last_one() {
    let (mut bench, list, ports, _) = listed();
    for queue in [0, 0, 1, 1, 2, 2] {
        bench.comes(queue, b"x");
    }
    let mut served = |order| bench.polled(list, order).1.unwrap();
    let order = [CONTINUE, CONTINUE, RESET, CONTINUE, CONTINUE];
    assert_eq!(order.map(&mut served), [0, 1, 0, 1, 2].map(|at| ports[at]), "nobody starves");
    assert_eq!(served(RESET), ports[2]);
}

#[test]
fn qpl_recv_05_oldest_message_of_a_port() {
    let (mut bench, list, ports, a) = listed();
    bench.comes(2, b"first");
    bench.comes(2, b"second");
    assert_eq!(bench.polled(list, RESET), (b"first".to_vec(), Some(ports[2])));
    assert_eq!(bench.polled(list, RESET), (b"second".to_vec(), Some(ports[2])));
    // And what comes while it waits.
    waits(bench.with_port_of_list(list, FOREVER, 8, RESET).0);
    bench.nobody_runs();
    bench.comes(1, b"later");
    bench.look();
    bench.runs(a);
    assert_eq!(
        (bench.result(), bench.message(), bench.served_port_of(a)),
        (NE, &b"later"[..], Some(ports[1]))
    );
}

#[test]
fn qpl_recv_06_message_behind_a_lost_one_comes_with_the_code_that_says_so() {
    let (mut bench, list, ports, a) = listed();
    bench.comes(0, b"next");
    bench.channels.queuing[0].overflow = true;
    let (got, message, port) = bench.with_port_of_list(list, 0, 8, RESET);
    assert_eq!((code(got), &*message, port), (IC, &b"next"[..], Some(ports[0])));
    waits(bench.with_port_of_list(list, FOREVER, 8, RESET).0);
    bench.comes(2, b"more");
    bench.channels.queuing[2].overflow = true;
    bench.look();
    assert_eq!(
        (bench.result(), bench.message(), bench.served_port_of(a)),
        (IC, &b"more"[..], Some(ports[2]))
    );
}

#[test]
fn qpl_recv_07_nothing_there() {
    let (mut bench, list, ..) = listed();
    let (got, message, port) = bench.with_port_of_list(list, 0, 8, RESET);
    assert_eq!((code(got), message, port), (NV, vec![], None));
}

#[test]
fn qpl_recv_08_caller_that_must_not_wait() {
    let mut bench = Bench::new();
    let port = bench.port("one", DESTINATION);
    let list = bench.create_queuing_port_list("list", 1).unwrap();
    bench.add_port_to_queuing_port_list(list, port, ACTIVE).unwrap();
    assert_eq!(code(bench.with_port_of_list(list, ms(5), 8, RESET).0), IM, "the main process");
    bench.started("a", 10);
    let mutex = bench.create_mutex("m", 200, FIFO).unwrap();
    bench.normal();
    done(bench.acquire_mutex(mutex, 0));
    assert_eq!(code(bench.with_port_of_list(list, FOREVER, 8, RESET).0), IM);
    bench.comes(0, b"x");
    assert_eq!(code(bench.with_port_of_list(list, FOREVER, 8, RESET).0), NE, "it does not have to wait");
}

#[test]
fn qpl_recv_09_nothing_comes_in_time() {
    let (mut bench, list, _, a) = listed();
    waits(bench.with_port_of_list(list, ms(5), 8, RESET).0);
    bench.at(5);
    bench.runs(a);
    assert_eq!((bench.result(), bench.message(), bench.served_port_of(a)), (TM, &b""[..], None));
    bench.comes(0, b"x");
    bench.look();
    assert_eq!(bench.polled(list, RESET).0, b"x", "nobody waits any more");
}

#[test]
fn qpl_recv_10_inactive_port_is_never_served() {
    let (mut bench, list, ports, a) = listed();
    bench.set_port_action_in_queuing_port_list(list, ports[0], INACTIVE).unwrap();
    bench.comes(0, b"x");
    assert_eq!(code(bench.with_port_of_list(list, 0, 8, RESET).0), NV);
    waits(bench.with_port_of_list(list, FOREVER, 8, RESET).0);
    bench.look();
    bench.nobody_runs();
    bench.comes(2, b"y");
    bench.look();
    bench.runs(a);
    assert_eq!(bench.served_port_of(a), Some(ports[2]));
}

#[test]
fn qpl_wait_01_message_stays_in_the_port_that_is_told() {
    let (mut bench, list, ports, a) = listed();
    let waited = |bench: &mut Bench, time_out| {
        let Bench { partition, channels } = bench;
        let mut port = None;
        let waited =
            partition.wait_for_message_from_queuing_port_list(channels, list, time_out, RESET, &mut port);
        (waited, port)
    };
    assert_eq!(code(waited(&mut bench, 0).0), NV);
    waits(waited(&mut bench, FOREVER).0);
    bench.comes(1, b"long one");
    bench.look();
    bench.runs(a);
    assert_eq!((bench.result(), bench.message(), bench.served_port_of(a)), (NE, &b""[..], Some(ports[1])));
    assert_eq!(waited(&mut bench, 0), (Ok(Progress::Done(())), Some(ports[1])), "it is there still");
    assert_eq!(bench.polled(list, RESET), (b"long one".to_vec(), Some(ports[1])));
}

#[test]
fn process_that_waits_at_a_port_goes_before_one_that_waits_at_a_list_with_it() {
    let mut bench = Bench::new();
    let port = bench.port("one", DESTINATION);
    let list = bench.create_queuing_port_list("list", 1).unwrap();
    bench.add_port_to_queuing_port_list(list, port, ACTIVE).unwrap();
    let (b, a) = (bench.started("b", 20), bench.started("a", 10));
    bench.normal();
    bench.runs(b);
    waits(bench.with_port_of_list(list, FOREVER, 8, RESET).0);
    bench.runs(a);
    let Bench { partition, channels } = &mut bench;
    waits(partition.receive_queuing_message(channels, port, FOREVER, &mut Vec::new()));
    assert!(bench.waits_at_ports());
    bench.comes(0, b"x");
    bench.look();
    bench.runs(a);
    bench.comes(0, b"y");
    bench.look();
    bench.runs(b);
    assert!(!bench.waits_at_ports());
}
