//! How long a replica may differ, or be silent, until it is outvoted.
//!
//! One message that differs is forgiven: an input that changed between two replicas' windows. What differs more often than it agrees is
//! not.

use crate::REPLICAS;

/// What a vote in which it differs adds to a replica's doubt; one in which it agrees takes 1 away.
const DIFFERS: u32 = 3;
/// The doubt with which a replica is outvoted: after four votes in which it differed, or ten of which it agreed in every other one.
const OUTVOTED: u32 = 12;
/// Votes in a row without a word of a replica that spoke before, after which it is outvoted: as many as the windows of `silence`, so that
/// one that was ended and starts again is not ended again.
const SILENT: u32 = 25;

/// Votes in a row without its word after which nobody waits for it.
const AWAY: u32 = 2;

/// What a replica did in a vote.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Conduct {
    /// It wrote what most did.
    Agrees,
    /// It wrote something else.
    Differs,
    /// It wrote nothing.
    Silent,
}

/// Why a replica is outvoted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    /// It writes something else.
    Differs,
    /// It writes nothing any more.
    Silent,
}

/// Of each replica's words on one port.
#[derive(Debug, Default)]
pub struct Standing {
    doubts: [u32; REPLICAS],
    silent: [u32; REPLICAS],
    /// It wrote something since it was outvoted last.
    heard: [bool; REPLICAS],
    /// Times that it fell silent or was outvoted.
    absences: [u32; REPLICAS],
}

impl Standing {
    /// Notes a vote; what the replica is outvoted for, if it is.
    pub fn note(&mut self, replica: usize, conduct: Conduct) -> Option<Verdict> {
        let (doubt, silent, heard) =
            (&mut self.doubts[replica], &mut self.silent[replica], &mut self.heard[replica]);
        match conduct {
            Conduct::Silent if !*heard => return None,
            Conduct::Silent => {
                self.absences[replica] += u32::from(*silent == 0);
                *silent += 1;
            }
            Conduct::Agrees => (*heard, *silent, *doubt) = (true, 0, doubt.saturating_sub(1)),
            Conduct::Differs => (*heard, *silent, *doubt) = (true, 0, *doubt + DIFFERS),
        }
        let verdict = match (*doubt >= OUTVOTED, *silent >= SILENT) {
            (true, _) => Verdict::Differs,
            (false, true) => Verdict::Silent,
            (false, false) => return None,
        };
        (*doubt, *silent, *heard) = (0, 0, false);
        self.absences[replica] += u32::from(verdict == Verdict::Differs);
        Some(verdict)
    }

    /// Whether the word of one replica counts less than the other one's because it differed more, of late.
    #[must_use]
    pub fn is_doubted(&self, replica: usize, other: usize) -> bool {
        self.doubts[replica] > self.doubts[other]
    }

    /// Nobody waits for its word: it has not spoken yet, or was silent in the last votes.
    #[must_use]
    pub fn is_away(&self, replica: usize) -> bool {
        !self.heard[replica] || self.silent[replica] >= AWAY
    }

    /// Who speaks first among those that say the same: least in doubt, then absent least often, since what a replica retains is not all that
    /// it knew.
    #[must_use]
    pub fn rank(&self, replica: usize) -> (u32, u32, usize) {
        (self.doubts[replica], self.absences[replica], replica)
    }
}
