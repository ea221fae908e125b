//! Numbers of a flight, as a command line gives them: those of the air have the same limits as the simulator's.
//!
//! Their arguments must allow negative numbers, or `-3` is taken for an option and never comes here.

/// Speed of the mean wind, m/s.
pub(crate) fn wind(text: &str) -> Result<f64, String> {
    match number(text)? {
        speed if (0.0..=50.0).contains(&speed) => Ok(speed),
        _ => Err("it must lie between 0 and 50 m/s; --wind-from says where it comes from".into()),
    }
}

/// Where the wind comes from, degrees clockwise from north.
pub(crate) fn direction(text: &str) -> Result<f64, String> {
    match number(text)? {
        degrees if (-360.0..=360.0).contains(&degrees) => Ok(degrees),
        _ => {
            Err("it must lie between -360 and 360 degrees, clockwise from north: 270 is a wind from the west"
                .into())
        }
    }
}

/// Seed of everything random.
pub(crate) fn seed(text: &str) -> Result<u64, String> {
    text.parse().map_err(|_| "it must be a whole number from 0 to 18446744073709551615".into())
}

fn number(text: &str) -> Result<f64, String> {
    text.parse().map_err(|_| "it must be a number".into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wind_from_nowhere_on_the_compass_is_refused() {
        assert_eq!(direction("-90"), Ok(-90.0));
        assert_eq!(direction("360"), Ok(360.0));
        for wrong in ["999", "-361", "nan", "west"] {
            assert!(direction(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn wind_against_its_own_direction_and_storms_are_refused() {
        assert_eq!(wind("12.5"), Ok(12.5));
        for wrong in ["-1", "51", "inf", "NaN", "strong"] {
            assert!(wind(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn seeds_below_zero_are_refused() {
        assert_eq!((seed("0"), seed("18446744073709551615")), (Ok(0), Ok(u64::MAX)));
        for wrong in ["-1", "1.5", "18446744073709551616", "dice"] {
            assert!(seed(wrong).is_err(), "{wrong}");
        }
    }
}
