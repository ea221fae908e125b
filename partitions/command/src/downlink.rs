//! From the functions to the ground: telemetry waits here for its turn on the line.

use std::collections::VecDeque;

use bateleur_messages::TelemetryMessage;
use bateleur_messages::frame;
use zerocopy::{FromBytes, FromZeros, Immutable, IntoBytes, KnownLayout};

use crate::Paced;

/// Messages that may wait, most. All telemetry of two seconds is 26 messages; older than that is of no use to anybody.
pub const BACKLOG: usize = 64;
/// Letter of an acknowledgement, which the ground waits for: it is dropped last.
const ACKNOWLEDGE: u8 = b'K';

/// Waiting telemetry, paced to what the line can carry.
#[derive(Debug)]
pub struct Downlink {
    waiting: VecDeque<TelemetryMessage>,
    dropped: u64,
    line: Paced,
}

/// Bytes that are due or of a frame that was begun, most: less than a burst and the longest frame.
const BYTES: usize = 1024;

/// A downlink as plain data. Every bit pattern is one.
#[derive(Debug, Clone, Copy, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct KeptDownlink {
    credit: u64,
    last_ns: u64,
    dropped: u64,
    waiting_count: u32,
    bytes_count: u32,
    bytes: [u8; BYTES],
    waiting: [TelemetryMessage; BACKLOG],
}

impl Downlink {
    /// Towards a line of `baud` symbols a second.
    pub fn new(baud: u32) -> Self {
        Self { waiting: VecDeque::with_capacity(BACKLOG), dropped: 0, line: Paced::new(baud) }
    }

    /// Goes on where the incarnation before stood.
    pub fn resume(&mut self, kept: &KeptDownlink) {
        let (waiting, bytes) = (kept.waiting_count as usize, kept.bytes_count as usize);
        let (Some(waiting), Some(bytes)) = (kept.waiting.get(..waiting), kept.bytes.get(..bytes)) else {
            return;
        };
        self.waiting.extend(waiting);
        self.dropped = kept.dropped;
        self.line.resume(bytes, kept.credit, kept.last_ns);
    }

    /// What its successor goes on from.
    pub fn kept(&self) -> KeptDownlink {
        let (bytes, credit, last_ns) = self.line.state();
        let mut kept = KeptDownlink {
            credit,
            last_ns,
            dropped: self.dropped,
            waiting_count: self.waiting.len() as u32,
            bytes_count: bytes.len().min(BYTES) as u32, // room and one frame at most
            ..KeptDownlink::new_zeroed()
        };
        kept.waiting.iter_mut().zip(&self.waiting).for_each(|(place, message)| *place = *message);
        kept.bytes.iter_mut().zip(bytes).for_each(|(place, byte)| *place = *byte);
        kept
    }

    /// Takes a message. Where too many wait, the oldest is dropped.
    pub fn push(&mut self, message: TelemetryMessage) {
        if self.waiting.len() == BACKLOG {
            let oldest = self.waiting.iter().position(|waiting| waiting.letter != ACKNOWLEDGE);
            self.waiting.remove(oldest.unwrap_or(0));
            self.dropped += 1;
        }
        self.waiting.push_back(message);
    }

    /// Messages dropped so far.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }

    /// The bytes that may go out at module time `now_ns`.
    pub fn due(&mut self, now_ns: u64) -> &[u8] {
        self.line.due(now_ns, |bytes| {
            let Some(message) = self.waiting.pop_front() else { return false };
            frame::encode(message.letter, message.bytes(), bytes);
            true
        })
    }

    /// The line took the first `count` of the bytes that were due.
    pub fn sent(&mut self, count: usize) {
        self.line.sent(count);
    }

    /// The line is gone: see [`Paced::cut`].
    pub fn cut(&mut self) {
        self.line.cut();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::paced::BURST_BYTES;
    use bateleur_messages::frame::Decoder;

    const CYCLE: u64 = 20_000_000;

    fn message(letter: u8, number: u8) -> TelemetryMessage {
        let mut message = TelemetryMessage { letter, length: 100, ..TelemetryMessage::default() };
        message.data[0] = number;
        message
    }

    /// The other end of a line that takes `at_most` bytes a window.
    struct Ground {
        decoder: Decoder,
        window: u64,
        at_most: usize,
    }

    impl Ground {
        fn new(at_most: usize) -> Self {
            Self { decoder: Decoder::new(), window: 0, at_most }
        }

        /// Numbers of the frames that it hears in so many windows.
        fn hears(&mut self, downlink: &mut Downlink, windows: u64) -> Vec<u8> {
            let mut heard = Vec::new();
            for _ in 0..windows {
                self.window += 1;
                let due = downlink.due(self.window * CYCLE);
                let taken = due[..due.len().min(self.at_most)].to_vec();
                downlink.sent(taken.len());
                heard.extend(self.decoder.extend(&taken).map(|frame| frame.data[0]));
            }
            heard
        }
    }

    #[test]
    fn telemetry_goes_out_in_order_at_the_pace_of_the_line() {
        let mut downlink = Downlink::new(57_600);
        (0..20).for_each(|number| downlink.push(message(b'P', number)));
        // 105 bytes each; 115 a window.
        let mut ground = Ground::new(usize::MAX);
        assert_eq!(ground.hears(&mut downlink, 10), (0..10).collect::<Vec<_>>());
        assert_eq!(ground.hears(&mut downlink, 20), (10..20).collect::<Vec<_>>());
    }

    #[test]
    fn a_line_that_takes_little_gets_the_frames_in_pieces() {
        let mut downlink = Downlink::new(57_600);
        (0..3).for_each(|number| downlink.push(message(b'P', number)));
        assert_eq!(Ground::new(7).hears(&mut downlink, 100), [0, 1, 2]);
    }

    #[test]
    fn a_line_that_takes_nothing_costs_the_oldest_telemetry_and_no_memory() {
        let mut downlink = Downlink::new(57_600);
        for number in 0..200 {
            downlink.push(message(b'P', number));
        }
        assert_eq!(downlink.dropped(), 200 - BACKLOG as u64);
        for window in 0..1_000 {
            assert!(downlink.due(window * CYCLE).len() <= BURST_BYTES as usize);
        }
        // What it keeps for a successor holds all of it, and the line that takes again gets the newest, each once.
        let mut successor = Downlink::new(57_600);
        successor.resume(&downlink.kept());
        let newest: Vec<u8> = (200 - BACKLOG as u8..200).collect();
        for downlink in [&mut downlink, &mut successor] {
            let mut ground = Ground { window: 1_000, ..Ground::new(usize::MAX) };
            assert_eq!(ground.hears(downlink, 200), newest);
        }
    }

    #[test]
    fn answers_to_the_ground_outlive_telemetry() {
        let mut downlink = Downlink::new(57_600);
        downlink.push(message(b'K', 1));
        (0..200).for_each(|_| downlink.push(message(b'P', 0)));
        assert_eq!(Ground::new(usize::MAX).hears(&mut downlink, 2)[0], 1);
        (0..200).for_each(|_| downlink.push(message(b'K', 2)));
        assert_eq!(downlink.waiting.len(), BACKLOG);
    }

    #[test]
    fn a_frame_that_was_cut_is_not_finished_on_the_next_line() {
        let mut downlink = Downlink::new(57_600);
        (0..3).for_each(|number| downlink.push(message(b'P', number)));
        let mut ground = Ground::new(50);
        assert!(ground.hears(&mut downlink, 1).is_empty());
        downlink.cut();
        ground.at_most = usize::MAX;
        assert_eq!(ground.hears(&mut downlink, 5), [2]);
    }
}
