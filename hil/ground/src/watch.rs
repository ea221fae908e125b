//! What a function that was restarted cold has forgotten, read from the telemetry.
//!
//! Evidence counts only when it is newer than the answer that last settled the matter: a status on its way must not
//! be taken for a loss.

use crate::board::Board;
use crate::retry_queue::RetryQueue;
use bateleur_messages::state::STATUS_DISABLED;
use bateleur_messages::telemetry::{NAVIGATION_AUTOPILOT, NAVIGATION_ON, Telemetry};

/// A status this young after the answer may still have been collected before it, ns: the functions report to each
/// other once a cycle, and Command forwards when its window comes.
const SETTLE_NS: u64 = 200_000_000;

/// What has been lost.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Losses {
    /// HIL mode is off.
    pub(crate) hil: bool,
    /// No sensors come. Perhaps HIL mode is off; whether it is, says the next status.
    pub(crate) sensors: bool,
    /// The Estimator is disabled.
    pub(crate) estimator: bool,
    /// The Controller has another number of way-points.
    pub(crate) waypoints: bool,
    /// Navigation is off.
    pub(crate) navigation: bool,
    /// The Controller or the Servo has let go.
    pub(crate) autopilot: bool,
}

/// What has to be remembered between messages.
#[derive(Debug, Default)]
pub(crate) struct Watch {
    imu_measured_ns: u64,
    /// When sensors were first seen to stand still, if they still do.
    sensors_stopped_ns: Option<u64>,
    disabled_ns: Option<u64>,
    loops_engaged_ns: Option<u64>,
}

impl Watch {
    /// Looks at a message that has just been put on the board.
    pub(crate) fn notice(&mut self, telemetry: &Telemetry, board: &Board) {
        match telemetry {
            Telemetry::Imu(imu) => {
                let stopped = imu.measured_ns == self.imu_measured_ns;
                self.sensors_stopped_ns = stopped.then(|| self.sensors_stopped_ns.unwrap_or(board.module_ns));
                self.imu_measured_ns = imu.measured_ns;
            }
            Telemetry::State(state) => {
                self.disabled_ns = (state.status == STATUS_DISABLED).then_some(board.module_ns);
            }
            Telemetry::Loops(loops) if loops.engaged != 0 => self.loops_engaged_ns = Some(loops.time_ns),
            _ => {}
        }
    }

    /// What is lost now, of a mission with so many way-points.
    pub(crate) fn losses(&self, board: &Board, retry_queue: &RetryQueue, waypoints: usize) -> Losses {
        let newer = |letter: u8, time_ns: u64| time_ns > retry_queue.settled_ns(letter) + SETTLE_NS;
        let seen = |letter: u8, time_ns: Option<u64>| time_ns.is_some_and(|time_ns| newer(letter, time_ns));
        let primary = board.primary.map(|primary| primary.message);
        let navigation = board.navigation.map(|navigation| navigation.message);
        Losses {
            hil: primary.is_some_and(|primary| primary.hil == 0 && newer(b'H', primary.time_ns)),
            sensors: seen(b'H', self.sensors_stopped_ns),
            estimator: primary
                .is_some_and(|primary| primary.estimator_enabled == 0 && newer(b'E', primary.time_ns))
                || seen(b'E', self.disabled_ns),
            waypoints: navigation
                .is_some_and(|now| now.waypoint_count as usize != waypoints && newer(b'W', now.time_ns)),
            navigation: navigation
                .is_some_and(|now| now.flags & NAVIGATION_ON == 0 && newer(b'N', now.time_ns)),
            autopilot: self.autopilot_lost(board, retry_queue),
        }
    }

    fn autopilot_lost(&self, board: &Board, retry_queue: &RetryQueue) -> bool {
        let settled_ns = retry_queue.settled_ns(b'A');
        let newer = |time_ns: u64| time_ns > settled_ns + SETTLE_NS;
        let controller = board.navigation.is_some_and(|navigation| {
            navigation.message.flags & NAVIGATION_AUTOPILOT == 0 && newer(navigation.message.time_ns)
        });
        let servo =
            board.servo.is_some_and(|servo| servo.message.autopilot == 0 && newer(servo.message.time_ns));
        // The loops tell sooner than the navigation, but only a Controller that has shown some engaged can lose them.
        let shown = self.loops_engaged_ns.is_some_and(newer);
        let loops = board
            .loops
            .is_some_and(|loops| shown && loops.message.engaged == 0 && newer(loops.message.time_ns));
        controller || servo || loops
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_messages::telemetry::{ImuTelemetry, Loops, Navigation, Primary, ServoTelemetry};

    const NAVIGATING: u32 = NAVIGATION_AUTOPILOT | NAVIGATION_ON;

    fn losses(telemetry: &[Telemetry]) -> Losses {
        let (mut board, mut watch) = (Board::default(), Watch::default());
        for item in telemetry {
            board.take(item, 0);
            watch.notice(item, &board);
        }
        watch.losses(&board, &RetryQueue::default(), 4)
    }

    fn navigation(flags: u32, waypoint_count: u32) -> Telemetry {
        Telemetry::Navigation(Navigation {
            time_ns: 1_000_000_000,
            flags,
            waypoint_count,
            ..Navigation::default()
        })
    }

    #[test]
    fn healthy_telemetry_shows_no_loss() {
        let primary = Primary { hil: 1, estimator_enabled: 1, time_ns: 1_000_000_000, ..Primary::default() };
        let servo = ServoTelemetry { autopilot: 1, time_ns: 1_000_000_000, ..ServoTelemetry::default() };
        let healthy = [navigation(NAVIGATING, 4), Telemetry::Primary(primary), Telemetry::Servo(servo)];
        assert_eq!(losses(&healthy), Losses::default());
    }

    #[test]
    fn restarted_controller_is_seen_to_have_lost_everything() {
        let lost = losses(&[navigation(0, 0)]);
        assert_eq!(lost, Losses { waypoints: true, navigation: true, autopilot: true, ..Losses::default() });
    }

    #[test]
    fn sensors_that_stand_still_are_missed_and_say_nothing_of_hil_mode() {
        let clock = Telemetry::Loops(Loops { time_ns: 1_000_000_000, ..Loops::default() });
        let sample = Telemetry::Imu(ImuTelemetry { measured_ns: 9, ..ImuTelemetry::default() });
        let next = Telemetry::Imu(ImuTelemetry { measured_ns: 10, ..ImuTelemetry::default() });
        let missed = Losses { sensors: true, ..Losses::default() };
        assert_eq!(losses(&[clock, sample, sample]), missed);
        assert_eq!(losses(&[clock, sample, sample, next]), Losses::default());
    }

    #[test]
    fn loops_that_were_never_engaged_are_no_evidence() {
        let loops = |engaged, time_ns| Telemetry::Loops(Loops { time_ns, engaged, ..Loops::default() });
        assert!(!losses(&[loops(0, 1_000_000_000)]).autopilot);
        assert!(losses(&[loops(1, 1_000_000_000), loops(0, 1_500_000_000)]).autopilot);
    }
}
