//! Two logs side by side.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod by_hand;

use std::path::{Path, PathBuf};

use bateleur_messages::{Message, Rates, ServoTimers, State, find};
use bateleur_recording::{PortLog, topic};
use bateleur_report::compare::{Comparison, Options, Place, Side, Tolerance, compare};
use by_hand::{channel, message, schema};
use zerocopy::IntoBytes;

/// What is written at step `n`; `None`: nothing.
type Made<T> = fn(u64) -> Option<T>;

fn state(n: u64) -> State {
    State { valid_ns: n * 20_000_000, euler_rad: [0.1, 0.2, n as f64 * 0.01], ..State::default() }
}

fn rates(n: u64) -> Rates {
    Rates { measured_ns: n * 20_000_000, interval_ns: 20_000_000, rates_radps: [0.0, -0.0, f64::NAN] }
}

/// A log of a hundred frames with two ports; `offset_ns` is how late its source was.
fn write(path: &Path, states: Made<State>, offset_ns: u64) -> PathBuf {
    let mut log = PortLog::create(path).unwrap();
    let one = log.add_channel(&topic("estimator", "state"), find(State::NAME).unwrap()).unwrap();
    let two = log.add_channel(&topic("imu", "orientation"), find(Rates::NAME).unwrap()).unwrap();
    for n in 0..100 {
        let time_ns = n * 20_000_000;
        log.write(two, n, time_ns + 3_800_000, rates(n).as_bytes()).unwrap();
        if let Some(state) = states(n) {
            log.write(one, n, time_ns + 4_400_000 + offset_ns, state.as_bytes()).unwrap();
        }
    }
    log.finish().unwrap();
    path.to_path_buf()
}

fn usual(n: u64) -> Option<State> {
    Some(state(n))
}

/// From frame 40 on the yaw is a little larger.
fn off(n: u64) -> Option<State> {
    let mut state = state(n);
    state.euler_rad[2] += if n < 40 { 0.0 } else { 1e-6 };
    Some(state)
}

fn hole(n: u64) -> Option<State> {
    (n != 60).then(|| state(n))
}

fn compared(a: Made<State>, b: Made<State>, options: &Options) -> Comparison {
    let folder = tempfile::tempdir().unwrap();
    let a = write(&folder.path().join("a"), a, 0);
    let b = write(&folder.path().join("b"), b, 0);
    compare(&a, &b, options).unwrap()
}

fn places(names: &[&str]) -> Vec<Place> {
    names.iter().map(|name| Place((*name).to_owned())).collect()
}

#[test]
fn the_same_messages_are_equal_also_where_they_are_no_numbers() {
    let found = compared(usual, usual, &Options::default());
    assert!(found.equal && found.first.is_none() && found.incomparable.is_empty());
    assert_eq!(found.ports.iter().map(|port| port.compared).collect::<Vec<_>>(), [100, 100]);
}

#[test]
fn first_difference_is_found_with_port_field_time_sequence_and_both_values() {
    let found = compared(usual, off, &Options::default());
    let first = found.first.unwrap();
    assert_eq!((first.port.as_str(), first.sequence, first.time_ns), ("estimator.state", 40, 804_400_000));
    assert_eq!(first.fields.len(), 1);
    assert_eq!(first.fields[0].field, "euler_rad[2]");
    assert_eq!((first.fields[0].a.clone(), first.fields[0].b.clone()), (0.4.into(), (0.4 + 1e-6).into()));
    let port = &found.ports[0];
    assert_eq!((port.compared, port.different, port.only_a, port.only_b), (100, 60, 0, 0));
    assert!(found.ports[1].first.is_none());
}

#[test]
fn tolerance_holds_where_it_was_given_and_the_longest_place_counts() {
    let with = |list: &[(Option<&str>, f64)]| {
        let tolerances = list.iter().map(|(place, at_most)| Tolerance {
            place: place.map(|name| Place(name.into())),
            at_most: *at_most,
        });
        compared(usual, off, &Options { tolerances: tolerances.collect(), ..Options::default() }).equal
    };
    assert!(with(&[(None, 2e-6)]) && !with(&[(None, 5e-7)]));
    assert!(with(&[(Some("estimator.state.euler_rad"), 2e-6)]));
    assert!(!with(&[(Some("estimator.state.position_ned_m"), 1.0)]));
    assert!(!with(&[(Some("estimator.state.euler_rad[2]"), 1e-7), (None, 1.0)]));
}

#[test]
fn only_what_was_asked_for_is_compared() {
    let only = |names: &[&str]| compared(usual, off, &Options { only: places(names), ..Options::default() });
    assert!(only(&["imu"]).equal && only(&["estimator.state.position_ned_m"]).equal);
    assert!(!only(&["estimator.state.euler_rad"]).equal);
    assert_eq!(only(&["imu"]).ports.len(), 1);
    let ignored = |name| Options { ignored: places(&[name]), ..Options::default() };
    assert!(compared(usual, off, &ignored("estimator.state.euler_rad")).equal);
    assert!(!compared(usual, off, &ignored("estimator.state.euler_rad[1]")).equal);
    let early = Options { until_ns: Some(790_000_000), ..Options::default() };
    assert!(compared(usual, off, &early).equal);
}

#[test]
fn place_that_is_nowhere_is_said_and_does_not_count_as_equal() {
    let found = compared(usual, usual, &Options { only: places(&["estimator.stat"]), ..Options::default() });
    assert!(!found.equal);
    assert_eq!(
        found.incomparable,
        ["there is no port or field `estimator.stat` in either log: did you mean `estimator.state`?"]
    );
}

#[test]
fn message_that_is_missing_in_one_log_is_one_difference() {
    let found = compared(usual, hole, &Options::default());
    let first = found.first.unwrap();
    assert_eq!((first.only_in, first.sequence), (Some(Side::A), 60));
    assert_eq!((found.ports[0].compared, found.ports[0].only_a, found.ports[0].different), (99, 1, 0));
}

#[test]
fn times_may_differ_by_the_tolerance_and_no_more() {
    let folder = tempfile::tempdir().unwrap();
    let a = write(&folder.path().join("a"), usual, 0);
    let b = write(&folder.path().join("b"), usual, 50_000);
    let with =
        |time_tolerance_ns| compare(&a, &b, &Options { time_tolerance_ns, ..Options::default() }).unwrap();
    let first = with(49_999).first.unwrap();
    assert_eq!((first.fields[0].field.as_str(), first.fields[0].difference), ("header.time_ns", 50_000.0));
    assert!(with(50_000).equal);
}

#[test]
fn log_that_was_cut_off_is_compared_as_far_as_it_goes() {
    let folder = tempfile::tempdir().unwrap();
    let a = write(&folder.path().join("a"), usual, 0);
    let whole = std::fs::read(&a).unwrap();
    let b = folder.path().join("b");
    for keep in [whole.len() / 2, whole.len() * 3 / 4] {
        std::fs::write(&b, &whole[..keep]).unwrap();
        let found = compare(&a, &b, &Options::default()).unwrap();
        assert!(found.b.cut.is_some() && found.a.cut.is_none());
        let first = found.first.unwrap();
        assert_eq!(first.only_in, Some(Side::A));
        assert!(first.time_ns > 0 && first.time_ns.abs_diff(found.b.time_ns) <= 25_000_000);
        let until = Options { until_ns: Some(found.b.time_ns), ..Options::default() };
        assert!(compare(&a, &b, &until).unwrap().equal, "as far as it goes");
    }
    std::fs::write(&b, &whole[..3]).unwrap();
    let found = compare(&a, &b, &Options::default());
    assert!(found.map_or(true, |found| !found.equal), "nothing is not equal to something");
}

#[test]
fn port_that_one_log_lacks_and_port_of_another_type_are_said() {
    let folder = tempfile::tempdir().unwrap();
    let a = write(&folder.path().join("a"), usual, 0);
    let b = folder.path().join("b");
    let mut log = PortLog::create(&b).unwrap();
    let message = ServoTimers::default();
    let other = log.add_channel(&topic("estimator", "state"), find(ServoTimers::NAME).unwrap()).unwrap();
    log.write(other, 0, 0, message.as_bytes()).unwrap();
    log.finish().unwrap();
    let found = compare(&a, &b, &Options::default()).unwrap();
    assert!(!found.equal);
    assert_eq!(
        found.incomparable,
        ["estimator.state carries State in A and ServoTimers in B", "B has no port imu.orientation"]
    );
}

/// Two logs of messages of two bytes, with these bytes instead.
fn of_bytes(a: &[&[u8]], b: &[&[u8]], options: &Options) -> Comparison {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, list: &[&[u8]]| {
        let messages = list.iter().enumerate().map(|(n, bytes)| message(1, n as u32, n as u64 * 1000, bytes));
        let records: Vec<_> =
            [schema("uint16 x\n"), channel(1, "/a/b")].into_iter().chain(messages).collect();
        by_hand::write(&folder.path().join(name), &records)
    };
    compare(&write("a", a), &write("b", b), options).unwrap()
}

#[test]
fn messages_that_do_not_fit_their_layout_differ_where_their_bytes_do() {
    let loose = Options { tolerances: vec![Tolerance { place: None, at_most: 1e9 }], ..Options::default() };
    for options in [Options::default(), loose] {
        let found =
            of_bytes(&[&[1, 2], &[1, 2, 3], &[1, 2, 3]], &[&[1, 2], &[1, 2, 4], &[1, 2, 4]], &options);
        let first = found.first.unwrap();
        assert_eq!((first.sequence, first.fields[0].field.as_str()), (1, "byte[2]"));
        assert_eq!((&first.fields[0].a, &first.fields[0].b), (&3.into(), &4.into()));
        assert_eq!((found.equal, found.ports[0].different), (false, 2));
        let found = of_bytes(&[&[1, 2], &[3, 4]], &[&[1, 2], &[3]], &options);
        let fields = found.first.unwrap().fields;
        assert_eq!((fields[0].field.as_str(), fields[0].difference), ("length in bytes", -1.0));
    }
    assert!(of_bytes(&[&[1, 2, 3]], &[&[1, 2, 3]], &Options::default()).equal, "the same bytes are the same");
}

#[test]
fn damaged_log_in_which_nothing_differs_is_not_called_equal() {
    let folder = tempfile::tempdir().unwrap();
    let a = write(&folder.path().join("a"), usual, 0);
    let mut bytes = std::fs::read(&a).unwrap();
    let header = bytes.windows(4).position(|window| window == [0, 1, 0, 0]).unwrap();
    bytes[header - 1] ^= 1; // the publish time, which is not compared
    let b = folder.path().join("b");
    std::fs::write(&b, bytes).unwrap();
    for (one, other, name) in [(&a, &b, "B"), (&b, &a, "A")] {
        let found = compare(one, other, &Options::default()).unwrap();
        assert!(!found.equal && found.first.is_none());
        assert_eq!(found.incomparable, [format!("what was in {name} before it was damaged")]);
    }
}

/// Ten thousand messages, a millisecond apart, and one from the end of time before number `place`.
fn with_one_far_ahead(path: &Path, place: Option<u64>) -> PathBuf {
    let mut records = vec![schema("uint8 x\n"), channel(1, "/a/b")];
    for n in 1..=10_000_u64 {
        if place == Some(n) {
            records.push(message(1, 0, u64::MAX, &[0]));
        }
        records.push(message(1, n as u32, n * 1_000_000, &[n as u8]));
    }
    by_hand::write(path, &records)
}

#[test]
fn message_with_a_time_far_ahead_is_one_difference_and_none_to_itself() {
    let folder = tempfile::tempdir().unwrap();
    let usual = with_one_far_ahead(&folder.path().join("usual"), None);
    for place in [1, 2, 5000, 10_000] {
        let far = with_one_far_ahead(&folder.path().join("far"), Some(place));
        let with_itself = compare(&far, &far, &Options::default()).unwrap();
        assert!(with_itself.equal && with_itself.ports[0].compared == 10_001, "{place}: {with_itself:?}");
        for (a, b, alone) in [(&far, &usual, (1, 0)), (&usual, &far, (0, 1))] {
            let found = &compare(a, b, &Options::default()).unwrap().ports[0];
            assert_eq!((found.compared, (found.only_a, found.only_b)), (10_000, alone), "{place}");
        }
    }
}

#[test]
fn schema_that_asks_for_all_memory_is_not_understood_and_said() {
    let folder = tempfile::tempdir().unwrap();
    let records = [schema("uint8[2000000000] x\n"), channel(1, "/a/b"), message(1, 1, 0, &[])];
    let log = by_hand::write(&folder.path().join("huge"), &records);
    let found = compare(&log, &log, &Options::default()).unwrap();
    assert_eq!(found.incomparable, ["a.b: the logs do not say what a X is made of"]);
}
