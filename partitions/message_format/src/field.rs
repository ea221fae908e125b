//! What a message is made of, known to the program that was built with it.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// A message that a port can carry: plain data, every bit pattern valid, no padding.
pub trait Message: FromBytes + IntoBytes + Immutable + KnownLayout + Copy + Send + 'static {
    /// The name that the schedule file uses.
    const NAME: &'static str;
    /// The fields in the order of their bytes; those of a type within it are called by their path, such as `pose.height`.
    const FIELDS: &'static [Field];
}

/// One field of a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    /// The field's name.
    pub name: &'static str,
    /// The unit of its values; empty: none is given.
    pub unit: &'static str,
    /// The kind of each element.
    pub kind: FieldKind,
    /// Elements: 1 for a plain value.
    pub count: usize,
    /// Bytes from the start of the message.
    pub offset: usize,
}

/// A number that differs where the fields differ, in name, unit, kind, count or place: programs that were built from different
/// messages of one name and size would read wrong values (FNV-1a, 32 bits). Never 0, which says that the fields are not known.
#[must_use]
pub fn layout_of(fields: &[Field]) -> u32 {
    digest(fields.iter().map(|field| (field.name, field.unit, field.kind, field.count, field.offset)))
}

pub(crate) fn digest<'a>(fields: impl Iterator<Item = (&'a str, &'a str, FieldKind, usize, usize)>) -> u32 {
    let bytes = fields.flat_map(|(name, unit, kind, count, offset)| {
        let numbers = [kind as u64, count as u64, offset as u64].into_iter().flat_map(u64::to_le_bytes);
        name.bytes().chain([0]).chain(unit.bytes()).chain([0]).chain(numbers)
    });
    let hash = bytes.fold(0x811c_9dc5, |hash: u32, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193));
    hash.max(1)
}

/// A field table for a person: a line for each field with its place, kind, name and unit.
#[must_use]
pub fn describe(fields: &[Field]) -> String {
    let line = |field: &Field| line(field.name, field.unit, field.kind, field.count, field.offset);
    fields.iter().map(line).collect()
}

pub(crate) fn line(name: &str, unit: &str, kind: FieldKind, count: usize, offset: usize) -> String {
    let array = if count == 1 { String::new() } else { format!("[{count}]") };
    let unit = if unit.is_empty() { String::new() } else { format!(" [{unit}]") };
    format!("  {offset:>5}  {}{array} {name}{unit}\n", kind.ros2_name())
}

macro_rules! kinds {
    ($($(#[$about:meta])* $kind:ident $ros2:literal $rust:literal $c:literal $size:literal),* $(,)?) => {
        /// The closed set of element kinds.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum FieldKind { $($(#[$about])* $kind),* }

        impl FieldKind {
            /// All of them.
            pub const ALL: &'static [Self] = &[$(Self::$kind),*];

            /// Bytes of one element, which are its alignment too.
            #[must_use]
            pub const fn size(self) -> usize {
                match self { $(Self::$kind => $size),* }
            }

            /// The kind's name in a ROS 2 message definition, which log viewers read.
            #[must_use]
            pub const fn ros2_name(self) -> &'static str {
                match self { $(Self::$kind => $ros2),* }
            }

            /// The kind's type in Rust.
            #[must_use]
            pub const fn rust_name(self) -> &'static str {
                match self { $(Self::$kind => $rust),* }
            }

            /// The kind's type in C.
            #[must_use]
            pub const fn c_name(self) -> &'static str {
                match self { $(Self::$kind => $c),* }
            }

            /// The kind's name in [`FieldKind`].
            #[must_use]
            pub const fn variant(self) -> &'static str {
                match self { $(Self::$kind => stringify!($kind)),* }
            }
        }
    };
}
kinds! {
    /// Unsigned, 8 bits.
    U8 "uint8" "u8" "uint8_t" 1,
    /// Unsigned, 16 bits.
    U16 "uint16" "u16" "uint16_t" 2,
    /// Unsigned, 32 bits.
    U32 "uint32" "u32" "uint32_t" 4,
    /// Unsigned, 64 bits.
    U64 "uint64" "u64" "uint64_t" 8,
    /// IEEE 754 binary64.
    F64 "float64" "f64" "double" 8,
    /// Two's complement, 8 bits.
    I8 "int8" "i8" "int8_t" 1,
    /// Two's complement, 16 bits.
    I16 "int16" "i16" "int16_t" 2,
    /// Two's complement, 32 bits.
    I32 "int32" "i32" "int32_t" 4,
    /// Two's complement, 64 bits.
    I64 "int64" "i64" "int64_t" 8,
    /// IEEE 754 binary32.
    F32 "float32" "f32" "float" 4,
    /// A byte of which every value but 0 is true. Rust and C see the byte: a `bool` of theirs has two values only.
    Bool "bool" "u8" "uint8_t" 1,
}

impl FieldKind {
    /// The kind that a message definition calls so; `byte` and `char` are other words for `uint8`, as in ROS 2.
    #[must_use]
    pub fn named(word: &str) -> Option<Self> {
        match word {
            "byte" | "char" => Some(Self::U8),
            _ => Self::ALL.iter().copied().find(|kind| kind.ros2_name() == word),
        }
    }

    /// The least and the greatest value of a kind that counts.
    #[must_use]
    pub const fn range(self) -> Option<(i128, i128)> {
        let bits = 8 * self.size() as u32;
        match self {
            Self::F32 | Self::F64 => None,
            Self::Bool => Some((0, 1)),
            Self::U8 | Self::U16 | Self::U32 | Self::U64 => Some((0, (1 << bits) - 1)),
            Self::I8 | Self::I16 | Self::I32 | Self::I64 => Some((-(1 << (bits - 1)), (1 << (bits - 1)) - 1)),
        }
    }
}
