//! What a message is made of, so that tools can name its values without its Rust type.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// A message that a port can carry: plain data, every bit pattern valid, no padding.
pub trait Message: FromBytes + IntoBytes + Immutable + KnownLayout + Copy + Send + 'static {
    /// The name that `schedule.toml` uses.
    const NAME: &'static str;
    /// The fields in the order of their bytes.
    const FIELDS: &'static [Field];
}

/// One field of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// The field's name, with its unit.
    pub name: &'static str,
    /// The kind of each element.
    pub kind: FieldKind,
    /// Elements: 1 for a plain value.
    pub count: usize,
    /// Bytes from the start of the message.
    pub offset: usize,
}

/// A number that differs where the fields differ, in name, kind, count or place: programs that were built from different messages of
/// one name and size would read wrong values (FNV-1a, 32 bits).
pub fn layout_of(fields: &[Field]) -> u32 {
    let numbers = |field: &Field| [field.kind as u64, field.count as u64, field.offset as u64];
    let bytes = fields.iter().flat_map(|field| {
        let numbers = numbers(field).into_iter().flat_map(u64::to_le_bytes);
        field.name.bytes().chain([0]).chain(numbers)
    });
    bytes.fold(0x811c_9dc5, |hash: u32, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193))
}

/// The closed set of element kinds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FieldKind {
    /// Unsigned, 8 bits.
    U8,
    /// Unsigned, 16 bits.
    U16,
    /// Unsigned, 32 bits.
    U32,
    /// Unsigned, 64 bits.
    U64,
    /// IEEE 754 binary64.
    F64,
}

impl FieldKind {
    /// Bytes of one element.
    pub const fn size(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 => 2,
            Self::U32 => 4,
            Self::U64 | Self::F64 => 8,
        }
    }

    /// The kind's name in a ROS 2 message definition, which log viewers read.
    pub const fn ros2_name(self) -> &'static str {
        match self {
            Self::U8 => "uint8",
            Self::U16 => "uint16",
            Self::U32 => "uint32",
            Self::U64 => "uint64",
            Self::F64 => "float64",
        }
    }
}

/// A Rust type that may stand in a message.
pub trait FieldType {
    /// The kind of each element.
    const KIND: FieldKind;
    /// Elements.
    const COUNT: usize;
}

macro_rules! field_types {
    ($($rust:ty => $kind:ident),*) => {
        $(
            impl FieldType for $rust {
                const KIND: FieldKind = FieldKind::$kind;
                const COUNT: usize = 1;
            }
            impl<const N: usize> FieldType for [$rust; N] {
                const KIND: FieldKind = FieldKind::$kind;
                const COUNT: usize = N;
            }
        )*
    };
}
field_types!(u8 => U8, u16 => U16, u32 => U32, u64 => U64, f64 => F64);

/// Declares a message: the structure, its layout rules and the table of its fields.
macro_rules! message {
    ($(#[$about:meta])* pub struct $name:ident { $($(#[$note:meta])* pub $field:ident: $kind:ty,)* }) => {
        $(#[$about])*
        #[derive(
            Debug, Clone, Copy, PartialEq,
            ::zerocopy::FromBytes, ::zerocopy::IntoBytes, ::zerocopy::Immutable, ::zerocopy::KnownLayout,
        )]
        #[repr(C)]
        pub struct $name { $($(#[$note])* pub $field: $kind,)* }

        impl Default for $name {
            fn default() -> Self {
                <Self as ::zerocopy::FromZeros>::new_zeroed()
            }
        }

        impl $crate::Message for $name {
            const NAME: &'static str = stringify!($name);
            const FIELDS: &'static [$crate::Field] = &[$($crate::Field {
                name: stringify!($field),
                kind: <$kind as $crate::FieldType>::KIND,
                count: <$kind as $crate::FieldType>::COUNT,
                offset: ::std::mem::offset_of!($name, $field),
            },)*];
        }
    };
}
pub(crate) use message;
