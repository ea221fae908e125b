//! SPX: what Part 2 adds to sampling ports.

use bateleur_processes::standard::*;
use bateleur_processes::{Progress, ReturnCode};

use crate::bench::*;

const SOURCE: PortDirection = PortDirection::Source;
const DESTINATION: PortDirection = PortDirection::Destination;

/// In NORMAL, at 0 ms: a source, and a destination with a refresh period of 145 ms.
fn sampled() -> (Bench, SamplingPortId, SamplingPortId) {
    let mut bench = Bench::new();
    bench.channels.add_sampling("out", SOURCE);
    bench.channels.add_sampling("in", DESTINATION);
    let mut create = |name, direction| {
        bench.partition.create_sampling_port(&bench.channels, name, 8, direction, ms(145)).unwrap()
    };
    let (out, into) = (create("out", SOURCE), create("in", DESTINATION));
    bench.started("a", 10);
    bench.normal();
    (bench, out, into)
}

impl Bench {
    /// Somebody else writes into the channel of the destination.
    fn is_written(&mut self, message: &[u8], at: i64) {
        self.channels.sampling[1].2 = Some((message.to_vec(), ms(at)));
    }

    fn read_updated(&mut self, port: SamplingPortId) -> (Code, Updated, Vec<u8>) {
        let (mut message, mut updated) = (b"old".to_vec(), Updated::NewMessage);
        let code = self.partition.read_updated_sampling_message(
            &mut self.channels,
            port,
            &mut message,
            &mut updated,
        );
        (code, updated, message)
    }

    fn read_after(&mut self, port: SamplingPortId, reference: SystemTime) -> (Code, SystemTime, Vec<u8>) {
        let (mut message, mut stamp) = (b"old".to_vec(), -7);
        let code = self.partition.read_sampling_message_conditional(
            &mut self.channels,
            port,
            reference,
            &mut message,
            &mut stamp,
        );
        (code, stamp, message)
    }

    fn current(&mut self, port: SamplingPortId) -> Result<SamplingPortCurrentStatus, ReturnCode> {
        self.partition.get_sampling_port_current_status(&mut self.channels, port)
    }

    fn read_plainly(&mut self, port: SamplingPortId) {
        self.partition.read_sampling_message(&mut self.channels, port, &mut Vec::new()).unwrap();
    }
}

#[test]
fn spx_upd_01_unknown_port() {
    let (mut bench, ..) = sampled();
    assert_eq!(bench.read_updated(SamplingPortId(9)).0, IP);
}

#[test]
fn spx_upd_02_source() {
    let (mut bench, out, _) = sampled();
    assert_eq!(bench.read_updated(out).0, IM);
}

#[test]
fn spx_upd_03_never_written() {
    let (mut bench, _, into) = sampled();
    assert_eq!(bench.read_updated(into), (NA, Updated::EmptyPort, Vec::new()));
}

#[test]
fn spx_upd_04_nothing_newer() {
    let (mut bench, _, into) = sampled();
    bench.is_written(b"x", 0);
    bench.read_updated(into).0.unwrap();
    bench.at(100);
    assert_eq!(bench.read_updated(into), (NA, Updated::ConsumedMessage, Vec::new()));
}

#[test]
fn spx_upd_05_new_message_is_given_once_and_another_of_the_same_time_is_new() {
    let (mut bench, _, into) = sampled();
    bench.at(10);
    for text in [b"x", b"y"] {
        bench.is_written(text, 10);
        assert_eq!(bench.read_updated(into), (NE, Updated::NewMessage, text.to_vec()));
        assert_eq!(bench.read_updated(into).1, Updated::ConsumedMessage);
    }
    // The same text, written later: its source has written it again. And an old one is given as well.
    bench.is_written(b"y", 11);
    bench.at(900);
    assert_eq!(bench.read_updated(into), (NE, Updated::NewMessage, b"y".to_vec()));
    assert_eq!(bench.get_sampling_port_status(into).unwrap().last_msg_validity, Validity::Invalid);
}

#[test]
fn spx_upd_06_plain_and_conditional_reads_consume_or_do_not() {
    let (mut bench, _, into) = sampled();
    bench.is_written(b"x", 0);
    bench.read_plainly(into);
    assert_eq!(bench.read_updated(into).1, Updated::ConsumedMessage, "here they do");
    bench.is_written(b"y", 1);
    bench.read_after(into, 0).0.unwrap();
    assert_eq!(bench.read_updated(into).1, Updated::ConsumedMessage);
}

#[test]
fn spx_cond_01_unknown_port() {
    let (mut bench, ..) = sampled();
    assert_eq!(bench.read_after(SamplingPortId(9), 0).0, IP);
}

#[test]
fn spx_cond_02_source() {
    let (mut bench, out, _) = sampled();
    assert_eq!(bench.read_after(out, 0).0, IM);
}

#[test]
fn spx_cond_03_empty() {
    let (mut bench, _, into) = sampled();
    assert_eq!(bench.read_after(into, -1), (NA, 0, Vec::new()));
}

#[test]
fn spx_cond_04_not_newer_than_asked_for_gives_its_time_and_consumes_nothing() {
    let (mut bench, _, into) = sampled();
    bench.is_written(b"x", 10);
    bench.at(20);
    for reference in [ms(10), ms(11), SystemTime::MAX] {
        assert_eq!(bench.read_after(into, reference), (NA, ms(10), Vec::new()));
    }
    assert_eq!(bench.current(into).unwrap().updated, Updated::NewMessage);
}

#[test]
fn spx_cond_05_newer() {
    let (mut bench, _, into) = sampled();
    bench.is_written(b"x", 10);
    bench.at(20);
    for reference in [0, ms(9), -1, SystemTime::MIN] {
        assert_eq!(bench.read_after(into, reference), (NE, ms(10), b"x".to_vec()));
    }
    assert_eq!(bench.get_sampling_port_status(into).unwrap().last_msg_validity, Validity::Valid);
}

#[test]
fn spx_cond_06_compared_to_the_nanosecond() {
    let (mut bench, _, into) = sampled();
    bench.is_written(b"x", 10);
    bench.at(20);
    assert_eq!(bench.read_after(into, ms(10) - 1).0, NE);
    assert_eq!(bench.read_after(into, ms(10)).0, NA);
}

#[test]
fn spx_stat_01_unknown_port() {
    let (mut bench, ..) = sampled();
    assert_eq!(code(bench.current(SamplingPortId(9))), IP);
}

#[test]
fn spx_stat_02_age_and_novelty_are_of_this_moment_and_nothing_is_consumed() {
    let (mut bench, _, into) = sampled();
    bench.is_written(b"x", 10);
    let expected = |message_age, updated| SamplingPortCurrentStatus {
        refresh_period: ms(145),
        time_stamp: ms(10),
        max_message_size: 8,
        port_direction: DESTINATION,
        message_age,
        updated,
    };
    bench.at(155);
    for _ in 0..2 {
        assert_eq!(bench.current(into), Ok(expected(MessageAge::Fresh, Updated::NewMessage)));
    }
    bench.read_plainly(into);
    assert_eq!(bench.current(into), Ok(expected(MessageAge::Fresh, Updated::ConsumedMessage)));
    bench.advance(ms(155) + 1);
    assert_eq!(bench.current(into), Ok(expected(MessageAge::Stale, Updated::ConsumedMessage)));
    let last = bench.get_sampling_port_status(into).unwrap().last_msg_validity;
    assert_eq!(last, Validity::Valid, "of the last read");
}

#[test]
fn spx_stat_03_empty_port_and_source() {
    let (mut bench, out, into) = sampled();
    for (port, direction) in [(into, DESTINATION), (out, SOURCE)] {
        let status = bench.current(port).unwrap();
        assert_eq!((status.message_age, status.updated), (MessageAge::Stale, Updated::EmptyPort));
        assert_eq!((status.time_stamp, status.port_direction), (0, direction));
    }
}

#[test]
fn messages_of_a_source_that_started_again_are_new() {
    let (mut bench, _, into) = sampled();
    bench.is_written(b"x", 10);
    bench.read_updated(into).0.unwrap();
    // Its numbers begin anew, and its time goes on.
    bench.is_written(b"x", 30);
    assert_eq!(bench.read_updated(into).1, Updated::NewMessage);
    assert!(matches!(bench.timed_wait(ms(1)), Ok(Progress::Waits)), "a reader is none that waits");
}
