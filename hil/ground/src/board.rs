//! The telemetry board: the newest message of each kind and when it came.

use bateleur_messages::SimulatorLink;
use bateleur_messages::telemetry::{
    Acknowledge, GpsTelemetry, ImuTelemetry, Loops, Navigation, Primary, ServoTelemetry, StateTelemetry,
    Telemetry, Voltages,
};

/// A module clock that falls back by more than this, ns, was started anew.
const CLOCK_RESTART_NS: u64 = 5_000_000_000;

/// An answer whose time is off by more than this, ns, was written by another clock.
const OTHER_CLOCK_NS: u64 = 1_000_000_000;

/// A message and when it came.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Latest<T> {
    /// The message.
    pub message: T,
    /// The caller's time at which it came, ns.
    pub received_ns: u64,
}

/// The newest of everything.
#[derive(Debug, Clone, Default)]
pub struct Board {
    /// Functions on and ready, every 2 s.
    pub primary: Option<Latest<Primary>>,
    /// Supply, every 0.5 s.
    pub voltages: Option<Latest<Voltages>>,
    /// Satellite receiver, every 2 s.
    pub gps: Option<Latest<GpsTelemetry>>,
    /// Sensors, every 0.5 s.
    pub imu: Option<Latest<ImuTelemetry>>,
    /// Estimator, every 0.5 s.
    pub state: Option<Latest<StateTelemetry>>,
    /// Way-points, every 2 s.
    pub navigation: Option<Latest<Navigation>>,
    /// Loops, every 0.5 s.
    pub loops: Option<Latest<Loops>>,
    /// Actuators, every 1 s.
    pub servo: Option<Latest<ServoTelemetry>>,
    /// What became of the conversation with the simulator, every 2 s.
    pub simulator: Option<Latest<SimulatorLink>>,
    /// The last answer to an order.
    pub acknowledge: Option<Latest<Acknowledge>>,
    /// The caller's time of the last message of any kind, ns.
    pub last_received_ns: Option<u64>,
    /// The newest module time in any message, ns.
    pub module_ns: u64,
    /// Times that the module's clock began anew.
    pub module_restarts: u64,
}

impl Board {
    /// Puts a message on the board.
    pub fn take(&mut self, telemetry: &Telemetry, now_ns: u64) {
        self.last_received_ns = Some(now_ns);
        self.follow_module(module_ns(telemetry));
        match *telemetry {
            Telemetry::Primary(message) => put(&mut self.primary, message, now_ns),
            Telemetry::Voltages(message) => put(&mut self.voltages, message, now_ns),
            Telemetry::Gps(message) => put(&mut self.gps, message, now_ns),
            Telemetry::Imu(message) => put(&mut self.imu, message, now_ns),
            Telemetry::State(message) => put(&mut self.state, message, now_ns),
            Telemetry::Navigation(message) => put(&mut self.navigation, message, now_ns),
            Telemetry::Loops(message) => put(&mut self.loops, message, now_ns),
            Telemetry::Servo(message) => put(&mut self.servo, message, now_ns),
            Telemetry::Simulator(message) => put(&mut self.simulator, message, now_ns),
            Telemetry::Acknowledge(message) => put(&mut self.acknowledge, message, now_ns),
            // An answer that nobody needs later; what the executive tells by itself.
            Telemetry::Parameter(_) | Telemetry::Health(_) => {}
        }
    }

    fn follow_module(&mut self, time_ns: Option<u64>) {
        let Some(time_ns) = time_ns else { return };
        if time_ns + CLOCK_RESTART_NS < self.module_ns {
            self.module_restarts += 1;
            self.module_ns = time_ns;
        }
        self.module_ns = self.module_ns.max(time_ns);
    }

    /// When an answer was given, by the clock of the module with the ground's line, ns. A function on another host answers by its
    /// host's clock, which begins anew when that host does.
    pub(crate) fn time_of_answer_ns(&self, answer: &Acknowledge) -> u64 {
        let is_own = answer.time_ns.abs_diff(self.module_ns) <= OTHER_CLOCK_NS;
        if is_own { answer.time_ns } else { self.module_ns }
    }

    /// Estimated height above the runway, m.
    pub fn altitude_m(&self) -> Option<f64> {
        self.state.map(|state| -state.message.position_ned_m[2])
    }

    /// Measured airspeed, m/s.
    pub fn airspeed_mps(&self) -> Option<f64> {
        self.imu.map(|imu| imu.message.airspeed_mps)
    }

    /// Time since the last message of any kind, ns.
    pub fn silence_ns(&self, now_ns: u64) -> Option<u64> {
        self.last_received_ns.map(|received_ns| now_ns.saturating_sub(received_ns))
    }
}

fn put<T>(place: &mut Option<Latest<T>>, message: T, received_ns: u64) {
    *place = Some(Latest { message, received_ns });
}

/// Module time at which a message was written. Sensor times (of IMU, GPS, Estimator) may stand still when the sensors
/// do, so they say nothing about the clock.
fn module_ns(telemetry: &Telemetry) -> Option<u64> {
    match telemetry {
        Telemetry::Primary(message) => Some(message.time_ns),
        Telemetry::Voltages(message) => Some(message.time_ns),
        Telemetry::Navigation(message) => Some(message.time_ns),
        Telemetry::Loops(message) => Some(message.time_ns),
        Telemetry::Servo(message) => Some(message.time_ns),
        Telemetry::Simulator(message) => Some(message.time_ns),
        Telemetry::Health(message) => Some(message.time_ns),
        Telemetry::Gps(_) | Telemetry::Imu(_) | Telemetry::State(_) => None,
        // By the clock of the host that the function is on.
        Telemetry::Acknowledge(_) | Telemetry::Parameter(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn newest_message_stays_and_the_module_clock_is_followed() {
        let mut board = Board::default();
        for (time_ns, now_ns) in [(10_000_000_000, 1), (9_000_000_000, 2), (1_000_000_000, 3)] {
            board.take(&Telemetry::Loops(Loops { time_ns, ..Loops::default() }), now_ns);
        }
        assert_eq!(board.loops.unwrap().message.time_ns, 1_000_000_000);
        assert_eq!((board.module_ns, board.module_restarts), (1_000_000_000, 1));
        assert_eq!(board.silence_ns(10), Some(7));
    }
}
