//! Partitions that end by faults leave reports: with the function and the line, bounded, and nothing else.

use std::path::Path;

use bateleur_tests::{Ended, Sketch, among_others, bateleur, compile_c, line_of, repository};
use serde_json::Value;

/// Bytes of a file, most.
const MOST_BYTES: u64 = 256 << 10;

fn crashes(folder: &Path) -> Value {
    let ended = bateleur(&["crash", folder.to_str().unwrap(), "--format", "json"]).end().expect_code(0);
    serde_json::from_str(&ended.stdout).unwrap()
}

fn reports(folder: &Path) -> Vec<Value> {
    crashes(folder)["reports"].as_array().unwrap().clone()
}

fn run_for(seconds: &str, sketch: &Sketch, folder: &Path, more: &[&str]) -> Ended {
    let schedule = sketch.write(folder);
    bateleur(&[&["run", "--fast", "--until", seconds, "--schedule", &schedule], more].concat())
        .end()
        .expect_code(0)
}

/// The first frame whose function's name ends so.
fn frame<'r>(report: &'r Value, function: &str) -> &'r Value {
    let frames = report["backtrace"].as_array().unwrap_or_else(|| panic!("no backtrace in {report:#}"));
    let named = |frame: &&Value| frame["function"].as_str().is_some_and(|name| name.ends_with(function));
    frames.iter().find(named).unwrap_or_else(|| panic!("no {function} in {report:#}"))
}

fn line_in(source: &str, part: &str) -> u64 {
    let text = std::fs::read_to_string(repository().join(source)).unwrap();
    line_of(&text, part) as u64
}

fn is_at(frame: &Value, source: &str, line: u64) {
    assert!(frame["file"].as_str().is_some_and(|file| file.ends_with(source)), "{frame:#}");
    assert_eq!(frame["line"], line, "{frame:#}");
}

/// Every file of the reports is within its bound.
fn expect_bounded(folder: &Path) {
    for file in std::fs::read_dir(folder.join("crashes")).unwrap().flatten() {
        let bytes = file.metadata().unwrap().len();
        assert!(bytes > 0 && bytes <= MOST_BYTES, "{}: {bytes}", file.path().display());
    }
}

#[test]
fn faults_in_rust_are_told_with_function_and_line() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let source = "tests/src/bin/crasher.rs";
    let mut cases = vec![
        ("segv", "SIGSEGV", "memory_violation", "write_to_nowhere", "nowhere.write_volatile(1)"),
        ("abort", "SIGABRT", "exit", "window", "=> std::process::abort()"),
        ("stack", "SIGSEGV", "stack_overflow", "dig", ""),
        ("divide", "panic", "numeric_error", "window", "1 / std::hint::black_box(0_i32)"),
        ("panic", "panic", "exit", "window", "=> panic!("),
    ];
    if cfg!(target_arch = "x86_64") {
        cases.push(("fpe", "SIGFPE", "numeric_error", "divide_by_zero", "\"xor edx, edx\""));
    }
    let sketch = cases.iter().fold(Sketch::new(), |sketch, (how, ..)| {
        let keys = format!(
            "attributes = {{ how = \"{how}\", after = 5 }}\nrestart = {{ budget = 0, then = \"idle\" }}"
        );
        sketch.partition(&format!("by_{how}"), "crasher", 1_000, &keys)
    });
    let ended = run_for("1", &sketch, folder.path(), &[]);
    let found = reports(&ended.folder());
    assert_eq!(found.len(), cases.len(), "{found:#?}\n{}", ended.stderr);
    for (how, signal, error, function, at) in cases {
        let report = found.iter().find(|one| one["partition"] == format!("by_{how}")).unwrap();
        assert_eq!((&report["signal"], &report["error"]), (&signal.into(), &error.into()), "{report:#}");
        let innermost = frame(report, function);
        if !at.is_empty() {
            is_at(innermost, source, line_in(source, at));
        }
        assert_eq!(report["main_thread"], true);
        assert!(report["registers"].as_object().unwrap().len() > 10);
        assert!(!report["windows"].as_array().unwrap().is_empty(), "{report:#}");
        let dump = std::fs::read(ended.folder().join(report["minidump"].as_str().unwrap())).unwrap();
        assert_eq!(&dump[..4], b"MDMP");
    }
    let address = |how: &str| {
        found.iter().find(|one| one["partition"] == format!("by_{how}")).unwrap()["address"].clone()
    };
    assert_eq!(address("segv"), "0x8");
    expect_bounded(&ended.folder());
    // As text.
    let said = bateleur(&["crash", ended.folder().to_str().unwrap(), "by_segv"]).end().expect_code(0).stdout;
    assert!(said.contains("SIGSEGV (nothing is mapped there) at address 0x8 in the main thread"), "{said}");
    assert!(said.contains("write_to_nowhere") && said.contains("crasher.rs:"), "{said}");
    assert!(!said.contains("by_abort"), "{said}");
}

#[test]
fn faults_in_c_are_told_with_function_and_line() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let source = "tests/c/faulty.c";
    let cases = [
        ("null_pointer", "SIGSEGV", "*nowhere = 1;"),
        ("division", "SIGFPE", "zero = one / zero;"),
        ("stack", "SIGSEGV", ""),
        ("aborted", "SIGABRT", "abort(); }"),
    ];
    let cases = cases.iter().filter(|(fault, ..)| *fault != "division" || cfg!(target_arch = "x86_64"));
    let sketch = cases.clone().fold(Sketch::new(), |sketch, (fault, ..)| {
        let flags = ["-g", &format!("-DFAULT={fault}")];
        let program = compile_c("faulty", folder.path(), fault, &flags);
        sketch.partition_at(fault, &program, 1_000, "threads = 2\nrestart = { budget = 0, then = \"idle\" }")
    });
    let ended = run_for("1", &sketch, folder.path(), &[]);
    let found = reports(&ended.folder());
    for (fault, signal, at) in cases {
        let report = found.iter().find(|one| one["partition"] == *fault);
        let report = report.unwrap_or_else(|| panic!("{fault}: {found:#?}\n{}", ended.stderr));
        assert_eq!(report["signal"], *signal, "{report:#}");
        assert_eq!(report["process"], "fault", "{report:#}");
        let name = if *fault == "stack" { "deep" } else { fault };
        let innermost = frame(report, name);
        if !at.is_empty() {
            is_at(innermost, source, line_in(source, at));
        }
    }
    expect_bounded(&ended.folder());
}

#[test]
fn process_of_several_is_named_and_what_was_provoked_is_told_likewise() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let sketch = Sketch::new()
        .partition("several", "processes", 2_000, "threads = 4")
        .partition("alone", "counter", 1_000, "")
        .partition("sent", "counter", 1_000, "");
    let more = [
        "--inject",
        "alone:null-write@0.3",
        "--inject",
        "sent:sigsegv@0.5",
        "--inject",
        "several:null-write@0.6",
    ];
    let ended = run_for("1", &sketch, folder.path(), &more);
    let found = reports(&ended.folder());
    let of = |partition: &str| {
        let report = found.iter().find(|one| one["partition"] == partition);
        report.unwrap_or_else(|| panic!("{partition}: {found:#?}\n{}", ended.stderr))
    };
    let functions =
        of("alone")["backtrace"].as_array().unwrap().iter().filter_map(|frame| frame["function"].as_str());
    assert!(
        functions.clone().any(|name| name.starts_with("bateleur_apex::faults") || name == "write_byte"),
        "{:#}",
        of("alone")
    );
    let sent = of("sent");
    assert_eq!((&sent["signal"], &sent["reason"]), (&"SIGSEGV".into(), &"sent by a process".into()));
    frame(sent, "main");
    assert_eq!(of("several")["error"], "memory_violation");
}

#[test]
fn only_the_first_reports_of_a_partition_are_kept_and_a_kill_leaves_none() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let sketch = Sketch::new()
        .partition(
            "again",
            "crasher",
            1_000,
            "attributes = { after = 1 }\nrestart = { budget = 100, within = \"10s\", then = \"idle\" }",
        )
        .partition("killed", "counter", 1_000, "");
    let ended = run_for("3", &sketch, folder.path(), &["--kill", "killed@1"]);
    let told = crashes(&ended.folder());
    let found = told["reports"].as_array().unwrap();
    assert_eq!(found.len(), 8, "{}", ended.stderr);
    assert!(found.iter().all(|report| report["partition"] == "again"));
    let numbers: Vec<u64> = found.iter().filter_map(|report| report["generation"].as_u64()).collect();
    assert_eq!(numbers, (0..8).collect::<Vec<_>>(), "the first ones");
    let without = told["without"].as_array().unwrap();
    let killed = without.iter().find(|death| death["partition"] == "killed").unwrap();
    assert!(killed["why"].as_str().unwrap().contains("SIGKILL"), "{killed}");
    let others = without.iter().filter(|death| death["partition"] == "again");
    assert!(
        others.clone().count() > 8
            && others.clone().all(|death| death["why"].as_str().unwrap().contains("first ones"))
    );
    let files = std::fs::read_dir(ended.folder().join("crashes")).unwrap().count();
    assert_eq!(files, 16, "a report and a minidump each");
    expect_bounded(&ended.folder());
}

#[test]
fn hostile_partition_that_writes_rubbish_there_harms_nobody() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let sketch = Sketch::new()
        .partition("liar", "crasher", 1_000, "attributes = { how = \"lie\", after = 5 }\nrestart = { budget = 20, within = \"10s\", then = \"idle\" }")
        .partition("neighbour", "counter", 1_000, "");
    let ended = run_for("2", &sketch, folder.path(), &[]);
    let faults = ended.faults();
    assert!(faults.iter().all(|fault| fault.partition == "liar"), "{faults:?}");
    assert!(faults.len() > 8, "{faults:?}");
    let ended_well = bateleur(&["crash", ended.folder().to_str().unwrap()]).end();
    assert!(ended_well.code.is_some_and(|code| code < 2), "{}", ended_well.stderr);
    for file in std::fs::read_dir(ended.folder().join("crashes")).unwrap().flatten() {
        assert!(file.metadata().unwrap().len() <= MOST_BYTES);
    }
}
