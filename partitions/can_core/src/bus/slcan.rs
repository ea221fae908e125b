//! Serial CAN adapters: the computer's end ([`Slcan`]), and the adapter's, on a pseudo terminal ([`Adapter`]).
#![allow(unsafe_code)] // the serial port's descriptor changes hands once

use std::fs::File;
use std::io::{ErrorKind, Read, Write};
use std::os::fd::{AsFd, BorrowedFd, FromRawFd, IntoRawFd, OwnedFd};
use std::path::{Path, PathBuf};

use rustix::fs::{OFlags, fcntl_getfl, fcntl_setfl};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, QueueSelector, tcflush, tcgetattr, tcsetattr};

use super::{Bus, BusError, Losses, Sent};
use crate::frame::Frame;
use crate::wire::slcan::{self, BELL, BIT_RATES, DONE, Decoder, Line};

/// Speed of the serial line where no other is said, symbols a second. Adapters on USB take any.
pub(super) const BAUD: u32 = 115_200;
/// The rest of what the line did not take at once is tried again after so long, ns: some ten bytes at 115 200 symbols a second.
const REST_NS: u64 = 1_000_000;
/// Bytes that wait for the line at most: some 150 frames.
const BACKLOG: usize = 4_096;

/// Text over a descriptor, both ways, without waiting.
#[derive(Debug)]
struct Text {
    bus: String,
    file: File,
    decoder: Decoder,
    /// Read and not yet decoded.
    input: Vec<u8>,
    taken: usize,
    /// To be written.
    output: Vec<u8>,
    /// Lines that were none.
    refused: u64,
    /// The time of the last look, ns.
    now_ns: u64,
}

impl Text {
    fn new(bus: String, descriptor: OwnedFd) -> Self {
        let (input, output) = (Vec::with_capacity(BACKLOG), Vec::with_capacity(BACKLOG));
        Self {
            bus,
            file: descriptor.into(),
            decoder: Decoder::new(),
            input,
            taken: 0,
            output,
            refused: 0,
            now_ns: 0,
        }
    }

    fn broken(&self, error: std::io::Error) -> BusError {
        BusError::Broken { bus: self.bus.clone(), error }
    }

    /// The next line that says something.
    fn line(&mut self) -> Result<Option<Line>, BusError> {
        loop {
            while let Some(byte) = self.input.get(self.taken) {
                self.taken += 1;
                match self.decoder.push(*byte) {
                    Some(Ok(line)) => return Ok(Some(line)),
                    Some(Err(_)) => self.refused += 1,
                    None => {}
                }
            }
            self.input.resize(BACKLOG, 0);
            self.taken = 0;
            let read = self.file.read(&mut self.input);
            self.input.truncate(*read.as_ref().unwrap_or(&0));
            match read {
                Ok(0) => return Err(BusError::Ended { bus: self.bus.clone() }),
                Ok(_) => {}
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {
                    return Ok(None);
                }
                Err(error) => return Err(self.broken(error)),
            }
        }
    }

    fn tend(&mut self, now_ns: u64) -> Result<(), BusError> {
        self.now_ns = now_ns;
        self.flush()
    }

    fn due_ns(&self) -> u64 {
        if self.output.is_empty() { u64::MAX } else { self.now_ns + REST_NS }
    }

    fn say(&mut self, bytes: &[u8]) {
        if self.output.len() + bytes.len() <= BACKLOG {
            self.output.extend_from_slice(bytes);
        }
    }

    fn frame(&mut self, frame: &Frame) -> Result<Sent, BusError> {
        self.flush()?;
        if self.output.len() + slcan::LINE_BYTES > BACKLOG {
            return Ok(Sent::Full);
        }
        let sent = if slcan::encode(frame, &mut self.output) { Sent::Taken } else { Sent::Refused };
        self.flush()?;
        Ok(sent)
    }

    fn flush(&mut self) -> Result<(), BusError> {
        while !self.output.is_empty() {
            match self.file.write(&self.output) {
                Ok(0) => break,
                Ok(written) => drop(self.output.drain(..written)),
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => break,
                Err(error) => return Err(self.broken(error)),
            }
        }
        Ok(())
    }
}

/// How quick an adapter's two sides are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Speeds {
    /// The bit rate that it is to set on its bus, bit/s; `None`: the one that it has.
    pub rate: Option<u32>,
    /// The serial line, symbols a second.
    pub baud: u32,
}

impl Default for Speeds {
    fn default() -> Self {
        Self { rate: None, baud: BAUD }
    }
}

/// An adapter at a serial device.
#[derive(Debug)]
pub struct Slcan {
    text: Text,
}

impl Slcan {
    /// Opens the device and the adapter's channel.
    ///
    /// # Errors
    /// The device can not be opened, or the protocol has no number for the rate.
    pub fn open(path: &Path, speeds: Speeds) -> Result<Self, BusError> {
        let bus = format!("slcan:{}", path.display());
        let command = match speeds.rate {
            None => None,
            Some(rate) => {
                let known = BIT_RATES.iter().find(|(known, _)| *known == rate);
                Some(known.ok_or_else(|| BusError::Rate { bus: bus.clone(), rate })?.1)
            }
        };
        let builder = serialport::new(path.to_string_lossy(), speeds.baud).exclusive(false);
        let port = builder.open_native().map_err(|error| refused(&bus, path, &error))?;
        // SAFETY: the port gives its descriptor away and closes it no more; from here on it is owned once.
        let descriptor = unsafe { OwnedFd::from_raw_fd(port.into_raw_fd()) };
        do_not_wait(&descriptor, &bus)?;
        let mut text = Text::new(bus, descriptor);
        // What the adapter had begun to read ends here; a channel that was open is closed.
        text.say(&[DONE, DONE, b'C', DONE]);
        if let Some(number) = command {
            text.say(&[b'S', number, DONE]);
        }
        text.say(&[b'O', DONE]);
        text.flush()?;
        Ok(Self { text })
    }
}

fn refused(bus: &str, path: &Path, error: &serialport::Error) -> BusError {
    match error.kind() {
        serialport::ErrorKind::Io(ErrorKind::PermissionDenied) => BusError::NoPermission {
            bus: bus.into(),
            error: ErrorKind::PermissionDenied.into(),
            mend: "the device belongs to a group (`ls -l` shows it): be in it, or grant the partition the device",
        },
        _ if !path.exists() => BusError::Open {
            bus: bus.into(),
            error: format!("there is no {}; is the adapter plugged in?", path.display()),
        },
        _ => BusError::Open { bus: bus.into(), error: format!("it is no serial device, or busy ({error})") },
    }
}

fn do_not_wait(descriptor: &OwnedFd, bus: &str) -> Result<(), BusError> {
    fcntl_getfl(descriptor)
        .and_then(|flags| fcntl_setfl(descriptor, flags | OFlags::NONBLOCK))
        .map_err(|error| BusError::Broken { bus: bus.into(), error: error.into() })
}

impl Bus for Slcan {
    fn receive(&mut self) -> Result<Option<Frame>, BusError> {
        loop {
            match self.text.line()? {
                Some(Line::Frame(frame)) => return Ok(Some(frame)),
                Some(Line::Refused) => self.text.refused += 1,
                Some(_) => {}
                None => return Ok(None),
            }
        }
    }

    fn send(&mut self, frame: &Frame) -> Result<Sent, BusError> {
        self.text.frame(frame)
    }

    fn readable(&self) -> Option<BorrowedFd<'_>> {
        Some(self.text.file.as_fd())
    }

    fn tend(&mut self, now_ns: u64) -> Result<(), BusError> {
        self.text.tend(now_ns)
    }

    fn due_ns(&self) -> u64 {
        self.text.due_ns()
    }

    fn losses(&self) -> Losses {
        Losses { unkept: 0, denied: self.text.refused }
    }
}

/// This program as an adapter, for whatever expects one at a serial device.
#[derive(Debug)]
pub struct Adapter {
    text: Text,
    /// The other end, held open so that the line does not hang up between two that use it.
    _far_end: OwnedFd,
    link: PathBuf,
    device: PathBuf,
    open: bool,
}

impl Adapter {
    /// Makes a pseudo terminal, and `link` a link to it.
    ///
    /// # Errors
    /// There is no terminal to be had, or the link can not be made.
    pub fn open(link: &Path) -> Result<Self, BusError> {
        let bus = format!("slcan-pty:{}", link.display());
        let (near, far, device) =
            pair().map_err(|error| BusError::Open { bus: bus.clone(), error: error.to_string() })?;
        do_not_wait(&near, &bus)?;
        let wrong = |error: std::io::Error| BusError::Open {
            bus: bus.clone(),
            error: format!("cannot make the link {} ({error})", link.display()),
        };
        if link.symlink_metadata().is_ok_and(|found| found.is_symlink()) {
            std::fs::remove_file(link).map_err(wrong)?; // of an adapter that was killed
        }
        std::os::unix::fs::symlink(&device, link).map_err(wrong)?;
        Ok(Self { text: Text::new(bus, near), _far_end: far, link: link.into(), device, open: false })
    }

    /// The terminal.
    pub fn device(&self) -> &Path {
        &self.device
    }

    fn answer(&mut self, command: u8) {
        match command {
            b'O' | b'L' => {
                // What was for somebody who has gone is not for the next one.
                let _ = tcflush(&self._far_end, QueueSelector::IFlush);
                self.open = true;
                self.text.say(&[DONE]);
            }
            b'C' => {
                self.open = false;
                self.text.output.clear();
                self.text.say(&[DONE]);
            }
            b'S' | b's' | b'Z' | b'M' | b'm' | b'Y' | b'y' => self.text.say(&[DONE]),
            b'V' => self.text.say(b"V0101\r"),
            b'N' => self.text.say(b"NBTLR\r"),
            b'F' => self.text.say(b"F00\r"),
            _ => self.text.say(&[BELL]),
        }
    }
}

/// The ends of a new pseudo terminal, raw, and the path of the second one.
fn pair() -> rustix::io::Result<(OwnedFd, OwnedFd, PathBuf)> {
    let near = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC)?;
    grantpt(&near)?;
    unlockpt(&near)?;
    let name = ptsname(&near, Vec::new())?;
    let path = PathBuf::from(String::from_utf8_lossy(name.to_bytes()).into_owned());
    let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC;
    let far = rustix::fs::open(&path, flags, rustix::fs::Mode::empty())?;
    let mut settings = tcgetattr(&far)?;
    settings.make_raw();
    tcsetattr(&far, OptionalActions::Now, &settings)?;
    Ok((near, far, path))
}

impl Bus for Adapter {
    fn receive(&mut self) -> Result<Option<Frame>, BusError> {
        loop {
            match self.text.line()? {
                Some(Line::Frame(frame)) if self.open => {
                    let done = match (frame.id(), frame.kind()) {
                        (_, crate::Kind::Fd { .. }) => &b"\r"[..],
                        (crate::Id::Standard(_), _) => b"z\r",
                        (crate::Id::Extended(_), _) => b"Z\r",
                    };
                    self.text.say(done);
                    self.text.flush()?;
                    return Ok(Some(frame));
                }
                Some(Line::Frame(_)) => self.text.say(&[BELL]),
                Some(Line::Command(command, _)) => self.answer(command),
                Some(Line::Done | Line::Refused) => {}
                None => {
                    self.text.flush()?;
                    return Ok(None);
                }
            }
        }
    }

    fn send(&mut self, frame: &Frame) -> Result<Sent, BusError> {
        // Nobody there hears it: on a wire it would find no acknowledgement.
        if self.open { self.text.frame(frame) } else { Ok(Sent::Refused) }
    }

    fn readable(&self) -> Option<BorrowedFd<'_>> {
        Some(self.text.file.as_fd())
    }

    fn tend(&mut self, now_ns: u64) -> Result<(), BusError> {
        self.text.tend(now_ns)
    }

    fn due_ns(&self) -> u64 {
        self.text.due_ns()
    }
}

impl Drop for Adapter {
    fn drop(&mut self) {
        if std::fs::read_link(&self.link).is_ok_and(|target| target == self.device) {
            let _ = std::fs::remove_file(&self.link); // the folder may have gone
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Id, Kind};

    /// Both ends of a line that this project speaks at both ends, and the folder of the link.
    fn line() -> (Adapter, Slcan, tempfile::TempDir) {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("can0");
        let mut adapter = Adapter::open(&link).unwrap();
        let mut host = Slcan::open(&link, Speeds { rate: Some(800_000), baud: 230_400 }).unwrap();
        assert_eq!(tcgetattr(&host.text.file).unwrap().output_speed(), 230_400);
        assert!(wait(|| adapter.receive().unwrap().is_some() || adapter.open), "the host opens the channel");
        assert!(wait(|| host.receive().unwrap().is_none()));
        (adapter, host, folder)
    }

    fn wait(mut done: impl FnMut() -> bool) -> bool {
        (0..2_000).any(|_| {
            done() || {
                std::thread::sleep(std::time::Duration::from_millis(1));
                false
            }
        })
    }

    fn next(bus: &mut dyn Bus) -> Frame {
        let mut found = None;
        assert!(wait(|| {
            found = bus.receive().unwrap();
            found.is_some()
        }));
        found.unwrap()
    }

    #[test]
    fn frames_of_every_kind_go_both_ways() {
        let (mut adapter, mut host, _folder) = line();
        let frames = [
            Frame::classic(Id::Standard(0x123), &[1, 2, 3]),
            Frame::classic(Id::Extended(0x1abc_def0), &[]),
            Frame::remote(Id::Standard(0x7ff), 8).unwrap(),
            Frame::new(Id::Standard(5), Kind::Fd { brs: true, esi: false }, &[7; 64]).unwrap(),
        ];
        for frame in frames {
            assert_eq!(host.send(&frame).unwrap(), Sent::Taken);
            assert_eq!(next(&mut adapter), frame);
            assert_eq!(adapter.send(&frame).unwrap(), Sent::Taken);
            assert_eq!(next(&mut host), frame);
        }
        assert_eq!(host.losses().denied, 0);
        let report = Frame::new(Id::Extended(4), Kind::Error, &[0; 8]).unwrap();
        assert_eq!(host.send(&report).unwrap(), Sent::Refused);
    }

    #[test]
    fn a_line_that_nobody_reads_fills_and_says_so_and_goes_on_later() {
        let (mut adapter, mut host, _folder) = line();
        let frame = Frame::classic(Id::Extended(1), &[0; 8]);
        let mut taken = 0;
        while adapter.send(&frame).unwrap() == Sent::Taken {
            taken += 1;
            assert!(taken < 10_000, "it takes for ever");
        }
        for _ in 0..taken {
            let mut heard = None;
            assert!(wait(|| {
                adapter.tend(0).unwrap();
                heard = host.receive().unwrap();
                heard.is_some()
            }));
        }
        assert_eq!(adapter.send(&frame).unwrap(), Sent::Taken);
    }

    #[test]
    fn rest_of_what_the_line_did_not_take_is_due_soon_and_nothing_is_due_once_it_is_out() {
        let (mut adapter, mut host, _folder) = line();
        let frame = Frame::classic(Id::Extended(1), &[0; 8]);
        assert_eq!((adapter.due_ns(), host.due_ns()), (u64::MAX, u64::MAX));
        while adapter.send(&frame).unwrap() == Sent::Taken {}
        adapter.tend(5_000_000_000).unwrap();
        assert!(adapter.due_ns() <= 5_001_000_000, "{}", adapter.due_ns());
        assert!(wait(|| {
            while host.receive().unwrap().is_some() {}
            adapter.tend(6_000_000_000).unwrap();
            adapter.due_ns() == u64::MAX
        }));
    }

    #[test]
    fn garbage_on_the_line_is_counted_and_the_next_frame_is_read() {
        let (mut adapter, mut host, _folder) = line();
        host.text.file.write_all(b"t12\r\x00\xff?\rt1231\xee\rt1230\r").unwrap();
        assert_eq!(next(&mut adapter), Frame::classic(Id::Standard(0x123), &[]));
        assert_eq!(adapter.text.refused, 2);
        assert!(
            wait(|| {
                let _ = host.receive().unwrap();
                host.losses().denied == 1
            }),
            "a command that there is not is answered with a bell"
        );
    }

    #[test]
    fn an_adapter_that_goes_is_the_end_of_the_bus_and_its_link_goes_too() {
        let (adapter, mut host, folder) = line();
        drop(adapter);
        assert!(wait(|| host.receive().is_err()));
        assert!(!folder.path().join("can0").exists());
    }

    #[test]
    fn what_can_not_be_opened_says_why() {
        let said = |path: &str, rate| {
            Slcan::open(Path::new(path), Speeds { rate, ..Speeds::default() }).unwrap_err().to_string()
        };
        assert!(said("/dev/nowhere9", None).contains("plugged in"), "{}", said("/dev/nowhere9", None));
        assert!(said("/dev/null", None).contains("no serial device"));
        assert!(said("/dev/null", Some(123)).contains("800000"));
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        assert!(Adapter::open(&file).unwrap_err().to_string().contains("cannot make the link"));
    }
}
