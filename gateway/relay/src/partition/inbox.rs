//! What has come since the last window, on all networks, in the order in which it came.
//!
//! A transport hands over one network after the other. What one network has lost and another one brings would come behind
//! everything that followed it: too late for whoever waits for it. It must never look into a datagram.

use bateleur_relay::Rejection;
use bateleur_relay::transport::Came;

/// See the module's head.
#[derive(Default)]
pub(super) struct Inbox {
    /// The datagrams, one behind the other. Neither list gives memory back: after the first windows nothing is allocated.
    bytes: Vec<u8>,
    all: Vec<Entry>,
}

struct Entry {
    endpoint: usize,
    at_ns: u64,
    /// Where it lies, or why it is none.
    place: Result<(usize, usize), Rejection>,
}

impl Inbox {
    pub(super) fn add(&mut self, came: &Came<'_>) {
        let from = self.bytes.len();
        let place = came.datagram.as_ref().map_err(|reason| *reason).map(|datagram| {
            self.bytes.extend_from_slice(datagram);
            (from, self.bytes.len())
        });
        self.all.push(Entry { endpoint: came.endpoint, at_ns: came.at_ns, place });
    }

    /// Hands over everything. What came at one instant, or on one network, stays in its order.
    pub(super) fn empty(&mut self, take: &mut dyn FnMut(Came<'_>)) {
        self.all.sort_by_key(|entry| entry.at_ns);
        for Entry { endpoint, at_ns, place } in self.all.drain(..) {
            let datagram = place.map(|(from, until)| &self.bytes[from..until]);
            take(Came { endpoint, at_ns, datagram });
        }
        self.bytes.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_networks_are_handed_over_in_the_order_of_their_instants() {
        let mut inbox = Inbox::default();
        let a = [(10, "1"), (30, "3"), (30, "4")].map(|(at_ns, text)| (0, at_ns, text));
        let b = [(11, "1"), (21, "2"), (31, "3")].map(|(at_ns, text)| (1, at_ns, text));
        for (endpoint, at_ns, text) in a.into_iter().chain(b) {
            inbox.add(&Came { endpoint, at_ns, datagram: Ok(text.as_bytes()) });
        }
        inbox.add(&Came { endpoint: 1, at_ns: 25, datagram: Err(Rejection::Giant) });
        let mut order = Vec::new();
        inbox.empty(&mut |came| {
            let text = came.datagram.map(|bytes| String::from_utf8(bytes.to_vec()).unwrap());
            order.push((came.endpoint, text.unwrap_or_else(|reason| format!("{reason:?}"))));
        });
        let expected = [(0, "1"), (1, "1"), (1, "2"), (1, "Giant"), (0, "3"), (0, "4"), (1, "3")];
        assert_eq!(order, expected.map(|(endpoint, text)| (endpoint, text.to_owned())));
        inbox.empty(&mut |came| panic!("handed over twice: {came:?}"));
    }
}
