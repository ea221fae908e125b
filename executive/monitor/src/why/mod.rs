//! Why a window was late, lost or used up: who had the processor, looked up in the kernel's trace after the event.
//!
//! The monitor asks and goes on. A thread of ordinary priority reads the trace, answers into a file ([`FILE`]), and tells the monitor of what
//! was taken from partitions. It must never hold up anybody: questions beyond a bound are counted.
//!
//! - `answer`: what is asked and answered, and the sentence for it
//! - `analysis`: who had a processor in a span of time
//! - `owner`: whose thread it was
//! - `without_trace`: the same as well as it can be known where there is no trace
//! - `answerer`: the thread

mod analysis;
mod answer;
mod answerer;
mod owner;
mod without_trace;

use std::io;
use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

pub use answer::{Answer, FILE, Kind, Share, Slice, Source, Taker};
pub use answerer::Cores;

use answer::Question;
use answerer::Answerer;
use bateleur_system::thread;
use bateleur_time::window_record::WindowRecord;

/// Questions that wait for the thread, most.
const QUESTIONS: usize = 256;
/// Questions in a second of module time, most.
const A_SECOND: u32 = 50;
/// What is told to the monitor and waits, most.
const TOLD: usize = 64;
const SECOND_NS: u64 = 1_000_000_000;

/// The monitor's end.
#[derive(Debug)]
pub struct Why {
    questions: Option<SyncSender<Question>>,
    told: Receiver<Answer>,
    thread: Option<JoinHandle<()>>,
    /// When module time 0 was, CLOCK_MONOTONIC, ns.
    origin_ns: u64,
    second: u64,
    asked: u32,
    /// Questions that were not asked.
    unasked: u64,
}

impl Why {
    /// Begins to trace `cores`, beside what the caller does meanwhile. `run`: a name for the trace that no other run has. Answers of a start
    /// before are kept.
    ///
    /// # Errors
    /// There can be no more threads, or the file can not be written.
    pub fn begin(run: &str, folder: &Path, cores: Cores) -> io::Result<Self> {
        let (questions, waiting) = sync_channel(QUESTIONS);
        let (tells, told) = sync_channel(TOLD);
        let answerer = Answerer::new(&folder.join(FILE), cores, tells)?;
        let run = run.to_owned();
        let thread = thread::named("why").spawn(move || answerer.run(&run, &waiting))?;
        let (questions, thread) = (Some(questions), Some(thread));
        Ok(Self { questions, told, thread, origin_ns: 0, second: 0, asked: 0, unasked: 0 })
    }

    /// Module time 0 is, or was, at this instant of CLOCK_MONOTONIC, ns.
    pub(crate) fn set_origin_ns(&mut self, origin_ns: u64) {
        self.origin_ns = origin_ns;
    }

    /// Asks why a window went as it did. `processes`: partitions' processes, and their names; asked for only where there is room for a
    /// question.
    pub(crate) fn ask(
        &mut self,
        kind: Kind,
        partition: &str,
        record: &WindowRecord,
        processes: impl FnOnce() -> Vec<(i32, String)>,
    ) {
        let Some((from_ns, to_ns)) = kind.span(record) else { return };
        let second = to_ns / SECOND_NS;
        if second != self.second {
            (self.second, self.asked) = (second, 0);
        }
        self.asked += 1;
        // These are few by themselves, and are not crowded out by windows that are late all the time.
        let is_rare = matches!(kind, Kind::Silence | Kind::ProcessorTaken);
        let Some(questions) = self.questions.as_ref().filter(|_| is_rare || self.asked <= A_SECOND) else {
            self.unasked += 1;
            return;
        };
        let question = Question {
            kind,
            partition: partition.to_owned(),
            core: record.occurrence.core,
            frame: record.occurrence.minor_frames,
            module_ns: from_ns,
            from_ns: self.origin_ns + from_ns,
            to_ns: self.origin_ns + to_ns,
            processes: processes(),
            unasked: self.unasked,
        };
        match questions.try_send(question) {
            Ok(()) => self.unasked = 0,
            Err(_) => self.unasked += 1,
        }
    }

    /// What was taken from a partition, if somebody knows by now.
    pub(crate) fn taken(&self) -> Option<Answer> {
        self.told.try_recv().ok()
    }
}

impl Drop for Why {
    fn drop(&mut self) {
        drop(self.questions.take());
        if let Some(thread) = self.thread.take() {
            let _ = thread.join(); // a panic there was printed, and costs answers
        }
    }
}
