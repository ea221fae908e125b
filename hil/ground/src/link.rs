//! The line to the aircraft: bytes in, telemetry out; orders in, bytes out.

use bateleur_messages::frame::{self, Decoder, Refused};
use bateleur_messages::ground::{BEAT, Order};
use bateleur_messages::telemetry::Telemetry;
use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::termios::{self, OptionalActions};
use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::os::fd::AsFd;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Bytes waiting for a line that does not take them. Beyond it orders are dropped and counted: they are repeated by
/// whoever needs them, and old ones would arrive after they were overtaken.
const LONGEST_QUEUE: usize = 16 * 1024;

/// Between two beats, ns: often enough that a few may be lost before the ground is called silent on board.
const BEAT_NS: u64 = 1_000_000_000;
/// Bytes read at a time.
const CHUNK: usize = 4096;
/// Bytes read in one step at most: a babbling line must not keep the caller.
const MOST_IN_A_STEP: usize = 64 * CHUNK;

/// Anything that a line can run over: a serial device, one end of a pseudo-terminal, a socket.
pub trait Stream: Read + Write + AsFd + Send {}
impl<T: Read + Write + AsFd + Send> Stream for T {}

/// Why the line cannot be used.
#[derive(Debug, Error)]
pub enum LinkError {
    /// The device cannot be opened or set.
    #[error("cannot use the serial device {}: {error}; is it plugged in, and are you in its group (ls -l says which)?", path.display())]
    Device {
        /// The device.
        path: PathBuf,
        /// What the system said.
        error: io::Error,
    },
    /// The stream cannot be made non-blocking.
    #[error("cannot use the line without waiting on it: {0}")]
    Blocking(io::Error),
    /// The other end has gone for good.
    #[error("the line was closed by the other end")]
    Closed,
    /// Reading or writing failed.
    #[error("the line failed: {0}")]
    Broken(io::Error),
}

/// What went over the line.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LinkCounters {
    /// Bytes that came.
    pub bytes_received: u64,
    /// Bytes that the line took.
    pub bytes_sent: u64,
    /// Telemetry messages read.
    pub telemetry: u64,
    /// Orders put on the line.
    pub orders: u64,
    /// Whole frames that were no telemetry.
    pub unknown: u64,
    /// Orders dropped because the line took nothing for too long.
    pub dropped: u64,
    /// Frames and bytes that the decoder refused.
    pub refused: Refused,
}

/// The line.
pub struct Link {
    stream: Box<dyn Stream>,
    decoder: Decoder,
    outgoing: Vec<u8>,
    beat_due_ns: u64,
    counters: LinkCounters,
}

impl std::fmt::Debug for Link {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Link").field("counters", &self.counters).finish_non_exhaustive()
    }
}

impl Link {
    /// A line over a stream, which is made non-blocking.
    ///
    /// # Errors
    /// When it cannot be.
    pub fn new(stream: impl Stream + 'static) -> Result<Self, LinkError> {
        let blocking = |errno: Errno| LinkError::Blocking(errno.into());
        let flags = rustix::fs::fcntl_getfl(&stream).map_err(blocking)?;
        rustix::fs::fcntl_setfl(&stream, flags | OFlags::NONBLOCK).map_err(blocking)?;
        Ok(Self {
            stream: Box::new(stream),
            decoder: Decoder::new(),
            outgoing: Vec::with_capacity(512),
            beat_due_ns: 0,
            counters: LinkCounters::default(),
        })
    }

    /// A line over a serial device or a pseudo-terminal, set to raw bytes, 8 bits, no parity, no flow control.
    ///
    /// # Errors
    /// When there is no such device or it cannot be set.
    pub fn serial(path: &Path, baud: u32) -> Result<Self, LinkError> {
        let refused = |errno: Errno| LinkError::Device { path: path.to_owned(), error: errno.into() };
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let device = rustix::fs::open(path, flags, Mode::empty()).map_err(refused)?;
        let mut settings = termios::tcgetattr(&device).map_err(refused)?;
        settings.make_raw();
        settings.set_speed(baud).map_err(refused)?;
        termios::tcsetattr(&device, OptionalActions::Now, &settings).map_err(refused)?;
        Self::new(File::from(device))
    }

    /// What went over the line so far.
    pub fn counters(&self) -> LinkCounters {
        LinkCounters { refused: self.decoder.refused(), ..self.counters }
    }

    /// Bytes that came so far.
    pub fn bytes_received(&self) -> u64 {
        self.counters.bytes_received
    }

    /// Bytes that the line took so far.
    pub fn bytes_sent(&self) -> u64 {
        self.counters.bytes_sent
    }

    /// Sends an order, or as much of it as the line takes; the rest goes with the next [`Link::flush`].
    ///
    /// # Errors
    /// When the line is closed or broken.
    pub fn send(&mut self, order: &Order) -> Result<(), LinkError> {
        if self.outgoing.len() > LONGEST_QUEUE {
            self.counters.dropped += 1;
        } else {
            frame::encode(order.letter(), &order.data(), &mut self.outgoing);
            self.counters.orders += 1;
        }
        self.flush()
    }

    /// Says that the ground is there, and nothing else, once a second; `now_ns` is the caller's clock.
    ///
    /// # Errors
    /// As [`Link::send`].
    pub fn beat(&mut self, now_ns: u64) -> Result<(), LinkError> {
        if now_ns < self.beat_due_ns {
            return Ok(());
        }
        self.beat_due_ns = now_ns + BEAT_NS;
        if self.outgoing.is_empty() {
            frame::encode(BEAT, &[], &mut self.outgoing);
        }
        self.flush()
    }

    /// Writes what waits, as far as the line takes it.
    ///
    /// # Errors
    /// When the line is closed or broken.
    pub fn flush(&mut self) -> Result<(), LinkError> {
        while !self.outgoing.is_empty() {
            match self.stream.write(&self.outgoing) {
                Ok(0) => return Err(LinkError::Closed),
                Ok(written) => {
                    self.outgoing.drain(..written);
                    self.counters.bytes_sent += written as u64;
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return nobody_there(error),
            }
        }
        Ok(())
    }

    /// Reads all that has come and hands each telemetry message to `take`. Never waits.
    ///
    /// # Errors
    /// When the line is closed or broken.
    pub fn receive(&mut self, mut take: impl FnMut(Telemetry)) -> Result<(), LinkError> {
        let mut chunk = [0; CHUNK];
        let mut taken = 0;
        while taken < MOST_IN_A_STEP {
            match self.stream.read(&mut chunk) {
                Ok(0) => return Err(LinkError::Closed),
                Ok(length) => {
                    taken += length;
                    self.decode(&chunk[..length], &mut take);
                }
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) => return nobody_there(error),
            }
        }
        Ok(())
    }

    fn decode(&mut self, bytes: &[u8], take: &mut impl FnMut(Telemetry)) {
        self.counters.bytes_received += bytes.len() as u64;
        for frame in self.decoder.extend(bytes) {
            if let Ok(telemetry) = Telemetry::of(&frame) {
                self.counters.telemetry += 1;
                take(telemetry);
            } else {
                self.counters.unknown += 1;
            }
        }
    }
}

/// No bytes now, or a pseudo-terminal whose other end nobody holds at the moment (a restarted partition): neither is
/// the end of the line.
fn nobody_there(error: io::Error) -> Result<(), LinkError> {
    let vacant = error.raw_os_error() == Some(Errno::IO.raw_os_error());
    match error.kind() {
        ErrorKind::WouldBlock => Ok(()),
        ErrorKind::BrokenPipe | ErrorKind::ConnectionReset => Err(LinkError::Closed),
        _ if vacant => Ok(()),
        _ => Err(LinkError::Broken(error)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bateleur_messages::telemetry::Primary;
    use std::os::unix::net::UnixStream;

    fn pair() -> (Link, UnixStream) {
        let (ours, theirs) = UnixStream::pair().unwrap();
        (Link::new(ours).unwrap(), theirs)
    }

    #[test]
    fn beat_goes_out_once_a_second_however_often_it_is_asked_for() {
        let (mut link, mut aircraft) = pair();
        aircraft.set_nonblocking(true).unwrap();
        (0..=40).for_each(|step| link.beat(step * 50_000_000).unwrap()); // 2 s
        let mut bytes = [0; 64];
        let length = aircraft.read(&mut bytes).unwrap();
        let letters: Vec<u8> = Decoder::new().extend(&bytes[..length]).map(|frame| frame.letter).collect();
        assert_eq!(letters, [BEAT; 3]);
    }

    #[test]
    fn telemetry_is_read_and_noise_counted() {
        let (mut link, mut aircraft) = pair();
        let primary = Telemetry::Primary(Primary { hil: 1, ..Primary::default() });
        let mut bytes = b"noise".to_vec();
        let (letter, data) = primary.parts();
        frame::encode(letter, data, &mut bytes);
        frame::encode(b'Z', &[1], &mut bytes);
        aircraft.write_all(&bytes).unwrap();
        let mut taken = Vec::new();
        link.receive(|telemetry| taken.push(telemetry)).unwrap();
        assert_eq!(taken, [primary]);
        let counters = link.counters();
        assert_eq!((counters.telemetry, counters.unknown, counters.refused.noise_bytes), (1, 1, 5));
        assert_eq!(counters.bytes_received, bytes.len() as u64);
    }

    #[test]
    fn line_that_takes_nothing_blocks_nobody() {
        let (mut link, _aircraft) = pair();
        for _ in 0..200_000 {
            link.send(&Order::Hil { on: true }).unwrap();
        }
        let counters = link.counters();
        assert!(counters.dropped > 0 && counters.bytes_sent > 0, "{counters:?}");
    }

    #[test]
    fn closed_line_is_told() {
        let (mut link, aircraft) = pair();
        drop(aircraft);
        assert!(matches!(link.receive(|_| ()), Err(LinkError::Closed)));
        assert!(matches!(link.send(&Order::Hil { on: true }), Err(LinkError::Closed)));
    }

    #[test]
    fn missing_device_is_named() {
        let message = Link::serial(Path::new("/dev/no_such_line"), 115_200).unwrap_err().to_string();
        assert!(message.contains("/dev/no_such_line") && message.contains("plugged in"), "{message}");
    }
}
