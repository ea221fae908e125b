//! An airframe is data: mass, geometry, derivatives, power, servos and wheels, read from a TOML text.
//!
//! Axes are forward, right, down with the origin at the centre of gravity; units are SI, angles in rad, derivatives
//! per rad. The fields are public so that a Monte-Carlo run can vary them; [`Airframe::check`] tells whether the result
//! still makes sense.

use crate::aerodynamics::greatest_lift;
use crate::airframe_file::{self, Flaws};
use crate::atmosphere::GRAVITY_MPS2;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Why an airframe was refused.
#[derive(Debug, Error)]
pub enum AirframeError {
    /// The file is no airframe: everything that is wrong with it.
    #[error(transparent)]
    File(#[from] Flaws),
    /// Numbers in memory do not make up an airframe.
    #[error("these numbers make no airframe: {0}")]
    Syntax(#[from] toml::de::Error),
    /// A value is outside the range in which the model means anything.
    #[error("airframe `{airframe}`: {key} is {value}, but it must be {demand}")]
    Value {
        /// Name of the airframe.
        airframe: String,
        /// Section and key, joined by a dot.
        key: &'static str,
        /// The value as read.
        value: f64,
        /// The condition it breaks.
        demand: &'static str,
    },
}

/// A value with which the equations can do nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Complaint {
    /// Section and key, joined by a dot.
    pub key: &'static str,
    /// The value.
    pub value: f64,
    /// What it must be.
    pub demand: &'static str,
}

/// All that distinguishes one aircraft from another.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Airframe {
    /// Name for people.
    pub name: String,
    /// Where the numbers come from.
    pub sources: Vec<String>,
    /// Mass and inertia.
    pub mass: Mass,
    /// Reference lengths.
    pub geometry: Geometry,
    /// Stability and control derivatives.
    pub aerodynamics: Aerodynamics,
    /// Motor or engine, with its propeller.
    pub propulsion: Propulsion,
    /// Actuators of the control surfaces.
    pub servo: Servo,
    /// Wheels and the outermost points of the structure.
    pub gear: Gear,
}

/// Mass and moments of inertia about the centre of gravity; I_xy and I_yz are zero by symmetry.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Mass {
    /// Mass, kg.
    pub mass_kg: f64,
    /// About the forward axis, kg m².
    pub inertia_xx_kgm2: f64,
    /// About the right axis, kg m².
    pub inertia_yy_kgm2: f64,
    /// About the down axis, kg m².
    pub inertia_zz_kgm2: f64,
    /// Product of inertia ∫ x z dm, kg m²; it enters the inertia matrix with a minus sign.
    pub inertia_xz_kgm2: f64,
}

/// Reference lengths of the aerodynamic coefficients.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Geometry {
    /// Wing area, m².
    pub wing_area_m2: f64,
    /// Wing span, m.
    pub wing_span_m: f64,
    /// Mean aerodynamic chord, m.
    pub mean_chord_m: f64,
}

/// Coefficients named effect first, cause second: `roll_aileron` is what books call C_lδa. Per rad.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Aerodynamics {
    /// C_L0.
    pub lift_0: f64,
    /// C_Lα.
    pub lift_alpha: f64,
    /// C_Lq, for q c / 2V.
    pub lift_pitch_rate: f64,
    /// C_Lδe.
    pub lift_elevator: f64,
    /// C_D at zero lift.
    pub drag_0: f64,
    /// Factor of C_L².
    pub drag_induced: f64,
    /// Drag per rad of |α|.
    pub drag_alpha: f64,
    /// Drag per rad of |δe|.
    pub drag_elevator: f64,
    /// C_Yβ.
    pub side_beta: f64,
    /// C_Yδa.
    pub side_aileron: f64,
    /// C_Yδr.
    pub side_rudder: f64,
    /// C_lβ.
    pub roll_beta: f64,
    /// C_lp, for p b / 2V.
    pub roll_roll_rate: f64,
    /// C_lr, for r b / 2V.
    pub roll_yaw_rate: f64,
    /// C_lδa, positive: a positive aileron rolls to the right.
    pub roll_aileron: f64,
    /// C_lδr.
    pub roll_rudder: f64,
    /// C_m0.
    pub pitch_0: f64,
    /// C_mα.
    pub pitch_alpha: f64,
    /// C_mq, for q c / 2V.
    pub pitch_pitch_rate: f64,
    /// C_mα̇, for α̇ c / 2V.
    pub pitch_alpha_rate: f64,
    /// C_mδe, negative: a positive elevator pitches down.
    pub pitch_elevator: f64,
    /// C_nβ.
    pub yaw_beta: f64,
    /// C_np, for p b / 2V.
    pub yaw_roll_rate: f64,
    /// C_nr, for r b / 2V.
    pub yaw_yaw_rate: f64,
    /// C_nδa.
    pub yaw_aileron: f64,
    /// C_nδr, negative: a positive rudder turns the nose to the left.
    pub yaw_rudder: f64,
    /// Angle of attack at which attached flow and flat plate weigh the same, rad.
    pub stall_alpha_rad: f64,
    /// Steepness of the change between the two, 1/rad.
    pub stall_sharpness: f64,
}

/// Source of thrust. The throttle acts through a first-order lag; the shaft speed follows at once.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum Propulsion {
    /// Direct-current motor: the throttle scales the voltage.
    Electric {
        /// Speed constant, turns per minute and volt.
        motor_kv_rpm_per_v: f64,
        /// Voltage at full throttle, V.
        battery_voltage_v: f64,
        /// Resistance of the winding, Ω.
        winding_resistance_ohm: f64,
        /// Current without load, A.
        no_load_current_a: f64,
        /// Time constant from throttle command to effective throttle, s.
        lag_s: f64,
        /// The propeller.
        propeller: Propeller,
    },
    /// Piston engine: the throttle scales a torque that does not depend on speed.
    Piston {
        /// Power at full throttle and rated speed, W.
        power_w: f64,
        /// Rated shaft speed, rad/s.
        rated_speed_radps: f64,
        /// Torque lost in the engine, N m.
        friction_torque_nm: f64,
        /// Time constant from throttle command to effective throttle, s.
        lag_s: f64,
        /// The propeller.
        propeller: Propeller,
    },
}

/// Thrust and torque coefficients as parabolas in the advance ratio.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Propeller {
    /// Diameter, m.
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

/// Surface actuators, the same for all three axes.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Servo {
    /// Corner frequency of the first-order lag, rad/s.
    pub bandwidth_radps: f64,
    /// Dead time before the lag, s; rounded to 2.5 ms. Delays the throttle too.
    pub delay_s: f64,
    /// Full width of the mechanical play, rad.
    pub backlash_rad: f64,
    /// Greatest aileron deflection either way, rad.
    pub aileron_limit_rad: f64,
    /// Greatest elevator deflection either way, rad.
    pub elevator_limit_rad: f64,
    /// Greatest rudder deflection either way, rad.
    pub rudder_limit_rad: f64,
}

/// Ground contact: three wheels, and four points of the structure that should not touch.
#[derive(Clone, Debug, Deserialize, PartialEq, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Gear {
    /// Right main wheel where it touches, body axes, m; the left one is its mirror image.
    pub main_wheel_m: [f64; 3],
    /// Steered wheel under nose or tail, body axes, m.
    pub third_wheel_m: [f64; 3],
    /// Foremost point, body axes, m.
    pub nose_m: [f64; 3],
    /// Rearmost point, body axes, m.
    pub tail_m: [f64; 3],
    /// Right wing tip, body axes, m; the left one is its mirror image.
    pub wing_tip_m: [f64; 3],
    /// Spring of each wheel, N/m.
    pub spring_n_per_m: f64,
    /// Damper of each wheel, N s/m.
    pub damping_ns_per_m: f64,
    /// Friction along the wheel.
    pub rolling_friction: f64,
    /// Friction across the wheel, and of the structure.
    pub lateral_friction: f64,
    /// Angle of the third wheel per rudder angle.
    pub steering_ratio: f64,
    /// Sink rate of a wheel from which the aircraft counts as lost, m/s; half of it for the structure, any for the nose: there is the propeller.
    pub crash_sink_mps: f64,
}

impl Propulsion {
    /// The propeller of either kind.
    pub fn propeller(&self) -> &Propeller {
        match self {
            Self::Electric { propeller, .. } | Self::Piston { propeller, .. } => propeller,
        }
    }

    /// Time constant of the throttle, s.
    pub fn lag_s(&self) -> f64 {
        match self {
            Self::Electric { lag_s, .. } | Self::Piston { lag_s, .. } => *lag_s,
        }
    }
}

/// The airframes that are embedded, by name.
pub const EMBEDDED: [(&str, &str); 5] = [
    ("aerosonde", include_str!("../../../airframes/aerosonde.toml")),
    ("rascal110", include_str!("../../../airframes/rascal110.toml")),
    ("ultrastick25e", include_str!("../../../airframes/ultrastick25e.toml")),
    ("vtail60", include_str!("../../../airframes/vtail60.toml")),
    ("zagi", include_str!("../../../airframes/zagi.toml")),
];

impl Airframe {
    /// Reads an airframe from TOML text and checks it.
    ///
    /// # Errors
    /// Everything that is wrong with the text, each flaw with its place.
    pub fn from_toml(text: &str) -> Result<Self, AirframeError> {
        Ok(airframe_file::read(text)?)
    }

    /// The Aerosonde, the aircraft flown when nothing else is asked for.
    pub fn aerosonde() -> Self {
        Self::embedded(EMBEDDED[0].1)
    }

    /// The Rascal 110.
    pub fn rascal110() -> Self {
        Self::embedded(EMBEDDED[1].1)
    }

    #[expect(clippy::expect_used, reason = "the text is part of the program and read by a test")]
    fn embedded(text: &str) -> Self {
        Self::from_toml(text).expect("an embedded airframe is valid")
    }

    /// Airspeed (m/s) at which the wing just carries the weight, in air of a density (kg/m³).
    pub fn stall_mps(&self, density_kgpm3: f64) -> f64 {
        let weight = self.mass.mass_kg * GRAVITY_MPS2;
        let (lift, _) = greatest_lift(&self.aerodynamics);
        (2.0 * weight / (density_kgpm3 * self.geometry.wing_area_m2 * lift)).sqrt()
    }

    /// Checks every value on which the equations rely.
    ///
    /// # Errors
    /// Names the first value that makes no sense.
    pub fn check(&self) -> Result<(), AirframeError> {
        match self.complaints().first() {
            None => Ok(()),
            Some(&Complaint { key, value, demand }) => {
                Err(AirframeError::Value { airframe: self.name.clone(), key, value, demand })
            }
        }
    }

    /// Every value that makes no sense.
    pub fn complaints(&self) -> Vec<Complaint> {
        let mut found = Complaints::default();
        self.check_body(&mut found);
        self.check_aerodynamics(&mut found);
        self.check_propulsion(&mut found);
        self.check_servo(&mut found);
        self.check_gear(&mut found);
        found.0
    }

    fn check_body(&self, found: &mut Complaints) {
        let (m, g) = (&self.mass, &self.geometry);
        found.positive("mass.mass_kg", m.mass_kg);
        found.positive("mass.inertia_xx_kgm2", m.inertia_xx_kgm2);
        found.positive("mass.inertia_yy_kgm2", m.inertia_yy_kgm2);
        found.positive("mass.inertia_zz_kgm2", m.inertia_zz_kgm2);
        // Each is made of two of the three sums of m x², m y², m z²: no body has one above the other two together. Measured values
        // are less exact than that, and drawn ones vary around them; a slip by a factor of ten is far beyond.
        let inertias = [
            ("mass.inertia_xx_kgm2", m.inertia_xx_kgm2),
            ("mass.inertia_yy_kgm2", m.inertia_yy_kgm2),
            ("mass.inertia_zz_kgm2", m.inertia_zz_kgm2),
        ];
        let all: f64 = inertias.iter().map(|(_, inertia)| inertia).sum();
        if inertias.iter().all(|(_, inertia)| *inertia > 0.0)
            && let Some((key, inertia)) =
                inertias.into_iter().find(|(_, inertia)| *inertia > 2.0 * (all - inertia))
        {
            found.demand(
                false,
                key,
                inertia,
                "no more than twice the other two together: no body has more than once",
            );
        }
        let limit = (m.inertia_xx_kgm2 * m.inertia_zz_kgm2).sqrt();
        let xz = m.inertia_xz_kgm2;
        found.demand(xz.abs() < limit, "mass.inertia_xz_kgm2", xz, "less than the root of I_xx I_zz");
        found.positive("geometry.wing_area_m2", g.wing_area_m2);
        found.positive("geometry.wing_span_m", g.wing_span_m);
        found.positive("geometry.mean_chord_m", g.mean_chord_m);
        if g.wing_area_m2 > 0.0 && g.wing_span_m > 0.0 {
            let aspect = g.wing_span_m * g.wing_span_m / g.wing_area_m2;
            let sensible = (ASPECT_RATIO.0..=ASPECT_RATIO.1).contains(&aspect);
            let demand = "such that the aspect ratio, its square over the wing's area, is between 1 and 60";
            found.demand(sensible, "geometry.wing_span_m", g.wing_span_m, demand);
        }
    }

    fn check_aerodynamics(&self, found: &mut Complaints) {
        let a = &self.aerodynamics;
        found.positive("aerodynamics.lift_alpha", a.lift_alpha);
        found.positive("aerodynamics.drag_0", a.drag_0);
        found.positive("aerodynamics.roll_aileron", a.roll_aileron);
        found.demand(
            a.pitch_elevator < 0.0,
            "aerodynamics.pitch_elevator",
            a.pitch_elevator,
            "less than zero",
        );
        let none_or_left = a.yaw_rudder <= 0.0;
        let demand = "less than zero, or zero where there is no rudder";
        found.demand(none_or_left, "aerodynamics.yaw_rudder", a.yaw_rudder, demand);
        if a.yaw_rudder == 0.0 {
            let demand = "zero, as yaw_rudder is: there is no rudder";
            found.demand(a.side_rudder == 0.0, "aerodynamics.side_rudder", a.side_rudder, demand);
            found.demand(a.roll_rudder == 0.0, "aerodynamics.roll_rudder", a.roll_rudder, demand);
        }
        let (stall, sharpness) = (a.stall_alpha_rad, a.stall_sharpness);
        found.demand(
            stall > 0.05 && stall < 1.5,
            "aerodynamics.stall_alpha_rad",
            stall,
            "between 0.05 and 1.5",
        );
        let sensible = sharpness > 0.0 && sharpness <= 100.0;
        found.demand(sensible, "aerodynamics.stall_sharpness", sharpness, "between 0 and 100");
    }

    fn check_propulsion(&self, found: &mut Complaints) {
        found.not_negative("propulsion.lag_s", self.propulsion.lag_s());
        let propeller = self.propulsion.propeller();
        found.positive("propulsion.propeller.diameter_m", propeller.diameter_m);
        found.positive("propulsion.propeller.thrust_0", propeller.thrust_0);
        found.positive("propulsion.propeller.torque_0", propeller.torque_0);
        match self.propulsion {
            Propulsion::Electric {
                motor_kv_rpm_per_v, battery_voltage_v, winding_resistance_ohm, ..
            } => {
                found.positive("propulsion.motor_kv_rpm_per_v", motor_kv_rpm_per_v);
                found.positive("propulsion.battery_voltage_v", battery_voltage_v);
                found.positive("propulsion.winding_resistance_ohm", winding_resistance_ohm);
            }
            Propulsion::Piston { power_w, rated_speed_radps, .. } => {
                found.positive("propulsion.power_w", power_w);
                found.positive("propulsion.rated_speed_radps", rated_speed_radps);
            }
        }
    }

    fn check_servo(&self, found: &mut Complaints) {
        let s = &self.servo;
        found.positive("servo.bandwidth_radps", s.bandwidth_radps);
        let longest = crate::servo::LONGEST_DELAY_S;
        let delay_ok = (0.0..=longest).contains(&s.delay_s);
        found.demand(delay_ok, "servo.delay_s", s.delay_s, "between 0 and 0.25");
        found.not_negative("servo.backlash_rad", s.backlash_rad);
        found.travel("servo.aileron_limit_rad", s.aileron_limit_rad);
        found.travel("servo.elevator_limit_rad", s.elevator_limit_rad);
        found.travel("servo.rudder_limit_rad", s.rudder_limit_rad);
    }

    fn check_gear(&self, found: &mut Complaints) {
        let g = &self.gear;
        found.positive("gear.main_wheel_m[1]", g.main_wheel_m[1]);
        found.positive("gear.main_wheel_m[2]", g.main_wheel_m[2]);
        let supported = g.main_wheel_m[0] * g.third_wheel_m[0] < 0.0;
        let demand = "on the other side of the centre of gravity than the main wheels";
        found.demand(supported, "gear.third_wheel_m[0]", g.third_wheel_m[0], demand);
        // The line through the wheels, at the nose.
        let (main, third, nose) = (g.main_wheel_m, g.third_wheel_m, g.nose_m);
        let ground_m = main[2] + (third[2] - main[2]) / (third[0] - main[0]) * (nose[0] - main[0]);
        let demand = "less than the line through the wheels has at the nose (z points down): a nose on the ground is the end of the aircraft";
        found.demand(!supported || nose[2] < ground_m, "gear.nose_m[2]", nose[2], demand);
        found.positive("gear.spring_n_per_m", g.spring_n_per_m);
        found.not_negative("gear.damping_ns_per_m", g.damping_ns_per_m);
        found.not_negative("gear.rolling_friction", g.rolling_friction);
        found.not_negative("gear.lateral_friction", g.lateral_friction);
        found.positive("gear.crash_sink_mps", g.crash_sink_mps);
    }
}

/// Wings are more slender than a square and no more than the slenderest glider's.
const ASPECT_RATIO: (f64, f64) = (1.0, 60.0);

/// What was found so far.
#[derive(Default)]
struct Complaints(Vec<Complaint>);

impl Complaints {
    fn demand(&mut self, holds: bool, key: &'static str, value: f64, demand: &'static str) {
        if !(holds && value.is_finite()) {
            self.0.push(Complaint { key, value, demand });
        }
    }

    fn positive(&mut self, key: &'static str, value: f64) {
        self.demand(value > 0.0, key, value, "greater than zero");
    }

    /// A surface that turns by more than this stands across the air; who writes more has written degrees.
    fn travel(&mut self, key: &'static str, value: f64) {
        self.demand(value > 0.0 && value <= 1.2, key, value, "in radians, greater than zero and 1.2 at most");
    }

    fn not_negative(&mut self, key: &'static str, value: f64) {
        self.demand(value >= 0.0, key, value, "zero or greater");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_embedded_airframes_are_valid() {
        assert_eq!(Airframe::aerosonde().name, "Aerosonde");
        assert_eq!(Airframe::rascal110().name, "Rascal 110");
        assert!(matches!(Airframe::rascal110().propulsion, Propulsion::Piston { .. }));
    }

    #[test]
    fn unknown_key_is_refused_with_its_name() {
        let text = include_str!("../../../airframes/aerosonde.toml").replace("drag_0 =", "drag_nought =");
        let message = Airframe::from_toml(&text).unwrap_err().to_string();
        assert!(message.contains("drag_nought"), "{message}");
    }

    #[test]
    fn elevator_of_the_wrong_sign_is_refused_with_key_and_value() {
        let text = include_str!("../../../airframes/aerosonde.toml")
            .replace("pitch_elevator = -0.99", "pitch_elevator = 0.99");
        let message = Airframe::from_toml(&text).unwrap_err().to_string();
        assert!(message.contains("aerodynamics.pitch_elevator is 0.99"), "{message}");
    }

    #[test]
    fn body_and_wing_that_nothing_has_are_refused() {
        let text = include_str!("../../../airframes/aerosonde.toml");
        let slips = [
            ("inertia_xx_kgm2 = 0.8244", "inertia_xx_kgm2 = 8.244", "mass.inertia_xx_kgm2 is 8.244"),
            ("inertia_yy_kgm2 = 1.135", "inertia_yy_kgm2 = 11.35", "mass.inertia_yy_kgm2 is 11.35"),
            ("wing_span_m = 2.8956", "wing_span_m = 28.956", "geometry.wing_span_m is 28.956"),
        ];
        for (from, to, said) in slips {
            assert!(text.contains(from), "{from}");
            let message = Airframe::from_toml(&text.replace(from, to)).unwrap_err().to_string();
            assert!(message.contains(said), "{message}");
        }
    }

    #[test]
    fn third_wheel_on_the_wrong_side_is_refused() {
        let text = include_str!("../../../airframes/rascal110.toml").replace("[-0.826,", "[0.826,");
        let message = Airframe::from_toml(&text).unwrap_err().to_string();
        assert!(message.contains("gear.third_wheel_m[0]"), "{message}");
    }

    #[test]
    fn nose_below_the_wheels_is_refused_and_one_above_is_not() {
        let text = include_str!("../../../airframes/aerosonde.toml");
        let nose = |z: &str| {
            Airframe::from_toml(
                &text.replace("nose_m = [0.65, 0.0, 0.0]", &format!("nose_m = [0.65, 0.0, {z}]")),
            )
        };
        // The wheels are at 0.30 and 0.36, the line through them at 0.37.
        assert!(nose("0.36").is_ok());
        let message = nose("0.38").unwrap_err().to_string();
        assert!(
            message.contains("gear.nose_m[2] is 0.38") && message.contains("line through the wheels"),
            "{message}"
        );
    }

    #[test]
    fn unknown_engine_kind_is_refused_with_the_known_ones() {
        let text = include_str!("../../../airframes/aerosonde.toml").replace("\"electric\"", "\"steam\"");
        let message = Airframe::from_toml(&text).unwrap_err().to_string();
        assert!(message.contains("steam") && message.contains("piston"), "{message}");
    }
}
