//! A CAN frame, classic or FD, and what of it decides arbitration and length on the wire.

use std::fmt;

/// The longest data of a classic frame, bytes.
pub const CLASSIC_BYTES: usize = 8;
/// The longest data of an FD frame, bytes.
pub const FD_BYTES: usize = 64;

/// Flag of Linux in an identifier word: 29 bits.
pub const EXTENDED_FLAG: u32 = 0x8000_0000;
/// Flag of Linux in an identifier word: remote frame.
pub const REMOTE_FLAG: u32 = 0x4000_0000;
/// Flag of Linux in an identifier word: no frame of the bus, but an error that the controller tells.
pub const ERROR_FLAG: u32 = 0x2000_0000;

const STANDARD_MASK: u32 = 0x7ff;
const EXTENDED_MASK: u32 = 0x1fff_ffff;

/// An identifier: lower numbers win the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Id {
    /// 11 bits.
    Standard(u16),
    /// 29 bits.
    Extended(u32),
}

impl Id {
    /// A standard identifier; none above 0x7ff.
    pub fn standard(id: u32) -> Option<Self> {
        (id <= STANDARD_MASK).then_some(Self::Standard(id as u16))
    }

    /// An extended identifier; none above 0x1fffffff.
    pub fn extended(id: u32) -> Option<Self> {
        (id <= EXTENDED_MASK).then_some(Self::Extended(id))
    }

    /// The number alone.
    pub fn number(self) -> u32 {
        match self {
            Self::Standard(id) => id.into(),
            Self::Extended(id) => id,
        }
    }
}

/// As other programs write it: three hexadecimal digits, or eight.
impl fmt::Display for Id {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Standard(id) => write!(f, "{id:03X}"),
            Self::Extended(id) => write!(f, "{id:08X}"),
        }
    }
}

/// What sort of frame it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Classic, with data.
    Data,
    /// Classic, asks for data; its length is that of the answer.
    Remote,
    /// CAN FD.
    Fd {
        /// Bit-rate switch: the data went at the second rate.
        brs: bool,
        /// Error state indicator: its sender is error passive.
        esi: bool,
    },
    /// Not of the bus: what the controller tells of errors, in the words of Linux (the identifier holds the classes).
    Error,
}

/// Why there is no such frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// The length is none of this kind's.
    #[error(
        "a frame of this kind can not hold {0} bytes: classic 0 to 8; FD 0 to 8, 12, 16, 20, 24, 32, 48, 64"
    )]
    Length(usize),
    /// The identifier has too many bits.
    #[error("{0:#x} is no identifier: at most 0x7ff standard, 0x1fffffff extended")]
    Id(u32),
    /// Flags that exclude each other.
    #[error("{0:#x} says remote or error of a frame that can be neither")]
    Flags(u32),
}

/// One frame.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct Frame {
    id: Id,
    kind: Kind,
    length: u8,
    data: [u8; FD_BYTES],
}

impl Frame {
    /// A frame with data.
    ///
    /// # Errors
    /// A length that the kind does not have.
    pub fn new(id: Id, kind: Kind, data: &[u8]) -> Result<Self, FrameError> {
        let fits = match kind {
            Kind::Fd { .. } => is_fd_length(data.len()),
            Kind::Remote => data.is_empty(),
            Kind::Data | Kind::Error => data.len() <= CLASSIC_BYTES,
        };
        if !fits {
            return Err(FrameError::Length(data.len()));
        }
        let mut frame = Self { id, kind, length: data.len() as u8, data: [0; FD_BYTES] };
        frame.data[..data.len()].copy_from_slice(data);
        Ok(frame)
    }

    /// A classic data frame with at most 8 bytes; longer data are cut.
    pub fn classic(id: Id, data: &[u8]) -> Self {
        let length = data.len().min(CLASSIC_BYTES);
        let mut frame = Self { id, kind: Kind::Data, length: length as u8, data: [0; FD_BYTES] };
        frame.data[..length].copy_from_slice(&data[..length]);
        frame
    }

    /// A remote frame that asks for `length` bytes.
    ///
    /// # Errors
    /// More than 8.
    pub fn remote(id: Id, length: usize) -> Result<Self, FrameError> {
        match length {
            0..=CLASSIC_BYTES => {
                Ok(Self { id, kind: Kind::Remote, length: length as u8, data: [0; FD_BYTES] })
            }
            _ => Err(FrameError::Length(length)),
        }
    }

    /// A frame from an identifier with the flags of Linux, for a kind that says whether it is FD. `length` counts for a
    /// remote frame, whose data are empty.
    ///
    /// # Errors
    /// An identifier, a length or flags that can not be.
    pub fn of_word(
        word: u32,
        fd: Option<(bool, bool)>,
        length: usize,
        data: &[u8],
    ) -> Result<Self, FrameError> {
        let number = word & EXTENDED_MASK;
        let id = match word & EXTENDED_FLAG != 0 {
            true => Id::extended(number),
            // The classes of an error stand where an identifier would, and need all bits.
            false if word & ERROR_FLAG != 0 => Id::extended(number),
            false => Id::standard(number),
        };
        let id = id.ok_or(FrameError::Id(number))?;
        let kind = match (fd, word & REMOTE_FLAG != 0, word & ERROR_FLAG != 0) {
            (Some((brs, esi)), false, false) => Kind::Fd { brs, esi },
            (None, false, false) => Kind::Data,
            (None, true, false) => return Self::remote(id, length),
            (None, false, true) => Kind::Error,
            _ => return Err(FrameError::Flags(word)),
        };
        Self::new(id, kind, data)
    }

    /// The identifier.
    pub fn id(&self) -> Id {
        self.id
    }

    /// The sort.
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// The data; none of a remote frame.
    pub fn data(&self) -> &[u8] {
        match self.kind {
            Kind::Remote => &[],
            _ => &self.data[..usize::from(self.length)],
        }
    }

    /// Length in bytes; of a remote frame, what it asks for.
    pub fn length(&self) -> usize {
        self.length.into()
    }

    /// CAN FD.
    pub fn is_fd(&self) -> bool {
        matches!(self.kind, Kind::Fd { .. })
    }

    /// What a bus carries: anything but the controller's own reports.
    pub fn is_of_the_bus(&self) -> bool {
        self.kind != Kind::Error
    }

    /// Identifier and flags as Linux has them in one word.
    pub fn word(&self) -> u32 {
        let flags = match self.kind {
            Kind::Remote => REMOTE_FLAG,
            Kind::Error => return self.id.number() | ERROR_FLAG,
            Kind::Data | Kind::Fd { .. } => 0,
        };
        match self.id {
            Id::Standard(id) => u32::from(id) | flags,
            Id::Extended(id) => id | EXTENDED_FLAG | flags,
        }
    }

    /// What arbitration compares, in the order of the bits on the wire: the smaller one wins the bus (ISO 11898-1).
    /// Eleven bits; remote or substitute bit; identifier extension bit; eighteen bits; remote bit. Reports of errors
    /// come before all of the bus.
    pub fn priority(&self) -> u64 {
        let remote = u64::from(self.kind == Kind::Remote);
        let wire = match self.id {
            Id::Standard(id) => u64::from(id) << 21 | remote << 20,
            Id::Extended(id) => {
                let (base, rest) = (u64::from(id) >> 18, u64::from(id) & 0x3_ffff);
                base << 21 | 1 << 20 | 1 << 19 | rest << 1 | remote
            }
        };
        if self.is_of_the_bus() { wire + 1 } else { 0 }
    }
}

/// As candump writes it: `123#0102`, `123#R4`, `123##1AABB`.
impl fmt::Display for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.kind {
            // An error keeps its flag in the number, with eight digits.
            Kind::Error => write!(f, "{:08X}#", self.word())?,
            Kind::Data => write!(f, "{}#", self.id)?,
            Kind::Remote if self.length == 0 => return write!(f, "{}#R", self.id),
            Kind::Remote => return write!(f, "{}#R{}", self.id, self.length),
            Kind::Fd { brs, esi } => write!(f, "{}##{:X}", self.id, u8::from(brs) | u8::from(esi) << 1)?,
        }
        self.data().iter().try_for_each(|byte| write!(f, "{byte:02X}"))
    }
}

impl fmt::Debug for Frame {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{self}")
    }
}

/// Whether an FD frame can have so many bytes.
pub fn is_fd_length(length: usize) -> bool {
    matches!(length, 0..=8 | 12 | 16 | 20 | 24 | 32 | 48 | 64)
}

#[cfg(test)]
pub(crate) mod any {
    //! Frames for property tests.

    use super::*;
    use proptest::prelude::*;

    /// Any identifier.
    pub(crate) fn id() -> impl Strategy<Value = Id> {
        prop_oneof![(0_u16..=0x7ff).prop_map(Id::Standard), (0_u32..=EXTENDED_MASK).prop_map(Id::Extended)]
    }

    /// Any classic frame of a bus.
    pub(crate) fn classic() -> impl Strategy<Value = Frame> {
        let data = (id(), proptest::collection::vec(any::<u8>(), 0..=8))
            .prop_map(|(id, data)| Frame::classic(id, &data));
        let remote = (id(), 0_usize..=8).prop_map(|(id, length)| Frame::remote(id, length).unwrap());
        prop_oneof![4 => data, 1 => remote]
    }

    /// Any frame of a bus.
    pub(crate) fn frame() -> impl Strategy<Value = Frame> {
        let lengths = prop::sample::select(vec![0_usize, 1, 5, 8, 12, 16, 20, 24, 32, 48, 64]);
        let fd = (id(), any::<bool>(), any::<bool>(), any::<u8>(), lengths).prop_map(
            |(id, brs, esi, seed, length)| {
                let data: Vec<u8> =
                    (0..length).map(|place| seed.wrapping_mul(31).wrapping_add(place as u8)).collect();
                Frame::new(id, Kind::Fd { brs, esi }, &data).unwrap()
            },
        );
        prop_oneof![3 => classic(), 1 => fd]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn standard(id: u16) -> Frame {
        Frame::classic(Id::Standard(id), &[])
    }

    #[test]
    fn arbitration_is_in_the_order_of_the_bits_on_the_wire() {
        let extended = |id| Frame::classic(Id::Extended(id), &[]);
        let remote = Frame::remote(Id::Standard(0x100), 0).unwrap();
        let error = Frame::new(Id::Extended(0x40), Kind::Error, &[0; 8]).unwrap();
        // The extended 0x100 << 18 has the same first eleven bits as the standard 0x100 and loses to it and to its remote.
        let order = [
            error,
            standard(0xff),
            standard(0x100),
            remote,
            extended(0x100 << 18),
            extended((0x100 << 18) + 1),
            standard(0x101),
        ];
        assert!(order.windows(2).all(|pair| pair[0].priority() < pair[1].priority()));
    }

    #[test]
    fn lengths_and_flags_that_no_frame_has_are_refused() {
        let id = Id::Standard(1);
        assert_eq!(Frame::new(id, Kind::Data, &[0; 9]), Err(FrameError::Length(9)));
        assert_eq!(Frame::new(id, Kind::Fd { brs: true, esi: false }, &[0; 9]), Err(FrameError::Length(9)));
        assert!(Frame::new(id, Kind::Fd { brs: true, esi: false }, &[0; 12]).is_ok());
        assert_eq!(Frame::of_word(0x800, None, 0, &[]), Err(FrameError::Id(0x800)));
        let remote_fd = Frame::of_word(REMOTE_FLAG | 1, Some((false, false)), 0, &[]);
        assert_eq!(remote_fd, Err(FrameError::Flags(REMOTE_FLAG | 1)));
        assert_eq!(Frame::remote(id, 9), Err(FrameError::Length(9)));
    }

    #[test]
    fn frames_are_written_as_candump_does() {
        assert_eq!(Frame::classic(Id::Standard(0x123), &[1, 0xab]).to_string(), "123#01AB");
        assert_eq!(Frame::classic(Id::Extended(0x123), &[]).to_string(), "00000123#");
        assert_eq!(Frame::remote(Id::Standard(0x123), 4).unwrap().to_string(), "123#R4");
        let fd = Frame::new(Id::Standard(0x321), Kind::Fd { brs: true, esi: true }, &[0xaa]).unwrap();
        assert_eq!(fd.to_string(), "321##3AA");
    }

    proptest! {
        #[test]
        fn a_frame_comes_back_from_its_word(frame in any::frame()) {
            let fd = match frame.kind() { Kind::Fd { brs, esi } => Some((brs, esi)), _ => None };
            prop_assert_eq!(Frame::of_word(frame.word(), fd, frame.length(), frame.data()), Ok(frame));
        }
    }
}
