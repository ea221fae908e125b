//! What is seen from outside of a partition of several processes: who ran when, how each is, and their errors.

use std::collections::BTreeMap;
use std::time::Duration;

use bateleur_tests::{Ended, Sketch, alone, among_others, await_some, bateleur};
use serde_json::Value;

/// Runs partition `own` of several processes beside another one, on the virtual clock.
fn run(tables: &str, keys: &str) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let sketch = Sketch::new()
        .table(tables)
        .partition("own", "processes", 2000, keys)
        .partition("other", "counter", 1000, "");
    let schedule = sketch.write(folder.path());
    bateleur(&["run", "--fast", "--record", "--until", "2", "--schedule", &schedule]).end().expect_code(0)
}

/// The lines of `processes.csv`: process, from, to.
fn spans(ended: &Ended) -> Vec<(String, u64, u64)> {
    let text = std::fs::read_to_string(ended.folder().join("processes.csv")).unwrap();
    let mut lines = text.lines();
    assert_eq!(lines.next(), Some("partition,process,from_ns,to_ns"));
    let span = |line: &str| {
        let [partition, process, from, to]: [&str; 4] =
            line.split(',').collect::<Vec<_>>().try_into().unwrap();
        assert_eq!(partition, "own", "the other partition is one loop");
        (process.to_owned(), from.parse().unwrap(), to.parse().unwrap())
    };
    lines.map(span).collect()
}

#[test]
fn who_ran_when_lies_in_the_windows_and_is_the_same_in_each_run_and_a_lane_of_the_trace() {
    let _turn = among_others();
    let ended = run("", "threads = 5\nattributes = { fails = true }");
    let found = spans(&ended);
    assert!(found.windows(2).all(|pair| pair[0].2 <= pair[1].1), "one at a time");
    let windows: Vec<(u64, u64)> = ended
        .windows()
        .iter()
        .filter(|window| window.partition == "own")
        .map(|window| (window.planned_start_ns, window.planned_end_ns))
        .collect();
    for (process, from, to) in &found {
        let inside = windows.iter().any(|(start, end)| start <= from && *to <= end + 1_000);
        assert!(inside && from < to, "{process} from {from} to {to}");
    }
    let mut times: BTreeMap<&str, usize> = BTreeMap::new();
    found.iter().for_each(|(process, ..)| *times.entry(process).or_default() += 1);
    assert_eq!(times.keys().copied().collect::<Vec<_>>(), ["error handler", "fails", "fast", "slow"]);
    assert!(times["fast"] >= 99 && times["slow"] >= 99 && times["error handler"] == 1, "{times:?}");
    assert_eq!(spans(&run("", "threads = 5\nattributes = { fails = true }")), found, "another run");

    let trace = ended.folder().join("trace.json");
    bateleur(&["export", ended.folder().to_str().unwrap(), "--chrome", trace.to_str().unwrap()])
        .end()
        .expect_code(0);
    let trace: Value = serde_json::from_str(&std::fs::read_to_string(trace).unwrap()).unwrap();
    let events = trace["traceEvents"].as_array().unwrap();
    let lane = events.iter().find(|event| event["args"]["name"] == "own: fast").expect("a lane");
    let own =
        |event: &&Value| event["ph"] == "X" && event["pid"] == lane["pid"] && event["tid"] == lane["tid"];
    assert_eq!(events.iter().filter(own).count(), times["fast"]);
}

#[test]
fn partitions_of_one_loop_leave_no_log_of_processes() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule = Sketch::new().partition("other", "counter", 1000, "").write(folder.path());
    let ended = bateleur(&["run", "--fast", "--until", "1", "--schedule", &schedule]).end().expect_code(0);
    assert!(!ended.folder().join("processes.csv").exists());
}

#[test]
fn error_that_a_process_level_handler_was_told_of_stands_in_the_health_log_with_the_process() {
    let _turn = among_others();
    let ended = run("", "threads = 5\nattributes = { fails = true }");
    let faults = ended.faults();
    let [fault] = faults.as_slice() else { panic!("{faults:#?}") };
    let found = [&fault.level, &fault.partition, &fault.error, &fault.action, &fault.detail];
    assert_eq!(found, ["process", "own", "illegal_request", "error_handler", "process fails"]);
}

#[test]
fn error_that_the_plan_leaves_to_the_module_does_not_reach_the_handler_of_processes() {
    let _turn = among_others();
    let tables =
        "[health.level]\nillegal_request = \"module\"\n[health.module]\npartition_error = \"ignore\"\n";
    let ended = run(tables, "threads = 5\nattributes = { fails = true }");
    let said = ended.stderr.clone() + &ended.stdout;
    assert!(said.contains("life 0") && !said.contains("IllegalRequest of process"), "{said}");
    let faults = ended.faults();
    let of_process = faults.iter().find(|fault| fault.error == "illegal_request").expect("an entry");
    assert_eq!((of_process.level.as_str(), of_process.detail.as_str()), ("module", "process fails"));
    assert!(!said.contains("life 1") && said.contains("fast 90 at"), "the others go on: {said}");
}

#[test]
fn process_that_is_not_as_in_the_plan_is_told_once_with_both() {
    let _turn = among_others();
    let keys = "processes = 3\n[partition.own.process]\n\
         fast = { priority = 25, period = \"40ms\", deadline = \"5ms\", wcet = \"100us\" }\n\
         slow = { priority = 10, wcet = \"100us\" }\n\
         ghost = { priority = 3, wcet = \"10us\" }\n";
    let ended = run("", keys);
    let said = ended.stderr.clone() + &ended.stdout;
    let differs = "own: process fast has priority 20 and not 25, period 20 ms and not 40 ms, deadline none and not 5 ms as in the plan";
    assert_eq!(said.matches(differs).count(), 1, "{said}");
    assert_eq!(said.matches("own: process ghost of the plan is not created by the program").count(), 1);
    assert!(!said.contains("process slow has"), "{said}");
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn processes_of_a_running_module_are_listed_with_state_priority_period_and_stack() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let keys = "threads = 6\nattributes = { computes = true, fails = true }";
        let schedule = Sketch::new().partition("own", "processes", 4000, keys).write(folder.path());
        let module = bateleur(&["run", "--until", "60", "--schedule", &schedule]);
        let pid = module.pid().to_string();
        let listed = await_some(Duration::from_secs(50), || {
            let ended = bateleur(&["ps", "--format", "json", "--module", &pid]).end();
            let listed: Value = serde_json::from_str(&ended.stdout).ok()?;
            let processes = listed["modules"][0]["partitions"][0]["processes"].as_array()?.clone();
            // The stacks are looked at a little in each window.
            let known = processes.iter().all(|process| process["stack_used_bytes"].is_u64());
            (known && processes.len() > 4).then_some(processes)
        });
        let listed = listed.expect("all stacks are known");
        let of = |name: &str| listed.iter().find(|process| process["name"] == name).expect(name).clone();
        let fast = of("fast");
        assert_eq!((&fast["priority"], &fast["period_ns"]), (&20.into(), &20_000_000.into()), "{fast}");
        assert_eq!((&fast["state"], &fast["starts"]), (&"waiting".into(), &1.into()), "{fast}");
        let computes = of("computes 0");
        assert_eq!(computes["state"], "running", "it goes on in the next window: {computes}");
        assert!(computes["run_ns"].as_u64() > fast["run_ns"].as_u64(), "{computes} {fast}");
        let fails = of("fails");
        assert_eq!(
            (&fails["state"], &fails["starts"], &fails["errors"]),
            (&"dormant".into(), &2.into(), &1.into())
        );
        assert!(of("error handler")["starts"] == 1);
        let stack = fast["stack_used_bytes"].as_u64().unwrap();
        assert!((256..64 << 10).contains(&stack), "{stack}");
        for verb in [&["ps"][..], &["top", "--once"]] {
            let table =
                bateleur(&[verb, &["--processes", "--module", &pid]].concat()).end().expect_code(0).stdout;
            assert!(table.contains("  fast ") && table.contains("STACK used/all"), "{table}");
        }
        module.signal(rustix::process::Signal::TERM);
        module.end().expect_code(0);
    }
}
