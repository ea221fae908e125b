//! The messages that travel through ports and over the links to the simulator and the ground.
//!
//! Responsible for: the layout of every message, a table of its fields (so that a log or a command line can
//! show values by name), and the byte protocols of the serial line and of the simulator link. It must never
//! know a partition, a port or a clock.
//!
//! The layouts are the files `msg/*.msg`, and `msg/packet/*.msg` of what travels over links alone; what the language means stands in
//! `bateleur-message-format`. Names carry units; SI and radians throughout. The Rust files, one a subject, have what is not layout.

use std::sync::{Arc, LazyLock};

pub mod control;
pub mod frame;
pub mod ground;
pub mod hil;
pub mod link;
pub mod mark;
pub mod parameter;
pub mod rate;
pub mod state;
pub mod telemetry;

pub use bateleur_message_format as format;
pub use bateleur_message_format::{Catalogue, Field, FieldKind, Message, Source, Type, layout_of};
pub use rate::Watch;

bateleur_message_macro::messages!(bateleur_message_format, "msg");

/// The texts of the flight's types, with the names of their files.
pub fn sources() -> impl Iterator<Item = Source> {
    MESSAGE_SOURCES.iter().map(|(name, text)| Source {
        name: (*name).to_owned(),
        file: format!("the flight's own {name}.msg"),
        text: (*text).to_owned(),
    })
}

/// The flight's types.
#[must_use]
pub fn catalogue() -> &'static Catalogue {
    // The macro has read the same texts, or this would not compile.
    static CATALOGUE: LazyLock<Catalogue> = LazyLock::new(|| Catalogue::read(sources()).unwrap_or_default());
    &CATALOGUE
}

/// The type of the flight called `name`, exactly as written.
#[must_use]
pub fn find(name: &str) -> Option<&'static Arc<Type>> {
    catalogue().find(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_and_structures_have_one_layout() {
        fn check<T: Message>() {
            let of = find(T::NAME).unwrap();
            assert_eq!((of.size(), of.layout()), (size_of::<T>(), layout_of(T::FIELDS)), "{}", T::NAME);
        }
        check::<State>();
        check::<LinkStatus>();
        check::<packet::HealthText>();
        assert_eq!(catalogue().types().count(), MESSAGE_SOURCES.len());
    }
}
