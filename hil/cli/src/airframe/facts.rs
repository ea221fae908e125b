//! What follows from an airframe file, as numbers. Angles are in degrees here, since people and programs read them.

use std::f64::consts::PI;

use bateleur_flight::airframe::Airframe as Laws;
use bateleur_flight::control::ControllerConfig;
use bateleur_flight::control::envelope::Envelope;
use bateleur_flight::control::inner::{
    Signals, axial_gains, lateral_gains, normal_gains, normal_zero_radps, roll_gains,
};
use bateleur_flight::guidance::GuidanceConfig;
use bateleur_plant::aerodynamics::greatest_lift;
use bateleur_plant::atmosphere::{GRAVITY_MPS2, air};
use bateleur_plant::modes::{Modes, linearise};
use bateleur_plant::propulsion::thrust;
use bateleur_plant::{Airframe, Mode, Trim, trim};
use serde::Serialize;

/// Winds for which the corner's radius is told, m/s.
const WINDS_MPS: [f64; 4] = [0.0, 5.0, 8.0, 12.0];
/// Interval of the Controller, s.
const FRAME_S: f64 = 0.02;
/// Rows of the table of trims, at most.
const MOST_TRIMS: usize = 9;
/// Fastest airspeed that is tried, m/s.
const FASTEST_MPS: f64 = 100.0;

/// Where modes, gains and limits are taken.
#[derive(Debug, Clone, Copy)]
pub(super) struct Point {
    pub(super) airspeed_mps: f64,
    pub(super) height_m: f64,
}

/// All of it.
#[derive(Debug, Serialize)]
pub(super) struct Facts {
    pub(super) name: String,
    pub(super) sources: Vec<String>,
    pub(super) airspeed_mps: f64,
    pub(super) height_m: f64,
    pub(super) density_kgpm3: f64,
    pub(super) mass_kg: f64,
    pub(super) wing_loading_npm2: f64,
    pub(super) aspect_ratio: f64,
    pub(super) stall: Stall,
    /// Slowest and fastest airspeed at which it trims, m/s.
    pub(super) speed_range_mps: Option<[f64; 2]>,
    pub(super) trims: Vec<TrimRow>,
    /// Why it has no trim at the airspeed asked for; then it has no modes either.
    pub(super) trim_error: Option<String>,
    pub(super) modes: Vec<ModeRow>,
    pub(super) gains: Gains,
    pub(super) limits: Limits,
}

#[derive(Debug, Serialize)]
pub(super) struct Stall {
    pub(super) lift_coefficient: f64,
    pub(super) alpha_deg: f64,
    pub(super) airspeed_mps: f64,
}

#[derive(Debug, Serialize)]
pub(super) struct TrimRow {
    pub(super) airspeed_mps: f64,
    pub(super) alpha_deg: f64,
    pub(super) elevator_deg: f64,
    pub(super) throttle: f64,
    /// Climb that full throttle adds at this airspeed, m/s.
    pub(super) climb_mps: f64,
}

#[derive(Debug, Serialize)]
pub(super) struct ModeRow {
    pub(super) name: &'static str,
    /// Real and imaginary part of each root, 1/s.
    pub(super) roots: Vec<[f64; 2]>,
    pub(super) frequency_radps: f64,
    pub(super) damping: f64,
    /// To 1/e; negative: from 1/e.
    pub(super) time_constant_s: f64,
}

#[derive(Debug, Serialize)]
pub(super) struct Gains {
    pub(super) normal: Normal,
    pub(super) lateral: Lateral,
    pub(super) axial: Axial,
    pub(super) roll: Roll,
}

#[derive(Debug, Serialize)]
pub(super) struct Normal {
    pub(super) k_q: f64,
    pub(super) k_c: f64,
    pub(super) k_e: f64,
    pub(super) n_c: f64,
    pub(super) frequency_radps: f64,
    pub(super) damping: f64,
    pub(super) pole_radps: f64,
}

#[derive(Debug, Serialize)]
pub(super) struct Lateral {
    pub(super) k_r: f64,
    pub(super) k_b: f64,
}

#[derive(Debug, Serialize)]
pub(super) struct Axial {
    pub(super) k_a: f64,
    pub(super) k_ea: f64,
    pub(super) k_t: f64,
}

#[derive(Debug, Serialize)]
pub(super) struct Roll {
    pub(super) k_p: f64,
    pub(super) k_ep: f64,
    pub(super) n_p: f64,
    pub(super) poles_radps: [f64; 2],
}

#[derive(Debug, Serialize)]
pub(super) struct Limits {
    /// Zeros of the normal acceleration at plus and minus this.
    pub(super) normal_zero_radps: Option<f64>,
    /// Whether the normal loop's frequency keeps below a third of it.
    pub(super) normal_frequency_within: Option<bool>,
    /// Load factor that the wing gives before it stalls.
    pub(super) load_factor_by_lift: f64,
    /// Load factor that the elevator can hold in a steady turn.
    pub(super) load_factor_by_elevator: f64,
    /// Load factor that the Controller asks for at most.
    pub(super) load_factor_asked: f64,
    /// Bank of a level turn at the lesser of the two, and the one that the Controller asks for at most.
    pub(super) bank_deg: f64,
    pub(super) bank_asked_deg: f64,
    /// Airspeed below which the Controller lets the nose down.
    pub(super) floor_mps: f64,
    /// Least airspeed that is asked for, m/s: that one, or what the elevator holds level.
    pub(super) slowest_mps: f64,
    /// Airspeed that full throttle holds level at sea level, m/s: none above is asked for.
    pub(super) fastest_mps: f64,
    /// Steady roll rate at full aileron.
    pub(super) roll_rate_degps: f64,
    pub(super) corners: Vec<Corner>,
}

/// A corner as guidance would fly it.
#[derive(Debug, Serialize)]
pub(super) struct Corner {
    pub(super) wind_mps: f64,
    pub(super) radius_m: f64,
    /// Bank with the whole wind from behind.
    pub(super) bank_deg: f64,
}

impl Facts {
    pub(super) fn of(plant: &Airframe, laws: &Laws, point: &Point) -> Self {
        let density = air(point.height_m).density_kgpm3;
        let (mass, geometry) = (&plant.mass, &plant.geometry);
        let weight = mass.mass_kg * GRAVITY_MPS2;
        let (lift, alpha) = greatest_lift(&plant.aerodynamics);
        let stall = Stall {
            lift_coefficient: lift,
            alpha_deg: alpha.to_degrees(),
            airspeed_mps: plant.stall_mps(density),
        };
        let trims = trims(plant, point.height_m, stall.airspeed_mps);
        let trimmed = trim(plant, point.airspeed_mps, 0.0, point.height_m);
        let modes = trimmed.as_ref().map_or_else(|_| Vec::new(), |at| modes(plant, at, point.height_m));
        Self {
            name: plant.name.clone(),
            sources: plant.sources.clone(),
            airspeed_mps: point.airspeed_mps,
            height_m: point.height_m,
            density_kgpm3: density,
            mass_kg: mass.mass_kg,
            wing_loading_npm2: weight / geometry.wing_area_m2,
            aspect_ratio: geometry.wing_span_m * geometry.wing_span_m / geometry.wing_area_m2,
            speed_range_mps: trims
                .first()
                .zip(trims.last())
                .map(|(first, last)| [first.airspeed_mps, last.airspeed_mps]),
            trims: thinned(trims),
            trim_error: trimmed.err().map(|error| error.to_string()),
            modes,
            gains: gains(laws, point, density),
            limits: limits(plant, laws, point, density, &stall),
            stall,
        }
    }
}

/// Level trims half a metre per second apart, from the slowest on; those beyond a control's reach left out.
fn trims(plant: &Airframe, height_m: f64, stall_mps: f64) -> Vec<TrimRow> {
    let first = (stall_mps / 0.5).floor() * 0.5;
    let speeds = (0..).map(|step| first + 0.5 * f64::from(step)).take_while(|speed| *speed <= FASTEST_MPS);
    let flies = speeds.map(|speed| trim(plant, speed, 0.0, height_m));
    // Behind the fastest one there are no more, but slower than the slowest there may be some that fail.
    let mut rows = Vec::new();
    for at in flies {
        match at {
            Ok(at) => rows.push(row(plant, &at, height_m)),
            Err(_) if rows.is_empty() => {}
            Err(_) => break,
        }
    }
    rows
}

fn row(plant: &Airframe, at: &Trim, height_m: f64) -> TrimRow {
    let density = air(height_m).density_kgpm3;
    let pull = |throttle: f64| {
        thrust(&plant.propulsion, throttle, at.airspeed_mps * at.alpha_rad.cos(), density).thrust_n
    };
    let excess = pull(1.0) - pull(at.controls.throttle);
    TrimRow {
        airspeed_mps: at.airspeed_mps,
        alpha_deg: at.alpha_rad.to_degrees(),
        elevator_deg: at.controls.elevator_rad.to_degrees(),
        throttle: at.controls.throttle,
        climb_mps: excess * at.airspeed_mps / (plant.mass.mass_kg * GRAVITY_MPS2),
    }
}

/// The first, the last, and evenly many between.
fn thinned(rows: Vec<TrimRow>) -> Vec<TrimRow> {
    let last = rows.len().saturating_sub(1);
    let stride = last.div_ceil(MOST_TRIMS - 1).max(1);
    let keep = |index: usize| index.is_multiple_of(stride) || index == last;
    rows.into_iter().enumerate().filter(|(index, _)| keep(*index)).map(|(_, row)| row).collect()
}

fn modes(plant: &Airframe, at: &Trim, height_m: f64) -> Vec<ModeRow> {
    let row = |(name, mode): (&'static str, Mode)| ModeRow {
        name,
        roots: if mode.roots[0] == mode.roots[1] {
            vec![[mode.roots[0].re, mode.roots[0].im]]
        } else {
            mode.roots.iter().map(|root| [root.re, root.im]).collect()
        },
        frequency_radps: mode.frequency_radps(),
        damping: mode.damping(),
        time_constant_s: mode.time_constant_s(),
    };
    Modes::of(&linearise(plant, at, height_m)).named().into_iter().map(row).collect()
}

fn signals(point: &Point, density: f64) -> Signals {
    Signals {
        airspeed_mps: point.airspeed_mps,
        density_kgpm3: density,
        normal_mps2: -GRAVITY_MPS2,
        ..Signals::default()
    }
}

fn gains(laws: &Laws, point: &Point, density: f64) -> Gains {
    let tuning = ControllerConfig::default().inner;
    let s = signals(point, density);
    let normal = normal_gains(laws, &tuning, &s);
    let lateral = lateral_gains(laws, &tuning, &s);
    let throttle = laws.trim(point.airspeed_mps, density).throttle;
    let axial = axial_gains(laws, &tuning, &s, throttle, FRAME_S);
    let roll = roll_gains(laws, &tuning, &s);
    Gains {
        normal: Normal {
            k_q: normal.pitch_rate,
            k_c: normal.normal,
            k_e: normal.integral,
            n_c: normal.forward,
            frequency_radps: normal.frequency_radps,
            damping: normal.damping,
            pole_radps: normal.pole_radps,
        },
        lateral: Lateral { k_r: lateral.yaw_rate, k_b: lateral.integral },
        axial: Axial { k_a: axial.axial, k_ea: axial.integral, k_t: axial.slope_mps2 },
        roll: Roll {
            k_p: roll.roll_rate,
            k_ep: roll.integral,
            n_p: roll.forward,
            poles_radps: roll.poles_radps,
        },
    }
}

fn limits(plant: &Airframe, laws: &Laws, point: &Point, density: f64, stall: &Stall) -> Limits {
    let config = ControllerConfig::default();
    let s = signals(point, density);
    let zero = normal_zero_radps(laws, &s);
    let frequency = normal_gains(laws, &config.inner, &s).frequency_radps;
    let by_lift = (point.airspeed_mps / stall.airspeed_mps).powi(2);
    let by_elevator = load_factor_by_elevator(plant, point.airspeed_mps, density);
    let factor = by_lift.min(by_elevator);
    let bank = if factor > 1.0 { (1.0 / factor).acos() } else { 0.0 };
    let envelope = Envelope::new(laws);
    let asked = envelope.limits(laws, point.airspeed_mps, density, config.outer.bank_limit_rad);
    let guidance = GuidanceConfig::default().of_airframe(laws);
    let (a, span) = (&plant.aerodynamics, plant.geometry.wing_span_m);
    let roll_rate =
        -a.roll_aileron / a.roll_roll_rate * plant.servo.aileron_limit_rad * 2.0 * point.airspeed_mps / span;
    Limits {
        normal_zero_radps: zero,
        normal_frequency_within: zero.map(|zero| frequency <= zero / 3.0),
        load_factor_by_lift: by_lift,
        load_factor_by_elevator: by_elevator,
        load_factor_asked: asked.load_factor,
        bank_deg: bank.to_degrees(),
        bank_asked_deg: asked.bank_rad.to_degrees(),
        floor_mps: asked.floor_mps,
        slowest_mps: envelope.slowest_mps,
        fastest_mps: envelope.fastest_mps,
        roll_rate_degps: roll_rate.to_degrees(),
        corners: WINDS_MPS.map(|wind| corner(&guidance, point.airspeed_mps, wind)).into(),
    }
}

fn corner(guidance: &GuidanceConfig, airspeed_mps: f64, wind_mps: f64) -> Corner {
    let radius_m = guidance.corner_radius_m(airspeed_mps, wind_mps);
    let fastest = airspeed_mps + wind_mps;
    Corner {
        wind_mps,
        radius_m,
        bank_deg: (fastest * fastest / (GRAVITY_MPS2 * radius_m)).atan() * 180.0 / PI,
    }
}

/// Greatest load factor of a steady turn in which the elevator stays off its stop, by lift and moment in balance with the turn's
/// pitch rate (g/V)(n − 1/n). Infinite where the elevator is not what ends it, 100 being taken for that.
fn load_factor_by_elevator(plant: &Airframe, airspeed_mps: f64, density: f64) -> f64 {
    let (a, g) = (&plant.aerodynamics, &plant.geometry);
    let area = 0.5 * density * airspeed_mps * airspeed_mps * g.wing_area_m2;
    let elevator = |factor: f64| {
        let rate =
            GRAVITY_MPS2 / airspeed_mps * (factor - 1.0 / factor) * g.mean_chord_m / (2.0 * airspeed_mps);
        let lift = factor * plant.mass.mass_kg * GRAVITY_MPS2 / area - a.lift_0 - a.lift_pitch_rate * rate;
        let moment = -a.pitch_0 - a.pitch_pitch_rate * rate;
        let determinant = a.lift_alpha * a.pitch_elevator - a.lift_elevator * a.pitch_alpha;
        (a.lift_alpha * moment - a.pitch_alpha * lift) / determinant
    };
    let (mut low, mut high) = (1.0, 100.0);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if elevator(middle).abs() < plant.servo.elevator_limit_rad {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;

    fn facts(name: &str, airspeed_mps: f64) -> Facts {
        let text = bateleur_flight::airframe::built_in(name).unwrap();
        let plant = Airframe::from_toml(text).unwrap();
        Facts::of(&plant, &Laws::from_toml(text).unwrap(), &Point { airspeed_mps, height_m: 0.0 })
    }

    #[test]
    fn aerosonde_trims_and_swings_as_published() {
        let facts = facts("aerosonde", 22.0);
        assert_eq!(facts.trim_error, None);
        assert!(
            facts.trims.len() <= MOST_TRIMS + 1
                && facts.trims.windows(2).all(|two| two[0].airspeed_mps < two[1].airspeed_mps)
        );
        let names: Vec<&str> = facts.modes.iter().map(|mode| mode.name).collect();
        assert_eq!(names, ["short period", "phugoid", "Dutch roll", "roll", "spiral"]);
        assert!(facts.modes[0].frequency_radps > 8.0 && facts.modes[3].roots.len() == 1);
        let zero = facts.limits.normal_zero_radps.unwrap();
        assert!((zero - 33.0).abs() < 2.0, "{zero}");
    }

    #[test]
    fn corner_keeps_the_design_bank_with_the_wind_behind_or_what_the_aircraft_holds() {
        let of = |name: &str, airspeed_mps: f64, wind_mps: f64| {
            let laws = Laws::from_toml(bateleur_flight::airframe::built_in(name).unwrap()).unwrap();
            corner(&GuidanceConfig::default().of_airframe(&laws), airspeed_mps, wind_mps)
        };
        let fast = of("aerosonde", 22.0, 8.0);
        assert!((fast.bank_deg - 38.0).abs() < 1e-9 && (fast.radius_m - 117.5).abs() < 1.0, "{fast:?}");
        assert_eq!(of("rascal110", 15.0, 0.0).radius_m, 70.0);
        let slow = of("aerosonde", 17.0, 0.0);
        assert!((8.0..20.0).contains(&slow.bank_deg) && slow.radius_m > 85.0, "{slow:?}");
    }

    #[test]
    fn speed_without_a_trim_is_told_and_has_no_modes() {
        let facts = facts("aerosonde", 60.0);
        assert!(facts.trim_error.unwrap().contains("the throttle") && facts.modes.is_empty());
    }

    #[test]
    fn elevator_ends_a_turn_where_its_stop_is() {
        let mut plant = Airframe::aerosonde();
        let factor = load_factor_by_elevator(&plant, 22.0, 1.225);
        assert!((1.5..4.0).contains(&factor), "{factor}");
        plant.servo.elevator_limit_rad *= 2.0;
        assert!(load_factor_by_elevator(&plant, 22.0, 1.225) > factor + 0.5);
    }
}
