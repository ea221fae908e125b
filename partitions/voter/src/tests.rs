use super::queues::Merger;
use super::standing::{Conduct, Standing, Verdict};
use super::*;
use bateleur_message_format::{Catalogue, Source};

const FRAME_NS: u64 = 20_000_000;

fn election(text: &str) -> Election {
    let source = Source { name: "Word".into(), file: "Word.msg".into(), text: text.into() };
    let catalogue = Catalogue::read([source]).unwrap();
    Election::new(Some(catalogue.find("Word").unwrap()))
}

/// A double, a time, a word of flags and four bytes.
const TEXT: &str = "float64 angle # [rad]\nuint64 time # [ns]\nuint32 flags\nuint8[4] bytes\n";

fn message(angle: f64, time_ns: u64, flags: u32) -> Vec<u8> {
    [&angle.to_le_bytes()[..], &time_ns.to_le_bytes(), &flags.to_le_bytes(), &[1, 2, 3, 4]].concat()
}

/// Nobody is in doubt, and replicas may not differ.
fn vote(election: &mut Election, ballots: [Option<Ballot<'_>>; REPLICAS]) -> Outcome {
    election.vote(ballots, FRAME_NS, (&Standing::default(), false))
}

fn ballots(messages: &[Vec<u8>; REPLICAS]) -> [Option<Ballot<'_>>; REPLICAS] {
    messages.each_ref().map(|bytes| Some(Ballot { bytes, source_ns: 40_000_000 }))
}

/// Numbers that repeat with their seed.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }
}

#[test]
fn whatever_one_of_three_writes_each_field_lies_between_those_of_the_two_others() {
    let mut election = election(TEXT);
    let mut random = Random(7);
    for _ in 0..20_000 {
        let near = (random.next() % 1000) as f64 / 1e6;
        let (one, other) = (message(0.25, 100, 5), message(0.25 + near, 105, 5));
        let mut lie = one.clone();
        for byte in &mut lie {
            if random.next().is_multiple_of(3) {
                *byte = random.next() as u8;
            }
        }
        let liar = (random.next() % 3) as usize;
        let mut all = [one.clone(), other.clone(), one.clone()];
        all[0] = if liar == 0 { lie.clone() } else { one.clone() };
        all[1] = if liar == 1 { lie.clone() } else { other.clone() };
        all[2] = if liar == 2 {
            lie.clone()
        } else if liar == 1 {
            other
        } else {
            one
        };
        let outcome = vote(&mut election, ballots(&all));
        assert_eq!(outcome.source_ns, Some(40_000_000));
        let angle = f64::from_le_bytes(election.message()[..8].try_into().unwrap());
        let time = u64::from_le_bytes(election.message()[8..16].try_into().unwrap());
        let rest = &election.message()[16..];
        assert!((0.25..=0.25 + near).contains(&angle), "{angle} of {all:?}");
        assert!((100..=105).contains(&time) && rest == &message(0.0, 0, 5)[16..], "{all:?}");
        let honest = (0..REPLICAS).filter(|replica| *replica != liar);
        assert!(honest.into_iter().all(|replica| outcome.differences[replica].is_none()), "{outcome:?}");
    }
}

#[test]
fn replicas_that_read_an_input_a_window_apart_do_not_differ_and_each_kind_of_lie_does() {
    let differs = |lie: Vec<u8>, source_ns: u64| {
        let mut election = election(TEXT);
        let honest = message(0.25, 100_000_000, 5);
        let all = [honest.clone(), lie, honest];
        let mut written = ballots(&all);
        written[1].as_mut().unwrap().source_ns = source_ns;
        let outcome = vote(&mut election, written);
        outcome.differences[1].clone().map(|difference| difference.field.unwrap_or_else(|| "late".into()))
    };
    assert_eq!(differs(message(0.2501, 105_000_000, 5), 45_000_000), None);
    assert_eq!(differs(message(0.3, 100_000_000, 5), 40_000_000), Some("angle".into()));
    assert_eq!(differs(message(f64::NAN, 100_000_000, 5), 40_000_000), Some("angle".into()));
    assert_eq!(differs(message(f64::INFINITY, 100_000_000, 5), 40_000_000), Some("angle".into()));
    assert_eq!(differs(message(0.25, 140_000_000, 5), 40_000_000), Some("time".into()));
    assert_eq!(differs(message(0.25, 100_000_000, 4), 40_000_000), Some("flags".into()));
    assert_eq!(differs(message(0.25, 100_000_000, 5), 5_000_000), Some("late".into()));
}

#[test]
fn of_two_that_differ_the_doubted_one_loses_and_without_doubt_nothing_is_written() {
    let (one, other) = (message(0.25, 100, 5), message(0.5, 100, 5));
    let ballot = |bytes| Some(Ballot { bytes, source_ns: 0 });
    let mut election = election(TEXT);
    assert_eq!(vote(&mut election, [ballot(&one), None, ballot(&other)]).source_ns, None);
    for doubted in [0, 2] {
        let mut standing = Standing::default();
        standing.note(doubted, Conduct::Differs);
        let two = [ballot(&one), None, ballot(&other)];
        let outcome = election.vote(two, FRAME_NS, (&standing, false));
        assert_eq!(outcome.source_ns, Some(0));
        assert_eq!(election.message(), if doubted == 0 { &other } else { &one });
        assert!(outcome.differences[doubted].is_some() && outcome.differences[2 - doubted].is_none());
    }
    let outcome = election.vote([ballot(&one), None, ballot(&other)], FRAME_NS, (&Standing::default(), true));
    assert_eq!((outcome.source_ns, election.message()), (Some(0), &one[..]), "they may differ");
    let outcome = vote(&mut election, [None, None, ballot(&other)]);
    assert_eq!((outcome.source_ns, election.message()), (Some(0), &other[..]));
    assert_eq!(vote(&mut election, [None, None, None]).source_ns, None);
}

#[test]
fn plain_bytes_are_those_that_two_wrote() {
    let mut election = Election::new(None);
    let written = |bytes: &'static [u8]| Some(Ballot { bytes, source_ns: 0 });
    let outcome = vote(&mut election, [written(b"abc"), written(b"xy"), written(b"abc")]);
    assert_eq!((election.message(), outcome.differences[1].is_some()), (&b"abc"[..], true));
    let outcome = vote(&mut election, [written(b"1"), written(b"xy"), written(b"xy")]);
    assert_eq!((election.message(), outcome.differences[0].is_some()), (&b"xy"[..], true));
    assert_eq!(vote(&mut election, [written(b"1"), written(b"2"), written(b"3")]).source_ns, None);
}

#[test]
fn one_message_that_differs_is_forgiven_and_four_in_a_row_are_not() {
    let mut standing = Standing::default();
    for _ in 0..100 {
        assert_eq!(standing.note(1, Conduct::Differs), None);
        (0..3).for_each(|_| assert_eq!(standing.note(1, Conduct::Agrees), None));
    }
    let verdicts: Vec<_> = (0..4).map(|_| standing.note(1, Conduct::Differs)).collect();
    assert_eq!(verdicts, [None, None, None, Some(Verdict::Differs)]);
    let mut every_other = (0..20)
        .map(|number| standing.note(2, if number % 2 == 0 { Conduct::Differs } else { Conduct::Agrees }));
    assert!(every_other.any(|verdict| verdict == Some(Verdict::Differs)));
}

#[test]
fn a_replica_that_falls_silent_is_outvoted_once_and_not_while_it_starts_again() {
    let mut standing = Standing::default();
    assert!((0..100).all(|_| standing.note(0, Conduct::Silent).is_none()), "it has not spoken yet");
    standing.note(0, Conduct::Agrees);
    let found: Vec<_> = (0..100).filter_map(|_| standing.note(0, Conduct::Silent)).collect();
    assert_eq!(found, [Verdict::Silent]);
}

#[test]
fn who_was_away_speaks_after_those_who_never_were() {
    let mut standing = Standing::default();
    (0..REPLICAS).for_each(|replica| assert_eq!(standing.note(replica, Conduct::Agrees), None));
    (0..3).for_each(|_| assert_eq!(standing.note(0, Conduct::Silent), None));
    let mut order = [0, 1, 2];
    order.sort_by_key(|replica| standing.rank(*replica));
    assert_eq!(order, [1, 2, 0]);
}

/// What is handed on of the messages of each window.
fn merged(windows: &[[&[&str]; REPLICAS]], first: usize) -> Vec<String> {
    let mut merger = Merger::default();
    let bytes = |list: &[&str]| list.iter().map(|text| text.as_bytes().to_vec()).collect::<Vec<_>>();
    let rank = |replica: usize| (replica != first, replica);
    let taken = windows.iter().flat_map(|sent| merger.take(sent.map(bytes), rank)).collect::<Vec<_>>();
    taken.into_iter().map(|bytes| String::from_utf8(bytes).unwrap()).collect()
}

#[test]
fn queues_hand_on_the_messages_that_two_sent() {
    assert_eq!(merged(&[[&["x", "b"], &["a", "b"], &["a", "b"]]], 0), ["a", "b"]);
    assert_eq!(
        merged(&[[&["at 1: 5"], &["at 2: 5"], &["at 3: 5"]]], 1),
        ["at 2: 5"],
        "each with its own time"
    );
    assert_eq!(merged(&[[&["at 1: 9 laps"], &["at 2: 5"], &["at 3: 5"]]], 0), ["at 2: 5"], "a lie");
    assert_eq!(merged(&[[&[], &["a"], &["a"]]], 0), ["a"], "one that is silent");
}

#[test]
fn one_queue_that_babbles_or_comes_a_window_later_is_in_step_again() {
    let silence: [&[&str]; REPLICAS] = [&[]; REPLICAS];
    let babble: [&[&str]; REPLICAS] = [&["x", "x", "x", "a"], &["a"], &["a"]];
    let after: [&[&str]; REPLICAS] = [&["b"], &["b"], &["b"]];
    assert_eq!(merged(&[babble, silence, after], 0), ["a", "b"]);
    let apart: [[&[&str]; REPLICAS]; 4] =
        [[&["a"], &[], &[]], [&["b"], &["a"], &["a"]], [&["c"], &["b"], &["b"]], [&[], &["c"], &["c"]]];
    assert_eq!(merged(&apart, 0), ["a", "b", "c"]);
}

#[test]
fn the_last_queue_that_is_left_is_handed_on_alone() {
    let alone: [&[&str]; REPLICAS] = [&["a"], &[], &[]];
    assert_eq!(merged(&[alone; 10], 0).len(), 9, "one is lost until it is known that nobody else is there");
}
