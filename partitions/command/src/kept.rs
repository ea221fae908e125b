//! What outlives a warm restart: the frames that are on their way over the line, in both directions, and what has been
//! reported. So the ground hears no frame cut or twice, and no order is lost in the middle.

use bateleur_apex::serial::Presence;
use bateleur_messages::frame::DecoderState;
use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::downlink::KeptDownlink;
use crate::{Downlink, Silence, Uplink};

/// Plain data in a fixed size.
#[derive(Debug, Clone, Copy, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct Kept {
    uplink: DecoderState,
    downlink: KeptDownlink,
    /// Not zero: the device was reported missing.
    missing: u64,
    silence: [u64; 2],
}

impl Kept {
    /// What to keep.
    pub fn of(uplink: &Uplink, downlink: &Downlink, presence: &Presence, silence: &Silence) -> Self {
        Self {
            uplink: uplink.state(),
            downlink: downlink.kept(),
            missing: u64::from(presence.is_reported()),
            silence: silence.kept(),
        }
    }

    /// Hands it to those of the next incarnation. What does not make sense is forgotten.
    pub fn resume(
        &self,
        uplink: &mut Uplink,
        downlink: &mut Downlink,
        presence: &mut Presence,
        silence: &mut Silence,
    ) {
        silence.resume(self.silence);
        uplink.resume(&self.uplink);
        downlink.resume(&self.downlink);
        *presence = Presence::after(self.missing != 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Delivery;
    use bateleur_apex::serial::Change;
    use bateleur_messages::TelemetryMessage;
    use bateleur_messages::frame::encode;
    use bateleur_messages::ground::Order;

    const CYCLE: u64 = 20_000_000;

    struct Command {
        uplink: Uplink,
        downlink: Downlink,
        presence: Presence,
    }

    impl Command {
        fn new(kept: Option<&Kept>) -> Self {
            let (mut uplink, mut downlink) = (Uplink::new(), Downlink::new(57_600));
            let mut presence = Presence::default();
            if let Some(kept) = kept {
                kept.resume(&mut uplink, &mut downlink, &mut presence, &mut Silence::default());
            }
            Self { uplink, downlink, presence }
        }

        /// One window: takes what has come up and some telemetry; gives what goes down, and the orders.
        fn window(&mut self, number: u64, up: &[u8]) -> (Vec<u8>, Vec<Delivery>) {
            let orders = self.uplink.take(up);
            for place in 0..number % 3 {
                let mut message =
                    TelemetryMessage { letter: b'P', length: 90, ..TelemetryMessage::default() };
                message.data[0] = (number + place) as u8;
                self.downlink.push(message);
            }
            let mut due = self.downlink.due(number * CYCLE).to_vec();
            due.truncate(100); // the line takes no more at once
            self.downlink.sent(due.len());
            (due, orders)
        }

        fn kept(&self) -> Kept {
            Kept::of(&self.uplink, &self.downlink, &self.presence, &Silence::default())
        }
    }

    /// What the ground hears and is heard of in 60 windows, with a restart at the end of some of them.
    fn line(restarted: impl Fn(u64) -> bool) -> (Vec<Vec<u8>>, Vec<Delivery>) {
        let mut up = Vec::new();
        for on in [true, false, true] {
            let order = Order::Autopilot { on };
            encode(order.letter(), &order.data(), &mut up);
        }
        let mut command = Command::new(None);
        let (mut down, mut orders) = (Vec::new(), Vec::new());
        for number in 0..60 {
            let piece = up.get(number as usize..number as usize + 1).unwrap_or_default();
            let (bytes, some) = command.window(number, piece);
            down.push(bytes);
            orders.extend(some);
            if restarted(number) {
                command = Command::new(Some(&command.kept()));
            }
        }
        (down, orders)
    }

    #[test]
    fn warm_restart_after_any_window_is_not_heard_on_the_line() {
        let undisturbed = line(|_| false);
        assert_eq!(undisturbed.1.len(), 3);
        for at in 0..60 {
            assert_eq!(line(|number| number == at), undisturbed, "restarted after window {at}");
        }
        assert_eq!(line(|_| true), undisturbed, "restarted after each window");
    }

    #[test]
    fn device_that_was_reported_missing_is_not_reported_again_after_a_warm_restart() {
        let mut command = Command::new(None);
        assert_eq!(command.presence.failed(0), Some(Change::Lost));
        let mut again = Command::new(Some(&command.kept()));
        assert_eq!(again.presence.failed(CYCLE), None);
        assert_eq!(again.presence.opened(), Some(Change::Found));
    }

    #[test]
    fn retained_memory_full_of_noise_keeps_the_line_going() {
        for byte in [0x01, 0x3f, 0xa5, 0xff] {
            let noise = Kept::read_from_bytes(&vec![byte; size_of::<Kept>()]).unwrap();
            let mut command = Command::new(Some(&noise));
            let mut frame = Vec::new();
            encode(b'H', &[1], &mut frame);
            // The first may end what noise began.
            let heard = (1..5).filter(|number| !command.window(*number, &frame).1.is_empty()).count();
            assert!(heard >= 2, "{byte:#x}: {heard} orders");
        }
    }
}
