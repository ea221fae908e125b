//! A module in which one partition makes random system calls, beside six that have nothing to do with it.

use crate::harm::NEEDS;
use crate::schedule::{Sketch, channel_between, ports_of};

/// Until then the fuzzer is quiet, ms: what the machine does to the others by itself.
pub const QUIET_MS: u64 = 1_000;
/// Who sends to whom, and has nothing to do with the fuzzer.
pub const PAIRS: [(&str, &str); 3] = [("early", "late"), ("next", "last"), ("writer", "reader")];

/// Whose faults are expected: those of whoever harms the others, and of who has a channel with it.
pub const EXPECTED: &[&str] = &["fuzzer", "attacker", "ear"];

/// What a fuzzer is granted.
#[derive(Debug)]
pub struct Kind {
    /// For people.
    pub name: &'static str,
    /// Keys of its partition.
    keys: &'static str,
    /// Attributes that say so.
    attributes: &'static str,
}

/// All kinds.
pub const KINDS: [Kind; 4] = [
    Kind { name: "with nothing granted", keys: "", attributes: "" },
    Kind { name: "with a network", keys: "network = true", attributes: ", network = true" },
    Kind {
        name: "with threads and a network",
        keys: "network = true\nthreads = 8",
        attributes: ", network = true, threads = 3",
    },
    Kind {
        name: "with what has a bound",
        keys: "system_calls = [\"timers\", \"inotify\", \"local_sockets\", \"queued_signals\"]",
        attributes: "",
    },
];

impl Kind {
    /// The module with a fuzzer.
    pub fn sketch(&self, seed: u64) -> Sketch {
        let fuzzer = format!(
            "attributes = {{ seed = {seed}, from_ms = {QUIET_MS}, tells = true{} }}\n\
             retained = \"4KiB\"\n\
             restart = {{ start = \"warm\", budget = 1000000, within = \"1s\", then = \"idle\" }}\n\
             health = {{ startup_timeout = \"warm_restart\" }}\n{}\n{}",
            self.attributes,
            self.keys,
            ports_of("fuzzer", &[("own", "source", "sampling")])
        );
        beside_six("fuzzer", &fuzzer)
    }
}

/// The module: three pairs around a partition of that name and program, which has the port `own`, and one who listens to it.
pub fn beside_six(program: &str, keys: &str) -> Sketch {
    let source =
        |name: &str| ports_of(name, &[("numbers", "source", "sampling"), ("queue", "source", "queuing")]);
    let destination = |name: &str| {
        let ports = [("numbers", "destination", "sampling"), ("queue", "destination", "queuing")];
        NEEDS.to_owned() + &ports_of(name, &ports)
    };
    let mut sketch = Sketch::new().table("[health]\nsilence_windows = 5\n");
    for (from, to) in PAIRS {
        sketch = sketch
            .table(&channel_between(&format!("{from}.numbers"), &format!("{to}.numbers")))
            .table(&channel_between(&format!("{from}.queue"), &format!("{to}.queue")));
    }
    sketch
        .table(&channel_between(&format!("{program}.own"), "ear.loose"))
        .partition("early", "neighbour", 800, &source("early"))
        .partition("next", "neighbour", 800, &source("next"))
        .partition(program, program, 5_000, keys)
        .partition("late", "neighbour", 800, &destination("late"))
        .partition("last", "neighbour", 800, &destination("last"))
        .partition("writer", "neighbour", 800, &source("writer"))
        .partition("reader", "neighbour", 800, &destination("reader"))
        .partition("ear", "neighbour", 300, &ports_of("ear", &[("loose", "destination", "sampling")]))
}
