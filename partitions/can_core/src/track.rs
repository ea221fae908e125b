//! What the numbers of datagrams say about those that did not come.

/// Datagrams back that one can be late and still be told from a repetition.
const WINDOW: u32 = 64;

/// What became of the datagrams of one sender.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, serde::Serialize)]
pub struct Tally {
    /// Datagrams with frames that were taken.
    pub datagrams: u64,
    /// Frames in them.
    pub frames: u64,
    /// Datagrams that are missing.
    pub lost_datagrams: u64,
    /// Frames in those.
    pub lost_frames: u64,
    /// Datagrams that came after a later one; taken all the same.
    pub late: u64,
    /// Datagrams that came twice, or too late to be told from such; thrown away.
    pub repeated: u64,
}

impl std::ops::AddAssign for Tally {
    fn add_assign(&mut self, other: Self) {
        self.datagrams += other.datagrams;
        self.frames += other.frames;
        self.lost_datagrams += other.lost_datagrams;
        self.lost_frames += other.lost_frames;
        self.late += other.late;
        self.repeated += other.repeated;
    }
}

/// Follows the numbers of one session.
#[derive(Debug, Clone, Copy, Default)]
pub struct Track {
    /// The number expected next; `None` if nothing has come.
    next: Option<u32>,
    /// Number of the frame expected next.
    next_frame: u32,
    /// Bit n: the datagram n + 1 before the expected one has come.
    seen: u64,
}

impl Track {
    /// Notes a datagram with `frames` frames. False: it is a repetition, not to be taken.
    pub fn note(&mut self, sequence: u32, first_frame: u32, frames: u32, tally: &mut Tally) -> bool {
        let Some(next) = self.next else {
            (self.next, self.next_frame, self.seen) =
                (Some(sequence.wrapping_add(1)), first_frame.wrapping_add(frames), 1);
            tally.datagrams += 1;
            tally.frames += u64::from(frames);
            return true;
        };
        let ahead = sequence.wrapping_sub(next);
        if ahead < 1 << 31 {
            self.skip(ahead, first_frame, tally);
            self.seen = self.seen << 1 | 1;
            (self.next, self.next_frame) = (Some(sequence.wrapping_add(1)), first_frame.wrapping_add(frames));
        } else {
            let back = next.wrapping_sub(sequence); // 1 and more
            let bit = 1_u64.checked_shl(back - 1).filter(|_| back <= WINDOW).unwrap_or(0);
            if bit == 0 || self.seen & bit != 0 {
                tally.repeated += 1;
                return false;
            }
            self.seen |= bit;
            tally.late += 1;
            // It had been counted as lost, unless it came before what was heard first.
            tally.lost_datagrams = tally.lost_datagrams.saturating_sub(1);
            tally.lost_frames = tally.lost_frames.saturating_sub(frames.into());
        }
        tally.datagrams += 1;
        tally.frames += u64::from(frames);
        true
    }

    /// As [`Track::note`], of a sender whose numbers have one byte and who does not number frames: it is the nearest that ends so.
    pub fn note_byte(&mut self, sequence: u8, frames: u32, tally: &mut Tally) -> bool {
        let next = self.next.unwrap_or(sequence.into());
        let ahead = sequence.wrapping_sub(next as u8).cast_signed();
        self.note(next.wrapping_add_signed(ahead.into()), self.next_frame, frames, tally)
    }

    /// The sender says which numbers it will give next: what lies before is missing.
    pub fn hear_of(&mut self, next: u32, next_frame: u32, tally: &mut Tally) {
        let Some(expected) = self.next else {
            // What it sent before it was met is not missed.
            (self.next, self.next_frame, self.seen) = (Some(next), next_frame, u64::MAX);
            return;
        };
        let ahead = next.wrapping_sub(expected);
        if (1..1 << 31).contains(&ahead) {
            self.skip(ahead, next_frame, tally);
            (self.next, self.next_frame) = (Some(next), next_frame);
        }
    }

    fn skip(&mut self, datagrams: u32, first_frame: u32, tally: &mut Tally) {
        self.seen = self.seen.checked_shl(datagrams).unwrap_or(0);
        if datagrams > 0 {
            tally.lost_datagrams += u64::from(datagrams);
            let frames = first_frame.wrapping_sub(self.next_frame);
            // A sender whose numbers make no sense is not believed about frames.
            tally.lost_frames += if frames < 1 << 31 { u64::from(frames) } else { 0 };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Ten frames each; the first datagram has this number.
    fn note(track: &mut Track, tally: &mut Tally, first: u32, number: u32) -> bool {
        track.note(first.wrapping_add(number), number.wrapping_mul(10), 10, tally)
    }

    #[test]
    fn a_gap_is_counted_in_datagrams_and_in_frames_over_the_wrap_of_numbers_too() {
        let (mut track, mut tally) = (Track::default(), Tally::default());
        for number in [0, 1, 4, 5] {
            assert!(note(&mut track, &mut tally, u32::MAX - 1, number));
        }
        assert_eq!(
            tally,
            Tally { datagrams: 4, frames: 40, lost_datagrams: 2, lost_frames: 20, ..Tally::default() }
        );
    }

    #[test]
    fn a_late_datagram_is_taken_and_no_longer_lost_and_a_repetition_is_thrown_away() {
        let (mut track, mut tally) = (Track::default(), Tally::default());
        assert!([0, 2, 1].iter().all(|number| note(&mut track, &mut tally, 7, *number)));
        assert!([0, 1, 2].iter().all(|number| !note(&mut track, &mut tally, 7, *number)));
        assert_eq!(tally, Tally { datagrams: 3, frames: 30, late: 1, repeated: 3, ..Tally::default() });
    }

    #[test]
    fn losses_at_the_end_show_when_the_sender_says_how_far_it_is() {
        let (mut track, mut tally) = (Track::default(), Tally::default());
        track.hear_of(100, 1_000, &mut tally);
        assert!(track.note(100, 1_000, 5, &mut tally));
        track.hear_of(103, 1_015, &mut tally);
        track.hear_of(103, 1_015, &mut tally);
        assert_eq!((tally.lost_datagrams, tally.lost_frames), (2, 10));
        assert!(track.note(101, 1_005, 5, &mut tally), "it was on its way");
        assert_eq!((tally.lost_datagrams, tally.lost_frames, tally.late), (1, 5, 1));
    }

    proptest! {
        #[test]
        fn whatever_comes_in_whatever_order_each_datagram_is_taken_once_at_most(
            numbers in proptest::collection::vec(0_u32..100, 1..300), first: u32,
        ) {
            let (mut track, mut tally) = (Track::default(), Tally::default());
            let mut taken = std::collections::BTreeSet::new();
            for number in &numbers {
                if note(&mut track, &mut tally, first, *number) {
                    prop_assert!(taken.insert(*number), "twice");
                }
            }
            prop_assert_eq!(tally.datagrams, taken.len() as u64);
            prop_assert_eq!(tally.datagrams + tally.repeated, numbers.len() as u64);
        }

        #[test]
        fn in_order_with_gaps_what_is_not_taken_is_lost(kept in proptest::collection::vec(any::<bool>(), 1..300), first: u32) {
            let (mut track, mut tally) = (Track::default(), Tally::default());
            track.hear_of(first, 0, &mut tally);
            for (number, _) in kept.iter().enumerate().filter(|(_, kept)| **kept) {
                prop_assert!(note(&mut track, &mut tally, first, number as u32));
            }
            track.hear_of(first.wrapping_add(kept.len() as u32), 10 * kept.len() as u32, &mut tally);
            prop_assert_eq!(tally.datagrams + tally.lost_datagrams, kept.len() as u64);
            prop_assert_eq!(tally.frames + tally.lost_frames, 10 * kept.len() as u64);
        }
    }
}
