//! SocketCAN: the kernel's own CAN interfaces, classic and FD.

use std::io::{self, ErrorKind};
use std::num::NonZeroU32;
use std::os::fd::{AsFd, BorrowedFd};

use rustix::io::Errno;
use rustix::net::{AddressFamily, Protocol, SocketType};
use socketcan::frame::{AsPtr, can_frame_default, canfd_frame_default};
use socketcan::{CanAnyFrame, CanFdSocket, CanInterface, CanRawFrame, Socket, SocketOptions};

use super::recovery::Recovery;
use super::{Bus, BusError, BusState, Losses, Sent, drops};
use crate::frame::{ERROR_FLAG, EXTENDED_FLAG, Frame, Kind};
use crate::ids::Ids;

/// The protocol of raw CAN sockets (`linux/can.h`).
const CAN_RAW: u32 = 1;
/// Flags of an FD frame in the words of Linux (`linux/can.h`).
const CANFD_BRS: u8 = 1;
const CANFD_ESI: u8 = 2;

/// Classes of errors (`linux/can/error.h`).
const CLASS_CONTROLLER: u32 = 0x04;
const CLASS_BUS_OFF: u32 = 0x40;
const CLASS_RESTARTED: u32 = 0x100;
/// Bits of the controller's state, in the second byte.
const PASSIVE_BITS: u8 = 0x10 | 0x20;
const ACTIVE_BIT: u8 = 0x40;

/// An interface of the kernel.
#[derive(Debug)]
pub struct SocketCan {
    bus: String,
    interface: String,
    socket: CanFdSocket,
    wanted: Ids,
    controller: Controller,
}

/// What frames and reports say of the interface's controller.
#[derive(Debug)]
struct Controller {
    state: BusState,
    recovery: Recovery,
    now_ns: u64,
}

impl SocketCan {
    /// Opens an interface: classic frames and FD, all reports of errors, none of the own frames. Where `wanted` is a list, the
    /// kernel leaves out other identifiers.
    ///
    /// # Errors
    /// No such interface, no CAN in this kernel, no permission.
    pub fn open(interface: &str, wanted: &Ids) -> Result<Self, BusError> {
        let bus = format!("socketcan:{interface}");
        let refused = |error| refusal(&bus, interface, error);
        let socket = index_of(interface).and_then(CanFdSocket::open_iface).map_err(refused)?;
        socket.set_nonblocking(true).map_err(refused)?;
        super::room::keep_more(&socket);
        socket.set_recv_own_msgs(false).map_err(refused)?;
        socket.set_error_filter_accept_all().map_err(refused)?;
        if let Some(masks) = wanted.masks() {
            socket.set_filters(&masks).map_err(refused)?;
        }
        // An interface that is down is bound all the same, with an error that waits in the socket.
        rustix::net::sockopt::socket_error(&socket)
            .and_then(|pending| pending)
            .map_err(|error| refused(error.into()))?;
        let (interface, wanted) = (interface.to_owned(), wanted.clone());
        Ok(Self { bus, interface, socket, wanted, controller: Controller::new() })
    }
}

impl Controller {
    fn new() -> Self {
        Self { state: BusState::Active, recovery: Recovery::default(), now_ns: 0 }
    }

    fn note(&mut self, frame: &Frame) {
        if frame.kind() != Kind::Error {
            // Who is off the bus hears nothing: the report of the restart was lost, for which a full socket is enough.
            if self.state == BusState::Off {
                self.restarted();
            }
            return;
        }
        let class = frame.word();
        if class & CLASS_BUS_OFF != 0 {
            self.state = BusState::Off;
            self.recovery.off(self.now_ns);
        } else if class & CLASS_RESTARTED != 0 {
            self.restarted();
        } else if class & CLASS_CONTROLLER != 0 && self.state != BusState::Off {
            let detail = frame.data().get(1).copied().unwrap_or(0);
            if detail & PASSIVE_BITS != 0 {
                self.state = BusState::Passive;
            } else if detail & ACTIVE_BIT != 0 {
                self.state = BusState::Active;
            }
        }
    }

    fn restarted(&mut self) {
        self.state = BusState::Active;
        self.recovery.on();
    }
}

/// Asks the kernel to restart the controller. It does so by itself where the interface has a `restart-ms`; then this is
/// refused, which is as good.
fn restart(interface: &str) -> Result<(), String> {
    let interface = CanInterface::open(interface).map_err(|error| error.to_string())?;
    interface.restart().map_err(|error| error.to_string())
}

/// What the system's answer means to a person.
fn refusal(bus: &str, interface: &str, error: io::Error) -> BusError {
    let bus = bus.to_owned();
    match error.raw_os_error().map(Errno::from_raw_os_error) {
        Some(Errno::AFNOSUPPORT | Errno::PROTONOSUPPORT) => BusError::NoCan { bus },
        Some(Errno::NODEV | Errno::NXIO) => BusError::NoInterface { bus },
        Some(Errno::NETDOWN) => BusError::Down { bus, interface: interface.into() },
        Some(Errno::PERM | Errno::ACCESS) => BusError::NoPermission {
            bus,
            error,
            mend: "a partition needs `network = true` and `system_calls = [\"can\"]` to have a CAN socket; a container needs CAP_NET_RAW",
        },
        _ => BusError::Broken { bus, error },
    }
}

/// The kernel's number of an interface. It is asked by a CAN socket, which a partition that may use one can have.
fn index_of(interface: &str) -> io::Result<u32> {
    let protocol = NonZeroU32::new(CAN_RAW).map(Protocol::from_raw);
    let socket = rustix::net::socket(AddressFamily::CAN, SocketType::RAW, protocol)?;
    Ok(rustix::net::netdevice::name_to_index(&socket, interface)?)
}

fn of_raw(raw: CanRawFrame) -> Option<Frame> {
    let frame = match raw {
        CanRawFrame::Classic(raw) => {
            let length = usize::from(raw.can_dlc).min(raw.data.len());
            let word = if raw.can_id & ERROR_FLAG != 0 { raw.can_id & !EXTENDED_FLAG } else { raw.can_id };
            Frame::of_word(word, None, length, &raw.data[..length])
        }
        CanRawFrame::Fd(raw) => {
            let length = usize::from(raw.len).min(raw.data.len());
            let flags = (raw.flags & CANFD_BRS != 0, raw.flags & CANFD_ESI != 0);
            Frame::of_word(raw.can_id, Some(flags), length, &raw.data[..length])
        }
    };
    frame.ok()
}

fn raw_of(frame: &Frame) -> CanAnyFrame {
    match frame.kind() {
        Kind::Fd { brs, esi } => {
            let mut raw = canfd_frame_default();
            raw.can_id = frame.word();
            raw.len = frame.length() as u8;
            raw.flags = if brs { CANFD_BRS } else { 0 } | if esi { CANFD_ESI } else { 0 };
            raw.data[..frame.data().len()].copy_from_slice(frame.data());
            raw.into()
        }
        _ => {
            let mut raw = can_frame_default();
            raw.can_id = frame.word();
            raw.can_dlc = frame.length() as u8;
            raw.data[..frame.data().len()].copy_from_slice(frame.data());
            raw.into()
        }
    }
}

impl Bus for SocketCan {
    fn receive(&mut self) -> Result<Option<Frame>, BusError> {
        loop {
            let raw = match self.socket.read_raw_frame() {
                Ok(raw) => raw,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(None),
                Err(error) if matches!(error.kind(), ErrorKind::Interrupted | ErrorKind::InvalidData) => {
                    continue;
                }
                Err(error) => return Err(refusal(&self.bus, &self.interface, error)),
            };
            let Some(frame) = of_raw(raw) else { continue };
            self.controller.note(&frame);
            // The kernel's filter is a little wider.
            if frame.kind() == Kind::Error || self.wanted.contain(frame.id()) {
                return Ok(Some(frame));
            }
        }
    }

    fn send(&mut self, frame: &Frame) -> Result<Sent, BusError> {
        if !frame.is_of_the_bus() {
            return Ok(Sent::Refused);
        }
        // The kernel would take it and throw it away without a word.
        if self.controller.state == BusState::Off {
            return Ok(Sent::Full);
        }
        let raw = raw_of(frame);
        debug_assert_eq!(raw.size(), if frame.is_fd() { 72 } else { 16 });
        let Err(error) = self.socket.write_frame(&raw) else { return Ok(Sent::Taken) };
        match error.raw_os_error().map(Errno::from_raw_os_error) {
            Some(Errno::AGAIN | Errno::NOBUFS | Errno::INTR) => Ok(Sent::Full),
            // An FD frame on an interface whose frames are classic.
            Some(Errno::INVAL | Errno::MSGSIZE) => Ok(Sent::Refused),
            _ => Err(refusal(&self.bus, &self.interface, error)),
        }
    }

    fn readable(&self) -> Option<BorrowedFd<'_>> {
        Some(self.socket.as_fd())
    }

    fn state(&self) -> BusState {
        self.controller.state
    }

    fn tend(&mut self, now_ns: u64) -> Result<(), BusError> {
        self.controller.now_ns = now_ns;
        self.controller.recovery.tend(now_ns, &self.bus, || restart(&self.interface));
        Ok(())
    }

    fn due_ns(&self) -> u64 {
        self.controller.recovery.due_ns()
    }

    fn losses(&self) -> Losses {
        Losses { unkept: drops::count(&self.socket), denied: 0 }
    }

    fn complaint(&mut self) -> Option<String> {
        self.controller.recovery.complaint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Id, any};
    use proptest::prelude::*;

    #[test]
    fn the_systems_answers_are_told_apart() {
        let said = |errno: Errno| refusal("socketcan:can0", "can0", errno.into()).to_string();
        assert!(said(Errno::AFNOSUPPORT).contains("no CAN sockets"));
        assert!(said(Errno::NETDOWN).contains("ip link set can0 up"));
        assert!(said(Errno::PERM).contains("network = true"));
        assert!(said(Errno::IO).contains("socketcan:can0"));
    }

    #[test]
    fn a_report_that_the_controller_is_off_the_bus_is_read_as_the_kernel_writes_it() {
        let mut raw = can_frame_default();
        (raw.can_id, raw.can_dlc) = (ERROR_FLAG | CLASS_BUS_OFF, 8);
        let frame = of_raw(CanRawFrame::from(raw)).unwrap();
        assert_eq!((frame.kind(), frame.word() & CLASS_BUS_OFF), (Kind::Error, CLASS_BUS_OFF));
        assert_eq!(frame.id(), Id::Extended(CLASS_BUS_OFF));
    }

    #[test]
    fn a_frame_that_is_heard_ends_bus_off_where_the_report_of_the_restart_was_lost() {
        let mut controller = Controller::new();
        let report = |class: u32| {
            let mut raw = can_frame_default();
            (raw.can_id, raw.can_dlc) = (ERROR_FLAG | class, 8);
            of_raw(CanRawFrame::from(raw)).unwrap()
        };
        controller.note(&report(CLASS_BUS_OFF));
        controller.note(&report(CLASS_CONTROLLER));
        assert_eq!(controller.state, BusState::Off, "a report of another kind is no frame of the bus");
        assert_ne!(controller.recovery.due_ns(), u64::MAX);
        controller.note(&Frame::classic(Id::Standard(0x123), &[1]));
        assert_eq!((controller.state, controller.recovery.due_ns()), (BusState::Active, u64::MAX));
    }

    proptest! {
        #[test]
        fn frames_are_the_same_before_and_after_the_kernels_form(frame in any::frame()) {
            let raw = match raw_of(&frame) {
                CanAnyFrame::Fd(fd) => CanRawFrame::from(*fd.as_ref()),
                CanAnyFrame::Normal(data) => CanRawFrame::from(*data.as_ref()),
                CanAnyFrame::Remote(remote) => CanRawFrame::from(*remote.as_ref()),
                CanAnyFrame::Error(error) => CanRawFrame::from(*error.as_ref()),
            };
            prop_assert_eq!(of_raw(raw), Some(frame));
        }
    }
}
