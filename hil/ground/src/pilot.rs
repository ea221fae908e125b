//! The safety pilot, as the ground station reaches him.

use bateleur_messages::frame::Decoder;
use bateleur_messages::hil::{Packet, PilotOrder};
use std::io;
use std::net::{SocketAddr, UdpSocket};
use std::time::Duration;

/// How long an echo may take before the order is sent again. Real time, not the mission's: it is the simulator's
/// process that answers, and it does so in microseconds unless the machine is busy.
const PATIENCE: Duration = Duration::from_millis(50);
/// Sendings of one order before the caller gets its time back.
const TRIES: usize = 4;

/// Whoever holds the sticks at the field.
pub trait Pilot {
    /// Calls an order over to him. It may be called again while it is not confirmed.
    fn order(&mut self, order: PilotOrder);

    /// Whether he has understood the last order. One who cannot answer is believed to.
    fn confirmed(&mut self) -> bool {
        true
    }
}

/// The simulated safety pilot, over UDP; the simulator echoes what it understood.
#[derive(Debug)]
pub struct UdpPilot {
    socket: UdpSocket,
    confirmed: bool,
}

impl UdpPilot {
    /// A line to the simulator at `address`.
    ///
    /// # Errors
    /// When no socket can be had.
    pub fn new(address: SocketAddr) -> io::Result<Self> {
        let any: SocketAddr =
            if address.is_ipv4() { ([0, 0, 0, 0], 0).into() } else { ([0_u16; 8], 0).into() };
        let socket = UdpSocket::bind(any)?;
        socket.connect(address)?;
        socket.set_read_timeout(Some(PATIENCE))?;
        Ok(Self { socket, confirmed: false })
    }

    fn attempt(&self, bytes: &[u8], order: &PilotOrder) -> bool {
        let mut incoming = [0; 512];
        if self.socket.send(bytes).is_err() {
            return false;
        }
        match self.socket.recv(&mut incoming) {
            Ok(length) => holds(&incoming[..length], order),
            Err(_) => false,
        }
    }
}

fn holds(datagram: &[u8], order: &PilotOrder) -> bool {
    Decoder::new().extend(datagram).any(|frame| Packet::of(&frame) == Ok(Packet::Pilot(*order)))
}

impl Pilot for UdpPilot {
    /// Sends the order and waits for its echo, at most 0.2 s: so it stands in order with the packets of the flight
    /// computer, and in virtual time the flight stays the same for the same seed.
    fn order(&mut self, order: PilotOrder) {
        let mut bytes = Vec::new();
        Packet::Pilot(order).write(&mut bytes);
        self.confirmed = (0..TRIES).any(|_| self.attempt(&bytes, &order));
    }

    fn confirmed(&mut self) -> bool {
        self.confirmed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_messages::hil::PILOT_TAKE_OFF;

    #[test]
    fn order_is_repeated_until_its_echo_comes() {
        let simulator = UdpSocket::bind("127.0.0.1:0").unwrap();
        let mut pilot = UdpPilot::new(simulator.local_addr().unwrap()).unwrap();
        let deaf_once = std::thread::spawn(move || {
            let mut bytes = [0; 512];
            simulator.recv_from(&mut bytes).unwrap();
            let (length, sender) = simulator.recv_from(&mut bytes).unwrap();
            simulator.send_to(&bytes[..length], sender).unwrap();
        });
        pilot.order(PilotOrder { order: PILOT_TAKE_OFF, reserved: 0 });
        assert!(pilot.confirmed());
        deaf_once.join().unwrap();
    }

    #[test]
    fn absent_simulator_is_not_believed() {
        let nobody = UdpSocket::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let mut pilot = UdpPilot::new(nobody).unwrap();
        pilot.order(PilotOrder { order: PILOT_TAKE_OFF, reserved: 0 });
        assert!(!pilot.confirmed());
    }
}
