//! Types at random, laid out a second time.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use bateleur_message_format::{Catalogue, FieldKind, Source};
use proptest::prelude::*;

/// An empty folder for the test of that name, below the target folder.
pub(crate) fn folder(test: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(test);
    let _ = std::fs::remove_dir_all(&folder); // there is none yet
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

/// One field as chosen: a kind or a place among the types before, and elements.
#[derive(Debug, Clone)]
pub(crate) struct Chosen {
    what: usize,
    count: Option<usize>,
    unit: Option<&'static str>,
    text: &'static str,
}

/// The fields of several types.
pub(crate) fn chosen() -> impl Strategy<Value = Vec<Vec<Chosen>>> {
    let count = prop_oneof![3 => Just(None), 1 => (1..5_usize).prop_map(Some)];
    let unit = prop_oneof![Just(None), Just(Some("m/s")), Just(Some("µs")), Just(Some("-"))];
    let text = prop_oneof![
        Just(""),
        Just("Höhe [1] \"über\" */ NN /* ??/"),
        Just("[@range 0, 1] A share."),
        Just("a # b")
    ];
    let field = (0..32_usize, count, unit, text).prop_map(|(what, count, unit, text)| Chosen {
        what,
        count,
        unit,
        text,
    });
    prop::collection::vec(prop::collection::vec(field, 1..10), 1..8)
}

/// What a type needs, by a second reckoning.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Expected {
    pub(crate) size: usize,
    pub(crate) align: usize,
    depth: usize,
}

/// The texts of the types, with holes filled in, and what they need.
pub(crate) fn texts(chosen: &[Vec<Chosen>]) -> (Vec<Source>, Vec<Expected>) {
    let (mut sources, mut known): (Vec<Source>, Vec<Expected>) = (Vec::new(), Vec::new());
    for (number, fields) in chosen.iter().enumerate() {
        let mut text = "# What it is for.\n#\n# More of it.\n\nuint8 MODE_OFF = 0  # Not on.\nuint8 MODE_ON = 1\nint64 LEAST = -9223372036854775808\nfloat32 SHARE = 0.1\nuint8 mode  # [@enum MODE] How it is.\n".to_owned();
        let mut made = Expected { size: 1, align: 1, depth: 1 };
        for (place, field) in fields.iter().enumerate() {
            let kinds = FieldKind::ALL.len();
            let nested = (field.what >= kinds).then(|| known.get(field.what - kinds)).flatten();
            let (name, size, align) = match nested.filter(|nested| nested.depth < 4) {
                Some(nested) => (format!("T{}", field.what - kinds), nested.size, nested.align),
                None => {
                    let kind = FieldKind::ALL[field.what % kinds];
                    (kind.ros2_name().to_owned(), kind.size(), kind.size())
                }
            };
            made.depth = made.depth.max(1 + nested.map_or(0, |nested| nested.depth));
            fill(&mut text, &mut made, align, &format!("pad_{place}"));
            let array = field.count.map_or(String::new(), |count| format!("[{count}]"));
            let unit = field.unit.map_or(String::new(), |unit| format!("[{unit}] "));
            match place % 3 {
                0 => drop(writeln!(text, "\n# {}\n{name}{array} f_{place} # {unit}", field.text)),
                1 => drop(writeln!(
                    text,
                    "\n# [@frame NED] [a, b]\n{name}{array} f_{place} # {unit}{}",
                    field.text
                )),
                _ => drop(writeln!(text, "{name}{array} f_{place} # {unit}{}", field.text)),
            }
            made.size += size * field.count.unwrap_or(1);
            made.align = made.align.max(align);
        }
        let align = made.align;
        fill(&mut text, &mut made, align, "pad_end");
        sources.push(Source { name: format!("T{number}"), file: format!("T{number}.msg"), text });
        known.push(made);
    }
    (sources, known)
}

fn fill(text: &mut String, made: &mut Expected, align: usize, name: &str) {
    let hole = made.size.next_multiple_of(align) - made.size;
    if hole > 0 {
        let _ = writeln!(text, "uint8[{hole}] {name}");
    }
    made.size += hole;
}

/// The types of texts that are right; `None`: they are larger than the bounds.
pub(crate) fn catalogue(sources: &[Source]) -> Option<Catalogue> {
    match Catalogue::read(sources.to_vec()) {
        Ok(catalogue) => Some(catalogue),
        Err(faults) => {
            let large = |what: &str| what.contains("longer than") || what.contains("more than");
            assert!(faults.0.iter().any(|fault| large(&fault.what)), "{faults}");
            None
        }
    }
}
