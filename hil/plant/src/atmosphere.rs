//! International Standard Atmosphere in the troposphere (ISO 2533), without temperature offset.

/// Pressure at mean sea level, Pa.
pub const SEA_LEVEL_PRESSURE_PA: f64 = 101_325.0;
/// Standard gravity, m/s². The plant uses it everywhere; at the runway the true value is 0.1 % less.
pub const GRAVITY_MPS2: f64 = 9.806_65;

const SEA_LEVEL_TEMPERATURE_K: f64 = 288.15;
const LAPSE_K_PER_M: f64 = 0.0065;
const GAS_CONSTANT: f64 = 287.052_87;

/// Air at one height.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Air {
    /// Static pressure, Pa.
    pub pressure_pa: f64,
    /// Density, kg/m³.
    pub density_kgpm3: f64,
}

/// Air at a height above mean sea level, m. Heights outside −1000 m to 11 km are cut to that range.
pub fn air(height_m: f64) -> Air {
    let ratio = 1.0 - LAPSE_K_PER_M * height_m.clamp(-1000.0, 11_000.0) / SEA_LEVEL_TEMPERATURE_K;
    let pressure_pa = SEA_LEVEL_PRESSURE_PA * ratio.powf(GRAVITY_MPS2 / (GAS_CONSTANT * LAPSE_K_PER_M));
    Air { pressure_pa, density_kgpm3: pressure_pa / (GAS_CONSTANT * SEA_LEVEL_TEMPERATURE_K * ratio) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn standard_values_at_sea_level_and_one_kilometre() {
        assert!((air(0.0).density_kgpm3 - 1.225).abs() < 1e-4);
        assert!((air(1000.0).pressure_pa - 89_874.6).abs() < 1.0);
        assert!((air(1000.0).density_kgpm3 - 1.1116).abs() < 1e-4);
    }
}
