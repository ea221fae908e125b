//! What a run tells whoever watches it: lines of JSON.

use std::io::Write;

use serde::{Deserialize, Serialize};

use crate::guarantee::Guarantee;

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
        /// Windows that were not closed in time.
        window_overruns: u64,
        /// Windows whose record was lost because the log could not keep up.
        lost_records: u64,
    },
}

/// Where events go. A reader that is gone costs nothing.
pub struct Events(Option<Box<dyn Write + Send>>);

impl Events {
    /// To `sink`, or nowhere.
    #[must_use]
    pub fn new(sink: Option<Box<dyn Write + Send>>) -> Self {
        Self(sink)
    }

    /// Tells one.
    pub fn tell(&mut self, event: &Event) {
        let Some(sink) = &mut self.0 else { return };
        let Ok(mut line) = serde_json::to_vec(event) else { return };
        line.push(b'\n');
        if sink.write_all(&line).and_then(|()| sink.flush()).is_err() {
            self.0 = None;
        }
    }
}
