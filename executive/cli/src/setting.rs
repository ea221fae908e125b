//! Values of options that several verbs take.

/// An attribute that is replaced: `--set`.
#[derive(Debug, Clone, PartialEq)]
pub struct Setting {
    /// The partition.
    pub partition: String,
    /// Its attribute.
    pub attribute: String,
    /// What it is instead.
    pub value: serde_json::Value,
}

/// Reads a `--set`.
///
/// # Errors
/// Says how it is written where it is written otherwise.
pub fn parse_setting(text: &str) -> Result<Setting, String> {
    let wrong = || format!("\"{text}\" is not PARTITION.ATTRIBUTE=VALUE, such as controller.laps=3");
    let (name, value) = text.split_once('=').ok_or_else(wrong)?;
    let (partition, attribute) = name.split_once('.').ok_or_else(wrong)?;
    let value = serde_json::from_str(value).unwrap_or_else(|_| value.into());
    Ok(Setting { partition: partition.into(), attribute: attribute.into(), value })
}

/// Reads a module time, s. The option must allow negative numbers, or `-3` is taken for an option and never comes here.
///
/// # Errors
/// Says what a module time is where it is none.
pub fn module_time(text: &str) -> Result<f64, String> {
    let seconds: f64 = text.parse().map_err(|_| "it must be a number".to_owned())?;
    match seconds.is_finite() && seconds >= 0.0 {
        true => Ok(seconds),
        false => Err("it must be a module time in seconds, 0 or above".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn module_times_below_zero_and_without_end_are_refused() {
        assert_eq!((module_time("0"), module_time("2.5")), (Ok(0.0), Ok(2.5)));
        for wrong in ["-1", "inf", "nan", "soon"] {
            assert!(module_time(wrong).is_err(), "{wrong}");
        }
    }
}
