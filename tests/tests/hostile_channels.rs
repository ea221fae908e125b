//! Partitions that spoil the directories of their channels: with modes, depth, names and numbers of what they make there. Who shares
//! no channel with them notices nothing, their own budgets end it, and nothing of it is left behind.

use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::time::Duration;

use bateleur_tests::{
    Ended, Sketch, Started, Traces, alone, among_others, await_some, bateleur, bateleur_as_ordinary, is_long,
    process_named,
};
use rustix::process::Signal;

/// Who runs the module.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Who {
    Root,
    Ordinary,
}

impl Who {
    /// Root where the tests have it.
    fn all() -> impl Iterator<Item = Self> {
        let root = rustix::process::geteuid().is_root().then_some(Self::Root);
        root.into_iter().chain([Self::Ordinary])
    }

    fn run(self, arguments: &[&str]) -> Started {
        match self {
            Self::Root => bateleur(arguments),
            Self::Ordinary => bateleur_as_ordinary(arguments),
        }
    }
}

/// The budget of the one that litters.
const BUDGET: usize = 4;

/// A module with one that litters as `attributes` say, and its peer; a writer and a reader that share nothing with them.
fn schedule(folder: &Path, attributes: &str) -> String {
    let port = |partition: &str, name: &str| match name {
        "count" => format!(
            "[partition.{partition}.port]\ncount = {{ direction = \"source\", kind = \"sampling\", message = \"FunctionStatus\" }}"
        ),
        _ => format!(
            "[partition.{partition}.port]\nheard = {{ direction = \"destination\", kind = \"sampling\", message = \"FunctionStatus\", refresh = \"1s\" }}"
        ),
    };
    let channel = |from: &str, to: &str| {
        format!("[[channel]]\nsource = \"{from}.count\"\ndestinations = [\"{to}.heard\"]")
    };
    let budget = format!(
        "startup_timeout = \"1s\"\nrestart = {{ start = \"warm\", budget = {BUDGET}, within = \"60s\", then = \"idle\" }}\n\
         attributes = {{ {attributes} }}"
    );
    let path = Sketch::new()
        .table("[health]\nsilence_windows = 2000\n")
        .partition("litterer", "litterer", 4000, &budget)
        .partition("peer", "counter", 500, "")
        .partition("writer", "counter", 500, "")
        .partition("reader", "counter", 500, "")
        .table(&port("litterer", "count"))
        .table(&port("peer", "heard"))
        .table(&port("writer", "count"))
        .table(&port("reader", "heard"))
        .table(&channel("litterer", "peer"))
        .table(&channel("writer", "reader"))
        .write(folder);
    std::fs::set_permissions(folder, std::fs::Permissions::from_mode(0o755)).unwrap();
    path
}

/// What must hold, however one partition litters: with the writer killed `kills` times.
#[track_caller]
fn assert_nobody_else_is_hurt(ended: &Ended, kills: usize, about: &str) {
    // What leads to nothing is a window that was too short on a busy machine.
    let faults: Vec<_> = ended.faults().into_iter().filter(|fault| fault.action != "ignore").collect();
    let said = || format!("{about}\n{faults:#?}\n{}", ended.stderr);
    let of = |name: &str| faults.iter().filter(|fault| fault.partition == name).collect::<Vec<_>>();
    assert_eq!(of("reader").len(), 0, "the reader shares nothing: {}", said());
    let writer = of("writer");
    assert_eq!(writer.len(), kills, "the writer was killed so often: {}", said());
    assert!(writer.iter().all(|fault| fault.error == "killed" && fault.recovered_ns.is_some()), "{}", said());
    // Each restart of the litterer's is one of its budget, and costs its peer one at most.
    let littering = of("litterer");
    assert!(littering.len() <= BUDGET + 1, "beyond its budget: {}", said());
    assert!(of("peer").len() <= 2 * (BUDGET + 1), "{}", said());
    assert!(ended.stderr.matches("made anew").count() <= 3 * (BUDGET + 1), "no storm: {}", said());
    let late: Vec<_> = littering.iter().filter(|fault| fault.action == "idle").collect();
    assert!(late.len() <= 1, "idle is final: {}", said());
    // The machine may hold the dispatcher up: that is nobody's fault in the module.
    let windows = ended.windows();
    let own = windows.iter().filter(|window| window.partition == "reader" && !window.late);
    let missed: Vec<_> = own.filter(|window| window.granted_ns.is_none()).collect();
    assert!(missed.is_empty(), "the reader misses no window: {missed:?}\n{}", said());
}

/// Runs the module to its end, in virtual time, with the writer killed twice.
fn littered(who: Who, attributes: &str) -> (Ended, Vec<String>) {
    let folder = tempfile::tempdir().unwrap();
    let schedule = schedule(folder.path(), attributes);
    let kills = ["--kill", "writer@1.5", "--kill", "writer@3"];
    let run = who.run(&[&["run", "--fast", "--until", "4", "--schedule", &schedule], &kills[..]].concat());
    let pid = run.pid();
    (run.end(), left_of(pid))
}

/// How often chance is asked.
fn rounds() -> u64 {
    let usual = if is_long() { 16 } else { 7 };
    std::env::var("BATELEUR_ROUNDS").map_or(usual, |text| text.parse().unwrap())
}

/// What is left in shared memory of the run of process `pid`.
fn left_of(pid: i32) -> Vec<String> {
    let names = std::fs::read_dir("/dev/shm").unwrap().map(|entry| entry.unwrap().file_name());
    let names = names.map(|name| name.to_string_lossy().into_owned());
    names.filter(|name| name.starts_with("bateleur.test.") && name.contains(&pid.to_string())).collect()
}

#[test]
fn one_that_closes_its_channels_again_and_again_runs_out_of_its_budget_and_nobody_else_is_hurt() {
    let _turn = among_others();
    for who in Who::all() {
        let (ended, left) = littered(who, "how = \"closed\"");
        let about = format!("{who:?}");
        assert_nobody_else_is_hurt(&ended.expect_code(0), 2, &about);
        assert_eq!(left, Vec::<String>::new(), "{about}");
    }
}

#[test]
fn folders_within_each_other_are_removed_at_the_end() {
    let _turn = among_others();
    for who in Who::all() {
        for end in ["exit", "stay"] {
            let (ended, left) = littered(who, &format!("how = \"nested\", lives = 2, end = \"{end}\""));
            let about = format!("{who:?}, then {end}");
            assert_nobody_else_is_hurt(&ended.expect_code(0), 2, &about);
            assert_eq!(left, Vec::<String>::new(), "{about}");
        }
    }
}

#[test]
fn channels_that_were_filled_with_files_are_empty_for_the_successor() {
    let _turn = among_others();
    for who in Who::all() {
        // Where files are counted for it, more than its 96 MiB hold; one life, so that the second has to come up.
        let count = if who == Who::Root { 300_000 } else { 30_000 };
        let (ended, left) = littered(who, &format!("how = \"full\", lives = 1, count = {count}"));
        let about = format!("{who:?}");
        let ended = ended.expect_code(0);
        assert_nobody_else_is_hurt(&ended, 2, &about);
        let last = ended.windows().into_iter().rfind(|window| window.partition == "litterer").unwrap();
        assert!(last.closed_ns.is_some(), "it is there again: {:?}\n{}", ended.faults(), ended.stderr);
        assert_eq!(left, Vec::<String>::new(), "{about}");
    }
}

#[test]
fn whatever_a_partition_makes_of_its_channels_nobody_else_is_hurt_and_nothing_is_left() {
    let _turn = among_others();
    let rounds = rounds();
    for who in Who::all() {
        for seed in 1..=rounds {
            let end = if seed % 3 == 0 { "stay" } else { "exit" };
            let (ended, left) = littered(
                who,
                &format!("how = \"random\", seed = {seed}, end = \"{end}\", lives = {}", 1 + seed % 7),
            );
            let about = format!("{who:?}, seed {seed}");
            assert_eq!(ended.code, Some(0), "{about}: {}", ended.stderr);
            assert_nobody_else_is_hurt(&ended, 2, &about);
            assert_eq!(left, Vec::<String>::new(), "{about}");
            let last = ended.windows().into_iter().rfind(|window| window.partition == "litterer").unwrap();
            let idle =
                ended.faults().iter().any(|fault| fault.partition == "litterer" && fault.action == "idle");
            assert!(last.closed_ns.is_some() || idle, "{about}: back, or idle\n{}", ended.stderr);
        }
    }
}

fn drop_or_end(module: Started, killed: bool) {
    if !killed {
        module.end().expect_code(0);
    }
}

#[test]
fn guard_that_was_stopped_does_not_stay_behind() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let schedule = schedule(folder.path(), "lives = 0");
    for who in Who::all() {
        let mut module = who.run(&["run", "--until", "1", "--schedule", &schedule]);
        module.await_words("partitions are ready");
        let (guard, traces) = (process_named(module.pid(), "guard"), Traces::of(module.pid()));
        guard.signal(Signal::STOP);
        module.end().expect_code(0);
        assert!(!guard.is_alive(), "{who:?}");
        assert_eq!(traces.left(), Vec::<String>::new(), "{who:?}");
    }
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn one_that_closes_its_channels_on_the_wall_clock_delays_nobody_elses_return() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let schedule = schedule(folder.path(), "how = \"closed\", after = 20");
        let kills =
            ["--kill", "writer@0.3", "--kill", "writer@0.7", "--kill", "writer@1.1", "--kill", "writer@1.6"];
        for who in Who::all() {
            let ended = who
                .run(&[&["run", "--until", "3", "--schedule", &schedule], &kills[..]].concat())
                .end()
                .expect_code(0);
            assert_nobody_else_is_hurt(&ended, 4, &format!("{who:?}"));
            let back = ended.faults().into_iter().filter(|fault| fault.partition == "writer");
            let times: Vec<u64> =
                back.filter_map(|fault| Some(fault.recovered_ns? - fault.time_ns)).collect();
            // Three seconds are what a channel cleaner that hangs is given.
            assert!(times.iter().all(|time| *time < 2_000_000_000), "{who:?}: {times:?}");
        }
    }

    #[test]
    fn folders_within_each_other_are_removed_by_the_guard_and_by_the_next_start() {
        let _turn = alone();
        for (who, with_guard) in Who::all().flat_map(|who| [(who, false), (who, true)]) {
            let folder = tempfile::tempdir().unwrap();
            let nested = schedule(folder.path(), "how = \"nested\", end = \"stay\"");
            let mut module = who.run(&["run", "--until", "100", "--schedule", &nested]);
            module.await_words("it has littered");
            let (pid, traces) = (module.pid(), Traces::of(module.pid()));
            if with_guard {
                process_named(pid, "guard").signal(Signal::KILL);
            }
            module.signal(Signal::KILL);
            drop(module);
            if with_guard {
                let gone = await_some(Duration::from_secs(10), || {
                    traces.processes().iter().all(|process| !process.is_alive()).then_some(())
                });
                assert!(gone.is_some(), "{:?}", traces.left());
                assert_ne!(left_of(pid), Vec::<String>::new(), "without the guard something is left");
                let sound = tempfile::tempdir().unwrap();
                let next = schedule(sound.path(), "lives = 0");
                who.run(&["run", "--fast", "--until", "0.2", "--schedule", &next]).end().expect_code(0);
            }
            traces.expect_gone();
        }
    }

    #[test]
    fn module_that_is_ended_while_channels_are_made_anew_leaves_nothing() {
        let _turn = alone();
        let rounds = rounds();
        for who in Who::all() {
            for seed in 1..=rounds {
                let folder = tempfile::tempdir().unwrap();
                let how = if seed % 2 == 0 { "closed" } else { "random" };
                let schedule = schedule(folder.path(), &format!("how = \"{how}\", after = 3, seed = {seed}"));
                let mut module = who.run(&["run", "--until", "20", "--schedule", &schedule]);
                module.await_words("it has littered");
                // From before its end is seen to after its successor is there.
                std::thread::sleep(Duration::from_micros(seed * 7919 % 90_000));
                let traces = Traces::of(module.pid());
                module.signal(if seed % 3 == 0 { Signal::KILL } else { Signal::TERM });
                drop_or_end(module, seed % 3 == 0);
                traces.expect_gone();
                // What a process that was late would make anew.
                std::thread::sleep(Duration::from_millis(300));
                assert_eq!(traces.left(), Vec::<String>::new(), "{who:?}, seed {seed}");
            }
        }
    }

    #[test]
    fn channel_holder_that_is_killed_is_followed_and_a_channel_that_can_not_be_held_costs_no_other_one() {
        let _turn = alone();
        for who in Who::all() {
            let folder = tempfile::tempdir().unwrap();
            let schedule = schedule(folder.path(), "how = \"random\", seed = 5, end = \"stay\"");
            let kills = ["--kill", "writer@2", "--kill", "reader@2.5", "--kill", "writer@3"];
            let mut module =
                who.run(&[&["run", "--until", "4", "--schedule", &schedule], &kills[..]].concat());
            module.await_words("it has littered");
            process_named(module.pid(), "channel-holder").signal(Signal::KILL);
            let ended = module.end().expect_code(0);
            let faults: Vec<_> =
                ended.faults().into_iter().filter(|fault| fault.action != "ignore").collect();
            let of = |name: &str| faults.iter().filter(|fault| fault.partition == name).collect::<Vec<_>>();
            for (name, kills) in [("writer", 2), ("reader", 1)] {
                let own = of(name);
                assert_eq!(own.len(), kills, "{who:?}: {name}: {own:?}\n{}", ended.stderr);
                assert!(own.iter().all(|fault| fault.recovered_ns.is_some()), "{who:?}: {own:?}");
            }
        }
    }
}
