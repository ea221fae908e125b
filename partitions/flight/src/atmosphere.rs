//! The standard atmosphere as far as two pressure sensors need it (ISO 2533:1975, troposphere).

/// Sea-level pressure of the standard atmosphere, Pa.
pub const SEA_LEVEL_PRESSURE_PA: f64 = 101_325.0;
/// Sea-level density of the standard atmosphere, kg/m³.
pub const SEA_LEVEL_DENSITY_KGPM3: f64 = 1.225;
/// T0 / L of ISO 2533, m.
const SCALE_M: f64 = 44_330.77;
/// R L / g of ISO 2533.
const EXPONENT: f64 = 0.190_263_2;

/// Pressure altitude (m above the 101325 Pa level) of a static pressure (Pa); `None` outside 20–120 kPa.
pub fn pressure_altitude_m(static_pa: f64) -> Option<f64> {
    let plausible = (20_000.0..120_000.0).contains(&static_pa);
    plausible.then(|| SCALE_M * (1.0 - (static_pa / SEA_LEVEL_PRESSURE_PA).powf(EXPONENT)))
}

/// Density (kg/m³) at a pressure altitude (m).
pub fn density_kgpm3(pressure_altitude_m: f64) -> f64 {
    let ratio = (1.0 - pressure_altitude_m / SCALE_M).clamp(0.1, 1.2);
    SEA_LEVEL_DENSITY_KGPM3 * ratio.powf(1.0 / EXPONENT - 1.0)
}

/// Airspeed (m/s) of a differential pressure (Pa) at a density: √(2Δp/ρ); negative pressures give zero.
pub fn airspeed_mps(differential_pa: f64, density_kgpm3: f64) -> f64 {
    (2.0 * differential_pa.max(0.0) / density_kgpm3).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pressure_altitude_matches_the_standard_table() {
        // ISO 2533: 1000 m is 89874.6 Pa and 1.11164 kg/m³.
        let altitude = pressure_altitude_m(89_874.6).unwrap();
        assert!((altitude - 1000.0).abs() < 0.5, "{altitude}");
        assert!((density_kgpm3(1000.0) - 1.11164).abs() < 2e-4);
        assert_eq!(pressure_altitude_m(f64::NAN), None);
    }

    #[test]
    fn airspeed_of_the_reference_point() {
        assert!((airspeed_mps(296.45, 1.225) - 22.0).abs() < 0.01);
        assert_eq!(airspeed_mps(-3.0, 1.2), 0.0);
    }
}
