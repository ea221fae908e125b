//! The function that talks to the ground station over a serial line.

use std::process::ExitCode;

use bateleur_apex::serial::{Change, Device, Presence};
use bateleur_apex::{
    Context, Direction, HealthNotices, Line, Partition, PortKind, QueuingDestination, QueuingSource,
    Retained, SamplingDestination, Sent, StartError, Takeover, Window,
};
use bateleur_command::{
    Contingencies, Contingency, Delivery, Downlink, Encoding, HealthTexts, Kept, Numbers, Paced, Radio,
    Rates, Setup, Station, Uplink, parameters, receivers, sane_runway,
};
use bateleur_mavlink::Runway;
use bateleur_messages::frame::Frame;
use bateleur_messages::ground::{Manoeuvre, Order};
use bateleur_messages::parameter::{ASKED_BY_LINE, Parameters};
use bateleur_messages::telemetry::{
    Acknowledge, FROM_COMMAND, FUNCTIONS, NOT_UNDERSTOOD, Refusal, Telemetry,
};
use bateleur_messages::{GroundMessage, Rate, State, TelemetryMessage, Watch};

/// Bytes read in one window, most: four times what a line of 57600 baud carries in 20 ms.
const BYTES_PER_WINDOW: usize = 512;
/// Telemetry messages taken from one function in one window, most; as many as the queue usually holds.
const MESSAGES_PER_FUNCTION: usize = 8;

pub(crate) struct Command {
    path: String,
    baud: u32,
    line: Line<Device>,
    presence: Presence,
    received: Vec<u8>,
    uplink: Uplink,
    downlink: Downlink,
    dropped_told: u64,
    /// What the plan says.
    plan: Numbers,
    /// The same, and what the ground has set since.
    numbers: Numbers,
    parameters: Parameters<Numbers>,
    /// By the name of the function.
    orders: Vec<(String, QueuingSource<GroundMessage>)>,
    telemetry: Vec<QueuingDestination<TelemetryMessage>>,
    rate: SamplingDestination<Rate>,
    timeout: Watch,
    retained: Retained<Kept>,
    contingencies: Contingencies,
    /// Module time of the window, ns.
    now_ns: u64,
    /// A ground station that speaks MAVLink, beside the line or on it.
    mavlink: Option<(Way, Station)>,
    /// What the module's health log says, where the plan lets this partition know.
    notices: HealthNotices,
    health: HealthTexts,
    /// Where the plan has it: telemetry is slower.
    state: Option<SamplingDestination<State>>,
}

/// Where MAVLink is spoken.
enum Way {
    /// Over the network, beside the line.
    Radio(Radio),
    /// On the line, in the place of the native protocol.
    Line(Paced),
}

impl Partition for Command {
    fn start(context: &mut Context) -> Result<Self, StartError> {
        let baud = context.attribute("baud", 57_600_u32)?;
        if baud == 0 {
            return Err(StartError::Other(
                "attribute baud = 0: give the speed of the line, such as 57600".into(),
            ));
        }
        let contingency = Contingency::read(context.attributes())?;
        let numbers = numbers(context, baud, &contingency)?;
        let orders = order_ports(context)?;
        let absent = Device::absent()
            .map_err(|error| StartError::Other(format!("cannot make a stand-in for the device: {error}")))?;
        let mut command = Self {
            path: context.attribute("device", "/dev/ttyS0".into())?,
            baud,
            line: context.line(absent),
            presence: Presence::default(),
            received: Vec::with_capacity(BYTES_PER_WINDOW),
            uplink: Uplink::new(),
            downlink: Downlink::new(baud),
            dropped_told: 0,
            plan: numbers,
            numbers,
            parameters: parameters(),
            mavlink: mavlink(context, &numbers, &orders)?,
            orders,
            telemetry: telemetry_ports(context)?,
            rate: context.sampling_destination("rate")?,
            timeout: Watch::default(),
            retained: context.retained()?,
            contingencies: Contingencies::new(contingency),
            now_ns: 0,
            notices: context.health_notices(),
            health: HealthTexts::default(),
            state: state_port(context)?,
        };
        command.resume();
        Ok(command)
    }

    fn take_over(&mut self, _takeover: &Takeover) {
        self.uplink = Uplink::new();
        self.downlink = Downlink::new(self.baud);
        self.resume();
    }

    fn window(&mut self, window: &Window) {
        self.now_ns = window.start_ns();
        if self.presence.is_due(window.start_ns()) {
            self.open(window);
        }
        self.receive(window);
        self.deliver(window.start_ns());
        self.collect();
        self.tell_health(window.start_ns());
        self.serve_mavlink(window.start_ns());
        self.listen(window);
        // Before and after the line has taken bytes: one that is killed in its window has little to repeat.
        self.keep();
        self.send(window);
        self.keep();
        if self.rate.read_valid().is_some_and(|rate| self.timeout.changed(rate.timeout_1)) {
            self.complain(window);
        }
    }
}

impl Command {
    /// Goes on with what was on its way when the incarnation before ended.
    fn resume(&mut self) {
        if let Some(kept) = self.retained.load() {
            kept.resume(&mut self.uplink, &mut self.downlink, &mut self.presence, &mut self.contingencies);
            self.dropped_told = self.downlink.dropped();
            let (read, owed) = kept.notices();
            self.notices.resume(read);
            self.health.lose(owed);
            (self.numbers, self.parameters) = (self.plan, parameters());
            self.parameters.resume(kept.parameters(), &mut self.numbers);
            if let Some((_, station)) = &mut self.mavlink {
                station.set_rates(self.numbers.rates);
                station.resume_mission(kept.mission());
                station.resume_marks(kept.marks());
            }
        }
    }

    fn keep(&mut self) {
        let mission = self.mavlink.as_ref().map(|(_, station)| station.mission()).unwrap_or_default();
        let marks = self.mavlink.as_ref().map(|(_, station)| station.marks()).unwrap_or_default();
        let parameters = self.parameters.changed();
        let notices = (self.notices.position(), self.health.owed());
        let kept = Kept::of(
            &self.uplink,
            &self.downlink,
            &self.presence,
            &self.contingencies,
            parameters,
            (mission, &marks),
            notices,
        );
        self.retained.store(&kept);
    }

    fn open(&mut self, window: &Window) {
        match Device::open(&self.path, self.baud) {
            Ok(device) => {
                self.line.replace(device);
                if self.presence.opened() == Some(Change::Found) {
                    window.report(&format!("ground link {} is there", self.path));
                }
            }
            Err(error) => self.lost(window, &error.to_string()),
        }
    }

    fn lost(&mut self, window: &Window, why: &str) {
        self.downlink.cut();
        if let Some((Way::Line(paced), _)) = &mut self.mavlink {
            paced.cut();
        }
        if self.presence.failed(window.start_ns()) == Some(Change::Lost) {
            window.raise(&format!("ground link {} {why}", self.path));
        }
    }

    fn receive(&mut self, window: &Window) {
        self.received.clear();
        if !self.presence.is_open() {
            return;
        }
        if let Err(error) = self.line.receive(window, &mut self.received, BYTES_PER_WINDOW) {
            self.lost(window, &format!("is gone ({error})"));
        }
        if let Some((Way::Line(_), station)) = &mut self.mavlink {
            station.stream(&self.received, window.start_ns());
            self.received.clear();
        }
    }

    /// Gives the order that the plan has for what is lost, the ground first of all.
    fn listen(&mut self, window: &Window) {
        let now_ns = window.start_ns();
        if self.mavlink.as_mut().is_some_and(|(_, station)| station.was_heard()) {
            self.contingencies.heard(now_ns);
        }
        let Some(change) = self.contingencies.window(now_ns) else { return };
        if let Some(order) = change.order {
            let frame = Frame { letter: order.letter(), data: order.data() };
            let Some(message) = GroundMessage::from_frame(&frame) else { return };
            if !self.pass_on(&message, receivers(&message), now_ns) {
                return; // in a later window
            }
            self.contingencies.given(change.cause);
        }
        window.report(&change.text);
        if let Some((_, station)) = &mut self.mavlink {
            station.warn(&change.text);
        }
    }

    fn deliver(&mut self, now_ns: u64) {
        for delivery in self.uplink.take(&self.received) {
            self.contingencies.heard(now_ns);
            match delivery {
                Delivery::Beat => {}
                Delivery::To(message, functions) => {
                    self.pass_on(&message, functions, now_ns);
                }
                Delivery::NotUnderstood(message) => self.answer(not_understood(&message, now_ns)),
            }
        }
    }

    /// Whether all functions have taken it.
    fn pass_on(&mut self, message: &GroundMessage, functions: &[&str], now_ns: u64) -> bool {
        let mut taken = true;
        if let (Some((_, station)), Ok(order)) =
            (&mut self.mavlink, Order::parse(message.letter, message.bytes()))
        {
            station.ordered(&order);
        }
        for function in functions {
            if *function == "command" {
                self.own(message, now_ns);
            } else if let Some(answer) = self.order(function, message, now_ns) {
                self.answer(answer);
                taken = false;
            }
        }
        taken
    }

    fn tell_health(&mut self, now_ns: u64) {
        self.notices.by_ref().for_each(|notice| self.health.take(notice));
        self.health.lose(self.notices.take_lost());
        if let Some(text) = self.health.next(now_ns) {
            self.told(TelemetryMessage::of(&Telemetry::Health(text)));
        }
    }

    /// An order that concerns this function.
    fn own(&mut self, message: &GroundMessage, now_ns: u64) {
        let answer = self.parameters.take(message, &mut self.numbers, now_ns);
        if let Some((_, station)) = self.mavlink.as_mut().filter(|_| answer.is_some_and(|a| a.changed)) {
            station.set_rates(self.numbers.rates);
        }
        match answer {
            Some(answer) => answer.messages().for_each(|message| self.told(message)),
            None => self.answer(not_understood(message, now_ns)),
        }
    }

    /// Hears and answers the ground station that speaks MAVLink.
    fn serve_mavlink(&mut self, now_ns: u64) {
        let Some((mut way, mut station)) = self.mavlink.take() else { return };
        if let Some(state) = self.state.as_mut().and_then(SamplingDestination::read_valid) {
            station.state(state);
        }
        if let Way::Radio(radio) = &mut way {
            radio.receive(&mut station, now_ns);
        }
        let orders = station.window(now_ns);
        if let Way::Radio(radio) = &mut way {
            radio.send(&mut station);
        }
        self.mavlink = Some((way, station));
        for order in orders {
            let frame = Frame { letter: order.letter(), data: order.data() };
            if let Some(message) = GroundMessage::from_frame(&frame) {
                self.pass_on(&message, receivers(&message), now_ns);
            }
        }
    }

    /// Passes an order on; gives what to answer in the function's place where that is not possible.
    fn order(&mut self, function: &str, message: &GroundMessage, now_ns: u64) -> Option<Acknowledge> {
        match self.orders.iter_mut().find(|(name, _)| name == function) {
            None => Some(not_understood(message, now_ns)), // the plan has no such function
            Some((_, port)) => (port.send(message) != Sent::Queued)
                .then(|| Acknowledge::refused(message, FROM_COMMAND, Refusal::NotTaken, now_ns)),
        }
    }

    fn answer(&mut self, answer: Acknowledge) {
        self.told(TelemetryMessage::of(&Telemetry::Acknowledge(answer)));
    }

    /// What a function tells the ground, for both kinds of ground station.
    fn told(&mut self, message: TelemetryMessage) {
        let mut for_the_line = true;
        let telemetry = Telemetry::of(&Frame { letter: message.letter, data: message.bytes().to_vec() });
        if let Ok(telemetry) = &telemetry {
            self.contingencies.telemetry(telemetry, self.now_ns);
        }
        if let Some((way, station)) = &mut self.mavlink {
            for_the_line = !matches!(way, Way::Line(_));
            if let Ok(telemetry) = telemetry {
                // What was asked for MAVLink is none of the line's.
                for_the_line &=
                    !matches!(&telemetry, Telemetry::Parameter(value) if value.asker != ASKED_BY_LINE);
                station.telemetry(&telemetry);
            }
        }
        if for_the_line {
            self.downlink.push(message);
        }
    }

    fn collect(&mut self) {
        for place in 0..self.telemetry.len() {
            for _ in 0..MESSAGES_PER_FUNCTION {
                let Some(message) = self.telemetry[place].receive() else { break };
                self.told(message);
            }
        }
    }

    fn send(&mut self, window: &Window) {
        if !self.presence.is_open() {
            return;
        }
        let now_ns = window.start_ns();
        let sent = match &mut self.mavlink {
            Some((Way::Line(paced), station)) => {
                let sent = self.line.send(paced.due(now_ns, |bytes| {
                    station.next_message().map(|message| bytes.extend(message)).is_some()
                }));
                sent.map(|count| paced.sent(count))
            }
            _ => {
                let sent = self.line.send(self.downlink.due(now_ns));
                sent.map(|count| self.downlink.sent(count))
            }
        };
        if let Err(error) = sent {
            self.lost(window, &format!("is gone ({error})"));
        }
    }

    /// Says what could not be read or sent, if that is news.
    fn complain(&mut self, window: &Window) {
        if let Some(refused) = self.uplink.news() {
            let (frames, noise) = (refused.frames(), refused.noise_bytes);
            window.report(&format!("ground link: {frames} frames refused, {noise} bytes of noise so far"));
        }
        let dropped = self.downlink.dropped();
        if std::mem::replace(&mut self.dropped_told, dropped) != dropped {
            window.report(&format!("ground link: {dropped} telemetry messages dropped so far"));
        }
    }
}

/// A ground station that speaks MAVLink, where the plan names one.
fn mavlink(
    context: &mut Context,
    numbers: &Numbers,
    orders: &[(String, QueuingSource<GroundMessage>)],
) -> Result<Option<(Way, Station)>, StartError> {
    let address: Option<String> = context.attribute("mavlink", None)?;
    let Some(address) = address else { return Ok(None) };
    let is_there = |(number, name): &(u8, &str)| {
        *number == FROM_COMMAND || orders.iter().any(|(function, _)| function == name)
    };
    let setup = Setup {
        system: numbers.system,
        runway: numbers.runway,
        functions: FUNCTIONS
            .iter()
            .filter(|function| is_there(function))
            .map(|(number, _)| 1 << number)
            .sum(),
        encoding: numbers.encoding,
        rates: numbers.rates,
    };
    let way = match address.as_str() {
        "serial" => Way::Line(Paced::new(numbers.baud)),
        address => Way::Radio(Radio::open(address).map_err(|error| StartError::Other(error.to_string()))?),
    };
    Ok(Some((way, Station::new(&setup))))
}

/// The attributes that are numbers.
fn numbers(context: &mut Context, baud: u32, contingency: &Contingency) -> Result<Numbers, StartError> {
    let usual = Runway::default();
    let encoding: String = context.attribute("parameter_encoding", "bytes".into())?;
    let [silence, ..] = contingency.ladders;
    let address: Option<String> = context.attribute("mavlink", None)?;
    Ok(Numbers {
        baud,
        mavlink: address.is_some(),
        system: context.attribute("system", 1)?,
        runway: sane_runway(Runway {
            latitude_deg: context.attribute("origin_latitude_deg", usual.latitude_deg)?,
            longitude_deg: context.attribute("origin_longitude_deg", usual.longitude_deg)?,
            altitude_m: context.attribute("origin_altitude_m", usual.altitude_m)?,
        })
        .map_err(StartError::Other)?,
        encoding: Encoding::from_name(&encoding).ok_or_else(|| {
            StartError::Other(format!(
                "attribute parameter_encoding = \"{encoding}\": give \"bytes\" (QGroundControl) or \"cast\" (MAVProxy)"
            ))
        })?,
        rates: Rates::default(),
        lost_link: match silence[0].map(|rung| rung.fly) {
            None => 0,
            Some(Manoeuvre::Loiter) => 1,
            Some(Manoeuvre::Land) => 3,
            Some(_) => 2,
        },
        lost_link_after_s: silence[0].map_or(0.0, |rung| rung.after_ns as f64 * 1e-9),
    })
}

fn state_port(context: &mut Context) -> Result<Option<SamplingDestination<State>>, StartError> {
    let ports = context.port_names(PortKind::Sampling, Direction::Destination);
    ports.iter().any(|port| port == "state").then(|| context.sampling_destination("state")).transpose()
}

fn not_understood(message: &GroundMessage, now_ns: u64) -> Acknowledge {
    Acknowledge::of(message, FROM_COMMAND, NOT_UNDERSTOOD, now_ns)
}

fn order_ports(context: &mut Context) -> Result<Vec<(String, QueuingSource<GroundMessage>)>, StartError> {
    let mut ports = Vec::new();
    for name in context.port_names(PortKind::Queuing, Direction::Source) {
        if let Some(function) = name.strip_prefix("to_") {
            ports.push((function.to_owned(), context.queuing_source(&name)?));
        }
    }
    Ok(ports)
}

fn telemetry_ports(context: &mut Context) -> Result<Vec<QueuingDestination<TelemetryMessage>>, StartError> {
    let mut ports = Vec::new();
    for name in context.port_names(PortKind::Queuing, Direction::Destination) {
        if name.starts_with("from_") {
            ports.push(context.queuing_destination(&name)?);
        }
    }
    Ok(ports)
}

pub(crate) fn main() -> ExitCode {
    bateleur_apex::run::<Command>()
}
