//! The way to the simulator.

use std::net::{SocketAddr, UdpSocket};
use std::time::Duration;

use bateleur_messages::frame::Decoder;
use bateleur_messages::hil::{Actuators, Packet};
use bateleur_messages::{Custom, Range, RawAnalog, RawGps, ServoTimers};

/// How long an answer is waited for before it is asked for again.
const PATIENCE: Duration = Duration::from_millis(500);
/// Times that it is asked for.
const TRIES: u32 = 4;

/// The sensors at one time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Answer {
    /// Inertial, magnetic and pressure sensors.
    pub analog: RawAnalog,
    /// A fix, where one came in.
    pub gps: Option<RawGps>,
    /// Sticks and voltages.
    pub custom: Option<Custom>,
    /// A distance to the ground, where there is one.
    pub range: Option<Range>,
}

/// A simulator in its native frames.
#[derive(Debug)]
pub struct Simulator {
    socket: UdpSocket,
    sequence: u64,
}

impl Simulator {
    /// The one at `address`.
    ///
    /// # Errors
    /// The system's answer.
    pub fn new(address: SocketAddr) -> std::io::Result<Self> {
        let socket = UdpSocket::bind(if address.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" })?;
        socket.connect(address)?;
        socket.set_read_timeout(Some(PATIENCE))?;
        Ok(Self { socket, sequence: 0 })
    }

    /// Lets the aircraft fly to `module_ns` with these actuators; `None` if no answer for that time came.
    pub fn ask(&mut self, module_ns: u64, timers: &ServoTimers) -> Option<Answer> {
        self.sequence += 1;
        let mut question = Vec::with_capacity(64);
        Packet::Actuators(Actuators::new(module_ns, self.sequence, timers)).write(&mut question);
        for _ in 0..TRIES {
            self.socket.send(&question).ok()?;
            let mut bytes = [0; 2_048];
            while let Ok(length) = self.socket.recv(&mut bytes) {
                if let Some(answer) = answer(&bytes[..length], module_ns) {
                    return Some(answer);
                }
            }
        }
        None
    }
}

/// What a datagram says of `module_ns`.
fn answer(bytes: &[u8], module_ns: u64) -> Option<Answer> {
    let (mut analog, mut gps, mut custom, mut range) = (None, None, None, None);
    for frame in Decoder::new().extend(bytes) {
        match Packet::of(&frame) {
            Ok(Packet::Analog(sensors)) => analog = Some(sensors),
            Ok(Packet::Gps(fix)) => gps = Some(fix),
            Ok(Packet::Custom(sticks)) => custom = Some(sticks),
            Ok(Packet::Range(distance)) => range = Some(distance),
            _ => {}
        }
    }
    let analog = analog.filter(|analog| analog.measured_ns == module_ns)?;
    Some(Answer { analog, gps, custom, range })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn datagram(measured_ns: u64) -> Vec<u8> {
        let mut bytes = Vec::new();
        Packet::Analog(RawAnalog { measured_ns, ..RawAnalog::default() }).write(&mut bytes);
        Packet::Gps(RawGps { measured_ns: 3, ..RawGps::default() }).write(&mut bytes);
        Packet::Range(Range { measured_ns: 4, ..Range::default() }).write(&mut bytes);
        bytes
    }

    #[test]
    fn an_answer_for_another_time_and_garbage_are_passed_over() {
        let there = UdpSocket::bind("127.0.0.1:0").unwrap();
        let mut simulator = Simulator::new(there.local_addr().unwrap()).unwrap();
        let answering = std::thread::spawn(move || {
            let mut bytes = [0; 512];
            let (_, from) = there.recv_from(&mut bytes).unwrap();
            for answer in [b"garbage".to_vec(), datagram(19), datagram(20)] {
                there.send_to(&answer, from).unwrap();
            }
        });
        let answer = simulator.ask(20, &ServoTimers::default()).unwrap();
        assert_eq!(
            (
                answer.analog.measured_ns,
                answer.gps.unwrap().measured_ns,
                answer.range.unwrap().measured_ns,
                answer.custom
            ),
            (20, 3, 4, None)
        );
        answering.join().unwrap();
    }
}
