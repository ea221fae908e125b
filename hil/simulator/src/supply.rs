//! The batteries: slow enough to be believable, simple enough to be known by heart.

use bateleur_plant::Airframe;
use bateleur_plant::airframe::Propulsion;

/// Main battery of an aircraft with an engine, V: it feeds the electronics alone.
const ENGINE_MAIN_V: f64 = 12.6;
/// Full backup battery, V (two lithium cells).
const BACKUP_V: f64 = 8.2;
/// Regulated supply of the actuator board, V.
const BOARD_V: f64 = 5.0;
/// Full throttle until the main battery is empty, s. A two-lap flight uses about a tenth.
const FULL_THROTTLE_S: f64 = 2400.0;
/// What the electronics draw, as a share of full throttle.
const IDLE_SHARE: f64 = 0.03;
/// Voltage lost between full and empty, share.
const DISCHARGE_DROP: f64 = 0.15;
/// Voltage lost to the inner resistance at full throttle, share.
const LOAD_DROP: f64 = 0.04;
/// Loss of the backup battery, V/s.
const BACKUP_DROP_VPS: f64 = 2.0e-5;
/// Loss of the actuator board's supply at full throttle, V.
const BOARD_DROP_V: f64 = 0.05;

/// The supply of one aircraft.
#[derive(Debug, Clone)]
pub(crate) struct Supply {
    full_v: f64,
    used: f64,
    throttle: f64,
    time_s: f64,
}

/// Voltages of one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Volts {
    pub(crate) main: f64,
    pub(crate) backup: f64,
    pub(crate) actuator_board: f64,
}

impl Supply {
    pub(crate) fn new(airframe: &Airframe) -> Self {
        let full_v = match airframe.propulsion {
            Propulsion::Electric { battery_voltage_v, .. } => battery_voltage_v,
            Propulsion::Piston { .. } => ENGINE_MAIN_V,
        };
        Self { full_v, used: 0.0, throttle: 0.0, time_s: 0.0 }
    }

    /// Draws for `dt_s` seconds at a throttle of 0 to 1.
    pub(crate) fn draw(&mut self, throttle: f64, dt_s: f64) {
        self.throttle = throttle;
        self.time_s += dt_s;
        self.used = (self.used + (IDLE_SHARE + throttle) * dt_s / FULL_THROTTLE_S).min(1.0);
    }

    /// From here on it holds no more than this share of its charge.
    pub(crate) fn drain(&mut self, left: f64) {
        self.used = self.used.max(1.0 - left);
    }

    pub(crate) fn volts(&self) -> Volts {
        Volts {
            main: self.full_v * (1.0 - DISCHARGE_DROP * self.used - LOAD_DROP * self.throttle),
            backup: (BACKUP_V - BACKUP_DROP_VPS * self.time_s).max(0.0),
            actuator_board: BOARD_V - BOARD_DROP_V * self.throttle,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn voltage_falls_with_throttle_and_with_time() {
        let mut supply = Supply::new(&Airframe::aerosonde());
        let fresh = supply.volts();
        supply.draw(1.0, 60.0);
        let loaded = supply.volts();
        supply.draw(0.0, 60.0);
        let rested = supply.volts();
        assert!(loaded.main < rested.main && rested.main < fresh.main);
        assert!(loaded.main > 0.9 * fresh.main && rested.backup < fresh.backup);
    }
}
