//! The MAVLink side of the conversation: messages to and from the inbox.

mod assembly;
mod beside;
mod clock;

use bateleur_mavlink::common::{HIL_GPS_DATA, HIL_SENSOR_DATA, HilSensorUpdatedFlags, MavMessage};
use bateleur_mavlink::{Decoder, Encoder, Received, hil};
use bateleur_messages::ServoTimers;

use crate::inbox::Inbox;
use crate::link::Chunk;
use assembly::Assembly;
use beside::Beside;
use clock::Clock;

/// Number of the component: the flight computer of its system.
const AUTOPILOT: u8 = 1;
/// Windows between two heartbeats: one second at 50 Hz.
const HEARTBEAT_WINDOWS: u64 = 50;
/// Windows without sensors of the one who speaks for the simulator, after which another may.
const SILENT_WINDOWS: u32 = 5;
/// A gap in the numbers of this length and more is a message that came late or twice.
const NOT_A_GAP: u8 = 128;

/// Who speaks for the simulator: system, component.
type Speaker = (u8, u8);

/// The state of the conversation.
#[derive(Debug)]
pub(crate) struct Mavlink {
    encoder: Encoder,
    decoder: Decoder,
    simulator: u8,
    lockstep: bool,
    windows: u64,
    asked_ns: u64,
    clock: Clock,
    assembly: Assembly,
    beside: Beside,
    /// Who sent the first sensors; others are not listened to while this one speaks.
    speaker: Option<Speaker>,
    /// Windows since it last sent sensors.
    silent_windows: u32,
    next_number: Option<u8>,
    newest_ns: Option<u64>,
    /// The simulator has moved on, but not as far as it was asked to.
    on_the_way: bool,
}

impl Mavlink {
    /// For a flight computer whose system number is `system`, and a simulator of system `simulator` (0: any).
    pub(crate) fn new(system: u8, simulator: u8, lockstep: bool) -> Self {
        Self {
            encoder: Encoder::new(system, AUTOPILOT),
            decoder: Decoder::new(),
            simulator,
            lockstep,
            windows: 0,
            asked_ns: 0,
            clock: Clock::default(),
            assembly: Assembly::default(),
            beside: Beside::default(),
            speaker: None,
            silent_windows: 0,
            next_number: None,
            newest_ns: None,
            on_the_way: false,
        }
    }

    /// A window begins; appends its question to `out`.
    pub(crate) fn ask(&mut self, module_ns: u64, timers: &ServoTimers, out: &mut Vec<u8>) {
        self.asked_ns = module_ns;
        self.clock.asks(module_ns);
        if self.windows.is_multiple_of(HEARTBEAT_WINDOWS) {
            self.encoder.write(&hil::heartbeat(timers.autopilot == 1), out);
        }
        self.windows += 1;
        self.silent_windows = self.silent_windows.saturating_add(1);
        self.write_question(timers, out);
    }

    /// Appends the question of this window once more.
    pub(crate) fn write_question(&mut self, timers: &ServoTimers, out: &mut Vec<u8>) {
        self.encoder.write(&hil::actuator_controls(self.asked_ns / 1_000, timers, self.lockstep), out);
    }

    /// Takes what came.
    pub(crate) fn take(&mut self, chunk: Chunk<'_>, inbox: &mut Inbox) {
        let mut decoder = std::mem::take(&mut self.decoder);
        let before = decoder.refused();
        match chunk {
            Chunk::Datagram(bytes) => decoder.datagram(bytes, |received| self.received(&received, inbox)),
            Chunk::Stream(bytes) => decoder.stream(bytes, |received| self.received(&received, inbox)),
            Chunk::End => {
                decoder.cut();
                (self.speaker, self.next_number) = (None, None);
            }
        }
        let after = decoder.refused();
        let counters = inbox.counters_mut();
        counters.refused += after.messages() - before.messages();
        // A datagram of noise alone; in a stream, the beginning of something else.
        let noise = after.noise_bytes > before.noise_bytes && after.messages() == before.messages();
        counters.refused += u64::from(noise);
        self.decoder = decoder;
    }

    /// Whether the simulator has moved on without reaching the time that it was asked for: it waits for the next
    /// question. Asking takes the mark away.
    pub(crate) fn wants_another_question(&mut self) -> bool {
        std::mem::take(&mut self.on_the_way)
    }

    /// The window is over: what was collected goes into the inbox.
    pub(crate) fn finish(&mut self, inbox: &mut Inbox) {
        self.on_the_way = false;
        if let Some(analog) = self.assembly.publish() {
            inbox.put_analog(analog);
        }
        if let Some(custom) = self.beside.publish(self.asked_ns) {
            inbox.put_custom(custom);
        }
        inbox.counters_mut().clock_ties = self.clock.ties();
    }

    fn received(&mut self, received: &Received, inbox: &mut Inbox) {
        let sender = (received.system, received.component);
        let Ok(message) = &received.message else { return };
        match message {
            MavMessage::HIL_SENSOR(message) if message.id == 0 => {
                if self.hears(sender, true, inbox) {
                    self.count(received.sequence, inbox);
                    self.sensor(message, inbox);
                }
            }
            MavMessage::HIL_GPS(_)
            | MavMessage::HIL_RC_INPUTS_RAW(_)
            | MavMessage::BATTERY_STATUS(_)
            | MavMessage::POWER_STATUS(_)
            | MavMessage::DISTANCE_SENSOR(_) => {
                if self.hears(sender, false, inbox) {
                    self.count(received.sequence, inbox);
                    self.beside(message, inbox);
                }
            }
            _ => {
                inbox.counters_mut().unused += 1;
                if self.speaker == Some(sender) {
                    self.count(received.sequence, inbox);
                }
            }
        }
    }

    /// Whether `sender` speaks for the simulator. The first that sends sensors does, until it has sent none for five
    /// windows.
    fn hears(&mut self, sender: Speaker, sensors: bool, inbox: &mut Inbox) -> bool {
        let is_free = (self.simulator == 0 || self.simulator == sender.0)
            && (self.speaker.is_none() || self.silent_windows >= SILENT_WINDOWS);
        if sensors && is_free && self.speaker != Some(sender) {
            (self.speaker, self.next_number) = (Some(sender), None);
        }
        // Before anybody has sent sensors, what comes beside them is as good as any.
        if self.speaker.map_or(sensors, |speaker| speaker != sender) {
            inbox.counters_mut().strangers += 1;
            return false;
        }
        if sensors {
            self.silent_windows = 0;
        }
        true
    }

    /// Counts what is missing between two messages by their numbers.
    fn count(&mut self, number: u8, inbox: &mut Inbox) {
        let gap = self.next_number.map_or(0, |next| number.wrapping_sub(next));
        if gap < NOT_A_GAP {
            inbox.counters_mut().lost += u64::from(gap);
            self.next_number = Some(number.wrapping_add(1));
        }
    }

    fn sensor(&mut self, message: &HIL_SENSOR_DATA, inbox: &mut Inbox) {
        if message.fields_updated.contains(HilSensorUpdatedFlags::HIL_SENSOR_UPDATED_RESET) {
            self.clock.reset();
            self.begin_anew();
        }
        let alone = inbox.accepts_older_stamps();
        let ties = self.clock.ties();
        let Ok(at_ns) = self.clock.sensor_ns(message.time_usec, alone) else {
            inbox.counters_mut().invalid += 1;
            return;
        };
        if self.clock.ties() != ties {
            self.begin_anew();
        }
        if self.newest_ns.is_some_and(|newest_ns| at_ns <= newest_ns) {
            if !alone || self.newest_ns == Some(at_ns) {
                // The answer that was asked for twice comes twice.
                inbox.counters_mut().stale += u64::from(at_ns != self.asked_ns);
                return;
            }
            self.begin_anew();
        }
        self.newest_ns = Some(at_ns);
        inbox.counters_mut().invalid += self.assembly.take(message, at_ns);
        if at_ns >= self.asked_ns {
            inbox.note_answer();
        } else {
            inbox.counters_mut().stale += u64::from(self.lockstep && self.clock.ties() == 0);
            self.on_the_way = true;
        }
    }

    fn begin_anew(&mut self) {
        self.newest_ns = None;
        self.assembly.reset();
    }

    fn beside(&mut self, message: &MavMessage, inbox: &mut Inbox) {
        match message {
            MavMessage::HIL_GPS(message) if message.id == 0 => self.fix(message, inbox),
            MavMessage::HIL_RC_INPUTS_RAW(message) => self.beside.sticks(message, self.asked_ns),
            MavMessage::BATTERY_STATUS(message) => self.beside.battery(message, self.asked_ns),
            MavMessage::POWER_STATUS(message) => self.beside.power(message, self.asked_ns),
            // Its milliseconds since some start say nothing: it came with this window's sensors.
            MavMessage::DISTANCE_SENSOR(message) => {
                hil::range(message, self.asked_ns).into_iter().for_each(|range| inbox.put_range(range));
            }
            _ => inbox.counters_mut().unused += 1,
        }
    }

    fn fix(&mut self, message: &HIL_GPS_DATA, inbox: &mut Inbox) {
        match self.clock.elsewhere_ns(message.time_usec) {
            Ok(measured_ns) => inbox.put_gps(hil::raw_gps(message, measured_ns)),
            Err(_) => inbox.counters_mut().invalid += 1,
        }
    }
}

#[cfg(test)]
mod tests;
