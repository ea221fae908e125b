//! Memory blocks of a plan, under the executive.

use std::path::Path;

use bateleur_tests::{Ended, Sketch, among_others, bateleur, compile_c};

fn run(schedule: &str, options: &[&str]) -> Ended {
    bateleur(&[&["run", "--fast", "--until", "2", "--schedule", schedule], options].concat()).end()
}

fn blocks(read: &str, read_write: &str) -> String {
    format!(
        "[memory_block.shared]\nsize = \"10000B\"\ncontent = \"map\"\nread = [{read}]\nread_write = [{read_write}]\n\
         [memory_block.fixed]\nsize = \"3B\"\ncontent = \"map\"\nread = [{read}, {read_write}]\n"
    )
}

/// Partitions in C, each with its role.
fn sketch(folder: &Path, roles: &[(&str, &[&str], &str)], tables: &str) -> String {
    std::fs::write(folder.join("map"), "map").unwrap();
    let sketch = roles.iter().fold(Sketch::new().table(tables), |sketch, (name, flags, keys)| {
        sketch.partition_at(name, &compile_c("blocks", folder, name, flags), 1000, keys)
    });
    sketch.write(folder)
}

#[test]
fn partitions_in_c_share_a_block_of_the_plan_with_its_content() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let wide = ["-DROLE=reads", "-DAPEX_IDENTIFIER_BITS=64"];
    let roles: [(&str, &[&str], &str); 3] = [
        ("reader", &["-DROLE=reads"], "threads = 2"),
        ("writer", &["-DROLE=writes"], "threads = 2"),
        ("wide", &wide, "threads = 2"),
    ];
    let ended = run(&sketch(folder.path(), &roles, &blocks("\"reader\", \"wide\"", "\"writer\"")), &[]);
    for (name, ..) in roles {
        assert!(ended.stderr.contains(&format!("{name}: done")), "{name}:\n{}", ended.stderr);
    }
    assert!(!ended.stderr.contains("FAILED") && ended.faults().is_empty(), "{}", ended.stderr);
}

#[test]
fn mem_03_write_to_a_block_for_reading_is_a_memory_violation_and_changes_nothing() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let idle = "threads = 2\nrestart = { start = \"cold\", budget = 0, within = \"10s\", then = \"idle\" }";
    let roles: [(&str, &[&str], &str); 3] = [
        ("breaker", &["-DROLE=breaks"], idle),
        ("writer", &["-DROLE=writes"], "threads = 2"),
        ("reader", &["-DROLE=reads"], "threads = 2"),
    ];
    let schedule = sketch(folder.path(), &roles, &blocks("\"reader\", \"breaker\"", "\"writer\""));
    let ended = run(&schedule, &[]).expect_code(0);
    let faults = ended.faults();
    assert!(!ended.stderr.contains("FAILED"), "{}", ended.stderr);
    let found: Vec<_> = faults.iter().map(|of| (&*of.partition, &*of.error)).collect();
    assert_eq!(found, [("breaker", "memory_violation")], "{}", ended.stderr);
    assert!(
        ended.stderr.contains("reader: done") && ended.stderr.contains("writer: done"),
        "{}",
        ended.stderr
    );
}

/// A partition that counts its windows in a block, and one that watches it.
fn counting(folder: &Path, tables: &str, keys: &str) -> String {
    let block = "[memory_block.count]\nsize = \"64B\"\nread_write = [\"counter\"]\nread = [\"watcher\"]\n";
    let sketch = Sketch::new().table(&format!("{tables}{block}")).partition("counter", "blocks", 1000, keys);
    sketch.partition("watcher", "blocks", 1000, "").write(folder)
}

/// What the counting partition has found at each of its starts but the first.
fn found(ended: &Ended, words: &str) -> Vec<u64> {
    let after = ended.stderr.lines().filter_map(|line| line.split_once("counter: ")?.1.split_once(words));
    after.filter_map(|(_, rest)| rest.trim_matches(|c: char| !c.is_ascii_digit()).parse().ok()).collect()
}

#[test]
fn mem_05_contents_outlive_restarts_cold_and_warm_of_a_partition_and_its_standby() {
    let _turn = among_others();
    for (keys, words) in [
        ("", "HmPartitionColdRestart found Ok("),
        ("standby = \"spare\"", "HmPartitionColdRestart found Ok("),
        ("standby = \"hot\"", "took over "),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let schedule = counting(folder.path(), "", keys);
        let ended = run(&schedule, &["--kill", "counter@0.5", "--kill", "watcher@0.7"]).expect_code(0);
        assert!(!ended.stderr.contains("FAILED"), "{}", ended.stderr);
        let counts = found(&ended, words);
        assert!(
            matches!(counts[..], [count] if (24..=26).contains(&count)),
            "{keys}: {counts:?}\n{}",
            ended.stderr
        );
    }
}

#[test]
fn contents_outlive_the_executive_and_not_a_cold_start_of_the_module() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let health = "[health]\nreset = { budget = 9, within = \"60s\" }\n[health.module]\nexecutive_died = \"reset\"\n\
                  partition_stopped = \"reset\"\n";
    let stops = "restart = { start = \"cold\", budget = 1, within = \"60s\", then = \"stop\" }";
    let schedule = counting(folder.path(), health, stops);
    let faults = ["--inject", "executive:sigkill@0.5", "--kill", "counter@0.8", "--kill", "counter@1.2"];
    let ended = run(&schedule, &faults);
    let words = &ended.stderr;
    assert!(!words.contains("FAILED"), "{words}");
    let after_death = found(&ended, "HmPartitionWarmRestart found Ok(");
    assert!(matches!(after_death[..], [count] if (20..=26).contains(&count)), "{after_death:?}\n{words}");
    let after_kill = found(&ended, "HmPartitionColdRestart found Ok(");
    assert!(matches!(after_kill[..], [count] if (30..=41).contains(&count)), "{after_kill:?}\n{words}");
    assert_eq!(found(&ended, "HmModuleRestart found Ok("), [0], "{words}");
}

#[test]
fn content_that_is_not_there_is_said_before_anything_starts() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let block = "[memory_block.count]\nsize = \"64B\"\ncontent = \"nowhere.bin\"\nread = [\"counter\"]\n";
    let schedule = Sketch::new().table(block).partition("counter", "blocks", 1000, "").write(folder.path());
    let ended = run(&schedule, &[]);
    assert_ne!(ended.code, Some(0));
    assert!(
        ended.stderr.contains("the content of memory block count: ") && ended.stderr.contains("nowhere.bin"),
        "{}",
        ended.stderr
    );
}
