//! What a run tells whoever watches it: lines of JSON.

use serde::{Deserialize, Serialize};

use crate::lines::LineLog;
use bateleur_host::guarantee::Guarantee;

/// One thing that happened.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// What this machine lets the executive promise.
    Guarantees {
        /// The promises.
        list: Vec<Guarantee>,
    },
    /// Every partition is ready; frame 0 is about to begin.
    Ready {
        /// Partitions of the module.
        partitions: usize,
        /// The module, where the plan has several.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        module: Option<String>,
    },
    /// A health error.
    Fault {
        /// Module time, s.
        time_s: f64,
        /// The partition.
        partition: String,
        /// The error.
        error: String,
        /// What is done about it.
        action: String,
        /// What is known beside it.
        detail: String,
    },
    /// A health error of the module itself.
    ModuleFault {
        /// Module time, s.
        time_s: f64,
        /// The error.
        error: String,
        /// What is done about it.
        action: String,
        /// What is known beside it.
        detail: String,
    },
    /// The module was reset, and its frame 0 begins again.
    ModuleRestarted {
        /// Module time of frame 0, s.
        time_s: f64,
        /// From the error to frame 0, ms.
        after_ms: f64,
    },
    /// The successor of a failed process had its first window.
    Recovered {
        /// Module time, s.
        time_s: f64,
        /// The partition.
        partition: String,
        /// From the fault to that window, ms.
        after_ms: f64,
    },
    /// A partition has something to say.
    Message {
        /// Module time, s.
        time_s: f64,
        /// The partition.
        partition: String,
        /// Its words.
        text: String,
    },
    /// What was planned for this instant could not be done.
    Undone {
        /// Module time, s.
        time_s: f64,
        /// The partition, or the dispatcher.
        partition: String,
        /// What was planned, and why nothing was done.
        text: String,
    },
    /// Another schedule was asked for.
    ScheduleRequested {
        /// Module time, s.
        time_s: f64,
        /// The schedule.
        schedule: String,
        /// The partition that asked, or `operator`.
        by: String,
    },
    /// The module has changed to another schedule.
    ScheduleChanged {
        /// Module time of the major frame that began with it, s.
        time_s: f64,
        /// The schedule.
        schedule: String,
        /// The one before.
        before: String,
    },
    /// A log can not be written. Told once for each log; what is lost from then on is counted.
    LogLost {
        /// Module time, s.
        time_s: f64,
        /// The file.
        log: String,
        /// Why.
        reason: String,
    },
    /// The log of the ports could not be gone on with, and goes on in another file.
    LogCut {
        /// Module time, s.
        time_s: f64,
        /// The file that ends.
        log: String,
        /// Why, and what it goes on in.
        reason: String,
    },
    /// Something that was written to a port is not in its log, which goes on. Told once for each port.
    LogLacks {
        /// Module time, s.
        time_s: f64,
        /// The file.
        log: String,
        /// Why.
        reason: String,
    },
    /// The run is over.
    Stopped {
        /// Why.
        reason: String,
        /// Module time, s.
        module_time_s: f64,
        /// Windows granted.
        windows: u64,
        /// Windows that the dispatcher started late.
        late_windows: u64,
        /// Switches, starts and ends of windows, that the dispatcher reached late.
        #[serde(default)]
        late_switches: u64,
        /// Windows that were lost because the dispatcher came later than they last.
        #[serde(default)]
        lost_windows: u64,
        /// Switches that it reached later than `late_after` of the plan: the error `late_dispatcher`.
        #[serde(default)]
        too_late_switches: u64,
        /// Resets of the module.
        #[serde(default)]
        resets: u32,
        /// Windows that were not closed in time.
        window_overruns: u64,
        /// Processor time for which dispatchers held their cores in slack, so as to be awake at the next start, s.
        #[serde(default)]
        spun_s: f64,
        /// Windows whose record was lost because the log could not keep up.
        lost_records: u64,
        /// Records of logs that could not be written.
        #[serde(default)]
        unwritten_records: u64,
    },
}

impl Event {
    /// The same in the time of a module that began `by_s` seconds earlier.
    #[must_use]
    pub fn later(mut self, by_s: f64) -> Self {
        match &mut self {
            Self::Guarantees { .. } | Self::Ready { .. } => {}
            Self::Fault { time_s, .. }
            | Self::ModuleFault { time_s, .. }
            | Self::ModuleRestarted { time_s, .. }
            | Self::Recovered { time_s, .. }
            | Self::Message { time_s, .. }
            | Self::Undone { time_s, .. }
            | Self::ScheduleRequested { time_s, .. }
            | Self::ScheduleChanged { time_s, .. }
            | Self::LogLost { time_s, .. }
            | Self::LogCut { time_s, .. }
            | Self::LogLacks { time_s, .. }
            | Self::Stopped { module_time_s: time_s, .. } => *time_s += by_s,
        }
        self
    }
}

/// Where events go. A reader that is gone or does not read costs nothing: a thread of its own writes the lines.
#[derive(Debug, Default)]
pub struct Events {
    lines: Option<LineLog>,
    logs_lost: bool,
}

impl Events {
    /// Into these lines, or nowhere.
    #[must_use]
    pub fn new(lines: Option<LineLog>) -> Self {
        Self { lines, logs_lost: false }
    }

    /// Tells one.
    pub fn tell(&mut self, event: &Event) {
        self.logs_lost |= matches!(event, Event::LogLost { .. });
        let (Some(lines), Ok(mut line)) = (&mut self.lines, serde_json::to_vec(event)) else { return };
        line.push(b'\n');
        lines.push(&line);
    }

    /// Whether it was told of a log that can not be written, whoever listened.
    #[must_use]
    pub fn has_told_lost_log(&self) -> bool {
        self.logs_lost
    }

    /// Hands on what a reader was too slow for when it was told.
    pub fn flush(&mut self) {
        if let Some(lines) = &mut self.lines {
            lines.flush();
        }
    }

    /// Waits a little until what was told has been written.
    pub fn finish(&mut self) {
        if let Some(lines) = &mut self.lines {
            lines.finish();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ready(partitions: usize) -> Event {
        Event::Ready { partitions, module: None }
    }

    #[test]
    fn a_log_that_was_lost_is_remembered_also_where_nobody_listens() {
        let mut events = Events::new(None);
        events.tell(&ready(1));
        assert!(!events.has_told_lost_log());
        events.tell(&Event::LogLost { time_s: 1.0, log: "windows.csv".into(), reason: "full".into() });
        events.tell(&ready(1));
        assert!(events.has_told_lost_log());
    }

    #[test]
    fn event_of_a_host_that_came_back_is_told_in_the_time_of_the_flight() {
        let event = |time_s| Event::Message { time_s, partition: "relay_nav".into(), text: "up".into() };
        assert_eq!(event(0.5).later(62.0), event(62.5));
        assert_eq!(ready(9).later(62.0), ready(9));
    }
}
