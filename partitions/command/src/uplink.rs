//! From the ground to the functions: frames out of bytes, and the way of each order.

use bateleur_messages::GroundMessage;
use bateleur_messages::frame::{Decoder, DecoderState, Frame, Refused};
use bateleur_messages::ground::BEAT;
use bateleur_messages::telemetry::FUNCTIONS;

/// Frames handled in one window, most. The line can not carry more than ten in 20 ms.
const FRAMES_AT_ONCE: usize = 16;

/// What is to be done with a frame.
#[derive(Debug, Clone, PartialEq)]
pub enum Delivery {
    /// An order for these functions.
    To(GroundMessage, &'static [&'static str]),
    /// The ground station is there, and wants nothing.
    Beat,
    /// No function knows the letter, or the data is longer than any order's. With the letter and the first byte of data,
    /// for the answer.
    NotUnderstood(GroundMessage),
}

/// The functions that an order concerns, by their names in the plan; `"command"` is this one.
pub fn receivers(message: &GroundMessage) -> &'static [&'static str] {
    match message.letter {
        b'H' => &["hil_interface"],
        // The Controller computes and the Servo lets through: both must know.
        b'A' => &["controller", "servo"],
        b'N' | b'W' | b'L' | b'F' | b'J' | b'G' | b'P' => &["controller"],
        b'I' => &["imu"],
        b'E' => &["estimator"],
        b'R' | b'Y' => message.bytes().first().map_or(&[], |of| function(*of)),
        _ => &[],
    }
}

/// The function with this number; empty if there is no such function.
fn function(of: u8) -> &'static [&'static str] {
    const NAMES: [&str; FUNCTIONS.len()] = {
        let mut names = [""; FUNCTIONS.len()];
        let mut place = 0;
        while place < FUNCTIONS.len() {
            names[place] = FUNCTIONS[place].1;
            place += 1;
        }
        names
    };
    let place = FUNCTIONS.iter().position(|(number, _)| *number == of);
    place.map_or(&[], |place| &NAMES[place..=place])
}

/// Finds orders in the bytes of the line.
#[derive(Debug, Default)]
pub struct Uplink {
    decoder: Decoder,
    told: Refused,
}

impl Uplink {
    /// Waits for its first frame.
    pub fn new() -> Self {
        Self::default()
    }

    /// Goes on where the incarnation before stood, perhaps in the middle of a frame.
    pub fn resume(&mut self, state: &DecoderState) {
        self.decoder = Decoder::resume(state);
        self.told = self.decoder.refused();
    }

    /// What its successor goes on from.
    pub fn state(&self) -> DecoderState {
        self.decoder.state()
    }

    /// Takes bytes; gives what is to be done.
    pub fn take(&mut self, bytes: &[u8]) -> Vec<Delivery> {
        self.decoder.extend(bytes).take(FRAMES_AT_ONCE).map(|frame| delivery(&frame)).collect()
    }

    /// What could not be read so far, if that has changed since it was last asked for.
    pub fn news(&mut self) -> Option<Refused> {
        let refused = self.decoder.refused();
        (std::mem::replace(&mut self.told, refused) != refused).then_some(refused)
    }
}

fn delivery(frame: &Frame) -> Delivery {
    if frame.letter == BEAT {
        return Delivery::Beat;
    }
    match GroundMessage::from_frame(frame).map(|message| (message, receivers(&message))) {
        Some((message, to)) if !to.is_empty() => Delivery::To(message, to),
        _ => Delivery::NotUnderstood(head(frame)),
    }
}

/// The letter and the first byte of a frame that may be too long for a message.
fn head(frame: &Frame) -> GroundMessage {
    let mut message = GroundMessage { letter: frame.letter, ..GroundMessage::default() };
    if let Some(&first) = frame.data.first() {
        (message.length, message.data[0]) = (1, first);
    }
    message
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_messages::frame::encode;
    use bateleur_messages::ground::{LoopId, Manoeuvre, Order, Reason};

    fn bytes(letter: u8, data: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        encode(letter, data, &mut bytes);
        bytes
    }

    fn route(order: &Order) -> &'static [&'static str] {
        let deliveries = Uplink::new().take(&bytes(order.letter(), &order.data()));
        let [Delivery::To(message, to)] = &deliveries[..] else { panic!("{deliveries:?}") };
        assert_eq!(Order::parse(message.letter, message.bytes()), Ok(*order));
        to
    }

    #[test]
    fn every_order_finds_those_whom_it_concerns() {
        assert_eq!(route(&Order::Hil { on: true }), ["hil_interface"]);
        assert_eq!(route(&Order::Autopilot { on: true }), ["controller", "servo"]);
        assert_eq!(route(&Order::Navigation { on: true }), ["controller"]);
        assert_eq!(route(&Order::Loop { id: LoopId::Normal, on: true, target: -9.8 }), ["controller"]);
        assert_eq!(route(&Order::InitialiseSensors { sensors: 7 }), ["imu"]);
        assert_eq!(
            route(&Order::Manoeuvre { what: Manoeuvre::Loiter, reason: Reason::Ordered }),
            ["controller"]
        );
        assert_eq!(Uplink::new().take(&bytes(BEAT, &[])), [Delivery::Beat]);
        assert_eq!(route(&Order::ReadParameter { of: 0, index: 0, asker: 0 }), ["command"]);
        assert_eq!(route(&Order::ReadParameter { of: 8, index: 0, asker: 0 }), ["rate_generator"]);
    }

    #[test]
    fn question_to_a_function_that_there_is_not_is_not_understood() {
        let order = Order::ReadParameter { of: 99, index: 0, asker: 0 };
        let deliveries = Uplink::new().take(&bytes(order.letter(), &order.data()));
        assert!(matches!(deliveries[..], [Delivery::NotUnderstood(message)] if message.letter == b'R'));
    }

    #[test]
    fn an_unknown_letter_is_not_understood_and_keeps_its_first_byte() {
        let deliveries = Uplink::new().take(&bytes(b'Z', &[9, 8]));
        let [Delivery::NotUnderstood(message)] = &deliveries[..] else { panic!("{deliveries:?}") };
        assert_eq!((message.letter, message.bytes()), (b'Z', &[9][..]));
    }

    #[test]
    fn an_order_that_is_too_long_is_not_understood() {
        let deliveries = Uplink::new().take(&bytes(b'W', &[3; 100]));
        assert!(matches!(deliveries[..], [Delivery::NotUnderstood(message)] if message.letter == b'W'));
    }

    #[test]
    fn an_order_in_pieces_among_noise_arrives_once() {
        let mut uplink = Uplink::new();
        let order = bytes(b'H', &[1]);
        assert!(uplink.take(b"\r\nlogin: ").is_empty());
        assert!(uplink.take(&order[..3]).is_empty());
        assert_eq!(uplink.take(&order[3..]).len(), 1);
        assert_eq!(uplink.news().map(|refused| refused.noise_bytes), Some(9));
        assert_eq!(uplink.news(), None);
    }

    #[test]
    fn a_damaged_order_is_counted_and_not_delivered() {
        let mut damaged = bytes(b'N', &[1]);
        damaged[3] ^= 1;
        let mut uplink = Uplink::new();
        assert!(uplink.take(&damaged).is_empty());
        assert_eq!(uplink.news().map(|refused| refused.frames()), Some(1));
    }
}
