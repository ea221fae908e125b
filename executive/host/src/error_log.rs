//! Partitions' standard error: a pipe for each process, one thread that reads all of them, and one that appends to the
//! partitions' files.
//!
//! A partition holds the end of a pipe and no file: it can append, and nothing else. How long the file becomes, how fast it
//! grows and what becomes of a full disk is decided here. Last words are taken from memory. It must never let a partition
//! hold up the monitor, nor another partition's log: who is read is read without waiting and by a bound. Only the second thread
//! touches the disk: one that hangs costs text, and no partition waits for it.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::os::fd::OwnedFd;
use std::os::unix::fs::FileExt;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering::SeqCst};
use std::sync::mpsc::{Receiver, sync_channel};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

use rustix::event::epoll::{self, EventData, EventFlags};
use rustix::event::{EventfdFlags, Timespec, eventfd};
use rustix::fs::OFlags;
use rustix::io::Errno;
use rustix::pipe::{PipeFlags, pipe_with};

use crate::trouble::Trouble;
use bateleur_system::thread;
use bateleur_system::time::now_ns;

/// A partition's file that would become longer than this, in bytes, begins anew.
const FILE_LIMIT: u64 = 1 << 20;
/// What is kept of the file before it, bytes.
const FILE_KEPT: u64 = 256 << 10;
/// Bytes of a process that may hold its last words: a trace of calls below them takes some kilobytes.
pub(crate) const TAIL: usize = 32 << 10;
/// Bytes that a partition may write at once into its file,
const BURST: u64 = 1 << 20;
/// and from then on in a second of real time: what is more is left out.
const BYTES_A_SECOND: u64 = 64 << 10;
/// What has been left out goes on when so many bytes may be written: not at each few bytes.
const RESUMED_WITH: u64 = 64 << 10;
/// Bytes that wait for the disk, most: of one partition.
const MOST_UNWRITTEN: u64 = BURST;
/// How long the last words may take to the disk when a run ends.
const LAST_WORDS: Duration = Duration::from_secs(2);
/// Bytes of one read.
const READ: usize = 16 << 10;
/// Reads of one pipe in a pass of the thread.
const READS_IN_A_PASS: usize = 16;
/// Reads that empty the largest pipe that a partition can make of its own (1 MiB, in pages), with some more.
const READS_TO_EMPTY: usize = 320;
/// Pipes of processes that have ended and left somebody behind that still holds the other end; of more, the oldest are closed.
const FORMER_PIPES: usize = 4;
/// Between two passes: a partition that writes as fast as it can waits for its reader, which leaves its processor meanwhile.
const PAUSE: Duration = Duration::from_micros(200);
/// How long what is left out may stay unsaid where nothing follows, s.
const UNSAID_S: i64 = 1;

/// The threads that read and write, and what they read.
#[derive(Debug)]
pub struct ErrorReader {
    logs: ErrorLogs,
    reader: Option<JoinHandle<()>>,
    /// The thread that writes has ended.
    written: Receiver<()>,
}

/// The logs of a module's partitions.
#[derive(Debug, Clone)]
pub struct ErrorLogs(Arc<Shared>);

#[derive(Debug)]
struct Shared {
    folder: PathBuf,
    /// What is written first where something of an earlier start stands.
    begin: String,
    /// Wakes the thread that reads when a pipe can be read.
    pipes: OwnedFd,
    /// Wakes it for anything else.
    wake: OwnedFd,
    stop: AtomicBool,
    /// What the thread that writes is asked for.
    order: Mutex<Order>,
    ordered: Condvar,
    logs: Mutex<Vec<Arc<ErrorLog>>>,
}

#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Order {
    #[default]
    Wait,
    Write,
    /// Everything that there is, for the last time.
    Finish,
}

/// One partition's standard error.
#[derive(Debug)]
struct ErrorLog {
    path: PathBuf,
    inflow: Mutex<Inflow>,
}

/// The standard error of one sandbox: of the one whose process has the windows, or of the one behind it. Both write into one file.
#[derive(Debug)]
pub struct ErrorLine {
    shared: Arc<Shared>,
    log: Arc<ErrorLog>,
    sandbox: u32,
}

#[derive(Debug, Default)]
struct Inflow {
    streams: Vec<Stream>,
    /// What is to be written.
    unwritten: Vec<Piece>,
    unwritten_bytes: u64,
    meter: Meter,
    /// Bytes that are not to be written, and of which nothing in `unwritten` says so yet.
    left_out: u64,
    /// A process was started: its file is opened anew, wherever the one before is now.
    reopen: bool,
    trouble: Trouble,
}

/// A piece of a file.
#[derive(Debug, PartialEq, Eq)]
enum Piece {
    Bytes(Vec<u8>),
    /// So many bytes are missing here.
    LeftOut(u64),
}

/// What one process writes.
#[derive(Debug)]
struct Stream {
    sandbox: u32,
    /// `None` if everybody who could write has closed it.
    pipe: Option<OwnedFd>,
    /// Its last bytes, more than [`TAIL`] at times.
    tail: Vec<u8>,
    /// The sandbox has another process now.
    former: bool,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl ErrorReader {
    /// Starts the threads; the files come into `folder`. A file of an earlier start is gone on with, behind a line that says `begin`.
    ///
    /// # Errors
    /// The machine has no descriptor or no thread left.
    pub fn start(folder: PathBuf, begin: &str) -> io::Result<Self> {
        let pipes = epoll::create(epoll::CreateFlags::CLOEXEC)?;
        let wake = eventfd(0, EventfdFlags::CLOEXEC | EventfdFlags::NONBLOCK)?;
        epoll::add(&pipes, &wake, EventData::new_u64(0), EventFlags::IN)?;
        let shared = Arc::new(Shared {
            folder,
            begin: format!("bateleur: {begin}\n"),
            pipes,
            wake,
            stop: AtomicBool::new(false),
            order: Mutex::default(),
            ordered: Condvar::new(),
            logs: Mutex::default(),
        });
        let (done, written) = sync_channel(1);
        let (reads, writes) = (shared.clone(), shared.clone());
        let reader = thread::named("error logs").spawn(move || reads.read_all())?;
        thread::named("error files").spawn(move || {
            writes.write_all();
            let _ = done.send(()); // nobody waits any more
        })?;
        Ok(Self { logs: ErrorLogs(shared), reader: Some(reader), written })
    }

    /// The logs that it reads.
    #[must_use]
    pub fn logs(&self) -> ErrorLogs {
        self.logs.clone()
    }

    /// Reads and writes what there is, for the last time. Waits a little for the disk.
    pub fn finish(&mut self) {
        self.logs.0.stop.store(true, SeqCst);
        self.logs.0.ring();
        if let Some(reader) = self.reader.take() {
            let _ = reader.join(); // a panic there was printed
            self.logs.0.order(Order::Finish);
            let _ = self.written.recv_timeout(LAST_WORDS); // the disk hangs
        }
    }
}

impl Drop for ErrorReader {
    fn drop(&mut self) {
        self.finish();
    }
}

impl ErrorLogs {
    /// The standard error of the partition `name`.
    #[must_use]
    pub fn line(&self, name: &str) -> ErrorLine {
        let path = self.0.folder.join(format!("{name}.log"));
        let log = Arc::new(ErrorLog { path, inflow: Mutex::default() });
        lock(&self.0.logs).push(log.clone());
        ErrorLine { shared: self.0.clone(), log, sandbox: 0 }
    }
}

impl ErrorLine {
    /// That of the same partition's process which stands by.
    #[must_use]
    pub fn beside(&self) -> Self {
        Self { shared: self.shared.clone(), log: self.log.clone(), sandbox: self.sandbox + 1 }
    }

    /// The end of a fresh pipe, for a process that is to be started: what a predecessor has set of its own does not reach it.
    ///
    /// # Errors
    /// No pipe is to be had.
    pub fn begin(&self) -> io::Result<OwnedFd> {
        let (pipe, end) = pipe_with(PipeFlags::CLOEXEC)?;
        rustix::fs::fcntl_setfl(&pipe, OFlags::NONBLOCK)?; // the other end is another description: it waits
        epoll::add(&self.shared.pipes, &pipe, EventData::new_u64(1), EventFlags::IN)?;
        lock(&self.log.inflow).begin(Stream {
            sandbox: self.sandbox,
            pipe: Some(pipe),
            tail: Vec::new(),
            former: false,
        });
        self.shared.ring();
        Ok(end)
    }

    /// The last bytes that the sandbox's present or last process wrote. What it wrote before it ended is among them; what a child
    /// still adds is not waited for.
    #[must_use]
    pub fn tail(&self) -> Vec<u8> {
        let tail = lock(&self.log.inflow).tail(self.sandbox);
        self.shared.order(Order::Write); // what was read
        tail
    }

    /// Why something could not be written into the file, the first time that this was so.
    #[must_use]
    pub fn take_trouble(&self) -> Option<String> {
        lock(&self.log.inflow).trouble.take()
    }
}

impl Shared {
    fn ring(&self) {
        let _ = rustix::io::write(&self.wake, &1_u64.to_ne_bytes()); // full: it rings already
    }

    fn order(&self, order: Order) {
        let mut before = lock(&self.order);
        *before = order.max(*before); // the last word stays the last
        drop(before);
        self.ordered.notify_one();
    }

    /// The life of the thread that reads.
    fn read_all(&self) {
        let mut has_unsaid = false;
        loop {
            self.await_something(has_unsaid);
            let is_last = self.stop.load(SeqCst);
            let logs = lock(&self.logs).clone();
            has_unsaid = false;
            for log in &logs {
                has_unsaid |= log.read(is_last);
            }
            if is_last {
                return;
            }
            self.order(Order::Write);
            std::thread::sleep(PAUSE);
        }
    }

    /// The life of the thread that writes.
    fn write_all(&self) {
        let mut files: Vec<LogFile> = Vec::new();
        loop {
            let order = self.await_order();
            let logs = lock(&self.logs).clone();
            for (place, log) in logs.iter().enumerate() {
                if files.len() == place {
                    files.push(LogFile::new(log.path.clone(), self.begin.clone()));
                }
                if log.write(&mut files[place]) > 0 {
                    self.ring(); // it is to be said
                }
            }
            if order == Order::Finish {
                return;
            }
        }
    }

    fn await_order(&self) -> Order {
        let waits = |order: &mut Order| *order == Order::Wait;
        let order = self.ordered.wait_while(lock(&self.order), waits);
        std::mem::take(&mut *order.unwrap_or_else(PoisonError::into_inner))
    }

    fn await_something(&self, has_unsaid: bool) {
        let soon = Timespec { tv_sec: UNSAID_S, tv_nsec: 0 };
        let mut events = Vec::with_capacity(8);
        // Interrupted, or refused: a look at everything does no harm.
        let _ = epoll::wait(
            &self.pipes,
            rustix::buffer::spare_capacity(&mut events),
            has_unsaid.then_some(&soon),
        );
        let _ = rustix::io::read(&self.wake, &mut [0_u8; 8]); // it did not ring
    }
}

impl ErrorLog {
    /// Reads the pipes; true: something is left out and not said yet.
    fn read(&self, is_last: bool) -> bool {
        let mut inflow = lock(&self.inflow);
        inflow.read_all(if is_last { READS_TO_EMPTY } else { READS_IN_A_PASS });
        if is_last || inflow.meter.may_resume(now_ns()) {
            inflow.say_left_out();
        }
        inflow.left_out > 0
    }

    /// Writes the file; how many bytes could not be written. Nobody is kept from the pipes meanwhile.
    fn write(&self, file: &mut LogFile) -> u64 {
        let mut inflow = lock(&self.inflow);
        let reopen = std::mem::take(&mut inflow.reopen);
        let unwritten = std::mem::take(&mut inflow.unwritten);
        inflow.unwritten_bytes = 0;
        drop(inflow);
        let mut written = if reopen { file.open() } else { Ok(()) };
        let mut lost = 0;
        for piece in unwritten {
            if let Err((error, bytes)) = file.append(&piece) {
                lost += bytes;
                written = Err(error);
            }
        }
        let mut inflow = lock(&self.inflow);
        inflow.left_out += lost;
        inflow.trouble.note(written);
        lost
    }
}

impl Inflow {
    fn begin(&mut self, stream: Stream) {
        for before in self.streams.iter_mut().filter(|before| before.sandbox == stream.sandbox) {
            before.former = true;
        }
        self.streams.push(stream);
        self.reopen = true;
        let mut formers = self.streams.iter().filter(|stream| stream.former).count();
        self.streams.retain(|stream| {
            let goes = stream.former && (stream.pipe.is_none() || formers > FORMER_PIPES);
            formers -= usize::from(goes);
            !goes
        });
    }

    fn read_all(&mut self, reads: usize) {
        for place in 0..self.streams.len() {
            self.read(place, reads);
        }
        self.streams.retain(|stream| !stream.former || stream.pipe.is_some());
    }

    /// Reads from a pipe without waiting.
    fn read(&mut self, place: usize, reads: usize) {
        let mut buffer = [0; READ];
        for _ in 0..reads {
            let stream = &mut self.streams[place];
            let Some(pipe) = &stream.pipe else { return };
            match rustix::io::read(pipe, &mut buffer) {
                Ok(0) => stream.pipe = None,
                Ok(count) => {
                    stream.keep(&buffer[..count]);
                    self.admit(&buffer[..count]);
                }
                Err(Errno::INTR) => {}
                Err(_empty) => return,
            }
        }
    }

    fn admit(&mut self, bytes: &[u8]) {
        let count = bytes.len() as u64;
        if self.unwritten_bytes + count > MOST_UNWRITTEN || !self.meter.admits(count, now_ns()) {
            self.left_out += count;
            return;
        }
        self.unwritten_bytes += count;
        self.say_left_out();
        match self.unwritten.last_mut() {
            Some(Piece::Bytes(before)) => before.extend_from_slice(bytes),
            _ => self.unwritten.push(Piece::Bytes(bytes.to_vec())),
        }
    }

    fn say_left_out(&mut self) {
        let bytes = std::mem::take(&mut self.left_out);
        match self.unwritten.last_mut() {
            _ if bytes == 0 => {}
            Some(Piece::LeftOut(before)) => *before += bytes,
            _ => self.unwritten.push(Piece::LeftOut(bytes)),
        }
    }

    fn tail(&mut self, sandbox: u32) -> Vec<u8> {
        let present = self.streams.iter().rposition(|stream| stream.sandbox == sandbox && !stream.former);
        let Some(place) = present else { return Vec::new() };
        self.read(place, READS_TO_EMPTY);
        let tail = &self.streams[place].tail;
        tail[tail.len().saturating_sub(TAIL)..].to_vec()
    }
}

impl Stream {
    fn keep(&mut self, bytes: &[u8]) {
        self.tail.extend_from_slice(bytes);
        if self.tail.len() > 2 * TAIL {
            self.tail.drain(..self.tail.len() - TAIL);
        }
    }
}

/// How much of what a partition writes comes into its file.
#[derive(Debug)]
struct Meter {
    left: u64,
    since_ns: u64,
    /// Something was left out, and goes on being.
    closed: bool,
}

impl Default for Meter {
    fn default() -> Self {
        Self { left: BURST, since_ns: now_ns(), closed: false }
    }
}

impl Meter {
    fn fill(&mut self, now_ns: u64) {
        let more = now_ns.saturating_sub(self.since_ns) / (1_000_000_000 / BYTES_A_SECOND);
        if more > 0 {
            self.left = BURST.min(self.left + more);
            self.since_ns = now_ns;
        }
    }

    /// Whether what was left out may be said, and what follows written.
    fn may_resume(&mut self, now_ns: u64) -> bool {
        self.fill(now_ns);
        self.left >= RESUMED_WITH
    }

    fn admits(&mut self, bytes: u64, now_ns: u64) -> bool {
        if self.closed {
            self.closed = !self.may_resume(now_ns);
        } else if self.left < bytes {
            self.fill(now_ns);
            self.closed = self.left < bytes;
        }
        if !self.closed {
            self.left -= bytes;
        }
        !self.closed
    }
}

/// A partition's file, written by the second thread alone.
#[derive(Debug)]
struct LogFile {
    path: PathBuf,
    file: Option<File>,
    /// The last line has no end yet.
    in_line: bool,
    /// What is written first into a file that is not empty; nothing once it was opened.
    begin: String,
}

impl LogFile {
    fn new(path: PathBuf, begin: String) -> Self {
        Self { path, file: None, in_line: false, begin }
    }

    fn open(&mut self) -> io::Result<()> {
        self.file = None;
        let mut opened = OpenOptions::new().create(true).read(true).append(true).open(&self.path)?;
        let length = opened.metadata()?.len();
        if length > 0 && !self.begin.is_empty() {
            let mut last = [0];
            opened.read_exact_at(&mut last, length - 1)?;
            let end_of_line = if last == *b"\n" { "" } else { "\n" };
            opened.write_all(format!("{end_of_line}{}", self.begin).as_bytes())?;
        }
        self.begin.clear();
        self.file = Some(opened);
        Ok(())
    }

    /// Writes `piece`, or says how many bytes of the partition are missing in its place, and why.
    fn append(&mut self, piece: &Piece) -> Result<(), (io::Error, u64)> {
        match piece {
            Piece::Bytes(bytes) => self.append_all(bytes),
            Piece::LeftOut(bytes) => {
                let end_of_line = if self.in_line { "\n" } else { "" };
                let text = format!("{end_of_line}bateleur: {bytes} bytes are left out here\n");
                self.append_all(text.as_bytes()).map_err(|(error, _)| (error, *bytes))
            }
        }
    }

    fn append_all(&mut self, bytes: &[u8]) -> Result<(), (io::Error, u64)> {
        let mut rest = bytes;
        while !rest.is_empty() {
            match self.append_some(rest) {
                Ok(count) => rest = &rest[count..],
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err((error, rest.len() as u64)),
            }
        }
        Ok(())
    }

    fn append_some(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if self.file.is_none() {
            self.open()?;
        }
        let Some(file) = &mut self.file else { return Err(io::ErrorKind::NotFound.into()) };
        let room = FILE_LIMIT.saturating_sub(file.metadata()?.len()) as usize;
        if room == 0 {
            let kept = keep_end(&self.path);
            file.set_len(0)?; // it appends: it goes on at the beginning
            kept?;
        }
        let part = if room == 0 { bytes } else { &bytes[..bytes.len().min(room)] };
        let count = file.write(&part[..part.len().min(FILE_LIMIT as usize)])?;
        self.in_line = count > 0 && part[count - 1] != b'\n';
        match count {
            0 => Err(io::ErrorKind::WriteZero.into()),
            count => Ok(count),
        }
    }
}

/// Copies the end of the file at `path` beside it.
fn keep_end(path: &Path) -> io::Result<()> {
    let mut file = File::open(path)?;
    let length = file.metadata()?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(FILE_KEPT)))?;
    io::copy(&mut file.take(FILE_KEPT), &mut File::create(path.with_extension("log.old"))?)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::thread;

    fn reader() -> (ErrorReader, tempfile::TempDir) {
        let folder = tempfile::tempdir().unwrap();
        (start(&folder), folder)
    }

    fn start(folder: &tempfile::TempDir) -> ErrorReader {
        ErrorReader::start(folder.path().to_owned(), "begins").unwrap()
    }

    fn written(folder: &tempfile::TempDir, file: &str) -> Vec<u8> {
        std::fs::read(folder.path().join(file)).unwrap_or_default()
    }

    #[test]
    fn what_processes_write_is_in_the_file_and_the_last_words_are_of_the_present_one() {
        let (mut reader, folder) = reader();
        let line = reader.logs().line("one");
        let behind = line.beside();
        let mut first = File::from(line.begin().unwrap());
        let mut standby = File::from(behind.begin().unwrap());
        standby.write_all(b"stands by\n").unwrap();
        first.write_all(b"first\n").unwrap();
        assert_eq!(line.tail(), b"first\n", "and not what the other process wrote after it began");
        drop(first);
        assert_eq!(line.tail(), b"first\n", "it is gone, its words are not");
        let second = File::from(line.begin().unwrap());
        assert_eq!((line.tail(), behind.tail()), (Vec::new(), b"stands by\n".to_vec()));
        drop(second);
        reader.finish();
        let file = String::from_utf8(written(&folder, "one.log")).unwrap();
        let mut lines: Vec<&str> = file.lines().collect();
        lines.sort_unstable();
        assert_eq!(lines, ["first", "stands by"]);
    }

    #[test]
    fn file_of_an_earlier_start_is_gone_on_with_behind_a_line_that_says_so() {
        let folder = tempfile::tempdir().unwrap();
        for words in ["first\n", "second, ", "third\n"] {
            let mut reader = start(&folder);
            let line = reader.logs().line("one");
            // Whoever comes next in the same run writes behind it.
            for _ in 0..2 {
                File::from(line.begin().unwrap()).write_all(words.as_bytes()).unwrap();
            }
            reader.finish();
        }
        let file = String::from_utf8(written(&folder, "one.log")).unwrap();
        assert_eq!(
            file,
            "first\nfirst\nbateleur: begins\nsecond, second, \nbateleur: begins\nthird\nthird\n"
        );
    }

    #[test]
    fn partition_can_do_nothing_to_its_standard_error_but_append() {
        use rustix::fs::{FallocateFlags, fallocate, ftruncate, seek};
        let (mut reader, folder) = reader();
        let line = reader.logs().line("one");
        let end = line.begin().unwrap();
        assert_eq!(fallocate(&end, FallocateFlags::KEEP_SIZE, 0, 1 << 30), Err(Errno::SPIPE));
        assert_eq!(ftruncate(&end, 1 << 30), Err(Errno::INVAL));
        assert_eq!(rustix::io::pwrite(&end, b"x", 1 << 30), Err(Errno::SPIPE));
        assert_eq!(seek(&end, rustix::fs::SeekFrom::Start(1 << 30)), Err(Errno::SPIPE));
        rustix::io::write(&end, b"said").unwrap();
        drop(end);
        reader.finish();
        assert_eq!(written(&folder, "one.log"), b"said");
    }

    #[test]
    fn flags_that_a_process_sets_do_not_reach_its_successor() {
        let (reader, _folder) = reader();
        let line = reader.logs().line("one");
        let first = line.begin().unwrap();
        rustix::fs::fcntl_setfl(&first, OFlags::NONBLOCK | OFlags::DIRECT).unwrap();
        let second = line.begin().unwrap();
        let flags = rustix::fs::fcntl_getfl(&second).unwrap();
        assert!(!flags.intersects(OFlags::NONBLOCK | OFlags::DIRECT), "{flags:?}");
    }

    #[test]
    fn child_that_holds_the_pipe_is_not_waited_for() {
        let (_reader, _folder) = reader();
        let line = _reader.logs().line("one");
        let mut end = File::from(line.begin().unwrap());
        let mut child = end.try_clone().unwrap();
        end.write_all(b"dying").unwrap();
        drop(end);
        assert_eq!(line.tail(), b"dying");
        let mut next = File::from(line.begin().unwrap());
        child.write_all(b"still here").unwrap();
        next.write_all(b"next").unwrap();
        assert_eq!(line.tail(), b"next");
    }

    #[test]
    fn pipes_that_children_of_former_processes_hold_are_bounded() {
        let (_reader, _folder) = reader();
        let line = _reader.logs().line("one");
        let held: Vec<OwnedFd> = (0..100).map(|_| line.begin().unwrap()).collect();
        let open = lock(&line.log.inflow).streams.len();
        assert!(open <= FORMER_PIPES + 1, "{open} of {} are open", held.len());
    }

    #[test]
    fn last_words_in_a_pipe_of_many_small_packets_are_found() {
        let mut inflow = Inflow::default();
        let (pipe, end) = pipe_with(PipeFlags::CLOEXEC | PipeFlags::DIRECT).unwrap();
        rustix::fs::fcntl_setfl(&pipe, OFlags::NONBLOCK).unwrap();
        rustix::pipe::fcntl_setpipe_size(&end, 1 << 20).unwrap();
        rustix::fs::fcntl_setfl(&end, OFlags::NONBLOCK | OFlags::DIRECT).unwrap();
        inflow.begin(Stream { sandbox: 0, pipe: Some(pipe), tail: Vec::new(), former: false });
        let mut count = 0_usize;
        while rustix::io::write(&end, b"x").is_ok() {
            count += 1;
        }
        assert!(count > READS_IN_A_PASS, "{count} packets fit");
        assert_eq!(inflow.tail(0).len(), count);
    }

    #[test]
    fn file_that_is_too_long_begins_anew_and_its_end_is_kept() {
        let folder = tempfile::tempdir().unwrap();
        let mut file = LogFile::new(folder.path().join("babbler.log"), String::new());
        file.append(&Piece::Bytes(vec![b'.'; FILE_LIMIT as usize - 4])).unwrap();
        file.append(&Piece::Bytes(b"lastanew".to_vec())).unwrap();
        let kept = written(&folder, "babbler.log.old");
        assert!(kept.len() == FILE_KEPT as usize && kept.ends_with(b".last"));
        assert_eq!(written(&folder, "babbler.log"), b"anew");
    }

    #[test]
    fn what_comes_too_fast_is_left_out_and_one_line_says_how_much() {
        let meter = Meter { left: 10, since_ns: u64::MAX, closed: false };
        let mut inflow = Inflow { meter, ..Inflow::default() };
        inflow.admit(b"0123456789");
        inflow.admit(b"too much");
        inflow.admit(b"too");
        inflow.meter.since_ns = now_ns() - 2_000_000_000;
        inflow.admit(b"again");
        let expected =
            [Piece::Bytes(b"0123456789".to_vec()), Piece::LeftOut(11), Piece::Bytes(b"again".to_vec())];
        assert_eq!(inflow.unwritten, expected);
        let folder = tempfile::tempdir().unwrap();
        let mut file = LogFile::new(folder.path().join("one.log"), String::new());
        inflow.unwritten.iter().for_each(|piece| file.append(piece).unwrap());
        assert_eq!(written(&folder, "one.log"), b"0123456789\nbateleur: 11 bytes are left out here\nagain");
    }

    #[test]
    fn babbling_partition_is_read_to_its_end_its_file_is_bounded_and_others_are_read_meanwhile() {
        const BYTES: usize = 200_000_000;
        let (mut reader, folder) = reader();
        let (loud, quiet) = (reader.logs().line("loud"), reader.logs().line("quiet"));
        let mut end = File::from(loud.begin().unwrap());
        let babbler = thread::spawn(move || {
            let block = vec![b'.'; 100_000];
            (0..BYTES / block.len()).for_each(|_| end.write_all(&block).unwrap());
            end.write_all(b"\nlast words\n").unwrap();
        });
        let mut end = File::from(quiet.begin().unwrap());
        let mut said = String::new();
        while !babbler.is_finished() {
            said.push_str("still here\n");
            end.write_all(b"still here\n").unwrap();
            thread::sleep(Duration::from_millis(20));
        }
        babbler.join().unwrap();
        assert!(loud.tail().ends_with(b".\nlast words\n"), "though that came too fast for the file");
        reader.finish();
        assert!(written(&folder, "quiet.log") == said.as_bytes());
        let (now, old) = (written(&folder, "loud.log"), written(&folder, "loud.log.old"));
        assert!(now.len() as u64 <= FILE_LIMIT && old.len() as u64 <= FILE_KEPT);
        let text = [old, now].concat();
        let text = String::from_utf8_lossy(&text);
        let left_out: usize = text
            .lines()
            .filter_map(|line| line.strip_prefix("bateleur: ")?.split(' ').next()?.parse::<usize>().ok())
            .sum();
        assert!(left_out > BYTES / 2 && left_out < BYTES, "{left_out} bytes are said to be left out");
    }

    #[test]
    fn disk_that_hangs_keeps_no_partition_waiting_and_what_it_missed_is_said() {
        const WRITTEN: u64 = 3 << 20;
        let (mut reader, folder) = reader();
        let path = folder.path().join("one.log");
        rustix::fs::mkfifoat(rustix::fs::CWD, &path, rustix::fs::Mode::RUSR | rustix::fs::Mode::WUSR)
            .unwrap();
        let lines = ["one", "two"].map(|name| reader.logs().line(name));
        let mut ends = lines.each_ref().map(|line| File::from(line.begin().unwrap()));
        // The thread that writes waits at the pipe until somebody reads it. Nobody does.
        for _ in 0..WRITTEN / 4096 {
            ends.iter_mut().for_each(|end| end.write_all(&[b'.'; 4096]).unwrap());
        }
        ends.iter_mut().for_each(|end| end.write_all(b"\nlast words\n").unwrap());
        assert!(lines.iter().all(|line| line.tail().ends_with(b"last words\n")));
        let kept = |line: &ErrorLine| lock(&line.log.inflow).unwritten_bytes;
        assert!(lines.iter().all(|line| kept(line) <= MOST_UNWRITTEN));
        let disk = thread::spawn(move || std::fs::read(path).unwrap());
        drop(ends);
        reader.finish();
        drop(reader);
        let text = disk.join().unwrap();
        let dots = text.iter().filter(|byte| **byte == b'.').count() as u64;
        let text = String::from_utf8_lossy(&text);
        let left_out: u64 = text
            .lines()
            .filter_map(|line| line.strip_prefix("bateleur: ")?.split(' ').next()?.parse::<u64>().ok())
            .sum();
        assert!(dots >= BURST / 2 && left_out > 0, "{dots} bytes written, {left_out} left out");
    }

    #[test]
    fn file_that_can_not_be_written_is_said_once_and_holds_up_nobody() {
        let (mut reader, folder) = reader();
        let line = reader.logs().line("gone/one");
        let mut end = File::from(line.begin().unwrap());
        for _ in 0..100 {
            end.write_all(&[b'.'; 10_000]).unwrap();
        }
        end.write_all(b"\nlast words\n").unwrap();
        assert!(line.tail().ends_with(b"\nlast words\n"));
        let trouble = loop {
            match line.take_trouble() {
                Some(trouble) => break trouble,
                None => std::thread::sleep(PAUSE), // the thread that writes has not tried yet
            }
        };
        assert!(trouble.contains("No such file"), "{trouble}");
        // There is room again.
        std::fs::create_dir(folder.path().join("gone")).unwrap();
        end.write_all(b"again\n").unwrap();
        drop(end);
        reader.finish();
        let file = String::from_utf8(written(&folder, "gone/one.log")).unwrap();
        assert!(file.contains(" bytes are left out here\n") && file.ends_with("again\n"), "{file}");
        assert_eq!(line.take_trouble(), None);
    }
}
