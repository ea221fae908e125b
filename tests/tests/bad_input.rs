//! Wrong files and wrong words: a message that says where and how to mend it, exit code 2, and nothing started.

use bateleur_tests::{Ended, Sketch, bateleur, edited, flight_schedule, line_of};

fn schedule() -> String {
    flight_schedule().to_str().unwrap().to_owned()
}

fn fly(choices: &[&str]) -> Ended {
    let schedule = schedule();
    let mut arguments = vec!["fly", "--fast", "--schedule", &schedule];
    arguments.extend(choices);
    bateleur(&arguments).end()
}

/// Flies and runs the schedule with `old` replaced by `new`: both refuse it by `rule`, at the place of `at`.
fn assert_refused(old: &str, new: &str, at: &str, rule: &str) {
    let text = edited(&[(old, new)]);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("broken.toml");
    std::fs::write(&path, &text).unwrap();
    let line = line_of(&text, at);
    for verb in ["fly", "run"] {
        let ended = bateleur(&[verb, "--fast", "--schedule", path.to_str().unwrap()]).end().expect_code(2);
        assert!(
            ended.stderr.contains(&format!("broken.toml:{line}:")),
            "line {line} is not named:\n{}",
            ended.stderr
        );
        let ended = ended.expect_words(&[rule, "help:"]);
        assert!(ended.left_no_output(), "it wrote into its output folder");
        assert_eq!(ended.stdout, "");
        assert!(!ended.stderr.contains("partitions are ready"), "{}", ended.stderr);
    }
}

#[test]
fn windows_that_overlap_are_refused() {
    let moved = "{ partition = \"imu\",              offset = \"3.5ms\"";
    assert_refused("{ partition = \"imu\",              offset = \"3.8ms\"", moved, moved, "overlap");
}

#[test]
fn window_beyond_its_minor_frame_is_refused() {
    let moved = "{ partition = \"command\",          offset = \"19ms\"";
    assert_refused(
        "{ partition = \"command\",          offset = \"13ms\"",
        moved,
        moved,
        "T04-window-outside-frame",
    );
}

#[test]
fn window_of_an_unknown_partition_is_refused() {
    let wrong = "{ partition = \"servos\",            offset";
    assert_refused("{ partition = \"servo\",            offset", wrong, wrong, "unknown");
}

#[test]
fn minor_frame_that_does_not_divide_the_major_frame_is_refused() {
    assert_refused("minor_frame = \"20ms\"", "minor_frame = \"30ms\"", "_frame = ", "T06-major-not-multiple");
}

#[test]
fn duration_without_a_unit_is_refused() {
    assert_refused("duration = \"2.5ms\"", "duration = \"2.5\"", "duration = \"2.5\"", "duration");
}

#[test]
fn unknown_message_type_is_refused() {
    let wrong = "message = \"RawGpss\" }";
    assert_refused("message = \"RawGps\" }", wrong, wrong, "N05-unknown-message");
}

#[test]
fn channel_from_an_unknown_port_is_refused() {
    let wrong = "source       = \"hil_interface.raw_gsp\"";
    assert_refused("source       = \"hil_interface.raw_gps\"", wrong, wrong, "unknown");
}

#[test]
fn channel_between_different_messages_is_refused() {
    assert_refused(
        "destinations = [\"gps.raw\"]",
        "destinations = [\"imu.raw\"]",
        "destinations = [\"imu.raw\"]",
        "C0",
    );
}

#[test]
fn unknown_key_is_refused() {
    assert_refused("network    = true", "netwrok    = true", "netwrok", "unknown");
}

#[test]
fn missing_quote_is_refused() {
    assert_refused("program    = \"servo\"", "program    = \"servo", "program    = \"servo", "syntax");
}

#[test]
fn size_without_sense_is_refused() {
    assert_refused("retained   = \"16KiB\"", "retained   = \"16 potatoes\"", "potatoes", "size");
}

#[test]
fn action_that_does_not_exist_is_refused() {
    assert_refused(
        "silence           = \"warm_restart\"",
        "silence           = \"warmrestart\"",
        "warmrestart",
        "help",
    );
}

#[test]
fn two_sources_into_one_destination_are_refused() {
    let twice = "destinations = [\"controller.state\", \"estimator.pressure\", ";
    assert_refused("destinations = [\"controller.state\", ", twice, twice, "C0");
}

#[test]
fn empty_schedule_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("empty.toml");
    std::fs::write(&path, "").unwrap();
    let ended = bateleur(&["fly", "--fast", "--schedule", path.to_str().unwrap()]).end().expect_code(2);
    assert!(ended.expect_words(&["empty.toml"]).left_no_output());
}

#[test]
fn schedule_that_is_not_there_is_named() {
    let ended = bateleur(&["fly", "--fast", "--schedule", "nowhere.toml"]).end().expect_code(2);
    assert!(ended.expect_words(&["nowhere.toml", "--schedule"]).left_no_output());
}

#[test]
fn program_that_is_not_there_is_named_with_its_partition() {
    let text = edited(&[("program    = \"gps\"", "program    = \"./nowhere/gps\"")]);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("missing.toml");
    std::fs::write(&path, &text).unwrap();
    for verb in ["fly", "run"] {
        let ended = bateleur(&[verb, "--fast", "--schedule", path.to_str().unwrap()]).end().expect_code(2);
        ended.expect_words(&["partition gps", "nowhere/gps", "build it"]);
    }
}

#[test]
fn module_that_the_plan_has_not_is_named_with_those_that_it_has() {
    fly(&["--module", "fcc"]).expect_code(2).expect_words(&["no module \"fcc\"", "fcu"]);
}

#[test]
fn kill_of_nobody_is_refused_with_the_names_that_there_are() {
    fly(&["--kill", "nobody@10"]).expect_code(2).expect_words(&[
        "no partition \"nobody\"",
        "estimator",
        "command",
    ]);
}

#[test]
fn device_whose_path_leaves_the_folder_of_devices_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    for path in ["/dev/../etc/shadow", "/dev//null", "/dev/./null", "/dev/input/../../etc/shadow"] {
        let schedule = Sketch::new()
            .partition("one", "counter", 500, &format!("devices = [{path:?}]"))
            .write(folder.path());
        let checked = bateleur(&["check", "--deny", "warnings", &schedule]).end().expect_code(1);
        assert!(
            checked.stdout.contains("is no device") && checked.stdout.contains(path),
            "{}",
            checked.stdout
        );
    }
}

#[test]
fn kill_of_a_standby_that_the_plan_has_not_is_refused() {
    fly(&["--kill", "imu.standby@10"]).expect_code(2).expect_words(&["nothing stands by", "\"imu\""]);
}

#[test]
fn kill_without_a_time_is_refused_with_an_example() {
    fly(&["--kill", "estimator"]).expect_code(2).expect_words(&["PARTITION@SECONDS", "estimator@100"]);
}

#[test]
fn attribute_of_nobody_is_refused_with_the_names_that_there_are() {
    fly(&["--set", "nobody.x=1"]).expect_code(2).expect_words(&["no partition \"nobody\"", "estimator"]);
}

#[test]
fn unknown_attribute_is_refused_with_the_nearest_name() {
    let ended = fly(&["--set", "controller.lapz=1"]).expect_code(2);
    let ended = ended.expect_words(&["controller", "unknown attribute lapz", "did you mean laps"]);
    assert!(!ended.stderr.contains("partitions are ready"));
}

#[test]
fn attribute_of_another_type_is_refused_with_its_value() {
    fly(&["--set", "controller.laps=many"]).expect_code(2).expect_words(&[
        "controller",
        "attribute laps: expected a whole number from 0 on, found the text \"many\"",
    ]);
}

#[test]
fn broken_mission_is_refused_with_its_file_and_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mission.toml");
    std::fs::write(&path, "laps = 2\nwaypoint = [\n  { north_m = \"far\" },\n]\n").unwrap();
    let ended = fly(&["--mission", path.to_str().unwrap()]).expect_code(2);
    let ended = ended.expect_words(&["mission.toml", "line 3"]);
    assert!(ended.left_no_output());
    assert_eq!(ended.stderr.matches("line 3").count(), 1, "said once:\n{}", ended.stderr);
}

#[test]
fn mission_that_is_not_there_is_named() {
    let ended = fly(&["--mission", "nowhere.toml"]).expect_code(2).expect_words(&["nowhere.toml"]);
    assert!(ended.left_no_output());
}

#[test]
fn mission_without_way_points_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mission.toml");
    std::fs::write(&path, "waypoint = []\n").unwrap();
    fly(&["--mission", path.to_str().unwrap()]).expect_code(2).expect_words(&["way-points"]);
}

#[test]
fn airframe_that_is_not_there_is_named() {
    fly(&["--airframe", "zeppelin"]).expect_code(2).expect_words(&["zeppelin", "aerosonde"]);
}

#[test]
fn wrong_word_on_the_command_line_is_refused() {
    fly(&["--turbulence", "stormy"]).expect_code(2).expect_words(&["stormy", "calm"]);
}

#[test]
fn wind_from_beyond_the_compass_is_refused_with_an_example() {
    fly(&["--wind-from", "999"]).expect_code(2).expect_words(&["999", "degrees", "270"]);
    fly(&["--wind", "-5"]).expect_code(2).expect_words(&["between 0 and 50", "--wind-from"]);
}

/// A counter in a schedule of its own, for half a second of virtual time.
fn count(folder: &std::path::Path, choices: &[&str]) -> Ended {
    let schedule = Sketch::new().partition("counter", "counter", 1000, "").write(folder);
    let mut arguments = vec!["run", "--fast", "--until", "0.5", "--schedule", &schedule];
    arguments.extend(choices);
    bateleur(&arguments).end()
}

#[test]
fn kill_after_the_end_is_said_not_to_have_been_reached() {
    let folder = tempfile::tempdir().unwrap();
    let ended = count(folder.path(), &["--kill", "counter@0.2", "--kill", "counter@9999"]).expect_code(0);
    assert!(!ended.stderr.contains("counter@0.2"), "{}", ended.stderr);
    ended.expect_words(&["--kill counter@9999 was not reached", "0.50 s"]);
}

#[test]
fn run_ends_exactly_at_its_time_and_not_a_frame_later() {
    let folder = tempfile::tempdir().unwrap();
    let ended = count(folder.path(), &[]).expect_code(0).expect_words(&["stopped after 0.50 s"]);
    assert_eq!(ended.windows().len(), 25, "a window in each of 25 frames of 20 ms");
}

#[test]
fn folder_of_an_earlier_run_is_not_written_over() {
    let folder = tempfile::tempdir().unwrap();
    let earlier = folder.path().join("earlier");
    std::fs::create_dir(&earlier).unwrap();
    std::fs::write(earlier.join("summary.json"), "{}").unwrap();
    let name = earlier.to_str().unwrap();
    for verb in ["fly", "run"] {
        let ended = bateleur(&[verb, "--fast", "--schedule", &schedule(), "--output", name]);
        ended.end().expect_code(2).expect_words(&[name, "summary.json", "--output"]);
    }
    assert_eq!(std::fs::read_dir(&earlier).unwrap().count(), 1, "nothing was added");
}

#[test]
fn verbs_of_flights_refuse_a_plan_that_does_not_fly_before_they_begin() {
    let folder = tempfile::tempdir().unwrap();
    let schedule = Sketch::new().partition("one", "counter", 500, "").write(folder.path());
    let output = folder.path().join("output");
    for verb in ["fly", "campaign"] {
        let arguments = [verb, "--schedule", &schedule, "--output", output.to_str().unwrap()];
        let ended = bateleur(&arguments).end().expect_code(2);
        ended.expect_words(&[
            "no partition of the plan runs the program hil_interface",
            "`bateleur run` runs any plan",
        ]);
        let made = std::fs::read_dir(&output).map_or(0, Iterator::count);
        assert_eq!(made, 0, "{verb} has written something");
    }
}

#[test]
fn start_that_is_refused_leaves_the_last_run_as_it_was_and_a_script_is_no_program() {
    let _turn = bateleur_tests::among_others();
    let folder = tempfile::tempdir().unwrap();
    let sketch = Sketch::new().partition("one", "counter", 500, "");
    let schedule = sketch.write(folder.path());
    let output = folder.path().join("output");
    let run = [
        "run",
        "--fast",
        "--schedule",
        &schedule,
        "--until",
        "1",
        "--over",
        "--output",
        output.to_str().unwrap(),
    ];
    bateleur(&run).end().expect_code(0);
    let logs = || {
        ["windows.csv", "health.jsonl", "health.ring"].map(|name| std::fs::read(output.join(name)).unwrap())
    };
    let before = logs();
    let text = std::fs::read_to_string(&schedule).unwrap();
    let script = folder.path().join("script");
    std::fs::write(&script, "#!/bin/sh\n").unwrap();
    std::fs::set_permissions(&script, std::os::unix::fs::PermissionsExt::from_mode(0o755)).unwrap();
    let built = bateleur_tests::program("counter").display().to_string();
    for (program, words) in
        [("/no/such/program", "there is no program"), (script.to_str().unwrap(), "is a script")]
    {
        std::fs::write(&schedule, text.replace(&built, program)).unwrap();
        bateleur(&run).end().expect_code(2).expect_words(&[words]);
        assert!(logs() == before, "{program}: the logs of the last run are others");
    }
    let check = ["check", &schedule, "--programs", folder.path().to_str().unwrap()];
    let said = bateleur(&check).end().expect_code(0).stdout;
    assert!(said.contains("is a script"), "{said}");
}
