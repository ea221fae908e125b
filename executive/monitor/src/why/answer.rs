//! What is asked and answered, and the sentence for it.

use serde::{Deserialize, Serialize};

use bateleur_time::dispatcher::LATE_NS;
use bateleur_time::window_record::{Missed, WindowRecord};

/// The file of answers in the folder of a run: one JSON object a line.
pub const FILE: &str = "why.jsonl";

/// What happened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Kind {
    /// The dispatcher came late to a window's start.
    LateStart,
    /// It came late to its end.
    LateEnd,
    /// A window was lost.
    LostWindow,
    /// It was not closed.
    Overrun,
    /// So many in a row were not closed; this is the last one.
    Silence,
    /// It was not closed, and the partition waited for a processor for most of it.
    ProcessorTaken,
}

impl Kind {
    /// What the record of a window alone says.
    pub(crate) fn of(record: &WindowRecord) -> Option<Self> {
        if record.is_lost() {
            Some(Self::LostWindow)
        } else if record.is_late() {
            Some(Self::LateStart)
        } else if !record.ending.shared && record.ending.late_ns > LATE_NS {
            Some(Self::LateEnd)
        } else {
            None
        }
    }

    /// The span in which somebody had the processor who was not to, module time, ns.
    pub(super) fn span(self, record: &WindowRecord) -> Option<(u64, u64)> {
        let at = &record.occurrence;
        let (from_ns, to_ns) = match self {
            Self::LateStart => (at.start_ns, at.start_ns + at.late_ns),
            Self::LateEnd => (at.end_ns, at.end_ns + record.ending.late_ns),
            Self::LostWindow if record.missed == Some(Missed::TooLate) => {
                (at.start_ns, at.start_ns + at.late_ns.max(at.window.duration_ns()))
            }
            Self::LostWindow => (at.start_ns, at.end_ns),
            Self::Overrun | Self::Silence | Self::ProcessorTaken => (record.granted_ns?, at.end_ns),
        };
        (from_ns < to_ns).then_some((from_ns, to_ns))
    }

    /// Whether the dispatcher is who waited.
    pub(super) fn is_dispatchers(self) -> bool {
        matches!(self, Self::LateStart | Self::LateEnd | Self::LostWindow)
    }
}

/// A question of the monitor.
#[derive(Debug, Clone)]
pub(super) struct Question {
    pub(super) kind: Kind,
    pub(super) partition: String,
    /// As the plan counts processors.
    pub(super) core: u32,
    pub(super) frame: u64,
    /// Module time at which the span begins, ns.
    pub(super) module_ns: u64,
    /// The span, CLOCK_MONOTONIC, ns.
    pub(super) from_ns: u64,
    pub(super) to_ns: u64,
    /// Processes of the partitions, with their names.
    pub(super) processes: Vec<(i32, String)>,
    /// Questions before it that were not asked.
    pub(super) unasked: u64,
}

/// Who had the processor.
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(tag = "taker", rename_all = "snake_case")]
pub enum Taker {
    /// A thread.
    Thread {
        /// Its name, as the kernel has it.
        name: String,
        /// Its number.
        tid: i32,
        /// Its priority in words.
        priority: String,
        /// Whose it is, as far as that could still be found.
        of: Option<String>,
    },
    /// An interrupt.
    Interrupt {
        /// Its name.
        name: String,
    },
    /// The machine below this kernel.
    Host,
    /// The kernel, with interrupts or preemption switched off, on behalf of a thread; or the host.
    Kernel {
        /// The thread's name.
        name: String,
    },
    /// Whoever waited for it: the partition, or the dispatcher.
    Itself,
    /// Nobody: the partition did not want it, or the processor was idle.
    Nobody,
    /// It is not known.
    Unknown {
        /// Why not.
        why: String,
    },
}

/// How long somebody had it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Share {
    /// Who.
    #[serde(flatten)]
    pub who: Taker,
    /// How long, ms.
    pub ms: f64,
}

/// A stretch of the trace.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Slice {
    /// From the span's begin on, us.
    pub at_us: u64,
    /// Its length, us.
    pub for_us: u64,
    /// The thread or interrupt.
    pub name: String,
}

/// Where the answer comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Source {
    /// The kernel's trace of that span.
    Trace,
    /// What the kernel counted for threads shortly after it.
    Counters,
}

/// An answer.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Answer {
    /// Module time at which the span begins, s.
    pub time_s: f64,
    /// The same on CLOCK_MONOTONIC, s: what other traces of the machine count in.
    pub monotonic_s: f64,
    /// The frame.
    pub frame: u64,
    /// What happened.
    pub kind: Kind,
    /// Whose window it was.
    pub partition: String,
    /// The processor, as the plan counts.
    pub core: u32,
    /// How long the span is that is accounted for: the delay, or the window from its grant on, ms.
    pub span_ms: f64,
    /// Who had the processor.
    #[serde(flatten)]
    pub taker: Taker,
    /// For how much of the span, ms; with counters, of the time in which they were compared.
    pub took_ms: f64,
    /// The whole span by who had the processor, longest first.
    pub shares: Vec<Share>,
    /// The same as it went, as far as it is not too long.
    pub slices: Vec<Slice>,
    /// What the host took from this processor about then, as the kernel counts it (in steps of 10 ms), ms.
    pub steal_ms: u64,
    /// Where that is from.
    pub source: Source,
    /// Events before this one of which nobody asked: too many came at once.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub unasked: u64,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde calls it so")]
fn is_zero(number: &u64) -> bool {
    *number == 0
}

impl Taker {
    /// In words.
    #[must_use]
    pub fn words(&self) -> String {
        match self {
            Self::Thread { name, tid, priority, of } => {
                let of = of.as_ref().map_or_else(String::new, |of| format!(" of {of}"));
                format!("thread {name}{of} (TID {tid}, {priority})")
            }
            Self::Interrupt { name } => format!("interrupt {name}"),
            Self::Host => "the host of this virtual machine, or firmware".into(),
            Self::Kernel { name } => {
                format!(
                    "the kernel, with interrupts or preemption off while it worked for {name}, or the host"
                )
            }
            Self::Itself => "itself".into(),
            Self::Nobody => "nobody".into(),
            Self::Unknown { why } => format!("not known: {why}"),
        }
    }
}

impl Taker {
    fn is_of_partition(&self, partition: &str) -> bool {
        matches!(self, Self::Thread { of: Some(of), .. } if of.strip_prefix("partition ") == Some(partition))
    }
}

impl Answer {
    /// In a sentence.
    #[must_use]
    pub fn sentence(&self) -> String {
        let Self { partition, core, frame, span_ms, took_ms, .. } = self;
        let what = match self.kind {
            Kind::LateStart => format!("{partition}'s window on core {core} began {span_ms:.1} ms late"),
            Kind::LateEnd => format!("{partition}'s window on core {core} ended {span_ms:.1} ms late"),
            Kind::LostWindow => format!("{partition}'s window on core {core} was lost"),
            Kind::Overrun => format!("{partition} did not close its window on core {core}"),
            Kind::Silence => format!("{partition} was silent on core {core}"),
            Kind::ProcessorTaken => format!("{partition} had no processor in its window on core {core}"),
        };
        format!("{what} in frame {frame}: {}", self.reason(*took_ms))
    }

    fn reason(&self, took_ms: f64) -> String {
        let span_ms = self.span_ms;
        match (&self.taker, self.source) {
            (Taker::Unknown { .. }, _) => self.taker.words(),
            (Taker::Itself, _) if self.kind.is_dispatchers() => {
                format!("the dispatcher itself was at work for {took_ms:.1} ms of {span_ms:.1}")
            }
            (Taker::Itself, _) => {
                let others = self.shares.iter().filter(|share| !share.who.is_of_partition(&self.partition));
                let most = others.max_by(|one, other| one.ms.total_cmp(&other.ms));
                let beside = most
                    .filter(|share| share.ms * 10.0 >= span_ms)
                    .map(|share| format!("; {} had the processor for {:.1} ms", share.who.words(), share.ms));
                format!("it computed for {took_ms:.1} ms of {span_ms:.1}{}", beside.unwrap_or_default())
            }
            (Taker::Nobody, _) if self.kind.is_dispatchers() => {
                format!("the processor was idle for {took_ms:.1} ms of {span_ms:.1}")
            }
            (Taker::Nobody, _) => {
                format!("it waited for something else than a processor for {took_ms:.1} ms of {span_ms:.1}")
            }
            (Taker::Host, _) if self.steal_ms > 0 => format!(
                "{} had the processor for {took_ms:.1} ms of {span_ms:.1} (it counts {} ms of steal about then)",
                self.taker.words(),
                self.steal_ms
            ),
            (taker, Source::Trace) => {
                format!("{} had the processor for {took_ms:.1} ms of {span_ms:.1}", taker.words())
            }
            (taker, Source::Counters) => format!(
                "{} had the processor shortly after it, as far as counters tell (there is no trace)",
                taker.words()
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(crate) fn answer(kind: Kind, taker: Taker) -> Answer {
        Answer {
            time_s: 1.5,
            monotonic_s: 100.5,
            frame: 75,
            kind,
            partition: "imu".into(),
            core: 1,
            span_ms: 8.25,
            taker,
            took_ms: 8.0,
            shares: Vec::new(),
            slices: Vec::new(),
            steal_ms: 0,
            source: Source::Trace,
            unasked: 0,
        }
    }

    #[test]
    fn each_answer_is_one_line_that_is_read_back_and_one_sentence() {
        let thread = Taker::Thread {
            name: "hog".into(),
            tid: 7,
            priority: "real-time priority 99".into(),
            of: Some("module second (PID 5)".into()),
        };
        for (kind, taker, sentence) in [
            (
                Kind::LateStart,
                thread.clone(),
                "imu's window on core 1 began 8.2 ms late in frame 75: thread hog of module second (PID 5) (TID 7, real-time \
                 priority 99) had the processor for 8.0 ms of 8.2",
            ),
            (
                Kind::Overrun,
                Taker::Itself,
                "imu did not close its window on core 1 in frame 75: it computed for 8.0 ms of 8.2",
            ),
            (
                Kind::Silence,
                Taker::Nobody,
                "imu was silent on core 1 in frame 75: it waited for something else than a processor for 8.0 ms of 8.2",
            ),
        ] {
            let answer = answer(kind, taker);
            assert_eq!(answer.sentence(), sentence);
            let line = serde_json::to_string(&answer).unwrap();
            assert_eq!(serde_json::from_str::<Answer>(&line).unwrap(), answer, "{line}");
        }
        let share = |who, ms| Share { who, ms };
        let storm = Taker::Interrupt { name: "soft 3 (network receive)".into() };
        let shares = vec![share(thread.clone(), 0.5), share(storm, 1.5), share(Taker::Nobody, 0.1)];
        let beside = Answer { shares, ..answer(Kind::Overrun, Taker::Itself) };
        assert_eq!(
            beside.sentence(),
            "imu did not close its window on core 1 in frame 75: it computed for 8.0 ms of 8.2; interrupt soft 3 (network receive) \
             had the processor for 1.5 ms"
        );
        let counted = Answer { source: Source::Counters, ..answer(Kind::ProcessorTaken, thread) };
        assert!(counted.sentence().ends_with("as far as counters tell (there is no trace)"));
    }
}
