//! Messages that an operator writes into ports which the plan leaves to him.

use bateleur_tests::{Sketch, Started, alone, bateleur, channel_between};

/// `hand` is a program without ports whose ports are the operator's; `queuer` says how many messages it has heard.
fn schedule(folder: &std::path::Path) -> String {
    let hand = "[partition.hand.port]\n\
        out = { direction = \"source\", kind = \"queuing\", message = \"GroundMessage\", operator = true }\n\
        rate = { direction = \"source\", kind = \"sampling\", message = \"Rate\", operator = true }\n";
    let queuer = "[partition.queuer.port]\n\
        in = { direction = \"destination\", kind = \"queuing\", message = \"GroundMessage\", depth = 4 }\n";
    let reader = "[partition.reader.port]\n\
        rate = { direction = \"destination\", kind = \"sampling\", message = \"Rate\", refresh = \"1s\" }\n\
        other = { direction = \"source\", kind = \"sampling\", message = \"Rate\" }\n\
        back = { direction = \"destination\", kind = \"sampling\", message = \"Rate\", refresh = \"1s\" }\n";
    Sketch::new()
        .table(&channel_between("hand.out", "queuer.in"))
        .table(&channel_between("hand.rate", "reader.rate"))
        .table(&channel_between("reader.other", "reader.back"))
        .partition("hand", "counter", 1000, hand)
        .partition("queuer", "queuer", 1000, queuer)
        .partition("reader", "untyped", 1000, reader)
        .write(folder)
}

fn started(schedule: &str, options: &[&str]) -> Started {
    let mut module = bateleur(&[&["run", "--schedule", schedule, "--until", "60"], options].concat());
    module.await_words("3 partitions are ready");
    module
}

fn publish(module: &Started, arguments: &[&str]) -> bateleur_tests::Ended {
    let pid = module.pid().to_string();
    bateleur(&[&["ports", "pub", "--module", &pid], arguments].concat()).end()
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn operators_messages_reach_queues_and_sampling_ports_and_are_recorded() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let mut module = started(&schedule(folder.path()), &["--record"]);
        // More callers in a row than may be at work at once.
        for number in 1..=12 {
            publish(&module, &["hand.out", &format!("letter={number}")]).expect_code(0);
            module.await_words(&format!("queuer: heard {number}"));
        }
        let many =
            publish(&module, &["queuer.in", "letter=7", "--rate", "10", "--count", "5"]).expect_code(0);
        assert!(many.stdout.contains("#5 of "), "{}", many.stdout);
        module.await_words("queuer: heard 17");
        publish(&module, &["reader.rate", "--rate", "50", "--count", "30"]).expect_code(0);
        module.signal(rustix::process::Signal::INT);
        let ended = module.end().expect_code(0);
        assert!(ended.faults().is_empty(), "{:?}", ended.faults());
        let log = bateleur_recording::read(ended.folder().join("ports.mcap"), |_| true).unwrap();
        for (topic, message, least) in [("/hand/out", "GroundMessage", 17), ("/hand/rate", "Rate", 30)] {
            let seen = log.track(topic, message).map_or(0, |track| track.samples.len());
            assert!(seen >= least, "{topic}: {seen} messages");
        }
        let health = std::fs::read_to_string(ended.folder().join("health.jsonl")).unwrap();
        assert!(health.contains("messages for hand.out, by the operator"), "{health}");
    }

    #[test]
    fn operator_writes_into_no_port_of_a_partition_and_not_on_the_virtual_clock() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule = schedule(folder.path());
        let module = started(&schedule, &[]);
        let refused = |arguments: &[&str], words: &[&str]| {
            publish(&module, arguments).expect_code(2).expect_words(words);
        };
        refused(&["hand.out", "lettr=1"], &["no field lettr", "did you mean letter?"]);
        refused(&["hand.tuo"], &["did you mean `hand.out`"]);
        refused(&["hand.rate", "--bytes", "0011"], &["hand.rate has 56 bytes, not 2"]);
        refused(&["hand.out", "letter=300"], &["letter: 300 is not a whole number from 0 to 255"]);
        // What a partition writes is its own.
        refused(
            &["reader.other", "execute=1"],
            &["reader.other is its partition's to write", "operator = true"],
        );
        module.signal(rustix::process::Signal::INT);
        module.end().expect_code(0);
        let mut fast = bateleur(&["run", "--fast", "--schedule", &schedule, "--until", "1000000"]);
        fast.await_words("3 partitions are ready");
        publish(&fast, &["hand.rate"]).expect_code(2).expect_words(&["virtual clock"]);
        fast.signal(rustix::process::Signal::INT);
        fast.end();
    }
}
