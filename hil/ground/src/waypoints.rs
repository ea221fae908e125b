//! The way-points that a person types, on their way: a few at a time, as many as the queues on board hold, and repeated
//! until the Controller has taken each. Every other order of the keyboard goes out once, and its answer is read by whoever
//! typed it.

use crate::board::Board;
use crate::link::{Link, LinkError};
use crate::retry_queue::{RetryQueue, Settled};
use bateleur_messages::ground::Order;
use bateleur_messages::telemetry::{Acknowledge, FROM_CONTROLLER, Telemetry};

const WAYPOINT: u8 = b'W';
/// A list of which nothing is taken for so long is given up, ns: a handful of repetitions.
const PATIENCE_NS: u64 = 2_500_000_000;

/// See the module.
#[derive(Debug, Default)]
pub struct WaypointDesk {
    retry_queue: RetryQueue,
    module_restarts: u64,
    /// The caller's time at which the last one was taken, or the list handed in.
    progress_ns: u64,
}

impl WaypointDesk {
    /// Takes a list on. Wait until [`WaypointDesk::is_idle`] before the next: an answer does not say to which list it belongs.
    pub fn request(&mut self, waypoints: impl IntoIterator<Item = Order>, board: &Board, now_ns: u64) {
        self.progress_ns = now_ns;
        for order in waypoints {
            self.retry_queue.request(order, board.module_ns);
        }
    }

    /// Nothing is on its way.
    pub fn is_idle(&self) -> bool {
        !self.retry_queue.is_pending(WAYPOINT)
    }

    /// Takes what came down and stands on the board.
    pub fn take(&mut self, telemetry: &Telemetry, board: &Board, now_ns: u64) {
        if self.module_restarts != board.module_restarts {
            self.module_restarts = board.module_restarts;
            self.retry_queue.forget_times();
        }
        let Telemetry::Acknowledge(answer) = telemetry else { return };
        let time_ns = board.time_of_answer_ns(answer);
        match self.retry_queue.answer(&Acknowledge { time_ns, ..*answer }) {
            Some(Settled::Accepted(_)) => self.progress_ns = now_ns,
            // It has said why, and would again; a full queue on the way is another matter.
            Some(Settled::Refused(..)) if answer.from == FROM_CONTROLLER => {
                self.retry_queue.withdraw(WAYPOINT);
            }
            _ => {}
        }
    }

    /// Sends what is due; says what has been given up.
    ///
    /// # Errors
    /// As [`Link::send`].
    pub fn step(&mut self, now_ns: u64, link: &mut Link) -> Result<Option<String>, LinkError> {
        if self.is_idle() || now_ns.saturating_sub(self.progress_ns) < PATIENCE_NS {
            self.retry_queue.send_due(now_ns, link)?;
            return Ok(None);
        }
        let given_up = self.retry_queue.withdraw(WAYPOINT).len();
        Ok(Some(format!(
            "way-points without an acknowledgement: {given_up}; the list is not whole: does the line reach the module, \
             and its Controller run? Type the last way-point again"
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_messages::frame::Decoder;
    use bateleur_messages::ground::{Step, Waypoint};
    use bateleur_messages::telemetry::{FROM_COMMAND, NOT_UNDERSTOOD, REFUSED};
    use std::collections::BTreeSet;
    use std::io::Read;
    use std::os::unix::net::UnixStream;

    const STEP_NS: u64 = 50_000_000;

    fn list(count: u8) -> Vec<Order> {
        let point = |index: u8| Waypoint {
            index,
            count,
            north_m: f64::from(index) * 100.0,
            east_m: 0.0,
            altitude_m: 160.0,
            heading_rad: 0.0,
            airspeed_mps: 22.0,
            step: Step::Pass,
        };
        (0..count).map(|index| Order::Waypoint(point(index))).collect()
    }

    fn answer(index: u8, from: u8, result: u8) -> Telemetry {
        Telemetry::Acknowledge(Acknowledge {
            letter: WAYPOINT,
            first: index,
            from,
            result,
            ..Acknowledge::default()
        })
    }

    fn line() -> (Link, UnixStream) {
        let (ours, theirs) = UnixStream::pair().unwrap();
        theirs.set_nonblocking(true).unwrap();
        (Link::new(ours).unwrap(), theirs)
    }

    /// Indices of the way-points that came.
    fn arrived(theirs: &mut UnixStream) -> Vec<u8> {
        let mut bytes = Vec::new();
        let _ = theirs.read_to_end(&mut bytes);
        Decoder::new().extend(&bytes).map(|frame| frame.data[0]).collect()
    }

    #[test]
    fn list_longer_than_the_queue_on_board_gets_through_though_some_are_lost() {
        let (mut link, mut theirs) = line();
        let (mut desk, board) = (WaypointDesk::default(), Board::default());
        desk.request(list(32), &board, 0);
        let (mut taken, mut heard, mut now_ns) = (BTreeSet::new(), 0, 0);
        while !desk.is_idle() && now_ns < 60_000_000_000 {
            assert_eq!(desk.step(now_ns, &mut link).unwrap(), None);
            let came = arrived(&mut theirs);
            assert!(came.len() <= 4, "{} at once", came.len());
            for index in came {
                heard += 1;
                if heard % 3 == 0 {
                    continue; // lost
                }
                taken.insert(index);
                desk.take(&answer(index, FROM_CONTROLLER, 0), &board, now_ns);
            }
            now_ns += STEP_NS;
        }
        assert_eq!((taken.len(), desk.is_idle()), (32, true));
    }

    #[test]
    fn list_without_an_answer_is_given_up_and_told() {
        let (mut link, _theirs) = line();
        let (mut desk, board) = (WaypointDesk::default(), Board::default());
        desk.request(list(3), &board, 0);
        let told: Vec<_> = (0..60).filter_map(|step| desk.step(step * STEP_NS, &mut link).unwrap()).collect();
        assert_eq!(told.len(), 1, "{told:?}");
        assert!(told[0].starts_with("way-points without an acknowledgement: 3;"), "{told:?}");
        assert!(desk.is_idle());
    }

    #[test]
    fn full_queue_is_tried_again_and_a_point_that_is_not_understood_is_not() {
        let (mut link, _theirs) = line();
        let (mut desk, board) = (WaypointDesk::default(), Board::default());
        desk.request(list(2), &board, 0);
        desk.step(0, &mut link).unwrap();
        desk.take(&answer(0, FROM_COMMAND, REFUSED), &board, 0);
        assert!(!desk.is_idle());
        desk.take(&answer(0, FROM_CONTROLLER, NOT_UNDERSTOOD), &board, 0);
        assert!(desk.is_idle());
    }
}
