//! A module whose major frames follow another one's, over a link, or the machine's disciplined clock. Whether this machine has
//! one is its own affair: the module runs on either way, and says how it stands. No duration is judged.

use bateleur_tests::{Started, alone, bateleur, program};
use rustix::process::Signal;

const MAJOR_NS: u64 = 20_000_000;

fn schedule(keys: &str) -> String {
    format!(
        "[module.test]\ncores = [1]\n{keys}\n[partition.a]\nprogram = \"{}\"\nmodule = \"test\"\nmemory = \"32MiB\"\n\
         [schedule.s]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\n\
         window = [{{ partition = \"a\", offset = \"1ms\", duration = \"1ms\" }}]\n",
        program("counter").display()
    )
}

#[test]
fn module_that_follows_two_clocks_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("both.toml");
    std::fs::write(&path, schedule("clock = \"realtime\"\nfollows = \"test\"")).unwrap();
    let ended = bateleur(&["check", path.to_str().unwrap()]).end().expect_code(2);
    assert!((ended.stdout + &ended.stderr).contains("both `test` and the disciplined clock"));
}

/// Two modules joined by a link; what one counts the other one hears.
fn pair() -> String {
    let program = program("counter");
    let partition = |name: &str, module: &str, port: &str| {
        format!(
            "[partition.{name}]\nprogram = \"{}\"\nmodule = \"{module}\"\nmemory = \"32MiB\"\n\
             [partition.{name}.port]\n{port}, kind = \"sampling\", message = \"FunctionStatus\"",
            program.display()
        )
    };
    format!(
        "[network.a]\nrate = \"1Gbit/s\"\nlatency = \"1ms\"\n\
         [module.lead]\ncores = [1]\naddresses = {{ a = \"127.0.0.1:15393\" }}\n\
         [module.own]\ncores = [1]\naddresses = {{ a = \"127.0.0.1:15394\" }}\nfollows = \"lead\"\n\
         [link.pair]\nmodules = [\"lead\", \"own\"]\nunauthenticated = true\ngap = \"1ms\"\n\
         {} }}\n{}, refresh = \"1s\" }}\n\
         [[channel]]\nsource = \"a.count\"\ndestinations = [\"b.heard\"]\n\
         [schedule.s]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\n\
         window = [\n\
         {{ partition = \"a\", offset = \"1ms\", duration = \"1ms\" }},\n\
         {{ partition = \"relay_lead\", offset = \"3ms\", duration = \"1ms\" }},\n\
         {{ partition = \"relay_own\", offset = \"8ms\", duration = \"1ms\" }},\n\
         {{ partition = \"b\", offset = \"12ms\", duration = \"1ms\" }},\n]\n",
        partition("a", "lead", "count = { direction = \"source\""),
        partition("b", "own", "heard = { direction = \"destination\""),
    )
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn module_on_the_disciplined_clock_says_how_it_stands_and_moves_no_frame_by_more_than_it_may() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("realtime.toml");
        // 100 ms: whoever is not locked within the first ten seconds is lost, and it is said.
        std::fs::write(&path, schedule("clock = \"realtime\"\nfollows_within = \"100ms\"")).unwrap();
        let ended =
            bateleur(&["run", "--schedule", path.to_str().unwrap(), "--until", "11"]).end().expect_code(0);
        let log = std::fs::read_to_string(ended.folder().join("alignment.csv")).unwrap();
        let lines: Vec<Vec<&str>> = log.lines().skip(1).map(|line| line.split(',').collect()).collect();
        assert!(lines.len() > 300, "a line for each frame that was looked at: {}", lines.len());
        let shifts: Vec<i64> = lines.iter().map(|line| line[8].parse().unwrap()).collect();
        let last = lines.last().unwrap();
        let lost = ended.faults().into_iter().filter(|fault| fault.error == "sync_lost").count();
        match last[2] {
            "locked" => {
                assert!(ended.stderr.contains("major frames follow realtime"), "{}", ended.stderr);
                let phase_ns: f64 = last[5].parse().unwrap();
                assert!(phase_ns.abs() < MAJOR_NS as f64 / 2.0, "{phase_ns}");
            }
            "lost" => {
                assert_eq!(lost, 1, "{}", ended.stderr);
                assert!(ended.stderr.contains("CLOCK_REALTIME is not synchronised"), "{}", ended.stderr);
                assert!(shifts.iter().all(|shift| *shift == 0), "nothing to go by");
            }
            other => panic!("{other} after eleven seconds:\n{}", ended.stderr),
        }
        // One longer frame at the start may be; but for that a thousandth of a frame.
        let larger = shifts.iter().filter(|shift| shift.unsigned_abs() > MAJOR_NS / 1_000);
        assert!(larger.collect::<std::collections::BTreeSet<_>>().len() <= 1);
        let windows = ended.windows();
        assert!(windows.windows(2).all(|pair| {
            let step_ns = pair[1].planned_start_ns - pair[0].planned_start_ns;
            (MAJOR_NS - MAJOR_NS / 1_000..2 * MAJOR_NS).contains(&step_ns)
        }));
    }

    #[test]
    fn module_that_follows_another_one_locks_loses_it_when_it_is_gone_and_finds_it_again() {
        let _turn = alone();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pair.toml");
        std::fs::write(&path, pair()).unwrap();
        let start = |module: &str| -> Started {
            bateleur(&["run", "--schedule", path.to_str().unwrap(), "--module", module])
        };
        let leader = start("lead");
        let mut follower = start("own");
        follower.await_words("major frames follow lead:");
        leader.signal(Signal::KILL);
        follower.await_words("module: sync_lost (nothing was heard of lead for");
        // Its frames begin anywhere: they are followed by small steps.
        let leader_again = start("lead");
        follower.await_words("major frames follow lead again:");
        follower.signal(Signal::TERM);
        let ended = follower.end().expect_code(0);
        leader_again.signal(Signal::TERM);
        leader_again.end().expect_code(0);
        let lost: Vec<_> = ended.faults().into_iter().filter(|fault| fault.error == "sync_lost").collect();
        assert!(!lost.is_empty() && lost.iter().all(|fault| fault.action == "ignore"), "{lost:?}");
        let log = std::fs::read_to_string(ended.folder().join("alignment.csv")).unwrap();
        let shifts = log.lines().skip(1).map(|line| line.split(',').nth(8).unwrap().parse::<i64>().unwrap());
        let large: std::collections::BTreeSet<i64> =
            shifts.filter(|shift| shift.unsigned_abs() > MAJOR_NS / 1_000).collect();
        assert!(large.len() <= 1, "one longer frame at the start, and none in flight: {large:?}");
    }
}
