//! Counts tests by the lines in which their runners sum up.

/// How many tests did what.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(crate) struct Tally {
    pub(crate) passed: u64,
    pub(crate) failed: u64,
    pub(crate) skipped: u64,
}

impl Tally {
    /// Adds what another one has counted.
    pub(crate) fn add(&mut self, other: Self) {
        self.passed += other.passed;
        self.failed += other.failed;
        self.skipped += other.skipped;
    }

    /// Adds what a line says, if it is a runner's last word.
    pub(crate) fn add_line(&mut self, line: &str) {
        let line = without_colors(line);
        // nextest repeats what a failed test said, indented: its inner result must not count once more.
        let counts = match (line.strip_prefix("test result: "), line.trim().strip_prefix("Summary [")) {
            // cargo test: "test result: ok. 12 passed; 0 failed; 3 ignored; …"
            (Some(rest), _) => rest.split_once(". ").map(|(_, counts)| counts),
            // nextest: "Summary [ 1.2s] 9 tests run: 7 passed (1 slow), 2 failed, 1 skipped"
            (_, Some(rest)) => rest.split_once("run: ").map(|(_, counts)| counts),
            _ => None,
        };
        let Some(counts) = counts else { return };
        without_brackets(counts).split([',', ';']).for_each(|part| self.add_count(part.trim()));
    }

    fn add_count(&mut self, part: &str) {
        let Some((number, what)) = part.split_once(' ') else { return };
        let Ok(number) = number.parse::<u64>() else { return };
        match what {
            "passed" => self.passed += number,
            "failed" | "exec failed" | "timed out" => self.failed += number,
            "skipped" | "ignored" => self.skipped += number,
            _ => {}
        }
    }
}

impl std::fmt::Display for Tally {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(formatter, "{} passed, {} failed, {} skipped", self.passed, self.failed, self.skipped)
    }
}

/// A line without terminal escapes of the kind `ESC [ … letter`.
pub(crate) fn without_colors(line: &str) -> String {
    let mut plain = String::with_capacity(line.len());
    let mut characters = line.chars();
    while let Some(character) = characters.next() {
        if character == '\u{1b}' {
            characters.by_ref().skip(1).find(char::is_ascii_alphabetic);
        } else {
            plain.push(character);
        }
    }
    plain
}

/// nextest adds "(1 slow, 1 flaky)" to a count; those tests are in the count already.
fn without_brackets(counts: &str) -> String {
    let mut depth = 0_u32;
    let keep = |character: &char| {
        match character {
            '(' => depth += 1,
            ')' => depth = depth.saturating_sub(1),
            _ => return depth == 0,
        }
        false
    };
    counts.chars().filter(keep).collect::<String>().replace(" ,", ",")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(lines: &[&str]) -> (u64, u64, u64) {
        let mut tally = Tally::default();
        lines.iter().for_each(|line| tally.add_line(line));
        (tally.passed, tally.failed, tally.skipped)
    }

    #[test]
    fn cargo_test_and_nextest_are_both_understood() {
        let plain =
            "test result: ok. 12 passed; 0 failed; 3 ignored; 0 measured; 0 filtered out; finished in 0.01s";
        let broken = "test result: FAILED. 1 passed; 2 failed; 0 ignored; 0 measured; 0 filtered out";
        assert_eq!(of(&[plain, broken]), (13, 2, 3));
        assert_eq!(of(&["     Summary [   1.234s] 301 tests run: 301 passed, 4 skipped"]), (301, 0, 4));
        let slow = "     Summary [  61.234s] 9/12 tests run: 6 passed (1 slow, 1 flaky), 2 failed, 1 timed out, 4 skipped";
        assert_eq!(of(&[slow]), (6, 3, 4));
    }

    #[test]
    fn colors_do_not_matter_and_other_lines_count_nothing() {
        let colored = "\u{1b}[32;1m     Summary\u{1b}[0m [   0.5s] \u{1b}[1m2\u{1b}[0m tests run: \u{1b}[1m2\u{1b}[0m passed, 0 skipped";
        assert_eq!(of(&[colored]), (2, 0, 0));
        assert_eq!(of(&["running 5 tests", "3 passed, nobody said so"]), (0, 0, 0));
        assert_eq!(of(&["    test result: FAILED. 0 passed; 1 failed; 0 ignored"]), (0, 0, 0));
    }

    #[test]
    fn it_is_written_as_it_is_read_elsewhere() {
        assert_eq!(Tally { passed: 7, failed: 1, skipped: 2 }.to_string(), "7 passed, 1 failed, 2 skipped");
    }
}
