use super::*;
use bateleur_mavlink::common::{BATTERY_STATUS_DATA, HIL_ACTUATOR_CONTROLS_DATA, HilActuatorControlsFlags};
use bateleur_messages::{Range, RawAnalog, RawGps};

const CYCLE: u64 = 20_000_000;

/// A flight computer, and a simulator that says what a test wants.
struct World {
    mavlink: Mavlink,
    inbox: Inbox,
    simulator: Encoder,
    cycle: u64,
}

impl World {
    fn new() -> Self {
        Self {
            mavlink: Mavlink::new(1, 0, true),
            inbox: Inbox::new(true),
            simulator: Encoder::new(42, 200),
            cycle: 0,
        }
    }

    /// The next window: asks for `cycle` times 20 ms, hears these messages, and gives the time of the sensors taken.
    fn window(&mut self, messages: &[MavMessage]) -> Option<u64> {
        let mut bytes = Vec::new();
        messages.iter().for_each(|message| self.simulator.write(message, &mut bytes));
        self.window_of(&[&bytes])
    }

    fn window_of(&mut self, datagrams: &[&[u8]]) -> Option<u64> {
        self.cycle += 1;
        let asked_ns = self.cycle * CYCLE;
        self.inbox.begin(asked_ns);
        self.mavlink.ask(asked_ns, &ServoTimers::AT_REST, &mut Vec::new());
        datagrams.iter().for_each(|bytes| self.mavlink.take(Chunk::Datagram(bytes), &mut self.inbox));
        self.mavlink.finish(&mut self.inbox);
        self.inbox.finish().analog.map(|analog| analog.measured_ns)
    }

    fn counters(&self) -> crate::Counters {
        *self.inbox.counters()
    }
}

fn at(measured_ns: u64) -> MavMessage {
    hil::sensor(&RawAnalog { measured_ns, ..RawAnalog::default() })
}

fn bytes_of(encoder: &mut Encoder, messages: &[MavMessage]) -> Vec<u8> {
    let mut bytes = Vec::new();
    messages.iter().for_each(|message| encoder.write(message, &mut bytes));
    bytes
}

#[test]
fn question_names_time_actuators_and_lockstep_and_a_heartbeat_comes_once_a_second() {
    let mut mavlink = Mavlink::new(5, 0, true);
    let (mut questions, mut heartbeats) = (Vec::new(), 0);
    for cycle in 1..=100 {
        let mut out = Vec::new();
        mavlink.ask(cycle * CYCLE, &ServoTimers::AT_REST, &mut out);
        Decoder::new().datagram(&out, |received| {
            assert_eq!((received.system, received.component), (5, 1));
            match received.message.unwrap() {
                MavMessage::HIL_ACTUATOR_CONTROLS(message) => questions.push(message),
                MavMessage::HEARTBEAT(_) => heartbeats += 1,
                other => panic!("{other:?}"),
            }
        });
    }
    assert_eq!((questions.len(), heartbeats), (100, 2));
    let HIL_ACTUATOR_CONTROLS_DATA { time_usec, flags, controls, .. } = questions[99];
    assert_eq!((time_usec, controls), (2_000_000, [0.0; 16]));
    assert_eq!(flags, HilActuatorControlsFlags::HIL_ACTUATOR_CONTROLS_FLAGS_LOCKSTEP);
}

#[test]
fn the_answer_ends_the_wait_and_a_repeated_one_does_no_harm() {
    let mut world = World::new();
    assert_eq!(world.window(&[at(CYCLE)]), Some(CYCLE));
    assert!(world.inbox.is_answered());
    assert_eq!(world.window(&[at(2 * CYCLE), at(2 * CYCLE)]), Some(2 * CYCLE));
    assert_eq!(world.window(&[at(2 * CYCLE)]), None, "the last one again is no news");
    assert_eq!(
        world.window(&[at(4 * CYCLE), at(3 * CYCLE)]),
        Some(4 * CYCLE),
        "the newest wins in any order"
    );
    assert_eq!((world.counters().stale, world.counters().accepted, world.counters().missing), (2, 3, 1));
}

#[test]
fn simulator_with_steps_of_its_own_is_asked_until_it_has_come_as_far_as_it_shall() {
    let mut world = World::new();
    let own = |step: u64| at(7_000_000_000_000 + step * 4_000_000);
    assert_eq!(world.window(&[own(0)]), Some(CYCLE), "the first stamp ties its clock");
    let mut questions = 0;
    let asked_ns = 2 * CYCLE;
    world.inbox.begin(asked_ns);
    world.mavlink.ask(asked_ns, &ServoTimers::AT_REST, &mut Vec::new());
    let mut step = 0;
    while !world.inbox.is_answered() {
        step += 1;
        let bytes = bytes_of(&mut world.simulator, &[own(step)]);
        world.mavlink.take(Chunk::Datagram(&bytes), &mut world.inbox);
        questions += u64::from(world.mavlink.wants_another_question());
    }
    world.mavlink.finish(&mut world.inbox);
    let analog = world.inbox.finish().analog.unwrap();
    assert_eq!((step, questions), (5, 4));
    assert_eq!((analog.measured_ns, analog.interval_ns), (2 * CYCLE, CYCLE));
}

#[test]
fn one_stamp_from_the_future_or_the_past_is_counted_and_does_not_shut_out_the_right_ones() {
    let mut world = World::new();
    world.window(&[at(CYCLE)]);
    let far = MavMessage::HIL_SENSOR(HIL_SENSOR_DATA { time_usec: u64::MAX, ..HIL_SENSOR_DATA::DEFAULT });
    assert_eq!(world.window(&[far, at(0)]), None);
    assert_eq!(world.window(&[at(3 * CYCLE)]), Some(3 * CYCLE));
    assert_eq!((world.counters().invalid, world.counters().stale), (1, 1));
}

#[test]
fn another_system_on_the_link_is_not_listened_to_while_the_first_one_speaks() {
    let mut world = World::new();
    let mut other = Encoder::new(43, 200);
    for cycle in 1..=20 {
        let stranger = bytes_of(&mut other, &[at(cycle * CYCLE)]);
        let own = bytes_of(&mut world.simulator, &[at(cycle * CYCLE)]);
        let first = if cycle == 1 { [&own[..], &stranger] } else { [&stranger[..], &own] };
        assert_eq!(world.window_of(&first), Some(cycle * CYCLE));
        assert_eq!(world.mavlink.speaker, Some((42, 200)));
    }
    assert_eq!((world.counters().strangers, world.counters().lost), (20, 0));
    for cycle in 21..=24 {
        let stranger = bytes_of(&mut other, &[at(cycle * CYCLE)]);
        assert_eq!(world.window_of(&[&stranger]), None);
    }
    let stranger = bytes_of(&mut other, &[at(25 * CYCLE)]);
    assert_eq!(world.window_of(&[&stranger]), Some(25 * CYCLE), "the first one is silent");
}

#[test]
fn system_that_the_plan_names_is_the_only_one_that_is_heard() {
    let mut world = World::new();
    world.mavlink = Mavlink::new(1, 42, true);
    let mut other = Encoder::new(43, 200);
    for cycle in 1..=20 {
        let stranger = bytes_of(&mut other, &[at(cycle * CYCLE)]);
        assert_eq!(world.window_of(&[&stranger]), None);
    }
    assert_eq!(world.window(&[at(21 * CYCLE)]), Some(21 * CYCLE));
}

#[test]
fn stranger_who_spoke_first_now_and_then_does_not_keep_the_simulator_out() {
    let mut world = World::new();
    let stranger = bytes_of(&mut Encoder::new(99, 1), &[at(CYCLE)]);
    world.window_of(&[&stranger]);
    let heard = (2..=30).filter(|cycle| world.window(&[at(cycle * CYCLE)]).is_some()).count();
    assert_eq!(heard, 25);
}

#[test]
fn simulator_that_was_started_anew_is_believed_after_a_second_or_at_once_if_it_says_so() {
    let mut world = World::new();
    let own = |cycle: u64| at(900_000_000_000 + cycle * CYCLE);
    for cycle in 0..10 {
        assert!(world.window(&[own(cycle)]).is_some());
    }
    let heard = (0..60).filter(|cycle| world.window(&[at(7_000 + cycle * CYCLE)]).is_some()).count();
    assert!((9..=11).contains(&heard), "{heard}");
    let MavMessage::HIL_SENSOR(mut reset) = at(33_000) else { panic!() };
    reset.fields_updated |= HilSensorUpdatedFlags::HIL_SENSOR_UPDATED_RESET;
    assert_eq!(world.window(&[MavMessage::HIL_SENSOR(reset)]), Some(world.cycle * CYCLE));
}

#[test]
fn lost_messages_are_counted_by_their_numbers_and_repeated_ones_are_not() {
    let mut world = World::new();
    world.window(&[at(CYCLE)]);
    bytes_of(&mut world.simulator, &[at(1), at(2), at(3)]); // these are lost
    world.window(&[at(2 * CYCLE)]);
    let twice = bytes_of(&mut world.simulator, &[at(3 * CYCLE)]);
    world.window_of(&[&twice, &twice]);
    world.window(&[at(4 * CYCLE)]);
    assert_eq!(world.counters().lost, 3);
}

#[test]
fn a_fix_has_module_time_and_is_published_once() {
    let mut world = World::new();
    world.window(&[at(CYCLE)]);
    let fix = hil::fix(&RawGps { measured_ns: CYCLE, latitude_rad: 0.5, fix: 3, ..RawGps::default() });
    let mut bytes = Vec::new();
    for _ in 0..2 {
        world.simulator.write(&fix, &mut bytes);
    }
    world.cycle += 1;
    world.inbox.begin(2 * CYCLE);
    world.mavlink.ask(2 * CYCLE, &ServoTimers::AT_REST, &mut Vec::new());
    world.mavlink.take(Chunk::Datagram(&bytes), &mut world.inbox);
    world.mavlink.finish(&mut world.inbox);
    let gps = world.inbox.finish().gps.unwrap();
    assert_eq!((gps.measured_ns, gps.fix), (CYCLE, 3));
    assert!((gps.latitude_rad - 0.5).abs() < 1e-8);
}

#[test]
fn a_distance_to_the_ground_counts_for_the_window_in_which_it_comes() {
    let mut world = World::new();
    let told =
        |distance_m: f64| hil::distance(&Range { measured_ns: 7, distance_m, least_m: 0.1, most_m: 50.0 });
    let mut window = |number: u64, messages: &[MavMessage]| {
        let bytes = bytes_of(&mut world.simulator, messages);
        world.inbox.begin(number * CYCLE);
        world.mavlink.ask(number * CYCLE, &ServoTimers::AT_REST, &mut Vec::new());
        world.mavlink.take(Chunk::Datagram(&bytes), &mut world.inbox);
        world.mavlink.finish(&mut world.inbox);
        world.inbox.finish().range.map(|range| (range.measured_ns, (range.distance_m * 100.0).round()))
    };
    assert_eq!(window(1, &[at(CYCLE)]), None);
    assert_eq!(window(2, &[told(12.34), at(2 * CYCLE)]), Some((2 * CYCLE, 1234.0)));
    assert_eq!(window(3, &[at(3 * CYCLE)]), None, "none came");
    assert_eq!(window(4, &[told(60.0), at(4 * CYCLE)]), None, "no echo");
}

#[test]
fn what_a_flight_computer_has_no_use_for_is_counted_and_passed_over() {
    let mut world = World::new();
    let camera = MavMessage::HIL_SENSOR(HIL_SENSOR_DATA { id: 1, ..HIL_SENSOR_DATA::DEFAULT });
    let battery = MavMessage::BATTERY_STATUS(BATTERY_STATUS_DATA { id: 9, ..BATTERY_STATUS_DATA::DEFAULT });
    let all = [hil::heartbeat(false), camera, battery, at(CYCLE)];
    assert_eq!(world.window(&all), Some(CYCLE));
    assert_eq!((world.counters().unused, world.counters().refused), (2, 0));
}

#[test]
fn garbage_is_counted_and_harms_nobody() {
    let mut world = World::new();
    let good = bytes_of(&mut Encoder::new(42, 200), &[at(CYCLE)]);
    let mut damaged = good.clone();
    damaged[20] ^= 1;
    assert_eq!(world.window_of(&[b"hello", &damaged, &good[..30], &good]), Some(CYCLE));
    assert_eq!(world.counters().refused, 3);
}
