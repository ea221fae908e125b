//! The thread that answers: reads the trace of the processor that is asked about, judges, writes.
//!
//! Bounds: a ring of the kernel and as much again decoded for each processor, and [`MOST_BYTES`] of answers on the disk.

use std::collections::{HashMap, VecDeque};
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender};
use std::time::Duration;

use super::analysis::{self, Left, Verdict, Who};
use super::answer::{Answer, Kind, Question, Share, Slice, Source, Taker};
use super::owner::Owners;
use super::without_trace::{self, Busy};
use bateleur_host::instance;
use bateleur_system::time::now_ns;
use bateleur_system::trace::{Event, Trace};

/// Answers on the disk, bytes, most.
const MOST_BYTES: u64 = 8 << 20;
/// Events of one processor that are kept, most: about as many as a full ring of the kernel has.
const MOST_EVENTS: usize = 1 << 15;
/// Slices and shares of one answer, most.
const MOST_SLICES: usize = 32;
const MOST_SHARES: usize = 8;
/// Between two looks at what the host takes, while nobody asks.
const LOOK: Duration = Duration::from_secs(1);
/// Looks at it that are remembered.
const LOOKS: usize = 64;
/// Between two looks at counters, ns, where there is no trace.
const COUNT_NS: u64 = 1_000_000_000;
/// How the kernel counts what the host takes: in hundredths of a second.
const STEAL_MS: u64 = 10;

/// The processors with windows: as the plan counts them, and as the machine does.
pub type Cores = Vec<(u32, u32)>;

/// See the module's head.
pub(super) struct Answerer {
    file: File,
    bytes: u64,
    cores: Cores,
    tells: SyncSender<Answer>,
    owners: Owners,
    events: HashMap<u32, (VecDeque<Event>, Left)>,
    dispatchers: HashMap<u32, i32>,
    /// By time: what the host had taken from each processor.
    steal: VecDeque<(u64, Vec<u64>)>,
    /// Of each processor: when its counters were compared, and who used most.
    counted: HashMap<u32, (u64, Option<Busy>)>,
}

impl Answerer {
    pub(super) fn new(path: &Path, cores: Cores, tells: SyncSender<Answer>) -> io::Result<Self> {
        let file = OpenOptions::new().create(true).append(true).open(path)?;
        Ok(Self {
            bytes: file.metadata()?.len(),
            file,
            cores,
            tells,
            owners: Owners::default(),
            events: HashMap::new(),
            dispatchers: HashMap::new(),
            steal: VecDeque::new(),
            counted: HashMap::new(),
        })
    }

    /// Answers until nobody asks any more.
    pub(super) fn run(mut self, run: &str, questions: &Receiver<Question>) {
        let real: Vec<u32> = self.cores.iter().map(|(_, real)| *real).collect();
        instance::sweep_traces(); // of executives that were killed
        // Without one, answers say that they are from counters.
        let mut trace = Trace::begin(run, &real).ok();
        self.look_at_host();
        loop {
            match questions.recv_timeout(LOOK) {
                Ok(question) => {
                    self.look_at_host();
                    let answer = self.answer(&question, trace.as_mut());
                    self.write(&answer);
                    if answer.kind == Kind::ProcessorTaken {
                        let _ = self.tells.try_send(answer); // the file has it
                    }
                }
                Err(RecvTimeoutError::Timeout) => self.look_at_host(),
                Err(RecvTimeoutError::Disconnected) => return,
            }
        }
    }

    fn write(&mut self, answer: &Answer) {
        let Ok(mut line) = serde_json::to_vec(answer) else { return };
        line.push(b'\n');
        self.bytes += line.len() as u64;
        if self.bytes <= MOST_BYTES {
            let _ = self.file.write_all(&line); // a full disk costs answers
        }
    }

    fn answer(&mut self, question: &Question, trace: Option<&mut Trace>) -> Answer {
        self.owners.note(&question.processes);
        let real = self.cores.iter().find(|(core, _)| *core == question.core).map_or(0, |(_, real)| *real);
        let mut answer = Answer {
            time_s: question.module_ns as f64 / 1e9,
            monotonic_s: question.from_ns as f64 / 1e9,
            frame: question.frame,
            kind: question.kind,
            partition: question.partition.clone(),
            core: question.core,
            span_ms: ms(question.to_ns - question.from_ns),
            taker: Taker::Unknown { why: String::new() },
            took_ms: 0.0,
            shares: Vec::new(),
            slices: Vec::new(),
            steal_ms: self.stolen_ms(real, question.from_ns),
            source: Source::Trace,
            unasked: question.unasked,
        };
        match trace {
            Some(trace) => self.answer_by_trace(question, real, trace, &mut answer),
            None => self.answer_by_counters(question, real, &mut answer),
        }
        answer
    }

    fn answer_by_trace(&mut self, question: &Question, real: u32, trace: &mut Trace, answer: &mut Answer) {
        let mut unknown = |why: &str| answer.taker = Taker::Unknown { why: why.into() };
        // The executive's memory is locked: it does not double.
        let empty = || (VecDeque::with_capacity(MOST_EVENTS), Left::default());
        let (events, left) = self.events.entry(real).or_insert_with(empty);
        match trace.read(real, events, MOST_EVENTS) {
            Ok(newest) => left.note(events.range(events.len() - newest..)),
            Err(error) => return unknown(&format!("the kernel's trace can not be read: {error}")),
        }
        let watched = match self.dispatchers.get(&question.core) {
            Some(thread) => Some(*thread),
            None => dispatcher_of(question.core),
        };
        if let Some(thread) = watched {
            self.dispatchers.insert(question.core, thread);
        }
        let bounds = (question.from_ns, question.to_ns);
        let Some(span) = analysis::span(events, left, bounds, watched) else {
            return unknown("the kernel's trace has lost that time already, or had not begun");
        };
        let verdict = match question.kind.is_dispatchers() {
            true => analysis::judge_dispatcher(&span, bounds, watched),
            false => {
                let (owners, mut asked) = (&mut self.owners, HashMap::new());
                let mut is_its = |thread| {
                    *asked
                        .entry(thread)
                        .or_insert_with(|| owners.is_of_partition(thread, &question.partition))
                };
                analysis::judge_partition(&span, question.kind == Kind::ProcessorTaken, &mut is_its)
            }
        };
        let (taker, took_ns) = match verdict {
            Verdict::Had(who, length) => (self.taker(who, trace), length),
            Verdict::Itself(length) => (Taker::Itself, length),
            Verdict::Slept(length) => (Taker::Nobody, length),
            Verdict::LateTimer(Who::Thread(thread), length) if answer.steal_ms == 0 => {
                (Taker::Kernel { name: name_of(thread, trace) }, length)
            }
            Verdict::LateTimer(_, length) => (Taker::Host, length),
        };
        (answer.taker, answer.took_ms) = (taker, ms(took_ns));
        let shares = span.shares(bounds.0, bounds.1);
        answer.shares = shares
            .into_iter()
            .take(MOST_SHARES)
            .map(|(who, length)| Share { who: self.taker(who, trace), ms: ms(length) })
            .collect();
        let slices = span.stretches.iter().take(MOST_SLICES).map(|stretch| Slice {
            at_us: (stretch.from_ns - bounds.0) / 1_000,
            for_us: stretch.length_ns() / 1_000,
            name: match stretch.who {
                Who::Idle => "idle".into(),
                Who::Thread(thread) => name_of(thread, trace),
                Who::Interrupt(interrupt) => format!("interrupt {}", trace.names().interrupt(interrupt)),
            },
        });
        answer.slices = slices.collect();
    }

    fn taker(&mut self, who: Who, trace: &Trace) -> Taker {
        match who {
            Who::Idle => Taker::Nobody,
            Who::Interrupt(interrupt) => Taker::Interrupt { name: trace.names().interrupt(interrupt) },
            Who::Thread(tid) => Taker::Thread {
                name: name_of(tid, trace),
                tid,
                priority: trace
                    .names()
                    .thread(tid)
                    .map_or("of unknown priority".into(), |known| priority_words(known.priority)),
                of: self.owners.of(tid),
            },
        }
    }

    /// The same threads have it a moment later, where somebody takes it for long.
    fn answer_by_counters(&mut self, question: &Question, real: u32, answer: &mut Answer) {
        answer.source = Source::Counters;
        let now = now_ns();
        let fresh = self.counted.get(&real).filter(|(at_ns, _)| now.saturating_sub(*at_ns) < COUNT_NS);
        let busy = match fresh {
            Some((_, busy)) => busy.clone(),
            None => {
                let busy = without_trace::busiest(real);
                self.counted.insert(real, (now, busy.clone()));
                busy
            }
        };
        answer.taker = match busy {
            _ if answer.steal_ms * 2 > (answer.span_ms as u64).max(STEAL_MS) => Taker::Host,
            Some(Busy { tid, name, priority, .. }) => {
                let of = self.owners.of(tid);
                match self.owners.is_of_partition(tid, &question.partition) {
                    true if !question.kind.is_dispatchers() => Taker::Itself,
                    _ => Taker::Thread {
                        name: without_controls(&name),
                        tid,
                        priority: priority_words(priority),
                        of,
                    },
                }
            }
            None => Taker::Unknown {
                why: "there is no trace, and nobody used the processor shortly after it".into(),
            },
        };
    }

    fn look_at_host(&mut self) {
        let taken = self.cores.iter().map(|(_, real)| without_trace::steal(*real).unwrap_or(0)).collect();
        if self.steal.len() >= LOOKS {
            self.steal.pop_front();
        }
        self.steal.push_back((now_ns(), taken));
    }

    /// What the host took from the last look before `from_ns` until now, ms.
    fn stolen_ms(&self, real: u32, from_ns: u64) -> u64 {
        let Some(place) = self.cores.iter().position(|(_, one)| *one == real) else { return 0 };
        let before = self.steal.iter().rev().find(|(at_ns, _)| *at_ns <= from_ns);
        let (Some((_, before)), Some((_, now))) = (before, self.steal.back()) else { return 0 };
        now[place].saturating_sub(before[place]) * STEAL_MS
    }
}

/// The dispatcher's thread of a processor.
fn dispatcher_of(core: u32) -> Option<i32> {
    let name = format!("dispatch {core}");
    let threads = fs::read_dir("/proc/self/task").ok()?.flatten();
    threads.filter_map(|entry| entry.file_name().to_str()?.parse().ok()).find(|thread: &i32| {
        let own = fs::read_to_string(format!("/proc/self/task/{thread}/comm"));
        own.is_ok_and(|own| own.trim_end() == name)
    })
}

fn name_of(thread: i32, trace: &Trace) -> String {
    trace.names().thread(thread).map_or_else(|| thread.to_string(), |known| without_controls(&known.name))
}

/// A thread calls itself what it likes.
fn without_controls(name: &str) -> String {
    name.replace(char::is_control, "\u{fffd}")
}

/// The kernel counts from 0 (real time, 99) to 139 (nice 19), and -1 is work with a deadline.
fn priority_words(priority: i32) -> String {
    match priority {
        ..0 => "with a deadline or above all".into(),
        0..=98 => format!("real-time priority {}", 99 - priority),
        120 => "ordinary work".into(),
        _ => format!("ordinary work, nice {}", priority - 120),
    }
}

fn ms(nanoseconds: u64) -> f64 {
    (nanoseconds / 1_000) as f64 / 1e3
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_kernels_priorities_are_told_as_those_of_programs() {
        for (kernel, words) in [
            (0, "real-time priority 99"),
            (98, "real-time priority 1"),
            (-1, "with a deadline or above all"),
            (120, "ordinary work"),
            (139, "ordinary work, nice 19"),
        ] {
            assert_eq!(priority_words(kernel), words);
        }
    }
}
