//! A schedule that is fine, broken in one place: the rule that guards that place answers, wherever the place is. The
//! JSON schema takes what is fine, and of what is broken all that is sound in its structure.

// A test may be blunt: a panic is how it fails.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod plan_support;

use std::fmt::Write;

use bateleur_checker::schema;
use bateleur_plan::compiled::Compiled;
use bateleur_plan::{Closed, PartitionError};
use plan_support::answer_to;
use plan_support::schema_check::{STRUCTURAL, fault_in};
use proptest::prelude::*;

/// A valid file: partitions in a row of windows, each with a sampling channel and a chain to the next.
fn valid(lengths_us: &[u64]) -> String {
    let mut text = "[module.fcu]\ncores = [1]\n".to_owned();
    let mut windows = String::new();
    for n in 0..lengths_us.len() {
        writeln!(
            text,
            "[partition.p{n}]\nprogram = \"p{n}\"\nmodule = \"fcu\"\nmemory = \"8MiB\"\n[partition.p{n}.port]"
        )
        .unwrap();
        if n > 0 {
            writeln!(text, "in{n} = {{ direction = \"destination\", kind = \"sampling\", message = \"Rates\", refresh = \"40ms\" }}").unwrap();
        }
        if n + 1 < lengths_us.len() {
            writeln!(text, "out{n} = {{ direction = \"source\", kind = \"sampling\", message = \"Rates\" }}")
                .unwrap();
            let next = n + 1;
            writeln!(windows, "[[channel]]\nsource = \"p{n}.out{n}\"\ndestinations = [\"p{next}.in{next}\"]")
                .unwrap();
            writeln!(windows, "[[chain]]\nname = \"c{n}\"\npath = [\"p{n}.out{n}\", \"p{next}.in{next}\"]\nmax_age = \"20ms\"").unwrap();
        }
    }
    text.push_str(&windows);
    text.push_str("[schedule.s]\nmajor_frame = \"80ms\"\nminor_frame = \"20ms\"\nwindow = [\n");
    let mut start = 0;
    for (n, length) in lengths_us.iter().enumerate() {
        writeln!(text, "{{ partition = \"p{n}\", offset = \"{start}us\", duration = \"{length}us\" }},")
            .unwrap();
        start += length;
    }
    text + "]\n"
}

fn rules(text: &str) -> Vec<&'static str> {
    let report = match answer_to("mutated.toml", text) {
        Ok((plan, report)) => {
            Compiled::new("mutated.toml", text, plan)
                .write()
                .expect("what the checker lets through is compiled");
            report
        }
        Err(report) => report,
    };
    report.violations().iter().map(|violation| violation.rule).collect()
}

/// Levels at which no error handler has anything to do.
const NONE_LEFT: &str = "port_error = \"partition\"\napplication_error = \"module\"\ndeadline_missed = \"partition\"\n\
     window_overrun = { normal = \"partition\" }";

/// Each rule with what breaks it at partition `n`, in a file whose window of `n` is `length` long.
fn mutations(n: usize, length: u64) -> Vec<(&'static str, String, String)> {
    let window = |rest: &str| format!("partition = \"p{n}\", {rest}");
    let table = format!("[partition.p{n}]\nprogram = \"p{n}\"\nmodule = \"fcu\"\nmemory = \"8MiB\"");
    let tables = |old: &str, new: &str| (table.clone(), table.replace(old, new));
    let levels = |levels: &str, keys: &str| {
        let mutated = table.replace("memory", &format!("{keys}memory"));
        (table.clone(), format!("[health.level]\n{levels}\n{mutated}"))
    };
    let one = |rule, (old, new): (String, String)| (rule, old, new);
    vec![
        one("S02-unknown-key", tables("memory", "colour = 1\nmemory")),
        one("S03-wrong-type", tables("\"fcu\"", "7")),
        one("S04-missing-key", tables("module = \"fcu\"\n", "")),
        one("S06-bad-size", tables("8MiB", "1")),
        one("N06-unknown-module", tables("\"fcu\"", "\"aft\"")),
        one("R01-memory-zero", tables("8MiB", "0B")),
        one("R04-retained-too-large", tables("memory", "retained = \"9MiB\"\nmemory")),
        one("R05-zero-time", tables("memory", "startup_timeout = \"0s\"\nmemory")),
        one("R07-standby-memory", tables("memory", "standby = \"hot\"\nmemory")),
        one("H10-standby-without-restart", tables("memory", &without_restart("standby = \"hot\"\nmemory"))),
        one("R11-too-few-threads", tables("memory", "threads = 2\nprocesses = 2\nmemory")),
        one("R12-stacks-too-large", tables("memory", "stacks = \"9MiB\"\nmemory")),
        one("R14-processes-standby", tables("memory", "processes = 2\nstandby = \"hot\"\nmemory")),
        one("T25-period-not-divisor", tables("memory", "period = \"30ms\"\nmemory")),
        one("T27-duration-short", tables("memory", "duration = \"9ms\"\nmemory")),
        one("T28-duration-exceeded", tables("memory", "duration = \"1us\"\nmemory")),
        one("T29-period-without-window", tables("memory", "period = \"10ms\"\nmemory")),
        one("A01-process-period", tables("memory", &process("period = \"30ms\", wcet = \"10us\""))),
        one(
            "A02-deadline-after-period",
            tables("memory", &process("period = \"20ms\", deadline = \"21ms\", wcet = \"10us\"")),
        ),
        one(
            "A04-response-too-late",
            tables("memory", &process("period = \"20ms\", deadline = \"9us\", wcet = \"10us\"")),
        ),
        one(
            "A05-response-unbounded",
            tables("memory", &process("period = \"20ms\", deadline = \"20ms\", wcet = \"19ms\"")),
        ),
        one("R06-program-missing", tables("program = \"", "program = \"nowhere/")),
        one("H11-illegal-level", levels("killed = \"process\"", "")),
        one("H12-process-without-handler", levels("port_error = \"process\"", "")),
        one("H13-handler-unused", levels(NONE_LEFT, "error_handler = true\n")),
        one("H14-answer-unused", levels("exit = \"module\"", "health = { exit = \"stop\" }\n")),
        one("H15-module-for-partition", levels("exit = \"module\"", "")),
        one("N01-bad-name", (format!("[partition.p{n}]"), format!("[partition.\"p {n}\"]"))),
        one("N03-unknown-partition", (window("offset"), "partition = \"nobody\", offset".to_owned())),
        one("T05-minor-out-of-range", (window("offset"), window("minor = [4], offset"))),
        one("T07-core-not-in-module", (window("offset"), window("core = 2, offset"))),
        one("T15-minor-twice", (window("offset"), window("minor = [0, 2, 0], offset"))),
        one("T17-uneven-minor", (window("offset"), window("minor = [0, 1], offset"))),
        one(
            "T04-window-outside-frame",
            (format!("duration = \"{length}us\""), "duration = \"21ms\"".to_owned()),
        ),
        one("T01-zero-duration", (format!("duration = \"{length}us\""), "duration = \"0us\"".to_owned())),
        one("S05-bad-duration", (format!("duration = \"{length}us\""), format!("duration = \"{length}\""))),
        one("T06-major-not-multiple", ("\"80ms\"".to_owned(), "\"81ms\"".to_owned())),
    ]
}

/// A process with these times, before the memory of its partition.
fn process(times: &str) -> String {
    format!("process = {{ only = {{ priority = 7, {times} }} }}\nmemory")
}

/// What stands before `rest` in a partition that nothing restarts.
fn without_restart(rest: &str) -> String {
    let stops: Vec<String> =
        PartitionError::ALL.iter().map(|error| format!("{} = \"stop\"", error.name())).collect();
    format!("health = {{ {} }}\n{rest}", stops.join(", "))
}

/// The same for what lies between partition `n` and the next.
fn link_mutations(n: usize) -> Vec<(&'static str, String, String)> {
    let next = n + 1;
    let channel = format!("source = \"p{n}.out{n}\"\ndestinations = [\"p{next}.in{next}\"]");
    let chain = format!("path = [\"p{n}.out{n}\", \"p{next}.in{next}\"]\nmax_age = \"20ms\"");
    let input = format!(
        "in{next} = {{ direction = \"destination\", kind = \"sampling\", message = \"Rates\", refresh = \"40ms\" }}"
    );
    let change = |whole: &String, old: &str, new: &str| (whole.clone(), whole.replace(old, new));
    let one = |rule, (old, new): (String, String)| (rule, old, new);
    vec![
        one("N04-unknown-port", change(&channel, "source = \"p", "source = \"q")),
        one("C08-no-destination", (channel.clone(), format!("source = \"p{n}.out{n}\"\ndestinations = []"))),
        one(
            "C06-destination-twice",
            change(
                &channel,
                "source",
                &format!(
                    "source = \"p{n}.out{n}\"\ndestinations = [\"p{next}.in{next}\"]\n[[channel]]\nsource"
                ),
            ),
        ),
        one("C04-message-mismatch", change(&input, "Rates", "State")),
        one("N05-unknown-message", change(&input, "Rates", "Ratez")),
        one(
            "C03-kind-mixed",
            change(
                &input,
                "\"sampling\", message = \"Rates\", refresh = \"40ms\"",
                "\"queuing\", message = \"Rates\", depth = 1",
            ),
        ),
        one("C02-destination-direction", change(&input, "destination", "source")),
        one("P02-refresh-missing", change(&input, ", refresh = \"40ms\"", "")),
        one("P03-refresh-zero", change(&input, "40ms", "0ms")),
        one("P10-refresh-too-short", change(&input, "40ms", "10ms")),
        one("P06-misplaced-key", change(&input, "refresh", "depth = 1, refresh")),
        one("S08-unknown-word", change(&input, "\"sampling\"", "\"samples\"")),
        one("L03-chain-zero-age", change(&chain, "20ms", "0ms")),
        one("L04-chain-too-old", change(&chain, "20ms", "1us")),
        one("L02-chain-too-short", change(&chain, &format!(", \"p{next}.in{next}\""), "")),
        one(
            "L01-chain-disconnected",
            (chain.clone(), format!("path = [\"p{next}.in{next}\", \"p{n}.out{n}\"]\nmax_age = \"20ms\"")),
        ),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn every_mutation_of_a_valid_file_breaks_the_rule_that_it_is_made_for(
        // Lengths that differ, so that a window is found by its own.
        lengths in proptest::sample::subsequence((200..1800).step_by(100).collect::<Vec<u64>>(), 2..10),
        place in 0_usize..100,
    ) {
        let text = valid(&lengths);
        prop_assert_eq!(rules(&text), Vec::<&str>::new(), "{}", text);
        let schema = schema();
        prop_assert_eq!(fault_in(&schema, &text), None, "{}", text);
        let n = place % lengths.len();
        let link = link_mutations(place % (lengths.len() - 1));
        for (rule, old, new) in mutations(n, lengths[n]).into_iter().chain(link) {
            prop_assert!(text.contains(&old), "{}: {}\n{}", rule, old, text);
            let broken = text.replacen(&old, &new, 1);
            let found = rules(&broken);
            prop_assert!(found.contains(&rule), "{} in {:?}\n{}", rule, found, broken);
            // Names and ranges are not for a schema to see.
            let structural = found.iter().any(|id| STRUCTURAL.iter().any(|rule| id.starts_with(rule)));
            let fault = fault_in(&schema, &broken);
            prop_assert_eq!(fault.is_some(), structural, "{}: {:?}\n{}", rule, fault, broken);
        }
    }
}
