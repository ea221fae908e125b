//! One sensor set out of the sensor messages of a window.
//!
//! Each message says which of its fields are new. Forces and rates of several messages become means over the time that they cover. A
//! pressure or temperature that is not new stands for a tenth of a second. Whatever is missing then is marked: it is not a number,
//! which the functions behind take for "not measured".

use bateleur_mavlink::common::{HIL_SENSOR_DATA, HilSensorUpdatedFlags as Flags};
use bateleur_mavlink::hil::{CELSIUS_ZERO_K, PA_PER_HPA, accelerometer, gyroscope, magnetometer};
use bateleur_messages::RawAnalog;

/// How long a pressure may stand, ns. Pressure sensors are read more slowly than others; an aircraft at 22 m/s climbs no
/// further than 1 m in this time.
const HOLD_NS: u64 = 100_000_000;
const NOT_MEASURED: f64 = f64::NAN;

/// A mean over the time since the last published one.
#[derive(Debug, Clone, Copy, Default)]
struct Mean {
    sum: [f64; 3],
    span_ns: u64,
    latest: Option<[f64; 3]>,
    previous_ns: Option<u64>,
}

impl Mean {
    fn take(&mut self, value: [f64; 3], at_ns: u64) {
        let before_ns = self.previous_ns.replace(at_ns);
        let step_ns = before_ns.map_or(0, |before_ns| at_ns.saturating_sub(before_ns));
        self.span_ns += step_ns;
        self.latest = Some(value);
        for (sum, value) in self.sum.iter_mut().zip(value) {
            *sum += value * step_ns as f64;
        }
    }

    /// The mean and its span, ns; begins anew.
    fn publish(&mut self) -> ([f64; 3], u64) {
        let published = match self.latest {
            None => ([NOT_MEASURED; 3], 0),
            Some(latest) if self.span_ns == 0 => (latest, 0),
            Some(_) => (self.sum.map(|sum| sum / self.span_ns as f64), self.span_ns),
        };
        *self = Self { previous_ns: self.previous_ns, ..Self::default() };
        published
    }
}

/// A value that may stand for a while.
#[derive(Debug, Clone, Copy, Default)]
struct Held(Option<(f64, u64)>);

impl Held {
    fn at(&self, time_ns: u64) -> f64 {
        self.0
            .filter(|(_, at_ns)| time_ns.saturating_sub(*at_ns) <= HOLD_NS)
            .map_or(NOT_MEASURED, |(value, _)| value)
    }
}

/// The sensors of one simulator.
#[derive(Debug, Clone, Default)]
pub(super) struct Assembly {
    force: Mean,
    rates: Mean,
    field: Option<[f64; 3]>,
    static_pa: Held,
    differential_pa: Held,
    temperature_k: Held,
    /// Time of the newest message since the last publication, ns.
    news_ns: Option<u64>,
}

impl Assembly {
    /// Takes a message that was measured at module time `at_ns`; gives how many of its new values are no numbers.
    pub(super) fn take(&mut self, message: &HIL_SENSOR_DATA, at_ns: u64) -> u64 {
        let mut invalid = 0;
        let mut vector = |all: Flags, value: [f32; 3]| {
            let value = message.fields_updated.contains(all).then_some(value.map(f64::from))?;
            let sound = value.iter().all(|component| component.is_finite());
            invalid += u64::from(!sound);
            sound.then_some(value)
        };
        let force = vector(accelerometer(), [message.xacc, message.yacc, message.zacc]);
        let rates = vector(gyroscope(), [message.xgyro, message.ygyro, message.zgyro]);
        let field = vector(magnetometer(), [message.xmag, message.ymag, message.zmag]);
        let mut scalar = |place: &mut Held, flag: Flags, value: f32, scale: f64, zero: f64| {
            if !message.fields_updated.contains(flag) {
                return;
            }
            match value.is_finite() {
                true => place.0 = Some((f64::from(value) * scale + zero, at_ns)),
                false => invalid += 1,
            }
        };
        scalar(
            &mut self.static_pa,
            Flags::HIL_SENSOR_UPDATED_ABS_PRESSURE,
            message.abs_pressure,
            PA_PER_HPA,
            0.0,
        );
        scalar(
            &mut self.differential_pa,
            Flags::HIL_SENSOR_UPDATED_DIFF_PRESSURE,
            message.diff_pressure,
            PA_PER_HPA,
            0.0,
        );
        scalar(
            &mut self.temperature_k,
            Flags::HIL_SENSOR_UPDATED_TEMPERATURE,
            message.temperature,
            1.0,
            CELSIUS_ZERO_K,
        );
        force.into_iter().for_each(|force| self.force.take(force, at_ns));
        rates.into_iter().for_each(|rates| self.rates.take(rates, at_ns));
        self.field = field.or(self.field);
        self.news_ns = Some(at_ns);
        invalid
    }

    /// The sensor set since the last one, if there is anything new.
    pub(super) fn publish(&mut self) -> Option<RawAnalog> {
        let measured_ns = self.news_ns.take()?;
        let (specific_force_mps2, force_ns) = self.force.publish();
        let (rates_radps, rates_ns) = self.rates.publish();
        Some(RawAnalog {
            measured_ns,
            interval_ns: force_ns.max(rates_ns),
            specific_force_mps2,
            rates_radps,
            field_gauss: self.field.take().unwrap_or([NOT_MEASURED; 3]),
            static_pressure_pa: self.static_pa.at(measured_ns),
            differential_pressure_pa: self.differential_pa.at(measured_ns),
            temperature_k: self.temperature_k.at(measured_ns),
        })
    }

    /// The simulator's clock was tied anew: what was measured before belongs to another time.
    pub(super) fn reset(&mut self) {
        *self = Self::default();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_mavlink::hil::all_updated;

    const CYCLE: u64 = 20_000_000;

    fn standing(fields_updated: Flags) -> HIL_SENSOR_DATA {
        HIL_SENSOR_DATA {
            zacc: -9.81,
            xgyro: 0.5,
            xmag: 0.1,
            ymag: -0.05,
            zmag: -0.23,
            abs_pressure: 1013.25,
            diff_pressure: 2.9,
            temperature: 15.0,
            fields_updated,
            ..HIL_SENSOR_DATA::DEFAULT
        }
    }

    #[test]
    fn units_become_those_of_the_ports() {
        let mut assembly = Assembly::default();
        assembly.take(&standing(all_updated()), CYCLE);
        let first = assembly.publish().unwrap();
        assert_eq!((first.measured_ns, first.interval_ns), (CYCLE, 0));
        assembly.take(&standing(all_updated()), 2 * CYCLE);
        let set = assembly.publish().unwrap();
        assert_eq!((set.measured_ns, set.interval_ns), (2 * CYCLE, CYCLE));
        assert!((set.specific_force_mps2[2] + 9.81).abs() < 1e-6);
        assert!((set.static_pressure_pa - 101_325.0).abs() < 0.01);
        assert!((set.differential_pressure_pa - 290.0).abs() < 1e-4);
        assert!((set.temperature_k - 288.15).abs() < 1e-5);
        assert!((set.field_gauss[2] + 0.23).abs() < 1e-6);
        assert_eq!(assembly.publish(), None);
    }

    #[test]
    fn several_steps_become_one_mean_over_all_of_them() {
        let mut assembly = Assembly::default();
        assembly.take(&standing(all_updated()), CYCLE);
        assembly.publish();
        for (step, xgyro) in [1.0, 2.0, 3.0, 4.0, 5.0].into_iter().enumerate() {
            let at_ns = CYCLE + (step as u64 + 1) * 4_000_000;
            assembly.take(&HIL_SENSOR_DATA { xgyro, ..standing(all_updated()) }, at_ns);
        }
        let set = assembly.publish().unwrap();
        assert_eq!((set.measured_ns, set.interval_ns), (2 * CYCLE, CYCLE));
        assert!((set.rates_radps[0] - 3.0).abs() < 1e-12);
    }

    #[test]
    fn what_is_not_new_is_not_measured_except_pressures_for_a_tenth_of_a_second() {
        let inertial = accelerometer() | gyroscope();
        let mut assembly = Assembly::default();
        assembly.take(&standing(all_updated()), CYCLE);
        assembly.publish();
        for cycle in 2..=6 {
            assembly.take(&standing(inertial), cycle * CYCLE);
            let set = assembly.publish().unwrap();
            assert!(set.field_gauss[0].is_nan() && set.static_pressure_pa.is_finite());
            assert!(set.differential_pressure_pa.is_finite() && set.temperature_k.is_finite());
        }
        assembly.take(&standing(inertial), 7 * CYCLE);
        let set = assembly.publish().unwrap();
        assert!(set.static_pressure_pa.is_nan() && set.differential_pressure_pa.is_nan());
        assembly.take(&standing(magnetometer()), 8 * CYCLE);
        let set = assembly.publish().unwrap();
        assert!(set.rates_radps[0].is_nan() && set.field_gauss[0].is_finite());
        assert_eq!(set.interval_ns, 0);
        // Two cycles later, forces and rates cover both.
        assembly.take(&standing(inertial), 9 * CYCLE);
        assert_eq!(assembly.publish().unwrap().interval_ns, 2 * CYCLE);
    }

    #[test]
    fn half_a_vector_is_none() {
        let mut assembly = Assembly::default();
        let half = Flags::HIL_SENSOR_UPDATED_XACC | Flags::HIL_SENSOR_UPDATED_YACC;
        assert_eq!(assembly.take(&standing(half), CYCLE), 0);
        assert!(assembly.publish().unwrap().specific_force_mps2[0].is_nan());
    }

    #[test]
    fn what_is_no_number_costs_its_own_sensor_alone() {
        let mut assembly = Assembly::default();
        assembly.take(&standing(all_updated()), CYCLE);
        assembly.publish();
        let broken =
            HIL_SENSOR_DATA { ygyro: f32::NAN, abs_pressure: f32::INFINITY, ..standing(all_updated()) };
        assert_eq!(assembly.take(&broken, 2 * CYCLE), 2);
        let set = assembly.publish().unwrap();
        assert!(set.rates_radps[0].is_nan() && set.specific_force_mps2[2] < -9.0);
        assert!((set.static_pressure_pa - 101_325.0).abs() < 0.01, "the last sound one stands");
    }
}
