//! The layouts of types at random, and what compilers make of the sources.
//!
//! Helpers panic as tests do.
#![allow(clippy::panic, clippy::unwrap_used)]

mod common;

use std::path::Path;
use std::process::Command;

use bateleur_message_format::{Catalogue, Source, header, structure};
use proptest::strategy::{Strategy, ValueTree};
use proptest::test_runner::TestRunner;

/// Whether a compiler takes a source; its words where it does not.
fn compile(folder: &Path, file: &str, source: &str, command: &[&str]) -> Result<(), String> {
    std::fs::write(folder.join(file), source).unwrap();
    let output = Command::new(command[0]).args(&command[1..]).arg(file).current_dir(folder).output();
    let output = output.unwrap_or_else(|error| panic!("{}: {error}", command[0]));
    if output.status.success() { Ok(()) } else { Err(String::from_utf8_lossy(&output.stderr).into_owned()) }
}

const RUSTC: &[&str] = &["rustc", "--edition=2024", "--crate-type=lib", "--emit=metadata", "-Dwarnings"];
const C: &[&str] = &["cc", "-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only"];
const CXX: &[&str] = &["c++", "-std=c++17", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-fsyntax-only"];

/// The header of types, used once: whether every constant is of its type shows there.
fn program(catalogue: &Catalogue) -> String {
    let mut out = header("TYPES_H", catalogue.types().map(|of| &**of));
    out += "\nint main(void) {\n    int64_t sum = 0;\n";
    for of in catalogue.types() {
        let name = format!(
            "{}_{}",
            if of.name().contains('/') { "" } else { "bateleur" },
            of.name().replace('/', "_")
        );
        let name = name.trim_start_matches('_');
        out += &format!("    {{ static {name} value; value = value; sum += (int64_t)sizeof value; }}\n");
        for constant in of.constants() {
            out += &format!(
                "    {{ {} one = {name}_{}; sum += (int64_t)one; }}\n",
                constant.kind.c_name(),
                constant.name
            );
        }
    }
    out + "    return sum == 0;\n}\n"
}

fn rust(catalogue: &Catalogue) -> String {
    let structures: String = catalogue.types().map(|of| structure(of, "self")).collect();
    format!("//! Types.\n#![allow(missing_docs)]\n{structures}")
}

/// Types enough for one run of each compiler.
fn many() -> Catalogue {
    let mut runner = TestRunner::deterministic();
    let mut sources: Vec<Source> = Vec::new();
    for group in 0..40 {
        let chosen = common::chosen().new_tree(&mut runner).unwrap().current();
        let (texts, expected) = common::texts(&chosen);
        let Some(catalogue) = common::catalogue(&texts) else { continue };
        for (source, expected) in texts.iter().zip(expected) {
            let of = catalogue.find(&source.name).unwrap();
            assert_eq!((of.size(), of.align()), (expected.size, expected.align), "{}", source.text);
        }
        // Each group is a package, in which the names are its own.
        let package = format!("group_{group}");
        sources.extend(
            texts.into_iter().map(|source| Source { name: format!("{package}/{}", source.name), ..source }),
        );
    }
    assert!(sources.len() > 60, "only {} types", sources.len());
    Catalogue::read(sources).unwrap()
}

#[test]
fn compilers_agree_with_the_layout_of_types_at_random() {
    let folder = &common::folder("types_at_random");
    let catalogue = many();
    let program = program(&catalogue);
    compile(folder, "types.c", &program, C).unwrap();
    compile(folder, "types.cpp", &program, CXX).unwrap();
    let mut modules = String::from("#![allow(missing_docs)]\n");
    let mut open = String::new();
    for of in catalogue.types() {
        let package = of.name().split_once('/').unwrap().0;
        if open != package {
            modules += if open.is_empty() { "" } else { "}\n" };
            modules += &format!("pub mod {package} {{\n");
            open = package.to_owned();
        }
        modules += &structure(of, "super");
    }
    compile(folder, "types.rs", &(modules + "}\n"), RUSTC).unwrap();
}

#[test]
fn compilers_refuse_a_place_and_a_size_that_are_not_the_layouts() {
    let folder = &common::folder("places_and_sizes");
    let text = "uint32 a\nuint16[2] b\nfloat64 c\n".to_owned();
    let catalogue = Catalogue::read([Source { name: "T".into(), file: "T.msg".into(), text }]).unwrap();
    let (program, rust) = (program(&catalogue), rust(&catalogue));
    compile(folder, "types.c", &program, C).unwrap();
    compile(folder, "types.rs", &rust, RUSTC).unwrap();
    for (right, wrong) in [("c) == 8", "c) == 16"), ("== 16 ?", "== 24 ?"), (">() == 16", ">() == 24")] {
        let (c, r) = (program.replace(right, wrong), rust.replace(right, wrong));
        assert!(c != program || r != rust, "`{right}` is in no source");
        if c != program {
            compile(folder, "wrong.c", &c, C).unwrap_err();
            compile(folder, "wrong.cpp", &c, CXX).unwrap_err();
        }
        if r != rust {
            compile(folder, "wrong.rs", &r, RUSTC).unwrap_err();
        }
    }
}

#[test]
fn header_of_the_flights_folder_is_written_and_compiles() {
    let folder = &common::folder("header_of_the_flight");
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let made = |folders: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_message_header"));
        command.args(folders.iter().map(|folder| here.join(folder))).output().unwrap()
    };
    let output = made(&["../messages/msg", "../../tests/messages"]);
    assert!(output.status.success());
    let header = String::from_utf8(output.stdout).unwrap();
    for line in [
        "typedef struct bateleur_State {",
        "    acme_Echo echoes[2];",
        "#define acme_Track_MODE_SWEEP UINT32_C(7)",
    ] {
        assert!(header.contains(line), "{line}");
    }
    compile(folder, "messages.c", &format!("{header}typedef int a_c_file;\n"), C).unwrap();
    compile(folder, "messages.cpp", &header, CXX).unwrap();
    let refused = made(&["nowhere"]);
    assert_eq!((refused.status.code(), refused.stdout.len()), (Some(2), 0));
}
