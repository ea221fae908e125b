//! A serial device, raw and without blocking.

use std::fs::File;
use std::io::{self, Read, Write};
use std::os::fd::{AsFd, BorrowedFd, OwnedFd};

use rustix::fs::{Mode, OFlags};
use rustix::io::Errno;
use rustix::termios::{ControlModes, OptionalActions, SpecialCodeIndex, tcgetattr, tcsetattr};

/// Why a device can not be used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum DeviceError {
    /// It can not be opened.
    #[error("cannot be opened ({0})")]
    Open(Errno),
    /// It is no terminal.
    #[error("is no serial line ({0})")]
    NoTerminal(Errno),
    /// It does not know the speed.
    #[error("does not do {baud} baud ({error})")]
    Speed {
        /// Symbols a second.
        baud: u32,
        /// The system's answer.
        error: Errno,
    },
}

/// An open device, or the place of one that is missing.
#[derive(Debug)]
pub struct Device {
    file: File,
}

impl Device {
    /// Opens the device at `path` with `baud` symbols a second, eight bits, no parity, no flow control. It does not
    /// become the controlling terminal, so that a line that hangs up sends no signal.
    pub fn open(path: &str, baud: u32) -> Result<Self, DeviceError> {
        let flags = OFlags::RDWR | OFlags::NOCTTY | OFlags::NONBLOCK | OFlags::CLOEXEC;
        let descriptor = rustix::fs::open(path, flags, Mode::empty()).map_err(DeviceError::Open)?;
        make_raw(&descriptor, baud)?;
        Ok(Self { file: descriptor.into() })
    }

    /// What stands in for a device that is not there: it is at its end when it is read.
    pub fn absent() -> io::Result<Self> {
        let (reader, _) = io::pipe()?;
        Ok(Self { file: OwnedFd::from(reader).into() })
    }
}

fn make_raw(device: &impl AsFd, baud: u32) -> Result<(), DeviceError> {
    let mut settings = tcgetattr(device).map_err(DeviceError::NoTerminal)?;
    settings.make_raw();
    settings.control_modes |= ControlModes::CLOCAL | ControlModes::CREAD;
    settings.control_modes -= ControlModes::CSTOPB | ControlModes::CRTSCTS;
    // One byte makes it readable; with 0 an empty line would look like one that has hung up.
    settings.special_codes[SpecialCodeIndex::VMIN] = 1;
    settings.special_codes[SpecialCodeIndex::VTIME] = 0;
    let speed = |error| DeviceError::Speed { baud, error };
    settings.set_speed(baud).map_err(speed)?;
    tcsetattr(device, OptionalActions::Now, &settings).map_err(speed)
}

impl Read for Device {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.file.read(buffer)
    }
}

impl Write for Device {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.file.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl AsFd for Device {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
    use std::io::ErrorKind;

    /// The ground's end of a line, and the path of the aircraft's end.
    fn line() -> (File, String) {
        let ground = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY).unwrap();
        grantpt(&ground).unwrap();
        unlockpt(&ground).unwrap();
        let path = ptsname(&ground, Vec::new()).unwrap().into_string().unwrap();
        (ground.into(), path)
    }

    #[test]
    fn every_byte_passes_both_ways_unchanged() {
        let (mut ground, path) = line();
        let mut device = Device::open(&path, 57_600).unwrap();
        let all: Vec<u8> = (0..=255).collect();
        device.write_all(&all).unwrap();
        let mut heard = [0; 256];
        ground.read_exact(&mut heard).unwrap();
        assert_eq!(heard[..], all);
        ground.write_all(&all).unwrap();
        let mut heard = Vec::new();
        while heard.len() < all.len() {
            let mut buffer = [0; 64];
            match device.read(&mut buffer) {
                Ok(count) => heard.extend_from_slice(&buffer[..count]),
                Err(error) => assert_eq!(error.kind(), ErrorKind::WouldBlock),
            }
        }
        assert_eq!(heard, all);
    }

    #[test]
    fn an_empty_line_does_not_block_and_is_not_at_its_end() {
        let (_ground, path) = line();
        let mut device = Device::open(&path, 57_600).unwrap();
        assert_eq!(device.read(&mut [0; 8]).unwrap_err().kind(), ErrorKind::WouldBlock);
    }

    #[test]
    fn a_line_that_hung_up_gives_an_error_or_its_end() {
        let (ground, path) = line();
        let mut device = Device::open(&path, 57_600).unwrap();
        drop(ground);
        let gone = device.read(&mut [0; 8]);
        assert!(matches!(&gone, Ok(0)) || gone.is_err_and(|error| error.kind() != ErrorKind::WouldBlock));
    }

    #[test]
    fn what_is_missing_or_no_line_is_told_apart() {
        assert_eq!(Device::open("/nowhere/tty", 57_600).unwrap_err(), DeviceError::Open(Errno::NOENT));
        assert_eq!(Device::open("/dev/null", 57_600).unwrap_err(), DeviceError::NoTerminal(Errno::NOTTY));
    }

    #[test]
    fn the_place_of_a_missing_device_is_at_its_end() {
        assert_eq!(Device::absent().unwrap().read(&mut [0; 8]).unwrap(), 0);
    }
}
