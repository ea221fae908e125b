//! What a relay tells the executive of a module that follows another one's major frames.

use bateleur_contract::AlignmentReport;

use crate::time::Time;

/// Where it is told; see [`crate::Context::alignment`]. Cheap to clone.
#[derive(Debug, Clone)]
pub struct Alignment {
    time: Time,
}

impl Alignment {
    pub(crate) fn new(time: Time) -> Self {
        Self { time }
    }

    /// Tells how the module's major frames lie to the peer's: in a window, and of the major frame in which that lies. Each
    /// report replaces the one before. The executive corrects the frames that come, by a little each.
    pub fn tell(&self, report: &AlignmentReport) {
        self.time.page().tell_alignment(report);
    }
}
