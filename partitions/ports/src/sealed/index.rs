//! What a queue's destination says of itself, in memory that it alone may write: which of its incarnations receives, and what it has
//! taken.

use bateleur_contract::sealed::{LINE, WORD};

use super::memory::Words;
use super::sync::{AtomicU64, Ordering};

/// The word with the incarnation that receives, plus one; 0: nobody does. The executive writes 0 there when that one is dead.
const ATTACHED: usize = 0;
/// The word with the number of the last message that was taken.
const TAKEN: usize = LINE / WORD;

/// See the module's head.
pub(crate) struct Index<M>(pub(crate) M);

impl<M: Words> Index<M> {
    /// The destination's: it has taken all up to `taken`.
    pub(crate) fn tell(&self, incarnation: u32, taken: u64) {
        self.word(TAKEN).store(taken, Ordering::Release);
        // What a wild write has left here stands no longer than until the next look.
        self.word(ATTACHED).store(u64::from(incarnation) + 1, Ordering::Release);
    }

    /// The source's: messages that wait when `newest` is the last one; `None`: nobody receives. Any number may come out.
    pub(crate) fn waiting(&self, newest: u64) -> Option<u64> {
        let attached = self.word(ATTACHED).load(Ordering::Acquire) != 0;
        attached.then(|| newest.wrapping_sub(self.word(TAKEN).load(Ordering::Acquire)))
    }

    fn word(&self, place: usize) -> &AtomicU64 {
        &self.0.words()[place]
    }
}
