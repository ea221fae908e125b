//! The schedule files that these tests generate meet the schema that editors hold against them.

#[path = "../../executive/checker/tests/plan_support/schema_check.rs"]
mod schema_check;

use bateleur_tests::{Sketch, bateleur};
use schema_check::{STRUCTURAL, fault_in};

#[test]
fn a_sketch_meets_the_schema_and_one_with_an_unknown_key_does_not() {
    let schema = bateleur(&["schema"]).end().expect_code(0).summary();
    let keys = "retained = \"4KiB\"\nstandby = \"hot\"\nhealth = { exit = \"stop\" }\nattributes = { busy_us = 3 }\n\
                restart = { start = \"warm\", budget = 5, within = \"10s\", then = \"idle\" }\n\
                [partition.one.port]\ncount = { direction = \"source\", kind = \"sampling\", message = \"FunctionStatus\" }";
    let port = "[partition.two.port]\nheard = { direction = \"destination\", kind = \"sampling\", message = \"FunctionStatus\", refresh = \"40ms\" }";
    let channel = "[[channel]]\nsource = \"one.count\"\ndestinations = [\"two.heard\"]";
    let sketch = Sketch::new()
        .table(channel)
        .partition("one", "counter", 500, keys)
        .partition("two", "counter", 500, port);
    assert_eq!(fault_in(&schema, &sketch.text()), None, "{}", sketch.text());
    let wrong = sketch.partition("three", "counter", 500, "colour = 1");
    let fault = fault_in(&schema, &wrong.text());
    assert_eq!(fault.as_deref(), Some(".partition.three.colour: no such key"));
    let folder = tempfile::tempdir().unwrap();
    let refused = bateleur(&["check", &wrong.write(folder.path())]).end().expect_code(2);
    assert!(STRUCTURAL.iter().any(|rule| refused.stdout.contains(rule)), "{}", refused.stdout);
}
