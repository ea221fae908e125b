//! What a transport has to do, as one suite that runs on every one of them.
//!
//! Responsible for: the promises of [`RelayTransport`], each with a check. A transport may lose datagrams, but this suite
//! runs where it has no reason to. It never looks at a clock but to be patient.
#![allow(clippy::panic)] // it is a test

use std::time::{Duration, Instant};

use super::RelayTransport;
use crate::Rejection;

/// How long a datagram may take where time is real.
const PATIENCE: Duration = Duration::from_secs(10);
/// From one round to the next, module time, ns.
const ROUND_NS: u64 = 1_000_000;

/// Two transports that are each other's other end: two endpoints each, for datagrams of 2000 bytes.
pub struct Bed<T> {
    here: T,
    there: T,
    now_ns: u64,
    /// Module time from sending to arrival; `None` if time is real.
    delay_ns: Option<u64>,
}

/// One thing that came: endpoint, instant, datagram.
type Found = (usize, u64, Result<Vec<u8>, Rejection>);

impl<T: RelayTransport> Bed<T> {
    /// Datagrams take some time of the real clock.
    pub fn real(here: T, there: T) -> Self {
        Self { here, there, now_ns: ROUND_NS, delay_ns: None }
    }

    /// Datagrams take `delay_ns` of module time and none of the real clock.
    pub fn stepped(here: T, there: T, delay_ns: u64) -> Self {
        Self { here, there, now_ns: ROUND_NS, delay_ns: Some(delay_ns) }
    }

    /// Takes what has come from here to there, until there are `count`.
    fn await_there(&mut self, count: usize, most: usize) -> Vec<Found> {
        let (begun, mut found) = (Instant::now(), Vec::new());
        self.now_ns += self.delay_ns.unwrap_or(ROUND_NS);
        while found.len() < count && begun.elapsed() < PATIENCE {
            receive(&mut self.there, self.now_ns, most, &mut found);
            if self.delay_ns.is_some() {
                break;
            }
        }
        found
    }

    fn flush_here(&mut self) -> Vec<usize> {
        let mut failed = Vec::new();
        self.here.flush(self.now_ns, &mut |endpoint| failed.push(endpoint));
        failed
    }
}

fn receive<T: RelayTransport>(transport: &mut T, now_ns: u64, most: usize, found: &mut Vec<Found>) {
    transport.receive(&|| now_ns, most, &mut |came| {
        found.push((came.endpoint, came.at_ns, came.datagram.map(<[u8]>::to_vec)));
    });
}

/// Panics where `bed` breaks a promise of [`RelayTransport`].
///
/// # Panics
/// See above: it is a test.
pub fn conforms<T: RelayTransport>(bed: &mut Bed<T>) {
    nothing_comes_of_nothing(bed);
    datagrams_come_whole_at_their_endpoint_and_no_other(bed);
    datagrams_of_all_lengths_come_as_they_were(bed);
    both_directions_work_at_once(bed);
    many_datagrams_of_one_window_come_in_order(bed);
    no_more_is_handed_over_than_asked_for(bed);
    arrivals_lie_between_sending_and_receiving(bed);
    nothing_goes_before_it_is_flushed(bed);
    a_longer_datagram_than_agreed_is_refused_whole(bed);
}

fn nothing_comes_of_nothing<T: RelayTransport>(bed: &mut Bed<T>) {
    let mut found = Vec::new();
    receive(&mut bed.there, bed.now_ns, 8, &mut found);
    assert!(found.is_empty(), "{found:?}");
    assert!(bed.flush_here().is_empty());
}

fn datagrams_come_whole_at_their_endpoint_and_no_other<T: RelayTransport>(bed: &mut Bed<T>) {
    bed.here.send(1, [b"second ", b"network"]);
    bed.here.send(0, [b"first", b""]);
    assert!(bed.flush_here().is_empty());
    let mut found = bed.await_there(2, 8);
    found.sort_by_key(|came| came.0);
    let found: Vec<_> = found.into_iter().map(|(endpoint, _, datagram)| (endpoint, datagram)).collect();
    assert_eq!(found, [(0, Ok(b"first".to_vec())), (1, Ok(b"second network".to_vec()))]);
}

fn datagrams_of_all_lengths_come_as_they_were<T: RelayTransport>(bed: &mut Bed<T>) {
    for length in [1, 63, 64, 1471, 1472, 1473, 1999, 2000] {
        let sent: Vec<u8> = (0..length).map(|n| (n * 7) as u8).collect();
        let (head, tail) = sent.split_at(length / 2);
        bed.here.send(0, [head, tail]);
        assert!(bed.flush_here().is_empty());
        let found = bed.await_there(1, 8);
        assert_eq!(found.into_iter().map(|came| came.2).collect::<Vec<_>>(), [Ok(sent)]);
    }
}

fn both_directions_work_at_once<T: RelayTransport>(bed: &mut Bed<T>) {
    bed.here.send(0, [b"there", b""]);
    bed.there.send(0, [b"here", b""]);
    assert!(bed.flush_here().is_empty());
    bed.there.flush(bed.now_ns, &mut |_| panic!("it could not be sent"));
    assert_eq!(bed.await_there(1, 8)[0].2, Ok(b"there".to_vec()));
    let (begun, mut found) = (Instant::now(), Vec::new());
    while found.is_empty() && begun.elapsed() < PATIENCE {
        receive(&mut bed.here, bed.now_ns, 8, &mut found);
    }
    assert_eq!(found[0].2, Ok(b"here".to_vec()));
}

fn many_datagrams_of_one_window_come_in_order<T: RelayTransport>(bed: &mut Bed<T>) {
    let all: Vec<Vec<u8>> = (0..50_u8).map(|number| vec![number; 30]).collect();
    all.iter().for_each(|datagram| bed.here.send(0, [datagram, b""]));
    assert!(bed.flush_here().is_empty());
    let found: Vec<_> = bed.await_there(50, 100).into_iter().filter_map(|came| came.2.ok()).collect();
    assert_eq!(found, all);
}

fn no_more_is_handed_over_than_asked_for<T: RelayTransport>(bed: &mut Bed<T>) {
    (0..5_u8).for_each(|number| bed.here.send(0, [&[number], b""]));
    assert!(bed.flush_here().is_empty());
    let mut all = Vec::new();
    let begun = Instant::now();
    bed.now_ns += bed.delay_ns.unwrap_or(ROUND_NS);
    while all.len() < 5 && begun.elapsed() < PATIENCE {
        let before = all.len();
        receive(&mut bed.there, bed.now_ns, 2, &mut all);
        assert!(all.len() - before <= 2);
    }
    assert_eq!(all.into_iter().filter_map(|came| came.2.ok()).flatten().collect::<Vec<_>>(), [0, 1, 2, 3, 4]);
}

fn arrivals_lie_between_sending_and_receiving<T: RelayTransport>(bed: &mut Bed<T>) {
    let sent_ns = bed.now_ns;
    bed.here.send(0, [b"when?", b""]);
    assert!(bed.flush_here().is_empty());
    let found = bed.await_there(1, 8);
    let at_ns = found[0].1;
    assert!(at_ns <= bed.now_ns, "{at_ns} lies after {}", bed.now_ns);
    if let Some(delay_ns) = bed.delay_ns {
        assert_eq!(at_ns, sent_ns + delay_ns);
    }
}

fn nothing_goes_before_it_is_flushed<T: RelayTransport>(bed: &mut Bed<T>) {
    bed.here.send(0, [b"later", b""]);
    let mut found = Vec::new();
    bed.now_ns += bed.delay_ns.unwrap_or(ROUND_NS);
    receive(&mut bed.there, bed.now_ns, 8, &mut found);
    assert!(found.is_empty(), "{found:?}");
    assert!(bed.flush_here().is_empty());
    assert_eq!(bed.await_there(1, 8)[0].2, Ok(b"later".to_vec()));
}

fn a_longer_datagram_than_agreed_is_refused_whole<T: RelayTransport>(bed: &mut Bed<T>) {
    bed.here.send(0, [&[1; 2000], &[2; 50]]);
    bed.here.send(0, [b"after", b""]);
    assert!(bed.flush_here().is_empty());
    let found: Vec<_> = bed.await_there(2, 8).into_iter().map(|came| came.2).collect();
    assert_eq!(found, [Err(Rejection::Giant), Ok(b"after".to_vec())]);
}
