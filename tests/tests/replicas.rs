//! Partitions that run three times: what one of them writes wrongly reaches nobody, and it is named and started again.
//!
//! The flight is the judge: with every lie of one replica it is the flight without lies, to the bit.

use std::collections::BTreeMap;

use bateleur_tests::{Ended, among_others, bateleur, is_long, repository};

const KINDS: [&str; 6] = ["stuck", "bias", "swap", "corrupt", "delay", "drop"];
/// Between two lies, module time, s: no replica comes to the end of its five restarts in ten seconds.
const APART_S: f64 = 2.0;

fn schedule() -> String {
    std::fs::read_to_string(repository().join("schedules/replicas.toml")).unwrap()
}

fn fly(schedule: &str, options: &[String]) -> Ended {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("replicas.toml");
    std::fs::write(&path, schedule).unwrap();
    let fixed = ["fly", "--fast", "--format", "json", "--seed", "3", "--schedule", path.to_str().unwrap()];
    let fixed = fixed.map(str::to_owned);
    bateleur(&[&fixed[..], options].concat()).end()
}

fn digest(ended: &Ended) -> String {
    ended.summary()["digest"].as_str().unwrap().to_owned()
}

/// Numbers that repeat with their seed.
struct Random(u64);

impl Random {
    fn below(&mut self, bound: u64) -> u64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % bound
    }
}

/// Lies of one replica at a time through a whole flight, as options, and how many of each kind there are.
fn lies(seed: u64) -> (Vec<String>, BTreeMap<&'static str, usize>) {
    let mut random = Random(seed);
    let (mut options, mut told) = (Vec::new(), BTreeMap::new());
    let mut at_s = 1.0;
    while at_s < 195.0 {
        let kind = KINDS[random.below(KINDS.len() as u64) as usize];
        let port = ["command", "command", "status"][random.below(3) as usize];
        let most = [8, 400][random.below(2) as usize];
        let messages = 1 + random.below(most);
        let delay = if kind == "delay" { format!("/{}ms", 30 + random.below(400)) } else { String::new() };
        let replica = 1 + random.below(3);
        let instant_s = at_s + random.below(400) as f64 / 1000.0;
        options.extend([
            "--inject".to_owned(),
            format!("controller_{replica}.{port}:{kind}={messages}{delay}@{instant_s:.3}"),
        ]);
        *told.entry(kind).or_default() += 1;
        at_s += APART_S;
    }
    (options, told)
}

#[test]
fn whatever_one_controller_of_three_writes_the_flight_is_the_one_without_lies() {
    let _turn = among_others();
    let text = schedule();
    let clean = digest(&fly(&text, &[]).expect_code(0));
    let mut told = BTreeMap::new();
    let mut seed = 0;
    let enough = if is_long() { 1000 } else { 20 };
    while KINDS.iter().any(|kind| told.get(kind).copied().unwrap_or(0) < enough) {
        seed += 1;
        let (options, kinds) = lies(seed);
        let ended = fly(&text, &options).expect_code(0);
        assert_eq!(digest(&ended), clean, "seed {seed}: {options:?}");
        // Messages that differ are forgiven where they are few: of the many, most are not.
        let outvoted = ended.faults().into_iter().filter(|fault| fault.error == "outvoted");
        assert!(outvoted.clone().count() > 10, "seed {seed}: {:?}", ended.faults());
        assert!(outvoted.clone().all(|fault| fault.action == "warm_restart"), "seed {seed}");
        assert!(outvoted.clone().all(|fault| fault.partition.starts_with("controller_")), "seed {seed}");
        kinds.into_iter().for_each(|(kind, count)| *told.entry(kind).or_default() += count);
    }
    eprintln!("{seed} flights: {told:?}");
}

#[test]
fn replica_that_lies_is_named_with_the_field_and_comes_back_with_what_the_others_retain() {
    let _turn = among_others();
    let lie = ["--inject", "controller_2.command:bias=100000@60"].map(str::to_owned);
    let ended = fly(&schedule(), &lie).expect_code(0);
    let outvoted: Vec<_> = ended.faults().into_iter().filter(|fault| fault.error == "outvoted").collect();
    // Once: if its successor knew nothing of the flight, it would be outvoted, too.
    let [fault] = outvoted.as_slice() else { panic!("{outvoted:#?}") };
    assert_eq!((fault.partition.as_str(), fault.action.as_str()), ("controller_2", "warm_restart"));
    assert!(fault.detail.starts_with("command.") && fault.detail.contains(" by most"), "{}", fault.detail);
    assert!((60_000_000_000..60_200_000_000).contains(&fault.time_ns), "{fault:?}");
}

#[test]
fn deaths_of_replicas_change_nothing_and_the_flight_outlives_its_voter() {
    let _turn = among_others();
    let kills = |names: &[&str]| {
        let options = names.iter().flat_map(|name| ["--kill".to_owned(), (*name).to_owned()]);
        fly(&schedule(), &options.collect::<Vec<_>>()).expect_code(0)
    };
    let clean = digest(&kills(&[]));
    let many = ["controller_1@31.013", "controller_2@60.006", "controller_3@90.0085", "controller_1@120"];
    assert_eq!(digest(&kills(&many)), clean);
    // A cold start is none where another replica knows better.
    let cold =
        schedule().replace("killed            = \"warm_restart\"", "killed            = \"cold_restart\"");
    let options = many.iter().flat_map(|name| ["--kill".to_owned(), (*name).to_owned()]);
    assert_eq!(digest(&fly(&cold, &options.collect::<Vec<_>>()).expect_code(0)), clean);
    let ended = kills(&["controller@70", "controller@110.0099"]);
    let faults = ended.faults();
    assert!(faults.iter().all(|fault| fault.partition == "controller"), "{faults:?}");
}

#[test]
fn setting_of_the_partition_is_set_in_each_replica() {
    let _turn = among_others();
    let options = ["--set", "controller.laps=1"].map(str::to_owned);
    let ended = fly(&schedule(), &options).expect_code(0);
    assert!(ended.faults().is_empty(), "{:?}", ended.faults());
    let said = &ended.summary()["mission"];
    assert!(said.to_string().contains('1'), "{said}");
}

/// The plan above with a replica on each of three computers.
fn on_three_hosts() -> String {
    let (one, three) = (schedule(), std::fs::read_to_string(repository().join("schedules/three-hosts.toml")));
    let three = three.unwrap();
    let between = |text: &str, from: &str, to: &str| {
        let begin = text.find(from).unwrap();
        text[begin..begin + text[begin..].find(to).unwrap()].to_owned()
    };
    let hosts = between(&three, "[network.a]", "[link.state]").replace("\"2ms\"", "\"1ms\"");
    let windows = [
        ("rate_generator", "0ms", "500us"),
        ("hil_interface", "500us", "2.5ms"),
        ("gps", "3.2ms", "500us"),
        ("imu", "3.8ms", "500us"),
        ("estimator", "4.4ms", "2ms"),
        ("relay_fcu", "6.5ms", "500us"),
        ("relay_nav", "8.2ms", "500us"),
        ("relay_ctl", "8.2ms", "500us"),
        ("controller_1", "8.8ms", "1ms"),
        ("controller_2", "8.8ms", "1ms"),
        ("controller_3", "8.8ms", "1ms"),
        ("relay_nav", "9.9ms", "500us"),
        ("relay_ctl", "9.9ms", "500us"),
        ("relay_fcu", "11.6ms", "500us"),
        ("controller", "12.2ms", "500us"),
        ("servo", "12.8ms", "600us"),
        ("onboard_computer", "15.4ms", "500us"),
        ("command", "16ms", "2ms"),
    ];
    let window = |(partition, offset, duration)| {
        format!("{{ partition = \"{partition}\", offset = \"{offset}\", duration = \"{duration}\" }},\n")
    };
    let windows: String = windows.into_iter().map(window).collect();
    one.replace(&between(&one, "[module.fcu]", "[schedule.flight]"), &hosts)
        .replace(&between(&one, "window = [", "[[chain]]"), &format!("window = [\n{windows}]\n"))
        .replace("replicas   = 3", "replicas   = [\"fcu\", \"nav\", \"ctl\"]")
        .replace("max_age = \"25ms\"", "max_age = \"40ms\"")
}

#[test]
fn replicas_on_three_hosts_outvote_one_on_any_of_them() {
    let _turn = among_others();
    let text = on_three_hosts();
    let flown = |more: &[&str]| {
        let options: Vec<String> = ["--hosts"].iter().chain(more).map(|&option| option.to_owned()).collect();
        fly(&text, &options).expect_code(0)
    };
    let clean = digest(&flown(&[]));
    let here = flown(&["--inject", "controller_1.command:swap=100000@60", "--kill", "controller_2@120"]);
    assert_eq!(digest(&here), clean);
    let outvoted = here.faults().into_iter().filter(|fault| fault.error == "outvoted");
    assert!(outvoted.map(|fault| fault.partition).eq(["controller_1".to_owned()]));
    // Of one elsewhere the voter's host says it; that host's executive is not told.
    let there = flown(&["--inject", "controller_3.command:bias=100000@60"]);
    assert_eq!(digest(&there), clean);
    let named = there.faults().into_iter().find(|fault| fault.detail.contains("controller_3 is outvoted"));
    assert!(named.is_some_and(|fault| fault.partition == "controller"), "{:?}", there.faults());
}
