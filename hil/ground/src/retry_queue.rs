//! Orders on their way: sent, repeated until every function that must answer has, and then settled.

use crate::link::{Link, LinkError};
use bateleur_messages::ground::Order;
use bateleur_messages::telemetry::{
    ACCEPTED, Acknowledge, FROM_COMMAND, FROM_CONTROLLER, FROM_ESTIMATOR, FROM_GPS, FROM_HIL_INTERFACE,
    FROM_IMU, FROM_ONBOARD_COMPUTER, FROM_RATE_GENERATOR, FROM_SERVO, REFUSED,
};

/// An order without an answer is sent again after this time, ns. A round trip takes a few cycles of 20 ms.
pub(crate) const RETRY_NS: u64 = 500_000_000;
/// Orders on the line at once: the queuing ports on board hold a handful.
const MOST_AT_ONCE: usize = 4;

/// An order and what is known of it.
#[derive(Debug, Clone)]
struct Pending {
    order: Order,
    /// Functions that have yet to answer, one bit each.
    missing: u8,
    sent_ns: Option<u64>,
    /// The newest module time known when it was given in. Answers older than that belong to a predecessor.
    since_module_ns: u64,
}

/// What became of an order through one answer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Settled {
    /// Every function took it.
    Accepted(Order),
    /// It was refused; it is sent again unless a refusal settles it.
    Refused(Order, Acknowledge),
}

/// All orders on their way.
#[derive(Debug, Default)]
pub(crate) struct RetryQueue {
    pending: Vec<Pending>,
    /// Module time of the last answer that settled an order, by letter.
    settled_ns: [u64; 26],
    last_refusal: Option<Acknowledge>,
}

impl RetryQueue {
    /// Takes an order on, unless the same one (letter and first byte) is on its way. False then.
    pub(crate) fn request(&mut self, order: Order, module_ns: u64) -> bool {
        if self.pending.iter().any(|pending| key(&pending.order) == key(&order)) {
            return false;
        }
        let missing = answers_wanted(&order);
        self.pending.push(Pending { order, missing, sent_ns: None, since_module_ns: module_ns });
        true
    }

    /// Whether any order with this letter is on its way.
    pub(crate) fn is_pending(&self, letter: u8) -> bool {
        self.pending.iter().any(|pending| pending.order.letter() == letter)
    }

    /// Gives up all orders with this letter.
    pub(crate) fn withdraw(&mut self, letter: u8) -> Vec<Order> {
        let (given_up, kept) = std::mem::take(&mut self.pending)
            .into_iter()
            .partition(|pending| pending.order.letter() == letter);
        self.pending = kept;
        let given_up: Vec<Pending> = given_up;
        given_up.into_iter().map(|pending| pending.order).collect()
    }

    /// Module time at which an order with this letter was last settled; 0 before that.
    pub(crate) fn settled_ns(&self, letter: u8) -> u64 {
        slot(letter).map_or(0, |slot| self.settled_ns[slot])
    }

    /// The last refusal, for an explanation.
    pub(crate) fn last_refusal(&self) -> Option<Acknowledge> {
        self.last_refusal
    }

    /// Forgets all times: the module's clock began anew.
    pub(crate) fn forget_times(&mut self) {
        self.settled_ns = [0; 26];
        self.pending.iter_mut().for_each(|pending| pending.since_module_ns = 0);
    }

    /// Sends what is due.
    pub(crate) fn send_due(&mut self, now_ns: u64, link: &mut Link) -> Result<(), LinkError> {
        for pending in self.pending.iter_mut().take(MOST_AT_ONCE) {
            let due = pending.sent_ns.is_none_or(|sent_ns| now_ns.saturating_sub(sent_ns) >= RETRY_NS);
            if due {
                link.send(&pending.order)?;
                pending.sent_ns = Some(now_ns);
            }
        }
        Ok(())
    }

    /// Takes an answer; tells what it settled.
    pub(crate) fn answer(&mut self, answer: &Acknowledge) -> Option<Settled> {
        let index = self.pending.iter().position(|pending| pending.answered_by(answer))?;
        if answer.result != ACCEPTED {
            return Some(self.refused(index, answer));
        }
        let pending = &mut self.pending[index];
        pending.missing &= !bit(answer.from);
        if pending.missing != 0 {
            return None;
        }
        Some(Settled::Accepted(self.settle(index, answer)))
    }

    fn refused(&mut self, index: usize, answer: &Acknowledge) -> Settled {
        self.last_refusal = Some(*answer);
        let order = self.pending[index].order;
        // Sensors may be initialised only at standstill; a refusal is as good an answer as any.
        if matches!(order, Order::InitialiseSensors { .. }) && answer.result == REFUSED {
            self.settle(index, answer);
        }
        Settled::Refused(order, *answer)
    }

    fn settle(&mut self, index: usize, answer: &Acknowledge) -> Order {
        if let Some(slot) = slot(answer.letter) {
            self.settled_ns[slot] = self.settled_ns[slot].max(answer.time_ns);
        }
        self.pending.remove(index).order
    }
}

impl Pending {
    fn answered_by(&self, answer: &Acknowledge) -> bool {
        let expected = self.missing & bit(answer.from) != 0 || answer.from == FROM_COMMAND;
        self.sent_ns.is_some()
            && key(&self.order) == (answer.letter, answer.first)
            && answer.time_ns >= self.since_module_ns
            && expected
    }
}

fn key(order: &Order) -> (u8, u8) {
    (order.letter(), order.data().first().copied().unwrap_or(0))
}

fn slot(letter: u8) -> Option<usize> {
    letter.is_ascii_uppercase().then(|| usize::from(letter - b'A'))
}

fn bit(from: u8) -> u8 {
    1_u8.checked_shl(u32::from(from)).unwrap_or(0)
}

fn answers_wanted(order: &Order) -> u8 {
    match order {
        Order::Hil { .. } => bit(FROM_HIL_INTERFACE),
        Order::Autopilot { .. } => bit(FROM_CONTROLLER) | bit(FROM_SERVO),
        Order::Navigation { .. }
        | Order::Waypoint(_)
        | Order::Fence(_)
        | Order::Rally(_)
        | Order::GoOnWith { .. }
        | Order::Loop { .. }
        | Order::Manoeuvre { .. } => bit(FROM_CONTROLLER),
        Order::InitialiseSensors { .. } => bit(FROM_IMU),
        Order::Estimator(_) => bit(FROM_ESTIMATOR),
        Order::ReadParameter { .. } => 0, // answered by the parameter itself
        Order::SetParameter(setting) => bit(setting.of),
    }
}

/// The name of the function that sent an answer.
pub(crate) fn function_name(from: u8) -> &'static str {
    match from {
        FROM_COMMAND => "Command",
        FROM_HIL_INTERFACE => "HILInterface",
        FROM_IMU => "IMU",
        FROM_ESTIMATOR => "Estimator",
        FROM_CONTROLLER => "Controller",
        FROM_SERVO => "Servo",
        FROM_GPS => "GPS",
        FROM_ONBOARD_COMPUTER => "OnBoardComputer",
        FROM_RATE_GENERATOR => "RateGenerator",
        _ => "a function unknown here",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;
    use std::os::unix::net::UnixStream;

    fn answer(order: &Order, from: u8, time_ns: u64) -> Acknowledge {
        let (letter, first) = key(order);
        Acknowledge { time_ns, letter, first, from, ..Acknowledge::default() }
    }

    fn sent(retry_queue: &mut RetryQueue, now_ns: u64) -> usize {
        let (ours, mut theirs) = UnixStream::pair().unwrap();
        theirs.set_nonblocking(true).unwrap();
        retry_queue.send_due(now_ns, &mut Link::new(ours).unwrap()).unwrap();
        let mut bytes = Vec::new();
        let _ = theirs.read_to_end(&mut bytes);
        bytes.iter().filter(|byte| **byte == b'$').count()
    }

    #[test]
    fn autopilot_is_settled_by_controller_and_servo_together() {
        let mut retry_queue = RetryQueue::default();
        let order = Order::Autopilot { on: true };
        assert!(retry_queue.request(order, 0));
        assert!(!retry_queue.request(order, 0), "not twice at a time");
        sent(&mut retry_queue, 0);
        assert_eq!(retry_queue.answer(&answer(&order, FROM_SERVO, 5)), None);
        assert_eq!(retry_queue.answer(&answer(&order, FROM_SERVO, 6)), None);
        let settled = retry_queue.answer(&answer(&order, FROM_CONTROLLER, 7));
        assert_eq!(settled, Some(Settled::Accepted(order)));
        assert_eq!((retry_queue.is_pending(b'A'), retry_queue.settled_ns(b'A')), (false, 7));
    }

    #[test]
    fn order_is_repeated_after_half_a_second() {
        let mut retry_queue = RetryQueue::default();
        retry_queue.request(Order::Hil { on: true }, 0);
        let sendings: Vec<_> =
            [0, 100, 400, 500, 900, 1000].map(|ms| sent(&mut retry_queue, ms * 1_000_000)).into();
        assert_eq!(sendings, [1, 0, 0, 1, 0, 1]);
    }

    #[test]
    fn answer_to_an_earlier_order_settles_nothing() {
        let mut retry_queue = RetryQueue::default();
        let order = Order::Hil { on: true };
        retry_queue.request(order, 100);
        sent(&mut retry_queue, 0);
        assert_eq!(retry_queue.answer(&answer(&order, FROM_HIL_INTERFACE, 99)), None);
        assert!(retry_queue.is_pending(b'H'));
    }

    #[test]
    fn refused_initialisation_is_settled_and_a_refused_order_is_not() {
        for (order, from, still) in [
            (Order::InitialiseSensors { sensors: 2 }, FROM_IMU, false),
            (Order::Navigation { on: true }, FROM_CONTROLLER, true),
        ] {
            let mut retry_queue = RetryQueue::default();
            retry_queue.request(order, 0);
            sent(&mut retry_queue, 0);
            let refusal = Acknowledge { result: REFUSED, ..answer(&order, from, 1) };
            assert_eq!(retry_queue.answer(&refusal), Some(Settled::Refused(order, refusal)));
            assert_eq!(retry_queue.is_pending(order.letter()), still);
        }
    }
}
