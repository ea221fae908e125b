//! How much of its stack a process has used: a stack is zeros until something was written there.
//!
//! A little of one stack is looked at in each window, so that nobody notices it: a kilobyte from its lower end upwards. What is found is
//! the greatest depth so far, apart from frames of which nothing but zeros is left.
#![allow(unsafe_code)] // reads the stacks of threads that sleep

use std::sync::atomic::{AtomicUsize, Ordering};

/// Words that are looked at in a window.
const WORDS: usize = 128;
const WORD: usize = size_of::<usize>();

/// Where a thread's stack lies. Empty: not known.
#[derive(Debug, Default)]
pub(crate) struct Place {
    low: AtomicUsize,
    top: AtomicUsize,
}

impl Place {
    /// Notes the stack of the calling thread, which has the guard page below it. Its lower end; 0: not known.
    pub(crate) fn note_own(&self) -> usize {
        // SAFETY: the attributes are filled in by the first call, read by the second and freed by the third.
        let (low, bytes) = unsafe {
            let mut attributes = std::mem::zeroed();
            if libc::pthread_getattr_np(libc::pthread_self(), &raw mut attributes) != 0 {
                return 0;
            }
            let (mut low, mut bytes) = (std::ptr::null_mut(), 0);
            let found = libc::pthread_attr_getstack(&raw const attributes, &raw mut low, &raw mut bytes);
            libc::pthread_attr_destroy(&raw mut attributes);
            if found != 0 {
                return 0;
            }
            (low as usize, bytes)
        };
        self.top.store(low + bytes, Ordering::Relaxed);
        let low = low.next_multiple_of(WORD);
        self.low.store(low, Ordering::Release);
        low
    }

    /// The thread is about to end: its stack may be gone.
    pub(crate) fn forget(&self) {
        self.low.store(0, Ordering::Relaxed);
        self.top.store(0, Ordering::Relaxed);
    }

    fn range(&self) -> (usize, usize) {
        (self.low.load(Ordering::Acquire), self.top.load(Ordering::Relaxed))
    }
}

/// Looks at one stack after the other.
#[derive(Debug, Default)]
pub(crate) struct Looker {
    place: usize,
    /// The next address; 0: the stack's lower end.
    at: usize,
}

impl Looker {
    /// Goes on by a little. `stacks`: those of all processes, whose threads sleep; bytes that the one with the given number has used so
    /// far, when that is known. A `used` that was found before is not looked at again.
    pub(crate) fn look<'s>(
        &mut self,
        stacks: usize,
        stack: impl FnOnce(usize) -> (&'s Place, u32),
    ) -> Option<(usize, u32)> {
        let place = self.place.checked_rem(stacks)?;
        let (stack, used) = stack(place);
        let (low, top) = stack.range();
        let known = top.saturating_sub(used as usize);
        let from = self.at.max(low);
        let until = known.min(from.saturating_add(WORDS * WORD));
        // SAFETY: words of a stack that is mapped as long as its place is known; its thread sleeps.
        let is_used = |at: &usize| unsafe { (*at as *const usize).read_volatile() } != 0;
        let found = if from < until { (from..until).step_by(WORD).find(is_used) } else { None };
        self.at = until;
        if found.is_some() || until >= known || low == 0 {
            (self.place, self.at) = (place + 1, 0);
        }
        found.map(|at| (place, (top - at) as u32))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[inline(never)]
    fn deep(depth: usize) -> usize {
        let frame = std::hint::black_box([depth + 1; 128]);
        if depth == 0 { frame[7] } else { deep(depth - 1) + frame[9] }
    }

    #[test]
    fn depth_that_a_thread_has_reached_is_found_after_it_came_back() {
        let places = [Place::default(), Place::default()];
        let (done, is_done) = std::sync::mpsc::channel();
        std::thread::scope(|scope| {
            let end = std::sync::Arc::new(std::sync::Barrier::new(3));
            for (place, depth) in places.iter().zip([0, 100]) {
                let (end, done) = (end.clone(), done.clone());
                let thread = std::thread::Builder::new().stack_size(512 << 10);
                let body = move || {
                    place.note_own();
                    std::hint::black_box(deep(depth));
                    done.send(()).unwrap();
                    end.wait();
                };
                thread.spawn_scoped(scope, body).unwrap();
            }
            (0..2).for_each(|_| is_done.recv().unwrap());
            let (mut looker, mut used) = (Looker::default(), [0_u32; 2]);
            for _ in 0..3 * 2 * 512 {
                let found = looker.look(2, |place| (&places[place], used[place]));
                if let Some((place, bytes)) = found {
                    used[place] = bytes;
                }
            }
            assert!(used[0] > 0 && used[1] > used[0] + 90 * 1024, "{used:?}");
            assert!(used[1] < 400 << 10, "{used:?}");
            places.iter().for_each(Place::forget);
            assert_eq!(looker.look(2, |place| (&places[place], 0)), None, "nobody is there");
            end.wait();
        });
    }
}
