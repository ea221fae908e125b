//! The schedule that ships with the project, and the plan that becomes of it.

// A test may be blunt: a panic is how it fails.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic)]

mod plan_support;

use bateleur_checker::check_with_warnings;
use bateleur_plan::{
    Attribute, Direction, Kind, PartitionAction, PartitionError, Payload, Plan, Role, Timeline,
};
use plan_support::{Table, repository};

fn flight() -> Plan {
    let text = std::fs::read_to_string(repository().join("schedule.toml")).unwrap();
    let (plan, report) =
        check_with_warnings("schedule.toml", &text, &Table).unwrap_or_else(|report| panic!("{report}"));
    assert_eq!((report.errors(), report.warnings()), (0, 0), "{report}");
    plan
}

#[test]
fn the_flight_schedule_breaks_no_rule() {
    let plan = flight();
    assert_eq!(plan.partitions.len(), 9);
    assert_eq!(plan.schedules.len(), 1);
    assert!(plan[plan.initial_schedule()].initial);
}

#[test]
fn a_port_knows_its_role_its_message_and_its_channel() {
    let plan = flight();
    let id = plan.port("gps.raw").unwrap();
    let port = &plan[id];
    assert_eq!(port.role, Role::SamplingDestination { refresh_ns: 500_000_000 });
    assert_eq!((port.direction(), port.kind()), (Direction::Destination, Kind::Sampling));
    assert_eq!(port.payload, Payload::Message { name: "RawGps".to_owned(), size_bytes: 64, layout: 0 });
    let channel = &plan[port.channel.unwrap()];
    assert_eq!(plan.port_path(channel.source), "hil_interface.raw_gps");
    assert_eq!(channel.destinations, [id]);
}

#[test]
fn attributes_reach_the_partition_as_they_are_written() {
    let plan = flight();
    let controller = &plan[plan.partition("controller").unwrap()];
    assert_eq!(controller.attributes["laps"], Attribute::Integer(2));
    assert_eq!(controller.attributes["path"], Attribute::String("fillet".to_owned()));
}

#[test]
fn a_default_warm_restart_reaches_a_cold_partition_as_a_cold_one() {
    let plan = flight();
    let action = |name| plan[plan.partition(name).unwrap()].health.action(PartitionError::MemoryViolation);
    assert_eq!(action("estimator"), PartitionAction::WarmRestart);
    assert_eq!(action("gps"), PartitionAction::ColdRestart);
}

#[test]
fn a_chain_names_every_port_on_its_way() {
    let plan = flight();
    let path: Vec<String> = plan.chains[0].path.iter().map(|&port| plan.port_path(port)).collect();
    assert_eq!(
        path,
        [
            "hil_interface.raw_analog",
            "imu.raw",
            "imu.orientation",
            "estimator.orientation",
            "estimator.state",
            "controller.state",
            "controller.command",
            "servo.command",
            "servo.timers",
        ]
    );
}

#[test]
fn a_module_sees_its_own_partitions_and_channels() {
    let plan = flight();
    let fcu = plan.module("fcu").unwrap();
    assert_eq!(fcu.cores(), [1]);
    assert_eq!(fcu.partitions().count(), 9);
    assert_eq!(fcu.channels().count(), plan.channels.len());
    assert_eq!(fcu.crossing_channels().count(), 0);
    assert!(plan.module("elsewhere").is_none());
}

/// A second module for the Estimator, and what joins it with the first.
const AFT: &str = r#"
[network.a]
rate = "100Mbit/s"

[module.aft]
cores = [3]
addresses = { a = "10.77.0.2:15300" }
follows = "fcu"

[link.bus]
modules = ["fcu", "aft"]
unauthenticated = true
gap = "4ms"
"#;

#[test]
fn moving_a_partition_changes_its_module_and_nothing_else() {
    let text = std::fs::read_to_string(repository().join("schedule.toml")).unwrap();
    let here = "program    = \"estimator\"\nmodule     = \"fcu\"";
    assert!(text.contains(here));
    let moved = text.replace(here, "program    = \"estimator\"\nmodule     = \"aft\"");
    let moved = moved.replace("[schedule.flight]", &format!("{AFT}\n[schedule.flight]"));
    let moved = moved.replace("cores = [1] #", "addresses = { a = \"10.77.0.1:15300\" }\ncores = [1] #");
    let relays = "window = [\n    { partition = \"relay_fcu\", offset = \"16ms\", duration = \"500us\" },\n    { partition = \"relay_aft\", offset = \"3ms\", duration = \"500us\" },\n";
    let moved = moved.replacen("window = [\n", relays, 1).replace("max_age = \"25ms\"", "max_age = \"80ms\"");
    let moved = moved.replace("refresh = \"40ms\"", "refresh = \"80ms\"");
    let (plan, report) = check_with_warnings("schedule.toml", &moved, &Table).unwrap();
    assert_eq!((report.errors(), report.warnings()), (0, 0), "{report}");
    let (fcu, aft) = (plan.module("fcu").unwrap(), plan.module("aft").unwrap());
    // One relay each.
    assert_eq!((fcu.partitions().count(), aft.partitions().count()), (9, 2));
    assert_eq!(aft.channels().count(), 0);
    assert_eq!(aft.crossing_channels().count(), fcu.crossing_channels().count());
    let line = Timeline::of(&plan, aft.id(), plan.initial_schedule());
    assert_eq!((line.cores[0].core, line.cores[0].windows.len()), (3, 10));
}

#[test]
fn the_timeline_of_the_flight_schedule_recurs_in_every_minor_frame() {
    let plan = flight();
    let line = Timeline::of(&plan, plan.module("fcu").unwrap().id(), plan.initial_schedule());
    let [core] = line.cores.as_slice() else { panic!("{line:?}") };
    assert_eq!(core.windows.len(), 9 * 5);
    assert_eq!(core.used_ns(), 5 * 10_100_000);
    assert!(core.windows.windows(2).all(|pair| pair[0].end_ns <= pair[1].start_ns));
    let imu = plan.partition("imu").unwrap();
    let imu: Vec<(u64, u32, u32)> = core
        .windows
        .iter()
        .filter(|window| window.partition == imu)
        .map(|window| (window.start_ns, window.minor, window.number))
        .collect();
    let expected =
        [(3_800_000, 0, 0), (23_800_000, 1, 1), (43_800_000, 2, 2), (63_800_000, 3, 3), (83_800_000, 4, 4)];
    assert_eq!(imu, expected);
}

/// Three partitions on two cores, in an order of the file that is not the order of time.
const TOUCHING: &str = r#"
[module.fcu]
cores = [2, 1]

[partition.one]
program = "one"
module = "fcu"
memory = "8MiB"

[partition.two]
program = "two"
module = "fcu"
memory = "8MiB"

[partition.three]
program = "three"
module = "fcu"
memory = "8MiB"

[schedule.flight]
major_frame = "20ms"
minor_frame = "10ms"
window = [
    { partition = "two", offset = "1ms", duration = "9ms", core = 1 },
    { partition = "one", offset = "0ms", duration = "1ms", core = 1, minor = [1, 0] },
    { partition = "three", offset = "5ms", duration = "500us", minor = [1] },
    { partition = "one", offset = "1ms", duration = "1ms", core = 2 },
]
"#;

fn touching() -> Plan {
    let (plan, report) = check_with_warnings("touching.toml", TOUCHING, &Table).unwrap();
    let rules: Vec<&str> = report.violations().iter().map(|violation| violation.rule).collect();
    assert_eq!(rules, ["T12-core-too-full"], "windows may touch, whoever has them");
    plan
}

#[test]
fn windows_that_touch_do_not_overlap() {
    let plan = touching();
    let line = Timeline::of(&plan, plan.module("fcu").unwrap().id(), plan.initial_schedule());
    assert_eq!(line.cores.iter().map(|core| core.core).collect::<Vec<_>>(), [2, 1]);
    let spans: Vec<(u64, u64)> =
        line.cores[1].windows.iter().map(|window| (window.start_ns, window.end_ns)).collect();
    let ms = 1_000_000;
    assert_eq!(spans, [(0, ms), (ms, 10 * ms), (10 * ms, 11 * ms), (11 * ms, 20 * ms)]);
}

#[test]
fn a_window_without_a_core_is_on_the_first_of_its_module() {
    let plan = touching();
    let line = Timeline::of(&plan, plan.module("fcu").unwrap().id(), plan.initial_schedule());
    let three = plan.partition("three").unwrap();
    let window = line.cores[0].windows.iter().find(|window| window.partition == three).unwrap();
    assert_eq!(
        (window.start_ns, window.duration_ns(), window.minor, window.declared),
        (15_000_000, 500_000, 1, 2)
    );
}

#[test]
fn instants_count_from_the_origin() {
    let plan = touching();
    let line = Timeline::of(&plan, plan.module("fcu").unwrap().id(), plan.initial_schedule());
    let last = line.cores[1].windows[3];
    // A day of major frames later, the instant is still exact.
    let frame = 24 * 60 * 60 * 50;
    assert_eq!(line.instant_ns(frame, last.start_ns), 24 * 60 * 60 * 1_000_000_000 + 11_000_000);
}

#[test]
fn what_the_file_leaves_out_has_a_default() {
    let plan = touching();
    let one = &plan[plan.partition("one").unwrap()];
    assert_eq!((one.threads, one.priority, one.network, one.retained_bytes), (1, 40, false, 0));
    assert_eq!(
        (one.restart.budget, one.restart.within_ns, one.restart.startup_ns),
        (5, 10_000_000_000, 20_000_000)
    );
    assert_eq!(one.startup_timeout_ns, 5_000_000_000);
    let told = &one.processes;
    assert_eq!((told.identifier, told.most, told.stacks_bytes), (1, 0, one.memory_bytes));
    assert_eq!(
        (told.release_ns, told.period_ns, told.duration_ns),
        (0, 10_000_000, 2_000_000),
        "its windows"
    );
    assert_eq!(plan.health.silence_windows, 25);
    assert!(plan.schedules[0].initial, "the only schedule is initial");
}
