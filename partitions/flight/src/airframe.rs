//! What the laws need to know of an aircraft, read from the same file as the plant reads.
//!
//! Sections `[mass]`, `[geometry]`, `[aerodynamics]`, `[propulsion]`, `[servo]`, `[gear]`; anything else is ignored, so that
//! the plant may keep its own keys in the same file. SI units, derivatives per rad.

use crate::GRAVITY_MPS2;
use crate::servo::ServoMap;
use serde::Deserialize;
use std::f64::consts::TAU;
use thiserror::Error;

/// Why an airframe file cannot be used.
#[derive(Debug, Error)]
pub enum AirframeError {
    /// Not TOML, or a key is missing or no number; the text names line and column.
    #[error("the airframe file cannot be read: {0}")]
    Syntax(#[from] toml::de::Error),
    /// A value with which no gain can be computed.
    #[error("the airframe's `{key}` is {value}: the laws need {demand}")]
    Value {
        /// Section and key.
        key: &'static str,
        /// Value found.
        value: f64,
        /// What would do.
        demand: &'static str,
    },
    /// No throttle keeps the aircraft level.
    #[error(
        "the airframe cannot hold level flight at {airspeed_mps} m/s: full throttle gives {thrust_n:.1} N, it takes {drag_n:.1} N"
    )]
    Power {
        /// Airspeed tried, m/s.
        airspeed_mps: f64,
        /// Thrust at full throttle, N.
        thrust_n: f64,
        /// Drag, N.
        drag_n: f64,
    },
}

/// Mass and inertia.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Mass {
    /// kg.
    pub mass_kg: f64,
    /// About the body's x axis, kg m².
    pub inertia_xx_kgm2: f64,
    /// About the body's y axis, kg m².
    pub inertia_yy_kgm2: f64,
    /// About the body's z axis, kg m².
    pub inertia_zz_kgm2: f64,
}

/// Reference lengths of the coefficients.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Geometry {
    /// m².
    pub wing_area_m2: f64,
    /// m.
    pub wing_span_m: f64,
    /// m.
    pub mean_chord_m: f64,
}

/// The derivatives that appear in the gains, effect first, cause second.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Aerodynamics {
    /// C_L0.
    pub lift_0: f64,
    /// C_Lα.
    pub lift_alpha: f64,
    /// C_Lq.
    pub lift_pitch_rate: f64,
    /// C_Lδe.
    pub lift_elevator: f64,
    /// C_D at zero lift.
    pub drag_0: f64,
    /// Factor of C_L² in C_D.
    pub drag_induced: f64,
    /// C_D per rad of |α|.
    #[serde(default)]
    pub drag_alpha: f64,
    /// C_D per rad of |δe|.
    #[serde(default)]
    pub drag_elevator: f64,
    /// C_lp.
    pub roll_roll_rate: f64,
    /// C_lδa, positive.
    pub roll_aileron: f64,
    /// C_m0.
    pub pitch_0: f64,
    /// C_mα, negative.
    pub pitch_alpha: f64,
    /// C_mq.
    pub pitch_pitch_rate: f64,
    /// C_mα̇.
    #[serde(default)]
    pub pitch_alpha_rate: f64,
    /// C_mδe, negative.
    pub pitch_elevator: f64,
    /// C_nβ.
    pub yaw_beta: f64,
    /// C_np.
    #[serde(default)]
    pub yaw_roll_rate: f64,
    /// C_nδa.
    #[serde(default)]
    pub yaw_aileron: f64,
    /// C_nr.
    pub yaw_yaw_rate: f64,
    /// C_nδr, of either sign.
    pub yaw_rudder: f64,
    /// Half way between attached flow and flat plate, rad.
    pub stall_alpha_rad: f64,
    /// How sharp that is, 1/rad.
    pub stall_sharpness: f64,
}

/// Propeller coefficients over the advance ratio J = V/(nD).
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Propeller {
    /// m.
    pub diameter_m: f64,
    /// C_T at J = 0.
    pub thrust_0: f64,
    /// Factor of J in C_T.
    pub thrust_1: f64,
    /// Factor of J² in C_T.
    pub thrust_2: f64,
    /// C_Q at J = 0.
    pub torque_0: f64,
    /// Factor of J in C_Q.
    pub torque_1: f64,
    /// Factor of J² in C_Q.
    pub torque_2: f64,
}

/// What drives the propeller.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
pub enum Propulsion {
    /// A direct-current motor whose voltage follows the throttle.
    Electric {
        /// Speed constant, rpm/V.
        motor_kv_rpm_per_v: f64,
        /// V.
        battery_voltage_v: f64,
        /// Ω.
        winding_resistance_ohm: f64,
        /// A.
        no_load_current_a: f64,
        /// Lag of the thrust behind the throttle, s.
        lag_s: f64,
        /// The propeller.
        propeller: Propeller,
    },
    /// An engine whose torque follows the throttle.
    Piston {
        /// Power at the rated speed, W.
        power_w: f64,
        /// Rated speed, rad/s.
        rated_speed_radps: f64,
        /// N m.
        friction_torque_nm: f64,
        /// Lag of the thrust behind the throttle, s.
        lag_s: f64,
        /// The propeller.
        propeller: Propeller,
    },
}

/// Actuators.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Servo {
    /// Corner frequency, rad/s.
    pub bandwidth_radps: f64,
    /// Dead time, s.
    pub delay_s: f64,
    /// rad.
    pub aileron_limit_rad: f64,
    /// rad.
    pub elevator_limit_rad: f64,
    /// rad.
    pub rudder_limit_rad: f64,
    /// Full width of the play in the linkages, rad.
    #[serde(default)]
    pub backlash_rad: f64,
}

/// What of the wheels matters to take-off and landing.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Gear {
    /// The steered wheel, body axes, m: ahead of the centre of gravity or behind it.
    pub third_wheel_m: [f64; 3],
    /// The right main wheel, body axes, m, where the file has it.
    pub main_wheel_m: Option<[f64; 3]>,
}

/// An aircraft as the laws see it.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct Airframe {
    /// Mass and inertia.
    pub mass: Mass,
    /// Reference lengths.
    pub geometry: Geometry,
    /// Derivatives.
    pub aerodynamics: Aerodynamics,
    /// Motor and propeller.
    pub propulsion: Propulsion,
    /// Actuators.
    pub servo: Servo,
    /// Wheels; an aircraft without them is launched.
    #[serde(default)]
    pub gear: Option<Gear>,
}

/// Level flight without wind.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Trim {
    /// Angle of attack, rad.
    pub alpha_rad: f64,
    /// Elevator, rad.
    pub elevator_rad: f64,
    /// Throttle, 0 to 1.
    pub throttle: f64,
}

/// Airspeed at which a file is checked, m/s: the mission's. An aircraft that does not fly at it is checked where it has most thrust to spare.
const CHECK_AIRSPEED_MPS: f64 = 22.0;
/// Least airspeed for that, of the one at which the wing just carries the weight.
const CHECK_SHARE: f64 = 1.3;
/// A wing that gives no more lift than this carries nothing.
const LEAST_LIFT: f64 = 0.1;
/// No airframe is asked for more, m/s.
const FASTEST_MPS: f64 = 100.0;

/// The airframes that are built in, by name.
pub const BUILT_IN: [(&str, &str); 5] = [
    ("aerosonde", include_str!("../../../airframes/aerosonde.toml")),
    ("rascal110", include_str!("../../../airframes/rascal110.toml")),
    ("ultrastick25e", include_str!("../../../airframes/ultrastick25e.toml")),
    ("vtail60", include_str!("../../../airframes/vtail60.toml")),
    ("zagi", include_str!("../../../airframes/zagi.toml")),
];

/// The text of a built-in airframe, by its name.
pub fn built_in(name: &str) -> Option<&'static str> {
    BUILT_IN.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

impl Airframe {
    /// The airframe that a plan's attribute means: the name of a built-in one, the text of an airframe file (it has
    /// several lines), or the path of one, which `read` then reads: this crate opens no files.
    ///
    /// # Errors
    /// One sentence with the attribute and the mend.
    pub fn from_attribute(
        value: &str,
        read: impl FnOnce(&str) -> std::io::Result<String>,
    ) -> Result<Self, String> {
        let text = match built_in(value) {
            Some(text) => text.to_owned(),
            None if value.contains('\n') => value.to_owned(),
            None => read(value).map_err(|error| {
                let names = BUILT_IN.map(|(name, _)| format!("\"{name}\"")).join(", ");
                format!(
                    "attribute airframe = \"{value}\": {error}; name a readable TOML file, or one of {names}"
                )
            })?,
        };
        let title = value.lines().next().unwrap_or_default();
        Self::from_toml(&text).map_err(|error| format!("attribute airframe = \"{title}\": {error}"))
    }

    /// Reads and checks an airframe file.
    pub fn from_toml(text: &str) -> Result<Self, AirframeError> {
        let airframe: Self = toml::from_str(text)?;
        airframe.check()?;
        Ok(airframe)
    }

    fn check(&self) -> Result<(), AirframeError> {
        let (m, g, a, s) = (&self.mass, &self.geometry, &self.aerodynamics, &self.servo);
        let positive = [
            ("mass.mass_kg", m.mass_kg),
            ("mass.inertia_xx_kgm2", m.inertia_xx_kgm2),
            ("mass.inertia_yy_kgm2", m.inertia_yy_kgm2),
            ("mass.inertia_zz_kgm2", m.inertia_zz_kgm2),
            ("geometry.wing_area_m2", g.wing_area_m2),
            ("geometry.wing_span_m", g.wing_span_m),
            ("geometry.mean_chord_m", g.mean_chord_m),
            ("aerodynamics.lift_alpha", a.lift_alpha),
            ("aerodynamics.roll_aileron", a.roll_aileron),
            ("aerodynamics.yaw_beta", a.yaw_beta),
            ("servo.bandwidth_radps", s.bandwidth_radps),
        ];
        let negative = [
            ("aerodynamics.pitch_alpha", a.pitch_alpha),
            ("aerodynamics.pitch_elevator", a.pitch_elevator),
            ("aerodynamics.roll_roll_rate", a.roll_roll_rate),
        ];
        for (key, value) in positive {
            demand(key, value, value > 0.0, "a positive number")?;
        }
        for (key, value) in negative {
            demand(key, value, value < 0.0, "a negative number")?;
        }
        let travels = [
            ("servo.aileron_limit_rad", s.aileron_limit_rad),
            ("servo.elevator_limit_rad", s.elevator_limit_rad),
            ("servo.rudder_limit_rad", s.rudder_limit_rad),
        ];
        for (key, value) in travels {
            demand(key, value, value > 0.0 && value <= 1.2, "radians, greater than zero and 1.2 at most")?;
        }
        let turns = a.yaw_rudder == 0.0 || a.yaw_rudder.abs() > 1e-4;
        demand(
            "aerodynamics.yaw_rudder",
            a.yaw_rudder,
            turns,
            "a rudder that turns, or zero where there is none",
        )?;
        let lift = self.greatest_lift();
        demand(
            "aerodynamics.lift_0",
            a.lift_0,
            lift > LEAST_LIFT,
            "more: the wing never gives a lift coefficient of 0.1",
        )?;
        self.check_power()
    }

    /// Airspeed (m/s) that full throttle just holds level, at sea level; higher up it is about the same with a motor, and more
    /// with an engine.
    pub fn fastest_mps(&self) -> f64 {
        let density = crate::atmosphere::SEA_LEVEL_DENSITY_KGPM3;
        let (mut low, mut high) = (self.check_airspeed_mps(), FASTEST_MPS);
        for _ in 0..24 {
            let middle = 0.5 * (low + high);
            if self.thrust_n(1.0, middle, density) > self.level_drag_n(middle, density) {
                low = middle;
            } else {
                high = middle;
            }
        }
        low
    }

    fn check_power(&self) -> Result<(), AirframeError> {
        let density = crate::atmosphere::SEA_LEVEL_DENSITY_KGPM3;
        let airspeed_mps = self.check_airspeed_mps();
        let drag_n = self.level_drag_n(airspeed_mps, density);
        let thrust_n = self.thrust_n(1.0, airspeed_mps, density);
        if thrust_n > drag_n {
            return Ok(());
        }
        Err(AirframeError::Power { airspeed_mps, thrust_n, drag_n })
    }

    /// Airspeed (m/s) at which full throttle has to hold it level, at sea level.
    fn check_airspeed_mps(&self) -> f64 {
        let density = crate::atmosphere::SEA_LEVEL_DENSITY_KGPM3;
        let spare_n = |airspeed_mps: &f64| {
            self.thrust_n(1.0, *airspeed_mps, density) - self.level_drag_n(*airspeed_mps, density)
        };
        let slowest_mps = CHECK_SHARE * self.stall_mps(self.greatest_lift(), density);
        if slowest_mps <= CHECK_AIRSPEED_MPS && spare_n(&CHECK_AIRSPEED_MPS) > 0.0 {
            return CHECK_AIRSPEED_MPS;
        }
        let airspeeds = (0..).map(|step| slowest_mps + 0.5 * f64::from(step));
        let airspeeds = airspeeds.take_while(|airspeed_mps| *airspeed_mps < FASTEST_MPS);
        airspeeds.max_by(|one, other| spare_n(one).total_cmp(&spare_n(other))).unwrap_or(slowest_mps)
    }

    /// Airspeed (m/s) at which the wing just carries the weight with a lift coefficient.
    pub fn stall_mps(&self, greatest_lift: f64, density_kgpm3: f64) -> f64 {
        let weight = self.mass.mass_kg * GRAVITY_MPS2;
        (2.0 * weight / (density_kgpm3 * self.geometry.wing_area_m2 * greatest_lift)).sqrt()
    }

    /// Travel of the surfaces, for the timer values.
    pub fn servo_map(&self) -> ServoMap {
        ServoMap {
            aileron_limit_rad: self.servo.aileron_limit_rad,
            elevator_limit_rad: self.servo.elevator_limit_rad,
            rudder_limit_rad: self.servo.rudder_limit_rad,
        }
    }

    /// Lag of the thrust behind the throttle, s.
    pub fn thrust_lag_s(&self) -> f64 {
        match self.propulsion {
            Propulsion::Electric { lag_s, .. } | Propulsion::Piston { lag_s, .. } => lag_s,
        }
    }

    /// Thrust (N) where motor and propeller torque balance: a quadratic in the shaft speed Ω, since the propeller's
    /// torque is ρD⁵(C_Q0 n² + C_Q1 n V/D + C_Q2 V²/D²) with n = Ω/2π and the motor's falls linearly with Ω.
    pub fn thrust_n(&self, throttle: f64, airspeed_mps: f64, density_kgpm3: f64) -> f64 {
        let (torque_nm, fall, propeller) = self.motor(throttle);
        let (d, v) = (propeller.diameter_m, airspeed_mps.max(0.0));
        let scale = density_kgpm3 * d * d * d;
        let square = scale * propeller.torque_0 * (d / TAU) * (d / TAU);
        let linear = scale * propeller.torque_1 * (d / TAU) * v + fall;
        let constant = scale * propeller.torque_2 * v * v - torque_nm;
        let discriminant = (linear * linear - 4.0 * square * constant).max(0.0);
        let speed = ((discriminant.sqrt() - linear) / (2.0 * square)).max(0.0);
        let tip = speed * d / TAU;
        let shape =
            propeller.thrust_0 * tip * tip + propeller.thrust_1 * tip * v + propeller.thrust_2 * v * v;
        density_kgpm3 * d * d * shape
    }

    /// Torque at standstill (N m), its fall per shaft speed (N m s), and the propeller.
    fn motor(&self, throttle: f64) -> (f64, f64, &Propeller) {
        match &self.propulsion {
            Propulsion::Electric {
                motor_kv_rpm_per_v,
                battery_voltage_v,
                winding_resistance_ohm,
                no_load_current_a,
                propeller,
                ..
            } => {
                let constant = 60.0 / (TAU * motor_kv_rpm_per_v);
                let current = throttle * battery_voltage_v / winding_resistance_ohm - no_load_current_a;
                (constant * current, constant * constant / winding_resistance_ohm, propeller)
            }
            Propulsion::Piston { power_w, rated_speed_radps, friction_torque_nm, propeller, .. } => {
                let full = power_w / rated_speed_radps + friction_torque_nm;
                (throttle * full - friction_torque_nm, 0.0, propeller)
            }
        }
    }

    /// ∂A/∂throttle (m/s²) by central difference about a throttle.
    pub fn thrust_slope_mps2(&self, throttle: f64, airspeed_mps: f64, density_kgpm3: f64) -> f64 {
        let middle = throttle.clamp(0.15, 0.85);
        let thrust = |t: f64| self.thrust_n(t, airspeed_mps, density_kgpm3);
        // A motor near idle gives almost no slope; a gain of one tenth of the weight bounds what divides by it.
        ((thrust(middle + 0.1) - thrust(middle - 0.1)) / (0.2 * self.mass.mass_kg)).max(0.1 * GRAVITY_MPS2)
    }

    /// The greatest lift coefficient: straight lift, blended into that of a flat plate beyond the stall.
    pub fn greatest_lift(&self) -> f64 {
        let a = &self.aerodynamics;
        let lift = |step: u32| {
            let alpha = 2e-3 * f64::from(step);
            let attached = 1.0 / (1.0 + (a.stall_sharpness * (alpha - a.stall_alpha_rad)).exp());
            let plate = 2.0 * alpha.sin() * alpha.sin() * alpha.cos();
            attached * (a.lift_0 + a.lift_alpha * alpha) + (1.0 - attached) * plate
        };
        (0..750).map(lift).fold(0.0, f64::max)
    }

    /// Steady roll rate at full aileron for each m/s of airspeed, rad/m: the aileron's moment against the roll's own damping,
    /// p b/2V = −C_lδa δa/C_lp.
    pub fn roll_per_airspeed(&self) -> f64 {
        let a = &self.aerodynamics;
        -2.0 * a.roll_aileron * self.servo.aileron_limit_rad / (a.roll_roll_rate * self.geometry.wing_span_m)
    }

    /// A flying wing, as a rule, has none: it is turned by its bank, and steadied by its fins.
    pub fn has_rudder(&self) -> bool {
        self.aerodynamics.yaw_rudder != 0.0
    }

    /// Rudder (rad) against the yaw that aileron and roll make to the wrong side: −(C_nδa δa + C_np p b/2V)/C_nδr, of each
    /// coefficient what is adverse. Where rolling yaws to the right side (C_np > 0), it counters the aileron as much as it does in a
    /// steady roll.
    pub fn coordinating_rudder(&self, aileron_rad: f64, roll_rate_radps: f64, airspeed_mps: f64) -> f64 {
        if !self.has_rudder() {
            return 0.0;
        }
        let (a, span) = (&self.aerodynamics, self.geometry.wing_span_m);
        let helps = a.yaw_roll_rate.max(0.0) * a.roll_aileron / a.roll_roll_rate.abs();
        let aileron = (a.yaw_aileron + helps).min(0.0) * aileron_rad;
        let roll = a.yaw_roll_rate.min(0.0) * roll_rate_radps * span / (2.0 * airspeed_mps);
        -(aileron + roll) / a.yaw_rudder
    }

    fn level_lift_coefficient(&self, airspeed_mps: f64, density_kgpm3: f64) -> f64 {
        let pressure = 0.5 * density_kgpm3 * airspeed_mps * airspeed_mps;
        self.mass.mass_kg * GRAVITY_MPS2 / (pressure * self.geometry.wing_area_m2)
    }

    fn level_drag_n(&self, airspeed_mps: f64, density_kgpm3: f64) -> f64 {
        self.drag_n(airspeed_mps, density_kgpm3, -GRAVITY_MPS2)
    }

    /// Drag (N) at the lift that a normal specific acceleration (m/s², −9.8 in level flight) takes.
    pub fn drag_n(&self, airspeed_mps: f64, density_kgpm3: f64, normal_mps2: f64) -> f64 {
        let lift = self.level_lift_coefficient(airspeed_mps, density_kgpm3) * normal_mps2 / GRAVITY_MPS2;
        let pressure = 0.5 * density_kgpm3 * airspeed_mps * airspeed_mps;
        let drag = self.aerodynamics.drag_0 + self.aerodynamics.drag_induced * lift * lift;
        pressure * self.geometry.wing_area_m2 * drag
    }

    /// The same with what angle of attack and elevator cost beyond the polar: much, where a wing is trimmed without a tail.
    pub fn trimmed_drag_n(&self, airspeed_mps: f64, density_kgpm3: f64, normal_mps2: f64) -> f64 {
        let a = &self.aerodynamics;
        let lift = self.level_lift_coefficient(airspeed_mps, density_kgpm3) * -normal_mps2 / GRAVITY_MPS2;
        let (alpha_rad, elevator_rad) = self.attitude_for(lift);
        let pressure = 0.5 * density_kgpm3 * airspeed_mps * airspeed_mps;
        let further = a.drag_alpha * alpha_rad.abs() + a.drag_elevator * elevator_rad.abs();
        self.drag_n(airspeed_mps, density_kgpm3, normal_mps2)
            + pressure * self.geometry.wing_area_m2 * further
    }

    /// Angle of attack and elevator, rad, of a lift coefficient: lift and pitching moment are two linear equations in them.
    fn attitude_for(&self, lift: f64) -> (f64, f64) {
        let a = &self.aerodynamics;
        let determinant = a.lift_alpha * a.pitch_elevator - a.lift_elevator * a.pitch_alpha;
        let alpha_rad = ((lift - a.lift_0) * a.pitch_elevator + a.lift_elevator * a.pitch_0) / determinant;
        let elevator_rad = (-a.lift_alpha * a.pitch_0 - a.pitch_alpha * (lift - a.lift_0)) / determinant;
        (alpha_rad, elevator_rad)
    }

    /// Airspeed (m/s) at which it glides farthest, at sea level: induced drag is as large as the rest, C_L² = C_D0 / k.
    pub fn farthest_glide_mps(&self) -> f64 {
        let a = &self.aerodynamics;
        self.stall_mps((a.drag_0 / a.drag_induced).sqrt(), crate::atmosphere::SEA_LEVEL_DENSITY_KGPM3)
    }

    /// Angle of attack, elevator and throttle of level flight.
    pub fn trim(&self, airspeed_mps: f64, density_kgpm3: f64) -> Trim {
        let lift = self.level_lift_coefficient(airspeed_mps, density_kgpm3);
        let (alpha_rad, elevator_rad) = self.attitude_for(lift);
        Trim { alpha_rad, elevator_rad, throttle: self.level_throttle(airspeed_mps, density_kgpm3) }
    }

    /// Throttle at which thrust equals drag, by bisection (thrust grows with the throttle).
    fn level_throttle(&self, airspeed_mps: f64, density_kgpm3: f64) -> f64 {
        let drag = self.level_drag_n(airspeed_mps, density_kgpm3);
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..40 {
            let middle = 0.5 * (low + high);
            if self.thrust_n(middle, airspeed_mps, density_kgpm3) < drag {
                low = middle
            } else {
                high = middle
            }
        }
        0.5 * (low + high)
    }
}

fn demand(key: &'static str, value: f64, holds: bool, demand: &'static str) -> Result<(), AirframeError> {
    if holds && value.is_finite() { Ok(()) } else { Err(AirframeError::Value { key, value, demand }) }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    const TEXT: &str = include_str!("../../../airframes/aerosonde.toml");

    pub(crate) fn aerosonde() -> Airframe {
        Airframe::from_toml(TEXT).unwrap()
    }

    #[test]
    fn aerosonde_trims_where_it_is_published_to() {
        let trim = aerosonde().trim(22.0, 1.225);
        assert!((trim.alpha_rad.to_degrees() - 4.5).abs() < 0.5, "{trim:?}");
        assert!((trim.elevator_rad + 0.20).abs() < 0.03, "{trim:?}");
        assert!((trim.throttle - 0.69).abs() < 0.05, "{trim:?}");
    }

    #[test]
    fn full_throttle_holds_the_fastest_airspeed_and_no_more() {
        let airframe = aerosonde();
        let fastest_mps = airframe.fastest_mps();
        assert!((fastest_mps - 32.4).abs() < 0.1, "{fastest_mps}");
        assert!((airframe.trim(fastest_mps, 1.225).throttle - 1.0).abs() < 1e-3);
    }

    #[test]
    fn rascal_is_read_too() {
        let text = include_str!("../../../airframes/rascal110.toml");
        let trim = Airframe::from_toml(text).unwrap().trim(22.0, 1.225);
        assert!(trim.throttle > 0.05 && trim.throttle < 0.95, "{trim:?}");
    }

    #[test]
    fn missing_key_is_named() {
        let error = Airframe::from_toml(&TEXT.replace("pitch_elevator", "pitch_elevater")).unwrap_err();
        assert!(error.to_string().contains("pitch_elevator"), "{error}");
    }

    #[test]
    fn wrong_sign_is_named_with_its_key() {
        let error =
            Airframe::from_toml(&TEXT.replace("pitch_alpha = -2.74", "pitch_alpha = 2.74")).unwrap_err();
        assert!(error.to_string().contains("aerodynamics.pitch_alpha"), "{error}");
    }

    #[test]
    fn an_airframe_comes_by_name_by_text_or_by_path() {
        let never = |_: &str| -> std::io::Result<String> { unreachable!("no file is needed") };
        let named = Airframe::from_attribute("rascal110", never).unwrap();
        assert_eq!(Airframe::from_attribute(BUILT_IN[1].1, never).unwrap(), named);
        assert_eq!(Airframe::from_attribute("mine.toml", |_| Ok(BUILT_IN[1].1.into())).unwrap(), named);
        let absent =
            Airframe::from_attribute("mine.toml", |_| Err(std::io::ErrorKind::NotFound.into())).unwrap_err();
        assert!(absent.contains("mine.toml") && absent.contains("\"aerosonde\""), "{absent}");
    }

    #[test]
    fn aircraft_that_stalls_at_the_missions_airspeed_is_checked_where_it_flies() {
        let heavy = TEXT.replace("mass_kg = 11.0", "mass_kg = 45.0").replace("= 44.4", "= 88.8");
        let heavy = Airframe::from_toml(&heavy).unwrap();
        assert!(heavy.stall_mps(heavy.greatest_lift(), 1.225) > 22.0);
        assert!((heavy.trim(heavy.fastest_mps(), 1.225).throttle - 1.0).abs() < 1e-3);
        let powerless = TEXT.replace("mass_kg = 11.0", "mass_kg = 450.0");
        assert!(matches!(Airframe::from_toml(&powerless), Err(AirframeError::Power { .. })));
    }

    #[test]
    fn aircraft_without_a_rudder_is_read_and_nothing_is_asked_of_it() {
        let wing = Airframe::from_toml(&TEXT.replace("yaw_rudder = -0.069", "yaw_rudder = 0.0")).unwrap();
        assert!(!wing.has_rudder());
        assert_eq!(wing.coordinating_rudder(0.2, 0.5, 20.0), 0.0);
        let hardly = TEXT.replace("yaw_rudder = -0.069", "yaw_rudder = -0.00001");
        assert!(matches!(Airframe::from_toml(&hardly), Err(AirframeError::Value { .. })));
    }

    #[test]
    fn powerless_aircraft_is_refused() {
        let text = TEXT.replace("battery_voltage_v = 44.4", "battery_voltage_v = 4.4");
        assert!(matches!(Airframe::from_toml(&text), Err(AirframeError::Power { .. })));
    }
}
