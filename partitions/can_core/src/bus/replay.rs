//! A log of candump played at its own pace, and the writing of one.

use std::collections::VecDeque;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::os::fd::BorrowedFd;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

use super::{Bus, BusError, Sent};
use crate::frame::Frame;
use crate::wire::candump::{self, Entry};

/// A log, read as a whole.
#[derive(Debug)]
pub struct Replay {
    name: String,
    entries: VecDeque<Entry>,
    /// The time in the log that is time 0 here.
    first_ns: u64,
    /// The time here at which it was begun.
    begun_ns: Option<u64>,
    now_ns: u64,
    /// Frames that were to be sent: nobody hears them.
    pub unheard: u64,
}

impl Replay {
    /// Reads the log at `path`; reports of errors in it are left out.
    ///
    /// # Errors
    /// It can not be read, or a line is none.
    pub fn open(path: &Path) -> Result<Self, BusError> {
        let shown = path.display().to_string();
        let text = std::fs::read_to_string(path)
            .map_err(|error| BusError::Open { bus: format!("replay:{shown}"), error: error.to_string() })?;
        let mut entries = VecDeque::new();
        for (place, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
            let entry = candump::parse(line).map_err(|error| BusError::Line {
                path: shown.clone(),
                line: place + 1,
                error,
            })?;
            if !candump::is_report(&entry.frame) {
                entries.push_back(entry);
            }
        }
        let first_ns = entries.iter().map(|entry| entry.time_ns).min().unwrap_or(0);
        Ok(Self { name: format!("replay:{shown}"), entries, first_ns, begun_ns: None, now_ns: 0, unheard: 0 })
    }

    fn next_ns(&self) -> Option<u64> {
        let entry = self.entries.front()?;
        Some(self.begun_ns? + (entry.time_ns - self.first_ns))
    }
}

impl Bus for Replay {
    fn receive(&mut self) -> Result<Option<Frame>, BusError> {
        if self.entries.is_empty() {
            return Err(BusError::Ended { bus: self.name.clone() });
        }
        match self.next_ns() {
            Some(next_ns) if next_ns <= self.now_ns => Ok(self.entries.pop_front().map(|entry| entry.frame)),
            _ => Ok(None),
        }
    }

    fn send(&mut self, _: &Frame) -> Result<Sent, BusError> {
        self.unheard += 1;
        Ok(Sent::Taken)
    }

    fn readable(&self) -> Option<BorrowedFd<'_>> {
        None
    }

    fn tend(&mut self, now_ns: u64) -> Result<(), BusError> {
        self.begun_ns.get_or_insert(now_ns);
        self.now_ns = now_ns;
        Ok(())
    }

    fn due_ns(&self) -> u64 {
        if self.begun_ns.is_none() { 0 } else { self.next_ns().unwrap_or(0) }
    }
}

/// Writes a log that candump's tools read.
#[derive(Debug)]
pub struct Log {
    file: BufWriter<File>,
    interface: String,
    /// Lines that could not be written.
    pub failed: u64,
}

impl Log {
    /// A new file, or one that goes on where it ended: who is started again must not lose what it wrote before. Frames are said to be
    /// of `interface`.
    ///
    /// # Errors
    /// The system's answer.
    pub fn open(path: &Path, interface: &str) -> std::io::Result<Self> {
        let interface = interface.replace([' ', '\t'], "_");
        let file = File::options().create(true).append(true).open(path)?;
        Ok(Self { file: BufWriter::new(file), interface, failed: 0 })
    }

    /// Adds a frame that was heard just now.
    pub fn note(&mut self, frame: &Frame) {
        let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        let entry = Entry {
            time_ns: since.as_nanos() as u64, // until the year 2554
            interface: self.interface.clone(),
            frame: *frame,
        };
        if writeln!(self.file, "{}", candump::line(&entry)).is_err() {
            self.failed += 1;
        }
    }

    /// What is written becomes readable.
    pub fn flush(&mut self) {
        self.failed += u64::from(self.file.flush().is_err());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Id;

    #[test]
    fn a_log_is_played_at_its_pace_and_ends() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.log");
        std::fs::write(&path, "(100.000000) can0 001#\n\n(100.500000) can0 20000004#0004000000000000\n(101.000000) can0 002#AA\n").unwrap();
        let mut replay = Replay::open(&path).unwrap();
        replay.tend(7_000_000_000).unwrap();
        assert_eq!(replay.receive().unwrap(), Some(Frame::classic(Id::Standard(1), &[])));
        assert_eq!(replay.receive().unwrap(), None);
        assert_eq!(replay.due_ns(), 8_000_000_000);
        replay.tend(8_000_000_000).unwrap();
        assert_eq!(replay.receive().unwrap(), Some(Frame::classic(Id::Standard(2), &[0xaa])));
        assert!(matches!(replay.receive(), Err(BusError::Ended { .. })));
    }

    #[test]
    fn a_bad_line_is_named_with_its_place() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bad.log");
        std::fs::write(&path, "(1.0) can0 001#\nhello\n").unwrap();
        let error = Replay::open(&path).unwrap_err().to_string();
        assert!(error.contains("bad.log:2:") && error.contains("expected"), "{error}");
    }

    #[test]
    fn what_is_logged_is_read_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("own.log");
        let mut log = Log::open(&path, "slcan:/dev/tty 1").unwrap();
        let frames = [Frame::classic(Id::Standard(1), &[1]), Frame::remote(Id::Extended(2), 3).unwrap()];
        frames.iter().for_each(|frame| log.note(frame));
        log.flush();
        let mut replay = Replay::open(&path).unwrap();
        replay.tend(0).unwrap();
        replay.tend(3_000_000_000).unwrap();
        assert_eq!([(); 2].map(|()| replay.receive().unwrap().unwrap()), frames);
    }

    #[test]
    fn a_log_that_is_there_is_kept_and_goes_on() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.log");
        for value in 0..3 {
            let mut log = Log::open(&path, "can0").unwrap();
            log.note(&Frame::classic(Id::Standard(1), &[value]));
        }
        let text = std::fs::read_to_string(&path).unwrap();
        let ends: Vec<_> = text.lines().filter_map(|line| line.rsplit(' ').next()).collect();
        assert_eq!(ends, ["001#00", "001#01", "001#02"]);
    }
}
