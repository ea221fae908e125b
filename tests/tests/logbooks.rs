//! Logbooks of a plan, under the executive: what is stored, and what outlives what.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

use bateleur_tests::{Ended, Sketch, alone, among_others, await_some, bateleur, children_of, compile_c};
use rustix::process::Signal;

/// A partition that writes into a logbook of 20 messages, of which three may be on their way.
fn scribe(folder: &Path, how: &str, keys: &str, tables: &str) -> String {
    let keys = format!(
        "attributes = {{ how = \"{how}\" }}\nlogbook.log = {{ max_size = 16, max_logged = 20, max_in_progress = 3 }}\n{keys}"
    );
    Sketch::new().table(tables).partition("scribe", "scribe", 1000, &keys).write(folder)
}

fn fast(schedule: &str, options: &[&str]) -> Ended {
    bateleur(&[&["run", "--fast", "--until", "2", "--schedule", schedule], options].concat()).end()
}

/// What the partition has found at each of its starts: the number of the newest message, messages stored and on their way.
fn found(words: &str) -> Vec<[u64; 3]> {
    let lines = words.lines().filter_map(|line| line.split_once("scribe: found "));
    let numbers = |rest: &str| {
        let mut words = rest.split_whitespace().filter_map(|word| word.parse().ok());
        [(); 3].map(|()| words.next().unwrap())
    };
    lines.map(|(_, rest)| numbers(rest)).collect()
}

/// What `bateleur logbook` gives of a run, from the oldest message on.
fn printed(run: &str) -> Vec<Option<String>> {
    let ended = bateleur(&["logbook", run, "--format", "json"]).end().expect_code(0);
    let entries: serde_json::Value = serde_json::from_str(&ended.stdout).unwrap();
    let text = |entry: &serde_json::Value| entry["text"].as_str().map(str::to_owned);
    entries.as_array().unwrap().iter().map(text).collect()
}

#[test]
fn log_create_07_what_was_stored_is_there_after_restarts_of_the_partition_the_executive_and_the_module() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let health = "[health]\nreset = { budget = 9, within = \"60s\" }\n[health.module]\nexecutive_died = \"reset\"\n\
                  partition_stopped = \"reset\"\n";
    let stops = "restart = { start = \"cold\", budget = 1, within = \"60s\", then = \"stop\" }";
    let schedule = scribe(folder.path(), "write", stops, health);
    let faults = ["--inject", "executive:sigkill@0.5", "--kill", "scribe@0.8", "--kill", "scribe@1.2"];
    let runs: Vec<_> = (0..2)
        .map(|run| {
            let output = folder.path().join(format!("run{run}"));
            let output = output.to_str().unwrap();
            let ended = fast(&schedule, &[&faults[..], &["--output", output]].concat());
            assert!(!ended.stderr.contains("FAILED"), "{}", ended.stderr);
            (found(&ended.stderr), printed(output))
        })
        .collect();
    let (starts, messages) = &runs[0];
    assert_eq!(starts.len(), 4, "{starts:?}");
    assert_eq!(starts[0], [0, 0, 0], "on the virtual clock a run begins with empty logbooks");
    // One message a window; those on their way are stored or still there.
    assert!(starts.windows(2).all(|pair| pair[0][0] < pair[1][0]), "{starts:?}");
    assert!(starts[1][0] >= 22 && starts[3][0] >= 40, "{starts:?}");
    assert!(starts[1..].iter().all(|[_, stored, under_way]| stored + under_way >= 20), "{starts:?}");
    assert_eq!((messages.len(), messages.iter().flatten().count()), (20, 20));
    assert!(messages.iter().flatten().is_sorted(), "{messages:?}");
    assert_eq!(runs[0], runs[1], "the same run again");
}

#[test]
fn log_read_04_program_in_c_finds_the_newest_entry_first_and_each_return_code_of_the_standard() {
    let _turn = among_others();
    for flags in [&[][..], &["-DAPEX_IDENTIFIER_BITS=64"]] {
        let folder = tempfile::tempdir().unwrap();
        let keys = "threads = 2\n[partition.scribe.logbook]\nevents = { max_size = 8, max_logged = 4, max_in_progress = 2 }\n\
                    single = { max_size = 8, max_logged = 4, max_in_progress = 1 }";
        let program = compile_c("logbooks", folder.path(), "scribe", flags);
        let schedule = Sketch::new().partition_at("scribe", &program, 1000, keys).write(folder.path());
        let ended = fast(&schedule, &[]).expect_code(0);
        assert!(ended.stderr.contains("scribe: done"), "{}", ended.stderr);
        assert!(!ended.stderr.contains("FAILED") && ended.faults().is_empty(), "{}", ended.stderr);
    }
}

#[test]
fn messages_that_replace_others_and_logbooks_that_are_emptied_are_on_the_disk_as_the_partition_has_them() {
    let _turn = among_others();
    for how in ["overwrite", "clear", "flood"] {
        let folder = tempfile::tempdir().unwrap();
        let output = folder.path().join("run");
        let output = output.to_str().unwrap();
        let ended = fast(&scribe(folder.path(), how, "", ""), &["--output", output]).expect_code(0);
        assert!(!ended.stderr.contains("FAILED"), "{how}: {}", ended.stderr);
        let messages = printed(output);
        assert!((1..=20).contains(&messages.len()), "{how}: {messages:?}");
        assert!(
            messages.iter().all(|message| message.as_ref().is_some_and(|text| text.starts_with("entry")))
        );
    }
}

#[test]
fn plan_without_a_logbook_and_a_file_that_is_none_are_told_in_words() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().to_str().unwrap();
    bateleur(&["logbook", path]).end().expect_code(2).expect_words(&["there is no logbook"]);
    let file = folder.path().join("scribe.log");
    fs::write(&file, "something else").unwrap();
    bateleur(&["logbook", file.to_str().unwrap()]).end().expect_code(1).expect_words(&["it is no logbook"]);
    fs::write(folder.path().join("scribe.log.old"), "not gone on with").unwrap();
    bateleur(&["logbook", path]).end().expect_code(1).expect_words(&["it is no logbook"]);
    let both = ["run", "--fast", "--logbooks", path, "--schedule", "nowhere.toml"];
    bateleur(&both).end().expect_code(2).expect_words(&["--logbooks"]);
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    fn wall(schedule: &str, logbooks: &str, run: u32) -> bateleur_tests::Started {
        let output = format!("{logbooks}-run{run}");
        bateleur(&[
            "run",
            "--schedule",
            schedule,
            "--logbooks",
            logbooks,
            "--output",
            &output,
            "--until",
            "60",
        ])
    }

    #[test]
    fn what_was_stored_outlives_all_processes_of_the_module_killed_at_any_instant() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule = scribe(folder.path(), "flood", "", "");
        let logbooks = folder.path().join("kept");
        let logbooks = logbooks.to_str().unwrap();
        let mut last = 0;
        for (run, milliseconds) in (0..).zip([310, 470, 333, 601]) {
            let module = wall(&schedule, logbooks, run);
            await_some(Duration::from_secs(20), || module.said().contains("scribe: found ").then_some(()))
                .unwrap_or_else(|| panic!("{}", module.said()));
            std::thread::sleep(Duration::from_millis(milliseconds));
            let below = children_of(module.pid());
            module.signal(Signal::KILL);
            below.iter().for_each(|process| process.kill());
            let ended = module.end_within(Duration::from_secs(30));
            assert!(!ended.stderr.contains("FAILED"), "{}", ended.stderr);
            let before = found(&ended.stderr)[0][0];
            assert!(before >= last, "{before} where {last} was on the disk: {}", ended.stderr);
            let messages = printed(logbooks);
            let newest = messages.iter().flatten().next_back().unwrap();
            last = newest.trim_start_matches("entry").trim().parse().unwrap();
            assert!(last > before && messages.iter().flatten().is_sorted(), "{messages:?}");
        }
    }

    #[test]
    fn full_disk_stops_no_logbook_that_has_begun() {
        let _turn = alone();
        if !rustix::process::geteuid().is_root() {
            eprintln!("skipped: needs root, to mount a small disk");
            return;
        }
        let folder = tempfile::tempdir().unwrap();
        let small = folder.path().join("small");
        fs::create_dir(&small).unwrap();
        let mount = Command::new("mount").args(["-t", "tmpfs", "-o", "size=4m", "none"]).arg(&small).status();
        assert!(mount.unwrap().success());
        let logbooks = small.join("kept");
        let logbooks = logbooks.to_str().unwrap();
        let module = wall(&scribe(folder.path(), "write", "", ""), logbooks, 0);
        let begun =
            await_some(Duration::from_secs(20), || module.said().contains("scribe: found ").then_some(()));
        let filled = fs::write(small.join("filler"), vec![1; 8 << 20]);
        std::thread::sleep(Duration::from_secs(1));
        module.signal(Signal::TERM);
        let ended = module.end_within(Duration::from_secs(30));
        let messages = printed(logbooks);
        let _ = Command::new("umount").arg("--lazy").arg(&small).status(); // the folder goes either way
        assert!(begun.is_some() && filled.is_err(), "{}", ended.stderr);
        assert!(!ended.stderr.contains("FAILED") && !ended.stderr.contains("logbook "), "{}", ended.stderr);
        let newest = messages.iter().flatten().next_back().unwrap();
        let newest: u64 = newest.trim_start_matches("entry").trim().parse().unwrap();
        assert!(newest >= 40, "{newest}");
    }
}
