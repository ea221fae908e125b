//! The compiled plan: every plan that the checker lets through is read as it was written, and whatever else stands in such a file is
//! refused by name, or is a plan with which nothing can be harmed.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod plan_support;

use std::sync::LazyLock;

use bateleur_checker::{MessageCatalogue, check};
use bateleur_plan::bounds::LONGEST_DEFINITION;
use bateleur_plan::compiled::{Compiled, CompiledError, MOST_BYTES, VERSION};
use bateleur_plan::{ModuleId, Plan, Timeline};
use plan_support::repository;
use proptest::prelude::*;
use serde_json::{Value, json};

/// Every message has some size.
struct Any;

impl MessageCatalogue for Any {
    fn size_of(&self, _: &str) -> Option<usize> {
        Some(64)
    }

    fn layout_of(&self, name: &str) -> u32 {
        name.len() as u32
    }

    fn definition_of(&self, _: &str) -> Option<String> {
        Some("uint64[8] words\n".to_owned())
    }

    fn names(&self) -> Vec<&str> {
        Vec::new()
    }
}

fn texts() -> Vec<(String, String)> {
    let top = repository();
    let names =
        ["schedule.toml", "schedules/can.toml", "schedules/two-hosts.toml", "schedules/three-hosts.toml"];
    names.map(|name| (name.to_owned(), std::fs::read_to_string(top.join(name)).unwrap())).to_vec()
}

fn compiled(name: &str, text: &str) -> Compiled {
    let plan = check(name, text, &Any).unwrap_or_else(|report| panic!("{}", report.render(false)));
    Compiled::new(name, text, plan)
}

/// A file with this content, whose first line says that it is whole.
fn sealed(content: &Value) -> Vec<u8> {
    let body = serde_json::to_vec(content).unwrap();
    let head = format!("bateleur plan {VERSION} {}\n", blake3::hash(&body).to_hex());
    [head.into_bytes(), body].concat()
}

/// Whatever is computed from a plan before its module starts.
fn use_all_of(plan: &Plan) {
    for module in (0..plan.modules.len()).map(ModuleId) {
        for timeline in Timeline::all(plan, module) {
            timeline.cores.iter().for_each(|core| assert!(core.used_ns() <= timeline.major_frame_ns));
        }
        plan.relay_table(module).unwrap();
        let local = plan.local(module);
        assert!(!local.port_path(bateleur_plan::PortId(0)).is_empty());
    }
}

#[test]
fn plan_is_read_as_it_was_written() {
    for (name, text) in texts() {
        let compiled = compiled(&name, &text);
        let bytes = compiled.write().unwrap();
        let again = Compiled::read(&bytes).unwrap();
        assert_eq!(again, compiled, "{name}");
        assert_eq!(again.plan.digest().unwrap(), compiled.plan.digest().unwrap(), "hosts agree on it");
        use_all_of(&again.plan);
    }
}

/// The bounds must let through whatever the rules do.
#[test]
fn every_schedule_file_of_the_repository_that_the_checker_lets_through_is_compiled() {
    let folders = [
        "schedules",
        "tests/schedule",
        "hil/bateleur/tests/new",
        "hil/bateleur/tests/golden",
        "hil/bateleur/tests",
    ];
    let files = folders.iter().flat_map(|folder| std::fs::read_dir(repository().join(folder)).unwrap());
    let paths = files
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|end| end == "toml"));
    let mut compiled = 0;
    for path in paths {
        let (name, text) = (path.display().to_string(), std::fs::read_to_string(&path).unwrap());
        if let Ok(plan) = check(&name, &text, &Any) {
            Compiled::new(&name, &text, plan).write().unwrap_or_else(|error| panic!("{name}: {error}"));
            compiled += 1;
        }
    }
    assert!(compiled > 20, "{compiled} files are plans");
}

#[test]
fn hosts_agree_wherever_they_keep_their_keys() {
    let (name, text) = &texts()[2];
    let here = compiled(name, text);
    let mut there = here.clone();
    for link in &mut there.plan.links {
        if let bateleur_plan::Protection::Key { file } = &mut link.protection {
            *file = "elsewhere".into();
        }
    }
    assert_ne!(here, there);
    assert_eq!(here.plan.digest().unwrap(), there.plan.digest().unwrap());
    assert_eq!(
        here.plan.relay_table(ModuleId(0)).unwrap().unwrap().sections,
        there.plan.relay_table(ModuleId(0)).unwrap().unwrap().sections
    );
}

#[test]
fn what_is_no_compiled_plan_is_refused_by_name() {
    let (name, text) = &texts()[0];
    let whole = compiled(name, text).write().unwrap();
    let refused = |bytes: &[u8]| Compiled::read(bytes).unwrap_err();
    for foreign in [
        &b""[..],
        b"\n",
        b"[module.fcu]\n",
        b"{}",
        &text.as_bytes()[..500],
        &[0xff; 1000],
        b"bateleur plan \n",
    ] {
        assert!(matches!(refused(foreign), CompiledError::Foreign), "{foreign:?}");
    }
    let other =
        String::from_utf8(whole.clone()).unwrap().replacen(&format!("plan {VERSION} "), "plan 999 ", 1);
    let error = refused(other.as_bytes());
    assert!(matches!(&error, CompiledError::Version(version) if version == "999"), "{error}");
    assert!(matches!(refused(&whole[..whole.len() - 1]), CompiledError::Damaged));
    assert!(matches!(refused(&vec![b' '; MOST_BYTES + 1]), CompiledError::TooLong));
    assert!(matches!(refused(&sealed(&json!({}))), CompiledError::Structure(_)));
    let deep = format!("{}{}", "[".repeat(100_000), "]".repeat(100_000));
    let head = format!("bateleur plan {VERSION} {}\n", blake3::hash(deep.as_bytes()).to_hex());
    assert!(matches!(refused((head + &deep).as_bytes()), CompiledError::Structure(_)));
}

#[test]
fn number_that_is_none_is_no_attribute() {
    let (name, text) = &texts()[0];
    let mut one = compiled(name, text);
    let nan = bateleur_plan::Attribute::Float(f64::NAN);
    one.plan.partitions[0].attributes.insert("nan".into(), nan);
    assert!(matches!(one.write().unwrap_err(), CompiledError::Unwritable(_)));
}

#[test]
fn value_that_could_hurt_is_refused_with_its_place() {
    let (name, text) = &texts()[2];
    let whole = serde_json::to_value(compiled(name, text)).unwrap();
    for (place, value, said) in [
        ("/partitions/0/name", json!("../x"), "partition"),
        ("/partitions/0/name", json!(""), "partition"),
        ("/partitions/1/name", whole["plan"]["partitions"][0]["name"].clone(), "two partitions"),
        ("/partitions/0/program", json!(""), "program"),
        ("/partitions/0/module", json!(7), "module"),
        ("/partitions/0/priority", json!(98), "priority"),
        ("/partitions/0/threads", json!(0), "threads"),
        ("/partitions/0/threads", json!(100_000), "threads"),
        ("/partitions/0/processes/period_ns", json!(0), "processes"),
        ("/partitions/0/processes/release_ns", json!(u64::MAX), "processes"),
        ("/partitions/0/processes/most", json!(129), "processes"),
        ("/partitions/0/processes/identifier", json!(u32::MAX), "processes"),
        (
            "/partitions/0/processes/declared",
            json!([{"name": "a", "priority": 0, "period_ns": null, "deadline_ns": null, "wcet_ns": 1}]),
            "processes",
        ),
        ("/partitions/0/memory_bytes", json!(0), "memory"),
        ("/partitions/0/retained_bytes", json!(u64::MAX), "retained"),
        ("/partitions/0/startup_timeout_ns", json!(u64::MAX), "times"),
        ("/partitions/0/devices", json!(["/dev/a\0b"]), "devices"),
        ("/partitions/0/may_set_schedule", json!([9]), "schedules"),
        ("/partitions/0/ports", json!([9999]), "ports"),
        ("/ports/0/partition", json!(3), "port"),
        ("/ports/0/name", json!("a/b"), "port"),
        ("/ports/0/channel", json!(9999), "channel"),
        ("/ports/0/payload", json!({"bytes": {"max_size_bytes": 0}}), "message"),
        ("/channels/0/source", json!(9999), "channel"),
        ("/channels/0/destinations", json!([9999]), "channel"),
        ("/modules/0/cores", json!([]), "cores"),
        ("/modules/0/cores", json!([1, 1]), "cores"),
        ("/modules/0/follows", json!(9), "followed"),
        ("/links/0/ends", json!([0, 0]), "ends"),
        ("/links/0/gap_ns", json!(0), "numbers"),
        ("/networks/0/rate_bits_per_s", json!(0), "network"),
        ("/schedules/0/initial", json!(false), "initial"),
        ("/schedules/0/minor_frame_ns", json!(0), "frames"),
        ("/schedules/0/major_frame_ns", json!(u64::MAX), "frames"),
        ("/schedules/0/windows/0/duration_ns", json!(0), "window"),
        ("/schedules/0/windows/0/duration_ns", json!(u64::MAX), "window"),
        ("/schedules/0/windows/0/core", json!(63), "core"),
        ("/schedules/0/windows/0/minor", json!([]), "minor frame"),
        ("/schedules/0/windows/0/minor", json!([1_000_000]), "minor frame"),
        ("/schedules/0/windows/0/partition", json!(9999), "nobody"),
        (
            "/schedules/0/windows/0/offset_ns",
            whole["plan"]["schedules"][0]["windows"][1]["offset_ns"].clone(),
            "overlap",
        ),
        ("/health/silence_windows", json!(0), "health"),
    ] {
        let mut content = whole.clone();
        *content.pointer_mut(&format!("/plan{place}")).unwrap_or_else(|| panic!("{place}")) = value.clone();
        let error = Compiled::read(&sealed(&content)).expect_err(place);
        assert!(matches!(error, CompiledError::Bounds(_)), "{place} = {value}: {error}");
        assert!(error.to_string().contains(said), "{place} = {value}: {error}");
    }
}

/// The places of a document that can be changed.
fn places(value: &Value, at: &str, found: &mut Vec<String>) {
    found.push(at.to_owned());
    match value {
        Value::Array(items) => {
            items.iter().enumerate().for_each(|(place, item)| places(item, &format!("{at}/{place}"), found));
        }
        Value::Object(fields) => {
            fields.iter().for_each(|(name, field)| places(field, &format!("{at}/{name}"), found));
        }
        _ => {}
    }
}

/// Another value at a place: another of its type, or another type.
fn mutated(value: &Value, how: u8, number: u64) -> Value {
    match (value, how % 8) {
        (Value::Array(items), 0) => Value::Array(items.iter().skip(1).cloned().collect()),
        (Value::Array(items), 1) => Value::Array(items.iter().chain(items).cloned().collect()),
        (Value::Array(items), 2) => Value::Array(items.iter().rev().cloned().collect()),
        (_, 3) => json!(0),
        (_, 4) => json!(u64::MAX),
        (Value::Number(_), 5) => json!(number % 70_000),
        (Value::Number(_), 6) => json!(number),
        (Value::String(_), 5) => json!("../../etc/passwd"),
        (Value::String(_), 6) => json!("x".repeat(40)),
        (Value::Bool(truth), _) => json!(!truth),
        (_, 7) => Value::Null,
        (Value::Object(fields), _) => {
            Value::Object(fields.iter().skip(1).map(|(name, field)| (name.clone(), field.clone())).collect())
        }
        _ => json!(number % 64),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3_000))]

    #[test]
    fn damaged_file_is_refused(seed in any::<u64>(), bit in 0_u8..8) {
        static WHOLE: LazyLock<Vec<u8>> = LazyLock::new(|| {
            let (name, text) = &texts()[0];
            compiled(name, text).write().unwrap()
        });
        let mut bytes = WHOLE.clone();
        let place = (seed % bytes.len() as u64) as usize;
        bytes[place] ^= 1 << bit;
        prop_assert!(Compiled::read(&bytes).is_err(), "bit {bit} of byte {place}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(3_000))]

    /// Whoever can write the digest too: what is let through can be run.
    #[test]
    fn sealed_file_with_wrong_values_is_refused_or_harmless(
        which in 0_usize..4,
        changes in prop::collection::vec((any::<u64>(), any::<u8>(), any::<u64>()), 1..4),
    ) {
        static CONTENTS: LazyLock<Vec<Value>> = LazyLock::new(|| {
            texts().iter().map(|(name, text)| serde_json::to_value(compiled(name, text)).unwrap()).collect()
        });
        let mut content = CONTENTS[which].clone();
        for (place, how, number) in changes {
            let mut all = Vec::new();
            places(&content, "", &mut all);
            let one = content.pointer_mut(&all[(place % all.len() as u64) as usize]).unwrap();
            *one = mutated(one, how, number);
        }
        if let Ok(read) = Compiled::read(&sealed(&content)) {
            use_all_of(&read.plan);
        }
    }
}

#[test]
fn text_of_a_type_that_no_port_carries_or_that_is_too_long_is_not_compiled() {
    let (name, text) = texts().remove(0);
    let plan = check(&name, &text, &Any).unwrap();
    assert!(plan.messages.contains_key("State"), "a plan carries the texts of its types");
    for (message, definition, words) in [
        ("Foreign", "uint8 x\n".to_owned(), "a message type that no port carries"),
        ("State", "#".repeat(LONGEST_DEFINITION + 1), "message type State: its text"),
    ] {
        let mut wrong = plan.clone();
        wrong.messages.insert(message.to_owned(), definition);
        let said = Compiled::new(&name, &text, wrong).write().unwrap_err().to_string();
        assert!(said.contains(words), "{said}");
    }
}
