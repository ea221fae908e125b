//! Who runs instead of a process that sleeps where the scheduler does not know of it: at a lock of its own, or for a device.

use crate::partition::{Partition, Runner};
use crate::queues::ListId;

impl Partition {
    /// Whoever runs sleeps outside of services: it is passed over until [`Partition::take_back`], as if it were not ready.
    pub fn lend(&mut self) {
        match self.running() {
            Some(Runner::Process(id)) => {
                let Ok(place) = self.place(id) else { return };
                self.leave_ready(place);
                self.processes[place].lent = true;
                self.lent.push(place);
            }
            Some(Runner::Handler) => self.handler.iter_mut().for_each(|handler| handler.lent = true),
            Some(Runner::Main) | None => {}
        }
    }

    /// Those that were passed over may run again, each before its equals.
    pub fn take_back(&mut self) {
        self.handler.iter_mut().for_each(|handler| handler.lent = false);
        while let Some(place) = self.lent.pop() {
            self.processes[place].lent = false;
            self.make_ready_first(place);
        }
    }

    /// Somebody is ready beside the one that runs.
    #[inline]
    #[must_use]
    pub fn others_are_ready(&self) -> bool {
        let own = usize::from(matches!(self.running(), Some(Runner::Process(_))));
        let priorities: usize = self.ready.iter().map(|word| word.count_ones() as usize).sum();
        let equals = || self.most_urgent().map_or(0, |place| self.processes[place].priority as usize);
        priorities > own || (priorities == 1 && self.queues.length(ListId::number(equals())) > 1)
    }
}
