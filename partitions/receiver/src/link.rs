//! The line to the receiver: a serial device, or a converter that carries one over TCP. Nothing here ever waits.

use std::fs::File;
use std::io::{self, ErrorKind, Read, Write};
use std::net::SocketAddr;
use std::os::fd::OwnedFd;
use std::str::FromStr;

use bateleur_apex::serial::{Device, DeviceError};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::io::Errno;
use rustix::net::{AddressFamily, SocketFlags, SocketType, connect, socket_with, sockopt};

/// Before a TCP address.
const TCP: &str = "tcp:";

/// Where the receiver is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Place {
    /// Path of a serial device.
    Serial(String),
    /// Address and port of a serial-to-Ethernet converter.
    Tcp(SocketAddr),
}

impl FromStr for Place {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let Some(address) = text.strip_prefix(TCP) else { return Ok(Self::Serial(text.into())) };
        let address = address.parse().map_err(|_| {
            format!(
                "device = \"{text}\": give address and port as numbers, such as \"tcp:192.168.1.20:4001\""
            )
        })?;
        Ok(Self::Tcp(address))
    }
}

/// Why there is no line.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// The serial device.
    #[error(transparent)]
    Serial(#[from] DeviceError),
    /// The system refused a socket.
    #[error("cannot be reached ({0}); the plan has to say `network = true` and `system_calls = [\"tcp\"]`")]
    Refused(Errno),
    /// The converter did not take the connection, or ended it.
    #[error("is not there ({0})")]
    Gone(io::Error),
    /// The converter says nothing, though the connection stands.
    #[error("is not there: not one byte in {0} s; it is dialled anew")]
    Mute(u64),
}

/// A line, or one that is coming about.
#[derive(Debug)]
pub enum Link {
    /// A serial device.
    Serial(Device),
    /// A connection.
    Tcp {
        /// It.
        socket: File,
        /// The converter has taken it.
        connected: bool,
    },
}

impl Link {
    /// Opens a device, or begins a connection.
    ///
    /// # Errors
    /// It is not there, or may not be used.
    pub fn open(place: &Place, baud: u32) -> Result<Self, LinkError> {
        match place {
            Place::Serial(path) => Ok(Self::Serial(Device::open(path, baud)?)),
            Place::Tcp(address) => Ok(Self::Tcp { socket: begin(*address)?.into(), connected: false }),
        }
    }

    /// Whether there is a connection that can vanish without a word.
    pub fn is_connection(&self) -> bool {
        matches!(self, Self::Tcp { .. })
    }

    /// Whether bytes can pass. Of a connection that was refused it is an error.
    ///
    /// # Errors
    /// The converter did not take the connection.
    pub fn is_up(&mut self) -> Result<bool, LinkError> {
        let Self::Tcp { socket, connected: connected @ false } = self else { return Ok(true) };
        let mut wanted = [PollFd::new(&*socket, PollFlags::OUT)];
        let now = Timespec { tv_sec: 0, tv_nsec: 0 };
        if poll(&mut wanted, Some(&now)).unwrap_or(0) == 0 {
            return Ok(false);
        }
        match sockopt::socket_error(&*socket) {
            Ok(Ok(())) => {
                *connected = true;
                Ok(true)
            }
            Ok(Err(error)) | Err(error) => Err(LinkError::Gone(error.into())),
        }
    }

    /// What has arrived, `buffer` full at most.
    ///
    /// # Errors
    /// The line is gone.
    pub fn receive(&mut self, buffer: &mut [u8]) -> Result<usize, LinkError> {
        let read = match self {
            Self::Serial(device) => device.read(buffer),
            Self::Tcp { socket, .. } => socket.read(buffer),
        };
        match read {
            Ok(0) => Err(LinkError::Gone(ErrorKind::UnexpectedEof.into())),
            Ok(count) => Ok(count),
            Err(error) if is_empty(&error) => Ok(0),
            Err(error) => Err(LinkError::Gone(error)),
        }
    }

    /// Sends what the line takes at once: an order that is cut off is repeated anyway.
    ///
    /// # Errors
    /// The line is gone.
    pub fn send(&mut self, bytes: &[u8]) -> Result<(), LinkError> {
        let written = match self {
            Self::Serial(device) => device.write(bytes),
            Self::Tcp { socket, .. } => socket.write(bytes),
        };
        match written {
            Ok(_) => Ok(()),
            Err(error) if is_empty(&error) => Ok(()),
            Err(error) => Err(LinkError::Gone(error)),
        }
    }
}

fn begin(address: SocketAddr) -> Result<OwnedFd, LinkError> {
    let family = if address.is_ipv4() { AddressFamily::INET } else { AddressFamily::INET6 };
    let flags = SocketFlags::NONBLOCK | SocketFlags::CLOEXEC;
    let socket = socket_with(family, SocketType::STREAM, flags, None).map_err(LinkError::Refused)?;
    match connect(&socket, &address) {
        Ok(()) | Err(Errno::INPROGRESS | Errno::INTR) => Ok(socket),
        Err(error @ (Errno::PERM | Errno::ACCESS)) => Err(LinkError::Refused(error)),
        Err(error) => Err(LinkError::Gone(error.into())),
    }
}

fn is_empty(error: &io::Error) -> bool {
    matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::net::TcpListener;

    fn await_up(link: &mut Link) -> Result<(), LinkError> {
        while !link.is_up()? {
            std::thread::yield_now();
        }
        Ok(())
    }

    #[test]
    fn converter_carries_bytes_both_ways_and_its_end_is_an_error() {
        let converter = TcpListener::bind("127.0.0.1:0").unwrap();
        let place = Place::Tcp(converter.local_addr().unwrap());
        let mut link = Link::open(&place, 0).unwrap();
        await_up(&mut link).unwrap();
        let (mut far, _) = converter.accept().unwrap();
        let mut buffer = [0; 8];
        assert_eq!(link.receive(&mut buffer).unwrap(), 0);
        link.send(b"ask").unwrap();
        let mut asked = [0; 3];
        far.read_exact(&mut asked).unwrap();
        assert_eq!(&asked, b"ask");
        far.write_all(b"answer").unwrap();
        let count = loop {
            match link.receive(&mut buffer).unwrap() {
                0 => std::thread::yield_now(),
                count => break count,
            }
        };
        assert_eq!(&buffer[..count], b"answer");
        drop(far);
        let ended = loop {
            if let Err(error) = link.receive(&mut buffer) {
                break error;
            }
        };
        assert!(ended.to_string().starts_with("is not there"), "{ended}");
    }

    #[test]
    fn converter_that_is_not_there_is_said_and_waited_for_by_nobody() {
        let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
        let refused = Link::open(&Place::Tcp(free), 0).and_then(|mut link| await_up(&mut link));
        assert!(refused.unwrap_err().to_string().contains("refused"));
    }

    #[test]
    fn places_are_devices_or_addresses() {
        assert_eq!("/dev/ttyUSB0".parse(), Ok(Place::Serial("/dev/ttyUSB0".into())));
        assert_eq!("tcp:10.0.0.7:4001".parse(), Ok(Place::Tcp("10.0.0.7:4001".parse().unwrap())));
        assert!("tcp:converter:4001".parse::<Place>().unwrap_err().contains("as numbers"));
    }
}
