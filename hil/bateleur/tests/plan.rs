//! What `bateleur plan` prints, and how it ends.

#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod support;

use support::{assert_golden, bateleur, repository};

const NEEDS: &str = "hil/bateleur/tests/needs/flight.toml";

#[test]
fn the_nine_partitions_are_planned_and_pass_the_checker() {
    let ended = bateleur(&["plan", NEEDS]);
    assert_eq!((ended.code, ended.stderr.as_str()), (0, ""));
    assert_golden("plan.txt", &ended.stdout);
    let folder = tempfile::tempdir().unwrap();
    let planned = folder.path().join("planned.toml");
    let ended = bateleur(&["plan", NEEDS, "--output", planned.to_str().unwrap()]);
    assert_eq!((ended.code, ended.stdout.as_str()), (0, ""));
    // Pasted over the schedule that is there.
    let text = std::fs::read_to_string(repository().join("schedule.toml")).unwrap();
    let (head, rest) = text.split_once("[schedule.flight]").unwrap();
    let (_, tail) = rest.split_once("\n]\n").unwrap();
    let pasted = folder.path().join("pasted.toml");
    std::fs::write(&pasted, [head, &std::fs::read_to_string(planned).unwrap(), tail].concat()).unwrap();
    let checked = bateleur(&["check", pasted.to_str().unwrap(), "--deny", "warnings"]);
    assert_eq!(checked.code, 0, "{}", checked.stdout);
}

fn plan_with(change: impl Fn(&str) -> String) -> support::Ended {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("needs.toml");
    std::fs::write(&path, change(&std::fs::read_to_string(repository().join(NEEDS)).unwrap())).unwrap();
    bateleur(&["plan", path.to_str().unwrap()])
}

#[test]
fn an_over_full_core_is_refused_with_how_much_too_much_it_is() {
    let ended = plan_with(|text| text.replace("duration = \"2ms\" }", "duration = \"9ms\" }"));
    assert_eq!((ended.code, ended.stdout.as_str()), (1, ""));
    assert_eq!(
        ended.stderr,
        "there is no such schedule: core 1 of `fcu` would have to give 24.1ms in each 20ms, which is 4.1ms too much\n"
    );
}

#[test]
fn needs_that_make_no_sense_are_refused_with_a_way_to_mend_them() {
    for (old, new, words) in [
        ("imu ", "imuu ", "there is no partition `imuu`: did you mean `imu`?"),
        (
            "command          = { period = \"20ms\", duration = \"2ms\" }\n",
            "",
            "partition `command` has no need",
        ),
        ("\"600us\"", "\"600\"", "`600` is not a time: it has no unit"),
        ("duration = \"600us\"", "length = \"600us\"", "there is no key `length`"),
        ("offset = \"12ms\"", "core = 3", "core 3, which module `fcu` does not have"),
        ("duration = \"600us\"", "duration = \"0ms\"", "the duration of `servo` is zero"),
    ] {
        let ended = plan_with(|text| text.replacen(old, new, 1));
        assert_eq!(ended.code, 2, "{}", ended.stdout);
        assert!(ended.stderr.contains(words), "{words}:\n{}", ended.stderr);
    }
}
