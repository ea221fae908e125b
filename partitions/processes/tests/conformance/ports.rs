//! SAMP, QUE and PRT: ports, as far as they do not depend on how a channel lies in memory.

use bateleur_processes::standard::*;
use bateleur_processes::{Progress, ReturnCode};

use crate::bench::*;

const SOURCE: PortDirection = PortDirection::Source;
const DESTINATION: PortDirection = PortDirection::Destination;

/// In start mode, with a port of each kind.
fn configured() -> Bench {
    let mut bench = Bench::new();
    bench.channels.add_sampling("out", SOURCE);
    bench.channels.add_sampling("in", DESTINATION);
    bench.channels.add_queuing("send", SOURCE);
    bench.channels.add_queuing("receive", DESTINATION);
    bench
}

fn sampling(
    bench: &mut Bench,
    name: &str,
    size: i32,
    direction: u32,
    refresh: i64,
) -> Result<SamplingPortId, ReturnCode> {
    bench.partition.create_sampling_port(&bench.channels, name, size, direction, ms(refresh))
}

fn queuing(
    bench: &mut Bench,
    name: &str,
    size: i32,
    depth: i32,
    direction: u32,
    discipline: u32,
) -> Result<QueuingPortId, ReturnCode> {
    bench.partition.create_queuing_port(&bench.channels, name, size, depth, direction, discipline)
}

/// In NORMAL: both sampling ports; process `b` (20) runs, and behind it `a` (10).
fn sampled() -> (Bench, SamplingPortId, SamplingPortId) {
    let mut bench = configured();
    let out = sampling(&mut bench, "out", 8, SOURCE.into(), 1).unwrap();
    let into = sampling(&mut bench, "in", 8, DESTINATION.into(), 145).unwrap();
    bench.started("b", 20);
    bench.started("a", 10);
    bench.normal();
    (bench, out, into)
}

/// The same with both queuing ports.
fn queued() -> (Bench, QueuingPortId, QueuingPortId) {
    let mut bench = configured();
    bench.create_error_handler(STACK).unwrap();
    let out = queuing(&mut bench, "send", 8, 2, SOURCE.into(), FIFO).unwrap();
    let into = queuing(&mut bench, "receive", 8, 2, DESTINATION.into(), FIFO).unwrap();
    bench.started("b", 20);
    bench.started("a", 10);
    bench.normal();
    (bench, out, into)
}

impl Bench {
    fn write(&mut self, port: SamplingPortId, message: &[u8]) -> Code {
        self.partition.write_sampling_message(&mut self.channels, port, message)
    }

    fn read(&mut self, port: SamplingPortId) -> Result<(Validity, Vec<u8>), ReturnCode> {
        let mut message = b"old".to_vec();
        let validity = self.partition.read_sampling_message(&mut self.channels, port, &mut message);
        if validity.is_err() {
            assert!(message.is_empty());
        }
        Ok((validity?, message))
    }

    fn send(
        &mut self,
        port: QueuingPortId,
        message: &[u8],
        time_out: SystemTime,
    ) -> Result<Progress, ReturnCode> {
        self.partition.send_queuing_message(&mut self.channels, port, message, time_out)
    }

    fn receive(
        &mut self,
        port: QueuingPortId,
        time_out: SystemTime,
    ) -> (Result<Progress, ReturnCode>, Vec<u8>) {
        let mut message = b"old".to_vec();
        let result = self.partition.receive_queuing_message(&mut self.channels, port, time_out, &mut message);
        (result, message)
    }

    fn serve(&mut self) {
        self.partition.serve_ports(&mut self.channels);
    }

    /// A message comes from the other partition.
    fn arrives(&mut self, message: &[u8]) {
        self.channels.queuing[1].messages.push_back(message.to_vec());
    }
}

#[test]
fn samp_create_01_too_many_or_not_in_the_plan() {
    let mut bench = configured();
    assert_eq!(code(sampling(&mut bench, "else", 8, 0, 1)), IC);
    let mut bench = Bench::with(|settings| settings.limits.ports = 0);
    bench.channels.add_sampling("out", SOURCE);
    assert_eq!(code(sampling(&mut bench, "out", 8, 0, 1)), IC);
}

#[test]
fn samp_create_02_created_already() {
    let mut bench = configured();
    sampling(&mut bench, "out", 8, 0, 1).unwrap();
    assert_eq!(code(sampling(&mut bench, "out", 8, 0, 1)), NA);
}

#[test]
fn samp_create_03_message_size() {
    for size in [0, -1, 7, 9] {
        assert_eq!(code(sampling(&mut configured(), "out", size, 0, 1)), IC, "{size}");
    }
}

#[test]
fn samp_create_04_direction() {
    assert_eq!(code(sampling(&mut configured(), "out", 8, 1, 1)), IC);
    assert_eq!(code(sampling(&mut configured(), "out", 8, NONSENSE, 1)), IC);
}

#[test]
fn samp_create_05_refresh_period_not_above_0() {
    assert_eq!(code(sampling(&mut configured(), "in", 8, 1, 0)), IC);
    assert_eq!(code(sampling(&mut configured(), "out", 8, 0, -1)), IC);
}

#[test]
fn samp_create_06_refresh_period_of_the_plan() {
    one_of(code(sampling(&mut configured(), "in", 8, 1, 144)), &[IC, NE]);
    assert_eq!(code(sampling(&mut configured(), "out", 8, 0, 77)), NE, "means nothing for a source");
}

#[test]
fn samp_create_07_not_in_normal() {
    let mut bench = configured();
    bench.started("a", 10);
    bench.normal();
    assert_eq!(code(sampling(&mut bench, "out", 8, 0, 1)), IM);
}

#[test]
fn samp_create_08_created() {
    assert_eq!(code(sampling(&mut configured(), "in", 8, 1, 145)), NE);
}

#[test]
fn samp_write_01_unknown_port() {
    assert_eq!(configured().write(SamplingPortId(1), b"x"), IP);
}

#[test]
fn samp_write_02_message_too_long() {
    let (mut bench, out, _) = sampled();
    assert_eq!(bench.write(out, &[1; 9]), IC);
}

#[test]
fn samp_write_03_empty_message() {
    let (mut bench, out, _) = sampled();
    assert_eq!(bench.write(out, b""), IP);
}

#[test]
fn samp_write_04_no_source() {
    let (mut bench, _, into) = sampled();
    assert_eq!(bench.write(into, b"x"), IM);
}

#[test]
fn samp_write_05_message_takes_the_place_of_the_one_before_with_its_time() {
    let (mut bench, out, _) = sampled();
    let before = bench.who();
    bench.write(out, b"old").unwrap();
    bench.at(5);
    bench.write(out, b"new").unwrap();
    assert_eq!(bench.channels.sampling[0].2, Some((b"new".to_vec(), ms(5))));
    assert_eq!(bench.who(), before);
}

#[test]
fn samp_write_06_longest_message() {
    let (mut bench, out, _) = sampled();
    assert_eq!(bench.write(out, &[1; 8]), NE);
}

#[test]
fn samp_read_01_unknown_port() {
    assert_eq!(code(configured().read(SamplingPortId(1))), IP);
}

#[test]
fn samp_read_02_no_destination() {
    let (mut bench, out, _) = sampled();
    assert_eq!(code(bench.read(out)), IM);
}

#[test]
fn samp_read_03_never_written() {
    let (mut bench, _, into) = sampled();
    assert_eq!(code(bench.read(into)), NA);
}

#[test]
fn samp_read_04_young_message_is_valid() {
    let (mut bench, _, into) = sampled();
    bench.channels.sampling[1].2 = Some((b"x".to_vec(), 0));
    bench.at(145);
    assert_eq!(bench.read(into), Ok((Validity::Valid, b"x".to_vec())));
}

#[test]
fn samp_read_05_old_message_is_given_and_invalid() {
    let (mut bench, _, into) = sampled();
    bench.channels.sampling[1].2 = Some((b"x".to_vec(), 0));
    bench.advance(ms(145) + 1);
    assert_eq!(bench.read(into), Ok((Validity::Invalid, b"x".to_vec())));
}

#[test]
fn samp_read_06_message_stays() {
    let (mut bench, _, into) = sampled();
    bench.channels.sampling[1].2 = Some((b"x".to_vec(), 0));
    assert_eq!(bench.read(into), bench.read(into));
}

#[test]
fn samp_read_07_validity_of_the_read_is_in_the_status() {
    let (mut bench, _, into) = sampled();
    bench.channels.sampling[1].2 = Some((b"x".to_vec(), 0));
    bench.read(into).unwrap();
    assert_eq!(bench.get_sampling_port_status(into).unwrap().last_msg_validity, Validity::Valid);
}

#[test]
fn samp_id_01_unknown_name() {
    assert_eq!(code(configured().get_sampling_port_id("else")), IC);
}

#[test]
fn samp_id_02_known_name() {
    let (bench, out, _) = sampled();
    assert_eq!(bench.get_sampling_port_id("out"), Ok(out));
}

#[test]
fn samp_id_03_in_all_modes_and_the_caller_runs_on() {
    let mut bench = configured();
    let port = sampling(&mut bench, "out", 8, 0, 1).unwrap();
    assert_eq!(bench.get_sampling_port_id("out"), Ok(port));
}

#[test]
fn samp_id_04_in_the_plan_but_not_created() {
    assert_eq!(code(configured().get_sampling_port_id("out")), IC);
}

#[test]
fn samp_stat_01_unknown_port() {
    assert_eq!(code(configured().get_sampling_port_status(SamplingPortId(1))), IP);
}

#[test]
fn samp_stat_02_status_is_one_of_this_moment() {
    let (bench, _, into) = sampled();
    let expected = SamplingPortStatus {
        refresh_period: ms(145),
        max_message_size: 8,
        port_direction: DESTINATION,
        last_msg_validity: Validity::Invalid,
    };
    assert_eq!(bench.get_sampling_port_status(into), Ok(expected));
}

#[test]
fn samp_stat_04_validity_is_of_the_last_read_or_of_now() {
    let (mut bench, _, into) = sampled();
    bench.channels.sampling[1].2 = Some((b"x".to_vec(), 0));
    bench.read(into).unwrap();
    bench.at(500);
    let validity = bench.get_sampling_port_status(into).unwrap().last_msg_validity;
    assert!([Validity::Valid, Validity::Invalid].contains(&validity));
    bench.read(into).unwrap();
    assert_eq!(bench.get_sampling_port_status(into).unwrap().last_msg_validity, Validity::Invalid);
}

#[test]
fn que_create_01_too_many_or_not_in_the_plan() {
    assert_eq!(code(queuing(&mut configured(), "else", 8, 2, 0, FIFO)), IC);
    let mut bench = Bench::with(|settings| settings.limits.ports = 0);
    bench.channels.add_queuing("send", SOURCE);
    assert_eq!(code(queuing(&mut bench, "send", 8, 2, 0, FIFO)), IC);
}

#[test]
fn que_create_02_created_already() {
    let mut bench = configured();
    queuing(&mut bench, "send", 8, 2, 0, FIFO).unwrap();
    assert_eq!(code(queuing(&mut bench, "send", 8, 2, 0, FIFO)), NA);
}

#[test]
fn que_create_03_message_size() {
    assert_eq!(code(queuing(&mut configured(), "send", 7, 2, 0, FIFO)), IC);
}

#[test]
fn que_create_04_number_of_messages() {
    for depth in [0, -1, 3] {
        assert_eq!(code(queuing(&mut configured(), "send", 8, depth, 0, FIFO)), IC, "{depth}");
    }
}

#[test]
fn que_create_05_direction() {
    assert_eq!(code(queuing(&mut configured(), "send", 8, 2, 1, FIFO)), IC);
}

#[test]
fn que_create_06_discipline() {
    assert_eq!(code(queuing(&mut configured(), "send", 8, 2, 0, NONSENSE)), IC);
}

#[test]
fn que_create_07_not_in_normal() {
    let mut bench = configured();
    bench.started("a", 10);
    bench.normal();
    assert_eq!(code(queuing(&mut bench, "send", 8, 2, 0, FIFO)), IM);
}

#[test]
fn que_create_08_content_of_the_channel_stays() {
    let mut bench = configured();
    bench.arrives(b"x");
    let port = queuing(&mut bench, "receive", 8, 2, 1, FIFO).unwrap();
    assert_eq!(bench.receive(port, 0).1, b"x");
}

#[test]
fn que_send_01_unknown_port() {
    assert_eq!(code(configured().send(QueuingPortId(1), b"x", 0)), IP);
}

#[test]
fn que_send_02_time_out_out_of_range() {
    let (mut bench, out, _) = queued();
    bench.at(1);
    assert_eq!(code(bench.send(out, b"x", SystemTime::MAX)), IP);
}

#[test]
fn que_send_03_message_too_long() {
    let (mut bench, out, _) = queued();
    assert_eq!(code(bench.send(out, &[1; 9], 0)), IC);
    assert_eq!(code(bench.send(out, &[1; 8], 0)), NE);
}

#[test]
fn que_send_04_empty_message() {
    let (mut bench, out, _) = queued();
    assert_eq!(code(bench.send(out, b"", 0)), IP);
}

#[test]
fn que_send_05_no_source() {
    let (mut bench, _, into) = queued();
    assert_eq!(code(bench.send(into, b"x", 0)), IM);
}

#[test]
fn que_send_06_room() {
    let (mut bench, out, _) = queued();
    done(bench.send(out, b"x", FOREVER));
    assert_eq!(bench.channels.queuing[0].messages, [b"x"]);
}

#[test]
fn que_send_07_full_and_no_waiting() {
    let (mut bench, out, _) = queued();
    (0..2).for_each(|_| done(bench.send(out, b"x", 0)));
    assert_eq!(code(bench.send(out, b"y", 0)), NV);
}

#[test]
fn que_send_08_full_and_waiting_forbidden() {
    let (mut bench, out, _) = queued();
    (0..2).for_each(|_| done(bench.send(out, b"x", 0)));
    done(bench.lock_preemption());
    assert_eq!(code(bench.send(out, b"y", FOREVER)), IM);
    bench.raise("x");
    assert_eq!(code(bench.send(out, b"y", FOREVER)), IM);
}

#[test]
fn que_send_09_room_in_time() {
    let (mut bench, out, _) = queued();
    let sender = bench.who();
    (0..2).for_each(|_| done(bench.send(out, b"x", 0)));
    waits(bench.send(out, b"y", ms(10)));
    bench.channels.queuing[0].messages.pop_front();
    bench.serve();
    assert_eq!((bench.who(), bench.result()), (sender, NE));
    assert_eq!(bench.channels.queuing[0].messages, [b"x", b"y"]);
}

#[test]
fn que_send_10_no_room_in_time() {
    let (mut bench, out, _) = queued();
    (0..2).for_each(|_| done(bench.send(out, b"x", 0)));
    waits(bench.send(out, b"y", ms(10)));
    bench.at(10);
    assert_eq!(bench.result(), TM);
    bench.channels.clear_for_test();
    bench.serve();
    assert!(bench.channels.queuing[0].messages.is_empty());
}

impl Channels {
    fn clear_for_test(&mut self) {
        self.queuing.iter_mut().for_each(|queue| queue.messages.clear());
    }
}

#[test]
fn que_send_11_new_sender_does_not_overtake() {
    let (mut bench, out, _) = queued();
    (0..2).for_each(|_| done(bench.send(out, b"x", 0)));
    waits(bench.send(out, b"y", FOREVER));
    bench.channels.queuing[0].messages.pop_front();
    assert_eq!(code(bench.send(out, b"z", 0)), NV);
}

#[test]
fn que_recv_01_unknown_port() {
    assert_eq!(code(configured().receive(QueuingPortId(1), 0).0), IP);
}

#[test]
fn que_recv_02_time_out_out_of_range() {
    let (mut bench, _, into) = queued();
    bench.at(1);
    assert_eq!(code(bench.receive(into, SystemTime::MAX).0), IP);
}

#[test]
fn que_recv_03_no_destination() {
    let (mut bench, out, _) = queued();
    assert_eq!(code(bench.receive(out, 0).0), IM);
}

#[test]
fn que_recv_04_oldest_message() {
    let (mut bench, _, into) = queued();
    bench.arrives(b"one");
    bench.arrives(b"two");
    assert_eq!(bench.receive(into, FOREVER), (Ok(Progress::Done(())), b"one".to_vec()));
}

#[test]
fn que_recv_05_overflow_is_told_once_with_the_message() {
    let (mut bench, _, into) = queued();
    bench.arrives(b"one");
    bench.arrives(b"two");
    bench.channels.queuing[1].overflow = true;
    let (result, message) = bench.receive(into, 0);
    assert_eq!((code(result), message), (IC, b"one".to_vec()));
    assert_eq!(code(bench.receive(into, 0).0), NE);
}

#[test]
fn que_recv_06_empty_and_no_waiting() {
    let (mut bench, _, into) = queued();
    let (result, message) = bench.receive(into, 0);
    assert_eq!((code(result), message), (NV, Vec::new()));
}

#[test]
fn que_recv_07_empty_and_waiting_forbidden() {
    let (mut bench, _, into) = queued();
    done(bench.lock_preemption());
    assert_eq!(code(bench.receive(into, 1).0), IM);
    bench.raise("x");
    assert_eq!(code(bench.receive(into, 1).0), IM);
}

#[test]
fn que_recv_08_message_in_time() {
    let (mut bench, _, into) = queued();
    let receiver = bench.who();
    waits(bench.receive(into, ms(10)).0);
    bench.arrives(b"x");
    bench.serve();
    assert_eq!((bench.who(), bench.result()), (receiver, NE));
    assert_eq!((bench.message(), bench.next_timer()), (&b"x"[..], None));
}

#[test]
fn que_recv_09_no_message_in_time() {
    let (mut bench, _, into) = queued();
    waits(bench.receive(into, ms(10)).0);
    bench.at(10);
    assert_eq!(bench.result(), TM);
    bench.arrives(b"x");
    bench.serve();
    assert_eq!(bench.channels.queuing[1].messages.len(), 1, "nobody waits for it any more");
}

#[test]
fn que_id_01_unknown_name() {
    assert_eq!(code(configured().get_queuing_port_id("send")), IC);
}

#[test]
fn que_id_02_known_name() {
    let (bench, out, _) = queued();
    assert_eq!(bench.get_queuing_port_id("send"), Ok(out));
}

#[test]
fn que_id_03_in_all_modes_and_the_caller_runs_on() {
    let (bench, out, _) = queued();
    let before = bench.who();
    assert_eq!(bench.get_queuing_port_id("send"), Ok(out));
    assert_eq!(bench.who(), before);
}

#[test]
fn que_stat_01_unknown_port() {
    let bench = configured();
    assert_eq!(code(bench.get_queuing_port_status(&bench.channels, QueuingPortId(1))), IP);
}

#[test]
fn que_stat_02_status_is_one_of_this_moment() {
    let (bench, _, into) = queued();
    let expected = QueuingPortStatus {
        nb_message: 0,
        max_nb_message: 2,
        max_message_size: 8,
        port_direction: DESTINATION,
        waiting_processes: 0,
    };
    assert_eq!(bench.get_queuing_port_status(&bench.channels, into), Ok(expected));
}

#[test]
fn que_stat_03_suspended_processes_count_among_those_that_wait() {
    let (mut bench, _, into) = queued();
    let b = bench.get_my_id().unwrap();
    waits(bench.receive(into, FOREVER).0);
    bench.suspend(b).unwrap();
    assert_eq!(bench.get_queuing_port_status(&bench.channels, into).unwrap().waiting_processes, 1);
}

#[test]
fn que_stat_04_messages_of_the_own_side() {
    let (mut bench, out, into) = queued();
    bench.arrives(b"x");
    assert_eq!(bench.get_queuing_port_status(&bench.channels, into).unwrap().nb_message, 1);
    assert_eq!(bench.get_queuing_port_status(&bench.channels, out).unwrap().nb_message, 0);
}

#[test]
fn que_clear_01_unknown_port() {
    let mut bench = configured();
    assert_eq!(bench.partition.clear_queuing_port(&mut bench.channels, QueuingPortId(1)), IP);
}

#[test]
fn que_clear_02_no_destination() {
    let (mut bench, out, _) = queued();
    assert_eq!(bench.partition.clear_queuing_port(&mut bench.channels, out), IM);
}

#[test]
fn que_clear_03_empty_port() {
    let (mut bench, _, into) = queued();
    one_of(bench.partition.clear_queuing_port(&mut bench.channels, into), &[NE, NA]);
}

#[test]
fn que_clear_04_all_messages_are_dropped() {
    let (mut bench, _, into) = queued();
    bench.arrives(b"x");
    bench.arrives(b"y");
    assert_eq!(bench.partition.clear_queuing_port(&mut bench.channels, into), NE);
    assert_eq!(code(bench.receive(into, 0).0), NV);
}

#[test]
fn prt_01_age_is_the_time_since_the_write() {
    let (mut bench, out, _) = sampled();
    bench.at(30);
    bench.write(out, b"x").unwrap();
    assert_eq!(bench.channels.sampling[0].2.as_ref().unwrap().1, ms(30));
}

#[test]
fn prt_02_valid_up_to_the_refresh_period_itself() {
    let (mut bench, _, into) = sampled();
    bench.channels.sampling[1].2 = Some((b"x".to_vec(), ms(10)));
    bench.at(155);
    assert_eq!(bench.read(into).unwrap().0, Validity::Valid);
    bench.advance(ms(155) + 1);
    assert_eq!(bench.read(into).unwrap().0, Validity::Invalid);
}

#[test]
fn prt_05_length_is_that_of_the_last_write() {
    let (mut bench, _, into) = sampled();
    bench.channels.sampling[1].2 = Some((b"long one".to_vec(), 0));
    assert_eq!(bench.read(into).unwrap().1.len(), 8);
    bench.channels.sampling[1].2 = Some((b"new".to_vec(), 0));
    assert_eq!(bench.read(into).unwrap().1, b"new");
}

#[test]
fn prt_14_waiting_sender_goes_on_when_another_partition_has_received() {
    let (mut bench, out, _) = queued();
    let sender = bench.who();
    (0..2).for_each(|_| done(bench.send(out, b"x", 0)));
    waits(bench.send(out, b"y", FOREVER));
    bench.serve();
    assert_ne!(bench.who(), sender);
    bench.channels.queuing[0].messages.clear();
    bench.serve();
    assert_eq!(bench.who(), sender);
}
