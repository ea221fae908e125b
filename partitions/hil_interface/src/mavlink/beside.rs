//! What comes beside the sensors: the safety pilot's sticks and the voltages, in messages of their own.

use bateleur_mavlink::common::{BATTERY_STATUS_DATA, HIL_RC_INPUTS_RAW_DATA, POWER_STATUS_DATA};
use bateleur_mavlink::hil::{BACKUP_BATTERY, MAIN_BATTERY, battery_v};
use bateleur_messages::Custom;

/// How long sticks stand, ns: a receiver that has lost its transmitter must not look like one that has not.
const STICKS_HOLD_NS: u64 = 100_000_000;
/// How long a voltage stands, ns: batteries are told about once in a second or two.
const VOLTS_HOLD_NS: u64 = 5_000_000_000;
const MILLI: f64 = 1e-3;

/// The latest of everything, each with the module time at which it came, ns.
#[derive(Debug, Clone, Default)]
pub(super) struct Beside {
    sticks: Option<([u16; 4], u64)>,
    main: Option<(f64, u64)>,
    backup: Option<(f64, u64)>,
    board: Option<(f64, u64)>,
    news: bool,
}

impl Beside {
    /// Sticks: aileron, elevator, throttle, rudder.
    pub(super) fn sticks(&mut self, message: &HIL_RC_INPUTS_RAW_DATA, now_ns: u64) {
        let channels = [message.chan1_raw, message.chan2_raw, message.chan3_raw, message.chan4_raw];
        (self.sticks, self.news) = (Some((channels, now_ns)), true);
    }

    /// A battery; others than the two are passed over.
    pub(super) fn battery(&mut self, message: &BATTERY_STATUS_DATA, now_ns: u64) {
        let place = match message.id {
            MAIN_BATTERY => &mut self.main,
            BACKUP_BATTERY => &mut self.backup,
            _ => return,
        };
        *place = battery_v(message).map(|volts| (volts, now_ns));
        self.news = true;
    }

    /// The supply of the actuators.
    pub(super) fn power(&mut self, message: &POWER_STATUS_DATA, now_ns: u64) {
        (self.board, self.news) = (Some((f64::from(message.Vservo) * MILLI, now_ns)), true);
    }

    /// What is to be published at module time `now_ns`, if anything is new.
    pub(super) fn publish(&mut self, now_ns: u64) -> Option<Custom> {
        if !std::mem::take(&mut self.news) {
            return None;
        }
        let sticks = self.sticks.filter(|(_, at_ns)| now_ns.saturating_sub(*at_ns) <= STICKS_HOLD_NS);
        let [pilot_aileron_us, pilot_elevator_us, pilot_throttle_us, pilot_rudder_us] =
            sticks.map_or([0; 4], |(channels, _)| channels);
        let volts = |volts: Option<(f64, u64)>| {
            let fresh = volts.filter(|(_, at_ns)| now_ns.saturating_sub(*at_ns) <= VOLTS_HOLD_NS);
            fresh.map_or(f64::NAN, |(volts, _)| volts)
        };
        Some(Custom {
            measured_ns: now_ns,
            pilot_aileron_us,
            pilot_elevator_us,
            pilot_rudder_us,
            pilot_throttle_us,
            main_v: volts(self.main),
            backup_v: volts(self.backup),
            actuator_board_v: volts(self.board),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_mavlink::common::MavMessage;
    use bateleur_mavlink::hil;

    const CYCLE: u64 = 20_000_000;

    fn sticks() -> HIL_RC_INPUTS_RAW_DATA {
        HIL_RC_INPUTS_RAW_DATA {
            chan1_raw: 1510,
            chan2_raw: 1490,
            chan3_raw: 1700,
            chan4_raw: 1505,
            ..HIL_RC_INPUTS_RAW_DATA::DEFAULT
        }
    }

    #[test]
    fn sticks_and_voltages_find_their_places() {
        let mut beside = Beside::default();
        assert_eq!(beside.publish(CYCLE), None);
        beside.sticks(&sticks(), CYCLE);
        let MavMessage::BATTERY_STATUS(battery) = hil::battery(BACKUP_BATTERY, 8.2) else { panic!() };
        beside.battery(&battery, CYCLE);
        beside.battery(&BATTERY_STATUS_DATA { id: 7, ..battery }, CYCLE);
        beside.power(&POWER_STATUS_DATA { Vservo: 5_010, ..POWER_STATUS_DATA::DEFAULT }, CYCLE);
        let custom = beside.publish(CYCLE).unwrap();
        assert_eq!((custom.pilot_aileron_us, custom.pilot_elevator_us), (1510, 1490));
        assert_eq!((custom.pilot_throttle_us, custom.pilot_rudder_us), (1700, 1505));
        assert!(custom.main_v.is_nan());
        assert_eq!((custom.backup_v, custom.actuator_board_v), (8.2, 5.01));
        assert_eq!(beside.publish(2 * CYCLE), None);
    }

    #[test]
    fn sticks_that_no_longer_come_are_no_pulses_while_voltages_go_on() {
        let mut beside = Beside::default();
        beside.sticks(&sticks(), CYCLE);
        beside.power(&POWER_STATUS_DATA { Vservo: 5_000, ..POWER_STATUS_DATA::DEFAULT }, 10 * CYCLE);
        let custom = beside.publish(10 * CYCLE).unwrap();
        assert_eq!((custom.pilot_aileron_us, custom.actuator_board_v), (0, 5.0));
    }
}
