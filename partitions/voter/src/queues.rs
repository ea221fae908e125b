//! Messages of three queues become one: in each window as many as most replicas sent.
//!
//! Messages of replicas that are right need not be the same: each has the time at which it was made. Where two are, that is the message;
//! otherwise the first in rank speaks.

use crate::REPLICAS;

/// What is to be handed on of what each replica sent since the last window. `rank`: of each, the lowest speaks first.
pub fn merge<R: Ord>(sent: &[Vec<Vec<u8>>; REPLICAS], rank: impl Fn(usize) -> R) -> Vec<&[u8]> {
    let mut counts = sent.each_ref().map(Vec::len);
    counts.sort_unstable();
    let count = counts[REPLICAS / 2];
    // Whoever sent as many is asked first.
    let mut asked: Vec<usize> = (0..REPLICAS).collect();
    asked.sort_by_key(|&replica| (sent[replica].len() != count, rank(replica)));
    let nth = |replica: usize, place: usize| sent[replica].get(place).map(Vec::as_slice);
    let chosen = |place: usize| {
        let same = |&&replica: &&usize| {
            let own = nth(replica, place);
            own.is_some() && asked.iter().any(|&other| other != replica && nth(other, place) == own)
        };
        let speaker = asked.iter().find(same).or_else(|| asked.first())?;
        nth(*speaker, place)
    };
    (0..count).filter_map(chosen).collect()
}
