//! What has come since the last window, on all networks, in the order in which it came.
//!
//! A window has an end: what there was no time to look at waits here for the next one, before what comes later. A transport hands over one network after the other. What one network has lost and another one brings would come behind
//! everything that followed it: too late for whoever waits for it. It must never look into a datagram.

use bateleur_relay::Rejection;
use bateleur_relay::transport::Came;

/// See the module's head.
#[derive(Default)]
pub(super) struct Inbox {
    /// The datagrams, one behind the other. Neither list gives memory back: after the first windows nothing is allocated.
    bytes: Vec<u8>,
    all: Vec<Entry>,
    /// Of what is left over, while it is put together.
    rest: Vec<u8>,
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

    /// Datagrams that wait here.
    pub(super) fn len(&self) -> usize {
        self.all.len()
    }

    /// Hands over what waits, as long as `goes_on` says so of the number that was handed over; the rest waits. What came at one
    /// instant, or on one network, stays in its order.
    pub(super) fn empty(&mut self, goes_on: &mut dyn FnMut(usize) -> bool, take: &mut dyn FnMut(Came<'_>)) {
        self.all.sort_by_key(|entry| entry.at_ns);
        let mut done = 0;
        while let Some(Entry { endpoint, at_ns, place }) = self.all.get(done).filter(|_| goes_on(done)) {
            let datagram = place.map(|(from, until)| &self.bytes[from..until]);
            take(Came { endpoint: *endpoint, at_ns: *at_ns, datagram });
            done += 1;
        }
        self.all.drain(..done);
        self.rest.clear();
        for (from, until) in self.all.iter_mut().filter_map(|entry| entry.place.as_mut().ok()) {
            let start = self.rest.len();
            self.rest.extend_from_slice(&self.bytes[*from..*until]);
            (*from, *until) = (start, self.rest.len());
        }
        std::mem::swap(&mut self.bytes, &mut self.rest);
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
        inbox.empty(&mut |_| true, &mut |came| {
            let text = came.datagram.map(|bytes| String::from_utf8(bytes.to_vec()).unwrap());
            order.push((came.endpoint, text.unwrap_or_else(|reason| format!("{reason:?}"))));
        });
        let expected = [(0, "1"), (1, "1"), (1, "2"), (1, "Giant"), (0, "3"), (0, "4"), (1, "3")];
        assert_eq!(order, expected.map(|(endpoint, text)| (endpoint, text.to_owned())));
        inbox.empty(&mut |_| true, &mut |came| panic!("handed over twice: {came:?}"));
    }

    #[test]
    fn what_there_is_no_time_for_waits_and_goes_before_what_comes_later() {
        let mut inbox = Inbox::default();
        let mut found = Vec::new();
        for round in 0..3_u64 {
            for number in 0..3 {
                let (at_ns, text) = (10 * round + number, format!("{round}{number}"));
                let datagram = if number == 1 { Err(Rejection::Giant) } else { Ok(text.as_bytes()) };
                inbox.add(&Came { endpoint: 0, at_ns, datagram });
            }
            inbox.empty(&mut |done| done < 2, &mut |came| {
                found.push(
                    came.datagram
                        .map_or_else(|_| "-".into(), |bytes| String::from_utf8(bytes.to_vec()).unwrap()),
                );
            });
            assert_eq!(inbox.len() as u64, round + 1);
        }
        inbox.empty(&mut |_| true, &mut |came| {
            found.push(
                came.datagram.map_or_else(|_| "-".into(), |bytes| String::from_utf8(bytes.to_vec()).unwrap()),
            );
        });
        assert_eq!(found, ["00", "-", "02", "10", "-", "12", "20", "-", "22"]);
        assert_eq!((inbox.len(), inbox.bytes.len()), (0, 0));
    }
}
