//! Moving air: a constant mean wind and Dryden turbulence after MIL-F-8785C, low-altitude model.
//!
//! The longitudinal gust lies along the mean wind (along north in its absence), the vertical one along down. Rolling
//! gusts have their own filter; pitching and yawing ones follow from how the vertical and lateral gusts change along
//! the flight path. Level and mean wind are set apart, as no level implies a mean wind here.

use crate::noise::{Noise, Source};
use nalgebra::{Rotation3, Vector3};
use std::f64::consts::PI;

/// How rough the air is, named by the wind at 20 ft that MIL-F-8785C gives for the level.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Turbulence {
    /// No gusts at all.
    #[default]
    Calm,
    /// As with 15 kt at 20 ft.
    Light,
    /// As with 30 kt at 20 ft.
    Moderate,
    /// As with 45 kt at 20 ft.
    Severe,
}

impl Turbulence {
    /// Wind at 20 ft that sets the intensity, m/s.
    pub fn reference_wind_mps(self) -> f64 {
        const KNOT: f64 = 0.514_444;
        match self {
            Self::Calm => 0.0,
            Self::Light => 15.0 * KNOT,
            Self::Moderate => 30.0 * KNOT,
            Self::Severe => 45.0 * KNOT,
        }
    }
}

/// Lengths and intensities at one height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spectrum {
    /// Scale of the horizontal gusts, m.
    pub horizontal_scale_m: f64,
    /// Scale of the vertical gusts, m.
    pub vertical_scale_m: f64,
    /// Standard deviation of either horizontal gust, m/s.
    pub horizontal_sigma_mps: f64,
    /// Standard deviation of the vertical gust, m/s.
    pub vertical_sigma_mps: f64,
}

const FOOT_M: f64 = 0.3048;
/// Filters never see the air pass slower than this, m/s: an aircraft standing in a calm would freeze its gusts.
const SLOWEST_MPS: f64 = 5.0;

impl Spectrum {
    /// The low-altitude model, meant for 10 ft to 1000 ft; outside, the nearer end holds.
    pub fn low_altitude(turbulence: Turbulence, height_m: f64) -> Self {
        let feet = (height_m / FOOT_M).clamp(10.0, 1000.0);
        let shape = 0.177 + 0.000_823 * feet;
        let vertical_sigma_mps = 0.1 * turbulence.reference_wind_mps();
        Self {
            horizontal_scale_m: feet / shape.powf(1.2) * FOOT_M,
            vertical_scale_m: feet * FOOT_M,
            horizontal_sigma_mps: vertical_sigma_mps / shape.powf(0.4),
            vertical_sigma_mps,
        }
    }

    /// Standard deviation of the rolling gust for a wing span, rad/s.
    fn roll_sigma(&self, span_m: f64) -> f64 {
        let slenderness = PI * self.vertical_scale_m / (4.0 * span_m);
        let variance = 0.8 * PI * PI / (8.0 * span_m * self.vertical_scale_m) * slenderness.cbrt();
        self.vertical_sigma_mps * variance.sqrt()
    }
}

/// Filter 1 / (1 + τ s) on white noise, scaled to variance 1.
#[derive(Clone, Debug)]
struct FirstOrder {
    noise: Noise,
    value: f64,
}

impl FirstOrder {
    fn new(seed: u64, source: Source) -> Self {
        let mut noise = Noise::new(seed, source);
        let value = noise.gaussian();
        Self { noise, value }
    }

    fn step(&mut self, time_constant: f64, h: f64) -> f64 {
        let keep = (-h / time_constant).exp();
        self.value = keep * self.value + (1.0 - keep * keep).sqrt() * self.noise.gaussian();
        self.value
    }
}

/// Filter (1 + √3 τ s) / (1 + τ s)² on white noise, scaled to variance 1: two lags in a row, mixed.
#[derive(Clone, Debug)]
struct SecondOrder {
    first: FirstOrder,
    second: f64,
}

impl SecondOrder {
    fn new(seed: u64, source: Source) -> Self {
        let mut first = FirstOrder::new(seed, source);
        // Of the second lag's variance of 1/2, half belongs to what it shares with the first.
        let second = 0.5 * first.value + 0.5 * first.noise.gaussian();
        Self { first, second }
    }

    fn step(&mut self, time_constant: f64, h: f64) -> f64 {
        let before = self.first.value;
        let after = self.first.step(time_constant, h);
        let keep = (-h / time_constant).exp();
        self.second = keep * self.second + (1.0 - keep) * 0.5 * (before + after);
        let root3 = 3.0_f64.sqrt();
        (root3 * after + (1.0 - root3) * self.second) * 0.5_f64.sqrt()
    }
}

/// Motion of the air around the aircraft.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AirMotion {
    /// Mean wind and gust, NED, m/s.
    pub velocity_ned: Vector3<f64>,
    /// The gust alone, NED, m/s.
    pub gust_ned: Vector3<f64>,
    /// Rotation of the air, body axes, rad/s.
    pub rates_body: Vector3<f64>,
}

/// Where and how fast the aircraft passes through the gusts.
#[derive(Clone, Copy, Debug)]
pub struct Passage {
    /// Height above ground, m.
    pub height_m: f64,
    /// Airspeed, m/s.
    pub airspeed_mps: f64,
    /// From NED to body axes.
    pub to_body: Rotation3<f64>,
}

/// Source of wind, seeded.
#[derive(Clone, Debug)]
pub struct Wind {
    mean_ned: Vector3<f64>,
    along: (f64, f64),
    turbulence: Turbulence,
    angular: bool,
    span_m: f64,
    gust_u: FirstOrder,
    gust_v: SecondOrder,
    gust_w: SecondOrder,
    gust_p: FirstOrder,
    slow_v: f64,
    slow_w: f64,
    primed: bool,
}

impl Wind {
    /// Wind of a speed (m/s) from a direction (rad, clockwise from north), with gusts for a wing span (m).
    pub fn new(
        seed: u64,
        speed_mps: f64,
        from_rad: f64,
        turbulence: Turbulence,
        angular: bool,
        span_m: f64,
    ) -> Self {
        let (sin, cos) = if speed_mps > 0.0 { from_rad.sin_cos() } else { (0.0, -1.0) };
        Self {
            mean_ned: Vector3::new(-cos, -sin, 0.0) * speed_mps.max(0.0),
            along: (-cos, -sin),
            turbulence,
            angular,
            span_m,
            gust_u: FirstOrder::new(seed, Source::GustAlong),
            gust_v: SecondOrder::new(seed, Source::GustAcross),
            gust_w: SecondOrder::new(seed, Source::GustVertical),
            gust_p: FirstOrder::new(seed, Source::GustRoll),
            slow_v: 0.0,
            slow_w: 0.0,
            primed: false,
        }
    }

    /// The constant part, NED, m/s.
    pub fn mean_ned(&self) -> Vector3<f64> {
        self.mean_ned
    }

    /// Moves the gusts by `h` seconds.
    pub fn step(&mut self, passage: &Passage, h: f64) -> AirMotion {
        if self.turbulence == Turbulence::Calm {
            return AirMotion { velocity_ned: self.mean_ned, ..AirMotion::default() };
        }
        let speed = passage.airspeed_mps.max(SLOWEST_MPS);
        let spectrum = Spectrum::low_altitude(self.turbulence, passage.height_m);
        let gust_ned = self.linear_gust(&spectrum, speed, h);
        let rates_body = if self.angular {
            self.angular_gust(&spectrum, passage, &gust_ned, speed, h)
        } else {
            Vector3::zeros()
        };
        AirMotion { velocity_ned: self.mean_ned + gust_ned, gust_ned, rates_body }
    }

    fn linear_gust(&mut self, spectrum: &Spectrum, speed: f64, h: f64) -> Vector3<f64> {
        let horizontal = spectrum.horizontal_scale_m / speed;
        let u = spectrum.horizontal_sigma_mps * self.gust_u.step(horizontal, h);
        let v = spectrum.horizontal_sigma_mps * self.gust_v.step(horizontal, h);
        let w = spectrum.vertical_sigma_mps * self.gust_w.step(spectrum.vertical_scale_m / speed, h);
        let (north, east) = self.along;
        Vector3::new(u * north - v * east, u * east + v * north, w)
    }

    /// A rotation of the air seen from a body that flies forward at V: p = ∂w/∂y, q = −ẇ/V, r = v̇/V.
    fn angular_gust(
        &mut self,
        spectrum: &Spectrum,
        passage: &Passage,
        gust_ned: &Vector3<f64>,
        speed: f64,
        h: f64,
    ) -> Vector3<f64> {
        let body = passage.to_body * gust_ned;
        if !self.primed {
            (self.slow_v, self.slow_w, self.primed) = (body.y, body.z, true);
        }
        let (lag_q, lag_r) = (4.0 * self.span_m / (PI * speed), 3.0 * self.span_m / (PI * speed));
        let q = -(body.z - self.slow_w) / (lag_q * speed);
        let r = (body.y - self.slow_v) / (lag_r * speed);
        self.slow_w += (1.0 - (-h / lag_q).exp()) * (body.z - self.slow_w);
        self.slow_v += (1.0 - (-h / lag_r).exp()) * (body.y - self.slow_v);
        let p = spectrum.roll_sigma(self.span_m) * self.gust_p.step(lag_q, h);
        Vector3::new(p, q, r)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Mean and deviation of the gust over many seeds and a long passage at 160 m.
    fn gust_statistics(turbulence: Turbulence) -> (Vector3<f64>, Vector3<f64>, Vector3<f64>) {
        let passage = Passage { height_m: 160.0, airspeed_mps: 22.0, to_body: Rotation3::identity() };
        let (mut n, mut sum, mut square, mut rate) =
            (0.0, Vector3::zeros(), Vector3::zeros(), Vector3::zeros());
        for seed in 0..300 {
            let mut wind = Wind::new(seed, 5.0, 0.0, turbulence, true, 2.9);
            for step in 0..4000 {
                let air = wind.step(&passage, 0.02);
                if step % 10 == 0 {
                    n += 1.0;
                    sum += air.gust_ned;
                    square += air.gust_ned.component_mul(&air.gust_ned);
                    rate += air.rates_body.component_mul(&air.rates_body);
                }
            }
        }
        (sum / n, (square / n).map(f64::sqrt), (rate / n).map(f64::sqrt))
    }

    #[test]
    fn gusts_have_the_standard_deviation_of_the_specification() {
        for (level, vertical) in [(Turbulence::Light, 0.77), (Turbulence::Moderate, 1.54)] {
            let spectrum = Spectrum::low_altitude(level, 160.0);
            assert!((spectrum.horizontal_scale_m - 290.0).abs() < 5.0, "{spectrum:?}");
            assert!((spectrum.vertical_sigma_mps - vertical).abs() < 0.01, "{spectrum:?}");
            let (mean, sigma, _) = gust_statistics(level);
            assert!(mean.norm() < 0.15 * spectrum.horizontal_sigma_mps, "mean gust {mean}");
            for axis in 0..2 {
                assert!(
                    (sigma[axis] / spectrum.horizontal_sigma_mps - 1.0).abs() < 0.05,
                    "axis {axis}: {sigma}"
                );
            }
            assert!((sigma.z / spectrum.vertical_sigma_mps - 1.0).abs() < 0.05, "vertical {sigma}");
        }
    }

    #[test]
    fn rolling_gust_has_the_standard_deviation_of_its_filter() {
        let spectrum = Spectrum::low_altitude(Turbulence::Light, 160.0);
        let (_, _, rates) = gust_statistics(Turbulence::Light);
        // MIL-F-8785C filter: σ_w √(0.8 / V) (π / 4b)^(1/6) / (L^(1/3) (1 + 4b/(πV) s)) on white noise of density π.
        let (b, v, l): (f64, f64, f64) = (2.9, 22.0, 160.0);
        let amplitude = (0.8 / v).sqrt() * (PI / (4.0 * b)).powf(1.0 / 6.0) / l.cbrt();
        let sigma = spectrum.vertical_sigma_mps * amplitude * (PI / 2.0 * PI * v / (4.0 * b)).sqrt();
        assert!((rates.x / sigma - 1.0).abs() < 0.05, "{} against {sigma}", rates.x);
        assert!(rates.y > 0.1 * sigma && rates.z > 0.1 * sigma, "{rates}");
    }

    #[test]
    fn wind_blows_from_where_it_was_asked_to() {
        let west = Wind::new(1, 8.0, 1.5 * PI, Turbulence::Severe, true, 2.9).mean_ned();
        assert!((west - Vector3::new(0.0, 8.0, 0.0)).norm() < 1e-9, "{west}");
    }

    #[test]
    fn level_implies_no_mean_wind() {
        assert_eq!(Wind::new(1, 0.0, 1.0, Turbulence::Severe, true, 2.9).mean_ned(), Vector3::zeros());
    }
}
