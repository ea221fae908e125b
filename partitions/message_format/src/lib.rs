//! Message types as text: read, laid out, and turned into field tables, Rust and C.
//!
//! Responsible for: the language of message types (the part of ROS 2's `.msg` whose length is fixed), the layout of a type in
//! memory, its values by the names of fields, and the sources that are made of it. It must never know a port, a partition, or
//! one particular type.
//!
//! A [`Catalogue`] is read from texts; what is wrong with them is reported all at once ([`Faults`]), with file, line and column.
//! A [`Type`] of it has no padding, so its bytes in memory (`repr(C)`, little endian) are the same on every processor that is
//! supported, and the same that CDR makes of it.

#[cfg(target_endian = "big")]
compile_error!("port messages are shared as they lie in memory, little endian");

mod c;
mod catalogue;
mod fault;
mod field;
mod folder;
mod layout;
mod print;
mod rust;
mod scalar;
mod syntax;
mod value;
mod words;

pub use c::{c_name, header};
pub use catalogue::{Catalogue, Source};
pub use fault::{Fault, Faults};
pub use field::{Field, FieldKind, Message, describe, layout_of};
pub use folder::sources;
pub use layout::{Body, Leaf, Member, Type};
pub use rust::{Paths, rust, structure};
pub use scalar::Scalar;
pub use syntax::Constant;
pub use value::{PathError, Place};
pub use words::{PACKAGE, rust_name, schema_name, type_name_of_schema};
/// What the types that are made of a text derive their traits from.
pub use zerocopy;

/// Bounds on what is read, so that a text that is wrong, or was made to do harm, takes little memory and time.
pub mod bounds {
    /// The longest text of one type, bytes.
    pub const FILE_BYTES: usize = 256 << 10;
    /// Most types of a catalogue.
    pub const TYPES: usize = 2048;
    /// Most fields, and most constants, of one type.
    pub const ITEMS: usize = 1024;
    /// The longest name of a type, package included, bytes.
    pub const NAME_BYTES: usize = 60;
    /// The longest name of a field or a constant, bytes.
    pub const FIELD_NAME_BYTES: usize = 60;
    /// The longest message, bytes: eight times what an APEX port carries.
    pub const MESSAGE_BYTES: usize = 64 << 10;
    /// Types within types, most.
    pub const DEPTH: usize = 8;
    /// Entries of a type's field table: each element of an array of types has its own.
    pub const LEAVES: usize = 4096;
}
