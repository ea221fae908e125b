//! What happens on the bus in one window.

use std::collections::BTreeMap;

use bateleur_can_core::{Frame, Id};
use bateleur_can_map::{Assembly, Layout, Outcome, Sync, Table};
use bateleur_messages::{Custom, Range, RawAnalog, RawGps, ServoTimers};
use zerocopy::{FromBytes, IntoBytes};

use crate::wires::{Waiting, Wires};

/// Times that sensors are asked for at most. On the wall clock there is time for two; where time stands still until they come,
/// the first wait is long.
const TRIES: usize = 3;
/// Looks at what has come in one window at most, where time stands still.
const LOOKS: usize = 256;
/// Looks before the actuators are sent: a flood of frames must not keep them waiting.
const LOOKS_BEFORE: usize = 4;

/// What is sent in a window.
#[derive(Debug, Clone, PartialEq)]
pub struct Actuators {
    /// The servos' pulses.
    pub timers: ServoTimers,
    /// Messages of further ports, in the order of [`Conversation::new`]; `None`: nothing was written yet.
    pub others: Vec<Option<Vec<u8>>>,
}

/// The ports that this function has of itself, where the plan and the table have them.
pub const OWN_PORTS: [&str; 5] = ["raw_analog", "raw_gps", "custom", "range", "timers"];

/// What is wrong where the plan has a port and the table does not.
pub fn nothing_for(port: &str) -> String {
    format!(
        "the plan declares port {port}, and the table of CAN frames (attribute table) has nothing for it: take the port out of the plan, or add [port.{port}] to the table"
    )
}

/// One window's sensors, as far as they came.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Sensors {
    /// Inertial, magnetic and pressure sensors.
    pub analog: Option<RawAnalog>,
    /// A satellite fix.
    pub gps: Option<RawGps>,
    /// Sticks and voltages.
    pub custom: Option<Custom>,
    /// A distance to the ground.
    pub range: Option<Range>,
    /// Messages of further ports, each with its place in the order of [`Conversation::new`].
    pub others: Vec<(usize, Vec<u8>)>,
}

impl Sensors {
    fn stamps(&mut self) -> impl Iterator<Item = &mut u64> {
        let analog = self.analog.as_mut().map(|analog| &mut analog.measured_ns);
        let gps = self.gps.as_mut().map(|gps| &mut gps.measured_ns);
        let custom = self.custom.as_mut().map(|custom| &mut custom.measured_ns);
        let range = self.range.as_mut().map(|range| &mut range.measured_ns);
        [analog, gps, custom, range].into_iter().flatten()
    }
}

/// When the conversation takes place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Moment {
    /// Module time for which sensors are asked, ns.
    pub module_ns: u64,
    /// Module time after which they are no longer waited for, ns.
    pub deadline_ns: u64,
}

/// What became of what came.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    /// Windows with new inertial sensors.
    pub accepted: u64,
    /// Windows without.
    pub missing: u64,
    /// Questions that were asked again.
    pub repeated: u64,
    /// Sets of which frames had not come: their values are not numbers.
    pub incomplete: u64,
    /// Sets that were withheld, because whole numbers had not come.
    pub withheld: u64,
    /// Frames that belong to nothing in the table.
    pub foreign: u64,
    /// Answers for another time than the one asked for: used where they are news.
    pub stale: u64,
}

/// See the module's text.
#[derive(Debug)]
pub struct Conversation {
    table: Table,
    sync: Option<Sync>,
    assemblies: Vec<(Port, Assembly)>,
    /// Of further ports that are sent.
    sent: Vec<Layout>,
    counts: Counts,
    /// Sets that have come, and of which it is not yet said for which time.
    pending: Sensors,
    /// The newest time for which sensors were taken, ns.
    taken_ns: Option<u64>,
    is_answered: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Port {
    Analog,
    Gps,
    Custom,
    Range,
    /// One of the further ports.
    Other(usize),
}

impl Port {
    const ALL: [(&'static str, Self); 4] = [
        ("raw_analog", Self::Analog),
        ("raw_gps", Self::Gps),
        ("custom", Self::Custom),
        ("range", Self::Range),
    ];
}

impl Conversation {
    /// A conversation in the words of a table. Ports beyond this function's own: those whose messages come from frames, and those whose
    /// messages are sent as frames.
    ///
    /// # Errors
    /// A port in the table that there is not, or one that the table does not have.
    pub fn new(table: Table, received: &[String], sent: &[String]) -> Result<Self, String> {
        let is_known =
            |port: &str| OWN_PORTS.contains(&port) || [received, sent].concat().iter().any(|own| own == port);
        if let Some(port) = table.ports().find(|port| !is_known(port)) {
            return Err(format!(
                "attribute table: there is no port \"{port}\": give the partition a sampling port of that name in the plan, or use {}",
                OWN_PORTS.join(", ")
            ));
        }
        let layout = |name: &String| table.layout(name).cloned().ok_or_else(|| nothing_for(name));
        let own = Port::ALL.into_iter().filter_map(|(name, port)| Some((port, table.layout(name)?.clone())));
        let mut layouts: Vec<(Port, Layout)> = own.collect();
        for (place, name) in received.iter().enumerate() {
            layouts.push((Port::Other(place), layout(name)?));
        }
        let assemblies = layouts.into_iter().map(|(port, layout)| (port, Assembly::new(layout))).collect();
        let sent: Vec<Layout> = sent.iter().map(layout).collect::<Result<_, _>>()?;
        let mut senders = BTreeMap::new();
        for layout in table.layout("timers").into_iter().chain(&sent) {
            for id in layout.ids() {
                if let Some(other) = senders.insert(id, layout.port()) {
                    return Err(format!(
                        "attribute table: frame {id} is sent for port {other} and for port {}, each with zeros in the other's bits: give each frames of its own",
                        layout.port()
                    ));
                }
            }
        }
        let sync = table.sync();
        Ok(Self {
            table,
            sync,
            assemblies,
            sent,
            counts: Counts::default(),
            pending: Sensors::default(),
            taken_ns: None,
            is_answered: false,
        })
    }

    /// Whether the table has a layout for a port.
    pub fn has(&self, port: &str) -> bool {
        self.table.layout(port).is_some()
    }

    /// Whether the table has anything that comes.
    pub fn hears(&self) -> bool {
        !self.assemblies.is_empty()
    }

    /// The message type that the table gives a port.
    pub fn message(&self, port: &str) -> Option<&str> {
        self.table.layout(port).map(Layout::message)
    }

    /// What became of what came.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Sends the actuators, asks for sensors where the table says how, and gives what came until the cut-off. Without a question,
    /// what came since the last window is taken as it is.
    pub fn exchange(
        &mut self,
        actuators: &Actuators,
        moment: &Moment,
        wires: &mut Wires,
        time: &impl Waiting,
    ) -> Sensors {
        let mut sensors = Sensors::default();
        self.is_answered = false;
        let asks = self.sync.is_some_and(|sync| sync.answer.is_some());
        let looks = if asks { LOOKS_BEFORE } else { LOOKS };
        for _ in 0..looks {
            if !self.hear(moment, wires, &mut sensors) || time.now_ns() >= moment.deadline_ns {
                break;
            }
        }
        if asks {
            // What is left of an answer to an earlier question is no part of the next one.
            self.assemblies.iter_mut().for_each(|(_, assembly)| assembly.forget());
        }
        self.say(actuators, moment, wires);
        wires.take_restarted_peer();
        if asks {
            self.await_answer(actuators, moment, wires, time, &mut sensors);
        }
        match self.came(&sensors) {
            Some(true) => self.counts.accepted += 1,
            Some(false) => self.counts.missing += 1,
            None => {}
        }
        sensors
    }

    /// Whether a window's sensors came: the inertial ones, or any where the table has none of those. `None`: it has no sensors.
    pub fn came(&self, sensors: &Sensors) -> Option<bool> {
        if self.has("raw_analog") {
            return Some(sensors.analog.is_some());
        }
        let Sensors { gps, custom, range, others, .. } = sensors;
        let any = gps.is_some() || custom.is_some() || range.is_some() || !others.is_empty();
        (!self.assemblies.is_empty()).then_some(any)
    }

    /// Nothing is asked and nothing believed: what comes meanwhile is thrown away, so that it is not taken for news later.
    pub fn pass_over(&mut self, module_ns: u64, wires: &mut Wires) {
        for _ in 0..LOOKS_BEFORE {
            if !wires.receive(module_ns, |_, _| ()) {
                break;
            }
        }
        self.pending = Sensors::default();
        self.assemblies.iter_mut().for_each(|(_, assembly)| assembly.forget());
    }

    /// Identifiers of the frames that it sends: of each the newest alone is worth anything.
    pub fn said(&self) -> impl Iterator<Item = Id> {
        let layouts = self.table.layout("timers").into_iter().chain(&self.sent);
        layouts.flat_map(Layout::ids).chain(self.sync.map(|sync| sync.frame))
    }

    fn say(&self, actuators: &Actuators, moment: &Moment, wires: &mut Wires) {
        let now_ns = moment.module_ns;
        let own = self.table.layout("timers").map(|layout| (layout, actuators.timers.as_bytes()));
        let others = self.sent.iter().zip(&actuators.others);
        let others = others.filter_map(|(layout, message)| Some((layout, message.as_deref()?)));
        for (layout, message) in own.into_iter().chain(others) {
            layout.frames(message, now_ns).iter().for_each(|frame| wires.send(frame, now_ns));
        }
        if let Some(sync) = self.sync {
            wires.send(&Frame::classic(sync.frame, &now_ns.to_le_bytes()), now_ns);
        }
        wires.flush(now_ns);
    }

    fn await_answer(
        &mut self,
        actuators: &Actuators,
        moment: &Moment,
        wires: &mut Wires,
        time: &impl Waiting,
        sensors: &mut Sensors,
    ) {
        let begun_ns = time.now_ns();
        // On the wall clock a question is asked again after a third of the time.
        let third_ns = begun_ns + moment.deadline_ns.saturating_sub(begun_ns) / 3;
        let mut tries = TRIES - 1;
        let mut until_ns = third_ns;
        for _ in 0..LOOKS {
            if self.is_answered || time.now_ns() >= moment.deadline_ns {
                return;
            }
            if wires.wait(time, until_ns) {
                self.hear(moment, wires, sensors);
                // A gateway that was started anew has not taken the question: it asks first who we are.
                if self.is_answered || !wires.take_restarted_peer() {
                    continue;
                }
            }
            if tries == 0 || time.now_ns() >= moment.deadline_ns {
                return;
            }
            tries -= 1;
            self.counts.repeated += 1;
            self.say(actuators, moment, wires);
            until_ns = moment.deadline_ns;
        }
    }

    /// What has come is of time `measured_ns`: an answer that comes a second time, or late after a newer one, is passed over.
    fn note_answer(&mut self, measured_ns: u64, moment: &Moment, sensors: &mut Sensors) {
        let mut set = std::mem::take(&mut self.pending);
        self.assemblies.iter_mut().for_each(|(_, assembly)| assembly.forget());
        self.is_answered |= measured_ns == moment.module_ns;
        self.counts.stale += u64::from(measured_ns != moment.module_ns);
        let is_news = self.taken_ns.is_none_or(|taken_ns| measured_ns > taken_ns);
        if !is_news || measured_ns > moment.module_ns {
            return;
        }
        self.taken_ns = Some(measured_ns);
        // They were stamped as if they were of now.
        let late_ns = moment.module_ns - measured_ns;
        for stamp in set.stamps() {
            *stamp = stamp.saturating_sub(late_ns);
        }
        sensors.analog = set.analog.or(sensors.analog);
        sensors.gps = set.gps.or(sensors.gps);
        sensors.custom = set.custom.or(sensors.custom);
        sensors.range = set.range.or(sensors.range);
        for (place, mut message) in set.others {
            let assembly = self.assemblies.iter().find(|(port, _)| *port == Port::Other(place));
            if let Some((_, assembly)) = assembly {
                assembly.layout().make_older(&mut message, late_ns);
            }
            sensors.others.push((place, message));
        }
    }

    /// Takes what has come; whether there may be more.
    fn hear(&mut self, moment: &Moment, wires: &mut Wires, sensors: &mut Sensors) -> bool {
        let mut heard = Vec::new();
        let is_more = wires.receive(moment.module_ns, |frame, age_ns| heard.push((*frame, age_ns)));
        heard.iter().for_each(|(frame, age_ns)| self.take(frame, *age_ns, moment, sensors));
        is_more
    }

    fn take(&mut self, frame: &Frame, age_ns: u64, moment: &Moment, sensors: &mut Sensors) {
        let answer = self.sync.and_then(|sync| sync.answer);
        if answer == Some(frame.id()) {
            if let Ok(bytes) = frame.data().try_into() {
                self.note_answer(u64::from_le_bytes(bytes), moment, sensors);
            }
            return;
        }
        let id: Id = frame.id();
        // An answer says for which time its frames are; without one it is when they came, less what they spent on the way.
        let age_ns = if answer.is_some() { 0 } else { age_ns };
        // Where an answer says for which time they are, they wait for it.
        let set = if answer.is_some() { &mut self.pending } else { sensors };
        let mut is_foreign = true;
        // One frame may carry values of several ports.
        for (port, assembly) in self.assemblies.iter_mut().filter(|(_, assembly)| assembly.wants(id)) {
            is_foreign = false;
            match assembly.take(frame, moment.module_ns.saturating_sub(age_ns)) {
                Outcome::Whole(bytes, missing) => {
                    self.counts.incomplete += u64::from(missing > 0);
                    let is_there = match port {
                        Port::Analog => set.analog.is_some(),
                        Port::Gps => set.gps.is_some(),
                        Port::Custom => set.custom.is_some(),
                        Port::Range => set.range.is_some(),
                        Port::Other(place) => set.others.iter().any(|(other, _)| other == place),
                    };
                    if missing > 0 && is_there {
                        continue;
                    }
                    match port {
                        Port::Analog => set.analog = RawAnalog::read_from_bytes(&bytes).ok(),
                        Port::Gps => set.gps = RawGps::read_from_bytes(&bytes).ok(),
                        Port::Custom => set.custom = Custom::read_from_bytes(&bytes).ok(),
                        Port::Range => set.range = Range::read_from_bytes(&bytes).ok(),
                        Port::Other(place) => {
                            set.others.retain(|(other, _)| other != place);
                            set.others.push((*place, bytes));
                        }
                    }
                }
                Outcome::Withheld => self.counts.withheld += 1,
                Outcome::Part | Outcome::Foreign => {}
            }
        }
        self.counts.foreign += u64::from(is_foreign && frame.is_of_the_bus());
    }
}

#[cfg(test)]
mod tests {
    use std::cell::{Cell, RefCell};
    use std::os::fd::AsFd;

    use bateleur_can_core::bus::BusName;
    use bateleur_can_core::{Gateway, Settings};
    use bateleur_can_map::{DISTRIBUTION_BOARD, from_attributes};

    use super::*;

    const CYCLE: u64 = 20_000_000;

    fn at_rest() -> Actuators {
        Actuators { timers: ServoTimers::AT_REST, others: Vec::new() }
    }

    /// A board with nodes, on the other side of a gateway, which answers in the wait; it leaves the first `ignores` questions
    /// unanswered and loses the frame with the identifier `loses`.
    struct Board {
        table: Table,
        gateway: RefCell<Gateway>,
        socket: std::net::UdpSocket,
        asked: RefCell<Vec<Frame>>,
        ignores: Cell<u32>,
        loses: Cell<u32>,
        now_ns: Cell<u64>,
    }

    impl Board {
        fn new() -> (Self, Wires, Conversation) {
            let socket = std::net::UdpSocket::bind("127.0.0.1:0").unwrap();
            socket.set_nonblocking(true).unwrap();
            let mut gateway = Gateway::new(Settings::new(1, 1, vec![]));
            gateway.address_is_ready(0);
            let settings = crate::Settings {
                bus: BusName::None,
                listen: Some("127.0.0.1:0".parse().unwrap()),
                gateway: Settings::new(2, 2, vec![socket.local_addr().unwrap()]),
            };
            let table = from_attributes(DISTRIBUTION_BOARD, None, bateleur_messages::catalogue()).unwrap();
            let (asked, now_ns) = (RefCell::default(), Cell::new(CYCLE));
            let (gateway, ignores, loses) = (RefCell::new(gateway), Cell::new(0), Cell::new(0));
            let board = Self { table: table.clone(), gateway, socket, asked, ignores, loses, now_ns };
            (board, Wires::open(settings).unwrap(), Conversation::new(table, &[], &[]).unwrap())
        }

        fn cycle(&self, number: u64, wires: &mut Wires, conversation: &mut Conversation) -> Sensors {
            self.now_ns.set(number * CYCLE);
            let moment = Moment { module_ns: number * CYCLE, deadline_ns: number * CYCLE + 2_500_000 };
            conversation.exchange(&at_rest(), &moment, wires, self)
        }

        fn answer(&self) -> bool {
            let (mut frames, mut bytes) = (Vec::new(), [0; 2_048]);
            let mut gateway = self.gateway.borrow_mut();
            while let Ok((length, from)) = self.socket.recv_from(&mut bytes) {
                gateway.take_datagram(&bytes[..length], from, 0, |frame, _| frames.push(*frame));
            }
            self.asked.borrow_mut().extend(&frames);
            let question =
                frames.iter().rfind(|frame| Some(frame.id()) == self.table.sync().map(|sync| sync.frame));
            let now_ns = question.map(|frame| u64::from_le_bytes(frame.data().try_into().unwrap()));
            let ignored = self.ignores.get() > 0 && now_ns.is_some();
            if ignored {
                self.ignores.set(self.ignores.get() - 1);
            }
            if let Some(now_ns) = now_ns.filter(|_| !ignored) {
                self.sample(&mut gateway, now_ns);
            }
            self.send(&mut gateway)
        }

        /// Its nodes say what they measured at a time, whoever asked.
        fn say(&self, now_ns: u64) {
            let mut gateway = self.gateway.borrow_mut();
            self.sample(&mut gateway, now_ns);
            self.send(&mut gateway);
        }

        fn sample(&self, gateway: &mut Gateway, now_ns: u64) {
            let analog = RawAnalog {
                measured_ns: now_ns,
                interval_ns: CYCLE,
                temperature_k: 288.15,
                ..RawAnalog::default()
            };
            let custom = Custom { measured_ns: now_ns, pilot_throttle_us: 1100, ..Custom::default() };
            // Measured half a cycle before it is said.
            let range = Range { measured_ns: now_ns - CYCLE / 2, distance_m: 2.5, ..Range::default() };
            let mut out = self.table.layout("raw_analog").unwrap().frames(analog.as_bytes(), now_ns);
            out.extend(self.table.layout("custom").unwrap().frames(custom.as_bytes(), now_ns));
            out.extend(self.table.layout("range").unwrap().frames(range.as_bytes(), now_ns));
            out.push(Frame::classic(self.table.sync().unwrap().answer.unwrap(), &now_ns.to_le_bytes()));
            let said = out.iter().filter(|frame| frame.id().number() != self.loses.get());
            said.for_each(|frame| gateway.take_frame(frame, 0));
        }

        fn send(&self, gateway: &mut Gateway) -> bool {
            let mut sent = false;
            gateway.run(0, &mut |to, bytes| {
                sent = true;
                self.socket.send_to(bytes, to).is_ok()
            });
            sent
        }
    }

    impl Waiting for Board {
        fn now_ns(&self) -> u64 {
            self.now_ns.get()
        }

        fn wait_readable(&self, _: &impl AsFd, until_ns: u64) -> bool {
            let came = self.answer();
            if !came {
                self.now_ns.set(until_ns);
            }
            came
        }
    }

    #[test]
    fn the_board_is_found_and_asked_and_its_answer_ends_the_wait() {
        let (board, mut wires, mut conversation) = Board::new();
        for number in 1..=3 {
            let sensors = board.cycle(number, &mut wires, &mut conversation);
            let analog = sensors.analog.unwrap();
            assert_eq!((analog.measured_ns, analog.interval_ns), (number * CYCLE, CYCLE));
            assert_eq!(sensors.custom.unwrap().pilot_throttle_us, 1100);
            assert_eq!(sensors.range.map(|range| range.measured_ns), Some(number * CYCLE - CYCLE / 2));
            assert_eq!(sensors.gps, None);
            assert!(board.now_ns.get() < number * CYCLE + 2_500_000);
        }
        let asked: Vec<u32> = board.asked.borrow().iter().map(|frame| frame.id().number()).collect();
        assert_eq!(asked, [0x200, 0x201, 0x2f0].repeat(3));
        assert_eq!(conversation.counts(), Counts { accepted: 3, ..Counts::default() });
    }

    #[test]
    fn a_lost_question_is_asked_again_and_a_silent_board_costs_no_more_than_the_cut_off() {
        let (board, mut wires, mut conversation) = Board::new();
        board.cycle(1, &mut wires, &mut conversation);
        board.ignores.set(1);
        assert!(board.cycle(2, &mut wires, &mut conversation).analog.is_some());
        assert_eq!(conversation.counts().repeated, 1);
        board.ignores.set(99);
        assert_eq!(board.cycle(3, &mut wires, &mut conversation), Sensors::default());
        assert!(board.now_ns.get() <= 3 * CYCLE + 2_500_000);
        assert_eq!(conversation.counts().missing, 1);
    }

    #[test]
    fn an_answer_that_comes_late_keeps_its_own_time_and_a_repeated_one_is_passed_over() {
        let (board, mut wires, mut conversation) = Board::new();
        board.cycle(1, &mut wires, &mut conversation);
        // The question of the second cycle is answered only when the third is asked, and once more.
        board.ignores.set(99);
        board.cycle(2, &mut wires, &mut conversation);
        board.say(2 * CYCLE);
        board.say(2 * CYCLE);
        let late = board.cycle(3, &mut wires, &mut conversation);
        assert_eq!(late.analog.map(|analog| analog.measured_ns), Some(2 * CYCLE));
        assert_eq!(late.range.map(|range| range.measured_ns), Some(2 * CYCLE - CYCLE / 2));
        assert_eq!(conversation.counts().stale, 2);
        board.say(2 * CYCLE);
        assert_eq!(board.cycle(4, &mut wires, &mut conversation), Sensors::default());
    }

    #[test]
    fn two_answers_in_one_datagram_stay_two() {
        let (board, mut wires, mut conversation) = Board::new();
        board.cycle(1, &mut wires, &mut conversation);
        board.ignores.set(99);
        board.cycle(2, &mut wires, &mut conversation);
        {
            let mut gateway = board.gateway.borrow_mut();
            board.sample(&mut gateway, 2 * CYCLE);
            board.sample(&mut gateway, 2 * CYCLE);
            board.send(&mut gateway);
        }
        let analog = board.cycle(3, &mut wires, &mut conversation).analog.unwrap();
        assert_eq!(analog.measured_ns, 2 * CYCLE);
        assert!(analog.rates_radps[0].is_finite() && analog.field_gauss[0].is_finite());
        assert_eq!(conversation.counts().incomplete, 0);
    }

    /// Something comes without end, and looking at it takes time.
    struct Flood<'a>(&'a Board);

    impl Waiting for Flood<'_> {
        fn now_ns(&self) -> u64 {
            self.0.now_ns.get()
        }

        fn wait_readable(&self, _: &impl AsFd, _: u64) -> bool {
            self.0.now_ns.set(self.0.now_ns.get() + 100_000);
            true
        }
    }

    #[test]
    fn a_flood_of_datagrams_does_not_hold_the_window_beyond_the_cut_off() {
        let (board, mut wires, mut conversation) = Board::new();
        let moment = Moment { module_ns: CYCLE, deadline_ns: CYCLE + 2_500_000 };
        conversation.exchange(&at_rest(), &moment, &mut wires, &Flood(&board));
        assert!(board.now_ns.get() <= moment.deadline_ns, "{} ns", board.now_ns.get());
    }

    #[test]
    fn what_came_while_it_was_switched_off_is_not_taken_for_news() {
        let (board, mut wires, mut conversation) = Board::new();
        board.cycle(1, &mut wires, &mut conversation);
        board.ignores.set(99);
        board.say(2 * CYCLE);
        conversation.pass_over(2 * CYCLE, &mut wires);
        assert_eq!(board.cycle(3, &mut wires, &mut conversation), Sensors::default());
    }

    #[test]
    fn a_frame_that_does_not_come_costs_its_own_sensor_alone_or_withholds_the_set() {
        let (board, mut wires, mut conversation) = Board::new();
        board.loses.set(0x111);
        let analog = board.cycle(1, &mut wires, &mut conversation).analog.unwrap();
        assert!(analog.rates_radps[0].is_nan() && (analog.temperature_k - 288.15).abs() < 1e-9);
        board.loses.set(0x120);
        assert_eq!(board.cycle(2, &mut wires, &mut conversation).custom, None);
        let counts = conversation.counts();
        assert_eq!((counts.incomplete, counts.withheld), (1, 1));
    }

    #[test]
    fn a_frame_that_two_ports_share_gives_both_their_values() {
        let text = "[port.raw_analog]\nmessage = \"RawAnalog\"\n\
                    fields = { temperature_k = { frame = \"121\", start = 48, bits = 16 } }\n\
                    [port.custom]\nmessage = \"Custom\"\n\
                    fields = { main_v = { frame = \"121\", start = 0, bits = 16 } }\n";
        let mut conversation = Conversation::new(Table::parse("t", text, None).unwrap(), &[], &[]).unwrap();
        let (moment, mut sensors) = (Moment { module_ns: CYCLE, deadline_ns: CYCLE }, Sensors::default());
        let frame = Frame::classic(Id::Standard(0x121), &[12, 0, 0, 0, 0, 0, 0x20, 1]);
        conversation.take(&frame, 0, &moment, &mut sensors);
        let values =
            (sensors.analog.map(|analog| analog.temperature_k), sensors.custom.map(|set| set.main_v));
        assert_eq!(values, (Some(288.0), Some(12.0)));
        assert_eq!(conversation.counts(), Counts::default());
    }

    #[test]
    fn a_table_with_somebody_elses_port_is_refused() {
        let text = "[port.states]\nmessage = \"Custom\"\nfields = { main_v = { frame = \"100\", start = 0, bits = 8 } }\n";
        let error = Conversation::new(Table::parse("t", text, None).unwrap(), &[], &[]).unwrap_err();
        assert!(error.contains("no port \"states\"") && error.contains("raw_analog"), "{error}");
    }

    #[test]
    fn without_a_bus_and_without_the_network_it_says_so() {
        let settings =
            crate::Settings { bus: BusName::None, listen: None, gateway: Settings::new(1, 1, vec![]) };
        assert!(Wires::open(settings).err().unwrap().contains("nobody to talk to"));
    }
}
