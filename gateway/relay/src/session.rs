//! The lives of both ends: which datagrams come from the peer as it is now.
//!
//! A relay that starts draws a number, its life. It takes datagrams of a life of the peer only once that life has answered
//! a challenge which was drawn for this purpose alone and never before. So a recorded datagram proves nothing, whichever of the
//! two ends was restarted since, and neither a clock nor memory that survives is needed: see the decision on restarts.
//!
//! Whoever is not proven may be the peer's new life or a recording of an old one, and nobody can tell before an answer has come
//! back. So all that were heard lately are answered, one by chance with each datagram: a recording that is said again and
//! again can delay a meeting, and not prevent it.
//!
//! It must never go back to a life that it has left, and never keep a challenge that was answered.

use std::collections::VecDeque;

use bateleur_contract::relay::TAKEN_IN_A_WINDOW;

/// Lives that are not proven of which a challenge is kept, most: as many as a window takes datagrams, so that none of them drives
/// out the peer's.
const STRANGERS: usize = TAKEN_IN_A_WINDOW;

/// Draws numbers that nobody can foresee: each is a keyed hash of how many were drawn before.
pub(crate) struct Draw {
    seed: [u8; 32],
    drawn: u64,
}

impl Draw {
    pub(crate) fn new(seed: [u8; 32]) -> Self {
        Self { seed, drawn: 0 }
    }

    /// The next number, never 0.
    fn next(&mut self) -> u64 {
        loop {
            self.drawn += 1;
            let hash = blake3::keyed_hash(&self.seed, &self.drawn.to_le_bytes());
            match hash.as_bytes().first_chunk().copied().map_or(0, u64::from_le_bytes) {
                0 => {}
                number => return number,
            }
        }
    }
}

/// What a datagram says of the lives of both ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Claim {
    pub(crate) session: u64,
    pub(crate) to_session: u64,
    pub(crate) challenge: u64,
    pub(crate) answer: u64,
}

/// What a claim shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Verdict {
    /// It is the peer's proven life.
    Present,
    /// It is a new life of the peer, proven by this.
    Born,
    /// Nothing is proven.
    Unproven,
}

/// What this end knows of both lives.
pub(crate) struct Session {
    own: u64,
    challenge: u64,
    peer: Option<u64>,
    /// The challenge of the proven life; 0: there is none yet.
    answer: u64,
    /// Challenges of lives that are not proven, the oldest first.
    strangers: VecDeque<u64>,
    /// One of them is answered next.
    their_turn: bool,
    /// The peer takes what this life sends.
    adopted: bool,
    /// Nothing comes from the peer any more.
    deaf: bool,
    draw: Draw,
}

impl Session {
    pub(crate) fn new(mut draw: Draw) -> Self {
        let (own, challenge) = (draw.next(), draw.next());
        Self {
            own,
            challenge,
            peer: None,
            answer: 0,
            strangers: VecDeque::new(),
            their_turn: false,
            adopted: false,
            deaf: false,
            draw,
        }
    }

    /// This life.
    pub(crate) fn own(&self) -> u64 {
        self.own
    }

    /// What the next datagram says. Each call takes a turn in answering: for a datagram that goes.
    pub(crate) fn claim(&mut self) -> Claim {
        Claim {
            session: self.own,
            // Who hears nothing says so: else the other end would take a way that works in one direction for a link.
            to_session: self.peer.filter(|_| !self.deaf).unwrap_or(0),
            challenge: self.challenge,
            answer: self.answer_next(),
        }
    }

    /// In turn the challenge of the proven life and one of the others.
    fn answer_next(&mut self) -> u64 {
        let theirs = std::mem::replace(&mut self.their_turn, true) || self.answer == 0;
        if self.strangers.is_empty() || !theirs {
            return self.answer;
        }
        self.their_turn = false;
        let one = (self.draw.next() % self.strangers.len() as u64) as usize;
        self.strangers[one]
    }

    /// The latest is the likeliest to be the peer: it is answered with the next datagram but for others that came with it.
    fn add_stranger(&mut self, challenge: u64) {
        if self.strangers.contains(&challenge) {
            return;
        }
        if self.strangers.len() == STRANGERS {
            self.strangers.pop_front();
        }
        self.strangers.push_back(challenge);
        self.their_turn = true;
    }

    /// Takes the claim of an authentic datagram. `newest`: no later one of the peer's proven life has come.
    pub(crate) fn meet(&mut self, claim: &Claim, newest: bool) -> Verdict {
        let verdict = match self.peer {
            Some(peer) if peer == claim.session => Verdict::Present,
            _ if claim.answer == self.challenge => Verdict::Born,
            _ => Verdict::Unproven,
        };
        if verdict == Verdict::Born {
            self.peer = Some(claim.session);
            self.challenge = self.draw.next();
            self.strangers.clear();
        }
        if verdict != Verdict::Unproven {
            self.deaf = false;
        }
        match verdict {
            Verdict::Unproven => self.add_stranger(claim.challenge),
            Verdict::Present if !newest => {}
            Verdict::Present | Verdict::Born => self.answer = claim.challenge, // so that it can prove this life
        }
        if verdict == Verdict::Born || verdict == Verdict::Present && newest {
            self.adopted = claim.to_session == self.own;
        }
        verdict
    }

    /// The peer is not heard any more: whether it still takes what is sent is not known, and it shall know that.
    pub(crate) fn silent(&mut self) {
        self.adopted = false;
        self.deaf = true;
    }

    /// Whether the peer takes what this life sends.
    pub(crate) fn is_adopted(&self) -> bool {
        self.adopted
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn session(seed: u8) -> Session {
        Session::new(Draw::new([seed; 32]))
    }

    /// One sends and the other takes.
    fn tell(from: &mut Session, to: &mut Session) -> Verdict {
        to.meet(&from.claim(), true)
    }

    fn acquainted() -> (Session, Session) {
        let (mut a, mut b) = (session(1), session(2));
        assert_eq!(tell(&mut a, &mut b), Verdict::Unproven);
        assert_eq!(tell(&mut b, &mut a), Verdict::Born);
        assert_eq!(tell(&mut a, &mut b), Verdict::Born);
        assert_eq!(tell(&mut b, &mut a), Verdict::Present);
        (a, b)
    }

    #[test]
    fn two_that_hear_each_other_adopt_each_other_within_two_rounds() {
        let (a, b) = acquainted();
        assert!(a.is_adopted() && b.is_adopted());
    }

    #[test]
    fn one_that_hears_nothing_says_so_and_both_adopt_each_other_again() {
        let (mut a, mut b) = acquainted();
        b.silent();
        assert_eq!(tell(&mut b, &mut a), Verdict::Present);
        assert!(!a.is_adopted(), "what it sends comes nowhere");
        // The way from a to b is there again.
        assert_eq!(tell(&mut a, &mut b), Verdict::Present);
        assert!(b.is_adopted());
        assert_eq!(tell(&mut b, &mut a), Verdict::Present);
        assert!(a.is_adopted());
    }

    #[test]
    fn a_recorded_life_is_not_taken_after_the_receiver_was_restarted() {
        let (mut a, _) = acquainted();
        let recorded = a.claim();
        let mut b = Session::new(Draw::new([9; 32]));
        for _ in 0..3 {
            assert_eq!(b.meet(&recorded, true), Verdict::Unproven);
        }
        // The living one is met all the same.
        tell(&mut b, &mut a);
        assert!(!a.is_adopted(), "what is sent to the old life would be refused by the new one");
        assert_eq!(tell(&mut a, &mut b), Verdict::Born);
        assert_eq!(b.meet(&recorded, false), Verdict::Present); // its own life: the window of numbers decides
    }

    #[test]
    fn a_life_that_was_left_is_not_gone_back_to() {
        let (mut a, mut b) = acquainted();
        let recorded = a.claim();
        let mut again = session(3);
        assert_eq!(tell(&mut again, &mut b), Verdict::Unproven);
        assert_eq!(tell(&mut b, &mut again), Verdict::Born);
        assert_eq!(tell(&mut again, &mut b), Verdict::Born);
        assert_eq!(b.meet(&recorded, true), Verdict::Unproven);
        assert_eq!(tell(&mut again, &mut b), Verdict::Present);
    }

    #[test]
    fn an_answer_proves_one_life_and_no_second() {
        let (mut a, mut b) = (session(1), session(2));
        tell(&mut b, &mut a);
        let answer = a.claim();
        assert_eq!(b.meet(&answer, true), Verdict::Born);
        let forged = Claim { session: 77, ..answer };
        assert_eq!(b.meet(&forged, true), Verdict::Unproven);
    }

    #[test]
    fn one_whose_peer_was_restarted_sends_it_nothing_before_it_is_adopted_anew() {
        let (mut a, _) = acquainted();
        let mut b = session(5);
        tell(&mut b, &mut a);
        a.silent(); // as when the old life is not heard any more
        assert!(!a.is_adopted());
        assert_eq!(tell(&mut b, &mut a), Verdict::Unproven);
    }

    #[test]
    fn recordings_of_old_lives_that_are_said_again_and_again_keep_nobody_apart() {
        for lives in [1_u8, 5, 40] {
            let (mut a, _) = acquainted();
            let recorded: Vec<Claim> = (0..lives).map(|life| session(100 + life).claim()).collect();
            let mut b = session(9); // the peer was restarted
            let mut windows = 0;
            while !(a.is_adopted() && b.is_adopted() && a.peer == Some(b.own)) {
                windows += 1;
                assert!(windows < 2_000, "{lives} recorded lives");
                tell(&mut b, &mut a);
                for claim in &recorded {
                    a.meet(claim, false);
                }
                tell(&mut a, &mut b);
            }
        }
    }
}
