//! What the receiver is asked for: repeated until it says yes, because a line loses things and a receiver starts anew.

use ublox::cfg_msg::CfgMsgSinglePortBuilder;
use ublox::cfg_rate::{AlignmentToReferenceTime, CfgRateBuilder};
use ublox::cfg_val::CfgVal;
use ublox::packets::cfg_val::{CfgLayerSet, CfgValSetBuilder};

/// Between two attempts, module time, ns.
const RETRY_NS: u64 = 1_000_000_000;
/// Class and number of NAV-PVT.
const NAV_PVT: (u8, u8) = (0x01, 0x07);
/// Class of all orders.
const CFG: u8 = 0x06;

/// What is wanted of it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Settings {
    /// Between two solutions, ms.
    pub period_ms: u16,
}

/// One order and its number within the class CFG.
struct Order {
    number: u8,
    bytes: Vec<u8>,
    /// A receiver that lacks what it is about refuses it, and goes on.
    optional: bool,
}

/// Orders that wait for their answers.
pub struct Orders {
    waiting: Vec<Order>,
    next_ns: u64,
    settings: Settings,
    refused: u64,
    newer: bool,
}

impl Orders {
    /// Nothing has been asked yet.
    #[must_use]
    pub fn new(settings: Settings) -> Self {
        Self { waiting: older(settings), next_ns: 0, settings, refused: 0, newer: false }
    }

    /// The line was opened anew, or the receiver fell silent: all is asked again.
    pub fn again(&mut self) {
        *self = Self { refused: self.refused, ..Self::new(self.settings) };
    }

    /// Bytes to send now; nothing where all was granted, or it is too early.
    pub fn due(&mut self, now_ns: u64) -> Option<Vec<u8>> {
        if self.waiting.is_empty() || now_ns < self.next_ns {
            return None;
        }
        self.next_ns = now_ns + RETRY_NS;
        Some(self.waiting.iter().flat_map(|order| order.bytes.iter().copied()).collect())
    }

    /// The receiver said yes or no to an order. From protocol 32 on (M10 and later) the older orders are refused: then the newer one is tried.
    pub fn answered(&mut self, class: u8, number: u8, granted: bool) {
        if class != CFG {
            return;
        }
        // Answers come in the order of what was sent: this one is for the first with its number.
        let Some(place) = self.waiting.iter().position(|order| order.number == number) else { return };
        let order = self.waiting.remove(place);
        if granted || order.optional {
            return;
        }
        self.refused += 1;
        if !self.newer {
            self.newer = true;
            self.waiting = newer(self.settings);
            self.next_ns = 0;
        }
    }

    /// All was granted.
    #[must_use]
    pub fn are_granted(&self) -> bool {
        self.waiting.is_empty()
    }

    /// How many were refused.
    #[must_use]
    pub fn refused(&self) -> u64 {
        self.refused
    }
}

/// Generations up to 9: one order a setting.
fn older(settings: Settings) -> Vec<Order> {
    let rate = CfgRateBuilder {
        measure_rate_ms: settings.period_ms,
        nav_rate: 1,
        time_ref: AlignmentToReferenceTime::Gps,
    };
    let message = CfgMsgSinglePortBuilder { msg_class: NAV_PVT.0, msg_id: NAV_PVT.1, rate: 1 };
    vec![
        Order { number: 0x08, bytes: rate.into_packet_bytes().to_vec(), optional: false },
        Order { number: 0x01, bytes: message.into_packet_bytes().to_vec(), optional: false },
    ]
}

/// Generations from 9 on, kept in memory that a restart of the receiver clears. Every one has a first serial port; an order that names
/// another port is refused whole where the receiver has none, so each of those stands for itself.
fn newer(settings: Settings) -> Vec<Order> {
    let everywhere = [CfgVal::RateMeas(settings.period_ms), CfgVal::MsgOutUbxNavPvtUart1(1)];
    let usb = [CfgVal::MsgOutUbxNavPvtUsb(1)];
    let second = [CfgVal::MsgOutUbxNavPvtUart2(1)];
    vec![set(&everywhere, false), set(&usb, true), set(&second, true)]
}

fn set(values: &[CfgVal], optional: bool) -> Order {
    let mut bytes = Vec::new();
    CfgValSetBuilder { version: 1, layers: CfgLayerSet::RAM, reserved1: 0, cfg_data: values }
        .extend_to(&mut bytes);
    Order { number: 0x8a, bytes, optional }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECOND: u64 = 1_000_000_000;

    #[test]
    fn orders_are_repeated_once_a_second_until_they_are_granted() {
        let mut orders = Orders::new(Settings { period_ms: 200 });
        let first = orders.due(0).unwrap();
        // CFG-RATE 200 ms, one solution each, GPS time; CFG-MSG NAV-PVT once a solution (UBX-13003221).
        assert_eq!(first[..14], [0xb5, 0x62, 0x06, 0x08, 6, 0, 0xc8, 0, 1, 0, 1, 0, 0xde, 0x6a]);
        assert_eq!(first[14..], [0xb5, 0x62, 0x06, 0x01, 3, 0, 0x01, 0x07, 1, 0x13, 0x51]);
        assert!(orders.due(SECOND / 2).is_none());
        assert_eq!(orders.due(SECOND).unwrap().len(), 25);
        orders.answered(CFG, 0x08, true);
        assert_eq!(orders.due(2 * SECOND).unwrap().len(), 11);
        orders.answered(CFG, 0x01, true);
        assert!(orders.due(9 * SECOND).is_none() && orders.are_granted());
        orders.again();
        assert_eq!(orders.due(0).unwrap().len(), 25);
    }

    #[test]
    fn receiver_that_refuses_the_older_orders_gets_the_newer_one_and_only_once() {
        let mut orders = Orders::new(Settings { period_ms: 100 });
        let _ = orders.due(0);
        orders.answered(CFG, 0x08, false);
        let bytes = orders.due(1).unwrap();
        assert_eq!(bytes[2..4], [CFG, 0x8a]);
        // Key 0x30210001 (CFG-RATE-MEAS) and its value, little endian (u-blox F9 interface description).
        assert!(bytes.windows(6).any(|part| part == [0x01, 0x00, 0x21, 0x30, 100, 0]), "{bytes:x?}");
        orders.answered(CFG, 0x01, false); // the answer to an order that nobody waits for any more
        assert_eq!(orders.due(2 * SECOND), Some(bytes));
        for _ in 0..3 {
            orders.answered(CFG, 0x8a, false);
        }
        assert!(orders.due(9 * SECOND).is_none());
        assert_eq!(orders.refused(), 2);
    }

    #[test]
    fn receiver_without_the_other_ports_is_set_up_all_the_same() {
        let mut orders = Orders::new(Settings { period_ms: 100 });
        let _ = orders.due(0);
        orders.answered(CFG, 0x08, false);
        let _ = orders.due(1);
        // A u-blox M10 has neither USB nor a second serial port.
        orders.answered(CFG, 0x8a, true);
        assert!(!orders.are_granted());
        orders.answered(CFG, 0x8a, false);
        orders.answered(CFG, 0x8a, false);
        assert!(orders.are_granted() && orders.due(9 * SECOND).is_none());
        assert_eq!(orders.refused(), 1, "the older order alone");
    }
}
