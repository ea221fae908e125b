//! Partitions written with the traits of `a653rs`, under the executive.

use bateleur_tests::{Fault, Sketch, among_others, bateleur, channel_between};

/// Each checks itself: it panics where something fails, and reports `done`.
#[test]
fn p4_09_partitions_written_for_another_hypervisor_run() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let messages = folder.path().join("messages");
    std::fs::create_dir(&messages).unwrap();
    std::fs::write(messages.join("Number.msg"), "float64 number\n").unwrap();
    let sampling = |partition: &str, input: &str, output: &str, refresh: &str| {
        format!(
            "threads = 3\n[partition.{partition}.port]\n\
             {input} = {{ direction = \"destination\", kind = \"sampling\", message = \"Number\", refresh = \"{refresh}\" }}\n\
             {output} = {{ direction = \"source\", kind = \"sampling\", message = \"Number\" }}"
        )
    };
    let queues = |partition: &str, questions: &str, answers: &str| {
        let depth = |direction: &str| if direction == "source" { "" } else { ", depth = 4" };
        format!(
            "threads = 2\n[partition.{partition}.port]\n\
             questions = {{ direction = \"{questions}\", kind = \"queuing\", max_size = 16{} }}\n\
             answers = {{ direction = \"{answers}\", kind = \"queuing\", max_size = 32{} }}",
            depth(questions),
            depth(answers)
        )
    };
    let partitions = [
        ("hello", "threads = 3".to_owned()),
        ("ping", sampling("ping", "in", "out", "100ms")),
        ("pong", sampling("pong", "in", "out", "100ms")),
        ("asker", queues("asker", "source", "destination")),
        ("answerer", queues("answerer", "destination", "source")),
        ("tank", sampling("tank", "opening", "level", "60ms")),
        ("gauge", sampling("gauge", "level", "wanting", "60ms")),
        ("valve", sampling("valve", "wanting", "opening", "60ms")),
        ("dice", "threads = 2".to_owned()),
        ("objects", "threads = 3".to_owned()),
        ("processes", "threads = 4".to_owned()),
        ("errors", "threads = 3".to_owned()),
        ("blocks", "threads = 2\nmay_set_schedule = true".to_owned()),
    ];
    let channels = [
        ("ping.out", "pong.in"),
        ("pong.out", "ping.in"),
        ("asker.questions", "answerer.questions"),
        ("answerer.answers", "asker.answers"),
        ("tank.level", "gauge.level"),
        ("gauge.wanting", "valve.wanting"),
        ("valve.opening", "tank.opening"),
    ];
    let tables: String = channels.iter().map(|(from, to)| channel_between(from, to)).collect();
    let block = "[memory_block.map]\nsize = \"4KiB\"\ncontent = \"map\"\nread_write = [\"blocks\"]\n";
    std::fs::write(folder.path().join("map"), "map").unwrap();
    let tables = tables + block;
    let sketch = partitions.iter().fold(Sketch::new().table(&tables), |sketch, (name, keys)| {
        sketch.partition(name, "a653rs_partitions", 1000, keys)
    });
    let schedule = sketch.write(folder.path());
    let ended = bateleur(&["run", "--fast", "--until", "2", "--schedule", &schedule]).end().expect_code(0);
    for (name, _) in &partitions {
        let log = std::fs::read_to_string(ended.folder().join(format!("partitions/{name}.log")));
        let said = ended.stderr.contains(&format!("{name}: done"));
        assert!(said, "{name} is not done:\n{}\n{}", ended.stderr, log.unwrap_or_default());
    }
    // One raises errors on purpose, of which its own handler is told.
    let faults = ended.faults();
    assert!(!faults.is_empty());
    let expected = |fault: &Fault| (&*fault.partition, &*fault.action) == ("errors", "error_handler");
    assert!(faults.iter().all(expected), "{faults:?}");
    let log = std::fs::read_to_string(ended.folder().join("partitions/hello.log")).unwrap();
    assert!(log.contains("INFO  hello in round 49"), "{log}");
    let warned = ended.stderr.contains("hello: a warning is seen from outside");
    assert!(warned && !ended.stderr.contains("hello in round"), "{}", ended.stderr);
}
