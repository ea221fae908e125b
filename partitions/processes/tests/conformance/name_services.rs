//! NS: name services.

use bateleur_processes::standard::*;

use crate::bench::*;

const GROUND: SapAddress = SapAddress::new(std::net::Ipv4Addr::new(10, 77, 0, 1), 14_550);
const NOBODY: SapAddress = SapAddress::new(std::net::Ipv4Addr::new(10, 77, 0, 9), 1);
const UNKNOWN: NameServiceId = NameServiceId(77);

/// The plan has the name service `stations`, which knows where `ground` and `relay` are.
fn bench() -> Bench {
    Bench::with(|settings| {
        let addresses = ["ground", "relay"].map(|name| (name.to_owned(), GROUND)).to_vec();
        settings.name_services = vec![(Name::new("stations").unwrap(), addresses)];
    })
}

/// In NORMAL: the name service, and a process of priority 10 that runs.
fn running() -> (Bench, NameServiceId, ProcessId) {
    let mut bench = bench();
    let id = bench.create_name_service("stations", FIFO).unwrap();
    let a = bench.started("a", 10);
    bench.normal();
    (bench, id, a)
}

fn get_name(bench: &mut Bench, id: NameServiceId, address: SapAddress, time_out: SystemTime) -> Code {
    code(bench.get_name(id, address, time_out, 32, &mut Vec::new()))
}

fn get_address(bench: &mut Bench, id: NameServiceId, name: &[u8], time_out: SystemTime) -> Code {
    code(bench.get_address(id, name, time_out, &mut None))
}

#[test]
fn ns_create_01_one_that_the_plan_does_not_have_or_too_many() {
    for name in ["another", "", "a name that is longer than the 32 characters of one"] {
        assert_eq!(code(bench().create_name_service(name, FIFO)), IC, "{name}");
    }
    let mut none = Bench::with(|settings| settings.limits.objects = 0);
    assert_eq!(code(none.create_name_service("stations", FIFO)), IC);
}

#[test]
fn ns_create_02_created_already() {
    let mut bench = bench();
    bench.create_name_service("stations", FIFO).unwrap();
    assert_eq!(code(bench.create_name_service("Stations", FIFO)), NA);
}

#[test]
fn ns_create_03_discipline() {
    assert_eq!(code(bench().create_name_service("stations", NONSENSE)), IC);
    assert_eq!(code(bench().create_name_service("stations", BY_PRIORITY)), NE);
}

#[test]
fn ns_create_04_not_in_normal() {
    let mut bench = bench();
    bench.started("a", 10);
    bench.normal();
    assert_eq!(code(bench.create_name_service("stations", FIFO)), IM);
}

#[test]
fn ns_name_01_unknown_name_service() {
    let (mut bench, ..) = running();
    assert_eq!(get_name(&mut bench, UNKNOWN, GROUND, 0), IP);
}

#[test]
fn ns_name_02_time_out_out_of_range() {
    let (mut bench, id, _) = running();
    bench.at(1);
    for time_out in [-2, SystemTime::MAX] {
        assert_eq!(get_name(&mut bench, id, GROUND, time_out), IP, "{time_out}");
    }
}

#[test]
fn ns_name_03_no_byte_may_be_written() {
    let (mut bench, id, _) = running();
    for most in [0, -1] {
        assert_eq!(code(bench.get_name(id, GROUND, 0, most, &mut Vec::new())), IP, "{most}");
    }
}

#[test]
fn ns_name_04_nobody_has_the_address_and_no_waiting() {
    let (mut bench, id, _) = running();
    assert_eq!(get_name(&mut bench, id, NOBODY, 0), NV);
}

#[test]
fn ns_name_05_whoever_must_not_wait_gets_what_is_known_and_nothing_else() {
    let (mut bench, id, _) = running();
    done(bench.lock_preemption());
    assert_eq!(get_name(&mut bench, id, NOBODY, FOREVER), IM);
    assert_eq!(get_name(&mut bench, id, GROUND, FOREVER), NE);
}

#[test]
fn ns_name_06_no_answer_in_time() {
    let (mut bench, id, a) = running();
    waits(bench.get_name(id, NOBODY, ms(10), 32, &mut Vec::new()));
    assert_eq!(bench.who(), None);
    bench.at(10);
    bench.runs(a);
    assert_eq!((bench.result(), bench.next_timer()), (TM, None));
}

#[test]
fn ns_name_07_longer_than_the_space_for_it() {
    let (mut bench, id, _) = running();
    let mut name = b"before".to_vec();
    assert_eq!(code(bench.get_name(id, GROUND, 0, 5, &mut name)), IC);
    assert!(name.is_empty());
    done(bench.get_name(id, GROUND, 0, 6, &mut name));
}

#[test]
fn ns_name_08_first_name_with_the_address() {
    let (mut bench, id, a) = running();
    let mut name = Vec::new();
    done(bench.get_name(id, GROUND, FOREVER, 32, &mut name));
    bench.runs(a);
    assert_eq!(name, b"ground");
}

#[test]
fn ns_addr_01_checks_and_waiting_are_those_of_get_name() {
    let (mut bench, id, a) = running();
    bench.at(1);
    assert_eq!(get_address(&mut bench, UNKNOWN, b"ground", 0), IP);
    for time_out in [-2, SystemTime::MAX] {
        assert_eq!(get_address(&mut bench, id, b"ground", time_out), IP, "{time_out}");
    }
    assert_eq!(get_address(&mut bench, id, b"Ground", 0), NV, "a point's name has one way to write it");
    done(bench.lock_preemption());
    assert_eq!(get_address(&mut bench, id, b"nobody", FOREVER), IM);
    assert_eq!(get_address(&mut bench, id, b"relay", FOREVER), NE);
    bench.unlock_preemption().unwrap();
    waits(bench.get_address(id, b"nobody", ms(10), &mut None));
    bench.at(11);
    bench.runs(a);
    assert_eq!(bench.result(), TM);
}

#[test]
fn ns_addr_02_name_without_a_byte() {
    let (mut bench, id, _) = running();
    assert_eq!(get_address(&mut bench, id, b"", FOREVER), IP);
}

#[test]
fn ns_addr_03_address_of_a_name() {
    let (mut bench, id, _) = running();
    let mut address = None;
    done(bench.get_address(id, b"relay", 0, &mut address));
    assert_eq!(address, Some(GROUND));
}
