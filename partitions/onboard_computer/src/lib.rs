//! The function that reports the status and the supply voltages of the whole system.
//!
//! Responsible for: the primary and secondary telemetry. Flight does not depend on it, and it must never become
//! necessary: it only reads, and a function that says nothing is reported as off.

use bateleur_messages::telemetry::{Primary, Voltages};
use bateleur_messages::{Custom, FunctionStatus};

/// What the functions say about themselves; nothing where one has not spoken lately.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Functions {
    /// HILInterface.
    pub hil: Option<FunctionStatus>,
    /// Estimator.
    pub estimator: Option<FunctionStatus>,
    /// Controller.
    pub controller: Option<FunctionStatus>,
    /// Servo.
    pub servo: Option<FunctionStatus>,
}

/// The primary telemetry at module time `time_ns`.
pub fn primary(time_ns: u64, functions: &Functions) -> Primary {
    let servo_follows = enabled(&functions.servo) == 1 && ready(&functions.servo) == 1;
    Primary {
        time_ns,
        autopilot: u8::from(servo_follows),
        controller: enabled(&functions.controller),
        estimator_enabled: enabled(&functions.estimator),
        estimator_ready: ready(&functions.estimator),
        hil: enabled(&functions.hil),
        hil_ready: ready(&functions.hil),
        reserved: [0; 2],
    }
}

/// The secondary telemetry at module time `time_ns`. Voltages that nobody measures are 0 V: no value that stood for a
/// working battery an hour ago.
pub fn voltages(time_ns: u64, custom: Option<&Custom>) -> Voltages {
    let volts = |of: fn(&Custom) -> f64| custom.map(of).filter(|volts| volts.is_finite()).unwrap_or(0.0);
    Voltages {
        time_ns,
        main_v: volts(|custom| custom.main_v),
        backup_v: volts(|custom| custom.backup_v),
        actuator_board_v: volts(|custom| custom.actuator_board_v),
    }
}

fn enabled(status: &Option<FunctionStatus>) -> u8 {
    u8::from(status.is_some_and(|status| status.enabled == 1))
}

fn ready(status: &Option<FunctionStatus>) -> u8 {
    u8::from(status.is_some_and(|status| status.ready == 1))
}

#[cfg(test)]
mod tests {
    use super::*;

    const ON: Option<FunctionStatus> =
        Some(FunctionStatus { enabled: 1, ready: 1, accepted: 5, refused: 0, starts: 1 });

    #[test]
    fn every_function_shows_up_in_its_own_place() {
        let all = Functions { hil: ON, estimator: ON, controller: ON, servo: ON };
        let sum = |functions: &Functions| {
            let p = primary(9, functions);
            [p.autopilot, p.controller, p.estimator_enabled, p.estimator_ready, p.hil, p.hil_ready]
        };
        assert_eq!(sum(&all), [1; 6]);
        assert_eq!(sum(&Functions { hil: None, ..all }), [1, 1, 1, 1, 0, 0]);
        assert_eq!(sum(&Functions { estimator: None, ..all }), [1, 1, 0, 0, 1, 1]);
        assert_eq!(sum(&Functions { controller: None, ..all }), [1, 0, 1, 1, 1, 1]);
        assert_eq!(sum(&Functions { servo: None, ..all }), [0, 1, 1, 1, 1, 1]);
    }

    #[test]
    fn an_enabled_function_that_is_not_ready_is_told_apart() {
        let waiting = ON.map(|status| FunctionStatus { ready: 0, ..status });
        let report = primary(9, &Functions { estimator: waiting, servo: waiting, ..Functions::default() });
        assert_eq!((report.estimator_enabled, report.estimator_ready, report.autopilot), (1, 0, 0));
    }

    #[test]
    fn voltages_pass_through_and_what_nobody_measures_is_zero() {
        let custom = Custom { main_v: 12.4, backup_v: f64::NAN, actuator_board_v: 5.1, ..Default::default() };
        let report = voltages(9, Some(&custom));
        assert_eq!((report.main_v, report.backup_v, report.actuator_board_v), (12.4, 0.0, 5.1));
        assert_eq!(voltages(9, None).main_v, 0.0);
    }
}
