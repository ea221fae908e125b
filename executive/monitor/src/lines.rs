//! Lines that a thread of their own writes, to a file or to whoever watches.
//!
//! Responsible for: lines that are whole, and a monitor that never waits for the disk. A disk that is full, gone or hangs, and a reader that
//! does not read, cost lines, which are counted.

use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use bateleur_host::trouble::Trouble;
use bateleur_system::thread;

/// Pieces on their way to the thread, most.
const PIECES: usize = 64;
/// Bytes that wait while no piece can be handed over, most.
const MOST_WAITING: usize = 1 << 20;
/// How long the last lines may take when a run ends.
const LAST_LINES: Duration = Duration::from_secs(2);
/// Between two looks whether one can be handed over then.
const LOOK: Duration = Duration::from_millis(1);

/// What is done where the disk can not keep up.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Patience {
    /// Wait: on the virtual clock no time passes meanwhile.
    Wait,
    /// Lose lines and count them.
    Lose,
}

/// See the module's head.
#[derive(Debug)]
pub struct LineLog {
    pieces: Option<SyncSender<Piece>>,
    ended: Receiver<()>,
    trouble: Arc<Mutex<Trouble>>,
    waiting: Piece,
    /// Bytes that are handed over together.
    piece_bytes: usize,
    patience: Patience,
}

/// Whole lines.
#[derive(Debug, Default)]
struct Piece {
    bytes: Vec<u8>,
    lines: u64,
}

impl LineLog {
    /// A new file. `piece_bytes`: lines are handed to the disk when there are so many bytes; 0: each at once.
    ///
    /// # Errors
    /// It can not be made.
    pub fn create(path: &Path, piece_bytes: usize, patience: Patience) -> io::Result<Self> {
        Self::write_into((File::create(path)?, 0), piece_bytes, patience)
    }

    /// Goes on with the whole lines of a file; a new one where there is none.
    ///
    /// # Errors
    /// It can not be read or written.
    pub fn go_on(path: &Path, piece_bytes: usize, patience: Patience) -> io::Result<Self> {
        let mut file = File::options().read(true).write(true).create(true).truncate(false).open(path)?;
        let whole = whole_lines(&mut file)?;
        file.set_len(whole)?;
        file.seek(SeekFrom::Start(whole))?;
        Self::write_into((file, whole), piece_bytes, patience)
    }

    /// As [`LineLog::create`], into `sink`.
    ///
    /// # Errors
    /// There can be no more threads.
    pub fn to(sink: impl Sink, piece_bytes: usize, patience: Patience) -> io::Result<Self> {
        Self::write_into((sink, 0), piece_bytes, patience)
    }

    /// `whole`: bytes of whole lines that are there.
    fn write_into(
        (sink, whole): (impl Sink, u64),
        piece_bytes: usize,
        patience: Patience,
    ) -> io::Result<Self> {
        let (pieces, waiting) = sync_channel(PIECES);
        let (done, ended) = sync_channel(1);
        let trouble = Arc::new(Mutex::new(Trouble::default()));
        let writer = Writer { sink, whole, trouble: trouble.clone() };
        thread::named("log lines").spawn(move || {
            writer.write_all(&waiting);
            let _ = done.send(()); // nobody waits any more
        })?;
        Ok(Self { pieces: Some(pieces), ended, trouble, waiting: Piece::default(), piece_bytes, patience })
    }

    /// From now on lines are handed to the disk when there are `bytes` of them.
    pub fn hand_over_at(&mut self, bytes: usize) {
        self.piece_bytes = bytes;
    }

    /// Adds a line, which ends with a line feed.
    pub fn push(&mut self, line: &[u8]) {
        if self.waiting.bytes.len() + line.len() > MOST_WAITING.max(self.piece_bytes) {
            self.trouble().lose(1, "the disk can not keep up");
            return self.flush();
        }
        self.waiting.bytes.extend_from_slice(line);
        self.waiting.lines += 1;
        if self.waiting.bytes.len() >= self.piece_bytes {
            self.flush();
        }
    }

    /// Hands over what waits, where that is possible at once.
    pub fn flush(&mut self) {
        if self.waiting.lines == 0 {
            return;
        }
        let piece = std::mem::take(&mut self.waiting);
        let refused = match (&self.pieces, self.patience) {
            (None, _) => Some(TrySendError::Disconnected(piece)),
            (Some(pieces), Patience::Lose) => pieces.try_send(piece).err(),
            (Some(pieces), Patience::Wait) => {
                pieces.send(piece).err().map(|refused| TrySendError::Disconnected(refused.0))
            }
        };
        match refused {
            None => {}
            Some(TrySendError::Full(piece)) => self.waiting = piece,
            Some(TrySendError::Disconnected(piece)) => {
                self.trouble().lose(piece.lines, "the thread that writes it has ended");
            }
        }
    }

    /// What went wrong with the disk.
    pub fn trouble(&self) -> MutexGuard<'_, Trouble> {
        self.trouble.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits a little until everything was written.
    pub fn finish(&mut self) {
        if self.pieces.is_none() {
            return;
        }
        let begun = Instant::now();
        self.flush();
        while self.waiting.lines > 0 && begun.elapsed() < LAST_LINES {
            std::thread::sleep(LOOK);
            self.flush();
        }
        drop(self.pieces.take());
        let left = std::mem::take(&mut self.waiting).lines;
        let is_late = self.ended.recv_timeout(LAST_LINES.saturating_sub(begun.elapsed())).is_err();
        // A disk that hangs must not keep the run from ending.
        self.trouble().lose(left + u64::from(is_late), "the disk did not take the last lines in time");
    }
}

impl Drop for LineLog {
    fn drop(&mut self) {
        self.finish();
    }
}

/// Bytes up to the end of a file's last line: whoever wrote it may have died within one.
fn whole_lines(file: &mut File) -> io::Result<u64> {
    let mut end = file.metadata()?.len();
    let mut piece = [0; 4096];
    while end > 0 {
        let begin = end.saturating_sub(piece.len() as u64);
        let bytes = &mut piece[..(end - begin) as usize];
        file.read_exact_at(bytes, begin)?;
        if let Some(last) = bytes.iter().rposition(|byte| *byte == b'\n') {
            return Ok(begin + last as u64 + 1);
        }
        end = begin;
    }
    Ok(0)
}

/// Where lines go.
pub trait Sink: Write + Send + 'static {
    /// Goes back to the end of the last whole line, so that the next one is written over what a full disk cut off; `whole`: bytes up to
    /// there. Nothing for what has no places.
    fn go_back(&mut self, whole: u64) {
        let _ = whole;
    }
}

impl Sink for File {
    fn go_back(&mut self, whole: u64) {
        let _ = self.seek(SeekFrom::Start(whole)); // no file that has places
    }
}

/// The thread that writes.
struct Writer<S> {
    sink: S,
    /// Bytes of whole lines that were written.
    whole: u64,
    trouble: Arc<Mutex<Trouble>>,
}

impl<S: Sink> Writer<S> {
    fn write_all(mut self, pieces: &Receiver<Piece>) {
        for piece in pieces {
            let (written, result) = self.write(&piece.bytes);
            let is_end = |byte: &&u8| **byte == b'\n';
            let kept = piece.bytes[..written].iter().filter(is_end).count() as u64;
            let Err(error) = result else {
                self.whole += written as u64;
                continue;
            };
            let last = piece.bytes[..written].iter().rposition(|byte| *byte == b'\n');
            self.whole += last.map_or(0, |last| last as u64 + 1);
            self.sink.go_back(self.whole);
            let mut trouble = self.trouble.lock().unwrap_or_else(PoisonError::into_inner);
            trouble.lose(piece.lines - kept, &error.to_string());
        }
    }

    /// How many of `bytes` were written, and why no more.
    fn write(&mut self, bytes: &[u8]) -> (usize, io::Result<()>) {
        let mut written = 0;
        while written < bytes.len() {
            match self.sink.write(&bytes[written..]) {
                Ok(0) => return (written, Err(io::ErrorKind::WriteZero.into())),
                Ok(count) => written += count,
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return (written, Err(error)),
            }
        }
        (written, Ok(()))
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::OpenOptionsExt;

    use super::*;

    #[test]
    fn lines_are_in_the_file_in_their_order_whatever_their_pieces() {
        let folder = tempfile::tempdir().unwrap();
        for (piece_bytes, patience) in [(0, Patience::Wait), (64, Patience::Wait), (1 << 16, Patience::Wait)]
        {
            let path = folder.path().join("lines");
            let mut log = LineLog::create(&path, piece_bytes, patience).unwrap();
            let lines: Vec<String> = (0..10_000).map(|number| format!("line {number}\n")).collect();
            lines.iter().for_each(|line| log.push(line.as_bytes()));
            log.finish();
            assert_eq!(std::fs::read_to_string(&path).unwrap(), lines.concat());
            assert_eq!(log.trouble().lost(), 0);
        }
    }

    #[test]
    fn file_whose_writer_has_died_within_a_line_is_gone_on_with_behind_its_last_whole_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lines");
        let long = "x".repeat(10_000);
        for (before, kept) in [("", ""), ("torn", ""), ("one\n", "one\n"), ("one\ntorn", "one\n")] {
            for torn in ["", &long] {
                std::fs::write(&path, format!("{before}{torn}")).unwrap();
                let mut log = LineLog::go_on(&path, 0, Patience::Wait).unwrap();
                log.push(b"two\n");
                log.finish();
                assert_eq!(std::fs::read_to_string(&path).unwrap(), format!("{kept}two\n"));
            }
        }
        std::fs::remove_file(&path).unwrap();
        LineLog::go_on(&path, 0, Patience::Wait).unwrap().push(b"one\n");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "one\n");
    }

    /// A disk that hangs: a pipe that is full, of which nobody reads.
    #[test]
    fn disk_that_hangs_holds_up_nobody_and_every_line_is_there_or_counted() {
        const LINES: u64 = 200_000;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pipe");
        let mode = rustix::fs::Mode::from_raw_mode(0o600);
        rustix::fs::mknodat(rustix::fs::CWD, &path, rustix::fs::FileType::Fifo, mode, 0).unwrap();
        let flags = rustix::fs::OFlags::NONBLOCK.bits().cast_signed();
        let mut reader = File::options().read(true).custom_flags(flags).open(&path).unwrap();
        let mut log = LineLog::create(&path, 1 << 16, Patience::Lose).unwrap();
        let line = [&[b'x'; 99][..], b"\n"].concat();
        (0..LINES).for_each(|_| log.push(&line)); // 20 MB: the test would never come back
        let lost = log.trouble().lost();
        assert!(lost > LINES / 2, "{lost} lines are lost in a pipe of 64 KiB");
        assert!(log.trouble().take().is_some_and(|why| why.contains("keep up")));
        // The disk is back.
        let reading = std::thread::spawn(move || {
            let (mut bytes, mut all) = (vec![0; 1 << 16], 0_u64);
            let begun = Instant::now();
            while begun.elapsed() < Duration::from_secs(20) {
                match io::Read::read(&mut reader, &mut bytes) {
                    Ok(0) => break,
                    Ok(count) => all += count as u64,
                    Err(_) => std::thread::sleep(Duration::from_millis(1)),
                }
            }
            all
        });
        log.finish();
        let lost = log.trouble().lost();
        drop(log);
        assert_eq!(reading.join().unwrap() / 100 + lost, LINES);
    }
}
