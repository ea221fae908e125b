//! Texts, right and wrong.
#![allow(clippy::panic, clippy::unwrap_used)]

mod common;

use bateleur_message_format::{Catalogue, FieldKind, Scalar, Source, Type, bounds, sources};
use proptest::prelude::*;

fn source(name: &str, text: &str) -> Source {
    Source { name: name.to_owned(), file: format!("{name}.msg"), text: text.to_owned() }
}

fn one(text: &str) -> Result<Type, String> {
    let catalogue = Catalogue::read([source("T", text)]).map_err(|faults| faults.to_string())?;
    Ok(Type::clone(catalogue.find("T").unwrap()))
}

const RADAR: &str = "\
# What a radar sees.

uint64 measured_ns    # [ns] Module time of the sweep.
# How it works.
uint32 mode           # [@enum MODE]
uint32 MODE_OFF = 0
uint32 MODE_SWEEP = 7 # Around.
uint32 count
Echo[2] echoes        # What came back, the nearest first.
bateleur/Place own
";
const ECHO: &str = "float32 range   # [m]\nint16 closing # [cm/s]\nbool[2] valid\n";
const PLACE: &str = "float64[3] position # [m] North, east, down.\n";

fn radar() -> Type {
    let sources = [source("acme/Radar", RADAR), source("acme/Echo", ECHO), source("Place", PLACE)];
    Type::clone(Catalogue::read(sources).unwrap().find("acme/Radar").unwrap())
}

#[test]
fn field_table_has_places_units_and_names_of_values() {
    let radar = radar();
    assert_eq!((radar.size(), radar.align(), radar.text()), (56, 8, "What a radar sees."));
    let table: Vec<_> =
        radar.leaves().iter().map(|leaf| (leaf.path.as_str(), leaf.offset, leaf.unit.as_str())).collect();
    assert_eq!(
        table[..5],
        [
            ("measured_ns", 0, "ns"),
            ("mode", 8, ""),
            ("count", 12, ""),
            ("echoes[0].range", 16, "m"),
            ("echoes[0].closing", 20, "cm/s"),
        ]
    );
    assert_eq!(table[8..], [("echoes[1].valid", 30, ""), ("own.position", 32, "m")]);
    let mode = &radar.leaves()[1];
    assert_eq!((mode.choice(Scalar::Whole(7)), mode.choice(Scalar::Whole(1))), (Some("SWEEP"), None));
    assert_eq!(radar.members()[1].text, "How it works.");
}

#[test]
fn values_are_written_and_read_by_path() {
    let radar = radar();
    let mut bytes = vec![0; radar.size()];
    for (path, value) in [("echoes[1].closing", Scalar::Whole(-3)), ("own.position[2]", Scalar::Real(-9.5))] {
        assert_eq!(radar.set(&mut bytes, path, value), Ok(Some(())));
        assert_eq!(radar.get(&bytes, path), Ok(Some(value)));
    }
    assert_eq!(bytes[28..30], (-3_i16).to_le_bytes());
    assert_eq!(radar.set(&mut bytes, "echoes[0].closing", Scalar::Whole(40_000)), Ok(None));
    let columns: Vec<String> = radar.columns().collect();
    let numbers: Vec<Scalar> = radar.numbers(&bytes).unwrap().collect();
    assert_eq!(columns.len(), numbers.len());
    let closing = columns.iter().position(|column| column == "echoes[1].closing").unwrap();
    assert_eq!(numbers[closing], Scalar::Whole(-3));
    assert!(radar.numbers(&bytes[1..]).is_none());
    for (path, words) in [
        ("own", "own of acme/Radar is a Place: write one of its fields behind it, such as own.position"),
        ("echoes.range", "echoes of acme/Radar has 2 elements: write echoes[0]"),
        ("echoes[2].range", "echoes of acme/Radar has 2 elements"),
        ("mode.x", "mode of acme/Radar is a number"),
        ("echos[0].range", "acme/Radar has no field echos; did you mean echoes?"),
    ] {
        let said = radar.place(path).unwrap_err().to_string();
        assert!(said.contains(words), "{path}: {said}");
    }
}

#[test]
fn schema_of_a_log_reads_back_as_the_type() {
    let radar = radar();
    let schema = radar.schema();
    assert!(schema.contains("MSG: acme/Echo\n") && schema.contains("MSG: bateleur/Place\n"), "{schema}");
    assert_eq!(Type::from_schema("acme/Radar", &schema).unwrap(), radar);
}

#[test]
fn layout_differs_with_name_unit_kind_count_and_place() {
    let texts = [
        "float64 x # [m]\nfloat64 y",
        "float64 y # [m]\nfloat64 x",
        "float64 x # [rad]\nfloat64 y",
        "float64 x\nfloat64 y",
        "uint64 x # [m]\nfloat64 y",
        "float64[2] x # [m]",
        "float64 y\nfloat64 x # [m]",
    ];
    let mut layouts: Vec<u32> = texts.iter().map(|text| one(text).unwrap().layout()).collect();
    layouts.sort_unstable();
    layouts.dedup();
    assert_eq!(layouts.len(), texts.len());
    let (plain, told) = (one("float64 x").unwrap(), one("float64 x # A height.").unwrap());
    assert_eq!(plain.layout(), told.layout(), "a text changes no value");
}

#[test]
fn every_fault_has_its_place_and_the_mend() {
    for (text, place, words) in [
        ("", "1:1", "T has no field"),
        ("float64 x y", "1:11", "`y` behind the name `x`"),
        ("float64 x 1.5", "1:11", "a field has no default"),
        ("\n  flaot64 x", "2:3", "did you mean `float64`?"),
        ("float64", "1:1", "`float64` has no name behind it"),
        ("string name", "1:1", "write `uint8[N]`"),
        ("uint8[] data", "1:1", "`uint8[]` has no fixed length: write how many there are at most"),
        ("uint8[<=4] data", "1:1", "has no fixed length"),
        ("uint8[0] data", "1:1", "has no fixed length"),
        ("uint8[99999999999999999999] data", "1:1", "has no fixed length"),
        ("float64 Height", "1:9", "can not be the name of a field"),
        ("float64 height__m", "1:9", "can not be the name of a field"),
        ("float64 class", "1:9", "a word of C, C++ or Rust: call it `class_value`"),
        ("float64 x\nfloat64 x", "2:9", "two fields `x`"),
        (
            "uint8 a\nfloat64 b",
            "2:1",
            "`b` would begin at byte 1, and its alignment is 8: put `uint8[7] reserved` above it",
        ),
        ("float64 b\nuint32 a", "2:1", "put `uint8[4] reserved` at its end"),
        ("uint8 A = 300\nuint8 a", "1:7", "write a whole number from 0 to 255"),
        ("float64 A = inf\nuint8 a", "1:9", "`inf` is no value of a float64"),
        ("uint8 a = 3", "1:7", "can not be the name of a constant"),
        ("uint8 NAME = 3\nuint8 a", "1:7", "call it `NAME_VALUE`"),
        ("string A = x\nuint8 a", "1:1", "constants are numbers"),
        ("uint8 A=1\nuint8 A=2\nuint8 a", "2:7", "two constants `A`"),
        (
            "uint8 mode # [@enum MODE]",
            "1:1",
            "no whole constant begins with MODE_: write one, such as `uint8 MODE_OFF = 0`",
        ),
        ("uint8 mode # [@enum]", "1:1", "names no constants"),
        (
            "uint16 MODE_X = 999\nuint8 mode # [@enum MODE]",
            "2:1",
            "MODE_X = 999 is no value of `mode`, a uint8",
        ),
        ("uint8 mode # [@unit m]", "1:1", "`[@unit …]` means nothing"),
        ("Other x", "1:1", "there is no type `Other`: put its file beside it"),
        ("acme/Other x", "1:1", "there is no type `acme/Other`"),
        ("T x", "1:1", "T would hold itself"),
        ("uint8[65537] x", "1:1", "no fixed length"),
        ("uint8[65536] x\nuint8 y", "2:1", "longer than 65536 bytes"),
        ("uint8 x # a\u{7}b", "1:12", "a control character"),
        ("uint8 ä", "1:7", "can not be the name of a field"),
    ] {
        let said = one(text).unwrap_err();
        assert!(said.starts_with(&format!("T.msg:{place}: ")) && said.contains(words), "{text:?}: {said}");
    }
}

#[test]
fn all_faults_are_told_at_once() {
    let said = one("float65 x\nuint8[] y\nuint8 Z").unwrap_err();
    assert_eq!(said.lines().count(), 4, "{said}");
}

#[test]
fn cycle_is_refused_with_its_way() {
    let sources = [source("A", "B b"), source("B", "C[2] c"), source("C", "A a")];
    let said = Catalogue::read(sources).unwrap_err().to_string();
    assert!(said.contains("A would hold itself: A, which holds B, which holds C"), "{said}");
}

#[test]
fn depth_size_and_numbers_are_bounded() {
    let level = |level: usize| source(&format!("L{level}"), &format!("L{} x", level + 1));
    for levels in [bounds::DEPTH - 1, bounds::DEPTH] {
        let chain = (0..levels).map(level).chain([source(&format!("L{levels}"), "uint8 x")]);
        let read = Catalogue::read(chain);
        assert_eq!(read.is_ok(), levels < bounds::DEPTH, "{levels}: {read:?}");
    }
    // Each doubles the one before: 2^32 numbers, if they were made.
    let doubling = (0..7).map(|n| source(&format!("D{n}"), &format!("D{}[24] x", n + 1)));
    let said = Catalogue::read(doubling.chain([source("D7", "uint8 x")])).unwrap_err().to_string();
    assert!(said.contains("numbers by name"), "{said}");
    let long = format!("uint8 x\n{}", "#".repeat(bounds::FILE_BYTES));
    assert!(one(&long).unwrap_err().contains("a text of"));
    let many: String = (0..=bounds::ITEMS).map(|n| format!("uint8 f{n}\n")).collect();
    assert!(one(&many).unwrap_err().contains("more than 1024 fields"));
}

#[test]
fn two_types_of_one_name_have_to_say_the_same() {
    let same = [source("T", "uint8 x"), source("T", "\n\nuint8   x")];
    assert!(Catalogue::read(same).is_ok());
    let said = Catalogue::read([source("T", "uint8 x"), source("T", "uint8 y")]).unwrap_err().to_string();
    assert!(said.contains("there is a type T already, with other fields, in T.msg"), "{said}");
}

#[test]
fn constants_are_of_their_kind() {
    let text = "uint8 A = 0x1f\nint64 B = -9223372036854775808\nbool C = True\nfloat32 D = 0.1\nuint8 x";
    let values: Vec<_> = one(text).unwrap().constants().iter().map(|constant| constant.value).collect();
    let least = Scalar::Whole(i64::MIN.into());
    assert_eq!(values, [Scalar::Whole(31), least, Scalar::Bool(true), Scalar::Single(0.1)]);
}

#[test]
fn folder_holds_types_and_packages_and_anything_else_is_passed_over() {
    let folder = &common::folder("folder_holds_types");
    for (path, text) in [
        ("Radar.msg", "uint8 x"),
        ("acme/Echo.msg", "uint8 x"),
        ("ros/msg/Time.msg", "int32 sec\nuint32 nanosec"),
        ("README.md", "no type"),
        ("acme/notes/Deep.msg", "no type"),
    ] {
        let path = folder.join(path);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }
    let names: Vec<String> = sources(folder).unwrap().into_iter().map(|source| source.name).collect();
    assert_eq!(names, ["Radar", "acme/Echo", "ros/Time"]);
    std::fs::write(folder.join("Bad.msg"), [0xff]).unwrap();
    let said = sources(folder).unwrap_err().to_string();
    assert!(said.contains("Bad.msg: it is not UTF-8 text"), "{said}");
    let said = sources(&folder.join("nowhere")).unwrap_err().to_string();
    assert!(said.contains("nowhere: "), "{said}");
}

proptest! {
    #[test]
    fn printed_type_reads_back_as_itself(chosen in common::chosen()) {
        let (texts, _) = common::texts(&chosen);
        let Some(catalogue) = common::catalogue(&texts) else { return Ok(()) };
        for of in catalogue.types() {
            let again = Type::from_schema(of.name(), &of.schema()).unwrap();
            prop_assert_eq!(&again, &**of);
            prop_assert_eq!(again.schema(), of.schema());
        }
    }

    #[test]
    fn damaged_text_is_read_or_refused(
        chosen in common::chosen(),
        damage in prop::collection::vec((any::<prop::sample::Index>(), "[ -~\\n#\\[\\]µ=/\u{0}]{0,4}", 0..6_usize), 0..6),
    ) {
        let (mut texts, _) = common::texts(&chosen);
        for (place, letters, gone) in damage {
            let many = texts.len();
            let source = &mut texts[place.index(many)];
            let mut chars: Vec<char> = source.text.chars().collect();
            let at = place.index(chars.len() + 1);
            let end = (at + gone).min(chars.len());
            chars.splice(at..end, letters.chars());
            source.text = chars.into_iter().collect();
        }
        let schema: String = texts.iter().map(|source| source.text.as_str()).collect();
        let _ = Type::from_schema("T0", &schema);
        if let Err(faults) = Catalogue::read(texts.clone()) {
            for fault in faults.0 {
                prop_assert!(fault.line >= 1 && fault.column >= 1 && !fault.mend.is_empty());
                let file = texts.iter().find(|source| source.file == fault.file).unwrap();
                prop_assert!(fault.line <= file.text.lines().count().max(1));
            }
        }
    }

    #[test]
    fn arbitrary_text_is_read_or_refused(text in "\\PC{0,200}", lines in "([a-zA-Z0-9\\[\\]/_]{0,9}[ =#\\n]){0,40}") {
        let _ = one(&text);
        let _ = one(&lines);
    }

    #[test]
    fn every_number_is_written_and_read_by_its_path(chosen in common::chosen(), seed in any::<u64>()) {
        let (texts, _) = common::texts(&chosen);
        let Some(catalogue) = common::catalogue(&texts) else { return Ok(()) };
        for of in catalogue.types() {
            let mut bytes = vec![0; of.size()];
            let value = |column: usize, kind: FieldKind| match kind {
                FieldKind::F64 => Scalar::Real(f64::from_bits(seed.rotate_left(column as u32))),
                FieldKind::F32 => Scalar::Single(f32::from_bits(seed.rotate_left(column as u32) as u32)),
                FieldKind::Bool => Scalar::Bool(column % 2 == 1),
                kind => Scalar::Whole(kind.range().unwrap().1 - (column % 100) as i128),
            };
            let columns: Vec<String> = of.columns().collect();
            for (column, path) in columns.iter().enumerate() {
                let kind = of.place(path).unwrap().kind;
                of.set(&mut bytes, path, value(column, kind)).unwrap().unwrap();
            }
            for (column, (path, read)) in columns.iter().zip(of.numbers(&bytes).unwrap()).enumerate() {
                let expected = value(column, of.place(path).unwrap().kind);
                prop_assert!(read.is_same(expected), "{} {}: {:?} {:?}", of.name(), path, read, expected);
            }
        }
    }
}
