//! Messages of three queues become one: each message that two replicas sent.
//!
//! Messages of replicas that are right need not be the same: each has the time at which it was made. What two say most alike counts, byte by
//! byte. A message may come a window later than that of another replica, and what nobody else sends until then is dropped, so that one that
//! babbles or loses messages is in step again.

use crate::REPLICAS;

/// Windows in a row in which others sent messages and a replica sent none: nobody waits for it any more.
const AWAY: u32 = 3;

/// A message that waits for those of the other replicas.
#[derive(Debug)]
struct Waiting {
    bytes: Vec<u8>,
    /// It came in an earlier window.
    is_old: bool,
}

/// Three queues on their way to one.
#[derive(Debug, Default)]
pub struct Merger {
    waiting: [Vec<Waiting>; REPLICAS],
    /// Windows in a row in which only others sent messages.
    quiet: [u32; REPLICAS],
}

impl Merger {
    /// Takes what each replica sent since the last window; what is to be handed on. `rank`: of each replica, the lowest speaks first.
    pub fn take<R: Ord>(
        &mut self,
        sent: [Vec<Vec<u8>>; REPLICAS],
        rank: impl Fn(usize) -> R,
    ) -> Vec<Vec<u8>> {
        let anybody = sent.iter().any(|messages| !messages.is_empty());
        for ((waiting, quiet), messages) in self.waiting.iter_mut().zip(&mut self.quiet).zip(sent) {
            *quiet = match messages.is_empty() {
                true => *quiet + u32::from(anybody),
                false => 0,
            };
            waiting.iter_mut().for_each(|message| message.is_old = true);
            waiting.extend(messages.into_iter().map(|bytes| Waiting { bytes, is_old: false }));
        }
        let mut decided = Vec::new();
        loop {
            let mut present: Vec<usize> =
                (0..REPLICAS).filter(|&replica| !self.waiting[replica].is_empty()).collect();
            present.sort_by_key(|&replica| rank(replica));
            match present.as_slice() {
                [] => return decided,
                &[only] => {
                    let is_left = (0..REPLICAS).all(|other| other == only || self.quiet[other] >= AWAY);
                    if !is_left && !self.waiting[only][0].is_old {
                        return decided;
                    }
                    let message = self.waiting[only].remove(0);
                    decided.extend(is_left.then_some(message.bytes));
                }
                several => {
                    let speaker = self.speaker(several);
                    for &replica in several {
                        let message = self.waiting[replica].remove(0);
                        decided.extend((replica == speaker).then_some(message.bytes));
                    }
                }
            }
        }
    }

    /// Of the two whose next messages are most alike the first.
    fn speaker(&self, several: &[usize]) -> usize {
        let next = |replica: usize| self.waiting[replica][0].bytes.as_slice();
        let pairs = several.iter().enumerate().flat_map(|(place, &one)| {
            several[place + 1..].iter().map(move |&other| (distance(next(one), next(other)), one))
        });
        pairs.min_by_key(|(distance, _)| *distance).map_or(several[0], |(_, one)| one)
    }
}

/// Bytes that differ.
fn distance(one: &[u8], other: &[u8]) -> usize {
    let unequal = one.iter().zip(other).filter(|(one, other)| one != other).count();
    unequal + one.len().abs_diff(other.len())
}
