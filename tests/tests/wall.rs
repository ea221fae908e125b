//! The wall clock: real windows on a real processor. The longest flight of the suite on it is here.

use std::time::Duration;

use bateleur_tests::{
    NINE, Sketch, Window, alone, await_some, bateleur, edited, executive_of, flight_schedule,
    laps_of_small_mission, process_named, program, quantile, small_mission,
};
use rustix::process::Signal;
use serde_json::Value;

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn module_without_its_simulator_has_all_its_windows() {
        let _turn = alone();
        let schedule = flight_schedule();
        let device = "command.device=/dev/nowhere";
        let ended =
            bateleur(&["run", "--schedule", schedule.to_str().unwrap(), "--set", device, "--until", "10"]);
        let ended = ended.end().expect_code(0).expect_words(&["9 partitions are ready"]);
        let windows = ended.windows();
        for partition in NINE {
            let of: Vec<&Window> = windows.iter().filter(|window| window.partition == partition).collect();
            assert!((495..=510).contains(&of.len()), "{partition} had {} windows in 10 s", of.len());
            // Those that the dispatcher came too late for were taken by who else uses the machine.
            let lost: Vec<&&Window> = of.iter().filter(|window| window.granted_ns.is_none()).collect();
            let in_time = lost.iter().filter(|window| !window.late).count();
            assert!(
                lost.len() * 2 < of.len() && in_time * 100 <= of.len() * 5,
                "{partition}: {lost:?} were not granted\n{}",
                ended.stderr
            );
            let granted = of.len() - lost.len();
            let closed = of.iter().filter(|window| window.closed_ns.is_some()).count();
            assert!(closed * 100 >= granted * 95, "{partition}: {closed} of {granted} were closed");
            assert!(
                of.iter().all(|window| window.granted_ns.is_none_or(|at| at >= window.planned_start_ns)),
                "{partition} was early"
            );
            let late = quantile(of.iter().filter_map(|window| window.lateness_ns()), 0.5);
            assert!(late < 5_000_000, "half of the windows of {partition} begin more than {late} ns late");
        }
        // In the order of the schedule, one after the other.
        assert!(windows.windows(2).all(|pair| pair[0].planned_end_ns <= pair[1].planned_start_ns));
    }

    /// A dispatcher ends by itself at that time, and the monitor, which has restarts to do, may not know the time yet.
    #[test]
    fn run_that_ends_at_its_time_while_the_monitor_is_busy_is_no_error_of_the_module() {
        let _turn = alone();
        let keys = "attributes = { how = \"exit\", after = 1 }\n\
                restart = { start = \"cold\", budget = 1000, within = \"10s\", then = \"idle\" }";
        let folder = tempfile::tempdir().unwrap();
        let names: Vec<String> = (0..8).map(|number| format!("p{number}")).collect();
        let sketch =
            names.iter().fold(Sketch::new(), |sketch, name| sketch.partition(name, "crasher", 1_000, keys));
        let schedule = sketch.write(folder.path());
        for _ in 0..5 {
            bateleur(&["run", "--schedule", &schedule, "--until", "0.2"]).end().expect_code(0);
        }
    }

    #[test]
    fn flight_on_the_wall_clock_outlives_two_partitions_its_supervisor_and_its_executive() {
        let _turn = alone();
        let schedule = flight_schedule();
        let [schedule, mission] = [schedule, small_mission()].map(|path| path.to_str().unwrap().to_owned());
        let flight = ["fly", "--format", "json", "--schedule", &schedule, "--mission", &mission];
        let kills = ["--kill", "estimator@35", "--kill", "controller@42"];
        let mut flight = bateleur(&[&flight[..], &kills[..]].concat());
        let back = await_some(Duration::from_secs(150), || {
            (flight.said().contains("controller: back") || flight.has_ended()).then_some(())
        });
        assert!(back.is_some() && !flight.has_ended(), "{}", flight.said());
        let executive = executive_of(flight.pid());
        process_named(flight.pid(), "supervisor").signal(Signal::KILL);
        process_named(executive.pid, "supervisor");
        executive.signal(Signal::KILL);
        let ended = flight.end_within(Duration::from_secs(300));
        let summary = ended.summary();
        eprintln!("{summary:#}");
        assert_eq!(summary["completed"], true, "{}\n{}", summary["failure"], ended.stderr);
        let ended = ended.expect_code(0);
        assert_eq!(summary["waypoints"], Value::from(vec!["WP0", "WP1", "WP2", "WP0"]));
        assert_eq!(summary["clock"], "wall");
        let died = ended.faults().into_iter().filter(|fault| fault.error == "executive_died").count();
        assert_eq!(died, 1, "{:#?}", ended.faults());
        let killed: Vec<_> = ended.faults().into_iter().filter(|fault| fault.error == "killed").collect();
        assert_eq!(
            killed.iter().map(|fault| fault.partition.as_str()).collect::<Vec<_>>(),
            ["estimator", "controller"]
        );
        assert!(killed.iter().all(|fault| fault.recovered_ns.is_some()), "{killed:#?}");
        let chain_us = summary["chain_execution_us"]["p99"].as_f64().unwrap();
        assert!(chain_us < 13_000.0, "the chain from gyro to elevator takes {chain_us} us");
        assert!(summary["window_start_lateness_us"]["p50"].is_number());
    }

    /// Faults that end a partition, and those that it survives or is watched through.
    const FAULTS: [&str; 14] = [
        "panic",
        "abort",
        "exit",
        "spin",
        "hang",
        "allocate",
        "null-write",
        "wild-write",
        "stack-overflow",
        "divide-by-zero",
        "illegal-instruction",
        "run-on",
        "sigkill",
        "sigsegv",
    ];

    /// What the flight's own windows and the flight were like.
    struct Measured {
        windows: usize,
        lost: usize,
        late_ns: [u64; 3],
        summary: Value,
    }

    fn measured(schedule: &str, more: &[String]) -> Measured {
        let mission = tempfile::tempdir().unwrap();
        let path = laps_of_small_mission(mission.path(), 11);
        let mut words =
            vec!["fly", "--format", "json", "--schedule", schedule, "--mission", path.to_str().unwrap()];
        words.extend(more.iter().map(String::as_str));
        let ended = bateleur(&words).end_within(Duration::from_secs(1500));
        let summary = ended.summary();
        assert_eq!(summary["completed"], true, "{}\n{}", summary["failure"], ended.stderr);
        let faults = ended.faults();
        let of_nine: Vec<_> =
            faults.iter().filter(|fault| NINE.contains(&fault.partition.as_str())).collect();
        assert!(of_nine.is_empty(), "{of_nine:#?}");
        let windows = ended.windows();
        let nine: Vec<&Window> = windows.iter().filter(|it| NINE.contains(&it.partition.as_str())).collect();
        let late = |part| quantile(nine.iter().filter_map(|window| window.lateness_ns()), part);
        Measured {
            windows: nine.len(),
            lost: nine.iter().filter(|window| window.granted_ns.is_none()).count(),
            late_ns: [0.5, 0.99, 0.999].map(late),
            summary,
        }
    }

    #[test]
    #[ignore = "flies for twenty minutes"]
    fn partitions_of_4_16_and_64_processes_with_200_faults_change_nothing_of_the_flight_beside_them() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let crowds = [(4, "8.4ms", "1ms"), (16, "9.6ms", "1.5ms"), (64, "15.2ms", "3ms")];
        let window = |(processes, offset, duration)| {
            format!(
                "{{ partition = \"crowd_{processes}\", offset = \"{offset}\", duration = \"{duration}\" }},\n]\n"
            )
        };
        let mut text = edited(&[]);
        let end = text.find("\n]\n").unwrap() + 1;
        let windows = crowds.map(window).concat().replace("]\n", "") + "]\n";
        text.replace_range(end..end + 2, &windows);
        for (processes, ..) in crowds {
            text += &format!(
                "\n[partition.crowd_{processes}]\nprogram = \"{}\"\nmodule = \"fcu\"\nmemory = \"128MiB\"\n\
                 threads = {}\nattributes = {{ processes = {processes} }}\n\
                 restart = {{ start = \"warm\", budget = 1000, within = \"10s\", then = \"idle\" }}\n",
                program("hive").display(),
                processes + 2,
            );
        }
        let schedule = folder.path().join("schedule.toml");
        std::fs::write(&schedule, text).unwrap();
        let fault = |number: usize| {
            let (processes, ..) = crowds[number % 3];
            format!(
                "--inject=crowd_{processes}:{}@{}",
                FAULTS[number % FAULTS.len()],
                20.0 + 2.8 * number as f64
            )
        };
        let beside = measured(schedule.to_str().unwrap(), &(0..200).map(fault).collect::<Vec<_>>());
        let alone = measured(flight_schedule().to_str().unwrap(), &[]);
        for (what, found) in [("beside them", &beside), ("alone", &alone)] {
            let Measured { windows, lost, late_ns, summary } = found;
            let cross_m = &summary["straight_cross_track_true_rms_m"];
            eprintln!(
                "{what}: {lost} of {windows} windows lost, late by {late_ns:?} ns, {cross_m} m beside the legs"
            );
        }
        assert!(beside.lost <= alone.lost + alone.windows / 1000, "{} and {}", beside.lost, alone.lost);
    }

    #[test]
    fn run_that_is_to_end_within_a_major_frame_has_the_windows_of_all_frames_that_begin_before() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule = Sketch::new().partition("only", "counter", 1000, "").write(folder.path());
        for (until, windows) in [("0.01", 1), ("0.02", 1), ("0.021", 2), ("0.05", 3)] {
            let ended = bateleur(&["run", "--schedule", &schedule, "--until", until]).end().expect_code(0);
            assert_eq!(ended.windows().len(), windows, "until {until} s, frames of 20 ms");
        }
    }
}
