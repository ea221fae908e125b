//! What a serial line can carry, and when: bytes leave at its pace, messages whole and in order, whichever language they are
//! in.
//!
//! A line that takes bytes faster (a pseudo-terminal) gets no more: the same flight then sends the same bytes in the same
//! windows on any device.

/// Bytes sent at once, most, after the line was idle: little enough that the system's own buffer (4 KiB) never fills.
pub(crate) const BURST_BYTES: u64 = 512;
/// One byte on the line: a start bit, eight bits, a stop bit.
const BITS_A_BYTE: u64 = 10;
const SECOND_NS: u64 = 1_000_000_000;

/// Bytes on their way to the line.
#[derive(Debug)]
pub struct Paced {
    baud: u64,
    bytes: Vec<u8>,
    /// Bits that may be sent now, times [`SECOND_NS`].
    credit: u64,
    last_ns: u64,
}

impl Paced {
    /// For a line of `baud` symbols a second.
    pub fn new(baud: u32) -> Self {
        Self { baud: u64::from(baud), bytes: Vec::with_capacity(1024), credit: 0, last_ns: 0 }
    }

    /// The bytes that may go out at module time `now_ns`. `add` appends the next message, or says by false that there is
    /// none: messages stay where they wait until their turn, so that a slow line loses the oldest ones and not the latest.
    pub fn due(&mut self, now_ns: u64, mut add: impl FnMut(&mut Vec<u8>) -> bool) -> &[u8] {
        let elapsed_ns = now_ns.saturating_sub(self.last_ns).min(SECOND_NS);
        self.last_ns = now_ns;
        let most = BURST_BYTES * BITS_A_BYTE * SECOND_NS;
        self.credit = self.credit.saturating_add(elapsed_ns.saturating_mul(self.baud)).min(most);
        let room = (self.credit / (BITS_A_BYTE * SECOND_NS)) as usize; // BURST_BYTES at most
        while self.bytes.len() < room && add(&mut self.bytes) {}
        &self.bytes[..room.min(self.bytes.len())]
    }

    /// The line took the first `count` of the bytes that were due.
    pub fn sent(&mut self, count: usize) {
        let count = count.min(self.bytes.len());
        self.bytes.drain(..count);
        self.credit = self.credit.saturating_sub(count as u64 * BITS_A_BYTE * SECOND_NS);
    }

    /// The line is gone: what was sent in part will never be whole. The next message, if it was begun, goes with it.
    pub fn cut(&mut self) {
        self.bytes.clear();
    }

    /// What its successor goes on from: the bytes that wait, the credit and the instant of the last look.
    pub(crate) fn state(&self) -> (&[u8], u64, u64) {
        (&self.bytes, self.credit, self.last_ns)
    }

    /// Goes on where another one stood.
    pub(crate) fn resume(&mut self, bytes: &[u8], credit: u64, last_ns: u64) {
        self.bytes.extend_from_slice(bytes);
        // More than the line can take at once there never is.
        self.credit = credit.min(BURST_BYTES * BITS_A_BYTE * SECOND_NS);
        self.last_ns = last_ns;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Encoding, Rates, Setup, Station};
    use bateleur_mavlink::common::MavSeverity;
    use bateleur_mavlink::{Decoder, Runway};

    #[test]
    fn messages_leave_whole_and_no_faster_than_the_line() {
        let mut station = Station::new(&Setup {
            system: 1,
            runway: Runway::default(),
            functions: 0,
            encoding: Encoding::Bytes,
            rates: Rates::default(),
        });
        let (mut paced, mut decoder) = (Paced::new(9_600), Decoder::new());
        (0..100).for_each(|number| station.tell(MavSeverity::MAV_SEVERITY_INFO, &format!("text {number}")));
        let mut add =
            |bytes: &mut Vec<u8>| station.next_message().map(|message| bytes.extend(message)).is_some();
        let (mut bytes, mut messages) = (0, 0);
        for window in 1..=50 {
            let due = paced.due(window * 20_000_000, &mut add);
            let taken = due[..due.len().min(7)].to_vec();
            paced.sent(taken.len());
            bytes += taken.len();
            decoder.stream(&taken, |_| messages += 1);
        }
        assert_eq!(bytes, 50 * 7, "the line takes seven bytes a window");
        assert!(messages > 10 && decoder.refused() == Default::default());
        let waiting = paced.due(60_000_000_000, &mut add).len();
        assert!(waiting <= BURST_BYTES as usize);
    }
}
