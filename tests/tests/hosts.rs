//! Flights on several hosts: the Estimator, the Controller and the Servo on computers of their own, over networks that work,
//! that lose and delay, and that are cut; hosts that die; on one virtual clock, and in real time in network namespaces.

use std::collections::BTreeSet;
use std::path::PathBuf;
use std::time::Duration;

use bateleur_contract::relay::LinkModelTable;
use bateleur_relay::model::LinkModel;
use bateleur_tests::{
    Ended, ONE_PROCESS, TWO_LAPS, alone, among_others, bateleur, flight_schedule, is_long, program,
    repository, small_mission,
};
use rustix::process::Signal;
use serde_json::Value;

fn schedule(name: &str) -> PathBuf {
    repository().join("schedules").join(format!("{name}.toml"))
}

/// A flight on the virtual clock, of the hosts of a shipped schedule.
fn fly(name: &str, choices: &[&str]) -> Ended {
    let schedule = schedule(name);
    let mut arguments = vec!["fly", "--fast", "--hosts", "--seed", "7", "--format", "json", "--schedule"];
    arguments.push(schedule.to_str().unwrap());
    arguments.extend(choices);
    bateleur(&arguments).end()
}

/// The same over sooner.
fn fly_small(name: &str, choices: &[&str]) -> Ended {
    fly(name, &[&["--mission", small_mission().to_str().unwrap()], choices].concat())
}

fn on_one_host() -> Value {
    fly_one(&[])
}

fn fly_one(choices: &[&str]) -> Value {
    let schedule = flight_schedule();
    let arguments = ["fly", "--fast", "--seed", "7", "--format", "json", "--schedule"];
    bateleur(&[&arguments[..], &[schedule.to_str().unwrap()], &ONE_PROCESS, choices].concat())
        .end()
        .expect_code(0)
        .summary()
}

const SCORES: [&str; 3] = ["altitude_rms_m", "airspeed_rms_mps", "straight_cross_track_rms_m"];

/// Both laps, with scores that are at most 1.2 times those of one host.
fn assert_flown_as_on_one(summary: &Value, one: &Value, which: &str) {
    assert_eq!(summary["completed"], true, "{which}: {}", summary["failure"]);
    assert_eq!(summary["waypoints"], Value::from(TWO_LAPS.to_vec()), "{which}");
    for name in SCORES {
        let score = |summary: &Value| summary[name].as_f64().unwrap();
        let (here, there) = (score(summary), score(one));
        assert!(here <= 1.2 * there, "{which}: {name} is {here}, and {there} on one host");
    }
}

#[test]
fn flights_are_the_same_wherever_estimator_controller_and_servo_run() {
    let _turn = among_others();
    let one = fly_one(&["--mission", small_mission().to_str().unwrap()]);
    let whole = is_long().then(on_one_host);
    for name in ["two-hosts", "controls-apart", "three-hosts"] {
        // Nothing is lost and everything comes in its minor frame: every actuator word is the same.
        let summary = fly_small(name, &[]).expect_code(0).summary();
        assert_eq!(summary["digest"], one["digest"], "{name}");
        if let Some(one) = &whole {
            let summary = fly(name, &[]).expect_code(0).summary();
            assert_flown_as_on_one(&summary, one, name);
            assert_eq!(summary["digest"], one["digest"], "{name}");
        }
    }
}

const BAD_LINK: &str = "loss=0.05,delay=1ms,jitter=5ms,duplicate=0.02,reorder=0.02,reorder_by=3ms,seed=3";

/// The same for [`BAD_LINK`].
fn bad_link() -> LinkModelTable {
    LinkModelTable {
        seed: 3,
        delay_ns: 1_000_000,
        jitter_ns: 5_000_000,
        loss: 0.05,
        duplicate: 0.02,
        reorder: 0.02,
        reorder_ns: 3_000_000,
        ..LinkModelTable::default()
    }
}

#[test]
fn two_laps_over_bad_networks_are_flown_and_are_the_same_again() {
    let _turn = among_others();
    let one = on_one_host();
    let first = fly("two-hosts", &["--link", BAD_LINK]).expect_code(0);
    assert_flown_as_on_one(&first.summary(), &one, "bad networks");
    assert_ne!(first.summary()["digest"], one["digest"], "the networks do something");
    let [small, again] =
        [(); 2].map(|()| fly_small("two-hosts", &["--link", BAD_LINK]).expect_code(0).summary());
    assert_eq!(small["digest"], again["digest"]);
}

fn number(value: &Value) -> u64 {
    value.as_u64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// What `bateleur links` says of a flight's only link at one of its ends.
fn link_at(links: &Value, module: &str) -> (u64, Value) {
    let modules = links["modules"].as_array().unwrap();
    let found = modules.iter().find(|one| one["module"] == module).unwrap();
    (number(&found["time_ns"]), found["links"][0].clone())
}

/// Nothing but what the two lives of both ends say before they have proof of each other.
fn assert_nothing_refused(link: &Value) {
    let refused = link["rejected"].as_object().unwrap();
    let meant = |(why, count): (&String, &Value)| number(count) == 0 || why == "restart";
    assert!(refused.iter().all(meant), "{refused:?}");
}

/// When the relay of a host sent: at the start of each of its windows.
fn sent_ns(ended: &Ended, relay: &str) -> Vec<u64> {
    let windows = ended.windows().into_iter();
    windows.filter(|window| window.partition == relay).filter_map(|window| window.granted_ns).collect()
}

/// What a receiver has to have counted at `until_ns` of what was sent at the instants `sent_ns`: all that came, and of it what had
/// come before, what never came though later ones did, and what first came after a later one.
fn expected(mut model: LinkModel, sent_ns: &[u64], until_ns: u64) -> [u64; 4] {
    let mut came: Vec<(u64, usize)> = Vec::new();
    for (number, &at_ns) in sent_ns.iter().enumerate() {
        let arrivals = model.pass(at_ns, 100).into_iter().flatten();
        came.extend(arrivals.filter(|arrives_ns| *arrives_ns <= until_ns).map(|at_ns| (at_ns, number)));
    }
    came.sort_unstable();
    let received = came.len() as u64;
    let (mut different, mut reordered) = (BTreeSet::new(), 0);
    for (_, number) in came {
        let overtaken = different.last().is_some_and(|newest| *newest > number);
        reordered += u64::from(different.insert(number) && overtaken);
    }
    let newest = different.last().map_or(0, |newest| newest + 1);
    [received, received - different.len() as u64, (newest - different.len()) as u64, reordered]
}

#[test]
fn counters_of_a_flight_over_bad_networks_are_what_the_networks_did() {
    let _turn = among_others();
    let ended = fly_small("two-hosts", &["--link", BAD_LINK]).expect_code(0);
    let out = ended.folder();
    let links =
        bateleur(&["links", out.to_str().unwrap(), "--format", "json"]).end().expect_code(0).summary();
    for (sender, receiver, initiator) in [("fcu", "nav", true), ("nav", "fcu", false)] {
        let (until_ns, link) = link_at(&links, receiver);
        let sent = sent_ns(&ended, &format!("relay_{sender}"));
        for (place, network) in ["a", "b"].into_iter().enumerate() {
            let counted = &link["networks"][place];
            assert_eq!(counted["network"], network);
            let model = LinkModel::new(&bad_link(), network, 0, initiator);
            let found = ["received", "duplicated", "lost", "reordered"].map(|key| number(&counted[key]));
            let expected = expected(model, &sent, until_ns);
            assert_eq!(found, expected, "{sender} to {receiver} on {network}");
            assert!(expected.iter().all(|count| *count > 5), "the network does something: {expected:?}");
        }
        assert_nothing_refused(&link);
    }
}

/// Lines of the health log that name a network or a link.
fn told(ended: &Ended, words: &str) -> usize {
    ended.faults().iter().filter(|fault| fault.detail.contains(words)).count()
}

#[test]
fn one_network_that_is_cut_costs_nothing_and_is_told() {
    let _turn = among_others();
    let one = fly_one(&["--mission", small_mission().to_str().unwrap()]);
    let ended = fly_small("two-hosts", &["--cut", "a@30-50"]).expect_code(0);
    assert_eq!(ended.summary()["digest"], one["digest"], "nothing was lost");
    assert_eq!(told(&ended, "nothing comes on network a"), 2, "at both ends: {:?}", ended.faults());
    assert_eq!(told(&ended, "down"), 0, "the link itself never was: {:?}", ended.faults());
    let links = bateleur(&["links", ended.folder().to_str().unwrap(), "--format", "json"]).end().summary();
    for module in ["fcu", "nav"] {
        let (_, link) = link_at(&links, module);
        assert_eq!((&link["state"], &link["messages"]["lost"]), (&"up".into(), &0.into()));
        assert!(number(&link["networks"][0]["lost"]) > 1000, "{link}");
        assert_eq!(link["networks"][1]["lost"], 0);
    }
}

#[test]
fn both_networks_cut_are_survived_without_a_restart() {
    let _turn = among_others();
    let ended = fly_small("two-hosts", &["--cut", "a@40-42", "--cut", "b@40-42"]);
    let summary = ended.summary();
    assert_eq!(summary["completed"], true, "{}\n{}", summary["failure"], ended.stderr);
    assert_eq!(told(&ended, "link nav: down"), 2, "at both ends: {:?}", ended.faults());
    let restarts = ended.faults().into_iter().filter(|fault| fault.action.ends_with("restart"));
    assert_eq!(restarts.count(), 0);
    assert!(!ended.stderr.contains("frame 0 again"), "{}", ended.stderr);
}

#[test]
fn dead_host_ends_the_flight_in_words_and_never_hangs_it() {
    let _turn = among_others();
    let ended = fly_small("two-hosts", &["--kill-host", "nav@60"]);
    let ended = ended.expect_words(&["host nav is killed", "link nav: down"]);
    let summary = ended.summary();
    // Without an estimate nobody flies laps; the aircraft's own module goes on, with every partition in it.
    assert_eq!(summary["completed"], false);
    let restarts = ended.faults().into_iter().filter(|fault| fault.action.ends_with("restart"));
    assert_eq!(restarts.count(), 0, "{:?}", ended.faults());
}

/// What can be judged of a flight whose second host died and came back: it has flown on, and everything is there again.
fn assert_back(ended: &Ended, module: &str) {
    assert!(ended.stderr.contains(&format!("host {module} is started again")), "{}", ended.stderr);
    assert!(ended.stderr.contains("has died"), "the other one says so: {}", ended.stderr);
    let ups = ended.stderr.matches("link nav: up").count();
    assert!(ups >= 4, "at both ends, before and after: {}", ended.stderr);
    // Nobody but the dead host was started anew.
    let restarts = ended.faults().into_iter().filter(|fault| fault.action.ends_with("restart"));
    assert_eq!(restarts.count(), 0, "{:?}", ended.faults());
    assert!(!ended.stderr.contains("frame 0 again"), "{}", ended.stderr);
}

#[test]
fn dead_host_that_comes_back_is_met_again_and_the_flight_is_the_same_twice() {
    let _turn = among_others();
    let fly = || fly_small("two-hosts", &["--kill-host", "nav@60-61"]);
    let first = fly();
    assert_back(&first, "nav");
    let links = bateleur(&["links", first.folder().to_str().unwrap(), "--format", "json"]).end().summary();
    for module in ["fcu", "nav.2"] {
        let (_, link) = link_at(&links, module);
        assert_eq!(link["state"], "up", "{module}: {link}");
    }
    assert!(first.folder().join("hosts/nav.2/windows.csv").exists());
    let (first, second) = (first.summary(), fly().summary());
    assert_eq!(first["digest"], second["digest"]);
    assert_eq!(first["completed"], second["completed"]);
}

#[test]
fn host_with_the_line_to_the_ground_can_not_come_back_and_the_message_says_so() {
    fly("two-hosts", &["--kill-host", "fcu@60-61"])
        .expect_code(2)
        .expect_words(&["fcu", "its end is the flight's"]);
    fly("two-hosts", &["--kill-host", "nav@50-51", "--kill-host", "nav@50.5-53"])
        .expect_code(2)
        .expect_words(&["nav is dead from 50 s on", "50.5 s"]);
    fly("two-hosts", &["--kill-host", "nav@61-60"]).expect_code(2).expect_words(&["MODULE@FROM-UNTIL"]);
}

#[test]
fn trace_has_the_cores_and_partitions_of_each_module() {
    let _turn = among_others();
    let ended = fly_small("two-hosts", &["--cut", "a@30-31"]).expect_code(0);
    let out = ended.folder();
    let trace = out.join("trace.json");
    bateleur(&["export", out.to_str().unwrap(), "--chrome", trace.to_str().unwrap()]).end().expect_code(0);
    let trace: Value = serde_json::from_slice(&std::fs::read(trace).unwrap()).unwrap();
    let events = trace["traceEvents"].as_array().unwrap();
    let named = events.iter().filter(|event| event["name"] == "process_name");
    let names: Vec<&str> = named.map(|event| event["args"]["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["fcu cores", "fcu partitions", "nav cores", "nav partitions"]);
    let process_of = |partition: &str| {
        let used = |event: &&Value| event["ph"] == "X" && event["name"] == partition;
        events.iter().find(used).unwrap_or_else(|| panic!("no window of {partition}"))["pid"].clone()
    };
    assert_ne!(process_of("estimator"), process_of("controller"));
    assert_eq!(process_of("estimator"), process_of("relay_nav"));
}

/// Namespaces that somebody has made, by the interfaces that `fly --hosts` makes in them; its own are not among them.
fn bridges_here() -> usize {
    let entries = std::fs::read_dir("/sys/class/net").unwrap();
    entries.filter(|entry| entry.as_ref().unwrap().file_name().to_string_lossy().starts_with("net")).count()
}

fn is_root() -> bool {
    rustix::process::geteuid().is_root()
}

fn in_namespaces(choices: &[&str]) -> bateleur_tests::Started {
    let schedule = schedule("two-hosts");
    let mut arguments = vec!["fly", "--hosts", "--seed", "7", "--format", "json", "--schedule"];
    arguments.push(schedule.to_str().unwrap());
    arguments.extend(choices);
    bateleur(&arguments)
}

fn started_by(parent: i32) -> Vec<i32> {
    let entries = std::fs::read_dir("/proc").unwrap().flatten();
    let pids = entries.filter_map(|entry| entry.file_name().to_str()?.parse::<i32>().ok());
    pids.filter(|pid| field(*pid, 1).as_deref() == Some(&parent.to_string())).collect()
}

fn is_alive(pid: i32) -> bool {
    field(pid, 0).is_some_and(|state| state != "Z")
}

/// A field of /proc/PID/stat behind the name: 0 the state, 1 the parent.
fn field(pid: i32, place: usize) -> Option<String> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    stat.rsplit_once(')')?.1.split_ascii_whitespace().nth(place).map(str::to_owned)
}

/// Two modules of one partition each: the one talks, the other listens.
fn two_modules(priority: u32) -> String {
    let queuer = program("queuer");
    let partition = |name: &str, module: &str, port: &str| {
        format!(
            "[partition.{name}]\nprogram = \"{}\"\nmodule = \"{module}\"\nmemory = \"96MiB\"\npriority = {priority}\n\
             [partition.{name}.port]\n{port}\n",
            queuer.display()
        )
    };
    let window = |name: &str, offset: u32| {
        format!("    {{ partition = \"{name}\", offset = \"{offset}ms\", duration = \"1ms\" }},\n")
    };
    let windows = [("talker", 1), ("relay_one", 3), ("relay_two", 6), ("listener", 9)];
    let windows: String = windows.iter().map(|(name, offset)| window(name, *offset)).collect();
    [
        "[network.a]\nrate = \"100Mbit/s\"\n".to_owned(),
        "[module.one]\ncores = [1]\naddresses = { a = \"10.99.0.1:15300\" }\n".to_owned(),
        "[module.two]\ncores = [1]\naddresses = { a = \"10.99.0.2:15300\" }\nfollows = \"one\"\n".to_owned(),
        "[link.bus]\nmodules = [\"one\", \"two\"]\nunauthenticated = true\ngap = \"4ms\"\n".to_owned(),
        partition("talker", "one", "out = { direction = \"source\", kind = \"queuing\", message = \"GroundMessage\" }"),
        partition(
            "listener",
            "two",
            "in = { direction = \"destination\", kind = \"queuing\", message = \"GroundMessage\", depth = 4 }",
        ),
        "[[channel]]\nsource = \"talker.out\"\ndestinations = [\"listener.in\"]\n".to_owned(),
        format!("[schedule.only]\nmajor_frame = \"20ms\"\nminor_frame = \"20ms\"\nwindow = [\n{windows}]\n"),
    ]
    .concat()
}

/// Runs both modules of [`two_modules`] on one virtual clock, each with a plan of its own; gives what they said.
fn run_two(plans: [String; 2], subnet: u8) -> [Ended; 2] {
    let folder = tempfile::tempdir().unwrap();
    let clock = folder.path().join("clock");
    let process = std::process::id();
    let address = |host: usize| format!("127.{subnet}.{}.{}:15300", process % 250 + 1, host + 1);
    let start = |place: usize| {
        let name = ["one", "two"][place];
        let file = folder.path().join(format!("{name}.toml"));
        std::fs::write(&file, &plans[place]).unwrap();
        let [file, clock] = [&file, &clock].map(|path| path.display().to_string());
        let mut arguments: Vec<String> =
            ["run", "--fast", "--until", "3", "--record"].map(str::to_owned).to_vec();
        arguments.extend(["--module".to_owned(), name.to_owned(), "--schedule".to_owned(), file]);
        arguments.extend(["--together".to_owned(), clock, "--place".to_owned(), format!("{place}/2")]);
        for host in 0..2 {
            arguments
                .extend(["--address".to_owned(), format!("10.99.0.{}:15300={}", host + 1, address(host))]);
        }
        bateleur(&arguments)
    };
    let started = [start(0), start(1)];
    started.map(|one| one.end().expect_code(0))
}

#[test]
fn two_modules_of_one_plan_talk_and_lose_nothing() {
    let _turn = among_others();
    let [one, two] = run_two([two_modules(40), two_modules(40)], 252);
    let heard =
        two.stderr.lines().filter_map(|line| line.split_once("listener: heard ")?.1.parse::<u64>().ok());
    // 150 windows each; the last message may be on its way.
    assert!(heard.max().unwrap_or(0) >= 149, "{}", two.stderr);
    assert!(!one.stderr.contains("talker: refused"), "{}", one.stderr);
    assert!(two.stderr.contains("link bus is not authenticated"), "{}", two.stderr);
}

#[test]
fn two_modules_of_different_plans_refuse_each_other_and_say_where_they_differ() {
    let _turn = among_others();
    let [one, two] = run_two([two_modules(40), two_modules(39)], 253);
    assert!(!two.stderr.contains("heard"), "{}", two.stderr);
    for ended in [one, two] {
        assert!(ended.stderr.contains("partition talker"), "where they differ: {}", ended.stderr);
    }
}

#[test]
fn module_without_its_key_does_not_start_and_is_told_how_to_get_one() {
    let _turn = among_others();
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("two.toml");
    std::fs::copy(schedule("two-hosts"), &file).unwrap();
    let run = || {
        bateleur(&["run", "--fast", "--module", "nav", "--until", "1", "--schedule", file.to_str().unwrap()])
    };
    run().end().expect_code(2).expect_words(&["the key of link nav", "bateleur key FILE"]);
    let key = folder.path().join("keys/nav.key");
    bateleur(&["key", key.to_str().unwrap()]).end().expect_code(0);
    // Made by somebody who did not mind.
    std::fs::set_permissions(&key, std::os::unix::fs::PermissionsExt::from_mode(0o644)).unwrap();
    run().end().expect_code(2).expect_words(&["mode 0644", "chmod 600"]);
    assert!(!String::from_utf8_lossy(&std::fs::read(&key).unwrap()).is_empty());
}

/// What shares the machine with no other test.
mod alone {
    use super::*;

    #[test]
    fn hosts_in_namespaces_fly_in_real_time_and_leave_nothing_when_they_are_stopped() {
        let _turn = alone();
        if !is_root() {
            let ended = in_namespaces(&[]).end();
            ended.expect_code(2).expect_words(&["root", "--fast"]);
            return;
        }
        let before = bridges_here();
        let mut flight = in_namespaces(&[]);
        flight.await_words("waiting for the estimator");
        // The estimate comes over the networks.
        flight.await_words("climbing");
        flight.signal(Signal::INT);
        let ended = flight.end();
        assert!(ended.stderr.contains("link nav: up"), "{}", ended.stderr);
        assert_eq!(bridges_here(), before);
        let links =
            bateleur(&["links", ended.folder().to_str().unwrap(), "--format", "json"]).end().summary();
        for module in ["fcu", "nav"] {
            let (_, link) = link_at(&links, module);
            assert_nothing_refused(&link);
            assert!(number(&link["messages"]["received"]) > 100, "{link}");
            assert!((0..2).all(|network| number(&link["networks"][network]["received"]) > 100), "{link}");
        }
    }

    #[test]
    fn cut_networks_and_a_dead_host_are_back_in_real_time_without_a_restart_of_the_module() {
        let _turn = alone();
        if !is_root() {
            return;
        }
        let faults = ["--cut", "a@4-5", "--cut", "b@4-5", "--kill-host", "nav@9-10"];
        let mut flight = in_namespaces(&faults);
        let await_ups = |flight: &bateleur_tests::Started, count: usize| {
            let seen = bateleur_tests::await_some(Duration::from_secs(60), || {
                (flight.said().matches("link nav: up").count() >= count).then_some(())
            });
            assert!(seen.is_some(), "{count} times up: {}", flight.said());
        };
        flight.await_words("network b is there again");
        // At both ends, at the start and after the cut.
        await_ups(&flight, 4);
        flight.await_words("host nav is started again");
        await_ups(&flight, 6);
        std::thread::sleep(Duration::from_secs(2)); // for what is counted below
        flight.signal(Signal::INT);
        let ended = flight.end();
        assert!(!ended.stderr.contains("frame 0 again"), "{}", ended.stderr);
        let links =
            bateleur(&["links", ended.folder().to_str().unwrap(), "--format", "json"]).end().summary();
        for module in ["fcu", "nav.2"] {
            let (_, link) = link_at(&links, module);
            assert_eq!(link["state"], "up", "{module}: {link}");
            for network in 0..2 {
                assert_eq!(link["networks"][network]["unsent"], 0, "{module}: {link}");
                assert_eq!(link["networks"][network]["up"], true, "{module}: {link}");
            }
        }
    }

    #[test]
    fn hosts_in_namespaces_end_when_the_program_that_made_them_is_killed() {
        let _turn = alone();
        if !is_root() {
            return;
        }
        let mut flight = in_namespaces(&[]);
        flight.await_words("waiting for the estimator");
        let group = flight.pid();
        let all = started_by(group);
        assert!(all.len() >= 3, "the simulator and two executives: {all:?}");
        flight.signal(Signal::KILL);
        let gone = bateleur_tests::await_some(Duration::from_secs(20), || {
            all.iter().all(|pid| !is_alive(*pid)).then_some(())
        });
        assert!(
            gone.is_some(),
            "still there: {:?}",
            all.iter().filter(|pid| is_alive(**pid)).collect::<Vec<_>>()
        );
    }
}
