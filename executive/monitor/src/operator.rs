//! Who gives orders, by the control socket, and what they are answered with.

use std::sync::Arc;

use crate::observers::{Observers, StartObserver};
use bateleur_control::{Answer, Inbox, Ordered, Status};
use bateleur_time::stall::Stall;

/// What operators work with.
#[derive(Default)]
pub struct Operator {
    inbox: Option<Inbox>,
    /// What does not change in a status.
    pub(crate) about: Status,
    pub(crate) stall: Arc<Stall>,
    pub(crate) observers: Observers,
}

impl Operator {
    /// `stall`: shared with the dispatchers. `inbox`: where orders come from; `None` if there is no socket. `about`: the module's name, its process, its clock.
    #[must_use]
    pub fn new(
        inbox: Option<Inbox>,
        about: Status,
        stall: Arc<Stall>,
        start_observer: Option<StartObserver>,
    ) -> Self {
        Self { inbox, about, stall, observers: Observers::new(start_observer) }
    }

    /// The next order.
    pub(crate) fn take(&self) -> Option<Ordered> {
        self.inbox.as_ref().and_then(Inbox::take)
    }

    pub(crate) fn answer(&self, ordered: &Ordered, answer: Result<Answer, String>) {
        if let Some(inbox) = &self.inbox {
            inbox.answer(ordered, answer.unwrap_or_else(Answer::refused));
        }
    }
}
