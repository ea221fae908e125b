//! Why was it late: whoever takes a processor from a module is named, by the kernel's own trace.

use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use bateleur_system::sched;
use bateleur_system::time::{now_ns, spin_until_ns};
use bateleur_system::trace;
use bateleur_tests::{ORDINARY, PATIENCE, Sketch, alone, await_some, bateleur, bateleur_as_ordinary};
use rustix::process::Signal;
use serde_json::Value;

const CORE: u32 = 1;

fn may_trace() -> bool {
    trace::lacking().inspect(|why| eprintln!("not tried: {why}")).is_none()
}

fn answers(folder: &Path) -> Vec<Value> {
    let ended = bateleur(&["why", folder.to_str().unwrap(), "--format", "json"]).end().expect_code(0);
    serde_json::from_str(&ended.stdout).unwrap()
}

fn number(answer: &Value, key: &str) -> f64 {
    answer[key].as_f64().unwrap_or_else(|| panic!("{key} of {answer}"))
}

/// Takes the processor for random times, above everybody, until it is told to stop; gives the times, CLOCK_MONOTONIC, s.
fn hog(stop: &AtomicBool) -> Vec<(f64, f64)> {
    sched::bind(0, &[CORE]).unwrap();
    sched::fifo(0, 99).unwrap();
    let (mut bursts, mut seed) = (Vec::new(), 19_u64);
    while !stop.load(Ordering::Relaxed) {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        std::thread::sleep(Duration::from_micros(50_000 + (seed >> 33) % 40_000));
        let begun = now_ns();
        spin_until_ns(begun + 8_000_000 + (seed >> 40) % 14_000_000);
        bursts.push((begun as f64 / 1e9, now_ns() as f64 / 1e9));
    }
    bursts
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn thread_that_takes_the_processor_above_the_dispatcher_is_named_with_its_priority() {
        if !may_trace() {
            return;
        }
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule = Sketch::new()
            .partition("first", "counter", 2_000, "")
            .partition("second", "counter", 2_000, "attributes = { busy_us = 1000 }")
            .write(folder.path());
        let output = folder.path().join("run");
        let mut module = bateleur(&[
            "run",
            "--schedule",
            &schedule,
            "--until",
            "1000",
            "--output",
            output.to_str().unwrap(),
        ]);
        module.await_words("2 partitions are ready");
        let stop = Arc::new(AtomicBool::new(false));
        let told = stop.clone();
        let thread = std::thread::Builder::new().name("hog".into()).spawn(move || hog(&told)).unwrap();
        let enough = || {
            let text = std::fs::read_to_string(output.join("why.jsonl")).unwrap_or_default();
            let of_it = text.lines().filter(|line| line.contains("\"name\":\"hog\",\"tid\"")).count();
            (of_it >= 40).then_some(())
        };
        let seen = await_some(PATIENCE, enough);
        stop.store(true, Ordering::Relaxed);
        let bursts = thread.join().unwrap();
        module.signal(Signal::INT);
        module.end().expect_code(0);
        let answers = answers(&output);
        assert!(seen.is_some(), "{} bursts and {} answers", bursts.len(), answers.len());
        let is_named = |answer: &&Value| answer["taker"] == "thread" && answer["name"] == "hog";
        let named: Vec<&Value> = answers.iter().filter(is_named).collect();
        // How much of the time that an answer is about it had the processor.
        let part = |answer: &Value| {
            let (from, length) = (number(answer, "monotonic_s"), number(answer, "span_ms") / 1e3);
            let of = |(begun, ended): &(f64, f64)| (ended.min(from + length) - begun.max(from)).max(0.0);
            bursts.iter().map(of).sum::<f64>() / length
        };
        for answer in &named {
            assert!(part(answer) > 0.0, "it was asleep: {answer}");
        }
        let provoked: Vec<&Value> = answers.iter().filter(|answer| part(answer) > 0.6).collect();
        let wrong: Vec<&&Value> = provoked.iter().filter(|answer| !is_named(answer)).collect();
        assert!(provoked.len() >= 20 && wrong.len() * 20 <= provoked.len(), "{}: {wrong:#?}", provoked.len());
        assert!(named.iter().all(|answer| answer["priority"] == "real-time priority 99"));
        let sentences = bateleur(&["why", output.to_str().unwrap(), "-n", "300"]).end().expect_code(0).stdout;
        assert!(sentences.contains("thread hog of process "), "{sentences}");
    }

    #[test]
    fn partition_that_computes_on_or_waits_for_something_else_is_told_so_and_nobody_else_is_blamed() {
        if !may_trace() {
            return;
        }
        let _turn = alone();
        for (how, taker, words) in
            [("spin", "itself", "it computed for "), ("sleep", "nobody", "it waited for something else")]
        {
            let folder = tempfile::tempdir().unwrap();
            let keys = format!("attributes = {{ how = \"{how}\", after = 10 }}");
            let schedule = Sketch::new().partition("hanger", "hanger", 4_000, &keys).write(folder.path());
            let output = folder.path().join("run");
            let module = bateleur(&[
                "run",
                "--schedule",
                &schedule,
                "--until",
                "1000",
                "--output",
                output.to_str().unwrap(),
            ]);
            let silent = await_some(PATIENCE, || module.said().contains("hanger: silence").then_some(()));
            module.signal(Signal::INT);
            module.end().expect_code(0);
            assert!(silent.is_some());
            let answers = answers(&output);
            let of = |kind| answers.iter().filter(|one| one["kind"] == kind).collect::<Vec<_>>();
            let (overruns, silences) = (of("overrun"), of("silence"));
            assert!(overruns.len() >= 10 && !silences.is_empty(), "{answers:#?}");
            // The machine may take a window of some.
            let right = overruns.iter().filter(|one| one["taker"] == taker).count();
            assert!(right * 10 >= overruns.len() * 7, "{how}: {overruns:#?}");
            let text = bateleur(&["why", output.to_str().unwrap()]).end().expect_code(0).stdout;
            assert!(text.contains("hanger was silent on core 1") && text.contains(words), "{text}");
        }
    }

    #[test]
    fn trace_of_a_run_that_ends_or_is_killed_is_removed() {
        if !may_trace() {
            return;
        }
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule = Sketch::new().partition("quiet", "counter", 500, "").write(folder.path());
        for signal in [Signal::INT, Signal::KILL] {
            let mut module = bateleur(&["run", "--schedule", &schedule, "--until", "1000"]);
            module.await_words("1 partition is ready");
            let run = format!("bateleur.test.{}", module.pid());
            assert!(await_some(PATIENCE, || trace::exists(&run).then_some(())).is_some(), "{run} is traced");
            module.signal(signal);
            let _ = module.end();
            let gone = await_some(PATIENCE, || (!trace::exists(&run)).then_some(()));
            assert!(gone.is_some(), "{run} after {signal:?}");
        }
    }

    #[test]
    fn without_a_trace_the_answer_is_who_used_the_processor_and_says_so() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        std::os::unix::fs::chown(folder.path(), Some(ORDINARY), None).unwrap();
        let keys = "attributes = { how = \"spin\", after = 10 }";
        let schedule = Sketch::new().partition("hanger", "hanger", 4_000, keys).write(folder.path());
        let output = folder.path().join("run");
        let run = ["run", "--schedule", &schedule, "--until", "1000", "--output", output.to_str().unwrap()];
        let module = bateleur_as_ordinary(&run);
        let silent = await_some(PATIENCE, || module.said().contains("hanger: silence").then_some(()));
        module.signal(Signal::INT);
        module.end().expect_code(0);
        assert!(silent.is_some());
        let answers = answers(&output);
        let silences: Vec<_> = answers.iter().filter(|one| one["kind"] == "silence").collect();
        assert!(
            !silences.is_empty() && answers.iter().all(|one| one["source"] == "counters"),
            "{answers:#?}"
        );
        let text = bateleur(&["why", output.to_str().unwrap()]).end().expect_code(0).stdout;
        assert!(text.contains("hanger was silent on core 1"), "{text}");
    }
}
