//! What this machine gives a partitioned flight, and what each lack costs.
//!
//! Responsible for: one [`Finding`] for each property of the machine that moves a window or opens a wall: its state,
//! what the lack costs, how to mend it. Properties that the kernel writes down are read below a [`Root`], so that tests
//! lay out machines that they do not run on; properties that only trying shows come in as [`Tried`]. It must never
//! change the machine.

mod processor;
mod root;
mod space;
#[cfg(test)]
mod tests;
mod time;
mod tried;

use serde::Serialize;

pub(crate) use root::Root;
pub(crate) use tried::Tried;

/// How well a property is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum State {
    /// As a flight wants it.
    Well,
    /// Good to know; nothing has to be done.
    Note,
    /// Costs something.
    Lacks,
}

/// One property of the machine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub(crate) struct Finding {
    /// What was looked at.
    pub(crate) topic: String,
    /// How well it is.
    pub(crate) state: State,
    /// What was found.
    pub(crate) found: String,
    /// What that costs; empty where it costs nothing.
    pub(crate) costs: String,
    /// The command or file that mends it; empty where there is nothing to mend.
    pub(crate) mend: String,
}

impl Finding {
    fn well(topic: &str, found: impl Into<String>) -> Self {
        let nothing = String::new;
        Self {
            topic: topic.into(),
            state: State::Well,
            found: found.into(),
            costs: nothing(),
            mend: nothing(),
        }
    }

    fn note(topic: &str, found: impl Into<String>, costs: impl Into<String>) -> Self {
        Self { state: State::Note, costs: costs.into(), ..Self::well(topic, found) }
    }

    fn lacks(
        topic: &str,
        found: impl Into<String>,
        costs: impl Into<String>,
        mend: impl Into<String>,
    ) -> Self {
        Self { state: State::Lacks, costs: costs.into(), mend: mend.into(), ..Self::well(topic, found) }
    }
}

/// For whom the machine is examined.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Subject {
    /// The processors whose time is partitioned.
    pub(crate) cores: Vec<u32>,
    /// Ports of the module.
    pub(crate) ports: usize,
}

/// Everything that can be said, in the order of its weight within each group: time, then space.
#[must_use]
pub(crate) fn examine(root: &Root, subject: &Subject, tried: &Tried) -> Vec<Finding> {
    let mut findings = time::findings(root, subject);
    findings.extend(processor::findings(root, subject));
    findings.extend(space::findings(root, subject, tried));
    findings.extend(tried.promises.iter().map(promise));
    findings
}

/// A promise of a run, kept or not: found by doing what a run does.
fn promise(guarantee: &bateleur_host::guarantee::Guarantee) -> Finding {
    if guarantee.held {
        return Finding::well(&guarantee.promise, guarantee.detail.as_str());
    }
    // The detail of a promise names its own way out after the reason.
    let (why, mend) =
        guarantee.detail.rsplit_once("; ").unwrap_or((&guarantee.detail, "as its finding above says"));
    Finding::lacks(&guarantee.promise, why, broken_promise(&guarantee.promise), mend)
}

fn broken_promise(promise: &str) -> &'static str {
    match promise {
        "a window starts and ends at its instant" => {
            "without real-time priority a window's end slips by 0.2 to 0.3 ms (median) and 0.6 to 0.8 ms (99 %), a start waits for the ordinary scheduler"
        }
        "a window's end holds every process of a partition" => {
            "SIGSTOP reaches one process, 21 us (median) to 71 us (99 %) later than a freeze; a child in a session of its own runs on in the others' windows"
        }
        "exclusive cores" => {
            "two dispatchers of one priority on one processor know nothing of each other: a window begins when the other's partition lets go"
        }
        "the executive's memory stays in place" => {
            "a page fault inside a switch: microseconds, with swap milliseconds"
        }
        _ => "the promise is not given: `--require strict` refuses to start, every report says so",
    }
}
