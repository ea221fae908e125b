//! What can stand for a CAN bus, behind one trait.
//!
//! A bus gives the frames that others wrote, never the own ones: whoever forwards them depends on that.

pub mod bits;
mod drops;
pub mod memory;
mod recovery;
pub mod replay;
pub mod room;
mod slcan;
mod socketcan;

use std::fmt;
use std::os::fd::BorrowedFd;
use std::path::PathBuf;
use std::str::FromStr;

use serde::Serialize;

use crate::frame::Frame;
use crate::ids::Ids;

pub use self::slcan::{Adapter, Slcan, Speeds};
pub use self::socketcan::SocketCan;

/// How the controller is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum BusState {
    /// It takes part.
    #[default]
    Active,
    /// Many errors: it no longer destroys others' frames.
    Passive,
    /// Too many errors: it takes no part until it is restarted.
    Off,
}

impl fmt::Display for BusState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Active => "error active",
            Self::Passive => "error passive",
            Self::Off => "bus-off",
        })
    }
}

/// What became of a frame that was to be sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sent {
    /// The controller has it.
    Taken,
    /// Its queue is full: later again.
    Full,
    /// It can not be carried here, now or later (FD on a classic bus).
    Refused,
}

/// Why a bus can not be had, or no longer.
#[derive(Debug, thiserror::Error)]
pub enum BusError {
    /// The kernel has no CAN.
    #[error(
        "{bus}: this kernel has no CAN sockets (AF_CAN): load the modules can and can_raw, or use a serial adapter \
         (slcan:/dev/ttyUSB0)"
    )]
    NoCan {
        /// The bus.
        bus: String,
    },
    /// There is no such interface.
    #[error(
        "{bus}: there is no such interface; `ip link show type can` lists them, and type vcan the virtual ones"
    )]
    NoInterface {
        /// The bus.
        bus: String,
    },
    /// The interface is not up.
    #[error(
        "{bus}: the interface is down; `ip link set {interface} up type can bitrate 800000` brings it up"
    )]
    Down {
        /// The bus.
        bus: String,
        /// The interface.
        interface: String,
    },
    /// This user may not.
    #[error("{bus}: no permission ({error}); {mend}")]
    NoPermission {
        /// The bus.
        bus: String,
        /// The system's answer.
        error: std::io::Error,
        /// What would help.
        mend: &'static str,
    },
    /// A file or device that can not be opened.
    #[error("{bus}: {error}")]
    Open {
        /// The bus.
        bus: String,
        /// The system's answer.
        error: String,
    },
    /// It broke.
    #[error("{bus}: {error}")]
    Broken {
        /// The bus.
        bus: String,
        /// The system's answer.
        error: std::io::Error,
    },
    /// It has come to its end.
    #[error("{bus}: it has ended")]
    Ended {
        /// The bus.
        bus: String,
    },
    /// A line of a file that is none.
    #[error("{path}:{line}: {error}")]
    Line {
        /// The file.
        path: String,
        /// Which line, from 1.
        line: usize,
        /// What is wrong.
        error: crate::wire::candump::Refusal,
    },
    /// A bit rate that the adapter has no number for.
    #[error(
        "{bus}: serial adapters know 10000, 20000, 50000, 100000, 125000, 250000, 500000, 800000 and 1000000 bit/s, not {rate}"
    )]
    Rate {
        /// The bus.
        bus: String,
        /// What was asked for.
        rate: u32,
    },
}

/// A bus, opened. Nothing in it waits.
pub trait Bus: Send {
    /// The next frame that somebody else wrote; `None` if none waits.
    ///
    /// # Errors
    /// The bus is no longer there.
    fn receive(&mut self) -> Result<Option<Frame>, BusError>;

    /// Hands a frame to the controller.
    ///
    /// # Errors
    /// The bus is no longer there.
    fn send(&mut self, frame: &Frame) -> Result<Sent, BusError>;

    /// What becomes readable when a frame waits; `None` if it has to be asked.
    fn readable(&self) -> Option<BorrowedFd<'_>>;

    /// How the controller is.
    fn state(&self) -> BusState {
        BusState::Active
    }

    /// Time passes: what has to be done by the clock (recovery, a replay). `now_ns` is any clock that never goes back.
    ///
    /// # Errors
    /// The bus is no longer there.
    fn tend(&mut self, now_ns: u64) -> Result<(), BusError> {
        let _ = now_ns;
        Ok(())
    }

    /// When [`Bus::tend`] has something to do next, ns.
    fn due_ns(&self) -> u64 {
        u64::MAX
    }

    /// What went wrong with frames out of this program's sight.
    fn losses(&self) -> Losses {
        Losses::default()
    }

    /// What a person should hear of, once.
    fn complaint(&mut self) -> Option<String> {
        None
    }
}

/// What went wrong with frames out of this program's sight, since the bus was opened.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Losses {
    /// Frames that came and that the system had no room for, while this program did not run.
    pub unkept: u64,
    /// Times that an adapter said no, to a frame or to an order, and lines of its that were none.
    pub denied: u64,
}

impl Losses {
    /// Says what has become twice as many since it was `told`: a log must not be filled.
    pub fn tell(self, told: &mut Self, bus: &BusName, say: &mut dyn FnMut(&str)) {
        let is_news = |now: u64, told: u64| now >= 2 * told.max(1) || (now == 1 && told == 0);
        if is_news(self.unkept, told.unkept) {
            told.unkept = self.unkept;
            say(&format!("{bus}: {} frames came while there was no room for them, so far", self.unkept));
        }
        if is_news(self.denied, told.denied) {
            told.denied = self.denied;
            say(&format!("{bus}: the adapter has said no {} times so far", self.denied));
        }
    }
}

impl std::ops::Add for Losses {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self { unkept: self.unkept + other.unkept, denied: self.denied + other.denied }
    }
}

/// Which bus, as a person says it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum BusName {
    /// `socketcan:can0`.
    SocketCan(String),
    /// `slcan:/dev/ttyUSB0` or `slcan:/dev/ttyUSB0@500000,230400`: a serial adapter, the bit rate that it is to set, and the speed of
    /// the serial line.
    Slcan(PathBuf, Speeds),
    /// `slcan-pty:/run/can0`: this program is the adapter; the path becomes a link to a new pseudo terminal.
    Adapter(PathBuf),
    /// `replay:FILE`: what a log of candump holds, at its pace; what is sent is thrown away.
    Replay(PathBuf),
    /// `none`: no bus; frames come from clients alone.
    None,
}

impl BusName {
    /// Opens it. `wanted`: the identifiers that will be looked at; a backend may leave out others.
    ///
    /// # Errors
    /// Why it can not be had.
    pub fn open(&self, wanted: &Ids) -> Result<Box<dyn Bus>, BusError> {
        Ok(match self {
            Self::SocketCan(interface) => Box::new(SocketCan::open(interface, wanted)?),
            Self::Slcan(path, speeds) => Box::new(Slcan::open(path, *speeds)?),
            Self::Adapter(path) => Box::new(Adapter::open(path)?),
            Self::Replay(path) => Box::new(replay::Replay::open(path)?),
            Self::None => Box::new(NoBus),
        })
    }
}

/// A text that names no bus.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "\"{0}\" names no bus: write socketcan:can0, slcan:/dev/ttyUSB0 (with @500000 for the bit rate, ,230400 for the serial line), slcan-pty:/run/can0 (be the \
     adapter of a new pseudo terminal), replay:FILE, or none"
)]
pub struct NotABus(pub String);

impl FromStr for BusName {
    type Err = NotABus;

    fn from_str(text: &str) -> Result<Self, NotABus> {
        let no = || NotABus(text.into());
        if text == "none" {
            return Ok(Self::None);
        }
        let (kind, name) = text.split_once(':').ok_or_else(no)?;
        if name.is_empty() {
            return Err(no());
        }
        match kind {
            "socketcan" => Ok(Self::SocketCan(name.into())),
            "slcan" => {
                let (name, baud) = match name.rsplit_once(',') {
                    Some((name, baud)) => (name, baud.parse().map_err(|_| no())?),
                    None => (name, slcan::BAUD),
                };
                let (path, rate) = match name.split_once('@') {
                    Some((path, rate)) => (path, Some(rate.parse().map_err(|_| no())?)),
                    None => (name, None),
                };
                match baud {
                    0 => Err(no()),
                    _ => Ok(Self::Slcan(path.into(), Speeds { rate, baud })),
                }
            }
            "slcan-pty" => Ok(Self::Adapter(name.into())),
            "replay" => Ok(Self::Replay(name.into())),
            _ => Err(no()),
        }
    }
}

impl fmt::Display for BusName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::SocketCan(name) => write!(f, "socketcan:{name}"),
            Self::Slcan(path, Speeds { rate, baud }) => {
                write!(f, "slcan:{}", path.display())?;
                rate.map_or(Ok(()), |rate| write!(f, "@{rate}"))?;
                if *baud == slcan::BAUD { Ok(()) } else { write!(f, ",{baud}") }
            }
            Self::Adapter(path) => write!(f, "slcan-pty:{}", path.display()),
            Self::Replay(path) => write!(f, "replay:{}", path.display()),
            Self::None => f.write_str("none"),
        }
    }
}

/// No bus at all.
struct NoBus;

impl Bus for NoBus {
    fn receive(&mut self) -> Result<Option<Frame>, BusError> {
        Ok(None)
    }

    fn send(&mut self, _: &Frame) -> Result<Sent, BusError> {
        Ok(Sent::Taken)
    }

    fn readable(&self) -> Option<BorrowedFd<'_>> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_is_read_back_as_it_is_written_and_others_are_refused_with_examples() {
        for text in [
            "socketcan:can0",
            "slcan:/dev/ttyUSB0",
            "slcan:/dev/ttyUSB0@500000",
            "slcan:/dev/ttyUSB0@500000,230400",
            "slcan:/dev/ttyS1,1000000",
            "slcan-pty:/run/x",
            "replay:a.log",
            "none",
        ] {
            assert_eq!(text.parse::<BusName>().unwrap().to_string(), text);
        }
        for text in
            ["can0", "socketcan:", "slcan:/dev/x@fast", "slcan:/dev/x,fast", "slcan:/dev/x,0", "usb:1", ""]
        {
            assert!(text.parse::<BusName>().unwrap_err().to_string().contains("socketcan:can0"), "{text}");
        }
    }

    #[test]
    fn losses_are_told_when_they_have_become_twice_as_many() {
        let (mut told, mut said) = (Losses::default(), 0);
        for unkept in 0..=1_000 {
            let losses = Losses { unkept, denied: unkept / 1_000 };
            losses.tell(&mut told, &BusName::SocketCan("can0".into()), &mut |text| {
                assert!(text.starts_with("socketcan:can0: "), "{text}");
                said += 1;
            });
        }
        assert_eq!(said, 11, "1, 2, 4, … 512, and the adapter's one");
    }

    #[test]
    fn an_interface_that_is_not_there_is_refused_with_what_helps() {
        let Err(error) = SocketCan::open("nocan9", &Ids::All) else { panic!("it is there") };
        let said = error.to_string();
        let raw = rustix::net::SocketType::RAW;
        let kernel = rustix::net::socket(rustix::net::AddressFamily::CAN, raw, None);
        let helps = if kernel.is_ok() { "ip link show" } else { "no CAN sockets" };
        assert!(said.contains(helps), "{said}");
        assert!(said.contains("socketcan:nocan9"), "{said}");
    }
}
