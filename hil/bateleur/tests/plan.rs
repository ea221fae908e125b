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

/// The needs of a flight with three Controllers, which `durations_us` gives their windows.
fn needs_of_replicas(durations_us: [u64; 3]) -> String {
    let needs = std::fs::read_to_string(repository().join(NEEDS)).unwrap();
    let replica = |(place, us)| {
        let number = place + 1;
        format!("controller_{number} = {{ period = \"20ms\", duration = \"{us}us\" }}\n")
    };
    needs + &durations_us.into_iter().enumerate().map(replica).collect::<String>()
}

fn plan_replicas(needs: &str, schedule: &str) -> support::Ended {
    let folder = tempfile::tempdir().unwrap();
    let (path, plan) = (folder.path().join("needs.toml"), folder.path().join("plan.toml"));
    std::fs::write(&path, needs).unwrap();
    std::fs::write(&plan, schedule).unwrap();
    bateleur(&["plan", path.to_str().unwrap(), "--schedule", plan.to_str().unwrap()])
}

#[test]
fn replicas_of_one_module_are_planned_one_after_the_other_and_their_voter_behind_them() {
    let schedule = std::fs::read_to_string(repository().join("schedules/replicas.toml")).unwrap();
    for durations_us in [[1000, 1000, 1000], [700, 1100, 900], [300, 250, 200]] {
        let ended = plan_replicas(&needs_of_replicas(durations_us), &schedule);
        // No warning either: nobody who writes what they read has a window between them.
        assert_eq!((ended.code, ended.stderr.as_str()), (0, ""), "{durations_us:?}");
        let order: Vec<&str> = ended.stdout.lines().filter_map(|line| line.split('"').nth(1)).collect();
        let of = |name: &str| order.iter().position(|other| *other == name).unwrap();
        let first = of("controller_1");
        assert_eq!(order[first..first + 3], ["controller_1", "controller_2", "controller_3"]);
        assert!(of("estimator") < first && first + 2 < of("controller") && of("controller") < of("servo"));
    }
}

#[test]
fn relays_and_replicas_of_several_modules_are_planned_with_their_partitions() {
    let three = std::fs::read_to_string(repository().join("schedules/three-hosts.toml")).unwrap();
    // The ages of chains through several modules are the author's matter: the planner does not know when they run.
    let schedule = three
        .replace("max_age = \"25ms\"", "max_age = \"150ms\"")
        .replace("[partition.controller]", "[partition.controller]\nreplicas = [\"fcu\", \"nav\", \"nav\"]");
    let needs = std::fs::read_to_string(repository().join(NEEDS)).unwrap();
    let mut others =
        ["relay_fcu", "relay_nav", "relay_ctl", "controller_1", "controller_2", "controller_3"].to_vec();
    let all = |others: &[&str]| {
        let need = |name: &&str| format!("{name} = {{ period = \"20ms\", duration = \"500us\" }}\n");
        needs.clone() + &others.iter().map(need).collect::<String>()
    };
    let ended = plan_replicas(&all(&others), &schedule);
    assert_eq!(ended.code, 0, "{}", ended.stderr);
    let order: Vec<&str> = ended.stdout.lines().filter_map(|line| line.split('"').nth(1)).collect();
    let second = order.iter().position(|name| *name == "controller_2").unwrap();
    assert_eq!(order[second + 1], "controller_3", "{}", ended.stdout);
    let missing = others.remove(0);
    let ended = plan_replicas(&all(&others), &schedule);
    let words = format!("partition `{missing}` has no need");
    assert!(ended.code == 2 && ended.stderr.contains(&words), "{}", ended.stderr);
}

#[test]
fn needs_of_replicas_that_can_not_be_together_are_refused_with_a_way_to_mend_them() {
    let schedule = std::fs::read_to_string(repository().join("schedules/replicas.toml")).unwrap();
    let needs = needs_of_replicas([1000; 3]);
    let third = "controller_3 = { period = \"20ms\", duration = \"1000us\" }";
    for (new, words) in [
        ("", "partition `controller_3` has no need: add"),
        ("controller_3 = { period = \"40ms\", duration = \"1ms\" }", "give them the same period and core"),
        (
            "controller_3 = { period = \"20ms\", duration = \"1ms\", offset = \"9ms\" }",
            "`controller_3` runs right behind `controller_1`: ask for the offset of `controller_1` alone",
        ),
        ("controller_4 = { period = \"20ms\", duration = \"1ms\" }", "there is no partition `controller_4`"),
    ] {
        let ended = plan_replicas(&needs.replace(third, new), &schedule);
        assert_eq!(ended.code, 2, "{}", ended.stdout);
        assert!(ended.stderr.contains(words), "{words}:\n{}", ended.stderr);
    }
    let ended = plan_replicas(&needs.replace(third, &third.replace("1000us", "19ms")), &schedule);
    let words = "the window of `controller_1`, `controller_2`, `controller_3` takes 21.2ms";
    assert_eq!(ended.code, 1, "{}", ended.stdout);
    assert!(ended.stderr.contains(words), "{}", ended.stderr);
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
        ("[need]", "major_frame = 5\n[need]", "integer 5 is no time"),
        ("duration = \"600us\"", "duration = \"0ms\"", "the duration of `servo` is zero"),
    ] {
        let ended = plan_with(|text| text.replacen(old, new, 1));
        assert_eq!(ended.code, 2, "{}", ended.stdout);
        assert!(ended.stderr.contains(words), "{words}:\n{}", ended.stderr);
    }
}

const PARTITIONS: [&str; 9] = [
    "rate_generator",
    "hil_interface",
    "gps",
    "imu",
    "estimator",
    "controller",
    "servo",
    "onboard_computer",
    "command",
];

/// A run of 2000 periods; each partition works a little longer than the one before, and once three times as long. `last` is the last line.
fn run_folder(last: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut text = "frame,minor,core,partition,planned_start_ns,planned_end_ns,granted_ns,opened_ns,closed_ns,flags,slack_ns,schedule\n".to_owned();
    for period in 0..2000_u64 {
        for (place, name) in PARTITIONS.iter().enumerate() {
            let start = period * 20_000_000 + 19_000_000;
            let used = (150 + 50 * place as u64) * if period == 1000 { 3_000 } else { 1_000 };
            let (end, closed) = (start + 1_000_000, start + used);
            text += &format!("0,0,1,{name},{start},{end},{start},{start},{closed},,0,flight\n");
        }
    }
    std::fs::write(folder.path().join("windows.csv"), text + last).unwrap();
    folder
}

#[test]
fn needs_come_from_a_run_with_a_margin_and_the_table_says_so() {
    let run = run_folder("");
    let folder = run.path().to_str().unwrap();
    let ended = bateleur(&["plan", "--from-run", folder, "--margin", "20"]);
    assert_eq!((ended.code, ended.stderr.as_str()), (0, ""));
    assert_golden("plan_from_run.txt", &ended.stdout.replace(folder, "RUN"));
    let needs = run.path().join("needs.toml");
    std::fs::write(&needs, "[need]\nimu = { period = \"20ms\", duration = \"2ms\" }\n").unwrap();
    let ended = bateleur(&["plan", needs.to_str().unwrap(), "--from-run", folder]);
    let imu = ended.stdout.lines().find(|line| line.contains("partition = \"imu\""));
    assert!(
        imu.is_some_and(|line| line.contains("duration = \"2ms\"")),
        "what is written goes first: {imu:?}"
    );
}

#[test]
fn run_that_does_not_say_what_a_partition_needs_is_refused() {
    let open = "0,0,1,imu,99019000000,99020000000,99019000000,99019000000,,O,,flight\n";
    let run = run_folder(open);
    let ended = bateleur(&["plan", "--from-run", run.path().to_str().unwrap()]);
    assert_eq!(ended.code, 2, "{}", ended.stdout);
    assert!(ended.stderr.contains("`imu` left windows open in"), "{}", ended.stderr);
    let ended = bateleur(&["plan", "--from-run", "/nowhere"]);
    assert!(ended.code == 2 && ended.stderr.contains("cannot read /nowhere/windows.csv"), "{}", ended.stderr);
    let ended = bateleur(&["plan"]);
    assert!(ended.code == 2 && ended.stderr.contains("NEEDS"), "{}", ended.stderr);
}

#[test]
fn major_frame_that_is_asked_for_is_taken_where_every_period_fits() {
    let with = |major: &str| plan_with(|text| format!("major_frame = \"{major}\"\n{text}"));
    let ended = with("200ms");
    assert_eq!(ended.code, 0, "{}", ended.stderr);
    assert!(ended.stdout.contains("major_frame = \"200ms\"\n"), "{}", ended.stdout);
    let ended = with("50ms");
    assert_eq!((ended.code, ended.stdout.as_str()), (1, ""));
    assert!(ended.stderr.contains("a major frame of 50ms is no multiple of 20ms"), "{}", ended.stderr);
}

#[test]
fn another_minor_frame_is_told_with_what_becomes_of_a_silence() {
    let ended = plan_with(|text| format!("minor_frame = \"40ms\"\n{text}"));
    let words = "`silence_windows` = 25 counts windows: of a partition with one in each minor frame a silence is 1s and no longer 500ms";
    assert!(ended.stderr.contains(words), "{}", ended.stderr);
}

#[test]
fn what_is_wrong_with_the_schedule_file_is_said_at_its_own_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("schedule.toml");
    let text = std::fs::read_to_string(repository().join("schedule.toml")).unwrap();
    let text = text.replacen("message = \"Rate\"", "message = \"Ratio\"", 1);
    std::fs::write(&path, &text).unwrap();
    let line = 1 + text.lines().position(|line| line.contains("\"Ratio\"")).unwrap();
    let path = path.to_str().unwrap();
    let ended = bateleur(&["plan", NEEDS, "--schedule", path]);
    assert_eq!((ended.code, ended.stdout.as_str()), (2, ""));
    assert!(ended.stderr.contains(&format!("--> {path}:{line}:")), "{}", ended.stderr);
}
