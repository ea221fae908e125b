//! Whether a network brings the peer's datagrams.

/// One network of a link.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Presence {
    lost_after_ns: u64,
    /// When it was heard last, or when listening began.
    since_ns: Option<u64>,
    heard: bool,
    up: bool,
    /// That nothing was ever heard has been said.
    told: bool,
}

/// What changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Change {
    /// The first datagram ever.
    First,
    /// Heard again.
    Back,
    /// Silent for too long.
    Gone,
    /// Silent since listening began, for too long.
    Never,
}

impl Presence {
    pub(crate) fn new(lost_after_ns: u64) -> Self {
        Self { lost_after_ns, since_ns: None, heard: false, up: false, told: false }
    }

    /// A datagram of the peer that lives came on it at `came_ns`. One that has lain in the socket for as long as a network may be silent
    /// says nothing of the present, as behind a flood.
    pub(crate) fn heard_at(&mut self, came_ns: u64, now_ns: u64) -> Option<Change> {
        let is_old = now_ns.saturating_sub(came_ns) > self.lost_after_ns;
        if is_old { None } else { self.heard(came_ns) }
    }

    fn heard(&mut self, now_ns: u64) -> Option<Change> {
        // What came on another socket first may be a little older.
        self.since_ns =
            Some(self.since_ns.filter(|_| self.up).map_or(now_ns, |since_ns| since_ns.max(now_ns)));
        let first = !std::mem::replace(&mut self.heard, true);
        let was_up = std::mem::replace(&mut self.up, true);
        match (was_up, first) {
            (true, _) => None,
            (false, true) => Some(Change::First),
            (false, false) => Some(Change::Back),
        }
    }

    /// When it was heard last; `None`: never.
    pub(crate) fn heard_ns(&self) -> Option<u64> {
        self.since_ns.filter(|_| self.heard)
    }

    /// Time passes. Each silence is told once.
    pub(crate) fn look(&mut self, now_ns: u64) -> Option<Change> {
        let since_ns = *self.since_ns.get_or_insert(now_ns);
        if now_ns.saturating_sub(since_ns) <= self.lost_after_ns {
            return None;
        }
        if self.up {
            self.up = false;
            return Some(Change::Gone);
        }
        let tell = !self.heard && !std::mem::replace(&mut self.told, true);
        tell.then_some(Change::Never)
    }

    /// Whether nothing was ever heard, and that has been said.
    pub(crate) fn is_told_silent(&self) -> bool {
        self.told && !self.heard
    }

    pub(crate) fn is_up(&self) -> bool {
        self.up
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn silence_is_told_once_and_so_is_its_end() {
        let mut network = Presence::new(100);
        assert_eq!(network.look(0), None);
        assert_eq!(network.heard(50), Some(Change::First));
        assert_eq!(network.heard(60), None);
        assert_eq!(network.look(160), None);
        assert_eq!(network.look(161), Some(Change::Gone));
        assert_eq!(network.look(400), None);
        assert!(!network.is_up());
        assert_eq!(network.heard(500), Some(Change::Back));
        assert!(network.is_up());
    }

    #[test]
    fn what_lay_in_a_socket_for_too_long_brings_no_network_back() {
        let mut network = Presence::new(100);
        assert_eq!(network.heard_at(50, 60), Some(Change::First));
        assert_eq!(network.look(200), Some(Change::Gone));
        for now_ns in [300, 400, 500] {
            assert_eq!(network.heard_at(now_ns - 101, now_ns), None);
            assert_eq!(network.look(now_ns), None, "neither back nor gone once more");
        }
        assert_eq!(network.heard_at(590, 600), Some(Change::Back));
        assert_eq!(network.look(600), None);
    }

    #[test]
    fn a_peer_that_never_comes_is_told_once_and_met_when_it_comes() {
        let mut network = Presence::new(100);
        assert_eq!(network.look(1000), None);
        assert_eq!(network.look(1101), Some(Change::Never));
        assert_eq!(network.look(9000), None);
        assert_eq!(network.heard(9500), Some(Change::First));
        assert_eq!(network.look(9600), None);
        assert_eq!(network.look(9601), Some(Change::Gone));
    }
}
