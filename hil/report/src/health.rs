//! `health.jsonl`: the errors that the health monitor saw, one JSON object a line.

use serde::{Deserialize, Serialize};

/// Name of the file in a flight's folder.
pub const FILE: &str = "health.jsonl";

/// One line of the health log.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HealthEntry {
    /// Module time, ns.
    pub time_ns: u64,
    /// The partition; `None` for an error of the module itself.
    #[serde(default)]
    pub partition: Option<String>,
    /// Which of the partition's processes, from 1.
    #[serde(default)]
    pub generation: u64,
    /// What happened, as the health tables call it.
    pub error: String,
    /// What was done about it, as the health tables call it.
    pub action: String,
    /// Anything else worth saying.
    #[serde(default)]
    pub detail: String,
    /// Module time at which the successor's first window was granted, ns.
    #[serde(default)]
    pub recovered_ns: Option<u64>,
}

impl HealthEntry {
    /// The partition, or that it is of the module itself.
    pub fn of_whom(&self) -> &str {
        self.partition.as_deref().unwrap_or("module")
    }

    /// Until the successor's first window, ms.
    pub fn recovery_ms(&self) -> Option<f64> {
        self.recovered_ns.map(|recovered_ns| recovered_ns.saturating_sub(self.time_ns) as f64 / 1e6)
    }

    /// Whether anything was done beyond writing it down.
    pub fn acted_on(&self) -> bool {
        self.action != "ignore"
    }

    /// Whether a new process took over.
    pub fn restarted(&self) -> bool {
        self.action.ends_with("restart") || self.action == "takeover"
    }
}

/// The entries of a health log, and how many lines could not be read: the last of a killed run, as a rule.
pub fn parse(text: &str) -> (Vec<HealthEntry>, usize) {
    let lines = text.lines().filter(|line| !line.trim().is_empty());
    let (good, bad): (Vec<_>, Vec<_>) = lines.map(serde_json::from_str).partition(Result::is_ok);
    (good.into_iter().flatten().collect(), bad.len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn broken_last_line_is_counted_and_the_rest_kept() {
        let text = concat!(
            r#"{"time_ns":5,"partition":"imu","generation":1,"error":"killed","action":"warm_restart","recovered_ns":7}"#,
            "\n\n",
            r#"{"time_ns":6,"partition":null,"error":"late_dispatcher","action":"ignore"}"#,
            "\n{\"time_ns\":7,\"par",
        );
        let (entries, broken) = parse(text);
        assert_eq!((entries.len(), broken), (2, 1));
        assert!(entries[0].restarted() && entries[0].acted_on());
        assert!(!entries[1].acted_on() && entries[1].partition.is_none());
    }
}
