//! The types of a folder in a program.
#![allow(clippy::unwrap_used)]

use bateleur_message_format::zerocopy::{FromBytes, IntoBytes};
use bateleur_message_format::{Catalogue, Message, Scalar, Source, describe, layout_of};

mod types {
    bateleur_message_macro::messages!(bateleur_message_format, "tests/messages");
}
use types::acme::Echo;
use types::{Place, Radar};

fn catalogue() -> Catalogue {
    let source = |(name, text): &(&str, &str)| Source {
        name: (*name).to_owned(),
        file: (*name).to_owned(),
        text: (*text).to_owned(),
    };
    Catalogue::read(types::MESSAGE_SOURCES.iter().map(source)).unwrap()
}

#[test]
fn program_and_text_have_one_layout() {
    let catalogue = catalogue();
    for (name, size, fields) in [
        (Radar::NAME, size_of::<Radar>(), Radar::FIELDS),
        (Echo::NAME, size_of::<Echo>(), Echo::FIELDS),
        (Place::NAME, size_of::<Place>(), Place::FIELDS),
    ] {
        let of = catalogue.find(name).unwrap();
        assert_eq!((of.size(), of.layout()), (size, layout_of(fields)), "{name}");
        assert_eq!(of.describe(), describe(fields));
    }
    assert_eq!((Radar::NAME, Echo::NAME), ("Radar", "acme/Echo"));
}

#[test]
fn value_of_a_program_is_read_by_its_path() {
    let mut radar = Radar { mode: Radar::MODE_SWEEP, r#type: 3, ..Radar::default() };
    radar.echoes[1] = Echo { closing: -40, at: Place { position: [1.0, 2.0, -30.5] }, ..Echo::default() };
    let of = catalogue();
    let of = of.find("Radar").unwrap();
    for (path, value) in [
        ("mode", Scalar::Whole(7)),
        ("type", Scalar::Whole(3)),
        ("echoes[1].closing", Scalar::Whole(-40)),
        ("echoes[1].at.position[2]", Scalar::Real(-30.5)),
    ] {
        assert_eq!(of.get(radar.as_bytes(), path), Ok(Some(value)), "{path}");
    }
    assert_eq!(Radar::read_from_bytes(radar.as_bytes()).unwrap(), radar);
    assert_eq!((Radar::TURN.to_bits(), Radar::MODE_OFF), (0.1_f64.to_bits(), 0));
}
