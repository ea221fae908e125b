//! An error in a line: what was tried, and why it did not work, each thing said once.

/// The error and what caused it. A cause that repeats how the text before it ends, as those of libraries do that already name theirs, is
/// not said again.
pub fn causes(error: &anyhow::Error) -> String {
    let mut text = String::new();
    for cause in error.chain().map(ToString::to_string) {
        let subject = cause.split(": ").next().unwrap_or_default();
        if text.ends_with(&cause) {
            continue;
        }
        if text.is_empty() {
            text = cause;
        } else if !subject.is_empty() && subject.len() < cause.len() && text.ends_with(subject) {
            text.push_str(&cause[subject.len()..]);
        } else {
            text.push_str(": ");
            text.push_str(&cause);
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cause_that_repeats_what_was_said_is_said_once() {
        let missing = || std::io::Error::from_raw_os_error(2);
        let library = anyhow::Error::from(missing()).context(format!("out/ports.mcap: {}", missing()));
        let error = library.context("cannot replay out/ports.mcap");
        assert_eq!(causes(&error), "cannot replay out/ports.mcap: No such file or directory (os error 2)");
        let plain = anyhow::Error::from(missing()).context("cannot write x");
        assert_eq!(causes(&plain), "cannot write x: No such file or directory (os error 2)");
    }
}
